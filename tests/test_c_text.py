"""The printed controllers in C, word for word, and the rules by which they are printed."""

import re
from pathlib import Path

import numpy as np
import pytest
import sympy
from exported import EVERYTHING, sampled
from test_extensions import law_of

import certrack
from certrack.core.errors import InputError
from certrack.core.select import Select, clamp, magnitude
from certrack.export.c.export import controller_files, export_c, write_all
from certrack.export.c.printer import (
    C_LINE_WIDTH,
    CPrinter,
    c_literal,
    comment,
    helper_definition,
    initialiser,
    wrapped,
)
from certrack.export.c.readme import README_KIND
from certrack.export.c.source import c_code

TEXTS = Path(__file__).parent / "data" / "c_texts"

#: A plant whose terms use what C has, and what it needs helpers for.
RICH = '''
[plant]
states = ["x1", "x2"]
chain = [1]
drift = """
sin(x1)*x2**3/2 - sqrt(1 + x2**2) + max(x1, -x2, 1/3) + x1*tanh(x2)*2 + (x1 + x2)/(1 + x1**2)
"""
regressor = ["abs(x1)*sign(x2)", "x2**2*min(x1**9, 2)*a", "(x1 - 2)**2*sqrt(3 - tanh(x2))"]
gain_sign = -1
input_gain = -2
theta = [1, 2, -3]
[plant.constants]
a = 0.7
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0.1]
beta = [0, 0.1]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [2, 3]
feedforward = 1
[truth]
input_gain = -2
theta = [1, 2, -3]
[simulation]
x0 = [0, 0]
duration = 1
[implementation]
period = 0.002
saturation = [-2, 3]
'''


def static():
    return certrack.load("dual-motor-lean").replace(
        implementation=certrack.Implementation(period=0.001)
    )


CASES = {
    "everything": lambda: c_code(sampled("example1", **EVERYTHING), "drive"),
    "float": lambda: c_code(
        sampled("example1", velocity=("x2",), velocity_filter=0.002, saturation=(-5, 5)),
        "axis 7",
        real="float",
        monitor=certrack.Monitor(parameters=True),
    ),
    "static": lambda: c_code(static(), "lean"),
    "static-parameters": lambda: c_code(
        static(), "lean", monitor=certrack.Monitor(parameters=True)
    ),
    "observer": lambda: c_code(certrack.load("dual-motor-observer"), "drive", real="float"),
    "time": lambda: c_code(
        law_of(lambda s: s.t).replace(implementation=certrack.Implementation(period=0.25)), "clock"
    ),
    "rich": lambda: c_code(certrack.loads(RICH), "rich"),
}


def short(match):
    """A number that was computed, to the digits that every machine gives."""
    return f"{float(match[0]):.6g}"


def text_of(name):
    code = CASES[name]()
    files = controller_files(code)
    kept = (files[f"{code.name}{end}"] for end in (".h", ".c", "_guard.h"))
    return re.sub(r"\d+\.\d{6,}(e-?\d+)?", short, "".join(kept))


@pytest.mark.parametrize("name", CASES)
def test_the_text_of_a_controller(name):
    assert text_of(name) == (TEXTS / f"{name}.txt").read_text()


# numbers and lines


def test_numbers_are_those_of_the_type():
    assert c_literal(1, "double") == "1.0" and c_literal(0.1, "double") == "0.1"
    assert c_literal(1e300, "double") == "1e+300" and c_literal(-0.25, "float") == "-0.25F"
    assert c_literal(0.1, "float") == "0.1F" and c_literal(1 / 3, "float") == "0.33333334F"
    with pytest.raises(InputError, match="float cannot hold the number 1e"):
        c_literal(1e39, "float")
    assert initialiser((1, 0.5), "double") == "{1.0, 0.5}"


def test_long_statements_break_where_the_fewest_parentheses_are_open():
    terms = " + ".join(f"(a_{i} * (b_{i} - c_{i}))" for i in range(9))
    lines = wrapped(f"const double y = {terms};").splitlines()
    assert len(lines) == 3 and all(len(line) <= C_LINE_WIDTH for line in lines)
    assert lines[0].startswith("    const") and lines[0].endswith(")")
    assert lines[1].startswith("        + (a_")
    assert " ".join(line.strip() for line in lines) == f"const double y = {terms};"
    call = "double f(" + ", ".join(f"double argument_{i}" for i in range(8)) + ")"
    lines = wrapped(call, "").splitlines()
    assert lines[0].endswith(",") and lines[1].startswith("    double argument")
    assert wrapped("short;") == "    short;"
    assert wrapped("x" * 200, "") == "x" * 200  # nowhere to break


@pytest.mark.parametrize("spare", [0, 1])
def test_a_line_may_be_full(spare):
    text = "y = " + "a" * (C_LINE_WIDTH - 4 - 12 - spare) + " + b;" + "c" * 3
    assert (len("    " + text) <= C_LINE_WIDTH) == ("\n" not in wrapped(text))
    assert all(len(line) <= C_LINE_WIDTH for line in wrapped(text).splitlines())


def test_nothing_ends_a_comment():
    made = comment(["a */ b /* c // d", "", "??/ Ä", "*/"])
    body = made[3:-3]
    assert made.startswith("/*\n") and made.endswith(" */\n")
    assert "*/" not in body and "/*" not in body and "//" not in body and "??" not in body
    assert made.isascii() and "\n *\n" in made and "\\xc4" in made


# formulas

A, B, C = SYMBOLS = sympy.symbols("a b c", real=True)


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (A + B * C - 2, "a + (c * b) - 2.0"),
        (A - B, "a - b"),
        (-A - B * C, "(-a) - (c * b)"),
        (2 * A * B, "2.0 * a * b"),
        (C * A * B, "c * a * b"),  # c is a constant, so it comes first
        (A / B, "a / b"),
        (A * B / C, "(a * b) / c"),
        (A / (B * C), "a / (b * c)"),
        (1 / A, "1.0 / a"),
        (A**-3, "1.0 / (a * a * a)"),
        ((A + B) / (A - B), "(a + b) / (a - b)"),
        (A**3, "a * a * a"),
        (A**8, " * ".join("a" * 8)),
        (A**9, "pow(a, 9.0)"),
        (A**2 * B, "a * a * b"),
        ((A + B) ** 2, "(a + b) * (a + b)"),
        (sympy.sqrt(A + 1), "sqrt(1.0 + a)"),
        (A ** sympy.Rational(3, 2), "pow(a, 1.5)"),
        (sympy.sin(A) * sympy.exp(-B), "sin(a) * exp(-b)"),
        (B * sympy.sin(A) + C, "c + (b * sin(a))"),
        (magnitude(A - B), "fabs(a - b)"),
        (sympy.Abs(A), "fabs(a)"),
        (sympy.sign(A + B), "sign(a + b)"),
        (clamp(A + B, -C, C), "clamp(a + b, -c, c)"),
        (Select(A + B, C, A, B) * 2, "2.0 * (((a + b) > c) ? a : b)"),
        (sympy.pi * A, "3.141592653589793 * a"),
    ],
)
def test_a_formula_in_c(formula, text):
    printer = CPrinter({name: name.name for name in SYMBOLS}, "double", [C])
    assert printer.text(formula) == text
    functions = ("sin", "exp", "sqrt", "pow", "fabs")
    assert printer.calls == any(f"{name}(" in text for name in functions)


def test_functions_of_floats_have_their_own_names():
    printer = CPrinter({A: "a"}, "float", [])
    terms = printer.text(sympy.sin(A) + sympy.sqrt(A) + A**9).split(" + ")
    assert sorted(terms) == ["powf(a, 9.0F)", "sinf(a)", "sqrtf(a)"]


def test_helpers_are_printed_in_their_type():
    text = helper_definition("sign", "axis_real", "float")
    assert "static axis_real sign(axis_real value)" in text
    assert "return (value > 0.0F) ? 1.0F : ((value < 0.0F) ? -1.0F : value);" in text


# files


def test_an_export_has_its_files_and_no_others(tmp_path, monkeypatch):
    module = "certrack.export.c.export."
    monkeypatch.setattr(module + "golden_vectors", lambda system, program, real: real)
    monkeypatch.setattr(module + "acceptance_test", lambda code, vectors: f"tests {vectors}")
    assert list(controller_files(CASES["everything"]())) == ["drive.h", "drive.c", "drive_guard.h"]
    system, folder = sampled("example1", saturation=(-5, 5)), tmp_path / "new"
    written = export_c(system, folder, "drive", monitor=certrack.Monitor())
    assert [path.name for path in written.files] == [
        *("drive.h", "drive.c", "drive_guard.h", "drive_monitor.h", "drive_test.c", "README.md")
    ]
    assert written.name == "drive" and written.notes == c_code(system).notes
    assert (folder / "drive_test.c").read_text() == "tests double"
    assert README_KIND in (folder / "README.md").read_text()
    write_all(folder, {"drive.h": "another"})  # over one of its kind
    assert (folder / "drive.h").read_text() == "another"


def test_a_folder_of_another_kind_is_left_alone(tmp_path):
    (tmp_path / "README.md").write_text("my notes")
    with pytest.raises(InputError, match="is not of an exported controller"):
        write_all(tmp_path, {"a.h": "1"})
    assert not (tmp_path / "a.h").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_all(tmp_path / "file", {"a.h": "1"})
    with pytest.raises(InputError, match="real"):
        c_code(sampled("example1"), "drive", real="half")
    assert np.isfinite(c_code(sampled("example1"), period=0.25).system.implementation.period)
    assert c_code(sampled("example1"), period=0.25).system.implementation.period == 0.25

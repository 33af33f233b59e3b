"""The exported C computes what the simulation computes, cleanly, and its own test would tell."""

import ctypes
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import sympy
from conftest import numbers, systems
from depth import depth
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import certrack
from certrack import Implementation, InputError
from certrack.cli import main
from certrack.core.compilers import CompilerError, find_c_compiler
from certrack.core.expressions import symbol
from certrack.export import program as program_module
from certrack.export.c import export as export_module
from certrack.export.c import export_c, simulate_with_c
from certrack.export.c.export import c_files
from certrack.export.c.printer import c_literal, comment, wrapped
from certrack.export.c.readme import readme
from certrack.export.c.source import c_code
from certrack.export.golden_vectors import GOLDEN_TOLERANCE, golden_vectors
from certrack.export.identifiers import C_RESERVED, free_name, stem
from certrack.export.program import sampled_system
from certrack.export.templates import fill_template
from certrack.export.undecided import undecided_jumps
from certrack.laws import Adaptive, leakage
from certrack.loops import controller as loops_controller
from certrack.loops import sampled as loops_sampled
from certrack.loops.energy import motor_numbers, with_motors
from certrack.loops.plant import true_constants
from certrack.systems.writer import field_values

STRICT = (
    "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wshadow -Werror -O2"
).split()
CLANG = "-std=c99 -Weverything -Wno-declaration-after-statement -Wno-padded -Werror -O1".split()
CPPCHECK = (
    "--std=c99 --enable=all --inconclusive --addon=misra --error-exitcode=1 -q "
    "--suppress=missingIncludeSystem --suppress=unusedFunction --suppress=unmatchedSuppression "
    "--suppress=misra-c2012-2.5:*.h"  # the period is for the caller to read
).split()


def needs(tool):
    return pytest.mark.skipif(
        shutil.which(tool) is None, reason=f"NOT TESTED: {tool} is not installed (see .ci/run)"
    )


pytestmark = needs("gcc")

NUMBER = re.compile(r"(?<![\w.])(\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)(F?)\b")

FULL = Implementation(
    period=0.001,
    saturation=(-20, 20),
    rate_limit=1e4,
    velocity=("x2",),
    velocity_filter=0.01,
    update="exact_leak",
)


def fully_implemented(system):
    """With everything that an implementation can have."""
    if not system.controller.states:
        return system.replace(implementation=replace(FULL, update="euler"))
    boxes = ((-3, 3),) * len(system.controller.states)
    return system.replace(implementation=replace(FULL, projection=boxes))


def run(*command, cwd, code=0):
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


def write(folder, code):
    for name, text in c_files(code).items():
        (folder / name).write_text(text)
    return code.name


SOON = {
    ("example1", "plain", "double"),
    ("example1", "full", "float"),
    ("example1-classic", "full", "double"),
    ("dual-motor", "plain", "float"),
    ("dual-motor-lean", "plain", "double"),
}
VARIANTS = [
    pytest.param(variant, marks=() if variant in SOON else pytest.mark.slow, id="-".join(variant))
    for variant in product(
        ("example1", "example1-classic", "dual-motor", "dual-motor-lean"),
        ("plain", "full"),
        ("double", "float"),
    )
]


@pytest.fixture(params=VARIANTS)
def exported(request, tmp_path):
    name, extent, real = request.param
    system = certrack.load(name)
    full = extent == "full"
    system = fully_implemented(system) if full else sampled_system(system, 0.001)
    code = c_code(system, name, real=real)
    write(tmp_path, code)
    return code, tmp_path


class TestCode:
    def test_compiles_strictly_and_passes_its_own_test(self, exported):
        code, folder = exported
        run("gcc", *STRICT, f"{code.name}.c", f"{code.name}_test.c", "-lm", cwd=folder)
        said = run("./a.out", cwd=folder)
        assert "passed" in said and code.name in said

    def test_no_double_in_float_code(self, exported):
        code, _ = exported
        if code.real == "float":
            body = code.source + code.header[code.header.index("*/") :]
            assert "double" not in body
            assert all(match[2] == "F" for match in NUMBER.finditer(body))

    @needs("clang")
    def test_clang_with_every_warning(self, exported):
        code, folder = exported
        run("clang", *CLANG, f"{code.name}.c", f"{code.name}_test.c", "-lm", cwd=folder)
        run("./a.out", cwd=folder)

    @needs("cppcheck")
    def test_cppcheck_with_misra(self, exported):
        code, folder = exported
        run("cppcheck", *CPPCHECK, f"{code.name}.c", cwd=folder)

    def test_sanitizers(self, exported):
        code, folder = exported
        sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
        run("gcc", *sanitize, f"{code.name}.c", f"{code.name}_test.c", "-lm", cwd=folder)
        run("./a.out", cwd=folder)


def test_what_is_not_read_is_not_called_measured():
    code = c_code(fully_implemented(certrack.load("example1")), "example1")
    assert (
        "/* Plant states x, measured: x1, x2;\n * x2: not read; computed from x1.\n */"
        in code.header
    )
    assert "| measured plant states: x1, x2 (not read; computed from x1) |" in readme(code, ())
    plain = c_code(certrack.load("example1"), "example1", period=0.001)
    assert "/* Measured plant states x: x1, x2. */" in plain.header
    assert "not read" not in plain.header + readme(plain, ())


def mutants(text, start=0):
    """The text with one number 0.3 % off, for every number but zero."""
    for match in NUMBER.finditer(text, start):
        if float(match[1]):
            wrong = f"{float(match[1]) * 1.003!r}{match[2]}"
            yield match[0], text[: match.start()] + wrong + text[match.end() :]


def test_every_wrong_number_is_caught(exported):
    code, folder = exported
    name = code.name
    run("gcc", "-c", f"{name}_test.c", "-o", "test.o", cwd=folder)
    found = []
    for number, wrong in mutants(code.source):
        (folder / f"{name}.c").write_text(wrong)
        run("gcc", f"{name}.c", "test.o", "-lm", "-o", "mutant", cwd=folder)
        assert run("./mutant", cwd=folder, code=1), number
        found.append(number)
    assert len(found) >= 9
    (folder / f"{name}.c").write_text(code.source)
    (wrong_period,) = mutants(code.header, code.header.index("*/"))
    (folder / f"{name}.h").write_text(wrong_period[1])
    run("gcc", f"{name}.c", f"{name}_test.c", "-lm", "-o", "mutant", cwd=folder)
    assert run("./mutant", cwd=folder, code=1)


FORMULAS = (
    "0 x1*{z} sin({z})-0.5*x1**3 tanh({z}/0.1) atan2({z},1+x1**2) exp(-x1**2)*{z} log(1+{z}**2) "
    "sqrt(1+x1**2) abs({z}) sign({z}) min(x1,{z},0.5) max(-1,{z}) {z}*abs({z}) asin(0.3*sin(x1)) "
    "acos(0.5*cos({z})) sinh(x1)/cosh(x1) atan({z})**2 tan(0.5*sin(x1)) (1+{z}**2)**0.3 "
    "1/(2+cos({z}))**3 pi*x1 x1**9/(1+x1**8) (x1+{z})**2/3 (1+abs(x1))**1.5"
).split()


@st.composite
def implementations(draw, system):
    r = len(system.controller.states)
    velocity = tuple(name for name in system.plant.states[1:] if draw(st.integers(0, 3)) == 0)
    return Implementation(
        period=draw(st.sampled_from([1e-3, 1e-2, 2.5e-4])),
        saturation=draw(st.sampled_from([None, (-5, 5), (-100, 30)])),
        rate_limit=draw(st.sampled_from([None, 100.0])),
        velocity=velocity,
        velocity_filter=draw(st.sampled_from([0.0, 0.02])) if velocity else 0.0,
        update=draw(st.sampled_from(["euler", "exact_leak"])),
        anti_windup=draw(st.sampled_from(["hold", "none"])),
        projection=draw(st.sampled_from([None, ((-2, 3),) * r])) if r else None,
    )


@st.composite
def controllers(draw):
    system = draw(systems(orders=st.integers(1, 6)))
    last = system.plant.states[-1]
    formulas = st.sampled_from([text.format(z=last) for text in FORMULAS])
    plant = replace(
        system.plant,
        drift=f"{draw(formulas)} + {draw(numbers(0.1, 3))}*({draw(formulas)})",
        regressor=[draw(formulas) for _ in range(system.plant.r)],
    )
    system = system.replace(plant=plant)
    return system.replace(implementation=draw(implementations(system)))


def worst(library, code):
    """Largest deviation of compiled code over its scale, at thousands of points."""
    kind = np.dtype("float32" if code.real == "float" else "float64")
    vectors = golden_vectors(code.system, code.program, code.real, thin=False)
    step = getattr(library, f"{code.name}_step")
    step.argtypes = [ctypes.c_void_p] * 3
    step.restype = ctypes.c_float if code.real == "float" else ctypes.c_double
    found = np.empty_like(vectors.answers)
    for k in range(found.shape[1]):
        s, x, y = (
            np.ascontiguousarray(part[:, k], dtype=kind)
            for part in (vectors.states, vectors.x, vectors.Y)
        )
        s = np.append(s, kind.type(0))
        found[0, k] = step(s.ctypes.data, x.ctypes.data, y.ctypes.data)
        found[1:, k] = s[:-1]
    deviations = np.abs(found - vectors.answers) / vectors.scales
    assert np.isfinite(deviations).all()
    return deviations.max()


def smallest_number(system):
    """The least coefficient of a controller that is not zero."""
    plant = system.plant
    values = np.abs([*plant.g, *plant.b.flat, *system.controller.values])
    return values[values > 0].min()


def turns_by_rounding(system):
    """Whether a sign may stand on what only a vanishing coefficient, or rounding, keeps from zero.

    Where a speed cancels to zero, 1e-241 x_2 decides on its sign, and not in both codes alike.
    """
    formulas = [system.plant.drift, *system.plant.regressor]
    return smallest_number(system) < 1e-9 and any(f.expr.has(sympy.sign) for f in formulas)


def reals(system):
    """Float only where its numbers do not underflow."""
    return ("double",) if smallest_number(system) < 1e-9 else ("double", "float")


def agree(folder, drawn):
    codes = [
        c_code(system, f"c{i}_{real}", real=real)
        for i, system in enumerate(drawn)
        if not turns_by_rounding(system)
        for real in reals(system)
    ]
    for code in codes:
        (folder / f"{code.name}.h").write_text(code.header)
        (folder / f"{code.name}.c").write_text(code.source)
    assume(codes)
    sources = [f"{code.name}.c" for code in codes]
    flags = [*STRICT, "-ffp-contract=off", "-shared", "-fPIC"]
    run("gcc", *flags, *sources, "-o", "all.so", "-lm", cwd=folder)
    library = ctypes.CDLL(str(folder / "all.so"))
    for code in codes:
        assert worst(library, code) <= GOLDEN_TOLERANCE[code.real], (
            code.system.implementation,
            code.source,
        )


def batches(examples):
    def decorate(test):
        several = st.lists(controllers(), min_size=4, max_size=4)
        return settings(max_examples=examples)(given(drawn=several)(test))

    return decorate


@batches(2)
def test_random_controllers_agree(tmp_path_factory, drawn):
    agree(tmp_path_factory.mktemp("c"), drawn)


@pytest.mark.slow
@batches(depth(8, 100))
def test_many_random_controllers_agree(tmp_path_factory, drawn):
    agree(tmp_path_factory.mktemp("c"), drawn)


HOSTILE = 'ends here */ int x; /* ??/ // \\\\ "quoted"'


@pytest.mark.parametrize(("name", "functions"), [("dual-motor-lean", False), ("example1", True)])
def test_only_what_is_used_is_included_and_comments_are_of_c90(name, functions):
    code = c_code(certrack.load(name), "kept", period=0.001)
    assert ("#include <math.h>" in code.source) == functions
    assert "//" not in code.header + code.source


class TestText:
    def test_a_template_and_its_values_fit(self):
        names = ("name", "header", "part", "step", "token", "kept", "period", "start")
        values = dict.fromkeys(names, "v")
        assert "#define model_init v_init" in fill_template("fmu/templates/model.h", **values)
        with pytest.raises(KeyError, match="no place for other"):
            fill_template("fmu/templates/model.h", **values, other=1)
        del values["token"]
        with pytest.raises(KeyError, match="token"):
            fill_template("fmu/templates/model.h", **values)

    def test_the_system_text_cannot_leave_its_comment(self, tmp_path):
        system = sampled_system(certrack.load("example1"), 0.01).replace(title=HOSTILE)
        code = c_code(system, "hostile")
        assert code.header.index("*/") == code.header.index("*/\n\n#ifndef")
        write(tmp_path, code)
        run("gcc", *STRICT, "hostile.c", "hostile_test.c", "-lm", cwd=tmp_path)

    @pytest.mark.parametrize("text", ["*/", "/*", "**/", "//*/", "/*/", "??/", "*" * 5 + "/" * 5])
    def test_comments_are_plain(self, text):
        body = comment([text, f"é{text}é"]).removeprefix("/*\n").removesuffix(" */\n")
        assert not re.search(r"\*/|/\*|//|\?\?", body)
        assert body.isascii()

    @pytest.mark.parametrize(
        ("source", "name"),
        [
            ("plants/dual-motor.toml", "dual_motor"),
            ("2 axes.toml", "c_2_axes"),
            ("Antrieb ü.toml", "Antrieb"),
            ("...", "c"),
            ("math.toml", "math_c"),
            ("x" * 80, "x" * 24),
        ],
    )
    def test_names_are_identifiers(self, source, name):
        assert stem(source) == name
        assert re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII)

    def test_reserved_names_get_another(self):
        assert free_name("double", ()) == "double_"
        assert free_name("s", {"s", "s_"}) == "s__"
        assert all(free_name(name, ()) not in C_RESERVED for name in C_RESERVED)

    def test_states_may_be_called_anything(self, tmp_path):
        names = ("x", "s", "y1", "double", "h", "advance")
        system = certrack.loads(
            f"""
            title = "awkward names"
            [plant]
            states = {list(names)}
            chain = [1, 1, 1, 1, 1]
            drift = "gamma*sin(advance)*x + sqrt(1 + s**2) + double"
            regressor = ["y1*h"]
            gain_sign = 1
            [plant.constants]
            gamma = 0.3
            [truth]
            input_gain = 1
            theta = [1]
            [reference]
            signal = "sin(t)"
            [law]
            kind = "adaptive"
            c = [1, 1, 1, 1, 1, 1]
            [simulation]
            x0 = [0, 0, 0, 0, 0, 0]
            duration = 1
            [implementation]
            period = 0.01
            """
        )
        name = write(tmp_path, c_code(system, "awkward"))
        run("gcc", *STRICT, f"{name}.c", f"{name}_test.c", "-lm", cwd=tmp_path)
        run("./a.out", cwd=tmp_path)

    @pytest.mark.parametrize(
        ("value", "real", "text"),
        [(0.1, "float", "0.1F"), (0.1, "double", "0.1"), (1e-7, "float", "1e-07F")],
    )
    def test_literals_round_trip(self, value, real, text):
        assert c_literal(value, real) == text

    def test_numbers_beyond_float_are_refused(self):
        with pytest.raises(InputError, match="float cannot hold the number 1e\\+40"):
            c_literal(1e40, "float")

    def test_long_statements_are_wrapped(self, exported):
        code, _ = exported
        assert max(map(len, code.source.splitlines())) <= 100
        text = "const real u = f(a, b) + " + " + ".join(f"(g{i} * h{i})" for i in range(40)) + ";"
        assert " ".join(wrapped(text).split()) == text

    def test_same_text_whatever_the_hash_seed(self, tmp_path):
        texts = set()
        for seed in ("1", "2"):
            out = tmp_path / seed
            command = ["certrack", "export", "c", "example1", "--period", "1e-3", "--out", str(out)]
            program = f"from certrack.cli import main; main({command[1:]!r})"
            environment = {**os.environ, "PYTHONHASHSEED": seed}
            subprocess.run([sys.executable, "-c", program], env=environment, check=True)
            texts.add("".join(path.read_text() for path in sorted(out.iterdir())))
        assert len(texts) == 1

    def test_a_law_that_uses_its_signals_in_its_own_way_is_printed_as_it_is(self, tmp_path):
        class Own(Adaptive):
            def equations(self, s):
                found = super().equations(s)
                return replace(found, u=found.u + sympy.diff(s.phi[0], s.x[0]) * s.e_n)

        system = sampled_system(certrack.load("example1"), 0.001)
        law = Own(**field_values(system.law))
        code = c_code(system.replace(law=law), "own")
        assert "e_n" not in code.source
        name = write(tmp_path, code)
        run("gcc", *STRICT, f"{name}.c", f"{name}_test.c", "-lm", cwd=tmp_path)
        run("./a.out", cwd=tmp_path)


class TestCommand:
    def go(self, capsys, *arguments):
        with pytest.raises(SystemExit) as stopped:
            main(["export", "c", *map(str, arguments)])
        return stopped.value.code, *capsys.readouterr()

    def test_writes_five_files(self, tmp_path, capsys):
        out = tmp_path / "new" / "firmware"
        code, said, errors = self.go(
            capsys, "example1", "--period", 1e-3, "--real", "float", "--out", out, "--json"
        )
        assert (code, errors) == (0, "")
        found = json.loads(said)
        assert found["name"] == "example1"
        wanted = {"example1.h", "example1.c", "example1_guard.h", "example1_test.c", "README.md"}
        assert {path.name for path in out.iterdir()} == wanted
        assert self.go(capsys, "example1", "--period", 1e-3, "--out", out)[0] == 0  # again

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["example1"], "implementation: is missing. Add a table [implementation] or give"),
            (["example1", "--period", "-1"], "--period: must be positive; got -1.0"),
            (["example1", "--period", "1e-9"], "makes more than"),
            (["nothing", "--period", "1"], "neither a file nor a shipped system"),
        ],
    )
    def test_wrong_input_is_one_line(self, tmp_path, capsys, arguments, message):
        code, said, errors = self.go(capsys, *arguments, "--out", tmp_path / "out")
        assert (code, said) == (2, "")
        assert message in errors and errors.count("\n") == 1
        assert not (tmp_path / "out").exists()

    def test_nothing_is_left_where_it_cannot_write(self, tmp_path, capsys):
        (tmp_path / "example1.c").mkdir()
        code, _, errors = self.go(capsys, "example1", "--period", 1, "--out", tmp_path)
        assert code == 2 and "cannot be written" in errors
        assert [path.name for path in tmp_path.iterdir()] == ["example1.c"]

    def test_the_readme_of_a_stranger_stays(self, tmp_path, capsys):
        (tmp_path / "README.md").write_text("mine")
        code, _, errors = self.go(capsys, "example1", "--period", 1, "--out", tmp_path)
        assert code == 2 and "is not of an exported controller" in errors
        assert (tmp_path / "README.md").read_text() == "mine"

    @pytest.mark.parametrize("real", ["double", "float"])
    def test_everything_is_built_once(self, tmp_path, monkeypatch, real):
        built = Counter()

        def counted(module, name):
            original = getattr(module, name)

            def function(*arguments, **more):
                built[name] += 1
                return original(*arguments, **more)

            for other in list(sys.modules.values()):
                if vars(other).get(name) is original:
                    monkeypatch.setattr(other, name, function)

        counted(loops_controller, "sampled_controller")
        counted(leakage, "leak_matrix")
        counted(loops_sampled, "sample_loop")
        counted(program_module, "controller_program")
        counted(export_module, "golden_vectors")
        counted(export_module, "readme")
        export_c(certrack.load("example1"), tmp_path, period=0.01, real=real)
        once = {
            "sampled_controller",
            "sample_loop",
            "controller_program",
            "golden_vectors",
            "readme",
        }
        assert built == Counter(once | ({"leak_matrix"} if real == "float" else set()))

    def test_period_of_the_command_wins(self, tmp_path):
        system = certrack.load("example1").replace(implementation=FULL)
        assert c_code(system, period=0.5).system.implementation == replace(FULL, period=0.5)

    def test_float_stalls_are_told(self, tmp_path, capsys):
        arguments = ["example1", "--real", "float", "--out", tmp_path, "--period"]
        assert self.go(capsys, *arguments, 1e-3)[2] == ""
        assert "estimates stall up to" in self.go(capsys, *arguments, 1e-4)[2]
        assert "estimates stall up to" in (tmp_path / "README.md").read_text()


class TestInTheLoop:
    @pytest.mark.parametrize("full", [False, True], ids=["plain", "full"])
    @pytest.mark.parametrize("name", ["example1", "example1-classic", "dual-motor-lean"])
    def test_agrees_with_the_run_in_python(self, name, full):
        system = certrack.load(name).with_settings(duration=3.0, tail=None)
        system = fully_implemented(system) if full else sampled_system(system, 0.002)
        system = system.replace(implementation=replace(system.implementation, delay=0.5))
        ours, theirs = certrack.simulate(system).dataset(), simulate_with_c(system).dataset()
        for variable in ours.data_vars:
            a, b = ours[variable].values, theirs[variable].values
            assert np.abs(a - b).max() <= 1e-12 * (1 + np.abs(a).max()), variable

    def test_command(self, tmp_path, capsys):
        path = tmp_path / "sampled.toml"
        system = sampled_system(certrack.load("example1"), 0.01)
        certrack.save(system, path)
        results = []
        for more in ([], ["--with-c"]):
            with pytest.raises(SystemExit) as stopped:
                main(["simulate", str(path), "--json", *more])
            assert stopped.value.code == 0
            results.append(json.loads(capsys.readouterr().out))
        assert results[0]["final_state"] == pytest.approx(results[1]["final_state"], rel=1e-12)
        assert [found["controller"] for found in results] == ["python", "c"]
        assert results[1]["difference_from_python"] < 1e-12 * results[1]["peak_input"]
        with pytest.raises(SystemExit):
            main(["simulate", str(path), "--with-c"])
        said = capsys.readouterr().out
        assert "controller: the exported C, compiled by" in said
        assert "largest difference of u from Python: " in said

    def test_needs_an_implementation_and_a_compiler(self, capsys, monkeypatch):
        with pytest.raises(InputError, match="only a sampled controller runs as C. Add a table"):
            simulate_with_c(certrack.load("example1"))
        monkeypatch.setenv("PATH", "")
        with pytest.raises(CompilerError, match="no C compiler was found: install gcc"):
            find_c_compiler()


class TestUndecided:
    """Points where a sign stands on what rounding, or absorption, leaves of terms that cancel."""

    def points(self, formula, x, y=0.0, p=1.0):
        symbols = sympy.symbols("x y p", real=True)
        inputs = [np.atleast_2d(np.array(x, dtype=float)), np.full((1, len(x)), y)]
        arguments = [[symbols[0]], [symbols[1]], [symbols[2]]]
        formula = sympy.sympify(formula, {s.name: s for s in symbols})
        return undecided_jumps([formula], arguments, inputs, np.array([p]), "double").tolist()

    def test_a_difference_that_cancels(self):
        assert self.points("sign(x - y)", [1.0, 1.0 + 1e-15, 1.1, 0.0], y=1.0) == [
            True,
            True,
            False,
            False,
        ]

    def test_a_tiny_coefficient_beside_terms_that_cancel_for_any_input(self):
        formula = "sign(x + p*(0 - x) - y/10**241)"
        assert self.points(formula, [3.0, 0.0], y=1.0) == [True, False]

    def test_zero_without_terms_and_what_is_continuous_are_decided(self):
        assert self.points("sign(x)", [0.0, 1e-300]) == [False, False]
        assert self.points("Abs(x - y) + x", [1.0], y=1.0) == [False]

    def test_golden_vectors_leave_them_out(self, tmp_path):
        system = certrack.load("example1")
        plant = replace(system.plant, linear=[["1e-129"]], drift="sign(x2) + x1")
        turning = system.replace(
            plant=plant, implementation=Implementation(0.001, velocity=("x2",))
        )
        code = c_code(turning, "turns")
        write(tmp_path, code)
        run("gcc", "-shared", "-fPIC", "turns.c", "-o", "all.so", "-lm", cwd=tmp_path)
        assert worst(ctypes.CDLL(str(tmp_path / "all.so")), code) <= GOLDEN_TOLERANCE["double"]


SPLIT_TEST = """
#include "servo_split.h"
#include <stdio.h>
int main(void)
{
    const servo_real given[3][3] = {{1, 2, 5}, {-4, 3, 3}, {0.5, -1, 2}};
    for (int i = 0; i < 3; i++) {
        servo_real u_each[2];
        servo_split(given[i][0], given[i][1], given[i][2], u_each);
        printf("%.17g %.17g\\n", (double)u_each[0], (double)u_each[1]);
    }
    return 0;
}
"""


@needs("gcc")
@pytest.mark.parametrize("real", ["double", "float"])
def test_two_motors_share_the_input_as_in_the_simulation(real, tmp_path):
    """Commands times torque per input are the torques of the simulated plant."""
    base = with_motors(certrack.load("dual-motor-physical"), share=0.625, damping=0.05)
    write(tmp_path, c_code(base, "servo", real=real, period=0.001))
    (tmp_path / "main.c").write_text(SPLIT_TEST.replace("0.5, -1", "0.5f, -1"))
    subprocess.run(["gcc", *STRICT, "main.c", "-o", "split"], cwd=tmp_path, check=True)
    printed = subprocess.run(["./split"], cwd=tmp_path, capture_output=True, text=True, check=True)
    found = [[float(value) for value in line.split()] for line in printed.stdout.splitlines()]
    u, one, two = symbol("u"), symbol("om_1"), symbol("om_2")
    torques = base.truth.motors.torque_formulas(u).values()
    for commands, values in zip(found, [(1, 2, 5), (-4, 3, 3), (0.5, -1, 2)], strict=True):
        known = dict(zip((u, one, two), values, strict=True))
        known |= {symbol(name): value for name, value in true_constants(base).items()}
        gains = motor_numbers(base).torque_per_input
        for command, torque, gain in zip(commands, torques, gains, strict=True):
            expected = float(torque.subs(known))
            assert gain * command == pytest.approx(expected, rel=1e-6 if real == "float" else 1e-14)
    assert sum(found[0]) == pytest.approx(1.0, rel=1e-6)


def test_a_system_without_motors_has_no_share():
    files = c_files(c_code(certrack.load("example1"), "drive", period=0.001))
    assert not any(name.endswith("_split.h") for name in files)

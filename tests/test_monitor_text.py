"""The printed monitors, word for word: a change of them is a change of these files."""

import re
from pathlib import Path

import numpy as np
import pytest
import sympy
from exported import sampled
from test_monitor import FREE, FULL

from certrack.core.select import Select, clamp, larger, magnitude, smaller
from certrack.export.c.export import controller_files
from certrack.export.c.monitor import monitored
from certrack.export.c.monitor_checks import _probe_table, monitor_checks
from certrack.export.c.printer import CPrinter, c_literal
from certrack.export.c.source import c_code
from certrack.export.fmu.monitored import monitored_header, monitored_variables
from certrack.export.monitor import Flag, Within
from certrack.export.monitor_probes import MonitorProbes
from certrack.export.st.function_block import structured_text

TEXTS = Path(__file__).parent / "data" / "monitors"
OPTIONS = {"full": FULL, "free": FREE}


def printed(name, language):
    """The monitor of a drive with everything, or with little."""
    limits, monitor = OPTIONS[name]
    system = sampled("example1", **limits)
    if language == "st":
        return structured_text(system, "drive", monitor=monitor)
    real = "float" if language == "float.h" else "double"
    return controller_files(c_code(system, "drive", real=real, monitor=monitor))["drive_monitor.h"]


def probes(count, program, monitor):
    """Samples of short numbers that all differ, in the place of those of the acceptance test."""

    def numbers(rows, first):
        return first + np.arange(float(count * rows)).reshape(rows, count) / 4

    expected = np.array([[(i + k) % 3 for k in range(count)] for i in range(len(monitor.flags))])
    x, Y, states = (
        numbers(len(part), first)
        for part, first in ((program.measured, 100), (program.Y, 200), (program.states, 300))
    )
    before = np.linspace(-1.25, 7.5, count)
    return MonitorProbes(x, Y, states, before, expected)


def two_probes(system, program, monitor, vectors, real):
    return probes(2, program, monitor)


def printed_around(name, language, monkeypatch):
    """The acceptance test of a monitor, and what an FMU has for it."""
    monkeypatch.setattr("certrack.export.c.monitor_checks.monitor_probes", two_probes)
    limits, monitor = OPTIONS[name]
    code = c_code(sampled("example1", **limits), "drive", monitor=monitor)
    if language == "checks.c":
        return monitor_checks(code, None)
    variables = "".join(f"{variable}\n" for variable in monitored_variables(code))
    return monitored_header(code) + variables


@pytest.mark.parametrize("language", ["checks.c", "fmu"])
@pytest.mark.parametrize("name", OPTIONS)
def test_the_text_around_a_monitor(name, language, monkeypatch):
    kept = TEXTS / f"{name}.{language}.txt"
    assert printed_around(name, language, monkeypatch) == kept.read_text()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_every_probe_has_its_initialiser(count):
    """However many there are of each signal: state, input before, measured, reference, flags."""
    limits, monitor = FULL
    code = c_code(sampled("example1", **limits), "drive", monitor=monitor)
    made = probes(count, code.program, monitored(code))
    rows = re.findall(r"\{[^{}]*\}", _probe_table(code, made))
    assert len(rows) == 4 * count
    for k in range(count):
        states, x, Y, expected = rows[4 * k : 4 * k + 4]
        for row, part in ((states, made.states), (x, made.x), (Y, made.Y)):
            numbers = [float(v) for v in row.strip("{}").split(",")]
            assert numbers == part[:, k].tolist()
        assert [int(v) for v in expected.strip("{}").split(",")] == made.expected[:, k].tolist()
    text = _probe_table(code, made)
    assert [text.count(c_literal(float(v), "double")) > 0 for v in made.before] == [True] * count


def test_without_a_monitor_an_fmu_has_no_variable_of_it():
    assert monitored_variables(c_code(sampled("example1"), "drive")) == []


@pytest.mark.parametrize("language", ["h", "float.h", "st"])
@pytest.mark.parametrize("name", OPTIONS)
def test_the_text_of_a_monitor(name, language):
    kept = TEXTS / f"{name}.{language}.txt"
    assert printed(name, language) == kept.read_text()


def test_a_flag_watches_nothing_unless_it_says_so():
    flag = Flag("name", "meaning")
    assert flag.premises == () and flag.of_command is False and flag.always is False
    assert Within(sympy.S.Zero, sympy.S.Zero, sympy.S.One).strict is False


def test_selections_in_c_are_the_helpers_with_their_arguments_in_order():
    """Of two equal numbers, and where one is none, the helper gives what the selection does."""
    a, b, c = symbols = sympy.symbols("a b c", real=True)
    printer = CPrinter({name: name.name for name in symbols}, "double", [])
    assert printer.text(larger(a, b)) == "larger(a, b)"
    assert printer.text(smaller(a, b)) == "smaller(a, b)"
    assert printer.text(Select(a, b, b, a)) == "smaller(b, a)"
    assert printer.text(clamp(b, a, c)) == "clamp(b, a, c)"
    assert printer.text(magnitude(a)) == "fabs(a)"
    assert printer.text(Select(a, b, c, a)) == "(a > b) ? c : a"
    assert printer.text(sympy.sign(a)) == "sign(a)"
    assert printer.helpers == {"larger", "smaller", "clamp", "sign"}
    assert printer.calls

"""Controllers with rules that try gains: C and Structured Text compute what we simulate."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from exported import PythonController, along_a_run
from test_export_c import STRICT, write
from test_export_fmu import VERSIONS, Imported, inputs, written
from test_export_st import compare, passes
from test_seeking import RULES, moving

import certrack
from certrack.core.compilers import c_compilers
from certrack.export.c import simulate_with_c
from certrack.export.c.source import c_code
from certrack.export.golden_vectors import GOLDEN_TOLERANCE, golden_vectors
from certrack.export.program import controller_program
from certrack.export.st.function_block import structured_text
from certrack.laws.seeking import NO_COST

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")

#: A quick dither, so that a short run has several of its periods, and all own states move.
QUICK = {"frequency": 4.0, "speed": 2.0}


def system_of(kind, rate=None, limit=None, duration=1.0):
    """The dual motor whose rule is quick, begun away from where its states would stay."""
    system = moving(duration, rate=rate, **(RULES[kind] | QUICK))
    drive = system.implementation
    if limit is not None:
        drive = certrack.Implementation(
            period=drive.period, noise=drive.noise, saturation=(-limit, limit)
        )
    begin = [0.3 / (i + 1) for i in range(len(system.controller.states))]
    begin[1] = 1e-4  # a mean of squares
    system = system.replace(implementation=drive)
    return system.with_settings(estimates=begin, x0=(0.01, 0.0, 0.02, 0.0))


CASES = [
    ("extremum", None, None),
    ("spsa", None, None),
    pytest.param("extremum", 2.0, 0.5, marks=pytest.mark.slow),
    pytest.param("spsa", 2.0, 0.5, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("kind", "rate", "limit"), CASES)
def test_what_is_compared_does_move(kind, rate, limit):
    """A comparison of controllers at rest would tell nothing."""
    system = system_of(kind, rate, limit)
    controller, states = PythonController(system), []
    for x, Y in zip(*along_a_run(system), strict=True):
        controller.step(x, Y)
        states.append(controller.state)
    moved = np.ptp(np.array(states)[:, : len(system.controller.states)], axis=0)
    assert (moved > 1e-7).all()


@pytest.mark.parametrize(("kind", "rate", "limit"), CASES)
def test_structured_text(kind, rate, limit):
    worst, _ = compare(system_of(kind, rate, limit), "seeking", within=1e-12)
    assert worst < 1e-12


@pytest.mark.parametrize(("kind", "rate", "limit"), CASES)
def test_c_along_a_run(kind, rate, limit):
    """The compiled controller in closed loop is the simulation."""
    system = system_of(kind, rate, limit)
    ours, of_c = certrack.simulate(system), simulate_with_c(system)
    t = system.implementation.period * np.arange(int(system.settings.duration / 0.002))
    np.testing.assert_allclose(
        of_c.trajectory.interpolate(t), ours.trajectory.interpolate(t), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(of_c.u, ours.u, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(("kind", "rate", "limit"), CASES)
def test_c_compiles_strictly_and_passes_its_golden_vectors(kind, rate, limit, real, tmp_path):
    system = system_of(kind, rate, limit)
    name = write(tmp_path, c_code(system, "seeking", real=real))
    files = [f"{name}.c", f"{name}_test.c"]
    for command in (["gcc", *STRICT, *files, "-lm"], ["./a.out"]):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    assert "passed" in done.stdout
    assert GOLDEN_TOLERANCE["double"] <= 1e-12


#: What a rule needs beside itself: nothing, a bounded rate and a limited input, both.
FMU_CASES = [("extremum", None, None), ("spsa", None, 0.2), ("extremum", 2.0, 0.2)]


@pytest.mark.skipif(not c_compilers(), reason="FMUs need a C compiler")
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(("kind", "rate", "limit"), FMU_CASES)
def test_fmu_along_a_run(kind, rate, limit, version, tmp_path):
    """An importer that steps the FMU gets what the simulation's own controller answers."""
    system = system_of(kind, rate, limit, duration=0.6)
    path = written(system, version, tmp_path, "seeking")
    controller, ours = Imported(path, version, tmp_path), PythonController(system)
    period, deviation, moved = system.implementation.period, 0.0, []
    for k, (x, Y) in enumerate(zip(*along_a_run(system), strict=True)):
        controller.set(inputs(system, x, Y))
        u = controller.step(k * period, period)
        moved.append(expected := ours.step(x, Y))
        deviation = max(deviation, abs(u - expected) / max(1.0, abs(expected)))
    controller.close()
    assert deviation < 1e-11
    assert np.ptp(moved) > 0.05 and (limit is None or max(map(abs, moved)) == limit)


#: Each rule with and without a bounded rate and a limited input.
BLIND_CASES = [
    (kind, rate, limit)
    for kind in ("extremum", "spsa")
    for rate in (None, 2.0)
    for limit in (None, 0.5)
]


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(("kind", "rate", "limit"), BLIND_CASES)
def test_golden_vectors_see_every_number_of_a_rule(kind, rate, limit, real):
    """But for the one below the quotient, which counts where there is no cost at all."""
    system = system_of(kind, rate, limit)
    vectors = golden_vectors(system, controller_program(system), real)
    assert vectors.blind == (f"{float(NO_COST):g}",)


@pytest.mark.parametrize(("kind", "rate", "limit"), BLIND_CASES)
def test_a_rule_with_a_wrong_number_fails_its_vectors(kind, rate, limit):
    """Each number of the rule's own, 0.3 % larger in the Structured Text."""
    system = system_of(kind, rate, limit)
    text = structured_text(system)
    vectors = golden_vectors(system, controller_program(system), "double")
    assert passes(text, vectors)
    for name in system.law.online.numbers:
        found = re.search(rf"\b{name} : LREAL := ([0-9.E-]+);", text)
        assert found is not None, name
        wrong = f"{float(found[1]) * 1.003!r}"
        assert not passes(text[: found.start(1)] + wrong + text[found.end(1) :], vectors), name

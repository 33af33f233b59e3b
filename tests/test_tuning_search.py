"""The search of a tuning: ranges by floats, smooth limits, and what an ended search keeps."""

import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from scipy.optimize import direct, minimize_scalar
from test_tuning import candidate_of, differences

import certrack
from certrack.certificates.estimates.loop_data import in_plant_coordinates
from certrack.certificates.estimates.peak_gains import peak_estimate
from certrack.certificates.ranges.certify import range_prover
from certrack.cli import console, progress_lines
from certrack.cli.surroundings import TERMINATED_CODE, kept_at_termination
from certrack.core.progress import AT_ONCE
from certrack.reports.runs import metrics_table, shared_units
from certrack.simulation.metrics import METRIC_LABELS
from certrack.tuning import tune as module
from certrack.tuning.candidate import Candidate
from certrack.tuning.families import RobustFamily
from certrack.tuning.problem import Requirements
from certrack.tuning.quantities import log_of
from certrack.tuning.ranged import RangedError
from certrack.tuning.responses import BoxPeak, BoxResponse, Grid, LinearPlant, PartPeak
from certrack.tuning.search import GainSearch
from certrack.tuning.stages import searches_of


def ranged_point(name, shift):
    system = certrack.load(name).replace(implementation=None)
    family = RobustFamily(system, system.law.feedforward)
    base = system.replace(law=family.law(family.start))
    return Candidate(family, base, family.start + shift * np.cos(np.arange(len(family.start))))


@pytest.mark.parametrize("name", ["axis", "flexible-joint"])
def test_corners_of_ranges_are_those_of_the_exact_problems(name):
    """For other gains than those that the formulas were evaluated with, too."""
    error = RangedError(ranged_point(name, 0.0).base)
    for shift in (0.0, 0.4):
        point = ranged_point(name, shift)
        prover = range_prover(point.system)
        exact = [
            peak_estimate(in_plant_coordinates(problem.in_floats()), gradient=False).bound
            for problem in prover.problems(prover.box)
        ]
        assert error.value(point) == pytest.approx(max(exact), rel=1e-9)


@pytest.mark.slow
def test_an_optimum_of_estimates_is_not_improved_by_a_global_search():
    """SciPy's `direct` about the gains and the decay rate, with the same limits as penalties."""
    system = certrack.load("example1")
    tuned = certrack.tune(system, peak_input=15.9, feedforward=1, starts=1).system
    (stage,) = searches_of(tuned, Requirements(peak_input=15.9), "error", None, 1)
    problem, family = stage.problem, stage.family

    def penalised(v):
        each = Candidate(family, problem.base, v)
        excess = max(limit.excess(each) for limit in problem.task.limits)
        return log_of(problem.error, each) + 100 * max(0.0, excess)

    centre = family.start.copy()  # of a law, which has no decay rate: that is found first
    ends = (family.low[-1], family.high[-1])
    centre[-1] = minimize_scalar(lambda s: penalised([*centre[:-1], s]), bounds=ends).x
    best = penalised(centre)
    assert math.exp(best) <= 0.0455
    bounds = list(zip(centre - 0.4, np.minimum(centre + 0.4, family.high), strict=True))
    assert direct(penalised, bounds, maxfun=300).fun >= best - 1e-3


@pytest.mark.parametrize("name", ["axis", "flexible-joint"])
def test_gradient_of_the_worst_corner(name):
    point = ranged_point(name, 0.2)
    error = RangedError(point.base)

    def log_error(v):
        return math.log(error.value(Candidate(point.family, point.base, v)))

    expected = differences(log_error, point.v, 1e-4)
    assert np.abs(error.log_gradient(point) - expected).max() < 5e-4 * np.abs(expected).max()


def chain(n):
    uncertainty = certrack.Uncertainty([0] * (n - 1) + [1], [1e-4] * n, [0.1] * n)
    return certrack.System(
        plant=certrack.Plant(
            states=[f"x{i}" for i in range(1, n + 1)],
            chain=[1] * (n - 1),
            input_gain=1,
            uncertainty=uncertainty,
        ),
        law=certrack.Robust(c=[3] * n, feedforward=1),
        reference=certrack.SymbolicReference("0.2*cos(t)"),
        truth=certrack.Truth(1),
        settings=certrack.Settings([0] * n, 10),
    )


class TestPeakInParts:
    def test_the_largest_part_is_the_peak(self):
        point = candidate_of(certrack.load("dual-motor-lean"))
        box = np.array([[-1.0, 0.5]] * 4)
        response = BoxResponse(LinearPlant.of(point.base), Grid.of(point.base), box)
        parts = [part.value(point) for part in PartPeak.every(response, point)]
        assert len(set(parts)) == len(parts) == 10
        assert max(parts) == BoxPeak(response).value(point)

    def test_a_kink_of_the_peak_does_not_hold_the_search_up(self):
        """At the optimum the input from the middle of the box begins at zero."""
        wanted = Requirements(peak_input=80.6, box=[(-0.2, 0.2)] * 4)
        (stage,) = searches_of(chain(4), wanted, "error", None, None)
        search = GainSearch(stage.problem.base, stage.problem.task)
        search.run(stage.family, stage.family.start)
        assert stage.problem.error.programs <= 15
        assert math.exp(search.state.score) < 0.0219


def test_an_ended_search_writes_at_once(monkeypatch):
    """SIGTERM is no time for figures, which take minutes; what is best is kept."""

    def measured(*_):
        raise AssertionError("nothing is measured")

    def end(done, total, best):
        if best is not None:
            raise KeyboardInterrupt(AT_ONCE)

    monkeypatch.setattr(module, "figures_of", measured)
    system = certrack.load("dual-motor-lean")
    found = certrack.tune(system, peak_input=39.1, progress=end)
    assert found.stopped and math.isnan(found.after.certified) and not found.active
    assert certrack.estimate(found.system).bound <= certrack.estimate(system).bound


class TestTermination:
    kept = False

    def test_becomes_an_exception_and_a_code(self):
        before = signal.getsignal(signal.SIGTERM)
        with pytest.raises(SystemExit) as ended:
            self.searched_until_the_signal()
        assert self.kept and ended.value.code == TERMINATED_CODE
        assert signal.getsignal(signal.SIGTERM) is before

    def searched_until_the_signal(self):
        with kept_at_termination():
            try:
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(5)
            except KeyboardInterrupt:
                self.kept = True

    def test_before_anything_is_found(self):
        with pytest.raises(SystemExit) as ended, kept_at_termination():
            raise KeyboardInterrupt(AT_ONCE)
        assert ended.value.code == TERMINATED_CODE

    def test_without_a_signal_nothing_ends(self):
        with kept_at_termination():
            pass


class TestProgressLines:
    def test_come_without_a_terminal(self, capsys, monkeypatch):
        monkeypatch.setattr(progress_lines, "SECONDS_BETWEEN_LINES", 0.01)
        with console.progress("Tuning, starts", "best", "now finished") as advance:
            advance(1, 2, 0.0123)
            time.sleep(0.3)
            advance(2, 2, 0.0123)
            time.sleep(0.3)
        lines = capsys.readouterr().err.splitlines()
        assert "certrack: Tuning, starts 1 of 2, best 0.0123, after 0 s" in lines
        assert any("2 of 2, best 0.0123, now finished, after" in line for line in lines)

    def test_name_the_step_at_work(self, capsys, monkeypatch):
        monkeypatch.setattr(progress_lines, "SECONDS_BETWEEN_LINES", 0.01)
        with console.progress("Step", at="part {}".format) as advance:
            advance(1, 2, None)
            time.sleep(0.3)
        assert "certrack: Step 1 of 2, part 1, after 0 s" in capsys.readouterr().err.splitlines()

    def test_a_short_call_says_nothing(self, capsys, monkeypatch):
        monkeypatch.setattr(progress_lines, "SECONDS_BETWEEN_LINES", 100.0)
        with console.rate_progress("Members") as advance:
            advance(1, 2, None)
        assert not capsys.readouterr().err


def test_an_interruption_while_the_command_line_is_loaded_is_one_line():
    program = (
        "import builtins, os, signal\n"
        "from certrack.__main__ import launch\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "load = builtins.__import__\n"
        "def interrupted(name, *args, **kwargs):\n"
        "    if name == 'certrack.cli':\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    return load(name, *args, **kwargs)\n"
        "builtins.__import__ = interrupted\n"
        "launch()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=120)
    assert (done.returncode, done.stdout) == (130, b"")
    assert done.stderr == b"certrack: interrupted\n"


def test_an_effort_that_is_none():
    with pytest.raises(certrack.InputError, match="effort"):
        certrack.falsify(certrack.load("axis"), effort="some")


def test_tables_have_the_units_of_the_plant():
    summary = dict.fromkeys(METRIC_LABELS, 1.5) | {"outcome": "finished", "integrator": "taylor"}
    units = ("rad", "rad/s", "N m")

    def labels(units):
        return [row[0] for row in metrics_table({"mine": summary}, units).rows]

    for label in ("tail error [rad]", "integral of |e_1| [rad s]", "input energy [(N m)^2 s]"):
        assert label in labels(units)
    assert labels(None)[1] == "settled within"
    assert [labels(None)[0], *labels(None)[2:-2]] == list(METRIC_LABELS.values())
    assert shared_units([units, units]) == units and shared_units([units, None]) is None

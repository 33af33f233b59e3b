"""The tube of the cascade: valid at every time, from every start, and no wider than it must be."""

import json
import math
import sys
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise

import flint
import numpy as np
import pytest
from click.testing import CliRunner

import certrack
from certrack.certificates import cascade, certify, certify_semidefinite
from certrack.certificates.arithmetic import rational
from certrack.certificates.cascade import certify_cascade, head_problem
from certrack.certificates.centred import RemainderBound, centred_problem
from certrack.certificates.exact import from_text, squared_bound
from certrack.certificates.formulation import error_problem
from certrack.certificates.tube import (
    PIECE_RATIO,
    Tube,
    _allowed,
    _centred_steps,
    _fall,
    single_stage,
    starts_of,
)
from certrack.certificates.tube import tube as tube_of
from certrack.cli import cli
from certrack.core.rounding import rounded_down, rounded_up
from certrack.simulation.simulator import Simulator, simulate
from certrack.studies.falsifier.falsify import falsify


@pytest.fixture(scope="module")
def example1():
    return certrack.load("example1")


@pytest.fixture(scope="module")
def stages(example1):
    return certify_cascade(example1)[1]


@pytest.fixture(scope="module")
def hostile(example1):
    """The worst admissible case that a search has found: disturbance, reference, parameters."""
    worst = falsify(example1, budget=1500).system
    bounds = example1.reference.bounds(1).values
    assert all(a <= b for a, b in zip(worst.reference.bounds(1).values, bounds, strict=True))
    return worst


#: Starts near the reference, far from it, and with e_2 large where e_1 is not.
STARTS = [(1, 2), (1, -2), (-3, 4), (0.2, 20), (0.2, -20), (8, 0), (0.2, -0.35), (0.2, 0.0)]

#: Guesses at 1/g_n and theta, whose true values are 1/2 and 2: exact, wrong, and very wrong.
ESTIMATES = [(0.0, 0.0), (0.5, 2.0), (0.4, 2.1), (3.0, -6.0)]

#: Two guesses with every start.
BEGINNINGS = [(x0, ESTIMATES[(i + j) % 4]) for i, x0 in enumerate(STARTS) for j in (0, 1)]


def runs_of(system, beginnings):
    """Runs from the beginnings, each with the system that starts there."""
    simulator = Simulator(system)
    for x0, estimates in beginnings:
        started = system.with_settings(x0=x0, estimates=estimates)
        yield started, simulator.run(started)


@pytest.fixture(scope="module")
def runs(example1, hostile):
    """Runs of the example, and under the worst case found."""
    worst = hostile.with_settings(duration=30, tail=15)
    return [*runs_of(example1, BEGINNINGS), *runs_of(worst, BEGINNINGS[1::2])]


def largest_ratio(runs, make):
    """Largest |e_1(t)|/tube(t) over the runs; `make` gives the tube from a start."""
    return max(float(np.max(np.abs(run.e[0]) / make(system)(run.t))) for system, run in runs)


@pytest.mark.slow
def test_no_run_leaves_the_tube(runs, stages):
    assert largest_ratio(runs, lambda system: tube_of(system, stages)) <= 1


def test_the_tube_at_the_start_is_the_error(example1, stages):
    """e_1(0) is known, and for order 2 the last stage has no other coordinate."""
    for x1 in (1.0, -3.0, 0.2):
        tube = tube_of(example1.with_settings(x0=(x1, 2)), stages)
        assert abs(x1 - 0.2) <= tube(0.0) <= max(abs(x1 - 0.2) * (1 + 1e-6), 1e-3)


def naive(system, stages):
    """The mutant: e_n within its bound from the start on."""
    problem = error_problem(system, rational)
    head = head_problem(problem, from_text(stages[-2].bound))
    return Tube(*single_stage(system, head, stages[-1], starts_of(system, None)[0]))


def narrowed(system, stages):
    """The mutant: the whole tube a little too narrow at the start."""
    whole = tube_of(system, stages)
    return replace(whole, pieces=tuple((t, 0.9 * s, 0.9 * f) for t, s, f in whole.pieces))


@pytest.mark.parametrize("mutant", [naive, narrowed])
def test_runs_leave_a_tube_that_is_too_small(mutant, runs, stages):
    assert largest_ratio(runs[:16], lambda system: mutant(system, stages)) > 1


def e_n_steps(system, stages):
    """Times, and bounds on |e_n| from each on, as the tube of the cascade uses them."""
    problem, starts = error_problem(system, rational), starts_of(system, None)[0]
    start, _, alpha = single_stage(system, problem, stages[0], starts, 1)
    steps = _fall(start, alpha, problem, stages[0], 1)
    if len(stages) > 2:
        steps = _centred_steps(system, problem, stages[:-1], starts, steps)
    times, squares = np.array(steps).T
    return times, np.sqrt(squares) * float(stages[-2].bound)


def test_the_bounds_on_the_last_coordinate_hold_at_every_time(runs, stages):
    for system, run in runs:
        for inner in (stages, (stages[0], stages[2])):
            times, limits = e_n_steps(system, inner)
            limit = limits[np.searchsorted(times, run.t, side="right") - 1]
            assert np.all(np.abs(run.e[1]) <= limit)


def test_the_bounds_on_the_last_coordinate_fall_in_steps_to_that_of_their_stage(example1, stages):
    for inner in (stages, (stages[0], stages[2])):
        _, limits = e_n_steps(example1.with_settings(x0=(8, 0)), inner)
        fall = limits[:-1] ** 2 / limits[1:] ** 2
        assert (fall > 1 - 1e-9).all() and (fall < 1 / PIECE_RATIO + 1e-9).all()
        assert limits[-1] == float(inner[-2].bound) and limits[0] > 10


def test_each_piece_has_the_floor_of_its_bound_on_the_last_coordinate(example1, stages):
    """2 Delta/alpha, to which e_n adds by the square of its bound."""
    system, last = example1.with_settings(x0=(8, 0)), stages[-1]
    times, limits = e_n_steps(system, stages)
    pieces = tube_of(system, stages).pieces
    assert [time for time, _, _ in pieces] == list(times)
    parts = limits**2 / float(stages[-2].bound) ** 2
    rest = sum(map(float, (*last.nu, *last.k[:-1])))
    floors = 2 * (rest + float(last.k[-1]) * parts) / float(last.alpha)
    assert [floor for _, _, floor in pieces] == pytest.approx(floors, rel=1e-9)


def test_the_centred_energy_starts_below_what_the_first_stage_allows(example1, stages):
    """2 V_2 <= allowed(2 V_1) for random errors and estimates."""
    problem = error_problem(example1, rational)
    allowed = _allowed(problem, stages[:2])
    P, Q = (np.array(stage.P, dtype=float) for stage in stages[:2])
    kappa = float(stages[1].shift)
    rng = np.random.default_rng(0)
    tightest = math.inf
    for _ in range(4000):
        e, (d, t) = rng.normal(size=2), rng.normal(size=2) * 10 ** rng.uniform(-3, 1)
        first = e @ P @ e + P[-1, -1] * (2 * d**2 + t**2)  # g = theta = 2, gbar = Gamma = 1
        second = e @ Q @ e + Q[-1, -1] * (2 * (d - kappa / 2) ** 2 + (t + kappa * 2) ** 2)
        limit = allowed(flint.fmpq(*float(first).as_integer_ratio()))
        assert second <= limit
        tightest = min(tightest, limit / second)
    assert tightest < 1.5


def test_the_tube_falls_to_the_certificate_and_belongs_to_the_best_by_one_function(example1):
    found = certify(example1)
    assert found.tube_kind == "cascade" and found.best is found.bootstrap
    assert found.tube(1e6) == pytest.approx(found.cascade.bound, rel=1e-9)
    assert found.tube(1e6) >= found.cascade.bound
    assert len(found.tube.pieces) > 1
    lean = certify(certrack.load("dual-motor-lean"))
    assert lean.tube == tube_of(certrack.load("dual-motor-lean"), lean.proof)


def test_the_pieces_join_and_none_is_below_the_floor(example1, stages):
    tube = tube_of(example1, stages)
    for (time, square, floor), (end, after, _) in pairwise(tube.pieces):
        decay = math.exp(-tube.alpha * (end - time))
        assert square * decay + floor * (1 - decay) <= after <= square * decay + floor + 1e-12
        assert end > time
    assert tube.pieces[-1][2] == tube.floor
    head = head_problem(error_problem(example1, rational), from_text(stages[-2].bound))
    assert tube.floor >= float(squared_bound(head, stages[-1]))


@pytest.mark.parametrize("level", [0.7, 0.3, 0.1, 0.08])
def test_settling_time_is_the_last_time_above_the_level(level, example1, stages):
    tube = tube_of(example1, stages)
    settled = tube.settling_time(level)
    assert np.all(tube(settled + np.linspace(0, 100, 20_001)) <= level * (1 + 1e-9))
    assert tube(0.999 * settled) > level
    assert math.isinf(tube.settling_time(0.0786))
    assert tube.settling_time(10.0) == 0.0


def test_a_tube_that_rises_first_settles_after_its_top():
    tube = Tube(1.0, 0.5, 1.0, ((0.0, 1.0, 4.0), (1.0, 4 - 3 * math.exp(-1), 0.5)))
    settled = tube.settling_time(1.2)
    assert settled > 1
    assert tube(settled) == pytest.approx(1.2)
    assert tube.settling_time(2.0) == 0.0


def test_two_stages_have_their_tube_too(example1, runs, stages):
    """Without the centred stage, as where drift and regressor have no interval bound."""
    problem = error_problem(example1, rational)
    last = cascade._prove_stage(head_problem(problem, from_text(stages[0].bound)), 0)
    two = (stages[0], last)
    assert largest_ratio(runs[::3], lambda system: tube_of(system, two)) <= 1
    assert tube_of(example1, two)(1e6) == pytest.approx(float(last.bound), rel=1e-9)


def test_the_centred_stage_waits_where_zeta_has_no_bound(monkeypatch, example1, runs, stages):
    """The first steps refuse; V_2 then starts with what V_1 allows, and nothing gets smaller."""
    whole = tube_of(example1, stages)
    module = sys.modules["certrack.certificates.tube"]
    refused = []

    class Refusing(module.RemainderBound):
        def __call__(self, reached):
            if float(from_text(reached.bound)) > 1.0:
                refused.append(1)
                raise certrack.NoCertificate("unbounded")
            return super().__call__(reached)

        def in_floats(self, reached, squares):
            found = super().in_floats(reached, squares)
            return np.where(squares > 1.0, np.inf, found)

    monkeypatch.setattr(module, "RemainderBound", Refusing)
    late = tube_of(example1, stages)
    assert refused
    t = np.linspace(0, 60, 601)
    assert np.all(late(t) >= whole(t) * (1 - 1e-12))
    assert late(1e6) == whole(1e6)
    assert largest_ratio(runs[::5], lambda system: tube_of(system, stages)) <= 1


@pytest.mark.parametrize(("factor", "wider"), [(0.2, False), (1.5, True)])
def test_the_bound_on_zeta_counts_while_the_first_stage_falls(
    monkeypatch, factor, wider, example1, stages
):
    module = sys.modules["certrack.certificates.tube"]
    whole = tube_of(example1, stages)

    class Changed(module.RemainderBound):
        def in_floats(self, reached, squares):
            return factor * super().in_floats(reached, squares)

    monkeypatch.setattr(module, "RemainderBound", Changed)
    other, t = tube_of(example1, stages), np.linspace(5, 15, 101)
    change = np.log(other(t) / whole(t)) * (1 if wider else -1)
    assert change.max() > 1e-3
    assert change.min() > -1e-9


def test_float_bounds_on_zeta_are_above_the_intervals(example1, stages):
    """On sets of all sizes; and hardly above."""
    zeta = RemainderBound(example1, error_problem(example1, rational))
    bounds = [str(2.0**k) for k in range(-4, 12, 3)]
    squares = np.array([float(bound) ** 2 for bound in bounds])
    found = zeta.in_floats(stages[0], squares)
    for bound, size in zip(bounds, found.tolist(), strict=True):
        exact = zeta(replace(stages[0], bound=bound))
        # these have roots of 12 digits, which are rounded up
        assert Fraction(size) >= Fraction(int(exact.p), int(exact.q)) * (1 - Fraction(1, 10**10))
        assert size <= float(exact) * (1 + 1e-12)


def test_a_cascade_of_order_3_keeps_its_tube():
    plant = certrack.Plant(
        states=["x1", "x2", "x3"],
        chain=[1, 2],
        linear=[[-1], [0.5, -1]],
        drift="0.2*sin(x2)*x3",
        regressor=["cos(x1)"],
        uncertainty=certrack.Uncertainty([0.1, 0.1, 0.2], [0.1, 0.1, 0.1], [0.0, 0.1, 0.1]),
    )
    law = certrack.Adaptive(
        c=[3, 3, 3], gain_rate=20, leak_gain=0.1, leak_theta=0.1, Gamma=[20.0], delta0=0.6
    )
    truth = certrack.Truth(
        2.0, (1.0,), omega=("0.1*x3*sin(t)", "0.1*cos(3*t)", "0.1*x1 + 0.1*sin(t)")
    )
    system = certrack.System(
        plant,
        law,
        certrack.SymbolicReference("0.2*cos(t)"),
        truth,
        certrack.Settings([1, 1, -1], 30),
    )
    certificate, stages = certify_cascade(system)
    assert certificate.verified
    tube = tube_of(system, stages)
    assert tube(1e6) == pytest.approx(certificate.bound, rel=1e-9)
    for x0 in ((1, 1, -1), (0.2, 0, 5), (-2, 3, -4), (0.2, 0, -9)):
        run = simulate(system, x0=x0)
        assert np.all(np.abs(run.e[0]) <= tube_of(system.with_settings(x0=x0), stages)(run.t))


def test_centred_problem_has_zeta_as_its_last_bounded_input(example1, stages):
    problem = error_problem(example1, rational)
    centred = centred_problem(example1, problem, stages[0], from_text(stages[1].shift))
    assert centred.counts[1] == problem.counts[1] + 1


@pytest.mark.parametrize("digits", [1, 4, 5, 12])
def test_printed_bounds_are_on_the_safe_side(digits):
    for value in np.random.default_rng(0).lognormal(sigma=8, size=300).tolist():
        up, down = (Decimal(f(value, digits)) for f in (rounded_up, rounded_down))
        assert down <= Decimal(value) <= up
        assert float(up) == float(f"{up:.{digits}g}")
        assert up - down <= 1.01 * 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    assert math.isinf(float(rounded_up(math.inf, digits)))


def test_what_is_printed_and_written_is_the_best_certificates_tube():
    done = CliRunner().invoke(cli, ["certify", "example1"])
    assert "tube from x0: |e_1| <= 0.80001 at t = 0" in done.output
    assert "0.078638" in done.output  # 0.07863787..., rounded up
    told = json.loads(CliRunner().invoke(cli, ["certify", "example1", "--json"]).output)
    tube = told["tube"]
    assert tube["kind"] == "cascade"
    assert math.sqrt(tube["floor"]) == pytest.approx(told["cascade"]["bound"], rel=1e-9)
    rebuilt = Tube(tube["start"], tube["floor"], tube["alpha"], tuple(map(tuple, tube["pieces"])))
    assert rebuilt(3.0) == tube_of(
        certrack.load("example1"), certify_cascade(certrack.load("example1"))[1]
    )(3.0)


def test_the_semidefinite_tube_is_still_to_be_had(example1):
    certificate, proof = certify_semidefinite(example1)
    assert tube_of(example1, proof)(1e6) == pytest.approx(certificate.bound, rel=1e-9)
    assert tube_of(example1, [proof]) == tube_of(example1, proof)

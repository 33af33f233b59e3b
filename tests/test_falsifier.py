"""The adversary's parts write the same into a system as into the compiled loop."""

from dataclasses import replace

import numpy as np
import pytest

import certrack
from certrack.integrators.base import MemberOutcome, MethodUnavailable
from certrack.integrators.many.native import vector_compiler
from certrack.studies.falsifier.falsify import falsify
from certrack.studies.falsifier.loop import (
    ESCAPE_SCORE,
    AdversarialLoop,
    slowest_time_constant,
)


def with_ranges():
    base = certrack.load("example1")
    ranges = {"input_gain_range": (1.5, 2.5), "theta_range": ((1.0, 2.5),)}
    return base.replace(plant=replace(base.plant, **ranges))


SYSTEMS = {
    "bent reference, gain, theta": with_ranges(),
    "sine, four states": certrack.load("dual-motor-lean"),
}


#: With few the grid is used, with many the lanes.
RUNS = [
    1,
    pytest.param(10**4, marks=pytest.mark.skipif(not vector_compiler(), reason="no C compiler")),
]


@pytest.mark.parametrize("runs", RUNS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_case_written_out_is_the_one_that_was_scored(name, runs):
    """Every number away from its plausible start, so that none may be forgotten in either place."""
    loop = AdversarialLoop(SYSTEMS[name], runs)
    assert (loop._lanes is not None) == (runs > 1)
    variables = loop.adversary.variables
    rng = np.random.default_rng(3)
    low, high = np.array([(variable.low, variable.high) for variable in variables]).T
    soft = np.where(high == 30.0, 0.05, 1.0)  # hard patterns are rough to integrate
    table = (
        (low + high) / 2 + soft * (rng.uniform(low, high, (3, len(variables))) - (low + high) / 2)
    ).T
    scores = loop.errors(table)
    for score, column in zip(scores, table.T, strict=True):
        exact = certrack.simulate(loop.case(column), tolerance=1e-9).metrics.tail_error
        assert score == pytest.approx(exact, rel=2e-3)


@pytest.mark.skipif(not vector_compiler(), reason="no C compiler")
@pytest.mark.parametrize("name", SYSTEMS)
def test_lanes_score_as_the_grid_does(name):
    """Hard patterns too, and more members than lanes; both to the accuracy of the search."""
    lanes, grid = (AdversarialLoop(SYSTEMS[name], runs) for runs in (10**4, 1))
    variables = grid.adversary.variables
    low, high = np.array([(variable.low, variable.high) for variable in variables]).T
    points = np.random.default_rng(5).uniform(low, high, (19, len(variables))).T
    scores, wanted = lanes.errors(points), grid.errors(points)
    assert scores == pytest.approx(wanted, rel=2e-2)
    assert np.median(np.abs(scores / wanted - 1)) < 1e-3
    assert np.array_equal(scores[3:4], lanes.errors(points[:, 3:4]))  # whatever the neighbours are


@pytest.mark.skipif(not vector_compiler(), reason="no C compiler")
def test_members_that_lanes_do_not_finish_are_run_otherwise(monkeypatch):
    system = SYSTEMS["sine, four states"]
    monkeypatch.setattr("certrack.studies.falsifier.lanes.MAX_STEPS", 350)
    loop, grid = AdversarialLoop(system, 10**4), AdversarialLoop(system)
    points = grid.adversary.plausible_starts().T
    steps = loop._lanes._largest
    starts = np.repeat(np.array(loop._template.start)[:, None], points.shape[1], axis=1)
    rows = loop._table(points).values[loop._lanes._rows]
    outcomes = steps.largest(starts, rows, *loop._tail)[1]
    assert 0 < (outcomes == MemberOutcome.run_alone).sum() < len(outcomes)
    assert loop.errors(points) == pytest.approx(grid.errors(points), rel=1e-3)


@pytest.mark.skipif(not vector_compiler(), reason="no C compiler")
def test_members_that_escape_score_above_all_others():
    """Without a useful input gain x2' = x1^2 x2 goes to infinity in finite time."""
    base = certrack.load("example1")
    weak = base.replace(truth=replace(base.truth, input_gain=1e-9))
    loop = AdversarialLoop(weak, 10**4)
    points = loop.adversary.plausible_starts()[:3].T
    assert (loop.errors(points) == ESCAPE_SCORE).all()


def test_without_a_compiler_the_grid_scores(monkeypatch):
    def refuse(*_):
        raise MethodUnavailable("no compiler")

    monkeypatch.setattr("certrack.integrators.peaks.compiled_library", refuse)
    loop = AdversarialLoop(SYSTEMS["sine, four states"], 10**4)
    assert loop._lanes is None
    assert loop.errors(loop.adversary.plausible_starts()[:2].T).min() > 0


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_number_changes_the_loop(name):
    loop = AdversarialLoop(SYSTEMS[name])
    middle = np.array([variable.middle for variable in loop.adversary.variables])
    for i, variable in enumerate(loop.adversary.variables):
        moved = middle.copy()
        moved[i] += 0.2 * (variable.high - variable.low)
        texts = [certrack.to_text(loop.case(point)) for point in (moved, middle)]
        assert texts[0] != texts[1], variable.name
        assert loop.errors(moved[:, None]) != loop.errors(middle[:, None]), variable.name


@pytest.mark.parametrize(
    ("changes", "slowest"),
    [
        ({"Gamma": [0.1]}, 1 / 0.06),
        ({"Gamma": [0.01]}, 1 / 0.006),
        ({"gain_rate": 0.1, "Gamma": [50.0]}, 1 / 0.06),
        ({"gain_rate": 9.0, "Gamma": [50.0]}, 0.0),
    ],
)
def test_the_transient_outlasts_the_slowest_leak(changes, slowest):
    """Theta leaks at Gamma leak_theta, delta_hat at gain_rate leak_gain; else the poles count."""
    base = certrack.load("example1")
    system = base.replace(law=replace(base.law, **changes))
    poles = -system.controller.coordinates.poles.real.max()
    expected = max(slowest, 1 / poles)
    assert slowest_time_constant(system) == pytest.approx(expected, rel=1e-12)


def test_plausible_starts_are_within_the_ranges():
    adversary = AdversarialLoop(SYSTEMS["bent reference, gain, theta"]).adversary
    low, high = np.array([(variable.low, variable.high) for variable in adversary.variables]).T
    starts = adversary.plausible_starts()
    assert np.all((low <= starts) & (starts <= high))
    frequencies = starts[:, [variable.name for variable in adversary.variables].index("adv_w0")]
    assert len(set(frequencies)) == 4


def test_constants_of_the_user_are_never_overwritten():
    """The patterns' numbers are constants of the plant, so their names are not the user's."""
    base = certrack.load("example1")
    constants = dict(base.plant.constants) | {"adv_m0": 1.0}
    system = base.replace(plant=replace(base.plant, constants=constants))
    with pytest.raises(certrack.InputError, match="adv_ are reserved by falsify"):
        falsify(system, budget=1)
    renamed = replace(base.plant, constants=dict(base.plant.constants) | {"advance": 1.0})
    case = AdversarialLoop(base.replace(plant=renamed))
    middle = np.array([variable.middle for variable in case.adversary.variables])
    assert float(case.case(middle).plant.constant_values["advance"]) == 1.0

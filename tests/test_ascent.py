"""The ascent of the falsifier: its slopes, what it leaves admissible, and what it finds."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from adaptive_plants import EASY, random_plant

import certrack
from certrack.certificates.bootstrap.certify import certify_bootstrap
from certrack.core.expressions import TIME, parse
from certrack.core.lowering import numpy_callable
from certrack.core.progress import silent
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.controlled import ControlledRuns
from certrack.studies.falsifier.ascent.case import MEANS, SIGNS, mean_formula, written
from certrack.studies.falsifier.ascent.climb import climb
from certrack.studies.falsifier.ascent.loop import (
    LEAST_PIECE,
    PIECE_PART,
    RESTING_PIECES,
    AdversaryInputs,
    ControlledLoop,
    _pieces,
)
from certrack.studies.falsifier.ascent.search import ascend
from certrack.studies.falsifier.ascent.seeds import all_members, of_run, waves
from certrack.studies.falsifier.falsify import falsify
from certrack.studies.falsifier.linear.ascent import worst_inputs
from certrack.studies.falsifier.linear.continuous import continuous_chain
from certrack.studies.falsifier.linear.search import NothingTried, linear_error_loop

EXAMPLE = certrack.load("example1")

#: What a gradient ascent of another program found of example1.
FOUND_ELSEWHERE = 0.0445


def with_ranges():
    ranges = {"input_gain_range": (1.5, 2.5), "theta_range": ((1.0, 2.5),)}
    return EXAMPLE.replace(plant=replace(EXAMPLE.plant, **ranges))


def bounds_of(system):
    return tuple(system.reference.bounds(system.controller.coordinates.q + 1).values)


def short(system, steps=40):
    """A loop of few steps: every input still matters at its end."""
    loop = ControlledLoop(system, bounds_of(system))
    loop.widths, loop.piece_steps = loop.widths[:steps], np.full(steps // 4, 4)
    return loop


def random_inputs(loop, count, seed=0):
    rng = np.random.default_rng(seed)
    m, pieces = len(loop.bounds) - 1, len(loop.piece_steps) + RESTING_PIECES
    low, high = loop.ranges.T[..., None]
    return AdversaryInputs(
        rng.uniform(-1, 1, (len(loop.widths), len(loop.acting), count)),
        rng.uniform(-0.1, 0.1, (m, count)),
        rng.uniform(-0.1, 0.1, (pieces, count)),
        rng.uniform(low, high, (len(loop.ranges), count)),
    )


def slopes_and_differences(loop):
    """Of shares, beginning, pieces and constants: differences along them, and what slopes say."""
    inputs, along = random_inputs(loop, 3), random_inputs(loop, 3, 1)
    values, slopes = loop.slopes(inputs)
    assert values == pytest.approx(loop.errors(inputs))
    step = 1e-5
    for i in range(4):
        parts = [a * (j == i) for j, a in enumerate(along.parts())]
        there, back = (
            AdversaryInputs(
                *(a + sign * step * b for a, b in zip(inputs.parts(), parts, strict=True))
            )
            for sign in (1, -1)
        )
        wanted = (loop.errors(there) - loop.errors(back)) / (2 * step)
        found = sum(
            (a * b).reshape(-1, 3).sum(axis=0) for a, b in zip(slopes.parts(), parts, strict=True)
        )
        yield wanted, found


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("plant", ["ranges", 4])
def test_slopes_are_those_of_differences(plant, compiled, monkeypatch):
    if not compiled:

        def refuse(*_):
            raise MethodUnavailable("no compiler")

        monkeypatch.setattr("certrack.integrators.controlled.compiled_library", refuse)
    loop = short(with_ranges() if plant == "ranges" else random_plant(plant))
    for i, (wanted, found) in enumerate(slopes_and_differences(loop)):
        assert found == pytest.approx(wanted, rel=1e-6, abs=1e-9)
        assert loop.ranges.size or i == 3 or np.abs(wanted).min() > 0


def test_numpy_integrates_as_the_compiled_lanes_do(monkeypatch):
    loop = short(with_ranges())
    inputs = random_inputs(loop, 11)  # more than lanes
    compiled = loop.slopes(inputs)

    def refuse(*_):
        raise MethodUnavailable("no compiler")

    monkeypatch.setattr("certrack.integrators.controlled.compiled_library", refuse)
    slow = short(with_ranges())
    assert slow.runs._library is None
    plain = slow.slopes(inputs)
    assert plain[0] == pytest.approx(compiled[0], rel=1e-12)
    for a, b in zip(plain[1].parts(), compiled[1].parts(), strict=True):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-14)
    assert isinstance(slow.runs, ControlledRuns)


def test_of_a_linear_loop_the_ascent_finds_the_worst_case_of_the_kernels():
    """Two programs that share only the linear program of the reference."""
    system = certrack.load("dual-motor-lean")
    bounds = bounds_of(system)
    linear = linear_error_loop(system)
    exact = worst_inputs(continuous_chain(linear, linear.nominal, bounds)).error
    loop = ControlledLoop(system, bounds)
    members = waves(loop, 4, np.random.default_rng(0))
    top = climb(loop, members, np.array([1.0, -1, 1, -1]), 3)
    assert 0.99 * exact < top.errors.max() < 1.005 * exact


@functools.cache
def ascended():
    """The ascent from the run of example1's own file."""
    own = certrack.simulate(EXAMPLE)
    return ascend(EXAMPLE, bounds_of(EXAMPLE), [(EXAMPLE, own)], 1500, 0, silent)


def test_example1_is_driven_beyond_what_was_found_elsewhere(tmp_path):
    case = ascended().case
    assert FOUND_ELSEWHERE < case.error < 0.0618
    assert case.error == pytest.approx(case.estimate, rel=2e-3)
    certrack.save(case.system, tmp_path / "worst.toml")
    replayed = certrack.simulate(certrack.load(tmp_path / "worst.toml"))
    assert replayed.metrics.tail_error == pytest.approx(case.error, rel=1e-9)


def test_the_case_found_is_admissible():
    case = ascended().case
    assert not certrack.check_assumption_1(case.system)
    assert case.system.reference.bounds(1).values <= bounds_of(EXAMPLE)
    assert case.system.plant == EXAMPLE.plant
    assert case.system.law == EXAMPLE.law


def test_the_seed_decides():
    system = certrack.loads(EASY)
    first, again, other = (
        ascend(system, bounds_of(system), [], 300, seed, silent).case for seed in (1, 1, 2)
    )
    assert certrack.to_text(first.system) == certrack.to_text(again.system)
    assert certrack.to_text(first.system) != certrack.to_text(other.system)


def test_no_step_leaves_what_is_admissible():
    system = with_ranges()
    loop = ControlledLoop(system, bounds_of(system))
    top = climb(loop, waves(loop, 8, np.random.default_rng(2)), np.tile([1.0, -1.0], 4), 3)
    assert np.abs(top.inputs.shares).max() <= 1
    low, high = loop.ranges.T[..., None]
    assert (low <= top.inputs.truths).all()
    assert (top.inputs.truths <= high).all()
    case = written(loop, top.inputs.subset(np.array([0])), top.slopes.subset(np.array([0])), SIGNS)
    begin = case.reference.values(np.zeros(1), 0)[0, 0]
    assert begin == pytest.approx(top.inputs.begin[0, 0], rel=1e-3)  # it was not scaled down


def test_a_run_becomes_inputs_that_do_the_same():
    """From a case that was written back to the shares and pieces that it was written from."""
    case = ascended().case
    loop = ControlledLoop(EXAMPLE, bounds_of(EXAMPLE))
    inputs, sense = of_run(loop, case.system, case.run)
    assert sense * loop.errors(inputs)[0] == pytest.approx(case.error, rel=0.01)
    flipped = AdversaryInputs(-inputs.shares, *inputs.parts()[1:])
    assert sense * loop.errors(flipped)[0] < 0.9 * case.error
    assert all_members([inputs, flipped]).count == 2


def test_mean_values_of_shares_as_a_formula():
    edges = np.arange(101.0)
    share = np.where(np.arange(100) < 30, 0.25, np.where(np.arange(100) < 70, -1.0, 0.5))
    text = mean_formula(share, np.ones(100), edges)
    formula = numpy_callable([TIME], [parse("", text, ["t"]).expr])
    assert formula(edges[:-1] + 0.5)[0] == pytest.approx(share)
    assert mean_formula(np.full(3, 0.25), np.ones(3), np.arange(4.0)) == "0.25"
    noisy = mean_formula(np.sin(np.arange(5000.0)), np.ones(5000), np.arange(5001.0))
    assert noisy.count("sign") < 60


def test_what_changes_slowly_is_held():
    u = replace(EXAMPLE.plant.uncertainty, gamma=(0.05, 0), rate=(float("inf"), 0.001))
    system = EXAMPLE.replace(plant=replace(EXAMPLE.plant, uncertainty=u))
    loop = ControlledLoop(system, bounds_of(system))
    assert loop.held == (False, True)
    top = climb(loop, waves(loop, 4, np.random.default_rng(0)), np.array([1.0, -1, 1, -1]), 2)
    assert (np.ptp(top.inputs.shares[:, 1], axis=0) == 0).all()
    assert (np.ptp(top.inputs.shares[:, 0], axis=0) == 2).all()
    inputs, slopes = (v.subset(np.array([0])) for v in (top.inputs, top.slopes))
    assert "t" not in written(loop, inputs, slopes, MEANS).truth.omega[1].text


def test_without_a_disturbance_the_reference_is_driven_alone():
    plant = certrack.Plant(
        states=["x1"],
        gain_sign=-1,
        input_gain="-0.3",
        uncertainty=certrack.Uncertainty([0], [0], [0]),
    )
    system = certrack.System(
        plant=plant,
        law=certrack.Adaptive(c=(0.5,), gain_rate=0.2, leak_gain=0.1, leak_theta=0.1, delta0=0),
        reference=certrack.SymbolicReference("0.1*sin(0.2*t)"),
        truth=certrack.Truth("-0.3", (), ("0",)),
        settings=certrack.Settings(x0=(0.0,), duration=2.0),
    )
    found = certrack.falsify(system, budget=100)
    assert found.origin == "ascent"
    assert found.own_run < found.worst_error <= certrack.certify(system, "fast").best.bound


def test_a_reference_that_stands_still_is_not_searched():
    with pytest.raises(NothingTried, match="stands still"):
        ascend(EXAMPLE, (0.2, 0.0), [], 100, 0, silent)


def test_a_bootstrap_that_gains_nothing_says_what_to_do():
    certificate, proof = certify_bootstrap(certrack.loads(EASY))
    assert proof or "take that one" in certificate.reason


@pytest.mark.slow
def test_falsify_of_the_shipped_example_goes_up_to_its_worst():
    found = falsify(EXAMPLE)
    assert found.origin == "ascent"
    assert found.alarm is None
    assert found.worst_error > FOUND_ELSEWHERE


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 5, 8, 13])
def test_no_random_plant_is_driven_beyond_its_certificate(seed):
    """Each is attacked again with another seed than that of the table in the documentation."""
    found = falsify(random_plant(seed), budget=2000, seed=seed)
    assert found.alarm is None
    assert found.against.bound >= found.worst_error
    assert found.against.bound <= 3 * found.worst_error


def test_a_run_that_shows_its_start_is_no_worst_case():
    slow = EXAMPLE.replace(law=replace(EXAMPLE.law, leak_gain=0.002, leak_theta=0.002))
    assert ControlledLoop(EXAMPLE, bounds_of(EXAMPLE)).forgets_start
    with pytest.raises(NothingTried, match="outlasts the longest run"):
        ascend(slow, bounds_of(slow), [], 300, 0, silent)


def test_the_reference_of_a_run_is_admissible_where_its_means_drift_away():
    """Of the former starter: pieces of 6 s in 100 s of 0.5 sin(t), whose mean is no y_d''."""
    system = certrack.load("tests/data/starter.toml")
    loop = ControlledLoop(system, bounds_of(system))
    inputs, _ = of_run(loop, system, certrack.simulate(system))
    widths = np.concatenate([loop.piece_widths, loop.stopping_widths])
    y, largest = inputs.begin[:, 0], np.zeros(2)
    for width, top in zip(widths, inputs.pieces[:, 0], strict=True):
        y = np.array([y[0] + width * y[1] + width**2 / 2 * top, y[1] + width * top])
        largest = np.maximum(largest, np.abs(y))
    assert (largest <= 0.5 * (1 + 1e-9)).all()
    assert np.abs(inputs.pieces).max() <= 0.5 * (1 + 1e-9)


@pytest.mark.parametrize(("steps", "longest"), [(1, 1), (100, 3), (4000, 10), (4000, 500)])
def test_pieces_are_short_at_the_end_and_never_longer_than_a_turn(steps, longest):
    pieces = _pieces(steps, longest)
    assert pieces.sum() == steps and pieces.max() <= max(longest, LEAST_PIECE)
    assert (np.diff(pieces[1:]) <= 0).all()  # the first takes what is left
    left = steps - np.cumsum(pieces)
    assert (pieces <= np.maximum(LEAST_PIECE, PIECE_PART * left)).all()


@pytest.mark.slow
def test_a_reference_that_turned_long_ago_counts_where_estimates_forget_slowly():
    """With pieces that grow with the time to the end alone, 0.0260 is found."""
    found = certrack.falsify(certrack.load("tests/data/starter.toml"), budget=1500)
    assert found.worst_error > 0.034

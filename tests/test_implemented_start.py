"""Bounds of the sampled loop for all time from a start: no run and no attack is beyond them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sampled_attack import SampledLoop
from test_implemented import on_a_drive, random_drive

import certrack
from certrack.certificates import certify, to_document, verify
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import start as start_room
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.limits import input_limits
from certrack.certificates.implemented.polytope import certified_starts
from certrack.certificates.implemented.start import bounds_from_start, starting_loop

X0 = (-1.0, 1.0, 1.0, 0.0)


def test_input_from_the_files_start():
    found = bounds_from_start(on_a_drive("dual-motor-lean", 0.003))
    assert 13.2 < found.peak_input <= 13.8  # 13.2 was simulated
    differenced = on_a_drive("dual-motor-lean", 0.003, ("x2", "x4"))
    assert bounds_from_start(differenced).peak_input <= 14.1
    loop = starting_loop(differenced)
    free = bounds_from_start(differenced, loop=loop, any_reference=True).peak_input
    box = bounds_from_start(differenced, [(-1, 1)] * 4, loop=loop).peak_input
    assert 17 < free < 18.1 < box < 42


def beyond(system, bounds, run):
    """By how much a run leaves the bounds, at its worst; negative inside."""
    excess = -np.inf
    k = np.minimum((run.t / system.implementation.period).astype(int), len(bounds.values) - 1)
    late = run.t >= len(bounds.values) * system.implementation.period
    for i in range(system.plant.n):
        limit = np.where(late, bounds.last[1 + i], bounds.values[k, 1 + i])
        excess = max(excess, (np.abs(run.x[i]) - limit).max())
    limit = np.where(late, bounds.last[0], bounds.values[k, 0])
    return max(excess, (np.abs(run.e[0]) - limit).max())


@pytest.mark.parametrize("speeds", [(), ("x2", "x4")])
def test_runs_stay_inside(speeds):
    """Runs of the simulator, which quantises, delays and differences by its own code."""
    system = on_a_drive("dual-motor-lean", 0.01, speeds)
    bounds = bounds_from_start(system)
    run = certrack.simulate(system, duration=4.0)
    assert beyond(system, bounds, run) < 0
    assert run.metrics.peak_input <= bounds.peak_input <= 1.1 * run.metrics.peak_input
    smaller = replace(bounds, values=bounds.values * 0.95, last=bounds.last * 0.95)
    assert beyond(system, smaller, run) > 0  # so it is near enough to be a test


@pytest.mark.parametrize("speeds", [(), ("x2",)])
def test_attacks_from_the_start_stay_inside(speeds):
    system = on_a_drive("dual-motor-lean", 0.02, speeds, noise=1e-3)
    bounds, loop = bounds_from_start(system), SampledLoop(system)
    memories = {"x2": 0}
    ratios = []
    for k in (0, 1, 3, 10, 40, 120):
        for output, column in ((None, -2), (0, 1), (3, 4)):
            found = loop.from_start(X0, k, 0, output, 0.1, 0.75, memories if speeds else {})
            assert found <= bounds.values[k, column], (k, output)
            ratios.append(bounds.values[k, column] / max(found, 1e-9))
    assert np.median(ratios) < 1.4


def test_random_loops_from_random_starts():
    rng, held = np.random.default_rng(8), 0
    for _ in range(8):
        system, _, _ = random_drive(rng)
        x0 = tuple(float(v) for v in rng.uniform(-1, 1, system.plant.n).round(3))
        system = system.replace(settings=replace(system.settings, x0=x0))
        if not certify_implemented(system)[0].exists:
            continue
        bounds = bounds_from_start(system)
        run = certrack.simulate(system, duration=2.0)
        assert beyond(system, bounds, run) < 0
        assert run.metrics.peak_input <= bounds.peak_input
        held += 1
    assert held > 4


def test_a_short_horizon_covers_all_time(monkeypatch):
    """What comes after the last period that is looked at has a bound, too, and a larger one."""
    system = on_a_drive("dual-motor-lean", 0.01)
    honest = bounds_from_start(system)
    monkeypatch.setattr(start_room, "LEFT_OF_TRANSIENT", 1e-3)
    short = bounds_from_start(system)
    assert len(short.values) < len(honest.values)
    assert (short.last >= honest.values[len(short.values) :].max(axis=0) * 0.999).all()
    run = certrack.simulate(system, duration=3.0)
    assert beyond(system, short, run) < 0


def test_the_tube_falls_to_about_the_certificate():
    system = on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"))
    bounds = bounds_from_start(system)
    certified = certify_implemented(system)[0].bound
    assert certified * (1 - 1e-5) <= bounds.values[-1, 0] < 2.5 * certified
    assert bounds.values[0, 0] >= 1  # |e_1(0)| = 1


# Limits of the input ------------------------------------------------------------------------------


def test_limits_that_never_act_are_proven():
    limited = on_a_drive("dual-motor-lean", 0.003, ("x2", "x4"), saturation=(-15.0, 15.0))
    found = certify(limited)
    assert (found.implemented.saturation, found.implemented.starts) == ("inactive", "x0")
    (premise,) = [p for p in found.premises if p.name == "input limits"]
    assert premise.status == "proven" and "14.07" in premise.detail
    assert verify(to_document(limited, *found.stages)).verified
    tighter = on_a_drive("dual-motor-lean", 0.003, ("x2", "x4"), saturation=(-14.0, 15.0))
    limits = input_limits(tighter)
    assert limits.status == "may act" and limits.starts is None and "14.07" in limits.detail
    assert input_limits(on_a_drive("dual-motor-lean", 0.003)).starts == "any"


def test_a_box_of_starts():
    base = on_a_drive("dual-motor-lean", 0.01, saturation=(-15.0, 15.0))
    x0 = [certrack.Distribution("uniform", (-0.02, 0.02))] * 4
    near = base.replace(
        population=certrack.Population(x0=tuple(x0)),
        settings=replace(base.settings, x0=(0.01, 0.0, 0.0, 0.0)),
    )
    assert input_limits(near).starts == "box"
    assert input_limits(base).starts == "x0"


def test_rate_limits_count_from_the_first_sample():
    steps = bounds_from_start(on_a_drive("dual-motor-lean", 0.01)).peaks[-1]
    enough = on_a_drive("dual-motor-lean", 0.01, rate_limit=float(steps) * 101)
    assert input_limits(enough).status == "inactive"
    less = on_a_drive("dual-motor-lean", 0.01, rate_limit=float(steps) * 99)
    assert input_limits(less).status == "may act"


def test_a_late_first_sample_is_not_covered():
    system = on_a_drive("dual-motor-lean", 0.01, offset=0.005)
    assert certify_implemented(system)[0].verified
    with pytest.raises(NoCertificate, match="first sample"):
        bounds_from_start(system)


def test_a_constant_of_the_law_counts():
    base = on_a_drive("dual-motor-lean", 0.01)
    moved = base.replace(plant=replace(base.plant, drift="K_L/J_M*(x1 - x3) + 6"))
    run = certrack.simulate(moved, duration=1.0)
    bounds = bounds_from_start(moved)
    assert run.metrics.peak_input <= bounds.peak_input
    assert beyond(moved, bounds, run) < 0
    assert math.isclose(bounds.offset, 0.3)


# The polytope of starts ---------------------------------------------------------------------------


def test_starts_at_the_edge_of_the_polytope_just_keep_the_limits():
    system = on_a_drive("dual-motor-lean", 0.01, saturation=(-15.0, 15.0))
    starts = certified_starts(system, [(-1, 1)] * 4)
    rng, loop, peaks = np.random.default_rng(2), SampledLoop(system), []
    for direction in rng.choice([-1.0, 1.0], (6, 4)) * rng.uniform(0.5, 1, (6, 4)):
        scales = np.linspace(0, 1, 400)[:, None] * direction / np.abs(direction).max()
        edge = scales[starts.contains(scales)][-1]
        if np.abs(edge).max() > 0.999:
            continue  # the box ends first
        first = np.argmin(starts.room - np.abs(starts.slopes @ edge + starts.offsets))
        peaks.append(loop.from_start(edge, int(first), 0, None, 0.1, 0.75))
    assert len(peaks) > 2 and max(peaks) <= 15 and min(peaks) > 14


def test_membership_of_starts():
    system = on_a_drive("dual-motor-lean", 0.003, saturation=(-15.0, 15.0))
    starts = certified_starts(system, [(-1, 1)] * 4)
    many = np.random.default_rng(0).uniform(-1, 1, (20_000, 4))
    assert 0.6 < starts.contains(many).mean() < 0.76
    part = starts.largest_part()
    assert 0.29 < part < 0.4
    corners = part * 0.999 * np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T
    assert starts.contains(corners).all()
    assert not starts.contains([2, 0, 0, 0])  # outside the box
    asymmetric = on_a_drive("dual-motor-lean", 0.003, saturation=(-15.0, 8.0))
    assert certified_starts(asymmetric, [(-1, 1)] * 4).contains(many).mean() < 0.5
    with pytest.raises(NoCertificate, match="too large"):
        certified_starts(system, [(-1e6, 1e6)] * 4)
    with pytest.raises(certrack.InputError, match="saturation"):
        certified_starts(on_a_drive("dual-motor-lean", 0.003), [(-1, 1)] * 4)


@pytest.mark.slow
def test_members_that_start_inside_never_saturate():
    base = certrack.load("dual-motor-drive")
    starts = certified_starts(base, [(-1, 1)] * 4)
    found = certrack.ensemble(base, 500)
    table = found.frame()
    members = [certrack.member(base, i).settings.x0 for i in range(500)]
    inside = starts.contains(np.array(members))
    assert 0.4 < inside.mean() < 0.9
    assert (table["peak_input"][inside] < 15).all()
    assert (table["tail_error"][inside] <= found.limit).all()


def test_a_reference_that_jumps_once_is_covered_in_the_long_run_only():
    base = on_a_drive("dual-motor-lean", 0.01)
    kink = base.replace(
        reference=certrack.SymbolicReference("0.02*max(t - 1, 0) - 0.02*max(t - 1.5, 0)"),
        law=replace(base.law, feedforward=0),
    )
    assert certify_implemented(kink)[0].verified
    once = base.replace(
        reference=certrack.SymbolicReference("0.05*tanh(max(t - 1, 0))"),
        law=replace(base.law, feedforward=0),
    )
    assert certify_implemented(once)[0].verified
    with pytest.raises(NoCertificate, match="jumps once"):
        bounds_from_start(once)


def test_lags_are_the_gains_period_by_period():
    loop = starting_loop(on_a_drive("dual-motor-lean", 0.02, ("x2", "x4")))
    gains = loop.bounds.gains
    assert loop.lags.w.sum(axis=1) + gains.older == pytest.approx(gains.w, rel=1e-8, abs=1e-15)
    later = [i for i, row in enumerate(loop.rows) if row.phase]
    assert (loop.lags.w[later, 0] > 0).any()  # of the running period

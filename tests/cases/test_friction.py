"""Sticking friction as it came in: an axis whose law and plant both have sign(v)."""

from pathlib import Path

import numpy as np
import pytest
from pace import within

import certrack

CASE = Path(__file__).parents[1] / "data" / "cases" / ("emps0" + ".toml")
AXIS = certrack.load(CASE)
METHODS = ("taylor", "scipy", "implicit")


@pytest.fixture(scope="module")
def runs():
    return {name: certrack.simulate(AXIS, integrator=name) for name in METHODS}


def test_the_axis_sticks_and_slides_to_the_end(runs):
    with within(20):  # it took 51 s to the step limit
        run = certrack.simulate(AXIS)
    assert run.outcome is certrack.Outcome.finished
    assert run.trajectory.method == "taylor"
    (note,) = run.notes
    assert note.startswith("Stuck at v = 0")
    held = run.trajectory.modes.intervals(0, run.trajectory.end)
    assert len(held) == 10
    for begin, end in held:
        inside = np.linspace(begin, end, 50)[1:-1]
        q, v = run.trajectory.interpolate(inside)[:2]
        assert np.abs(v).max() == 0.0
        assert np.ptp(q) < 1e-15
    total = sum(end - begin for begin, end in held)
    assert total == pytest.approx(4.29838, abs=1e-5)
    assert run.metrics.tail_error == pytest.approx(0.00673110, abs=1e-7)


@pytest.mark.parametrize("name", METHODS[1:])
def test_methods_agree(runs, name):
    a, b = runs["taylor"], runs[name]
    t = np.linspace(0, 12, 2001)
    assert np.abs(a.trajectory.interpolate(t) - b.trajectory.interpolate(t))[:4].max() < 2e-7
    for x, y in zip(*(r.trajectory.modes.intervals(0, 12) for r in (a, b)), strict=True):
        assert np.abs(np.subtract(x, y)).max() < 1e-4  # where the speed hardly leaves zero
    assert a.metrics.input_energy == pytest.approx(b.metrics.input_energy, rel=1e-7)
    assert a.metrics.input_variation == pytest.approx(b.metrics.input_variation, rel=1e-4)


def test_the_sampled_loop_sticks_too():
    drive = AXIS.with_settings(duration=4, tail=2)
    drive = drive.replace(implementation=certrack.Implementation(period=0.002))
    by_heyoka, by_numpy = (certrack.simulate(drive, integrator=i) for i in ("auto", "scipy"))
    t = np.linspace(0, 4, 1001)
    a, b = (run.trajectory.interpolate(t)[:4] for run in (by_heyoka, by_numpy))
    assert np.abs(a - b).max() < 1e-9
    assert by_heyoka.outcome is certrack.Outcome.finished
    assert by_heyoka.notes[0].startswith("Stuck at v = 0")
    begin, end = by_heyoka.trajectory.modes.intervals(0, 4)[0]
    inside = np.linspace(begin, end, 99)[1:-1]
    assert np.abs(by_heyoka.trajectory.interpolate(inside)[1]).max() == 0.0
    continuous = certrack.simulate(AXIS.with_settings(duration=4, tail=2)).metrics.tail_error
    assert by_heyoka.metrics.tail_error == pytest.approx(continuous, abs=2e-5)


def test_an_ensemble_finishes():
    short = AXIS.with_settings(duration=2, tail=1)
    found = certrack.ensemble(short, 4)
    assert found.summary()["outcomes"] == {"finished": 4}
    alone = certrack.simulate(found.member(2)).metrics
    members = found.frame()
    assert members.tail_error[2] == pytest.approx(alone.tail_error, abs=1e-6)
    assert members.input_variation[2] == pytest.approx(alone.input_variation, rel=1e-3)
    assert members.integral_abs_error[2] == pytest.approx(alone.integral_abs_error, rel=1e-3)

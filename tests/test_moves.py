"""Metrics of every move: against formulas, and as the command prints them."""

import json
import math

import numpy as np
import pytest

import certrack
from certrack.cli import main
from certrack.core.errors import InputError
from certrack.plotting import reference_figure
from certrack.references import SymbolicReference, scurve, steps, triangle
from certrack.references.rests import MoveTimes, moves_of
from certrack.reports.runs import SHOWN_MOVES, moves_table
from certrack.simulation.moves import MOVE_LABELS, measure_moves

DECAY, FREQUENCY = 2.0, 5.0


def response(target, sign=1.0):
    """A step at 0.5 of size 1 that arrives at 1, then e^(-2 s) cos(5 s) above the target."""
    t = np.linspace(0, 5, 200_001)
    y_d = np.where(t < 1, np.clip((t - 0.5) / 0.5, 0, 1), 1.0)
    e = np.where(t < 1, 0.3 * np.sin(math.pi * np.clip(t - 0.5, 0, 0.5)), 0.0)
    s = t - 1
    late = 0.3 * np.exp(-DECAY * s) * np.cos(FREQUENCY * s)
    e = np.where(t < 1, e, late)
    return t, target + sign * (y_d - 1 + e), target + sign * (y_d - 1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_decaying_response_is_measured(sign):
    t, y, y_d = response(2.0, sign)
    move = MoveTimes(0.5, 1.0, 5.0, 2.0 - sign, 2.0)
    (found,) = measure_moves([move], t, y, y_d, band=0.05)
    assert found.following_error == pytest.approx(0.3, abs=1e-4)
    assert found.overshoot == pytest.approx(0.3, abs=1e-4)
    s = np.linspace(0, 4, 4_000_001)
    late = 0.3 * np.exp(-DECAY * s) * np.abs(np.cos(FREQUENCY * s))
    assert found.settling_time == pytest.approx(s[np.flatnonzero(late > 0.05)[-1]], abs=1e-4)
    assert found.rest_error == pytest.approx(late[s >= 2].max(), rel=1e-6)
    assert found.band == 0.05


def test_the_band_is_a_share_of_the_move_and_may_never_be_reached():
    t, y, y_d = response(2.0)
    move = MoveTimes(0.5, 1.0, 5.0, 1.0, 2.0)
    (found,) = measure_moves([move], t, y, y_d, None)
    assert found.band == 0.05
    (found,) = measure_moves([move._replace(until=1.3)], t, y, y_d, 1e-3)
    assert math.isnan(found.settling_time)
    assert found.as_dict()["settling_time"] is None
    (found,) = measure_moves([move], t, y_d, y_d, None)
    assert (found.settling_time, found.overshoot, found.rest_error) == (0.0, 0.0, 0.0)


def test_a_move_that_ends_where_it_began_has_no_overshoot():
    t, y, y_d = response(2.0)
    (found,) = measure_moves([MoveTimes(0.5, 1.0, 5.0, 2.0, 2.0)], t, y, y_d, None)
    assert math.isnan(found.overshoot)


def test_moves_are_what_lies_between_rests():
    made = scurve((0, 1, 0), speed=1, acceleration=4, jerk=40, dwell=0.5, start=0.25)
    first, second = moves_of(made, 10.0)
    assert (first.begin, first.origin, first.target) == (0.25, 0.0, 1.0)
    assert second.begin == pytest.approx(first.arrival + 0.5)
    assert (second.until, second.target) == (10.0, pytest.approx(0.0, abs=1e-12))
    assert first.until == second.begin
    assert moves_of(made, first.arrival - 0.01) == ()  # it has not arrived
    assert len(moves_of(made, first.arrival + 0.01)) == 1
    assert [m.target for m in moves_of(steps((1, 4), (0, 1, 0.5), 2.0), 9)] == [1.0, 0.5]


@pytest.mark.parametrize("made", [triangle(1, 2), SymbolicReference("sin(t)")])
def test_what_never_rests_has_no_moves(made):
    assert moves_of(made, 10.0) == ()


def test_without_a_dwell_there_is_one_move():
    made = scurve((0, 1, 0.5), speed=1, acceleration=4, jerk=40)
    (move,) = moves_of(made, 10.0)
    assert (move.origin, move.target) == (0.0, pytest.approx(0.5, rel=1e-15))


def test_a_run_measures_its_moves():
    system = certrack.load("point-to-point").with_settings(duration=1.9, tail=None)
    run = certrack.simulate(system)
    first, second = run.moves
    assert first.origin == 0.0
    assert (first.target, second.target) == (pytest.approx(0.4), pytest.approx(0.1))
    t = np.linspace(second.begin, second.arrival, 20_001)
    e = np.abs(run.trajectory.interpolate(t)[0] - system.reference.values(t, 0)[0])
    assert second.following_error == pytest.approx(e.max(), rel=1e-6)
    assert second.band == system.settings.band
    assert run.summary()["moves"] == [move.as_dict() for move in run.moves]


def printed(capfd, *arguments):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 0
    return capfd.readouterr().out


def test_the_command_prints_moves(capfd, monkeypatch):
    monkeypatch.setenv("COLUMNS", "130")
    shown = printed(capfd, "simulate", "point-to-point")
    for label in MOVE_LABELS.values():
        assert label in shown
    found = json.loads(printed(capfd, "simulate", "point-to-point", "--json"))
    assert len(found["moves"]) == 6
    assert found["moves"][0]["target"] == pytest.approx(0.4)


def test_of_many_moves_the_table_shows_the_first_and_the_largest():
    rows = [dict.fromkeys(MOVE_LABELS, float(i)) for i in range(40)]
    rows[-1]["settling_time"] = None
    made = moves_table(rows)
    assert len(made.rows) == SHOWN_MOVES + 1
    assert list(made.rows[-1]) == ["largest of 40", "", "", "", "39", "39", "38", "39"]


def test_the_picture_of_a_reference_has_a_panel_per_derivative_and_its_bounds():
    made = scurve((0, 1), speed=1, acceleration=4, jerk=40)
    drawing = reference_figure({"fast": made}, 2.0, unit="m")
    labels = [axes.get_ylabel() for axes in drawing.axes]
    assert labels == ["position [m]", "speed [m/s]", "acceleration [m/s²]", "jerk [m/s³]"]
    for i, axes in enumerate(drawing.axes):
        heights = {round(abs(line.get_ydata()[0]), 9) for line in axes.lines[1:]}
        assert heights == {round(made.bounds(i).values[i], 9)}
    assert len(reference_figure({"": made}, 2.0, order=1, bounds=False).axes) == 2
    with pytest.raises(InputError, match="at least one"):
        reference_figure({}, 1.0)
    with pytest.raises(InputError, match="order"):
        reference_figure({"": made}, 1.0, order=4)

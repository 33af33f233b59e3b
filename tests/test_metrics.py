"""Metrics on signals whose values are known, with their order of convergence."""

import math

import numpy as np
import pytest
from test_tuning_drive import RANGED_DRIVE

import certrack
from certrack.simulation.metrics import (
    _crossing,
    _integral_of_magnitude,
    _interpolate,
    _most_promising,
    _tail_candidates,
    measure,
    settling_band,
    supremum,
)
from certrack.simulation.refine import Candidates


def order(error, counts=(200, 400, 800)):
    errors = [error(n) for n in counts]
    return [math.log2(a / b) for a, b in zip(errors[:-1], errors[1:], strict=True)]


def test_supremum_converges_with_order_three_or_more():
    def error(n):  # the worst over where the peak falls between the samples
        found = []
        for shift in np.linspace(0, 0.02, 37):
            t = shift + np.linspace(0, 3, n) ** 1.1  # not equidistant
            found.append(abs(supremum(t, np.sin(t + 0.1) * np.exp(0.1 * t)) - exact))
        return max(found)

    peak = math.atan(-10) + math.pi  # derivative of sin(s) exp(0.1 (s - 0.1)) is zero there
    exact = math.sin(peak) * math.exp(0.1 * (peak - 0.1))
    assert min(order(error)) > 2.7


def test_crossing_converges_with_order_four():
    def error(n):  # the worst over where the crossing falls between the samples
        found = []
        for shift in np.linspace(0, 0.2, 23):
            t = shift + np.linspace(0, 1.5, n)
            f = np.cos(t) - 0.3
            i = int(np.flatnonzero(f > 0)[-1])
            found.append(abs(_crossing(t, f, i) - math.acos(0.3)))
        return max(found)

    assert min(order(error, (20, 40, 80))) > 3.5


def test_integral_of_magnitude_is_exact_to_order_four():
    def error(n):
        t = np.linspace(0, 10, n)
        return abs(_integral_of_magnitude(t, np.cos(t), np.sin(t)) - exact) + 1e-16

    exact = _by_pieces()
    assert min(order(error, (50, 100, 200))) > 3.3


def _by_pieces():
    zeros = [0.0, *(math.pi / 2 + k * math.pi for k in range(3)), 10.0]
    values = [abs(math.sin(b) - math.sin(a)) for a, b in zip(zeros[:-1], zeros[1:], strict=True)]
    return sum(values)


def test_settling_and_tail():
    t = np.linspace(0, 10, 2001)
    e = np.exp(-t)
    running = np.vstack([t, 0.5 - 0.5 * np.exp(-2 * t), 1 - np.exp(-t)])
    found = measure(t, e, np.ones_like(t), running, band=0.05, tail_start=5)
    assert found.settling_time == pytest.approx(-math.log(0.05), abs=1e-8)
    assert found.tail_error == pytest.approx(math.exp(-5))
    assert found.integral_abs_error == pytest.approx(1 - math.exp(-10))
    assert found.rms_error == pytest.approx(math.sqrt(0.05 * (1 - math.exp(-20))))
    assert found.input_energy == 10
    assert found.integral_squared_error == pytest.approx(0.5 - 0.5 * math.exp(-20))
    assert found.input_variation == 0


def test_never_settled_is_missing_and_always_settled_is_zero():
    t = np.linspace(0, 1, 11)
    running = np.zeros((3, 11))
    never = measure(t, np.ones(11), t, running, band=0.5, tail_start=0)
    assert never.as_dict()["settling_time"] is None
    assert measure(t, np.zeros(11), t, running, 0.5, 0).settling_time == 0


def test_no_parabola_reaches_across_a_jump_between_steps():
    t = np.array([0, 0.004, 0.009, 0.009, 0.02, 0.044])
    u = np.array([-0.2, -0.1, -0.08, 4.77, 4.65, 4.53])  # jumps where one step ends
    assert supremum(t, u, per_step=3) == 4.77
    assert supremum(t[1:], u[1:], per_step=3, offset=1) == 4.77
    smooth = np.array([0.0, 0.9, 1.0, 1.0, 0.9, 0.0])
    assert 1.0 <= supremum(np.array([0, 1, 2, 2, 3, 4.0]), smooth, per_step=3) < 1.1


def test_a_crossing_between_samples_that_do_not_fall_is_that_of_the_line():
    """Where the samples before it rise, or those after it are equal, no inverse exists."""
    t = np.array([0.0, 1.0, 3.0, 4.0])
    assert _crossing(t, np.array([3.0, 2.0, -1.0, -1.0]), 1) == pytest.approx(1 + 2 * 2 / 3)
    assert _crossing(t, np.array([2.0, 2.0, -1.0, -3.0]), 1) == pytest.approx(1 + 2 * 2 / 3)
    assert _crossing(t, np.array([1.0, 2.0, -1.0, -2.0]), 1) == pytest.approx(1 + 2 * 2 / 3)
    t, zero = np.arange(4.0), (math.sqrt(2) - 1) / 0.2
    f = 2.5 - t - 0.1 * t**2  # and otherwise of a cubic, t as a function of f
    assert abs(_crossing(t, f, 2) - zero) < 1e-3 < abs(2 + f[2] / (f[2] - f[3]) - zero)


@pytest.mark.parametrize("count", [4, 5, 9])
def test_a_crossing_is_exact_where_t_is_a_cubic_of_f(count):
    """Wherever among the samples it lies, also between the first two and the last two."""
    for i in range(count - 1):
        f = 1.7 * np.arange(i, i - count, -1.0) + 0.6 + 0.1 * np.cos(np.arange(count))
        f -= f[i] - 0.7  # above zero at i alone of i and i + 1
        t = 3.0 - 1.3 * f + 0.02 * f**2 - 0.005 * f**3
        assert f[i] > 0 > f[i + 1] and (np.diff(t) > 0).all()
        assert _crossing(t, f, i) == pytest.approx(3.0, abs=1e-12)


@pytest.mark.parametrize("count", [4, 5, 9])
def test_a_value_between_samples_is_exact_for_cubics(count):
    """Just before any sample, also before the first ones and the last."""
    t = np.cumsum(1 + 0.3 * np.cos(np.arange(count)))
    f = 2 - t + 0.3 * t**2 - 0.05 * t**3
    for i in range(1, count):
        at = t[i] - 0.4
        expected = 2 - at + 0.3 * at**2 - 0.05 * at**3
        assert _interpolate(t, f, at, i) == pytest.approx(expected, rel=1e-11, abs=1e-11)
    few, twice = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 1.0, 2.0])
    assert _interpolate(few, few**2, 1.5, 2) == 2.5  # by the line
    assert _interpolate(twice, twice**2, 1.5, 3) == 2.5


PEAKS = Candidates(
    begins=np.array([0.0, 2.0, 4.0]),
    ends=np.array([1.0, 3.0, 5.0]),
    signs=np.array([1.0, -1.0, 1.0]),
    sampled=np.array([0.9, 0.8, 0.5]),
    estimates=np.array([0.94, 0.96, 0.99]),
)


@pytest.mark.parametrize(
    ("start", "kept"), [(0.0, [1, 2]), (2.5, [1, 2]), (3.0, [2]), (4.5, [2]), (5.0, [])]
)
def test_peaks_of_the_tail_that_may_exceed_its_samples_are_refined(monkeypatch, start, kept):
    """Twice the gain of the parabola must reach beyond the largest sample: 0.98, 1.12, 1.48."""
    monkeypatch.setattr("certrack.simulation.metrics.candidates", lambda *_: PEAKS)
    t = np.linspace(0.0, 6.0, 7)
    best, late = _tail_candidates(t, np.array([3.0, 0, 0, 0, 0, 1, -1]), start, 3)
    best_of_all = 3.0 if start == 0 else 1.0
    assert best == best_of_all
    if start == 0:
        assert len(late.begins) == 0  # none reaches 3
        best, late = _tail_candidates(t, np.array([1.0, 0, 0, 0, 0, 1, -1]), start, 3)
        assert best == 1.0
    assert late.estimates.tolist() == PEAKS.estimates[kept].tolist()
    assert late.begins.tolist() == np.maximum(PEAKS.begins[kept], start).tolist()
    assert late.ends.tolist() == PEAKS.ends[kept].tolist()


def test_beyond_the_run_there_is_no_tail(monkeypatch):
    monkeypatch.setattr("certrack.simulation.metrics.candidates", lambda *_: PEAKS)
    best, late = _tail_candidates(np.linspace(0, 6, 7), np.zeros(7), 6.5, 3)
    assert math.isnan(best) and len(late.begins) == 0


def test_the_most_promising_are_those_of_the_largest_merit():
    merit = np.array([0.2, 0.9, 0.5])
    assert _most_promising(PEAKS, merit, 2).estimates.tolist() == [0.96, 0.99]
    assert _most_promising(PEAKS, merit, 1).estimates.tolist() == [0.96]
    assert _most_promising(PEAKS, merit, 4) is PEAKS


@pytest.mark.parametrize("order", [1, -1])
def test_the_peak_of_the_neighbouring_step_counts(order):
    """The largest sample ends one step (or begins it); the parabola beside it reaches higher."""
    t = np.array([0.0, 1, 2, 2, 3, 4])
    f = np.array([0.0, 0.5, 1.0, 0.99, 0.99, 0.5])
    t, f = (t, f) if order == 1 else (4 - t[::-1], f[::-1])
    assert supremum(t, f, per_step=3) == pytest.approx(0.99 + 0.06125)
    if order == 1:  # seen from the second sample of its step on
        assert supremum(t[1:], f[1:], per_step=3, offset=1) == pytest.approx(0.99 + 0.06125)


@pytest.mark.parametrize("order", [1, -1])
def test_the_peak_beside_the_largest_sample_counts(order):
    """The parabola around the next sample, on either side, may be the one that reaches highest."""
    f = np.array([0.98, 1.0, 0.99, 0.3])[::order]
    assert supremum(np.arange(4.0), f) == pytest.approx(0.99 + 0.35**2 / (2 * 0.68))


def test_the_settling_band_is_a_share_of_the_largest_reference():
    system = certrack.load("example1").with_settings(band=None)
    for text, size in (
        ("0.3*sin(5*t)", 0.3),
        ("0.1*cos(t) + 1", 1.1),
        ("0*t", 1.0),
        ("exp(-3*t)", 1.0),
    ):
        reference = certrack.SymbolicReference(text)
        assert settling_band(system.settings, reference) == pytest.approx(0.05 * size, rel=1e-6)
    assert settling_band(system.with_settings(band=0.2).settings, reference) == 0.2


@pytest.mark.parametrize("start", [0.5, 1.7, 3.9])
def test_a_tail_that_begins_between_samples_begins_on_their_cubic(start):
    t = np.arange(5.0)
    e = 70 - t**3 + 0.5 * t
    found = measure(t, e, t, np.zeros((3, 5)), band=1.0, tail_start=start)
    assert found.tail_error == pytest.approx(70 - start**3 + 0.5 * start, rel=1e-12)


def test_a_tail_that_begins_inside_a_step_keeps_the_steps_apart():
    t = np.array([0.0, 1, 2, 2, 3, 4])
    e = np.array([0.0, 0.5, 1.0, 0.99, 0.99, 0.5])
    found = measure(t, e, e, np.zeros((3, 6)), band=2.0, tail_start=1.0, per_step=3)
    assert found.tail_error == pytest.approx(0.99 + 0.06125)


def test_the_band_itself_is_inside():
    t, e = np.arange(4.0), np.array([2.0, 0.5, 0.5, 0.5])
    assert measure(t, e, t, np.zeros((3, 4)), band=0.5, tail_start=0).settling_time == 1.0


def test_the_nearest_samples_make_the_cubic():
    t = np.arange(8.0)
    found = measure(t, 3000 - t**4, t, np.zeros((3, 8)), band=1.0, tail_start=2.5)
    assert abs(found.tail_error - (3000 - 2.5**4)) <= 0.57


def test_an_error_of_rounding_alone_has_metrics():
    """Undisturbed, from the reference's own start: sums of squares may fall below zero."""
    axis = certrack.loads(RANGED_DRIVE).replace(implementation=None)
    assert 0 <= certrack.simulate(axis).metrics.rms_error < 1e-12

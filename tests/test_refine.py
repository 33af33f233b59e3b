"""Refined extremes and crossings of signals whose extremes and crossings are known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import certrack
from certrack.simulation import metrics
from certrack.simulation.metrics import (
    SETTLING_SHARE,
    _integral_of_magnitude,
    _most_promising,
    measure,
    settling_band,
    supremum,
)
from certrack.simulation.refine import (
    MAX_REFINED,
    POINTS,
    ROUNDS,
    Candidates,
    Crossings,
    candidates,
    refine,
)

#: Between points of the last grid on an interval of length 1: every round keeps two spacings.
SPACING = (2 / (len(POINTS) - 1)) ** (ROUNDS - 1) / (len(POINTS) - 1)


def interval(sign, begin=0.0, end=1.0):
    nothing = np.array([-np.inf])
    return Candidates(np.array([begin]), np.array([end]), np.array([sign]), nothing, nothing)


def fall(sign, level=0.0, begin=0.0, end=1.0):
    return Crossings(np.array([begin]), np.array([end]), np.array([sign]), level)


def peak(f, sign=1.0, *, smooth=True, begin=0.0, end=1.0):
    found, none = refine(lambda t: f(t)[None], [(0, interval(sign, begin, end))], [], smooth=smooth)
    assert none == []
    return float(found[0][0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("top", np.linspace(0, 1, 40))
def test_newtons_step_finds_the_vertex_of_a_parabola_exactly(sign, top):
    found = peak(lambda t: sign * (2 - 3 * (t - top) ** 2), sign)
    assert found == pytest.approx(2, abs=1e-14)
    found = peak(lambda t: sign * (2 - 3 * (t - 7 * top) ** 2), sign, begin=-0.5, end=7.5)
    assert found == pytest.approx(2, abs=1e-13)


@pytest.mark.parametrize("top", np.linspace(0, 1, 40))
def test_a_kink_is_found_to_half_a_spacing_and_never_exceeded(top):
    sharp = lambda t: 1 - np.abs(t - top)  # noqa: E731
    assert 1 - SPACING / 2 - 1e-15 <= peak(sharp, smooth=False) <= 1
    assert peak(lambda t: -sharp(t), -1.0, smooth=False) <= 1
    jump = lambda t: np.where(t <= top, t, t - 5)  # noqa: E731
    assert top - SPACING <= peak(jump, smooth=False) <= top


@pytest.mark.parametrize("f", [lambda t: 3 * t, lambda t: t**2 - 4 * t, lambda t: 0 * t + 0.25])
def test_an_extreme_at_an_end_is_no_more_than_the_end(f):
    ends = f(np.array([0.0, 1.0]))
    assert peak(f) == pytest.approx(max(ends), abs=1e-15)
    assert peak(f, -1.0) == pytest.approx(max(-ends), abs=1e-15)


def test_newtons_step_converges_with_order_four():
    def error(length):
        tops = length * np.array([0.31, 0.43, 0.57])
        found = [peak(lambda t, p=p: np.cos(t - p) + (t - p) ** 3, end=length) for p in tops]
        return np.abs(np.array(found) - 1).max()

    assert np.log2(error(4.0 / 3) / error(2.0 / 3)) > 3.5


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("zero", np.linspace(0.013, 1, 40))
def test_a_crossing_of_a_line_is_exact_and_of_a_curve_of_second_order(sign, zero):
    def dense(t):
        return np.array([sign * (0.7 - 2 * (t - zero)), np.exp(zero - t) - 1])

    crossings = [(0, fall(sign, 0.7)), (1, fall(1.0))]
    none, found = refine(dense, [], crossings, smooth=True)
    assert none == []
    assert found[0][0] == pytest.approx(zero, abs=1e-14)
    assert abs(found[1][0] - zero) <= SPACING**2 / 8


def test_the_last_of_several_crossings_counts():
    wave = lambda t: np.cos(9 * t)[None]  # noqa: E731  falls through 0 at pi/18 and 5 pi/18
    _, found = refine(wave, [], [(0, fall(1.0))], smooth=True)
    assert found[0][0] == pytest.approx(5 * np.pi / 18, abs=9 * SPACING**2)


def test_where_a_signal_stays_above_the_crossing_is_the_end():
    _, found = refine(lambda t: (2 + 0 * t)[None], [], [(0, fall(1.0))], smooth=True)
    assert found[0][0] == 1.0
    _, found = refine(lambda t: np.where(t < 1, 1.0, 0.0)[None], [], [(0, fall(1.0))], smooth=True)
    assert found[0][0] == 1.0


def test_searches_of_several_signals_do_not_mix():
    """Each asks its own row, on its own intervals, with its own sign and level."""

    def dense(t):
        return np.array([1 - (t - 0.3) ** 2, 5 + (t - 2.4) ** 2, 4 - t])

    two = Candidates(
        np.array([2.0, 0.0]), np.array([3.0, 1.0]), np.array([-1.0, -1.0]), *2 * [np.zeros(2)]
    )
    extremes = [(0, interval(1.0)), (1, two)]
    crossings = [(2, fall(1.0, 1.5, 2.0, 3.0)), (2, fall(1.0, 0.25, 3.0, 5.0))]
    peaks, times = refine(dense, extremes, crossings, smooth=True)
    assert [list(p) for p in peaks] == [
        pytest.approx([1.0], abs=1e-14),
        pytest.approx([-5.0, -5 - 1.4**2], abs=1e-13),
    ]
    assert [list(p) for p in times] == [
        pytest.approx([2.5], abs=1e-13),
        pytest.approx([3.75], abs=1e-13),
    ]
    nothing = np.empty(0)
    none = Candidates(nothing, nothing, nothing, nothing, nothing)
    peaks, times = refine(dense, [(0, none)], [], smooth=True)
    assert [len(p) for p in peaks] == [0] and times == []


@pytest.mark.parametrize("per_step", [3, 4, 7])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_parabolas_vertex_is_a_candidate_wherever_it_lies_in_a_step(per_step, sign):
    """Three steps of length 2; the estimate of the vertex is exact, and it lies in the interval."""
    t = np.concatenate([2 * k + np.linspace(0, 2, per_step) for k in range(3)])
    for top in np.linspace(0.03, 5.97, 50):
        f = sign * (3 - 0.5 * (t - top) ** 2)
        found = candidates(t, f, per_step)
        inside = (found.begins <= top) & (top <= found.ends)
        assert inside.any()
        assert (found.signs == sign).all()
        assert found.estimates[inside] == pytest.approx(3, abs=1e-13)
        h = 2 / (per_step - 1)
        assert found.ends - found.begins == pytest.approx(2 * h, abs=1e-13)
        near = np.abs(t[:, None] - (found.begins + found.ends) / 2) <= h * (1 + 1e-9)
        largest = [max((sign * f)[column]) for column in near.T]
        assert found.sampled <= np.array(largest) + 1e-15
        assert found.sampled[inside] >= 3 - 0.5 * (h / 2) ** 2 - 1e-13


def test_a_vertex_far_outside_of_a_step_is_no_candidate():
    t = np.linspace(0, 1, 5)
    for top in (-0.2, 1.2, 7.0):
        assert len(candidates(t, -((t - top) ** 2), 5).begins) == 0
    assert len(candidates(t, 3 * t, 5).begins) == 0
    assert len(candidates(t, 0 * t, 5).begins) == 0


def test_candidates_are_of_steps_of_three_samples_and_of_finite_size():
    t = np.linspace(0, 1, 6)
    f = -((t - 0.2) ** 2)
    assert len(candidates(t, f, 2).begins) == 0
    assert len(candidates(t, f, 4).begins) == 0  # the samples are no whole steps
    assert len(candidates(t, f, 3).begins) == 1
    assert len(candidates(t[:3], 3 * MAX_REFINED * np.array([0.5, 1.0, 0.4]), 3).begins) == 0


def test_some_candidates_are_some_of_each_column():
    columns = [np.arange(3.0) + 10 * k for k in range(5)]
    some = Candidates(*columns).only(np.array([True, False, True]))
    found = (some.begins, some.ends, some.signs, some.sampled, some.estimates)
    for column, part in zip(columns, found, strict=True):
        assert list(part) == [column[0], column[2]]


def run(e, u, integral, end, steps, per_step):
    """Samples of a run with equal steps, and its dense output."""
    t = np.concatenate(
        [np.linspace(a, b, per_step) for a, b in pairwise(np.linspace(0, end, steps + 1))]
    )
    running = np.array([0.5 * t, 0.25 * t, integral(t)])
    return t, e(t), u(t), running, lambda s: np.array([e(s), u(s), integral(s)])


@pytest.mark.parametrize("per_step", [4, 5])
@pytest.mark.parametrize("phase", np.linspace(0, 6, 7))
def test_metrics_are_those_of_a_grid_that_is_a_thousand_times_finer(phase, per_step):
    """Of e = cos(2 t + p) exp(-t/4) and u = 1.3 sin(3 t + p) + t/2, on 29 steps."""

    def e(t):
        return np.cos(2 * t + phase) * np.exp(-t / 4)

    def u(t):
        return 1.3 * np.sin(3 * t + phase) + t / 2

    def integral(t):
        values = np.exp((2j - 0.25) * t + 1j * phase) / (2j - 0.25)
        return values.real - (np.exp(1j * phase) / (2j - 0.25)).real

    *samples, dense = run(e, u, integral, 7.0, 29, per_step)
    fine = np.linspace(0, 7, 7 * 29 * 1000 + 1)
    outside = fine[np.abs(e(fine)) > 0.4]
    h = fine[1]
    for start in (-1.0, 0.0, 2.0, 3.333, 7.0):
        found = measure(*samples, 0.4, start, per_step, dense)
        assert found.settling_time == pytest.approx(outside[-1], abs=h)
        assert found.peak_input == pytest.approx(np.abs(u(fine)).max(), abs=2 * h**2)
        assert found.input_variation == pytest.approx(np.abs(np.diff(u(fine))).sum(), abs=1e-6)
        tail = np.abs(e(np.append(fine[fine >= start], max(start, 0))))
        assert found.tail_error == pytest.approx(tail.max(), abs=2 * h**2)
        size = np.abs(e(fine))
        area = h * (size.sum() - (size[0] + size[-1]) / 2)
        assert found.integral_abs_error == pytest.approx(area, abs=1e-8)
        assert found.input_energy == 3.5 and found.integral_squared_error == 1.75
        assert found.rms_error == 0.5
    assert np.isnan(measure(*samples, 0.4, 7.001, per_step, dense).tail_error)
    assert measure(*samples, 2.0, 0.0, per_step, dense).settling_time == 0
    assert np.isnan(measure(*samples, 1e-9, 0.0, per_step, dense).settling_time)
    kinked = measure(*samples, 0.4, 3.333, per_step, dense, smooth=False)
    assert kinked.peak_input == pytest.approx(np.abs(u(fine)).max(), abs=1e-4)


def test_of_too_many_extremes_those_of_the_largest_merit_are_refined():
    columns = [np.arange(4.0) + 10 * k for k in range(5)]
    where, merit = Candidates(*columns), np.array([2.0, 5.0, 1.0, 3.0])
    assert list(_most_promising(where, merit, 2).begins) == [1, 3]
    for enough in (4, 5):
        assert _most_promising(where, merit, enough) is where


def test_extremes_beyond_the_limit_keep_their_samples(monkeypatch):
    """Those that gain most are refined, here three of 80."""

    def signal(t):
        return np.sin(t) * (1 + t / 10)

    *samples, dense = run(signal, signal, lambda t: 0 * t, 80 * np.pi, 200, 5)
    t, _, u, _ = samples
    found = candidates(t, u, 5)
    gains = np.sort(found.estimates - found.sampled)
    every = measure(*samples, 0.1, 0.0, 5, dense)
    monkeypatch.setattr(metrics, "MAX_EXTREMES", 3)
    few = measure(*samples, 0.1, 0.0, 5, dense)
    sampled = np.abs(np.diff(u)).sum()
    assert few.input_variation - sampled == pytest.approx(2 * gains[-3:].sum(), rel=0.15)
    assert every.input_variation - sampled == pytest.approx(2 * gains.sum(), rel=0.15)
    assert few.tail_error == every.tail_error


def test_the_settling_band_looks_at_the_reference_and_not_at_its_slope():
    settings = certrack.load("example1").settings
    reference = certrack.SymbolicReference("0.3*sin(5*t)")
    band = settling_band(replace(settings, band=None), reference)
    assert band == pytest.approx(SETTLING_SHARE * 0.3, rel=1e-6)


def test_the_integral_of_what_keeps_its_sign_is_a_difference():
    t = np.linspace(0, 1, 6)
    for sign in (1, -1):
        found = _integral_of_magnitude(t, sign * (1 + 0 * t), 5 + sign * t)
        assert found == pytest.approx(1, abs=1e-15)


@pytest.mark.parametrize("zero", [0.1, 0.5, 0.77])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_integral_of_a_line_that_changes_sign_is_exact(zero, sign):
    t = np.array([0.0, 0.3, 1.0])
    found = _integral_of_magnitude(t, sign * (zero - t), 7 + sign * (zero * t - t**2 / 2))
    assert found == pytest.approx((zero**2 + (1 - zero) ** 2) / 2, abs=1e-14)


@pytest.mark.parametrize("order", [1, -1])
def test_only_the_neighbours_of_the_largest_sample_may_have_the_peak(order):
    f = np.array([0.95, 0.965, 0.98, 1.0, 0.99, 0.3, 0.2, 0.0])[::order]
    assert supremum(np.arange(8.0), f) == pytest.approx(0.99 + 0.35**2 / (2 * 0.68))


def test_where_no_parabola_exists_the_largest_sample_counts():
    assert supremum(np.array([0.0, 1, 1]), np.array([0.2, 0.5, 0.4])) == 0.5
    assert supremum(np.array([0.0, 0, 1]), np.array([0.2, 0.5, 0.4])) == 0.5
    assert supremum(np.arange(3.0), MAX_REFINED * np.array([0.2, 0.5, 0.4])) == 0.5 * MAX_REFINED
    assert supremum(np.arange(3.0), np.array([0.0, 0.5, 1.0])) == 1.0
    assert np.isnan(supremum(np.empty(0), np.empty(0)))


def test_a_run_that_ends_where_it_begins_has_no_mean():
    found = measure(np.zeros(1), np.ones(1), np.ones(1), np.zeros((3, 1)), 2.0, 0.0)
    assert np.isnan(found.settling_time) and np.isnan(found.rms_error)
    assert found.tail_error == 1 and found.peak_input == 1

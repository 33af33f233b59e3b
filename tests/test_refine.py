"""Refined extremes and crossings of signals whose extremes and crossings are known."""

import numpy as np
import pytest

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

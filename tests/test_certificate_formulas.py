"""Parts of the certificates by themselves, against closed forms and identities."""

import math
from dataclasses import replace
from fractions import Fraction
from itertools import product
from types import SimpleNamespace

import flint
import numpy as np
import pytest

import certrack
from certrack.certificates.adaptation import MAX_PARAMETERS_WITH_FULL_GAMMA, Adaptation
from certrack.certificates.arithmetic import rational
from certrack.certificates.balls import ball_precision
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.domain import Condition, _zero_between
from certrack.certificates.reference_premise import _proves, reference_premise
from certrack.certificates.sampling import Points
from certrack.certificates.start import UNPROVEN_RADIUS, reference_at_start
from certrack.certificates.worst_profile import (
    STOPPING_TIMES,
    _one_step_later,
    _reached,
    stopping_widths,
    worst_profile,
)
from certrack.core.expressions import parse, symbol
from certrack.references import triangle

# what the update laws add


def exact(rows):
    """A table of rationals."""
    return np.array([rational(v) for v in np.ravel(np.array(rows, dtype=object))]).reshape(
        np.shape(rows)
    )


def adaptation(Gamma, box, theta0, **others):
    """Of numbers that all differ, so that none can stand for another."""
    numbers = {
        "gain_rate": "3/2",
        "leak_gain": "1/5",
        "leak_theta": "1/3",
        "gains": ("2", "7/2"),
        "delta0": "-1/4",
    } | others
    return Adaptation(
        gain_rate=rational(numbers["gain_rate"]),
        leak_gain=rational(numbers["leak_gain"]),
        leak_theta=rational(numbers["leak_theta"]),
        Gamma=exact(Gamma),
        gains=tuple(map(rational, numbers["gains"])),
        delta0=rational(numbers["delta0"]),
        gain_sign=-1,
        theta0=exact(theta0),
        theta_box=tuple(tuple(map(rational, pair)) for pair in box),
        shift=rational(others.get("shift", "0")),
    )


BOX = (("-1", "2"), ("1/2", "3"))


@pytest.mark.parametrize("shift", ["0", "1/4", "-1/2"])
def test_a_full_metric_has_every_corner_of_the_box(shift):
    full = adaptation([["2", "1/2"], ["1/2", "1"]], BOX, ["1/3", "-1/5"], shift=shift)
    kappa = 1 + Fraction(shift)
    expected = {
        (kappa * Fraction(a) - Fraction("1/3"), kappa * Fraction(b) + Fraction("1/5"))
        for a, b in product(*BOX)
    }
    found = {tuple(Fraction(int(v.p), int(v.q)) for v in corner) for corner in full.theta_offsets()}
    assert found == expected and len(full.theta_offsets()) == 4


def test_a_parameter_that_is_known_has_one_end():
    full = adaptation([["2", "1/2"], ["1/2", "1"]], (("1", "1"), BOX[1]), ["0", "0"])
    assert len(full.theta_offsets()) == 2


def test_a_diagonal_metric_needs_the_farthest_corner_alone():
    diagonal = adaptation([["2", "0"], ["0", "1"]], BOX, ["1/3", "5/2"])
    (corner,) = diagonal.theta_offsets()
    assert list(corner) == [rational("5/3"), rational("-2")]  # 2 - 1/3, and 1/2 - 5/2
    (other,) = diagonal.theta_offsets(exact(["1", "0"]))  # farthest from (1, 0): (-1, 3)
    assert list(other) == [rational("-4/3"), rational("1/2")]


@pytest.mark.parametrize("count", [MAX_PARAMETERS_WITH_FULL_GAMMA, 13])
def test_a_full_metric_of_too_many_parameters_is_refused(count):
    Gamma = [
        [Fraction(2) if i == j else Fraction(i + j == 1) for j in range(count)]
        for i in range(count)
    ]
    many = adaptation(Gamma, [("0", "0")] * count, [0] * count)
    if count == MAX_PARAMETERS_WITH_FULL_GAMMA:
        assert len(many.theta_offsets()) == 1
    else:
        with pytest.raises(NoCertificate, match="13 parameters"):
            many.theta_offsets()


@pytest.mark.parametrize("shift", [Fraction(0), Fraction(1, 3)])
def test_offsets_of_the_inverse_gain(shift):
    one = adaptation([["1"]], [("0", "0")], ["0"], shift=str(shift))
    expected = [(g, (1 - shift) * -1 / g + Fraction(1, 4)) for g in (Fraction(2), Fraction(7, 2))]
    assert [tuple(pair) for pair in one.delta_offsets()] == [
        (rational(g), rational(v)) for g, v in expected
    ]


def test_the_cost_of_the_leakage_is_the_largest_value_of_what_it_bounds():
    """With a diagonal metric each estimate has its own parabola, whose top is known."""
    one = adaptation([["2"]], [("-1", "2")], ["1/3"])
    alpha = Fraction(1, 10)
    gbar, gbar1, gbar2, gamma = Fraction(3, 2), Fraction(1, 5), Fraction(1, 3), Fraction(2)
    tops = [
        g * gbar1 * d**2 / (4 * (1 - alpha / (2 * gbar * gbar1)))
        for g, d in ((g, -1 / g + Fraction(1, 4)) for g in (Fraction(2), Fraction(7, 2)))
    ]
    top_theta = gbar2**2 * Fraction(5, 3) ** 2 / (4 * (gbar2 - alpha / 2 / gamma))
    assert one.leakage_cost(rational(alpha)) == rational(max(tops) + top_theta)


def test_the_cost_with_a_full_metric_is_that_of_the_worst_corner():
    """Of W = I/3 - (1/20) Gamma^{-1}, by Cramer's rule; |g| = 2 costs what it does alone."""
    full = adaptation([["2", "1/2"], ["1/2", "1"]], BOX, ["1/3", "-1/5"])
    alone = adaptation(np.zeros((0, 0)), (), np.zeros(0))
    a, b, d = (
        Fraction(1, 3) - Fraction(1, 20) * Fraction(4, 7),
        Fraction(1, 20) * Fraction(2, 7),
        Fraction(1, 3) - Fraction(1, 20) * Fraction(8, 7),
    )

    def form(x, y):
        x, y = Fraction(x) - Fraction(1, 3), Fraction(y) + Fraction(1, 5)
        return (d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b)

    worst = max(form(*corner) for corner in product(*BOX))
    assert full.leakage_cost(rational("1/10")) == alone.leakage_cost(rational("1/10")) + rational(
        worst / 9 / 4
    )


def test_there_is_no_cost_beyond_the_rates_of_the_leakage():
    gain = adaptation([["100"]], [("0", "0")], ["0"])  # alpha < 2 gbar gbar1 = 3/5
    assert gain.leakage_cost(rational("3/5")) is None
    assert gain.leakage_cost(rational("599/1000")) is not None
    theta = adaptation([["1/2"]], [("0", "0")], ["0"])  # alpha < 2 gbar2 Gamma = 1/3
    assert theta.leakage_cost(rational("1/3")) is None
    assert theta.leakage_cost(rational("333/1000")) is not None


def test_no_metric_that_is_indefinite_or_no_symmetric_one():
    for Gamma, fits in (
        ([["2", "1"], ["1", "1"]], True),
        ([["2", "1"], ["0", "1"]], False),
        ([["1", "2"], ["2", "1"]], False),
    ):
        found = adaptation(Gamma, BOX, ["0", "0"])
        assert found.gamma_is_positive_definite() == fits
        assert (found.leakage_cost(rational("1/100")) is not None) == fits
        assert found.in_floats().gamma_is_positive_definite()  # floats only guess


def test_the_energy_of_estimates():
    """|g| (1/g - delta_hat)^2/(2 gbar) + gap Gamma^{-1} gap/2, the worst of the ranges."""
    full = adaptation([["2", "1/2"], ["1/2", "1"]], BOX, ["1/3", "-1/5"])
    estimates = [Fraction(-3, 4), Fraction(1, 7), Fraction(2)]
    of_gain = max(g * (-1 / g - estimates[0]) ** 2 / 3 for g in (Fraction(2), Fraction(7, 2)))

    def of_gap(a, b):  # the inverse of [[2, 1/2], [1/2, 1]] is 4/7 [[1, -1/2], [-1/2, 2]]
        a, b = Fraction(a) - estimates[1], Fraction(b) - estimates[2]
        return Fraction(4, 7) * (a * a - a * b + 2 * b * b) / 2

    assert full.energy(exact(estimates)) == rational(
        of_gain + max(of_gap(*c) for c in product(*BOX))
    )
    assert full.in_floats().energy(np.array(estimates, dtype=float)) == pytest.approx(
        float(of_gain + max(of_gap(*c) for c in product(*BOX)))
    )
    diagonal = adaptation([["2", "0"], ["0", "1"]], BOX, ["1/3", "-1/5"])
    gaps = (Fraction(2) - estimates[1]) ** 2 / 2 + (Fraction(1, 2) - estimates[2]) ** 2
    assert diagonal.energy(exact(estimates)) == rational(of_gain + gaps / 2)
    without = adaptation(np.zeros((0, 0)), (), np.zeros(0))
    assert without.energy(exact(estimates[:1])) == rational(of_gain)


# the reference at t = 0


def at_start(reference, order):
    return reference_at_start(SimpleNamespace(reference=reference), order)


def test_the_reference_at_the_start_is_enclosed():
    """(1/3) cos 2t and its derivatives: no float is 1/3, its ball holds it."""
    reference = certrack.SymbolicReference("a*cos(w*t)", constants={"a": "1/3", "w": 2})
    with ball_precision():
        balls, proven = at_start(reference, 2)
        assert proven
        for ball, value in zip(balls, map(Fraction, ("1/3", 0, "-4/3")), strict=True):
            assert ball.contains(flint.fmpq(value.numerator, value.denominator))
            assert ball.contains(flint.arb(float(value)))  # a run begins with the float
            assert float(ball.rad()) <= 2 * math.ulp(float(value) or 1e-300)


def test_a_kink_at_the_start_is_not_proven():
    kink = certrack.SymbolicReference("2 + abs(sin(t))")
    assert at_start(kink, 0)[1]
    (first, _), proven = at_start(kink, 1)
    assert not proven
    assert first.contains(2) and float(first.rad()) == pytest.approx(2 * UNPROVEN_RADIUS)
    later = certrack.SymbolicReference("2 + abs(t - 3)*exp(-t)")
    balls, proven = at_start(later, 1)
    assert proven
    assert [float(v.mid()) for v in balls] == pytest.approx([5, -4])


def test_pieces_at_the_start_are_balls_of_a_few_roundings():
    balls, proven = at_start(triangle(0.3, 1.6), 1)
    floats = triangle(0.3, 1.6).values(np.zeros(1), 1)[:, 0]
    assert proven
    for ball, value in zip(balls, floats, strict=True):
        assert ball.contains(flint.arb(float(value)))
        assert float(ball.rad()) <= 1e-14


# where a condition fails


def points(*columns):
    """Points (t, x)."""
    t, x = zip(*columns, strict=True)
    return Points(np.array(t, dtype=float), np.array([x], dtype=float))


def test_a_zero_between_two_points_is_found():
    found = _zero_between(points((0, -9), (1, -1), (1, 3), (0, 8)), lambda p: p.x[0] - 1 / 3)
    assert found.t == pytest.approx([1]) and found.x[0] == pytest.approx([1 / 3], abs=1e-11)
    found = _zero_between(points((0, -2), (3, 2)), lambda p: p.t + p.x[0] - 1)
    assert found.t + found.x[0] == pytest.approx([1], abs=1e-11)
    assert found.t == pytest.approx([9 / 7]) and found.x[0] == pytest.approx([-2 / 7])


def test_a_point_that_is_zero_or_has_no_value_is_taken_as_it_is():
    def zero(p):
        return np.where(np.abs(p.x[0]) < 0.1, 0.0, p.x[0])

    def nothing(p):
        with np.errstate(all="ignore"):
            return np.where(np.abs(p.x[0]) < 0.1, np.nan, p.x[0])

    for value in (zero, nothing):
        found = _zero_between(points((2, -3), (4, 3)), value)
        assert found.t == [3] and found.x[0] == [0]


@pytest.mark.parametrize("size", [1e9, 1e-9])
def test_what_is_left_at_a_zero_counts_against_the_largest_value(size):
    """Small values are signs, too; that one of the points is nearly a zero changes nothing."""
    for x in ((-0.5, 0.4), (-0.4, 0.5), (-3.0, 2.0, 0.123 + 1e-13)):
        found = _zero_between(points(*((0, v) for v in x)), lambda p: size * (p.x[0] - 0.123))
        assert found is not None and found.x[0] == pytest.approx([0.123], abs=1e-12)


def test_a_jump_from_nearly_zero_is_none():
    for sign in (1, -1):

        def value(p, sign=sign):
            above = sign * p.x[0] - 0.3
            return np.where(above > 0, 1.0, np.minimum(above, -1e-30))

        assert _zero_between(points((0, -2), (0, 3)), value) is None


@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_and_one_sign_have_no_zero(sign):
    assert _zero_between(points((0, -2), (0, 3)), lambda p: np.where(p.x[0] > 0.3, 1, -1)) is None
    assert _zero_between(points((0, 2), (0, 3)), lambda p: sign * p.x[0]) is None
    assert _zero_between(points((0, 0.0)), lambda p: p.x[0]) is None


@pytest.mark.parametrize(
    ("text", "must_be", "proven"),
    [
        ("x1**2", "not negative", True),
        ("x1**2", "positive", False),
        ("x1**2 + 1", "positive", True),
        ("x1**2 - 1/2", "not negative", False),
        ("-1 - x1**2", "not zero", True),
        ("-1 - x1**2", "positive", False),
        ("-x1**2", "not zero", False),
        ("x1**2 + 1", "not zero", True),
    ],
)
def test_what_intervals_prove_of_a_condition(text, must_be, proven):
    inside = parse("", text, ["x1"]).expr
    assert Condition(inside, inside, must_be).proven([symbol("x1")]) == proven


# declared bounds


def test_a_declared_bound_that_is_the_proven_one_is_proven():
    system = certrack.load("example1")
    order = system.controller.coordinates.q + 1

    def status(declared):
        reference = certrack.SymbolicReference("0.3*cos(0.7*t)", declared=declared)
        return reference_premise(system.replace(reference=reference)).status

    bounds = certrack.SymbolicReference("0.3*cos(0.7*t)").bounds(order).values
    assert status(bounds) == "proven"
    for i in range(order + 1):
        less = [*bounds]
        less[i] = math.nextafter(math.nextafter(bounds[i], 0), 0)
        assert status(less) == "checked"
    assert not _proves(triangle(0.3, 1.6), [1.0], [0])  # no formula, so no proof of one
    slow = certrack.SymbolicReference("0.001*t/(1 + 0.0001*t)", declared=(11, 1))
    assert not _proves(replace(slow, declared=(11.0,)), [11.0], [0]) or slow.bound_of(0)[0] >= 10


# the worst reference


def test_the_worst_reference_of_one_bound_has_the_signs_of_the_gains():
    found = worst_profile(np.array([1.0, -2.0, 3.0]), [2.0], np.full(3, 0.5))
    assert found.value == pytest.approx(12)
    assert found.pieces == pytest.approx([2, -2, 2])
    assert found.start.shape == (0,) and (found.widths == 0.5).all()


def test_the_worst_reference_of_two_bounds():
    """y + y' on one piece of 2 s: y falls by at most Y_0 + Y_0, at Y_1 in the mean."""
    found = worst_profile(np.array([5.0, 1.0]), [3.0, 4.0], np.array([2.0]))
    assert found.value == pytest.approx(15.0)  # y(0) = 3 is worth 5, and y' <= 0 costs
    found = worst_profile(np.array([-1.0, 5.0]), [3.0, 4.0], np.array([2.0]))
    assert found.value == pytest.approx(3.0 + 15.0)  # from -3 to 3 in 2 s
    assert found.start == pytest.approx([-3]) and found.pieces == pytest.approx([3])
    found = worst_profile(np.array([0.0, 5.0]), [30.0, 4.0], np.array([2.0]))
    assert found.value == pytest.approx(20.0)


def test_a_worst_reference_at_rest_stands_still_afterwards():
    found = worst_profile(np.array([0.0, 0.0, 1.0]), [2.0, 1.0, 0.5], np.array([0.1]), 12)
    assert found.value == pytest.approx(0.5, rel=1e-6)
    speed = found.start[1] + found.pieces @ found.widths
    assert speed == pytest.approx(0, abs=1e-12)
    assert len(found.widths) == 13


def motion(found, t):
    """y, y' ... y^(m) of a profile at times within it: (m + 1, N)."""
    edges = np.concatenate([[0.0], np.cumsum(found.widths)])
    m, state, values = len(found.start), found.start, []
    for k, top in enumerate(found.pieces):
        inside = t[(t >= edges[k]) & (t < edges[k + 1])] - edges[k]
        full = np.append(state, top)
        for h in (inside, found.widths[k : k + 1]):
            taylor = [
                sum(full[j] * h ** (j - i) / math.factorial(j - i) for j in range(i, m + 1)) + 0 * h
                for i in range(m + 1)
            ]
            values.append(np.array(taylor))
        state = values[-1][:m, 0]
    return np.hstack(values), state


def test_the_worst_reference_keeps_its_bounds_between_pieces():
    """y' up and down again, each worth its size: from -1 to 1 and back."""
    found = worst_profile(np.array([0.0, 1.0, -1.0]), [1.0, 10.0], np.ones(2))
    assert found.value == pytest.approx(4)


def test_within_wide_pieces_the_rest_is_scaled_away():
    gains = np.array([0.0, 0.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    Y = np.array([1.0, 5.0, 5.0])
    found = worst_profile(gains, Y, np.ones(6))
    values, _ = motion(found, np.linspace(0, 6, 600, endpoint=False))
    reached = np.abs(values).max(axis=1) / Y
    assert 0.99 < reached.max() < 1.001
    assert found.value == pytest.approx(gains @ [*found.start, *found.pieces])


def test_a_worst_reference_comes_to_rest_where_it_likes():
    still = worst_profile(np.array([1.0, 0.0]), [3.0, 0.0], np.ones(1), 1)
    assert still.value == pytest.approx(3)  # a constant is at rest, too
    rng = np.random.default_rng(4)
    found = worst_profile(rng.normal(size=23), [1.0, 0.7, 2.0, 30.0], np.full(20, 0.1), 40)
    _, last = motion(found, np.empty(0))
    assert last[1:] == pytest.approx([0, 0], abs=1e-13)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_the_size_of_the_gains_does_not_matter(size):
    gains = size * np.array([1.0, 0.0, -2.0, 3.0])
    assert worst_profile(gains, [2.0], np.ones(4)).value == pytest.approx(12 * size, rel=1e-6)


def test_no_worst_reference_of_gains_that_are_not_finite():
    assert worst_profile(np.array([np.inf, 1.0]), [1.0], np.ones(2)) is None
    assert worst_profile(np.array([1.0, np.nan]), [1.0], np.ones(2)) is None


def test_the_time_to_come_to_rest():
    assert len(stopping_widths(np.array([1.0, 0.5]), 0)) == 0
    assert stopping_widths(np.array([1.0, 0.5]), 10) == pytest.approx(
        [STOPPING_TIMES * 2 / 10] * 10
    )
    # y' cannot stay above sqrt(2 Y_0 Y_2) = 2, so Y_1 = 10 says nothing: 2/2 is the slowest
    assert stopping_widths(np.array([1.0, 10.0, 2.0]), 4) == pytest.approx([STOPPING_TIMES / 4] * 4)
    assert stopping_widths(np.array([1.0, 1e-300]), 4) == pytest.approx([STOPPING_TIMES / 4] * 4)


def test_what_derivatives_reach_for_long():
    assert _reached(np.array([1.0, 10.0, 2.0])) == pytest.approx([1, 2, 2])
    assert _reached(np.array([1.0, 1.5, 2.0])) == pytest.approx([1, 1.5, 2])
    inner = 2 ** (1 - 1 / 16) * 100 ** (1 / 16)  # four times x <- sqrt(2 x) from 100
    assert _reached(np.array([1.0, 100.0, 100.0, 1.0])) == pytest.approx([1, inner, inner, 1])


def test_a_step_of_a_profile_is_its_taylor_polynomial():
    sizes, h = np.array([2.0, 3.0, 5.0, 7.0]), 0.3
    y = np.array([0.1, -0.2, 0.4, 0.8])
    later = sizes[:-1] * (_one_step_later(sizes, h) @ (y / sizes))
    expected = [
        sum(y[j] * h ** (j - i) / math.factorial(j - i) for j in range(i, 4)) for i in range(3)
    ]
    assert later == pytest.approx(expected)

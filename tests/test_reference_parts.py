"""Parts of the references by themselves: extremes, rests, kinks, joins, against closed forms."""

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import pytest
import sympy
from flint import fmpq, fmpq_poly

import certrack
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, parse, symbol
from certrack.references import moves, polynomial, polynomials, samples, scurve, triangle
from certrack.references.base import (
    Bounds,
    Reference,
    bound_of,
    jumps,
    lipschitz_bound,
    pieces_at,
    require_order,
    round_up,
    total_bound,
)
from certrack.references.exact import exact, nearest, rational_above
from certrack.references.extremes import largest_derivative, largest_of_rows
from certrack.references.piecewise import PiecewiseReference
from certrack.references.polynomials import (
    _halved,
    derived,
    evaluate,
    largest_by_control_points,
    largest_slope,
    stationary,
    value_above,
)
from certrack.references.rests import MoveTimes, moves_of
from certrack.references.smoothness import smoothness
from certrack.references.soft_start import SoftStart, long_run, vanishing
from certrack.references.supremum import (
    MAX_SINUSOIDS,
    _terms,
    is_sum_of_sinusoids,
    sinusoid_supremum,
)

# numbers


def test_floats_above_rationals():
    third = fmpq(1, 3)
    assert exact(0.5) == fmpq(1, 2) and nearest(third) == 1 / 3
    above = rational_above(third)
    assert exact(above) >= third > exact(math.nextafter(above, 0))
    assert rational_above(fmpq(1, 2)) == 0.5
    for value in (fmpq(-1, 3), fmpq(2, 3), fmpq(10**30, 7)):
        above = rational_above(value)
        assert exact(above) >= value > exact(math.nextafter(above, -math.inf))


def test_rounding_up_makes_four_roundings_good():
    assert round_up(0.0) == 0.0
    assert round_up(1.0) == 1 + 4 * math.ulp(1.0) and round_up(-1.0) > -1.0


# extremes of polynomials


def test_the_largest_derivative_of_one_polynomial():
    p = fmpq_poly([1, -3, 0, 1])  # t^3 - 3 t + 1: 1 at 0, -1 at 1, 3 at 2
    assert largest_derivative(p, 0, fmpq(2)) == 3 and largest_derivative(p, 0, fmpq(1)) == 1
    assert largest_derivative(p, 0, fmpq(3, 2)) == pytest.approx(1)
    assert largest_derivative(p, 1, fmpq(2)) == 9 and largest_derivative(p, 1, fmpq(1)) == 3
    assert largest_derivative(p, 2, fmpq(2)) == 12 and largest_derivative(p, 3, fmpq(2)) == 6
    assert largest_derivative(p, 4, fmpq(2)) == 0
    hill = fmpq_poly([0, 1, -1])  # its top is inside, 1/4 at 1/2
    assert 0.25 <= largest_derivative(hill, 0, fmpq(1)) <= 0.25 * (1 + 1e-14)
    assert largest_derivative(hill, 0, fmpq(1, 4)) == 3 / 16
    assert largest_derivative(fmpq_poly([-2]), 0, fmpq(1)) == 2
    wave = fmpq_poly([0, -1, 0, 1])  # -2/sqrt(27) at 1/sqrt(3)
    assert largest_derivative(wave, 0, fmpq(1)) == pytest.approx(2 / math.sqrt(27), rel=1e-14)


ROWS = np.array([[1.0, -3.0, 0.0, 1.0, 0.0, 0.0], [0.0, 4.0, -4.0, 0.5, 0.25, -0.1]])
KNOTS = np.array([0.0, 1.5, 3.5])


@pytest.mark.parametrize("i", range(6))
def test_the_largest_derivative_of_all_rows(i):
    fine = [np.linspace(0, w, 200_001) for w in np.diff(KNOTS)]
    brute = max(
        float(np.abs(np.polynomial.polynomial.Polynomial(row).deriv(i)(s)).max())
        if i
        else float(np.abs(np.polynomial.polynomial.Polynomial(row)(s)).max())
        for row, s in zip(ROWS, fine, strict=True)
    )
    found = largest_of_rows(ROWS, i, KNOTS)
    assert brute <= found * (1 + 1e-13) and found <= brute * (1 + 1e-8)
    widths = np.diff(KNOTS)
    by_points = largest_by_control_points(derived(ROWS, i), widths)
    assert brute <= by_points <= brute * (1 + 1e-8)
    if i:
        assert brute <= largest_slope(ROWS, i, widths) <= brute * (1 + 1e-8)
        cubic = largest_slope(ROWS[:1, :4], i, widths[:1])
        first = float(np.abs(np.polynomial.polynomial.Polynomial(ROWS[0]).deriv(i)(fine[0])).max())
        assert first <= cubic <= first * (1 + 1e-12) + 1e-300


def test_a_row_that_does_not_count_is_passed_over_without_a_loss():
    small = np.vstack([1e-3 * ROWS, ROWS])
    knots = np.array([0.0, 1.5, 3.5, 5.0, 7.0])
    for i in (0, 1, 2):
        assert largest_of_rows(small, i, knots) == largest_of_rows(ROWS, i, KNOTS)
    assert largest_by_control_points(np.array([[1e308, 1e308, 1e308]]), np.ones(1)) == math.inf


def test_values_of_rows_and_what_is_not_below_them():
    s = np.array([0.3, 1.7])
    values = [np.polynomial.polynomial.polyval(x, row) for x, row in zip(s, ROWS, strict=True)]
    assert evaluate(ROWS, s) == pytest.approx(values)
    assert derived(ROWS, 2)[0].tolist() == [0, 6, 0, 0, 0, 0]
    assert derived(ROWS, 1)[1].tolist() == [4, -8, 1.5, 1, -0.5, 0]
    above = value_above(ROWS, s)
    assert (above > np.abs(values)).all() and above == pytest.approx(np.abs(values), rel=1e-12)


def test_stationary_points_are_roots_inside_the_piece():
    width = np.array([2.0, 1.0, 3.0])
    slope = np.array([[-1.0, 0.0, 1.0, 0.0], [2.0, -4.0, 0.0, 0.0], [2.0, -3.0, 1.0, 0.0]])
    first, second = stationary(slope, width)
    found = np.sort(np.vstack([first, second]), axis=0)
    assert found[1, 0] == pytest.approx(1.0)  # -1 is moved to 0
    assert 0.5 in found[:, 1] and found[:, 2] == pytest.approx([1, 2])
    quartic = np.array([[-1.0, 0.0, 0.0, 0.0, 16.0]])  # 1/2 and others outside
    points = np.array(stationary(quartic, np.ones(1))).ravel()
    assert np.abs(points - 0.5).min() < 1e-12 and ((points >= 0) & (points <= 1)).all()


def test_halves_of_a_polynomial_by_its_control_points():
    """t^2 - t + 1 has the control points 1, 1/2, 1; its halves 1, 3/4, 3/4 and back."""
    left, right = _halved(np.array([[1.0, 0.5, 1.0]]))
    assert left.tolist() == [1, 0.75, 0.75] and right.tolist() == [0.75, 0.75, 1]
    cubic = np.array([[0.0, 1.0, 3.0, 8.0], [8.0, 3.0, 1.0, 0.0]])
    halves = _halved(cubic)
    assert halves.shape == (4, 4)
    assert halves[0].tolist() == [0, 0.5, 1.25, 2.5] and halves[2].tolist() == [2.5, 3.75, 5.5, 8]
    assert halves[1].tolist() == [8, 5.5, 3.75, 2.5] and halves[3].tolist() == [2.5, 1.25, 0.5, 0]


def test_bounds_by_control_points_that_need_halving():
    """Wilkinson-like rows, whose control points reach far beyond the values."""
    rows = np.array([np.polynomial.chebyshev.cheb2poly([0] * 8 + [1])])  # |T_8| <= 1
    shifted = fmpq_poly([fmpq(int(v)) for v in rows[0]])(fmpq_poly([-1, 2]))  # on [0, 1]
    found = largest_by_control_points(np.array([[float(v) for v in shifted]]), np.ones(1))
    assert 1 <= found <= 1 + 1e-7
    two = np.array([[float(v) for v in shifted], [0.25] + [0.0] * 8])
    assert largest_by_control_points(two, np.array([1.0, 5.0])) == pytest.approx(1, abs=1e-7)


def test_every_rounding_of_the_control_points_is_in_the_bound(monkeypatch):
    """As if a rounding were large: the first points lose of all terms, each halving of the largest.

    A point is a sum of degree + 1 products and a halving a mean of two; degree + 4 covers both.
    """
    first, _ = rows = np.array([[0.0, 4.0, -4.0, 0.5, 0.0], [0.3, 0.0, 0.0, 0.0, 0.0]])
    widths, degree, counted = np.array([1.25, 1.0]), 4, []

    def halved(points):
        counted.append(float(np.abs(points).max()))
        return _halved(points)

    monkeypatch.setattr(polynomials, "_halved", halved)
    monkeypatch.setattr(polynomials, "ROUNDINGS", 0.0)
    exact_ = largest_by_control_points(rows, widths)
    halvings, size = len(counted), counted[0]
    assert halvings > 5
    part = 1e-6
    monkeypatch.setattr(polynomials, "ROUNDINGS", part)
    terms = np.abs(first) @ widths[0] ** np.arange(degree + 1)
    lost = part * (degree + 4) * (terms + halvings * size)
    assert largest_by_control_points(rows, widths) == pytest.approx(
        (exact_ + lost) * (1 + part), rel=1e-12
    )
    above = value_above(rows, np.array([0.1, 0.2]))
    exact_values = np.abs(evaluate(rows, np.array([0.1, 0.2])))
    sizes = evaluate(np.abs(rows), np.array([0.1, 0.2]))
    assert above == pytest.approx(exact_values + part * sizes, rel=1e-14)
    ends = largest_slope(np.array([[0.0, -0.4, 0.0, 0.0]]), 1, np.ones(1))
    assert ends == pytest.approx(0.4 * (1 + part), rel=1e-14)


@pytest.mark.parametrize(("smoothness", "taken"), [(1, True), (3, True), (4, False), (0, False)])
def test_pieces_have_as_many_derivatives_as_their_degree_at_most(smoothness, taken):
    still = ((1.0, 0.0, 0.0, 0.0),)
    if taken:
        assert PiecewiseReference((0.0, 1.0), still, smoothness).order == smoothness
        return
    with pytest.raises(InputError, match=r"reference\.smoothness"):
        PiecewiseReference((0.0, 1.0), still, smoothness)


# sums of sinusoids


@pytest.mark.parametrize(
    ("text", "bound", "single"),
    [
        ("3*sin(t) + 4*cos(t)", 5, True),
        ("2 - 3*sin(2*t + 1)", 5, True),
        ("sin(t + pi/3) + sin(t)", math.sqrt(3), True),
        ("cos(t + pi/3) - cos(t)", 1, True),
        ("sin(-t) + sin(t) + 1", 1, True),
        ("sin(pi/6 - t) + cos(t)/2", math.sqrt(0.75), True),  # (1/2 + 1/2, -sqrt(3)/2) ...
        ("sin(t)*cos(t)", 0.5, True),
        ("sin(t)**2", 1, True),
        ("sin(t) + sin(2*t)/2", 1.5, False),
        ("7", None, None),
        ("t*sin(t)", None, None),
        ("sin(t**2)", None, None),
        ("exp(-t)", None, None),
        ("sin(t)**17", None, None),
    ],
)
def test_bounds_of_sums_of_sinusoids(text, bound, single):
    found = sinusoid_supremum(parse("", text, ["t"]).expr)
    if text == "7":
        assert found == (7.0, True)
    elif bound is None:
        assert found is None
    else:
        t = np.linspace(0, 200, 400_001)
        largest = np.abs(sympy.lambdify(TIME, parse("", text, ["t"]).expr)(t)).max()
        assert largest <= found[0] * (1 + 1e-12) and found[1] == single
        if single:
            assert found[0] == pytest.approx(largest, rel=1e-6)
        else:
            assert found[0] == pytest.approx(bound)


def test_expanding_is_not_tried_where_it_takes_long():
    t = TIME
    assert is_sum_of_sinusoids((sympy.sin(t) + sympy.cos(2 * t)) ** 7)
    assert not is_sum_of_sinusoids((sympy.sin(t) + sympy.cos(2 * t)) ** 8)
    assert not is_sum_of_sinusoids(sympy.sin(t) * sympy.exp(t))


def test_terms_of_an_expansion_are_counted_each_once():
    """A constant is one, so are factors of it; powers and products multiply, sums add."""
    t, a = TIME, symbol("a")
    waves = [sympy.sin(k * t) for k in range(1, 4)]
    for expr, count in (
        (sympy.Integer(3), 1),
        (a + 1, 1),
        (2 * a * sympy.cos(t), 1),
        (waves[0] + 3, 2),
        (sum(waves), 3),
        (sum(waves) + a, 4),
        ((waves[0] + 1) * sum(waves), 6),
        (sympy.sin(t) ** 2, 4),  # a constant and a sinusoid from each of two exponentials at most
        ((waves[0] + 1) ** 5, 32),
        (sum(waves) ** 3, 27),
        (sympy.sin(t) ** 16, 2**16),
        (sympy.sin(t) ** 17, 0),
        (1 / sympy.sin(t), 0),
        (sympy.sqrt(sympy.sin(t)), 0),
        (t, 0),
        (t + sympy.sin(t), 0),
        (t * sympy.sin(t), 0),
        (sympy.sin(sympy.exp(t)), 0),
        (sympy.sin(sympy.exp(t)) ** 2, 0),
        (sympy.exp(sympy.sin(t)), 0),
    ):
        assert _terms(expr) == count, expr


@pytest.mark.parametrize(("count", "quick"), [(1, True), (MAX_SINUSOIDS, True), (201, False)])
def test_as_many_sinusoids_as_are_expanded(count, quick):
    assert (
        is_sum_of_sinusoids(sympy.Add(*(sympy.sin(k * TIME) for k in range(1, count + 1)))) is quick
    )


# kinks


@pytest.mark.parametrize(
    ("text", "order", "pieces"),
    [
        ("sin(t)*exp(-t)", math.inf, 1),
        ("abs(t - 1)", 1, 2),
        ("abs(t - 1)*(t - 1)", 2, 2),
        ("abs(t - 1)**3", 3, 2),
        ("max(t - 1, 0)**3 + abs(t - 3)*(t - 3)", 2, 3),
        ("abs(t + 1)", math.inf, 1),  # before the begin
        ("abs(2 - t) + abs(t - 2)", 1, 2),
        ("min(t, 4)", 1, 2),
        ("max(min(t, 4), 1)", 1, 3),
        ("abs(sin(t))", 1, 1),  # its kinks are not located
    ],
)
def test_the_order_of_a_formula_with_kinks(text, order, pieces):
    found = smoothness(parse("", text, ["t"]).expr)
    assert found.order == order and len(found.stretches) == pieces


def test_jumps_at_kinks_and_bounds_between_them():
    found = smoothness(parse("", "max(t - 1, 0)**2 - max(t - 1.5, 0)**2 - (t - 1)/2", ["t"]).expr)
    assert found.order == 2
    assert found.jumps(2) == ((1.0, 2.0), (1.5, 2.0))
    assert found.bound(2) == 2.0 and found.bound(1) == 0.5
    tent = smoothness(parse("", "min(t, 4 - t, 1/3)", ["t"]).expr)
    third = tent.jumps(1)
    assert [size for _, size in third] == [1.0, 1.0]
    assert [t for t, _ in third] == pytest.approx([1 / 3, 11 / 3])
    assert all(Fraction(t) >= Fraction(k, 3) for (t, _), k in zip(third, (1, 11), strict=True))
    assert tent.bound(1) == 1.0
    assert smoothness(parse("", "abs(sin(t))", ["t"]).expr).jumps(1) is None
    quiet = smoothness(parse("", "abs(t - 2)*exp(-t)", ["t"]).expr)
    (jump,) = quiet.jumps(1)
    assert jump == pytest.approx((2.0, 2 * math.exp(-2)))


# rests and moves


def test_moves_begin_and_arrive_where_the_reference_says():
    there_and_back = samples((0, 1, 2, 3, 5), (0, 0, 2, 2, -1))
    assert moves_of(there_and_back, 8.0) == (
        MoveTimes(1.0, 2.0, 3.0, 0.0, 2.0),
        MoveTimes(3.0, 5.0, 8.0, 2.0, -1.0),
    )
    assert moves_of(there_and_back, 4.0) == (MoveTimes(1.0, 2.0, 3.0, 0.0, 2.0),)
    assert moves_of(there_and_back, 1.5) == () and moves_of(there_and_back, 0.0) == ()
    at_once = samples((0, 1, 2), (1, 3, 3))
    assert moves_of(at_once, 2.5) == (MoveTimes(0.0, 1.0, 2.5, 1.0, 3.0),)
    assert moves_of(certrack.SymbolicReference("sin(t)"), 9.0) == ()
    through = samples((0, 1, 2, 3), (0, 1, 4, 4))  # a break is no rest
    assert moves_of(through, 4.0) == (MoveTimes(0.0, 2.0, 4.0, 0.0, 4.0),)


# what every reference has


@dataclass(frozen=True)
class Ramp(Reference):
    """Only what is asked for: y = 2 t until 3, then 6."""

    order = 1.0

    def bounds(self, order):
        return Bounds((6.0, 2.0)[: order + 1], ("exact", "proven")[: order + 1])

    def values(self, t, order):
        return np.array([np.minimum(2 * t, 6), np.where(t < 3, 2.0, 0.0)])[: order + 1]

    def formulas(self, order):
        return (sympy.Min(2 * TIME, 6),)


@pytest.mark.parametrize(
    ("rough", "order", "remedy", "smooth"),
    [
        (
            polynomial((0, 1), degree=5, duration=0.3),
            4,
            r"or take degree = 7 in \[reference\]",
            polynomial((0, 1), degree=7, duration=0.3),
        ),
        (
            samples((0, 1, 2), (0, 1, 4)),
            3,
            r'or take interpolation = "spline" and degree = 5 in \[reference\]',
            samples((0, 1, 2), (0, 1, 4), interpolation="spline", degree=5),
        ),
        (
            scurve((0, 1), speed=5, acceleration=100, jerk=2000),
            4,
            'or take kind = "moves" with a limit of snap besides',
            moves((0, 1), speed=5, acceleration=100, jerk=2000, snap=1e6),
        ),
        (triangle(1, 1), 2, "or choose a smoother reference", None),
        (polynomial((0, 1), degree=9, duration=1), 6, "or choose a smoother reference", None),
    ],
)
def test_the_remedy_of_a_reference_that_is_too_rough(rough, order, remedy, smooth):
    """What it tells to take is smooth enough."""
    with pytest.raises(InputError, match=f"Lower law.feedforward {remedy}"):
        require_order(rough, order, "this law")
    if smooth is not None:
        require_order(smooth, order, "this law")


def test_what_holds_of_a_reference_that_says_no_more():
    ramp = Ramp()
    assert bound_of(ramp, 1) == (2.0, "proven") and bound_of(ramp, 0) == (6.0, "exact")
    assert lipschitz_bound(ramp, 0) == 2.0 and lipschitz_bound(ramp, 1) is None
    assert jumps(ramp, 1) is None and ramp.declared_bound is None
    assert len(ramp.breaks(0, 9)) == 0 and ramp.piece_symbols == ()
    assert pieces_at(ramp, np.zeros(4)).shape == (0, 4)
    assert 8 < total_bound(ramp) < 8 + 1e-13
    require_order(ramp, 1, "this law")
    with pytest.raises(InputError, match="this law needs 2 bounded derivatives"):
        require_order(ramp, 2, "this law")
    unknown = certrack.SymbolicReference("t*exp(sin(t) - t)", declared=(9, 9))
    assert lipschitz_bound(unknown, 3) is None or lipschitz_bound(unknown, 3) > 0
    declared = certrack.SymbolicReference("0.1*sin(t)", bound=0.5)
    assert total_bound(declared) == 0.5


def test_pieces_of_a_reference_at_many_times():
    wave = triangle(0.5, 2.0)
    t = np.array([0.0, 0.2, 0.5, 0.7, 1.5, 3.9, 0.1])
    table = pieces_at(wave, t)
    assert table.shape == (5, 7)
    for k, time in enumerate(t):
        assert table[:, k] == pytest.approx(wave.piece_values(time))
        start, *a = table[:, k]
        here = sum(a[i] * (time - start) ** i for i in range(4))
        assert here == pytest.approx(wave.values(np.array([time]), 0)[0, 0])


# pieces


def test_jumps_and_slopes_of_a_triangle():
    wave = triangle(0.5, 2.0)  # slopes of 1
    size, apart = wave.jumps(1)
    assert size == pytest.approx(2) and size >= 2 and apart == pytest.approx(1) and apart <= 1
    assert wave.jumps(0) is None and wave.jumps(2) is None
    assert wave.lipschitz_bound(0) == pytest.approx(1) and wave.lipschitz_bound(0) >= 1
    assert wave.lipschitz_bound(1) is None
    assert wave.lipschitz_bound(1, between_jumps=True) == pytest.approx(0, abs=1e-12)
    assert wave.lipschitz_bound(2, between_jumps=True) is None
    assert wave.bounds(1).values == pytest.approx((0.5, 1.0))
    assert wave.breaks(0.0, 4.0) == pytest.approx([1, 2, 3])


@pytest.mark.parametrize("period", [None, 2.0])
@pytest.mark.parametrize("turned", [False, True])
def test_a_jump_has_room_for_the_roundings_of_the_piece_before_it(period, turned):
    """y = 1e9 (s^2 - s^3) ends with y' = 2e9 - 3e9 and begins with 0; its neighbours rest."""
    pieces = ((0.0, 0.0, 1e9, -1e9), (0.0, 0.0, 0.0, 0.0))
    knots = (0.0, 1.0, 2.0)
    wave = PiecewiseReference(knots, pieces[::-1] if turned else pieces, 1, period)
    size, _ = wave.jumps(1)
    assert size - 1e9 == pytest.approx(polynomials.ROUNDINGS * 5e9, rel=0.05)
    assert wave.jumps(0) is None


def test_jumps_of_a_profile_that_holds():
    once = PiecewiseReference((1.0, 2.0, 4.0), ((0, 0, 3, 0), (3, 6, -1.5, 0)), 1)
    assert once.jumps(1) is None  # y' is 0, from 0 to 6, from 6 to 0, 0
    corner = PiecewiseReference((0.0, 1.0, 3.0), ((0, 2, 0, 0), (2, -1, 0, 0)), 1)
    size, apart = corner.jumps(1)
    assert size == pytest.approx(3) and apart == pytest.approx(2) and apart <= 2
    assert corner.bounds(1).values == pytest.approx((2, 2))
    late = PiecewiseReference((0.5, 1.0, 3.0), ((0, 2, 0, 0), (1, -1, 0, 0)), 1)
    assert late.jumps(1)[1] == pytest.approx(0.5)
    assert late.values(np.array([0.0, 0.5, 0.75, 1.0, 3.0, 9.0]), 0)[0] == pytest.approx(
        [0, 0, 0.5, 1, -1, -1]
    )
    assert late.values(np.array([0.25, 0.5, 1.0, 3.0]), 1)[1] == pytest.approx([0, 2, -1, 0])
    assert list(late.breaks(0.0, 9.0)) == [0.5, 1.0, 3.0] and list(late.breaks(0.5, 3.0)) == [1.0]


@pytest.mark.parametrize("degree", [3, 5, 7])
def test_a_spline_passes_its_samples_and_rests_at_its_ends(degree):
    q = (degree - 1) // 2
    t, y = (0.0, 0.7, 1.0, 2.5), (0.0, 1.0, -0.5, 2.0)
    spline = samples(t, y, interpolation="spline", degree=degree)
    assert spline.order == q + 1
    assert spline.values(np.array(t), 0)[0] == pytest.approx(y, abs=1e-12)
    ends = spline.values(np.array([0.0, 2.5 - 1e-12]), q)
    assert np.abs(ends[1:]).max() < 1e-6
    inner = np.array([0.7, 1.0])
    before, after = spline.values(inner - 1e-9, 2 * q), spline.values(inner + 1e-9, 2 * q)
    assert before == pytest.approx(after, rel=1e-4, abs=1e-4)  # a spline is smoother inside
    turn = samples((0, 1, 2, 4), (1, 2, -1, 1), interpolation="spline", degree=degree, repeat=True)
    at = np.array([0.3, 1.7, 3.9])
    assert turn.values(at, q) == pytest.approx(turn.values(at + 4, q), rel=1e-9, abs=1e-9)
    assert turn.period == 4 and turn.order == q + 1
    later = samples((1, 2, 3, 5), (1, 2, -1, 1), interpolation="spline", degree=degree, repeat=True)
    assert later.period == 4 and later.values(at + 1, q) == pytest.approx(turn.values(at, q))


def test_monotone_samples_do_not_overshoot_and_times_have_units():
    data = samples((0, 1, 2, 3), (0, 0, 1, 1))
    values = data.values(np.linspace(0, 3, 500), 0)[0]
    assert values.min() >= 0 and values.max() <= 1 and data.order == 2
    fast = samples((0, 1000, 2000, 3000), (0, 0, 1, 1), time_unit="ms")
    assert fast.values(np.linspace(0, 3, 500), 0)[0] == pytest.approx(values, abs=1e-12)
    for wrong, key in (
        ({"degree": 5}, "reference.degree"),
        ({"interpolation": "spline", "degree": 4}, "reference.degree"),
        ({"interpolation": "spline", "degree": True}, "reference.degree"),
        ({"repeat": True}, "reference.repeat"),
        ({"interpolation": "spline", "repeat": True}, r"reference.values\[3\]"),
        ({"interpolation": "spline", "repeat": 1}, "reference.repeat"),
        ({"time_unit": "h"}, "reference.time_unit"),
    ):
        with pytest.raises(InputError, match=key):
            samples((0, 1, 2, 3), (0, 0, 1, 1), **wrong)
    with pytest.raises(InputError, match="3 samples or more"):
        samples((0, 1), (1, 1), interpolation="spline", repeat=True)
    with pytest.raises(InputError, match=r"times\[2\]: times must increase"):
        samples((0, 1, 1), (0, 1, 2))


# the soft start


@pytest.mark.parametrize("transient", [0.5, 2.0])
def test_the_transient_has_one_derivative_at_the_start_and_none_at_its_end(transient):
    for count in (1, 2, 4):
        for i, p in enumerate(vanishing(count, transient)):
            for k in range(count):
                assert p(fmpq(0)) == (i == k) and p(exact(transient)) == 0
                p = p.derivative()


def test_a_soft_start_joins_its_target():
    target = certrack.SymbolicReference("sin(2*t)")
    soft = SoftStart(target, 0.5).joined((1.0, -2.0, 3.0))
    assert soft.start == (1.0, -2.0, 3.0) and soft.order == 3 and long_run(soft) is target
    at_zero = soft.values(np.zeros(1), 2)[:, 0]
    assert at_zero == pytest.approx([1, -2, 3])
    t = np.array([0.5, 0.7, 4.0])
    assert soft.values(t, 3) == pytest.approx(target.values(t, 3))
    before = soft.values(np.array([0.5 - 1e-7]), 2)[:, 0]
    assert before == pytest.approx(target.values(np.array([0.5]), 2)[:, 0], abs=1e-3)
    assert list(soft.breaks(0.0, 3.0)) == [0.5] and len(soft.breaks(0.5, 3.0)) == 0
    fine = np.linspace(0, 0.5 * (1 - 1e-12), 2001)
    for i in range(4):
        value, origin = soft.bound_of(i)
        added = np.abs(soft.values(fine, i)[i] - target.values(fine, i)[i]).max()
        assert value == pytest.approx(bound_of(target, i)[0] + added, rel=1e-3)
        assert value >= bound_of(target, i)[0] + added * (1 - 1e-9) and origin == "proven"
    assert soft.bounds(1).values == (soft.bound_of(0)[0], soft.bound_of(1)[0])
    assert soft.lipschitz_bound(1) == pytest.approx(soft.bound_of(2)[0], rel=1e-12)
    assert soft.lipschitz_bound(3) is None and soft.lipschitz_bound(4, between_jumps=True) is None
    assert soft.lipschitz_bound(3, between_jumps=True) > bound_of(target, 4)[0]
    size, apart = soft.jumps(3)
    assert apart == math.inf and soft.jumps(2) is None
    assert size >= abs(np.diff(soft.values(np.array([0.5 - 1e-9, 0.5]), 3)[3]))[0] * (1 - 1e-6)
    still = SoftStart(target, 0.5)
    assert still.jumps(1) is None and len(still.breaks(0.0, 3.0)) == 0
    assert still.bound_of(0) == (round_up(1.0), bound_of(target, 0)[1])
    with pytest.raises(InputError, match="must not be stated twice"):
        SoftStart(soft, 0.5)


@pytest.mark.parametrize("signal", ["abs(sin(t))", "sin(t)", "asin(sin(t))/2"])
def test_a_bound_of_the_sum_is_held_against_the_slope(signal):
    """Also where y_d' is the last derivative that there is: |y_d| + |y_d'| reaches more."""
    t = np.linspace(0, 7, 7001)
    values = certrack.SymbolicReference(signal).values(t, 1)
    largest = np.abs(values).sum(axis=0).max()
    assert largest > 1.05 * np.abs(values[0]).max()
    with pytest.raises(InputError, match=r"reference.bound: must bound \|y_d\| \+ \|y_d'\|"):
        certrack.SymbolicReference(signal, bound=0.97 * largest)
    stated = certrack.SymbolicReference(signal, bound=1.001 * largest)
    assert stated.declared_bound == 1.001 * largest


def up_to_one(time, last):
    """It rises to 1 until a time, and rests there."""
    return PiecewiseReference((0.0, time, last), ((0, 1 / time, 0, 0), (1, 0, 0, 0)), 1)


@pytest.mark.parametrize("end", [0.3, 1.0, 4.0, 1000.0])
def test_breaks_at_the_ends_of_a_run_but_for_rounding_are_none(end):
    """Times are the same within 1e-12 of the larger of 1 and the run's end."""
    same = 1e-12 * max(1.0, end)
    for part, counted in ((0.7, False), (1.4, True)):
        knot = end - part * same
        for found in (
            up_to_one(knot, 3000.0),
            SoftStart(certrack.SymbolicReference("sin(2*t)"), knot).joined((1.0,)),
        ):
            assert len(found.breaks(0.0, end)) == counted
            assert len(found.breaks(end, 2 * end)) == 0
            assert len(found.breaks(knot - part * same, knot + 2 * same)) == counted
    corner = up_to_one(end, 3000.0)  # and one that is nearly the end of the transient
    for part, both in ((0.7, 1), (1.4, 2)):
        soft = SoftStart(corner, end + part * same).joined((1.0,))
        assert len(soft.breaks(0.0, end + 3 * same)) == both


@pytest.mark.parametrize("time", [0.3, 1.0, 1000.0])
@pytest.mark.parametrize("last", [2000.0, 3000.0])
def test_a_piece_begins_a_rounding_before_its_time(time, last):
    """Within 1e-12 of the largest of 1, t and the whole span; a soft start's end without that."""
    bent, same = up_to_one(time, last), 1e-12 * last
    assert bent.piece_values(time - 0.7 * same)[1] == 1
    assert bent.piece_values(time - 1.4 * same)[1] == 0
    soft = SoftStart(certrack.SymbolicReference("sin(2*t)"), time).joined((1.0,))
    same = 1e-12 * max(1.0, time)
    assert soft.piece_values(time - 0.7 * same)[-1] == 0
    assert soft.piece_values(time - 1.4 * same)[-1] == 1


def test_a_soft_start_of_a_target_with_corners_has_no_more_derivatives():
    soft = SoftStart(triangle(0.5, 2.0), 0.3).joined((1.0, 2.0, 3.0))
    assert soft.start == (1.0,) and soft.order == 1
    size, apart = soft.jumps(1)
    assert size >= 2 + 1 / 0.3 and 0 < apart < 0.71
    at_end = replace(soft, transient=1.0)  # both jumps at once
    assert at_end.breaks(0.0, 4.0) == pytest.approx([1, 2, 3])
    assert soft.breaks(0.0, 4.0) == pytest.approx([0.3, 1, 2, 3])
    assert at_end.jumps(1)[1] == pytest.approx(1, rel=1e-6)
    t = np.array([0.0, 0.1, 0.2999, 0.3, 0.4])
    joining = [soft.piece_values(time)[-1] for time in t]
    assert joining == [1, 1, 1, 0, 0]
    formula = soft.formulas(0)[0]
    for time in t:
        known = dict(zip(soft.piece_symbols, soft.piece_values(time), strict=True))
        known |= dict(zip(soft.parameter_symbols, soft.parameter_values, strict=True))
        value = float(formula.subs(known | {TIME: time}))
        assert value == pytest.approx(soft.values(np.array([time]), 0)[0, 0], abs=1e-12)


# formulas


def test_what_is_known_of_a_formula_with_corners():
    tent = certrack.SymbolicReference("min(t, 4 - t, 1/2)*3")  # slopes 3, 0, -3; corners apart
    size, apart = tent.jumps(1)
    assert size == 3.0 and apart == pytest.approx(3.0) and apart < 3.0
    assert tent.jumps(0) is None and tent.jumps(2) is None and tent.order == 1
    assert tent.lipschitz_bound(0) == 3.0 and tent.lipschitz_bound(1) is None
    assert tent.lipschitz_bound(1, between_jumps=True) == 0.0
    assert tent.lipschitz_bound(2, between_jumps=True) is None
    smooth = certrack.SymbolicReference("sin(2*t)")
    assert smooth.jumps(1) is None and smooth.lipschitz_bound(2) == bound_of(smooth, 3)[0]
    assert smooth.bound_of(3) == (8.0, "exact") and smooth.bounds(1).origin == ("exact",) * 2
    known = certrack.SymbolicReference("abs(sin(t))*sin(t)", declared=(1, 1, 2))
    assert known.lipschitz_bound(1) == 2.0  # it is stated, where no kink is located
    unknown = certrack.SymbolicReference("abs(sin(t))", declared=(1, 1))
    assert unknown.lipschitz_bound(1, between_jumps=True) is None
    assert known.bound_of(1) == (1.0, "declared")


@pytest.mark.parametrize(
    ("signal", "options", "key"),
    [
        ("sin(t)", {"declared": (0.999,)}, r"bounds\[0\]"),
        ("sin(2*t)", {"declared": (1, 1.99)}, r"bounds\[1\]"),
        ("abs(t - 1)*exp(-t)", {"declared": (1, 2, 1.9)}, r"bounds\[2\].*between its jumps"),
        ("abs(sin(3*t))", {"declared": (1, 3, 8.9)}, r"bounds\[2\]"),
        ("sin(t) + cos(t)", {"bound": 1.9}, "bound: must bound"),
        ("sign(t - 1)", {}, "signal: must be continuous"),
        ("1/(t - 1)", {}, "signal: may jump"),
    ],
)
def test_what_a_formula_contradicts_is_refused(signal, options, key):
    with pytest.raises(InputError, match="reference." + key):
        certrack.SymbolicReference(signal, **options)


def test_what_a_formula_only_just_keeps_is_accepted():
    for signal, options in (
        ("sin(2*t)", {"declared": (1, 2)}),
        ("abs(t - 1)*exp(-t)", {"declared": (1, 2, 3)}),
        ("sin(t) + cos(t)", {"bound": 2}),
        ("abs(t - 50)", {"declared": (1e4, 1, 0)}),
    ):
        certrack.SymbolicReference(signal, **options)


def test_a_formula_is_evaluated_over_the_run_before_it():
    late = certrack.SymbolicReference("exp(-t)*exp(t - 1)*0 + 1/(1 + exp(t))")
    late.check_finite(0, 100.0)
    overflow = certrack.SymbolicReference("exp(t)/(1 + exp(t))", declared=(1, 1))
    overflow.check_finite(1, 300.0)
    with pytest.raises(InputError, match="is not finite in floating point at t = 3"):
        overflow.check_finite(1, 1000.0)


def test_constants_of_a_formula_are_parameters():
    wave = certrack.SymbolicReference("a*sin(w*t)", constants={"a": "1/3", "w": 2})
    assert wave.parameter_values == (1 / 3, 2.0)
    assert [s.name for s in wave.parameter_symbols] == ["ref_a", "ref_w"]
    y, slope = wave.formulas(1)
    a, w = wave.parameter_symbols
    assert sympy.expand(y - a * sympy.sin(w * TIME)) == 0
    assert sympy.expand(slope - a * w * sympy.cos(w * TIME)) == 0
    t = np.array([0.0, 0.4])
    assert wave.values(t, 1) == pytest.approx(np.array([np.sin(2 * t) / 3, 2 * np.cos(2 * t) / 3]))
    assert wave.bound_of(1)[0] >= Fraction(2, 3) and len(wave.piece_values(1.0)) == 0
    corner = certrack.SymbolicReference("abs(t)*t")  # from the right at 0
    assert corner.order == math.inf and corner.values(np.zeros(1), 2)[2] == [2]

"""References: derivatives, proven bounds, break points."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline, PchipInterpolator

import certrack
from certrack.certificates import certify_semidefinite
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.references import (
    Key,
    SymbolicReference,
    profile,
    register,
    samples,
    steps,
    trapezoid,
    triangle,
)
from certrack.references.base import Bounds, round_up, total_bound

DENSE = np.linspace(0, 60, 60_001)
PIECEWISE = {
    "triangle": triangle(0.2, 4.0, offset=0.1, start=-0.3),
    "trapezoid": trapezoid(0.2, 5.0, 0.5),
    "steps": steps([1, 4, 8], [0, 0.2, -0.1, 0.3], 1.0),
    "adjacent steps": steps([1, 2], [0, 1, 0], 1.0),
    "monotone": samples([0, 1, 2, 3.5, 5], [0, 0.1, 0.3, 0.2, 0.2]),
    "cubic": samples([0, 1, 2, 3.5, 5], [0, 0.1, 0.3, 0.2, 0.2], "cubic"),
}


@pytest.fixture(params=PIECEWISE)
def piecewise(request):
    return PIECEWISE[request.param]


def test_single_frequency_is_exact():
    found = SymbolicReference("0.3*cos(2*t) + 0.4*sin(2*t) - 0.1").bounds(2)
    assert found.values == pytest.approx((0.6, 1.0, 2.0))
    assert found.origin == ("exact",) * 3


def test_products_of_sinusoids_become_sums():
    found = SymbolicReference("sin(t)*cos(t)").bounds(1)
    assert found.values == pytest.approx((0.5, 1.0))
    assert found.origin == ("exact", "exact")


def test_two_frequencies_give_the_sum_of_amplitudes():
    found = SymbolicReference("sin(t) + 0.5*sin(sqrt(2)*t)").bounds(0)
    assert found.values[0] == pytest.approx(1.5)
    assert found.origin == ("proven",)


@pytest.mark.parametrize(
    "signal",
    [
        "exp(-t)*sin(3*t)",
        "tanh(t)*cos(t)",
        "atan(t) - 1",
        "1/(1 + t)",
        "sqrt(2 + sin(t))",
        "abs(sin(t)) + min(cos(t), 0.5)",
        "max(0, sin(t))",
        "0.7",
    ],
)
def test_interval_bounds_hold_everywhere(signal):
    reference = SymbolicReference(signal)
    order = int(min(1, reference.order))
    found = reference.bounds(order)
    largest = np.abs(reference.values(DENSE, order)).max(axis=1)
    assert np.all(np.array(found.values) >= largest)


@given(st.lists(st.tuples(st.floats(-2, 2), st.floats(0.1, 5), st.floats(-3, 3)), max_size=4))
def test_bounds_of_random_sinusoids_hold(terms):
    signal = " + ".join(f"({a:.3f})*sin({w:.3f}*t + ({p:.3f}))" for a, w, p in terms) or "0"
    reference = SymbolicReference(signal)
    found = reference.bounds(1)
    largest = np.abs(reference.values(DENSE[::20], 1)).max(axis=1)
    assert np.all(np.array(found.values) >= largest - 1e-12)


def test_bound_that_cannot_be_proven_is_asked_for():
    with pytest.raises(InputError, match=r"could not be proven .* State it: bounds"):
        SymbolicReference("sin(t**2)").bounds(1)


def test_declared_bounds_are_used_and_contradictions_refused():
    found = SymbolicReference("sin(t**2)", declared=(1.0,)).bounds(0)
    assert found == type(found)((1.0,), ("declared",))
    with pytest.raises(InputError, match=r"reference.bounds\[0\]: must bound"):
        SymbolicReference("2*sin(t)", declared=(1.0,))
    with pytest.raises(InputError, match="reference.bound: must bound"):
        SymbolicReference("2*sin(t)", bound=1.0)
    with pytest.raises(InputError, match="reference.bound: must bound"):
        triangle(1.0, 1.0, bound=1.0)


def test_total_bound_is_declared_or_summed():
    assert total_bound(SymbolicReference("0.2*cos(t)", bound=0.4)) == 0.4
    assert total_bound(SymbolicReference("0.2*cos(t)")) == pytest.approx(0.4)


def test_jumps_and_poles_are_refused():
    with pytest.raises(InputError, match="may jump"):
        SymbolicReference("sign(sin(t))")
    with pytest.raises(InputError, match="not finite"):
        SymbolicReference("1/(1 - t)")


def test_derivatives_match_differences(piecewise):
    t = np.linspace(0.0137, 11, 977)
    breaks = piecewise.breaks(0, 12)
    keep = np.min(np.abs(t[:, None] - breaks), axis=1) > 1e-4
    h = 1e-5
    for order in range(1, int(piecewise.order) + 1):
        values = piecewise.values(t, order)[order]
        low, high = (piecewise.values(t + s * h, order - 1)[order - 1] for s in (-1, 1))
        assert np.abs((high - low) / (2 * h) - values)[keep].max() < 1e-6


def test_lower_derivatives_are_continuous(piecewise):
    breaks = piecewise.breaks(0, 12)
    left = piecewise.values(breaks - 1e-9, int(piecewise.order) - 1)
    right = piecewise.values(breaks + 1e-9, int(piecewise.order) - 1)
    assert np.abs(left - right).max() < 1e-7


def test_formulas_equal_values_on_every_piece(piecewise):
    edges = [0.0, *piecewise.breaks(0, 12), 12.0]
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        known = dict(zip(piecewise.piece_symbols, piecewise.piece_values(begin), strict=True))
        middle = (begin + end) / 2
        for order, formula in enumerate(piecewise.formulas(2)):
            found = float(
                formula.subs(known)
                .subs({"t": middle})
                .subs(dict.fromkeys(formula.free_symbols, middle))
            )
            expected = piecewise.values(np.array([middle]), order)[order, 0]
            assert found == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("offset", "start"), [(0.0, 0.0), (0.1, -0.3), (-2.0, 1.7)])
def test_triangle_is_the_arcsine_of_a_sine(offset, start):
    """It rises for half a period from its lowest value at `start`, and falls for the other half."""
    phase = 2 * np.pi * (DENSE[::13] - start) / 4.0
    expected = offset + 0.2 * 2 / np.pi * np.arcsin(-np.cos(phase))
    found = triangle(0.2, 4.0, offset, start).values(DENSE[::13], 0)[0]
    assert np.abs(found - expected).max() < 1e-8  # the arcsine loses half the digits at its ends


def test_trapezoid_rises_holds_falls_and_holds():
    at = [3.0, 3.25, 3.5, 4.0, 4.5, 4.75, 5.0, 5.9]
    value, slope = trapezoid(0.2, 3.0, 0.5, offset=1.0, start=3.0).values(np.array(at), 1)
    assert value == pytest.approx([0.8, 1.0, 1.2, 1.2, 1.2, 1.0, 0.8, 0.8])
    assert slope == pytest.approx([0.8, 0.8, 0.0, 0.0, -0.8, -0.8, 0.0, 0.0])


def test_bounds_are_attained_and_never_passed(piecewise):
    bounds = np.array(piecewise.bounds(1).values)
    largest = np.abs(piecewise.values(np.linspace(-2, 20, 220_001), 1)).max(axis=1)
    assert np.all(largest <= bounds)
    assert np.all(largest >= bounds * (1 - 1e-6))


def test_samples_interpolate_with_scipy_inside():
    t, y = np.array([0, 1, 2, 3.5, 5]), np.array([0, 0.1, 0.3, 0.2, 0.2])
    inside = np.linspace(0, 5, 301)
    cubic = samples(t, y, "cubic").values(inside, 0)[0]
    assert np.abs(cubic - CubicSpline(t, y, bc_type="clamped")(inside)).max() < 1e-14
    middle = np.linspace(1, 3.5, 100)  # the ends have zero slope instead of SciPy's
    monotone = samples(t, y).values(middle, 0)[0]
    assert np.abs(monotone - PchipInterpolator(t, y)(middle)).max() < 1e-14
    whole = samples(t, y).values(inside, 0)[0]
    assert whole.min() >= 0
    assert whole.max() <= 0.3
    held = samples(t, y).values(np.array([-3.0, 9.0]), 1)
    assert held.tolist() == [[0, 0.2], [0, 0]]


@pytest.mark.slow
def test_bounds_of_many_samples_are_fast_and_right():
    t = np.linspace(0, 300 * np.pi, 100_000)  # zero slope at both ends, as the interpolant has
    reference = samples(t, np.cos(t))
    assert reference.bounds(1).values == pytest.approx((1, 1), rel=1e-3)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: triangle(0, 1), "amplitude"),
        (lambda: triangle(1, -1), "period"),
        (lambda: trapezoid(1, 1, 0.6), "rise"),
        (lambda: steps([], [1], 1), "times"),
        (lambda: steps([1], [1], 1), "levels"),
        (lambda: steps([1, 1.5], [0, 1, 0], 1), "times[1]"),
        (lambda: steps([1], [1, 1], 1), "levels[1]"),
        (lambda: steps([1], [0, 1], 0), "slope"),
        (lambda: samples([0, 0], [1, 2]), "times[1]"),
        (lambda: samples([0], [1]), "times"),
        (lambda: samples([0, 1], [1]), "values"),
        (lambda: samples([0, 1], [1, 2], "linear"), "interpolation"),
        (lambda: samples([0, 1], [1, float("nan")]), "values[1]"),
    ],
)
def test_bad_fields_are_named(make, key):
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value).startswith(f"reference.{key}: ")


def test_bounds_beyond_the_order_are_refused():
    with pytest.raises(InputError, match="needs 2 bounded derivatives"):
        SymbolicReference("abs(sin(t))").bounds(2)  # y_d'' contains impulses


@pytest.mark.parametrize("scale", [1e-170, 1e-20, 1, 1e140])
def test_sample_bounds_do_not_depend_on_the_scale(scale):
    found = samples((0, 1, 2, 3), (0, scale, 1.1 * scale, 0), "cubic").bounds(1).values
    unit = samples((0, 1, 2, 3), (0, 1, 1.1, 0), "cubic").bounds(1).values
    assert np.array(found) / scale == pytest.approx(unit, rel=1e-9)


def test_constants_enter_bounds_exactly():
    from fractions import Fraction

    reference = SymbolicReference("A*sin(t)", constants={"A": "1/3"})
    assert Fraction(reference.bounds(0).values[0]) >= Fraction(1, 3)
    assert (
        SymbolicReference("A*sin(t)", constants={"A": np.float64(0.5)}).bounds(0).values[0] == 0.5
    )


def test_wrong_declared_bound_of_samples_is_refused():
    with pytest.raises(InputError, match="reference.bound: must bound"):
        samples((0, 1), (0, 1), bound=1.0)  # y_d + y_d' reaches 2.09


@pytest.mark.parametrize("signal", ["atan2(sin(t), cos(t))", "atan(tan(t))", "tan(2*sin(t))"])
def test_functions_that_may_jump_are_refused(signal):
    with pytest.raises(InputError, match="may jump"):
        SymbolicReference(signal)


def test_arcsine_that_reaches_its_ends_has_order_one():
    assert SymbolicReference("asin(sin(t))").order == 1  # a triangle
    assert SymbolicReference("asin(0.9*sin(t))").order == math.inf


def test_expanding_huge_sums_is_not_tried():
    text = "(sin(t) + cos(2*t) + sin(3*t) + cos(5*t) + sin(7*t))**64"
    assert SymbolicReference(text).bounds(0).origin == ("proven",)


@pytest.mark.parametrize(
    "make",
    [
        lambda: trapezoid(1, 20, 1e-13),
        lambda: trapezoid(1, 20, 5, start=1e20),
        lambda: triangle(1, 20, start=-1e15),
        lambda: steps([1e20], [0, 1], 1),
        lambda: steps([0], [0, 1], 1e14),
        lambda: steps([0, 1e14], [0, 1, 0], 1),
        lambda: samples([0, 1e-14, 1], [0, 1, 0]),
    ],
)
def test_a_piece_that_rounding_would_lose_is_refused(make):
    """Such a piece is a jump, which no bound on y_d' allows."""
    with pytest.raises(InputError, match="too narrow for its time"):
        make()


@given(
    st.floats(0.01, 100),
    st.floats(1e-3, 1e3),
    st.floats(1e-9, 0.5),
    st.floats(-1e9, 1e9),
)
def test_pieces_meet_whatever_their_times(amplitude, period, part, start):
    """|y_d(s) - y_d(t)| <= Y_1 |s - t| on both sides of every knot that is accepted."""
    try:
        reference = trapezoid(amplitude, period, part * period, start=start)
    except InputError as problem:
        assert "too narrow for its time" in str(problem)
        return
    knots, rows = np.array(reference.knots), np.array(reference.coefficients)
    ends = rows[:, 0] + rows[:, 1] * np.diff(knots)
    starts = np.append(rows[1:, 0], rows[0, 0])
    assert np.abs(ends - starts).max() <= 1e-14 * amplitude
    assert reference.bounds(1).values[1] >= np.abs(np.diff(rows[:2, 0]) / np.diff(knots[:2]))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"knots": ("a",)}, "knots"),
        ({"knots": (0.0, 2.0, 1.0)}, "knots[2]"),
        ({"knots": (0.0, 1.0, math.inf)}, "knots"),
        ({"knots": 3}, "knots"),
        ({"knots": (0.0,), "coefficients": ()}, "knots"),
        ({"knots": (0.0, 1.0)}, "coefficients"),
        ({"coefficients": "abc"}, "coefficients"),
        ({"coefficients": ((1.0, 0.0), (2.0,))}, "coefficients"),
        ({"coefficients": ((math.nan,) * 4,) * 2}, "coefficients"),
        ({"smoothness": 0}, "smoothness"),
        ({"smoothness": 1.5}, "smoothness"),
        ({"period": -1}, "period"),
        ({"period": 3}, "period"),
        ({"bound": "x*"}, "bound"),
    ],
)
def test_no_invalid_pieces_exist(change, key):
    with pytest.raises(InputError) as caught:
        replace(triangle(1, 2), **change)
    assert str(caught.value).startswith(f"reference.{key}: ")


@pytest.mark.parametrize(
    "change",
    [
        {"coefficients": ((-1.0, 2.0, 0.0, 0.0), (1.1, -2.0, 0.0, 0.0))},  # between pieces
        {"coefficients": ((-1.0, 2.0, 0.0, 0.0), (1.0, -1.0, 0.0, 0.0))},  # where it repeats
        {"smoothness": 2},  # the slope
        {"smoothness": 2, "period": None, "coefficients": ((0, 1, 0, 0), (1, 1, 0, 0))},  # held
    ],
)
def test_pieces_that_jump_are_refused(change):
    with pytest.raises(InputError, match="must not jump"):
        replace(triangle(1, 2), **change)


@pytest.mark.parametrize(
    "make", [lambda: triangle(1e300, 1e-10), lambda: steps([0], [0, 1e300], 1e-10)]
)
def test_overflow_of_a_reference_is_refused(make):
    with pytest.raises(InputError, match=r"^reference.*(overflows|finite)"):
        make()


def test_contiguous_moves_are_accepted():
    assert steps((0.1, 0.3), (0, 0.2, 0.4), 1.0).bounds(0).values[0] == pytest.approx(0.4)


@register("wave", height=Key("number", help="its amplitude", required=True))
@dataclass(frozen=True)
class Wave:
    """A newcomer's reference, with the duties of Reference and nothing else: h sin(0.75 t)."""

    height: float
    declared_bound: float | None = None
    order = math.inf
    parameter_symbols = (sympy.Symbol("ref_height", real=True),)
    piece_symbols = ()

    @property
    def parameter_values(self):
        return (self.height,)

    def bounds(self, order):
        sizes = tuple(round_up(abs(self.height) * 0.75**i) for i in range(order + 1))
        return Bounds(sizes, ("exact",) * (order + 1))

    def breaks(self, start, end):
        return np.empty(0)

    def piece_values(self, t):
        return np.empty(0)

    def values(self, t, order):
        phase = 0.75 * np.asarray(t)[None, :] + np.pi / 2 * np.arange(order + 1)[:, None]
        return self.height * 0.75 ** np.arange(order + 1)[:, None] * np.sin(phase)

    def formulas(self, order):
        signal = self.parameter_symbols[0] * sympy.sin(sympy.Rational(3, 4) * TIME)
        return tuple(sympy.diff(signal, TIME, i) for i in range(order + 1))


def test_a_function_that_is_registered_remembers_its_arguments():
    @register("bumps", times=Key("numbers"), levels=Key("numbers"), slope=Key("number"))
    def bumps(times, levels, slope=1.0):
        return steps(times, levels, slope or 2.0)

    found = bumps([1.0, 4.0], np.array([0.0, 1.0, 0.0]), slope=None)
    assert found.fields == (("kind", "bumps"), ("times", (1.0, 4.0)), ("levels", (0.0, 1.0, 0.0)))
    assert bumps((1.0,), (0.0, 1.0), 3.0).fields[1:] == (
        ("times", (1.0,)),
        ("levels", (0.0, 1.0)),
        ("slope", 3.0),
    )


@pytest.mark.parametrize("name", ["dual-motor-lean", "dual-motor-drive"])
def test_the_stated_duties_of_a_reference_suffice(name):
    """It is simulated, swept without recompiling, sampled and certified like a formula."""
    system = certrack.load(name).with_settings(duration=5.0, tail=None)
    systems = [system.replace(reference=Wave(height)) for height in (0.1, 0.05)]
    simulator = certrack.Simulator(systems[0])
    for ours, height in zip(systems, (0.1, 0.05), strict=True):
        formula = system.replace(reference=SymbolicReference(f"{height}*sin(0.75*t)"))
        expected = certrack.simulate(formula)
        assert simulator.run(ours).final_state == pytest.approx(expected.final_state, abs=1e-7)
        bounds = [certify_semidefinite(entry)[0].bound for entry in (ours, formula)]
        assert bounds[0] == pytest.approx(bounds[1], rel=1e-6)


def test_a_triangle_has_its_corners_where_it_turns():
    found = triangle(0.2, 4.0, offset=0.1, start=-0.3)
    assert found.knots == (-0.3, 1.7, 3.7)
    assert found.breaks(0, 8).tolist() == pytest.approx([1.7, 3.7, 5.7, 7.7])
    times = np.array([-0.3, 0.7, 1.7, 2.7, 3.7, 4.7])
    level, slope = found.values(times, 1)
    assert level == pytest.approx([-0.1, 0.1, 0.3, 0.1, -0.1, 0.1])
    assert slope == pytest.approx([0.2, 0.2, -0.2, -0.2, 0.2, 0.2])


def test_a_trapezoid_that_hardly_holds_is_a_triangle():
    assert trapezoid(1.0, 4.0, 2.0 - 1e-13).knots == (0.0, 2.0, 4.0)
    assert trapezoid(1.0, 4.0, 1.0).knots == (0.0, 1.0, 2.0, 3.0, 4.0)


@pytest.mark.parametrize("period", [0.1, 0.3, 1 / 3, 0.7])
def test_a_break_belongs_to_the_piece_after_it(period):
    """Also where t less so many periods is rounded below the first knot."""
    found = triangle(0.5, period, start=0.1)
    turns = 0.1 + period * np.arange(1, 2000)
    for shift, slope in ((0.0, 2 / period), (period / 2, -2 / period)):
        times = turns + shift + 1e-12 * turns
        assert found.values(times, 1)[1] == pytest.approx(np.full(len(times), slope))
        pieces = np.array([found.piece_values(t) for t in times[::97].tolist()])
        assert pieces[:, 2] == pytest.approx(np.full(len(pieces), slope))


def test_shapes_remember_what_made_them():
    size = ("amplitude", 0.2), ("period", 4.0)
    assert trapezoid(0.2, 4.0, 1.0, 0.1, -0.3).fields == (
        ("kind", "trapezoid"),
        *size,
        ("rise", 1.0),
        ("offset", 0.1),
        ("start", -0.3),
    )
    assert triangle(0.2, 4.0).fields == (
        ("kind", "triangle"),
        *size,
        ("offset", 0.0),
        ("start", 0.0),
    )
    times, levels = ("times", (1.0, 3.0)), ("levels", (0.5, 1.0, -1.0))
    found = steps([1.0, 3.0], [0.5, 1.0, -1.0], 2.0)
    assert found.fields == (("kind", "steps"), times, levels, ("slope", 2.0))
    moved = profile((0, 1, 2), (0, 0), (2, -2))
    assert moved.fields == (
        ("kind", "profile"),
        ("times", (0, 1, 2)),
        ("start", (0, 0)),
        ("highest", (2, -2)),
    )
    written = samples([0, 1, 2], [0, 1, 0]).fields
    assert written[:3] == (("kind", "samples"), ("times", (0, 1, 2)), ("values", (0, 1, 0)))
    assert written[3:] == (("interpolation", "monotone"),)
    turning = samples(
        [0, 1000, 2000], [0, 1, 0], "spline", time_unit="ms", degree=7, repeat=True
    ).fields
    assert turning[3:] == (
        ("interpolation", "spline"),
        ("time_unit", "ms"),
        ("degree", 7),
        ("repeat", True),
    )
    assert samples([0, 1, 2], [0, 1, 0], "cubic", repeat=True).fields[-1] == ("repeat", True)


def test_steps_stand_still_before_the_first_and_after_the_last():
    found = steps([1.0, 3.0], [0.5, 1.0, -1.0], 2.0)
    level, slope = found.values(np.array([0.0, 0.9, 2.0, 5.0, 9.0]), 1)
    assert level.tolist() == pytest.approx([0.5, 0.5, 1.0, -1.0, -1.0])
    assert slope.tolist() == [0.0] * 5
    assert found.piece_values(0.0)[1:].tolist() == [0.5, 0.0, 0.0, 0.0]
    assert found.piece_values(9.0)[1:].tolist() == pytest.approx([-1.0, 0.0, 0.0, 0.0])


def test_a_declared_bound_is_kept_if_it_holds():
    largest = 0.2 + 4 * 0.2 / 4.0
    assert triangle(0.2, 4.0, bound=largest).declared_bound == largest
    with pytest.raises(InputError, match="must bound"):
        triangle(0.2, 4.0, bound=0.999 * largest)


def test_slopes_that_overflow_are_refused_as_too_steep():
    with pytest.raises(InputError, match="so steep that its slope overflows"):
        trapezoid(1e299, 1e-9, 1e-10)


@pytest.mark.parametrize(
    ("text", "bound"),
    [
        ("sin(0.2*tanh(t))", math.sin(0.2)),  # by intervals: of sin, not of cos
        ("1 - cos(0.2*tanh(t))", 1 - math.cos(0.2)),
        ("sqrt(abs(sin(t)))", 1.0),  # of what may be zero
        ("cos(2*t) - cos(-2*t) + 0.1", 0.1),
        ("sin(2*t + 1) + sin(-2*t - 1) + 0.1", 0.1),
    ],
)
def test_bounds_by_intervals_are_near_what_is_reached(text, bound):
    (found,) = SymbolicReference(text).bounds(0).values
    assert bound * (1 - 1e-9) <= found <= bound * 1.02


def test_an_irrational_constant_is_enclosed():
    """The nearest double of pi is below pi."""
    (found,) = SymbolicReference("pi*tanh(t)").bounds(0).values
    assert sympy.Rational(found) >= sympy.pi
    assert found < math.pi * (1 + 1e-12)


@pytest.mark.parametrize("text", ["abs(t - 2)*exp(-t)", "abs(2 - t)*exp(-t)"])
def test_a_kink_is_the_same_from_both_sides(text):
    """The slope of |t - 2| exp(-t) jumps by 2 exp(-2) at t = 2."""
    ((time, size),) = SymbolicReference(text).smoothness.jumps(1)
    assert time == pytest.approx(2, abs=1e-12)
    assert 2 * math.exp(-2) <= size <= 2 * math.exp(-2) * (1 + 1e-12)
    assert SymbolicReference(text).smoothness.jumps(0) == ()

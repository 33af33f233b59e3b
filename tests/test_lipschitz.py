"""Slopes of the last derivative that a law uses, and its jumps: exact cases and dense samples."""

import math

import numpy as np
import pytest
from depth import depth
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack.core.errors import InputError
from certrack.references import (
    PiecewiseReference,
    SymbolicReference,
    jumps,
    lipschitz_bound,
    samples,
    steps,
    trapezoid,
    triangle,
)

#: A C^2 move by thirds, of which the third derivative jumps by 6, 12, 12 and 6.
MOVE = "max(0, t - 1)**3 - 2*max(0, t - 2)**3 + 2*max(0, t - 4)**3 - max(0, t - 5)**3"


@pytest.mark.parametrize(
    ("reference", "order", "slope"),
    [
        (SymbolicReference("0.1*sin(0.75*t)"), 2, 0.1 * 0.75**3),
        (SymbolicReference("0.2 + 0.3*cos(2*t)*sin(2*t)"), 0, 0.6),
        (SymbolicReference("t"), 0, 1.0),
        (SymbolicReference("t"), 1, 0.0),
        (SymbolicReference("t*exp(-t)"), 1, 2.0),
        (SymbolicReference("exp(-t**2)"), 1, 2.0),
        (SymbolicReference(MOVE), 2, 6.0),
        (triangle(0.2, 4.0), 0, 0.2),
        (trapezoid(0.2, 5.0, 0.5), 0, 0.8),
        (steps([1, 4, 8], [0, 0.2, -0.1, 0.3], 1.0), 0, 1.0),
        (samples([0, 2], [0, 1]), 0, 0.75),  # 3 s^2 - 2 s^3 in s = t/2: largest slope 3/2 ds/dt
        (samples([0, 2], [0, 1]), 1, 1.5),
    ],
)
def test_slopes_of_known_references(reference, order, slope):
    assert slope <= lipschitz_bound(reference, order) <= slope * (1 + 1e-4) + 1e-300
    assert jumps(reference, order) is None


@pytest.mark.parametrize(
    ("reference", "order", "expected", "slope"),
    [
        (triangle(0.2, 4.0, start=-1), 1, (0.4, 2.0), 0.0),
        (trapezoid(0.2, 5.0, 0.5), 1, (0.8, 0.5), 0.0),
        (trapezoid(0.2, 5.0, 2.4, start=7), 1, (1 / 6, 0.1), 0.0),
        (steps([1, 4, 8], [0, 0.2, -0.1, 0.3], 1.0), 1, (1.0, 0.2), 0.0),
        (steps([1, 2], [0, 1, 0], 1.0), 1, (2.0, 1.0), 0.0),
        (steps([0], [0, 1], 1.0), 1, (1.0, math.inf), 0.0),  # what is at 0 is no jump
        (samples([0, 2], [0, 1]), 2, (1.5, math.inf), 1.5),
        (samples([1, 3], [0, 1]), 2, (1.5, 2.0), 1.5),
        (SymbolicReference(MOVE), 3, (12.0, 1.0), 0.0),
        (SymbolicReference("min(t, 1)**2"), 1, (2.0, math.inf), 2.0),
        (SymbolicReference("abs(t - 1/3) + abs(t - pi)"), 1, (2.0, math.pi - 1 / 3), 0.0),
    ],
)
def test_jumps_of_known_references(reference, order, expected, slope):
    size, spacing = jumps(reference, order)
    assert expected[0] <= size <= expected[0] * (1 + 1e-9)
    assert math.isinf(spacing) if math.isinf(expected[1]) else spacing <= expected[1]
    assert spacing >= expected[1] * (1 - 1e-9)
    assert lipschitz_bound(reference, order) is None
    between = lipschitz_bound(reference, order, between_jumps=True)
    assert slope <= between <= slope * (1 + 1e-4) + 1e-300


def test_a_spline_jumps_only_where_it_begins_and_ends():
    spline = samples([1, 2, 3, 4.5, 6], [0, 0.1, 0.3, 0.2, 0.2], "cubic")
    size, spacing = jumps(spline, 2)
    left, right = (abs(spline.values(np.array([t]), 2)[2, 0]) for t in (1.0, 6 - 1e-9))
    assert size == pytest.approx(max(left, right), rel=1e-6)
    assert spacing == pytest.approx(5)


def test_the_shortest_time_may_be_from_one_period_to_the_next():
    rows = ((0.0, 1.0, 0.0, 0.0), (1.0, -0.5, 0.0, 0.0), (0.5, -5.0, 0.0, 0.0))
    saw = PiecewiseReference((0.0, 1.0, 2.0, 2.1), rows, 1, 2.1)
    assert jumps(saw, 1) == pytest.approx((6.0, 0.1), rel=1e-9)
    assert jumps(saw, 1)[0] >= 6 and jumps(saw, 1)[1] <= 0.1


@pytest.mark.parametrize(
    ("signal", "order"), [("abs(sin(t))", 1), ("sin(t**2)", 0), ("t**2", 0), ("asin(sin(t))", 1)]
)
def test_what_is_not_known_is_none(signal, order):
    reference = SymbolicReference(signal)
    assert lipschitz_bound(reference, order) is jumps(reference, order) is None


def test_beyond_the_order_there_is_nothing():
    assert triangle(1, 1).lipschitz_bound(2) is triangle(1, 1).jumps(2) is None
    assert SymbolicReference(MOVE).lipschitz_bound(4, between_jumps=True) is None


class TestStated:
    def test_the_next_bound_is_a_slope(self):
        reference = SymbolicReference("sin(t**2)/(1 + t)**4", declared=[0.4, 1, 4, "30"])
        assert reference.lipschitz_bound(2) == 30.0
        assert reference.bound_of(3) == (30.0, "declared")

    def test_of_a_derivative_whose_kinks_are_hidden(self):
        reference = SymbolicReference("abs(sin(t))**3", declared=[1, 1.2, 3])
        assert reference.order == 1 and reference.lipschitz_bound(1) == 3.0
        assert SymbolicReference("abs(sin(t))**3").lipschitz_bound(1) is None

    @pytest.mark.parametrize(
        ("signal", "declared", "key"),
        [
            ("0.1*sin(0.75*t)", [0.1, 0.075, 0.05625, 0.0421], "reference.bounds[3]"),
            ("abs(sin(t))**3", [1, 1.2, 2.9], "reference.bounds[2]"),
            ("abs(sin(t))", [1, 1, 1], "reference.bounds[2]"),  # y_d' jumps
            ("min(t, 1)**2", [1, 2, 1.9], "reference.bounds[2]"),
        ],
    )
    def test_that_a_sample_breaks_is_refused(self, signal, declared, key):
        with pytest.raises(InputError) as problem:
            SymbolicReference(signal, declared=declared)
        assert problem.value.key == key

    def test_at_a_known_jump_is_between_the_jumps(self):
        reference = SymbolicReference("min(t, 1)**2", declared=[1, 2, 2])
        assert reference.lipschitz_bound(1) is None
        assert reference.lipschitz_bound(1, between_jumps=True) == 2.0

    def test_in_a_file(self):
        text = certrack.to_text(certrack.load("dual-motor-lean"))
        stated = text.replace("bound = 0.2", "bounds = [0.1, 0.075, 0.05625, 0.05]")
        assert certrack.loads(stated).reference.lipschitz_bound(2) == 0.05
        with pytest.raises(InputError, match=r"reference\.bounds\[3\]: must bound \|y_d\^\(3\)\|"):
            certrack.loads(stated.replace("0.05]", "0.04]"))


class Foreign:
    """A reference with nothing but its duties."""

    order = 2.0

    def bounds(self, order):
        return certrack.Bounds(tuple(range(1, order + 2)), ("proven",) * (order + 1))


def test_a_reference_of_ones_own_has_the_slopes_of_its_bounds():
    assert [lipschitz_bound(Foreign(), i) for i in range(3)] == [2, 3, None]
    assert jumps(Foreign(), 2) is None


# ---- dense samples -------------------------------------------------------------------------------

NUMBERS = st.floats(-3, 3).map(lambda v: round(v, 3))
WIDTHS = st.floats(0.05, 2).map(lambda v: round(v, 3))


@st.composite
def pieces(draw):
    """Interpolated samples, moves and trapezoids."""
    kind = draw(st.sampled_from(["monotone", "cubic", "trapezoid", "triangle"]))
    begin = draw(st.floats(-1, 1).map(lambda v: round(v, 2)))
    if kind == "trapezoid":
        period = draw(WIDTHS)
        share = draw(st.floats(0.05, 0.5))
        return trapezoid(draw(NUMBERS.filter(bool)), period, period * share, start=begin)
    if kind == "triangle":
        return triangle(draw(NUMBERS.filter(bool)), draw(WIDTHS), start=begin)
    widths = draw(st.lists(WIDTHS, min_size=1, max_size=5))
    values = draw(st.lists(NUMBERS, min_size=len(widths) + 1, max_size=len(widths) + 1))
    return samples(np.cumsum([begin, *widths]).tolist(), values, kind)


@st.composite
def kinked(draw):
    """Formulas with kinks in a derivative of an order of their own, and smooth ones added."""
    power = draw(st.integers(1, 3))
    terms = [
        f"({draw(NUMBERS)})*max(0, t - {draw(st.floats(0.1, 4)):.3f})**{power}*exp(-t)"
        for _ in range(draw(st.integers(1, 3)))
    ]
    smooth = draw(st.sampled_from(["0", "sin(2*t)", "0.3*t*exp(-t)", "atan(t)", "1/(1 + t**2)"]))
    return SymbolicReference(" + ".join([*terms, smooth]))


def check_against_samples(reference):
    """No two neighbours are steeper, no jump is larger, and none is nearer to the next."""
    top = int(min(reference.order, 3))
    for order in range(top + 1):
        t = np.linspace(0, 6, 4001)
        breaks = (
            reference.breaks(0, 6.1)
            if isinstance(reference, PiecewiseReference)
            else [time for time, _ in reference.smoothness.jumps(order) or ()]
        )
        y = reference.values(t, order)[order]
        size = np.abs(y).max() + np.abs(reference.values(t, 0)).max() + 1e-300
        crossed = np.zeros(len(t) - 1, dtype=bool)
        places = np.searchsorted(t, breaks)
        for offset in (-2, -1, 0):  # a break may be a sample but for rounding
            crossed[np.clip(places + offset, 0, len(t) - 2)] = True
        slopes = (np.abs(np.diff(y)) - 1e-11 * size) / np.diff(t)
        found = jumps(reference, order)
        slope = lipschitz_bound(reference, order, between_jumps=found is not None)
        if slope is None:
            continue
        if found is None:
            assert slopes.max() <= slope * (1 + 1e-9)
            continue
        assert slopes[~crossed].max(initial=0) <= slope * (1 + 1e-9) + 1e-9 * size
        steps_there = np.abs(np.diff(y))[crossed]
        assert steps_there.max(initial=0) <= found[0] + 2 * slope * (t[1] - t[0]) + 1e-9 * size
        big = np.flatnonzero(np.abs(np.diff(y)) > 10 * slope * (t[1] - t[0]) + 1e-6 * size)
        apart = np.diff(big)[np.diff(big) > 1] * (t[1] - t[0])
        assert apart.min(initial=np.inf) >= found[1] - 2 * (t[1] - t[0])


@settings(max_examples=60, deadline=None)
@given(pieces())
def test_no_sample_of_pieces_is_steeper(reference):
    check_against_samples(reference)


@settings(max_examples=3, deadline=None)
@given(kinked())
def test_no_sample_of_a_formula_is_steeper(reference):
    check_against_samples(reference)


@pytest.mark.slow
@settings(max_examples=depth(25, 300), deadline=None)
@given(kinked())
def test_no_sample_of_many_formulas_is_steeper(reference):
    check_against_samples(reference)


@settings(max_examples=40, deadline=None)
@given(pieces())
def test_slopes_of_pieces_are_attained(reference):
    for order in range(int(reference.order)):
        t = np.linspace(0, 6, 6001)
        reached = np.abs(reference.values(t, order + 1)[order + 1]).max()
        slope = reference.lipschitz_bound(order)
        assert slope == pytest.approx(reference.bounds(order + 1).values[-1], rel=1e-9, abs=1e-12)
        assert reached <= slope * (1 + 1e-12)


def test_control_points_bound_polynomials_of_high_degree():
    """Against exact roots; near a double root, too, where numerical roots are off."""
    from flint import arb_poly, fmpq, fmpq_poly

    from certrack.references.polynomials import largest_by_control_points

    rng = np.random.default_rng(3)
    rows = [rng.integers(-9, 10, size=degree + 1) for degree in (3, 5, 8, 9) for _ in range(8)]
    rows.append(np.array([1, -8, 24, -32, 16]))  # (1 - 2 s)^4
    for row in rows:
        p = fmpq_poly([int(v) for v in row])
        ends = [abs(p(fmpq(0))), abs(p(fmpq(1)))]
        best = float(max(v.p / v.q for v in ends))
        for root, _ in p.derivative().numer().complex_roots():
            if root.imag.contains(0) and not (root.real < 0 or root.real > 1):
                best = max(best, float(arb_poly(p)(root.real).abs_lower()))
        terms = np.zeros((1, 10))
        terms[0, : len(row)] = row
        found = largest_by_control_points(terms, np.ones(1))
        assert best <= found <= best * (1 + 1e-9) + 1e-12

"""Formulas of t: what is accepted is continuous, and no bound is below what it bounds."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy
from depth import depth
from flint import arb, fmpq
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import iv

from certrack.certificates.intervals import enclosure
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, parse, symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.references import SymbolicReference
from certrack.references.growth import INFINITE, LINEAR, GrowthEnclosure, Span, Undefined, ball
from certrack.references.search import Formula, derivative_bound
from certrack.references.taylor import Evaluation

DENSE = np.linspace(0, 40, 40_001)
STEP = DENSE[1]


def bounds_of(text, order):
    """Bounds of the derivatives, None where there is none."""
    proven = SymbolicReference(text).smoothness
    return [proven.bound(i) for i in range(int(min(order, proven.order)) + 1)]


def check(text, order=2):
    """Each derivative is within its bound, and so are the differences of the one below it."""
    values = SymbolicReference(text).values(DENSE, order)
    bounds = bounds_of(text, order)
    for i, bound in enumerate(bounds):
        if bound is None:
            continue
        found = np.abs(values[i])
        rounding = 1e-9 * (1 + np.nanmax(found))
        assert np.nanmax(found) <= bound + rounding
        if i:
            below = values[i - 1]
            slope = np.abs(np.diff(below)) / STEP
            assert np.nanmax(slope) <= bound + 1e-9 * (1 + np.nanmax(np.abs(below))) / STEP


@pytest.mark.parametrize(
    ("text", "order", "exact"),
    [
        ("tanh(t)", 3, (1, 1, 4 / (3 * math.sqrt(3)), 2)),
        ("tanh(5*t - 3)", 2, (1, 5, 25 * 4 / (3 * math.sqrt(3)))),
        ("t*exp(-t)", 2, (1 / math.e, 1, 2)),
        ("t**3*exp(-t/2)", 1, ((6 / math.e) ** 3, 3.1344474)),
        ("exp(-t)*sin(3*t)", 1, (0.62561066, 3)),
        ("log(2 + sin(t))", 1, (math.log(3), 1 / math.sqrt(3))),
        ("sinh(sin(t))", 1, (math.sinh(1), 1)),
        ("1/cosh(t - 3)", 2, (1, 0.5, 1)),
        ("tan(0.3*sin(t))", 1, (math.tan(0.3), 0.3)),
        ("1/(-2 + sin(t))", 1, (1, 0.42374437)),
        ("t/(1 + t)", 1, (1, 1)),
        ("t**2/(1 + t**2)", 1, (1, 0.64951905)),
        ("sinh(t)/cosh(t)", 1, (1, 1)),
        ("exp(-((t - 10)/0.02)**2)", 1, (1, math.sqrt(2 / math.e) / 0.02)),
        ("log(1 + exp(-t))", 1, (math.log(2), 0.5)),
        ("(1 - exp(-t))*sin(2*pi*t)", 1, (1, 2 * math.pi)),
        ("asin(0.9*sin(t))", 1, (math.asin(0.9), 0.9)),
        ("1/(1 + exp(15 - 3*t))", 1, (1, 0.75)),
        ("abs(t - 2)**3*exp(-t)", 3, (8, 20, 44, 86)),
    ],
)
def test_bounds_of_known_signals_are_within_one_percent(text, order, exact):
    found = bounds_of(text, order)
    assert np.all(np.array(found) >= np.array(exact) * (1 - 1e-8))
    assert np.all(np.array(found) <= np.array(exact) * 1.01)
    check(text, order)


@pytest.mark.parametrize(
    "text",
    [
        "1/(t - 1)",
        "atan(1/(t - 1))",
        "tan(t)",
        "tan(t/100)",
        "1/sin(t)",
        "atan(tan(t))",
        "(t - 3)/abs(t - 3)",
        "abs(sin(t + 0.1234))/sin(t + 0.1234)",
        "sign(t - 1)*t",
        "sin(t)*sign(cos(t))",
        "atan2(sin(t), cos(t))",
        "sqrt((t - 1)**2)/(t - 1)",
        "t - atan(tan(t))",  # a floor
        "asin(sin(t))/acos(cos(t))",
        "acos(cos(t))/sin(t)",
        "log(abs(t - 5))",
        "tanh(1/(t - 7))",
        "exp(-1/(t - 2)**2)",  # smooth, but not shown to be
        "1/(t - 50)",
        "max(t - 1, 0)/(t - 1)",
        "abs(t - 1)**0.5/(t - 1)",
        "1/(1 - 1.00001*sin(t))",
        "1/(2 + sin(t) + 1.5*sin(sqrt(2)*t))",
        "log(sin(t))",
        "acos(1.2*sin(t))",
        "sqrt(sin(t))",
        "1/log(1 + t)",
    ],
)
def test_what_may_jump_or_has_a_pole_is_refused_with_a_remedy(text):
    with pytest.raises(InputError, match=r"^reference\.signal: .*jump.*\. .*kind = ") as caught:
        SymbolicReference(text, declared=(1e3, 1e3))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "order"),
    [
        ("min(t, 1)", 1),
        ("max(t - 1, 0)**3", 3),
        ("min(max(t, 0), 1)**2*(3 - 2*min(max(t, 0), 1))", 2),
        ("abs(t - 1)*sin(t)", 1),
        ("abs(t - 1)*(t - 1)", 2),
        ("abs(t + 1)", math.inf),
        ("abs(sin(t))", 1),
        ("asin(sin(t))", 1),
        ("sqrt(abs(sin(t)))", 1),
        ("sqrt(1 + t)", math.inf),
        ("max(t - 1, 0)*exp(-t) + min(t, 2)**2", 1),
        ("max(sin(t) + 2, 0)", 1),  # no kink, but that is not looked for
    ],
)
def test_the_order_is_the_derivative_that_jumps(text, order):
    assert SymbolicReference(text).order == order


def test_what_grows_is_continuous_but_has_no_bound():
    for text in ("0.5*t", "exp(t/10)", "log(1 + t)", "t*sin(t)", "exp(exp(t))"):
        reference = SymbolicReference(text)
        with pytest.raises(InputError, match="Y_0 of .* could not be proven"):
            reference.bound_of(0)
    assert SymbolicReference("0.5*t").bound_of(1) == (0.5, "proven")
    assert SymbolicReference("log(1 + t)").bound_of(1)[0] == pytest.approx(1)


@st.composite
def signals(draw, depth=3):
    """Formulas of t, many of which have poles or kinks."""
    number = st.sampled_from(["0.5", "1", "2", "3", "0.1", "pi/3", "sqrt(2)", "7"])
    if depth == 0:
        return draw(st.sampled_from(["t", "sin(t)", "cos(3*t)", "exp(-t)", draw(number)]))
    inner = signals(depth=depth - 1)
    kind = draw(st.sampled_from("+-*/fffpmt"))
    if kind == "f":
        names = "sin cos tanh atan exp log sqrt abs tan sinh cosh asin acos".split()
        return f"{draw(st.sampled_from(names))}({draw(inner)})"
    if kind == "p":
        return f"({draw(inner)})**{draw(st.sampled_from(['2', '3', '-1', '-2', '0.5', '1.5']))}"
    if kind == "m":
        return f"{draw(st.sampled_from(['min', 'max']))}({draw(inner)}, {draw(inner)})"
    if kind == "t":
        return f"sin({draw(number)}*t + {draw(inner)})"
    return f"({draw(inner)}) {kind} ({draw(inner)})"


@settings(max_examples=40, deadline=None)
@given(signals(depth=2))
def test_no_accepted_short_signal_jumps_or_passes_its_bounds(text):
    _check_if_accepted(text)


@pytest.mark.slow
@settings(max_examples=depth(60, 1000), deadline=None)
@given(signals())
def test_no_accepted_signal_jumps_or_passes_its_bounds(text):
    _check_if_accepted(text)


def _check_if_accepted(text):
    try:
        reference = SymbolicReference(text)
    except InputError:
        return
    values = reference.values(DENSE, 0)[0]
    if np.isfinite(values).all() and np.abs(values).max() < 1e6:
        check(text, 1)


@settings(max_examples=100, deadline=None)
@given(signals(), st.floats(0, 30), st.floats(0, 2))
def test_taylor_coefficients_enclose_those_of_mpmath(text, begin, width):
    """On a short interval without an end and on one with: derivatives at points inside it."""
    try:
        expr = parse("", text, ["t"]).expr
        times = [ball(begin, begin + width)]
        times.append(GrowthEnclosure(Span(arb(begin), INFINITE), {LINEAR: fmpq(1)}))
        found = [Evaluation(time, 1).series(expr) for time in times]
    except (Undefined, InputError):
        return
    for part in (0.0, 0.37, 1.0):
        t = begin + part * width
        try:
            sympy.lambdify(TIME, expr, "math")(t)
        except (ArithmeticError, ValueError):  # mpmath counts the digits of sinh(1e20) for ever
            continue
        with mpmath.workdps(60):
            at = sympy.Float(t, 60)
            exact = expr.xreplace({TIME: at}).evalf(40)
        if not exact.is_real or not exact.is_finite:
            continue
        for series in found:
            value = (
                series[0].interval() if isinstance(series[0], GrowthEnclosure) else arb(series[0])
            )
            assert not value.is_finite() or value.overlaps(arb(str(exact)) + arb(0, 1e-25))


@pytest.mark.parametrize(
    "text",
    [
        "log(3 + x)",
        "sinh(x) + cosh(y)",
        "tan(x/3)",
        "1/(x - 4)**3",
        "1/(x - 4)",
        "asin(x/3) + acos(y/5)",
        "(4 + x)**0.3",
        "(x - 7)**(-2)",
        "exp(x)*tanh(y) - atan(x*y)",
    ],
)
def test_intervals_of_formulas_hold_at_random_points(text):
    expr = parse("", text, ["x", "y"]).expr
    found = enclosure(expr, {symbol("x"): iv.mpf([-1, 2]), symbol("y"): iv.mpf([-0.5, 3])})
    x, y = np.random.default_rng(0).uniform([[-1], [-0.5]], [[2], [3]], (2, 2000))
    x[:4], y[:4] = [-1, -1, 2, 2], [-0.5, 3, -0.5, 3]
    values = rows(numpy_callable([symbol("x"), symbol("y")], [expr])(x, y), 2000)[0]
    low, high = float(mpmath.mpf(found.a)), float(mpmath.mpf(found.b))
    assert low <= values.min() + 1e-12
    assert high >= values.max() - 1e-12
    assert high - low < 6 * (values.max() - values.min())


@pytest.mark.parametrize("text", ["tan(x)", "log(x)", "1/x", "asin(x)", "x**0.3", "1/(x - 1)"])
def test_intervals_refuse_poles(text):
    with pytest.raises((ValueError, ArithmeticError)):
        enclosure(parse("", text, ["x"]).expr, {symbol("x"): iv.mpf([-2, 2])})


def test_a_large_irrational_number_is_enclosed():
    expr = parse("", "(1e200)**0.123456789*x", ["x"]).expr
    found = enclosure(expr, {symbol("x"): iv.mpf(1)})
    exact = mpmath.mpf(10) ** (200 * mpmath.mpf("0.123456789"))
    assert found.a < exact < found.b


def test_bounds_are_rounded_up():
    bound = derivative_bound(Formula(parse("", "t/3", ["t"]).expr, 0.0, 1.0), 1)
    assert Fraction(bound) >= Fraction(1, 3)


@pytest.mark.parametrize(
    "text",
    [
        "cos(t) + cos(sqrt(2)*t) + 0.7*cos(2*t + 1) + 0.01*exp(-t)",
        "sin(t)*cos(sqrt(3)*t) + 0.3*sin(3*t)",
        "sin(t + 0.4)**3 + sin(sqrt(5)*t) - 0.5*cos(2*sqrt(5)*t) - 0.01*exp(-t)",
        "(1 + exp(-t))*sin(t) - 0.8*cos(2*t) + 0.1*cos(sqrt(2)*t)",
    ],
)
def test_bounds_of_several_frequencies_are_those_over_all_phases(text):
    """In the long run every pair of phases is approached: the supremum is that over the torus."""
    irrational = next(root for root in (2, 3, 5) if f"sqrt({root})" in text)
    first, second = np.meshgrid(*[np.linspace(0, 2 * math.pi, 1201)] * 2)
    formula = sympy.sympify(text.replace("exp(-t)", "0")).expand()
    u, v, t = sympy.symbols("u v t")
    phases = sympy.sympify(str(formula).replace(f"sqrt({irrational})*t", "v").replace("*t", "*u"))
    phases = phases.xreplace({t: u})
    values = np.abs(sympy.lambdify((u, v), phases, "numpy")(first, second))
    times = np.linspace(0, 40, 400_001)
    sampled = np.abs(sympy.lambdify(t, sympy.sympify(text), "numpy")(times))
    reached = max(values.max(), sampled.max())
    found = SymbolicReference(text).bounds(0).values[0]
    assert reached <= found <= 1.01 * reached


RATIOS = st.sampled_from(["1", "1", "0.1", "1.1", "2/3", "5/7", "3", "-1", "10/11"])


@given(st.lists(RATIOS, min_size=2, max_size=5))
def test_every_frequency_is_a_multiple_of_the_common_one(frequencies):
    """Else the phases of a turn are not all that occur, and a bound is too small."""
    terms = (f"sin({w}*t + cos(t + {i}))" for i, w in enumerate(frequencies))
    formula = Formula(parse("", "*".join(terms), ["t"]).expr)
    for base, turns in formula._tables:
        for arg, (n, offset) in turns.items():
            assert sympy.expand(n * base * sympy.Symbol("t", real=True) + offset - arg) == 0


@pytest.mark.parametrize(
    "text",
    [
        "sin(t + cos(t) + sin(1.1*t))",  # frequencies 1, 1 and 1.1
        "sin(sin(t)*cos(3*t)*sin(3*t + sin(t)))",
        "sin(0.5*t + sin(1.5*t) + sin(3*t + cos(3*t)))",
        "sin((sin(t) - cos(3*t))*tanh(t))",  # no period, though its sines have one
        "(sin(t) - cos(3*t))*exp(-t/10)*sin(2*t) + (cos(t) - sin(2*t))*tanh(t)",
    ],
)
def test_sines_of_several_frequencies_stay_within_their_bounds(text):
    check(text, 2)


def test_what_grows_between_sines_is_not_taken_for_periodic():
    assert bounds_of("t*sin(2*t)*(sin(t) - cos(3*t))", 0) == [None]


@pytest.mark.parametrize("text", ["sin(sin(t)) + min(exp(t), sin(1.5*t))", "max(-exp(t), cos(t))"])
def test_a_slope_is_not_lost_beside_a_steep_one(text):
    check(text, 1)


@pytest.mark.parametrize("shift", [-1, 0, 1])
@pytest.mark.parametrize("function", ["asin(sin(t))", "acos(cos(t)) - pi/2"])
def test_bounds_of_triangles_cover_both_ends(function, shift):
    found = SymbolicReference(f"{function} + {shift}").bounds(0).values[0]
    assert math.pi / 2 + abs(shift) <= found <= 1.01 * (math.pi / 2 + abs(shift))

"""Taylor coefficients of formulas: against SymPy's derivatives at points, and ranges on spans."""

import math

import numpy as np
import pytest
import sympy
from flint import arb, fmpq

from certrack.core.expressions import TIME, parse
from certrack.core.kinks import without_minmax
from certrack.core.powers import ConstantPower
from certrack.references.growth import INFINITE, LINEAR, GrowthEnclosure, Span, Undefined, ball
from certrack.references.taylor import (
    ONE,
    RULES,
    Evaluation,
    _between,
    _dot,
    _integer_power,
    _inverse,
    _is_part_of_sine,
    _positive,
    _power_of,
    constant,
)

ORDER = 4


def formula(text):
    return without_minmax(parse("", text, ["t"]).expr)


def series(text, time, order=ORDER, **options):
    return Evaluation(time, order, **options).series(formula(text))


def endless(begin=1.0):
    return GrowthEnclosure(Span(arb(begin), INFINITE), {LINEAR: fmpq(1)})


def finite(begin, end):
    return GrowthEnclosure(Span(arb(begin), arb(end)), {LINEAR: fmpq(1)})


def ends(value):
    """The least and the largest value of a coefficient, as floats."""
    if isinstance(value, GrowthEnclosure):
        return tuple(map(float, value.ends()))
    value = arb(value)
    return float(value.lower()), float(value.upper())


def derivatives(text, order=ORDER):
    """Functions of NumPy for f^(k)/k!."""
    f = parse("", text, ["t"]).expr
    off_kinks = [{"DiracDelta": lambda *_: 0.0}, "numpy"]
    return [
        sympy.lambdify(TIME, f.diff(TIME, k) / math.factorial(k), off_kinks)
        for k in range(order + 1)
    ]


ANALYTIC = [
    "3",
    "t",
    "1 - 2*t + t**3/7",
    "(1 + t)**5",
    "(2 - t)**4",
    "t**6",
    "(t**2 + 1)*(t - 3)*(2*t + 5)",
    "1/(1 + t)",
    "1/(1 + t)**3",
    "(t + 2)/(t**2 + 3)",
    "sqrt(t + 2)",
    "(t + 1)**(7/3)",
    "(1 + t**2)**(-3/2)",
    "(1 + t)**pi",
    "exp(-2*t)*t",
    "exp(t**2 - t)",
    "log(2 + 3*t)",
    "log(1 + t + t**2)",
    "sin(3*t + 1)",
    "cos(2*t)*sin(t)",
    "cos(t**2)",
    "sin(t)**3",
    "tan(t)",
    "tan(t/2 + t**2)",
    "tanh(2*t - 1)",
    "tanh(t**2)",
    "sinh(t - 2)",
    "cosh(2*t**2)",
    "asin(t/2)",
    "acos(t**2)",
    "asin(t - 1/2)",
    "atan(3*t)",
    "atan(t**2 - t)",
    "abs(t - 2)*t**2",
    "abs(1 + t)",
    "max(t, 2*t + 1)",
    "sqrt(2)*t + pi**2",
]


@pytest.mark.parametrize("text", ANALYTIC)
def test_coefficients_at_a_point_are_the_derivatives(text):
    point = sympy.Rational(3, 8)
    found = series(text, arb(0.375))
    assert len(found) == ORDER + 1
    f = parse("", text, ["t"]).expr
    for k, value in enumerate(found):
        exact = sympy.N(f.diff(TIME, k).subs(TIME, point).doit() / sympy.factorial(k), 30)
        low, high = ends(value)
        size = max(1.0, abs(float(exact)))
        assert low <= float(exact) + 1e-15 * size and float(exact) - 1e-15 * size <= high
        assert high - low <= 1e-12 * size, k


@pytest.mark.parametrize("order", [0, 1])
def test_as_many_coefficients_as_are_asked_for(order):
    for text in ANALYTIC:
        assert len(series(text, arb(0.375), order)) == order + 1
        assert len(series(text, ball(0.375, 0.4), order)) == order + 1


MONOTONE = [
    ("t**3", -2, 1),
    ("t**5", -1, 2),
    ("1/t", 1, 4),
    ("1/t", -4, -1),
    ("exp(t)", -1, 2),
    ("log(t)", 1, 3),
    ("sqrt(t)", 1, 4),
    ("t**(-1/3)", 1, 8),
    ("sin(t)", -1, 1),
    ("cos(t)", 0.5, 2),
    ("sinh(t)", -1, 2),
    ("cosh(t)", 1, 2),
    ("atan(t)", -5, 1),
    ("abs(t)", 1, 2),
    ("abs(t)", -2, -1),
]


@pytest.mark.parametrize(("text", "begin", "end"), MONOTONE)
def test_the_values_on_an_interval_are_those_of_its_ends(text, begin, end):
    f = derivatives(text, 0)[0]
    low, high = sorted((float(f(begin)), float(f(end))))
    found = ends(series(text, ball(begin, end), 2)[0])
    assert found == pytest.approx((low, high), rel=1e-7, abs=1e-7)
    assert found[0] <= low + 1e-15 * abs(low) and found[1] >= high - 1e-15 * abs(high)


@pytest.mark.parametrize(
    ("text", "begin", "end", "low", "high"),
    [
        ("t**2", -2, 1, 0, 4),
        ("t**4", -1, 2, 0, 16),
        ("t**2", -3, -1, 1, 9),
        ("abs(t)", -2, 1, 0, 2),
        ("abs(t)", -1, 3, 0, 3),
        ("cosh(t)", -1, 2, 1, math.cosh(2)),
        ("cos(t)", -1, 1, math.cos(1), 1),
        ("sin(t)", 0, 7, -1, 1),
    ],
)
def test_values_on_an_interval_that_turn_inside(text, begin, end, low, high):
    found = ends(series(text, ball(begin, end), 1)[0])
    assert found == pytest.approx((low, high), rel=1e-6, abs=1e-6)
    assert found[0] <= low + 1e-15 and found[1] >= high


@pytest.mark.parametrize("text", ANALYTIC)
def test_coefficients_on_an_interval_enclose_the_derivatives(text):
    found = series(text, ball(0.25, 0.5))
    narrow = series(text, ball(0.25, 0.25 + 1e-4))
    t = np.linspace(0.25, 0.5, 41)
    for k, f in enumerate(derivatives(text)):
        values = np.array([float(f(x)) for x in t])
        low, high = ends(found[k])
        size = 1e-13 * max(1.0, np.abs(values).max())
        assert low <= values.min() + size and values.max() - size <= high
        width = ends(narrow[k])[1] - ends(narrow[k])[0]
        assert width <= 0.2 * max(1.0, np.abs(values).max())


# spans without end


GROWING = [
    ("1/t", 1, 0, 1),
    ("1/t**2", 1, 0, 1),
    ("t*exp(-t)", 1, 0, math.exp(-1)),
    ("exp(-t)", 1, 0, math.exp(-1)),
    ("exp(-t**2)", 1, 0, math.exp(-1)),
    ("tanh(2*t)", 1, 1 - 2 * math.exp(-4), 1),
    ("tanh(-t)", 1, -1, -1 + 2 * math.exp(-2)),
    ("atan(t)", 1, math.pi / 4, math.pi / 2),
    ("atan(-t)", 1, -math.pi / 2, -math.pi / 4),
    ("sqrt(t)", 1, 1, math.inf),
    ("t**(-1/2)", 1, 0, 1),
    ("(1 + t)/(2 + t)", 1, 1 / 3, 1),
    ("t**3*exp(-t)", 1, 0, 27 * math.exp(-3)),
    ("abs(-t)", 1, 1, math.inf),
    ("abs(1 - 2*t)", 1, 1, math.inf),
    ("abs(exp(-t) - 1/2)", 1, 1 / 2 - math.exp(-1), 1 / 2),
    ("sin(t)", 1, -1, 1),
    ("cos(1/t)", 1, math.cos(1), 1),
    ("sin(1/t)", 1, 0, math.sin(1)),
    ("tan(1/t)", 1, 0, math.tan(1)),
    ("asin(exp(-t))", 1, 0, math.asin(math.exp(-1))),
    ("acos(exp(-t))", 1, math.acos(math.exp(-1)), math.pi / 2),
    ("sinh(exp(-t))", 1, 0, math.sinh(math.exp(-1))),
    ("cosh(t)*exp(-t)", 1, 1 / 2, (1 + math.exp(-2)) / 2),
    ("sinh(t)*exp(-t)", 1, (1 - math.exp(-2)) / 2, 1 / 2),
]


@pytest.mark.parametrize(("text", "begin", "low", "high"), GROWING)
def test_values_for_ever(text, begin, low, high):
    f = formula(text)
    found = ends(Evaluation(endless(begin), 2).series(f)[0])
    assert found[0] <= low + 1e-12 and found[1] >= high - 1e-12
    loose = ("/(2 + t)", "sin", "cos")
    slack = 1.01 if any(part in text for part in loose) else 1e-6
    assert found[0] >= low - slack and (math.isinf(high) or found[1] <= high + slack)


@pytest.mark.parametrize("text", [text for text, *_ in GROWING if "abs" not in text])
def test_derivatives_for_ever(text):
    found = Evaluation(endless(1), 3).series(formula(text))
    t = np.geomspace(1, 300, 200)
    for k, f in enumerate(derivatives(text, 3)):
        low, high = ends(found[k])
        with np.errstate(all="ignore"):
            values = np.array([float(f(x)) for x in t])
        values = values[np.isfinite(values)]
        assert low <= values.min() + 1e-12 and high >= values.max() - 1e-12


@pytest.mark.parametrize("text", [t for t, *_ in GROWING if "/t" not in t or t == "1/t"])
def test_a_finite_span_is_enclosed_as_well(text):
    found = Evaluation(finite(1, 2), 2).series(formula(text))
    t = np.linspace(1, 2, 50)
    for k, f in enumerate(derivatives(text, 2) if "abs" not in text else derivatives(text, 0)):
        values = np.array([float(f(x)) for x in t])
        low, high = ends(found[k])
        assert low <= values.min() + 1e-12 and high >= values.max() - 1e-12
        assert high - low < 40


def test_growing_powers_are_products():
    cube = Evaluation(endless(), 3).series(formula("t**3"))
    assert [dict(value.terms) for value in cube[:3]] == [
        {(fmpq(3), fmpq(0)): fmpq(1)},
        {(fmpq(2), fmpq(0)): fmpq(3)},
        {(fmpq(1), fmpq(0)): fmpq(3)},
    ]
    assert cube[3] == 1 or ends(cube[3]) == (1, 1)
    assert dict(_integer_power(endless(), 1).terms) == {LINEAR: fmpq(1)}


# phases


def test_phases_that_are_told_apart_from_the_time():
    arg = formula("sin(3*t + 1)").args[0]
    phases = {arg: (ball(0, 0.25), sympy.S.One)}
    found = Evaluation(endless(), 2, phases).series(formula("2*sin(3*t + 1)"))
    assert ends(found[0]) == pytest.approx((2 * math.sin(1), 2 * math.sin(1.25)), abs=1e-6)
    assert ends(found[1]) == pytest.approx((6 * math.cos(1.25), 6 * math.cos(1)), abs=1e-6)
    assert ends(found[2]) == pytest.approx((-9 * math.sin(1.25), -9 * math.sin(1)), abs=1e-6)
    cosine = Evaluation(endless(), 1, phases).series(sympy.cos(arg))
    assert ends(cosine[0]) == pytest.approx((math.cos(1.25), math.cos(1)), abs=1e-6)
    assert ends(cosine[1]) == pytest.approx((-3 * math.sin(1.25), -3 * math.sin(1)), abs=1e-6)


# what has no value


@pytest.mark.parametrize(
    ("text", "time", "message"),
    [
        ("log(t)", ball(0, 1), "argument of log"),
        ("log(t)", ball(-1, 1), "argument of log"),
        ("1/t", ball(0, 1), "denominator"),
        ("1/t", ball(-1, 0), "denominator"),
        ("1/t**2", ball(-1, 1), "denominator"),
        ("sqrt(t)", ball(0, 1), "base of a power"),
        ("sqrt(t)", ball(-1, 1), "base of a power"),
        ("tan(t)", ball(1, 2), "pole"),
        ("asin(t)", ball(0, 1), "may reach 1 or -1"),
        ("asin(t)", ball(-1, 0), "may reach 1 or -1"),
        ("acos(2*t)", ball(0, 0.75), "may reach 1 or -1"),
        ("asin(t)", arb(1), "may reach 1 or -1"),
        ("(t**2 + abs(t))**(1/2)", ball(-1, 1), "base of a power"),
        ("abs(t)**(-1/2)", ball(-1, 1), "base of a power"),
    ],
)
def test_what_may_have_no_value_is_undefined(text, time, message):
    with pytest.raises(Undefined, match=message):
        series(text, time, 1)


def test_functions_without_a_rule_may_jump():
    with pytest.raises(Undefined, match="sign may jump"):
        Evaluation(ball(0, 1), 0).series(sympy.sign(TIME - 1))
    with pytest.raises(Undefined, match="has no value"):
        constant(sympy.Symbol("a"))
    assert len(RULES) == 12


def test_roots_of_what_may_be_zero_have_a_value_and_no_derivative():
    value, *rest = series("abs(t)**(1/2)", ball(-4, 1), 2)
    assert ends(value) == pytest.approx((0, 2), abs=1e-6)
    assert len(rest) == 2 and all(arb(v).is_nan() for v in rest)
    with pytest.raises(Undefined, match="exponent depends on t"):
        Evaluation(ball(0, 1), 0).series((1 + TIME) ** TIME)
    with pytest.raises(Undefined, match="base of a power"):
        series("abs(t)**(1/2)", ball(-4, 1), 2, smooth=True)


def test_arcsines_of_sines_have_a_value_and_no_derivative():
    value, *rest = series("asin(sin(t))", ball(1, 2), 2)
    assert ends(value) == pytest.approx((math.asin(math.sin(1)), math.pi / 2), abs=1e-4)
    assert len(rest) == 2 and all(arb(v).is_nan() for v in rest)
    low = series("asin(sin(t))", ball(-2, -1), 0)[0]
    assert ends(low) == pytest.approx((-math.pi / 2, -math.asin(math.sin(1))), abs=1e-4)
    with pytest.raises(Undefined, match="may reach"):
        series("asin(sin(t))", ball(1, 2), 2, smooth=True)
    with pytest.raises(Undefined, match="may reach"):
        series("asin(1.1*sin(t))", ball(1, 2), 2)
    assert _is_part_of_sine(sympy.sin(TIME)) and _is_part_of_sine(-sympy.cos(TIME))
    assert _is_part_of_sine(sympy.cos(TIME) / 2) and not _is_part_of_sine(TIME)
    assert not _is_part_of_sine(sympy.Rational(9, 8) * sympy.cos(TIME))


def test_magnitudes():
    """Where it may turn: a value, a slope of either sign, and nothing more."""
    value, slope, third, fourth = series("abs(2*t)", ball(-1, 2), 3)
    assert ends(value) == pytest.approx((0, 4), abs=1e-6)
    assert ends(slope) == pytest.approx((-2, 2), abs=1e-6)
    assert arb(third).is_nan() and arb(fourth).is_nan()
    assert len(Evaluation(ball(-1, 1), 4).series(sympy.Abs(TIME))) == 5
    (only,) = series("abs(t)", ball(-3, 2), 0)
    assert ends(only) == pytest.approx((0, 3), abs=1e-6)
    assert ends(series("abs(t)", ball(-2, -1), 1)[1]) == (-1, -1)
    assert ends(series("abs(t)", ball(1, 2), 1)[1]) == (1, 1)
    crossing = Evaluation(endless(0), 1).series(formula("abs(exp(-t) - 1/2)"))
    assert ends(crossing[0]) == pytest.approx((0, 0.5), abs=1e-6)


# numbers


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2/3", 2 / 3),
        ("pi", math.pi),
        ("exp(1)", math.e),
        ("sqrt(2)", math.sqrt(2)),
        ("2**(1/3)", 2 ** (1 / 3)),
        ("sin(1)", math.sin(1)),
        ("pi**2/3", math.pi**2 / 3),
    ],
)
def test_numbers(text, value):
    found = constant(formula(text))
    low, high = ends(found)
    assert low <= value * (1 + 1e-15) and high >= value * (1 - 1e-15) and high - low < 1e-13


def test_parts():
    assert constant(sympy.Rational(-2, 3)) == fmpq(-2, 3)
    assert _dot([fmpq(2), fmpq(3)], [fmpq(5), fmpq(7)]) == 31
    assert _dot([fmpq(0), fmpq(3)], [arb("nan"), fmpq(7)]) == 21
    assert _dot([arb("nan"), fmpq(3)], [fmpq(0), fmpq(7)]) == 21
    assert _inverse(fmpq(4)) == fmpq(1, 4) and _inverse(fmpq(-4)) == fmpq(-1, 4)
    with pytest.raises(Undefined):
        _inverse(fmpq(0))
    assert _positive(fmpq(1, 9)) and not _positive(fmpq(0)) and not _positive(ball(0, 1))
    assert _positive(endless(1)) and not _positive(endless(0))
    assert ends(_power_of(fmpq(4), fmpq(1, 2))) == (2, 2)
    assert ends(_power_of(fmpq(4), fmpq(3, 2))) == pytest.approx((8, 8), rel=1e-12)
    assert ends(_power_of(finite(1, 4), arb(1) / 2))[1] == pytest.approx(2, rel=1e-6)
    assert ends(_power_of(arb(3), arb(2))) == pytest.approx((9, 9), rel=1e-12)
    assert _integer_power(fmpq(-2, 3), 3) == fmpq(-8, 27)
    assert ends(_integer_power(ball(-2, 1), 3)) == pytest.approx((-8, 1), rel=1e-7)
    assert ends(_integer_power(ball(-2, 1), 2)) == pytest.approx((0, 4), abs=1e-7)
    assert ends(ONE) == pytest.approx((-1, 1)) and ends(_between(ball(-3, 2))) == pytest.approx(
        (-3, 3)
    )


LOOSE = ("tanh", "acos(t**2)", "log(2 + 3*t)", "log(1 + t + t**2)", "asin(t - 1/2)")


@pytest.mark.parametrize("text", [text for text in ANALYTIC if not text.startswith(LOOSE)])
def test_a_span_of_one_time_has_the_derivatives_of_a_point(text):
    found = series(text, finite(1.5, 1.5), 3)
    expected = series(text, arb(1.5), 3)
    for one, other in zip(found, expected, strict=True):
        assert ends(one) == pytest.approx(ends(other), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_hyperbolic_tangent_bends_less_than_its_bell(sign):
    """tanh'' = -2 tanh (1 - tanh^2), where 0 <= 1 - tanh^2(2t) <= 4 e^(-4t)."""
    found = ends(series("tanh(2*t)" if sign > 0 else "tanh(-2*t)", endless(1), 2)[2])
    expected = sorted((-16 * sign * math.exp(-4), 0))
    assert found == pytest.approx(expected, abs=0.02)


def test_arcsines_are_clamped_on_the_side_that_reaches_one():
    rising = ends(series("asin(sin(t))", ball(-0.5, 1.7), 0)[0])
    assert rising == pytest.approx((-0.5, math.pi / 2), abs=1e-4)
    falling = ends(series("asin(sin(t))", ball(-1.7, 0.5), 0)[0])
    assert falling == pytest.approx((-math.pi / 2, 0.5), abs=1e-4)


@pytest.mark.parametrize(("begin", "end"), [(-0.5, -0.25), (0.25, 0.5)])
def test_magnitudes_of_what_is_near_zero(begin, end):
    found = ends(series("abs(t)", ball(begin, end), 1)[0])
    assert found == pytest.approx((0.25, 0.5), rel=1e-6)


def test_a_number_to_the_power_one_is_that_number_exactly():
    """It stands for the exponent of a fine root, and keeps a rational one exact."""
    exponent = sympy.Rational(1, 3)
    assert constant(ConstantPower(exponent, sympy.Integer(1))) == fmpq(1, 3)
    root = constant(ConstantPower(sympy.Integer(2), exponent))
    assert (root**3).contains(2) and float(root.rad()) < 1e-12

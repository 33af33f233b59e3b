"""Enclosures of growing functions of t, against their values and their closed forms."""

import math

import numpy as np
import pytest
from flint import arb, fmpq

from certrack.references.growth import (
    CONSTANT,
    INFINITE,
    LINEAR,
    LOG_POWER,
    MAX_TERMS,
    GrowthEnclosure,
    Span,
    Undefined,
    ball,
    sech2,
)

ENDLESS = Span(arb(1), INFINITE)
SHORT = Span(arb(1), arb(3))
SQUARE = (fmpq(2), fmpq(0))
DECAY = (fmpq(0), fmpq(-1))


def term(span, *terms):
    """The sum of factor t^k e^(r t)."""
    powers = [(k if isinstance(k, tuple) else (k, 1), r, f) for k, r, f in terms]
    return GrowthEnclosure(span, {(fmpq(*k), fmpq(*r)): fmpq(*f) for k, r, f in powers})


def ends(value):
    low, high = value.ends()
    return float(low), float(high)


def at(value, t):
    """The least and the largest value at a time, by the terms."""
    low = high = 0.0
    for (k, r), factor in value.terms.items():
        size = t ** float(fmpq(k)) * math.exp(float(fmpq(r)) * t)
        low += float(arb(factor).lower()) * size
        high += float(arb(factor).upper()) * size
    return low, high


def close(found, low, high):
    """Not inside of the exact range but for its own rounding, and hardly outside."""
    assert found[0] <= low or math.isclose(found[0], low, rel_tol=1e-15)
    assert found[1] >= high or math.isclose(found[1], high, rel_tol=1e-15)
    assert found == pytest.approx((low, high), rel=1e-7, abs=1e-7)


@pytest.mark.parametrize(
    ("begin", "end", "k", "r", "low", "high"),
    [
        (1, 4, 2, (0, 1), 1, 16),
        (1, 4, -1, (0, 1), 0.25, 1),
        (0, 4, -1, (0, 1), 0.25, math.inf),
        (0, 4, 1, (0, 1), 0, 4),
        (0, math.inf, 1, (-1, 1), 0, 1 / math.e),
        (0, 4, 1, (-1, 2), 0, 2 / math.e),
        (3, 4, 1, (-1, 2), 4 * math.exp(-2), 3 * math.exp(-1.5)),
        (0, 1, 1, (-1, 2), 0, math.exp(-0.5)),
        (1, math.inf, -2, (1, 1), math.e**2 / 4, math.inf),
        (1, math.inf, -2, (-1, 1), 0, math.exp(-1)),
        (1, math.inf, 0, (0, 1), 1, 1),
        (0, math.inf, 0, (-1, 1), 0, 1),
        (0, math.inf, 0, (1, 2), 1, math.inf),
    ],
)
def test_the_range_of_one_growth(begin, end, k, r, low, high):
    found = Span(arb(begin), arb(end)).range_of((fmpq(k), fmpq(*r)))
    close(tuple(map(float, found)), low, high)


def test_sums_and_products_are_those_of_their_terms():
    f = term(SHORT, (1, (0, 1), (2, 1)), (0, (-1, 1), (-3, 1)))  # 2 t - 3 e^-t
    g = term(SHORT, (1, (0, 1), (1, 2)), (0, (0, 1), (5, 1)))  # t/2 + 5
    assert (f + g).terms == {LINEAR: fmpq(5, 2), DECAY: fmpq(-3), CONSTANT: fmpq(5)}
    assert (f - g).terms == {LINEAR: fmpq(3, 2), DECAY: fmpq(-3), CONSTANT: fmpq(-5)}
    assert (1 - f).terms == {CONSTANT: fmpq(1), LINEAR: fmpq(-2), DECAY: fmpq(3)}
    assert (f / 4).terms == {LINEAR: fmpq(1, 2), DECAY: fmpq(-3, 4)}
    assert (f * g).terms == {
        SQUARE: fmpq(1),
        LINEAR: fmpq(10),
        (fmpq(1), fmpq(-1)): fmpq(-3, 2),
        DECAY: fmpq(-15),
    }
    assert (f - f).terms == {} and ends(f - f) == (0, 0)
    assert (g * g).terms == {SQUARE: fmpq(1, 4), LINEAR: fmpq(5), CONSTANT: fmpq(25)}


def test_the_ends_of_a_sum_that_cancels():
    """t - 2 t^2 from t = 1 on falls from -1 for ever; by the parts it would be unknown."""
    close(ends(term(ENDLESS, (1, (0, 1), (1, 1)), (2, (0, 1), (-2, 1)))), -math.inf, -1)
    close(ends(term(ENDLESS, (1, (0, 1), (-1, 1)), (2, (0, 1), (2, 1)))), 1, math.inf)
    g = term(ENDLESS, (0, (0, 1), (3, 1)), (-1, (0, 1), (-1, 1)))  # 3 - 1/t
    close(ends(g), 2, 3)
    assert g.nonzero() and not (g - 3).nonzero() and not (g - 2).nonzero() and (g - 4).nonzero()


def test_many_terms_become_fewer_and_none_is_lost():
    f = term(SHORT, *((k, (0, 1), (1, k + 1)) for k in range(MAX_TERMS + 3)))
    assert len(f.terms) == MAX_TERMS
    for t in np.linspace(1, 3, 9):
        exact = sum(t**k / (k + 1) for k in range(MAX_TERMS + 3))
        low, high = at(f, t)
        assert low <= exact * (1 + 1e-12) and high >= exact * (1 - 1e-12)


def test_inverses():
    close(ends(term(SHORT, (1, (0, 1), (2, 1))).inverse()), 1 / 6, 1 / 2)
    endless = term(ENDLESS, (1, (0, 1), (2, 1)), (0, (0, 1), (1, 1))).inverse()  # 1/(2 t + 1)
    assert set(endless.terms) == {(fmpq(-1), fmpq(0))}
    close(ends(endless), 0, 1 / 2)
    negative = term(ENDLESS, (1, (0, 1), (-2, 1))).inverse()
    close(ends(negative), -1 / 2, 0)
    for span in (SHORT, ENDLESS):
        with pytest.raises(Undefined, match="denominator may be zero"):
            term(span, (1, (0, 1), (1, 1)), (0, (0, 1), (-2, 1))).inverse()
        with pytest.raises(Undefined):
            term(span).inverse()


# log


def test_the_logarithm_of_an_exponential_is_a_line():
    found = term(ENDLESS, (0, (2, 1), (3, 1))).log()
    assert found.terms[LINEAR] == 2 and set(found.terms) == {CONSTANT, LINEAR}
    assert found.terms[CONSTANT].contains(arb(3).log())
    assert float(found.terms[CONSTANT].rad()) < 1e-12


def test_the_logarithm_of_a_power_within_a_span():
    found = term(SHORT, (2, (1, 2), (5, 1))).log()  # log 5 + 2 log t + t/2
    close(ends(found), math.log(5) + 0.5, math.log(5) + 2 * math.log(3) + 1.5)
    for t in np.linspace(1, 3, 9):
        low, high = at(found, t)
        assert low <= math.log(5 * t**2 * math.exp(t / 2)) <= high


@pytest.mark.parametrize("k", [1, 3])
def test_the_logarithm_of_a_power_for_ever_grows_less_than_a_root(k):
    """0 <= log t <= 8/e t^(1/8), with equality at t = e^8."""
    found = term(ENDLESS, (k, (0, 1), (1, 1))).log()
    factor = found.terms[LOG_POWER, fmpq(0)]
    close((float(arb(factor).lower()), float(arb(factor).upper())), 0, k * 8 / math.e)
    assert set(found.terms) <= {CONSTANT, (LOG_POWER, fmpq(0))}
    for t in (1.0, 2.0, math.exp(8), 1e6):
        low, high = at(found, t)
        assert low <= k * math.log(t) + 1e-12 and k * math.log(t) <= high + 1e-9


def test_a_logarithm_by_its_ends_where_the_leading_term_may_vanish():
    above = (0, (0, 1), (2, 1)), (1, (0, 1), (1, 1))  # 2 + t from 0 on
    close(ends(term(Span(arb(0), arb(3)), *above).log()), math.log(2), math.log(5))
    assert ends(term(Span(arb(0), INFINITE), *above).log())[1] == math.inf
    g = GrowthEnclosure(ENDLESS, {(fmpq(-1), fmpq(0)): ball(0, 1), CONSTANT: fmpq(2)})
    close(ends(g.log()), math.log(2), math.log(3))
    decaying = GrowthEnclosure(ENDLESS, {DECAY: ball(0, 1), SQUARE: ball(0, 0.0)})
    with pytest.raises(Undefined, match="log"):
        decaying.log()


@pytest.mark.parametrize(
    ("begin", "end", "terms"),
    [
        (1, math.inf, ((0, (0, 1), (-1, 1)),)),
        (1, 3, ((1, (0, 1), (1, 1)), (0, (0, 1), (-1, 1)))),
        (0.5, math.inf, ((1, (0, 1), (1, 1)),)),
        (0, 3, ((1, (0, 1), (1, 1)),)),
    ],
)
def test_a_logarithm_of_what_may_be_zero_is_refused(begin, end, terms):
    with pytest.raises(Undefined, match="the argument of log may be zero or negative"):
        term(Span(arb(begin), arb(end)), *terms).log()


def test_powers():
    found = term(SHORT, (2, (1, 1), (4, 1))).power(fmpq(1, 2))
    (growth,) = found.terms
    assert growth == (fmpq(1), fmpq(1, 2))
    assert found.terms[growth].contains(2) and float(found.terms[growth].rad()) < 1e-12
    rational = term(SHORT, (0, (0, 1), (2, 1)), (1, (0, 1), (1, 1))).power(fmpq(-1))
    close(ends(rational), 1 / 9, 3 / 5)  # 1/t of [1/3, 1] times 1/(1 + 2/t) of [1/3, 3/5]
    f = term(Span(arb(0), arb(3)), (0, (0, 1), (2, 1)), (1, (0, 1), (1, 1))).power(fmpq(-1))
    close(ends(f), 1 / 5, 1 / 2)
    for bad in ({CONSTANT: fmpq(-1)}, {CONSTANT: ball(0, 1)}):
        with pytest.raises(Undefined, match="base of a power"):
            GrowthEnclosure(SHORT, bad).power(fmpq(1, 2))


# exp, tanh


def test_exponentials():
    line = term(ENDLESS, (1, (0, 1), (-2, 1)), (0, (0, 1), (1, 1))).exp()  # e^(1 - 2 t)
    assert set(line.terms) == {(fmpq(0), fmpq(-2))}
    close(ends(line), 0, math.exp(-1))
    square = term(ENDLESS, (2, (0, 1), (-1, 1))).exp()  # e^(-t^2) <= e^(-t)
    assert set(square.terms) == {(fmpq(0), fmpq(-1))}
    close(ends(square), 0, math.exp(-1))
    growing = term(ENDLESS, (2, (0, 1), (1, 1))).exp()
    assert ends(growing)[1] == math.inf
    close(ends(term(SHORT, (2, (0, 1), (-1, 1))).exp()), math.exp(-9), math.exp(-1))


def test_an_exponential_is_positive_whatever_its_argument_falls_to():
    """Of -sqrt(t), which falls more slowly than every line."""
    slow = term(ENDLESS, ((1, 2), (0, 1), (-1, 1)))
    low, high = ends(slow.exp())
    assert low == pytest.approx(0, abs=1e-8)
    assert high == pytest.approx(math.exp(-1)) and high >= math.exp(-1)
    both = term(ENDLESS, ((1, 2), (0, 1), (-1, 1)), (0, (0, 1), (3, 1))).exp()
    close(ends(both), 0, math.exp(2))


@pytest.mark.parametrize("sign", [1, -1])
def test_the_hyperbolic_tangent_of_what_grows_is_near_one(sign):
    found = term(ENDLESS, (1, (0, 1), (sign * 2, 1))).tanh()  # |1 - tanh 2t| <= 2 e^(-4t)
    low, high = sorted(sign * v for v in ends(found))
    close((low, high), 1 - 2 * math.exp(-4), 1)
    for t in (1.0, 1.5, 4.0):
        low, high = at(found, t)
        assert low - 1e-12 <= math.tanh(sign * 2 * t) <= high + 1e-12
    bounded = term(ENDLESS, (-1, (0, 1), (sign, 1))).tanh()
    close(tuple(sorted(sign * v for v in ends(bounded))), 0, math.tanh(1))


@pytest.mark.parametrize("sign", [1, -1])
def test_the_bell_of_the_hyperbolic_tangent(sign):
    found = term(ENDLESS, (1, (0, 1), (sign * 2, 1))).sech2()
    assert set(found.terms) == {(fmpq(0), fmpq(-4))}
    close(ends(found), 0, 4 * math.exp(-4))
    level = term(ENDLESS, (0, (0, 1), (sign * 2, 1)), (-1, (0, 1), (-sign, 1))).sech2()  # 1 to 2
    close(ends(level), 1 / math.cosh(2) ** 2, 1 / math.cosh(1) ** 2)
    crossing = term(SHORT, (0, (0, 1), (sign * 2, 1)), (1, (0, 1), (-sign, 1))).sech2()  # 1 to -1
    close(ends(crossing), 1 / math.cosh(1) ** 2, 1)
    assert float(sech2(arb(0))) == 1 and float(sech2(INFINITE)) == 0
    assert float(sech2(arb(1.5))) == pytest.approx(1 / math.cosh(1.5) ** 2)

"""What formulas have in common, taken out of them."""

import math

import pytest
import sympy

from certrack.core.hoisting import hoisted, hoisted_numbers
from certrack.core.lowering import numpy_callable
from certrack.integrators.many.native import numbers_of

a, b, c, s, t, x, y = sympy.symbols("a b c s t x y", real=True)

FORMULAS = [
    2 * a * x - a * b * y + sympy.sin(t) / 3,
    (a + b / 2 - 1 + x) * sympy.exp(-a * t) - 3 * c,
    x**2 / a + sympy.sqrt(b) * sympy.Abs(x + c),
    -(a * b) * sympy.cos(b * t + x),
    x * y + 7,
]
VALUES = {a: 0.7, b: 1.9, c: -2.3, s: 0.31, t: 1.1, x: -0.6, y: 2.2}


def back(formula, symbols):
    return formula.xreplace({symbol: expr for expr, symbol in symbols.items()})


@pytest.mark.parametrize("formula", FORMULAS)
def test_formulas_keep_their_values(formula):
    (numbers,), of_numbers = hoisted_numbers([formula], {a, b, c})
    (shared,), of_time = hoisted([numbers], {t}, set(of_numbers.values()))
    value = back(back(shared, of_time), of_numbers).subs(VALUES)
    assert float(value) == pytest.approx(float(formula.subs(VALUES)), rel=1e-14)
    assert not numbers.free_symbols & {a, b, c}
    assert not shared.free_symbols & {a, b, c, t}
    assert all(not expr.free_symbols - {a, b, c} for expr in of_numbers)


def test_numbers_take_their_coefficients_but_for_the_sign():
    changed, symbols = hoisted_numbers([2 * a * x, -2 * a * y, a + 3 + x, x / 3], {a})
    assert list(symbols) == [2 * a, a + 3]
    double, sum_ = symbols.values()
    assert changed == [double * x, -double * y, sum_ + x, x / 3]


def test_known_symbols_stay_where_nothing_depends_on_the_common_ones():
    changed, symbols = hoisted([a * x, a * sympy.sin(b * t) * x, a + t + x, a], {t}, {a, b})
    assert list(symbols) == [a * sympy.sin(b * t), a + t]
    wave, sum_ = symbols.values()
    assert changed == [a * x, wave * x, sum_ + x, a]


@pytest.mark.filterwarnings("error")
def test_numbers_that_overflow_are_infinite_as_in_compiled_code():
    _, symbols = hoisted_numbers([a**2 * x, x / (a - b), x * sympy.exp(b)], {a, b})
    values = numbers_of(numpy_callable([[a, b]], list(symbols)), [1e200, 1e200])
    assert values.tolist() == [math.inf] * 3

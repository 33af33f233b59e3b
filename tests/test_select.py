"""Selections of compiled maps: the same in NumPy and heyoka, and exact where a cubic is simple."""

import numpy as np
import pytest
import sympy

from certrack.core.lowering import numpy_callable, to_heyoka
from certrack.core.select import Entry, Extremum, Select, larger, magnitude

NAMES = sympy.symbols("e0 e1 d0 d1", real=True)
E0, E1, D0, D1 = NAMES
BAND = 0.5


def numpy_values(formula, columns):
    return numpy_callable([NAMES], [formula])(columns)[0]


def parabolas(count):
    """Parabolas e0 + d0 s + b s^2 as columns (e0, e1, d0, d1)."""
    e0, d0, b = np.random.default_rng(5).normal(size=(3, count))
    return np.array([e0, e0 + d0 + b, d0, d0 + 2 * b])


def test_extremum_of_a_parabola_is_exact():
    e0, e1, d0, d1 = columns = parabolas(500)
    turns = d0 * d1 < 0
    assert 50 < turns.sum() < 450
    b = e1 - e0 - d0
    expected = np.where(turns, e0 - d0**2 / (4 * b), e0)
    np.testing.assert_allclose(numpy_values(Extremum(*NAMES), columns), expected, atol=1e-12)


def test_extremum_of_a_nearly_even_cubic_is_close():
    """Its error falls with the square of the cubic term, or faster."""
    s = np.linspace(0, 1, 2001)[:, None]

    def error(part):
        e0, e1, d0, _ = parabolas(500)
        b = e1 - e0 - d0
        a = part * b
        cubic = e0 + s * (d0 + s * (b + s * a))
        slope = d0 + 2 * b + 3 * a
        turns = d0 * slope < 0
        exact = np.where(d0 > 0, cubic.max(axis=0), cubic.min(axis=0))
        values = numpy_values(Extremum(*NAMES), np.array([e0, cubic[-1], d0, slope]))
        return (np.abs(values - exact) / np.ptp(cubic, axis=0))[turns].max()

    assert error(0.1) < 1e-3
    assert error(0.2) > 3 * error(0.1)


@pytest.mark.parametrize("sign", [1, -1])
def test_entry_of_a_straight_line_is_exact(sign):
    e0, e1 = sign * np.linspace(0.6, 3, 50), sign * np.linspace(0.4, -0.4, 50)
    columns = np.array([e0, e1, e1 - e0, e1 - e0])
    expected = (np.abs(e0) - BAND) / np.abs(e1 - e0)
    np.testing.assert_allclose(numpy_values(Entry(*NAMES, BAND), columns), expected, rtol=1e-12)


def test_entry_of_a_bent_line_is_corrected():
    """The chord alone would miss the band by ten times as much."""
    e0, e1, bend = 1.0, 0.1, np.linspace(-0.1, 0.1, 41)
    ones = np.ones(41)
    columns = np.array([e0 * ones, e1 * ones, e1 - e0 - bend, e1 - e0 + bend])
    place = numpy_values(Entry(*NAMES, BAND), columns)
    value = e0 + place * (e1 - e0 - bend + place * bend)
    chord = (e0 - BAND) / (e0 - e1)
    assert np.abs(value - BAND).max() < 0.1 * np.abs(0.1 * chord * (1 - chord))


def test_entry_is_the_end_where_nothing_is_outside():
    columns = np.random.default_rng(7).uniform(-0.49, 0.49, size=(4, 100))
    np.testing.assert_array_equal(numpy_values(Entry(*NAMES, BAND), columns), 1.0)


def test_nothing_is_divided_by_zero():
    """Flat or constant pieces are finite."""
    flat = np.array([[1.0, 1.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.0], [0.0] * 4, [1, 1, 2, 2]]).T
    for formula in (Extremum(*NAMES), Entry(*NAMES, BAND)):
        assert np.isfinite(numpy_values(formula, flat)).all()


@pytest.mark.parametrize(
    "formula",
    [
        Select(E0, E1, D0, D1),
        magnitude(E0),
        larger(E0, E1),
        Extremum(*NAMES),
        Entry(*NAMES, BAND),
    ],
)
def test_heyoka_has_the_same_values(formula):
    hy = pytest.importorskip("heyoka")
    inputs = [hy.expression(str(name)) for name in NAMES]
    outputs = to_heyoka([formula], dict(zip(NAMES, inputs, strict=True)), kinks=True)
    columns = np.random.default_rng(8).normal(size=(4, 200))
    values = hy.cfunc(outputs, inputs)(columns)[0]
    np.testing.assert_allclose(values, numpy_values(formula, columns), rtol=1e-12, atol=1e-13)

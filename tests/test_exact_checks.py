"""Exact checks and conversions at the edge of what they allow."""

from fractions import Fraction

import flint
import numpy as np
import pytest

from certrack.certificates.arithmetic import positive_definite, rational, solve
from certrack.certificates.exact import (
    MAX_EXPONENT,
    MAX_TEXT_LENGTH,
    PROOF_DIGITS,
    decimal_text,
    float_down,
    float_up,
    from_text,
    root_up,
)


@pytest.mark.parametrize("sign", ["", "-", "+"])
def test_exponents_of_texts_have_a_largest_one(sign):
    largest = from_text(f"1e{sign}{MAX_EXPONENT}")
    assert largest == (flint.fmpq(10) ** MAX_EXPONENT) ** (-1 if sign == "-" else 1)
    with pytest.raises(ValueError, match="not a decimal"):
        from_text(f"1E{sign}{MAX_EXPONENT + 1}")


def test_texts_have_a_longest_one_and_are_digits():
    assert from_text("1" * MAX_TEXT_LENGTH) == int("1" * MAX_TEXT_LENGTH)
    for wrong in ("1" * (MAX_TEXT_LENGTH + 1), "1/3", "nan", "1_0", 1.0, None):
        with pytest.raises(ValueError, match="not a decimal"):
            from_text(wrong)
    with pytest.raises(ValueError, match="Invalid literal"):
        from_text("")


@pytest.mark.parametrize("value", [1 / 3, -2e-7 / 3, 6.02e23, 0.0, 1e-310])
def test_the_text_of_a_float_is_its_nearest_decimal_of_so_many_digits(value):
    error = abs(Fraction(decimal_text(value)) - Fraction(value))
    assert error <= abs(Fraction(value)) * Fraction(10) ** (1 - PROOF_DIGITS) / 2
    assert len(decimal_text(value).partition("e")[0].strip("-0.").replace(".", "")) <= PROOF_DIGITS


@pytest.mark.parametrize("square", [2, 9, 100, 99, 10**20 - 1, Fraction(1, 7), Fraction(1, 10**40)])
def test_a_root_is_rounded_up_by_less_than_a_unit_of_its_last_digit(square):
    square = Fraction(square)
    root = Fraction(root_up(flint.fmpq(square.numerator, square.denominator)))
    assert square < root**2 <= square * (1 + Fraction(10) ** -11) ** 2


@pytest.mark.parametrize(
    "exact", [flint.fmpq(1, 3), flint.fmpq(-1, 3), flint.fmpq(3), flint.fmpq(0)]
)
def test_floats_around_a_rational_are_its_neighbours(exact):
    low, high = float_down(exact), float_up(exact)
    assert flint.fmpq(*low.as_integer_ratio()) <= exact <= flint.fmpq(*high.as_integer_ratio())
    assert high == (low if exact.q == 1 else np.nextafter(low, np.inf))


@pytest.mark.parametrize("number", [float, rational])
def test_a_semidefinite_matrix_is_not_positive_definite(number):
    def matrix(*rows):
        return np.array([[number(v) for v in row] for row in rows])

    assert positive_definite(matrix([2.0, 1.0], [1.0, 1.0]))
    assert not positive_definite(matrix([1.0, 0.0], [0.0, 0.0]))
    assert not positive_definite(matrix([0.0, 0.0], [0.0, 1.0]))
    assert not positive_definite(matrix([1.0, 2.0], [2.0, 1.0]))
    assert positive_definite(np.empty((0, 0), dtype=matrix([1.0]).dtype))


@pytest.mark.parametrize("columns", [None, 1, 3])
def test_a_linear_system_is_solved_in_both_arithmetics(columns):
    rng = np.random.default_rng(1)
    a, x = rng.integers(-9, 9, (4, 4)), rng.integers(-9, 9, (4, columns) if columns else 4)
    exact = np.vectorize(flint.fmpq, otypes=[object])
    assert (solve(exact(a), exact(a @ x)) == exact(x)).all()
    assert solve(exact(a), exact(a @ x)).shape == x.shape
    assert np.abs(solve(a.astype(float), a @ x.astype(float)) - x).max() < 1e-12

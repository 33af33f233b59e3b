"""Exact checks and conversions at the edge of what they allow."""

from fractions import Fraction
from types import SimpleNamespace

import flint
import numpy as np
import pytest

from certrack.certificates import verification
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
from certrack.certificates.layout import DOCUMENT_KEYS, FORMAT
from certrack.certificates.majorants import _root_of
from certrack.certificates.published import Terms
from certrack.certificates.ranges.proofs import MAX_PROOF_CELLS
from certrack.certificates.tube import Tube
from certrack.core.errors import InputError


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


@pytest.mark.parametrize("level", np.linspace(0.11, 1.3, 25))
def test_a_tube_stays_below_a_level_from_its_settling_time_on_and_not_before(level):
    """Of one piece, and of three of which the middle one rises."""
    one = Tube(start=1.5, floor=0.01, alpha=2.0)
    three = Tube(1.5, 0.01, 2.0, ((0.0, 1.5, 0.2), (0.4, 0.3, 0.9), (1.0, 0.8, 0.01)))
    grid = np.linspace(0, 8, 400_001)
    for tube in (one, three):
        found = tube.settling_time(level)
        outside = grid[tube(grid) > level * (1 + 1e-9)]
        assert found >= (outside[-1] if outside.size else 0) - 1e-9
        assert found <= (outside[-1] if outside.size else 0) + 3e-5
        assert tube.settling_time(0.0999) == np.inf


def test_rates_of_the_published_bound_are_the_smallest_of_all():
    gamma = np.diag([0.5, 2.0])

    def terms(**changes):
        fields = {"gain_rate": 1.5, "leak_gain": 9.0, "leak_theta": 9.0, "Gamma": gamma}
        law = SimpleNamespace(**fields | changes)
        return Terms(2.0, 3.0, 0.1, 1.0, 0.2, 0.3, 0.4, (0.7, 0.9), law, 0.5)

    mu1 = 2 - (1 + 0.5) * 3 * 0.1
    assert terms().mu1(0.5) == pytest.approx(mu1)
    assert terms().dbar(0.5) == pytest.approx((1 + 2) * 0.1 + 0.2 + 0.3 + 0.4)
    assert terms().rho1(0.5) == pytest.approx(mu1)
    assert terms(leak_gain=2.0).rho1(0.5) == pytest.approx(0.7 * 2 / 2)
    assert terms(leak_theta=2.0).rho1(0.5) == pytest.approx(1.0)
    assert terms(leak_theta=2.0, Gamma=np.zeros((0, 0))).rho1(0.5) == pytest.approx(mu1)
    assert terms().rho2() == pytest.approx(max(0.5, 0.9 / 3, 1.0))
    assert terms(gain_rate=0.1).rho2() == pytest.approx(4.5)
    assert terms(Gamma=np.zeros((0, 0))).rho2() == pytest.approx(0.5)


def test_a_cover_has_a_largest_number_of_cells(monkeypatch):
    body = dict.fromkeys(DOCUMENT_KEYS[FORMAT], "") | {"format": FORMAT}
    monkeypatch.setattr(verification, "cell_record", lambda entries: 1 / 0)
    for count, error in ((MAX_PROOF_CELLS, ZeroDivisionError), (MAX_PROOF_CELLS + 1, InputError)):
        with pytest.raises(error):
            verification._verify_cover(body | {"proof": [{}] * count})


@pytest.mark.parametrize(
    "majorant", [(4,), (0, 0, 9), (2, 3, 1), (2, 0, 7), (Fraction(1, 10**9), 5, 1)]
)
def test_the_root_of_a_majorant_is_above_the_root(majorant):
    majorant = tuple(map(Fraction, majorant))
    constant, slope = _root_of(majorant)
    for s in map(Fraction, (0, Fraction(1, 10**6), Fraction(1, 10), 1, 7, 10**5)):
        square = sum(c * s**i for i, c in enumerate(majorant))
        assert (constant + slope * s) ** 2 >= square
    b, a, p = (*majorant, 0, 0)[:3]
    assert float(constant) == pytest.approx(float(b) ** 0.5, rel=1e-12)
    steepest = max(float(p) ** 0.5, float(a) / (2 * float(b) ** 0.5) if a else 0.0)
    assert float(slope) == pytest.approx(steepest, rel=1e-12)
    assert _root_of((Fraction(0), Fraction(1))) is None
    assert _root_of((Fraction(1), Fraction(0), Fraction(0), Fraction(1))) is None

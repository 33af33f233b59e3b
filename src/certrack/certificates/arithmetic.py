"""Two arithmetics with the same formulas: floats, and exact rationals (python-flint)."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import flint
import numpy as np
import sympy

from certrack.core.expressions import Expression
from certrack.core.rationals import exact_rational

#: Turns a number or formula into the arithmetic at hand: :func:`rational` or :func:`decimal`.
ToNumber = Callable[[Any], Any]


def rational(value: Any) -> Any:
    """Exact rational of what a float stands for, of a formula, or of a Fraction."""
    if isinstance(value, Fraction):
        return flint.fmpq(value.numerator, value.denominator)
    if isinstance(value, Expression):
        value = value.expr
    if isinstance(value, sympy.Rational):
        return flint.fmpq(int(value.p), int(value.q))
    if isinstance(value, (float, np.floating, sympy.Expr)):  # an irrational by its float
        value = exact_rational(value if isinstance(value, float) else float(value))
    exact = Fraction(value)
    return flint.fmpq(exact.numerator, exact.denominator)


def fraction(exact: Any) -> Fraction:
    """The same number as a Fraction."""
    return Fraction(int(exact.p), int(exact.q))


def as_sympy(value: Any) -> sympy.Rational:
    """The exact rational of a number as one of SymPy."""
    exact = value if isinstance(value, flint.fmpq) else rational(value)
    return sympy.Rational(int(exact.p), int(exact.q))


def decimal(value: Any) -> Any:
    """Float of a number or formula."""
    return float(value.expr if isinstance(value, Expression) else value)


def solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of a linear system in the arithmetic of its arguments."""
    if matrix.dtype != object:
        return np.linalg.solve(matrix, right)
    a = flint.fmpq_mat([list(row) for row in matrix])
    columns = right if right.ndim == 2 else right[:, None]
    b = flint.fmpq_mat([[flint.fmpq(v) for v in row] for row in columns])
    solution = np.array(a.solve(b).tolist(), dtype=object).reshape(columns.shape)
    return solution if right.ndim == 2 else solution[:, 0]


def positive_definite(matrix: np.ndarray) -> bool:
    """Exact for rationals: every pivot of the LDL^T factorisation is positive."""
    if matrix.dtype != object:
        return bool(np.linalg.eigvalsh(matrix).min() > 0) if len(matrix) else True
    rows = matrix.copy()
    for k in range(len(rows)):
        pivot = rows[k, k]
        if not pivot > 0:
            return False
        factor = rows[k + 1 :, k] / pivot
        rows[k + 1 :, k + 1 :] -= factor[:, None] * rows[None, k, k + 1 :]
    return True


def exact_float(value: float, number: ToNumber) -> Any:
    """The value of a float itself, not of its decimal text.

    For bounds that were rounded up as floats: their shortest decimal text may be below the float,
    and so below what was bounded.
    """
    if number is rational:
        return flint.fmpq(*float(value).as_integer_ratio())
    return value

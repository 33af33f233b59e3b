"""The numbers of a law: lists and matrices of the right shape, and positive where they must be."""

from __future__ import annotations

from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.rationals import RationalFloat, exact_rational, exactly_positive_definite


def metric(key: str, value: Any, r: int) -> np.ndarray:
    """A symmetric positive definite r x r matrix from a diagonal, a matrix, or None (identity)."""
    if value is None:
        return np.eye(r)
    rows = _numbers(value)
    if rows.shape == (r,):
        rows = np.diag(rows)
    if rows.shape != (r, r):
        raise InputError(key, f"must be {r} numbers or a {r} x {r} matrix", _listed(value))
    if not np.array_equal(rows, rows.T):
        raise InputError(key, "must be symmetric", _listed(value))
    exact = [[exact_rational(entry) for entry in row] for row in rows.tolist()]
    if not exactly_positive_definite(exact):
        remedy = "Raise its diagonal: the determinant of every leading block must be positive"
        raise InputError(key, "must be positive definite", _listed(value), remedy)
    return rows


def vector(key: str, value: Any, r: int) -> np.ndarray:
    """r numbers, zero if None."""
    if value is None:
        return np.zeros(r)
    return _numbers(checks.reals(key, value, r, "one number per regressor"))


def _numbers(values: Any) -> np.ndarray:
    """An array of floats; of objects, where one of them stands for a rational."""
    entries = np.array(values, dtype=object)
    is_rational = any(isinstance(entry, RationalFloat) for entry in entries.ravel())
    return entries if is_rational else entries.astype(float)


def _listed(value: Any) -> Any:
    return [_listed(entry) for entry in value] if isinstance(value, (list, tuple)) else value

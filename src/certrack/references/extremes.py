"""The largest |p^(i)| of polynomials on intervals, exactly: roots are enclosed, not trusted."""

from __future__ import annotations

import math

import numpy as np
from flint import arb_poly, fmpq, fmpq_poly

from certrack.references.exact import exact, rational_above
from certrack.references.polynomials import derived, evaluate
from certrack.references.search import float_above_ball

#: Rows of which floats show, with this relative distance, that another is larger are passed over.
DISTANCE = 1e-9

#: Of the size of its terms: what roundings may take from a control point.
CONTROL_ROUNDING = 1e-12


def largest_derivative(p: fmpq_poly, i: int, end: fmpq) -> float:
    """The largest |p^(i)| on [0, end], rounded up: at the ends, or where p^(i+1) is zero."""
    for _ in range(i):
        p = p.derivative()
    best = max(rational_above(abs(p(fmpq(0)))), rational_above(abs(p(end))))
    slope = p.derivative().numer()
    for root, _ in slope.complex_roots() if slope.degree() > 0 else []:
        inside = not (root.real <= 0 or root.real >= end)
        if inside and root.imag.contains(0):
            best = max(best, float_above_ball(arb_poly(p)(root.real).abs_upper()))
    return best


def largest_of_rows(a: np.ndarray, i: int, knots: np.ndarray) -> float:
    """The largest |p^(i)| of all rows, each from its knot to the next, rounded up.

    Parameters
    ----------
    a : (m, d + 1) array
        Factors of the powers of the time since the row's knot, lowest power first.
    i : int
    knots : (m + 1,) array, s
    """
    best = 0.0
    for row in _candidates(derived(a, i), np.diff(knots)):
        width = exact(knots[row + 1]) - exact(knots[row])
        best = max(best, largest_derivative(fmpq_poly([exact(v) for v in a[row]]), i, width))
    return best


def _candidates(terms: np.ndarray, width: np.ndarray) -> list[int]:
    """Rows that may be largest: their control points reach what another row has at an end."""
    degree = terms.shape[1] - 1
    with np.errstate(all="ignore"):
        scaled = terms * width[:, None] ** np.arange(degree + 1)
        reached = np.maximum(np.abs(terms[:, 0]), np.abs(evaluate(terms, width)))
        powers = range(degree + 1)
        weights = [[math.comb(k, j) / math.comb(degree, j) for j in powers] for k in powers]
        points = np.abs(scaled @ np.array(weights).T).max(axis=1)
        points += CONTROL_ROUNDING * np.abs(scaled).sum(axis=1)
        passed_over = points < (1 - DISTANCE) * np.max(reached, initial=0.0)
    return np.flatnonzero(~passed_over).tolist()

"""Polynomials of one degree, many at once: a row of coefficients each, lowest power first."""

from __future__ import annotations

import math

import numpy as np

#: Enough for a cubic interpolant; a profile may have more.
DEGREE = 3

#: Where control points reach no further beyond a value at an end, the search of the largest ends;
#: and after so many halvings, or with so many pieces left.
CLOSE, MOST_HALVINGS, MOST_PIECES = 1 + 1e-10, 60, 20_000

#: Of the size of its terms: what a dozen roundings may take from a value.
ROUNDINGS = 2.0**-48


def derived(a: np.ndarray, i: int) -> np.ndarray:
    """Coefficient rows of the i-th derivative, padded with zeros."""
    rows = np.zeros_like(a)
    for k in range(i, a.shape[1]):
        rows[:, k - i] = math.perm(k, i) * a[:, k]
    return rows


def evaluate(a: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Value of each row's polynomial at its own s."""
    value = np.zeros_like(s)
    for k in range(a.shape[1] - 1, -1, -1):
        value = value * s + a[:, k]
    return value


def value_above(a: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Upper bound of |p(s)| of each row's polynomial at its own s >= 0, its roundings included.

    Coefficients and s may be a few roundings away from the exact ones.
    """
    value: np.ndarray = np.abs(evaluate(a, s)) + ROUNDINGS * evaluate(np.abs(a), s)
    return value


def largest_slope(a: np.ndarray, i: int, width: np.ndarray) -> float:
    """Upper bound of |p^(i)|, i >= 1, of all rows' polynomials on [0, width]."""
    terms = derived(a, i)
    if terms[:, 3:].any():
        return largest_by_control_points(terms, width)
    c1, c2 = terms[:, 1], terms[:, 2]
    best = np.maximum(np.abs(terms[:, 0]) * (1 + ROUNDINGS), value_above(terms, width))
    with np.errstate(all="ignore"):
        turning = np.nan_to_num(-c1 / (2 * c2), nan=-1.0, posinf=-1.0, neginf=-1.0)
    inside = (turning > 0) & (turning < width)
    there = np.zeros_like(terms)
    there[:, 0], there[:, 1] = terms[:, 0], c1 / 2  # its value where it turns
    best[inside] = np.maximum(best, value_above(there, turning))[inside]
    return float(best.max())


def largest_by_control_points(terms: np.ndarray, width: np.ndarray) -> float:
    """Upper bound of |p| of all rows' polynomials on [0, width], rounded up.

    A polynomial stays among its control points. Pieces whose control points reach beyond the
    largest value at an end are halved, by de Casteljau's averages, until none does by more than
    :data:`CLOSE`, or there are too many, which leaves a larger bound.
    """
    degree = terms.shape[1] - 1
    powers = range(degree + 1)
    weights = [
        [math.comb(j, k) / math.comb(degree, k) if k <= j else 0.0 for j in powers] for k in powers
    ]
    with np.errstate(all="ignore"):
        scaled = terms * width[:, None] ** np.arange(degree + 1)
        points = scaled @ np.array(weights)
        lost = ROUNDINGS * (degree + 4) * float(np.abs(scaled).sum(axis=1).max(initial=0.0))
        if not np.isfinite(points).all() or not math.isfinite(lost):
            return math.inf
        size, reached = float(np.abs(points).max(initial=0.0)), 0.0
        for _ in range(MOST_HALVINGS):
            reached = max(reached, float(np.abs(points[:, [0, -1]]).max(initial=0.0)))
            open_ = np.abs(points).max(axis=1, initial=0.0) > reached * CLOSE
            points = points[open_]
            if not 0 < len(points) <= MOST_PIECES:
                break
            points = _halved(points)
            lost += ROUNDINGS * (degree + 4) * size
        largest = max(reached * CLOSE, float(np.abs(points).max(initial=0.0)))
    return (largest + lost) * (1 + ROUNDINGS)


def _halved(points: np.ndarray) -> np.ndarray:
    """Control points of the left and the right halves."""
    left, right, row = [points[:, 0]], [points[:, -1]], points
    while row.shape[1] > 1:
        row = (row[:, :-1] + row[:, 1:]) / 2
        left.append(row[:, 0])
        right.append(row[:, -1])
    return np.vstack([np.array(left).T, np.array(right[::-1]).T])


def stationary(slope: np.ndarray, width: np.ndarray) -> list[np.ndarray]:
    """Roots of each row, moved into the piece (any point of it is admissible)."""
    if slope[:, 3:].any():
        return _roots(slope, width)
    # in units of the piece's width and height, so that nothing under- or overflows
    scaled = slope[:, :3] * width[:, None] ** np.arange(3)
    scaled = scaled / np.maximum(np.abs(scaled).max(axis=1, keepdims=True), 1e-300)
    c0, c1, c2 = scaled[:, 0], scaled[:, 1], scaled[:, 2]
    with np.errstate(all="ignore"):
        half = -(c1 + np.copysign(np.sqrt(np.maximum(c1**2 - 4 * c0 * c2, 0.0)), c1)) / 2
        roots = (half / c2, c0 / half)
    finite = (np.nan_to_num(root, nan=0.0, posinf=0.0, neginf=0.0) for root in roots)
    return [width * np.clip(root, 0.0, 1.0) for root in finite]


def _roots(slope: np.ndarray, width: np.ndarray) -> list[np.ndarray]:
    """The same for rows of any degree; of a complex pair, maybe a double root, its middle."""
    count = slope.shape[1] - 1
    points = np.zeros((count, len(slope)))
    scaled = slope * width[:, None] ** np.arange(count + 1)
    for i, row in enumerate(scaled):
        roots = np.roots(row[::-1] / max(np.abs(row).max(), 1e-300)).real
        points[: len(roots), i] = np.nan_to_num(roots, nan=0.0, posinf=0.0, neginf=0.0)
    return list(width * np.clip(points, 0.0, 1.0))

"""The starts from which the input is proven to stay within its limits: a polytope.

With the bounds X(k) of a whole region of starts, the input of period k is G_k x(0) plus what the
reference at t = 0 adds, within what all the rest can: two half-spaces for each period. From every
start in all of them, and in the region, no limit is ever met.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from certrack.certificates.implemented.enclosed import ROUNDOFF, widened
from certrack.core import checks
from certrack.core.errors import InputError


@dataclass(frozen=True)
class Polytope:
    """{x in region : rows x <= limits}, a set of starts x(0).

    Attributes
    ----------
    rows : (M, n) array
    limits : (M,) array
        Rounded down, so that a product in floats proves it.
    region : n pairs (low, high)
        For which the bounds behind it were computed.
    states : n names
    """

    rows: np.ndarray
    limits: np.ndarray
    region: tuple[tuple[float, float], ...]
    states: tuple[str, ...]

    def __contains__(self, x: Sequence[float] | np.ndarray) -> bool:
        return bool(self.contains(x))

    def contains(self, x: Sequence[float] | np.ndarray) -> np.ndarray:
        """Whether starts are proven.

        Parameters
        ----------
        x : (n,) or (..., n) array

        Returns
        -------
        array of bool, shape (...)

        Raises
        ------
        InputError
            If it has another number of states.
        """
        x = np.asarray(x, dtype=float)
        if x.shape[-1:] != (len(self.states),):
            raise InputError("x0", f"must have {len(self.states)} numbers per start", x.shape)
        low, high = np.array(self.region).T
        within = ((low <= x) & (x <= high)).all(axis=-1)
        inside: np.ndarray = within & (x @ self.rows.T <= self.limits).all(axis=-1)
        return inside

    @property
    def is_region(self) -> bool:
        """Whether it is all of the region."""
        return not len(self.rows)

    def largest_box(self) -> tuple[tuple[float, float], ...] | None:
        """The largest box of the region's middle and shape that lies in it; None if there is none.

        Its corners are rounded inwards by a part in 10^9.
        """
        low, high = np.array(self.region).T
        middle, half = (low + high) / 2, (high - low) / 2
        room = self.limits - self.rows @ middle
        reach = np.abs(self.rows) @ half
        if (room < 0).any():
            return None
        with np.errstate(divide="ignore"):
            part = min(1.0, float(np.min(room / np.maximum(reach, 1e-300), initial=1.0)))
        part *= 1 - 1e-9 if part < 1 else 1
        ends = zip((middle - part * half).tolist(), (middle + part * half).tolist(), strict=True)
        return tuple(ends)

    def section(
        self, first: str | int, second: str | int, at: Sequence[float] | None = None
    ) -> np.ndarray:
        """Corners of its section by two states, in order.

        Parameters
        ----------
        first, second : names of states, or their numbers from 0
        at : n numbers, optional
            Values of the other states; zero if left out.

        Returns
        -------
        (V, 2) array
            Without rows if the plane does not meet it.
        """
        i, j = self.index(first), self.index(second)
        if i == j:
            raise InputError("states", "must be two different ones", [first, second])
        n = len(self.states)
        fixed = np.array(checks.reals("at", at or [0.0] * n, n, "one number per state"))
        fixed[[i, j]] = 0.0
        others = [k for k in range(n) if k not in (i, j)]
        if any(not self.region[k][0] <= fixed[k] <= self.region[k][1] for k in others):
            return np.empty((0, 2))
        (a, b), (c, d) = self.region[i], self.region[j]
        corners = [np.array(p) for p in ((a, c), (b, c), (b, d), (a, d))]
        room = self.limits - self.rows @ fixed
        for row, limit in zip(self.rows[:, [i, j]], room, strict=True):
            corners = _cut(corners, row, float(limit))
        return np.array(corners).reshape(-1, 2)

    def index(self, state: str | int) -> int:
        """Number of a state from 0."""
        if isinstance(state, str):
            return self.states.index(checks.choice("states", state, self.states))
        return checks.integer("states", state, 0, len(self.states) - 1)


def _cut(corners: list[np.ndarray], row: np.ndarray, limit: float) -> list[np.ndarray]:
    """The part of a convex polygon with row x <= limit."""
    left: list[np.ndarray] = []
    for p, q in pairwise([*corners, *corners[:1]]):
        a, b = float(row @ p) - limit, float(row @ q) - limit
        if a <= 0:
            left.append(p)
        if (a < 0 < b) or (b < 0 < a):
            left.append(p + a / (a - b) * (q - p))
    return left


def half_spaces(
    rows: np.ndarray, error: np.ndarray, limits: np.ndarray, region: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and limits, in floats whose products prove it; without those that the region implies.

    Parameters
    ----------
    rows, error : (M, n) arrays
        Rows, and what they may be off by.
    limits : (M,) array
        Rounded down.
    region : (n, 2) array
    """
    size, n = np.abs(region).max(axis=1), len(region)
    off = widened(error @ size + 4 * (n + 4) * ROUNDOFF * (np.abs(rows) @ size), 2 * n + 8)
    limits = limits - off - 4 * ROUNDOFF * (np.abs(limits) + off)
    least, most = region.T
    reach = np.where(rows > 0, rows * most, rows * least).sum(axis=1)
    slack = 4 * (n + 4) * ROUNDOFF * (np.abs(rows) @ size)
    needed = reach + slack > limits
    return rows[needed], limits[needed]


def common(polytopes: Sequence[Polytope]) -> Polytope:
    """What lies in all of them, and in the regions of all."""
    regions = np.array([p.region for p in polytopes])
    low, high = regions[:, :, 0].max(axis=0), regions[:, :, 1].min(axis=0)
    return Polytope(
        np.concatenate([p.rows for p in polytopes]),
        np.concatenate([p.limits for p in polytopes]),
        tuple(zip(low.tolist(), high.tolist(), strict=True)),
        polytopes[0].states,
    )

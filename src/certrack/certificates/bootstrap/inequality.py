"""The conditions on a quadratic function, in floats or exactly.

W = (zeta, 1)^T G (zeta, 1) need not be positive. At every corner, with multipliers >= 0 but for mu,

    W' + alpha W + sum squares_k (|rows_k w|^2 - w_k^2) + sum inputs_i (1 - w_i^2)
       + sum sectors_j (1 - (row_j (zeta, 1))^2) + (mu w) (relation w)
       + sum (v^T D_i v - (psi v)^T D_i (psi v) + v^T K_i (psi v))  <=  0,

with D_i >= 0 and K_i = -K_i^T. So W' <= -alpha W in the box: the left side is affine in pi, what
stands behind the multipliers is not negative, and the relation is zero for the true pi. In the long
run W is not positive, and a row c with scale W + u >= c (zeta, 1) everywhere has limsup
c (zeta, 1) <= u.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.bootstrap.forms import Corner, Forms

#: Multipliers of :class:`Unknowns`, in the order of its fields.
MULTIPLIERS = ("squares", "inputs", "sectors", "mu", "scales", "turns")


@dataclass(frozen=True)
class Unknowns:
    """What a solver finds and a proof states.

    Attributes
    ----------
    alpha : number
    G : (size + 1, size + 1) array
    squares, inputs, sectors, mu : arrays
        Multipliers; `inputs` one for each entry of w behind the 1.
    scales, turns : arrays
        Upper triangles of the D_i, column by column, and of the K_i without their diagonals.
    """

    alpha: Any
    G: np.ndarray
    squares: np.ndarray
    inputs: np.ndarray
    sectors: np.ndarray
    mu: np.ndarray
    scales: np.ndarray
    turns: np.ndarray

    def scale(self, i: int) -> np.ndarray:
        """D_i."""
        a, b, c, d, e, f = self.scales[6 * i : 6 * i + 6]
        return np.array([[a, b, d], [b, c, e], [d, e, f]])

    def turn(self, i: int) -> np.ndarray:
        """K_i."""
        a, b, c = self.turns[3 * i : 3 * i + 3]
        return np.array([[0 * a, a, b], [-a, 0 * a, c], [-b, -c, 0 * a]])


def multiplier_counts(forms: Forms) -> tuple[int, ...]:
    """How many numbers each of :data:`MULTIPLIERS` has."""
    kinds, behind = len(forms.products), forms.width - forms.size - 1
    return len(forms.squares), behind, len(forms.sectors), forms.width, 6 * kinds, 3 * kinds


def shared_form(forms: Forms, unknowns: Unknowns) -> np.ndarray:
    """The part of the inequality that all corners share."""
    size, width = forms.size, forms.width
    Q = np.zeros((width, width), dtype=forms.middle.dtype) + 0 * forms.middle[0]
    Q[: size + 1, : size + 1] = unknowns.alpha * unknowns.G
    for value, (rows, place) in zip(unknowns.squares, forms.squares, strict=True):
        Q += value * (rows.T @ rows)
        Q[place, place] -= value
    places = np.arange(size + 1, width)
    Q[places, places] -= unknowns.inputs
    Q[size, size] += sum(unknowns.inputs, 0 * Q[0, 0]) + sum(unknowns.sectors, 0 * Q[0, 0])
    for value, row in zip(unknowns.sectors, forms.sectors, strict=True):
        Q[: size + 1, : size + 1] -= value * np.outer(row, row)
    for i, (at, times) in enumerate(forms.products):
        D, K = unknowns.scale(i), unknowns.turn(i)
        Q[np.ix_(at, at)] += D
        Q[np.ix_(times, times)] -= D
        Q[np.ix_(at, times)] += K / 2
        Q[np.ix_(times, at)] += K.T / 2
    return Q


def corner_form(forms: Forms, corner: Corner, unknowns: Unknowns) -> np.ndarray:
    """What a corner adds to it."""
    size = forms.size
    through = np.outer(unknowns.mu, corner.relation) / 2
    through[: size + 1] += unknowns.G[:, :size] @ corner.F
    form: np.ndarray = through + through.T
    return form


def target_form(G: np.ndarray, row: np.ndarray, bound: Any) -> np.ndarray:
    """Of W + bound - row (zeta, 1)."""
    form: np.ndarray = G.copy()
    form[-1] = form[-1] - row / 2
    form[:, -1] = form[:, -1] - row / 2
    form[-1, -1] += bound
    return form

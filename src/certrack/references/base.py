"""The interface every reference keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import sympy

from certrack.core.errors import InputError


@dataclass(frozen=True)
class Bounds:
    """Y_0 ... Y_m with |y_d^(i)(t)| <= Y_i for all t >= 0, and where they come from.

    Attributes
    ----------
    values : tuple of float
        Y_i, rounded up.
    origin : tuple of str
        Per bound: ``"exact"``, ``"proven"`` (an upper bound, maybe loose) or ``"declared"``.
    """

    values: tuple[float, ...]
    origin: tuple[str, ...]


class Reference(Protocol):
    """What a closed loop, a simulation and a certificate ask of a reference."""

    @property
    def order(self) -> float:
        """Highest derivative that exists piecewise and is bounded (``inf`` if smooth)."""

    @property
    def declared_bound(self) -> float | None:
        """The user's D of Assumption 2, |y_d| + |y_d'| <= D."""

    def bounds(self, order: int) -> Bounds:
        """Bounds Y_0 ... Y_order; raises InputError where they cannot be proven."""

    def breaks(self, start: float, end: float) -> np.ndarray:
        """Times strictly inside (start, end) where a derivative jumps."""

    def values(self, t: np.ndarray, order: int) -> np.ndarray:
        """y_d ... y_d^(order) at the times `t`, shape (order + 1, len(t))."""

    def formulas(self, order: int) -> tuple[sympy.Expr, ...]:
        """y_d ... y_d^(order) as formulas of t, the parameters and the piece symbols."""

    @property
    def parameter_symbols(self) -> tuple[sympy.Symbol, ...]:
        """Symbols in the formulas that a sweep may vary."""

    @property
    def parameter_values(self) -> tuple[float, ...]:
        """Values of :attr:`parameter_symbols`."""

    @property
    def piece_symbols(self) -> tuple[sympy.Symbol, ...]:
        """Symbols that take new values at every break point."""

    def piece_values(self, t: float) -> np.ndarray:
        """Values of :attr:`piece_symbols` on the piece that begins at or contains `t`."""


def pieces_at(reference: Reference, t: np.ndarray) -> np.ndarray:
    """Values of the piece symbols at every time, a row each."""
    if not reference.piece_symbols:
        return np.empty((0, len(t)))
    edges = np.concatenate([[0.0], reference.breaks(0.0, float(t.max()))])
    table = np.array([reference.piece_values(edge) for edge in edges])
    values: np.ndarray = table[np.searchsorted(edges, t, side="right") - 1].T
    return values


def require_order(reference: Reference, order: int, who: str) -> None:
    """Refuse a reference that is not smooth enough for `who`."""
    if reference.order < order:
        raise InputError(
            "reference",
            f"{who} needs {order} bounded derivatives of y_d, the reference has "
            f"{reference.order:g}",
            remedy="Lower law.feedforward or choose a smoother reference",
        )


def total_bound(reference: Reference) -> float:
    """D of Assumption 2: declared by the user, else Y_0 + Y_1."""
    if reference.declared_bound is not None:
        return reference.declared_bound
    return round_up(sum(reference.bounds(1).values))


#: Roundings that :func:`round_up` makes good, each at most half a unit in the last place.
ROUNDED_UNITS = 4


def round_up(value: float) -> float:
    """A float not below the exact result, where `value` was computed with a few roundings.

    Every float operation may round down, and a bound must not: the next floats are taken. Zero
    stays zero, for a sum of magnitudes that is zero is exact.
    """
    for _ in range(ROUNDED_UNITS if value else 0):
        value = math.nextafter(value, math.inf)
    return value

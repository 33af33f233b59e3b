"""What every reference must offer, and what follows from that alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import sympy

from certrack.core.errors import InputError
from certrack.core.rationals import stated_above


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
    """What a closed loop, a simulation and a certificate ask of a reference y_d(t), t >= 0.

    A reference that consists of cubic pieces is a function that returns a
    :class:`~certrack.references.piecewise.PiecewiseReference`, and a formula in t is a
    :class:`~certrack.references.symbolic.SymbolicReference`; both keep these duties already. Any
    other kind is a class that inherits this one, for the parts that may be left out, and must:

    1. be a frozen dataclass whose equality leaves no field out: equal references share compiled
       loops and results, and a run must not change them. Its fields are declared by
       :func:`certrack.references.key`, and :func:`certrack.references.register` gives it the word
       by which system files name it;
    2. be continuous, and say in `order` how many derivatives exist piecewise and are bounded;
       derivatives below `order` must be continuous. A law with feed-forward order q is refused
       unless ``order >= q + 1``, and asks for derivatives 0 ... q + 1 only;
    3. state y_d and its derivatives twice, as numbers (`values`) and as formulas (`formulas`), and
       the two must agree between the breaks: the loop is compiled from the formulas, errors are
       computed from the values;
    4. list in `breaks` every time at which one of these derivatives jumps, unless the formula shows
       the kink itself by abs, min or max: integrators stop and restart there, and lose their
       accuracy without notice where a break is missing;
    5. bound every derivative for all t >= 0, rounded up, and refuse where it cannot: the
       certificates take the bounds as proven, and what they claim holds for every reference within
       them.

    A reference of which y_d or a derivative has no bound, such as a ramp, may have `bound_of(i)`
    besides, which gives Y_i and its origin: what no proof needs is then not asked for. One whose
    derivative of the order `order` jumps may have `jumps(i)` and `lipschitz_bound(i,
    between_jumps=False)`, as :func:`jumps` and :func:`lipschitz_bound` ask for them.

    Optional, with what holds if they are left out: `declared_bound` (None: nobody has declared D),
    `breaks` (none), and the symbols with their values (none). Symbols begin with ``ref_`` or
    ``piece_``. A system refuses a reference that is not registered, whose formulas contain what is
    not supported, or whose formulas and values differ. What cannot be checked - bounds, breaks that
    are missing - :class:`certrack.testing.ReferenceConformance` looks at.

    Times are in s, y_d in the unit of the output, y_d^(i) in that unit per s^i.
    """

    @property
    def order(self) -> float:
        """Highest derivative that exists piecewise and is bounded (``inf`` if smooth)."""

    @property
    def declared_bound(self) -> float | None:
        """The user's D of Assumption 2, |y_d| + |y_d'| <= D; None if not declared."""
        return None

    def bounds(self, order: int) -> Bounds:
        """Bounds Y_0 ... Y_order, each >= sup |y_d^(i)| over t >= 0.

        Raises
        ------
        InputError
            Where a bound can neither be proven nor is declared.
        """

    def breaks(self, start: float, end: float) -> np.ndarray:
        """Increasing times strictly inside (start, end) where a derivative jumps, s."""
        return np.empty(0)

    def values(self, t: np.ndarray, order: int) -> np.ndarray:
        """y_d ... y_d^(order) at the times `t`, shape (order + 1, len(t)).

        At a break, a derivative that jumps takes the value after it.
        """

    def formulas(self, order: int) -> tuple[sympy.Expr, ...]:
        """y_d ... y_d^(order) as order + 1 formulas of t, the parameters and the piece symbols.

        Of functions that :mod:`certrack.core.lowering` can compile, and without numbers that a
        sweep may vary: those are parameters.
        """

    @property
    def parameter_symbols(self) -> tuple[sympy.Symbol, ...]:
        """Symbols in the formulas that a sweep may vary; no state or gain may have their names."""
        return ()

    @property
    def parameter_values(self) -> tuple[float, ...]:
        """Values of :attr:`parameter_symbols`, as many."""
        return ()

    @property
    def piece_symbols(self) -> tuple[sympy.Symbol, ...]:
        """Symbols in the formulas that take new values at every break point."""
        return ()

    def piece_values(self, t: float) -> np.ndarray:
        """Values of :attr:`piece_symbols`, as many, on the piece that begins at or contains `t`.

        A `t` that is a break but for rounding is the break, so the piece after it counts.
        """
        return np.empty(0)


def pieces_at(reference: Reference, t: np.ndarray) -> np.ndarray:
    """Values of the piece symbols at every time, a row each."""
    if not reference.piece_symbols:
        return np.empty((0, len(t)))
    edges = np.concatenate([[0.0], reference.breaks(0.0, float(t.max()))])
    table = np.array([reference.piece_values(edge) for edge in edges])
    values: np.ndarray = table[np.searchsorted(edges, t, side="right") - 1].T
    return values


def bound_of(reference: Reference, i: int) -> tuple[float, str]:
    """Y_i alone and its origin: a ramp has no Y_0, but a Y_1, and may need no other.

    Raises
    ------
    InputError
        Where it can neither be proven nor is declared.
    """
    alone: Callable[[int], tuple[float, str]] | None = getattr(reference, "bound_of", None)
    if alone is not None:
        return alone(i)
    bounds = reference.bounds(i)
    return bounds.values[i], bounds.origin[i]


def lipschitz_bound(
    reference: Reference, order: int, *, between_jumps: bool = False
) -> float | None:
    """Upper bound of the Lipschitz constant of y_d^(order) over t >= 0, rounded up.

    Where y_d^(order + 1) exists piecewise and y_d^(order) is continuous, that is Y_{order+1}.

    Parameters
    ----------
    reference : Reference
    order : int
        Of the derivative; 0 for y_d itself.
    between_jumps : bool
        Whether y_d^(order) may jump, as :func:`jumps` says, and what counts is between the jumps.

    Returns
    -------
    float or None
        None where there is none: y_d^(order) jumps or does not exist, or no bound is known.
    """
    method: Callable[..., float | None] | None = getattr(reference, "lipschitz_bound", None)
    if method is not None:
        return method(order, between_jumps=between_jumps)
    if order + 1 > reference.order:
        return None
    try:
        return bound_of(reference, order + 1)[0]
    except InputError:
        return None


def jumps(reference: Reference, order: int) -> tuple[float, float] | None:
    """Size of the largest jump of y_d^(order), and the least time between two jumps, s.

    Parameters
    ----------
    reference : Reference
    order : int

    Returns
    -------
    (size, spacing), or None
        The size is rounded up, the spacing down; it is inf where there is one jump. None where
        y_d^(order) does not jump, and where its jumps are not known: whoever asks takes
        :func:`lipschitz_bound` first, which tells the two apart.
    """
    method: Callable[[int], tuple[float, float] | None] | None = getattr(reference, "jumps", None)
    return None if method is None else method(order)


def require_order(reference: Reference, order: int, who: str) -> None:
    """Refuse a reference that is not smooth enough for `who`."""
    if reference.order < order:
        raise InputError(
            "reference",
            f"{who} needs {order} bounded derivatives of y_d, the reference has "
            f"{reference.order:g}",
            remedy=f"Lower law.feedforward or {_smoother(reference, order)}",
        )


def _smoother(reference: Reference, order: int) -> str:
    """What in the file gives the reference this order, in words."""
    kind = dict(getattr(reference, "fields", ())).get("kind")
    if kind in ("polynomial", "samples") and order <= LARGEST_SPLINE_ORDER:
        spline = 'interpolation = "spline" and ' if kind == "samples" else ""
        return f"take {spline}degree = {max(2 * order - 1, 3)} in [reference]"
    if kind in ("velocity", "scurve", "moves") and order in LIMIT_OF_ORDER:
        return f'take kind = "moves" with a limit of {LIMIT_OF_ORDER[order]} besides'
    return "choose a smoother reference"


def total_bound(reference: Reference) -> float:
    """D of Assumption 2: declared by the user, else Y_0 + Y_1."""
    if reference.declared_bound is not None:
        return stated_above(reference.declared_bound)
    return round_up(sum(reference.bounds(1).values))


#: Splines and polynomials of degree 2 m - 1 have the order m, up to this one.
LARGEST_SPLINE_ORDER = 5

#: Moves from rest to rest have the order of their highest limit.
LIMIT_OF_ORDER = {2: "acceleration", 3: "jerk", 4: "snap"}

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

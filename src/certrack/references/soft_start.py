"""A soft start: the reference begins at the measured state and joins its target smoothly.

y_d = r + p, where r is the target, and p brings y_d and its first m derivatives at t = 0 to those
of the state and vanishes at the time tau with as many derivatives. So the error begins near zero,
and the input without a peak. From tau on y_d is r: what holds in the long run needs the bounds of
r only, and what holds from a start needs those of r + p.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import sympy
from flint import fmpq_poly

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, symbol
from certrack.core.keys import set_fields
from certrack.references.base import (
    Bounds,
    Reference,
    bound_of,
    jumps,
    lipschitz_bound,
    round_up,
)
from certrack.references.exact import exact, nearest
from certrack.references.extremes import largest_derivative
from certrack.references.piecewise import SAME_TIME

#: Derivatives of y_d at the start that are brought to those of the state, beyond y_d itself.
MAX_JOINED = 20

#: Shortest soft start, s: derivatives grow with its inverse powers.
MIN_TRANSIENT = 1e-6

#: 1 while it joins, 0 afterwards.
JOINING = sympy.Symbol("piece_joining", real=True)


@dataclass(frozen=True)
class SoftStart(Reference):
    """A target that is joined from a start.

    Parameters
    ----------
    target : Reference
        What is followed after the transient.
    transient : float, s
        tau: how long it takes.
    start : tuple of float
        y, y', ... of the state at t = 0: as many as there are states, or as the target has
        continuous derivatives. A system sets them from its initial state; empty before.
    """

    target: Reference
    transient: float
    start: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.target, SoftStart):
            raise InputError("reference.transient", "must not be stated twice")
        transient = checks.real("reference.transient", self.transient, least=MIN_TRANSIENT)
        start = checks.reals("reference.start", self.start, None, "y, y', ... at t = 0")
        set_fields(self, transient=transient, start=start)

    def joined(self, start: tuple[float, ...]) -> SoftStart:
        """The same from another start, of which what the target has no derivative for is left."""
        most = min(self.target.order, MAX_JOINED)
        return replace(self, start=tuple(start)[: int(min(len(start), most))])

    @property
    def order(self) -> float:
        """That of the target, or the number of derivatives that are joined."""
        return min(self.target.order, float(len(self.start) or math.inf))

    @property
    def declared(self) -> tuple[float, ...] | None:
        """Bounds of the target that a user has declared."""
        declared: tuple[float, ...] | None = getattr(self.target, "declared", None)
        return declared

    @property
    def long_run(self) -> Reference:
        """What it is from the time `transient` on."""
        return self.target

    def gaps(self, start: np.ndarray) -> np.ndarray:
        """p(0), p'(0), ...: by how much the start differs from the target's, a row each."""
        if not len(start):
            return start
        at_zero = self.target.values(np.zeros(1), len(start) - 1)
        return np.asarray(start) - at_zero.reshape(-1, *[1] * (np.ndim(start) - 1))

    @cached_property
    def _own_gaps(self) -> tuple[float, ...]:
        return tuple(self.gaps(np.array(self.start)).tolist())

    @property
    def _basis(self) -> tuple[fmpq_poly, ...]:
        return vanishing(len(self.start), self.transient)

    def bounds(self, order: int) -> Bounds:
        """For all t >= 0: those of the target, and what p adds."""
        pairs = [self.bound_of(i) for i in range(order + 1)]
        return Bounds(tuple(value for value, _ in pairs), tuple(origin for _, origin in pairs))

    def bound_of(self, i: int) -> tuple[float, str]:
        """Y_i alone, and where it comes from."""
        value, origin = bound_of(self.target, i)
        added = self._transient(i)
        return round_up(value + added), "proven" if origin == "exact" and added else origin

    def _transient(self, i: int) -> float:
        """The largest |p^(i)|, rounded up."""
        p = fmpq_poly([0])
        for gap, polynomial in zip(self._own_gaps, self._basis, strict=True):
            p += exact(gap) * polynomial
        return largest_derivative(p, i, exact(self.transient))

    def lipschitz_bound(self, order: int, *, between_jumps: bool = False) -> float | None:
        """That of y_d^(order); see :func:`certrack.references.lipschitz_bound`."""
        if order > self.order or (order == self.order and not between_jumps):
            return None
        jumping = order == self.target.order and between_jumps
        slope = lipschitz_bound(self.target, order, between_jumps=jumping)
        return None if slope is None else round_up(slope + self._transient(order + 1))

    def jumps(self, order: int) -> tuple[float, float] | None:
        """Those of y_d^(order); where the transient ends they may be near those of the target."""
        if order != self.order or not self.start:
            return None
        ends = self._transient(order)
        known = jumps(self.target, order)
        if known is None:
            return ends, math.inf
        near = np.asarray(self.target.breaks(0.0, 2 * self.transient + known[1]), dtype=float)
        apart = np.abs(near - self.transient)
        apart = apart[apart > SAME_TIME * max(1.0, self.transient)]  # else both jumps are one
        return round_up(ends + known[0]), float(apart.min(initial=known[1])) * (1 - 1e-9)

    def breaks(self, start: float, end: float) -> np.ndarray:
        known = np.asarray(self.target.breaks(start, end), dtype=float)
        tiny = SAME_TIME * max(1.0, abs(end))
        if not start + tiny < self.transient < end - tiny or not self.start:
            return known
        if len(known) and np.abs(known - self.transient).min() <= tiny:
            return known
        return np.union1d(known, [self.transient])

    def values(self, t: np.ndarray, order: int) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        total = np.array(self.target.values(t, order), dtype=float)
        during = t < self.transient
        for gap, polynomial in zip(self._own_gaps, self._basis, strict=True):
            for i in range(order + 1):
                factors = [nearest(f) for f in polynomial.coeffs()]
                total[i] += np.where(during, gap * np.polyval(factors[::-1], t), 0.0)
                polynomial = polynomial.derivative()
        return total

    def formulas(self, order: int) -> tuple[sympy.Expr, ...]:
        total = list(self.target.formulas(order))
        for name, polynomial in zip(self._gap_symbols, self._basis, strict=True):
            for i in range(order + 1):
                terms = (
                    sympy.Rational(*nearest(f).as_integer_ratio()) * TIME**k
                    for k, f in enumerate(polynomial.coeffs())
                    if f != 0
                )
                total[i] += JOINING * name * sympy.Add(*terms)
                polynomial = polynomial.derivative()
        return tuple(total)

    @property
    def _gap_symbols(self) -> tuple[sympy.Symbol, ...]:
        return tuple(symbol(f"ref_gap_{i}") for i in range(len(self.start)))

    @property
    def parameter_symbols(self) -> tuple[sympy.Symbol, ...]:
        """Those of the target, and the gaps last."""
        return (*self.target.parameter_symbols, *self._gap_symbols)

    @property
    def parameter_values(self) -> tuple[float, ...]:
        return (*self.target.parameter_values, *self._own_gaps)

    @property
    def piece_symbols(self) -> tuple[sympy.Symbol, ...]:
        return (*self.target.piece_symbols, JOINING) if self.start else self.target.piece_symbols

    def piece_values(self, t: float) -> np.ndarray:
        values = np.asarray(self.target.piece_values(t), dtype=float)
        if not self.start:
            return values
        soon = t + SAME_TIME * max(1.0, abs(t))
        return np.append(values, 1.0 if soon < self.transient else 0.0)


@lru_cache(maxsize=64)
def vanishing(count: int, transient: float) -> tuple[fmpq_poly, ...]:
    """Polynomials of t: the i-th has the i-th derivative 1 at 0 and no other of the first `count`.

    All of these are zero at the end of the transient.
    """
    u = fmpq_poly([0, 1 / exact(transient)])
    basis = []
    for i in range(count):
        series = fmpq_poly([math.comb(count - 1 + k, k) for k in range(count - i)])
        p = fmpq_poly([0, 1]) ** i * fmpq_poly([1, -1]) ** count * series / math.factorial(i)
        basis.append(p(u) * exact(transient) ** i)
    return tuple(basis)


def long_run(reference: Reference) -> Reference:
    """What a reference is in the long run: without a transient part that has vanished."""
    return reference.long_run if isinstance(reference, SoftStart) else reference

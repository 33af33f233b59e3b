"""A reference given by a formula in t; SymPy differentiates it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, Expression, check_name, number, parse, symbol
from certrack.core.keys import set_fields
from certrack.core.kinks import JUMPING, derivative
from certrack.core.lowering import numpy_callable, rows
from certrack.core.powers import put_in
from certrack.core.rationals import stated_above
from certrack.references.base import Bounds, require_order
from certrack.references.growth import Undefined
from certrack.references.smoothness import Smoothness, smoothness
from certrack.references.supremum import is_sum_of_sinusoids, sinusoid_supremum

#: What to do about a formula that may jump.
NO_JUMPS = (
    "Keep what is divided by, and the arguments of log, roots and tan, within what they allow for "
    'all t >= 0, or use kind = "steps" or "samples"'
)

#: Times at which a declared bound is compared with the signal, dense where transients are, s.
CHECK_TIMES = np.concatenate([np.linspace(0, 100, 10_001), np.geomspace(100, 1e4, 2_000)])


#: Times in a run at which the formula is evaluated before it.
CHECKED_IN_RUN = 1001

#: Relative excess over a declared bound that is not refused: the evaluation of a formula rounds.
CHECK_TOLERANCE = 1e-9


@dataclass(frozen=True)
class SymbolicReference:
    """y_d(t) as a formula.

    Parameters
    ----------
    signal : formula in t
        y_d, unit of the output. It must be continuous for all t >= 0, which is proven: a division,
        log, tan or root that may have no value somewhere is refused, and so is sign. With abs, min
        and max it has the order that :func:`~certrack.references.smoothness.smoothness` finds.
    bound : float, optional
        D with |y_d| + |y_d'| <= D (Assumption 2).
    declared : tuple of float, optional
        Y_0, Y_1, ... where the user knows them; otherwise they are proven or asked for.
    constants : mapping of names to numbers, optional
        Names usable in the formula.
    fields : pairs, optional
        The keys of the system file that made it, for saving, where those are not the formula's.
    """

    signal: Expression
    bound: float | None = None
    declared: tuple[float, ...] | None = None
    constants: tuple[tuple[str, Expression], ...] = ()
    fields: tuple[tuple[str, Any], ...] = ()

    def __post_init__(self) -> None:
        key, names = "reference.constants", list[str]()
        pairs = checks.name_value_pairs(key, self.constants)
        for name, _ in pairs:
            names.append(check_name(f"{key}.{name}", name))
        constants = tuple((name, number(f"{key}.{name}", value)) for name, value in pairs)
        signal = parse("reference.signal", self.signal, ["t", *names])
        if signal.expr.has(*JUMPING):
            raise InputError(
                "reference.signal",
                "must be continuous, but sign and atan2 may jump",
                signal.text,
                'Use kind = "steps" with a slope limit, or kind = "samples"',
            )
        set_fields(self, constants=constants, signal=signal)
        try:
            self.smoothness  # noqa: B018 - proves that there is no jump
        except Undefined as problem:
            what = f"may jump, or is not finite: {problem}"
            raise InputError("reference.signal", what, signal.text, NO_JUMPS) from None
        if self.bound is not None:
            set_fields(self, bound=checks.real("reference.bound", self.bound, above=0))
        if self.declared is not None:
            declared = checks.reals(
                "reference.bounds", self.declared, None, "Y_0, Y_1, ...", least=0
            )
            set_fields(self, declared=declared)
        self._refuse_contradictions()

    def _refuse_contradictions(self) -> None:
        """A declared bound that one sample breaks is wrong; this is a check, never a proof."""
        highest = max(1 if self.bound is not None else 0, len(self.declared or ()) - 1)
        highest = int(min(highest, self.order))
        if self.declared is None and self.bound is None:
            return
        values = np.abs(self.values(CHECK_TIMES, highest))
        values[~np.isfinite(values)] = 0.0  # beyond floats, so no sample
        for i, limit in enumerate((self.declared or ())[: highest + 1]):
            self._refuse_above(f"reference.bounds[{i}]", f"|y_d^({i})|", values[i], limit)
        if self.declared is not None and len(self.declared) > highest + 1:
            self._refuse_steep(highest, self.declared[highest + 1])
        if self.bound is not None and self.order >= 1:
            total = values[0] + values[1]
            self._refuse_above("reference.bound", "|y_d| + |y_d'|", total, self.bound)

    def _refuse_steep(self, order: int, limit: float) -> None:
        """A declared bound of the slope of y_d^(order), the last derivative, between its jumps."""
        values = self.values(CHECK_TIMES, order)[order]
        known = [time for time, _ in self.smoothness.jumps(order) or ()]
        with np.errstate(all="ignore"):
            size = np.maximum(np.abs(values[:-1]), np.abs(values[1:]))
            slopes = (np.abs(np.diff(values)) - CHECK_TOLERANCE * size) / np.diff(CHECK_TIMES)
        slopes[~np.isfinite(slopes)] = 0.0
        for beside in (-2, -1, 0):  # a jump may be at a time of the check, but for rounding
            places = np.searchsorted(CHECK_TIMES, known) + beside
            slopes[np.clip(places, 0, len(slopes) - 1)] = 0.0
        what = f"the slope of y_d^({order})" + (" between its jumps" if known else "")
        self._refuse_above(f"reference.bounds[{order + 1}]", what, slopes, limit)

    def _refuse_above(self, key: str, what: str, values: np.ndarray, limit: float) -> None:
        worst = int(np.argmax(values))
        if values[worst] > limit * (1 + CHECK_TOLERANCE):
            raise InputError(
                key,
                f"must bound {what}, which is {values[worst]:.6g} at t = {CHECK_TIMES[worst]:g}",
            )

    @property
    def declared_bound(self) -> float | None:
        return self.bound

    def check_finite(self, order: int, duration: float) -> None:
        """Refuse a formula that floats cannot evaluate during the run."""
        if ("finite", order, duration) in self._cache:
            return
        times = np.linspace(0.0, duration, CHECKED_IN_RUN)
        finite = np.isfinite(self.values(times, int(min(order, self.order)))).all(axis=0)
        if not finite.all():
            at = times[int(np.argmin(finite))]
            what = f"is not finite in floating point at t = {at:g}, which the run reaches"
            remedy = "Write it in another way, or shorten simulation.duration"
            raise InputError("reference.signal", what, self.signal.text, remedy)
        self._cache["finite", order, duration] = True

    @property
    def smoothness(self) -> Smoothness:
        """What is proven of the formula."""
        return smoothness(self.numeric)

    @property
    def order(self) -> float:
        """Infinite for analytic formulas; where there are kinks, the derivative that jumps."""
        return self.smoothness.order

    @property
    def piece_symbols(self) -> tuple[sympy.Symbol, ...]:
        return ()

    def piece_values(self, t: float) -> np.ndarray:
        return np.empty(0)

    def breaks(self, start: float, end: float) -> np.ndarray:
        return np.empty(0)

    @property
    def parameter_symbols(self) -> tuple[sympy.Symbol, ...]:
        return tuple(symbol(f"ref_{name}") for name, _ in self.constants)

    @property
    def parameter_values(self) -> tuple[float, ...]:
        return tuple(float(value.expr) for _, value in self.constants)

    def formulas(self, order: int) -> tuple[sympy.Expr, ...]:
        names = {symbol(name): symbol(f"ref_{name}") for name, _ in self.constants}
        return self._derivatives(_from_zero_on(self.signal.expr.xreplace(names)), order)

    def _derivatives(self, signal: sympy.Expr, order: int) -> tuple[sympy.Expr, ...]:
        formulas = [signal]
        for _ in range(order):
            formulas.append(derivative(formulas[-1], TIME))
        return tuple(formulas)

    def _numeric(self, order: int) -> tuple[sympy.Expr, ...]:
        """y_d ... y_d^(order) with the values of the constants."""
        known: list[sympy.Expr] = self._cache.setdefault("numeric", [self.numeric])
        while len(known) <= order:
            known.append(derivative(known[-1], TIME))
        return tuple(known[: order + 1])

    @cached_property
    def numeric(self) -> sympy.Expr:
        """The signal with the exact values of the constants."""
        values = {symbol(k): value.expr for k, value in self.constants}
        return _from_zero_on(put_in(self.signal.expr, values))

    def values(self, t: np.ndarray, order: int) -> np.ndarray:
        key = ("values", order)
        if key not in self._cache:
            self._cache[key] = numpy_callable([TIME], self._numeric(order))
        with np.errstate(all="ignore"):
            return rows(self._cache[key](np.asarray(t, dtype=float)), len(t))

    @cached_property
    def _cache(self) -> dict[Any, Any]:
        return {}

    def bounds(self, order: int) -> Bounds:
        require_order(self, order, "the bound asked for")
        pairs = [self.bound_of(i) for i in range(order + 1)]
        return Bounds(tuple(value for value, _ in pairs), tuple(origin for _, origin in pairs))

    def bound_of(self, i: int) -> tuple[float, str]:
        """Y_i alone, and where it comes from."""
        require_order(self, i, "the bound asked for")
        if self.declared is not None and i < len(self.declared):
            return stated_above(self.declared[i]), "declared"
        if i not in self._bounds:
            waves = is_sum_of_sinusoids(self.numeric)
            wave = sinusoid_supremum(self._numeric(i)[i]) if waves else None
            self._bounds[i] = wave or (self.smoothness.bound(i), False)
        bound, exact = self._bounds[i]
        if bound is None:
            raise InputError(
                "reference.bounds",
                f"the bound Y_{i} of |y_d^({i})| could not be proven for this formula",
                self.signal.text,
                f"State it: bounds = [{'Y_0' if i == 0 else f'Y_0, ..., Y_{i}'}]",
            )
        return bound, "exact" if exact else "proven"

    def lipschitz_bound(self, order: int, *, between_jumps: bool = False) -> float | None:
        """That of y_d^(order); see :func:`certrack.references.lipschitz_bound`.

        Where y_d^(order) has kinks whose places are unknown, it is Y_{order+1} if that is stated.
        """
        if order > self.order:
            return None
        if order < self.order:
            try:
                return self.bound_of(order + 1)[0]
            except InputError:
                return None
        known = self.smoothness.jumps(order)
        if known and not between_jumps:
            return None
        if self.declared is not None and order + 1 < len(self.declared):
            return stated_above(self.declared[order + 1])
        return None if known is None else self.smoothness.bound(order + 1)

    def jumps(self, order: int) -> tuple[float, float] | None:
        """Those of y_d^(order); see :func:`certrack.references.jumps`."""
        known = self.smoothness.jumps(order) if order == self.order else None
        if not known:
            return None
        times = [time for time, _ in known]
        gaps = [math.nextafter(b - a - math.ulp(b), 0.0) for a, b in pairwise(times)]
        return max(size for _, size in known), min(gaps, default=math.inf)

    @cached_property
    def _bounds(self) -> dict[int, tuple[float | None, bool]]:
        return {}


def _from_zero_on(formula: sympy.Expr) -> sympy.Expr:
    """The formula for t >= 0, where |t| is t: the derivatives at 0 are those from the right."""
    if not formula.has(sympy.Abs, sympy.sign, sympy.Min, sympy.Max):
        return formula
    later = sympy.Dummy("t", positive=True)
    return formula.xreplace({TIME: later}).xreplace({later: TIME})

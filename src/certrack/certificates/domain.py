"""Is a formula defined for every state (and every t >= 0)?

A certificate speaks of all states, so drift, regressor and disturbance must have a value at each.
Every part that may have none gives a condition: log(g) needs g > 0, a root g >= 0, a quotient
g != 0, asin and acos |g| <= 1, tan cos(g) != 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import sympy

from certrack.certificates.majorants import interval_ends, whole_space
from certrack.certificates.sampling import Points, nearest_failure
from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows

#: Bisections between two points of different sign; what is left of a jump is no zero, relative to
#: the largest value found.
ZERO_BISECTIONS, ZERO_SIZE = 100, 1e-12

#: What a condition asks of its g.
POSITIVE, NONNEGATIVE, NONZERO = "positive", "not negative", "not zero"


@dataclass(frozen=True)
class Condition:
    """One part of a formula that has a value only under a condition.

    Attributes
    ----------
    part : sympy.Expr
        E.g. log(x1).
    inside : sympy.Expr
        What must be positive, not negative, or not zero.
    must_be : str
    """

    part: sympy.Expr
    inside: sympy.Expr
    must_be: str

    def __str__(self) -> str:
        return f"{self.inside} must be {self.must_be} in {self.part}"

    def proven(
        self, states: Sequence[sympy.Symbol], region: Sequence[Fraction] | None = None
    ) -> bool:
        """Whether intervals prove it for all states, or |x_i| <= region_i, and t >= 0."""
        low, high = interval_ends(self.inside, whole_space(states, region))
        if self.must_be == NONNEGATIVE:
            return low >= 0
        return low > 0 or (self.must_be == NONZERO and high < 0)

    def failure(self, states: Sequence[sympy.Symbol], points: Points) -> Points | None:
        """The point of the smallest ||x|| found where it fails; None if none was found."""
        function = numpy_callable([TIME, states], [self.inside])

        def value(where: Points) -> np.ndarray:
            with np.errstate(all="ignore"):
                return rows(function(where.t, where.x), len(where.t))[0]

        def fails(where: Points) -> np.ndarray:
            g = value(where)
            if self.must_be == POSITIVE:
                return g <= 0
            return g < 0 if self.must_be == NONNEGATIVE else g == 0

        failing = nearest_failure(points, fails)
        if failing is not None:
            return failing if self._confirmed(states, failing) else None
        return _zero_between(points, value) if self.must_be == NONZERO else None

    def _confirmed(self, states: Sequence[sympy.Symbol], where: Points) -> bool:
        """Whether more digits than a float's say the same: exp(-1e4) is not zero."""
        g = more_digits(self.inside, states, where)
        if not g.is_real:
            return False
        return bool(
            g < 0 if self.must_be == NONNEGATIVE else g == 0 or (self.must_be == POSITIVE and g < 0)
        )


def more_digits(formula: sympy.Expr, states: Sequence[sympy.Symbol], where: Points) -> sympy.Expr:
    """The formula at a point, with 30 digits and exponents of any size."""
    place = {TIME: sympy.Rational(float(where.t[0]))}
    place |= {s: sympy.Rational(float(v)) for s, v in zip(states, where.x[:, 0], strict=True)}
    return sympy.N(formula.xreplace(place), 30)


def _zero_between(points: Points, value: Callable[[Points], np.ndarray]) -> Points | None:
    """Where a continuous g passes zero between a point where it is positive and a negative one."""
    g = value(points)
    signs = [np.flatnonzero(g > 0), np.flatnonzero(g < 0)]
    if not all(map(len, signs)):
        return None
    a, b = (points[int(s[np.argmin(points.norm[s])])] for s in signs)
    for _ in range(ZERO_BISECTIONS):
        middle = Points((a.t + b.t) / 2, (a.x + b.x) / 2)
        g_middle = float(value(middle)[0])
        if not np.isfinite(g_middle) or g_middle == 0:
            return middle
        a, b = (middle, b) if g_middle > 0 else (a, middle)
    near = max(abs(float(value(a)[0])), abs(float(value(b)[0])))
    return a if near < ZERO_SIZE * float(np.abs(g[np.isfinite(g)]).max()) else None  # no jump


def conditions(formula: sympy.Expr) -> list[Condition]:
    """What must hold for the formula to have a value, the innermost parts first."""
    return list(dict.fromkeys(_conditions(formula)))


def _conditions(f: sympy.Expr) -> Iterator[Condition]:
    for arg in f.args:
        yield from _conditions(arg)
    if not f.free_symbols:
        return
    if isinstance(f, sympy.log):
        yield Condition(f, f.args[0], POSITIVE)
    elif isinstance(f, (sympy.asin, sympy.acos)):
        yield Condition(f, 1 - sympy.Abs(f.args[0]), NONNEGATIVE)
    elif isinstance(f, sympy.tan):
        yield Condition(f, sympy.cos(f.args[0]), NONZERO)
    elif isinstance(f, sympy.Pow):
        base, exponent = f.args
        if exponent.is_Integer:
            if exponent < 0:
                yield Condition(f, base, NONZERO)
        else:
            yield Condition(f, base, NONNEGATIVE if exponent > 0 else POSITIVE)


def always_defined(
    formula: sympy.Expr,
    states: Sequence[sympy.Symbol],
    region: Sequence[Fraction] | None = None,
) -> bool:
    """Whether intervals prove a value for all states, or |x_i| <= region_i, and t >= 0."""
    return all(condition.proven(states, region) for condition in conditions(formula))


def undefined_at(
    formula: sympy.Expr, states: Sequence[sympy.Symbol], points: Points
) -> tuple[Condition, Points] | None:
    """The first condition that fails at a point, and where; None if no failure was found."""
    for condition in conditions(formula):
        if not condition.proven(states):
            where = condition.failure(states, points)
            if where is not None:
                return condition, where
    return None

"""How often a formula of t can be differentiated, and the stretches between its kinks.

Kinks of abs, min and max of something linear in t lie at known times. Between two of them the
formula is analytic, and at each both sides say, exactly, from which derivative on they differ: so a
move made of min, max and powers has the order that it was made for. Other kinks leave one
derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import sympy
from flint import arb, fmpq, fmpq_poly

from certrack.core.expressions import TIME
from certrack.core.kinks import without_minmax
from certrack.core.powers import put_in
from certrack.references.extremes import largest_derivative
from certrack.references.growth import Undefined
from certrack.references.search import Formula, derivative_bound, float_above_ball, prove_defined
from certrack.references.taylor import constant

#: More stretches than this are not told apart.
MAX_STRETCHES = 64

#: Derivatives that are compared at a kink; no law asks for more.
MAX_COMPARED = 52


@dataclass(frozen=True)
class Stretch:
    """A formula without kinks between two times; its end may be infinite.

    Attributes
    ----------
    begin, end : numbers
        Exact.
    formula : formula of t
    """

    begin: sympy.Expr
    end: sympy.Expr
    formula: sympy.Expr

    def bound(self, i: int) -> float | None:
        """Upper bound of |f^(i)|; None where none was found."""
        ends = (self.begin, self.end)
        if self.formula.is_polynomial(TIME) and all(end.is_Rational for end in ends):
            poly = sympy.Poly(self.formula, TIME)
            if all(factor.is_Rational for factor in poly.coeffs()):
                return _of_polynomial(poly, i, *map(constant, ends))
        return derivative_bound(self.bounded(), i)

    def bounded(self) -> Formula:
        """The formula with its times rounded outward."""
        begin = max(0.0, -_above(-self.begin))
        end = math.inf if self.end is sympy.oo else _above(self.end)
        return Formula(self.formula, begin, end)


@dataclass(frozen=True)
class Smoothness:
    """What is proven of a formula for t >= 0: it is continuous, and more.

    Attributes
    ----------
    order : float
        Derivatives up to it exist piecewise, those below it are continuous; infinite if analytic.
    stretches : tuple of Stretch
    """

    order: float
    stretches: tuple[Stretch, ...]

    def jumps(self, i: int) -> tuple[tuple[float, float], ...] | None:
        """Where f^(i) jumps, i being the order: times and sizes, both as the next float above.

        None where the kinks could not be located.
        """
        if len(self.stretches) == 1:
            return None
        places = []
        for left, right in pairwise(self.stretches):
            gap = put_in((left.formula - right.formula).diff(TIME, i), {TIME: right.begin})
            if not sympy.expand(gap).is_zero:
                size = float_above_ball(abs(arb(constant(gap))).upper())
                places.append((_above(right.begin), size))
        return tuple(places)

    def bound(self, i: int) -> float | None:
        """Upper bound of |f^(i)| between the kinks, t >= 0; None where none was found.

        Up to the order it is that of f^(i) over all t >= 0.
        """
        largest = 0.0
        for stretch in self.stretches:
            bound = stretch.bound(i)
            if bound is None:
                return None
            largest = max(largest, bound)
        return largest


@lru_cache(maxsize=256)
def smoothness(expr: sympy.Expr) -> Smoothness:
    """Prove that a formula of t is continuous for t >= 0, and find its order.

    Parameters
    ----------
    expr : formula of t, without other symbols

    Raises
    ------
    Undefined
        Where it may have no value, or jump.
    """
    entire = (Stretch(sympy.S.Zero, sympy.oo, expr),)
    # on the formula as it is: (t - 1)/|t - 1| is a constant on both sides of its jump
    prove_defined(entire[0].bounded(), smooth=False)
    kinks = expr.has(sympy.Abs, sympy.Min, sympy.Max)
    stretches = _cut(Stretch(sympy.S.Zero, sympy.oo, without_minmax(expr))) if kinks else entire
    try:
        for stretch in stretches or entire:
            prove_defined(stretch.bounded(), smooth=True)
    except Undefined:
        return Smoothness(1.0, entire)
    if stretches is None:
        return Smoothness(1.0, entire)
    return Smoothness(_order(stretches), stretches)


def _cut(stretch: Stretch) -> tuple[Stretch, ...] | None:
    """The stretch, cut where its kinks are; None where they could not be located."""
    done: list[Stretch] = []
    waiting = [stretch]
    while waiting:
        current = waiting.pop()
        inner = _innermost(current.formula)
        if inner is None:
            done.append(_simpler(current))
        elif len(done) + len(waiting) >= MAX_STRETCHES or not _is_linear(inner.args[0]):
            return None
        else:
            waiting += reversed(_without(inner, current))
    joined = [done[0]]
    for following in done[1:]:
        last = joined[-1]
        if _same(following.formula, last.formula):
            joined[-1] = Stretch(last.begin, following.end, last.formula)
        else:
            joined.append(following)
    return tuple(joined)


def _same(a: sympy.Expr, b: sympy.Expr) -> bool:
    polynomials = a.is_polynomial(TIME) and b.is_polynomial(TIME)
    return bool(a == b or (polynomials and sympy.expand(a - b) == 0))


def _innermost(formula: sympy.Expr) -> sympy.Expr | None:
    kinks = [part for part in formula.atoms(sympy.Abs) if part.has(TIME)]
    plain = [part for part in kinks if not any(a.has(TIME) for a in part.args[0].atoms(sympy.Abs))]
    return min(plain, key=sympy.default_sort_key, default=None)


def _is_linear(arg: sympy.Expr) -> bool:
    return bool(arg.is_polynomial(TIME)) and sympy.Poly(arg, TIME).degree() == 1


def _without(kink: sympy.Expr, stretch: Stretch) -> list[Stretch]:
    """One stretch, or two, in which the argument of the kink has one sign."""
    arg = kink.args[0]
    slope, offset = sympy.Poly(arg, TIME).all_coeffs()
    at = -offset / slope
    before, after = (
        stretch.formula.xreplace({kink: sign * arg})
        for sign in ((-1, 1) if slope.is_positive else (1, -1))
    )
    if not bool(at > stretch.begin):
        return [Stretch(stretch.begin, stretch.end, after)]
    if not bool(at < stretch.end):
        return [Stretch(stretch.begin, stretch.end, before)]
    return [Stretch(stretch.begin, at, before), Stretch(at, stretch.end, after)]


def _simpler(stretch: Stretch) -> Stretch:
    """Polynomials in powers of the time since the beginning, whose terms do not cancel."""
    if not stretch.formula.is_polynomial(TIME):
        return stretch
    since = sympy.Poly(stretch.formula, TIME).compose(sympy.Poly(TIME + stretch.begin, TIME))
    terms = (factor * (TIME - stretch.begin) ** k for (k,), factor in since.terms())
    return Stretch(stretch.begin, stretch.end, sympy.Add(*terms))


def _of_polynomial(poly: sympy.Poly, i: int, begin: fmpq, end: fmpq) -> float:
    """The largest |p^(i)| on [begin, end]."""
    p = fmpq_poly([constant(factor) for factor in reversed(poly.all_coeffs())])
    return largest_derivative(
        p(fmpq_poly([begin, 1])), i, end - begin
    )  # of the time since the beginning


def _order(stretches: tuple[Stretch, ...]) -> float:
    """The first derivative that jumps at a kink; infinite if none does."""
    order = math.inf
    for left, right in zip(stretches[:-1], stretches[1:], strict=True):
        before, after = left.formula, right.formula
        for i in range(MAX_COMPARED):
            gap = sympy.expand(put_in(before - after, {TIME: right.begin}))
            if not gap.is_zero:
                order = min(order, max(i, 1))  # y_d itself is continuous, which is proven
                break
            before, after = before.diff(TIME), after.diff(TIME)
            if before == after:
                break
        else:
            order = min(order, MAX_COMPARED)
    return float(order)


def _above(number: sympy.Expr) -> float:
    """The number as a float that is not below it."""
    return float_above_ball(arb(constant(number)).upper())

"""Proofs of |f(t, x)| <= b(|x_1|, ..., |x_n|, ||S x||) for all t >= 0, in a region or everywhere.

A majorant here is a polynomial of the sizes of the states and of ||x||, with coefficients >= 0,
that is never below |f|: sums and products of parts keep their sizes, other parts have the majorants
of :mod:`majorants`. It lies below b if what is left of b - majorant has no negative part. In a
region |x_i| <= R_i a part of higher degree is at most a linear one, and a linear one a number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, product
from typing import Any

import sympy

from certrack.certificates.arithmetic import as_sympy
from certrack.certificates.majorants import MAX_DEGREE, MAX_TRIED, majorants
from certrack.core.expressions import symbol
from certrack.core.monotone import NotMonotone, check_growth
from certrack.model.growth import NORM

#: Majorants of a formula that are kept.
MAX_MAJORANTS = 32

#: ||x|| without weights.
PLAIN_NORM = sympy.Dummy("norm", nonnegative=True)


@dataclass(frozen=True)
class Sizes:
    """What is known of the sizes.

    Attributes
    ----------
    states : symbols
    weights : n Fractions
        Diagonal of S.
    region : n Fractions, or None
        |x_i| is at most that; None for all states.
    norm : Fraction
        ||S x|| is at most that in the region.
    """

    states: tuple[sympy.Symbol, ...]
    weights: tuple[Fraction, ...]
    region: tuple[Fraction, ...] | None = None
    norm: Fraction = Fraction(0)

    @property
    def limits(self) -> Mapping[sympy.Symbol, Any]:
        """Largest sizes in the region, by symbol."""
        if self.region is None:
            return {}
        return dict(
            zip(
                (*self.states, symbol(NORM)),
                map(as_sympy, (*self.region, self.norm)),
                strict=True,
            )
        )


def stays_below(
    formula: sympy.Expr, bound: sympy.Expr, sizes: Sizes, strength: Fraction = Fraction(1)
) -> bool:
    """Whether it is proven that strength |formula| <= bound for all t >= 0 in the region.

    Parameters
    ----------
    formula : sympy.Expr
        Of t and the states.
    bound : sympy.Expr
        Of the sizes of the states, by their symbols, and of ``norm``; it grows with all of them.
    sizes : Sizes
    strength : Fraction
    """
    return any(
        _covers(bound, as_sympy(strength) * _weighted(candidate, sizes), sizes)
        for candidate in _majorants(formula, sizes.states)
    )


def _majorants(f: sympy.Expr, states: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """Majorants over the states' symbols and :data:`PLAIN_NORM`."""
    candidates: list[sympy.Expr] = []
    inside = f.args[0] if isinstance(f, sympy.Abs) else f
    if inside in states:
        candidates.append(inside)
    elif isinstance(f, (sympy.Add, sympy.Mul)):
        parts = [_majorants(part, states) for part in f.args]
        candidates += (
            sympy.expand(f.func(*chosen)) for chosen in islice(product(*parts), MAX_MAJORANTS)
        )
    elif isinstance(f, sympy.Pow) and f.exp.is_Integer and 0 < f.exp <= MAX_DEGREE:
        candidates += (sympy.expand(part**f.exp) for part in _majorants(f.base, states))
    for coefficients in majorants(f, states)[:MAX_TRIED]:
        candidates.append(
            sum((as_sympy(c) * PLAIN_NORM**i for i, c in enumerate(coefficients)), sympy.S.Zero)
        )
    return list(dict.fromkeys(candidates))[:MAX_MAJORANTS]


def _weighted(majorant: sympy.Expr, sizes: Sizes) -> sympy.Expr:
    """With ||S x|| and the sizes in the place of ||x||."""
    least = min(sizes.weights)
    plain = symbol(NORM) / as_sympy(least) if least else sum(sizes.states, sympy.S.Zero)
    return majorant.xreplace({PLAIN_NORM: plain})


def _covers(bound: sympy.Expr, majorant: sympy.Expr, sizes: Sizes) -> bool:
    left = sympy.expand(bound - majorant).as_coefficients_dict()
    names = (*sizes.states, symbol(NORM))
    for part, c in list(left.items()):
        if part.is_polynomial(*names) and not part.has(sympy.Function):
            continue
        try:  # parts of the bound itself, of which not all are >= 0
            check_growth(part, names)
        except NotMonotone:
            return False
        if c < 0:
            return False
    sequences: list[tuple[Any, ...]] = [(_to_norm,)]
    if sizes.region is not None:
        sequences += [(_to_parts,), (_to_number,), (_to_parts, _to_norm, _to_number)]
    for sequence in sequences:
        after = dict(left)
        for reduce in sequence:
            after = reduce(after, sizes)
        if all(c >= 0 for c in after.values()):
            return True
    return False


def _to_parts(left: Mapping[sympy.Expr, Any], sizes: Sizes) -> dict[sympy.Expr, Any]:
    """Negative parts as positive ones of lower degree that are there, as far as these go."""
    after: dict[sympy.Expr, Any] = dict(left)
    names = (*sizes.states, symbol(NORM))
    for part, c in left.items():
        for target in [p for p in left if p != 1 and after[p] > 0]:
            factor = part / target
            if c < 0 and factor.is_polynomial(*names):
                largest = factor.xreplace(dict(sizes.limits))
                moved = min(-after[part], after[target] / largest) if largest else -after[part]
                after[part] += moved
                after[target] -= moved * largest
    return after


def _to_norm(left: Mapping[sympy.Expr, Any], sizes: Sizes) -> dict[sympy.Expr, Any]:
    """Negative parts as parts of the norm: all factors but one at their largest."""
    after: dict[sympy.Expr, Any] = dict(left)
    limits, norm = sizes.limits, symbol(NORM)
    weights = dict(zip(sizes.states, sizes.weights, strict=True))
    for part, c in left.items():
        powers = part.as_powers_dict()
        chosen = next((s for s in powers if s == norm or weights.get(s)), None)
        if c >= 0 or chosen is None or (part / chosen != 1 and not limits):
            continue
        others = (part / chosen).xreplace(dict(limits))
        share = 1 if chosen == norm else 1 / as_sympy(weights[chosen])
        after[part] -= c
        after[norm] = after.get(norm, sympy.S.Zero) + c * others * share
    return after


def _to_number(left: Mapping[sympy.Expr, Any], sizes: Sizes) -> dict[sympy.Expr, Any]:
    """Negative parts at their largest."""
    after: dict[sympy.Expr, Any] = dict(left)
    for part, c in left.items():
        if c < 0:
            after[part] -= c
            after[sympy.S.One] = after.get(sympy.S.One, sympy.S.Zero) + c * part.xreplace(
                dict(sizes.limits)
            )
    return after

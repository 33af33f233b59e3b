"""Rates that jump where a state crosses a surface: sides, sliding, and the equivalent control.

Every sign(f) whose f contains a state makes the rates jump on the surface f = 0. With a symbol s_k
for sign(f_k) they are F(x, s), which an exact identity (s^2 = 1) makes linear in each s_k. Off the
surface s_k is the side, +1 or -1. Where the rates on both sides point towards it, the solution
slides along it (Filippov): F is the convex combination of both sides, which is F with an s_k
between -1 and 1, and it is the one that stays,

    0 = f_k' = d f_k/dt + grad f_k . F(x, s),       s_k = -drift_k/effect_k,

linear in s_k (the equivalent control). The solution leaves where s_k leaves [-1, 1].

All of it is one set of smooth formulas with two parameters per surface, its *mode*: the side, and
whether it is stuck (0 or 1). Whoever integrates them watches f_k or s_k and changes the mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import sympy

from certrack.core.expressions import TIME
from certrack.core.kinks import derivative


@dataclass(frozen=True)
class Switching:
    """The rates of a system with switching surfaces, as formulas of its modes.

    Attributes
    ----------
    states : symbols
    surfaces : formulas f_k
        In the states, time and parameters.
    sides, stuck : symbols
        The mode: on which side of each surface the state is, and whether it slides along it.
    rates : formulas, one per state
        Smooth in the states while the modes are constant.
    values : formulas
        What stands for sign(f_k): the side, or the equivalent control.
    gradients : formulas
        Of every surface by every state, row-major.
    drifts, effects : formulas
        f_k' = drift_k + effect_k s_k, the other s_j being as they are.
    crossed : formulas
        What s of the partner adds to f_k', per unit; 0 without a partner.
    partners : numbers, or None
        The one other surface that may be slid along at the same time although both interact.
    bound : frozensets of two numbers
        Surfaces that interact.
    """

    states: tuple[sympy.Symbol, ...]
    surfaces: tuple[sympy.Expr, ...]
    sides: tuple[sympy.Symbol, ...]
    stuck: tuple[sympy.Symbol, ...]
    rates: tuple[sympy.Expr, ...]
    values: tuple[sympy.Expr, ...]
    gradients: tuple[sympy.Expr, ...]
    drifts: tuple[sympy.Expr, ...]
    effects: tuple[sympy.Expr, ...]
    crossed: tuple[sympy.Expr, ...]
    partners: tuple[int | None, ...]
    bound: frozenset[frozenset[int]]

    @property
    def modes(self) -> tuple[sympy.Symbol, ...]:
        """Sides, then what is stuck."""
        return (*self.sides, *self.stuck)

    def resolved(self, formulas: Sequence[sympy.Expr]) -> tuple[sympy.Expr, ...]:
        """Other formulas, such as the input, with their sign(f_k) replaced by :attr:`values`."""
        signs = _Signs(self.states, self.surfaces)
        written = [signs.written(formula) for formula in formulas]
        known = dict(zip(signs.symbols, self.values, strict=True))
        return tuple(formula.xreplace(known) for formula in written)


def switching(
    rates: Sequence[sympy.Expr],
    states: Sequence[sympy.Symbol],
    *,
    smooth_rates: int = 0,
) -> Switching | None:
    """The rates with modes; None where no sign of a state occurs in them.

    Parameters
    ----------
    rates : formulas
    states : symbols
    smooth_rates : int
        The last so many rates are integrals along the solution; no surface contains their states.
        They are evaluated at the equivalent control, as the signals that they integrate are.

    Returns
    -------
    Switching or None
    """
    if not any(rate.has(sympy.sign) for rate in rates):
        return None
    signs = _Signs(states)
    written = [signs.written(rate) for rate in rates]
    surfaces, s = signs.surfaces, signs.symbols
    if not surfaces:
        return None
    moving = len(rates) - smooth_rates
    flow = [_linear(rate, s) for rate in written[:moving]]
    gradients = [[derivative(f, x) for x in states] for f in surfaces]
    normal = [
        derivative(f, TIME) + sympy.Add(*(g * rate for g, rate in zip(row, flow, strict=False)))
        for f, row in zip(surfaces, gradients, strict=True)
    ]
    slopes = [[sympy.diff(speed, name) for name in s] for speed in normal]
    count = len(s)
    bound = frozenset(
        frozenset((i, j))
        for i, j in combinations(range(count), 2)
        if slopes[i][j] != 0 or slopes[j][i] != 0 or surfaces[i].has(s[j]) or surfaces[j].has(s[i])
    )
    partners = tuple(_partner(k, bound, surfaces, slopes, s) for k in range(count))
    sides = tuple(sympy.Symbol(f"mode_side_{k}", real=True) for k in range(count))
    stuck = tuple(sympy.Symbol(f"mode_stuck_{k}", real=True) for k in range(count))
    on_sides = dict(zip(s, sides, strict=True))
    values = []
    for k, partner in enumerate(partners):
        if partner is None:
            drift = normal[k].xreplace({s[k]: sympy.S.Zero}).xreplace(on_sides)
            effect = slopes[k][k].xreplace(on_sides)
            values.append(
                (1 - stuck[k]) * sides[k] - stuck[k] * drift / (stuck[k] * effect + 1 - stuck[k])
            )
        else:
            values.append(_of_pair(k, partner, normal, slopes, s, sides, stuck))
    known = dict(zip(s, values, strict=True))
    others = [{name: value for name, value in known.items() if name != s[k]} for k in range(count)]
    return Switching(
        states=tuple(states),
        surfaces=tuple(f.xreplace(known) for f in surfaces),
        sides=sides,
        stuck=stuck,
        rates=tuple(
            _at_rest(x, surfaces, stuck) * rate.xreplace(known)
            for x, rate in zip(states, [*flow, *written[moving:]], strict=True)
        ),
        values=tuple(values),
        gradients=tuple(g.xreplace(known) for row in gradients for g in row),
        drifts=tuple(
            normal[k].xreplace({s[k]: sympy.S.Zero}).xreplace(others[k]) for k in range(count)
        ),
        effects=tuple(slopes[k][k].xreplace(others[k]) for k in range(count)),
        crossed=tuple(
            sympy.S.Zero if partner is None else slopes[k][partner]
            for k, partner in enumerate(partners)
        ),
        partners=partners,
        bound=bound,
    )


class _Signs:
    """The signs that have been met, a symbol each; sign(f) and sign(-c f) are one surface."""

    def __init__(self, states: Sequence[sympy.Symbol], known: Sequence[sympy.Expr] = ()) -> None:
        self.surfaces: list[sympy.Expr] = list(known)
        self._states = frozenset(states)

    @property
    def symbols(self) -> list[sympy.Symbol]:
        """A symbol for the sign of each surface."""
        return [sympy.Symbol(f"mode_sign_{k}", real=True) for k in range(len(self.surfaces))]

    def written(self, expr: sympy.Expr) -> sympy.Expr:
        """The formula with symbols for the signs."""
        if not expr.has(sympy.sign):
            return expr
        args = [self.written(arg) for arg in expr.args]
        return self._sign(args[0]) if isinstance(expr, sympy.sign) else expr.func(*args)

    def _sign(self, inside: sympy.Expr) -> sympy.Expr:
        if not inside.free_symbols & self._states:
            return sympy.sign(inside)  # of time or parameters alone: no surface
        factor, f = inside.as_independent(*self._states, TIME, as_Add=False)
        if f.could_extract_minus_sign():
            factor, f = -factor, -f
        if f not in self.surfaces:
            self.surfaces.append(f)
        return sympy.sign(factor) * self.symbols[self.surfaces.index(f)]


def _linear(rate: sympy.Expr, s: Sequence[sympy.Symbol]) -> sympy.Expr:
    """The rate as a formula that is linear in every s, whose square is 1."""
    for name in s:
        slope = sympy.diff(rate, name)
        if slope.has(name):
            up, down = (rate.xreplace({name: side}) for side in (sympy.S.One, sympy.S.NegativeOne))
            rate = (up + down) / 2 + name * (up - down) / 2
        elif slope != 0:
            rate = rate.xreplace({name: sympy.S.Zero}) + name * slope
    return rate


def _partner(
    k: int,
    bound: frozenset[frozenset[int]],
    surfaces: Sequence[sympy.Expr],
    slopes: Sequence[Sequence[sympy.Expr]],
    s: Sequence[sympy.Symbol],
) -> int | None:
    """The only surface that k interacts with, if it interacts with no other and linearly."""
    near = [pair for pair in bound if k in pair]
    if len(near) != 1:
        return None
    (other,) = near[0] - {k}
    if any(other in pair for pair in bound - {near[0]}):
        return None
    pair = {s[k], s[other]}
    if any(
        (surfaces[i].free_symbols | slopes[i][j].free_symbols) & pair
        for i in near[0]
        for j in near[0]
    ):
        return None
    return other


def _of_pair(
    k: int,
    other: int,
    normal: Sequence[sympy.Expr],
    slopes: Sequence[Sequence[sympy.Expr]],
    s: Sequence[sympy.Symbol],
    sides: Sequence[sympy.Symbol],
    stuck: Sequence[sympy.Symbol],
) -> sympy.Expr:
    """Value of s_k where each of two either has its side or keeps the state on its surface."""
    nothing = {s[k]: sympy.S.Zero, s[other]: sympy.S.Zero}

    def row(i: int, j: int) -> tuple[sympy.Expr, sympy.Expr, sympy.Expr]:
        """Of both equations m_i (drift + effect s_i + cross s_j) + (1 - m_i)(s_i - side) = 0."""
        m = stuck[i]
        right = (1 - m) * sides[i] - m * normal[i].xreplace(nothing)
        return m * slopes[i][i] + 1 - m, m * slopes[i][j], right

    a, b, p = row(k, other)
    d, c, q = row(other, k)
    return (p * d - b * q) / (a * d - b * c)


def _at_rest(
    x: sympy.Symbol, surfaces: Sequence[sympy.Expr], stuck: Sequence[sympy.Symbol]
) -> sympy.Expr:
    """0 for a state that is itself a surface while the solution slides there: exactly at rest."""
    return sympy.Mul(*(1 - m for f, m in zip(surfaces, stuck, strict=True) if f == x))

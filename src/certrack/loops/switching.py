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
    if not signs.surfaces:
        return None
    moving = len(rates) - smooth_rates
    flow = [_linear(rate, signs.symbols) for rate in written[:moving]]
    crossings = _crossings(signs, states, flow)
    bound = crossings.interactions
    partners = tuple(crossings.partner(k, bound) for k in range(crossings.count))
    values = tuple(crossings.value(k, partner) for k, partner in enumerate(partners))
    known = dict(zip(crossings.s, values, strict=True))
    others = [{s: value for s, value in known.items() if s != s_k} for s_k in crossings.s]
    return Switching(
        states=tuple(states),
        surfaces=tuple(f.xreplace(known) for f in crossings.surfaces),
        sides=crossings.sides,
        stuck=crossings.stuck,
        rates=tuple(
            _at_rest(x, crossings.surfaces, crossings.stuck) * rate.xreplace(known)
            for x, rate in zip(states, [*flow, *written[moving:]], strict=True)
        ),
        values=values,
        gradients=tuple(g.xreplace(known) for row in crossings.gradients for g in row),
        drifts=tuple(crossings.drift(k).xreplace(others[k]) for k in range(crossings.count)),
        effects=tuple(crossings.slopes[k][k].xreplace(others[k]) for k in range(crossings.count)),
        crossed=tuple(
            sympy.S.Zero if partner is None else crossings.slopes[k][partner]
            for k, partner in enumerate(partners)
        ),
        partners=partners,
        bound=bound,
    )


@dataclass(frozen=True)
class _Crossings:
    """How fast a solution crosses each surface f_k, as a formula of all signs s.

    Attributes
    ----------
    s : symbols
        One for the sign of each surface.
    surfaces : formulas f_k
    gradients : rows of formulas
        Of each surface by the states.
    speeds : formulas
        f_k', linear in every s.
    slopes : rows of formulas
        Of each speed by every s.
    sides, stuck : symbols
        The mode, as in :class:`Switching`.
    """

    s: Sequence[sympy.Symbol]
    surfaces: Sequence[sympy.Expr]
    gradients: Sequence[Sequence[sympy.Expr]]
    speeds: Sequence[sympy.Expr]
    slopes: Sequence[Sequence[sympy.Expr]]
    sides: tuple[sympy.Symbol, ...]
    stuck: tuple[sympy.Symbol, ...]

    @property
    def count(self) -> int:
        """Number of surfaces."""
        return len(self.s)

    def drift(self, k: int) -> sympy.Expr:
        """f_k' at s_k = 0."""
        return self.speeds[k].xreplace({self.s[k]: sympy.S.Zero})

    @property
    def interactions(self) -> frozenset[frozenset[int]]:
        """The pairs of surfaces of which one's sign acts on the other, or stands in it."""
        s, surfaces, slopes = self.s, self.surfaces, self.slopes
        return frozenset(
            frozenset((i, j))
            for i, j in combinations(range(self.count), 2)
            if slopes[i][j] != 0
            or slopes[j][i] != 0
            or surfaces[i].has(s[j])
            or surfaces[j].has(s[i])
        )

    def partner(self, k: int, bound: frozenset[frozenset[int]]) -> int | None:
        """The only surface that k interacts with, if it interacts with no other and linearly."""
        near = [pair for pair in bound if k in pair]
        if len(near) != 1:
            return None
        (other,) = near[0] - {k}
        if any(other in pair for pair in bound - {near[0]}):
            return None
        pair = {self.s[k], self.s[other]}
        if any(
            (self.surfaces[i].free_symbols | self.slopes[i][j].free_symbols) & pair
            for i in near[0]
            for j in near[0]
        ):
            return None
        return other

    def value(self, k: int, partner: int | None) -> sympy.Expr:
        """What stands for s_k: the side, or where the state slides the equivalent control."""
        if partner is not None:
            return self._value_of_pair(k, partner)
        on_sides = dict(zip(self.s, self.sides, strict=True))
        m, drift = self.stuck[k], self.drift(k).xreplace(on_sides)
        effect = self.slopes[k][k].xreplace(on_sides)
        return (1 - m) * self.sides[k] - m * drift / (m * effect + 1 - m)

    def _value_of_pair(self, k: int, other: int) -> sympy.Expr:
        """s_k where each of two either has its side or keeps the state on its surface."""
        nothing = {self.s[k]: sympy.S.Zero, self.s[other]: sympy.S.Zero}

        def row(i: int, j: int) -> tuple[sympy.Expr, sympy.Expr, sympy.Expr]:
            """Of m_i (drift + effect s_i + cross s_j) + (1 - m_i)(s_i - side) = 0."""
            m = self.stuck[i]
            right = (1 - m) * self.sides[i] - m * self.speeds[i].xreplace(nothing)
            return m * self.slopes[i][i] + 1 - m, m * self.slopes[i][j], right

        a, b, p = row(k, other)
        d, c, q = row(other, k)
        return (p * d - b * q) / (a * d - b * c)


def _crossings(
    signs: _Signs, states: Sequence[sympy.Symbol], flow: Sequence[sympy.Expr]
) -> _Crossings:
    """Of the surfaces that were met, along the rates of the first states."""
    s, surfaces = signs.symbols, signs.surfaces
    gradients = [[derivative(f, x) for x in states] for f in surfaces]
    speeds = [
        derivative(f, TIME) + sympy.Add(*(g * rate for g, rate in zip(row, flow, strict=False)))
        for f, row in zip(surfaces, gradients, strict=True)
    ]
    return _Crossings(
        s=s,
        surfaces=surfaces,
        gradients=gradients,
        speeds=speeds,
        slopes=[[sympy.diff(speed, name) for name in s] for speed in speeds],
        sides=tuple(sympy.Symbol(f"mode_side_{k}", real=True) for k in range(len(s))),
        stuck=tuple(sympy.Symbol(f"mode_stuck_{k}", real=True) for k in range(len(s))),
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


def _at_rest(
    x: sympy.Symbol, surfaces: Sequence[sympy.Expr], stuck: Sequence[sympy.Symbol]
) -> sympy.Expr:
    """0 for a state that is itself a surface while the solution slides there: exactly at rest."""
    return sympy.Mul(*(1 - m for f, m in zip(surfaces, stuck, strict=True) if f == x))

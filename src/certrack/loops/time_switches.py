"""Switches of time: abs, sign, min and max of formulas of t alone, taken out of a loop's formulas.

Every one of them becomes a symbol s, the sign of its function, which is constant between the times
at which the function changes sign: |f| = s f, and max(a, b) = a (1 + s)/2 + b (1 - s)/2 with the
sign s of a - b. These times are found before a run and are breaks of it
(:mod:`certrack.loops.schedule`), so no step of any integrator crosses one and none is missed.

What depends on the state, too, stays where it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy

from certrack.core.expressions import TIME
from certrack.core.kinks import derivative
from certrack.loops.continuous import ClosedLoop
from certrack.loops.sampled import SampledLoop

#: Functions with branch points, and where these are: at zeros of the formulas of the arguments.
_BRANCHES: dict[Any, Callable[..., tuple[sympy.Expr, ...]]] = {
    sympy.asin: lambda x: (x - 1, x + 1, derivative(x, TIME)),
    sympy.acos: lambda x: (x - 1, x + 1, derivative(x, TIME)),
    sympy.atan2: lambda y, _: (y,),
}

#: Functions that become switches.
_SWITCHING = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max)


@dataclass(frozen=True)
class TimeSwitches:
    """What of a loop's formulas depends on t and on numbers alone.

    Attributes
    ----------
    symbols : symbols
        One per switch.
    functions : formulas
        What each is the sign of, as it was written: with abs, sign, min and max.
    branches : formulas
        Changes of sign of these are breaks, too: of switches inside of switches, and branch points
        of roots, asin, acos and atan2.
    formulas : formulas
        Largest formulas of t alone, written by the switches; each has t in it.
    of_members : formulas
        Switches of t and of numbers that differ between members: left where they are.
    formulas_of_members : formulas
        Largest formulas of t, numbers and those that differ between members, with one of the last.
    """

    symbols: tuple[sympy.Symbol, ...] = ()
    functions: tuple[sympy.Expr, ...] = ()
    branches: tuple[sympy.Expr, ...] = ()
    formulas: tuple[sympy.Expr, ...] = ()
    of_members: tuple[sympy.Expr, ...] = ()
    formulas_of_members: tuple[sympy.Expr, ...] = ()

    @cached_property
    def numbers(self) -> frozenset[sympy.Symbol]:
        """Parameters that the switches and formulas depend on."""
        every = (*self.functions, *self.branches, *self.formulas)
        names = frozenset().union(*(formula.free_symbols for formula in every))
        return names - {TIME, *self.symbols}


def switched_loop(
    loop: ClosedLoop, numbers: Iterable[sympy.Symbol] | None = None
) -> tuple[ClosedLoop, TimeSwitches]:
    """The loop with switches of time as further symbols of its piece.

    Parameters
    ----------
    loop : ClosedLoop
    numbers : symbols, optional
        Parameters whose values are the same in all runs that share the switches; by default all
        but those of the reference's piece.
    """
    if numbers is None:
        numbers = loop.parameters[: len(loop.parameters) - loop.pieces]
    formulas, switches = take_switches([*loop.rates, loop.u, loop.e_1], numbers)
    *rates, u, e_1 = formulas
    changed = replace(
        loop,
        rates=tuple(rates),
        u=u,
        e_1=e_1,
        parameters=(*loop.parameters, *switches.symbols),
        pieces=loop.pieces + len(switches.symbols),
    )
    return changed, switches


def switched_sampled_loop(
    loop: SampledLoop,
    numbers: Iterable[sympy.Symbol] | None = None,
    varying: Iterable[sympy.Symbol] = (),
) -> tuple[SampledLoop, TimeSwitches]:
    """The same for a loop with a sampled controller.

    The controller looks at the time when it samples, not between: its formulas stay.
    """
    if numbers is None:
        numbers = loop.parameters
    plant = loop.plant
    formulas, switches = take_switches([*plant.rates, loop.e_1, loop.slope], numbers, varying)
    *rates, e_1, slope = formulas
    changed = replace(
        loop,
        plant=replace(plant, rates=tuple(rates)),
        e_1=e_1,
        slope=slope,
        pieces=(*loop.pieces, *switches.symbols),
    )
    return changed, switches


def take_switches(
    formulas: Sequence[sympy.Expr],
    numbers: Iterable[sympy.Symbol],
    varying: Iterable[sympy.Symbol] = (),
) -> tuple[list[sympy.Expr], TimeSwitches]:
    """Replace switches of t and `numbers` by symbols.

    Parameters
    ----------
    formulas : sequence of sympy.Expr
    numbers : symbols
    varying : symbols
        Numbers that differ between members.

    Returns
    -------
    formulas : list
    switches : TimeSwitches
    """
    if not any(formula.has(TIME) or formula.has(*_SWITCHING) for formula in formulas):
        return list(formulas), TimeSwitches()
    writer = _SwitchWriter(numbers, varying)
    changed = [writer.written(formula) for formula in formulas]
    return changed, writer.switches(changed)


class _SwitchWriter:
    """Writes formulas by switches, and remembers which it has met."""

    def __init__(self, numbers: Iterable[sympy.Symbol], varying: Iterable[sympy.Symbol]) -> None:
        self._known = frozenset(numbers) | {TIME}
        self._members = self._known | frozenset(varying)
        self._symbols: dict[sympy.Expr, sympy.Symbol] = {}  # by what each is the sign of
        self._branches: dict[sympy.Expr, None] = {}
        self._of_members: dict[sympy.Expr, None] = {}
        self._memory: dict[sympy.Expr, sympy.Expr] = {}

    def written(self, expr: sympy.Expr) -> sympy.Expr:
        """The formula with symbols for its switches of time."""
        if expr not in self._memory:
            self._memory[expr] = self._write(expr)
        return self._memory[expr]

    def switches(self, formulas: Sequence[sympy.Expr]) -> TimeSwitches:
        """What has been met on the way to these formulas."""
        used = frozenset().union(*(formula.free_symbols for formula in formulas))
        inner = [function for function, symbol in self._symbols.items() if symbol not in used]
        outer = {symbol: function for function, symbol in self._symbols.items() if symbol in used}
        return TimeSwitches(
            symbols=tuple(outer),
            functions=tuple(outer.values()),
            branches=(*inner, *self._branches),
            formulas=_largest_of_time(formulas, self._known | set(self._symbols.values())),
            of_members=tuple(self._of_members),
            formulas_of_members=tuple(
                formula
                for formula in _largest_of_time(formulas, self._members)
                if not formula.free_symbols <= self._known
            ),
        )

    def _write(self, expr: sympy.Expr) -> sympy.Expr:
        if not expr.args:
            return expr
        if not (expr.free_symbols and expr.free_symbols <= self._known):
            if isinstance(expr, _SWITCHING) and TIME in expr.free_symbols <= self._members:
                self._of_members[expr] = None
            return expr.func(*map(self.written, expr.args))
        if isinstance(expr, (sympy.Max, sympy.Min)):
            return self._extreme(expr)
        if isinstance(expr, _SWITCHING):
            inside = self.written(expr.args[0])  # inner switches come first
            s = self._sign(expr.args[0])
            return s * inside if isinstance(expr, sympy.Abs) else s
        if TIME in expr.free_symbols:
            if isinstance(expr, sympy.Pow) and not expr.exp.is_Integer:
                self._branches[expr.base] = None
            if type(expr) in _BRANCHES:
                self._branches.update(dict.fromkeys(_BRANCHES[type(expr)](*expr.args)))
        return expr.func(*map(self.written, expr.args))

    def _extreme(self, expr: sympy.Expr) -> sympy.Expr:
        """The largest or smallest of some formulas: the one so far against each of the others."""
        upwards = 1 if isinstance(expr, sympy.Max) else -1
        first, *others = expr.args
        value, *values = map(self.written, expr.args)  # inner switches come first
        for other, its_value in zip(others, values, strict=True):
            s = upwards * self._sign(first - other)
            value = value * (1 + s) / 2 + its_value * (1 - s) / 2
            first = expr.func(first, other)
        return value

    def _sign(self, function: sympy.Expr) -> sympy.Expr:
        if not function.free_symbols:
            return sympy.sign(function)
        if function not in self._symbols:
            name = f"switch_time_{len(self._symbols)}"
            self._symbols[function] = sympy.Symbol(name, real=True)
        return self._symbols[function]


def _largest_of_time(
    formulas: Sequence[sympy.Expr], known: frozenset[sympy.Symbol]
) -> tuple[sympy.Expr, ...]:
    """Largest subexpressions in t and known symbols alone, in which t occurs."""
    parts: dict[sympy.Expr, None] = {}

    def walk(expr: sympy.Expr) -> None:
        free = expr.free_symbols
        if TIME not in free:
            return
        if free <= known:
            parts[expr] = None
            return
        if expr.is_Add or expr.is_Mul:
            timely = [arg for arg in expr.args if arg.free_symbols <= known]
            if any(TIME in arg.free_symbols for arg in timely):
                parts[expr.func(*timely)] = None
            for arg in expr.args:
                if arg not in timely:
                    walk(arg)
            return
        for arg in expr.args:
            walk(arg)

    for formula in formulas:
        walk(formula)
    return tuple(parts)

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
    """

    symbols: tuple[sympy.Symbol, ...] = ()
    functions: tuple[sympy.Expr, ...] = ()
    branches: tuple[sympy.Expr, ...] = ()
    formulas: tuple[sympy.Expr, ...] = ()
    of_members: tuple[sympy.Expr, ...] = ()

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
    known = frozenset(numbers) | {TIME}
    members = known | frozenset(varying)
    of_members: dict[sympy.Expr, None] = {}
    symbols: dict[sympy.Expr, sympy.Symbol] = {}
    branches: dict[sympy.Expr, None] = {}
    memory: dict[sympy.Expr, sympy.Expr] = {}

    def switch(function: sympy.Expr) -> sympy.Expr:
        if not function.free_symbols:
            return sympy.sign(function)
        if function not in symbols:
            symbols[function] = sympy.Symbol(f"switch_time_{len(symbols)}", real=True)
        return symbols[function]

    def smooth(expr: sympy.Expr) -> sympy.Expr:
        if expr not in memory:
            memory[expr] = written(expr)
        return memory[expr]

    def written(expr: sympy.Expr) -> sympy.Expr:
        if not expr.args:
            return expr
        if not (expr.free_symbols and expr.free_symbols <= known):
            if isinstance(expr, _SWITCHING) and TIME in expr.free_symbols <= members:
                of_members[expr] = None
            return expr.func(*map(smooth, expr.args))
        if isinstance(expr, (sympy.Max, sympy.Min)):
            upwards = 1 if isinstance(expr, sympy.Max) else -1
            first, *others = expr.args
            value, *values = map(smooth, expr.args)  # inner switches come first
            for other, its_value in zip(others, values, strict=True):
                s = upwards * switch(first - other)
                value = value * (1 + s) / 2 + its_value * (1 - s) / 2
                first = expr.func(first, other)
            return value
        if isinstance(expr, sympy.Abs):
            value = smooth(expr.args[0])
            return switch(expr.args[0]) * value
        if isinstance(expr, sympy.sign):
            smooth(expr.args[0])
            return switch(expr.args[0])
        if isinstance(expr, sympy.Pow) and not expr.exp.is_Integer and TIME in expr.free_symbols:
            branches[expr.base] = None
        if type(expr) in _BRANCHES and TIME in expr.free_symbols:
            branches.update(dict.fromkeys(_BRANCHES[type(expr)](*expr.args)))
        return expr.func(*map(smooth, expr.args))

    if not any(formula.has(TIME) or formula.has(*_SWITCHING) for formula in formulas):
        return list(formulas), TimeSwitches()
    changed = [smooth(formula) for formula in formulas]
    parts = _largest_of_time(changed, known | set(symbols.values()))
    used = frozenset().union(*(formula.free_symbols for formula in changed))
    inner = [function for function, symbol in symbols.items() if symbol not in used]
    used_ones = {symbol: function for function, symbol in symbols.items() if symbol in used}
    switches = TimeSwitches(
        tuple(used_ones), tuple(used_ones.values()), (*inner, *branches), parts, tuple(of_members)
    )
    return changed, switches


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

"""What the integrators of many members are given: rates, and what is kept of every member."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import sympy

from certrack.expressions import TIME

#: Begin of a step or of a part of it, and its length: for memories.
BEGIN, STEP = sympy.symbols("kept_begin kept_step", real=True)


@dataclass(frozen=True)
class Flow:
    """What is integrated and what is kept of it.

    Attributes
    ----------
    states : symbols
    rates : formulas of the states, the parameters and what all members share
    parameters : symbols
        Numbers that differ between members.
    integrands : formulas
        Integrated along the run.
    signals : formulas
        Evaluated at both ends of every step; they may contain the symbols of :attr:`slopes`.
    slopes : symbols
        Stand for the rates in the signals.
    memories : pairs (symbol, formula)
        Updated at the end of every step. The formula may contain its own symbol, BEGIN, STEP,
        ``sides[j][0]`` and ``sides[j][1]`` (signal j at begin and end), and shared symbols.
    sides : pairs of symbols, one per signal
    watched : int
        The first states, which must stay within a limit.
    shared : symbols that are the same for all members besides time (the reference's piece)
    """

    states: tuple[sympy.Symbol, ...]
    rates: tuple[sympy.Expr, ...]
    parameters: tuple[sympy.Symbol, ...]
    integrands: tuple[sympy.Expr, ...]
    signals: tuple[sympy.Expr, ...]
    slopes: tuple[sympy.Symbol, ...]
    memories: tuple[tuple[sympy.Symbol, sympy.Expr], ...]
    sides: tuple[tuple[sympy.Symbol, sympy.Symbol], ...]
    watched: int
    shared: tuple[sympy.Symbol, ...] = ()

    @property
    def rows(self) -> dict[str, slice]:
        """Where each kind lies in a member's column; all of it is handed from step to step."""
        sizes = {
            "states": len(self.states),
            "parameters": len(self.parameters),
            "integrals": len(self.integrands),
            "slopes": len(self.rates),
            "signals": len(self.signals),
            "memories": len(self.memories),
        }
        ends = np.cumsum(list(sizes.values())).tolist()
        begins = [0, *ends[:-1]]
        return {name: slice(a, b) for name, a, b in zip(sizes, begins, ends, strict=True)}

    def without_time(self) -> tuple[Flow, dict[sympy.Expr, sympy.Symbol]]:
        """The flow with every largest subexpression that all members share as one symbol."""
        common = {TIME, *self.shared}
        found: dict[sympy.Expr, sympy.Symbol] = {}

        def name(expr: sympy.Expr) -> sympy.Expr:
            number, rest = expr.as_coeff_Mul()
            if rest not in found:
                found[rest] = sympy.Symbol(f"kept_shared_{len(found)}", real=True)
            return number * found[rest]

        def walk(expr: sympy.Expr) -> sympy.Expr:
            free = expr.free_symbols
            if not free & common:
                return expr
            if free <= common:
                return name(expr)
            if expr.is_Add or expr.is_Mul:
                own = [arg for arg in expr.args if arg.free_symbols and arg.free_symbols <= common]
                rest = [walk(arg) for arg in expr.args if arg not in own]
                return expr.func(*rest, *([name(expr.func(*own))] if own else []))
            return expr.func(*map(walk, expr.args))

        return (
            replace(
                self,
                rates=tuple(map(walk, self.rates)),
                integrands=tuple(map(walk, self.integrands)),
                signals=tuple(map(walk, self.signals)),
                memories=tuple((symbol, walk(formula)) for symbol, formula in self.memories),
            ),
            found,
        )

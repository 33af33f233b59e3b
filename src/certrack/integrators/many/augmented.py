"""What the integrators of many members integrate: the rates, and what is recorded of a member."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import sympy

from certrack.core.expressions import TIME
from certrack.core.hoisting import Hoisted, hoisted, hoisted_numbers
from certrack.core.lowering import jacobian


@dataclass(frozen=True)
class AugmentedFlow:
    """A system together with the integrals, signals and memories that are recorded of it.

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
        Updated at the end of every step. The formula may contain its own symbol, STEP_BEGIN,
        STEP_LENGTH, ``sides[j][0]`` and ``sides[j][1]`` (signal j at begin and end), and shared
        symbols.
    sides : pairs of symbols, one per signal
    watched : int
        The first states, which must stay within a limit.
    shared : symbols that are the same for all members besides time (the reference's piece)
    held : numbers of the states that may stick at zero
        Their modes, sides and then what is stuck, are the last of the parameters.
    numbers : symbols
        Stand for numbers that all members share at all times; compiled code serves all values.
    surfaces : formulas
        Of all of them what stands for the sign, then the drifts, then the effects
        (:mod:`certrack.loops.switching`).
    partials : formulas
        Derivatives of the rates by every state, row by row; none before :meth:`linearised`.
    by_time : formulas
        Derivatives of the rates by time.
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
    held: tuple[int, ...] = ()
    surfaces: tuple[sympy.Expr, ...] = ()
    numbers: tuple[sympy.Symbol, ...] = ()
    partials: tuple[sympy.Expr, ...] = ()
    by_time: tuple[sympy.Expr, ...] = ()

    @property
    def rows(self) -> dict[str, slice]:
        """Which rows of a member's column each kind has; a step maps a column to the next one."""
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

    def linearised(self) -> AugmentedFlow:
        """The flow with the derivatives of its rates; kinks have one-sided slopes."""
        return replace(
            self,
            partials=tuple(jacobian(self.rates, self.states)),
            by_time=tuple(jacobian(self.rates, [TIME])),
        )

    def without_time(self) -> tuple[AugmentedFlow, Hoisted]:
        """The flow with every largest subexpression that all members share as one symbol."""
        common, known = {TIME, *self.shared}, set(self.numbers)
        return self._with(lambda formulas: hoisted(formulas, common, known))

    def with_fewest_numbers(self) -> tuple[AugmentedFlow, Hoisted]:
        """The flow with every largest subexpression of numbers alone as one number."""
        flow, symbols = self._with(lambda formulas: hoisted_numbers(formulas, set(self.numbers)))
        return replace(flow, numbers=tuple(symbols.values())), symbols

    def _with(
        self, hoist: Callable[[list[sympy.Expr]], tuple[list[sympy.Expr], Hoisted]]
    ) -> tuple[AugmentedFlow, Hoisted]:
        """All formulas as a function of them leaves them, and the symbols it puts in."""
        kinds = (
            self.rates,
            self.integrands,
            self.signals,
            self.surfaces,
            self.partials,
            self.by_time,
            [f for _, f in self.memories],
        )
        changed, symbols = hoist([f for kind in kinds for f in kind])
        formulas = iter(changed)
        rates, integrands, signals, surfaces, partials, by_time, updates = (
            tuple(islice(formulas, len(kind))) for kind in kinds
        )
        names = (name for name, _ in self.memories)
        memories = tuple(zip(names, updates, strict=True))
        return (
            replace(
                self,
                rates=rates,
                integrands=integrands,
                signals=signals,
                surfaces=surfaces,
                partials=partials,
                by_time=by_time,
                memories=memories,
            ),
            symbols,
        )

"""What a law computes, as formulas: :class:`Equations`."""

from __future__ import annotations

from dataclasses import dataclass

import sympy


@dataclass(frozen=True)
class Equations:
    """A law as formulas: the input u, and the derivatives of the controller's own states.

    Attributes
    ----------
    u : formula
    update : pairs (symbol, formula)
        Own states and their rates, per second. They may contain ``s.applied``, the input within
        its limits.
    filters : symbols
        Own states that are no estimates: they move on while the input is limited, when a sampled
        controller lets its estimates forget only.
    first : pairs (symbol, formula)
        Own states of a sampled controller, and what is added to their initial values at the first
        sample: formulas of states and reference, so that an observer begins where the plant is.
    """

    u: sympy.Expr
    update: tuple[tuple[sympy.Symbol, sympy.Expr], ...] = ()
    filters: tuple[sympy.Symbol, ...] = ()
    first: tuple[tuple[sympy.Symbol, sympy.Expr], ...] = ()

    @property
    def formulas(self) -> dict[str, sympy.Expr]:
        """All formulas, by what they are."""
        rates = {f"the rate of {z}": rate for z, rate in self.update}
        return {"u": self.u} | rates | {f"the first {z}": value for z, value in self.first}

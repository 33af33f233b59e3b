"""Bounds of |w| that are a growing formula: their largest values where |x| <= X, in balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np
import sympy

from certrack.certificates.balls import enclosing_ball
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.enclosed import widened
from certrack.core.expressions import symbol
from certrack.core.monotone import growth_power
from certrack.model.growth import NORM

#: Bits of the values that floats are made of.
BITS_OF_SIZES = 80


@dataclass(frozen=True)
class GrowingBound:
    """A formula of the sizes of the states and of their norm that only grows.

    Attributes
    ----------
    formula : sympy.Expr
    states : symbols
    """

    formula: sympy.Expr
    states: tuple[sympy.Symbol, ...]

    @property
    def is_global(self) -> bool:
        """Whether it grows no faster than the sizes."""
        return growth_power(self.formula) <= 1

    def largest(self, X: Sequence[Any], norm: Any) -> Any:
        """The bound where |x| <= X and ||S x|| <= norm, as an exact ball not below it.

        Raises
        ------
        NoCertificate
            If it has no finite value there.
        """
        values = {s: flint.arb(v) for s, v in zip(self.states, X, strict=True)}
        try:
            ball = enclosing_ball(self.formula, values | {symbol(NORM): flint.arb(norm)})
        except ValueError as problem:
            raise NoCertificate(f"the bound of an uncertain term has {problem}") from None
        return flint.arb(ball.upper())

    def largest_float(self, X: Sequence[float], norm: float) -> float:
        """The same of floats, rounded up twice."""
        with flint.ctx.workprec(BITS_OF_SIZES):
            return float(widened(np.array(float(self.largest(X, norm)))))

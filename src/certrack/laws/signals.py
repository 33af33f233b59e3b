"""The symbols that a law is written with: states, reference, and a symbol for every gain."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, symbol
from certrack.laws.integral import INTEGRAL
from certrack.model.plant import Plant

#: Formulas that a process remembers.
MAX_FORMULAS = 256


class _Signal(tuple[sympy.Expr, ...]):
    """The entries of a signal; one beyond the last is refused with its name and their number."""

    name = ""

    def __getitem__(self, index: Any) -> Any:
        try:
            return super().__getitem__(index)
        except IndexError:
            count = f"has {len(self)} entries, from {self.name}[0]" if self else "has no entries"
            raise InputError(f"{self.name}[{index}]", count) from None


def _signal(name: str, entries: Iterable[sympy.Expr]) -> tuple[sympy.Expr, ...]:
    signal = _Signal(entries)
    signal.name = name
    return signal


class Signals:
    """The symbols a law may use in its equations.

    Attributes
    ----------
    x : tuple of symbols
        Plant states.
    Y : tuple of symbols
        y_d ... y_d^(q+1).
    e_n : expression
        Last error coordinate.
    nu : expression
        The part of the control that all laws share: ubar of [25] without theta_hat.
    phi : tuple of expressions
        Regressor phi(x).
    sign_g : symbol
        Sign of the input gain.
    t : symbol
        Time since the run began, s.
    applied : symbol
        For rates of own states: u within the limits of the drive; u itself where there are none.
    """

    t = TIME
    applied = symbol("ctl_applied")

    def __init__(
        self, plant: Plant, q: int, *, short: bool = False, integral: bool = False
    ) -> None:
        """With `short`, e_n and nu stay symbols: for printing a law as the paper does.

        With `integral` they contain the integral of the error, e_0.
        """
        self.plant, self.q = plant, q
        self.x = _signal("s.x", plant.symbols)
        self.Y = _signal("s.Y", (symbol(f"y_d_{i}") for i in range(q + 2)))
        self.phi = _signal("s.phi", (phi.expr for phi in plant.regressor))
        self._parameters: dict[str, tuple[sympy.Symbol, ...]] = {}
        a = self.parameters("A_n", plant.n)
        b = self.parameters("B_n", q + 1)
        nu_x = self.parameters("nu_x", plant.n)
        nu_Y = self.parameters("nu_Y", q + 2)
        self.e_n = _inner(a, self.x) - _inner(b, self.Y[: q + 1])
        self.nu = _inner(nu_x, self.x) + _inner(nu_Y, self.Y) - plant.drift.expr
        if integral:
            self.e_n += self.parameter("A_n0") * INTEGRAL
            self.nu += self.parameter("nu_0") * INTEGRAL
        if short:
            self.e_n, self.nu = symbol("e_n"), symbol("nu")
        self.sign_g = self.parameter("sign_g")

    @property
    def r(self) -> int:
        """Number of unknown parameters theta."""
        return self.plant.r

    def parameter(self, name: str) -> sympy.Symbol:
        """A scalar gain as a symbol."""
        return self.parameters(name, 1)[0]

    def parameters(self, name: str, *shape: int) -> tuple[sympy.Symbol, ...]:
        """An array of gains as symbols, in row-major order."""
        symbols = tuple(symbol(f"law_{name}_{i}") for i in range(math.prod(shape)))
        self._parameters[name] = symbols
        return symbols

    @property
    def all_parameters(self) -> Mapping[str, tuple[sympy.Symbol, ...]]:
        """Every gain asked for so far, by name."""
        return self._parameters


@lru_cache(maxsize=MAX_FORMULAS)
def _inner(a: tuple[sympy.Symbol, ...], b: tuple[sympy.Symbol, ...]) -> sympy.Expr:
    """Inner product of symbols: a law that is made again for other gains has the same formulas."""
    return dot(a, b)


def dot(a: Sequence[sympy.Expr], b: Sequence[sympy.Expr]) -> sympy.Expr:
    """Inner product of formulas."""
    return sympy.Add(*(left * right for left, right in zip(a, b, strict=True)))

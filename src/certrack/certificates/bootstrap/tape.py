"""A formula as a list of ball operations, to be computed at many boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import sympy

from certrack.certificates.balls import ball_rule

#: Increasing functions whose balls of wide arguments are not finite; their ends are.
INCREASING = (sympy.tanh, sympy.atan, sympy.sinh)


class Tape:
    """Formulas of some symbols whose common parts are computed once.

    Parameters
    ----------
    formulas : formulas
    symbols : symbols

    Raises
    ------
    ValueError
        If a part has no rule of ball arithmetic.
    """

    def __init__(self, formulas: Sequence[sympy.Expr], symbols: Sequence[sympy.Symbol]) -> None:
        self._places: dict[sympy.Basic, int] = {s: i for i, s in enumerate(symbols)}
        self._operations: list[tuple[Any, tuple[int, ...]]] = []
        self._start = len(symbols)
        self._results = [self._place(formula) for formula in formulas]

    def _place(self, expr: sympy.Basic) -> int:
        if expr not in self._places:
            operation, parts = ball_rule(expr)
            if not parts:
                constant = operation()
                operation = lambda: constant  # noqa: E731
            if isinstance(expr, INCREASING):
                operation = partial(_between_ends, operation)
            arguments = tuple(self._place(part) for part in parts)
            self._operations.append((operation, arguments))
            self._places[expr] = self._start + len(self._operations) - 1
        return self._places[expr]

    def __call__(self, values: Sequence[Any]) -> list[Any]:
        """The balls of the formulas at balls of the symbols; not finite where nothing is known."""
        memory = list(values)
        for operation, arguments in self._operations:
            memory.append(operation(*(memory[i] for i in arguments)))
        return [memory[i] for i in self._results]


def _between_ends(increasing: Callable[[Any], Any], inside: Any) -> Any:
    return increasing(inside.lower()).union(increasing(inside.upper()))

"""Bounds of w_k that are any growing formula of the sizes |x_1| ... |x_n| and of ||S_k x||.

In the formula the name of a state stands for its magnitude, and ``norm`` for ||S_k x||. That it
grows with each of them is proven (:mod:`certrack.core.monotone`), so the largest value in a box of
states is that at its largest magnitudes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import Expression, parse, symbol
from certrack.core.formula_text import text_of
from certrack.core.lowering import numpy_callable
from certrack.core.monotone import NotMonotone, check_growth, growth_power

#: What ||S_k x|| is called in a bound.
NORM = "norm"

BOUND_KEY = "plant.uncertainty.bound"


def growing_bound(
    k: int, text: Any, states: Sequence[str], constants: Mapping[str, Any]
) -> Expression | None:
    """The bound of w_k, checked; None for an empty text.

    Parameters
    ----------
    k : int
        From 0.
    text : str, number or Expression
    states : names
    constants : mapping of names to numbers

    Returns
    -------
    Expression
        Over the states and ``norm``, with numbers in the place of the constants.

    Raises
    ------
    InputError
        If it is no formula of these names, or is not proven to grow.
    """
    if text == "" or (isinstance(text, Expression) and not text.text):
        return None
    key = f"{BOUND_KEY}[{k}]"
    owner = "state" if NORM in states else "constant" if NORM in constants else ""
    if owner:
        what = f"speaks of {NORM}, which is the name of a {owner} of this plant"
        raise InputError(key, what, getattr(text, "text", text), f"Rename the {owner}")
    sizes = [symbol(name) for name in (*states, NORM)]
    bound = parse(key, text, {s.name: s for s in sizes} | dict(constants))
    try:
        check_growth(bound.expr, sizes)
    except NotMonotone as problem:
        remedy = "Write a larger bound that does, of sums, products and powers of sizes"
        raise InputError(key, f"must {problem}", bound.text, remedy) from None
    return bound


def growing_bounds(
    texts: Sequence[Any], states: Sequence[str], constants: Mapping[str, Any]
) -> tuple[Expression | str, ...]:
    """The bounds of all w_k; see :func:`growing_bound`. Empty texts stay."""
    read = (growing_bound(k, text, states, constants) for k, text in enumerate(texts))
    return tuple("" if entry is None else entry for entry in read)


def is_global(bound: Expression) -> bool:
    """Whether it grows no faster than the sizes: what holds in a large box then holds everywhere.

    bound(c x) <= c bound(x) for all c >= 1, so that a bound that is met once is met for all larger
    states.
    """
    return growth_power(bound.expr) <= 1


def bound_as_formula(bound: Expression, states: Sequence[str], norm: str, offset: float) -> str:
    """A bound as a formula of the states that is smooth at zero, and never above it.

    Parameters
    ----------
    bound : Expression
    states : names
    norm : str
        Formula in the place of the norm.
    offset : float
        Magnitudes are sqrt(x^2 + offset^2) - offset.
    """
    text = f"({text_of(bound.expr)})"
    inside: dict[Any, Any] = {symbol(NORM): parse(BOUND_KEY, norm, states).expr}
    for name in states:
        inside[symbol(name)] = parse(BOUND_KEY, smooth_size(name, offset), states).expr
    return text_of(bound.expr.xreplace(inside)) if bound.expr.free_symbols else text


def smooth_size(name: str, offset: float) -> str:
    """A formula of a state that is smooth at zero, and never above its magnitude."""
    return f"(sqrt({name}**2 + {offset**2!r}) - {offset!r})"


class GrowthInFloats:
    """A bound and its derivatives at many states.

    Parameters
    ----------
    bound : Expression
    states : names
    """

    def __init__(self, bound: Expression, states: Sequence[str]) -> None:
        names = [symbol(name) for name in (*states, NORM)]
        self._value = numpy_callable(names, [bound.expr])
        self._slopes = numpy_callable(names, [sympy.diff(bound.expr, name) for name in names])

    def value(self, x: np.ndarray, norm: np.ndarray) -> np.ndarray:
        """The bound at states (n,) or (n, N), with their norms."""
        values: np.ndarray = self._value(*np.abs(x), norm)[0] + 0.0 * norm
        return values

    def slopes(self, x: np.ndarray, norm: np.ndarray) -> np.ndarray:
        """Derivatives by the sizes and the norm, a row each; 0 where there is none."""
        with np.errstate(all="ignore"):
            rows = [entry + 0.0 * norm for entry in self._slopes(*np.abs(x), norm)]
        return np.nan_to_num(np.array(rows), nan=0.0, posinf=0.0, neginf=0.0)

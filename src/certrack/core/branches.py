"""Branch points: where a function has values, but no Taylor series."""

from __future__ import annotations

import sympy

#: Functions whose values stay within [-1, 1].
_WITHIN_ONE = (sympy.sin, sympy.cos, sympy.tanh)


def may_branch(formula: sympy.Expr, functions: tuple[type[sympy.Expr], ...]) -> bool:
    """Whether a formula has one of these functions, where it may meet a branch point or a pole.

    That asin and acos stay away from theirs, at -1 and 1, is seen where the argument is a smaller
    number times a sine, cosine or hyperbolic tangent.

    >>> t = sympy.Symbol("t", real=True)
    >>> [may_branch(sympy.asin(k * sympy.sin(t)), (sympy.asin,)) for k in (0.9, 1)]
    [False, True]
    """
    return any(not _stays_away(part) for part in formula.atoms(*functions))


def _stays_away(part: sympy.Expr) -> bool:
    if not isinstance(part, (sympy.asin, sympy.acos)):
        return False
    number, wave = part.args[0].as_coeff_Mul()
    return isinstance(wave, _WITHIN_ONE) and bool(abs(number) < 1)

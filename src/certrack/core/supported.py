"""What the formulas of a law, or of a reference, may contain; refused before anything is compiled.

Simulation, exports and ensembles all take the same formulas, so what one of them could not compute
is refused here, in one line.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import Any

import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import ALLOWED_FUNCTIONS
from certrack.core.select import Select

#: Functions that every compiler and every export has.
SUPPORTED = (
    *(build for build, *_ in ALLOWED_FUNCTIONS.values() if build is not sympy.sqrt),
    sympy.Add,
    sympy.Mul,
    sympy.Pow,
    Select,
)

#: Formulas whose normal forms are remembered.
MAX_NORMAL_FORMS = 1024


def normal_form(key: str, what: str, formula: Any) -> sympy.Expr:
    """The formula in the form that is compiled, printed and exported.

    A power whose exponent is no number, a**b, becomes exp(b log(a)), so its base must be positive.

    Parameters
    ----------
    key : str
        Where the formula belongs to, for messages.
    what : str
        Which one it is.
    formula : sympy.Expr or number

    Raises
    ------
    InputError
        If it is no real formula, or contains a function that is not supported.
    """
    try:
        expr = sympy.sympify(formula, strict=True)
    except sympy.SympifyError:
        raise InputError(key, f"{what} must be a formula", formula) from None
    if not isinstance(expr, sympy.Expr):
        raise InputError(key, f"{what} must be a formula", formula)
    return _normal_form(key, what, expr)


@lru_cache(maxsize=MAX_NORMAL_FORMS)
def _normal_form(key: str, what: str, expr: sympy.Expr) -> sympy.Expr:
    """The same of a formula; a law that is made again for other gains has the same formulas."""
    expr = expr.replace(
        lambda part: part.is_Pow and not part.exp.is_number and part.base != sympy.E,
        lambda part: sympy.exp(part.exp * sympy.log(part.base)),
    )
    for part in sympy.preorder_traversal(expr):
        if part.is_number:
            if part.has(sympy.I, sympy.oo, sympy.zoo, sympy.nan):
                raise InputError(key, f"{what} is not a finite real formula", str(expr))
        elif part.args and not isinstance(part, SUPPORTED):
            names = ", ".join(sorted(ALLOWED_FUNCTIONS))
            message = f"{what} contains {type(part).__name__}, which has no compiled form"
            raise InputError(key, message, remedy=f"Supported: + - * / **, {names}")
    return expr


def check_symbols(
    key: str, formulas: Mapping[str, sympy.Expr], known: Collection[sympy.Symbol], remedy: str
) -> None:
    """Refuse formulas of anything but the known symbols; the remedy says what may occur."""
    for what, formula in formulas.items():
        foreign = sorted(map(str, formula.free_symbols - set(known)))
        if foreign:
            raise InputError(key, f"{what} contains unknown symbols", ", ".join(foreign), remedy)

"""SymPy to CasADi: formulas as functions of CasADi's symbols, which it differentiates exactly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import sympy
from sympy.printing.pycode import PythonCodePrinter

from certrack.core.errors import MissingExtra
from certrack.core.kinks import without_minmax
from certrack.core.lowering import renamed

#: Added below a square root: its derivative at 0 is infinite, and ||x|| would have none at rest.
#: The root itself changes by 1e-8 there, and by less elsewhere.
UNDER_ROOT = 1e-16

#: Functions that CasADi has, by the names that they are printed with.
FUNCTIONS = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log"),
    *("sign", "fabs"),
)


def casadi(purpose: str) -> Any:
    """The module ``casadi``.

    Raises
    ------
    MissingExtra
        Where it is not installed.
    """
    try:
        import casadi as module
    except ImportError:
        raise MissingExtra("CasADi", "optimal", purpose) from None
    return module


class CasadiPrinter(PythonCodePrinter):
    """Code whose functions take CasADi's symbols."""

    def _print_sign(self, expr: sympy.Expr) -> str:
        return f"sign({self._print(expr.args[0])})"

    def _print_Abs(self, expr: sympy.Expr) -> str:
        return f"fabs({self._print(expr.args[0])})"


def casadi_callable(
    module: Any, arguments: Sequence[Any], formulas: Sequence[sympy.Expr]
) -> Callable[..., list[Any]]:
    """A function of CasADi's symbols that returns all formulas.

    Parameters
    ----------
    module : module
        ``casadi``.
    arguments : sequence
        Symbols, or nested sequences of them.
    formulas : sequence of sympy.Expr
        At a kink of abs, sign, min or max they have the slope of one side.
    """
    names, renamed_formulas = renamed(arguments, map(without_minmax, formulas))
    known = {name: getattr(module, name) for name in FUNCTIONS}
    known |= {"sqrt": lambda value: module.sqrt(value + UNDER_ROOT), "pi": float(sympy.pi)}
    known["e"] = float(sympy.E)
    printer = CasadiPrinter({"fully_qualified_modules": False})
    return sympy.lambdify(names, renamed_formulas, [known], printer, cse=True)

"""SymPy to text that our own parser reads again."""

from __future__ import annotations

import sympy
from sympy.printing.str import StrPrinter


class _TextPrinter(StrPrinter):
    """SymPy's own text, with our names of functions; a symbol may be called E, Abs or Max."""

    def _print_Exp1(self, _expr: sympy.Expr) -> str:
        return "exp(1)"

    def _print_Abs(self, expr: sympy.Expr) -> str:
        return self._call("abs", expr)

    def _print_Max(self, expr: sympy.Expr) -> str:
        return self._call("max", expr)

    def _print_Min(self, expr: sympy.Expr) -> str:
        return self._call("min", expr)

    def _call(self, name: str, expr: sympy.Expr) -> str:
        arguments = sorted(expr.args, key=sympy.default_sort_key)
        return f"{name}({', '.join(map(self._print, arguments))})"


def text_of(expr: sympy.Basic) -> str:
    """The formula as text of our language.

    >>> text_of(sympy.E * sympy.Abs(sympy.Symbol("E")))
    'exp(1)*abs(E)'
    """
    return str(_TextPrinter({"full_prec": False}).doprint(expr))

"""The design as formulas: virtual controls, control law and update laws, as text or LaTeX."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import sympy
from sympy.printing.latex import LatexPrinter

from certrack.core.expressions import symbol
from certrack.laws.integral import INTEGRAL
from certrack.laws.signals import Signals, dot

if TYPE_CHECKING:
    from certrack.systems.system import System

#: Significant digits of the numbers in printed formulas.
PRINTED_DIGITS = 6

#: Left and right side of each formula.
Sides = list[tuple[str, str]]


def as_text(system: System) -> list[str]:
    """One line per formula, plain text."""
    return [
        f"{left} = {right}"
        for left, right in _equation_sides(system, _as_plain_text, "e_{}", "lambda_{}")
    ]


def as_latex(system: System) -> str:
    """The whole design as a LaTeX ``align*`` environment."""
    lines = _equation_sides(system, _as_latex_text, "e_{{{}}}", r"\lambda_{{{}}}")
    body = " \\\\\n".join(f"  {left} &= {right}" for left, right in lines)
    return f"\\begin{{align*}}\n{body}\n\\end{{align*}}"


def plant_as_text(system: System) -> list[str]:
    """The plant's equations (5), one line each, plain text."""
    return [f"{left} = {right}" for left, right in _plant_sides(system, _as_plain_text)]


def plant_as_latex(system: System) -> list[str]:
    """The same in LaTeX."""
    return [f"{left} = {right}" for left, right in _plant_sides(system, _as_latex_text)]


def _plant_sides(system: System, show: Callable[[sympy.Expr], str]) -> Sides:
    """x_i' = g_i x_{i+1} + sum_j b_ij x_j + tau_i w_i, and that of x_n with h, theta and u."""
    plant, x = system.plant, system.plant.symbols
    tau = [sympy.Float(value, PRINTED_DIGITS) for value in plant.uncertainty.tau]
    w = [symbol(f"w_{i + 1}") for i in range(plant.n)]
    sides = []
    for i, (g, row) in enumerate(zip(plant.chain, plant.linear, strict=True)):
        rate = g.expr * x[i + 1] + dot([b.expr for b in row], x[: i + 1]) + tau[i] * w[i]
        sides.append((_dotted(show, x[i]), show(_with_few_digits(rate))))
    known = plant.theta
    theta = (
        [symbol(f"theta_{k + 1}") for k in range(plant.r)]
        if known is None
        else [value.expr for value in known]
    )
    gain = symbol(f"g_{plant.n}") if plant.input_gain is None else plant.input_gain.expr
    rate = plant.drift.expr + dot([f.expr for f in plant.regressor], theta) + tau[-1] * w[-1]
    sides.append((_dotted(show, x[-1]), show(_with_few_digits(rate + gain * symbol("u")))))
    return sides


def _with_few_digits(expr: sympy.Expr) -> sympy.Expr:
    """Numbers, and constants by their values, with the digits that are printed."""
    rationals = {r for r in expr.atoms(sympy.Rational) if not r.is_Integer}
    return _rounded(expr.xreplace({r: sympy.Float(r, PRINTED_DIGITS) for r in rationals}))


def _equation_sides(
    system: System, show: Callable[[sympy.Expr], str], e: str, virtual: str
) -> Sides:
    """Left and right sides, in the order in which the design is read."""
    plant, design = system.plant, system.controller.coordinates
    n, x = plant.n, plant.symbols
    Y = [symbol(f"y_d_{i}") for i in range(design.q + 2)]
    part = design.integral
    a = np.zeros(n) if part is None else part.column  # of e_0
    lines: Sides = [(e.format(1), show(x[0] - Y[0] + _linear(a[:1], [INTEGRAL])))]
    for m in range(1, n):
        formula = _linear(design.eta[m - 1], x[:m]) + _linear(design.d[m - 1], Y[:-1])
        formula += _linear([-a[m]], [INTEGRAL])
        lines.append((virtual.format(m), show(formula)))
        lines.append((e.format(m + 1), f"{show(x[m])} - {virtual.format(m)}"))
    nu = _linear(design.nu_x, x) + _linear(design.nu_Y, Y) - _rounded(plant.drift.expr)
    nu += _linear([0.0 if part is None else part.nu], [INTEGRAL])
    lines.append((show(symbol("nu")), show(nu)))

    short = Signals(plant, design.q, short=True)
    equations = system.law.equations(short)
    names = [s for group in short.all_parameters.values() for s in group]
    values = system.law.values(plant, list(short.all_parameters))
    symbols = {s: sympy.Float(v, PRINTED_DIGITS) for s, v in zip(names, values, strict=True)}
    symbols |= {symbol("e_n"): symbol(f"e_{n}"), short.applied: symbol("u")}
    lines.append(("u", show(_rounded(equations.u.xreplace(symbols)))))
    if part is not None:
        lines.append((_dotted(show, INTEGRAL), show(x[0] - Y[0])))
    for state, rate in equations.update:
        lines.append((_dotted(show, state), show(_rounded(rate.xreplace(symbols)))))
    return lines


def _linear(weights: np.ndarray | Sequence[float], terms: Sequence[sympy.Symbol]) -> sympy.Expr:
    return dot(
        [sympy.Float(weight, PRINTED_DIGITS) if weight else sympy.S.Zero for weight in weights],
        terms,
    )


def _rounded(expr: sympy.Expr) -> sympy.Expr:
    """Floats that are whole numbers printed as such."""
    floats = expr.atoms(sympy.Float)
    return expr.xreplace({f: sympy.Integer(int(f)) for f in floats if float(f).is_integer()})


def _as_plain_text(expr: sympy.Expr) -> str:
    text = sympy.sstr(_rounded(expr), full_prec=False)
    for i in range(20, 1, -1):
        text = text.replace(f"y_d_{i}", f"y_d^({i})")
    return text.replace("y_d_1", "y_d'").replace("y_d_0", "y_d")


def _dotted(show: Callable[[sympy.Expr], str], state: sympy.Symbol) -> str:
    if show is not _as_latex_text:
        return f"{state.name}'"
    letter, mark, index = show(state).partition("_")  # the dot stands over the letter
    return rf"\dot{{{letter}}}{mark}{index}"


class _Latex(LatexPrinter):
    def _print_Symbol(self, expr: sympy.Symbol, style: str = "plain") -> str:
        name = expr.name
        if name.startswith("y_d_"):
            order = int(name[4:])
            plain = ["y_d", r"\dot y_d", r"\ddot y_d"]
            return plain[order] if order < 3 else f"y_d^{{({order})}}"
        if name == "delta_hat":
            return r"\hat\delta"
        if name.startswith("theta_hat_"):
            return rf"\hat\theta_{{{name[10:]}}}"
        letters = str(super()._print_Symbol(expr))
        return rf"\mathrm{{{letters}}}" if letters.isalpha() and len(letters) > 1 else letters


def _as_latex_text(expr: sympy.Expr) -> str:
    settings = {"full_prec": False, "mul_symbol": r" \, "}  # factors of several letters stay apart
    return str(_Latex(settings).doprint(_rounded(expr)))

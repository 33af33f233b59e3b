"""The sampled controller of a linear law as matrices, in balls.

They are the slopes of the formulas that are simulated and exported
(:mod:`certrack.loops.controller`), with the numbers of the design exact and those of an observer
the floats that the controller computes with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import flint
import sympy

from certrack.certificates.arithmetic import exact_float, rational
from certrack.certificates.balls import enclosing_ball
from certrack.certificates.certificate import NoCertificate
from certrack.core.expressions import symbol
from certrack.core.memo import remembered
from certrack.loops.controller import PERIOD
from certrack.loops.linear_controller import linear_controller
from certrack.loops.observers import INPUT_BEFORE, observer_values
from certrack.model.implementation import Implementation
from certrack.systems.system import System


def controller_matrices(
    system: System, implementation: Implementation, K: Sequence[Any]
) -> dict[str, flint.arb_mat]:
    """Lx, Ls, Ly, Sx, Ss, Sy, first and first_input of :class:`~.drive.Drive`.

    Parameters
    ----------
    system : System
    implementation : Implementation
    K : rationals
        u = K (x, y_d ... y_d^(q+1), own states of the law), for the x that the law is given.
    """
    plant, controller = system.plant, system.controller
    s = controller.signals
    gains = [symbol(f"law_K_{i}") for i in range(len(K))]
    u = sympy.Add(*(k * v for k, v in zip(gains, (*s.x, *s.Y, *controller.states), strict=True)))
    linear = linear_controller(plant, controller, implementation, u)
    values = dict(zip(gains, map(flint.arb, K), strict=True))
    values |= _numbers(system, implementation)
    command, *after = linear.formulas
    known = set(values)

    def slopes(rows: Sequence[sympy.Expr], by: Sequence[sympy.Symbol]) -> flint.arb_mat:
        entries, names = _derivatives(tuple(rows), tuple(by))
        if names - known:
            raise NoCertificate("only loops that are linear are covered as implemented")
        balls = [enclosing_ball(entry, values) for entry in entries]
        return flint.arb_mat(len(rows), len(by), balls)

    return {
        "Lx": slopes([command], s.x),
        "Ls": slopes([command], linear.states),
        "Ly": slopes([command], s.Y),
        "Sx": slopes(after, s.x),
        "Ss": slopes(after, linear.states),
        "Sy": slopes(after, s.Y),
        "first": slopes(linear.presets, s.x),
        "first_input": slopes(linear.presets, [INPUT_BEFORE]),
    }


@remembered
def _derivatives(
    rows: tuple[sympy.Expr, ...], by: tuple[sympy.Symbol, ...]
) -> tuple[tuple[sympy.Expr, ...], frozenset[sympy.Basic]]:
    """Derivatives of every row by every symbol, and what is left in them.

    The numbers of a law are symbols in its formulas: laws of one structure have the same.
    """
    entries = tuple(sympy.diff(row, v) for row in rows for v in by)
    return entries, frozenset().union(*(entry.free_symbols for entry in entries))


def _numbers(system: System, implementation: Implementation) -> Mapping[sympy.Symbol, Any]:
    """Balls of the numbers that are not the law's."""
    plant, T = system.plant, rational(implementation.period)
    values = {symbol(name): flint.arb(rational(v)) for name, v in plant.constant_values.items()}
    values[PERIOD] = flint.arb(T)
    pole = flint.arb(1)
    if implementation.velocity_filter:
        pole = 1 - (-flint.arb(T / rational(implementation.velocity_filter))).exp()
    values[symbol("ctl_filter")] = pole
    observer = observer_values(plant, system.law, implementation)
    return values | {name: flint.arb(exact_float(v, rational)) for name, v in observer.items()}

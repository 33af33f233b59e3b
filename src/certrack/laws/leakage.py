"""The leakage of a law's own states, and the longest period at which Euler's step of it decays.

Of the rates z' the constant part L of the Jacobian by z is the leak. A step of forward Euler takes
the estimates' distance from their priors by I + T L: where an eigenvalue of that leaves the unit
circle although L itself decays, the estimates diverge whatever the plant does.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import sympy

from certrack.core.lowering import NumpyFunction, numpy_callable
from certrack.laws.base import Controller
from certrack.laws.equations import Equations

#: Formulas of so many laws are kept: members of an ensemble share theirs.
KEPT_LAWS = 64


def leak_jacobian(controller: Controller) -> tuple[sympy.Expr, ...]:
    """Jacobian of the rates by the estimates, row-major: what depends on gains alone, else zero."""
    return _constant_jacobian(controller.equations, controller.symbols)


def leak_matrix(controller: Controller) -> np.ndarray:
    """L, the leak as numbers, (s, s) for a law with s states of its own."""
    return _leak_numbers(controller)


def _leak_numbers(controller: Controller) -> np.ndarray:
    count = len(controller.states)
    if not count:
        return np.zeros((0, 0))
    values = _leak_function(controller.equations, controller.symbols)(*controller.values)
    return np.array(values, dtype=float).reshape(count, count)


def longest_euler_period(controller: Controller) -> float:
    """Period at which Euler's step of the leak ceases to decay, s; inf where nothing leaks.

    Parameters
    ----------
    controller : Controller

    Returns
    -------
    float
        The least 2 |Re l|/|l|^2 of the decaying eigenvalues l of L: there |1 + T l| = 1.
    """
    leak = _leak_numbers(controller)
    if not leak.size or not np.isfinite(leak).all():
        return np.inf
    poles = np.linalg.eigvals(leak)
    decaying = poles[poles.real < 0]
    with np.errstate(all="ignore"):
        periods = -2.0 * decaying.real / np.abs(decaying) ** 2
    return float(periods.min(initial=np.inf))


@lru_cache(maxsize=KEPT_LAWS)
def _constant_jacobian(
    equations: Equations, symbols: tuple[sympy.Symbol, ...]
) -> tuple[sympy.Expr, ...]:
    gains, states = set(symbols), [name for name, _ in equations.update]
    table = [sympy.diff(rate, z) for _, rate in equations.update for z in states]
    return tuple(entry if entry.free_symbols <= gains else sympy.S.Zero for entry in table)


@lru_cache(maxsize=KEPT_LAWS)
def _leak_function(equations: Equations, symbols: tuple[sympy.Symbol, ...]) -> NumpyFunction:
    return numpy_callable(symbols, _constant_jacobian(equations, symbols))

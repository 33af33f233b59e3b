"""The balanced recursion: poles that no choice of units moves.

The recursion cancels g_{m-1} e_{m-1} e_m of V = e^T e/2, and the size of that term depends on the
units of the states. Carried out in xi = S x, S = diag(s_1 ... s_n), with

    s_1 = 1,  s_{i+1} = s_i |g_i| / (rho sqrt(c_i c_{i+1}))

the chain's coefficients become rho sqrt(c_i c_{i+1}), and the error matrix sqrt(C) (-I + rho (J -
J^T)) sqrt(C): for equal c the poles are -c + i 2 rho c cos(k pi/(n+1)), k = 1 ... n, in any units.
rho is the coupling; near zero the poles are -c_1 ... -c_n. Mapped back, A = S^-1 A~ S, B = S^-1 B~,
nu_x = nu~_x S/s_n, nu_Y = nu~_Y/s_n. There is no damping: it lives in the coordinates of the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from certrack.core.errors import DesignError
from certrack.laws.backstepping import ErrorCoordinates, carry_out

#: Significant digits of the weights: they are exact decimals, the same for floats and rationals.
WEIGHT_DIGITS = 12


def balancing_weights(
    g: Sequence[float] | np.ndarray, c: Sequence[float] | np.ndarray, coupling: float
) -> list[Fraction]:
    """s_1 ... s_n.

    Parameters
    ----------
    g : n - 1 numbers
        Virtual control coefficients.
    c : n numbers, 1/s
    coupling : float > 0
        rho.

    Raises
    ------
    DesignError
        If a weight is beyond floats.
    """
    weights = [1.0]
    for i, coefficient in enumerate(g):
        rate = coupling * math.sqrt(c[i] * c[i + 1])
        weights.append(weights[-1] * abs(coefficient) / rate if rate else math.inf)
    if not all(0 < weight < math.inf for weight in weights):
        raise DesignError(
            "law.coupling",
            "the weights of the balanced recursion leave the range of floating point",
            coupling,
            "Take a coupling near 0.5, or scale the states (chain)",
        )
    return [Fraction(f"{weight:.{WEIGHT_DIGITS}g}") for weight in weights]


def balanced(
    g: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    q: int,
    weights: Sequence[Fraction],
    number: Callable[[Any], Any] = float,
) -> ErrorCoordinates:
    """The recursion in balanced coordinates, mapped back, in the arithmetic of its arguments.

    Parameters
    ----------
    g, b, c, q
        As in :func:`certrack.laws.recursion.recursion`.
    weights : s_1 ... s_n
    number : callable
        Turns a rational into the arithmetic.
    """
    n, s = len(c), np.array([number(weight) for weight in weights], dtype=b.dtype)
    none = np.zeros(n - 1, dtype=b.dtype)
    design = carry_out(
        g * s[:-1] / s[1:],
        b * s[:-1, None] / s[None, :],
        c,
        [np.zeros(m + 1, dtype=b.dtype) for m in range(n)],
        none,
        q,
    )
    return replace(
        design,
        A=design.A * s[None, :] / s[:, None],
        B=design.B / s[:, None],
        F=b + np.eye(n - 1, n, 1, dtype=b.dtype) * g[:, None],
        g=g,
        nu_x=design.nu_x * s / s[-1],
        nu_Y=design.nu_Y / s[-1],
        weights=s,
    )

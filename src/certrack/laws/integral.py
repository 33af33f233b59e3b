"""Integral action: the recursion for the chain with one state more, the integral of the error.

With x_0' = x_1 and the reference of x_0, whose derivative is y_d, the recursion for (x_0, x) and
the gains (c_0, c) gives a law in which x_0 and its reference occur as their difference only,

    e_0 = int (x_1 - y_d) dt,    e = A x - B Y + a e_0,    nu = nu_x x + nu_Y Y' + nu_0 e_0 - h(x).

The tracking error is x_1 - y_d = e_1 - c_0 e_0.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from certrack.core.expressions import symbol
from certrack.laws.backstepping import ErrorCoordinates, IntegralPart

#: The law's own state.
INTEGRAL = symbol("e_0")


def longer_chain(
    g: np.ndarray, b: np.ndarray, c: np.ndarray, integral: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chain, couplings and gains of (x_0, x).

    Parameters
    ----------
    g : (n-1,) array
    b : (n-1, n) array
    c : (n,) array
    integral : c_0
    """
    zero = 0 * np.asarray(c[0])
    rows = np.full((len(b) + 1, len(c) + 1), zero, dtype=b.dtype)
    rows[1:, 1:] = b
    one = zero + 1
    return np.concatenate([[one], g]), rows, np.concatenate([[integral], c])


def of_the_plant(design: ErrorCoordinates) -> ErrorCoordinates:
    """The rows of the plant's states, of the recursion for the longer chain."""
    part = IntegralPart(
        gain=design.c[0],
        column=design.A[1:, 0],
        nu=design.nu_x[0],
        error_matrix=design.error_matrix,
    )
    weights = design.weights
    return replace(
        design,
        A=design.A[1:, 1:],
        B=design.B[1:, 1:],
        F=design.F[1:, 1:],
        c=design.c[1:],
        kappa=design.kappa[1:],
        g=design.g[1:],
        nu_x=design.nu_x[1:],
        nu_Y=design.nu_Y[1:],
        weights=None if weights is None else weights[1:],
        integral=part,
    )


def of_the_chain(design: ErrorCoordinates) -> ErrorCoordinates:
    """The recursion of the longer chain, whose rows of the plant's states `design` has.

    A design without integral action is returned as it is.
    """
    part, weights = design.integral, design.weights
    if part is None:
        return design
    return replace(
        design,
        A=_bordered(design.A, part.column),
        B=_bordered(design.B, part.column),
        F=np.vstack([np.eye(1, design.n + 1, 1), np.insert(design.F, 0, 0.0, axis=1)]),
        c=np.append(part.gain, design.c),
        kappa=np.append(0.0, design.kappa),
        g=np.append(1.0, design.g),
        nu_x=np.append(part.nu, design.nu_x),
        nu_Y=np.append(-part.nu, design.nu_Y),
        weights=None if weights is None else np.append(1.0, weights),
        integral=None,
    )


def _bordered(rows: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The rows with a column before them, and 1, 0, ... above."""
    return np.vstack([np.eye(1, rows.shape[1] + 1), np.column_stack([column, rows])])

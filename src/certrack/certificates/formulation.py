"""From a system to its :class:`ErrorProblem`, in floats or in exact rationals.

Every number is taken from the system's decimal texts, so the exact problem is the one that the
file states and not a float near it.
"""

from __future__ import annotations

from typing import Any

import flint
import numpy as np

from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import ToNumber, exact_float, rational, solve
from certrack.certificates.premises import refuse
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.stated import stated_error_system
from certrack.laws.backstepping import ErrorCoordinates, carry_out
from certrack.laws.error_system import KnownParameters
from certrack.systems.system import System


def error_problem(system: System, number: ToNumber) -> ErrorProblem:
    """The error system of `system`, its inputs scaled to their bounds.

    Parameters
    ----------
    system : System
    number : callable
        The arithmetic: :func:`rational` or :func:`decimal`.

    Returns
    -------
    ErrorProblem
        Inputs whose column is zero are left out.

    Raises
    ------
    NoCertificate
        If no certificate of this kind exists for the system, with the reason.
    InputError
        If a bound of the reference can neither be proven nor is declared.
    """
    refuse(system)
    plant, dtype = system.plant, _dtype(number)
    coordinates = error_coordinates(system, number)
    n, q, A = plant.n, coordinates.q, coordinates.A
    u = plant.uncertainty
    tau, gamma, beta = ([number(v) for v in values] for values in (u.tau, u.gamma, u.beta))
    bounds = [exact_float(v, number) for v in system.reference.bounds(q + 1).values]
    Xe = solve(A, np.eye(n, dtype=dtype))
    in_a = tuple(k for k in range(n) if tau[k] * gamma[k] != 0)
    in_b = tuple(k for k in range(n) if tau[k] * beta[k] != 0)
    in_x = [i for i in range(q + 1) if in_a and bounds[i] != 0 and any(coordinates.B[:, i] != 0)]
    residual = bool(bounds[q + 1] != 0 and any(coordinates.R != 0))
    Uy = np.zeros((n, len(in_x) + residual), dtype=dtype)
    Xy = np.zeros((n, len(in_x) + residual), dtype=dtype)
    for column, i in enumerate(in_x):
        Xy[:, column] = (Xe @ coordinates.B[:, i]) * bounds[i]
    if residual:
        Uy[:, -1] = -coordinates.R * bounds[q + 1]
    return ErrorProblem(
        M=coordinates.error_matrix,
        Ua=_columns([tau[k] * gamma[k] * A[:, k] for k in in_a], n, dtype),
        Ub=_columns([tau[k] * beta[k] * A[:, k] for k in in_b], n, dtype),
        Uy=Uy,
        Xe=Xe,
        Xy=Xy,
        states=(in_a, in_b),
        derivatives=(*in_x, *([q + 1] if residual else [])),
        adaptation=_adaptation(system, number),
    )


def error_coordinates(system: System, number: ToNumber) -> ErrorCoordinates:
    """The error coordinates of the design, by the recursion in the arithmetic of `number`."""
    plant, gains, dtype = system.plant, system.law.gains(), _dtype(number)
    assert plant.linear is not None and gains.k is not None and gains.p is not None
    n = plant.n
    g = np.array([number(v) for v in plant.chain], dtype=dtype)
    b = np.zeros((n - 1, n), dtype=dtype)
    for i, row in enumerate(plant.linear):
        b[i, : i + 1] = [number(v) for v in row]
    if dtype is object:
        b = b + flint.fmpq(0)
    c = np.array([number(v) for v in gains.c], dtype=dtype)

    def weight(k: float) -> Any:
        return number(0) if k == float("inf") else 1 / (4 * number(k))

    weights = [
        np.array([weight(row[2 * i]) + weight(row[2 * i + 1]) for i in range(m + 1)], dtype=dtype)
        for m, row in enumerate(gains.k)
    ]
    residual = np.array([weight(p) for p in gains.p], dtype=dtype)
    return carry_out(g, b, c, weights, residual, system.law.order(plant))


def _adaptation(system: System, number: ToNumber) -> Adaptation | None:
    plant, truth = system.plant, system.truth
    law = stated_error_system(system)
    if isinstance(law, KnownParameters):
        return None
    dtype = _dtype(number)
    gains = plant.input_gain_range or (truth.input_gain,)
    theta0 = np.array([number(v) for v in law.theta0], dtype=dtype)
    Gamma = np.array([[number(v) for v in row] for row in law.Gamma], dtype=dtype)
    box: Any = plant.theta_range or tuple((v, v) for v in truth.theta)
    return Adaptation(
        gain_rate=number(law.gain_rate),
        leak_gain=number(law.leak_gain),
        leak_theta=number(law.leak_theta),
        Gamma=Gamma.reshape(plant.r, plant.r),
        gains=tuple(abs(number(g)) for g in dict.fromkeys(gains)),
        delta0=number(law.delta0),
        gain_sign=plant.gain_sign,
        theta0=theta0,
        theta_box=tuple((number(low), number(high)) for low, high in box),
    )


def _dtype(number: ToNumber) -> Any:
    return object if number is rational else float


def _columns(columns: list[np.ndarray], n: int, dtype: Any) -> np.ndarray:
    return np.array(columns, dtype=dtype).reshape(len(columns), n).T

"""From a system to its :class:`ErrorProblem`, in floats or in exact rationals.

Every number is taken from the system's decimal texts, so the exact problem is the one that the
file states and not a float near it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import ToNumber, exact_float, rational, solve
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.scope import refuse, refuse_formulas
from certrack.certificates.stated import stated_error_system
from certrack.core.once import once
from certrack.laws.backstepping import ErrorCoordinates, carry_out, no_damping
from certrack.laws.balanced import balanced, balancing_weights
from certrack.laws.error_system import KnownParameters
from certrack.laws.integral import longer_chain, of_the_plant
from certrack.laws.linear import Linear
from certrack.laws.plant_coordinates import plant_coordinates
from certrack.model.uncertainty import Uncertainty
from certrack.references.base import bound_of
from certrack.systems.system import System


@once
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

    def bound(i: int) -> Any:
        return exact_float(bound_of(system.reference, i)[0], number)

    return problem_of_design(
        error_coordinates(system, number),
        system.plant.uncertainty,
        bound,
        adaptation_of(system, number),
        number,
    ).read_only()


def problem_of_design(
    coordinates: ErrorCoordinates,
    uncertainty: Uncertainty,
    bound_on: Callable[[int], Any],
    adaptation: Adaptation | None,
    number: ToNumber,
) -> ErrorProblem:
    """The error system of a design in the arithmetic of its numbers.

    Parameters
    ----------
    coordinates : ErrorCoordinates
    uncertainty : Uncertainty
    bound_on : callable
        Y_i of an order i; asked for only where it acts.
    adaptation : Adaptation or None
    number : callable
    """
    dtype, A = _dtype(number), coordinates.A
    n, q = coordinates.n, coordinates.q
    inputs = uncertain_inputs(uncertainty, A, number)
    Xe = solve(A, np.eye(n, dtype=dtype))
    used = [i for i in range(q + 1) if inputs.a and any(coordinates.B[:, i] != 0)]
    used += [q + 1] if any(coordinates.R != 0) else []
    bounds = {i: bound_on(i) for i in used}
    in_x = [i for i in used if i <= q and bounds[i] != 0]
    residual = bool(bounds.get(q + 1, 0) != 0)
    Uy = np.zeros((n, len(in_x) + residual), dtype=dtype)
    Xy = np.zeros((n, len(in_x) + residual), dtype=dtype)
    for column, i in enumerate(in_x):
        Xy[:, column] = (Xe @ coordinates.B[:, i]) * bounds[i]
    if residual:
        Uy[:, -1] = -coordinates.R * bounds[q + 1]
    return ErrorProblem(
        M=coordinates.error_matrix,
        Ua=columns_of(inputs.a, n, dtype),
        Ub=columns_of(inputs.b, n, dtype),
        Uy=Uy,
        Xe=Xe,
        Xy=Xy,
        states=inputs.states,
        derivatives=(*in_x, *([q + 1] if residual else [])),
        adaptation=adaptation,
        selections=inputs.selections,
    )


@dataclass(frozen=True)
class UncertainInputs:
    """The columns by which the w_k act on e, and what bounds them.

    Attributes
    ----------
    a, b : columns
        Scaled to |a_i| <= ||x|| (or what `selections` says) and |b_i| <= 1.
    states : the k of the columns of a, then of b
    selections : as of :class:`ErrorProblem`
    """

    a: tuple[np.ndarray, ...]
    b: tuple[np.ndarray, ...]
    states: tuple[tuple[int, ...], tuple[int, ...]]
    selections: tuple[tuple[np.ndarray, np.ndarray | None] | None, ...]


def uncertain_inputs(u: Uncertainty, A: np.ndarray, number: ToNumber) -> UncertainInputs:
    """The uncertain terms in error coordinates e = A x - B Y.

    |w_k| <= gamma_k ||S_k x|| + sum_j Delta_kj |x_j| + beta_k splits, without loss, into an a-input
    for ||S_k x||, one for each Delta_kj, and a b-input.

    Raises
    ------
    NoCertificate
        If a bound is a formula, which does not split so.
    """
    refuse_formulas(u)
    n = len(A)
    a: list[tuple[int, np.ndarray, Any]] = []
    b: list[tuple[int, np.ndarray]] = []
    for k in range(n):
        column = number(u.tau[k]) * A[:, k]
        if u.tau[k] != 0 and u.gamma[k] != 0:
            scaled = None if u.S is None else np.diag([number(v) for v in u.norm_weights(k)])
            a.append((k, column * number(u.gamma[k]), scaled))
        for j, entry in enumerate(u.Delta[k] if u.Delta is not None else ()):
            if u.tau[k] != 0 and entry != 0:
                unit = np.array([[number(int(i == j)) for i in range(n)]])
                a.append((k, column * number(entry), unit))
        if u.tau[k] != 0 and u.beta[k] != 0:
            b.append((k, column * number(u.beta[k])))
    plain = all(chosen is None for _, _, chosen in a)
    return UncertainInputs(
        tuple(column for _, column, _ in a),
        tuple(column for _, column in b),
        (tuple(k for k, _, _ in a), tuple(k for k, _ in b)),
        () if plain else tuple(None if s is None else (s, None) for _, _, s in a),
    )


@once
def error_coordinates(system: System, number: ToNumber) -> ErrorCoordinates:
    """The error coordinates of the design, in the arithmetic of `number`."""
    plant, dtype = system.plant, _dtype(number)
    assert plant.linear is not None
    n = plant.n
    g = np.array([number(v) for v in plant.chain], dtype=dtype)
    b = np.zeros((n - 1, n), dtype=dtype)
    for i, row in enumerate(plant.linear):
        b[i, : i + 1] = [number(v) for v in row]
    if dtype is object:
        b = b + flint.fmpq(0)
    if isinstance(system.law, Linear):
        law = system.law.settled(plant)
        assert law.K is not None
        K = np.array([number(v) for v in law.K], dtype=dtype)
        return plant_coordinates(g, b, K, number(law.r), law.feedforward)

    gains = system.law.gains()
    assert gains.k is not None and gains.p is not None
    c = np.array([number(v) for v in gains.c], dtype=dtype)

    q, rows, damping = system.law.order(plant), gains.k, gains.p
    floats = plant.g, np.array(gains.c)
    if gains.integral is not None:
        g, b, c = longer_chain(g, b, c, number(gains.integral))
        floats = np.append(1.0, floats[0]), np.append(gains.integral, floats[1])
        rows, damping = no_damping(n + 1)
        q += 1
    if gains.coupling is not None:
        design = balanced(g, b, c, q, balancing_weights(*floats, gains.coupling), number)
        return design if gains.integral is None else of_the_plant(design)

    def weight(k: float) -> Any:
        return number(0) if k == float("inf") else 1 / (4 * number(k))

    weights = [
        np.array([weight(row[2 * i]) + weight(row[2 * i + 1]) for i in range(m + 1)], dtype=dtype)
        for m, row in enumerate(rows)
    ]
    residual = np.array([weight(p) for p in damping], dtype=dtype)
    design = carry_out(g, b, c, weights, residual, q)
    return design if gains.integral is None else of_the_plant(design)


def adaptation_of(system: System, number: ToNumber) -> Adaptation | None:
    """The update laws' data, with what is known of g_n and theta; None without estimates."""
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


def columns_of(columns: Sequence[np.ndarray], n: int, dtype: Any = object) -> np.ndarray:
    """A matrix of n rows with these columns."""
    return np.array(columns, dtype=dtype).reshape(len(columns), n).T

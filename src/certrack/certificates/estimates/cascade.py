"""Value and gradient of the cascade in floats: the second program's, chained with the first's.

The first program bounds e_n by E, and E is a datum of the second (:mod:`..cascade`). So where a
gain changes, the head's problem changes by the gain and by what E moves, and its dual tells of
both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from certrack.certificates.cascade import head_problem
from certrack.certificates.estimates.dual import semidefinite_estimate
from certrack.certificates.problem import ErrorProblem


@dataclass(frozen=True)
class CascadeEstimate:
    """The bound of the two stages, without a centred one between, and its gradient.

    Attributes
    ----------
    bound : float
        Of limsup |e_1|.
    last : float
        Of limsup |e_n|.
    log_gradient : array
        Derivatives of log bound, one for each pair of changed problems.
    by_log_shares : pair of floats
        Its derivatives by the logarithms of the two shares.
    """

    bound: float
    last: float
    log_gradient: np.ndarray
    by_log_shares: tuple[float, float]


def cascade_estimate(
    problem: ErrorProblem,
    shares: tuple[float, float],
    changed: Sequence[tuple[ErrorProblem, ErrorProblem]] = (),
    step: float = 1.0,
) -> CascadeEstimate | None:
    """The bound with each stage's alpha a share of its fastest rate; None if there is none.

    Parameters
    ----------
    problem : ErrorProblem
        In floats, with estimates, n >= 2.
    shares : pair of floats
        Below 1.
    changed : pairs of ErrorProblem
        With each parameter a step above and below.
    step : float
        Of these.
    """
    first = semidefinite_estimate(problem, shares[0], changed, step, problem.n - 1)
    if first is None:
        return None
    E = first.bound
    pairs = [
        (
            head_problem(above, E * math.exp(step * slope)),
            head_problem(below, E * math.exp(-step * slope)),
        )
        for (above, below), slope in zip(changed, first.log_gradient, strict=True)
    ]
    by_E = head_problem(problem, E * math.exp(step)), head_problem(problem, E * math.exp(-step))
    head = semidefinite_estimate(head_problem(problem, E), shares[1], [*pairs, by_E], step)
    if head is None:
        return None
    *gradient, slope_of_E = head.log_gradient
    by_shares = float(slope_of_E * first.by_log_share), head.by_log_share
    return CascadeEstimate(head.bound, E, np.array(gradient), by_shares)

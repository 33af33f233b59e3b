"""The bound in floats, by the method that the exact path will use: for searches and designers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from certrack.certificates.arithmetic import decimal
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.estimates.cascade import (
    BestCascade,
    best_cascade,
    rate_nearby,
    solution_nearby,
)
from certrack.certificates.estimates.loop_data import in_plant_coordinates
from certrack.certificates.estimates.peak_gains import peak_estimate
from certrack.certificates.formulation import error_problem
from certrack.certificates.implemented.estimate import estimate_implemented
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.ranges.proofs import RangeProver
from certrack.certificates.ranges.vertices import VertexProgram
from certrack.certificates.scaling import Scaling
from certrack.certificates.scope import has_ranges
from certrack.certificates.search.decay_rate import NEARBY_SLOPE_ACCURACY
from certrack.certificates.search.riccati import RiccatiState
from certrack.certificates.semidefinite import (
    SemidefiniteProgram,
    Solution,
    best_solution,
)
from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.errors import InputError
from certrack.systems.system import System, require_system

#: By which part a bound that is begun nearby may be above the least, and what may be asked for.
NEARBY_ACCURACY, MAX_ACCURACY = NEARBY_SLOPE_ACCURACY / 2, 0.1


@dataclass(frozen=True)
class TubeEstimate:
    """|e_1(t)|^2 <= 2 V(0) e^(-alpha t) + bound^2 (1 - e^(-alpha t)), in floats.

    Attributes
    ----------
    start : float
        sqrt(2 V(0)).
    bound : float
    alpha : float, 1/s
    """

    start: float
    bound: float
    alpha: float

    def __call__(self, t: float | np.ndarray) -> float | np.ndarray:
        """The bound on |e_1| at the times t, s."""
        decayed = np.exp(-self.alpha * np.asarray(t, dtype=float))
        values = np.sqrt(self.start**2 * decayed + self.bound**2 * (1 - decayed))
        return values if np.ndim(t) else float(values)


@dataclass(frozen=True)
class BoundEstimate:
    """Bounds of limsup |e_1|, as far as floats tell: nothing is proven.

    Attributes
    ----------
    bound : float
        The smallest; inf if there is none.
    method : str
        Of it, as :func:`certrack.certify` calls it; empty if there is none.
    bounds : mapping of str to float
        By method.
    shares : mapping of str to float
        What each cause adds to the bound of `method`; empty where the method does not tell.
    tube : TubeEstimate or None
        From the system's own start, of the semidefinite bound.
    alpha : float, 1/s
        Of that bound; NaN if there is none.
    state : RiccatiState or None
        What a warm start needs besides.
    cascade : BestCascade or None
        The same of the cascade.
    reason : str
        Why there is none.
    """

    bound: float
    method: str
    bounds: Mapping[str, float]
    shares: Mapping[str, float] = field(default_factory=dict)
    tube: TubeEstimate | None = None
    alpha: float = math.nan
    state: RiccatiState | None = None
    cascade: BestCascade | None = None
    reason: str = ""

    def __repr__(self) -> str:
        if not self.method:
            return f"BoundEstimate(none, {self.reason})"
        return f"BoundEstimate({self.method}: limsup |e_1| about {self.bound:.4g}, not proven)"


@one_blas_thread
def estimate(
    system: System, *, warm: BoundEstimate | None = None, accuracy: float = NEARBY_ACCURACY
) -> BoundEstimate:
    """Estimate the certified error, many times faster than it is proven.

    The methods are those of :func:`certrack.certify`, without cells of ranges and
    anything exact. Never show the result as proven.

    Parameters
    ----------
    system : System
    warm : BoundEstimate, optional
        Of a system nearby: the searches begin where they ended there.
    accuracy : float
        With `warm`, by about which part the bound of a law with estimates may be above the least,
        0.1 at most. A quick look (1e-4) takes a fraction of the time, and does not try a centred
        stage that `warm` had little use for, until a gain has doubled since all were searched.

    Returns
    -------
    BoundEstimate

    Raises
    ------
    InputError
        If a bound of the reference can neither be proven nor is declared, or an argument is none
        of those above.

    Examples
    --------
    >>> import certrack
    >>> found = certrack.estimate(certrack.load("dual-motor-lean"))
    >>> found
    BoundEstimate(peak: limsup |e_1| about 0.001287, not proven)
    >>> sorted(found.shares)
    ['w_2 (state)', 'w_4', 'w_4 (state)', 'y_d^(2)']
    """
    require_system(system)
    if warm is not None and not isinstance(warm, BoundEstimate):
        raise InputError("warm", "must be what certrack.estimate returned", warm)
    accuracy = checks.real("accuracy", accuracy, above=0, most=MAX_ACCURACY)
    try:
        with within_floats():
            if system.implementation is not None:
                implemented = _of_the_drive(system)
                if implemented is not None:
                    return implemented
            return _ranged(system) if has_ranges(system) else _nominal(system, warm, 2 * accuracy)
    except NoCertificate as refusal:
        return BoundEstimate(math.inf, "", {}, reason=str(refusal))


def _of_the_drive(system: System) -> BoundEstimate | None:
    try:
        bound = estimate_implemented(system).bound
    except NoCertificate:
        return None
    return BoundEstimate(bound, "implemented", {"implemented": bound})


def _ranged(system: System) -> BoundEstimate:
    """By one quadratic function for all constants in their ranges."""
    prover = RangeProver(system)
    problems = [problem.in_floats() for problem in prover.problems(prover.box)]
    solution = best_solution(VertexProgram(problems))
    if solution is None:
        raise NoCertificate("no quadratic function was found for the whole box of constants")
    return BoundEstimate(solution.bound, "vertices", {"vertices": solution.bound})


def _nominal(system: System, warm: BoundEstimate | None, accuracy: float) -> BoundEstimate:
    problem = error_problem(system, decimal)
    near = None if warm is None or math.isnan(warm.alpha) else warm.alpha
    bounds: dict[str, float] = {}
    shares: dict[str, dict[str, float]] = {}
    cascade = None
    if problem.adaptation is None:
        peak = peak_estimate(in_plant_coordinates(problem), gradient=False)
        if math.isfinite(peak.bound):
            bounds["peak"] = peak.bound
            parts = zip(causes(problem), peak.shares.tolist(), strict=True)
            shares["peak"] = {name: share for name, share in parts if share}
        known = None if warm is None else warm.state
        solution, state = solution_nearby(problem, known, near, accuracy)
    else:
        scaling, quick = Scaling.of(problem), accuracy > NEARBY_SLOPE_ACCURACY
        scaling = scaling.alone() if quick and near is not None else scaling
        program = SemidefiniteProgram(problem, 0, scaling)
        solution, state = rate_nearby(program, near, accuracy), None
        if problem.n > 1:
            stages = None if warm is None else warm.cascade
            if warm is not None and stages is not None and warm.method != "cascade":
                stages = stages.in_vain()
            cascade = best_cascade(system, program, stages, accuracy)
    if solution is not None:
        bounds["semidefinite"] = solution.bound
        shares["semidefinite"] = _quadratic_shares(problem, solution)
    if cascade is not None:
        bounds["cascade"] = cascade.head.bound
        shares["cascade"] = _cascade_shares(cascade)
    if not bounds:
        raise NoCertificate("the uncertainty is too strong for this design; lower tau, or raise c")
    method = min(bounds, key=lambda kind: bounds[kind])
    return BoundEstimate(
        bounds[method],
        method,
        bounds,
        shares.get(method, {}),
        None if solution is None else _tube_of(system, problem, solution),
        math.nan if solution is None else solution.alpha,
        state,
        cascade,
    )


def _cascade_shares(cascade: BestCascade) -> dict[str, float]:
    """The bound of e_1, and in the place of its part by e_n what that is made of."""
    of_last, of_head = cascade.problems
    shares = _quadratic_shares(of_head, cascade.head, "e_n")
    through_last = shares.pop("e_n", 0.0)
    inner = _quadratic_shares(of_last, cascade.of_last, "estimates")
    total = sum(inner.values())
    for name, share in inner.items():
        shares[name] = shares.get(name, 0.0) + through_last * share / total
    return shares


def causes(problem: ErrorProblem) -> list[str]:
    """Names of the inputs of a problem."""
    a, b = problem.states
    names = [f"w_{k + 1} (state)" for k in a] + [f"w_{k + 1}" for k in b]
    names += [f"y_d^({i})" for i in problem.derivatives]
    return [name if names.count(name) == 1 else f"{name} {i + 1}" for i, name in enumerate(names)]


def _quadratic_shares(
    problem: ErrorProblem, solution: Solution, other: str = "estimates"
) -> dict[str, float]:
    """The bound, divided among the causes as Delta is; `other` has what is no cause by itself."""
    values = np.concatenate([solution.nu, solution.k])
    parts = {other: 0.0}
    for name, value in zip(_inputs(problem, other), values, strict=True):
        parts[name] = parts.get(name, 0.0) + float(value)
    if problem.adaptation is not None:
        parts["estimates"] = parts.get("estimates", 0.0) + float(
            solution.P[-1, -1] * problem.leakage(solution.alpha)
        )
    delta = solution.delta
    return {name: float(solution.bound * v / delta) for name, v in parts.items() if v}


def _inputs(problem: ErrorProblem, other: str) -> list[str]:
    """Names of the b-inputs and of the columns of the reference; `other` for those without."""
    named = causes(problem)[problem.counts[0] :]
    nb, order = len(problem.states[1]), len(problem.derivatives)
    b = [*named[:nb], *[other] * (problem.Ub.shape[1] - nb)]
    return [*b, *named[nb:], *[other] * (problem.Uy.shape[1] - order)]


def _tube_of(system: System, problem: ErrorProblem, solution: Solution) -> TubeEstimate | None:
    if system.truth.states:
        return None
    design, x0 = system.controller.coordinates, np.array(system.settings.x0)
    Y = np.array(system.reference.values(np.zeros(1), design.q))[:, 0]
    e = design.A @ x0 - design.B @ Y
    twice = float(e @ solution.P @ e)
    twice = max(twice, float(e[0]) ** 2)  # P >= e_1 e_1^T, but for rounding
    if problem.adaptation is not None:
        estimates = np.array(system.estimates, dtype=float)
        twice += 2 * float(solution.P[-1, -1] * problem.adaptation.energy(estimates))
    return TubeEstimate(math.sqrt(twice), solution.bound, solution.alpha)

"""The critical strength: the largest common scale of tau for which a certificate exists.

Only the a-inputs decide, |a_k| <= s ||x|| with scale s: everything else enters Delta, not the
question whether there is one. A certificate at s is one at every smaller scale: there is an edge.

    below  at the published strength, P = I with the design's own multipliers holds, for then
           Q = -(sum of squares of Young's inequality) - mu1 ||e||^2 with mu1 > 0 [34]
    above  a_k = s x_k is admissible and moves the trace of the error matrix by s tau_k gamma_k, so
           from s = -trace(S - C - K)/max tau_k gamma_k on an admissible loop is unstable

Between the two the scale is bisected, relatively, so that tau may be of any size; what is returned
has been verified exactly.
"""

from __future__ import annotations

import math

import numpy as np

from certrack.certificates.arithmetic import exact_float, positive_definite, rational
from certrack.certificates.certificate import Certificate, NoCertificate, within_floats
from certrack.certificates.exact import prove
from certrack.certificates.formulation import error_problem
from certrack.certificates.own_multipliers import own_multipliers
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.published import critical_strength
from certrack.certificates.search.strength_program import largest_strength
from certrack.certificates.semidefinite import SemidefiniteProgram, fastest_rate
from certrack.systems.system import System

#: Whether any certificate exists is asked at this part of the fastest alpha: a smaller alpha asks
#: less of the loop, and the solver copes with three decades.
SLOW_RATE = 1e-3

#: Part of min c that is asked of mu1 as alpha/2 at the published strength, which is rounded down
#: by more than that.
PUBLISHED_RATE = 1e-9

#: How far below the largest strength of a program it is tried to be proven, as parts.
BELOW_THE_LARGEST = (1e-6, 1e-5, 1e-4, 5e-4)

#: How far the multipliers give way there: of the strength it takes nothing.
STRENGTH_BACK_OFF = (1e-5, 1e-3)

#: The search for a first scale with a certificate goes this far below the largest possible one.
SMALLEST_PART = 1e-30


def critical_semidefinite(
    system: System, certified: Certificate | None = None, accuracy: float = 1e-3
) -> float:
    """Largest common scale of tau for which a certificate exists, verified exactly.

    Parameters
    ----------
    system : System
    certified : Certificate, optional
        The verified bound at scale 1, where it exists: it holds at every smaller scale, too, and
        its rate tells how slow the leakage lets V fall.
    accuracy : float
        Relative width of the bisection; the value returned is proven feasible.

    Returns
    -------
    float
        inf if no gamma-part acts, 0 if no certificate exists for this law at all. Not below the
        published strength.
    """
    try:
        exact = error_problem(system, rational)
    except NoCertificate:
        return 0.0
    if not exact.counts[0]:
        return math.inf
    holds = certified is not None and certified.verified
    slow = certified.alpha / 2 if holds and certified is not None else math.inf
    published = critical_strength(system)
    low = published if _holds_as_published(system, exact, published) else 0.0
    low = max(low, 1.0) if holds else low
    high = _limit(exact)
    strong = _by_one_program(exact, max(low, SMALLEST_PART * high), slow)
    if strong is not None:
        return strong
    trial = high
    while not low and trial > SMALLEST_PART * high:
        trial /= 10
        low = trial if _provable(exact, trial, slow) else 0.0
    while low and high > (1 + accuracy) * low:
        middle = math.sqrt(low) * math.sqrt(high)
        if _provable(exact, middle, slow):
            low = middle
        else:
            high = middle
    return low


def _by_one_program(exact: ErrorProblem, low: float, slow: float) -> float | None:
    """The strength of :func:`largest_strength`, a little lower, exactly verified.

    None where that is not above `low`, or is not confirmed.
    """
    try:
        with within_floats():
            unit = exact.homogeneous(rational(1)).in_floats()
            fastest = fastest_rate(unit)
            if not fastest > 0:
                return None
            strongest = largest_strength(unit, min(SLOW_RATE * fastest, slow))
            if strongest is None:
                return None
            for part in BELOW_THE_LARGEST:
                strength = strongest.strength * (1 - part)
                if strength <= low:
                    return None
                scaled = exact.homogeneous(exact_float(strength, rational))
                if prove(scaled, strongest.solution, back_off=STRENGTH_BACK_OFF) is not None:
                    return strength
    except NoCertificate:
        pass
    return None


def _limit(exact: ErrorProblem) -> float:
    """Scale from which on some admissible loop is unstable, so that no certificate exists."""
    trace = -float(sum(np.diag(exact.M)))
    through = exact.Xe @ exact.Ua
    return trace / max(abs(float(through[k, i])) for i, k in enumerate(exact.states[0]))


def _provable(exact: ErrorProblem, strength: float, slow: float) -> bool:
    """Whether the problem with scaled tau has an exactly verified certificate."""
    scaled = exact.homogeneous(exact_float(strength, rational))
    try:
        with within_floats():
            program = SemidefiniteProgram(scaled.in_floats())
            if not program.fastest > 0:
                return False
            solution = program.solve(min(SLOW_RATE * program.fastest, slow))
            return solution is not None and prove(scaled, solution) is not None
    except NoCertificate:
        return False


def _holds_as_published(system: System, exact: ErrorProblem, strength: float) -> bool:
    """Whether P = I and the design's own multipliers hold at the published strength, exactly."""
    if not 0 < strength < math.inf:
        return False
    scale = exact_float(strength, rational)
    scaled = exact.homogeneous(scale)
    lam = np.array([weight * scale**2 for weight in own_multipliers(system, exact)], dtype=object)
    rate = rational(PUBLISHED_RATE) * min(rational(c) for c in system.law.gains().c)
    slowest = SemidefiniteProgram(scaled.in_floats()).fastest
    alpha = min(rate, exact_float(SLOW_RATE * slowest, rational))
    none = np.zeros(0, dtype=object)
    P = np.eye(exact.n, dtype=object) + 0 * scale
    matrix = scaled.inequality(P, lam, none, none, alpha)
    return scaled.leakage(alpha) is not None and positive_definite(-matrix)

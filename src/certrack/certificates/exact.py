"""Verification in exact rational arithmetic: what is not confirmed here is not reported.

The solver's floats are rounded to decimals, the problem is rebuilt from the decimal text of the
system, and definiteness is decided by an exact LDL^T factorisation. If it fails, the certificate
gives way a little (larger multipliers, smaller alpha) and is checked again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Protocol

import flint
import numpy as np

from certrack.certificates.arithmetic import fraction, positive_definite
from certrack.certificates.assumptions import assumptions
from certrack.certificates.certificate import Certificate
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.semidefinite import Solution
from certrack.systems.system import System

#: Decimals kept of the solver's floats, nearly all of them. Fewer than 9 loosen the bounds of the
#: shipped systems; with 13, P of order 12, which is ill-conditioned, is only proven 4e-6 above.
PROOF_DIGITS = 16

#: How far a solution gives way, relatively, until the exact check confirms it. The first loosens a
#: bound by less than 1e-6; where the last fails, the solution is not worth having.
BACK_OFF = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)

#: Added to every lam, as part of its natural unit, so that a multiplier the solver put at zero
#: still leaves room in the matrix.
MULTIPLIER_FLOOR = 1e-12

#: Digits of a printed bound: it exceeds the exact one by a relative 1e-11 at most.
BOUND_DIGITS = 12

#: Limits of a decimal text in a certificate file; beyond them its rational would fill the memory.
MAX_TEXT_LENGTH, MAX_EXPONENT = 60, 400


@dataclass(frozen=True)
class Proof:
    """The numbers of a certificate as decimal texts; anyone can check them.

    Attributes
    ----------
    alpha : str
    P : rows of texts
    lam, nu, k : texts
        Multipliers of the a-inputs, the b-inputs and the reference derivatives.
    bound : str
        Decimal with bound^2 >= 2 Delta/alpha.
    shift : str
        kappa of a centred stage.
    """

    alpha: str
    P: tuple[tuple[str, ...], ...]
    lam: tuple[str, ...]
    nu: tuple[str, ...]
    k: tuple[str, ...]
    bound: str
    shift: str = "0"


class SharedNumbers(Protocol):
    """What the points of a proof share, as a solver returned it."""

    @property
    def alpha(self) -> float:
        """Decay rate, 1/s."""

    @property
    def P(self) -> np.ndarray:
        """Of V = e^T P e."""

    @property
    def delta(self) -> float:
        """Largest Delta."""


def prove(
    problem: ErrorProblem,
    solution: Solution,
    target: int = 0,
    back_off: Sequence[float] = BACK_OFF,
) -> Proof | None:
    """Round `solution` so that exact arithmetic confirms it; None if that does not succeed.

    Parameters
    ----------
    problem : ErrorProblem
        In exact rationals.
    solution : Solution
        What the solver returned.
    target : int
        Which e_i is bounded (from 0).
    back_off : floats
        How far it may give way.
    """
    parts = [(solution.lam, solution.nu, solution.k)]
    proofs = prove_together([problem], solution, parts, [solution.lam_unit], target, back_off)
    return None if proofs is None else proofs[0]


def prove_together(
    problems: Sequence[ErrorProblem],
    solution: SharedNumbers,
    multipliers: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    lam_units: Sequence[np.ndarray],
    target: int = 0,
    back_off: Sequence[float] = BACK_OFF,
) -> tuple[Proof, ...] | None:
    """Round P, alpha and each problem's multipliers; None if exact arithmetic does not confirm.

    Parameters
    ----------
    problems : ErrorProblem
        In exact rationals.
    solution : alpha, P and Delta
    multipliers : (lam, nu, k) for each problem
    lam_units : what a lam of 1 in the program is, for each problem
    target : int
        Which e_i is bounded (from 0).
    back_off : floats
        How far the solution may give way.

    Returns
    -------
    one Proof per problem
        They share P, alpha and the bound, the largest of all.
    """
    for slack in back_off:
        scale, extra = 1 + slack, slack * solution.delta
        P = scale * (solution.P + solution.P.T) / 2
        texts = tuple(tuple(decimal_text(v) for v in row) for row in P)
        alpha = decimal_text(solution.alpha * (1 - slack))
        largest, proofs = flint.fmpq(0), []
        for problem, (lam, nu, k), unit in zip(problems, multipliers, lam_units, strict=True):
            least = MULTIPLIER_FLOOR * unit
            lams = tuple(decimal_text(v * scale + w) for v, w in zip(lam, least, strict=True))
            nus, ks = (tuple(decimal_text(v * scale**2 + extra) for v in w) for w in (nu, k))
            proof = Proof(alpha, texts, lams, nus, ks, "0")
            square = squared_bound(problem, proof, target)
            if square is None:
                break
            largest = max(largest, square)
            proofs.append(proof)
        else:
            bound = root_up(largest)
            return tuple(replace(proof, bound=bound) for proof in proofs)
    return None


def proven(kind: str, system: System, proof: Proof) -> Certificate:
    """The certificate that `proof` allows to print: its bound as a float, rounded up."""
    exact, bound = from_text(proof.alpha), from_text(proof.bound)
    alpha, delta = float_down(exact), float_up(bound**2 * exact / 2)
    premises = tuple(assumptions(system))
    return Certificate(kind, float_up(bound), alpha, delta, True, assumptions=premises)


def failed_condition(problem: ErrorProblem, proof: Proof, target: int = 0) -> str:
    """Empty if the proof holds for the (exact) problem, else the first condition that fails."""
    P, lam, nu, k, alpha, bound = _exact_numbers(proof)
    n, counts = problem.n, problem.counts
    if P.shape != (n, n) or (len(lam), len(nu), len(k)) != counts:
        return "P or the multipliers do not have the shape of the system"
    if not (P == P.T).all():
        return "P is not symmetric"
    if problem.adaptation is not None and any(v != 0 for v in P[-1, :-1]):
        return "P couples e_n, so the update laws do not cancel the estimation errors"
    if not alpha > 0:
        return "alpha is not positive"
    if any(v < 0 for v in (*lam, *nu, *k)):
        return "a multiplier is negative"
    if problem.adaptation is not None and not problem.adaptation.gamma_is_positive_definite():
        return "Gamma is not positive definite"
    leak = problem.leakage(alpha)
    if leak is None:
        return "alpha exceeds what the leakage allows"
    floor = P.copy()
    floor[target, target] -= 1
    if not positive_definite(floor):
        return f"P - e_{target + 1} e_{target + 1}^T is not positive definite"
    if not positive_definite(-problem.inequality(P, lam, nu, k, alpha)):
        return "the matrix inequality does not hold"
    square = 2 * _delta(problem, P, nu, k, leak) / alpha
    if not (bound >= 0 and bound * bound >= square):
        return "the bound is smaller than what the inequality gives"
    return ""


def squared_bound(problem: ErrorProblem, proof: Proof, target: int = 0) -> Any:
    """2 Delta/alpha as an exact rational, or None if a condition fails."""
    P, lam, nu, k, alpha, _ = _exact_numbers(proof)
    if P.shape != (problem.n,) * 2 or (len(lam), len(nu), len(k)) != problem.counts:
        return None
    leak = problem.leakage(alpha)
    floor = P.copy()
    floor[target, target] -= 1
    if leak is None or not positive_definite(floor):
        return None
    if not positive_definite(-problem.inequality(P, lam, nu, k, alpha)):
        return None
    return 2 * _delta(problem, P, nu, k, leak) / alpha


def _delta(problem: ErrorProblem, P: np.ndarray, nu: np.ndarray, k: np.ndarray, leak: Any) -> Any:
    total = sum(nu, flint.fmpq(0)) + sum(k, flint.fmpq(0))
    return total + P[-1, -1] * leak if problem.adaptation is not None else total


def _exact_numbers(proof: Proof) -> tuple[Any, ...]:
    P = np.array([[from_text(v) for v in row] for row in proof.P], dtype=object)
    vectors = [
        np.array([from_text(v) for v in values], dtype=object)
        for values in (proof.lam, proof.nu, proof.k)
    ]
    return (P, *vectors, from_text(proof.alpha), from_text(proof.bound))


def from_text(text: str) -> Any:
    """Exact rational of a decimal text of sane length."""
    if (
        not isinstance(text, str)
        or len(text) > MAX_TEXT_LENGTH
        or not set(text) <= set("0123456789.eE+-")
    ):
        raise ValueError(f"not a decimal number: {text!r:.40}")
    exponent = text.lower().partition("e")[2]
    if exponent and abs(int(exponent)) > MAX_EXPONENT:
        raise ValueError(f"not a decimal number: {text!r:.40}")
    exact = Fraction(text)
    return flint.fmpq(exact.numerator, exact.denominator)


def decimal_text(value: float) -> str:
    """The digits of a float that a proof keeps."""
    return f"{value:.{PROOF_DIGITS}g}"


def root_up(square: Any) -> str:
    """Decimal of 12 digits that is not below the square root of a rational.

    An integer root rounds down, so one unit of the last digit is added; without it the printed
    bound would be below the proven one.
    """
    exact = fraction(square)
    if exact == 0:
        return "0"
    bits = exact.numerator.bit_length() - exact.denominator.bit_length()
    decade = math.floor(bits * math.log10(2) / 2)  # of the root, but for one up or down
    while Fraction(10) ** (2 * decade) > exact:
        decade -= 1
    while Fraction(10) ** (2 * decade + 2) <= exact:
        decade += 1
    places = BOUND_DIGITS - decade
    scaled = exact * Fraction(10) ** (2 * places)
    root = math.isqrt(scaled.numerator // scaled.denominator) + 1
    return f"{root}e{-places}"


def float_up(value: Any) -> float:
    """Smallest float not below a rational.

    Conversion rounds to the nearest float, which may be below: then the next one is taken.
    """
    try:
        near = float(value)
    except OverflowError:
        return math.inf
    while near < math.inf and flint.fmpq(*near.as_integer_ratio()) < value:
        near = math.nextafter(near, math.inf)
    return near


def float_down(value: Any) -> float:
    """Largest float not above a rational."""
    return -float_up(-value)

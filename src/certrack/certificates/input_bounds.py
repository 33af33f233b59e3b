"""How much input a law asks for, at most: energy over the run, root mean square, peak, long run.

For everything the assumptions admit, the law in continuous time, known parameters, a linear drift:

    int_0^T u^2 dt <= V(0) + T (sum nu + sum k m)    with V' + u^2 <= sum nu b^2 + sum k y^2
    |u(t)| <= sqrt(2 max(V(0), Delta/alpha)) + what reference and constant add to u directly,
                                                     with V' <= -alpha V + Delta, P >= row^T row

Every number is proven in exact rationals as the bounds of the error are. Energy and root mean
square are of u without the constant that cancels a drift h(0); where there is one, none is given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import positive_definite, rational
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.exact import (
    BACK_OFF,
    MULTIPLIER_FLOOR,
    Proof,
    decimal_text,
    float_up,
    from_text,
    root_up,
)
from certrack.certificates.formulation import error_coordinates
from certrack.certificates.input_problem import InputProblem, input_problem
from certrack.certificates.input_program import InputProgram, InputSolution
from certrack.certificates.mean_squares import mean_squares
from certrack.certificates.semidefinite import fastest_rate
from certrack.certificates.start import Start, starting_energy
from certrack.certificates.tube import intervals, starts_of
from certrack.systems.system import System, require_system

#: Rates that are tried for the peak, as parts of the fastest.
RATES = np.geomspace(0.02, 0.9, 8)

#: The bounds: of squares, and all.
ENERGIES = ("energy", "rms")
ALL_BOUNDS = (*ENERGIES, "peak", "ultimate")

#: Starts of a box that a program distinguishes: all corners of one of six states.
MAX_PROGRAM_STARTS = 64


@dataclass(frozen=True)
class InputBound:
    """One bound on the input, or on a state, and the numbers that prove it.

    Attributes
    ----------
    bound : float
        Rounded up.
    proof : Proof
        `bound` as a decimal that the check confirms; alpha is 0 for energies.
    """

    bound: float
    proof: Proof


@dataclass(frozen=True)
class InputBounds:
    """Bounds on the input.

    Attributes
    ----------
    energy : InputBound or None
        Of int_0^T u^2 dt over the run of the file, from its start.
    rms : InputBound or None
        Of the root of the mean of u^2 in the long run.
    peak, ultimate : InputBound or None
        Of |u(t)| from the start on, and in the long run.
    box : n intervals, optional
        The starts of energy and peak, if not x0 alone.
    reason : str
        Why there are none.
    missing : mapping of str to str
        Why one of the four is missing, by name.
    """

    energy: InputBound | None = None
    rms: InputBound | None = None
    peak: InputBound | None = None
    ultimate: InputBound | None = None
    box: tuple[tuple[float, float], ...] | None = None
    reason: str = ""
    missing: Mapping[str, str] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """The bounds, ready for JSON."""
        return {
            "energy": _value(self.energy),
            "rms_input": _value(self.rms),
            "peak_input": _value(self.peak),
            "ultimate_input": _value(self.ultimate),
            "box": None if self.box is None else [list(pair) for pair in self.box],
            "reason": self.reason,
            "missing": dict(self.missing),
        }


def _value(bound: InputBound | None) -> float | None:
    return None if bound is None else bound.bound


def certify_input(system: System, box: Sequence[tuple[float, float]] | None = None) -> InputBounds:
    """Bounds on the input of `system`, verified exactly.

    They rest on the premises of the certificates of the continuous law.

    Parameters
    ----------
    system : System
        Its reference, x0 and duration count.
    box : n intervals, optional
        Set of initial plant states; the system's x0 if left out.

    Returns
    -------
    InputBounds

    Raises
    ------
    InputError
        If the box does not fit the plant or has too many corners.

    Examples
    --------
    >>> import certrack
    >>> found = certrack.certificates.certify_input(certrack.load("dual-motor-lean"))
    >>> found.peak.bound < 13.91
    True
    """
    require_system(system)
    pairs = None if box is None else intervals(system.plant.n, box)
    try:
        starts, proven = starts_of(system, pairs)
        with within_floats():
            exact = input_problem(system)
            if not proven:
                raise NoCertificate("the start is not known exactly: the reference has no formula")
            duration = system.settings.duration
            bounds = InputBounds(
                *_energies(system, exact, starts, duration),
                peak=_peak(system, exact, starts),
                ultimate=ultimate_bound(system, exact),
                box=pairs,
            )
            return replace(bounds, missing=_missing(bounds, exact))
    except NoCertificate as refusal:
        return InputBounds(reason=str(refusal), box=pairs)


def _missing(bounds: InputBounds, exact: InputProblem) -> dict[str, str]:
    """Why some are missing."""
    reasons = dict.fromkeys(ALL_BOUNDS, "no proof was found")
    if exact.constant != 0:
        reasons |= dict.fromkeys(ENERGIES, "u cancels a constant drift, which it does for ever")
    return {name: reasons[name] for name in ALL_BOUNDS if getattr(bounds, name) is None}


def _energies(
    system: System, exact: InputProblem, starts: Sequence[Start], duration: float
) -> tuple[InputBound | None, InputBound | None]:
    if exact.constant != 0:
        return None, None
    floats = exact.in_floats()
    order = len(exact.through_y) - 1
    means = mean_squares(system, order, duration)
    program = InputProgram(floats, _errors(system, starts))
    energy = None
    solution = program.energy(duration, means.astype(float))
    for proof in () if solution is None else _as_proofs(solution):
        value = energy_bound(system, exact, proof, starts, duration, means)
        if value is not None:
            energy = _proven_bound(proof, value**2)
            break
    rms = None
    ones = np.array([rational(1)] * (order + 1), dtype=object)
    solution = InputProgram(floats).energy(1.0, ones.astype(float))
    for proof in () if solution is None else _as_proofs(solution):
        value = energy_bound(system, exact, proof, (), 1.0, ones)
        if value is not None:
            rms = _proven_bound(proof, value)
            break
    return energy, rms


def _proven_bound(proof: Proof, square: Any) -> InputBound:
    """The root of a rational, rounded up, with the proof of it."""
    text = root_up(square)
    return InputBound(float_up(from_text(text)), replace(proof, bound=text))


def ultimate_bound(system: System, exact: InputProblem) -> InputBound | None:
    """The bound in the long run of a row that stands beside the error system.

    Parameters
    ----------
    system : System
    exact : InputProblem
        Of the input, or of another row.

    Returns
    -------
    InputBound, or None where no proof is found.
    """
    return _peak(system, exact, ())


def _peak(system: System, exact: InputProblem, starts: Sequence[Start]) -> InputBound | None:
    """The smallest bound over the rates that are tried."""
    program = InputProgram(exact.in_floats(), _errors(system, starts))
    fastest = fastest_rate(exact.in_floats().problem)
    solutions = [program.peak(part * fastest) for part in RATES]
    for solution in sorted(filter(None, solutions), key=lambda entry: entry.value):
        for proof in _as_proofs(solution):
            square = peak_square(system, exact, proof, starts)
            if square is not None:
                largest = from_text(root_up(square)) + exact.direct
                return _proven_bound(proof, largest**2)
    return None


def _errors(system: System, starts: Sequence[Start]) -> list[np.ndarray]:
    """e(0) in floats."""
    design = error_coordinates(system, rational)
    A, B = design.A.astype(float), design.B.astype(float)
    errors = [
        A @ np.array([float(v) for v in x]) - B @ np.array([float(v) for v in Y]) for x, Y in starts
    ]
    if len(errors) > MAX_PROGRAM_STARTS:
        raise NoCertificate(f"a box of starts has more than {MAX_PROGRAM_STARTS} corners")
    return errors


def _as_proofs(solution: InputSolution) -> list[Proof]:
    """The solution as texts, giving way more and more."""
    proofs = []
    for slack in BACK_OFF:
        scale = 1 + slack
        P = scale * (solution.P + solution.P.T) / 2
        rows = tuple(tuple(decimal_text(v) for v in row) for row in P)
        extra = slack * max(solution.nu.sum() + solution.k.sum(), 1e-12 * solution.value)
        least = MULTIPLIER_FLOOR * (1 + solution.lam)
        groups = (
            solution.lam * scale + least,
            solution.nu * scale**2 + extra,
            solution.k * scale**2 + extra,
        )
        lam, nu, k = (tuple(decimal_text(v) for v in group) for group in groups)
        proofs.append(Proof(decimal_text(solution.alpha * (1 - slack)), rows, lam, nu, k, "0"))
    return proofs


def energy_bound(
    system: System,
    exact: InputProblem,
    proof: Proof,
    starts: Sequence[Start],
    duration: float,
    shares: np.ndarray,
) -> Any:
    """V(0) + T (sum nu + sum k m) as an exact rational; None where a condition fails."""
    numbers = _checked(exact, proof)
    if numbers is None or exact.constant != 0:
        return None
    P, lam, nu, k, alpha = numbers
    row = exact.over_all
    form = exact.problem.inequality(P, lam, nu, k, rational(0)) + np.outer(row, row)
    if alpha != 0 or not positive_definite(-form) or not positive_definite(P):
        return None
    total = rational(duration) * (sum(nu, flint.fmpq(0)) + sum(k * shares, flint.fmpq(0)))
    return total + (starting_energy(system, exact.problem, P, starts) if len(starts) else 0)


def peak_square(system: System, exact: InputProblem, proof: Proof, starts: Sequence[Start]) -> Any:
    """2 max(V(0), Delta/alpha) as an exact rational; None where a condition fails."""
    numbers = _checked(exact, proof)
    if numbers is None:
        return None
    P, lam, nu, k, alpha = numbers
    floor = P - np.outer(exact.row, exact.row)
    form = exact.problem.inequality(P, lam, nu, k, alpha)
    if not alpha > 0 or not positive_definite(-form) or not positive_definite(floor):
        return None
    level = (sum(nu, flint.fmpq(0)) + sum(k, flint.fmpq(0))) / alpha
    if len(starts):
        level = max(level, starting_energy(system, exact.problem, P, starts))
    return 2 * level


def failed_input(system: System, bounds: InputBounds) -> str:
    """Empty if the proofs of all bounds hold, else the first that does not."""
    exact, duration = input_problem(system), system.settings.duration
    starts, _ = starts_of(system, bounds.box)
    order = len(exact.through_y) - 1
    means = mean_squares(system, order, duration)
    ones = np.array([rational(1)] * (order + 1), dtype=object)
    for name, of, horizon, shares in (
        ("energy", starts, duration, means),
        ("rms", (), 1.0, ones),
        ("peak", starts, None, None),
        ("ultimate", (), None, None),
    ):
        bound: InputBound | None = getattr(bounds, name)
        if bound is None:
            continue
        if horizon is not None and shares is not None:
            value = energy_bound(system, exact, bound.proof, of, horizon, shares)
            largest = value if name == "rms" or value is None else value**2
        else:
            value = peak_square(system, exact, bound.proof, of)
            largest = None if value is None else (from_text(root_up(value)) + exact.direct) ** 2
        claimed = from_text(bound.proof.bound)
        if largest is None or claimed < 0 or claimed**2 < largest:
            return f"the proof of {name} does not hold"
        if rational(bound.bound) < claimed and bound.bound < float_up(claimed):
            return f"{name} is smaller than what is proven"
    return ""


def _checked(exact: InputProblem, proof: Proof) -> tuple[Any, ...] | None:
    """The exact numbers of a proof of the right shape and signs."""
    n = exact.problem.n
    P = np.array([[from_text(v) for v in row] for row in proof.P], dtype=object)
    lam, nu, k = (
        np.array([from_text(v) for v in group], dtype=object)
        for group in (proof.lam, proof.nu, proof.k)
    )
    if P.shape != (n, n) or not (P == P.T).all():
        return None
    if (len(lam), len(nu), len(k)) != exact.problem.counts:
        return None
    return None if any(v < 0 for v in (*lam, *nu, *k)) else (P, lam, nu, k, from_text(proof.alpha))

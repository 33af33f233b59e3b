"""The tube where gains move: |e_1(t)| from a start on, for every motion of the gains."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from certrack.certificates.arithmetic import rational, solve
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, float_down, float_up, from_text
from certrack.certificates.formulation import error_coordinates
from certrack.certificates.online.certify import OnlineProof, failed_online
from certrack.certificates.online.ends import end_problems
from certrack.certificates.start import starting_energy
from certrack.certificates.stated import first_end_system
from certrack.certificates.tube import TUBE_ROUNDING, Tube, starts_of, tube
from certrack.systems.system import System


def online_tube(
    system: System, proof: OnlineProof, box: Sequence[tuple[float, float]] | None = None
) -> Tube:
    """Bound on |e_1(t)| for every t and every motion of the gains.

    V(0) is linear in the level, where V moves along: the ends count.

    Parameters
    ----------
    system : System
        The one the proof is for; its reference at t = 0 and its initial estimates count.
    proof : OnlineProof
    box : n intervals, optional
        Set of initial plant states; the system's x0 if left out.

    Raises
    ------
    InputError
        If the box does not fit the plant or has too many corners.
    NoCertificate
        If the proof is of another system, or each start of the box has a reference of its own (a
        soft start).
    """
    if reason := failed_online(system, proof):
        raise NoCertificate(f"the proof does not hold for this system: {reason}")
    problems, first = end_problems(system), first_end_system(system)
    starts, verified = starts_of(system, box)
    begun = dict(zip(system.controller.states, system.estimates, strict=True))
    estimates = [begun[z] for z in first.controller.states]
    first = first.with_settings(estimates=tuple(estimates))
    A = error_coordinates(first, rational).A
    energies = []
    for problem, stage in zip(problems, proof.ends, strict=True):
        P = np.array([[from_text(v) for v in row] for row in stage.P], dtype=object)
        if problem.adaptation is None:  # P is of xi = A^-1 e
            P = solve(A.T, solve(A.T, P).T)
        energies.append(starting_energy(first, problem, P, starts))
    alpha, bound = from_text(proof.ends[0].alpha), from_text(proof.bound)
    floor = float_up(bound**2) * TUBE_ROUNDING
    return Tube(float_up(2 * max(energies)), floor, float_down(alpha), verified=verified)


def tube_of(system: System, stages: Sequence[Proof] | Sequence[OnlineProof]) -> Tube:
    """The tube that follows from quadratic functions, of gains that stand still or move."""
    first = stages[0]
    if isinstance(first, OnlineProof):
        return online_tube(system, first)
    return tube(system, [stage for stage in stages if isinstance(stage, Proof)])

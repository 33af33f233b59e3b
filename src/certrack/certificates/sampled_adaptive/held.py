"""The adaptive law as a drive runs it: which loops are covered, and their numbers.

At t_k = k T the controller measures x(t_k) + n_k, computes u_k = delta_hat_k ubar, which acts from
t_k + D until the next one does, and takes one step of its estimates. D is the largest of the delays
of the file: what is proven is monotone in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy

from certrack.certificates.arithmetic import exact_float, rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.drive import (
    NO_IMPLEMENTATION,
    sensor_errors,
    upper_rational_of,
)
from certrack.certificates.stated import stated_error_system
from certrack.core.expressions import TIME
from certrack.laws.error_system import EstimatedParameters
from certrack.laws.leakage import leak_jacobian
from certrack.references.base import lipschitz_bound
from certrack.systems.system import System


@dataclass(frozen=True)
class HeldLaw:
    """Numbers of the implementation, exact.

    Attributes
    ----------
    T, first : numbers
        The period, and D: before it `initial` acts, s.
    mu : (n,) tuple
        Bounds of the sensors' errors.
    eta : number
        Half a step of the converter.
    exact_leak : bool
        Whether a step of the estimates is exact for their leak; else it is Euler's.
    steepest : number
        Lipschitz constant of y_d^(q+1).
    initial : number
    saturation : pair or None
    projection : pairs, one per estimate, or None
        Of delta_hat, theta_hat.
    """

    T: Any
    first: Any
    mu: tuple[Any, ...]
    eta: Any
    exact_leak: bool
    steepest: Any
    initial: Any
    saturation: tuple[Any, Any] | None
    projection: tuple[tuple[Any, Any], ...] | None

    @property
    def reach(self) -> Any:
        """T + D: the input that acts is of a sample that is not older."""
        return self.T + self.first


def held_law(system: System) -> HeldLaw:
    """The implementation of `system`.

    Raises
    ------
    NoCertificate
        If the loop is not one that this room covers, with the reason.
    """
    drive = system.implementation
    if drive is None:
        raise NoCertificate(NO_IMPLEMENTATION)
    if not isinstance(stated_error_system(system), EstimatedParameters):
        raise NoCertificate("this is for the adaptive law")
    if reason := _left_out(system):
        raise NoCertificate(f"the adaptive law as implemented is not covered with {reason}")
    order = system.controller.coordinates.q + 1
    steepest = lipschitz_bound(system.reference, order)
    if steepest is None:
        raise NoCertificate(
            "the adaptive law as implemented needs a Lipschitz constant of "
            f"y_d^({order}), which jumps or has none: take a smoother reference"
        )
    T = rational(drive.period)
    exact_leak = drive.update == "exact_leak"
    if exact_leak and any(leak_jacobian(system.controller)[i] for i in _off_blocks(system)):
        raise NoCertificate("the leaks of delta_hat and theta_hat depend on each other")
    pairs = drive.projection
    return HeldLaw(
        T=T,
        first=T * max(rational(delay) for delay in drive.delays),
        mu=sensor_errors(drive, system.plant.n),
        eta=upper_rational_of(drive.input_quantum) / 2,
        exact_leak=exact_leak,
        steepest=exact_float(steepest, rational),
        initial=rational(drive.initial_input),
        saturation=None if drive.saturation is None else _pair(drive.saturation),
        projection=None if pairs is None else tuple(map(_pair, pairs)),
    )


def _pair(ends: tuple[float, float]) -> tuple[Any, Any]:
    low, high = ends
    return rational(low), rational(high)


def _off_blocks(system: System) -> list[int]:
    """Where the leak's matrix must be zero: between delta_hat, the first, and theta_hat."""
    count = len(system.controller.states)
    return [i for k in range(1, count) for i in (k, k * count)]


def _left_out(system: System) -> str:
    """What of the implementation has no proof here; empty if all has."""
    drive, law = system.implementation, system.law
    assert drive is not None
    if system.long_run is not system:
        return "a soft start of the reference"
    if law.observer is not None:
        return "law.observer"
    if law.sampled_feedforward:
        return "the reference fed forward as the sampled loop needs it"
    if drive.velocity:
        return "velocity: measure the states, or take the robust law"
    if drive.jitter:
        return "jitter"
    if drive.rate_limit is not None:
        return "rate_limit"
    if drive.offset:
        return "offset: let the first sample be at t = 0"
    if system.controller.equations.u.has(TIME):
        return "a law that contains the time"
    if any(sympy.sympify(rate).has(TIME) for _, rate in system.controller.equations.update):
        return "a law that contains the time"
    return ""

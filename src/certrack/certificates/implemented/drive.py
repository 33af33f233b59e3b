"""The loop of a system with an implementation as data, in exact rationals and balls.

    x' = A x + b u + W w,    |w_j| <= gamma_j ||S_j x|| + sum_i Delta_ji |x_i| + beta_j
    u_k = Lx (x(t_k) + n_k) + Ls s_k + Ly Y'_k + eta_k,    |n_k,i| <= mu_i,  |eta_k| <= eta
    s_{k+1} = Sx (x(t_k) + n_k) + Ss s_k + Sy Y'_k,        t_k = k T

with Y' = (y_d ... y_d^(q+1)); u_k acts from t_k + delay T on, until the next one does. A constant
in the drift is cancelled by a constant in u, which is left out here and kept as `offset`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import exact_float, rational, solve
from certrack.certificates.balls import ball_matrix, ball_of, upper_rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.formulation import error_coordinates
from certrack.certificates.implemented.channels import Channel
from certrack.certificates.implemented.controller_matrices import controller_matrices
from certrack.certificates.implemented.growing import GrowingBound
from certrack.certificates.scope import ranged_names, refuse_unknown
from certrack.certificates.stated import stated_error_system
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.laws.error_system import KnownParameters
from certrack.laws.integral import INTEGRAL
from certrack.laws.observer import KALMAN
from certrack.loops.feedforward import sampled_feedforward
from certrack.model.implementation import Implementation
from certrack.model.linear_drift import linear_parts, total_drift
from certrack.references.base import bound_of, jumps, lipschitz_bound
from certrack.systems.system import System


@dataclass(frozen=True)
class SlowBound:
    """w = s + f, |f| <= fast, |s'| <= rate + by_states |x'| between jumps of at most `jump`.

    Attributes
    ----------
    rate, jump, fast : rationals
    by_states : n rationals
    dwell : rational or None
        Least time between two jumps, s; None where there are none.
    """

    rate: Any
    by_states: tuple[Any, ...]
    jump: Any
    dwell: Any | None
    fast: Any


@dataclass(frozen=True)
class UncertainBound:
    """|w| <= gamma ||S x|| + Delta |x| + beta, for one column of W; all of it >= 0.

    Attributes
    ----------
    gamma, beta : rationals
    weights : rationals
        Diagonal of S: n, and zeros for the channels.
    Delta : rationals
        n, and of the channels.
    growing : GrowingBound or None
        In the place of gamma, Delta and beta, which are zero then.
    slow : SlowBound or None
        How fast w may change, where the controller makes something of it.
    """

    gamma: Any
    beta: Any
    weights: tuple[Any, ...]
    Delta: tuple[Any, ...]
    growing: GrowingBound | None = None
    slow: SlowBound | None = None


@dataclass(frozen=True)
class Drive:
    """What a certificate of the implemented loop is computed from.

    Attributes
    ----------
    A, b, W : ball matrices of n rows
    Lx, Ls, Ly : ball matrices of one row
    Sx, Ss, Sy : ball matrices of a row per memory
    first : (memories, n) ball matrix
        The memories before the first sample, over what it measures: its differences are zero, and
        an observer has not missed anything.
    first_input : (memories, 1) ball matrix
        The same over the input before the first sample.
    T : rational
        Period, s.
    delay : rational
        Periods.
    uncertain : one UncertainBound per column of W
    mu : n upper bounds of the sensors' errors, rationals
    eta : rational
        Half a step of the converter.
    Y : q + 2 rationals
        Bounds of y_d ... y_d^(q+1).
    lipschitz : rational or None
        Lipschitz constant of y_d^(q+1) between its jumps; None where it has none, or the jumps are
        closer than a period.
    jumps : (size, spacing), rationals, or None
        The largest jump of y_d^(q+1) and the least time between two of them, s; None if there is
        none, or one, which the long run forgets.
    jumps_once : bool
        Whether there is one.
    offset : rational
        The constant part of the law, which cancels that of the drift; not in u above.
    jitter : rational
        Samples and inputs may be off their times by so many periods.
    desired : (n, q + 1) ball matrix, or None
        The states where e = 0, over (y_d ... y_d^(q)); None if that is not known.
    channels : tuple of Channel
        Outputs beside the states, for ranges of constants.
    """

    A: flint.arb_mat
    b: flint.arb_mat
    W: flint.arb_mat
    Lx: flint.arb_mat
    Ls: flint.arb_mat
    Ly: flint.arb_mat
    Sx: flint.arb_mat
    Ss: flint.arb_mat
    Sy: flint.arb_mat
    first: flint.arb_mat
    first_input: flint.arb_mat
    T: Any
    delay: Any
    uncertain: tuple[UncertainBound, ...]
    mu: tuple[Any, ...]
    eta: Any
    Y: tuple[Any, ...]
    lipschitz: Any | None
    jumps: tuple[Any, Any] | None
    jumps_once: bool
    offset: Any
    jitter: Any = flint.fmpq(0)
    desired: flint.arb_mat | None = None
    channels: tuple[Channel, ...] = ()

    @property
    def n(self) -> int:
        """Order of the plant."""
        return self.A.nrows()

    @property
    def sized(self) -> int:
        """How many outputs bound what acts on the loop: the states and the channels."""
        return self.n + len(self.channels)

    @property
    def memories(self) -> int:
        """Number of the controller's memories."""
        return self.Ss.nrows()

    @property
    def q(self) -> int:
        """Order of the feed-forward."""
        return len(self.Y) - 2

    @property
    def periods_between_jumps(self) -> int:
        """Whole periods between two jumps of y_d^(q+1) at least; for `jumps` that are known."""
        assert self.jumps is not None
        return max(1, int((self.jumps[1] / self.T).floor()))


#: Bits of all balls of this room.
DRIVE_BITS = 256


def drive_of(system: System, delay: Any | None = None) -> Drive:
    """The implemented loop of a system.

    Parameters
    ----------
    system : System
    delay : rational, optional
        Periods; that of the file if left out.

    Raises
    ------
    NoCertificate
        If the loop is not one that this room covers, with the reason.
    """
    if system.implementation is not None and (ranged := open_names(system)):
        raise NoCertificate(f"plant.ranges lets {', '.join(ranged)} vary: {RANGED}")
    return nominal_drive(system, delay)


def open_names(system: System) -> list[str]:
    """What the law takes for known, although it has a range."""
    return ranged_names(system, refuse_unknown(system, integral=True))


def nominal_drive(system: System, delay: Any | None = None) -> Drive:
    """The same for the nominal constants, whatever has a range.

    Raises
    ------
    NoCertificate
        If the loop is not one that this room covers, with the reason.
    """
    implementation = system.implementation
    if implementation is None:
        raise NoCertificate(NO_IMPLEMENTATION)
    if not isinstance(stated_error_system(system, integral=True), KnownParameters):
        raise NoCertificate(
            "only loops that are linear are covered as implemented, and the adaptive law is not; "
            'use law.kind = "robust", or certrack margin for what samples say'
        )
    integral = [INTEGRAL] * (system.law.integral is not None)
    if system.controller.equations.u.has(TIME) or list(system.controller.states) != integral:
        raise NoCertificate("a law with the time or states of its own is not covered")
    sensors = sensor_errors(implementation, system.plant.n)
    with flint.ctx.workprec(DRIVE_BITS):
        return _drive(system, implementation, sensors, delay)


#: Why there is none without a table [implementation].
NO_IMPLEMENTATION = "the file has no [implementation]"

#: Why there is none where what the law takes for known has a range.
RANGED = "this is a question about one plant; certrack certify covers ranges cell by cell"


def _drive(
    system: System, implementation: Implementation, mu: tuple[Any, ...], delay: Any | None
) -> Drive:
    plant, n = system.plant, system.plant.n
    slopes, constant = linear_drift(system)
    if constant != 0 and system.law.observer is not None:
        # its rounded coefficients do not cancel the constant, as the law does
        raise NoCertificate(
            f"a constant in plant.drift ({float(constant):.6g}) is not covered together with "
            "law.observer: move the state's origin, or state it in plant.uncertainty.beta"
        )
    assert plant.input_gain is not None
    gain = rational(plant.input_gain)
    c = error_coordinates(system, rational)
    A = [[flint.fmpq(0)] * n for _ in range(n)]
    for i, g in enumerate(plant.chain):
        for j, value in enumerate(plant.linear[i] if plant.linear else ()):
            A[i][j] = rational(value)
        A[i][i + 1] += rational(g)
    A[n - 1] = slopes
    u = plant.uncertainty
    acting = [k for k in range(n) if u.tau[k] and u.acts(k)]
    K = [(v - h) / gain for v, h in zip(c.nu_x, slopes, strict=True)]
    nu_Y = list(c.nu_Y)
    if system.law.sampled_feedforward:
        corrected = sampled_feedforward(plant, system.controller, system.law, implementation)
        nu_Y = [exact_float(v, rational) for v in corrected]
    gains_of_u = [*K, *(v / gain for v in nu_Y)]
    gains_of_u += [] if c.integral is None else [c.integral.nu / gain]
    T = rational(implementation.period)
    return Drive(
        A=ball_matrix(A),
        b=ball_matrix([[flint.fmpq(0)]] * (n - 1) + [[gain]]),
        W=ball_matrix([[rational(u.tau[k]) if i == k else 0 for k in acting] for i in range(n)]),
        T=T,
        delay=rational(implementation.run_delay) if delay is None else delay,
        uncertain=tuple(_uncertain_bound(system, k) for k in acting),
        mu=mu,
        eta=upper_rational_of(implementation.input_quantum) / 2,
        Y=_reference_bounds(system, c.q),
        **_smoothness(system, c.q + 1, T),
        offset=-constant / gain,
        jitter=rational(implementation.jitter),
        desired=ball_matrix((solve(c.A, np.eye(n, dtype=object)) @ c.B).tolist()),
        **controller_matrices(system, implementation, gains_of_u),
    )


def estimates_disturbances(system: System) -> bool:
    """Whether the controller estimates what acts: else nothing is gained from how fast that is."""
    observer = system.law.observer
    estimated = observer is not None and observer.kind != KALMAN
    return estimated or system.law.integral is not None


def _slow_bound(system: System, k: int) -> SlowBound | None:
    slowness = system.plant.uncertainty.slowness(k)
    if slowness is None or not estimates_disturbances(system):
        return None
    return SlowBound(
        rational(slowness.rate),
        tuple(map(rational, slowness.by_states)),
        rational(slowness.jump),
        rational(slowness.dwell) if slowness.jump else None,
        rational(slowness.fast),
    )


def _uncertain_bound(system: System, k: int) -> UncertainBound:
    plant, u = system.plant, system.plant.uncertainty
    formula = u.formula(k)
    Delta = (0.0,) * plant.n if u.Delta is None else u.Delta[k]
    return UncertainBound(
        rational(u.gamma[k]),
        rational(u.beta[k]),
        tuple(map(rational, u.norm_weights(k))),
        tuple(map(rational, Delta)),
        None if formula is None else GrowingBound(formula.expr, plant.symbols),
        _slow_bound(system, k),
    )


def linear_drift(system: System) -> tuple[list[Any], Any]:
    """h + phi^T theta = slopes x + constant.

    Raises
    ------
    NoCertificate
        If it is not linear.
    """
    plant = system.plant
    total = total_drift(plant, plant.theta or ())
    parts = linear_parts(plant, total)
    if parts is None:
        raise NoCertificate(
            "only loops that are linear are covered as implemented: plant.drift (with the known "
            f"regressors) is {total}"
        )
    slopes, constant = parts
    return [rational(slope) for slope in slopes], rational(constant)


def sensor_errors(implementation: Implementation, n: int) -> tuple[Any, ...]:
    """|n_k,i|: half a step of the encoder, which rounds to the nearest, and the noise's bound.

    Raises
    ------
    NoCertificate
        If there is noise without a bound.
    """
    quanta = implementation.measurement_quantum or (0.0,) * n
    try:
        bounds = implementation.largest_noise(n)
    except InputError as problem:
        raise NoCertificate(str(problem)) from None
    return tuple(
        upper_rational_of(step) / 2 + upper_rational_of(bound)
        for step, bound in zip(quanta, bounds, strict=True)
    )


def upper_rational_of(value: float) -> Any:
    """Not below a number that may stand for an irrational one (2 pi/2^16 of an encoder)."""
    with flint.ctx.workprec(DRIVE_BITS):
        return upper_rational(ball_of(value))


def _reference_bounds(system: System, q: int) -> tuple[Any, ...]:
    try:
        bounds = [bound_of(system.reference, i)[0] for i in range(q + 2)]
    except InputError as problem:
        raise NoCertificate(
            f"the implemented loop needs bounds of the reference: {problem}"
        ) from None
    return tuple(exact_float(bound, rational) for bound in bounds)


def _smoothness(system: System, order: int, T: Any) -> dict[str, Any]:
    """Lipschitz constant and jumps of y_d^(order), as :class:`Drive` has them."""
    reference = system.reference
    steepest, jumping = lipschitz_bound(reference, order), None
    if steepest is None:
        steepest = lipschitz_bound(reference, order, between_jumps=True)
        jumping = jumps(reference, order)
        apart = jumping is not None and (math.isinf(jumping[1]) or rational(jumping[1]) >= T)
        if steepest is None or not apart:
            return {"lipschitz": None, "jumps": None, "jumps_once": False}
    once = jumping is not None and math.isinf(jumping[1])
    several = None if jumping is None or once else jumping
    return {
        "lipschitz": exact_float(steepest, rational),
        "jumps": None if several is None else tuple(exact_float(v, rational) for v in several),
        "jumps_once": once,
    }

"""The tube: a certified bound on |e_1(t)| for every t, from a start or a set of starts.

One stage. V' <= -alpha V + Delta and V >= e_1^2/2 give

    |e_1(t)|^2 <= 2 V(0) e^{-alpha t} + (2 Delta/alpha) (1 - e^{-alpha t})

which is the comparison principle [40] with alpha in the place of rho1/rho2.

The cascade. Its stages are inequalities that hold for every t, not only in the long run, if each
bound that an earlier stage supplies is taken at time t. With E and Z the bounds of e_n and zeta
that the matrix inequalities were scaled with, and k and nu the multipliers of these inputs,

    V_1' <= -alpha_1 V_1 + Delta_1                               and e_n^2 <= 2 V_1
    V_2' <= -alpha_2 V_2 + Delta_2 - nu (1 - (zeta(t)/Z)^2)      and e_n^2 <= 2 V_2
    V_3' <= -alpha_3 V_3 + Delta_3 - k (1 - (e_n(t)/E)^2)        and e_1^2 <= 2 V_3

The first is a tube for V_1, falling to its floor. So from a time t_i on 2 V_1 <= R_i^2, which
bounds zeta by Z(R_i), in interval arithmetic, for all t >= t_i; hence V_2 on [t_i, t_{i+1}]; hence
|e_n| by the smaller of the two; hence V_3. Where Z(R_i) does not exist, V_2 waits and starts with
what V_1 allows it. On each interval the right-hand sides are constants, so the bound is a chain of
pieces like that of one stage. The last piece begins where R_i and |e_n| are inside the bounds B_1
and E of the proof: they are rounded up, so that happens in finite time. From there on the tube
falls to the certificate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise, product, repeat
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import exact_float, positive_definite, rational
from certrack.certificates.balls import ball_of, ball_precision
from certrack.certificates.cascade import head_problem
from certrack.certificates.centred import RemainderBound, centred_problem
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import (
    Proof,
    float_down,
    float_up,
    from_text,
    root_up,
    squared_bound,
)
from certrack.certificates.formulation import error_problem
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.start import Start, reference_at_start, starting_energy, states_at_start
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.systems.system import System, require_system

#: Corners of a box of starts at which V is evaluated: all of a box in 12 states.
MAX_BOX_CORNERS = 4096

#: Factor on results of a few float operations, each of which may have rounded down by 1e-16.
TUBE_ROUNDING = 1 + 1e-12

#: Factor on every link of the chain of pieces, for a handful of float operations.
PIECE_ROUNDING = 1 + 1e-14

#: And for those of the exponent alpha t, which e^{-alpha t} multiplies by it.
LAPSED_ROUNDING = 4 * float(np.finfo(float).eps)

#: Beyond this exponent the decay is no float.
LONGEST_DECAY = 800.0

#: e^{-alpha t} is not taken smaller than this: the smallest float of full precision.
SMALLEST_DECAY = float(np.finfo(float).tiny)

#: From piece to piece of a cascade, what exceeds the floor falls by this factor. For Example 1 the
#: tube is then within 3 % of what a factor near 1 gives; 0.95 gives 1.2 % in twice the time.
PIECE_RATIO = 0.9

#: The weights with which the virtual parameters' offset is split from the estimation errors.
OFFSET_WEIGHTS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)


@dataclass(frozen=True)
class Tube:
    """Bound on |e_1(t)|.

    Attributes
    ----------
    start : float
        Square of the bound at t = 0: 2 V(0), rounded up.
    floor : float
        2 Delta/alpha, rounded up: the square of the certificate's bound.
    alpha : float, 1/s
        Rounded down.
    pieces : rows (time, square, floor)
        From each time on until the next, the square of the bound is
        square e^{-alpha (t - time)} + floor (1 - e^{-alpha (t - time)}). One piece if left out.
    verified : bool
        Whether the start is a rigorous bound. It is not where the reference or the states at t = 0
        have no rule of ball arithmetic; then it rests on their floats.
    """

    start: float
    floor: float
    alpha: float
    pieces: tuple[tuple[float, float, float], ...] = ()
    verified: bool = True

    def __call__(self, t: np.ndarray | float) -> np.ndarray:
        """The bound at times `t` >= 0, unit of the output."""
        times, squares, floors = np.array(self._chain).T
        t = np.asarray(t, dtype=float)
        if not (t >= 0).all():
            early = float(t[~(t >= 0)][0])
            raise InputError("t", "must be at least 0: the tube begins at the start", early)
        i = np.maximum(np.searchsorted(times, t, side="right") - 1, 0)
        lapsed = self.alpha * (t - times[i])
        decay = np.maximum(np.exp(-lapsed), SMALLEST_DECAY)
        square = squares[i] * decay - floors[i] * np.expm1(-lapsed)
        return np.sqrt(square) * TUBE_ROUNDING

    @property
    def _chain(self) -> tuple[tuple[float, float, float], ...]:
        return self.pieces or ((0.0, self.start, self.floor),)

    def settling_time(self, level: float) -> float:
        """Time after which |e_1| <= level is guaranteed, s; inf if it never is."""
        limit, chain = Fraction(level) ** 2, self._chain
        if max(chain[-1][1], self.floor) > limit and limit <= self.floor * TUBE_ROUNDING:
            return math.inf
        chain = (*chain, (math.inf, self.floor, self.floor))
        for (time, square, floor), (end, after, _) in reversed(list(pairwise(chain))):
            if after > limit or (square > limit and floor >= limit):
                return end
            if square > limit:
                ratio = (Fraction(square) - Fraction(floor)) / (limit - Fraction(floor))
                fall = math.log(math.nextafter(float(ratio), math.inf)) / self.alpha
                return min(time + fall * TUBE_ROUNDING, end)
        return 0.0


def tube(
    system: System,
    proof: Proof | Sequence[Proof],
    box: Sequence[tuple[float, float]] | None = None,
) -> Tube:
    """Tube of a proven certificate.

    Parameters
    ----------
    system : System
        The one the proof is for; its reference at t = 0 and its initial estimates count.
    proof : Proof, or the stages of a cascade
        The semidefinite certificate's proof, or ``Certificates.quadratic``.
    box : n intervals, optional
        Set of initial plant states; the system's x0 if left out. Where a premise holds in a region
        only, the tube is of starts within ``Certificates.starts_box``, whatever box is asked for.

    Returns
    -------
    Tube

    Raises
    ------
    InputError
        If the box does not fit the plant or has too many corners, or the proof is by cells.
    NoCertificate
        If the proof is of another system, a stage of a cascade has the bound 0, or each start of
        the box has a reference of its own (a soft start).

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> found = certrack.certify(system)
    >>> tube = certrack.certificates.tube(system, found.proof)
    >>> bool(tube(0.0) > tube(10.0) >= 0)
    True
    """
    require_system(system)
    stages = (proof,) if isinstance(proof, Proof) else tuple(proof)
    if not stages or not all(isinstance(stage, Proof) for stage in stages):
        raise InputError(
            "proof",
            "must be one to three stages: peak gains and cells say nothing of a transient",
            remedy="Take Certificates.quadratic",
        )
    problem = error_problem(system, rational)
    starts, verified = starts_of(system, box)
    if len(stages) > 1:
        return replace(_cascade_tube(system, problem, stages, starts), verified=verified)
    return Tube(*single_stage(system, problem, stages[0], starts), verified=verified)


def single_stage(
    system: System,
    problem: ErrorProblem,
    proof: Proof,
    starts: Sequence[Start],
    target: int = 0,
) -> tuple[float, float, float]:
    """2 V(0), 2 Delta/alpha and alpha of one stage."""
    square = squared_bound(problem, proof, target)
    if square is None:
        raise NoCertificate("the proof does not hold for this system: it is of another one")
    P = np.array([[from_text(v) for v in row] for row in proof.P], dtype=object)
    energy = starting_energy(system, problem, P, starts)
    floor = float_up(square) * TUBE_ROUNDING
    return float_up(2 * energy), floor, float_down(from_text(proof.alpha))


#: Times, and for each the largest 2 V (or e_n^2) from it until the next, as a multiple of the
#: square of the proof's bound; the last lasts for ever and is 1.
Steps = list[tuple[float, float]]


def _cascade_tube(
    system: System,
    problem: ErrorProblem,
    stages: Sequence[Proof],
    starts: Sequence[Start],
) -> Tube:
    """The chain of pieces of a cascade's last stage, from bounds on |e_n| in time."""
    *inner, last = stages
    target = problem.n - 1
    start, _, alpha = single_stage(system, problem, inner[0], starts, target)
    steps = _fall(start, alpha, problem, inner[0], target)
    if len(inner) > 1:
        steps = _centred_steps(system, problem, inner, starts, steps)
    head = head_problem(problem, from_text(inner[-1].bound))
    square, floor, alpha = single_stage(system, head, last, starts)
    share = 2 * from_text(last.k[-1]) / from_text(last.alpha)  # of e_n in the floor
    total, pieces = squared_bound(head, last), []
    for (time, ratio), (end, _) in pairwise((*steps, (math.inf, 1.0))):
        level = _level(total, share, ratio)
        pieces.append((time, square, level))
        square = _later(square, level, alpha, end - time)
    return Tube(pieces[0][1], floor, alpha, tuple(pieces))


def _level(square: Any, share: Any, ratio: float) -> float:
    """2 Delta/alpha, rounded up, with one input's share of it scaled by `ratio`."""
    return float_up(square + share * (exact_float(ratio, rational) - 1)) * TUBE_ROUNDING


def _later(square: float, floor: float, alpha: float, lapsed: float) -> float:
    """2 V after some time, rounded up."""
    decay = max(math.exp(-alpha * lapsed), SMALLEST_DECAY)
    rounding = PIECE_ROUNDING + LAPSED_ROUNDING * min(alpha * lapsed, LONGEST_DECAY)
    return (square * decay - floor * math.expm1(-alpha * lapsed)) * rounding


def _fall(
    start: float,
    alpha: float,
    problem: ErrorProblem,
    proof: Proof,
    target: int,
    begin: float = 0.0,
) -> Steps:
    """Steps of 2 V of one stage from `start` at the time `begin`, down to the proof's bound."""
    floor, limit = squared_bound(problem, proof, target), from_text(proof.bound) ** 2
    if not limit > floor:
        raise NoCertificate("a tube needs bounds of the stages above what their inequalities give")
    gap = (limit - floor) / limit
    excess = (exact_float(start, rational) - floor) / limit
    time, steps, part = begin, [], exact_float(PIECE_RATIO, rational)
    while excess > gap:
        steps.append((time, float_up(floor / limit + excess)))
        excess = exact_float(float_up(excess * part), rational)
        time += -math.log(PIECE_RATIO) / alpha * TUBE_ROUNDING
    return [*steps, (time, 1.0)]


def _centred_steps(
    system: System,
    problem: ErrorProblem,
    inner: Sequence[Proof],
    starts: Sequence[Start],
    steps: Steps,
) -> Steps:
    """Steps of e_n^2 by the centred stage, given those of 2 V of the first stage."""
    reached, proof = inner
    target, shift = problem.n - 1, from_text(proof.shift)
    centred = centred_problem(system, problem, reached, shift)
    square, _, alpha = single_stage(system, centred, proof, starts, target)
    has_zeta = centred.counts[1] > problem.counts[1]
    share = 2 * from_text(proof.nu[-1]) / from_text(proof.alpha) if has_zeta else rational(0)
    floor, bound2 = squared_bound(centred, proof, target), from_text(reached.bound) ** 2
    limit, allowed = from_text(proof.bound) ** 2, _allowed(problem, inner)
    growths = _growths(RemainderBound(system, problem), reached, steps) if has_zeta else repeat(1.0)
    result: Steps = []
    for ((time, ratio), (end, _)), growth in zip(pairwise(steps), growths, strict=False):
        level2 = exact_float(ratio, rational) * bound2  # 2 V_1 from here on
        square = min(square, allowed(level2))
        if math.isfinite(growth):
            level = _level(floor, share, growth)
            after = _later(square, level, alpha, end - time)
        else:  # zeta has no bound on so large a set
            after = math.inf
        largest = min(float_up(level2), max(square, after))
        result.append((time, float_up(exact_float(largest, rational) / limit)))
        square = after
    time = steps[-1][0]
    square = min(square, allowed(bound2))
    for at, ratio in _fall(square, alpha, centred, proof, target, time):
        largest = min(ratio, float_up(bound2 / limit)) if ratio != 1.0 else 1.0
        result.append((at, largest))
    return result


def _growths(zeta: RemainderBound, reached: Proof, steps: Steps) -> Iterator[float]:
    """The square of zeta on each step's set, as a multiple of that on the smallest; inf without."""
    bound2, smallest = from_text(reached.bound) ** 2, zeta(reached)
    squares = [exact_float(ratio, rational) * bound2 for _, ratio in steps[:-1]]
    sizes = zeta.in_floats(reached, np.array(list(map(float_up, squares))))
    for square, size in zip(squares, sizes.tolist(), strict=True):
        try:
            if math.isfinite(size):
                largest = exact_float(size, rational)
            else:  # other intervals may know more
                largest = zeta(replace(reached, bound=root_up(square)))
        except NoCertificate:
            yield math.inf
        else:
            yield float_up((largest / smallest) ** 2)


def _allowed(problem: ErrorProblem, inner: Sequence[Proof]) -> Callable[[Any], float]:
    """What 2 V of the centred stage can be where 2 V of the first is at most a level.

    2 V_2 <= mu e^T P_1 e + s_2 (N + kappa N_0)^2 with P_2 <= mu P_1, s_1 N^2 the estimates' part of
    2 V_1, and N_0 the length of (delta, theta) in the same norm.
    """
    law = problem.adaptation
    assert law is not None
    P, Q = (np.array([[from_text(v) for v in row] for row in proof.P]) for proof in inner)
    guess = np.linalg.eigvals(np.linalg.solve(P.astype(float), Q.astype(float))).real.max()
    mu = exact_float(float(guess) * (1 + 1e-9), rational)
    while not positive_definite(mu * P - Q):
        mu *= 2
    zero = np.zeros(1 + len(law.Gamma), dtype=object) + rational(0)
    offset2 = 2 * from_text(inner[1].shift) ** 2 * law.energy(zero)
    lines = []
    for weight in map(rational, OFFSET_WEIGHTS):
        steep = max(mu, Q[-1, -1] / P[-1, -1] * (1 + weight))
        lines.append((steep, Q[-1, -1] * (1 + 1 / weight) * offset2))
    return lambda level: float_up(min(steep * level + offset for steep, offset in lines))


def starts_of(
    system: System, box: Sequence[tuple[float, float]] | None
) -> tuple[list[Start], bool]:
    """Starts at which the convex V can be largest, and whether their numbers are proven.

    Raises
    ------
    InputError
        If the box does not fit the plant or has too many corners.
    NoCertificate
        If each start of a box has a reference of its own.
    """
    corners = None if box is None else _corners(system.plant.n, box)
    if corners is not None and system.long_run is not system:
        raise NoCertificate(
            "reference.transient joins each start by a reference of its own, so a set of starts "
            "has no bound in common: leave the box or reference.transient out"
        )
    with ball_precision():
        Y, proven = reference_at_start(system, system.controller.coordinates.q)
        if corners is None:
            x, known = states_at_start(system)
            return [(x, Y)], proven and known
        return [(list(map(ball_of, corner)), Y) for corner in corners], proven


def intervals(n: int, box: Any) -> tuple[tuple[float, float], ...]:
    """A box of plant states as n pairs of floats.

    Raises
    ------
    InputError
    """
    entries = checks.sequence("box", box, n, "[low, high] per state")
    return tuple(checks.ordered_pair(f"box[{i}]", pair) for i, pair in enumerate(entries))


def _corners(n: int, box: Any) -> list[tuple[float, ...]]:
    distinct = [tuple(dict.fromkeys(pair)) for pair in intervals(n, box)]
    if math.prod(map(len, distinct)) > MAX_BOX_CORNERS:
        raise InputError("box", f"must have at most {MAX_BOX_CORNERS} corners", n)
    return list(product(*distinct))

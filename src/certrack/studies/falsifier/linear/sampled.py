"""The loop with a sampled controller, as a chain: a jump at every sample, and cells between."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from certrack.core.expressions import symbol
from certrack.loops.stability import LinearLoop, linear_loop
from certrack.model.implementation import NOISE_BOUND_DEVIATIONS, Implementation
from certrack.references import jumps, lipschitz_bound
from certrack.studies.falsifier.linear.chain import Chain, HeldStep, Jump
from certrack.studies.falsifier.linear.continuous import REFERENCE_PIECES, STEP_PART, horizon_of
from certrack.studies.falsifier.outputs import ERROR, ERROR_NAME, STATE, SoughtOutput
from certrack.systems.system import System

#: Samples in a run, at most: slower loops would take minutes.
MAX_CHAIN_SAMPLES = 50_000

#: The last piece of a reference that may jump seldom is one period long, or so many times as long
#: as the next shorter one, up to the length of all others.
LAST_PIECES = 8

#: Steps in a period, at most.
MOST_STEPS_PER_PERIOD = 16


def sampled_chain(
    system: System, bounds: tuple[float, ...], output: SoughtOutput = ERROR
) -> Chain | None:
    """The chain of a system with an implementation, whose truth has the constants of the case.

    Parameters
    ----------
    system : System
        Limits of the input are left out; half a step of each sensor counts as noise.
    bounds : Y_0 ... Y_m
        Of a :class:`ReferenceClass`.
    output : SoughtOutput
        What is made large: the input is that which acts at the end.

    Returns
    -------
    Chain, or None where the loop is not linear, unstable or too slow.
    """
    implementation, loop = system.implementation, linear_loop(system)
    if implementation is None or loop is None or system.truth.states:
        return None
    T, delay = implementation.period, implementation.run_delay
    radius = loop.radius(T, delay)
    if not 0 < radius < 1:
        return None
    periods = math.ceil(horizon_of(-math.log(radius) / T, system.plant.n) / T)
    if periods > MAX_CHAIN_SAMPLES:
        return None
    u, m = system.plant.uncertainty, len(bounds) - 1
    acting = tuple(k for k in range(system.plant.n) if u.tau[k] > 0 and u.acts(k))
    cells, lengths = _cells(loop, acting, T, delay, m)
    start, N = _start(system, loop, delay, m), len(loop.b)
    size = N + len(loop.controller.states) + math.floor(delay) + 2
    row = np.zeros(size + m)
    if output.kind == ERROR_NAME:
        row[:N], row[size] = loop.C[0], -1.0
    elif output.kind == STATE:
        row[:N] = loop.C[output.place]
    else:
        row[N + len(loop.controller.states) + math.floor(delay)] = 1.0
    return Chain(
        uncertainty=u,
        states=system.plant.states,
        acting=acting,
        jump=_jump(loop, T, delay, m),
        cells=tuple(cells),
        lengths=tuple(lengths),
        row=row,
        start=start,
        bounds=bounds,
        noise=largest_sensor_errors(implementation, system.plant.n),
        pieces=np.full(REFERENCE_PIECES, math.ceil(periods / REFERENCE_PIECES)),
    )


def with_jumps(chain: Chain, references: ReferenceClass) -> list[Chain]:
    """The chain with pieces as the class admits them.

    Where y_d^(q+1) jumps, the last jump may be any time before the end, and just after a sample:
    the law sees it a period later.
    """
    if references.jump == math.inf and not references.spacing:
        return [chain]
    least = max(1, math.ceil(min(references.spacing / chain.period, chain.periods)))
    stride = max(least, int(chain.pieces[0]))
    lasts = {min(stride, LAST_PIECES**i) for i in range(stride.bit_length() + 1)}
    chains = []
    for last in sorted(lasts):
        count = max(1, math.ceil((chain.periods - last) / stride))
        pieces = np.array([*[stride] * count, last])
        chains += [
            replace(chain, pieces=pieces, late=late, largest_jump=references.jump)
            for late in (False, True)
        ]
    return chains


def noise_bounds(implementation: Implementation, n: int) -> np.ndarray:
    """The largest noise of each sensor; of normal noise without a bound, what is likely."""
    if implementation.noise_bound is not None:
        return np.array(implementation.noise_bound)
    return NOISE_BOUND_DEVIATIONS * np.array(implementation.noise or (0.0,) * n)


def largest_sensor_errors(implementation: Implementation, n: int) -> np.ndarray:
    """The largest error of each sensor, half a step of it included.

    In floats, and apart from those of the certificates, which are held against what is found here.
    """
    half: np.ndarray = np.array(implementation.measurement_quantum or (0.0,) * n) / 2
    return noise_bounds(implementation, n) + half


@dataclass(frozen=True)
class ReferenceClass:
    """References that a proof for a sampled loop admits.

    Attributes
    ----------
    bounds : Y_0 ... Y_m
        m is q + 2 where y_d^(q+1) has a largest slope, else q + 1.
    spacing : float, s
        Least time between two jumps of y_d^(q+1); 0 where there is no such time.
    jump : float
        Their largest size.
    """

    bounds: tuple[float, ...]
    spacing: float = 0.0
    jump: float = math.inf


def reference_class(system: System, bounds: tuple[float, ...]) -> ReferenceClass:
    """References within Y_0 ... Y_{q+1} whose y_d^(q+1) moves as that of the system may."""
    order = len(bounds) - 1
    slope = lipschitz_bound(system.reference, order)
    if slope is not None:
        return ReferenceClass((*bounds, slope))
    known = jumps(system.reference, order)
    if known is None or lipschitz_bound(system.reference, order, between_jumps=True) is None:
        return ReferenceClass(bounds)
    return ReferenceClass(bounds, spacing=known[1], jump=known[0])


def _jump(loop: LinearLoop, T: float, delay: float, m: int) -> Jump:
    """A sample: the law is evaluated, its command is the newest of those that wait."""
    N, n, memories = len(loop.b), len(loop.C), len(loop.controller.states)
    commands = math.floor(delay) + 2
    law, size = loop.law_matrix(T), N + memories + commands
    by_Y = law[:, n + memories :]
    J = np.eye(size + m)
    J[N:size] = 0.0
    order = [N + memories, *range(N, N + memories)]  # where the rows of the law go
    for place, values, of_Y in zip(order, law, by_Y, strict=True):
        J[place, :N] = values[:n] @ loop.C
        J[place, N : N + memories] = values[n : n + memories]
        count = min(m, len(of_Y))
        J[place, size : size + count] = of_Y[:count]
    for i in range(1, commands):
        J[N + memories + i, N + memories + i - 1] = 1.0
    by_noise, by_reference = np.zeros((size + m, n)), np.zeros(size + m)
    by_noise[order] = law[:, :n]
    if by_Y.shape[1] > m:
        by_reference[order] = by_Y[:, m]
    return Jump(J, by_noise, by_reference)


def _cells(
    loop: LinearLoop, acting: tuple[int, ...], T: float, delay: float, m: int
) -> tuple[list[HeldStep], list[float]]:
    N, memories, full = len(loop.b), len(loop.controller.states), math.floor(delay)
    size = N + memories + full + 2
    fastest = float(np.abs(np.linalg.eigvals(loop.A)).max(initial=0.0))
    cells, lengths = [], []
    for part, command in ((delay - full, full + 1), (1 - delay + full, full)):
        if part <= 0:
            continue
        steps = min(MOST_STEPS_PER_PERIOD, max(1, math.ceil(part * T * fastest / STEP_PART)))
        h = part * T / steps
        cells += [_cell(loop, acting, h, N + memories + command, size, m)] * steps
        lengths += [h] * steps
    return cells, lengths


def _cell(
    loop: LinearLoop, acting: tuple[int, ...], h: float, command: int, size: int, m: int
) -> HeldStep:
    N, inputs, tau = len(loop.b), len(acting), loop.system.plant.uncertainty.tau
    A = np.zeros((size + m + inputs + 1, size + m + inputs + 1))
    A[:N, :N], A[:N, command] = loop.A, loop.b
    for j, k in enumerate(acting):
        A[k, size + m + j] = tau[k]
    for i in range(m - 1):
        A[size + i, size + i + 1] = 1.0
    A[size + m - 1, -1] = 1.0
    step = expm(A * h)[: size + m]
    return HeldStep(step[:, : size + m], step[:, size + m : -1], step[:, -1], np.zeros(size + m))


def _start(system: System, loop: LinearLoop, delay: float, m: int) -> np.ndarray:
    """The loop where the nominal error is zero, after a rest at the same place."""
    c, N = system.controller.coordinates, len(loop.b)
    x = np.zeros((N, m))
    x[:, : c.q + 1] = np.linalg.solve(c.A, c.B)
    states = list(loop.controller.states)
    start = np.zeros((N + len(states) + math.floor(delay) + 2 + m, m))
    start[:N] = x
    for i, name in enumerate(system.plant.states[1:]):
        before = symbol(f"ctl_before_{name}")
        if before in states:
            start[N + states.index(before)] = x[i]
    start[-m:] = np.eye(m)
    return start

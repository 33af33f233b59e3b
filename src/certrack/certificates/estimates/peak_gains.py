"""The bound by peak gains in floats, and its gradient: one pass forward, one back.

The states xi of a linear error loop answer to bounded inputs with the kernels e^{Mt} B, and

    |xi_j| <= sum_l G_jl (size of input l),     G = int_0^inf |e^{Mt} B| dt

The sizes of what grows with the state are a fixed point v = F(v) of the states' bounds. The kernels
are followed on a grid whose step doubles from block to block, by products with powers of
E = e^{Mh}, and the derivative of the bound goes back through the same products: that of all entries
of M and B costs about as much as the bound itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, expm_frechet

from certrack.certificates.estimates.loop_data import DataGradient
from certrack.certificates.problem import ErrorProblem

#: The first step is this part of the fastest time constant; a block has two to this power steps,
#: and the step of each block is twice that of the one before.
FIRST_STEP, BLOCK_POWER = 0.03, 7

#: The kernels are followed until the slowest mode has fallen to this; blocks at most, which is a
#: stiffness of 1e9.
LEFT_OVER, BLOCK_LIMIT = 1e-7, 40

#: Steps of the fixed point, and what counts as standing still.
MOST_PASSES, PASS_ACCURACY = 200, 1e-13

#: A bound that grew to this has no fixed point.
DIVERGED = 1e30


@dataclass(frozen=True)
class PeakEstimate:
    """A bound by peak gains, as far as floats tell.

    Attributes
    ----------
    bound : float
        Of limsup |e_1|; inf if there is none.
    shares : (na + nb + ny,) array
        What each input of the problem adds to it.
    gradient : DataGradient or None
        Of the bound.
    """

    bound: float
    shares: np.ndarray
    gradient: DataGradient | None


#: What there is where there is no bound.
NO_PEAK = PeakEstimate(math.inf, np.zeros(0), None)


@dataclass(frozen=True)
class _Kernels:
    """e^{Mt} B on a grid of blocks.

    Attributes
    ----------
    step : float
        h of the first block.
    powers : matrices
        E^(2^i): those of block b begin at i = b.
    stacks : lists of arrays (n, 2^i, columns), for each block
        As they double; the last one has all nodes of the block.
    """

    step: float
    powers: list[np.ndarray]
    stacks: list[list[np.ndarray]]


def peak_estimate(
    problem: ErrorProblem, *, gradient: bool = True, step: float | None = None
) -> PeakEstimate:
    """The bound by peak gains of a problem without estimates, in plant coordinates.

    Parameters
    ----------
    problem : ErrorProblem
        In floats, with x = e + Xy y.
    gradient : bool
        Whether its gradient is wanted; the step is held fixed in it.
    step : float, optional
        First step of the grid, s; a part of the fastest time constant if left out.
    """
    na, nb, _ = problem.counts
    B = np.hstack([problem.Ua, problem.Ub, problem.Uy])
    poles = np.linalg.eigvals(problem.M)
    slowest = -float(poles.real.max())
    if not slowest > 0 or not np.isfinite(B).all():
        return NO_PEAK
    step = FIRST_STEP / float(np.abs(poles).max()) if step is None else step
    kernels = _kernels(problem.M, B, step, slowest)
    gains = _integrals_of_magnitude(kernels)
    fixed = _fixed_point(problem, gains, na)
    if fixed is None:
        return NO_PEAK
    sizes, slope = fixed
    shares = gains[0] * sizes
    estimate = PeakEstimate(float(shares.sum()), shares, None)
    if not gradient:
        return estimate
    weights = _weights(gains, sizes, slope, na)
    by_M, by_B = _back(kernels, problem.M, weights)
    return PeakEstimate(estimate.bound, shares, DataGradient(by_M, by_B[:, na + nb :]))


def _kernels(M: np.ndarray, B: np.ndarray, step: float, slowest: float) -> _Kernels:
    end = math.log(1 / LEFT_OVER) / slowest
    power, start, t = expm(M * step), B, 0.0
    powers, stacks = [power], []
    for block in range(BLOCK_LIMIT):
        while len(powers) < block + BLOCK_POWER + 1:
            powers.append(powers[-1] @ powers[-1])
        doubled = [start[:, None, :]]
        for i in range(BLOCK_POWER):
            last = doubled[-1]
            moved = (powers[block + i] @ last.reshape(len(M), -1)).reshape(last.shape)
            doubled.append(np.concatenate([last, moved], axis=1))
        stacks.append(doubled)
        start = powers[block + BLOCK_POWER] @ start
        t += step * 2.0 ** (block + BLOCK_POWER)
        if t >= end:
            break
    return _Kernels(step, powers, stacks)


def _nodes(kernels: _Kernels, block: int) -> np.ndarray:
    """The values at both ends of every step of a block, (n, steps + 1, columns)."""
    values = kernels.stacks[block][-1]
    after = kernels.powers[block + BLOCK_POWER] @ values[:, 0]
    return np.concatenate([values, after[:, None]], axis=1)


def _integrals_of_magnitude(kernels: _Kernels) -> np.ndarray:
    """int |e^{Mt} B| dt: the kernels as straight lines from node to node."""
    total = 0.0
    for block in range(len(kernels.stacks)):
        a, b = _step_ends(kernels, block)
        size = np.abs(a) + np.abs(b)
        crossing = a * b < 0
        line = np.where(crossing, (a**2 + b**2) / np.where(size > 0, size, 1.0), size) / 2
        total = total + kernels.step * 2.0**block * line.sum(axis=1)
    return np.asarray(total)


def _step_ends(kernels: _Kernels, block: int) -> tuple[np.ndarray, np.ndarray]:
    nodes = _nodes(kernels, block)
    return nodes[:, :-1], nodes[:, 1:]


def _fixed_point(
    problem: ErrorProblem, gains: np.ndarray, na: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Sizes of the inputs at the states' bounds v, and by v the slope of the a-inputs' sizes."""
    n = problem.n
    static = np.abs(problem.Xy).sum(axis=1)
    sizes = np.ones(gains.shape[1])
    constant = static + gains[:, na:].sum(axis=1)
    norms = _absolute_norms(problem, na)
    v = constant.copy()
    for _ in range(MOST_PASSES if na else 0):
        sizes[:na] = [np.linalg.norm(S @ v) for S in norms]
        after = constant + gains[:, :na] @ sizes[:na]
        if not np.isfinite(after).all() or after.max() > DIVERGED:
            return None
        still = bool((np.abs(after - v) <= PASS_ACCURACY * after).all())
        v = after
        if still:
            break
    else:
        if na and not _newton(constant, gains[:, :na], norms, v):
            return None
    slope = np.zeros((na, n))
    for i, S in enumerate(norms):
        image = S @ v
        size = float(np.linalg.norm(image))
        sizes[i] = size
        if size > 0:
            slope[i] = S.T @ image / size
    return sizes, slope


def _newton(
    constant: np.ndarray, through: np.ndarray, norms: list[np.ndarray], v: np.ndarray
) -> bool:
    """Whether a slow fixed point has a limit; v becomes it."""
    for _ in range(MOST_PASSES):
        images = [S @ v for S in norms]
        sizes = np.array([np.linalg.norm(image) for image in images])
        slope = np.array(
            [
                S.T @ image / (size or 1.0)
                for S, image, size in zip(norms, images, sizes, strict=True)
            ]
        )
        loop = through @ slope
        if np.abs(np.linalg.eigvals(loop)).max() >= 1:
            return False
        step = np.linalg.solve(np.eye(len(v)) - loop, constant + through @ sizes - v)
        v += step
        if (np.abs(step) <= PASS_ACCURACY * np.abs(v)).all():
            return bool((v > 0).all())
    return False


def _absolute_norms(problem: ErrorProblem, na: int) -> list[np.ndarray]:
    """For each a-input the S with |a| <= ||S v||."""
    selections = problem.selections or (None,) * na
    eye = np.eye(problem.n)
    return [eye if part is None else np.abs(part[0]) for part in selections]


def _weights(gains: np.ndarray, sizes: np.ndarray, slope: np.ndarray, na: int) -> np.ndarray:
    """Derivative of the bound by every entry of the gains, by the implicit function theorem."""
    n = len(gains)
    weights = np.zeros_like(gains)
    weights[0] = sizes
    if na:
        loop = gains[:, :na] @ slope  # dF/dv
        through = gains[0, :na] @ slope
        adjoint = np.linalg.solve((np.eye(n) - loop).T, through)
        weights += adjoint[:, None] * sizes[None, :]
    return weights


def _back(kernels: _Kernels, M: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of sum weights * gains by M and by B."""
    by_powers = [np.zeros_like(power) for power in kernels.powers]
    by_next = np.zeros_like(kernels.stacks[0][0][:, 0])  # by the first node of the next block
    for block in reversed(range(len(kernels.stacks))):
        h = kernels.step * 2.0**block
        by_nodes = _by_nodes(*_step_ends(kernels, block), h, weights)
        stack = kernels.stacks[block]
        last, jump = by_nodes[:, -1] + by_next, block + BLOCK_POWER
        by_stack = by_nodes[:, :-1].copy()
        by_powers[jump] += last @ stack[0][:, 0].T
        by_stack[:, 0] += kernels.powers[jump].T @ last
        for i in reversed(range(BLOCK_POWER)):
            half = 2**i
            second, power = by_stack[:, half:], kernels.powers[block + i]
            by_powers[block + i] += np.tensordot(second, stack[i], axes=((1, 2), (1, 2)))
            by_stack = by_stack[:, :half] + np.tensordot(power.T, second, axes=(1, 0))
        by_next = by_stack[:, 0]
    for i in reversed(range(len(kernels.powers) - 1)):
        power, after = kernels.powers[i], by_powers[i + 1]
        by_powers[i] += after @ power.T + power.T @ after
    by_exponential = expm_frechet(M.T * kernels.step, by_powers[0], compute_expm=False)
    return kernels.step * by_exponential, by_next


def _by_nodes(a: np.ndarray, b: np.ndarray, h: float, weights: np.ndarray) -> np.ndarray:
    """Derivative of the weighted integrals by the kernels' values at the nodes."""
    size = np.abs(a) + np.abs(b)
    safe = np.where(size > 0, size, 1.0)
    crossing = a * b < 0
    mean = (a**2 + b**2) / safe**2
    by_a = np.where(crossing, (2 * a / safe - mean * np.sign(a)), np.sign(a)) / 2
    by_b = np.where(crossing, (2 * b / safe - mean * np.sign(b)), np.sign(b)) / 2
    scaled = h * weights[:, None, :]
    n, steps, columns = a.shape
    total = np.zeros((n, steps + 1, columns))
    total[:, :-1] += by_a * scaled
    total[:, 1:] += by_b * scaled
    return total

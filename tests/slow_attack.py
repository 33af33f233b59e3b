"""The worst that a sampled linear loop can be driven to by what changes slowly.

Random rates, jumps and fast parts; the worst slow signal by a linear program over the kernels of
:mod:`sampled_attack`, which shares nothing with the certificates, simulated step by step.
"""

import math
from copy import copy
from dataclasses import replace

import numpy as np
from sampled_attack import GROWTH, STEPS, SampledLoop
from scipy import sparse
from scipy.optimize import linprog

#: Times at which a signal may change its slope: dense before the end, at most so many.
DENSER, NODES = 1.03, 60


def with_random_rates(system, rng):
    """The system with random rates, jumps and fast parts of what acts."""
    u, n, speed = system.plant.uncertainty, system.plant.n, max(system.law.c)
    rate = [float(rng.choice([0, 0.01, 0.1, 1, 5])) * b * speed for b in u.beta]
    rate = [r if rng.random() < 0.85 else math.inf for r in rate]
    known = [r < math.inf for r in rate]
    fast = [float(rng.choice([0, 0.1, 1])) * b * k for b, k in zip(u.beta, known, strict=True)]
    jump = [float(rng.choice([0, 0.3, 2])) * b * k for b, k in zip(u.beta, known, strict=True)]
    values = {"rate": rate, "fast": fast}
    if rng.random() < 0.6 and any(jump):
        values |= {"jump": jump, "dwell": float(rng.choice([0.3, 1, 3, 10])) / speed}
    if rng.random() < 0.6:
        values["Delta_rate"] = [[g * k] * n for g, k in zip(u.gamma, known, strict=True)]
    return system.replace(plant=replace(system.plant, uncertainty=replace(u, **values)))


def fed_back(loop, slopes):
    """The loop with w_k = slopes_k x, for each w that acts."""
    steps = []
    for step in loop.steps:
        step = step.copy()
        step[: loop.n, : loop.n] += loop.through_w @ slopes
        steps.append(step)
    loop = copy(loop)
    loop.steps = steps
    return loop


def worst_slow_error(
    system, amplitude, frequency, forgotten=1e-7, most=3000, feedback=None, within=0.0
):
    """The largest |e_1| found at several places of a period.

    With `feedback`, slopes over x for each w that acts, slopes x is a part of w; where that is more
    than gamma ||x||, `within` of beta is kept for it, and it is asserted that this is enough.
    """
    loop = SampledLoop(system)
    loop = loop if feedback is None else fed_back(loop, feedback)
    fed = np.zeros((0, loop.n)) if feedback is None else feedback
    periods = min(int(math.log(forgotten) / math.log(loop.radius)) + 20, most)
    places = sorted({0, loop.switch, STEPS // 2})
    return max(
        _error(system, loop, place, periods, amplitude, frequency, (fed, within))
        for place in places
    )


def _error(system, loop, place, periods, amplitude, frequency, feedback):
    (fed, within), u = feedback, system.plant.uncertainty
    end = periods * loop.T + place * loop.h
    acting = [k for k in range(system.plant.n) if u.tau[k] and u.acts(k)]
    row = np.eye(len(loop.jump))[0]
    weights = _weights(loop, row, place, periods)
    signals = [_signal(u, k, weights[:, j], loop.h, within) for j, k in enumerate(acting)]
    signals = [(v, 0 * s if fed[j : j + 1].any() else s) for j, (v, s) in enumerate(signals)]
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False) if amplitude else np.zeros(1)
    angles, sides = (v.ravel() for v in np.meshgrid(angles, [1.0, -1.0]))
    orders = np.arange(loop.q + 2)[:, None]

    def reference(t):
        turned = frequency * (t - end) + angles + orders * np.pi / 2
        return amplitude * frequency**orders * np.sin(turned)

    chi, i = np.zeros((len(row), len(angles))), 0
    for k, (of_w, of_noise, of_step) in enumerate(loop.signs(row, place, periods)):
        chi = loop.jump @ chi + np.outer(loop.noise @ (loop.mu * of_noise), sides)
        chi += loop.forward @ reference(k * loop.T)
        chi[loop.newest] += loop.eta * of_step * sides
        for p in range(len(of_w)):
            norm = GROWTH * np.linalg.norm(chi[: loop.n], axis=0)
            w = [v[i] + s[i] * g * norm for (v, s), g in zip(signals, loop.gamma, strict=True)]
            for row_of_x, k, g in zip(fed, acting, loop.gamma, strict=False):
                assert (
                    abs(row_of_x @ chi[: loop.n]) <= within * u.beta[k] + g * norm / GROWTH
                ).all()
            chi = loop.steps[p] @ chi
            chi[: loop.n] += loop.through_w @ (np.array(w).reshape(-1, len(sides)) * sides)
            i += 1
    return float(np.abs(row @ chi - reference(end)[0]).max())


def _weights(loop, row, place, periods):
    """What a unit of each w, held over a step, adds to the row at the end; the oldest first."""
    steps = []
    for k in range(periods, -1, -1):
        for p in range(place - 1 if k == periods else STEPS - 1, -1, -1):
            steps.append(row[: loop.n] @ loop.through_w)
            row = row @ loop.steps[p]
        row = row @ loop.jump
    return np.array(steps[::-1]).reshape(len(steps), -1)


def _signal(u, k, weights, h, within):
    """Values of w_k step by step, and the sign of what grows with the state."""
    slowness, signs = u.slowness(k), np.sign(weights)
    if slowness is None:
        return signs * u.beta[k], signs
    values = _worst_slow(weights, h, u.beta[k] * (1 - within) - slowness.fast, slowness)
    follows = all(slope >= u.gamma[k] for slope in slowness.by_states)
    return values + slowness.fast * signs, 0 * signs + follows * np.sign(weights.sum())


def _worst_slow(weights, h, size, slowness):
    """The best of linear programs with jumps at several places, `dwell` apart."""
    count, ends, gap = len(weights), [len(weights)], 1.0
    while ends[-1] > 0:
        ends.append(max(0, ends[-1] - int(gap)))
        gap = min(gap * DENSER, max(1, count / NODES))
    middle, best = np.arange(count) + 0.5, (-math.inf, np.zeros(count))
    apart = math.ceil(slowness.dwell / h) if slowness.jump else 0
    for first in [0, *range(1, apart + 1, max(1, apart // 6))]:
        jumps = np.arange(count - first, 0, -apart) if first else np.zeros(0)
        nodes = np.unique(np.concatenate([ends, jumps]))
        nodes = np.repeat(nodes, 1 + np.isin(nodes, jumps))
        after = np.clip(np.searchsorted(nodes, middle), 1, len(nodes) - 1)
        share = (middle - nodes[after - 1]) / (nodes[after] - nodes[after - 1])
        gain = np.bincount(after, share * weights, len(nodes))
        gain += np.bincount(after - 1, (1 - share) * weights, len(nodes))
        moves = sparse.diags([-1.0, 1.0], [0, 1], shape=(len(nodes) - 1, len(nodes)))
        limits = np.diff(nodes) * h * slowness.rate + slowness.jump * (np.diff(nodes) == 0)
        scale = np.abs(gain).max() or 1.0
        solved = linprog(
            -gain / scale,
            A_ub=sparse.vstack([moves, -moves]),
            b_ub=np.tile(limits, 2),
            bounds=(-size, size),
            method="highs",
        )
        if solved.x is not None and -solved.fun * scale > best[0]:
            held = (1 - share) * solved.x[after - 1] + share * solved.x[after]
            best = -solved.fun * scale, held
    return best[1] * (1 - 1e-7)  # HiGHS keeps its limits within 1e-7

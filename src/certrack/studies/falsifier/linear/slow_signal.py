"""The worst signals that change slowly: a linear program over their values at some times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.optimize import linprog

from certrack.model.slowness import follows_growth
from certrack.studies.falsifier.linear.chain import Chain, Kernels
from certrack.studies.falsifier.linear.pattern import sign_formula

#: Times at which a slow signal may change its slope, at most.
MAX_SLOW_NODES = 90

#: Keeps a signal below its bounds in spite of rounding.
WITHIN = 1 - 1e-9


@dataclass(frozen=True)
class SlowSignal:
    """w_k of one input: straight from time to time, and a part that jumps between two values.

    Attributes
    ----------
    times, values : (nodes,) arrays
    fast : float
        Size of the part that jumps.
    weights, edges : arrays
        Of its sign; see :func:`~certrack.studies.falsifier.linear.pattern.sign_formula`.
    growth : {1, -1, 0}
        Sign of what grows with the state, where that may follow the states; else 0.
    """

    times: np.ndarray
    values: np.ndarray
    fast: float
    weights: np.ndarray
    edges: np.ndarray
    growth: int = 0

    def held(self) -> np.ndarray:
        """The values in the middle of the cells."""
        middle = (self.edges[1:] + self.edges[:-1]) / 2
        slow: np.ndarray = np.interp(middle, self.times, self.values)
        return slow + self.fast * np.sign(self.weights)

    def formula(self, sense: int) -> str:
        """As a formula of t: a straight line, and a kink at every time but the first.

        After the last one it stands still.
        """
        if not self.values.any() and not self.fast:
            return "0"
        slopes = np.append(np.diff(self.values) / np.diff(self.times), 0.0)
        kinks = np.diff(slopes) / 2
        inner = self.times[1:]
        slope = float(slopes[0] + slopes[-1]) / 2
        begin = float(self.values[0] - slope * self.times[0])
        begin -= float(np.abs(self.times[0] - inner) @ kinks)
        terms = [f"{sense * begin!r}", f"({sense * slope!r})*t"]
        terms += [
            f"({sense * kink!r})*abs(t - {at!r})"
            for kink, at in zip(kinks.tolist(), inner.tolist(), strict=True)
            if kink
        ]
        if self.fast:
            terms.append(f"{sense * self.fast!r}*{sign_formula(self.weights, self.edges)}")
        return " + ".join(terms)


def slow_signals(chain: Chain, seen: Kernels) -> Mapping[int, SlowSignal]:
    """The worst signals, by number of the input, of those whose speed is bounded."""
    edges = np.concatenate([[0.0], np.cumsum(np.tile(chain.lengths, chain.periods))])
    signals: dict[int, SlowSignal] = {}
    for j, k in enumerate(chain.acting):
        slowness = chain.uncertainty.slowness(k)
        if slowness is None:
            continue
        weights = seen.disturbance[:, :, j].ravel()
        size = chain.uncertainty.beta[k] - slowness.fast
        times, values = _worst(weights, edges, size * WITHIN, slowness.rate * WITHIN)
        fast = slowness.fast * WITHIN
        growth = int(np.sign(weights.sum())) if follows_growth(chain.uncertainty, k) else 0
        signals[j] = SlowSignal(times, values, fast, weights, edges, growth)
    return signals


def _worst(
    weights: np.ndarray, edges: np.ndarray, size: float, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times, and values with the largest sum of weights times values at the cells' middles."""
    middle = (edges[1:] + edges[:-1]) / 2
    measure = np.cumsum(np.abs(weights)) + 1e-300
    measure = measure / measure[-1] + 0.2 * middle / middle[-1]
    inside = np.interp(np.linspace(0, measure[-1], MAX_SLOW_NODES)[1:-1], measure, middle)
    times = np.unique(np.concatenate([[0.0], inside, edges[-1:]]))
    after = np.clip(np.searchsorted(times, middle), 1, len(times) - 1)
    share = (middle - times[after - 1]) / (times[after] - times[after - 1])
    gain = np.bincount(after, share * weights, len(times))
    gain += np.bincount(after - 1, (1 - share) * weights, len(times))
    count = len(times)
    moves = sparse.diags([-1.0, 1.0], [0, 1], shape=(count - 1, count))
    solved = linprog(
        -gain / (np.abs(gain).max() or 1.0),
        A_ub=sparse.vstack([moves, -moves]),
        b_ub=np.tile(rate * np.diff(times), 2),
        bounds=(-size, size),
        method="highs",
    )
    if solved.x is None:
        return times, np.full(count, size * np.sign(weights.sum()))
    return times, _within(times, solved.x, size, rate)


def _within(times: np.ndarray, values: np.ndarray, size: float, rate: float) -> np.ndarray:
    """The values, made smaller where the program's tolerance left their bounds."""
    steepest = float((np.abs(np.diff(values)) / np.diff(times)).max(initial=0.0))
    largest = float(np.abs(values).max(initial=0.0))
    factor = min(1.0, size / largest if largest else 1.0)
    if steepest * factor > rate:
        if not rate:
            return np.full(len(values), float(np.clip(values.mean(), -size, size)))
        factor = rate / steepest
    return factor * values

"""A linear loop over a long time, step by step, forwards and backwards.

The state z holds the loop's own states, the plant's first, and y_d ... y_d^(m-1) last. A period is
a jump (a sample, where the controller is sampled) and cells between which inputs are held:

    jump   z <- J z + J_n n + J_r y_d^(m)            n: errors of the sensors
    cell   z <- E z + G w + E_r y_d^(m) + E_o        w_j = s_j bound_j(x), |s_j| <= 1

Backwards, the row whose product with z is the error at the end becomes its *kernels*: what an input
does to that error, however long ago it acts. Where the bound of w_j grows with the state, it is
linear along the run that was computed last, and goes back with the row.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from certrack.certificates.worst_profile import WorstProfile
from certrack.model.growth import GrowthInFloats
from certrack.model.uncertainty import Uncertainty

#: A norm below this has no direction.
LEAST_NORM = 1e-300


@dataclass(frozen=True)
class HeldStep:
    """A stretch of a period: the matrices of the module's text."""

    E: np.ndarray
    G: np.ndarray
    by_reference: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True)
class Jump:
    """A sample: the matrices of the module's text."""

    J: np.ndarray
    by_noise: np.ndarray
    by_reference: np.ndarray


@dataclass(frozen=True)
class Chain:
    """A loop whose error at the end of `periods` is to be made large.

    Attributes
    ----------
    uncertainty : Uncertainty
    acting : numbers of the states whose w_k acts, from 0
    jump : Jump or None
    cells : tuple of HeldStep
    lengths : of the cells, s
    row : (N,) array
        The error is row @ z; another output has the two numbers below besides.
    start : (N, m) array
        z at the beginning, from y_d ... y_d^(m-1).
    bounds : Y_0 ... Y_m
    noise : largest error of each sensor
    pieces : (pieces,) array of int
        How many periods each piece of the reference lasts.
    late : bool
        Whether pieces begin just after a sample, which then sees the one before.
    largest_jump : float
        The largest that y_d^(m) may make between pieces.
    states : names of the plant's states
        Where bounds are formulas of them.
    through, level : float
        What y_d^(m) adds to the output at once, and a constant.
    """

    uncertainty: Uncertainty
    acting: tuple[int, ...]
    jump: Jump | None
    cells: tuple[HeldStep, ...]
    lengths: tuple[float, ...]
    row: np.ndarray
    start: np.ndarray
    bounds: tuple[float, ...]
    noise: np.ndarray
    pieces: np.ndarray
    late: bool = False
    largest_jump: float = math.inf
    states: tuple[str, ...] = ()
    through: float = 0.0
    level: float = 0.0

    @property
    def period(self) -> float:
        """Length of a period, s."""
        return float(sum(self.lengths))

    @property
    def periods(self) -> int:
        """In all."""
        return int(self.pieces.sum())

    @cached_property
    def piece_at(self) -> tuple[np.ndarray, np.ndarray]:
        """Number of the piece in each period, and of the one that its sample sees."""
        inside = np.repeat(np.arange(len(self.pieces)), self.pieces)
        return inside, np.concatenate([inside[:1], inside[:-1]]) if self.late else inside

    @property
    def widths(self) -> np.ndarray:
        """Of the pieces, s."""
        return self.pieces * self.period

    @property
    def n(self) -> int:
        """Order of the plant."""
        return len(self.uncertainty.tau)

    @cached_property
    def _weights(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """S_k, gamma_k, beta_k and the rows of Delta of the w that act."""
        u, acting, n = self.uncertainty, list(self.acting), self.n
        S = np.array([u.norm_weights(k) for k in acting]).reshape(len(acting), n)
        Delta = np.zeros((n, n)) if u.Delta is None else np.array(u.Delta)
        return S, np.array(u.gamma)[acting], np.array(u.beta)[acting], Delta[acting]

    @cached_property
    def _growing(self) -> dict[int, GrowthInFloats]:
        """Bounds that are formulas, by the number of their input."""
        formulas = {j: self.uncertainty.formula(k) for j, k in enumerate(self.acting)}
        return {j: GrowthInFloats(f, self.states) for j, f in formulas.items() if f is not None}

    def bound(self, x: np.ndarray) -> np.ndarray:
        """The bounds of the w that act, at a state."""
        S, gamma, beta, Delta = self._weights
        norm = np.sqrt(((S * x) ** 2).sum(axis=1))
        limits: np.ndarray = gamma * norm + beta + Delta @ np.abs(x)
        for j, grown in self._growing.items():
            limits[j] = grown.value(x, norm[j])
        return limits

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of these bounds by states (..., n): (..., inputs, n)."""
        S, gamma, _, Delta = self._weights
        scaled = S * x[..., None, :]
        norm = np.sqrt((scaled**2).sum(axis=-1, keepdims=True))
        by_norm = gamma[:, None] * S * scaled / np.maximum(norm, LEAST_NORM)
        rows: np.ndarray = by_norm + Delta * np.sign(x[..., None, :])
        for j, grown in self._growing.items():
            size, at = norm[..., j, 0], np.moveaxis(x, -1, 0)
            *by_size, by_norm = grown.slopes(at, size)
            unit = S[j] * scaled[..., j, :] / np.maximum(size, LEAST_NORM)[..., None]
            rows[..., j, :] = np.moveaxis(by_size * np.sign(at), 0, -1) + by_norm[..., None] * unit
        slow = [self.uncertainty.slowness(k) is not None for k in self.acting]
        rows[..., slow, :] = 0.0  # what changes slowly is a function of time here
        return rows


class Kernels(NamedTuple):
    """What inputs do to the error at the end.

    Attributes
    ----------
    disturbance : (periods, cells, inputs) array
    noise : (periods, sensors) array
    reference : (m + pieces,) array
        Of y_d ... y_d^(m-1) at the beginning, and of y_d^(m) on each piece.
    """

    disturbance: np.ndarray
    noise: np.ndarray
    reference: np.ndarray


class Motion(NamedTuple):
    """A run of the chain.

    Attributes
    ----------
    error : float
        At the end.
    states : (periods, cells, n) array
        Of the plant, at the begin of each cell.
    """

    error: float
    states: np.ndarray


def kernels(chain: Chain, motion: Motion | None = None) -> Kernels:
    """The kernels; along a motion, bounds that grow with the state are as large as there."""
    m, inputs = len(chain.bounds) - 1, len(chain.acting)
    disturbance = np.zeros((chain.periods, len(chain.cells), inputs))
    noise = np.zeros((chain.periods, len(chain.noise)))
    reference, (inside, sampled) = np.zeros(m + len(chain.pieces)), chain.piece_at
    slopes = None if motion is None else chain.slopes(motion.states)
    row = chain.row.copy()
    reference[m + inside[-1]] += chain.through
    for k in range(chain.periods - 1, -1, -1):
        for c in range(len(chain.cells) - 1, -1, -1):
            cell = chain.cells[c]
            reference[m + inside[k]] += row @ cell.by_reference
            kernel = row @ cell.G
            disturbance[k, c] = kernel
            row = row @ cell.E
            if slopes is not None:
                row[: chain.n] += np.abs(kernel) @ slopes[k, c]
        if chain.jump is not None:
            reference[m + sampled[k]] += row @ chain.jump.by_reference
            noise[k] = row @ chain.jump.by_noise
            row = row @ chain.jump.J
    reference[:m] = row @ chain.start
    return Kernels(disturbance, noise, reference)


def run(
    chain: Chain,
    signed: Kernels,
    reference: WorstProfile,
    slow: Mapping[int, tuple[np.ndarray, int]] = MappingProxyType({}),
) -> Motion:
    """The chain under inputs of the kernels' signs and a reference.

    Parameters
    ----------
    chain : Chain
    signed : Kernels
    reference : WorstProfile
    slow : mapping of int to pairs
        Inputs that have values of their own in the cells, one after the other, and a sign of what
        grows with the state.
    """
    shape, beta = signed.disturbance.shape[:2], np.array(chain.uncertainty.beta)
    held = {j: (values.reshape(shape), sign) for j, (values, sign) in slow.items()}
    signs, senses = np.sign(signed.disturbance), np.sign(signed.noise)
    z, (inside, sampled) = chain.start @ reference.start, chain.piece_at
    states = np.zeros((chain.periods, len(chain.cells), chain.n))
    for k in range(chain.periods):
        if chain.jump is not None:
            jump, top = chain.jump, reference.pieces[sampled[k]]
            z = jump.J @ z + jump.by_noise @ (senses[k] * chain.noise) + jump.by_reference * top
        top = reference.pieces[inside[k]]
        for c, cell in enumerate(chain.cells):
            x = states[k, c] = z[: chain.n]
            z = cell.E @ z + cell.by_reference * top + cell.offset
            if chain.acting:
                sizes = chain.bound(x)
                w = signs[k, c] * sizes
                for j, (values, sign) in held.items():
                    w[j] = values[k, c] + sign * (sizes[j] - beta[chain.acting[j]])
                z = z + cell.G @ w
    last = reference.pieces[inside[-1]]
    output = float(chain.row @ z + chain.through * last + chain.level)
    return Motion(output, states)

"""Gain and phase margins of a linear loop that is opened at its input.

    x' = A x + b v,   v = -k x,   L(s) = k (s I - A)^-1 b

The closed loop is stable. A factor at v that makes L(j omega) = -1 at some omega is where it
ceases to be: factors between the nearest ones below and above 1 are its gain margin, and the angle
from L to -1 where |L| = 1 is its phase margin.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

#: Frequencies looked at: from this part of the slowest rate of the loop to this multiple of the
#: fastest, so many of them to a decade, and those near crossings. Between two of them a crossing is
#: refined.
SLOWEST_PART, FASTEST_MULTIPLE, POINTS_PER_DECADE = 1e-3, 1e3, 20

#: A rate below this part of the fastest is none: a pole at 0.
NO_RATE = 1e-9

#: Where a pencil is inverted, over the fastest rate: any number that is no root of an equation.
PENCIL_SHIFT = 0.7310585786

#: A larger |L| is a pole of the open loop, where the sign of a part changes without a zero.
POLE = 1e9


@dataclass(frozen=True)
class LoopMargins:
    """Margins at the input of a loop.

    Attributes
    ----------
    lowest_gain, highest_gain : float
        Factors at the input between which the loop is stable; 0 and inf where nothing ends them.
    phase : float
        Degrees; inf where |L| never is 1.
    """

    lowest_gain: float
    highest_gain: float
    phase: float


def loop_margins(A: np.ndarray, b: np.ndarray, k: np.ndarray) -> LoopMargins:
    """Margins of v = -k x in x' = A x + b v.

    Parameters
    ----------
    A : (n, n) array
    b, k : (n,) arrays
        A - b k is stable.
    """
    if not np.any(k):  # nothing is fed back: nothing depends on the factor
        return LoopMargins(0.0, math.inf, math.inf)
    eye = np.eye(len(A))

    def L(omega: float) -> complex:
        try:
            return complex(k @ np.linalg.solve(1j * omega * eye - A, b))
        except np.linalg.LinAlgError:  # a pole of the open loop
            return complex(math.inf)

    omegas = _frequencies(A, b, k)
    values = [L(omega) for omega in omegas]
    real = _where_zero(L, omegas, values, lambda v: v.imag)
    factors = [*_at_rest(A, b, k), *(-1 / v.real for v in real if v.real < 0)]
    unit = _where_zero(L, omegas, values, lambda v: math.log(abs(v)))
    return LoopMargins(
        max((factor for factor in factors if 0 < factor < 1), default=0.0),
        min((factor for factor in factors if factor > 1), default=math.inf),
        min((180 - abs(math.degrees(cmath.phase(v))) for v in unit), default=math.inf),
    )


def _frequencies(A: np.ndarray, b: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Where the response is looked at: nearly at every crossing, between them, and coarsely.

    |L| = 1 at the imaginary eigenvalues of a Hamiltonian matrix; L(s) - L(-s), twice the imaginary
    part, is zero at those of a pencil.
    """
    n = len(A)
    hamiltonian = np.block([[A, np.outer(b, b)], [-np.outer(k, k), -A.T]])
    mirrored = np.zeros((2 * n + 1, 2 * n + 1))
    mirrored[:n, :n], mirrored[n:-1, n:-1] = A, -A
    mirrored[:-1, -1], mirrored[-1, :-1] = np.tile(b, 2), np.tile(k, 2)
    poles = np.concatenate([np.linalg.eigvals(A), np.linalg.eigvals(A - np.outer(b, k))])
    with np.errstate(all="ignore"):
        shift = PENCIL_SHIFT * np.abs(poles).max()
        zeros = _pencil_values(mirrored, np.diag([*np.ones(2 * n), 0.0]), shift)
        rates = np.concatenate([np.abs(poles), *map(_heights, (poles, zeros[np.isfinite(zeros)]))])
        rates = np.append(rates, _heights(np.linalg.eigvals(hamiltonian)))
    fastest = np.abs(poles).max()
    low, high = (np.abs(poles[np.abs(poles) > NO_RATE * fastest]).min(), fastest)
    low, high = low * SLOWEST_PART, high * FASTEST_MULTIPLE
    count = int(POINTS_PER_DECADE * math.log10(high / low))
    rates = rates[(rates > low) & (rates < high)]
    omegas = np.union1d(np.geomspace(low, high, count), rates)
    return np.union1d(omegas, np.sqrt(omegas[:-1] * omegas[1:]))


def _pencil_values(M: np.ndarray, N: np.ndarray, shift: float) -> np.ndarray:
    """The s with det(M - s N) = 0, those at infinity as very large or no numbers.

    They are the eigenvalues of one matrix, inverted, from a shift that is none of them; SciPy's
    pencils take longer to import than a design to compute.
    """
    values = np.linalg.eigvals(np.linalg.solve(M - shift * N, N))
    return shift + 1 / values.astype(complex)


def _heights(values: np.ndarray) -> np.ndarray:
    return np.abs(values.imag)


def _at_rest(A: np.ndarray, b: np.ndarray, k: np.ndarray) -> list[float]:
    """The factor that puts a pole at 0: det(A - factor b k), which is linear in it, vanishes."""
    without, closed = np.linalg.det(A), np.linalg.det(A - np.outer(b, k))
    if abs(without) <= NO_RATE * abs(closed) or without == closed:
        return []
    return [float(without / (without - closed))]


def _where_zero(
    L: Callable[[float], complex],
    omegas: np.ndarray,
    values: Sequence[complex],
    part: Callable[[complex], float],
) -> list[complex]:
    """L where a part of it passes zero, not a pole, between two frequencies."""
    crossings, above = [], np.array([part(value) >= 0 for value in values])
    for i in np.flatnonzero(above[:-1] != above[1:]):
        low, high = float(omegas[i]), float(omegas[i + 1])
        while low < (middle := low + (high - low) / 2) < high:  # down to neighbouring floats
            low, high = (middle, high) if (part(L(middle)) >= 0) == above[i] else (low, middle)
        crossings.append(L(high))
    return [value for value in crossings if abs(value) < POLE]

"""An optimum's input on the plant itself, integrated by another method."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from certrack.core.arrays import Array
from certrack.studies.optimal.goal import TrajectoryCost
from certrack.studies.optimal.law_run import LawRun

#: Tolerances of the integration.
RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-9, 1e-11

#: Samples of an element in the replayed run.
SAMPLES_PER_ELEMENT = 8


@dataclass(frozen=True)
class Replay:
    """What the plant does with the input of an optimum.

    Attributes
    ----------
    cost : TrajectoryCost
        Its cost; the integral by the integrator itself.
    times : (N,) array, s
    states : (S, N) array
        NaN from where the integrator gave up.
    """

    cost: TrajectoryCost
    times: Array
    states: Array

    def deviation(self, begins: Array) -> float:
        """Largest difference from states at the ends of the elements, over that of each state.

        Parameters
        ----------
        begins : (S, E + 1) array
        """
        at_ends = self.states[:, ::SAMPLES_PER_ELEMENT]
        if at_ends.shape != begins.shape or not np.isfinite(at_ends).all():
            return math.inf
        largest = np.abs(begins).max(axis=1, keepdims=True)
        return float((np.abs(at_ends - begins) / np.where(largest > 0, largest, 1.0)).max())


def replay(law_run: LawRun, ends: Array, inputs: Array, arrival: bool) -> Replay:
    """Integrate the plant element by element.

    Parameters
    ----------
    law_run : LawRun
    ends : (E + 1,) array, s
        Of the elements.
    inputs : (2, E) array
        At their begins and ends, straight between.
    arrival : bool
        Whether the end is a time of arrival.
    """
    rates, output = law_run.rates(), law_run.output()
    reference = law_run.system.reference

    def right_side(t: float, z: Array, begin: float, first: float, slope: float) -> Array:
        u = first + slope * (t - begin)
        error = float(output(z[:-1])[0]) - float(reference.values(np.array([t]), 0)[0, 0])
        return np.array([*rates(t, z[:-1], u), error**2], dtype=float)

    z = np.append(law_run.start, 0.0)
    times, table = [ends[:1]], [z[:, None]]
    for begin, end, first, last in zip(ends[:-1], ends[1:], *inputs, strict=True):
        at = np.linspace(begin, end, SAMPLES_PER_ELEMENT + 1)[1:]
        inside = np.append(at[:-1], np.nextafter(end, begin))  # what jumps at the end jumps later
        with np.errstate(all="ignore"):
            piece = solve_ivp(
                right_side,
                (begin, inside[-1]),
                z,
                method="DOP853",
                t_eval=inside,
                args=(begin, first, (last - first) / (end - begin)),
                rtol=RELATIVE_TOLERANCE,
                atol=ABSOLUTE_TOLERANCE,
            )
        times.append(at)
        if not piece.success:
            table.append(np.full((len(z), SAMPLES_PER_ELEMENT), np.nan))
            break
        table.append(piece.y)
        z = piece.y[:, -1]
    states = np.concatenate(table, axis=1)
    cost = TrajectoryCost(
        squared_error=float(states[-1, -1]),
        energy=float(np.diff(ends) @ (inputs[0] ** 2 + inputs[0] * inputs[1] + inputs[1] ** 2)) / 3,
        peak=float(np.abs(inputs).max()),
        time=float(ends[-1]) if arrival else math.nan,
    )
    return Replay(cost, np.concatenate(times), states[:-1])

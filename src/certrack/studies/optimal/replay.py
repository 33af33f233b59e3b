"""An optimum's input on the plant itself, integrated by another method, element by element.

Every element begins at the state that the program has there, and what it ends at is held against
the next. One integration over all of the run would say nothing of an unstable plant, on which any
rounding grows without bound where no law holds it back.
"""

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
        NaN where the integrator gave up.
    defects : (E,) array
        Difference between the end of each element and the begin of the next, over the largest
        magnitude of each state, the largest of all states; inf from where the integrator gave up.
    """

    cost: TrajectoryCost
    times: Array
    states: Array
    defects: Array

    @property
    def deviation(self) -> float:
        """The largest defect."""
        return float(self.defects.max())


def replay(law_run: LawRun, ends: Array, inputs: Array, begins: Array, arrival: bool) -> Replay:
    """Integrate the plant over each element.

    Parameters
    ----------
    law_run : LawRun
        Jumps of its plant in the states (dry friction) as wide as its smoothing says; all else is
        as it is.
    ends : (E + 1,) array, s
        Of the elements.
    inputs : (2, E) array
        At their begins and ends, straight between.
    begins : (S, E + 1) array
        States at the ends.
    arrival : bool
        Whether the end is a time of arrival.
    """
    rates, output = law_run.rates(), law_run.output()
    method = "LSODA" if law_run.has_jumping_rates else "DOP853"  # a smoothed jump is stiff
    reference = law_run.system.reference

    def right_side(t: float, z: Array, begin: float, first: float, slope: float) -> Array:
        u = first + slope * (t - begin)
        error = float(output(z[:-1])[0]) - float(reference.values(np.array([t]), 0)[0, 0])
        return np.array([*rates(t, z[:-1], u), error**2], dtype=float)

    largest = np.abs(begins).max(axis=1)
    scale = np.where(largest > 0, largest, 1.0)
    times, table, squared = [ends[:1]], [law_run.start[:, None]], 0.0
    defects = np.full(len(ends) - 1, math.inf)
    states = law_run.start
    for k, (begin, end) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
        first, last = inputs[:, k]
        at = np.linspace(begin, end, SAMPLES_PER_ELEMENT + 1)[1:]
        inside = np.append(at[:-1], np.nextafter(end, begin))  # what jumps at the end jumps later
        with np.errstate(all="ignore"):
            piece = solve_ivp(
                right_side,
                (begin, inside[-1]),
                np.append(states, 0.0),
                method=method,
                t_eval=inside,
                args=(begin, first, (last - first) / (end - begin)),
                rtol=RELATIVE_TOLERANCE,
                atol=ABSOLUTE_TOLERANCE,
            )
        times.append(at)
        if not piece.success:
            table.append(np.full((len(scale), SAMPLES_PER_ELEMENT), np.nan))
            break
        table.append(piece.y[:-1])
        squared += float(piece.y[-1, -1])
        defects[k] = (np.abs(piece.y[:-1, -1] - begins[:, k + 1]) / scale).max()
        states = begins[:, k + 1]
    cost = TrajectoryCost(
        squared_error=squared,
        energy=float(np.diff(ends) @ (inputs[0] ** 2 + inputs[0] * inputs[1] + inputs[1] ** 2)) / 3,
        peak=float(np.abs(inputs).max()),
        time=float(ends[-1]) if arrival else math.nan,
    )
    return Replay(cost, np.concatenate(times), np.concatenate(table, axis=1), defects)

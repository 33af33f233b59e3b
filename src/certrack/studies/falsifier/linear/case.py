"""Worst inputs as a system that anyone can run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from certrack.certificates.ranges.formulas import RANGED_GAIN, RANGED_THETA
from certrack.certificates.worst_profile import WorstProfile
from certrack.model.implementation import Implementation
from certrack.model.truth import Truth
from certrack.references import PiecewiseReference, profile
from certrack.references.shapes import derivatives_between
from certrack.studies.falsifier.linear.ascent import STOPPING_PIECES, WorstInputs
from certrack.studies.falsifier.linear.pattern import sign_formula
from certrack.studies.falsifier.linear.sampled import noise_bounds
from certrack.systems.system import System

#: |w_k| rounds below its bound with this factor, and y_d and its derivatives below theirs.
WITHIN_BOUND = 1 - 1e-9

#: ||x|| in a disturbance is sqrt(x.x + offset^2) - offset; the offset over the largest |x|.
PATTERN_NORM_OFFSET = 1e-4

#: Corrections that bring a reference to rest at the end: each leaves the rounding of its own sums.
REST_CORRECTIONS_OF_CASE = 3

#: What comes just after a sample does so by this part of the period.
LATE_PART = 1e-4

#: The last part of the run, of which the error counts.
END_PART = 0.15


def written_case(
    system: System,
    worst: WorstInputs,
    sense: int = 1,
) -> System:
    """The system under worst inputs.

    Parameters
    ----------
    system : System
        Its truth has the constants of the case.
    worst : WorstInputs
    sense : {1, -1}
        1, or -1 for the opposite of every input.
    """
    chain, settings, implementation = worst.chain, system.settings, system.implementation
    shift = LATE_PART * chain.period if chain.late else 0.0
    reference = admissible_profile(worst.reference, chain.bounds, sense, shift)
    x0 = sense * (chain.start @ worst.reference.start)[: chain.n]
    end = chain.period * chain.periods
    duration = end if implementation is None else end + implementation.period
    if implementation is not None:
        implementation = _worst_sensors(implementation, worst, sense)
    settings = replace(
        settings,
        x0=tuple(x0.tolist()),
        duration=duration,
        tail=(1 - END_PART) * end,
        estimates=None,
    )
    return System(
        plant=system.plant,
        law=system.law,
        reference=reference,
        truth=replace(
            system.truth,
            omega=_omega(system, worst, sense, float(np.abs(x0).max())),  # type: ignore[arg-type]
            tau=system.plant.uncertainty.tau,
        ),
        settings=settings,
        title=f"Worst case found for: {system.title}",
        implementation=implementation,
    )


def admissible_profile(
    worst: WorstProfile,
    bounds: tuple[float, ...],
    sense: int,
    shift: float = 0.0,
    stopping: int = STOPPING_PIECES,
) -> PiecewiseReference:
    """The reference as one of a system file, within the bounds for certain.

    All times but the first are moved by `shift`; by the last `stopping` pieces it comes to rest.
    """
    times = np.concatenate([[0.0], shift + np.cumsum(worst.widths)])

    def scaled(factor: float) -> PiecewiseReference:
        start, pieces = (factor * sense * part for part in (worst.start, worst.pieces))
        pieces = _ending_at_rest(times, start, pieces, stopping)
        return profile(tuple(times.tolist()), tuple(start.tolist()), tuple(pieces.tolist()))

    reached = scaled(1.0).bounds(len(bounds) - 1).values
    excess = max((a / b for a, b in zip(reached, bounds, strict=True) if b > 0), default=1.0)
    return scaled(WITHIN_BOUND / max(1.0, excess))


def _ending_at_rest(
    times: np.ndarray, start: np.ndarray, pieces: np.ndarray, stopping: int
) -> np.ndarray:
    """The pieces with the last ones corrected by the rounding of all sums before them."""
    order, last = len(start), len(pieces) - stopping
    columns = [
        [
            ((times[-1] - begin) ** (order - k) - (times[-1] - end) ** (order - k))
            / math.factorial(order - k)
            for begin, end in zip(times[last:], times[last + 1 :], strict=False)
        ]
        for k in range(1, order)
    ]
    if not columns:
        return pieces
    table, pieces = np.array(columns), pieces.copy()
    sizes = np.abs(table).max(axis=1)
    for _ in range(REST_CORRECTIONS_OF_CASE):
        end = np.array(derivatives_between(times.tolist(), start.tolist(), pieces.tolist())[-1][1:])
        pieces[last:] -= np.linalg.lstsq(table / sizes[:, None], end / sizes, rcond=None)[0]
    return pieces


def _worst_sensors(
    implementation: Implementation, worst: WorstInputs, sense: int
) -> Implementation:
    """The implementation with the worst errors of the sensors in the place of noise."""
    chain = worst.chain
    edges = (np.arange(chain.periods + 1) - 0.5) * chain.period
    sizes = noise_bounds(implementation, chain.n).tolist()
    errors = [
        f"{sense * size!r}*{sign_formula(worst.kernels.noise[:, i], edges)}" if size else "0"
        for i, size in enumerate(sizes)
    ]
    return replace(
        implementation,
        offset=0.0,
        noise=None,
        sensor_error=tuple(errors) if any(sizes) else None,  # type: ignore[arg-type]
    )


def at_point(system: System, values: Mapping[str, Any]) -> System:
    """The system whose truth has these values of what has a range.

    Parameters
    ----------
    system : System
    values : mapping
        By name, as texts.
    """
    truth, theta = system.truth, list(system.truth.theta)
    for i in range(len(theta)):
        theta[i] = values.get(f"{RANGED_THETA}[{i}]", theta[i])
    constants = dict(truth.constants) | {
        name: value for name, value in values.items() if name in system.plant.constant_boxes
    }
    gain = values.get(RANGED_GAIN, truth.input_gain)
    changed = Truth(gain, tuple(theta), truth.omega, constants=tuple(constants.items()))
    return system.replace(truth=changed)


def _omega(system: System, worst: WorstInputs, sense: int, size: float) -> tuple[str, ...]:
    """The worst disturbances as formulas."""
    chain, u = worst.chain, system.plant.uncertainty
    lengths = np.tile(chain.lengths, chain.periods)
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    omega = ["0"] * system.plant.n
    offset = 2.0 ** round(
        math.log2(PATTERN_NORM_OFFSET * size or PATTERN_NORM_OFFSET)
    )  # its square is exact
    for j, k in enumerate(chain.acting):
        bound = u.bound_formula(k, system.plant.states, offset)
        if (slow := worst.slow.get(j)) is not None:
            grown = f" + {slow.growth * sense * WITHIN_BOUND!r}*({bound} - {u.beta[k]!r})"
            omega[k] = slow.formula(sense) + (grown if slow.growth else "")
            continue
        weights = (worst.kernels.disturbance[:, :, j].ravel() * lengths).astype(float)
        omega[k] = f"{sense * WITHIN_BOUND!r}*{sign_formula(weights, edges)}*({bound})"
    return tuple(omega)

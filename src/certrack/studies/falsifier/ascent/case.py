"""The inputs of an ascent as a system that anyone can run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from certrack.certificates.worst_profile import WorstProfile
from certrack.core.arrays import Array
from certrack.model.truth import Truth
from certrack.studies.falsifier.ascent.loop import AdversaryInputs, ControlledLoop
from certrack.studies.falsifier.linear.case import END_PART, WITHIN_BOUND, admissible_profile
from certrack.studies.falsifier.linear.pattern import MAX_CHANGES, sign_formula
from certrack.systems.system import System

#: Shares are written as signs, and as mean values between so many changes; the worse one counts.
SIGNS, MEANS = "signs", "means"


def written(
    loop: ControlledLoop, inputs: AdversaryInputs, slopes: AdversaryInputs, form: str
) -> System:
    """The system under the inputs of one member.

    Parameters
    ----------
    loop : ControlledLoop
    inputs : AdversaryInputs
    slopes : AdversaryInputs
        Of |e_1| by them: what matters less is left out first.
    form : {"signs", "means"}
    """
    system = loop.system
    widths = np.concatenate([loop.piece_widths, loop.stopping_widths])
    worst = WorstProfile(0.0, inputs.begin[:, 0], inputs.pieces[:, 0], widths)
    bounds, stopping = tuple(loop.bounds.tolist()), len(loop.stopping_widths)
    reference = admissible_profile(worst, bounds, 1, stopping=stopping)
    x0 = loop.resting @ inputs.begin[:, 0]
    omega = ["0"] * system.plant.n
    edges = np.concatenate([[0.0], np.cumsum(loop.widths)])
    for j, k in enumerate(loop.acting):
        share, weight = inputs.shares[:, j, 0], np.abs(slopes.shares[:, j, 0])
        if loop.held[j]:
            text = repr(float(share[0]))
        elif form == SIGNS:
            text = sign_formula(share * np.maximum(weight, 1e-300), edges)
        else:
            text = mean_formula(share, weight, edges)
        omega[k] = f"{WITHIN_BOUND!r}*({text})*({loop.share_bound(k)})"
    truth = _truth(loop, inputs.truths[:, 0], omega)
    settings = replace(
        system.settings,
        x0=tuple(x0.tolist()),
        duration=loop.horizon,
        tail=(1 - END_PART) * loop.horizon,
    )
    title = f"Worst case found for: {system.title}"
    return system.replace(reference=reference, truth=truth, settings=settings, title=title)


def _truth(loop: ControlledLoop, values: Array, omega: list[str]) -> Truth:
    """The truth with these values of what has a range."""
    truth: Any = loop.system.truth
    gain, theta = truth.input_gain, list(truth.theta)
    for name, value in zip(loop.truth_names, values.tolist(), strict=True):
        if name.startswith("true_theta"):
            theta[int(name.rsplit("_", 1)[1])] = value
        else:
            gain = value
    return Truth(gain, tuple(theta), tuple(omega), constants=truth.constants)  # type: ignore[arg-type]


def mean_formula(share: Array, weight: Array, edges: Array) -> str:
    """Shares over time as a formula of t: their weighted means between a limited number of changes.

    The changes are dense where shares change while they matter.
    """
    matter = (weight[1:] + weight[:-1]) / 2
    moved = np.abs(np.diff(share)) * matter
    measure = np.concatenate([[0.0], np.cumsum(moved)])
    if not measure[-1]:
        return repr(float(share[0]))
    group = np.minimum((measure / measure[-1] * MAX_CHANGES).astype(int), MAX_CHANGES - 1)
    first = np.flatnonzero(np.concatenate([[True], np.diff(group) > 0]))
    heavy = weight + 1e-12 * weight.max() + 1e-300
    means = np.add.reduceat(share * heavy, first) / np.add.reduceat(heavy, first)
    halves = np.diff(means) / 2
    terms = [repr(float((means[0] + means[-1]) / 2))]
    terms += [
        f"({half!r})*sign(t - {at!r})"
        for half, at in zip(halves.tolist(), edges[first[1:]].tolist(), strict=True)
    ]
    return " + ".join(terms)

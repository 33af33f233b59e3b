"""The numbers of a sampled controller: gains, and what the implementation makes of its own."""

from __future__ import annotations

import math

import numpy as np

from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable
from certrack.laws.base import Law
from certrack.loops.controller import PERIOD, SampledController
from certrack.loops.observers import observer_values
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant


def plain_values(
    controller: SampledController,
    plant: Plant,
    law: Law,
    implementation: Implementation,
) -> np.ndarray:
    """Values of :attr:`SampledController.parameters`, with the law's own feed-forward.

    Parameters
    ----------
    controller : SampledController
    plant : Plant
    law : Law
        Has the gains.
    implementation : Implementation
        Of the structure that the controller was made for.

    Returns
    -------
    (P,) array
    """
    gains = law.values(plant, controller.gain_names)
    T, filter_time = implementation.period, implementation.velocity_filter
    known = {PERIOD: T, **observer_values(plant, law, implementation)}
    known[symbol("ctl_filter")] = 1.0 - math.exp(-T / filter_time) if filter_time else 1.0
    if implementation.rate_limit is not None:
        known[symbol("ctl_u_step")] = implementation.rate_limit * T
    if implementation.saturation is not None:
        known[symbol("ctl_u_low")], known[symbol("ctl_u_high")] = implementation.saturation
    if controller.hold:
        weights = _hold_weights(controller, gains, T)
        known |= {symbol(f"ctl_hold_{i}_{j}"): weights[i, j] for i, j in controller.hold}
    for i, end in enumerate(end for box in implementation.projection or () for end in box):
        known[symbol(f"ctl_box_{i}")] = end
    constants = [float(value) for value in plant.constant_values.values()]
    numbers = controller.parameters[len(gains) + len(constants) :]
    return np.concatenate([gains, constants, [known[name] for name in numbers]])


def _hold_weights(controller: SampledController, gains: np.ndarray, T: float) -> np.ndarray:
    """W = L^-1 (exp(L T) - I), without dividing by L."""
    from scipy.linalg import expm

    count = len(controller.estimates)
    names = controller.parameters[: len(gains)]
    L = np.array(numpy_callable(names, controller.leak)(*gains), dtype=float).reshape(count, count)
    block = np.zeros((2 * count, 2 * count))
    block[:count, :count], block[:count, count:] = L * T, np.eye(count) * T
    weights: np.ndarray = expm(block)[:count, count:]
    return weights

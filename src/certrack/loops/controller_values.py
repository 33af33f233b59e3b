"""What the symbols of a sampled controller stand for."""

from __future__ import annotations

import numpy as np

from certrack.core.expressions import symbol
from certrack.laws.base import Law
from certrack.loops.controller import SampledController
from certrack.loops.controller_numbers import plain_values
from certrack.loops.feedforward import sampled_feedforward
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant


def controller_values(
    controller: SampledController, plant: Plant, law: Law, implementation: Implementation
) -> np.ndarray:
    """Values of :attr:`SampledController.parameters`.

    Parameters
    ----------
    controller : SampledController
    plant : Plant
    law : Law
        Has the gains; its feed-forward may be that of the sampled loop.
    implementation : Implementation
        Of the structure that the controller was made for.

    Returns
    -------
    (P,) array
    """
    values = plain_values(controller, plant, law, implementation)
    if law.sampled_feedforward:
        of_Y = sampled_feedforward(plant, law.design(plant), law, implementation)
        places = {name: i for i, name in enumerate(controller.parameters)}
        for i, value in enumerate(of_Y):
            values[places[symbol(f"law_nu_Y_{i}")]] = value
    return values

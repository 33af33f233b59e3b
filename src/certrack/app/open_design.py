"""A text that is open in a worker: the system, its compiled loops, the starts of its searches."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from certrack.app.gains import with_gains
from certrack.certificates.estimates.estimate import BoundEstimate
from certrack.core.errors import CertrackError
from certrack.simulation.run import Run
from certrack.simulation.simulator import Simulator
from certrack.systems.reader import loads
from certrack.systems.system import System

#: Texts and compiled loops that a worker keeps: the ones that were not used for longest go.
MAX_OPEN, MAX_COMPILED = 16, 16


class OpenDesign:
    """One text.

    Parameters
    ----------
    text : str
        Of a system file.
    name : str
        What messages call it.
    folder : Path or None
        Where its sample files lie.
    """

    def __init__(self, text: str, name: str, folder: Path | None) -> None:
        self.system = loads(text, name or "<text>", folder)
        self.warm: BoundEstimate | None = None

    def with_gains(self, gains: Mapping[str, float]) -> System:
        """The system with other gains."""
        return with_gains(self.system, gains)


class Designs:
    """The texts and compiled loops of a worker."""

    def __init__(self) -> None:
        self._designs: OrderedDict[tuple[str, str], OpenDesign] = OrderedDict()
        self._simulators: list[Simulator] = []

    def of(self, text: str, name: str, folder: Path | None) -> OpenDesign:
        """The design of a text, loaded once."""
        key = text, str(folder)
        if key not in self._designs:
            self._designs[key] = OpenDesign(text, name, folder)
            while len(self._designs) > MAX_OPEN:
                self._designs.popitem(last=False)
        self._designs.move_to_end(key)
        return self._designs[key]

    def run(self, system: System) -> Run:
        """A run, by a loop that is compiled already if one serves."""
        simulator = next((s for s in self._simulators if s.serves(system)), None)
        if simulator is None:
            simulator = Simulator(system)
        else:
            self._simulators.remove(simulator)
        self._simulators = [simulator, *self._simulators[: MAX_COMPILED - 1]]
        return simulator.run(system)


def continuous_law(system: System) -> System | None:
    """The system without its drive, which runs a hundred times as fast; None if there is none."""
    if system.implementation is None:
        return system
    try:
        return system.replace(implementation=None)
    except CertrackError:  # a feed-forward that only the sampled loop has
        return None


def nominal_law(system: System) -> System | None:
    """The continuous law with the constants as they stand; None if there is none."""
    continuous = continuous_law(system)
    if continuous is None or not continuous.plant.constant_ranges:
        return continuous
    try:
        return continuous.replace(plant=replace(continuous.plant, constant_ranges=()))
    except CertrackError:  # a formula elsewhere that rests on the ranges
        return None

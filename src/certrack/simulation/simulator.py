"""What a user runs: a system's loop, compiled once, for any numbers.

A system with an [implementation] runs as on the drive (:mod:`certrack.simulation.sampled`), any
other one in continuous time (:mod:`certrack.simulation.continuous`). Only that one is built.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.loops.continuous import ClosedLoop, close_loop
from certrack.loops.sampled import SampledLoop, sample_loop
from certrack.model.truth import Truth
from certrack.simulation.continuous import ContinuousSimulator
from certrack.simulation.run import Run
from certrack.simulation.sampled import SampledSimulator
from certrack.systems.system import System, require_system


class Simulator:
    """A system's closed loop, compiled; runs it for any gains, truth, start and disturbance.

    Parameters
    ----------
    system : System

    Examples
    --------
    >>> import certrack, dataclasses
    >>> system = certrack.load("example1")
    >>> simulator = certrack.Simulator(system)
    >>> run = simulator.run()
    >>> stiffer = system.replace(law=dataclasses.replace(system.law, c=(2, 1)))
    >>> faster = simulator.run(stiffer)  # no recompilation
    """

    def __init__(self, system: System) -> None:
        require_system(system)
        self.system = system
        self._simulator: ContinuousSimulator | SampledSimulator = (
            ContinuousSimulator(system)
            if system.implementation is None
            else SampledSimulator(system)
        )

    @property
    def loop(self) -> ClosedLoop | SampledLoop:
        """The loop that is compiled, as formulas."""
        return self._simulator.loop

    def run(
        self,
        system: System | None = None,
        progress: Progress = silent,
    ) -> Run:
        """Simulate `system`, by default the one given at construction.

        Any number of threads may do so at once.

        Parameters
        ----------
        system : System, optional
        progress : callable
            Gets the simulated time, the duration and None.

        Returns
        -------
        Run

        Raises
        ------
        InputError
            If its structure (formulas, law, feed-forward order) differs from the compiled one.
        """
        system = self.system if system is None else system
        if not self.serves(system):
            raise InputError(
                "system", "has another structure than the compiled one", remedy="Make a Simulator"
            )
        return self._simulator.run(system, progress)

    def __repr__(self) -> str:
        return f"Simulator({self.system!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (self.system,)  # compiled code stays here

    def serves(self, system: System) -> bool:
        """Whether the compiled loop is that of `system`, so that :meth:`run` takes it.

        Parameters
        ----------
        system : System

        Returns
        -------
        bool
        """
        if (system.implementation is None) != (self.system.implementation is None):
            return False
        if system is self.system or _same_structure(system, self.system):
            return True
        join = close_loop if system.implementation is None else sample_loop
        return join(system) == self.loop


#: Simulators that a process keeps of those it was sent: each took seconds to compile, perhaps.
MAX_RESTORED = 8


def _restored(system: System) -> Simulator:
    """The simulator that was pickled; one that is sent again and again is compiled once."""
    try:
        return _compiled_for(system)
    except TypeError:  # a reference or a law of the user's that has no hash
        return Simulator(system)


@lru_cache(maxsize=MAX_RESTORED)
def _compiled_for(system: System) -> Simulator:
    return Simulator(system)


def _same_structure(a: System, b: System) -> bool:
    """Whether two systems surely differ in numbers only; a cheap check: no may mean "unknown"."""
    return (
        a.plant == b.plant
        and type(a.law) is type(b.law)
        and a.controller.equations == b.controller.equations
        and a.reference == b.reference
        and a.implementation == b.implementation
        and _same_truth_structure(a.truth, b.truth)
    )


def _same_truth_structure(a: Truth, b: Truth) -> bool:
    """Whether two truths of one plant surely differ in numbers only."""
    if a.states:
        forms = [
            (v.states, v.rates, v.outputs, v.motors, [name for name, _ in v.constants])
            for v in (a, b)
        ]
        return forms[0] == forms[1]
    return a.omega == b.omega and not b.states and not a.constants  # these may fill a coupling


def simulate(system: System, *, progress: Progress = silent, **settings: Any) -> Run:
    """Simulate a system once.

    Parameters
    ----------
    system : System
    progress : callable
        Gets the simulated time, the duration and None; see :mod:`certrack.core.progress`.
    **settings
        Override entries of :class:`certrack.Settings`, e.g. ``duration=5``. A stated tail keeps its
        share of the run where only the duration changes.

    Returns
    -------
    Run

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"), duration=30)
    >>> run.outcome.name
    'finished'
    """
    require_system(system)
    if settings:
        system = system.with_settings(**settings)
    return Simulator(system).run(progress=progress)

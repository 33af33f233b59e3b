"""What exported controllers are compared with: the sampled controller, evaluated by NumPy."""

import numpy as np

import certrack
from certrack.core.lowering import numpy_callable
from certrack.loops.controller import resolved, sampled_controller, starting_state
from certrack.loops.controller_values import controller_values

#: All that a controller on a drive may do, for example1.
EVERYTHING = {
    "saturation": (-5, 5),
    "rate_limit": 200.0,
    "velocity": ("x2",),
    "velocity_filter": 0.002,
    "update": "exact_leak",
    "projection": ((0.1, 2), (-5, 5)),
    "initial_input": 0.3,
}


def sampled(name, period=0.001, duration=1.0, **implementation):
    """A shipped system with an implementation."""
    system = certrack.load(name).with_settings(duration=duration, tail=duration / 2)
    return system.replace(implementation=certrack.Implementation(period=period, **implementation))


class PythonController:
    """The controller of a system, stepped by NumPy."""

    def __init__(self, system):
        implementation = system.implementation
        made = sampled_controller(system.plant, system.controller, implementation)
        self.start = starting_state(made, system.estimates, implementation)
        self.state = self.start
        self._numbers = controller_values(made, system.plant, system.law, implementation)
        command, update = resolved(made)
        given = [made.states, made.measured, made.Y, made.parameters]
        self._evaluate = numpy_callable(given, [command, *update])

    def step(self, x, Y):
        """The command; the states move on."""
        u, *after = self._evaluate(self.state, x, Y, self._numbers)
        self.state = np.array(after, dtype=float)
        return float(u)


def along_a_run(system):
    """Measured states and reference with derivatives at the samples of a run, row by row."""
    implementation, count = system.implementation, len(system.controller.signals.Y)
    t = implementation.offset + implementation.period * np.arange(
        int(system.settings.duration / implementation.period)
    )
    x = certrack.simulate(system).trajectory.interpolate(t)[: system.plant.n]
    return x.T, system.reference.values(t, count - 1).T

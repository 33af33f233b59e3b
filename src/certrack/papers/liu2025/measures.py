"""What is read off a response: total variation, final range, settling, response time.

Signals are taken from the dense output at equal distances, so that no figure depends on the steps
of the integrator, and by the paper's letters: e_1, xi_1 ..., delta_hat, theta_hat, u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certrack.simulation.run import Run

#: Distance of the samples in s: a settling time is known to this.
SPACING = 1e-4

#: The band in which |e_1| counts as tracking: twice the final error of both examples.
BAND = 0.05

#: A signal has settled into its final range where it stays within this much more than the range.
RANGE_MARGIN = 0.05


@dataclass(frozen=True)
class Response:
    """The signals of a run at equal distances.

    Attributes
    ----------
    t : (N,) array, s
    signals : arrays (N,) by name
    """

    t: np.ndarray
    signals: dict[str, np.ndarray]

    def after(self, name: str, start: float) -> np.ndarray:
        """A signal from `start` on."""
        return self.signals[name][self.t >= start - SPACING / 2]

    def supremum(self, name: str, start: float = 0.0) -> float:
        """Largest magnitude from `start` on."""
        return float(np.abs(self.after(name, start)).max())

    def total_variation(self, name: str, start: float = 0.0) -> float:
        """Integral of the magnitude of the derivative from `start` on: how much it moves."""
        return float(np.abs(np.diff(self.after(name, start))).sum())

    def turns(self, name: str, start: float) -> int:
        """How often it turns from rising to falling or back."""
        rising = np.diff(self.after(name, start)) > 0
        return int(np.count_nonzero(rising[1:] != rising[:-1]))

    def final_range(self, name: str) -> float:
        """Largest magnitude over the second half of the run."""
        return self.supremum(name, float(self.t[-1]) / 2)

    def settles(self, name: str) -> float:
        """When it is within its final range, and the margin, for good."""
        limit = (1 + RANGE_MARGIN) * self.final_range(name)
        return self.last_time(np.abs(self.signals[name]) > limit)

    def within(self, name: str, band: float) -> float:
        """When its magnitude is within the band for good."""
        return self.last_time(np.abs(self.signals[name]) > band)

    def response_time(self, name: str, tolerance: float) -> float:
        """When it is as close as this to the values of the second half of the run, for good."""
        last = self.after(name, float(self.t[-1]) / 2)
        values = self.signals[name]
        outside = (values < last.min() - tolerance) | (values > last.max() + tolerance)
        return self.last_time(outside)

    def last_time(self, where: np.ndarray) -> float:
        """The last time at which something is true; 0 if it never is."""
        times = self.t[where]
        return float(times[-1]) if len(times) else 0.0


def response(run: Run) -> Response:
    """The signals of a run."""
    t = np.linspace(0.0, run.trajectory.end, 1 + round(run.trajectory.end / SPACING))
    states = run.trajectory.interpolate(t)
    n = run.system.plant.n
    signals = {f"xi_{i + 1}": states[i] for i in range(n)}
    signals["e_1"] = states[0] - run.system.reference.values(t, 0)[0]
    for state, values in zip(run.system.controller.states, states[n:], strict=False):
        signals[state.name.removesuffix("_1")] = values
    signals["u"] = run.input_of(t, states)
    return Response(t, signals)


def response_times(pair: tuple[Response, Response], name: str) -> tuple[float, float]:
    """Response times of both, with a tolerance of 5 % of the larger excursion for both."""
    tolerance = RANGE_MARGIN * max(float(np.ptp(r.signals[name])) for r in pair)
    first, second = (r.response_time(name, tolerance) for r in pair)
    return first, second


def both(pair: tuple[Response, Response], read: Callable[[Response], float]) -> tuple[float, float]:
    """The same figure of two responses."""
    return read(pair[0]), read(pair[1])

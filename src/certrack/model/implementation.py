"""How a controller is carried out on a real drive: sampling, delay, limits, sensors.

At t_k = offset + k T the states are measured, the law is evaluated and its estimates take one step.
The input is limited, and acts from t_k + delay T until the next one does (zero-order hold).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.model.plant import Plant

UPDATES = ("euler", "exact_leak")
ANTI_WINDUPS = ("leak", "hold", "none")

#: Longest computation delay, periods.
MAX_DELAY = 100.0

#: More samples than this in a run are refused: a period in the wrong unit.
MAX_SAMPLES = 20_000_000


@dataclass(frozen=True)
class Implementation:
    """A controller on a drive.

    Parameters
    ----------
    period : float > 0, s
        T, sampling period.
    offset : float, s
        Time of the first sample, 0 <= offset < period; before it `initial_input` acts.
    delay : float >= 0, periods
        From a sample until its input acts; fractions and more than one period are possible.
    saturation : (low, high), optional
        Limits of the input.
    rate_limit : float > 0, optional
        Largest |u_k - u_{k-1}| / T, input unit per second.
    input_quantum : float >= 0
        Step of the actuator's converter; it gives the nearest step within the saturation.
    measurement_quantum : n numbers >= 0, optional
        Step of each sensor (an encoder of N lines per turn with x in rad: 2 pi/(4 N)).
    noise : n numbers >= 0, optional
        Standard deviation of the normal noise on each measured state.
    seed, stream : int
        Of the noise; every member of an ensemble has a stream of its own.
    velocity : names of states, optional
        Not measured: x_{i+1} = (filtered difference of the measured x_i - sum_j b_ij x_j)/g_i.
    velocity_filter : float >= 0, s
        Time constant of the filter; none if zero.
    update : {"euler", "exact_leak"}
        Step of the estimates: forward Euler, or exact for the constant leak in their rates.
    anti_windup : {"leak", "hold", "none"}
        While the input is limited the estimates only forget (``leak``: towards the priors), stand
        still (``hold``), or go on adapting (``none``).
    projection : pairs (low, high), one per estimate, optional
        The estimates are kept within.
    initial_input : float
        Before the first sample acts; also the last input that the rate limit sees.

    Raises
    ------
    InputError
        If a number does not fit.
    """

    period: float
    offset: float = 0.0
    delay: float = 0.0
    saturation: tuple[float, float] | None = None
    rate_limit: float | None = None
    input_quantum: float = 0.0
    measurement_quantum: tuple[float, ...] | None = None
    noise: tuple[float, ...] | None = None
    seed: int = 0
    stream: int = 0
    velocity: tuple[str, ...] = ()
    velocity_filter: float = 0.0
    update: str = "euler"
    anti_windup: str = "leak"
    projection: tuple[tuple[float, float], ...] | None = None
    initial_input: float = 0.0

    def bound_to(self, plant: Plant, estimates: int) -> Implementation:
        """This implementation checked against `plant` and the number of estimates."""
        known = plant.constant_values

        def real(name: str, **limits: Any) -> float:
            return checks.real(f"implementation.{name}", getattr(self, name), known, **limits)

        def per_state(name: str) -> tuple[float, ...] | None:
            given, key = getattr(self, name), f"implementation.{name}"
            if given is None:
                return None
            found = checks.reals(key, given, plant.n, "one number per state", known, least=0)
            return found if any(found) else None

        period, offset, delay = real("period", above=0), real("offset", least=0), real("delay")
        if offset >= period:
            raise InputError("implementation.offset", "must be less than the period", offset)
        if not 0 <= delay <= MAX_DELAY:
            what = f"must be 0 to {MAX_DELAY:g} periods"
            raise InputError("implementation.delay", what, delay)
        initial = real("initial_input")
        saturation = self._saturation(known)
        if saturation is not None and not saturation[0] <= initial <= saturation[1]:
            raise InputError(
                "implementation.initial_input", "must be within the saturation", initial
            )
        quantum = real("input_quantum", least=0)
        if saturation is not None and quantum:
            low, high = _steps_within(saturation, quantum)
            if low > high:
                raise InputError(
                    "implementation.input_quantum", "has no step within the saturation", quantum
                )
        limit = None if self.rate_limit is None else real("rate_limit", above=0)
        if self.velocity_filter and not self.velocity:
            raise InputError(
                "implementation.velocity_filter",
                "filters nothing",
                remedy="Name the states in implementation.velocity",
            )
        return Implementation(
            period=period,
            offset=offset,
            delay=delay,
            saturation=saturation,
            rate_limit=limit,
            input_quantum=quantum,
            measurement_quantum=per_state("measurement_quantum"),
            noise=per_state("noise"),
            seed=checks.integer("implementation.seed", self.seed, 0, 2**63),
            stream=checks.integer("implementation.stream", self.stream, 0, 2**63),
            velocity=self._velocity(plant),
            velocity_filter=real("velocity_filter", least=0),
            update=checks.choice("implementation.update", self.update, UPDATES),
            anti_windup=checks.choice("implementation.anti_windup", self.anti_windup, ANTI_WINDUPS),
            projection=self._projection(estimates, known),
            initial_input=initial,
        )

    def _saturation(self, known: Mapping[str, Any]) -> tuple[float, float] | None:
        if self.saturation is None:
            return None
        key = "implementation.saturation"
        low, high = checks.reals(key, self.saturation, 2, "[low, high]", known)
        if low >= high:
            raise InputError(key, "low must be less than high", [low, high])
        return low, high

    def _velocity(self, plant: Plant) -> tuple[str, ...]:
        key = "implementation.velocity"
        names = checks.sequence(key, self.velocity, None, "names of states")
        for i, name in enumerate(names):
            checks.choice(f"{key}[{i}]", name, plant.states)
            if name == plant.states[0]:
                raise InputError(
                    f"{key}[{i}]", "the first state has none before it to be differenced", name
                )
        return tuple(name for name in plant.states if name in names)

    def _projection(
        self, estimates: int, known: Mapping[str, Any]
    ) -> tuple[tuple[float, float], ...] | None:
        if self.projection is None:
            return None
        key = "implementation.projection"
        boxes = checks.sequence(key, self.projection, estimates, "[low, high] per estimate")
        return tuple(checks.interval(f"{key}[{i}]", box, known) for i, box in enumerate(boxes))

    @property
    def converter(self) -> tuple[float, float, float]:
        """Step of the actuator's converter, and the lowest and highest input it gives."""
        if self.saturation is None or not self.input_quantum:
            return self.input_quantum, -math.inf, math.inf
        low, high = _steps_within(self.saturation, self.input_quantum)
        return self.input_quantum, low * self.input_quantum, high * self.input_quantum

    def converted(self, command: np.ndarray) -> np.ndarray:
        """What the actuator's converter makes of commands."""
        quantum, low, high = self.converter
        if not quantum:
            return command
        found: np.ndarray = np.clip(np.rint(command / quantum) * quantum, low, high)
        return found

    def samples(self, duration: float) -> int:
        """Number of samples in a run.

        Raises
        ------
        InputError
            If there are too many to be meant.
        """
        count = (duration - self.offset) / self.period
        if count > MAX_SAMPLES:
            raise InputError(
                "implementation.period",
                f"makes more than {MAX_SAMPLES} samples in simulation.duration",
                self.period,
                "State the period in seconds",
            )
        return max(0, int(count * (1 + 1e-12))) + 1


def _steps_within(saturation: tuple[float, float], quantum: float) -> tuple[float, float]:
    """Numbers of the lowest and highest step of a converter; rounding of a limit does no harm."""
    low, high = (end / quantum for end in saturation)
    return float(np.ceil(low - 1e-9)), float(np.floor(high + 1e-9))

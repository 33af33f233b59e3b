"""How a controller is carried out on a real drive: sampling, delay, limits, sensors.

At t_k = offset + k T the states are measured, the law is evaluated and its estimates take one step.
The input is limited, and acts from t_k + delay T until the next one does (zero-order hold).

A simulation has one delay and random noise. A proof speaks of several delays, each of them
constant, and of noise with a largest value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, Expression, parse
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.core.lowering import numpy_callable, rows
from certrack.model.jitter import JITTER_PATTERNS, MAX_JITTER, RANDOM
from certrack.model.plant import Plant

UPDATES = ("euler", "exact_leak")
ANTI_WINDUPS = ("leak", "hold", "none")

#: Period of a drive of which none is stated, s.
USUAL_PERIOD = 0.001

#: Longest computation delay, periods.
MAX_DELAY = 100.0

#: Delays in a list: each is a proof of its own.
MAX_DELAYS = 16

#: More samples than this in a run are refused: a period in the wrong unit.
MAX_RUN_SAMPLES = 20_000_000

#: Largest seed and stream of the noise: what an unsigned 64-bit generator takes, with room.
MAX_SEED = 2**63

#: Fields with one number per state; None means zero for all of them.
PER_STATE = ("measurement_quantum", "noise", "noise_bound")

#: Rounding of (duration - offset)/period that must not cost the last sample, relative.
COUNT_ROUNDING = 1e-12

#: Rounding of a limit that must not cost the converter its last step, steps.
STEP_ROUNDING = 1e-9

#: Standard deviations that are suggested as a bound, and that the falsifier takes for one: beyond
#: them lies one number in two million.
NOISE_BOUND_DEVIATIONS = 5


@dataclass(frozen=True)
class Implementation:
    """A controller on a drive.

    Parameters
    ----------
    period : float > 0, s
        T, sampling period.
    offset : float, s
        Time of the first sample, 0 <= offset < period; before it `initial_input` acts.
    delay : float >= 0, or several, periods
        From a sample until its input acts; fractions and more than one period are possible. Of
        several a run has the first, and a certificate of the sampled loop covers each.
    jitter : float, periods
        Samples and inputs come up to so much earlier or later than they should, each by itself, and
        a reference by the controller's clock. At most half of every delay: an input follows its
        sample.
    jitter_pattern : {"random", "alternating", "late"}
        How they do in a run; a certificate covers all that are within the jitter.
    counted_delay : float >= 0, optional, periods
        The delay that observers and sampled feed-forward count on; the one of a run if left out.
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
    noise_bound : n numbers >= 0, optional
        Largest |noise| of each sensor, positive where there is noise: simulated noise is clipped
        to it, and a certificate admits every noise within it. Without it normal noise has no
        largest value, and the loop no worst case.
    sensor_error : n formulas of t, optional
        Added to the noise at the samples, before it is clipped: an offset, a ripple, or the worst
        case that `falsify` found.
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
        If a number is out of its limits. What needs the plant (how many sensors, which states) is
        checked when a system is made of both.
    """

    period: float = keyed("number", help="sampling period", unit="s", above=0)
    offset: float = keyed(
        "number", 0.0, help="time of the first sample, below the period", unit="s", least=0
    )
    delay: float | tuple[float, ...] = keyed(
        "number or numbers",
        0.0,
        help="from a sample until its input acts; of several a run has the first",
        unit="periods",
        least=0,
        most=MAX_DELAY,
    )
    jitter: float = keyed(
        "number",
        0.0,
        help="largest shift of a sample, and of an input, from its time; at most half the delay",
        unit="periods",
        least=0,
        most=MAX_JITTER,
    )
    jitter_pattern: str = keyed(
        "choice",
        RANDOM,
        help="how the shifts of a run go; proofs are of all",
        choices=JITTER_PATTERNS,
    )
    counted_delay: float | None = keyed(
        "number",
        None,
        help="the delay that observers and sampled feed-forward count on",
        unit="periods",
        least=0,
        most=MAX_DELAY,
        otherwise="that of a run",
    )
    saturation: tuple[float, float] | None = keyed(
        "interval",
        None,
        help="limits of the input",
        strict=True,
        otherwise="no limits",
    )
    rate_limit: float | None = keyed(
        "number", None, help="largest slope of the input", above=0, otherwise="no limit"
    )
    input_quantum: float = keyed(
        "number", 0.0, help="step of the actuator's converter; 0 for none", least=0
    )
    measurement_quantum: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="step of each sensor, e.g. of an encoder",
        shape="one number per state",
        least=0,
        otherwise="zero",
    )
    noise: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="standard deviation of the noise of each sensor",
        shape="one number per state",
        least=0,
        otherwise="zero",
    )
    noise_bound: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="largest noise of each sensor: simulated noise is clipped to it",
        shape="one number per state",
        least=0,
        otherwise="no limit",
    )
    sensor_error: tuple[Expression, ...] | None = keyed(
        "formulas",
        None,
        help="error of each sensor besides noise, a formula of t, within noise_bound",
        shape="one per state",
        otherwise="zero",
    )
    seed: int = keyed("integer", 0, help="seed of the noise", least=0, most=MAX_SEED)
    stream: int = keyed(
        "integer",
        0,
        help="stream of the noise; a member of an ensemble has its own",
        least=0,
        most=MAX_SEED,
    )
    velocity: tuple[str, ...] = keyed(
        "names",
        (),
        help="states not measured but computed from filtered differences of the one before",
        shape="names of states",
    )
    velocity_filter: float = keyed(
        "number", 0.0, help="time constant of that filter; 0 for none", unit="s", least=0
    )
    update: str = keyed(
        "choice",
        "euler",
        help="step of the estimates: forward Euler, or exact for their constant leak",
        choices=UPDATES,
    )
    anti_windup: str = keyed(
        "choice",
        "leak",
        help="while the input is limited the estimates only leak, stand still, or go on adapting",
        choices=ANTI_WINDUPS,
    )
    projection: tuple[tuple[float, float], ...] | None = keyed(
        "intervals",
        None,
        help="limits of the estimates",
        shape="[low, high] per estimate",
        otherwise="no limits",
    )
    initial_input: float = keyed("number", 0.0, help="input before the first sample acts")

    def __post_init__(self) -> None:
        names = [name for name in keys_of(self) if name != "sensor_error"]
        check_fields(self, "implementation", *names)
        if self.sensor_error is not None:
            key, shape = "implementation.sensor_error", keys_of(self)["sensor_error"].shape
            entries = checks.sequence(key, self.sensor_error, None, shape)
            errors = (parse(f"{key}[{i}]", entry, ["t"]) for i, entry in enumerate(entries))
            set_fields(self, sensor_error=tuple(errors))
        if self.offset >= self.period:
            raise InputError("implementation.offset", "must be less than the period", self.offset)
        if self.saturation is not None:
            self._check_saturation(self.saturation)
        if not 1 <= len(self.delays) <= MAX_DELAYS:
            count, wanted = len(self.delays), f"must be a number or a list of 1 to {MAX_DELAYS}"
            raise InputError("implementation.delay", wanted, f"a list of {count}")
        if 2 * self.jitter > min(self.delays):
            wanted = "must be at most half of every delay, for an input follows its sample"
            raise InputError("implementation.jitter", wanted, self.jitter)
        for i, (noise, bound) in enumerate(
            zip(self.noise or (), self.noise_bound or (), strict=False)
        ):
            if noise and not bound:
                raise InputError(
                    f"implementation.noise_bound[{i}]",
                    "must be positive where there is noise",
                    bound,
                    f"State the largest noise, or set implementation.noise[{i}] = 0",
                )
        if self.velocity_filter and not self.velocity:
            raise InputError(
                "implementation.velocity_filter",
                "filters nothing",
                remedy="Name the states in implementation.velocity",
            )

    def _check_saturation(self, saturation: tuple[float, float]) -> None:
        initial, quantum = self.initial_input, self.input_quantum
        if not saturation[0] <= initial <= saturation[1]:
            raise InputError(
                "implementation.initial_input", "must be within the saturation", initial
            )
        if quantum:
            low, high = _steps_within(saturation, quantum)
            if low > high:
                raise InputError(
                    "implementation.input_quantum", "has no step within the saturation", quantum
                )

    def bound_to(self, plant: Plant, estimates: int) -> Implementation:
        """This implementation checked against `plant` and the number of estimates.

        Lists of zeros become None.
        """
        keys = keys_of(self)
        per_state = (*PER_STATE, "sensor_error")
        for name, count in (*((name, plant.n) for name in per_state), ("projection", estimates)):
            if getattr(self, name) is not None:
                values = getattr(self, name)
                checks.sequence(f"implementation.{name}", values, count, keys[name].shape)
        for i, name in enumerate(self.velocity):
            key = f"implementation.velocity[{i}]"
            checks.choice(key, name, plant.states)
            if name == plant.states[0]:
                raise InputError(key, "the first state has none before it to be differenced", name)
        changes: dict[str, Any] = {
            name: None for name in PER_STATE if not any(getattr(self, name) or (True,))
        }
        in_order = tuple(name for name in plant.states if name in self.velocity)
        if in_order != self.velocity:
            changes["velocity"] = in_order
        return replace(self, **changes) if changes else self

    @property
    def delays(self) -> tuple[float, ...]:
        """All delays, periods: a certificate of the sampled loop covers each."""
        return self.delay if isinstance(self.delay, tuple) else (self.delay,)

    @property
    def run_delay(self) -> float:
        """The delay of a run, periods: the first."""
        return self.delays[0]

    @property
    def design_delay(self) -> float:
        """The delay that the controller counts on, periods."""
        return self.run_delay if self.counted_delay is None else self.counted_delay

    def largest_noise(self, states: int) -> tuple[float, ...]:
        """The largest |noise| on each of the `states`; what noise_bound says, or zero.

        Raises
        ------
        InputError
            If there is normal noise without a bound.
        """
        noisy = self.noise is not None or self.sensor_error is not None
        if noisy and self.noise_bound is None:
            raise InputError(
                "implementation.noise_bound",
                "is missing: normal noise has no largest value, so the loop has no worst case"
                if self.noise is not None
                else "is missing: it has to cover implementation.sensor_error",
                remedy=f"State one number per state, e.g. {NOISE_BOUND_DEVIATIONS} times the noise",
            )
        return self.noise_bound or (0.0,) * states

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
        inputs: np.ndarray = np.clip(np.rint(command / quantum) * quantum, low, high)
        return inputs

    def sensor_errors(self, times: np.ndarray) -> np.ndarray | None:
        """The errors of the sensors at times, a row each; None where there are none."""
        if self.sensor_error is None:
            return None
        errors = numpy_callable([TIME], [formula.expr for formula in self.sensor_error])
        return rows(errors(times), len(times))

    def samples(self, duration: float) -> int:
        """Number of samples in a run.

        Raises
        ------
        InputError
            If there are too many to be meant.
        """
        count = (duration - self.offset) / self.period
        if count > MAX_RUN_SAMPLES:
            raise InputError(
                "implementation.period",
                f"makes more than {MAX_RUN_SAMPLES} samples in simulation.duration",
                self.period,
                "State the period in seconds",
            )
        return max(0, int(count * (1 + COUNT_ROUNDING))) + 1


def _steps_within(saturation: tuple[float, float], quantum: float) -> tuple[float, float]:
    """Numbers of the lowest and highest step of a converter; rounding of a limit does no harm."""
    low, high = (end / quantum for end in saturation)
    return float(np.ceil(low - STEP_ROUNDING)), float(np.floor(high + STEP_ROUNDING))

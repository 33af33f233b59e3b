"""The adversary: all that the assumptions leave open, as numbers with ranges.

Each part knows its numbers, and writes them into a system or into the parameters of a compiled
loop. Whatever the numbers, the assumptions hold:

* disturbances w_k = tanh(m_k sin(omega_k t + phase_k) + v_k . x) (gamma_k ||x|| + beta_k): nearly
  bang-bang patterns with searched frequency, phase, hardness and state feedback; sines within their
  rate where that is bounded;
* references of searched amplitude, frequency, phase and shape within Y_0 ... Y_{q+1};
* g_n and theta within the ranges of the file;
* where the gains move, any motion of them between their ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from certrack.core.errors import InputError
from certrack.model.names import refuse_prefix
from certrack.references import SymbolicReference
from certrack.references.base import bound_of
from certrack.studies.falsifier.draft import ParameterTable, SystemDraft
from certrack.studies.falsifier.patterns import (
    ADVERSARY_PREFIX,
    BELOW_ONE,
    MAX_FREQUENCY,
    MIN_FREQUENCY,
    AdversaryPart,
    FreeLevel,
    Pattern,
    SearchVariable,
)
from certrack.systems.system import System

#: The fastest frequency searched is at least this, rad/s, however slow the design.
LEAST_FASTEST = 0.5

#: ||x|| in the disturbances is sqrt(x.x + offset^2) - offset: larger than in an ensemble, lest the
#: Taylor method take tiny steps where feedback drives the state through zero.
ADVERSARY_NORM_OFFSET = 1e-4

#: Where the search begins: frequencies over that of the fastest full-size reference, and phases.
PLAUSIBLE_FACTORS, PLAUSIBLE_PHASES = (1.0, 2.0, 0.5, 3.0), 4

#: Range of the shape k of asin(k sin): below it is a sine, above it a triangle, whose corners cost
#: ever more steps; and the shape to begin with.
MIN_BEND, MAX_BEND, PLAUSIBLE_BEND = 0.05, 0.999, 0.9

#: Least amplitude over Y_0, and least frequency over the highest admissible one: the frequency of a
#: reference without amplitude is not defined, and one without frequency is none to track.
LEAST_SIZE, LEAST_SPEED = 0.02, 0.05

#: A reference turns at most so many times as fast as the fastest pattern.
REFERENCE_SPEEDUP = 3.0

#: Names of a wave's numbers among the constants of the reference.
WAVE_CONSTANTS = ("r_a", "r_k", "r_w", "r_p")
BEND = WAVE_CONSTANTS[1]

#: Times at which a reference without bounds is evaluated.
REFERENCE_SAMPLES = 1001

#: Keeps derivatives of the reference below their bounds in spite of rounding.
BELOW_BOUND = 1 - 1e-12


class Wave(NamedTuple):
    """y_d = amplitude sin(frequency t + phase); with a bend, amplitude asin(bend sin(...))."""

    amplitude: float
    bend: float | None
    frequency: float
    phase: float


@dataclass(frozen=True)
class ReferenceShape(AdversaryPart):
    """A reference within the bounds of the system's own.

    Attributes
    ----------
    bounds : (Y_0, ..., Y_{q+1})
    fastest : float, rad/s
        The fastest frequency of the patterns.
    """

    bounds: tuple[float, ...]
    fastest: float

    @property
    def bent(self) -> bool:
        """Whether its shape is searched: only where no second derivative is bounded (q = 0)."""
        return len(self.bounds) == 2

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        size, speed = SearchVariable("size", 0.0, 1.0), SearchVariable("speed", 0.0, 1.0)
        phase, shape = (
            SearchVariable("phase", 0.0, 2 * math.pi),
            SearchVariable("shape", MIN_BEND, MAX_BEND),
        )
        return (size, speed, phase, shape) if self.bent else (size, speed, phase)

    def plausible(self, frequency: float, phase: float) -> tuple[float, ...]:
        return (1.0, 1.0, 0.0, PLAUSIBLE_BEND) if self.bent else (1.0, 1.0, 0.0)

    def wave(self, size: float, speed: float, phase: float, shape: float | None = None) -> Wave:
        """The reference of a member; `size` and `speed` are shares of what is admissible."""
        Y = self.bounds
        amplitude = Y[0] * (LEAST_SIZE + (1 - LEAST_SIZE) * size)
        if shape is not None:  # asin(k sin) is nearly a triangle as k -> 1
            scale = amplitude / math.asin(shape)
            frequency = Y[1] * math.asin(shape) / (amplitude * shape) if amplitude else 1.0
        else:
            scale = amplitude
            orders = range(1, len(Y)) if amplitude else ()
            frequency = min(((Y[i] / amplitude) ** (1 / i) for i in orders), default=1.0)
        frequency = min(frequency, REFERENCE_SPEEDUP * self.fastest)
        frequency *= LEAST_SPEED + (1 - LEAST_SPEED) * speed
        return Wave(scale, shape, frequency * BELOW_BOUND, phase)

    def waves(self, values: np.ndarray) -> np.ndarray:
        """The references of N members, values (G, N): a row for each field of :class:`Wave`."""
        waves = [self.wave(*column) for column in values.T.tolist()]
        return np.array(waves, dtype=float).T

    def reference(self, waves: np.ndarray, t: np.ndarray) -> np.ndarray:
        """y_d of N members at the times t, shape (T, N)."""
        amplitude, bend, frequency, phase = waves
        sine = np.sin(frequency * t[:, None] + phase)
        return amplitude * (np.arcsin(bend * sine) if self.bent else sine)

    def write_system(self, values: Sequence[float], draft: SystemDraft, *, named: bool) -> None:
        wave = self.wave(*values)
        a, k, w, p = (f"({value!r})" for value in wave)
        constants = {}
        if named:
            a, k, w, p = WAVE_CONSTANTS
            pairs = zip(WAVE_CONSTANTS, wave, strict=True)
            constants = {name: value for name, value in pairs if value is not None}
        sine = f"sin({w}*t + {p})"
        text = f"{a}*asin({k}*{sine})" if self.bent else f"{a}*{sine}"
        draft.reference = SymbolicReference(text, constants=constants)  # type: ignore[arg-type]

    def write_parameters(self, values: np.ndarray, table: ParameterTable) -> None:
        for name, row in zip(WAVE_CONSTANTS, self.waves(values), strict=True):
            if name != BEND or self.bent:
                table.set(f"ref_{name}", row)


@dataclass(frozen=True)
class DisturbancePattern(Pattern):
    """w_k of one state, a share of its bound.

    Attributes
    ----------
    bound : formula
        The bound of w_k.
    """

    bound: str

    def write(self, pattern: str, draft: SystemDraft) -> None:
        draft.omega[int(self.name)] = f"{BELOW_ONE}*{pattern}*({self.bound})"


@dataclass(frozen=True)
class SlowSine(AdversaryPart):
    """w_k of one state whose rate is bounded: a sine within both bounds.

    Attributes
    ----------
    k : int
        Number of the state, from 0.
    size, rate : float
    fastest : float, rad/s
    """

    k: int
    size: float
    rate: float
    fastest: float

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        return (
            SearchVariable(f"{ADVERSARY_PREFIX}w{self.k}", MIN_FREQUENCY, self.fastest),
            SearchVariable(f"{ADVERSARY_PREFIX}p{self.k}", 0.0, 2 * math.pi),
        )

    def plausible(self, frequency: float, phase: float) -> tuple[float, ...]:
        return (frequency, phase)

    def write_system(self, values: Sequence[float], draft: SystemDraft, *, named: bool) -> None:
        numbers = {
            variable.name: value for variable, value in zip(self.variables, values, strict=True)
        }
        if named:
            draft.constants |= numbers
        w, p = (name if named else f"({value!r})" for name, value in numbers.items())
        size, rate = BELOW_ONE * self.size, BELOW_ONE * self.rate
        # rate/(w + rate/size) is at most the size, and times w at most the rate
        draft.omega[self.k] = f"{rate!r}*{size!r}/({size!r}*{w} + {rate!r})*sin({w}*t + {p})"
        if not size * rate:
            draft.omega[self.k] = f"{size!r}*sin({p})"

    def write_parameters(self, values: np.ndarray, table: ParameterTable) -> None:
        for variable, row in zip(self.variables, values, strict=True):
            table.set_constant(variable.name, row)


@dataclass(frozen=True)
class TrueGain(AdversaryPart):
    """g_n within the range of the file; n is the plant's order."""

    n: int
    low: float
    high: float

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        return (SearchVariable("input_gain", self.low, self.high),)

    def write_system(self, values: Sequence[float], draft: SystemDraft, *, named: bool) -> None:
        (draft.input_gain,) = values

    def write_parameters(self, values: np.ndarray, table: ParameterTable) -> None:
        table.set(f"true_g_{self.n - 1}", values[0])


@dataclass(frozen=True)
class TrueTheta(AdversaryPart):
    """Entry i of theta within the range of the file."""

    i: int
    low: float
    high: float

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        return (SearchVariable(f"theta[{self.i}]", self.low, self.high),)

    def write_system(self, values: Sequence[float], draft: SystemDraft, *, named: bool) -> None:
        (draft.theta[self.i],) = values

    def write_parameters(self, values: np.ndarray, table: ParameterTable) -> None:
        table.set(f"true_theta_{self.i}", values[0])


@dataclass(frozen=True)
class Adversary:
    """All that an adversary may choose against one system.

    Attributes
    ----------
    reference : ReferenceShape
    others : tuple of AdversaryPart
    """

    reference: ReferenceShape
    others: tuple[AdversaryPart, ...]

    @classmethod
    def against(cls, system: System) -> Adversary:
        """The adversary that the system's assumptions admit.

        Raises
        ------
        InputError
            If the plant has names that the adversary gives to its own numbers.
        """
        plant, u = system.plant, system.plant.uncertainty
        refuse_prefix(plant, ADVERSARY_PREFIX, "falsify")
        coordinates = system.controller.coordinates
        fastest = max(LEAST_FASTEST, min(MAX_FREQUENCY, system.controller.fastest_pole))
        bounds = reference_bounds(system, coordinates.q + 1)
        bound = partial(u.bound_formula, states=plant.states, offset=ADVERSARY_NORM_OFFSET)
        others: list[AdversaryPart] = []
        for k in range(plant.n):
            slowness = u.slowness(k)
            if u.tau[k] > 0 and u.acts(k) and slowness is not None:
                others.append(SlowSine(k, u.beta[k], slowness.rate, fastest))
            elif u.tau[k] > 0 and u.acts(k):
                others.append(DisturbancePattern(str(k), plant.states, fastest, bound(k)))
        if plant.input_gain_range and len(set(plant.input_gain_range)) > 1:
            others.append(TrueGain(plant.n, *plant.input_gain_range))
        for i, box in enumerate(plant.theta_range or ()):
            others += [TrueTheta(i, *box)] if box[0] < box[1] else []
        if system.law.online is not None:
            others.append(FreeLevel("g", plant.states, fastest))
        return cls(ReferenceShape(tuple(bounds), fastest), tuple(others))

    @property
    def parts(self) -> tuple[AdversaryPart, ...]:
        """All parts, in the order of the variables."""
        return (self.reference, *self.others)

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        """All numbers."""
        return tuple(variable for part in self.parts for variable in part.variables)

    def slices(self) -> list[tuple[AdversaryPart, slice]]:
        """Every part, and where its numbers lie among all."""
        ends = np.cumsum([len(part.variables) for part in self.parts]).tolist()
        begins = [0, *ends[:-1]]
        return [(part, slice(a, b)) for part, a, b in zip(self.parts, begins, ends, strict=True)]

    def plausible_starts(self) -> np.ndarray:
        """Points (a row each) to begin with: in step with the reference, no feedback."""
        Y = self.reference.bounds
        frequency = Y[1] / Y[0] if Y[0] else 1.0
        low, high = np.array([(variable.low, variable.high) for variable in self.variables]).T
        rows = [
            [v for part in self.parts for v in part.plausible(factor * frequency, phase)]
            for factor in PLAUSIBLE_FACTORS
            for phase in np.arange(PLAUSIBLE_PHASES) * 2 * math.pi / PLAUSIBLE_PHASES
        ]
        return np.clip(rows, low, high)


def reference_bounds(system: System, order: int) -> list[float]:
    """Y_0 ... Y_order; where there is none any is admissible: what the run reaches."""
    bounds = []
    for i in range(order + 1):
        try:
            bounds.append(bound_of(system.reference, i)[0])
        except InputError:
            times = np.linspace(0.0, system.settings.duration, REFERENCE_SAMPLES)
            bounds.append(float(np.abs(system.reference.values(times, i)[i]).max()))
    return bounds

"""What varies between the members of an ensemble, and how it is sampled.

A member's numbers are a pure function of the seed and its index, so any member can be replayed
alone and any division of the work gives the same ensemble.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.model.plant import Plant, check_gain, check_within, name_value_pairs
from certrack.model.truth import Truth

SAMPLINGS = ("plain", "latin", "sobol")
DISTURBANCES = ("file", "multisine")

#: Members that are drawn together; a Latin hypercube stratifies each of these groups.
GROUP = 1024

#: Sobol points that exist.
MOST = 2**30

MAX_SINES = 50


@dataclass(frozen=True)
class Distribution:
    """Distribution of one number.

    Parameters
    ----------
    kind : {"fixed", "uniform", "loguniform", "truncnorm"}
        SciPy's names.
    values : numbers
        ``fixed``: the value; ``uniform`` and ``loguniform``: low, high; ``truncnorm``: mean and
        standard deviation of the normal distribution, then low, high between which it is cut.
    """

    kind: str
    values: tuple[float, ...]

    @property
    def low(self) -> float:
        """Smallest value."""
        return self.values[-2] if len(self.values) > 1 else self.values[0]

    @property
    def high(self) -> float:
        """Largest value."""
        return self.values[-1]

    @property
    def fixed(self) -> bool:
        """Whether it always gives the same number."""
        return self.low == self.high

    def quantile(self, p: np.ndarray) -> np.ndarray:
        """Values at the probabilities p in [0, 1]."""
        low, high = self.low, self.high
        if self.fixed:
            return np.full(np.shape(p), low)
        if self.kind == "uniform":
            found = low + p * (high - low)
        elif self.kind == "loguniform":
            found = low * (high / low) ** p
        else:
            from scipy.stats import truncnorm

            mean, deviation = self.values[:2]
            a, b = (low - mean) / deviation, (high - mean) / deviation
            found = mean + deviation * truncnorm.ppf(p, a, b)
        return np.clip(found, low, high)


KINDS = {"uniform": 2, "loguniform": 2, "truncnorm": 4}


def distribution(key: str, value: Any, known: Mapping[str, Any] | None = None) -> Distribution:
    """A distribution from ``{kind = [numbers]}``, or a number that is fixed.

    Raises
    ------
    InputError
        If it is neither, or its limits do not fit.
    """
    if isinstance(value, Distribution):
        if value.kind == "fixed":
            return value
        value = {value.kind: list(value.values)}
    if not isinstance(value, Mapping):
        return Distribution("fixed", (checks.real(key, value, known),))
    if len(value) != 1:
        raise InputError(key, "must be a number or one distribution", dict(value), _REMEDY)
    kind, numbers = next(iter(value.items()))
    if kind not in KINDS:
        raise InputError(key, "must be one of " + ", ".join(KINDS), kind, _REMEDY)
    what = "mean, deviation, low, high" if kind == "truncnorm" else "low, high"
    found = checks.reals(f"{key}.{kind}", numbers, KINDS[kind], what, known)
    if found[-2] > found[-1]:
        raise InputError(f"{key}.{kind}", "low must not exceed high", list(found))
    if kind == "loguniform" and found[0] <= 0:
        raise InputError(f"{key}.{kind}", "low must be positive", found[0])
    if kind == "truncnorm" and found[1] <= 0:
        raise InputError(f"{key}.{kind}", "the deviation must be positive", found[1])
    return Distribution(kind, found)


_REMEDY = "For example {uniform = [-1, 1]}"


@dataclass(frozen=True)
class Population:
    """What varies between members, and how; what is left out is as in the system.

    Parameters
    ----------
    x0 : n distributions, optional
        Initial plant states; those of the truth where it has states of its own.
    estimates : distributions, optional
        Initial controller states.
    input_gain : distribution, optional
        True g_n.
    theta : r distributions, optional
        True theta.
    tau : n distributions, optional
        True strengths of the disturbances.
    constants : mapping of names to distributions, optional
        True values of plant constants.
    amplitude, frequency : distribution, optional
        Factors on the reference and on its time: amplitude y_d(frequency t).
    disturbance : {"file", "multisine"}
        The system's omega, or w_k = s_k(t) (gamma_k ||x|| + beta_k) where s_k is a sum of sines of
        random weight, frequency and phase with |s_k| <= 1: always within Assumption 1.
    sines : int
        Terms of each s_k.
    frequencies : (low, high), rad/s
        Of the sines, log-uniform.
    sampling : {"plain", "latin", "sobol"}
        Independent members; Latin hypercubes of 1024 members each; or a scrambled Sobol sequence.
    points : int
        Intervals of the time grid on which quantile bands are kept.
    limit : float > 0, optional
        A member whose tail error exceeds it counts as a violation; the certificate if left out.
    """

    x0: tuple[Distribution, ...] | None = None
    estimates: tuple[Distribution, ...] | None = None
    input_gain: Distribution | None = None
    theta: tuple[Distribution, ...] | None = None
    tau: tuple[Distribution, ...] | None = None
    constants: tuple[tuple[str, Distribution], ...] = ()
    amplitude: Distribution | None = None
    frequency: Distribution | None = None
    disturbance: str = "file"
    sines: int = 3
    frequencies: tuple[float, float] = (0.1, 10.0)
    sampling: str = "plain"
    points: int = 200
    limit: float | None = None

    def bound_to(self, plant: Plant, truth: Truth, estimates: int) -> Population:
        """This population checked against plant, truth and the number of controller states."""
        known = plant.constant_values
        whose = "one per state of the truth" if truth.states else "one per state"
        if truth.states:
            self._refuse_design_form()

        def some(key: str, given: Any, count: int, what: str) -> tuple[Distribution, ...] | None:
            if given is None:
                return None
            entries = checks.sequence(f"ensemble.{key}", given, count, what)
            return tuple(
                distribution(f"ensemble.{key}[{i}]", v, known) for i, v in enumerate(entries)
            )

        def one(key: str, given: Any) -> Distribution | None:
            return None if given is None else distribution(f"ensemble.{key}", given, known)

        gain = one("input_gain", self.input_gain)
        if gain is not None:
            for end in (gain.low, gain.high):
                check_gain("ensemble.input_gain", end, plant.gain_sign)
                check_within("ensemble.input_gain", end, plant.input_gain_range, "input_gain")
        theta = some("theta", self.theta, plant.r, "one per regressor")
        for i, (entry, box) in enumerate(zip(theta or (), plant.theta_range or (), strict=False)):
            for end in (entry.low, entry.high):
                check_within(f"ensemble.theta[{i}]", end, box, "theta")
        tau = some("tau", self.tau, plant.n, "one per state")
        for i, entry in enumerate(tau or ()):
            if entry.low < 0:
                raise InputError(f"ensemble.tau[{i}]", "must be zero or positive", entry.low)
        constants = []
        for name, value in name_value_pairs("ensemble.constants", self.constants):
            key = f"ensemble.constants.{name}"
            if name not in (*known, *dict(truth.constants)):
                raise InputError(key, "is not a constant of the plant or of the truth")
            constants.append((name, distribution(key, value, known)))
        amplitude = one("reference.amplitude", self.amplitude)
        frequency = one("reference.frequency", self.frequency)
        if frequency is not None and frequency.low <= 0:
            raise InputError("ensemble.reference.frequency", "must be positive", frequency.low)
        low, high = checks.interval("ensemble.frequencies", self.frequencies, known)
        if low <= 0:
            raise InputError("ensemble.frequencies", "must be positive", low)
        limit = self.limit
        return Population(
            x0=some("x0", self.x0, len(truth.states or plant.states), whose),
            estimates=some("estimates", self.estimates, estimates, "one per controller state"),
            input_gain=gain,
            theta=theta,
            tau=tau,
            constants=tuple(constants),
            amplitude=amplitude,
            frequency=frequency,
            disturbance=checks.choice("ensemble.disturbance", self.disturbance, DISTURBANCES),
            sines=checks.integer("ensemble.sines", self.sines, 1, MAX_SINES),
            frequencies=(low, high),
            sampling=checks.choice("ensemble.sampling", self.sampling, SAMPLINGS),
            points=checks.integer("ensemble.points", self.points, 2, 10_000),
            limit=None if limit is None else checks.real("ensemble.limit", limit, known, above=0),
        )

    def _refuse_design_form(self) -> None:
        """What a truth with states of its own has no place for."""
        own = "where the truth has states of its own"
        for name in ("input_gain", "theta", "tau"):
            if getattr(self, name) is not None:
                remedy = "Vary ensemble.constants and ensemble.x0"
                raise InputError(f"ensemble.{name}", f"must be left out {own}", remedy=remedy)
        if self.disturbance == "multisine":
            message = f"must be file {own}: its rates hold the disturbances"
            raise InputError("ensemble.disturbance", message, self.disturbance)

    @classmethod
    def default(cls, plant: Plant, truth: Truth) -> Population:
        """Every plant within the ranges, under every disturbance within the bounds.

        A truth with states of its own says itself what it is; then nothing varies.
        """
        if truth.states:
            return cls()

        def uniform(box: tuple[float, float]) -> Distribution:
            return Distribution("uniform", box)

        gain, theta, u = plant.input_gain_range, plant.theta_range, plant.uncertainty
        disturbed = any(t * (g + b) for t, g, b in zip(u.tau, u.gamma, u.beta, strict=True))
        return cls(
            input_gain=uniform(gain) if gain else None,
            theta=tuple(uniform(box) for box in theta) if theta else None,
            disturbance="multisine" if disturbed else "file",
        )


def probabilities(sampling: str, seed: int, begin: int, end: int, count: int) -> np.ndarray:
    """Numbers in [0, 1) of the members begin ... end-1, shape (count, end - begin).

    Raises
    ------
    InputError
        If the sequence has no such members.
    """
    if not 0 <= begin < end <= MOST:
        raise InputError("members", f"must be at most {MOST}", end)
    if not count:
        return np.empty((0, end - begin))
    if sampling == "sobol":
        return _sobol(seed, count, begin, end)
    first, last = begin // GROUP, (end - 1) // GROUP
    groups = [_group(sampling, seed, group, count) for group in range(first, last + 1)]
    table = np.concatenate(groups, axis=1)
    return table[:, begin - first * GROUP : end - first * GROUP]


def _group(sampling: str, seed: int, group: int, count: int) -> np.ndarray:
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, group])))
    if sampling == "plain":
        return rng.random((GROUP, count)).T
    from scipy.stats import qmc

    return qmc.LatinHypercube(count, rng=rng).random(GROUP).T


def _sobol(seed: int, count: int, begin: int, end: int) -> np.ndarray:
    import warnings

    from scipy.stats import qmc

    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed])))
    engine = qmc.Sobol(count, rng=rng)
    if begin:
        engine.fast_forward(begin)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a part of the sequence need not be a power of two
        found: np.ndarray = engine.random(end - begin).T
    return found

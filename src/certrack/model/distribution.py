"""The distribution of one number, as a file or a user states it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import set_fields

#: What the numbers of each kind of distribution are; of an empirical one, any number of samples.
PARAMETERS = {
    "fixed": ("the value",),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "truncnorm": ("mean", "deviation", "low", "high"),
    "empirical": ("samples",),
}

#: Those that are written ``{kind = [numbers]}``; a fixed number is written as it is.
WRITTEN_KINDS = tuple(kind for kind in PARAMETERS if kind != "fixed")

EXAMPLE = "For example {uniform = [-1, 1]}, or {norm = {loc = 0, scale = 1}} as in scipy.stats"

#: SciPy's distributions are cut off at the quantiles of this probability and of its complement:
#: certificates, limits and bands need ends, and a normal distribution has none.
TAIL_PROBABILITY = 1e-9

#: More samples of an empirical distribution than this are refused.
MAX_SAMPLES = 1_000_000


@dataclass(frozen=True)
class Distribution:
    """Distribution of one number.

    Parameters
    ----------
    kind : str
        ``fixed``, ``uniform``, ``loguniform``, ``truncnorm``, ``empirical``, or the name of any
        distribution of scipy.stats.
    values : numbers
        ``fixed``: the value; ``uniform`` and ``loguniform``: low, high; ``truncnorm``: mean and
        standard deviation of the normal distribution, then low, high between which it is cut;
        ``empirical``: samples, each as likely as any other.
    parameters : pairs (name, number)
        Of a distribution of scipy.stats: its shapes, loc and scale. It is cut off at the quantiles
        1e-9 and 1 - 1e-9.

    Raises
    ------
    InputError
        If there is no such kind, or its numbers do not fit.

    Examples
    --------
    >>> import scipy.stats
    >>> from certrack import Distribution
    >>> str(Distribution.of(scipy.stats.norm(loc=2, scale=0.1)))
    '{norm = {loc = 2, scale = 0.1}}'
    >>> Distribution.empirical([1.8, 2.0, 2.3]).high
    2.3
    """

    kind: str
    values: tuple[float, ...] = ()
    parameters: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if self.parameters:
            self._check_parameters()
            return
        kind = checks.choice("distribution", self.kind, PARAMETERS)
        names = PARAMETERS[kind]
        count = None if kind == "empirical" else len(names)
        values = checks.reals(kind, self.values, count, ", ".join(names))
        if kind == "empirical":
            if not 1 <= len(values) <= MAX_SAMPLES:
                raise InputError(kind, f"must be 1 to {MAX_SAMPLES} samples", len(values))
            values = tuple(sorted(values))
        set_fields(self, values=values)
        if self.low > self.high:
            raise InputError(kind, "low must not exceed high", list(values))
        if kind == "loguniform" and values[0] <= 0:
            raise InputError(kind, "low must be positive", values[0])
        if kind == "truncnorm" and values[1] <= 0:
            raise InputError(kind, "the deviation must be positive", values[1])

    def _check_parameters(self) -> None:
        numbers = dict(self.parameters)
        for name, value in numbers.items():
            numbers[name] = checks.real(f"{self.kind}.{name}", value)
        set_fields(self, values=(), parameters=tuple(sorted(numbers.items())))
        low, high = self._ends
        if not (np.isfinite(low) and np.isfinite(high)):
            raise InputError(self.kind, "has no such distribution", numbers, "See scipy.stats")

    @classmethod
    def empirical(cls, samples: Sequence[float] | np.ndarray) -> Distribution:
        """Samples, each as likely as any other: measurements of a fleet, for example."""
        return cls("empirical", tuple(np.asarray(samples, dtype=float).ravel().tolist()))

    @classmethod
    def of(cls, frozen: Any) -> Distribution:
        """A frozen distribution of scipy.stats, such as ``scipy.stats.beta(2, 3, scale=0.5)``.

        Raises
        ------
        InputError
            If it is none that scipy.stats has by a name.
        """
        family: Any = getattr(frozen, "dist", None)
        name = getattr(family, "name", None)
        if name is None or type(_scipy_family(str(name))) is not type(family):
            message = "must be a frozen distribution of scipy.stats"
            raise InputError("distribution", message, frozen, "Use Distribution.empirical(samples)")
        shapes = (family.shapes or "").replace(" ", "").split(",")
        names = [*filter(None, shapes), "loc", *(["scale"] if hasattr(family, "pdf") else [])]
        stated = dict(zip(names, frozen.args, strict=False)) | frozen.kwds
        if name == "uniform":
            low = float(stated.get("loc", 0.0))
            return cls("uniform", (low, low + float(stated.get("scale", 1.0))))
        numbers = tuple((key, float(value)) for key, value in stated.items())
        return cls(str(name), (), numbers or (("loc", 0.0),))

    @cached_property
    def _frozen(self) -> Any:
        """SciPy's distribution."""
        family = _scipy_family(self.kind)
        if family is None:
            known = ", ".join(WRITTEN_KINDS)
            message = f"must be one of {known}, or a distribution of scipy.stats"
            raise InputError("distribution", message, self.kind)
        try:
            return family(**dict(self.parameters))
        except (TypeError, ValueError) as problem:
            reason = str(problem) or "its parameters do not fit"
            raise InputError(self.kind, reason, dict(self.parameters), "See scipy.stats") from None

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Smallest and largest value of a distribution of SciPy."""
        return float(self._frozen.ppf(TAIL_PROBABILITY)), float(
            self._frozen.ppf(1 - TAIL_PROBABILITY)
        )

    @property
    def low(self) -> float:
        """Smallest value."""
        if self.parameters:
            return self._ends[0]
        if self.kind == "empirical":
            return self.values[0]
        return self.values[-2] if len(self.values) > 1 else self.values[0]

    @property
    def high(self) -> float:
        """Largest value."""
        return self._ends[1] if self.parameters else self.values[-1]

    @property
    def fixed(self) -> bool:
        """Whether it always gives the same number."""
        return self.low == self.high

    def quantile(self, p: np.ndarray) -> np.ndarray:
        """Values at the probabilities p in [0, 1]."""
        low, high = self.low, self.high
        if self.fixed:
            return np.full(np.shape(p), low)
        if self.kind == "uniform" and not self.parameters:
            values = low + p * (high - low)
        elif self.kind == "loguniform" and not self.parameters:
            values = np.exp((1 - p) * np.log(low) + p * np.log(high))
        elif self.kind == "empirical":
            place = np.asarray(np.floor(np.asarray(p) * len(self.values)), dtype=int)
            values = self._sorted[np.minimum(place, len(self.values) - 1)]
        elif self.parameters:
            values = self._frozen.ppf(np.clip(p, TAIL_PROBABILITY, 1 - TAIL_PROBABILITY))
        else:
            from scipy.stats import truncnorm

            mean, deviation = self.values[:2]
            a, b = (low - mean) / deviation, (high - mean) / deviation
            values = mean + deviation * truncnorm.ppf(p, a, b)
        return np.clip(values, low, high)

    @cached_property
    def _sorted(self) -> np.ndarray:
        return np.array(self.values)

    @property
    def written(self) -> Any:
        """As a system file has it: a number, or a table of one entry."""
        if self.kind == "fixed":
            return self.values[0]
        return {self.kind: dict(self.parameters) if self.parameters else list(self.values)}

    def __str__(self) -> str:
        if self.kind == "fixed":
            return f"{self.values[0]:g}"
        if self.parameters:
            pairs = ", ".join(f"{name} = {value:g}" for name, value in self.parameters)
            return f"{{{self.kind} = {{{pairs}}}}}"
        return f"{{{self.kind} = [{', '.join(f'{value:g}' for value in self.values)}]}}"


def _scipy_family(name: str) -> Any:
    """A distribution of scipy.stats by its name, or None."""
    import scipy.stats

    family = getattr(scipy.stats, name, None) if name.isidentifier() else None
    kinds = (scipy.stats.rv_continuous, scipy.stats.rv_discrete)
    return family if isinstance(family, kinds) else None


def as_distribution(key: str, value: Any) -> Distribution:
    """A distribution from ``{kind = [numbers]}``, a frozen one of SciPy, or a number that is fixed.

    Raises
    ------
    InputError
        If it is none of them, or its limits do not fit.
    """
    if isinstance(value, Distribution):
        return value
    try:
        if hasattr(value, "dist") and hasattr(value, "ppf"):
            return Distribution.of(value)
        if not isinstance(value, Mapping):
            return Distribution("fixed", (checks.real(key, value),))
        if len(value) != 1:
            raise InputError("", "must be a number or one distribution", dict(value), EXAMPLE)
        kind, numbers = next(iter(value.items()))
        if isinstance(numbers, Mapping):
            if _scipy_family(kind) is None or not numbers:
                raise InputError("", "is no distribution of scipy.stats", kind, EXAMPLE)
            return Distribution(kind, (), tuple(numbers.items()))
        if kind not in WRITTEN_KINDS:
            raise InputError("", "must be one of " + ", ".join(WRITTEN_KINDS), kind, EXAMPLE)
        return Distribution(kind, numbers)
    except InputError as problem:
        if problem.key == key:
            raise
        problem.key = f"{key}.{problem.key}" if problem.key else key
        raise problem from None

"""The distribution of one number, as a file or a user states it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import set_fields

#: What the numbers of each kind of distribution are.
PARAMETERS = {
    "fixed": ("the value",),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "truncnorm": ("mean", "deviation", "low", "high"),
}

#: Those that are written ``{kind = [numbers]}``; a fixed number is written as it is.
WRITTEN_KINDS = tuple(kind for kind in PARAMETERS if kind != "fixed")

EXAMPLE = "For example {uniform = [-1, 1]}"


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

    Raises
    ------
    InputError
        If there is no such kind, or its numbers do not fit.
    """

    kind: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        kind = checks.choice("distribution", self.kind, PARAMETERS)
        names = PARAMETERS[kind]
        values = checks.reals(kind, self.values, len(names), ", ".join(names))
        set_fields(self, values=values)
        if self.low > self.high:
            raise InputError(kind, "low must not exceed high", list(values))
        if kind == "loguniform" and values[0] <= 0:
            raise InputError(kind, "low must be positive", values[0])
        if kind == "truncnorm" and values[1] <= 0:
            raise InputError(kind, "the deviation must be positive", values[1])

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
            values = low + p * (high - low)
        elif self.kind == "loguniform":
            values = np.exp((1 - p) * np.log(low) + p * np.log(high))
        else:
            from scipy.stats import truncnorm

            mean, deviation = self.values[:2]
            a, b = (low - mean) / deviation, (high - mean) / deviation
            values = mean + deviation * truncnorm.ppf(p, a, b)
        return np.clip(values, low, high)

    def __str__(self) -> str:
        if self.kind == "fixed":
            return f"{self.values[0]:g}"
        return f"{{{self.kind} = [{', '.join(f'{value:g}' for value in self.values)}]}}"


def as_distribution(key: str, value: Any) -> Distribution:
    """A distribution from ``{kind = [numbers]}``, or a number that is fixed.

    Raises
    ------
    InputError
        If it is neither, or its limits do not fit.
    """
    if isinstance(value, Distribution):
        return value
    if not isinstance(value, Mapping):
        return Distribution("fixed", (checks.real(key, value),))
    if len(value) != 1:
        raise InputError(key, "must be a number or one distribution", dict(value), EXAMPLE)
    kind, numbers = next(iter(value.items()))
    if kind not in WRITTEN_KINDS:
        raise InputError(key, "must be one of " + ", ".join(WRITTEN_KINDS), kind, EXAMPLE)
    try:
        return Distribution(kind, numbers)
    except InputError as problem:
        raise problem.under(key) from None

"""Laws with an observer or integral action: their own numbers beside those of the plain law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from certrack.core.errors import InputError
from certrack.core.rounding import in_digits
from certrack.laws.base import Law
from certrack.laws.observer import Observer
from certrack.tuning.families import GAIN_DIGITS, HIGHEST_GAIN, LOWEST_GAIN, SPREAD, Family

#: What a law has besides that of the continuous loop.
DRIVE_PARTS = ("observer", "integral", "sampled_feedforward")


class DriveFamily(Family):
    """A family, with what the sampled controller has besides.

    v are those of the family, then logarithms of the observer's weights or bandwidths, then of the
    gain of the integral action.

    Parameters
    ----------
    family : Family
        Of the plain laws.
    law : Law
        Has the parts.
    feedforward : int
        q of all of them.
    """

    def __init__(self, family: Family, law: Law, feedforward: int) -> None:
        self.inner, self._observer, self._integral = family, law.observer, law.integral
        self._parts: dict[str, Any] = {
            name: value
            for name in DRIVE_PARTS
            if (value := getattr(law, name)) not in (None, False)
        }
        self._refuse_missing(family.law(family.start))
        if law.sampled_feedforward:
            self._parts["feedforward"] = feedforward
        numbers = [*_numbers_of(law.observer), *([] if law.integral is None else [law.integral])]
        added = np.log(np.array(numbers, dtype=float))
        self._count = len(family.start)
        self.start = np.append(family.start, added)
        self.low = np.append(family.low, added + np.log(LOWEST_GAIN))
        self.high = np.append(family.high, added + np.log(HIGHEST_GAIN))

    @property
    def kind(self) -> str:  # type: ignore[override]
        """Of the laws."""
        return self.inner.kind

    @property
    def own_keys(self) -> tuple[str, ...]:
        """Keys of the numbers that it has besides those of the plain laws."""
        keys = []
        if self._observer is not None:
            weighted = self._observer.weights is not None
            keys.append("law.observer." + ("weights" if weighted else "bandwidth"))
        return (*keys, *(["law.integral"] if self._integral is not None else []))

    def law(self, v: np.ndarray) -> Law:
        return self._joined(self.inner.law(v[: self._count]), np.exp(v[self._count :]))

    def written(self, v: np.ndarray) -> Law:
        added = np.array([in_digits(value, GAIN_DIGITS) for value in np.exp(v[self._count :])])
        return self._joined(self.inner.written(v[: self._count]), added)

    def random(self, rng: np.random.Generator) -> np.ndarray:
        inner, added = self.inner.random(rng), self.start[self._count :]
        moved = np.append(inner, added + SPREAD * rng.standard_normal(len(added)))
        return np.clip(moved, self.low, self.high)

    def _joined(self, plain: Law, added: np.ndarray) -> Law:
        parts = dict(self._parts)
        if self._observer is not None:
            count = len(_numbers_of(self._observer))
            parts["observer"], added = _with_numbers(self._observer, added[:count]), added[count:]
        if self._integral is not None:
            parts["integral"] = float(added[0])
        return replace(plain, **parts)

    def _refuse_missing(self, law: Law) -> None:
        """A linear law knows neither integral action nor sampled feed-forward."""
        known = {field.name for field in fields(law) if field.init}
        for name in self._parts:
            if name not in known:
                raise InputError(
                    f"law.{name}", f"is not known to the {law.kind} law", remedy="Leave it out"
                )


def _numbers_of(observer: Observer | None) -> Sequence[float]:
    """Its weights, or its bandwidths."""
    if observer is None:
        return ()
    if observer.weights is not None:
        return observer.weights
    assert observer.bandwidth is not None
    return observer.bandwidth if isinstance(observer.bandwidth, tuple) else (observer.bandwidth,)


def _with_numbers(observer: Observer, values: np.ndarray) -> Observer:
    numbers = tuple(map(float, values))
    if observer.weights is not None:
        return replace(observer, weights=numbers)
    several = isinstance(observer.bandwidth, tuple)
    return replace(observer, bandwidth=numbers if several else numbers[0])

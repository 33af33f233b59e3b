"""Floats as rationals of FLINT and back."""

from __future__ import annotations

import math

from flint import fmpq


def exact(value: float) -> fmpq:
    """The rational that a float is."""
    return fmpq(*float(value).as_integer_ratio())


def nearest(value: fmpq) -> float:
    """The float nearest to a rational."""
    return int(value.p) / int(value.q)


def rational_above(value: fmpq) -> float:
    """The smallest float that is not below a rational."""
    near = nearest(value)
    return near if exact(near) >= value else math.nextafter(near, math.inf)

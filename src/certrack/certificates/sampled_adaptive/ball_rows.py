"""Lists of balls as rows and matrices; hulls and common parts of balls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import flint
import numpy as np

from certrack.certificates.bootstrap.ranges import ZERO_BALL
from certrack.certificates.exact import float_down, float_up


def ball_between(low: Any, high: Any) -> Any:
    """A ball that holds the interval of two rationals."""
    return flint.arb(float_down(low)).union(flint.arb(float_up(high)))


def symmetric_ball(size: Any) -> Any:
    """The ball around zero of a ball's largest magnitude."""
    return flint.arb(0, 1) * size.abs_upper()


def common_ball(first: Any, second: Any) -> Any:
    """Where two enclosures of the same value overlap; the finite one if one is not."""
    if not first.is_finite() or not second.is_finite():
        return second if second.is_finite() else first
    low = max(first.lower(), second.lower())
    high = min(first.upper(), second.upper())
    return low.union(high) if low <= high else second


def ball_hull(balls: Sequence[Any]) -> Any:
    """A ball that holds all."""
    total = balls[0]
    for ball in balls[1:]:
        total = total.union(ball)
    return total


def largest_ball(balls: Sequence[Any]) -> Any:
    """A bound of all magnitudes; not finite if one is not."""
    if not all(ball.is_finite() for ball in balls):
        return flint.arb("inf")
    return max(ball.abs_upper() for ball in balls)


def ball_list(values: Any) -> list[Any]:
    """The balls of numbers."""
    return [flint.arb(v) for v in values]


def ball_table(rows: np.ndarray) -> list[list[Any]]:
    """The balls of a matrix, row by row."""
    return [ball_list(row) for row in rows]


def ball_sum(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """The inner product."""
    return sum((left * right for left, right in zip(a, b, strict=True)), ZERO_BALL)


def row_product(row: Sequence[Any], rows: Sequence[Sequence[Any]]) -> list[Any]:
    """A row times a matrix."""
    return [ball_sum(row, column) for column in zip(*rows, strict=True)]

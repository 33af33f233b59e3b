"""Moves of one polynomial each: of degree 2q + 1, with q derivatives that are zero at both ends.

Degree 5 is the move of minimum jerk: of all moves from rest to rest in a given time, with zero
acceleration at both ends, it has the smallest integral of the squared jerk.

With an `effort` the move is the polynomial of least energy: of those with the same derivatives at
both ends, and up to :data:`ADDED_TERMS` powers more, the one with the smallest integral of u^2,
u = a_1 y' + a_2 y'' + ...; its coefficients are solved for in rational arithmetic.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from flint import fmpq, fmpq_mat, fmpq_poly

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.references.exact import exact
from certrack.references.extremes import largest_derivative
from certrack.references.piecewise import PiecewiseReference
from certrack.references.profiles.moves import Move, assembled, checked_limits, on_grid
from certrack.references.profiles.shortest import MOTION_LIMITS

#: Degrees of a move: up to four derivatives are continuous.
MOVE_DEGREES = (3, 5, 7, 9)

#: Terms that a move of least energy has beside its degree's: with eight, the energy of the shipped
#: dual motor is within 0.01 % of the least of all moves.
ADDED_TERMS = 8


def polynomial(
    positions: tuple[float, ...],
    degree: int = 5,
    duration: float | tuple[float, ...] | None = None,
    dwell: float | tuple[float, ...] = 0.0,
    start: float = 0.0,
    repeat: bool = False,
    speed: float | None = None,
    acceleration: float | None = None,
    jerk: float | None = None,
    snap: float | None = None,
    effort: tuple[float, ...] | None = None,
    bound: float | None = None,
) -> PiecewiseReference:
    """Moves of one polynomial each, in stated times or the shortest within limits.

    Parameters
    ----------
    positions : m + 1 numbers
        Where it begins, then where each move ends, unit of the output.
    degree : {3, 5, 7, 9}
        Of the polynomials; 2q + 1 keeps q derivatives continuous, so that the order is q + 1.
    duration : float or m numbers, s, optional
        Of the moves; without it, at least one limit decides.
    effort : (degree + 1)/2 numbers, optional
        a_1, a_2, ... of the input u = a_1 y' + a_2 y'' + ... that a motion needs. Then a move is
        the one of least energy in its stated time, with ADDED_TERMS powers more than its degree's.
    dwell, start, repeat, speed, acceleration, jerk, snap, bound
        As for :func:`~certrack.references.profiles.moves.moves`.

    Returns
    -------
    PiecewiseReference

    Examples
    --------
    >>> from certrack.references.profiles.polynomial import polynomial
    >>> round(polynomial((0, 1), degree=5, duration=2).bounds(1).values[1], 9)
    0.9375
    """
    degree = int(_degree(degree))
    limits = checked_limits((speed, acceleration, jerk, snap))
    more: dict[str, Any] = {"degree": degree}
    stated: tuple[float, ...] = ()
    if duration is not None:
        if limits:
            name = next(iter(limits))
            raise InputError(f"reference.{name}", "must be left out beside duration")
        positions = checks.reals("reference.positions", positions, None, "begin, then each target")
        stated = _durations(duration, len(positions) - 1)
        more["duration"] = duration
    elif not limits:
        message = "needs a duration, or limits: " + ", ".join(MOTION_LIMITS)
        raise InputError("reference", message, remedy="State e.g. duration = 1.0")
    elif all(MOTION_LIMITS.index(name) >= degree for name in limits):
        message = f"needs a limit that binds: a polynomial of degree {degree} has no snap"
        raise InputError("reference", message, remedy="State speed, acceleration or jerk")

    if effort is not None:
        if duration is None:
            raise InputError("reference.effort", "needs a duration", remedy="State one, s")
        effort = _effort(effort, degree)
        more["effort"] = effort

    def move(distance: float, i: int) -> Move:
        if stated:
            return Move(
                stated[i], lambda slack, grid: (_piece(distance, on_grid(stated[i], grid)),)
            )
        time = shortest_time(degree, distance, limits)
        return Move(
            time, lambda slack, grid: (_piece(distance, on_grid(time * (1 + slack), grid)),)
        )

    def _piece(distance: float, width: fmpq) -> tuple[fmpq, tuple[fmpq, ...]]:
        unit = smooth_step(degree) if effort is None else least_energy_step(degree, effort, width)
        scaled = (unit[k] / width**k for k in range(unit.degree() + 1))
        return width, tuple(exact(distance) * a for a in scaled)

    order = (degree + 1) // 2
    return assembled(
        "polynomial", positions, dwell, start, repeat, move, limits, order, more, bound
    )


def shortest_time(degree: int, distance: float, limits: dict[str, float]) -> float:
    """Of a polynomial move under the limits, s."""
    unit = smooth_step(degree)
    orders = {MOTION_LIMITS.index(name) + 1: limit for name, limit in limits.items()}
    return max(
        (distance * largest_derivative(unit, k, fmpq(1)) / limit) ** (1 / k)
        for k, limit in orders.items()
    )


@lru_cache
def smooth_step(degree: int) -> fmpq_poly:
    """From 0 at 0 to 1 at 1, with (degree - 1)/2 derivatives that are zero at both."""
    q = (degree - 1) // 2
    bump = fmpq_poly([0, 1]) ** q * fmpq_poly([1, -1]) ** q
    step = bump.integral()
    return step / step(fmpq(1))


@lru_cache
def least_energy_step(degree: int, effort: tuple[float, ...], width: fmpq) -> fmpq_poly:
    """The step with the least integral of u^2 over a time, as a polynomial over [0, 1].

    Parameters
    ----------
    degree : int
        2q + 1, with q derivatives that are zero at both ends.
    effort : numbers
        a_1, a_2, ... of u.
    width : fmpq, s
        The time.
    """
    step, q = smooth_step(degree), (degree - 1) // 2
    bump = (fmpq_poly([0, 1]) * fmpq_poly([1, -1])) ** (q + 1)
    added = [bump * fmpq_poly([0, 1]) ** k for k in range(ADDED_TERMS)]

    def input_of(p: fmpq_poly) -> fmpq_poly:
        u = fmpq_poly([0])
        for i, a in enumerate(effort, 1):
            p = p.derivative()
            u += exact(a) / width**i * p
        return u

    def product(p: fmpq_poly, r: fmpq_poly) -> fmpq:
        return (p * r).integral()(fmpq(1))

    inputs, first = [input_of(p) for p in added], input_of(step)
    gram = fmpq_mat([[product(p, r) for r in inputs] for p in inputs])
    right = fmpq_mat([[-product(p, first)] for p in inputs])
    weights = gram.solve(right)
    for k, p in enumerate(added):
        step = step + weights[k, 0] * p
    return step


def _effort(effort: Any, degree: int) -> tuple[float, ...]:
    numbers = checks.reals("reference.effort", effort, None, "a_1, a_2, ...")
    count = (degree + 1) // 2  # beyond what u needs, rest at the ends costs coefficients of 1e5
    if len(numbers) != count or not numbers[-1]:
        message = f"must be {count} numbers, the last not zero, for the degree {degree}"
        remedy = "Set the degree to 2 m - 1, where a_m is the last number"
        raise InputError("reference.effort", message, checks.as_written(effort), remedy)
    return numbers


def _degree(degree: Any) -> Any:
    if degree not in MOVE_DEGREES or isinstance(degree, bool):
        wanted = "must be " + " or ".join(map(str, MOVE_DEGREES))
        raise InputError("reference.degree", wanted, checks.as_written(degree))
    return degree


def _durations(duration: Any, count: int) -> tuple[float, ...]:
    key = "reference.duration"
    if isinstance(duration, str) or not hasattr(duration, "__len__"):
        return (checks.real(key, duration, above=0),) * count
    return checks.reals(key, duration, count, "one per move", above=0)

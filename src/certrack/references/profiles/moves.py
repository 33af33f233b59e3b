"""Lists of moves from rest to rest, with dwells between them, as piecewise polynomials.

Durations are computed in floats and rounded to times that floats hold exactly; from there on the
arithmetic is rational. So a list of any length does not drift, ends where it is told to, and no
limit is exceeded by a rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from flint import fmpq, fmpq_poly

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.references.exact import exact, nearest
from certrack.references.extremes import largest_derivative
from certrack.references.piecewise import SAME_TIME, PiecewiseReference
from certrack.references.polynomials import DEGREE
from certrack.references.profiles.phases import Phase, Profile, following, travelled
from certrack.references.profiles.shortest import MOTION_LIMITS, shortest

#: More moves than this are refused: each has up to fifteen pieces.
MAX_MOVES = 10_000

#: Durations are longer by this part at first, and by more until no limit is exceeded.
FIRST_SLACK, MORE, MOST_SLACK = 1e-12, 8.0, 1e-3

#: Phases shorter than so many of the times that count as the same are left out.
SHORT = 8.0

#: A piece: how long, in exact s, and the factors of the powers of the time since its begin.
ExactPiece = tuple[fmpq, tuple[fmpq, ...]]


class Move(NamedTuple):
    """One move: about how long it takes, s, and what makes its exact pieces.

    They are made for a slack of the durations, relative to them, and a grid of times.
    """

    duration: float
    pieces: Callable[[float, fmpq], tuple[ExactPiece, ...]]


def moves(
    positions: tuple[float, ...],
    dwell: float | tuple[float, ...] = 0.0,
    start: float = 0.0,
    repeat: bool = False,
    speed: float | None = None,
    acceleration: float | None = None,
    jerk: float | None = None,
    snap: float | None = None,
    bound: float | None = None,
) -> PiecewiseReference:
    """Moves from position to position, each in the shortest time that the limits allow.

    The highest limit that is stated makes the order: with `acceleration` the speed is a trapezoid,
    with `jerk` it is an S-curve; lower limits may be left out.

    Parameters
    ----------
    positions : m + 1 numbers
        Where it begins, then where each move ends, unit of the output.
    dwell : float or m numbers, s
        Rest after each move.
    start : float, s
        When the first move begins.
    repeat : bool
        Whether it starts again after the last dwell; it must then end where it began.
    speed, acceleration, jerk, snap : float, optional
        Limits of |y_d'|, |y_d''|, ..., at least one.
    bound : float, optional
        D of Assumption 2.

    Returns
    -------
    PiecewiseReference

    Examples
    --------
    >>> from certrack.references.profiles.moves import moves
    >>> moves((0, 1), speed=0.5, acceleration=2).breaks(0, 10)
    array([0.25, 2.  , 2.25])
    """
    values = (speed, acceleration, jerk, snap)
    return shortest_moves("moves", positions, dwell, start, repeat, values, bound)


def velocity(
    positions: tuple[float, ...],
    speed: float,
    acceleration: float,
    dwell: float | tuple[float, ...] = 0.0,
    start: float = 0.0,
    repeat: bool = False,
    bound: float | None = None,
) -> PiecewiseReference:
    """Moves whose speed is a trapezoid: the shortest under limits of speed and acceleration.

    Parameters
    ----------
    positions, speed, acceleration, dwell, start, repeat, bound
        As for :func:`moves`.

    Returns
    -------
    PiecewiseReference
    """
    values = (speed, acceleration)
    return shortest_moves("velocity", positions, dwell, start, repeat, values, bound)


def scurve(
    positions: tuple[float, ...],
    speed: float,
    acceleration: float,
    jerk: float,
    dwell: float | tuple[float, ...] = 0.0,
    start: float = 0.0,
    repeat: bool = False,
    bound: float | None = None,
) -> PiecewiseReference:
    """S-curves: the shortest moves under limits of speed, acceleration and jerk.

    Parameters
    ----------
    positions, speed, acceleration, jerk, dwell, start, repeat, bound
        As for :func:`moves`.

    Returns
    -------
    PiecewiseReference
    """
    values = (speed, acceleration, jerk)
    return shortest_moves("scurve", positions, dwell, start, repeat, values, bound)


def shortest_moves(
    kind: str,
    positions: Any,
    dwell: Any,
    start: Any,
    repeat: Any,
    values: Sequence[Any],
    bound: float | None,
) -> PiecewiseReference:
    """A move list of one kind under the limits that are stated."""
    stated = checked_limits(values)
    if not stated:
        message = "needs a limit: " + ", ".join(MOTION_LIMITS[:-1]) + f" or {MOTION_LIMITS[-1]}"
        raise InputError("reference", message, remedy="State e.g. speed and acceleration")
    order = 1 + max(MOTION_LIMITS.index(name) for name in stated)
    limits = tuple(stated.get(name, math.inf) for name in MOTION_LIMITS[:order])

    def move(distance: float, i: int) -> Move:
        profile = shortest(distance, limits)
        return Move(profile.duration, lambda slack, grid: _exact(profile, distance, slack, grid))

    return assembled(kind, positions, dwell, start, repeat, move, stated, order, {}, bound)


def checked_limits(values: Sequence[Any]) -> dict[str, float]:
    """The limits that are stated, by name."""
    pairs = zip(MOTION_LIMITS, values, strict=False)
    return {
        name: checks.real(f"reference.{name}", value, above=0)
        for name, value in pairs
        if value is not None
    }


@contextmanager
def _in_floats() -> Iterator[None]:
    """Refuse distances and limits of which times or speeds are beyond floats."""
    try:
        yield
    except InputError:
        raise
    except (ArithmeticError, ValueError, RuntimeError):
        what = "must not have distances and limits so far apart that times or speeds overflow"
        raise InputError("reference", what) from None


@_in_floats()
def assembled(
    kind: str,
    positions: Any,
    dwell: Any,
    start: Any,
    repeat: Any,
    move: Callable[[float, int], Move],
    limits: dict[str, float],
    order: int,
    more: dict[str, Any],
    bound: float | None,
) -> PiecewiseReference:
    """Moves and dwells one after the other.

    Parameters
    ----------
    kind, positions, dwell, start, repeat, bound
        As a user gave them.
    move : callable
        Of the distance and the place in the list.
    limits : dict
        That no derivative may exceed.
    order : int
        Of the reference.
    more : dict
        Further keys of the file.
    """
    positions = checks.reals("reference.positions", positions, None, "begin, then each target")
    if not 2 <= len(positions) <= MAX_MOVES + 1:
        wanted = f"must be 2 to {MAX_MOVES + 1} positions"
        raise InputError("reference.positions", wanted, len(positions))
    rests = _dwells(dwell, len(positions) - 1)
    start = checks.real("reference.start", start, least=0)
    if not isinstance(repeat, bool):
        raise InputError("reference.repeat", "must be true or false", repeat)
    if repeat and positions[0] != positions[-1]:
        what = f"must end at the first position, {positions[0]:g}, where it repeats"
        raise InputError(f"reference.positions[{len(positions) - 1}]", what, positions[-1])
    planned = []
    for i, (a, b) in enumerate(zip(positions, positions[1:], strict=False)):
        if a == b:
            key = f"reference.positions[{i + 1}]"
            raise InputError(key, "must differ from the position before", b, "Rest by a dwell")
        planned.append(move(abs(b - a), i))
    total = start + sum(each.duration for each in planned) + sum(rests)
    if not math.isfinite(total):
        raise InputError("reference", "must not have limits so small that a move never ends")
    grid = _grid(total)
    knots, rows = [on_grid(start, grid)], []
    for i, each in enumerate(planned):
        begin, sense = (
            exact(positions[i]),
            math.copysign(1, positions[i + 1] - positions[i]),
        )
        pieces = _within(each.pieces, limits, grid, i)
        for width, factors in pieces:
            row = [int(sense) * factor for factor in factors]
            row[0] += begin
            rows.append(tuple(map(nearest, row)))
            knots.append(knots[-1] + width)
        if rests[i]:
            rows.append((positions[i + 1], *[0.0] * (len(rows[-1]) - 1)))
            knots.append(knots[-1] + on_grid(rests[i], grid))
    times = tuple(map(nearest, knots))
    written = {
        "positions": positions,
        **more,
        **limits,
        "dwell": dwell,
        "start": start,
        "repeat": repeat,
    }
    defaults = {"dwell": 0.0, "start": 0.0, "repeat": False}
    fields = [(k, tuple(v) if isinstance(v, list) else v) for k, v in written.items()]
    stated = tuple((k, v) for k, v in fields if k not in defaults or v != defaults[k])
    period = times[-1] - times[0] if repeat else None
    return PiecewiseReference(times, tuple(rows), order, period, (("kind", kind), *stated), bound)


def _dwells(dwell: Any, count: int) -> tuple[float, ...]:
    key = "reference.dwell"
    if isinstance(dwell, str) or not hasattr(dwell, "__len__"):
        return (checks.real(key, dwell, least=0),) * count
    return checks.reals(key, dwell, count, "one per move", least=0)


def _grid(total: float) -> fmpq:
    """The finest times of which all multiples up to twice the total are floats."""
    _, exponent = math.frexp(2 * max(total, SAME_TIME))
    power = exponent - 53
    return fmpq(2**power) if power >= 0 else fmpq(1, 2**-power)


def on_grid(time: float, grid: fmpq) -> fmpq:
    """The time, rounded up to the grid."""
    return ((exact(time) / grid).ceil()) * grid


def _within(
    make: Callable[[float, fmpq], tuple[ExactPiece, ...]],
    limits: dict[str, float],
    grid: fmpq,
    i: int,
) -> tuple[ExactPiece, ...]:
    """The pieces of a move with just so much slack that they keep the limits exactly."""
    slack = FIRST_SLACK
    while slack < MOST_SLACK:
        pieces = make(slack, grid)
        if pieces and _keeps(pieces, limits):
            return pieces
        slack *= MORE
    what = "is too short to be told apart from rest at its time"
    remedy = "Move earlier, or leave out the highest limit"
    raise InputError(f"reference.positions[{i + 1}]", what, remedy=remedy)


def _keeps(pieces: Sequence[ExactPiece], limits: dict[str, float]) -> bool:
    """Whether no derivative exceeds its limit, with room for the rounding of the factors."""
    for width, factors in pieces:
        p = fmpq_poly(list(factors))
        for name, limit in limits.items():
            if largest_derivative(p, MOTION_LIMITS.index(name) + 1, width) >= limit:
                return False
    return True


def _exact(profile: Profile, distance: float, slack: float, grid: fmpq) -> tuple[ExactPiece, ...]:
    """Pieces that travel the distance exactly, from rest to rest exactly; none if it is too short.

    Rounded durations change where phases end, so their values are scaled: those of the fall for an
    acceleration that ends at zero, then all of them for the distance.
    """
    shortest_kept = SHORT * SAME_TIME * max(1.0, nearest(grid) * 2.0**52)

    def rounded(phases: Sequence[Phase]) -> tuple[Phase, ...]:
        return tuple(
            Phase(on_grid(p.duration * (1 + slack), grid), exact(p.value))
            for p in phases
            if p.duration > shortest_kept
        )

    rise, fall = rounded(profile.rise), rounded(profile.fall)
    if not rise or (profile.fall and not fall):
        return ()
    if fall:
        balance = -travelled(rise, 2) / travelled(fall, 2)
        fall = tuple(Phase(p.duration, balance * p.value) for p in fall)
    (cruise,) = rounded([Phase(profile.cruise, 0.0)]) or (Phase(fmpq(0), fmpq(0)),)
    phases = Profile(rise, cruise.duration, profile.order, fall).phases()
    scale = exact(distance) / travelled(phases, profile.order)
    state: tuple[Any, ...] = (fmpq(0),) * profile.order
    padding = (fmpq(0),) * (DEGREE - profile.order)
    pieces: list[ExactPiece] = []
    for phase in phases:
        every = (*state, phase.value)
        factors = (scale * value / math.factorial(k) for k, value in enumerate(every))
        pieces.append((phase.duration, (*factors, *padding)))
        state = following(state, phase)
    return tuple(pieces)

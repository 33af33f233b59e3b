"""Piecewise polynomials by their coefficients, as a planner writes them."""

from __future__ import annotations

from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.references.piecewise import MAX_PIECE_DEGREE, PiecewiseReference
from certrack.references.polynomials import DEGREE


def pieces(
    times: tuple[float, ...],
    coefficients: tuple[tuple[float, ...], ...],
    repeat: bool = False,
    bound: float | None = None,
) -> PiecewiseReference:
    """A piecewise polynomial, held before the first and after the last time, or repeated.

    Its order is found: the first derivative that jumps.

    Parameters
    ----------
    times : m + 1 increasing times, s
    coefficients : m rows of numbers
        a_0, a_1, ... of a_0 + a_1 s + a_2 s^2 + ..., s being the time since the begin of the piece.
    repeat : bool
        Whether it starts again at the last time.
    bound : float, optional
        D of Assumption 2.

    Returns
    -------
    PiecewiseReference

    Raises
    ------
    InputError
        If it jumps itself.

    Examples
    --------
    >>> from certrack.references.profiles.pieces import pieces
    >>> pieces((0, 1, 2), ((0, 0, 1), (1, 2, -1))).order
    2.0
    """
    times = checks.reals("reference.times", times, None, "times between the pieces, s")
    table = checks.sequence("reference.coefficients", coefficients, len(times) - 1, "one per piece")
    rows = [
        checks.reals(f"reference.coefficients[{i}]", row, None, "a_0, a_1, ...")
        for i, row in enumerate(table)
    ]
    for i, row in enumerate(rows):
        if not 1 <= len(row) <= MAX_PIECE_DEGREE + 1:
            wanted = f"must be 1 to {MAX_PIECE_DEGREE + 1} numbers"
            raise InputError(f"reference.coefficients[{i}]", wanted, len(row))
    if not isinstance(repeat, bool):
        raise InputError("reference.repeat", "must be true or false", repeat)
    degree = max([DEGREE, *(len(row) - 1 for row in rows)])
    padded = tuple((*row, *[0.0] * (degree + 1 - len(row))) for row in rows)
    written: dict[str, Any] = {"times": times, "coefficients": tuple(rows)}
    written |= {"repeat": True} if repeat else {}
    fields = (("kind", "pieces"), *written.items())
    period = times[-1] - times[0] if repeat and len(times) > 1 else None
    reference = PiecewiseReference(times, padded, 1, period, fields, bound)
    while reference.smoothness < degree:
        try:
            reference = PiecewiseReference(
                times, padded, reference.smoothness + 1, period, fields, bound
            )
        except InputError:
            break
    return reference

"""Checks of a plant's coefficients: constants of the right sign, true values in their ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, parse

#: What to do where a coefficient of the rows 1 ... n-1 depends on states.
ROW_REMEDY = (
    "Rows 1 ... n-1 must be x_i' = g_i x_{i+1} + sum b_ij x_j + tau_i w_i with constant g_i and "
    "b_ij: take x_i' itself as the next state, or put the difference from a constant into w_i"
)

#: What to do where a row has entries beyond the diagonal.
BEYOND_REMEDY = (
    "The factor of x_{i+1} stands in plant.chain. A state beyond it does not fit the chain: take "
    "one that stays small in its place, such as the twist of a shaft and its rate, and bound its "
    "term by plant.uncertainty.Delta (see the tutorial, 'A motor and a load')"
)

#: The same as ROW_REMEDY, for g_n.
GAIN_REMEDY = (
    "The last row must be x_n' = h(x) + g_n u + phi(x)^T theta + tau_n w_n, affine in u with a "
    "constant g_n: take the whole term with the input as a new input v, with input_gain = 1 or "
    "another constant, and let the drive compute its command from v and the measured states"
)


def refuse_states(key: str, value: Any, states: Sequence[str], remedy: str) -> None:
    """Refuse a coefficient that depends on states, and say what the class of plants is."""
    if not isinstance(value, (str, Expression)):
        return
    names = {str(s) for s in parse(key, value, None).expr.free_symbols}
    for name in states:
        if name in names:
            text = value if isinstance(value, str) else value.text
            raise InputError(
                key, f"unknown name {name!r}: a state, where a constant is needed", text, remedy
            )


def coupling_row(key: str, row: Any, length: int) -> list[Any]:
    """The entries b_i1 ... b_ii of a row of couplings; more of them say what the plant has not."""
    what = "b_i1 ... b_ii"
    if isinstance(row, (list, tuple)) and len(row) > length:
        raise InputError(
            key, f"must be a list of {length}: {what}", checks.as_written(row), BEYOND_REMEDY
        )
    return checks.sequence(key, row, length, what)


def refuse_varying_gain(key: str, value: Any, states: Sequence[str]) -> None:
    """Refuse an input gain that depends on states, and say which change of the input helps."""
    refuse_states(key, value, states, GAIN_REMEDY)


def check_gain(
    key: str, value: Any, gain_sign: int, constants: Mapping[str, Any] | None = None
) -> float:
    """A nonzero input gain of the stated sign."""
    gain = checks.real(key, value, constants, nonzero=True)
    if gain * gain_sign < 0:
        raise InputError(key, f"must have the sign of plant.gain_sign = {gain_sign}", gain)
    return gain


def check_within(key: str, value: float, box: tuple[float, float] | None, name: str) -> None:
    """Refuse a true value outside the range that the designer states."""
    if box is not None and not box[0] <= value <= box[1]:
        raise InputError(key, f"must lie in plant.ranges.{name} = [{box[0]:g}, {box[1]:g}]", value)

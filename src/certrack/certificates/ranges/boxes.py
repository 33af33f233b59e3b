"""Other boxes than the file's ranges: scaled about the nominal constants, or with one closed.

The law is made with the nominal constants whatever the ranges are, so the loop as a function of the
constants stays the same, and a proof for another box needs no other derivation.
"""

from __future__ import annotations

from typing import Any

from certrack.certificates.ranges.cells import Cell
from certrack.certificates.ranges.formulas import RANGED_GAIN
from certrack.certificates.ranges.loop import RangedLoop
from certrack.core.errors import InputError
from certrack.core.expressions import number
from certrack.model.ranges import ConstantRange, check_sign_at_ends


def names(loop: RangedLoop) -> tuple[str, ...]:
    """What has a range, as [plant.ranges] calls it."""
    constants = loop.symbols[: len(loop.symbols) - loop.moving]
    return tuple(str(s).removeprefix("ranges.") for s in constants)


def closed(loop: RangedLoop, k: int) -> Cell:
    """The box with range k closed: that constant has its nominal value."""
    return with_range(loop, k, loop.nominal[k], loop.nominal[k])


def with_range(loop: RangedLoop, k: int, low: Any, high: Any) -> Cell:
    """The box with another range k."""
    return (*loop.box[:k], (low, high), *loop.box[k + 1 :])


def scaled(loop: RangedLoop, scale: Any) -> Cell:
    """All distances of the ends from the nominal values times a scale (a rational).

    A nominal value outside of its range is an end of it here: so the box of a smaller scale lies
    inside that of a larger one.
    """
    ends = tuple(
        (min(low, value), max(high, value))
        for value, (low, high) in zip(loop.nominal, loop.box, strict=True)
    )
    return moved(loop, ends, scale)


def moved(loop: RangedLoop, cell: Cell, scale: Any) -> Cell:
    """A cell with all distances from the nominal values times a scale (a rational).

    Cells that fill a box so fill the box of the scale. What varies in time has its whole interval.
    """
    ends = tuple(
        (value + scale * (low - value), value + scale * (high - value))
        for value, (low, high) in zip(loop.nominal, cell, strict=True)
    )
    count = len(ends) - loop.moving
    return (*ends[:count], *loop.box[count:])


def forbidden(loop: RangedLoop, box: Cell) -> str:
    """Why no plant of the design's form may have these ranges; empty if one may.

    A coefficient of the chain, or the input gain, would vanish or change its sign.
    """
    plant = loop.system.plant
    rows: list[ConstantRange] = []
    for symbol, (low, high) in zip(loop.symbols, box, strict=True):
        if str(symbol) == RANGED_GAIN and not low * high > 0:
            return "plant.ranges.input_gain would reach zero"
        if str(symbol) in plant.constant_boxes:
            ends = (number("plant.ranges", str(end)) for end in (low, high))
            rows.append((str(symbol), *ends))  # type: ignore[arg-type]
    formulas = {f"plant.chain[{i}]": g for i, g in enumerate(plant.chain)}
    formulas |= {} if plant.input_gain is None else {"plant.input_gain": plant.input_gain}
    for key, formula in formulas.items():
        try:
            check_sign_at_ends(key, formula, rows, plant.open_values)
        except InputError:
            return f"{key} = {formula.text} would vanish, change its sign or have no value"
    return ""

"""Units in which a file may have samples of the output, and their sizes."""

from __future__ import annotations

import math
import re

from certrack.core.errors import InputError

#: What a unit measures, and its size as a numerator and a denominator.
VALUE_UNITS: dict[str, tuple[str, float, float]] = {
    "m": ("length", 1, 1),
    "cm": ("length", 1, 100),
    "mm": ("length", 1, 1e3),
    "um": ("length", 1, 1e6),
    "nm": ("length", 1, 1e9),
    "in": ("length", 0.0254, 1),
    "rad": ("angle", 1, 1),
    "mrad": ("angle", 1, 1e3),
    "urad": ("angle", 1, 1e6),
    "deg": ("angle", math.pi, 180),
    "rev": ("angle", 2 * math.pi, 1),
    "arcmin": ("angle", math.pi, 180 * 60),
    "arcsec": ("angle", math.pi, 180 * 3600),
}

#: Other ways to write them.
_ALIASES = {"\u00b5m": "um", "\u03bcm": "um", "\u00b0": "deg", "degrees": "deg", "inch": "in"}

VALUE_UNIT = "reference.value_unit"


def converted(values: list[float], unit: str, output: str) -> list[float]:
    """Values in the unit of the output.

    Parameters
    ----------
    values : numbers
        In the unit of the file.
    unit, output : str
        That of the file, and that of the output in ``plant.units``.

    Raises
    ------
    InputError
        If one of them is unknown, or they measure different things.
    """
    if unit == output:
        return values
    if not output:
        message = "needs the unit of the output"
        raise InputError(VALUE_UNIT, message, unit, "State plant.units, or convert the file")
    for key, name in ((VALUE_UNIT, unit), ("plant.units[0]", output)):
        if name not in VALUE_UNITS:
            raise InputError(key, "must be one of " + ", ".join(VALUE_UNITS), name)
    (kind, up, down), (wanted, over, under) = VALUE_UNITS[unit], VALUE_UNITS[output]
    if kind != wanted:
        raise InputError(VALUE_UNIT, f"must measure the output, which is in {output}", unit)
    return [value * (up * under) / (down * over) for value in values]


def check_value_unit(name: str, header: str, output: str) -> None:
    """Refuse values whose header names another unit than the output has, where none is stated."""
    second = header.split(";")[1] if header.count(";") == 1 else re.split(r"[,\t]", header)[-1]
    match = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", second)
    unit = _ALIASES.get(match[1], match[1]) if match else ""
    if not output or unit == output or unit not in VALUE_UNITS:
        return
    what = f"the header of {name} says that values are in {unit}, the output is in {output}"
    remedy = f'State value_unit = "{unit}" beside file, or "{output}" if the header is wrong'
    raise InputError("reference.file", what, second.strip(), remedy)

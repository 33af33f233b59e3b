"""What the file says of each kind of reference, beside the function that makes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from certrack.core.keys import Key
from certrack.references import shapes
from certrack.references.base import Reference

_BOUND = Key(
    "number",
    help="D with |y_d| + |y_d'| <= D",
    above=0,
    otherwise="computed",
)
_AMPLITUDE = Key("number", help="half the swing", nonzero=True, required=True)
_PERIOD = Key("number", help="after it the reference repeats", unit="s", above=0, required=True)
_OFFSET = Key("number", help="mean value", default=0.0)
_START = Key("number", help="a time at which a rise begins", unit="s", default=0.0)

#: A reference given by a formula has no kind; these are its keys.
FORMULA_KEYS: dict[str, Key] = {
    "signal": Key("formula", help="y_d, a formula of t", required=True),
    "bound": _BOUND,
    "bounds": Key(
        "numbers",
        help="bounds of |y_d|, |y_d'|, ... where they cannot be proven; the last may be of a slope",
        shape="Y_0, Y_1, ..., Y_{q+2}",
        least=0,
        otherwise="proven",
    ),
}


@dataclass(frozen=True)
class ReferenceKind:
    """A kind of reference: what makes it, and the keys that are its arguments."""

    make: Callable[..., Reference]
    keys: Mapping[str, Key]


REFERENCE_KINDS: dict[str, ReferenceKind] = {
    "triangle": ReferenceKind(
        shapes.triangle,
        {
            "amplitude": _AMPLITUDE,
            "period": _PERIOD,
            "offset": _OFFSET,
            "start": _START,
            "bound": _BOUND,
        },
    ),
    "trapezoid": ReferenceKind(
        shapes.trapezoid,
        {
            "amplitude": _AMPLITUDE,
            "period": _PERIOD,
            "rise": Key(
                "number", help="time of a rise, at most period/2", unit="s", above=0, required=True
            ),
            "offset": _OFFSET,
            "start": _START,
            "bound": _BOUND,
        },
    ),
    "steps": ReferenceKind(
        shapes.steps,
        {
            "times": Key(
                "numbers",
                help="when each move begins",
                unit="s",
                required=True,
            ),
            "levels": Key(
                "numbers",
                help="level before the first move, then after each",
                shape="one more than times",
                required=True,
            ),
            "slope": Key("number", help="speed of a move", above=0, required=True),
            "bound": _BOUND,
        },
    ),
    "profile": ReferenceKind(
        shapes.profile,
        {
            "times": Key("numbers", help="times between the pieces", unit="s", required=True),
            "start": Key(
                "numbers",
                help="at the first time; their number is the order",
                shape="y_d, y_d', ...",
                required=True,
            ),
            "highest": Key(
                "numbers",
                help="the next derivative, which is constant on each piece",
                shape="one less than times",
                required=True,
            ),
            "bound": _BOUND,
        },
    ),
    "samples": ReferenceKind(
        shapes.samples,
        {
            "times": Key(
                "numbers",
                help="sample times, increasing",
                unit="s",
                required=True,
                otherwise="or file",
            ),
            "values": Key(
                "numbers",
                help="y_d at these times",
                shape="one per time",
                required=True,
                otherwise="or file",
            ),
            "interpolation": Key(
                "choice",
                help="never beyond the samples, or smoother",
                choices=("monotone", "cubic"),
                default="monotone",
            ),
            "bound": _BOUND,
            "time_unit": Key(
                "choice",
                help="unit of times, or of those in file",
                choices=tuple(shapes.TIME_UNITS),
                default="s",
            ),
            "file": Key(
                "text",
                help="instead of times and values: CSV file beside the system file, time and y_d",
                otherwise="none",
            ),
        },
    ),
}

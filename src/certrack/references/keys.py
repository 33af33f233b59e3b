"""What the file says of each kind of reference, beside the function that makes it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from certrack.core.keys import Key
from certrack.references import shapes
from certrack.references.base import Reference
from certrack.references.profiles import moves, polynomial, waves
from certrack.references.profiles.pieces import pieces
from certrack.references.samples import INTERPOLATIONS, SPLINE_DEGREES, TIME_UNITS, samples
from certrack.references.soft_start import MIN_TRANSIENT

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
_REPEAT = Key("flag", help="whether it starts again at its end", default=False)
_SPEED = Key("number", help="limit of the speed |y_d'|", above=0, required=True)
_ACCELERATION = Key("number", help="limit of |y_d''|", above=0, required=True)
_JERK = Key("number", help="limit of |y_d^(3)|", above=0, required=True)
_SNAP = Key("number", help="limit of |y_d^(4)|", above=0, required=True)
_DEGREE = Key("choice", help="degree of the polynomials", choices=SPLINE_DEGREES, default=5)

#: Keys of every list of moves from rest to rest.
_MOVES = {
    "positions": Key(
        "numbers",
        help="where it begins, then where each move ends",
        shape="one more than moves",
        required=True,
    ),
    "dwell": Key("number or numbers", help="rest after each move", unit="s", least=0, default=0.0),
    "start": Key("number", help="when the first move begins", unit="s", least=0, default=0.0),
    "repeat": _REPEAT,
}

#: Limits of which some may be left out.
_LIMITS = {
    name: replace(key, required=False, otherwise="no limit")
    for name, key in (
        ("speed", _SPEED),
        ("acceleration", _ACCELERATION),
        ("jerk", _JERK),
        ("snap", _SNAP),
    )
}

#: Of every reference.
TRANSIENT = Key(
    "number",
    help="soft start: in this time the reference is joined from the state at the start",
    unit="s",
    least=MIN_TRANSIENT,
    otherwise="none",
)

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
    "transient": TRANSIENT,
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
    "moves": ReferenceKind(moves.moves, {**_MOVES, **_LIMITS, "bound": _BOUND}),
    "velocity": ReferenceKind(
        moves.velocity,
        {**_MOVES, "speed": _SPEED, "acceleration": _ACCELERATION, "bound": _BOUND},
    ),
    "scurve": ReferenceKind(
        moves.scurve,
        {
            **_MOVES,
            "speed": _SPEED,
            "acceleration": _ACCELERATION,
            "jerk": _JERK,
            "bound": _BOUND,
        },
    ),
    "polynomial": ReferenceKind(
        polynomial.polynomial,
        {
            **_MOVES,
            "degree": _DEGREE,
            "duration": Key(
                "number or numbers",
                help="of each move",
                unit="s",
                above=0,
                otherwise="the shortest within the limits",
            ),
            **_LIMITS,
            "effort": Key(
                "numbers",
                help="of the input a_1 y' + a_2 y'' + ... whose energy is the least",
                shape="a_1, a_2, ...",
                otherwise="the polynomial of its degree",
            ),
            "bound": _BOUND,
        },
    ),
    "chirp": ReferenceKind(
        waves.chirp,
        {
            "amplitude": replace(_AMPLITUDE, help="of the sine"),
            "frequencies": Key(
                "numbers",
                help="at the begin and at the end of the sweep",
                shape="[begin, end]",
                unit="rad/s",
                above=0,
                required=True,
            ),
            "duration": Key("number", help="of the sweep", unit="s", above=0, required=True),
            "offset": _OFFSET,
            "smoothness": Key(
                "integer",
                help="continuous derivatives of the frequency, two less than the order",
                least=0,
                most=3,
                default=0,
            ),
            "bound": _BOUND,
        },
    ),
    "multisine": ReferenceKind(
        waves.multisine,
        {
            "amplitudes": Key("numbers", help="of the sines", required=True),
            "frequencies": Key(
                "numbers",
                help="of the sines",
                shape="one per sine",
                unit="rad/s",
                above=0,
                required=True,
            ),
            "phases": Key(
                "numbers",
                help="of the sines",
                shape="one per sine",
                unit="rad",
                otherwise="Schroeder's, which keep the peaks low",
            ),
            "offset": _OFFSET,
            "bound": _BOUND,
        },
    ),
    "pieces": ReferenceKind(
        pieces,
        {
            "times": Key("numbers", help="times between the pieces", unit="s", required=True),
            "coefficients": Key(
                "rows",
                help="a_0, a_1, ... in powers of the time since the begin of the piece",
                shape="one row per piece",
                required=True,
            ),
            "repeat": _REPEAT,
            "bound": _BOUND,
        },
    ),
    "samples": ReferenceKind(
        samples,
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
                choices=INTERPOLATIONS,
                default="monotone",
            ),
            "degree": replace(
                _DEGREE, help="degree of a spline", default=None, otherwise="5 for splines"
            ),
            "repeat": _REPEAT,
            "bound": _BOUND,
            "time_unit": Key(
                "choice",
                help="unit of times, or of those in file",
                choices=tuple(TIME_UNITS),
                default="s",
            ),
            "file": Key(
                "text",
                help="instead of times and values: CSV file beside the system file, time and y_d",
                otherwise="none",
            ),
            "columns": Key(
                "texts",
                help="which columns of file: names in its header, or numbers from 1",
                shape="time, y_d",
                otherwise="the only two",
            ),
            "value_unit": Key(
                "text",
                help="unit of the values in file, e.g. mm where plant.units has m",
                otherwise="that of the output",
            ),
        },
    ),
}

"""References y_d(t): what they are, how smooth, how large, and where they break.

A reference of order m has derivatives 0 ... m that exist piecewise and are bounded, with 0 ... m-1
continuous. A law with feed-forward order q needs order q + 1; the paper's law needs one derivative
only, so a triangle will do.

Whoever writes a reference finds all names here: :class:`Reference`, :class:`Bounds`, :func:`key`,
:func:`check_fields`, :func:`symbol`, ``TIME``, :func:`round_up`, and :func:`register`.
"""

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, symbol
from certrack.core.keys import Key, check_fields
from certrack.core.keys import keyed as key
from certrack.references.base import (
    Bounds,
    Reference,
    jumps,
    lipschitz_bound,
    pieces_at,
    require_order,
    round_up,
)
from certrack.references.piecewise import PiecewiseReference
from certrack.references.profiles.moves import moves, scurve, velocity
from certrack.references.profiles.pieces import pieces
from certrack.references.profiles.polynomial import polynomial
from certrack.references.profiles.waves import chirp, multisine
from certrack.references.registry import check_reference, known_references
from certrack.references.registry import register_reference as register
from certrack.references.samples import samples
from certrack.references.shapes import profile, steps, trapezoid, triangle
from certrack.references.soft_start import SoftStart
from certrack.references.symbolic import SymbolicReference

__all__ = [
    "TIME",
    "Bounds",
    "InputError",
    "Key",
    "PiecewiseReference",
    "Reference",
    "SoftStart",
    "SymbolicReference",
    "check_fields",
    "check_reference",
    "chirp",
    "jumps",
    "key",
    "known_references",
    "lipschitz_bound",
    "moves",
    "multisine",
    "pieces",
    "pieces_at",
    "polynomial",
    "profile",
    "register",
    "require_order",
    "round_up",
    "samples",
    "scurve",
    "steps",
    "symbol",
    "trapezoid",
    "triangle",
    "velocity",
]

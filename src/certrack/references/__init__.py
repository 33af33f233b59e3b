"""References y_d(t): what they are, how smooth, how large, and where they break.

A reference of order m has derivatives 0 ... m that exist piecewise and are bounded, with 0 ... m-1
continuous. A law with feed-forward order q needs order q + 1 (section "feed-forward" of the
theory page); the paper's law needs one derivative only, so a triangle will do.
"""

from certrack.references.base import Bounds, Reference, pieces_at, require_order
from certrack.references.piecewise import PiecewiseReference, samples, steps, trapezoid, triangle
from certrack.references.symbolic import SymbolicReference

__all__ = [
    "Bounds",
    "PiecewiseReference",
    "Reference",
    "SymbolicReference",
    "pieces_at",
    "require_order",
    "samples",
    "steps",
    "trapezoid",
    "triangle",
]

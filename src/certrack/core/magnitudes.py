"""How large a formula may be on a box of its symbols, on many boxes at once, rounded up."""

from __future__ import annotations

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.enclosures import Known, enclose


def largest_magnitudes(formula: sympy.Expr, box: Known, count: int) -> Array:
    """Upper bounds of |formula| on many boxes.

    Parameters
    ----------
    formula : sympy.Expr
        Without t.
    box : mapping
        Bounds of every symbol: two arrays (count,).
    count : int
        Boxes.

    Returns
    -------
    (count,) array
        Infinite where nothing is known.
    """
    never = np.zeros(count)
    enclosed = enclose(formula, never, never, box, 1)
    return np.maximum(np.abs(enclosed.low[0]), np.abs(enclosed.high[0]))

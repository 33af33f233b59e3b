"""What each constant costs: the bound with its range closed, all others as they are."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from certrack.certificates.certificate import within_floats
from certrack.certificates.exact import float_down, float_up
from certrack.certificates.ranges.boxes import closed, names
from certrack.certificates.ranges.cells import Cell
from certrack.certificates.ranges.proofs import RangeProver
from certrack.certificates.ranges.search import RangeBounds


@dataclass(frozen=True)
class ConstantCost:
    """What the range of one constant adds to the bound.

    Attributes
    ----------
    name : str
        As in [plant.ranges].
    low, nominal, high : float
        Its range, and the value that the law knows.
    known : float
        Bound on limsup |e_1| if it had this value exactly, all else as in the file; rounded up;
        inf if there is none.
    bound : float
        The bound of the file, for all ranges; inf if there is none.
    verified : bool
        Whether `known` is proven for this file, as the bound itself is.
    """

    name: str
    low: float
    nominal: float
    high: float
    known: float
    bound: float
    verified: bool = True

    @property
    def cost(self) -> float:
        """How much of the bound would go if the constant were known; NaN without a bound."""
        return self.bound - self.known if math.isfinite(self.bound) else math.nan

    def record(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "name": self.name,
            "range": [self.low, self.high],
            "nominal": self.nominal,
            "bound_if_known": self.known,
            "cost": self.cost,
            "verified": self.verified,
        }


def costs(
    prover: RangeProver, search: Callable[[Cell], RangeBounds], bounds: RangeBounds
) -> tuple[ConstantCost, ...]:
    """The bound with each range closed in turn.

    Parameters
    ----------
    prover : RangeProver
    search : callable
        From a box to what is proven for it.
    bounds : RangeBounds
        Of the file's own box. A proof for it is one for every box inside, so none is above it.
    """
    loop, total = prover.loop, bounds.certified
    result = []
    for k, name in enumerate(names(loop)):
        (low, high), nominal = loop.box[k], loop.nominal[k]
        with within_floats():
            least = search(closed(loop, k)).certified
        known = min(least, total) if low <= nominal <= high else least
        ends = float_down(low), float(nominal), float_up(high)
        result.append(ConstantCost(name, *ends, known, total, math.isfinite(known)))
    return tuple(result)

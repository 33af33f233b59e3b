"""How far each constant may drift: the largest ranges whose certified error is still admitted.

One by one, the range of a constant is made symmetric about the value that the law knows, and grown
or shrunk while all others stay as in the file; then all ranges of the file are scaled together.
Every range that is returned was proven as it stands: the bound for it is not above the error.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.exact import float_down, float_up, from_text
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.ranges.boxes import forbidden, names, scaled, with_range
from certrack.certificates.ranges.cells import Cell, corners_of
from certrack.certificates.ranges.certify import NO_RANGES, range_prover, smaller_bounds
from certrack.certificates.ranges.edges import Edge, largest_scale
from certrack.certificates.ranges.proofs import RangeProver
from certrack.certificates.ranges.search import RangeBounds, bound_ranges
from certrack.certificates.scope import has_ranges
from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.progress import Progress, silent
from certrack.systems.system import System, require_system

#: Where nobody says which error is admitted: so many times the certified bound of the file.
ADMITTED_FACTOR = 1.5

#: Relative accuracy of a range: each further digit costs three more bounds.
DRIFT_ACCURACY = 0.02


@dataclass(frozen=True)
class ConstantDrift:
    """The largest symmetric range of one constant, all others as in the file.

    Attributes
    ----------
    name : str
        As in [plant.ranges].
    nominal : float
        The value that the law knows.
    file : (low, high)
        The range in the file.
    low, high : float or None
        Ends of the largest range with a proof, rounded inward; None where there is none even if
        the constant is known exactly.
    part : float or None
        Its half width over the size of the nominal value, rounded down; None where that is 0.
    bound : float
        Certified for it: limsup |e_1| is at most this.
    reason : str
        Why a little more is too much.
    unlimited : bool
        Whether the search ended without an edge.
    """

    name: str
    nominal: float
    file: tuple[float, float]
    low: float | None
    high: float | None
    part: float | None
    bound: float
    reason: str
    unlimited: bool


@dataclass(frozen=True)
class CommonDrift:
    """The largest common scale of all ranges of the file.

    Attributes
    ----------
    scale : float
        Of the distances of their ends from the nominal values, rounded down; 0 where there is none.
    ranges : name, low, high
        The ranges at that scale, rounded inward.
    bound : float
        Certified for them.
    reason : str
        Why a little more is too much.
    unlimited : bool
        Whether the search ended without an edge.
    """

    scale: float
    ranges: tuple[tuple[str, float, float], ...]
    bound: float
    reason: str
    unlimited: bool


@dataclass(frozen=True)
class Drift:
    """How far the constants may drift.

    Attributes
    ----------
    error : float
        The admitted error: limsup |e_1| of the continuous loop; NaN where nobody states one.
    origin : str
        Where it comes from.
    constants : tuple of ConstantDrift
        One by one.
    together : CommonDrift or None
    verified : bool
        Whether every range is proven for this file; not where its own truth breaks a premise.
    reason : str
        Why nothing was searched; empty if it was.
    """

    error: float
    origin: str
    constants: tuple[ConstantDrift, ...] = ()
    together: CommonDrift | None = None
    verified: bool = False
    reason: str = ""

    def __repr__(self) -> str:
        if self.reason:
            return f"Drift(none: {self.reason})"
        ranges = ", ".join(
            f"{c.name} none" if c.low is None else f"{c.name} [{c.low:.4g}, {c.high:.4g}]"
            for c in self.constants
        )
        return f"Drift(error {self.error:.5g}: {ranges})"

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        together = self.together
        return {
            "error": self.error,
            "origin": self.origin,
            "verified": self.verified,
            "reason": self.reason,
            "constants": [vars(entry) for entry in self.constants],
            "together": None
            if together is None
            else vars(together)
            | {"ranges": {name: [low, high] for name, low, high in together.ranges}},
        }


@one_blas_thread
def drift(system: System, *, error: float | None = None, progress: Progress = silent) -> Drift:
    """Search how far each constant with a range may drift, one by one and together.

    Parameters
    ----------
    system : System
        With ranges of constants, or of what its law takes for known.
    error : float, optional
        Admitted limsup |e_1|; by default the population's limit, else 1.5 times the certified
        bound.
    progress : callable
        Gets how many ranges were tried, None and None.

    Returns
    -------
    Drift
        Of the continuous loop, whatever its implementation.

    Raises
    ------
    InputError
        If the error is no positive number.
    """
    require_system(system)
    if error is not None:
        error = checks.real("error", error, above=0)
    if not has_ranges(system):
        return Drift(math.nan, "", reason=NO_RANGES)
    try:
        with within_floats():
            cells = not system.plant.uncertainty.constants_vary
            options = {"cells": cells, "progress": lambda *_: progress(0, None, None)}
            prover, bounds = smaller_bounds(range_prover(system), options)
            admitted, origin = _admitted_drift(system, error, bounds)
    except NoCertificate as refusal:
        return Drift(math.nan, "", reason=str(refusal))
    search = _Boxes(prover, admitted, progress)
    constants = tuple(_one(search, k) for k in range(len(names(prover.loop))))
    together = _together(search) if len(constants) > 1 else None
    return Drift(admitted, origin, constants, together, not contradicted(premises(system)))


def _admitted_drift(system: System, error: float | None, bounds: RangeBounds) -> tuple[float, str]:
    """The admitted error, and where it comes from."""
    if error is not None:
        return error, "given"
    limit = system.varied.limit
    if limit is not None:
        return limit, "file"
    if not bounds.best:
        raise NoCertificate(
            "the file's own ranges have no certificate, whose bound could be admitted; state the "
            "admitted error"
        )
    return ADMITTED_FACTOR * bounds.certified, f"{ADMITTED_FACTOR:g} times the certified bound"


class _Boxes:
    """Bounds for one box after the other."""

    def __init__(self, prover: RangeProver, error: float, progress: Progress) -> None:
        self.prover, self.error = prover, error
        self._progress, self._tried = progress, itertools.count()
        self._cells = not prover.loop.system.plant.uncertainty.constants_vary

    def bound(self, box: Cell, enough: float) -> float:
        """The bound for a box, rounded up; inf if there is none."""
        done = next(self._tried)
        bounds = bound_ranges(
            self.prover,
            cells=self._cells,
            box=box,
            enough=enough,
            progress=lambda *_: self._progress(done, None, None),
        )
        self._progress(done + 1, None, None)
        return bounds.certified

    def edge(self, box_at: Callable[[Any], Cell]) -> Edge[float]:
        """The largest scale of a box whose bound is admitted, and the bound."""

        def find(scale: Any) -> float | str:
            box = box_at(scale)
            reason = forbidden(self.prover.loop, box)
            if reason:
                return reason
            try:
                with within_floats():
                    too_much = self._exceeded_at_a_corner(box)
                    bound = math.inf if too_much else self.bound(box, self.error)
            except NoCertificate as refusal:
                return str(refusal)
            return bound if bound <= self.error else "no bound within the admitted error was found"

        return largest_scale(find, accuracy=DRIFT_ACCURACY)

    def _exceeded_at_a_corner(self, box: Cell) -> bool:
        """Whether a corner alone has no bound that is admitted: then no cell around it has."""
        for corner in corners_of(box):
            point = tuple((value, value) for value in corner)
            bounds = bound_ranges(self.prover, cells=False, box=point, enough=self.error)
            if bounds.bound > self.error:
                return True
        return False


def _one(search: _Boxes, k: int) -> ConstantDrift:
    """The largest symmetric range of one constant."""
    loop = search.prover.loop
    (low, high), nominal = loop.box[k], loop.nominal[k]
    half = max(high - nominal, nominal - low)

    def box_at(scale: Any) -> Cell:
        return with_range(loop, k, nominal - scale * half, nominal + scale * half)

    edge = search.edge(box_at)
    file = float_down(low), float_up(high)
    name, value = names(loop)[k], float(nominal)
    if edge.result is None:
        return ConstantDrift(name, value, file, None, None, None, math.inf, edge.reason, False)
    width = from_text(edge.scale) * half
    return ConstantDrift(
        name,
        value,
        file,
        float_up(nominal - width),
        float_down(nominal + width),
        float_down(width / abs(nominal)) if nominal else None,
        edge.result,
        edge.reason,
        edge.unlimited,
    )


def _together(search: _Boxes) -> CommonDrift:
    """The largest common scale of all ranges."""
    loop = search.prover.loop
    edge = search.edge(lambda scale: scaled(loop, scale))
    if edge.result is None:
        return CommonDrift(0.0, (), math.inf, edge.reason, False)
    scale = from_text(edge.scale)
    ranges = tuple(
        (name, float_up(low), float_down(high))
        for name, (low, high) in zip(names(loop), scaled(loop, scale), strict=False)
    )
    return CommonDrift(float_down(scale), ranges, edge.result, edge.reason, edge.unlimited)

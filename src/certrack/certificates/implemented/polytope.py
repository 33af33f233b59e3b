"""The starts from which the input's limits never act: a polytope inside a box.

With the bounds X(k) of all starts of a box, the input u_k of one start x(0) in it is at most

    |g_k x(0) + h_k| + rest_k,    rest_k = c + noise of the first sample + sum_l D_l wbar(X(k - l))

where g_k and h_k come from the row of u, k periods back. Where that is within the limits for all
k < L, and the bound of the box for all later k is too, the loop of this start is the linear one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import flint
import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_down
from certrack.certificates.implemented.drive import DRIVE_BITS
from certrack.certificates.implemented.enclosed import Enclosed, widened
from certrack.certificates.implemented.start import (
    StartingLoop,
    bounds_from_start,
    products_above,
    starting_loop,
    zeta_at_start,
)
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.systems.system import System


@dataclass(frozen=True)
class CertifiedStarts:
    """Starts in a box with |slopes x + offsets| <= room: from them the limits never act.

    Attributes
    ----------
    box : n pairs (low, high)
    slopes : (L, n) array
    offsets, room : (L,) arrays
        The room is rounded down, by all that the products may lose inside the box, too.
    """

    box: tuple[tuple[float, float], ...]
    slopes: np.ndarray
    offsets: np.ndarray
    room: np.ndarray

    def contains(self, starts: np.ndarray) -> np.ndarray:
        """Whether starts are among them.

        Parameters
        ----------
        starts : (n,) or (members, n) array

        Returns
        -------
        bool, or (members,) array of bool
        """
        x = np.asarray(starts, dtype=float)
        low, high = np.array(self.box).T
        inside = ((x >= low) & (x <= high)).all(axis=-1)
        reached = np.abs(x @ self.slopes.T + self.offsets) <= self.room
        return np.asarray(inside & reached.all(axis=-1))

    def largest_part(self) -> float:
        """The largest factor f <= 1 for which the box shrunk by f about its centre is inside."""
        low, high = np.array(self.box).T
        centre, half = (low + high) / 2, (high - low) / 2
        at_centre = np.abs(self.slopes @ centre + self.offsets)
        left = self.room - at_centre
        if not (left > 0).all():
            return 0.0
        spread = np.abs(self.slopes) @ half
        with np.errstate(divide="ignore"):
            return float(min(1.0, (left / spread).min() * (1 - 1e-12)))


def certified_starts(
    system: System, box: Sequence[tuple[float, float]], loop: StartingLoop | None = None
) -> CertifiedStarts:
    """The starts in a box from which the saturation never acts, for references as the file's.

    Parameters
    ----------
    system : System
        With an implementation that has a saturation.
    box : n pairs (low, high)
    loop : StartingLoop, optional
        Of the system, where it has been made before.

    Returns
    -------
    CertifiedStarts

    Raises
    ------
    InputError
        If the file has no saturation, or the box another shape.
    NoCertificate
        If the box is so large that nothing holds for its starts in the long run.

    Examples
    --------
    >>> import certrack
    >>> from certrack.certificates.implemented.polytope import certified_starts
    >>> drive = certrack.Implementation(period=0.01, saturation=(-15, 15))
    >>> lean = certrack.load("dual-motor-lean").replace(implementation=drive)
    >>> starts = certified_starts(lean, [(-1, 1)] * 4)
    >>> bool(starts.contains(lean.settings.x0)), bool(starts.contains([1, 1, 1, 1]))
    (True, False)
    """
    implementation = system.implementation
    if implementation is None or implementation.saturation is None:
        raise InputError(
            "implementation.saturation", "is missing", remedy="Without it no start is lost"
        )
    pairs = checks.sequence("box", box, system.plant.n, "one pair (low, high) per state")
    loop = starting_loop(system) if loop is None else loop
    with flint.ctx.workprec(DRIVE_BITS):
        limit = _largest_input(loop, implementation.saturation)
        bounds = bounds_from_start(system, pairs, loop=loop)
        if not bounds.last[-2] <= limit:
            raise NoCertificate("the box is too large: its starts may meet the limits at any time")
        return _polytope(system, loop, pairs, bounds.values[:, -2], limit)


def _largest_input(loop: StartingLoop, saturation: tuple[float, float]) -> float:
    """What |u| must not exceed, without the constant of the law."""
    low, high = map(rational, saturation)
    return float_down(min(high - loop.drive.offset, loop.drive.offset - low))


def _polytope(
    system: System,
    loop: StartingLoop,
    box: Sequence[tuple[float, float]],
    largest: np.ndarray,
    limit: float,
) -> CertifiedStarts:
    n = loop.drive.n
    (row,) = np.flatnonzero(loop.bounds.outputs == n + 1)
    past = Enclosed(loop.lags.past.value[row], loop.lags.past.error[row])
    spread = zeta_at_start(system, loop, box, any_reference=False)
    of_columns = products_above(past, spread)  # the middle, n half widths, what is left
    transient = widened(of_columns.sum(axis=1), of_columns.shape[1])
    # all of the bound of the box but what its starts themselves add
    others = widened(largest - transient * (1 - 1e-9)) + of_columns[:, n + 1 :].sum(axis=1)
    others = np.maximum(others, 0)
    Z = Enclosed.of(loop.Z)
    slopes = past.value @ Z.value
    centre = Enclosed(spread.value[:, :1], spread.error[:, :1])
    middle = (past.value @ centre.value)[:, 0] - slopes @ np.array(box, dtype=float).mean(axis=1)
    reach = np.abs(np.array(box, dtype=float)).max(axis=1)
    exact = products_above(past, Z) @ reach + products_above(past, centre)[:, 0]
    lost = (past.error @ Z.upper) @ reach + (past.error @ centre.upper)[:, 0] + 1e-12 * exact
    return CertifiedStarts(
        tuple((float(low), float(high)) for low, high in box),
        slopes,
        middle,
        (limit - widened(others + lost, 64)) * (1 - 1e-12),
    )

"""Linear law: any linear feedback of the plant's states, for known parameters."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from certrack.core import checks
from certrack.core.errors import DesignError, InputError
from certrack.core.keys import check_fields, keyed, set_fields
from certrack.laws.backstepping import Gains
from certrack.laws.lqr import LqrWeights, as_computed, lqr_feedback
from certrack.laws.online import at_other_end
from certrack.laws.plant_coordinates import (
    PlantCoordinates,
    balancing_feedforward,
    plant_coordinates,
)
from certrack.laws.robust import Robust
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Linear(Robust):
    """Linear feedback of xi = x - Pi Y in the coordinates of the plant.

        u  = (nu - phi^T theta)/g_n
        nu = K xi + Pi_n (y_d' ... y_d^(q)) + r y_d^(q+1) - h(x)

    There is no recursion: xi' = [F; K] xi + ..., and the poles are those of [F; K], which every
    lean backstepping law is a special case of (:mod:`certrack.laws.plant_coordinates`).

    Parameters
    ----------
    K : n numbers
        The feedback; nu *adds* K xi, so a stabilising K is negative in the main.
    r : float, optional
        Coefficient of y_d^(q+1) in nu; the one for which a constant y_d^(q+1) moves x_1 by nothing
        if left out.
    lqr : table of `error` and `input`, optional
        In the place of K: weights of :class:`certrack.laws.lqr.LqrWeights`.
    """

    kind = "linear"
    moving = ("K", "r")

    c: tuple[float, ...] = field(default=(), init=False, repr=False)
    k: tuple[tuple[float, ...], ...] | None = field(default=None, init=False, repr=False)
    p: tuple[float, ...] | None = field(default=None, init=False, repr=False)
    coupling: float | None = field(default=None, init=False, repr=False)
    integral: float | None = field(default=None, init=False, repr=False)
    sampled_feedforward: bool = field(default=False, init=False, repr=False)

    K: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="feedback in the coordinates of the plant: nu has K (x - Pi Y)",
        shape="K_1 ... K_n",
        otherwise="from lqr",
    )
    r: float | None = keyed(
        "number",
        None,
        help="feed-forward gain: coefficient of y_d^(q+1) in nu",
        otherwise="no static error by y_d^(q+1)",
    )
    lqr: LqrWeights | None = keyed(
        "weights",
        None,
        help="K from weights: error of x_1 - y_d (a list: of each state), input of u",
        otherwise="K is given",
    )

    def __post_init__(self) -> None:
        check_fields(self, "law", "feedforward", "K", "r")
        self._check_tables()
        if self.lqr is not None:
            set_fields(self, lqr=LqrWeights.of(self.lqr))
        if (self.K is None) == (self.lqr is None):
            what = "is missing" if self.K is None else "must be left out beside law.lqr"
            raise InputError("law.K", what, remedy="Give K_1 ... K_n, or lqr = {error = 1}")

    def gains(self) -> Gains:
        raise DesignError("law", "a linear law has no gains of the recursion")

    def settled(self, plant: Plant) -> Linear:
        """The law with K and r as numbers."""
        q = checks.integer("law.feedforward", self.feedforward, 0, plant.n - 1)
        F = plant.b + np.eye(plant.n - 1, plant.n, 1) * plant.g[:, None]
        if self.lqr is not None:
            g_n = self.known_gain(plant)
            K = tuple(map(as_computed, lqr_feedback(self.lqr, F, g_n).tolist()))
        else:
            K = checks.reals("law.K", self.K, plant.n, "K_1 ... K_n")
        _require_stable(np.vstack([F, K]))
        r = self.r
        if r is None:
            r = as_computed(balancing_feedforward(plant.g, plant.b, np.array(K), q))
        online = self.online
        if online is not None and online.K is not None:
            online = replace(online, r=at_other_end(self, lambda law: law.settled(plant)).r)
        return replace(self, K=K, r=r, lqr=None, online=online)

    def coordinates(self, plant: Plant) -> PlantCoordinates:
        """xi = x - Pi Y."""
        law = self.settled(plant)
        return plant_coordinates(plant.g, plant.b, np.array(law.K), law.r, law.feedforward)


def _require_stable(M: np.ndarray) -> None:
    """Refuse a feedback whose error system does not decay."""
    if not np.isfinite(M).all():
        raise DesignError("law.K", "the design overflows", remedy="Scale the states (chain)")
    slowest = float(np.linalg.eigvals(M).real.max())
    if slowest < 0:
        return
    reversed_sign = np.vstack([M[:-1], -M[-1:]])
    remedy = "nu adds K (x - Pi Y): of one state, K must be negative"
    if np.linalg.eigvals(reversed_sign).real.max() < 0:
        remedy = "Reverse its signs: nu adds K (x - Pi Y), where others write u = -K x"
    raise DesignError(
        "law.K", f"the error system has a pole with real part {slowest:.4g} >= 0", remedy=remedy
    )

"""What the laws to compare with share: no recursion, a feedback K in the coordinates of the plant.

    xi = x - Pi Y,    nu = K xi + Pi_n (y_d' ... y_d^(q)) + r y_d^(q+1) - h(x)

K is that of the law where nothing is estimated yet; its poles are what integrators expect.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import comb
from typing import Any, ClassVar

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import DesignError
from certrack.core.keys import check_fields, keys_of
from certrack.laws.backstepping import Gains
from certrack.laws.lqr import LqrWeights, lqr_feedback
from certrack.laws.plant_coordinates import (
    PlantCoordinates,
    balancing_feedforward,
    output_derivatives,
    plant_coordinates,
)
from certrack.laws.robust import Robust
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant


@dataclass(frozen=True, kw_only=True)
class Baseline(Robust):
    """A law without recursion: its keys are feedforward and gains of its own."""

    moving: ClassVar[tuple[str, ...]] = ()
    #: Gains that a search may choose: positive numbers.
    tuned: ClassVar[tuple[str, ...]] = ()
    #: What makes its poles slower, as a remedy says it.
    slower: ClassVar[str]
    no_certificate = "no inequality V' <= -alpha V + Delta is known for this law"

    c: tuple[float, ...] = field(default=(), init=False, repr=False)
    k: tuple[tuple[float, ...], ...] | None = field(default=None, init=False, repr=False)
    p: tuple[float, ...] | None = field(default=None, init=False, repr=False)
    coupling: float | None = field(default=None, init=False, repr=False)
    integral: float | None = field(default=None, init=False, repr=False)
    sampled_feedforward: bool = field(default=False, init=False, repr=False)

    def __post_init__(self) -> None:
        names = [name for name in keys_of(self) if name not in keys_of(Robust)]
        check_fields(self, "law", "feedforward", *names)
        self._check_tables()

    @abstractmethod
    def feedback(self, plant: Plant) -> np.ndarray:
        """K, (n,)."""

    @abstractmethod
    def gains_at(self, plant: Plant, rate: float) -> Mapping[str, float]:
        """Gains with which the loop is about so fast, 1/s: where a search may begin."""

    def gains(self) -> Gains:
        raise DesignError("law", f"the {self.kind} law has no gains of the recursion")

    def error_system(self, s: Signals) -> None:
        return None

    def coordinates(self, plant: Plant) -> PlantCoordinates:
        """xi = x - Pi Y."""
        q = checks.integer("law.feedforward", self.feedforward, 0, plant.n - 1)
        K = self.feedback(plant)
        r = balancing_feedforward(plant.g, plant.b, K, q)
        return plant_coordinates(plant.g, plant.b, K, r, q)

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        gains = {name: getattr(self, name) for name in self.tuned}
        Pi = self.coordinates(plant).B
        return {**super().parameters(plant), **gains, "Pi": Pi}


def followed_states(s: Signals) -> list[sympy.Expr]:
    """Pi Y, where the states are when the plant follows the reference."""
    n, width = len(s.x), s.q + 1
    Pi = s.parameters("Pi", n, width)
    return [dot(Pi[i * width : (i + 1) * width], s.Y[:width]) for i in range(n)]


def deviations(s: Signals) -> list[sympy.Expr]:
    """xi = x - Pi Y."""
    return [x - y for x, y in zip(s.x, followed_states(s), strict=True)]


def known_input(s: Signals, nu: sympy.Expr) -> sympy.Expr:
    """u of the known parameters: (nu - phi^T theta)/g_n."""
    return (nu - dot(s.phi, s.parameters("theta", s.r))) / s.parameter("g_n")


def highest_gain(plant: Plant, g_n: float) -> float:
    """b_0 of y^(n) = b_0 u + ..., its size."""
    return abs(g_n * float(output_derivatives(plant)[-1, -1]))


def weight_at(plant: Plant, g_n: float, rate: float) -> float:
    """The weight of xi_1 with which :func:`weighted_feedback` is about so fast, 1/s.

    For a chain of integrators the poles are those of a Butterworth filter of this radius.
    """
    return float((rate**plant.n / highest_gain(plant, g_n)) ** 2)


def chain_rows(plant: Plant) -> np.ndarray:
    """F of the nominal chain: x_i' = F_i x for i < n, (n - 1, n)."""
    rows: np.ndarray = plant.b + np.eye(plant.n - 1, plant.n, 1) * plant.g[:, None]
    return rows


def binomial_row(plant: Plant, rate: float, order: int) -> np.ndarray:
    """(D + rate)^order y without its highest derivative, as a row over the states."""
    rows = output_derivatives(plant)
    return np.array([comb(order, i) * rate ** (order - i) for i in range(order)]) @ rows[:order]


def placed_feedback(plant: Plant, rate: float) -> np.ndarray:
    """K with all n poles of [F; K] at -rate."""
    F = chain_rows(plant)
    last = output_derivatives(plant)[-1]
    feedback: np.ndarray = -(last[:-1] @ F + binomial_row(plant, rate, plant.n)) / last[-1]
    return feedback


def sliding_row(plant: Plant, rate: float) -> np.ndarray:
    """Row S of sigma = S xi, with S_n = 1: xi_1 decays as (D + rate)^(n-1) where sigma = 0."""
    last = output_derivatives(plant)[-1]
    row: np.ndarray = (binomial_row(plant, rate, plant.n - 1) + last) / last[-1]
    return row


def equivalent_feedback(plant: Plant, row: np.ndarray) -> np.ndarray:
    """K that holds sigma = S xi where it is."""
    F = chain_rows(plant)
    held: np.ndarray = -(row[:-1] @ F)
    return held


def weighted_feedback(weight: float, plant: Plant, g_n: float) -> np.ndarray:
    """K that minimises int (weight xi_1^2 + u_xi^2) dt."""
    return lqr_feedback(LqrWeights(weight), chain_rows(plant), g_n)

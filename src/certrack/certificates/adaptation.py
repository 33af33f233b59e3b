"""What the update laws of the adaptive law contribute to V and to V'.

With delta_tilde = 1/g_n - delta_hat and theta_tilde = theta - theta_hat [22], V holds

    s |g_n| delta_tilde^2/(2 gbar) + s theta_tilde^T Gamma^{-1} theta_tilde/2              [23]

In V' the update laws [26] cancel the mismatch on the last row of the error system; what they leave
is the leakage towards the prior guesses, whose cost is q(alpha) below, for s = 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import positive_definite, solve
from certrack.certificates.certificate import NoCertificate

#: A full Gamma needs every corner of the box of theta, each with a linear system in rationals:
#: 0.2 s for 12 parameters, and every further one doubles it.
MAX_PARAMETERS_WITH_FULL_GAMMA = 12


@dataclass(frozen=True)
class Adaptation:
    """What the update laws contribute to V'.

    Attributes
    ----------
    gain_rate, leak_gain, leak_theta : number
        gbar, gbar1, gbar2.
    Gamma : (r, r) array
    gains : numbers
        |g_n| at the ends of its range (one number if it is taken as known).
    delta0 : number
    gain_sign : int
    theta0 : (r,) array
    theta_box : r pairs
        Ends of the range of each theta_i (equal if it is taken as known).
    shift : number
        kappa of :mod:`certrack.certificates.centred`; 0 elsewhere.
    """

    gain_rate: Any
    leak_gain: Any
    leak_theta: Any
    Gamma: np.ndarray
    gains: tuple[Any, ...]
    delta0: Any
    gain_sign: int
    theta0: np.ndarray
    theta_box: tuple[tuple[Any, Any], ...]
    shift: Any = 0

    def delta_offsets(self) -> list[tuple[Any, Any]]:
        """Pairs |g_n|, (1 - shift) delta - delta_0."""
        return [(g, (1 - self.shift) * self.gain_sign / g - self.delta0) for g in self.gains]

    @cached_property
    def _is_diagonal(self) -> bool:
        """Whether each coordinate of theta has a rate of its own."""
        return not ((self.Gamma - np.diag(np.diag(self.Gamma))) != 0).any()

    @cached_property
    def _rates(self) -> np.ndarray:
        """The diagonal of Gamma."""
        return np.diagonal(self.Gamma)

    @cached_property
    def _own_offsets(self) -> list[np.ndarray]:
        """Of theta_offsets, those around theta_0."""
        return self.theta_offsets()

    def theta_offsets(self, origin: np.ndarray | None = None) -> list[np.ndarray]:
        """Values (1 + shift) theta - theta_0 at the corners of the box that can be worst.

        Worst for a convex form of theta - origin (theta_0 if left out).

        With diagonal Gamma the form is a sum of one term per coordinate, so each coordinate takes
        its own worst end: one corner. Otherwise all corners are listed.
        """
        centre = self.theta0 if origin is None else origin
        box = [((1 + self.shift) * low, (1 + self.shift) * high) for low, high in self.theta_box]
        if self._is_diagonal:
            worst = [
                max(pair, key=partial(_distance, c)) for pair, c in zip(box, centre, strict=True)
            ]
            return [np.array(worst, dtype=self.theta0.dtype) - self.theta0]
        if len(self.theta_box) > MAX_PARAMETERS_WITH_FULL_GAMMA:
            raise NoCertificate(
                f"a full Gamma with {len(self.theta_box)} parameters has too many corners; use a "
                "diagonal Gamma"
            )
        corners = product(*(dict.fromkeys(pair) for pair in box))
        return [np.array(c, dtype=self.theta0.dtype) - self.theta0 for c in corners]

    def gamma_is_positive_definite(self) -> bool:
        """Whether V is positive definite in theta_tilde; without it nothing follows from V.

        Decided in exact rationals only: floats, which only guess, take it for granted.
        """
        if self.Gamma.dtype != object:
            return True
        return bool((self.Gamma == self.Gamma.T).all()) and positive_definite(self.Gamma)

    def leakage_cost(self, alpha: Any) -> Any:
        """q(alpha): what the prior guesses cost, worst over the ranges.

        None if alpha is too large, or Gamma is not positive definite.
        """
        of_gain = self._cost_of_gain(alpha, self.leak_gain)
        of_theta = self._cost_of_theta(alpha, self.leak_theta)
        return None if of_gain is None or of_theta is None else of_gain + of_theta

    def _cost_of_gain(self, alpha: Any, leak: Any) -> Any:
        """-|g| gbar1 (s1 d^2 - d (delta - delta_0)), maximised over d = delta_tilde.

        s1 = 1 - alpha/(2 gbar gbar1); None if it is not positive.
        """
        s1 = 1 - alpha / (2 * self.gain_rate * leak)
        if not s1 > 0:
            return None
        return max(g * leak * d**2 / (4 * s1) for g, d in self.delta_offsets())

    def _cost_of_theta(self, alpha: Any, leak: Any) -> Any:
        """Its theta counterpart, with W = gbar2 I - alpha/2 Gamma^{-1}."""
        r, dtype = len(self.Gamma), self.Gamma.dtype
        if not r:
            return 0
        if not self.gamma_is_positive_definite():
            return None
        if self._is_diagonal:
            weights = leak - alpha / 2 / self._rates
            if not (weights > 0).all():
                return None
            return leak**2 * max((v**2 / weights).sum() for v in self._own_offsets) / 4
        W = leak * np.eye(r, dtype=dtype) - alpha / 2 * solve(self.Gamma, np.eye(r, dtype=dtype))
        if not positive_definite(W):
            return None
        return leak**2 * max(v @ solve(W, v) for v in self._own_offsets) / 4

    def energy(self, estimates: np.ndarray) -> Any:
        """The estimates' part of V for s = 1, worst over the ranges.

        Parameters
        ----------
        estimates : (1 + r,) array
            delta_hat, theta_hat.
        """
        total = max(
            g * (offset + self.delta0 - estimates[0]) ** 2 / (2 * self.gain_rate)
            for g, offset in self.delta_offsets()
        )
        if len(self.Gamma):
            gaps = [v + self.theta0 - estimates[1:] for v in self.theta_offsets(estimates[1:])]
            total = total + max(gap @ solve(self.Gamma, gap) for gap in gaps) / 2
        return total

    def in_floats(self) -> Adaptation:
        """The same numbers in floating point."""
        return Adaptation(
            gain_rate=float(self.gain_rate),
            leak_gain=float(self.leak_gain),
            leak_theta=float(self.leak_theta),
            Gamma=self.Gamma.astype(float),
            gains=tuple(float(g) for g in self.gains),
            delta0=float(self.delta0),
            gain_sign=self.gain_sign,
            theta0=self.theta0.astype(float),
            theta_box=tuple((float(low), float(high)) for low, high in self.theta_box),
            shift=float(self.shift),
        )


def _distance(origin: Any, end: Any) -> Any:
    return abs(end - origin)

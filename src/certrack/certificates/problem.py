"""The error system as a certificate sees it, in floats or in exact rationals.

    e' = (S - C - K) e + sum_k tau_k A_k w_k - R y_d^(q+1) + (0 ... 0, mismatch)

The uncertain terms are split, w_k = a_k + b_k with |a_k| <= gamma_k ||x||, |b_k| <= beta_k (nothing
is lost), and every input is scaled to its bound: |a_k| <= ||x||, |b_k| <= 1, |y_i| <= 1. For the
adaptive law the mismatch phi^T theta_tilde - g_n delta_tilde ubar is cancelled by the update laws
when V contains the estimates with the same weight s as e_n^2.

The same formulas serve both arithmetics, so what is optimised is what is verified.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import Number, positive_definite, rational, solve, upper
from certrack.certificates.certificate import NoCertificate
from certrack.laws import Adaptive, Robust
from certrack.laws.backstepping import ErrorCoordinates, carry_out
from certrack.systems.system import System


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

    def theta_offsets(self, origin: np.ndarray | None = None) -> list[np.ndarray]:
        """Values (1 + shift) theta - theta_0 at the corners of the box that can be worst.

        Worst for a convex form of theta - origin (theta_0 if left out).

        With diagonal Gamma the form is a sum of one term per coordinate, so each coordinate takes
        its own worst end: one corner. Otherwise all corners are listed.
        """
        centre = self.theta0 if origin is None else origin
        box = [((1 + self.shift) * low, (1 + self.shift) * high) for low, high in self.theta_box]
        off_diagonal = self.Gamma - np.diag(np.diag(self.Gamma))
        if not (off_diagonal != 0).any():
            worst = [
                max(pair, key=partial(_distance, c)) for pair, c in zip(box, centre, strict=True)
            ]
            return [np.array(worst, dtype=self.theta0.dtype) - self.theta0]
        if len(self.theta_box) > MAX_CORNERS:
            raise NoCertificate(
                f"a full Gamma with {len(self.theta_box)} parameters has too many corners; use a "
                "diagonal Gamma"
            )
        corners = product(*(dict.fromkeys(pair) for pair in box))
        return [np.array(c, dtype=self.theta0.dtype) - self.theta0 for c in corners]


@dataclass(frozen=True)
class ErrorProblem:
    """Data of the linear matrix inequality.

    Attributes
    ----------
    M : (n, n) array
        S - C - K.
    Ua, Ub, Uy : arrays with n rows
        Input columns of a, b and the reference derivatives, scaled.
    Xe, Xy : arrays with n rows
        x = Xe e + Xy y.
    states : indices k (from 0) of the a-inputs, then of the b-inputs
    derivatives : orders i of the reference derivatives that matter
    adaptation : Adaptation or None
    """

    M: np.ndarray
    Ua: np.ndarray
    Ub: np.ndarray
    Uy: np.ndarray
    Xe: np.ndarray
    Xy: np.ndarray
    states: tuple[tuple[int, ...], tuple[int, ...]]
    derivatives: tuple[int, ...]
    adaptation: Adaptation | None

    @property
    def n(self) -> int:
        """Order of the plant."""
        return self.M.shape[0]

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of a-, b- and reference inputs."""
        return self.Ua.shape[1], self.Ub.shape[1], self.Uy.shape[1]

    def inequality(
        self, P: np.ndarray, lam: np.ndarray, nu: np.ndarray, k: np.ndarray, alpha: Any
    ) -> np.ndarray:
        """Matrix of the quadratic form that must be <= 0 in z = (e, a, b, y).

        e^T P (M e + U (a, b, y)) + alpha/2 e^T P e
          + sum lam_k (||x||^2 - a_k^2) - sum nu_k b_k^2 - sum k_i y_i^2
        """
        n, (na, nb, ny) = self.n, self.counts
        size = n + na + nb + ny
        Q = np.zeros((size, size), dtype=self.M.dtype)
        a, b, y = slice(n, n + na), slice(n + na, n + na + nb), slice(n + na + nb, size)
        PM = P @ self.M
        Q[:n, :n] = (PM + PM.T + alpha * P) / 2
        Q[:n, a], Q[:n, b], Q[:n, y] = P @ self.Ua / 2, P @ self.Ub / 2, P @ self.Uy / 2
        if na:
            weight = lam.sum()
            Q[:n, :n] += weight * (self.Xe.T @ self.Xe)
            Q[:n, y] += weight * (self.Xe.T @ self.Xy)
            Q[y, y] += weight * (self.Xy.T @ self.Xy)
        Q[a, :n], Q[b, :n], Q[y, :n] = Q[:n, a].T, Q[:n, b].T, Q[:n, y].T
        diagonal = np.arange(n, size)
        Q[diagonal, diagonal] -= np.concatenate([lam, nu, k])
        return Q

    def leakage(self, alpha: Any) -> Any:
        """q(alpha): what the prior guesses cost, worst over the ranges; None if alpha is too large.

        -|g| gbar1 (s1 d^2 - d (delta - delta_0)) and its theta counterpart, maximised over the
        estimation errors; s1 = 1 - alpha/(2 gbar gbar1), and W = gbar2 I - alpha/2 Gamma^{-1}.
        """
        law = self.adaptation
        if law is None:
            return 0
        s1 = 1 - alpha / (2 * law.gain_rate * law.leak_gain)
        if not s1 > 0:
            return None
        cost = max(g * law.leak_gain * d**2 / (4 * s1) for g, d in law.delta_offsets())
        r = len(law.Gamma)
        if r:
            inverse = solve(law.Gamma, np.eye(r, dtype=law.Gamma.dtype))
            W = law.leak_theta * np.eye(r, dtype=law.Gamma.dtype) - alpha / 2 * inverse
            if not positive_definite(W):
                return None
            worst = max(v @ solve(W, v) for v in law.theta_offsets())
            cost = cost + law.leak_theta**2 * worst / 4
        return cost

    def estimate_energy(self, estimates: np.ndarray) -> Any:
        """The estimates' part of V for s = 1, worst over the ranges.

        Parameters
        ----------
        estimates : (1 + r,) array
            delta_hat, theta_hat.
        """
        law = self.adaptation
        if law is None:
            return 0
        total = max(
            g * (offset + law.delta0 - estimates[0]) ** 2 / (2 * law.gain_rate)
            for g, offset in law.delta_offsets()
        )
        if len(law.Gamma):
            gaps = [v + law.theta0 - estimates[1:] for v in law.theta_offsets(estimates[1:])]
            total = total + max(gap @ solve(law.Gamma, gap) for gap in gaps) / 2
        return total

    def homogeneous(self, strength: Any) -> ErrorProblem:
        """Only the a-inputs, with tau scaled: what decides whether any certificate exists."""
        n = self.n
        none = self.Ub[:, :0]
        return replace(
            self,
            Ua=self.Ua * strength,
            Ub=none,
            Uy=none,
            Xy=np.zeros((n, 0), dtype=self.M.dtype),
            states=(self.states[0], ()),
            derivatives=(),
            adaptation=self.adaptation,
        )

    def in_floats(self) -> ErrorProblem:
        """The same problem in floating point, with the same structure."""
        arrays = {
            name: getattr(self, name).astype(float) for name in ("M", "Ua", "Ub", "Uy", "Xe", "Xy")
        }
        law = self.adaptation
        if law is not None:
            law = Adaptation(
                gain_rate=float(law.gain_rate),
                leak_gain=float(law.leak_gain),
                leak_theta=float(law.leak_theta),
                Gamma=law.Gamma.astype(float),
                gains=tuple(float(g) for g in law.gains),
                delta0=float(law.delta0),
                gain_sign=law.gain_sign,
                theta0=law.theta0.astype(float),
                theta_box=tuple((float(low), float(high)) for low, high in law.theta_box),
                shift=float(law.shift),
            )
        return replace(self, **arrays, adaptation=law)


#: A full Gamma needs every corner of the theta box.
MAX_CORNERS = 12


def _distance(origin: Any, end: Any) -> Any:
    return abs(end - origin)


def error_problem(system: System, number: Number) -> ErrorProblem:
    """Collect the data of `system` in the arithmetic of `number` (:func:`rational` or float).

    Raises
    ------
    NoCertificate
        If no certificate of this kind exists for the system, with the reason.
    """
    refuse(system)
    plant = system.plant
    exact = number is rational
    dtype: Any = object if exact else float
    found = coordinates(system, number, dtype)
    n, q, A = plant.n, found.q, found.A
    u = plant.uncertainty
    tau, gamma, beta = ([number(v) for v in values] for values in (u.tau, u.gamma, u.beta))
    bounds = [upper(v, number) for v in system.reference.bounds(q + 1).values]
    Xe = solve(A, np.eye(n, dtype=dtype))
    in_a = tuple(k for k in range(n) if tau[k] * gamma[k] != 0)
    in_b = tuple(k for k in range(n) if tau[k] * beta[k] != 0)
    seen = [i for i in range(q + 1) if in_a and bounds[i] != 0 and any(found.B[:, i] != 0)]
    residual = bounds[q + 1] != 0 and any(found.R != 0)
    Uy = np.zeros((n, len(seen) + residual), dtype=dtype)
    Xy = np.zeros((n, len(seen) + residual), dtype=dtype)
    for column, i in enumerate(seen):
        Xy[:, column] = (Xe @ found.B[:, i]) * bounds[i]
    if residual:
        Uy[:, -1] = -found.R * bounds[q + 1]
    return ErrorProblem(
        M=found.error_matrix,
        Ua=_columns([tau[k] * gamma[k] * A[:, k] for k in in_a], n, dtype),
        Ub=_columns([tau[k] * beta[k] * A[:, k] for k in in_b], n, dtype),
        Uy=Uy,
        Xe=Xe,
        Xy=Xy,
        states=(in_a, in_b),
        derivatives=(*seen, *([q + 1] if residual else [])),
        adaptation=_adaptation(system, number, dtype),
    )


def refuse(system: System) -> None:
    """Say why there is no certificate where there is none."""
    law, plant = system.law, system.plant
    if law.no_certificate:
        raise NoCertificate(law.no_certificate)
    if not isinstance(law, (Adaptive, Robust)):
        raise NoCertificate(f"certificates know the adaptive and the robust law, not {law.kind}")
    if system.truth.states:
        _refuse_unknown_ranges(system)
    elif system.truth.constants:
        raise NoCertificate(
            "truth.constants make the simulated plant differ from the certified one; remove them"
        )
    if isinstance(law, Robust):
        assert plant.input_gain is not None
        fixed = float(plant.input_gain.expr)
        box = plant.input_gain_range or (fixed, fixed)
        known = [float(v.expr) for v in plant.theta or ()]
        thetas = plant.theta_range or tuple((v, v) for v in known)
        exact = all(low == high == v for (low, high), v in zip(thetas, known, strict=True))
        if box != (fixed, fixed) or not exact:
            raise NoCertificate(
                "the robust law is proven for the exact input_gain and theta it uses, but "
                "plant.ranges lets them vary; use the adaptive law"
            )


def _refuse_unknown_ranges(system: System) -> None:
    """A truth with states of its own tells the adaptive law no true g_n and theta."""
    plant = system.plant
    known = plant.input_gain_range and (plant.theta_range or not plant.r)
    if isinstance(system.law, Adaptive) and not known:
        raise NoCertificate(
            "a truth with states of its own has no g_n and theta to be certified for; state "
            "plant.ranges"
        )


def assumptions(system: System) -> list[str]:
    """What a certificate of `system` rests on."""
    plant, truth = system.plant, system.truth
    q = system.law.order(plant)
    bounds = system.reference.bounds(q + 1)
    listed = ", ".join(
        f"|y_d^({i})| <= {value:.6g} ({origin})"
        for i, (value, origin) in enumerate(zip(bounds.values, bounds.origin, strict=True))
    )
    found = [
        "|w_k| <= gamma_k ||x|| + beta_k (Assumption 1) with the file's tau, gamma, beta",
        f"every reference with {listed}",
        "chain, linear, drift and regressor exactly as in the file",
    ]
    if truth.states:
        found.append(
            "the simulated plant, which has states of its own, differing from the design's by no "
            "more than w, that is within gamma and beta; nothing here checks this"
        )
    if isinstance(system.law, Robust):
        found.append("g_n and theta exactly as the law uses them")
        return found + _irrational(system)
    if plant.input_gain_range:
        low, high = plant.input_gain_range
        found.append(f"every g_n in [{low:g}, {high:g}]")
    else:
        found.append(f"the true g_n = {truth.input_gain} (the file gives no range)")
    if plant.r:
        found.append(
            "every theta in its range"
            if plant.theta_range
            else "the true theta of the file (it gives no range)"
        )
    return found + _irrational(system)


def _irrational(system: System) -> list[str]:
    """Numbers that exact arithmetic must take by their floats."""
    plant, truth = system.plant, system.truth
    numbers = [*plant.chain, *(v for row in plant.linear or () for v in row), *truth.theta]
    numbers += [*(plant.theta or ()), *filter(None, [truth.input_gain, plant.input_gain])]
    rounded = sorted({v.text for v in numbers if not v.expr.is_Rational})
    return [f"irrational numbers rounded to 17 digits: {', '.join(rounded)}"] if rounded else []


def coordinates(system: System, number: Number, dtype: Any) -> ErrorCoordinates:
    """The recursion in the arithmetic of `number`."""
    plant, gains = system.plant, system.law.gains()
    assert plant.linear is not None and gains.k is not None and gains.p is not None
    n = plant.n
    g = np.array([number(v) for v in plant.chain], dtype=dtype)
    b = np.zeros((n - 1, n), dtype=dtype)
    for i, row in enumerate(plant.linear):
        b[i, : i + 1] = [number(v) for v in row]
    if dtype is object:
        b = b + flint.fmpq(0)
    c = np.array([number(v) for v in gains.c], dtype=dtype)

    def weight(k: float) -> Any:
        return number(0) if k == float("inf") else 1 / (4 * number(k))

    weights = [
        np.array([weight(row[2 * i]) + weight(row[2 * i + 1]) for i in range(m + 1)], dtype=dtype)
        for m, row in enumerate(gains.k)
    ]
    residual = np.array([weight(p) for p in gains.p], dtype=dtype)
    return carry_out(g, b, c, weights, residual, system.law.order(plant))


def _adaptation(system: System, number: Number, dtype: Any) -> Adaptation | None:
    law, plant, truth = system.law, system.plant, system.truth
    if not isinstance(law, Adaptive):
        return None
    gains = plant.input_gain_range or (truth.input_gain,)
    numbers = law.parameters(plant)
    theta0 = np.array([number(v) for v in numbers["theta0"]], dtype=dtype)
    Gamma = np.array([[number(v) for v in row] for row in numbers["Gamma"]], dtype=dtype)
    box: Any = plant.theta_range or tuple((v, v) for v in truth.theta)
    return Adaptation(
        gain_rate=number(law.gain_rate),
        leak_gain=number(law.leak_gain),
        leak_theta=number(law.leak_theta),
        Gamma=Gamma.reshape(plant.r, plant.r),
        gains=tuple(abs(number(g)) for g in dict.fromkeys(gains)),
        delta0=number(law.delta0),
        gain_sign=plant.gain_sign,
        theta0=theta0,
        theta_box=tuple((number(low), number(high)) for low, high in box),
    )


def _columns(columns: list[np.ndarray], n: int, dtype: Any) -> np.ndarray:
    return np.array(columns, dtype=dtype).reshape(len(columns), n).T

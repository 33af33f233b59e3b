"""The bounds of all outputs at once: v = (|x_1| ... |x_n|, |u|) with v > F(v).

Where constants have ranges, the channels stand behind the states in x and X, as n + 1 ... m.

F is what the gains make of the inputs' bounds where |x| <= X and |u| <= U: monotone, homogeneous
but for a constant >= 0. A v >= 0 with v > F(v) in every entry proves limsup |x| <= X, |u| <= U (a
negative one proves nothing: where F grows faster than v, -v is above F(-v) for every large v):
for every start some f >= 1 has f v above F(f v) plus the transient, so nothing leaves f v; and the
least f with limsup <= f v is not above 1, for F(f v) < f v where f >= 1. |e_1| is then at most its
own entry of F(v).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.gains import PeakGains
from certrack.certificates.implemented.outputs import Row, steady
from certrack.certificates.implemented.period import Period

#: Iterations until the fixed point stands still, and by how much it is widened before it is
#: checked, which leaves room for checkers with another quadrature.
FIXED_POINT_STEPS, STANDS_STILL, FIXED_POINT_MARGIN, SMALLEST_BOUND = 2000, 1e-8, 1e-6, 1e-280

#: A value beyond which there is no fixed point.
LARGEST_BOUND = 1e100


@dataclass(frozen=True)
class OutputBounds:
    """F of the module's text: per row, balls that the inputs' bounds are multiplied with.

    Attributes
    ----------
    outputs : int of each row
        0 for e_1, 1 ... m for the states and channels, m + 1 for u, m + 2 for its steps.
    constant : (rows,) of balls
    w : (rows, columns of W) of balls
        Times the bounds of w.
    x, u : (rows, m) and (rows,) of balls
        Times X and U.
    drive : Drive
    gains : PeakGains
        What the balls were made of.
    sample : rational
        Bound of the input `sample` of the gains.
    rows : of outputs
    """

    outputs: np.ndarray
    constant: np.ndarray
    w: np.ndarray
    x: np.ndarray
    u: np.ndarray
    drive: Drive
    gains: PeakGains
    sample: Any
    rows: tuple[Row, ...] = ()

    @classmethod
    def of(
        cls,
        period: Period,
        rows: Sequence[Row],
        gains: PeakGains,
        reference: np.ndarray | None = None,
    ) -> OutputBounds:
        """From the gains of the rows, and another bound of the reference's part of each of them."""
        drive = period.drive
        Y = np.array(drive.Y, dtype=object)
        mu = np.array(drive.mu, dtype=object)
        sample = drive.Y[-1] if drive.lipschitz is None else drive.T / 2 * drive.lipschitz
        share = np.array([flint.arb(row.share) for row in rows], dtype=object)
        static = np.array([steady(period, row) for row in rows], dtype=object)
        past = static @ Y[:-1] + _as_balls(gains.r) * Y[-1]
        if reference is not None:
            smaller = zip(past, _as_balls(reference), strict=True)
            past = np.array([min(a.upper(), b.upper()) for a, b in smaller], dtype=object)
        r = _as_balls(gains.first)
        r = r + share * np.array([row.in_cell.r for row in rows], dtype=object)
        constant = past + r * Y[-1] + _as_balls(gains.noise) @ mu
        constant = constant + _as_balls(gains.sample) * sample + _as_balls(gains.step) * drive.eta
        if drive.jumps is not None:
            constant = constant + _as_balls(gains.jump) * drive.jumps[0]
        nw = len(drive.uncertain)
        in_cell_w = np.array([row.in_cell.w for row in rows], dtype=object).reshape(len(rows), nw)
        return cls(
            outputs=np.array([row.output for row in rows]),
            constant=constant,
            w=_as_balls(gains.w) + share[:, None] * in_cell_w,
            x=share[:, None] * np.array([row.in_cell.x for row in rows], dtype=object),
            u=share * np.array([row.in_cell.u for row in rows], dtype=object),
            drive=drive,
            gains=gains,
            sample=sample,
            rows=tuple(rows),
        )

    @property
    def is_regional(self) -> bool:
        """Whether a bound of w grows faster than the state: then v > F(v) is not enough."""
        growing = (bound.growing for bound in self.drive.uncertain)
        return any(entry is not None and not entry.is_global for entry in growing)

    def image(self, X: Sequence[Any], U: Any) -> list[Any]:
        """F: upper bounds of e_1, of the states, of u and of its steps.

        Parameters
        ----------
        X : m balls or rationals
        U : ball or rational

        Returns
        -------
        m + 3 exact balls

        Raises
        ------
        NoCertificate
            If one of them is not finite.
        """
        sizes = [uncertain_size(bound, X) for bound in self.drive.uncertain]
        return self.largest(self.values(self.constant, sizes, X, U), range(self.drive.sized + 3))

    def values(self, constant: np.ndarray, sizes: Sequence[Any], X: Sequence[Any], U: Any) -> Any:
        """Bounds of all rows, where |w| <= sizes, |x| <= X, |u| <= U and the rest is `constant`."""
        values = constant + self.x @ np.array(X, dtype=object) + self.u * U
        for j, size in enumerate(sizes):
            values = values + self.w[:, j] * size
        return values

    def largest(self, values: np.ndarray, outputs: Sequence[int]) -> list[Any]:
        """The upper bounds of outputs, as exact balls, from those of their rows.

        Raises
        ------
        NoCertificate
            If a row's is not finite.
        """
        if not all(value.is_finite() for value in values):
            raise NoCertificate("a gain of the sampled loop leaves the range of floating point")
        chosen = (values[self.outputs == k] for k in outputs)
        return [max(flint.arb(v.upper()) for v in entries) for entries in chosen]

    def search(self) -> tuple[list[float], float]:
        """X and U that are probably above F(X, U): the fixed point, widened.

        Raises
        ------
        NoCertificate
            If there seems to be none.
        """
        n, uncertain = self.drive.sized, self.drive.uncertain
        constant, w, x, u = (_floats(v) for v in (self.constant, self.w, self.x, self.u))
        gamma, beta = (_floats([getattr(b, name) for b in uncertain]) for name in ("gamma", "beta"))
        weights = _floats([b.weights for b in uncertain]).reshape(-1, n)
        Delta = _floats([b.Delta for b in uncertain]).reshape(-1, n)
        growing = [(j, b.growing) for j, b in enumerate(uncertain) if b.growing is not None]
        chosen = [self.outputs == k for k in range(1, n + 2)]
        v = np.zeros(n + 1)
        for _ in range(FIXED_POINT_STEPS):
            X = v[:n]
            norm = np.linalg.norm(weights * X, axis=1)
            size = gamma * norm + Delta @ X + beta
            for j, bound in growing:
                size[j] = bound.largest_float(X.tolist(), float(norm[j]))
            values = constant + w @ size + x @ X + u * v[n]
            after = np.array([values[rows].max() for rows in chosen])
            if not after.max() < LARGEST_BOUND:
                break
            still = (after <= v * (1 + STANDS_STILL)).all()
            v = after
            if still:
                v = v * (1 + FIXED_POINT_MARGIN) + SMALLEST_BOUND
                return [float(entry) for entry in v[:n]], float(v[n])
        raise NoCertificate(
            "the uncertain terms are too strong for the sampled loop: what they add by growing "
            "with the state is not less than the state; lower gamma or the period, or raise c"
        )

    def parts(self, X: Sequence[float], U: float) -> dict[str, float]:
        """What the bound of e_1 is made of, in its largest row."""
        drive, gains = self.drive, self.gains
        sizes = [float(uncertain_size(bound, X).mid()) for bound in drive.uncertain]
        still = [0.0] * drive.sized
        beta = [float(uncertain_size(bound, still).mid()) for bound in drive.uncertain]
        w, x, u, constant = (_floats(v) for v in (self.w, self.x, self.u, self.constant))
        values = constant + w @ np.array(sizes) + x @ np.array(X) + u * U
        rows = np.flatnonzero(self.outputs == 0)
        i = rows[int(np.argmax(values[rows]))]
        sensors = gains.noise[i] @ _floats(drive.mu)
        converter = gains.step[i] * float(drive.eta)
        sampling = gains.sample[i] * float(self.sample) + gains.first[i] * float(drive.Y[-1])
        sampling += gains.jump[i] * float(drive.jumps[0]) if drive.jumps else 0.0
        constant_w = float(w[i] @ np.array(beta))
        return {
            "reference": float(constant[i] - sensors - converter - sampling),
            "sampling of the reference": float(sampling),
            "sensors": float(sensors),
            "converter": float(converter),
            "uncertain, constant": constant_w,
            "uncertain, growing": float(w[i] @ np.array(sizes)) - constant_w,
            "between samples": float(x[i] @ np.array(X) + u[i] * U),
        }


def uncertain_size(bound: Any, X: Sequence[Any]) -> Any:
    """Largest |w| where |x| <= X."""
    X = [flint.arb(v) for v in X]
    square = sum(
        ((flint.arb(s) * v) ** 2 for s, v in zip(bound.weights, X, strict=True)), flint.arb(0)
    )
    if bound.growing is not None:
        return bound.growing.largest(X, square.sqrt())
    grown = sum((flint.arb(d) * v for d, v in zip(bound.Delta, X, strict=True)), flint.arb(0))
    return bound.gamma * square.sqrt() + grown + bound.beta


def _as_balls(values: np.ndarray) -> np.ndarray:
    return np.vectorize(flint.arb, otypes=[object])(values)


def _floats(values: Any) -> np.ndarray:
    """Nearest floats of balls or rationals."""
    array = np.array(values, dtype=object)
    flat = [float(v.mid()) if isinstance(v, flint.arb) else float(v) for v in array.ravel()]
    return np.array(flat, dtype=float).reshape(array.shape)

"""What sampling, hold, delay and steps of the estimates add to the loop, on a box.

With u_law(t) = delta_hat ubar of the state at t, and the estimates between two samples as in
:mod:`certrack.certificates.sampled_adaptive`, the implemented loop is the continuous one with

    m = u - u_law                       behind g_n on the last row,
    v_theta, v_delta                    in the rates of the estimates.

On a box the rates of u_law, of phi e_n and of ubar e_n are at most a + b |m|, so that these
differences are at most the time since the sample times that. All is computed in ball arithmetic on
parts of the box of (e, y_d ... y_d^(q)); what is of another time than the rest is bounded over all
of the box.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import solve
from certrack.certificates.bootstrap.box import RegionNumbers
from certrack.certificates.bootstrap.forms import scaled_ubar
from certrack.certificates.bootstrap.loop import AdaptiveLoop, Formulas
from certrack.certificates.bootstrap.ranges import ZERO_BALL
from certrack.certificates.bootstrap.regions import box_of_states
from certrack.certificates.bootstrap.tape import Tape
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.sampled_adaptive.ball_rows import (
    ball_between,
    ball_hull,
    ball_list,
    ball_sum,
    ball_table,
    common_ball,
    largest_ball,
    row_product,
    symmetric_ball,
)
from certrack.certificates.sampled_adaptive.held import HeldLaw
from certrack.certificates.sampled_adaptive.paces import Paces, image, least_law
from certrack.core.kinks import JUMPING, derivative

#: Parts of a box at most: for what is bounded at all times, and for the rate of the law where the
#: estimates move with it.
FEW_CELLS, MANY_CELLS = 64, 1000


@dataclass(frozen=True)
class Near:
    """A row of the errors e, theta_tilde, d that u_law' is near to, and the interval of it.

    Attributes
    ----------
    row : (size,) array of rationals
    interval : pair of rationals
    """

    row: np.ndarray
    interval: tuple[Any, Any]


class LoopRates:
    """The rates of a loop on boxes.

    Parameters
    ----------
    formulas : Formulas
    loop : AdaptiveLoop
        In exact rationals.
    held : HeldLaw

    Raises
    ------
    NoCertificate
        If a formula or its gradient has no rule of ball arithmetic, or jumps.
    """

    def __init__(self, formulas: Formulas, loop: AdaptiveLoop, held: HeldLaw) -> None:
        known = (formulas.drift, *formulas.regressor)
        if any(formula.has(*JUMPING) for formula in known):
            raise NoCertificate("the drift or the regressor may jump, so that u has no rate")
        try:
            self._values = Tape(known, formulas.states)
            self._slopes = [
                Tape([derivative(formula, state) for state in formulas.states], formulas.states)
                for formula in known
            ]
        except ValueError as problem:
            raise NoCertificate(f"no bounds of the slopes of h or phi: {problem}") from None
        self.loop, self.held = loop, held
        A = solve(loop.Xe, np.eye(loop.n, dtype=object))
        self._e_n = ball_list(A[-1])  # e_n = this x - ...
        self._mu = [symmetric_ball(flint.arb(v)) for v in held.mu]
        self._Xe, self._AB = (ball_table(rows) for rows in (loop.Xe, loop.AB))
        self._M, self._Ua, self._Ub = (ball_table(v) for v in (loop.M, loop.Ua, loop.Ub))
        self._R, self._nu_x, self._nu_Y = map(ball_list, (loop.R, loop.nu_x, loop.nu_Y))
        self._Y = [flint.arb(v) for v in (*loop.Y, held.steepest)]

    def middle_row(self, region: RegionNumbers) -> np.ndarray:
        """The part of u_law' that is linear in the errors, in the middle of a box."""
        wide = _Wide.of(self.loop, region)
        places = box_of_states(self.loop, region.box).mean(axis=1)
        part = self._part(wide, [flint.arb(v) for v in places.tolist()])
        linear = self._linear(wide, part, row_product(part.slopes, self._Xe))
        return np.array([float(v.mid()) for v in self._of_law(wide, part, linear)])

    def paces(self, region: RegionNumbers, near: Near | None = None) -> Paces:
        """All bounds on a box, whose ranges hold.

        Parameters
        ----------
        region : RegionNumbers
        near : Near, optional
            Then the box is that of the long run, and the estimates move as the continuous law says
            but for what the steps add. Otherwise their rates are only known to be of some sample.

        Raises
        ------
        NoCertificate
            If one of them is not finite.
        """
        wide = _Wide.of(self.loop, region)
        box = box_of_states(self.loop, region.box)
        parts = [self._part(wide, cell) for cell in _parts_of_box(box, FEW_CELLS)]
        steps = [
            ball_hull([part.estimate_rates[i] for part in parts]) for i in range(self.loop.r + 1)
        ]
        bounds = self._over_all(wide, parts, [self._moved(wide, part, steps) for part in parts])
        if near is None:
            return bounds
        law = least_law(self.held, bounds)
        added = [symmetric_ball(v) for v in image(self.loop, self.held, bounds, law)[1]]
        parts, moved = [self._part(wide, cell) for cell in _parts_of_box(box, MANY_CELLS)], []
        for part in parts:
            rates = [rate + more for rate, more in zip(part.estimate_rates, added, strict=True)]
            moved.append(self._moved(wide, part, rates, near, added[-1]))
        return self._over_all(wide, parts, moved)

    def _over_all(self, wide: _Wide, parts: list[_Part], moved: list[Any]) -> Paces:
        """The bounds of all parts together."""
        count = self.loop.r + 1
        laws, through, drives, drives_through = zip(*moved, strict=True)
        bounds = Paces(
            law=largest_ball(laws),
            law_through=largest_ball(through),
            drives=[largest_ball(entries) for entries in zip(*drives, strict=True)],
            drives_through=[largest_ball(entries) for entries in zip(*drives_through, strict=True)],
            noise=largest_ball([part.noise for part in parts]),
            drive_noise=[
                largest_ball([part.drive_noise[i] for part in parts]) for i in range(count)
            ],
            steps=[largest_ball([part.estimate_rates[i] for part in parts]) for i in range(count)],
            input=ball_hull([wide.delta_hat * part.measured_ubar for part in parts])
            + symmetric_ball(flint.arb(self.held.eta)),
            estimates=[wide.delta_hat, *wide.theta_hat],
        )
        numbers = [bounds.law, bounds.law_through, *bounds.drives, *bounds.drives_through]
        numbers += [bounds.noise, *bounds.drive_noise, *bounds.steps, bounds.input]
        if not all(ball.is_finite() for ball in numbers):
            raise NoCertificate("the rates of the loop have no bounds on the set")
        return bounds

    def _linear(self, wide: _Wide, part: _Part, row: Sequence[Any]) -> list[Any]:
        """What of row e' is linear in the errors e, theta_tilde, d."""
        return [*row_product(row, self._M), *(row[-1] * p for p in part.phi), -row[-1] * wide.pull]

    def _of_law(self, wide: _Wide, part: _Part, linear: Sequence[Any]) -> list[Any]:
        """What of u_law' is linear in the errors, where `linear` is of ubar'."""
        row, n, ubar = [wide.delta_hat * v for v in linear], self.loop.n, part.measured_ubar
        row[n - 1] -= wide.gain_rate * wide.gain_sign * ubar * ubar
        row[-1] += wide.gain_rate * wide.leak_gain * ubar / wide.v
        return row

    def _part(self, wide: _Wide, cell: list[Any]) -> _Part:
        """What is known where (e, y_d ... y_d^(q)) is in a cell."""
        loop, n = self.loop, self.loop.n
        e, Y = cell[:n], [*cell[n:], symmetric_ball(self._Y[-2])]
        x = [
            ball_sum(row, e) + ball_sum(other, Y[:-1])
            for row, other in zip(self._Xe, self._AB, strict=True)
        ]
        seen = [v + error for v, error in zip(x, self._mu, strict=True)]
        h, *phi = self._values(seen)
        h_slopes, *phi_slopes = (tape(seen) for tape in self._slopes)
        slopes = [nu - v for nu, v in zip(self._nu_x, h_slopes, strict=True)]
        for theta, row in zip(wide.theta_hat, phi_slopes, strict=True):
            slopes = [a - theta * b for a, b in zip(slopes, row, strict=True)]
        by_sensors = ball_sum(slopes, self._mu)
        direct = (
            ball_sum(self._nu_x, seen) + ball_sum(self._nu_Y, Y) - h - ball_sum(phi, wide.theta_hat)
        )
        measured = common_ball(direct, wide.ubar + by_sensors)
        e_seen = e[-1] + ball_sum(self._e_n, self._mu)
        drive_noise = [
            abs(
                ball_sum(
                    [a * e_seen + p * b for a, b in zip(row, self._e_n, strict=True)], self._mu
                )
            )
            for p, row in zip(phi, phi_slopes, strict=True)
        ]
        both = [a * e_seen + measured * b for a, b in zip(slopes, self._e_n, strict=True)]
        drive_noise.append(abs(ball_sum(both, self._mu)))
        drive = [
            p * e_seen - wide.leak_theta * (theta - prior)
            for p, theta, prior in zip(phi, wide.theta_hat, wide.theta0, strict=True)
        ]
        rates = [ball_sum(ball_list(row), drive) for row in loop.Gamma]
        of_delta = wide.gain_sign * measured * e_seen
        of_delta = -wide.gain_rate * (of_delta + wide.leak_gain * (wide.delta_hat - wide.delta0))
        return _Part(
            e=e,
            Y=Y,
            phi=phi,
            phi_slopes=phi_slopes,
            slopes=slopes,
            measured_ubar=measured,
            noise=abs(wide.delta_hat * by_sensors),
            drive_noise=drive_noise,
            estimate_rates=[*rates, of_delta],
        )

    def _moved(
        self,
        wide: _Wide,
        part: _Part,
        steps: Sequence[Any],
        near: Near | None = None,
        added: Any = None,
    ) -> tuple[Any, Any, list[Any], list[Any]]:
        """Bounds of the rates of u_law, and of phi_i e_n and ubar e_n, without m and through it.

        `steps` are the rates of the estimates: with `near`, those of this part, and what the steps
        add to that of delta_hat is `added`.
        """
        n, e_n, ubar = self.loop.n, part.e[-1], part.measured_ubar
        errors = [*part.e, *wide.theta_tilde, wide.d]

        def acting(x_row: Sequence[Any], Y_row: Sequence[Any], row: Sequence[Any]) -> Any:
            """What inputs and the reference add to the rate of x_row x + Y_row Y + ..."""
            total = ZERO_BALL
            for entry, size in zip(row_product(row, self._Ua), wide.reach, strict=True):
                total += symmetric_ball(entry * size)
            for entry in row_product(row, self._Ub):
                total += symmetric_ball(entry)
            by_Y = [a + b for a, b in zip(row_product(x_row, self._AB), Y_row, strict=False)]
            by_Y += list(Y_row[len(by_Y) :])
            by_Y[len(part.Y) - 2] = by_Y[len(part.Y) - 2] - ball_sum(row, self._R)
            return total + ball_sum(by_Y, [*part.Y[1:], symmetric_ball(self._Y[-1])])

        none, no_Y = [ZERO_BALL] * n, [ZERO_BALL] * len(part.Y)
        row = row_product(part.slopes, self._Xe)
        linear = self._linear(wide, part, row)
        remaining = acting(part.slopes, self._nu_Y, row) - ball_sum(part.phi, steps[:-1])
        ubar_rate = ball_sum(linear, errors) + remaining
        u_rate = wide.delta_hat * ubar_rate + steps[-1] * ubar
        if near is not None:
            of_law = self._of_law(wide, part, linear)
            away = [a - flint.arb(b) for a, b in zip(of_law, near.row, strict=True)]
            leak = wide.gain_rate * wide.leak_gain * (1 / wide.gain - wide.delta0)
            other = ball_between(*near.interval) + ball_sum(away, errors)
            other += wide.delta_hat * remaining + ubar * (added - leak)
            u_rate = common_ball(u_rate, other)
        e_row = [*none[:-1], flint.arb(1)]
        e_rate = ball_sum(self._linear(wide, part, e_row), errors) + acting(none, no_Y, e_row)
        drives, through = [], []
        for p, slopes in zip(part.phi, part.phi_slopes, strict=True):
            phi_row = row_product(slopes, self._Xe)
            phi_rate = ball_sum(self._linear(wide, part, phi_row), errors)
            phi_rate += acting(slopes, no_Y, phi_row)
            drives.append(abs(phi_rate * e_n + p * e_rate))
            through.append(abs((phi_row[-1] * e_n + p) * wide.gain))
        drives.append(abs(ubar_rate * e_n + ubar * e_rate))
        through.append(abs((row[-1] * e_n + ubar) * wide.gain))
        return abs(u_rate), abs(wide.delta_hat * row[-1] * wide.gain), drives, through


@dataclass(frozen=True)
class _Wide:
    """What is bounded on the whole box, as balls."""

    theta_tilde: list[Any]
    theta_hat: list[Any]
    theta0: list[Any]
    delta_hat: Any
    ubar: Any
    d: Any
    pull: Any
    gain: Any
    v: Any
    delta0: Any
    reach: list[Any]
    gain_sign: Any
    gain_rate: Any
    leak_gain: Any
    leak_theta: Any

    @classmethod
    def of(cls, loop: AdaptiveLoop, region: RegionNumbers) -> _Wide:
        n, r = loop.n, loop.r
        box = [ball_between(low, high) for low, high in region.box]
        v = ball_between(loop.largest_scale / loop.largest_scale, loop.largest_scale)
        theta = [
            flint.arb(m) + symmetric_ball(flint.arb(size))
            for m, size in zip(loop.theta_middle, loop.theta_radius, strict=True)
        ]
        gain = flint.arb(loop.gain_sign) * flint.arb(loop.smallest_gain) * v * v
        pi = ball_between(*scaled_ubar(loop, region))
        theta_tilde = box[n : n + r]
        return cls(
            theta_tilde=theta_tilde,
            theta_hat=[a - b for a, b in zip(theta, theta_tilde, strict=True)],
            theta0=ball_list(loop.theta0),
            delta_hat=1 / gain - box[-1] / v,
            ubar=ball_between(*region.ubar(loop)),
            d=box[-1],
            pull=flint.arb(loop.gain_sign) * flint.arb(loop.smallest_gain) * pi,
            gain=gain,
            v=v,
            delta0=flint.arb(loop.delta0),
            reach=ball_list(region.reach),
            gain_sign=flint.arb(loop.gain_sign),
            gain_rate=flint.arb(loop.gain_rate),
            leak_gain=flint.arb(loop.leak_gain),
            leak_theta=flint.arb(loop.leak_theta),
        )


@dataclass(frozen=True)
class _Part:
    """What is known on a part of the box."""

    e: list[Any]
    Y: list[Any]
    phi: list[Any]
    phi_slopes: list[list[Any]]
    slopes: list[Any]
    measured_ubar: Any
    noise: Any
    drive_noise: list[Any]
    estimate_rates: list[Any]


def _parts_of_box(box: np.ndarray, most: int) -> Iterator[list[Any]]:
    """Parts, not more than so many, that cover a box of floats, as balls."""
    wide = int((box[:, 0] < box[:, 1]).sum())
    count = 1 if not wide else max(1, int(most ** (1 / wide) + 1e-9))
    sides = []
    for low, high in box:
        inner = np.linspace(low, high, count + 1)[1:-1] if low < high else np.empty(0)
        edges = [low, *inner.tolist(), high]
        sides.append(
            [flint.arb(a).union(flint.arb(b)) for a, b in zip(edges, edges[1:], strict=False)]
        )
    return (list(cell) for cell in product(*sides))

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
from certrack.certificates.bootstrap.regions import box_of_states
from certrack.certificates.bootstrap.tape import Tape
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_down, float_up
from certrack.certificates.sampled_adaptive.held import HeldLaw
from certrack.core.kinks import JUMPING

#: Parts of a box at most: for what is bounded at all times, and for the rate of the law where the
#: estimates move with it.
FEW_CELLS, MANY_CELLS = 64, 1000

ZERO = flint.arb(0)


@dataclass(frozen=True)
class Paces:
    """Bounds on a box: of what moves, rest + through |m|, and of what the sensors' errors do.

    Attributes
    ----------
    law, law_through : balls
        Of |u_law'|.
    drives, drives_through : lists of balls
        Of |(phi_i e_n)'|, then |(ubar e_n)'|.
    noise, drive_noise : ball and list of balls
        How much u, phi_i e_n and ubar e_n differ by the sensors' errors.
    steps : list of balls
        Of |theta_hat_i'|, then |delta_hat'|.
    input : ball
        Contains every u_k.
    estimates : list of balls
        Contain delta_hat, theta_hat.
    """

    law: Any
    law_through: Any
    drives: list[Any]
    drives_through: list[Any]
    noise: Any
    drive_noise: list[Any]
    steps: list[Any]
    input: Any
    estimates: list[Any]


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


class Motion:
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
                Tape([formula.diff(state) for state in formulas.states], formulas.states)
                for formula in known
            ]
        except ValueError as problem:
            raise NoCertificate(f"no bounds of the slopes of h or phi: {problem}") from None
        self.loop, self.held = loop, held
        A = solve(loop.Xe, np.eye(loop.n, dtype=object))
        self._e_n = _balls(A[-1])  # e_n = this x - ...
        self._mu = [_symmetric(flint.arb(v)) for v in held.mu]
        self._Xe, self._AB = (_ball_rows(rows) for rows in (loop.Xe, loop.AB))
        self._M, self._Ua, self._Ub = (_ball_rows(v) for v in (loop.M, loop.Ua, loop.Ub))
        self._R, self._nu_x, self._nu_Y = map(_balls, (loop.R, loop.nu_x, loop.nu_Y))
        self._Y = [flint.arb(v) for v in (*loop.Y, held.steepest)]

    def middle_row(self, region: RegionNumbers) -> np.ndarray:
        """The part of u_law' that is linear in the errors, in the middle of a box."""
        wide = _Wide.of(self.loop, region)
        places = box_of_states(self.loop, region.box).mean(axis=1)
        part = self._part(wide, [flint.arb(v) for v in places.tolist()])
        linear = self._linear(wide, part, _product(part.slopes, self._Xe))
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
        parts = [self._part(wide, cell) for cell in _cells(box, FEW_CELLS)]
        steps = [_hull([part.estimate_rates[i] for part in parts]) for i in range(self.loop.r + 1)]
        found = self._over_all(wide, parts, [self._moved(wide, part, steps) for part in parts])
        if near is None:
            return found
        law = least_law(self.held, found)
        added = [_symmetric(v) for v in image(self.loop, self.held, found, law)[1]]
        parts, moved = [self._part(wide, cell) for cell in _cells(box, MANY_CELLS)], []
        for part in parts:
            rates = [rate + more for rate, more in zip(part.estimate_rates, added, strict=True)]
            moved.append(self._moved(wide, part, rates, near, added[-1]))
        return self._over_all(wide, parts, moved)

    def _over_all(self, wide: _Wide, parts: list[_Part], moved: list[Any]) -> Paces:
        """The bounds of all parts together."""
        count = self.loop.r + 1
        laws, through, drives, drives_through = zip(*moved, strict=True)
        found = Paces(
            law=_largest(laws),
            law_through=_largest(through),
            drives=[_largest(entries) for entries in zip(*drives, strict=True)],
            drives_through=[_largest(entries) for entries in zip(*drives_through, strict=True)],
            noise=_largest([part.noise for part in parts]),
            drive_noise=[_largest([part.drive_noise[i] for part in parts]) for i in range(count)],
            steps=[_largest([part.estimate_rates[i] for part in parts]) for i in range(count)],
            input=_hull([wide.delta_hat * part.measured_ubar for part in parts])
            + _symmetric(flint.arb(self.held.eta)),
            estimates=[wide.delta_hat, *wide.theta_hat],
        )
        numbers = [found.law, found.law_through, *found.drives, *found.drives_through]
        numbers += [found.noise, *found.drive_noise, *found.steps, found.input]
        if not all(ball.is_finite() for ball in numbers):
            raise NoCertificate("the rates of the loop have no bounds on the set")
        return found

    def _linear(self, wide: _Wide, part: _Part, row: Sequence[Any]) -> list[Any]:
        """What of row e' is linear in the errors e, theta_tilde, d."""
        return [*_product(row, self._M), *(row[-1] * p for p in part.phi), -row[-1] * wide.pull]

    def _of_law(self, wide: _Wide, part: _Part, linear: Sequence[Any]) -> list[Any]:
        """What of u_law' is linear in the errors, where `linear` is of ubar'."""
        row, n, ubar = [wide.delta_hat * v for v in linear], self.loop.n, part.measured_ubar
        row[n - 1] -= wide.gain_rate * wide.gain_sign * ubar * ubar
        row[-1] += wide.gain_rate * wide.leak_gain * ubar / wide.v
        return row

    def _part(self, wide: _Wide, cell: list[Any]) -> _Part:
        """What is known where (e, y_d ... y_d^(q)) is in a cell."""
        loop, n = self.loop, self.loop.n
        e, Y = cell[:n], [*cell[n:], _symmetric(self._Y[-2])]
        x = [
            _dot(row, e) + _dot(other, Y[:-1])
            for row, other in zip(self._Xe, self._AB, strict=True)
        ]
        seen = [v + error for v, error in zip(x, self._mu, strict=True)]
        h, *phi = self._values(seen)
        h_slopes, *phi_slopes = (tape(seen) for tape in self._slopes)
        slopes = [nu - v for nu, v in zip(self._nu_x, h_slopes, strict=True)]
        for theta, row in zip(wide.theta_hat, phi_slopes, strict=True):
            slopes = [a - theta * b for a, b in zip(slopes, row, strict=True)]
        by_sensors = _dot(slopes, self._mu)
        direct = _dot(self._nu_x, seen) + _dot(self._nu_Y, Y) - h - _dot(phi, wide.theta_hat)
        measured = _common(direct, wide.ubar + by_sensors)
        e_seen = e[-1] + _dot(self._e_n, self._mu)
        drive_noise = [
            abs(_dot([a * e_seen + p * b for a, b in zip(row, self._e_n, strict=True)], self._mu))
            for p, row in zip(phi, phi_slopes, strict=True)
        ]
        both = [a * e_seen + measured * b for a, b in zip(slopes, self._e_n, strict=True)]
        drive_noise.append(abs(_dot(both, self._mu)))
        drive = [
            p * e_seen - wide.leak_theta * (theta - prior)
            for p, theta, prior in zip(phi, wide.theta_hat, wide.theta0, strict=True)
        ]
        rates = [_dot(_balls(row), drive) for row in loop.Gamma]
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
            total = ZERO
            for entry, size in zip(_product(row, self._Ua), wide.reach, strict=True):
                total += _symmetric(entry * size)
            for entry in _product(row, self._Ub):
                total += _symmetric(entry)
            by_Y = [a + b for a, b in zip(_product(x_row, self._AB), Y_row, strict=False)]
            by_Y += list(Y_row[len(by_Y) :])
            by_Y[len(part.Y) - 2] = by_Y[len(part.Y) - 2] - _dot(row, self._R)
            return total + _dot(by_Y, [*part.Y[1:], _symmetric(self._Y[-1])])

        none, no_Y = [ZERO] * n, [ZERO] * len(part.Y)
        row = _product(part.slopes, self._Xe)
        linear = self._linear(wide, part, row)
        rest = acting(part.slopes, self._nu_Y, row) - _dot(part.phi, steps[:-1])
        ubar_rate = _dot(linear, errors) + rest
        u_rate = wide.delta_hat * ubar_rate + steps[-1] * ubar
        if near is not None:
            of_law = self._of_law(wide, part, linear)
            away = [a - flint.arb(b) for a, b in zip(of_law, near.row, strict=True)]
            leak = wide.gain_rate * wide.leak_gain * (1 / wide.gain - wide.delta0)
            other = _between(*near.interval) + _dot(away, errors)
            other += wide.delta_hat * rest + ubar * (added - leak)
            u_rate = _common(u_rate, other)
        e_row = [*none[:-1], flint.arb(1)]
        e_rate = _dot(self._linear(wide, part, e_row), errors) + acting(none, no_Y, e_row)
        drives, through = [], []
        for p, slopes in zip(part.phi, part.phi_slopes, strict=True):
            phi_row = _product(slopes, self._Xe)
            phi_rate = _dot(self._linear(wide, part, phi_row), errors)
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
        box = [_between(low, high) for low, high in region.box]
        v = _between(loop.largest_scale / loop.largest_scale, loop.largest_scale)
        theta = [
            flint.arb(m) + _symmetric(flint.arb(size))
            for m, size in zip(loop.theta_middle, loop.theta_radius, strict=True)
        ]
        gain = flint.arb(loop.gain_sign) * flint.arb(loop.smallest_gain) * v * v
        pi = _between(*scaled_ubar(loop, region))
        theta_tilde = box[n : n + r]
        return cls(
            theta_tilde=theta_tilde,
            theta_hat=[a - b for a, b in zip(theta, theta_tilde, strict=True)],
            theta0=_balls(loop.theta0),
            delta_hat=1 / gain - box[-1] / v,
            ubar=_between(*region.ubar(loop)),
            d=box[-1],
            pull=flint.arb(loop.gain_sign) * flint.arb(loop.smallest_gain) * pi,
            gain=gain,
            v=v,
            delta0=flint.arb(loop.delta0),
            reach=_balls(region.reach),
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


def least_law(held: HeldLaw, paces: Paces) -> Any:
    """The fixed point of :func:`image`: a bound of |m| in the long run.

    Raises
    ------
    NoCertificate
        If there is none.
    """
    rest = 1 - flint.arb(held.reach) * paces.law_through
    if not bool(rest > 0):
        raise NoCertificate("the period is too long: the input moves faster than it is sampled")
    fixed = flint.arb(held.reach) * paces.law + paces.noise + flint.arb(held.eta)
    return (fixed / rest).abs_upper()


def image(loop: AdaptiveLoop, held: HeldLaw, paces: Paces, law: Any) -> tuple[Any, list[Any]]:
    """Bounds of m, and of what the steps add to the rates of the estimates, where |m| <= law."""
    T, m = flint.arb(held.T), flint.arb(law)
    of_law = flint.arb(held.reach) * (paces.law + paces.law_through * m)
    of_law += paces.noise + flint.arb(held.eta)
    drives = [
        T * (rest + through * m) + noise
        for rest, through, noise in zip(
            paces.drives, paces.drives_through, paces.drive_noise, strict=True
        )
    ]
    if not held.exact_leak:  # Euler's leak is that of the sample
        leaks = [*(loop.leak_theta for _ in range(loop.r)), loop.leak_gain]
        drives = [
            drive + T * flint.arb(leak) * step
            for drive, leak, step in zip(drives, leaks, paces.steps, strict=True)
        ]
    thetas = [
        sum((flint.arb(abs(v)) * d for v, d in zip(row, drives[:-1], strict=True)), flint.arb(0))
        for row in loop.Gamma
    ]
    return of_law, [*thetas, flint.arb(loop.gain_rate) * drives[-1]]


def _cells(box: np.ndarray, most: int) -> Iterator[list[Any]]:
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


def _between(low: Any, high: Any) -> Any:
    return flint.arb(float_down(low)).union(flint.arb(float_up(high)))


def _symmetric(size: Any) -> Any:
    """The ball around zero of a ball's largest magnitude."""
    return flint.arb(0, 1) * size.abs_upper()


def _common(first: Any, second: Any) -> Any:
    """Where two enclosures of the same value overlap; the finite one if one is not."""
    if not first.is_finite() or not second.is_finite():
        return second if second.is_finite() else first
    low = max(first.lower(), second.lower())
    high = min(first.upper(), second.upper())
    return low.union(high) if low <= high else second


def _hull(balls: Sequence[Any]) -> Any:
    total = balls[0]
    for ball in balls[1:]:
        total = total.union(ball)
    return total


def _largest(balls: Sequence[Any]) -> Any:
    """A bound of all magnitudes; not finite if one is not."""
    if not all(ball.is_finite() for ball in balls):
        return flint.arb("inf")
    return max(ball.abs_upper() for ball in balls)


def _balls(values: Any) -> list[Any]:
    return [flint.arb(v) for v in values]


def _ball_rows(rows: np.ndarray) -> list[list[Any]]:
    return [_balls(row) for row in rows]


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum((left * right for left, right in zip(a, b, strict=True)), ZERO)


def _product(row: Sequence[Any], rows: Sequence[Sequence[Any]]) -> list[Any]:
    """A row times a matrix."""
    return [_dot(row, column) for column in zip(*rows, strict=True)]

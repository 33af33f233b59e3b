"""The adaptive law as implemented, checked from docs/certificate-file.md; a part of
independent_checker.

Rates are enclosed in intervals of floats, rounded outward, with the slopes of the formulas carried
along, on parts of the box of (e, y_d ... y_d^(q)).
"""

import itertools
import math
from fractions import Fraction as Q

from independent_bootstrap import (
    Loop,
    Region,
    Slopes,
    around,
    constant,
    dot,
    formula,
    interval,
    opposite,
    pair,
    plus,
    times,
    wide,
)
from independent_checker import decimal, demand, number

INVARIANT = {"region", "law", "estimates", "function", "room", "starts", "priors"}
STAGE = {"region", "pace", "law", "estimates", "functions"}

#: Parts of a box: where the estimates' rates are those of any point, and of the same one.
FEW, MANY = 64, 1000

NOT_COVERED = ("velocity", "jitter", "rate_limit", "offset")

ZERO, ONE = (0.0, 0.0), (1.0, 1.0)


def is_adaptive(proof):
    return isinstance(proof, list) and len(proof) == 1 and "invariant" in proof[0]


def added(*values):
    total = values[0]
    for value in values[1:]:
        total = plus(total, value)
    return total


def minus(a, b):
    return plus(a, opposite(b))


def inner(a, b):
    total = ZERO
    for u, v in zip(a, b, strict=True):
        total = plus(total, times(u, v))
    return total


def size(x):
    return max(abs(x[0]), abs(x[1]))


def both(x):
    """The symmetric interval of the magnitudes of another."""
    return -size(x), size(x)


def within(a, b):
    return max(a[0], b[0]), min(a[1], b[1])


def over(low, high):
    return around(low)[0], around(high)[1]


def through(row, rows):
    return [inner(row, column) for column in zip(*rows, strict=True)]


def inverse(x):
    demand(x[0] > 0 or x[1] < 0, "a division by zero")
    return wide(1 / x[1], 1 / x[0])


class Drive:
    """Numbers of [implementation], exact but for T and what it multiplies."""

    def __init__(self, table, system, steepest):
        drive = table["implementation"]
        demand(not any(drive.get(key) for key in NOT_COVERED), "the drive is not covered")
        law = table["law"]
        demand("observer" not in law and not law.get("sampled_feedforward"), "the law, too")
        n = system.n
        quanta = drive.get("measurement_quantum", [0] * n)
        bounds = drive.get("noise_bound", [0] * n)
        noisy = any(drive.get("noise", [])) or "sensor_error" in drive
        demand(not noisy or "noise_bound" in drive, "noise has no bound")
        late = drive.get("delay", 0)
        self.T = number(drive["period"], {})
        self.D = self.T * max(number(v, {}) for v in (late if isinstance(late, list) else [late]))
        self.h = self.T + self.D
        pairs = zip(quanta, bounds, strict=True)
        self.mu = [number(a, {}) / 2 + number(b, {}) for a, b in pairs]
        self.eta = number(drive.get("input_quantum", 0), {}) / 2
        self.euler = drive.get("update", "euler") == "euler"
        self.first = number(drive.get("initial_input", 0), {})
        self.saturation, self.projection = (drive.get(k) for k in ("saturation", "projection"))
        self.steepest = steepest


class AdaptiveLoop(Loop):
    """The loop of the bootstrap without a first proof."""

    def __init__(self, system):
        unit = [[Q(i == j) for j in range(system.n)] for i in range(system.n)]
        super().__init__(system, Q(1), unit)


class Rates:
    """Bounds of all that moves on the box of a region."""

    def __init__(self, loop, drive, region, near=None):
        self.loop, self.drive, self.region = loop, drive, region
        s = loop.system
        self.gain_sign, self.g0 = around(Q(loop.sign)), around(loop.g0)
        self.v = over(Q(1), loop.v1)
        self.gain = times(times(self.gain_sign, self.g0), times(self.v, self.v))
        box = [over(*ends) for ends in region.box]
        self.errors, self.d = box[loop.n : -1], box[-1]
        theta = [over(m - half, m + half) for m, half in zip(loop.middle, loop.radius, strict=True)]
        self.theta_hat = [minus(a, b) for a, b in zip(theta, self.errors, strict=True)]
        self.delta_hat = minus(inverse(self.gain), times(self.d, inverse(self.v)))
        self.ubar = over(*region.ubar)
        self.pull = times(times(self.gain_sign, self.g0), over(*region.pi))
        self.A_last = [around(v) for v in s.A[-1]]
        self.mu = [both(around(v)) for v in drive.mu]
        self.A_inverse = [[around(v) for v in row] for row in s.A_inverse]
        self.AB = [[around(v) for v in row[: s.q + 1]] for row in s.through]
        self.M = [[around(v) for v in row] for row in s.M]
        self.R = [around(v) for v in s.R]
        self.a = [[around(v) for v in column] for column in s.a]
        self.b = [[around(v) for v in column] for column in s.b]
        self.nu_x, self.nu_Y = ([around(v) for v in row] for row in (s.nu_x, s.nu_Y))
        self.Y = [around(v) for v in (*s.Y, drive.steepest)]
        self.Gamma = [[around(v) for v in row] for row in s.Gamma]
        self.gbar, self.gbar1, self.gbar2 = map(around, (s.gbar, s.gbar1, s.gbar2))
        self.theta0, self.delta0 = [around(v) for v in s.theta0], around(s.delta0)
        few = [self.point(cell) for cell in self.cells(FEW)]
        count = loop.r + 1
        anywhere = [
            (min(p.rates[i][0] for p in few), max(p.rates[i][1] for p in few)) for i in range(count)
        ]
        self.take(few, [self.moved(p, anywhere) for p in few])
        if near is not None:
            _, law = self.least()
            more = [both(v) for v in self.of_steps(law)]
            many = [self.point(cell) for cell in self.cells(MANY)]
            moved = [
                self.moved(
                    p, [plus(a, b) for a, b in zip(p.rates, more, strict=True)], near, more[-1]
                )
                for p in many
            ]
            self.take(many, moved)

    def cells(self, most):
        sides = [over(*ends) for ends in self.region.box[: self.loop.n]]
        sides += [both(y) for y in self.Y[:-2]]
        count = max(1, int(most ** (1 / max(1, sum(a < b for a, b in sides))) + 1e-9))
        cut = []
        for low, high in sides:
            edges = [low + (high - low) * i / count for i in range(count)] + [high]
            cut.append(list(itertools.pairwise(edges)) if low < high else [(low, high)])
        return itertools.product(*cut)

    def point(self, cell):
        """What is known in a part."""
        loop, n = self.loop, self.loop.n
        p = Part()
        p.e, p.Y = list(cell[:n]), [*cell[n:], both(self.Y[-2])]
        x = [
            plus(inner(row, p.e), inner(other, p.Y[:-1]))
            for row, other in zip(self.A_inverse, self.AB, strict=True)
        ]
        seen = [plus(a, b) for a, b in zip(x, self.mu, strict=True)]
        unit = [[ONE if i == j else ZERO for j in range(n)] for i in range(n)]
        like = Slopes(ZERO, ZERO, [ZERO] * n)
        constants = loop.system.constants.items()
        known = {name: constant(around(v), like) for name, v in constants}
        known |= {
            name: Slopes(v, v, row)
            for name, v, row in zip(loop.system.plant["states"], seen, unit, strict=True)
        }
        h, *phi = (formula(node, known, like) for node in loop.formulas.nodes)
        p.phi, p.steep = [v.value for v in phi], [v.slopes for v in phi]
        p.K = [minus(a, b) for a, b in zip(self.nu_x, h.slopes, strict=True)]
        for theta, row in zip(self.theta_hat, p.steep, strict=True):
            p.K = [minus(a, times(theta, b)) for a, b in zip(p.K, row, strict=True)]
        by_sensors = inner(p.K, self.mu)
        direct = plus(inner(self.nu_x, seen), inner(self.nu_Y, p.Y))
        direct = minus(minus(direct, h.value), inner(p.phi, self.theta_hat))
        p.ubar = within(direct, plus(self.ubar, by_sensors))
        e_seen = plus(p.e[-1], inner(self.A_last, self.mu))
        p.noise = size(times(self.delta_hat, by_sensors))
        rows = [
            [plus(times(a, e_seen), times(f, b)) for a, b in zip(row, self.A_last, strict=True)]
            for f, row in [*zip(p.phi, p.steep, strict=True), (p.ubar, p.K)]
        ]
        p.drive_noise = [size(inner(row, self.mu)) for row in rows]
        drive = [
            minus(times(f, e_seen), times(self.gbar2, minus(theta, prior)))
            for f, theta, prior in zip(p.phi, self.theta_hat, self.theta0, strict=True)
        ]
        of_delta = times(times(self.gain_sign, p.ubar), e_seen)
        leak = times(self.gbar1, minus(self.delta_hat, self.delta0))
        p.rates = [inner(row, drive) for row in self.Gamma]
        p.rates.append(times(opposite(self.gbar), plus(of_delta, leak)))
        return p

    def moved(self, p, steps, near=None, more=None):
        """Bounds of |u'| and of the drives' rates: what is there without m, and through it."""
        n = self.loop.n
        errors = [*p.e, *self.errors, self.d]

        def linear(row):
            return [
                *through(row, self.M),
                *(times(row[-1], f) for f in p.phi),
                times(opposite(row[-1]), self.pull),
            ]

        def acting(x_row, Y_row, row):
            total = ZERO
            for column, reach in zip(self.a, self.region.reach, strict=True):
                total = plus(total, both(times(inner(row, column), around(reach))))
            for column in self.b:
                total = plus(total, both(inner(row, column)))
            by_Y = [plus(a, b) for a, b in zip(through(x_row, self.AB), Y_row, strict=False)]
            by_Y += Y_row[len(by_Y) :]
            by_Y[-2] = minus(by_Y[-2], inner(row, self.R))
            return plus(total, inner(by_Y, [*p.Y[1:], both(self.Y[-1])]))

        none, no_Y = [ZERO] * n, [ZERO] * len(p.Y)
        row = through(p.K, self.A_inverse)
        along = linear(row)
        rest = minus(acting(p.K, self.nu_Y, row), inner(p.phi, steps[:-1]))
        ubar_rate = plus(inner(along, errors), rest)
        u_rate = plus(times(self.delta_hat, ubar_rate), times(steps[-1], p.ubar))
        if near is not None:
            r, interval_of_r = near
            of_law = [times(self.delta_hat, v) for v in along]
            square = times(times(self.gbar, self.gain_sign), times(p.ubar, p.ubar))
            of_law[n - 1] = minus(of_law[n - 1], square)
            forget = times(self.gbar, self.gbar1)
            of_law[-1] = plus(of_law[-1], times(times(forget, p.ubar), inverse(self.v)))
            away = [minus(a, around(b)) for a, b in zip(of_law, r, strict=True)]
            leak = times(forget, minus(inverse(self.gain), self.delta0))
            other = added(
                over(*interval_of_r),
                inner(away, errors),
                times(self.delta_hat, rest),
                times(p.ubar, minus(more, leak)),
            )
            u_rate = within(u_rate, other)
        last = [*none[:-1], ONE]
        e_rate = plus(inner(linear(last), errors), acting(none, no_Y, last))
        drives, by_m = [], []
        for f, slopes in zip(p.phi, p.steep, strict=True):
            row_f = through(slopes, self.A_inverse)
            rate = plus(inner(linear(row_f), errors), acting(slopes, no_Y, row_f))
            drives.append(size(plus(times(rate, p.e[-1]), times(f, e_rate))))
            by_m.append(size(times(plus(times(row_f[-1], p.e[-1]), f), self.gain)))
        drives.append(size(plus(times(ubar_rate, p.e[-1]), times(p.ubar, e_rate))))
        by_m.append(size(times(plus(times(row[-1], p.e[-1]), p.ubar), self.gain)))
        return size(u_rate), size(times(times(self.delta_hat, row[-1]), self.gain)), drives, by_m

    def take(self, points, moved):
        count = self.loop.r + 1
        self.law, self.by_m = max(m[0] for m in moved), max(m[1] for m in moved)
        self.drives = [max(m[2][i] for m in moved) for i in range(count)]
        self.drives_by_m = [max(m[3][i] for m in moved) for i in range(count)]
        self.noise = max(p.noise for p in points)
        self.drive_noise = [max(p.drive_noise[i] for p in points) for i in range(count)]
        self.steps = [max(size(p.rates[i]) for p in points) for i in range(count)]
        inputs = [times(self.delta_hat, p.ubar) for p in points]
        eta = both(around(self.drive.eta))
        self.u = plus((min(u[0] for u in inputs), max(u[1] for u in inputs)), eta)

    def of_law(self, m):
        """Above |u - u_law| where |m| is not more."""
        inner_rate = plus(around(Q(self.law)), times(around(Q(self.by_m)), m))
        parts = times(around(self.drive.h), inner_rate), around(Q(self.noise))
        return added(*parts, around(self.drive.eta))[1]

    def least(self):
        """b h < 1, and m*."""
        room = minus(ONE, times(around(self.drive.h), around(Q(self.by_m))))
        demand(room[0] > 0, "the period is too long")
        m = times((0.0, self.of_law(ZERO)), inverse(room))[1]
        return room, (0.0, m)

    def of_steps(self, m):
        T = around(self.drive.T)
        drives = [
            plus(times(T, plus((a, a), times((b, b), m))), (N, N))
            for a, b, N in zip(self.drives, self.drives_by_m, self.drive_noise, strict=True)
        ]
        if self.drive.euler:
            leaks = [self.gbar2] * self.loop.r + [self.gbar1]
            drives = [
                plus(v, times(T, times(leak, (F, F))))
                for v, leak, F in zip(drives, leaks, self.steps, strict=True)
            ]
        above = [(0.0, v[1]) for v in drives]
        rows = [inner([both(v) for v in row], above[:-1]) for row in self.Gamma]
        return [(0.0, v[1]) for v in (*rows, times(self.gbar, above[-1]))]

    def check(self, record):
        """That what sampling adds is less than what is said."""
        law, estimates = decimal(record["law"]), [decimal(v) for v in record["estimates"]]
        demand(len(estimates) == self.loop.r + 1, "not as many estimates")
        self.least()
        demand(Q(self.of_law(around(law))) < law, "u - u_law is not below what is said")
        for value, stated in zip(self.of_steps(around(law)), estimates, strict=True):
            demand(Q(value[1]) < stated, "what steps add is not below what is said")


class Part:
    """What is known in a part of a box."""


def acting_of(loop, record):
    law, (*thetas, delta) = decimal(record["law"]), map(decimal, record["estimates"])
    return [Q(0)] * (loop.n - 1) + [loop.g0 * loop.v1**2 * law, *thetas, loop.v1 * delta]


def check_invariant(loop, drive, invariant):
    """The claims of the kept set, as what is known."""
    demand(
        isinstance(invariant, dict) and set(invariant) == INVARIANT, "the kept set has other keys"
    )
    loop.box, loop.row = [pair(v) for v in invariant["region"]["box"]], None
    region = Region(loop, invariant["region"], acting_of(loop, invariant), stands=False)
    low, high = interval(region.row, region.box)
    demand(region.ends[0] <= low and high <= region.ends[1], "the row is not that of the box")
    rates = Rates(loop, drive, region)
    rates.check(invariant)
    claims = region.function(invariant["function"])
    box = []
    for error, (low, high) in enumerate(region.box):
        sides = {s: [b for e, side, b in claims if e == error and side == s] for s in (1, -1)}
        demand(all(sides.values()), "an error is not bounded by the kept set")
        above, below = min(sides[1]), min(sides[-1])
        demand(above < high and -below > low, "the kept set is not inside its box")
        box.append((-below, above))
    demand(all(error < loop.size for error, _, _ in claims), "a claim of no error")
    room, alpha = decimal(invariant["room"]), around(decimal(invariant["function"]["alpha"]))
    D, h, T = (around(v) for v in (drive.D, drive.h, drive.T))

    def grown(time):
        x = times(alpha, time)[1]
        return (1.0, math.nextafter(math.exp(x) * (1 + 1e-12), math.inf))

    rest = minus(ONE, times(times((0.0, rates.by_m), h), grown(h)))
    demand(rest[0] > 0, "the first input is too late")
    away = (0.0, size(minus(rates.u, around(drive.first))))
    total = times(times(times(away, D), grown(D)), inverse(rest))
    impulse = [times((0.0, b), times(T, grown(T))) for b in rates.drives_by_m]
    factors = [ZERO] * (loop.n - 1) + [around(loop.g0 * loop.v1**2)]
    factors += [inner([both(v) for v in row], impulse[:-1]) for row in rates.Gamma]
    factors.append(times(times(around(loop.v1), rates.gbar), impulse[-1]))
    G = [[decimal(v) for v in row] for row in invariant["function"]["G"]]
    rise = ZERO
    for row, factor, half in zip(G, factors, region.halves, strict=False):
        slope = around(2 * sum(map(abs, row)) / half)
        rise = plus(rise, times(slope, factor))
    demand(Q(times(rise, total)[1]) <= room, "the room is too small")
    check_starts(loop, region, invariant, G, room)
    check_limits(drive, rates)
    loop.box = box


def check_starts(loop, region, invariant, G, room):
    starts = [decimal(v) for v in invariant["starts"]]
    of_delta, *of_thetas = map(pair, invariant["priors"])
    demand(len(starts) == loop.n and len(of_thetas) == loop.r, "not as many starts")
    demand(min(starts) >= 0 and room >= 0, "a start is negative")
    ends = [(-v, v) for v in starts]
    for (low, high), m, half in zip(of_thetas, loop.middle, loop.radius, strict=True):
        demand(low <= high, "an interval is empty")
        ends.append((m - half - high, m + half - low))
    corners = [(s, 1 / s) for s in (Q(1), loop.v1)]
    far = Q(loop.sign) / loop.g0
    if all(loop.sign * v >= 0 for v in of_delta):  # it falls or rises along with v
        values = [far * inverse_v - v * delta for v, inverse_v in corners for delta in of_delta]
    else:
        values = [
            far * inverse_v - v * delta
            for v, _ in corners
            for _, inverse_v in corners
            for delta in of_delta
        ]
    ends.append((min(values), max(values)))
    for corner in itertools.product(*ends):
        zeta = [
            (z - m) / half for z, m, half in zip(corner, region.middles, region.halves, strict=True)
        ]
        vector = [*zeta, Q(1)]
        value = dot(vector, [dot(row, vector) for row in G])
        demand(value <= -room, "a start is not in the kept set")


def check_limits(drive, rates):
    if drive.saturation is not None:
        low, high = (number(v, {}) for v in drive.saturation)
        demand(low <= drive.first <= high, "the first input is beyond the limits")
        inside = low <= Q(rates.u[0]) and Q(rates.u[1]) <= high
        demand(inside, "the saturation may act")
    if drive.projection is not None:
        values = [rates.delta_hat, *rates.theta_hat]
        for value, (low, high) in zip(values, drive.projection, strict=True):
            inside = number(low, {}) <= Q(value[0]) and Q(value[1]) <= number(high, {})
            demand(inside, "the projection may act")


def check_adaptive(proof, table, system, steepest):
    """The bound on limsup |e_1| that the proof shows, and the words of its claim."""
    demand(system.adaptive, "it is for the adaptive law")
    demand(set(proof) == {"invariant", "row", "stages"}, "the proof has other keys")
    loop, drive = AdaptiveLoop(system), Drive(table, system, steepest)
    check_invariant(loop, drive, proof["invariant"])
    row = [decimal(v) for v in proof["row"]]
    demand(len(row) == loop.size, "the row has another length")
    pace = loop.known(row)
    sides = {1: [], -1: []}
    demand(0 < len(proof["stages"]) <= 64, "no stages, or too many")
    for stage in proof["stages"]:
        demand(isinstance(stage, dict) and set(stage) == STAGE, "a stage has other keys")
        stated = pair(stage["pace"])
        demand(stated[0] < pace[0] and pace[1] < stated[1], "a pace does not hold what is known")
        region = Region(loop, stage["region"], acting_of(loop, stage), more=row)
        Rates(loop, drive, region, (row, stated)).check(stage)
        claims = [claim for f in stage["functions"] for claim in region.function(f)]
        loop.take(region, claims)
        low, high = loop.known(row)
        pace = max(pace[0], low), min(pace[1], high)
        for error, side, bound in claims:
            if error == loop.size + 1:
                pace = (
                    (pace[0], min(pace[1], bound)) if side > 0 else (max(pace[0], -bound), pace[1])
                )
            if error == 0:
                sides[side].append(bound)
    demand(all(sides.values()), "e_1 is not bounded on both sides")
    bound = max(min(bounds) for bounds in sides.values())
    invariant = proof["invariant"]
    words = [f"|e_{i + 1}(0)| <= {v}" for i, v in enumerate(invariant["starts"])]
    for i, (low, high) in enumerate(invariant["priors"]):
        words.append(f"{f'theta_hat_{i}' if i else 'delta_hat'}(0) in [{low}, {high}]")
    texts = {
        claim["bound"]
        for stage in proof["stages"]
        for f in stage["functions"]
        for claim in f["claims"]
        if claim["error"] == 0 and decimal(claim["bound"]) == bound
    }
    return bound, {f"limsup |e_1(t)| <= {text} from {', '.join(words)}" for text in texts}

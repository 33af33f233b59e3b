"""The bootstrap's stages, checked from docs/certificate-file.md; a part of independent_checker.

Ranges of formulas are enclosed in floats, rounded outward by `nextafter`, with slopes carried along
(the mean value theorem), on parts of the box of (e, Y); matrices are checked in integers.
"""

import ast
import heapq
import math
from fractions import Fraction as Q

from independent_checker import Refused, decimal, demand, inverse, product, root_above, transposed

REGION = {"box", "middle", "slope", "row", "regressor", "drift", "remainder", "reach"}
FUNCTION = {"alpha", "G", "squares", "inputs", "sectors", "mu", "scales", "turns", "claims"}
CLAIM = {"error", "side", "scale", "bound"}

#: Parts of a box before a range counts as not shown.
PARTS = 20_000


def is_bootstrap(proof):
    return (
        isinstance(proof, list)
        and len(proof) > 1
        and all(isinstance(entry, dict) and "region" in entry for entry in proof[1:])
    )


# Intervals of floats, and their slopes ------------------------------------------------------------


def wide(low, high):
    for _ in range(2):
        low, high = math.nextafter(low, -math.inf), math.nextafter(high, math.inf)
    return low, high


def plus(a, b):
    return wide(a[0] + b[0], a[1] + b[1])


def times(a, b):
    ends = [u * v for u in a for v in b]
    return wide(min(ends), max(ends))


class Slopes:
    """A value on a part, in its middle, and the slopes on the part, as intervals."""

    def __init__(self, value, middle, slopes):
        self.value, self.middle, self.slopes = value, middle, slopes

    def __add__(self, other):
        slopes = [plus(a, b) for a, b in zip(self.slopes, other.slopes, strict=True)]
        return Slopes(plus(self.value, other.value), plus(self.middle, other.middle), slopes)

    def __mul__(self, other):
        pairs = zip(self.slopes, other.slopes, strict=True)
        slopes = [plus(times(a, other.value), times(b, self.value)) for a, b in pairs]
        return Slopes(times(self.value, other.value), times(self.middle, other.middle), slopes)

    def through(self, function, slope):
        steep = slope(self.value)
        slopes = [times(steep, s) for s in self.slopes]
        return Slopes(function(self.value), function(self.middle), slopes)


def around(number):
    """An interval of floats around a rational."""
    return wide(float(number), float(number))


def constant(value, like):
    return Slopes(value, value, [(0.0, 0.0)] * len(like.slopes))


def rising(function):
    return lambda x: wide(function(x[0]), function(x[1]))


def sine(x):
    low, high = x
    if not high - low < 6:
        return -1.0, 1.0
    values = [math.sin(low), math.sin(high)]
    for k in range(math.floor(low / math.pi) - 1, math.ceil(high / math.pi) + 1):
        crest = (k + 0.5) * math.pi
        if low - 1e-9 <= crest <= high + 1e-9:
            values.append(1.0 if k % 2 == 0 else -1.0)
    low, high = wide(min(values), max(values))
    return max(low, -1.0), min(high, 1.0)


def cosine(x):
    return sine(plus(x, around(Q(math.pi) / 2)))


def opposite(x):
    return -x[1], -x[0]


def even(x):
    """|x| of an interval."""
    return (0.0 if x[0] <= 0 <= x[1] else min(map(abs, x)), max(map(abs, x)))


def steepness_of_tanh(x):
    near, far = even(x)
    return wide(max(0.0, 1 - math.tanh(far) ** 2 - 1e-15), 1 - math.tanh(near) ** 2 + 1e-15)


FUNCTIONS = {
    "sin": (sine, cosine),
    "cos": (cosine, lambda x: opposite(sine(x))),
    "tanh": (rising(math.tanh), steepness_of_tanh),
    "exp": (rising(math.exp), rising(math.exp)),
    "abs": (even, lambda x: (1.0 if x[0] > 0 else -1.0, -1.0 if x[1] < 0 else 1.0)),
}


def power(x, k):
    if k == 0:
        return 1.0, 1.0
    ends = even(x) if k % 2 == 0 else x
    return wide(ends[0] ** k, ends[1] ** k)


def formula(node, known, like):
    match node:
        case ast.Constant():
            return constant(around(Q(repr(node.value))), like)
        case ast.Name():
            return known[node.id]
        case ast.UnaryOp():
            inner = formula(node.operand, known, like)
            negative = isinstance(node.op, ast.USub)
            return constant((-1.0, -1.0), like) * inner if negative else inner
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=int(k))) if k >= 0:
            base = formula(node.left, known, like)
            return base.through(
                lambda x: power(x, k), lambda x: times((float(k),) * 2, power(x, max(k - 1, 0)))
            )
        case ast.BinOp():
            a, b = (formula(n, known, like) for n in (node.left, node.right))
            if isinstance(node.op, ast.Add):
                return a + b
            if isinstance(node.op, ast.Sub):
                return a + constant((-1.0, -1.0), like) * b
            if isinstance(node.op, ast.Mult):
                return a * b
            if isinstance(node.op, ast.Div):
                demand(b.value[0] > 0 or b.value[1] < 0, "a division by zero")
                return a * b.through(reciprocal, lambda x: opposite(power(reciprocal(x), 2)))
        case ast.Call():
            return formula(node.args[0], known, like).through(*FUNCTIONS[node.func.id])
    raise Refused(f"no interval: {ast.unparse(node)}")


def reciprocal(x):
    return wide(1 / x[1], 1 / x[0])


class Formulas:
    """Combinations of drift and regressor on parts of the box of (e, Y)."""

    def __init__(self, system):
        self.system = system
        texts = [system.plant.get("drift", 0), *system.plant.get("regressor", [])]
        self.nodes = [ast.parse(str(text).strip(), mode="eval").body for text in texts]
        through = [row[: system.q + 1] for row in system.through]
        rows = [[*a, *b] for a, b in zip(system.A_inverse, through, strict=True)]
        self.rows = [[around(v) for v in row] for row in rows]
        self.exact = rows

    def on(self, weights, slope, fixed, middles, halves):
        """weights . (h, phi) - slope x + fixed: its bounds, and what each direction adds."""
        count = len(middles)
        box = [wide(m - h, m + h) for m, h in zip(middles, halves, strict=True)]
        like = Slopes((0.0, 0.0), (0.0, 0.0), [(0.0, 0.0)] * count)
        x = []
        for row in self.rows:
            value = middle = (0.0, 0.0)
            for a, part, m in zip(row, box, middles, strict=True):
                value, middle = plus(value, times(a, part)), plus(middle, times(a, (m, m)))
            x.append(Slopes(value, middle, list(row)))
        known = {name: constant(around(v), like) for name, v in self.system.constants.items()}
        known.setdefault("pi", constant(around(Q(math.pi)), like))
        known |= dict(zip(self.system.plant["states"], x, strict=True))
        total = constant(around(fixed), like)
        for weight, node in zip(weights, self.nodes, strict=True):
            if weight:
                total = total + constant(around(weight), like) * formula(node, known, like)
        for k, state in zip(slope, x, strict=True):
            total = total + constant(around(-k), like) * state
        shares = [times(s, (-h, h)) for s, h in zip(total.slopes, halves, strict=True)]
        spread = total.middle
        for share in shares:
            spread = plus(spread, share)
        low, high = max(total.value[0], spread[0]), min(total.value[1], spread[1])
        return low, high, [share[1] for share in shares]

    def within(self, weights, slope, fixed, box, low, high):
        """Whether it is proven to be in [low, high] for all (e, Y) of the box."""
        middles = [float((a + b) / 2) for a, b in box]
        halves = [
            float((b - a) / 2) * (1 + 1e-14) + 1e-15 * abs(m)
            for (a, b), m in zip(box, middles, strict=True)
        ]
        low, high = around(low)[1], around(high)[0]
        waiting, count = [], 0

        def put(middles, halves):
            least, largest, shares = self.on(weights, slope, fixed, middles, halves)
            miss = max(largest - high, low - least)
            if miss > 0:
                heapq.heappush(waiting, (-miss, count, middles, halves, shares))

        put(middles, halves)
        while waiting:
            count += 1
            demand(count < PARTS, "a range is not shown")
            _, _, middles, halves, shares = heapq.heappop(waiting)
            i = max(range(len(shares)), key=shares.__getitem__)
            half = [h / 2 * (1 + 1e-14) if j == i else h for j, h in enumerate(halves)]
            for sign in (-1, 1):
                put(
                    [m + sign * halves[i] / 2 if j == i else m for j, m in enumerate(middles)], half
                )


# Matrices -----------------------------------------------------------------------------------------


def definite(matrix):
    """Positive definite, by leading minors of integers (Bareiss)."""
    common = math.lcm(*(v.denominator for row in matrix for v in row))
    rows = [[int(v * common) for v in row] for row in matrix]
    before = 1
    for k in range(len(rows)):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            for j in range(k + 1, len(rows)):
                rows[i][j] = (rows[i][j] * rows[k][k] - rows[i][k] * rows[k][j]) // before
        before = rows[k][k]
    return True


def add(a, b, factor=1):
    return [u + factor * v for u, v in zip(a, b, strict=True)]


def scaled(factor, a):
    return [factor * v for v in a]


def dot(a, b):
    return sum((u * v for u, v in zip(a, b, strict=True)), Q(0))


def put_square(form, row, factor):
    """form += factor (row w)^2."""
    used = [(i, v) for i, v in enumerate(row) if v]
    for i, u in used:
        for j, v in used:
            form[i][j] += factor * u * v


def put_product(form, first, second, factor):
    """form += factor (first w) (second w)."""
    for i, u in enumerate(first):
        for j, v in enumerate(second):
            if u and v:
                form[i][j] += factor * u * v / 2
                form[j][i] += factor * u * v / 2


# Stages -------------------------------------------------------------------------------------------


def pair(texts):
    demand(isinstance(texts, list) and len(texts) == 2, "an interval is no pair")
    low, high = map(decimal, texts)
    return low, high


def interval(row, box):
    low = sum((c * (ends[0] if c > 0 else ends[1]) for c, ends in zip(row, box, strict=True)), Q(0))
    high = sum(
        (c * (ends[1] if c > 0 else ends[0]) for c, ends in zip(row, box, strict=True)), Q(0)
    )
    return low, high


class Loop:
    """What does not change from stage to stage."""

    def __init__(self, system, E, P):
        self.system, s = system, P[-1][-1]
        self.n, self.r = system.n, len(system.Gamma)
        self.size = self.n + self.r + 1
        sizes = sorted(map(abs, system.gains))
        self.g0, self.sign = sizes[0], 1 if system.gains[0] > 0 else -1
        self.v1 = root_above(sizes[-1] / sizes[0]) if sizes[-1] > sizes[0] else Q(1)
        self.middle = [(a + b) / 2 for a, b in system.boxes]
        self.radius = [(b - a) / 2 for a, b in system.boxes]
        spread = inverse(P)
        squares = [spread[i][i] for i in range(self.n)]
        squares += [system.Gamma[i][i] / s for i in range(self.r)] + [system.gbar / (self.g0 * s)]
        limits = [root_above(E**2 * v) for v in squares]
        self.box = [(-v, v) for v in limits]
        self.row, self.interval = None, None
        self.formulas = Formulas(system)

    def known(self, row):
        low, high = interval(row, self.box)
        if self.row is None:
            return low, high
        less, more = interval(add(row, self.row, -1), self.box)
        return max(low, self.interval[0] + less), min(high, self.interval[1] + more)

    def stage(self, stage):
        demand(isinstance(stage, dict) and set(stage) == {"region", "functions"}, "other keys")
        demand(isinstance(stage["functions"], list), "functions are no list")
        region = Region(self, stage["region"])
        functions = stage["functions"]
        self.take(region, [claim for f in functions for claim in region.function(f)])

    def take(self, region, claims):
        """What is known behind a stage: of the errors, and of the row of ubar."""
        size = self.size
        box, row = list(self.box), None
        for error, side, bound in claims:
            if error > size:
                continue
            ends = box[error] if error < size else row or self.known(region.row)
            ends = (ends[0], min(ends[1], bound)) if side > 0 else (max(ends[0], -bound), ends[1])
            if error < size:
                box[error] = ends
            else:
                row = ends
        if row is not None:
            self.row, self.interval = region.row, row
        self.box = box


class Region:
    """A stage's box, its ranges, and the forms on it."""

    def __init__(self, loop, record, acting=(), more=None, stands=True):
        system, n, r = loop.system, loop.n, loop.r
        self.acting = [(i, v) for i, v in enumerate(acting) if v]
        self.more = more
        demand(isinstance(record, dict) and set(record) == REGION, "a region has other keys")
        self.loop, self.box = loop, [pair(v) for v in record["box"]]
        self.phi_middle, self.slope = ([decimal(v) for v in record[k]] for k in ("middle", "slope"))
        self.regressor = [pair(v) for v in record["regressor"]]
        self.drift, self.rest, self.ends = (pair(record[k]) for k in ("drift", "remainder", "row"))
        self.reach = [decimal(v) for v in record["reach"]]
        counts = (len(self.box), len(self.phi_middle), len(self.slope), len(self.regressor))
        demand(counts == (loop.size, r, n, r), "a region has another shape")
        demand(len(self.reach) == len(system.a) and min(self.reach, default=1) > 0, "no reach")
        rest = [v - k for v, k in zip(system.nu_x, self.slope, strict=True)]
        self.through_e = product([rest], system.A_inverse)[0]
        self.row = [*self.through_e, *self.phi_middle, Q(0)]
        pairs = [*zip(self.box, loop.box, strict=True), (self.ends, loop.known(self.row))]
        for new, old in pairs if stands else ():
            demand(new[0] < old[0] and new[1] > old[1], "a box does not hold what is known")
        through_y = product([rest], system.through)[0]
        self._ranges(record["regressor"])
        sizes = [abs(a + b) for a, b in zip(through_y, system.nu_Y, strict=True)]
        spread = dot(sizes, system.Y)
        low, high = self.ends[0] - spread - self.rest[1], self.ends[1] + spread - self.rest[0]
        self.ubar = low, high
        self.pi = min(low, low * loop.v1), max(high, high * loop.v1)
        self._forms()

    def _ranges(self, texts):
        loop, system = self.loop, self.loop.system
        place = [*self.box[: loop.n], *((-y, y) for y in system.Y[: system.q + 1])]
        zero, none = Q(0), [Q(0)] * loop.n
        within = loop.formulas.within
        for i, (low, high) in enumerate(self.regressor):
            node = loop.formulas.nodes[i + 1]
            if low == high:
                demand(isinstance(node, ast.Constant) and Q(repr(node.value)) == low, "no constant")
            else:
                weights = [Q(j == i + 1) for j in range(loop.r + 1)]
                within(weights, none, zero, place, low, high)
        within([Q(1)] + [zero] * loop.r, self.slope, zero, place, *self.drift)
        boxes = self.box[loop.n : loop.n + loop.r]
        middles = [(a + b) / 2 for a, b in boxes]
        spread = zero
        for (low, high), m, (a, b), radius in zip(
            self.regressor, self.phi_middle, boxes, loop.radius, strict=True
        ):
            spread += (
                max(abs(low - m), abs(high - m)) * (b - a) / 2 + max(abs(low), abs(high)) * radius
            )
        weights = [Q(1), *(a - b for a, b in zip(loop.middle, middles, strict=True))]
        fixed = dot(self.phi_middle, middles)
        within(weights, self.slope, fixed, place, self.rest[0] + spread, self.rest[1] - spread)
        for limit, selection in zip(self.reach, system.selections, strict=True):
            rows = [product([row], loop.formulas.exact)[0] for row, _ in selection]
            demand(largest_square(rows, place) <= limit**2, "a reach is too small")

    def _forms(self):
        loop, system = self.loop, self.loop.system
        n, r, size = loop.n, loop.r, loop.size
        ranged = [i for i in range(r) if loop.radius[i] > 0]
        varying = [i for i, (low, high) in enumerate(self.regressor) if low != high]
        self.varying = varying
        parts = [size, 1, len(system.a), len(system.b), system.q + 2, 1, len(ranged)]
        parts += [2 if loop.v1 > 1 else 0, 3 * len(varying), len(self.acting)]
        self.width = width = sum(parts)
        unit = [[Q(i == j) for j in range(width)] for i in range(width)]
        groups, at = [], 0
        for count in parts:
            groups.append(unit[at : at + count])
            at += count
        zeta, (one,), a, b, y, (eta,), t, kappa, psi, others = groups
        self.middles = [(low + high) / 2 for low, high in self.box]
        self.halves = [(high - low) / 2 for low, high in self.box]
        z = [
            add(scaled(h, u), one, m)
            for h, u, m in zip(self.halves, zeta, self.middles, strict=True)
        ]
        e, errors, d = z[:n], z[n : n + r], z[-1]
        Y = [scaled(bound, u) for bound, u in zip(system.Y, y, strict=True)]
        nothing = [Q(0)] * width
        self.x = []
        for row, through in zip(system.A_inverse, system.through, strict=True):
            state = nothing
            for v, u in [*zip(row, e, strict=True), *zip(through, Y, strict=True)]:
                state = add(state, u, v)
            self.x.append(state)
        phi_errors, phi_last, phi_one, self.psi = [], [], [], []
        for i, (low, high) in enumerate(self.regressor):
            centre, half = (low + high) / 2, (high - low) / 2
            parts = [scaled(centre, u) for u in (errors[i], e[-1], one)]
            if i in varying:
                first, second, third = psi[3 * len(self.psi) : 3 * len(self.psi) + 3]
                self.psi.append(((one, zeta[n - 1], zeta[n + i]), (first, second, third)))
                parts[0] = add(
                    parts[0],
                    add(scaled(self.middles[n + i], first), third, self.halves[n + i]),
                    half,
                )
                parts[1] = add(
                    parts[1],
                    add(scaled(self.middles[n - 1], first), second, self.halves[n - 1]),
                    half,
                )
                parts[2] = add(parts[2], first, half)
            for group, part in zip((phi_errors, phi_last, phi_one), parts, strict=True):
                group.append(part)
        more = sum(
            (max(map(abs, ends)) * v for ends, v in zip(self.regressor, loop.radius, strict=True)),
            Q(0),
        )
        H = add(scaled(sum(self.drift) / 2, one), eta, (self.drift[1] - self.drift[0]) / 2 + more)
        rates = []
        for i in range(n):
            rate = nothing
            for v, u in zip(system.M[i], e, strict=True):
                rate = add(rate, u, v)
            for column, u, limit in zip(system.a, a, self.reach, strict=True):
                rate = add(rate, u, column[i] * limit)
            for column, u in zip(system.b, b, strict=True):
                rate = add(rate, u, column[i])
            rates.append(add(rate, Y[-1], -system.R[i]))
        for u in phi_errors:
            rates[-1] = add(rates[-1], u)
        drive = []
        for i in range(r):
            off = scaled(loop.middle[i] - system.theta0[i], one)
            if i in ranged:
                off = add(off, t[ranged.index(i)], loop.radius[i])
            drive.append(add(phi_last[i], add(errors[i], off, -1), system.gbar2))
        for row in system.Gamma:
            rate = nothing
            for v, u in zip(row, drive, strict=True):
                rate = add(rate, u, -v)
            rates.append(rate)
        inverse_v, v = one, one
        if kappa:
            v1 = loop.v1
            inverse_v = add(scaled((1 + 1 / v1) / 2, one), kappa[0], (1 - 1 / v1) / 2)
            v = add(
                add(scaled(1 + v1, one), inverse_v, -v1), add(one, kappa[1]), -((v1 - 1) ** 2) / 8
            )
        linear = nothing
        for k, nu, state in zip(self.slope, system.nu_x, self.x, strict=True):
            linear = add(linear, state, nu - k)
        for nu, u in zip(system.nu_Y, Y, strict=True):
            linear = add(linear, u, nu)
        linear = add(linear, H, -1)
        for i in range(r):
            linear = add(add(linear, phi_errors[i]), phi_one[i], -loop.middle[i])
        self.corners = []
        for pi in self.pi:
            last = [*rates[: n - 1], add(rates[n - 1], d, -loop.sign * loop.g0 * pi), *rates[n:]]
            pulled = add(add(d, inverse_v, -loop.sign / Q(loop.g0)), v, system.delta0)
            pulled = add(scaled(loop.sign * pi, e[-1]), pulled, -system.gbar1)
            last.append(scaled(system.gbar, pulled))
            for (i, limit), u in zip(self.acting, others, strict=True):
                last[i] = add(last[i], u, limit)
            F = [scaled(1 / h, u) for h, u in zip(self.halves, last, strict=True)]
            self.corners.append((F, add(linear, inverse_v, -pi)))
        self.first = [*zeta, one]
        self.sectors = list(zeta)
        if any(self.row):
            low, high = self.ends
            line = scaled(-(low + high) / 2, one)
            for v, u in zip(self.row, z, strict=True):
                line = add(line, u, v)
            self.sectors.append(scaled(2 / (high - low), line))

    def function(self, record):
        """The claims of a function that holds: (error, side, bound)."""
        if isinstance(record, dict) and "degree" in record:
            from independent_polynomial import check_polynomial

            return check_polynomial(self, record)
        demand(isinstance(record, dict) and set(record) == FUNCTION, "a function has other keys")
        vectors = {
            key: [decimal(v) for v in record[key]]
            for key in ("squares", "inputs", "sectors", "mu", "scales", "turns")
        }
        alpha, size, width = decimal(record["alpha"]), self.loop.size, self.width
        G = [[decimal(v) for v in row] for row in record["G"]]
        kinds, na = len(self.psi), len(self.loop.system.a)
        counts = [na, width - size - 1, len(self.sectors), width, 6 * kinds, 3 * kinds]
        demand([len(v) for v in vectors.values()] == counts, "multipliers have another number")
        demand(len(G) == size + 1 and all(len(row) == size + 1 for row in G), "G has another shape")
        demand(transposed(G) == G and alpha > 0, "G is not symmetric, or alpha not positive")
        signed = [*vectors["squares"], *vectors["inputs"], *vectors["sectors"]]
        demand(min(signed) >= 0, "a multiplier is negative")
        shared = [[Q(0)] * width for _ in range(width)]
        for i in range(size + 1):
            for j in range(size + 1):
                shared[i][j] = alpha * G[i][j]
        unit = [[Q(i == j) for j in range(width)] for i in range(width)]
        one = self.first[-1]
        for k, (factor, selection) in enumerate(
            zip(vectors["squares"], self.loop.system.selections, strict=True)
        ):
            for row, _ in selection:
                line = [Q(0)] * width
                for v, state in zip(row, self.x, strict=True):
                    line = add(line, state, v / self.reach[k])
                put_square(shared, line, factor)
            put_square(shared, unit[size + 1 + k], -factor)
        for factor, row in [
            *zip(vectors["inputs"], unit[size + 1 :], strict=True),
            *zip(vectors["sectors"], self.sectors, strict=True),
        ]:
            put_square(shared, one, factor)
            put_square(shared, row, -factor)
        for i, (at, scaled_by) in enumerate(self.psi):
            a, b, c, d, e, f = vectors["scales"][6 * i : 6 * i + 6]
            D = [[a, b, d], [b, c, e], [d, e, f]]
            demand(definite(D), "a scale is not positive definite")
            a, b, c = vectors["turns"][3 * i : 3 * i + 3]
            K = [[0, a, b], [-a, 0, c], [-b, -c, 0]]
            for j in range(3):
                for k in range(3):
                    put_product(shared, at[j], at[k], D[j][k])
                    put_product(shared, scaled_by[j], scaled_by[k], -D[j][k])
                    put_product(shared, at[j], scaled_by[k], K[j][k])
        for F, relation in self.corners:
            form = [list(row) for row in shared]
            GF = product([row[:size] for row in G], F)
            for i in range(size + 1):
                put_product(form, unit[i], GF[i], Q(2))
            put_product(form, vectors["mu"], relation, Q(1))
            demand(definite([[-v for v in row] for row in form]), "the inequality does not hold")
        return [self._claim(claim, G) for claim in record["claims"]]

    def _claim(self, claim, G):
        size = self.loop.size
        demand(isinstance(claim, dict) and set(claim) == CLAIM, "a claim has other keys")
        error, side = claim["error"], claim["side"]
        demand(type(error) is int and type(side) is int, "no integers")
        of_more = self.more is not None and error == size + 1
        known = of_more or 0 <= error < len(self.sectors)
        demand(side in (1, -1) and known, "a claim of nothing")
        scale, bound = decimal(claim["scale"]), decimal(claim["bound"])
        demand(scale > 0, "a scale is not positive")
        row = [Q(i == error) for i in range(size)] if error < size else self.row
        row = self.more if of_more else row
        line = [side * v * h for v, h in zip(row, self.halves, strict=True)]
        line.append(side * dot(row, self.middles))
        form = [[scale * v for v in u] for u in G]
        for i, v in enumerate(line):
            form[i][size] -= v / 2
            form[size][i] -= v / 2
        form[size][size] += bound
        demand(definite(form), "the function is below the claim")
        return error, side, bound


def largest_square(rows, box):
    """Of |rows (e, Y)|^2 over a box: it is convex, so at a corner, each with its opposite."""
    best = Q(0)
    count = len(box)
    for corner in range(2**count):
        at = [ends[corner >> i & 1] for i, ends in enumerate(box)]
        best = max(best, sum((dot(row, at) ** 2 for row in rows), Q(0)))
    return best


def check_stages(system, E, P, stages):
    """The bound on limsup |e_1| that the stages prove, and its text's value."""
    loop = Loop(system, E, P)
    sides = {1: [], -1: []}
    for stage in stages:
        loop.stage(stage)
        for function in stage["functions"]:
            for claim in function["claims"]:
                if claim["error"] == 0:
                    sides[claim["side"]].append(decimal(claim["bound"]))
    demand(all(sides.values()), "e_1 is not bounded on both sides")
    return max(min(bounds) for bounds in sides.values())

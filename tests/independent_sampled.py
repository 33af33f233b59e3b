"""The implemented loop of docs/certificate-file.md, checked from that page and numpy alone.

Kernels are summed period by period on a grid of its own, in floats: an estimate, for which the
page leaves room. What it says of an exact proof is whether another reading of the page agrees.
"""

import ast
import itertools
import math
import random
import re
from fractions import Fraction as Q

import independent_checker as checker
import numpy as np
from independent_levels import all_levels, area, bernstein_of_Y, reference_part
from independent_observers import Observer
from independent_slow import Slow

#: Steps of each cell in which kernels are summed, and what is left of rows.
GRID, LEFT = 2, 1e-11


def check(proof, table, system):
    """The largest bound of the entries."""
    drive = table["implementation"]
    delays = drive.get("delay", 0)
    delays = delays if isinstance(delays, list) else [delays]
    groups = [list(group) for _, group in itertools.groupby(proof, lambda e: e["delay"])]
    checker.demand(len(groups) == len(delays), "there is not one entry for each delay")
    bounds = []
    for group, delay in zip(groups, delays, strict=True):
        delay = checker.number(delay, system.constants)
        loops = loops_of(group, table, system, delay)
        bounds += [check_entry(*pair, delay, table, system) for pair in loops]
    return max(bounds)


def loops_of(group, table, system, delay):
    """The entries for one delay, each with its loop."""
    if any("cell" in entry for entry in group):
        from independent_cells import cell_loops

        return cell_loops(group, table, system, delay)
    checker.demand(len(group) == 1, "there is not one entry for each delay")
    checker.demand(not system.plant.get("ranges"), "the loop is not covered")
    return [(group[0], Loop(table, system, delay, group[0]["parts"]))]


def check_entry(entry, loop, delay, table, system):
    """The bound of one entry."""
    drive = table["implementation"]
    checker.demand(Q(entry["delay"]) == delay, "the delay is another")
    X = np.array([float(checker.decimal(v)) for v in entry["states"]])
    checker.demand(len(X) == len(loop.seen), "the states are others")
    U, step, bound = (float(checker.decimal(entry[k])) for k in ("input", "step", "bound"))
    checker.demand((X >= 0).all() and U >= 0, "v is negative")
    rates = np.array([float(checker.decimal(v)) for v in entry.get("rates", [])])
    checker.demand(len(rates) == (loop.n if loop.shift else 0), "other rates")
    if loop.shift:
        checker.demand(2 * loop.shift <= float(delay) * loop.T, "not causal")
        checker.demand((rates >= 0).all() and not entry["starts"] and step >= 0, "jitter")
        loop.mu = loop.mu + loop.shift * rates
    image = loop.image(X, U, step)
    checker.demand("slow" in entry or "split" not in entry, "a split without rates")
    if "slow" in entry:
        slow = Slow(entry, loop, table, system, exponential)
        image[0] = loop.image(X, U, slow=slow, speeds=slow.speeds(X, U))[0]
    if loop.shift:
        checker.demand((image[loop.n + 3 :] < rates).all(), "a rate is not above")
        checker.demand(image[loop.n + 2] < step, "the step is not above")
        image = image[: loop.n + 3]
    checker.demand((image[1:-2] < X).all() and image[-2] < U, "v is not above F(v)")
    checker.demand(bound >= image[0] and step >= image[-1], "a bound is too small")
    loop.check_limits(drive, U, step)
    limited = "saturation" in drive or "rate_limit" in drive or loop.formulas
    kinds = [start["of"] for start in entry["starts"]]
    checker.demand("x0" in kinds or not limited, "nothing is said of the start")
    checker.demand(kinds in ([], ["x0"], ["x0", "polytope"]), "other starts")
    for start in entry["starts"]:
        loop.check_start(start, table, system, (X, U))
    return checker.decimal(entry["bound"])


def exponential(A):
    """e^A, by squaring its Taylor polynomial."""
    halvings = max(0, math.ceil(math.log2(max(np.abs(A).sum(axis=1).max(), 1e-9))) + 4)
    B, total, term = A / 2**halvings, np.eye(len(A)), np.eye(len(A))
    for k in range(1, 15):
        term = term @ B / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def linear(text, names, constants):
    """Slopes and constant of a linear formula."""
    node = ast.parse(str(text).strip(), mode="eval").body

    def at(values):
        return checker.rational(node, constants | dict(zip(names, values, strict=True)))

    zero = [Q(0)] * len(names)
    constant = at(zero)
    slopes = [at([Q(int(i == j)) for j in range(len(names))]) - constant for i in range(len(names))]
    for _ in range(5):
        point = [Q(random.Random(str(_)).randint(-99, 99), 7) for _ in names]
        value = sum((a * x for a, x in zip(slopes, point, strict=True)), constant)
        checker.demand(at(point) == value, "the drift is not linear")
    return slopes, constant


def beginning(reference, q):
    """y_d(0) ... of a sine."""
    match = re.fullmatch(r"([\d.]+)\*sin\(([\d.]+)\*t\)", reference["signal"])
    checker.demand(match is not None, "an unknown reference at t = 0")
    size, frequency = map(float, match.groups())
    return np.array([size * frequency**j * [0, 1, 0, -1][j % 4] for j in range(q + 1)])


class Loop:
    def __init__(self, table, system, delay, parts):
        plant, drive, n, q = table["plant"], table["implementation"], system.n, system.q
        names, constants = plant["states"], system.constants
        checker.demand(not system.adaptive, "the loop is not covered")
        slopes, constant = linear(plant.get("drift", 0), names, constants)
        for phi, theta in zip(
            plant.get("regressor", []), system.numbers(plant.get("theta", [])), strict=True
        ):
            more, offset = linear(phi, names, constants)
            slopes = [a + theta * b for a, b in zip(slopes, more, strict=True)]
            constant += theta * offset
        gain = checker.number(plant["input_gain"], constants)
        g = system.numbers(plant.get("chain", []))
        rows = plant.get("linear", [[0] * (i + 1) for i in range(n - 1)])
        b = [system.numbers(row) for row in rows]
        A = [[*b[i], g[i], *[Q(0)] * (n - 2 - i)] for i in range(n - 1)] + [slopes]
        K = [(v - h) / gain for v, h in zip(system.nu_x, slopes, strict=True)]
        self.constant = float(-constant / gain)
        self.T, self.n, self.q = float(checker.number(drive["period"], constants)), n, q
        self.A, self.b = np.array(A, float), np.array([0.0] * (n - 1) + [float(gain)])
        self.seen = [(row, 0.0) for row in np.eye(n)]  # the states; for ranges the channels too
        self.desired = np.array([row[: q + 1] for row in system.through], float)
        self._uncertainty(plant, system)
        self._reference(table["reference"], system)
        quanta = system.numbers(drive.get("measurement_quantum", [0] * n))
        noise = system.numbers(drive.get("noise_bound", [0] * n))
        checker.demand("noise_bound" in drive or not any(drive.get("noise", [])), "noise")
        self.mu = np.array([float(a / 2 + c) for a, c in zip(quanta, noise, strict=True)])
        self.eta = float(checker.number(drive.get("input_quantum", 0), constants)) / 2
        self.shift = float(checker.number(drive.get("jitter", 0), constants)) * self.T
        law = table["law"]
        checker.demand("integral" not in law, "integral action is not covered here")
        self.forward = np.array([float(v / gain) for v in system.nu_Y])

        def built():
            self._controller(drive, names, g, b, np.array(K, float), law)
            self._period(counted, [1, 1])
            return self.Pi[-1][0]

        if law.get("sampled_feedforward"):
            delays = drive.get("delay", 0)
            counted = drive.get("counted_delay", delays[0] if isinstance(delays, list) else delays)
            counted = checker.number(counted, constants)
            own, columns = self.forward.copy(), []
            self.forward = own * ([0] * (q + 1) + [1])
            base = built()
            for j in range(q + 1):
                self.forward = np.eye(q + 2)[j] + own * ([0] * (q + 1) + [1])
                columns.append(built() - base)
            wanted = np.linalg.solve(np.array(columns).T, np.eye(q + 1)[0] - base)
            self.forward = np.array([*(float(f"{v * float(gain):.13g}") for v in wanted), own[-1]])
            self.forward[:-1] /= float(gain)
        self._controller(drive, names, g, b, np.array(K, float), law)
        self._period(delay, parts)

    def _uncertainty(self, plant, system):
        u, n = plant.get("uncertainty", {}), self.n
        tau, gamma, beta = (
            np.array(system.numbers(u.get(k, [0] * n)), float) for k in ("tau", "gamma", "beta")
        )
        S = u.get("S", [1] * n)
        S = S if isinstance(S[0], list) else [S] * n
        self.W, self.gamma, self.beta = np.diag(tau), gamma, beta
        self.S = np.array([system.numbers(row) for row in S], float)
        Delta = u.get("Delta", [[0] * n] * n)
        self.Delta = np.array([system.numbers(row) for row in Delta], float)
        self.formulas = {k: f for k, f in enumerate(u.get("bound", [])) if f != ""}
        self.names, self.constants = [*plant["states"], "norm"], system.constants
        for k, formula in self.formulas.items():
            checker.demand(not (gamma[k] or beta[k] or self.Delta[k].any()), "two bounds")
            self.formulas[k] = ast.parse(str(formula), mode="eval").body
        self._refuse_falling()

    def _refuse_falling(self):
        """A bound must not fall where a size grows: at random points it does not."""
        draw = random.Random("sizes")
        for k in self.formulas:
            for _ in range(50):
                low = np.array([draw.uniform(0, 9) for _ in range(self.n)])
                high = low + [draw.uniform(0, 9) for _ in range(self.n)]
                falls = self.size(low)[k] > self.size(high)[k] or self.size(low)[k] < 0
                checker.demand(not falls, "a bound falls")

    def _reference(self, table, system):
        self.Y = np.array(system.Y, float)
        if table.get("kind") in ("triangle", "trapezoid"):
            checker.demand(table["kind"] == "triangle" and self.q == 0, "an unknown reference")
            self.slope, self.jump = 0.0, 2 * self.Y[1]
            self.apart = float(checker.number(table["period"], system.constants)) / 2
            return
        bounds = checker.reference_bounds(table, self.q + 2, system.constants)
        checker.demand(bounds is not None and len(bounds) > self.q + 2, "an unknown reference")
        self.slope, self.jump, self.apart = float(bounds[-1]), 0.0, math.inf

    def _controller(self, drive, names, g, b, K, law):
        """u and the next memories over (m, memories), and over Y'; the first memories."""
        n, T, y = self.n, self.T, self.q + 2
        table = law.get("observer")
        delays = drive.get("delay", 0)
        delay = drive.get("counted_delay", delays[0] if isinstance(delays, list) else delays)
        o = table and Observer(
            table, drive, names, self.A, self.b, T, exponential, checker.number(delay, {})
        )
        unread = [i for i in range(1, n) if names[i] in drive.get("velocity", [])]
        computed = unread if o is None or o.L is None else []
        filter_time = float(drive.get("velocity_filter", 0))
        pole = 1 - math.exp(-T / filter_time) if filter_time else 1.0
        count = 2 * len(computed)
        if o:
            count += len(o.predicted) + len(o.rows) + o.kept
        signals = np.eye(n + count + y)
        x, after, memories = list(signals[:n]), [], iter(signals[n : n + count])
        for i in computed:
            p, v = next(memories), next(memories)
            f = v + pole * ((x[i - 1] - p) / T - v)
            after += [x[i - 1], f]
            others = sum((float(c) * x[j] for j, c in enumerate(b[i - 1])), 0 * f)
            x[i] = (f - others) / float(g[i - 1])
        still = list(np.eye(n))
        for i in unread:
            others = sum((float(c) * still[j] for j, c in enumerate(b[i - 1])), np.zeros(n))
            still[i] = -others / float(g[i - 1])
        self.first = [row for i in computed for row in (still[i - 1], np.zeros(n))]
        self.first_u = [0.0] * len(self.first)
        x, added = np.array(x), 0.0
        if o:
            expected = np.array([next(memories) for _ in o.predicted])
            d = np.array([next(memories) for _ in o.rows]).reshape(len(o.rows), len(signals))
            past = [next(memories) for _ in range(o.kept)]
            miss = x[o.seen] - expected[[o.predicted.index(i) for i in o.seen]]
            if o.L is not None:
                x = expected + o.L @ miss
            d = d + o.Ld @ miss
            given, added = x - o.P @ d, o.U @ d
        else:
            given = x
        forward = self.forward @ signals[n + count :]
        command = K @ given + added + forward
        if o:
            inputs = [command, *past]
            moved = o.F @ x + o.G @ d + np.outer(o.new, inputs[o.late])
            if o.kept > o.late:
                moved += np.outer(o.old, inputs[o.late + 1])
            after += [*moved[o.predicted], *d, *inputs[: o.kept]]
            self.first += [still[i] for i in o.predicted] + [np.zeros(n)] * len(d)
            self.first += [np.zeros(n)] * o.kept
            self.first_u = [0.0] * (len(self.first) - o.kept) + [1.0] * o.kept
        after = np.array(after).reshape(len(after), len(signals))
        self.command, self.after = command[: n + count], after[:, : n + count]
        self.after_Y = after[:, n + count :]

    def _period(self, delay, parts):
        n, memories = self.n, len(self.after)
        late, part = math.floor(delay), float(delay - math.floor(delay))
        self.windows = 2 if min(part, 1 - part) * self.T < self.shift else 1
        self.newest, size = n + memories, n + memories + late + 2
        J = np.zeros((size, size))
        J[:n, :n] = np.eye(n)
        J[n : self.newest, : self.newest] = self.after
        J[self.newest, : self.newest] = self.command
        for i in range(self.newest + 1, size):
            J[i, i - 1] = 1
        self.J, self.R = J, np.zeros((size, self.q + 2))
        self.R[self.newest] = self.forward
        self.R[n : self.newest] = self.after_Y
        self.N = J[:, :n].copy()
        self.N[:n] = 0
        self.cells = []
        for length, count, acting in (
            (part * self.T, parts[0], self.newest + late + 1),
            ((1 - part) * self.T, parts[1], self.newest + late),
        ):
            if length:
                self.cells += [self._cell(length / count / GRID, acting, size)] * count * GRID
        self._motion()

    def _cell(self, h, acting, size):
        n = self.n
        block = np.zeros((n + 1, n + 1))
        block[:n, :n], block[:n, n] = self.A * h, self.b * h
        over, E = exponential(block), np.eye(size)
        E[:n, :n] = over[:n, :n]
        E[:n, acting] = over[:n, n]
        return h, acting, E

    def _shift(self, t):
        orders = range(self.q + 1)
        return np.array(
            [
                [t ** (j - i) / math.factorial(j - i) if j >= i else 0.0 for j in orders]
                for i in orders
            ]
        )

    def _motion(self):
        through = np.eye(len(self.J))
        for _, _, E in self.cells:
            through = E @ through
        M, forced = through @ self.J, through @ self.R[:, :-1]
        Phi, columns = self._shift(self.T), []
        for j in range(self.q + 1):
            right = forced[:, j] - sum(columns[k] * Phi[k, j] for k in range(j))
            columns.append(np.linalg.solve(np.eye(len(M)) - M, right))
        self.Pi = [self.J @ np.array(columns).T + self.R[:, :-1]]
        for h, _, E in self.cells:
            self.Pi.append(E @ self.Pi[-1] @ self._shift(-h))

    def image(self, X, U, step=0.0, moving=False, slow=None, speeds=None):
        """F: e_1, the states, u, its steps; with jitter, or `moving`, the rates of the states."""
        w, levels = self.size(X), all_levels(self)
        moving = self.n if self.shift or moving else 0
        largest = np.zeros(len(self.seen) + 3 + moving)
        for p in range(0, len(self.cells), GRID):
            rows, values, owners, of_Y = [], [], [], []
            growth = exponential(np.abs(self.A) * self.cells[p][0] * GRID)
            for i in range(moving):
                none = np.zeros(self.q + 1)
                more, value = self._rows(p, (self.A[i], self.b[i]), none, 2, w, X, U)
                value = value + abs(self.W[i]) @ w + abs(self.b[i]) * step
                at_most = self.windows * self.shift * step
                value = value + at_most * growth[i] @ abs(self.A @ self.b)
                rows, values = [*rows, more], [*values, value]
                of_Y.append(bernstein_of_Y(self, p, none, 2))
                owners += [self.n + 3 + i] * len(more)
            for output, (seen, of_y, N) in enumerate(self.outputs()):
                more, value = self._rows(p, seen, of_y, N, w, X, U)
                if self.shift:
                    at_most = self.windows * self.shift * step
                    value = value + at_most * growth[max(output - 1, 0)] @ abs(self.b)
                rows, values = [*rows, more], [*values, value]
                of_Y.append(bernstein_of_Y(self, p, of_y, N))
                owners += [output] * len(more)
            if p == 0:
                newest, older = np.eye(len(self.J))[self.newest : self.newest + 2]
                commands = np.array([newest, newest - older])
                rows.append(commands)
                values.append(np.abs(commands @ self.Pi[0]) @ self.Y[:-1])
                of_Y.append(np.zeros((2, self.q + 1)))
                owners += [len(self.seen) + 1, len(self.seen) + 2]
            rows, of_Y = np.vstack(rows), np.vstack(of_Y)
            total = np.concatenate(values) + self._responses(rows, p, w, step)
            parts = [reference_part(self, level, rows, of_Y, p // GRID) for level in levels]
            total += np.min(parts, axis=0) - parts[-1]
            if slow:
                of_e = np.array(owners) == 0
                total[of_e] -= slow.savings(rows[of_e], p, w, speeds)
            np.maximum.at(largest, owners, total)
        return largest

    def outputs(self):
        """e_1, and what is seen; with the degrees of their polynomials."""
        of_y = np.eye(self.q + 1)[0]
        return [(self.seen[0], of_y, max(3, self.q)), *((s, 0 * of_y, 2) for s in self.seen)]

    def _rows(self, p, seen, of_y, N, w, X, U):
        """Bernstein rows of an output in a cell, and all of their bound but the gains."""
        c, of_u = seen
        step, acting, _ = self.cells[p]
        h, rows, of_Y, derivatives = step * GRID, [], [], [c]
        for _ in range(N + 30):
            derivatives.append(derivatives[-1] @ self.A)
        for k in range(N + 1):
            row = np.zeros(len(self.J))
            row[: self.n] = derivatives[k]
            row[acting] = derivatives[k - 1] @ self.b if k else of_u
            rows.append(row)
            of_Y.append(np.concatenate([np.zeros(k), of_y])[: self.q + 1])
        change = [
            [math.comb(i, k) / math.comb(N, k) * h**k / math.factorial(k) for k in range(N + 1)]
            for i in range(N + 1)
        ]
        rows, of_Y = np.array(change) @ np.array(rows), np.array(change) @ np.array(of_Y)
        still = np.abs(rows @ self.Pi[p] - of_Y) @ self.Y[:-1]
        share = np.arange(N + 1) / N
        return rows, still + share * self._in_cell(h, derivatives, of_y, N, w, X, U)

    def _in_cell(self, h, derivatives, of_y, N, w, X, U):
        total = sum(
            np.abs(d @ self.W) @ w * h ** (k + 1) / math.factorial(k + 1)
            for k, d in enumerate(derivatives)
        )
        total += sum(
            abs(v) * h ** (self.q - j + 1) / math.factorial(self.q - j + 1) * self.Y[-1]
            for j, v in enumerate(of_y)
        )
        growth = np.abs(derivatives[N + 1]) @ exponential(np.abs(self.A) * h)
        rest = (
            growth @ X[: self.n]
            + abs(derivatives[N] @ self.b) * U
            + h * growth @ np.abs(self.b) * U
        )
        return total + rest * h ** (N + 1) / math.factorial(N + 1)

    def _responses(self, rows, phase, w, step=0.0):
        """The gains of rows at the beginning of a cell times the bounds of the inputs."""
        total = np.zeros(len(rows))
        largest, since, group = np.zeros(len(rows)), 0, math.inf
        if self.jump:
            group = math.floor(self.apart / self.T)
        for first, of_w, others, sampled, _, pulse in self._periods(rows, phase):
            total += of_w @ w + others + self.windows * self.shift * step * pulse
            if not first:
                largest, since = np.maximum(largest, sampled), since + 1
                if since == group:
                    total += largest * self.jump
                    largest, since = 0 * largest, 0
        return total + largest * self.jump

    def _periods(self, rows, phase):
        """Period by period backwards, the running one first: the gains of w, the parts of the
        other inputs, the magnitude of the sample's row, and the rows before the jump."""
        q, n = self.q, self.n
        first, last = True, self.R[:, -1]
        start = np.abs(rows).max()
        for _ in range(10**6):
            below, kernels = rows, []
            of_w, others = np.zeros((len(rows), self.W.shape[1])), np.zeros(len(rows))
            pulse = np.zeros(len(rows))
            for p in range(phase - 1, -1, -1):
                h, _, E = self.cells[p]
                before = below @ E
                of_w += h * area(below[:, :n] @ self.W, before[:, :n] @ self.W)
                tip = np.array([h ** (q - j) / math.factorial(q - j) for j in range(q + 1)])
                for row in (below, before):
                    pulse = np.maximum(pulse, np.abs(row[:, :n] @ self.b))
                motion = below @ self.Pi[p + 1]
                kernels.append((h, -motion[:, -1], -motion @ tip))
                below = before
            sampled = below @ last
            spread = 0 * sampled if first else sampled / self.T
            for h, new, old in kernels:
                others += h * area(new + spread, old + spread) * self.Y[-1]
            others += np.abs(below @ self.N) @ self.mu + np.abs(below[:, self.newest]) * self.eta
            others += np.abs(sampled) * (self.Y[-1] if first else self.T / 2 * self.slope)
            rows = below @ self.J
            yield first, of_w, others, np.abs(sampled), rows, pulse
            if np.abs(rows).max() < LEFT * start:
                return
            phase, first = len(self.cells), False
            checker.demand(np.abs(rows).max() < 1e12 * start, "the loop is unstable")
        raise checker.Refused("the loop does not forget")

    # From a start on ----------------------------------------------------------------------------

    def check_start(self, entry, table, system, claimed):
        """The claims of a proof of runs from a start."""
        K, middle = 2 ** entry["doublings"], entry["middle"]
        checker.demand(not self.jump, "jumps are not covered here")
        drive = table["implementation"]
        checker.demand(not drive.get("offset"), "the first sample is late")
        low, high = [system.numbers(table["simulation"]["x0"])] * 2
        if entry["of"] == "polytope":
            low, high = zip(*[map(checker.decimal, pair) for pair in entry["region"]], strict=True)
        low, high = np.array(low, float), np.array(high, float)
        Y0 = beginning(table["reference"], self.q) if entry["phase"] == "file" else None
        first = float(checker.number(drive.get("initial_input", 0), system.constants))
        parts = self._start_parts((low + high) / 2, (high - low) / 2, Y0, first - self.constant)
        X_t = np.array([float(checker.decimal(v)) for v in entry["states"]])
        U_t = float(checker.decimal(entry["input"]))
        m = len(self.seen)
        history, peaks, U = [], np.zeros(m + 3), abs(first - self.constant)
        outputs = []
        for k in range(K):
            X = outputs[-1][1:-2] if outputs else np.zeros(m)
            for _ in range(60):
                sizes = [*history, self.size(X)]
                now = self._start_image(parts, k, sizes, X, U)
                U = max(U, now[-2])
                if np.allclose(now[1:-2], X, rtol=1e-12, atol=0):
                    break
                X = now[1:-2]
                checker.demand((X < 1e50).all(), "the states have no bound")
            history.append(self.size(X))
            outputs.append(now)
            peaks = np.maximum(peaks, now)
        checker.demand((X_t >= 0).all() and U_t >= 0, "X_t is negative")
        recent = np.maximum(np.max([o[1:-2] for o in outputs[middle:]], axis=0), X_t)
        ever = np.maximum(np.max([o[1:-2] for o in outputs], axis=0), X_t)
        late = [self.size(ever)] * middle + [self.size(recent)] * (K - middle)
        image = self._start_image(parts, K, [*late, self.size(X_t)], X_t, max(U, U_t), ever=True)
        checker.demand((image[1:-2] < X_t).all() and image[-2] < U_t, "X_t is not above")
        image[1:-1] = [*X_t, U_t]
        claimed = np.array([float(checker.decimal(v)) for v in entry["peaks"]])
        checker.demand((claimed >= np.maximum(peaks, image)).all(), "a peak is too small")
        if self.formulas:
            self.check_long_run(parts, X_t, U_t, claimed)
        size, step = (image if entry["of"] == "polytope" else claimed)[-2:]
        self.check_limits(drive, size, step)

    def size(self, X):
        norm = np.linalg.norm(self.S * X, axis=1)
        sizes = self.gamma * norm + self.Delta @ X + self.beta
        for k, formula in self.formulas.items():
            values = [Q(float(v)) for v in (*X, norm[k])]
            known = self.constants | dict(zip(self.names, values, strict=True))
            sizes[k] = float(checker.rational(formula, known))
        return sizes

    def check_long_run(self, parts, X_t, U_t, claimed):
        """From X_t, F leads down to what is claimed of the long run."""
        X, U = X_t, U_t
        for _ in range(2000):
            if (claimed[0] >= X).all() and claimed[1] >= U:
                return
            now = self._start_image(parts, 10**9, [self.size(X)], X, U, ever=True)
            X, U = np.minimum(X, now[1:-2]), min(U, now[-2])
        raise checker.Refused("the long run is not reached")

    def _start_parts(self, center, half, Y0, first):
        """Of each phase: rows' owners, what of them is constant, in a cell, and of every lag."""
        n, size = self.n, len(self.J)
        eye, m = np.eye(n), len(self.seen)
        unit_w = np.eye(self.W.shape[1])
        zero, of_x = np.zeros(m), np.eye(m)
        Z, parts = self._first_memories(), []
        at = np.vstack([eye, Z, np.zeros((size - self.newest, n))])
        noise = np.vstack([0 * eye, Z, np.zeros((size - self.newest, n))])
        zeta = at @ center
        zeta[self.newest :] = first
        zeta[n : self.newest] += first * np.array(self.first_u)
        last = self.Pi[-1]
        if Y0 is not None:
            zeta = zeta - last @ Y0
        for p in range(0, len(self.cells), GRID):
            rows, owners, still, near = [], [], [], []
            for output, (c, of_Y, N) in enumerate(self.outputs()):
                more, base = self._rows(p, c, of_Y, N, 0 * unit_w[0], zero, 0.0)
                units = [self._rows(p, c, of_Y, N, e, zero, 0.0)[1] - base for e in unit_w]
                units += [self._rows(p, c, of_Y, N, 0 * unit_w[0], e, 0.0)[1] - base for e in of_x]
                units += [self._rows(p, c, of_Y, N, 0 * unit_w[0], zero, 1.0)[1] - base]
                rows, still, near = [*rows, more], [*still, base], [*near, np.array(units).T]
                owners += [output] * len(more)
            if p == 0:
                newest, older = np.eye(size)[self.newest : self.newest + 2]
                commands = np.array([newest, newest - older])
                rows.append(commands)
                still.append(np.abs(commands @ self.Pi[0]) @ self.Y[:-1])
                near.append(np.zeros((2, len(unit_w) + m + 1)))
                owners += [m + 1, m + 2]
            lags, transient = [], []
            for _, of_w, others, _, before, _ in self._periods(np.vstack(rows), p):
                lags.append((of_w, others))
                moved = np.abs(before @ zeta) + np.abs(before @ at) @ half
                moved += np.abs(before @ noise) @ self.mu
                if Y0 is None:
                    moved += np.abs(before @ last) @ self.Y[:-1]
                transient.append(moved)
            of_w = np.array([lag[0] for lag in lags]).swapaxes(0, 1)
            others = np.cumsum([lag[1] for lag in lags], axis=0)
            parts.append((owners, np.concatenate(still), np.vstack(near), of_w, others, transient))
        return parts

    def _start_image(self, parts, k, sizes, X, U, ever=False):
        """Bounds of all outputs in period k, or in all from k on."""
        largest = np.zeros(len(self.seen) + 3)
        for owners, still, near, of_w, others, transient in parts:
            total = still + near @ np.concatenate([sizes[-1], X, [U]])
            later = transient[k:] or [0 * still]
            total += np.max(later, axis=0) if ever else later[0]
            count = len(others) if ever else min(k + 1, len(others))
            newest = np.array(sizes[::-1][:count])
            newest = np.vstack([newest, np.tile(sizes[0], (count - len(newest), 1))])
            total += others[count - 1] + np.tensordot(of_w[:, :count], newest, 2)
            np.maximum.at(largest, owners, total)
        return largest

    def _first_memories(self):
        """The memories at the first sample over what it measures: nothing is missed."""
        return np.array(self.first).reshape(len(self.after), self.n)

    def check_limits(self, drive, U, step):
        if "saturation" in drive:
            low, high = map(float, drive["saturation"])
            inside = low <= self.constant - U and self.constant + U <= high
            checker.demand(inside, "the input may stay at its limits")
        if "rate_limit" in drive:
            checker.demand(step <= float(drive["rate_limit"]) * self.T, "so may its rate")

"""Bounds of rates in the implemented loop of docs/certificate-file.md, from that page and numpy."""

import copy
import math

import independent_checker as checker
import numpy as np
from independent_levels import area


class Slow:
    """What the file says of the speed of its uncertain terms, and a z for each."""

    def __init__(self, entry, loop, table, system, exponential):
        self.loop, self.entry, self.exponential = loop, entry, exponential
        u, law = table["plant"]["uncertainty"], table["law"]
        estimated = law.get("observer", {}).get("kind") in ("eso", "dob")
        checker.demand(estimated or "integral" in law, "nothing estimates what acts")
        checker.demand("cell" not in entry and not loop.shift, "rates with ranges or jitter")
        self.known = checker.known_rates(u)
        checker.demand(len(entry["slow"]) == len(self.known), "other terms have rates")
        zero = [0] * loop.n
        number = lambda name, k: float(system.numbers(u.get(name, zero))[k])  # noqa: E731
        self.rate = {k: float(checker.number(u["rate"][k], system.constants)) for k in self.known}
        self.jump = {k: number("jump", k) for k in self.known}
        self.fast = {k: number("fast", k) for k in self.known}
        checker.demand(all(self.fast[k] <= loop.beta[k] for k in self.known), "fast is too large")
        self.dwell = float(checker.number(u.get("dwell", 0), system.constants))
        Delta = u.get("Delta_rate", [zero] * loop.n)
        self.by_states = {k: np.array(system.numbers(Delta[k]), float) for k in self.known}

    def speeds(self, X, U):
        """Bounds of |s_k'|."""
        self.apart = self._apart(X, U) if "split" in self.entry else {}
        if not any(row.any() for row in self.by_states.values()):
            return self.rate
        rates = self.loop.image(X, U, moving=True)[self.loop.n + 3 :]
        return {k: self.rate[k] + self.by_states[k] @ rates for k in self.known}

    def _apart(self, X, U):
        """w_k = s_k(t, x_s) + rest: bounds of the first, of its rate and of the rest."""
        loop, split = self.loop, self.entry["split"]
        functions = [k for k in self.known if self.by_states[k].any() and not self.jump[k]]
        checker.demand(functions and not loop.formulas, "nothing is a function of the states")
        checker.demand([len(part) for part in split] == [loop.n + 1] * 2, "other parts")
        v_s, v_f = (np.array([float(checker.decimal(v)) for v in part]) for part in split)
        checker.demand((v_s >= 0).all() and (v_f >= 0).all(), "a part is negative")
        slow, fast = copy.copy(loop), copy.copy(loop)
        slow.mu, slow.eta = 0 * loop.mu, 0.0
        fast.Y, fast.slope, fast.jump = 0 * loop.Y, 0.0, 0.0

        def of_slow(x):
            size = np.zeros(loop.n)
            for k in self.known:
                size[k] = loop.size(x if k in functions else X)[k] - self.fast[k]
            return size

        def of_fast(x):
            size, both = loop.size(X), of_slow(v_s[:-1])
            for k in self.known:
                moved = self.fast[k] + self.by_states[k] @ x
                size[k] = min(moved, size[k] + both[k]) if k in functions else self.fast[k]
            return size

        slow.size, fast.size = of_slow, of_fast
        images = [part.image(v[:-1], v[-1], moving=True) for part, v in ((slow, v_s), (fast, v_f))]
        for image, v in zip(images, (v_s, v_f), strict=True):
            checker.demand((image[1 : loop.n + 2] < v).all(), "a part is not above F of it")
        rates, size, rest = images[0][loop.n + 3 :], of_slow(v_s[:-1]), of_fast(v_f[:-1])
        return {k: (size[k], self.rate[k] + self.by_states[k] @ rates, rest[k]) for k in functions}

    def savings(self, rows, phase, w, speeds):
        """What rows of e_1 lose: of each w the plain part or that by steps counts."""
        kernels, spent = self._measures(rows, phase)
        total = np.zeros(len(rows))
        for k in self.known:
            tv, area, jumps = spent[k]
            slow = (w[k] - self.fast[k]) * tv + speeds[k] * area + self.jump[k] * jumps
            slow = slow + self.fast[k] * kernels[:, k]
            if k in self.apart:
                size, speed, rest = self.apart[k]
                slow = np.minimum(slow, size * tv + speed * area + rest * kernels[:, k])
            total += np.maximum(kernels[:, k] * w[k] - slow, 0)
        return total

    def _measures(self, rows, phase):
        """int |k| of all terms; TV(z), int |g - z| and the jumps' sums of those with rates."""
        loop, W = self.loop, self.loop.W
        kernels = np.zeros((len(rows), W.shape[1]))
        g = np.zeros((len(rows), W.shape[1]))
        z = {k: {int(m): float(v) for m, v in s} for k, s in self._z()}
        value = {k: z[k][0] for k in self.known}
        tv = {k: abs(value[k]) for k in self.known}
        spent = {k: np.zeros(len(rows)) for k in self.known}
        apart = math.floor(self.dwell / loop.T) if self.dwell else 0
        checker.demand(apart or not any(self.jump.values()), "jumps in every period")
        jumps = {k: [np.zeros(len(rows))] * (apart + 1) for k in self.known}  # up to each period
        halves = {}
        until, start = 2 ** self.entry["doublings"], np.abs(rows).max()
        for m in range(10**6):
            for k in self.known:
                if m in z[k] and m:
                    tv[k] += abs(z[k][m] - value[k])
                    value[k] = z[k][m]
            most = {k: np.zeros(len(rows)) for k in self.known}
            for p in range(phase - 1, -1, -1):
                h, _, E = loop.cells[p]
                before = rows @ E
                a, b = rows[:, : loop.n] @ W, before[:, : loop.n] @ W
                half = halves.setdefault(h, self.exponential(loop.A * h / 2)) @ W
                middle = rows[:, : loop.n] @ half
                kernels += h * (area(a, middle) + area(middle, b)) / 2
                if m <= until:
                    after = g + h * (a + 4 * middle + b) / 6
                    for k in self.known:
                        gap, old = g[:, k] - value[k], after[:, k] - value[k]
                        spent[k] += h * area(gap, old)
                        most[k] = np.maximum(most[k], np.maximum(abs(gap), abs(old)))
                    g = after
                rows = before
            if m == until:
                for k in self.known:
                    tv[k] = tv[k] + abs(g[:, k] - value[k]) - kernels[:, k]
            if apart and m <= until:
                for k in self.known:
                    jumps[k].append(np.maximum(jumps[k][-1], most[k] + jumps[k][-apart]))
            rows = rows @ loop.J
            phase = len(loop.cells)
            if m >= until and np.abs(rows).max() < 1e-11 * start:
                break
        for k in self.known:
            tv[k] = tv[k] + kernels[:, k]
        return kernels, {k: (tv[k], spent[k], jumps[k][-1]) for k in self.known}

    def _z(self):
        for k, steps in zip(self.known, self.entry["slow"], strict=True):
            first = [m for m, _ in steps]
            checker.demand(all(type(m) is int for m in first), "a period is no integer")
            checker.demand(first[:1] == [0] and first == sorted(set(first)), "z is out of order")
            checker.demand(first[-1] <= 2 ** self.entry["doublings"], "z ends too late")
            yield k, [(m, checker.decimal(v)) for m, v in steps]

"""A checker of certificate files, written from docs/certificate-file.md and fractions alone.

It shares nothing with certrack: no import, no number type, no factorisation, no bound of a
reference. ``python tests/independent_checker.py cert.json`` prints what holds, or what does not.

Two things the page leaves to the checker are done here like this. Y_i of step 2 is this file's own
bound of y_d^(i) for signals that it knows (sums and products of sines and cosines of t, triangles,
trapezoids); for others the caller states them. Intervals of step 10 have rational ends.
"""

import ast
import hashlib
import itertools
import json
import math
import sys
import tomllib
from collections import defaultdict
from fractions import Fraction as Q
from functools import partial

FORMATS = {"certrack-certificate/1": "assumptions", "certrack-certificate/2": "premises"}
STAGE = {"alpha", "P", "lam", "nu", "k", "bound", "shift"}
STATUSES = {"proven", "checked", "assumed", "contradicted"}
RECORD = {"name", "status", "detail", "witness", "remedy"}


class Refused(Exception):
    """What does not hold."""


def demand(condition, what):
    if not condition:
        raise Refused(what)


# Numbers and formulas -----------------------------------------------------------------------------

IRRATIONAL = {"pi": math.pi, "e": math.e}


def number(value, constants):
    """A number of the system file: its decimal text, or a formula of the constants."""
    if isinstance(value, str):
        return rational(ast.parse(value.strip(), mode="eval").body, constants)
    return Q(repr(value)) if isinstance(value, float) else Q(value)


def rational(node, constants):
    match node:
        case ast.Constant():
            return Q(repr(node.value))
        case ast.Name():
            return constants[node.id] if node.id in constants else Q(repr(IRRATIONAL[node.id]))
        case ast.UnaryOp():
            inner = rational(node.operand, constants)
            return -inner if isinstance(node.op, ast.USub) else inner
        case ast.BinOp(op=ast.Pow()):
            base, power = (rational(n, constants) for n in (node.left, node.right))
            if power.denominator == 1:
                return base ** int(power)
            return Q(repr(float(base) ** float(power)))
        case ast.BinOp():
            a, b = (rational(n, constants) for n in (node.left, node.right))
            return binary(node.op, a, b)
        case ast.Call():
            parts = [float(rational(n, constants)) for n in node.args]
            return Q(repr(getattr(math, node.func.id)(*parts)))
    raise Refused(f"no number: {ast.unparse(node)}")


def binary(op, a, b):
    match op:
        case ast.Add():
            return a + b
        case ast.Sub():
            return a - b
        case ast.Mult():
            return a * b
        case ast.Div():
            return a / b
    raise Refused("an unknown operation")


# Matrices: lists of rows --------------------------------------------------------------------------


def zeros(rows, columns):
    return [[Q(0)] * columns for _ in range(rows)]


def product(a, b):
    return [[sum((u * v for u, v in zip(row, col)), Q(0)) for col in zip(*b)] for row in a]  # noqa: B905


def transposed(a):
    return [list(row) for row in zip(*a, strict=True)]


def inverse(a):
    n = len(a)
    rows = [list(row) + [Q(i == j) for j in range(n)] for i, row in enumerate(a)]
    for i in range(n):
        pivot = next((k for k in range(i, n) if rows[k][i] != 0), None)
        demand(pivot is not None, "a matrix is singular")
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [v / rows[i][i] for v in rows[i]]
        for k in range(n):
            if k != i and rows[k][i] != 0:
                factor = rows[k][i]
                rows[k] = [u - factor * v for u, v in zip(rows[k], rows[i], strict=True)]
    return [row[n:] for row in rows]


def positive_definite(a):
    """By the signs of the leading minors, from elimination without division by columns."""
    rows = [list(row) for row in a]
    for k in range(len(rows)):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            if factor:
                rows[i] = [u - factor * v for u, v in zip(rows[i], rows[k], strict=True)]
    return True


def form(v, a):
    return sum((v[i] * a[i][j] * v[j] for i in range(len(v)) for j in range(len(v))), Q(0))


def root_above(square):
    """A rational not below the square root, to 40 digits."""
    scale = 10**40
    return Q(math.isqrt(square.numerator * scale**2 // square.denominator) + 1, scale)


# Step 2: bounds of the reference ------------------------------------------------------------------


def reference_bounds(table, order, constants):
    """Y_0 ... Y_order, or None for a signal that this file does not know."""
    if "bounds" in table:
        return [number(v, constants) for v in table["bounds"][: order + 1]]
    kind = table.get("kind")
    if kind in ("triangle", "trapezoid"):
        size, period = (abs(number(table[key], constants)) for key in ("amplitude", "period"))
        rise = period / 2 if kind == "triangle" else number(table["rise"], constants)
        return [size + abs(number(table.get("offset", 0), constants)), 2 * size / rise]
    if kind is not None:
        return None
    known = {
        **constants,
        **{k: number(v, constants) for k, v in table.get("constants", {}).items()},
    }
    try:
        waves = spectrum(ast.parse(str(table["signal"]).strip(), mode="eval").body, known)
    except (KeyError, Refused):
        return None
    bounds = []
    for i in range(order + 1):
        total = defaultdict(lambda: [Q(0), Q(0)])
        for (w, phase), (cosine, sine) in waves.items():
            size = abs(w) ** i if i else Q(1)
            if phase == 0:
                total[abs(w)][0] += cosine * size
                total[abs(w)][1] += sine * size * (1 if w >= 0 else -1)
            else:
                total[w, phase] = [cosine * size, sine * size]
        bounds.append(sum((amplitude(*pair) for pair in total.values()), Q(0)))
    return bounds


def amplitude(cosine, sine):
    if cosine and sine:
        return root_above(cosine**2 + sine**2)
    return abs(cosine) + abs(sine)


def spectrum(node, constants):
    """A signal as {(w, phase): (a, b)} for a cos(w t + phase) + b sin(w t + phase)."""
    match node:
        case ast.Call(func=ast.Name(id="sin" | "cos" as name), args=[inner]):
            w, phase = line(inner, constants)
            return {(w, phase): (Q(1), Q(0)) if name == "cos" else (Q(0), Q(1))}
        case ast.UnaryOp():
            sign = -1 if isinstance(node.op, ast.USub) else 1
            inner = spectrum(node.operand, constants)
            return {k: (sign * a, sign * b) for k, (a, b) in inner.items()}
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            sign = -1 if isinstance(node.op, ast.Sub) else 1
            total = defaultdict(lambda: (Q(0), Q(0)), spectrum(node.left, constants))
            for k, (a, b) in spectrum(node.right, constants).items():
                total[k] = (total[k][0] + sign * a, total[k][1] + sign * b)
            return total
        case ast.BinOp(op=ast.Mult()):
            return waves_product(spectrum(node.left, constants), spectrum(node.right, constants))
        case ast.BinOp(op=ast.Div()):
            factor = rational(node.right, constants)
            inner = spectrum(node.left, constants)
            return {k: (a / factor, b / factor) for k, (a, b) in inner.items()}
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=int(power))) if 0 < power < 9:
            inner = total = spectrum(node.left, constants)
            for _ in range(power - 1):
                total = waves_product(total, inner)
            return total
    return {(Q(0), Q(0)): (rational(node, constants), Q(0))}


def waves_product(first, second):
    total = defaultdict(lambda: (Q(0), Q(0)))
    for (w, p), (a, b) in first.items():
        for (v, r), (c, d) in second.items():
            half = Q(1, 2)
            for key, pair in (
                ((w - v, p - r), (half * (a * c + b * d), half * (b * c - a * d))),
                ((w + v, p + r), (half * (a * c - b * d), half * (b * c + a * d))),
            ):
                total[key] = (total[key][0] + pair[0], total[key][1] + pair[1])
    return total


def line(node, constants):
    """w and phase of w t + phase."""
    at = [rational(node, {**constants, "t": Q(t)}) for t in (0, 1, 3)]
    w = at[1] - at[0]
    demand(at[2] - at[0] == 3 * w, "the argument is no line")
    return w, at[0]


# Step 10: intervals with rational ends ------------------------------------------------------------

#: Ends are rounded outward to this many binary digits.
DIGITS = 120

#: Below and above pi.
PI = (
    Q(314159265358979323846264338327950288, 10**35),
    Q(314159265358979323846264338327950289, 10**35),
)


def outward(low, high):
    scale = 2**DIGITS
    return Q(math.floor(low * scale), scale), Q(math.ceil(high * scale), scale)


def enclosure(node, box):
    """(low, high) of a formula on a box of its symbols."""
    match node:
        case ast.Constant():
            return (Q(repr(node.value)),) * 2
        case ast.Name():
            return PI if node.id == "pi" and "pi" not in box else box[node.id]
        case ast.UnaryOp():
            low, high = enclosure(node.operand, box)
            return (-high, -low) if isinstance(node.op, ast.USub) else (low, high)
        case ast.BinOp(op=ast.Pow()):
            return power(enclosure(node.left, box), rational(node.right, {}))
        case ast.BinOp():
            a, b = enclosure(node.left, box), enclosure(node.right, box)
            if isinstance(node.op, ast.Sub):
                return outward(a[0] - b[1], a[1] - b[0])
            if isinstance(node.op, ast.Add):
                return outward(a[0] + b[0], a[1] + b[1])
            if isinstance(node.op, ast.Div):
                demand(b[0] > 0 or b[1] < 0, "a division by zero")
                b = (1 / b[1], 1 / b[0])
            ends = [u * v for u in a for v in b]
            return outward(min(ends), max(ends))
        case ast.Call():
            return function(node.func.id, [enclosure(n, box) for n in node.args])
    raise Refused(f"no interval: {ast.unparse(node)}")


def power(base, exponent):
    low, high = base
    if exponent.denominator == 2:
        demand(low >= 0, "a root of a negative number")
        low, high, exponent = root_below(low), root_above(high), 2 * exponent
    demand(exponent.denominator == 1, "an unknown power")
    k = int(exponent)
    if k < 0:
        demand(low > 0 or high < 0, "a division by zero")
        low, high, k = 1 / high, 1 / low, -k
    ends = sorted((low**k, high**k))
    if k % 2 == 0 and low < 0 < high:
        ends[0] = Q(0)
    return outward(*ends)


def root_below(square):
    scale = 10**40
    return Q(math.isqrt(square.numerator * scale**2 // square.denominator), scale)


def function(name, arguments):
    low, high = arguments[0]
    match name:
        case "sin":
            return sine(low, high)
        case "cos":
            return sine(*outward(low + PI[0] / 2, high + PI[1] / 2))
        case "sqrt":
            return power((low, high), Q(1, 2))
        case "abs":
            return (Q(0) if low < 0 < high else min(abs(low), abs(high)), max(-low, high))
        case "exp":
            return outward(1 / exponential(-low)[1], exponential(high)[1])
        case "tanh":
            return tanh_at(low)[0], tanh_at(high)[1]
        case "min" | "max":
            pick = min if name == "min" else max
            return tuple(pick(a[i] for a in arguments) for i in (0, 1))
    raise Refused(f"no interval of {name}")


def sine(low, high):
    """By the series at the ends, and 1 or -1 where a crest may lie between them."""
    if high - low >= 2 * PI[0]:
        return Q(-1), Q(1)
    ends = [sine_at(low), sine_at(high)]
    values = [min(e[0] for e in ends), max(e[1] for e in ends)]
    first = math.floor(low / PI[1]) - 2
    for k in range(first, first + 8):  # crests at (k + 1/2) pi
        crest = sorted((k + Q(1, 2)) * p for p in PI)
        if crest[1] >= low and crest[0] <= high:
            values[k % 2 == 0] = Q(1 if k % 2 == 0 else -1)
    return outward(max(values[0], Q(-1)), min(values[1], Q(1)))


def sine_at(x):
    x, total, term, k = outward(x, x)[0], Q(0), Q(0), 1
    step = abs(x)
    demand(step < 60, "an argument of sin is large")
    term = x
    while abs(term) > Q(1, 10**30) or k < step:
        total += term
        term = outward(-term * x * x / ((k + 1) * (k + 2)), Q(0))[0]
        k += 2
    return total - Q(1, 10**25), total + Q(1, 10**25)


def tanh_at(x):
    """Below and above tanh x = 1 - 2/(1 + e^(2x)), which is within 1e-30 of 1 beyond 40."""
    if abs(x) > 40:
        near = (1 - Q(1, 10**30), Q(1))
        return near if x > 0 else (-near[1], -near[0])
    low, high = exponential(2 * x)
    return outward(1 - 2 / (1 + low), 1 - 2 / (1 + high))


def exponential(x):
    """Below and above e^x: (e^(x/m))^m by the series, for |x/m| <= 1/2."""
    m = max(1, math.ceil(2 * abs(x)))
    demand(m < 50_000, "an argument of exp is large")
    y, total, term = x / m, Q(0), Q(1)
    for k in range(1, 40):
        total, term = total + term, term * y / k
    slack = Q(1, 10**35)
    low, high = outward(total - slack, total + slack)
    return outward(low**m, high**m)


# The problem of a system --------------------------------------------------------------------------


class System:
    """Steps 1 to 3."""

    def __init__(self, text, stated_bounds=None):
        table = tomllib.loads(text) if isinstance(text, str) else text
        demand("online" not in table["law"], "the gains move")
        self.plant, self.law, truth = table["plant"], table["law"], table["truth"]
        c = self.constants = {}
        for name, value in self.plant.get("constants", {}).items():
            c[name] = number(value, c)
        kinds = ("adaptive", "robust", "linear")
        demand(self.law["kind"] in kinds, "no certificate covers this law")
        self.adaptive = self.law["kind"] == "adaptive"
        self.n, self.q = len(self.plant["states"]), self.law.get("feedforward", 0)
        if self.law["kind"] == "linear":
            self._feedback()
        else:
            self._recursion()
        Y = reference_bounds(table["reference"], self.q + 1, c) or stated_bounds
        demand(Y is not None and len(Y) == self.q + 2, "the bounds of the reference are unknown")
        self.Y = Y
        self._inputs()
        self._parameters(truth)

    def numbers(self, values):
        return [number(v, self.constants) for v in values]

    def _recursion(self):
        """docs/equations.md, Recursion; A and B have one row per e_m = x_m - lambda_{m-1}."""
        n, q, plant, law = self.n, self.q, self.plant, self.law
        g = self.numbers(plant.get("chain", []))
        b = [
            self.numbers(row) for row in plant.get("linear", [[0] * (i + 1) for i in range(n - 1)])
        ]
        decay = self.numbers(law["c"])
        demand(len(g) == len(b) == n - 1 and len(decay) == n, "g, b or c has another length")
        weights = self._weights(g, decay)
        g = [v * weights[i] / weights[i + 1] for i, v in enumerate(g)]
        b = [[v * weights[i] / weights[j] for j, v in enumerate(row)] for i, row in enumerate(b)]

        def young(value):
            return Q(0) if value in (math.inf, "inf") else 1 / (4 * number(value, self.constants))

        k = law.get("k", [[math.inf] * (2 * m) for m in range(1, n + 1)])
        p = law.get("p", [math.inf] * (n - 1))
        A, B, M, kappa = zeros(n, n), zeros(n, q + 2), zeros(n, n), []
        A[0][0] = B[0][0] = Q(1)
        rows = [[*row, g[i]] + [Q(0)] * (n - 2 - i) for i, row in enumerate(b)]  # F_i x
        for m in range(n):
            eta = [-v for v in A[m][:m]]
            damping = [young(k[m][2 * i]) + young(k[m][2 * i + 1]) for i in range(m + 1)]
            total = damping[m] + sum((damping[i] * eta[i] ** 2 for i in range(m)), Q(0))
            if m < n - 1:
                total += B[m][q] ** 2 * young(p[m])
            kappa.append(total)
            gain = decay[m] + total
            x_part = [-gain * v for v in A[m]]
            y_part = [gain * v for v in B[m]]
            if m:
                x_part = [u - g[m - 1] * v for u, v in zip(x_part, A[m - 1], strict=True)]
                y_part = [u + g[m - 1] * v for u, v in zip(y_part, B[m - 1], strict=True)]
            for i in range(m):
                x_part = [u + eta[i] * v for u, v in zip(x_part, rows[i], strict=True)]
            for i in range(q if m < n - 1 else q + 1):
                y_part[i + 1] += B[m][i]
            if m == n - 1:
                self.nu_x, self.nu_Y = x_part, y_part
                break
            for j in range(m + 1):
                x_part[j] -= b[m][j]
            A[m + 1] = [-v / g[m] for v in x_part]
            A[m + 1][m + 1] += 1
            B[m + 1] = [v / g[m] for v in y_part]
        for m in range(n):
            M[m][m] = -(decay[m] + kappa[m])
            if m < n - 1:
                M[m][m + 1], M[m + 1][m] = g[m], -g[m]
        for i, s in enumerate(weights):  # back from balanced coordinates
            A[i] = [v * w / s for v, w in zip(A[i], weights, strict=True)]
            M[i] = [v * w / s for v, w in zip(M[i], weights, strict=True)]
            B[i] = [v / s for v in B[i]]
        self.nu_x = [v * w / weights[-1] for v, w in zip(self.nu_x, weights, strict=True)]
        self.nu_Y = [v / weights[-1] for v in self.nu_Y]
        self.A, self.B, self.M = A, B, M
        self.R = [B[m][q] for m in range(n - 1)] + [Q(0)]
        self.A_inverse = inverse(A)
        self.through = product(self.A_inverse, B)  # A^-1 B

    def _feedback(self):
        """docs/equations.md, The linear law: A = 1, B = Pi, M = [F; K]."""
        n, q, plant, law = self.n, self.q, self.plant, self.law
        demand("lqr" not in law and "r" in law, "K and r must be stated")
        g = self.numbers(plant.get("chain", []))
        b = [
            self.numbers(row) for row in plant.get("linear", [[0] * (i + 1) for i in range(n - 1)])
        ]
        K = self.numbers(law["K"])
        demand(len(g) == len(b) == n - 1 and len(K) == n, "g, b or K has another length")
        r = number(law["r"], self.constants)
        B = zeros(n, q + 2)
        B[0][0] = Q(1)
        for i in range(n - 1):
            for j in range(q + 1):
                follow = B[i][j - 1] if j else Q(0)
                B[i + 1][j] = (follow - sum((b[i][m] * B[m][j] for m in range(i + 1)), Q(0))) / g[i]
        self.A = self.A_inverse = [[Q(i == j) for j in range(n)] for i in range(n)]
        self.B = self.through = B
        self.M = [[*row, g[i]] + [Q(0)] * (n - 2 - i) for i, row in enumerate(b)] + [K]
        self.R = [row[q] for row in B]
        self.R[-1] -= r
        self.nu_x = K
        self.nu_Y = [-v for v in product([K], B)[0]]
        for i in range(1, q + 2):
            self.nu_Y[i] += B[-1][i - 1] if i <= q else r

    def _weights(self, g, decay):
        """s_1 ... s_n of balanced coordinates; ones without `coupling`."""
        coupling = self.law.get("coupling")
        if coupling is None:
            return [Q(1)] * len(decay)
        demand("k" not in self.law and "p" not in self.law, "balanced coordinates have no damping")
        square, weights = Q(1), [Q(1)]  # s_i^2, and s_i to 12 digits
        for i, v in enumerate(g):
            rho = number(coupling, self.constants)
            square *= v**2 / (rho**2 * decay[i] * decay[i + 1])
            weights.append(Q(f"{float(root_above(square)):.12g}"))
        return weights

    def _inputs(self):
        n, u = self.n, self.plant.get("uncertainty", {})
        tau, gamma, beta = (self.numbers(u.get(key, [0] * n)) for key in ("tau", "gamma", "beta"))
        Delta = [self.numbers(row) for row in u.get("Delta", [[0] * n] * n)]
        S = u.get("S", [1] * n)
        S = [self.numbers(row if isinstance(row, list) else S) for row in S]
        demand(min(*tau, *gamma, *beta, *map(min, Delta)) >= 0, "a strength is negative")
        columns = transposed(self.A)
        self.a, self.b, self.selections = [], [], []  # |a|^2 <= sum (row x + row y)^2
        for k, t in enumerate(tau):
            if t * gamma[k]:
                self.a.append([t * gamma[k] * v for v in columns[k]])
                unit = [[S[k][j] * (i == j) for j in range(n)] for i in range(n)]
                self.selections.append([(row, None) for row in unit])
            for j, entry in enumerate(Delta[k]):
                if t * entry:
                    self.a.append([t * entry * v for v in columns[k]])
                    self.selections.append([([Q(i == j) for i in range(n)], None)])
            if t * beta[k]:
                self.b.append([t * beta[k] * v for v in columns[k]])
        self.y = []  # pairs: column, its part of x
        for i in range(self.q + 1):
            if self.a and self.Y[i] and any(row[i] for row in self.B):
                self.y.append(([Q(0)] * n, [row[i] * self.Y[i] for row in self.through]))
        if self.Y[-1] and any(self.R):
            self.y.append(([-v * self.Y[-1] for v in self.R], [Q(0)] * n))

    def _parameters(self, truth):
        plant, ranges = self.plant, self.plant.get("ranges", {})
        r = len(plant.get("regressor", []))
        if "states" not in truth:
            demand(not truth.get("constants"), "true constants make another plant")
        gain = [truth["input_gain"]] * 2 if "input_gain" in truth else []
        gains = self.numbers(ranges.get("input_gain", gain))
        boxes = ranges.get("theta") or [[v, v] for v in truth.get("theta", [])]
        self.boxes = [self.numbers(pair) for pair in boxes]
        if not self.adaptive:
            known = self.numbers([plant["input_gain"], *plant.get("theta", [])])
            for value, *ends in zip(
                known,
                gains[:1] + [b[0] for b in self.boxes],
                gains[1:] + [b[1] for b in self.boxes],
                strict=False,
            ):
                demand(
                    all(end == value for end in ends), "the law's g_n or theta is not the true one"
                )
            return
        demand(gains and len(self.boxes) == r, "no g_n and theta are stated")
        demand(min(gains) > 0 or max(gains) < 0, "the range of g_n contains 0")
        self.gains = gains
        self._gains_of_the_law(r)

    def _gains_of_the_law(self, r):
        law = self.law
        defaults = {"gain_rate": 1.0, "leak_gain": 0.1, "leak_theta": 0.1, "delta0": 0.0}
        self.gbar, self.gbar1, self.gbar2, self.delta0 = (
            number(law.get(key, value), self.constants) for key, value in defaults.items()
        )
        demand(
            min(self.gbar, self.gbar1, self.gbar2) > 0, "a gain of the update laws is not positive"
        )
        self.theta0 = self.numbers(law.get("theta0", [0] * r))
        metric = law.get("Gamma", [1] * r)
        if r and isinstance(metric[0], list):
            self.Gamma = [self.numbers(row) for row in metric]
        else:
            diagonal = self.numbers(metric)
            self.Gamma = [[diagonal[i] * (i == j) for j in range(r)] for i in range(r)]
        demand(self.Gamma == transposed(self.Gamma) if r else True, "Gamma is not symmetric")
        demand(positive_definite(self.Gamma), "Gamma is not positive definite")

    def leakage(self, alpha, shift):
        """Step 7."""
        s1 = 1 - alpha / (2 * self.gbar * self.gbar1)
        demand(s1 > 0, "alpha exceeds what the leakage of delta_hat allows")
        cost = max(
            abs(g) * self.gbar1 * ((1 - shift) / g - self.delta0) ** 2 / (4 * s1)
            for g in self.gains
        )
        return cost + self.leakage_of_theta(alpha, shift)

    def leakage_of_theta(self, alpha, shift):
        r = len(self.Gamma)
        if not r:
            return Q(0)
        Gamma_inverse = inverse(self.Gamma)
        W = [
            [self.gbar2 * (i == j) - alpha / 2 * Gamma_inverse[i][j] for j in range(r)]
            for i in range(r)
        ]
        demand(positive_definite(W), "alpha exceeds what the leakage of theta_hat allows")
        W = inverse(W)
        corners = itertools.product(*self.boxes)
        worst = max(
            form([(1 + shift) * v - t for v, t in zip(corner, self.theta0, strict=True)], W)
            for corner in corners
        )
        return self.gbar2**2 * worst / 4


class Problem:
    """What a stage is checked on."""

    def __init__(self, M, X, a, b, y, leakage, selections):
        self.M, self.X, self.a, self.b, self.y, self.leakage = M, X, a, b, y, leakage
        self.selections = selections


def numbers_of(stage):
    demand(isinstance(stage, dict) and set(stage) == STAGE, "a stage has other keys")
    alpha, bound, shift = (decimal(stage[key]) for key in ("alpha", "bound", "shift"))
    P = [[decimal(v) for v in row] for row in stage["P"]]
    lam, nu, k = ([decimal(v) for v in stage[key]] for key in ("lam", "nu", "k"))
    return alpha, P, lam, nu, k, bound, shift


def decimal(text):
    demand(isinstance(text, str) and len(text) <= 60, "a number is no decimal text")
    demand(set(text) <= set("0123456789.eE+-"), "a number is no decimal text")
    demand(abs(int(text.lower().partition("e")[2] or 0)) <= 400, "a number is too large")
    return Q(text)


def negative_form(problem, P, lam, nu, k, alpha):
    """Minus the form of step 6."""
    n = len(problem.M)
    columns = [*problem.a, *problem.b, *(column for column, _ in problem.y)]
    size = n + len(columns)
    negative = zeros(size, size)
    PM = product(P, problem.M)
    for i in range(n):
        for j in range(n):
            negative[i][j] -= (PM[i][j] + PM[j][i] + alpha * P[i][j]) / 2
        for j, column in enumerate(columns):
            entry = sum((P[i][m] * column[m] for m in range(n)), Q(0)) / 2
            negative[i][n + j] -= entry
            negative[n + j][i] -= entry
    before = [Q(0)] * (len(problem.a) + len(problem.b))
    states = [  # x_m, row by row
        [*row, *before, *(part[m] for _, part in problem.y)] for m, row in enumerate(problem.X)
    ]
    sums = defaultdict(Q)  # of the multipliers of one row, which many a-inputs share
    for factor, selection in zip(lam, problem.selections, strict=True):
        for row, direct in selection:
            sums[tuple(row), tuple(direct or ())] += factor
    for (row, direct), factor in sums.items():
        x = product([row], states)[0]
        for j, v in enumerate(direct, start=size - len(direct)):
            x[j] += v
        for i, u in enumerate(x):
            for j, v in enumerate(x):
                negative[i][j] -= factor * u * v
    for j, value in enumerate([*lam, *nu, *k]):
        negative[n + j][n + j] += value
    return negative


def check_stage(stage, problem, target):
    """Steps 4 to 8; the bound, and P."""
    alpha, P, lam, nu, k, bound, _ = numbers_of(stage)
    n, adaptive = len(problem.M), problem.leakage is not None
    counts = (len(problem.a), len(problem.b), len(problem.y))
    demand((len(lam), len(nu), len(k)) == counts, "the multipliers have another number")
    demand(len(P) == n and all(len(row) == n for row in P), "P has another shape")
    demand(transposed(P) == P, "P is not symmetric")
    demand(alpha > 0 and min([*lam, *nu, *k, Q(0)]) >= 0, "a sign is wrong")
    demand(not adaptive or not any(P[-1][:-1]), "P couples e_n")
    floor = [[v - (i == j == target) for j, v in enumerate(row)] for i, row in enumerate(P)]
    demand(positive_definite(floor), "P is below its floor")
    negative = negative_form(problem, P, lam, nu, k, alpha)
    demand(positive_definite(negative), "the inequality does not hold")
    delta = sum(nu, Q(0)) + sum(k, Q(0))
    if adaptive:
        delta += P[-1][-1] * problem.leakage(alpha)
    demand(bound >= 0 and bound**2 >= 2 * delta / alpha, "the bound is too small")
    return bound, P


def centred(system, first, E, P, shift):
    """Step 10."""
    n, q, Y = system.n, system.q, system.Y
    M = [list(row) for row in system.M]
    along = product([system.nu_x], system.A_inverse)[0]
    M[-1] = [u - shift * v for u, v in zip(M[-1], along, strict=True)]
    y = []
    for i in range(q + 2):
        column = [-v * Y[-1] for v in system.R] if i == q + 1 else [Q(0)] * n
        part = [row[i] * Y[i] if i <= q else Q(0) for row in system.through]
        direct = sum((v * row[i] for v, row in zip(system.nu_x, system.through, strict=True)), Q(0))
        column[-1] -= shift * ((direct if i <= q else 0) + system.nu_Y[i]) * Y[i]
        if any(column) or (system.a and any(part)):
            y.append((column, part))
    spread = product(product(system.A_inverse, inverse(P)), transposed(system.A_inverse))
    box = {name: (value, value) for name, value in system.constants.items()}
    for j, name in enumerate(system.plant["states"]):
        radius = root_above(E**2 * spread[j][j])
        radius += sum((abs(system.through[j][i]) * Y[i] for i in range(q + 1)), Q(0))
        box[name] = (-radius, radius)

    def largest(formula):
        low, high = enclosure(ast.parse(str(formula).strip(), mode="eval").body, box)
        return max(-low, high)

    Z = largest(system.plant.get("drift", 0))
    for i, phi in enumerate(system.plant.get("regressor", [])):
        Z += largest(phi) * root_above(E**2 * system.Gamma[i][i] / P[-1][-1])
    b = [*system.b, [Q(0)] * (n - 1) + [abs(shift) * Z]] if shift * Z else system.b
    return Problem(
        M, first.X, system.a, b, y, lambda alpha: system.leakage(alpha, shift), system.selections
    )


def head(system, E):
    """Step 9: the first n - 1 rows, with e_n as an input."""
    m = system.n - 1

    def cut(columns):
        return [column[:m] for column in columns]

    last = [row[m] for row in system.A_inverse]
    y = [(column[:m], part) for column, part in system.y]
    y.append(([system.M[i][m] * E for i in range(m)], [v * E for v in last]))
    M = [row[:m] for row in system.M[:m]]
    X = [row[:m] for row in system.A_inverse]
    return Problem(M, X, cut(system.a), cut(system.b), y, None, system.selections)


def check(document, stated_bounds=None):
    """The proven bound on limsup |e_1|.

    Raises
    ------
    Refused
        Where a condition of the page does not hold.
    """
    demand(isinstance(document, dict), "the file is no object")
    basis = FORMATS.get(document.get("format"))
    keys = {"format", "made_by", "claim", "system", "proof", "sha256", basis}
    optional = {"region"} if basis == "premises" else set()
    given = set(document) - optional
    demand(basis is not None and given == keys, "the file has other keys or formats")
    texts = ("made_by", "claim", "system", "sha256")
    demand(all(isinstance(document[key], str) for key in texts), "a text is missing")
    body = {key: value for key, value in document.items() if key != "sha256"}
    digest = hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()
    demand(digest == document["sha256"], "the file was changed")
    proof = document["proof"]
    if basis == "premises" and is_sampled(proof):
        return check_sampled(document, stated_bounds)
    if (
        isinstance(proof, list)
        and proof
        and all(isinstance(e, dict) and "cell" in e for e in proof)
    ):
        from independent_ranges import check_cells

        return check_cells(document, stated_bounds)
    if isinstance(proof, list) and proof and isinstance(proof[0], dict) and "ends" in proof[0]:
        from independent_online import check_online

        return check_online(document, stated_bounds)
    from independent_bootstrap import is_bootstrap

    if basis == "premises" and is_bootstrap(proof):
        return check_bootstrap(document, stated_bounds)
    from independent_adaptive import is_adaptive

    if basis == "premises" and is_adaptive(proof):
        return check_sampled_adaptive(document, stated_bounds)
    demand(isinstance(proof, list) and 1 <= len(proof) <= 3, "the proof has no one to three stages")
    for i, stage in enumerate(proof):
        numbers_of(stage)
        centre = len(proof) == 3 and i == 1
        demand(centre or stage["shift"] == "0", "only a centred stage has a shift")
    claim = f"limsup |e_1(t)| <= {proof[-1]['bound']}" + of_start(document)
    demand(document["claim"] == claim, "the claim is not that of the proof")
    system = System(document["system"], stated_bounds)
    if basis == "premises":
        check_premises_of(document, system)
    else:
        demand(all(isinstance(text, str) for text in document["assumptions"]), "no texts")
    adaptive = (lambda alpha: system.leakage(alpha, Q(0))) if system.adaptive else None
    parts = (system.a, system.b, system.y, adaptive, system.selections)
    whole = Problem(system.M, system.A_inverse, *parts)
    if len(proof) == 1:
        return check_stage(proof[0], whole, 0)[0]
    demand(system.adaptive and system.n >= 2, "no cascade exists for this system")
    E, P = check_stage(proof[0], whole, system.n - 1)
    if len(proof) == 3:
        problem = centred(system, whole, E, P, decimal(proof[1]["shift"]))
        E, _ = check_stage(proof[1], problem, system.n - 1)
    return check_stage(proof[-1], head(system, E), 0)[0]


def check_bootstrap(document, stated_bounds):
    """A bound on e_n, and stages on what it reaches; their arithmetic is in a file of its own."""
    from independent_bootstrap import check_stages

    first, *stages = document["proof"]
    demand(len(stages) <= 64 and first["shift"] == "0", "too many stages, or a shift")
    system = System(document["system"], stated_bounds)
    demand(system.adaptive, "the bootstrap is for the adaptive law")
    check_premises_of(document, system)
    leakage = partial(system.leakage, shift=Q(0))
    parts = (system.a, system.b, system.y, leakage, system.selections)
    E, P = check_stage(first, Problem(system.M, system.A_inverse, *parts), system.n - 1)
    bound = check_stages(system, E, P, stages)
    claims = [c["bound"] for s in stages for f in s["functions"] for c in f["claims"]]
    start = of_start(document)
    texts = {f"limsup |e_1(t)| <= {text}{start}" for text in claims if decimal(text) == bound}
    demand(document["claim"] in texts, "the claim is not that of the proof")
    return bound


def check_sampled_adaptive(document, stated_bounds):
    """The adaptive law as implemented; its arithmetic is in a file of its own.

    Stated bounds of the reference are those of y_d ... y_d^(q+2).
    """
    from independent_adaptive import check_adaptive

    table = tomllib.loads(document["system"])
    demand("soft_start" not in table["reference"], "a soft start")
    demand("kind" not in table["reference"] or stated_bounds, "y_d^(q+1) may jump")
    system = System(document["system"], stated_bounds and stated_bounds[:-1])
    known = reference_bounds(table["reference"], system.q + 2, system.constants)
    known = stated_bounds or known
    demand(known is not None and len(known) == system.q + 3, "y_d^(q+2) has no bound")
    check_premises(document["premises"], system, table, adaptive=True)
    bound, claims = check_adaptive(document["proof"][0], table, system, known[-1])
    demand(document["claim"] in claims, "the claim is not the proof's")
    return bound


#: End of the name of a premise that holds where the states stay from x0.
IN_REGION = " in the region"

#: Keys of the proof for one delay of the implemented loop.
SAMPLED = {"delay", "parts", "doublings", "states", "input", "step", "bound", "starts"}


def is_sampled(proof):
    more = {"cell", "rates", "slow", "split"}  # with ranges, with jitter, with bounds of rates
    return bool(proof) and all(isinstance(e, dict) and set(e) - more == SAMPLED for e in proof)


def check_sampled(document, stated_bounds):
    """The implemented loop; its arithmetic is in a file of its own."""
    import independent_sampled

    demand("region" not in document, "the implemented loop has no such region")
    table = tomllib.loads(document["system"])
    ranged = any("cell" in entry for entry in document["proof"])
    if ranged:
        from independent_cells import SampledPlant

        system = SampledPlant(document["system"], stated_bounds)
    else:
        system = System(document["system"], stated_bounds)
    bound = max(document["proof"], key=lambda entry: decimal(entry["bound"]))["bound"]
    limited = {"saturation", "rate_limit"} & set(table["implementation"])
    limited |= {"bound"} & set(table["plant"].get("uncertainty", {}))
    limited |= {p["name"] for p in document["premises"] if p["name"].endswith(IN_REGION)}
    claim = f"limsup |e_1(t)| <= {bound}" + (" from simulation.x0" if limited else "")
    demand(document["claim"] == claim, "the claim is not the proof's")
    slow = any("slow" in entry for entry in document["proof"])
    check_premises(document["premises"], system, table, sampled=True, slow=slow)
    return independent_sampled.check(document["proof"], table, system)


def known_rates(u):
    """The w, from 0, that act and have a rate."""
    return [
        k
        for k, rate in enumerate(u.get("rate", []))
        if rate not in ("inf", math.inf)
        and u["tau"][k]
        and (
            u["gamma"][k]
            or u["beta"][k]
            or any(u["Delta"][k] if "Delta" in u else ())
            or u.get("bound", [""] * (k + 1))[k] not in ("", 0, "0")
        )
    ]


def of_start(document):
    return " from simulation.x0" if "region" in document else ""


def check_premises_of(document, system):
    """Those of a continuous loop, and the region that some may need."""
    from independent_region import check_region

    table = tomllib.loads(document["system"])
    demand("integral" not in table["law"], "integral action has no such certificate")
    check_premises(document["premises"], system, table, regional="region" in document)
    check_region(document, system, table)


def check_premises(
    premises, system, table, sampled=False, slow=False, regional=False, adaptive=False
):
    """Step 11: names, their order, and that none is contradicted."""
    demand(isinstance(premises, list), "the premises are no list")
    names = []
    for record in premises:
        demand(isinstance(record, dict) and set(record) == RECORD, "a premise has other keys")
        demand(record["status"] in STATUSES, "a premise has another status")
        demand(record["status"] != "contradicted", f"{record['name']} is contradicted")
        demand(record["witness"] is None, "a premise that holds has a witness")
        demand(isinstance(record["detail"], str) and isinstance(record["remedy"], str), "no text")
        names.append(
            record["name"].removesuffix(IN_REGION) if sampled or regional else record["name"]
        )
    own = "states" in table["truth"]
    regressor = bool(table["plant"].get("regressor"))
    expected = ["plant"]
    expected += [] if own else ["input gain", *(["theta"] if regressor else [])]
    expected += [] if own else [f"w_{k + 1}" for k in range(system.n)]
    expected += ["domain", "reference"]
    optional = ["irrational numbers"] if "irrational numbers" in names else []
    expected += optional
    drive = table.get("implementation", {})
    if sampled:
        expected += ["sampled loop", "sampled reference", "timing and arithmetic"]
        uncertain = table["plant"].get("uncertainty", {})
        bounds = uncertain.get("bound")
        expected += [f"rate of w_{k + 1}" for k in (known_rates(uncertain) if slow else ())]
        expected += ["region of states"] if bounds else []
        expected += ["input limits"] if {"saturation", "rate_limit"} & set(drive) else []
    elif adaptive:
        expected += ["starts", "sampled loop", "input limits and projection"]
        expected += ["sampled reference", "timing and arithmetic"]
    elif "implementation" in table:
        expected += ["continuous law, exact states"]
    demand(names == expected, "the premises are not those of the system")


def read(path):
    """A file as a document; keys that stand twice are refused."""

    def once(pairs):
        demand(len({key for key, _ in pairs}) == len(pairs), "a key stands twice")
        return dict(pairs)

    with open(path, encoding="utf-8") as stream:  # noqa: PTH123
        return json.load(stream, object_pairs_hook=once)


if __name__ == "__main__":
    sys.modules["independent_checker"] = sys.modules["__main__"]  # whose Refused the parts raise
    try:
        print("holds:", float(check(read(sys.argv[1]))))
    except Refused as reason:
        sys.exit(f"does not hold: {reason}")

"""Ranges of constants, for the checker of certificate files: fractions and integers alone.

Written from docs/certificate-file.md, "Ranges of constants". It shares nothing with certrack: no
computer algebra, no interval library, no quadrature. Rational functions of the constants are
quotients of polynomials with a greatest common divisor of this file; the exponential of a matrix is
its series in integers of fixed point, whose errors are counted; and the integrals of |c e^{Mt} b|
are added up over steps that are halved where a kernel changes its sign.
"""

import ast
import itertools
import math
import tomllib
from collections import defaultdict
from fractions import Fraction as Q
from functools import cached_property

import independent_checker as base
from independent_checker import Refused, demand, inverse, product, zeros

#: What a file may hold, by the page.
MAX_POINTS, MAX_CELLS = 256, 1024

# Polynomials: {exponents: coefficient} ------------------------------------------------------------


def trimmed(p):
    return {key: value for key, value in p.items() if value}


def plus(p, q, factor=1):
    total = defaultdict(Q, p)
    for key, value in q.items():
        total[key] += factor * value
    return trimmed(total)


def times(p, q):
    total = defaultdict(Q)
    for (a, u), (b, v) in itertools.product(p.items(), q.items()):
        total[tuple(map(sum, zip(a, b, strict=True)))] += u * v
    return trimmed(total)


def lead(p):
    """The first exponents in lexicographic order, and their coefficient."""
    key = max(p)
    return key, p[key]


def divided(p, q):
    """p/q if it is a polynomial, else None."""
    quotient, (first, size) = {}, lead(q)
    while p:
        key, value = lead(p)
        step = tuple(a - b for a, b in zip(key, first, strict=True))
        if min(step, default=0) < 0:
            return None
        quotient[step] = value / size
        p = plus(p, times({step: value / size}, q), -1)
    return quotient


def primitive(p):
    """The content, with the sign of the leading coefficient, and p divided by it."""
    values = list(p.values())
    content = Q(
        math.gcd(*(v.numerator for v in values)), math.lcm(*(v.denominator for v in values))
    )
    content *= 1 if lead(p)[1] > 0 else -1
    return content, {key: value / content for key, value in p.items()}


def by_axis(p, axis):
    """The coefficients of the powers of one constant, as polynomials of the others."""
    parts = defaultdict(dict)
    for key, value in p.items():
        parts[key[axis]][(*key[:axis], 0, *key[axis + 1 :])] = value
    return parts


def divisor(p, q, axis=0):
    """Greatest common divisor, by Euclid on primitive parts, constant by constant."""
    if not p or not q:
        return primitive(p or q)[1]
    width = len(next(iter(p)))
    if axis == width:
        return {(0,) * width: Q(1)}

    def content(f):
        common = {}
        for part in by_axis(f, axis).values():
            common = divisor(common, part, axis + 1) if common else primitive(part)[1]
        return common

    def degree(f):
        return max(key[axis] for key in f)

    a, b = content(p), content(q)
    shared, f, g = divisor(a, b, axis + 1), divided(p, a), divided(q, b)
    while g and degree(g):
        if degree(f) < degree(g):
            f, g = g, f
            continue
        while f and degree(f) >= degree(g):  # the remainder, without fractions of constants
            step = [0] * width
            step[axis] = degree(f) - degree(g)
            top, other = (by_axis(h, axis)[degree(h)] for h in (f, g))
            f = plus(times(f, other), times(times(g, top), {tuple(step): Q(1)}), -1)
        f, g = g, divided(f, content(f)) if f else {}
    if g:  # of degree 0: no common factor with this constant
        return shared
    return primitive(times(shared, divided(f, content(f))))[1]


class Ratio:
    """A rational function of the constants, in lowest terms, the denominator primitive."""

    def __init__(self, top, bottom):
        demand(bool(bottom), "a division by zero")
        common = divisor(top, bottom) if top else bottom
        top, bottom = divided(top, common), divided(bottom, common)
        content, self.bottom = primitive(bottom)
        self.top = {key: value / content for key, value in top.items()}

    @classmethod
    def number(cls, value, width):
        one = {(0,) * width: Q(1)}
        return cls(trimmed({(0,) * width: Q(value)}), one)

    def __add__(self, other):
        top = plus(times(self.top, other.bottom), times(other.top, self.bottom))
        return Ratio(top, times(self.bottom, other.bottom))

    def __neg__(self):
        return Ratio({key: -value for key, value in self.top.items()}, self.bottom)

    def __sub__(self, other):
        return self + -other

    def __mul__(self, other):
        return Ratio(times(self.top, other.top), times(self.bottom, other.bottom))

    def __truediv__(self, other):
        return Ratio(times(self.top, other.bottom), times(self.bottom, other.top))

    def __pow__(self, k):
        result = Ratio.number(1, len(next(iter(self.bottom))))
        for _ in range(abs(k)):
            result = result * self if k > 0 else result / self
        return result

    def __eq__(self, other):
        return self.top == other.top and self.bottom == other.bottom

    def __hash__(self):
        return hash((frozenset(self.top.items()), frozenset(self.bottom.items())))

    @property
    def constant(self):
        """The number it is, or None."""
        if any(any(key) for key in (*self.top, *self.bottom)):
            return None
        return sum(self.top.values(), Q(0)) / sum(self.bottom.values(), Q(0))

    def at(self, point):
        below = value_at(self.bottom, point)
        demand(below != 0, "a denominator vanishes")
        return value_at(self.top, point) / below


def value_at(p, point):
    return sum(
        (v * math.prod(x**k for x, k in zip(point, key, strict=True)) for key, v in p.items()), Q(0)
    )


def bernstein(p, degrees, box):
    """Coefficients of a polynomial in the tensor Bernstein basis, the last constant fastest."""
    table = {key: Q(0) for key in itertools.product(*(range(d + 1) for d in degrees))}
    table.update(p)
    for axis, (d, (low, high)) in enumerate(zip(degrees, box, strict=True)):
        changed = dict.fromkeys(table, Q(0))
        for key, value in table.items():
            if not value:
                continue
            j = key[axis]  # p^j = (low + (high - low) s)^j, and s^k in the basis
            for k in range(j + 1):
                part = value * math.comb(j, k) * low ** (j - k) * (high - low) ** k
                for i in range(k, d + 1):
                    place = (*key[:axis], i, *key[axis + 1 :])
                    changed[place] += part * Q(math.comb(i, k), math.comb(d, k))
        table = changed
    return [table[key] for key in sorted(table)]


def common_denominator(ratios, width):
    lowest = {(0,) * width: Q(1)}
    for ratio in ratios:
        lowest = divided(times(lowest, ratio.bottom), divisor(lowest, ratio.bottom))
    return lowest


class Vector:
    """Rational functions over their least common denominator."""

    def __init__(self, ratios, width):
        bottom = common_denominator(ratios, width)
        self.bottom = bottom
        self.tops = [times(r.top, divided(bottom, r.bottom)) for r in ratios]
        keys = [key for p in (*self.tops, bottom) for key in p]
        self.degrees = [max(key[axis] for key in keys) for axis in range(width)]
        self.count = math.prod(d + 1 for d in self.degrees)

    def points(self, box):
        demand(self.count <= MAX_POINTS, "a hull has too many points")
        below = bernstein(self.bottom, self.degrees, box)
        demand(min(below) > 0 or max(below) < 0, "a denominator may vanish")
        tables = [bernstein(top, self.degrees, box) for top in self.tops]
        return [[table[i] / d for table in tables] for i, d in enumerate(below)]


def ends(ratio, width, box):
    """Smallest and largest of the points of one function."""
    values = [point[0] for point in Vector([ratio], width).points(box)]
    return min(values), max(values)


# Formulas of constants and states -----------------------------------------------------------------


class Formula:
    """A formula as {function of x: coefficient}; a function is a sorted tuple of (atom, power)."""

    #: f(z)/z over all z; all of them are odd.
    SECTORS = {"sin": (Q(-2173, 10000), Q(1)), "tanh": (Q(0), Q(1)), "atan": (Q(0), Q(1))}

    BOUNDED = {"sin": Q(1), "cos": Q(1), "tanh": Q(1), "sign": Q(1), "atan": base.PI[1] / 2}

    def __init__(self, width, known, states):
        self.width, self.known, self.states = width, known, states

    def number(self, value):
        return Ratio.number(value, self.width)

    def of(self, text):
        if not isinstance(text, str):
            return trimmed_terms({(): self.number(base.number(text, {}))})
        return trimmed_terms(self.terms(ast.parse(text.strip(), mode="eval").body))

    def ratio(self, text):
        """A formula without states."""
        terms = self.of(text)
        demand(set(terms) <= {()}, "a state stands where a number belongs")
        return terms.get((), self.number(0))

    def terms(self, node):
        match node:
            case ast.Constant():
                return {(): self.number(base.number(node.value, {}))}
            case ast.Name() if node.id in self.known:
                return {(): self.known[node.id]}
            case ast.Name() if node.id in self.states:
                return {((node.id, 1),): self.number(1)}
            case ast.Name():
                return {(): self.number(Q(repr(base.IRRATIONAL[node.id])))}
            case ast.UnaryOp():
                inner = self.terms(node.operand)
                sign = isinstance(node.op, ast.USub)
                return {key: -value for key, value in inner.items()} if sign else inner
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                total = dict(self.terms(node.left))
                for key, value in self.terms(node.right).items():
                    before = total.get(key, self.number(0))
                    total[key] = before + (value if isinstance(node.op, ast.Add) else -value)
                return total
            case ast.BinOp(op=ast.Mult()):
                return self.multiplied(self.terms(node.left), self.terms(node.right))
            case ast.BinOp(op=ast.Div()):
                return self.multiplied(self.terms(node.left), self.power(node.right, Q(-1)))
            case ast.BinOp(op=ast.Pow()):
                exponent = self.terms(node.right).get((), self.number(0)).constant
                return self.power(node.left, exponent)
            case ast.Call():
                parts = [trimmed_terms(self.terms(arg)) for arg in node.args]
                if all(set(part) <= {()} for part in parts):
                    numbers = [part.get((), self.number(0)).constant for part in parts]
                    demand(None not in numbers, "a constant with a range is inside a function")
                    value = getattr(math, node.func.id)(*map(float, numbers))
                    return {(): self.number(Q(repr(value)))}
                return self.function_of(node.func.id, parts)
        raise Refused(f"no formula: {ast.unparse(node)}")

    def function_of(self, name, parts):
        """A function of the states, its sign and that of its argument normalised."""
        factor = self.number(1)
        if name in (*self.SECTORS, "abs", "cos") and len(parts[0]) == 1:
            ((key, value),) = parts[0].items()
            number = value.constant
            if number is not None and number < 0:
                parts, number = [{key: -value}], -number
                factor = -factor if name in self.SECTORS else factor
            if name == "abs" and number is not None:
                parts, factor = [{key: self.number(1)}], self.number(number)
        return {(((name, *map(self.frozen, parts)), 1),): factor}

    def multiplied(self, first, second):
        total = {}
        for (a, u), (b, v) in itertools.product(first.items(), second.items()):
            powers = defaultdict(Q)
            for atom, k in (*a, *b):
                powers[atom] += k
            key = tuple(sorted(((n, k) for n, k in powers.items() if k), key=repr))
            total[key] = total.get(key, self.number(0)) + u * v
        return total

    def power(self, node, exponent):
        inner = trimmed_terms(self.terms(node))
        if exponent.denominator == 1 and exponent > 0:
            total = {(): self.number(1)}
            for _ in range(int(exponent)):
                total = self.multiplied(total, inner)
            return total
        if set(inner) <= {()} and exponent.denominator == 1:
            return {(): inner.get((), self.number(0)) ** int(exponent)}
        if set(inner) <= {()}:
            value = inner.get((), self.number(0)).constant
            demand(value is not None, "a root of a constant with a range")
            return {(): self.number(Q(repr(float(value) ** float(exponent))))}
        if len(inner) == 1 and exponent.denominator == 1:
            ((key, factor),) = inner.items()
            return {tuple((atom, k * exponent) for atom, k in key): factor ** int(exponent)}
        return {((("power", self.frozen(inner)), exponent),): self.number(1)}

    def frozen(self, terms):
        """An argument of a function: it holds no constant with a range."""
        values = [(key, value.constant) for key, value in terms.items()]
        demand(all(v is not None for _, v in values), "a ranged constant is inside a function")
        return tuple(sorted(values, key=repr))

    def extent(self, function):
        """What a product of functions may be over all x; None if it is not known to be bounded."""
        low, high = Q(1), Q(1)
        for atom, k in function:
            known = isinstance(atom, tuple) and atom[0] in self.BOUNDED
            if not (known and k > 0 and k.denominator == 1):
                return None
            size = self.BOUNDED[atom[0]] ** int(k)
            low, high = hull((low, high), (Q(0) if k % 2 == 0 else -size, size))
        return low, high

    def largest(self, function):
        """sup |m(x)| over all x."""
        found = self.extent(function)
        demand(found is not None, "an unbounded function is not cancelled")
        return max(map(abs, found))

    def sector(self, function):
        """The number of a state x_j, and an interval that holds m(x)/x_j over all x; or None."""
        for j, state in enumerate(self.states):
            found = []
            for i, (atom, k) in enumerate(function):
                slope = self.slope(atom, state) if k == 1 else None
                rest = self.extent(function[:i] + function[i + 1 :])
                if slope is not None and rest is not None:
                    found.append(hull(slope, rest))
            if found:
                return j, (max(low for low, _ in found), min(high for _, high in found))
        return None

    def slope(self, atom, state):
        """What a factor over a state may be."""
        line = ((state, 1),)
        match atom:
            case str():
                return (Q(1), Q(1)) if atom == state else None
            case ("abs", ((key, value),)) if key == line and value == 1:
                return Q(-1), Q(1)
            case (name, ((key, value),)) if key == line and name in self.SECTORS:
                return hull(self.SECTORS[name], (value, value))
        return None


def hull(first, second):
    """All products of numbers of two intervals."""
    found = [u * v for u in first for v in second]
    return min(found), max(found)


def lifted(ratio, count):
    """The same function of more constants."""
    top, bottom = (
        {(*key, *(0,) * count): value for key, value in p.items()}
        for p in (ratio.top, ratio.bottom)
    )
    return Ratio(top, bottom)


def trimmed_terms(terms):
    return {key: value for key, value in terms.items() if value.top}


# The loop -----------------------------------------------------------------------------------------


class RangedSystem(base.System):
    """Steps 1 to 3 at the nominal constants, and the loop as a function of the constants.

    With slopes, terms within a sector are functions of constants that vary in time, too, whose
    intervals a cell has in some order.
    """

    def __init__(self, text, stated_bounds=None, *, slopes=False):
        self.table, self.slopes = tomllib.loads(text), slopes
        super().__init__(text, stated_bounds)
        self._functions()

    def _parameters(self, truth):
        """The law's part of step 7; g_n and theta follow the constants."""
        ranges, r = self.plant.get("ranges", {}), len(self.plant.get("regressor", []))
        self.named = [name for name in ranges if name not in ("input_gain", "theta")]
        names = set(truth.get("constants", {}))
        demand(names <= set(self.named), "true constants make another plant")
        for name in names:
            low, high = self.numbers(ranges[name])
            inside = low <= base.number(truth["constants"][name], self.constants) <= high
            demand(inside, "a true constant is outside its range")
        if self.adaptive:
            self._gains_of_the_law(r)

    def _functions(self):
        plant, truth, ranges = self.plant, self.table["truth"], self.plant.get("ranges", {})
        n, q, r = self.n, self.q, len(self.plant.get("regressor", []))
        opened = [("input_gain", None)] if "input_gain" in ranges and not self.adaptive else []
        boxes = [self.numbers(pair) for pair in ranges.get("theta", [])]
        if not self.adaptive:
            opened += [("theta", i) for i, (low, high) in enumerate(boxes) if low != high]
        self.width = width = len(self.named) + len(opened)
        unit = [tuple(int(i == j) for j in range(width)) for i in range(width)]
        one = {(0,) * width: Q(1)}
        symbols = [Ratio({key: Q(1)}, one) for key in unit]
        known, maker = {}, Formula(width, {}, plant["states"])
        maker.known = known
        for name, value in plant.get("constants", {}).items():
            is_open = name in self.named
            known[name] = symbols[self.named.index(name)] if is_open else maker.ratio(value)
        self.box = [tuple(self.numbers(ranges[name])) for name in self.named]
        nominal = [self.constants[name] for name in self.named]

        def formula(key, i=None):
            """What the proof takes for g_n or theta."""
            pick = (lambda v: v) if i is None else (lambda v: v[i])
            if key in plant:
                found = maker.ratio(pick(plant[key]))
                if found.constant is None or not self.adaptive:
                    return found
            demand(key in truth, "no g_n or theta is stated")
            return maker.ratio(pick(truth[key]))

        gain, theta = formula("input_gain"), [formula("theta", i) for i in range(r)]
        for j, (_, i) in enumerate(opened, start=len(self.named)):
            nominal.append(
                (gain if i is None else theta[i]).at([*nominal, *[Q(0)] * width][:width])
            )
            pair = self.numbers(ranges["input_gain"]) if i is None else boxes[i]
            self.box.append(tuple(pair))
            if i is None:
                gain = symbols[j]
            else:
                theta[i] = symbols[j]
        inside = [low <= v <= high for v, (low, high) in zip(nominal, self.box, strict=True)]
        demand(all(inside), "a nominal constant is outside its range")
        self.gain_ratio, self.theta_ratios = gain, theta

        def fixed(ratio):
            return Ratio.number(ratio.at(nominal), width)

        rho = Ratio.number(1, width) if self.adaptive else gain / fixed(gain)
        matrix = [[Ratio.number(0, width)] * (n + q + 3) for _ in range(n)]
        for i in range(n - 1):
            matrix[i][i + 1] = maker.ratio(plant["chain"][i])
            for j, entry in enumerate(plant.get("linear", [[]] * (n - 1))[i]):
                matrix[i][j] = matrix[i][j] + maker.ratio(entry)
        for j, value in enumerate([*self.nu_x, *self.nu_Y]):
            matrix[-1][j] = rho * Ratio.number(value, width)
        terms = maker.of(plant.get("drift", 0))
        for phi, value in zip(plant.get("regressor", []), theta, strict=True):
            if not self.adaptive:
                for key, part in maker.multiplied(maker.of(phi), {(): value}).items():
                    terms[key] = terms.get(key, Ratio.number(0, width)) + part
        self.brackets, self.sizes, self.within = [], [], []
        for function, coefficient in terms.items():
            bracket = coefficient - rho * fixed(coefficient)
            if not bracket.top:
                continue
            state = function[0][0] if len(function) == 1 and function[0][1] == 1 else None
            if function == ():
                matrix[-1][-1] = matrix[-1][-1] + bracket
            elif state in plant["states"]:
                j = plant["states"].index(state)
                matrix[-1][j] = matrix[-1][j] + bracket
            elif self.slopes and (sector := maker.sector(function)) is not None:
                self.within.append((bracket, *sector))
            else:
                self.brackets.append(bracket)
                self.sizes.append(maker.largest(function))
        self.matrix, self.ranged = matrix, width
        self.ordered(tuple(range(len(self.within))))

    def ordered(self, order):
        """The loop with its slopes in another order, behind the constants."""
        count, m = len(self.within), self.ranged
        self.width = width = m + count
        if count and len(next(iter(self.matrix[0][0].bottom))) != width:
            self.matrix = [[lifted(entry, count) for entry in row] for row in self.matrix]
            self.brackets = [lifted(bracket, count) for bracket in self.brackets]
            self.within = [(lifted(b, count), j, ends) for b, j, ends in self.within]
            self.gain_ratio = lifted(self.gain_ratio, count)
            self.theta_ratios = [lifted(ratio, count) for ratio in self.theta_ratios]
        one = {(0,) * width: Q(1)}
        self.terms, total = [], [list(row) for row in self.matrix]
        for i, k in enumerate(order):
            bracket, j, _ = self.within[k]
            slope = Ratio({tuple(int(c == m + i) for c in range(width)): Q(1)}, one)
            self.terms.append((j, bracket * slope))
            total[-1][j] = total[-1][j] + bracket * slope
        self.sectors = [self.within[k][2] for k in order]
        self.entries = Vector([*itertools.chain(*total), *self.brackets], width)
        self.__dict__.pop("functions", None)

    def form(self, values):
        """M, W and the offset for the entries of (Acl | Ecl | o)."""
        n, q = self.n, self.q
        width = n + q + 3
        rows = [values[i * width : (i + 1) * width] for i in range(n)]
        M = product(product(self.A, [row[:n] for row in rows]), self.A_inverse)
        W = product(self.A, [row[n:-1] for row in rows])
        through = product(M, self.B)
        for i in range(n):
            for j in range(q + 2):
                W[i][j] += through[i][j] if j <= q else 0
                W[i][j] -= self.B[i][j - 1] if j else 0
        return M, W, [v[0] for v in product(self.A, [[row[-1]] for row in rows])]

    @property
    def last_column(self):
        return [row[-1] for row in self.A]

    @cached_property
    def functions(self):
        """{(numerator, denominator): matrix} of the entries, in the order of the page."""
        found = {}
        shape = (self.n, len(self.matrix[0]))
        for i, row in enumerate(self.matrix):
            for j, entry in enumerate(row):
                for key in sorted(entry.top, reverse=True):
                    part = Ratio({key: entry.top[key]}, entry.bottom)
                    ((monomial, value),) = part.top.items()
                    name = (frozenset([(monomial, Q(1))]), frozenset(part.bottom.items()))
                    found.setdefault(name, zeros(*shape))[i][j] += value
        for j, term in self.terms:
            name = (frozenset(term.top.items()), frozenset(term.bottom.items()))
            found[name] = zeros(*shape)
            found[name][-1][j] = Q(1)
        return found

    def channels(self, box):
        """Middle of (Acl | Ecl | o), and products of columns and rows with their radii."""
        middle = zeros(self.n, len(self.matrix[0]))
        columns, rows = [], []
        for (top, bottom), matrix in self.functions.items():
            low, high = ends(Ratio(dict(top), dict(bottom)), self.width, box)
            for i, row in enumerate(matrix):
                middle[i] = [u + v * (low + high) / 2 for u, v in zip(middle[i], row, strict=True)]
            if high > low:
                for column, row in factors(matrix):
                    columns.append([v * (high - low) / 2 for v in column])
                    rows.append(row)
        return middle, columns, rows

    def largest_brackets(self, box):
        found = [ends(bracket, self.width, box) for bracket in self.brackets]
        return [max(abs(low), abs(high)) for low, high in found]

    def leakage_over(self, box):
        """Step 7 with g_n and theta within their hulls over a cell; None for the robust law."""
        if not self.adaptive:
            return None
        ranges = self.plant.get("ranges", {})
        if "input_gain" in ranges:
            self.gains = self.numbers(ranges["input_gain"])
        else:
            self.gains = list(ends(self.gain_ratio, self.width, box))
        demand(min(self.gains) > 0 or max(self.gains) < 0, "the range of g_n contains 0")
        if "theta" in ranges:
            self.boxes = [self.numbers(pair) for pair in ranges["theta"]]
        else:
            points = Vector(self.theta_ratios, self.width).points(box) if self.theta_ratios else []
            self.boxes = [(min(v), max(v)) for v in zip(*points, strict=True)]
        return lambda alpha: self.leakage(alpha, Q(0))


def factors(matrix):
    """Columns and rows whose products sum to the matrix: its reduced row echelon form."""
    rows, pivots = [list(row) for row in matrix], []
    for j in range(len(rows[0])):
        i = next((k for k in range(len(pivots), len(rows)) if rows[k][j]), None)
        if i is None:
            continue
        m = len(pivots)
        rows[m], rows[i] = rows[i], rows[m]
        rows[m] = [v / rows[m][j] for v in rows[m]]
        for k in range(len(rows)):
            if k != m and rows[k][j]:
                factor = rows[k][j]
                rows[k] = [u - factor * v for u, v in zip(rows[k], rows[m], strict=True)]
        pivots.append(j)
    return [([row[j] for row in matrix], rows[m]) for m, j in enumerate(pivots)]


# Cells with points --------------------------------------------------------------------------------


def problems_of(system, box, order):
    """What the stages of a cell are checked on, with the brackets in some order."""
    leakage = system.leakage_over(box)
    if system.entries.count <= MAX_POINTS:
        size = system.n * (system.n + system.q + 3)
        return [
            problem_of(system, values[:size], values[size:], order, leakage)
            for values in system.entries.points(box)
        ]
    middle, columns, rows = system.channels(box)
    values = list(itertools.chain(*middle))
    brackets = system.largest_brackets(box)
    return [problem_of(system, values, brackets, order, leakage, columns, rows)]


def problem_of(system, values, brackets, order, leakage, columns=(), rows=()):
    n, q, Y = system.n, system.q, system.Y
    M, W, offset = system.form(values)
    a = [*system.a, *(through_A(system, column) for column in columns)]
    b = [*system.b]
    for i in order:
        if brackets[i]:
            b.append([v * brackets[i] * system.sizes[i] for v in system.last_column])
    y, kept = [], []
    scale = [*Y, Q(1)]
    for i in range(q + 3):
        column = offset if i == q + 2 else [row[i] * Y[i] for row in W]
        part = [row[i] * Y[i] if i <= q else Q(0) for row in system.through]
        part = part if i <= q else [Q(0)] * n
        in_rows = any(row[n + i] * scale[i] for row in rows)
        if any(column) or in_rows or (a and any(part)):
            y.append((column, part))
            kept.append(i)
    selections = [*system.selections]
    for row in rows:
        selections.append([(row[:n], [row[n + i] * scale[i] for i in kept])])
    return base.Problem(M, system.A_inverse, a, b, y, leakage, selections)


def through_A(system, column):
    return [sum((u * v for u, v in zip(row, column, strict=True)), Q(0)) for row in system.A]


# Peak gains ---------------------------------------------------------------------------------------

#: Binary digits after the point, of integers that stand for numbers.
POINT = 320

#: Terms of the series of an exponential whose argument has the norm 1/1024.
TERMS = 40

#: Steps of one length before it doubles, and its exponent of two at the beginning.
STEPS, FIRST = 48, 9

#: The exponential is followed until its norm is below 2 to this power.
DECAYED = -60

#: A norm of the exponential above 2 to this power is taken for that of an unstable loop.
GROWN = 100

#: A step in which a kernel changes its sign is halved until what is not known is so small a part.
RESOLUTION = 30  # halvings of the integral so far


def fixed(value):
    return round(value * 2**POINT)


class Exponential:
    """e^{M h 2^j} in fixed point, and how far off they are; norms are sums of rows."""

    def __init__(self, M):
        self.n = n = len(M)
        self.norm = max(sum(abs(v) for v in row) for row in M)
        self.halvings = max(0, math.ceil(math.log2(float(self.norm) * 1024)))
        self.h = Q(1, 2**self.halvings)
        H = [[fixed(v * self.h) for v in row] for row in M]
        term = [[(i == j) << POINT for j in range(n)] for i in range(n)]
        total = [list(row) for row in term]
        for count in range(1, TERMS):
            term = [[v // count for v in row] for row in rounded_product(term, H)]
            total = [
                [u + v for u, v in zip(*rows, strict=True)]
                for rows in zip(total, term, strict=True)
            ]
        self.powers = [total]
        # the series beyond, which is below 1024^-TERMS/TERMS!, the roundings of each term (which
        # the later ones carry on, with the norm 1/1024), and those of H
        self.errors = [Q((TERMS + 4) * (n + 2) * 4, 2**POINT)]
        self.growth = [1 + 2 * self.norm * self.h]  # above the norm of e^{M s} for s up to h 2^j

    def size(self, j):
        F = self.powers[j]
        return Q(max(sum(abs(v) for v in row) for row in F), 2**POINT) + self.errors[j]

    def grow(self):
        F, error, size = self.powers[-1], self.errors[-1], self.size(len(self.powers) - 1)
        self.powers.append(rounded_product(F, F))
        self.errors.append(upward(2 * size * error + error**2 + Q(2 * self.n, 2**POINT)))
        self.growth.append(upward(self.growth[-1] * max(Q(1), size)))

    def to(self, j):
        while len(self.powers) <= j:
            growing = self.size(len(self.powers) - 1) > Q(2) ** GROWN
            demand(len(self.powers) < 80 and not growing, "the loop is not stable")
            self.grow()
        return self.powers[j]


def upward(value):
    """A rational of few digits above a positive one."""
    return Q(math.ceil(value * 2**400), 2**400) if value.denominator.bit_length() > 800 else value


def rounded_product(a, b):
    columns = list(zip(*b, strict=True))
    return [[sum(map(int.__mul__, row, col)) >> POINT for col in columns] for row in a]


class Kernels:
    """Integrals of |c e^{Mt} b| over t >= 0, from above, for rows c and columns b."""

    def __init__(self, M, C, columns):
        self.E = Exponential(M)
        inverse_M = inverse(M)
        self.n = len(M)
        self.scale_C = max((sum(map(abs, row)) for row in C), default=Q(0)) or Q(1)
        self.scale_b = [max(map(abs, b)) or Q(1) for b in columns]
        unit = [[v / s for v in b] for b, s in zip(columns, self.scale_b, strict=True)]
        self.B = [[fixed(v) for v in b] for b in unit]
        self.K = [[fixed(v) for v in image(inverse_M, b)] for b in unit]
        second = [image(M, image(M, b)) for b in unit]
        self.B2 = [[fixed(v) for v in b] for b in second]
        self.third = [max(map(abs, image(M, b))) for b in second]
        self.largest = max(
            [Q(1), self.E.norm**2, *(max(map(abs, image(inverse_M, b))) for b in unit)]
        )
        self.C = [[fixed(v / self.scale_C) for v in row] for row in C]
        self._integrate()

    def _integrate(self):
        E, level, R, steps = self.E, FIRST, self.C, 0
        while E.size(len(E.powers) - 1) >= Q(2) ** DECAYED:  # else the loop is not stable
            E.to(len(E.powers))
        count = len(self.B)
        self.totals = [[0] * count for _ in self.C]
        self.cells = 0
        self.growing = {}  # above growth and the norm of M^3 b, by level and column
        while True:
            F = E.to(level)
            after = rounded_product(R, F)
            for p, (left, right) in enumerate(zip(R, after, strict=True)):
                for j in range(count):
                    self.totals[p][j] += self._cell(left, right, j, level, p)
            R, steps = after, steps + 1
            if steps == STEPS:
                steps, level = 0, level + 1
                E.to(level)
                if E.size(level) < Q(2) ** DECAYED:
                    break
        # steps of the longest length with which the kernels were followed all the way down
        while any(sum(map(abs, row)) > 1 << (POINT + DECAYED // 2) for row in R):
            F = E.to(level)
            after = rounded_product(R, F)
            for p, (left, right) in enumerate(zip(R, after, strict=True)):
                for j in range(count):
                    self.totals[p][j] += self._cell(left, right, j, level, p)
            R = after
        self._finish(R, level)

    def _finish(self, R, level):
        """The tail, and the roundings of everything."""
        E, n = self.E, self.n
        rho, growth, span = E.size(level), E.growth[level], E.h * 2**level
        steps = self.cells + 1
        one = Q(2 * n, 2**POINT) + max(E.errors[: level + 1])
        drift = one * steps * growth * growth  # of a row of R, with the norm 1 at most `growth`
        value = 2 * n * (drift + growth * Q(2, 2**POINT)) * self.largest
        roundings = 4 * steps * (1 + span) ** 3 * value
        self.gains = []
        for p, row in enumerate(R):
            rest = Q(sum(map(abs, row)), 2**POINT) + drift
            tail = rest * span * growth / (1 - rho)
            self.gains.append(
                [
                    (Q(total, 2**POINT) + tail + roundings) * self.scale_C * scale
                    for total, scale in zip(self.totals[p], self.scale_b, strict=True)
                ]
            )

    def _cell(self, left, right, j, level, p):
        """Above the integral over one step, in fixed point; its length is a power of two."""
        self.cells += 1
        halvings = self.E.halvings - level
        b = self.B[j]
        first = sum(map(int.__mul__, left, b)) >> POINT
        last = sum(map(int.__mul__, right, b)) >> POINT
        curve = abs(sum(map(int.__mul__, left, self.B2[j])) >> POINT)
        if (level, j) not in self.growing:
            self.growing[level, j] = math.ceil(self.E.growth[level] * self.third[j])
        curve += shifted(sum(map(abs, left)) * self.growing[level, j], halvings) + 2
        bend = shifted(curve, 2 * halvings + 3)
        if first * last > 0 and min(abs(first), abs(last)) > bend:
            antiderivative = self.K[j]
            change = sum(map(int.__mul__, map(int.__sub__, right, left), antiderivative)) >> POINT
            return abs(change) + 1
        part = shifted(bend, halvings)
        if level and part > (self.totals[p][j] >> RESOLUTION) and part > 1 << (POINT // 2):
            middle = rounded_product([left], self.E.powers[level - 1])[0]
            return self._cell(left, middle, j, level - 1, p) + self._cell(
                middle, right, j, level - 1, p
            )
        a, c = abs(first), abs(last)
        if first * last < 0:
            chord = shifted((a * a + c * c) // (a + c) + 1, halvings + 1)
        else:
            chord = shifted(a + c, halvings + 1)
        return chord + part


def shifted(value, halvings):
    """Above value/2^halvings."""
    return (value >> halvings) + 1 if halvings > 0 else value << -halvings


def image(matrix, column):
    return [sum((u * v for u, v in zip(row, column, strict=True)), Q(0)) for row in matrix]


def peak_bound(system, box):
    """The bound of the page on limsup |e_1| for constants in a cell."""
    n, q, Y = system.n, system.q, system.Y
    middle, columns, rows = system.channels(box)
    M, W, offset = system.form(list(itertools.chain(*middle)))
    bounded = list(system.b)
    for bracket, size in zip(system.largest_brackets(box), system.sizes, strict=True):
        bounded.append([v * bracket * size for v in system.last_column])
    channel_columns = [through_A(system, column) for column in columns]
    states = [[Q(i == j) for j in range(n)] for i in range(n)] if system.a else []
    C = [[Q(i == 0) for i in range(n)]]
    D = [[Q(0)] * (q + 2)]
    D_o = [Q(0)]
    for row in (*rows, *(unit + [Q(0)] * (q + 3) for unit in states)):
        C.append(product([row[:n]], system.A_inverse)[0])
        of_x = product([row[:n]], system.through)[0]
        D.append([(of_x[j] if j <= q else 0) + row[n + j] for j in range(q + 2)])
        D_o.append(row[-1])
    M_inverse = inverse(M)
    still, residuals, last = [], [], [Q(0)] * n
    for s in range(q + 2):
        residuals.append([W[i][s] - last[i] for i in range(n)])
        last = [-v for v in image(M_inverse, residuals[-1])]
        still.append(last)
    rest = [-v for v in image(M_inverse, offset)]
    later = [[row[j] for row in W] for j in range(1, q + 2)]
    table = [*bounded, *channel_columns, *system.a, *residuals, *later]
    acting = [i for i, column in enumerate(table) if any(column)]
    found = Kernels(M, C, [table[i] for i in acting]).gains
    gains = [[Q(0)] * len(table) for _ in C]
    for p, row in enumerate(found):
        for i, value in zip(acting, row, strict=True):
            gains[p][i] = value
    nb, nc, na = len(bounded), len(columns), len(system.a)
    constant = []
    for p, (c, d, d_o) in enumerate(zip(C, D, D_o, strict=True)):
        moving = gains[p][nb + nc + na :]
        options = []
        for s in range(q + 2):
            total = moving[s] * Y[s]
            total += sum((abs(dot(c, still[j]) + d[j]) * Y[j] for j in range(s)), Q(0))
            total += sum((moving[q + 1 + j] * Y[j] for j in range(s + 1, q + 2)), Q(0))
            total += sum((abs(d[j]) * Y[j] for j in range(s, q + 2)), Q(0))
            options.append(total)
        offset_part = abs(dot(c, rest) + d_o)
        constant.append(min(options) + offset_part + sum(gains[p][:nb], Q(0)))
    through = [row[nb : nb + nc + na] for row in gains]
    return fixed_point(system, constant, through, nc)


def dot(a, b):
    return sum((u * v for u, v in zip(a, b, strict=True)), Q(0))


def fixed_point(system, constant, through, nc):
    """e_1's line at a v with v > F(v) for the outputs q_k and |x_j|."""
    count = len(constant) - 1

    def norms(x):
        """N_k from above: ||S_k x|| of the |x_j|."""
        sizes = []
        for selection in system.selections:
            squares = sum((dot(map(abs, row), x) ** 2 for row, _ in selection), Q(0))
            single = len(selection) == 1
            sizes.append(dot(map(abs, selection[0][0]), x) if single else base.root_above(squares))
        return sizes

    def after(v):
        inputs = [*v[:nc], *norms(v[nc:])] if system.a else v
        return [c + dot(row, inputs) for c, row in zip(constant, through, strict=True)]

    v = [Q(0)] * count
    for _ in range(2000):
        new = [Q(float(value)) for value in after(v)[1:]]
        demand(all(value < 10**100 for value in new), "the gain through the ranges is not below 1")
        settled = all(b <= a * (1 + Q(1, 10**11)) for a, b in zip(v, new, strict=True))
        v = new
        if settled:
            break
    v = [value * (1 + Q(1, 10**9)) + Q(1, 10**280) for value in v]
    found = after(v)
    demand(
        all(a < b for a, b in zip(found[1:], v, strict=True)),
        "the gain through the ranges is not below 1",
    )
    return found[0]


# The cells ----------------------------------------------------------------------------------------


def fraction(text):
    demand(isinstance(text, str) and len(text) <= 2000, "an end of a cell is no fraction")
    top, _, bottom = text.partition("/")
    demand(set(top) <= set("0123456789-") and set(bottom) <= set("0123456789"), "no fraction")
    return Q(int(top), int(bottom or "1"))


def covered(box, cells):
    """Whether every point of the box is in a cell, by cutting the box at an end of a cell."""
    touching = [
        cell
        for cell in cells
        if all(c < b and a < d for (a, b), (c, d) in zip(box, cell, strict=True))
        or all(c <= a and b <= d for (a, b), (c, d) in zip(box, cell, strict=True))
    ]
    for cell in touching:
        if all(c <= a and b <= d for (a, b), (c, d) in zip(box, cell, strict=True)):
            return True
    for cell in touching:
        for i, ((a, b), pair) in enumerate(zip(box, cell, strict=True)):
            for end in pair:
                if a < end < b:
                    halves = [(a, end), (end, b)]
                    return all(
                        covered([*box[:i], half, *box[i + 1 :]], touching) for half in halves
                    )
    return False


def check_cells(document, stated_bounds=None):
    """The proven bound of a proof by cells."""
    proof = document["proof"]
    demand(document["format"] == "certrack-certificate/2", "a proof by cells needs format 2")
    demand(1 <= len(proof) <= MAX_CELLS, "there are too many cells")
    cells = []
    for entry in proof:
        demand(isinstance(entry, dict) and set(entry) == {"cell", "bound", "points"}, "other keys")
        demand(isinstance(entry["points"], list), "points are no list")
        cells.append([(fraction(low), fraction(high)) for low, high in entry["cell"]])
        demand(all(low <= high for low, high in cells[-1]), "an interval of a cell is empty")
        for stage in entry["points"]:
            base.numbers_of(stage)
            demand(stage["shift"] == "0", "only a centred stage has a shift")
    bounds = [base.decimal(entry["bound"]) for entry in proof]
    largest = [entry["bound"] for entry, b in zip(proof, bounds, strict=True) if b == max(bounds)]
    claims = {f"limsup |e_1(t)| <= {text}{base.of_start(document)}" for text in largest}
    demand(document["claim"] in claims, "the claim is not that of the proof")
    system = RangedSystem(document["system"], stated_bounds, slopes=True)
    if len(cells[0]) == system.ranged:  # every nonlinear term is a b-input
        system = RangedSystem(document["system"], stated_bounds)
    if "region" in document:  # then nothing has a range
        base.check_premises_of(document, base.System(document["system"], stated_bounds))
    else:
        base.check_premises(document["premises"], system, system.table)
    if system.plant.get("uncertainty", {}).get("constants_vary", False):
        demand(len(cells) == 1 and not system.adaptive, "constants that vary need one cell")
    demand(all(len(cell) == system.width for cell in cells), "a cell has another dimension")
    constants = [cell[: system.ranged] for cell in cells]
    demand(covered(system.box, constants), "the cells do not cover the ranges")
    for entry, cell, bound in zip(proof, cells, bounds, strict=True):
        check_orders(system, entry["points"], cell, bound, cells)
    return max(bounds)


def check_orders(system, points, cell, bound, cells):
    """A cell with its slopes in one of the orders in which all cells have them entire."""
    refusal, m = Refused("a cell cuts a slope, which varies in time"), system.ranged
    for order in itertools.permutations(range(len(system.within))):
        system.ordered(order)
        if not all(
            low <= a and b <= high
            for other in cells
            for (low, high), (a, b) in zip(other[m:], system.sectors, strict=True)
        ):
            continue
        try:
            check_cell(system, points, cell, bound)
        except Refused as reason:
            refusal = reason
        else:
            return
    raise refusal


def check_cell(system, points, cell, bound):
    if not points:
        demand(not system.adaptive, "peak gains prove nothing with estimates in the loop")
        demand(peak_bound(system, cell) <= bound, "the bound is smaller than the peak gains give")
        return
    for stage in points:
        same = all(stage[key] == points[0][key] for key in ("P", "alpha"))
        demand(same and base.decimal(stage["bound"]) == bound, "the stages of a cell differ")
    refusal = None
    for order in itertools.permutations(range(len(system.brackets))):  # that of the maker
        problems = problems_of(system, cell, order)
        demand(len(problems) == len(points), "a cell has not one stage for each point")
        try:
            for problem, stage in zip(problems, points, strict=True):
                base.check_stage(stage, problem, 0)
        except Refused as reason:
            refusal = reason
        else:
            return
    raise refusal

"""Polynomial functions of a bootstrap, checked from docs/certificate-file.md.

A part of independent_bootstrap. A polynomial is a dictionary from sorted tuples of indices of
variables (with repetitions) to coefficients.
"""

from fractions import Fraction as Q
from itertools import combinations_with_replacement
from math import comb

from independent_bootstrap import definite
from independent_checker import decimal, demand

POLYNOMIAL = {
    "degree",
    "reference",
    "alpha",
    "W",
    "mu",
    "squares",
    "inputs",
    "sectors",
    "majorants",
    "holds",
    "grams",
    "claims",
}

#: The variable a in the conditions of a-inputs.
EXTRA = 10**6


def words(count, degree):
    return [
        word
        for total in range(degree + 1)
        for word in combinations_with_replacement(range(count), total)
    ]


def join(first, second):
    return tuple(sorted(first + second))


def total(*parts):
    result = {}
    for factor, polynomial in parts:
        for word, value in polynomial.items():
            result[word] = result.get(word, Q(0)) + factor * value
    return result


def times(p, q):
    result = {}
    for u, a in p.items():
        for v, b in q.items():
            if a and b:
                word = join(u, v)
                result[word] = result.get(word, Q(0)) + a * b
    return result


def slope(p, i):
    result = {}
    for word, value in p.items():
        if i in word:
            rest = list(word)
            rest.remove(i)
            result[tuple(rest)] = value * word.count(i)
    return result


def has_gram(p, basis, free):
    """Whether p = m^T Q m with the positive definite Q of these free entries."""
    size = len(basis)
    Qm = [[Q(0)] * size for _ in range(size)]
    first, left, free = {}, dict(p), list(free)
    for j in range(size):
        for i in range(j + 1):
            word = join(basis[i], basis[j])
            if word not in first:
                first[word] = i, j
                left.setdefault(word, Q(0))
                continue
            demand(free, "too few entries of a Gram matrix")
            value = free.pop(0)
            Qm[i][j] = Qm[j][i] = value
            left[word] -= value * (1 if i == j else 2)
    demand(not free, "too many entries of a Gram matrix")
    for word, value in left.items():
        if word not in first:
            demand(value == 0, "a monomial is no product")
            continue
        i, j = first[word]
        Qm[i][j] = Qm[j][i] = value if i == j else value / 2
    return definite(Qm)


def check_polynomial(region, record):
    """The claims of a polynomial function that holds: (error, side, bound)."""
    demand(isinstance(record, dict) and set(record) == POLYNOMIAL, "a function has other keys")
    loop, system = region.loop, region.loop.system
    D, reference = record["degree"], record["reference"]
    demand(type(D) is int and D >= 4 and D % 2 == 0, "the degree is not even, or below 4")
    demand(type(reference) is bool, "reference is no truth value")
    size, width, n_y = loop.size, region.width, system.q + 1
    begin_y = size + 1 + len(system.a) + len(system.b)
    moved = list(range(begin_y, begin_y + n_y)) if reference else []
    demand(not reference or min(system.Y[:n_y]) > 0, "the reference does not move")
    variables = [*range(size), *moved]  # places in w
    N = len(variables)
    demand(D <= 260 and comb(N + D // 2, D // 2) <= 130, "too many monomials")
    basis, low = words(N, D // 2), words(N, D // 2 - 1)
    corners = []
    for F, relation in region.corners:
        rows = [list(row) for row in F]
        for i, _ in enumerate(moved):
            row = [Q(0)] * width
            row[begin_y + i + 1] = system.Y[i + 1] / system.Y[i]
            rows.append(row)
        corners.append((rows, relation))

    def of(line):
        """The part of a row over w that is made of variables and 1."""
        parts = {(i,): line[place] for i, place in enumerate(variables)}
        return {word: v for word, v in (parts | {(): line[size]}).items() if v}

    def read(texts, degree):
        wanted = words(N, degree)
        demand(isinstance(texts, list) and len(texts) == len(wanted), "a polynomial's length")
        return dict(zip(wanted, map(decimal, texts), strict=True))

    alpha = decimal(record["alpha"])
    demand(alpha > 0, "alpha is not positive")
    W, mu = read(record["W"], D), read(record["mu"], D - 1)
    for key in ("squares", "inputs", "sectors", "majorants", "holds", "grams", "claims"):
        demand(isinstance(record[key], list), f"{key} is no list")
    demand(all(isinstance(free, list) for free in record["grams"]), "a Gram matrix is no list")
    squares, inputs, sectors, holds = (
        [read(p, D - 2) for p in record[key]] for key in ("squares", "inputs", "sectors", "holds")
    )
    majorants = [read(p, D) for p in record["majorants"]]
    boxes = [of(line) for line in region.sectors] + [{(size + i,): Q(1)} for i in range(len(moved))]
    boxes = [total((1, {(): Q(1)}), (-1, times(p, p))) for p in boxes]
    claims = record["claims"]
    counts = [len(squares), len(inputs), len(sectors), len(holds)]
    na = len(system.a)
    demand(counts == [na, na, len(boxes), len(claims) * len(boxes)], "numbers of multipliers")
    lines = []  # S_j x / reach_j, as rows over w
    for limit, selection in zip(region.reach, system.selections, strict=True):
        lines.append([])
        for row, _ in selection:
            line = [
                sum((v * x[i] for v, x in zip(row, region.x, strict=True)), Q(0)) / limit
                for i in range(width)
            ]
            lines[-1].append(line)
    free_y = [i for i in range(begin_y, begin_y + n_y) if i not in moved]
    triples = {}
    psi_begin = width - 3 * len(region.psi)
    n = loop.n
    for k, i in enumerate(region.varying):
        at = psi_begin + 3 * k
        triples[at] = [(at, ()), (at + 1, (n - 1,)), (at + 2, (n + i,))]

    def column(corner, entries):
        rows, relation = corner
        parts = []
        for i, row in enumerate(rows):
            field = {word: row[place] for place, word in entries}
            parts.append((1, times(field, slope(W, i))))
        field = {word: relation[place] for place, word in entries}
        return total(*parts, (1, times(field, mu)))

    expected = [(p, low) for kind in (squares, inputs, sectors, holds) for p in kind]
    sums, waiting = [[] for _ in corners], list(majorants)
    for place in range(size + 1, width):
        if place in moved or (place >= psi_begin and place not in triples):
            continue
        entries = triples.get(place, [(place, ())])
        stacked = [
            [[row[at] for row in (*rows, relation)] for at, _ in entries]
            for rows, relation in corners
        ]
        in_x = [
            (j, line)
            for j, group in enumerate(lines)
            for line in group
            if place in free_y
            if line[place]
        ]
        if not in_x and not any(v for part in stacked for c in part for v in c):
            continue
        same = all(part == stacked[0] for part in stacked)
        groups = [range(len(corners))] if same else [[c] for c in range(len(corners))]
        for group in groups:
            demand(waiting, "too few majorants")
            s = waiting.pop(0)
            q = column(corners[group[0]], entries)
            for j, line in in_x:
                q = total((1, q), (2 * line[place], times(of(line), squares[j])))
            for c in group:
                sums[c].append((1, s))
            j = place - size - 1
            if j < na:
                lifted = total(
                    (1, s),
                    (-1, times({(EXTRA,): Q(1)}, q)),
                    (1, times({(EXTRA, EXTRA): Q(1)}, total((1, squares[j]), (1, inputs[j])))),
                )
                expected.append((lifted, [*basis, *(join(m, (EXTRA,)) for m in low)]))
            else:
                expected += [(total((1, s), (sign, q)), basis) for sign in (-1, 1)]
    demand(not waiting, "too many majorants")
    own = [(place, (i,)) for i, place in enumerate(variables)] + [(size, ())]
    shared = [(1, p) for p in inputs]
    for p, group in zip(squares, lines, strict=True):
        for line in group:
            shared.append((1, times(p, times(of(line), of(line)))))
        crossed = sum(
            (abs(sum((line[k] * line[m] for line in group), Q(0))) for k in free_y for m in free_y),
            Q(0),
        )
        shared.append((crossed, p))
    shared += [(1, times(p, box)) for p, box in zip(sectors, boxes, strict=True)]
    for corner, parts in zip(corners, sums, strict=True):
        falls = total((1, column(corner, own)), (alpha, W), *parts, *shared)
        expected.append((total((-1, falls)), basis))
    found = []
    for number, claim in enumerate(claims):
        demand(set(claim) == {"error", "side", "scale", "bound"}, "a claim has other keys")
        error, side = claim["error"], claim["side"]
        scale, bound = decimal(claim["scale"]), decimal(claim["bound"])
        demand(type(error) is int and type(side) is int and side in (1, -1), "no error or side")
        demand(0 <= error < len(region.sectors) and scale > 0, "no such row, or no scale")
        if error < size:
            line = {(error,): region.halves[error], (): region.middles[error]}
        else:
            low_end, high_end = region.ends
            half = (high_end - low_end) / 2
            line = total((half, of(region.sectors[error])), ((low_end + high_end) / 2, {(): Q(1)}))
        own_holds = holds[number * len(boxes) : (number + 1) * len(boxes)]
        p = total(
            (1, W),
            (bound / scale, {(): Q(1)}),
            (-side / scale, line),
            *((-1, times(h, box)) for h, box in zip(own_holds, boxes, strict=True)),
        )
        expected.append((p, basis))
        found.append((error, side, bound))
    demand(len(record["grams"]) == len(expected), "another number of Gram matrices")
    for (p, basis_of_p), texts in zip(expected, record["grams"], strict=True):
        demand(
            has_gram(p, basis_of_p, [decimal(v) for v in texts]), "a Gram matrix is not definite"
        )
    return found

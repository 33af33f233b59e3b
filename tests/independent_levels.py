"""Levels of the implemented loop, from docs/certificate-file.md and numpy alone.

A level is a motion Pi of the loop with the reference, at the beginnings of the cells, and what the
loop does not obey of it in each cell, D. The last level is the loop's own, with D = 0.
"""

import math

import numpy as np

#: Steps of each cell in which kernels are summed.
GRID = 2


def area(a, b):
    """Under the magnitude of a line over a unit of time."""
    size = np.abs(a) + np.abs(b)
    crossing = (a * b < 0) & (size > 0)
    return np.where(crossing, (a * a + b * b) / np.where(size > 0, size, 1), size) / 2


def all_levels(loop):
    """(Pi, D) of levels 0 ... q + 1, over whole cells."""
    own = loop.Pi[::GRID]
    ideal, found = where_the_error_is_zero(loop), []
    if ideal is None:  # the loop's own motion alone
        D = np.zeros((len(own[0]), loop.q + 1))
        return [(own, [D] * (len(loop.cells) // GRID))]
    for s in range(loop.q + 2):
        Pi = [np.hstack([a[:, :s], b[:, s:]]) for a, b in zip(own, ideal, strict=True)]
        D = []
        for p in range(0, len(loop.cells), GRID):
            h, E = whole_cell(loop, p)
            left = E @ Pi[p // GRID] - Pi[p // GRID + 1] @ loop._shift(h)
            left[:, :s] = 0
            D.append(left)
        found.append((Pi, D))
    return found


def whole_cell(loop, p):
    E, h = np.eye(len(loop.J)), 0.0
    for step, _, over in loop.cells[p : p + GRID]:
        E, h = over @ E, h + step
    return h, E


def ages_of(loop, h):
    """Powers of the ages in a cell of that length, one row for each derivative."""
    powers = [(loop.q - j, math.factorial(loop.q - j)) for j in range(loop.q + 1)]
    return np.array([np.linspace(0, h, 2 * GRID + 1) ** k / whole for k, whole in powers])


def where_the_error_is_zero(loop):
    """x = x_d, the memories of its samples after some time, and the inputs that follow.

    None where a memory never forgets, as that of a disturbance observer whose states are given.
    """
    n, q, back = loop.n, loop.q, loop._shift(-loop.T)
    of_x, of_s = loop.after[:, :n], loop.after[:, n:]
    count = len(of_x)
    s = np.zeros((count, q + 1))
    if count:
        whole = np.eye(count * (q + 1)) - np.kron(of_s, back.T)
        try:
            s = np.linalg.solve(whole, (of_x @ loop.desired).ravel()).reshape(count, q + 1)
        except np.linalg.LinAlgError:
            return None
    u = loop.command[:n] @ loop.desired + loop.command[n:] @ (s @ back) + loop.forward[: q + 1]
    inputs = [u @ loop._shift(-i * loop.T) for i in range(len(loop.J) - n - count)]
    Pi = [np.vstack([loop.desired, s, *inputs])]
    for p in range(0, len(loop.cells), GRID):
        after = Pi[-1] @ loop._shift(-whole_cell(loop, p)[0])
        after[:n] = loop.desired
        Pi.append(after)
    return Pi


def bernstein_of_Y(loop, p, of_y, N):
    """r_i of the page, one row for each i."""
    h = loop.cells[p][0] * GRID
    table = [np.concatenate([np.zeros(k), of_y])[: loop.q + 1] for k in range(N + 1)]
    change = [
        [math.comb(i, k) / math.comb(N, k) * h**k / math.factorial(k) for k in range(N + 1)]
        for i in range(N + 1)
    ]
    return np.array(change) @ np.array(table)


def reference_part(loop, level, rows, of_Y, phase):
    """The reference's part of rows at the beginning of a cell, without its samples' errors."""
    Pi, D = level
    total = np.abs(rows @ Pi[phase] - of_Y) @ loop.Y[:-1]
    first, start, whole = True, np.abs(rows).max(), len(D)
    spans = [whole_cell(loop, p * GRID) for p in range(whole)]
    cells = [(h, E, ages_of(loop, h)) for h, E in spans]
    while np.abs(rows).max() >= 1e-11 * start:
        kernels = []
        for p in range(phase - 1, -1, -1):
            h, E, Gamma = cells[p]
            motion = rows @ Pi[p + 1]
            kernels.append((h / (2 * GRID), -motion @ Gamma))
            total = total + np.abs(rows @ D[p]) @ loop.Y[:-1]
            rows = rows @ E
        spread = 0 if first else (rows @ loop.R[:, -1])[:, None] / loop.T
        for step, kernel in kernels:
            values = kernel + spread
            total = total + step * area(values[:, :-1], values[:, 1:]).sum(axis=1) * loop.Y[-1]
        rows, first, phase = rows @ loop.J, False, whole
    return total

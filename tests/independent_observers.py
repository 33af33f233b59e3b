"""Observers as docs/certificate-file.md tells of them, by numpy alone."""

import math

import independent_checker as checker
import numpy as np

#: Steps of the Riccati equation until it stands still.
RICCATI_STEPS = 200_000


def over(A, B, t, exponential):
    """e^(A t), and the integral of e^(A s) B over t."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A * t, B * t
    full = exponential(block)
    return full[:n, :n], full[:n, n:]


def stationary(F, C, Q):
    S = np.array(Q)
    for _ in range(RICCATI_STEPS):
        seen = C @ S @ C.T + np.eye(len(C))
        after = F @ (S - S @ C.T @ np.linalg.solve(seen, C @ S)) @ F.T + Q
        change, S = np.abs(after - S).max(), after
        if change <= 1e-15 * np.abs(S).max():
            break
    return S @ C.T @ np.linalg.inv(C @ S @ C.T + np.eye(len(C)))


def weights_of(observer, A, T, measured, rows, n):
    weights = np.full(n + len(rows), 1e-3)
    if "weights" in observer:
        signals = [i for i in range(n) if i not in measured] + [n + j for j in range(len(rows))]
        weights[signals] = [float(v) for v in observer["weights"]]
        return weights
    for first, end in zip(measured, [*measured[1:], n], strict=True):
        named = [i for i in rows if first <= i < end]
        checker.demand(len(named) < 2, "one bandwidth of several rows")
        last, order = named[0] if named else end - 1, 1 + len(named)
        g = np.prod([A[i, i + 1] for i in range(first, last)])
        signal = n + rows.index(last) if named else last
        power = float(observer["bandwidth"]) ** (last - first + order)
        weights[signal] = power * T / abs(g)
    return weights


class Observer:
    """Its numbers.

    Attributes: F, G, new, old, L (states), Ld (rows), P, U, rows, and the whole and the fractional
    part of the delay.
    """

    def __init__(self, table, drive, names, A, b, T, exponential, delay):
        n = len(b)
        rows = table.get("rows", [] if table["kind"] == "kalman" else names[-1:])
        self.rows = rows = sorted(names.index(name) for name in rows)
        E = np.eye(n)[:, rows]
        self.late, part = math.floor(delay), float(delay - math.floor(delay))
        self.kept = self.late + (part > 0)
        self.F, self.G = over(A, E, T, exponential)
        newer, self.new = over(A, b[:, None], (1 - part) * T, exponential)
        self.old = newer @ over(A, b[:, None], part * T, exponential)[1]
        velocity = drive.get("velocity", [])
        measured = [i for i in range(n) if names[i] not in velocity]
        count = len(rows)
        if table["kind"] == "dob":
            speeds = table["bandwidth"]
            speeds = speeds if isinstance(speeds, list) else [speeds] * count
            order = [names.index(name) for name in table.get("rows", names[-1:])]
            share = [1 - math.exp(-float(speeds[order.index(i)]) * T) for i in rows]
            self.Ld, self.L = np.diag(share) @ np.linalg.inv(self.G[rows]), None
            self.predicted = self.seen = rows
        else:
            full = np.eye(n + count)
            full[:n, :n], full[:n, n:] = self.F, self.G
            if "weights" in table:
                stated = [names.index(name) for name in table.get("rows", names[-1:])]
                hidden = n - len(measured)
                entries = dict(zip(stated, table["weights"][hidden:], strict=True))
                in_order = [*table["weights"][:hidden], *(entries[i] for i in rows)]
                table = {**table, "weights": in_order}
            weights = weights_of(table, A, T, measured, rows, n)
            gain = stationary(full, np.eye(n + count)[measured], np.diag(weights**2))
            self.L, self.Ld = gain[:n], gain[n:]
            self.predicted, self.seen = list(range(n)), measured
        block = np.zeros((n + 1, n + 1))
        block[:n, :n], block[:n, n], block[n, 0] = A, b, 1
        steady = np.linalg.solve(block, -np.vstack([E, np.zeros((1, count))]))
        self.P, self.U = steady[:n], steady[n]

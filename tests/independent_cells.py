"""Cells of ranges for the implemented loop, from docs/certificate-file.md, fractions and numpy."""

import independent_checker as checker
import independent_ranges as ranges
import independent_sampled as sampled
import numpy as np


class SampledPlant(ranges.RangedSystem):
    """(A | b | o)(p) in the place of the closed loop: what the law does is taken out again."""

    def _functions(self):
        super()._functions()
        checker.demand(not self.brackets, "a term that is not linear")
        n, width = self.n, self.width
        one, zero = (ranges.Ratio.number(v, width) for v in (1, 0))
        names = self.plant["states"]
        slopes, _ = sampled.linear(self.plant.get("drift", 0), names, self.constants)
        thetas = self.numbers(self.plant.get("theta", []))
        for phi, theta in zip(self.plant.get("regressor", []), thetas, strict=True):
            more, _ = sampled.linear(phi, names, self.constants)
            slopes = [a + theta * b for a, b in zip(slopes, more, strict=True)]
        gain = checker.number(self.plant["input_gain"], self.constants)
        rho = self.gain_ratio * ranges.Ratio.number(1 / gain, width)
        matrix = [[*row[:n], zero, zero] for row in self.matrix]
        for j in range(n):
            closed = ranges.Ratio.number(slopes[j] - self.nu_x[j], width)
            matrix[-1][j] = matrix[-1][j] + rho * closed
        matrix[-1][n], matrix[-1][n + 1] = one * self.gain_ratio, self.matrix[-1][-1]
        self.matrix = matrix


class CellLoop(sampled.Loop):
    """The loop at the centre of a cell, with the channels."""

    def __init__(self, table, system, delay, parts, cell):
        self.plant, self.cell = system, cell
        super().__init__(table, system, delay, parts)

    def _period(self, delay, parts):
        n = self.n
        middle, columns, rows = self.plant.channels(self.cell)
        middle = np.array(middle, float)
        rows = np.array(rows, float).reshape(len(rows), n + 2)
        self.A, self.b = middle[:, :n], middle[:, n]
        self.seen += [(row[:n], row[n]) for row in rows]
        more = np.array([np.eye(n)[-1], *np.array(columns, float)]).T
        self.W = np.hstack([self.W, more])
        self.beta = np.concatenate([self.beta, [abs(middle[-1, n + 1])], np.abs(rows[:, n + 1])])
        self.count = len(rows)
        super()._period(delay, parts)

    def size(self, X):
        n = self.n
        own = self.gamma * np.linalg.norm(self.S * X[:n], axis=1) + self.Delta @ X[:n]
        return np.concatenate([own, [0.0], X[n:]]) + self.beta


def cell_loops(group, table, system, delay):
    """The cells' entries for one delay, each with its loop."""
    checker.demand(all("cell" in entry for entry in group), "an entry has no cell")
    cells = []
    for entry in group:
        cells.append([(ranges.fraction(low), ranges.fraction(high)) for low, high in entry["cell"]])
        checker.demand(all(low <= high for low, high in cells[-1]), "an interval is empty")
        checker.demand(len(cells[-1]) == system.width, "a cell has another dimension")
    if system.plant.get("uncertainty", {}).get("constants_vary", False):
        checker.demand(len(cells) == 1, "constants that vary need one cell")
    checker.demand(ranges.covered(system.box, cells), "the cells do not cover the ranges")
    return [
        (entry, CellLoop(table, system, delay, entry["parts"], cell))
        for entry, cell in zip(group, cells, strict=True)
    ]

"""How an output between two samples is seen by rows over chi.

In a cell, o(t_p + s) = c x - c_Y Y is a polynomial of degree N in s, linear in (chi_p, Y_p), plus
what w and r add since the cell began, plus the polynomial's remainder. In Bernstein form the
polynomial lies in the hull of its coefficients R_i chi_p - r_i Y_p. The rest is convex in s and
zero at s = 0, so at most s/h times its value at the cell's end, and s/h has the coefficients i/N:

    |o(t_p + s)| <= max_i |R_i chi_p - r_i Y_p| + i/N (rest at the end).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint

from certrack.certificates.implemented.channels import Channel
from certrack.certificates.implemented.period import InputCell, Period
from certrack.core.ball_matrices import absolute


@dataclass(frozen=True)
class InCell:
    """What a cell adds to an output until its end: balls, times the bounds of w, r, x and u."""

    w: tuple[Any, ...]
    r: Any
    x: tuple[Any, ...]
    u: Any


@dataclass(frozen=True)
class Row:
    """|o| <= |row chi_p - of_Y Y_p| + share in_cell, at the beginning of a cell.

    Attributes
    ----------
    output : int
        Which output it belongs to.
    phase : int
        The cell p; 0 is right after the jump.
    row : N balls
    of_Y : q + 1 balls
    share : rational
    in_cell : InCell
    """

    output: int
    phase: int
    row: tuple[Any, ...]
    of_Y: tuple[Any, ...]
    share: Any
    in_cell: InCell


#: Degree of the polynomials of e_1 (at least q, for that of Y) and of the states.
ERROR_DEGREE, STATE_DEGREE = 3, 2


def output_rows(period: Period) -> list[Row]:
    """Rows of e_1 (output 0), of the m states and channels (1 ... m), of u_k and u_k - u_{k-1}."""
    drive, n, q, m = period.drive, period.drive.n, period.drive.q, period.drive.sized
    none = [flint.arb(0)] * (q + 1)
    of_y = [flint.arb(1), *none[1:]]
    eye = [Channel(tuple(int(i == j) for j in range(n)), 0) for i in range(n)]
    rows = state_rows(period, 0, eye[0], of_y, max(ERROR_DEGREE, q))
    for i, seen in enumerate((*eye, *drive.channels)):
        rows += state_rows(period, i + 1, seen, none, STATE_DEGREE)
    nothing = flint.arb(0)
    in_cell = InCell((nothing,) * period.W.ncols(), nothing, (nothing,) * m, nothing)
    entries = range(period.size)
    newest = tuple(flint.arb(int(i == period.command)) for i in entries)
    step = tuple(v - int(i == period.command + 1) for i, v in zip(entries, newest, strict=True))
    for output, row in ((m + 1, newest), (m + 2, step)):
        rows.append(Row(output, 0, row, tuple(none), flint.fmpq(0), in_cell))
    return rows


def state_rows(
    period: Period, output: int, seen: Channel, of_Y: Sequence[Any], degree: int
) -> list[Row]:
    """Bernstein rows of what is seen of x and the acting u, minus of_Y Y, in every cell."""
    A, of_u = period.drive.A, flint.arb(seen.of_u)
    derivatives = [flint.arb_mat([[flint.arb(v) for v in seen.of_x]])]
    for _ in range(degree + 1):
        derivatives.append(derivatives[-1] * A)
    rows, in_cells = [], {}
    for p, cell in enumerate(period.cells):
        if cell.length not in in_cells:
            in_cells[cell.length] = _in_cell(period, cell.length, derivatives, of_Y, degree)
        taylor = _polynomial_rows(period, cell, (derivatives, of_u), of_Y, degree)
        for i in range(degree + 1):
            weights = [
                flint.fmpq(math.comb(i, k), math.comb(degree, k) * math.factorial(k))
                * cell.length**k
                for k in range(i + 1)
            ]
            parts = [
                [
                    sum((w * v for w, v in zip(weights, entries, strict=False)), flint.arb(0))
                    for entries in zip(*table, strict=True)
                ]
                for table in taylor
            ]
            share = flint.fmpq(i, degree)
            rows.append(
                Row(output, p, tuple(parts[0]), tuple(parts[1]), share, in_cells[cell.length])
            )
    return rows


def _polynomial_rows(
    period: Period,
    cell: InputCell,
    seen: tuple[Sequence[Any], Any],
    of_Y: Sequence[Any],
    degree: int,
) -> tuple[list[list[Any]], list[list[Any]]]:
    """Derivatives 0 ... degree of the polynomial, over chi and over Y."""
    derivatives, of_u = seen
    n, q, size = period.drive.n, period.drive.q, period.size
    over_chi, over_Y = [], []
    for k in range(degree + 1):
        row = [flint.arb(0)] * size
        row[:n] = derivatives[k].entries()
        row[cell.acting] = (derivatives[k - 1] * period.drive.b)[0, 0] if k else of_u
        over_chi.append(row)
        over_Y.append([of_Y[j - k] if j >= k else flint.arb(0) for j in range(q + 1)])
    return over_chi, over_Y


def _in_cell(
    period: Period, h: Any, derivatives: Sequence[Any], of_Y: Sequence[Any], degree: int
) -> InCell:
    """Values at the end of a cell of length h."""
    drive, q = period.drive, period.drive.q
    growth = (absolute(drive.A) * flint.arb(h)).exp()
    last = absolute(derivatives[degree + 1]) * growth
    w = [flint.arb(0)] * drive.W.ncols()
    for k in range(degree + 1):
        through = (derivatives[k] * drive.W).entries()
        step = flint.arb(h ** (k + 1) / math.factorial(k + 1))
        w = [total + abs(v) * step for total, v in zip(w, through, strict=True)]
    step = flint.arb(h ** (degree + 2) / math.factorial(degree + 2))
    through = (last * absolute(drive.W)).entries()
    w = [total + v * step for total, v in zip(w, through, strict=True)]
    r = sum(
        (abs(of_Y[j]) * h ** (q - j + 1) / math.factorial(q - j + 1) for j in range(q + 1)),
        flint.arb(0),
    )
    step = flint.arb(h ** (degree + 1) / math.factorial(degree + 1))
    b = absolute(drive.b)
    u = abs((derivatives[degree] * drive.b)[0, 0]) + (last * b)[0, 0] * h
    x = [v * step for v in last.entries()] + [flint.arb(0)] * len(drive.channels)
    return InCell(tuple(w), r, tuple(x), u * step)


def steady(period: Period, row: Row) -> list[Any]:
    """|row Pi_p - of_Y|: what of the reference's own motion is in the output, per derivative."""
    static = (flint.arb_mat([list(row.row)]) * period.Pi[row.phase]).entries()
    return [abs(v - y) for v, y in zip(static, row.of_Y, strict=True)]

"""One period of the implemented loop, in balls.

The state is chi = (x, s, u_{k} ... ), the inputs that act or wait, newest first. At t_k it jumps,

    chi <- J chi + N n_k + R Y'_k + e eta_k

then come the cells p = 0 ... : times of constant input, cut so that no cell is long against the
plant's motions; chi <- E_p chi + int e^{A(h-s)} W w ds in x. The cells' lengths add up to T
exactly, and one of their ends is where the delayed input takes over. M = E_{J-1} ... E_0 J is the
period before a jump.

The reference's own motion is taken out: with Y = (y_d ... y_d^(q)), Y' = Phi Y + int Gamma r,
r = y_d^(q+1) and Gamma(s)_j = s^{q-j}/(q-j)!, the Pi with M Pi + E R_q = Pi Phi(T) before the jump,
Pi_0 = J Pi + R_q after it, and Pi_{p+1} = E_p Pi_p Phi(-h_p) let zeta = chi - Pi_p Y move by

    zeta <- J zeta + N n + R_{q+1} r(t_k) + e eta,
    zeta <- E_p zeta + int (e^{A(h-s)} W w - Pi_{p+1} Gamma(h-s) r) ds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.drive import Drive
from certrack.core.ball_matrices import beside, column, identity


@dataclass(frozen=True)
class InputCell:
    """A time of constant input.

    Attributes
    ----------
    length : rational, s
    acting : int
        Index in chi of the input that acts.
    transition : (N, N) ball matrix
    """

    length: Any
    acting: int
    transition: flint.arb_mat


@dataclass(frozen=True)
class Period:
    """One period of a :class:`Drive`.

    Attributes
    ----------
    drive : Drive
    jump, noise, reference, step : ball matrices of N rows
        J, N, R (q + 2 columns) and e of the module's text.
    cells : tuple of InputCell
    after : J + 1 ball matrices
        E_{J-1} ... E_p, from p = J (the identity) down to p = 0; entry p.
    Pi : J + 1 ball matrices (N, q + 1)
        At the beginning of cell p, after the jump; entry J is at the period's end.
    """

    drive: Drive
    jump: flint.arb_mat
    noise: flint.arb_mat
    reference: flint.arb_mat
    step: flint.arb_mat
    cells: tuple[InputCell, ...]
    after: tuple[flint.arb_mat, ...]
    Pi: tuple[flint.arb_mat, ...]

    @property
    def size(self) -> int:
        """Number N of entries of chi."""
        return self.jump.nrows()

    @property
    def command(self) -> int:
        """Index in chi of the newest input."""
        return self.drive.n + self.drive.memories

    def since_jump(self, phase: int) -> tuple[flint.arb_mat, ...]:
        """E_{phase-1} ... E_p for p = phase (the identity), phase - 1 ... 0."""
        over = [identity(self.size)]
        for p in range(phase - 1, -1, -1):
            over.append(over[-1] * self.cells[p].transition)
        return tuple(over)

    @property
    def map(self) -> flint.arb_mat:
        """M: a whole period, from before a jump to before the next."""
        return self.after[0] * self.jump

    @property
    def W(self) -> flint.arb_mat:
        """The columns of the uncertain terms over chi."""
        return padded(self.drive.W, self.size)


def one_period(drive: Drive, parts: tuple[int, int]) -> Period:
    """The period of a drive.

    Parameters
    ----------
    drive : Drive
    parts : two ints >= 1
        Cells before and after the delayed input takes over; the first counts only if there is
        something before.

    Raises
    ------
    NoCertificate
        If a constant reference has no steady motion of the loop.
    """
    n, memories, q = drive.n, drive.memories, drive.q
    periods = int(drive.delay.floor())
    fraction = drive.delay - periods
    inputs = periods + 2  # the last one, too, where the delay is a whole number: it tells the step
    size = n + memories + inputs
    jump = flint.arb_mat(size, size)
    command = n + memories
    for i in range(n):
        jump[i, i] = 1
    _place(jump, drive.Sx, n, 0)
    _place(jump, drive.Ss, n, n)
    _place(jump, drive.Lx, command, 0)
    _place(jump, drive.Ls, command, n)
    for i in range(1, inputs):
        jump[command + i, command + i - 1] = 1
    noise = flint.arb_mat(size, n)
    _place(noise, drive.Sx, n, 0)
    _place(noise, drive.Lx, command, 0)
    reference = flint.arb_mat(size, q + 2)
    _place(reference, drive.Sy, n, 0)
    _place(reference, drive.Ly, command, 0)
    step = flint.arb_mat(size, 1)
    step[command, 0] = 1
    cells = _cells(drive, fraction, command + periods, parts, size)
    after = [identity(size)]
    for cell in reversed(cells):
        after.append(after[-1] * cell.transition)
    after.reverse()
    Pi = _steady(drive, jump, reference, cells, after[0])
    return Period(drive, jump, noise, reference, step, cells, tuple(after), Pi)


def _cells(
    drive: Drive, fraction: Any, new: int, parts: tuple[int, int], size: int
) -> tuple[InputCell, ...]:
    """Cells with the input that acted before (index new + 1), then those with the new one."""
    cells: list[InputCell] = []
    for length, count, acting in (
        (fraction * drive.T, parts[0], new + 1),
        ((1 - fraction) * drive.T, parts[1], new),
    ):
        if length:
            cell = _held_cell(drive, length / count, acting, size)
            cells += [cell] * count
    return tuple(cells)


def _held_cell(drive: Drive, length: Any, acting: int, size: int) -> InputCell:
    n = drive.n
    block = flint.arb_mat(n + 1, n + 1)
    _place(block, drive.A * flint.arb(length), 0, 0)
    _place(block, drive.b * flint.arb(length), 0, n)
    over = block.exp()
    transition = identity(size)
    for i in range(n):
        for j in range(n):
            transition[i, j] = over[i, j]
        transition[i, acting] = over[i, n]
    return InputCell(length, acting, transition)


def _steady(
    drive: Drive,
    jump: flint.arb_mat,
    reference: flint.arb_mat,
    cells: Sequence[InputCell],
    through: flint.arb_mat,
) -> tuple[flint.arb_mat, ...]:
    """Pi at the ends of the cells; column by column, for Phi is triangular."""
    size, q = jump.nrows(), drive.q
    M, forced = through * jump, through * reference
    less = identity(size) - M
    over = shift(q, drive.T)
    columns: list[flint.arb_mat] = []
    for j in range(q + 1):
        right = column(forced, j)
        for k in range(j):
            right = right - columns[k] * over[k, j]
        try:
            columns.append(less.solve(right))
        except ZeroDivisionError:
            raise NoCertificate(
                "the sampled loop has an eigenvalue at 1: it does not follow a constant reference"
            ) from None
    Pi = beside(*columns)
    at_ends = [jump * Pi + beside(*(column(reference, j) for j in range(q + 1)))]
    for cell in cells:
        at_ends.append(cell.transition * at_ends[-1] * shift(q, -cell.length))
    return tuple(at_ends)


def shift(q: int, t: Any) -> flint.arb_mat:
    """Phi(t): (y_d ... y_d^(q)) after t, of a polynomial."""
    rows = [
        [flint.arb(t ** (j - i) / math.factorial(j - i)) if j >= i else 0 for j in range(q + 1)]
        for i in range(q + 1)
    ]
    return flint.arb_mat(rows)


def gamma(q: int, s: Any) -> flint.arb_mat:
    """Gamma(s)_j = s^{q-j}/(q-j)!."""
    return flint.arb_mat([[flint.arb(s ** (q - j) / math.factorial(q - j))] for j in range(q + 1)])


def _place(matrix: flint.arb_mat, part: flint.arb_mat, row: int, column: int) -> None:
    for i in range(part.nrows()):
        for j in range(part.ncols()):
            matrix[row + i, column + j] = part[i, j]


def padded(matrix: flint.arb_mat, size: int) -> flint.arb_mat:
    """The matrix over chi: with rows of zeros below."""
    result = flint.arb_mat(size, matrix.ncols())
    _place(result, matrix, 0, 0)
    return result

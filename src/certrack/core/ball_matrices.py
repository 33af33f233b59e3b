"""Matrices of balls, put together and taken apart."""

from __future__ import annotations

from itertools import chain

import flint


def identity(size: int) -> flint.arb_mat:
    """The identity."""
    return flint.arb_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])


def column(matrix: flint.arb_mat, j: int) -> flint.arb_mat:
    """Column j."""
    return flint.arb_mat([[matrix[i, j]] for i in range(matrix.nrows())])


def beside(*matrices: flint.arb_mat) -> flint.arb_mat:
    """Matrices side by side."""
    tables = [matrix.tolist() for matrix in matrices]
    return flint.arb_mat([list(chain(*rows)) for rows in zip(*tables, strict=True)])


def above(*matrices: flint.arb_mat) -> flint.arb_mat:
    """Matrices one above the other."""
    entries = list(chain(*(matrix.entries() for matrix in matrices)))
    return flint.arb_mat(sum(m.nrows() for m in matrices), matrices[0].ncols(), entries)


def absolute(matrix: flint.arb_mat) -> flint.arb_mat:
    """Upper bounds of the entries' magnitudes."""
    rows, columns = matrix.nrows(), matrix.ncols()
    return flint.arb_mat(rows, columns, [flint.arb(v.abs_upper()) for v in matrix.entries()])

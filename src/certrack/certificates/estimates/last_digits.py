"""The last digits of a semidefinite program's solution: Newton's method on its optimality.

At the minimiser of c . x with s = h - G x in a cone, and its dual z,

    G^T z + c = 0,      S Z + Z S = 0     (s z = 0 for the multipliers)

An interior-point solver stops where s . z is small. Where an eigenvalue of S and that of Z are both
small, z is far less accurate than that. From there Newton's method converges quadratically, if the
solution is the only one. If not, it goes anywhere on the plane through all of them, where S Z = 0,
too, but S has negative eigenvalues: such points are none of the program, and do not count.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

#: Steps at most; each must bring the residual down to this part.
NEWTON_STEPS, LEFT_AFTER_STEP = 8, 0.5

#: A slack or a dual is outside its cone by an eigenvalue below this part of its largest.
CONE_ROUNDING = 1e-9


def with_last_digits(
    program: tuple[np.ndarray, np.ndarray, np.ndarray],
    sizes: Sequence[int],
    x: np.ndarray,
    z: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """x and z, improved as far as Newton's method does.

    Parameters
    ----------
    program : arrays c, G, h
    sizes : of the semidefinite matrices
        Whose entries, in Clarabel's convention, are the first rows; the others are numbers.
    x, z : arrays
        What a solver found.
    """
    residual, nearest = optimality_residual(program, sizes, x, z), (x, z)
    for _ in range(NEWTON_STEPS):
        try:
            step = np.linalg.solve(optimality_slopes(program, sizes, x, z), -residual)
        except np.linalg.LinAlgError:
            break
        nearer = x + step[: len(x)], z + step[len(x) :]
        after = optimality_residual(program, sizes, *nearer)
        if not np.linalg.norm(after) < LEFT_AFTER_STEP * np.linalg.norm(residual):
            break
        (x, z), residual = nearer, after
        if _in_cones(program, sizes, x, z):
            nearest = nearer
    return nearest


def optimality_residual(
    program: tuple[np.ndarray, np.ndarray, np.ndarray],
    sizes: Sequence[int],
    x: np.ndarray,
    z: np.ndarray,
) -> np.ndarray:
    """What the equations of the module's text have on their left: zero at the minimiser.

    Parameters
    ----------
    program, sizes, x, z
        As :func:`with_last_digits` has them.
    """
    cost, matrix, right = program
    complementary = _product(sizes, z, (right - matrix @ x)[:, None])[:, 0]
    return np.concatenate([matrix.T @ z + cost, complementary])


def _in_cones(
    program: tuple[np.ndarray, np.ndarray, np.ndarray],
    sizes: Sequence[int],
    x: np.ndarray,
    z: np.ndarray,
) -> bool:
    """Whether slack and dual are in their cones, but for roundings."""
    _, matrix, right = program
    values = (_eigenvalues(sizes, vector) for vector in (right - matrix @ x, z))
    return all(each.min() >= -CONE_ROUNDING * np.abs(each).max() for each in values)


def _eigenvalues(sizes: Sequence[int], vector: np.ndarray) -> np.ndarray:
    """Those of each block, and the numbers behind them."""
    parts, at = [], 0
    for size in sizes:
        rows = slice(at, at := at + size * (size + 1) // 2)
        parts.append(np.linalg.eigvalsh(matrices(vector[rows, None], size)[0]))
    return np.concatenate([*parts, vector[at:]])


def optimality_slopes(
    program: tuple[np.ndarray, np.ndarray, np.ndarray],
    sizes: Sequence[int],
    x: np.ndarray,
    z: np.ndarray,
) -> np.ndarray:
    """The derivatives of :func:`optimality_residual` by x and z."""
    _, matrix, right = program
    by_x = -_product(sizes, z, matrix)
    by_z = _product(sizes, right - matrix @ x, np.eye(len(z)))
    return np.block([[np.zeros((len(x), len(x))), matrix.T], [by_x, by_z]])


def _product(sizes: Sequence[int], fixed: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(F D + D F)/2 of each block, F that of the first vector, D that of each column."""
    parts, at = [], 0
    for size in sizes:
        rows = slice(at, at := at + size * (size + 1) // 2)
        F, D = matrices(fixed[rows, None], size), matrices(columns[rows], size)
        FD = F @ D
        parts.append(vectors((FD + FD.transpose(0, 2, 1)) / 2))
    parts.append(fixed[at:, None] * columns[at:])
    return np.vstack(parts)


def matrices(columns: np.ndarray, size: int) -> np.ndarray:
    """The symmetric matrices that columns are in Clarabel's convention, one behind the other."""
    j, i = np.tril_indices(size)
    full = np.zeros((columns.shape[1], size, size))
    full[:, i, j] = full[:, j, i] = columns.T / np.where(i == j, 1.0, np.sqrt(2))
    return full


def vectors(full: np.ndarray) -> np.ndarray:
    """The columns of symmetric matrices, back again."""
    j, i = np.tril_indices(full.shape[-1])
    columns: np.ndarray = full[:, i, j].T * np.where(i == j, 1.0, np.sqrt(2))[:, None]
    return columns

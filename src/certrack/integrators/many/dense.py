"""Dense output of DOP853 from the slopes that a step has anyway.

SciPy's dense output, of order 7, needs three more evaluations of the rates in every step. Without
them order 6 is possible: the slopes k_i of the twelve stages and of the end of the step (which
begins the next one) give the states at every part theta of a step,

    x(t + theta h) = x(t) + h sum_i b_i(theta) k_i.

For order 6 the weights have to meet the order conditions of Butcher's rooted trees (Hairer,
Norsett, Wanner, Solving Ordinary Differential Equations I, II.2 and II.6), linear in b for a fixed
theta: sum_i b_i Phi_i = theta^r / gamma for every tree of r <= 6 nodes. The 37 conditions have rank
12; the one direction in which the 13 weights are still free goes into the conditions of order 7,
which are then met within 1e-5. On example1 the error is a tenth of that of SciPy's dense output.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import cache
from math import factorial, prod

import numpy as np
from scipy.integrate import DOP853

ORDER = 6

#: A rooted tree: the trees that hang on its root.
Tree = tuple["Tree", ...]


@cache
def weights() -> np.ndarray:
    """Coefficients of b_i(theta), shape (7, 13): of theta, theta^2, ..., theta^7."""
    trees = [tree for size in range(1, ORDER + 1) for tree in _trees(size)]
    sides = np.zeros((len(trees), ORDER + 1))
    for side, tree in zip(sides, trees, strict=True):
        side[_size(tree) - 1] = 1 / _density(tree)
    conditions = np.array([_elementary(tree) for tree in trees])
    left, sizes, right = np.linalg.svd(conditions)
    rank = len(sizes) - 1
    found = right[:rank].T @ ((left[:, :rank].T @ sides) / sizes[:rank, None])
    free = right[rank]

    further = _trees(ORDER + 1)
    symmetry = np.array([_symmetry(tree) for tree in further])
    conditions = np.array([_elementary(tree) for tree in further]) / symmetry[:, None]
    missing = -conditions @ found
    missing[:, ORDER] += [1 / _density(tree) for tree in further] / symmetry
    along = conditions @ free
    found += np.outer(free, along @ missing / (along @ along))
    found[np.abs(found).max(axis=1) < 1e-6] = 0.0  # four stages have no weight
    return found.T


@cache
def _trees(size: int) -> list[Tree]:
    """All rooted trees with so many nodes."""

    def branches(nodes: int, largest: int) -> Iterator[Tree]:
        if not nodes:
            yield ()
        for first in range(min(nodes, largest), 0, -1):
            for rest in branches(nodes - first, first):
                yield from ((tree, *rest) for tree in _trees(first))

    return sorted({tuple(sorted(tree)) for tree in branches(size - 1, size - 1)})


def _size(tree: Tree) -> int:
    return 1 + sum(map(_size, tree))


def _density(tree: Tree) -> int:
    """Butcher's gamma."""
    return _size(tree) * prod(map(_density, tree))


def _symmetry(tree: Tree) -> int:
    """Butcher's sigma: how strongly a tree's condition counts in the error."""
    return prod(factorial(n) * _symmetry(branch) ** n for branch, n in Counter(tree).items())


def _elementary(tree: Tree) -> np.ndarray:
    """Phi_i of every stage and of the end of the step."""
    stages = len(DOP853.B)
    table = np.zeros((stages + 1, stages + 1))
    table[:stages, :stages], table[stages, :stages] = DOP853.A, DOP853.B
    found = np.ones(stages + 1)
    for branch in tree:
        found *= table @ _elementary(branch)
    return found

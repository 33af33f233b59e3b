"""The Runge-Kutta tables against Butcher's order conditions, in exact arithmetic.

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.2: a method is of order p if
sum_i b_i Phi_i(tree) = 1 / gamma(tree) for every rooted tree of up to p nodes.
"""

from collections import Counter
from fractions import Fraction
from functools import cache
from math import factorial, prod

import numpy as np
import pytest
import scipy.integrate

from certrack.integrators.pairs import DOP853, DORMAND_PRINCE, numpy_step

PAIRS = [pytest.param(pair, id=pair.name) for pair in (DORMAND_PRINCE, DOP853)]


@cache
def trees(size):
    """All rooted trees with so many nodes; a tree is the tuple of those that hang on its root."""

    def branches(nodes, largest):
        if not nodes:
            yield ()
        for first in range(min(nodes, largest), 0, -1):
            for others in branches(nodes - first, first):
                yield from ((tree, *others) for tree in trees(first))

    return sorted({tuple(sorted(tree)) for tree in branches(size - 1, size - 1)})


def size_of(tree):
    return 1 + sum(map(size_of, tree))


def density(tree):
    """Butcher's gamma."""
    return size_of(tree) * prod(map(density, tree))


def symmetry(tree):
    """Butcher's sigma: how strongly a tree's condition counts in the error."""
    return prod(factorial(n) * symmetry(branch) ** n for branch, n in Counter(tree).items())


def table_of(pair):
    """The rows of A, and B for the end of the step."""
    s = pair.stages
    table = np.zeros((s + 1, s + 1))
    table[:s, :s], table[s, :s] = pair.A, pair.B
    return table


def elementary(tree, table):
    """Phi_i of every row of the table."""
    phi = np.ones(len(table), dtype=table.dtype)
    for branch in tree:
        phi = phi * (table @ elementary(branch, table))
    return phi


def exact(table):
    """The same numbers as fractions."""
    return np.vectorize(Fraction, otypes=[object])(np.array(table, dtype=float))


#: What the rounding of the coefficients to double precision leaves of a condition; exact arithmetic
#: adds nothing to it. Measured: at most 9e-16.
ROUNDED = 4e-15


def largest_residual(weights, pair, nodes, right=1):
    """Of the conditions sum_i weights_i Phi_i = right / gamma of all trees with so many nodes."""
    table, weights = exact(table_of(pair)), exact(weights)
    residuals = [
        weights @ elementary(tree, table) - Fraction(right, density(tree)) for tree in trees(nodes)
    ]
    return float(max(map(abs, residuals)))


def test_there_are_as_many_trees_as_there_should_be():
    assert [len(trees(size)) for size in range(1, 9)] == [1, 1, 2, 4, 9, 20, 48, 115]


@pytest.mark.parametrize("pair", PAIRS)
def test_the_order_of_the_method(pair):
    """All conditions hold up to the coefficients' rounding; those of the next order do not."""
    weights = np.append(pair.B, 0.0)
    for nodes in range(1, pair.order + 1):
        assert largest_residual(weights, pair, nodes) < ROUNDED
    assert largest_residual(weights, pair, pair.order + 1) > 1e-5


@pytest.mark.parametrize("pair", PAIRS)
def test_the_orders_of_the_error_estimates(pair):
    """The difference of two methods that agree up to the lower one's order, and not beyond it."""
    for weights, order in zip(pair.errors, pair.error_orders, strict=True):
        for nodes in range(1, order + 1):
            assert largest_residual(weights, pair, nodes, right=0) < ROUNDED
        assert largest_residual(weights, pair, order + 1, right=0) > 1e-5


@pytest.mark.parametrize("pair", PAIRS)
def test_nodes_are_the_sums_of_their_rows(pair):
    missing = exact(pair.A).sum(axis=1) - exact(pair.C)
    assert max(map(abs, missing)) < 2 * ROUNDED
    assert (np.triu(pair.A) == 0).all()


def test_dormand_prince_in_fractions():
    """Its coefficients are fractions, and as such meet every condition exactly."""

    def fractions(table):
        found = np.vectorize(lambda x: Fraction(x).limit_denominator(400_000), otypes=[object])
        assert (found(table).astype(float) == table).all()
        return found(table)

    pair, order = DORMAND_PRINCE, 5
    table, weights = fractions(table_of(pair)), fractions(np.append(pair.B, 0.0))
    for nodes in range(1, order + 1):
        for tree in trees(nodes):
            phi = elementary(tree, table)
            assert weights @ phi == Fraction(1, density(tree))
            assert nodes == order or fractions(pair.errors[0]) @ phi == 0


def test_the_tables_are_those_of_scipy():
    """Bit for bit."""
    ours, scipys = DORMAND_PRINCE, scipy.integrate.RK45
    np.testing.assert_array_equal(ours.A[:, :5], scipys.A)
    for mine, theirs in ((ours.B, scipys.B), (ours.C, scipys.C), (ours.errors[0], scipys.E)):
        np.testing.assert_array_equal(mine, theirs)
    ours, scipys = DOP853, scipy.integrate.DOP853
    pairs = zip((ours.A, ours.B, ours.C, *ours.errors), "A B C E5 E3".split(), strict=True)
    for mine, name in pairs:
        np.testing.assert_array_equal(mine, getattr(scipys, name))


@pytest.mark.parametrize("pair", PAIRS)
def test_nobody_changes_a_table(pair):
    for table in (pair.A, pair.B, pair.C, *pair.errors):
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 1.0


@pytest.mark.parametrize("pair", PAIRS)
def test_a_step_is_as_accurate_as_its_order(pair):
    """Where a step is halved, its error falls by 2^(order + 1)."""

    def error(h):
        start = np.array([[1.0], [0.0]])
        _, end = numpy_step(pair, h, start, lambda _, x: np.array([x[0] * x[1], -(x[0] ** 2)]))
        return np.abs(end[:, 0] - [1 / np.cosh(h), -np.tanh(h)]).max()

    assert error(0.25) / error(0.125) == pytest.approx(2 ** (pair.order + 1), rel=0.3)


def derived_dense_weights(order=6):
    """Coefficients of b_i(theta), shape (order + 1, s + 1), from the order conditions.

    Those of `order` leave one direction free; it goes into those of the next order (see pairs.py).
    """
    table = table_of(DOP853)
    rooted = [tree for size in range(1, order + 1) for tree in trees(size)]
    sides = np.zeros((len(rooted), order + 1))
    for side, tree in zip(sides, rooted, strict=True):
        side[size_of(tree) - 1] = 1 / density(tree)
    conditions = np.array([elementary(tree, table) for tree in rooted])
    left, sizes, right = np.linalg.svd(conditions)
    rank = len(sizes) - 1
    assert sizes[rank] < 1e-12 < 1e-6 < sizes[rank - 1]
    weights = right[:rank].T @ ((left[:, :rank].T @ sides) / sizes[:rank, None])
    free = right[rank]

    further = trees(order + 1)
    weight = np.array([symmetry(tree) for tree in further])
    conditions = np.array([elementary(tree, table) for tree in further]) / weight[:, None]
    missing = -conditions @ weights
    missing[:, order] += [1 / density(tree) for tree in further] / weight
    along = conditions @ free
    weights += np.outer(free, along @ missing / (along @ along))
    return weights.T


def test_dense_output_is_the_derived_one():
    derived = derived_dense_weights()
    np.testing.assert_allclose(DOP853.dense, derived, rtol=1e-10, atol=1e-8)
    zero = np.abs(derived).max(axis=0) < 1e-6
    assert zero.sum() == 4
    np.testing.assert_array_equal(DOP853.dense[:, zero], 0.0)


def test_dense_output_is_of_order_6_and_ends_as_the_step_does():
    """The error at every part of a step falls by 2^7 where the step is halved."""

    def error(h):
        solver = scipy.integrate.DOP853(
            lambda t, y: [-y[0] * y[1], np.cos(t)], 0.3, [1.0, 0.2], 2, first_step=h
        )
        solver.step()
        assert solver.t == pytest.approx(0.3 + h)
        theta = np.linspace(0.1, 0.9, 9)
        found = solver.y_old[:, None] + h * solver.K.T @ powers(theta)
        t = 0.3 + theta * h
        y = 0.2 + np.sin(t) - np.sin(0.3)
        rise = 0.2 * (t - 0.3) - np.cos(t) + np.cos(0.3) - np.sin(0.3) * (t - 0.3)
        return np.abs(found - [np.exp(-rise), y]).max()

    def powers(theta):
        return DOP853.dense.T @ theta ** np.arange(1, 8)[:, None]

    np.testing.assert_allclose(powers(np.ones(1))[:, 0], [*DOP853.B, 0], atol=1e-9)
    assert error(0.5) / error(0.25) == pytest.approx(2**7, rel=0.5)
    assert error(0.5) < 1e-6

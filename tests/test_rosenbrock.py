"""The table of the linearly implicit method against the order conditions, and its matrices in C.

Hairer, Wanner, Solving Ordinary Differential Equations II, IV.7: with alpha where the rates are
evaluated, Gamma = (gamma_ij) and beta = alpha + Gamma, a method is of order p if
sum_i b_i Phi_i(tree) = 1 / density(tree) for every rooted tree of up to p nodes, where a node with
one branch sums with beta, and any other with alpha. The table has a = alpha Gamma^-1,
coupling = 1/gamma - Gamma^-1 and m = b Gamma^-1 in their place.
"""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_pairs import density, trees

from certrack.integrators.many.implicit_source import (
    LEAST_PIVOT,
    solve_function,
    triangular_factors,
)
from certrack.integrators.rosenbrock import RODAS5P

#: What the rounding of coefficients up to 150 leaves of a condition. Measured: 6e-14.
ROUNDED = 5e-13


def original():
    """alpha, Gamma and the inverse of Gamma."""
    inverse = np.eye(RODAS5P.stages) / RODAS5P.gamma - RODAS5P.coupling
    gammas = np.linalg.inv(inverse)
    return RODAS5P.A @ gammas, gammas


def elementary(tree, alpha, beta):
    """Phi_i of every stage."""
    sums = beta if len(tree) == 1 else alpha
    return math.prod(
        (sums @ elementary(branch, alpha, beta) for branch in tree), start=np.ones(len(alpha))
    )


def largest_residual(weights, nodes, theta=1.0, right=1.0):
    """Of sum_i b_i Phi_i = right theta^nodes / density, of all trees with so many nodes."""
    alpha, gammas = original()
    b = weights @ gammas
    return max(
        abs(b @ elementary(tree, alpha, alpha + gammas) - right * theta**nodes / density(tree))
        for tree in trees(nodes)
    )


def test_the_order_of_the_method():
    for nodes in range(1, RODAS5P.order + 1):
        assert largest_residual(RODAS5P.B, nodes) < ROUNDED
    assert largest_residual(RODAS5P.B, RODAS5P.order + 1) > 1e-5


def test_the_order_of_the_error_estimate():
    """The difference of two methods that agree up to the lower one's order, and not beyond it."""
    for nodes in range(1, RODAS5P.error_order + 1):
        assert largest_residual(RODAS5P.errors, nodes, right=0.0) < ROUNDED
    assert largest_residual(RODAS5P.errors, RODAS5P.error_order + 1, right=0.0) > 1e-5


@pytest.mark.parametrize("theta", [0.1, 0.37, 0.5, 0.82, 1.0])
def test_the_order_of_the_dense_output(theta):
    weights = theta ** np.arange(1, len(RODAS5P.dense) + 1) @ RODAS5P.dense
    for nodes in range(1, 5):
        assert largest_residual(weights, nodes, theta) < ROUNDED
    if theta == 1.0:
        assert weights == pytest.approx(RODAS5P.B, abs=1e-13)
    else:
        assert largest_residual(weights, 5, theta) > 1e-6


def test_times_are_those_of_the_stages():
    """C and the weights of the derivative by time are sums of alpha and Gamma."""
    alpha, gammas = original()
    assert alpha.sum(axis=1) == pytest.approx(RODAS5P.C, abs=ROUNDED)
    assert gammas.sum(axis=1) == pytest.approx(RODAS5P.slope, abs=ROUNDED)
    assert np.triu(RODAS5P.A).any() == np.triu(RODAS5P.coupling).any() == False  # noqa: E712


def stability(z):
    """What a step makes of x' = z x with step 1."""
    k = np.zeros(RODAS5P.stages, dtype=complex)
    for i in range(RODAS5P.stages):
        right = z * (1 + RODAS5P.A[i] @ k) + RODAS5P.coupling[i] @ k
        k[i] = right / (1 / RODAS5P.gamma - z)
    return 1 + RODAS5P.B @ k


def test_it_is_l_stable():
    """|R| <= 1 on the imaginary axis, and so in the left half-plane; R vanishes at infinity."""
    axis = 1j * np.concatenate([np.linspace(0, 50, 2001), np.logspace(1.7, 6, 500)])
    assert max(abs(stability(z)) for z in axis) < 1 + 1e-12
    assert abs(stability(-1e9)) < 1e-6
    assert stability(-0.1) == pytest.approx(math.exp(-0.1), abs=1e-8)


def step(h, t, x, rates, partials, by_time):
    """The slopes of one step of a system."""
    k = np.zeros((RODAS5P.stages, len(x)))
    matrix = np.eye(len(x)) / RODAS5P.gamma - h * partials(t, x)
    for i in range(RODAS5P.stages):
        right = rates(t + RODAS5P.C[i] * h, x + h * RODAS5P.A[i] @ k) + RODAS5P.coupling[i] @ k
        k[i] = np.linalg.solve(matrix, right + h * RODAS5P.slope[i] * by_time(t, x))
    return k


def test_it_converges_with_its_order():
    """x' = -x^2 + cos(t) - ..., whose solution is (1/(1+t), sin(t)), on halved steps."""

    def exact(t):
        return np.array([1 / (1 + t), math.sin(t)])

    def rates(t, x):
        first = -(x[0] ** 2) + x[1] * x[0] - math.sin(t) * x[0]
        return np.array([first, math.cos(t) + x[0] * (1 + t) - 1])

    def partials(t, x):
        return np.array([[-2 * x[0] + x[1] - math.sin(t), x[0]], [1 + t, 0.0]])

    def by_time(t, x):
        return np.array([-math.cos(t) * x[0], -math.sin(t) + x[0]])

    errors, inside = [], []
    for count in (8, 16, 32, 64):
        h, x = 2.0 / count, exact(0.0)
        for n in range(count):
            k = step(h, n * h, x, rates, partials, by_time)
            if n == count // 2:
                weights = 0.5 ** np.arange(1, 5) @ RODAS5P.dense
                inside.append(np.abs(x + h * weights @ k - exact((n + 0.5) * h)).max())
            x = x + h * RODAS5P.B @ k
        errors.append(np.abs(x - exact(2.0)).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] == pytest.approx(5, abs=0.3), errors
    assert (np.log2(np.array(inside[:-1]) / inside[1:]) > 3.7).all(), inside


def in_python(text, **names):
    """Run the body of a C function of vectors on numbers; what it leaves."""
    body = re.sub(r"^INLINE.*\{$|^\}$|^  \(void\).*$", "", text, flags=re.M)
    body = body.replace("~(I){0}", "True").replace("  return holds;", "").replace("SPLAT", "")
    body = re.sub(r"^  (?:[IV] )?(.*);$", r"\1", body, flags=re.M)
    scope = {"v_abs": abs, "GAMMA": RODAS5P.gamma} | names
    exec(body, scope)
    return scope


@st.composite
def sparse_matrices(draw):
    size = draw(st.integers(1, 6))
    places = draw(st.sets(st.tuples(*[st.integers(0, size - 1)] * 2), max_size=size**2))
    numbers = st.floats(-3, 3, allow_nan=False)
    return size, sorted(places), [draw(numbers) for _ in places], draw(st.floats(0.01, 0.3))


@given(matrix=sparse_matrices(), timed=st.sets(st.integers(0, 5)))
def test_the_factors_solve_the_system(matrix, timed):
    """Whatever the pattern of zeros, where the pivots hold; else that is said."""
    size, places, values, h = matrix
    timed = sorted(row for row in timed if row < size)
    factors, text = triangular_factors(size, places)
    m, f = np.zeros(factors.count), np.arange(1.0, size + 1)
    try:
        holds = in_python(text, h=h, j=values, m=m)["holds"]
    except ZeroDivisionError:
        holds = False
    dense = np.eye(size) / RODAS5P.gamma
    for (row, column), value in zip(places, values, strict=True):
        dense[row, column] -= h * value
    if not holds:
        return
    d = np.arange(2.0, 2 + len(timed))
    right = f.copy()
    right[timed] += 0.7 * d
    in_python(solve_function(factors, timed), m=m, d=d, weight=0.7, f=f)
    assert np.abs(dense @ f - right).max() < 1e-9 * (1 + np.abs(f).max())


def test_a_small_pivot_does_not_hold():
    """x' = a x with h a near 1/gamma, or beyond it, where a step would damp what grows."""
    _, text = triangular_factors(1, [(0, 0)])
    critical = 1 / RODAS5P.gamma
    for value, expected in (
        (critical, False),
        (critical * (1 + 0.5 * LEAST_PIVOT), False),
        (critical * (1 - 2 * LEAST_PIVOT), True),
        (critical * (1 + 2 * LEAST_PIVOT), False),
        (10 * critical, False),
        (-10 * critical, True),
        (math.nan, False),
    ):
        try:
            holds = in_python(text, h=1.0, j=[value], m=[0.0])["holds"]
        except ZeroDivisionError:
            holds = False
        assert bool(holds) == expected, value


def test_a_chain_has_as_few_factors_as_its_feedback():
    """x_i' = x_{i+1}, x_n' = a feedback of all: 3 n - 2 factors, where a full matrix has n^2."""
    n = 12
    places = [(i, i + 1) for i in range(n - 1)] + [(n - 1, j) for j in range(n)]
    factors, _ = triangular_factors(n, places)
    assert factors.count == 3 * n - 2


def test_nobody_changes_the_table():
    for table in (RODAS5P.A, RODAS5P.coupling, RODAS5P.B, RODAS5P.C, RODAS5P.dense):
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 1.0

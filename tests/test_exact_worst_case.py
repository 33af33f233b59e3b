"""The worst case of robust loops by a linear program of its own, and what `falsify` finds of it.

The program shares nothing with the package but the law's matrices: the closed loop in the plant's
states, disturbances with the signs of their kernels, and y_d^(q+1) free in every step, with all
derivatives below it as variables within their bounds. Disturbances do not grow here, so that it is
exact but for its steps, which only take from it; between them the reference may pass a bound by
a thousandth or so.
"""

import numpy as np
import pytest
from depth import depth
from scipy import sparse
from scipy.linalg import expm
from scipy.optimize import linprog

import certrack
from certrack.studies.falsifier.falsify import falsify

#: Steps, and the horizon in slowest time constants.
STEPS, TIME_CONSTANTS = 900, 9.0


def random_third_order(seed):
    """A third-order plant under the robust law, of any feed-forward order."""
    rng = np.random.default_rng([seed, 3])
    a, c = rng.uniform(-1, 1, 3).round(3).tolist(), rng.uniform(1, 4, 3).round(3).tolist()
    return certrack.System(
        plant=certrack.Plant(
            states=["x1", "x2", "x3"],
            chain=[1, 1],
            drift=f"({a[0]!r})*x1 + ({a[1]!r})*x2 + ({a[2]!r})*x3",
            input_gain=2,
            gain_sign=1,
            uncertainty={
                "tau": [1, 1, 1],
                "gamma": [0, 0, 0],
                "beta": rng.uniform(0, 0.2, 3).round(4).tolist(),
            },
        ),
        law=certrack.Robust(c=c, feedforward=seed % 3),
        reference=certrack.SymbolicReference(f"0.3*sin({rng.uniform(0.5, 3):.3f}*t)"),
        truth=certrack.Truth(input_gain=2),
        settings=certrack.Settings(x0=[0.0] * 3, duration=10),
    )


def exact_worst_case(system, steps=STEPS, of="error"):
    """The largest e_1, u or state at the end of a long run."""
    c, n = system.controller.coordinates, 3
    m = c.q + 1
    Y = system.reference.bounds(m).values
    loop = np.zeros((n + m, n + m + 1 + n))  # of x, y ... y^(m-1), y^(m) and w
    loop[0, 1] = loop[1, 2] = 1.0
    loop[2, :n] = c.nu_x
    loop[2, n : n + m + 1] = c.nu_Y
    loop[:n, n + m + 1 :] = np.diag(system.plant.uncertainty.tau)
    for i in range(m):
        loop[n + i, n + i + 1] = 1.0
    slowest = -float(c.poles.real.max())
    dt = TIME_CONSTANTS / slowest / steps
    whole = np.zeros((loop.shape[1],) * 2)
    whole[: n + m] = loop
    step = expm(whole * dt)[: n + m]
    E, of_top, of_w = step[:, : n + m], step[:, n + m], step[:, n + m + 1 :]
    row, at_once = np.zeros(n + m), 0.0
    if of == "error":
        row[0], row[n] = 1.0, -1.0
    elif of == "input":
        parts = system.plant.drift.expr.as_coefficients_dict()
        h = [float(parts[name]) for name in system.plant.symbols]
        row[:n], row[n:] = (c.nu_x - h) / 2, c.nu_Y[:m] / 2  # g_n = 2
        at_once = abs(c.nu_Y[m]) / 2 * Y[m]
    else:
        row[system.plant.states.index(of)] = 1.0
    tops, by_w = np.zeros(steps), 0.0
    for k in range(steps - 1, -1, -1):
        tops[k] = row @ of_top
        by_w += np.abs(row @ of_w) @ np.array(system.plant.uncertainty.beta)
        row = row @ E
    at_rest = np.linalg.solve(c.A, c.B)
    gains = np.concatenate([row[:n] @ at_rest + row[n:], np.zeros(m * steps), tops])
    moves = sparse.kron(sparse.eye(steps), np.eye(m)).tolil()
    moves = sparse.hstack([sparse.csr_matrix((m * steps, m)), moves]).tolil()
    for k in range(steps):
        moves[m * k : m * (k + 1), m * k : m * (k + 1)] = -E[n:, n:]
    inputs = sparse.kron(sparse.eye(steps), -of_top[n:, None])
    sizes = [*np.tile(Y[:m], steps + 1), *[Y[m]] * steps]
    solved = linprog(
        -gains,
        A_eq=sparse.hstack([moves, inputs]).tocsr(),
        b_eq=np.zeros(m * steps),
        bounds=[(-v, v) for v in sizes],
        method="highs",
    )
    assert solved.x is not None, solved.message
    return by_w - solved.fun + at_once


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_what_is_found_is_the_exact_worst_case(seed):
    system = random_third_order(seed)
    exact, found = exact_worst_case(system), falsify(system, budget=100)
    assert found.origin == "kernels"
    assert found.worst_error >= 0.99 * exact
    assert found.worst_error <= found.against.bound


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(3, depth(6, 12)))
def test_what_is_found_is_the_exact_worst_case_of_others(seed):
    system = random_third_order(seed)
    exact, found = exact_worst_case(system), falsify(system, budget=100)
    assert 0.99 * exact <= found.worst_error <= found.against.bound


def test_of_the_lean_drive_what_was_found_elsewhere():
    assert falsify(certrack.load("dual-motor-lean"), budget=100).worst_error > 0.00121

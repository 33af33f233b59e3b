"""The recursion against the paper's numbers and against symbolic backstepping."""

import math

import numpy as np
import pytest
import sympy
from conftest import relative, systems
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack.core.errors import DesignError, InputError
from certrack.core.expressions import TIME, symbol
from certrack.laws import Adaptive, Robust
from certrack.laws.backstepping import Gains
from certrack.laws.integral import longer_chain, of_the_chain
from certrack.laws.plant_coordinates import balancing_feedforward, plant_coordinates
from certrack.laws.recursion import recursion
from certrack.model.plant import MAX_ORDER, Plant
from certrack.testing import LawConformance

# Theory: Actuators 14:367, Examples 1 and 2, recomputed to 8 decimals.
EXAMPLE_2_A = [
    [1, 0, 0, 0],
    [3.5, 1, 0, 0],
    [1.40451389, 0.95486111, 1, 0],
    [37.07355978, 17.84523232, 16.10897664, 1],
]
EXAMPLE_2_B = [1, 3.5, 2.40451389, 53.18253642]
EXAMPLE_2_KAPPA = [2.5, 6.95833333, 3.65064331, 267.04359722]


def test_example_1():
    found = certrack.load("example1").controller.coordinates
    np.testing.assert_allclose(found.A, [[1, 0], [1.75, 1]], atol=1e-8)
    np.testing.assert_allclose(found.B[:, 0], [1, 3.25], atol=1e-8)
    np.testing.assert_allclose(found.kappa, [5.5, 0.5 + 0.25 * 1.75**2], atol=1e-8)


def test_example_2():
    found = certrack.load("dual-motor").controller.coordinates
    np.testing.assert_allclose(found.A, EXAMPLE_2_A, atol=1e-8)
    np.testing.assert_allclose(found.B[:, 0], EXAMPLE_2_B, atol=1e-8)
    np.testing.assert_allclose(found.kappa, EXAMPLE_2_KAPPA, atol=1e-8)
    norm = np.linalg.norm(np.linalg.inv(found.A))
    assert norm == pytest.approx(17.90056, abs=1e-5)


def test_classic_law_of_example_1_is_the_papers():
    """[48]: the last input before the estimates, written out by hand."""
    controller = certrack.load("example1-classic").controller
    x1, x2, y0, y1, y2 = map(symbol, ("x1", "x2", "y_d_0", "y_d_1", "y_d_2"))
    e1, c1, c2 = x1 - y0, sympy.Integer(1), sympy.Rational(1, 2)
    e2 = x2 - (-c1 * e1 + 3 * x1 + y1) / 2
    phi = 1 + x1 * sympy.sin(x2)
    ubar = (
        -c2 * e2
        - 2 * e1
        - x1**2 * x2
        - phi * symbol("theta_hat_1")
        + c1 / 2 * y1
        + y2 / 2
        + (3 - c1) / 2 * (2 * x2 - 3 * x1)
    )
    values = dict(zip(controller.symbols, controller.values, strict=True))
    ours = controller.equations.u.subs(values) / symbol("delta_hat")
    assert sympy.simplify(sympy.nsimplify(ours - ubar)) == 0


@given(systems())
def test_error_system_holds_for_random_plants(system):
    """Both sides of e' = (S - C - K) e + T w - R y_d^(q+1) + ... evaluated, n = 1 ... 8."""
    kit = LawConformance()
    kit.system = system
    kit.test_loop_holds_the_plant_and_the_input()


@settings(max_examples=12)
@given(systems(orders=st.integers(1, 5)))
def test_random_nominal_loops_are_as_the_laws_state(system):
    """With w = 0 and the law's input: e' = (S - C - K) e - R y_d^(q+1) + mismatch, and V'."""
    kit = LawConformance()
    kit.system = system
    kit.test_obeys_its_error_system()
    kit.test_its_energy_falls_as_stated()


def symbolic_backstepping(plant, gains, q):
    """nu by differentiating every stabilising function along the nominal chain; no shortcut."""
    n, x = plant.n, plant.symbols
    y = sympy.Function("y")(TIME)
    g = [sympy.nsimplify(v.expr) for v in plant.chain]
    b = [[v.expr for v in row] for row in plant.linear]
    chain = [g[i] * x[i + 1] + sum(b[i][j] * x[j] for j in range(i + 1)) for i in range(n - 1)]
    c = [sympy.Rational(repr(v)) for v in gains.c]
    virtual, e_before, g_before = y, sympy.Integer(0), sympy.Integer(0)
    highest = y.diff(TIME, q + 1)
    for m in range(n):
        e = x[m] - virtual
        rate = sum(virtual.diff(x[j]) * chain[j] for j in range(m)) + virtual.diff(TIME)
        eta = [virtual.diff(x[j]) for j in range(m)]
        young = [(0 if math.isinf(k) else 1 / (4 * sympy.Rational(repr(k)))) for k in gains.k[m]]
        kappa = young[2 * m] + young[2 * m + 1]
        kappa += sum((young[2 * i] + young[2 * i + 1]) * eta[i] ** 2 for i in range(m))
        if m < n - 1:
            residual = rate.expand().coeff(highest)
            if not math.isinf(gains.p[m]):
                kappa += residual**2 / (4 * sympy.Rational(repr(gains.p[m])))
            rate = (rate - residual * highest).expand()
        wanted = -(c[m] + kappa) * e - g_before * e_before + rate
        if m == n - 1:
            return wanted - plant.drift.expr
        known = sum(b[m][j] * x[j] for j in range(m + 1))
        virtual, e_before, g_before = ((wanted - known) / g[m]).expand(), e, g[m]
    raise AssertionError


@given(systems(orders=st.integers(1, 4), kinds=("robust",)))
def test_symbolic_backstepping_gives_the_same_law(system):
    plant, law = system.plant, system.law
    q = law.order(plant)
    nu = symbolic_backstepping(plant, law.gains(), q)
    y = sympy.Function("y")(TIME)
    found = system.controller.coordinates
    for i in range(q + 1, -1, -1):  # higher derivatives first, y itself last
        nu = nu.subs(y.diff(TIME, i) if i else y, symbol(f"Y{i}"))
    rest = sympy.expand(nu + plant.drift.expr)
    ours = [float(v) for v in (*found.nu_x, *found.nu_Y)]
    variables = (*plant.symbols, *(symbol(f"Y{i}") for i in range(q + 2)))
    theirs = [float(rest.coeff(v)) for v in variables]
    assert relative(ours, theirs) < 1e-9


@given(systems(kinds=("robust",)))
def test_a_has_unit_diagonal_and_residual_ends_with_zero(system):
    found = system.controller.coordinates
    assert np.all(np.diag(found.A) == 1)
    assert np.all(np.triu(found.A, 1) == 0)
    assert found.B[0].tolist() == [1.0] + [0.0] * found.q
    assert found.R[-1] == 0
    if found.q == found.n - 1:
        assert np.allclose(found.R, 0)


def test_fifty_states_are_designed():
    rng = np.random.default_rng(1)
    g, b = rng.uniform(0.5, 2, 49), np.tril(rng.normal(size=(49, 50)))
    for q in (0, 49):
        found = recursion(g, b, Gains(c=[1.0] * 50), q)
        assert np.isfinite(found.nu_x).all()


def test_damping_that_overflows_is_refused_with_the_remedy():
    n = 14
    gains = Gains(c=[1] * n, k=[[0.1] * (2 * m) for m in range(1, n + 1)], p=[0.1] * (n - 1))
    with pytest.raises(DesignError, match=r"overflows at step \d+ of 14.*Raise k and p"):
        recursion(np.ones(n - 1), np.zeros((n - 1, n)), gains)


def test_first_order_plant_has_no_virtual_control():
    plant = Plant(states=["x1"], drift="-x1", input_gain=2)
    law = Robust(c=[3])
    found = law.design(plant).coordinates
    assert found.eta == []
    assert found.d.shape == (0, 1)
    assert found.nu_x.tolist() == [-3]
    assert found.nu_Y.tolist() == [3, 1]


@pytest.mark.parametrize(
    ("gains", "key"),
    [
        ({"c": [1]}, "law.c"),
        ({"c": [1, 0]}, "law.c[1]"),
        ({"c": [1, -1]}, "law.c[1]"),
        ({"c": [1, math.nan]}, "law.c[1]"),
        ({"c": [1, math.inf]}, "law.c[1]"),
        ({"c": "12"}, "law.c"),
        ({"c": [1, 1], "k": [[1, 1]]}, "law.k"),
        ({"c": [1, 1], "k": [[1, 1], [1, 1]]}, "law.k[1]"),
        ({"c": [1, 1], "k": [[1, 0], [1, 1, 1, 1]]}, "law.k[0][1]"),
        ({"c": [1, 1], "p": [1, 1]}, "law.p"),
        ({"c": [1, 1], "p": [-1]}, "law.p[0]"),
        ({"c": [1, 1], "feedforward": 2}, "law.feedforward"),
        ({"c": [1, 1], "feedforward": -1}, "law.feedforward"),
        ({"c": [1, 1], "feedforward": 0.5}, "law.feedforward"),
        ({"c": [1, 1], "Gamma": [[1, 2], [2, 1]]}, "law.Gamma"),
        ({"c": [1, 1], "Gamma": [1]}, "law.Gamma"),
        ({"c": [1, 1], "Gamma": [[1, 0.5], [0.2, 1]]}, "law.Gamma"),
        ({"c": [1, 1], "Gamma": [1, -1]}, "law.Gamma[1]"),
        ({"c": [1, 1], "theta0": [1]}, "law.theta0"),
        ({"c": [1, 1], "gain_rate": 0}, "law.gain_rate"),
        ({"c": [1, 1], "leak_gain": -1}, "law.leak_gain"),
    ],
)
def test_bad_gains_are_named(gains, key):
    plant = Plant(states=["x1", "x2"], chain=[1], regressor=["x1", "x2"])
    with pytest.raises(InputError) as caught:
        Adaptive(**gains).design(plant)
    assert str(caught.value).startswith(f"{key}: ")


def test_the_slowest_and_the_fastest_pole():
    """[[-c_1, g], [-g, -c_2]], solved by hand."""
    plant = Plant(states=["x1", "x2"], chain=[0.5], input_gain=1)
    found = Robust(c=(1.0, 4.0)).coordinates(plant)
    half, root = 2.5, math.sqrt(1.5**2 - 0.5**2)
    assert found.slowest_pole == pytest.approx(half - root)
    assert found.fastest_pole == pytest.approx(half + root)


@pytest.mark.parametrize("step", [2, 3])
def test_the_step_whose_damping_overflows_is_named(step):
    k = [[math.inf] * (2 * m) for m in range(1, 4)]
    k[0] = [1e-130, 1]
    k[step - 1][0] = 1e-60  # times eta^2, which is (1e130)^2 after step 1
    plant = Plant(states=["x1", "x2", "x3"], chain=[1, 1], input_gain=1)
    with pytest.raises(DesignError, match=f"overflows at step {step} of 3"):
        recursion(plant.g, plant.b, Gains((1, 1, 1), k))


def test_a_design_whose_coefficients_have_no_square_is_refused():
    """They are finite, but the certificates square them."""
    plant = Plant(states=["x1", "x2"], chain=[1], input_gain=1)
    with pytest.raises(DesignError, match="the design overflows"):
        recursion(plant.g, plant.b, Gains((1e160, 1.0)))
    assert recursion(plant.g, plant.b, Gains((1e140, 1.0))).n == 2


@pytest.mark.parametrize("coupling", [None, 0.6])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_the_error_matrix_is_that_of_the_closed_chain(n, coupling):
    """x' = F x with x_n' = nu_x x, in e = A x; lambda_m = eta_m x + d_m Y is x_{m+1} - e_{m+1}."""
    rng = np.random.default_rng(n)
    g, b = rng.uniform(0.5, 2, n - 1) * rng.choice([-1, 1], n - 1), np.tril(rng.normal(size=(n, n)))
    gains = Gains(tuple(rng.uniform(1, 3, n)), coupling=coupling)
    for q in range(n):
        found = recursion(g, b[: n - 1], gains, q)
        loop = np.vstack([found.F, found.nu_x])
        expected = found.A @ loop @ np.linalg.inv(found.A)
        assert found.error_matrix == pytest.approx(expected, abs=1e-10 * np.abs(found.A).max())
        assert sorted(np.abs(found.poles)) == pytest.approx(
            sorted(np.abs(np.linalg.eigvals(loop))), rel=1e-6
        )
        x, Y = rng.normal(size=n), rng.normal(size=q + 1)
        e = found.A @ x - found.B @ Y
        for m in range(1, n):
            virtual = found.eta[m - 1] @ x[:m] + found.d[m - 1] @ Y
            assert x[m] - virtual == pytest.approx(e[m], abs=1e-12 * np.abs(found.A).max())
        assert list(found.R[:-1]) == list(found.B[:-1, q]) and found.R[-1] == 0


@pytest.mark.parametrize("coupling", [None, 0.6])
@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_errors_of_perfect_tracking_are_zero(n, coupling):
    """With all derivatives fed forward: x_1 = y_d and x_{i+1} = (x_i' - sum_j b_ij x_j)/g_i."""
    rng = np.random.default_rng(10 + n)
    g, b = rng.uniform(0.5, 2, n - 1) * rng.choice([-1, 1], n - 1), np.tril(rng.normal(size=(n, n)))
    design = recursion(g, b[: n - 1], Gains(tuple(rng.uniform(1, 3, n)), coupling=coupling), n - 1)
    states = np.zeros((n, n))  # each state as a combination of y_d, y_d' ...
    states[0, 0] = 1.0
    for i in range(n - 1):
        derivative = np.append(0.0, states[i, :-1])
        states[i + 1] = (derivative - b[i, : i + 1] @ states[: i + 1]) / g[i]
    errors = design.A @ states - design.B
    assert np.abs(errors).max() < 1e-12 * np.abs(design.A).max() * np.abs(states).max()


def random_chain(n, seed):
    """g and b of n states, and gains."""
    rng = np.random.default_rng(seed)
    g = rng.uniform(0.5, 2, n - 1) * rng.choice([-1, 1], n - 1)
    return g, np.tril(rng.normal(size=(n, n)))[: n - 1], tuple(rng.uniform(1, 3, n)), rng


@pytest.mark.parametrize("coupling", [None, 0.6])
@pytest.mark.parametrize("n", [1, 2, 4])
def test_integral_action_closes_the_chain_with_its_own_state(n, coupling):
    """e_0' = x_1 - y_d = e_1 - c_0 e_0; (e_0, e)' = M (e_0, e) - R y_d^(q+1), with nu as stated."""
    g, b, c, rng = random_chain(n, n)
    gains = Gains(c, coupling=coupling, integral=1.7)
    for q in range(n):
        found = recursion(g, b, gains, q)
        part = found.integral
        assert (found.n, found.q, part.gain) == (n, q, 1.7)
        assert tuple(found.c) == c
        assert found.error_matrix is part.error_matrix
        assert found.error_matrix.shape == (n + 1, n + 1)
        x, Y, e_0 = rng.normal(size=n), rng.normal(size=q + 2), rng.normal()
        e = found.A @ x - found.B @ Y[:-1] + part.column * e_0
        assert x[0] - Y[0] == pytest.approx(e[0] - part.gain * e_0, abs=1e-12)
        x_dot = np.append(found.F @ x, found.nu_x @ x + found.nu_Y @ Y + part.nu * e_0)
        e_dot = found.A @ x_dot - found.B @ Y[1:] + part.column * (x[0] - Y[0])
        expected = found.error_matrix @ np.append(e_0, e)
        assert x[0] - Y[0] == pytest.approx(expected[0], abs=1e-12)
        scale = np.abs(found.A).max() * np.abs(found.nu_x).max()
        assert e_dot + found.R * Y[-1] == pytest.approx(expected[1:], abs=1e-12 * scale)


@pytest.mark.parametrize("coupling", [None, 0.6])
def test_the_longer_chain_comes_back(coupling):
    """What `of_the_plant` leaves out, `of_the_chain` restores; a plain design stays itself."""
    g, b, c, _ = random_chain(3, 5)
    longer_g, longer_b, longer_c = longer_chain(g, b, np.array(c), 1.7)
    assert longer_g.tolist() == [1.0, *g]
    assert longer_c.tolist() == [1.7, *c]
    assert (longer_b[0] == 0).all() and (longer_b[:, 0] == 0).all()
    assert (longer_b[1:, 1:] == b).all()
    expected = recursion(longer_g, longer_b, Gains(tuple(longer_c), coupling=coupling), 2)
    found = of_the_chain(recursion(g, b, Gains(c, coupling=coupling, integral=1.7), 1))
    for name in ("A", "B", "F", "c", "kappa", "g", "nu_x", "nu_Y", "error_matrix"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    if coupling is None:
        assert found.weights is None
    else:
        np.testing.assert_allclose(found.weights, expected.weights, rtol=1e-12)
    plain = recursion(g, b, Gains(c), 1)
    assert of_the_chain(plain) is plain


@pytest.mark.parametrize("name", ["integral", "coupling"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "x", True])
def test_a_gain_that_is_no_positive_number_is_refused(name, value):
    with pytest.raises(InputError) as caught:
        Gains((1, 1), **{name: value})
    assert caught.value.key == f"law.{name}"


@pytest.mark.parametrize("name", ["integral", "coupling"])
def test_damping_goes_with_neither_integral_nor_coupling(name):
    """One finite k or p is damping."""
    for damping in ({"k": [[1, math.inf], [math.inf] * 4]}, {"p": [1]}):
        assert not Gains((1, 1), **damping).is_lean
        with pytest.raises(InputError, match=f"law.{name}: needs k and p to be inf"):
            Gains((1, 1), **damping, **{name: 1.0})
    assert Gains((1, 1), k=[[math.inf] * 2, [math.inf] * 4], p=[math.inf], **{name: 1}).is_lean
    assert getattr(Gains((1, 1), **{name: 2}), name) == 2.0
    assert isinstance(getattr(Gains((1, 1), **{name: 2}), name), float)


def test_feedforward_is_0_by_default_and_ends_with_the_order():
    """A sampled loop may go beyond, to the derivatives that any plant may have."""
    g, b, c, _ = random_chain(3, 7)
    assert recursion(g, b, Gains(c)).q == 0
    for q in range(3):
        assert recursion(g, b, Gains(c), q).q == q
    for q in (-1, 3):
        with pytest.raises(InputError, match="law.feedforward: must be a whole number from 0 to 2"):
            recursion(g, b, Gains(c), q)
    for q in (3, MAX_ORDER - 1):
        beyond = recursion(g, b, Gains(c), q, beyond=True)
        assert beyond.q == q
        assert np.abs(beyond.B[:, 3:]).max() == 0  # the recursion has no use for them
    for q in (-1, MAX_ORDER):
        with pytest.raises(InputError, match=f"from 0 to {MAX_ORDER - 1}"):
            recursion(g, b, Gains(c), q, beyond=True)


@pytest.mark.parametrize("coupling", [None, 0.6])
def test_the_input_feedback_is_what_the_terms_that_cancel_leave(coupling):
    """v = -k e with k = (0 ... c_n + kappa_n): the last row of M is -k beside the skew part."""
    g, b, c, _ = random_chain(3, 3)
    found = recursion(g, b, Gains(c, coupling=coupling), 1)
    weights = np.ones(3) if coupling is None else found.weights
    S = np.diag(weights**2) @ found.error_matrix
    symmetric = (S + S.T) / 2
    assert found.input_feedback.tolist() == [0, 0, pytest.approx(c[2])]
    assert -symmetric[-1] / weights[-1] ** 2 == pytest.approx(found.input_feedback, abs=1e-12)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_the_coordinates_of_the_plant_are_those_of_every_law(n):
    """xi' = [F; K] xi - R y_d^(q+1), in exact numbers; a lean design is one K and one r of them."""
    g, b, c, rng = random_chain(n, 20 + n)
    for q in range(n):
        K, r = rng.normal(size=n), rng.normal()
        found = plant_coordinates(g, b, K, r, q)
        x, Y = rng.normal(size=n), rng.normal(size=q + 2)
        xi = x - found.B @ Y[:-1]
        x_dot = np.append(found.F @ x, found.nu_x @ x + found.nu_Y @ Y)
        xi_dot = x_dot - found.B @ Y[1:]
        loop = np.vstack([found.F, K])
        assert xi_dot == pytest.approx(loop @ xi - found.R * Y[-1], abs=1e-11)
        assert (found.error_matrix == loop).all()
        assert (found.input_feedback == -K).all()
        assert (np.eye(n) == found.A).all() and (found.c == 0).all() and (found.kappa == 0).all()
        assert found.B[0].tolist() == [1.0] + [0.0] * q
        lean = recursion(g, b, Gains(c), q)
        same = plant_coordinates(g, b, lean.nu_x, lean.nu_Y[-1], q)
        assert same.nu_Y == pytest.approx(lean.nu_Y, abs=1e-9)
        assert np.linalg.solve(lean.A, lean.B) == pytest.approx(same.B, abs=1e-9)


def test_the_balancing_feedforward_leaves_no_error_of_a_constant_derivative():
    """x_1 - y_d at rest of xi' = [F; K] xi - R v is zero; with all derivatives r = Pi_nq."""
    g, b, c, _ = random_chain(3, 40)
    K = recursion(g, b, Gains(c)).nu_x
    for q in range(3):
        r = balancing_feedforward(g, b, K, q)
        found = plant_coordinates(g, b, K, r, q)
        rest = np.linalg.solve(found.error_matrix, found.R)
        assert rest[0] == pytest.approx(0, abs=1e-12)
        assert np.linalg.solve(found.error_matrix, found.R + np.eye(3)[2])[0] != 0
    assert r == pytest.approx(found.B[-1, 2])
    assert pytest.approx(np.append(found.B[:-1, 2], 0), abs=1e-12) == found.R

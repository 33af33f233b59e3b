"""The data of the matrix inequality against the theorem, each computed another way.

The exact check confirms the inequality that it is given; that this is the loop's is shown here.
"""

from dataclasses import replace
from itertools import product

import flint
import numpy as np
import pytest
from conftest import systems
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

import certrack
from certrack.certificates import certify_semidefinite
from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import decimal, rational
from certrack.certificates.cascade import head_problem
from certrack.certificates.centred import centred_problem
from certrack.certificates.exact import Proof
from certrack.certificates.formulation import error_coordinates, error_problem


def draw(rng, *shape):
    """Random rationals."""
    return np.vectorize(lambda v: flint.fmpq(int(v), 8), otypes=[object])(
        rng.integers(-16, 17, shape)
    )


def at(problem, e, a, b, y):
    """e' without the mismatch, and x, at scaled inputs."""
    rate = problem.M @ e + problem.Ua @ a + problem.Ub @ b + problem.Uy @ y
    return rate, problem.Xe @ e + problem.Xy @ y


@given(systems(kinds=("adaptive", "robust")), st.integers(0, 9))
def test_scaled_inputs_are_those_of_the_error_system(system, seed):
    """e' = (S - C - K) e + T w - R y_d^(q+1), x = A^-1 (e + B Y), at inputs within bounds."""
    problem, found = error_problem(system, decimal), system.controller.coordinates
    rng = np.random.default_rng(seed)
    n, q, u = found.n, found.q, system.plant.uncertainty
    Y = rng.uniform(-1, 1, q + 2) * system.reference.bounds(q + 1).values
    x = rng.normal(size=n)
    e = found.A @ x - found.B @ Y[: q + 1]
    a, b = rng.uniform(-1, 1, n) * np.linalg.norm(x), rng.uniform(-1, 1, n)
    w = u.gamma * a + u.beta * b
    expected = found.error_matrix @ e + found.A @ (u.tau * w) - found.R * Y[-1]
    in_a, in_b = map(list, problem.states)
    orders = list(problem.derivatives)
    y = Y[orders] / np.array(system.reference.bounds(q + 1).values)[orders]
    rate, state = at(problem, e, a[in_a], b[in_b], y)
    scale = np.abs(found.A).max() * (1 + np.abs(expected).max())
    assert np.abs(rate - expected).max() <= 1e-11 * scale
    if in_a:  # else ||x|| does not matter, and y_i that act only through it are left out
        assert np.abs(state - x).max() <= 1e-11 * scale * np.abs(problem.Xe).max()


def test_reference_bounds_enter_as_the_value_of_their_float():
    """Its decimal text may be below it, and so below what is proven."""
    base = certrack.load("dual-motor-lean")
    for amplitude in ("1/3", "1/7", "0.1", "2/11"):
        reference = certrack.SymbolicReference("A*sin(t)", constants={"A": amplitude})
        system = base.replace(reference=reference)
        problem = error_problem(system, rational)
        q = system.controller.coordinates.q
        bound = flint.fmpq(*reference.bounds(q + 1).values[-1].as_integer_ratio())
        R = -error_coordinates(system, rational).R
        assert (problem.Uy[:, -1] == R * bound).all()


@given(systems(orders=st.integers(2, 5), kinds=("adaptive",)), st.integers(0, 9))
def test_head_of_a_cascade_is_the_first_rows(system, seed):
    rng = np.random.default_rng(seed)
    problem = error_problem(system, rational)
    limit = flint.fmpq(3, 7)
    head = head_problem(problem, limit)
    e, (a, b, y) = draw(rng, problem.n), (draw(rng, count) for count in problem.counts)
    v = draw(rng, 1)
    e[-1] = limit * v[0]
    rate, x = at(problem, e, a, b, y)
    head_rate, head_x = at(head, e[:-1], a, b, np.concatenate([y, v]))
    assert (head_rate == rate[:-1]).all()
    assert (head_x == x).all()
    assert head.adaptation is None


@given(systems(orders=st.integers(1, 4), kinds=("adaptive",)), st.integers(0, 9))
def test_centred_problem_adds_minus_kappa_times_the_linear_part_of_nu(system, seed):
    rng = np.random.default_rng(seed)
    problem, found = error_problem(system, rational), error_coordinates(system, rational)
    n, q = found.n, found.q
    unit = tuple(tuple("1" if i == j else "0" for j in range(n)) for i in range(n))
    kappa = flint.fmpq(-1, 16)
    centred = centred_problem(system, problem, Proof("1", unit, (), (), (), "1"), kappa)
    bounds = [flint.fmpq(*v.as_integer_ratio()) for v in system.reference.bounds(q + 1).values]
    scaled = draw(rng, q + 2)
    Y = scaled * np.array(bounds, dtype=object)
    e, a, b = draw(rng, n), draw(rng, problem.counts[0]), draw(rng, problem.counts[1])
    x = problem.Xe @ (e + found.B @ Y[:-1])
    rate, _ = at(problem, e, a, b, scaled[list(problem.derivatives)])
    rate[-1] -= kappa * (found.nu_x @ x + found.nu_Y @ Y)
    still = np.concatenate([b, draw(rng, centred.counts[1] - len(b)) * 0])  # zeta is apart
    centred_rate, centred_x = at(centred, e, a, still, scaled[list(centred.derivatives)])
    assert (centred_rate == rate).all()
    if len(a):
        assert (centred_x == x).all()
    assert centred.adaptation.shift == kappa


ADAPTATIONS = {
    "diagonal": np.diag([0.5, 2.0]),
    "full": np.array([[1.0, 0.4], [0.4, 0.7]]),
    "none": np.zeros((0, 0)),
}


def adaptation(Gamma, gain_sign, delta0, shift):
    r = len(Gamma)
    return Adaptation(
        gain_rate=0.8,
        leak_gain=0.6,
        leak_theta=0.5,
        Gamma=Gamma,
        gains=(1.5, 3.0),
        delta0=delta0,
        gain_sign=gain_sign,
        theta0=np.array([0.3, -0.2])[:r],
        theta_box=((0.0, 1.0), (-2.0, 0.5))[:r],
        shift=shift,
    )


def parameters(law, points=3):
    """(g, delta, theta) over the ranges, moved as the shift says."""
    axes = [np.linspace(*law.gains, points)]
    axes += [np.linspace(*pair, points) for pair in law.theta_box]
    for g, *theta in product(*axes):
        delta = (1 - law.shift) * law.gain_sign / g
        yield g, delta, (1 + law.shift) * np.array(theta)


@pytest.mark.parametrize("kind", ADAPTATIONS)
@pytest.mark.parametrize("gain_sign", [1, -1])
@pytest.mark.parametrize("delta0", [0.2, 0.9])
@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_leakage_is_the_largest_rise_of_the_estimates_energy(kind, gain_sign, delta0, shift):
    """q(alpha) = max of V' + alpha V over estimation errors and ranges, the e-part left out."""
    law = adaptation(ADAPTATIONS[kind], gain_sign, delta0, shift)
    alpha, r = 0.4, len(law.Gamma)
    inverse = np.linalg.inv(law.Gamma)

    def rise(errors, g, delta, theta):
        d, v = errors[0], errors[1:]
        leak = g * law.leak_gain * d * (delta - d - law.delta0)
        leak += law.leak_theta * v @ (theta - v - law.theta0)
        return leak + alpha * (g * d**2 / (2 * law.gain_rate) + v @ inverse @ v / 2)

    largest = max(
        -minimize(lambda errors, p=p: -rise(errors, *p), np.zeros(1 + r), tol=1e-12).fun
        for p in parameters(law)
    )
    assert law.leakage_cost(alpha) == pytest.approx(largest, rel=1e-6)
    rates = [2 * law.gain_rate * law.leak_gain]
    rates += [2 * law.leak_theta * rate for rate in np.linalg.eigvalsh(law.Gamma)]
    assert law.leakage_cost(min(rates) * 1.001) is None
    assert law.leakage_cost(min(rates) * 0.999) is not None


@pytest.mark.parametrize("kind", ADAPTATIONS)
@pytest.mark.parametrize("gain_sign", [1, -1])
@pytest.mark.parametrize("delta_hat", [-1.0, 0.4, 1.0])
def test_energy_of_the_estimates_is_the_largest_over_the_ranges(kind, gain_sign, delta_hat):
    law = adaptation(ADAPTATIONS[kind], gain_sign, 0.4, 0.0)
    inverse = np.linalg.inv(law.Gamma)
    estimates = np.array([delta_hat, 0.2, -0.9])[: 1 + len(law.Gamma)]

    def energy(g, delta, theta):
        gap = theta - estimates[1:]
        return g * (delta - estimates[0]) ** 2 / (2 * law.gain_rate) + gap @ inverse @ gap / 2

    largest = max(energy(*p) for p in parameters(law, 5))
    assert law.energy(estimates) == pytest.approx(largest, rel=1e-12)


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean"])
@pytest.mark.parametrize("sides", [(0.3, 0.5), (2.5, 0.5)])
def test_tube_from_a_box_starts_at_its_worst_corner(name, sides):
    system = certrack.load(name)
    _, proof = certify_semidefinite(system)
    box = [(v - sides[0], v + sides[1]) for v in system.settings.x0]
    starts = [
        certrack.certificates.tube(system.with_settings(x0=corner), proof).start
        for corner in product(*box)
    ]
    assert certrack.certificates.tube(system, proof, box).start == max(starts)


def test_tube_counts_the_initial_estimates():
    """V(0) of Example 1, with g_n = theta = 2, gbar = Gamma = 1, written out."""
    base = certrack.load("example1")
    _, proof = certify_semidefinite(base)
    system = base.with_settings(estimates=(0.1, 1.4))
    P = np.array(proof.P, dtype=float)
    found = system.controller.coordinates
    e = found.A @ np.array(system.settings.x0) - found.B[:, 0] * 0.2
    estimates = 2 * (0.5 - 0.1) ** 2 / 2 + (2 - 1.4) ** 2 / 2
    expected = e @ P @ e + 2 * P[-1, -1] * estimates
    assert certrack.certificates.tube(system, proof).start == pytest.approx(expected, rel=1e-8)


def test_ranges_reach_the_adaptation():
    base = certrack.load("example1")
    plant = replace(base.plant, input_gain_range=(1.5, 2.5), theta_range=((1, 3),))
    law = error_problem(base.replace(plant=plant), decimal).adaptation
    assert law.gains == (1.5, 2.5)
    assert law.theta_box == ((1.0, 3.0),)

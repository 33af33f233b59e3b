"""The shipped laws, and a newcomer's, pass the conformance kit."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from conftest import systems
from hypothesis import given

import certrack
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.laws import Classic, Robust
from certrack.laws.backstepping import Gains
from certrack.laws.balanced import balancing_weights
from certrack.laws.base import Equations, Law, gain
from certrack.laws.recursion import recursion
from certrack.laws.signals import Signals, dot
from certrack.model.plant import Plant
from certrack.references import triangle
from certrack.testing import LawConformance


class TestAdaptive(LawConformance):
    system = certrack.load("example1")


class TestAdaptiveOnATriangle(LawConformance):
    system = certrack.load("example1").replace(reference=triangle(0.2, 6.0))


class TestRobust(LawConformance):
    system = certrack.load("dual-motor-lean")


class TestClassic(LawConformance):
    system = certrack.load("example1-classic").with_settings(duration=30)  # it settles after 12 s


class TestFullGamma(LawConformance):
    """Two unknown parameters, a full Gamma, a negative input gain; no two gains are equal."""

    system = certrack.loads(
        """
[plant]
states = ["x1", "x2"]
chain = [1.5]
linear = [[-0.5]]
drift = "sin(x2) - x1"
regressor = ["x1", "cos(x2)"]
gain_sign = -1

[plant.uncertainty]
tau = [0.1, 0.2]
gamma = [0.1, 0.1]
beta = [0.1, 0.1]

[law]
kind = "adaptive"
c = [2, 3]
feedforward = 1
gain_rate = 1.5
leak_gain = 0.05
leak_theta = 0.15
delta0 = -0.4
theta0 = [0.4, -0.6]
Gamma = [[2.0, 0.5], [0.5, 1.0]]

[reference]
signal = "0.5*cos(t)"

[truth]
input_gain = -2
theta = [0.5, -0.7]
omega = ["0.05*sin(t)", "0.05*x1"]

[simulation]
x0 = [1, 0]
duration = 20
"""
    )


@dataclass(frozen=True, kw_only=True)
class Proportional(Law):
    """A newcomer's law: the robust law with a softened input."""

    kind = "proportional"
    softness: float = gain(above=0, default=1.0)

    def equations(self, s: Signals) -> Equations:
        g, theta = s.parameter("g_n"), s.parameters("theta", s.r)
        return Equations(u=s.parameter("softness") * (s.nu - dot(s.phi, theta)) / g)

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        known = Robust(c=self.c).parameters(plant)
        return {**known, "softness": self.softness}


class TestNewcomer(LawConformance):
    system = certrack.load("dual-motor-lean").replace(
        law=Proportional(c=(2, 2, 2, 2), softness=0.9)
    )


@pytest.mark.parametrize("coupling", [0, -0.5])
def test_a_coupling_that_is_not_positive_is_refused(coupling):
    assert certrack.Robust(c=[1, 1], coupling=0.5).coupling == 0.5
    with pytest.raises(InputError, match="coupling"):
        certrack.Robust(c=[1, 1], coupling=coupling)


def test_a_foreign_symbol_is_refused_when_the_law_meets_its_plant():

    @dataclass(frozen=True, kw_only=True)
    class Foreign(Robust):
        def equations(self, s: Signals) -> Equations:
            from certrack.core.expressions import symbol

            return Equations(u=super().equations(s).u + symbol("x9"))

    system = certrack.load("dual-motor-lean")
    with pytest.raises(InputError, match="law: u contains unknown symbols; got x9"):
        replace(system, law=Foreign(c=(1, 1, 1, 1)))


def evaluated(formula, values):
    return float(formula.subs(values))


def at_random(system, estimates=()):
    """Values of every symbol of the law at a random point, and nu, phi and e_n there."""
    rng = np.random.default_rng(1)
    controller, plant = system.controller, system.plant
    s = controller.signals
    values = dict(zip(controller.symbols, controller.values, strict=True))
    values |= dict(zip(s.x, rng.normal(size=plant.n), strict=True))
    values |= dict(zip(s.Y, rng.normal(size=len(s.Y)), strict=True))
    if not estimates:
        estimates = rng.normal(size=len(controller.states))
    values |= dict(zip(controller.states, estimates, strict=True))
    x, Y = [values[v] for v in s.x], [values[v] for v in s.Y]
    found = controller.coordinates
    nu = found.nu_x @ x + found.nu_Y @ Y - evaluated(plant.drift.expr, values)
    phi = np.array([evaluated(v.expr, values) for v in plant.regressor])
    e_n = (found.A @ x - found.B @ Y[: found.q + 1])[-1]
    return values, nu, phi, e_n


@given(systems(kinds=("robust",)))
def test_robust_law_leaves_nothing_on_the_last_row(system):
    """Corollary 1: g_n u + phi^T theta = nu, so e_n' is what the recursion says."""
    values, nu, phi, _ = at_random(system)
    g_n = float(system.truth.input_gain.expr)
    theta = np.array([float(v.expr) for v in system.truth.theta])
    u = evaluated(system.controller.equations.u, values)
    assert g_n * u + phi @ theta == pytest.approx(nu, rel=1e-9, abs=1e-9)


@given(systems(kinds=("adaptive", "classic")))
def test_adaptive_laws_leave_nothing_where_the_estimates_are_true(system):
    """[25] with delta_hat = 1/g_n and theta_hat = theta is the robust law."""
    g_n = float(system.truth.input_gain.expr)
    theta = np.array([float(v.expr) for v in system.truth.theta])
    values, nu, phi, _ = at_random(system, [1 / g_n, *theta])
    u = evaluated(system.controller.equations.u, values)
    assert g_n * u + phi @ theta == pytest.approx(nu, rel=1e-9, abs=1e-9)


@given(systems(kinds=("adaptive", "classic")))
def test_update_laws_cancel_the_estimation_errors(system):
    """[26]: in V' of [23] the mismatch on the last row goes, and only the leakage remains."""
    law, plant = system.law, system.plant
    values, nu, phi, e_n = at_random(system)
    g_n = float(system.truth.input_gain.expr)
    theta = np.array([float(v.expr) for v in system.truth.theta])
    delta_hat, *theta_hat = (values[v] for v in system.controller.states)
    delta_rate, *theta_rate = (
        evaluated(rate, values) for _, rate in system.controller.equations.update
    )
    u = evaluated(system.controller.equations.u, values)
    delta_error, theta_error = 1 / g_n - delta_hat, theta - np.array(theta_hat)
    rate = e_n * (g_n * u + phi @ theta - nu)
    rate -= abs(g_n) / law.gain_rate * delta_error * delta_rate
    rate -= (theta_error / np.array(law.Gamma or [1.0] * plant.r)) @ np.array(theta_rate)
    leakage = 0.0
    if law.kind == "adaptive":
        leakage += abs(g_n) * law.leak_gain * delta_error * (delta_hat - law.delta0)
        leakage += law.leak_theta * theta_error @ (np.array(theta_hat) - np.array(law.theta0))
    scale = abs(e_n * nu) + abs(e_n * g_n * u) + 1
    assert rate == pytest.approx(leakage, rel=1e-9, abs=1e-9 * scale)


def test_robust_law_must_know_its_parameters():
    plant = Plant(states=["x1"], regressor=["x1"])
    with pytest.raises(InputError, match="must know g_n"):
        Robust(c=[1]).design(plant)
    with pytest.raises(InputError, match="must know theta"):
        Robust(c=[1]).design(replace(plant, input_gain=1))


def test_classic_law_refuses_what_it_does_not_have():
    with pytest.raises(InputError, match="no damping"):
        Classic(c=[1], k=[[1, 1]])
    with pytest.raises(InputError, match="always has n - 1"):
        Classic(c=[1], feedforward=1)


def test_classic_law_needs_a_smooth_reference():
    system = certrack.load("example1-classic")
    with pytest.raises(InputError, match="needs 2 bounded derivatives of y_d, the reference has 1"):
        system.replace(reference=triangle(0.2, 4.0))


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["z", "x1"], "has a state of this name already; got x1"),
        (["K"], "has a state of this name already; got K"),
        (["z", "z"], "has a state of this name already; got z"),
        (["ctl_z"], "names of own states must not begin so; got ctl_z"),
        (["kept_1"], "names of own states must not begin so; got kept_1"),
    ],
)
def test_own_states_have_names_of_their_own(names, message):
    @dataclass(frozen=True, kw_only=True)
    class Filtering(Robust):
        def equations(self, s: Signals) -> Equations:
            update = tuple((symbol(name), s.x[0] - symbol(name)) for name in names)
            return Equations(u=super().equations(s).u, update=update)

    plant = Plant(states=["x1"], drift="K*x1", input_gain=1, constants={"K": 2})
    with pytest.raises(InputError, match=re.escape(message)):
        Filtering(c=[1]).design(plant)
    names[:] = ["z", "z_2"]
    assert [str(z) for z in Filtering(c=[1]).design(plant).states] == names


def test_the_classic_update_law_of_several_parameters_is_that_of_full_gamma():
    Gamma = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, -0.2], [0.1, -0.2, 3.0]])
    law = Classic(c=[1, 2], gain_rate=0.7, Gamma=Gamma.tolist())
    base = certrack.load("example1-classic")
    plant = Plant(states=["x1", "x2"], chain=[2], regressor=["x1", "x2", "1"], gain_sign=-1)
    truth = replace(base.truth, input_gain=-2, theta=[0.1, 0.2, 0.3], omega=["0", "0"])
    system = base.replace(plant=plant, law=law, truth=truth)
    values, nu, phi, e_n = at_random(system)
    delta_hat, *theta_hat = (values[v] for v in system.controller.states)
    delta_rate, *theta_rate = (
        evaluated(rate, values) for _, rate in system.controller.equations.update
    )
    assert theta_rate == pytest.approx(Gamma @ phi * e_n, rel=1e-12)
    ubar = nu - phi @ theta_hat
    assert delta_rate == pytest.approx(0.7 * ubar * e_n, rel=1e-12)
    assert evaluated(system.controller.equations.u, values) == pytest.approx(delta_hat * ubar)


@pytest.mark.parametrize("rho", [0.25, 1.0, 4.0])
def test_balanced_weights_are_decimals_of_twelve_digits(rho):
    g, c = [1e-3, -7.0, 3.0], [1.0, 3.0, 2.0, 5.0]
    weights = balancing_weights(g, c, rho)
    assert weights[0] == 1
    exact = 1.0
    for i, weight in enumerate(weights[1:]):
        exact *= abs(g[i]) / (rho * (c[i] * c[i + 1]) ** 0.5)
        digits = -int(np.floor(np.log10(exact)))
        assert weight == Fraction(exact).limit_denominator(10**30).__round__(11 + digits)
    design = recursion(np.array(g), np.zeros((3, 4)), Gains(c, coupling=rho), 1)
    S = np.diag(np.array(weights, float))
    C = np.diag(np.sqrt(c))
    J = np.eye(4, k=1)
    expected = C @ (rho * (J * np.sign([0, *g]) - (J * np.sign([0, *g])).T) - np.eye(4)) @ C
    assert S @ design.error_matrix @ np.linalg.inv(S) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("law", "key"),
    [
        (Classic, "gain_rate"),
        (certrack.Adaptive, "gain_rate"),
        (certrack.Adaptive, "leak_gain"),
        (certrack.Adaptive, "leak_theta"),
    ],
)
def test_rates_are_positive_and_may_be_small(law, key):
    assert getattr(law(c=[1], **{key: 1e-9}), key) == 1e-9
    for wrong in (0, -1e-9):
        with pytest.raises(InputError, match=f"law.{key}"):
            law(c=[1], **{key: wrong})


@pytest.mark.parametrize("key", ["k", "p"])
def test_damping_is_positive_and_may_be_left_out(key):
    def fields(value):
        return {"k": [[value, 1], [1, 1, 1, 1]]} if key == "k" else {"p": [value]}

    for right in (1e-9, np.inf):
        assert Robust(c=[1, 1], **fields(right)).c == (1, 1)
    for wrong in (0, -1e-9, np.nan):
        with pytest.raises(InputError, match=f"law.{key}"):
            Robust(c=[1, 1], **fields(wrong))

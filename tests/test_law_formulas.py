"""Laws by their formulas: signals, what a law states of its errors, leakage, numbers, names."""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
import sympy

import certrack
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.rationals import RationalFloat
from certrack.laws import Adaptive, Classic, Robust
from certrack.laws.backstepping import Gains
from certrack.laws.balanced import balancing_weights
from certrack.laws.base import Equations, _of_integral, gain
from certrack.laws.integral import INTEGRAL
from certrack.laws.leakage import (
    _constant_jacobian,
    leak_jacobian,
    leak_matrix,
    longest_euler_period,
)
from certrack.laws.numbers import metric, vector
from certrack.laws.online import Online
from certrack.laws.recursion import recursion
from certrack.laws.registry import known_laws, register_law
from certrack.laws.signals import Signals, dot
from certrack.model.plant import MAX_ORDER, Plant

PLANT = Plant(
    states=("x1", "x2"),
    chain=(1.5,),
    linear=((-0.5,),),
    drift="sin(x2) - x1",
    regressor=("x1", "cos(x2)"),
    gain_sign=-1,
)
x1, x2 = symbol("x1"), symbol("x2")
A, Z = symbol("a"), symbol("z")


def gains(name, count):
    return [symbol(f"law_{name}_{i}") for i in range(count)]


# signals


@pytest.mark.parametrize("integral", [False, True])
def test_the_signals_are_what_their_names_say(integral):
    s = Signals(PLANT, 1, integral=integral)
    y = [symbol(f"y_d_{i}") for i in range(3)]
    a, b, nu_x, nu_Y = (gains(n, k) for n, k in (("A_n", 2), ("B_n", 2), ("nu_x", 2), ("nu_Y", 3)))
    e_n = a[0] * x1 + a[1] * x2 - b[0] * y[0] - b[1] * y[1]
    nu = nu_x[0] * x1 + nu_x[1] * x2 + sum(c * v for c, v in zip(nu_Y, y, strict=True))
    nu += -sympy.sin(x2) + x1
    names = {"A_n", "B_n", "nu_x", "nu_Y", "sign_g"}
    if integral:
        e_n += symbol("law_A_n0_0") * INTEGRAL
        nu += symbol("law_nu_0_0") * INTEGRAL
        names |= {"A_n0", "nu_0"}
    assert sympy.expand(s.e_n - e_n) == 0 and sympy.expand(s.nu - nu) == 0
    assert set(s.all_parameters) == names
    assert s.r == 2 and s.x == (x1, x2) and list(s.Y) == y
    assert s.phi == (x1, sympy.cos(x2)) and s.sign_g == symbol("law_sign_g_0")


def test_short_signals_stay_symbols():
    s = Signals(PLANT, 0, short=True)
    assert (s.e_n, s.nu) == (symbol("e_n"), symbol("nu"))


def test_an_entry_beyond_a_signal_is_named():
    s = Signals(PLANT, 0)
    with pytest.raises(InputError, match=r"s\.x\[2\].* has 2 entries, from s\.x\[0\]"):
        s.x[2]
    bare = Plant(states=("x1",), gain_sign=1)
    with pytest.raises(InputError, match=r"s\.phi\[0\].* has no entries"):
        Signals(bare, 0).phi[0]
    assert s.x[-1] == x2 and s.x[:1] == (x1,)


def test_the_numbers_of_integral_action_are_those_of_the_last_row():
    part = SimpleNamespace(column=[1, 2, 3], nu=4)
    assert _of_integral(SimpleNamespace(integral=part)) == {"A_n0": 3, "nu_0": 4}
    assert _of_integral(SimpleNamespace(integral=None)) == {}


# what a law states, and its equations


@pytest.mark.parametrize(
    "law", [Adaptive(c=(1, 2)), Classic(c=(1, 2)), Robust(c=(1, 2))], ids=lambda law: law.kind
)
def test_a_law_obeys_the_errors_that_it_states(law):
    s = Signals(PLANT, 1)
    stated, equations = law.error_system(s), law.equations(s)
    assert sympy.expand(stated.input(s.nu, s.phi) - equations.u) == 0
    rates = stated.rates(s.nu, s.phi, s.e_n, s.sign_g)
    assert stated.estimates == tuple(z for z, _ in equations.update)
    for mine, (_, theirs) in zip(rates, equations.update, strict=True):
        assert sympy.expand(mine - theirs) == 0


def test_the_adaptive_law_term_by_term():
    """[25], [26], written out for two parameters and a full Gamma."""
    s = Signals(PLANT, 1)
    found = Adaptive(c=(1, 2)).equations(s)
    gbar, gbar1, gbar2, delta0, sign = (
        symbol(f"law_{n}_0") for n in ("gain_rate", "leak_gain", "leak_theta", "delta0", "sign_g")
    )
    theta0, G = gains("theta0", 2), gains("Gamma", 4)
    d, h = symbol("delta_hat"), [symbol("theta_hat_1"), symbol("theta_hat_2")]
    ubar = s.nu - x1 * h[0] - sympy.cos(x2) * h[1]
    drive = [s.phi[i] * s.e_n - gbar2 * (h[i] - theta0[i]) for i in range(2)]
    expected = [
        (d, -gbar * sign * ubar * s.e_n - gbar * gbar1 * (d - delta0)),
        (h[0], G[0] * drive[0] + G[1] * drive[1]),
        (h[1], G[2] * drive[0] + G[3] * drive[1]),
    ]
    assert sympy.expand(found.u - d * ubar) == 0
    for (z, rate), (name, formula) in zip(found.update, expected, strict=True):
        assert z == name and sympy.expand(rate - formula) == 0
    assert found.filters == ()
    assert list(found.formulas) == ["u", *(f"the rate of {z}" for z, _ in expected)]


def test_inner_products():
    assert dot([A, Z], [2, 3]) == 2 * A + 3 * Z and dot([], []) == 0


# leakage


def test_the_leak_is_what_depends_on_gains_alone():
    """Of z' = -a z, w' = -3 z + x1 w: the part with a state of the plant is none."""
    w = symbol("w")
    equations = Equations(sympy.S.Zero, ((Z, -A * Z), (w, -3 * Z + x1 * w)))
    assert _constant_jacobian(equations, (A,)) == (-A, 0, -3, 0)
    assert _constant_jacobian(equations, (A, symbol("b"))) == (-A, 0, -3, 0)
    assert _constant_jacobian(equations, ()) == (0, 0, -3, 0)


def test_the_leak_of_the_adaptive_law():
    law = Adaptive(
        c=(1, 2), gain_rate=1.5, leak_gain=0.2, leak_theta=0.3, Gamma=((2, 0.5), (0.5, 1))
    )
    controller = law.design(PLANT)
    expected = [[-0.3, 0, 0], [0, -0.6, -0.15], [0, -0.15, -0.3]]
    assert leak_matrix(controller) == pytest.approx(np.array(expected))
    assert len(leak_jacobian(controller)) == 9
    fastest = 0.45 + math.hypot(0.15, 0.15)  # of the block of theta
    assert longest_euler_period(controller) == pytest.approx(2 / fastest)
    without = Robust(c=(1,)).design(Plant(states=("x1",), input_gain=2))
    assert leak_matrix(without).shape == (0, 0) and longest_euler_period(without) == math.inf


@pytest.mark.parametrize(
    ("poles", "period"),
    [
        ((-4, -1), 0.5),
        ((-1, 3), 2.0),
        ((0, 0), math.inf),
        ((5, 2), math.inf),
        ((-sympy.oo, -1), math.inf),
    ],
)
def test_the_longest_period_of_an_euler_step(poles, period):
    equations = Equations(sympy.S.Zero, ((Z, poles[0] * Z), (A, poles[1] * A)))
    controller = SimpleNamespace(equations=equations, symbols=(), states=(Z, A), values=())
    assert longest_euler_period(controller) == period


def test_a_turning_leak():
    """Poles -1 +- 2i: |1 + T l| = 1 at T = 2/5."""
    equations = Equations(sympy.S.Zero, ((Z, -Z + 2 * A), (A, -2 * Z - A)))
    controller = SimpleNamespace(equations=equations, symbols=(), states=(Z, A), values=())
    assert longest_euler_period(controller) == pytest.approx(0.4)


# numbers


def test_metrics_are_positive_definite_matrices():
    assert (metric("Gamma", None, 2) == np.eye(2)).all()
    assert (metric("Gamma", (2, 3), 2) == np.diag([2, 3])).all()
    assert (metric("Gamma", ((2, 1), (1, 1)), 2) == [[2, 1], [1, 1]]).all()
    for value, why in (
        ((1, 2, 3), "must be 2 numbers or a 2 x 2 matrix"),
        (((1, 0), (0.5, 1)), "must be symmetric"),
        (((1, 1), (1, 1)), "must be positive definite"),
        ((1, 0), "must be positive definite"),
    ):
        with pytest.raises(InputError, match=why):
            metric("Gamma", value, 2)
    third = RationalFloat(Fraction(1, 3))
    mixed = metric("Gamma", (third, 2.0), 2)
    assert mixed.dtype == object and mixed[0, 0] is third and mixed[0, 1] == 0
    assert (vector("theta0", None, 3) == np.zeros(3)).all()
    assert (vector("theta0", (1, 2), 2) == [1, 2]).all()
    assert vector("theta0", (1, 2), 2).dtype == float
    with pytest.raises(InputError, match="theta0"):
        vector("theta0", (1, 2, 3), 2)


def test_orders_of_feed_forward_end_at_the_largest_plant():
    assert Robust(c=(1,), feedforward=MAX_ORDER - 1).feedforward == MAX_ORDER - 1
    for order in (MAX_ORDER, -1):
        with pytest.raises(InputError, match="feedforward"):
            Robust(c=(1,), feedforward=order)


def test_gains_that_are_left_out():
    law = Adaptive(c=(1, 2))
    found = law.gain_rate, law.leak_gain, law.leak_theta, law.delta0, law.theta0, law.Gamma
    assert found == (1.0, 0.1, 0.1, 0.0, None, None)
    assert Classic(c=(1, 2)).gain_rate == 1.0
    assert (law.feedforward, law.coupling, law.integral, law.observer) == (0, None, None, None)
    assert law.sampled_feedforward is False
    for name in ("gain_rate", "leak_gain", "leak_theta"):
        with pytest.raises(InputError, match=name):
            Adaptive(c=(1, 2), **{name: 0})


def test_integral_action_is_one_more_state_of_the_law():
    s = Signals(PLANT, 0, integral=True)
    with_it, without = Robust(c=(1, 2), coupling=0.5, integral=1.0), Robust(c=(1, 2))
    assert with_it.normal_equations(s).update == ((INTEGRAL, x1 - s.Y[0]),)
    assert without.normal_equations(s).update == ()


def test_the_classic_law_refuses_what_it_does_not_use():
    assert Classic(c=(1, 2)).order(PLANT) == 1
    for other in ({"k": ((1, 1), (1, 1, 1, 1))}, {"p": (1,)}, {"feedforward": 1}):
        with pytest.raises(InputError, match=f"law.{next(iter(other))}"):
            Classic(c=(1, 2), **other)


# the balanced recursion


def test_balancing_weights_make_the_coupling_that_is_asked_for():
    g, c = (2.0, -3.0), (1.0, 4.0, 9.0)
    weights = balancing_weights(g, c, 0.5)
    assert weights == [1, 2, 2]  # |g_i|/(rho sqrt(c_i c_{i+1})): 2/(1/2 2), 3/(1/2 6)
    assert all(isinstance(weight, Fraction) for weight in weights)
    loop = recursion(np.array(g), np.zeros((2, 3)), Gains(c, None, None, 0.5, None), 1)
    assert loop.weights == pytest.approx([1, 2, 2])


# names


@register_law
@dataclass(frozen=True, kw_only=True)
class Named(Robust):
    kind = "named-in-a-test"


def test_a_registered_law_is_known_by_its_kind_and_may_be_registered_again():
    assert known_laws()["named-in-a-test"] is Named
    assert register_law(Named) is Named
    assert list(known_laws())[:4] == ["adaptive", "robust", "linear", "classic"]


def test_laws_that_cannot_be_registered():
    @dataclass(frozen=True, kw_only=True)
    class Space(Robust):
        kind = "two words"

    @dataclass(frozen=True, kw_only=True)
    class Shipped(Robust):
        kind = "adaptive"

    @dataclass(frozen=True, kw_only=True)
    class OtherField(Robust):
        kind = "other-field"
        c: float = gain(default=1.0)

    class Bare(Robust):
        kind = "bare"

    @dataclass
    class Thawed:
        kind = "thawed"

    for law, where in (
        (Space, "law.kind"),
        (Shipped, "law.kind.*shipped"),
        (OtherField, r"law\.c.*is the name of a field"),
        (Bare, "frozen dataclass"),
        (Thawed, "subclass"),
        (Named(c=(1,)), "subclass"),
    ):
        with pytest.raises(InputError, match=where):
            register_law(law)
    assert certrack.laws.known_laws().get("two words") is None


# gains that move


class ByAConstant(Robust):
    """With a constant of the plant in its input, which no signal stands for."""

    def equations(self, s):
        equations = super().equations(s)
        return replace(equations, u=equations.u + symbol("J") * 0.1)


CONSTANT = Plant(states=("x1",), chain=(), drift="-x1", input_gain=1, constants={"J": 2.0})


def test_constants_of_the_plant_are_known_to_a_schedule_and_to_no_law():
    """A schedule is a formula of the file, where constants have their names."""
    online = Online(c=(3.0,), schedule="0.5 + 0.5*tanh(J*x1)")
    runs = Robust(c=(2.0,), online=online).design(CONSTANT)
    assert symbol("J") in runs.equations.u.free_symbols
    with pytest.raises(InputError, match="u contains unknown symbols; got J"):
        ByAConstant(c=(2.0,)).design(CONSTANT)
    still = Robust(c=(2.0,)).design(CONSTANT)
    assert not still.states
    rule = Online(c=(3.0,), threshold=0.1, rise=2.0, fall=1.0)
    moving = Robust(c=(2.0,), online=rule).design(CONSTANT)
    assert [str(z) for z in moving.states] == ["online_level"]


def test_numbers_of_both_ends_stand_beside_each_other_where_gains_move():
    rule = Online(c=(3.0,), threshold=0.1, rise=2.0, fall=1.0)
    moving = Robust(c=(2.0,), online=rule).numbers(CONSTANT)
    still, other = (Robust(c=(v,)).numbers(CONSTANT) for v in (2.0, 3.0))
    assert not any(name.startswith("other_") for name in still)
    for name, value in still.items():
        assert np.all(moving[name] == value)
        assert np.all(moving[f"other_{name}"] == other[name])
    rest = {k: v for k, v in moving.items() if k.startswith("online_")}
    assert rest == {"online_threshold": 0.1, "online_rise": 2.0, "online_fall": 1.0}

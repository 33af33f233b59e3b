"""What a file says is what is proven: decimals, fractions, and the laws' own statements."""

import copy
import json
import math
import pickle
import re
from dataclasses import dataclass, fields, replace
from fractions import Fraction

import flint
import numpy as np
import pytest
import sympy
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from mpmath import mp

import certrack
from certrack.certificates import certify, certify_semidefinite, to_document, verify
from certrack.certificates import start as start_room
from certrack.certificates import stated as stated_room
from certrack.certificates.arithmetic import rational
from certrack.certificates.balls import ball_of, ball_precision, enclosing_ball, upper_rational
from certrack.certificates.cascade import certify_cascade
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_down, float_up, from_text
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.published import _smallest_eigenvalue, certify_published, collect
from certrack.certificates.start import reference_at_start, states_at_start
from certrack.certificates.stated import stated_error_system
from certrack.certificates.tube import Tube
from certrack.certificates.tube import tube as tube_of
from certrack.cli import cli
from certrack.core import checks
from certrack.core.rationals import (
    RationalFloat,
    decimal_float,
    exact_rational,
    exactly_positive_definite,
    float_above,
    float_below,
    nearest_float,
    stated_above,
)
from certrack.laws import Adaptive, Equations, Robust
from certrack.laws.error_system import KnownParameters


def exactly(value):
    return (
        Fraction(int(value.p), int(value.q)) if isinstance(value, flint.fmpq) else Fraction(value)
    )


FRACTIONS = """
[plant]
states = ["x1", "x2"]
chain = ["1/3"]
linear = [["1/7"]]
drift = "0"
regressor = ["x1"]
gain_sign = 1
[plant.ranges]
input_gain = ["2/3", "7/3"]
theta = [["1/3", "5/3"]]
[plant.uncertainty]
tau = ["1/3", 0.12345678901234567890123]
gamma = ["1/7", "sqrt(2)/100"]
beta = ["1/11", "0.1"]
[truth]
input_gain = 1
theta = [1]
[reference]
signal = "0.2*cos(t)"
[law]
kind = "adaptive"
c = ["7/3", 2]
gain_rate = "1/3"
leak_gain = 1
leak_theta = 1
delta0 = "2/3"
theta0 = ["2/3"]
Gamma = ["1/9"]
[simulation]
x0 = [0, 0]
duration = 1
"""


def test_fractions_of_a_file_enter_the_proof_as_rationals():
    system = certrack.loads(FRACTIONS)
    problem = error_problem(system, rational)
    A = error_coordinates(system, rational).A
    q = flint.fmpq
    assert (problem.Ua[:, 0] == q(1, 3) * q(1, 7) * A[:, 0]).all()
    assert (problem.Ub[:, 0] == q(1, 3) * q(1, 11) * A[:, 0]).all()
    tau = q(12345678901234567890123, 10**23)
    assert (problem.Ub[:, 1] == tau * q(1, 10) * A[:, 1]).all()
    law = problem.adaptation
    assert law.gains == (q(2, 3), q(7, 3))
    assert law.theta_box == ((q(1, 3), q(5, 3)),)
    assert (law.gain_rate, law.delta0) == (q(1, 3), q(2, 3))
    assert law.Gamma[0, 0] == q(1, 9)
    assert law.theta0[0] == q(2, 3)
    assert problem.M[0, 0] == -q(7, 3)


def test_an_irrational_bound_is_the_float_above_it():
    system = certrack.loads(FRACTIONS)
    gamma = rational(system.plant.uncertainty.gamma[1])
    with mp.workdps(60):
        root = mp.sqrt(2) / 100
        assert mp.mpf(int(gamma.p)) / int(gamma.q) >= root
        assert float(gamma) <= float(root) * (1 + 1e-15)
    ranged = certrack.loads(FRACTIONS.replace('["1/3", "5/3"]', '["1/pi", "pi"]'))
    low, high = error_problem(ranged, rational).adaptation.theta_box[0]
    with mp.workdps(60):
        assert mp.mpf(int(low.p)) / int(low.q) <= 1 / mp.pi
        assert mp.mpf(int(high.p)) / int(high.q) >= mp.pi


def test_fractions_survive_files_copies_and_certificates():
    system = certrack.loads(FRACTIONS)
    text = certrack.to_text(system)
    assert '"1/3"' in text
    found = certify(system)
    document = to_document(system, *found.stages)
    assert verify(document).verified
    for other in (
        certrack.loads(text),
        certrack.loads(document["system"]),
        copy.deepcopy(system),
    ):
        assert (
            error_problem(other, rational).adaptation == error_problem(system, rational).adaptation
        )
        assert rational(other.plant.uncertainty.tau[0]) == flint.fmpq(1, 3)


@given(st.fractions(-1000, 1000, max_denominator=10**30))
def test_a_float_stands_for_the_rational_it_was_written_as(exact):
    value = nearest_float(exact)
    assert exact_rational(value) == exact
    assert float(value) == float(exact)
    assert exact_rational(pickle.loads(pickle.dumps(value))) == exact
    above, below = stated_above(value), float_below(exact)
    assert Fraction(below) <= exact <= Fraction(above)
    assert Fraction(repr(below)) <= exact <= Fraction(repr(above))


def test_literals_of_any_length_end():
    assert decimal_float("1e400") == math.inf
    assert type(decimal_float("1e-999999999")) is float
    assert type(decimal_float("0.1")) is float
    assert isinstance(decimal_float("0.10000000000000000001"), RationalFloat)
    assert type(decimal_float("0." + "1" * 300)) is float


def test_declared_bounds_are_not_below_their_decimals():
    reference = certrack.SymbolicReference("0.3*sin(t)", declared=(0.3, 0.7), bound=0.9)
    values = reference.bounds(1).values
    assert [Fraction(v) >= Fraction(t) for v, t in zip(values, ("0.3", "0.7"), strict=True)] == [
        True,
        True,
    ]
    assert Fraction(0.3) < Fraction("0.3")  # what was taken before
    assert float_above(sympy.Rational(3, 10)) == math.nextafter(0.3, 1)


@given(
    st.lists(st.lists(st.integers(-9, 9), min_size=3, max_size=3), min_size=3, max_size=3),
    st.integers(0, 3),
)
def test_definiteness_of_rationals_is_that_of_the_leading_determinants(rows, shift):
    L = np.array(rows)
    M = L @ L.T + (shift - 1) * np.eye(3, dtype=int)
    minors = [sympy.Matrix(M[:k, :k].tolist()).det() for k in (1, 2, 3)]
    exact = [[Fraction(int(v), 7) for v in row] for row in M]
    assert exactly_positive_definite(exact) == all(m > 0 for m in minors)


def test_floats_are_rounded_down_and_up():
    third = flint.fmpq(1, 3)
    assert exactly(float_down(third)) <= Fraction(1, 3) <= exactly(float_up(third))
    assert float_down(third) == math.nextafter(float_up(third), 0)
    assert float_down(flint.fmpq(-1, 3)) == -float_up(third)


@pytest.mark.parametrize("name", ["example1", "dual-motor", "dual-motor-lean"])
def test_rates_are_rounded_down_and_constants_up(name):
    system = certrack.load(name)
    certificates = [certify_semidefinite(system)]
    if name == "example1":
        cascade, stages = certify_cascade(system)
        certificates.append((cascade, stages[-1]))
    for certificate, proof in certificates:
        alpha, bound = Fraction(proof.alpha), Fraction(proof.bound)
        assert Fraction(certificate.alpha) <= alpha
        assert Fraction(certificate.delta) >= bound**2 * alpha / 2
        assert certificate.delta == pytest.approx(float(bound**2 * alpha / 2), rel=1e-12)


def full_gamma():
    """Example 1 with two parameters and a full Gamma, whose smallest eigenvalue is irrational."""
    base = certrack.load("example1")
    plant = replace(base.plant, regressor=("1 + x1*sin(x2)", "x1/3"), theta=None)
    law = replace(base.law, theta0=(2.1, 0.2), Gamma=((1.0, 0.3), (0.3, 0.7)))
    return base.replace(plant=plant, law=law, truth=replace(base.truth, theta=(2.0, 0.1)))


@pytest.mark.parametrize("system", [certrack.load("example1"), full_gamma()], ids=["1", "full"])
def test_corrected_and_rate_are_those_of_their_formulas_and_verified(system):
    """Against 50 digits, at the eps that the certificate chose: its delta tells it."""
    found = certify_published(system)
    Gamma = collect(system, rational).adaptation.Gamma
    with mp.workdps(50):
        matrix = mp.matrix([[mp.mpf(int(v.p)) / int(v.q) for v in row] for row in Gamma])
        smallest = min(mp.eigsy(matrix, eigvals_only=True))
        alpha = mp.mpf(6) / 10 * min(smallest, 1)  # gbar2 lambda_min, gbar gbar1
        assert mp.mpf(found["rate"].alpha) <= alpha
        assert found["rate"].alpha == pytest.approx(float(alpha), rel=1e-9)
        least = mp.sqrt(2 * mp.mpf(found["rate"].delta) / alpha)
        assert found["rate"].bound >= float(least) * (1 - 1e-15)
        assert found["rate"].bound == pytest.approx(float(least), rel=1e-9)
    assert found["corrected"].verified
    assert found["rate"].verified
    assert not found["published"].verified


def test_the_smallest_eigenvalue_is_bounded_from_below():
    for rows in ([[1, 0.3], [0.3, 0.7]], [[2, -1], [-1, 0.6]], [[1e-3, 0], [0, 5]]):
        exact = np.array([[rational(v) for v in row] for row in rows], dtype=object)
        below = _smallest_eigenvalue(exact)
        with mp.workdps(40):
            matrix = mp.matrix([[mp.mpf(int(v.p)) / int(v.q) for v in row] for row in exact])
            true = min(mp.eigsy(matrix, eigvals_only=True))
            assert mp.mpf(int(below.p)) / int(below.q) <= true + mp.mpf(10) ** -35
            assert float(below) == pytest.approx(float(true), rel=1e-8)


def test_an_eigenvalue_that_floats_make_too_large_is_not_taken():
    """0.1 d - 0.09 is 1e-26 here, and eigvalsh gives 1e-17."""
    tiny = flint.fmpq(1, 10**25)
    exact = np.array([[rational(v) for v in row] for row in [[0.1, 0.3], [0.3, 0.9]]], dtype=object)
    exact[1, 1] += tiny
    assert np.linalg.eigvalsh(exact.astype(float)).min() > 0
    with pytest.raises(certrack.NoCertificate, match="too near to a singular matrix"):
        _smallest_eigenvalue(exact)


def test_times_of_settling_are_not_too_early():
    """Against 50 digits, for levels near the floor, where floats lose all digits of the gap."""
    tube = Tube(2.0, 0.01, 0.7)
    with mp.workdps(50):
        for excess in (1e-11, 1e-9, 1e-6, 1e-3, 0.1, 1.0):
            level = math.sqrt(0.01 * (1 + excess))
            limit, floor = mp.mpf(level) ** 2, mp.mpf(0.01)
            exact = mp.log((2 - floor) / (limit - floor)) / mp.mpf(0.7)
            assert exact <= tube.settling_time(level) <= exact * (1 + mp.mpf(10) ** -11)


def test_a_bound_that_is_not_verified_is_never_the_best():
    found = certify(certrack.load("dual-motor-lean"))
    fake = replace(found.rate, bound=1e-9, verified=False)
    assert replace(found, rate=fake, corrected=fake).best == found.peak
    assert certrack.certificates.best_sound_bound(certrack.load("dual-motor")) == pytest.approx(
        0.02670710, rel=1e-6
    )


def test_the_tube_starts_at_the_exact_energy():
    """Example 1 at a reference whose start is irrational, against 60 digits."""
    base = certrack.load("example1")
    system = base.replace(reference=certrack.SymbolicReference("0.2*cos(t + 1)"))
    _, proof = certify_semidefinite(system)
    found = tube_of(system, proof)
    coordinates = error_coordinates(system, rational)
    with mp.workdps(60):

        def number(v):
            return mp.mpf(exactly(v).numerator) / exactly(v).denominator

        y = mp.mpf(2) / 10 * mp.cos(1)
        x = [mp.mpf(1), mp.mpf(2)]
        e = [sum(number(a) * v for a, v in zip(row, x, strict=True)) for row in coordinates.A]
        e = [v - number(b) * y for v, b in zip(e, coordinates.B[:, 0], strict=True)]
        P = [[number(from_text(v)) for v in row] for row in proof.P]
        energy = sum(P[i][j] * e[i] * e[j] for i in range(2) for j in range(2)) / 2
        energy += P[1][1] * (2 * mp.mpf("0.5") ** 2 / 2 + mp.mpf(2) ** 2 / 2)
        assert mp.mpf(found.start) >= 2 * energy
        assert found.start == pytest.approx(float(2 * energy), rel=1e-8)
    assert found.verified


def test_the_reference_and_the_states_at_the_start_are_enclosed():
    for name in certrack.catalog():
        system = certrack.load(name)
        q = system.controller.coordinates.q
        with ball_precision():
            Y, proven = reference_at_start(system, q)
            x, known = states_at_start(system)
        assert proven and known
        floats = system.reference.values(np.array([0.0]), q)[:, 0]
        for ball, value in zip(Y, floats.tolist(), strict=True):
            assert abs(float(ball.mid()) - value) <= 1e-15 * (1 + abs(value))
        assert len(x) == system.plant.n


def test_a_start_that_no_ball_encloses_is_that_of_floats_and_unproven(monkeypatch):
    """Of a plant with states of its own, and of a reference."""
    base = certrack.load("dual-motor-physical")
    system, same = (base.with_settings(x0=(0.1, 0.2, -0.3, 0.4, 0.5, -0.6)) for _ in range(2))
    q = system.controller.coordinates.q
    with ball_precision():
        before = states_at_start(system)[0], reference_at_start(system, q)[0]

        def refuse(formula, values):
            raise ValueError("no rule")

        monkeypatch.setattr(start_room, "enclosing_ball", refuse)
        after = states_at_start(same), reference_at_start(same, q)
    for exact, (balls, proven) in zip(before, after, strict=True):
        assert not proven and len(balls) == len(exact) > 0
        for ball, known in zip(balls, exact, strict=True):
            value = float(known.mid())
            assert float(ball.mid()) == pytest.approx(value, rel=1e-12, abs=1e-15)
            assert float(ball.rad()) == pytest.approx(1e-9 * abs(value), rel=1e-6, abs=1e-24)


BALLS = "sin(x) cos(x) tan(x) asin(x) acos(x) atan(x) sinh(x) cosh(x) tanh(x) exp(x) log(x) sqrt(x)"


@pytest.mark.parametrize(
    "formula", [*BALLS.split(), "abs(-x)", "max(x,1/3)", "min(x,1/3)", "x**3/(1+x)", "pi*x**-1.5"]
)
def test_balls_hold_the_values_of_formulas(formula):
    expr = certrack.core.expressions.parse("f", formula, ["x"]).expr
    x = certrack.laws.symbol("x")
    with ball_precision():
        ball = enclosing_ball(expr, {x: ball_of(0.3)})
    true = sympy.N(expr.subs(x, sympy.Rational(3, 10)), 60)
    assert Fraction(str(true)) <= exactly(upper_rational(ball)) + Fraction(1, 10**55)
    assert float(ball.mid()) == pytest.approx(float(true), rel=1e-14)
    with pytest.raises(ValueError, match="no finite value"), ball_precision():
        enclosing_ball(sympy.log(x), {x: ball_of(-1.0)})


def test_a_start_without_a_rule_is_marked(monkeypatch):
    system = certrack.load("example1")

    def no_rule(*_):
        raise ValueError("no rule")

    monkeypatch.setattr("certrack.certificates.start.enclosing_ball", no_rule)
    _, proof = certify_semidefinite(system)
    found = tube_of(system, proof)
    assert not found.verified
    assert found.start == pytest.approx(tube_of(system, proof).start)


def test_a_tube_is_positive_at_every_time_at_which_the_true_one_is():
    """e^{-800} is no float."""
    assert Tube(1.0, 0.0, 1.0)(np.array([800.0]))[0] >= math.exp(-400)


def states_nothing(self, s):
    return None


@dataclass(frozen=True, kw_only=True)
class Renamed(Robust):
    """The same equations, written otherwise."""

    kind = "renamed"

    def equations(self, s):
        g_n, theta = s.parameter("g_n"), s.parameters("theta", s.r)
        both = sympy.Add(*(-p * v for p, v in zip(s.phi, theta, strict=True)), s.nu)
        return Equations(u=both * (1 + g_n) / (g_n + g_n**2))


@dataclass(frozen=True, kw_only=True)
class Zero(Robust):
    kind = "zero"

    def equations(self, s):
        return Equations(u=0 * super().equations(s).u)


@dataclass(frozen=True, kw_only=True)
class WrongSign(Robust):
    kind = "wrong-sign"

    def equations(self, s):
        return Equations(u=-super().equations(s).u)


@dataclass(frozen=True, kw_only=True)
class OtherNumbers(Robust):
    kind = "other-numbers"

    def parameters(self, plant):
        return {**super().parameters(plant), "g_n": 1.001 * float(plant.input_gain.expr)}


@dataclass(frozen=True, kw_only=True)
class OtherRecursion(Robust):
    kind = "other-recursion"

    def coordinates(self, plant):
        design = super().coordinates(plant)
        return replace(design, nu_x=1.01 * design.nu_x)


@dataclass(frozen=True, kw_only=True)
class OtherController(Robust):
    """Its equations are right, and not what runs."""

    kind = "other-controller"

    def normal_equations(self, s):
        equations = super().normal_equations(s)
        return Equations(u=equations.u / 2)


@dataclass(frozen=True, kw_only=True)
class OtherValues(Adaptive):
    kind = "other-values"

    def design(self, plant):
        controller = super().design(plant)
        return replace(controller, values=1.1 * controller.values)


@dataclass(frozen=True, kw_only=True)
class Silent(Robust):
    kind = "silent"
    error_system = states_nothing


@dataclass(frozen=True, kw_only=True)
class Flipped(Adaptive):
    kind = "flipped"

    def equations(self, s):
        e = super().equations(s)
        return Equations(e.u, tuple((z, -rate) for z, rate in e.update))


@dataclass(frozen=True, kw_only=True)
class TwiceTheLeak(Adaptive):
    kind = "twice-the-leak"

    def error_system(self, s):
        stated = super().error_system(s)
        return replace(stated, leak_gain=2 * stated.leak_gain)


@dataclass(frozen=True, kw_only=True)
class ClaimsToKnow(Adaptive):
    kind = "claims-to-know"

    def error_system(self, s):
        return KnownParameters(s.parameter("gain_rate"), s.parameters("theta0", s.r))


@dataclass(frozen=True, kw_only=True)
class Draining(Adaptive):
    """Leakage of the wrong sign: the identity holds, the theorem does not."""

    kind = "draining"

    def parameters(self, plant):
        return {**super().parameters(plant), "leak_gain": -0.6}


def with_law(name, law):
    base = certrack.load(name)
    values = {f.name: getattr(base.law, f.name) for f in fields(base.law)}
    return base.replace(law=law(**values))


def test_a_law_is_certified_by_its_equations_whatever_its_class():
    found, _ = certify_semidefinite(with_law("dual-motor-lean", Renamed))
    assert found.verified
    assert found.bound == certify_semidefinite(certrack.load("dual-motor-lean"))[0].bound


@pytest.mark.parametrize(
    ("name", "law", "reason"),
    [
        ("dual-motor-lean", Zero, "its u is another"),
        ("dual-motor-lean", WrongSign, "its u is another"),
        ("dual-motor-lean", OtherNumbers, "plant.input_gain"),
        ("dual-motor-lean", OtherRecursion, "its nu_x is not that of the recursion"),
        ("dual-motor-lean", OtherController, "what runs as u is another"),
        ("example1", OtherValues, "has another number"),
        ("dual-motor-lean", Silent, "that of the recursion, not silent"),
        ("example1", Flipped, "the rate of delta_hat is another"),
        ("example1", TwiceTheLeak, "the rate of delta_hat is another"),
        ("example1", ClaimsToKnow, "its own states are not the estimates"),
        ("example1", Draining, "must be positive"),
        ("example1-classic", None, "without leakage"),
    ],
)
def test_a_law_that_does_not_obey_what_it_states_has_no_certificate(name, law, reason):
    system = certrack.load(name) if law is None else with_law(name, law)
    found = certify(system)
    assert reason in found.semidefinite.reason
    assert not any(c.exists for c in (found.published, found.corrected, found.rate, found.cascade))
    assert found.critical_semidefinite == found.critical_published == 0


@pytest.mark.parametrize("integral", [None, 4.0])
def test_the_numbers_of_a_law_are_those_of_the_recursion_but_for_roundings(monkeypatch, integral):
    """Relative to the largest of each group: 1e-10 is a rounding, 1e-8 another design."""
    base = certrack.load("dual-motor-lean")
    law = replace(base.law, integral=integral)
    honest = stated_room.recursion

    def apart(name, relative):
        """The design with all numbers of a group off by a part of its largest."""

        def recursion(*parts, **options):
            design = honest(*parts, **options)
            if name in ("column", "nu"):
                old = getattr(design.integral, name)
                part = replace(design.integral, **{name: old + relative * np.abs(old).max()})
                return replace(design, integral=part)
            old = getattr(design, name)
            return replace(design, **{name: old + relative * np.abs(old).max()})

        return recursion

    groups = {"A": "A_n", "B": "B_n", "nu_x": "nu_x", "nu_Y": "nu_Y"}
    groups |= {} if integral is None else {"column": "A_n0", "nu": "nu_0"}
    for name, said in groups.items():
        for relative in (1e-13, 1e-8):
            system = base.replace(law=law)  # nothing is kept with another object
            monkeypatch.setattr(stated_room, "recursion", apart(name, relative))
            if relative < 1e-9:
                assert stated_error_system(system, integral=True)
            else:
                with pytest.raises(NoCertificate, match=f"its {said} is not that of"):
                    stated_error_system(system, integral=True)
    if integral is not None:
        with pytest.raises(NoCertificate, match=re.escape(stated_room.INTEGRAL_ACTION)):
            stated_error_system(base.replace(law=law))


def test_a_law_runs_with_the_subnormal_numbers_that_it_states():
    """Rounded first to 53 bits and then to a subnormal float, these become other floats."""
    system = certrack.load("example1")
    for number in (1.766551574016232e-308, 1.546147210739702e-308, 5e-324):
        law = replace(system.law, leak_gain=number)
        stated = stated_error_system(system.replace(law=law))
        assert rational(stated.leak_gain) == rational(number)


def test_the_critical_strength_is_told_above_all_where_there_is_no_certificate(tmp_path):
    text = certrack.to_text(certrack.load("dual-motor-lean"))
    path = tmp_path / "strong.toml"
    path.write_text(text.replace("tau = [0.0, 1.0, 0.0, 1.0]", "tau = [0.0, 100.0, 0.0, 100.0]"))
    done = CliRunner().invoke(cli, ["certify", str(path)])
    assert done.exit_code == 0
    assert "semidefinite 0.89" in done.output
    assert CliRunner().invoke(cli, ["certify", str(path), "--require"]).exit_code == 1
    told = json.loads(CliRunner().invoke(cli, ["certify", str(path), "--json"]).stdout)
    assert told["critical_strength"]["beyond"] is False
    assert told["critical_strength"]["semidefinite"] == pytest.approx(0.8905, rel=1e-3)


def test_without_a_term_that_grows_the_strength_is_beyond_what_is_looked_for(tmp_path):
    text = certrack.to_text(certrack.load("dual-motor-lean"))
    path = tmp_path / "bounded.toml"
    path.write_text(text.replace("gamma = [0.0, 0.01, 0.0, 0.01]", "gamma = [0, 0, 0, 0]"))
    done = CliRunner().invoke(cli, ["certify", str(path)])
    assert "semidefinite > 1e9 (no term grows with the state)" in done.output
    told = json.loads(CliRunner().invoke(cli, ["certify", str(path), "--json"]).stdout)
    assert told["critical_strength"]["semidefinite"] == 1e9
    assert told["critical_strength"]["beyond"] is True


@pytest.mark.parametrize(
    "exact",
    [
        Fraction(10**302 + 1, 3 * 10**100 + 1),
        Fraction(-(10**250) - 7, 10**500 + 3),
        Fraction(7**700, 11**560),
        Fraction(10**200, 3),
        Fraction(-(10**199), 7),
        Fraction(3**5000, 5**3400),
    ],
)
def test_rationals_of_many_digits_are_written_as_formulas_that_are_read_again(exact):
    """A file holds no integer beyond 1e300; what was loaded was refused once it had been saved."""
    value = RationalFloat(exact)
    assert exact_rational(checks.real("key", value.text)) == exact

"""Parts of the certificates that few systems reach: conditions of proofs, searches, enclosures."""

import copy
import json
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from types import SimpleNamespace

import flint
import numpy as np
import pytest
import sympy
from mpmath import iv, mp
from test_forged_claims import DRIVEN_APART
from test_independent_checker import signed
from test_independent_ranges import VARIANTS

import certrack
from certrack.certificates import premises, to_document, verify
from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import decimal, rational
from certrack.certificates.assumption_1 import UncertainTerm
from certrack.certificates.balls import ball_precision, enclosing_ball
from certrack.certificates.centred import RemainderBound
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.cover import _Suprema, smallest_cover
from certrack.certificates.domain import Condition, conditions
from certrack.certificates.exact import Proof, failed_condition, from_text, prove, squared_bound
from certrack.certificates.formulation import error_coordinates, error_problem, uncertain_inputs
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.intervals import enclosure
from certrack.certificates.layout import FORMAT_1
from certrack.certificates.majorants import (
    MAX_KEPT,
    _below,
    _best,
    _plus,
    _root_of,
    _times,
    covers,
    interval_ends,
    majorants,
    root_above,
)
from certrack.certificates.methods import METHOD_STEPS, every_certificate, smallest
from certrack.certificates.own_multipliers import own_multipliers, own_solution
from certrack.certificates.premises_of_truth import DOMAIN, GAIN, THETA, _rewriting, _same
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.published import best_eps, collect, residual_damping
from certrack.certificates.ranges.cells import halved
from certrack.certificates.ranges.proofs import MAX_PROOF_CELLS, RangeProver
from certrack.certificates.sampling import Points, random_points
from certrack.certificates.scaling import COUPLING, _gramian_diagonal, _not_slaved, _size_under
from certrack.certificates.semidefinite import Solution, best_solution
from certrack.certificates.strength import _provable
from certrack.certificates.tube import Tube
from certrack.core.errors import InputError
from certrack.core.expressions import parse, symbol
from certrack.core.magnitudes import largest_magnitudes
from certrack.laws.recursion import recursion

# the conditions of a proof, on a loop of two states whose inequality is solved by hand


def q(*rows):
    """A matrix of rationals."""
    return np.array([[rational(v) for v in row] for row in rows], dtype=object)


#: e' = -2 e + (a/2 + b + y/4, 0), x = e: with P = 2 I and multipliers 1 what must be positive is
#: (4 - 2 alpha/2 - lam) - (1/4)/lam - 1/nu - (1/16)/k, and 2 (nu + k)/alpha = 4.
LOOP = ErrorProblem(
    M=q(["-2", "0"], ["0", "-2"]),
    Ua=q(["1/2"], ["0"]),
    Ub=q(["1"], ["0"]),
    Uy=q(["1/4"], ["0"]),
    Xe=q(["1", "0"], ["0", "1"]),
    Xy=q(["0"], ["0"]),
    states=((0,), (0,)),
    derivatives=(0,),
    adaptation=None,
)
PROOF = Proof("1", (("2", "0"), ("0", "2")), ("1",), ("1",), ("1",), "2")

FAILING = [
    ({"P": (("2",),)}, "do not have the shape"),
    ({"lam": ("1", "1")}, "do not have the shape"),
    ({"nu": ()}, "do not have the shape"),
    ({"P": (("2", "0.01"), ("0", "2"))}, "P is not symmetric"),
    ({"alpha": "0"}, "alpha is not positive"),
    ({"alpha": "-1"}, "alpha is not positive"),
    ({"lam": ("-1",)}, "a multiplier is negative"),
    ({"nu": ("-1",)}, "a multiplier is negative"),
    ({"k": ("-1e-9",)}, "a multiplier is negative"),
    ({"P": (("1", "0"), ("0", "2"))}, "P - e_1 e_1^T is not positive definite"),
    ({"P": (("0.9", "0"), ("0", "2"))}, "P - e_1 e_1^T is not positive definite"),
    ({"lam": ("0",)}, "the matrix inequality does not hold"),
    ({"nu": ("0.5",)}, "the matrix inequality does not hold"),
    ({"k": ("0",)}, "the matrix inequality does not hold"),
    ({"alpha": "1.69"}, "the matrix inequality does not hold"),  # 4 - 1.69 - 2.3125 < 0
    ({"bound": "1.9999999999"}, "the bound is smaller"),
    ({"bound": "-2"}, "the bound is smaller"),
]


@pytest.mark.parametrize(("changed", "message"), FAILING)
def test_each_condition_of_a_proof_is_named(changed, message):
    assert message in failed_condition(LOOP, replace(PROOF, **changed))


def test_a_proof_holds_up_to_its_numbers():
    assert failed_condition(LOOP, PROOF) == ""
    assert failed_condition(LOOP, replace(PROOF, bound="3")) == ""
    assert failed_condition(LOOP, replace(PROOF, alpha="1.68", bound="2")) == ""
    assert squared_bound(LOOP, PROOF) == 4
    assert squared_bound(LOOP, replace(PROOF, alpha="1.69")) is None
    assert squared_bound(LOOP, replace(PROOF, P=(("1", "0"), ("0", "2")))) is None


def test_the_target_is_the_coordinate_that_p_must_exceed():
    small = replace(PROOF, P=(("2", "0"), ("0", "0.5")), lam=("0.5",))
    assert failed_condition(LOOP, small) == ""
    assert "P - e_2 e_2^T" in failed_condition(LOOP, small, target=1)
    assert squared_bound(LOOP, small, target=1) is None


def adaptive(**changed):
    """The loop with estimates that forget at the rates 2 gbar gbar1 = 6 and 2 gbar2 Gamma = 3."""
    numbers = {"gain_rate": 1, "leak_gain": 3, "leak_theta": "3/2", "delta0": 0} | changed
    Gamma = numbers.pop("Gamma", q(["1"]))
    exact = {name: rational(value) for name, value in numbers.items()}
    law = Adaptation(
        **exact,
        Gamma=Gamma,
        gains=(rational(1),),
        gain_sign=1,
        theta0=np.array([rational(0)]),
        theta_box=((rational(0), rational(2)),),
    )
    return replace(LOOP, adaptation=law)


def test_conditions_of_a_proof_with_estimates():
    """(delta - delta_0)^2 gbar1/(4 s1) + gbar2^2 4/(4 w): 3/(4 5/6) + (9/4)/(3/2 - 1/2)."""
    square = 4 + 2 * 2 * (Fraction(9, 10) + Fraction(9, 4))
    assert squared_bound(adaptive(), PROOF) == rational(square)
    bound = str(math.sqrt(square) * (1 + 1e-9))
    assert failed_condition(adaptive(), replace(PROOF, bound=bound)) == ""
    assert "smaller" in failed_condition(adaptive(), PROOF)
    coupled = (("2", "0.01"), ("0.01", "2"))
    assert "couples e_n" in failed_condition(adaptive(), replace(PROOF, P=coupled))
    assert failed_condition(LOOP, replace(PROOF, P=coupled)) == ""
    assert "Gamma" in failed_condition(adaptive(Gamma=q(["-1"])), PROOF)
    assert "leakage" in failed_condition(adaptive(leak_gain="1/4"), PROOF)
    assert "leakage" in failed_condition(adaptive(leak_theta="1/4"), PROOF)


def test_what_a_solver_finds_is_rounded_until_it_is_proven():
    """An optimum has no room: it is confirmed after it gave way, by as little as that takes."""
    one = np.ones(1)
    edge = Solution(1.0, 2 * np.eye(2), one, 1 / 1.6875 * one, one, 1 + 1 / 1.6875, one)
    found = prove(LOOP, edge)
    assert found is not None and failed_condition(LOOP, found) == ""
    least = math.sqrt(2 * edge.delta)
    assert least <= float(found.bound) <= least * (1 + 1e-5)
    assert prove(LOOP, replace(edge, nu=0.5 * one, delta=1.5)) is None


# the search over alpha


class Valley:
    """A bound whose square has its least value at `best`, feasible between two rates."""

    def __init__(self, best, low=0.0, fastest=10.0, high=10.0):
        self.best, self.low, self.fastest, self.high = best, low, fastest, high
        self.asked = []

    def solve(self, alpha):
        self.asked.append(alpha)
        if not self.low <= alpha <= self.high:
            return None
        return SimpleNamespace(bound=1 + math.log(alpha / self.best) ** 2, alpha=alpha)


@pytest.mark.parametrize("best", [0.011, 0.5, 3.0, 9.5])
def test_the_best_rate_is_found_without_a_guess(best):
    found = best_solution(Valley(best))
    assert found.bound < 1 + 1e-4 and 0.98 * best < found.alpha < 1.02 * best


def test_no_rate_has_a_solution_outside_of_what_is_feasible():
    assert best_solution(Valley(0.3, high=0.5)).bound < 1 + 1e-4
    assert best_solution(Valley(0.3, low=20.0, high=0.0)) is None
    assert best_solution(Valley(0.3, fastest=0.0)) is None


def test_no_strength_is_provable_of_a_loop_that_is_unstable_or_leaves_the_floats():
    assert _provable(LOOP, 1.0, math.inf)
    assert not _provable(replace(LOOP, M=-LOOP.M), 1.0, math.inf)
    assert not _provable(replace(LOOP, M=0 * LOOP.M), 1.0, math.inf)
    assert not _provable(LOOP, 1e200, math.inf)
    assert _provable(LOOP, 3.9, math.inf) and not _provable(LOOP, 4.1, math.inf)


# error coordinates


CHAIN = certrack.Plant(
    states=["x1", "x2", "x3"],
    chain=[2, "1/3"],
    linear=[[-1], ["1/2", -1]],
    input_gain=2,
    theta=[],
    uncertainty=certrack.Uncertainty([0.1, 0.1, 0.2], [0.1, 0.1, 0.1], [0.0, 0.1, 0.1]),
)


def chain_with(law, reference="0.2*cos(t)"):
    start = certrack.Settings([0, 0, 0], 40, tail=1)
    return certrack.System(
        CHAIN, law, certrack.SymbolicReference(reference), certrack.Truth(2), start
    )


@pytest.mark.parametrize("coupling", [None, 1])
@pytest.mark.parametrize("integral", [None, 3])
@pytest.mark.parametrize("feedforward", [0, 1, 2])
def test_exact_coordinates_are_those_of_the_controller(coupling, integral, feedforward):
    law = certrack.Robust(
        c=(4, 5, 6), feedforward=feedforward, integral=integral, coupling=coupling
    )
    system = chain_with(law)
    exact = error_coordinates(system, rational)
    floats = recursion(CHAIN.g, CHAIN.b, law.gains(), law.order(CHAIN))
    for name in ("A", "B", "F", "c", "nu_x", "nu_Y"):
        found = getattr(exact, name).astype(float)
        assert found == pytest.approx(getattr(floats, name), rel=1e-9, abs=1e-9), name
    assert exact.error_matrix.astype(float) == pytest.approx(floats.error_matrix, abs=1e-9)
    assert exact.A.dtype == object and exact.q == floats.q
    if integral is not None:
        assert exact.integral.column.astype(float) == pytest.approx(floats.integral.column)
        assert float(exact.integral.nu) == pytest.approx(floats.integral.nu)


@pytest.mark.parametrize("feedforward", [0, 1])
def test_what_the_reference_costs_the_published_proof(feedforward):
    damping = {"k": [[1] * (2 * m) for m in range(1, 4)], "p": [0.7, 0.9]}
    law = certrack.Robust(c=(4, 5, 6), feedforward=feedforward, **damping)
    system = chain_with(law, "0.2*cos(3*t)")
    Y = system.reference.bounds(feedforward + 1).values
    A, B, R = (
        getattr(system.controller.coordinates, name).astype(float) for name in ("A", "B", "R")
    )
    through = np.linalg.solve(A, B)
    for number in (decimal, rational):
        terms = collect(system, number)
        if feedforward:
            expected = ((np.abs(through) @ Y[: feedforward + 1]) ** 2).sum()
            last = Y[feedforward + 1]
        else:
            last = certrack.references.base.total_bound(system.reference)
            expected = (through**2).sum() * last**2
        residual = sum(p for p, r in zip((0.7, 0.9), R, strict=False) if r) * last**2
        assert float(terms.reference2) == pytest.approx(expected, rel=1e-9)
        assert float(terms.residual) == pytest.approx(residual, rel=1e-9) and residual > 0


# the remainder of a centred stage


def test_the_remainder_is_bounded_by_the_whole_ellipsoid():
    """h = x2, phi = (x1, 1): 2 |x2| + |x1| N_1 + N_2 at the largest of each, by hand.

    P = diag(4, 9, 16) and B = 2: |e_i| <= 2/(2, 3, 4), and s N_i^2 <= B^2 Gamma_ii with s = 16.
    """
    plant = replace(
        CHAIN, drift="2*x2", regressor=["x1", "1"], theta=None, input_gain=None, uncertainty=None
    )
    law = certrack.Adaptive(
        c=[4, 5, 6],
        feedforward=2,
        gain_rate=1,
        leak_gain=1,
        leak_theta=1,
        Gamma=[[4.0, 0.0], [0.0, 9.0]],
    )
    system = certrack.System(
        plant,
        law,
        certrack.SymbolicReference("0*t"),
        certrack.Truth(2.0, (1.0, 1.0)),
        certrack.Settings([0, 0, 0], 40, tail=1),
    )
    problem = error_problem(system, rational)
    P = (("4", "0", "0"), ("0", "9", "0"), ("0", "0", "16"))
    reached = Proof("1", P, (), (), (), "2")
    spread = problem.Xe.astype(float) ** 2 @ (4 / np.array([4.0, 9.0, 16.0]))
    x1, x2 = np.sqrt(spread[:2])
    expected = 2 * x2 + x1 * 2 * 2 / 4 + 2 * 3 / 4
    found = float(RemainderBound(system, problem)(reached))
    assert expected <= found <= expected * (1 + 1e-9)


def test_largest_magnitudes_hold_what_underflows():
    """And every value of a formula on boxes of all sizes."""
    a, b, c, x, y = sympy.symbols("a b c x y", real=True)
    tiny, huge = np.full(1, 1e-200), np.full(1, 1e300)
    box = {a: (tiny, tiny), b: (tiny, tiny), c: (huge, huge)}
    assert largest_magnitudes(a * b * c, box, 1)[0] >= 1e-100
    assert largest_magnitudes(sympy.exp(-x) * c, {x: (huge, huge), c: (huge, huge)}, 1)[0] > 0
    sizes = 10.0 ** np.arange(-6, 3)
    pair = dict.fromkeys((x, y), (-sizes, 2 * sizes))
    formula = sympy.log(1 + x**2) * sympy.sin(x * y) - sympy.sqrt(1 + y**2) / 7
    found = largest_magnitudes(formula, pair, len(sizes))
    draws = np.random.default_rng(3).uniform(-1, 2, (2, 1000))[..., None] * sizes
    values = abs(sympy.lambdify([x, y], formula)(*draws)).max(axis=0)
    assert (values <= found).all()
    assert found[0] <= values[0] * (1 + 1e-6)


# tubes


def test_a_tube_that_stands_at_a_level_has_settled_there():
    still = Tube(4.0, 4.0, 1.0)
    assert still.settling_time(2.0) == 0.0
    assert math.isinf(still.settling_time(math.nextafter(2.0, 0)))
    falling = Tube(16.0, 4.0, 0.5)
    assert falling.settling_time(4.0) == 0.0
    assert falling.settling_time(3.0) == pytest.approx(math.log(12 / 5) / 0.5)
    rising = Tube(1.0, 4.0, 0.5)
    assert math.isinf(rising.settling_time(1.5)) and rising.settling_time(2.1) == 0.0


@pytest.mark.parametrize("t", [-1e-9, [0.0, 3.0, -2.0], math.nan])
def test_a_tube_begins_at_the_start(t):
    with pytest.raises(InputError, match="at least 0"):
        Tube(4.0, 1.0, 1.0)(t)


def test_the_first_time_before_the_start_is_named():
    with pytest.raises(InputError, match=r"-2"):
        Tube(4.0, 1.0, 1.0)([0.0, -2.0, -5.0])


# enclosures of formulas

X = symbol("x")


def interval(text, low, high):
    found = enclosure(parse("", text, ["x"]).expr, {X: iv.mpf([low, high])})
    return float(mp.mpf(found.a)), float(mp.mpf(found.b))


@pytest.mark.parametrize(
    ("text", "box", "values"),
    [
        ("tan(x)", (-1, 0.5), (math.tan(-1), math.tan(0.5))),
        ("tan(x)", (2, 4), (math.tan(2), math.tan(4))),  # the cosine is negative
        ("cosh(x)", (-1, 2), (1, math.cosh(2))),
        ("cosh(x)", (-3, 1), (1, math.cosh(3))),
        ("cosh(x)", (1, 2), (math.cosh(1), math.cosh(2))),
        ("cosh(x)", (-3, -1), (math.cosh(1), math.cosh(3))),
        ("cosh(x)", (0.5, "inf"), (math.cosh(0.5), math.inf)),
        ("sinh(x)", (-3, 1), (math.sinh(-3), math.sinh(1))),
        ("sinh(x)", ("-inf", 2), (-math.inf, math.sinh(2))),
        ("sinh(x)", (-1, "inf"), (math.sinh(-1), math.inf)),
        ("asin(x)", (-1, 0.5), (-math.pi / 2, math.asin(0.5))),
        ("asin(x)", (-0.25, 1), (math.asin(-0.25), math.pi / 2)),
        ("acos(x)", (-0.25, 0.5), (math.acos(0.5), math.acos(-0.25))),
        ("log(x)", (0.5, 3), (math.log(0.5), math.log(3))),
        ("log(x)", (2, "inf"), (math.log(2), math.inf)),
        ("atan(x)", (-1, 2), (math.atan(-1), math.atan(2))),
        ("atan(x)", ("-inf", "inf"), (-math.pi / 2, math.pi / 2)),
        ("tanh(x)", (-1, 2), (math.tanh(-1), math.tanh(2))),
        ("tanh(x)", ("-inf", "inf"), (-1, 1)),
        ("abs(x)", (-3, 1), (0, 3)),
        ("min(x, 0.5)", (-3, 1), (-3, 0.5)),
        ("max(x, 0.5)", (-3, 1), (0.5, 1)),
        ("sign(x)", (2, 3), (-1, 1)),
        ("sin(x)", (0, "inf"), (-1, 1)),
        ("cos(x)", (0.5, 1), (math.cos(1), math.cos(0.5))),
        ("sqrt(x)", (0, 4), (0, 2)),
        ("x**1.5", (0, 4), (0, 8)),
        ("x**(-0.5)", (0.25, 4), (0.5, 2)),
        ("x**3", (-2, 1), (-8, 1)),
        ("x**2", (-2, 1), (0, 4)),
        ("1/x", (-4, -2), (-0.5, -0.25)),
        ("x**(-2)", (2, 4), (1 / 16, 0.25)),
        ("x**pi", (1, 2), (1, 2**math.pi)),
        ("x**(1/3)", (1, 8), (1, 2)),
        ("1/3 - 2*x", (-1, 2), (1 / 3 - 4, 1 / 3 + 2)),
        ("pi*x", (1, 2), (math.pi, 2 * math.pi)),
    ],
)
def test_an_enclosure_is_the_range_of_a_function(text, box, values):
    """Outward, and by roundings only."""
    low, high = interval(text, *box)
    assert low <= values[0] and high >= values[1]
    assert (low, high) == pytest.approx(values, rel=1e-12, abs=1e-12)
    ends = interval_ends(parse("", text, ["x"]).expr, {X: iv.mpf(list(box))})
    assert tuple(map(float, ends)) == (low, high)


@pytest.mark.parametrize(
    ("text", "box"),
    [
        ("tan(x)", (1, 2)),
        ("tan(x)", (-2, -1)),
        ("tan(x)", (0, "inf")),
        ("tan(x)", ("-inf", 0)),
        ("log(x)", (0, 1)),
        ("log(x)", (-1, 1)),
        ("asin(x)", (-1.001, 0.5)),
        ("asin(x)", (-0.5, 1.001)),
        ("acos(x)", (-2, 2)),
        ("1/x", (-1, 1)),
        ("1/x", (0, 1)),
        ("x**(-3)", (-1, 0)),
        ("sqrt(x)", (-1e-9, 1)),
        ("x**(1/3)", (-1, 1)),
        ("x**(1/3)", (0, 1)),
    ],
)
def test_no_enclosure_where_a_function_has_no_value(text, box):
    with pytest.raises((ValueError, ArithmeticError)):
        interval(text, *box)
    ends = interval_ends(parse("", text, ["x"]).expr, {X: iv.mpf(list(box))})
    assert ends == (-math.inf, math.inf)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("pi - x", mp.mpf("3.14159265358979323846264338327950288") - 2),
        ("exp(1)*x", 2 * mp.mpf("2.71828182845904523536028747135266250")),
        ("x**3.5", mp.sqrt(128)),
        ("x**(-1.5)", mp.mpf(2) ** -1.5),
        ("x**(1/3)", mp.mpf("1.25992104989487316476721060727822835")),
        ("x**pi", mp.mpf("8.82497782707628762385642960420800158")),
        ("max(x, 1, 3) + 10*min(x, 5, 1)", mp.mpf(13)),
        ("sign(-x)*abs(-x)", mp.mpf(-2)),
        ("x - 2*x - 3", mp.mpf(-5)),
    ],
)
def test_a_ball_holds_the_value_to_many_digits(text, value):
    with ball_precision():
        ball = enclosing_ball(parse("", text, ["x"]).expr, {X: flint.arb(2)})
        assert abs(float(ball - flint.arb(str(value)))) < 1e-13
        assert float(ball.rad()) < 1e-300


@pytest.mark.parametrize(
    ("middle", "radius", "exponent", "low", "high"),
    [
        (0, 2, 2, 0, 4),
        (0, 2, 3, -8, 8),
        (1, 2, 2, 0, 9),
        (1, 2, 3, -27, 27),
        (-1, 2, 4, 0, 81),
        (3, 1, 2, 4, 16),
        (-3, 1, 3, -64, -8),
        (2, 1, -1, 1 / 3, 1),
    ],
)
def test_a_power_of_a_ball_that_may_hold_zero(middle, radius, exponent, low, high):
    """Of an even one nothing is below zero; where zero is not inside, more may be enclosed."""
    with ball_precision():
        inside = flint.arb(middle, radius)
        found = enclosing_ball(symbol("x1") ** exponent, {symbol("x1"): inside})
        least, most = float(found.lower()), float(found.upper())
    assert least <= low + 1e-12 and most >= high - 1e-12
    if inside.contains(0):
        assert (least, most) == pytest.approx((low, high), abs=1e-6)


def test_no_ball_without_a_finite_value():
    for text in ("1/(x - 2)", "log(x - 3)", "sqrt(1 - x)"):
        with ball_precision(), pytest.raises(ValueError, match="no finite value"):
            enclosing_ball(parse("", text, ["x"]).expr, {X: flint.arb(2)})
    with pytest.raises(ValueError, match="no rule"):
        enclosing_ball(symbol("y"), {X: flint.arb(2)})


# majorants


@pytest.mark.parametrize(
    ("majorant", "root"),
    [
        ((0, 0, 9), (0, 3)),
        ((4,), (2, 0)),
        ((4, 0, 9), (2, 3)),
        ((4, 20), (2, 5)),  # sqrt(4 + 20 s) <= 2 + 5 s
        ((4, 8, 9), (2, 3)),  # the larger of 8/4 and 3
        ((4, 20, 9), (2, 5)),
        ((0, 1), None),
        ((0, 1, 1), None),
        ((1, 0, 0, 1), None),
        ((1, 1, 1, 1), None),
    ],
)
def test_the_root_of_a_majorant(majorant, root):
    found = _root_of(tuple(map(Fraction, majorant)))
    if root is None:
        assert found is None
        return
    assert tuple(map(float, found)) == pytest.approx(root, abs=1e-25)
    for s in (Fraction(0), Fraction(1, 10), Fraction(3), Fraction(1000)):
        inside = sum((c * s**i for i, c in enumerate(majorant)), Fraction(0))
        assert (found[0] + found[1] * s) ** 2 >= inside


def test_the_root_of_an_irrational_majorant_is_rounded_up():
    offset, slope = _root_of((Fraction(2), Fraction(3), Fraction(1)))
    assert 0 < offset**2 - 2 < Fraction(1, 2**90)
    assert 0 < slope - Fraction(3) / (2 * offset) < Fraction(1, 2**90)
    tiny = Fraction(1, 2**300)
    assert _root_of((tiny, Fraction(1), Fraction(0))) is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("log(1 + x1**2)", (0, 0.81)),
        ("log(3 + x1**2)", (math.log(3), 0.81 / math.sqrt(3))),
        ("log(2 + abs(x1))", (math.log(2), 0.5)),
        ("atan(4*x1**2)", (0, 1.62)),
        ("tanh(4*x1**2)", (0, 2)),
        ("3*x1 - 4*x2 + 2", (2, 5)),
        ("3*abs(x1) + 4*x2", (0, 5)),
        ("sqrt(4 + x1**2) - 2", (0, 1)),
        ("sqrt(4 + x1**2)", (2, 1)),
        ("max(x1, 3*x2, 2)", (2, 3)),
        ("x1*sin(t) + x2*cos(t)", (0, 2)),
        ("x1**2/sqrt(1 + x1**2)", None),
        ("sin(x1)*7", (0, 7)),
        ("1/sqrt(x1**2 + 1/4)", None),
        ("(x1**2 + 1/4)**(-3/2)", None),
        ("3*sin(t) + 4*cos(t)", (5,)),
    ],
)
def test_the_majorant_of_a_formula(text, expected):
    states = (symbol("x1"), symbol("x2"))
    found = majorants(parse("", text, ["t", "x1", "x2"]).expr, states)
    if expected is not None:
        floats = [tuple(map(float, m)) for m in found]
        assert any(
            m == pytest.approx(expected, abs=1e-12) for m in floats if len(m) == len(expected)
        )
    formula = sympy.lambdify((symbol("t"), *states), parse("", text, ["t", "x1", "x2"]).expr)
    draw = np.random.default_rng(0)
    for _ in range(200):
        t, *x = draw.uniform(0, 9), *(draw.normal(size=2) * 10 ** draw.uniform(-2, 2))
        norm = math.hypot(*x)
        for m in found:
            limit = sum(float(c) * norm**i for i, c in enumerate(m))
            assert abs(formula(t, *x)) <= limit * (1 + 1e-12) + 1e-12


def test_sums_and_products_of_majorants():
    a, b = (Fraction(2), Fraction(3)), (Fraction(5), Fraction(0), Fraction(7))
    assert _plus(a, b) == _plus(b, a) == (7, 3, 7)
    assert _times(a, b) == _times(b, a) == (10, 15, 14, 21)
    assert root_above(Fraction(9, 16)) == Fraction(3, 4) and root_above(Fraction(0)) == 0
    for square in (Fraction(2), Fraction(9, 2), Fraction(1, 3)):
        assert 0 < root_above(square) ** 2 - square < Fraction(1, 2**90)


def test_what_a_majorant_must_keep_to_cover():
    """strength (b + a s) <= beta + gamma s, and nothing of a higher degree."""
    one, two = Fraction(1), Fraction(2)
    low = (one, two)
    assert covers([low], two, one) and covers([(two,), low], two, one)
    assert not covers([low], Fraction(199, 100), one) and not covers([low], two, Fraction(99, 100))
    assert covers([low], 2 * two, 2 * one, two) and not covers([low], two, 2 * one, two)
    assert not covers([low], 2 * two, one, two) and not covers([], two, one)
    assert not covers([(one, two, Fraction(1, 10**9))], two, one)
    assert covers([(one, two, Fraction(0))], two, one) and covers([(one,)], Fraction(0), one)


def test_majorants_that_another_one_beats_are_left_out():
    one, two, three = Fraction(1), Fraction(2), Fraction(3)
    assert _below((one, two), (one, two)) and _below((one,), (one, two))
    assert not _below((one, two), (one,)) and not _below((one, two), (two, one))
    assert _below((one, two), (two, two)) and not _below((two, two), (one, two))
    low, steep = (one, three), (two, one)
    assert _best([(two, three), low, steep, (one, three, one)]) == [steep, low]
    assert _best([(one, Fraction(0), Fraction(0)), (two,)]) == [(one,)]
    many = [(Fraction(i), Fraction(99 - i)) for i in range(2 * MAX_KEPT)]
    assert len(_best(many)) == MAX_KEPT


# terms of the truth and what would cover them


def term(text, **changed):
    """3 w_1, for which 1/2 (||S x||/10 + 1/5) is allowed."""
    numbers = {"strength": 3, "tau": "1/2", "gamma": "1/10", "beta": "1/5"} | changed
    formula = parse("", text, ["t", "x1", "x2"]).expr
    exact = {name: Fraction(numbers.pop(name)) for name in ("strength", "tau", "gamma", "beta")}
    states = (symbol("x1"), symbol("x2"))
    return UncertainTerm(0, formula, states, **exact, **numbers)


def fractions(*numbers):
    return tuple(map(Fraction, numbers))


def growing(text):
    """A bound of the sizes and the norm."""
    return parse("", text, ["x1", "x2", "norm"])


def test_only_what_is_zero_needs_no_bound():
    """Of strength 3: 3 |w| <= 1/2 (||x||/10 + 1/5) holds for w = 0, and for no other constant."""
    nothing = {"gamma": 0, "beta": 0}
    assert term("0").zero and term("0", **nothing).proven
    for text in ("1", "-1", "x1"):
        assert not term(text).zero and not term(text).proven
        assert not term(text, weights=fractions(1, 1)).proven_within(fractions(1, 1))
        assert term(text, strength=0).zero and term(text, strength=0, **nothing).proven
    assert term("-1", beta="6").proven and not term("-1", beta="5.99").proven


AT = Points(np.array([0.0, 2.0]), np.array([[3.0, -1.0], [4.0, 2.0]]))


@pytest.mark.parametrize(
    ("changed", "limits", "words"),
    [
        ({}, (0.35, (math.sqrt(5) / 10 + 0.2) / 2), "0.05 ||x|| + 0.1"),
        (
            {"weights": fractions(2, 1)},
            ((math.hypot(6, 4) / 10 + 0.2) / 2, (math.hypot(2, 2) / 10 + 0.2) / 2),
            "0.05 ||S x|| + 0.1",
        ),
        (
            {"weights": fractions(1, 1)},
            (0.35, (math.sqrt(5) / 10 + 0.2) / 2),
            "0.05 ||x|| + 0.1",
        ),
        (
            {"single": fractions("1/3", 0)},
            (0.35 + 0.5, (math.sqrt(5) / 10 + 0.2 + 1 / 3) / 2),
            "0.05 ||x|| + tau Delta |x| + 0.1",
        ),
        (
            {"single": (Fraction(0), Fraction(0))},
            (0.35, (math.sqrt(5) / 10 + 0.2) / 2),
            "0.05 ||x|| + 0.1",
        ),
        (
            {"growing": parse("", "x1**2 + norm", ["x1", "x2", "norm"])},
            (7, (1 + math.sqrt(5)) / 2),
            "0.5 (x1**2 + norm)",
        ),
        (
            {"growing": parse("", "x1**2 + x2", ["x1", "x2", "norm"]), "tau": 1},
            (13, 3),
            "x1**2 + x2",
        ),
    ],
)
def test_what_a_design_allows_for_a_term(changed, limits, words):
    one = term("x1", **changed)
    assert one.limit(AT) == pytest.approx(limits)
    assert one.size(AT) == pytest.approx([9, 3])
    assert one.excess(AT) == pytest.approx([9, 3] - np.array(limits) * (1 + 1e-9), abs=1e-14)
    assert one.allowance == words


def test_a_bound_that_is_a_formula_covers_its_term_or_does_not():
    points = random_points(2, 20.0, 0)
    square, line = growing("x1**2 + 1/5"), growing("x1")
    for text, bound, expected in (
        ("x1**2/6", square, (0.0, 0.0, True)),
        ("x1**2/5.9", square, (None, None, False)),
        ("sin(x1)/6", line, (0.0, 0.0, False)),  # true, and no majorant knows it
    ):
        found = smallest_cover(term(text, growing=bound, weights=fractions(1, 1)), points)
        assert (found.gamma, found.beta, found.proven) == expected and found.both is None


def test_a_point_that_breaks_a_bound_is_moved_to_where_it_breaks_it_most():
    """3 exp(-(x1 - 1)^2 - x2^2) against 1e-4: nearly at the top, a little towards the origin."""
    hill = term("exp(-(x1 - 1)**2 - x2**2)", gamma=0, beta="1e-4", tau=1)
    start = Points(np.array([3.0]), np.array([[1.6], [0.5]]))
    found = hill._polished(start)

    def gain(x1, x2):
        return 3 * np.exp(-((x1 - 1) ** 2) - x2**2) / (1 + np.hypot(x1, x2))

    grid = gain(*np.meshgrid(np.linspace(0, 2, 401), np.linspace(-1, 1, 401))).max()
    assert gain(*found.x[:, 0]) >= 0.999 * grid and found.t[0] >= 0


def test_terms_that_nothing_covers():
    points = random_points(2, 20.0, 0)
    assert smallest_cover(term("x1", tau=0), points).gamma is None
    assert smallest_cover(term("log(x1)"), points).beta is None
    nothing = smallest_cover(term("x1", strength=0), points)
    assert (nothing.gamma, nothing.beta, nothing.proven) == (0.0, 0.0, True)


@dataclass(frozen=True)
class Needs:
    """A term that is covered from some gamma + beta on."""

    least: float
    gamma: Fraction = Fraction(0)
    beta: Fraction = Fraction(0)
    tau: Fraction = Fraction(1)
    proven: bool = False

    def exceeded(self, points):
        return None if float(self.gamma + self.beta) >= self.least else points


@pytest.mark.parametrize(
    ("value", "least", "expected"),
    [
        (0.311, 0.1, "0.32"),
        (0.32, 0.1, "0.32"),
        (0.311, 0.321, "0.33"),
        (0.311, 0.345, "0.35"),
        (0.311, 0.36, "0.36"),
        (0.311, 0.37, None),
        (math.inf, 0.1, None),
    ],
)
def test_a_cover_is_rounded_up_and_raised_a_little(value, least, expected):
    right = None if expected is None else Fraction(expected)
    search = _Suprema(Needs(least), AT)
    assert search.smallest(value, None, Fraction(0)) == right
    assert search.smallest(value, Fraction(0), None) == right


def test_a_supremum_is_looked_for_between_the_samples_and_not_far_from_them():
    line = Points(np.zeros(2), np.array([[1.0, 2.0], [0.0, 0.0]]))
    search = _Suprema(Needs(1.0), line)

    def hill(points):
        """1 near x = (1.3, 0), and much more where nothing is looked at."""
        value = np.exp(-((points.x[0] - 1.3) ** 2) - points.x[1] ** 2)
        return np.where((points.norm > 20.0) | (points.norm < 1e-6), 100.0, value)

    assert search._supremum(hill) == pytest.approx(1.0, abs=1e-6)
    beyond = Points(line.t, 30 * line.x)
    assert search._supremum(hill, line) == pytest.approx(1.0, abs=1e-6)
    assert math.isinf(search._supremum(hill, beyond))
    assert math.isinf(search._supremum(lambda points: points.x[0] * math.inf))


@dataclass(frozen=True)
class Sized(Needs):
    """A term of this size."""

    tau: Fraction = Fraction(2)
    form: object = None

    def size(self, points):
        return self.form(points.norm)


def test_what_is_needed_beside_the_gamma_or_beta_of_a_file():
    points = random_points(2, 20.0, 0)

    def search(form):
        return _Suprema(Sized(1.0, form=form), points)

    affine = search(lambda r: 6 * r + 2)  # tau is 2: 3 ||x|| + 1
    assert affine.gamma_needed(1.0) == pytest.approx(3.0, rel=1e-6)
    assert affine.beta_needed(3.0) == pytest.approx(1.0, rel=1e-3)
    assert affine.far_growth() == pytest.approx(3.0, rel=1e-3)
    assert math.isinf(affine.gamma_needed(0.5)) and math.isinf(affine.beta_needed(2.9))
    assert affine.gamma_needed(0.0) == math.inf
    square = search(lambda r: r**2)
    assert math.isinf(square.far_growth()) and math.isinf(square.gamma_needed(1.0))
    assert search(lambda r: 4 * np.minimum(r, 1.0)).gamma_needed(0.0) == pytest.approx(2.0)
    assert search(lambda r: r * math.nan).beta_needed(1.0) == 0


@dataclass(frozen=True)
class Judged(Sized):
    """A term of which pairs are proven or not, and none is broken by samples."""

    proven_pairs: object = None
    name: str = "w_1"
    zero: bool = False
    growing: object = None

    def violation_of_domain(self, points):
        return None

    def exceeded(self, points):
        return None

    def proven_with(self, gamma, beta):
        return self.proven_pairs(gamma, beta)


def test_a_cover_is_proven_if_all_that_is_stated_is():
    points = random_points(2, 20.0, 0)

    def cover(form, pairs, **numbers):
        return smallest_cover(Judged(1.0, form=form, proven_pairs=pairs, **numbers), points)

    def bent(r):
        return 4 * np.minimum(r, 1.0)  # tau is 2: gamma = 2, or beta = 2

    found = cover(bent, lambda gamma, beta: True)
    assert (found.gamma, found.beta, found.both, found.proven) == (2.0, 2.0, None, True)
    assert not cover(bent, lambda gamma, beta: beta > 0).proven
    assert not cover(bent, lambda gamma, beta: gamma > 0).proven
    affine = cover(lambda r: 6 * r + 2, lambda gamma, beta: gamma > 3)
    assert affine.gamma is affine.beta is None and affine.proven
    assert affine.both == (3.1, 1.0)
    square = cover(lambda r: r**2, lambda gamma, beta: True)
    assert square.gamma is square.beta is square.both is None and not square.proven


# premises


def test_whether_two_formulas_are_the_same():
    states = (symbol("x1"), symbol("x2"))

    def same(a, b):
        return _same(parse("", a, ["x1", "x2"]).expr, parse("", b, ["x1", "x2"]).expr, states)

    assert same("x1*(x1 - x2)", "x1**2 - x1*x2") is True
    assert same("sin(x1)**2 + cos(x1)**2", "1") is None  # at random states, which is no proof
    assert same("sin(x1)**2 + cos(x1)**2", "1 + 1e-12*x2") is False
    assert same("sqrt(x1**2)", "x1") is False
    assert same("x1", "x2") is False
    assert _same(sympy.zoo, sympy.oo, ()) is None  # of no value there is nothing to compare


@pytest.mark.parametrize(
    ("must_be", "start"),
    [
        ("not negative", "write max(x1, 0) there if the plant keeps away from negative ones"),
        ("not zero", "write sqrt((x1)**2 + 0.001**2) there"),
        ("positive", "write max(x1, 0.001) there if the plant keeps above it"),
    ],
)
def test_what_to_write_for_a_formula_that_may_have_no_value(must_be, start):
    condition = Condition(symbol("x1"), symbol("x1"), must_be)
    assert _rewriting(condition).startswith(start)


@pytest.mark.parametrize(
    ("drift", "regressor", "status"),
    [
        ("x3**2", "sin(x1)", "proven"),
        ("sqrt(x1**2 - 2*x1*x2 + x2**2)", "sin(x1)", "checked"),
        ("x3", "sqrt(x1**2 - 2*x1*x2 + x2**2)", "checked"),
        ("sqrt(x1)", "1", "contradicted"),
        ("x3", "1/x2", "contradicted"),
    ],
)
def test_whether_drift_and_regressor_are_defined(drift, regressor, status):
    plant = replace(CHAIN, drift=drift, regressor=[regressor], theta=[2])
    law = certrack.Robust(c=(4, 5, 6))
    start = certrack.Settings([0, 0, 0], 40, tail=1)
    reference, truth = certrack.SymbolicReference("0.2*cos(t)"), certrack.Truth(2, (2,))
    system = certrack.System(plant, law, reference, truth, start)
    (found,) = [p for p in premises(system) if p.name == DOMAIN]
    assert found.status == status
    (theta,) = [p for p in premises(system) if p.name == THETA]
    assert (theta.status, theta.detail) == ("proven", "theta exactly as the law uses it")


RANGED = """
[plant]
states = ["x1"]
regressor = ["sin(x1)"]
gain_sign = 1
input_gain = {gain}
theta = [{theta}]
[plant.constants]
a = 2
[plant.ranges]
{ranges}
[plant.uncertainty]
tau = [0]
gamma = [0]
beta = [0]
[truth]
input_gain = {true_gain}
theta = [{true_theta}]
[reference]
signal = "sin(t)"
[law]
kind = "robust"
c = [7]
[simulation]
x0 = [0]
duration = 1
"""

#: What is stated, and status, detail, witness and remedy of the premises on g_n and theta.
KNOWN = [
    ({}, "proven", "proven", "theta exactly as the law uses it", None, ""),
    (
        {"true_gain": "5.5", "true_theta": "3.5"},
        "contradicted",
        "contradicted",
        "the law uses theta = [3], the true one is [3.5]",
        {"true": [3.5], "assumed": [3.0]},
        "set plant.theta to [3.5]",
    ),
    (
        {"gain": '"2*a"', "theta": '"a/2"', "true_gain": '"2*a"', "true_theta": '"a/2"'}
        | {"ranges": "a = [1, 3]"},
        "proven",
        "proven",
        "theta exactly of the constants in their ranges",
        None,
        "",
    ),
    (
        {"gain": '"2*a"', "theta": '"a/2"', "true_gain": "4.5", "true_theta": "1.5"}
        | {"ranges": "a = [1, 3]"},
        "contradicted",
        "contradicted",
        "with the true constants theta is [1], the true one is [1.5]",
        {"true": [1.5], "assumed": [1.0]},
        'write truth.theta = ["a/2"]',
    ),
    (
        {
            "ranges": "input_gain = [4, 6]\ntheta = [[2, 4]]",
            "true_gain": "5.5",
            "true_theta": "3.5",
        },
        "proven",
        "proven",
        "every theta in its range, the true one among them",
        None,
        "",
    ),
]


@pytest.mark.parametrize(("stated", "of_gain", "of_theta", "detail", "witness", "remedy"), KNOWN)
def test_what_a_law_knows_of_the_truth(stated, of_gain, of_theta, detail, witness, remedy):
    base = {"gain": "5", "theta": "3", "true_gain": "5", "true_theta": "3", "ranges": ""}
    system = certrack.loads(RANGED.format(**(base | stated)))
    found = {p.name: p for p in premises(system)}
    assert (found[GAIN].status, found[THETA].status) == (of_gain, of_theta)
    assert found[THETA].detail == detail and found[THETA].witness == witness
    assert found[THETA].remedy.startswith(remedy) and bool(found[THETA].remedy) == bool(remedy)
    if of_gain == "contradicted":
        true, assumed = found[GAIN].witness["true"], found[GAIN].witness["assumed"]
        assert (true, assumed) in ((5.5, 5.0), (4.5, 4.0))
        wanted = "write truth.input_gain = " if "ranges" in stated else "set plant.input_gain to"
        assert found[GAIN].remedy.startswith(wanted)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("log(x1 + 1)", [("x1 + 1", "positive")]),
        (
            "asin(x1)*acos(2*x2)",
            [("1 - abs(x1)", "not negative"), ("1 - 2*abs(x2)", "not negative")],
        ),
        ("tan(x1)", [("cos(x1)", "not zero")]),
        ("x1**(-2) + x2**3", [("x1", "not zero")]),
        ("sqrt(x1)", [("x1", "not negative")]),
        ("x1**(-0.5)", [("x1", "positive")]),
        ("x1**1.5", [("x1", "not negative")]),
        ("log(sqrt(x1))", [("x1", "not negative"), ("sqrt(x1)", "positive")]),
        ("log(2)*sqrt(3)/7 + sin(x1) + atan(x2)", []),
        ("log(x1) + 2*log(x1)", [("x1", "positive")]),
    ],
)
def test_what_must_hold_for_a_formula_to_have_a_value(text, expected):
    found = conditions(parse("", text, ["x1", "x2"]).expr)
    known = [(parse("", inside, ["x1", "x2"]).expr, must_be) for inside, must_be in expected]
    assert sorted((str(c.inside), c.must_be) for c in found) == sorted(
        (str(inside), must_be) for inside, must_be in known
    )
    if len(found) == 2 and "log(sqrt" in text:
        assert [c.must_be for c in found] == ["not negative", "positive"]  # the innermost first


def test_a_condition_fails_where_its_part_is_beyond_its_limit():
    points = Points(np.zeros(3), np.array([[-2.0, 0.0, 3.0]]))
    x = [symbol("x1")]
    for must_be, at_zero, below in (
        ("positive", True, True),
        ("not negative", False, True),
        ("not zero", True, False),
    ):
        only_zero = Points(np.zeros(1), np.zeros((1, 1)))
        condition = Condition(x[0], x[0], must_be)
        assert (condition.failure(x, only_zero) is not None) == at_zero
        negative = Points(np.zeros(1), np.array([[-2.0]]))
        assert (condition.failure(x, negative) is not None) == below
        assert condition.failure(x, Points(np.zeros(1), np.array([[3.0]]))) is None
        assert condition.failure(x, points) is not None


def test_uncertain_terms_are_split_into_their_inputs():
    """Columns tau_k A_k times gamma_k, each Delta_kj, beta_k; zeros are left out."""
    u = certrack.Uncertainty(
        tau=["2", "0", "3"],
        gamma=["1/2", "1", "0"],
        beta=["0", "1", "1/5"],
        Delta=[["0", "1/3", "0"], ["1", "1", "1"], ["1/7", "0", "0"]],
        S=[[1, 2, 3], [1, 1, 1], [1, 1, 1]],
    )
    A = q(["1", "0", "0"], ["4", "5", "0"], ["6", "7", "8"])
    found = uncertain_inputs(u, A, rational)
    assert found.states == ((0, 0, 2), (2,))
    assert [list(column) for column in found.a] == [
        [rational(v) for v in column]
        for column in (("1", "4", "6"), ("2/3", "8/3", "4"), ("0", "0", "24/7"))
    ]
    assert [list(column) for column in found.b] == [[0, 0, rational("24/5")]]
    (weights, none), (first, _), (second, _) = found.selections
    assert (weights == np.diag([1, 2, 3])).all() and none is None
    assert first.tolist() == [[0, 1, 0]] and second.tolist() == [[1, 0, 0]]
    plain = certrack.Uncertainty(tau=[1, 1, 1], gamma=[1, 0, 2], beta=[0, 0, 0])
    found = uncertain_inputs(plain, A.astype(float), decimal)
    assert found.selections == () and found.states == ((0, 2), ()) and found.b == ()
    weighted = certrack.Uncertainty(tau=[1, 1, 1], gamma=[1, 0, 2], beta=[0, 0, 0], S=[2, 1, 1])
    found = uncertain_inputs(weighted, A.astype(float), decimal)
    assert [np.diag(S).tolist() for S, _ in found.selections] == [[2, 1, 1]] * 2
    with pytest.raises(NoCertificate, match="plant.uncertainty.bound"):
        uncertain_inputs(SimpleNamespace(bound=("x1**2", None, None)), A, rational)


# files of proofs by cells


@pytest.fixture(scope="module")
def halves():
    """A system with one range, and a file of proofs of both halves of it."""
    system = certrack.loads(VARIANTS["small"])
    prover = RangeProver(system)
    cells = halved(prover.box, [1] * len(prover.box), prover.loop.moving)
    return system, to_document(system, *(prover.vertices(cell) for cell in cells))


def test_a_proof_by_cells_is_what_it_claims(halves):
    _, document = halves
    verdict = verify(document)
    bounds = [cell["bound"] for cell in document["proof"]]
    assert verdict.verified and len(bounds) == 2
    assert verdict.bound == max(bounds, key=float) != min(bounds, key=float)
    assert document["claim"] == f"limsup |e_1(t)| <= {verdict.bound}"
    assert len(verdict.premises) == len(document["premises"]) > 2


def test_a_changed_proof_by_cells_is_refused(halves):
    _, document = halves
    unsigned = document | {"made_by": "certrack 99"}
    assert "changed after it was made" in verify(unsigned).reason
    assert "claim" in verify(signed(document | {"claim": "limsup |e_1(t)| <= 0.1"})).reason
    shifted = copy.deepcopy(document)
    shifted["proof"][1]["points"][0]["shift"] = "0.1"
    assert "shift" in verify(signed(shifted)).reason
    for k in (0, 1):  # half of the range is left out
        half = document | {"proof": document["proof"][k : k + 1]}
        bound = half["proof"][0]["bound"]
        assert not verify(signed(half | {"claim": f"limsup |e_1(t)| <= {bound}"})).verified
    other = document | {"premises": document["premises"][1:]}
    assert "premises" in verify(signed(other)).reason
    old = {key: value for key, value in document.items() if key != "premises"}
    with pytest.raises(InputError, match="certificate/2 for a proof by cells"):
        verify(signed(old | {"format": FORMAT_1, "assumptions": []}))
    many = document["proof"] * (MAX_PROOF_CELLS // 2)
    with pytest.raises(InputError, match="at most"):
        verify(signed(document | {"proof": [*many, document["proof"][0]]}))


def test_a_changed_claim_of_an_implemented_loop_is_refused():
    system = certrack.loads(DRIVEN_APART.format(drift=0))
    proof = ImplementedProof("0", (1, 1), 11, ("1", "1"), "1", "0.000001", "0.000001")
    document = to_document(system, proof)
    claim = {"claim": document["claim"].replace("0.000001", "0.0000001")}
    assert document["claim"] != claim["claim"]
    assert "claim" in verify(signed(document | claim)).reason
    assert "claim" not in verify(document).reason
    old = {key: value for key, value in document.items() if key != "premises"}
    with pytest.raises(InputError, match="certificate/2 for an implemented loop"):
        verify(signed(old | {"format": FORMAT_1, "assumptions": []}))


@pytest.mark.parametrize("body", [[], 3, None, [{"cell": []}]])
def test_what_is_no_table_is_no_certificate(body, tmp_path):
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(body))
    with pytest.raises(InputError, match="not a certificate"):
        verify(path)


def test_texts_of_numbers_have_a_sane_length():
    assert from_text("1" + "0" * 59) == 10**59 and from_text("-2.50e-3") * 400 == -1
    assert from_text("1e400") > 10**399 and from_text("1e-400") * 10**400 == 1
    for text in ("1" + "0" * 60, "1e401", "1E-401", "1/3", "inf", "0x1", "", "1_0", " 1", 3):
        with pytest.raises(ValueError, match="not a decimal number|Invalid literal"):
            from_text(text)


@pytest.mark.parametrize(
    ("coupling", "expected"),
    [(20 * COUPLING, [30, 30]), (0.2 * COUPLING, [3, 30]), (0, [1, 30])],
)
def test_a_coordinate_that_follows_another_has_a_size_of_its_own(coupling, expected):
    """Of the rates 1 and 4: the geometric mean 2 counts."""
    M = np.array([[-1.0, coupling], [0.0, -4.0]])
    for unit in (1e-4, 1.0, 1e4):  # of the rates
        assert _not_slaved(unit * M, np.array([1.0, 30.0])) == pytest.approx(expected)
    assert _not_slaved(M.T[::-1, ::-1].T, np.array([30.0, 1.0])) == pytest.approx(expected[::-1])


@pytest.mark.parametrize(
    ("rates", "inputs"), [((1, 4), (1, 1e6)), ((2, 2), (3, 3)), ((0.1, 10), (1, 7))]
)
def test_coordinates_that_are_apart_have_the_size_that_noise_gives_them(rates, inputs):
    """X = b^2/(2 r) solves -2 r X + b^2 = 0."""
    problem = SimpleNamespace(n=2, M=-np.diag(np.array(rates, dtype=float)))
    expected = np.array(inputs) / np.sqrt(2 * np.array(rates))
    found = _size_under(problem, np.diag(np.array(inputs, dtype=float)))
    assert found == pytest.approx(expected, rel=1e-4)
    both = _size_under(problem, np.array([inputs], dtype=float).T)
    assert both == pytest.approx(expected, rel=1e-4)


def test_a_loop_that_is_not_stable_has_no_sizes():
    for M in (np.diag([0.0, -1.0]), np.diag([1e-9, -1.0])):
        assert (_size_under(SimpleNamespace(n=2, M=M), np.array([[1.0], [5.0]])) == 1).all()
    with np.errstate(all="ignore"), pytest.raises(OverflowError):
        _size_under(SimpleNamespace(n=1, M=-np.eye(1)), np.array([[1e200]]))


def test_the_solution_of_a_lyapunov_equation_of_two_states():
    found = _gramian_diagonal(np.array([[-1.0, 2.0], [0.0, -3.0]]), np.eye(2))
    assert found == pytest.approx([2 / 3, 1 / 6])


# what is told of the progress


def test_every_method_is_announced_before_it_begins():
    told = []
    found = every_certificate(certrack.load("dual-motor-lean"), "fast", lambda *a: told.append(a))
    assert told == [(step, METHOD_STEPS, None) for step in range(METHOD_STEPS)]
    assert smallest(found.certificates.values()).bound == min(
        entry.bound for entry in found.certificates.values() if entry.verified
    )
    told.clear()
    certrack.certify(
        certrack.load("dual-motor-lean"), effort="fast", progress=lambda *a: told.append(a)
    )
    assert told == [(step, METHOD_STEPS + 1, None) for step in range(METHOD_STEPS + 2)]


def test_what_is_no_system_is_refused():
    for ask in (certrack.certify, lambda none: certrack.certificates.tube(none, ())):
        with pytest.raises(InputError, match="system"):
            ask("example1")


@pytest.mark.parametrize("name", ["example1", "dual-motor"])
def test_the_designs_own_multipliers(name):
    """k_i = (1 + 1/eps) G a_i sum a, and what damps the last derivative besides."""
    system = certrack.load(name)
    exact = error_problem(system, rational)
    found, terms = own_solution(system, exact), collect(system)
    eps = best_eps(terms)
    a = np.linalg.norm(exact.in_floats().Xy, axis=0)
    k = (1 + 1 / eps) * terms.G * a * a.sum()
    last = system.reference.bounds(exact.derivatives[-1]).values[-1]
    k[-1] += residual_damping(system) * last**2
    assert found.k == pytest.approx(k, rel=1e-12)
    gamma, beta = (own_multipliers(system, exact, part) for part in ("gamma", "beta"))
    assert found.lam == pytest.approx([float(v) for v in gamma])
    assert found.nu == pytest.approx([float(v) for v in beta])
    assert found.alpha == terms.alpha(eps) and (np.eye(exact.n) == found.P).all()
    leak = exact.in_floats().leakage(found.alpha)
    assert found.delta == pytest.approx(found.k.sum() + found.nu.sum() + leak)
    assert 2 * found.delta / found.alpha <= (1 + 1e-9) * 2 * terms.dbar(eps) / found.alpha

"""Every step that rounds a bound outward, and what would be claimed without it."""

import math
import re
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from functools import partial
from itertools import product

import flint
import numpy as np
import pytest
import sympy
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from mpmath import iv, mp

import certrack
from certrack.certificates import certify_semidefinite
from certrack.certificates.arithmetic import rational
from certrack.certificates.balls import ball_precision
from certrack.certificates.cascade import _prove_stage, certify_cascade
from certrack.certificates.centred import _enclose, centred_problem
from certrack.certificates.exact import float_up, from_text, root_up, squared_bound
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.intervals import enclosure
from certrack.certificates.published import certify_published
from certrack.certificates.start import reference_at_start, starting_energy, states_at_start
from certrack.cli import cli
from certrack.core.rounding import rounded_up
from certrack.laws import Robust
from certrack.model.plant import Plant, Uncertainty
from certrack.model.truth import Truth
from certrack.references import SymbolicReference, triangle
from certrack.references.base import round_up, total_bound
from certrack.systems.system import Settings, System

DECIMALS = [f"{k / 997:.6f}" for k in range(1, 60)]


def exactly(value):
    """A float, a decimal text, a flint rational or an mpmath number as a Fraction."""
    if isinstance(value, flint.fmpq):
        return Fraction(int(value.p), int(value.q))
    if hasattr(value, "_mpf_"):
        sign, mantissa, exponent, _ = value._mpf_
        return (-1) ** sign * Fraction(int(mantissa)) * Fraction(2) ** int(exponent)
    return Fraction(value)


def ends(enclosure):
    return exactly(mp.mpf(enclosure.a)), exactly(mp.mpf(enclosure.b))


def test_float_up_is_the_smallest_float_that_is_not_below():
    for text in DECIMALS:
        exact = from_text(text)
        found = float_up(exact)
        assert exactly(found) >= exactly(exact)
        assert exactly(math.nextafter(found, -math.inf)) < exactly(exact)
    assert float_up(flint.fmpq(3, 4)) == 0.75
    barely = flint.fmpq(3, 4) + flint.fmpq(1, 10**40)  # the nearest float is below
    assert float_up(barely) == math.nextafter(0.75, 1)


def test_root_up_is_never_below_the_root():
    squares = [
        Fraction(text) * scale for text in DECIMALS for scale in (1, Fraction(1, 10**9), 10**12)
    ]
    for square in [*squares, Fraction(2), Fraction(4), Fraction(1, 3) ** 40]:
        root = Fraction(root_up(flint.fmpq(square.numerator, square.denominator)))
        assert square <= root**2 <= square * (1 + Fraction(1, 10**10))
    assert root_up(flint.fmpq(0)) == "0"


def test_root_up_has_twelve_digits_and_no_less():
    """It is at most a unit of the twelfth above the root, whatever the digits of its square."""
    squares = [Fraction(2**a, 2**b - 1) for a in range(1, 140, 3) for b in range(1, 70, 5)]
    squares += [Fraction(2**b + 1, 2**a) for a in range(1, 140, 9) for b in range(1, 70, 5)]
    squares += [Fraction(10) ** k + d for k in range(-12, 13) for d in (0, Fraction(1, 10**40))]
    for square in squares:
        text = root_up(flint.fmpq(square.numerator, square.denominator))
        digits, _, places = text.partition("e")
        unit = Fraction(10) ** int(places)
        root = Fraction(text)
        assert (root - unit) ** 2 <= square < root**2
        assert 10**12 < int(digits) <= 10**13


def test_round_up_makes_good_what_float_addition_loses():
    pairs = list(product(DECIMALS, DECIMALS[::7]))
    lost = [pair for pair in pairs if exactly(sum(map(float, pair))) < sum(map(Fraction, pair))]
    assert lost
    for pair in pairs:
        assert exactly(round_up(sum(map(float, pair)))) >= sum(map(Fraction, pair))
    assert round_up(0.0) == 0.0


def test_total_bound_is_not_below_the_sum_of_the_bounds():
    for text in DECIMALS:
        reference = SymbolicReference(f"{text}*sin(3*t)")
        exact = sum(map(exactly, reference.bounds(1).values))
        assert exactly(total_bound(reference)) >= exact


def test_bounds_of_a_triangle_are_not_below_its_decimals():
    for text in DECIMALS:
        height, slope = triangle(float(text), 4.0).bounds(1).values
        assert exactly(height) >= Fraction(text)
        assert exactly(slope) >= Fraction(text)  # 4 amplitude/period


@pytest.mark.parametrize("formula", ["tanh(1)", "tanh(-2)", "atan(1)", "atan(-3)", "pi", "E"])
def test_enclosures_hold_the_number_they_enclose(formula):
    expr = sympy.sympify(formula, evaluate=False)
    low, high = ends(enclosure(expr, {}))
    value = Fraction(str(sympy.N(expr, 60)))
    assert low < value < high


def test_enclosures_of_rationals_hold_them():
    for text in DECIMALS:
        exact = from_text(text)
        low, high = ends(_enclose(-exact, exact))
        assert low <= -Fraction(text)
        assert Fraction(text) <= high
        low, high = ends(enclosure(sympy.Rational(text), {}))
        assert low <= Fraction(text) <= high
    long = "123456789012345678901.5"  # more digits than a float has
    low, high = ends(enclosure(sympy.Float(long, 30), {}))
    assert low <= Fraction(long) <= high
    x = sympy.Symbol("x")
    low, high = ends(enclosure(sympy.exp(x) / 3, {x: iv.mpf([0, 1])}))
    assert low <= Fraction(1, 3)
    assert high >= Fraction(str(sympy.N(sympy.E / 3, 60)))


def first_order(c, beta):
    """x' = u + 0.1 w with |w| <= beta: the published bound is sqrt(k (0.1 beta)^2/c), k = 3."""
    plant = Plant(
        states=["x1"],
        input_gain=1,
        uncertainty=Uncertainty([0.1], [0], [float(beta)]),
    )
    law = Robust(c=[float(c)], k=[[math.inf, 3]])
    return System(plant, law, SymbolicReference("0"), Truth(1), Settings([0], 1))


def test_published_bounds_are_not_below_their_formula():
    for c, beta in product(DECIMALS[::9], DECIMALS[::5]):
        exact = 3 * (Fraction("0.1") * Fraction(beta)) ** 2 / Fraction(c)
        for certificate in certify_published(first_order(c, beta)).values():
            assert exactly(certificate.bound) ** 2 >= exact


@pytest.mark.parametrize("name", ["example1", "dual-motor", "dual-motor-strong", "dual-motor-lean"])
def test_bounds_are_not_below_what_is_proven(name):
    system = certrack.load(name)
    certificate, proof = certify_semidefinite(system)
    square = exactly(squared_bound(error_problem(system, rational), proof))
    assert Fraction(proof.bound) ** 2 >= square
    assert exactly(certificate.bound) >= Fraction(proof.bound)


def test_tube_contains_the_exact_values():
    system = certrack.load("dual-motor-lean")
    _, proof = certify_semidefinite(system)
    coordinates = system.controller.coordinates
    Y = system.reference.values(np.array([0.0]), coordinates.q)[:, 0]
    rng = np.random.default_rng(0)
    P = np.array([[from_text(v) for v in row] for row in proof.P], dtype=object)
    square = exactly(squared_bound(error_problem(system, rational), proof))
    for _ in range(20):
        x0 = [float(f"{v:.3f}") for v in rng.uniform(-1, 1, 4)]
        found = certrack.certificates.tube(system.with_settings(x0=x0), proof)
        e = coordinates.A @ np.array(x0) - coordinates.B @ Y
        e = np.array([rational(Fraction(v)) for v in e], dtype=object)
        assert exactly(found.start) >= exactly(e @ P @ e)
        assert exactly(found.floor) >= square


@pytest.mark.parametrize(("n", "k"), [(3, 0.5), (4, 0.1), (5, 0.5), (6, 0.5)])
def test_tube_of_a_damped_design_starts_above_the_exact_energy(n, k):
    """A has entries up to 1e41, and near the orbit A x - B Y nearly cancels."""
    plant = Plant(states=[f"x{i + 1}" for i in range(n)], chain=[1.1] * (n - 1), input_gain=1)
    damping = {"k": [[k] * (2 * m) for m in range(1, n + 1)], "p": [k] * (n - 1)}
    law = Robust(c=[1.3] * n, **damping)
    system = System(plant, law, SymbolicReference("0.3*cos(t)"), Truth(1), Settings([0] * n, 1))
    problem, exact = error_problem(system, rational), error_coordinates(system, rational)
    floats = system.controller.coordinates
    rng = np.random.default_rng(0)
    for decade in np.linspace(-12, 3, 20):
        apart = rng.normal(size=n) * 10**decade
        x = np.linalg.solve(floats.A, floats.B[:, 0] * 0.3 + apart)
        start = np.array([rational(Fraction(v)) for v in x], dtype=object)
        e = exact.A @ start - exact.B[:, 0] * rational(Fraction(0.3))
        at = system.with_settings(x0=x.tolist(), max_state=1e300)
        with ball_precision():
            balls = [(states_at_start(at)[0], reference_at_start(at, 0)[0])]
        identity = np.eye(n, dtype=object) + flint.fmpq(0)
        found = starting_energy(at, problem, identity, balls)
        assert exactly(found) >= exactly(e @ e) / 2


def test_rate_of_a_tube_is_not_above_the_proven_one():
    system = certrack.load("dual-motor-lean")
    _, proof = certify_semidefinite(system)
    above = [text for text in DECIMALS if exactly(float(text)) > Fraction(text)]
    assert above  # decimals whose nearest float is larger
    for alpha in above:
        found = certrack.certificates.tube(system, replace(proof, alpha=alpha))
        assert exactly(found.alpha) <= Fraction(alpha)


def planar(drift, regressor):
    """Example 1 with another drift and regressor."""
    base = certrack.load("example1")
    plant = replace(base.plant, drift=drift, regressor=tuple(regressor), theta=None)
    theta = (2.0,) * len(regressor)
    law = replace(base.law, theta0=(2.1,) * len(regressor), Gamma=(0.7,) * len(regressor))
    return base.replace(plant=plant, law=law, truth=replace(base.truth, theta=theta))


def remainder(system):
    """Proof of a bound on V, and what the centred stage then adds on the last row for kappa = 1."""
    problem = error_problem(system, rational)
    proof = _prove_stage(problem, problem.n - 1)
    zeta = centred_problem(system, problem, proof, flint.fmpq(1)).Ub[:, -1]
    return proof, float(zeta[-1])


def reached_states(system, proof, count=4001):
    """States at which e^T P e = bound^2 and |y_d| = Y_0, all around."""
    found = system.controller.coordinates
    P, bound = np.array(proof.P, dtype=float), float(proof.bound)
    angle = np.linspace(0, 2 * np.pi, count)
    e = bound * np.linalg.solve(np.linalg.cholesky(P).T, [np.cos(angle), np.sin(angle)])
    y = found.B * system.reference.bounds(0).values[0]
    return np.linalg.solve(found.A, np.hstack([e + y, e - y]))


@pytest.mark.parametrize(("state", "row"), [("x1", 0), ("x2", 1)])
def test_centred_stage_covers_every_state_that_is_reached(state, row):
    """With drift x_j alone, the remainder is the radius of the box in x_j: it must be exact."""
    system = planar(state, [])
    proof, radius = remainder(system)
    largest = np.abs(reached_states(system, proof)[row]).max()
    assert largest <= radius
    assert radius == pytest.approx(largest, rel=1e-5)


def test_centred_stage_covers_every_estimate_that_is_reached():
    """With regressor 1 alone, it is the largest |theta_tilde| with s theta_tilde^2/Gamma <= B^2."""
    system = planar("0", ["1"])
    proof, radius = remainder(system)
    s, bound = float(proof.P[-1][-1]), float(proof.bound)
    largest = bound * math.sqrt(0.7 / s)
    assert largest <= radius
    assert radius == pytest.approx(largest, rel=1e-9)


def test_centred_stage_of_example_1_covers_drift_and_regressor():
    system = certrack.load("example1")
    proof, limit = remainder(system)
    x1, x2 = reached_states(system, proof)
    error = float(proof.bound) / math.sqrt(float(proof.P[-1][-1]))
    size = np.abs(x1**2 * x2) + np.abs(1 + x1 * np.sin(x2)) * error
    assert size.max() <= limit


def test_cascade_of_example_1_is_not_below_what_its_stages_prove():
    certificate, stages = certify_cascade(certrack.load("example1"))
    assert exactly(certificate.bound) >= Fraction(stages[-1].bound)


def test_remainder_beyond_the_floats_is_no_bound():
    """exp(5000 x_2) is finite for mpmath, but no float bounds it."""
    system = planar("exp(5000*x2)", [])
    certificate, stages = certify_cascade(system)
    assert len(stages) == 2  # without the centred stage
    assert certificate.verified
    with pytest.raises(certrack.NoCertificate, match="unbounded on the set"):
        remainder(system)


def bounds_in(text):
    """The bounds of a table of certificates."""
    rows = re.findall(r"^│ (\w+) +│ ([\d.e-]+) ", text, re.M)
    return {kind: Decimal(bound) for kind, bound in rows if bound != "-"}


@pytest.mark.parametrize("name", ["example1", "dual-motor"])
def test_printed_bounds_are_not_below_those_computed(name, tmp_path):
    """To six digits, upwards: in the tables of certify and in what verify and falsify say."""
    system = certrack.load(name)
    results = certrack.certify(system)
    run = partial(CliRunner().invoke, cli, catch_exceptions=False)
    printed = bounds_in(run(["certify", name, "--out", str(tmp_path / "proof.json")]).output)
    assert printed.keys() >= {"published", "corrected", "rate", "semidefinite"}
    for kind, bound in printed.items():
        exact = Decimal(getattr(results, kind).bound)
        assert exact <= bound <= exact * Decimal("1.0001")
    said = run(["verify", str(tmp_path / "proof.json")]).output
    assert Decimal(re.search(r"<= ([\d.e-]+)", said)[1]) >= Decimal(results.best.bound)


@given(st.floats(1e-12, 1e12), st.integers(2, 8))
def test_rounded_up_is_the_next_short_number(value, digits):
    text = rounded_up(value, digits)
    assert Decimal(value) <= Decimal(text) <= Decimal(value) * (1 + Decimal(10) ** (1 - digits))
    assert len(Decimal(text).normalize().as_tuple().digits) <= digits


def test_rounded_up_beyond_numbers():
    assert [rounded_up(value, 4) for value in (0.0, math.inf, "0.12345")] == ["0", "inf", "0.1235"]

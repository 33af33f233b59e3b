"""Bounds of w that grow faster than the state: claims on a region, and where they hold."""

import json
from dataclasses import replace
from fractions import Fraction

import flint
import independent_checker
import numpy as np
import pytest
import sympy
from test_implemented import UNIT_W, bare_drive

import certrack
from certrack.certificates import certify, to_document, verify
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.certify import failed_cover
from certrack.certificates.implemented.drive import DRIVE_BITS
from certrack.certificates.implemented.growing import GrowingBound
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.start import FromStarts, Starts
from certrack.certificates.layout import digest_of
from certrack.certificates.methods import NOMINAL_KINDS
from certrack.certificates.size_majorants import Sizes, stays_below
from certrack.core.errors import InputError
from certrack.core.expressions import parse, symbol
from certrack.core.monotone import UNLIMITED, NotMonotone, check_growth, growth_power
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.escape import first_escape
from certrack.studies.falsifier.linear.search import sampled_case

NAMES = ("x1", "x2", "norm")
SYMBOLS = tuple(map(symbol, NAMES))

# Formulas that grow ------------------------------------------------------------------------------

GROWING = {
    "0.1*x2**2 + 0.01*norm": 2,
    "1 - 1/(1 + x1**2)": UNLIMITED,
    "exp(x1*x2) - 1": UNLIMITED,
    "sqrt(x2**2)": 1,
    "tanh(x1) + pi*x2": 1,
    "log(1 + norm)": 1,
    "log(2 + x1**3)": 3,
    "max(x1, 1)*min(x2, 3)": 2,
    "atan(x1**2)": 2,
    "x1**1.5": Fraction(3, 2),
    "exp(-1/(1 + x1))": UNLIMITED,
    "2 + tanh(x1 - 1)": UNLIMITED,
    "log(max(1, x1))": UNLIMITED,
    "sinh(x1) + cosh(x2)": UNLIMITED,
    "0.2": 0,
}

NOT_GROWING = [
    "sin(x1)",
    "x1 - x2",
    "x1*(x2 - 1)",
    "0 - x1",
    "log(norm)",
    "x1/(1 + x1)",
    "x1 - 1",
    "abs(x1 - 1)",
    "sign(x1)",
    "x1**2 - 2*x1 + 1",
    "tanh(x1 - 1)",
    "1/x1",
    "tan(x1)",
    "max(x1, 0 - x2)",
]


@pytest.mark.parametrize("text", GROWING)
def test_what_is_proven_to_grow_grows(text):
    formula = parse("bound", text, NAMES).expr
    check_growth(formula, SYMBOLS)
    assert growth_power(formula) == GROWING[text]
    draw = np.random.default_rng(0)
    value = sympy.lambdify(SYMBOLS, formula, "numpy")
    low = draw.uniform(0, 3, (3, 400)) * (draw.random((3, 400)) < 0.7)
    more = draw.uniform(0, 2, (3, 400)) * (draw.random((3, 400)) < 0.5)
    at_low = value(*low) + 0 * low[0]
    assert (at_low >= 0).all() and (value(*(low + more)) >= at_low * (1 - 1e-12)).all()
    power, c = growth_power(formula), draw.uniform(1, 3, 400)
    if power < UNLIMITED:
        assert (value(*(c * low)) <= c ** float(power) * at_low * (1 + 1e-12) + 1e-300).all()


@pytest.mark.parametrize("text", NOT_GROWING)
def test_what_is_not_proven_to_grow_is_refused(text):
    with pytest.raises(NotMonotone):
        check_growth(parse("bound", text, NAMES).expr, SYMBOLS)


def with_bounds(bound, gamma=(0, 0, 0, 0.01), **entries):
    base = certrack.load("dual-motor-lean").plant
    table = {"tau": [0, 1, 0, 1], "gamma": gamma, "beta": [0, 0, 0, 0.1], "bound": bound}
    return replace(base, uncertainty=table | entries)


@pytest.mark.parametrize(
    ("bound", "words"),
    [
        (["", "sin(x2)", "", ""], r"bound\[1\]: must be proven never to fall"),
        (["", "0.1*x2 - 1", "", ""], r"bound\[1\]: must not be negative"),
        (["", "0.1*x9", "", ""], r"bound\[1\]: unknown name 'x9'"),
        (["", "0.1*t", "", ""], r"bound\[1\]: unknown name 't'"),
        (["", "", "", "x2"], r"bound\[3\]: must be all of the bound of w_4"),
        (["", "x2", ""], r"bound: must be a list of 4"),
    ],
)
def test_one_line_says_what_is_wrong_with_a_bound(bound, words):
    with pytest.raises(InputError, match=words):
        with_bounds(bound)


def test_a_bound_that_no_state_has_grows_with_none_is_a_number():
    u = with_bounds(["", "K_L*x2 + 0.5*norm", "", 0.2], gamma=(0,) * 4, beta=(0,) * 4).uncertainty
    assert u.grows(1) and not u.grows(3) and u.acts(3) and not u.is_regional
    x = np.array([[1.0, 0.0], [-2.0, 3.0], [2.0, 0.0], [0.0, 4.0]])
    states = ("x1", "x2", "x3", "x4")
    assert u.largest(1, x, states) == pytest.approx([6 + 1.5, 9 + 2.5])
    text = u.bound_formula(1, states, 1e-3)
    smooth = sympy.lambdify(states, parse("w", text, states).expr)(*x)
    assert (smooth <= u.largest(1, x, states)).all()
    assert smooth == pytest.approx(u.largest(1, x, states), rel=1e-2)


def test_a_file_with_a_bound_is_written_as_it_was_read():
    system = certrack.load("dual-motor-drag")
    again = certrack.loads(certrack.to_text(system))
    assert again == system and again.plant.uncertainty.is_regional


# Is the truth below the bound? --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("formula", "bound", "region", "below"),
    [
        ("0.1*x2**2*sin(t) + 0.01*atan(x1**2 + x2**2)", "0.1*x2**2 + 0.01*norm", None, True),
        ("0.1*x2*abs(x2) + 0.011*sqrt(x1**2 + x2**2)", "0.1*x2**2 + 0.01*norm", None, False),
        ("0.1*x2**3", "0.1*x2**2", None, False),
        ("0.1*x2**3", "0.1*x2**2", (1, 1), True),
        ("0.1*x2**3", "0.1*norm", (1, 1), True),
        ("0.1*x2**3", "0.1*norm", (1, 1.1), False),
        ("0.1*x2**3", "0.1", (9, 1), True),
        ("0.1*x2**3", "0.0999", (9, 1), False),
        ("1.9", "2 + tanh(x1 - 1)", None, False),
        ("x1*x2", "x1*x2", None, True),
    ],
)
def test_proofs_that_a_formula_stays_below(formula, bound, region, below):
    states = SYMBOLS[:2]
    at = None if region is None else tuple(Fraction(str(r)) for r in region)
    norm = Fraction(0) if at is None else sum(at)
    sizes = Sizes(states, (Fraction(1),) * 2, at, norm)
    f = parse("omega", formula, ["t", "x1", "x2"]).expr
    assert stays_below(f, parse("bound", bound, NAMES).expr, sizes) == below


# Claims on a region -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drag():
    return certrack.load("dual-motor-drag")


@pytest.fixture(scope="module")
def found(drag):
    return certify(drag)


def test_the_largest_box_and_the_bound_inside_it(found):
    implemented = found.implemented
    assert found.verified and found.best is implemented and implemented.bound <= 0.00137
    (box,) = {high for _, high in implemented.polytope.region}
    assert 0.9 * 7.2 <= box <= 1.1 * 7.2
    assert implemented.starts == "box" and implemented.peaks.states[1] <= 3.3
    assert implemented.admits([7, -7, 7, 7]) and not implemented.admits([8, 0, 0, 0])
    (region,) = (p for p in found.premises if p.name == "region of states")
    assert "|x2| <= 3.0" in region.detail and region.status == "proven"


def test_the_continuous_loop_has_no_bound_of_a_formula(found):
    for kind in NOMINAL_KINDS:
        certificate = getattr(found, kind)
        assert not certificate.exists and "as implemented only" in certificate.reason


def test_the_file_is_verified_here_and_by_the_page(drag, found):
    document = to_document(drag, *found.stages)
    assert document["claim"].endswith(" from simulation.x0")
    assert verify(document).verified
    assert float(independent_checker.check(document)) == pytest.approx(found.best.bound)
    body = json.loads(json.dumps(document))
    region = body["proof"][0]["starts"][1]["region"]
    for pair in region:
        pair[:] = ["-9.0", "9.0"]  # wider: the states of some start escape from it
    body["sha256"] = digest_of(body)
    assert not verify(body).verified
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(body)


def smaller(text, factor=0.99):
    return repr(float(text) * factor)


MUTANTS = {
    "no start": lambda p: replace(p, starts=()),
    "no x0": lambda p: replace(p, starts=p.starts[1:]),
    "long run": lambda p: replace(p, states=tuple(map(smaller, p.states))),
    "bound": lambda p: replace(p, bound=smaller(p.bound)),
    "later": lambda p: of_box(p, states=tuple(map(smaller, p.starts[1].states))),
    "later, huge": lambda p: of_box(p, states=("1000",) * 4, input="10000"),
    "peaks": lambda p: of_box(p, peaks=tuple(map(smaller, p.starts[1].peaks))),
    "horizon": lambda p: of_box(p, doublings=5, middle=16),
    "box": lambda p: of_box(p, region=(("-7.7", "7.7"),) * 4),
}


def of_box(proof, **changes):
    return replace(proof, starts=(proof.starts[0], replace(proof.starts[1], **changes)))


@pytest.mark.parametrize("name", MUTANTS)
def test_changed_proofs_of_a_region_are_refused(drag, found, name):
    (proof,) = found.implemented_proof
    assert failed_cover(drag, (MUTANTS[name](proof),)) != ""


def squared_drive():
    """x1' = x2, x2' = -x1 - 2 x2 + w, |w| <= x1^2, without a controller."""
    grown = GrowingBound(symbol("x1") ** 2, (symbol("x1"), symbol("x2")))
    zero = flint.fmpq(0)
    w = replace(UNIT_W, beta=zero, weights=(flint.fmpq(1),) * 2, Delta=(zero,) * 2, growing=grown)
    return bare_drive([[0, 1], [-1, -2]], [0, 0], [[0], [1]], [0, 0], 0.1, [0.0] * 2, 0.0, [w])


def test_a_finite_horizon_proves_nothing():
    """From (0, 5) the state passes 1e4 at 3.48 s; from (0, 0.2) it stays."""
    with flint.ctx.workprec(DRIVE_BITS):
        period, zero = one_period(squared_drive(), (1, 8)), flint.arb(0)
        for speed, holds in ((5, False), (0.2, True)):
            starts = Starts((zero, flint.arb(speed)), (zero,) * 2, (zero,), zero)
            assert has_bounds(FromStarts(period, 6), starts) == holds
            assert has_bounds(FromStarts(period, 8), starts) == holds


def has_bounds(frame, starts):
    try:
        with np.errstate(all="ignore"):
            transient = frame.transient(starts)
            run = frame.run(starts, transient)
            frame.find_later(starts, transient, run, frame.count // 2)
    except NoCertificate:
        return False
    return True


# A truth that breaks its bound far away -----------------------------------------------------------


def cubic(strength, gamma=0.04):
    """w_2 = strength x_2^3 under |w_2| <= gamma ||x||, every 5 ms."""
    base = certrack.load("dual-motor-lean")
    u = replace(base.plant.uncertainty, gamma=(0, gamma, 0, 0.01))
    omega = ("0", f"{strength}*x2**3", "0", str(base.truth.omega[3]))
    return base.replace(
        plant=replace(base.plant, uncertainty=u),
        truth=replace(base.truth, omega=omega),
        implementation=certrack.Implementation(period=0.005, delay=0.5),
    )


def test_a_violation_far_away_is_not_fatal():
    """0.003 x^3 <= 0.04 x up to 3.65; from x0 the states keep |x_2| <= 3.06."""
    system = cubic(0.003)
    found = certify(system, "fast")
    assert found.verified and found.best.kind == "implemented" and found.best.starts == "x0"
    (held,) = (p for p in found.premises if p.name == "w_2 in the region")
    assert held.status == "proven" and "|x2| <= 3.0" in held.detail
    assert not found.semidefinite.verified and "contradicted" in found.semidefinite.reason
    assert not found.best.admits([0, 0, 0, 0]) and found.tube is None
    document = to_document(system, *found.stages)
    assert document["claim"].endswith(" from simulation.x0") and verify(document).verified
    independent_checker.check(document)
    everywhere = document | {"claim": document["claim"].removesuffix(" from simulation.x0")}
    assert not verify(everywhere | {"sha256": digest_of(everywhere)}).verified


def test_a_violation_where_the_states_are_is_fatal():
    """0.005 x^3 > 0.04 x from 2.83 on, where the states may be."""
    found = certify(cubic(0.005), "fast")
    assert not found.verified and [p.name for p in found.contradicted] == ["w_2"]


# Attacks ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_first_escape_is_outside_the_certified_box(drag, found):
    bounds = tuple(reference_bounds(drag, 2))
    escape = first_escape(drag, bounds, found.implemented.polytope)
    assert not escape.within and 7.7 < escape.scale < 13
    assert certrack.simulate(escape.system).outcome.name == "escaped"


@pytest.mark.slow
def test_no_attack_in_the_region_is_above_the_bound(drag, found):
    case = sampled_case(drag, tuple(reference_bounds(drag, 2)))
    assert found.implemented.admits(case.system.settings.x0)
    assert 0.0011 < case.error <= found.implemented.bound
    assert found.implemented.bound <= 1.15 * case.estimate

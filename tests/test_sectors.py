"""Nonlinear terms within a sector: numbers that vary in time, which no cell may cut."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import sympy
from depth import depth
from scipy.linalg import expm
from varying_attack import VaryingLoop, Wave

import certrack
from certrack.certificates import NoCertificate
from certrack.certificates.arithmetic import rational
from certrack.certificates.ranges.cells import halved
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.ranges.loop import error_form, ranged_loop
from certrack.certificates.ranges.proofs import (
    CellProof,
    RangeProver,
    check_cells,
    prover_of,
    texts,
)
from certrack.certificates.ranges.sectors import LEAST_SINC, sector_of
from certrack.core.expressions import symbol

Q = rational

FILE = """
[plant]
states = ["x", "v"]
chain = [1]
linear = [[0]]
drift = "DRIFT"
gain_sign = 1
input_gain = 1
[plant.constants]
K = 1
[plant.ranges]
K = ["1/2", "3/2"]
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]
[truth]
input_gain = 1
omega = [0, "0.1*sin(2*t)"]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [C, C]
feedforward = 1
[simulation]
x0 = [0, 0]
duration = 30
"""

X, V = symbol("x"), symbol("v")


def system_of(drift, c=3):
    return certrack.loads(FILE.replace("DRIFT", drift).replace("C, C", f"{c}, {c}"))


FUNCTIONS = ["sin(3*x)", "tanh(-2*v)", "atan(x/7)", "abs(x)", "x*tanh(v)", "v*cos(x)", "-x*sin(x)"]
PRODUCTS = ["sin(2*x)*cos(v)", "tanh(3*v)*sin(x)**2", "atan(x)*tanh(x)", "abs(v)*cos(x)*tanh(v)"]
SEARCHED = [*FUNCTIONS, *PRODUCTS]


@pytest.mark.parametrize("text", FUNCTIONS + PRODUCTS)
def test_sectors_contain_the_function(text):
    function = sympy.sympify(text, locals={"x": X, "v": V})
    _, function = function.as_independent(X, V, as_Add=False)
    j, low, high = sector_of(function, [X, V])
    f = sympy.lambdify([X, V], function)
    rng = np.random.default_rng(0)
    for scale in (0.01, 1.0, 5.0, 100.0):
        for x, v in rng.normal(size=(300, 2)) * scale:
            ratio = f(x, v) / (x, v)[j]
            assert float(low) - 1e-12 <= ratio <= float(high) + 1e-12


def test_sectors_are_not_much_too_wide():
    z = np.linspace(4, 5, 100_001)
    assert 0 < (np.sin(z) / z).min() - float(LEAST_SINC) < 1e-4
    assert sector_of(sympy.tanh(2 * X), [X, V]) == (0, 0, 2)
    for other in (X**3, X * V, sympy.exp(X), sympy.sin(X + 1), sympy.sqrt(1 + X**2)):
        assert sector_of(other, [X, V]) is None


def test_an_unbounded_term_within_a_sector_has_a_certificate():
    """No run at a corner exceeds it, whatever the slope does along it."""
    for drift in ("-K*abs(x)", "K*x*tanh(x)"):
        system = system_of(drift)
        with pytest.raises(NoCertificate, match="is unbounded"):
            RangeProver(system)
        found = certify_ranges(system)
        assert found.best.exists and found.attainable is None
        assert (
            check_cells(system, found.proof, max((p.bound for p in found.proof), key=float)) == ""
        )
        for K in (0.5, 1.5):
            member = system.replace(truth=replace(system.truth, constants={"K": K}))
            assert certrack.simulate(member).metrics.tail_error <= found.best.bound
    with pytest.raises(NoCertificate, match=r"x\*\*3 is unbounded"):
        RangeProver(system_of("-K*x**3"), sectors=True)
    assert "x**3 is unbounded" in certify_ranges(system_of("-K*x**3")).best.reason


def test_the_smaller_of_the_two_bounds_counts():
    """A saturating friction over a small motion: nearly linear there, and tiny beside its size."""
    system = system_of("-3*K*tanh(v/10)")
    plain, within = RangeProver(system), RangeProver(system, sectors=True)
    assert plain.loop.moving == 0 and within.loop.moving == 1 and len(within.box) == 2
    bounds = [float(prover.vertices(prover.box).bound) for prover in (plain, within)]
    assert bounds[1] < bounds[0] / 2
    assert certify_ranges(system, "fast").vertices.bound == pytest.approx(bounds[1], rel=1e-3)
    coarse = system_of("-K*0.001*tanh(100*v)")
    plain, within = RangeProver(coarse), RangeProver(coarse, sectors=True)
    bounds = [float(prover.vertices(prover.box).bound) for prover in (plain, within)]
    assert bounds[0] < bounds[1]
    assert certify_ranges(coarse, "fast").vertices.bound == pytest.approx(bounds[0], rel=1e-3)


def test_a_product_within_a_sector_is_one_function():
    """One number for bracket times slope: it is small where the law nearly knows the constant."""
    assert sector_of(sympy.atan(X) * sympy.tanh(X), [X, V])[1:] == (-1, 1)  # of two, the smaller
    system = system_of("K*sin(x)*cos(v)")
    prover = RangeProver(system, sectors=True)
    channels = prover.coefficients.over(prover.box)
    assert len(prover.coefficients.functions) == 1 and channels.rows.shape[0] == 1
    assert channels.columns.tolist() == [[0], [Q("1/2")]]  # |K - 1| <= 1/2 and |s| <= 1
    exact = prover.coefficients.over(((Q(1), Q(1)), *prover.box[1:]))
    assert exact.rows.shape[0] == 0  # nothing is left of the term, whatever s does
    plain = RangeProver(system)
    within, outside = (float(p.peak(p.box).bound) for p in (prover, plain))
    assert within < outside / 3
    assert certify_ranges(system).best.bound <= within * (1 + 1e-12)


def test_a_regressor_within_a_sector_with_a_range_of_theta():
    text = (
        FILE.replace("DRIFT", "0")
        .replace("C, C", "3, 3")
        .replace("gain_sign = 1", 'gain_sign = 1\nregressor = ["PHI"]\ntheta = [2]')
        .replace('K = ["1/2", "3/2"]', "theta = [[1, 2.5]]")
        .replace("omega = [0,", "theta = [1.2]\nomega = [0,")
    )
    system = certrack.loads(text.replace("PHI", "x*cos(v)"))
    prover = RangeProver(system, sectors=True)
    assert [str(s) for s in prover.loop.symbols] == ["ranges.theta[0]", "sector.slope[0]"]
    found = certify_ranges(system)
    assert found.best.exists
    assert check_cells(system, found.proof, max((p.bound for p in found.proof), key=float)) == ""
    assert certrack.simulate(system).metrics.tail_error <= found.best.bound
    unbounded = certify_ranges(certrack.loads(text.replace("PHI", "x*v")))
    assert not unbounded.best.exists and "v*x is unbounded" in unbounded.best.reason
    assert "is covered; narrow plant.ranges" in unbounded.best.reason


#: e'' + 0.1 e' + (1.0025 + delta) e with |delta| <= 1/2: stable for every constant delta.
SWITCHED = replace(system_of("(K - 1)*abs(x)", c=0.05))


def test_the_counterexample_is_stable_for_constants_and_not_for_slopes_that_switch():
    loop = ranged_loop(SWITCHED, sectors=True)
    forms = {
        point: error_form(loop, loop.entries.at(point)).M.astype(float)
        for point in itertools.product((Q("1/2"), Q(1), Q("3/2")), (Q(-1), Q(0), Q(1)))
    }
    assert all(np.linalg.eigvals(M).real.max() < 0 for M in forms.values())
    stiff, soft = forms[Q("1/2"), Q(1)], forms[Q("3/2"), Q(1)]
    steps = expm(0.01 * stiff), expm(0.01 * soft)
    e, largest = np.array([1.0, 0.0]), 0.0
    for _ in range(8000):
        outward = bool(e[0] * (soft @ e)[0] > 0)  # let it go, and draw it back
        e = steps[outward] @ e
        largest = max(largest, abs(e[0]))
    assert largest > 100


def test_no_cell_cuts_a_slope():
    """What cells would prove of it if they did, piece by piece, is refused as a whole."""
    assert not certify_ranges(SWITCHED).best.exists
    prover = RangeProver(SWITCHED, sectors=True)
    assert prover.vertices(prover.box) is None and prover.peak(prover.box) is None
    for K, s in itertools.product(("1/2", "1", "3/2"), ("-1", "0", "1")):  # yet each point has one
        assert prover.vertices(((Q(K), Q(K)), (Q(s), Q(s)))) is not None
    tame = system_of("-K*abs(x)")
    prover = RangeProver(tame, sectors=True)
    halves = ((Q(-1), Q(0)), (Q(0), Q(1)))
    cut = [prover.vertices((prover.box[0], half)) for half in halves]
    assert all(prover.check(proof) == "" for proof in cut)
    bound = max((proof.bound for proof in cut), key=float)
    assert "varies in time" in check_cells(tame, cut, bound)
    entire = prover.vertices(prover.box)
    assert check_cells(tame, [entire], entire.bound) == ""
    lower = f"{float(entire.bound) * (1 - 1e-6):.15g}"
    assert check_cells(tame, [replace(entire, bound=lower)], lower)
    narrower = replace(entire, cell=(entire.cell[0], ("-1/2", "1/2")))
    assert check_cells(tame, [narrower], entire.bound)


def test_saved_and_checked(tmp_path):
    system = system_of("-K*abs(x)")
    found = certrack.certify(system)
    assert found.verified and len(found.stages[0].cell) == 2
    certrack.certificates.save_certificate(system, found.stages, tmp_path / "cert.json")
    verdict = certrack.certificates.verify(tmp_path / "cert.json")
    assert verdict.verified, verdict.reason
    text = (tmp_path / "cert.json").read_text()
    assert '"-1"' in text
    (tmp_path / "wrong.json").write_text(text.replace('"-1"', '"-1/2"'))
    assert not certrack.certificates.verify(tmp_path / "wrong.json").verified
    assert [entry.name for entry in found.constants] == ["K"]
    assert 0 < found.critical_ranges.scale < math.inf and found.tube.start >= 0
    assert isinstance(found.stages[0], CellProof)
    assert prover_of(system, 2).loop.moving == 1
    assert texts(prover_of(system, 2).box)[1] == ("-1", "1")


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(5, 40)))
def test_no_run_exceeds_a_bound_of_sectors(seed):
    rng = np.random.default_rng([seed, 5])
    terms = [f"{rng.integers(-9, 10) / 10}*K*{f}" for f in rng.choice(SEARCHED, 2, replace=False)]
    system = system_of(" + ".join(terms), c=int(rng.integers(2, 6)))
    system = system.with_settings(x0=rng.normal(size=2).round(2).tolist())
    found = certrack.certify(system)
    if not found.best.exists:
        return
    for K in (0.5, 0.8, 1.5):
        member = system.replace(truth=replace(system.truth, constants={"K": K}))
        run = certrack.simulate(member)
        assert run.metrics.tail_error <= found.best.bound
        if found.tube is not None:
            assert (np.abs(run.e[0]) <= found.tube(run.t)).all()


# a search that tries to beat them


def switched_slopes(loop, rng):
    """The largest |e_1| at the end with slopes and inputs that jump, and constants that do not."""
    m = len(loop.box) - loop.moving
    points = list(itertools.product(*loop.box))
    nominal = np.linalg.eigvals(loop.coordinates.error_matrix.astype(float))
    steps = 300
    step = 10 / float(-nominal.real.max()) / steps
    varying = VaryingLoop(loop, points, step, Wave(0.1, 1.0))
    output = np.array([1.0, *[0.0] * (loop.n + 2)])
    phase = float(rng.uniform(0, 2 * np.pi))
    z = varying.start(np.zeros(loop.n), phase)
    z[: loop.n] = 0
    run = varying.ascent(z, output, steps, rng, rounds=6, still=2**loop.moving)
    assert m and 2**m * 2**loop.moving == len(points)
    return float(output @ run[-1])


@pytest.mark.search
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, depth(8, 25)))]
)
def test_no_switching_slope_exceeds_a_bound_of_sectors(seed):
    """Of every proof: the smallest cells too, for slopes vary where constants stand still."""
    rng = np.random.default_rng([seed, 6])
    terms = [f"{rng.integers(-15, 16) / 10}*K*{f}" for f in rng.choice(SEARCHED, 2, replace=False)]
    system = system_of(" + ".join(terms), c=int(rng.integers(2, 6)))
    prover = RangeProver(system, sectors=True)
    moving = prover.loop.moving
    if not moving:
        return
    whole = [p for p in (prover.vertices(prover.box), prover.peak(prover.box)) if p]
    halves = [prover.peak(cell) for cell in halved(prover.box, [1] * len(prover.box), moving)]
    bounds = [float(proof.bound) for proof in whole]
    bounds += [max(float(proof.bound) for proof in halves)] if all(halves) else []
    if bounds:
        reached = switched_slopes(prover.loop, rng)
        assert 0.1 * min(bounds) < reached <= min(bounds)

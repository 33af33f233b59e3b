"""`verify` and a checker that shares no line with it agree on proofs by cells, and on mutants."""

import copy
import math
from dataclasses import replace
from fractions import Fraction

import independent_checker
import independent_ranges
import numpy as np
import pytest
from depth import depth
from test_independent_checker import accepted, signed, verified
from test_ranges import case, random_system, seven_constants

import certrack
from certrack.certificates import certify_peak
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.document import to_document
from certrack.certificates.ranges.cells import halved
from certrack.certificates.ranges.proofs import RangeProver
from certrack.certificates.ranges.rational import MAX_HULL_POINTS
from certrack.core.errors import InputError

TWO = """
[plant]
states = ["x1", "x2"]
chain = ["k/m"]
linear = [["-0.5*k"]]
drift = "-d/m*x2 + d*tanh(x1)"
gain_sign = 1
input_gain = "1/m"
[plant.constants]
m = 1
k = 2
d = 0.3
[plant.ranges]
m = ["0.8", "1.3"]
k = ["1.9", "2.1"]
d = [0.2, 0.4]
[plant.uncertainty]
tau = [1, 1]
gamma = [0, 0.05]
beta = [0, 0.1]
Delta = [[0.01, 0], [0, 0.02]]
[law]
kind = "robust"
c = [2, 3]
feedforward = 1
[reference]
signal = "0.5*sin(t) + 0.1"
[truth]
input_gain = "1/m"
[simulation]
x0 = [0, 0]
duration = 5
"""

VARIANTS = {
    "small": TWO.replace("gamma = [0, 0.05]", "gamma = [0, 0]")
    .replace("Delta = [[0.01, 0], [0, 0.02]]", "")
    .replace("d = [0.2, 0.4]", "")
    .replace('k = ["1.9", "2.1"]', ""),
    "growth": TWO,
    "weights": TWO.replace("Delta = [[0.01, 0], [0, 0.02]]", "S = [[2, 0.5], [0.1, 0.7]]"),
    "one weight for all": TWO.replace("Delta = [[0.01, 0], [0, 0.02]]", "S = [2, 0.5]"),
    "coupling": TWO.replace("feedforward = 1", "coupling = 0.5"),
    "input gain and theta": TWO.replace("[plant.ranges]", "[plant.ranges]\ninput_gain = [0.9, 1.1]")
    .replace('m = ["0.8", "1.3"]\n', "")
    .replace("gain_sign", 'regressor = ["x1", "sin(x2)"]\ntheta = [0.1, 0.2]\ngain_sign')
    .replace("[truth]", "[truth]\ntheta = [0.1, 0.2]")
    .replace("[plant.ranges]", "[plant.ranges]\ntheta = [[0, 0.1], [0.2, 0.2]]"),
    "adaptive": TWO.replace('kind = "robust"', 'kind = "adaptive"\nGamma = [0.5]')
    .replace("gain_sign", 'regressor = ["x1"]\ngain_sign')
    .replace("[truth]", '[truth]\ntheta = ["0.1*k"]')
    .replace('input_gain = "1/m"\n[plant', "[plant")
    .replace('m = ["0.8", "1.3"]\n', 'm = ["0.9", "1.1"]\n'),
}


#: With terms within a sector, some of them products, and with many functions of the constants.
SECTORS = {
    "one": VARIANTS["small"].replace("d*tanh(x1)", "d*x1*cos(x2)"),
    "growth": TWO.replace("d*tanh(x1)", "d*x1*cos(x2)"),
    "two": TWO.replace("-d/m*x2 + d*tanh(x1)", "d*sin(-3*x1)*tanh(x2)/m + k*abs(x2/5)")
    .replace("Delta = [[0.01, 0], [0, 0.02]]", "")
    .replace("gamma = [0, 0.05]", "gamma = [0, 0]"),
    "input gain and theta": VARIANTS["input gain and theta"]
    .replace('"sin(x2)"', '"x2*tanh(x1)"')
    .replace("[[0, 0.1], [0.2, 0.2]]", "[[0, 0.1], [0.1, 0.25]]"),
    "adaptive": VARIANTS["adaptive"].replace("d*tanh(x1)", "d*x1*tanh(x1)"),
    "centre": TWO.replace(
        "-d/m*x2 + d*tanh(x1)", "(m*d/k**2 + k**6/d**2)*(x1*atan(x2) + tanh(x2))/m/9999"
    ),
}


def documents(system, sectors=False):
    """Proofs by the whole box, by its halves, and by the cells that `certify` finds."""
    prover = RangeProver(system, sectors=sectors)
    halves = halved(prover.box, [1] * len(prover.box), prover.loop.moving)
    proofs = [[prover.vertices(prover.box)], [prover.vertices(cell) for cell in halves]]
    if prover.by_peak_gains:
        proofs += [[prover.peak(prover.box)], [prover.peak(cell) for cell in halves]]
        proofs += [[prover.vertices(halves[0]), prover.peak(halves[1])]]
    return [to_document(system, *cells) for cells in proofs if all(cells)]


def agree(system, sectors=False):
    found = documents(system, sectors)
    for document in found:
        assert verified(document), document["system"]
        assert accepted(document), document["system"]
    return found


FAST = ("small", "adaptive")


@pytest.mark.parametrize(
    "name", [*FAST, *(pytest.param(n, marks=pytest.mark.slow) for n in VARIANTS if n not in FAST)]
)
def test_variants_agree(name):
    assert len(agree(certrack.loads(VARIANTS[name]))) >= 2


@pytest.mark.parametrize(
    "name", ["one", *(pytest.param(n, marks=pytest.mark.slow) for n in SECTORS if n != "one")]
)
def test_sectors_agree(name):
    system = certrack.loads(SECTORS[name])
    prover = RangeProver(system, sectors=True)
    assert prover.loop.moving and len(agree(system, sectors=True)) >= 2
    assert (prover.loop.entries.count > MAX_HULL_POINTS) == (name == "centre")


@pytest.mark.parametrize("name", ["axis"])
def test_certificates_of_shipped_systems_hold_by_both(name):
    system = certrack.load(name)
    document = to_document(system, *certrack.certify(system).stages)
    assert "cell" in document["proof"][0]
    assert verified(document)
    bound = independent_checker.check(document)
    assert bound == Fraction(document["claim"].split()[-1])


@pytest.mark.slow
def test_certificates_of_the_flexible_joint_hold_by_both():
    test_certificates_of_shipped_systems_hold_by_both("flexible-joint")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ranges-axis", "ranges-dual-motor", "ranges-joint"])
@pytest.mark.parametrize("varies", [False, True])
def test_certificates_of_the_cases_hold_by_both(name, varies):
    system = case(name)
    uncertainty = replace(system.plant.uncertainty, constants_vary=varies)
    system = system.replace(plant=replace(system.plant, uncertainty=uncertainty))
    document = to_document(system, *certrack.certify(system).stages)
    assert verified(document)
    assert accepted(document)


@pytest.mark.slow
def test_a_proof_at_the_centre_holds_by_both():
    system = seven_constants()
    prover = RangeProver(system)
    document = to_document(system, prover.vertices(prover.box))
    assert verified(document)
    assert accepted(document)


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(20, 100)))
def test_random_systems_agree(seed):
    system = random_system(np.random.default_rng([seed, 3]))
    try:
        agree(system)
    except (NoCertificate, InputError) as refusal:
        pytest.skip(str(refusal))


@pytest.mark.parametrize(
    "name", ["dual-motor-lean", pytest.param("dual-motor", marks=pytest.mark.slow)]
)
def test_peak_gains_without_ranges_hold_by_both(name):
    system = certrack.load(name)
    document = to_document(system, *certify_peak(system)[1])
    assert verified(document) and accepted(document)
    mutant = copy.deepcopy(document)
    changed_bound(mutant["proof"][0])
    mutant["claim"] = f"limsup |e_1(t)| <= {mutant['proof'][0]['bound']}"
    assert not verified(signed(mutant)) and not accepted(signed(mutant))


# Mutants ------------------------------------------------------------------------------------------


def better(text, factor=1 - 1e-4):
    return f"{float(text) * factor:.15g}"


def changed_stage(key, factor):
    def change(cell):
        for stage in cell["points"]:
            if isinstance(stage[key], list):
                stage[key] = [better(v, factor) for v in stage[key]]
            else:
                stage[key] = better(stage[key], factor)

    return change


def changed_P(cell):
    for stage in cell["points"]:
        stage["P"][0][0] = better(stage["P"][0][0], 0.7)


def changed_bound(cell):
    cell["bound"] = better(cell["bound"], 1 - 2e-5 if not cell["points"] else 1 - 1e-6)
    for stage in cell["points"]:
        stage["bound"] = cell["bound"]


def narrower(cell):
    low, high = map(Fraction, cell["cell"][0])
    cell["cell"][0] = [str(low + (high - low) / 100), str(high)]


def another_axis_narrower(cell):
    low, high = map(Fraction, cell["cell"][-1])
    cell["cell"][-1] = [str(low), str(high - (high - low) / 100)]


def wider(cell):
    """The proof of a small cell for a larger one."""
    low, high = map(Fraction, cell["cell"][0])
    cell["cell"][0] = [str(low), str(high + (high - low) / 5)]


def slopes_exchanged(cell):
    """Where there is one slope, its interval and that of a constant."""
    cell["cell"][-2:] = cell["cell"][:-3:-1]


def without_a_point(cell):
    del cell["points"][1:2]


def points_reversed(cell):
    cell["points"].reverse()


def without_points(cell):
    cell["points"] = []


def other_bound_of_a_point(cell):
    for stage in cell["points"][:1]:
        stage["bound"] = better(stage["bound"], 2)


MUTATIONS = (
    changed_stage("nu", 0.5),
    changed_stage("lam", 0.0),
    changed_stage("k", 0.5),
    changed_stage("alpha", 1.5),
    changed_P,
    changed_bound,
    narrower,
    another_axis_narrower,
    wider,
    slopes_exchanged,
    without_a_point,
    points_reversed,
    without_points,
    other_bound_of_a_point,
)


def mutants(document):
    for change in MUTATIONS:
        for i in {0, len(document["proof"]) - 1}:
            mutant = copy.deepcopy(document)
            change(mutant["proof"][i])
            if mutant["proof"] != document["proof"]:
                largest = max((cell["bound"] for cell in mutant["proof"]), key=float)
                mutant["claim"] = f"limsup |e_1(t)| <= {largest}"
                yield change, signed(mutant)
    lost = copy.deepcopy(document)
    del lost["proof"][-1]
    if lost["proof"]:
        yield None, signed(lost)
    yield None, signed({**document, "claim": "limsup |e_1(t)| <= 0.0001"})


@pytest.mark.parametrize(
    "name", ["small", *(pytest.param(n, marks=pytest.mark.slow) for n in ("growth", "adaptive"))]
)
def test_mutants_are_refused_by_both(name):
    refused = 0
    found = documents(certrack.loads(VARIANTS[name]))
    for document in found if name != "small" else (found[0], found[-1]):
        for change, mutant in mutants(document):
            first, second = verified(mutant), accepted(mutant)
            assert first == second, (change, mutant["proof"][0]["cell"])
            refused += not second
            must_be_refused = change in (narrower, another_axis_narrower, changed_bound, None)
            assert not (must_be_refused and second), change
    assert refused >= 20


@pytest.mark.slow
@pytest.mark.parametrize("name", ["one", "two"])
def test_mutants_of_sectors_are_refused_by_both(name):
    system = certrack.loads(SECTORS[name])
    moving = RangeProver(system, sectors=True).loop.moving
    for document in documents(system, sectors=True):
        cell = document["proof"][0]["cell"]
        for change, mutant in mutants(document):
            first, second = verified(mutant), accepted(mutant)
            if change is slopes_exchanged:  # a checker may take them in any order
                assert not first and (moving > 1 or not second)
                continue
            assert first == second, (change, mutant["proof"][0]["cell"])
            must_be_refused = change in (narrower, another_axis_narrower, changed_bound, None)
            assert not (must_be_refused and second), change
        for i in range(len(cell) - moving, len(cell)):  # entire slopes, which no two cells share
            low, high = map(Fraction, cell[i])
            cut = copy.deepcopy(document)
            cut["proof"] = []
            for part in ((low, (low + high) / 2), ((low + high) / 2, high)):
                for entry in copy.deepcopy(document["proof"]):
                    entry["cell"][i] = list(map(str, part))
                    cut["proof"].append(entry)
            assert not verified(signed(cut)) and not accepted(signed(cut))


# What the checker is made of ----------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_integrals_are_above_and_near_those_of_a_quadrature(seed):
    rng = np.random.default_rng([seed, 4])
    n = int(rng.integers(1, 4))
    M = np.round(rng.normal(size=(n, n)) * 3, 2) - np.diag(np.round(rng.uniform(4, 9, n), 2))
    M[0, 0] *= 10 ** rng.uniform(0, 2)  # a fast mode
    if np.linalg.eigvals(M).real.max() > -0.5:
        pytest.skip("slow or unstable")
    c, b = np.round(rng.normal(size=(1, n)), 2), np.round(rng.normal(size=(n, 2)), 2)
    exact = [[[Fraction(v) for v in row] for row in table.tolist()] for table in (M, c, b.T)]
    found = np.array(independent_ranges.Kernels(*exact).gains, dtype=float)
    rates, V = np.linalg.eig(M)
    left, right = c @ V, np.linalg.solve(V, b)
    ends = np.concatenate([[0], np.geomspace(1e-4, 1, 60) * 40 / -rates.real.max()])
    total = np.zeros(2)
    for low, high in zip(ends, ends[1:], strict=False):
        t = np.linspace(low, high, 4001)
        kernel = np.abs((left * np.exp(np.outer(t, rates))) @ right)
        total += np.trapezoid(kernel, t, axis=0)
    assert (found >= total * (1 - 1e-7)).all()
    assert (found <= total * (1 + 1e-6)).all()


def test_an_unstable_matrix_has_no_integral():
    with pytest.raises(independent_checker.Refused, match="not stable"):
        independent_ranges.Kernels([[Fraction(1, 10)]], [[Fraction(1)]], [[Fraction(1)]])


def test_an_exact_integral():
    """Of |e^-t - 2 e^-2t|, which changes its sign at log 2, is 1/2."""
    M = [[Fraction(-1), Fraction(0)], [Fraction(0), Fraction(-2)]]
    ((found,),) = independent_ranges.Kernels(
        M, [[Fraction(1), Fraction(-2)]], [[Fraction(1), Fraction(1)]]
    ).gains
    assert Fraction(1, 2) <= found <= Fraction(1, 2) * (1 + Fraction(1, 10**8))


def test_rational_functions_are_in_lowest_terms():
    m, d = (
        independent_ranges.Ratio({key: Fraction(1)}, {(0, 0): Fraction(1)})
        for key in ((1, 0), (0, 1))
    )
    one = independent_ranges.Ratio.number(1, 2)
    assert (m * m - d * d) / (m + d) == m - d
    assert one / m + one / d == (m + d) / (m * d)
    trap = d * m / (m * m + d)
    assert trap * (m * m + d) / d == m
    vector = independent_ranges.Vector([one / m, one / d, m / (d * d)], 2)
    assert vector.degrees == [2, 2] and vector.count == 9
    points = vector.points([(Fraction(1), Fraction(2)), (Fraction(1), Fraction(3))])
    assert points[0] == [1, 1, 1] and points[-1] == [Fraction(1, 2), Fraction(1, 3), Fraction(2, 9)]
    assert math.prod(point[0] for point in points) > 0

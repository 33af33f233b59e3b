"""Polynomials by sums of squares on the boxes of the bootstrap: proofs, and what they refuse."""

import copy
import dataclasses
import json
from fractions import Fraction
from functools import cache

import flint
import independent_bootstrap
import independent_checker
import numpy as np
import pytest
from adaptive_plants import random_plant
from test_bootstrap import WORST_OF_EXAMPLE1, proven_system

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.arithmetic import decimal, rational
from certrack.certificates.bootstrap.certify import certify_bootstrap
from certrack.certificates.bootstrap.check import claimed_bound
from certrack.certificates.bootstrap.conditions import layout_of
from certrack.certificates.bootstrap.forms import forms_of
from certrack.certificates.bootstrap.gram import gram_matrix, gram_pattern
from certrack.certificates.bootstrap.loop import adaptive_loop, formulas_of
from certrack.certificates.bootstrap.monomials import monomials
from certrack.certificates.bootstrap.polynomial_proof import failed_sum
from certrack.certificates.bootstrap.polynomial_stages import RowSolver
from certrack.certificates.bootstrap.ranges import Ranges
from certrack.certificates.bootstrap.rates import Rate
from certrack.certificates.bootstrap.regions import after, first_box, next_region, rows_of
from certrack.certificates.bootstrap.stage import BootstrapStage
from certrack.certificates.bootstrap.variables import with_reference
from certrack.certificates.exact import from_text
from certrack.certificates.layout import digest_of


class OneStage:
    """A stage with polynomials behind the quadratic ones of a system."""

    def __init__(self, name, wanted, *, reference=False, alpha=2.0):
        self.system, self.certificate, self.before = proven_system(name)
        self.loop, known = adaptive_loop(self.system), None
        for stage in self.before[1:]:
            numbers = stage.region.numbers()
            known = known or first_box(self.loop, self.before[0])
            known = after(known, stage.functions, rows_of(self.loop, numbers))
        self.region = next_region(self.loop, Ranges(formulas_of(self.system), self.loop), known)
        numbers = self.region.numbers()
        self.forms, self.rows = forms_of(self.loop, numbers), rows_of(self.loop, numbers)
        floats = forms_of(self.loop.in_floats(), numbers.in_floats())
        solver = RowSolver(self.loop, self.forms, floats, reference=reference)
        self.functions = []
        for row in wanted:
            rate = Rate(alpha)
            rate.met(-1.0)  # both are known: one program only
            rate.met(1.0)
            rate.alpha = alpha
            self.functions.append(solver.bound(self.rows, row, rate))

    @property
    def stages(self):
        return (*self.before, BootstrapStage(self.region, tuple(self.functions)))

    def fails(self, function):
        return failed_sum(self.loop, self.forms, function, self.rows)


@cache
def one_stage(name):
    return {
        "example1": lambda: OneStage("example1", [(0, 1), (0, -1)]),
        "reference": lambda: OneStage("example1", [(0, 1)], reference=True),
        "ranged": lambda: OneStage("ranged", [(1, 1)], alpha=1.0),
    }[name]()


def test_a_quartic_makes_the_bound_of_example1_smaller():
    stage = one_stage("example1")
    text = claimed_bound(stage.stages[1:])
    assert WORST_OF_EXAMPLE1 < float(text) < 0.0530
    assert float(text) < 0.86 * stage.certificate.bound
    document = json.loads(json.dumps(to_document(stage.system, *stage.stages)))
    verdict = verify(document)
    assert verdict.verified
    assert verdict.bound == text
    document["claim"] = document["claim"].replace(text, text[:-1])
    document["sha256"] = digest_of(document)
    assert not verify(document).verified


def test_the_reference_among_the_variables_makes_it_smaller_still():
    bounds = [float(one_stage(n).functions[0].claims[0].bound) for n in ("reference", "example1")]
    assert WORST_OF_EXAMPLE1 < bounds[0] < 0.97 * bounds[1]


@pytest.mark.slow
def test_a_quartic_helps_where_constants_have_ranges():
    stage = one_stage("ranged")
    low, high = stage.region.numbers().box[1].astype(float)
    assert float(stage.functions[0].claims[0].bound) < high - 0.01 * (high - low)


def values_of(texts, degree, points):
    """A polynomial of coefficients at points (rows)."""
    powers = [np.prod(points ** np.array(m), axis=1) for m in monomials(points.shape[1], degree)]
    return np.array([float(v) for v in texts]) @ np.array(powers)


@pytest.mark.parametrize(
    "name", ["example1", "reference", pytest.param("ranged", marks=pytest.mark.slow)]
)
def test_functions_fall_at_random_points_and_inputs(name):
    """W' + alpha W + mu relation <= 0 by the forms alone, at w in the box with pi between ends."""
    stage = one_stage(name)
    floats = forms_of(stage.loop.in_floats(), stage.region.numbers().in_floats())
    rng = np.random.default_rng(8)
    for function in stage.functions:
        forms = with_reference(stage.loop.in_floats(), floats) if function.reference else floats
        N, d = forms.size, function.degree
        w = rng.uniform(-1, 1, (4000, forms.width))
        w[:2000] = np.sign(w[:2000])
        w[:1000, :N] *= rng.uniform(0, 1, (1000, 1))
        w[:, N] = 1.0
        for first, second in forms.products:
            for a, b in zip(first[1:], second[1:], strict=True):
                w[:, b] = w[:, second[0]] * w[:, a]
        for rows, place in forms.squares:
            w[:, place] *= np.minimum(1, np.linalg.norm(w @ rows.T, axis=1))
        extra = np.abs(w[:, : N + 1] @ forms.sectors.T).max(axis=1) <= 1  # the row of ubar
        w = w[extra]
        assert len(w) > 500
        part = rng.uniform(0, 1, len(w)).round()[:, None]
        part[::3] = rng.uniform(0, 1, (len(part[::3]), 1))
        first, last = forms.corners
        rates = part * (w @ first.F.T) + (1 - part) * (w @ last.F.T)
        relation = part[:, 0] * (w @ first.relation) + (1 - part[:, 0]) * (w @ last.relation)
        v = w[:, :N]
        step = 1e-6
        ahead, behind = (values_of(function.W, d, v + s * step * rates) for s in (1, -1))
        W = values_of(function.W, d, v)
        falls = (ahead - behind) / (2 * step) + float(function.alpha) * W
        falls += values_of(function.mu, d - 1, v) * relation
        assert falls.max() <= 1e-6 * np.abs(W).max()
        assert falls.max() >= -0.2 * np.abs(falls).max()  # and it is not far from zero
        claim = function.claims[0]
        row = np.append(stage.rows[claim.error].astype(float), [0.0] * (N - stage.loop.size))
        z = forms.middle + forms.radius * v
        above = W + (float(claim.bound) - claim.side * (z @ row)) / float(claim.scale)
        assert above.min() >= 0


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_gram_matrix_is_the_polynomial(count):
    rng = np.random.default_rng(count)
    basis = monomials(count, 2)
    whole = monomials(count, 4)
    polynomial = {m: rational(int(v)) for m, v in zip(whole, rng.integers(-9, 9, 99), strict=False)}
    free = [rational(int(v)) for v in rng.integers(-9, 9, len(gram_pattern(basis).free))]
    Q = gram_matrix(polynomial, basis, free)
    assert (Q == Q.T).all()
    assert len(set(whole)) == len(gram_pattern(basis).first)

    def at(point, monomial):
        value = flint.fmpq(1)
        for x, k in zip(point, monomial, strict=True):
            value *= flint.fmpq(x) ** k
        return value

    for point in rng.integers(-5, 6, (5, count)).tolist():
        m = np.array([at(point, monomial) for monomial in basis], dtype=object)
        assert m @ Q @ m == sum((v * at(point, k) for k, v in polynomial.items()), flint.fmpq(0))
    assert gram_matrix({(5, *(0,) * (count - 1)): rational(1)}, basis, free) is None


def times(text, factor):
    return f"{float(text) * factor:.15g}"


def of_first(change):
    """Change the entry of largest size of one of many lists of texts."""

    def changed(lists):
        sizes = [max((abs(float(v)) for v in texts), default=0.0) for texts in lists]
        at = int(np.argmax(sizes))
        return tuple(largest(texts, change) if i == at else texts for i, texts in enumerate(lists))

    return changed


def largest(texts, change):
    at = max(range(len(texts)), key=lambda i: abs(float(texts[i])))
    return tuple(change(v) if i == at else v for i, v in enumerate(texts))


def smaller_bound(claims):
    return tuple(dataclasses.replace(c, bound=times(c.bound, 0.98)) for c in claims)


def opposite(text):
    return f"{-float(text):.15g}"


def grown(text):
    return times(text, 1.2)


MUTANTS = {
    "bound": {"claims": smaller_bound},
    "side": {"claims": lambda v: (dataclasses.replace(v[0], side=-v[0].side),)},
    "no side": {"claims": lambda v: (dataclasses.replace(v[0], side=0),)},
    "another row": {"claims": lambda v: (dataclasses.replace(v[0], error=1),)},
    "no row": {"claims": lambda v: (dataclasses.replace(v[0], error=9),)},
    "scale": {"claims": lambda v: (dataclasses.replace(v[0], scale=times(v[0].scale, 1.05)),)},
    "no scale": {"claims": lambda v: (dataclasses.replace(v[0], scale="0"),)},
    "two claims": {"claims": lambda v: v + v},
    "alpha": {"alpha": lambda v: times(v, 1.1)},
    "alpha's sign": {"alpha": lambda v: f"-{v}"},
    "W": {"W": lambda v: largest(v, grown)},
    "mu's sign": {"mu": lambda v: tuple(map(opposite, v))},
    "no mu": {"mu": lambda v: ("0",) * len(v)},
    "squares' sign": {"squares": lambda v: tuple(tuple(map(opposite, p)) for p in v)},
    "inputs": {"inputs": lambda v: tuple(("-1e-3", *p[1:]) for p in v)},
    "sectors' sign": {"sectors": lambda v: tuple(tuple(map(opposite, p)) for p in v)},
    "majorants": {"majorants": of_first(lambda v: times(v, 0.9))},
    "no majorants": {"majorants": lambda v: tuple(("0",) * len(p) for p in v)},
    "fewer majorants": {"majorants": lambda v: v[:-1]},
    "holds": {"holds": lambda v: tuple(tuple(map(opposite, p)) for p in v)},
    "grams": {"grams": of_first(lambda v: times(v, 1.5))},
    "grams' sign": {"grams": lambda v: tuple(tuple(map(opposite, p)) for p in v)},
    "fewer grams": {"grams": lambda v: v[:-1]},
    "shorter gram": {"grams": lambda v: (*v[:-1], v[-1][:-1])},
    "degree": {"degree": lambda v: 6},
    "odd degree": {"degree": lambda v: 3},
    "degree two": {"degree": lambda v: 2},
    "huge degree": {"degree": lambda v: 10**9},
    "reference": {"reference": lambda v: not v},
}


def changed(function, name):
    changes = {key: change(getattr(function, key)) for key, change in MUTANTS[name].items()}
    return dataclasses.replace(function, **changes)


@pytest.mark.parametrize("name", ["example1", "reference"])
def test_what_is_proven_holds(name):
    stage = one_stage(name)
    for function in stage.functions:
        assert not stage.fails(function)


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_of_a_polynomial_are_refused(name):
    stage = one_stage("example1" if len(name) % 2 else "reference")
    assert stage.fails(changed(stage.functions[0], name))


def test_every_gram_matrix_is_needed_to_be_definite():
    """Each condition fails alone when its free entries are far off."""
    stage = one_stage("example1")
    function = stage.functions[0]
    for i, texts in enumerate(function.grams):
        if texts:
            worse = largest(texts, lambda v: f"{float(v) + 50:.15g}")
            grams = (*function.grams[:i], worse, *function.grams[i + 1 :])
            assert stage.fails(dataclasses.replace(function, grams=grams))


def narrower(pair):
    low, high = map(float, pair)
    return (times(str(low + 0.02 * (high - low)), 1), times(str(high - 0.02 * (high - low)), 1))


def test_monomials_of_a_function_are_counted_by_half_its_degree():
    """Of four variables a Gram matrix has C(4 + d/2, 4) rows: 126 for d = 10, 210 for d = 12."""
    stage = one_stage("example1")
    for degree in (6, 8, 10):
        assert "shape" in stage.fails(dataclasses.replace(stage.functions[0], degree=degree))
    for degree in (12, 14):
        assert "many" in stage.fails(dataclasses.replace(stage.functions[0], degree=degree))


@pytest.mark.parametrize("key", ["box", "row", "regressor", "drift", "remainder", "reach"])
def test_ranges_that_are_too_narrow_are_refused(key):
    """A box that is not reached, and ranges that do not hold on it."""
    stage = one_stage("example1")
    document = json.loads(json.dumps(to_document(stage.system, *stage.stages)))
    region = document["proof"][-1]["region"]
    if key == "reach":
        region[key][0] = times(region[key][0], 0.98)
    elif key in ("box", "regressor"):
        region[key][0] = narrower(region[key][0])
    else:
        region[key] = narrower(region[key])
    document["sha256"] = digest_of(document)
    verdict = verify(document)
    assert not verdict.verified
    assert "stage" in verdict.reason


def test_forged_entries_are_refused_in_one_line():
    stage = one_stage("example1")
    document = json.loads(json.dumps(to_document(stage.system, *stage.stages)))
    for key, value in {
        "degree": "4",
        "reference": 0,
        "W": "1",
        "grams": [["x"]],
        "claims": [{}],
        "mu": [1.0],
    }.items():
        forged = copy.deepcopy(document)
        forged["proof"][-1]["functions"][0][key] = value
        forged["sha256"] = digest_of(forged)
        with pytest.raises(certrack.InputError, match="proof"):
            verify(forged)


def test_functions_fall_along_runs_that_are_in_the_box():
    stage = one_stage("reference")
    system = stage.system.with_settings(duration=60.0)
    clock = np.arange(0.0, 60.0, 0.002)
    states = certrack.simulate(system).trajectory.interpolate(clock)
    Y = system.reference.values(clock, 1)
    c, truth = system.controller.coordinates, system.truth
    e = c.A @ states[:2] - c.B @ Y[: c.B.shape[1]]
    theta, gain = decimal(truth.theta[0]), decimal(truth.input_gain)
    z = np.vstack([e, theta - states[3], 1 / gain - states[2]])
    box = stage.region.numbers().box.astype(float)
    inside = ((z >= box[:, :1]) & (z <= box[:, 1:])).all(axis=0)
    last = len(clock) - int(np.argmin(inside[::-1]))
    assert last < 0.9 * len(clock)
    zeta = (z - box.mean(axis=1)[:, None]) / (np.diff(box, axis=1) / 2)
    v = np.vstack([zeta, Y[0] / float(stage.loop.Y[0])]).T
    function = stage.functions[0]
    W = values_of(function.W, 4, v)[last:]
    rate, middle = np.diff(W) / np.diff(clock[last:]), (W[1:] + W[:-1]) / 2
    assert (rate <= -float(function.alpha) * middle + 1e-5 * np.abs(W).max()).all()
    assert W[-1] <= 0


@pytest.mark.slow
def test_inputs_that_act_on_nothing_have_no_majorant():
    stage = one_stage("ranged")
    layout = layout_of(stage.forms, 4)
    assert any(len(channel.groups) == 2 for channel in layout.channels)  # 1/v, with each end of pi
    assert sum(channel.square is not None for channel in layout.channels) == layout.squares
    assert len(layout.channels) < stage.forms.width - stage.forms.size - 1


@pytest.mark.slow
def test_example1_with_high_effort():
    system = certrack.load("example1")
    heard = []
    certificate, stages = certify_bootstrap(
        system, "high", progress=lambda _, __, best: heard.append(best)
    )
    assert certificate.verified
    assert WORST_OF_EXAMPLE1 < certificate.bound <= 0.0500
    assert heard == sorted(heard, reverse=True)
    document = json.loads(json.dumps(to_document(system, *stages)))
    assert verify(document).verified
    bound = independent_checker.check(document)
    assert float(bound) == pytest.approx(certificate.bound, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["example1", "reference", "ranged"])
def test_the_other_checker_agrees(kind):
    stage = one_stage(kind)
    document = json.loads(json.dumps(to_document(stage.system, *stage.stages)))
    assert from_text(verify(document).bound) == flint.fmpq(
        *independent_checker.check(document).as_integer_ratio()
    )


@cache
def other_region():
    """The last stage's region for the other checker, which has checked what is before it."""
    stage = one_stage("example1")
    document = json.loads(json.dumps(to_document(stage.system, *stage.stages)))
    first, *stages = document["proof"]
    P = [[Fraction(v) for v in row] for row in first["P"]]
    system = independent_checker.System(document["system"], None)
    loop = independent_bootstrap.Loop(system, Fraction(first["bound"]), P)
    for before in stages[:-1]:
        loop.stage(before)
    return independent_bootstrap.Region(loop, stages[-1]["region"])


def recorded(function):
    return json.loads(json.dumps(dataclasses.asdict(function)))


@pytest.mark.slow
def test_the_other_checker_finds_the_same_claims():
    for function in one_stage("example1").functions:
        claims = other_region().function(recorded(function))
        assert claims == [(c.error, c.side, Fraction(c.bound)) for c in function.claims]


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_refused_by_the_other_checker(name):
    function = changed(one_stage("example1").functions[0], name)
    with pytest.raises(independent_checker.Refused):
        other_region().function(recorded(function))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4])
def test_random_plants_of_low_order_keep_their_bound(seed):
    seeds = [s for s in range(40) if random_plant(s).plant.n <= 2]
    system = random_plant(seeds[seed])
    usual, _ = certify_bootstrap(system)
    certificate, stages = certify_bootstrap(system, "high")
    assert certificate.bound <= usual.bound
    assert certificate.bound >= certrack.simulate(system).metrics.tail_error
    document = json.loads(json.dumps(to_document(system, *stages)))
    assert verify(document).verified
    assert float(independent_checker.check(document)) >= certificate.bound * (1 - 1e-12)

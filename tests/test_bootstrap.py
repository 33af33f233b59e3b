"""The bootstrap of the adaptive law: its equations, its proofs, and what it must refuse."""

import copy
import json
import math
from functools import cache

import flint
import independent_checker
import numpy as np
import pytest
import sympy
from adaptive_plants import random_plant
from depth import depth

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.arithmetic import decimal, positive_definite, rational
from certrack.certificates.bootstrap.certify import certify_bootstrap
from certrack.certificates.bootstrap.check import bounds_error, claimed_bound
from certrack.certificates.bootstrap.document import bootstrap_stages
from certrack.certificates.bootstrap.forms import forms_of, scaled_ubar
from certrack.certificates.bootstrap.loop import adaptive_loop, formulas_of
from certrack.certificates.bootstrap.proof import proven_definite
from certrack.certificates.bootstrap.ranges import Combination, Ranges, largest_reach
from certrack.certificates.bootstrap.rates import Rate
from certrack.certificates.bootstrap.regions import box_of_states, rows_of
from certrack.certificates.exact import from_text
from certrack.certificates.layout import digest_of

#: A plant with a full Gamma, ranges of g_n < 0 and theta, feed-forward and a full regressor.
RANGED = """
[plant]
states = ["x1", "x2"]
chain = [1.3]
linear = [[-0.4]]
drift = "-0.3*x2 + 0.2*x1**2"
regressor = ["sin(x1)", "1 + x2/4"]
gain_sign = -1
[plant.ranges]
input_gain = [-1.6, -1.4]
theta = [[0.3, 0.5], [-0.4, -0.3]]
[plant.uncertainty]
tau = [0.05, 0.1]
gamma = [0.2, 0.3]
beta = [0.1, 0.2]
[truth]
input_gain = -1.5
theta = [0.4, -0.35]
omega = ["0.1*sin(t)", "0.2*cos(2*t) + 0.3*x2*sin(t)"]
[reference]
signal = "0.2*sin(t)"
[law]
kind = "adaptive"
c = [1.5, 2]
feedforward = 1
gain_rate = 0.8
leak_gain = 0.5
leak_theta = 0.4
delta0 = -0.6
theta0 = [0.3, -0.3]
Gamma = [[1.0, 0.3], [0.3, 0.7]]
[simulation]
x0 = [0.3, 0]
duration = 40
tail = 10
"""

#: The worst error of example1 that any search has found; no bound may be below.
WORST_OF_EXAMPLE1 = 0.04467


@cache
def proven_system(name):
    """A system, its certificate and the proof."""
    system = certrack.loads(RANGED) if name == "ranged" else certrack.load(name)
    return (system, *certify_bootstrap(system))


@pytest.fixture(params=["example1", "ranged"])
def proven(request):
    return proven_system(request.param)


class ErrorsByHand:
    """z = (e, theta_tilde, d), its rates and ubar at a state, from the plant's and law's formulas.

    The truth's g_n and theta are given; w_k are numbers.
    """

    def __init__(self, system, gain, theta):
        self.system, self.gain, self.theta = system, gain, np.array(theta)
        self.plant, c = system.plant, system.controller
        self.coordinates = c.coordinates
        gains = dict(zip(c.symbols, c.values.tolist(), strict=True))
        s = c.signals
        formulas = [c.equations.u, *(rate for _, rate in c.equations.update)]
        formulas = [f.xreplace(gains) for f in formulas]
        self.law = sympy.lambdify([s.x, s.Y, c.states], formulas, "math")
        values = {sympy.Symbol(k, real=True): v for k, v in self.plant.constant_values.items()}
        rest = [self.plant.drift.expr, *(phi.expr for phi in self.plant.regressor)]
        self.known = sympy.lambdify([s.x], [f.xreplace(values) for f in rest], "math")
        low = min(map(abs, self.plant.input_gain_range or (gain,)))
        self.v = math.sqrt(abs(gain) / low)

    def states(self, z, Y):
        """x and the estimates (delta_hat, theta_hat) of errors z."""
        n, r = self.plant.n, self.plant.r
        A, B = self.coordinates.A, self.coordinates.B
        x = np.linalg.solve(A, z[:n] + B @ Y[: B.shape[1]])
        return x, np.array([1 / self.gain - z[-1] / self.v, *(self.theta - z[n : n + r])])

    def rates(self, z, Y, w):
        """z', given y_d ... y_d^(q+1) and the values of tau_k w_k."""
        x, estimates = self.states(z, Y)
        plant, n = self.plant, self.plant.n
        u, delta_rate, *theta_rates = self.law(x, Y, estimates)
        h, *phi = self.known(x)
        rates = [
            float(plant.g[i]) * x[i + 1]
            + sum(float(b.expr if hasattr(b, "expr") else b) * x[j] for j, b in enumerate(row))
            for i, row in enumerate(plant.linear)
        ]
        rates.append(h + self.gain * u + self.theta @ np.array(phi))
        B = self.coordinates.B
        e = self.coordinates.A @ (np.array(rates) + w) - B @ Y[1 : B.shape[1] + 1]
        ubar = u / estimates[0]
        return np.array([*e, *(-v for v in theta_rates), -self.v * delta_rate])[: n + len(z)], ubar


def vector_of(system, hand, region, z, Y, w_parts):
    """w at a state, and which part of the way ubar is between its bounds, from the page."""
    loop = adaptive_loop(system).in_floats()
    numbers = region.numbers().in_floats()
    middle, radius = numbers.box.mean(axis=1), np.diff(numbers.box, axis=1)[:, 0] / 2
    x, _ = hand.states(z, Y)
    h, *phi = hand.known(x)
    a, b = w_parts
    n, r = loop.n, loop.r
    off = hand.theta - loop.theta_middle
    remainder = h - numbers.slope @ x + np.array(phi) @ off
    sizes = np.abs(numbers.regressor).max(axis=1, initial=0.0)
    spread = np.diff(numbers.drift)[0] / 2 + sizes @ loop.theta_radius
    zeta = (z - middle) / radius
    psi = []
    for i in range(r):
        low, high = numbers.regressor[i]
        if low != high:
            value = (phi[i] - (low + high) / 2) / ((high - low) / 2)
            psi += [value, value * zeta[n - 1], value * zeta[n + i]]
    ranged = [off[i] / v for i, v in enumerate(loop.theta_radius) if v > 0]
    rho = (remainder - numbers.drift.mean()) / spread
    y = [v / bound for v, bound in zip(Y, loop.Y, strict=True)]
    scale = []
    if loop.largest_scale > 1:
        end, v = loop.largest_scale, hand.v
        scale = [(2 / v - 1 - 1 / end) / (1 - 1 / end)]
        scale.append((1 + end - end / v - v) / ((end - 1) ** 2 / 8) - 1)
    return np.array([*zeta, 1.0, *(a / numbers.reach), *b, *y, rho, *ranged, *scale, *psi]), zeta


@pytest.mark.parametrize(
    "gain", [-1.47, *(pytest.param(gain, marks=pytest.mark.slow) for gain in (-1.6, -1.4))]
)
def test_equations_are_those_of_the_plant_and_the_law(gain):
    """zeta' = F w and the relation of ubar, at random states, against the law's own formulas."""
    rng = np.random.default_rng(3)
    system, _, (_, stage, *_) = proven_system("ranged")
    region, loop = stage.region, adaptive_loop(system)
    numbers = region.numbers()
    forms = forms_of(loop.in_floats(), numbers.in_floats())
    low, high = (float(v) for v in numbers.ubar(loop))
    u = system.plant.uncertainty
    for _ in range(20):
        theta = [rng.uniform(0.3, 0.5), rng.uniform(-0.4, -0.3)]
        hand = ErrorsByHand(system, gain, theta)
        z = rng.uniform(*numbers.box.astype(float).T)
        Y = rng.uniform(-1, 1, 3) * 0.2
        x, _ = hand.states(z, Y)
        a = rng.uniform(-1, 1, 2) * np.linalg.norm(x)
        b = rng.uniform(-1, 1, 2)
        tau, gamma, beta = (np.array(v, float) for v in (u.tau, u.gamma, u.beta))
        rates, ubar = hand.rates(z, Y, tau * (gamma * a + beta * b))
        w, _ = vector_of(system, hand, region, z, Y, (a, b))
        assert np.abs(w).max() <= 1 + 1e-9  # every entry is within its bound
        assert low <= ubar <= high
        first, second = forms.corners  # at the lower and the upper end of pi
        low, high = (float(v) for v in scaled_ubar(loop, numbers))
        part = (hand.v * ubar - low) / (high - low)
        F = (1 - part) * first.F + part * second.F
        relation = (1 - part) * first.relation + part * second.relation
        assert (F @ w) * forms.radius == pytest.approx(rates, abs=1e-9)
        assert relation @ w == pytest.approx(0, abs=1e-9)


def test_example1_is_tight_and_never_below_the_worst_found(proven):
    system, certificate, stages = proven
    assert certificate.verified
    if system.plant.input_gain_range is None:
        assert WORST_OF_EXAMPLE1 <= certificate.bound <= 0.0620
    assert certificate.bound >= certrack.simulate(system).metrics.tail_error
    document = json.loads(json.dumps(to_document(system, *stages)))
    assert from_text(document["claim"].split()[-1]) <= from_text(repr(certificate.bound))
    verdict = verify(document)
    assert (verdict.verified, verdict.reason) == (True, "")


def test_a_checker_that_shares_no_line_agrees(proven):
    system, certificate, stages = proven
    document = json.loads(json.dumps(to_document(system, *stages)))
    document["proof"] = (
        document["proof"][:2] if system.plant.input_gain_range else document["proof"]
    )
    document = claimed_again(document)
    assert verify(document).verified
    bound = independent_checker.check(document)
    assert float(bound) >= certificate.bound * (1 - 1e-12)


def claimed_again(document):
    """With the claim and the digest of its own proof."""
    text = claimed_bound(bootstrap_stages(document["proof"][1:]))
    document["claim"] = f"limsup |e_1(t)| <= {text}"
    document["sha256"] = digest_of(document)
    return document


def times(text, factor):
    return f"{float(text) * factor:.13g}"


def of_stage(*keys, change):
    """A mutant that changes one entry of the last stage but one."""

    def mutate(proof):
        record = proof[-2]
        for key in keys[:-1]:
            record = record[key]
        record[keys[-1]] = change(record[keys[-1]])

    return mutate


def narrower(pair):
    middle = (float(pair[0]) + float(pair[1])) / 2
    return [f"{middle + 0.9 * (float(v) - middle):.13g}" for v in pair]


def box_inside_of_what_is_known(proof):
    """A box that is not invariant: the last stage's, a little smaller, for the stage before."""
    proof[-2]["region"]["box"] = copy.deepcopy(proof[-1]["region"]["box"])


def negated(texts):
    largest = max(range(len(texts)), key=lambda i: abs(float(texts[i])))
    return [f"-{v}" if i == largest else v for i, v in enumerate(texts)]


def without_a_stage(proof):
    """Later boxes do not stand on the first one."""
    del proof[1]


def another_row(proof):
    """The bound of one error claimed of another."""
    for function in proof[-2]["functions"]:
        for claim in function["claims"]:
            claim["error"] = {0: 2, 1: 0}.get(claim["error"], claim["error"])


MUTANTS = {
    "bound of e_1": of_stage("functions", 0, "claims", 0, "bound", change=lambda v: times(v, 0.98)),
    "bound of e_n": of_stage("functions", 1, "claims", 1, "bound", change=lambda v: times(v, 0.95)),
    "scale": of_stage("functions", 1, "claims", 0, "scale", change=lambda v: times(v, 0.9)),
    "no scale": of_stage("functions", 1, "claims", 0, "scale", change=lambda v: "0"),
    "side": of_stage("functions", 1, "claims", 0, "side", change=lambda v: -v),
    "no side": of_stage("functions", 1, "claims", 0, "side", change=lambda v: 2),
    "alpha": of_stage("functions", 1, "alpha", change=lambda v: times(v, 1.5)),
    "alpha's sign": of_stage("functions", 1, "alpha", change=lambda v: f"-{v}"),
    "G": of_stage("functions", 1, "G", 0, 0, change=lambda v: times(v, 0.5)),
    "G not symmetric": of_stage("functions", 1, "G", 0, 1, change=lambda v: times(v, 1.001)),
    "sectors": of_stage("functions", 1, "sectors", change=negated),
    "inputs": of_stage("functions", 1, "inputs", change=negated),
    "squares": of_stage("functions", 1, "squares", change=lambda v: [f"-{u}" for u in v]),
    "mu": of_stage("functions", 1, "mu", change=lambda v: [f"{-float(u):.13g}" for u in v]),
    "scales": of_stage("functions", 1, "scales", change=negated),
    "turns": of_stage("functions", 1, "turns", change=lambda v: [f"{-float(u):.13g}" for u in v]),
    "fewer multipliers": of_stage("functions", 1, "inputs", change=lambda v: v[:-1]),
    "regressor": of_stage("region", "regressor", 0, change=narrower),
    "regressor as a constant": of_stage("region", "regressor", 0, change=lambda v: [v[0], v[0]]),
    "drift": of_stage("region", "drift", change=narrower),
    "remainder": of_stage("region", "remainder", change=narrower),
    "row": of_stage("region", "row", change=narrower),
    "reach": of_stage("region", "reach", 0, change=lambda v: times(v, 0.98)),
    "no reach": of_stage("region", "reach", 0, change=lambda v: "0"),
    "box of e_n": of_stage("region", "box", 1, change=narrower),
    "box of d": of_stage("region", "box", -1, change=narrower),
    "box that is not invariant": box_inside_of_what_is_known,
    "no first stage": without_a_stage,
    "another row": another_row,
    "first proof": lambda proof: proof[0].update(bound=times(proof[0]["bound"], 0.9)),
    "shift": lambda proof: proof[0].update(shift="0.1"),
}


@pytest.fixture(scope="module")
def document():
    system, _, stages = proven_system("example1")
    return json.loads(json.dumps(to_document(system, *stages)))


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_refused(document, name):
    mutant = copy.deepcopy(document)
    MUTANTS[name](mutant["proof"])
    mutant = claimed_again(mutant)
    assert not verify(mutant).verified


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_are_refused_by_the_other_checker(document, name):
    mutant = copy.deepcopy(document)
    MUTANTS[name](mutant["proof"])
    with pytest.raises((independent_checker.Refused, ZeroDivisionError)):
        independent_checker.check(claimed_again(mutant))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("tau = [0.1, 0.2]", "tau = [0.1, 0.25]"),
        ("gamma = [0.5, 0.2]", "gamma = [0.55, 0.2]"),
        ('signal = "0.2*cos(t)"', 'signal = "0.21*cos(t)"'),
        ("leak_theta = 0.6", "leak_theta = 0.5"),
        ("delta0 = 0.4", "delta0 = 0.3"),
        ("theta0 = [2.1]", "theta0 = [2.3]"),
        ("input_gain = 2.0", "input_gain = 2.1"),
        ('"x1**2*x2"', '"1.2*x1**2*x2"'),
        ('"1 + x1*sin(x2)"', '"1 + 1.1*x1*sin(x2)"'),
    ],
)
def test_another_system_with_the_same_proof_is_refused(document, old, new):
    mutant = copy.deepcopy(document)
    text = mutant["system"]
    assert old in text or old.replace(".0", "") in text, text
    mutant["system"] = (
        text.replace(old, new) if old in text else text.replace(old.replace(".0", ""), new)
    )
    mutant["sha256"] = digest_of(mutant)
    assert not verify(mutant).verified


def test_functions_fall_along_runs_that_are_in_the_box():
    """W' <= -alpha W along a run, once it is in the box, and W is not positive in the end."""
    system, _, (_, *stages) = proven_system("example1")
    system = system.with_settings(duration=60.0)
    loop = adaptive_loop(system)
    times = np.arange(0.0, 60.0, 0.002)
    states = certrack.simulate(system).trajectory.interpolate(times)
    Y = system.reference.values(times, 1)
    c, truth = system.controller.coordinates, system.truth
    e = c.A @ states[:2] - c.B @ Y[: c.B.shape[1]]
    theta, gain = decimal(truth.theta[0]), decimal(truth.input_gain)
    z = np.vstack([e, theta - states[3], 1 / gain - states[2]])
    fell = 0
    for stage in stages:
        box = stage.region.numbers().box.astype(float)
        inside = ((z >= box[:, :1]) & (z <= box[:, 1:])).all(axis=0)
        last = len(times) - int(np.argmin(inside[::-1]))  # from here on it is in the box
        assert last < 0.9 * len(times)
        zeta = (z - box.mean(axis=1)[:, None]) / (np.diff(box, axis=1) / 2)
        one = np.vstack([zeta, np.ones(len(times))])
        for function in stage.functions:
            G, alpha = function.unknowns().G.astype(float), float(function.alpha)
            W = np.einsum("it,ij,jt->t", one, G, one)[last:]
            rate = np.diff(W) / np.diff(times[last:])
            middle = (W[1:] + W[:-1]) / 2
            assert (rate <= -alpha * middle + 1e-5 * np.abs(G).max()).all()
            assert W[-1] <= 0
            fell += bool((W > 0).any())
        rows = rows_of(loop, stage.region.numbers())
        for claim in (claim for function in stage.functions for claim in function.claims):
            row = claim.side * rows[claim.error].astype(float)
            assert (row @ z)[-5000:].max() <= float(claim.bound)
    assert fell  # some of it began above


def test_ranges_hold_at_random_points_and_are_near_to_them(proven):
    system, _, (_, *stages) = proven
    rng = np.random.default_rng(5)
    loop, formulas = adaptive_loop(system), formulas_of(system)
    ranges, region = Ranges(formulas, loop), stages[0].region
    numbers = region.numbers()
    place = box_of_states(loop, numbers.box)
    through = np.hstack([loop.Xe, loop.AB]).astype(float)
    corners = rng.choice([0, 1], (4000, len(place)))
    points = np.vstack(
        [rng.uniform(*place.T, (4000, len(place))), place[np.arange(len(place)), corners]]
    )
    x = points @ through.T
    functions = sympy.lambdify([formulas.states], [formulas.drift, *formulas.regressor])
    h, *phi = (np.broadcast_to(v, len(x)) for v in functions(x.T))
    drift = h - x @ numbers.slope.astype(float)
    for values, (low, high) in zip([drift, *phi], [numbers.drift, *numbers.regressor], strict=True):
        width = float(high - low)
        assert float(low) <= values.min() <= float(low) + 0.15 * width
        assert float(high) - 0.15 * width <= values.max() <= float(high)
        chosen = Combination(
            (rational(1),) + (rational(0),) * loop.r, tuple(numbers.slope), rational(0)
        )
    assert ranges.within(chosen, place, *(float(v) for v in numbers.drift))
    low, high = (float(v) for v in numbers.drift)
    assert not ranges.within(chosen, place, low + 0.1 * (high - low), high)
    sizes = np.linalg.norm(x, axis=1).max()
    assert all(sizes <= reach <= 1.01 * sizes for reach in largest_reach(loop, place))


@pytest.mark.parametrize(
    "formula",
    [
        "atan2(x1, x2 - 9)",  # its cut is inside, and its slopes are bounded there
        "x2*atan2(x1 + 0.1, -4 - x1)",
        "sign(x1 + 0.02)",
        "abs(abs(x1) - 0.2)*x2",
        "max(x1, x2)*min(x1, 0.1)",
    ],
)
def test_ranges_hold_where_a_formula_jumps_or_has_a_kink(formula):
    text = RANGED.replace('"-0.3*x2 + 0.2*x1**2"', f'"{formula}"')
    system = certrack.loads(text)
    loop, formulas = adaptive_loop(system), formulas_of(system)
    ranges, one, zero = Ranges(formulas, loop), rational(1), rational(0)
    box = np.array([[-0.3, 0.31], [-0.4, 0.41], [-0.2, 0.2], [-0.2, 0.2]])
    drift = Combination((one, zero, zero), (zero, zero), zero)
    low, high = ranges.bounds(drift, box)
    points = np.random.default_rng(0).uniform(*box.T, (20_000, 4))
    x = points @ np.hstack([loop.Xe, loop.AB]).astype(float).T
    values = sympy.lambdify([formulas.states], formulas.drift)(x.T)
    assert low <= values.min()
    assert values.max() <= high
    narrow = 0.9 * (values.max() - values.min()) / 2
    middle = (values.max() + values.min()) / 2
    assert not ranges.within(drift, box, middle - narrow, middle + narrow)


FORGED = {
    "no pair": (("region", "remainder"), lambda v: [*v, "1"]),
    "one end": (("region", "row"), lambda v: v[:1]),
    "inputs beyond floats": (("functions", 0, "inputs", 0), lambda _: "1e390"),
    "G beyond floats": (("functions", 0, "G", 0, 0), lambda _: "1e390"),
    "row beyond floats": (("region", "row"), lambda v: [v[0], "1e390"]),
    "box beyond floats": (("region", "box", 0), lambda v: [v[0], "1e390"]),
}


@pytest.mark.parametrize("name", FORGED)
def test_forged_numbers_are_refused_in_one_line(document, name):
    mutant = copy.deepcopy(document)
    keys, change = FORGED[name]
    of_stage(*keys, change=change)(mutant["proof"])
    mutant["sha256"] = digest_of(mutant)
    try:
        assert not verify(mutant).verified
    except certrack.InputError as problem:
        assert "proof" in str(problem)


def test_definiteness_is_that_of_exact_factorisation():
    rng = np.random.default_rng(2)
    for _ in range(30):
        A = rng.integers(-9, 10, (5, 5))
        matrix = A @ A.T
        shift = int(rng.integers(-3, 4))
        exact = np.array(
            [[flint.fmpq(int(v)) for v in row] for row in matrix + shift * np.eye(5, dtype=int)]
        )
        assert proven_definite(exact) == positive_definite(exact)
    singular = np.array([[flint.fmpq(1), flint.fmpq(1)], [flint.fmpq(1), flint.fmpq(1)]])
    assert not proven_definite(singular)


def test_a_rate_surrounds_the_best_and_comes_near():
    rate = Rate(0.01)
    for _ in range(14):
        rate.met(math.log(rate.alpha / 3.0))
    assert rate._below is not None and rate._above is not None
    assert rate.alpha == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("start", [0.01, 0.3, 8.0])
def test_a_rate_goes_both_ways_where_there_is_no_bound(start):
    """Bounds from 0.5 to 5, the best at 1: it is looked for above and below the start."""
    rate, tried = Rate(start), []
    for _ in range(20):
        tried.append(rate.alpha)
        rate.met(math.log(rate.alpha) if 0.5 <= rate.alpha <= 5 else None)
    assert rate.surrounded
    assert rate.alpha == pytest.approx(1.0, rel=0.05)
    assert sum(not 0.5 <= alpha <= 5 for alpha in tried) < 10


def test_a_rate_that_never_finds_a_bound_leaves_no_side_out():
    rate, tried = Rate(1.0), []
    for _ in range(9):
        tried.append(rate.alpha)
        rate.met(None)
    assert sorted(tried) == pytest.approx([2.5**k for k in range(-4, 5)])
    assert not rate.surrounded


def test_what_has_no_bootstrap_says_why():
    robust, _ = certify_bootstrap(certrack.load("dual-motor-lean"))
    assert "adaptive law" in robust.reason
    fast, proof = certify_bootstrap(certrack.load("example1"), "fast")
    assert "takes more time" in fast.reason
    assert proof == ()


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(5, 40)))
def test_random_plants_keep_their_bound_and_both_checkers_agree(seed):
    system = random_plant(seed)
    certificate, stages = certify_bootstrap(system)
    if not stages:
        assert certificate.reason
        return
    assert certificate.verified
    assert certificate.bound >= certrack.simulate(system).metrics.tail_error
    document = json.loads(json.dumps(to_document(system, *stages)))
    assert verify(document).verified
    enough = next(k for k in range(2, len(stages) + 1) if bounds_error(stages[1:k]))
    document["proof"] = document["proof"][:enough]  # of the later ones each takes as long
    bound = independent_checker.check(claimed_again(document))
    assert float(bound) >= certificate.bound * (1 - 1e-12)

"""The linear law: lean backstepping as a case of it, LQR weights, certificates, and refusals.

With it what every design prints: the cost it is optimal for, and its margins.
"""

import hashlib
import json
import math
from dataclasses import replace

import independent_checker
import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

import certrack
from certrack import Linear, Robust
from certrack.certificates.arithmetic import rational
from certrack.certificates.document import to_document
from certrack.certificates.formulation import error_coordinates
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.methods import certify_peak, certify_semidefinite
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.verification import verify
from certrack.core.errors import DesignError, InputError
from certrack.laws.cost import freed_loop, optimal_cost
from certrack.laws.integral import longer_chain, of_the_chain
from certrack.laws.loop_margins import loop_margins
from certrack.laws.lqr import LqrWeights
from certrack.laws.recursion import recursion
from certrack.model.implementation import Implementation
from certrack.testing import LawConformance

LEAN = certrack.load("dual-motor-lean")
LINEAR = certrack.load("dual-motor-linear")


class TestLinear(LawConformance):
    """Two states, a regressor, q below n - 1, and r of its own."""

    system = certrack.load("example1").replace(
        plant=replace(certrack.load("example1").plant, input_gain=2, theta=[2]),
        law=Linear(K=(-6, -5), r=1.2),
    )


@pytest.mark.slow
class TestFromWeights(LawConformance):
    system = LEAN.replace(law=Linear(lqr={"error": 400}, feedforward=1))


def as_linear(law, plant):
    """The K and r that a lean law is."""
    design = law.coordinates(plant)
    return Linear(
        K=tuple(design.nu_x.tolist()), r=float(design.nu_Y[-1]), feedforward=law.feedforward
    )


@pytest.mark.parametrize("q", range(4))
def test_every_lean_law_is_a_linear_one(q):
    lean = Robust(c=(6, 5, 4, 7), feedforward=q)
    linear = as_linear(lean, LEAN.plant)
    first, second = (law.coordinates(LEAN.plant) for law in (lean, linear))
    np.testing.assert_allclose(np.linalg.solve(first.A, first.B), second.B, atol=1e-12)
    np.testing.assert_allclose(second.nu_Y, first.nu_Y, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(np.linalg.solve(first.A, first.R), second.R, atol=1e-9)
    np.testing.assert_allclose(np.poly(first.poles), np.poly(second.poles), rtol=1e-8)


def test_the_bound_does_not_depend_on_the_coordinates():
    linear = LEAN.replace(law=as_linear(LEAN.law, LEAN.plant))
    for method in (certify_semidefinite, certify_peak):
        first, second = (method(system)[0] for system in (LEAN, linear))
        assert second.verified
        assert second.bound == pytest.approx(first.bound, rel=1e-4)


def test_the_shipped_one_is_tighter_at_no_larger_peak_of_the_box_and_no_shorter_period():
    bound = certify_semidefinite(LINEAR)[0].bound
    assert bound <= 0.0012
    assert bound < 0.76 * certify_semidefinite(LEAN)[0].bound
    assert box_peak(LINEAR) <= 39.1
    assert box_peak(LEAN) == pytest.approx(39.02, abs=0.05)
    for system in (LINEAR, LEAN):
        assert sampled_radius(system, 0.087) < 1


SLOPES, GAIN = np.array([30.0, 0, -30, 0]), 20.0


def feedback(system):
    return (system.controller.coordinates.nu_x - SLOPES) / GAIN


def box_peak(system):
    """Largest |u| from the starts [-1, 1]^4 without w: |u of the centre| + sum_j |k e^(M t)|_j."""
    design = system.controller.coordinates
    t = np.linspace(0, 4, 2001)
    centre = certrack.simulate(
        system.with_settings(x0=(0, 0, 0, 0), duration=4, tail=None).replace(
            truth=replace(system.truth, omega=None)
        )
    )
    u = np.abs(np.interp(t, centre.t, centre.u))
    A = np.vstack([design.F, design.nu_x])
    poles, V = np.linalg.eig(A)
    rows = (feedback(system) @ V)[:, None] * np.exp(np.outer(poles, t))
    return (u + np.abs((rows.T @ np.linalg.inv(V)).real).sum(axis=1)).max()


def sampled_radius(system, T):
    """Spectral radius of the nominal loop, held for T."""
    design = system.controller.coordinates
    block = np.zeros((5, 5))
    block[:4, :4], block[3, 4] = np.vstack([design.F, SLOPES]), GAIN
    step = expm(block * T)
    return np.abs(np.linalg.eigvals(step[:4, :4] + np.outer(step[:4, 4], feedback(system)))).max()


@pytest.mark.parametrize("q", [0, 1, 2, 3])
def test_a_constant_residual_moves_the_output_by_nothing_without_r(q):
    law = Linear(K=(-88, -219, -436, -20.85), feedforward=q)
    design = law.coordinates(LEAN.plant)
    moved = np.linalg.solve(design.error_matrix, design.R)[0]
    assert abs(moved) < 1e-10
    other = replace(law, r=1.0).coordinates(LEAN.plant)
    assert abs(np.linalg.solve(other.error_matrix, other.R)[0]) > 1e-4


def test_weights_give_the_gain_of_another_solver():
    control = pytest.importorskip("control")
    weights = LqrWeights((400, 2, 0, 1), 3)
    system = LEAN.replace(law=Linear(lqr={"error": [400, 2, 0, 1], "input": 3}, feedforward=1))
    design = system.controller.coordinates
    A, b = np.vstack([design.F, np.zeros(4)]), np.array([[0.0], [0], [0], [GAIN]])
    K, _, _ = control.lqr(A, b, np.diag(weights.diagonal(4)), [[3.0]])
    np.testing.assert_allclose(-K[0] * GAIN, design.nu_x, rtol=1e-8)


def random_design(seed, n, q):
    rng = np.random.default_rng(seed)
    g = rng.uniform(0.4, 2, n - 1) * rng.choice([-1, 1], n - 1)
    b = np.tril(rng.normal(size=(n - 1, n)))
    return recursion(g, b, certrack.laws.backstepping.Gains(tuple(rng.uniform(0.5, 4, n))), q)


@pytest.mark.parametrize("n", range(1, 7))
def test_a_lean_law_solves_the_riccati_equation_of_its_cost(n):
    design = random_design(n, n, 0)
    cost = optimal_cost(Robust(c=tuple(design.c)), LEAN.plant, design)
    M, k = freed_loop(design)
    last = np.eye(n)[:, -1:]
    X = solve_continuous_are(M, last, np.diag(cost.state), [[cost.input]])
    np.testing.assert_allclose(X, np.eye(n), atol=1e-8)
    np.testing.assert_allclose(X[-1] / cost.input, k, atol=1e-7)
    other = replace(cost, input=2 * cost.input)
    wrong = solve_continuous_are(M, last, np.diag(other.state), [[other.input]])
    assert np.abs(wrong - np.eye(n)).max() > 1e-3


@pytest.mark.parametrize("n", range(1, 9))
def test_the_cost_of_random_lean_laws_is_that_of_their_riccati_equation_to_rounding(n):
    """X = I, so J* = |e(0)|^2: in error coordinates, and as A^T A in those of the plant."""
    for seed in range(20):
        design = random_design(100 * n + seed, n, seed % n)
        cost = optimal_cost(Robust(c=tuple(design.c)), LEAN.plant, design)
        M, k = freed_loop(design)
        last = np.eye(n)[:, -1:]
        residual = M.T + M - last @ last.T / cost.input + np.diag(cost.state)
        size = np.abs(design.error_matrix).max()
        assert np.abs(residual).max() < 1e-12 * size
        assert np.abs(last[:, 0] / cost.input - k).max() < 1e-12 * size
        A = design.A
        F = np.linalg.solve(A, M @ A)  # of x - x_d
        X, through = A.T @ A, A.T @ last
        terms = F.T @ X, X @ F, through @ through.T / cost.input, cost.of_states
        in_plant = terms[0] + terms[1] - terms[2] + terms[3]
        assert np.abs(in_plant).max() < 1e-12 * n * max(np.abs(term).max() for term in terms)


@pytest.mark.parametrize("name", ["dual-motor-lean", "point-to-point", "example1"])
def test_the_cost_of_a_lean_law_is_exact_in_rationals(name):
    """M + M^T = -2 diag(c + kappa): with X = I all that is asked of the cost."""
    design = error_coordinates(certrack.load(name), rational)
    decay = design.c + design.kappa
    symmetric = design.error_matrix + design.error_matrix.T
    for i, j in np.ndindex(symmetric.shape):
        assert symmetric[i, j] == (-2 * decay[i] if i == j else 0)


def test_a_balanced_design_has_its_cost_in_its_own_units():
    system = certrack.load("flexible-joint")
    law = replace(system.law, coupling=0.5)
    design = law.coordinates(system.plant)
    cost = optimal_cost(law, system.plant, design)
    M, k = freed_loop(design)
    X = np.diag(design.weights.astype(float) ** 2)
    last = np.eye(design.n)[:, -1:]
    residual = M.T @ X + X @ M - X @ last @ last.T @ X / cost.input + np.diag(cost.state)
    assert np.abs(residual).max() < 1e-9 * np.abs(M.T @ X).max()
    np.testing.assert_allclose(X[-1] / cost.input, k, rtol=1e-9)


@pytest.mark.parametrize("n", range(1, 6))
def test_margins_are_those_of_python_control(n):
    control = pytest.importorskip("control")
    rng = np.random.default_rng(n)
    for _ in range(6):
        A = rng.normal(size=(n, n)) * 3
        k = rng.normal(size=n)
        b = np.eye(n)[:, -1]
        closed = A - np.outer(b, k)
        A = A - (np.linalg.eigvals(closed).real.max() + 0.3) * np.eye(n)
        found = loop_margins(A, b, k)
        loop = control.ss(A, b[:, None], k[None], 0)
        gains, phases, *_ = control.stability_margins(loop, returnall=True)
        inside = [v for v in np.atleast_1d(gains) if 1e-6 < v < 1]
        above = [v for v in np.atleast_1d(gains) if 1 < v < 1e6]
        assert found.lowest_gain == pytest.approx(max(inside, default=0.0), rel=1e-6, abs=1e-9)
        assert found.highest_gain == pytest.approx(min(above, default=math.inf), rel=1e-6)
        angles = [abs(math.remainder(v, 360)) for v in np.atleast_1d(phases)]
        assert found.phase == pytest.approx(min(angles, default=math.inf), rel=1e-6)


@pytest.mark.parametrize("name", ["dual-motor-lean", "example1", "flexible-joint"])
def test_backstepping_keeps_the_margins_of_a_regulator_at_v(name):
    margins = certrack.load(name).design().optimality.at_v
    assert margins.lowest_gain <= 0.5
    assert margins.highest_gain == math.inf
    assert margins.phase >= 60


def test_margins_at_the_input_end_where_the_loop_does():
    """A factor at u just inside the gain margin leaves the loop stable, one outside does not."""
    margins = LINEAR.design().optimality.at_u
    design = LINEAR.controller.coordinates
    plant = np.vstack([design.F, SLOPES])
    for factor, stable in ((1.001, True), (0.999, False)):
        loop = plant.copy()
        loop[-1] += margins.lowest_gain * factor * GAIN * feedback(LINEAR)
        assert (np.linalg.eigvals(loop).real.max() < 0) == stable


def test_the_design_prints_them():
    text, record = str(LEAN.design()), LEAN.design().summary()
    assert "12 e_1^2 + 12 e_2^2 + 12 e_3^2 + 6 e_4^2 + 0.1667 v^2" in text
    assert "margins at v, what the law adds to the last e': gain 0 to inf" in text
    assert "margins at u, the input of the plant: gain 0.2578 to inf, phase 58.06 degrees" in text
    assert "degrees (of" not in text
    sampled = str(certrack.load("dual-motor-drive").design())
    assert sampled.count("degrees (of the continuous law)") == sampled.count("margins at ") > 0
    A = np.array(record["A"])
    expected = A.T @ np.diag([12, 12, 12, 6]) @ A
    np.testing.assert_allclose(record["cost"]["of_states"], expected)
    assert LINEAR.design().summary()["cost"] is None
    of_weights = LEAN.replace(law=Linear(lqr={"error": 4, "input": 2})).design().optimality.cost
    np.testing.assert_allclose(of_weights.state, [4, 0, 0, 0])
    assert of_weights.input == 2 / GAIN**2


def test_a_certificate_holds_the_numbers_that_the_weights_gave():
    system = LEAN.replace(law=Linear(lqr={"error": 400}, feedforward=1))
    certificate, proof = certify_semidefinite(system)
    document = to_document(system, proof)
    assert "lqr" not in document["system"]
    assert verify(document).verified
    assert float(independent_checker.check(document)) <= certificate.bound
    forged = json.loads(json.dumps(document))
    law = system.law.settled(system.plant)
    forged["system"] = forged["system"].replace(f"{law.K[0]}", f"{0.5 * law.K[0]}")
    assert forged["system"] != document["system"]
    body = {key: value for key, value in forged.items() if key != "sha256"}
    forged["sha256"] = hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()
    assert not verify(forged).verified
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(forged)


@pytest.mark.parametrize("q", [0, 1, 3])
def test_exact_coordinates_are_those_of_the_controller(q):
    system = LEAN.replace(law=Linear(K=("-88", -219, -436, -20.85), feedforward=q, r=3.5))
    exact, floats = error_coordinates(system, rational), system.controller.coordinates
    for name in ("A", "B", "nu_x", "nu_Y", "R", "error_matrix"):
        numbers = np.array(getattr(exact, name)).astype(float)
        np.testing.assert_allclose(numbers, getattr(floats, name), rtol=1e-12, atol=1e-12)
    follow = exact.F @ exact.B  # the states that B tells do follow: F_i Pi Y = (Pi_i Y)'
    for i in range(3):
        assert list(follow[i][1:]) == list(exact.B[i][:-1])
        assert follow[i][0] == 0


@pytest.mark.slow
def test_the_falsifier_stays_below_and_near():
    found = certrack.falsify(LINEAR, budget=300, seed=0)
    assert 0.5 < found.worst_error / certify_peak(LINEAR)[0].bound <= 1


def test_the_loop_as_implemented_has_its_certificate():
    system = LINEAR.replace(implementation=Implementation(period=0.01))
    certificate, _ = certify_implemented(system)
    assert certificate.verified, certificate.reason
    run = certrack.simulate(system)
    assert run.metrics.tail_error <= certificate.bound


@pytest.mark.slow
def test_ranges_are_covered():
    plant = replace(LEAN.plant, input_gain_range=(18, 22))
    ranged = certify_ranges(LEAN.replace(plant=plant, law=LINEAR.law))
    assert ranged.best.verified
    nominal = certify_peak(LINEAR)[0].bound
    assert nominal < ranged.best.bound < 10 * nominal


@pytest.mark.slow
def test_margins_of_the_implementation_and_exports(tmp_path):
    system = certrack.load("dual-motor-drive").replace(law=LINEAR.law)
    found = certrack.margins(system)
    assert found.period.exact > system.implementation.period
    certrack.export_fmu(system, tmp_path / "linear.fmu")


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ("K = [-88, -219, -436]", r"law\.K: must be a list of 4"),
        ("K = [88, 219, 436, 20.85]", r"law\.K: .*Reverse its signs"),
        ("K = [0, 0, 0, 0]", r"law\.K: .*pole"),
        ("K = [-88, -219, -436, -20.85]\nlqr = {error = 1}", r"law\.K: must be left out"),
        ("r = 1", r"law\.K: is missing"),
        ("lqr = {error = 0}", r"law\.lqr\.error: must be positive"),
        ("lqr = {error = [0, 0, 0, 0]}", r"law\.lqr\.error: must not be all zero"),
        ("lqr = {error = [1, 2]}", r"law\.lqr\.error: must be a number or 4 numbers"),
        ("lqr = {error = 1, input = 0}", r"law\.lqr\.input: must be positive"),
        ("lqr = {input = 1}", r"law\.lqr.*error"),
        ("lqr = {error = 1, speed = 2}", r"law\.lqr.*speed"),
        ("lqr = 3", r"law\.lqr"),
        ("c = [1, 1, 1, 1]", r"law\.c: is not a key of the linear law"),
        ("lqr = {error = 1}\nfeedforward = 4", r"law\.feedforward"),
    ],
)
def test_bad_keys_are_refused_in_one_line(law, message):
    text = certrack.to_text(LINEAR)
    begin, end = text.index("[law]"), text.index("[simulation]")
    with pytest.raises(InputError, match=message) as refused:
        certrack.loads(f'{text[:begin]}[law]\nkind = "linear"\n{law}\n\n{text[end:]}')
    assert "\n" not in str(refused.value)


def test_an_unknown_input_gain_is_refused():
    plant = replace(LEAN.plant, input_gain=None)
    with pytest.raises(DesignError, match="the linear law must know g_n"):
        LINEAR.replace(plant=plant)


def test_a_law_that_changes_its_coordinates_has_no_certificate():
    class Bent(Linear):
        def coordinates(self, plant):
            return replace(super().coordinates(plant), nu_x=2 * super().coordinates(plant).nu_x)

    system = LEAN.replace(law=Bent(K=LINEAR.law.K, r=33.7, feedforward=1))
    certificate, proof = certify_semidefinite(system)
    assert not certificate.verified
    assert proof is None
    assert "nu_x is not that" in certificate.reason


def test_there_is_no_gain_of_the_recursion():
    with pytest.raises(DesignError, match="no gains of the recursion"):
        LINEAR.law.gains()
    assert "linear law" in certrack.certify(LINEAR, effort="fast").published.reason


@pytest.mark.parametrize("coupling", [None, 0.5])
def test_integral_action_has_the_cost_and_margins_of_the_longer_chain(coupling):
    law = Robust(c=(5, 6, 7, 8), feedforward=1, integral=4, coupling=coupling)
    system = LEAN.replace(law=law)
    design, shown = system.controller.coordinates, system.design()
    longer = of_the_chain(design)
    chain = longer_chain(design.g, LEAN.plant.b, np.array(law.c), law.integral)
    gains = certrack.laws.backstepping.Gains(tuple(chain[2]), coupling=coupling)
    expected = recursion(*chain[:2], gains, 2)
    for name in ("A", "B", "F", "c", "kappa", "g", "nu_x", "nu_Y"):
        np.testing.assert_allclose(getattr(longer, name), getattr(expected, name), rtol=1e-9)
    M, k = freed_loop(longer)
    cost = shown.optimality.cost
    weights = np.ones(5) if coupling is None else longer.weights.astype(float) ** 2
    X, last = np.diag(weights), np.eye(5)[:, -1:]
    residual = M.T @ X + X @ M - X @ last @ last.T @ X / cost.input + np.diag(cost.state)
    assert np.abs(residual).max() < 1e-9 * np.abs(M.T @ X).max()
    np.testing.assert_allclose(X[-1] / cost.input, k, rtol=1e-9)
    assert "e_0^2 + " in str(shown) and "what the law adds to e_4' besides" in str(shown)
    assert "in (e_0, x - x_d) the weights" in str(shown)
    found = shown.optimality.at_u
    plant = np.vstack([longer.F, np.insert(SLOPES, 0, 0.0)])
    feedback = plant[-1] - longer.nu_x  # u = -k x of the whole input
    for factor, stable in ((1.001, True), (0.999, False)):
        loop = plant.copy()
        loop[-1] -= found.lowest_gain * factor * feedback
        assert (np.linalg.eigvals(loop).real.max() < 0) == stable


@pytest.mark.parametrize(
    ("law", "key"),
    [
        ({"coupling": 1e-320}, "law.coupling"),
        ({"coupling": 1e299}, "law.coupling"),
        ({"coupling": 0.5, "c": (1e-300,) * 4}, "law.coupling"),
        ({"integral": 1e299}, "law.c"),
    ],
)
def test_a_design_beyond_floats_is_refused(law, key):
    with pytest.raises(certrack.DesignError) as refusal:
        LEAN.replace(law=Robust(**{"c": (6, 6, 6, 6), **law})).design()
    assert refusal.value.key == key


@pytest.mark.filterwarnings("error")
def test_weights_that_differ_too_much_are_refused_without_a_warning():
    for weights in ({"error": 1e300, "input": 1e-300}, {"error": 1e-300, "input": 1e300}):
        with pytest.raises(certrack.DesignError, match=r"law\.(K|lqr)"):
            LEAN.replace(law=Linear(lqr=weights)).design()


def test_a_loop_without_feedback_has_all_margins():
    A, b = np.array([[0.0, 1.0], [-2.0, -3.0]]), np.array([0.0, 1.0])
    margins = loop_margins(A, b, np.zeros(2))
    assert (margins.lowest_gain, margins.highest_gain) == (0.0, np.inf)
    assert margins.phase == np.inf

"""Certificates: the table, soundness, exactness, tampering."""

import copy
import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import cvxpy
import flint
import numpy as np
import pytest
from conftest import systems
from depth import depth
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import certrack
from certrack.certificates import (
    best_sound_bound,
    certify,
    certify_semidefinite,
    save_certificate,
    to_document,
)
from certrack.certificates.arithmetic import decimal, positive_definite, rational
from certrack.certificates.cascade import certify_cascade, check_cascade
from certrack.certificates.exact import Proof, failed_condition, float_up, from_text, prove, root_up
from certrack.certificates.formulation import error_problem
from certrack.certificates.layout import digest_of
from certrack.certificates.methods import NOMINAL_KINDS
from certrack.certificates.published import certify_published, collect, critical_strength
from certrack.certificates.semidefinite import SemidefiniteProgram, best_solution
from certrack.certificates.verification import verify
from certrack.core.errors import InputError
from certrack.laws import Robust
from certrack.model.plant import Plant
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references import SymbolicReference
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.falsify import falsify
from certrack.systems.reader import loads
from certrack.systems.system import Settings, System

# Computed beside this project, to the digits given; docs/certificates.md has more digits of some.
CLASSICAL = {
    "example1": (0.262, 0.371, 0.262),
    "dual-motor": (0.222, 0.222, 0.222),
    "dual-motor-strong": (2.19, 2.19, 2.19),
}
LEAN = {
    ((4, 4, 4, 4), 0, "dual-motor"): 0.0239,
    ((10, 6, 6, 6), 0, "dual-motor"): 0.0149,
    ((4, 4, 4, 4), 1, "dual-motor"): 0.00223,
    ((6, 6, 6, 6), 1, "dual-motor"): 0.00154,
    ((6, 6, 6, 6), 3, "dual-motor"): 0.00035,
    ((6, 6, 6, 6), 1, "dual-motor-strong"): 0.00302,
}
TIGHT = {"example1": 0.136, "dual-motor": 0.0267, "dual-motor-strong": 0.0270}


def lean(c, q, base="dual-motor"):
    return certrack.load(base).replace(law=Robust(c=c, feedforward=q))


@pytest.mark.parametrize("name", CLASSICAL)
def test_classical_bounds_equal_the_table(name):
    found = certify_published(certrack.load(name))
    bounds = [found[kind].bound for kind in ("published", "corrected", "rate")]
    assert bounds == pytest.approx(CLASSICAL[name], rel=3e-3)


def test_critical_strengths_equal_the_table():
    assert critical_strength(certrack.load("example1")) == pytest.approx(4.30, abs=5e-3)
    assert critical_strength(certrack.load("dual-motor")) == pytest.approx(5.10, abs=5e-3)


@pytest.mark.parametrize("name", TIGHT)
def test_semidefinite_bounds_are_no_looser_than_the_table(name):
    found, proof = certify_semidefinite(certrack.load(name))
    assert found.verified
    assert proof is not None
    assert found.bound <= 1.01 * TIGHT[name]


@pytest.mark.parametrize("case", LEAN, ids=str)
def test_lean_bounds_are_no_looser_than_the_table(case):
    found, _ = certify_semidefinite(lean(*case))
    assert found.verified
    assert found.bound <= 1.015 * LEAN[case]  # the table has two or three digits


def test_tight_bound_is_between_simulation_and_rate(shipped):
    found = certify(shipped, "fast")
    if not found.best.exists:
        assert "without leakage" in found.semidefinite.reason
        return
    if shipped.plant.constant_ranges:  # the nominal loop is not what is certified
        assert not found.semidefinite.exists
        assert found.best.bound >= simulate(shipped).metrics.tail_error
        return
    assert found.semidefinite.bound <= found.rate.bound
    assert found.semidefinite.bound >= simulate(shipped).metrics.tail_error
    assert found.critical_semidefinite >= max(1.0, found.critical_published)


@given(
    st.lists(st.floats(0.05, 20), min_size=4, max_size=4),
    st.floats(0.1, 10),
    st.floats(-2, 2),
    st.floats(1e-3, 3),
)
def test_rate_is_never_above_corrected_at_any_eps(rates, gain, delta0, eps):
    """alpha >= rho1/rho2, so the corrected step implies the rate form, not the other way."""
    gbar, gbar1, gbar2, Gamma = rates
    system = certrack.load("example1")
    law = replace(
        system.law,
        gain_rate=gbar,
        leak_gain=gbar1,
        leak_theta=gbar2,
        Gamma=(Gamma,),
        delta0=delta0,
    )
    truth = replace(system.truth, input_gain=gain)
    terms = collect(system.replace(law=law, truth=truth))
    assume(terms.mu1(eps) > 0)
    assert terms.alpha(eps) >= terms.rho1(eps) / terms.rho2() * (1 - 1e-12)
    assert terms.rho2() >= 0.5


def test_modelling_layer_finds_the_same_optimum():
    """The program written again in cvxpy, from the inequality of docs/certificates.md."""
    system = certrack.load("dual-motor")
    p = error_problem(system, decimal)
    ours = SemidefiniteProgram(p).solve(3.5)
    n, (na, nb, ny) = p.n, p.counts
    P = cvxpy.Variable((n, n), symmetric=True)
    lam, nu, k = (cvxpy.Variable(c, nonneg=True) for c in (na, nb, ny))
    E = np.eye(n, n + na + nb + ny)
    X = np.hstack([p.Xe, np.zeros((n, na + nb)), p.Xy])
    rate = np.hstack([p.M, p.Ua, p.Ub, p.Uy])
    form = E.T @ P @ rate
    Q = (form + form.T) / 2 + 3.5 / 2 * E.T @ P @ E + cvxpy.sum(lam) * X.T @ X
    diagonal = cvxpy.hstack([np.zeros(n), lam, nu, k])
    Q = Q - cvxpy.diag(diagonal)
    floor = np.zeros((n, n))
    floor[0, 0] = 1
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum(nu) + cvxpy.sum(k)), [Q << 0, P - floor >> 0])
    problem.solve(solver=cvxpy.CLARABEL)
    assert ours.delta == pytest.approx(problem.value, rel=1e-4)


@pytest.mark.parametrize("name", ["example1", "dual-motor", "theorem1-counterexample"])
def test_the_designs_own_multipliers_prove_the_rate_form_without_a_solver(name, monkeypatch):
    module = sys.modules["certrack.certificates.search.best_proof"]
    monkeypatch.setattr(module, "riccati_optimum", lambda *_, **__: None)
    monkeypatch.setattr(module, "best_by_slope", lambda *_: None)
    system = certrack.load(name)
    found, proof = certify_semidefinite(system)
    assert found.verified
    assert failed_condition(error_problem(system, rational), proof) == ""
    assert found.bound <= certify_published(system)["rate"].bound * (1 + 1e-4)


def test_damping_terms_of_any_size_are_proven():
    """kappa_5 = 2e30: the solver sees nothing but it."""
    n, k = 5, 0.5
    plant = Plant(states=[f"x{i + 1}" for i in range(n)], chain=[1] * (n - 1), input_gain=1)
    damping = {"k": [[k] * (2 * m) for m in range(1, n + 1)], "p": [k] * (n - 1)}
    law, start = Robust(c=[1.3] * n, **damping), Settings([0] * n, 1)
    system = System(plant, law, SymbolicReference("0.3*cos(t)"), Truth(1), start)
    found, _ = certify_semidefinite(system)
    assert found.verified
    assert found.bound <= certify_published(system)["rate"].bound


def test_inequality_is_the_derivative_of_v():
    """z^T Q z equals V' + alpha V/… evaluated term by term, at random points, exactly."""
    system = certrack.load("dual-motor-lean")
    p = error_problem(system, rational)
    rng = np.random.default_rng(3)

    def draw(*shape):
        values = rng.integers(-9, 10, shape)
        return np.vectorize(lambda v: flint.fmpq(int(v), 4), otypes=[object])(values)

    n, (na, nb, ny) = p.n, p.counts
    P = draw(n, n)
    P = P + P.T
    lam, nu, k = np.abs(draw(na)), np.abs(draw(nb)), np.abs(draw(ny))
    alpha = flint.fmpq(3, 7)
    Q = p.inequality(P, lam, nu, k, alpha)
    for _ in range(5):
        e, a, b, y = draw(n), draw(na), draw(nb), draw(ny)
        z = np.concatenate([e, a, b, y])
        rate = p.M @ e + p.Ua @ a + p.Ub @ b + p.Uy @ y
        x = p.Xe @ e + p.Xy @ y
        expected = e @ P @ rate + alpha / 2 * (e @ P @ e) + (lam * (x @ x - a**2)).sum()
        expected -= (nu * b**2).sum() + (k * y**2).sum()
        assert z @ Q @ z == expected


def test_exact_definiteness():
    def matrix(rows):
        return np.array([[flint.fmpq(v) for v in row] for row in rows], dtype=object)

    assert positive_definite(matrix([[2, 1], [1, 2]]))
    assert not positive_definite(matrix([[1, 1], [1, 1]]))
    assert not positive_definite(matrix([[1, 2], [2, 1]]))
    assert not positive_definite(matrix([[-1]]))
    nearly = matrix([[1, 1], [1, 1]])
    nearly[1, 1] += flint.fmpq(1, 10**40)  # no float could tell
    assert positive_definite(nearly)


MUTANTS = {
    "P smaller": lambda p: replace(p, P=scaled_rows(p.P, 0.99)),
    "P larger": lambda p: replace(p, P=scaled_rows(p.P, 1.01)),
    "nu smaller": lambda p: replace(p, nu=scaled(p.nu, 0.99)),
    "k smaller": lambda p: replace(p, k=scaled(p.k, 0.99)),
    "lam smaller": lambda p: replace(p, lam=scaled(p.lam, 0.99)),
    "alpha smaller": lambda p: replace(p, alpha=scaled([p.alpha], 0.99)[0]),
    "alpha larger": lambda p: replace(p, alpha=scaled([p.alpha], 1.01)[0]),
    "bound smaller": lambda p: replace(p, bound=scaled([p.bound], 0.99)[0]),
    "negative multiplier": lambda p: replace(p, lam=scaled(p.lam, -1)),
    "negative alpha": lambda p: replace(p, alpha=scaled([p.alpha], -1)[0]),
    "multiplier missing": lambda p: replace(p, nu=()),
    "P not symmetric": lambda p: replace(
        p, P=(*p.P[:-1], (*scaled(p.P[-1][:1], 1.001), *p.P[-1][1:]))
    ),
}


def scaled(values, factor):
    return tuple(f"{float(v) * factor:.15g}" for v in values)


def scaled_rows(rows, factor):
    return tuple(scaled(row, factor) for row in rows)


@pytest.mark.parametrize("name", ["dual-motor", "dual-motor-lean", "dual-motor-strong"])
@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutated_proofs_are_refused(name, mutant):
    system = certrack.load(name)
    _, proof = certify_semidefinite(system)
    problem = error_problem(system, rational)
    assert failed_condition(problem, proof) == ""
    assert failed_condition(problem, MUTANTS[mutant](proof)) != ""


def test_mutated_adaptive_proofs_are_refused():
    system = certrack.load("example1")
    _, proof = certify_semidefinite(system)
    problem = error_problem(system, rational)
    for name in ("P smaller", "alpha smaller", "bound smaller", "k smaller", "nu smaller"):
        assert failed_condition(problem, MUTANTS[name](proof)) != "", name
    coupled = [list(row) for row in proof.P]
    coupled[0][1] = coupled[1][0] = "0.001"
    assert "update laws" in failed_condition(problem, replace(proof, P=tuple(map(tuple, coupled))))


def test_wrong_sign_in_the_inequality_is_caught_by_the_exact_check(monkeypatch):
    system = certrack.load("dual-motor-lean")
    exact = error_problem(system, rational)
    wrong = replace(exact.in_floats(), M=-exact.in_floats().M - 20 * np.eye(4))
    found = best_solution(SemidefiniteProgram(wrong))
    assert found is not None  # the wrong program has a solution ...
    assert prove(exact, found) is None  # ... that exact arithmetic refuses
    flipped = replace(exact.in_floats(), Uy=0 * exact.in_floats().Uy)
    found = best_solution(SemidefiniteProgram(flipped))
    assert (
        found is None or prove(exact, found) is None or (float(prove(exact, found).bound) >= 0.0015)
    )


def test_too_strong_uncertainty_has_no_certificate_and_says_so():
    base = certrack.load("dual-motor-lean")
    u = base.plant.uncertainty
    strong = Uncertainty(tuple(1e3 * v for v in u.tau), u.gamma, u.beta)
    system = base.replace(plant=replace(base.plant, uncertainty=strong), truth=Truth(20.0))
    found, proof = certify_semidefinite(system)
    assert proof is None
    assert not found.exists
    assert "lower tau" in found.reason


def test_critical_strength_separates_provable_from_not():
    system = certrack.load("example1")
    critical = certify(system).critical_semidefinite
    u = system.plant.uncertainty

    def exists(scale):
        scaled_tau = Uncertainty(tuple(scale * v for v in u.tau), u.gamma, u.beta)
        plant = replace(system.plant, uncertainty=scaled_tau)
        return certify_semidefinite(system.replace(plant=plant))[0].exists

    assert exists(0.98 * critical)
    assert not exists(1.05 * critical)


def ranged(gain, theta):
    system = certrack.load("example1")
    plant = replace(system.plant, input_gain_range=gain, theta_range=theta)
    return system.replace(plant=plant)


def test_ranges_take_their_worst_corner():
    point, _ = certify_semidefinite(certrack.load("example1"))
    degenerate, _ = certify_semidefinite(ranged((2.0, 2.0), ((2.0, 2.0),)))
    assert degenerate.bound == pytest.approx(point.bound, rel=1e-6)
    wide, _ = certify_semidefinite(ranged((1.5, 2.5), ((1.5, 2.5),)))
    assert wide.bound > point.bound
    problem = error_problem(ranged((1.5, 2.5), ((1.5, 2.5),)), decimal)
    q = problem.leakage(0.5)
    for g in np.linspace(1.5, 2.5, 11):
        for theta in np.linspace(1.5, 2.5, 11):
            system = certrack.load("example1")
            at = system.replace(truth=replace(system.truth, input_gain=g, theta=(theta,)))
            assert error_problem(at, decimal).leakage(0.5) <= q * (1 + 1e-12)
    assert any("every g_n in [1.5, 2.5]" in text for text in wide.assumptions)


def test_many_parameters_need_no_enumeration():
    r = 40
    plant = Plant(
        states=["x1"],
        regressor=[f"sin({i}*x1)" for i in range(1, r + 1)],
        theta_range=[(-1, 1)] * r,
        input_gain_range=(1, 2),
    )
    law = certrack.Adaptive(c=[2], leak_gain=1, leak_theta=1, Gamma=[5.0] * r, delta0=0.75)
    system = System(
        plant, law, SymbolicReference("cos(t)"), Truth(1.5, (0.5,) * r), Settings([0], 10)
    )
    found, _ = certify_semidefinite(system)
    assert found.verified
    full = replace(law, Gamma=np.full((r, r), 0.1) + 5 * np.eye(r))
    refused, _ = certify_semidefinite(system.replace(law=full))
    assert "diagonal Gamma" in refused.reason


def test_full_gamma_equals_diagonal_where_it_is_diagonal():
    system = ranged((1.5, 2.5), ((1.5, 2.5),))
    full = system.replace(law=replace(system.law, Gamma=((1.0,),)))
    a, b = (certify_semidefinite(s)[0].bound for s in (system, full))
    assert a == pytest.approx(b, rel=1e-9)


def test_robust_law_with_ranges_is_refused_with_the_reason():
    base = certrack.load("dual-motor-lean")
    system = base.replace(plant=replace(base.plant, input_gain_range=(10, 30)))
    found, _ = certify_semidefinite(system)
    assert found.reason.startswith("plant.ranges lets input_gain vary: only vertices, cells and")


def test_a_law_with_other_equations_is_refused():
    """The certificate is of the robust law's equations, not of what is derived from the class."""

    @dataclass(frozen=True, kw_only=True)
    class Halved(Robust):
        def equations(self, s):
            equations = super().equations(s)
            return replace(equations, u=equations.u / 2)

    system = certrack.load("dual-motor-lean").replace(law=Halved(c=(6, 6, 6, 6), feedforward=1))
    found = certify(system)
    assert not found.best.exists
    assert "not Halved" in found.semidefinite.reason


@pytest.mark.slow
@settings(max_examples=depth(6, 100))
@given(systems(orders=st.integers(1, 4), kinds=("adaptive", "robust")))
def test_falsified_error_never_exceeds_the_certificate(system):
    """Random plants and designs, hunted: the bound must hold."""
    bound = best_sound_bound(system)
    assume(math.isfinite(bound))
    hunted = falsify(system, budget=400)
    assert hunted.alarm != "defect"
    if hunted.own_run:  # it may be short: what it says of a bound in the long run is the tube's
        return
    integration_error = 100 * hunted.system.settings.tolerance  # the bound may be exactly zero
    assert hunted.worst_error <= bound + integration_error


@pytest.mark.parametrize("name", ["example1", "dual-motor", "dual-motor-lean"])
def test_falsifier_comes_close_and_never_beats_the_certificate(name, tmp_path):
    system = certrack.load(name)
    hunted = falsify(system, budget=1500)
    assert hunted.worst_error <= best_sound_bound(system)
    assert hunted.worst_error > simulate(system).metrics.tail_error  # worse than the file's omega
    path = tmp_path / "worst.toml"
    certrack.save(hunted.system, path)
    assert simulate(certrack.load(path)).metrics.tail_error == hunted.worst_error
    assert not certrack.check_assumption_1(hunted.system)
    Y = system.reference.bounds(system.controller.coordinates.q + 1).values
    t = np.linspace(0, 60, 20_001)
    reached = np.abs(hunted.system.reference.values(t, len(Y) - 1)).max(axis=1)
    assert np.all(reached <= np.array(Y) * (1 + 1e-9))


def test_assumption_1_violations_are_reported_with_a_point():
    base = certrack.load("example1")
    assert certrack.check_assumption_1(base) == []
    wild = base.replace(truth=replace(base.truth, omega=("0.6*x1", base.truth.omega[1])))
    (found,) = certrack.check_assumption_1(wild)
    assert found.term == "w_1"
    assert found.value > found.limit
    assert "raise gamma" in str(found)
    late = base.replace(truth=replace(base.truth, omega=("0", "0.11/(1 + t)")))
    (found,) = certrack.check_assumption_1(late)
    assert found.t < 2.3


@pytest.mark.parametrize("name", ["example1", "dual-motor", "dual-motor-lean"])
def test_tube_holds_for_runs_from_the_start_and_from_a_box(name):
    system = certrack.load(name)
    found = certify(system)
    run = simulate(system)
    assert np.all(np.abs(run.e[0]) <= found.tube(run.t))
    assert found.tube(1e6) == pytest.approx(float(found.quadratic[-1].bound), rel=1e-9)
    box = [(v - 0.3, v + 0.3) for v in system.settings.x0]
    wide = certrack.certificates.tube(system, found.quadratic, box)
    rng = np.random.default_rng(0)
    for _ in range(5):
        x0 = [rng.uniform(*pair) for pair in box]
        run = simulate(system, x0=x0)
        assert np.all(np.abs(run.e[0]) <= wide(run.t))
    level = 2 * found.best.bound
    settled = found.tube.settling_time(level)
    assert found.tube(settled) <= level * (1 + 1e-9)
    assert math.isinf(found.tube.settling_time(0.9 * found.best.bound))


def test_saved_certificate_is_verified_and_tampering_refused(tmp_path):
    system = certrack.load("dual-motor-lean")
    _, proof = certify_semidefinite(system)
    path = tmp_path / "cert.json"
    save_certificate(system, [proof], path)
    assert verify(path).verified
    document = to_document(system, proof)
    changes = {
        "bound": lambda d: d["proof"][0].update(bound="1e-9"),
        "P": lambda d: d["proof"][0]["P"][0].__setitem__(0, "2"),
        "stage": lambda d: d["proof"].append(d["proof"][0]),
        "system": lambda d: d.update(system=d["system"].replace("0.01", "0.02")),
        "claim": lambda d: d.update(claim="limsup |e_1(t)| <= 0"),
        "premises": lambda d: d.update(premises=[]),
        "a premise left out": lambda d: d["premises"].pop(0),
        "a status": lambda d: d["premises"][0].update(status="assumed"),
        "a detail": lambda d: d["premises"][3].update(detail="tau |w_2| = 0"),
        "a shift that no stage uses": lambda d: d["proof"][0].update(shift="1"),
        "made_by": lambda d: d.update(made_by="someone"),
    }
    for name, change in changes.items():
        tampered = copy.deepcopy(document)
        change(tampered)
        assert not verify(tampered).verified, name
        if name != "made_by":
            tampered["sha256"] = digest_of(tampered)  # the forger knows the digest too
            assert not verify(tampered).verified, name


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{}", "nonsense", '{"format": 1}', "[" * 100_000, "null", '{"a": NaN}'],
)
def test_what_is_no_certificate_is_our_error(content, tmp_path):
    path = tmp_path / "cert.json"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        verify(path)
    assert "\n" not in str(caught.value)


def test_malformed_proofs_are_our_error():
    system = certrack.load("dual-motor-lean")
    document = to_document(system, certify_semidefinite(system)[1])
    for key, value in (
        ("alpha", "1e999999999"),
        ("alpha", 1.0),
        ("alpha", "nan"),
        ("alpha", "__import__"),
        ("P", "no"),
        ("P", [1]),
        ("nu", None),
    ):
        bad = json.loads(json.dumps(document))
        bad["proof"][0][key] = value
        with pytest.raises(InputError):
            verify(bad)


def test_cascade_is_tighter_sound_and_verified(tmp_path):
    system = certrack.load("example1")
    found = certify(system)
    assert found.cascade.verified
    assert found.best is found.bootstrap and found.bootstrap.bound < found.cascade.bound
    assert found.cascade.bound <= 0.0787
    for stages in (found.stages, found.cascade_proof):
        save_certificate(system, stages, tmp_path / "cert.json")
        assert verify(tmp_path / "cert.json").verified
    problem = error_problem(system, rational)
    reached, centred, first = found.cascade_proof
    assert check_cascade(system, problem, found.cascade_proof) == ""
    assert check_cascade(system, problem, (reached, first)) != ""  # the middle stage is needed
    for mutant in ("P smaller", "alpha smaller", "bound smaller", "k smaller"):
        for place in range(3):
            stages = list(found.cascade_proof)
            stages[place] = MUTANTS[mutant](stages[place])
            assert check_cascade(system, problem, stages) != "", (mutant, place)
    shifted = replace(centred, shift="0.0")
    assert check_cascade(system, problem, (reached, shifted, first)) != ""
    run = simulate(system, duration=60)  # the middle stage bounds e_2
    assert np.abs(run.e[1][run.t > 40]).max() <= float(centred.bound)


def test_centred_energy_falls_as_proven_on_the_worst_run_found():
    """V' <= -alpha V + Delta with V centred by kappa, differentiated along a hostile run."""
    system = certrack.load("example1")
    _, (_, centred, _) = certify_cascade(system)
    worst = falsify(system, budget=600).system
    run = simulate(worst, tolerance=1e-12)
    kappa, alpha = float(centred.shift), float(centred.alpha)
    P = np.array(centred.P, dtype=float)
    delta = float(centred.bound) ** 2 * alpha / 2
    t = np.linspace(worst.settings.tail, worst.settings.duration - 0.1, 4001)

    def energy(t):
        states = run.trajectory.interpolate(t)
        found = system.controller.coordinates
        e = found.A @ states[:2] - found.B @ worst.reference.values(t, 0)
        about_delta = (1 - kappa) / 2.0 - states[2]
        about_theta = (1 + kappa) * 2.0 - states[3]
        estimates = 2.0 * about_delta**2 / 2 + about_theta**2 / 2  # g = 2, gbar = Gamma = 1
        return ((P @ e) * e).sum(axis=0) / 2 + P[-1, -1] * estimates

    h = 1e-4
    slope = (energy(t + h) - energy(t - h)) / (2 * h)
    assert np.all(slope <= -alpha * energy(t) + delta + 1e-6)
    assert np.all(energy(t) <= delta / alpha)


def test_cascade_is_for_the_adaptive_law():
    assert "adaptive law" in certify(certrack.load("dual-motor")).cascade.reason


def test_proof_survives_json():
    system = certrack.load("example1")
    proof = certify_semidefinite(system)[1]
    assert isinstance(proof, Proof)
    document = json.loads(json.dumps(to_document(system, proof)))
    assert verify(document).verified


#: What is measured on it here stays measured: the gains of `certrack new` may change.
STARTER = (Path(__file__).parent / "data" / "starter.toml").read_text()


@pytest.mark.slow
def test_tenth_order_plant_is_certified():
    n = 10
    plant = Plant(
        states=[f"x{i}" for i in range(1, n + 1)],
        chain=[1] * (n - 1),
        input_gain=1,
        uncertainty=Uncertainty([0] * (n - 1) + [0.1], [1e-3] * n, [0.1] * n),
    )
    system = System(
        plant,
        Robust(c=[3] * n, feedforward=1),
        SymbolicReference("0.2*cos(t)"),
        Truth(1),
        Settings([0] * n, 1),
    )
    found, _ = certify_semidefinite(system)
    assert found.verified


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "leak"), [(0.01, 100.0), (0.001, 1000.0), (0.01, 1000.0)])
def test_critical_strength_is_at_least_the_certified_one(rate, leak):
    """Gains of very different size, whose program the solver gives up at other scales."""
    text = STARTER.replace("gain_rate = 1.0", f"gain_rate = {rate}")
    text = text.replace("leak_gain = 0.1", f"leak_gain = {leak}")
    text = text.replace("c = [5, 5]", "c = [40, 40]").replace("Gamma = [1.0]", "Gamma = [1000.0]")
    text = text.replace("leak_theta = 0.1", "leak_theta = 0.01")
    found = certify(loads(text))
    assert found.semidefinite.verified
    assert found.critical_semidefinite >= 1.0


@given(st.integers(1, 10**40), st.integers(1, 10**40), st.integers(-600, 600))
def test_roots_are_rounded_up_at_any_magnitude(p, q, decade):
    square = flint.fmpq(p, q) * flint.fmpq(10) ** decade
    root = from_text(root_up(square))
    assert square <= root * root <= square * (1 + flint.fmpq(3, 10**12)) ** 2


def test_floats_beyond_the_largest_are_infinite():
    assert float_up(flint.fmpq(10) ** 400) == math.inf


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    "change",
    [
        {"beta": 1e8},
        {"beta": 1e200},
        {"gamma": 1e200},
        {"leak_gain": 1e-10},
        {"Gamma": (1e-12,)},
        {"Gamma": (1e30,)},
        {"signal": "1e16*cos(t)"},
        {"signal": "1e200*cos(t)"},
    ],
)
def test_extreme_numbers_end_in_a_bound_or_a_reason(change):
    (name, value), system = *change.items(), certrack.load("example1")
    if name == "signal":
        system = system.replace(reference=SymbolicReference(value))
    elif name in ("beta", "gamma"):
        bounds = replace(system.plant.uncertainty, **{name: (0.0, value)})
        system = system.replace(plant=replace(system.plant, uncertainty=bounds))
    else:
        system = system.replace(law=replace(system.law, **{name: value}))
    found = certrack.certify(system)
    for kind in NOMINAL_KINDS:
        one = getattr(found, kind)
        assert one.exists != bool(one.reason)

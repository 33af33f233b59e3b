"""Peak gains of a loop without ranges: exact cases, kernel attacks, mutants, the command line."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import certrack
from certrack.certificates import certify_peak, to_document, verify
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.formulation import error_problem
from certrack.certificates.layout import digest_of
from certrack.certificates.methods import FAST_PEAK_ORDER, NOMINAL_KINDS, every_certificate
from certrack.certificates.ranges.kernels import peak_gains
from certrack.cli import main
from certrack.model.plant import Plant
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.systems.system import Settings, System


def loop(c, *, beta, gamma=None, q=None, signal="0.1*sin(t)", truth=None):
    """A chain of integrators under the robust law without damping terms."""
    n = len(c)
    gamma = gamma or [0] * n
    plant = Plant(
        states=[f"x{i + 1}" for i in range(n)],
        chain=[1] * (n - 1),
        input_gain=1,
        uncertainty=Uncertainty(tau=[1] * n, gamma=gamma, beta=beta),
    )
    law = certrack.Robust(c=c, feedforward=n - 1 if q is None else q)
    start = Settings([0] * n, 40, tail=1)
    return System(plant, law, certrack.SymbolicReference(signal), truth or Truth(1), start)


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("dual-motor-lean", 0.00129),
        ("dual-motor", 0.0269),
        ("dual-motor-strong", 0.02744),
        pytest.param("dual-motor-drive", 0.00129, marks=pytest.mark.slow),
    ],
)
def test_shipped_loops_are_certified_tighter_and_verified(name, limit):
    system = certrack.load(name)
    found = certrack.certify(system)
    assert found.peak.verified and found.peak.bound <= limit
    document = json.loads(json.dumps(to_document(system, *certify_peak(system)[1])))
    verdict = verify(document)
    assert verdict.verified and found.peak.bound == float_up(from_text(verdict.bound))
    if system.implementation is None:
        assert found.best.bound == min(found.peak.bound, found.semidefinite.bound)
    else:
        assert found.best is found.implemented  # the others speak of the continuous law
    assert to_document(system, *found.stages)["claim"].endswith(f"<= {verdict.bound}") == (
        found.best.kind == "peak"
    )


def test_first_order_is_exact():
    found, _ = certify_peak(loop([2.0], beta=[0.1]))
    assert 0.05 <= found.bound <= 0.05 * (1 + 2e-6)


@pytest.mark.parametrize("c", [0.05, 0.5, 2.0, 7.0])
def test_second_order_is_exact(c):
    """The kernel of w_2 is e^(-ct) sin t, whose absolute value has a known integral."""
    found, _ = certify_peak(loop([c, c], beta=[0, 0.1]))
    exact = 0.1 / (math.tanh(c * math.pi / 2) * (1 + c**2))
    assert exact <= found.bound <= exact * (1 + 5e-5)


def test_the_norm_of_the_states_is_a_fixed_point():
    """n = 1, q = 0: |e| <= (g |x| + b)/c with |x| <= |e| + Y_0, beside the static reference."""
    c, g, b, Y = 2.0, 0.3, 0.1, 0.1
    found, _ = certify_peak(loop([c], beta=[b], gamma=[g], signal=f"{Y}*sin(t)"))
    exact = (g * Y + b) / (c - g)
    assert exact <= found.bound <= exact * (1 + 1e-5)
    none, proof = certify_peak(loop([c], beta=[b], gamma=[2.001]))
    assert not none.exists and proof == () and "not below 1" in none.reason


def test_what_no_proof_uses_is_not_asked_for():
    """A ramp has no Y_0; without a term that grows with the state nobody needs it."""
    ramp = loop([2.0, 2.0], beta=[0, 0.1], q=1, signal="t")
    assert certify_peak(ramp)[0].verified
    with pytest.raises(certrack.InputError, match="Y_0"):
        certify_peak(loop([2.0, 2.0], beta=[0, 0.1], gamma=[0, 0.01], q=1, signal="t"))


def test_where_nothing_acts_the_decay_is_proven_all_the_same():
    still = loop([2.0, 2.0], beta=[0, 0])
    assert 0 <= certify_peak(still)[0].bound < 1e-12
    with pytest.raises(NoCertificate, match="not stable"):
        peak_gains(
            np.array([[rational(1)]]), np.array([[rational(1)]]), np.zeros((1, 0), dtype=object)
        )


def test_the_adaptive_law_has_none():
    found = certrack.certify(certrack.load("example1"))
    assert not found.peak.exists and "robust law" in found.peak.reason
    assert found.best.kind == "bootstrap"


def test_fast_leaves_out_what_takes_long(monkeypatch):
    system = certrack.load("dual-motor-lean")
    assert system.plant.n <= FAST_PEAK_ORDER
    monkeypatch.setattr("certrack.certificates.methods.FAST_PEAK_ORDER", 3)
    assert "--effort default" in certify_peak(system, "fast")[0].reason
    assert certify_peak(system)[0].verified


def test_every_method_is_listed_once():
    found = every_certificate(certrack.load("dual-motor-lean"))
    assert found.kinds == NOMINAL_KINDS and set(NOMINAL_KINDS) < set(found.certificates)
    assert found.best.kind == "peak"
    assert certrack.certificates.best_sound_bound(certrack.load("dual-motor-lean")) == (
        found.best.bound
    )
    ranged = every_certificate(certrack.load("axis"))
    assert ranged.kinds == ("vertices", "peak", "cells") and ranged.best.kind == "cells"


# ---- files ---------------------------------------------------------------------------------------


def signed(body):
    return body | {"sha256": digest_of(body)}


MUTANTS = {
    "smaller bound": lambda b: b["proof"][0].update(bound="0.001287"),
    "smallest change": lambda b: b["proof"][0].update(
        bound=f"{float(b['proof'][0]['bound']) * (1 - 3e-6):.12g}"
    ),
    "a range that is none": lambda b: b["proof"][0].update(cell=[["0", "1"]]),
    "stronger uncertainty": lambda b: b.update(
        system=b["system"].replace("0.0, 0.1]", "0.0, 0.1001]")
    ),
    "weaker gains": lambda b: b.update(system=b["system"].replace("c = [6.0, ", "c = [5.99, ")),
    "larger reference": lambda b: b.update(
        system=b["system"].replace("0.1*sin(0.75*t)", "0.1001*sin(0.75*t)")
    ),
    "larger norm": lambda b: b.update(
        system=b["system"].replace("gamma = [0.0, 0.01,", "gamma = [0.0, 0.0101,")
    ),
}


@pytest.fixture(scope="module")
def document():
    system = certrack.load("dual-motor-lean")
    return to_document(system, *certify_peak(system)[1])


@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutants_are_refused(mutant, document):
    body = json.loads(json.dumps(document))
    before = json.dumps(body)
    MUTANTS[mutant](body)
    body["claim"] = f"limsup |e_1(t)| <= {body['proof'][0]['bound']}"
    assert json.dumps(body) != before
    assert not verify(signed(body)).verified


def test_a_larger_bound_holds(document):
    body = json.loads(json.dumps(document))
    body["proof"][0]["bound"] = "0.0013"
    body["claim"] = "limsup |e_1(t)| <= 0.0013"
    assert verify(signed(body)).verified


def test_peak_gains_prove_nothing_of_the_adaptive_law(document):
    body = json.loads(json.dumps(document))
    body["system"] = certrack.to_text(certrack.load("example1"))
    verdict = verify(signed(body))
    assert not verdict.verified and "estimates" in verdict.reason


def test_command_line(capsys, tmp_path):
    path = tmp_path / "peak.json"
    with pytest.raises(SystemExit, match="0"):
        main(["certify", "dual-motor-lean", "--out", str(path), "--json"])
    shown = json.loads(capsys.readouterr().out)
    assert shown["best"]["method"] == "peak" and shown["peak"]["verified"]
    assert shown["peak"]["alpha"] is None and shown["tube"]["kind"] == "semidefinite"
    with pytest.raises(SystemExit, match="0"):
        main(["verify", str(path), "--json"])
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["bound"] == "0.00128736737046"
    assert shown["best"]["starts"] == verdict["starts"] == "every start"


# ---- attacks -------------------------------------------------------------------------------------


def kernel(system, horizon, count):
    """c e^(Mt) b of e_1 for each w_k, and the times."""
    problem = error_problem(system, rational).in_floats()
    t = np.linspace(0, horizon, count)
    one = expm(problem.M * (t[1] - t[0]))
    rows, row = [], np.eye(len(problem.M))[0]
    for _ in t:
        rows.append(row)
        row = row @ one
    return t, np.array(rows)


def attack(system, horizon=30.0):
    """Largest |e_1| at the horizon under w_k = beta_k sign(kernel), by the ordinary simulation."""
    u, n = system.plant.uncertainty, system.plant.n
    A = system.controller.coordinates.A
    t, rows = kernel(system, horizon, 30_001)
    omega = []
    for k in range(n):
        values = rows @ A[:, k]
        switches = t[1:][np.diff(np.sign(values)) != 0]
        switches = switches[(switches > 0) & (switches < 12)]  # what is older hardly counts
        factors = "*".join(f"sign({horizon} - t - {s:.6f})" for s in switches) or "1"
        norm = "sqrt(" + " + ".join(f"x{i + 1}**2" for i in range(n)) + ")"
        first = 1 if values[1] > 0 else -1
        size = f"({u.gamma[k]!r}*{norm} + {u.beta[k]!r})" if u.gamma[k] else f"{u.beta[k]!r}"
        omega.append(f"{first}*{size}*{factors}")
    case = system.replace(truth=Truth(1, omega=omega)).with_settings(duration=horizon, tail=0.5)
    run = certrack.simulate(case, tolerance=1e-9)
    return float(np.abs(run.e[0][run.t > horizon - 0.5]).max())


@pytest.mark.parametrize("c", [[1.0, 1.5], [0.4, 0.4], [2.0, 3.0, 4.0]])
def test_the_worst_disturbance_reaches_the_bound_and_not_more(c):
    n = len(c)
    system = loop(c, beta=[0.1 * (k + 1 == n) for k in range(n)])
    reached, bound = attack(system), certify_peak(system)[0].bound
    assert 0.9 * bound <= reached <= bound


def test_the_worst_disturbance_that_grows_with_the_state_stays_below():
    system = loop([2.0, 3.0], beta=[0, 0.1], gamma=[0, 0.2])
    reached, bound = attack(system), certify_peak(system)[0].bound
    assert 0.5 * bound <= reached <= bound


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(0.3, 8).map(lambda v: round(v, 2)), min_size=1, max_size=5),
    st.integers(0, 4),
    st.data(),
)
def test_no_bound_is_below_the_integral_of_its_kernels(c, q, data):
    """Against float quadrature on a fine grid, whose own error is allowed for."""
    n = len(c)
    beta = [data.draw(st.sampled_from([0, 0.1, 1.0])) for _ in range(n)]
    q = min(q, n - 1)
    system = loop(c, beta=beta, q=q, signal="0.3*sin(2*t)")
    found, _ = certify_peak(system)
    problem = error_problem(system, rational).in_floats()
    horizon = 16 / -np.linalg.eigvals(problem.M).real.max()
    step = min(horizon / 4000, 0.02 / np.abs(problem.M).max())
    t, rows = kernel(system, horizon, int(horizon / step))
    gains = np.trapezoid(np.abs(rows @ problem.Ub), t, axis=0).sum()
    # of all references one sine, in the long run, with its own phase
    response = (
        np.linalg.solve(2j * np.eye(n) - problem.M, problem.Uy[:, -1:])
        if len(problem.Uy.T)
        else np.zeros((n, 1))
    )
    assert found.verified
    assert found.bound >= (gains + abs(response[0, 0])) * (1 - 1e-3)


def test_a_premise_that_is_broken_is_no_bound():
    system = certrack.load("dual-motor-lean")
    broken = system.replace(truth=replace(system.truth, omega=("0", "0", "0", "0.2")))
    found = certrack.certify(broken)
    assert not found.peak.verified and not found.stages

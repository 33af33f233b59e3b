"""Bounds on the input: energy, root mean square, peak and long run."""

from dataclasses import replace

import numpy as np
import pytest
from test_certificates import MUTANTS, scaled, scaled_rows

import certrack
from certrack.certificates import certify_input, certify_semidefinite, tube
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.input_bounds import InputBound, failed_input
from certrack.certificates.input_problem import input_problem
from certrack.certificates.mean_squares import mean_squares
from certrack.core.errors import InputError
from certrack.references import SoftStart
from certrack.reports.input_bounds import bounds_of_input, input_lines
from certrack.simulation.simulator import simulate

BOX = ((-1.0, 1.0),) * 4


def lean(q=1, c=6.0):
    base = certrack.load("dual-motor-lean")
    return base.replace(law=certrack.Robust(c=(c,) * 4, feedforward=q))


def test_lean_designs_have_bounds_near_their_runs():
    for system in (lean(), lean(q=3), lean(c=4.0)):
        found, run = certify_input(system), simulate(system).metrics
        assert run.input_energy <= found.energy.bound <= 1.2 * run.input_energy
        assert run.peak_input <= found.peak.bound <= 1.05 * run.peak_input
        assert failed_input(system, found) == ""
    assert certify_input(lean()).energy.bound == pytest.approx(10.61, abs=0.01)
    assert certify_input(lean()).peak.bound == pytest.approx(13.89, abs=0.01)


@pytest.mark.slow
def test_the_worst_corner_of_a_box_is_below_its_peak():
    """u is linear in x(0): with w = 0 the largest peak of a box is at a corner."""
    system = lean()
    found = certify_input(system, BOX)
    worst = 0.0
    for corner in np.array(np.meshgrid(*[[-1.0, 1.0]] * 4)).reshape(4, -1).T[:8]:
        for start in (corner, -corner):
            run = simulate(system.with_settings(x0=tuple(start.tolist()), duration=3.0))
            worst = max(worst, run.metrics.peak_input)
            assert run.metrics.input_energy <= found.energy.bound
    assert worst == pytest.approx(39.0, abs=0.3)
    assert worst <= found.peak.bound <= 1.02 * worst


def hostile(system, rng):
    """The system with disturbances at their bounds, with signs that follow states and time."""
    norm = "sqrt(x1**2 + x2**2 + x3**2 + x4**2)"
    v = rng.normal(size=(2, 4)).round(3)
    w = rng.uniform(0.3, 12, 2).round(3)
    feedback = [" + ".join(f"({a})*x{i + 1}" for i, a in enumerate(row)) for row in v]
    signs = [f"tanh(30*(sin({a}*t) + {f}))" for a, f in zip(w, feedback, strict=True)]
    omega = ("0", f"0.01*{norm}*{signs[0]}", "0", f"(0.01*{norm} + 0.1)*{signs[1]}")
    return system.replace(truth=certrack.Truth(system.truth.input_gain, omega=omega))


@pytest.mark.slow
def test_hostile_runs_stay_below_the_bounds():
    system, rng = lean(), np.random.default_rng(0)
    found = certify_input(system)
    late = 0.0
    for _ in range(3):
        run = simulate(hostile(system, rng))
        assert run.metrics.input_energy <= found.energy.bound
        assert run.metrics.peak_input <= found.peak.bound
        late = max(late, float(np.abs(run.u[run.t > 10]).max()))
    assert 0.01 < late <= found.ultimate.bound


@pytest.mark.parametrize("name", ["energy", "peak"])
def test_the_inequality_holds_at_random_points(name):
    """V' + u^2 <= sum nu b^2 + sum k y^2, and V' <= -alpha V + Delta, by the numbers of a proof."""
    system = lean()
    exact, proof = input_problem(system).in_floats(), getattr(certify_input(system), name).proof
    problem, rng = exact.problem, np.random.default_rng(0)
    P, nu, k = (np.array(part, dtype=float) for part in (proof.P, proof.nu, proof.k))
    alpha, na, nb = float(proof.alpha), *problem.counts[:2]

    def excess(share):
        worst = -np.inf
        for _ in range(800):
            e = rng.normal(size=4) * 10.0 ** rng.uniform(-4, 1)
            y = rng.choice([-1.0, 1.0], problem.counts[2])
            b = rng.choice([-1.0, 1.0], nb)
            x = problem.Xe @ e + problem.Xy @ y
            a = np.sign(problem.Ua.T @ P @ e) * np.linalg.norm(x)
            assert len(a) == na
            V_dot = e @ P @ (problem.M @ e + problem.Ua @ a + problem.Ub @ b + problem.Uy @ y)
            u = exact.row @ e + exact.through_y @ y
            used = share * (nu.sum() + k.sum())
            left = V_dot + (u**2 if name == "energy" else alpha * e @ P @ e / 2) - used
            worst = max(worst, left / used)
        return worst

    assert excess(1.0) <= 1e-9
    assert excess(0.0001) > 0


@pytest.fixture(scope="module")
def of_lean():
    return certify_input(lean())


CHANGES = MUTANTS | {
    "nu smaller": lambda p: replace(p, nu=scaled(p.nu, 0.01)),
    "negative alpha": lambda p: replace(p, alpha="-1"),
    "P larger": lambda p: replace(p, P=scaled_rows(p.P, 2.0)),
    "alpha smaller": lambda p: replace(p, alpha="0.0001"),
    "alpha larger": lambda p: replace(p, alpha=str(1 + 2 * float(p.alpha))),
}


@pytest.mark.parametrize("name", ["energy", "rms", "peak", "ultimate"])
@pytest.mark.parametrize("mutant", CHANGES)
def test_mutated_proofs_are_refused(of_lean, name, mutant):
    bound = getattr(of_lean, name)
    changed = replace(of_lean, **{name: InputBound(bound.bound, CHANGES[mutant](bound.proof))})
    assert failed_input(lean(), changed) == f"the proof of {name} does not hold"


def test_a_smaller_number_than_the_proven_is_refused():
    system = lean()
    found = certify_input(system)
    less = replace(found, peak=InputBound(0.999 * found.peak.bound, found.peak.proof))
    assert failed_input(system, less) == "peak is smaller than what is proven"
    assert failed_input(lean(c=6.5), found) != ""


def test_mean_squares_are_above_the_true_ones_and_near_them():
    system, T, w = lean(q=3), 20.0, 0.75
    shares = mean_squares(system, 4, T).astype(float)
    drift = np.sin(2 * w * T) / (4 * w * T)
    for i, share in enumerate(shares):
        true = 0.5 - drift if i % 2 == 0 else 0.5 + drift
        assert true <= share <= 1.05 * true
    pieces = certrack.load("example1").replace(reference=certrack.references.triangle(0.2, 6.0))
    assert (mean_squares(pieces, 1, T) == 1).all()


def test_what_has_no_bound_says_why():
    assert "known parameters" in certify_input(certrack.load("example1")).reason
    online = certrack.laws.Online(c=(8.0,) * 4, schedule="0.5")
    moving = lean().replace(law=replace(lean().law, online=online))
    assert "stand still" in certify_input(moving).reason
    base = certrack.load("dual-motor-lean")
    bent = replace(base.plant, drift="x1**3")
    assert "linear" in certify_input(base.replace(plant=bent)).reason
    shifted = base.replace(plant=replace(base.plant, drift="K_L/J_M*(x1 - x3) + 1"))
    found = certify_input(shifted)
    assert found.energy is None
    assert found.rms is None
    run = simulate(shifted.with_settings(duration=3.0))
    assert run.metrics.peak_input <= found.peak.bound


# What is no bound ---------------------------------------------------------------------------------

OWN_STATES = """
title = "truth in other units"
[plant]
states = ["x1", "x2"]
chain = [1]
linear = [[0]]
drift = "0"
input_gain = 1
gain_sign = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]
[truth]
states = ["p", "v"]
rates = ["v", "0.01*u + 0.001*sin(3*t)"]
outputs = ["100*p", "100*v"]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [2, 2]
feedforward = 1
[simulation]
x0 = [0.01, 0.0]
duration = 10
[ensemble]
x0 = [{ uniform = [-0.01, 0.01]}, { uniform = [-0.01, 0.01]}]
"""


def softly(transient=0.3):
    system = lean()
    system = system.replace(reference=SoftStart(system.reference, transient))
    return system.with_settings(x0=(0.0, 0.075, 0.0, 0.075))


def test_a_soft_start_has_no_bound_over_a_box():
    """Each start joins the reference by a polynomial of its own, with derivatives of its own."""
    system = softly()
    found = certify_input(system, BOX)
    assert "reference of its own" in found.reason
    assert found.peak is None
    elsewhere = simulate(system.with_settings(x0=(1.0, 1.0, -1.0, 1.0), duration=2.0)).metrics
    assert elsewhere.peak_input > 39.28  # what the reference from x0 would give for the box
    bounds = bounds_of_input(certrack.loads(certrack.to_text(system)))
    assert bounds["input"]["verified"]
    assert not bounds["input_over_starts"]["verified"]
    assert "reference of its own" in " ".join(input_lines(system, bounds))
    _, proof = certify_semidefinite(system)
    with pytest.raises(NoCertificate, match="reference of its own"):
        tube(system, proof, BOX)


def test_starts_of_a_truth_with_states_of_its_own_are_no_box_of_the_plant():
    system = certrack.loads(OWN_STATES)
    bounds = bounds_of_input(system)
    assert bounds["input"]["peak_input"] > simulate(system).metrics.peak_input
    assert bounds["input_over_starts"]["peak_input"] is None
    assert "truth.states" in input_lines(system, bounds)[-1]
    other = certrack.load("dual-motor-physical")  # with more states than the plant
    assert "truth.states" in bounds_of_input(other)["input_over_starts"]["reason"]


def test_nothing_is_verified_where_the_truth_contradicts_a_premise():
    base = lean()
    norm = "sqrt(x1**2 + x2**2 + x3**2 + x4**2)"
    omega = ("0", "0", "0", f"0.01*{norm} + 60*cos(t)")
    system = base.replace(truth=certrack.Truth(base.truth.input_gain, omega=omega))
    bounds = bounds_of_input(system)
    assert bounds["input_over_starts"] is None
    here = bounds["input"]
    assert not here["verified"]
    assert here["peak_input"] is here["energy"] is None
    assert "contradicted" in {premise["status"] for premise in here["premises"]}
    (line,) = input_lines(system, bounds)
    assert "contradicted" in line
    assert "verified" not in line


@pytest.mark.parametrize(
    "box", [[1, 2, 3, 4], 5, "abcd", [("a", "b")] * 4, [(1, 0)] * 4, [[0]] * 4]
)
def test_a_malformed_box_is_refused(box):
    with pytest.raises(InputError, match="box"):
        certify_input(lean(), box)


def integrators(n, starts=""):
    """A chain of n integrators whose last is disturbed."""
    return certrack.loads(f"""
[plant]
states = {str([f"x{i + 1}" for i in range(n)]).replace("'", '"')}
chain = {[1] * (n - 1)}
drift = "0"
gain_sign = 1
input_gain = 1
[truth]
input_gain = 1
[plant.uncertainty]
tau = {[0] * (n - 1) + [1]}
gamma = {[0] * n}
beta = {[0] * (n - 1) + [0.1]}
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = {[2] * n}
feedforward = {n - 1}
[simulation]
x0 = {[0.1] * n}
duration = 10
{starts}
""")


def test_what_is_missing_is_told():
    starts = ", ".join(["{ uniform = [-1, 1] }"] * 7)
    system = integrators(7, f"[ensemble]\nx0 = [{starts}]")
    bounds = bounds_of_input(system)
    lines = input_lines(system, bounds)
    assert "64 corners" in lines[-1]
    told = any(line.startswith("no bound of energy:") for line in lines)
    assert told == (bounds["input"]["energy"] is None)
    base = certrack.load("dual-motor-lean")
    shifted = base.replace(plant=replace(base.plant, drift="K_L/J_M*(x1 - x3) + 1"))
    assert certify_input(shifted).missing.keys() == {"energy", "rms"}
    assert "constant drift" in " ".join(input_lines(shifted, bounds_of_input(shifted)))


def test_an_observer_is_no_part_of_the_bound():
    system = certrack.load("axis-load")
    assert system.law.observer is not None
    assert "without the input of law.observer" in input_lines(system, bounds_of_input(system))[0]

"""Members of stiff loops by linearly implicit steps, beside explicit ones and single runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_ensembles import identical

import certrack
from certrack.core.errors import InputError
from certrack.integrators.many.native import vector_compiler
from certrack.studies.ensembles.engine import STEPS_PER_IMPLICIT, Engine, fastest, is_stiff
from certrack.studies.ensembles.error_limit import is_certified
from certrack.studies.ensembles.members import Members
from certrack.studies.ensembles.plan import METRICS, make_plan

pytestmark = pytest.mark.skipif(vector_compiler() is None, reason="needs a C compiler")

STIFF = ("dual-motor", "dual-motor-strong")


def plan_of(system, method="native", tolerance=1e-6, seed=0):
    return make_plan(system, seed, tolerance, None, method)


def final_states(system, method, tolerance, begin, end, seed=0):
    engine = Engine(plan_of(system, method, tolerance, seed))
    return engine.method.final_states(begin, end, engine.plan.empty().bands)


def metrics_of(system, method, tolerance, count):
    engine = Engine(plan_of(system, method, tolerance))
    metrics, outcomes = engine.metrics_and_outcomes(0, count, engine.plan.empty().bands)
    return dict(zip(METRICS, metrics, strict=True)), outcomes


def adaptive_chain(n=8):
    """The adaptive law on a chain of n integrators: bursts of its estimate, and slow parts."""
    states = [f"x{i}" for i in range(1, n + 1)]
    uncertainty = certrack.Uncertainty([0.0] * (n - 1) + [0.1], [1e-3] * n, [0.1] * n)
    plant = certrack.Plant(
        states=states,
        chain=[1] * (n - 1),
        uncertainty=uncertainty,
        drift="x1**2",
        regressor=["sin(x1)"],
        gain_sign=1,
    )
    law = certrack.Adaptive(
        c=[3] * n,
        feedforward=1,
        Gamma=[1.0],
        gain_rate=1.0,
        leak_gain=0.6,
        leak_theta=0.6,
        delta0=1.0,
        theta0=[1.0],
    )
    return certrack.System(
        plant=plant,
        law=law,
        reference=certrack.SymbolicReference("0.2*cos(t)"),
        truth=certrack.Truth(1, (1.0,), ("0",) * (n - 1) + ("1e-3*sin(x1)+0.1*cos(t)",)),
        settings=certrack.Settings([0] * n, 20),
    )


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("name", STIFF)
def test_errors_stay_below_the_tolerance(name, tolerance):
    """Of random members, against single runs by Taylor series; explicit steps exceed it tenfold."""
    system = certrack.load(name)
    members, chosen = Members(system, 3), np.random.default_rng(7).choice(1000, 6, replace=False)
    for index in chosen.tolist():
        found = final_states(system, "implicit", tolerance, index, index + 1, seed=3)[:, 0]
        exact = certrack.simulate(members.member(index), tolerance=1e-12).x[:, -1]
        assert np.abs(found - exact).max() < tolerance


@pytest.mark.parametrize("name", STIFF)
def test_metrics_are_those_of_exact_explicit_steps(name):
    """Of 64 members at 1e-6; what explicit steps get at that tolerance is worse in all but one."""
    system = certrack.load(name)
    exact, _ = metrics_of(system, "native", 1e-10, 64)
    found, outcomes = metrics_of(system, "implicit", 1e-6, 64)
    assert not outcomes.any()
    for metric, expected in exact.items():
        np.testing.assert_allclose(found[metric], expected, rtol=1e-4, err_msg=metric)
    explicit, _ = metrics_of(system, "native", 1e-6, 64)
    error = {
        kind: np.abs(values["input_variation"] / exact["input_variation"] - 1).max()
        for kind, values in (("explicit", explicit), ("implicit", found))
    }
    assert error["implicit"] < 5e-5 < 1e-2 < error["explicit"]  # steps at the edge of stability


def test_quantile_bands_are_those_of_explicit_steps():
    system = certrack.load("dual-motor")
    tight, found = (
        certrack.ensemble(system, 256, method=method, tolerance=tolerance, limit=np.inf)
        for method, tolerance in (("native", 1e-9), ("implicit", 1e-6))
    )
    bands = tight.statistics.bands
    bins = (np.abs(tight.bands - bands.centre) + bands.scale[:, None] / 4096) / 128
    assert (np.abs(tight.bands - found.bands) <= 1.01 * bins + 1e-4 * bands.scale[:, None]).all()
    assert tight.statistics.outcomes == found.statistics.outcomes


@pytest.mark.parametrize("name", STIFF)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_stiff_loops_get_implicit_steps(name, tolerance):
    plan = plan_of(certrack.load(name), tolerance=tolerance)
    assert is_stiff(plan, plan.registered)
    assert fastest(plan, 1).plan.method == "implicit"
    steps = [
        Engine(plan_of(plan.system, m, tolerance)).method.first_group(tolerance)[0]
        for m in ("native", "implicit")
    ]
    assert STEPS_PER_IMPLICIT * steps[1] < steps[0]


@pytest.mark.parametrize(
    "name", ["example1", "example1-classic", "dual-motor-lean", "flexible-joint", "stiction"]
)
def test_others_keep_explicit_steps(name):
    plan = plan_of(certrack.load(name))
    assert not is_stiff(plan, plan.registered)
    assert fastest(plan, 1).plan.method == "native"


def test_who_asks_for_explicit_steps_gets_them():
    system = certrack.load("dual-motor")
    chosen, explicit, implicit = (
        certrack.ensemble(system, 64, method=method, limit=np.inf)
        for method in (None, "native", "implicit")
    )
    identical(chosen, implicit)
    with pytest.raises(AssertionError):
        identical(chosen, explicit)


def test_threads_and_chunks_do_not_matter():
    """Bit for bit; the number of members neither."""
    system = certrack.load("dual-motor")
    whole = certrack.ensemble(system, 700, threads=1, limit=np.inf)
    for threads, chunk in ((2, 177), (3, 100_000), (1, 65)):
        identical(whole, certrack.ensemble(system, 700, threads=threads, chunk=chunk, limit=np.inf))
    metrics, _ = whole.per_member()
    fewer, _ = certrack.ensemble(system, 45, limit=np.inf).per_member()
    np.testing.assert_array_equal(metrics[:, :45], fewer)


def test_a_folder_knows_the_steps(tmp_path):
    """It is gone on with by the same steps, and not filled by others."""
    system = certrack.load("dual-motor")
    certrack.ensemble(system, 64, out=tmp_path, limit=np.inf)
    again = certrack.ensemble(system, 128, out=tmp_path, limit=np.inf)
    assert again.computed == 64
    identical(again, certrack.ensemble(system, 128, method="implicit", limit=np.inf))
    with pytest.raises(InputError):
        certrack.ensemble(system, 128, out=tmp_path, limit=np.inf, method="native")


def test_members_that_stick_and_slide():
    """Modes end inside implicit steps, too."""
    system = certrack.load("stiction")
    exact = final_states(system, "native", 1e-10, 0, 40)
    found = final_states(system, "implicit", 1e-8, 0, 40)
    np.testing.assert_allclose(found, exact, atol=1e-6)


def test_escaping_members_escape():
    """The limit of the states and where steps vanish are looked at by both."""
    system = certrack.load("dual-motor").with_settings(max_state=3)
    outcomes = [metrics_of(system, method, 1e-6, 64)[1] for method in ("native", "implicit")]
    assert (outcomes[0] == outcomes[1]).all()
    assert 0 < (outcomes[0] > 0).sum() < 64


def test_a_sampled_loop_has_no_implicit_steps():
    with pytest.raises(InputError, match="a sampled loop has no implicit steps"):
        certrack.ensemble(certrack.load("dual-motor-drive"), 4, method="implicit", limit=np.inf)


@pytest.mark.slow
def test_the_adaptive_law_on_a_long_chain():
    """Bound by accuracy where its estimate bursts: it keeps explicit steps; both are right."""
    system = adaptive_chain()
    plan = plan_of(system)
    assert not is_stiff(plan, plan.registered)
    chosen = np.random.default_rng(2).choice(500, 3, replace=False).tolist()
    for index in chosen:
        exact = certrack.simulate(Members(system, 0).member(index), tolerance=1e-11).x[:, -1]
        for method in ("native", "implicit"):
            found = final_states(system, method, 1e-8, index, index + 1)[:, 0]
            np.testing.assert_allclose(found, exact, atol=1e-6)


AXIS = """
[plant]
states = ["q", "v"]
chain = [1]
gain_sign = 1
input_gain = 1
[plant.constants]
at = 64.37
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 1.5]
[truth]
input_gain = 1
omega = [0, "{omega}"]
[reference]
signal = "0.01*sin(0.02*t)"
[law]
kind = "robust"
c = [1, {pole}]
[simulation]
x0 = [0.1, 0]
duration = 90
tail = 50
max_state = 100
[ensemble]
x0 = [{{uniform = [-0.03, 0.03]}}, {{uniform = [-0.02, 0.02]}}]
disturbance = "file"
"""


def test_implicit_steps_do_not_damp_what_runs_away():
    """At rest until 60 s, then driven away by a pole that long steps would damp."""
    omega = "500*v*(1 + sign(t - 60))/2 + 1e-4*cos(0.01*t)"
    system = certrack.loads(AXIS.format(omega=omega, pole=60))
    for method in (None, "implicit", "native"):
        found = certrack.ensemble(system, 32, method=method, limit=np.inf)
        assert found.statistics.outcomes == {"escaped": 32}, method


def test_implicit_steps_are_chosen_where_a_certificate_covers_all_members():
    calm = certrack.loads(AXIS.format(omega="0.5*sin(0.01*t)", pole=60))
    plan = plan_of(calm)
    assert is_certified(calm) and is_stiff(plan, plan.registered)
    stronger = calm.replace(truth=replace(calm.truth, omega=("0", "2*sin(0.01*t)")))
    plan = plan_of(stronger)
    assert not is_certified(stronger) and not is_stiff(plan, plan.registered)


def test_a_pulse_whose_time_is_drawn_is_not_passed_over():
    text = AXIS.format(omega="1.4*exp(-((t - at)/0.1)**2)", pole=40)
    text += "constants = {at = {uniform = [64.3, 66.5]}}\n"
    system = certrack.loads(text)
    assert fastest(plan_of(system), 1).plan.method == "native"
    for method in (None, "native", "implicit"):
        found = certrack.ensemble(system, 32, limit=0.003, method=method)
        assert found.violations()["count"] == 32, method
    narrow = certrack.loads(text.replace("/0.1)", "/0.0001)"))
    with pytest.raises(InputError, match="very short events at times of their own"):
        certrack.ensemble(narrow, 8, method="native")


def test_a_loop_at_rest_sees_a_pulse_whose_time_is_drawn():
    """Between two looks of a long step there was nothing: no member saw its pulse."""
    text = AXIS.format(omega="exp(-((t - at)/0.01)**2)", pole=60)
    text = text.replace("0.01*sin(0.02*t)", "0").replace("x0 = [0.1, 0]", "x0 = [0, 0]")
    start = text.index("x0 = [{")
    text = (
        text[:start]
        + "constants = {at = {uniform = [64.3, 66.5]}}\n"
        + text[text.index("disturbance") :]
    )
    system = certrack.loads(text)
    found, alone = (
        certrack.ensemble(system, 8, limit=np.inf, method=method).per_member()[0]
        for method in ("native", "alone")
    )
    peak = METRICS.index("peak_input")
    assert found[peak].min() > 0.1
    np.testing.assert_allclose(found[peak], alone[peak], rtol=2e-3)  # at nodes
    drawn = certrack.Population(disturbance="multisine", sines=12)
    calm = certrack.load("dual-motor").replace(population=drawn)
    assert fastest(plan_of(calm), 1).plan.method != "alone"


def test_one_member_that_stops_does_not_hold_up_its_group():
    """Of 1 in 32 the Jacobian has no value at the start; it alone is run by itself."""
    text = AXIS.format(omega="0.3*sqrt(abs(v)) + 0.1*cos(t)", pole=60)
    system = certrack.loads(
        text.replace("{uniform = [-0.02, 0.02]}", "{empirical = [0, 0.1, 0.2]}")
    )
    engine = Engine(
        plan_of(system.replace(settings=replace(system.settings, duration=2, tail=1)), "implicit")
    )
    results = engine.method.compute(0, 32, engine.plan.empty().bands)
    assert 0 < results.run_alone.sum() < 32

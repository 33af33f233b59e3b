"""Sampled control: against an independent loop, exact edges, limits, sensors, ensembles."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import certrack
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.many.native import vector_compiler
from certrack.integrators.sampled.run import sensed
from certrack.loops.sampled import sample_loop
from certrack.loops.stability import linear_loop
from certrack.model.noise import keys, normal
from certrack.studies.ensembles.methods.choice import fastest_adjustable
from certrack.studies.ensembles.methods.lockstep_sampled import LockstepSampled
from certrack.studies.ensembles.problem import EnsembleProblem

EVERYTHING = {
    "period": 0.01,
    "offset": 0.002,
    "delay": 1.3,
    "saturation": (-8, 8),
    "rate_limit": 500,
    "input_quantum": 0.001,
    "measurement_quantum": (1e-3, 0),
    "noise": (0.001, 0.002),
    "noise_bound": (0.0015, 0.001),
    "velocity": ("x2",),
    "velocity_filter": 0.02,
    "update": "exact_leak",
    "projection": ((0, 5), (-9, 9)),
}

#: What is measured on it here stays measured: the gains of `certrack new` may change.
STARTER = (Path(__file__).parent / "data" / "starter.toml").read_text()

METHODS = [
    pytest.param("native", marks=pytest.mark.skipif(not vector_compiler(), reason="no C compiler")),
    "lockstep",
]


def sampled(name, **options):
    implementation = certrack.Implementation(**options)
    return certrack.load(name).replace(implementation=implementation)


def with_omega(system, *omega):
    text = certrack.to_text(system)
    line = next(line for line in text.splitlines() if line.startswith("omega"))
    listed = ", ".join(f'"{term}"' for term in omega)
    return certrack.loads(text.replace(line, f"omega = [{listed}]"))


def with_reference(system, reference):
    text = certrack.to_text(system).replace("feedforward = 1", "feedforward = 0")
    head, tail = text.split("[reference]")
    return certrack.loads(f"{head}[reference]\n{reference}\n\n[law]{tail.split('[law]')[1]}")


def finals(run):
    return np.array(list(run.final_state.values()))


# ---- against independent computations ------------------------------------------------------------


def law(x, t, z):
    """The adaptive law of example1, written out by hand: ubar, e_2, phi."""
    (x1, x2), theta_hat = x, z[1]
    e2 = 1.75 * x1 + x2 - 3.25 * 0.2 * math.cos(t)
    phi = 1 + x1 * math.sin(x2)
    nu = 0.16015625 * x1 - 5.265625 * x2 - x1**2 * x2
    nu += 7.73828125 * 0.2 * math.cos(t) - 3.25 * 0.2 * math.sin(t)
    return nu - theta_hat * phi, e2, phi


def plant(t, x, u):
    x1, x2 = x
    w1 = 0.5 * math.hypot(x1, x2) * math.sin(2 * t)
    w2 = 0.2 * math.log(1 + x1 * x1 + x2 * x2) + 0.1 / (1 + t)
    rate2 = x1**2 * x2 + 2 * u + 2 * (1 + x1 * math.sin(x2)) + 0.2 * w2
    return [2 * x2 - 3 * x1 + 0.1 * w1, rate2]


def by_hand(T, duration, delay=0.0, limits=(-math.inf, math.inf)):
    """Example1 under forward Euler updates, SciPy between the events."""
    x, z, u, waiting = np.array([1.0, 2.0]), np.zeros(2), 0.0, []
    count = round(duration / T)
    samples = [(k * T, "sample") for k in range(count)]
    events = sorted([*samples, *((t + delay * T, "act") for t, _ in samples), (duration, "end")],
                    key=lambda event: (round(event[0], 12), event[1] == "act"))  # fmt: skip
    for (t, kind), (after, _) in pairwise(events):
        if kind == "sample":
            ubar, e2, phi = law(x, t, z)
            asked = z[0] * ubar
            command = min(max(asked, limits[0]), limits[1])
            rate = np.array([-ubar * e2 - 0.6 * (z[0] - 0.4), phi * e2 - 0.6 * (z[1] - 2.1)])
            if command == asked:
                z = z + T * rate
            waiting.append(command)
        if kind == "act":
            u = waiting.pop(0)
        if after > t + 1e-12 and t < duration:
            until = min(after, duration)
            options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
            x = solve_ivp(plant, (t, until), x, args=(u,), **options).y[:, -1]
    return np.array([*x, *z])


@pytest.mark.parametrize(
    ("delay", "limits"), [(0.0, None), (0.4, None), (1.7, (-4.0, 4.0)), (0.0, (-4.0, 6.0))]
)
@pytest.mark.parametrize("integrator", ["auto", "scipy"])
def test_example1_against_a_loop_by_hand(delay, limits, integrator):
    implementation = {"period": 0.001, "delay": delay, "saturation": limits, "anti_windup": "hold"}
    system = sampled("example1", **implementation)
    run = certrack.simulate(system, duration=3, tail=1, integrator=integrator)
    expected = by_hand(0.001, 3, delay, limits or (-math.inf, math.inf))
    assert np.abs(finals(run) - expected).max() < 1e-8


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean", "example1-classic"])
def test_converges_to_the_continuous_loop_with_order_one(name):
    system = certrack.load(name)
    exact = finals(certrack.simulate(system, duration=5, tail=2, tolerance=1e-11))
    errors = []
    for period in (2e-3, 1e-3, 5e-4):
        run = certrack.simulate(sampled(name, period=period), duration=5, tail=2)
        errors.append(np.abs(finals(run) - exact).max())
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert np.abs(orders - 1).max() < 0.1, errors


def test_kinks_of_the_plant_are_respected():
    """Dry friction: steps shrink towards the kink; tolerance is kept against a brute-force run."""
    text = certrack.to_text(certrack.load("example1"))
    text = text.replace('"0.5*sqrt(x1**2 + x2**2)*sin(2*t)"', '"0.5*abs(x2)*sign(sin(2*t))"')
    system = certrack.loads(text).replace(implementation=certrack.Implementation(period=0.02))
    runs = {
        integrator: certrack.simulate(system, integrator=integrator, duration=5, tail=2)
        for integrator in ("auto", "scipy")
    }
    tight = certrack.simulate(system, duration=5, tail=2, tolerance=1e-13)
    for run in runs.values():
        assert run.outcome is certrack.Outcome.finished
        assert np.abs(finals(run) - finals(tight)).max() < 1e-8


@pytest.mark.parametrize("method", [*METHODS, "alone"])
def test_large_jumps_of_the_rates_are_crossed(method):
    """The error of the shortest step across one is above its share of the tolerance."""
    system = with_omega(sampled("dual-motor-lean", period=0.001), 0, 0, 0, "100*sign(sin(2.1*t))")
    system = system.with_settings(duration=4, tail=2, tolerance=1e-11)
    system = system.replace(population=replace(system.varied, disturbance="file", x0=None))
    found = certrack.ensemble(system, 1, method=method, tolerance=1e-11)
    assert dict(found.statistics.outcomes) == {"finished": 1}
    loose = certrack.simulate(system, tolerance=1e-7).metrics.tail_error
    assert found.statistics.metrics["tail_error"].most == pytest.approx(loose, rel=1e-7)


@pytest.mark.parametrize("reference", ['kind = "triangle"\namplitude = 0.2\nperiod = 3.001', None])
def test_integrals_and_peaks(reference):
    """Metrics against sums over a fine grid of the dense output."""
    system = sampled("dual-motor-lean", period=0.03, delay=0.5)
    if reference:
        system = with_reference(system, reference)
    run = certrack.simulate(system, duration=6, tail=3)
    t = np.linspace(0, 6, 600_001)
    states = run.trajectory.interpolate(t)
    e = states[0] - system.reference.values(t, 0)[0]
    u = run.input_of(t, states)
    found = run.metrics
    assert found.integral_squared_error == pytest.approx(np.trapezoid(e**2, t), rel=1e-6)
    assert found.integral_abs_error == pytest.approx(np.trapezoid(np.abs(e), t), rel=1e-5)
    assert found.input_energy == pytest.approx(np.trapezoid(u**2, t), rel=1e-3)
    assert found.tail_error == pytest.approx(np.abs(e[t >= 3]).max(), rel=1e-4)
    assert found.peak_input == np.abs(u).max()
    assert found.input_variation == pytest.approx(np.abs(np.diff(u)).sum(), rel=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_break_and_the_begin_of_the_tail_that_rounding_separates(method):
    """The triangle bends at 17 * 0.2 = 3.4000000000000004."""
    system = sampled("dual-motor-lean", period=0.01).with_settings(duration=6, tail=3.4)
    system = with_reference(system, 'kind = "triangle"\namplitude = 0.2\nperiod = 0.4')
    assert 0 < np.abs(system.reference.breaks(0.0, 6.0) - 3.4).min() < 1e-15
    found, alone = (
        certrack.ensemble(system, 2, method=m, tolerance=1e-9) for m in (method, "alone")
    )
    for name in ("tail_error", "integral_squared_error", "input_energy"):
        one, other = (each.statistics.metrics[name].most for each in (found, alone))
        assert one == pytest.approx(other, rel=1e-6), name


@pytest.mark.parametrize("period", [1e3, 1e12])
@pytest.mark.parametrize("method", METHODS)
def test_a_period_longer_than_the_run(period, method):
    """One sample, at the begin; its input stays, and the loop is open."""
    short = {"duration": 0.5, "tail": 0.25}
    system = sampled("example1", period=period, update="exact_leak").with_settings(**short)
    run = certrack.simulate(system)
    once = sampled("example1", period=0.5, update="exact_leak")
    expected = certrack.simulate(once, **short)
    assert np.abs(finals(run)[:2] - finals(expected)[:2]).max() < 1e-9
    found = certrack.ensemble(system, 3, method=method)
    assert dict(found.statistics.outcomes) == {"finished": 3}
    assert found.statistics.metrics["tail_error"].least > 0


@pytest.mark.parametrize("method", [*METHODS, "alone"])
def test_escape_in_the_first_and_in_the_last_interval(method):
    """Both in one: the run is shorter than the period."""
    system = sampled("example1", period=10.0, update="exact_leak")
    system = system.with_settings(duration=5, tail=1)
    found = certrack.ensemble(system, 8, method=method)
    assert dict(found.statistics.outcomes) == {"escaped": 8}
    assert found.statistics.metrics["tail_error"].missing == 8


def test_escape_before_the_first_step_ends():
    system = sampled("example1", period=0.01)
    run = certrack.simulate(system, max_state=2.0)
    assert run.outcome is certrack.Outcome.escaped
    assert run.trajectory.end == 0.0 and finals(run).tolist() == [1, 2, 0, 0]
    assert run.dataset().sizes["time"] == 1 and run.summary()["peak_input"] == 0.0


def test_simulator_refuses_another_structure_of_the_implementation():
    plain = sampled("example1", period=0.01)
    simulator, continuous = (certrack.Simulator(s) for s in (plain, certrack.load("example1")))
    limited = sampled("example1", period=0.01, saturation=(-1, 1))
    for one, other in (
        (simulator, limited),
        (simulator, certrack.load("example1")),
        (simulator, sampled("example1", period=0.01, velocity=("x2",))),
        (continuous, plain),
    ):
        with pytest.raises(certrack.InputError, match="has another structure"):
            one.run(other)
    slower = sampled("example1", period=0.02, delay=0.5)
    assert finals(simulator.run(slower)).tolist() == finals(certrack.simulate(slower)).tolist()


# ---- what the implementation does ----------------------------------------------------------------


def test_limits_are_kept_and_estimates_stand_still_meanwhile():
    options = {"period": 0.002, "saturation": (-3, 4), "rate_limit": 200}
    run = certrack.simulate(sampled("example1", **options, anti_windup="hold"))
    dense = run.trajectory.interpolate
    assert dense.inputs.min() >= -3 and dense.inputs.max() <= 4
    steps = np.diff(dense.inputs, prepend=0.0)
    assert np.abs(steps).max() <= 200 * 0.002 * (1 + 1e-12)
    limited = (np.abs(steps) > 0.399999) | (dense.inputs == -3) | (dense.inputs == 4)
    still = np.abs(np.diff(dense.estimates, axis=1)).max(axis=0) == 0
    held = limited[: len(still)]
    assert held.sum() > 5 and still[held].all() and not still[~held].any()
    moving = certrack.simulate(sampled("example1", **options, anti_windup="none"))
    changes = np.diff(moving.trajectory.interpolate.estimates, axis=1)
    assert np.abs(changes).max(axis=0).min() > 0


def test_limits_are_those_of_the_rate_in_both_directions():
    run = certrack.simulate(sampled("dual-motor-lean", period=0.002, rate_limit=50))
    steps = np.diff(run.trajectory.interpolate.inputs, prepend=0.0)
    assert (np.isclose(steps, 0.1)).any() and (np.isclose(steps, -0.1)).any()
    assert np.abs(steps).max() <= 0.1 * (1 + 1e-9)


def test_the_slope_by_hand_of_a_tracking_error():
    """The slope of e_1 = x_1 - y_d(t), by which its peaks are placed, is x_1' - y_d'."""
    system = sampled("example1", period=0.002)
    loop, (y, dy) = sample_loop(system), system.reference.formulas(1)
    assert loop.e_1 == loop.plant.outputs[0] - y and dy.free_symbols
    assert sympy.expand(loop.slope - loop.plant.rates[0] + dy) == 0


def test_estimates_forget_while_the_input_is_limited():
    """z + T (leak) there, z + T (drive + leak) elsewhere; the classic law has none and stands."""
    options = {"period": 0.002, "saturation": (-3, 4)}
    dense = certrack.simulate(sampled("example1", **options)).trajectory.interpolate
    z, u = dense.estimates, dense.input(dense.samples[:-1])
    limited = np.flatnonzero((u == -3) | (u == 4))
    rates = -0.6 * (z - np.array([[0.4], [2.1]]))
    change = np.diff(z, axis=1)[:, limited]
    assert len(limited) > 5
    np.testing.assert_allclose(change, 0.002 * rates[:, limited], rtol=1e-9, atol=1e-15)
    rest = np.setdiff1d(np.arange(z.shape[1] - 1), limited)
    assert np.abs(np.diff(z, axis=1) - 0.002 * rates[:, :-1])[:, rest[:100]].min() > 0

    classic = sampled("example1-classic", **options).with_settings(duration=1, tail=0.5)
    dense = certrack.simulate(classic).trajectory.interpolate
    u = dense.input(dense.samples[:-1])
    still = np.abs(np.diff(dense.estimates, axis=1)).max(axis=0) == 0
    held = (u == -3) | (u == 4)
    assert held.any() and still[held].all()


def test_projection_keeps_the_estimates_inside():
    box = ((0.1, 0.45), (-1.0, 2.0))
    run = certrack.simulate(sampled("example1", period=0.002, projection=box))
    z = run.trajectory.interpolate.estimates[:, 1:]
    for row, (low, high) in zip(z, box, strict=True):
        assert row.min() >= low and row.max() <= high and np.isin([low, high], row).any()


def test_quantised_inputs_and_measurements():
    run = certrack.simulate(sampled("example1", period=0.005, input_quantum=0.25))
    multiples = run.trajectory.interpolate.inputs / 0.25
    assert np.array_equal(multiples, np.rint(multiples))
    coarse, fine = (
        certrack.simulate(sampled("example1", period=0.005, measurement_quantum=(q, q)))
        for q in (1e-2, 1e-9)
    )
    exact = certrack.simulate(sampled("example1", period=0.005))
    assert np.abs(finals(fine) - finals(exact)).max() < 1e-6
    assert np.abs(finals(coarse) - finals(exact)).max() > 1e-4


@pytest.mark.parametrize("method", [*METHODS, "alone"])
def test_converter_stays_within_the_saturation(method):
    """The limit -8 is nearer to the step -9 than to -6."""
    system = sampled("example1", period=0.005, saturation=(-8, 8), input_quantum=3)
    system = system.with_settings(duration=3, tail=1)
    inputs = certrack.simulate(system).trajectory.interpolate.inputs
    assert np.unique(inputs).tolist() == [-6, -3, 0]
    found = certrack.ensemble(system, 8, method=method).statistics.metrics["peak_input"]
    assert found.most == 6


def test_differenced_speed():
    """x_2 = (x_1' + 3 x_1)/2 from differences: converges with order one where w_1 = 0."""

    def final(**implementation):
        system = certrack.load("example1")
        quiet = replace(system.truth, omega=(0, system.truth.omega[1]))
        made = certrack.Implementation(**implementation) if implementation else None
        system = system.replace(truth=quiet, implementation=made)
        return certrack.simulate(system, duration=5, tail=2).final_state["x1"]

    exact = final()
    errors = [abs(final(period=T, velocity=("x2",)) - exact) for T in (2e-3, 1e-3)]
    assert errors[1] < 1e-3 and 1.7 < errors[0] / errors[1] < 2.3
    slow = final(period=1e-3, velocity=("x2",), velocity_filter=0.05)
    assert abs(slow - exact) > 3 * errors[1]


def test_exact_leak_is_exponential_euler():
    """L W = exp(L T) - I, for a full adaptation gain; nothing couples delta_hat and theta_hat."""
    from certrack.loops.controller import sampled_controller
    from certrack.loops.controller_values import controller_values

    Gamma = ((2.0, 0.5), (0.5, 1.0))
    base = certrack.load("example1")
    plant_ = replace(base.plant, regressor=("1", "sin(x2)"), theta=(1.0, 2.0), theta_range=None)
    law_ = replace(base.law, Gamma=Gamma, theta0=(1.0, 2.0), leak_theta=3.0, leak_gain=5.0)
    implementation = certrack.Implementation(period=0.1, update="exact_leak").bound_to(plant_, 3)
    found = sampled_controller(plant_, law_.design(plant_), implementation)
    values = dict(
        zip(
            (s.name for s in found.parameters),
            controller_values(found, plant_, law_, implementation),
            strict=True,
        )
    )
    weights = np.zeros((3, 3))
    for i, j in found.hold:
        weights[i, j] = values[f"ctl_hold_{i}_{j}"]
    L = np.zeros((3, 3))
    L[0, 0], L[1:, 1:] = -5.0, -3.0 * np.array(Gamma)
    assert np.abs(L @ weights - (expm(0.1 * L) - np.eye(3))).max() < 1e-14
    assert {(0, 1), (1, 0), (0, 2), (2, 0)}.isdisjoint(found.hold)


def test_noise_is_normal_and_reproducible():
    drawn = np.array([normal(keys(3, 0, 5000), k, 2) for k in range(20)])
    assert abs(drawn.mean()) < 0.01 and abs(drawn.std() - 1) < 0.01
    assert abs(np.mean(drawn**4) - 3) < 0.1
    assert np.array_equal(normal(keys(3, 77, 1), 5, 2)[:, 0], drawn[5, :, 77])
    first, again, other = (
        certrack.simulate(sampled("example1", period=0.01, noise=(0.01, 0.01), seed=seed))
        for seed in (1, 1, 2)
    )
    assert finals(first).tolist() == finals(again).tolist() != finals(other).tolist()


def test_noise_is_clipped_to_its_bound():
    drive = certrack.Implementation(0.01, noise=(1.0, 2.0), noise_bound=(0.5, 3.0))
    members, samples = keys(3, 0, 500), range(20)
    free = replace(drive, noise_bound=None)
    zero = np.zeros((2, 500))
    clipped, drawn = (
        np.array([sensed(zero, one, members, k) for k in samples]) for one in (drive, free)
    )
    assert np.array_equal(clipped, np.clip(drawn, [[-0.5], [-3.0]], [[0.5], [3.0]]))
    assert (clipped != drawn).any(axis=(0, 2)).all() and (clipped == drawn).any(axis=(0, 2)).all()


def test_the_largest_noise_is_its_bound_and_normal_noise_has_none():
    noisy = sampled("example1", period=0.01, noise=(0, 0.1), noise_bound=(0.2, 0.5))
    assert noisy.implementation.largest_noise(2) == (0.2, 0.5)
    assert sampled("example1", period=0.01).implementation.largest_noise(2) == (0, 0)
    with pytest.raises(certrack.InputError, match=r"noise_bound: is missing: normal noise has no"):
        sampled("example1", period=0.01, noise=(0, 0.1)).implementation.largest_noise(2)


def test_of_several_delays_a_run_has_the_first():
    one, several = (sampled("example1", period=0.02, delay=d) for d in (1.5, [1.5, 0, "7/2"]))
    assert several.implementation.delays == (1.5, 0, 3.5)
    assert one.implementation.delays == (1.5,) == (several.implementation.run_delay,)
    runs = [certrack.simulate(system, duration=2, tail=1) for system in (one, several)]
    assert finals(runs[0]).tolist() == finals(runs[1]).tolist()
    again = certrack.loads(certrack.to_text(several))
    assert again.implementation == several.implementation


def test_check_takes_the_worst_of_several_delays():
    lean = certrack.load("dual-motor-lean")

    def finding(delay):
        system = lean.replace(implementation=certrack.Implementation(0.02, delay=delay))
        return next(f for f in certrack.check(system).findings if f.name == "sampled stability")

    assert finding(0.0).status != "fault" and finding(5.0).status == "fault"
    assert finding([0.0, 5.0]) == finding(5.0) == finding([5.0, 0.0])


# ---- exact edges and margins ---------------------------------------------------------------------


@pytest.mark.parametrize("name", ["dual-motor", "dual-motor-lean"])
@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 2.3])
@pytest.mark.parametrize("speeds", [(), ("x2", "x4")])
def test_period_map_is_what_one_period_does(name, delay, speeds):
    """Two runs under the same reference differ by a solution of the linear loop."""
    implementation = {
        "period": 0.001,
        "velocity": speeds,
        "velocity_filter": 0.01 if speeds else 0.0,
    }
    system = sampled(name, **implementation)
    system = system.replace(truth=replace(system.truth, omega=None))
    loop, T, n = linear_loop(system), 0.001, system.plant.n
    assert delay > 2 or loop.radius(T, delay) < 1
    implementation = replace(system.implementation, delay=delay)
    system = system.replace(implementation=implementation).with_settings(
        duration=300 * T, tail=None
    )
    moved = system.with_settings(x0=tuple(x + 0.1 for x in system.settings.x0))
    runs = [certrack.simulate(one).trajectory.interpolate for one in (system, moved)]
    times = T * np.arange(1, 300)
    gap = np.subtract(*(dense(times)[:n] for dense in runs[::-1]))

    M = loop.period_map(T, delay)  # holds from the second sample on: the first has no difference
    xi = np.zeros(len(M))
    xi[:n] = gap[:, 0]
    if speeds:
        kept = [state.name for state in loop.controller.states]
        for speed, before in (("x2", 0), ("x4", 2)):
            start = np.subtract(*(dense(np.zeros(1))[:n, 0] for dense in runs[::-1]))
            xi[n + kept.index(f"ctl_before_{speed}")] = start[before]
    acts = np.array([delay * T + 1e-9])
    xi[n + len(loop.controller.states)] = np.subtract(
        *(dense.input(acts)[0] for dense in runs[::-1])
    )
    for k in range(len(times)):
        assert np.abs(gap[:, k] - xi[:n]).max() < 1e-9 * (1 + np.abs(xi).max())
        xi = M @ xi


def test_stable_below_the_exact_edge_and_not_above():
    system = sampled("dual-motor-lean", period=0.01)
    loop = linear_loop(system)
    assert loop.radius(0.0865, 0.0) < 1 < loop.radius(0.0878, 0.0)
    outcomes = [
        certrack.simulate(
            sampled("dual-motor-lean", period=T), duration=170, tail=None
        ).outcome.name
        for T in (0.0865, 0.0885)
    ]
    assert outcomes == ["finished", "escaped"]


def test_nonlinear_loops_have_no_exact_edge():
    assert linear_loop(sampled("example1", period=0.01)) is None
    text = certrack.to_text(sampled("dual-motor-lean", period=0.01))
    bent = certrack.loads(text.replace('"K_L/J_M*(x1 - x3)"', '"K_L/J_M*sin(x1 - x3)"'))
    assert linear_loop(bent) is None


def test_motions_that_the_controller_neither_causes_nor_sees_do_not_hide_the_edge():
    """Two equal motors without play swing undamped against each other; the rest is the model."""
    shafts = ["th_1 - th_L", "th_2 - th_L"]
    plain = certrack.load("dual-motor-physical")
    rates = [
        "om_L",
        f"K_L/J_L*({' + '.join(shafts)})",
        "om_1",
        f"K_M/J_M*split*u - K_L/J_M*({shafts[0]})",
        "om_2",
        f"K_M/J_M*(1 - split)*effectiveness_2*u - K_L/J_M*({shafts[1]})",
    ]
    constants = {"split": 0.5, "effectiveness_2": 1}
    simple = replace(plain.truth, rates=rates, constants=constants, motors=None, supply=None)
    implementation, found = certrack.Implementation(period=0.01, velocity=("x2", "x4")), []
    for truth in (
        certrack.load("dual-motor-lean").truth,
        replace(simple, constants=constants),
        replace(simple, constants=constants | {"split": 0.6}),
    ):
        x0 = plain.settings.x0 if truth.states else certrack.load("dual-motor-lean").settings.x0
        system = plain.replace(
            truth=truth, settings=replace(plain.settings, x0=x0), population=None
        )
        loop = linear_loop(system.replace(implementation=implementation))
        found.append([loop.radius(T, 0.3) for T in (1e-3, 0.01, 0.05, 0.1)])
    assert found[0][0] < 1 < found[0][-1]
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[2] == pytest.approx(found[0], rel=1e-9)  # the mean does not feel the split


def test_margins_agree_with_the_exact_edge():
    found = certrack.margins(certrack.load("dual-motor-lean"), members=16)
    assert found.origin == "certificate"
    for one in (found.period, found.delay):
        assert one.within <= one.exact * 1.0001
        assert one.within == pytest.approx(one.exact, rel=0.05)
    assert found.period.errors[-1] == math.inf and not found.saturation.unlimited
    assert 0 < found.saturation.within < 14
    strict = certrack.margins(certrack.load("dual-motor-lean"), members=8, error=1e-6)
    assert strict.period.within is None


def test_margins_keep_the_rest_of_the_file():
    """A delay shortens the longest period; the file's own point is judged."""
    late = sampled("dual-motor-lean", period=0.01, delay=1.0)
    found = certrack.margins(late, members=8, error=0.002)
    loop = linear_loop(late)
    assert loop.radius(found.period.exact, 1.0) == pytest.approx(1.0, abs=1e-9)
    assert found.period.within == pytest.approx(0.0274, rel=0.05)
    assert found.at == 0.01 and found.as_given < 0.002
    beyond = certrack.margins(late, members=8, error=1e-4)
    assert beyond.as_given > beyond.error and beyond.saturation.within is None


def high_gains():
    """A loop with fast adaptation, which is faster than its error poles."""
    system = certrack.loads(STARTER)
    gains = {"Gamma": (100.0,), "gain_rate": 100.0, "leak_gain": 0.01, "leak_theta": 0.01}
    return system.replace(law=replace(system.law, **gains))


@pytest.mark.slow
def test_margins_of_a_loop_that_adaptation_makes_faster_than_its_poles():
    """At the period to begin with none finishes; docs/certificates.md sends such loops here."""
    system = high_gains()
    found = certrack.margins(system, members=16)
    first = 0.05 / system.controller.coordinates.fastest_pole
    assert dict(zip(found.period.values, found.period.errors, strict=True))[first / 4] < 0.009
    assert found.period.within == pytest.approx(0.00524, rel=0.05)
    assert found.period.within < first
    for value, error in zip(found.period.values, found.period.errors, strict=True):
        assert (error <= found.error) == (value <= found.period.within), value
    assert 0 < found.delay.within < found.period.within and not found.saturation.unlimited


@pytest.mark.slow
def test_margins_of_members_that_finish_in_continuous_time_are_found():
    assert certrack.margins(certrack.load("example1-classic"), members=64).period.within > 0.002


@pytest.mark.slow
def test_margins_refuse_a_loop_that_never_finishes():
    """The law knows a wrong theta of x1^3: the loop escapes in finite time, however sampled."""
    text = STARTER
    for old, new in {
        'kind = "adaptive"': 'kind = "robust"',
        '["-sin(x1)"]': '["x1**3"]',
        "theta = [[1.0, 3.0]]": "theta = [[1, 50]]",
        "theta = [1.7]": "theta = [50]",
        "x0 = [0.5, 0]": "x0 = [5, 0]",
    }.items():
        assert old in text
        text = text.replace(old, new)
    gains = ("Gamma", "gain_rate", "leak_", "delta0", "theta0")
    text = "\n".join(line for line in text.splitlines() if not line.startswith(gains))
    system = certrack.loads(text)
    refusal = r"not every member of the population finishes, down to a period of 9.58e-06 s"
    with pytest.raises(certrack.InputError, match=refusal):
        certrack.margins(system, members=8)
    given = certrack.margins(system, members=8, error=1.0)
    assert given.period.within is None and given.period.errors == (math.inf,)


def test_margins_refuse_a_pole_too_fast_to_be_sampled():
    system = certrack.load("dual-motor-lean")
    fast = system.replace(law=replace(system.law, c=(1e6,) * 4))
    with pytest.raises(certrack.InputError, match=r"fastest error pole, 1e\+06 /s, has more than"):
        certrack.margins(fast, members=2)


def test_halving_ends_where_a_run_has_too_many_samples(monkeypatch):
    monkeypatch.setattr("certrack.studies.margins.MAX_RUN_SAMPLES", 2100)
    with pytest.raises(certrack.InputError, match=r"finishes, down to a period of 0\.00981 s"):
        certrack.margins(high_gains(), members=2)


# ---- ensembles -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("options", [{"period": 0.02}, EVERYTHING], ids=["plain", "everything"])
def test_members_are_single_runs(method, options):
    system = sampled("example1", **options)
    found = certrack.ensemble(system, 12, seed=5, method=method)
    every = [found.run(i).metrics.as_dict() for i in range(12)]
    for name, tally in found.statistics.metrics.items():
        values = [one[name] for one in every if one[name] is not None]
        near = {"rel": 1e-5, "abs": 5e-4 if name == "settling_time" else 1e-12}
        assert tally.most == pytest.approx(max(values), **near), name
        assert tally.least == pytest.approx(min(values), **near), name


@pytest.mark.parametrize("method", METHODS)
def test_threads_and_chunks_do_not_matter(method):
    system = sampled("example1", **EVERYTHING).with_settings(duration=2, tail=1)
    packed = [
        certrack.ensemble(
            system, 600, seed=1, method=method, threads=threads, chunk=chunk
        ).statistics.packed()
        for threads, chunk in ((1, 4096), (2, 4096), (2, 100))
    ]
    for other in packed[1:]:
        assert all(np.array_equal(packed[0][key], other[key]) for key in packed[0])


@pytest.mark.parametrize("method", METHODS)
def test_members_that_escape(method):
    system = sampled("dual-motor-lean", period=0.1).with_settings(duration=200, tail=None)
    found = certrack.ensemble(system, 16, method=method)
    assert dict(found.statistics.outcomes) == {"escaped": 16}
    assert found.limit is None and "sampled" in found.limit_origin


@pytest.mark.parametrize("method", [*METHODS, "alone"])
def test_members_without_a_way_on_are_counted_once(method):
    """Where the uncertain term leaves its domain; every member is then run alone."""
    system = with_omega(sampled("example1", period=0.01), 0, "sqrt(3.2 - t + 0.05*x1)")
    system = system.replace(population=replace(system.varied, disturbance="file"))
    found = certrack.ensemble(system.with_settings(duration=5, tail=1), 11, method=method)
    assert dict(found.statistics.outcomes) == {"undefined": 11}
    assert np.unique(found.statistics.bands.counts.sum(axis=2)).tolist() == [11]


def test_neither_compiler_nor_heyoka(monkeypatch):
    """NumPy takes the members side by side, and margins have a method, too."""

    def missing(*_):
        raise MethodUnavailable

    monkeypatch.setattr("certrack.integrators.sampled.native.compiled_library", missing)
    methods = "certrack.studies.ensembles.methods"
    monkeypatch.setattr(f"{methods}.lockstep_sampled.has_heyoka", lambda: False)
    monkeypatch.setattr(f"{methods}.lockstep_continuous.has_heyoka", lambda: False)
    system = sampled("example1", **EVERYTHING).with_settings(duration=1, tail=0.5)
    method = fastest_adjustable(EnsembleProblem(system, 3, 1e-9), 1)
    assert type(method) is LockstepSampled
    worst, _ = method.extremes(3, system.implementation)
    every = [certrack.ensemble(system, 3, seed=3).run(i).metrics.tail_error for i in range(3)]
    assert worst == pytest.approx(max(every), rel=1e-7)


# ---- files, command line, bad input --------------------------------------------------------------


def test_survives_a_system_file():
    system = sampled("example1", **EVERYTHING, seed=3)
    assert certrack.loads(certrack.to_text(system)) == system
    member = certrack.ensemble(system, 3, seed=9).member(2)
    again = certrack.loads(certrack.to_text(member))
    assert finals(certrack.simulate(again)).tolist() == finals(certrack.simulate(member)).tolist()
    assert (member.implementation.seed, member.implementation.stream) == (9, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"period": -1}, "implementation.period: must be positive; got -1"),
        ({"period": 1e-9}, "implementation.period: makes more than 20000000 samples"),
        ({"period": 0.01, "offset": 0.02}, "implementation.offset: must be less than the period"),
        ({"period": 0.01, "delay": -1}, "implementation.delay: must be 0 to 100 periods; got -1"),
        (
            {"period": 0.01, "saturation": (2, 2)},
            "implementation.saturation: low must be less than high; got [2.0, 2.0]",
        ),
        (
            {"period": 0.01, "saturation": (1, 2)},
            "implementation.initial_input: must be within the saturation; got 0",
        ),
        ({"period": 0.01, "rate_limit": 0}, "implementation.rate_limit: must be positive"),
        (
            {"period": 0.01, "noise": (0.1,)},
            "implementation.noise: must be a list of 2: one number per state",
        ),
        (
            {"period": 0.01, "noise_bound": (0.1,)},
            "implementation.noise_bound: must be a list of 2: one number per state",
        ),
        (
            {"period": 0.01, "noise": (0, 0.1), "noise_bound": (1, 0)},
            "implementation.noise_bound[1]: must be positive where there is noise; got 0",
        ),
        ({"period": 0.01, "delay": []}, "implementation.delay: must be a number or a list of 1 to"),
        ({"period": 0.01, "delay": [0.5] * 17}, "a list of 1 to 16; got a list of 17"),
        (
            {"period": 0.01, "delay": [0.5, -1]},
            "implementation.delay[1]: must be 0 to 100 periods; got -1",
        ),
        (
            {"period": 0.01, "delay": None},
            "implementation.delay: must be a formula (text) or a number",
        ),
        ({"period": 0.01, "velocity": ("x1",)}, "the first state has none before it"),
        ({"period": 0.01, "velocity_filter": 1}, "implementation.velocity_filter: filters nothing"),
        (
            {"period": 0.01, "projection": ((0, 1),)},
            "implementation.projection: must be a list of 2",
        ),
        (
            {"period": 0.01, "saturation": (0.1, 0.2), "input_quantum": 1, "initial_input": 0.1},
            "implementation.input_quantum: has no step within the saturation; got 1",
        ),
        ({"period": 0.01, "update": "heun"}, "must be one of euler, exact_leak; got heun"),
    ],
)
def test_bad_implementations(options, message):
    with pytest.raises(certrack.InputError) as problem:
        sampled("example1", **options)
    assert message in str(problem.value) and "\n" not in str(problem.value)


def test_implicit_method_is_refused():
    with pytest.raises(certrack.InputError, match="no implicit method"):
        certrack.simulate(sampled("example1", period=0.01), integrator="implicit")


@pytest.mark.parametrize("integrator", ["auto", "scipy"])
def test_a_reference_faster_than_the_plant(integrator):
    """x' = u, sampled twice a second, while y_d turns ten times a second: the error is resolved."""
    text = certrack.to_text(sampled("dual-motor-lean", period=0.5))
    head = text[: text.index("[plant]")]
    system = certrack.loads(
        head
        + """
[plant]
states = ["x1"]
gain_sign = 1
input_gain = 1
[truth]
input_gain = 1
[reference]
signal = "sin(20*t)"
[law]
kind = "robust"
c = [1]
[simulation]
x0 = [0.3]
duration = 6
tail = 3
[implementation]
period = 0.5
"""
    )
    run = certrack.simulate(system, integrator=integrator)
    t = np.linspace(0, 6, 600_001)
    e = run.trajectory.interpolate(t)[0] - np.sin(20 * t)
    found = run.metrics
    assert found.integral_squared_error == pytest.approx(np.trapezoid(e**2, t), rel=1e-7)
    assert found.integral_abs_error == pytest.approx(np.trapezoid(np.abs(e), t), rel=1e-5)
    crowd = certrack.ensemble(system, 1, method="native" if vector_compiler() else "lockstep")
    square = crowd.statistics.metrics["integral_squared_error"].most
    assert square == pytest.approx(found.integral_squared_error, rel=1e-4)

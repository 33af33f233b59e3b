"""Runs with pulses, kinks and bumps of time, from rest, and by threads: the events of a run."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import certrack

CASES = Path(__file__).parent.parent / "data" / "cases"


def load(name, **settings):
    return certrack.load(CASES / f"{name}.toml").with_settings(**settings)


def double_integrator(disturbance, nodes, *, c=(2.0, 2.0), start=(0.0, 0.0), sine=0.0):
    """Largest |e_1| from t = 9 on: x1' = x2, x2' = u + w, restarted at the nodes.

    With y_d = sine sin t and e_2 = x_2 + c_1 e_1, u = -e_1 - c_2 e_2 - c_1 (x_2 - y_d').
    """
    a0, a1 = c[0] * c[1] + 1, c[0] + c[1]
    tail, y = 0.0, np.array(start)
    for begin, end in zip(nodes[:-1], nodes[1:], strict=True):
        w = disturbance(begin, end)

        def rates(t, x, w=w):
            y_d, rate = sine * np.sin(t), sine * np.cos(t)
            return [x[1], -a0 * (x[0] - y_d) - a1 * x[1] + c[0] * rate + w(t)]

        found = solve_ivp(
            rates, (begin, end), y, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True
        )
        y = found.y[:, -1]
        if end > 9.0:
            t = np.linspace(begin, end, 40_001)
            tail = max(tail, np.abs(found.sol(t)[0] - sine * np.sin(t)).max())
    return tail


def triangle(begin, end):
    """The load pulse of 40 ms at t = 10, as the straight line of this piece."""
    middle = (begin + end) / 2
    if not 9.98 < middle < 10.02:
        return lambda t: 0.0
    side = 1.0 if middle < 10 else -1.0
    return lambda t: 3 * (1 + side * (t - 10) / 0.02)


PULSE = [0.0, 9.0, 9.98, 10.0, 10.02, 11.0, 20.0]


@pytest.mark.parametrize("method", ["taylor", "scipy", "implicit"])
def test_a_triangular_pulse_of_time_is_not_missed(method):
    run = certrack.simulate(load("pulse_decayed_tri", integrator=method))
    right = double_integrator(triangle, PULSE, start=(0.3, 0.0))
    assert right == pytest.approx(0.0106139, abs=1e-7)
    assert run.metrics.tail_error == pytest.approx(right, abs=1e-8)
    assert {9.98, 10.0, 10.02} <= set(run.trajectory.times.round(12))


def test_a_pulse_far_above_the_steps_of_an_implicit_method_is_not_missed():
    run = certrack.simulate(load("pulse_stiff"))
    assert run.trajectory.method == "implicit"
    assert run.metrics.tail_error == pytest.approx(2.885e-4, abs=2e-7)
    exact = 3000 / (2 * 2e5 + 1)  # the fast pole follows: a first-order lag of the triangle
    assert run.metrics.tail_error < exact


@pytest.mark.parametrize("method", ["native", "lockstep", "alone"])
def test_no_member_of_an_ensemble_misses_a_pulse(method):
    def rectangle(begin, end):
        inside = 10 < (begin + end) / 2 < 10.02
        return lambda t: 3.0 if inside else 0.0

    system = load("pulse_ensemble")
    right = double_integrator(rectangle, [0.0, 9.0, 10.0, 10.02, 11.0, 20.0])
    assert right == pytest.approx(0.0106148, abs=1e-7)
    try:
        results = [
            certrack.ensemble(system, members=16, method=method, tolerance=tolerance)
            for tolerance in (1e-6, 1e-9)
        ]
    except certrack.InputError as problem:
        pytest.skip(str(problem))
    for result in results:  # lanes follow e_1 by cubics between the nodes of their steps
        allowed = 1e-8 if method == "alone" else 2e-7
        tails = result.summary()["tail_error"]
        assert tails["max"] == pytest.approx(right, abs=allowed)
        assert tails["min"] == pytest.approx(right, abs=allowed)


def bump(begin, end):
    return lambda t: 3 * np.exp(-(((t - 10) / 0.02) ** 2))


BUMP = [0.0, 9.0, *np.linspace(9.8, 10.2, 21), 11.0, 20.0]


@pytest.mark.parametrize("method", ["taylor", "scipy", "implicit"])
@pytest.mark.parametrize(
    ("name", "sine", "stated"),
    [("smooth_bump_rest", 0.0, 0.0188064), ("smooth_bump_sine", 0.2, 0.0852862)],
)
def test_a_smooth_bump_of_time_is_not_missed(name, sine, stated, method):
    run = certrack.simulate(load(name, integrator=method))
    right = double_integrator(bump, BUMP, sine=sine)
    assert right == pytest.approx(stated, abs=1e-7)
    assert run.metrics.tail_error == pytest.approx(right, abs=1e-8)
    (note,) = run.notes
    assert "scanned on" in note


@pytest.mark.parametrize("name", ["rest_smooth_start", "rest_one_minus_cos", "rest2"])
def test_the_taylor_method_starts_at_rest(name):
    run = certrack.simulate(load(name, integrator="auto"))
    assert (run.trajectory.method, run.notes) == ("taylor", ())
    assert run.outcome is certrack.Outcome.finished
    assert len(run.trajectory.times) < 40
    other = certrack.simulate(load(name, integrator="scipy"))
    t = np.linspace(0, run.trajectory.end, 401)
    states = run.trajectory.interpolate(t)
    np.testing.assert_allclose(states, other.trajectory.interpolate(t), atol=1e-8)


@pytest.mark.parametrize("method", ["taylor", "scipy", "implicit"])
def test_metrics_are_as_accurate_as_the_run(method):
    run = certrack.simulate(load("scipy_metric", integrator=method))
    right = double_integrator(triangle, PULSE, sine=0.2)
    assert right == pytest.approx(0.07934642, abs=1e-8)
    assert run.metrics.tail_error == pytest.approx(right, abs=1e-8)


def test_one_simulator_serves_two_threads():
    """What "threads" of the cases does."""
    simulator = certrack.Simulator(certrack.load("example1"))

    def one(i):
        return simulator.run(simulator.system.with_settings(x0=(0.1 * i, 0.2))).metrics.rms_error

    alone = [one(i) for i in range(40)]
    with ThreadPoolExecutor(2) as pool:
        assert [list(pool.map(one, range(40))) for _ in range(3)] == [alone] * 3


@pytest.mark.parametrize("name", ["pulse_decayed_tri", "smooth_bump_rest"])
def test_two_threads_see_the_same_events(name):
    simulator = certrack.Simulator(load(name))

    def one(i):
        system = simulator.system.with_settings(x0=(0.01 * i, 0.0), duration=11 + 0.01 * i)
        return simulator.run(system).metrics

    alone = [one(i) for i in range(8)]
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(one, range(8))) == alone


def test_systems_and_simulators_can_be_pickled():
    """What "pickle_system" of the cases does; the copy runs as the original does."""
    for system in (certrack.load("example1"), load("pulse_decayed_tri")):
        copy = pickle.loads(pickle.dumps(system))
        assert copy == system
        simulator = certrack.Simulator(system)
        again = pickle.loads(pickle.dumps(simulator))
        assert again.run().metrics == simulator.run().metrics == certrack.simulate(copy).metrics

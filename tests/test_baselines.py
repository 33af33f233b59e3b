"""The laws of the textbooks: each is a law like any other, and does what its formulas promise."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import minimize

import certrack
from certrack.cli import main
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.core.lowering import numpy_callable
from certrack.integrators.sampled.events import event_timeline
from certrack.laws.baselines.adrc import Adrc
from certrack.laws.baselines.base import placed_feedback, sliding_row
from certrack.laws.baselines.l1 import L1Adaptive
from certrack.laws.baselines.mpc import MOVES, Mpc
from certrack.laws.baselines.mrac import Mrac
from certrack.laws.baselines.pid import Pid
from certrack.laws.baselines.sliding import SlidingMode
from certrack.laws.baselines.super_twisting import SuperTwisting
from certrack.laws.plant_coordinates import output_derivatives
from certrack.laws.registry import BASELINES
from certrack.loops.controller import resolved, sampled_controller, starting_state
from certrack.loops.controller_values import controller_values
from certrack.model.distribution import Distribution
from certrack.model.implementation import Implementation
from certrack.simulation import sampled as sampled_runs
from certrack.simulation.planned_input import PlannedMaps, limited_plans
from certrack.simulation.sampled import SampledSimulator
from certrack.testing import LawConformance


def benchmark(law, **settings):
    """Example 1 with known parameters."""
    base = certrack.load("example1")
    plant = certrack.Plant(
        **{name: getattr(base.plant, name) for name in ("states", "chain", "linear", "drift")},
        regressor=base.plant.regressor,
        gain_sign=1,
        input_gain=2,
        theta=[2],
        uncertainty=base.plant.uncertainty,
    )
    settings = {"duration": 6, "tail": 3} | settings
    return base.replace(plant=plant, law=law).with_settings(**settings)


class TestPid(LawConformance):
    system = benchmark(Pid(k_p=30, k_i=20, k_d=8, filter_time=0.01, feedforward=1))


@pytest.mark.slow
class TestSlidingMode(LawConformance):
    system = benchmark(SlidingMode(feedforward=1))


@pytest.mark.slow
class TestSuperTwisting(LawConformance):
    system = benchmark(SuperTwisting(feedforward=1))


class TestAdrc(LawConformance):
    system = benchmark(Adrc(feedforward=1))


@pytest.mark.slow
class TestMrac(LawConformance):
    system = benchmark(Mrac(feedforward=1))


@pytest.mark.slow
class TestL1(LawConformance):
    system = benchmark(L1Adaptive(feedforward=1))


@pytest.mark.parametrize("law", BASELINES)
def test_a_file_can_name_it(law):
    system = benchmark(law(feedforward=1))
    assert certrack.loads(certrack.to_text(system)) == system
    assert not certrack.certify(system).best.verified
    assert "minimises" not in str(system.design()) and "margins" not in str(system.design())


def test_poles_are_where_they_are_placed():
    plant = certrack.load("dual-motor-lean").plant
    F = plant.b + np.eye(3, 4, 1) * plant.g[:, None]
    poles = np.linalg.eigvals(np.vstack([F, placed_feedback(plant, 3.0)]))
    np.testing.assert_allclose(np.poly(poles), np.poly([-3.0] * 4), rtol=1e-9)
    row = sliding_row(plant, 2.0)  # x_4 where sigma = 0
    on_surface = F[:, :3] - np.outer(F[:, 3], row[:3])
    np.testing.assert_allclose(np.poly(on_surface), np.poly([-2.0] * 3), rtol=1e-9)
    rows = output_derivatives(plant)
    np.testing.assert_allclose(rows[2], [-12, 0, 12, 0])  # x_1'' = 2 K_L/J_L (x_3 - x_1)


class TestMpc(LawConformance):
    system = benchmark(Mpc(feedforward=1))


def next_states(system, x, Y, first):
    """Command and own states after one sample, by the controller's formulas."""
    drive = system.implementation
    controller = sampled_controller(system.plant, system.controller, drive)
    states = starting_state(controller, system.estimates, drive)
    if not first:
        states[-1] = 0.0  # what says that it is the first sample
    numbers = controller_values(controller, system.plant, system.law, drive)
    command, after = resolved(controller)
    names = [controller.measured, controller.Y, controller.states, controller.parameters]
    values = numpy_callable(names, [command, *after[: len(controller.estimates)]])
    return [float(v) for v in values(x, Y, states, numbers)]


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("limit", [1e6, 0.5])
def test_the_observer_of_adrc_is_exact_begins_at_the_output_and_sees_the_limited_input(
    first, limit
):
    drive = Implementation(period=0.01, update="exact_leak", saturation=(-limit, limit))
    law = Adrc(feedforward=1, rate=4.0, observer_rate=60.0)
    system = benchmark(law).replace(implementation=drive)
    x, Y = (0.7, -0.2), (0.1, 0.3, -0.2)
    u, *z = next_states(system, x, Y, first)
    assert abs(u) <= limit
    n, numbers = 2, law.parameters(system.plant)
    A = np.diag(np.ones(n), 1) - np.outer(numbers["l"], np.eye(n + 1)[0])
    inputs = np.array([numbers["l"], [0.0, numbers["b_0"], 0.0]]).T
    block = np.zeros((n + 3, n + 3))
    block[: n + 1, : n + 1], block[: n + 1, n + 1 :] = A, inputs
    exact = expm(block * drive.period)[: n + 1]
    begin = [x[0] if first else 0.0, 0.0, 0.0]
    np.testing.assert_allclose(z, exact @ [*begin, x[0], u], rtol=1e-9, atol=1e-12)


def test_the_predictor_of_l1_begins_at_the_state_and_sees_the_limited_input():
    law = L1Adaptive(feedforward=1)
    misses = []
    for limit in (1e6, 0.5):
        drive = Implementation(period=1e-6, saturation=(-limit, limit))
        system = benchmark(law).replace(implementation=drive)
        u, predicted, _ = next_states(system, (0.7, -0.2), (0.1, 0.3, -0.2), first=True)
        misses.append((u, predicted))
    (free, p_free), (cut, p_cut) = misses
    assert abs(free) > 0.5 and abs(cut) == 0.5
    assert p_cut - p_free == pytest.approx(1e-6 * 2.0 * (cut - free), rel=1e-6)  # g_n = 2


def test_mrac_adapts_a_gain_of_each_regressor():
    names = [str(z) for z in benchmark(Mrac(feedforward=1)).controller.states]
    assert len(names) == 2 + 1 + 1 + 1  # xi, nu, phi and a constant


def predictive(period=0.01, **keys):
    base = certrack.load("dual-motor-lean").with_settings(duration=1.5, tail=1.0)
    law = Mpc(feedforward=3, weight=400.0, horizon=0.4, **keys)
    return base.replace(law=law, implementation=Implementation(period=period))


def test_within_its_limits_the_plan_is_the_linear_feedback():
    free, wide = certrack.simulate(predictive()), certrack.simulate(predictive(input_limit=50.0))
    np.testing.assert_allclose(wide.u, free.u, rtol=1e-12, atol=1e-15)
    assert free.metrics.peak_input > 2.0


def _law_input(system, x, Y):
    """u = law(x, Y) without limits."""
    controller, plant = system.controller, system.plant
    names = [controller.signals.x, controller.signals.Y, controller.symbols]
    formula = controller.equations.u.subs({symbol(k): v for k, v in plant.constant_values.items()})
    return float(numpy_callable(names, [formula])(x, Y, controller.values)[0])


def test_a_plan_is_the_least_cost_within_the_limits_by_another_solver():
    system = predictive(input_limit=1.5)
    simulator = SampledSimulator(system)
    line = event_timeline(system.implementation, 1.5, np.empty(0), np.empty(0))
    plans = limited_plans(system, line)
    maps = PlannedMaps(simulator.maps, simulator.loop, line, plans)
    A, B, K = system.law.plan_matrices(system.plant)
    g_n = system.law.known_gain(system.plant)
    x = np.array([-1.0, 1.0, 1.0, 0.0])
    Y = system.reference.values(np.zeros(1), 4)[:, 0]
    asked = _law_input(system, x, Y)
    plan = asked + plans.spread @ x + plans.offsets[0]
    xi = x - system.law.coordinates(system.plant).B @ Y[:-1]
    step, weight = system.law.horizon / MOVES, system.law.weight
    fed = plan - [
        K @ np.linalg.matrix_power(A + np.outer(B, K), j) @ xi / g_n for j in range(MOVES)
    ]
    far = np.linalg.matrix_power(A + np.outer(B, K), 200)
    assert np.abs(far).max() < 1e-3

    def cost(u):
        total, state = 0.0, xi
        for v in u - fed:
            total += step * (weight * state[0] ** 2 + v**2)
            state = A @ state + B * g_n * v
        for _ in range(400):  # what the last weight stands for
            v = K @ state
            total += step * (weight * state[0] ** 2 + (v / g_n) ** 2)
            state = A @ state + B * v
        return total

    assert np.abs(plan).max() > 1.5
    found = minimize(
        cost,
        np.clip(plan, -1.5, 1.5),
        bounds=[(-1.5, 1.5)] * MOVES,
        method="L-BFGS-B",
        options={"ftol": 1e-14, "gtol": 1e-9, "maxiter": 5000, "maxfun": 200_000},
    )
    applied = np.clip(plan[0] + maps._correction(plan), -1.5, 1.5)
    assert applied == pytest.approx(found.x[0], abs=2e-3)
    assert maps.solved == 1


@pytest.mark.parametrize("limit", [0.7, 1.5, 5.0])
@pytest.mark.parametrize(
    "real", [{}, {"delay": 1, "noise": (1e-4,) * 4, "saturation": (-1.0, 2.0)}]
)
def test_programs_solved_in_c_are_those_of_osqp(limit, real, monkeypatch):
    """An active-set method against one of operator splitting, on runs that meet the limits."""
    system = predictive(input_limit=limit)
    system = system.replace(implementation=Implementation(period=4e-3, **real))
    runs = []
    for events in (0, 10**9):
        monkeypatch.setattr(sampled_runs, "WORTH_COMPILING", events)
        runs.append(certrack.simulate(system))
    in_c, by_osqp = runs
    np.testing.assert_allclose(in_c.u, by_osqp.u, atol=1e-4 * limit)
    assert (np.abs(in_c.u) > 0.99 * min(limit, 1.0)).any() or limit > 2


def test_members_side_by_side_plan_as_each_alone():
    system = certrack.load("dual-motor-lean").with_settings(duration=1.5, tail=1.0)
    law = Mpc(feedforward=3, weight=400.0, horizon=0.4, input_limit=1.5)
    system = system.replace(law=law, implementation=Implementation(period=4e-3))
    figures = []
    for method in ("native", "alone"):
        group = certrack.ensemble(system, 9, seed=3, method=method)
        assert group.statistics.outcomes["finished"] == 9
        metrics = group.statistics.metrics
        figures.append([metrics[name].summary()["max"] for name in ("tail_error", "rms_error")])
        assert metrics["peak_input"].summary()["max"] == pytest.approx(1.5, rel=1e-9)
    together, alone = figures
    np.testing.assert_allclose(together, alone, rtol=1e-5)


def test_members_with_references_of_their_own_plan_alone():
    system = predictive(input_limit=1.5)
    population = replace(system.population, amplitude=Distribution("uniform", (0.5, 1.0)))
    with pytest.raises(InputError, match="plans of the input differ"):
        certrack.ensemble(system.replace(population=population), 2, method="native")


def test_its_inputs_keep_the_limit_and_members_do():
    system = predictive(input_limit=1.5)
    assert certrack.simulate(system).metrics.peak_input == pytest.approx(1.5)
    assert certrack.ensemble(system, 2).statistics.metrics["peak_input"].summary()["max"] <= 1.5


def test_what_is_said_without_osqp(tmp_path, monkeypatch, capsys):
    """Neither a traceback nor a run that is lost; what needs no plan, or plans in C, runs on."""
    monkeypatch.setitem(sys.modules, "osqp", None)
    limited = predictive(input_limit=1.5)
    for run in (certrack.simulate, lambda system: certrack.ensemble(system, 2, method="alone")):
        with pytest.raises(certrack.MissingExtra, match=r"pip install 'certrack\[mpc\]'"):
            run(limited)
    assert certrack.simulate(predictive()).metrics.peak_input > 2.0
    file = tmp_path / "limited.toml"
    file.write_text(certrack.to_text(limited))
    with pytest.raises(SystemExit) as stop:
        main(["simulate", str(file)])
    said = capsys.readouterr().err.strip()
    assert stop.value.code == 2
    assert said.count("\n") == 0 and "needs OSQP" in said and "certrack[mpc]" in said


def test_what_plans_cannot_do_is_refused(tmp_path):
    with pytest.raises(InputError, match="no export"):
        certrack.export_c(predictive(input_limit=1.5), tmp_path)
    with pytest.raises(InputError, match="needs a sampled controller"):
        predictive(input_limit=1.5).replace(implementation=None)
    limited = Implementation(period=0.01, rate_limit=10.0)
    with pytest.raises(InputError, match="rate_limit"):
        predictive(input_limit=1.5).replace(implementation=limited)

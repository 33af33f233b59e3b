"""The system as python-control blocks: the same responses as our own runs."""

import sys
from dataclasses import replace

import control
import numpy as np
import pytest

import certrack

EVERYTHING = {
    "offset": 0.0003,
    "delay": 0.5,
    "saturation": (-5, 5),
    "rate_limit": 200.0,
    "noise": (1e-3, 1e-3),
    "measurement_quantum": (1e-4, 1e-4),
    "velocity": ("x2",),
    "velocity_filter": 0.002,
    "update": "exact_leak",
    "projection": ((0.1, 2), (-5, 5)),
    "initial_input": 0.3,
}


def short(name, duration=2.0, **settings):
    system = certrack.load(name)
    return system.with_settings(duration=duration, tail=duration / 2, tolerance=1e-12, **settings)


def respond(blocks, T, **options):
    return control.input_output_response(blocks.loop, T, X0=blocks.X0, **options)


@pytest.mark.parametrize("name", ["example1", "example1-classic", "dual-motor-lean"])
def test_continuous_loop_reproduces_the_run(name):
    system = short(name)
    blocks = certrack.to_control(system)
    T = np.linspace(0, 2, 101)
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
    found = respond(blocks, T, solve_ivp_kwargs=options)
    run = certrack.simulate(system)
    n, states = system.plant.n, run.trajectory.interpolate(T)
    assert blocks.loop.dt == blocks.plant.dt == 0.0
    assert found.states == pytest.approx(states[: len(found.states)], abs=1e-8)
    assert found.outputs[:n] == pytest.approx(states[:n], abs=1e-8)
    assert found.outputs[n] == pytest.approx(run.input_of(T, states), rel=1e-8, abs=1e-8)
    assert found.outputs[n + 1] == pytest.approx(system.reference.values(T, 0)[0], abs=1e-15)


@pytest.mark.parametrize(
    ("name", "implementation"),
    [
        ("example1", {}),
        ("example1", EVERYTHING),
        ("example1", {"delay": 1, "anti_windup": "none", "saturation": (-5, 5)}),
        ("dual-motor-lean", {"delay": 2.25, "offset": 0.0004}),
    ],
)
def test_discrete_loop_reproduces_the_run(name, implementation):
    T, system = 0.001, short(name, 1.0)
    system = system.replace(implementation=certrack.Implementation(period=T, **implementation))
    blocks = certrack.to_control(system)
    assert blocks.loop.dt == blocks.plant.dt == blocks.controller.dt == T
    times = blocks.start + T * np.arange(990)
    found = respond(blocks, times)
    run = certrack.simulate(system)
    states, n = run.trajectory.interpolate(times), system.plant.n
    assert found.states[:n] == pytest.approx(states[:n], abs=1e-10)
    acting = times + (implementation.get("delay", 0) + 1e-4) * T
    assert found.outputs[n] == pytest.approx(run.input_of(acting, None), rel=1e-10, abs=1e-10)
    estimates = [f"controller_{z.name}" for z in system.controller.states]
    rows = [found.state_labels.index(label) for label in estimates]
    assert found.states[rows] == pytest.approx(states[n : n + len(rows)], abs=1e-10)


def test_reference_with_breaks_and_converter():
    """A break of the reference at a sample belongs to what follows; the converter rounds u."""
    T, system = 0.01, short("example1")
    system = system.replace(
        reference=certrack.triangle(amplitude=0.2, period=0.4),
        implementation=certrack.Implementation(period=T, input_quantum=0.25),
    )
    blocks = certrack.to_control(system)
    found = respond(blocks, T * np.arange(190))
    run = certrack.simulate(system)
    assert found.states[:2] == pytest.approx(run.trajectory.interpolate(found.time)[:2], abs=1e-10)
    rounded = np.rint(found.outputs[2] / 0.25) * 0.25
    assert rounded == pytest.approx(run.input_of(found.time + T / 2, None), abs=1e-10)


def test_a_jump_of_the_rates_is_crossed():
    """The first one is at t = 0."""
    T, system = 0.01, certrack.load("example1")
    truth = replace(system.truth, omega=("0", "5*sign(sin(2.1*t))"))
    implementation = certrack.Implementation(period=T)
    system = system.replace(truth=truth, implementation=implementation).with_settings(
        duration=4, tail=2
    )
    found = respond(certrack.to_control(system), T * np.arange(390))
    run = certrack.simulate(system)
    assert found.states[:2] == pytest.approx(run.trajectory.interpolate(found.time)[:2], abs=1e-7)


def test_blocks_are_pure_functions_with_names():
    blocks = certrack.to_control(certrack.load("example1"))
    assert blocks.plant.state_labels == blocks.plant.output_labels == ["x1", "x2"]
    assert blocks.controller.input_labels == ["x1", "x2", "y_d", "y_d_1"]
    assert blocks.controller.state_labels == ["delta_hat", "theta_hat_1"]
    first, again = (blocks.controller.output(0, [0.4, 2], [1, 2, 0.2, 0]) for _ in range(2))
    assert first == again
    matrix = blocks.plant.linearize([0, 0], [0]).A
    assert matrix[0] == pytest.approx([-3, 2], abs=0.1)


def test_escape_is_named():
    """python-control would call it an algebraic loop."""
    system = short("example1", x0=(1e3, 1e3), max_state=1e4).replace(
        implementation=certrack.Implementation(period=0.5, saturation=(-1, 1))
    )
    with pytest.raises(certrack.CertrackError, match=r"simulation\.max_state"):
        respond(certrack.to_control(system), 0.5 * np.arange(3))


def test_missing_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(certrack.MissingExtra, match=r"certrack\[control\]"):
        certrack.to_control(certrack.load("example1"))

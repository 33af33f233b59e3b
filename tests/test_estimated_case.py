"""The falsifier against the adaptive law with ranges: corners and linear programs as candidates."""

from __future__ import annotations

import math

import pytest

import certrack
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.falsify import falsify
from certrack.studies.falsifier.hunt import KERNELS
from certrack.studies.falsifier.linear.estimated import estimated_case, is_estimated, known_system

ADAPTIVE = """
[plant]
states = ["x", "v"]
chain = [1]
drift = "-d/m*v"
regressor = ["x"]
gain_sign = 1
[plant.constants]
m = 1
d = 1
[plant.ranges]
m = [0.7, 1.5]
d = [0.5, 1.5]
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]
[truth]
input_gain = "2/m"
theta = ["0.3/m"]
omega = [0, "0.1*sin(t)"]
[reference]
signal = "0.3*sin(2*t)"
[law]
kind = "adaptive"
c = [3, 3]
feedforward = 1
delta0 = 0.5
theta0 = [0.3]
leak_gain = 1
leak_theta = 1
gain_rate = 5
Gamma = [5]
[simulation]
x0 = [0, 0]
duration = 30
tail = 20
"""


def test_the_case_of_the_known_loop_is_run_with_the_adaptive_law():
    system = certrack.loads(ADAPTIVE)
    bounds = tuple(reference_bounds(system, 2))
    case = estimated_case(system, bounds)
    assert case.system.law is system.law or case.system.law == system.law
    values = {name: float(value.expr) for name, value in case.system.truth.constants}
    for name, (low, high) in system.plant.constant_boxes.items():
        assert low <= values[name] <= high
    assert any(values[n] in ends for n, ends in system.plant.constant_boxes.items())
    assert case.system.settings.estimates[0] == pytest.approx(values["m"] / 2)
    assert case.run.outcome.name == "finished"
    assert certrack.simulate(system).metrics.tail_error < case.error
    certificate = certrack.certify(system, effort="fast").best
    assert case.error <= certificate.bound
    assert known_system(system).law.kind == "robust"
    assert is_estimated(system) and not is_estimated(known_system(system))


def test_the_search_goes_on_from_it():
    system = certrack.loads(ADAPTIVE)
    found = falsify(system, budget=1)
    assert found.alarm is None and found.origin in ("search", KERNELS)
    case = estimated_case(system, tuple(reference_bounds(system, 2)))
    assert found.worst_error >= case.error and math.isfinite(found.worst_error)
    constants = dict(case.system.truth.constants)
    worst = dict(found.system.truth.constants)
    assert {n: v.text for n, v in worst.items()} == {n: v.text for n, v in constants.items()}

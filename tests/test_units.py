"""A certificate is the same in every unit of time, and in every unit common to all states."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import systems
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import certrack
from certrack.certificates import certify_semidefinite
from certrack.certificates.arithmetic import decimal
from certrack.certificates.cascade import certify_cascade
from certrack.certificates.estimates.cascade import cascade_estimate
from certrack.certificates.estimates.dual import semidefinite_estimate
from certrack.certificates.estimates.loop_data import PlainLoop
from certrack.certificates.estimates.peak_gains import peak_estimate
from certrack.certificates.estimates.riccati import riccati_estimate
from certrack.certificates.formulation import error_problem
from certrack.certificates.strength import critical_semidefinite
from certrack.laws import Robust
from certrack.model.plant import Plant
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references import SymbolicReference
from certrack.systems.system import Settings, System

#: Seconds in the new unit of time; old units in the new unit of the states.
TIMES, SIZES = (1e-6, 1e-3, 3.7, 3600.0, 1e8), (1e-9, 1e-3, 25.4, 1e6)

#: Relative difference that is allowed: of random systems, whose optimum may be flat, and of others.
SAME, SAME_EXACTLY = 1e-6, 1e-9

#: Smaller uncertainties than this are random numbers, not bounds: the solver hardly sees them.
SMALLEST = 1e-4


def times(values, factor):
    return tuple(value * factor for value in values)


def in_units(system, time, size):
    """The same loop with t in units of `time` seconds and x `size` times as large in number."""
    plant, law, truth, u = system.plant, system.law, system.truth, system.plant.uncertainty
    rates = {
        "chain": times([float(v.expr) for v in plant.chain], time),
        "linear": tuple(times([float(v.expr) for v in row], time) for row in plant.linear),
        "uncertainty": Uncertainty(times(u.tau, time), u.gamma, times(u.beta, size)),
        "input_gain": None if plant.input_gain is None else float(plant.input_gain.expr) * time,
        "theta": None,
    }
    if plant.theta is not None:
        rates["theta"] = times([float(v.expr) for v in plant.theta], time * size)
    gains = {"c": times(law.c, time)}
    gains |= {"k": tuple(times(row, 1 / time) for row in law.k)} if law.k else {}
    damped = 1 + 2 * law.order(plant)  # kappa is (d e_m/d y_d^(q))^2/(4 p)
    gains |= {"p": times(law.p, 1 / time**damped)} if law.p else {}
    if law.kind == "adaptive":
        gains |= {
            "gain_rate": law.gain_rate / (time * size**2),
            "leak_gain": law.leak_gain * (time * size) ** 2,
            "leak_theta": law.leak_theta / time,
            "delta0": law.delta0 / time,
            "theta0": times(law.theta0 or (0.0,) * plant.r, time * size),
            "Gamma": times(law.Gamma, time**2) if plant.r else None,
        }
    true_gain = float(truth.input_gain.expr) * time
    true_theta = times([float(v.expr) for v in truth.theta], time * size)
    signal = system.reference.numeric.subs(certrack.laws.TIME, certrack.laws.TIME * time) * size
    return System(
        plant=replace(plant, **rates),
        law=replace(law, **gains),
        reference=SymbolicReference(signal),
        truth=Truth(true_gain, true_theta),
        settings=Settings([0.0] * plant.n, 1.0),
    )


def bound_of(system):
    return certify_semidefinite(system)[0].bound


def test_the_error_matrix_of_a_damped_law_of_order_one_is_that_in_other_units():
    """Finite p, and 0 < q < n - 1: the damping of y_d^(q+1) has powers of the unit of time."""
    plant = Plant(states=["x1", "x2", "x3", "x4"], chain=[1.5, -2, 1], input_gain=2)
    law = Robust(c=[2, 1, 1.5, 1], k=[[1] * 2 * m for m in range(1, 5)], p=[4, 3, 2], feedforward=1)
    system = System(plant, law, SymbolicReference("sin(t)"), Truth(2), Settings([0] * 4, 1))
    M = error_problem(in_units(system, 1.0, 1.0), decimal).M
    assert pytest.approx(3.7 * M) == error_problem(in_units(system, 3.7, 25.4), decimal).M


@settings(max_examples=12, suppress_health_check=list(HealthCheck))
@given(
    systems(orders=st.integers(1, 4), kinds=("adaptive", "robust")),
    st.sampled_from(TIMES),
    st.sampled_from(SIZES),
)
def test_bounds_of_random_systems_are_those_in_other_units(system, time, size):
    u = system.plant.uncertainty
    assume(all(v == 0 or v > SMALLEST for v in (*u.tau, *u.gamma, *u.beta)))
    bound = bound_of(in_units(system, 1.0, 1.0))
    assume(math.isfinite(bound))
    assert bound_of(in_units(system, time, size)) == pytest.approx(bound * size, rel=SAME)


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean"])
@pytest.mark.parametrize("time", TIMES)
def test_shipped_systems_have_their_bound_in_every_unit(name, time):
    system = certrack.load(name)
    bound = bound_of(in_units(system, 1.0, 1.0))
    for size in SIZES:
        there = bound_of(in_units(system, time, size))
        assert there == pytest.approx(bound * size, rel=SAME_EXACTLY)


def estimates(system):
    """The bounds that a search computes: of a law with estimates, and of one without."""
    if system.law.kind == "adaptive":
        problem = error_problem(system, decimal)
        return [
            semidefinite_estimate(problem, 0.35).bound,
            cascade_estimate(problem, (0.35, 0.3)).bound,
        ]
    problem = PlainLoop.of(system).problem
    return [peak_estimate(problem).bound, riccati_estimate(problem).bound]


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean"])
@pytest.mark.parametrize("time", TIMES)
def test_what_a_search_computes_is_the_same_in_every_unit(name, time):
    system = certrack.load(name)
    bounds = np.array(estimates(in_units(system, 1.0, 1.0)))
    for size in SIZES:
        there = estimates(in_units(system, time, size))
        np.testing.assert_allclose(there, bounds * size, rtol=SAME_EXACTLY)


@pytest.mark.parametrize("time", [1e-6, 3600.0])
def test_the_first_and_last_stage_of_a_cascade_and_the_strength_are_the_same(time):
    system = certrack.load("example1")
    plant = replace(system.plant, drift="exp(5000*x2)")  # no centred stage
    system = system.replace(plant=plant)
    here, there = in_units(system, 1.0, 1.0), in_units(system, time, 1.0)
    assert certify_cascade(there)[0].bound == pytest.approx(
        certify_cascade(here)[0].bound, rel=SAME
    )
    assert critical_semidefinite(there) == pytest.approx(critical_semidefinite(here), rel=1e-3)


@pytest.mark.parametrize("chain", [1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e6])
def test_one_state_in_a_unit_of_its_own_has_a_bound(chain):
    """The smaller the unit of x_2, the less x_1 counts in ||x||: the bounds tend to a limit."""
    plant = Plant(
        states=["x1", "x2"],
        chain=[chain],
        input_gain=1,
        uncertainty=Uncertainty([0, 1], [0, 0.1], [0, 1]),
    )
    law = Robust(c=[2, 2], feedforward=1)
    system = System(plant, law, SymbolicReference("sin(t)"), Truth(1), Settings([0, 0], 1))
    certificate, _ = certify_semidefinite(system)
    assert certificate.verified
    if chain < 1e-5:
        assert certificate.bound == pytest.approx(0.02744, rel=1e-3)


def lean_chain(n):
    """x_i' = x_{i+1} + w_i with |w_i| <= 0 but the last: 0.1 (1e-3 ||x|| + 0.1)."""
    plant = Plant(
        states=[f"x{i + 1}" for i in range(n)],
        chain=[1] * (n - 1),
        drift="x1**2",
        input_gain=1,
        uncertainty=Uncertainty([0.0] * (n - 1) + [0.1], [1e-3] * n, [0.1] * n),
    )
    law, start = Robust(c=[3] * n, feedforward=1), Settings([0] * n, 20)
    return System(plant, law, SymbolicReference("0.2*cos(t)"), Truth(1), start)


@pytest.mark.parametrize(("n", "optimum"), [(12, 1.146), (16, 2.223), (20, 5.322)])
def test_lean_chains_are_proven_near_the_optima_of_another_method(n, optimum):
    """The optima are those of a Riccati equation with descent over the multipliers, in floats."""
    certificate, _ = certify_semidefinite(lean_chain(n))
    assert certificate.verified
    assert certificate.bound <= 1.005 * optimum

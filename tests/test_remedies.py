"""Remedies name what the law has, and findings what the controller does."""

from dataclasses import replace

import pytest

import certrack
from certrack import Linear, Robust
from certrack.certificates.implemented.certify import certify_implemented
from certrack.laws.observer import Observer
from certrack.model.implementation import Implementation
from certrack.simulation.implementation_notes import implementation_notes, quantum_error
from certrack.simulation.remedies import shorter_period, slower_law

JOINT, DRIVE = certrack.load("flexible-joint"), certrack.load("dual-motor-drive")
LEAN = certrack.load("dual-motor-lean")
FAST = tuple([60.0] * 4)


@pytest.mark.parametrize(
    ("law", "remedy"),
    [
        (Robust(c=FAST), "lower law.c"),
        (Linear(lqr={"error": 400}), "raise law.lqr.input"),
        (Linear(K=LEAN.controller.coordinates.nu_x), "lower law.K"),
    ],
)
def test_a_remedy_is_of_the_law(law, remedy):
    assert slower_law(LEAN.replace(law=law)).startswith(remedy)


def test_poles_that_the_chain_makes_fast_are_slowed_by_the_coupling():
    fast = JOINT.replace(
        plant=replace(JOINT.plant, chain=("1", "2000", "1"), constant_ranges={}),
        law=Robust(c=(9, 9, 9, 9)),
    )
    assert fast.controller.coordinates.fastest_pole > 1000
    assert slower_law(fast).startswith("set law.coupling = 0.5")
    slow = fast.replace(law=replace(fast.law, coupling=0.5))
    assert slow.controller.coordinates.fastest_pole < 20
    damped = LEAN.replace(law=certrack.load("dual-motor").law)
    assert "leave law.k and law.p out" in slower_law(damped)


def test_what_an_observer_estimates_is_not_said_to_be_differenced():
    drive = replace(DRIVE.implementation, velocity_filter=0.0)
    observed = DRIVE.replace(
        law=replace(DRIVE.law, observer=Observer(kind="eso", bandwidth=60)), implementation=drive
    )
    named = {finding.name: str(finding.detail) for finding in certrack.check(observed).findings}
    assert "quantum of x1" in named
    assert not {"quantum of x2", "quantum of x4"} & set(named)
    of_differences = certrack.check(DRIVE).findings
    assert any("from differences of x1" in finding.detail for finding in of_differences)


def test_notes_of_an_unstable_loop_name_the_observer():
    slow = replace(DRIVE.implementation, period=0.2, velocity_filter=0.0)
    law = replace(DRIVE.law, observer=Observer(kind="kalman", bandwidth=60))
    system = DRIVE.replace(law=law, implementation=slow)
    assert "change law.observer" in shorter_period(system)
    assert any(
        "Shorten implementation.period or delay, change" in note
        for note in implementation_notes(system)
    )


def test_quanta_hold_the_error_at_half_a_step_where_it_is_integrated():
    coarse = DRIVE.replace(implementation=replace(DRIVE.implementation, input_quantum=0.5))
    integrated = coarse.replace(law=replace(DRIVE.law, integral=3.0))
    assert quantum_error(integrated) == DRIVE.implementation.measurement_quantum[0] / 2
    assert quantum_error(coarse) > 2 * quantum_error(integrated)


def test_ranges_with_jitter_are_refused_in_a_word():
    drive = Implementation(period=0.001, delay=0.5, jitter=0.1)
    found, proofs = certify_implemented(JOINT.replace(implementation=drive), effort="fast")
    assert not proofs
    assert found.reason == (
        "implementation.jitter is not covered together with ranges of constants: "
        "leave it or plant.ranges out"
    )

"""The worst case of the adaptive law as a drive runs it: replayed, admissible, below the bound."""

import functools
import math
from dataclasses import replace

import flint
import numpy as np
import pytest
from adaptive_plants import EASY

import certrack
from certrack.certificates.bootstrap.tape import Tape
from certrack.certificates.sampled_adaptive.certify import certify_sampled_adaptive
from certrack.core.kinks import derivative
from certrack.studies.falsifier.falsify import falsify
from certrack.studies.falsifier.sampled_search import (
    SampledGuarantee,
    _SampledSearch,
    _worst_sensor_errors,
    attack_as_implemented,
)

#: The loop of first order on a drive.
ON_DRIVE = (
    EASY.rstrip()
    + """
estimates = [1, 0.5]
[implementation]
period = 0.005
delay = 0.5
noise_bound = [0.001]
"""
)


#: The same with a regressor that saturates.
KINKED = ON_DRIVE.replace('["x"]\ngain', '["min(max(x, -0.15), 0.15)"]\ngain')


@functools.cache
def attacked():
    return falsify(certrack.loads(ON_DRIVE), budget=1200)


@pytest.mark.slow
def test_the_adaptive_law_is_attacked_as_it_runs(tmp_path):
    found = attacked()
    drive = found.drive
    assert "drive" not in found.left_out
    assert found.alarm is None
    assert drive.estimate is None
    assert drive.runs > 12
    certrack.save(drive.system, tmp_path / "worst.toml")
    replayed = certrack.simulate(certrack.load(tmp_path / "worst.toml"))
    assert replayed.metrics.tail_error == pytest.approx(drive.worst_error, rel=1e-9)
    assert drive.system.implementation.period == 0.005


def test_sampling_and_sensors_hurt():
    """The continuous worst case is one of those that are run; a sensor's offset adds to it."""
    found = attacked()
    assert found.drive.worst_error > found.worst_error + 0.5 * 0.001


def test_the_case_keeps_what_the_assumptions_say():
    case = attacked().drive.system
    assert not certrack.check_assumption_1(case)
    system = certrack.loads(ON_DRIVE)
    assert (case.plant, case.law) == (system.plant, system.law)
    allowed = system.reference.bounds(1).values
    assert np.all(np.array(case.reference.bounds(1).values) <= np.array(allowed) * (1 + 1e-9))
    error = case.implementation.sensor_error
    assert error is None or abs(float(error[0].expr)) <= 0.001


def test_a_certificate_of_the_sampled_loop_is_not_exceeded():
    drive = attacked().drive
    if not drive.certificate.exists:
        pytest.skip(f"no certificate here: {drive.certificate.reason}")
    assert drive.certificate.verified
    assert not drive.limited
    assert drive.worst_error <= drive.certificate.bound
    below = replace(drive, certificate=replace(drive.certificate, bound=drive.worst_error * 0.99))
    assert below.exceeds


def test_kinks_of_a_regressor_have_slopes():
    """On a box across the kinks of min and max the slope is anything between its two sides."""
    x = certrack.loads(KINKED).plant.symbols[0]
    formula = certrack.loads(KINKED).plant.regressor[0].expr
    (slope,) = Tape([derivative(formula, x)], [x])([flint.arb(0.1, 0.1)])
    assert slope.contains(0)
    assert slope.contains(1)
    (inside,) = Tape([derivative(formula, x)], [x])([flint.arb(0, 0.1)])
    assert abs(inside - 1) < 1e-9


@pytest.mark.slow
def test_no_attack_beats_the_certificate_of_a_law_with_kinks():
    found = falsify(certrack.loads(KINKED), budget=1200)
    assert found.origin == "ascent"  # the population needs a smooth loop
    drive = found.drive
    assert drive.certificate.verified
    assert not drive.limited
    assert 0.5 * drive.certificate.bound < drive.worst_error < drive.certificate.bound


def test_sensors_stay_at_their_bounds():
    drive = certrack.Implementation(period=0.01, noise_bound=(0.1, 0.2, 0.0))
    variants = _worst_sensor_errors(drive, 3)
    values = {
        tuple(float(v.expr) for v in variant.sensor_error)
        for variant in variants
        if variant != drive
    }
    assert values == {(a, b, 0.0) for a in (0.1, -0.1) for b in (0.2, -0.2)}
    assert _worst_sensor_errors(certrack.Implementation(period=0.01), 3) == [
        certrack.Implementation(period=0.01)
    ]


def test_a_period_that_is_too_long_escapes():
    system = certrack.loads(ON_DRIVE.replace("period = 0.005", "period = 1.9"))
    drive = falsify(system, budget=400).drive
    assert drive.worst_error == math.inf or drive.worst_error > 3 * attacked().drive.worst_error
    assert not drive.exceeds


@pytest.mark.slow
def test_example1_at_one_millisecond():
    """With the file's own reference: that of the continuous worst case, 0.0447, turns too fast."""
    system = certrack.load("example1").replace(
        implementation=certrack.Implementation(period=0.001, delay=0.5)
    )
    drive = falsify(system, budget=1500).drive
    assert drive.certificate.verified
    assert 0.038 < drive.worst_error < drive.certificate.bound
    assert not drive.limited


def test_a_reference_that_turns_faster_is_not_covered():
    """The proof has the slope of y_d', which bounds of y_d and y_d' leave open."""
    system = certrack.loads(ON_DRIVE)
    certificate, proof = certify_sampled_adaptive(system)
    search = _SampledSearch(system, proof, lambda worst: None)
    assert certificate.verified and search.covered(search._placed(system))
    for text, covered in (("0.19*sin(t)", True), ("0.01*sin(20*t)", False)):
        case = search._placed(system.replace(reference=certrack.SymbolicReference(text)))
        assert max(case.reference.bounds(1).values) <= 0.2 * (1 + 1e-9)
        assert search.covered(case) is covered
    steep = system.replace(reference=certrack.SymbolicReference("0.01*sin(20*t)"))
    drive = attack_as_implemented(
        system,
        SampledGuarantee(certificate, proof),
        {"steep": steep},
        None,
        100,
        0,
        lambda *_: None,
    )
    assert not drive.limited
    assert drive.system.reference == system.reference

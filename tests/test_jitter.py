"""Samples and inputs off their times: in runs and in certificates of the loop as it runs."""

import json
from dataclasses import replace

import flint
import independent_checker
import numpy as np
import pytest
from test_implemented import NOISE, on_a_drive, random_drive

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.certify import certify_implemented, failed_cover
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.from_starts import bounds_from_start
from certrack.certificates.implemented.gains import output_gains
from certrack.certificates.implemented.outputs import output_rows
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.timing import TimedBounds, pulse_gains, rate_rows
from certrack.certificates.layout import digest_of
from certrack.core.errors import InputError
from certrack.integrators.sampled.events import event_timeline
from certrack.model.implementation import Implementation
from certrack.model.jitter import JITTER_PATTERNS, timing_shifts
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.linear.search import sampled_case

FAST = """
[plant]
states = ["x1", "x2"]
chain = [1]
linear = [[0]]
drift = "0"
regressor = []
gain_sign = 1
input_gain = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.01]
[truth]
input_gain = 1
omega = [0, "0.01*sin(3*t)"]
[reference]
signal = "0.5*sin(2*t)"
[law]
kind = "robust"
c = [20, 20]
feedforward = 1
[simulation]
x0 = [0, 1]
duration = 10
tail = 5
[implementation]
period = 0.005
delay = 0.5
"""


def fast(jitter, pattern="random", **entries):
    """A precise loop that moves fast: an early or late sample is most of its error."""
    system = certrack.loads(FAST)
    changes = {"jitter": jitter, "jitter_pattern": pattern} | entries
    return system.replace(implementation=replace(system.implementation, **changes))


# Runs ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pattern", JITTER_PATTERNS)
def test_shifts_are_within_the_jitter_and_have_a_seed(pattern):
    drive = Implementation(period=0.01, delay=0.5, jitter=0.2, jitter_pattern=pattern)
    shifts = timing_shifts(drive, 500)
    assert np.abs(shifts).max() <= 0.2 and np.abs(shifts).max() > 0.19
    assert (timing_shifts(drive, 500) == shifts).all()
    other = timing_shifts(replace(drive, seed=1), 500)
    assert (pattern == "random") == bool((other != shifts).any())


@pytest.mark.parametrize("pattern", JITTER_PATTERNS)
def test_no_sample_is_lost_where_two_may_meet(pattern):
    drive = Implementation(period=0.01, delay=1.3, jitter=0.5, jitter_pattern=pattern)
    line = event_timeline(drive, 1.003, np.empty(0), np.empty(0))
    assert line.samples.sum() >= 100
    assert line.acts.sum() >= 98
    assert not timing_shifts(replace(drive, jitter=0.0), 5).any()


@pytest.mark.parametrize("pattern", JITTER_PATTERNS)
@pytest.mark.parametrize("delay", [0.5, 1.0, 1.7])
def test_inputs_follow_their_samples(pattern, delay):
    drive = Implementation(period=0.01, delay=delay, jitter=0.25, jitter_pattern=pattern)
    line = event_timeline(drive, 2.0, np.empty(0), np.empty(0))
    samples, acts = line.times[line.samples], line.times[line.acts]
    nominal = line.clock[line.samples]
    assert nominal == pytest.approx(0.01 * np.arange(200))
    assert (np.abs(samples - nominal) <= 0.0025 + 1e-12).all() and samples[0] >= 0
    late = acts - samples[: len(acts)]
    assert (late >= 0).all() and (np.abs(late - delay * 0.01) <= 0.005 + 1e-12).all()


def test_a_late_sample_is_an_error_of_the_position():
    """The law steers what it measures at k T + j T to y_d(k T): x_1 lags y_d by j T."""
    exact, late = (certrack.simulate(fast(j, "late")).metrics.tail_error for j in (0.0, 0.25))
    assert late - exact == pytest.approx(0.25 * 0.005 * 1.0, rel=0.15)


@pytest.mark.slow
def test_members_have_the_times_of_the_run():
    population = certrack.Population(disturbance="file", x0=((0.0), (1.0)))
    system = fast(0.2, noise=(1e-4, 0.0)).replace(population=population)
    found = certrack.ensemble(system, members=3, seed=0)
    member = certrack.simulate(found.member(1))
    errors = found.frame()["tail_error"]
    assert errors[1] == pytest.approx(member.metrics.tail_error, rel=1e-6)


def test_a_jitter_that_turns_samples_and_inputs_around_is_refused():
    with pytest.raises(InputError, match="jitter: must be at most half of every delay"):
        Implementation(period=0.01, delay=(0.5, 0.3), jitter=0.2)


# Certificates -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shaken():
    system = fast(0.05, measurement_quantum=(1e-4, 0.0))
    return system, *certify_implemented(system)


def test_a_jitter_too_small_is_caught():
    """Proven without jitter, run with it; with its own jitter the bound holds."""
    without, _ = certify_implemented(fast(0.0))
    found, _ = certify_implemented(fast(0.25))
    worst = max(certrack.simulate(fast(0.25, p)).metrics.tail_error for p in JITTER_PATTERNS)
    assert without.bound < worst <= found.bound
    least, _ = certify_implemented(fast(1e-9))
    assert without.bound <= least.bound <= without.bound * (1 + 1e-3)


def test_the_bound_grows_with_the_jitter():
    """States measured, three derivatives fed forward, noise within 1e-4."""
    base = on_a_drive("dual-motor-lean", 0.001, noise=NOISE)
    system = base.replace(law=replace(base.law, feedforward=3))
    for jitter, most in ((0.0, 0.000439), (0.01, 0.000444), (0.1, 0.000493)):
        drive = replace(system.implementation, jitter=jitter)
        found, _ = certify_implemented(system.replace(implementation=drive))
        assert 0.99 * most < found.bound <= most


def test_the_file_is_verified_here_and_by_the_page(shaken):
    system, found, proofs = shaken
    assert found.verified and found.parts["jitter"] > 0
    document = to_document(system, *proofs)
    assert verify(document).verified
    (timing,) = (p for p in document["premises"] if p["name"] == "timing and arithmetic")
    assert "within 0.05 periods" in timing["detail"]
    assert float(independent_checker.check(document)) == pytest.approx(found.bound)
    more = json.loads(json.dumps(document))
    more["system"] = more["system"].replace("jitter = 0.05", "jitter = 0.06")
    more["sha256"] = digest_of(more)
    assert not verify(more).verified
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(more)


def smaller(text, factor=0.99):
    return repr(float(text) * factor)


MUTANTS = {
    "rates": lambda p: replace(p, rates=tuple(map(smaller, p.rates))),
    "one rate": lambda p: replace(p, rates=(p.rates[0], smaller(p.rates[1]))),
    "no rates": lambda p: replace(p, rates=()),
    "step": lambda p: replace(p, step=smaller(p.step)),
    "states": lambda p: replace(p, states=tuple(map(smaller, p.states))),
    "input": lambda p: replace(p, input=smaller(p.input)),
    "bound": lambda p: replace(p, bound=smaller(p.bound)),
    "negative": lambda p: replace(p, rates=tuple(f"-{v}" for v in p.rates)),
    "zero": lambda p: replace(p, rates=("0", "0"), step="0"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_changed_proofs_with_jitter_are_refused(shaken, name):
    system, _, (proof,) = shaken
    assert failed_cover(system, (proof,)) == ""
    assert failed_cover(system, (MUTANTS[name](proof),)) != ""


def test_a_proof_without_jitter_is_none_with_it(shaken):
    system, _, _ = shaken
    _, proofs = certify_implemented(fast(0.0, measurement_quantum=(1e-4, 0.0)))
    assert failed_cover(system, proofs) != ""
    without = fast(0.0, measurement_quantum=(1e-4, 0.0))
    assert failed_cover(without, shaken[2]) != ""


def test_a_window_that_reaches_into_the_next_period_counts_in_both():
    """With a delay of one period an input may change on either side of a sample."""

    def gains(delay, jitter):
        with flint.ctx.workprec(DRIVE_BITS):
            drive = drive_of(fast(jitter, delay=delay))
            period = one_period(drive, (2, 2))
            return pulse_gains(period, output_rows(period), 9)

    assert (gains(1.0, 0.1) >= 1.99 * gains(1.0, 0.0)).all()
    assert gains(0.5, 0.2) == pytest.approx(gains(0.5, 0.0))
    # each pulse adds at least what b at the sample does: a row of x_2 sees 1 of it at once
    assert gains(0.5, 0.2).max() > 0.9


def test_nothing_is_said_of_a_start_with_jitter():
    """The bounds from a start are those of exact times."""
    with pytest.raises(NoCertificate, match="with jitter"):
        bounds_from_start(fast(0.1))
    assert bounds_from_start(fast(0.0)).peaks.error > 0


def test_two_inputs_may_change_in_a_cell_that_is_a_whole_period():
    """One late at its begin, the next early at its end: each adds up to j T in the cell."""

    def in_cell(delay):
        with flint.ctx.workprec(DRIVE_BITS):
            drive = drive_of(fast(0.1, delay=delay))
            period = one_period(drive, (1, 1))
            rows = output_rows(period) + rate_rows(period)
            bounds = OutputBounds.of(period, rows, output_gains(period, rows, 9))
            timed = TimedBounds.of(period, rows, bounds, 9)
            pulses = pulse_gains(period, rows, 9)
            shift = float(drive.jitter * drive.T)
        moving = [i for i, row in enumerate(rows) if row.output == 2]
        return [float(timed.by_step[i]) / shift - pulses[i] for i in moving]

    assert in_cell(0.5) == pytest.approx([1.0] * len(in_cell(0.5)), rel=0.01)
    assert in_cell(1.0) == pytest.approx([2.0] * len(in_cell(1.0)), rel=0.01)


@pytest.mark.parametrize(
    ("system", "words"),
    [
        (on_a_drive("dual-motor-lean", 0.01, jitter=0.1, saturation=(-50, 50)), "limits"),
        (
            certrack.load("dual-motor-drag").replace(
                implementation=Implementation(period=0.005, delay=0.5, jitter=0.1)
            ),
            "grows faster",
        ),
        (on_a_drive("dual-motor-lean", 0.003, ("x2", "x4"), jitter=0.25), None),
    ],
)
def test_what_is_not_covered_with_jitter_says_so(system, words):
    found, proofs = certify_implemented(system)
    if words is None:
        assert found.exists and found.bound > 0.002
    else:
        assert not found.exists and not proofs and words in found.reason


@pytest.mark.slow
def test_no_attack_of_random_loops_with_jitter_is_above_the_bound():
    rng, tried = np.random.default_rng(5), 0
    while tried < 8:
        system, *_ = random_drive(rng)
        drive = system.implementation
        jitter = float(rng.choice([0.02, 0.1, 0.25]))
        delay = float(rng.choice([0.5, 1.0, 1.6]))
        system = system.replace(
            implementation=replace(
                drive, delay=delay, jitter=jitter, saturation=None, rate_limit=None
            )
        )
        found, _ = certify_implemented(system)
        if not found.exists:
            continue
        case = sampled_case(
            system, tuple(reference_bounds(system, system.controller.coordinates.q + 1))
        )
        if case is None:
            continue
        tried += 1
        assert case.error <= found.bound

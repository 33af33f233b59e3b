"""Bounds for all time from a start, and the starts from which no limit of the input is met."""

import json
import math
from dataclasses import replace

import flint
import independent_checker
import numpy as np
import pytest
from depth import depth
from start_attack import worst_from
from test_implemented import ENCODER, UNIT_W, bare_drive, command, on_a_drive, random_drive

import certrack
from certrack.certificates import certify, to_document, verify
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import lags as lags_room
from certrack.certificates.implemented import start_proof as start_proof_room
from certrack.certificates.implemented.certify import certify_implemented, failed_cover
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.from_starts import bounds_from_start, failed_starts
from certrack.certificates.implemented.gains import output_gains
from certrack.certificates.implemented.lags import lag_gains
from certrack.certificates.implemented.outputs import output_rows
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.proof import cells_of, delays, start_prover
from certrack.certificates.implemented.start import FromStarts, Later, Starts, is_above
from certrack.certificates.implemented.start_proof import MOST_DOUBLINGS
from certrack.certificates.implemented.start_set import POLYTOPE, X0, start_set_of
from certrack.model.distribution import Distribution
from certrack.reports.sampled import implemented_notes, implemented_summary
from certrack.studies.ensembles.error_limit import limit_and_starts, started_inside

LIMITS = {"saturation": (-15.0, 15.0)}


def lean(T=0.01, speeds=("x2", "x4"), **entries):
    return on_a_drive("dual-motor-lean", T, speeds, **entries)


def peaks(certificate):
    """Of e_1, the states, the input, its steps."""
    p = certificate.peaks
    return np.array([p.error, *p.states, p.input, p.input_step])


# Bounds -------------------------------------------------------------------------------------------


def test_input_from_the_start_of_the_lean_motor():
    """At 3 ms, speeds measured: 13.2 was simulated, +-15 is never met."""
    found, (proof,) = certify_implemented(lean(0.003, (), **LIMITS))
    assert 13.2 < found.peaks.input <= 13.8
    assert found.verified and found.saturation == "inactive" and found.starts == "x0"
    assert [start.of for start in proof.starts] == [X0, POLYTOPE]
    assert found.admits((-1, 1, 1, 0)) and not found.admits((1, 1, 1, 1))


def test_no_attack_from_the_start_is_above_the_bounds():
    system = lean(0.003, ())
    found, _ = certify_implemented(system, from_start=True)
    assert found.saturation == "none" and found.starts == "any" and found.admits((9, 9, 9, 9))
    places = [int(t / 0.003) for t in (0, 0.05, 0.1, 0.3, 0.8)]
    attack = worst_from(system, system.settings.x0, 0.1, 0.75, places)
    assert (attack <= peaks(found)).all()
    assert attack[5] > 0.95 * found.peaks.input


def attacked(seed, count):
    """Bounds over attacks of random loops from random starts, each output."""
    rng, ratios = np.random.default_rng(seed), []
    while len(ratios) < count:
        system, amplitude, frequency = random_drive(rng)
        n = system.plant.n
        x0 = tuple(np.round(rng.uniform(-1, 1, n), 3).tolist())
        first = float(rng.choice([0, 0.7]))
        system = system.replace(
            settings=replace(system.settings, x0=x0),
            implementation=replace(system.implementation, initial_input=first),
        )
        found, _ = certify_implemented(system, from_start=True)
        if not found.exists:
            continue
        assert found.peaks is not None
        attack = worst_from(system, x0, amplitude, frequency, [0, 1, 2, 4, 8, 20, 60])
        ratios.append(peaks(found) / np.maximum(attack, 1e-12))
        assert (ratios[-1] >= 1).all(), (seed, system.implementation, x0, ratios[-1])
    return [ratio[-2] for ratio in ratios]


def test_no_attack_beats_the_bounds_of_random_loops():
    assert np.median(attacked(1, 5)) < 1.1


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(1, 12)))
def test_no_attack_beats_the_bounds_of_many_random_loops(seed):
    assert np.median(attacked(50 + seed, 25)) < 1.1


def test_the_simulator_starts_where_the_bounds_do():
    """Without disturbance and noise the peak of u is nearly that of the bounds."""
    base = lean(0.01, ("x2", "x4"), measurement_quantum=None)
    quiet = replace(base.plant.uncertainty, gamma=(0,) * 4, beta=(0,) * 4)
    system = base.replace(
        plant=replace(base.plant, uncertainty=quiet), truth=replace(base.truth, omega=None)
    )
    found, _ = certify_implemented(system, from_start=True)
    run = certrack.simulate(system, duration=2)
    assert np.abs(run.u).max() <= found.peaks.input <= 1.02 * np.abs(run.u).max() + 0.3
    assert (np.abs(run.x).max(axis=1) <= found.peaks.states).all()


def beyond(system, bounds, run):
    """By how much a run leaves the bounds, at its worst; negative inside."""
    k = (run.t / system.implementation.period * (1 + 1e-12)).astype(int)
    late = (k >= len(bounds.values))[:, None]
    limits = np.where(late, bounds.last, bounds.values[np.minimum(k, len(bounds.values) - 1)])
    outputs = np.abs(np.vstack([run.e[:1], run.x]))
    return (outputs.T - limits[:, : len(outputs)]).max()


@pytest.mark.parametrize("speeds", [(), ("x2", "x4")])
def test_runs_of_the_simulator_stay_inside(speeds):
    """It quantises, delays and differences by its own code; a constant in the drift counts."""
    base = lean(0.01, speeds)
    system = base.replace(plant=replace(base.plant, drift="K_L/J_M*(x1 - x3) + 6"))
    bounds = bounds_from_start(system)
    run = certrack.simulate(system, duration=3.0)
    assert beyond(system, bounds, run) < 0
    assert run.metrics.peak_input <= bounds.peaks.input <= 1.15 * run.metrics.peak_input
    smaller = replace(bounds, values=bounds.values * 0.9, last=bounds.last * 0.9)
    assert beyond(system, smaller, run) > 0  # so it is near enough to be a test
    assert math.isclose(bounds.offset, 0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "signal", ["0.05*tanh(max(t - 1, 0))", "0.02*max(t - 1, 0) - 0.02*max(t - 1.5, 0)"]
)
def test_jumps_of_the_reference_count(signal):
    """The long run forgets one that happens once; a run from its start does not."""
    base = lean(0.01, ())
    system = base.replace(
        reference=certrack.SymbolicReference(signal),
        law=replace(base.law, feedforward=0),
        settings=replace(base.settings, x0=(0.0,) * 4),
    )
    bounds, run = bounds_from_start(system), certrack.simulate(system, duration=4.0)
    assert beyond(system, bounds, run) < 0 and run.metrics.peak_input <= bounds.peaks.input
    smaller = replace(bounds, values=bounds.values * 0.4, last=bounds.last * 0.4)
    assert beyond(system, smaller, run) > 0


def test_lags_are_the_gains_period_by_period():
    system = lean(0.02)
    with flint.ctx.workprec(DRIVE_BITS):
        drive = drive_of(system)
        period = one_period(drive, cells_of(drive))
        rows = output_rows(period)
        whole, lags = output_gains(period, rows, 8), lag_gains(period, rows, 8)
    total = lags.running + lags.lags.sum(axis=0) + lags.tail
    nw = drive.W.ncols()
    assert total[:, :nw] == pytest.approx(whole.w, rel=1e-8, abs=1e-15)
    assert total[:, nw] == pytest.approx(whole.r, rel=1e-8, abs=1e-15)
    assert (lags.tail[:, :nw] > 0).any() and (lags.running[:, :nw] > 0).any()


def test_any_phase_of_the_reference():
    """With another phase than the file's the input may be larger, and the bounds know."""
    system = lean(0.01, ())
    bounds = bounds_from_start(system, any_reference=True)
    largest = np.array([bounds.peaks.error, bounds.peaks.input])
    assert 17 < bounds.peaks.input < 18.5 and bounds_from_start(system).peaks.input < 14
    assert bounds_from_start(system, [(-1, 1)] * 4).peaks.input > bounds.peaks.input
    places = [0, 5, 10, 30]
    for phase in np.linspace(0, 2 * math.pi, 7)[:-1]:
        attack = worst_from(system, system.settings.x0, 0.1, 0.75, places, phase, outputs=[0, 5])
        assert (attack[[0, 5]] <= largest).all()


# A finite horizon does not cover all time -------------------------------------------------------


class Squared(FromStarts):
    """|w| <= x_1^2."""

    def sizes(self, X):
        return np.array([X[0] ** 2 * (1 + 1e-12)])


def test_a_short_horizon_is_not_all_time():
    """x1' = x2, x2' = -x1 - 2 x2 + w, |w| <= x1^2 from (0, 5): 1e4 is passed at 3.48 s.

    For one period of 0.1 s all is well, and X at its end is above what the steady inequality makes
    of it: that once counted as a proof.
    """
    A, W = [[0, 1], [-1, -2]], [[0], [1]]
    w = replace(UNIT_W, weights=UNIT_W.weights * 2, Delta=UNIT_W.Delta * 2)
    drive = bare_drive(A, [0, 0], W, [0, 0], 0.1, [0.0] * 2, 0.0, [w])
    assert escape(np.array([0.0, 5.0])) < 3.6
    zero = flint.arb(0)
    starts = Starts((zero, flint.arb(5)), (zero,) * 2, (zero,), zero)
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive, (1, 8))
        for doublings in range(8, 4, -1):  # a gain of the w that stays small is not one of x1^2
            frame = Squared(period, doublings)
            transient = frame.transient(starts)
            assert not has_later(frame, starts, transient)
        small = Starts((zero, flint.arb(0.2)), (zero,) * 2, (zero,), zero)
        transient = frame.transient(small)
        gains = frame.gains
        total = frame.largest((gains.lags.sum(axis=0) + gains.tail + gains.running)[:, 0])
        assert (total[1:3] * 0.5**2 < [0.5, 5]).all()  # the inequality at the first period's end
        run = frame.run(small, transient)  # from a small start it is a proof
        assert max(frame.find_later(small, transient, run, 16).states) < 0.4


def has_later(frame, starts, transient):
    """Whether bounds for all time are found."""
    try:
        with np.errstate(all="ignore"):
            run = frame.run(starts, transient)
            frame.find_later(starts, transient, run, frame.count // 2)
    except NoCertificate:
        return False
    return True


SLOW = """
[plant]
states = ["x1", "x2"]
chain = [1]
linear = [[0]]
drift = "0"
regressor = []
gain_sign = 1
input_gain = 1
[plant.uncertainty]
tau = [1, 1]
gamma = [0.05, 0]
beta = [0, 0.1]
[truth]
input_gain = 1
omega = [0, 0]
[reference]
signal = "0.1*sin(0.1*t)"
[law]
kind = "robust"
c = [1, 1]
[simulation]
x0 = [0, 5]
duration = 20
[implementation]
period = 0.1
"""


def test_a_shortened_proof_is_refused():
    """x1 rises for a second. Ten periods do not show it, and only the last test knows."""
    system = certrack.systems.reader.loads(SLOW, "slow")
    found, proofs = certify_implemented(system, from_start=True)
    assert failed_cover(system, proofs) == ""
    (start,) = proofs[0].starts
    attack = worst_from(system, (0, 5), 0.1, 0.1, [10, 20])
    assert (attack <= peaks(found)).all() and attack[1] > 1.5
    low = ("0.7", "5.1")  # what eight periods and their end show, not more
    short = replace(
        start, doublings=3, middle=4, states=low, input="10", peaks=("0.8", *low, "12", "12")
    )
    assert float(low[0]) < attack[1]
    assert "not forgotten" in failed_cover(system, (replace(proofs[0], starts=(short,)),))
    early = replace(start, doublings=start.doublings - 1, middle=start.middle // 2, states=low)
    assert failed_cover(system, (replace(proofs[0], starts=(early,)),)) != ""


def test_an_engine_with_a_finite_horizon_is_beaten_by_the_attack(monkeypatch):
    """Four periods, and nothing asked of what comes later."""
    system = certrack.systems.reader.loads(SLOW, "slow")
    attack = worst_from(system, (0, 5), 0.1, 0.1, [10, 20])
    assert (attack <= peaks(certify_implemented(system, from_start=True)[0])).all()

    def last(self, starts, transient, run, middle):
        return Later(tuple(run.bounds[-1, 1:-2].tolist()), float(run.bounds[-1, -2]))

    def below(self, starts, transient, run, middle, later):
        return np.array([0, *later.states, later.input, 0]) * 0.999

    monkeypatch.setattr(lags_room, "tail_gains", lambda last, each, power: 0 * last @ each)
    monkeypatch.setattr(FromStarts, "_later_transient", lambda self, zeta: np.zeros(len(self.rows)))
    monkeypatch.setattr(FromStarts, "find_later", last)
    monkeypatch.setattr(FromStarts, "later_image", below)
    monkeypatch.setattr(start_proof_room, "FEWEST_DOUBLINGS", 2)
    wrong, _ = certify_implemented(system, from_start=True)
    assert attack[1] > 1.1 * wrong.peaks.states[0]


def escape(x, h=1e-4):
    """When a run of the loop above with w = +x1^2 passes 1e4, s."""
    for k in range(100_000):
        x = x + h * np.array([x[1], -x[0] - 2 * x[1] + x[0] ** 2])
        if abs(x[0]) > 1e4:
            return k * h
    return math.inf


# Certificates that are wrong --------------------------------------------------------------------


def scaled(texts, factor, i=None):
    return tuple(
        f"{float(v) * (factor if i in (None, k) else 1):.12g}" for k, v in enumerate(texts)
    )


MUTANTS = {
    "later states": lambda s: replace(s, states=scaled(s.states, 0.9)),
    "later input": lambda s: replace(s, input=scaled((s.input,), 0.9)[0]),
    "peak of the input": lambda s: replace(s, peaks=scaled(s.peaks, 0.999, 5)),
    "peak of the error": lambda s: replace(s, peaks=scaled(s.peaks, 0.999, 0)),
    "peak of a state": lambda s: replace(s, peaks=scaled(s.peaks, 0.999, 2)),
    "fewer periods": lambda s: replace(s, doublings=3, middle=4),
    "middle": lambda s: replace(s, middle=2**s.doublings),
    "other kind": lambda s: replace(s, of=POLYTOPE),
    "no such kind": lambda s: replace(s, of="box"),
    "no such phase": lambda s: replace(s, phase="best"),
    "a state less": lambda s: replace(s, states=s.states[1:]),
}


@pytest.fixture(scope="module")
def limited():
    system = lean(0.01, (), **LIMITS)
    return system, *certify_implemented(system)


@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutated_proofs_of_a_start_are_refused(limited, mutant):
    system, _, (proof,) = limited
    delay = delays(system)[0]
    assert failed_starts(system, proof, delay) == ""
    wrong = replace(proof, starts=(MUTANTS[mutant](proof.starts[0]), *proof.starts[1:]))
    assert failed_starts(system, wrong, delay) != ""


def test_negative_bounds_of_later_periods_prove_nothing(limited):
    system, _, (proof,) = limited
    start = proof.starts[0]
    for wrong in (
        replace(start, states=("-1", *start.states[1:])),
        replace(start, input=f"-{start.input}"),
    ):
        reason = failed_starts(system, replace(proof, starts=(wrong,)), delays(system)[0])
        assert "negative" in reason


def test_mutated_proofs_of_a_polytope_are_refused(limited):
    system, _, (proof,) = limited
    x0, polytope = proof.starts
    delay = delays(system)[0]
    for wrong in (
        (polytope,),
        (x0, x0),
        (x0, replace(polytope, region=polytope.region[1:])),
        (x0, replace(polytope, region=tuple(("-9", "9") for _ in polytope.region))),
        (x0, replace(polytope, states=scaled(polytope.states, 0.5))),
    ):
        assert failed_starts(system, replace(proof, starts=wrong), delay) != ""
    unlimited = system.replace(implementation=replace(system.implementation, saturation=None))
    assert "for an input with limits" in failed_starts(unlimited, proof, delay)


def test_limits_that_may_act():
    """What is proven of the unlimited loop is said, and nothing is verified."""
    found, proofs = certify_implemented(lean(0.01, (), saturation=(-12.0, 12.0)))
    assert not found.verified and proofs == () and found.saturation == "may act"
    assert found.starts == "polytope" and not found.admits((-1, 1, 1, 0)) and found.admits([0] * 4)
    assert "13." in found.reason and found.peaks.input > 12
    lopsided, _ = certify_implemented(lean(0.01, (), saturation=(-15.0, 2.0)))
    assert lopsided.saturation == "may act"


@pytest.mark.slow
def test_limits_that_may_act_leave_the_continuous_certificate():
    result = certify(lean(0.01, (), saturation=(-12.0, 12.0)))
    assert result.best is not result.implemented and "input limits" not in str(result.premises)


@pytest.mark.slow
def test_the_published_gains_may_stay_at_their_limits():
    published = on_a_drive("dual-motor", 0.001, ("x2", "x4"), **LIMITS)
    refused, _ = certify_implemented(published)
    assert "15.5" in refused.reason and not refused.exists and refused.starts == "none"


def test_rate_limits():
    steps = certify_implemented(lean(0.01, (), rate_limit=1e4))[0]
    assert steps.saturation == "inactive" and 10 < steps.peaks.input_step < 100
    tight = certify_implemented(lean(0.01, (), rate_limit=500.0))[0]
    assert tight.saturation == "may act" and "steps of u" in tight.reason
    assert tight.polytope.largest_box() is not None
    slow, _ = certify_implemented(lean(0.003, rate_limit=1.0))
    assert "rate limit" in slow.reason


def test_starts_that_are_not_covered():
    late, _ = certify_implemented(lean(0.01, (), offset=0.005, **LIMITS))
    assert "first sample is not at t = 0" in late.reason and late.starts == "none"
    assert late.exists and not late.verified


# The polytope -------------------------------------------------------------------------------------


def test_starts_in_the_polytope_stay_within_the_limits(limited):
    """Random starts at its faces, driven for the largest input."""
    system, found, _ = limited
    rng, polytope, largest = np.random.default_rng(3), found.polytope, []
    for _ in range(12):
        direction = rng.normal(size=4)
        room = polytope.limits / np.maximum(polytope.rows @ direction, 1e-12)
        part = min(room.min(), (1 / np.abs(direction)).min()) * (1 - 1e-9)
        start = part * direction
        assert polytope.contains(start)
        attack = worst_from(system, start, 0.1, 0.75, [0, 2, 5, 10, 20], outputs=[5])
        largest.append(attack[5])
    assert 14 < max(largest) <= 15


def test_membership_and_largest_box(limited):
    _, found, _ = limited
    polytope = found.polytope
    box = np.array(polytope.largest_box())
    assert 0.25 < box[0, 1] < 0.5
    corners = np.array(np.meshgrid(*box)).reshape(4, -1).T
    assert polytope.contains(corners).all() and found.admits(corners).all()
    assert not polytope.contains(1.01 * corners).all()
    assert [0.0] * 4 in polytope and [1.0] * 4 not in polytope and [1.1, 0, 0, 0] not in polytope
    starts = np.random.default_rng(0).uniform(-1, 1, (4000, 4))
    assert 0.6 < polytope.contains(starts).mean() < 0.85
    corners = polytope.section("x1", 2)
    inside = np.insert(0.999 * corners, 1, 0, axis=1)
    assert polytope.contains(np.insert(inside, 3, 0, axis=1)).all()
    assert len(polytope.section("x1", "x3", at=[0, 2, 0, 0])) == 0
    with pytest.raises(certrack.InputError):
        polytope.section("x1", "x1")
    with pytest.raises(certrack.InputError):
        found.admits([0, 0])


def test_a_box_that_is_proven_as_a_whole():
    system = lean(0.01, ())
    near = tuple(Distribution("uniform", (-0.2, 0.2)) for _ in range(4))
    system = system.replace(
        settings=replace(system.settings, x0=(0.1, 0, 0, 0)),
        population=replace(system.varied, x0=near),
        implementation=replace(system.implementation, **LIMITS),
    )
    found, proofs = certify_implemented(system)
    assert found.starts == "box" and found.polytope.is_region and found.admits([0.2] * 4)
    assert not found.admits([0.21, 0, 0, 0]) and failed_cover(system, proofs) == ""


def test_without_an_ensemble_the_region_is_that_of_the_limits():
    system = lean(0.01, (), **LIMITS).replace(population=None)
    found, _ = certify_implemented(system)
    assert found.starts == "x0" and found.admits(system.settings.x0)
    assert found.polytope.region[0][1] >= 1


# Delays, files, ensembles, pictures --------------------------------------------------------------


def test_every_delay_is_proven():
    one = certify_implemented(lean(0.01, (), **LIMITS))[0]
    system = lean(0.01, (), delay=(0.5, 0.0), **LIMITS)
    found, proofs = certify_implemented(system)
    assert found.verified and len(proofs) == 2 and found.peaks.input >= one.peaks.input
    assert len(found.polytope.rows) >= len(one.polytope.rows)
    assert failed_cover(system, proofs) == ""


def test_file_of_a_limited_drive(limited):
    system, _, proofs = limited
    document = to_document(system, *proofs)
    assert document["claim"].endswith("from simulation.x0")
    assert verify(document).verified
    assert not verify(document | {"claim": document["claim"].split(" from")[0]}).verified
    entry = document["proof"][0]
    without = document | {"proof": [entry | {"starts": []}]}
    assert not verify(without).verified
    for wrong in (
        [entry["starts"][0] | {"doublings": 9.0}],
        [entry["starts"][0] | {"states": "1"}],
        [entry["starts"][1] | {"region": [["1"]] * 4}],
        [{"of": "x0"}],
        entry["starts"] * 2,
    ):
        with pytest.raises(certrack.InputError):
            verify(document | {"proof": [entry | {"starts": wrong}]})
    elsewhere = system.replace(settings=replace(system.settings, x0=(1, 1, 1, 1)))
    assert "limits" in failed_cover(elsewhere, proofs) or failed_cover(elsewhere, proofs)


def test_another_checker_agrees(limited):
    """It was written from the page of the file, and sums every lag by itself."""
    system, _, proofs = limited
    assert independent_checker.check(to_document(system, *proofs)) > 0
    x0, polytope = proofs[0].starts
    for wrong in (
        (replace(x0, peaks=scaled(x0.peaks, 0.99, 5)), polytope),
        (x0, replace(polytope, states=scaled(polytope.states, 0.5))),
        (polytope,),
    ):
        document = to_document(system, replace(proofs[0], starts=wrong))
        with pytest.raises(independent_checker.Refused):
            independent_checker.check(document)


@pytest.mark.slow
def test_another_checker_agrees_on_random_loops():
    rng, held = np.random.default_rng(31), 0
    while held < 6:
        system, _, _ = random_drive(rng)
        x0 = tuple(np.round(rng.uniform(-1, 1, system.plant.n), 3).tolist())
        system = system.replace(settings=replace(system.settings, x0=x0))
        found, proofs = certify_implemented(system, from_start=True)
        if found.exists:
            assert independent_checker.check(to_document(system, *proofs)) > 0
            held += 1


def test_members_are_counted_apart():
    system = lean(0.01, (), **LIMITS)
    system = system.replace(settings=replace(system.settings, duration=1.0, tail=0.1))
    limit, origin, proven = limit_and_starts(system, None)
    assert origin == "certificate" and proven.bound == limit
    result = certrack.ensemble(system, 64, method="lockstep")
    counted = result.violations()
    assert f"; {counted['count']} beyond" in repr(result)
    assert 30 < counted["started_inside"] < 64
    starts = np.array([result.member(i).settings.x0 for i in range(64)])
    draws = {f"x0[{i}]": column for i, column in enumerate(starts.T)}
    inside = started_inside(system, proven, draws)
    assert (inside == proven.admits(starts)).all()
    assert inside.sum() == counted["started_inside"]
    beyond = result.frame()["tail_error"] > limit  # so early that many are
    assert counted["count"] == (beyond & inside).sum() > 0
    assert counted["others"] == (beyond & ~inside).sum() > 0
    moved = system.replace(
        population=replace(system.varied, amplitude=Distribution("uniform", (0.5, 1)))
    )
    _, _, proven = limit_and_starts(moved, None)
    # the polytope is for every phase; what is known of x0 is not
    assert started_inside(moved, proven, draws).sum() < counted["started_inside"]
    x0 = {f"x0[{i}]": np.array([v]) for i, v in enumerate(system.settings.x0)}
    assert proven.admits(system.settings.x0) and not started_inside(moved, proven, x0).any()


@pytest.mark.slow
def test_command_line(tmp_path, capsys):
    file = tmp_path / "drive.toml"
    certrack.save(lean(0.01, (), **LIMITS), file)
    code, text = command(capsys, "certify", file, "--json", "--plot", tmp_path, "--states", "x1,x3")
    found = json.loads(text)["implemented"]
    assert code == 0 and found["saturation"] == "inactive" and found["starts"] == "x0"
    assert len(found["peaks"]["states"]) == 4 and found["polytope"]["half_spaces"] > 4
    assert (tmp_path / "starts.png").exists()
    text = command(capsys, "certify", file, "--out", tmp_path / "cert.json")[1]
    assert "from simulation.x0" in command(capsys, "verify", tmp_path / "cert.json")[1]
    assert "its limits are never met" in text and "largest box" in text
    assert command(capsys, "certify", file, "--states", "x1,x1")[0] == 2
    assert "members that start where" in command(capsys, "ensemble", file, "--members", "64")[1]


def test_what_is_said_and_drawn(limited):
    _, found, _ = limited
    summary, lines = implemented_summary(found), " ".join(implemented_notes(found, 5))
    assert summary["starts"] == "x0" and summary["peaks"]["input"] == found.peaks.input
    assert "its limits are never met" in lines and "largest box" in lines
    unlimited, _ = certify_implemented(lean(0.01, ()))
    assert "met" not in " ".join(implemented_notes(unlimited, 5))
    (ax,) = certrack.plotting.starts_figure(found, ("x2", "x4")).axes
    assert "x_{2}" in ax.get_xlabel() and len(ax.patches) == 4
    units = ("rad", "rad/s", "rad", "rad/s", "1")
    (ax,) = certrack.plotting.starts_figure(found, ("x1", "x4"), "", units).axes
    assert ax.get_xlabel().endswith("[rad]") and ax.get_ylabel().endswith("[rad/s]")
    assert len(certrack.plotting.starts_figure(found).axes[0].patches) == 4
    with pytest.raises(certrack.InputError, match="polytope"):
        certrack.plotting.starts_figure(unlimited)


@pytest.mark.slow
def test_the_shipped_drive():
    """+-15 is not met from x0; from corners of its box it is, so its starts are x0 and more."""
    result = certify(certrack.load("dual-motor-drive"))
    found = result.implemented
    assert result.best is found and found.bound <= 0.00165
    assert found.saturation == "inactive" and found.starts == "x0" and found.peaks.input < 14.6
    assert not found.admits([1, 1, 1, 1]) and found.polytope.largest_box()[0][1] > 0.3
    members = certrack.ensemble(certrack.load("dual-motor-drive"), 300)
    assert members.violations()["count"] == 0


def test_words_of_the_start_are_floats_above(limited):
    """A text stands for no more than it says."""
    _, _, (proof,) = limited
    later = Later((1.0, 2.0), 3.0)
    image = np.array([0, 1.0, 1.0, 1.0, 0])
    assert not is_above(later, image) and is_above(later, image * (1 - 1e-15))
    assert ENCODER > 0 and proof.starts[0].phase == "file"


def test_no_more_periods_than_lower_a_peak():
    """From rest the bounds only rise, so that what comes later is never below them."""
    system = certrack.load("dual-motor-lean")
    drive = certrack.Implementation(period=0.003, delay=0.5, saturation=(-100, 100))
    settings = replace(system.settings, x0=(0.0,) * 4)
    system = system.replace(implementation=drive, settings=settings)
    with flint.ctx.workprec(DRIVE_BITS):
        prover = start_prover(system, rational("0.5"), (1, 1))
        proof = prover.prove(X0)
        starts = start_set_of(system, prover.drive, proof.phase, ())
        more = prover.bounds(starts, proof.doublings + 2, 2 ** (proof.doublings + 1), None)
        fewer = prover.bounds(starts, proof.doublings - 1, 2 ** (proof.doublings - 2), None)
    peaks = np.array([float(text) for text in proof.peaks])
    assert proof.doublings + 2 <= MOST_DOUBLINGS
    assert (peaks <= more.peaks * (1 + 2e-3)).all()
    assert (fewer.peaks > more.peaks * (1 + 1e-3)).any()

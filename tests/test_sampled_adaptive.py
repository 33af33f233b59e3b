"""The adaptive law as a drive runs it: its proof, what must be refused, and runs against it."""

import copy
import json
import math
from functools import cache

import independent_checker
import numpy as np
import pytest
import sampled_adaptive_attack

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.layout import digest_of
from certrack.certificates.sampled_adaptive.certify import certify_sampled_adaptive
from certrack.certificates.sampled_adaptive.document import sampled_adaptive_record
from certrack.cli import main

#: Of example1's continuous law, by the bootstrap.
CONTINUOUS = 0.061792


def example(**drive):
    drive = {"period": 0.001, "delay": 0.5, "update": "exact_leak"} | drive
    return certrack.load("example1").replace(implementation=certrack.Implementation(**drive))


@cache
def found():
    return certify_sampled_adaptive(example())


@cache
def document():
    return to_document(example(), found()[1])


def refusal(change, system=None):
    """Why a changed file is refused, although its digest and claim are those of its content."""
    body = copy.deepcopy(document())
    (proof,) = body["proof"]
    change(proof)
    if system is not None:
        body["system"] = system(body["system"])
    body["sha256"] = digest_of(body)
    verdict = verify(body)
    assert not verdict.verified
    return verdict.reason


def times(text, factor):
    return repr(float(text) * factor)


@pytest.mark.slow
def test_example1_at_one_millisecond_is_within_a_tenth_of_the_continuous_law():
    certificate, proof = found()
    assert certificate.verified and certificate.bound <= 1.1 * CONTINUOUS
    assert certificate.bound > CONTINUOUS
    assert not certificate.from_file  # x0 = (1, 2) with estimates at zero is far away
    assert float(proof.bound) <= certificate.bound
    verdict = verify(document())
    assert verdict.verified and verdict.bound == proof.bound
    status = {premise.name: premise.status for premise in verdict.premises}
    assert status["starts"] == "assumed" and status["sampled loop"] == "proven"


def test_the_record_is_read_as_it_was_written():
    assert sampled_adaptive_record(document()["proof"]) == found()[1]


def test_the_command_line_says_of_which_starts_a_verified_bound_is(tmp_path, capfd):
    path = tmp_path / "cert.json"
    path.write_text(json.dumps(document()))
    with pytest.raises(SystemExit) as ended:
        main(["verify", str(path)])
    assert ended.value.code == 0
    first, *others = capfd.readouterr().out.splitlines()
    assert first.endswith("from the starts stated below, resting on")
    assert any("starts: |e_1(0)| <=" in line for line in others)


def test_what_sampling_adds_must_be_below_what_is_said():
    what = "what sampling adds is not below what a stage says"

    def less(stage, name):
        def change(proof):
            part = proof["invariant"] if stage is None else proof["stages"][stage]
            if name == "law":
                part["law"] = times(part["law"], 0.99)
            else:
                part["estimates"][name] = times(part["estimates"][name], 0.99)

        return change

    for stage in (None, 0, -1):
        for name in ("law", 0, 1):
            assert refusal(less(stage, name)) == what


def test_a_pace_must_hold_what_was_proven():
    def narrow(proof):
        low, high = proof["stages"][2]["pace"]
        proof["stages"][2]["pace"] = [low, times(high, 0.99)]

    assert "pace" in refusal(narrow)


def test_a_kept_set_must_be_inside_its_box_and_hold_its_starts():
    def loose(proof):
        for claim in proof["invariant"]["function"]["claims"]:
            claim["bound"] = times(claim["bound"], 1.01)

    def missing(proof):
        proof["invariant"]["function"]["claims"].pop()

    def larger(proof):
        proof["invariant"]["starts"][0] = times(proof["invariant"]["starts"][0], 1.2)

    def wider(proof):
        proof["invariant"]["priors"][0][0] = "0.2"

    def no_room(proof):
        proof["invariant"]["room"] = "0.001"

    assert refusal(loose) == "the kept set is not inside its box"
    assert refusal(missing) == "the kept set is not inside its box"
    assert "not that of the proof" in refusal(larger)  # the claim states the starts
    assert "not that of the proof" in refusal(wider)
    assert "first input" in refusal(no_room)


def claim_too(change):
    """With the claim of the changed proof."""
    from certrack.certificates.sampled_adaptive.certify import sampled_claim

    body = copy.deepcopy(document())
    change(body["proof"][0])
    body["claim"] = sampled_claim(sampled_adaptive_record(body["proof"]))
    body["sha256"] = digest_of(body)
    verdict = verify(body)
    assert not verdict.verified
    return verdict.reason


def test_starts_outside_are_refused_whatever_is_claimed():
    def larger(proof):
        proof["invariant"]["starts"][0] = times(proof["invariant"]["starts"][0], 1.2)

    def wider(proof):
        proof["invariant"]["priors"][0][0] = "0.2"

    def better(proof):
        for stage in proof["stages"]:
            for function in stage["functions"]:
                for claim in function["claims"]:
                    if claim["error"] == 0:
                        claim["bound"] = times(claim["bound"], 0.98)

    assert claim_too(larger) == claim_too(wider) == "a start is not in the kept set"
    assert claim_too(better) == "the function is below what it shall bound"


def test_multipliers_and_boxes_are_checked():
    def negative(proof):
        inputs = proof["stages"][0]["functions"][0]["inputs"]
        inputs[-1] = "-1e-3"  # that of what sampling adds to the estimates

    def none(proof):
        inputs = proof["stages"][1]["functions"][1]["inputs"]
        inputs[-3] = "0"  # that of u - u_law

    def small(proof):
        low, high = proof["stages"][1]["region"]["box"][1]
        proof["stages"][1]["region"]["box"][1] = [low, times(high, 0.98)]

    assert refusal(negative) == "a multiplier is negative"
    assert refusal(none) == "the matrix inequality does not hold at a corner"
    assert refusal(small) == "a stage's box does not hold what was proven before"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("period = 0.001", "period = 0.00102"),
        ("delay = 0.5", "delay = 0.55"),
        ('update = "exact_leak"', 'update = "euler"'),
        ("leak_theta = 0.6", "leak_theta = 0.65"),
    ],
)
def test_a_proof_is_of_its_own_loop(old, new):
    def other(text):
        assert old in text
        return text.replace(old, new)

    assert refusal(lambda proof: None, other)


@pytest.mark.slow
def test_limits_are_proven_never_to_act_or_there_is_no_certificate():
    certificate, _ = certify_sampled_adaptive(example(saturation=(-0.5, 0.5)))
    assert not certificate.exists and "saturation may act" in certificate.reason
    certificate, _ = certify_sampled_adaptive(
        example(projection=((0.3, 0.5), (2.05, 2.15))),
    )
    assert not certificate.exists and "projection may act" in certificate.reason


@pytest.mark.slow
def test_the_independent_checker_agrees_and_refuses_what_is_changed():
    assert float(independent_checker.check(document())) <= found()[0].bound
    changes = {
        "u - u_law": lambda proof: proof["invariant"].update(
            law=times(proof["invariant"]["law"], 0.5)
        ),
        "room": lambda proof: proof["invariant"].update(room="0.001"),
        "inside": lambda proof: proof["invariant"]["function"]["claims"].pop(),
        "steps add": lambda proof: proof["invariant"]["estimates"].__setitem__(1, "1e-9"),
    }
    for what, change in changes.items():
        body = copy.deepcopy(document())
        change(body["proof"][0])
        body["sha256"] = digest_of(body)
        with pytest.raises(independent_checker.Refused) as refused:
            independent_checker.check(body)
        assert what in str(refused.value) or "bounded by the kept" in str(refused.value)


@pytest.mark.slow
def test_inactive_limits_sensors_and_quanta_are_covered():
    drive = {
        "saturation": (-8, 8),
        "projection": ((0, 1), (1, 3)),
        "noise_bound": (1e-5, 1e-5),
        "input_quantum": 1e-4,
        "update": "euler",
        "delay": (0.2, 0.5),
    }
    system = example(**drive)
    certificate, proof = certify_sampled_adaptive(system)
    assert certificate.verified and found()[0].bound < certificate.bound < 0.08
    verdict = verify(to_document(system, proof))
    assert verdict.verified, verdict.reason


@pytest.mark.parametrize(
    ("drive", "why"),
    [
        ({"velocity": ("x2",)}, "velocity"),
        ({"jitter": 0.1}, "jitter"),
        ({"rate_limit": 100.0}, "rate_limit"),
        ({"offset": 0.0005}, "offset"),
        ({"noise": (1e-3, 0)}, "noise"),
        ({"period": 0.05}, ""),
    ],
)
def test_what_is_not_covered_is_said(drive, why):
    certificate, proof = certify_sampled_adaptive(example(**drive))
    assert not certificate.exists and proof is None
    assert why in certificate.reason and certificate.reason


def test_a_robust_law_is_not_for_this():
    certificate, _ = certify_sampled_adaptive(certrack.load("dual-motor-drive"))
    assert "adaptive law" in certificate.reason


@pytest.mark.slow
def test_a_file_that_starts_inside_ships_with_it():
    inside = example()
    settings = inside.settings
    inside = inside.replace(
        settings=certrack.Settings(
            **{f: getattr(settings, f) for f in ("duration", "band", "tail")},
            x0=(0.2, 0.3),
            estimates=(0.4, 2.1),
        )
    )
    result = certrack.certify(inside)
    assert result.best is result.sampled and result.sampled.from_file
    assert result.stages == (result.sampled_proof,)
    assert {p.name: p.status for p in result.premises}["starts"] == "proven"
    assert verify(to_document(inside, *result.stages)).verified
    outside = certrack.certify(example())
    assert outside.sampled.verified and outside.best is outside.bootstrap


@pytest.mark.slow
def test_no_run_beats_any_part_of_the_proof():
    certificate, proof = found()
    invariant, last = proof.invariant, proof.stages[-1]
    loops = sampled_adaptive_attack.Loops(example(), 96)
    seen = loops.run(
        7.0,
        [float(v) for v in invariant.starts],
        [[float(v) for v in pair] for pair in invariant.priors],
        amplitude=0.2,
        top=1.0,
    )
    box = np.abs(np.array(invariant.region.box, dtype=float)).max(axis=1)
    late = np.abs(np.array(last.region.box, dtype=float)).max(axis=1)
    assert (seen.errors <= box[:2]).all()
    assert (seen.late_errors <= late[:2]).all()
    assert seen.late_errors[0] <= certificate.bound
    assert seen.late_law <= float(last.law)
    assert (seen.late_steps <= [float(v) for v in last.estimates]).all()
    assert (seen.steps <= [float(v) for v in invariant.estimates]).all()
    assert seen.law <= float(invariant.law)
    # a search that finds nothing near the bound would not be one
    assert seen.late_errors[0] > 0.5 * certificate.bound
    assert math.isfinite(seen.u)

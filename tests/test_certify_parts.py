"""What `certify` makes of the methods: the best, the tube, reasons, and broken premises."""

import importlib
import math
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_range_algebra import FIRST_ORDER

import certrack
from certrack.certificates import cascade, methods, strength
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import Certificate, missing
from certrack.certificates.exact import Proof, from_text
from certrack.certificates.formulation import error_problem
from certrack.certificates.methods import RANGE_KINDS, Methods, _why_none, certify_peak, smallest
from certrack.certificates.premise import Premise
from certrack.certificates.sampling import RAY_POINTS, Points, nearest_failure
from certrack.certificates.scope import has_ranges
from certrack.certificates.semidefinite import fastest_rate

certify_module = importlib.import_module("certrack.certificates.certify")

BROKEN = Premise("domain", "contradicted", "log(x1) has no value")


@pytest.fixture(scope="module")
def found():
    return certrack.certify(certrack.load("example1"), effort="fast")


def bound(kind, value, verified=True):
    return Certificate(kind, value, verified=verified)


def stage(name):
    return Proof("1", (("1",),), (), (), (), name)


def test_the_smallest_is_verified():
    one, two, none = bound("rate", 2.0), bound("peak", 1.5), bound("cascade", 0.5, False)
    assert smallest([one, two, none]) is two and smallest([one, none]) is one
    assert smallest([none]) is None and smallest([]) is None


def test_the_tightest_of_what_has_a_proof():
    certificates = {"semidefinite": bound("semidefinite", 2.0), "cascade": bound("cascade", 1.0)}
    certificates |= {"peak": bound("peak", 0.5), "rate": bound("rate", 0.1)}
    proofs = {"semidefinite": (stage("a"),), "cascade": (stage("b"), stage("c")), "peak": ()}
    of = Methods(certificates, proofs, ("rate", "semidefinite", "cascade", "peak"), None, None)
    assert of.best.kind == "rate" and of.tightest == of.stages == (stage("b"), stage("c"))
    assert of.stages_of("semidefinite") == (stage("a"),)
    cells = (SimpleNamespace(cell=()),)
    of = replace(of, proofs={**proofs, "peak": cells, "cascade": ()}, kinds=("rate", "peak"))
    assert of.tightest is cells and of.stages == (stage("a"),)
    assert replace(of, proofs={"rate": ()}).tightest == ()


def test_the_best_is_that_of_the_loop_as_it_runs_if_it_has_one(found):
    assert found.best.bound == min(
        getattr(found, f.name).bound
        for f in fields(found)
        if isinstance(getattr(found, f.name), Certificate) and getattr(found, f.name).verified
    )
    implemented = replace(found.implemented, bound=100.0, verified=True)
    assert replace(found, implemented=implemented).best is implemented
    kinds = [f.name for f in fields(found) if isinstance(getattr(found, f.name), Certificate)]
    nothing = replace(found, **{kind: missing(kind, "none") for kind in kinds})
    assert nothing.best is nothing.semidefinite and not nothing.verified


def test_the_tube_follows_from_the_tighter_stages(found):
    one, three = stage("a"), (stage("b"), stage("c"), stage("d"))
    of = replace(found, proof=one, cascade_proof=three, semidefinite=bound("semidefinite", 2.0))
    lower, same = (replace(of, cascade=bound("cascade", v)) for v in (1.0, 2.0))
    assert lower.quadratic == three and lower.tube_kind == "cascade"
    assert same.quadratic == (one,) and same.tube_kind == "semidefinite"
    assert replace(lower, cascade_proof=None).quadratic == (one,)
    assert replace(same, proof=None).quadratic == ()
    assert replace(lower, kinds=RANGE_KINDS).tube_kind == "vertices"
    assert replace(of, tightest=three).stages == three
    assert replace(of, tightest=three, implemented_proof=(1,)).stages == (1,)
    broken = replace(lower, premises=(BROKEN,), tightest=three)
    assert broken.quadratic == broken.stages == () and broken.contradicted
    assert broken.best.verified and not broken.verified and lower.verified


def test_nothing_is_verified_of_another_plant(found):
    of = replace(found, peak=missing("peak", "too long"), constants=())
    result = certify_module._unverified(of, BROKEN)
    kinds = [f.name for f in fields(of) if isinstance(getattr(of, f.name), Certificate)]
    assert {"published", "rate", "semidefinite", "cascade", "peak"} <= set(kinds)
    for kind in kinds:
        entry = getattr(result, kind)
        assert not entry.verified and entry.bound == pytest.approx(
            getattr(of, kind).bound, nan_ok=True
        )
        assert entry.reason
    assert result.peak.reason == "too long"
    assert result.semidefinite.reason == "a premise is contradicted: log(x1) has no value"


def test_a_loop_that_begins_softly_is_proven_for_its_start_and_for_later(monkeypatch):
    asked = []

    def implemented(system, **how):
        asked.append((system, how))
        cert = certify_module.ImplementedCertificate
        return cert.__new__(cert), ("proofs", len(asked))

    monkeypatch.setattr(certify_module, "certify_implemented", implemented)
    monkeypatch.setattr(certify_module, "replace", lambda later, **values: values)
    monkeypatch.setattr(certify_module, "is_of_starts", lambda system: system.of_starts)
    plain = SimpleNamespace(of_starts=False)
    plain.long_run = plain
    certify_module._implemented(plain, True, "high", print)
    how = {"margins": True, "effort": "high", "progress": print}
    assert asked == [(plain, {"from_start": True, **how})]
    soft = SimpleNamespace(of_starts=False, long_run=plain)
    asked.clear()
    monkeypatch.setattr(
        certify_module,
        "certify_implemented",
        lambda system, **how: (
            asked.append((system, how)),
            (SimpleNamespace(start=len(asked), peaks=-len(asked)), len(asked)),
        )[1],
    )
    values, proofs = certify_module._implemented(soft, True, "high", print)
    early = {"from_start": True, "effort": "high", "progress": print}
    assert asked == [(soft, early), (plain, how)]
    assert values == {"start": 1, "peaks": -1} and proofs == 2
    asked.clear()
    certify_module._implemented(
        SimpleNamespace(of_starts=True, long_run=plain), False, "fast", print
    )
    assert len(asked) == 1 and asked[0][1]["from_start"] is True


def test_of_which_proof_the_tube_is(monkeypatch):
    for name in ("tube", "tube_of"):
        monkeypatch.setattr(certify_module, name, lambda system, proof: ("tube", proof))
    monkeypatch.setattr(certify_module, "range_tube", lambda system, proof: ("ranges", proof))
    monkeypatch.setattr(certify_module, "has_ranges", lambda system: system.ranged)
    monkeypatch.setattr(certify_module, "certify_semidefinite", lambda system: (None, system.own))
    fixed = SimpleNamespace(online=None)
    plain = SimpleNamespace(ranged=False, law=fixed)
    plain.long_run = plain
    assert certify_module._tube(plain, ("a", "b"), None) == ("tube", ("a", "b"))
    assert certify_module._tube(plain, (), None) is None
    assert certify_module._tube(plain, ("a",), "v") == ("ranges", "v")
    for ranged, own, expected in (
        (False, "mine", ("tube", "mine")),
        (False, None, None),
        (True, "mine", None),
    ):
        soft = SimpleNamespace(ranged=ranged, long_run=plain, own=own, law=fixed)
        assert certify_module._tube(soft, ("a",), "v") == expected
    online = SimpleNamespace(online="between two ends")
    moving = SimpleNamespace(ranged=False, law=online, long_run=plain)
    monkeypatch.setattr(certify_module, "online_tube", lambda system, proof: ("online", proof))
    for proofs, expected in ((("p",), ("online", "p")), ((), None)):
        monkeypatch.setattr(certify_module, "certify_online", lambda system, p=proofs: (None, p))
        assert certify_module._tube(moving, ("a",), None) == expected
    moving.long_run = moving  # what was proven serves the tube, too
    assert certify_module._tube(moving, ("a",), None) == ("tube", ("a",))


@pytest.mark.parametrize(
    ("fastest", "solution", "reason"),
    [
        (1e-10, None, "forget too slowly"),
        (1e-10, "found", "forget too slowly"),
        (1e-8, None, "uncertainty is too strong"),
        (1e-8, "found", "did not survive"),
        (None, None, "uncertainty is too strong"),
        (None, "found", "did not survive"),
    ],
)
def test_why_there_is_no_proof(fastest, solution, reason):
    program = None if fastest is None else SimpleNamespace(fastest=2 * fastest, slowest_pole=2.0)
    assert reason in _why_none(SimpleNamespace(program=program, solution=solution))


def test_peak_gains_of_large_orders_take_their_time(monkeypatch):
    system = certrack.load("dual-motor-lean")
    monkeypatch.setattr(methods, "FAST_PEAK_ORDER", system.plant.n)
    assert certify_peak(system, "fast")[0].verified
    monkeypatch.setattr(methods, "FAST_PEAK_ORDER", system.plant.n - 1)
    left_out, proof = certify_peak(system, "fast")
    assert "takes more time" in left_out.reason and proof == () and not left_out.verified
    found, (proof,) = certify_peak(system)
    assert found.verified and 0 <= found.bound - float(proof.bound) < 1e-12 * found.bound
    nonlinear, _ = certify_peak(certrack.load("example1"))
    assert "estimates make the loop nonlinear" in nonlinear.reason


@pytest.mark.parametrize(
    ("effort", "alpha", "expected"),
    [
        ("fast", None, (False, None)),
        ("default", math.nan, (True, None)),
        ("high", 2.0, (True, 2.0)),
    ],
)
def test_what_every_method_is_asked(monkeypatch, effort, alpha, expected):
    class Enough(Exception):
        pass

    def every(system, effort, progress, *, details, near):
        asked.append((effort, details, near))
        progress(2, 99, 0.5)
        raise Enough

    asked, told = [], []
    monkeypatch.setattr(certify_module, "every_certificate", every)
    warm = None if alpha is None else SimpleNamespace(alpha=alpha)
    with pytest.raises(Enough):
        certrack.certify(
            certrack.load("dual-motor-lean"), effort, lambda *a: told.append(a), warm=warm
        )
    assert asked == [(effort, *expected)] and told == [(2, certify_module.STEPS, 0.5)]
    with pytest.raises(certrack.InputError, match="effort"):
        certrack.certify(certrack.load("dual-motor-lean"), "slow")


# the cascade


@pytest.fixture
def asked(monkeypatch):
    """What is asked of the conditions of stages, whose bounds are their names."""
    asked = []

    def failed(problem, proof, target=0):
        asked.append((problem, proof.bound, target))
        return "fails" if proof.bound == "9" else ""

    monkeypatch.setattr(cascade, "failed_condition", failed)
    monkeypatch.setattr(cascade, "centred_problem", lambda *a: ("centred", a[2].bound, a[3]))
    monkeypatch.setattr(cascade, "head_problem", lambda problem, limit: ("head", limit))
    return asked


def staged(bound, shift="0"):
    return SimpleNamespace(bound=bound, shift=shift)


def test_every_stage_of_a_cascade_is_checked_with_the_one_before(asked):
    problem = SimpleNamespace(n=3, adaptation=1)
    one, two, three = staged("1"), staged("2", "0.5"), staged("3")
    assert cascade.check_cascade(None, problem, [one, three]) == ""
    assert asked == [(problem, "1", 2), (("head", from_text("1")), "3", 0)]
    asked.clear()
    assert cascade.check_cascade(None, problem, [one, two, three]) == ""
    shifted = ("centred", "1", from_text("0.5"))
    assert asked == [(problem, "1", 2), (shifted, "2", 2), (("head", from_text("2")), "3", 0)]
    bad = staged("9")
    for stages in ([bad, three], [one, bad], [bad, two, three], [one, bad, three], [one, two, bad]):
        assert cascade.check_cascade(None, problem, stages) == "fails"


@pytest.mark.parametrize(("n", "adaptation"), [(1, 1), (2, None), (1, None)])
def test_a_cascade_needs_estimates_and_two_states(asked, n, adaptation, monkeypatch):
    problem = SimpleNamespace(n=n, adaptation=adaptation)
    assert "at least two states" in cascade.check_cascade(None, problem, [staged("1")] * 2)
    monkeypatch.setattr(cascade, "error_problem", lambda *_: problem)
    found, stages = cascade.certify_cascade(None)
    assert "adaptive law of order 2" in found.reason and stages is None and asked == []
    assert cascade.check_cascade(None, SimpleNamespace(n=2, adaptation=1), [staged("1")] * 2) == ""


@pytest.mark.parametrize(("centred", "limit"), [(None, "7"), ("5", "5")])
def test_the_last_stage_of_a_cascade_begins_with_the_smallest_bound(monkeypatch, centred, limit):
    problem, proven = SimpleNamespace(n=3, adaptation=1), []

    def prove(problem, target):
        proven.append((problem, target))
        return staged("7") if target else staged("3")

    second = None if centred is None else staged(centred, "0.5")
    monkeypatch.setattr(cascade, "error_problem", lambda *_: problem)
    monkeypatch.setattr(cascade, "_prove_stage", prove)
    monkeypatch.setattr(cascade, "_centred_stage", lambda system, exact, stage: second)
    monkeypatch.setattr(cascade, "head_problem", lambda problem, limit: ("head", limit))
    monkeypatch.setattr(cascade, "proven", lambda kind, system, proof: (kind, system, proof))
    found, stages = cascade.certify_cascade("it")
    assert proven == [(problem, 2), (("head", from_text(limit)), 0)]
    bounds = [stage.bound for stage in stages]
    assert bounds == ["7", "3"] if centred is None else bounds == ["7", "5", "3"]
    assert found == ("cascade", "it", stages[-1])


@pytest.mark.parametrize(
    ("bound", "taken"), [("1.9", True), ("2", False), ("2.1", False), (None, False)]
)
def test_a_centred_stage_counts_where_it_is_smaller(monkeypatch, bound, taken):
    proof = None if bound is None else Proof("1", (("1",),), (), (), (), bound)
    at, tried = [], []

    def best(problem, target, near):
        tried.append((problem, target, near))
        return SimpleNamespace(proof=proof)

    shifts = [(0.1234567, 3.0), (0.5, 4.0)]
    floats = SimpleNamespace(in_floats=lambda: "floats", at=lambda kappa: at.append(kappa) or kappa)
    monkeypatch.setattr(cascade, "CentredProblems", SimpleNamespace(of=lambda *_: floats))
    monkeypatch.setattr(
        cascade, "best_shifts", lambda *a: shifts if a[1:] == (0.25, 2, 2.0) else []
    )
    monkeypatch.setattr(cascade, "best_proof", best)
    reached = SimpleNamespace(bound="2", alpha="0.25")
    found = cascade._centred_stage(None, SimpleNamespace(n=3), reached)
    assert tried[0] == (from_text("0.123457"), 2, 3.0)
    assert (found is not None) == taken and len(tried) == (1 if taken else 2)
    assert found is None or found == replace(proof, shift="0.123457")


# the critical strength


@pytest.mark.parametrize("edge", [0.0, 1e-3, 3.7, 99.0])
@pytest.mark.parametrize("published", [0.0, 2.0])
def test_the_edge_of_what_is_provable_is_bisected(monkeypatch, edge, published):
    asked = []

    def provable(exact, strength, slow):
        asked.append((strength, slow))
        return strength <= edge

    problem = SimpleNamespace(counts=(1, 0, 0))
    monkeypatch.setattr(strength, "error_problem", lambda *_: problem)
    monkeypatch.setattr(strength, "critical_strength", lambda _: published)
    monkeypatch.setattr(strength, "_holds_as_published", lambda *_: 0 < published <= edge)
    monkeypatch.setattr(strength, "_limit", lambda _: 100.0)
    monkeypatch.setattr(strength, "_by_one_program", lambda *_: None)
    monkeypatch.setattr(strength, "_provable", provable)
    found = strength.critical_semidefinite(None, accuracy=1e-4)
    assert edge / (1 + 1.01e-4) <= found <= edge
    assert {slow for _, slow in asked} == {math.inf}
    certified = Certificate("semidefinite", 1.0, alpha=0.5, verified=True)
    asked.clear()
    proven = strength.critical_semidefinite(None, certified, accuracy=1e-4)
    assert proven == pytest.approx(max(found, 1.0), rel=1e-3)
    assert {slow for _, slow in asked} == {0.25}
    problem.counts = (0, 1, 1)
    assert strength.critical_semidefinite(None) == math.inf
    monkeypatch.setattr(strength, "_by_one_program", lambda exact, low, slow: ("strong", low))
    problem.counts = (1, 0, 0)
    least = max(published if 0 < published <= edge else 0.0, strength.SMALLEST_PART * 100)
    assert strength.critical_semidefinite(None) == ("strong", least)


def test_one_program_of_the_stated_strength_is_asked_and_its_answer_proven(monkeypatch):
    """That of 1 times the stated tau; then what it finds, less and less, until exact proof."""
    exact = error_problem(certrack.load("dual-motor-lean"), rational)
    asked, unproven = [], 1

    def largest(unit, slow):
        np.testing.assert_array_equal(unit.Ua, exact.Ua.astype(float))
        assert unit.counts == (exact.counts[0], 0, 0)
        assert slow == min(strength.SLOW_RATE * fastest_rate(unit), 0.01)
        return SimpleNamespace(strength=4.0, solution="found")

    def prove(scaled, solution, back_off):
        asked.append(float(scaled.Ua[0, 0] / exact.Ua[0, 0]) if exact.Ua[0, 0] else None)
        assert solution == "found"
        return "proof" if len(asked) > unproven else None

    monkeypatch.setattr(strength, "largest_strength", largest)
    monkeypatch.setattr(strength, "prove", prove)
    parts = strength.BELOW_THE_LARGEST
    assert strength._by_one_program(exact, 0.0, 0.01) == 4.0 * (1 - parts[1])
    assert len(asked) == 2
    assert strength._by_one_program(exact, 4.0, 0.01) is None
    unproven = math.inf
    assert strength._by_one_program(exact, 0.0, 0.01) is None
    monkeypatch.setattr(strength, "largest_strength", lambda *_: None)
    assert strength._by_one_program(exact, 0.0, 0.01) is None


@pytest.mark.parametrize("place", [0, 0.5, 1, 1.5, 2.7, 200.3, 399.5])
def test_the_nearest_failure_of_a_ray_is_bisected(place):
    """What fails does so from some ||x|| on: at zero, before the first that is tried, behind it."""
    points = Points(np.arange(3.0), np.array([[3.0, 300.0, 60.0], [4.0, 400.0, 80.0]]))
    tried = [0.0, *np.geomspace(1e-3, 100.0, RAY_POINTS)]  # of 100, the smallest that fails
    k = int(place)
    edge = tried[k] + (place - k) * (tried[k + 1] - tried[k])

    def fails(some):
        return (some.norm >= edge) & (some.norm > 0 if place else some.norm >= 0) & (some.t > 0)

    found = nearest_failure(points, fails)
    assert found.t.tolist() == [2.0] and found.x.shape == (2, 1)
    least = 0.0 if place == 0 else 1e-3 if place <= 1 else edge
    assert found.norm[0] == pytest.approx(least, rel=1e-9)
    assert found.x[:, 0] == pytest.approx([0.6 * least, 0.8 * least], rel=1e-9)
    assert nearest_failure(points, lambda some: some.norm < 0) is None
    alone = nearest_failure(points, lambda some: (some.norm == 100.0) & (len(some.t) == 3))
    assert alone.norm.tolist() == [100.0]  # the ray has none


def test_ranges_of_what_a_law_with_integral_action_knows_count():
    """The robust law takes g_n for known; that it integrates, too, makes no difference."""
    system = certrack.loads(FIRST_ORDER)
    plain = certrack.loads(FIRST_ORDER.replace("a = [2, 3]\n", ""))
    assert has_ranges(system) and has_ranges(plain)
    law = replace(plain.law, integral=1.0)
    assert has_ranges(plain.replace(law=law))
    assert not has_ranges(certrack.load("dual-motor-lean"))

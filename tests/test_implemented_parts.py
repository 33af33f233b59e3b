"""Parts of the certificates of implemented loops: files, limits, margins, who is admitted."""

import copy
import math
from dataclasses import asdict, replace
from fractions import Fraction
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from test_forged_claims import DRIVEN_APART
from test_implemented import UNIT_W

import certrack
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import certify as certify_room
from certrack.certificates.implemented import cover as cover_room
from certrack.certificates.implemented import margins
from certrack.certificates.implemented.certify import (
    ImplementedCertificate,
    certify_implemented,
    claim_of,
    failed_cover,
    from_x0_only,
    jitters,
    largest_bound,
    limits_met,
    missing_implemented,
)
from certrack.certificates.implemented.controller_matrices import _numbers
from certrack.certificates.implemented.cover import failed_cells
from certrack.certificates.implemented.document import (
    MAX_DELAY_PROOFS,
    implemented_proofs,
    is_implemented,
    record_of,
)
from certrack.certificates.implemented.drive import drive_of
from certrack.certificates.implemented.estimate import (
    estimate_implemented,
    estimate_nearby,
)
from certrack.certificates.implemented.fixed_point import uncertain_size
from certrack.certificates.implemented.input_limits import (
    NO_LIMIT,
    InputLimits,
    input_limits,
    is_limited,
)
from certrack.certificates.implemented.margins import period_margins
from certrack.certificates.implemented.polytope import Polytope
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.ranged import RangedPlant
from certrack.certificates.implemented.start_proof import StartProof
from certrack.core.errors import InputError
from certrack.core.expressions import symbol

#: Poles at -2, an uncertain term of 0.1, samples every 10 ms.
CALM = DRIVEN_APART.format(drift=0).replace("[[0, 0], [12, 6]]", "[[0, 0], [0.2, 0]]")
CALM = CALM.replace("12*x1 + 6*x2", "0.2*x1")


@pytest.fixture(scope="module")
def calm():
    system = certrack.loads(CALM)
    return system, *certify_implemented(system)


# the whole certificate


def test_the_worst_of_all_delays_counts(calm):
    system, one, proofs = calm
    assert one.verified and len(proofs) == 1 and one.saturation == "none" and one.starts == "any"
    late = system.replace(implementation=replace(system.implementation, delay=(0, 1, 0.5)))
    found, several = certify_implemented(late)
    assert [Fraction(p.delay) for p in several] == [0, 1, Fraction(1, 2)]
    bounds = [float(p.bound) for p in several]
    assert found.bound == pytest.approx(max(bounds), rel=1e-15) and found.bound > one.bound
    assert largest_bound(several) == max((p.bound for p in several), key=float)
    assert found.peak_input == pytest.approx(max(float(p.input) for p in several))
    for i in range(2):
        assert found.states[i] >= max(Fraction(p.states[i]) for p in several)
        assert found.states[i] == pytest.approx(max(float(p.states[i]) for p in several))
    assert sum(found.parts.values()) == pytest.approx(found.bound, rel=1e-6)
    assert found.cells == 0 and found.margins is None and found.start == (0.01, 0.0)
    assert failed_cover(late, several) == ""
    assert "one proof for each delay" in failed_cover(late, several[:2])
    assert "one proof for each delay" in failed_cover(system, several)
    swapped = [several[1], several[0], several[2]]
    assert "delay is not that of the system" in failed_cover(late, swapped)


def test_an_estimate_is_near_what_is_proven(calm):
    system, one, _ = calm
    guess = estimate_implemented(system)
    assert guess.bound == pytest.approx(one.bound, rel=1e-3)
    assert guess.states == pytest.approx(one.states, rel=1e-3)
    assert guess.peak_input == pytest.approx(one.peak_input, rel=1e-3)
    late = estimate_implemented(system, rational(1))
    assert late.bound > guess.bound


def test_a_loop_nearby_is_estimated_to_first_order(calm):
    """The same loop has its own bounds; another's are wrong by the square of what it differs by."""
    system, *_ = calm
    known = estimate_implemented(system)
    same = estimate_nearby(system, known)
    assert same.bound == pytest.approx(known.bound, rel=1e-6)
    assert same.peak_input == pytest.approx(known.peak_input, rel=1e-6)
    errors = []
    for part in (0.02, 0.01):
        drive = system.implementation
        slower = system.replace(implementation=replace(drive, period=drive.period * (1 + part)))
        near, there = estimate_nearby(slower, known), estimate_implemented(slower)
        assert there.bound != pytest.approx(known.bound, rel=1e-5)
        moved = abs(there.bound - known.bound)
        errors.append(abs(near.bound - there.bound))
        assert errors[-1] < 0.1 * moved
        assert near.peak_input == pytest.approx(there.peak_input, rel=1e-2 * part)


def test_nothing_is_proven_where_the_term_drives_the_loop_apart():
    found, proofs = certify_implemented(certrack.loads(DRIVEN_APART.format(drift=0)))
    assert not found.exists and proofs == () and found.starts == "none"
    assert "too strong for the sampled loop" in found.reason
    none = missing_implemented("why")
    assert math.isinf(none.bound) and none.reason == "why" and none.starts == "none"
    assert none.cells == 0 and not none.verified


#: |x_1| <= 2, |x_2| <= 3 and x_1 + 2 x_2 <= 4.
BOX = Polytope(np.array([[1.0, 2.0]]), np.array([4.0]), ((-2.0, 2.0), (-3.0, 3.0)), ("a", "b"))


def admitting(**changed):
    return ImplementedCertificate("implemented", 0.1, states=(1.0, 2.0), **changed)


def test_who_is_admitted():
    anyone = admitting(starts="any")
    assert anyone.admits((9.0, 9.0)) is True
    assert anyone.admits([(9.0, 9.0), (0.0, 0.0)]).tolist() == [True, True]
    assert replace(anyone, bound=math.inf).admits((0.0, 0.0)) is False
    alone = admitting(starts="x0", start=(5.0, 1.0))
    assert alone.admits((5.0, 1.0)) is True and alone.admits((5.0, 1.1)) is False
    assert alone.admits([(5.0, 1.0), (5.0, 2.0)]).tolist() == [True, False]
    assert admitting(starts="none", start=(5.0, 1.0)).admits((5.0, 1.0)) is False
    assert admitting(starts="polytope", start=(5.0, 1.0)).admits((5.0, 1.0)) is False
    of_box = admitting(starts="box", start=(5.0, 1.0), polytope=BOX)
    starts = [(2.0, 1.0), (2.0, 1.01), (-2.0, 3.0), (-2.0, 3.01), (-2.1, 0.0), (5.0, 1.0)]
    assert of_box.admits(starts).tolist() == [True, False, True, False, False, True]
    assert [of_box.admits(x0) for x0 in starts] == of_box.admits(starts).tolist()
    assert replace(of_box, starts="polytope").admits(starts).tolist()[-1] is False
    assert (2.0, 1.0) in BOX and (2.0, 1.01) not in BOX
    for x0 in ((1.0,), (1.0, 2.0, 3.0), [[1.0], [2.0]]):
        with pytest.raises(InputError, match="2 numbers per start"):
            anyone.admits(x0)


# limits of the input


def limited(system, **limits):
    return system.replace(implementation=replace(system.implementation, **limits))


def test_limits_beyond_what_is_proven_are_not_met(calm):
    system, _, proofs = calm
    size, step = float(proofs[0].input), float(proofs[0].step)
    assert limits_met(system, proofs) == "" and not is_limited(system)
    for part, met in ((1.01, False), (0.99, True)):
        for low, high in ((-part * size, 9), (-9, part * size)):
            other = limited(system, saturation=(low, high))
            assert ("stay at its limits" in limits_met(other, proofs)) == met
            assert is_limited(other)
        other = limited(system, rate_limit=part * step / 0.01)
        assert ("stay at its rate limit" in limits_met(other, proofs)) == met
        assert is_limited(other)
    larger = replace(proofs[0], input=str(10 * size))
    other = limited(system, saturation=(-2 * size, 2 * size))
    assert limits_met(other, proofs) == "" and limits_met(other, [*proofs, larger]) != ""
    assert limits_met(system.replace(implementation=None), proofs) == ""
    assert not is_limited(system.replace(implementation=None))


def test_limits_are_those_without_the_offset_of_the_law(calm):
    system, *_ = calm
    drive = drive_of(limited(system, saturation=(-3, 5), rate_limit=7.0))
    drive = replace(drive, offset=rational(1))
    found = input_limits(limited(system, saturation=(-3, 5), rate_limit=7.0), drive)
    assert (found.low, found.high, found.step) == (-4, 4, rational("7/100"))
    none = input_limits(system, drive)
    assert (none.low, none.high, none.step) == (-NO_LIMIT, NO_LIMIT, NO_LIMIT)
    limits = InputLimits(rational(-2), rational(3), rational(1))
    for size, step, holds in (
        (2, 1, True),
        (3, 1, False),
        (2, "11/10", False),
        ("21/10", 0, False),
    ):
        assert limits.hold(rational(size), rational(step)) is holds
    assert not InputLimits(rational(-3), rational(2), rational(1)).hold(rational(3), rational(1))
    assert InputLimits(rational(-3), rational(2), rational(1)).hold(rational(2), rational(1))


def test_a_claim_names_the_start_where_it_counts(calm):
    system, *_ = calm
    assert claim_of(system, "0.1") == "limsup |e_1(t)| <= 0.1"
    for limits in ({"saturation": (-3, 5)}, {"rate_limit": 7.0}):
        assert claim_of(limited(system, **limits), "0.1").endswith("<= 0.1 from simulation.x0")
    assert not jitters(system) and jitters(limited(system, jitter=0.05, delay=1))
    assert not jitters(system.replace(implementation=None))


def test_a_region_of_x0_alone_has_no_other_starts(calm):
    _, one, proofs = calm
    found, kept = from_x0_only(replace(one, polytope=BOX), proofs)
    assert found.starts == "x0" and found.polytope is None and len(kept) == len(proofs)


# margins of the period


def searched(monkeypatch, calm, serves, delays=1, cells=()):
    """The margins where a period serves as this function says: its bound, or a refusal."""
    system, *_ = calm
    proofs = [ImplementedProof(str(k), (1, 1), 5, (), "1", "1", str(1 + k)) for k in range(delays)]
    asked = []

    def prove(other, delay, cell, plant):
        period = other.implementation.period
        asked.append((period, int(delay)))
        bound = serves(period, int(delay))
        if bound is None:
            raise NoCertificate("no")
        return replace(proofs[int(delay)], bound=repr(bound)), {}

    monkeypatch.setattr(margins, "prove_implemented", prove)
    return period_margins(system, proofs, lambda other, again: ""), asked


def test_periods_are_searched_on_both_sides(monkeypatch, calm):
    found, asked = searched(monkeypatch, calm, lambda T, _: 1.0 if 0.004 <= T <= 0.05 else None)
    assert 0.05 / 1.03 <= found.slowest <= 0.05 and 0.004 <= found.fastest <= 0.004 * 1.03
    assert not found.slower_untried and not found.faster_untried and found.bound == 2
    assert {delay for _, delay in asked} == {0}
    found, _ = searched(monkeypatch, calm, lambda T, _: 2.0 if T < 0.03 else 2.001)
    assert 0.03 / 1.03 <= found.slowest < 0.03
    assert found.faster_untried and found.fastest == pytest.approx(0.01 / 8)
    found, asked = searched(monkeypatch, calm, lambda T, _: 1.0)
    assert found.slower_untried and found.slowest == pytest.approx(0.01 * 64)
    assert len(asked) == 6 + 3
    found, _ = searched(monkeypatch, calm, lambda T, _: None)
    assert 1 <= found.slowest / 0.01 < 1.03 and 0.97 < found.fastest / 0.01 <= 1


def test_every_delay_must_be_proven_at_the_last_period(monkeypatch, calm):
    """The worst delay is searched; the other one ends earlier."""

    def serves(T, delay):
        return 1.0 if (0.08 if delay == 1 else 0.03) >= T else None

    found, asked = searched(monkeypatch, calm, serves, delays=2)
    assert 0.01 < found.slowest <= 0.03 and not found.slower_untried and found.bound == 4
    assert (found.slowest, 0) in asked and (found.slowest, 1) in asked


@pytest.mark.parametrize(
    ("limit", "slowest"), [(0.0105, 0.01033), (0.0103, 0.01), (0.0107, 0.01067)]
)
def test_a_period_that_is_hardly_slower_is_the_own_one(monkeypatch, calm, limit, slowest):
    """On the way back from 0.64 s, by halves of an order: within a 32nd nothing is tried."""
    found, _ = searched(monkeypatch, calm, lambda T, delay: 1.0 if delay or limit >= T else None, 2)
    assert found.slowest == slowest and not found.slower_untried
    assert found.fastest == pytest.approx(0.01 / 8) and found.faster_untried


# files


def record(**changed):
    start = StartProof(
        of="x0",
        region=(("0", "0.1"), ("0", "0")),
        doublings=3,
        middle=1,
        phase="0",
        states=("1", "2"),
        input="3",
        peaks=("1", "2"),
    )
    proof = ImplementedProof("1/2", (1, 2), 5, ("1", "2"), "3", "4", "5", (start,))
    return copy.deepcopy(record_of(proof)) | changed


def test_a_proof_survives_its_record():
    (proof,) = implemented_proofs([record()])
    assert asdict(proof) == record(cell=(), rates=(), slow=(), split=()) and "cell" not in record()
    (ranged,) = implemented_proofs([record(cell=[["1/3", "2"]], rates=["1"])])
    assert ranged.cell == (("1/3", "2"),) and ranged.rates == ("1",)
    assert record_of(ranged)["cell"] == (("1/3", "2"),)
    assert is_implemented({"proof": [record()]})
    for body in ({"proof": []}, {"proof": [{}]}, {"proof": record()}, [], {}, {"proof": [3]}):
        assert not is_implemented(body)


def start(**changed):
    (first,) = record()["starts"]
    return [first | changed]


@pytest.mark.parametrize(
    "entry",
    [
        {"delay": 0.5},
        {"delay": "x"},
        {"delay": "1/0"},
        {"delay": "0" * 61},
        {"states": "12"},
        {"states": ["1", "x"]},
        {"input": 3},
        {"step": "1/2"},
        {"bound": None},
        {"rates": ["y"]},
        {"cell": [["2", "1"]]},
        {"cell": [["1"]]},
        {"cell": [["1", "1/0"]]},
        {"parts": [1, 2, 3]},
        {"parts": [1, 2.0]},
        {"parts": [1, True]},
        {"doublings": "5"},
        {"doublings": True},
        {"starts": {}},
        {"starts": start() * 3},
        {"starts": [3]},
        {"starts": start(more=1)},
        {"starts": start(region=[["0"], ["0", "1"]])},
        {"starts": start(region=[["0", "x"], ["0", "1"]])},
        {"starts": start(states="1")},
        {"starts": start(peaks=["z"])},
        {"starts": start(input=1)},
        {"starts": start(doublings=1.0)},
        {"starts": start(middle="1")},
        {"starts": start(of=1)},
        {"starts": start(phase=0)},
        {"more": 1},
    ],
)
def test_a_record_that_is_malformed_is_refused(entry):
    with pytest.raises(InputError, match="proof: "):
        implemented_proofs([record(**entry)])


def test_a_record_has_all_its_keys_and_a_file_few_delays():
    for key in record():
        with pytest.raises(InputError, match="must have"):
            implemented_proofs([{k: v for k, v in record().items() if k != key}])
    (first,) = record()["starts"]
    for key in first:
        with pytest.raises(InputError, match="starts must have"):
            implemented_proofs([record(starts=[{k: v for k, v in first.items() if k != key}])])
    many = [record(delay=f"{k}/100") for k in range(MAX_DELAY_PROOFS + 1)]
    assert len(implemented_proofs(many[:-1])) == MAX_DELAY_PROOFS
    with pytest.raises(InputError, match="at most 64 delays"):
        implemented_proofs(many)
    assert len(implemented_proofs([record(starts=start() * 2)])[0].starts) == 2


# cells


def test_without_ranges_there_is_one_proof_without_a_cell():
    proof = ImplementedProof("0", (1, 1), 5, (), "1", "1", "1")
    assert failed_cells([proof], None) == ""
    for proofs in ([], [proof, proof], [replace(proof, cell=(("0", "1"),))]):
        assert "one proof for each delay" in failed_cells(proofs, None)


class Ranges:
    def __init__(self, varies):
        self.varies = varies
        self.box = ((rational(0), rational(2)),)


def test_cells_for_one_delay_fill_the_ranges(monkeypatch):
    def proofs(*cells):
        made = ImplementedProof("0", (1, 1), 5, (), "1", "1", "1")
        return [replace(made, cell=(cell,)) for cell in cells]

    halves = proofs(("0", "1"), ("1", "2"))
    assert failed_cells(halves, Ranges(False)) == ""
    assert "do not cover" in failed_cells(halves[:1], Ranges(False))
    assert "vary in time need one cell" in failed_cells(halves, Ranges(True))
    assert failed_cells(proofs(("0", "2")), Ranges(True)) == ""
    wide = [replace(halves[0], cell=(("0", "1"), ("0", "1")))]
    assert "one interval for each range" in failed_cells(wide, Ranges(False))
    assert "more than" in failed_cells(halves * 600, Ranges(False))
    monkeypatch.setattr(cover_room, "MAX_PROOF_CELLS", 2)
    assert failed_cells(halves, Ranges(False)) == ""
    monkeypatch.setattr(cover_room, "MAX_PROOF_CELLS", 1)
    assert "more than 1 cells" in failed_cells(halves, Ranges(False))


# sizes of w


def test_the_size_of_an_uncertain_term():
    bound = replace(
        UNIT_W,
        gamma=rational("1/2"),
        beta=rational("1/3"),
        weights=(rational(3), rational(4)),
        Delta=(rational(5), rational(7)),
    )
    X = [flint.arb(1), rational(2)]
    expected = math.hypot(3, 8) / 2 + 5 + 14 + 1 / 3
    assert float(uncertain_size(bound, X).mid()) == pytest.approx(expected, rel=1e-14)
    assert np.isclose(float(uncertain_size(bound, [0, 0]).mid()), 1 / 3)


# what a certificate is made of


@pytest.mark.parametrize("limited", [True, False])
@pytest.mark.parametrize("regional", [True, False])
@pytest.mark.parametrize("shaken", [True, False])
@pytest.mark.parametrize("asked", [True, False])
@pytest.mark.parametrize("reason", ["", "|u| is large"])
def test_a_certificate_gathers_what_its_parts_say(
    monkeypatch, reason, asked, shaken, regional, limited
):
    made = ImplementedProof("0", (1, 1), 5, ("1", "2", "9"), "3", "1", "5")
    other = replace(made, states=("4", "1", "9"), input="2", bound="6", cell=(("0", "1"),))
    other = replace(other, slow=("z",))
    proven = [(made, {"a": 1.0}), (other, {"b": 2.0})]
    calls = []
    found = SimpleNamespace(reason=reason, starts="x0", peaks="P", polytope="T", proofs=("new",))

    def note(name, result):
        return lambda *parts, **named: calls.append((name, *parts)) or result

    states = []
    system = SimpleNamespace(
        plant=SimpleNamespace(n=2),
        truth=SimpleNamespace(states=states),
        settings=SimpleNamespace(x0=(7.0, 8.0)),
        implementation=SimpleNamespace(jitter=0.1 if shaken else 0.0),
    )
    refused = [""]
    for name, result in (
        ("is_limited", limited),
        ("is_regional", regional),
        ("_proven", (proven, "tried")),
        ("from_starts", found),
        ("period_margins", "M"),
        ("nominal_drive", SimpleNamespace(offset=rational("-1/2"))),
        ("assumptions", ["A"]),
        ("rated_terms", ("w_1",)),
        ("rates_unused", "why"),
    ):
        monkeypatch.setattr(certify_room, name, note(name, result))
    monkeypatch.setattr(certify_room, "limits_met", lambda system, proofs: refused[0])
    given, proofs = certify_implemented(system, from_start=asked, margins=asked, effort="high")
    names = [name for name, *_ in calls]
    partly = limited or regional
    looked = partly or (asked and not shaken)
    assert ("from_starts" in names) is looked
    assert ("period_margins" in names) is (asked and not (regional or shaken))
    assert given.margins == ("M" if asked and not (regional or shaken) else None)
    for name, *parts in calls:
        if name == "period_margins":
            assert parts[1:] == [(made, other), certify_room.limits_met, "tried"]
        if name == "rates_unused":
            assert parts[1] is other
    assert (given.bound, given.peak_input, given.states) == (6, 3.5, (4, 2))
    assert (given.parts, given.cells, given.slow) == ({"b": 2.0}, 1, ("w_1",))
    assert (given.assumptions, given.rates_unused, given.start) == (("A",), "why", (7.0, 8.0))
    failed = limited and looked and bool(reason)
    assert given.verified is not failed and given.reason == (reason if failed else "")
    assert given.saturation == ("none" if not limited else "may act" if failed else "inactive")
    assert given.starts == ("x0" if partly else "any")
    assert (given.peaks, given.polytope) == (("P", "T") if looked else (None, None))
    assert proofs == (() if failed else ("new",) if looked else (made, other))
    states.append("of its own")
    proven[1] = (replace(other, slow=()), {"b": 2.0})
    given, _ = certify_implemented(system)
    assert given.start == () and given.slow == () and given.margins is None
    refused[0] = "its limits"
    given, proofs = certify_implemented(system)
    assert (given.reason, given.exists, proofs) == ("its limits", False, ())


# a plant in a cell

RANGED = """
[plant]
states = ["x1", "x2"]
chain = [2]
drift = "a*x1 + 3*x2 + a/4"
input_gain = "g"
gain_sign = 1
[plant.constants]
a = 1
g = 4
[plant.ranges]
a = [1, 3]
g = [4, 5]
[plant.uncertainty]
tau = [0.5, 0]
gamma = [0.01, 0]
beta = [0.25, 0]
[truth]
input_gain = 4
omega = [0, 0]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [2, 3]
[simulation]
x0 = [0, 0]
duration = 5
[implementation]
period = 0.01
delay = 0.5
"""


@pytest.mark.parametrize(
    ("a", "g", "drift", "gain", "rest", "channels"),
    [
        ((1, 1), (4, 4), 1, 4, "0", []),
        ((3, 3), (5, 5), 3, 5, "7/16", []),
        ((1, 3), (4, 4), 2, 4, "1/4", [((1, 0), 0, "1/4", 1.0)]),
        ((1, 1), (4, 5), 1, 4.5, "-1/32", [((0, 0), 1, "1/16", 0.5)]),
        ((1, 3), (4, 5), 2, 4.5, "7/32", [((1, 0), 0, "1/4", 1), ((0, 0), 1, "1/16", 0.5)]),
    ],
)
def test_a_plant_in_a_cell_is_its_middle_and_a_channel_for_each_range(
    a, g, drift, gain, rest, channels
):
    """x2' = a x1 + 3 x2 + a/4 + g (u - 1/16), where the law cancels 1/4 with a gain of 4."""
    plant = RangedPlant(certrack.loads(RANGED))
    drive = plant.drive(tuple(tuple(map(rational, ends)) for ends in (a, g)), rational("1/4"))

    def numbers(matrix):
        return [[float(v) for v in row] for row in matrix.tolist()]

    assert numbers(drive.A) == [[0, 2], [drift, 3]] and numbers(drive.b) == [[0], [gain]]
    width = [size for *_, size in channels]
    assert numbers(drive.W) == [[0.5, 0] + [0] * len(width), [0, 1, *width]]
    assert drive.offset == rational("-1/16") and drive.delay == rational("1/4")
    assert [(c.of_x, c.of_u) for c in drive.channels] == [(x, u) for x, u, *_ in channels]
    of_w, of_rest, *others = drive.uncertain
    more = (0,) * len(channels)
    assert (of_w.gamma, of_w.beta) == (rational("1/100"), rational("1/4"))
    assert (of_w.weights, of_w.Delta) == ((1, 1, *more), (0, 0, *more))
    assert (of_rest.gamma, of_rest.beta) == (0, abs(rational(rest)))
    assert of_rest.weights == of_rest.Delta == (0, 0, *more)
    for k, (bound, (_, _, constant, _)) in enumerate(zip(others, channels, strict=True)):
        assert (bound.gamma, bound.beta) == (0, rational(constant))
        assert bound.weights == (0, 0, *more)
        assert bound.Delta == tuple(int(i == 2 + k) for i in range(2 + len(channels)))
    assert plant.box == (tuple(map(rational, (1, 3))), tuple(map(rational, (4, 5))))
    assert not plant.varies
    alone = certrack.loads(RANGED).replace(implementation=None)
    with pytest.raises(NoCertificate, match="has no .implementation"):
        RangedPlant(alone)


@pytest.mark.parametrize(("slow", "pole"), [(0.0, 1.0), (0.02, 1 - math.exp(-0.5))])
def test_differences_are_filtered_by_a_pole_that_is_1_without_a_filter(calm, slow, pole):
    """Of samples every 10 ms."""
    system, *_ = calm
    drive = replace(system.implementation, velocity=("x2",), velocity_filter=slow)
    found = _numbers(system.replace(implementation=drive), drive)[symbol("ctl_filter")]
    assert float(found) == pytest.approx(pole, rel=1e-15)

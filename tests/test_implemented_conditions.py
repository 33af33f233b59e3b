"""Conditions of a proof of the implemented loop, at their edges: with numbers that are made up."""

import math
from dataclasses import replace
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from test_fixed_point_parts import q

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import cover, margins, start_proof, superposition
from certrack.certificates.implemented import drive as drive_room
from certrack.certificates.implemented import from_starts as from_starts_room
from certrack.certificates.implemented import premises as premises_room
from certrack.certificates.implemented import proof as module
from certrack.certificates.implemented.input_limits import region_of
from certrack.certificates.implemented.proof import (
    MAX_CELLS_OF_INPUT,
    MAX_DOUBLINGS,
    ImplementedProof,
    cells_of,
    failed_implemented,
)
from certrack.certificates.implemented.ranged import refuse_in_cells
from certrack.model.implementation import Implementation


def claim(**changed):
    """X = (1, 2), U = 3, |e_1| <= 4 and steps of at most 5."""
    numbers = {
        "delay": "1/2",
        "parts": (1, 1),
        "doublings": 3,
        "states": ("1", "2"),
        "input": "3",
        "step": "5",
        "bound": "4",
        "starts": (),
    }
    return ImplementedProof(**(numbers | changed))


GLOBAL = SimpleNamespace(is_regional=False)


def image(*values):
    return [flint.arb(q(v)) for v in values]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (("4", "0.99", "1.99", "2.99", "5"), ""),
        (("4", "1", "1.9", "2.9", "5"), "state 1"),
        (("4", "0.9", "2", "2.9", "5"), "state 2"),
        (("4", "0.9", "1.9", "3", "5"), "the input"),
        (("4.001", "0.9", "1.9", "2.9", "5"), "the bound is smaller"),
        (("4", "0.9", "1.9", "2.9", "5.001"), "the bound of the input's steps"),
        (("3", "0", "0", "0", "0"), ""),
    ],
)
def test_what_is_claimed_is_above_its_image(values, reason):
    found = module._not_proven(GLOBAL, image(*values), claim())
    assert reason in found and bool(found) == bool(reason)


def test_the_bounds_of_every_start_lead_down(monkeypatch):
    asked = []
    monkeypatch.setattr(
        module, "not_reached", lambda bounds, v, start: asked.append((v, start)) or start
    )
    fine = image("4", "0.9", "1.9", "2.9", "5")
    starts = claim(starts=("", "far"))
    assert module._not_proven(GLOBAL, fine, starts) == "" and asked == []
    regional = SimpleNamespace(is_regional=True)
    assert module._not_proven(regional, fine, starts) == "far"
    assert asked == [(([q(1), q(2)], q(3)), ""), (([q(1), q(2)], q(3)), "far")]
    assert module._not_proven(regional, fine, claim(starts=("",))) == ""


@pytest.mark.parametrize("at", range(1, 7))
def test_with_jitter_steps_and_rates_are_above_theirs_too(at):
    proof = claim(rates=("6", "7"))
    below = np.array([4, 0.9, 1.9, 2.9, 4.9, 5.9, 6.9])
    assert module._not_above_timed(image(*below), proof) == ""
    below[at] = (1, 2, 3, 5, 6, 7)[at - 1]
    assert "not above" in module._not_above_timed(image(*below), proof)


@pytest.mark.parametrize(
    ("changed", "passed"),
    [
        ({"doublings": 0}, True),
        ({"doublings": MAX_DOUBLINGS}, True),
        ({"doublings": MAX_DOUBLINGS + 1}, False),
        ({"doublings": -1}, False),
        ({"parts": (1, MAX_CELLS_OF_INPUT)}, True),
        ({"parts": (0, 1)}, False),
        ({"parts": (1, 0)}, False),
        ({"parts": (1, MAX_CELLS_OF_INPUT + 1)}, False),
    ],
)
def test_a_proof_has_so_many_parts_and_periods(monkeypatch, changed, passed):
    def stop(*_):
        raise NoCertificate("passed")

    monkeypatch.setattr(module, "refuse_in_cells", stop)
    found = failed_implemented(None, claim(**changed), q("0.5"))
    assert found == "passed" if passed else "parts must be" in found
    assert "not that of the system" in failed_implemented(None, claim(**changed), q("0.25"))


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, "passed"),
        ({"states": ("1",)}, "the shape"),
        ({"states": ("1", "-1e-9")}, "negative"),
        ({"states": ("0", "0"), "input": "0"}, "passed"),
        ({"input": "-1"}, "negative"),
        ({"rates": ("1", "1")}, "the rates that jitter needs"),
    ],
)
def test_a_proof_has_the_shape_of_its_system(monkeypatch, changed, reason):
    def stop(*_):
        raise NoCertificate("passed")

    drive = SimpleNamespace(sized=2, n=2, jitter=0)
    monkeypatch.setattr(module, "refuse_in_cells", lambda *_: None)
    monkeypatch.setattr(module, "drive_in", lambda *_: drive)
    monkeypatch.setattr(module, "one_period", stop)
    assert reason in failed_implemented(None, claim(**changed), q("0.5"))
    drive.jitter = 1
    if reason == "passed":
        assert "jitter needs" in failed_implemented(None, claim(**changed), q("0.5"))
        timed = claim(**changed, rates=("1", "1"))
        assert failed_implemented(None, timed, q("0.5")) == "passed"


def test_bounds_with_jitter_are_not_negative(monkeypatch):
    values = image("4", "0.9", "1.9", "2.9", "4.9", "5.9", "6.9")
    monkeypatch.setattr(module, "_timed_image", lambda *_: values)
    monkeypatch.setattr(module, "TimedBounds", SimpleNamespace(of=lambda *_: None))
    bounds = SimpleNamespace(rows=())

    def failed(**changed):
        return module._failed_with_jitter(None, bounds, claim(rates=("6", "7"), **changed))

    assert failed() == "" and "smaller" in failed(bound="3.999")
    assert "negative" in failed(step="-5") and "not above" in failed(step="4.9")
    assert "negative" in module._failed_with_jitter(None, bounds, claim(rates=("6", "-7")))


def test_cells_are_as_long_as_the_fastest_motion_allows():
    def drive(pole, T, delay):
        return SimpleNamespace(A=flint.arb_mat([[-pole]]), T=q(T), delay=q(delay))

    part = module.CELL_PART
    assert cells_of(drive(1, "0.0001", "0.5")) == (1, 1)
    slow, rest = cells_of(drive(500, "0.01", "1.25"))
    assert (slow, rest) == (math.ceil(1.25 / part), math.ceil(3.75 / part))
    assert cells_of(drive(10**9, "1", "0.5")) == (MAX_CELLS_OF_INPUT,) * 2
    assert cells_of(drive(1000, "0.01", "3"))[0] == 1


def test_the_work_of_a_proof(monkeypatch):
    monkeypatch.setattr(cover, "periods_needed", lambda period: 3)
    period = SimpleNamespace(
        drive=SimpleNamespace(sized=2, q=1), cells=[0, 0], W=flint.arb_mat(2, 1), size=5
    )
    assert cover._work_of(period) == 8 * (3 * 2 * 4 + 5) * (3 * 2 + 2 * 2 * 2 * 4 + 10)


def test_a_text_is_above_its_ball():
    for value in ("0.1", "1", "123.456"):
        ball = flint.arb(q(value))
        text = module._text_above(ball)
        assert 1 + 9e-7 < float(text) / float(value) < 1 + 2e-6  # for checkers that differ a little


@pytest.mark.parametrize("cell", [(), (("1", "2"),)])
@pytest.mark.parametrize("bound", [None, "x1**2"])
@pytest.mark.parametrize("jitter", [None, 0, 0.1])
def test_what_is_not_covered_in_cells(cell, bound, jitter):
    drive = None if jitter is None else SimpleNamespace(jitter=jitter)
    uncertainty = SimpleNamespace(bound=bound)
    system = SimpleNamespace(implementation=drive, plant=SimpleNamespace(uncertainty=uncertainty))
    stated = [name for name, there in (("bound", bound), ("jitter", jitter)) if there]
    if not cell or not stated:
        refuse_in_cells(system, cell)
        return
    with pytest.raises(
        NoCertificate, match=" and ".join(f"[.]{name}" for name in stated)[:12]
    ) as it:
        refuse_in_cells(system, cell)
    assert (" are not covered" in str(it.value)) == (len(stated) == 2)


# what the reference does between samples


@pytest.mark.parametrize(
    ("steepest", "between", "jumping", "expected"),
    [
        (2.5, None, None, ("5/2", None, False)),
        (None, 2.5, None, (None, None, False)),  # nothing is known of its jumps
        (None, None, (3.0, 0.5), (None, None, False)),
        (None, None, (3.0, math.inf), (None, None, False)),
        (None, 2.5, (3.0, 0.5), ("5/2", ("3", "1/2"), False)),
        (None, 2.5, (3.0, 0.25), ("5/2", ("3", "1/4"), False)),  # in every period
        (None, 2.5, (3.0, 0.125), (None, None, False)),  # more often
        (None, 2.5, (3.0, math.inf), ("5/2", None, True)),
        (None, 2.5, (math.inf, 0.125), (None, None, False)),
    ],
)
def test_jumps_of_the_reference_are_none_one_or_a_period_apart(
    monkeypatch, steepest, between, jumping, expected
):
    """The period is 1/4 s."""
    asked = []

    def bound(reference, order, *, between_jumps=False):
        asked.append((reference, order))
        return between if between_jumps else steepest

    monkeypatch.setattr(drive_room, "lipschitz_bound", bound)
    monkeypatch.setattr(drive_room, "jumps", lambda *parts: asked.append(parts) or jumping)
    found = drive_room._smoothness(SimpleNamespace(reference="it"), 3, q("0.25"))
    lipschitz, several, once = expected
    assert set(asked) == {("it", 3)} and set(found) == {"lipschitz", "jumps", "jumps_once"}
    assert found["lipschitz"] == (None if lipschitz is None else q(lipschitz))
    assert found["jumps"] == (None if several is None else tuple(map(q, several)))
    assert found["jumps_once"] is once


# refusals in cells


@pytest.mark.parametrize("effort", ["fast", "default", "high"])
@pytest.mark.parametrize("varies", [True, False])
@pytest.mark.parametrize("proven", [0, 0.05, 0.2, 0.5])
@pytest.mark.parametrize("cause", ["nominal", "corner", "widths"])
def test_a_refusal_says_what_would_help(monkeypatch, cause, proven, varies, effort):
    """Which part of the ranges' widths has a bound in one cell is tried, the widest first."""
    tried = []

    def prove(system, delay, cell, plant):
        assert (system, delay, plant.varies) == ("it", 1, varies)
        tried.append(cell)
        if float(cell) > proven or cause == "nominal":
            raise NoCertificate("there is none")

    monkeypatch.setattr(cover, "prove_implemented", prove)
    monkeypatch.setattr(cover, "scaled", lambda loop, scale: scale)
    monkeypatch.setattr(cover, "names", lambda loop: ("K", "J"))
    corner = "at K = 1 it is unstable" if cause == "corner" else ""
    monkeypatch.setattr(cover, "_lost_corner", lambda plant, delay: corner)
    plant = SimpleNamespace(loop="loop", varies=varies)
    failed = ((q(1), q(2)), (q(3), q("3.5")))
    said = cover._no_bound_for("it", plant, 1, ["a", "b", "c"], failed, effort)
    if cause == "nominal":
        assert said.endswith("the nominal ones: there is none") and tried == [0]
        return
    if cause == "corner":
        assert said.startswith("plant.ranges are too wide: at K = 1 it is unstable; narrow them")
        assert tried == [0]
        return
    wider = [v for v in (q("0.5"), q("0.2"), q("0.05")) if float(v) >= proven]
    assert [float(v) for v in tried] == [0, *map(float, wider)]
    percent = f"in one cell: with {100 * proven:.0f} % of their widths" if proven else ""
    assert percent in said and ("of their widths" in said) is bool(proven)
    ends = "K in [1, 2], J in [3, 3.5]"
    assert (f"in all of them ({ends})" in said) is varies
    assert ("(constants_vary)" in said) is varies
    assert ("take --effort default, which cuts" in said) is (effort == "fast" and not varies)
    last = effort != "fast" and not varies
    assert (f"none for {ends}, the worst of 3 cells" in said) is last
    assert ("take --effort high" in said) is (last and effort == "default")
    assert "narrow plant.ranges" in said


@pytest.mark.parametrize("looked_at", [{}, {"1/2": "bounds of cells"}])
def test_other_periods_are_proven_in_few_cells_for_each_delay(monkeypatch, looked_at):
    asked = []

    def prove(*parts):
        asked.append(parts)
        return [(f"proof {len(asked)}", {}), ("another", {})]

    monkeypatch.setattr(margins, "prove_few_cells", prove)
    monkeypatch.setattr(margins, "coarsest", lambda *parts: ("coarsest", *parts))
    plant = SimpleNamespace(box="box")
    proofs = [claim(delay=text) for text in ("1/2", "1/2", "3", "1/2")]
    found = margins._in_few_cells("it", plant, looked_at, proofs, 2.0)
    assert found == ["proof 1", "another", "proof 2", "another"]
    begin = ("coarsest", "box", "bounds of cells", 2.0) if looked_at else ()
    assert asked == [("it", plant, q("0.5"), 2.0, begin), ("it", plant, q(3), 2.0, ())]


def test_a_period_is_proven_for_each_delay_and_cell(monkeypatch):
    """What is searched is the worst proof; at the ends all of them, in few cells."""
    asked = []

    def again(system, proof, plant):
        asked.append(("one", system.period, proof.cell, plant))
        return claim(bound="7.9")

    def few(system, plant, tried, proofs, admitted):
        asked.append(("few", system.period, plant, tried, proofs, admitted))
        return [claim(bound="7.9" if system.period < 0.05 else "8.1"), claim(bound="1")]

    monkeypatch.setattr(margins, "_again", again)
    monkeypatch.setattr(margins, "_in_few_cells", few)
    monkeypatch.setattr(margins, "RangedPlant", lambda system: ("plant", system.period))
    drive = Implementation(period=0.01)

    def at(period):
        return SimpleNamespace(
            period=period,
            implementation=drive,
            replace=lambda implementation: at(implementation.period),
        )

    cells = [(("0", "1"),), (("1", "2"),)]
    proofs = [claim(cell=cells[0], bound="3"), claim(cell=cells[1])]
    tried = {"1/2": {}}
    found = margins.period_margins(at(0.01), proofs, lambda *_: "", tried)
    # 0.64 s, then half of the way back to the file's own, in orders of magnitude, until all are
    assert found.bound == 8 and found.slowest == 0.02828 and not found.slower_untried
    assert found.fastest == pytest.approx(0.01 / 8) and found.faster_untried
    ones = [parts for parts in asked if parts[0] == "one"]
    assert {parts[2] for parts in ones} == {cells[1]}
    assert all(plant == ("plant", period) for _, period, _, plant in ones)
    for _, period, plant, known, of, admitted in (p for p in asked if p[0] == "few"):
        assert (plant, known, of, admitted) == (("plant", period), tried, proofs, 8)
    asked.clear()
    margins.period_margins(at(0.01), proofs, lambda *_: "")
    assert {parts[3] == {} for parts in asked if parts[0] == "few"} == {True}
    asked.clear()
    alone = margins.period_margins(at(0.01), proofs[1:], lambda *_: "", tried)
    assert alone.slowest == pytest.approx(0.64) and {parts[0] for parts in asked} == {"one"}
    limited = margins.period_margins(at(0.01), proofs, lambda other, _: "x" * (other.period > 0.02))
    assert 0.0194 < limited.slowest <= 0.02 and not limited.slower_untried


# starts of a region


@pytest.mark.parametrize("refused", [(), ("polytope",), ("x0",), ("x0", "polytope")])
@pytest.mark.parametrize("regional", [True, False])
def test_a_region_needs_a_start_and_may_have_a_box(monkeypatch, regional, refused):
    def prove(of):
        if of in refused:
            raise NoCertificate("it is too far")
        return f"proof of {of}"

    asked = []
    prover = SimpleNamespace(prove=prove)
    monkeypatch.setattr(module, "is_regional", lambda system: regional)
    monkeypatch.setattr(module, "start_prover", lambda *parts: asked.append(parts) or prover)
    if not regional:
        assert module._starts_of_region("it", 1, (2, 3)) == () and not asked
        return
    if "x0" in refused:
        with pytest.raises(NoCertificate, match=r"the states keep \(it is too far\)"):
            module._starts_of_region("it", 1, (2, 3))
    else:
        found = module._starts_of_region("it", 1, (2, 3))
        assert found == ("proof of x0", "proof of polytope")[: 2 - len(refused)]
    assert asked == [("it", 1, (2, 3))]


@pytest.mark.parametrize("region", [None, ("X",)])
def test_a_region_that_the_states_keep_is_a_premise(monkeypatch, region):
    monkeypatch.setattr(premises_room, "region_of_runs", lambda proofs: region)
    monkeypatch.setattr(premises_room, "while_within", lambda system, X: f"{system} within {X[0]}")
    found = premises_room._region("it", ())
    if region is None:
        assert found == []
    else:
        (premise,) = found
        assert (premise.name, premise.status) == ("region of states", "proven")
        assert "proven to keep it within X from simulation.x0" in premise.detail


def finding(*starts, polytope=None, reason=""):
    entry = claim(starts=tuple(SimpleNamespace(of=of, doublings=d) for of, d in starts))
    return from_starts_room.Findings((entry,), None, polytope, reason)


def test_the_starts_of_another_cell_begin_with_as_many_periods(monkeypatch):
    """And again with few, where that has a reason or no polytope; without cells it never does."""
    known = (("x0", 7), ("polytope", 9))
    assert from_starts_room._begin_near(finding(*known)) == {"x0": 7, "polytope": 9}
    box = SimpleNamespace(largest_box=lambda: "box", is_region=False)
    answers, asked = [], []

    def starts_of(system, proof, plant, begin):
        asked.append((proof.cell, plant, begin))
        return answers.pop(0)

    monkeypatch.setattr(from_starts_room, "_starts_of_delay", starts_of)
    monkeypatch.setattr(from_starts_room, "RangedPlant", lambda system: "plant")
    monkeypatch.setattr(from_starts_room, "peaks_of", lambda system, proofs: ("peaks", *proofs))
    monkeypatch.setattr(from_starts_room, "common", lambda polytopes: polytopes[-1])
    cells = [claim(cell=((str(k), str(k + 1)),)) for k in range(3)]
    near = {"x0": 7, "polytope": 9}

    def found(proofs, *given):
        asked.clear()
        answers[:] = given
        result = from_starts_room.from_starts("it", proofs)
        assert not answers
        return result, [begin for *_, begin in asked]

    good = finding(*known, polytope=box)
    result, begins = found(cells, good, good, good)
    assert begins == [{}, near, near] and result.polytope is box and result.reason == ""
    assert [plant for _, plant, _ in asked] == ["plant"] * 3
    assert result.peaks == ("peaks", *result.proofs) and len(result.proofs) == 3
    assert result.starts == "x0"
    bad = finding(*known, polytope=box, reason="no")
    result, begins = found(cells[:2], good, bad, good)
    assert begins == [{}, near, {}] and result.reason == ""
    result, begins = found(cells[:2], good, finding(*known), bad)
    assert begins == [{}, near, {}] and result.reason == "no" and result.polytope is box
    result, begins = found(cells[:2], finding(*known), good)
    assert begins == [{}, near] and result.polytope is None
    result, begins = found([claim(), claim()], good, good)
    assert begins == [{}, {}] and {plant for _, plant, _ in asked} == {None}
    box.largest_box = lambda: None
    assert found(cells[:1], good)[0].polytope is None


# regions of starts


def test_without_an_ensemble_a_state_alone_may_be_so_far_within_the_limits():
    """The largest of all periods; what hardly moves the input counts a hundredth of another."""
    before = np.zeros((2, 5, 4))
    before[0, -2:, :3] = [[2.0, -0.5, 1e-6], [1.0, 0.25, 0.0]]
    before[1, -2:, :3] = [[-4.0, 0.1, 0.0], [0.5, -2.0, 0.0]]
    before[:, :3] = 1e9  # of other outputs
    frame = SimpleNamespace(gains=SimpleNamespace(before=SimpleNamespace(value=before)))
    drive = SimpleNamespace(n=3, offset=q("0.5"), T=q("0.01"))
    drawn = [SimpleNamespace(low=-1.0, high=2.0)] * 3

    def system(x0=(0.0, 0.0, 0.0), states=(), drawn=None):
        return SimpleNamespace(
            truth=SimpleNamespace(states=states),
            settings=SimpleNamespace(x0=x0),
            varied=SimpleNamespace(x0=drawn),
            implementation=Implementation(period=0.01, saturation=(-3, 9), rate_limit=300.0),
        )

    def region(**changed):
        found = region_of(system(**changed), drive, lambda: frame)
        return [tuple(map(float, pair)) for pair in found]

    # room of 6 and 3; columns 4 and 1, 1/2 and 2, 0.04 and 0.02
    assert region() == [(-1.5, 1.5), (-1.5, 1.5), (-150, 150)]
    assert region(x0=(-2.0, 1.0, -151.0)) == [(-2, 2), (-1.5, 1.5), (-151, 151)]
    assert region(x0=(0.0, 3.0, -4.0), drawn=drawn) == [(-1, 2), (-1, 3), (-4, 2)]
    with pytest.raises(NoCertificate, match="states of its own"):
        region(states=("a",))


# steps down


def test_steps_down_end_where_a_bound_would_rise_or_hardly_falls():
    def down(image, *begin):
        asked = []

        def counted(v):
            asked.append([float(entry) for entry in v])
            return image(v)

        found = superposition._down(counted, [flint.arb(v) for v in begin])
        return [float(v) for v in found], len(asked)

    assert down(lambda v: [v[0] / 2, 2 * v[1]], 8, 1) == ([8, 1], 1)
    assert down(lambda v: [v[0], v[1]], 8, 1) == ([8, 1], 1)
    found, steps = down(lambda v: [1 + v[0] / 2, v[1]], 8, 1)
    assert found == [8, 1] and steps == 1  # its margin would raise the second one
    found, steps = down(lambda v: [1 + v[0] / 2, v[1] / 2 + 1], 8, 2.5)
    assert found == pytest.approx([2, 2], rel=2e-4) and min(found) > 2 and 10 < steps < 20
    found, steps = down(lambda v: [v[0] / 2], 1.0)
    assert steps == 40 and found[0] == pytest.approx(2.0**-40, rel=1e-4)
    found, steps = down(lambda v: [flint.arb(1)], 1.00001)
    assert steps == 1 and found[0] == pytest.approx(1 + superposition.FIXED_POINT_MARGIN, rel=1e-9)
    (found,), steps = down(lambda v: [0 * v[0]], 1.0)
    assert 0 < found < 1e-270  # strictly above where nothing acts


# how many periods, and what is refused at once


def test_so_many_periods_are_summed_that_hardly_anything_is_left():
    """2^d periods of radius r: r^(2^d) <= 1e-9, up to d = 18; at once where nothing is left."""

    def needed(radius, **left):
        period = SimpleNamespace(map=flint.arb_mat([[radius]]))
        return module.periods_needed(period, **left)

    assert [needed(v) for v in (0.0, 1e-12, 0.5, 0.99)] == [1, 1, 5, 12]
    assert needed(0.5, left=1e-3) == 4 and needed(-0.5) == 5
    last = math.log(1e-9) / 2**MAX_DOUBLINGS
    assert needed(math.exp(last * 1.001)) == MAX_DOUBLINGS
    with pytest.raises(NoCertificate, match="too slowly"):
        needed(math.exp(last / 1.001))
    for radius in (1.0, -1.0, 1.5, math.inf):
        with pytest.raises(NoCertificate, match="is unstable"):
            needed(radius)


def test_what_is_not_covered_in_cells_is_refused_before_it_is_looked_at(monkeypatch):
    def stop(*_):
        raise NoCertificate("at once")

    monkeypatch.setattr(module, "refuse_in_cells", stop)
    monkeypatch.setattr(module, "drive_in", lambda *_: pytest.fail("it was looked at"))
    with pytest.raises(NoCertificate, match="at once"):
        module.prove_implemented(None, q(1), ((q(1), q(2)),))
    assert failed_implemented(None, claim(), q("0.5")) == "at once"


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, ""),
        ({"states": ("1", "-0.5")}, "negative"),
        ({"input": "-0.5"}, "negative"),
        ({"phase": "any"}, ""),
        ({"peaks": ("1", "1.999", "3", "4", "5")}, "smaller"),
        ({"peaks": ("1", "2", "3", "4", "4.999")}, "smaller"),
        ({"peaks": ("9", "9", "9", "9", "9")}, ""),
    ],
)
@pytest.mark.parametrize("known", [True, False])
def test_a_proof_of_a_start_is_computed_anew(monkeypatch, known, changed, reason):
    numbers = {
        "of": "x0",
        "phase": "file",
        "region": (),
        "doublings": 5,
        "middle": 7,
        "states": ("1", "2"),
        "input": "0.1",
        "peaks": ("1", "2", "3", "4", "5"),
    }
    proof = start_proof.StartProof(**(numbers | changed))
    asked = []
    found = SimpleNamespace(peaks=np.arange(1.0, 6.0))
    prover = SimpleNamespace(
        system="it",
        drive="drive",
        _is_well_formed=lambda proof: proof.doublings == 5,
        _starts=lambda *parts: parts,
        bounds=lambda *parts: asked.append(parts) or found,
    )
    phase = "file" if known else "any"
    monkeypatch.setattr(start_proof, "phase_of", lambda *parts: phase)
    if not reason and proof.phase == "file" and not known:
        reason = "not known exactly"
    if reason == "smaller" and not known:
        reason = "not known exactly"
    if reason:
        with pytest.raises(NoCertificate, match=reason):
            start_proof.StartProver.evidence(prover, proof)
    else:
        assert start_proof.StartProver.evidence(prover, proof) is found
        ((starts, doublings, middle, later),) = asked
        assert (starts, doublings, middle) == ((proof.phase, ()), 5, 7)
        assert (later.states == (1, 2) and 0 < 0.1 - later.input < 1e-16) or later.input == 0.1
    with pytest.raises(NoCertificate, match="the shape"):
        start_proof.StartProver.evidence(prover, replace(proof, doublings=6))

"""Claims on a region part by part: the descent from later bounds, the largest box of starts."""

import math
from inspect import signature
from types import SimpleNamespace

import flint
import pytest
from test_implemented_formulas import exact_period

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import cover, proof, start_proof
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.drive import DRIVE_BITS
from certrack.certificates.implemented.fixed_point import FIXED_POINT_MARGIN
from certrack.certificates.implemented.regional import (
    LARGEST_BOX,
    descend,
    in_the_long_run,
    largest_region,
    not_reached,
)
from certrack.certificates.implemented.start_proof import StartProver


class Halving:
    """F(x, u) = (1 + x/2, 3 + u/2), whose fixed point is (2, 6)."""

    def __init__(self, least=(1.0, 3.0)):
        self.least, self.asked = least, 0

    def image(self, X, U):
        self.asked += 1
        (x,) = X
        return [None, flint.arb(self.least[0]) + x / 2, flint.arb(self.least[1]) + U / 2, None]


def floats(balls):
    return [float(v) for v in balls]


def test_bounds_go_down_to_the_fixed_point_and_stand_still_there():
    found = floats(descend(Halving(), ([10], 20), lambda v: False))
    assert found == pytest.approx([2, 6], rel=1e-7)
    assert found[0] >= 2 and found[1] >= 6
    # what is below its image already stays: nothing follows of a larger one
    assert floats(descend(Halving(), ([1.5], 20), lambda v: False)) == pytest.approx([1.5, 6])
    assert floats(descend(Halving(), ([1.5], 5), lambda v: False)) == [1.5, 5]


def test_bounds_go_down_as_far_as_is_wanted():
    loop = Halving()
    assert floats(descend(loop, ([10], 20), lambda v: True)) == [10, 20] and loop.asked == 0
    assert floats(descend(loop, ([10], 20), lambda v: v[0] < 5)) == [4, 9.5]
    assert loop.asked == 2


def start(states, input):
    return SimpleNamespace(states=states, input=input)


def test_the_long_run_is_the_largest_that_any_start_leads_to():
    """From (1.5, 20) the state stays and the input falls to 6; from (10, 5) the other way."""
    states, of_input = in_the_long_run(Halving(), [start(["1.5"], "20"), start(["10"], "5")])
    assert states == pytest.approx([2 * (1 + FIXED_POINT_MARGIN)], rel=1e-7)
    assert of_input == pytest.approx(6 * (1 + FIXED_POINT_MARGIN), rel=1e-7)
    assert states[0] > 2 and of_input > 6
    states, _ = in_the_long_run(Halving((0.0, 3.0)), [start(["0"], "20")])
    assert 0 < states[0] < 1e-200  # strictly above where nothing acts


@pytest.mark.parametrize(
    ("states", "of_input", "reached"),
    [(2.1, 6.1, True), (2.1, 5.9, False), (1.9, 6.1, False), (10, 20, True), (4, 9.5, True)],
)
def test_a_claim_of_the_long_run_is_one_that_a_start_leads_to(states, of_input, reached):
    said = not_reached(Halving(), ([flint.arb(states)], flint.arb(of_input)), start(["10"], "20"))
    assert (said == "") is reached
    assert reached or "do not lead down" in said


def system(n=2, drawn=None, states=()):
    return SimpleNamespace(
        truth=SimpleNamespace(states=states),
        varied=SimpleNamespace(x0=drawn),
        plant=SimpleNamespace(n=n),
    )


def largest(limit, **options):
    """The largest box whose first state is within a limit, and the boxes that were tried."""
    tried = []

    def holds(box):
        tried.append(box)
        assert all(float(low) == -float(high) for low, high in box)
        return float(box[0][1]) <= limit

    return largest_region(system(**options), holds), tried


@pytest.mark.parametrize("limit", [1.0, 0.999, 1.5, 37.0, 2e-5, 9.99e5])
def test_the_largest_box_is_within_what_holds_and_near(limit):
    found, tried = largest(limit)
    size = float(found[0][1])
    assert limit / 1.0011 <= size <= limit and found in tried
    assert found[1] == found[0]
    assert all(float(f"{float(high):.5g}") == float(high) for _, high in found)


def test_a_box_has_the_shape_of_the_starts_that_are_drawn():
    drawn = [SimpleNamespace(low=-2.0, high=1.0), SimpleNamespace(low=-3.0, high=8.0)]
    found, _ = largest(1.0, drawn=drawn)
    sizes = [float(high) for _, high in found]
    assert 1 / 1.0011 <= sizes[0] <= 1 and sizes[1] == pytest.approx(4 * sizes[0], rel=1e-4)


def test_a_box_is_looked_for_between_two_scales():
    found, _ = largest(float("inf"))
    assert 0.5 * LARGEST_BOX < float(found[0][1]) <= 2 * LARGEST_BOX
    with pytest.raises(NoCertificate, match="no bounds from a box"):
        largest(0.0)
    with pytest.raises(NoCertificate, match="states of its own"):
        largest(1.0, states=("a",))


@pytest.mark.parametrize("regional", [True, False])
def test_a_region_of_starts_is_where_bounds_hold(monkeypatch, regional):
    """With the periods that x(0) = 0 needs, half of them before the later bounds begin."""
    asked = []

    def bounds(starts, doublings, middle, later):
        asked.append((starts, doublings, middle, later))
        if "far" in starts:
            raise NoCertificate("too far")

    def largest(system, holds):
        return "largest of", system, holds("near"), holds("far")

    prover = SimpleNamespace(
        system="it", drive="drive", first_frame="frame", bounds=bounds, _doublings=lambda phase: 7
    )
    monkeypatch.setattr(start_proof, "is_regional", lambda system: regional)
    monkeypatch.setattr(start_proof, "largest_region", largest)
    monkeypatch.setattr(start_proof, "region_of", lambda *parts: parts)
    monkeypatch.setattr(start_proof, "start_set_of", lambda *parts: parts)
    found = StartProver._region(prover, "phase")
    if regional:
        assert found == ("largest of", "it", True, False)
        near, far = (("it", "drive", "phase", region) for region in ("near", "far"))
        assert asked == [(near, 7, 64, None), (far, 7, 64, None)]
    else:
        assert found == ("it", "drive", "frame") and not asked


@pytest.mark.parametrize(("needed", "looked_at"), [(5, 6), (12, 13), (13, 13)])
def test_a_region_is_looked_for_with_twice_the_periods_of_the_origin(
    monkeypatch, needed, looked_at
):
    asked = []

    def search(starts, enough):
        asked.append(starts)
        assert enough(None) is True
        return needed, None

    monkeypatch.setattr(start_proof, "start_set_of", lambda *parts: parts)
    prover = SimpleNamespace(system="it", drive=SimpleNamespace(n=2), search=search)
    assert StartProver._doublings(prover, "phase") == looked_at
    assert asked == [("it", prover.drive, "phase", (("0.0", "0.0"), ("0.0", "0.0")))]


@pytest.mark.parametrize("worst", [1.0, math.inf])
def test_few_cells_are_proven_if_all_have_a_bound(monkeypatch, worst):
    asked = []

    class Search:
        def __init__(self, *parts):
            asked.append(parts)

        def divided(self, *parts):
            asked.append(parts)
            return ["a", "b"]

        def bound(self, cell):
            return {"a": 0.5, "b": worst}[cell]

        def proofs(self, cells):
            return [f"proof of {cell}" for cell in cells]

    monkeypatch.setattr(cover, "_CellSearch", Search)
    if math.isfinite(worst):
        found = cover.prove_few_cells("it", "plant", 1, 2.0, ("first",))
        assert found == ["proof of a", "proof of b"]
    else:
        with pytest.raises(NoCertificate, match="has no bound"):
            cover.prove_few_cells("it", "plant", 1, 2.0, ("first",))
    assert asked[0] == ("it", "plant", 1)
    assert asked[1][0] == "default" and asked[1][2:] == (2.0, ("first",))


@pytest.mark.parametrize("regional", [True, False])
@pytest.mark.parametrize("early", [True, False])
def test_what_has_no_fixed_point_is_refused_before_the_reference_is_looked_at(
    monkeypatch, regional, early
):
    """Not where a bound grows faster than the states: there a start decides."""
    searched = []

    class Bounds:
        is_regional = regional

        @classmethod
        def of(cls, *parts):
            return cls()

        def search(self):
            searched.append(self)

    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, 1], (1, 1))
        monkeypatch.setattr(proof, "OutputBounds", Bounds)
        monkeypatch.setattr(proof, "partly_cancelled", lambda *parts: None)
        assert isinstance(proof._bounds(period, 5, refuse_early=early), Bounds)
        assert len(searched) == (1 if early and not regional else 0)
        searched.clear()
        proof._bounds(period, 5)  # as a check does
        assert not searched


def test_what_takes_longer_of_a_drive_is_made_where_it_is_asked_for():
    parameters = signature(certify_implemented).parameters
    assert parameters["from_start"].default is parameters["margins"].default is False
    assert parameters["effort"].default == "default"

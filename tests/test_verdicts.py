"""How each kind of proof in a file is judged, step by step, with checks that are made up."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from certrack.certificates import verification
from certrack.certificates.claimed_starts import claimed_starts
from certrack.certificates.implemented.from_starts import ANY_START, BOX
from certrack.certificates.layout import DOCUMENT_KEYS, FORMAT, FORMAT_1, digest_of
from certrack.certificates.premise import ASSUMED, CONTRADICTED, Premise
from certrack.certificates.region import _within
from certrack.certificates.sampling import Points
from certrack.core.errors import InputError

STAGE = {name: [] for name in ("P", "lam", "nu", "k")} | {"alpha": "1", "bound": "0.5"}
STEADY, SHIFTED = STAGE | {"shift": "0"}, STAGE | {"shift": "0.25"}


def body(proof, kind=FORMAT, **changes):
    """A body with the keys of its format, and its digest."""
    made = dict.fromkeys(DOCUMENT_KEYS[kind], "text") | {"format": kind, "proof": proof}
    made |= {DOCUMENT_KEYS[kind][3]: []} | changes
    return made | {"sha256": digest_of(made)}


@pytest.fixture
def asked(monkeypatch):
    """What the common check is asked, in the place of its answer."""

    def verified(body, bound, shifts, failed):
        return SimpleNamespace(body=body, bound=bound, shifts=list(shifts), failed=failed)

    monkeypatch.setattr(verification, "_verified", verified)
    return verification


def test_a_proof_of_moving_gains_is_one_of_the_newer_format(asked, monkeypatch):
    proof = {"bound": "0.5", "ends": [STEADY, SHIFTED]}
    found = asked._verify(body([proof]))
    assert found.bound == "0.5" and found.shifts == ["0", "0.25"]
    monkeypatch.setattr(asked, "failed_online", lambda system, proof: f"{system} {proof.bound}")
    assert found.failed("of this system") == "of this system 0.5"
    for wrong in (body([proof, proof]), body([proof], FORMAT_1)):
        with pytest.raises(InputError, match="with one proof for gains that move"):
            asked._verify(wrong)


def test_a_bootstrap_begins_with_a_stage_and_goes_on_with_others(asked, monkeypatch):
    monkeypatch.setattr(asked, "is_bootstrap", lambda body: True)
    monkeypatch.setattr(asked, "bootstrap_stages", tuple)
    monkeypatch.setattr(asked, "claimed_bound", lambda stages: f"bound of {stages}")
    monkeypatch.setattr(asked, "error_problem", lambda system, number: f"problem of {system}")
    monkeypatch.setattr(asked, "check_bootstrap", lambda *parts: parts)
    found = asked._verify(body([SHIFTED, "one", "two"]))
    assert found.bound == "bound of ('one', 'two')" and found.shifts == ["0.25"]
    system, problem, first, stages = found.failed("it")
    assert (system, problem, stages) == ("it", "problem of it", ("one", "two"))
    assert first.shift == "0.25" and first.bound == "0.5"
    with pytest.raises(InputError, match="for a bootstrap"):
        asked._verify(body([SHIFTED, "one"], FORMAT_1))


ASSUMPTION = Premise("timing", ASSUMED, "as the file says")


@pytest.fixture
def sampled(monkeypatch):
    """What is asked of a proof of the sampled adaptive loop, which holds."""
    answers = {
        "is_sampled_adaptive": lambda body: True,
        "sampled_adaptive_record": lambda proof: SimpleNamespace(bound="0.3"),
        "sampled_claim": lambda proof: f"at most {proof.bound}",
        "loads": lambda text, name: f"{name}: {text}",
        "_left_open": lambda system: "",
        "failed_sampled_adaptive": lambda system, proof: "",
        "premises_of_sampled_adaptive": lambda system, proof: (ASSUMPTION,),
    }
    for name, answer in answers.items():
        monkeypatch.setattr(verification, name, answer)
    return lambda **changes: verification._verify(
        body([{}], **({"claim": "at most 0.3", "premises": [ASSUMPTION.record()]} | changes))
    )


def test_a_sampled_adaptive_proof_is_judged_by_all_that_it_says(sampled, monkeypatch):
    held = sampled()
    assert held.verified and held.bound == "0.3" and held.premises == (ASSUMPTION,)
    other = sampled(claim="at most 0.2")
    assert not other.verified and other.reason == "the claim is not that of the proof"
    other = sampled(premises=[])
    assert not other.verified and "premises are not those" in other.reason
    changed = body([{}], claim="at most 0.3", premises=[ASSUMPTION.record()]) | {"made_by": "me"}
    other = verification._verify(changed)
    assert not other.verified and "was changed" in other.reason and other.bound == "0.3"
    with pytest.raises(InputError, match="of a continuous law only"):
        sampled(region={})
    for name in ("failed_sampled_adaptive", "_left_open"):
        with monkeypatch.context() as context:
            context.setattr(verification, name, lambda *parts, name=name: f"{name} {parts[0]}")
            other = sampled()
            assert not other.verified and other.reason == f"{name} system: text"
    broken = Premise("bound of w_1", CONTRADICTED, "is broken")
    monkeypatch.setattr(verification, "premises_of_sampled_adaptive", lambda *parts: (broken,))
    other = sampled(premises=[broken.record()])
    assert not other.verified and "a premise is contradicted" in other.reason


def test_from_which_starts_the_best_bound_holds():
    best, box = object(), SimpleNamespace(starts=BOX)
    none = {"sampled": object(), "implemented": object(), "starts_box": None}

    def said(best=best, **entries):
        return claimed_starts(SimpleNamespace(best=best, **(none | entries)))

    assert said() == ""
    assert said(sampled=best).startswith("from x0 and the starts near the reference")
    assert said(best=box, implemented=box) == "from x0 and the box of starts"
    anywhere = SimpleNamespace(starts=ANY_START)
    assert said(best=anywhere, implemented=anywhere, starts_box=1.0) == ""
    for polytope, more in ((None, ""), (object(), " and the proven polytope")):
        some = SimpleNamespace(starts="x0", polytope=polytope)
        assert said(best=some, implemented=some) == "from x0" + more
    text = said(starts_box=0.12399)
    assert text == "from x0 and every start with |x_i - x0_i| <= 0.123"
    assert said(starts_box=0.0).endswith("<= 0")


def test_points_beyond_a_region_are_moved_to_its_edge_on_their_ray():
    x = np.array([[1.0, 4.0, -0.5, 0.0, -6.0], [1.0, 1.0, 8.0, 0.0, 0.0]])
    found = _within(Points(np.arange(5.0), x), (Fraction(2), Fraction(4)))
    assert found.t.tolist() == [0, 1, 2, 3, 4]
    expected = [[1.0, 2.0, -0.25, 0.0, -2.0], [1.0, 0.5, 4.0, 0.0, 0.0]]
    assert found.x == pytest.approx(np.array(expected), rel=1e-11)
    assert (np.abs(found.x) < [[2], [4]]).all()

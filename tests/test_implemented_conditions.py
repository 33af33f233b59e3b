"""Conditions of a proof of the implemented loop, at their edges: with numbers that are made up."""

import math
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from test_fixed_point_parts import q

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import cover
from certrack.certificates.implemented import proof as module
from certrack.certificates.implemented.proof import (
    MAX_CELLS_OF_INPUT,
    MAX_DOUBLINGS,
    ImplementedProof,
    cells_of,
    failed_implemented,
)
from certrack.certificates.implemented.ranged import refuse_in_cells


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
        assert 1 < float(text) / float(value) < 1 + 2e-6


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

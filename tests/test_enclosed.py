"""Floats with what they may be off by hold the exact numbers, also where every rounding falls."""

import re
from dataclasses import replace
from fractions import Fraction
from itertools import product
from types import SimpleNamespace

import flint
import numpy as np
import pytest

import certrack
from certrack.certificates.arithmetic import rational
from certrack.certificates.implemented.drive import DRIVE_BITS
from certrack.certificates.implemented.enclosed import ROUNDOFF, Enclosed, widened
from certrack.certificates.implemented.premises import _covered
from certrack.certificates.implemented.proof import start_prover
from certrack.certificates.implemented.start import Later, _product_with, is_above, up
from certrack.certificates.implemented.start_proof import (
    ANY_PHASE,
    FILE_PHASE,
    MOST_DOUBLINGS,
    POLYTOPE,
    X0,
    StartProof,
    StartProver,
    start_set_of,
)

LOST = ROUNDOFF * (1 - 2.0**-20)  # added to 1 it is lost


@pytest.mark.parametrize("roundings", range(0, 60, 7))
def test_what_roundings_lose_is_made_good(roundings):
    found = Fraction(float(widened(np.array(1.0), roundings)))
    assert found >= (1 + Fraction(ROUNDOFF)) ** (roundings + 1)
    assert found <= 1 + 4 * (roundings + 8) * Fraction(ROUNDOFF)
    assert widened(np.array(0.0)) > 0
    total = 1.0
    for _ in range(roundings):
        total += LOST
    assert Fraction(float(widened(np.array(total), roundings))) >= 1 + roundings * Fraction(LOST)


@pytest.mark.parametrize("value", ["1/3", "-1/3", "1e-320", "-7e18", "0"])
def test_the_middle_and_the_radius_of_a_ball_are_enclosed(value):
    with flint.ctx.workprec(200):
        exact = Fraction(value)
        ball = flint.arb(flint.fmpq(exact.numerator, exact.denominator), "1e-20")
        found = Enclosed.of(flint.arb_mat([[ball]]))
        largest = abs(exact) + Fraction(1, 10**20)
        low = Fraction(float(found.value[0, 0])) - Fraction(float(found.error[0, 0]))
        high = Fraction(float(found.value[0, 0])) + Fraction(float(found.error[0, 0]))
        assert low <= exact - Fraction(1, 10**20) and exact + Fraction(1, 10**20) <= high
        assert high - low <= Fraction(3, 10**20) + abs(exact) * Fraction(2) ** -48
        assert largest <= Fraction(float(found.upper[0, 0])) <= largest * 2 + Fraction(1, 10**100)
        assert up(ball) == found.upper[0, 0]


def exact_product(p, q):
    return [
        [sum(Fraction(float(u)) * Fraction(float(v)) for u, v in zip(row, column, strict=True))]
        for row in p
        for column in q.T
    ]


@pytest.mark.parametrize("size", range(1, 7))
@pytest.mark.parametrize("part", ["value", "left error", "right error"])
def test_products_of_enclosed_matrices_hold_all_products(size, part):
    """Of 1 and what is lost beside it: a product of the values, or of a value and an error."""
    ones, none = np.ones((1, size)), np.zeros((1, size))
    column = np.full((size, 1), LOST)
    column[0] = 1
    a, b = {
        "value": ((ones, none), (column, 0 * column)),
        "left error": ((none, ones), (column, 0 * column)),
        "right error": ((ones, none), (0 * column, column)),
    }[part]
    found = _product_with(Enclosed(*a), Enclosed(*b))
    exact = exact_product(ones, column)[0][0]
    high = Fraction(float(found.value[0, 0])) + Fraction(float(found.error[0, 0]))
    assert high >= exact
    assert high <= exact * (1 + 8 * (size + 10) * Fraction(ROUNDOFF))


def test_a_later_bound_is_strictly_above_its_image():
    image = np.array([9.0, 1.0, 2.0, 3.0, 9.0])
    assert is_above(Later((1.1, 2.1), 3.1), image)
    for states, size in (((1.0, 2.1), 3.1), ((1.1, 2.0), 3.1), ((1.1, 2.1), 3.0)):
        assert not is_above(Later(states, size), image)


def test_a_proof_of_starts_has_the_shape_of_its_system():
    prover = SimpleNamespace(drive=SimpleNamespace(n=2))
    region = (("-1", "1"), ("0", "0"))

    def holds(**changes):
        fields = {"of": X0, "phase": FILE_PHASE, "region": (), "doublings": 5, "middle": 31}
        fields |= {"states": ("1",) * 2, "input": "1", "peaks": ("1",) * 5}
        return StartProver._is_well_formed(prover, StartProof(**fields | changes))

    right = [
        {},
        {"phase": ANY_PHASE},
        {"of": POLYTOPE, "region": region},
        {"middle": 0},
        {"doublings": 1, "middle": 1},
        {"doublings": MOST_DOUBLINGS},
    ]
    wrong = [
        {"of": "x1"},
        {"phase": "none"},
        {"region": region},
        {"of": POLYTOPE},
        {"of": POLYTOPE, "region": region[:1]},
        {"of": POLYTOPE, "region": (("-1", "1"), ("0", "-1"))},
        {"doublings": 0, "middle": 0},
        {"doublings": MOST_DOUBLINGS + 1},
        {"middle": 32},
        {"middle": -1},
        {"states": ("1",)},
        {"states": ("1",) * 3},
        {"peaks": ("1",) * 4},
        {"peaks": ("1",) * 6},
    ]
    assert all(holds(**changes) for changes in right)
    assert not any(holds(**changes) for changes in wrong)


#: A drive whose reference at t = 0 is not zero, with sensors that err.
DRIVE = """
[plant]
states = ["x1", "x2"]
chain = [1]
input_gain = 1
gain_sign = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]
[truth]
input_gain = 1
omega = [0, "0.1*sin(t)"]
[reference]
signal = "0.1*cos(t)"
[law]
kind = "robust"
c = [2, 2]
feedforward = 1
[simulation]
x0 = [0.01, 0]
duration = 5
[implementation]
period = 0.01
measurement_quantum = [0.001, 0.002]
"""


def test_a_start_with_any_reference_covers_every_reference():
    """Within their bounds: what the starts add is at least what they add with each of them."""
    system = certrack.loads(DRIVE)
    with flint.ctx.workprec(DRIVE_BITS):
        prover = start_prover(system, rational(0), (1, 1))
        frame = prover.frame(9)
        starts = start_set_of(system, prover.drive, ANY_PHASE, ())
        every = frame.transient(starts)
        assert starts.Y is None
        for signs in product((-1, 1), repeat=2):
            bounds = [flint.arb(v) * s for v, s in zip(prover.drive.Y, signs, strict=False)]
            one = frame.transient(replace(starts, Y=tuple(bounds)))
            assert (every.size >= one.size).all()
            assert (every.later >= one.later).all()
            assert (every.free >= one.free).all()
        noisy = replace(starts, half=tuple(flint.arb("0.001") for _ in starts.half))
        more = frame.transient(noisy)
        assert (more.size > every.size).all() and (more.later >= every.later).all()


def test_the_premise_names_what_the_drive_has():
    quantised = DRIVE.replace("[implementation]", "[implementation]\ninput_quantum = 0.25")
    sensors = "sensors within 0.0005001 for x1, 0.001001 for x2"  # rounded up
    exact = re.sub("measurement_quantum.*", "", DRIVE)
    for text, expected in (
        (DRIVE, [sensors]),
        (quantised, [sensors, "the input in steps of 0.25"]),
        (exact, ["exact sensors"]),
    ):
        system = certrack.loads(text)
        every, *others = _covered(system, system.implementation).split("; ")
        assert every.startswith("sampled every 0.01 s, its input acts 0 periods later")
        assert others == expected

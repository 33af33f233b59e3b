"""Numbers of a tube, of stages that are made up: levels, falling steps, links of the chain."""

import importlib
import math
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.tube import OFFSET_WEIGHTS, PIECE_RATIO, Tube

tubes = importlib.import_module("certrack.certificates.tube")


def stage(bound, alpha="4", k=("0.25",), nu=("0.5",), **more):
    return SimpleNamespace(bound=bound, alpha=alpha, k=k, nu=nu, shift="0", **more)


def number(value):
    return rational(Fraction(value))


def close(value):
    return pytest.approx(value, rel=1e-9)


def above(value):
    """Not below, and above by no more than roundings."""
    return SimpleNamespace(holds=lambda found: value <= found <= value * (1 + 1e-9))


def test_a_level_has_one_inputs_share_scaled():
    assert above(1.75).holds(tubes._level(number(1), number("0.25"), 4.0))
    assert above(1.0).holds(tubes._level(number(1), number("0.25"), 1.0))


@pytest.mark.parametrize(("square", "floor"), [(5.0, 1.0), (0.0, 1.0), (5.0, 0.0), (3.0, 3.0)])
def test_a_link_falls_from_its_square_to_its_floor(square, floor):
    for lapsed in (0.0, 0.7, 20.0):
        decay = math.exp(-0.3 * lapsed)
        expected = square * decay + floor * (1 - decay)
        assert above(expected).holds(tubes._later(square, floor, 0.3, lapsed))
    assert floor <= tubes._later(square, floor, 0.3, math.inf) <= floor * (1 + 1e-9) + 1e-300
    assert tubes._later(1.0, 0.0, 1.0, 2000.0) > 0  # no decay is below the smallest float


def test_energy_falls_in_steps_to_the_bound(monkeypatch):
    """From 7 to 4 over the floor 3: ratios 3/4 + 0.9^k, until less than 1/4 is left."""
    monkeypatch.setattr(tubes, "squared_bound", lambda problem, proof, target: number(3))
    found = tubes._fall(7.0, 0.5, None, stage("2"), 1, begin=10.0)
    count = next(k for k in range(100) if PIECE_RATIO**k <= 0.25)
    assert len(found) == count + 1 and found[-1][1] == 1.0
    for k, (time, ratio) in enumerate(found):
        assert time == close(10 - k * math.log(PIECE_RATIO) / 0.5)
        assert k == count or above(0.75 + PIECE_RATIO**k).holds(ratio)
    assert tubes._fall(4.0, 0.5, None, stage("2"), 1) == [(0.0, 1.0)]
    assert tubes._fall(1.0, 0.5, None, stage("2"), 1, begin=2.0) == [(2.0, 1.0)]
    monkeypatch.setattr(tubes, "squared_bound", lambda problem, proof, target: number(4))
    with pytest.raises(NoCertificate, match="above what their inequalities give"):
        tubes._fall(7.0, 0.5, None, stage("2"), 1)


def test_the_chain_of_two_stages(monkeypatch):
    """e_n^2 is twice the proof's for a second; its share of the floor is 2 k/alpha = 1/8."""
    asked = []

    def single(system, problem, proof, starts, target=0):
        asked.append((problem, proof.bound, target))
        return (5.0, 1.0, 0.3) if proof.bound == "1" else (9.0, 0.0, 0.7)

    def fall(start, alpha, problem, proof, target):
        asked.append((start, alpha, target))
        return [(0.0, 2.0), (1.0, 1.0)]

    monkeypatch.setattr(tubes, "single_stage", single)
    monkeypatch.setattr(tubes, "_fall", fall)
    monkeypatch.setattr(tubes, "squared_bound", lambda problem, proof: number(1))
    monkeypatch.setattr(tubes, "head_problem", lambda problem, bound: ("head", bound))
    problem = SimpleNamespace(n=3)
    found = tubes._cascade_tube(None, problem, [stage("2"), stage("1")], ())
    assert asked == [(problem, "2", 2), (9.0, 0.7, 2), (("head", number(2)), "1", 0)]
    (t0, first, level), (t1, second, last) = found.pieces
    assert (t0, t1, first, found.start) == (0.0, 1.0, 5.0, 5.0)
    assert (found.floor, found.alpha) == (1.0, 0.3)
    assert level == close(1.125) and last == close(1.0)
    assert second == close(5 * math.exp(-0.3) + 1.125 * (1 - math.exp(-0.3)))


@pytest.mark.parametrize(
    ("known_until", "in_floats"), [(10.0, 1), (10.0, math.inf), (3.0, math.inf)]
)
def test_the_centred_stage_follows_the_first(monkeypatch, known_until, in_floats):
    """Until t = 1 2 V_1 <= 16, so zeta is twice the proof's, if it has a bound there at all."""
    asked = []
    problem = SimpleNamespace(n=3, counts=(0, 1))
    centred = SimpleNamespace(n=3, counts=(0, 2))

    def fall(*arguments):
        asked.append(arguments)
        return [(1.0, 0.9), (1.5, 0.3), (2.0, 1.0)]

    class Zeta:
        """As large as e_n, where it has a bound; floats know all of it, or nothing."""

        def __call__(self, reached):
            if float(reached.bound) > known_until:
                raise NoCertificate("none")
            return number(reached.bound)

        def in_floats(self, reached, squares):
            return np.sqrt(squares) * in_floats

    monkeypatch.setattr(tubes, "_fall", fall)
    monkeypatch.setattr(tubes, "centred_problem", lambda *_: centred)
    monkeypatch.setattr(tubes, "single_stage", lambda *_: (6.0, 0.0, 0.5))
    monkeypatch.setattr(tubes, "squared_bound", lambda *_: number(1))
    monkeypatch.setattr(tubes, "RemainderBound", lambda *_: Zeta())
    monkeypatch.setattr(tubes, "_allowed", lambda *_: lambda level: float(Fraction(str(level))) - 2)
    monkeypatch.setattr(tubes, "replace", lambda reached, bound: stage(bound))
    inner = [stage("2"), stage("3")]
    found = tubes._centred_steps(None, problem, inner, (), [(0.0, 4.0), (1.0, 1.0)])
    after = 6 * math.exp(-0.5) + 1.75 * (1 - math.exp(-0.5))
    largest, later = (6.0, after) if known_until > 4 else (16.0, math.inf)
    times, ratios = zip(*found, strict=True)
    assert times == (0.0, 1.0, 1.5, 2.0)
    assert ratios == (close(largest / 9), close(4 / 9), close(0.3), 1.0)
    ((square, alpha, of, proof, target, begin),) = asked
    assert square == close(min(later, 2.0)) and of is centred and proof.bound == "3"
    assert (alpha, target, begin) == (0.5, 2, 1.0)


def test_without_a_remainder_the_centred_stage_has_one_floor(monkeypatch):
    """zeta is no input: its multiplier is none of the remainder, and the first stage no matter."""
    problem = SimpleNamespace(n=3, counts=(0, 1))
    monkeypatch.setattr(tubes, "_fall", lambda *_: [(1.0, 1.0)])
    monkeypatch.setattr(tubes, "centred_problem", lambda *_: problem)
    monkeypatch.setattr(tubes, "single_stage", lambda *_: (6.0, 0.0, 0.5))
    monkeypatch.setattr(tubes, "squared_bound", lambda *_: number(7))
    monkeypatch.setattr(tubes, "_allowed", lambda *_: lambda level: math.inf)
    monkeypatch.setattr(tubes, "replace", lambda reached, bound: stage(bound))
    inner = [stage("2"), stage("3")]
    found = tubes._centred_steps(None, problem, inner, (), [(0.0, 4.0), (1.0, 1.0)])
    rising = 6 * math.exp(-0.5) + 7 * (1 - math.exp(-0.5))
    assert found == [(0.0, close(rising / 9)), (1.0, 1.0)]


def test_what_the_first_stage_allows_the_centred_one():
    """P_2 <= 2 P_1, s_2/s_1 = 3/4, offset 2 kappa^2 N_0^2: the best of all splits counts."""
    one, two = [["1", "0", "0"], ["0", "2", "0"]], [["2", "0", "0"], ["0", "1", "0"]]
    first = SimpleNamespace(P=[*one, ["0", "0", "4"]])
    centred = SimpleNamespace(P=[*two, ["0", "0", "3"]], shift="0.5")
    law = SimpleNamespace(Gamma=np.eye(2), energy=lambda zero: number(6) + sum(zero))
    allowed = tubes._allowed(SimpleNamespace(adaptation=law), [first, centred])
    offset = 2 * 0.25 * 6
    for level in (0.0, 0.1, 5.0, 1000.0):
        expected = min(
            max(2.0, 0.75 * (1 + w)) * level + 3 * (1 + 1 / w) * offset for w in OFFSET_WEIGHTS
        )
        assert expected <= allowed(number(level)) <= expected * (1 + 1e-6)


def test_pieces_of_a_chain_are_followed_one_after_the_other():
    chain = Tube(16.0, 1.0, 0.5, pieces=((0.0, 16.0, 4.0), (2.0, 9.0, 2.0), (5.0, 4.0, 1.0)))
    t = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 9.0])
    square, floor = np.array([16, 16, 9, 9, 4, 4.0]), np.array([4, 4, 2, 2, 1, 1.0])
    decay = np.exp(-0.5 * (t - np.array([0, 0, 2, 2, 5, 5.0])))
    expected = np.sqrt(square * decay + floor * (1 - decay))
    assert (chain(t) >= expected).all() and chain(t) == close(expected)
    assert float(chain(1e6)) == close(1.0)
    within = 2 + math.log((9 - 2) / (2.5**2 - 2)) / 0.5
    assert chain.settling_time(2.5) == close(within) and chain.settling_time(4.0) == 0.0
    assert chain.settling_time(3.0) == close(math.log(12 / 5) / 0.5)
    assert chain.settling_time(math.sqrt(1.5)) == close(5 + math.log(3 / 0.5) / 0.5)
    assert math.isinf(chain.settling_time(1.0))


def test_a_level_that_only_roundings_keep_from_the_floor_is_never_reached():
    tube = Tube(16.0, 4.0, 0.5)
    assert math.isinf(tube.settling_time(2.0 * (1 + 2e-13)))
    assert tube.settling_time(2.0 * (1 + 2e-12)) > 40
    late = Tube(16.0, 4.0, 0.5, pieces=((0.0, 16.0, 4.0), (100.0, 4.5, 4.0)))
    assert math.isinf(late.settling_time(2.0 * (1 + 2e-13)))
    assert late.settling_time(2.2) < 100

"""Parts of the bootstrap by themselves, on first boxes and on plants of order one."""

import itertools
import json
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from types import SimpleNamespace

import flint
import numpy as np
import pytest
import sympy
from test_bootstrap import RANGED, ErrorsByHand, vector_of

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.arithmetic import rational
from certrack.certificates.bootstrap import polynomial_stages as polynomial_stages_room
from certrack.certificates.bootstrap import search
from certrack.certificates.bootstrap.box import interval_of
from certrack.certificates.bootstrap.certify import certify_bootstrap, first_proof
from certrack.certificates.bootstrap.check import bounds_error, claimed_bound
from certrack.certificates.bootstrap.conditions import Polynomials, layout_of, sums_of_squares
from certrack.certificates.bootstrap.document import bootstrap_stages, is_bootstrap
from certrack.certificates.bootstrap.forms import forms_of, scaled_ubar
from certrack.certificates.bootstrap.inequality import (
    Unknowns,
    corner_form,
    multiplier_counts,
    shared_form,
    target_form,
)
from certrack.certificates.bootstrap.loop import adaptive_loop, formulas_of
from certrack.certificates.bootstrap.monomials import monomials
from certrack.certificates.bootstrap.polynomial_stages import (
    RowSolver,
    polynomial_stages,
    shrunk,
)
from certrack.certificates.bootstrap.program import BootstrapProgram
from certrack.certificates.bootstrap.proof import (
    failed_part,
    prove_function,
    proven_definite,
    row_over_box,
)
from certrack.certificates.bootstrap.ranges import (
    Combination,
    Ranges,
    _decimal_of,
    _float_ends,
    largest_reach,
)
from certrack.certificates.bootstrap.rates import Rate, best_of_rates
from certrack.certificates.bootstrap.regions import (
    LOOSER,
    WIDER,
    Reached,
    after,
    box_of_states,
    failed_ranges,
    failed_region,
    first_box,
    next_region,
    remainder_of,
    rows_of,
    wider_texts,
)
from certrack.certificates.bootstrap.tape import Tape
from certrack.certificates.bootstrap.variables import knows_reference, with_reference
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import from_text
from certrack.certificates.formulation import error_problem
from certrack.core.errors import InputError
from certrack.core.expressions import parse

ONE = """
[plant]
states = ["x1"]
chain = []
drift = "0.3*x1 - 0.2*x1**2"
regressor = [REGRESSOR]
gain_sign = 1
[plant.ranges]
input_gain = GAIN
theta = RANGES
[plant.uncertainty]
tau = [0.3]
gamma = [0.2]
beta = [0.2]
[truth]
input_gain = 1.5
theta = THETA
omega = ["0.2*cos(2*t)"]
[reference]
signal = "0.2*sin(t)"
[law]
kind = "adaptive"
c = [2]
gain_rate = 0.8
leak_gain = 0.5
leak_theta = 0.4
delta0 = 0.6
PRIOR
[simulation]
x0 = [0.3]
duration = 20
tail = 5
"""


def order_one(gain="[1.5, 1.5]", *, parameter=False):
    """A plant of order one, with a range of g_n or of a theta."""
    changes = {
        "REGRESSOR": '"sin(x1)"' if parameter else "",
        "GAIN": gain,
        "RANGES": "[[0.3, 0.5]]" if parameter else "[]",
        "THETA": "[0.4]" if parameter else "[]",
        "PRIOR": "theta0 = [0.3]" if parameter else "",
    }
    text = ONE
    for name, value in changes.items():
        text = text.replace(name, value)
    return certrack.loads(text if parameter else text.replace("leak_theta = 0.4\n", ""))


SYSTEMS = {
    "plain": order_one(),
    "gain": order_one("[1.4, 1.6]"),
    "parameter": order_one(parameter=True),
    "both": order_one("[1.4, 1.6]", parameter=True),
    "order two": certrack.loads(RANGED),
}

#: What the default effort proves of each, and what the semidefinite program does.
BOUNDS = {"plain": 0.061433, "gain": 0.079843, "parameter": 0.120019, "both": 0.163951}


@dataclass
class FirstStage:
    """What the first stage of a system stands on; the box moved, so that no middle is zero."""

    system: object

    def __post_init__(self):
        self.problem = error_problem(self.system, rational)
        self.loop = adaptive_loop(self.system, self.problem)
        self.proof = first_proof(self.problem)
        self.ranges = Ranges(formulas_of(self.system), self.loop)
        self.known = first_box(self.loop, self.proof)
        moved = self.known.box.copy()
        for i in range(len(moved)):
            moved[i, 0] = moved[i, 0] * rational(f"0.{5 + i}")
        self.moved = replace(self.known, box=moved)
        self.region = next_region(self.loop, self.ranges, self.moved)
        self.numbers = self.region.numbers()
        self.forms, self.rows = forms_of(self.loop, self.numbers), rows_of(self.loop, self.numbers)
        self.floats = forms_of(self.loop.in_floats(), self.numbers.in_floats())


@cache
def first_stage(name):
    return FirstStage(SYSTEMS[name])


@pytest.fixture(params=SYSTEMS)
def stage(request):
    return first_stage(request.param)


# The whole on plants of order one -----------------------------------------------------------------


@pytest.mark.parametrize("name", BOUNDS)
def test_small_plants_are_as_tight_as_they_were(name):
    """All groups, stages and sweeps; a search that is worse by a thousandth is worse."""
    system = SYSTEMS[name]
    certificate, stages = certify_bootstrap(system)
    assert certificate.verified
    assert certificate.bound == pytest.approx(BOUNDS[name], rel=1e-3)
    assert bounds_error(stages[1:])
    verdict = verify(json.loads(json.dumps(to_document(system, *stages))))
    assert (verdict.verified, verdict.reason) == (True, "")


def test_a_run_keeps_the_bound_of_a_small_plant():
    system = SYSTEMS["plain"]
    assert 0 < certrack.simulate(system).metrics.tail_error <= BOUNDS["plain"]


def test_progress_is_the_bound_so_far(monkeypatch):
    """After each stage what |e_1| keeps to in the long run; the last one is the certificate's."""
    stage, told = first_stage("plain"), []
    monkeypatch.setattr(search, "MOST_STAGES", 2)
    stages = search.bootstrap(
        stage.system, stage.problem, stage.proof, progress=lambda *parts: told.append(parts)
    )
    assert len(told) == len(stages) == 2
    assert all(part[:2] == (0, None) for part in told)
    bounds = [part[2] for part in told]
    assert bounds == sorted(bounds, reverse=True)
    assert bounds[-1] == pytest.approx(float(claimed_bound(stages)), rel=1e-12)


def test_effort_says_what_is_left_out():
    system = SYSTEMS["plain"]
    assert "--effort default" in certify_bootstrap(system, "fast")[0].reason
    lean = certrack.load("dual-motor-lean")
    assert "for the adaptive law" in certify_bootstrap(lean)[0].reason
    with pytest.raises(NoCertificate, match="both sides"):
        claimed_bound(())


# What a stage stands on ---------------------------------------------------------------------------


def test_the_first_box_is_that_of_the_ellipsoid(stage):
    """max z_i over e^T P e + s (theta^T Gamma^-1 theta + g_0 d^2/gbar) <= bound^2."""
    loop, proof = stage.loop.in_floats(), stage.proof
    n, r = loop.n, loop.r
    P, s = np.array(proof.P, dtype=float), float(proof.P[-1][-1])
    whole = np.zeros((n + r + 1, n + r + 1))
    whole[:n, :n] = P
    whole[n : n + r, n : n + r] = s * np.linalg.inv(loop.Gamma) if r else np.zeros((0, 0))
    whole[-1, -1] = s * loop.smallest_gain / loop.gain_rate
    sizes = float(proof.bound) * np.sqrt(np.diag(np.linalg.inv(whole)))
    box = stage.known.box.astype(float)
    np.testing.assert_allclose(box[:, 1], sizes, rtol=1e-10)
    assert (box[:, 0] == -box[:, 1]).all()
    assert (box[:, 1] >= sizes * (1 - 1e-13)).all()


@pytest.mark.parametrize("part", [0.0, 0.6, 1.0])
def test_the_loop_on_its_first_box_is_that_of_the_plant_and_the_law(stage, part):
    """zeta' = F w and the relation of ubar at random states, for g_n and theta in their ranges."""
    rng = np.random.default_rng(3)
    system, numbers, loop = stage.system, stage.numbers, stage.loop
    forms, plant = stage.floats, stage.system.plant
    ends = plant.input_gain_range or (1.5, 1.5)
    gain = (1 - part) * float(ends[0]) + part * float(ends[1])
    low, high = (float(v) for v in numbers.ubar(loop))
    u = plant.uncertainty
    n = loop.n
    box = np.array(plant.theta_range or np.zeros((0, 2)), dtype=float)
    for _ in range(12):
        hand = ErrorsByHand(system, gain, rng.uniform(*box.T))
        z = rng.uniform(*numbers.box.astype(float).T)
        Y = rng.uniform(-1, 1, len(loop.Y)) * loop.Y.astype(float)
        x, _ = hand.states(z, Y)
        a, b = rng.uniform(-1, 1, n) * np.linalg.norm(x), rng.uniform(-1, 1, n)
        tau, gamma, beta = (np.array(v, float) for v in (u.tau, u.gamma, u.beta))
        rates, ubar = hand.rates(z, Y, tau * (gamma * a + beta * b))
        w, _ = vector_of(system, hand, stage.region, z, Y, (a, b))
        assert np.abs(w).max() <= 1 + 1e-9
        assert low <= ubar <= high
        first, second = forms.corners
        least, most = (float(v) for v in scaled_ubar(loop, numbers))
        share = (hand.v * ubar - least) / (most - least)
        assert 0 <= share <= 1
        F = (1 - share) * first.F + share * second.F
        relation = (1 - share) * first.relation + share * second.relation
        assert (F @ w) * forms.radius == pytest.approx(rates, abs=1e-9)
        assert relation @ w == pytest.approx(0, abs=1e-9)
        for rows, place in forms.squares:
            assert np.linalg.norm(rows @ w) * (1 + 1e-9) >= abs(w[place])
            assert np.linalg.norm(rows @ w) <= 1 + 1e-9
        assert (np.abs(forms.sectors @ w[: forms.size + 1]) <= 1 + 1e-9).all()
        for at, times in forms.products:
            assert w[list(times)] == pytest.approx(w[times[0]] * w[list(at)], abs=1e-12)


def test_ubar_is_bounded_by_its_row_its_remainder_and_what_the_reference_adds(stage):
    """ubar + remainder - row z is linear in Y: its largest value over |y_i| <= Y_i is added."""
    loop, numbers = stage.loop.in_floats(), stage.numbers.in_floats()
    n, r, row = loop.n, loop.r, numbers.linear_row(loop)
    hand = ErrorsByHand(stage.system, 1.5, loop.theta_middle)
    rng, largest = np.random.default_rng(9), -math.inf
    for signs in itertools.product((-1, 1), repeat=len(loop.Y)):
        z, Y = rng.uniform(*numbers.box.T), np.array(signs) * loop.Y
        x, _ = hand.states(z, Y)
        h, *phi = hand.known(x)
        _, ubar = hand.rates(z, Y, np.zeros(n))
        rest = h - numbers.slope @ x + np.array(phi) @ hand.theta
        rest -= (np.array(phi) - numbers.middle) @ z[n : n + r]
        largest = max(largest, ubar + rest - row @ z)
    low, high = numbers.ubar(loop)
    assert high == pytest.approx(numbers.row[1] + largest - numbers.remainder[0], rel=1e-9)
    assert low == pytest.approx(numbers.row[0] - largest - numbers.remainder[1], rel=1e-9)


def test_parameters_without_a_range_are_no_inputs():
    """w has an entry t for each theta with a range, and three for each phi that varies."""
    text = RANGED.replace("[-0.4, -0.3]]", "[-0.35, -0.35]]").replace('"1 + x2/4"', '"2"')
    stage = FirstStage(certrack.loads(text))
    assert [float(v) for v in stage.loop.theta_radius] == pytest.approx([0.1, 0])
    assert [float(v) for v in stage.loop.theta_middle] == pytest.approx([0.4, -0.35])
    inputs = stage.loop.Ua.shape[1] + stage.loop.Ub.shape[1] + len(stage.loop.Y)
    assert stage.forms.width == stage.loop.size + 1 + inputs + 1 + 1 + 2 + 3


@pytest.mark.parametrize("off", [0.0, 0.3, -4.0])
def test_the_remainder_holds_what_it_stands_for(stage, off):
    """h - k x + phi^T theta - (phi - phi_m)^T theta_tilde, anywhere in the box, and is near."""
    rng = np.random.default_rng(4)
    loop, exact, system = stage.loop.in_floats(), stage.numbers, stage.system
    n, r = loop.n, loop.r
    exact = replace(exact, middle=exact.middle + rational(off))  # phi_m may be any numbers
    numbers = exact.in_floats()
    combination, spread = remainder_of(stage.loop, exact)
    hand = ErrorsByHand(system, 1.5, np.zeros(r))
    weights = np.array([float(v) for v in combination.weights])
    slope = np.array([float(v) for v in combination.slope])
    found, middles = [], []
    for _ in range(600):
        z = rng.choice([0, 1, 2], len(numbers.box))
        z = np.where(z == 2, rng.uniform(*numbers.box.T), numbers.box[np.arange(len(z)), z % 2])
        Y = rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], len(loop.Y)) * loop.Y
        theta = loop.theta_middle + loop.theta_radius * rng.choice([-1, 1], r)
        x = loop.Xe @ z[:n] + loop.AB @ Y[:-1]
        h, *phi = hand.known(x)
        phi = np.array(phi)
        value = h - numbers.slope @ x + phi @ theta - (phi - numbers.middle) @ z[n : n + r]
        middle = weights @ np.array([h, *phi]) - slope @ x + float(combination.constant)
        assert abs(value - middle) <= float(spread) + 1e-9
        found.append(value)
        middles.append(middle)
    if off:
        return
    low, high = numbers.remainder
    assert low <= min(found) and max(found) <= high
    assert high - low <= 1.3 * (max(middles) - min(middles)) + 2.3 * float(spread) + 1e-6


def test_a_region_is_wider_than_what_is_known_and_not_much(stage):
    loop, ranges, region = stage.loop, stage.ranges, stage.region
    old, new = stage.moved.box, stage.numbers.box
    assert failed_region(loop, ranges, stage.moved, region) == ""
    assert all(a[0] < b[0] and b[1] < a[1] for a, b in zip(new, old, strict=True))
    width = (old[:, 1] - old[:, 0]).astype(float)
    assert (np.abs((new - old).astype(float)) <= 2e-7 * width[:, None]).all()
    narrow = replace(region, box=tuple((low, high) for low, high in region.box[:-1]))
    assert "shape" in failed_region(loop, ranges, stage.moved, narrow)
    for i in range(len(region.box)):  # an interval that is the known one is not wider
        exact = [(str(v[0]), str(v[1])) for v in new.astype(float) * 0.9]
        box = tuple(
            e if j == i else p for j, (p, e) in enumerate(zip(region.box, exact, strict=True))
        )
        assert "does not hold" in failed_region(loop, ranges, stage.moved, replace(region, box=box))
    less = tuple(str(0.999 * float(v)) for v in region.reach)
    if less:
        assert "||x||" in failed_region(loop, ranges, stage.moved, replace(region, reach=less))
        none = ("0",) * len(less)
        assert "||x||" in failed_region(loop, ranges, stage.moved, replace(region, reach=none))
    for name in ("drift", "remainder"):
        low, high = map(float, getattr(region, name))
        for pair in ((low + 0.1 * (high - low), high), (low, high - 0.1 * (high - low))):
            texts = tuple(map(str, pair))
            changed = replace(region, **{name: texts})
            assert "range" in failed_region(loop, ranges, stage.moved, changed)


class Told(Ranges):
    """Ranges that are told what they enclose, and remember what they are asked to prove."""

    told, asked = (0.0, 0.0), ()

    def bounds(self, chosen, box):
        return self.told

    def within(self, chosen, box, low, high):
        self.asked = (*self.asked, (chosen, low, high))
        return True


@pytest.mark.parametrize("ends", [(3.0, 3.0), (-3.0, -3.0), (-1.0, 3.0), (-3.0, 1.0), (2.0, 3.0)])
def test_ranges_leave_room_for_what_another_enclosure_rounds(stage, ends):
    """ROUNDING_SHARE of both ends, of |k| times the largest |x|, and of what is beyond the middle:
    each of them counts, whatever the signs of the ends; and what is claimed is what is checked.
    """
    loop, told = stage.loop, Told(formulas_of(stage.system), stage.loop)
    told.told = ends
    region = next_region(loop, told, stage.moved)
    numbers = region.numbers()
    place = box_of_states(loop, numbers.box)
    through = np.abs(np.hstack([loop.Xe, loop.AB]).astype(float))
    linear = float(np.abs(numbers.slope.astype(float)) @ through @ np.abs(place).max(axis=1))
    remainder, spread = remainder_of(loop, numbers)
    cases = [(numbers.drift, linear, 0), (numbers.remainder, linear, spread)]
    free = [i for i, value in enumerate(told.constants) if value is None]
    cases += [(numbers.regressor[i], 0.0, 0) for i in free]
    for (low, high), slope, off in cases:
        sizes = slope + float(off) + abs(ends[0]) + abs(ends[1])
        inside = rational(ends[0]) - off, rational(ends[1]) + off
        more = 1e-9 * sizes
        more += 1e-6 * (float(inside[1] - inside[0]) + 2 * more)
        for room in (inside[0] - low, high - inside[1]):
            assert float(room) == pytest.approx(more, rel=1e-6, abs=2e-12 * sizes)
    assert failed_ranges(loop, told, region) == ""
    zeros = (rational(0),) * loop.r
    drift = Combination((rational(1), *zeros), tuple(numbers.slope), rational(0))
    expected = [(drift, numbers.drift, 0), (remainder, numbers.remainder, spread)]
    *singles, first, last = told.asked
    for (chosen, low, high), (combination, (least, most), off) in zip(
        (first, last), expected, strict=True
    ):
        assert chosen == combination
        assert least + off <= flint.fmpq(*low.as_integer_ratio())
        assert flint.fmpq(*high.as_integer_ratio()) <= most - off
        assert low == pytest.approx(float(least + off), rel=1e-15)
        assert high == pytest.approx(float(most - off), rel=1e-15)
    for (chosen, low, high), i in zip(singles, free, strict=True):
        assert chosen.weights == tuple(rational(int(j == i + 1)) for j in range(loop.r + 1))
        assert not any(chosen.slope) and chosen.constant == 0
        assert (low, high) == pytest.approx(numbers.regressor[i].astype(float), rel=1e-15)


@pytest.mark.parametrize("value", ["0.5", "-0.5", "0", "3", "1e-300", "-123456.789", "1/3"])
def test_texts_of_an_interval_are_strictly_wider(value):
    """Also where it is a point that is a short decimal itself."""
    exact = flint.fmpq(1, 3) if value == "1/3" else rational(value)
    for width in (rational(0), rational("0.25")):
        for part in (WIDER, LOOSER):
            low, high = map(from_text, wider_texts(exact, exact + width, part))
            assert low < exact and high > exact + width
            more = rational(part) * width + rational("3e-12") * (abs(exact) + width)
            more += rational("1e-299")
            assert low >= exact - more and high <= exact + width + more


@pytest.mark.parametrize("constant", [1e6, -1e6])
def test_ranges_beside_a_large_constant_are_confirmed(constant):
    """They are as narrow as the roundings of the constant, for which there is room."""
    stage = first_stage("plain")
    x1 = formulas_of(stage.system).states[0]
    drift = sympy.Rational(constant) + x1 / 10**7
    ranges = Ranges(SimpleNamespace(states=(x1,), drift=drift, regressor=()), stage.loop)
    region = next_region(stage.loop, ranges, stage.known)
    assert failed_region(stage.loop, ranges, stage.known, region) == ""
    low, high = map(float, region.drift)
    assert low < constant < high and high - low < 0.01


def test_a_row_has_nothing_of_errors_that_the_law_cancels(stage):
    """With k = nu_x, ubar is linear in theta_tilde alone."""
    numbers = replace(stage.numbers, slope=stage.loop.nu_x)
    n = stage.loop.n
    expected = [*([0] * n), *stage.numbers.middle, 0]
    assert numbers.linear_row(stage.loop).tolist() == expected


def held_by(part, first, second):
    """Whether a box is inside of two that differ in one direction, where they meet."""
    cut = [i for i, (a, b) in enumerate(zip(first, second, strict=True)) if a != b]
    ends = [(a[0], b[1]) for a, b in zip(first, second, strict=True)]
    inside = all(e[0] <= p[0] and p[1] <= e[1] for p, e in zip(part, ends, strict=True))
    return inside and len(cut) <= 1 and all(second[i][0] <= first[i][1] for i in cut)


def test_halves_of_a_part_hold_all_of_it():
    """Exactly, in spite of the roundings of their middles and half widths."""
    met = []

    class Recorded(Ranges):
        def _on(self, chosen, middle, width):
            met.append(
                [
                    (Fraction(m) - Fraction(w), Fraction(m) + Fraction(w))
                    for m, w in zip(middle.tolist(), width.tolist(), strict=True)
                ]
            )
            return -1.0, 1.0 + len(met), 0.0, width

    stage, rng = first_stage("plain"), np.random.default_rng(11)
    ranges = Recorded(formulas_of(stage.system), stage.loop)
    for scale in (1e-8, 0.1, 1.0, 1e6):
        for centre in (0.0, *rng.normal(size=4)):
            met.clear()
            half = rng.uniform(0, scale, 2)
            box = np.array([centre - half, centre + half]).T
            ranges._end(None, box, 1.0, -math.inf, 41)
            whole, *halves = met
            for (low, high), (a, b) in zip(whole, box.tolist(), strict=True):
                assert low <= Fraction(a) and Fraction(b) <= high
            parents = [whole]
            for first, second in zip(halves[::2], halves[1::2], strict=True):
                parents.remove(next(part for part in parents if held_by(part, first, second)))
                parents += [first, second]
            assert len(parents) == 21


def test_box_of_states_holds_errors_and_reference(stage):
    place = box_of_states(stage.loop, stage.numbers.box)
    n = stage.loop.n
    assert place.shape == (n + len(stage.loop.Y) - 1, 2)
    assert (place[:n, 0] <= stage.numbers.box[:n, 0].astype(float)).all()
    for (low, high), Y in zip(place[n:], stage.loop.Y[:-1], strict=True):
        assert low == -high
        assert high == pytest.approx(float(Y), rel=1e-15)
        assert flint.fmpq(*high.as_integer_ratio()) >= Y


def test_intervals_of_rows_are_those_of_the_corners():
    box = np.array([[rational(-1), rational(3)], [rational(2), rational(5)]], dtype=object)
    for row in itertools.product((-2, 0, 1), repeat=2):
        corners = [row[0] * a + row[1] * b for a in (-1, 3) for b in (2, 5)]
        assert interval_of(np.array([rational(v) for v in row]), box) == (
            min(corners),
            max(corners),
        )


def claims(*bounds):
    return SimpleNamespace(
        claims=tuple(SimpleNamespace(error=e, side=s, bound=b) for e, s, b in bounds)
    )


def test_what_is_proven_cuts_the_box_and_never_widens_it():
    box = np.array([[rational(-1), rational(3)], [rational(-2), rational(5)]], dtype=object)
    row = np.array([rational(1), rational(1)])
    rows = [*(np.eye(2, dtype=object) + rational(0)), row]
    known = Reached(box)
    found = after(known, [claims((0, 1, "2"), (0, -1, "0.5"), (1, 1, "9"), (1, -1, "9"))], rows)
    assert found.box.tolist() == [[rational("-0.5"), rational(2)], [rational(-2), rational(5)]]
    assert (found.row, found.interval) == (None, None)
    assert known.box[0, 1] == rational(3)
    cut = after(known, [claims((2, 1, "4")), claims((2, -1, "1"))], rows)
    assert cut.interval == (rational(-1), rational(4)) and (cut.row == row).all()
    assert cut.interval_of(row) == (rational(-1), rational(4))
    near = np.array([rational(1), rational("1.1")])  # of the known one, and 0.1 z_2 in [-0.2, 0.5]
    assert cut.interval_of(near) == (rational("-1.2"), rational("4.5"))
    far = np.array([rational(1), rational(0)])
    assert cut.interval_of(far) == (rational(-1), rational(3))
    assert after(cut, [claims((2, 1, "7"))], rows).interval == cut.interval
    assert shrunk(known, found) == pytest.approx(1 - 2.5 / 4)
    assert shrunk(found, found) == 0


def test_the_claim_is_the_worse_side_of_the_best_bounds_of_the_first_error():
    """By their numbers, whatever their texts look like; of all stages and functions."""
    first = SimpleNamespace(functions=(claims((0, 1, "10"), (1, 1, "0.1")), claims((0, 1, "9"))))
    second = SimpleNamespace(functions=(claims((0, -1, "1.5e1"), (0, -1, "5e-1"), (1, -1, "99")),))
    other = SimpleNamespace(functions=(claims((0, -1, "30"), (0, -1, "200")),))
    assert claimed_bound((first, second)) == "9"
    assert claimed_bound((second, first, other)) == "9"
    assert claimed_bound((first, other)) == "30"
    assert claimed_bound((other, first)) == "30"
    for stages, both in (((first,), False), ((second,), False), ((first, second), True)):
        assert bounds_error(stages) == both
        if not both:
            with pytest.raises(NoCertificate, match="both sides"):
                claimed_bound(stages)


def test_floats_of_a_ball_are_outside_of_it_and_near():
    """Whatever the ball's digits are, and a point has floats below and above, too."""
    rng = np.random.default_rng(2)
    points = [flint.arb(v) for v in (0, 1, -3, 1e-300, -1e300)]
    thirds = [flint.arb(flint.fmpq(int(p), 3)) for p in rng.integers(-(10**6), 10**6, 40)]
    wide = [flint.arb(float(m), float(r)) for m, r in rng.normal(size=(40, 2)) ** 2]
    for ball in (*points, *thirds, *wide):
        low, high = _float_ends(ball)
        assert flint.arb(low) < ball.lower() and flint.arb(high) > ball.upper()
        width = float(ball.upper() - ball.lower())
        assert high - low <= width + 1e-15 * max(abs(low), abs(high)) + 1e-320
    for unknown in (flint.arb(0) / 0, flint.arb("inf"), flint.arb(0, "inf")):
        assert _float_ends(unknown) == (-math.inf, math.inf)


# The quadratic form -------------------------------------------------------------------------------


def random_unknowns(forms, rng):
    counts, size = multiplier_counts(forms), forms.size
    G = rng.normal(size=(size + 1, size + 1))
    return Unknowns(rng.uniform(0.2, 2), G + G.T, *(rng.normal(size=k) for k in counts))


def test_the_form_is_the_sum_that_it_stands_for(stage):
    """W' + alpha W + all multipliers times what they multiply, at any w, inside or not."""
    rng = np.random.default_rng(5)
    forms = stage.floats
    size, u = forms.size, random_unknowns(stage.floats, rng)
    for corner in forms.corners:
        form = shared_form(forms, u) + corner_form(forms, corner, u)
        assert form == pytest.approx(form.T)
        for _ in range(5):
            w = rng.normal(size=forms.width)
            one = w[: size + 1]
            total = 2 * one @ u.G[:, :size] @ (corner.F @ w) + u.alpha * one @ u.G @ one
            for value, (rows, place) in zip(u.squares, forms.squares, strict=True):
                total += value * (np.sum((rows @ w) ** 2) - w[place] ** 2)
            total += u.inputs @ (w[size] ** 2 - w[size + 1 :] ** 2)
            total += u.sectors @ (w[size] ** 2 - (forms.sectors @ one) ** 2)
            total += (u.mu @ w) * (corner.relation @ w)
            for i, (at, times) in enumerate(forms.products):
                v, psi = w[list(at)], w[list(times)]
                D, K = u.scale(i), u.turn(i)
                assert (K == -K.T).all() and (D == D.T).all()
                assert D[np.triu_indices(3)].tolist() != D[np.tril_indices(3)].tolist()
                total += v @ D @ v - psi @ D @ psi + v @ K @ psi
            assert w @ form @ w == pytest.approx(total, rel=1e-9, abs=1e-9)
    row, z = rng.normal(size=size + 1), rng.normal(size=size + 1)
    z[-1] = 1.0
    target = z @ target_form(u.G, row, 0.7) @ z
    assert target == pytest.approx(z @ u.G @ z + 0.7 - row @ z)


def test_a_row_over_the_box_is_that_over_the_errors(stage):
    rng = np.random.default_rng(6)
    forms, row = stage.floats, np.random.default_rng(6).normal(size=stage.loop.size)
    zeta = rng.uniform(-1, 1, forms.size)
    z = forms.middle + forms.radius * zeta
    assert row_over_box(forms, row) @ np.append(zeta, 1) == pytest.approx(row @ z)


@pytest.mark.parametrize("inputs", [True, False])
def test_forms_with_the_reference_are_the_same_in_another_order(stage, inputs):
    """y_i' = Y_{i+1}/Y_i y_{i+1}; y_0 ... y_q are behind the errors, all else as it was."""
    rng = np.random.default_rng(7)
    loop, forms = stage.loop.in_floats(), stage.floats
    if not inputs:
        loop = replace(loop, Ub=loop.Ub[:, :0])
        forms = forms_of(loop, stage.numbers.in_floats())
    assert knows_reference(loop)
    assert not knows_reference(replace(loop, Y=np.append(0.0, loop.Y[1:])))
    wide = with_reference(loop, forms)
    q, size = len(loop.Y) - 2, forms.size
    begin = size + 1 + loop.Ua.shape[1] + loop.Ub.shape[1]
    w = rng.uniform(-1, 1, forms.width)
    w[size] = 1.0
    y = w[begin : begin + q + 2]
    order = [*range(size), *range(begin, begin + q + 1)]
    order += [i for i in range(size, forms.width) if i not in order]
    new = w[order]
    assert (wide.size, wide.width) == (size + q + 1, forms.width)
    for old, corner in zip(forms.corners, wide.corners, strict=True):
        rates = corner.F @ new
        assert rates[:size] == pytest.approx(old.F @ w)
        follow = [loop.Y[i + 1] / loop.Y[i] * y[i + 1] for i in range(q + 1)]
        assert rates[size:] == pytest.approx(follow)
        assert corner.relation @ new == pytest.approx(old.relation @ w)
    for (rows, place), (other, at) in zip(forms.squares, wide.squares, strict=True):
        assert other @ new == pytest.approx(rows @ w)
        assert new[at] == w[place]
    for first, second in zip(forms.products, wide.products, strict=True):
        for places, others in zip(first, second, strict=True):
            assert new[list(others)].tolist() == w[list(places)].tolist()
    one = np.append(new[: wide.size], 1.0)
    expected = [*(forms.sectors @ w[: size + 1]), *y[: q + 1]]
    assert wide.sectors @ one == pytest.approx(expected)
    assert wide.middle.tolist() == [*forms.middle, *[0.0] * (q + 1)]
    assert wide.radius.tolist() == [*forms.radius, *loop.Y[:-1]]


# The conditions on polynomials --------------------------------------------------------------------


def polynomial(rng, count, degree):
    return {m: float(rng.normal()) for m in monomials(count, degree)}


def value_at(p, v):
    return sum(c * math.prod(x**k for x, k in zip(v, m, strict=True)) for m, c in p.items())


def gradient_at(p, v, step=1e-5):
    units = np.eye(len(v)) * step
    return np.array([(value_at(p, v + d) - value_at(p, v - d)) / (2 * step) for d in units])


@pytest.mark.parametrize("name", ["plain", "both", "order two"])
@pytest.mark.parametrize("reference", [False, True])
def test_the_conditions_on_polynomials_are_those_of_the_loop(name, reference):
    """W' + alpha W + mu relation, split into what inputs multiply, with their majorants."""
    rng, stage = np.random.default_rng(8), first_stage(name)
    forms, exact = stage.floats, stage.forms
    if reference:
        forms = with_reference(stage.loop.in_floats(), forms)
        exact = with_reference(stage.loop, exact)
    N, alpha = forms.size, 0.7
    layout = layout_of(exact, 4)
    parts = {
        kind: tuple(polynomial(rng, N, degree) for _ in range(number))
        for kind, number, degree in layout.shapes
    }
    functions = Polynomials(**parts)
    claim = polynomial(rng, N, 1)
    conditions = iter(sums_of_squares(forms, layout, functions, alpha, [claim]))
    v = rng.uniform(-1, 1, N)
    one = np.append(v, 1.0)
    W, mu = functions.W[0], functions.mu[0]
    slope, of_mu = gradient_at(W, v), value_at(mu, v)
    for kind in (functions.squares, functions.inputs, functions.sectors, functions.holds):
        for p in kind:
            assert next(conditions).polynomial is p
    squares = [value_at(p, v) for p in functions.squares]
    inputs = [value_at(p, v) for p in functions.inputs]
    sums, majorants = [0.0 for _ in forms.corners], iter(functions.majorants)
    seen = set()
    for channel in layout.channels:
        for group in channel.groups:
            s, p = next(majorants), forms.corners[group[0]]
            q = sum(
                (slope @ p.F[:, place] + of_mu * p.relation[place]) * value_at({m: 1.0}, v)
                for place, m in channel.entries
            )
            place = channel.entries[0][0]
            for weight, (rows, _) in zip(squares, forms.squares, strict=True):
                q += weight * 2 * rows[:, place] @ (rows[:, : N + 1] @ one)
            seen |= {place for place, _ in channel.entries}
            if channel.square is None:
                signs = [value_at(next(conditions).polynomial, v) for _ in range(2)]
                expected = [value_at(s, v) - q, value_at(s, v) + q]
                assert sorted(signs) == pytest.approx(sorted(expected), rel=1e-6, abs=1e-7)
            else:
                k, a = channel.square, rng.normal()
                assert forms.squares[k][1] == place
                lifted = value_at(next(conditions).polynomial, np.append(v, a))
                expected = value_at(s, v) - q * a + (squares[k] + inputs[k]) * a**2
                assert lifted == pytest.approx(expected, rel=1e-6, abs=1e-7)
            for corner in group:
                sums[corner] += value_at(s, v)
    for i in range(N + 1, forms.width):
        acts = any((c.F[:, i] != 0).any() or c.relation[i] != 0 for c in forms.corners)
        assert i in seen or not acts
    for corner, total in zip(forms.corners, sums, strict=True):
        falls = slope @ (corner.F[:, : N + 1] @ one) + of_mu * (corner.relation[: N + 1] @ one)
        falls += alpha * value_at(W, v) + total + sum(inputs)
        for weight, (rows, _) in zip(squares, forms.squares, strict=True):
            crossed = np.abs(rows[:, N + 1 :].T @ rows[:, N + 1 :]).sum()
            falls += weight * (np.sum((rows[:, : N + 1] @ one) ** 2) + crossed)
        for p, row in zip(functions.sectors, forms.sectors, strict=True):
            falls += value_at(p, v) * (1 - (row @ one) ** 2)
        found = value_at(next(conditions).polynomial, v)
        assert found == pytest.approx(-falls, rel=1e-6, abs=1e-6)
    held = value_at(W, v) + value_at(claim, v)
    for p, row in zip(functions.holds, forms.sectors, strict=True):
        held -= value_at(p, v) * (1 - (row @ one) ** 2)
    assert value_at(next(conditions).polynomial, v) == pytest.approx(held, rel=1e-9, abs=1e-9)
    assert next(conditions, None) is None


@pytest.mark.parametrize("corner", [0, 1])
def test_an_input_that_acts_at_one_corner_alone_has_a_majorant(corner):
    """On the rates or on the relation; one that acts at neither has none."""
    forms = first_stage("gain").forms
    zero, place = rational(0), forms.width - 1
    for acts, rate, relation in ((True, 1, 0), (True, 0, 1), (False, 0, 0)):
        corners = []
        for i, old in enumerate(forms.corners):
            F, row = old.F.copy(), old.relation.copy()
            F[:, place], row[place] = zero, zero
            if i == corner:
                F[0, place], row[place] = rational(rate), rational(relation)
            corners.append(replace(old, F=F, relation=row))
        layout = layout_of(replace(forms, corners=tuple(corners)), 4)
        found = [c for c in layout.channels if place in [column for column, _ in c.entries]]
        assert len(found) == acts
        assert all(sorted(c.groups) == [(0,), (1,)] for c in found)


def test_a_sweep_is_tried_once_for_every_row(monkeypatch):
    """On the first stage and its upper side; the lower side begins where that ended."""
    stage, asked = first_stage("plain"), []

    class Asked:
        def __init__(self, *parts, reference):
            self.reference = reference

        def bound(self, rows, wanted, rate, sweep):
            asked.append((self.reference, wanted, tuple(sweep), rate.alpha))
            rate.alpha = 7.0 + wanted[0]

    monkeypatch.setattr(polynomial_stages_room, "RowSolver", Asked)
    sweep, rows = (1.5, 3.0), range(len(stage.forms.sectors))
    found = polynomial_stages(stage.loop, stage.ranges, stage.known, sweep, lambda *parts: None)
    assert found == []
    first = [
        (False, (i, side), sweep if side > 0 else (), 1.5 if side > 0 else 7.0 + i)
        for i in rows
        for side in (1, -1)
    ]
    second = [(True, (i, side), (), 7.0 + i) for i in rows for side in (1, -1)]
    assert asked == first + second


@pytest.mark.parametrize(
    ("size", "more", "known", "gain", "expected"),
    [
        (3, 2, True, 1.0, [False] + [True] * 5),  # 21 monomials of five variables
        (4, 2, True, 1.0, [False, True]),  # 28 of six: few stages
        (5, 2, True, 1.0, [False] * 6),  # 36 of seven: without the reference
        (6, 2, False, 1.0, [False] * 2),
        (6, 1, True, 1.0, [False] * 2),
        (7, 1, False, 1.0, []),
        (3, 2, False, 1.0, [False] * 6),
        (3, 2, True, 0.0, [False, True]),  # nothing gained ends it, with all variables
        (3, 2, False, 0.0, [False]),
        (3, 2, True, 0.0151, [False] + [True] * 5),
    ],
)
def test_stages_of_polynomials_are_as_many_as_there_is_time_for(
    monkeypatch, size, more, known, gain, expected
):
    """The first without the reference, then with it where a program of all variables is solved."""
    stage, met, room = first_stage("plain"), [], polynomial_stages_room

    class Asked:
        def __init__(self, loop, forms, floats, *, reference):
            met.append(reference)

        def bound(self, rows, wanted, rate, sweep):
            return None

    loop = SimpleNamespace(size=size, Y=np.ones(more + 1), in_floats=lambda: None)
    for name, value in {
        "RowSolver": Asked,
        "knows_reference": lambda _: known,
        "next_region": lambda *parts: stage.region,
        "forms_of": lambda *parts: stage.forms,
        "rows_of": lambda *parts: stage.rows,
        "shrunk": lambda before, later: gain,
    }.items():
        monkeypatch.setattr(room, name, value)
    assert polynomial_stages(loop, None, stage.known, (1.0,), lambda *parts: None) == []
    assert met == expected


def test_a_quartic_on_a_first_box_is_proven_and_better():
    """One program of degree 4, with and without the reference among the variables."""
    stage, bounds = first_stage("plain"), []
    _, high = stage.numbers.box[0]
    for reference in (False, True):
        solver = RowSolver(stage.loop, stage.forms, stage.floats, reference=reference)
        rate = Rate(2.0)
        rate.met(-1.0)
        rate.met(1.0)
        rate.alpha = 2.0
        function = solver.bound(stage.rows, (0, 1), rate)
        assert (function.degree, function.reference, function.alpha) == (4, reference, "2")
        bounds.append(float(function.claims[0].bound))
    program = BootstrapProgram(stage.floats, 1)
    asked = np.array([row_over_box(stage.floats, stage.rows[0].astype(float))])
    quadratic = program.solve(2.0, asked)
    bounds.insert(0, float(quadratic.bounds[0] * quadratic.sizes[0]))
    assert bounds[2] <= bounds[1] * (1 + 1e-4)
    assert bounds[1] <= bounds[0] * (1 + 1e-4)
    assert bounds[0] < float(high)


def test_stages_with_polynomials_go_on_from_what_is_known(monkeypatch):
    """The first without the reference, the others with it; each makes the box smaller."""
    stage, told = first_stage("plain"), []
    monkeypatch.setattr(polynomial_stages_room, "MOST_STAGES_OF_POLYNOMIALS", 2)

    def progress(*parts):
        told.append(parts[-1])

    found = polynomial_stages(stage.loop, stage.ranges, stage.known, (1.5, 3.0), progress)
    assert [{f.reference for f in part.functions} for part in found] == [{False}, {True}]
    known = stage.known
    for part in found:
        numbers = part.region.numbers()
        assert failed_region(stage.loop, stage.ranges, known, part.region) == ""
        later = after(known, part.functions, rows_of(stage.loop, numbers))
        assert shrunk(known, later) > 0.02
        claimed = [(c.error, c.side) for f in part.functions for c in f.claims]
        assert len(set(claimed)) == len(claimed) >= 2 * stage.loop.size
        known = later
    assert told == sorted(told, reverse=True)
    assert told[-1] == pytest.approx(float(np.abs(known.box[0].astype(float)).max()))
    assert len(told) == 2 * len(stage.forms.sectors) * len(found)
    monkeypatch.setattr(polynomial_stages_room, "MOST_SOLVED", 1)
    assert polynomial_stages(stage.loop, stage.ranges, stage.known, (1.5,), progress) == []


def test_monomials_of_a_gram_matrix_are_counted():
    for count in range(1, 6):
        assert polynomial_stages_room._monomials(count) == len(monomials(count, 2))
    assert polynomial_stages_room._solvable(6) and not polynomial_stages_room._solvable(7)


# The program --------------------------------------------------------------------------------------


def test_what_the_program_finds_holds_and_is_proven_so(stage):
    """Bounds that exact arithmetic confirms, nearly as they are; the slope is a derivative."""
    forms, floats, loop = stage.forms, stage.floats, stage.loop
    program = BootstrapProgram(floats, 2)
    wanted = ((loop.n - 1, 1), (loop.n - 1, -1))
    row = stage.rows[loop.n - 1]
    asked = np.array([row_over_box(forms, side * row) for _, side in wanted]).astype(float)
    alpha, step = 1.5 * float(from_text(stage.proof.alpha)), 1e-3
    found = program.solve(alpha, asked)
    sizes = np.linalg.norm(asked[:, :-1], axis=1)
    assert found.sizes == pytest.approx(sizes)
    proof = prove_function(forms, found, wanted, stage.rows)
    assert failed_part(forms, proof, stage.rows) == ""
    for claim, (error, side), bound in zip(proof.claims, wanted, found.bounds * sizes, strict=True):
        assert (claim.error, claim.side) == (error, side)
        assert float(claim.bound) == pytest.approx(bound, rel=1e-3, abs=1e-5)
        assert float(claim.bound) >= bound
    sums = [program.solve(alpha * math.exp(v), asked).bounds.sum() for v in (-step, step)]
    assert found.slope == pytest.approx((sums[1] - sums[0]) / (2 * step), rel=0.05, abs=1e-3)
    assert failed_part(forms, replace(proof, alpha="0"), stage.rows) != ""
    assert failed_part(forms, replace(proof, claims=()), stage.rows) == ""
    beyond = replace(proof.claims[0], error=len(stage.rows))
    assert "no row" in failed_part(forms, replace(proof, claims=(beyond,)), stage.rows)
    before = replace(proof.claims[0], error=-1)
    assert "no row" in failed_part(forms, replace(proof, claims=(before,)), stage.rows)


@cache
def stated(name):
    """A proof of both sides of e_n on the first box."""
    stage = first_stage(name)
    forms, wanted = stage.forms, ((stage.loop.n - 1, 1), (stage.loop.n - 1, -1))
    asked = [row_over_box(forms, side * stage.rows[error]) for error, side in wanted]
    alpha = 1.5 * float(from_text(stage.proof.alpha))
    found = BootstrapProgram(stage.floats, 2).solve(alpha, np.array(asked).astype(float))
    return prove_function(forms, found, wanted, stage.rows)


@pytest.mark.parametrize("name", ["plain", "both"])
@pytest.mark.parametrize("kind", ["squares", "inputs", "sectors"])
def test_no_multiplier_may_be_negative_however_little(name, kind):
    """One alone, by so little that every matrix may stay definite: its sign is what fails."""
    stage, proof = first_stage(name), stated(name)
    texts = getattr(proof, kind)
    for i in range(len(texts)):
        for text in ("-1e-200", "-1e-12", "-1"):
            forged = replace(proof, **{kind: (*texts[:i], text, *texts[i + 1 :])})
            assert "negative" in failed_part(stage.forms, forged, stage.rows)
        zero = replace(proof, **{kind: (*texts[:i], "0", *texts[i + 1 :])})
        assert "negative" not in failed_part(stage.forms, zero, stage.rows)


@pytest.mark.parametrize("name", ["plain", "both"])
def test_what_a_quadratic_proof_must_have_is_named(name):
    """Each condition alone: signs, symmetry, shapes, and the regressor's multipliers."""
    stage, proof = first_stage(name), stated(name)
    assert failed_part(stage.forms, proof, stage.rows) == ""
    claim, G = proof.claims[0], proof.G
    off = (*G[:1], (str(float(G[1][0]) + 1e-9), *G[1][1:]), *G[2:])
    faults = {
        "alpha is not positive": [{"alpha": "0"}, {"alpha": "-1e-200"}],
        "G is not symmetric": [{"G": off}],
        "a scale is not positive": [
            {"claims": (claim, replace(claim, scale=text))} for text in ("0", "-1e-200")
        ],
        "a claim is of no row": [{"claims": (claim, replace(claim, side=side))} for side in (0, 2)],
        "the function is below": [{"claims": (claim, replace(claim, bound="-1e3"))}],
    }
    for kind in ("squares", "inputs", "sectors", "mu", "scales", "turns"):
        texts = getattr(proof, kind)
        faults.setdefault("shape", []).append({kind: (*texts, "0")})
        faults["shape"] += [{kind: texts[:-1]}] if texts else []
    for i in range(0, len(proof.scales), 6):
        for at in (0, 2, 5):  # the diagonal of a D_i
            scales = [*proof.scales[: i + at], "0", *proof.scales[i + at + 1 :]]
            fault = "a multiplier of the regressor is not positive definite"
            faults.setdefault(fault, []).append({"scales": tuple(scales)})
    for reason, changes in faults.items():
        for change in changes:
            assert reason in failed_part(stage.forms, replace(proof, **change), stage.rows)


def test_one_function_for_two_rows_is_no_better_than_one_for_each(stage):
    forms, loop = stage.floats, stage.loop
    row = stage.rows[loop.n - 1].astype(float)
    asked = np.array([row_over_box(forms, side * row) for side in (1, -1)])
    alone, both = BootstrapProgram(forms, 1), BootstrapProgram(forms, 2).solve(1.0, asked)
    each = [alone.solve(1.0, row[None]).bounds[0] for row in asked]
    assert sum(each) <= both.bounds.sum() * (1 + 1e-5)
    assert both.bounds.sum() <= 2.5 * max(each)


def test_a_matrix_that_only_floats_take_for_definite_is_not_proven():
    """[[1, b], [b, c]], b = 1 + 2^-53 and c = 1 + 2^-52: det = -2^-106; b is 1 in floats."""
    tiny = flint.fmpq(1, 2**53)
    one, zero = flint.fmpq(1), flint.fmpq(0)
    b = one + tiny
    for c, definite in ((one + 2 * tiny, False), (one + 4 * tiny, True)):
        for size in (2, 4):  # beside a part that is definite, before it and behind it
            for first in (0, size - 2):
                matrix = np.full((size, size), zero, dtype=object)
                matrix[range(size), range(size)] = one
                i, j = first, first + 1
                matrix[i, j] = matrix[j, i] = b
                matrix[j, j] = c
                np.linalg.cholesky(matrix.astype(float))
                assert proven_definite(matrix) == definite
    assert not proven_definite(np.array([[-one]], dtype=object))
    assert proven_definite(np.array([[tiny]], dtype=object))


def test_no_singular_matrix_is_proven_definite():
    """b b^T/7 leaves exactly zeros behind a factor that floats have: no row may be as large."""
    factored = 0
    for b in itertools.product(range(-9, 10), repeat=2):
        matrix = np.array([[flint.fmpq(v * w, 7) for v in b] for w in b])
        try:
            np.linalg.cholesky(matrix.astype(float))
            factored += 1
        except np.linalg.LinAlgError:
            pass
        assert not proven_definite(matrix)
        assert proven_definite(matrix + np.diag([flint.fmpq(1, 1000)] * 2))
    assert factored > 10  # of rank one, and taken for definite


# The search ---------------------------------------------------------------------------------------


def test_rows_are_grouped_by_what_they_follow(stage):
    """e_1; e_2 ... e_{n-1}; e_n; the rest, each with both sides, and each row once."""
    loop, rows = stage.loop, len(stage.forms.sectors)
    groups = search.groups_of(loop, rows)
    assert sorted(itertools.chain(*groups)) == sorted((i, s) for i in range(rows) for s in (1, -1))
    assert [g[0][0] for g in groups] == ([0, loop.n] if loop.n == 1 else [0, loop.n - 1, loop.n])
    long = SimpleNamespace(n=5)
    firsts = [[error for error, side in g if side > 0] for g in search.groups_of(long, 8)]
    assert firsts == [[0], [1, 2, 3], [4], [5, 6, 7]]


def test_rates_that_are_tried_lie_between_the_slow_and_the_fast(stage):
    loop = stage.loop
    slow = float(from_text(stage.proof.alpha))
    sweep = search.sweep_of(loop, stage.proof)
    fast = 2 * max(-float(loop.M[i, i]) for i in range(loop.n))
    assert len(sweep) == 6
    assert sweep[0] == pytest.approx(1.5 * slow)
    assert sweep[-1] == pytest.approx(max(fast, 1.5 * slow))
    ratios = np.array(sweep[1:]) / np.array(sweep[:-1])
    assert ratios == pytest.approx(ratios[0])
    starts = search.starting_rates(loop, slow)
    assert len(starts) == loop.n + loop.r + 2  # of every error, and of the row of ubar
    head = loop.M[:-1, :-1].astype(float)
    errors = -np.linalg.eigvals(head).real.max() if len(head) else slow
    assert starts[: loop.n - 1] == [max(errors, slow)] * (loop.n - 1)
    assert starts[loop.n - 1 :] == [slow] * (loop.r + 3)


def test_a_gain_is_the_part_of_the_interval_that_goes():
    box = np.array([[rational(-1), rational(3)]], dtype=object)
    known, row = Reached(box), np.array([rational(1)])
    assert search._gain(known, row, 1, 2.0) == 0.25
    assert search._gain(known, row, -1, 0.5) == 0.125
    assert search._gain(known, row, 1, 4.0) == -0.25


def test_corners_are_counted_by_the_width_of_their_matrices(stage):
    loop = stage.loop
    scales = 2 if loop.largest_scale > 1 else 0
    ranged = sum(v > 0 for v in loop.theta_radius)
    inputs = loop.Ua.shape[1] + loop.Ub.shape[1] + len(loop.Y)
    width = loop.size + 1 + inputs + 1 + ranged + scales + 3 * loop.r
    assert search._corner_entries(loop) == 2 * width**2
    varying = [i for i, pair in enumerate(stage.region.regressor) if pair[0] != pair[1]]
    assert stage.forms.width == width - 3 * (loop.r - len(varying))


class Parabola:
    """Bounds with their least at one alpha, by its logarithm; none above a largest."""

    def __init__(self, best, largest=math.inf):
        self.best, self.largest, self.asked = math.log(best), largest, []

    def solve(self, alpha, rows):
        self.asked.append(alpha)
        if alpha > self.largest:
            return None
        off = math.log(alpha) - self.best
        return SimpleNamespace(bounds=np.array([1 + off**2]), slope=2 * off)


@pytest.mark.parametrize("start", [0.01, 1.0, 3.0, 100.0])
def test_the_best_alpha_is_found_from_either_side(start):
    program, rate = Parabola(3.0, 50.0), Rate(start)
    found = best_of_rates(program, np.zeros((1, 2)), rate, 14)
    assert found.bounds[0] == pytest.approx(1, abs=1e-3)
    assert rate.alpha == pytest.approx(3.0, rel=0.1)
    assert len(program.asked) == 14
    assert best_of_rates(Parabola(3.0, 0.0), np.zeros((1, 2)), Rate(start), 3) is None


@pytest.mark.parametrize("start", [0.01, 200.0])
def test_rates_without_a_bound_are_left_behind(start):
    """There is one between 1 and 50 only: it is found, and then not left again."""

    class Window(Parabola):
        def solve(self, alpha, rows):
            return None if alpha < 1 else super().solve(alpha, rows)

    program, rate = Window(3.0, 50.0), Rate(start)
    found = best_of_rates(program, np.zeros((1, 2)), rate, 24)
    assert found.bounds[0] == pytest.approx(1, abs=1e-2)
    assert 1 < rate.alpha < 50
    both = Rate(10.0)
    both.met(-1.0)  # it still falls there
    assert both.alpha == pytest.approx(25.0)
    both.met(None)
    assert both.surrounded and 10 < both.alpha < 25
    other = Rate(10.0)
    other.met(1.0)
    assert other.alpha == pytest.approx(4.0)
    other.met(None)
    assert other.surrounded and 4 < other.alpha < 10
    other.met(None)  # slower still has none: the best is between this one and 10
    least = other.alpha
    assert least > math.sqrt(4.0 * 10.0)


@pytest.mark.parametrize(("slope", "expected"), [(1.0, 4.0), (-1.0, 25.0)])
def test_an_alpha_that_contradicts_itself_is_believed_anew(slope, expected):
    """The programs change: where the bound fell with alpha it rises now, or the other way round."""
    rate = Rate(10.0)
    rate.met(-slope)
    rate.alpha = 10.0
    rate.met(slope)
    assert not rate.surrounded
    assert rate.alpha == pytest.approx(expected)


@pytest.mark.parametrize(("slope", "contradicting"), [(-1.0, 2.0), (1.0, 4.0)])
def test_where_no_bound_was_is_forgotten_with_the_first_bound(slope, contradicting):
    """It tells on which side of the first bound there is none, and nothing of later programs."""
    rate = Rate(1.0 if slope < 0 else 9.0)
    rate.met(None)
    rate.alpha = 3.0
    rate.met(slope)
    rate.alpha = contradicting
    rate.met(-slope)
    assert not rate.surrounded
    assert rate.alpha == pytest.approx(contradicting * (2.5 if slope > 0 else 1 / 2.5))


def test_a_sweep_is_gone_on_from_its_best():
    program, rate = Parabola(3.0), Rate(0.5)
    found = best_of_rates(program, np.zeros((1, 2)), rate, 0, (0.1, 1.0, 4.0, 20.0))
    assert program.asked == [0.1, 1.0, 4.0, 20.0]
    assert found.bounds[0] == pytest.approx(1 + math.log(4 / 3) ** 2)
    assert rate.alpha < 4.0  # there the bound rises


# What a file may hold -----------------------------------------------------------------------------


def written_stage():
    """A stage of order one, as a file has it; nothing is proven by it."""
    pair, claim = ["-1", "1"], {"error": 0, "side": 1, "scale": "2", "bound": "0.5"}
    region = {"box": [pair, pair], "middle": [], "slope": ["0"], "row": pair, "regressor": []}
    region |= {"drift": pair, "remainder": pair, "reach": ["1"]}
    names = ("squares", "inputs", "sectors", "mu", "scales", "turns")
    function = {"alpha": "1", "G": [["1"]], **{name: ["0"] for name in names}, "claims": [claim]}
    return {"region": region, "functions": [function]}


@cache
def small_document():
    system = SYSTEMS["gain"]
    _, proof = certify_bootstrap(system)
    return json.loads(json.dumps(to_document(system, *proof)))


def test_a_file_holds_as_many_parts_as_it_may_and_no_more():
    """Stages, functions, claims, and entries of a list; each limit is admitted, one more is not."""
    stage = written_stage()
    assert len(bootstrap_stages([stage] * 64)) == 64
    with pytest.raises(InputError, match="at most 64 stages"):
        bootstrap_stages([stage] * 65)
    function = stage["functions"][0]
    for most, changed in (
        (256, lambda k: stage | {"functions": [function] * k}),
        (256, lambda k: of_function(claims=[function["claims"][0]] * k)),
        (2000, lambda k: of_function(mu=["0"] * k)),
        (2000, lambda k: of_function(G=[["0"]] * k)),
        (2000, lambda k: of_function(G=[["0"] * k])),
        (2000, lambda k: stage | {"region": stage["region"] | {"reach": ["1"] * k}}),
    ):

        def of_function(**changes):
            return stage | {"functions": [function | changes]}

        (found,) = bootstrap_stages([changed(most)])
        assert found.region.box == tuple(map(tuple, stage["region"]["box"]))
        with pytest.raises(InputError, match="too long"):
            bootstrap_stages([changed(most + 1)])
    for pair in (["1"], ["1", "2", "3"], "12", 1):
        with pytest.raises(InputError, match="proof"):
            bootstrap_stages([stage | {"region": stage["region"] | {"drift": pair}}])


def written_polynomial():
    """A function of degree 4, as a file has it; nothing is proven by it."""
    kinds = ("squares", "inputs", "sectors", "majorants", "holds", "grams")
    vectors = {"alpha": "1", "W": ["1"], "mu": ["0"], **{name: [["0"]] for name in kinds}}
    claims = written_stage()["functions"][0]["claims"]
    return {"degree": 4, "reference": False, **vectors, "claims": claims}


def test_parts_of_a_file_have_their_fields_and_no_others():
    """Stage, region, function of either kind and claim: none may be missing, and none unknown."""
    stage, polynomial = written_stage(), written_polynomial()
    region, (function,) = stage["region"], stage["functions"]
    (claim,) = function["claims"]

    def of(**changes):
        return stage | changes

    parts = (
        (stage, lambda part: part),
        (region, lambda part: of(region=part)),
        (function, lambda part: of(functions=[part])),
        (polynomial, lambda part: of(functions=[part])),
        (claim, lambda part: of(functions=[function | {"claims": [part]}])),
        (claim, lambda part: of(functions=[polynomial | {"claims": [part]}])),
    )
    for part, inside in parts:
        assert len(bootstrap_stages([inside(part)])) == 1
        less = [{k: v for k, v in part.items() if k != name} for name in part if name != "degree"]
        for wrong in (part | {"note": "1"}, *less, list(part.items()), 3):
            with pytest.raises(InputError, match="must have [a-zA-Z]+, [a-zA-Z]+"):
                bootstrap_stages([inside(wrong)])


def test_entries_of_a_file_are_of_their_types():
    """Whole numbers, true or false, and decimal texts; nothing is converted."""
    stage, polynomial = written_stage(), written_polynomial()
    (function,) = stage["functions"]
    (claim,) = function["claims"]
    wrong = [polynomial | {name: value} for name in ("degree",) for value in (4.0, "4", True)]
    wrong += [polynomial | {"reference": value} for value in (0, 1, "false", None)]
    for name in ("error", "side"):
        wrong += [function | {"claims": [claim | {name: v}]} for v in (True, 1.0, "1")]
    for name in ("scale", "bound"):
        wrong += [function | {"claims": [claim | {name: v}]} for v in (1, None, "x", "1/0")]
    wrong += [function | {name: v} for name in ("alpha",) for v in (1, None, "x")]
    wrong += [polynomial | {"W": value} for value in ("1", {"1": 1}, [1], [["1"]])]
    for entry in wrong:
        with pytest.raises(InputError, match="^proof: must hold decimal texts"):
            bootstrap_stages([stage | {"functions": [entry]}])


def test_what_a_file_says_is_what_was_proven():
    system = SYSTEMS["gain"]
    _, proof = certify_bootstrap(system)
    assert bootstrap_stages(small_document()["proof"][1:]) == proof[1:]
    assert is_bootstrap({"proof": small_document()["proof"]})
    for other in ([], [{}], [{}, {}], [{}, {"region": 1}, 3], {"region": 1}, None):
        assert not is_bootstrap({"proof": other})
    assert not is_bootstrap([]) and is_bootstrap({"proof": [{}, {"region": 1}]})


# Formulas -----------------------------------------------------------------------------------------


def test_short_decimals_are_their_own_texts():
    assert _decimal_of(sympy.Rational(1, 4)) == "0.25"
    assert _decimal_of(sympy.Integer(-3)) == "-3"
    assert _decimal_of(sympy.Rational("0.1")) == "0.1"
    assert _decimal_of(sympy.Rational(1, 3)) is None
    assert _decimal_of(sympy.pi) is None
    assert _decimal_of(sympy.Symbol("x")) is None


@pytest.mark.parametrize("formula", ["x1**2 - x1", "sin(3*x1)", "tanh(x1)", "abs(x1 - 0.3)"])
def test_bounds_on_a_box_hold_and_are_near(formula):
    """Over e in [-1, 2] and y_d in [-0.2, 0.2]: x_1 = e + y_d; the slope and a constant are in."""
    stage = first_stage("plain")
    x1 = formulas_of(stage.system).states[0]
    expr = parse("", formula, ["x1"]).expr
    ranges = Ranges(SimpleNamespace(states=(x1,), drift=expr, regressor=()), stage.loop)
    place = np.array([[-1.0, 2.0], [-0.2, 0.2]])
    x = np.linspace(-1.2, 2.2, 4001)
    for slope, constant in ((0, 0), (1, 2)):
        chosen = Combination((rational(1),), (rational(slope),), rational(constant))
        values = sympy.lambdify(x1, expr)(x) - slope * x + constant
        low, high = ranges.bounds(chosen, place)
        room = 0.03 * (values.max() - values.min())
        assert values.min() - room <= low <= values.min() + 1e-6
        assert values.max() - 1e-6 <= high <= values.max() + room
        assert ranges.within(chosen, place, low, high)
        assert ranges.within(chosen, place, low - 1, high + 1)
        assert not ranges.within(chosen, place, values.min() + room, high)
        assert not ranges.within(chosen, place, low, values.max() - room)
        plain = sympy.lambdify(x1, expr)(x)
        for weight in (0.5, -1.0, 0.0, -2.0):
            weighted = Combination((rational(weight),), (rational(0),), rational(0))
            ends = sorted((weight * plain.min(), weight * plain.max()))
            found = ranges.bounds(weighted, place)
            assert found == pytest.approx(ends, abs=0.03 * np.ptp(plain) * abs(weight) + 1e-9)
    fitted = ranges.fitted_slope(place, 400)
    points = np.random.default_rng(0).uniform(*place.T, (4000, 2)).sum(axis=1)
    expected = np.polyfit(points, sympy.lambdify(x1, expr)(points), 1)[0]
    assert fitted == pytest.approx([expected], abs=0.05)


def test_the_largest_reach_is_at_a_corner(stage):
    """||S_k x||, by all corners and, with too many of them, by each entry."""
    place = box_of_states(stage.loop, stage.numbers.box)
    through = np.hstack([stage.loop.Xe, stage.loop.AB]).astype(float)
    corners = np.array(list(itertools.product(*place)))
    for S, reach in zip(stage.loop.selections, largest_reach(stage.loop, place), strict=True):
        largest = np.linalg.norm(corners @ (S.astype(float) @ through).T, axis=1).max()
        assert largest <= reach <= largest * (1 + 1e-10)


def test_the_reach_of_many_corners_is_above_that_of_each(monkeypatch):
    stage = first_stage("order two")
    place = box_of_states(stage.loop, stage.numbers.box)
    exact = largest_reach(stage.loop, place)
    monkeypatch.setattr("certrack.certificates.bootstrap.ranges.MOST_BOX_CORNERS", 1)
    rough = largest_reach(stage.loop, place)
    through = np.hstack([stage.loop.Xe, stage.loop.AB]).astype(float)
    for S, reach, least in zip(stage.loop.selections, rough, exact, strict=True):
        rows = S.astype(float) @ through
        entries = np.abs(rows @ place.mean(axis=1)) + np.abs(rows) @ (np.diff(place)[:, 0] / 2)
        assert reach >= least * (1 - 1e-12)
        assert np.linalg.norm(entries) <= reach <= np.linalg.norm(entries) * (1 + 1e-10)


def test_a_tape_gives_the_values_of_its_formulas():
    x, y = sympy.symbols("x y", real=True)
    formulas = [x * sympy.sin(y) + 2, sympy.tanh(x * sympy.sin(y)), sympy.Integer(3), x]
    tape = Tape(formulas, [x, y])
    values = [float(v.mid()) for v in tape([flint.arb(0.5), flint.arb(1.25)])]
    expected = [float(f.subs({x: 0.5, y: 1.25})) for f in formulas]
    assert values == pytest.approx(expected, rel=1e-12)
    for function, end in (
        (sympy.tanh, 1.0),
        (sympy.atan, math.pi / 2),
        (sympy.sinh, math.sinh(40)),
    ):
        (wide,) = Tape([function(x)], [x])([flint.arb(0, 40)])
        assert float(wide.upper()) == pytest.approx(end, rel=0.03)
        assert float(wide.lower()) == pytest.approx(-end, rel=0.03)


def test_both_sides_of_the_error_must_be_bounded():
    up, down = (SimpleNamespace(functions=(claims((0, s, b)),)) for s, b in ((1, "2"), (-1, "3")))
    other = SimpleNamespace(functions=(claims((1, 1, "0.1")),))
    assert bounds_error([up, down]) and bounds_error([other, down, up])
    assert not bounds_error([up, other]) and not bounds_error([down])
    assert claimed_bound([up, down, other]) == "3"
    better = SimpleNamespace(functions=(claims((0, -1, "1.5")),))
    assert claimed_bound([up, down, better]) == "2"

"""Parts of the proof that uses rates: measures of step responses, sums, and steps of few digits."""

from types import SimpleNamespace

import flint
import numpy as np
import pytest
import sympy
from test_slow_signals import loop

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import rate_premise, step_search, superposition
from certrack.certificates.implemented import slow as slow_terms
from certrack.certificates.implemented.drive import DRIVE_BITS, SlowBound
from certrack.certificates.implemented.slow import (
    SlowTerms,
    StepResponses,
    as_function,
    needs_rates,
    slow_columns,
)
from certrack.certificates.implemented.superposition import (
    SplitLoop,
    _may_split,
    is_split,
    speeds_of_states,
)
from certrack.certificates.premise import ASSUMED, CHECKED, CONTRADICTED, PROVEN


def no_less(found, expected):
    """A bound that is rounded up by little."""
    return (np.array(found) >= expected).all() and found == pytest.approx(expected, rel=1e-9)


# measures of z


def responses():
    """Two rows over three periods of two cells; the first row has passed one cell of the first."""
    begin = np.array([[[0, 1], [3, 2], [2, -1]], [[0, -1], [-2, 0], [1, 1]]], dtype=float)
    end = np.array([[[1, 3], [2, 2], [-1, 0.5]], [[-1, -2], [0, 1], [1, 4]]], dtype=float)
    lengths = np.array([[[0.0, 0.5]] + [[0.25, 0.5]] * 2, [[0.25, 0.5]] * 3])
    return StepResponses(
        columns=[0],
        begin=begin[..., None],
        end=end[..., None],
        lengths=lengths,
        error=np.array([[0.125], [0.25]]),
        bend=np.array([[1.0], [2.0]]),
        overshoot=np.array([[[0.1], [0.2], [0.3]]] * 2),
    )


def mean(a, b):
    """Of |line|."""
    return (abs(a) + abs(b)) / 2 if a * b >= 0 else (a * a + b * b) / (2 * (abs(a) + abs(b)))


@pytest.mark.parametrize("z", [[0, 0, 0], [1, 1, 1], [2, -1, 0.5]])
@pytest.mark.parametrize("apart", [0, 1, 2])
def test_the_measures_of_a_z(z, apart):
    step, old = responses(), np.array([0.5, 0.75])
    assert step.periods == 3
    variation, area, jumps = step.measures(0, np.array(z, dtype=float), old, apart)
    for row in range(2):
        a, b = (side[row, ..., 0] - np.array(z)[:, None] for side in (step.begin, step.end))
        error, lengths = step.error[row, 0], step.lengths[row]
        last = abs(step.end[row, -1, -1, 0] - z[-1])
        tv = abs(z[0]) + sum(abs(v - w) for v, w in zip(z, z[1:], strict=False))
        assert no_less(variation[row], tv + last + error + old[row])
        lines = sum(h * mean(p, q) for h, p, q in zip(lengths.flat, a.flat, b.flat, strict=True))
        assert no_less(area[row], lines + step.bend[row, 0] + error * lengths.sum())
        largest = np.maximum(abs(a), abs(b)).max(axis=1) + step.overshoot[row, :, 0] + error
        sums = {0: 0.0, 1: largest.sum(), 2: max(largest[0] + largest[2], largest[1])}
        assert no_less(jumps[row], sums[apart])


def test_a_z_is_constant_from_step_to_step():
    assert as_function(((0, "1"), (2, "-3e0")), 5).tolist() == [1, 1, -3, -3, -3]
    assert as_function(((0, "0.5"),), 1).tolist() == [0.5]
    for steps in (
        (),
        ((1, "1"),),
        ((0, "1"), (0, "2")),
        ((0, "1"), (5, "2")),
        ((0, "1"), (6, "2")),
    ):
        with pytest.raises(NoCertificate, match="not in the order"):
            as_function(steps, 5)


# step responses of a loop


def test_step_responses_add_up_the_kernels_of_all_periods():
    period, bounds, doublings, *_ = loop()
    chosen = [row for row, k in zip(bounds.rows, bounds.outputs, strict=True) if k == 0]
    with flint.ctx.workprec(DRIVE_BITS):
        found = StepResponses.of(period, chosen, doublings)
        cells, n = len(period.cells), period.drive.n
        periods, (j,) = found.periods, found.columns
        assert periods == 2**doublings + 1 and found.columns == [0]
        integrals = []
        for cell in period.cells:
            block = flint.arb_mat(n + 1, n + 1)
            for i in range(n):
                for k in range(n):
                    block[i, k] = period.drive.A[i, k] * flint.arb(cell.length)
                block[i, n] = period.drive.W[i, j] * flint.arb(cell.length)
            over = block.exp()
            integrals.append(np.array([float(over[i, n].mid()) for i in range(n)]))

        def seen(row, p):
            """The integral of the kernel over cell p, of a row at its end."""
            return sum(float(row[0, i].mid()) * integrals[p][i] for i in range(n))

        for number, row in enumerate(chosen):
            first = flint.arb_mat([list(row.row)])
            g, at, phase = 0.0, first, row.phase
            since = period.since_jump(phase)
            for age in range(cells):
                p = cells - 1 - age
                if p < phase:
                    g += seen(first * since[phase - 1 - p], p)
                assert found.end[number, 0, age, 0] == pytest.approx(g, rel=1e-9, abs=1e-15)
                assert (found.lengths[number, 0, age] > 0) == (p < phase)
            at = first * (since[-1] * period.jump)
            for whole_period in range(1, 4):
                whole = period.since_jump(cells)
                for age in range(cells):
                    before = g
                    g += seen(at * whole[age], cells - 1 - age)
                    assert found.begin[number, whole_period, age, 0] == pytest.approx(
                        before, rel=1e-9
                    )
                    assert found.end[number, whole_period, age, 0] == pytest.approx(g, rel=1e-9)
                at = at * period.map
    assert (found.begin[:, 1:, 0] == found.end[:, :-1, -1]).all()
    of_cells = [float(cell.length) for cell in reversed(period.cells)]
    assert found.lengths[0, 1] == pytest.approx(of_cells, rel=1e-12)
    assert (
        (found.error < 1e-9).all() and (found.bend > 0).all() and (found.overshoot[:, 1:] > 0).all()
    )


def test_what_bends_between_the_ends_of_cells_is_bounded(monkeypatch):
    """One state and one cell: sup|k'| = |lambda| e^{|A| h} |A W|."""
    period = SimpleNamespace(
        drive=SimpleNamespace(A=flint.arb_mat([[-2]]), W=flint.arb_mat([[7, 3]])),
        size=1,
        cells=[SimpleNamespace(length=flint.fmpq(1, 4)), SimpleNamespace(length=flint.fmpq(1, 2))],
        since_jump=lambda phase: [flint.arb_mat([[v]]) for v in (1, -2, 5)[: phase + 1]],
    )
    monkeypatch.setattr(slow_terms, "padded", lambda matrix, size: matrix)
    cubic, square = slow_terms._bends(period, 2, [1])
    young, old = np.exp(1.0) * 6, 2 * np.exp(0.5) * 6  # the younger cell is the longer one
    assert no_less(cubic[0], [young * 0.125 / 12 + old / 64 / 12])
    assert no_less(square[0], [max(young / 4 / 8, old / 16 / 8)])
    one, _ = slow_terms._bends(period, 1, [1])
    assert no_less(one[0], [np.exp(0.5) * 6 / 64 / 12])


# bounds of slow terms


def made(by_states=(), dwell=None, measures=None):
    """Slow terms of one row and one column: |w| <= 3, of which 0.5 is fast, and 1.25 without it."""
    slow = SimpleNamespace(
        rate=flint.fmpq(2),
        by_states=by_states,
        jump=flint.fmpq(1, 4),
        dwell=dwell,
        fast=flint.fmpq(1, 2),
    )
    drive = SimpleNamespace(uncertain=(SimpleNamespace(slow=slow),), T=flint.fmpq(1, 100))
    gains = SimpleNamespace(w=np.array([[10.0]]), old=np.array([[0.125]]))
    step = SimpleNamespace(columns=[0], periods=4, measures=measures)
    value = np.array([flint.arb("1.25")], dtype=object)
    bounds = SimpleNamespace(drive=drive, gains=gains)
    return SlowTerms(bounds, np.array([0]), step, [flint.arb(3)], [flint.arb(2)], value, {})


def test_a_bound_is_the_sum_of_size_rate_jumps_and_what_is_fast():
    asked = []

    def measures(i, z, old, apart):
        asked.append((i, z.tolist(), old.tolist(), apart))
        return np.array([0.5]), np.array([0.25]), np.array([0.75])

    terms = made(dwell=flint.fmpq(3, 100), measures=measures)
    found = terms.bound([((0, "1"), (2, "0"))])
    assert asked == [(0, [1, 1, 0, 0], [0.125], 3)]
    expected = 1.25 + (3 - 0.5) * 0.5 + 2 * 0.25 + 0.25 * 0.75 + 0.5 * 10
    assert no_less(float(found), expected)
    plain = made(measures=lambda *_: (np.array([50.0]), np.array([0.0]), np.array([0.0])))
    assert no_less(float(plain.bound([((0, "0"),)])), 1.25 + 30)  # no more than without a rate
    with pytest.raises(NoCertificate, match="not one z"):
        terms.bound([])
    endless = made(measures=lambda *_: [np.array([np.nan])] * 3)
    with pytest.raises(NoCertificate, match="range of floating point"):
        endless.bound([((0, "0"),)])


@pytest.mark.parametrize(("dwell", "periods"), [("3/100", 3), ("399/10000", 3), ("1/100", 1)])
def test_jumps_are_so_many_periods_apart(dwell, periods):
    p, q = map(int, dwell.split("/"))
    assert made(dwell=flint.fmpq(p, q)).apart(0) == periods
    assert made().apart(0) == 0
    with pytest.raises(NoCertificate, match="shorter than a period"):
        made(dwell=flint.fmpq(99, 10000)).apart(0)


def test_rates_of_the_states_are_of_their_rows_and_of_what_acts():
    drive = SimpleNamespace(n=2, W=flint.arb_mat([[0, 2], [-3, 0]]))
    rows = {5: flint.arb(9), 6: flint.arb(4)}  # of x_i' - W_i w, behind u, its rate and the states
    bounds = SimpleNamespace(drive=drive, largest=lambda values, which: [rows[i] for i in which])
    found = speeds_of_states(bounds, None, [flint.arb(10), flint.arb(20)])
    assert no_less([float(v) for v in found], [9 + 2 * 20, 4 + 3 * 10])


# the search for z


def test_steps_have_few_digits_and_equal_neighbours_are_one():
    starts, z = np.array([0, 3, 5, 9]), np.array([1 / 3, 1 / 3 + 1e-9, -0.0, 2.0])
    found = step_search._few(starts, z, 1.0)
    assert found == ((0, "0.333333333"), (5, "0"), (9, "2"))
    assert step_search._few(starts, z, 1e9) == ((0, "0.333333333"),)


def test_blocks_follow_what_varies(monkeypatch):
    monkeypatch.setattr(step_search, "MOST_STEPS_OF_Z", 4)
    time = np.ones(100)
    even = step_search._blocks(np.arange(100.0), time)
    assert even.tolist() == pytest.approx([0, 25, 50, 75], abs=2)
    early = step_search._blocks(np.minimum(np.arange(100.0), 10), time)
    assert early[0] == 0 and early[1] < 10 and len(early) == 4
    late = step_search._blocks(np.arange(100.0) // 90, np.where(np.arange(100) < 90, 0.0, 1.0))
    assert (late[1:] > 88).all()


@pytest.mark.parametrize(
    ("prices", "owner", "expected"),
    [
        ((100.0, 1.0, 0.0), None, "zero"),  # a change of z costs more than any gap
        ((1.0, 100.0, 0.0), None, "g"),
        ((1.0, 0.0, 100.0), [0, 0, 1], "g"),
        ((100.0, 0.0, 1.0), [0, 0, 1], "zero"),
    ],
)
def test_the_cheapest_z(prices, owner, expected):
    """From 0 over g = 1, 3, 2 back to 0."""
    g, weights = np.array([1.0, 3.0, 2.0]), np.array([1.0, 2.0, 1.0])
    windows = None if owner is None else np.array(owner)
    found = step_search._least(g, weights, 0.0, prices, windows)
    assert found == pytest.approx(g if expected == "g" else 0 * g, abs=1e-7)


def test_a_z_that_ends_where_the_response_does():
    """TV counts the way to the last value: rising at once costs no more than later."""
    g, weights = np.array([0.0, 2.0, 2.0]), np.array([1.0, 1.0, 1.0])
    found = step_search._least(g, weights, 2.0, (1.0, 0.5, 0.0), None)
    assert found == pytest.approx(g, abs=1e-7)


def test_differences_of_a_response_and_z_lose_by_the_size_of_both(monkeypatch):
    """As if the roundings of g - z were large: they count as an error of g would."""
    step, z, old = responses(), np.array([2.0, -1.0, 0.5]), np.array([0.5, 0.75])
    _, area, jumps = step.measures(0, z, old, 1)
    monkeypatch.setattr(slow_terms, "ROUNDOFF", 0.01)
    variation, more_area, more_jumps = step.measures(0, z, old, 1)
    off = 4 * 0.01 * (2.0 + np.abs(step.end[..., 0]).max())
    assert more_area - area == pytest.approx(off * step.lengths.sum(axis=(1, 2)), rel=1e-9)
    assert more_jumps - jumps == pytest.approx(off * np.array([3, 3]), rel=1e-9)
    assert variation == pytest.approx(step.measures(0, z, old, 0)[0])


# what is said of a rate


def test_a_rate_is_stated_in_words_and_proven_of_nothing():
    """Of a term that is zero it holds; of a truth with states of its own it is not seen."""
    slowness = SimpleNamespace(rate=0.5, by_states=(2, 0), jump=0, dwell=0, fast=0)
    system = SimpleNamespace(plant=SimpleNamespace(states=("a", "b")))
    rate = rate_premise._Rate(system, 1, slowness, of_states=False)
    assert rate.stated == "w_2 changes by at most 0.5 dt + 2 |da|"
    unseen = rate.premise(None, None)
    assert (unseen.name, unseen.status) == ("rate of w_2", ASSUMED)
    assert unseen.remedy == rate_premise.NOT_SEEN
    still = rate.premise(SimpleNamespace(zero=True), None)
    assert (still.status, still.remedy, still.detail) == (PROVEN, "", rate.stated)
    jumping = SimpleNamespace(rate=0.5, by_states=(0, 0), jump=3, dwell=0.25, fast=0.1)
    rate = rate_premise._Rate(system, 0, jumping, of_states=True)
    assert rate.stated == (
        "w_1 is a function of t and x, without hysteresis, that changes by at most 0.5 dt, but for "
        "jumps of at most 3, at least 0.25 s apart, and a part of at most 0.1 of any speed, "
        "without which w_1 stays so much below its bound"
    )


def slow_bound(*by_states, dwell=None):
    return SlowBound(rate=1, by_states=by_states, jump=0, dwell=dwell, fast=0)


def driven(*slow, jitter=0, channels=(), growing=None):
    """A drive of which only is known how fast its terms are."""
    bounds = tuple(SimpleNamespace(slow=entry, growing=growing) for entry in slow)
    return SimpleNamespace(jitter=jitter, channels=channels, uncertain=bounds)


STILL, BY_STATES, JUMPING = slow_bound(0, 0), slow_bound(0, 1), slow_bound(1, 0, dwell=2)


def test_rates_count_where_they_are_known_and_times_are_exact():
    assert slow_columns(driven(STILL, None, BY_STATES)) == [0, 2]
    assert slow_columns(driven(STILL, jitter=0.1)) == []
    assert slow_columns(driven(STILL, channels=("c",))) == []


@pytest.mark.parametrize(
    ("slow", "needed"),
    [
        ((), False),
        ((None,), False),
        ((STILL, STILL), False),
        ((STILL, BY_STATES), True),
        ((BY_STATES, STILL, None), True),
        ((BY_STATES, JUMPING), True),
    ],
)
def test_one_term_that_follows_the_states_needs_their_rates(slow, needed):
    assert needs_rates(driven(*slow)) is needed
    assert not needs_rates(driven(*slow, jitter=0.1))


def test_terms_of_the_states_without_jumps_are_split():
    kinds = [None, STILL, BY_STATES, JUMPING]
    split = [is_split(SimpleNamespace(slow=slow)) for slow in kinds]
    assert split == [False, False, True, False]
    for slow, may in (((STILL, BY_STATES), True), ((STILL, JUMPING), False), ((), False)):
        assert _may_split(SimpleNamespace(drive=driven(*slow))) is may
    formula = driven(BY_STATES, STILL, growing="a formula")
    assert not _may_split(SimpleNamespace(drive=formula))


def test_a_part_of_the_loop_is_driven_as_the_whole_is():
    """By its constants, its terms, its states and its input; its rows are those of x and u."""
    asked = []

    class Bounds:
        drive = SimpleNamespace(n=2)

        def values(self, *parts):
            asked.append(parts)
            return "values"

        def largest(self, values, outputs):
            return values, list(outputs)

    loop = SplitLoop(Bounds(), (7, 8), "sensors", "others")
    assert loop._image("constant", "sizes", [1, 2, 3]) == ("values", [1, 2, 3])
    assert asked == [("constant", "sizes", [1, 2], 3)]


# a bound by rates


class MadeUpTerms:
    """|e_1| <= 10 less what each z takes off, and 1/8 of all with the split."""

    def __init__(self, gains, split, of_split):
        self.gains, self.split, self.of_split = gains, split, of_split

    def bound(self, steps):
        less = sum(gain for gain, z in zip(self.gains, steps, strict=True) if z != ((0, "0"),))
        return flint.arb(10 - less - (self.of_split if self.split else 0))


@pytest.mark.parametrize(
    ("gains", "of_split", "split", "expected"),
    [
        ((1, 2), 1, ("s",), (("z0", "z1"), ("s",), 6)),
        ((0, 2), 1, ("s",), ((((0, "0"),), "z1"), ("s",), 7)),
        ((2, 0), 1, ("s",), (("z0", ((0, "0"),)), ("s",), 7)),
        ((1e-9, 2), 1, ("s",), ((((0, "0"),), "z1"), ("s",), 7)),
        ((1, 2), 0, ("s",), (("z0", "z1"), (), 7)),
        ((1, 2), 1e-9, ("s",), (("z0", "z1"), (), 7)),
        ((1, 2), 9, (), (("z0", "z1"), (), 7)),
        ((0, 0), 0, (), ((), (), 10)),
        ((0, -1), 0, (), ((), (), 10)),
    ],
)
def test_no_more_is_written_than_makes_a_bound_smaller(
    monkeypatch, gains, of_split, split, expected
):
    asked = []
    terms = MadeUpTerms(gains, split, of_split)
    monkeypatch.setattr(step_search, "slow_columns", lambda drive: [0, 1])
    monkeypatch.setattr(step_search, "search_split", lambda *parts: asked.append(parts) or split)
    monkeypatch.setattr(step_search, "search_steps", lambda terms: ("z0", "z1"))

    def of(*parts):
        asked.append(parts)
        return terms

    def without(terms, parts):
        assert parts == {}
        return MadeUpTerms(gains, (), of_split)

    monkeypatch.setattr(step_search, "SlowTerms", SimpleNamespace(of=of))
    monkeypatch.setattr(step_search, "replace", without)
    period = SimpleNamespace(drive="drive")
    found = step_search.by_rates(period, "bounds", 5, ("X", "U"), flint.arb(10))
    slow, parts, bound = expected
    assert (found.slow, found.split) == (slow, parts)
    assert float(found.bound) == pytest.approx(bound, abs=1e-8)
    assert asked == [("bounds", "X", "U"), (period, "bounds", 5, "X", "U", split)]
    monkeypatch.setattr(step_search, "slow_columns", lambda drive: [])
    none = step_search.by_rates(period, "bounds", 5, ("X", "U"), flint.arb(10))
    assert (none.slow, none.split, float(none.bound), len(asked)) == ((), (), 10, 2)


@pytest.mark.parametrize(
    ("texts", "reason"),
    [
        ((("1", "2", "3"), ("4", "5", "6")), ""),
        ((("0.5", "0.5", "0.5"), ("0.5", "0.5", "0.5")), ""),
        ((("1", "2", "3"),), "two bounds"),
        ((("1", "2", "3"),) * 3, "two bounds"),
        ((("1", "2"), ("4", "5", "6")), "two bounds"),
        ((("1", "2", "3"), ("4", "5", "6", "7")), "two bounds"),
        ((("-0.5", "2", "3"), ("4", "5", "6")), "negative"),
        ((("1", "2", "3"), ("4", "5", "-0.5")), "negative"),
        ((("1", "20", "3"), ("4", "5", "6")), "not above"),
        ((("1", "2", "3"), ("4", "5", "60")), "not above"),
        ((("7", "2", "3"), ("4", "5", "6")), "not above"),
    ],
)
def test_both_parts_of_a_loop_are_bounded_by_positive_numbers(monkeypatch, texts, reason):
    """Of images that are 1/10 less, of what is 7 and more as much or more."""

    def image(v):
        return [flint.arb(x if x >= 7 else x - flint.fmpq(1, 10)) for x in v]

    asked = []
    made = SimpleNamespace(
        slow_image=image,
        fast_image=lambda slow, v: asked.append(slow) or image(v),
        parts=lambda slow, fast: (slow, fast),
    )
    monkeypatch.setattr(superposition, "SplitLoop", SimpleNamespace(of=lambda *parts: made))
    monkeypatch.setattr(superposition, "_may_split", lambda bounds: bounds.may)
    bounds = SimpleNamespace(drive=SimpleNamespace(n=2), may=True)
    if reason:
        with pytest.raises(NoCertificate, match=reason):
            superposition.split_from(bounds, "X", texts)
        return
    slow, fast = superposition.split_from(bounds, "X", texts)
    assert [tuple(map(float, v)) for v in (slow, fast)] == [tuple(map(float, t)) for t in texts]
    assert asked == [slow]
    bounds.may = False
    with pytest.raises(NoCertificate, match="no term is a function"):
        superposition.split_from(bounds, "X", texts)


@pytest.mark.parametrize("split", [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("slow", [(False, False), (True, False), (True, True)])
def test_rates_are_premises_where_a_proof_uses_them(monkeypatch, slow, split):
    """Of terms that act and have one; of those that are split also what they depend on."""
    still = SimpleNamespace(by_states=(0, 0), jump=0)
    follows = SimpleNamespace(by_states=(0, 1), jump=0)
    jumps = SimpleNamespace(by_states=(0, 1), jump=2)
    slowness = [still, follows, jumps, None, follows, follows]
    u = SimpleNamespace(
        tau=(1.0, 2.0, 1.0, 1.0, 0.0, 1.0),
        slowness=lambda k: slowness[k],
        acts=lambda k: k != 5,
    )
    system = SimpleNamespace(
        plant=SimpleNamespace(uncertainty=u, n=2), settings=SimpleNamespace(duration=3)
    )
    term = SimpleNamespace(k=1)
    monkeypatch.setattr(rate_premise, "uncertain_terms", lambda system: [term])
    monkeypatch.setattr(rate_premise, "random_points", lambda *parts: "points")
    monkeypatch.setattr(
        rate_premise._Rate, "premise", lambda self, *parts: (self.k, self.of_states, *parts)
    )
    proofs = [SimpleNamespace(slow=a, split=b) for a, b in zip(slow, split, strict=True)]
    found = list(rate_premise.rate_premises(system, proofs))
    expected = [
        (0, False, None, "points"),
        (1, any(split), term, "points"),
        (2, False, None, "points"),
    ]
    assert found == (expected if any(slow) else [])


@pytest.mark.parametrize("formula", ["sign", "tan", "smooth"])
@pytest.mark.parametrize("slopes", [(True, True), (True, False), (False, False)])
@pytest.mark.parametrize("exceeded", [None, "there"])
@pytest.mark.parametrize(("jump", "fast"), [(0, 0), (1, 0), (0, 1)])
def test_what_is_known_of_a_rate(monkeypatch, formula, slopes, exceeded, jump, fast):
    """Which premise is proven, checked, assumed or contradicted."""
    x = sympy.Symbol("x")
    formulas = {"sign": sympy.sign(x), "tan": sympy.tan(x), "smooth": sympy.sin(x)}
    slowness = SimpleNamespace(rate=1.0, by_states=(), jump=jump, dwell=2.0, fast=fast)
    system = SimpleNamespace(plant=SimpleNamespace(states=()))
    rate = rate_premise._Rate(system, 1, slowness, of_states=False)
    made = [
        (f"of {i}", SimpleNamespace(proven=proven, exceeded=lambda points: exceeded), "key")
        for i, proven in enumerate(slopes)
    ]
    monkeypatch.setattr(rate_premise._Rate, "_slopes", lambda self, term: made)
    monkeypatch.setattr(rate_premise._Rate, "_broken", lambda self, *parts: parts)
    term = SimpleNamespace(zero=False, formula=formulas[formula])
    found = rate.premise(term, "points")
    proven = all(slopes)
    if formula == "smooth" and not proven and not (jump or fast) and exceeded:
        which = slopes.index(False)
        assert found == ("rate of w_2", f"of {which}", made[which][1], "key", "there")
        return
    assert found.name == "rate of w_2"
    if formula == "sign":
        expected = ASSUMED if jump or fast else CONTRADICTED
    elif formula == "tan":
        expected = ASSUMED
    else:
        expected = PROVEN if proven else ASSUMED if jump or fast else CHECKED
    assert found.status == expected

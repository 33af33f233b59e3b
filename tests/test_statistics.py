"""Statistics of ensembles on arrays that are known, without a run."""

import math
import pickle
from collections import Counter

import numpy as np
import pytest

from certrack.studies.ensembles.member_table import MemberTable
from certrack.studies.ensembles.statistics import (
    BAND_BINS,
    BAND_BITS,
    FINEST_OCTAVE,
    LEVELS,
    WORST_MEMBERS,
    Bands,
    Statistics,
    Tally,
    _distinct,
    bin_values,
    binomial_interval,
)


def bands(values, centre=0.0, scale=1.0):
    made = Bands(np.full((2, 3), centre), np.full(2, scale))
    made.observe(1, 2, np.asarray(values, dtype=float))
    return made


def statistics(values, first=0):
    """Statistics of members whose only metric is `values`, with the bands filled too."""
    made = Statistics(bands(values), {"tail_error": Tally()})
    made.metrics["tail_error"].observe(np.asarray(values, dtype=float))
    made.members, made.violations = len(values), sum(v > 1 for v in values)
    made.outcomes = Counter(finished=len(values))
    made.observe_worst(np.asarray(values, dtype=float), first)
    return made


def test_bins_are_symmetric_and_their_middles_increase():
    values = bin_values()
    assert len(values) == BAND_BINS - 1
    np.testing.assert_array_equal(values, -values[::-1])
    assert values[-1] == math.inf
    assert np.all(np.diff(values[1:-1]) > 0)
    half = 2.0 ** -(FINEST_OCTAVE + BAND_BITS + 1)
    assert values[len(values) // 2] == pytest.approx(half)


@pytest.mark.parametrize("count", [1, 2, 3, 20, 100, 101])
def test_quantiles_are_order_statistics(count):
    """The smallest value with F >= level, at every level, also where level times count is whole."""
    values = np.random.default_rng(count).permutation(np.arange(1.0, count + 1))
    tally = Tally()
    tally.observe(values)
    found = bands(values).quantiles(LEVELS)[:, 1, 2]
    for level, band in zip(LEVELS, found, strict=True):
        exact = np.quantile(values, level, method="inverted_cdf")
        assert tally.quantile(level) == pytest.approx(exact, rel=2.0**-11)
        assert band == pytest.approx(exact, rel=2.0**-6)


def test_a_constant_signal_has_its_value_in_every_band():
    found = bands([3.5] * 7, centre=3.5, scale=2.0).quantiles()
    assert np.isnan(found[:, 0]).all()
    assert np.isnan(found[:, 1, :2]).all()
    assert found[:, 1, 2] == pytest.approx(np.full(len(LEVELS), 3.5), abs=2 * 2.0**-12)


def test_members_far_away_have_no_finite_quantile():
    found = bands([1e30, 1e30, 0.0]).quantiles((0.3, 0.5))[:, 1, 2]
    assert abs(found[0]) < 1e-3
    assert found[1] == math.inf


def test_summaries_of_nothing_and_of_missing_values():
    empty = Tally()
    nothing = empty.summary()
    assert nothing["min"] is nothing["max"] is nothing["50%"] is None
    assert nothing["missing"] == 0
    empty.observe(np.array([np.nan, np.inf, 2.0]))
    assert empty.summary() == {
        "min": 2.0,
        "max": 2.0,
        "missing": 2,
        **{f"{100 * level:g}%": 2.0 for level in LEVELS},
    }


def test_extremes_are_exact_and_quantiles_stay_between_them():
    tally = Tally()
    tally.observe(np.array([0.0, 0.1, 1.0001, 1.0002]))
    found = tally.summary()
    assert (found["min"], found["max"]) == (0.0, 1.0002)
    assert found["1%"] < 1e-300
    assert found["50%"] == pytest.approx(0.1, rel=2.0**-11)
    assert found["99%"] <= 1.0002


@pytest.mark.parametrize("spread", [1e-3, 1e3, 1e200])
def test_tallies_merge_in_any_order(spread):
    """Keys that are close together are counted in a table, others by a sort: the same counts."""
    values = np.exp(np.random.default_rng(0).uniform(0, math.log(1 + spread), 300))
    whole = Tally()
    whole.observe(values)
    parts = [Tally() for _ in range(4)]
    for k, part in enumerate(parts):
        part.observe(values[k::4])
    total = Tally()
    for k in (2, 0, 3, 1):
        total.merge(parts[k])
    np.testing.assert_array_equal(whole.keys, total.keys)
    np.testing.assert_array_equal(whole.counts, total.counts)
    assert whole.summary() == total.summary()
    assert whole.counts.sum() == 300
    assert np.all(np.diff(whole.keys) > 0)


@pytest.mark.parametrize(
    "keys", [[], [7], [-5, 3, -5, 2], [10**15, 10**15 + 2, 10**15], [-(10**15), 10**15]]
)
def test_different_keys_are_counted_wherever_they_lie(keys):
    """None at all, close together or far apart, of either sign."""
    found, counts = _distinct(np.array(keys, dtype=np.int64))
    assert found.tolist() == sorted(set(keys))
    assert counts.tolist() == [keys.count(key) for key in found]


def test_the_worst_members_are_the_largest_and_the_earliest():
    values = np.array([5.0, 1.0, 9.0, 9.0, math.inf, *np.linspace(0, 4, 20)])
    found = statistics(values, first=100).worst
    order = sorted(range(len(values)), key=lambda i: (-values[i], i))[:WORST_MEMBERS]
    assert found == [(values[i], 100 + i) for i in order]
    few = statistics([2.0, 3.0]).worst
    assert few == [(3.0, 1), (2.0, 0)]
    ties = statistics([1.0] * 15).worst
    assert ties == [(1.0, i) for i in range(10)]  # as many as the page says


def test_statistics_merge_as_if_they_were_one():
    values = np.random.default_rng(1).exponential(1.0, 50)
    whole, first, second = statistics(values), statistics(values[:20]), statistics(values[20:], 20)
    first.merge(second)
    assert_same(first, whole)


def assert_same(first, second):
    np.testing.assert_array_equal(first.bands.counts, second.bands.counts)
    assert first.metrics["tail_error"].summary() == second.metrics["tail_error"].summary()
    assert (first.members, first.violations) == (second.members, second.violations)
    assert first.outcomes == second.outcomes
    assert first.worst == second.worst


def test_tables_of_members_are_merged_and_packed_where_both_have_one():
    first, second = statistics([1.0, 2.0]), statistics([3.0], first=2)
    first.merge(second)  # neither has one
    assert first.table is None
    first.table, second.table = MemberTable(), MemberTable()
    first.table.add(0, np.array([[1.0, 2.0]]), np.array([0, 0]))
    second.table.add(2, np.array([[3.0]]), np.array([1]))
    first.merge(second)
    metrics, outcomes = first.table.arrays(3)
    assert (metrics.tolist(), outcomes.tolist()) == ([[1.0, 2.0, 3.0]], [0, 0, 1])
    blank = Statistics(bands([]), {"tail_error": Tally()}, table=MemberTable())
    blank.add_packed(first.packed())
    assert blank.table.arrays(3)[0].tolist() == [[1.0, 2.0, 3.0]]
    first.merge(statistics([4.0], first=3))  # the other has none
    assert first.table.arrays(3) is not None


def test_packed_statistics_are_the_same():
    values = [0.3, 2.0, 2.0, np.nan, 7.5, 1e-9]
    original, other = statistics(values), statistics([1.5, 4.0], first=6)
    original.outcomes["escaped"] = 2
    blank = Statistics(bands([]), {"tail_error": Tally()})
    blank.add_packed(original.packed())
    assert_same(blank, original)
    blank.add_packed(other.packed())
    original.merge(other)
    assert_same(blank, original)
    assert blank.metrics["tail_error"].missing == 1


def test_bands_survive_pickle_with_their_filled_bins_only():
    made = bands([0.1, -3.0, 0.1, np.nan], centre=0.5, scale=2.0)
    again = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(again.counts, made.counts)
    np.testing.assert_array_equal(again.centre, made.centre)
    np.testing.assert_array_equal(again.unit, np.full(2, 2.0 * 2.0**-FINEST_OCTAVE))
    assert len(pickle.dumps(made)) < made.counts.nbytes / 10
    again.merge(made)
    np.testing.assert_array_equal(again.counts, 2 * made.counts)


def test_wider_levels_have_wider_intervals():
    low, high = binomial_interval(3, 40)
    lower, higher = binomial_interval(3, 40, level=0.99)
    assert 0 < lower < low < 3 / 40 < high < higher < 1


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_quantiles_are_in_the_unit_of_the_signal(scale):
    found = bands([7.0, 7.0, 9.0], centre=5.0, scale=scale).quantiles((0.5, 1.0))[:, 1, 2]
    assert found - 5 == pytest.approx([2, 4], abs=(4 + scale / 4096) / 128)


def test_a_bin_of_a_metric_is_a_thousandth_of_it():
    """Of the leading ten bits: 2 to 2 + 1/512 is one bin, and what follows is another."""
    tally = Tally()
    tally.observe(np.array([2.0, 2 + 0.9 / 512, 2 + 1 / 512, 2 + 2.1 / 512]))
    assert tally.counts.tolist() == [2, 1, 1]
    assert tally.values == pytest.approx([2 + 0.5 / 512, 2 + 1.5 / 512, 2 + 2.1 / 512])


def test_the_interval_of_no_member_is_exact():
    """(1 - p)^10 = 0.025 where none of ten is counted; of all ten it is the mirror image."""
    edge = 1 - 0.025**0.1
    assert binomial_interval(0, 10) == pytest.approx((0, edge))
    assert binomial_interval(10, 10) == pytest.approx((1 - edge, 1))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("scale", [1.0, 8.0])
def test_every_value_of_a_band_is_within_half_a_bin(sign, scale):
    values = sign * scale * np.append(np.geomspace(1e-7, 1e6, 300), [0.0, 2.0**-18])
    for v in values:
        (found,) = bands([v], scale=scale).quantiles((0.5,))[:, 1, 2]
        assert abs(found - v) <= (abs(v) + scale / 4096) / 128 * (1 + 1e-5)


def test_a_band_ends_with_its_last_octave():
    """y = 1 + 4096 |v| below 2^36; the bin before that is the last finite one."""
    edge = 2.0**24
    for v, finite in ((edge * (1 - 2.0**-5), True), (edge * 1.01, False), (1e300, False)):
        for sign in (1, -1):
            (found,) = bands([sign * v]).quantiles((0.5,))[:, 1, 2]
            assert math.isfinite(found) == finite
            assert finite or found == sign * math.inf


def test_the_worst_of_several_merges_are_the_worst_of_all():
    draw = np.random.default_rng(5)
    parts = [draw.integers(0, 12, 17).astype(float) for _ in range(4)]
    whole = statistics(np.concatenate(parts))
    merged = statistics(parts[2], first=34)
    for k in (3, 0, 1):
        merged.merge(statistics(parts[k], first=17 * k))
    assert merged.worst == whole.worst
    merged.merge(statistics(parts[0]))  # the same members once more are not two
    assert merged.worst == whole.worst


def test_what_is_packed_are_the_filled_bins_and_plain_numbers():
    made = statistics([0.5, 2.0, 2.0, np.nan])
    arrays = made.packed()
    filled = np.flatnonzero(made.bands.counts.ravel())
    assert np.cumsum(arrays["bins"].astype(int)).tolist() == filled.tolist()
    assert arrays["counts"].tolist() == [1, 2, 1] and arrays["totals"].tolist() == [4, 2]
    assert arrays["outcomes"].tolist() == ["finished"]
    assert arrays["outcome_counts"].tolist() == [4]
    assert arrays["tail_error_extremes"].tolist() == [0.5, 2.0, 1.0]
    assert arrays["tail_error_counts"].tolist() == [1, 2]
    assert sorted(arrays["worst_members"].tolist()) == [0, 1, 2]  # no number is no member

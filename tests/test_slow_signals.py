"""What rates, jumps and fast parts admit, against the sums that bound it: on the kernels."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import flint
import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import linprog
from test_slow import axis

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.apart import largest_apart
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.proof import _bounds, cells_of, periods_needed
from certrack.certificates.implemented.slow import SlowTerms, as_function
from certrack.certificates.implemented.step_search import by_rates, search_steps


@cache
def loop():
    """Period, bounds, doublings, (X, U) and the bound without rates of an axis with a rate."""
    with flint.ctx.workprec(DRIVE_BITS):
        drive = drive_of(axis(rate=[0, 0.5]))
        period = one_period(drive, cells_of(drive))
        doublings = periods_needed(period)
        bounds = _bounds(period, doublings)
        X, U = bounds.search()
        claimed = [flint.arb(v) for v in X], flint.arb(U)
        return period, bounds, doublings, claimed, bounds.image(*claimed)[0]


def with_slow(rate=0.0, jump=0.0, dwell=1.0, fast=0.0):
    """The same for another w."""
    exact = [flint.fmpq(round(v * 10**9), 10**9) for v in (rate, jump, dwell, fast)]
    period, bounds, *others = loop()
    (uncertain,) = period.drive.uncertain
    slow = replace(uncertain.slow, rate=exact[0], jump=exact[1], fast=exact[3])
    slow = replace(slow, dwell=exact[2] if jump else None)
    drive = replace(period.drive, uncertain=(replace(uncertain, slow=slow),))
    return replace(period, drive=drive), replace(bounds, drive=drive), *others


def bound(**values):
    with flint.ctx.workprec(DRIVE_BITS):
        return float(by_rates(*with_slow(**values)).bound)


def measured(apart=0, **values):
    """Kernel over the ages of cells, newest first; TV, area, jumps and the gain of a row."""
    period, bounds, doublings, claimed, _ = with_slow(**values)
    with flint.ctx.workprec(DRIVE_BITS):
        terms = SlowTerms.of(period, bounds, doublings, *claimed)
        z = as_function(search_steps(terms)[0], terms.responses.periods)
    responses, row = terms.responses, len(terms.chosen) - 1
    old = bounds.gains.old[terms.chosen, 0]
    sums = [v[row] for v in responses.measures(0, z, old, apart)]
    lengths = responses.lengths[row].ravel()
    increments = np.diff(responses.end[row, ..., 0].ravel(), prepend=0.0)
    seen = lengths > 0
    return increments[seen], lengths[seen], sums, bounds.gains.w[terms.chosen, 0][row]


# Sums over what is apart ------------------------------------------------------------------------


@pytest.mark.parametrize("apart", [1, 2, 3, 5, 20])
def test_the_largest_sum_of_what_is_apart(apart):
    rng = np.random.default_rng(apart)
    values = rng.exponential(size=(3, 11)) * (rng.random((3, 11)) < 0.7)
    sets = [s for r in range(12) for s in combinations(range(11), r)]
    sets = [s for s in sets if all(b - a >= apart for a, b in zip(s, s[1:], strict=False))]
    expected = [max(sum(row[list(s)]) for s in sets) for row in values]
    assert largest_apart(values, apart) == pytest.approx(expected)


def test_what_comes_more_seldom_never_adds_more():
    """Not so for fixed windows: of 0 0 1 1 0 0 those of two hold 1, those of three 2."""
    values = np.abs(np.random.default_rng(1).normal(size=(4, 200)))
    sums = np.array([largest_apart(values, apart) for apart in range(1, 60)])
    assert (np.diff(sums, axis=0) <= 1e-12).all()
    assert largest_apart(np.array([[0.0, 0, 1, 1, 0, 0]]), 3).tolist() == [1.0]


# More is never less -----------------------------------------------------------------------------


def test_the_bound_never_falls_where_more_is_allowed():
    """Up to what the search for z leaves, far below what each step here makes."""
    rng, (*_, plain) = np.random.default_rng(4), loop()
    for _ in range(4):
        values = {
            "rate": 10 ** rng.uniform(-3, 1),
            "jump": float(rng.choice([0, 10 ** rng.uniform(-2, 0)])),
            "dwell": 10 ** rng.uniform(-1.5, 0.5),
            "fast": float(rng.choice([0, 0.3 * rng.random()])),
        }
        least = bound(**values)
        assert least <= float(plain)
        for name in values:
            factor = 1 + rng.random()
            more = values[name] / factor if name == "dwell" else values[name] * factor
            assert bound(**(values | {name: more})) >= least * (1 - 1e-6), (name, values)


def test_ends_of_the_scale():
    """As fast as it likes: the bound without rates. Constant: not less than a constant makes."""
    *_, plain = loop()
    assert bound(rate=1e6) == pytest.approx(float(plain), rel=1e-9)
    assert bound(fast=1.0) == pytest.approx(float(plain), rel=1e-9)
    assert bound(rate=0.0, jump=0.5, dwell=0.0049) == float(plain)  # less than a period
    assert bound(rate=0.0, jump=1e-9, dwell=0.005) == pytest.approx(bound(rate=0.0), rel=1e-4)
    increments, _, (variation, *_), _ = measured(rate=0.0)
    assert variation >= abs(increments.sum())


# Signals that try to be worse -------------------------------------------------------------------


@pytest.mark.parametrize("fast", [0.1, 0.5])
def test_a_slow_part_beyond_its_share_gains_nothing(fast):
    """Premise: |s + f| <= 1 and |f| <= fast; s may be 1 + fast, if f takes it back."""
    rate = 0.5
    kernel, lengths, (variation, area, _), gain = measured(rate=rate, fast=fast)
    kernel, lengths = (v[: len(v) // 8 * 8].reshape(-1, 8) for v in (kernel, lengths))
    kernel, lengths = kernel.sum(axis=1), lengths.sum(axis=1)  # f holds as long: no worse
    count = len(kernel)
    moves = sparse.diags([-1.0, 1.0], [0, 1], shape=(count - 1, count))
    still, one = sparse.csr_matrix((count - 1, count)), sparse.eye(count)
    A = sparse.bmat([[moves, still], [-moves, still], [one, one], [-one, -one]])
    steps = rate * (lengths[1:] + lengths[:-1]) / 2
    limits = np.concatenate([steps, steps, np.ones(2 * count)])
    ends = [(None, None)] * count + [(-fast, fast)] * count
    solved = linprog(-np.tile(kernel, 2) / np.abs(kernel).sum(), A_ub=A, b_ub=limits, bounds=ends)
    reached = -solved.fun * np.abs(kernel).sum()
    allowed = (1 - fast) * variation + rate * area + fast * gain
    assert 0.9 * allowed <= reached <= allowed


def test_steep_changes_that_are_over_for_a_while_are_jumps():
    """Ramps of any length, of which each adds up to the jump, `dwell` from end to begin."""
    jump, dwell = 0.5, 0.3
    T = float(loop()[0].drive.T)
    kernel, lengths, (variation, _, jumps), _ = measured(
        int(dwell / T + 1e-9), jump=jump, dwell=dwell
    )
    ages = np.cumsum(lengths) - lengths / 2
    allowed, rng, reached = variation + jump * jumps, np.random.default_rng(2), 0.0
    for _ in range(400):
        length = rng.choice([0.0, 0.02, 0.2]) * rng.random()
        knots, values, age = [0.0], [rng.uniform(-1, 1)], rng.random() * dwell
        while age < ages[-1]:
            goal = np.clip(-np.sign(values[-1]) * 0.25, values[-1] - jump, values[-1] + jump)
            knots += [age, age + length + 1e-9]
            values += [values[-1], float(goal)]
            age += length + 1e-9 + dwell
        reached = max(reached, abs(kernel @ np.interp(ages, knots, values)))
    assert 0.3 * allowed <= reached <= allowed


def test_a_z_that_is_no_number_is_refused():
    with pytest.raises(NoCertificate, match="range of floating point"):
        as_function(((0, "1e400"),), 5)

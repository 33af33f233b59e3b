"""Steps between two events of a sampled loop, with maps that are known; parts of its controller."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import sympy

from certrack.core.expressions import symbol
from certrack.integrators.base import ESCAPING, Outcome
from certrack.integrators.sampled.run import SampledRun
from certrack.integrators.sampled.step_control import (
    FIRST_MAX_FACTOR,
    MAX_FACTOR,
    MAX_INTERVAL_STEPS,
    next_factor,
)
from certrack.loops.controller import PERIOD, _hold_entries, _weighted, forgetting_rates


class Maps:
    """x' = u and total' = 1, exact; the error is (h/longest)^9 of the member, or what it says."""

    def __init__(self, longest):
        self.longest, self.calls = np.array(longest, dtype=float), 0
        self.shortest = math.inf

    def step(self, t, h, allowed, x, u, totals, p):
        self.calls += 1
        longest = p[0]
        self.shortest = min(self.shortest, float(np.min(h)))
        error = np.where(np.isfinite(longest), (h / np.abs(longest)) ** 9, math.nan)
        return x + h * u, totals + h, error


def run_of(longest, u=None, x=None, max_state=1e6):
    """A run of members with their longest steps, between two events."""
    count = len(longest)
    run = object.__new__(SampledRun)
    run._maps = Maps(longest)
    run._problem = SimpleNamespace(tolerance=1e-6, max_state=max_state)
    run.allowed = 1e-7
    run.x = np.zeros((1, count)) if x is None else np.array([x], dtype=float)
    run.totals = np.zeros((1, count))
    run.u = np.ones(count) if u is None else np.array(u, dtype=float)
    run.parameters = np.array([longest], dtype=float)
    run.alive = np.ones(count, dtype=bool)
    run.run_alone = np.zeros(count, dtype=bool)
    run.outcomes = np.full(count, Outcome.finished, dtype=object)
    return run


def crossed(run, begin=1.0, end=2.0, on_step=None):
    run._cross(begin, end, on_step)
    return run.x[0]


@pytest.mark.parametrize("longest", [[10.0], [0.3], [0.3, 0.01], [10.0, 0.02, 0.4, 7.0, 0.05]])
def test_every_member_crosses_by_its_own_steps(longest):
    u = np.arange(1.0, 1 + len(longest))
    run = run_of(longest, u)
    assert crossed(run) == pytest.approx(u)
    assert run.totals[0] == pytest.approx(np.ones(len(longest)))
    assert (run.outcomes == Outcome.finished).all() and not run.run_alone.any()


def test_a_member_does_not_depend_on_its_neighbours():
    alone = [crossed(run_of([longest]))[0] for longest in (0.3, 0.011)]
    assert list(crossed(run_of([0.3, 0.011]))) == alone


def test_a_member_without_an_error_is_lost_and_the_others_go_on():
    run = run_of([math.nan, 0.1, math.nan, 0.3], x=[0, 0, 2 * ESCAPING, 0])
    found = crossed(run)
    assert np.isnan(found[[0, 2]]).all() and found[[1, 3]] == pytest.approx([1, 1])
    outcomes = list(run.outcomes)
    assert outcomes == [Outcome.undefined, Outcome.finished, Outcome.escaped, Outcome.finished]
    assert list(run.run_alone) == [True, False, False, False]
    assert np.isnan(run.totals[0, 0]) and run.totals[0, 1] == pytest.approx(1)


def test_a_member_that_needs_too_many_steps_says_so():
    run = run_of([1e-5, 0.3])
    assert MAX_INTERVAL_STEPS < 1e5
    found = crossed(run)
    assert np.isnan(found[0]) and found[1] == pytest.approx(1)
    assert list(run.outcomes) == [Outcome.step_limit, Outcome.finished]
    assert list(run.run_alone) == [True, False]
    assert run._maps.calls == MAX_INTERVAL_STEPS + 1


@pytest.mark.parametrize("u", [2e6, -2e6, math.nan, math.inf])
def test_an_input_beyond_all_states_is_the_controllers(u):
    run = run_of([math.nan], u=[u], max_state=1e6)
    crossed(run)
    assert list(run.outcomes) == [Outcome.controller_diverged]
    run = run_of([math.nan], u=[1e6], max_state=1e6)
    crossed(run)
    assert list(run.outcomes) == [Outcome.undefined]


@pytest.mark.parametrize(("longest", "steps"), [(10.0, (1, 1)), (0.3, (4, 9)), (0.01, (100, 150))])
def test_steps_of_a_lone_member_are_told(longest, steps):
    seen = []
    run = run_of([longest])
    crossed(run, on_step=lambda t, x, totals, u: seen.append((t, x[0, 0], totals[0, 0], u[0])))
    times = np.array([t for t, *_ in seen])
    assert (np.diff(times) > 0).all() and times[-1] == 2.0
    assert steps[0] <= len(times) <= steps[1]
    assert [x for _, x, _, _ in seen] == pytest.approx(list(times - 1))
    assert {u for *_, u in seen} == {1.0}


def test_who_leaves_the_admitted_states_has_escaped():
    run = run_of([1.0] * 4, x=[5, -11, math.nan, 10], max_state=10)
    run.outcomes[2] = Outcome.undefined
    assert run._inside()
    assert list(run.alive) == [True, False, False, True]
    assert list(run.outcomes) == [
        Outcome.finished,
        Outcome.escaped,
        Outcome.undefined,
        Outcome.finished,
    ]
    assert np.isnan(run.x[0, 1]) and run.x[0, 3] == 10
    for state in (11, -11):
        one = run_of([1.0], x=[state], max_state=10)
        assert not one._inside()
    assert run_of([1.0], x=[-10], max_state=10)._inside()


def test_the_next_step_is_within_its_limits():
    error = np.array([0.0, 1e-30, 1.0, 1e30, math.nan, math.inf])
    found = next_factor(error, MAX_FACTOR)
    assert found[[0, 1]] == pytest.approx([MAX_FACTOR] * 2)
    assert 0.5 < found[2] < 1 and found[3:] == pytest.approx([0.1] * 3)
    assert next_factor(np.zeros(1), FIRST_MAX_FACTOR) == [FIRST_MAX_FACTOR]


# the controller's formulas

A, Z, X = symbol("a"), symbol("z"), symbol("x")


def test_what_is_forgotten_are_the_terms_of_gains_and_estimates():
    """Of -a (z - 1) + x z: -a z + a; a term that has every name, and one that has none."""
    rates = [-A * (Z - 1) + X * Z, X, -A * Z, sympy.Integer(3) + X]
    assert forgetting_rates(rates, {A, Z}) == [-A * Z + A, 0, -A * Z, 3]
    assert forgetting_rates([-A * Z], {A}) == [0]


def test_entries_of_the_hold_are_where_estimates_reach_each_other():
    chain = (A, A, sympy.S.Zero, sympy.S.Zero, A, A, sympy.S.Zero, sympy.S.Zero, A)
    upper = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    assert _hold_entries(chain, 3) == upper
    assert _hold_entries((sympy.S.Zero,) * 4, 2) == ()
    ring = (0, 1, 0, 0, 0, 1, 1, 0, 0)
    assert len(_hold_entries(tuple(map(sympy.Integer, ring)), 3)) == 9


def test_weights_of_the_rates():
    assert _weighted([X, Z], ()) == [PERIOD * X, PERIOD * Z]
    w = {at: symbol("ctl_hold_{}_{}".format(*at)) for at in ((0, 0), (0, 1), (1, 1))}
    assert _weighted([X, Z], tuple(w)) == [w[0, 0] * X + w[0, 1] * Z, w[1, 1] * Z]

"""What is remembered, and for whom."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import certrack
from certrack.certificates.arithmetic import rational
from certrack.certificates.formulation import error_problem
from certrack.core.memo import MAX_REMEMBERED, remembered
from certrack.core.rationals import nearest_float
from certrack.model.disturbance import DisturbanceFamily, register_disturbance
from certrack.studies.ensembles.engine import Engine, compute_chunk
from certrack.studies.ensembles.members import Members, members_of
from certrack.studies.ensembles.plan import make_plan


def test_equal_arguments_are_computed_once_and_old_ones_forgotten():
    calls = []

    @remembered
    def pair(x, *, more=0):
        """A pair."""
        calls.append(x)
        if x == 13:
            raise ValueError("unlucky")
        return (x, more)

    assert [pair(1), pair(1), pair(1, more=1)] == [(1, 0), (1, 0), (1, 1)]
    assert calls == [1, 1]
    assert pair.__doc__ == "A pair."
    assert [pair([1]), pair([1])] == [([1], 0)] * 2  # no hash: computed every time
    assert len(calls) == 4
    for _ in range(2):
        with pytest.raises(ValueError, match="unlucky"):
            pair(13)
    assert len(calls) == 6
    for x in range(100, 100 + MAX_REMEMBERED):
        pair(x)
    pair(1)
    assert calls[-1] == 1


def test_members_of_another_seed_are_those_of_new_members():
    system = certrack.load("example1")
    for seed in (3, 0, 4):
        found, expected = members_of(system, seed), Members(system, seed)
        assert found.seed == seed
        assert found.member(2) == expected.member(2)
        for name, values in expected.draws(0, 8).items():
            assert np.array_equal(found.draws(0, 8)[name], values)
    assert members_of(system, 3).loop is members_of(certrack.load("example1"), 5).loop
    assert members_of(system, 3).member(2) != members_of(system, 4).member(2)


def test_the_second_ensemble_of_a_system_proves_and_simulates_nothing(monkeypatch):
    system = certrack.load("example1").replace(title="a system of this test")
    first = certrack.ensemble(system, 8, method="lockstep")

    def refuse(*_, **__):
        raise AssertionError("computed again")

    monkeypatch.setattr("certrack.studies.ensembles.error_limit.best_sound_bound", refuse)
    monkeypatch.setattr("certrack.studies.ensembles.plan.simulate", refuse)
    again = certrack.ensemble(system, 8, seed=1, method="lockstep")
    assert again.limit == first.limit
    assert again.statistics.worst != first.statistics.worst
    with pytest.raises(AssertionError, match="computed again"):
        certrack.ensemble(system.replace(title="another"), 8, method="lockstep")


def test_what_is_proven_of_a_float_is_not_recalled_for_a_rational_beside_it():
    """1/3 and its float are one number to NumPy, and two systems to a proof."""
    third = nearest_float(Fraction(1, 3))
    equal, unequal = third == 1 / 3, third != 1 / 3
    assert unequal and not equal
    assert third == nearest_float(Fraction(1, 3)) and hash(third) == hash(1 / 3)
    base = certrack.load("dual-motor-lean")

    def with_strength(tau):
        uncertainty = replace(base.plant.uncertainty, tau=(0, tau, 0, 1))
        return base.replace(plant=replace(base.plant, uncertainty=uncertainty))

    exact, rounded = with_strength("1/3"), with_strength(1 / 3)
    assert exact != rounded and exact == with_strength("1/3")
    recalled = remembered(lambda system: error_problem(system, rational))
    assert recalled(exact).Ua.tolist() != recalled(rounded).Ua.tolist()


def test_a_family_that_is_registered_anew_is_the_one_that_is_drawn():
    """Its name in the system stays the same, so systems are equal; chunks of workers, too."""

    def register(pattern):
        class Family(DisturbanceFamily):
            kind = "taken_anew"

            def numbers(self, population):
                return {"rate": certrack.Distribution("uniform", (0.1, 1.0))}

            def pattern(self, number):
                return pattern(number("rate"))

        register_disturbance(Family)

    register(lambda rate: f"exp(-{rate}*t)")
    population = certrack.Population(disturbance="taken_anew")
    system = certrack.load("example1").replace(population=population).with_settings(duration=1)
    plan = make_plan(system, 0, 1e-6, None, "alone")
    first = members_of(system, 0).member(0)
    chunk, _ = compute_chunk(plan, 0, 2)
    register(lambda rate: f"-exp(-{rate}*t)")
    assert members_of(system, 0).member(0) == Members(system, 0).member(0) != first
    other, _ = compute_chunk(plan, 0, 2)
    wanted = Engine(plan).compute(0, 2).packed()
    for name, values in wanted.items():
        assert np.array_equal(other[name], values)
    assert any(not np.array_equal(chunk[name], values) for name, values in wanted.items())

"""No state leaves what one quadratic function says of it, whatever constants and inputs do."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from depth import depth
from hypothesis import given, settings
from hypothesis import strategies as st
from test_ranges import random_system
from varying_attack import VaryingLoop, Wave

import certrack
from certrack.certificates import NoCertificate
from certrack.certificates.exact import from_text
from certrack.certificates.ranges.proofs import RangeProver
from certrack.certificates.ranges.tube import range_tube
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.linear.search import continuous_case

#: Of the references of random systems.
WAVE = Wave(0.3, 0.7)


class Energy:
    """2 V and what bounds it along every motion, from any start."""

    def __init__(self, system, proof):
        first = proof.points[0]
        self.P = np.array([[float(from_text(v)) for v in row] for row in first.P])
        self.alpha = float(from_text(first.alpha))
        self.floor = float(from_text(proof.bound)) ** 2

    def of(self, e):
        """2 V of states (rows)."""
        return np.einsum("ti,ij,tj->t", e, self.P, e)

    def ratio(self, t, e):
        """The largest 2 V over its bound."""
        start = self.of(e[:1])[0]
        bound = start * np.exp(-self.alpha * t) - self.floor * np.expm1(-self.alpha * t)
        return float((self.of(e)[1:] / bound[1:]).max())


def errors_of(loop, run, reference):
    """e along a run of the plant."""
    c = loop.coordinates
    Y = reference.values(run.t, c.q)
    return (c.A.astype(float) @ run.x - c.B.astype(float) @ Y).T


def beyond(values, bounds):
    """The largest value over its bound, after the start: both may be 0 there."""
    return float((np.abs(values[1:]) / bounds[1:]).max())


def attacked(seed, growth=False):
    """The largest 2 V, |e_1| over the tube, and states over their bounds; None without a proof."""
    rng = np.random.default_rng([seed, 7])
    system = random_system(rng, states=5, constants=4)
    if growth:
        u = system.plant.uncertainty
        gamma = [0] * (system.plant.n - 1) + [float(rng.integers(1, 20)) / 100]
        changed = replace(u, gamma=gamma)
        system = system.replace(plant=replace(system.plant, uncertainty=changed))
    try:
        prover = RangeProver(system)
    except NoCertificate:
        return None
    proof = prover.vertices(prover.box)
    if proof is None:
        return None
    x0 = np.round(rng.normal(size=system.plant.n) * rng.choice([0, 0.1, 1]), 2)
    system = system.with_settings(x0=x0.tolist())
    return [
        *by_ascent(system, prover.loop, proof, rng, growth),
        *([] if growth else by_runs(system, prover, proof)),
    ]


def by_ascent(system, loop, proof, rng, growth):
    """Constants and inputs that jump, chosen to drive e_1 or a state as far as they can."""
    energy, tube = Energy(system, proof), range_tube(system, proof)
    points = list(itertools.product(*loop.box))
    nominal = np.linalg.eigvals(loop.coordinates.error_matrix.astype(float))
    n, steps = loop.n, 120
    step = min(0.05 / float(-nominal.real.max()), 2 / float(np.abs(nominal).max()))
    varying = VaryingLoop(loop, points, step, WAVE, growing=growth)
    t = step * np.arange(steps + 1)
    inverse = np.linalg.inv(energy.P)
    worst = []
    for target in range(2):
        output = np.zeros(n + 3)
        output[:n] = [1, *[0] * (n - 1)] if target == 0 else loop.Xe.astype(float)[n - 1]
        for sign in (1, -1):
            z = varying.start(np.array(system.settings.x0), 0.0)
            e = varying.ascent(z, sign * output, steps, rng, rounds=5)[:, :n]
            size = np.sqrt(np.einsum("i,ij,j->", output[:n], inverse, output[:n]))
            worst.append(energy.ratio(t, e))
            worst.append(beyond(e[:, 0], tube(t)))
            worst.append(beyond(e @ output[:n], size * tube(t)))
    return worst


def by_runs(system, prover, proof):
    """The plant's own equations at corners, and under the linear programs' references."""
    loop, energy, tube = prover.loop, Energy(system, proof), range_tube(system, proof)
    worst = []
    for point in list(itertools.product(*prover.box))[:4]:
        values = {str(s): float(v) for s, v in zip(loop.symbols, point, strict=True)}
        run = certrack.simulate(
            system.replace(truth=replace(system.truth, constants=values)).with_settings(duration=12)
        )
        worst.append(energy.ratio(run.t, errors_of(loop, run, system.reference)))
        worst.append(beyond(run.e[0], tube(run.t)))
    if not loop.brackets:
        case = continuous_case(system, tuple(reference_bounds(system, loop.coordinates.q + 1)))
        if case is not None:
            run = case.run
            worst.append(energy.ratio(run.t, errors_of(loop, run, case.system.reference)))
    return worst


@pytest.mark.parametrize("seed", [4, 8])
def test_no_state_leaves_the_tube(seed):
    rng = np.random.default_rng([seed, 8])
    system = random_system(rng, states=2, constants=2)
    prover = RangeProver(system)
    proof = prover.vertices(prover.box)
    assert 0.8 < max(by_ascent(system, prover.loop, proof, rng, False)) <= 1
    assert 0.7 < max(by_runs(system, prover, proof)) <= 1


@pytest.mark.slow
@given(st.integers(0, 10**6), st.booleans())
@settings(max_examples=depth(10, 100), deadline=None)
def test_no_state_of_a_random_chain_leaves_the_tube(seed, growth):
    found = attacked(seed, growth)
    assert found is None or max(found) <= 1 + 1e-9


def test_the_attack_beats_a_tube_that_is_too_small():
    """What is proven for the nominal constants alone does not hold for all."""
    rng = np.random.default_rng([4, 8])
    system = random_system(rng, states=2, constants=2)
    prover = RangeProver(system)
    loop = prover.loop
    proof = prover.vertices(prover.box)
    assert max(by_ascent(system, loop, proof, rng, False)) <= 1
    values = dict(zip(map(str, loop.symbols), loop.nominal, strict=True))
    ranges = {name: [f"0.99999*{v}", f"1.00001*{v}"] for name, v in values.items()}
    narrow = system.replace(plant=replace(system.plant, constant_ranges=ranges))
    other = RangeProver(narrow)
    assert max(by_ascent(narrow, loop, other.vertices(other.box), rng, False)) > 1

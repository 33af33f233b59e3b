"""The adversary's parts write the same into a system as into the compiled loop."""

from dataclasses import replace

import numpy as np
import pytest

import certrack
from certrack.studies.falsifier.loop import AdversarialLoop


def with_ranges():
    base = certrack.load("example1")
    ranges = {"input_gain_range": (1.5, 2.5), "theta_range": ((1.0, 2.5),)}
    return base.replace(plant=replace(base.plant, **ranges))


SYSTEMS = {
    "bent reference, gain, theta": with_ranges(),
    "sine, four states": certrack.load("dual-motor-lean"),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_case_written_out_is_the_one_that_was_scored(name):
    """Every gene away from its plausible start, so that none may be forgotten in either place."""
    loop = AdversarialLoop(SYSTEMS[name])
    genes = loop.adversary.genes
    rng = np.random.default_rng(3)
    low, high = np.array([(gene.low, gene.high) for gene in genes]).T
    soft = np.where(high == 30.0, 0.05, 1.0)  # hard patterns are rough to integrate
    table = (
        (low + high) / 2 + soft * (rng.uniform(low, high, (3, len(genes))) - (low + high) / 2)
    ).T
    scores = loop.errors(table)
    for score, column in zip(scores, table.T, strict=True):
        exact = certrack.simulate(loop.case(column), tolerance=1e-9).metrics.tail_error
        assert score == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_gene_changes_the_loop(name):
    loop = AdversarialLoop(SYSTEMS[name])
    middle = np.array([gene.middle for gene in loop.adversary.genes])
    for i, gene in enumerate(loop.adversary.genes):
        moved = middle.copy()
        moved[i] += 0.2 * (gene.high - gene.low)
        assert certrack.to_text(loop.case(moved)) != certrack.to_text(loop.case(middle)), gene.name
        assert loop.errors(moved[:, None]) != loop.errors(middle[:, None]), gene.name


def test_plausible_starts_are_within_the_ranges():
    adversary = AdversarialLoop(SYSTEMS["bent reference, gain, theta"]).adversary
    low, high = np.array([(gene.low, gene.high) for gene in adversary.genes]).T
    starts = adversary.plausible_starts()
    assert np.all((low <= starts) & (starts <= high))
    frequencies = starts[:, [gene.name for gene in adversary.genes].index("adv_w0")]
    assert len(set(frequencies)) == 4

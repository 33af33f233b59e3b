"""The kit of a distribution."""

from __future__ import annotations

import numpy as np

from certrack.model.distribution import Distribution, as_distribution
from certrack.model.population import Population
from certrack.systems.reader import load, loads
from certrack.systems.writer import to_text

#: Probabilities at which a distribution is looked at.
LOOKED_AT_PROBABILITIES = 1001


class DistributionConformance:
    """Tests that every distribution passes, such as one of your measurements.

    Attributes
    ----------
    distribution : Distribution
    samples : numbers, optional
        What it was fitted to: its quantiles must be near theirs.
    """

    distribution: Distribution
    samples: tuple[float, ...] = ()

    def test_values_increase_between_its_ends(self) -> None:
        """From low to high, both of which are reached."""
        p = np.linspace(0, 1, LOOKED_AT_PROBABILITIES)
        values, (low, high) = (
            self.distribution.quantile(p),
            (
                self.distribution.low,
                self.distribution.high,
            ),
        )
        assert low <= high
        assert values.shape == p.shape
        assert np.all(np.isfinite(values))
        assert np.all(np.diff(values) >= 0), "a larger probability has a smaller value"
        np.testing.assert_allclose(values[[0, -1]], [low, high], rtol=1e-6)
        assert self.distribution.fixed == (low == high)

    def test_each_value_is_its_own(self) -> None:
        """The value at a probability does not depend on the others asked for beside it."""
        p = np.random.default_rng(0).uniform(size=7)
        together = self.distribution.quantile(p)
        alone = [self.distribution.quantile(p[i : i + 1])[0] for i in range(len(p))]
        np.testing.assert_array_equal(together, alone)

    def test_is_that_of_its_samples(self) -> None:
        """The quantiles are near those of the samples, if there are any: Kolmogorov's distance."""
        samples = np.sort(np.asarray(self.samples, dtype=float))
        if not len(samples):
            return
        p = np.linspace(0, 1, LOOKED_AT_PROBABILITIES)[1:-1]
        values = self.distribution.quantile(p)
        below = np.searchsorted(samples, values, side="left") / len(samples)
        up_to = np.searchsorted(samples, values, side="right") / len(samples)
        distance = np.maximum(below - p, p - up_to).max()
        assert distance <= 1.95 / np.sqrt(len(samples)) + 1e-12, f"distance {distance:.3g}"

    def test_survives_a_system_file(self) -> None:
        """As a file writes it, it is read again."""
        assert as_distribution("distribution", self.distribution.written) == self.distribution
        population = Population(x0=(self.distribution, self.distribution))
        system = load("example1").replace(population=population)
        system = system.with_settings(max_state=1e300)
        assert loads(to_text(system)).population == system.population

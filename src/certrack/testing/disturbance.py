"""The kit of a family of disturbances."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from certrack.core.expressions import TIME, parse, symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.model.distribution import Distribution
from certrack.model.disturbance import DisturbanceFamily
from certrack.model.population import Population
from certrack.studies.ensembles.ensemble import ensemble
from certrack.systems.reader import load
from certrack.testing.shared import SHORT_RUN, TRIED_MEMBERS, require_heyoka

#: Members and times at which |s_k| <= 1 is looked at; the times reach this many durations.
LOOKED_AT_MEMBERS, LOOKED_AT_TIMES, REACH = 1000, 501, 100

#: Rounding of a pattern that touches 1.
TOUCH = 1e-9


class DisturbanceConformance:
    """Tests that every family of disturbances passes.

    Attributes
    ----------
    family : DisturbanceFamily
        An instance of the registered class.
    population : Population
        What :meth:`DisturbanceFamily.numbers` is asked with.
    duration : float, s
        How far it is looked at densely.
    """

    family: DisturbanceFamily
    population: Population = Population()
    duration: float = 20.0

    def _draws(self, probabilities: np.ndarray) -> dict[str, np.ndarray]:
        """Numbers of many members, one row of probabilities per number."""
        numbers = self.family.numbers(self.population).values()
        values = [d.quantile(p) for d, p in zip(numbers, probabilities, strict=True)]
        return dict(zip(self.family.numbers(self.population), values, strict=True))

    def _patterns(self, draws: Mapping[str, np.ndarray], t: np.ndarray) -> np.ndarray:
        """s_k of the members (rows) at the times (columns)."""
        names = list(draws)
        text = self.family.pattern(lambda name: name)
        formula = parse("pattern", text, ["t", *names]).expr
        evaluate = numpy_callable([TIME, [symbol(name) for name in names]], [formula])
        members = np.array(list(draws.values())).T.reshape(-1, len(names))
        with np.errstate(all="ignore"):  # what is not finite is not within 1
            return np.array([rows(evaluate(t, member), len(t))[0] for member in members])

    def _random(self, members: int, seed: int = 0) -> dict[str, np.ndarray]:
        count = len(self.family.numbers(self.population))
        return self._draws(np.random.default_rng(seed).uniform(size=(count, members)))

    def test_numbers_are_distributions(self) -> None:
        """By names that may stand in a formula, and the same whenever they are asked for."""
        numbers = self.family.numbers(self.population)
        for name, distribution in numbers.items():
            assert name.isidentifier(), f"{name!r} is no identifier"
            assert isinstance(distribution, Distribution), f"{name} is no Distribution"
        assert numbers == self.family.numbers(self.population)

    def test_pattern_uses_every_number(self) -> None:
        """A number that is drawn and not used is a mistake."""
        used: set[str] = set()

        def number(name: str) -> str:
            used.add(name)
            return name

        first = self.family.pattern(number)
        assert first == self.family.pattern(number), "the pattern is another one each time"
        names = set(self.family.numbers(self.population))
        assert used == names, f"drawn: {sorted(names)}, used: {sorted(used)}"
        parse("pattern", first, ["t", *names])

    def test_stays_within_one(self) -> None:
        """|s_k| <= 1 for random members and for those at the ends of their numbers, for long."""
        rng = np.random.default_rng(1)
        dense = np.linspace(0, self.duration, LOOKED_AT_TIMES)
        late = self.duration * np.geomspace(1, REACH, LOOKED_AT_TIMES)
        times = np.concatenate([dense, late])
        count = len(self.family.numbers(self.population))
        ends = self._draws(rng.integers(0, 2, (count, LOOKED_AT_MEMBERS)).astype(float))
        for draws in (self._random(LOOKED_AT_MEMBERS), ends):
            worst = np.abs(self._patterns(self.family.adjusted(draws), times)).max(initial=0)
            assert worst <= 1 + TOUCH, f"|s_k| reaches {worst:.6g}"

    def test_members_differ(self) -> None:
        """Another member has another pattern, which is not zero."""
        times = np.linspace(0, self.duration, LOOKED_AT_TIMES)
        values = self._patterns(self.family.adjusted(self._random(TRIED_MEMBERS)), times)
        assert np.abs(values).max() > 0, "no member is disturbed"
        assert len(np.unique(values, axis=0)) > 1, "every member has the same pattern"

    def test_members_do_not_depend_on_each_other(self) -> None:
        """Adjusted in parts, as workers do it, the numbers are those adjusted together."""
        draws = self._random(2 * TRIED_MEMBERS)
        together = self.family.adjusted(draws)
        assert set(together) == set(draws), "adjusted must return every number"
        first = {name: values[:TRIED_MEMBERS] for name, values in draws.items()}
        for name, values in self.family.adjusted(first).items():
            np.testing.assert_array_equal(values, together[name][:TRIED_MEMBERS])

    def test_runs_in_ensembles(self) -> None:
        """Side by side, and each by itself."""
        require_heyoka()
        system = load("example1").with_settings(duration=SHORT_RUN, tail=None)
        system = system.replace(population=Population(disturbance=self.family.kind))
        together, alone = (
            ensemble(system, TRIED_MEMBERS, method=method, limit=1.0).per_member()[0]
            for method in ("lockstep", "alone")
        )
        np.testing.assert_allclose(together, alone, rtol=1e-3, atol=1e-5)

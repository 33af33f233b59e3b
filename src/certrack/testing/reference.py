"""The kit of a reference."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.integrators.base import Outcome
from certrack.model.implementation import Implementation
from certrack.references import (
    Reference,
    check_reference,
    jumps,
    lipschitz_bound,
    pieces_at,
)
from certrack.simulation.simulator import simulate
from certrack.studies.ensembles.ensemble import ensemble
from certrack.systems.reader import load, loads
from certrack.systems.writer import to_text
from certrack.testing.shared import PERIOD_TESTED, SHORT_RUN, TRIED_MEMBERS


class ReferenceConformance:
    """Tests that every reference passes.

    Attributes
    ----------
    reference : Reference
    duration : float, s
        How far it is looked at.
    """

    reference: Reference
    duration: float = 10.0

    @property
    def _order(self) -> int:
        return int(min(self.reference.order, 3))

    @property
    def _times(self) -> np.ndarray:
        """Dense times, none of which is a break."""
        edges = [0.0, *self.reference.breaks(0.0, self.duration).tolist(), self.duration]
        inside = np.linspace(0.01, 0.99, 200)
        return np.concatenate([a + (b - a) * inside for a, b in pairwise(edges)])

    def test_keeps_the_protocol(self) -> None:
        """Registered, every member there, formulas supported and those of the values."""
        check_reference(self.reference, self._order, self.duration)

    def test_formulas_are_those_of_the_values(self) -> None:
        """Everywhere between the breaks."""
        reference, t = self.reference, self._times
        names = [TIME, reference.parameter_symbols, reference.piece_symbols]
        evaluate = numpy_callable(names, reference.formulas(self._order))
        expected = rows(evaluate(t, reference.parameter_values, pieces_at(reference, t)), len(t))
        actual = reference.values(t, self._order)
        np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-9)

    def test_every_break_is_listed(self) -> None:
        """Between two of them the piece does not change, and derivatives do not jump."""
        reference, t = self.reference, self._times
        table = np.array([reference.piece_values(time) for time in t.tolist()])
        np.testing.assert_array_equal(table.T.reshape(-1, len(t)), pieces_at(reference, t))
        h = 1e-6 * self.duration
        left, right = (reference.values(t + s, self._order) for s in (-h, h))
        slope = (right[:-1] - left[:-1]) / (2 * h)
        middle = reference.values(t, self._order)[1:]
        edges = reference.breaks(0.0, self.duration)
        near = np.abs(t[:, None] - edges[None]).min(axis=1, initial=np.inf) <= 2 * h
        scale = np.abs(middle).max(axis=1, keepdims=True) + 1
        assert np.all((np.abs(slope - middle) / scale)[:, ~near] < 1e-3), "a derivative is wrong"

    def test_is_continuous_below_its_order(self) -> None:
        """At a break only the derivative of the order may jump."""
        reference, h = self.reference, 1e-9 * self.duration
        edges = reference.breaks(0.0, self.duration)
        order = int(min(reference.order, 3))
        left, right = (reference.values(edges + s, order)[:order] for s in (-h, h))
        size = np.abs(reference.values(self._times, order)).max() + 1
        assert np.all(np.abs(left - right) <= 1e-5 * size)

    def test_bounds_hold(self) -> None:
        """No sample is beyond them."""
        bounds = self.reference.bounds(self._order).values
        largest = np.abs(self.reference.values(self._times, self._order)).max(axis=1)
        assert np.all(largest <= np.array(bounds)), f"{largest} exceeds {bounds}"

    def test_slopes_hold(self) -> None:
        """Of every derivative, between the breaks: no two neighbours are steeper."""
        edges = [0.0, *self.reference.breaks(0.0, self.duration).tolist(), self.duration]
        for order in range(self._order + 1):
            jumping = jumps(self.reference, order) is not None
            slope = lipschitz_bound(self.reference, order, between_jumps=jumping)
            for a, b in pairwise(edges if slope is not None else ()):
                t = a + (b - a) * np.linspace(0.01, 0.99, 200)
                y = self.reference.values(t, order)[order]
                allowed = slope * np.diff(t) * (1 + 1e-6) + 1e-9 * np.abs(y).max()
                assert np.all(np.abs(np.diff(y)) <= allowed), f"y_d^({order}) is steeper"

    def test_survives_a_system_file(self) -> None:
        """Saved and loaded, it is the same."""
        system = load("example1").replace(reference=self.reference)
        assert loads(to_text(system)).reference == self.reference

    def test_is_simulated(self) -> None:
        """In continuous time, sampled, and in an ensemble."""
        system = load("example1").replace(reference=self.reference)
        system = system.with_settings(duration=SHORT_RUN, tail=None)
        sampled = system.replace(implementation=Implementation(period=PERIOD_TESTED))
        runs = [simulate(each) for each in (system, sampled)]
        assert all(run.outcome is Outcome.finished for run in runs)
        np.testing.assert_allclose(runs[0].y_d, self.reference.values(runs[0].t, 0)[0])
        assert (
            ensemble(system, TRIED_MEMBERS, limit=1.0).statistics.outcomes["finished"]
            == TRIED_MEMBERS
        )

"""Conformance tests: write a law or a reference in one file, inherit its tests.

In a test file of your own::

    from certrack import load
    from certrack.testing import LawConformance

    class TestMyLaw(LawConformance):
        system = load("example1").replace(law=MyLaw(c=(1, 0.5)))

pytest then runs every ``test_`` method below on your law. A law that is not defined everywhere (a
barrier, say) states the points at which it is tested::

        points = [(0.5, {"x1": 0.3, "x2": 0.1, "bias": 0.2})]

:class:`ReferenceConformance` does the same for a reference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import FrozenInstanceError, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from certrack.core.compilers import CompilerError
from certrack.core.errors import MissingExtra
from certrack.core.expressions import TIME
from certrack.core.heyoka import has_heyoka
from certrack.core.keys import keys_of
from certrack.core.lowering import extract_switches, numpy_callable, rows, to_heyoka
from certrack.core.powers import put_in
from certrack.export.c.export import c_files
from certrack.export.c.software_in_the_loop import difference_from_python, simulate_with_c
from certrack.export.c.source import c_code
from certrack.export.python_control import to_control
from certrack.export.st.function_block import structured_text
from certrack.integrators.base import Outcome
from certrack.laws import known_laws
from certrack.loops.continuous import INTEGRALS, close_loop, parameter_values
from certrack.model.implementation import Implementation
from certrack.references import Reference, check_reference, pieces_at
from certrack.simulation.simulator import Simulator, simulate
from certrack.studies.ensembles.ensemble import ensemble
from certrack.systems.reader import load, loads
from certrack.systems.system import System
from certrack.systems.writer import to_text

#: What is tried at random, and how far numbers may differ.
TRIED_POINTS, TRIED_MEMBERS, SHORT_RUN = 5, 4, 1.0

#: Period of the sampled runs where the system has none, s.
PERIOD_TESTED = 1e-3


class LawConformance:
    """Tests that every law passes; set :attr:`system` to a system that uses the law.

    Attributes
    ----------
    system : System
    points : pairs (t, values by name)
        Times and states of plant and law at which formulas are evaluated; a state that is left out
        has its initial value. Without points, random ones: states of 0.1 to 1.5.
    """

    system: System
    points: Sequence[tuple[float, Mapping[str, float]]] = ()

    def _points(self) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """Times and states of the loop, with the parameters of the current piece."""
        loop, reference = close_loop(self.system), self.system.reference
        values, states = parameter_values(loop, self.system), [s.name for s in loop.states]
        rng, size = np.random.default_rng(0), (TRIED_POINTS, len(states))
        times = rng.uniform(0, self.system.settings.duration, TRIED_POINTS)
        pairs = list(zip(times.tolist(), rng.uniform(0.1, 1.5, size), strict=True))
        if self.points:
            start = dict(zip(states, [*self.system.start, 0.0, 0.0, 0.0], strict=True))
            for _, named in self.points:
                assert set(named) <= set(states), f"no such state: {set(named) - set(states)}"
            pairs = [
                (float(t), np.array(list({**start, **named}.values()))) for t, named in self.points
            ]
        return [(t, y, np.concatenate([values, reference.piece_values(t)])) for t, y in pairs]

    @property
    def _sampled(self) -> System:
        """The system, sampled, for a short time."""
        system = self.system
        implementation = system.implementation or Implementation(period=PERIOD_TESTED)
        duration = min(SHORT_RUN, system.settings.duration)
        return system.replace(implementation=implementation).with_settings(
            duration=duration, tail=None
        )

    def test_is_immutable(self) -> None:
        """A law is a frozen value."""
        name = fields(self.system.law)[0].name
        try:
            setattr(self.system.law, name, None)
        except FrozenInstanceError:
            return
        raise AssertionError("the law can be changed in place; make it a frozen dataclass")

    def test_uses_only_its_signals(self) -> None:
        """The equations contain states, reference, estimates and declared gains, nothing else."""
        controller = self.system.controller
        s = controller.signals
        known = {*s.x, *s.Y, *controller.states, *controller.symbols, TIME}
        known |= {symbol for phi in s.phi for symbol in phi.free_symbols}
        known |= self.system.plant.drift.expr.free_symbols
        equations = controller.equations
        for formula in (equations.u, *(rate for _, rate in equations.update)):
            foreign = formula.free_symbols - known
            assert not foreign, f"unknown symbols {foreign} in {formula}"
        assert len(controller.values) == len(controller.symbols)

    def test_obeys_the_error_system(self) -> None:
        """e' = (S - C - K) e + T w - R y_d^(q+1) + (0 ... 0, g_n u + phi^T theta - nu)."""
        system, loop = self.system, close_loop(self.system)
        plant, truth, coordinates = system.plant, system.truth, system.controller.coordinates
        if truth.input_gain is None:  # it has states of its own
            return
        rates = numpy_callable([TIME, loop.states, loop.parameters], [*loop.rates, loop.u])
        names = [TIME, *plant.symbols]
        known = {name: float(v) for name, v in plant.constant_values.items()}
        exact = {symbol: known[symbol.name] for symbol in _constants(system)}
        unknown = numpy_callable(
            names, [put_in(w.expr, exact) for w in (*(truth.omega or ()), *plant.regressor)]
        )
        drift = numpy_callable(names, [put_in(plant.drift.expr, exact)])
        theta = np.array([float(value.expr) for value in truth.theta])
        A, B = coordinates.A, coordinates.B
        for t, y, p in self._points():
            x, Y = y[: plant.n], system.reference.values(np.array([t]), coordinates.q + 1)[:, 0]
            *rate, u = rates(t, y, p)
            e = A @ x - B @ Y[:-1]
            left = A @ np.array(rate[: plant.n]) - B @ Y[1:]
            values = np.array(unknown(t, *x), dtype=float)
            w, phi = values[: plant.n], values[plant.n :]
            nu = coordinates.nu_x @ x + coordinates.nu_Y @ Y - drift(t, *x)[0]
            right = coordinates.error_matrix @ e + A @ (np.array(truth.tau) * w)
            right -= coordinates.R * Y[-1]
            right[-1] += float(truth.input_gain.expr) * u + phi @ theta - nu
            scale = np.abs(A) @ np.abs(rate[: plant.n]) + np.abs(coordinates.nu_x) @ np.abs(x) + 1
            assert np.all(np.abs(left - right) <= 1e-11 * scale.max())

    def test_numpy_and_taylor_forms_agree(self) -> None:
        """Both lowerings of the loop give the same rates."""
        if not has_heyoka():
            return
        import heyoka as hy

        loop = close_loop(self.system)
        smooth, switches = extract_switches(loop.rates)
        if switches:
            return
        rates = numpy_callable([TIME, loop.states, loop.parameters], loop.rates)
        variables = [hy.expression(state.name) for state in loop.states]
        known = dict(zip(loop.states, variables, strict=True))
        used = set().union(*(rate.free_symbols for rate in smooth))
        needed = [i for i, symbol in enumerate(loop.parameters) if symbol in used]
        known |= {loop.parameters[i]: hy.par[k] for k, i in enumerate(needed)}
        compiled = hy.cfunc(to_heyoka(smooth, known), variables)
        for t, y, p in self._points():
            expected = np.array(rates(t, y, p), dtype=float)
            rate = compiled(y, pars=p[needed], time=t)
            np.testing.assert_allclose(rate, expected, rtol=1e-11, atol=1e-11)

    def test_integrators_agree(self) -> None:
        """Taylor and SciPy give the same run."""
        if not has_heyoka():
            return
        settings = self.system.settings
        start = replace(settings, tolerance=1e-11, duration=min(5.0, settings.duration), tail=None)
        system = self.system.replace(settings=start)
        runs = [simulate(system, integrator=method) for method in ("taylor", "scipy")]
        t = np.linspace(0, min(run.trajectory.end for run in runs), 200)
        first, second = (run.trajectory.interpolate(t) for run in runs)
        scale = np.abs(first).max(axis=1, keepdims=True) + 1
        assert np.abs((first - second) / scale).max() < 1e-7

    def test_new_gains_need_no_recompilation(self) -> None:
        """A compiled simulator run with other gains equals a fresh one."""
        law = self.system.law
        other = self.system.replace(law=replace(law, c=tuple(1.1 * c for c in law.c)))
        compiled, fresh = Simulator(self.system).run(other), Simulator(other).run()
        assert compiled.final_state == fresh.final_state

    def test_gains_are_symbols(self) -> None:
        """Other numbers in the law's fields change no formula: none stands there as a number."""
        law, plant = self.system.law, self.system.plant
        for name, key in keys_of(law).items():
            value = getattr(law, name)
            if key.kind == "number" and isinstance(value, float):
                change: dict[str, Any] = {name: value + 1e-3 * (abs(value) or 1.0)}
                other = replace(law, **change)
                same = other.design(plant).equations == law.design(plant).equations
                assert same, f"{name} stands in the formulas as a number"

    def test_runs_sampled(self) -> None:
        """The sampled loop reaches its end."""
        run = simulate(self._sampled)
        assert run.outcome is Outcome.finished, run.outcome.value

    def test_members_are_the_same_however_they_are_computed(self) -> None:
        """Side by side, and each by itself: continuous and sampled."""
        if not has_heyoka():
            return
        short = self._sampled
        for system in (short.replace(implementation=None), short):
            together, alone = (
                ensemble(system, TRIED_MEMBERS, method=method, limit=1.0).per_member()[0]
                for method in ("lockstep", "alone")
            )
            np.testing.assert_allclose(together, alone, rtol=1e-3, atol=1e-5)

    def test_is_exported(self) -> None:
        """C and Structured Text exist; C, where it compiles, gives the run of Python."""
        system = self._sampled
        assert structured_text(system)
        c_files(c_code(system))
        try:
            run = simulate_with_c(system)
        except CompilerError:
            return
        assert difference_from_python(run) <= 1e-9 * (1 + float(np.abs(run.u).max()))

    def test_python_control_has_the_same_rates(self) -> None:
        """The blocks' rates are those of the loop."""
        system = self.system.replace(implementation=None)
        try:
            blocks = to_control(system)
        except MissingExtra:
            return
        loop = close_loop(system)
        rates = numpy_callable([TIME, loop.states, loop.parameters], loop.rates)
        for t, y, p in self._points():
            count = len(loop.states) - len(INTEGRALS)
            expected = np.array(rates(t, y, p), dtype=float)[:count]
            actual = blocks.loop.dynamics(t, y[:count], [])
            np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-9)

    def test_survives_a_system_file(self) -> None:
        """Saved and loaded, the system is the same (laws that a file can name)."""
        if self.system.law.kind in known_laws():
            assert loads(to_text(self.system)) == self.system


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


def _constants(system: System) -> set[Any]:
    """The symbols of the plant's constants that its formulas contain."""
    names = set(system.plant.constant_values)
    formulas = (system.plant.drift, *system.plant.regressor, *(system.truth.omega or ()))
    symbols = {symbol for formula in formulas for symbol in formula.expr.free_symbols}
    return {symbol for symbol in symbols if symbol.name in names}

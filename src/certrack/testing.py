"""Conformance tests for control laws: write a law in one file, inherit its tests.

In a test file of your own::

    from certrack import load
    from certrack.testing import LawConformance

    class TestMyLaw(LawConformance):
        system = load("example1").replace(law=MyLaw(c=(1, 0.5)))

pytest then runs every ``test_`` method below on your law.
"""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np

from certrack.core.expressions import TIME
from certrack.core.heyoka import has_heyoka
from certrack.core.lowering import extract_switches, numpy_callable, to_heyoka
from certrack.laws import known_laws
from certrack.loops.continuous import close_loop, parameter_values
from certrack.simulation.simulator import Simulator, simulate
from certrack.systems.reader import loads
from certrack.systems.system import System
from certrack.systems.writer import to_text


class LawConformance:
    """Tests that every law passes; set :attr:`system` to a system that uses the law."""

    system: System

    def _points(self, count: int = 5) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """Random times and states of the loop, with the parameters of the current piece."""
        rng = np.random.default_rng(0)
        loop, reference = close_loop(self.system), self.system.reference
        values = parameter_values(loop, self.system)
        return [
            (t, y, np.concatenate([values, reference.piece_values(t)]))
            for t, y in zip(
                rng.uniform(0, self.system.settings.duration, count),
                rng.uniform(0.1, 1.5, (count, len(loop.states))),
                strict=True,
            )
        ]

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
            names, [w.expr.subs(exact) for w in (*(truth.omega or ()), *plant.regressor)]
        )
        drift = numpy_callable(names, [plant.drift.expr.subs(exact)])
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

    def test_survives_a_system_file(self) -> None:
        """Saved and loaded, the system is the same (laws that a file can name)."""
        if self.system.law.kind in known_laws():
            assert loads(to_text(self.system)) == self.system


def _constants(system: System) -> set[Any]:
    """The symbols of the plant's constants that its formulas contain."""
    names = set(system.plant.constant_values)
    formulas = (system.plant.drift, *system.plant.regressor, *(system.truth.omega or ()))
    symbols = {symbol for formula in formulas for symbol in formula.expr.free_symbols}
    return {symbol for symbol in symbols if symbol.name in names}

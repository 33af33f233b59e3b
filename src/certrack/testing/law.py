"""The kit of a law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import FrozenInstanceError, fields, replace
from typing import Any

import numpy as np

from certrack.core.compilers import CompilerError
from certrack.core.errors import MissingExtra
from certrack.core.expressions import TIME
from certrack.core.keys import keys_of
from certrack.core.lowering import extract_switches, numpy_callable, to_heyoka
from certrack.core.powers import put_in
from certrack.export.c.export import c_files
from certrack.export.c.software_in_the_loop import difference_from_python, simulate_with_c
from certrack.export.c.source import c_code
from certrack.export.python_control import to_control
from certrack.export.st.function_block import structured_text
from certrack.integrators.base import Outcome
from certrack.laws import Law, known_laws
from certrack.loops.continuous import INTEGRALS, close_loop, parameter_values
from certrack.model.implementation import Implementation
from certrack.simulation.simulator import Simulator, simulate
from certrack.studies.ensembles.ensemble import ensemble
from certrack.systems.reader import loads
from certrack.systems.system import System
from certrack.systems.writer import to_text
from certrack.testing.claim import TestedClaim, nominal_system
from certrack.testing.shared import (
    PERIOD_TESTED,
    SHORT_RUN,
    TRIED_MEMBERS,
    TRIED_POINTS,
    require_heyoka,
    skip,
)

#: A claim must hold to this fraction of the terms in it, which cancel each other.
CLAIM_TOLERANCE = 1e-10

#: Where a claimed V' must be negative: at states this many times as large.
FAR_AWAY = 1e4


class LawConformance:
    """Tests that every law passes; set :attr:`system` to a system that uses the law.

    Attributes
    ----------
    system : System
    points : pairs (t, values by name)
        Times and states of plant and law at which formulas are evaluated; a state that is left out
        has its initial value. Without points, random ones: states of 0.1 to 1.5.
    tracking : float
        The largest |e_1| in the tail of a run without uncertain terms, as a part of what a constant
        output would leave.
    """

    system: System
    points: Sequence[tuple[float, Mapping[str, float]]] = ()
    tracking: float = 0.5

    def _points(self, system: System) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """Times and states of the loop, with the parameters of the current piece."""
        loop, reference = close_loop(system), system.reference
        values, states = parameter_values(loop, system), [s.name for s in loop.states]
        rng, size = np.random.default_rng(0), (TRIED_POINTS, len(states))
        times = rng.uniform(0, system.settings.duration, TRIED_POINTS)
        pairs = list(zip(times.tolist(), rng.uniform(0.1, 1.5, size), strict=True))
        if self.points:
            start = dict(zip(states, [*system.start, 0.0, 0.0, 0.0], strict=True))
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
        known = {*s.x, *s.Y, *controller.states, *controller.symbols, TIME, s.applied}
        known |= {symbol for phi in s.phi for symbol in phi.free_symbols}
        known |= self.system.plant.drift.expr.free_symbols
        equations = controller.equations
        for formula in (equations.u, *(rate for _, rate in equations.update)):
            foreign = formula.free_symbols - known
            assert not foreign, f"unknown symbols {foreign} in {formula}"
        assert len(controller.values) == len(controller.symbols)

    def test_obeys_its_error_system(self) -> None:
        """The errors change in the nominal loop as the law states, whatever its u is."""
        nominal = nominal_system(self.system)
        claim = TestedClaim(nominal)
        errors, rates = claim.formulas.errors, claim.formulas.rates
        assert len(errors) == len(rates), "the claim needs one rate per error"
        compare = claim.compare(errors, rates)
        for t, y, p in self._points(nominal):
            actual, claimed, size = compare(t, y, p)
            wrong = np.abs(actual - claimed) > CLAIM_TOLERANCE * size
            assert not wrong.any(), (
                f"e_{int(np.argmax(wrong)) + 1}' is {actual[wrong][0]:.6g} in the loop at "
                f"t = {t:.4g}, the law states {claimed[wrong][0]:.6g}"
            )

    def test_its_energy_falls_as_stated(self) -> None:
        """V > 0, V' in the nominal loop is at most what the law states, which is negative far away.

        Far away is not asked where the law states `points`, since it may be undefined there.
        """
        nominal = nominal_system(self.system)
        claim = TestedClaim(nominal)
        V, V_rate = claim.formulas.V, claim.formulas.V_rate
        if V is None or V_rate is None:
            skip(f"the {nominal.law.kind} law states no Lyapunov function")
        compare, energy = claim.compare((V,), (V_rate,)), claim.value(V)
        for t, y, p in self._points(nominal):
            (actual,), (claimed,), size = compare(t, y, p)
            assert actual <= claimed + CLAIM_TOLERANCE * size, (
                f"V' is {actual:.6g} at t = {t:.4g}, the law states {claimed:.6g} at most"
            )
            assert energy(t, y, p) > 0, "V is not positive"
            if not self.points:
                assert compare(t, FAR_AWAY * y, p)[1][0] < 0, "the claimed V' is not negative"

    def test_tracks(self) -> None:
        """Without uncertain terms the output follows the reference: a part of the error is left."""
        nominal = nominal_system(self.system)
        run = simulate(nominal)
        assert run.outcome is Outcome.finished, run.outcome.value
        tail = run.t >= (nominal.settings.tail or run.t[-1] / 2)
        y_d = run.y_d[tail]
        constant = np.ptp(y_d) / 2 if np.ptp(y_d) > 1e-9 else np.abs(y_d - run.x[0, 0]).max()
        left = np.abs(run.e[0][tail]).max()
        assert left <= self.tracking * constant, (
            f"|e_1| reaches {left:.3g} after t = {run.t[tail][0]:.4g}; a constant output would "
            f"leave {constant:.3g}. Correct the law, or raise simulation.duration or `tracking`"
        )

    def test_loop_holds_the_plant_and_the_input(self) -> None:
        """The rates are those of plant and truth, with the law's input: in error coordinates,

        e' = (S - C - K) e + T w - R y_d^(q+1) + (0 ... 0, g_n u + phi^T theta - nu).
        """
        system, loop = self.system, close_loop(self.system)
        plant, truth, coordinates = system.plant, system.truth, system.controller.coordinates
        if truth.input_gain is None:
            skip("the truth has states of its own")
        rates = numpy_callable([TIME, loop.states, loop.parameters], [*loop.rates, loop.u])
        names = [TIME, *plant.symbols]
        exact = {symbol: plant.constant_values[symbol.name] for symbol in _constants(system)}
        unknown = numpy_callable(
            names, [put_in(w.expr, exact) for w in (*(truth.omega or ()), *plant.regressor)]
        )
        drift = numpy_callable(names, [put_in(plant.drift.expr, exact)])
        theta = np.array([float(value.expr) for value in truth.theta])
        A, B = coordinates.A, coordinates.B
        for t, y, p in self._points(self.system):
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
        require_heyoka()
        import heyoka as hy

        loop = close_loop(self.system)
        smooth, switches = extract_switches(loop.rates)
        if switches:
            skip("the loop has switches, which Taylor's method treats as events")
        rates = numpy_callable([TIME, loop.states, loop.parameters], loop.rates)
        variables = [hy.expression(state.name) for state in loop.states]
        known = dict(zip(loop.states, variables, strict=True))
        used = set().union(*(rate.free_symbols for rate in smooth))
        needed = [i for i, symbol in enumerate(loop.parameters) if symbol in used]
        known |= {loop.parameters[i]: hy.par[k] for k, i in enumerate(needed)}
        compiled = hy.cfunc(to_heyoka(smooth, known), variables)
        for t, y, p in self._points(self.system):
            expected = np.array(rates(t, y, p), dtype=float)
            rate = compiled(y, pars=p[needed], time=t)
            np.testing.assert_allclose(rate, expected, rtol=1e-11, atol=1e-11)

    def test_integrators_agree(self) -> None:
        """Taylor and SciPy give the same run."""
        require_heyoka()
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
        law = self.system.law.settled(self.system.plant)
        other = self.system.replace(law=_with_other_gains(law))
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

    def test_gains_are_those_of_the_fields(self) -> None:
        """A number that `parameters` returns under the name of a field is that of the field."""
        law = self.system.law
        numbers = law.parameters(self.system.plant)
        for name, key in keys_of(law).items():
            if key.kind == "number" and name in numbers:
                assert float(numbers[name]) == float(getattr(law, name)), name

    def test_runs_sampled(self) -> None:
        """The sampled loop reaches its end."""
        run = simulate(self._sampled)
        assert run.outcome is Outcome.finished, run.outcome.value

    def test_members_are_the_same_however_they_are_computed(self) -> None:
        """Side by side, and each by itself: continuous and sampled."""
        require_heyoka()
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
        except CompilerError as problem:
            skip(str(problem))
        assert difference_from_python(run) <= 1e-9 * (1 + float(np.abs(run.u).max()))

    def test_python_control_has_the_same_rates(self) -> None:
        """The blocks' rates are those of the loop."""
        system = self.system.replace(implementation=None)
        try:
            blocks = to_control(system)
        except MissingExtra as problem:
            skip(str(problem))
        loop = close_loop(system)
        rates = numpy_callable([TIME, loop.states, loop.parameters], loop.rates)
        for t, y, p in self._points(self.system):
            count = len(loop.states) - len(INTEGRALS)
            expected = np.array(rates(t, y, p), dtype=float)[:count]
            actual = blocks.loop.dynamics(t, y[:count], [])
            np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-9)

    def test_survives_a_system_file(self) -> None:
        """Saved and loaded, the system is the same (laws that a file can name)."""
        if self.system.law.kind not in known_laws():
            skip(f"the {self.system.law.kind} law is not registered, so no file can name it")
        assert loads(to_text(self.system)) == self.system


def _with_other_gains(law: Law) -> Law:
    """The law with one list of its gains, c where it has one, or all its numbers a tenth larger."""
    keys = keys_of(law).items()
    lists = [name for name, key in keys if key.kind == "numbers" and getattr(law, name)]
    if lists:
        changed: dict[str, Any] = {lists[0]: tuple(1.1 * v for v in getattr(law, lists[0]))}
    else:
        numbers = [name for name, key in keys if key.kind == "number"]
        changed = {name: 1.1 * getattr(law, name) for name in numbers if getattr(law, name)}
        assert changed, f"the {law.kind} law has no gains"
    return replace(law, **changed)


def _constants(system: System) -> set[Any]:
    """The symbols of the plant's constants that its formulas contain."""
    names = set(system.plant.constant_values)
    formulas = (system.plant.drift, *system.plant.regressor, *(system.truth.omega or ()))
    symbols = {symbol for formula in formulas for symbol in formula.expr.free_symbols}
    return {symbol for symbol in symbols if symbol.name in names}

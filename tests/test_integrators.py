"""The duties of an integrator of one run, as `certrack.integrators.base.Integrator` states them."""

from dataclasses import replace

import numpy as np
import pytest

import certrack
from certrack.integrators.base import Outcome, Problem
from certrack.integrators.single.scipy import ScipyIntegrator
from certrack.integrators.single.taylor import TaylorIntegrator
from certrack.loops.continuous import INTEGRALS, close_loop, parameter_values

TOLERANCE = 1e-8
METHODS = {
    "taylor": lambda loop: TaylorIntegrator(loop, TOLERANCE),
    "scipy": ScipyIntegrator,
    "implicit": lambda loop: ScipyIntegrator(loop, implicit=True),
}


@pytest.fixture(params=METHODS)
def make(request):
    return METHODS[request.param]


def ready(make, **changes):
    """An integrator of example1, and its problem."""
    system = certrack.load("example1").replace(**changes)
    loop = close_loop(system)
    problem = Problem(
        start=np.concatenate([system.start, np.zeros(len(INTEGRALS))]),
        parameters=parameter_values(loop, system),
        schedule=system.reference,
        duration=3.0,
        tolerance=TOLERANCE,
        plant_order=loop.n,
        fastest_pole=system.controller.coordinates.fastest_pole,
        max_state=system.settings.max_state,
    )
    return make(loop), problem


def test_runs_do_not_depend_on_those_before(make):
    """Duties 1, 6 and 7: other numbers in between change neither bits nor what was returned."""
    integrator, problem = ready(make)
    first = integrator.integrate(problem)
    t = np.linspace(0, first.end, 101)
    states = first.interpolate(t).copy()
    other = integrator.integrate(replace(problem, start=problem.start * 0.5, duration=2.0))
    assert other.end == 2.0
    assert not np.array_equal(other.interpolate(t[:50]), states[:, :50])
    again = integrator.integrate(problem)
    np.testing.assert_array_equal(again.times, first.times)
    np.testing.assert_array_equal(again.interpolate(t), states)
    np.testing.assert_array_equal(first.interpolate(t), states)


def test_no_step_crosses_a_break_of_the_reference(make):
    """Duty 2."""
    integrator, problem = ready(make, reference=certrack.triangle(0.2, 1.0))
    ends = [end for _, end in problem.segments]
    assert len(ends) > 3
    trajectory = integrator.integrate(problem)
    assert trajectory.outcome is Outcome.finished
    assert set(ends) <= set(trajectory.times)


def test_the_error_is_about_the_tolerance(make):
    """Duties 3 and 6: at the ends of the steps and inside them."""
    integrator, problem = ready(make)
    trajectory = integrator.integrate(problem)
    reference, _ = ready(METHODS["scipy"])
    exact = reference.integrate(replace(problem, tolerance=1e-13))
    t = np.linspace(0, problem.duration, 301)
    states = exact.interpolate(t)
    error = np.abs(trajectory.interpolate(t) - states) / (1 + np.abs(states))
    assert error.max() < 100 * TOLERANCE


def test_an_escape_ends_the_run(make):
    """Duty 5: a state of the plant beyond the limit."""
    integrator, problem = ready(make)
    start = problem.start * [0.5, 0.0, 1, 1, 1, 1, 1]
    problem = replace(problem, start=start)
    trajectory = integrator.integrate(problem)
    states = trajectory.interpolate(np.linspace(0, trajectory.end, 1001))
    peak = np.abs(states[: problem.plant_order]).max()
    assert peak > 1.2 * np.abs(start).max()
    inside = integrator.integrate(replace(problem, max_state=1.01 * peak))
    assert inside.outcome is Outcome.finished
    limit = (np.abs(start).max() + peak) / 2
    outside = integrator.integrate(replace(problem, max_state=limit))
    assert outside.outcome is Outcome.escaped
    assert outside.end < problem.duration


def test_rates_that_are_not_finite_end_the_run(make):
    """Duty 5."""
    integrator, problem = ready(make)
    trajectory = integrator.integrate(replace(problem, start=problem.start * np.nan))
    assert trajectory.outcome is Outcome.undefined
    assert trajectory.end == 0.0


def test_times_and_dense_output_belong_together(make):
    """Duty 6: increasing times from the start on; any times in any order."""
    integrator, problem = ready(make)
    trajectory = integrator.integrate(problem)
    times = trajectory.times
    assert times[0] == 0.0
    assert times[-1] == trajectory.end == problem.duration
    assert (np.diff(times) > 0).all()
    np.testing.assert_allclose(trajectory.interpolate(times[:1])[:, 0], problem.start, atol=1e-14)
    t = np.random.default_rng(3).uniform(0, problem.duration, 50)
    order = np.argsort(t)
    np.testing.assert_allclose(
        trajectory.interpolate(t)[:, order], trajectory.interpolate(t[order]), rtol=1e-14
    )

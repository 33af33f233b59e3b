"""Metrics of a run in compiled C are those of NumPy: the same searches, to rounding."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import sympy

import certrack
from certrack.core.expressions import TIME, symbol
from certrack.core.lowering import numpy_callable
from certrack.core.select import Select
from certrack.integrators.base import subdivide
from certrack.integrators.single import extremes
from certrack.integrators.single.extremes import SeriesSignals, signal_program
from certrack.integrators.single.taylor import TaylorSeries
from certrack.loops.continuous import close_loop
from certrack.references.shapes import steps
from certrack.simulation.metrics import measure

pytestmark = pytest.mark.skipif(
    extremes.extremes_library() is None, reason="no compiler, or nothing can be kept"
)

#: They agree to rounding: of the largest of the signals that a sum or a search goes over.
ROUNDING = 1e-10

REFERENCES = {
    "trapezoid": certrack.trapezoid(amplitude=0.3, period=4, rise=1),
    "steps": steps((1.0, 2.5, 4.0), (0.0, 0.4, -0.2, 0.1), 2.0),
    "kinks": certrack.SymbolicReference("0.2*abs(sin(3*t))"),
}


def both(run):
    fast, slow = run.metrics, replace(run, signals=None).metrics
    assert run.signals is not None
    return asdict(fast), asdict(slow)


def agree(run):
    fast, slow = both(run)
    size = max(abs(v) for v in slow.values() if np.isfinite(v))
    for name, value in fast.items():
        assert value == pytest.approx(slow[name], rel=ROUNDING, abs=ROUNDING * size, nan_ok=True), (
            name
        )


def continuous(name):
    return certrack.load(name).replace(implementation=None)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-9, 1e-12])
@pytest.mark.parametrize(
    "name", ["example1", "dual-motor-lean", "dual-motor", "point-to-point", "axis-load"]
)
def test_metrics_of_shipped_systems_are_those_of_numpy(name, tolerance):
    agree(certrack.simulate(continuous(name), tolerance=tolerance))


@pytest.mark.parametrize("tail", [0.0, 1e-3, 7.123, 19.999])
@pytest.mark.parametrize("band", [1e-9, 0.01, 0.3, 1e3])
def test_every_tail_and_band_is_that_of_numpy(tail, band):
    system = certrack.load("example1").with_settings(tail=tail, band=band)
    agree(certrack.simulate(system))


@pytest.mark.parametrize("name", REFERENCES)
def test_references_with_pieces_and_breaks(name):
    system = continuous("axis-load")
    law = replace(system.law, feedforward=0, sampled_feedforward=False, observer=None)
    system = system.replace(law=law, reference=REFERENCES[name])
    agree(certrack.simulate(system, integrator="taylor"))


def test_a_run_that_escapes():
    run = certrack.simulate(certrack.load("example1-classic"), max_state=2.4)
    assert run.outcome.name == "escaped"
    fast, slow = both(run)
    for name in ("tail_error", "peak_input", "rms_error"):
        assert fast[name] == pytest.approx(slow[name], rel=1e-9, nan_ok=True)


def test_too_many_extremes_are_left_to_numpy(monkeypatch):
    run = certrack.simulate(certrack.load("example1"))
    series, end = run.trajectory.interpolate, run.trajectory.end
    assert run.signals.measure(series, end, 1.0, 0.05, 10.0, smooth=True, most=2000) is not None
    assert run.signals.measure(series, end, 1.0, 0.05, 10.0, smooth=True, most=3) is None


def test_without_the_library_numpy_measures(monkeypatch):
    run = certrack.simulate(certrack.load("example1"))
    wanted = replace(run, signals=None).metrics
    monkeypatch.setattr("certrack.integrators.single.extremes.extremes_library", lambda: None)
    assert run.metrics == wanted


def test_a_cache_that_is_off_means_no_library(monkeypatch):
    monkeypatch.setenv("CERTRACK_CACHE", "off")
    assert extremes.extremes_library.__wrapped__() is None


X, Y, P = symbol("x"), symbol("y"), symbol("p")
FORMULAS = [
    X + 2 * Y - P / 3 + TIME,
    X**2 * Y**-3 + 1 / (2 + X) ** 2,
    sympy.sqrt(X + 3) ** 3 / sympy.sqrt(Y + 3),
    (X + 3) ** sympy.Float(1.3) + (X + 3) ** sympy.Rational(-1, 3),
    sympy.sin(X) * sympy.cos(Y * TIME) + sympy.tan(X / 3) + sympy.exp(X - Y) * sympy.log(X + 4),
    sympy.asin(X / 9) + sympy.acos(Y / 9) + sympy.atan(X) + sympy.atan2(X, Y),
    sympy.sinh(X) - sympy.cosh(Y) + sympy.tanh(X * Y),
    abs(X) + sympy.sign(Y - P) + sympy.Max(X, Y, P) - sympy.Min(X, Y, P, 0),
    Select(X, Y, P, TIME) + Select(0, X, X * Y, 7),
    sympy.Integer(3),
]


@pytest.mark.parametrize("formula", FORMULAS, ids=str)
def test_every_operation_is_that_of_numpy(formula):
    """The largest and the last value of random cubics of a formula."""
    rng = np.random.default_rng(3)
    starts, end = np.array([0.0, 0.4, 1.1]), 1.7
    times = np.append(starts, end)
    table = rng.uniform(-0.6, 0.6, (3, 5, 4))
    table[:, :2, 0] += 1.3
    loop = replace(
        close_loop(certrack.load("example1")),
        states=(X, Y, *map(symbol, ("integral_u2", "integral_e2", "integral_e"))),
        parameters=(P,),
        pieces=0,
        u=formula,
        e_1=-formula,
    )
    series = TaylorSeries(starts, table)
    function = numpy_callable([TIME, X, Y, P], [formula])

    def dense(t):
        values = series(t)
        u = np.broadcast_to(function(t, values[0], values[1], 0.7)[0], t.shape)
        return np.array([-u, u, values[4]])

    samples = subdivide(times, 8)
    states = series.subdivided(times, 8)
    u = np.broadcast_to(function(samples, states[0], states[1], 0.7)[0], samples.shape)
    wanted = measure(samples, -u, u, states[2:], 1e-3, 0.7, 9, dense)
    signals = SeriesSignals(signal_program(loop), np.array([0.7]), lambda t: np.empty((0, len(t))))
    found = signals.measure(series, end, 1.0, 1e-3, 0.7, smooth=True, most=2000)
    names = ("settling_time", "tail_error", "integral_abs_error", "peak_input", "input_variation")
    for name, value in zip(names, found, strict=False):
        assert value == pytest.approx(getattr(wanted, name), rel=1e-9, nan_ok=True), name


def test_what_no_operation_is_has_no_program():
    loop = close_loop(certrack.load("example1"))
    assert signal_program(replace(loop, u=sympy.gamma(X), states=(X, *loop.states[1:]))) is None

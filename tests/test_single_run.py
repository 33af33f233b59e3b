"""One sampled run in compiled C is the run of the maps, to rounding; its metrics, exactly."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import certrack
from certrack.core.compilers import CompilerError, c_compilers
from certrack.integrators.sampled import single
from certrack.loops.continuous import INTEGRAL_SCALE
from certrack.simulation import sampled
from certrack.simulation.metrics import measure, settling_band
from certrack.simulation.sampled import SampledSimulator
from certrack.simulation.step_metrics import measure_steps

pytestmark = pytest.mark.skipif(not c_compilers(), reason="no C compiler")

#: Both may differ by so much of one and the size of a state: each rounds a few operations a step.
ROUNDING = 1e-12


def implemented(name, duration, **options):
    system = certrack.load(name)
    if options:
        system = system.replace(implementation=certrack.Implementation(**options))
    return system.with_settings(duration=duration)


def changed(system, old, new):
    text = certrack.to_text(system)
    assert old in text
    return certrack.loads(text.replace(old, new))


def everything(**options):
    usual = {
        "period": 0.01,
        "offset": 0.002,
        "delay": 1.3,
        "saturation": (-8, 8),
        "rate_limit": 500,
        "input_quantum": 0.001,
        "measurement_quantum": (1e-3, 0),
        "noise": (0.001, 0.002),
        "noise_bound": (0.0015, 0.001),
        "sensor_error": ("0.0001*sin(3*t)", "0.0003*cos(t)"),
        "velocity": ("x2",),
        "velocity_filter": 0.02,
        "update": "exact_leak",
        "projection": ((0, 5), (-9, 9)),
    }
    return implemented("example1", 4.0, **(usual | options))


def disturbed(*omega):
    """example1 whose disturbance has these factors."""
    system = implemented("example1", 3.0, period=0.01)
    text = certrack.to_text(system)
    line = next(line for line in text.splitlines() if line.startswith("omega"))
    return changed(system, line, f"omega = {list(omega)}".replace("'", '"'))


SYSTEMS = {
    "everything": everything,
    "hold": lambda: everything(anti_windup="hold", update="euler"),
    "jitter": lambda: everything(jitter=0.2, jitter_pattern="random", delay=0.5),
    "long delay": lambda: implemented("example1", 2.0, period=0.005, delay=3.7),
    "example1": lambda: implemented("example1", 3.0, period=0.001),
    "lean": lambda: implemented("dual-motor-lean", 2.0, period=0.002),
    "drive": lambda: implemented("dual-motor-drive", 1.0),
    "observer": lambda: implemented("dual-motor-observer", 0.1),
    "drag": lambda: implemented("dual-motor-drag", 2.0),
    "steps of the reference": lambda: implemented("point-to-point", 2.0, period=0.002),
    "integral": lambda: implemented("axis", 1.0, period=0.001),
    "states of the truth": lambda: implemented("flexible-joint", 0.5, period=0.001),
    "switches of time": lambda: disturbed("sign(sin(3*t))", "abs(cos(2*t))"),
    "kinks": lambda: disturbed("abs(x1)", "max(x1, x2)"),
}


def runs(system, monkeypatch):
    """By C and by the maps."""
    found = []
    for least in (0, 10**9):
        monkeypatch.setattr(sampled, "WORTH_COMPILING", least)
        simulator = SampledSimulator(system)
        found.append(simulator.run(system))
        assert ("maps" in vars(simulator)) == (least > 0)
    return found


def records(system, monkeypatch):
    return [run.trajectory.interpolate.record for run in runs(system, monkeypatch)]


def assert_same(a, b, tolerance=ROUNDING):
    size = 1.0 + np.abs(b).max(axis=-1, keepdims=True)
    assert (np.abs(a - b) <= tolerance * size).all()


@pytest.mark.parametrize("name", SYSTEMS)
def test_c_is_the_run_of_the_maps(name, monkeypatch):
    """States, inputs and estimates at every sample; the steps between may differ in length."""
    system = SYSTEMS[name]()
    c, maps = records(system, monkeypatch)
    assert np.array_equal(c.samples, maps.samples)
    assert len(c.samples) > 50
    assert_same(c.estimates, maps.estimates)
    at, there = (np.searchsorted(one.ends, one.samples) for one in (c, maps))
    assert_same(c.columns[:, at], maps.columns[:, there])
    acting, acting_there = at[:-1].clip(max=len(c.inputs) - 1), there[:-1]
    assert_same(c.inputs[acting], maps.inputs[acting_there])
    assert len(c.ends) == len(maps.ends)
    assert np.abs(c.ends - maps.ends).max() < 1e-8  # error estimates round, so do step lengths


@pytest.mark.parametrize("name", ["everything", "drive", "states of the truth", "kinks"])
def test_sides_are_those_of_the_formulas(name, monkeypatch):
    """e_1 and its rate at both ends of every step, as NumPy computes them."""
    monkeypatch.setattr(sampled, "WORTH_COMPILING", 0)
    system = SYSTEMS[name]()
    solution = certrack.simulate(system).trajectory.interpolate
    anew = dataclasses.replace(solution, record=dataclasses.replace(solution.record, sides=None))
    assert anew.record.sides is None
    assert_same(solution.sides, anew.sides)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dual-motor-observer", "dual-motor-drag"])
def test_loops_that_amplify_rounding_differ_no_more_than_before(name, monkeypatch):
    """These do: by 1e6 and more in 20 s. Plain Python and heyoka differ as much from each other."""
    system = certrack.load(name)
    c, maps = records(system, monkeypatch)
    python = certrack.simulate(system, integrator="scipy").trajectory.interpolate.record
    before, now = (np.abs(one.columns - maps.columns).max() for one in (python, c))
    assert before > 1e-10
    assert now < 10 * before


def test_the_record_grows_where_errors_demand_many_steps(monkeypatch):
    system = disturbed("tanh(200*sin(2000*t))", "1").with_settings(duration=1.0)
    monkeypatch.setattr(sampled, "WORTH_COMPILING", 0)
    run = certrack.simulate(system)
    record = run.trajectory.interpolate.record
    assert len(record.inputs) > 2 * single.MAX_INTERVAL_STEPS + 2 * len(record.samples)
    assert (np.diff(record.ends) > 0).all()
    assert record.ends[-1] == 1.0
    monkeypatch.setattr(sampled, "WORTH_COMPILING", 10**9)
    assert_same(run.x[:, -1:], certrack.simulate(system).x[:, -1:], 1e-7)


def test_what_c_does_not_do_is_left_to_the_maps(monkeypatch):
    monkeypatch.setattr(sampled, "WORTH_COMPILING", 0)
    escaping = implemented("example1", 20.0, period=0.4)
    runs = [certrack.simulate(escaping)]
    sliding = SampledSimulator(implemented("stiction", 0.1, period=0.01))
    monkeypatch.setattr(sampled, "WORTH_COMPILING", 10**9)
    runs.append(certrack.simulate(escaping))
    assert runs[0].outcome is runs[1].outcome is not certrack.Outcome.finished
    assert runs[0].summary() == runs[1].summary()
    assert sliding.surfaces is not None
    assert not sliding._in_c


def test_a_run_that_ends_before_its_first_sample(monkeypatch):
    noise = {"noise": (0.01, 0.02), "noise_bound": (0.02, 0.03), "sensor_error": ("0.01", "0")}
    system = implemented("example1", 0.5, period=2.0, offset=1.0, **noise)
    c, maps = records(system, monkeypatch)
    assert c.samples.tolist() == maps.samples.tolist() == [0.5]
    assert_same(c.columns[:, -1:], maps.columns[:, -1:])
    assert_same(c.estimates, maps.estimates)


def test_short_runs_and_machines_without_a_compiler_take_the_maps(monkeypatch):
    def refuse(*_, **__):
        raise CompilerError("no compiler")

    monkeypatch.setattr(single, "load_library", refuse)
    short = certrack.simulate(implemented("example1", 3.9, period=0.001))
    assert short.outcome.name == "finished"
    long = implemented("example1", 4.1, period=0.001)
    simulator = SampledSimulator(long)
    run = simulator.run(long)
    assert run.trajectory.end == 4.1
    assert simulator._single(False) is None
    assert "maps" in vars(simulator)


def test_the_choice_depends_on_the_problem_alone():
    """So the same problem gives the same bits, whatever was run before."""
    system = implemented("example1", 4.1, period=0.001)
    simulator = SampledSimulator(system)
    first = simulator.run(system)
    for duration in (0.5, 6.0):
        simulator.run(system.with_settings(duration=duration))
    again = simulator.run(system)
    assert np.array_equal(first.x, again.x)
    assert first.metrics == again.metrics


def test_progress_is_reported(monkeypatch):
    monkeypatch.setattr(single, "EVENTS_PER_CALL", 1000)
    times = []
    certrack.simulate(
        implemented("example1", 5.0, period=0.001), progress=lambda t, *_: times.append(t)
    )
    assert times[0] == 0.0
    assert times[-1] == 5.0
    assert len(times) >= 7
    assert times == sorted(times)


# ---- metrics -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["everything", "drive", "lean", "integral", "observer"])
def test_metrics_are_those_of_the_dense_output(name):
    system = SYSTEMS[name]()
    system = system.with_settings(tail=0.3 * system.settings.duration + 0.0003)
    run = certrack.simulate(system)
    by_dense = measure(
        run.t,
        run.x[0] - run.y_d,
        run.u,
        run._states[-3:] * INTEGRAL_SCALE,
        settling_band(system.settings, system.reference),
        system.settings.tail_start,
        per_step=run.trajectory.parts + 1,
        dense=run._signals,
    )
    for metric, value in dataclasses.asdict(run.metrics).items():
        wanted = dataclasses.asdict(by_dense)[metric]
        assert value == pytest.approx(wanted, rel=1e-7, abs=1e-9, nan_ok=True), metric


def metrics_of(ends, error, slope, inputs, tail_start, band=0.1):
    """Of e_1 = error(t, k) on step k, with Simpson's integrals."""
    ends = np.asarray(ends, dtype=float)
    k = np.arange(len(ends) - 1)
    begin, end = ends[:-1], ends[1:]
    sides = np.array([error(begin, k), error(end, k), slope(begin, k), slope(end, k)])
    fine = np.linspace(begin, end, 401, axis=1)
    weights = np.tile([2.0, 4.0], 200)[:400]
    simpson = np.append(weights, 1.0)
    simpson[0] = 1.0
    areas = [
        (end - begin) / 1200 * (power(error(fine, k[:, None])) @ simpson)
        for power in (np.square, np.asarray)
    ]
    running = np.cumsum(np.pad([np.square(inputs) * (end - begin), *areas], ((0, 0), (1, 0))), 1)
    record = SimpleNamespace(ends=ends, inputs=np.asarray(inputs), columns=running / INTEGRAL_SCALE)
    solution = SimpleNamespace(record=record, sides=sides, n=0)
    return measure_steps(solution, band, tail_start)


def test_extremes_inside_a_step_are_exact():
    """(t - 1)^2 (t - 2.5) on one step: a top at 1, a dip at 2, zeros at 1 and 2.5."""

    def error(t, _):
        return (t - 1) ** 2 * (t - 2.5)

    def slope(t, _):
        return (t - 1) * (3 * t - 6)

    assert metrics_of([0, 3], error, slope, [2.0], 1.2).tail_error == pytest.approx(2.0)
    assert metrics_of([0, 2.9], error, slope, [2.0], 2.7).tail_error == pytest.approx(error(2.9, 0))
    assert metrics_of([0, 2.6], error, slope, [2.0], 1.2).tail_error == pytest.approx(0.5)
    assert metrics_of([0, 2.6], error, slope, [2.0], 2.3).tail_error == pytest.approx(1.69 * 0.2)
    primitive = np.polyint(np.polymul([1, -2, 1], [1, -2.5]))
    below, above = (
        np.polyval(primitive, b) - np.polyval(primitive, a) for a, b in ((0, 2.5), (2.5, 3))
    )
    many = metrics_of(np.linspace(0, 3, 61), error, slope, np.arange(60.0) % 2, 1.2)
    assert many.integral_abs_error == pytest.approx(above - below, rel=1e-6)
    assert many.input_variation == 59
    assert many.peak_input == 1


def test_settling_is_the_last_entry_into_the_band():
    def error(t, _):
        return np.exp(-t) * np.cos(5 * t)

    def slope(t, _):
        return -np.exp(-t) * (np.cos(5 * t) + 5 * np.sin(5 * t))

    metrics = metrics_of(np.linspace(0, 6, 6001), error, slope, np.zeros(6000), 3.0, band=0.1)
    t = np.linspace(0, 6, 6_000_001)
    last = t[np.flatnonzero(np.abs(error(t, 0)) > 0.1)[-1]]
    assert metrics.settling_time == pytest.approx(last, abs=2e-6)
    assert metrics.tail_error == pytest.approx(np.abs(error(t[t >= 3], 0)).max(), rel=1e-12)
    assert metrics.integral_abs_error == pytest.approx(np.abs(error(t, 0)).mean() * 6, rel=1e-5)


def test_jumps_between_steps_are_kept_apart():
    """-1 on the first step, 2 t - 4 on the second: no zero but the jump, and one at 2."""

    def error(t, k):
        return np.where(k == 0, -1.0 + 0 * t, 3.0 - t)

    def slope(t, k):
        return np.where(k == 0, 0.0 * t, -1.0 + 0 * t)

    metrics = metrics_of([0, 1, 4], error, slope, [0.0, 0.0], 0.5, band=2.5)
    assert metrics.tail_error == pytest.approx(2.0)
    assert metrics.settling_time == 0.0
    assert metrics.integral_abs_error == pytest.approx(1 + 2 + 0.5)
    assert metrics_of([0, 1, 4], error, slope, [0.0, 0.0], 0.5, band=1.5).settling_time == (
        pytest.approx(1.5)
    )
    assert metrics_of([0, 1, 2.5], error, slope, [0.0, 0.0], 0, band=0.7).settling_time == (
        pytest.approx(2.3)
    )
    assert np.isnan(metrics_of([0, 1, 2], error, slope, [0.0, 0.0], 3.0).tail_error)
    assert np.isnan(metrics_of([0, 1, 2], error, slope, [0.0, 0.0], 0, band=0.7).settling_time)


def test_a_run_without_a_step_has_metrics():
    """The first one would end beyond the largest state."""
    run = certrack.simulate(implemented("example1", 1.0, period=0.5, delay=0.0), max_state=2.0)
    assert run.trajectory.times.tolist() == [0.0]
    assert run.outcome.name == "escaped"
    assert np.isnan(run.metrics.settling_time)
    assert run.summary()["steps"] == 0

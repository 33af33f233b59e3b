"""Enclosures, changes of sign, switches and bursts of time; random systems and a loop by hand."""

import math
import subprocess
import sys
from dataclasses import replace

import mpmath
import numpy as np
import pytest
import sympy
from depth import depth
from random_systems import DURATION, amplification, by_hand, draw
from scipy.integrate import simpson

import certrack
from certrack.core.enclosures import enclose
from certrack.core.expressions import TIME, parse
from certrack.core.sign_changes import sign_changes
from certrack.loops.bursts import is_plain, scan
from certrack.loops.schedule import make_schedule
from certrack.loops.time_switches import take_switches
from certrack.references.shapes import steps

SMOOTH = (
    *("sin(3*t)", "exp(-((t-10)/0.02)**2)", "tanh(50*(t-3))", "atan(5*(t-2))", "1/(1+t**2)"),
    *("sqrt(1+t**2)", "log(1+t)", "cos(t)**3*exp(-t)", "sinh(t/5)", "cosh(t/3)", "tan(t/20)"),
    *("asin(0.5*sin(t))", "acos(0.9*cos(2*t))", "(1+t)**(-3)", "t**2.5", "(t-5)**4", "(t-5)**3"),
    "atan2(sin(t), 2+cos(t))",
)
KINKED = ("abs(sin(t))", "max(0, 1-abs(t-10)/0.5)", "min(t, 3)*sign(t-4)", "max(t, 2, 7-t)")


def formula(text):
    return parse("formula", text, ["t"]).expr


@pytest.mark.parametrize("text", SMOOTH + KINKED)
def test_enclosures_hold_values_and_taylor_coefficients(text):
    rng, order = np.random.default_rng(1), 4
    f = formula(text)
    begins = rng.uniform(0, 12, 20)
    ends = begins + 10 ** rng.uniform(-6, 0.3, 20)
    found = enclose(f, begins, ends, {}, order)
    count = 1 if f.has(sympy.Abs, sympy.Max, sympy.Min, sympy.sign) else order + 1
    series = [sympy.diff(f, TIME, k) / math.factorial(k) for k in range(count)]
    series = [sympy.lambdify(TIME, part, "mpmath") for part in series]
    with mpmath.workdps(400):
        for i, (begin, end) in enumerate(zip(begins, ends, strict=True)):
            half = (mpmath.mpf(end) - mpmath.mpf(begin)) / 2
            for t in (begin, end, *rng.uniform(begin, end, 3)):
                for k, part in enumerate(series):
                    value, tiny = part(mpmath.mpf(t)) * half**k, mpmath.mpf("1e-300")
                    if k < 2:
                        assert found.low[k, i] - tiny <= value <= found.high[k, i] + tiny
                    assert abs(value) <= found.sizes[k, i] + tiny


def test_enclosures_are_tight_on_short_intervals():
    begins = np.linspace(0.1, 11, 50)
    for text in SMOOTH:
        f = formula(text)
        found = enclose(f, begins, begins + 1e-7, {}, 2)
        width = found.high[0] - found.low[0]
        slope = np.abs(sympy.lambdify(TIME, sympy.diff(f, TIME), "numpy")(begins))
        assert (width <= 2e-7 * (slope + 1)).all()


@pytest.mark.parametrize(
    ("text", "times"),
    [
        ("t - 10", [10]),
        ("sin(7*t)", [math.pi * k / 7 for k in range(1, 45)]),
        ("sin(3*t) - 0.9999", None),
        ("1 - abs(t - 10)/0.02", [9.98, 10.02]),
        ("(t - 3)*(t - 3.0000001)", [3, 3.0000001]),
        ("exp(-((t - 5)/1e-4)**2) - 0.5", None),
        ("(t - 4)**3", [4]),
        ("sign(t - 4) + sign(t - 4.001)", [4, 4.001]),
        ("t*0 + 1 + exp(-t)", []),
        ("sin(t)/(t - 8)", None),
    ],
)
def test_no_change_of_sign_is_lost(text, times):
    f = formula(text)
    found = sign_changes(f, np.array([0.0, 20.0]), {})
    if times is None:
        if text.startswith("sin(3"):
            a = math.asin(0.9999)
            both = [(a + 2 * math.pi * k) / 3 for k in range(10)]
            both += [(math.pi - a + 2 * math.pi * k) / 3 for k in range(10)]
            times = sorted(t for t in both if t < 20)
        elif text.startswith("exp"):
            half = 1e-4 * math.sqrt(math.log(2))
            times = [5 - half, 5 + half]
        else:
            times = [math.pi, 2 * math.pi, 8, *(math.pi * k for k in range(3, 7))]
    times = np.sort(times)
    assert len(found) >= len(times)
    for t in times:
        assert (
            np.abs(found - t).min() < 1e-9 if "0.9999" in text else np.abs(found - t).min() < 1e-11
        )
    extra = [t for t in found if len(times) == 0 or np.abs(times - t).min() > 1e-6]
    assert extra == []


@pytest.mark.parametrize("text", ["sin(t)**2 + cos(t)**2 - 1 + 1e-18*sin(t)", "sin(1e6*t)"])
def test_a_formula_whose_changes_cannot_be_told_is_refused(text):
    with pytest.raises(certrack.InputError, match="changes of sign of a formula of t"):
        sign_changes(formula(text), np.array([0.0, 20.0]), {})


def switched(text, duration=20.0):
    """Schedule of a formula, and the formula with its switches as a function of time."""
    (smooth,), switches = take_switches([formula(text)], [])
    schedule = make_schedule(steps((1,), (0, 0.1), 1), switches, {}, duration, 1e-9)
    evaluate = sympy.lambdify([TIME, *switches.symbols], smooth, "numpy")
    return schedule, lambda t: evaluate(t, *schedule.switch_values(t))


@pytest.mark.parametrize(
    "text",
    [
        *("3*max(0, 1 - abs(t - 10)/0.02)", "abs(abs(abs(t - 10) - 2) - 1)", "max(t, 3, 8 - t)"),
        *("sign(max(0, 1 - abs(t - 7)))", "min(sin(t), cos(t), 0.5)", "sign(sin(5*t))*abs(t - 2)"),
        *("abs(3 - 5)*t", "max(-t, min(t, 4))"),
    ],
)
def test_switches_write_the_same_function(text):
    schedule, value = switched(text)
    t = np.random.default_rng(0).uniform(0, 20, 4001)
    t = t[np.abs(t[:, None] - schedule.breaks(0, 20)).min(axis=1, initial=1.0) > 1e-9]
    right = sympy.lambdify(TIME, formula(text), "numpy")(t)
    np.testing.assert_allclose(value(t) * np.ones_like(t), right, atol=1e-13)


def test_breaks_of_the_reference_and_switches_are_one_where_rounding_parts_them():
    schedule, value = switched("sign(t - 1 - 1e-15)")
    assert schedule.breaks(0, 20).tolist() == pytest.approx([1.0, 1.1])
    assert value(np.array([1.0, 0.9999])).tolist() == [1.0, -1.0]


@pytest.mark.parametrize("width", [1e-1, 1e-2, 1e-3, 1e-5])
@pytest.mark.parametrize("at", [3.1, 7.77777, 19.99])
@pytest.mark.parametrize("shape", ["exp(-x**2)", "1/(1+x**2)**4", "1 - tanh(x)**2", "exp(-x**4)"])
def test_no_bump_hides_from_the_scan(shape, at, width):
    text = shape.replace("x**", f"((t-{at})/{width})**").replace("(x)", f"((t-{at})/{width})")
    found = scan(formula(text), np.array([0.0, 20.0]), {}, {}, 1e-9)
    near = np.abs(found.marks - at) < 5 * width
    assert near.sum() >= 3
    assert len(found.marks) < 400


@pytest.mark.parametrize("integrator", ["taylor", "scipy", "implicit"])
def test_no_run_misses_a_bump(integrator):
    """x' = u + w from rest, u = -x: the end is the convolution of w with exp(-t)."""
    system = certrack.loads(FIRST_ORDER)
    simulator = certrack.Simulator(system.with_settings(integrator=integrator))
    for at in (0.003, 0.2, 3.1, 7.9):
        for width in (0.1, 1e-2, 1e-3, 1e-5):
            changed = system.replace(truth=replace(system.truth, constants={"at": at, "w": width}))
            run = simulator.run(changed.with_settings(integrator=integrator))
            x = run.final_state["x1"]
            s = np.linspace(max(0.0, at - 9 * width), min(8.0, at + 9 * width), 20_001)
            w = np.exp(-(((s - at) / width) ** 2)) * np.exp(s - 8)
            assert x == pytest.approx(simpson(w, x=s), abs=1e-9)


FIRST_ORDER = """
[plant]
states = ["x1"]
drift = "0"
gain_sign = 1
input_gain = 1
[plant.constants]
at = 1
w = 1
[plant.uncertainty]
tau = [1]
gamma = [0]
beta = [1]
[truth]
input_gain = 1
omega = ["exp(-((t - at)/w)**2)"]
[reference]
signal = "0"
[law]
kind = "robust"
c = [1]
[simulation]
x0 = [0]
duration = 8
"""


def test_plain_formulas_are_not_scanned_and_say_nothing():
    for text in ("3", "0.2*sin(3*t + 1) + t**2", "exp(-t)*cos(2*t)", "1 - cos(t)"):
        assert is_plain(formula(text))
    for text in ("exp(-t**2)", "sin(t**2)", "1/(1+t)", "sin(t)**8", "tanh(t)", "exp(sin(t))"):
        assert not is_plain(formula(text))


def test_what_the_scan_cannot_resolve_is_said():
    found = scan(formula("sqrt(abs(sin(1e9*t)))"), np.array([0.0, 20.0]), {}, {}, 1e-9)
    assert "is not resolved there" in found.note


def pulsed(omega, **changes):
    system = certrack.load("tests/data/cases/pulse_ensemble.toml")
    return system.replace(truth=replace(system.truth, omega=("0", omega)), **changes)


@pytest.mark.parametrize("integrator", ["auto", "scipy"])
@pytest.mark.parametrize(
    "shape", ["3*(sign(t-10.013)-sign(t-10.014))/2", "3*exp(-((t-10.013)/0.0005)**2)"]
)
def test_pulses_between_two_samples_are_not_missed(shape, integrator):
    system = pulsed(shape, implementation=certrack.Implementation(period=0.05))
    run = certrack.simulate(system, integrator=integrator)
    assert run.outcome is certrack.Outcome.finished
    area = 0.003 if "sign" in shape else 3 * 0.0005 * math.sqrt(math.pi)
    t = np.array([10.0095, 10.0165])
    speed = run.trajectory.interpolate(t)[1]
    assert speed[1] - speed[0] == pytest.approx(area, rel=1e-6)  # u is zero until the next sample


@pytest.mark.parametrize("method", ["native", "lockstep"])
@pytest.mark.parametrize("period", [None, 0.05])
def test_members_side_by_side_do_not_miss_bumps(method, period):
    implementation = None if period is None else certrack.Implementation(period=period)
    system = pulsed("3*exp(-((t-10)/0.002)**2)", implementation=implementation)
    right = certrack.simulate(system).metrics.tail_error
    assert right > 1e-3
    try:
        result = certrack.ensemble(system, members=8, method=method)
    except certrack.InputError as problem:
        pytest.skip(str(problem))
    assert result.summary()["tail_error"]["min"] == pytest.approx(right, rel=1e-4)


def test_members_that_switch_at_their_own_times_are_run_alone():
    plant = certrack.load("tests/data/cases/pulse_ensemble.toml").plant
    plant = replace(plant, constants={"at": 10})
    population = certrack.Population(
        disturbance="file", constants={"at": certrack.Distribution("uniform", (10, 19))}
    )
    system = pulsed("3*(sign(t-at)-sign(t-at-0.02))/2", plant=plant, population=population)
    result = certrack.ensemble(system, members=6)
    tails = result.summary()["tail_error"]
    assert tails["min"] == pytest.approx(0.0106148, abs=2e-7)
    with pytest.raises(certrack.InputError, match="times of their own"):
        certrack.ensemble(system, members=6, method="lockstep")


def test_too_many_switches_are_refused():
    with pytest.raises(certrack.InputError, match="more than 50000 changes of sign"):
        certrack.simulate(pulsed("sign(sin(1e5*t))"))


MEMORY = """
import resource, certrack
from scipy.integrate import simpson
from random_systems import lean_chain
system = lean_chain()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
run = certrack.simulate(system)
run.metrics
used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
print(run.outcome.name, used * 1024 < 5e8, used)
"""


@pytest.mark.slow
def test_a_chain_that_meets_its_step_limit_says_so_within_half_a_gigabyte():
    command = [sys.executable, "-c", MEMORY]
    done = subprocess.run(command, capture_output=True, text=True, cwd="tests", timeout=500)
    assert done.stdout.split()[:2] == ["step_limit", "True"], done.stdout + done.stderr


#: Tolerance of each method in the comparison: an implicit method takes long at a tight one.
TOLERANCES = {"taylor": 1e-9, "scipy": 1e-9, "implicit": 1e-4}


def disagreements(seed, methods=tuple(TOLERANCES)):
    """By method: largest difference from the loop by hand, in tolerances.

    An error of the tolerance at the start may become `amplification` as large.
    """
    system, hand = by_hand(seed)
    grid = np.linspace(0, DURATION, 201)
    right = hand.solve(grid)
    size = np.abs(right).max() + amplification(system)
    found = {}
    for method in methods:
        tolerance = TOLERANCES[method]
        run = certrack.simulate(system, integrator=method, tolerance=tolerance)
        assert run.outcome is certrack.Outcome.finished
        states = run.trajectory.interpolate(grid)[: hand.drawn.n]
        found[method] = float(np.abs(states - right).max()) / size / tolerance
    return found


@pytest.mark.parametrize("seed", [3, 17, 31, 34, 38])
def test_random_systems_agree_with_a_loop_by_hand(seed):
    found = disagreements(seed, ("taylor", "scipy"))
    assert max(found.values()) < 10


@pytest.mark.slow
@pytest.mark.search
def test_many_random_systems_agree_with_a_loop_by_hand():
    worst = dict.fromkeys(TOLERANCES, (0.0, -1))
    for seed in range(depth(40, 300)):
        for method, value in disagreements(seed).items():
            worst[method] = max(worst[method], (value, seed))
    print(worst)
    assert max(value for value, _ in worst.values()) < 10


def test_the_drawn_systems_have_every_kind():
    texts = [draw(seed).text for seed in range(300)]
    for word in ("robust", "adaptive", "classic", "triangle", "trapezoid", "steps", "samples"):
        assert sum(f'"{word}"' in text for text in texts) >= 10
    for word in ("sign(", "max(", "min(", "exp(-((", "**3", "abs(sin(t))", "abs(x1)"):
        assert sum(word in text for text in texts) >= 10
    assert {draw(seed).n for seed in range(300)} == set(range(1, 9))

"""Rates that jump at a surface of the state: sticking, sliding, leaving."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import sympy
from depth import depth
from scipy.optimize import brentq

import certrack
from certrack import Implementation, Outcome, simulate
from certrack.core.expressions import TIME
from certrack.integrators.event_location import first_event
from certrack.integrators.single import scipy as scipy_integrators
from certrack.integrators.single import sliding
from certrack.laws import Equations, Law, gain
from certrack.loops.switching import switching
from certrack.studies.ensembles.plan import METRICS

METHODS = ("taylor", "scipy", "implicit")


def free(rates, x0, duration, **settings):
    """A system of these rates, which the input does not reach."""
    names = [f"x{i + 1}" for i in range(len(x0))]
    n = len(x0)
    text = f"""
    title = "free"
    [plant]
    states = {names}
    chain = {[1] * (n - 1)}
    drift = "{rates[-1]}"
    gain_sign = 1
    input_gain = 1
    [plant.uncertainty]
    tau = {[1] * n}
    gamma = {[0] * n}
    beta = {[100] * n}
    [truth]
    input_gain = 1e-12
    omega = [{", ".join(f'"{rates[i]} - x{i + 2}"' for i in range(n - 1))}{"," * (n > 1)} "0"]
    [reference]
    signal = "0"
    [law]
    kind = "robust"
    c = {[1] * n}
    [simulation]
    x0 = {list(x0)}
    duration = {duration}
    """
    return certrack.loads(text.replace("\n    ", "\n")).with_settings(**settings)


# --- exact solutions -------------------------------------------------------------------------


class PulledMass:
    """x'' = A sin(W t) - k x - mu sign(x') from rest, in closed form between the events."""

    k, mu, A, W = 4.0, 1.0, 2.5, 0.5

    def __init__(self, end):
        self.pieces, t, x = [], 0.0, 0.0
        while t < end:
            leaves = self._leaves(t, x, end)
            self.pieces.append((t, leaves, lambda s, x=x: (x + 0 * s, 0 * s)))
            t, moves = leaves, leaves < end
            while moves and t < end:
                side = math.copysign(1.0, self.A * math.sin(self.W * t) - self.k * x)
                motion = self._motion(t, x, side)
                grid = np.linspace(t, t + 8, 8001)[1:]
                j = np.flatnonzero(side * motion(grid)[1] < 0)[0]
                stop = brentq(lambda s, m=motion: m(s)[1], grid[j - 1], grid[j], xtol=1e-15)
                self.pieces.append((t, stop, motion))
                t, x = stop, float(motion(stop)[0])
                moves = abs(self.A * math.sin(self.W * t) - self.k * x) > self.mu

    def _leaves(self, t, x, end):
        def excess(s):
            return np.abs(self.A * np.sin(self.W * s) - self.k * x) - self.mu

        grid = np.linspace(t, end + 1, 100_001)
        found = np.flatnonzero(excess(grid) > 0)
        if not len(found) or grid[found[0]] > end:
            return end
        return brentq(excess, grid[found[0] - 1], grid[found[0]], xtol=1e-15)

    def _motion(self, t, x, side):
        w, P = math.sqrt(self.k), self.A / (self.k - self.W**2)
        a = x - P * math.sin(self.W * t) + side * self.mu / self.k
        b = -P * self.W * math.cos(self.W * t) / w
        return lambda s: (
            P * np.sin(self.W * s)
            - side * self.mu / self.k
            + a * np.cos(w * (s - t))
            + b * np.sin(w * (s - t)),
            P * self.W * np.cos(self.W * s)
            - a * w * np.sin(w * (s - t))
            + b * w * np.cos(w * (s - t)),
        )

    def stuck(self):
        return [(a, b) for a, b, motion in self.pieces if not np.any(motion(np.array([a, b]))[1])]

    def __call__(self, t):
        k = np.searchsorted([a for a, _, _ in self.pieces], t, side="right") - 1
        return np.array([self.pieces[i][2](s) for i, s in zip(k, t, strict=True)]).T


PULLED = PulledMass(12.0)


def pulled(**settings):
    return (
        free(("x2", "-4*x1"), (0, 0), 12)
        .replace(truth=certrack.Truth(1e-12, omega=("0", "2.5*sin(0.5*t) - sign(x2)")))
        .with_settings(**settings)
    )


@pytest.mark.parametrize(
    ("method", "tolerance", "error"),
    [("taylor", 1e-9, 2e-11), ("scipy", 1e-9, 1e-8), ("implicit", 1e-9, 1e-8)],
)
def test_a_pulled_mass_sticks_and_breaks_loose_when_it_must(method, tolerance, error):
    run = simulate(pulled(), integrator=method, tolerance=tolerance)
    t = np.linspace(0.001, 12, 1000)
    assert np.abs(run.trajectory.interpolate(t)[:2] - PULLED(t)).max() < error
    found = run.trajectory.modes.intervals(0, 12)
    assert found[0][1] == pytest.approx(2 * math.asin(1 / 2.5), abs=1e-14)  # A sin(W t) = mu
    assert len(found) == 4
    assert np.abs(np.subtract(found, PULLED.stuck())).max() < 10 * error
    assert not any(run.x[1][run.trajectory.modes.stuck(run.t)[0]])


@pytest.mark.parametrize("integrator", ["auto", "scipy"])
def test_so_it_does_between_samples(integrator):
    sampled = pulled(integrator=integrator).replace(implementation=Implementation(period=0.17))
    t = np.linspace(0.001, 12, 1000)
    for tolerance, error in ((1e-6, 5e-6), (1e-9, 5e-8)):
        run = simulate(sampled, tolerance=tolerance)
        assert np.abs(run.trajectory.interpolate(t)[:2] - PULLED(t)).max() < error
        found = run.trajectory.modes.intervals(0, 12)
        assert np.abs(np.subtract(found, PULLED.stuck())).max() < 10 * error
    assert np.abs(run.trajectory.interpolate(t[-1:])[0, 0] - PULLED(t[-1:])[0, 0]) < 1e-10


def test_the_order_of_the_method_holds_across_events(monkeypatch):
    """DOP853 with steps of one length between the events: order 8, its dense output 7."""
    t = np.array([2.0, 6.5, 9.5])
    errors = []
    monkeypatch.setattr(scipy_integrators, "EXPLICIT_SHARE", 1.0)  # no error control
    for steps in (24, 48, 96):
        monkeypatch.setattr(sliding, "LONGEST_STEP", 1 / steps)
        run = simulate(pulled(), integrator="scipy", tolerance=0.01)
        errors.append(np.abs(run.trajectory.interpolate(t)[:2] - PULLED(t)).max())
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert orders.min() > 5.5, (errors, orders)


@pytest.mark.parametrize("method", METHODS)
def test_a_swinging_mass_loses_2_mu_over_k_per_half_period(method):
    """x'' = -k x - mu sign(x'), and the energy is what friction took."""
    k, mu = 9.0, 1.5  # mu/k = 1/6
    system = free(("x2", f"-{k}*x1 - {mu}*sign(x2)"), (1.4, 0), 6, integrator=method)
    run = simulate(system)
    half = math.pi / math.sqrt(k)
    peaks = [1.4 - i * 2 * mu / k for i in range(5)]
    assert abs(peaks[-1]) <= mu / k < abs(peaks[-2])
    times = half * np.arange(len(peaks))
    expected = np.array(peaks) * (-1.0) ** np.arange(len(peaks))
    assert np.abs(run.trajectory.interpolate(times)[0] - expected).max() < 1e-7
    ((begin, end),) = run.trajectory.modes.intervals(0, 6)
    assert begin == pytest.approx(times[-1], abs=1e-6)
    assert end == 6
    t = run.t
    x, v = run.x
    path = np.abs(np.diff(x)).sum()  # every turn is a step's end
    energy = v**2 / 2 + k * x**2 / 2
    assert energy[0] - energy[-1] == pytest.approx(mu * path, rel=1e-8)
    assert t[-1] == 6


def stiction_by_hand():
    """The shipped axis after its start has died out: e'' + 40 e' + 401 e = -1.5 sign(v).

    While it moves forwards e = -1.5/401 until v = y_d' is zero at pi/2; from there it rests at q
    until the law's pull is the friction's, and then e returns to 1.5/401 with exp(-20 t).
    """
    q = 0.05 - 1.5 / 401

    def pull(t):
        y, rate, second = 0.05 * math.sin(t), 0.05 * math.cos(t), -0.05 * math.sin(t)
        return 401 * (y - q) + 40 * rate + second

    leaves = brentq(lambda t: pull(t) + 1.5, 1.6, 2.5, xtol=1e-15)
    e, slope = q - 0.05 * math.sin(leaves), -0.05 * math.cos(leaves)
    a = e - 1.5 / 401
    b = slope + 20 * a

    def error(t):
        """From the turn to the next one half a period later."""
        s = t - leaves
        moving = 1.5 / 401 + np.exp(-20 * s) * (a * np.cos(s) + b * np.sin(s))
        return np.where(t < leaves, q - 0.05 * np.sin(t), moving)

    return leaves, error


@pytest.mark.parametrize("method", METHODS)
def test_the_shipped_axis_does_what_the_formula_says(method):
    run = simulate(certrack.load("stiction"), integrator=method)
    leaves, error = stiction_by_hand()
    held = run.trajectory.modes.intervals(0, 20)[1:]
    turns = math.pi * np.arange(len(held))
    assert len(held) == 6
    expected = [(math.pi / 2 + turn, leaves + turn) for turn in turns]
    assert np.abs(np.subtract(held, expected)).max() < 1e-7
    t = np.linspace(math.pi / 2, 3 * math.pi / 2 - 1e-9, 500)
    for k, turn in enumerate(turns[:5]):
        e = run.trajectory.interpolate(t + turn)[0] - 0.05 * np.sin(t + turn)
        assert np.abs((-1) ** k * e - error(t)).max() < 2e-8
    assert run.metrics.tail_error == pytest.approx(1.5 / 401, abs=1e-8)
    assert run.metrics.tail_error < certrack.certify(run.system).best.bound


def test_refused_motions_are_said_in_one_line():
    twisting = free(("x2", "-2*sign(x1) - sign(x2)"), (0.3, 0), 20)
    for method in METHODS:
        run = simulate(twisting, integrator=method)
        assert run.outcome is Outcome.chattering
        assert "tanh" in run.outcome.value
        assert "\n" not in run.outcome.value
        # amplitudes shrink by 3 per half swing: T = sum of a geometric series
        assert run.trajectory.end == pytest.approx(_twisting_end(), abs=1e-5)
    relay = free(("x2", "-sign(x1)"), (0, 0), 1)
    assert simulate(relay).outcome is Outcome.chattering


def _twisting_end():
    x, t = 0.3, 0.0
    for _ in range(200):
        inward, outward = 1.0, 3.0  # 2 - 1 towards zero, 2 + 1 away from it
        speed = math.sqrt(2 * inward * x)
        t += speed / inward + speed / outward
        x = speed**2 / (2 * outward)
    return t


# --- several surfaces, and a smooth law that comes close to the jump ---------------------------


def smoothed(system, width):
    """The same with tanh(x/width) in place of sign(x), by the implicit method."""
    text, out = certrack.to_text(system), ""
    while "sign(" in text:
        before, _, after = text.partition("sign(")
        depth, i = 1, 0
        while depth:
            depth += (after[i] == "(") - (after[i] == ")")
            i += 1
        out += f"{before}tanh({1 / width!r}*({after[: i - 1]}))"
        text = after[i:]
    return certrack.loads(out + text).with_settings(integrator="implicit", tolerance=1e-9)


def test_smoothing_is_written_as_meant():
    text = certrack.to_text(smoothed(certrack.load("stiction"), 1e-3))
    assert "sign(" not in text
    assert "tanh(1000.0*(v))" in text


TWO_MASSES = (
    "x2",
    "-8*x1 + 4*x3 + 1.5*sin(1.3*t) - 1.1*sign(x2)",
    "x4",
    "4*x1 - 8*x3 + 1.2*cos(0.9*t) - 0.9*sign(x4)",
)
#: The second mass rides on the first one; the belt moves under both.
STACKED = (
    "x2",
    "-8*x1 + 1.5*sin(1.3*t) - 0.6*sign(x2) - 0.3*sign(x2 - x4)",
    "x4",
    "-3*x3 + 0.9*sign(x2 - x4)",
)
CASES = {"two masses": TWO_MASSES, "stacked": STACKED}


def moving(rates, x0, duration=6.0, **settings):
    base = free((*rates[:-1], "0"), x0, duration)
    omega = tuple(
        f"{rate} - x{i + 2}" if i + 1 < len(rates) else rate for i, rate in enumerate(rates)
    )
    return base.replace(truth=certrack.Truth(1e-12, omega=omega)).with_settings(**settings)


@pytest.mark.parametrize("name", CASES)
def test_two_surfaces_each_stick_by_themselves_and_together(name):
    system = moving(CASES[name], (0.3, 0, -0.2, 0))
    runs = [simulate(system, integrator=method) for method in METHODS]
    t = np.linspace(0, 6, 601)
    for run in runs:
        assert run.outcome is Outcome.finished
        gap = run.trajectory.interpolate(t) - runs[0].trajectory.interpolate(t)
        assert np.abs(gap[:4]).max() < 1e-7
    held = runs[0].trajectory.modes.stuck(t)
    assert {tuple(column) for column in held.T} == {(a, b) for a in (0, 1) for b in (0, 1)}
    errors = []
    for width in (1e-2, 1e-3, 1e-4):
        near = simulate(smoothed(system, width))
        gap = near.trajectory.interpolate(t) - runs[0].trajectory.interpolate(t)
        errors.append(np.abs(gap[:4]).max())
    assert errors[-1] < 1e-3
    assert errors[0] > 5 * errors[1] > 25 * errors[2], errors


def test_partners_are_those_that_touch_no_third():
    x = sympy.symbols("x1:7", real=True)
    a, b, c = (sympy.sign(x[i]) for i in (1, 3, 5))
    apart = switching([x[1], -a, x[3], -2 * b, x[5], -c], x)
    assert apart.partners == (None, None, None)
    assert not apart.bound
    two = switching([x[1], -a + b, x[3], -2 * b, x[5], -c], x)
    assert two.partners == (1, 0, None)
    three = switching([x[1], -a + b, x[3], -2 * b + c, x[5], -c], x)
    assert three.partners == (None, None, None)
    assert len(three.bound) == 2
    same = switching([x[1], -a + sympy.sign(-3 * x[1]), x[3], -b, x[5], -c], x)
    assert len(same.surfaces) == 3
    assert switching([x[1], sympy.sign(sympy.sin(TIME))], x[:2]) is None


def test_three_that_interact_are_refused_when_they_all_stick():
    rates = (
        "x2",
        "-x1 - 0.6*sign(x2) + 0.1*sign(x4)",
        "x4",
        "-x3 - 0.6*sign(x4) + 0.1*sign(x6)",
        "x6",
        "-x5 - 0.6*sign(x6)",
    )
    run = simulate(moving(rates, (0.1, 1, 0.1, 1, 0.1, 1), 9))
    assert run.outcome is Outcome.chattering
    assert run.trajectory.end > 0.5
    apart = tuple(rate.split(" + 0.1")[0] for rate in rates)
    run = simulate(moving(apart, (0.1, 1, 0.1, 1, 0.1, 1), 9))
    assert run.outcome is Outcome.finished
    assert run.trajectory.modes.stuck(np.array([8.9])).all()


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(2, 12)))
def test_random_systems_are_the_limit_of_smooth_ones(seed):
    """One to two masses on springs with random friction, Stribeck's dip, moving belts, |x|."""
    draw = np.random.default_rng(seed)

    def number(low, high):
        return f"{draw.uniform(low, high):.3f}"

    rates = []
    for i in range(1 + seed % 2):
        q, v, other = f"x{2 * i + 1}", f"x{2 * i + 2}", f"x{3 - 2 * i}" if seed % 2 else "0"
        slip = f"{v} - {number(-0.15, 0.15)}"
        size = f"{number(0.7, 1.2)} + {number(0, 0.2)}*exp(-4*({slip})**2)"
        rates += [
            v,
            f"-{number(2, 6)}*{q} - {number(0, 0.3)}*{v} + {number(0.2, 1)}*{other}"
            f" + {number(0.5, 2)}*sin({number(0.5, 2)}*t) - 0.2*abs({q})*{v}"
            f" - ({size})*sign({slip})",
        ]
    x0 = draw.uniform(-0.5, 0.5, len(rates)).round(3).tolist()
    system = moving(rates, x0, 4.0)
    runs = [simulate(system, integrator=method) for method in METHODS]
    t = np.linspace(0, 4, 401)
    n = len(rates)
    for run in runs[1:]:
        gap = run.trajectory.interpolate(t) - runs[0].trajectory.interpolate(t)
        assert np.abs(gap[:n]).max() < 1e-6
    assert runs[0].trajectory.modes.stuck(t).any()
    errors = []
    for width in (1e-3, 1e-4):
        gap = simulate(smoothed(system, width)).trajectory.interpolate(t)
        errors.append(np.abs((gap - runs[0].trajectory.interpolate(t))[:n]).max())
    assert errors[1] < 1e-3
    assert errors[0] > 4 * errors[1], errors


# --- a law that switches -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Relay(Law):
    """u = -k sign(x1 - y_d): a first-order sliding mode."""

    kind = "relay"
    pull: float = gain(above=0, default=2.0)

    def equations(self, s):
        return Equations(-s.parameter("pull") * sympy.sign(s.x[0] - s.Y[0]), ())

    def parameters(self, plant):
        return {"pull": self.pull}

    def initial_states(self, plant):
        return {}


@pytest.mark.parametrize("method", METHODS)
def test_a_law_that_switches_slides_and_its_input_is_the_equivalent_one(method):
    uncertainty = certrack.Uncertainty((1,), (0,), (1,))
    plant = certrack.Plant(states=["x1"], input_gain=1, uncertainty=uncertainty)
    system = certrack.System(
        plant,
        Relay(c=(1,)),
        certrack.SymbolicReference("sin(t)"),
        certrack.Truth(1, omega=("0.5*cos(3*t)",)),
        certrack.Settings((0.5,), 5),
    )
    run = simulate(system, integrator=method)
    ((begin, end),) = run.trajectory.modes.intervals(0, 5)
    # e' = -2 + 0.5 cos(3t) - cos(t) from 0.5
    hit = brentq(lambda t: 0.5 - 2 * t + math.sin(3 * t) / 6 - math.sin(t), 0, 1, xtol=1e-15)
    assert begin == pytest.approx(hit, abs=1e-8)
    assert end == 5
    t = np.linspace(begin + 1e-6, 5, 300)
    states = run.trajectory.interpolate(t)
    assert np.abs(states[0] - np.sin(t)).max() < 1e-8
    assert np.abs(run.input_of(t, states) - (np.cos(t) - 0.5 * np.cos(3 * t))).max() < 1e-8
    u = np.cos(t) - 0.5 * np.cos(3 * t)
    assert run.metrics.input_energy == pytest.approx(4 * hit + np.trapezoid(u**2, t), rel=1e-4)
    assert run.metrics.tail_error < 1e-8


# --- members, data, events -----------------------------------------------------------------------


@pytest.mark.parametrize("implementation", [None, Implementation(period=0.01)])
def test_members_are_what_they_are_alone(implementation):
    system = certrack.load("stiction").with_settings(duration=4, tail=2)
    system = system.replace(implementation=implementation)
    found = certrack.ensemble(system, 10, tolerance=1e-9)
    assert found.summary()["outcomes"] == {"finished": 10}
    metrics, _ = found.per_member()
    for index in (0, 7):
        run = simulate(found.member(index))
        assert run.notes, "it sticks"
        for name, value in zip(METRICS, metrics[:, index], strict=True):
            share = 1e-3 if name in ("settling_time", "input_variation") else 1e-5
            assert value == pytest.approx(getattr(run.metrics, name), rel=share), name


def test_members_on_surfaces_that_interact_are_run_alone():
    system = moving(STACKED, (0.3, 0, -0.2, 0), 2.0)
    system = system.replace(population=replace(system.varied, disturbance="file"))
    with pytest.raises(certrack.InputError, match="each is run by itself"):
        certrack.ensemble(system, 2, method="native", limit=1)
    found = certrack.ensemble(system, 2, limit=1)
    assert found.summary()["outcomes"] == {"finished": 2}


def test_sampled_converges_to_the_continuous_loop():
    system = certrack.load("stiction").with_settings(duration=4, tail=2)
    t = np.array([1.0, 2.5, 4.0])
    exact = simulate(system).trajectory.interpolate(t)[:2]
    errors = []
    for period in (4e-3, 2e-3, 1e-3):
        run = simulate(system.replace(implementation=Implementation(period=period)))
        errors.append(np.abs(run.trajectory.interpolate(t)[:2] - exact).max())
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert np.abs(orders - 1).max() < 0.15, errors


def test_the_dataset_says_when_it_sticks(tmp_path):
    run = simulate(certrack.load("stiction"), duration=4, tail=2)
    run.save(tmp_path / "run.nc")
    stored = certrack.Run.load(tmp_path / "run.nc")
    assert stored.notes == run.notes
    data = run.dataset(samples=401)
    assert data["surface"].values.tolist() == ["v"]
    held = data["sticking"].values[:, 0]
    assert held.mean() == pytest.approx(0.144, abs=0.01)  # 0.122 s and 0.458 s of 4 s
    assert np.abs(data["x"].values[held > 0, 1]).max() == 0.0
    assert "sticking" not in simulate(certrack.load("example1"), duration=1, tail=None).dataset()


def test_events_between_samples_and_in_fast_formulas_are_found():
    def one(f):
        return lambda since: f(since)[None]

    found, row = first_event(one(lambda t: (t - 0.501) ** 2 - 1e-8), 1.0, 1e-15)
    assert row == 0
    assert found == pytest.approx(0.501 - 1e-4, abs=1e-12)  # a dip far narrower than a sixteenth
    found, _ = first_event(one(lambda t: 1.02 - np.sin(60 * t) - 0.1 * t), 1.0, 1e-15)
    first = brentq(lambda t: 1.02 - math.sin(60 * t) - 0.1 * t, 0.2, math.pi * 4.5 / 60)
    assert found == pytest.approx(first, abs=1e-12)
    assert first_event(one(lambda t: (t - 0.5) ** 2 + 1e-8), 1.0, 1e-15) is None


def test_loops_without_a_sign_of_a_state_are_left_alone():
    for name in ("example1", "dual-motor"):
        assert simulate(certrack.load(name), duration=1, tail=None).trajectory.modes is None
    jump = certrack.load("example1")
    jump = jump.replace(truth=replace(jump.truth, omega=("0.1*sign(sin(3*t))", "0")))
    assert simulate(jump, duration=1, tail=None).trajectory.modes is None

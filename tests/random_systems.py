"""Random systems with pulses and kinks of time, and a loop by hand that is told where these are.

The loop shares with certrack the formulas of the law and the numbers of the reference, which have
tests of their own; the plant, the disturbances and the integration are written here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import sympy
from scipy.integrate import DOP853

import certrack

DURATION = 4.0


@dataclass
class Draw:
    """A random system, as text and as what the loop by hand needs."""

    text: str
    n: int
    g: list[float]
    b: list[list[float]]
    drift: str
    regressor: list[str]
    theta: list[float]
    omega: list[str]
    tau: list[float]
    switches: list[float]
    bumps: list[tuple[float, float]] = field(default_factory=list)


def draw(seed: int) -> Draw:
    """System number `seed`."""
    rng = np.random.default_rng([seed, 7])
    n = int(rng.integers(1, 9))
    kind = str(rng.choice(["robust", "adaptive", "classic"], p=[0.45, 0.4, 0.15]))
    signal = ["smooth", "kinked", "triangle", "trapezoid", "steps", "samples"]
    reference = "smooth" if kind == "classic" and n > 1 else str(rng.choice(signal))
    g = [round(rng.uniform(0.7, 1.5), 3) for _ in range(n)]
    b = [
        [round(rng.uniform(-0.4, 0.4), 3) * (rng.random() < 0.4) for _ in range(i + 1)]
        for i in range(n - 1)
    ]
    drifts = ["0", "-0.3*x1", "0.2*sin(x1)", "-0.2*abs(x1)*x1", "0.2*x1/(1 + x1**2)"]
    drift = str(rng.choice(drifts))
    regressor = [["sin(x1)"], ["x1"], []][int(rng.integers(3))]
    theta = [round(rng.uniform(-0.5, 0.5), 3) for _ in regressor]
    tau = [round(rng.uniform(0.2, 1.0), 3) for _ in range(n)]
    switches: list[float] = []
    bumps: list[tuple[float, float]] = []
    omega = ["0"] * n
    for i in sorted({n - 1, int(rng.integers(n))}):
        omega[i] = _disturbance(rng, switches, bumps, n - i)
    lines = _reference(rng, reference, switches)
    smooth = reference == "smooth"
    feedforward = int(rng.integers(n)) if smooth and kind != "classic" else 0
    law = ["[law]", f'kind = "{kind}"', f"c = {[round(rng.uniform(1, 2.5), 2) for _ in range(n)]}"]
    if kind != "classic":
        law.append(f"feedforward = {feedforward}")
    if kind == "adaptive":
        law += ["gain_rate = 0.5", "leak_gain = 0.3", "leak_theta = 0.3", "delta0 = 1.0"]
    rest = rng.random() < 0.5
    x0 = [0.0] * n if rest else [round(rng.uniform(-0.3, 0.3), 3) for _ in range(n)]
    known = [f"input_gain = {g[-1]}", f"theta = {theta}"] if kind == "robust" else []
    text = "\n".join(
        [
            "[plant]",
            f"states = {[f'x{i + 1}' for i in range(n)]}",
            f"chain = {g[:-1]}",
            f"linear = {b}",
            f'drift = "{drift}"',
            f"regressor = {regressor}",
            "gain_sign = 1",
            *known,
            "[plant.uncertainty]",
            f"tau = {tau}",
            f"gamma = {[0] * n}",
            f"beta = {[9] * n}",
            "[truth]",
            f"input_gain = {g[-1]}",
            f"theta = {theta}",
            f"omega = {omega}",
            *lines,
            *law,
            "[simulation]",
            f"x0 = {x0}",
            f"duration = {DURATION}",
            "tail = 1",
        ]
    ).replace("'", '"')
    return Draw(text, n, g, b, drift, regressor, theta, omega, tau, switches, bumps)


def _disturbance(rng, switches, bumps, depth) -> str:
    """A formula of t (and maybe x1), with its switches and bumps noted."""
    size = 3.0 if depth == 1 else 0.3
    at = round(rng.uniform(0.5, 3.5), 3)
    width = round(10 ** rng.uniform(-3, -0.5), 5)
    choice = int(rng.integers(8))
    if choice == 0:
        switches += [at, at + width]
        return f"{size}*(sign(t - {at}) - sign(t - {at + width!r}))/2"
    if choice == 1:
        switches += [at - width, at, at + width]
        return f"{size}*max(0, 1 - abs(t - {at})/{width})"
    if choice == 2:
        bumps.append((at, width))
        return f"{size}*exp(-((t - {at})/{width})**2)"
    if choice == 3:
        switches += [at - 2 * width, at - width, at, at + width, at + 2 * width]
        return f"{size}*max(0, min(1, 2 - abs(t - {at})/{width}))"
    if choice == 4:
        a = math.asin(0.9)
        for k in range(3):
            switches += [(a + 2 * math.pi * k) / 3, (math.pi - a + 2 * math.pi * k) / 3]
        return f"{size}*max(0, sin(3*t) - 0.9)"
    if choice == 5:
        switches += [math.pi * k / 7 for k in range(1, 9)]
        return f"0.1*{size}*sign(sin(7*t))"
    if choice == 6:
        switches += [at, at + width]
        return f"{size}*x1*(1 + sign(t - {at}))*(1 - sign(t - {at + width!r}))/4 + 0.1*sin(2*t)"
    bumps.append((at, width))
    return f"{size}/(1 + ((t - {at})/{width})**2)**3"


def _reference(rng, kind, switches) -> list[str]:
    a, period = round(rng.uniform(0.1, 0.4), 3), round(rng.uniform(1.0, 4.0), 3)
    if kind == "smooth":
        options = [f"{a}*sin(t)", f"{a}*(1 - cos(t))", "0", f"{a}*sin(t)*exp(-t/4)"]
        return ["[reference]", f'signal = "{options[int(rng.integers(4))]}"']
    if kind == "kinked":
        switches += [math.pi * k for k in (1,)]
        return ["[reference]", f'signal = "{a}*abs(sin(t))"', "bounds = [1, 1]"]
    if kind == "triangle":
        return ["[reference]", 'kind = "triangle"', f"amplitude = {a}", f"period = {period}"]
    if kind == "trapezoid":
        shape = [f"amplitude = {a}", f"period = {period}", f"rise = {round(period / 5, 3)}"]
        return ["[reference]", 'kind = "trapezoid"', *shape]
    if kind == "steps":
        return [
            "[reference]",
            'kind = "steps"',
            "times = [0.7, 2.1]",
            f"levels = [0, {a}, 0]",
            "slope = 2",
        ]
    values = [0.0, *(round(v, 3) for v in rng.uniform(-a, a, 4)), 0.0]
    return [
        "[reference]",
        'kind = "samples"',
        "times = [0, 1, 2.3, 3, 4.5, 7]",
        f"values = {[float(value) for value in values]}",
    ]


class ByHand:
    """The closed loop of a drawn system, integrated piece by piece with SciPy's DOP853."""

    def __init__(self, drawn: Draw, system) -> None:
        self.drawn, self.system = drawn, system
        names = {
            "abs": abs,
            "sign": lambda v: float(v > 0) - float(v < 0),
            "min": min,
            "max": max,
            "sin": math.sin,
            "cos": math.cos,
            "exp": math.exp,
        }
        states = [f"x{i + 1}" for i in range(drawn.n)]

        def function(text):
            return eval(f"lambda t, {', '.join(states)}: {text}", names)

        self.w = [function(text) for text in drawn.omega]
        self.h = function(drawn.drift)
        self.phi = [function(text) for text in drawn.regressor]
        controller = system.controller
        s, equations = controller.signals, controller.equations
        gains = dict(zip(controller.symbols, controller.values.tolist(), strict=True))
        formulas = [f.xreplace(gains) for f in (equations.u, *(r for _, r in equations.update))]
        arguments = [s.x, s.Y, controller.states]
        self.law = sympy.lambdify(arguments, formulas, "math", cse=True)
        self.derivatives = len(s.Y) - 1

    def rates(self, t, y, shift=0.0):
        """`shift` moves the time off a switch, towards the inside of the piece."""
        d = self.drawn
        n, x, z = d.n, y[: d.n].tolist(), y[d.n :].tolist()
        Y = self.system.reference.values(np.array([t + shift]), self.derivatives)[:, 0].tolist()
        u, *updates = self.law(x, Y, z)
        rates = [
            d.g[i] * x[i + 1] + sum(b * v for b, v in zip(d.b[i], x, strict=False))
            for i in range(n - 1)
        ]
        last = d.g[-1] * u + self.h(t, *x)
        last += sum(p * f(t, *x) for p, f in zip(d.theta, self.phi, strict=True))
        rates.append(last)
        rates = [r + tau * w(t + shift, *x) for r, tau, w in zip(rates, d.tau, self.w, strict=True)]
        return np.array([*rates, *updates])

    def nodes(self) -> np.ndarray:
        """Switches, breaks, and a fine grid around every bump."""
        times = [0.0, DURATION, *self.drawn.switches]
        times += self.system.reference.breaks(0.0, DURATION).tolist()
        for at, width in self.drawn.bumps:
            times += (at + width * np.linspace(-6, 6, 13)).tolist()
            times += (at + width * np.geomspace(12, 100, 6)).tolist()
            times += (at - width * np.geomspace(12, 100, 6)).tolist()
        times = np.unique(times)
        return times[(times >= 0) & (times <= DURATION)]

    def solve(self, grid: np.ndarray, tolerance: float = 1e-12) -> np.ndarray:
        """Plant states on a grid."""
        y, columns = np.array(self.system.start, dtype=float), []
        nodes = self.nodes()
        for begin, end in zip(nodes[:-1], nodes[1:], strict=True):
            inside = 1e-12 + 1e-9 * (end - begin)
            rates = partial(self._inside, begin + inside, end - inside)
            solver = DOP853(rates, begin, y, end, rtol=tolerance, atol=tolerance)
            while solver.status == "running":
                solver.step()
                assert solver.status != "failed"
                dense = solver.dense_output()
                here = grid[(grid >= solver.t_old) & (grid < solver.t)]
                columns += [dense(t) for t in here]
            y = solver.y
        columns += [y] * int(grid[-1] == DURATION)
        return np.array(columns).T[: self.drawn.n]

    def _inside(self, low, high, t, y):
        return self.rates(t, y, min(max(t, low), high) - t)


def amplification(system) -> float:
    """How many times a run's states move as much as its start, at most."""
    grid = np.linspace(0, DURATION, 81)
    simulator = certrack.Simulator(system)
    n, push = len(system.settings.x0), 1e-6
    moved = system.with_settings(
        x0=[x + push for x in system.settings.x0], estimates=[z + push for z in system.estimates]
    )
    a, b = (simulator.run(each).trajectory.interpolate(grid)[:n] for each in (system, moved))
    return max(1.0, float(np.abs(a - b).max() / push))


def by_hand(seed: int):
    """System `seed` and the loop by hand."""
    drawn = draw(seed)
    system = certrack.loads(drawn.text)
    return system, ByHand(drawn, system)


def lean_chain(duration: float = 20_000.0):
    """An adaptive chain of twelve states without damping, in a run too long for its steps."""
    n = 12
    text = f"""
[plant]
states = {[f"x{i + 1}" for i in range(n)]}
chain = {[1] * (n - 1)}
drift = "0"
regressor = ["sin(x1)"]
gain_sign = 1
[plant.uncertainty]
tau = {[0] * (n - 1) + [1]}
gamma = {[0] * n}
beta = {[0] * (n - 1) + [0.1]}
[truth]
input_gain = 1
theta = [0.5]
omega = {["0"] * (n - 1) + ["0.1*sin(t)"]}
[reference]
signal = "0.2*sin(t)"
[law]
kind = "adaptive"
c = {[2.0] * n}
delta0 = 1
[simulation]
x0 = {[0] * n}
duration = {duration}
integrator = "taylor"
"""
    return certrack.loads(text.replace("'", '"'))

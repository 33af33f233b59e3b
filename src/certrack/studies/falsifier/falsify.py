"""The falsifier: hunt for the worst that the assumptions admit, to see how tight a certificate is.

Adversary, all within the assumptions by construction:

* disturbances w_k = tanh(m_k sin(omega_k t + phase_k) + v_k . x) (gamma_k ||x|| + beta_k): nearly
  bang-bang patterns with searched frequency, phase, hardness and state feedback;
* references of searched amplitude, frequency, phase and shape within Y_0 ... Y_{q+1};
* g_n and theta within the ranges of the file.

A population is evolved on the batched integrator to maximise |e_1| after the transient; the best
case is polished alone, written as a system file and replayed there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution, minimize

from certrack.core.errors import InputError
from certrack.integrators.base import Outcome
from certrack.integrators.many.batch import BatchIntegrator
from certrack.integrators.single.taylor import available
from certrack.loops.continuous import close_loop, parameter_values
from certrack.model.truth import Truth
from certrack.references import SymbolicReference
from certrack.simulation.simulator import simulate
from certrack.systems.system import System

GRID = 600
MAX_HARDNESS = 30.0
ESCAPED = 1e3  # score of a run that escapes


@dataclass(frozen=True)
class Gene:
    """One searched number: its name among the constants, and its range."""

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class Falsification:
    """The worst case found.

    Attributes
    ----------
    worst_error : float
        Largest |e_1| after the transient, replayed by the ordinary simulation; inf if it escapes.
    system : System
        Replays it.
    evaluations : int
        Runs spent.
    """

    worst_error: float
    system: System
    evaluations: int


def falsify(
    system: System,
    *,
    budget: int = 6000,
    seed: int = 0,
    progress: Callable[[int, float], None] = lambda _n, _worst: None,
) -> Falsification:
    """Search the worst admissible case of `system`.

    Parameters
    ----------
    system : System
        Its law, ranges and uncertainty; the search replaces disturbance, reference and start. The
        loop is the continuous one, which certificates are of; an implementation is left out.
    budget : int
        Number of runs.
    seed : int
        Of the population.
    progress : callable
        Gets the runs so far and the worst error so far.

    Raises
    ------
    InputError
        If heyoka is missing, a bound of the reference cannot be proven, or the truth has states
        of its own.
    """
    if system.truth.states:
        raise InputError(
            "truth.states",
            "falsify searches disturbances of the design's plant, not of one with own states",
            remedy="Give the truth in the design's form, or vary it by certrack ensemble",
        )
    if not available():
        raise InputError(
            "falsify", "needs heyoka, which is not installed", remedy="conda-forge has it"
        )
    hunt = _Hunt(system.replace(implementation=None))
    spent = 0
    size = max(32, min(96, 8 * (len(hunt.genes) // 2)))

    def scores(points: np.ndarray) -> np.ndarray:
        nonlocal spent
        table = points.reshape(len(hunt.genes), -1)
        spent += table.shape[1]
        found = hunt.errors(table)
        progress(spent, float(found.max()))
        return -found

    bounds = [(gene.low, gene.high) for gene in hunt.genes]
    rng = np.random.default_rng(seed)
    lows, highs = np.array(bounds).T
    start = rng.uniform(lows, highs, (size, len(bounds)))
    start[: len(hunt.seeds)] = hunt.seeds
    evolved = differential_evolution(
        scores,
        bounds,
        vectorized=True,
        updating="deferred",
        init=start,
        maxiter=max(1, budget // size - 1),
        polish=False,
        rng=rng,
        tol=0.0,
        atol=0.0,
        mutation=(0.4, 0.9),
        recombination=0.8,
    )
    polished = minimize(
        lambda p: float(scores(np.clip(p, lows, highs)[:, None])[0]),
        evolved.x,
        method="Nelder-Mead",
        options={"maxfev": max(50, budget // 20), "xatol": 1e-6, "fatol": 1e-9},
    )
    candidates = (evolved.x, np.clip(polished.x, lows, highs))
    best = min(candidates, key=lambda p: float(scores(p[:, None])[0]))
    case = hunt.case(best)
    replayed = simulate(case)
    worst = float(replayed.metrics.tail_error)
    if replayed.outcome is Outcome.escaped:
        worst = math.inf
    elif math.isnan(worst):  # stopped before the tail: the run shows nothing
        worst = 0.0
    return Falsification(worst, case, spent)


class _Hunt:
    """The adversarial closed loop, compiled once, with every gene a runtime parameter."""

    def __init__(self, system: System) -> None:
        self.system = system
        plant, u = system.plant, system.plant.uncertainty
        self.q = system.controller.coordinates.q
        self.Y = system.reference.bounds(self.q + 1).values
        slow = 1.0 / max(1e-9, -system.controller.coordinates.poles.real.max())
        leaks = [getattr(system.law, name, 0.0) for name in ("leak_gain", "leak_theta")]
        rates = [leak * getattr(system.law, "gain_rate", 1.0) for leak in leaks if leak]
        slow = max(slow, *(1.0 / rate for rate in rates), 0.0)
        fastest = max(0.5, min(10.0, system.controller.coordinates.fastest_pole))
        self.fastest = fastest
        self.transient = min(500.0, 25.0 * slow)  # e^-25: nothing is left of the start
        self.duration = self.transient + min(100.0, max(4.0 * slow, 12.0))
        self.active = [k for k in range(plant.n) if u.tau[k] * (u.gamma[k] + u.beta[k]) > 0]
        self.genes = self._genes(fastest)
        self.seeds = self._seeds()
        self.template = self._system({gene.name: (gene.low + gene.high) / 2 for gene in self.genes})
        self.loop = close_loop(self.template)
        self.batch = BatchIntegrator(self.loop, 1e-7)
        self.base = parameter_values(self.loop, self.template)
        self.index = {symbol.name: i for i, symbol in enumerate(self.loop.parameters)}
        self.times = np.concatenate([[0.0], np.linspace(self.transient, self.duration, GRID)])

    def _genes(self, fastest: float) -> list[Gene]:
        plant = self.system.plant
        genes = [
            Gene("adv_size", 0.0, 1.0),
            Gene("adv_speed", 0.0, 1.0),
            Gene("adv_phase", 0.0, 2 * math.pi),
        ]
        genes += [Gene("adv_shape", 0.05, 0.999)] if self.q == 0 else []
        for k in self.active:
            genes += [
                Gene(f"adv_m{k}", 0.0, MAX_HARDNESS),
                Gene(f"adv_w{k}", 0.05, fastest),
                Gene(f"adv_p{k}", 0.0, 2 * math.pi),
                *(Gene(f"adv_v{k}_{j}", -MAX_HARDNESS, MAX_HARDNESS) for j in range(plant.n)),
            ]
        if plant.input_gain_range and len(set(plant.input_gain_range)) > 1:
            genes.append(Gene("truth_gain", *plant.input_gain_range))
        for i, box in enumerate(plant.theta_range or ()):
            genes += [Gene(f"truth_theta{i}", *box)] if box[0] < box[1] else []
        return genes

    def _seeds(self) -> np.ndarray:
        """Plausible adversaries to begin with: in step with the reference, no feedback."""
        speed = self.Y[1] / self.Y[0] if self.Y[0] else 1.0
        rows = []
        for factor in (1.0, 2.0, 0.5, 3.0):
            for phase in np.arange(4) * math.pi / 2:
                point = {"adv_size": 1.0, "adv_speed": 1.0, "adv_phase": 0.0, "adv_shape": 0.9}
                for k in self.active:
                    point |= {f"adv_m{k}": 10.0, f"adv_w{k}": factor * speed, f"adv_p{k}": phase}
                rows.append(
                    [
                        min(max(point.get(g.name, 0.0), g.low), g.high)
                        if g.name in point or g.low <= 0 <= g.high
                        else (g.low + g.high) / 2
                        for g in self.genes
                    ]
                )
        return np.array(rows)

    def _reference(self, point: dict[str, float]) -> tuple[str, dict[str, float]]:
        """Amplitude, frequency, phase and shape within the bounds Y."""
        amplitude = self.Y[0] * (0.02 + 0.98 * point["adv_size"])
        if self.q == 0:
            k = point["adv_shape"]  # asin(k sin) is nearly a triangle as k -> 1
            w = self.Y[1] * math.asin(k) / (amplitude * k) if amplitude else 1.0
            values = {"ref_a": amplitude / math.asin(k), "ref_k": k}
            text = "ref_a*asin(ref_k*sin(ref_w*t + ref_p))"
        else:
            limits = [(Y / amplitude) ** (1 / i) for i, Y in enumerate(self.Y) if i and amplitude]
            w = min(limits, default=1.0)
            values = {"ref_a": amplitude}
            text = "ref_a*sin(ref_w*t + ref_p)"
        speed = min(w, 3.0 * self.fastest) * (0.05 + 0.95 * point["adv_speed"])
        return text, values | {"ref_w": speed * (1 - 1e-12), "ref_p": point["adv_phase"]}

    def _omega(self, number: Callable[[str], str]) -> list[str]:
        plant, u = self.system.plant, self.system.plant.uncertainty
        # smooth at zero, and never above ||x||
        norm = "(sqrt(" + " + ".join(f"{x}**2" for x in plant.states) + " + 1e-8) - 1e-4)"
        terms = []
        for k in range(plant.n):
            if k not in self.active:
                terms.append("0")
                continue
            pattern = f"{number(f'adv_m{k}')}*sin({number(f'adv_w{k}')}*t + {number(f'adv_p{k}')})"
            for j, x in enumerate(plant.states):
                pattern += f" + {number(f'adv_v{k}_{j}')}*{x}"
            limit = f"{u.gamma[k]!r}*{norm} + {u.beta[k]!r}" if u.gamma[k] else repr(u.beta[k])
            terms.append(f"0.999999*tanh({pattern})*({limit})")
        return terms

    def _system(self, point: dict[str, float]) -> System:
        """The loop with genes as constants: the plant's for omega, its own for the reference."""
        plant = self.system.plant
        adversary = {g.name: point[g.name] for g in self.genes if g.name.startswith("adv_")}
        own = dict(plant.constants) | {k: v for k, v in adversary.items() if _of_omega(k)}
        text, values = self._reference(point)
        names = {name.removeprefix("ref_"): v for name, v in values.items()}
        signal = text.replace("ref_", "r_")
        constants = {f"r_{name}": v for name, v in names.items()}
        return self._assembled(
            replace(plant, constants=own),  # type: ignore[arg-type]
            self._omega(lambda name: name),
            SymbolicReference(signal, constants=constants),  # type: ignore[arg-type]
            point,
        )

    def case(self, genes: np.ndarray) -> System:
        """The found case with its numbers written out."""
        point = {gene.name: float(v) for gene, v in zip(self.genes, genes, strict=True)}
        text, values = self._reference(point)
        for name, value in values.items():
            text = text.replace(name, f"({value!r})")
        omega = self._omega(lambda name: f"({point[name]!r})")
        return self._assembled(self.system.plant, omega, SymbolicReference(text), point)  # type: ignore[arg-type]

    def _assembled(self, plant: Any, omega: Any, reference: Any, point: dict[str, float]) -> System:
        truth = self.system.truth
        theta = [point.get(f"truth_theta{i}", v) for i, v in enumerate(truth.theta)]
        return System(
            plant=plant,
            law=self.system.law,
            reference=reference,
            truth=Truth(
                point.get("truth_gain", truth.input_gain),  # type: ignore[arg-type]
                tuple(theta),  # type: ignore[arg-type]
                tuple(omega),
            ),
            settings=replace(
                self.system.settings, duration=self.duration, tail=self.transient, integrator="auto"
            ),
            title=f"Worst case found for: {self.system.title}",
        )

    def errors(self, table: np.ndarray) -> np.ndarray:
        """Largest |e_1| after the transient of every member; genes (G, N)."""
        count = table.shape[1]
        parameters = np.repeat(self.base[:, None], count, axis=1)
        points = [
            {gene.name: float(v) for gene, v in zip(self.genes, column, strict=True)}
            for column in table.T
        ]
        known = list(self.template.plant.constant_values)
        for i, name in enumerate(known):
            if name in points[0]:
                values = [point[name] for point in points]
                parameters[self.index[f"true_constants_{i}"]] = values
                parameters[self.index[name]] = values
        references = [self._reference(point)[1] for point in points]
        for name in references[0]:
            parameters[self.index[f"ref_r_{name.removeprefix('ref_')}"]] = [
                r[name] for r in references
            ]
        for gene, row in zip(self.genes, table, strict=True):
            if gene.name == "truth_gain":
                parameters[self.index[f"true_g_{self.system.plant.n - 1}"]] = row
            elif gene.name.startswith("truth_theta"):
                parameters[self.index[f"true_theta_{gene.name[11:]}"]] = row
        starts = np.repeat(np.array([*self.template.start, 0.0, 0.0, 0.0])[:, None], count, axis=1)
        worst = np.zeros(count)
        a, w, p = (np.array([r[k] for r in references]) for k in ("ref_a", "ref_w", "ref_p"))
        shape = np.array([r.get("ref_k", 0.0) for r in references])

        def look(states: np.ndarray, escaped: np.ndarray, members: slice) -> None:
            wave = np.sin(w[members] * self.times[1:, None] + p[members])
            bent = np.arcsin(shape[members] * wave) if self.q == 0 else wave
            error = np.abs(states[1:, 0] - a[members] * bent)
            seen = np.nan_to_num(error, nan=0.0).max(axis=0)  # a run cut short shows what it has
            worst[members] = np.where(escaped, ESCAPED, seen)

        self.batch.over_time(starts, parameters, self.times, look)
        return worst


def _of_omega(name: str) -> bool:
    return name[4] in "mwpv" and name[5:6].isdigit()

"""L. Liu, G. Sun, R. Bai, Actuators 14(8):367, 2025, doi:10.3390/act14080367.

Runs both examples, draws Figures 2 to 4, and sets every claim beside what is measured. Our copy of
the paper has lost minus signs, so Example 1 is run with every sign of x(0) and y_d.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import count, pairwise, product

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from certrack.certificates import Tube, certify
from certrack.core.progress import Progress, silent
from certrack.plotting import (
    figure,
    plot_error,
    plot_estimates,
    plot_input,
    plot_output,
    plot_states,
    style,
)
from certrack.references import SymbolicReference
from certrack.simulation.run import Run
from certrack.simulation.simulator import Simulator, simulate
from certrack.studies.falsifier.falsify import falsify
from certrack.systems.reader import load
from certrack.systems.system import System

#: Both examples, the theorem, four systems certified and falsified, the figures.
STEPS = 8

HOLDS, DIFFERS, AMBIGUOUS = "holds", "differs", "ambiguous"


@dataclass(frozen=True)
class Claim:
    """A statement of the paper and what we measure.

    Attributes
    ----------
    where, statement, measured : str
    verdict : {"holds", "differs", "ambiguous"}
    """

    where: str
    statement: str
    measured: str
    verdict: str


@dataclass(frozen=True)
class Reproduction:
    """Result of :func:`reproduce`.

    Attributes
    ----------
    claims : tuple of Claim
    figures : figures by file name, without its extension
    runs : runs by the name of the shipped system
    bounds : by the name of the system, then by kind: certified, falsified and simulated sup |e_1|
    """

    claims: tuple[Claim, ...]
    figures: dict[str, Figure]
    runs: dict[str, Run]
    bounds: dict[str, dict[str, float]]

    def __repr__(self) -> str:
        verdicts = [claim.verdict for claim in self.claims]
        counts = (f"{verdicts.count(v)} {v}" for v in (HOLDS, DIFFERS, AMBIGUOUS))
        return f"Reproduction({len(verdicts)} claims: {', '.join(counts)})"


def reproduce(progress: Progress = silent, budget: int = 3000) -> Reproduction:
    """Run the paper's examples and judge its claims.

    Parameters
    ----------
    progress : callable
        Gets the steps done, their number and None.
    budget : int
        Runs that the falsifier spends on each system.

    Returns
    -------
    Reproduction

    Examples
    --------
    >>> import certrack
    >>> result = certrack.reproduce(budget=100)  # doctest: +SKIP
    >>> [claim.verdict for claim in result.claims]  # doctest: +SKIP
    """
    steps = count()

    def report() -> None:
        progress(next(steps), STEPS, None)

    report()
    variants = dict(_example1_variants())
    improved, classic = variants[((1, 2), 1)]
    report()
    motor = Simulator(load("dual-motor"))
    weak, strong = motor.run(), motor.run(load("dual-motor-strong"))
    signs: list[tuple[int, ...]] = [(1, 1, 1, 0), (-1, 1, 1, 0), (1, -1, -1, 0)]
    starts = {x0: _run_from(motor, x0) for x0 in signs}
    report()
    theorem = _theorem_1()
    claims = (
        *_claims_example1(variants),
        *_claims_example2(weak, strong, starts),
        theorem,
    )
    bounds, tubes = {}, {}
    for name in ("example1", "dual-motor", "dual-motor-strong", "dual-motor-lean"):
        report()
        bounds[name], tubes[name] = _bounds(load(name), budget)
    report()
    runs = {
        "example1": improved,
        "example1-classic": classic,
        "dual-motor": weak,
        "dual-motor-strong": strong,
    }
    certified = {"example1": improved, "dual-motor": weak, "dual-motor-strong": strong}
    certified["dual-motor-lean"] = simulate(load("dual-motor-lean"))
    panels = figures(runs) | {"certificates": _certificate_figure(certified, tubes)}
    report()
    return Reproduction(claims, panels, runs, bounds)


def _bounds(system: System, budget: int) -> tuple[dict[str, float], Tube | None]:
    """Certified, simulated and falsified errors of one system."""
    certificates = certify(system)
    return {
        "published": certificates.published.bound,
        "corrected": certificates.corrected.bound,
        "semidefinite": certificates.semidefinite.bound,
        "tightest": certificates.best.bound,
        "falsified": falsify(system, budget=budget).worst_error,
        "simulated": simulate(system).metrics.tail_error,
    }, certificates.tube


def _certificate_figure(runs: dict[str, Run], tubes: dict[str, Tube | None]) -> Figure:
    """Certified tube over the response of every example, magnitudes on a logarithmic scale."""
    with style():
        panels = Figure(figsize=(7.0, 5.0), layout="constrained")
        for ax, (name, run) in zip(
            panels.subplots(2, 2, sharex=True).flat, runs.items(), strict=True
        ):
            ax.semilogy(run.t, np.maximum(np.abs(run.e[0]), 1e-7), label="$|e_1|$")
            tube = tubes[name]
            if tube is not None:
                ax.semilogy(run.t, tube(run.t), "--", label="certified tube")
                ax.set_ylim(0.02 * math.sqrt(tube.floor), 2 * math.sqrt(tube.start))
            ax.set_title(name, loc="left")
            ax.set_xlabel("time [s]")
            ax.set_ylabel("tracking error")
            ax.legend(loc="upper right")
    return panels


def figures(runs: dict[str, Run]) -> dict[str, Figure]:
    """Figures 2 (a-d), 3 (a-c) and 4 (a-c)."""
    laws = {"improved": runs["example1"], "classic": runs["example1-classic"]}
    panels = {
        "figure-2a": figure(plot_output, laws, "2(a) Example 1: output"),
        "figure-2b": figure(plot_error, laws, "2(b) Example 1: tracking error"),
        "figure-2c": figure(plot_estimates, laws, "2(c) Example 1: estimates"),
        "figure-2d": figure(plot_input, laws, "2(d) Example 1: input"),
    }
    for number, name, tau in ((3, "dual-motor", 1), (4, "dual-motor-strong", 5)):
        one = {name: runs[name]}
        for letter, what, panel in (
            ("a", "output", plot_output),
            ("b", "states", plot_states),
            ("c", "input", plot_input),
        ):
            title = f"{number}({letter}) Example 2, $\\tau$ = {tau}: {what}"
            panels[f"figure-{number}{letter}"] = figure(panel, one, title)
    return panels


def _variant(system: System, x0: tuple[int, int], sign: int) -> System:
    """Example 1 from the start `x0`, with the sign of y_d = +-0.2 cos t.

    y_d -> -y_d is a shift by pi in cos, so the compiled loop would differ; each sign has its own.
    """
    reference = SymbolicReference("0.2*cos(t)" if sign > 0 else "-0.2*cos(t)", bound=0.4)  # type: ignore[arg-type]
    return replace(system, reference=reference).with_settings(x0=x0)


def _example1_variants() -> Iterator[tuple[tuple[tuple[int, int], int], tuple[Run, Run]]]:
    improved, classic = load("example1"), load("example1-classic")
    for sign in (1, -1):
        both = [Simulator(_variant(law, (1, 2), sign)) for law in (improved, classic)]
        for x0 in product((1, -1), (2, -2)):
            runs = [s.run(_variant(s.system, x0, sign)) for s in both]
            yield (x0, sign), (runs[0], runs[1])


def _run_from(simulator: Simulator, x0: tuple[int, ...]) -> Run:
    return simulator.run(simulator.system.with_settings(x0=x0))


Variants = dict[tuple[tuple[int, int], int], tuple[Run, Run]]


def _claims_example1(variants: Variants) -> Iterator[Claim]:
    improved, classic = variants[((1, 2), 1)]
    ours, theirs = improved.metrics, classic.metrics

    def every(test: Callable[[Run, Run], bool]) -> str:
        holding = sum(test(a, b) for a, b in variants.values())
        return f"in {holding} of {len(variants)} sign variants"

    def faster(a: Run, b: Run) -> bool:
        return not a.metrics.settling_time > b.metrics.settling_time

    yield Claim(
        "Example 1",
        "the improved law tracks after about 3 s",
        f"|e_1| < 0.05 from {ours.settling_time:.2f} s on; "
        + every(lambda a, b: a.metrics.settling_time < 3.5)
        + " before 3.5 s",
        HOLDS if ours.settling_time < 3.5 else DIFFERS,
    )
    yield Claim(
        "Example 1",
        "the classic law tracks only after 10 s",
        f"|e_1| < 0.05 from {theirs.settling_time:.2f} s on; improved is faster " + every(faster),
        HOLDS if theirs.settling_time > 10 and faster(improved, classic) else DIFFERS,
    )
    smaller = ours.tail_error < theirs.tail_error
    yield Claim(
        "Example 1",
        "the improved law fluctuates less after tracking",
        f"sup |e_1|, t > 10 s: {ours.tail_error:.4f} against {theirs.tail_error:.4f}",
        HOLDS if smaller else DIFFERS,
    )
    late = [_supremum(run, 15.0) for run in (improved, classic)]
    yield Claim(
        "Example 1",
        "the improved law has the smaller error (also at the end of the run)",
        f"sup |e_1|, t > 15 s: {late[0]:.4f} against {late[1]:.4f}; the classic law ends "
        f"{late[0] / late[1]:.1f}x more accurate",
        HOLDS if late[0] < late[1] else DIFFERS,
    )
    yield Claim(
        "Example 1",
        "less control effort (integral of u^2)",
        f"{ours.input_energy:.1f} against {theirs.input_energy:.1f}; smaller "
        + every(lambda a, b: a.metrics.input_energy < b.metrics.input_energy),
        HOLDS if ours.input_energy < theirs.input_energy else DIFFERS,
    )
    yield Claim(
        "Example 1",
        "less control effort (peak |u|)",
        f"{ours.peak_input:.2f} against {theirs.peak_input:.2f}; smaller "
        + every(lambda a, b: a.metrics.peak_input < b.metrics.peak_input),
        HOLDS if ours.peak_input < theirs.peak_input else DIFFERS,
    )
    settling = [a.metrics.settling_time for a, _ in variants.values()]
    peaks = [a.metrics.peak_input for a, _ in variants.values()]
    yield Claim(
        "Example 1",
        "x(0) and y_d (their signs are lost in our copy)",
        f"over all {len(variants)} signs: settling {min(settling):.2f} to {max(settling):.2f} s, "
        f"peak |u| {min(peaks):.1f} to {max(peaks):.1f}",
        AMBIGUOUS,
    )


def _claims_example2(weak: Run, strong: Run, starts: dict[tuple[int, ...], Run]) -> Iterator[Claim]:
    a, b = weak.metrics, strong.metrics
    yield Claim(
        "Example 2",
        "the servo tracks after about 2 s",
        f"|e_1| < 0.05 from {a.settling_time:.2f} s on, within its final {a.tail_error:.4f} from "
        f"{_settled(weak, 1.05 * a.tail_error):.2f} s on",
        HOLDS if a.settling_time < 2.5 else DIFFERS,
    )
    amplitude = 0.1
    yield Claim(
        "Example 2",
        "the output tracks the reference",
        f"sup |e_1|, t > 10 s: {a.tail_error:.4f}, {100 * a.tail_error / amplitude:.0f} % of the "
        "amplitude: the published gains track poorly",
        HOLDS if a.tail_error < 0.1 * amplitude else DIFFERS,
    )
    apart = np.abs(_states_on_grid(weak) - _states_on_grid(strong)).max(axis=1)
    yield Claim(
        "Example 2",
        "tau = 5 instead of 1 hardly changes output and states",
        f"tail error {a.tail_error:.4f} and {b.tail_error:.4f}; largest difference "
        + ", ".join(f"x{i + 1} {value:.2g}" for i, value in enumerate(apart)),
        HOLDS if (apart < 0.05 * np.abs(_states_on_grid(weak)).max(axis=1)).all() else DIFFERS,
    )
    inputs = [_supremum(run, 10.0, of="u") for run in (weak, strong)]
    yield Claim(
        "Example 2",
        "tau = 5 only raises the input",
        f"max |u|, t > 10 s: {inputs[0]:.3f} and {inputs[1]:.3f}",
        HOLDS if inputs[1] > inputs[0] else DIFFERS,
    )
    peaks = ", ".join(f"{x0}: {run.metrics.peak_input:.1f}" for x0, run in starts.items())
    yield Claim(
        "Example 2",
        "x(0) (one sign is lost in our copy)",
        f"peak |u| from {peaks}; we take (-1, 1, 1, 0)",
        AMBIGUOUS,
    )


def _theorem_1() -> Claim:
    """The last step of the proof, refuted by a system that meets its premises.

    e' = -e + S s(t) q,  q' = -gbar S s(t) e - gbar (q - 1),  s(t) = 1 where sin(0.01 t) > 0.6.
    V = e^2/2 + q^2/(2 gbar) has V' <= -||(e, q)||^2/2 + 1/2, so V falls wherever |e| > 1. The
    proof concludes that |e| falls there too and ends below 1.
    """
    gbar, strength = 0.05, 8.0
    worst = theorem_1_counterexample(gbar, strength)
    corrected = math.sqrt(2 * max(0.5, 1 / (2 * gbar)))
    return Claim(
        "Theorem 1",
        "V' < 0 while |e_1| > r implies limsup |e_1| <= r (last step of the proof)",
        f"a system with r = 1 and V' < 0 wherever |e_1| > 1 returns to |e_1| = {worst:.2f} in "
        f"every period; the corrected bound is {corrected:.2f}",
        HOLDS if worst <= 1 else DIFFERS,
    )


def theorem_1_counterexample(gbar: float = 0.05, strength: float = 8.0) -> float:
    """Largest |e| of the refuting system in its second to fourth period."""
    on, off = math.asin(0.6), math.pi - math.asin(0.6)
    edges = sorted(100 * (2 * math.pi * k + phase) for k in range(4) for phase in (on, off))
    times = [0.0, *edges, 100 * 8 * math.pi]
    state, worst = np.array([0.0, 1.0]), 0.0
    for begin, end in pairwise(times):
        s = strength * (math.sin(0.005 * (begin + end)) > 0.6)
        matrix = np.array([[-1.0, s], [-gbar * s, -gbar]])
        run = solve_ivp(
            lambda t, y, m=matrix: m @ y + (0.0, gbar),
            (begin, end),
            state,
            method="DOP853",
            rtol=1e-9,
            atol=1e-12,
            max_step=0.05,
        )
        state = run.y[:, -1]
        if begin > 100 * 2 * math.pi:
            worst = max(worst, float(np.abs(run.y[0]).max()))
    return worst


def _supremum(run: Run, start: float, of: str = "e") -> float:
    values = run.u if of == "u" else run.e[0]
    return float(np.abs(values[run.t >= start]).max())


def _settled(run: Run, band: float) -> float:
    outside = np.flatnonzero(np.abs(run.e[0]) > band)
    return float(run.t[outside[-1]])


def _states_on_grid(run: Run) -> np.ndarray:
    return run.trajectory.interpolate(np.linspace(0, run.trajectory.end, 2001))[
        : run.system.plant.n
    ]

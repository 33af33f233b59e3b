"""Pictures of what is proven: the tubes of the examples, and the run that exceeds (42)."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from certrack.core.rounding import rounded_up
from certrack.papers.liu2025.runs import COUNTEREXAMPLE, PaperRuns
from certrack.papers.liu2025.theorem1 import REFERENCE_PERIOD, energies
from certrack.plotting.shared import BLUE, GREEN, RED, new_figure, set_title, style

#: The pulse of the third period: from so long before its peak to so long after, s.
BEFORE_PEAK, AFTER_PEAK = 2.0, 6.0


def tubes_figure(runs: PaperRuns) -> Figure:
    """Certified tube over the response of every example, magnitudes on a logarithmic scale."""
    shown = {
        "example1": runs.example1[(1, 2), 1][0],
        "dual-motor": runs.weak,
        "dual-motor-strong": runs.strong,
        "dual-motor-lean": runs.lean,
    }
    with style():
        figure = Figure(figsize=(7.0, 5.0), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True)
        for ax, (name, run) in zip(axes.flat, shown.items(), strict=True):
            ax.semilogy(run.t, np.maximum(np.abs(run.e[0]), 1e-7), label="$|e_1|$")
            tube = runs.certificates[name].tube
            if tube is not None:
                ax.semilogy(run.t, tube(run.t), "--", label="certified tube")
                ax.set_ylim(0.02 * math.sqrt(tube.floor), 2 * math.sqrt(tube.start))
            ax.set_title(name, loc="left")
            ax.set_xlabel("time [s]")
            ax.set_ylabel("tracking error")
            ax.legend(loc="upper right")
    return figure


def counterexample_figure(runs: PaperRuns) -> Figure:
    """|e_1| over three periods with every bound; one pulse; the energies during the pulse."""
    run, certificates = runs.counterexample, runs.certificates[COUNTEREXAMPLE]
    published = certificates.published.bound
    late = run.t >= 2 * REFERENCE_PERIOD
    peak = float(run.t[late][np.argmax(np.abs(run.e[0][late]))])
    t = np.linspace(peak - BEFORE_PEAK, peak + AFTER_PEAK, 4001)
    error = run.trajectory.interpolate(t)[0] - run.system.reference.values(t, 0)[0]
    of_errors, of_estimates = energies(run, t)
    with style():
        figure = new_figure(6.5, 6.4)
        periods, pulse, energy = figure.subplots(3, 1)
        set_title(figure, "Theorem 1 exceeded inside its own class")
        periods.semilogy(run.t, np.maximum(np.abs(run.e[0]), 1e-6), color=BLUE, label="$|e_1|$")
        for bound, text, line, color in (
            (published, "(42)", "--", RED),
            (certificates.semidefinite.bound, "semidefinite", "-", GREEN),
            (certificates.corrected.bound, "corrected", ":", "k"),
        ):
            periods.axhline(bound, color=color, ls=line, label=f"{text}: {rounded_up(bound, 4)}")
        periods.set_ylim(1e-5, 100)
        periods.set_ylabel("tracking error")
        periods.set_title("three periods of $y_d$: every time the bound (42) is passed", loc="left")
        periods.legend(ncols=4, loc="upper center")
        pulse.plot(t - peak, np.abs(error), color=BLUE, label="$|e_1|$")
        pulse.axhline(published, color=RED, ls="--", label=f"(42): {rounded_up(published, 4)}")
        pulse.set_ylabel("tracking error")
        pulse.set_title("the pulse of the third period", loc="left")
        energy.plot(t - peak, of_errors + of_estimates, color="k", label="$V$")
        energy.plot(t - peak, of_estimates, color=GREEN, ls="--", label="of the estimates")
        energy.plot(t - peak, of_errors, color=BLUE, label="of the errors")
        energy.set_ylabel("energy in $V$")
        energy.set_title("$V$ falls, and yet the errors grow", loc="left")
        for ax in (pulse, energy):
            ax.set_xlabel("time after the peak [s]")
            ax.legend(loc="upper right")
            ax.margins(x=0.0)
        periods.margins(x=0.0)
        periods.set_xlabel("time [s]")
    return figure

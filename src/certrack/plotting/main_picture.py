"""The main picture of a result, whatever it is."""

from __future__ import annotations

from collections.abc import Mapping
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from certrack.certificates import Certificates
from certrack.core.errors import InputError
from certrack.plotting.certificates import certificates_figure
from certrack.plotting.energy import energy_figure
from certrack.plotting.ensembles import fan_chart
from certrack.plotting.margins import margin_figure
from certrack.plotting.optima import optima_figure
from certrack.plotting.overviews import overview
from certrack.plotting.shared import PAGE_WIDTH, in_brackets, new_figure, style
from certrack.simulation.run import Run
from certrack.studies.energy import Energy
from certrack.studies.ensembles.ensemble import Ensemble
from certrack.studies.margins import Margins
from certrack.studies.optimal.optimal import Optima
from certrack.systems.system import System

#: Times at which a reference is drawn.
SHOWN_POINTS = 2000


def plot(result: Any) -> Figure:
    """Draw what a result is looked at for.

    Parameters
    ----------
    result : Run, mapping of names to runs, System, Certificates, Ensemble, Margins, Optima, Energy
        A run, or several to compare: output, error, states, estimates and input. A system: its
        reference. Certificates: the bounds side by side, and the tube. An ensemble: its quantile
        bands. Margins: the error against period, delay and saturation. Optima: output and input
        beside those of the law. Energy: powers and balance.

    Returns
    -------
    Figure
        Of matplotlib; ``savefig`` writes it, and a notebook shows it.

    Raises
    ------
    InputError
        If there is no picture of such an object.

    Examples
    --------
    >>> import certrack
    >>> figure = certrack.plot(certrack.simulate(certrack.load("example1")))
    >>> figure.savefig("run.png")
    """
    return _drawn(result)


@singledispatch
def _drawn(result: Any) -> Figure:
    raise InputError(
        "plot",
        "draws a run, runs by name, a system, certificates, an ensemble, margins, optima or energy",
        type(result).__name__,
    )


@_drawn.register
def _draw_run(result: Run) -> Figure:
    return overview({"": result}, result.system.title)


@_drawn.register(Mapping)
def _draw_runs(result: Mapping[str, Run]) -> Figure:
    if not result or not all(isinstance(run, Run) for run in result.values()):
        raise InputError("plot", "a mapping must hold runs by name", list(result))
    return overview(result)


@_drawn.register
def _draw_ensemble(result: Ensemble) -> Figure:
    return fan_chart(result)


@_drawn.register
def _draw_margins(result: Margins) -> Figure:
    return margin_figure(result, "", None)


@_drawn.register
def _draw_optima(result: Optima) -> Figure:
    return optima_figure(result, result.run.system.title)


@_drawn.register
def _draw_energy(result: Energy) -> Figure:
    return energy_figure(result, result.system.title)


@_drawn.register
def _draw_certificates(result: Certificates) -> Figure:
    return certificates_figure(result)


@_drawn.register
def _draw_system(result: System) -> Figure:
    end = result.settings.duration
    t = np.union1d(np.linspace(0.0, end, SHOWN_POINTS), result.reference.breaks(0.0, end))
    units = result.plant.units
    with style():
        drawing = new_figure(PAGE_WIDTH, 1.6)
        ax = drawing.subplots()
        ax.plot(t, result.reference.values(t, 0)[0], color="k", lw=1.0)
        ax.set_xlabel("time [s]")
        ax.set_ylabel("reference $y_d$" + in_brackets(units[0] if units else ""))
        ax.margins(x=0.01)
    return drawing

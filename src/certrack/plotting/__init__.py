"""Pictures of runs, certificates, ensembles, margins, fronts, optima and energy.

Figures are made without pyplot, so nothing global is touched and no window opens. The functions
``plot_...`` draw on any axes, of pyplot's figures too: ``plot_error(ax, {"adaptive": run})``. Their
legend names the runs, and a curve never gets the style of another one on the same axes.
"""

from certrack.plotting.appearance import Appearance
from certrack.plotting.certificates import certificates_figure
from certrack.plotting.curves import Runs
from certrack.plotting.energy import energy_figure
from certrack.plotting.ensembles import (
    ensemble_figures,
    fan_chart,
    metric_histograms,
    plot_fan,
)
from certrack.plotting.fronts import front_figure
from certrack.plotting.main_picture import plot
from certrack.plotting.margins import drift_figure, margin_figure
from certrack.plotting.optima import optima_figure
from certrack.plotting.overviews import figure, overview, panels_for
from certrack.plotting.references import reference_figure
from certrack.plotting.runs import (
    PANELS,
    Panel,
    plot_error,
    plot_estimates,
    plot_input,
    plot_output,
    plot_states,
)
from certrack.plotting.shared import STYLE, save_figure, style
from certrack.plotting.show import show
from certrack.plotting.starts import starts_figure
from certrack.plotting.tubes import plot_tube, tube_figure

__all__ = [
    "PANELS",
    "STYLE",
    "Appearance",
    "Panel",
    "Runs",
    "certificates_figure",
    "drift_figure",
    "energy_figure",
    "ensemble_figures",
    "fan_chart",
    "figure",
    "front_figure",
    "margin_figure",
    "metric_histograms",
    "optima_figure",
    "overview",
    "panels_for",
    "plot",
    "plot_error",
    "plot_estimates",
    "plot_fan",
    "plot_input",
    "plot_output",
    "plot_states",
    "plot_tube",
    "reference_figure",
    "save_figure",
    "show",
    "starts_figure",
    "style",
    "tube_figure",
]

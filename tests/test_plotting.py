"""Pictures: what they show, and that drawing them warns of nothing."""

import math
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from cycler import cycler
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import certrack
from certrack import plotting
from certrack.certificates.certificate import Certificate
from certrack.certificates.tube import Tube
from certrack.core.errors import InputError
from certrack.studies.ensembles.statistics import LEVELS
from certrack.studies.margins import Margin, Margins

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def runs():
    names = ("dual-motor", "dual-motor-lean", "dual-motor-drive")
    systems = {name: certrack.load(name).with_settings(duration=1.0, tail=0.5) for name in names}
    return {name: certrack.simulate(system) for name, system in systems.items()}


def texts(legend):
    return [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("count", [2, 3])
def test_systems_differ_by_line_and_states_by_colour(runs, tmp_path, count):
    some = dict(list(runs.items())[:count])
    made = plotting.overview(some)
    plotting.save_figure(made, tmp_path, "overview")
    (systems,) = made.legends
    assert texts(systems) == list(some)
    assert len({line.get_linestyle() for line in systems.get_lines()}) == count
    states = made.axes[2].get_legend()
    assert len(states.get_texts()) == 4
    assert len({line.get_color() for line in states.get_lines()}) == 4
    width, height = made.get_size_inches() * made.dpi
    for legend in (systems, *(ax.get_legend() for ax in made.axes)):
        box = legend.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
    for ax in made.axes:
        assert ax.get_legend().get_window_extent().x0 >= ax.get_window_extent().x1


def test_long_names_stay_on_the_page(runs, tmp_path):
    run = runs["dual-motor-lean"]
    made = plotting.overview({f"{'a-folder/' * 8}{k}.toml": run for k in range(5)})
    plotting.save_figure(made, tmp_path, "overview")
    box = made.legends[0].get_window_extent()
    assert box.x0 >= 0 and box.x1 <= made.get_figwidth() * made.dpi


def test_one_run_needs_no_legend_of_systems(runs):
    made = plotting.overview({"lean": runs["dual-motor-lean"]})
    assert not made.legends
    assert len(texts(made.axes[2].get_legend())) == 4


def test_the_input_of_a_sampled_run_is_a_staircase(runs):
    run = runs["dual-motor-drive"]
    made = plotting.figure(plotting.plot_input, {"": run})
    t, u = made.axes[0].lines[0].get_data()
    rising = np.diff(t) > 1e-9
    assert np.all(np.diff(u)[rising] == 0) and np.any(np.diff(u) != 0)


def drawn_labels(axis):
    """Boxes of the tick labels that are seen."""
    low, high = sorted(axis.get_view_interval())
    ticks = [t for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
    boxes = [t.label1.get_window_extent() for t in ticks if t.label1.get_text()]
    return sorted(boxes, key=lambda box: box.x0)


@pytest.mark.slow
@pytest.mark.parametrize("span", [(0.00125, 0.0013), (0.0005, 0.002), (1e-4, 2e-2), (1e-5, 3.0)])
def test_margin_figure_of_any_span(tmp_path, span):
    values = tuple(np.geomspace(*span, 9).tolist())
    one = Margin(span[0], span[0], None, False, values, (*[1e-3] * 8, math.inf))
    found = Margins(1e-2, "given", 8, span[0], None, one, one, one)
    made = plotting.margin_figure(found, "title", ["rad", "1"])
    plotting.save_figure(made, tmp_path, "margin")
    for ax in made.axes:
        boxes = drawn_labels(ax.xaxis)
        assert len(boxes) >= 2
        assert all(a.x1 < b.x0 for a, b in zip(boxes, boxes[1:], strict=False))
    assert made.axes[0].get_xlabel() == "sampling period [ms]"
    (legend,) = made.legends
    assert texts(legend) == ["worst member", "lost, or off the scale", "admitted"]
    assert all(legend.get_window_extent().y1 < ax.get_window_extent().y0 for ax in made.axes)


@pytest.mark.parametrize("count", [1, 2])
def test_estimates_of_other_magnitudes_have_their_own_axes(count, tmp_path):
    system = certrack.load("example1").with_settings(duration=1.0, tail=0.5)
    law = replace(system.law, gain_rate=1e-4, delta0=0.01)
    run = certrack.simulate(system.replace(law=law))
    small, large = (float(np.abs(row).max()) for row in run.z)
    assert small < 0.1 * large
    made = plotting.figure(plotting.plot_estimates, {str(k): run for k in range(count)})
    plotting.save_figure(made, tmp_path, "estimates")
    left, right = made.axes
    assert left.get_ylim()[1] > large > 5 * right.get_ylim()[1]
    assert left.get_legend() is None
    found = [r"$\hat\theta_{1}$", "true values", r"$\hat\delta$ (right)"]
    assert texts(right.get_legend()) == found
    together = plotting.figure(plotting.plot_estimates, {"": certrack.simulate(system)})
    assert len(together.axes) == 1


def test_runaways_leave_the_fan_chart_and_histograms_readable(tmp_path):
    system = certrack.load("dual-motor-lean").with_settings(duration=1.0, tail=0.5)
    calm = certrack.ensemble(system, 50)
    for name, made in plotting.ensemble_figures(calm).items():
        plotting.save_figure(made, tmp_path, name)
        assert {ax.get_yscale() for ax in made.axes} == {ax.get_xscale() for ax in made.axes}
    wild = certrack.ensemble(system, 50)
    bands = wild.bands.copy()
    bands[LEVELS.index(0.95) :, :, -5:] = 1e5
    bands[-1, :, -1] = np.inf
    wild.__dict__["bands"] = bands
    for metric in wild.statistics.metrics.values():
        metric.observe(np.array([1e5]))
    figures = plotting.ensemble_figures(wild)
    for name, made in figures.items():
        plotting.save_figure(made, tmp_path, name)
    assert {ax.get_yscale() for ax in figures["fan"].axes} == {"symlog"}
    assert "run away" in figures["fan"].axes[0].texts[0].get_text()
    axes = figures["metrics"].axes
    assert {ax.get_xscale() for ax in axes} == {"log"}
    assert axes[0].get_xlabel() == "tail error [rad]"
    assert [sum(bar.get_height() for bar in ax.patches) for ax in axes] == [51] * 4


@pytest.mark.parametrize("name", ["dual-motor-lean", "dual-motor-drive"])
def test_the_tube_is_said_to_be_of_the_continuous_law(name, runs):
    made = plotting.tube_figure(runs[name], Tube(start=9.0, floor=1e-6, alpha=1.0), "title")
    said = "continuous law" in made.axes[0].get_title(loc="left")
    (shown, *_) = [text for text in texts(made.axes[0].get_legend()) if "tube" in text]
    assert said == ("continuous law" in shown) == (name == "dual-motor-drive")


def styles(ax):
    """What tells the curves of runs on axes apart."""
    shown = [line for line in ax.lines if len(line.get_xdata()) > 2 and line.get_label() != "$y_d$"]
    return [(to_hex(line.get_color()), str(line._dash_pattern)) for line in shown]


def test_own_axes_name_the_runs_and_repeat_no_style():
    """Twelve runs, at once and one after the other, with the colours of the user's own style."""
    system = certrack.load("example1")
    simulator = certrack.Simulator(system.with_settings(duration=0.5, tail=None))
    runs = {
        f"run {k}": simulator.run(simulator.system.with_settings(x0=(0.1 * k, 0)))
        for k in range(12)
    }
    for named in ({"axes.prop_cycle": cycler(color=["#112233", "#445566"])}, {}):
        with matplotlib.rc_context(named):
            together, after = Figure(), Figure()
            ax = together.subplots()
            plotting.plot_error(ax, runs)
            assert len(set(styles(ax))) == 12
            assert set(runs) < {text.get_text() for text in ax.get_legend().get_texts()}
            ax = after.subplots()
            for name, run in runs.items():
                plotting.plot_error(ax, {name: run})
            assert len(set(styles(ax))) == 12
            texts = [text.get_text() for text in ax.get_legend().get_texts()]
            assert sorted(texts) == sorted({f"{name}: $e_1$" for name in runs} | {texts[1]})


def test_a_fan_on_own_axes_refuses_what_is_not_there():
    system = certrack.load("example1").with_settings(duration=0.5, tail=None)
    found = certrack.ensemble(system, 8, method="lockstep", limit=0.1)
    ax = Figure().subplots()
    plotting.plot_fan(ax, found, "u", color="#aa0000")
    assert ax.get_ylabel() == "$u$"
    with pytest.raises(InputError, match="signal: must be one of e_1, x1, x2, u; got x9"):
        plotting.plot_fan(ax, found, "x9")


def test_the_tube_shows_the_certificate_to_rely_on_where_its_bound_is_another(runs):
    run, tube = runs["dual-motor-lean"], Tube(start=9.0, floor=1e-6, alpha=1.0)
    for bound, kind, names in (
        (1e-3, "semidefinite", []),
        (2.5e-3, "implemented", ["implemented"]),
    ):
        best = Certificate(kind, bound, verified=True)
        magnified = plotting.tube_figure(run, tube, "title", best).axes[1]
        legend = magnified.get_legend()
        assert [text.partition(":")[0] for text in (texts(legend) if legend else [])] == names
        drawn = {line.get_ydata()[0] for line in magnified.lines if len(line.get_xdata()) == 2}
        assert {bound, -bound} <= drawn
        assert magnified.get_ylim()[1] > bound


def test_zeros_do_not_stretch_a_histogram_to_the_smallest_number():
    """3 % of the members are settled from the start; a logarithmic axis would end at 1e-12."""
    ensemble = certrack.ensemble(certrack.load("example1"), 97)
    settling = ensemble.statistics.metrics["settling_time"]
    settling.observe(np.zeros(3))
    made = plotting.metric_histograms(ensemble)
    (ax,) = [each for each in made.axes if "settling" in each.get_xlabel()]
    assert ax.get_xscale() == "linear"
    assert sum(bar.get_height() for bar in ax.patches) == 100

"""Pictures: what they show, and that drawing them warns of nothing."""

import importlib
import math
from dataclasses import replace
from types import SimpleNamespace

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
from certrack.plotting.limits import draw_input_limits
from certrack.plotting.names import math_name
from certrack.plotting.units import prefix
from certrack.plotting.windows import split_time
from certrack.studies.ensembles.statistics import LEVELS
from certrack.studies.margins import Margin, Margins

show_module = importlib.import_module("certrack.plotting.show")

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def runs():
    names = ("dual-motor", "dual-motor-lean", "dual-motor-drive")
    systems = {name: certrack.load(name).with_settings(duration=1.0, tail=0.5) for name in names}
    return {name: certrack.simulate(system) for name, system in systems.items()}


def texts(legend):
    return [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("count", [2, 3])
def test_systems_differ_by_colour_and_states_by_line(runs, tmp_path, count):
    some = dict(list(runs.items())[:count])
    made = plotting.overview(some)
    plotting.save_figure(made, tmp_path, "overview")
    (systems,) = made.legends
    assert texts(systems) == list(some)
    colors = {to_hex(line.get_color()) for line in systems.get_lines()}
    assert colors == set(plotting.STYLE["axes.prop_cycle"].by_key()["color"][:count])
    angles, speeds = (made.axes[k].get_legend() for k in (2, 3))
    assert [texts(angles), texts(speeds)] == [["$x_{1}$", "$x_{3}$"], ["$x_{2}$", "$x_{4}$"]]
    assert len({line.get_linestyle() for line in angles.get_lines()}) == 2
    assert [made.axes[k].get_ylabel() for k in (2, 3)] == ["states [rad]", "states [rad/s]"]
    width, height = made.get_size_inches() * made.dpi
    for legend in (systems, *(ax.get_legend() for ax in made.axes)):
        box = legend.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
    for ax in made.axes:
        assert ax.get_legend().get_window_extent().y0 >= ax.get_window_extent().y1 - 1


def test_long_names_stay_on_the_page(runs, tmp_path):
    run = runs["dual-motor-lean"]
    made = plotting.overview({f"{'a-folder/' * 8}{k}.toml": run for k in range(5)})
    plotting.save_figure(made, tmp_path, "overview")
    box = made.legends[0].get_window_extent()
    assert box.x0 >= 0 and box.x1 <= made.get_figwidth() * made.dpi


def test_one_run_needs_no_legend_of_systems(runs):
    made = plotting.overview({"lean": runs["dual-motor-lean"]})
    assert not made.legends
    assert sum(len(texts(ax.get_legend())) for ax in made.axes[2:4]) == 4


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


@pytest.mark.slow
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
    said = "continuous law" in made.get_suptitle()
    (shown, *_) = [text for text in texts(made.axes[0].get_legend()) if "tube" in text]
    assert said == ("continuous law" in shown) == (name == "dual-motor-drive")


@pytest.mark.parametrize("factor", [2.0, 20.0])
def test_a_certified_bound_is_drawn_or_told(factor, runs):
    """The legend has it in both cases; a line far off would hide the error."""
    run = runs["dual-motor-lean"]
    bound = factor * float(np.abs(run.e[0]).max())
    certificates = SimpleNamespace(best=Certificate("peak", bound, verified=True), tube=None)
    ax = plotting.plot(run).axes[1]
    ax.clear()
    plotting.plot_error(ax, {"": run}, certified={"": certificates})
    assert any(text.startswith("certified ") for text in texts(ax.get_legend()))
    drawn = {line.get_ydata()[0] for line in ax.lines if len(line.get_xdata()) == 2}
    assert (bound in drawn) == (factor == 2.0)


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


@pytest.mark.parametrize(
    ("peak", "decay", "split"),
    [(1.0, 5.0, 1.0), (0.02, 5.0, None), (1.0, 0.4, None), (0.0, 1.0, None)],
)
def test_a_short_transient_that_dominates_gets_axes_of_its_own(peak, decay, split):
    t = np.linspace(0, 20, 4001)
    signal = peak * np.exp(-decay * t) + 0.01 * np.sin(t)
    found = split_time(20.0, [(t, signal), (t, 0.01 * np.sin(t))])
    assert found == split
    if split is not None:
        assert np.abs(signal[t > split]).max() < 0.05


def test_the_rest_of_a_run_is_scaled_to_its_error_and_shows_bound_and_reference(tmp_path):
    system = certrack.load("dual-motor-lean")
    run, found = certrack.simulate(system), certrack.certify(system, effort="fast")
    made = plotting.overview({"": run}, certified={"": found})
    plotting.save_figure(made, tmp_path, "overview")
    first, rest = made.axes[2:4]  # output, then error
    assert first.get_xlim()[1] == rest.get_xlim()[0] == 1.5
    assert rest.get_ylabel() == "[mrad]" and first.get_ylabel() == "tracking error [rad]"
    bound = found.best.bound
    assert bound < rest.get_ylim()[1] < 2 * bound
    assert {line.get_ydata()[0] for line in rest.lines} >= {bound, -bound}
    assert not any("band" in text.get_label() for text in rest.patches)  # it does not fit
    shown = texts(rest.get_legend())
    assert "certified 0.001288 rad" in shown and "tube" in shown
    y, y_d = made.axes[0].lines
    assert y_d.get_label() == "$y_d$" and y_d.get_zorder() > y.get_zorder()


def test_limits_of_the_input_are_drawn(runs):
    drive = runs["dual-motor-drive"]
    limited = replace(drive.system.implementation, rate_limit=5000.0)
    run = certrack.simulate(drive.system.replace(implementation=limited))
    ax = Figure().subplots()
    plotting.plot_input(ax, {"": run})
    flat = {line.get_ydata()[0] for line in ax.lines if len(line.get_xdata()) == 2}
    assert {-15.0, 15.0} <= flat
    (rate,) = [line for line in ax.lines if line.get_label() == "rate limit 5000/s"]
    slopes = [np.diff(line.get_ydata()) / np.diff(line.get_xdata()) for line in ax.lines[-2:]]
    assert sorted(float(slope[0]) for slope in slopes) == pytest.approx([-5000, 5000])
    assert rate in ax.lines


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("x1", "$x_{1}$"),
        ("phi", r"$\phi$"),
        ("phi_dot", r"$\dot\phi$"),
        ("theta_m", r"$\theta_{m}$"),
        ("theta_m_dot", r"$\dot\theta_{m}$"),
        ("theta_hat_2", r"$\hat\theta_{2}$"),
        ("delta_hat", r"$\hat\delta$"),
        ("q", "$q$"),
        ("v_load", r"$v_{\mathrm{load}}$"),
        ("speed", "speed"),
        ("e_1", "$e_{1}$"),
    ],
)
def test_names_are_set_as_mathematics(name, shown):
    assert math_name(name) == shown


@pytest.mark.parametrize(
    ("unit", "size", "shown"),
    [
        ("rad", 0.5, (1.0, "rad")),
        ("rad", 0.02, (1e3, "mrad")),
        ("m", 3e-5, (1e6, "\N{MICRO SIGN}m")),
        ("deg", 1e-3, (1.0, "deg")),
        ("m", 0.0, (1.0, "m")),
    ],
)
def test_units_take_a_prefix(unit, size, shown):
    assert prefix(unit, size) == shown


def test_appearances(runs, tmp_path):
    run = runs["dual-motor-lean"]
    paper = plotting.overview({"": run}, "title", plotting.Appearance("paper"))
    assert paper.get_figwidth() == 3.5
    wide = plotting.Appearance("slides", (10, 5), "new", (0.2, 0.4))
    slide = plotting.figure(plotting.plot_error, {"": run}, "old", wide)
    assert tuple(slide.get_size_inches()) == (10, 5)
    assert slide.get_suptitle() == "new"
    assert slide.axes[0].get_xlim() == (0.2, 0.4)
    written = plotting.save_figure(slide, tmp_path, "error")
    assert [path.suffix for path in written] == [".png", ".svg", ".pdf"]
    same = plotting.figure(plotting.plot_error, {"": run}, "old", wide)
    again = plotting.save_figure(same, tmp_path / "again", "error")
    for first, second in zip(written, again, strict=True):
        assert first.read_bytes() == second.read_bytes()
    for wrong in ({"kind": "poster"}, {"size": (0, 1)}, {"window": (2, 1)}):
        with pytest.raises(InputError, match="appearance"):
            plotting.Appearance(**wrong)


def test_a_limit_far_from_the_errors_does_not_squeeze_their_histogram():
    found = certrack.ensemble(certrack.load("example1"), 40, limit=10.0)
    ax = plotting.metric_histograms(found).axes[0]
    assert ax.get_xlim()[1] < 0.1
    assert "limit 10" in ax.texts[0].get_text()
    near = certrack.ensemble(certrack.load("example1"), 40, limit=0.0355)
    assert 0.0355 in {
        line.get_xdata()[0] for line in plotting.metric_histograms(near).axes[0].lines
    }


def test_without_a_display_there_is_no_window(monkeypatch):
    monkeypatch.setattr(show_module.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert plotting.show([Figure()]) == "there is no display here"


def test_a_window_is_opened_by_the_first_toolkit_that_can(monkeypatch):
    """A toolkit that fails is passed over; the figures are shown, then the loop runs."""
    calls = []

    class Manager:
        def show(self):
            calls.append("shown")

        @classmethod
        def start_main_loop(cls):
            calls.append("loop")

    class Canvas:
        manager_class = Manager

        @classmethod
        def new_manager(cls, figure, number):
            calls.append(number)
            return Manager()

    def load(name):
        if name.endswith("qtagg"):
            raise ImportError("no Qt")
        return type("Backend", (), {"FigureCanvas": Canvas})

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(show_module, "import_module", load)
    assert plotting.show([Figure(), Figure()]) == ""
    assert calls == [1, 2, "shown", "shown", "loop"]


def test_dollars_in_a_title_are_no_formula():
    from certrack.plotting import Appearance
    from certrack.plotting.shared import set_title

    drawing = Figure()
    with plotting.style():
        set_title(drawing, Appearance(title=r"$\bad$").titled("none"))
    text = drawing._suptitle
    drawing.canvas.draw()  # a formula that is none would raise
    assert text._preprocess_math(text.get_text()) == (r"$\bad$", False)


def test_far_limits_of_the_input_have_their_unit():
    drive = certrack.load("dual-motor-drive")
    run = certrack.simulate(drive.replace(settings=replace(drive.settings, duration=0.1, tail=0)))
    for units, label in (
        (("rad", "rad/s", "rad", "rad/s", "N m"), "saturation -15 to 15 N m"),
        (None, "saturation -15 to 15"),
    ):
        system = run.system.replace(plant=replace(run.system.plant, units=units))
        ax = Figure().add_subplot()
        draw_input_limits(ax, {"run": replace(run, system=system)}, None, 0.1)
        assert ax.get_legend_handles_labels()[1] == [label]

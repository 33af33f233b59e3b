"""Figures 2 to 4, each twice: as the paper describes it, and so that one can read it.

The second one, named `...-detail`, shows what comes after the first seconds, which stand in an
inset; u of Figures 3(c) and 4(c) has the same scale in both, so that the two tails compare.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.papers.liu2025.measures import Response
from certrack.papers.liu2025.runs import PaperRuns
from certrack.plotting.shared import BLUE, GREEN, RED, new_figure, style

#: Solid, dashed and dotted as in the paper; the dots are round and close enough to be a line.
SOLID, DASHED, DOTTED = "-", (0, (5, 2)), (0, (1, 1.2))

#: Every so many samples of a response are drawn, and in the first 0.2 s of them all every tenth.
DRAWN, DENSE, DENSE_UNTIL = 50, 10, 0.2

#: The height of the inset, and the share of the axes above the curves that is free for it.
INSET_HEIGHT, INSET_ROOM = 0.40, 1.25

#: Space between the curves and the frame, as a part of their height.
FRAME_MARGIN = 0.08


@dataclass(frozen=True)
class PaperCurve:
    """One line of a figure."""

    t: np.ndarray
    values: np.ndarray
    label: str
    color: str
    line: object


@dataclass(frozen=True)
class PaperAxes:
    """One pair of axes of a figure.

    Attributes
    ----------
    curves : tuple of PaperCurve
    label : str
        Of the ordinate.
    first : float, s
        Length of the inset; what comes after it sets the scale of the detail.
    limits : pair of float, optional
        Scale of the detail below its inset, where figures have to compare.
    """

    curves: tuple[PaperCurve, ...]
    label: str
    first: float
    limits: tuple[float, float] | None = None


def paper_figures(runs: PaperRuns) -> dict[str, Figure]:
    """Figures 2(a) to 4(c) and their details, by file name."""
    drawings = {}
    for number, title, rows in (*_figures_2(runs), *_figures_3_4(runs)):
        drawings[f"figure-{number}"] = _drawing(rows, title, _draw_whole)
        drawings[f"figure-{number}-detail"] = _drawing(rows, title, _draw_detail)
    return drawings


#: Number, title and axes of a figure.
Specification = tuple[str, str, tuple[PaperAxes, ...]]


def _figures_2(runs: PaperRuns) -> Iterator[Specification]:
    improved, classic = runs.laws
    t = improved.t[::DRAWN]
    y_d = improved.signals["xi_1"] - improved.signals["e_1"]
    reference = PaperCurve(t, y_d[::DRAWN], "$y_d$", "k", DOTTED)

    def pair(name: str, symbol: str) -> tuple[PaperCurve, ...]:
        return (
            _curve_of(improved, name, f"${symbol}$, improved law (47)", BLUE, SOLID),
            _curve_of(classic, name, f"${symbol}$, classic law (48)", RED, DASHED),
        )

    output = PaperAxes((*pair("xi_1", "y"), reference), "output", 3.0)
    yield "2a", "2(a) Example 1: output", (output,)
    yield "2b", r"2(b) Example 1: $\xi_2$", (PaperAxes(pair("xi_2", r"\xi_2"), r"$\xi_2$", 3.0),)
    estimates = [
        PaperAxes(pair(name, symbol), f"${symbol}$", 3.0)
        for name, symbol in (("delta_hat", r"\hat\delta"), ("theta_hat", r"\hat\vartheta"))
    ]
    yield "2c", "2(c) Example 1: updated laws", tuple(estimates)
    yield "2d", "2(d) Example 1: input", (PaperAxes(pair("u", "u"), "$u$", 3.0),)


def _figures_3_4(runs: PaperRuns) -> Iterator[Specification]:
    tail = 1.3 * max(motor.final_range("u") for motor in runs.motors)
    for number, tau, motor in zip((3, 4), (1, 5), runs.motors, strict=True):
        title = f"Example 2, $\\tau$ = {tau}"
        t = motor.t[::DRAWN]
        y_d = (motor.signals["xi_1"] - motor.signals["e_1"])[::DRAWN]
        output = PaperAxes(
            (
                _curve_of(motor, "xi_1", "$y$", BLUE, SOLID),
                PaperCurve(t, y_d, "$y_d$", "k", DASHED),
                _curve_of(motor, "e_1", "$e_1$", RED, DOTTED),
            ),
            "angle [rad]",
            2.0,
        )
        yield f"{number}a", f"{number}(a) {title}: output and error", (output,)
        lines = ((BLUE, SOLID), (RED, DASHED), (GREEN, DOTTED))
        units = ("rad/s", "rad", "rad/s")
        states = tuple(
            _curve_of(motor, f"xi_{i}", f"$\\xi_{i}$ [{unit}]", color, line)
            for i, unit, (color, line) in zip((2, 3, 4), units, lines, strict=True)
        )
        yield f"{number}b", f"{number}(b) {title}: states", (PaperAxes(states, "states", 2.0),)
        torque = PaperAxes((_curve_of(motor, "u", "$u$", BLUE, SOLID),), "$u$", 2.0, (-tail, tail))
        yield f"{number}c", f"{number}(c) {title}: input", (torque,)


def _curve_of(response: Response, name: str, label: str, color: str, line: object) -> PaperCurve:
    """A signal, dense where it is fast."""
    dense = int(np.searchsorted(response.t, DENSE_UNTIL))
    keep = np.r_[0:dense:DENSE, dense : len(response.t) : DRAWN]
    return PaperCurve(response.t[keep], response.signals[name][keep], label, color, line)


def _drawing(
    rows: tuple[PaperAxes, ...], title: str, draw: Callable[[Axes, PaperAxes], None]
) -> Figure:
    with style():
        figure = new_figure(6.0, 3.2 + 1.9 * (len(rows) - 1))
        axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        for ax, content in zip(axes, rows, strict=True):
            draw(ax, content)
            ax.set_ylabel(content.label)
            if draw is _draw_detail:
                ax.set_xlim(content.first, content.curves[0].t[-1])
            else:
                ax.margins(x=0.01)
        axes[-1].set_xlabel("time [s]")
        figure.align_ylabels()
        axes[0].set_title(title, loc="left")
    return figure


def _plot(ax: Axes, content: PaperAxes) -> None:
    for curve in content.curves:
        ax.plot(curve.t, curve.values, color=curve.color, ls=curve.line, lw=1.3, label=curve.label)


def _draw_whole(ax: Axes, content: PaperAxes) -> None:
    _plot(ax, content)
    ax.legend(loc="best")


def _draw_detail(ax: Axes, content: PaperAxes) -> None:
    _plot(ax, content)
    low, high = content.limits or _span(content, lambda t: t >= content.first)
    ax.set_ylim(low, high + INSET_ROOM * (high - low))
    inset = ax.inset_axes((0.52, 0.93 - INSET_HEIGHT, 0.47, INSET_HEIGHT))
    _plot(inset, content)
    inset.set_xlim(-0.01 * content.first, content.first)
    inset.set_ylim(*_span(content, lambda t: t <= content.first))
    inset.tick_params(labelsize=7)
    inset.set_title(f"the first {content.first:g} s", fontsize=8, pad=3, fontweight="normal")
    inset.patch.set_alpha(0.0)
    ax.grid(visible=False, axis="x")
    ax.legend(loc="upper left", title=f"from {content.first:g} s on", alignment="left")
    ax.set_yticks([tick for tick in ax.get_yticks() if low <= tick <= high])
    ax.axhline(high, color="#d9d9d9", lw=0.5)


def _span(content: PaperAxes, where: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """Lowest and highest value of the curves at these times, with a margin."""
    values = [curve.values[where(curve.t)] for curve in content.curves]
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    room = FRAME_MARGIN * (high - low)
    return low - room, high + room

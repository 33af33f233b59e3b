"""Figure 1: the dual-motor drive servo as a block diagram."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from certrack.plotting.shared import BLUE, GREEN, RED, new_figure, style

#: Colours of control, mechanics and uncertainty.
CONTROL, MECHANICS, UNCERTAIN = BLUE, GREEN, RED

Point = tuple[float, float]


def servo_diagram() -> Figure:
    """Controller, two motors, two shafts, load; what acts on them and what is fed back [1]-[4]."""
    with style():
        figure = new_figure(7.0, 3.6)
        ax = figure.add_subplot()
        ax.set_xlim(0, 14)
        ax.set_ylim(0, 7.2)
        ax.set_aspect("equal")
        ax.set_axis_off()
        ax.set_title("1 Dual-motor drive servo, system (1) with (2) to (4)", loc="left")
        _servo(ax)
    return figure


def _servo(ax: Axes) -> None:
    _block(ax, (0.9, 2.6), (2.2, 1.8), "controller\n(54)", CONTROL)
    _arrow(ax, (0.0, 3.5), (0.9, 3.5), "$y_d$", CONTROL)
    for i, y in ((1, 4.7), (2, 0.9)):
        _block(ax, (4.6, y), (2.2, 1.4), f"motor {i}\n$K_{i},\\ J_{i}$", MECHANICS)
        _block(ax, (8.1, y), (1.6, 1.4), "shaft\n$K_L$", MECHANICS)
        middle = y + 0.7
        start = (3.1, 4.0 if i == 1 else 3.0)
        ax.plot([start[0], 3.7, 3.7], [start[1], start[1], middle], color=CONTROL, lw=1.2)
        _arrow(ax, (3.7, middle), (4.6, middle), f"$u_{i}$", CONTROL)
        _arrow(ax, (6.8, middle), (8.1, middle), f"$\\theta_{i}$", MECHANICS, both=True)
        _arrow(ax, (5.7, y + 2.2), (5.7, y + 1.4), "", UNCERTAIN)
        ax.text(5.85, y + 1.8, f"$\\varpi_{i}$", color=UNCERTAIN, va="center")
        ax.plot([9.7, 11.4], [middle, middle], color=MECHANICS, lw=1.2)
        _arrow(ax, (11.4, middle), (11.4, 4.3 if i == 1 else 2.7), "", MECHANICS)
    _block(ax, (10.4, 2.7), (2.0, 1.6), "load\n$J_L$", MECHANICS)
    _arrow(ax, (12.4, 3.5), (13.9, 3.5), "$y = \\theta_L$", MECHANICS)
    _arrow(ax, (9.5, 3.5), (10.4, 3.5), "", UNCERTAIN)
    ax.text(9.1, 3.5, r"$\varpi_L$", color=UNCERTAIN, va="center")
    ax.plot([12.9, 12.9, 2.0], [3.5, 0.25, 0.25], color=CONTROL, lw=1.2)
    ax.plot([7.6, 7.6], [5.4, 0.25], color=CONTROL, lw=1.2, ls=":")  # the motors' angles
    ax.plot([7.6, 7.6, 12.9], [5.4, 1.6, 3.5], color=CONTROL, marker="o", ms=3, ls="")
    _arrow(ax, (2.0, 0.25), (2.0, 2.6), "", CONTROL)
    ax.text(
        10.2,
        0.32,
        r"$\xi = (\theta_L,\ \dot\theta_L,\ (\theta_1+\theta_2)/2,"
        r"\ (\dot\theta_1+\dot\theta_2)/2)$",
        color=CONTROL,
        va="bottom",
        ha="center",
        fontsize=8,
    )


def _block(ax: Axes, corner: Point, size: Point, text: str, color: str) -> None:
    box = FancyBboxPatch(
        corner, *size, boxstyle="round,pad=0,rounding_size=0.15", fc="white", ec=color, lw=1.4
    )
    ax.add_patch(box)
    center = corner[0] + size[0] / 2, corner[1] + size[1] / 2
    ax.text(*center, text, ha="center", va="center", fontsize=9)


def _arrow(
    ax: Axes, start: Point, end: Point, text: str, color: str, *, both: bool = False
) -> None:
    """An arrow with its signal above; `both`: torque one way, angle the other."""
    head = "<|-|>" if both else "-|>"
    arrow = FancyArrowPatch(
        start, end, arrowstyle=head, mutation_scale=10, color=color, lw=1.2, shrinkA=0, shrinkB=0
    )
    ax.add_patch(arrow)
    if text:
        x, y = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
        x -= 0.2 if both else 0.0  # beside the tap of the feedback
        ax.text(x, y + 0.12, text, ha="center", va="bottom", color=color)

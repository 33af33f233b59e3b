"""The picture of the energy of two motors: powers over time, and the balance as bars."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from certrack.plotting.shared import (
    BLUE,
    GOLD,
    GRAY,
    GREEN,
    PAGE_WIDTH,
    PURPLE,
    RED,
    TEAL,
    new_figure,
    set_title,
    style,
)

if TYPE_CHECKING:
    from certrack.studies.energy import Energy, EnergyBalance

#: Times after which all powers stay below this part of the largest are not shown.
SHOWN_PART = 0.01

#: Half the width of the bars' axis over the longest bar.
ROOM_FOR_NUMBERS = 1.7

#: Below one of these, a thousandth of the unit is used.
UNIT_PREFIXES = ((1e-3, 1e6, "µ"), (1.0, 1e3, "m"), (1e3, 1.0, ""), (math.inf, 1e-3, "k"))


def energy_figure(result: Energy, title: str) -> Figure:
    """Powers and balance of the whole run, and beside it of its last cycle if there is one.

    Parameters
    ----------
    result : Energy
    title : str

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> found = certrack.energy(certrack.load("dual-motor-physical"))
    >>> len(certrack.plotting.energy_figure(found, "").axes)
    4
    """
    shown = [("run", result.balance)]
    if result.cycles:
        shown.append(("last cycle", result.cycles[-1]))
    with style():
        drawing = new_figure(PAGE_WIDTH, 5.2)
        axes = drawing.subplots(2, len(shown), squeeze=False, height_ratios=[1.0, 1.15])
        for column, (name, balance) in enumerate(shown):
            _draw_powers(axes[0, column], result, balance)
            axes[0, column].set_title(f"{name}: {balance.begin:.4g} to {balance.end:.4g} s")
            _draw_bars(axes[1, column], balance)
        handles, labels = axes[0, 0].get_legend_handles_labels()
        drawing.legend(handles, labels, loc="outside lower center", ncols=3)
        if title:
            set_title(drawing, title)
    return drawing


def _draw_powers(ax: Axes, result: Energy, balance: EnergyBalance) -> None:
    """Power of the link, of both motors' shafts, and what becomes heat in the copper."""
    t, powers = result.run.t, result.powers
    inside = (t >= balance.begin) & (t <= balance.end)
    curves = (
        (powers["asked"] - powers["given_back"], BLUE, 2.2, "of the link (below 0: given back)"),
        (powers["work_1"] + powers["work_2"], GOLD, 1.0, "to the mechanism"),
        (powers["copper_1"] + powers["copper_2"], RED, 1.0, "copper"),
    )
    sizes = np.max([np.abs(values[inside]) for values, *_ in curves], axis=0)
    largest = float(np.max(sizes))
    factor, prefix = _prefix(largest)
    for values, colour, width, label in curves:
        ax.plot(t[inside], factor * values[inside], color=colour, lw=width, label=label)
    busy = t[inside][sizes >= SHOWN_PART * largest]
    ax.set_xlim(balance.begin, busy[-1] if busy[-1] > balance.begin else balance.end)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"power [{prefix}W]")
    ax.axhline(0.0, color="k", lw=0.6)


def _draw_bars(ax: Axes, balance: EnergyBalance) -> None:
    """Where energy came from (to the right) and where it went (to the left), J."""
    entries: list[tuple[str, float, str]] = [
        ("drawn", balance.drawn, BLUE),
        ("returned", -balance.returned, GREEN),
        ("disturbances", balance.surroundings, PURPLE),
        ("from storage", -balance.stored, TEAL),
        ("copper 1", -balance.copper[0], RED),
        ("copper 2", -balance.copper[1], RED),
        ("friction", -balance.friction, GRAY),
        ("chopper", -balance.chopper, GOLD),
        ("supply", -balance.supply_loss, GOLD),
    ]
    places = np.arange(len(entries))[::-1]
    largest = max(abs(value) for _, value, _ in entries)
    factor, prefix = _prefix(largest)
    values = [factor * value for _, value, _ in entries]
    ax.barh(places, values, color=[colour for _, _, colour in entries], height=0.7)
    ax.set_yticks(places, [label for label, _, _ in entries])
    ax.axvline(0.0, color="k", lw=0.6)
    for place, value in zip(places, values, strict=True):
        side = 1 if value >= 0 else -1
        ax.annotate(
            f"{value:.3g}",
            (value, place),
            xytext=(3 * side, 0),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=7,
        )
    half = ROOM_FOR_NUMBERS * factor * largest or 1.0
    ax.set_xlim(-half, half)
    ax.set_xlabel(f"energy [{prefix}J]: gained to the right")
    ax.grid(visible=False, axis="y")


def _prefix(largest: float) -> tuple[float, str]:
    """Factor and prefix of the unit in which the largest of some numbers is readable."""
    below = (entry for entry in UNIT_PREFIXES if largest < entry[0])
    return next((factor, prefix) for _, factor, prefix in below) if largest else (1.0, "")

"""Units on an axis, with the prefix that makes its numbers short."""

from __future__ import annotations

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes

from certrack.plotting.shared import plain

#: Units that take a prefix; others are shown as they are ("deg", "%", a user's own).
PREFIXED = (
    *("m", "m/s", "m/s^2", "rad", "rad/s", "rad/s^2", "s"),
    *("V", "A", "N", "N m", "Nm", "W", "Pa"),
)

#: Prefixes, and the size in the unit below which they serve.
PREFIXES = ((1e-4, "\N{MICRO SIGN}", 1e6), (0.1, "m", 1e3))

#: Numbers without a unit have a common power of ten outside these exponents.
PLAIN_EXPONENTS = (-3, 5)


def prefix(unit: str, size: float) -> tuple[float, str]:
    """Factor and unit in which values of this size are short numbers."""
    if unit in PREFIXED and size > 0:
        for below, letter, factor in PREFIXES:
            if size < below:
                return factor, letter + unit
    return 1.0, unit


def label_with_unit(ax: Axes, label: str, unit: str) -> None:
    """Label the ordinate, and show its ticks in a unit that fits what is seen."""
    factor, shown = prefix(unit, float(np.abs(ax.get_ylim()).max()))
    bracket = f"[{plain(shown)}]" if shown not in ("", "1") else ""
    ax.set_ylabel(" ".join(filter(None, (label, bracket))))
    if ax.get_yscale() != "linear":
        return
    if factor != 1:
        ax.yaxis.set_major_formatter(ticker.FuncFormatter(lambda v, _: short(factor * v)))
    elif unit in ("", "1"):
        ax.ticklabel_format(axis="y", scilimits=PLAIN_EXPONENTS, useMathText=True)


def short(value: float) -> str:
    """A tick's number."""
    return f"{value:.6g}".replace("-", "\N{MINUS SIGN}")

"""What a signal is known to stay within: certified bounds and tubes, limits of the input."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from certrack.certificates.certify import Certificates
from certrack.core.rounding import rounded_up
from certrack.plotting.curves import Runs, design_style, label_once
from certrack.plotting.shared import GRAY, GREEN, plain
from certrack.plotting.windows import Window

#: Certificates by the names of their runs.
Certified = Mapping[str, Certificates]

#: A bound, a limit of the input or a rate limit is drawn where it is at most so many times what is
#: seen of the signal; one that is farther off is told in the legend.
FITS = 3.0

#: Points of a tube in a window, and the share of it that hides nothing.
TUBE_POINTS, TUBE_ALPHA = 400, 0.10


def draw_guarantees(
    ax: Axes, runs: Runs, certified: Certified, window: Window | None, largest: float
) -> tuple[float, ...]:
    """Lines at certified bounds, and tubes; what the ordinate must hold.

    Parameters
    ----------
    largest : float
        The largest |e_1| that is seen.
    """
    held: list[float] = []
    plant = next(iter(runs.values())).system.plant
    unit = (plant.units or ("",))[0]
    for k, (name, run) in enumerate(runs.items()):
        certificates = certified.get(name)
        if certificates is None:
            continue
        color = GREEN if len(runs) == 1 else design_style(k)["color"]
        low, high = window or (0.0, float(run.t[-1]))
        best = certificates.best
        if best.exists:
            drawn = best.bound <= FITS * largest
            text = f"certified {rounded_up(best.bound, 4)} {plain(unit)}"
            label = label_once(ax, text.strip())
            for sign in (-1, 1) if drawn else ():
                ax.axhline(sign * best.bound, color=color, ls="-.", lw=0.9, label=label)
                label = None
            if not drawn:
                ax.plot([], [], " ", label=label)
            held += [best.bound, -best.bound] if drawn else []
        if certificates.tube is not None:
            t = np.linspace(low, high, TUBE_POINTS)
            wide = certificates.tube(t)
            label = label_once(ax, "tube")
            limits = ax.get_ylim()
            ax.fill_between(t, -wide, wide, color=color, alpha=TUBE_ALPHA, lw=0, label=label)
            ax.set_ylim(limits)
    return tuple(held)


def draw_input_limits(
    ax: Axes, runs: Runs, window: Window | None, largest: float
) -> tuple[float, ...]:
    """Lines at the limits of the input and its rate; what the ordinate must hold.

    Parameters
    ----------
    largest : float
        The largest |u| that is seen.
    """
    held: list[float] = []
    for run in runs.values():
        implementation = run.system.implementation
        if implementation is None:
            continue
        for limit in implementation.saturation or ():
            if abs(limit) <= FITS * largest:
                label = label_once(ax, "saturation")
                ax.axhline(limit, color="k", ls="--", lw=0.9, label=label)
                held.append(limit)
        if implementation.saturation is not None and not held:
            low, high = implementation.saturation
            units = run.system.plant.units  # the axis may be in thousandths of it
            unit = "" if units is None or units[-1] == "1" else f" {units[-1]}"
            ax.plot([], [], " ", label=label_once(ax, f"saturation {low:g} to {high:g}{unit}"))
        if implementation.rate_limit is not None:
            _draw_rate(ax, implementation.rate_limit, run.t, run.u, window)
    return tuple(held)


def _draw_rate(ax: Axes, rate: float, t: np.ndarray, u: np.ndarray, window: Window | None) -> None:
    """The fastest change of the input, as lines from where it changes most in the window."""
    low, high = window or (float(t[0]), float(t[-1]))
    within = np.flatnonzero((t >= low) & (t <= high))
    if len(within) < 2:
        return
    begin = within[int(np.argmax(np.abs(u[within] - u[within[0]]) > 0)) - 1]
    span = float(np.ptp(u[within]))
    width = min(span / rate, high - t[begin])
    label = label_once(ax, f"rate limit {rate:g}/s")
    for sign in (-1, 1):
        ends = [t[begin], t[begin] + width], [u[begin], u[begin] + sign * rate * width]
        ax.plot(*ends, color=GRAY, ls=":", lw=1.0, label=label, scalex=False, scaley=False)
        label = None

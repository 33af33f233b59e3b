"""The picture of the margins of a sampled loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from certrack.plotting.shared import (
    GREEN,
    RED,
    few_ticks,
    in_brackets,
    new_figure,
    set_title,
    style,
    time_unit,
)

if TYPE_CHECKING:
    from certrack.studies.drift import Drift
    from certrack.studies.margins import Margins


#: Errors beyond this many times the admitted one are marked at the top, as lost ones are.
TOP = 1e3

#: Something happens between two values tried where the error changes by more than this part; so
#: many values at rest are shown before and after, and this much room.
CHANGE, AT_REST, ROOM = 0.05, 2, 1.12

LOST, EDGE = "lost, or off the scale", "exact edge of stability"


def margin_figure(margins: Margins, title: str, units: Sequence[str] | None) -> Figure:
    """Worst tail error against period, delay and saturation.

    Parameters
    ----------
    margins : Margins
    title : str
    units : texts, optional
        Of the plant's states and the input.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> tried = certrack.Margin(0.01, 0.02, None, False, (0.01, 0.02), (1e-3, 1e-2))
    >>> limits = {name: tried for name in ("period", "delay", "saturation")}
    >>> result = certrack.Margins(2e-3, "given", 8, 0.01, None, **limits)
    >>> len(certrack.plotting.margin_figure(result, "", None).axes)
    3
    """
    output, *_, force = map(in_brackets, units or ("", ""))
    at, unit = time_unit(margins.at)
    panels = {
        "sampling period": margins.period,
        f"delay at a period of {margins.at * at:.3g} {unit}": margins.delay,
        f"saturation $\\pm u${force}": margins.saturation,
    }
    top = TOP * margins.error
    with style():
        drawing = new_figure(9.0, 3.2)
        axes, lost = drawing.subplots(1, 3, sharey=True), False
        for ax, (label, margin) in zip(axes, panels.items(), strict=True):
            factor, unit = (1.0, "") if ax is axes[-1] else time_unit(*margin.values)
            values, errors = factor * np.array(margin.values), np.array(margin.errors)
            shown = np.isfinite(errors) & (errors < top)
            ax.loglog(values[shown], errors[shown], ".-", label="worst member")
            lost = lost or not shown.all()
            ax.plot(values[~shown], [top] * (~shown).sum(), "x", color=RED, label=LOST)
            ax.axhline(margins.error, color="k", ls="--", lw=0.8, label="admitted")
            edge = factor * margin.exact if margin.exact else math.nan
            ax.axvline(edge, color=GREEN, ls=":", lw=1.2, label=EDGE)
            ax.set_xlabel(label + in_brackets(unit))
            ax.set_xlim(_eventful_range(values, errors, edge))
            few_ticks(ax)
        exists = {LOST: lost, EDGE: any(margin.exact for margin in panels.values())}
        entries = zip(*axes[0].get_legend_handles_labels(), strict=True)
        handles, labels = zip(*(e for e in entries if exists.get(e[1], True)), strict=True)
        drawing.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        axes[0].set_ylabel(f"tail error{output}")
        set_title(drawing, title)
    return drawing


def drift_figure(drift: Drift, title: str) -> Figure:
    """How far each constant may drift: the range of the file and the largest one, beside it.

    Parameters
    ----------
    drift : Drift
        With constants.
    title : str

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> from certrack.studies.drift import drift
    >>> found = drift(certrack.load("axis"))
    >>> len(certrack.plotting.drift_figure(found, "").axes)
    1
    """
    entries = drift.constants[::-1]
    shares = [entry.nominal for entry in entries]
    with style():
        drawing = new_figure(6.0, 1.2 + 0.45 * len(entries))
        ax = drawing.subplots()
        for y, (entry, size) in enumerate(zip(entries, shares, strict=True)):
            scale = 100 / abs(size) if size else 1.0
            low, high = (scale * (end - size) for end in entry.file)
            ax.barh(y + 0.17, high - low, 0.3, low, color="0.75", label="in the file")
            if entry.low is not None and entry.high is not None:
                low, high = (scale * (end - size) for end in (entry.low, entry.high))
                ax.barh(y - 0.17, high - low, 0.3, low, color=GREEN, label="largest, by itself")
        ax.axvline(0.0, color="k", lw=0.8)
        ax.use_sticky_edges = False
        ax.margins(x=0.05)
        ax.set_yticks(range(len(entries)), [entry.name for entry in entries])
        percent = all(shares)
        ax.set_xlabel("from the nominal value" + (" [%]" if percent else " [% where it is not 0]"))
        shown = dict(zip(*ax.get_legend_handles_labels()[::-1], strict=True))
        drawing.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=len(shown))
        set_title(drawing, title)
    return drawing


def _eventful_range(values: np.ndarray, errors: np.ndarray, edge: float) -> tuple[float, float]:
    """The axis from where something begins to happen to where nothing more does."""
    with np.errstate(all="ignore"):
        steps = np.nan_to_num(np.diff(np.log(errors)), posinf=np.inf)  # lost after lost: none
    changes = np.flatnonzero(np.abs(steps) > CHANGE)
    first, last = (changes[0], changes[-1] + 1) if len(changes) else (0, len(values) - 1)
    low = float(values[max(first - AT_REST + 1, 0)])
    high = float(values[min(last + AT_REST - 1, len(values) - 1)])
    if math.isfinite(edge):
        low, high = min(low, edge), max(high, edge)
    return low / ROOM, high * ROOM

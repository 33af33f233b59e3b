"""The picture of the margins of a sampled loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from certrack.plotting.shared import few_ticks, seconds, style

if TYPE_CHECKING:
    from certrack.studies.margins import Margins


def margin_figure(found: Margins, title: str, units: Sequence[str] | None) -> Figure:
    """Worst tail error against period, delay and saturation."""
    names = [f" [{unit}]" if unit not in ("", "1") else "" for unit in units or ("", "")]
    at, unit_ = seconds(found.at)
    panels = {
        "sampling period": found.period,
        f"delay at a period of {found.at * at:.3g} {unit_}": found.delay,
        f"saturation $\\pm u${names[-1]}": found.saturation,
    }
    top = 1e3 * found.error
    with style():
        made = Figure(figsize=(9.0, 3.2), layout="constrained")
        axes, lost = made.subplots(1, 3, sharey=True), False
        for ax, (label, one) in zip(axes, panels.items(), strict=True):
            factor, unit_ = (1.0, "") if ax is axes[-1] else seconds(*one.values)
            values, errors = factor * np.array(one.values), np.array(one.errors)
            shown = np.isfinite(errors) & (errors < top)
            ax.loglog(values[shown], errors[shown], ".-", label="worst member")
            lost = lost or not shown.all()
            label_ = "lost, or off the scale"
            ax.plot(values[~shown], [top] * (~shown).sum(), "x", color="#d1495b", label=label_)
            ax.axhline(found.error, color="k", ls="--", lw=0.8, label="admitted")
            edge = factor * one.exact if one.exact else math.nan
            ax.axvline(edge, color="#2e8b57", ls=":", lw=1.2, label="exact edge of stability")
            ax.set_xlabel(f"{label} [{unit_}]" if unit_ else label)
            few_ticks(ax)
        handles, labels = axes[0].get_legend_handles_labels()
        some = {
            "lost, or off the scale": lost,
            "exact edge of stability": any(one.exact for one in panels.values()),
        }
        kept = [k for k, label in enumerate(labels) if some.get(label, True)]
        made.legend(
            [handles[k] for k in kept],
            [labels[k] for k in kept],
            loc="outside lower center",
            ncols=len(kept),
        )
        axes[0].set_ylabel(f"tail error{names[0]}")
        made.suptitle(title, fontsize=10, fontweight="bold")
    return made

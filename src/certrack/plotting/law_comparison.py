"""The picture of laws side by side: the error of the members, a fan for each law."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from certrack.plotting.ensembles import BANDS, plot_fan
from certrack.plotting.shared import few_ticks, new_figure, set_title, style

if TYPE_CHECKING:
    from certrack.tuning.comparison.compare_laws import LawComparison

#: Columns of the picture, and the size of a part, in.
PANEL_COLUMNS, PART_WIDTH, PART_HEIGHT = 2, 3.6, 1.7


def law_comparison_figure(result: LawComparison, title: str) -> Figure:
    """e_1 of the members in the tail of the run, a panel for each law, each on its own scale.

    Parameters
    ----------
    result : LawComparison
    title : str

    Returns
    -------
    Figure
    """
    shown = [figures for figures in result.laws if figures.members is not None]
    settings = result.system.settings
    window = (settings.tail_start, settings.duration)
    rows = max(1, -(-len(shown) // PANEL_COLUMNS))
    with style():
        drawing = new_figure(PANEL_COLUMNS * PART_WIDTH, rows * PART_HEIGHT + 0.5)
        axes = np.atleast_1d(drawing.subplots(rows, PANEL_COLUMNS, squeeze=False)).ravel()
        for ax, figures in zip(axes, shown, strict=False):
            assert figures.members is not None
            plot_fan(ax, replace(figures.members, limit=None), window=window)
            ax.set_title(figures.name, fontsize="medium")
            few_ticks(ax)
        for ax in axes[len(shown) :]:
            ax.set_visible(False)
        for ax in axes[max(0, len(shown) - PANEL_COLUMNS) : len(shown)]:
            ax.set_xlabel("t [s]")
        if shown:
            handles, labels = axes[0].get_legend_handles_labels()
            known = dict(zip(labels, handles, strict=True))
            names = [label for *_, label, _ in BANDS] + ["median"]
            drawing.legend([known[n] for n in names], names, loc="outside lower center", ncols=4)
        set_title(drawing, title)
    return drawing

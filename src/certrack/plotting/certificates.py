"""The picture of the certificates: bounds side by side, and the tube."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from certrack.certificates.certificate import Certificate
from certrack.core.rounding import rounded_up
from certrack.plotting.shared import BLUE, GRAY, PAGE_WIDTH, new_figure, style

if TYPE_CHECKING:
    from certrack.certificates import Certificates

#: The tube is shown until its distance from the final bound has shrunk by this factor.
TUBE_DECAY = 1e-3


def certificates_figure(certificates: Certificates) -> Figure:
    """Bound of every method, verified ones in colour, and the tube where there is one.

    Parameters
    ----------
    certificates : Certificates

    Returns
    -------
    Figure

    Examples
    --------
    >>> import certrack
    >>> found = certrack.certify(certrack.load("dual-motor-lean"))
    >>> len(certrack.plotting.certificates_figure(found).axes)
    2
    """
    entries = [getattr(certificates, entry.name) for entry in fields(certificates)]
    bounds = [entry for entry in entries if isinstance(entry, Certificate)][::-1]
    tube = certificates.tube
    with style():
        drawing = new_figure(PAGE_WIDTH, 1.0 + 0.28 * len(bounds))
        axes = drawing.subplots(1, 1 if tube is None else 2, squeeze=False)[0]
        ax, names = axes[0], [entry.kind for entry in bounds]
        widths = [entry.bound if entry.exists else 0.0 for entry in bounds]
        colors = [BLUE if entry.verified else GRAY for entry in bounds]
        ax.barh(names, widths, color=colors, height=0.6)
        for name, entry in zip(names, bounds, strict=True):
            text = f" {rounded_up(entry.bound, 4)}" if entry.exists else " none"
            ax.text(entry.bound if entry.exists else 0.0, name, text, va="center", fontsize=8)
        ax.set_xlabel("bound on limsup $|e_1|$")
        ax.set_title("blue: verified exactly", loc="left", fontweight="normal", fontsize=8)
        ax.margins(x=0.3)
        ax.grid(axis="y", visible=False)
        if tube is not None:
            right, end = axes[1], math.log(1 / TUBE_DECAY) / tube.alpha
            t = np.concatenate([[0.0], np.geomspace(end * 1e-3, end, 300)])
            right.plot(t, tube(t), color=BLUE)
            right.set_yscale("log")
            right.set_xlabel("time [s]")
            right.set_ylabel("tube: bound on $|e_1(t)|$")
            right.set_title("from the start of the system", loc="left", fontweight="normal")
        elif max(widths, default=0.0) <= 0:
            ax.set_xlim(0, 1)
    return drawing

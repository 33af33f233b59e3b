"""The picture of the starts from which the input is proven never to meet its limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from certrack.certificates.implemented.certify import ImplementedCertificate
from certrack.core.errors import InputError
from certrack.plotting.appearance import PAGE, Appearance
from certrack.plotting.names import math_name
from certrack.plotting.shared import (
    BLUE,
    GRAY,
    GREEN,
    RED,
    in_brackets,
    new_figure,
    style,
)

#: Width and height of the picture, inches.
SIZE = (4.6, 4.2)


def starts_figure(
    certificate: ImplementedCertificate,
    states: tuple[str, str] | None = None,
    title: str = "",
    units: Sequence[str] | None = None,
    appearance: Appearance = PAGE,
) -> Figure:
    """Sections of the proven starts by two states.

    Parameters
    ----------
    certificate : ImplementedCertificate
        With a polytope: of a drive whose input has limits.
    states : two names, optional
        The first two by default. The others are zero, or as in x0.
    title : str
    units : texts, optional
        Of the states, as ``system.plant.units``.
    appearance : Appearance

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        If there is no polytope, or no such states.

    Examples
    --------
    >>> import certrack
    >>> from certrack.certificates.implemented.certify import certify_implemented
    >>> found, _ = certify_implemented(certrack.load("dual-motor-drive"))
    >>> len(certrack.plotting.starts_figure(found, ("x1", "x3")).axes)
    1
    """
    polytope = certificate.polytope
    if polytope is None:
        raise InputError(
            "certificate",
            "has no polytope of starts",
            remedy="It is for a drive whose input has limits that are met from some starts only",
        )
    first, second = states or _first_two(polytope.states)
    i, j = polytope.index(first), polytope.index(second)
    with style(appearance):
        drawing = new_figure(*appearance.size or SIZE)
        ax = drawing.subplots()
        _fill(ax, polytope.section(i, j), BLUE, "proven, the other states zero")
        if len(certificate.start) == len(polytope.states):
            of_x0 = polytope.section(i, j, certificate.start)
            others = len(polytope.states) > 2 and any(
                v for k, v in enumerate(certificate.start) if k not in (i, j)
            )
            if others:
                _outline(ax, of_x0, RED, "proven, the others as in $x_0$")
            ax.plot(*np.array(certificate.start)[[i, j]], "o", color=RED, label="$x_0$", ms=4)
        _rectangle(ax, [polytope.region[k] for k in (i, j)], GRAY, "region that was looked at")
        box = polytope.largest_box()
        if box is not None and not polytope.is_region:
            _rectangle(ax, [box[k] for k in (i, j)], GREEN, "largest box, of all states")
        along, across = (
            f"{math_name(polytope.states[k])} at $t = 0$" + in_brackets(units[k] if units else "")
            for k in (i, j)
        )
        ax.set(xlabel=along, ylabel=across)
        ax.set_title(title or "starts from which no limit of the input is met", loc="left")
        ax.margins(0.05)
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return drawing


def _fill(ax: Axes, corners: np.ndarray, color: str, label: str) -> None:
    if len(corners):
        ax.add_patch(Polygon(corners, facecolor=color, alpha=0.3, edgecolor=color, label=label))


def _outline(ax: Axes, corners: np.ndarray, color: str, label: str) -> None:
    if len(corners):
        ax.add_patch(Polygon(corners, fill=False, edgecolor=color, label=label))


def _rectangle(ax: Axes, ends: Sequence[tuple[float, float]], color: str, label: str) -> None:
    (a, b), (c, d) = ends
    patch = Rectangle((a, c), b - a, d - c, fill=False, edgecolor=color, ls="--", label=label)
    ax.add_patch(patch)
    ax.update_datalim([(a, c), (b, d)])
    ax.autoscale_view()


def _first_two(states: Sequence[str]) -> tuple[str, str]:
    if len(states) < 2:
        raise InputError("states", "must be two: a plant of one state has no section")
    return states[0], states[1]

"""How a picture looks: for a page, a column of a paper, a slide; its size, title and window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from certrack.core import checks
from certrack.core.keys import set_fields

#: For each kind: width in inches, height of a panel, and what differs from the common style.
KINDS: Mapping[str, tuple[float, float, dict[Any, Any]]] = {
    "page": (6.5, 1.9, {}),
    "paper": (
        3.5,
        1.35,
        {
            "font.size": 8,
            "axes.titlesize": 8,
            "legend.fontsize": 7.0,
            "lines.linewidth": 1.0,
            "axes.linewidth": 0.6,
            "xtick.major.width": 0.6,
            "ytick.major.width": 0.6,
            "font.family": "STIXGeneral",
            "mathtext.fontset": "stix",
        },
    ),
    "slides": (
        10.0,
        2.4,
        {
            "font.size": 16,
            "axes.titlesize": 16,
            "legend.fontsize": 14,
            "lines.linewidth": 2.2,
            "axes.linewidth": 1.2,
        },
    ),
}


@dataclass(frozen=True)
class Appearance:
    """How pictures are drawn.

    Parameters
    ----------
    kind : {"page", "paper", "slides"}
        A page, one column of a paper, a slide: width and type.
    size : (width, height) in inches, optional
    title : str, optional
        In the place of the system's; "" for none.
    window : (from, to) in seconds, optional
        The times that are shown.
    """

    kind: str = "page"
    size: tuple[float, float] | None = None
    title: str | None = None
    window: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        checks.choice("appearance.kind", self.kind, KINDS)
        if self.size is not None:
            size = checks.reals(
                "appearance.size", self.size, 2, "width and height in inches", above=0
            )
            set_fields(self, size=size)
        if self.window is not None:
            window = checks.ordered_pair("appearance.window", self.window, strict=True)
            set_fields(self, window=window)

    @property
    def changes(self) -> dict[Any, Any]:
        """What differs from the common style."""
        return KINDS[self.kind][2]

    def extent(self, panels: float) -> tuple[float, float]:
        """Width and height of a figure of so many panels below each other."""
        if self.size is not None:
            return self.size
        width, height, _ = KINDS[self.kind]
        return width, height * panels + 0.25 * height

    def titled(self, title: str) -> str:
        """The title to show where the system's is this one."""
        return title if self.title is None else self.title


#: As pictures are drawn if nothing else is asked for.
PAGE = Appearance()

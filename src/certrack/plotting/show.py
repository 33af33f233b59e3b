"""Figures in windows, where there is a display and a toolkit for it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from matplotlib.figure import Figure

#: Toolkits, in the order in which they are tried.
TOOLKITS = ("qtagg", "tkagg", "gtk4agg", "gtk3agg", "wxagg", "macosx")


def show(figures: Sequence[Figure]) -> str:
    """Show figures in windows until they are closed.

    Parameters
    ----------
    figures : sequence of Figure

    Returns
    -------
    str
        Empty, or why there is no window.

    Examples
    --------
    >>> import certrack
    >>> run = certrack.simulate(certrack.load("example1"))
    >>> certrack.plotting.show([certrack.plot(run)])  # doctest: +SKIP
    ''
    """
    if not _has_display():
        return "there is no display here"
    reasons = []
    for name in TOOLKITS:
        try:
            canvas: Any = import_module(f"matplotlib.backends.backend_{name}").FigureCanvas
            managers = [canvas.new_manager(drawing, k) for k, drawing in enumerate(figures, 1)]
        except Exception as problem:  # a toolkit fails in its own way: no module, no display
            reasons.append(f"{name}: {problem}")
            continue
        for manager in managers:
            manager.show()
        canvas.manager_class.start_main_loop()
        return ""
    return "no toolkit opens one (" + "; ".join(reasons[:2]) + ")"


def _has_display() -> bool:
    """Whether windows can be: always on Windows and macOS, elsewhere with a display server."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))

"""What a result looks like in a notebook.

The picture of a run needs plotting, which is far above the run. So an object only says that it can
be shown, and how is found by name when a notebook asks: nothing is imported before.
"""

from __future__ import annotations

from importlib import import_module

#: The module that writes the HTML of everything that can be shown.
WRITER = "certrack.plotting.notebook"


class ShownInNotebooks:
    """Base of what notebooks show with tables, formulas and a picture."""

    def _repr_html_(self) -> str:
        html: str = import_module(WRITER).html(self)
        return html

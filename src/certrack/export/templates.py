"""Text files that lie beside the code: templates, and sources that are handed on as they are.

A template is what is written, with ``${placeholders}``; so a reader sees the C, the README or the
page as it will be.
"""

from __future__ import annotations

from importlib.resources import files
from string import Template


def packaged_text(path: str) -> str:
    """A text file of this room, by its path from here."""
    return files("certrack.export").joinpath(*path.split("/")).read_text("utf-8")


def fill_template(path: str, **values: object) -> str:
    """The template with the values in their places.

    Raises
    ------
    KeyError
        If it has a placeholder without a value, or a value has no placeholder.
    """
    template = Template(packaged_text(path))
    if surplus := values.keys() - set(template.get_identifiers()):
        raise KeyError(f"{path} has no place for {', '.join(sorted(surplus))}")
    return template.substitute(values)

"""The version of the installed package."""

from __future__ import annotations

from importlib.metadata import version as _installed


def version() -> str:
    """Version text, e.g. ``"0.1.0"``."""
    return _installed("certrack")


__version__ = version()

"""Verbs that hand the controller to other tools: export c, ..."""

from __future__ import annotations

import click


@click.group()
def export() -> None:
    """Export the controller to other tools.

    \b
    Example: certrack export c example1 --period 0.001 --out firmware
    """

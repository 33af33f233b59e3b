"""The shipped systems, as texts."""

from __future__ import annotations

import tomllib
from importlib.resources import files

from certrack.core.errors import InputError


def catalog() -> dict[str, str]:
    """Names and titles of the shipped systems.

    Returns
    -------
    dict
        Title by name.

    Examples
    --------
    >>> import certrack
    >>> certrack.catalog()["example1-classic"]
    'Second-order benchmark (Actuators 14:367, Example 1), classic law'
    """
    return {name: tomllib.loads(shipped_text(name))["title"] for name in shipped_names()}


def shipped_names() -> list[str]:
    """Names of the shipped systems, none of which is read."""
    entries = (files("certrack.systems") / "catalog").iterdir()
    return sorted(e.name.removesuffix(".toml") for e in entries if e.name.endswith(".toml"))


def starter(shipped: str | None = None) -> str:
    """Text of a commented system file to begin with: the general one, or a shipped system's.

    Parameters
    ----------
    shipped : str, optional
        Name of a shipped system.

    Returns
    -------
    str

    Examples
    --------
    >>> import certrack
    >>> certrack.loads(certrack.starter()).law.kind
    'adaptive'
    """
    if shipped is not None:
        return shipped_text(shipped)
    return (files("certrack.systems") / "starter.toml").read_text("utf-8")


def shipped_text(name: str) -> str:
    """The file of a shipped system."""
    names = shipped_names()
    if name not in names:
        raise InputError(
            name,
            "is neither a file nor a shipped system",
            remedy="Shipped: " + ", ".join(names),
        )
    return (files("certrack.systems") / "catalog" / f"{name}.toml").read_text("utf-8")

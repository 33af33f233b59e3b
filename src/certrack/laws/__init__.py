"""Control laws: one law, one file, side by side with its equations."""

from importlib.metadata import entry_points

from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Controller, Law, Signals
from certrack.laws.classic import Classic
from certrack.laws.robust import Robust

LAWS: dict[str, type[Law]] = {law.kind: law for law in (Adaptive, Robust, Classic)}


def known_laws() -> dict[str, type[Law]]:
    """The laws a system file can name: ours, and those of packages that declare the entry point
    group ``certrack.laws``.
    """
    return {point.name: point.load() for point in entry_points(group="certrack.laws")} | LAWS


__all__ = ["LAWS", "Adaptive", "Classic", "Controller", "Law", "Robust", "Signals", "known_laws"]

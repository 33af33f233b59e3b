"""Control laws: one law, one file, side by side with its equations."""

from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Controller, Law, Signals
from certrack.laws.classic import Classic
from certrack.laws.robust import Robust

#: The laws a system file can name.
LAWS: dict[str, type[Law]] = {law.kind: law for law in (Adaptive, Robust, Classic)}

__all__ = ["LAWS", "Adaptive", "Classic", "Controller", "Law", "Robust", "Signals"]

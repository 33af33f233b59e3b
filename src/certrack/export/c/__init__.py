"""The controller as C99 with its acceptance test, and that C in the simulated loop."""

from certrack.export.c.files import Exported, export

__all__ = ["Exported", "export"]

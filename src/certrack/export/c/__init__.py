"""The controller as C99 with its acceptance test, and that C in the simulated loop."""

from certrack.export.c.export import Exported, export_c
from certrack.export.c.software_in_the_loop import difference_from_python, simulate_with_c

__all__ = ["Exported", "difference_from_python", "export_c", "simulate_with_c"]

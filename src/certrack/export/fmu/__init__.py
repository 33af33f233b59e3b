"""The controller as a co-simulation FMU (FMI 2.0 and 3.0)."""

from certrack.export.fmu.archive import export_fmu, fmu

__all__ = ["export_fmu", "fmu"]

"""The present design in the formats that others read, each as one file to download."""

from __future__ import annotations

import io
import json
import tempfile
import zipfile
from pathlib import Path

from certrack.app.messages import REPORTS
from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.export.identifiers import stem
from certrack.model.implementation import USUAL_PERIOD
from certrack.systems.system import System


def exported_file(
    system: System, text: str, name: str, file_format: str, progress: Progress = silent
) -> tuple[str, bytes]:
    """Name and content of one exported file.

    Parameters
    ----------
    system : System
    text : str
        Of its file, with the gains that it has now.
    name : str
        Of the design.
    file_format : str
        One of :data:`certrack.app.messages.EXPORTS`.
    progress : callable
        Told of every part of a dossier.

    Raises
    ------
    InputError, DesignError
        If the system cannot be exported so.
    """
    base = stem(name or "design")
    if file_format == "toml":
        return f"{base}.toml", text.encode()
    if file_format in REPORTS:
        return _report(system, base, REPORTS[file_format], progress)
    period = USUAL_PERIOD if system.implementation is None else None
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        match file_format:
            case "certificate":
                return f"{base}-certificate.json", _certificate(system)
            case "c":
                from certrack.export.c import export_c

                export_c(system, folder / base, base, period=period)
                return f"{base}-c.zip", _zipped(folder / base)
            case "st":
                from certrack.export.st import export_st

                path = export_st(system, folder / f"{base}.st", period=period)
            case "fmu":
                from certrack.export.fmu import export_fmu

                path = export_fmu(system, folder / f"{base}.fmu", period=period)
            case "netcdf":
                from certrack.simulation.simulator import simulate

                path = folder / f"{base}.nc"
                simulate(system).save(path)
            case _:
                return f"{base}.{file_format}", _picture(system, file_format)
        return path.name, path.read_bytes()


def _report(system: System, base: str, ending: str, progress: Progress) -> tuple[str, bytes]:
    from certrack.reports.dossier import dossier
    from certrack.reports.pages import require_writable, save_dossier

    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / f"{base}-report{ending}"
        require_writable(path)
        save_dossier(dossier(system, f"{base}.toml", progress=progress), path)
        return path.name, path.read_bytes()


def _certificate(system: System) -> bytes:
    from certrack.certificates import certify, to_document

    results = certify(system)
    if not results.stages:
        reason = results.reason or results.best.reason or "nothing is verified"
        raise InputError("certificate", f"there is none to export: {reason}")
    return json.dumps(to_document(system, *results.stages), indent=1).encode()


def _picture(system: System, file_format: str) -> bytes:
    from certrack import plotting
    from certrack.certificates import certify
    from certrack.simulation.simulator import simulate

    certified = {"run": certify(system, "fast")}
    figure = plotting.overview(
        {"run": simulate(system)}, system.title, plotting.Appearance("page"), certified
    )
    stream = io.BytesIO()
    figure.savefig(stream, format=file_format, dpi=160)
    return stream.getvalue()


def _zipped(folder: Path) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.iterdir()):
            archive.write(path, f"{folder.name}/{path.name}")
    return stream.getvalue()

"""Section of a dossier that says what exactly it is about: the file, the versions, the digests."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version

from certrack.core.version import __version__
from certrack.reports.evidence import DesignEvidence
from certrack.reports.sections import Attachment, Section
from certrack.reports.tables import table
from certrack.systems.writer import to_text

#: Packages on which the numbers depend.
PACKAGES = ("numpy", "scipy", "sympy", "python-flint", "heyoka", "mpmath", "matplotlib")


def file_section(evidence: DesignEvidence) -> Section:
    """The system as a file, written anew without comments, and what computed the dossier."""
    text = to_text(evidence.system)
    digest = hashlib.sha256(text.encode()).hexdigest()
    rows = [["certrack", __version__], ["Python", platform.python_version()]]
    rows += [[name, _installed(name)] for name in PACKAGES]
    return Section(
        key="file",
        title="The system file",
        lines=(
            "What everything above is about, written anew without the comments of its file. "
            "Digests are SHA-256: a text with another digest may be another system.",
        ),
        tables=(table("computed by", ["package", "version"], rows),),
        attachments=(Attachment("system.toml", "application/toml", text, digest),),
        code=text,
    )


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"

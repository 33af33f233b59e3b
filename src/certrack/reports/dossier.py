"""The dossier of a design: what a reviewer or a customer gets, with how to check it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from certrack.core.progress import Progress, silent
from certrack.reports.evidence import DesignEvidence, evidence_of
from certrack.reports.file_section import file_section
from certrack.reports.guarantee import guarantee_section, premises_section, summary
from certrack.reports.run_sections import (
    drive_section,
    ensemble_section,
    falsification_section,
    margins_section,
    response_section,
)
from certrack.reports.sections import Section
from certrack.reports.system_sections import law_section, plant_section
from certrack.systems.system import System, require_system


@dataclass(frozen=True)
class Dossier:
    """All that was found of a design.

    Attributes
    ----------
    title : str
    summary : texts
        What is guaranteed, in a few sentences.
    sections : sequence of Section
    verified : bool
        Whether the best bound is proven, no premise is contradicted and no run is beyond it.
    sound : bool
        Whether no premise is contradicted, and no run that was found is beyond a verified bound.
    """

    title: str
    summary: tuple[str, ...]
    sections: tuple[Section, ...]
    verified: bool
    sound: bool


#: The sections, in their order; what is None for a design has none.
IN_ORDER = (
    *(plant_section, law_section, premises_section, guarantee_section, response_section),
    *(falsification_section, ensemble_section, margins_section, drive_section, file_section),
)


def dossier(
    system: System,
    file: str = "FILE.toml",
    *,
    effort: str = "default",
    members: int = 1000,
    budget: int = 6000,
    seed: int = 0,
    without: Collection[str] = (),
    progress: Progress = silent,
) -> Dossier:
    """Everything about a design that can be checked: premises, guarantee, runs, worst cases, drive.

    The same system and arguments give the same dossier, as far as floats are the same.

    Parameters
    ----------
    system : System
    file : str
        Name of its file, for the commands that the dossier quotes.
    effort : {"fast", "default", "high"}
        Of the certificates.
    members : int
        Of the ensemble.
    budget : int
        Runs of the falsifier.
    seed : int
        Of both.
    without : names
        Parts to leave out, since they take time: ``falsification``, ``ensemble``, ``margins``.
    progress : callable
        Told of every part.

    Returns
    -------
    Dossier

    Raises
    ------
    InputError
        If an argument is not of the stated kind.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> result = certrack.dossier(system, without=["falsification", "ensemble", "margins"])
    >>> result.summary[0]
    'limsup |e_1| <= 0.0012874, verified exactly (peak)'
    """
    require_system(system)
    evidence = evidence_of(
        system,
        file,
        effort=effort,
        members=members,
        budget=budget,
        seed=seed,
        without=without,
        progress=progress,
    )
    return dossier_of(evidence)


def dossier_of(evidence: DesignEvidence) -> Dossier:
    """The dossier of what was found."""
    worst = evidence.falsification
    sound = not evidence.certificates.contradicted and (worst is None or worst.alarm is None)
    sections = (section(evidence) for section in IN_ORDER)
    return Dossier(
        title=evidence.system.title or evidence.file,
        summary=tuple(summary(evidence)),
        sections=tuple(section for section in sections if section is not None),
        verified=sound and evidence.certificates.verified,
        sound=sound,
    )

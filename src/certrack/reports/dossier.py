"""The dossier of a design: what a reviewer or a customer gets, with how to check it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from certrack.core.progress import Progress, silent
from certrack.reports.findings import Findings, findings
from certrack.reports.guarantee import guarantee, premises, summary
from certrack.reports.identity import identity
from certrack.reports.of_runs import drive, falsification, many_runs, one_run, tried_margins
from certrack.reports.of_system import law, plant
from certrack.reports.sections import Section
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
        Whether the best bound is proven and no premise is contradicted.
    sound : bool
        Whether no premise is contradicted.
    """

    title: str
    summary: tuple[str, ...]
    sections: tuple[Section, ...]
    verified: bool
    sound: bool


#: The sections, in their order; what is None for a design has none.
SECTIONS = (
    *(plant, law, premises, guarantee, one_run),
    *(falsification, many_runs, tried_margins, drive, identity),
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
    >>> made = certrack.dossier(system, without=["falsification", "ensemble", "margins"])
    >>> made.summary[0]
    'limsup |e_1| <= 0.0012874, verified exactly (peak)'
    """
    require_system(system)
    found = findings(
        system,
        file,
        effort=effort,
        members=members,
        budget=budget,
        seed=seed,
        without=without,
        progress=progress,
    )
    return dossier_of(found)


def dossier_of(found: Findings) -> Dossier:
    """The dossier of what was found."""
    made = (section(found) for section in SECTIONS)
    return Dossier(
        title=found.system.title or found.file,
        summary=tuple(summary(found)),
        sections=tuple(section for section in made if section is not None),
        verified=found.certificates.verified,
        sound=not found.certificates.contradicted,
    )

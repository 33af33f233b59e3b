"""All that a dossier reports, computed once."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TypeVar

from certrack.certificates import BoundEstimate, Certificates, certify, estimate
from certrack.core import checks
from certrack.core.errors import Cancelled, CertrackError
from certrack.core.progress import Progress, silent
from certrack.export.c.source import CCode, c_code
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.ensembles.ensemble import Ensemble, ensemble
from certrack.studies.falsifier.falsify import Falsification, falsify
from certrack.studies.margins import Margins, margins
from certrack.systems.system import System

PartResult = TypeVar("PartResult")

#: Parts that may be left out, since they take time.
OPTIONAL = ("falsification", "ensemble", "margins")

#: Most members, and runs of the falsifier, that are taken.
MAX_RUNS = 10**9


@dataclass(frozen=True)
class DesignEvidence:
    """What was found of a design.

    Attributes
    ----------
    system : System
    file : str
        Its name in the commands that the dossier quotes.
    certificates : Certificates
    run : Run
        From the system's own start.
    estimate : BoundEstimate or None
        For the shares of the causes.
    falsification : Falsification or None
    ensemble : Ensemble or None
    margins : Margins or None
    code : CCode or None
        Of the controller, where the file has a drive.
    refusals : mapping of names to texts
        Why one of these is None, by its name; nothing where it was left out.
    """

    system: System
    file: str
    certificates: Certificates
    run: Run
    estimate: BoundEstimate | None
    falsification: Falsification | None
    ensemble: Ensemble | None
    margins: Margins | None
    code: CCode | None
    refusals: Mapping[str, str]


def evidence_of(
    system: System,
    file: str = "FILE.toml",
    *,
    effort: str = "default",
    members: int = 1000,
    budget: int = 6000,
    seed: int = 0,
    without: Collection[str] = (),
    progress: Progress = silent,
) -> DesignEvidence:
    """Compute all parts, in the order of the dossier; parameters as of :func:`dossier`."""
    for name in without:
        checks.choice("without", name, OPTIONAL)
    checks.integer("members", members, 1, MAX_RUNS)
    refusals: dict[str, str] = {}
    done = 0.0

    def part(
        name: str, compute: Callable[[], PartResult], needed: bool = True
    ) -> PartResult | None:
        """What was computed; None where it is left out or refused, which is noted."""
        nonlocal done
        progress(done, 7, None)
        done += 1
        try:
            return compute() if needed and name not in without else None
        except Cancelled:
            raise
        except CertrackError as refusal:
            refusals[name] = str(refusal)
            return None

    progress(done, 7, None)
    certificates = certify(system, effort)
    run = simulate(system)
    evidence = DesignEvidence(
        system=system,
        file=file,
        certificates=certificates,
        run=run,
        estimate=part("estimate", lambda: estimate(system)),
        falsification=part("falsification", lambda: falsify(system, budget=budget, seed=seed)),
        ensemble=part("ensemble", lambda: ensemble(system, members, seed=seed)),
        margins=part("margins", lambda: margins(system, seed=seed)),
        code=part("code", lambda: c_code(system), system.implementation is not None),
        refusals=refusals,
    )
    progress(7, 7, None)
    return evidence

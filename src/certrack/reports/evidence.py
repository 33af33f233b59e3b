"""All that a dossier reports, computed once."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import TypeVar

from certrack.certificates import BoundEstimate, Certificates, certify, estimate
from certrack.core import checks
from certrack.core.errors import Cancelled, CertrackError
from certrack.core.progress import Progress, silent
from certrack.export.c.source import CCode, c_code
from certrack.model.implementation import MAX_SEED
from certrack.model.sampling import MAX_MEMBERS
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.ensembles.ensemble import Ensemble, ensemble
from certrack.studies.falsifier.falsify import MAX_BUDGET, Falsification, falsify
from certrack.studies.margins import Margins, margins
from certrack.systems.system import System

PartResult = TypeVar("PartResult")

#: Parts that may be left out, since they take time.
OPTIONAL = ("falsification", "ensemble", "margins")

#: Steps of which `progress` is told: certificates, run, and the five that may be refused.
EVIDENCE_STEPS = 7

#: What the commands take where nothing is said.
DEFAULT_EFFORT, DEFAULT_BUDGET = "default", 6000


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
    effort, budget, seed
        As of :func:`dossier`, for the commands that the dossier quotes.
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
    effort: str = DEFAULT_EFFORT
    budget: int = DEFAULT_BUDGET
    seed: int = 0

    def command(self, verb: str, options: str = "") -> str:
        """The command line that computes a part anew, with the arguments that matter to it."""
        changed = ""
        if verb == "certify" and self.effort != DEFAULT_EFFORT:
            changed = f" --effort {self.effort}"
        if verb == "falsify":
            changed += f" --budget {self.budget}" if self.budget != DEFAULT_BUDGET else ""
            changed += f" --seed {self.seed}" if self.seed else ""
        return f"certrack {verb} {shlex.quote(self.file)}{changed}{options}"


def evidence_of(
    system: System,
    file: str = "FILE.toml",
    *,
    effort: str = DEFAULT_EFFORT,
    members: int = 1000,
    budget: int = DEFAULT_BUDGET,
    seed: int = 0,
    without: Collection[str] = (),
    progress: Progress = silent,
) -> DesignEvidence:
    """Compute all parts, in the order of the dossier; parameters as of :func:`dossier`."""
    for name in without:
        checks.choice("without", name, OPTIONAL)
    checks.integer("members", members, 1, MAX_MEMBERS)
    checks.integer("budget", budget, 1, MAX_BUDGET)
    checks.integer("seed", seed, 0, MAX_SEED - 1)
    refusals: dict[str, str] = {}
    done = 0

    def begin() -> None:
        nonlocal done
        progress(done, EVIDENCE_STEPS, None)
        done += 1

    def part(
        name: str, compute: Callable[[], PartResult], needed: bool = True
    ) -> PartResult | None:
        """What was computed; None where it is left out or refused, which is noted."""
        begin()
        try:
            return compute() if needed and name not in without else None
        except Cancelled:
            raise
        except CertrackError as refusal:
            refusals[name] = str(refusal)
            return None

    begin()
    certificates = certify(system, effort)
    begin()
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
        effort=effort,
        budget=budget,
        seed=seed,
    )
    progress(EVIDENCE_STEPS, EVIDENCE_STEPS, None)
    return evidence

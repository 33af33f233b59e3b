"""Run the paper, judge it, draw it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

from matplotlib.figure import Figure

from certrack.certificates import Certificates
from certrack.core.progress import Progress, silent
from certrack.papers.liu2025.claim import Claim, Observation
from certrack.papers.liu2025.drawing import servo_diagram
from certrack.papers.liu2025.example1 import example1_claims
from certrack.papers.liu2025.example2 import example2_claims
from certrack.papers.liu2025.figures import paper_figures
from certrack.papers.liu2025.observations import observations
from certrack.papers.liu2025.printed_laws import printed_law_claims
from certrack.papers.liu2025.proof_figures import counterexample_figure, tubes_figure
from certrack.papers.liu2025.runs import CERTIFIED, PaperRuns, paper_runs
from certrack.papers.liu2025.sections import section_claims
from certrack.papers.liu2025.theorem1 import theorem1_claims
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.falsify import falsify
from certrack.systems.reader import load


@dataclass(frozen=True)
class Reproduction:
    """Result of :func:`reproduce`.

    Attributes
    ----------
    claims : tuple of Claim
        In the order of the paper.
    observations : tuple of Observation
        What the paper does not claim.
    figures : figures by file name, without its extension
    runs : runs by the name of the shipped system
    bounds : by the name of the system, then by kind: certified, falsified and simulated sup |e_1|
    """

    claims: tuple[Claim, ...]
    observations: tuple[Observation, ...]
    figures: dict[str, Figure]
    runs: dict[str, Run]
    bounds: dict[str, dict[str, float]]


def reproduce(
    progress: Progress = silent,
    budget: int = 3000,
    tell: Callable[[str], None] = lambda _: None,
) -> Reproduction:
    """Run the paper's examples and judge its claims.

    Parameters
    ----------
    progress : callable
        Gets the number of the step that begins, None and None.
    budget : int
        Runs that the falsifier spends on each system.
    tell : callable
        Gets a text that says what the step does.

    Returns
    -------
    Reproduction

    Examples
    --------
    >>> import certrack
    >>> result = certrack.reproduce(budget=100)  # doctest: +SKIP
    >>> [claim.verdict for claim in result.claims]  # doctest: +SKIP
    """
    steps = count(1)

    def begin(what: str) -> None:
        tell(what)
        progress(next(steps), None, None)

    runs = paper_runs(begin)
    begin("Judging the claims")
    claims = (
        *section_claims(runs),
        *theorem1_claims(runs),
        *printed_law_claims(runs),
        *example1_claims(runs),
        *example2_claims(runs),
    )
    notes = tuple(observations(runs))
    bounds = {}
    for name in CERTIFIED:
        begin(f"Falsifying {name}")
        bounds[name] = _bounds(name, runs.certificates[name], budget)
    begin("Figures")
    figures = {
        "figure-1": servo_diagram(),
        **paper_figures(runs),
        "certificates": tubes_figure(runs),
        "counterexample": counterexample_figure(runs),
    }
    return Reproduction(claims, notes, figures, _runs_by_name(runs), bounds)


def _runs_by_name(runs: PaperRuns) -> dict[str, Run]:
    improved, classic = runs.example1[(1, 2), 1]
    return {
        "example1": improved,
        "example1-classic": classic,
        "dual-motor": runs.weak,
        "dual-motor-strong": runs.strong,
    }


def _bounds(name: str, certificates: Certificates, budget: int) -> dict[str, float]:
    """Certified, falsified and simulated errors of one system."""
    system = load(name)
    return {
        "published": certificates.published.bound,
        "corrected": certificates.corrected.bound,
        "semidefinite": certificates.semidefinite.bound,
        "tightest": certificates.best.bound,
        "falsified": falsify(system, budget=budget).worst_error,
        "simulated": simulate(system).metrics.tail_error,
    }

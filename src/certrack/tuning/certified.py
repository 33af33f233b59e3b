"""What is proven of a design, as far as a tuning waits for it."""

from __future__ import annotations

from dataclasses import dataclass

from certrack.certificates.bootstrap.certify import certify_bootstrap
from certrack.certificates.certificate import Certificate
from certrack.certificates.certify import STEPS, certify
from certrack.certificates.claimed_starts import claimed_starts
from certrack.certificates.implemented.certify import KIND
from certrack.certificates.methods import smallest
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.scope import has_ranges
from certrack.core.progress import Progress, silent
from certrack.systems.system import System


def certified(
    system: System,
    *,
    bootstrap: bool = True,
    effort: str = "fast",
    progress: Progress = silent,
) -> Certificate:
    """The best certificate of a system: that of the loop as implemented, else the smallest."""
    return certified_or_why(system, bootstrap=bootstrap, effort=effort, progress=progress).best


@dataclass(frozen=True)
class CertifiedDesign:
    """What is proven of a design.

    Attributes
    ----------
    best : Certificate
    why_continuous : str
        Why there is none of the loop as implemented. Empty where there is no ``[implementation]``,
        or a verified bound of the loop that it makes.
    starts : str
        From which starts it holds, in words; empty for all.
    """

    best: Certificate
    why_continuous: str
    starts: str


def certified_or_why(
    system: System,
    *,
    bootstrap: bool = True,
    effort: str = "fast",
    progress: Progress = silent,
) -> CertifiedDesign:
    """The best certificate, from which starts, and why there is none of the loop as implemented.

    With the effort ``fast`` ranges are cut into cells, which takes seconds: gains that were
    searched for the corners may be too sharp for one proof of the whole box. The loop as
    implemented, of which the cells take minutes, is tried for the whole box only.

    Parameters
    ----------
    system : System
    bootstrap : bool
        Whether the bootstrap, which takes a second or two, may be it with the effort ``fast``.
    effort : {"fast", "default", "high"}
        Others than ``fast`` as :func:`~certrack.certify` has them.
    progress : callable
        Gets what :func:`~certrack.certify` reports; its last step is what ``fast`` leaves out
        there, the cells and the bootstrap.

    Returns
    -------
    CertifiedDesign
    """
    result = certify(system, effort, progress)
    missing = system.implementation is not None and not result.implemented.verified
    reason, starts = result.implemented.reason if missing else "", claimed_starts(result)
    if effort != "fast" or result.best.kind == KIND or result.contradicted:
        return CertifiedDesign(result.best, reason, starts)
    later, others = system.long_run, []
    if has_ranges(system):
        cells = certify_ranges(later, progress=lambda _, __, bound: progress(STEPS, STEPS, bound))
        others.append(cells.best)
    elif bootstrap and result.cascade_proof is not None:
        others.append(certify_bootstrap(later, first=result.cascade_proof[0])[0])
    return CertifiedDesign(smallest((*others, result.best)) or result.best, reason, starts)

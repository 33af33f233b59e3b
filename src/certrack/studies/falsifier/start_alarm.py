"""Is a start that the loop loses one that its certificate claims?"""

from __future__ import annotations

import numpy as np

from certrack.certificates.certify import Certificates, certify
from certrack.certificates.sampled_adaptive.certify import starts_inside
from certrack.core.progress import Progress, silent
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.alarm import DEFECT, PREMISE, Alarm, broken_on_the_way
from certrack.studies.falsifier.lost_starts import LostStarts, is_lost, start_patterns
from certrack.systems.system import System

#: A start is lost for good if its run passes so many times simulation.max_state: a bound in the
#: long run forbids no excursion, which a narrow max_state calls an escape.
ESCAPE_FACTOR = 1e3


def start_alarm(system: System, searched: LostStarts, progress: Progress = silent) -> Alarm | None:
    """The alarm that lost starts raise, or None.

    Of the lost starts that the best verified certificate claims its bound from, the first that is
    lost beyond :data:`ESCAPE_FACTOR` times ``simulation.max_state``, too.

    Parameters
    ----------
    system : System
        The one that was searched.
    searched : LostStarts
    progress : callable
        Of the certificate.
    """
    if not searched.gone or system.truth.states:
        return None
    results = certify(system, progress=progress)
    if not results.verified:
        return None
    patterns = start_patterns(system, np.diff(np.array(searched.box), axis=1)[:, 0] / 2)
    for pattern, x0 in searched.gone:
        case = patterns[pattern].with_settings(x0=x0)
        if not _claimed(system, results, case):
            continue
        run = simulate(case.with_settings(max_state=ESCAPE_FACTOR * case.settings.max_state))
        if is_lost(run):
            at = ", ".join(f"{value:.10g}" for value in x0)
            broken = broken_on_the_way(case, run)
            reason = broken or "certrack itself is wrong; please report this file"
            return Alarm(PREMISE if broken else DEFECT, f"the start [{at}]: {reason}")
    return None


def _claimed(system: System, results: Certificates, case: System) -> bool:
    """Whether the best certificate holds for runs from the start of a case."""
    if results.best is results.sampled:
        return results.sampled_proof is not None and starts_inside(case, results.sampled_proof)
    if results.best is results.implemented:
        return bool(results.implemented.admits(case.settings.x0))
    if system.implementation is not None:
        return False  # what is verified is of the continuous law
    away = np.abs(np.array(case.settings.x0) - np.array(system.settings.x0))
    return results.starts_box is None or bool((away <= results.starts_box).all())

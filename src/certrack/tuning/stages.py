"""What is searched, one after the other: the continuous loop, then that of the drive."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.scope import has_ranges
from certrack.core import checks
from certrack.core.errors import InputError
from certrack.laws.base import Law
from certrack.loops.stability import linear_loop
from certrack.model.plant import MAX_ORDER
from certrack.systems.system import System
from certrack.tuning.companion import companion, is_memoryless, with_law_of
from certrack.tuning.drive_family import DriveFamily
from certrack.tuning.families import AdaptiveFamily, Family
from certrack.tuning.problem import Requirements, TuningProblem
from certrack.tuning.registry import tuning_family


@dataclass(frozen=True)
class GainStage:
    """One search.

    Attributes
    ----------
    problem : TuningProblem
    family : Family
    complete : Family
        The same laws with all that the system's own has besides.
    """

    problem: TuningProblem
    family: Family
    complete: Family

    @property
    def is_quick(self) -> bool:
        """Whether inputs are computed and not simulated, and a bound takes milliseconds."""
        return self.problem.is_linear and self.problem.base.implementation is None

    def beside(self, v: np.ndarray) -> np.ndarray:
        """A point of the continuous loop's as one of this family's."""
        added = len(self.family.start) - len(v)
        return np.append(v, self.family.start[-added:]) if added else v

    def left_alone(self) -> list[str]:
        """What of the law is not tuned, in words; empty if everything is."""
        names = list(getattr(self.complete, "own_keys", ()))
        if self.family is self.complete or not names:
            return []
        system = self.problem.system
        if system.implementation is None:
            why = "their certificate is that of the loop as implemented: state [implementation]"
        elif has_ranges(system):
            why = "constants have ranges, for which the continuous loop is tuned: try other values"
        else:
            why = "the loop is nonlinear, and its continuous form is tuned: try other values"
        return [f"not tuned, as in the file: {', '.join(names)}; {why}"]

    def written(self, v: np.ndarray) -> Law:
        """The law of a point, as the file states it."""
        complete = self.complete
        added = len(complete.start) - len(v)
        return complete.written(np.append(v, complete.start[-added:]) if added else v)


def searches_of(
    system: System, wanted: Requirements, objective: str, kind: str | None, feedforward: int | None
) -> tuple[GainStage, ...]:
    """One or two searches.

    The continuous loop is the first, where it has a certificate; the loop as the drive runs it
    another, where it is linear.

    Raises
    ------
    InputError
        If neither has a certificate.
    """
    plain, law = companion(system), system.law
    q, most = plain.law.order(plain.plant), plain.plant.n - 1
    complete_q = law.order(system.plant)
    if feedforward is not None:
        complete_q = checks.integer(
            "feedforward", feedforward, 0, MAX_ORDER - 1 if law.sampled_feedforward else most
        )
        q = min(feedforward, most)
    family = tuning_family(plain, law.kind if kind is None else kind, q)
    plain = with_law_of(plain, family.law(family.start))
    complete = family if is_memoryless(law) else DriveFamily(family, law, complete_q)
    first = complete.law(complete.start)
    _refuse_uncertified(system, first)
    driven = _driven(system, first)
    try:
        stages = [
            GainStage(TuningProblem(plain, system, wanted, objective, family), family, complete)
        ]
    except NoCertificate as refusal:
        if driven is None:
            raise InputError("tune", f"there is no certificate to tune: {refusal}") from None
        stages = []
    if driven is not None:
        if stages and objective != "error" and wanted.error is None:
            (error,) = (limit for limit in stages[0].problem.task.limits if limit.name == "error")
            wanted = replace(wanted, error=error.value)
        problem = TuningProblem(driven, system, wanted, objective, complete)
        stages.append(GainStage(problem, complete, complete))
    return tuple(stages)


def _driven(system: System, law: Law) -> System | None:
    """The system as the drive runs it, with this law; None if that is not what is optimised."""
    if system.implementation is None:
        return None
    driven = with_law_of(system, law)
    if has_ranges(driven) or linear_loop(driven) is None:
        return None
    return driven


def _refuse_uncertified(system: System, law: Law) -> None:
    """Integral action has a certificate where the loop is linear and implemented, only."""
    if law.integral is None:
        return
    if law.kind == AdaptiveFamily.kind:
        raise InputError(
            "law.integral",
            "has no certificate together with estimates, so nothing could be tuned",
            remedy="Leave it out, or choose law.kind robust",
        )
    if system.implementation is None:
        raise InputError(
            "law.integral",
            "has a certificate as implemented only",
            remedy="State [implementation], or leave it out",
        )

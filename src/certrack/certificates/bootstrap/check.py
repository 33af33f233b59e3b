"""The check of all stages from the text of the system: exact, and with no solver."""

from __future__ import annotations

from collections.abc import Sequence

from certrack.certificates.bootstrap.forms import forms_of
from certrack.certificates.bootstrap.loop import adaptive_loop, formulas_of
from certrack.certificates.bootstrap.polynomial_proof import PolynomialProof, failed_sum
from certrack.certificates.bootstrap.proof import failed_part
from certrack.certificates.bootstrap.ranges import Ranges
from certrack.certificates.bootstrap.regions import after, failed_region, first_box, rows_of
from certrack.certificates.bootstrap.stage import BootstrapStage, Claiming
from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.exact import Proof, failed_condition, from_text
from certrack.certificates.problem import ErrorProblem
from certrack.systems.system import System


def check_bootstrap(
    system: System, problem: ErrorProblem, first: Proof, stages: Sequence[BootstrapStage]
) -> str:
    """Empty if the first proof and every stage hold for the (exact) problem, else what fails."""
    if problem.adaptation is None:
        return "a bootstrap needs the adaptive law"
    reason = failed_condition(problem, first, problem.n - 1)
    if reason:
        return reason
    with within_floats():
        return _failed_stage(system, problem, first, stages)


def _failed_stage(
    system: System, problem: ErrorProblem, first: Proof, stages: Sequence[BootstrapStage]
) -> str:
    loop = adaptive_loop(system, problem)
    ranges = Ranges(formulas_of(system), loop)
    known = first_box(loop, first)
    for stage in stages:
        reason = failed_region(loop, ranges, known, stage.region)
        if reason:
            return reason
        numbers = stage.region.numbers()
        forms, rows = forms_of(loop, numbers), rows_of(loop, numbers)[:]
        allowed = rows[: len(forms.sectors)]
        for function in stage.functions:
            if isinstance(function, PolynomialProof):
                reason = failed_sum(loop, forms, function, allowed)
            else:
                reason = failed_part(forms, function, allowed)
            if reason:
                return reason
        known = after(known, stage.functions, rows)
    return ""


def bounds_error(stages: Sequence[Claiming]) -> bool:
    """Whether the stages bound e_1 on both sides."""
    return all(_error_claims(stages, side) for side in (1, -1))


def _error_claims(stages: Sequence[Claiming], side: int) -> list[str]:
    """The texts of all bounds of e_1 on one side."""
    claims = [c for stage in stages for f in stage.functions for c in f.claims if c.error == 0]
    return [c.bound for c in claims if c.side == side]


def claimed_bound(stages: Sequence[Claiming]) -> str:
    """The text of the bound on limsup |e_1| that the stages claim: the worse of its two sides.

    Raises
    ------
    NoCertificate
        If they do not bound e_1 on both sides.
    """
    sides = [_error_claims(stages, side) for side in (1, -1)]
    if not all(sides):
        raise NoCertificate("no stage bounds e_1 on both sides")
    return max((min(texts, key=from_text) for texts in sides), key=from_text)

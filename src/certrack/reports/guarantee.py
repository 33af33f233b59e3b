"""Sections of a dossier about what is guaranteed, and what the guarantee rests on."""

from __future__ import annotations

import hashlib

from certrack.certificates.document import certificate_text
from certrack.core.rounding import printed_bound, rounded_up
from certrack.plotting.shared import as_svg
from certrack.plotting.starts import starts_figure
from certrack.plotting.tubes import tube_figure
from certrack.reports.certificates import certificates_notes, certificates_table, certified_starts
from certrack.reports.evidence import DesignEvidence
from certrack.reports.premises import premise_rows
from certrack.reports.ranges import costs_table, strength_line
from certrack.reports.sampled import for_starts
from certrack.reports.sections import Attachment, Picture, Section
from certrack.reports.tables import BOUND_TEXT_DIGITS, Table, table
from certrack.studies.falsifier.falsify import Falsification

#: A certificate that is longer, in characters, is named by its digest only.
LONGEST_ATTACHMENT = 700_000

#: A cause that adds less than this part of the bound is not listed.
LEAST_LISTED = 0.001


def summary(evidence: DesignEvidence) -> list[str]:
    """The guarantee, and what was found beside it, in a few sentences."""
    results = evidence.certificates
    lines = [_guaranteed(evidence)]
    broken = [premise.name for premise in results.contradicted]
    if broken:
        lines.append(f"premises contradicted by the file's own truth: {', '.join(broken)}")
    lines.append(f"tail error of the simulated run: {evidence.run.metrics.tail_error:.5g}")
    if evidence.falsification is not None:
        lines.append(_worst_found(evidence, evidence.falsification))
        if evidence.falsification.alarm is not None:
            reason = evidence.falsification.reason
            lines.insert(1, f"ALARM: a run is beyond the verified bound: {reason}")
    if evidence.ensemble is not None:
        error, _ = evidence.ensemble.statistics.worst[0]
        lines.append(f"largest tail error of {evidence.ensemble.members} members: {error:.5g}")
    return lines


def _worst_found(evidence: DesignEvidence, worst: Falsification) -> str:
    """The worst case of the loop that the guarantee is of; that of another one says nothing of it.

    A run in which the input meets its limits, or that begins elsewhere, may be beyond the bound.
    """
    results = evidence.certificates
    best = results.best
    if best is not results.implemented and best is not results.sampled:
        return f"worst admissible case found, of the continuous law: {worst.worst_error:.5g}"
    of = "of the loop as the drive runs it"
    if worst.drive is None:
        why = worst.left_out.get("drive", "it was not searched")
        return f"no worst admissible case was found {of}: {why}"
    line = f"worst admissible case found, {of}: {worst.drive.worst_error:.5g}"
    if worst.drive.limited and worst.drive.worst_error > best.bound:
        line += " (the bound is not for it: its input meets the limits, or it begins elsewhere)"
    return line


def _guaranteed(evidence: DesignEvidence) -> str:
    results = evidence.certificates
    best = results.best
    if results.contradicted:
        return "nothing is verified for this file: its own truth contradicts a premise"
    if not best.exists:
        return "nothing is guaranteed: no certificate exists"
    bound = printed_bound(best.bound, BOUND_TEXT_DIGITS)
    loop = ""
    if best is results.implemented:
        loop = f", of the loop as the drive runs it{for_starts(results.implemented)}"
    elif best is results.sampled:
        loop = ", of the loop as the drive runs it, from the file's start"
    elif evidence.system.implementation is not None:
        loop = ", of the continuous law; nothing is verified of the loop as the drive runs it"
    if best is not results.implemented:
        loop += certified_starts(results)
    checked = "verified exactly" if best.verified else "NOT verified"
    return f"limsup |e_1| <= {bound}, {checked} ({best.kind}{loop})"


def premises_section(evidence: DesignEvidence) -> Section:
    """Every premise with its status."""
    rows = premise_rows(evidence.certificates.premises)
    return Section(
        key="premises",
        title="Premises",
        lines=(
            "A certificate says: the premises imply the bound. Each is proven, checked on samples, "
            "assumed, or contradicted by the truth that the file states.",
        ),
        tables=(table("", ["status", "premise", "what is taken for true"], rows),),
    )


def guarantee_section(evidence: DesignEvidence) -> Section:
    """All certificates, the budget of the error, and how to check the best."""
    results = evidence.certificates
    tables = [certificates_table(results)]
    if results.constants:
        tables.append(costs_table(results))
    if (shares := _shares(evidence)) is not None:
        tables.append(shares)
    certificate = _certificate(evidence)
    return Section(
        key="guarantee",
        title="Guarantee",
        lines=(*certificates_notes(results), *strength_line(results), *_how_to_check(evidence)),
        tables=tuple(tables),
        pictures=tuple(_pictures(evidence)),
        attachments=() if certificate is None else (certificate,),
    )


def _shares(evidence: DesignEvidence) -> Table | None:
    """What each cause adds to the bound, the largest first."""
    best, estimate = evidence.certificates.best, evidence.estimate
    title = "where the bound comes from: what to improve next"
    if best is evidence.certificates.implemented:
        shares = evidence.certificates.implemented.parts
    elif estimate is not None and estimate.method == best.kind:
        shares, title = estimate.shares, f"{title} (as far as floats tell)"
    else:
        shares = {}
    total = sum(shares.values())
    rows = [
        [cause, rounded_up(part, 3), f"{100 * part / total:.0f} %"]
        for cause, part in sorted(shares.items(), key=lambda entry: -entry[1])
        if part >= LEAST_LISTED * total
    ]
    return table(title, ["cause", "adds", "of it"], rows, digits=3) if rows else None


def _certificate(evidence: DesignEvidence) -> Attachment | None:
    stages = evidence.certificates.stages
    if not stages:
        return None
    text = certificate_text(evidence.system, stages)
    digest = hashlib.sha256(text.encode()).hexdigest()
    content = text if len(text) <= LONGEST_ATTACHMENT else ""
    return Attachment("certificate.json", "application/json", content, digest)


def _how_to_check(evidence: DesignEvidence) -> list[str]:
    if not evidence.certificates.stages:
        return []
    command = evidence.command("certify", " --out certificate.json")
    return [
        f"To check it without a solver: {command}, then certrack verify certificate.json. The "
        "format is described, so that anyone can write another checker."
    ]


def _pictures(evidence: DesignEvidence) -> list[Picture]:
    results, system = evidence.certificates, evidence.system
    pictures = []
    if results.tube is not None:
        drawing = tube_figure(evidence.run, results.tube, "", results.best)
        pictures.append(Picture("tube", "Tracking error in the certified tube", as_svg(drawing)))
    polytope = results.implemented.polytope
    regions = () if polytope is None else zip(polytope.states, polytope.region, strict=True)
    wide = [state for state, (low, high) in regions if high > low]
    if len(wide) > 1:  # a start that only one state varies is no area
        axes = wide[0], wide[1]
        drawing = starts_figure(results.implemented, axes, "", system.plant.units)
        caption = "Starts from which the input is proven to stay within its limits"
        pictures.append(Picture("starts", caption, as_svg(drawing)))
    return pictures

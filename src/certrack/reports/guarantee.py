"""Sections of a dossier about what is guaranteed, and what the guarantee rests on."""

from __future__ import annotations

import hashlib
import json

from certrack.certificates.document import to_document
from certrack.core.rounding import printed_bound, rounded_up
from certrack.plotting.shared import as_svg
from certrack.plotting.starts import starts_figure
from certrack.plotting.tubes import tube_figure
from certrack.reports.certificates import certificates_notes, certificates_table
from certrack.reports.findings import Findings
from certrack.reports.premises import premise_rows
from certrack.reports.ranges import costs_table, strength_line
from certrack.reports.sections import Attachment, Picture, Section
from certrack.reports.tables import BOUND_TEXT_DIGITS, Table, table

#: A certificate that is longer, in characters, is named by its digest only.
LONGEST_ATTACHMENT = 700_000

#: A cause that adds less than this part of the bound is not listed.
LEAST_SHARE = 0.001


def summary(found: Findings) -> list[str]:
    """The guarantee, and what was found beside it, in a few sentences."""
    results = found.certificates
    lines = [_guaranteed(found)]
    broken = [premise.name for premise in results.contradicted]
    if broken:
        lines.append(f"premises contradicted by the file's own truth: {', '.join(broken)}")
    lines.append(f"tail error of the simulated run: {found.run.metrics.tail_error:.5g}")
    if found.falsification is not None:
        worst = found.falsification.worst_error
        lines.append(f"worst admissible case found, of the continuous law: {worst:.5g}")
    if found.ensemble is not None:
        error, _ = found.ensemble.statistics.worst[0]
        lines.append(f"largest tail error of {found.ensemble.members} members: {error:.5g}")
    return lines


def _guaranteed(found: Findings) -> str:
    results = found.certificates
    best = results.best
    if results.contradicted:
        return "nothing is verified for this file: its own truth contradicts a premise"
    if not best.exists:
        return "nothing is guaranteed: no certificate exists"
    bound = printed_bound(best.bound, BOUND_TEXT_DIGITS)
    loop = ", of the loop as the drive runs it" if best is results.implemented else ""
    checked = "verified exactly" if best.verified else "NOT verified"
    return f"limsup |e_1| <= {bound}, {checked} ({best.kind}{loop})"


def premises(found: Findings) -> Section:
    """Every premise with its status."""
    rows = premise_rows(found.certificates.premises)
    return Section(
        key="premises",
        title="Premises",
        lines=(
            "A certificate says: the premises imply the bound. Each is proven, checked on samples, "
            "assumed, or contradicted by the truth that the file states.",
        ),
        tables=(table("", ["status", "premise", "what is taken for true"], rows),),
    )


def guarantee(found: Findings) -> Section:
    """All certificates, the budget of the error, and how to check the best."""
    results = found.certificates
    tables = [certificates_table(results)]
    if results.constants:
        tables.append(costs_table(results))
    if (shares := _shares(found)) is not None:
        tables.append(shares)
    certificate = _certificate(found)
    return Section(
        key="guarantee",
        title="Guarantee",
        lines=(*certificates_notes(results), *strength_line(results), *_how_to_check(found)),
        tables=tuple(tables),
        pictures=tuple(_pictures(found)),
        attachments=() if certificate is None else (certificate,),
    )


def _shares(found: Findings) -> Table | None:
    """What each cause adds to the bound, the largest first."""
    best, estimate = found.certificates.best, found.estimate
    title = "where the bound comes from: what to improve next"
    if best is found.certificates.implemented:
        shares = found.certificates.implemented.parts
    elif estimate is not None and estimate.method == best.kind:
        shares, title = estimate.shares, f"{title} (as far as floats tell)"
    else:
        shares = {}
    total = sum(shares.values())
    rows = [
        [cause, rounded_up(part, 3), f"{100 * part / total:.0f} %"]
        for cause, part in sorted(shares.items(), key=lambda entry: -entry[1])
        if part >= LEAST_SHARE * total
    ]
    return table(title, ["cause", "adds", "of it"], rows, digits=3) if rows else None


def _certificate(found: Findings) -> Attachment | None:
    stages = found.certificates.stages
    if not stages:
        return None
    text = json.dumps(to_document(found.system, *stages), indent=1) + "\n"
    digest = hashlib.sha256(text.encode()).hexdigest()
    content = text if len(text) <= LONGEST_ATTACHMENT else ""
    return Attachment("certificate.json", "application/json", content, digest)


def _how_to_check(found: Findings) -> list[str]:
    if not found.certificates.stages:
        return []
    return [
        f"To check it without a solver: certrack certify {found.file} --out certificate.json, then "
        "certrack verify certificate.json. The format is described well enough that anyone can "
        "write another checker."
    ]


def _pictures(found: Findings) -> list[Picture]:
    results, system = found.certificates, found.system
    pictures = []
    if results.tube is not None:
        drawing = tube_figure(found.run, results.tube, "", results.best)
        pictures.append(Picture("tube", "Tracking error in the certified tube", as_svg(drawing)))
    if results.implemented.polytope is not None and system.plant.n > 1:
        drawing = starts_figure(results.implemented, None, "", system.plant.units)
        caption = "Starts from which the input is proven to stay within its limits"
        pictures.append(Picture("starts", caption, as_svg(drawing)))
    return pictures

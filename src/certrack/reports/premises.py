"""What is said of the premises of certificates."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from certrack.certificates import Premise

#: Width of the column of statuses: that of the longest.
STATUS_WIDTH = len("contradicted")


def premise_rows(premises: Iterable[Premise]) -> list[tuple[str, str, str]]:
    """Status, name and detail of every premise; terms that are zero share a row."""
    zero, rows = [], []
    for premise in premises:
        if premise.status == "proven" and premise.detail == f"tau |{premise.name}| = 0":
            zero.append(premise.name)
            continue
        remedy = f"; {premise.remedy}" if premise.remedy else ""
        rows.append((premise.status, premise.name, premise.detail + remedy))
    return [*rows, ("proven", ", ".join(zero), "zero")] if zero else rows


def premise_lines(premises: Iterable[Premise]) -> list[str]:
    """The same, one line each."""
    return [
        f"  {status:<{STATUS_WIDTH}}  {name}: {detail}"
        for status, name, detail in premise_rows(premises)
    ]

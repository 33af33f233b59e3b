"""What is said of the premises of certificates."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from certrack.certificates import Premise

#: Width of the column of statuses: that of the longest.
STATUS_WIDTH = len("contradicted")


def premise_lines(premises: Iterable[Premise]) -> list[str]:
    """Every premise with its status, one line each; terms that are zero share one."""
    zero, lines = [], []
    for premise in premises:
        if premise.status == "proven" and premise.detail == f"tau |{premise.name}| = 0":
            zero.append(premise.name)
            continue
        text = f"  {premise.status:<{STATUS_WIDTH}}  {premise.name}: {premise.detail}"
        lines.append(f"{text}; {premise.remedy}" if premise.remedy else text)
    if zero:
        lines.append(f"  {'proven':<{STATUS_WIDTH}}  {', '.join(zero)}: zero")
    return lines

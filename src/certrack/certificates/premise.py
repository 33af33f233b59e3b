"""One premise of a certificate, and what is known of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

PROVEN, CHECKED, ASSUMED, CONTRADICTED = "proven", "checked", "assumed", "contradicted"

#: What may be known of a premise, from the best to the worst.
STATUSES = (PROVEN, CHECKED, ASSUMED, CONTRADICTED)


@dataclass(frozen=True)
class Premise:
    """Something that a certificate takes for true: "premises imply bound" is what it proves.

    Attributes
    ----------
    name : str
        As in docs/certificate-file.md, e.g. ``"input gain"`` or ``"w_2"``.
    status : {"proven", "checked", "assumed", "contradicted"}
        Proven by exact arithmetic; looked at in samples; nobody has looked; or broken by the file's
        own truth.
    detail : str
        What is taken for true, and how it is known.
    witness : mapping or None
        Of a contradicted premise: where it fails, as numbers (``t``, ``x``, ``value``, ``limit``).
    remedy : str
        What can be done; empty where nothing has to be.
    """

    name: str
    status: str
    detail: str
    witness: Mapping[str, Any] | None = None
    remedy: str = ""

    @property
    def contradicted(self) -> bool:
        """Whether the file's own truth breaks it."""
        return self.status == CONTRADICTED

    def __str__(self) -> str:
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.name}: {self.status}: {self.detail}{remedy}"

    def record(self) -> dict[str, Any]:
        """Ready for JSON."""
        witness = None if self.witness is None else dict(self.witness)
        return {
            "name": self.name,
            "status": self.status,
            "detail": self.detail,
            "witness": witness,
            "remedy": self.remedy,
        }


def contradicted(premises: Iterable[Premise]) -> tuple[Premise, ...]:
    """Those that the file's own truth breaks."""
    return tuple(premise for premise in premises if premise.contradicted)

"""One stage of a bootstrap: what it stands on, and what it proves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.polynomial_proof import PolynomialProof
from certrack.certificates.bootstrap.proof import Bounding, FunctionProof


class Claiming(Protocol):
    """What has functions that bound rows: a stage of any loop."""

    @property
    def functions(self) -> Sequence[Bounding]:
        """Its functions."""


@dataclass(frozen=True)
class BootstrapStage:
    """A box, and the functions that prove bounds of the rows on it."""

    region: Region
    functions: tuple[FunctionProof | PolynomialProof, ...]

"""One stage of a bootstrap: what it stands on, and what it proves."""

from __future__ import annotations

from dataclasses import dataclass

from certrack.certificates.bootstrap.box import Region
from certrack.certificates.bootstrap.polynomial_proof import PolynomialProof
from certrack.certificates.bootstrap.proof import FunctionProof


@dataclass(frozen=True)
class BootstrapStage:
    """A box, and the functions that prove bounds of the rows on it."""

    region: Region
    functions: tuple[FunctionProof | PolynomialProof, ...]

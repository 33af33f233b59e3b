"""The box of states that is proven of the loop as the drive runs it, for a monitor to watch."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from certrack.certificates.exact import float_up, from_text
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.document import implemented_proofs, is_implemented
from certrack.certificates.implemented.drive import nominal_drive
from certrack.certificates.implemented.from_starts import peaks_of
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.verification import verify
from certrack.core.errors import InputError
from certrack.systems.system import System
from certrack.systems.writer import to_text


def proven_box(
    system: System, certificate: str | os.PathLike[str] | None = None
) -> dict[str, tuple[float, float]]:
    """Bounds of the measured states, proven for all t >= 0 from x0, else in the long run.

    They count what a sensor may be off by. A state that is computed from differences has none: the
    proof is of the state, and not of its difference.

    Parameters
    ----------
    system : System
        With an implementation.
    certificate : path, optional
        A saved certificate of this system, which is verified first; the system is certified anew
        if it is left out.

    Returns
    -------
    dict
        Name of a state and (low, high).

    Raises
    ------
    InputError
        If nothing is proven of the states, or the file is of another system.

    Examples
    --------
    >>> import certrack
    >>> from certrack.export.proven_box import proven_box
    >>> drive = certrack.Implementation(period=0.01, delay=0.5)
    >>> box = proven_box(certrack.load("dual-motor-lean").replace(implementation=drive))
    >>> bool(box["x1"][1] > 1)
    True
    """
    if certificate is None:
        anew, proofs = certify_implemented(system, from_start=True)
        if not proofs:
            raise InputError("--certify", f"nothing is proven of the states: {anew.reason}")
    else:
        proofs = _saved(system, certificate)
    peaks = peaks_of(system, proofs)
    sizes = _in_the_long_run(proofs) if peaks is None else peaks.states
    drive = system.implementation
    assert drive is not None
    return {
        name: (-size, size)
        for name, state, mu in zip(
            system.plant.states, sizes, nominal_drive(system).mu, strict=False
        )
        if name not in drive.velocity
        for size in [float_up(mu + from_text(repr(state)))]
    }


def _saved(system: System, path: str | os.PathLike[str]) -> tuple[ImplementedProof, ...]:
    """The proofs of a file that holds, of this system."""
    verdict = verify(path)
    if not verdict.verified:
        raise InputError(str(path), f"is not verified: {verdict.reason}")
    body = json.loads(Path(path).read_text(encoding="utf-8"))  # of which `verify` was the judge
    if not is_implemented(body):
        raise InputError(
            str(path),
            "says nothing of the states: it is not of the loop as [implementation] runs it",
            remedy="certrack certify a file with [implementation] writes one",
        )
    if body["system"] != to_text(system):
        raise InputError(
            str(path),
            "is the certificate of another system",
            remedy="Certify the file that is exported, with --out",
        )
    return implemented_proofs(body["proof"])


def _in_the_long_run(proofs: Sequence[ImplementedProof]) -> list[Any]:
    columns = zip(*(proof.states for proof in proofs), strict=False)
    return [float_up(max(map(from_text, column))) for column in columns]

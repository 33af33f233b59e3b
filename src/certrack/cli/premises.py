"""What the command line says of the premises of certificates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from certrack.certificates import Premise
    from certrack.systems.system import System


def say_contradicted(broken: Sequence[Premise]) -> None:
    """Every contradicted premise on standard error: nothing is verified for this file."""
    for premise in broken:
        click.echo(f"certrack: not verified for this file: {_one(premise)}", err=True)


def note_contradictions(system: System, file: str, *, replaced: bool = False) -> None:
    """Say, once, that no certificate covers all runs of a file whose truth breaks a premise.

    Where it breaks it far away only, `certify` may have one from x0.

    With `replaced`, omega does not matter: the runs have other disturbances.
    """
    from certrack.certificates.premise import contradicted
    from certrack.certificates.premises_of_truth import DOMAIN, premises

    if system.law.no_certificate:
        return
    broken = contradicted(premises(system))
    if replaced:
        broken = tuple(p for p in broken if not p.name.startswith("w_"))
    if broken:
        far = broken[0].name.startswith("w_") or broken[0].name == DOMAIN
        what = "every start" if far else "this"
        more = f" (and {len(broken) - 1} more, see: certrack check)" if len(broken) > 1 else ""
        click.echo(
            f"certrack: note: {file}: no certificate covers {what}: {_one(broken[0])}{more}",
            err=True,
        )


def _one(premise: Premise) -> str:
    remedy = f"; {premise.remedy}" if premise.remedy else ""
    return f"premise contradicted: {premise.name}: {premise.detail}{remedy}"

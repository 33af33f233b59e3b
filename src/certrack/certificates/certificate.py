"""What every certificate method returns."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from certrack.core.errors import CertrackError


class NoCertificate(CertrackError):
    """No certificate of this kind exists or was found; the text says why and what may help."""


@dataclass(frozen=True)
class Certificate:
    """limsup |e_1(t)| <= bound for all initial states and everything the assumptions admit.

    Attributes
    ----------
    kind : str
        ``published``, ``corrected``, ``rate``, ``semidefinite`` or ``cascade``.
    bound : float
        Rounded up; ``inf`` if there is no certificate. Unit of the output.
    alpha, delta : float
        V' <= -alpha V + delta, to a few roundings (1/s; NaN where the method does not give them).
    verified : bool
        Whether exact arithmetic has confirmed it.
    reason : str
        Why there is none, and the remedy.
    assumptions : texts
        What it rests on.
    """

    kind: str
    bound: float
    alpha: float = math.nan
    delta: float = math.nan
    verified: bool = False
    reason: str = ""
    assumptions: tuple[str, ...] = field(default=())

    @property
    def exists(self) -> bool:
        """Whether there is a bound at all."""
        return math.isfinite(self.bound)


def missing(kind: str, reason: str) -> Certificate:
    """The certificate that says there is none."""
    return Certificate(kind, math.inf, reason=reason)

"""What every certificate method returns."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from certrack.core.errors import CertrackError, shorten
from certrack.core.rounding import rounded_up


class NoCertificate(CertrackError):
    """No certificate of this kind exists or was found; the text says why and what may help."""


#: Letters of the reason in a certificate's one line.
MAX_REASON_LETTERS = 300


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
        V' <= -alpha V + delta; alpha is rounded down and delta up (1/s; NaN where the method does
        not give them).
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

    def __repr__(self) -> str:
        if not self.exists:
            return f"Certificate({self.kind}: none, {shorten(self.reason, MAX_REASON_LETTERS)})"
        verified = "verified" if self.verified else "not verified"
        return f"Certificate({self.kind}: limsup |e_1| <= {rounded_up(self.bound, 4)}, {verified})"

    @property
    def exists(self) -> bool:
        """Whether there is a bound at all."""
        return math.isfinite(self.bound)


def missing(kind: str, reason: str) -> Certificate:
    """The certificate that says there is none."""
    return Certificate(kind, math.inf, reason=reason)


@contextmanager
def within_floats() -> Iterator[None]:
    """Compute what may leave the range of floats: then there is no certificate, not a crash.

    Raises
    ------
    NoCertificate
        Instead of the errors of arithmetic; results that became inf or NaN are the caller's to see.
    """
    try:
        with np.errstate(all="ignore"):
            yield
    except (ArithmeticError, np.linalg.LinAlgError):
        raise NoCertificate(OUT_OF_RANGE) from None


#: Why there is none where a number overflowed or vanished.
OUT_OF_RANGE = (
    "numbers of this design leave the range of floating point; "
    "choose units in which they are nearer to 1"
)

"""How fast the loop moves on a box, and what sampling adds at that pace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import flint

from certrack.certificates.bootstrap.loop import AdaptiveLoop
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.sampled_adaptive.held import HeldLaw


@dataclass(frozen=True)
class Paces:
    """Bounds on a box: of what moves, remaining + through |m|, and of what the sensors' errors do.

    Attributes
    ----------
    law, law_through : balls
        Of |u_law'|.
    drives, drives_through : lists of balls
        Of |(phi_i e_n)'|, then |(ubar e_n)'|.
    noise, drive_noise : ball and list of balls
        How much u, phi_i e_n and ubar e_n differ by the sensors' errors.
    steps : list of balls
        Of |theta_hat_i'|, then |delta_hat'|.
    input : ball
        Contains every u_k.
    estimates : list of balls
        Contain delta_hat, theta_hat.
    """

    law: Any
    law_through: Any
    drives: list[Any]
    drives_through: list[Any]
    noise: Any
    drive_noise: list[Any]
    steps: list[Any]
    input: Any
    estimates: list[Any]


def least_law(held: HeldLaw, paces: Paces) -> Any:
    """The fixed point of :func:`image`: a bound of |m| in the long run.

    Raises
    ------
    NoCertificate
        If there is none.
    """
    remaining = 1 - flint.arb(held.reach) * paces.law_through
    if not bool(remaining > 0):
        raise NoCertificate("the period is too long: the input moves faster than it is sampled")
    fixed = flint.arb(held.reach) * paces.law + paces.noise + flint.arb(held.eta)
    return (fixed / remaining).abs_upper()


def image(loop: AdaptiveLoop, held: HeldLaw, paces: Paces, law: Any) -> tuple[Any, list[Any]]:
    """Bounds of m, and of what the steps add to the rates of the estimates, where |m| <= law."""
    T, m = flint.arb(held.T), flint.arb(law)
    of_law = flint.arb(held.reach) * (paces.law + paces.law_through * m)
    of_law += paces.noise + flint.arb(held.eta)
    drives = [
        T * (remaining + through * m) + noise
        for remaining, through, noise in zip(
            paces.drives, paces.drives_through, paces.drive_noise, strict=True
        )
    ]
    if not held.exact_leak:  # Euler's leak is that of the sample
        leaks = [*(loop.leak_theta for _ in range(loop.r)), loop.leak_gain]
        drives = [
            drive + T * flint.arb(leak) * step
            for drive, leak, step in zip(drives, leaks, paces.steps, strict=True)
        ]
    thetas = [
        sum((flint.arb(abs(v)) * d for v, d in zip(row, drives[:-1], strict=True)), flint.arb(0))
        for row in loop.Gamma
    ]
    return of_law, [*thetas, flint.arb(loop.gain_rate) * drives[-1]]

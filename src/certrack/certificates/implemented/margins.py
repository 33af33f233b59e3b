"""How much slower and how much faster a drive may sample, with a proof at both ends.

The slowest period is where delay, hold and filters begin to cost the bound; the fastest one is
where differences of quantised positions do, or where the input no longer stays within its limits.
Both are found in floats and then proven; that all periods between them hold is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_up, from_text
from certrack.certificates.implemented.cover import prove_few_cells
from certrack.certificates.implemented.proof import ImplementedProof, prove_implemented
from certrack.certificates.implemented.ranged import RangedPlant
from certrack.certificates.ranges.cells import Cell, coarsest
from certrack.certificates.ranges.proofs import numbers
from certrack.core.errors import InputError
from certrack.core.rounding import in_digits
from certrack.systems.system import System

#: The bound may grow to so much of the file's own.
ADMITTED = 2.0

#: The period is changed by this factor until it no longer serves, so often at most, slower and
#: faster (which takes longer); and the last interval is halved so often.
STEP, SLOWER, FASTER, HALVINGS = 2.0, 6, 3, 5

#: Digits of a period that is proven.
PERIOD_DIGITS = 4


@dataclass(frozen=True)
class PeriodMargins:
    """Periods with a proven bound in the long run, at most `bound`; the rest is as in the file.

    Attributes
    ----------
    slowest, fastest : float, s
    slower_untried, faster_untried : bool
        Whether nothing failed up to there: the search ended, and not the bound.
    bound : float
        Twice the file's own.
    """

    slowest: float
    fastest: float
    slower_untried: bool
    faster_untried: bool
    bound: float


def period_margins(
    system: System,
    proofs: Sequence[ImplementedProof],
    within_limits: Callable[[System, Sequence[ImplementedProof]], str],
    tried: Mapping[str, Mapping[Cell, float]] | None = None,
) -> PeriodMargins:
    """Search the periods of a system that are proven as its own is.

    Parameters
    ----------
    system : System
    proofs : of its own period
    within_limits : callable
        Why the input may stay at its limits; empty if it does not.
    tried : mapping, optional
        By delay, the bounds at its own period of every cell of the ranges that was looked at: a
        cell that has no bound there is not tried at other periods.
    """
    drive = system.implementation
    assert drive is not None
    admitted = ADMITTED * max(float_up(from_text(proof.bound)) for proof in proofs)
    worst = max(proofs, key=lambda proof: from_text(proof.bound))

    def serves(period: float, chosen: Sequence[ImplementedProof]) -> bool:
        try:
            other = system.replace(implementation=replace(drive, period=period))
            plant = RangedPlant(other) if chosen[0].cell else None
            if plant is not None and chosen is proofs:
                again = _in_few_cells(other, plant, tried or {}, proofs, admitted)
            else:
                again = [_again(other, proof, plant) for proof in chosen]
        except (NoCertificate, InputError):
            return False
        bound = max(float_up(from_text(proof.bound)) for proof in again)
        return bound <= admitted and not within_limits(other, again)

    def end(factor: float, times: int) -> tuple[float, bool]:
        """The last period that serves, and whether all that were tried did."""
        good, bad = drive.period, 0.0
        for _ in range(times):
            tried = in_digits(good * factor, PERIOD_DIGITS)
            if not serves(tried, [worst]):
                bad = tried
                break
            good = tried
        for _ in range(HALVINGS if bad else 0):
            tried = in_digits((good * bad) ** 0.5, PERIOD_DIGITS)
            good, bad = (tried, bad) if serves(tried, [worst]) else (good, tried)
        while good != drive.period and len(proofs) > 1 and not serves(good, proofs):
            bad, good = good, in_digits((good * drive.period) ** 0.5, PERIOD_DIGITS)
            if abs(good / drive.period - 1) < 1 / 2**HALVINGS:
                good = drive.period
        return good, not bad

    slowest, fastest = end(STEP, SLOWER), end(1 / STEP, FASTER)
    return PeriodMargins(slowest[0], fastest[0], slowest[1], fastest[1], admitted)


def _in_few_cells(
    system: System,
    plant: RangedPlant,
    tried: Mapping[str, Mapping[Cell, float]],
    proofs: Sequence[ImplementedProof],
    admitted: float,
) -> list[ImplementedProof]:
    """Proofs for the same delays, of cells that fill the ranges: for this bound a few will do."""
    again = []
    for text in dict.fromkeys(proof.delay for proof in proofs):
        begin = coarsest(plant.box, tried[text], admitted) if text in tried else ()
        delay: Any = rational(Fraction(text))
        again += [p for p, _ in prove_few_cells(system, plant, delay, admitted, begin)]
    return again


def _again(system: System, proof: ImplementedProof, plant: RangedPlant | None) -> ImplementedProof:
    """The proof for the same delay and cell at another period."""
    delay: Any = rational(Fraction(proof.delay))
    return prove_implemented(system, delay, numbers(proof.cell), plant)[0]

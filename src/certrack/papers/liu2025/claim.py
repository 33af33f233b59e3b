"""What a claim of the paper is, and its verdict."""

from __future__ import annotations

from dataclasses import dataclass

#: The verdicts. A claim is ambiguous where our copy or the paper leaves open what it says, and not
#: testable where no run and no proof could decide it.
HOLDS, DIFFERS, AMBIGUOUS, NOT_TESTABLE = VERDICTS = (
    "holds",
    "differs",
    "ambiguous",
    "not testable",
)


@dataclass(frozen=True)
class Claim:
    """A statement of the paper and what we measure.

    Attributes
    ----------
    where : str
        Its place in the paper.
    statement : str
        In our words.
    measure : str
        What is measured, and why this.
    measured : str
        The values.
    verdict : {"holds", "differs", "ambiguous", "not testable"}
    criterion : str
        Where the paper states none: when we say that it holds.
    """

    where: str
    statement: str
    measure: str
    measured: str
    verdict: str
    criterion: str = ""


@dataclass(frozen=True)
class Observation:
    """Something that the paper does not claim and its reader should know.

    Attributes
    ----------
    where, text : str
    """

    where: str
    text: str


def judged(holds: bool) -> str:
    """The verdict of a claim that a measurement decides."""
    return HOLDS if holds else DIFFERS

"""What is saved of a proof for the implemented loop, and its check.

The numbers say how the proof is carried out and where v is; the checker computes the loop, its
gains and F(v) anew, in balls, from the text of the system.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.balls import upper_rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import from_text, root_up
from certrack.certificates.implemented.drive import DRIVE_BITS, Drive
from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.gains import output_gains
from certrack.certificates.implemented.input_limits import is_limited
from certrack.certificates.implemented.levels import partly_cancelled
from certrack.certificates.implemented.outputs import output_rows
from certrack.certificates.implemented.period import Period, one_period
from certrack.certificates.implemented.powers import PastRows
from certrack.certificates.implemented.ranged import RangedPlant, drive_in, refuse_in_cells
from certrack.certificates.implemented.regional import in_the_long_run, is_regional, not_reached
from certrack.certificates.implemented.slow import (
    SlowTerms,
    StepFunction,
    needs_rates,
    slow_columns,
)
from certrack.certificates.implemented.start import FromStarts
from certrack.certificates.implemented.start_proof import StartProof, StartProver
from certrack.certificates.implemented.start_set import POLYTOPE, X0
from certrack.certificates.implemented.step_search import RATES_PART, by_rates
from certrack.certificates.implemented.timing import TimedBounds, rate_rows
from certrack.certificates.ranges.cells import Cell
from certrack.certificates.ranges.proofs import numbers, texts
from certrack.systems.system import System

#: A cell is at most this part of the time that the plant's fastest motion takes for one radian.
CELL_PART = 0.2

#: Cells before and after the input changes, at most; doublings of the periods that are summed.
MAX_CELLS_OF_INPUT, MAX_DOUBLINGS = 32, 18

#: What may be left of the rows where the sums end.
LEFT = 1e-9

#: Numbers in the tables of one proof, at most: a few seconds and some 100 MB.
MAX_NUMBERS = 20_000_000

#: Digits of the states' and the input's bounds in a file, and the factor on the bound, so that a
#: checker with another quadrature confirms it.
DIGITS, TEXT_MARGIN = 13, flint.fmpq(1_000_001, 1_000_000)


@dataclass(frozen=True)
class ImplementedProof:
    """The numbers of a proof for one delay; texts are decimals or fractions.

    Attributes
    ----------
    delay : str
        Periods.
    parts : two ints
        Cells before and after the delayed input takes over.
    doublings : int
        2^doublings periods are summed one by one.
    states : n texts
        Bounds of limsup |x_i|.
    input : str
        Bound of limsup |u|, without the constant of the law.
    step : str
        Bound of limsup |u_k - u_{k-1}|.
    bound : str
        Of limsup |e_1|.
    starts : tuple of StartProof
        What is proven of runs from x0, and from the polytope of starts, if anything.
    rates : n texts
        With jitter: bounds of limsup |x_i'|.
    cell : pairs of texts
        Ends of each range, for constants in this cell; empty where nothing has a range. The
        channels' bounds stand behind the states' then.
    slow : one z for each uncertain term with a rate
        Where rates make the bound smaller: see :mod:`certrack.certificates.implemented.slow`.
    split : two lists of n + 1 texts
        Where that needs them, bounds of the states and the input without and by the sensors'
        errors: see :mod:`certrack.certificates.implemented.superposition`.
    """

    delay: str
    parts: tuple[int, int]
    doublings: int
    states: tuple[str, ...]
    input: str
    step: str
    bound: str
    starts: tuple[StartProof, ...] = ()
    rates: tuple[str, ...] = ()
    cell: tuple[tuple[str, str], ...] = ()
    slow: tuple[StepFunction, ...] = ()
    split: tuple[tuple[str, ...], ...] = ()


def delays(system: System) -> tuple[Any, ...]:
    """The delays that must be proven, periods."""
    if system.implementation is None:
        return ()
    return tuple(rational(value) for value in system.implementation.delays)


def prove_implemented(
    system: System, delay: Any, cell: Cell = (), plant: RangedPlant | None = None
) -> tuple[ImplementedProof, dict[str, float]]:
    """Prove a bound for one delay; also what it is made of, in floats.

    Parameters
    ----------
    system : System
    delay : rational, periods
    cell : Cell
        What constants with a range may be.
    plant : RangedPlant, optional
        That of the system, if it is at hand.

    Raises
    ------
    NoCertificate
        If there is none, or the loop is not covered.
    """
    refuse_in_cells(system, cell)
    drive = drive_in(system, delay, cell, plant)
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive, cells_of(drive))
        doublings = periods_needed(period)
        bounds = _bounds(period, doublings, refuse_early=True)
        if drive.jitter:
            return _prove_with_jitter(system, period, doublings, bounds)
        starts = _starts_of_region(system, delay, cells_of(drive))
        X, U = in_the_long_run(bounds, starts) if starts else bounds.search()
        states = tuple(f"{v:.{DIGITS}g}" for v in X)
        proof = ImplementedProof(
            str(delay),
            cells_of(drive),
            doublings,
            states,
            f"{U:.{DIGITS}g}",
            "0",
            "0",
            starts,
            cell=texts(cell),
        )
        image = _image(bounds, proof)
        if reason := _not_above(bounds, image, proof):
            raise NoCertificate(reason)
        parts = bounds.parts(X, U)
        if not cell:
            rated = by_rates(period, bounds, doublings, _claimed(proof), image[0])
            proof = replace(proof, slow=rated.slow, split=rated.split)
        if proof.slow:
            parts |= {RATES_PART: float(rated.bound) - float(image[0])}
            image[0] = rated.bound
        bound, step = (_text_above(value) for value in (image[0], image[-1]))
    return replace(proof, bound=bound, step=step), parts


def _prove_with_jitter(
    system: System, period: Period, doublings: int, bounds: OutputBounds
) -> tuple[ImplementedProof, dict[str, float]]:
    """A proof for a loop whose samples and inputs are off their times."""
    drive, n = period.drive, period.drive.n
    if is_regional(system) or is_limited(system):
        what = "a bound that grows faster than the state" if is_regional(system) else "limits"
        raise NoCertificate(
            f"implementation.jitter is not covered together with {what}: leave one of them out"
        )
    timed = TimedBounds.of(period, bounds.rows, bounds, doublings)
    v = timed.search()
    entries = [f"{value:.{DIGITS}g}" for value in v]
    proof = ImplementedProof(
        str(drive.delay),
        cells_of(drive),
        doublings,
        tuple(entries[:n]),
        entries[n],
        entries[n + 1],
        "0",
        (),
        tuple(entries[n + 2 :]),
    )
    image = _timed_image(timed, proof)
    if reason := _not_above_timed(image, proof):
        raise NoCertificate(reason)
    parts = bounds.parts(v[:n], v[n])
    bound = _text_above(image[0])
    parts |= {"jitter": max(0.0, float(image[0]) - sum(parts.values()))}
    return replace(proof, bound=bound), parts


def _timed_image(timed: TimedBounds, proof: ImplementedProof) -> list[Any]:
    rates = [from_text(v) for v in proof.rates]
    return timed.image(*_claimed(proof), from_text(proof.step), rates)


def _not_above_timed(image: Sequence[Any], proof: ImplementedProof) -> str:
    """Empty if v = (X, U, DU, R) is above F(v) in every entry."""
    claimed = (*proof.states, proof.input, proof.step, *proof.rates)
    for text, value in zip(claimed, image[1:], strict=True):
        if not flint.arb(from_text(text)) > value:
            return "a bound of the loop with jitter is not above what follows from all of them"
    return ""


def _starts_of_region(system: System, delay: Any, parts: tuple[int, int]) -> tuple[StartProof, ...]:
    """Proofs from x0 and from the largest box, where none can be from every start.

    Raises
    ------
    NoCertificate
        If there is none from x0.
    """
    if not is_regional(system):
        return ()
    prover, starts = start_prover(system, delay, parts), []
    for of in (X0, POLYTOPE):
        try:
            starts.append(prover.prove(of))
        except NoCertificate as refusal:
            if of == X0:
                raise NoCertificate(
                    "the uncertain terms grow faster than the state, and from simulation.x0 no "
                    f"region is proven that the states keep ({refusal}); begin nearer to the "
                    "reference, lower plant.uncertainty.bound, or raise c"
                ) from None
    return tuple(starts)


def start_prover(
    system: System,
    delay: Any,
    parts: tuple[int, int],
    cell: Cell = (),
    plant: RangedPlant | None = None,
    begin: Mapping[str, int] | None = None,
) -> StartProver:
    """What proves bounds from a start for one delay; call it with :data:`DRIVE_BITS`.

    Raises
    ------
    NoCertificate
        If the loop is not covered.
    """
    drive = drive_in(system, delay, cell, plant)
    period = one_period(drive, parts)
    return StartProver(system, drive, lambda doublings: FromStarts(period, doublings), begin)


def failed_implemented(
    system: System, proof: ImplementedProof, delay: Any, plant: RangedPlant | None = None
) -> str:
    """Empty if the proof holds for the system with this delay, else what fails."""
    if rational(Fraction(proof.delay)) != delay:
        return "the delay is not that of the system"
    if not (
        0 <= proof.doublings <= MAX_DOUBLINGS
        and all(1 <= v <= MAX_CELLS_OF_INPUT for v in proof.parts)
    ):
        return f"parts must be 1 ... {MAX_CELLS_OF_INPUT}, doublings 0 ... {MAX_DOUBLINGS}"
    try:
        refuse_in_cells(system, proof.cell)
        drive = drive_in(system, delay, numbers(proof.cell), plant)
        if len(proof.states) != drive.sized:
            return "the proof does not have the shape of the system"
        if any(from_text(text) < 0 for text in (*proof.states, proof.input)):
            return "a bound of a state or of the input is negative"
        if len(proof.rates) != (drive.n if drive.jitter else 0):
            return "the proof does not have the rates that jitter needs, or has some without it"
        with flint.ctx.workprec(DRIVE_BITS):
            period = one_period(drive, proof.parts)
            bounds = _bounds(period, proof.doublings)
            if drive.jitter and not (proof.slow or proof.split):
                return _failed_with_jitter(period, bounds, proof)
            if is_regional(system) and not proof.starts:
                return "the bound is not for every start, and nothing is said of one"
            image = _image(bounds, proof)
            if proof.slow or proof.split:
                if proof.cell or not slow_columns(drive):
                    return "the proof uses rates where there are none"
                claimed = _claimed(proof)
                terms = SlowTerms.of(period, bounds, proof.doublings, *claimed, proof.split)
                image[0] = terms.bound(proof.slow)
            return _not_proven(bounds, image, proof)
    except NoCertificate as refusal:
        return str(refusal)


def _failed_with_jitter(period: Period, bounds: OutputBounds, proof: ImplementedProof) -> str:
    if any(from_text(text) < 0 for text in (*proof.rates, proof.step)):
        return "a bound of the loop with jitter is negative"
    image = _timed_image(TimedBounds.of(period, bounds.rows, bounds, proof.doublings), proof)
    if reason := _not_above_timed(image, proof):
        return reason
    if not flint.arb(from_text(proof.bound)) >= image[0]:
        return "the bound is smaller than what the fixed point gives"
    return ""


def cells_of(drive: Drive) -> tuple[int, int]:
    """So many cells that none is long against the plant's motions."""
    A = Enclosed.of(drive.A).value
    fastest = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    fraction = float(drive.delay) - math.floor(float(drive.delay))
    T = float(drive.T)
    counts = (T * part * fastest / CELL_PART for part in (fraction, 1 - fraction))
    return tuple(min(max(1, math.ceil(count)), MAX_CELLS_OF_INPUT) for count in counts)  # type: ignore[return-value]


def periods_needed(period: Period, left: float = LEFT) -> int:
    """The doublings after which no more than `left` is left of a row.

    Raises
    ------
    NoCertificate
        If the loop is unstable, or too slow.
    """
    M = Enclosed.of(period.map).value
    radius = float(np.abs(np.linalg.eigvals(M)).max()) if np.isfinite(M).all() else math.inf
    if not radius < 1:
        raise NoCertificate(
            f"the sampled loop is unstable: the spectral radius of one period is {radius:.4g}; "
            "shorten implementation.period or delay, or lower c"
        )
    periods = math.log(left) / math.log(radius) if radius > 0 else 1.0
    doublings = max(1, math.ceil(math.log2(max(periods, 1.0))))
    if doublings > MAX_DOUBLINGS:
        raise NoCertificate(
            f"the sampled loop forgets too slowly: {periods:.3g} periods would have to be summed; "
            "raise c, or sample less often"
        )
    return doublings


def _bounds(period: Period, doublings: int, *, refuse_early: bool = False) -> OutputBounds:
    """The right-hand sides.

    Whether there is a fixed point does not depend on what the reference adds: with `refuse_early`
    the levels of it are not looked at where there is none.
    """
    moving = period.drive.jitter or needs_rates(period.drive)
    rows = output_rows(period) + (rate_rows(period) if moving else [])
    size, width = period.size, (len(period.cells) + 1) * (period.W.ncols() + 1) + period.size
    block = 2 ** (doublings // 2 + 1)
    if (len(rows) + size) * block * max(width, size) > MAX_NUMBERS:
        raise NoCertificate(
            "the sampled loop is too large for its peak gains: fewer states or memories"
        )
    past = PastRows.of_outputs(period, rows, doublings)
    gains = output_gains(period, rows, doublings, past)
    if refuse_early and not period.drive.jitter:
        plain = OutputBounds.of(period, rows, gains)
        if not plain.is_regional:
            plain.search()
    return OutputBounds.of(period, rows, gains, partly_cancelled(period, rows, doublings, past))


def _image(bounds: OutputBounds, proof: ImplementedProof) -> list[Any]:
    return bounds.image(*_claimed(proof))


def _claimed(proof: ImplementedProof) -> tuple[list[Any], Any]:
    """X and U."""
    return [from_text(v) for v in proof.states], from_text(proof.input)


def _not_proven(bounds: OutputBounds, image: Sequence[Any], proof: ImplementedProof) -> str:
    """Empty if v > F(v), and the bounds are not below what follows from it."""
    if reason := _not_above(bounds, image, proof):
        return reason
    if not flint.arb(from_text(proof.bound)) >= image[0]:
        return "the bound is smaller than what the fixed point gives"
    if not flint.arb(from_text(proof.step)) >= image[-1]:
        return "the bound of the input's steps is smaller than what the fixed point gives"
    return ""


def _not_above(bounds: OutputBounds, image: Sequence[Any], proof: ImplementedProof) -> str:
    """Empty if v > F(v) in every entry, and the bounds of all starts lead down to v."""
    states, size = [from_text(v) for v in proof.states], from_text(proof.input)
    for start in proof.starts if bounds.is_regional else ():
        if reason := not_reached(bounds, (states, size), start):
            return reason
    for name, text, value in zip(
        (*(f"state {i + 1}" for i in range(len(proof.states))), "the input"),
        (*proof.states, proof.input),
        image[1:],
        strict=False,
    ):
        if not flint.arb(from_text(text)) > value:
            return f"the bound of {name} is not above what follows from all of them"
    return ""


def _text_above(ball: Any) -> str:
    """A decimal text above a ball's numbers, which are not negative."""
    return root_up((upper_rational(ball) * TEXT_MARGIN) ** 2)

"""What is proven of runs from a start: bounds for all t >= 0, and that no limit is met.

As long as no limit of the input has been met the loop is the linear one, whose bounds hold. If they
say that the next input, too, is within the limits, none is ever met.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import flint
import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import float_down, from_text
from certrack.certificates.implemented.drive import Drive
from certrack.certificates.implemented.enclosed import ROUNDOFF
from certrack.certificates.implemented.input_limits import input_limits, region_of
from certrack.certificates.implemented.polytope import Polytope, half_spaces
from certrack.certificates.implemented.regional import is_regional, largest_region
from certrack.certificates.implemented.start import (
    FromStarts,
    Later,
    PeriodBounds,
    Starts,
    Transient,
    is_above,
    up,
)
from certrack.certificates.implemented.start_set import (
    ANY_PHASE,
    FILE_PHASE,
    POLYTOPE,
    X0,
    phase_of,
    start_set_of,
)
from certrack.systems.system import System

#: 2^doublings periods are looked at one by one: from the first to the last of these.
FEWEST_DOUBLINGS, MOST_DOUBLINGS = 5, 13

#: By this part at least peaks must fall with twice as many periods.
WORTH_PERIODS = 1e-3

#: Digits of the bounds in a file, and the factor on them, so that other checkers confirm them.
START_DIGITS, TEXT_FACTOR = 13, 1 + 1e-6


@dataclass(frozen=True)
class StartProof:
    """The numbers of a proof for a set of starts; texts are decimals.

    Attributes
    ----------
    of : str
        ``"x0"``: from simulation.x0. ``"polytope"``: from every start of the region from which the
        input is proven to be within its limits.
    phase : str
        ``"file"``: the reference begins as in the file; ``"any"``: it is any within its bounds.
    region : n pairs of texts
        Of a polytope; none for x0.
    doublings : int
        K = 2^doublings periods are bounded one by one.
    middle : int
        K1.
    states : n texts
        Bounds of |x_i|, and of the channels behind them, in all later periods: X_t.
    input : str
        The same of |u|, without the constant of the law.
    peaks : n + 3 texts
        Bounds for all t >= 0 of |e_1|, |x_i| (and the channels), |u| (without that constant),
        |u_k - u_{k-1}|.
    """

    of: str
    phase: str
    region: tuple[tuple[str, str], ...]
    doublings: int
    middle: int
    states: tuple[str, ...]
    input: str
    peaks: tuple[str, ...]


@dataclass(frozen=True)
class Evidence:
    """A run of the bounds with all that it was made of.

    Attributes
    ----------
    frame : FromStarts
    starts : Starts
    transient : Transient
    run : PeriodBounds
    after : n + 3 floats
        Bounds of all outputs in the periods from K on.
    peaks : n + 3 floats
        And in all periods.
    later : Later
    """

    frame: FromStarts
    starts: Starts
    transient: Transient
    run: PeriodBounds
    later: Later
    after: np.ndarray
    peaks: np.ndarray

    @property
    def is_spent(self) -> bool:
        """Whether no peak would be smaller with more periods, but for :data:`WORTH_PERIODS`.

        The periods that are looked at have the same bounds then.
        """
        largest = self.run.bounds.max(axis=0)
        return bool((largest * (1 + WORTH_PERIODS) >= self.peaks).all())


class StartProver:
    """Finds and checks start proofs of one loop, whose gains it keeps.

    Parameters
    ----------
    system : System
    frames : callable
        From a number of doublings to :class:`FromStarts`.
    begin : mapping, optional
        The doublings that the search of each kind begins with, as another cell of the same ranges
        needs them.
    """

    def __init__(
        self,
        system: System,
        drive: Drive,
        frames: Any,
        begin: Mapping[str, int] | None = None,
    ) -> None:
        self._begin = begin or {}
        self.system, self.drive, self._frames = system, drive, frames
        self._by_doublings: dict[int, FromStarts | NoCertificate] = {}
        self._starts = cache(partial(start_set_of, system, drive))
        self._last_run: tuple[Starts, int, Transient, PeriodBounds] | None = None

    def frame(self, doublings: int) -> FromStarts:
        """The right-hand sides for so many periods; NoCertificate is raised if there are none."""
        if doublings not in self._by_doublings:
            try:
                self._by_doublings[doublings] = self._frames(doublings)
            except NoCertificate as refusal:
                self._by_doublings[doublings] = refusal
        known = self._by_doublings[doublings]
        if isinstance(known, NoCertificate):
            raise known
        return known

    def _run(self, starts: Starts, doublings: int) -> tuple[Transient, PeriodBounds]:
        """The periods that are looked at; the last ones are kept, for they are asked for twice."""
        last = self._last_run
        if last is None or last[0] is not starts or last[1] != doublings:
            frame = self.frame(doublings)
            transient = frame.transient(starts)
            last = self._last_run = starts, doublings, transient, frame.run(starts, transient)
        return last[2:]

    def first_frame(self) -> FromStarts:
        """The shortest one that has gains.

        Raises
        ------
        NoCertificate
            If there is none.
        """
        for doublings in range(FEWEST_DOUBLINGS, MOST_DOUBLINGS):
            try:
                return self.frame(doublings)
            except NoCertificate:
                continue
        return self.frame(MOST_DOUBLINGS)

    def prove(self, of: str) -> StartProof:
        """A proof from x0, or of a polytope.

        Raises
        ------
        NoCertificate
            If none is found.
        """
        phase = phase_of(self.system, self.drive, of)
        region = self._region(phase) if of == POLYTOPE else ()
        starts = self._starts(phase, region)
        enough = self.within_later if of == POLYTOPE else lambda _: True
        begin = self._begin.get(of, FEWEST_DOUBLINGS)
        doublings, evidence = self.search(starts, enough, begin)
        return StartProof(
            of,
            phase,
            region,
            doublings,
            2 ** (doublings - 1),
            tuple(f"{v:.{START_DIGITS}g}" for v in evidence.later.states),
            f"{evidence.later.input:.{START_DIGITS}g}",
            tuple(f"{v * TEXT_FACTOR:.{START_DIGITS}g}" for v in evidence.peaks),
        )

    def _region(self, phase: str) -> tuple[tuple[str, str], ...]:
        """Where starts are looked at: where the bounds hold, if they do not everywhere."""
        if not is_regional(self.system):
            return region_of(self.system, self.drive, self.first_frame)
        best = self._doublings(phase)

        def holds(region: tuple[tuple[str, str], ...]) -> bool:
            starts = start_set_of(self.system, self.drive, phase, region)
            try:
                self.bounds(starts, best, 2 ** (best - 1), None)
            except NoCertificate:
                return False
            return True

        return largest_region(self.system, holds)

    def _doublings(self, phase: str) -> int:
        """As many periods as the start x(0) = 0 needs, and twice as many."""
        origin = (("0.0", "0.0"),) * self.drive.n
        starts = start_set_of(self.system, self.drive, phase, origin)
        return min(self.search(starts, lambda _: True)[0] + 1, MOST_DOUBLINGS)

    def search(
        self,
        starts: Starts,
        enough: Callable[[Evidence], bool],
        begin: int = FEWEST_DOUBLINGS,
    ) -> tuple[int, Evidence]:
        """The fewest doublings after which hardly anything that comes is larger than before.

        Parameters
        ----------
        starts : Starts
        enough : callable
            What else must hold of the bounds; the most doublings are taken if it never does.
        begin : int
            The fewest that are tried.

        Raises
        ------
        NoCertificate
            If nothing is bounded for all time.
        """
        best, reason = None, ""
        for doublings in range(begin, MOST_DOUBLINGS + 1):
            try:
                evidence = self.bounds(starts, doublings, 2 ** (doublings - 1), None)
            except NoCertificate as refusal:
                reason = str(refusal)
                continue
            best = doublings, evidence
            if evidence.is_spent and enough(evidence):
                break
        if best is None:
            raise NoCertificate(reason)
        return best

    def within_later(self, evidence: Evidence) -> bool:
        """Whether no limit is met in the periods from K on, from no start that is looked at."""
        U, step = (flint.fmpq(*v.as_integer_ratio()) for v in evidence.after[-2:].tolist())
        return input_limits(self.system, self.drive).hold(U, step)

    def evidence(self, proof: StartProof) -> Evidence:
        """What a proof stands on, computed anew.

        Raises
        ------
        NoCertificate
            If it does not hold.
        """
        if not self._is_well_formed(proof):
            raise NoCertificate("the proof of the start does not have the shape of the system")
        if any(from_text(text) < 0 for text in (*proof.states, proof.input)):
            raise NoCertificate("a bound of what comes later is negative")
        if proof.phase == FILE_PHASE and phase_of(self.system, self.drive, X0) != FILE_PHASE:
            raise NoCertificate("the reference at t = 0 is not known exactly")
        starts = self._starts(proof.phase, proof.region)
        # rounded down: a text stands for no more than it says
        states = tuple(float_down(from_text(text)) for text in proof.states)
        later = Later(states, float_down(from_text(proof.input)))
        evidence = self.bounds(starts, proof.doublings, proof.middle, later)
        if not all(
            float_down(from_text(text)) >= value
            for text, value in zip(proof.peaks, evidence.peaks, strict=True)
        ):
            raise NoCertificate("a bound from the start is smaller than what follows")
        return evidence

    def _is_well_formed(self, proof: StartProof) -> bool:
        n, sized = self.drive.n, self.drive.sized
        return (
            proof.of in (X0, POLYTOPE)
            and proof.phase in (FILE_PHASE, ANY_PHASE)
            and len(proof.region) == (n if proof.of == POLYTOPE else 0)
            and all(float(low) <= float(high) for low, high in proof.region)
            and 1 <= proof.doublings <= MOST_DOUBLINGS
            and 0 <= proof.middle < 2**proof.doublings
            and len(proof.states) == sized
            and len(proof.peaks) == sized + 3
        )

    def bounds(self, starts: Starts, doublings: int, middle: int, later: Later | None) -> Evidence:
        """Bounds from starts, with a bound of the later periods that is given or found.

        Raises
        ------
        NoCertificate
            If it is none, or none is found.
        """
        frame, (transient, run) = self.frame(doublings), self._run(starts, doublings)
        if later is None:
            later = frame.find_later(starts, transient, run, middle)
        image = frame.later_image(starts, transient, run, middle, later)
        if not is_above(later, image):
            raise NoCertificate(
                "the bound of what comes after the periods looked at is not above what follows "
                "from it"
            )
        n = self.drive.sized
        after = image.copy()
        after[1 : n + 2] = [*later.states, later.input]
        peaks = np.maximum(run.bounds.max(axis=0), after)
        peaks[n + 1] = max(peaks[n + 1], up(starts.initial))
        return Evidence(frame, starts, transient, run, later, after, peaks)


def limit_met(system: System, drive: Drive, proof: StartProof) -> str:
    """Empty if the peaks of a proof are within the limits of the input, else which is not."""
    limits = input_limits(system, drive)
    size, step = (from_text(text) for text in proof.peaks[drive.sized + 1 :])
    if not limits.hold(size, rational(0)):
        peak = float(size + abs(drive.offset))
        return f"|u| is certified to be within {peak:.5g} from simulation.x0 only"
    if not limits.hold(rational(0), step):
        return f"steps of u are certified to be within {float(step):.4g} from simulation.x0 only"
    return ""


def polytope_of(prover: StartProver, proof: StartProof) -> Polytope:
    """The starts in the region of a proof from which no limit is ever met.

    Raises
    ------
    NoCertificate
        If the proof does not hold, or the limits may be met after the periods that are looked at,
        from every start.
    """
    system, drive, evidence = prover.system, prover.drive, prover.evidence(proof)
    limits, run, transient = input_limits(system, drive), evidence.run, evidence.transient
    n, frame = drive.sized, evidence.frame
    if not prover.within_later(evidence):
        raise NoCertificate("the limits of the input may be met in the long run")
    region = np.array([[float(low), float(high)] for low, high in proof.region])
    rows, errors, ends = [], [], []
    for output, low, high in (
        (0, limits.low, limits.high),
        (1, -limits.step, limits.step),
    ):
        at = frame.begins[n + 1 + output]
        G, error = transient.of_x0.value[:, at], transient.of_x0.error[:, at]
        fixed, fixed_off = transient.fixed.value[:, at], transient.fixed.error[:, at]
        forced = run.forced[:, output] + transient.free[:, at] + fixed_off
        for sign, end in ((1, high), (-1, -low)):
            end = float_down(end)
            left = end - sign * fixed - forced
            left -= 8 * ROUNDOFF * (abs(end) + np.abs(fixed) + forced)
            rows.append(sign * G)
            errors.append(error)
            ends.append(left)
    table, off, room = (np.concatenate(v) for v in (rows, errors, ends))
    rows_and_limits = half_spaces(table, off, room, region)
    pairs = tuple((low, high) for low, high in region.tolist())
    return Polytope(*rows_and_limits, pairs, tuple(system.plant.states))

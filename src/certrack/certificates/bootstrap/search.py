"""The iteration: box, ranges, bounds of every row, a smaller box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.bootstrap.forms import forms_of
from certrack.certificates.bootstrap.ground import Known, first_box, ground_on
from certrack.certificates.bootstrap.loop import AdaptiveLoop, adaptive_loop, formulas_of
from certrack.certificates.bootstrap.program import BootstrapProgram, Found
from certrack.certificates.bootstrap.proof import (
    BootstrapStage,
    prove,
    row_over_box,
)
from certrack.certificates.bootstrap.ranges import Ranges
from certrack.certificates.bootstrap.rates import Rate
from certrack.certificates.exact import Proof, from_text
from certrack.certificates.problem import ErrorProblem
from certrack.systems.system import System

#: Stages at most; the iteration ends when no interval shrinks by more than this part.
MOST_STAGES, WORTH_A_STAGE = 8, 0.01

#: Programs for each row on the first box, on the others, and for e_1 on the last.
FIRST_TRIES, LATER_TRIES, LAST_TRIES = 4, 1, 4

#: A bound is proven if it is better than what is known by this part of the interval.
WORTH_A_PROOF = 1e-3


@dataclass(frozen=True)
class Bootstrap:
    """The stages that were found, and what is known after them."""

    stages: tuple[BootstrapStage, ...]
    known: Known

    @property
    def bound(self) -> Any:
        """Of limsup |e_1|, exact."""
        low, high = self.known.box[0]
        return max(abs(low), abs(high))


def bootstrap(system: System, problem: ErrorProblem, first: Proof) -> Bootstrap:
    """All stages behind the proof `first` of a bound on e_n.

    Raises
    ------
    NoCertificate
        If drift or regressor have no bounds on the first box.
    """
    loop = adaptive_loop(system, problem)
    ranges = Ranges(formulas_of(system), loop)
    known = first_box(loop, first)
    rates: dict[tuple[int, int], Rate] = {}
    starts = _starts(loop, float(from_text(first.alpha)))
    stages: list[BootstrapStage] = []
    for count in range(MOST_STAGES):
        tries = LATER_TRIES if count else FIRST_TRIES
        stage, after = _stage(loop, ranges, known, rates, starts, tries)
        if not stage.bounds:
            break
        stages.append(stage)
        gain, known = _shrunk(known, after), after
        if gain < WORTH_A_STAGE:
            break
    return Bootstrap(tuple(stages), known)


def _starts(loop: AdaptiveLoop, slow: float) -> list[float]:
    """An alpha for each row: e_1 ... e_{n-1} follow e_n alone, and faster than the estimates."""
    head = loop.M[:-1, :-1].astype(float)
    fast = -float(np.linalg.eigvals(head).real.max()) if len(head) else slow
    return [max(fast, slow)] * (loop.n - 1) + [slow] * (loop.r + 3)


def _shrunk(before: Known, after: Known) -> float:
    """The largest part by which an interval has become smaller."""
    old, new = ((k.box[:, 1] - k.box[:, 0]).astype(float) for k in (before, after))
    return float((1 - new / old).max())


def _stage(
    loop: AdaptiveLoop,
    ranges: Ranges,
    known: Known,
    rates: dict[tuple[int, int], Rate],
    starts: list[float],
    tries: int,
) -> tuple[BootstrapStage, Known]:
    ground = ground_on(loop, ranges, known)
    numbers = ground.numbers()
    forms = forms_of(loop, numbers)
    program = BootstrapProgram(forms_of(loop.in_floats(), numbers.in_floats()))
    bounds = []
    rows = [*(np.eye(loop.size, dtype=object) + rational(0)), numbers.linear_row(loop)]
    for error, row in enumerate(rows[: len(forms.sectors)]):
        low, high = known.interval_of(row)
        for side in (1, -1):
            rate = rates.setdefault((error, side), Rate(starts[error]))
            best = high if side > 0 else -low
            found = _best(program, row_over_box(forms, side * row).astype(float), rate, tries)
            if found is None or found.bound > float(best) - WORTH_A_PROOF * float(high - low):
                continue
            proof = prove(forms, found, error, side, side * row)
            if proof is not None and from_text(proof.bound) < best:
                bounds.append(proof)
    for proof in bounds:
        known = known.improved(proof.error, proof.side, from_text(proof.bound), rows[proof.error])
    return BootstrapStage(ground, tuple(bounds)), known


def _best(program: BootstrapProgram, row: np.ndarray, rate: Rate, tries: int) -> Found | None:
    best: Found | None = None
    for _ in range(tries):
        found = program.solve(rate.alpha, row)
        rate.met(None if found is None else found.slope)
        if found is not None and (best is None or found.bound < best.bound):
            best = found
    return best



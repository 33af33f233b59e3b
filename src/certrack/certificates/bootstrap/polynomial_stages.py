"""Stages with polynomials, behind those with quadratic functions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.bootstrap.conditions import layout_of
from certrack.certificates.bootstrap.forms import Forms, forms_of
from certrack.certificates.bootstrap.loop import AdaptiveLoop
from certrack.certificates.bootstrap.polynomial_program import PolynomialProgram
from certrack.certificates.bootstrap.polynomial_proof import PolynomialProof, prove_polynomial
from certrack.certificates.bootstrap.proof import row_over_box
from certrack.certificates.bootstrap.ranges import Ranges
from certrack.certificates.bootstrap.rates import Rate, best_of_rates
from certrack.certificates.bootstrap.regions import Reached, after, next_region, rows_of
from certrack.certificates.bootstrap.stage import BootstrapStage
from certrack.certificates.bootstrap.variables import knows_reference, with_reference
from certrack.core.progress import Progress

#: Degree of the functions. With degree 6 a program takes 50 times as long.
FUNCTION_DEGREE = 4

#: Monomials of a Gram matrix with which a program is solved: a second or two for 15 of them, four
#: for 21, but seven to 35 for 28, the more the more inputs there are.
MOST_SOLVED = 28

#: Stages at most, the first one without the reference, and with more than so many monomials; they
#: end when no interval shrinks by more than this part.
MOST_STAGES_OF_POLYNOMIALS, WORTH_A_STAGE_OF_POLYNOMIALS = 6, 0.015
MANY_MONOMIALS, STAGES_OF_MANY = 21, 2

#: Programs for each row and side until its alpha is surrounded, and behind that or a sweep.
FIRST_PROGRAMS, LATER_PROGRAMS = 3, 1


def polynomial_stages(
    loop: AdaptiveLoop,
    ranges: Ranges,
    known: Reached,
    sweep: Sequence[float],
    progress: Progress,
) -> list[BootstrapStage]:
    """The stages behind what is known.

    Parameters
    ----------
    loop : AdaptiveLoop
    ranges : Ranges
    known : Reached
    sweep : floats, 1/s
        The alpha with which the search begins.
    progress : callable
        Gets the bound so far.
    """
    stages: list[BootstrapStage] = []
    if not _solvable(loop.size):
        return stages
    more = len(loop.Y) - 1
    reference, best = False, knows_reference(loop) and _solvable(loop.size + more)
    rates: dict[tuple[int, int], Rate] = {}
    largest = _monomials(loop.size + more if best else loop.size)
    most = MOST_STAGES_OF_POLYNOMIALS if largest <= MANY_MONOMIALS else STAGES_OF_MANY
    for _ in range(most):
        region = next_region(loop, ranges, known)
        numbers = region.numbers()
        forms, rows = forms_of(loop, numbers), rows_of(loop, numbers)
        floats = forms_of(loop.in_floats(), numbers.in_floats())
        functions = []
        solver = RowSolver(loop, forms, floats, reference=reference)
        for error in range(len(forms.sectors)):
            for side in (1, -1):
                first = (error, side) not in rates
                begin = rates[error, 1].alpha if side < 0 else sweep[0]
                rate = rates.setdefault((error, side), Rate(begin))
                tried = sweep if first and side > 0 else ()
                function = solver.bound(rows, (error, side), rate, tried)
                functions += [] if function is None else [function]
                so_far = after(known, functions, rows).box[0].astype(float)
                progress(0, None, float(np.abs(so_far).max()))
        later = after(known, functions, rows)
        gain, known = shrunk(known, later), later
        if functions:
            stages.append(BootstrapStage(region, tuple(functions)))
        if gain < WORTH_A_STAGE_OF_POLYNOMIALS and reference == best:
            break
        reference = best
    return stages


def _monomials(variables: int) -> int:
    """Those of a Gram matrix."""
    return math.comb(variables + FUNCTION_DEGREE // 2, FUNCTION_DEGREE // 2)


def _solvable(variables: int) -> bool:
    return _monomials(variables) <= MOST_SOLVED


def shrunk(before: Reached, after: Reached) -> float:
    """The largest part by which an interval has become smaller."""
    old, new = ((k.box[:, 1] - k.box[:, 0]).astype(float) for k in (before, after))
    return float((1 - new / old).max())


class RowSolver:
    """The program of a box, and the proofs of what it finds."""

    def __init__(self, loop: AdaptiveLoop, forms: Forms, floats: Forms, *, reference: bool) -> None:
        self._loop, self._errors, self._reference = loop, forms, reference
        self._forms = with_reference(loop, forms) if reference else forms
        floats = with_reference(loop.in_floats(), floats) if reference else floats
        self._program = PolynomialProgram(floats, layout_of(self._forms, FUNCTION_DEGREE))

    def bound(
        self,
        rows: Sequence[np.ndarray],
        wanted: tuple[int, int],
        rate: Rate,
        sweep: Sequence[float] = (),
    ) -> PolynomialProof | None:
        """A proven bound of one side of a row, if there is one."""
        error, side = wanted
        more = self._forms.size - self._loop.size
        row = np.append(side * rows[error], [rational(0)] * more)
        asked = row_over_box(self._forms, row).astype(float)[None]
        tries = LATER_PROGRAMS if sweep or rate.surrounded else FIRST_PROGRAMS
        solution = best_of_rates(self._program, asked, rate, tries, sweep)
        if solution is None:
            return None
        return prove_polynomial(
            self._loop,
            self._errors,
            solution,
            [wanted],
            rows,
            degree=FUNCTION_DEGREE,
            reference=self._reference,
        )

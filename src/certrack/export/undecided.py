"""Where rounding decides on a jump: no point for a test of exported code.

A sign, or a choice between formulas that do not meet, jumps where its argument passes zero. If the
argument is zero but for rounding, because its terms cancel, one code may jump and another not, and
both are right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.lowering import numpy_callable, rows
from certrack.core.printing import recognise_selection
from certrack.core.select import Select

#: Relative change by which the terms of an argument show.
TERM_PROBE = 1e-6

#: An argument below this part of its terms is rounding.
CANCELLED_SHARE = {"double": 1e-13, "float": 1e-6}


def undecided_jumps(
    formulas: Sequence[sympy.Expr],
    arguments: Sequence[Sequence[sympy.Symbol]],
    inputs: Sequence[Array],
    parameters: Array,
    real: str,
) -> Array:
    """At which points a jump of the formulas is left to rounding.

    Parameters
    ----------
    formulas : formulas
    arguments : lists of symbols
        As many as `inputs`, then the parameters.
    inputs : arrays (rows, N)
    parameters : (P,) array
    real : {"double", "float"}

    Returns
    -------
    (N,) array of bool
    """
    jumps = _jump_arguments(formulas)
    count = inputs[0].shape[1]
    undecided = np.zeros(count, dtype=bool)
    if not jumps:
        return undecided
    function = numpy_callable(list(arguments), jumps)

    def values(*changed: Array) -> Array:
        with np.errstate(all="ignore"):
            return rows(function(*changed), count)

    everything = [*inputs, np.repeat(parameters[:, None], count, axis=1)]
    at = values(*everything)
    terms = np.zeros_like(at)
    for which, part in enumerate(everything):
        for row in range(len(part)):
            changed = [each.copy() for each in everything]
            changed[which][row] *= 1 + TERM_PROBE
            terms += np.abs(values(*changed) - at) / TERM_PROBE
    undecided |= ((terms > 0) & (np.abs(at) <= CANCELLED_SHARE[real] * terms)).any(axis=0)
    return undecided


def _jump_arguments(formulas: Sequence[sympy.Expr]) -> list[sympy.Expr]:
    """What passes zero where a formula may jump."""
    choices = set().union(*(formula.atoms(Select) for formula in formulas))
    signs = set().union(*(formula.atoms(sympy.sign) for formula in formulas))
    differences = [c.args[0] - c.args[1] for c in choices if not recognise_selection(c)]
    return sorted([*differences, *(s.args[0] for s in signs)], key=sympy.default_sort_key)

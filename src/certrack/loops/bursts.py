"""Bursts: where a smooth formula of t suddenly moves much faster than before.

An integrator chooses a step from what it sees at its begin and inside it. Of a loop at rest the
steps are long, and a pulse such as exp(-((t-10)/0.02)^2) lies between two looks. So formulas of t
alone are scanned before a run: the time is cut into cells, on each of which the formula is proven,
by enclosures of its Taylor coefficients (:mod:`certrack.core.enclosures`), to be a polynomial of
degree :data:`ORDER` - 1 within the tolerance. Where cells become much shorter than those before,
their ends are marks: breaks of the run, from which on the integrator sees what comes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.arrays import Array
from certrack.core.enclosures import Known, enclose
from certrack.core.errors import shorten
from certrack.core.expressions import TIME

#: On a cell the formula is a polynomial of a degree below this.
ORDER = 8

#: Cells are halved down to this part of the time, and until there are this many at most.
SHORTEST_CELL, MAX_CELLS = 2.0**-36, 50_000

#: A cell is the begin of a burst if one of so many before it is so many times as long.
MEMORY, BURST_RATIO = 8, 4.0

#: Ends of so many cells from the begin of a burst on are marks; after them the steps are as short
#: as the formula asks for, and the error control sees it.
MARKED_CELLS = 24

#: Sums of no more than so many polynomials, sines and exponentials of t are not scanned: none of
#: them is ever quiet.
MAX_PLAIN_TERMS = 8

#: Letters of a formula that a note shows.
NOTED_LETTERS = 60


@dataclass(frozen=True)
class Scan:
    """What a scan of one formula found.

    Attributes
    ----------
    marks : array, s
        Breaks of the run.
    cells : int
        Number of cells; 0 where the formula need not be scanned.
    shortest : float, s
        Length of the shortest cell.
    note : str
        For the user; empty where nothing was found.
    """

    marks: Array
    cells: int = 0
    shortest: float = 0.0
    note: str = ""


def scan(
    formula: sympy.Expr,
    nodes: Array,
    known: Known,
    switches: Mapping[sympy.Symbol, Array],
    tolerance: float,
) -> Scan:
    """Scan a smooth formula of t for bursts.

    Parameters
    ----------
    formula : sympy.Expr
        Smooth between the nodes.
    nodes : (K+1,) array, s
        From the begin to the end of the run.
    known : mapping
        Numbers of all symbols but t and the switches.
    switches : mapping
        Value of each switch between the nodes, shape (K,).
    tolerance : float
        The integral of the formula over a cell is that of a polynomial within it, relative to
        1 + |formula|.

    Returns
    -------
    Scan
    """
    if is_plain(formula):
        return Scan(np.empty(0))
    duration = nodes[-1] - nodes[0]
    begins, ends, piece = nodes[:-1], nodes[1:], np.arange(len(nodes) - 1)
    done: list[Array] = []
    count, unresolved = 0, False
    while len(begins):
        values = {**known, **{symbol: row[piece] for symbol, row in switches.items()}}
        enclosure = enclose(formula, begins, ends, values, ORDER)
        width = ends - begins
        allowed = tolerance * (1 + enclosure.sizes[0])
        known_well = np.isfinite(enclosure.sizes[ORDER])
        fine = known_well & (enclosure.sizes[ORDER] * width <= allowed)
        fine |= enclosure.sizes[0] * width <= tolerance  # whatever it does there
        tiny = width <= SHORTEST_CELL * duration
        full = count + len(begins) > MAX_CELLS
        unresolved |= bool((~fine & (tiny | full)).any())
        settled = fine | tiny | full
        done.append(begins[settled])
        count += int(settled.sum())
        begins, ends, piece = (part[~settled] for part in (begins, ends, piece))
        middle = (begins + ends) / 2
        begins, ends = np.concatenate([begins, middle]), np.concatenate([middle, ends])
        piece = np.concatenate([piece, piece])
    edges = np.append(np.sort(np.concatenate(done)), nodes[-1])
    marks = _marks(edges)
    shortest = float(np.diff(edges).min())
    numbers = {symbol: sympy.Float(float(value)) for symbol, value in known.items()}
    text = sympy.sstr(formula.xreplace(numbers), full_prec=False)
    return Scan(marks, count, shortest, _note(text, count, shortest, len(marks), unresolved))


def _marks(edges: Array) -> Array:
    """Ends of the cells from the begin of each burst on."""
    widths = np.diff(edges)
    padded = np.concatenate([np.zeros(MEMORY), widths])
    before = np.lib.stride_tricks.sliding_window_view(padded, MEMORY)[: len(widths)].max(axis=1)
    begins = np.flatnonzero(before >= BURST_RATIO * widths)
    marked = np.zeros(len(edges), dtype=bool)
    for k in range(MARKED_CELLS):
        marked[np.minimum(begins + k, len(edges) - 1)] = True
    marks: Array = edges[marked]
    return marks


def _note(text: str, cells: int, shortest: float, marks: int, unresolved: bool) -> str:
    text = shorten(text, NOTED_LETTERS)
    if unresolved:
        return (
            f"A formula of t was scanned down to {shortest:.2g} s, on {cells} cells, and is not "
            f"resolved there: {text}. Shorter events are not looked for."
        )
    if marks:
        return (
            f"A formula of t has short events, which the run stops at; scanned on {cells} cells, "
            f"the shortest {shortest:.2g} s: {text}."
        )
    return ""


def is_plain(formula: sympy.Expr) -> bool:
    """Whether a formula is a short sum of polynomials, sines and exponentials of linear phase."""
    terms = sympy.Add.make_args(formula)
    return len(terms) <= MAX_PLAIN_TERMS and all(map(_is_plain_term, terms))


def _is_plain_term(term: sympy.Expr) -> bool:
    waves = growths = degree = 0
    for factor in sympy.Mul.make_args(term):
        if TIME not in factor.free_symbols:
            continue
        base, power = factor.as_base_exp() if isinstance(factor, sympy.Pow) else (factor, 1)
        if power == 1 and isinstance(factor, (sympy.sin, sympy.cos, sympy.exp)):
            if not _is_linear(factor.args[0]):
                return False
            waves += not isinstance(factor, sympy.exp)
            growths += isinstance(factor, sympy.exp)
        elif _is_linear(base) and sympy.Integer(power).is_Integer and 0 < power <= MAX_PLAIN_TERMS:
            degree += int(power)
        else:
            return False
    return waves <= 1 and growths <= 1 and degree <= MAX_PLAIN_TERMS


def _is_linear(formula: sympy.Expr) -> bool:
    """Whether the derivative by t does not contain t."""
    return bool(formula.is_polynomial(TIME)) and sympy.degree(formula, TIME) <= 1

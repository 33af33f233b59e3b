"""The largest |f^(i)(t)| of a formula over an interval without end, by branch and bound.

The interval is cut into pieces, and pieces in which the bound is largest are cut again. On a piece
that never ends, or is longer than a turn of a sine, the phases of the sines are intervals of their
own: sin(3 t) has every value there, whatever t.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import sympy
from flint import arb

from certrack.core.expressions import TIME
from certrack.core.kinks import without_minmax
from certrack.references.growth import (
    INFINITE,
    LINEAR,
    GrowthEnclosure,
    Span,
    Undefined,
    ball,
)
from certrack.references.taylor import Evaluation, constant

#: A bound this much above a value that is reached is good enough.
LOOSENESS = 1e-4

#: Operations on coefficients for one bound: a second or two.
MAX_WORK = 600_000

#: Cuts of a piece without a bound until none is expected, and narrowest phases, in turns.
MAX_CUTS_UNBOUNDED, NARROWEST_PHASE = 30, 2.0**-14

#: A cut in time of a piece without end must lower its bound so much more than one in phase.
GAIN_IN_TIME = 0.99

#: Pieces that are tried for a proof that a formula is defined everywhere.
MAX_PROVEN_PIECES = 4000

#: Cuts of a piece until a formula counts as undefined there.
MAX_CUTS = 50

#: Where the piece without end begins, s; further cuts are found.
FIRST_END = 8

#: Distinct frequencies whose phases are told apart, and turns of the fastest to one of the slowest.
MAX_PHASES, MAX_TURNS = 3, 64


@dataclass(frozen=True)
class Piece:
    """Times, and phases modulo 2 pi where they are told apart; None where t tells them.

    Attributes
    ----------
    begin, end : float
        Dyadic numbers of few digits, or an infinite end.
    phases : pairs of floats
        In turns of 2 pi.
    cuts : int
        How often it was cut.
    """

    begin: float
    end: float
    phases: tuple[tuple[float, float], ...] | None
    cuts: int = 0

    def in_time(self) -> Iterator[Piece]:
        """The first and the last half of its times."""
        if math.isinf(self.end):
            middle = 2 * max(self.begin, 1.0)
        else:
            middle = (self.begin + self.end) / 2
        yield replace(self, end=middle, cuts=self.cuts + 1)
        yield replace(self, begin=middle, cuts=self.cuts + 1)

    def in_phase(self, i: int) -> Iterator[Piece]:
        """Both halves of the turns of a phase."""
        assert self.phases is not None
        low, high = self.phases[i]
        for part in ((low, (low + high) / 2), ((low + high) / 2, high)):
            phases = (*self.phases[:i], part, *self.phases[i + 1 :])
            yield replace(self, phases=phases, cuts=self.cuts + 1)


class Formula:
    """A formula of t on begin <= t < end, its derivatives to be bounded.

    Parameters
    ----------
    expr : formula of t
    begin, end : float
        Rounded outward; the end may be infinite.
    """

    def __init__(self, expr: sympy.Expr, begin: float = 0.0, end: float = math.inf) -> None:
        has_extremes = expr.has(sympy.Max, sympy.Min)  # written by abs, once
        self.expr = without_minmax(expr) if has_extremes else expr
        self.begin = begin
        self.end = min(end, begin + self.period)

    @cached_property
    def period(self) -> float:
        """After it the formula repeats, rounded up, s; infinite if it does not."""
        if len(self._tables) != 1:
            return math.inf
        base, turns = self._tables[0]
        if not all(offset.is_number for _, offset in turns.values()):
            return math.inf
        # a symbol for each, else sin(t) - cos(3*t) would be nothing, and what it multiplies with it
        waves = {f(arg): sympy.Dummy() for arg in turns for f in (sympy.sin, sympy.cos)}
        if self.expr.xreplace(waves).has(TIME):
            return math.inf
        return 2 * math.pi / abs(float(base)) * (1 + 1e-12)

    @cached_property
    def _tables(self) -> list[tuple[sympy.Expr, dict[sympy.Expr, tuple[int, sympy.Expr]]]]:
        """Per base frequency: argument of a sine -> its multiple and what is added to it."""
        groups: list[tuple[sympy.Expr, dict[sympy.Expr, tuple[sympy.Rational, sympy.Expr]]]] = []
        waves = self.expr.atoms(sympy.sin, sympy.cos)
        for wave in sorted(waves, key=sympy.default_sort_key):  # a set has no order of its own
            arg = wave.args[0]
            w = sympy.expand(arg).coeff(TIME, 1)
            offset = sympy.expand(arg - w * TIME)
            if not w.is_number or w == 0:
                continue
            for first, members in groups:
                ratio = w / first
                if ratio.is_Rational:
                    members[arg] = (ratio, offset)
                    break
            else:
                groups.append((w, {arg: (sympy.S.One, offset)}))
        tables = []
        for first, members in groups[:MAX_PHASES]:
            common = _common_divisor([ratio for ratio, _ in members.values()])
            turns = {arg: (int(ratio / common), offset) for arg, (ratio, offset) in members.items()}
            if max(abs(n) for n, _ in turns.values()) <= MAX_TURNS:
                tables.append((first * common, turns))
        return tables

    @cached_property
    def _turn(self) -> float:
        """Longest piece on which t tells the phases, s."""
        sizes = [
            abs(float(base)) * max(abs(n) for n, _ in turns.values())
            for base, turns in self._tables
        ]
        return 2 * math.pi / max(sizes) if sizes else math.inf

    def pieces(self) -> list[Piece]:
        """All times, in few pieces."""
        if self.end - self.begin <= FIRST_END:
            return [self._settled(Piece(self.begin, self.end, self._all_phases))]
        middle = math.ceil(self.begin) + FIRST_END
        ends = [self.begin, float(middle), self.end]
        if ends[1] >= self.end:
            ends = [self.begin, self.end]
        return [self._settled(Piece(a, b, self._all_phases)) for a, b in itertools.pairwise(ends)]

    @property
    def _all_phases(self) -> tuple[tuple[float, float], ...]:
        return ((0.0, 1.0),) * len(self._tables)

    def _settled(self, piece: Piece) -> Piece:
        """With phases only where it is long."""
        is_long = math.isinf(piece.end) or piece.end - piece.begin > self._turn
        return piece if is_long else replace(piece, phases=None)

    def possible_cuts(self, piece: Piece) -> list[list[Piece]]:
        """Each possible cut of a piece in two: in its phases, and last in time."""
        cuts = [list(map(self._settled, piece.in_time()))]
        if piece.phases is not None and math.isinf(piece.end):
            wide = [i for i, (a, b) in enumerate(piece.phases) if b - a > NARROWEST_PHASE]
            cuts = [list(piece.in_phase(i)) for i in wide] + cuts
        return cuts

    def evaluation(self, piece: Piece, order: int, *, smooth: bool = False) -> Evaluation:
        """Taylor coefficients on a piece."""
        if piece.phases is None:
            return Evaluation(ball(piece.begin, piece.end), order, smooth=smooth)
        span = Span(arb(piece.begin), INFINITE if math.isinf(piece.end) else arb(piece.end))
        phases = {
            arg: (2 * arb.pi() * n * ball(*turn), offset)
            for turn, (_, turns) in zip(piece.phases, self._tables, strict=True)
            for arg, (n, offset) in turns.items()
        }
        return Evaluation(GrowthEnclosure(span, {LINEAR: ONE_EXACTLY}), order, phases, smooth)


ONE_EXACTLY = constant(sympy.S.One)


def _common_divisor(ratios: Iterable[sympy.Rational]) -> sympy.Rational:
    """The largest rational of which all are whole multiples.

    SymPy's ``gcd_list`` is not used: it stops at the first 1, and so overlooks 1/2 in (1, 1, 1/2).
    """
    numerators, denominators = zip(*((int(r.p), int(r.q)) for r in ratios), strict=True)
    return sympy.Rational(math.gcd(*numerators), math.lcm(*denominators))


def prove_defined(formula: Formula, *, smooth: bool) -> None:
    """Prove that the formula has one value at every time, and is continuous.

    Parameters
    ----------
    formula : Formula
    smooth : bool
        Prove that it is analytic, but for kinks of abs, min and max.

    Raises
    ------
    Undefined
        Where that could not be proven; the text says near which time, and why.
    """
    waiting = formula.pieces()[::-1]
    for _ in range(MAX_PROVEN_PIECES):
        if not waiting:
            return
        piece = waiting.pop()
        try:
            formula.evaluation(piece, 1, smooth=smooth).series(formula.expr)
        except Undefined as problem:
            if piece.cuts >= MAX_CUTS or piece.end - piece.begin < 1e-9 * max(1.0, piece.begin):
                raise Undefined(f"{problem} near t = {piece.begin:.6g}") from None
            cuts = formula.possible_cuts(piece)
            waiting += cuts[piece.cuts % len(cuts)][::-1]
    raise Undefined("it has too many pieces")


def derivative_bound(formula: Formula, order: int) -> float | None:
    """Upper bound of |f^(order)| on all times of the formula, or None.

    Parameters
    ----------
    formula : Formula
    order : int

    Returns
    -------
    float or None
        Rounded up; None where no bound was found.
    """
    search = _Search(formula, order)
    for piece in formula.pieces():
        search.add(piece, search.bound(piece))
    while search.work < MAX_WORK and not search.is_done():
        search.cut()
    return search.result()


class _Search:
    """Pieces with the bounds on them, the largest first."""

    def __init__(self, formula: Formula, order: int) -> None:
        self.formula, self.order = formula, order
        self.factor = math.factorial(order)
        self.heap: list[tuple[float, int, Piece]] = []
        self.count = itertools.count(0, -1)  # of equal bounds the newest: one is followed down
        self.reached = 0.0
        self.work = 0

    def add(self, piece: Piece, bound: float) -> None:
        heapq.heappush(self.heap, (-bound, next(self.count), piece))

    def is_done(self) -> bool:
        largest, _, piece = self.heap[0]
        close = -largest <= self.reached * (1 + LOOSENESS)
        return close or piece.cuts >= (MAX_CUTS_UNBOUNDED if math.isinf(largest) else MAX_CUTS)

    def cut(self) -> None:
        """Cut the piece with the largest bound so that it lowers the bound most."""
        _, _, piece = heapq.heappop(self.heap)
        cuts = self.formula.possible_cuts(piece)
        *in_phase, in_time = [[(half, self.bound(half)) for half in cut] for cut in cuts]
        if in_phase:  # of phases that are equally good, each in its turn
            turn = piece.cuts % len(in_phase)
            in_phase = in_phase[turn:] + in_phase[:turn]
        best = min(in_phase, key=_largest_of, default=in_time)
        if _largest_of(in_time) < GAIN_IN_TIME * _largest_of(best):
            best = in_time
        for half, bound in best:
            self.add(half, bound)

    def result(self) -> float | None:
        bound = -self.heap[0][0]
        return None if math.isinf(bound) else bound

    def bound(self, piece: Piece) -> float:
        """Bound of |f^(order)| on a piece, infinite where there is none."""
        try:
            value = self._natural(piece)
            if piece.phases is None:
                value = _closer(value, self._centred(piece))
        except Undefined:
            return math.inf
        if not value.is_finite():
            return math.inf
        self.reached = max(self.reached, _float_below(value.abs_lower()))
        return float_above_ball(value.abs_upper())

    def _natural(self, piece: Piece) -> arb:
        return self._derivative(self.formula.evaluation(piece, self.order), self.order)

    def _derivative(self, evaluation: Evaluation, order: int) -> arb:
        try:
            value = evaluation.series(self.formula.expr)[order]
        finally:
            self.work += evaluation.work
        ball_of = value.interval() if isinstance(value, GrowthEnclosure) else arb(value)
        return ball_of * math.factorial(order)

    def _centred(self, piece: Piece) -> arb:
        """f(m) + f'(piece) (t - m), and f'(piece) decides whether the ends are largest."""
        times = ball(piece.begin, piece.end)
        slope = self._derivative(self.formula.evaluation(piece, self.order + 1), self.order + 1)
        ends = [self._at(arb(t)) for t in (piece.begin, piece.end)]
        self.reached = max(self.reached, *(_float_below(v.abs_lower()) for v in ends))
        if slope >= 0 or slope <= 0:
            return ends[0].union(ends[1])
        middle = times.mid()
        return self._at(middle) + slope * (times - middle)

    def _at(self, t: arb) -> arb:
        return self._derivative(Evaluation(t, self.order), self.order)


def _largest_of(halves: list[tuple[Piece, float]]) -> float:
    return max(bound for _, bound in halves)


def _closer(a: arb, b: arb) -> arb:
    """The enclosure of the two with the smaller bound."""
    if not b.is_finite():
        return a
    return b if not a.is_finite() or b.abs_upper() < a.abs_upper() else a


def float_above_ball(value: arb) -> float:
    """The smallest float that is not below a point of Arb."""
    nearest = float(value)
    while math.isfinite(nearest) and not arb(nearest) >= value:
        nearest = math.nextafter(nearest, math.inf)
    return nearest


def _float_below(value: arb) -> float:
    nearest = float(value)
    return math.nextafter(nearest, 0.0) if math.isfinite(nearest) else 0.0

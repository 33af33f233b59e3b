"""Parts of the proofs for ranges, against closed forms and with provers that are known."""

import itertools
import math
import re
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction
from inspect import signature
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from test_independent_ranges import VARIANTS
from test_range_algebra import FIRST_ORDER, exact

import certrack
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.ranges import strength
from certrack.certificates.ranges.boxes import (
    closed,
    forbidden,
    moved,
    names,
    scaled,
    with_range,
)
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.ranges.coefficients import Coefficients, _parts, largest_brackets
from certrack.certificates.ranges.costs import costs
from certrack.certificates.ranges.edges import Edge, _decimal, largest_scale
from certrack.certificates.ranges.estimates import estimated_peak_gains
from certrack.certificates.ranges.formulas import OpenFormulas
from certrack.certificates.ranges.loop import error_form, ranged_loop
from certrack.certificates.ranges.peak import peak_bound
from certrack.certificates.ranges.proofs import (
    CellProof,
    RangeProver,
    cells_fill,
    check_cells,
    numbers,
    texts,
)
from certrack.certificates.ranges.search import RangeBounds, bound_ranges
from certrack.certificates.ranges.sectors import sector_of
from certrack.certificates.ranges.strength import NO_PROOF, _Search, critical_ranges
from certrack.certificates.ranges.vertices import ProblemMaker, VertexProgram, prove_vertices
from certrack.certificates.semidefinite import best_solution

A_ONLY = re.sub(r"input_gain = \[4.*|theta = \[\[.*", "", FIRST_ORDER)


def first_order(uncertainty="", ranged=A_ONLY, signal="sin(t)"):
    """x' = -a x + x + 5 u with a = 2.5 in [2, 3] and c = 7, so e' = -7 e + (2.5 - a) x + w."""
    text = ranged.replace("sin(t)", signal)
    if uncertainty:
        text = text.replace("tau = [0]\ngamma = [0]\nbeta = [0]", uncertainty)
    return ranged_loop(certrack.loads(text.replace("omega = [0]", "")))


def peak_of(loop, box=None):
    return peak_bound(loop, Coefficients(loop), loop.box if box is None else box).bound


POINT = ((exact("2.5"), exact("2.5")),)

# bounds by peak gains that are known


@pytest.mark.parametrize(
    ("uncertainty", "known"),
    [
        ("tau = [2]\ngamma = [0]\nbeta = [0.3]", 0.6 / 7),
        ("tau = [2]\ngamma = [0.4]\nbeta = [0.3]", (0.8 * 1.5 + 0.6) / (7 - 0.8)),
        ("tau = [2]\ngamma = [0.4]\nbeta = [0.3]\nS = [[0.5]]", (0.4 * 1.5 + 0.6) / (7 - 0.4)),
        (
            "tau = [2]\ngamma = [0.4]\nbeta = [0.3]\nDelta = [[0.1]]",
            (1.0 * 1.5 + 0.6) / (7 - 1.0),
        ),
    ],
)
def test_a_first_order_loop_of_one_value_has_the_bound_of_its_fixed_point(uncertainty, known):
    """|e| = (gamma (|e| + Y_0) + beta)/7."""
    loop = first_order(uncertainty, signal="1.5*sin(t)")
    assert known <= peak_of(loop, POINT) <= known * (1 + 1e-6)


@pytest.mark.parametrize(("low", "high"), [("2", "3"), ("2.25", "2.75"), ("1", "4")])
def test_a_rate_within_a_range_has_the_bound_of_its_worst_constant(low, high):
    """e' = -(7 - d) e + d y with |d| <= half: half Y_0/(7 - half), for a constant y."""
    loop = first_order(signal="1.5*sin(t)")
    half = (float(high) - float(low)) / 2
    known = half * 1.5 / (7 - half)
    assert known <= peak_of(loop, ((exact(low), exact(high)),)) <= known * (1 + 1e-6)


def test_an_offset_of_the_constants_is_carried_to_the_error():
    """x' = ... + (a - 2.5): e = half/7 at rest, and nothing of y."""
    text = re.sub('"-a\\*x1"', '"a - x1"', A_ONLY)
    loop = first_order(ranged=text)
    assert 0.5 / 7 <= peak_of(loop) <= 0.5 / 7 * (1 + 1e-6)
    off = (exact("2.5"), exact("3"))  # the centre is off by a quarter, and half of it stays
    assert 0.5 / 7 <= peak_of(loop, (off,)) <= 0.5 / 7 * (1 + 1e-6)


def test_a_range_through_which_the_loop_is_unstable_has_no_bound():
    loop = first_order()
    with pytest.raises(NoCertificate, match="not below 1"):
        peak_of(loop, ((exact("-4.5"), exact("9.5")),))
    for half in ("6.3", "6.8"):  # a gain of 0.9 and of 0.97
        known = float(half) / (7 - float(half))
        box = ((exact("2.5") - exact(half), exact("2.5") + exact(half)),)
        assert known <= peak_of(loop, box) <= known * (1 + 1e-6)
    with pytest.raises(NoCertificate, match="not stable"):
        peak_of(loop, ((exact("-4.6"), exact("-4.6")),))


# functions of the constants


def test_a_loop_is_its_centre_and_channels():
    """At every corner some delta in [-1, 1] gives the matrix."""
    loop = first_order(ranged=FIRST_ORDER)
    channels = Coefficients(loop).over(loop.box)
    rng = np.random.default_rng(2)
    for _ in range(20):
        point = [
            low + (high - low) * exact(Fraction(int(rng.integers(9)), 8)) for low, high in loop.box
        ]
        matrix, _ = loop.unpacked(loop.entries.at(point))
        gap = (matrix - channels.centre).astype(float)[0]
        reach = (np.abs(channels.columns.astype(float)) @ np.abs(channels.rows.astype(float)))[0]
        assert (np.abs(gap) <= reach + 1e-12).all()
    assert channels.rows.shape[0] == channels.columns.shape[1] == len(Coefficients(loop).functions)
    still = Coefficients(loop).over([(v, v) for v in loop.nominal])
    assert still.rows.shape == (0, matrix.shape[1]) and still.columns.shape == (1, 0)
    assert (still.centre == loop.unpacked(loop.entries.at(loop.nominal))[0]).all()


@pytest.mark.parametrize("text", ["3*p/2 + 5", "(p + 2*q)/(4*q)", "p**2*q - 7/(2*p)", "0", "2/3"])
def test_an_entry_is_the_sum_of_its_parts(text):
    symbols = sympy.symbols("p q")
    entry = sympy.sympify(text)
    parts = _parts(entry, symbols)
    total = sum(
        (sympy.Rational(int(c.p), int(c.q)) * function for function, c in parts), sympy.S.Zero
    )
    assert sympy.cancel(total - entry) == 0
    for function, _ in parts:  # a number before it would be another function
        top, bottom = sympy.fraction(sympy.cancel(function))
        assert sympy.LC(top, *symbols) == 1 and sympy.Poly(bottom, *symbols).content() == 1


def test_terms_of_a_law_that_estimates_are_those_of_the_drift_alone():
    system = certrack.loads(FIRST_ORDER)
    known, estimated = (OpenFormulas(system, flag).terms() for flag in (False, True))
    (x,), (a, _, theta) = system.plant.symbols, OpenFormulas(system, False).symbols
    assert estimated == {x: -a} and list(known) == [x]
    assert sympy.expand(known[x] - (theta - a)) == 0


def test_the_largest_bracket_of_a_box():
    text = re.sub('"-a\\*x1"', '"a*atan(x1**3)"', A_ONLY)
    loop = first_order(ranged=text)
    assert [float(v) for v in largest_brackets(loop, loop.box)] == [0.5]
    assert [float(v) for v in largest_brackets(loop, ((exact("1"), exact("2.75")),))] == [1.5]
    assert [float(v) for v in largest_brackets(loop, ((exact("2.5"), exact("4")),))] == [1.5]
    assert float(loop.sizes[0]) == pytest.approx(math.pi / 2) and loop.sizes[0] > exact("1.5707")


# boxes


def test_boxes_about_the_nominal_constants():
    loop = first_order(ranged=FIRST_ORDER)  # 2.5 in [2, 3], 5 in [4, 6], 1 in [0.5, 1.5]
    assert names(loop) == ("a", "input_gain", "theta[0]")

    def ends(box):
        return [(float(low), float(high)) for low, high in box]

    assert ends(closed(loop, 1)) == [(2, 3), (5, 5), (0.5, 1.5)]
    assert ends(with_range(loop, 2, exact(0), exact(9))) == [(2, 3), (4, 6), (0, 9)]
    assert ends(scaled(loop, exact(2))) == [(1.5, 3.5), (3, 7), (0, 2)]
    assert ends(scaled(loop, exact("1/2"))) == [(2.25, 2.75), (4.5, 5.5), (0.75, 1.25)]
    cell = ((exact("2.5"), exact("3")), loop.box[1], loop.box[2])
    assert ends(moved(loop, cell, exact(3)))[0] == (2.5, 4)
    off = replace(loop, nominal=(exact(4), *loop.nominal[1:]))
    assert ends(scaled(off, exact("1/2")))[0] == (3, 4)  # the nominal value is an end of it
    low = replace(loop, nominal=(exact(1), *loop.nominal[1:]))
    assert ends(scaled(low, exact("1/2")))[0] == (1, 2)


def test_ranges_that_no_plant_has_are_forbidden():
    loop = first_order(ranged=FIRST_ORDER)
    assert forbidden(loop, loop.box) == ""
    for low in ("0", "-1"):
        box = with_range(loop, 1, exact(low), exact(6))
        assert forbidden(loop, box) == "plant.ranges.input_gain would reach zero"
    assert forbidden(loop, with_range(loop, 1, exact("1/1000"), exact(6))) == ""
    assert forbidden(loop, with_range(loop, 0, exact(-9), exact(9))) == ""  # a is in no chain
    chain = ranged_loop(certrack.loads(VARIANTS["small"]))  # k/m, and g_n = 1/m
    assert names(chain) == ("m",) and forbidden(chain, chain.box) == ""
    assert "plant.chain[0] = k/m" in forbidden(chain, ((exact(0), exact(1)),))
    assert "plant.chain[0] = k/m" in forbidden(chain, ((exact(-1), exact(1)),))


def test_what_each_constant_costs():
    loop = first_order(ranged=FIRST_ORDER)
    asked = []

    def search(box):
        asked.append(box)
        return SimpleNamespace(certified=[0.5, 3.0, math.inf][len(asked) - 1])

    found = costs(SimpleNamespace(loop=loop), search, SimpleNamespace(certified=2.0))
    assert asked == [closed(loop, k) for k in range(3)]
    assert [cost.name for cost in found] == ["a", "input_gain", "theta[0]"]
    first, second, third = (
        [value for key, value in vars(cost).items() if key != "name"] for cost in found
    )
    assert first == [2.0, 2.5, 3.0, 0.5, 2.0, True]
    assert second == [4.0, 5.0, 6.0, 2.0, 2.0, True]  # a proof of the box is one of its part
    assert third == [0.5, 1.0, 1.5, 2.0, 2.0, True]
    asked.clear()
    off = replace(loop, nominal=(exact(4), *loop.nominal[1:]))
    found = costs(
        SimpleNamespace(loop=off),
        lambda _: SimpleNamespace(certified=math.inf),
        SimpleNamespace(certified=2.0),
    )
    assert list(vars(found[0]).values())[-3:] == [math.inf, 2.0, False]


def test_scales_are_short_decimals_rounded_down():
    assert _decimal(1.0) == "1" and _decimal(0.1234567) == "0.12345"
    assert _decimal(1.99999999) == "1.9999" and _decimal(1e9) == "1000000000"
    assert _decimal(2.0**-20) == "0.00000095367"


# estimates of peak gains


@pytest.mark.parametrize("rate", [1e-3, 1.0, 50.0])
def test_estimates_of_peak_gains_are_near_the_integrals(rate):
    def of(M, C, B):
        return estimated_peak_gains(*(np.array(part, dtype=object) for part in (M, C, B)))

    assert of([[-rate]], [[3.0]], [[2.0, -1.0]])[0] == pytest.approx([6 / rate, 3 / rate], rel=1e-3)
    two = of([[-rate, 0], [0, -3 * rate]], [[1, 1], [1, -1]], [[1], [1]])  # e^-t -+ e^-3t
    assert two[:, 0] == pytest.approx([4 / 3 / rate, 2 / 3 / rate], rel=1e-3)
    M = [[-rate, 20 * rate], [-20 * rate, -rate]]  # e^-t |cos 20 t|
    w = 20.0
    decay = math.exp(-math.pi / w)
    first = (w * math.exp(-math.pi / (2 * w)) + 1) / (1 + w * w)
    half = w * math.exp(-math.pi / (2 * w)) * (1 + decay) / (1 + w * w) / (1 - decay)
    assert of(M, [[1, 0]], [[1], [0]])[0, 0] * rate == pytest.approx(first + half, rel=2e-2)
    for pole in (0.0, rate):
        with pytest.raises(NoCertificate, match="not stable"):
            of([[pole]], [[1.0]], [[1.0]])
    with pytest.raises(NoCertificate, match="range of floating point"):
        of([[-rate]], [[math.inf]], [[1.0]])


# sectors


def test_the_sector_of_a_product_is_the_narrowest_of_its_factors():
    x1, x2 = sympy.symbols("x1 x2", real=True)

    def found(function):
        j, low, high = sector_of(function, [x1, x2])
        return j, float(low), float(high)

    assert found(x1 * sympy.cos(x2)) == pytest.approx((0, -1, 1))
    assert found(-3 * sympy.tanh(x2)) == pytest.approx((1, -3, 0))
    assert found(sympy.atan(2 * x2) * (2 + sympy.sin(x1))) == pytest.approx((1, 0, 6))
    assert found(x1 * sympy.tanh(2 * x1)) == pytest.approx((0, -1, 1))  # by x1: |tanh| <= 1
    assert found(sympy.tanh(x1) * sympy.sin(x1)) == pytest.approx((0, -1, 1))
    assert found(sympy.Abs(x1) * sympy.tanh(x2)) == pytest.approx((0, -1, 1))
    assert found(sympy.tanh(-2 * x2)) == pytest.approx((1, -2, 0))
    assert sector_of(sympy.cos(x1), [x1, x2]) is None
    assert sector_of(x1 * x2, [x1, x2]) is None


# the search


def interval(*ends):
    return tuple(map(exact, ends))


def size_of(cell):
    low, high = map(float, cell[0])
    return high - low + 0.25 * high


class Prover:
    """Bounds that are known: the width of a cell and a part of its end, times the method's cost."""

    by_peak_gains = True

    def __init__(self, peak=1.0, vertices=2.0, moving=0, width=(1, 3)):
        self.costs = {"peak": peak, "vertices": vertices}
        self.loop = SimpleNamespace(moving=moving)
        self.box = (interval(*width),)
        self.asked = []

    def _proof(self, method, cell):
        self.asked.append((method, cell))
        cost = self.costs[method]
        size = size_of(cell)
        return None if cost is None else CellProof(texts(cell), repr(cost * size))

    def peak(self, cell):
        return self._proof("peak", cell)

    def vertices(self, cell):
        return self._proof("vertices", cell)


def test_bounds_of_the_whole_box_and_of_cells():
    prover = Prover()
    found = bound_ranges(prover, cells=True)
    assert float(found.peak.bound) == 2.75 and float(found.vertices.bound) == 5.5
    assert found.bound == max(float(p.bound) for p in found.cells) < 1
    assert cells_fill([numbers(p.cell) for p in found.cells], prover.box)
    assert all(float(p.bound) == size_of(numbers(p.cell)) for p in found.cells)
    assert found.best == found.cells and found.certified == found.bound


@pytest.mark.parametrize(
    "options",
    [
        {"cells": False},
        {"cells": True, "effort": "fast"},
        {"cells": True, "box": (interval(2, 2),)},
    ],
)
def test_no_cells_where_none_are_wanted(options):
    prover = Prover()
    found = bound_ranges(prover, **options)
    assert found.cells == () and len(prover.asked) == 2
    assert found.best == (found.peak,) and found.bound == float(found.peak.bound)
    worse = bound_ranges(Prover(peak=5.0), **options)
    assert worse.best == (worse.vertices,)
    nothing = bound_ranges(Prover(peak=None, vertices=None), **options)
    assert nothing.best == () and nothing.bound == nothing.certified == math.inf


def test_one_constant_that_is_known_leaves_the_others_to_be_cut():
    found = bound_ranges(Prover(), cells=True, box=(interval(1, 3), interval(2, 2)))
    assert len(found.cells) > 1 and found.bound < 1
    known = bound_ranges(Prover(moving=1), cells=True, box=(interval(2, 2), interval(-1, 1)))
    assert known.cells == ()  # what is left is a slope, which is never cut


def test_a_search_ends_with_what_is_enough():
    prover = Prover()
    found = bound_ranges(prover, cells=True, enough=2.75)
    assert found.vertices is None and len(prover.asked) == 1
    prover = Prover(peak=3.0, vertices=1.0)
    found = bound_ranges(prover, cells=True, enough=2.75)
    assert found.cells == () and len(prover.asked) == 2
    few = bound_ranges(Prover(), cells=True, enough=1.8)
    assert len(few.cells) == 2 and few.bound == 1.75


def test_the_worst_cells_are_tried_by_the_other_method():
    found = bound_ranges(Prover(peak=1.0, vertices=0.75), cells=True)
    alone = bound_ranges(Prover(), cells=True)
    assert found.bound < alone.bound and len(found.cells) == len(alone.cells)
    other = [p for p in found.cells if float(p.bound) < size_of(numbers(p.cell))]
    assert 1 <= len(other) <= 8
    worst = sorted(alone.cells, key=lambda p: float(p.bound))[-1]
    assert worst.cell in {p.cell for p in other}
    same = bound_ranges(Prover(peak=1.0, vertices=1.0), cells=True)
    assert same.cells == alone.cells
    enough = Prover(peak=1.0, vertices=0.75)
    bound_ranges(enough, cells=True, enough=1.8)
    assert [method for method, _ in enough.asked] == ["peak", "vertices", "peak", "peak"]


def test_cells_by_quadratic_functions_where_peak_gains_say_nothing():
    adaptive = Prover(peak=None, vertices=2.0)
    adaptive.by_peak_gains = False
    found = bound_ranges(adaptive, cells=True)
    assert found.peak is None and {m for m, _ in adaptive.asked} == {"vertices"}
    assert 2 <= len(found.cells) <= 16
    many = Prover(peak=None, vertices=2.0)
    many.by_peak_gains = False
    assert len(found.cells) <= len(bound_ranges(many, cells=True, effort="high").cells) <= 64
    robust = Prover(peak=None, vertices=2.0)
    assert bound_ranges(robust, cells=True).cells == found.cells
    nothing = bound_ranges(Prover(peak=None, vertices=None), cells=True)
    assert nothing.cells == () and nothing.best == ()


def test_progress_of_the_cells():
    told = []
    found = bound_ranges(Prover(), cells=True, progress=lambda *args: told.append(args))
    counts = [count for count, _, _ in told]
    assert counts == list(range(counts[0], counts[0] + len(counts))) and counts[-1] == len(
        found.cells
    )
    bounds = [bound for _, _, bound in told]
    assert bounds == sorted(bounds, reverse=True) and {total for _, total, _ in told} == {None}


def test_the_best_of_what_was_proven():
    proofs = [CellProof((), bound) for bound in ("3", "2", "1", "2.5")]
    bounds = RangeBounds(proofs[0], proofs[1], (proofs[2], proofs[3]))
    assert bounds.best == (proofs[1],) and bounds.bound == 2
    assert RangeBounds(proofs[0], None, (proofs[2], proofs[3])).bound == 2.5
    assert RangeBounds(None, None, ()).best == ()
    third = RangeBounds(CellProof((), "0.1"), None)
    assert third.certified >= Fraction(1, 10) and third.certified - 0.1 < 1e-16


# proofs of cells


@pytest.fixture(scope="module")
def small():
    system = certrack.loads(VARIANTS["small"])
    return system, RangeProver(system)


def test_cells_are_checked_one_by_one(small):
    system, prover = small
    (low, high), middle = prover.box[0], exact("21/20")
    cells = [prover.peak(((low, middle),)), prover.peak(((middle, high),))]
    bound = max((cell.bound for cell in cells), key=float)
    assert check_cells(system, cells, bound) == ""
    assert check_cells(system, cells, "9") == ""
    assert "smaller than that of a cell" in check_cells(system, cells, "0.000001")
    assert "do not cover" in check_cells(system, cells[:1], bound)
    assert "do not cover" in check_cells(system, [], bound)
    wide = replace(cells[0], cell=(*cells[0].cell, ("0", "1")))
    assert "one interval for each range" in check_cells(system, [wide, cells[1]], bound)
    less = [replace(cell, bound=str(float(cell.bound) * 0.9)) for cell in cells]
    assert "smaller than the peak gains give" in check_cells(system, less, bound)
    largest = peak_bound(prover.loop, prover.coefficients, ((low, middle),)).bound
    for text, holds in ((largest, True), (math.nextafter(largest, 0), False)):
        exactly = replace(cells[0], bound=f"{Decimal(text):f}")  # all digits of the float
        assert (prover.check(exactly) == "") == holds
    assert "more than" in check_cells(system, cells * 513, bound)


def test_points_of_a_cell_share_their_function(small):
    _, prover = small
    proof = prover.vertices(prover.box)
    assert prover.check(proof) == "" and len(proof.points) > 1
    other = replace(proof.points[1], alpha="0.001")
    mixed = replace(proof, points=(proof.points[0], other, *proof.points[2:]))
    assert "do not share" in prover.check(mixed)
    assert "one stage for each point" in prover.check(replace(proof, points=proof.points[1:]))
    wrong = replace(proof.points[-1], nu=tuple("0" for _ in proof.points[-1].nu))
    assert prover.check(replace(proof, points=(*proof.points[:-1], wrong))) != ""
    assert "do not share" in prover.check(replace(proof, bound="0.001"))
    assert prover.holds(prover.box) and prover.promises(prover.box)
    far = ((exact("0.001"), exact("900")),)
    assert not prover.holds(far) and not prover.promises(far)
    assert prover.peak(far) is None and prover.vertices(far) is None


def test_a_cell_with_more_points_than_a_proof_has_is_proven_at_its_centre(small, monkeypatch):
    """One stage, checked as those of points are; as many points as a proof has are still points."""
    _, prover = small
    count = prover.loop.entries.count
    monkeypatch.setattr("certrack.certificates.ranges.proofs.MAX_HULL_POINTS", count)
    points = prover.vertices(prover.box)
    assert len(prover.problems(prover.box)) == len(points.points) > 1
    monkeypatch.setattr("certrack.certificates.ranges.proofs.MAX_HULL_POINTS", count - 1)
    assert len(prover.problems(prover.box)) == 1
    proof = prover.vertices(prover.box)
    (stage,) = proof.points
    assert prover.check(proof) == ""
    assert "one at its centre" in prover.check(points)
    assert "one at its centre" in prover.check(replace(proof, points=(stage, stage)))
    assert "do not share" in prover.check(replace(proof, bound="0.001"))
    lower = f"{float(proof.bound) * 0.99:.9g}"
    assert prover.check(replace(proof, bound=lower, points=(replace(stage, bound=lower),)))
    for i in range(len(stage.lam)):  # each function of the constants needs its multiplier
        lam = tuple("0" if j == i else text for j, text in enumerate(stage.lam))
        assert prover.check(replace(proof, points=(replace(stage, lam=lam),)))


OFFSET = {"offset": VARIANTS["growth"].replace("d*tanh(x1)", "d")}


@pytest.mark.parametrize("name", ["offset", "small", "growth", "weights", "input gain and theta"])
def test_the_problem_at_a_point_is_the_loop_there(name):
    """e' = A x' - B Y' of its matrix over (x, Y', 1) at each point, the constant included."""
    prover = RangeProver(certrack.loads((VARIANTS | OFFSET)[name]))
    loop, rng = prover.loop, np.random.default_rng(5)
    c, problems = loop.coordinates, prover.problems(prover.box)
    A, B = c.A.astype(float), c.B.astype(float)
    sizes, acts = np.array([*map(float, loop.Y), 1.0]), False
    for values, problem in zip(loop.entries.points(prover.box), problems, strict=True):
        matrix, _ = loop.unpacked(values)
        acts |= bool(matrix[:, -1].any())
        assert len(sizes) - 1 in problem.derivatives or not matrix[:, -1].any()
        floats = problem.in_floats()
        e, y = rng.normal(size=loop.n), rng.uniform(-1, 1, len(sizes))
        y[-1] = 1.0
        Y = y * sizes
        whole = np.concatenate([np.linalg.solve(A, e + B @ Y[: c.q + 1]), Y])
        expected = A @ (matrix.astype(float) @ whole) - B @ Y[1 : c.q + 2]
        found = floats.M @ e + floats.Uy @ y[list(problem.derivatives)]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert acts == (name == "offset")


@pytest.mark.parametrize("name", ["offset", "small", "growth", "weights", "input gain and theta"])
def test_the_problem_at_the_centre_has_an_input_for_each_function(name):
    """q_k of the problem = C_k x + E_k (Y', 1); e' and x are those of the centre, at any x, Y."""
    prover = RangeProver(certrack.loads((VARIANTS | OFFSET)[name]))
    loop, channels = prover.loop, prover.coefficients.over(prover.box)
    problem = prover._problems.at_centre(prover.coefficients, prover.box, None)
    floats, c, rng = problem.in_floats(), loop.coordinates, np.random.default_rng(3)
    n, count = loop.n, len(channels.rows)
    assert problem.counts[0] == len(loop.uncertain.a) + count
    assert len(problem.selections) == problem.counts[0]
    A, B, rows, columns, centre = (
        part.astype(float) for part in (c.A, c.B, channels.rows, channels.columns, channels.centre)
    )
    sizes = np.array([*map(float, loop.Y), 1.0])
    for _ in range(3):
        e, y = rng.normal(size=n), rng.uniform(-1, 1, len(sizes))
        Y = y * sizes
        Y[-1] = y[-1] = 1.0
        x = np.linalg.solve(A, e + B @ Y[: c.q + 1])
        acting = y[list(problem.derivatives)]
        np.testing.assert_allclose(floats.Xe @ e + floats.Xy @ acting, x, rtol=1e-9, atol=1e-12)
        whole = np.concatenate([x, Y])
        for k, (S, T) in enumerate(problem.selections[-count:]):
            assert S.shape == (1, n) and T.shape == (1, len(problem.derivatives))
            q = S.astype(float) @ x + T.astype(float) @ acting
            assert q == pytest.approx(rows[k] @ whole, rel=1e-9, abs=1e-12)
        at_rest = floats.M @ e + floats.Uy @ acting
        expected = A @ (centre @ whole) - B @ Y[1 : c.q + 2]
        np.testing.assert_allclose(at_rest, expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(floats.Ua[:, -count:], A @ columns, rtol=1e-12, atol=1e-12)


def test_peak_gains_prove_nothing_with_estimates():
    prover = RangeProver(certrack.loads(VARIANTS["adaptive"]))
    assert not prover.by_peak_gains
    assert "estimates in the loop" in prover.check(CellProof(texts(prover.box), "9"))
    law = prover._leakage(prover.box)
    k = names(prover.loop).index("k")
    low, high = (end / 10 for end in prover.box[k])
    assert law.theta_box == ((low, high),)
    m = names(prover.loop).index("m")
    inverse = {1 / end for end in prover.box[m]}
    assert set(law.gains) == inverse
    with pytest.raises(NoCertificate, match="may vanish"):
        prover._leakage(with_range(prover.loop, m, exact(-1), exact(1)))


def test_cells_that_fill_a_box():
    def box(*ends):
        return tuple(interval(*pair) for pair in ends)

    whole = box((0, 2), (0, 2))
    quarters = [box((a, a + 1), (b, b + 1)) for a in (0, 1) for b in (0, 1)]
    assert cells_fill(quarters, whole) and cells_fill([whole], whole)
    for k in range(4):
        assert not cells_fill(quarters[:k] + quarters[k + 1 :], whole)
    assert cells_fill([box((-1, 1), (-1, 3)), box((1, 5), (0, 2))], whole)
    assert not cells_fill([box((0, 1), (0, 2)), box((exact("1.001"), 2), (0, 2))], whole)
    assert not cells_fill([box((0, 1), (0, 2)), box((1, 2), (0, exact("1.999")))], whole)
    assert not cells_fill([], whole)
    brick = [box((0, 1), (0, 1)), box((0, 1), (1, 2)), box((1, 2), (0, exact("0.5")))]
    full = [*brick, box((1, 2), (exact("0.5"), 2))]
    assert cells_fill(full, whole)
    beside = [box((2, 4), (0, 2)), box((-2, 0), (0, 2)), box((0, 2), (2, 3)), box((0, 2), (-1, 0))]
    for cells in (quarters, full):  # in any order, and whatever lies beside the box
        for order in itertools.permutations(cells):
            assert cells_fill(order, whole)
            assert not cells_fill(order[1:], whole)
        for other in beside:
            assert cells_fill([other, *cells], whole)
            assert not cells_fill([other, *cells[1:]], whole)
        assert cells_fill([*beside, *cells], whole)
    assert not cells_fill(beside, whole)


def test_texts_of_cells_are_fractions():
    cell = (interval("1/3", "2"), interval("-7/5", "0"))
    assert texts(cell) == (("1/3", "2"), ("-7/5", "0")) and numbers(texts(cell)) == cell
    assert numbers((("0.25", "1e1"),)) == (interval("1/4", "10"),)


# how far ranges may grow


def searched(limit, **options):
    """The edge of what holds up to a limit, and the scales that were tried."""
    tried = []

    def find(scale):
        tried.append(float(scale))
        return "beyond" if tried[-1] > limit else tried[-1]

    return largest_scale(find, **options), tried


@pytest.mark.parametrize("limit", [1e-5, 0.0625, 0.1, 0.9, 1.0, 1.7, 150.0, 3e6])
@pytest.mark.parametrize("known", [None, 1.0])
def test_the_edge_of_what_holds_is_below_it_and_near(limit, known):
    edge, tried = searched(limit, known=known if limit >= 1 else None)
    assert limit / 1.0011 <= float(edge.scale) <= limit and not edge.unlimited
    assert edge.result == float(edge.scale) and edge.reason == "beyond"
    assert (1.0 in tried) == (known is None or limit < 1)
    assert all(len(f"{scale:.12f}".strip("0.").replace(".", "")) <= 5 for scale in tried)
    coarse, fewer = searched(limit, known=known if limit >= 1 else None, accuracy=0.2)
    assert limit / 1.21 <= float(coarse.scale) <= limit and len(fewer) < len(tried)


def test_scales_fall_faster_and_faster_until_one_holds():
    assert searched(0.1)[1][:3] == [1.0, 0.25, 0.0625]
    assert searched(0.01, fall=1.5)[1][:5] == [1.0, 0.66666, 0.29629, 0.074074, 0.018518]
    assert searched(0.5, fall=1.002, begin=0.8)[1][:4] == [0.8, 0.7984, 0.79521, 0.78888]
    edge, tried = searched(0.0)
    assert edge == Edge("0", None, "beyond") and tried == [
        pytest.approx(0.25**k, rel=1e-4) for k in range(10)
    ]


def test_scales_rise_until_nothing_holds_or_nobody_asks_for_more():
    edge, tried = searched(math.inf)
    assert edge == Edge("1000000000", 1e9, "", unlimited=True)
    assert tried == [1, 2, 4, 8, 16, 32, 64, 128, 1e9]
    edge, tried = searched(math.inf, known=3.0, begin=3.0)
    assert edge.unlimited and edge.result == 1e9
    assert tried == [6, 12, 24, 48, 96, 192, 384, 1e9]
    assert searched(math.inf, begin=2e9)[0].unlimited


class Holding:
    """A prover of FIRST_ORDER whose cells hold up to a width."""

    by_peak_gains = True

    def __init__(self, widest, promised=None):
        self.loop = first_order()
        self.widest, self.promised = widest, promised or widest
        self.asked = 0

    def holds(self, cell):
        self.asked += 1
        return float(cell[0][1] - cell[0][0]) <= self.widest

    def promises(self, cell):
        return float(cell[0][1] - cell[0][0]) <= self.promised


@pytest.mark.parametrize(("widest", "scale"), [(0.3, 0.3), (1.0, 1.0), (2.7, 2.7)])
def test_ranges_may_grow_until_nothing_holds(widest, scale):
    found = critical_ranges(Holding(widest), cells=False, known=False)
    assert scale / 1.02 <= found.scale <= scale and found.reason == NO_PROOF
    more = critical_ranges(Holding(widest), cells=True, known=False)
    assert more.scale > 2 * found.scale
    assert critical_ranges(Holding(1e-12), cells=False, known=False).scale == 0


def test_a_search_tells_how_many_scales_were_tried():
    told = []
    critical_ranges(Holding(0.3), cells=False, known=False, progress=lambda *all: told.append(all))
    assert len(told) > 5 and told == [(k, None, None) for k in range(len(told))]


@pytest.mark.parametrize("uncertainty", ["tau = [2]\ngamma = [0.4]\nbeta = [0.3]"])
def test_what_the_program_of_a_hull_finds_is_what_is_proven(uncertainty):
    """Its Delta is the largest cost of all points, and each has multipliers of its own."""
    loop = first_order(uncertainty, signal="1.5*sin(t)")
    exact_problems = ProblemMaker(loop).at_points(loop.box, None)
    program = VertexProgram([problem.in_floats() for problem in exact_problems])
    solution = best_solution(program)
    costs = [float(nu.sum() + k.sum()) for _, nu, k in solution.multipliers]
    assert len(costs) == 2 and costs[0] != costs[1]
    assert solution.delta == pytest.approx(max(costs), rel=1e-5)
    stages = prove_vertices(exact_problems, solution)
    bounds = {float(stage.bound) for stage in stages}
    assert len(stages) == 2 and len(bounds) == 1
    assert solution.bound == pytest.approx(bounds.pop(), rel=1e-4)
    assert not program.solve(1.001 * program.fastest)


def test_a_proof_at_scale_1_is_not_lost():
    assert critical_ranges(Holding(0.5, 4.0), cells=False, known=True).scale == 1.0
    assert critical_ranges(Holding(3.0, 4.0), cells=False, known=True).scale >= 3 / 1.03
    assert critical_ranges(Holding(0.5, 4.0), cells=False, known=False).scale <= 0.5
    assert 1.45 < critical_ranges(Holding(1.5, 4.0), cells=False, known=True).scale <= 1.5


def test_a_search_is_limited_by_stability_and_by_cells():
    search = _Search(Holding(1e9), cells=False)
    held = search.parts(lambda cell: True, exact(2))
    assert held == ((interval("1.5", "3.5"),),)
    assert search.parts(lambda cell: True, exact(4)) == ((interval("0.5", "4.5"),),)
    with pytest.raises(NoCertificate, match=NO_PROOF):  # -a + 1 - 5.5 = 0 at a = -4.5
        search.parts(lambda cell: True, exact(14))
    assert search.parts(lambda cell: True, exact("13.9"))
    cut = _Search(Holding(1.0), cells=True)
    parts = cut.parts(cut._prover.holds, exact(2))
    assert len(parts) == 2 and cells_fill(parts, scaled(cut._prover.loop, exact(2)))
    with pytest.raises(NoCertificate, match=NO_PROOF):
        _Search(Holding(1e-9), cells=True).parts(Holding(1e-9).holds, exact(1))


@pytest.mark.parametrize("count", [2, 4, 8])
def test_a_search_has_so_many_cells_at_most(monkeypatch, count):
    monkeypatch.setattr(strength, "PROVABLE_CELLS", count)
    prover = Holding(1.0 / count)
    assert len(_Search(prover, cells=True).parts(prover.holds, exact(1))) == count
    monkeypatch.setattr(strength, "PROVABLE_CELLS", count - 1)
    with pytest.raises(NoCertificate, match=NO_PROOF):
        _Search(prover, cells=True).parts(prover.holds, exact(1))


def test_forms_at_two_points_of_a_range():
    loop = first_order()
    for a, rate in (("2", "0.5"), ("3", "-0.5")):
        form = error_form(loop, loop.entries.at([exact(a)]))
        assert form.M.tolist() == [[exact(rate) - 7]]
        assert form.W.tolist() == [[exact(rate), 0]]
    assert Proof("1", (), (), (), (), "1").shift == "0"


def test_what_takes_longer_is_made_where_it_is_asked_for():
    for verb, options in (
        (certify_ranges, ("details",)),
        (certify_implemented, ("from_start", "margins")),
        (ranged_loop, ("sectors",)),
        (RangeProver, ("sectors",)),
    ):
        assert all(signature(verb).parameters[name].default is False for name in options), verb
    assert signature(certify_ranges).parameters["effort"].default == "default"
    assert signature(bound_ranges).parameters["enough"].default == 0  # goes on as far as it can

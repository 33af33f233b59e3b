"""The algebra below the proofs for ranges: rational functions, cells, edges, sectors, periods."""

import itertools
import math
import re
from fractions import Fraction
from types import SimpleNamespace

import flint
import numpy as np
import pytest
import sympy

import certrack
from certrack.certificates.arithmetic import as_sympy
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.proof import LEFT, MAX_DOUBLINGS, periods_needed
from certrack.certificates.ranges import rational
from certrack.certificates.ranges.boxes import names
from certrack.certificates.ranges.cells import MAX_CORNERS, coarsest, corners_of, divided, halved
from certrack.certificates.ranges.coefficients import Coefficients, _factors
from certrack.certificates.ranges.edges import LARGEST_SCALE, largest_scale
from certrack.certificates.ranges.estimates import estimated_peak_gains
from certrack.certificates.ranges.formulas import untrue_formulas
from certrack.certificates.ranges.kernels import peak_gains
from certrack.certificates.ranges.loop import error_form, ranged_loop
from certrack.certificates.ranges.peak import (
    FIXED_POINT_ROUNDING,
    LEAST,
    UNBOUNDED,
    WIDENED,
    _bound,
    peak_bound,
)
from certrack.certificates.ranges.rational import RationalVector, _bernstein
from certrack.certificates.ranges.sectors import SECTORS, sector_of
from certrack.certificates.ranges.strength import stable_at_corners

p, q = sympy.symbols("p q")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (flint.fmpq(10**7000 + 1, 3), sympy.Rational(10**7000 + 1, 3)),
        (Fraction(-(10**5000), 7), sympy.Rational(-(10**5000), 7)),
        (flint.fmpq(-2), sympy.Integer(-2)),
        (0.1, sympy.Rational(1, 10)),
        (3, sympy.Integer(3)),
    ],
    ids=["long", "long fraction", "integer", "decimal", "int"],
)
def test_rationals_of_any_length_are_those_of_sympy(value, expected):
    """Python refuses to read or write integers of more than 4300 digits."""
    assert as_sympy(value) == expected


def exact(value):
    value = Fraction(str(value))
    return flint.fmpq(value.numerator, value.denominator)


@pytest.mark.parametrize(
    "texts",
    [["p", "1/p"], ["(1 + p*q)/(2 + p)", "q**2", "3"], ["p**2*q/(1 + q)**2", "p/q - 1/3"]],
)
def test_values_of_rational_functions_are_exact_and_inside_their_hull(texts):
    entries = [sympy.sympify(text) for text in texts]
    vector = RationalVector.of(entries, [p, q])
    box = [(exact("1/2"), exact("3")), (exact("2"), exact("7/3"))]
    low, high = vector.ends(box)
    for u, v in itertools.product(range(5), repeat=2):
        point = [a + (b - a) * exact(Fraction(k, 4)) for (a, b), k in zip(box, (u, v), strict=True)]
        values = {s: sympy.Rational(int(x.p), int(x.q)) for s, x in zip((p, q), point, strict=True)}
        found = vector.at(point)
        assert [str(x) for x in found] == [str(e.subs(values)) for e in entries]
        assert (low <= found).all() and (found <= high).all()
    corners = [vector.at(corner) for corner in itertools.product(*box)]
    points = [tuple(map(str, point)) for point in vector.points(box)]
    assert {tuple(map(str, corner)) for corner in corners} <= set(points)


def test_hulls_shrink_to_the_values_with_the_square_of_the_box():
    vector = RationalVector.of([p**2 / (1 + p) - p**3 / 7], [p])

    def excess(width):
        low, high = (end[0] for end in vector.ends([(exact(1), exact(1) + exact(width))]))
        values = [
            vector.at([exact(1) + exact(width) * exact(Fraction(k, 64))])[0] for k in range(65)
        ]
        assert low <= min(values) and max(values) <= high
        return float(high - low - (max(values) - min(values)))

    assert excess("1/2") <= 0.02
    assert excess("1/8") <= excess("1/2") / 3


def test_one_value_has_one_point_and_no_constant_none_to_choose():
    vector = RationalVector.of([p**2, p * q], [p, q])
    assert len(vector.points([(exact(3), exact(3)), (exact(1), exact(2))])) == 2
    assert len(vector.points([(exact(3), exact(3)), (exact(2), exact(2))])) == 1
    assert vector.points([(exact(3), exact(3)), (exact(2), exact(2))])[0].tolist() == [9, 6]
    fixed = RationalVector.of([sympy.Rational(2, 3), sympy.Integer(5)], [])
    assert fixed.at([]).tolist() == [exact("2/3"), 5]
    assert [point.tolist() for point in fixed.points([])] == [[exact("2/3"), 5]]


def test_hulls_are_refused_where_a_denominator_vanishes_or_points_are_too_many(monkeypatch):
    for text, low, high in (("1/p", 0, 1), ("1/p", -1, 0), ("1/(p - 2)", 1, 3)):
        with pytest.raises(NoCertificate, match="may vanish"):
            RationalVector.of([sympy.sympify(text)], [p]).points([(exact(low), exact(high))])
    with pytest.raises(NoCertificate, match="vanishes"):
        RationalVector.of([1 / p], [p]).at([exact(0)])
    with pytest.raises(NoCertificate, match="no rational function"):
        RationalVector.of([sympy.sin(p)], [p])
    assert RationalVector.of([1 / p], [p]).points([(exact(-2), exact(-1))])
    monkeypatch.setattr(rational, "MAX_HULL_POINTS", 6)
    for degree in (4, 5):
        vector = RationalVector.of([p**degree], [p])
        assert len(vector.points([(exact(0), exact(1))])) == degree + 1
    with pytest.raises(NoCertificate, match="hull of 7 points"):
        RationalVector.of([p**6], [p]).points([(exact(0), exact(1))])


@pytest.mark.parametrize("edge", [4e-6, 1e-3, 0.2, 0.99, 1.0, 1.3, 3.9, 77.0, 1e4, 3e8])
@pytest.mark.parametrize("begin", [1.0, 0.125])
def test_the_edge_of_what_is_found_is_found(edge, begin):
    asked = []

    def find(scale):
        asked.append(float(scale))
        return ("found", float(scale)) if float(scale) <= edge else f"not at {float(scale)}"

    found = largest_scale(find, begin=begin, accuracy=1e-3)
    assert edge / (1 + 1.2e-3) <= float(found.scale) <= edge
    assert found.result == ("found", float(found.scale))
    assert found.reason == f"not at {min(s for s in asked if s > edge)}"
    assert not found.unlimited
    assert len(asked) <= 60
    if edge >= begin:
        again = largest_scale(find, begin=begin, known="known", accuracy=1e-3)
        assert edge / (1 + 1.2e-3) <= float(again.scale) <= edge


def test_edges_at_the_ends_of_the_search():
    nothing = largest_scale(lambda scale: "never")
    assert (nothing.scale, nothing.result, nothing.reason) == ("0", None, "never")
    always = largest_scale(lambda scale: float(scale))
    assert always.unlimited and float(always.scale) == always.result == LARGEST_SCALE
    known = largest_scale(lambda scale: "no more", known="known")
    assert (float(known.scale), known.result, known.reason) == (1.0, "known", "no more")


def test_corners_are_each_listed_once():
    assert list(corners_of(((1, 2), (3, 3), (4, 5)))) == list(
        itertools.product((1, 2), (3,), (4, 5))
    )
    assert len(list(corners_of(((0, 1),) * 7))) == MAX_CORNERS
    assert list(corners_of(())) == [()]


def test_cells_are_cut_where_they_are_widest_and_fill_the_box():
    assert halved(((0, 1), (0, 4)), (1, 8)) == (((0, 0.5), (0, 4)), ((0.5, 1), (0, 4)))
    assert halved(((0, 1), (0, 4)), (4, 8)) == (((0, 1), (0, 2)), ((0, 1), (2, 4)))
    assert halved(((0, 1), (0, 4)), (4, 8), moving=1) == (((0, 0.5), (0, 4)), ((0.5, 1), (0, 4)))
    assert halved(((2, 2), (0, 4)), (0, 4)) == (((2, 2), (0, 2)), ((2, 2), (2, 4)))


def largest(cell):
    (a, b), (c, d) = cell
    return max(abs(v) for v in (a, b)) + (d - c) ** 2


def test_the_worst_cells_are_cut_as_long_as_it_pays():
    box, reports = ((0.0, 2.0), (0.0, 1.0)), []
    cells = divided(box, largest, 12, 0.0, lambda found: reports.append(len(found)))
    assert len(cells) == 12 and reports == list(range(2, 13))
    assert sum((b - a) * (d - c) for (a, b), (c, d) in cells) == 2
    assert max(map(largest, cells)) < largest(box)
    for u, v in itertools.product(np.linspace(0, 2, 9), np.linspace(0, 1, 9)):
        assert any(a <= u <= b and c <= v <= d for (a, b), (c, d) in cells)
    still = divided(box, largest, 12, 0.0, reports.append, moving=1)
    assert all(second == (0.0, 1.0) for _, second in still)
    assert divided(box, largest, 12, 0.0, reports.append, enough=3.0) == [box]
    few = divided(box, largest, 12, 0.0, reports.append, enough=2.5)
    assert max(map(largest, few)) <= 2.5 and len(few) < 12
    assert len(divided(box, lambda cell: 1.0, 12, 0.01, reports.append)) == 3
    assert len(divided(box, lambda cell: float("inf"), 5, 0.01, reports.append)) == 5


@pytest.mark.parametrize("part", [0.02, 0.49])
def test_a_cut_counts_with_the_one_beside_it(part):
    """Of the two halves of a box each must be cut before the bound falls."""

    def width(cell):
        return cell[0][1] - cell[0][0]

    cells = divided(((0.0, 1.0),), width, 16, part, lambda _: None)
    assert set(map(width, cells)) == {1 / 16}
    assert len(divided(((0.0, 1.0),), width, 16, 0.51, lambda _: None)) == 3


@pytest.mark.parametrize("function", list(SECTORS))
@pytest.mark.parametrize("scale", [1, 3, sympy.Rational(1, 2)])
def test_sectors_are_as_narrow_as_the_function_allows(function, scale):
    x1, x2 = sympy.symbols("x1 x2")
    j, low, high = sector_of(function(scale * x2), [x1, x2])
    z = np.linspace(1e-3, 3000, 2_000_001)
    with np.errstate(all="ignore"):
        slopes = sympy.lambdify(x2, function(scale * x2) / x2, "numpy")(z)
    assert j == 1
    assert float(low) <= slopes.min() <= float(low) + 3.1e-3
    assert float(high) - 3.1e-3 <= slopes.max() <= float(high)


def test_terms_without_a_sector():
    x1, x2 = sympy.symbols("x1 x2", real=True)
    assert sector_of(sympy.sin(x1 + x2), [x1, x2]) is None
    assert sector_of(sympy.sin(sympy.pi * x1), [x1, x2]) is None
    assert sector_of(x1**2, [x1, x2]) is None
    assert sector_of(x1 * sympy.cos(x2), [x1, x2])[:1] == (0,)
    j, low, high = sector_of(sympy.Abs(x2) * (2 + sympy.sin(x1)), [x1, x2])
    assert (j, -low) == (1, high) and 3 <= float(high) <= 3.0001


def test_the_bound_of_a_fixed_point_is_above_it_and_close():
    """v = c + G v with a gain below 1, and none where it is 1 or more."""
    c, G = np.array([1.0, 2.0, 0.5]), np.array([[0, 0.3, 2.0], [0, 0.2, 0.1], [0, 0.4, 0.5]])
    fixed = np.linalg.solve(np.eye(3) - G, c)
    found = _bound(lambda v: c + G @ v, 3)
    assert fixed[0] <= found <= fixed[0] * (1 + 1e-6)
    for gain in (1.0, 1.5):
        with pytest.raises(NoCertificate, match="not below 1"):
            _bound(lambda v, gain=gain: np.minimum(1.0 + gain * v, UNBOUNDED), 2)
    assert _bound(lambda v: 0 * v, 2) >= 0


def test_a_fixed_point_must_be_above_its_image_not_at_it():
    def at_it(v):
        """1 until that stands still; then what is as large as v with its rounding."""
        if v.max() <= 1:
            return np.ones(2)
        below = v / (1 + FIXED_POINT_ROUNDING)
        steps = np.array([below, np.nextafter(below, 0), np.nextafter(below, 9)])
        return steps[np.argmin(np.abs(steps * (1 + FIXED_POINT_ROUNDING) - v), axis=0), [0, 1]]

    top = np.full(2, 1 + WIDENED) + LEAST
    assert (at_it(top) * (1 + FIXED_POINT_ROUNDING) == top).all()
    with pytest.raises(NoCertificate, match="not below 1"):
        _bound(at_it, 2)
    assert _bound(lambda v: np.ones(2), 2) == pytest.approx(1.0)


@pytest.mark.parametrize("degree", [0, 1, 2, 4])
@pytest.mark.parametrize(("low", "high"), [("1", "3"), ("-2", "0.5"), ("0", "1")])
def test_bernstein_coefficients_give_the_powers(degree, low, high):
    low, high = exact(low), exact(high)
    change = _bernstein(degree, low, high)
    for t in map(exact, ("0", "0.25", "0.7", "1")):
        basis = [math.comb(degree, i) * t**i * (1 - t) ** (degree - i) for i in range(degree + 1)]
        for power in range(degree + 1):
            value = sum(b * c for b, c in zip(basis, change[:, power], strict=True))
            assert value == (low + (high - low) * t) ** power


def test_a_matrix_is_the_product_of_its_factors():
    rng = np.random.default_rng(1)
    for rank in (1, 2, 3):
        left, right = rng.integers(-3, 4, (4, rank)), rng.integers(-3, 4, (rank, 6))
        matrix = np.vectorize(flint.fmpq, otypes=[object])(left @ right)
        columns, rows = _factors(matrix)
        assert (columns @ rows == matrix).all()
        assert columns.shape[1] == np.linalg.matrix_rank(left @ right)


@pytest.mark.parametrize("radius", ["0", "0.01", "0.5", "0.9", "0.999", "0.9999"])
def test_so_many_periods_are_summed_that_little_is_left(radius):
    def period(*entries):
        return SimpleNamespace(map=flint.arb_mat([[flint.arb(v)] for v in entries]))

    doublings = periods_needed(period(radius))
    left = float(radius) ** (2**doublings)
    assert left <= LEFT
    assert doublings == 1 or float(radius) ** (2 ** (doublings - 1)) > LEFT


def test_loops_that_do_not_forget_in_time_are_refused():
    for radius, message in (("1", "unstable"), ("1.5", "unstable"), ("0.9999999", "too slowly")):
        with pytest.raises(NoCertificate, match=message):
            periods_needed(SimpleNamespace(map=flint.arb_mat([[flint.arb(radius)]])))
    slow = 1 - 21 / 2**MAX_DOUBLINGS
    assert periods_needed(SimpleNamespace(map=flint.arb_mat([[slow]]))) == MAX_DOUBLINGS


def test_the_loop_of_a_first_order_plant_with_every_range():
    """x' = -a x + g u + theta x with u = (nu - theta_0 x)/g_0, nu = (a_0 - c) x + c y_d + y_d'."""
    system = certrack.loads(FIRST_ORDER)
    loop = ranged_loop(system)
    assert names(loop) == ("a", "input_gain", "theta[0]")
    for a, g, theta in itertools.product(("2", "3"), ("4", "5", "6"), ("0.5", "1.5")):
        named = {"a": a, "g": g, "t": theta}
        point = [
            exact(named[str(s).removeprefix("ranges.")[0].replace("i", "g")]) for s in loop.symbols
        ]
        form = error_form(loop, loop.entries.at(point))
        a, g, theta = exact(a), exact(g), exact(theta)
        ratio = g / 5
        rate = -a + theta + ratio * (exact("2.5") - 7 - 1)
        assert form.M.tolist() == [[rate]]
        assert form.W.tolist() == [[rate + ratio * 7, ratio - 1]]
        assert form.offset.tolist() == [0]


FIRST_ORDER = """
[plant]
states = ["x1"]
drift = "-a*x1"
regressor = ["x1"]
gain_sign = 1
input_gain = 5
theta = [1]
[plant.constants]
a = 2.5
[plant.ranges]
a = [2, 3]
input_gain = [4, 6]
theta = [[0.5, 1.5]]
[plant.uncertainty]
tau = [0]
gamma = [0]
beta = [0]
[truth]
input_gain = 5
theta = [1]
omega = [0]
[reference]
signal = "sin(t)"
[law]
kind = "robust"
c = [7]
[simulation]
x0 = [0]
duration = 1
"""


def test_a_centre_without_inverse_is_not_stable():
    """e' = -(a + 4.5) e + ...: zero in the middle of the range of a."""
    text = re.sub("input_gain = .4.*|theta = .\\[.*", "", FIRST_ORDER)
    system = certrack.loads(text.replace("a = [2, 3]", "a = [-12, 3]"))
    loop = ranged_loop(system)
    for gains_of in (peak_gains, estimated_peak_gains):
        with pytest.raises(NoCertificate, match="not stable"):
            peak_bound(loop, Coefficients(loop), loop.box, gains_of)


@pytest.mark.parametrize("M", [[[0]], [["-1/3", "1/3"], ["1/7", "-1/7"]], [["-4/3", "2"], [2, -3]]])
def test_what_has_no_inverse_has_no_peak_gain(M):
    matrix = np.array([[exact(v) for v in row] for row in M], dtype=object)
    one = 0 * matrix + np.eye(len(M), dtype=int)
    with pytest.raises(NoCertificate, match="not stable"):
        peak_gains(matrix, one, one)


@pytest.mark.parametrize("size", [1, 5])
def test_a_bounded_term_whose_coefficient_is_uncertain_acts_with_its_size(size):
    """e' = -7 e + (a - 2.5) size atan(x^3): the bound is (0.5 size pi/2)/7."""
    text = FIRST_ORDER.replace('"-a*x1"', f'"{size}*a*atan(x1**3)"')
    text = re.sub("input_gain = .4.*|theta = .\\[.*", "", text)
    loop = ranged_loop(certrack.loads(text))
    found = peak_bound(loop, Coefficients(loop), loop.box)
    exact_bound = 0.5 * size * np.pi / 2 / 7
    assert exact_bound <= found.bound <= exact_bound * (1 + 1e-6)


def test_a_truth_that_is_no_formula_of_the_ranges_is_named():
    fixed = re.sub("input_gain = .4.*|theta = .\\[.*", "", FIRST_ORDER)
    assert untrue_formulas(certrack.loads(FIRST_ORDER)) == []
    assert untrue_formulas(certrack.loads(fixed)) == []
    gain, theta = ("input_gain = 5\ntheta = [1]\nomega", "input_gain = {}\ntheta = [{}]\nomega")
    for values, expected in (((5.5, 1), ["input_gain"]), ((5, 1.5), ["theta[0]"])):
        changed = certrack.loads(fixed.replace(gain, theta.format(*values)))
        assert untrue_formulas(changed) == expected
        changed = certrack.loads(FIRST_ORDER.replace(gain, theta.format(*values)))
        assert untrue_formulas(changed) == []


def test_a_loop_on_the_edge_of_stability_is_not_stable_at_its_corners():
    """x' = (a - 7.5 ...) x: the rate is zero at one corner, then just below it."""
    prover = SimpleNamespace(loop=ranged_loop(certrack.loads(FIRST_ORDER)), by_peak_gains=True)
    rate = exact(5)  # -a + theta + g/5 (2.5 - 7 - 1) is zero for g = 5 (theta - a)/5.5
    edge = rate * (exact("0.5") - 2) / exact("5.5")
    for end, stable in (
        (edge, False),
        (edge - exact("1/100"), False),
        (edge + exact("1/100"), True),
    ):
        box = ((exact(2), exact(3)), (end, exact(6)), (exact("0.5"), exact("0.5")))
        assert stable_at_corners(prover, box) == stable
    prover.by_peak_gains = False
    assert stable_at_corners(prover, box)


def test_cells_are_cut_relative_to_the_width_of_the_box():
    """Not to the size of the constants: one between 10 and 11 is cut as one between 0 and 1 is."""
    box = ((0.0, 1.0), (10.0, 11.0))
    bounds = {}

    def bound(cell):
        bounds[cell] = max(float(high - low) for low, high in cell)
        return bounds[cell]

    cells = divided(box, bound, 4, 0.0, lambda _: None)
    quarters = [((a, a + 0.5), (b, b + 0.5)) for a in (0.0, 0.5) for b in (10.0, 10.5)]
    assert sorted(cells) == quarters
    assert sorted(coarsest(box, bounds, 0.5)) == quarters


def test_a_search_begins_with_the_cells_of_another():
    """A cell with no bound, or too large a one, is not asked for again."""
    asked = []

    def width(cell):
        asked.append(cell)
        return float(cell[0][1] - cell[0][0])

    box = ((0.0, 1.0),)
    divided(box, width, 8, 0.0, lambda _: None)
    bounds = {cell: width(cell) for cell in tuple(asked)}
    begin = coarsest(box, bounds, 0.25)
    assert sorted(begin) == [((k / 4, (k + 1) / 4),) for k in range(4)]
    assert sorted(coarsest(box, bounds, 0.0)) == [((k / 8, (k + 1) / 8),) for k in range(8)]
    assert coarsest(box, bounds | {box: math.inf}, math.inf) == [box]
    assert coarsest(box, {}, 0.25) == [box]
    asked.clear()
    assert divided(box, width, 8, 0.0, lambda _: None, enough=0.25, begin=begin) == begin
    assert box not in asked
    finer = divided(box, width, 8, 0.0, lambda _: None, enough=0.125, begin=begin)
    assert sorted(finer) == [((k / 8, (k + 1) / 8),) for k in range(8)]

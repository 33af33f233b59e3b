"""Bounds of outputs as a fixed point, regions, polytopes: with numbers that are made up."""

import itertools
from dataclasses import dataclass, replace
from fractions import Fraction
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from scipy.linalg import expm
from test_slow_signals import loop

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import fixed_point, rates_used
from certrack.certificates.implemented.drive import DRIVE_BITS
from certrack.certificates.implemented.fixed_point import (
    FIXED_POINT_MARGIN,
    SMALLEST_BOUND,
    OutputBounds,
    uncertain_size,
)
from certrack.certificates.implemented.float_image import FloatImage
from certrack.certificates.implemented.gains import output_gains
from certrack.certificates.implemented.lags import lag_gains
from certrack.certificates.implemented.period import Period
from certrack.certificates.implemented.polytope import Polytope, _cut, common, half_spaces
from certrack.certificates.implemented.rates_used import rates_unused
from certrack.certificates.implemented.region import region_of_runs, without_polytopes
from certrack.certificates.implemented.regional import (
    descend,
    in_the_long_run,
    largest_region,
    not_reached,
)
from certrack.certificates.implemented.timing import (
    TimedBounds,
    _crosses,
    _in_cell_pulse,
    _pulse_columns,
)
from certrack.certificates.region import IN_REGION, _within, is_only_in_region, while_within
from certrack.certificates.sampling import Points
from certrack.core.errors import InputError


def q(value):
    exact = Fraction(str(value))
    return flint.fmpq(exact.numerator, exact.denominator)


def balls(values):
    return np.vectorize(lambda v: flint.arb(q(v)), otypes=[object])(np.array(values, dtype=object))


def bound_of_w(gamma="0.5", weights=(3, 4), Delta=("0.1", "0.2"), beta="0.25", growing=None):
    numbers = {"gamma": q(gamma), "beta": q(beta), "growing": growing}
    return SimpleNamespace(weights=[q(v) for v in weights], Delta=[q(v) for v in Delta], **numbers)


def outputs(constant=(1, 2, 3, 4, 5, 6), x=None, u=None, w=None, **more):
    """Rows: two of e_1, one of each state, of u and of its steps."""
    uncertain = more.pop("uncertain", (bound_of_w(),))
    drive = SimpleNamespace(sized=2, uncertain=uncertain, mu=[q(2)], eta=q(3), Y=[q(0), q(10)])
    drive.jumps = (q(7), None)
    rows = np.arange(6)
    gains = SimpleNamespace(
        noise=np.array([[0.01], [0.02]] + [[0.0]] * 4),
        step=np.array([0.03, 0.04] + [0.0] * 4),
        sample=np.array([0.05, 0.06] + [0.0] * 4),
        first=np.array([0.001, 0.002] + [0.0] * 4),
        jump=np.array([0.003, 0.004] + [0.0] * 4),
    )
    return OutputBounds(
        outputs=np.array([0, 0, 1, 2, 3, 4]),
        constant=balls(constant),
        w=balls(np.zeros((6, 1)) if w is None else w),
        x=balls(np.zeros((6, 2)) if x is None else x),
        u=balls(0 * rows if u is None else u),
        drive=drive,
        gains=gains,
        sample=q("0.5"),
    )


W = [["0.1"], ["0.2"], ["0.01"], ["0.02"], ["0.03"], ["0.04"]]
X = [["0.5", "0.25"], ["0.125", 0], ["0.1", "0.05"], [0, "0.2"], ["0.3", 0], [0, 0]]
U = ["0.01", 0, "0.02", "0.03", 0, "0.1"]


def test_the_largest_w_of_a_box():
    assert float(uncertain_size(bound_of_w(), [1, 2])) == pytest.approx(
        0.5 * (9 + 64) ** 0.5 + 0.1 + 0.4 + 0.25
    )
    seen = []
    growing = SimpleNamespace(largest=lambda X, norm: seen.append((X, norm)) or "grown")
    assert uncertain_size(bound_of_w(growing=growing), [1, 1]) == "grown"
    assert [float(v) for v in seen[0][0]] == [1, 1] and float(seen[0][1]) == pytest.approx(5)


@pytest.mark.parametrize("lipschitz", [None, q("0.5")])
@pytest.mark.parametrize("jumps", [None, (q(9), q(1))])
@pytest.mark.parametrize("reference", [None, np.array([1e3, 16.0])])
def test_the_bounds_of_rows_from_their_gains(monkeypatch, lipschitz, jumps, reference):
    """Two rows, Y = (2, 1.5, 3), T = 1/4: what each input does, and what is added in a cell."""
    at_rest = {0: [q(5), q(4)], 1: [q(7), q(1)]}
    monkeypatch.setattr(fixed_point, "steady", lambda period, row: at_rest[row.output])
    drive = SimpleNamespace(
        Y=[q(2), q("1.5"), q(3)], mu=[q(4)], eta=q(6), T=q("0.25"), lipschitz=lipschitz, jumps=jumps
    )
    drive.uncertain = ("w",)
    gains = SimpleNamespace(
        r=np.array([0.5, 0.25]),
        first=np.array([2.0, 4.0]),
        noise=np.array([[0.75], [1.5]]),
        sample=np.array([8.0, 16.0]),
        step=np.array([0.125, 3.0]),
        w=np.array([[10.0], [11.0]]),
        jump=np.array([0.5, 0.75]),
    )
    cells = [
        SimpleNamespace(w=[q(20)], x=[q(21), q(22)], u=q(23), r=q(24)),
        SimpleNamespace(w=[q(30)], x=[q(31), q(32)], u=q(33), r=q(34)),
    ]
    rows = [
        SimpleNamespace(output=0, share=q(1), in_cell=cells[0]),
        SimpleNamespace(output=1, share=q("0.5"), in_cell=cells[1]),
    ]
    found = OutputBounds.of(SimpleNamespace(drive=drive), rows, gains, reference)
    sample = 3 if lipschitz is None else 0.25 / 2 * 0.5
    past = np.array([5 * 2 + 4 * 1.5 + 0.5 * 3, 7 * 2 + 1.5 + 0.25 * 3])
    past = past if reference is None else np.minimum(past, reference)
    expected = past + np.array([2 + 24, 4 + 17]) * 3 + np.array([0.75, 1.5]) * 4
    expected = expected + np.array([8, 16]) * sample + np.array([0.125, 3]) * 6
    expected = expected + (0 if jumps is None else np.array([0.5, 0.75]) * 9)
    assert [float(v) for v in found.constant] == pytest.approx(expected, rel=1e-14)
    assert [[float(v) for v in row] for row in found.w] == [[30], [26]]
    assert [[float(v) for v in row] for row in found.x] == [[21, 22], [15.5, 16]]
    assert [float(v) for v in found.u] == [23, 16.5] and found.sample == q(sample)
    assert found.outputs.tolist() == [0, 1] and found.rows == tuple(rows)


def test_the_image_has_the_largest_row_of_each_output():
    bounds = outputs(x=X, u=U, w=W)
    size = 0.5 * (9 + 64) ** 0.5 + 0.1 + 0.4 + 0.25
    rows = np.arange(1.0, 7.0) + np.array(X, dtype=float) @ [1, 2]
    rows += np.array(U, dtype=float) * 10 + np.array(W, dtype=float)[:, 0] * size
    expected = [max(rows[:2]), *rows[2:]]
    found = [float(v) for v in bounds.image([q(1), q(2)], q(10))]
    assert found == pytest.approx(expected) and len(found) == 5
    assert not bounds.is_regional
    for regional_growth in (False, True):
        growing = SimpleNamespace(is_global=not regional_growth)
        of = outputs(uncertain=(bound_of_w(), bound_of_w(growing=growing)))
        assert of.is_regional == regional_growth
    endless = outputs(constant=("1e400", 1, 1, 1, 1, 1))
    endless.constant[0] = flint.arb("nan")
    with pytest.raises(NoCertificate, match="range of floating point"):
        endless.image([q(1), q(1)], q(1))


def test_the_search_ends_a_little_above_the_fixed_point():
    bounds = outputs(x=X, u=U, w=W)
    states, u = bounds.search()
    v = np.zeros(3)
    for _ in range(400):
        size = 0.5 * np.hypot(3 * v[0], 4 * v[1]) + 0.1 * v[0] + 0.2 * v[1] + 0.25
        rows = np.arange(1.0, 7.0) + np.array(X, dtype=float) @ v[:2]
        rows += np.array(U, dtype=float) * v[2] + np.array(W, dtype=float)[:, 0] * size
        v = rows[2:5]
    assert [*states, u] == pytest.approx(v, rel=3 * FIXED_POINT_MARGIN)
    image = [float(value) for value in bounds.image(states, u)]
    assert (np.array(image[1:4]) < [*states, u]).all()
    nothing, still = outputs(constant=[0] * 6, uncertain=(bound_of_w(beta=0),)).search()
    assert nothing == [SMALLEST_BOUND] * 2 and still == SMALLEST_BOUND
    grown = SimpleNamespace(largest_float=lambda X, norm: 2.0 + norm)
    of = outputs(w=W, uncertain=(bound_of_w(growing=grown),))
    (first, second), _ = of.search()
    norm = np.hypot(3 * first, 4 * second)
    assert first == pytest.approx(3 + 0.01 * (2 + norm), rel=1e-5)
    alone = [[0, 0], [0, 0], ["2", 0], [0, 0], [0, 0], [0, 0]]  # leaves the floats, by itself
    for growing in ([["1.01", 0]] * 6, [["2", 0]] * 6, alone):
        with pytest.raises(NoCertificate, match="too strong"):
            outputs(x=growing).search()


def test_the_parts_of_a_bound():
    bounds = outputs(x=X, u=U, w=W)  # the first row of e_1 is the larger one
    found = bounds.parts([1.0, 2.0], 100.0)
    size = 0.5 * (9 + 64) ** 0.5 + 0.5 + 0.25
    assert found["sensors"] == pytest.approx(0.01 * 2)
    assert found["converter"] == pytest.approx(0.03 * 3)
    sampling = 0.05 * 0.5 + 0.001 * 10 + 0.003 * 7
    assert found["sampling of the reference"] == pytest.approx(sampling)
    assert found["reference"] == pytest.approx(1 - 0.02 - 0.09 - sampling)
    assert found["uncertain, constant"] == pytest.approx(0.1 * 0.25)
    assert found["uncertain, growing"] == pytest.approx(0.1 * (size - 0.25))
    assert found["between samples"] == pytest.approx(0.5 + 0.5 + 0.01 * 100)
    total = float(bounds.image([q(1), q(2)], q(100))[0])
    assert sum(found.values()) == pytest.approx(total)
    bounds.drive.jumps = None
    less = bounds.parts([1.0, 2.0], 100.0)["sampling of the reference"]
    assert less == pytest.approx(sampling - 0.021)


def timed(**more):
    """With steps of the input and rates of the states: seven outputs, a row each."""
    drive = SimpleNamespace(n=2, sized=2, uncertain=(bound_of_w(),))
    bounds = SimpleNamespace(
        outputs=np.arange(7),
        constant=balls([1, 2, 3, 4, 5, 6, 7]),
        x=balls([[0.1 * i, 0.01] for i in range(7)]),
        u=balls([0.01 * i for i in range(7)]),
        w=balls([[0.01]] * 7),
        drive=drive,
    )
    numbers = {
        "by_step": balls([0.05 * i for i in range(7)]),
        "by_rate": balls([[0.01, 0.02 * i] for i in range(7)]),
        "direct": balls([[0.001 * i] for i in range(7)]),
    }
    return TimedBounds(bounds, **(numbers | more))


def test_the_image_with_jitter_has_steps_and_rates():
    bounds, i = timed(), np.arange(7.0)
    found = bounds.image([q(1), q(2)], q(10), q(20), [q(30), q(40)])
    size = 0.5 * (9 + 64) ** 0.5 + 0.75
    expected = 1 + i + 0.1 * i + 0.02 + 0.1 * i + (0.01 + 0.001 * i) * size
    expected += 0.05 * i * 20 + 0.3 + 0.8 * i
    assert [float(v) for v in found] == pytest.approx(expected) and bounds.count == 7
    v = bounds.search()
    image = bounds.image(v[:2], v[2], v[3], v[4:])
    assert all(float(a) < b for a, b in zip(image[1:], v, strict=True))
    assert [float(a) for a in image[1:]] == pytest.approx(v, rel=3 * FIXED_POINT_MARGIN)
    with pytest.raises(NoCertificate, match="jitter is too large"):
        timed(by_step=balls([1] * 7)).search()
    with pytest.raises(NoCertificate, match="jitter is too large"):
        timed(by_step=balls([3] * 7)).search()
    still = timed()
    still.bounds.constant, still.bounds.w = balls([0] * 7), balls([[0]] * 7)
    still = replace(still, direct=balls([[0]] * 7))
    assert still.search() == [SMALLEST_BOUND] * 6
    with pytest.raises(NoCertificate, match="range of floating point"):
        bounds.image([flint.arb("nan"), q(2)], q(10), q(20), [q(30), q(40)])


def test_what_a_pulse_does_within_a_cell():
    """|e^{A s} b| <= e^{|A| h} |b|, and the same of its rate."""
    A, b = flint.arb_mat([[-1, 2], [0, -3]]), flint.arb_mat([[1], [-4]])
    period = SimpleNamespace(drive=SimpleNamespace(A=A, b=b, n=2))
    still, moving = _in_cell_pulse(period, flint.fmpq(1, 2))
    growth = expm(np.array([[1.0, 2.0], [0.0, 3.0]]) / 2)
    assert [float(v) for v in still] == pytest.approx(growth @ [1.0, 4.0])
    assert [float(v) for v in moving] == pytest.approx(growth @ [9.0, 12.0])


@pytest.mark.parametrize(
    ("delay", "jitter", "crosses"),
    [
        (0, "0.1", True),
        ("0.05", "0.1", True),
        ("0.1", "0.1", False),
        ("0.5", "0.1", False),
        ("0.9", "0.1", False),
        ("0.95", "0.1", True),
        ("2.05", "0.1", True),
        ("2.5", "0.1", False),
        ("0.5", "0.51", True),
        (0, 0, False),
    ],
)
def test_a_window_of_an_input_may_reach_into_another_period(delay, jitter, crosses):
    assert _crosses(SimpleNamespace(delay=q(delay), jitter=q(jitter))) == crosses


# gains of each lag


def test_gains_by_lag_are_those_of_all_the_past():
    period, bounds, doublings, *_ = loop()
    rows = list(bounds.rows)[:2]
    with flint.ctx.workprec(DRIVE_BITS):
        found = lag_gains(period, rows, 9)
        M = np.array([[float(v.mid()) for v in row] for row in period.map.tolist()])
        assert found.lags.shape[:2] == (512, 2) and found.before.value.shape == (
            512,
            2,
            period.size,
        )
        for row, before in zip(rows, found.before.value.swapaxes(0, 1), strict=True):
            first = flint.arb_mat([list(row.row)]) * period.since_jump(row.phase)[-1]
            at = np.array([float(v.mid()) for v in (first * period.jump).entries()])
            scale = np.abs(at).max()
            for lag in (0, 1, 7, 511):
                expected = at @ np.linalg.matrix_power(M, lag)
                assert before[lag] == pytest.approx(expected, rel=1e-6, abs=1e-9 * scale)
        for lag in (0, 1, 7, 511):
            power = np.abs(np.linalg.matrix_power(M, lag))
            assert found.powers[lag] == pytest.approx(power, rel=1e-6, abs=1e-9)
            assert (found.powers[lag] >= power * (1 - 1e-9)).all()
        last = np.abs(np.linalg.matrix_power(M, 512))
        assert found.last == pytest.approx(last, rel=1e-6, abs=1e-9)
        whole = output_gains(period, rows, doublings)
    added = found.running + found.lags.sum(axis=0) + found.tail
    nw, n = period.drive.W.ncols(), period.drive.n
    assert (added[:, :nw] >= whole.w * (1 - 1e-6)).all()
    assert added[:, :nw] == pytest.approx(whole.w, rel=0.3)
    noise = added[:, nw + 1 : nw + 1 + n]
    assert (noise >= whole.noise * (1 - 1e-6)).all()


# bounds that lead down from a region


def halving(limit=1.0):
    """Bounds that halve from period to period, down to a limit."""
    return SimpleNamespace(
        image=lambda X, U: [0, *(max(v / 2, flint.arb(limit)) for v in (*X, U)), 0]
    )


def start(*states, u):
    return SimpleNamespace(states=[str(v) for v in states], input=str(u))


def test_bounds_lead_down_until_they_stand_still_or_are_enough():
    found = descend(halving(), ([8, 3], 5), lambda _: False)
    assert [float(v) for v in found] == [1, 1, 1]
    found = descend(halving(), ([8, 3], 5), lambda v: v[0] <= 4)
    assert [float(v) for v in found] == [4, 1.5, 2.5]
    found = descend(halving(), ([0.5, 3], 5), lambda _: False)
    assert [float(v) for v in found] == [0.5, 1, 1]  # none is raised again
    wide, u = in_the_long_run(halving(), [start(8, 3, u=5), start("0.5", 2, u="0.25")])
    expected = [1 + FIXED_POINT_MARGIN] * 2
    assert wide == pytest.approx(expected, rel=1e-12) and u == pytest.approx(expected[0])
    assert min(*wide, u) > 1
    assert not_reached(halving(), ([1, 1], 1), start(8, 3, u=5)) == ""
    for wanted in (([0.9, 1], 1), ([1, 0.9], 1), ([1, 1], 0.9)):
        assert "do not lead down" in not_reached(halving(), wanted, start(8, 3, u=5))


@pytest.mark.parametrize("edge", [0.0123, 0.37, 1.0, 5.5, 300.0])
def test_the_largest_region_is_searched_from_1_on(edge):
    system = SimpleNamespace(
        truth=SimpleNamespace(states=()),
        plant=SimpleNamespace(n=2),
        varied=SimpleNamespace(x0=None),
    )
    asked = []

    def holds(box):
        asked.append(box)
        return float(box[0][1]) <= edge

    box = largest_region(system, holds)
    assert all(float(low) == -float(high) for low, high in box) and box[0] == box[1]
    assert (1 - 1.1e-3) * edge <= float(box[0][1]) <= edge and asked[0][0] == ("-1.0", "1.0")
    assert len(asked) < 22 and len(set(asked)) == len(asked)  # no finer than that
    drawn = (SimpleNamespace(low=-4.0, high=2.0), SimpleNamespace(low=-0.5, high=0.25))
    system.varied.x0 = drawn
    shaped = largest_region(system, lambda box: float(box[0][1]) <= 4 * edge)
    assert float(shaped[0][1]) == pytest.approx(8 * float(shaped[1][1]), rel=1e-3)
    assert 0.98 * 4 * edge <= float(shaped[0][1]) <= 4 * edge
    with pytest.raises(NoCertificate):
        largest_region(system, lambda box: False)
    system.truth.states = ("z",)
    with pytest.raises(NoCertificate, match="states of its own"):
        largest_region(system, lambda box: True)


def test_a_region_of_runs_is_the_largest_of_all_delays():
    def proof(*peaks, of="x0"):
        return SimpleNamespace(starts=(SimpleNamespace(of=of, peaks=peaks),))

    one, two = proof("9", "1", "0.5", "7", "8"), proof("9", "0.25", "2", "7", "8")
    assert region_of_runs([one, two]) == (1, 2) and region_of_runs([two]) == (Fraction(1, 4), 2)
    assert region_of_runs([]) is None
    assert region_of_runs([one, proof("9", "1", "1", "1", "1", of="elsewhere")]) is None
    plant = SimpleNamespace(plant=SimpleNamespace(states=("x1", "v")))
    assert while_within(plant, (Fraction(1, 3), Fraction(2))) == "|x1| <= 0.3334, |v| <= 2"
    named = [SimpleNamespace(name="w_1"), SimpleNamespace(name="w_2" + IN_REGION)]
    assert is_only_in_region(named) and not is_only_in_region(named[:1])


def test_points_beyond_a_region_are_moved_to_its_edge():
    points = Points(np.arange(4.0), np.array([[0.5, 4.0, 1.0, 0.0], [0.5, 2.0, -8.0, 0.0]]))
    found = _within(points, (Fraction(1), Fraction(2)))
    expected = [[0.5, 1.0, 0.25, 0.0], [0.5, 0.5, -2.0, 0.0]]
    assert found.x == pytest.approx(np.array(expected)) and (found.t == points.t).all()
    assert (np.abs(found.x) <= [[1.0], [2.0]]).all()


# polytopes


TRIANGLE = Polytope(np.array([[1.0, 1.0]]), np.array([1.0]), ((-1.0, 1.0), (-1.0, 2.0)), ("x", "v"))


def test_a_polytope_is_its_region_within_half_spaces():
    starts = np.array([[0.5, 0.5], [0.5, 0.6], [1.0, 0.0], [1.1, -1.0], [-1.0, 2.0], [0.0, -1.1]])
    assert TRIANGLE.contains(starts).tolist() == [True, False, True, False, True, False]
    assert (0.5, 0.5) in TRIANGLE and (0.6, 0.5) not in TRIANGLE and not TRIANGLE.is_region
    free = Polytope(np.zeros((0, 2)), np.zeros(0), TRIANGLE.region, ("x", "v"))
    assert free.is_region and (1.0, 2.0) in free and (1.0, 2.1) not in free
    with pytest.raises(InputError, match="2 numbers"):
        TRIANGLE.contains([1.0, 2.0, 3.0])
    assert (TRIANGLE.index("v"), TRIANGLE.index(0)) == (1, 0)
    for state in (2, -1, "y"):
        with pytest.raises(InputError):
            TRIANGLE.index(state)


def test_the_largest_box_in_a_polytope():
    """About (0, 1/2), of the shape 1 by 3/2: 1/2 + 5/2 part = 1."""
    (a, b), (c, d) = TRIANGLE.largest_box()
    assert (a, b, c, d) == pytest.approx((-0.2, 0.2, 0.2, 0.8), rel=1e-8)
    assert all(corner in TRIANGLE for corner in itertools.product((a, b), (c, d)))
    wide = Polytope(TRIANGLE.rows, np.array([5.0]), TRIANGLE.region, ("x", "v"))
    assert wide.largest_box() == TRIANGLE.region
    assert (
        Polytope(TRIANGLE.rows, np.array([0.4]), TRIANGLE.region, ("x", "v")).largest_box() is None
    )


def test_a_section_of_a_polytope():
    corners = TRIANGLE.section("x", "v")
    assert sorted(map(tuple, corners.tolist())) == [(-1, -1), (-1, 2), (1, -1), (1, 0)]
    rows, limits = np.array([[1.0, 0.0, 2.0]]), np.array([1.0])
    three = Polytope(rows, limits, ((-1.0, 1.0),) * 3, ("a", "b", "c"))
    moved = three.section("a", "b", [9.0, 9.0, 0.25])  # of these two nothing is fixed
    assert moved[:, 0].max() == pytest.approx(0.5) and moved[:, 0].min() == -1
    assert three.section(0, 1, [0.0, 0.0, 1.5]).shape == (0, 2)
    assert three.section(0, 1, [0.0, 0.0, 1.0])[:, 0].max() == pytest.approx(-1.0)
    with pytest.raises(InputError, match="two different"):
        three.section("a", 0)


def test_a_polygon_is_cut_by_a_line():
    square = [np.array(p, dtype=float) for p in ((0, 0), (2, 0), (2, 2), (0, 2))]
    half = _cut(square, np.array([1.0, 0.0]), 0.5)
    assert [p.tolist() for p in half] == [[0, 0], [0.5, 0], [0.5, 2], [0, 2]]
    assert len(_cut(square, np.array([1.0, 0.0]), 2.0)) == 4
    assert _cut(square, np.array([1.0, 0.0]), -0.1) == []
    corner = _cut(square, np.array([1.0, 1.0]), 2.0)
    assert [p.tolist() for p in corner] == [[0, 0], [2, 0], [0, 2]]


def test_half_spaces_that_the_region_implies_are_left_out():
    region = np.array([[-1.0, 2.0], [-3.0, 1.0]])
    rows = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 0.5]])
    reach = np.array([3.0, 5.0, 1.5])
    kept, limits = half_spaces(rows, 0 * rows, reach * (1 - 1e-9), region)
    assert (kept == rows).all() and limits == pytest.approx(reach) and (limits < reach).all()
    kept, _ = half_spaces(rows, 0 * rows, reach + np.array([1e-9, -1e-9, 1e-9]), region)
    assert (kept == rows[1:2]).all()
    error = np.array([[0.1, 0.01]] * 3)
    _, less = half_spaces(rows, error, np.ones(3), region)
    assert less == pytest.approx(1 - 0.1 * 2 - 0.01 * 3) and (less < 1 - 0.23).all()


def test_what_is_in_several_polytopes():
    other = Polytope(np.array([[0.0, 1.0]]), np.array([0.5]), ((-2.0, 0.5), (0.0, 3.0)), ("x", "v"))
    both = common([TRIANGLE, other])
    assert both.region == ((-1.0, 0.5), (0.0, 2.0)) and both.states == ("x", "v")
    assert both.rows.tolist() == [[1, 1], [0, 1]] and both.limits.tolist() == [1.0, 0.5]


def test_why_rates_are_not_used(monkeypatch):
    proof = SimpleNamespace(slow=(), cell=())
    system = SimpleNamespace(implementation=SimpleNamespace(jitter=0))
    monkeypatch.setattr(rates_used, "rated_terms", lambda _: ("w_1",))
    monkeypatch.setattr(rates_used, "estimates_disturbances", lambda _: True)
    assert "as bad as without" in rates_unused(system, proof)
    assert "ranges" in rates_unused(system, SimpleNamespace(slow=(), cell=(1,)))
    assert rates_unused(system, SimpleNamespace(slow=(1,), cell=())) == ""
    late = SimpleNamespace(implementation=SimpleNamespace(jitter=0.1))
    assert "jitter" in rates_unused(late, proof)
    assert "as bad" in rates_unused(SimpleNamespace(implementation=None), proof)
    monkeypatch.setattr(rates_used, "estimates_disturbances", lambda _: False)
    assert "law.observer" in rates_unused(late, proof)
    monkeypatch.setattr(rates_used, "rated_terms", lambda _: ())
    assert rates_unused(system, proof) == ""


@dataclass(frozen=True)
class WithStarts:
    starts: tuple


def test_nothing_is_said_of_other_starts():
    x0, box = SimpleNamespace(of="x0"), SimpleNamespace(of="polytope")
    found = without_polytopes((WithStarts((x0, box)), WithStarts((box,)), WithStarts((x0,))))
    assert [proof.starts for proof in found] == [(x0,), (), (x0,)]


# F in floats


class Product:
    """0.3 x_1 x_2 + 0.5 ||S x||, in the place of a formula."""

    def largest_float(self, X, norm):
        return 0.3 * X[0] * X[1] + 0.5 * norm


def float_image():
    """Outputs e_1 (two rows), x_1, x_2, u (two rows) and its step; two terms, one a formula."""
    rng = np.random.default_rng(12)
    plain = SimpleNamespace(
        gamma=q("0.2"), beta=q("0.1"), weights=(q(1), q(3)), Delta=(q("0.4"), q(0)), growing=None
    )
    grown = SimpleNamespace(
        gamma=q(0), beta=q(0), weights=(q(2), q(1)), Delta=(q(0), q(0)), growing=Product()
    )
    outputs = np.array([0, 0, 1, 2, 3, 3, 4])
    return FloatImage(
        outputs,
        rng.uniform(0, 1, 7),
        rng.uniform(0, 1, (7, 2)),
        rng.uniform(0, 1, (7, 3)),
        (plain, grown),
    )


def test_the_image_in_floats_is_its_formula():
    image, v = float_image(), np.array([0.5, 2.0, 3.0])
    sizes = [
        0.2 * np.hypot(0.5, 3 * 2.0) + 0.4 * 0.5 + 0.1,
        0.3 * 0.5 * 2.0 + 0.5 * np.hypot(2 * 0.5, 2.0),
    ]
    expected = image.constant + image.by_w @ sizes + image.by_v @ v
    assert image.values(v) == pytest.approx(expected, rel=1e-14)
    rows = image.largest_rows(v)
    assert image.outputs[rows].tolist() == [0, 1, 2, 3, 4]
    for k, row in enumerate(rows):
        assert expected[row] == expected[image.outputs == k].max()


@pytest.mark.parametrize(
    "v", [(0.5, 2.0, 3.0), (4.0, 0.1, 0.0), (1e-3, 7.0, 1.0), (0.02, 0.03, 0.1)]
)
def test_the_derivative_of_the_image_is_that_of_its_values(v):
    image, v, rows = float_image(), np.array(v), np.array([1, 2, 3, 5, 6])
    found, step = image.derivative(v, rows), 1e-6
    for i, unit in enumerate(np.eye(3)):
        ends = [image.values(v + sign * step * unit)[rows] for sign in (1, -1)]
        assert found[:, i] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-6)


def test_where_nothing_moves_the_slopes_are_finite():
    """At x = 0 the norm has no slope, and a formula no step."""
    image, rows = float_image(), np.arange(7)
    found = image.derivative(np.zeros(3), rows)
    expected = image.by_v.copy()
    expected[:, 0] += image.by_w[:, 0] * 0.4
    assert found == pytest.approx(expected)


@pytest.mark.parametrize("longest", range(4))
def test_between_the_ends_of_cells_a_pulse_bends_by_no_more_than_is_said(longest):
    """Of every cell, also where the one that bends most is not the first or the last."""
    A, b = np.array([[-1.0, 2.0], [-0.5, -3.0]]), np.array([1.0, -4.0])
    lengths = [q("0.3") if p == longest else q("0.1") for p in range(4)]
    moves = [expm(A * float(h)) for h in lengths]
    cells = [
        SimpleNamespace(length=h, transition=flint.arb_mat(E.tolist()))
        for h, E in zip(lengths, moves, strict=True)
    ]
    drive = SimpleNamespace(A=flint.arb_mat(A.tolist()), b=flint.arb_mat([[v] for v in b]))
    identity = flint.arb_mat([[1, 0], [0, 1]])
    period = Period(drive, identity, None, None, None, tuple(cells), (), ())
    nodes, bend = _pulse_columns(period, drive.b, 4)
    largest, said, later = np.zeros(2), np.zeros(2), np.eye(2)
    for k, p in enumerate((3, 2, 1, 0)):
        h = float(lengths[p])
        ends = [np.array([float(nodes[i, k + j]) for i in range(2)]) for j in (0, 1)]
        assert ends[0] == pytest.approx(later @ b)
        for s in np.linspace(0, 1, 41):
            line = (1 - s) * ends[0] + s * ends[1]
            largest = np.maximum(largest, np.abs(later @ expm(A * s * h) @ b - line))
        curved = expm(np.abs(A) * h) @ np.abs(A @ A @ b) * h**2 / 8
        said = np.maximum(said, np.abs(later) @ curved)
        later = later @ moves[p]
    assert (largest <= bend).all()
    assert bend == pytest.approx(said)

"""Parts of the bounds of implemented loops by themselves: kernels, gains, tails, growing bounds."""

import math
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from scipy.linalg import expm
from test_implemented import UNIT_W, bare_drive

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import cover as cover_room
from certrack.certificates.implemented import gains as gains_room
from certrack.certificates.implemented import lags as lags_room
from certrack.certificates.implemented import levels as levels_room
from certrack.certificates.implemented import polytope as polytope_room
from certrack.certificates.implemented import slow as slow_room
from certrack.certificates.implemented import start as start_room
from certrack.certificates.implemented import timing as timing_room
from certrack.certificates.implemented.drive import DRIVE_BITS, SlowBound, UncertainBound
from certrack.certificates.implemented.enclosed import Enclosed, widened
from certrack.certificates.implemented.estimate import _estimated_gains
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.gains import (
    gains_of,
    kernel_columns,
    largest_of_each,
    mean_magnitude,
    output_gains,
    product_error,
    running_period,
    sums_over_time,
    tail_gains,
    upper_number,
)
from certrack.certificates.implemented.growing import GrowingBound
from certrack.certificates.implemented.lags import lag_gains
from certrack.certificates.implemented.levels import (
    Level,
    _memories,
    _sized,
    _still,
    _where_the_error_is_zero,
    levels_of,
    partly_cancelled,
    reference_columns,
)
from certrack.certificates.implemented.outputs import InCell, Row, _in_cell, output_rows
from certrack.certificates.implemented.period import gamma, one_period, shift
from certrack.certificates.implemented.powers import (
    PastRows,
    powers_of_columns,
    powers_of_rows,
)
from certrack.certificates.implemented.start import (
    Later,
    _product_with,
    first_state,
    is_above,
    up,
)
from certrack.certificates.implemented.timing import (
    TimedBounds,
    _crosses,
    _in_cell_pulse,
    pulse_gains,
    rate_rows,
)
from certrack.core.ball_matrices import column
from certrack.core.expressions import parse, symbol


def exact_period(Ly, parts, n=1, lipschitz=0.01):
    """x' = -x + u with the law u = Ly Y', in cells of equal length."""
    A, b = [[-1]], [1]
    if n == 2:
        A, b = [[-1, 1], [0, -2]], [0, 1]
    W = [[0]] * (n - 1) + [[1]]
    Y = [1.0] * len(Ly)
    return one_period(bare_drive(A, b, W, Ly, 0.1, Y, lipschitz, [UNIT_W][:1]), parts)


@pytest.mark.parametrize("lipschitz", [0.01, None])
@pytest.mark.parametrize("phase", [1, 2, 3])
@pytest.mark.parametrize("q", [0, 1, 2, 4])
def test_what_is_seen_of_the_reference_by_levels_is_the_definition(q, phase, lipschitz):
    """k_r = spread - E Pi' Gamma(age) of each cell, newest first, its second derivatives, and E D.

    Each cell has a Pi' of its own at its end, which is not that of its beginning.
    """
    rng = np.random.default_rng(q)

    def some(columns):
        return flint.arb_mat(rng.integers(-9, 9, (period.size, columns)).tolist())

    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, *range(2, q + 3)], (1, 3), lipschitz=lipschitz)
        J = len(period.cells)
        levels = [
            Level(tuple(some(q + 1) for _ in range(J + 1)), tuple(some(q + 1) for _ in range(J)))
            for _ in range(2)
        ]
        found, over = reference_columns(period, levels, phase), period.since_jump(phase)
        entire = phase == J and lipschitz is not None
        spread = over[-1] * column(period.reference, q + 1) / flint.arb(period.drive.T)
        nodes, samples, bends, weights = [], [], [], []
        for back in range(phase):
            p, matrix = phase - 1 - back, over[back]
            h = period.cells[p].length
            for age in (flint.fmpq(0), h):
                for level in levels:
                    kernel = -matrix * (level.Pi[p + 1] * gamma(q, age))
                    nodes.append(kernel + spread if entire else kernel)
            samples += [matrix * level.residual[p] for level in levels]
            for level in levels:
                for j in range(q - 1):
                    bends.append(matrix * column(level.Pi[p + 1], j))
                    power = float(h) ** (q - 2 - j) / math.factorial(q - 2 - j)
                    weights.append(power * float(h) ** 3 / 12)

        def same(matrix, parts):
            entries = [[v for part in parts for v in part.tolist()[i]] for i in range(period.size)]
            assert [len(row) for row in matrix.tolist()] == [len(row) for row in entries]
            for row, other in zip(matrix.tolist(), entries, strict=True):
                assert all(
                    abs(float((a - b).mid())) < 1e-12 for a, b in zip(row, other, strict=True)
                )

        same(found.nodes, nodes)
        same(found.samples, samples)
        assert (found.bends is None) == (not bends)
        if bends:
            same(found.bends, bends)
        assert found.bend_weights == pytest.approx(np.array(weights), rel=1e-12)
        assert (found.bend_weights >= np.array(weights) * (1 - 1e-15)).all()
        h = float(period.cells[0].length)
        assert found.lengths == pytest.approx([h, 0.0] * (phase - 1) + [h], rel=1e-15)
        assert found.curvature.shape == (period.size, 0)


@pytest.mark.parametrize("q", [0, 1, 2])
def test_memories_of_samples_of_what_is_wanted_repeat_themselves(q):
    """s = Sx x_d + Ss s before + Sy: what was there a period before, of the Y of then."""
    rng = np.random.default_rng(q)

    def some(rows, columns):
        return flint.arb_mat(rng.integers(-9, 9, (rows, columns)).tolist())

    with flint.ctx.workprec(DRIVE_BITS):
        Sx, Ss, Sy, desired = some(2, 3), some(2, 2), some(2, q + 2), some(3, q + 1)
        drive = SimpleNamespace(Sx=Sx, Ss=Ss, Sy=Sy, desired=desired, memories=2, q=q)
        before = shift(q, -flint.fmpq(1, 10))
        s = _memories(drive, before)
        of_Y = flint.arb_mat([row[: q + 1] for row in Sy.tolist()])
        left = s - (Sx * desired + Ss * (s * before) + of_Y)
        assert (s.nrows(), s.ncols()) == (2, q + 1)
        assert all(v.contains(0) and float(v.rad()) < 1e-20 for v in left.entries())


def test_what_stands_still_of_a_level_is_its_difference_from_the_reference():
    """|row Pi_p - of_Y| Y, of the Pi of the row's own cell."""
    rng = np.random.default_rng(11)
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, 2, 3], (1, 2))
        levels = [
            Level(
                tuple(
                    flint.arb_mat(rng.integers(-9, 9, (period.size, 2)).tolist()) for _ in range(3)
                ),
                (),
            )
            for _ in range(2)
        ]
        nothing = InCell((), flint.arb(0), (), flint.arb(0))
        rows = [
            Row(0, phase, tuple(map(int, rng.integers(-9, 9, period.size))), (5, -3), 0, nothing)
            for phase in (1, 0, 1)
        ]
        found = _still(period, levels, rows)
    for row, values in zip(rows, found, strict=True):
        for level, value in zip(levels, values, strict=True):
            Pi = np.array([[float(v) for v in line] for line in level.Pi[row.phase].tolist()])
            expected = np.abs(np.array(row.row) @ Pi - [5, -3]).sum()  # Y = (1, 1)
            assert value >= expected and value == pytest.approx(expected, rel=1e-12)


def test_the_last_rows_are_the_newest_input_and_its_step():
    """u_k is the entry `command` of chi and u_{k-1} the next one, right after the jump."""
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, 2, 3], (1, 2), n=2)
        *others, newest, step = output_rows(period)
    n = period.drive.n
    assert (newest.output, step.output) == (n + 1, n + 2)
    assert {row.output for row in others} == set(range(n + 1))
    for row, entries in ((newest, {0: 1}), (step, {0: 1, 1: -1})):
        expected = [entries.get(i - period.command, 0) for i in range(period.size)]
        assert [float(v) for v in row.row] == expected
        assert (row.phase, row.share) == (0, 0)
        assert [float(v) for v in row.of_Y] == [0, 0]
        parts = (*row.in_cell.w, row.in_cell.r, *row.in_cell.x, row.in_cell.u)
        assert [float(v) for v in parts] == [0] * len(parts)


@pytest.mark.parametrize("smeared", [True, False])
@pytest.mark.parametrize("q", [0, 1, 2, 4])
def test_columns_of_the_kernels_are_their_definitions(q, smeared):
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, *range(2, q + 3)], (1, 3))
        found = kernel_columns(period, 3, smeared)
        h = Fraction(1, 30)
        expected = [
            float(h ** (q - 2 - j) / math.factorial(q - 2 - j) * h**3 / 12) for j in range(q - 1)
        ]
        assert found.bend_weights == pytest.approx(np.array(expected * 3), rel=1e-12)
        assert (found.bends is None) == (q < 2)
        assert found.lengths == pytest.approx([1 / 30] * 3) and (found.lengths >= 1 / 30).all()
        over = period.since_jump(3)
        last = over[-1] * column(period.reference, q + 1)
        for i, matrix in enumerate(over):
            k_w = matrix * period.W
            k_r = -matrix * (period.Pi[3 - i] * gamma(q, flint.fmpq(0)))
            if smeared:
                k_r = k_r + last * (1 / flint.arb(period.drive.T))
            for row in range(period.size):
                assert found.nodes[row, 2 * i].overlaps(k_w[row, 0])
                assert found.nodes[row, 2 * i + 1].overlaps(k_r[row, 0])
        for i, matrix in enumerate(over[:-1]):
            for j in range(q - 1):
                bend = matrix * column(period.Pi[3 - i], j)
                at = i * (q - 1) + j
                assert all(
                    found.bends[row, at].overlaps(bend[row, 0]) for row in range(period.size)
                )
        # |k_w''| <= e^{h}, three cells of it, each through at most e^0
        bound = 3 * math.exp(1 / 30) * (1 / 30) ** 3 / 12
        assert 0.9 * bound < found.curvature[0, 0] <= 1.0001 * bound
        width = 2 * 4 + 1 + 2 + 3 * max(q - 1, 0) + period.size
        assert found.all().ncols() == width


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_what_a_cell_adds_is_its_taylor_series_and_a_remainder(degree):
    """Of w the series of the kernel and what is beyond it; of x and u what is beyond it alone."""
    h, q = Fraction(1, 5), 1
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([0, 1, 1], (1, 1), n=2)
        derivatives = [flint.arb_mat([[1, 2]])]
        for _ in range(degree + 1):
            derivatives.append(derivatives[-1] * period.drive.A)
        of_Y = [flint.arb(3), flint.arb(-5)]
        found = _in_cell(period, flint.fmpq(1, 5), derivatives, of_Y, degree)
    A, W, b = np.array([[-1.0, 1.0], [0.0, -2.0]]), np.array([0.0, 1.0]), np.array([0.0, 1.0])
    lines = [np.array([1.0, 2.0]) @ np.linalg.matrix_power(A, k) for k in range(degree + 2)]
    step = [float(h**k / math.factorial(k)) for k in range(degree + 3)]
    last = np.abs(lines[-1]) @ expm(np.abs(A) * float(h))
    w = sum(abs(lines[k] @ W) * step[k + 1] for k in range(degree + 1))
    assert [float(v) for v in found.w] == pytest.approx([w + last @ W * step[degree + 2]])
    assert float(found.r) == pytest.approx(sum(v * step[q - j + 1] for j, v in enumerate((3, 5))))
    assert [float(v) for v in found.x] == pytest.approx(last * step[degree + 1])
    u = (abs(lines[degree] @ b) + last @ b * float(h)) * step[degree + 1]
    assert float(found.u) == pytest.approx(u)


def test_of_the_running_period_only_what_has_passed_is_seen():
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, 1, 1, 1], (1, 3))
        assert [len(kernel_columns(period, p, False).lengths) for p in range(4)] == [0, 1, 2, 3]
        assert kernel_columns(period, 0, False).nodes.ncols() == 2


@pytest.mark.parametrize("q", [0, 2])
def test_of_the_running_period_the_sample_is_an_input_by_itself(q):
    """What moved since is not spread over the period; noise, sample and step count as they are."""
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, *range(2, q + 3)], (1, 2), n=2)
        n, nw = period.drive.n, period.drive.W.ncols()
        nothing = InCell((), flint.arb(0), (), flint.arb(0))
        rng = np.random.default_rng(q)
        rows = [
            Row(0, phase, tuple(map(int, rng.integers(1, 9, period.size))), (), 0, nothing)
            for phase in (1, 0, 1)
        ]
        table, before = running_period(period, rows)
        assert table.shape == (3, nw + 1 + n + 3) and before.nrows() == 3
        for i, row in enumerate(rows):
            over = period.since_jump(row.phase)
            line = flint.arb_mat([list(row.row)])

            def seen(matrix, line=line):
                return np.array([[float(v.mid()) for v in r] for r in (line * matrix).tolist()])[0]

            ends = [
                seen(-(matrix * (period.Pi[p] * gamma(q, flint.fmpq(0)))))[0]
                for matrix, p in zip(over, range(row.phase, -1, -1), strict=True)
            ]
            lengths = [float(period.cells[p].length) for p in range(row.phase - 1, -1, -1)]
            pairs = zip(ends[:-1], ends[1:], lengths, strict=True)
            moved = sum(h * float(mean_magnitude(np.array(a), np.array(b))) for a, b, h in pairs)
            for h, matrix, p in zip(lengths, over, range(row.phase, 0, -1), strict=False):
                for j in range(q - 1):
                    weight = h ** (q - 2 - j) / math.factorial(q - 2 - j) * h**3 / 12
                    moved += weight * abs(seen(matrix * column(period.Pi[p], j))[0])
            noise = np.abs(seen(over[-1] * period.noise))
            (last,) = np.abs(seen(over[-1] * column(period.reference, q + 1)))
            (step,) = np.abs(seen(over[-1] * period.step))
            expected = np.array([moved, *noise, 0.0, step, last])
            assert last > 0
            assert table[i, nw:] == pytest.approx(expected, rel=1e-12)
            assert (table[i, nw:] >= expected * (1 - 1e-15)).all()


@pytest.mark.parametrize("n", [1, 2])
def test_jumps_add_up_once_in_so_many_periods(n):
    """x_{k+1} = a x_k + (1 - a) r_k: jumps N periods apart sum up to (1 - a)/(1 - a^N)."""
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([0, 1], (1, 1), n=n)
        drive = replace(period.drive, jumps=(rational(1.0), rational(0.35)), jumps_once=False)
        assert drive.periods_between_jumps == 3
        period = one_period(drive, (1, 1))
        rows = output_rows(period)
        found = output_gains(period, rows, 8)
        first = [row.output == n and row.phase == 0 and not row.share for row in rows].index(True)
        a = math.exp(-0.1 * n)
        weight = (1 - a) / n  # of x_n, whose pole is -n
        assert found.jump[first] == pytest.approx(weight / (1 - a**3), rel=1e-6)
        assert found.jump[first] >= weight / (1 - a**3) * (1 - 1e-12)
        assert found.sample[first] == pytest.approx(1 / n, rel=1e-6)
        assert found.step[first] == pytest.approx(1 / n, rel=1e-6)  # the converter's acts as well
        steps = [float(v.mid()) for v in period.step.entries()]
        assert steps == [float(i == period.command) for i in range(period.size)]
        without = output_gains(exact_period([0, 1], (1, 1), n=n), rows, 8)
        assert (without.jump == 0).all()


def test_a_sum_of_jumps_counts_a_rounding_for_each_period(monkeypatch):
    counts = []

    def counting(values, roundings=8):
        counts.append(roundings)
        return widened(values, roundings)

    monkeypatch.setattr(gains_room, "widened", counting)
    with flint.ctx.workprec(DRIVE_BITS):
        drive = exact_period([0, 1], (1, 1)).drive
        for jumps in (None, (rational(1.0), rational(0.35))):
            counts.clear()
            period = one_period(replace(drive, jumps=jumps), (1, 1))
            output_gains(period, output_rows(period), 8)
            assert (max(counts) >= 2**8) is (jumps is not None)


def test_sums_over_periods_are_lines_between_the_cells_and_magnitudes():
    """With what all numbers may be off by: half of both ends' errors on a line, all on others."""
    rng = np.random.default_rng(5)
    lengths, width, others = np.array([0.5, 0.25, 2.0]), 2, 7
    rows, periods, split = 3, 4, 4 * width
    columns = SimpleNamespace(lengths=lengths, nodes=flint.arb_mat(1, split))
    values = rng.uniform(-1, 1, (rows, periods, split + others))
    error = rng.uniform(0, 0.1, (rows, split + others))
    found = sums_over_time(columns, values, error)
    expected = np.zeros((rows, width + others))
    for i in range(rows):
        for w in range(width):
            for c, h in enumerate(lengths):
                a, b = c * width + w, (c + 1) * width + w
                expected[i, w] += h * (error[i, a] + error[i, b]) / 2
                for p in range(periods):
                    line = np.linspace(values[i, p, a], values[i, p, b], 40_001)
                    expected[i, w] += h * float(np.trapezoid(np.abs(line), dx=1 / 40_000))
        expected[i, width:] = np.abs(values[i, :, split:]).sum(axis=0) + error[i, split:]
    assert found == pytest.approx(expected, rel=1e-8)


def test_products_of_tables_are_off_by_no_more_than_is_counted():
    """Sum over all periods; each part of the error is there at its full size, none twice."""
    rng = np.random.default_rng(6)
    blocks, count, size, block, width = 3, 2, 4, 5, 2
    heads = Enclosed(*rng.uniform(0.5, 1, (2, blocks * count, size)))
    table = Enclosed(*rng.uniform(0.5, 1, (2, size, block * width)))
    found = product_error(heads, table, count, block)
    worst = np.zeros((count, width))
    for b in range(blocks):
        head, off = (v[b * count : (b + 1) * count] for v in (heads.value, heads.error))
        for k in range(block):
            entry, apart = (v[:, k * width : (k + 1) * width] for v in (table.value, table.error))
            worst += (head + off) @ (entry + apart) - head @ entry
    assert (found >= worst).all() and found == pytest.approx(worst, rel=1e-12)
    exact = replace(heads, error=0 * heads.error), replace(table, error=0 * table.error)
    sizes = heads.value.reshape(blocks, count, size).sum(axis=0)
    sizes = sizes @ table.value.reshape(size, block, width).sum(axis=1)
    least, most = (2 * (size + more) * 2.0**-53 * sizes for more in (0, 8))
    rounding = product_error(*exact, count, block)
    assert (rounding > least).all() and (rounding < most).all()


def test_the_largest_of_each_group():
    samples = np.array([[1.0, 5.0, 2.0, 3.0, 4.0], [9.0, 1.0, 1.0, 1.0, 2.0]])
    assert list(largest_of_each(samples, 2)) == [5 + 3 + 4, 9 + 1 + 2]
    assert list(largest_of_each(samples, 1)) == [15, 14]
    assert list(largest_of_each(samples, 9)) == [5, 9]


def test_a_tail_is_a_geometric_series():
    """Sums S of unit rows over L periods, M^L = r: l (S + r S + r^2 S ...) = l S/(1 - r)."""
    for r in (0.0, 0.25, 0.75):
        found = tail_gains(np.array([[2.0]]), np.array([[3.0, 0.0, 5.0]]), np.array([[r]]))
        expected = 2 * np.array([3, 0, 5]) / (1 - r)
        assert found[0] == pytest.approx(expected) and (found[0] >= expected).all()
    with pytest.raises(NoCertificate, match="does not shrink"):
        tail_gains(np.array([[2.0]]), np.array([[3.0]]), np.array([[1.0]]))


def test_a_tail_of_two_entries_is_not_below_its_series():
    power, each = np.array([[0.5, 0.2], [0.1, 0.3]]), np.array([[1.0, 2.0], [4.0, 0.5]])
    last = np.array([[1.0, 0.0], [0.3, 2.0]])
    series = last @ np.linalg.solve(np.eye(2) - power, each)
    found = tail_gains(last, each, power)
    assert (found >= series).all() and (found <= 4 * series).all()


def test_powers_of_columns_and_rows():
    M, x = flint.arb_mat([[2, 1], [0, 3]]), flint.arb_mat([[1], [1]])
    columns, power = powers_of_columns(M, x, 2)
    assert columns.value == pytest.approx(np.array([[1, 3, 9, 27], [1, 3, 9, 27]]))
    assert (np.abs(columns.value - [[1, 3, 9, 27]] * 2) <= columns.error).all()
    assert float(power[1, 1]) == 81
    heads, after = powers_of_rows(M, flint.arb_mat([[1, 0]]), 2)
    assert heads.value == pytest.approx(np.array([[1, 0], [2, 1], [4, 5], [8, 19]]))
    assert after[0] == pytest.approx([16, 65])


@pytest.mark.parametrize("axis", [0, 1])
def test_blocks_of_balls_lie_within_their_errors(axis):
    """Also where radii are far above the roundings of floats, and of one entry only."""
    balls = flint.arb_mat([[flint.arb(1) / 3, flint.arb(2, 1e-3)], [flint.arb(1e200), 0]])
    found = Enclosed.of_blocks([balls, 2 * balls], axis)
    both = np.concatenate([np.array(m.tolist(), dtype=object) for m in (balls, 2 * balls)], axis)
    assert found.value.shape == both.shape
    for ball, value, error in zip(both.flat, found.value.flat, found.error.flat, strict=True):
        around = flint.arb(float(value), float(error))
        assert around.contains(ball)
    assert found.error[0, 1] >= 1e-3 and found.error[1, 1] < 1e-3 * 1e200


def test_columns_of_a_table_by_their_names():
    table, jump = np.arange(16.0).reshape(2, 8), np.array([1.0, 2.0])
    found = gains_of(table, 2, 2, jump)
    assert (found.w == table[:, :2]).all() and (found.r == table[:, 2]).all()
    assert (found.noise == table[:, 3:5]).all() and (found.sample == table[:, 5]).all()
    assert (found.step == table[:, 6]).all() and (found.first == table[:, 7]).all()
    assert found.jump is jump


def test_magnitudes_are_rounded_up():
    third = flint.arb(1) / 3
    for value in (third, -third):
        for rounded in (upper_number(value), up(value)):
            assert Fraction(1, 3) < Fraction(rounded) < Fraction(1, 3) * (1 + Fraction(1, 10**14))
    assert up(flint.fmpq(-1, 2)) >= 0.5


# growing bounds


def growing(text):
    states = ("x1", "x2")
    names = [*states, "norm"]
    return GrowingBound(parse("", text, names).expr, tuple(map(symbol, states)))


def test_a_growing_bound_has_its_value_at_the_largest_sizes():
    bound = growing("2*x1 + x2**2/3 + norm**3")
    expected = Fraction(2) + Fraction(9, 3) + Fraction(125)
    value = bound.largest([1, 3], 5)
    assert value.contains(flint.fmpq(130)) or value > 130
    assert Fraction(bound.largest_float([1.0, 3.0], 5.0)) >= expected
    assert bound.largest_float([1.0, 3.0], 5.0) == pytest.approx(130, rel=1e-14)
    third = growing("x1/3")
    assert Fraction(third.largest_float([1.0, 0.0], 0.0)) >= Fraction(1, 3)


@pytest.mark.parametrize(
    ("text", "everywhere"),
    [("1", True), ("3*norm + x1", True), ("sqrt(x1)", True), ("x1*x2", False), ("norm**2", False)],
)
def test_what_grows_no_faster_than_the_sizes_holds_everywhere(text, everywhere):
    assert growing(text).is_global == everywhere


def test_a_growing_bound_without_a_value_is_refused():
    with pytest.raises(NoCertificate, match="the bound of an uncertain term has"):
        growing("exp(x1)").largest([flint.arb("1e300"), 0], 0)


# starts


def test_what_comes_later_must_be_strictly_above_its_image():
    image = np.array([9.0, 1.0, 2.0, 3.0, 4.0])  # e_1, two states, u, its steps
    assert is_above(Later((1.1, 2.1), 3.1), image)
    for states, u in (((1.0, 2.1), 3.1), ((1.1, 2.0), 3.1), ((1.1, 2.1), 3.0), ((1.1, 0.5), 9.0)):
        assert not is_above(Later(states, u), image)


def test_before_the_first_sample_memories_are_what_is_measured():
    period = exact_period([0, 1], (1, 1), n=2)
    drive = replace(
        period.drive,
        first=flint.arb_mat([[3, 4]]),
        first_input=flint.arb_mat([[0]]),
        Ss=flint.arb_mat(1, 1),
        Sx=flint.arb_mat(1, 2),
        Sy=flint.arb_mat(1, 2),
        Ls=flint.arb_mat(1, 1),
    )
    assert drive.memories == 1
    Z, of_noise = first_state(drive, 5)
    found = np.array([[float(v) for v in row] for row in Z.tolist()])
    assert (found == [[1, 0], [0, 1], [3, 4], [0, 0], [0, 0]]).all()
    noise = np.array([[float(v) for v in row] for row in of_noise.tolist()])
    assert (noise == [[0, 0], [0, 0], [3, 4], [0, 0], [0, 0]]).all()


def test_products_of_enclosures_enclose():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(4, 3, 5)), rng.normal(size=(5, 2))
    ea, eb = 1e-9 * rng.random(a.shape), 1e-9 * rng.random(b.shape)
    found = _product_with(Enclosed(a, ea), Enclosed(b, eb))
    for _ in range(20):
        exact = (a + ea * rng.choice([-1, 1], a.shape)) @ (b + eb * rng.choice([-1, 1], b.shape))
        assert (np.abs(exact - found.value) <= found.error).all()
    worst = np.abs(a) @ eb + ea @ np.abs(b) + ea @ eb
    assert (found.error <= 1.001 * worst).all() and (found.error >= worst).all()


def test_polynomials_move_by_their_shift():
    """Phi(t) of (1, t, t^2, t^3) at zero, and Gamma(s)_j = s^{q-j}/(q-j)!."""
    q, t = 3, flint.fmpq(1, 2)
    moved = shift(q, t) * flint.arb_mat([[1], [2], [3], [4]])
    expected = [
        sum(Fraction(y) * Fraction(1, 2) ** k / math.factorial(k) for k, y in enumerate(row))
        for row in ([1, 2, 3, 4], [2, 3, 4], [3, 4], [4])
    ]
    assert [float(v) for v in moved.entries()] == pytest.approx([float(v) for v in expected])
    assert [float(v) for v in gamma(q, t).entries()] == pytest.approx([1 / 48, 1 / 8, 1 / 2, 1])


# Jitter -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cells", [1, 2, 3])
@pytest.mark.parametrize("n", [1, 2])
def test_a_pulse_counts_with_its_largest_effect_in_every_period(n, cells):
    """|lambda(s) b| at the cells' ends, and h^2/8 |lambda| e^{|A| h} |A^2 b| for what lies between.

    The loop without feedback: lambda is that of x' = A x. The period that runs counts, too.
    """
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, 1], (1, cells), n=n)
        rows = output_rows(period)
        found = pulse_gains(period, rows, 8)
    A, b = np.array([[-1.0]]), np.array([1.0])
    if n == 2:
        A, b = np.array([[-1.0, 1.0], [0.0, -2.0]]), np.array([0.0, 1.0])
    h = 0.1 / cells
    inner = expm(np.abs(A) * h) @ np.abs(A @ A @ b) * h**2 / 8
    bend = np.max([np.abs(expm(A * h * k)) @ inner for k in range(cells)], axis=0)

    def largest(line, ends):
        nodes = [abs(line @ expm(A * h * k) @ b) for k in range(ends + 1)]
        return max(nodes) + np.abs(line) @ bend

    for row, value in zip(rows, found, strict=True):
        line = np.array([float(v) for v in row.row[:n]])
        old = line @ expm(A * h * row.phase)
        expected = largest(line, row.phase) if row.phase else 0.0
        for k in range(300):
            expected += largest(old @ expm(A * 0.1 * k), cells)
        small = [np.abs(expm(A * h * k)) @ inner for k in range(row.phase)]
        if row.phase:  # of the cells that have passed only
            expected += np.abs(line) @ (np.max(small, axis=0) - bend)
        assert value >= expected * (1 - 1e-12) and value == pytest.approx(expected, rel=1e-9)


def test_sums_of_pulses_count_a_rounding_for_each_of_their_terms(monkeypatch):
    """Of a block of periods, of all blocks, and of the period that runs."""
    counts = []

    def counting(values, roundings=8):
        counts.append(roundings)
        return widened(values, roundings)

    monkeypatch.setattr(timing_room, "widened", counting)
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, 1], (1, 3))
        pulse_gains(period, output_rows(period), 7)
    block, blocks, size, ends = 8, 16, period.size, 4
    assert len(counts) == blocks + 3
    assert min(counts[:blocks]) >= block + size
    assert counts[blocks] >= blocks + size + ends
    assert counts[blocks + 1] >= size and counts[-1] >= 2


def test_what_a_pulse_does_within_a_cell():
    """Of every state, and of its rate."""
    with flint.ctx.workprec(DRIVE_BITS):
        period = exact_period([1, 1], (1, 2), n=2)
        still, moving = _in_cell_pulse(period, flint.fmpq(1, 20))
    A, b = np.array([[-1.0, 1.0], [0.0, -2.0]]), np.array([0.0, 1.0])
    growth = expm(np.abs(A) / 20)
    assert [float(v) for v in still] == pytest.approx(growth @ np.abs(b), rel=1e-12)
    assert [float(v) for v in moving] == pytest.approx(growth @ np.abs(A @ b), rel=1e-12)


@pytest.mark.parametrize(
    ("delay", "jitter", "crosses"),
    [
        ("0", "0", False),
        ("0", "0.1", True),
        ("0.05", "0.1", True),
        ("0.1", "0.1", False),
        ("0.5", "0.2", False),
        ("0.9", "0.1", False),
        ("0.95", "0.1", True),
        ("1.05", "0.1", True),
        ("2.5", "0.4", False),
    ],
)
def test_windows_that_reach_into_another_period(delay, jitter, crosses):
    drive = exact_period([1, 1], (1, 1)).drive
    exact = {"delay": rational(delay), "jitter": rational(jitter)}
    assert _crosses(replace(drive, **exact)) is crosses


@pytest.mark.parametrize("delay", ["0.5", "0"])
def test_jitter_adds_what_moves_within_it(delay):
    """j T times pulses and rates; rates have |b| DU and |W| w at once, u and its steps no cell."""
    with flint.ctx.workprec(DRIVE_BITS):
        drive = exact_period([1, 1], (1, 1), n=2).drive
        one, zero = rational(1.0), rational(0.0)
        both = UncertainBound(zero, one, (one, one), (zero, zero))
        drive = replace(drive, delay=rational(delay), jitter=rational("0.25"), uncertain=(both,))
        period = one_period(drive, (1, 1))
        rows = output_rows(period) + rate_rows(period)
        bounds = OutputBounds.of(period, rows, output_gains(period, rows, 8))
        timed, pulses = TimedBounds.of(period, rows, bounds, 8), pulse_gains(period, rows, 8)
        cells = [_in_cell_pulse(period, cell.length) for cell in period.cells]
        windows = 2 if delay == "0" else 1
        assert timed.count == 7 and {row.output for row in rows} == set(range(7))
        for i, row in enumerate(rows):
            held, at_once, direct = pulses[i], 0.0, 0.0
            still, moving = cells[row.phase]
            if row.output in (0, 1, 2):
                held += windows * float(still[max(row.output - 1, 0)])
            if row.output >= 5:
                state = row.output - 5
                held += windows * float(moving[state])
                at_once, direct = (0.0, 1.0)[state], (0.0, 1.0)[state]
            assert float(timed.by_step[i]) == pytest.approx(0.025 * held + at_once, rel=1e-12)
            assert [float(v) for v in timed.direct[i]] == [direct]
            noise = 0.025 * bounds.gains.noise[i]
            assert [float(v) for v in timed.by_rate[i]] == pytest.approx(noise, rel=1e-12)
        image = timed.image([1, 2], 3, 0.5, [4, 5])
        noise = np.array(timed.by_rate, dtype=float) @ [4, 5]
        w = np.array(bounds.w[:, 0] + timed.direct[:, 0], dtype=float)  # |w| <= 1
        values = np.array(bounds.constant, dtype=float) + w + noise
        values += np.array(bounds.x, dtype=float) @ [1, 2] + 3 * np.array(bounds.u, dtype=float)
        values += 0.5 * np.array(timed.by_step, dtype=float)
        largest = [max(values[bounds.outputs == k]) for k in range(7)]
        assert [float(v) for v in image] == pytest.approx(largest, rel=1e-9)
        v = timed.search()
        entries = [flint.arb(x) for x in v]
        after = timed.image(entries[:2], entries[2], entries[3], entries[4:])
        assert all(float(a) < b <= float(a) * 1.01 for a, b in zip(after[1:], v, strict=True))


# the period, and what the law wants in it


def late_drive(delay, q_order=1):
    """Two states, one memory, delayed inputs; Lx, Ls and the rest are made up."""
    Ly = list(range(1, q_order + 3))
    drive = bare_drive(
        [[-1, 1], [0, -2]], [0, 3], [[1, 0], [0, 1]], Ly, 0.1, [1.0] * len(Ly), 0.5, []
    )
    return replace(
        drive,
        delay=rational(delay),
        Lx=flint.arb_mat([[-0.25, 0.125]]),
        Ls=flint.arb_mat([[0.5]]),
        Sx=flint.arb_mat([[0.25, -0.5]]),
        Ss=flint.arb_mat([[0.375]]),
        Sy=flint.arb_mat([[k + 0.5 for k in range(q_order + 2)]]),
        first=flint.arb_mat([[1, 1]]),
        first_input=flint.arb_mat([[0]]),
        uncertain=(replace(UNIT_W, weights=(1, 1), Delta=(0, 0)),) * 2,
        mu=(rational("0.01"), rational("0.02")),
        eta=rational("0.03"),
    )


def middles(matrix):
    return np.array([[float(v.mid()) for v in row] for row in matrix.tolist()])


@pytest.mark.parametrize(
    ("delay", "counts"), [("0", (0, 3)), ("0.75", (2, 3)), ("1.75", (2, 3)), ("2", (0, 3))]
)
def test_a_period_has_cells_before_and_after_its_input_takes_over(delay, counts):
    """The input of `floor(delay)` periods before takes over; until then one more acts."""
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(late_drive(delay), (2, 3))
    periods, part = int(float(delay)), float(delay) % 1
    newest = period.command + periods
    assert (period.command, period.size) == (3, 3 + periods + 2)
    assert period.drive.jitter == 0
    lengths = [0.1 * part / 2] * counts[0] + [0.1 * (1 - part) / 3] * counts[1]
    acting = [newest + 1] * counts[0] + [newest] * counts[1]
    assert [float(cell.length) for cell in period.cells] == pytest.approx(lengths)
    assert sum(cell.length for cell in period.cells) == period.drive.T
    assert [cell.acting for cell in period.cells] == acting
    for cell in period.cells:
        block = np.zeros((3, 3))
        block[:2] = [[-1, 1, 0], [0, -2, 3]]
        over = expm(block * float(cell.length))
        expected = np.eye(period.size)
        expected[:2, :2], expected[:2, cell.acting] = over[:2, :2], over[:2, 2]
        assert middles(cell.transition) == pytest.approx(expected)
    jump = np.eye(period.size, k=-1)
    jump[:4] = 0
    jump[:2, :2] = np.eye(2)
    jump[2, :3], jump[3, :3] = [0.25, -0.5, 0.375], [-0.25, 0.125, 0.5]
    assert middles(period.jump) == pytest.approx(jump)
    noise = np.zeros((period.size, 2))
    noise[2], noise[3] = [0.25, -0.5], [-0.25, 0.125]
    assert middles(period.noise) == pytest.approx(noise)
    reference = np.zeros((period.size, 3))
    reference[2], reference[3] = [0.5, 1.5, 2.5], [1, 2, 3]
    assert middles(period.reference) == pytest.approx(reference)


@pytest.mark.parametrize("q", [0, 1, 2])
@pytest.mark.parametrize("delay", ["0", "0.5", "1.5"])
def test_where_the_error_is_zero_states_memories_and_inputs_are_as_wanted(delay, q):
    """Y is a polynomial: x_d of each cell's begin, the memory and inputs of the samples before."""
    rng = np.random.default_rng(q)
    desired = rng.integers(-4, 5, (2, q + 1))
    with flint.ctx.workprec(DRIVE_BITS):
        drive = replace(late_drive(delay, q), desired=flint.arb_mat(desired.tolist()))
        period = one_period(drive, (2, 1))
        found = _where_the_error_is_zero(period)
        s = middles(_memories(drive, shift(q, -drive.T)))
        assert _where_the_error_is_zero(replace(period, drive=replace(drive, desired=None))) is None
    assert len(found) == len(period.cells) + 1
    Y0 = rng.uniform(-1, 1, q + 1)

    def Y(t):
        return np.array(
            [
                sum(Y0[j] * t ** (j - i) / math.factorial(j - i) for j in range(i, q + 1))
                for i in range(q + 1)
            ]
        )

    def command(t):
        of_Y = [k + 1 for k in range(q + 1)] @ Y(t)
        return [-0.25, 0.125] @ desired @ Y(t) + 0.5 * (s @ Y(t - 0.1))[0] + of_Y

    inputs = [command(-0.1 * k) for k in range(period.size - 3)]
    t = 0.0
    for Pi, length in zip(found, [*(float(c.length) for c in period.cells), 0.0], strict=True):
        expected = [*(desired @ Y(t)), (s @ Y(0.0))[0], *inputs]
        assert middles(Pi) @ Y(t) == pytest.approx(expected, rel=1e-12, abs=1e-12)
        t += length


@pytest.mark.parametrize("lipschitz", [0.5, None])
@pytest.mark.parametrize("jumps", [None, (1.0, 0.35), (1.0, 0.1)])
@pytest.mark.parametrize("delay", ["0", "0.5"])
def test_gains_in_floats_are_those_of_the_proof(delay, jumps, lipschitz):
    """But for what bends within the cells, and what is left after all periods."""
    with flint.ctx.workprec(DRIVE_BITS):
        drive = replace(
            late_drive(delay),
            jumps=None if jumps is None else tuple(map(rational, jumps)),
            lipschitz=None if lipschitz is None else rational(lipschitz),
        )
        period = one_period(drive, (12, 16))
        rows = output_rows(period)[::3] + output_rows(period)[-2:]
        for doublings in (7, 8):
            found = _estimated_gains(period, rows, doublings)
            proven = output_gains(period, rows, doublings)
            for name in ("w", "r", "noise", "sample", "step", "first", "jump"):
                guess, value = getattr(found, name), getattr(proven, name)
                assert guess.shape == value.shape
                assert guess == pytest.approx(value, rel=2e-4, abs=1e-9), name
                assert (guess <= value * (1 + 1e-9)).all()
            assert (found.jump > 0).any() == (jumps is not None)


# what is before the periods that are summed, and roundings


@pytest.mark.parametrize("lipschitz", [0.5, None])
def test_what_is_before_the_periods_that_are_summed_is_bounded(lipschitz):
    """After 16 periods a fifth is left: fewer periods never say less."""
    with flint.ctx.workprec(DRIVE_BITS):
        jumps = (rational(1.0), rational(0.35))
        smooth = None if lipschitz is None else rational(lipschitz)
        drive = replace(
            late_drive("0.5"),
            jumps=jumps,
            lipschitz=smooth,
            desired=flint.arb_mat([[1, 0], [1, 1]]),
        )
        period = one_period(drive, (1, 2))
        rows = output_rows(period)[::4] + output_rows(period)[-2:]
        short, long = (output_gains(period, rows, d) for d in (4, 8))
        for name in ("w", "r", "noise", "sample", "step", "first", "jump"):
            few, many = getattr(short, name), getattr(long, name)
            assert (few >= many * (1 - 1e-9) - 1e-200).all() and (few <= 20 * many + 1e-9).all()
        often = replace(drive, jumps=(rational(1.0), rational(0.1)))  # in every period
        of_each = output_gains(one_period(often, (1, 2)), rows, 4)
        assert of_each.jump == pytest.approx(of_each.sample, rel=1e-9)
        assert (short.old > 1e-3 * short.w).all() and (long.old < 1e-6 * long.w).all()
        lagged = [lag_gains(period, rows, d) for d in (4, 8)]
        few, many = (g.running + g.lags.sum(axis=0) + g.tail for g in lagged)
        assert (few >= many * (1 - 1e-9) - 1e-200).all() and (few <= 20 * many + 1e-9).all()
        nw = period.drive.W.ncols()
        assert few[:, :nw] == pytest.approx(short.w, rel=1e-6)
        few, many = (pulse_gains(period, rows, d) for d in (4, 8))
        assert (few >= many * (1 - 1e-9) - 1e-200).all() and (few <= 20 * many + 1e-9).all()
        few, many = (partly_cancelled(period, rows, d) for d in (4, 8))
        assert (few >= many * (1 - 1e-9) - 1e-200).all() and (few <= 20 * many + 1e-9).all()


def test_the_reference_counts_by_its_smallest_level():
    """Of every level what stands still, the running period, and all periods before it."""
    with flint.ctx.workprec(DRIVE_BITS):
        drive = replace(late_drive("0.5", 2), desired=flint.arb_mat([[1, 0, 0], [1, 1, 2]]))
        period = one_period(drive, (1, 2))
        every = output_rows(period)
        rows = every[::3] + every[-2:]
        found = partly_cancelled(period, rows, 8)
        levels = levels_of(period)
        assert len(levels) == 3
        assert (
            partly_cancelled(replace(period, drive=replace(drive, desired=None)), rows, 8) is None
        )
        M, J = middles(period.map), len(period.cells)
        whole = reference_columns(period, levels, J)
        expected = np.zeros((len(rows), len(levels)))
        for i, row in enumerate(rows):
            line = flint.arb_mat([list(row.row)])
            if row.phase:
                seen = reference_columns(period, levels, row.phase)
                values = middles(line * seen.all())[:, None]
                sums = sums_over_time(seen, values, 0 * values[:, 0])
                expected[i] += _sized(period, levels, seen, row.phase, sums)[0]
            at = middles(line * (period.since_jump(row.phase)[-1] * period.jump))[0]
            past = np.array([at @ np.linalg.matrix_power(M, k) for k in range(256)])
            values = (past @ middles(whole.all()))[None]
            sums = sums_over_time(whole, values, 0 * values[:, 0])
            expected[i] += _sized(period, levels, whole, J, sums)[0]
        expected += _still(period, levels, rows)
    assert found == pytest.approx(expected.min(axis=1), rel=1e-6)
    assert (found >= expected.min(axis=1) * (1 - 1e-9)).all()
    assert (expected.max(axis=1) > 1.001 * expected.min(axis=1)).any()


@pytest.mark.parametrize(("delay", "cells", "doublings"), [(9, 1, 4), (0, 12, 1), (0, 1, 9)])
def test_sums_of_pulses_count_roundings_of_all_that_is_large(monkeypatch, delay, cells, doublings):
    counts = []

    def counting(values, roundings=8):
        counts.append(roundings)
        return widened(values, roundings)

    monkeypatch.setattr(timing_room, "widened", counting)
    with flint.ctx.workprec(DRIVE_BITS):
        drive = replace(exact_period([1, 1], (1, 1)).drive, delay=rational(delay))
        period = one_period(drive, (1, cells))
        pulse_gains(period, output_rows(period), doublings)
    inner = doublings // 2
    block, blocks = 2**inner, 2 ** (doublings - inner)
    assert len(counts) == blocks + 3
    assert min(counts[:blocks]) >= block + period.size
    assert counts[blocks] >= blocks + period.size + cells + 1
    assert counts[blocks + 1] >= period.size + 1


def test_tables_that_are_too_large_are_refused(monkeypatch):
    """So many numbers as all lags, or all step responses, have."""
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(late_drive("0.5"), (1, 2))
        rows = output_rows(period)[-5:]
        numbers = 2**3 * (5 + period.size) * (2 + 2 + 4 + period.size)
        monkeypatch.setattr(lags_room, "MAX_LAG_NUMBERS", numbers)
        assert len(lag_gains(period, rows, 3).lags) == 8
        monkeypatch.setattr(lags_room, "MAX_LAG_NUMBERS", numbers - 1)
        with pytest.raises(NoCertificate, match="too large, or too slow"):
            lag_gains(period, rows, 3)
        slow = SlowBound(rational(1), (rational(0),) * 2, rational(0), None, rational(0))
        uncertain = tuple(replace(bound, slow=slow) for bound in period.drive.uncertain)
        for parts, most in (((1, 1), 2**3 * 5), ((7, 9), 2**3 * 5)):
            period = one_period(replace(late_drive("0.5"), uncertain=uncertain), parts)
            most *= max(period.size, sum(parts) * 2)
            monkeypatch.setattr(slow_room, "MAX_STEP_NUMBERS", most)
            assert slow_room.StepResponses.of(period, rows, 3).periods == 9
            monkeypatch.setattr(slow_room, "MAX_STEP_NUMBERS", most - 1)
            with pytest.raises(NoCertificate, match="step responses"):
                slow_room.StepResponses.of(period, rows, 3)


def test_step_responses_count_a_rounding_for_each_of_their_terms(monkeypatch):
    counts = []

    def counting(values, roundings=8):
        counts.append(roundings)
        return widened(values, roundings)

    slow = SlowBound(rational(1), (rational(0),) * 2, rational(0), None, rational(0))
    monkeypatch.setattr(slow_room, "widened", counting)
    with flint.ctx.workprec(DRIVE_BITS):
        for delay in ("0.5", "9.5"):
            drive = late_drive(delay)
            uncertain = tuple(replace(bound, slow=slow) for bound in drive.uncertain)
            period = one_period(replace(drive, uncertain=uncertain), (1, 1))
            counts.clear()
            found = slow_room.StepResponses.of(period, output_rows(period)[:5], 1)
            *of_cells, error, bend, overshoot = counts
            assert (found.begin[:, 0, 0] == 0).all()
            with monkeypatch.context() as large:  # as if roundings were
                large.setattr(slow_room, "ROUNDOFF", 2.0**-10)
                rounded = slow_room.StepResponses.of(period, output_rows(period)[:5], 1)
            every = np.abs(found.end - found.begin).sum(axis=(1, 2))
            lost = 2 * (3 * len(period.cells) + 8) * 2.0**-10 * every
            assert rounded.error - found.error == pytest.approx(lost, rel=1e-6)
            assert min(of_cells) >= 3 and error >= 3
            assert bend >= found.periods + period.size and overshoot >= period.size
            counts.clear()
            found.measures(0, np.ones(3), np.zeros(5), 1)
            assert len(counts) == 3 and counts[0] >= 3 + 2
            assert counts[1] >= 3 * 2 + 4 and counts[2] >= 3 + 1


def test_half_spaces_count_a_rounding_for_each_of_their_states(monkeypatch):
    for n in (1, 30):
        counts = []
        monkeypatch.setattr(
            polytope_room,
            "widened",
            lambda v, k=8, counts=counts: counts.append(k) or widened(v, k),
        )
        ones = np.ones((2, n))
        polytope_room.half_spaces(ones, 0 * ones, np.ones(2), np.array([[-1.0, 1.0]] * n))
        assert counts.pop() >= n + 3


def test_at_least_one_cell_is_tried_and_no_more_than_the_work_allows(monkeypatch):
    period = exact_period([0, 1], (1, 1))
    plant = SimpleNamespace(box="box", drive=lambda box, delay: period.drive)
    monkeypatch.setattr(cover_room, "one_period", lambda drive, parts: period)
    for work, effort, cells in (
        (1e12, "default", 1),
        (1e12, "high", 1),
        (2e8, "default", 10),
        (2e8, "high", 40),
        (1.0, "default", 48),
        (1.0, "high", 192),
        (1.0, "fast", 1),
    ):
        monkeypatch.setattr(cover_room, "_work_of", lambda _, work=work: work)
        assert cover_room.cells_allowed(plant, 1, effort) == cells

    def unstable(_):
        raise NoCertificate("it is unstable")

    monkeypatch.setattr(cover_room, "_work_of", unstable)
    assert cover_room.cells_allowed(plant, 1, "default") == 48


@pytest.mark.parametrize(("delay", "doublings"), [("0", 4), ("9", 6)])
def test_sums_over_few_periods_count_their_roundings(monkeypatch, delay, doublings):
    """Of few blocks, or of entries that are many beside them; of levels, each derivative's."""
    counts = []

    def counting(values, roundings=8):
        counts.append(roundings)
        return widened(values, roundings)

    monkeypatch.setattr(gains_room, "widened", counting)
    monkeypatch.setattr(levels_room, "widened", counting)
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(
            replace(late_drive(delay), desired=flint.arb_mat([[1, 0], [1, 1]])), (1, 1)
        )
        rows = output_rows(period)[-2:]
        output_gains(period, rows, doublings)
        assert min(counts) >= 3 and max(counts) >= period.size
        counts.clear()
        partly_cancelled(period, rows, doublings)
        assert min(counts) >= 3


@pytest.mark.parametrize(("q", "of_error"), [(0, 4), (2, 4), (3, 4), (4, 5)])
def test_outputs_are_polynomials_of_the_degrees_that_the_page_of_files_states(q, of_error):
    """3 of e_1, at least q; 2 of the states: so many rows in each cell, and of u one each."""
    with flint.ctx.workprec(DRIVE_BITS):
        rows = output_rows(exact_period([1] * (q + 2), (1, 2), n=2))
    for p in range(2):
        found = [row.output for row in rows if row.phase == p]
        assert found == [0] * of_error + [1] * 3 + [2] * 3 + [3, 4] * (p == 0) or p == 0
        assert [found.count(k) for k in range(5)] == [of_error, 3, 3, *[int(p == 0)] * 2]
        shares = [row.share for row in rows if row.phase == p and row.output == 0]
        assert shares == [flint.fmpq(i, of_error - 1) for i in range(of_error)]


def test_errors_of_products_count_once_and_not_in_every_block(monkeypatch):
    """The sums of the values have none; those of the errors stand beside them."""
    asked = []

    def noted(columns, values, error):
        asked.append((np.abs(values).max(), error.max()))
        return sums_over_time(columns, values, error)

    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(late_drive("0.5"), (1, 2))
        rows = output_rows(period)
        past = PastRows.of_outputs(period, rows, 4)
        columns = kernel_columns(period, len(period.cells), True)
        monkeypatch.setattr(gains_room, "sums_over_time", noted)
        gains_room.sums_of_periods(period, columns, past, 4)
    *of_blocks, of_errors = asked
    assert len(of_blocks) == 4 and all(v > 0 and error == 0 for v, error in of_blocks)
    assert of_errors[0] == 0 < of_errors[1]


def test_half_spaces_lose_what_their_products_may_round(monkeypatch):
    """As if roundings were large: off by 4 (n + 4) of them, and limits by 4 of their sizes."""
    unit = 2.0**-10
    monkeypatch.setattr(polytope_room, "ROUNDOFF", unit)
    rng = np.random.default_rng(4)
    rows, error = rng.uniform(-1, 1, (5, 3)), rng.uniform(0, 1e-3, (5, 3))
    region = np.array([[-1.0, 2.0], [-3.0, 1.0], [-0.5, 0.25]])
    size, limits = np.array([2.0, 3.0, 0.5]), np.array([0.5, -0.25, 0.125, 0.75, -0.5])
    kept, found = polytope_room.half_spaces(rows, error, limits, region)
    off = error @ size + 4 * 7 * unit * (np.abs(rows) @ size)
    expected = limits - off - 4 * unit * (np.abs(limits) + off)
    assert (kept == rows).all() and found == pytest.approx(expected, rel=1e-12)
    reach = np.where(rows > 0, rows * region[:, 1], rows * region[:, 0]).sum(axis=1)
    slack = 4 * 7 * unit * (np.abs(rows) @ size)
    for part, needed in ((0.99, True), (1.01, False)):
        room = (reach + part * slack + 4 * 7 * unit * (np.abs(rows) @ size)) / (1 - 4 * unit)
        room += 4 * unit * 4 * 7 * unit * (np.abs(rows) @ size) / (1 - 4 * unit)
        assert (room > 0).all()
        kept, _ = polytope_room.half_spaces(rows, 0 * error, room, region)
        assert len(kept) == (5 if needed else 0)


def test_products_with_a_matrix_lose_what_they_may_round(monkeypatch):
    unit = 2.0**-10
    monkeypatch.setattr(start_room, "ROUNDOFF", unit)
    rng = np.random.default_rng(5)
    a, b = (Enclosed(rng.uniform(-1, 1, s), rng.uniform(0, 0.1, s)) for s in ((2, 3, 4), (4, 2)))
    found = _product_with(a, b)
    p, q = np.abs(a.value), np.abs(b.value)
    expected = 2 * (4 + 4) * unit * (p @ q) + p @ b.error + a.error @ (q + b.error)
    assert found.error == pytest.approx(expected, rel=1e-12)
    assert found.value == pytest.approx(a.value @ b.value)

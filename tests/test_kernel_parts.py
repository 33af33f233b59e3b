"""Peak gains part by part: cells of a quadrature, roundings of products, the proven decay."""

import math
from fractions import Fraction
from types import SimpleNamespace

import flint
import numpy as np
import pytest

from certrack.certificates.arithmetic import rational
from certrack.certificates.balls import ball_matrix
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.ranges import kernels
from certrack.certificates.ranges.kernels import (
    CELLS,
    FIRST_CELL,
    LATER_CELLS,
    LEAST_STATE_SIZE,
    PRECISION,
    SMALL,
    UNDERFLOW,
    _block,
    _doublings,
    _roots,
    _sizes,
    _steps,
    _values,
    peak_gains,
    proven_decay,
    rounded,
)
from certrack.certificates.ranges.peak import TOO_MUCH_GAIN, UNBOUNDED, _bound, _responses

UNIT = np.finfo(float).eps / 2  # what a float loses at most, not what the module takes it for


def exact(rows):
    table = [[rational(Fraction(str(v))) for v in row] for row in rows]
    return np.array(table, dtype=object).reshape(len(rows), -1)


def block(k, h=0.5, error=0.0, areas=0.0, curvature=0.0):
    """The integral over the cells between these values, of one row and one column."""
    count = len(k)
    full = [np.full((n, 1, 1), v) for n, v in ((count, error), (count - 1, areas))]
    bent = np.full((count - 1, 1, 1), curvature)
    return _block(h, np.array(k, dtype=float).reshape(-1, 1, 1), full[0], full[1], bent).item()


def test_where_a_kernel_keeps_its_sign_its_area_counts():
    assert block([1.0, 2.0], areas=0.7) == 0.7
    assert block([-1.0, -2.0, -1.0], areas=0.7) == 1.4
    bent = 1.0 * 8 / 0.25  # the line's least value over h^2/8
    assert block([1.0, 2.0], areas=0.7, curvature=0.999 * bent) == 0.7
    assert block([1.0, 2.0], areas=0.7, curvature=1.001 * bent) > 0.75
    assert block([1.0, 2.0], error=0.999, areas=0.7) == 0.7
    assert block([1.0, 2.0], error=1.001, areas=0.7) > 1.2


def test_elsewhere_the_absolute_line_counts_and_what_the_kernel_is_off_it():
    line = (1 + 4) / (1 + 2) * 0.5 / 2  # of -1 to 2 over a cell of 1/2
    assert block([-1.0, 2.0]) == pytest.approx(line, rel=1e-14)
    assert block([-1.0, 2.0], curvature=3.0) == pytest.approx(line + 3 * 0.125 / 12, rel=1e-14)
    assert block([0.0, 2.0]) == block([-2.0, 0.0]) == pytest.approx(0.5)
    assert block([0.0, 0.0], curvature=12.0) == pytest.approx(0.125)
    wide = (1.25**2 + 2.25**2) / (0.75 + 1.75) * 0.25
    assert block([-1.0, 2.0], error=0.25) == pytest.approx(wide)
    assert block([-1.0, 2.0], error=1.5) == pytest.approx((2.5 + 3.5) * 0.25)
    assert block([-1.0, 2.0, -1.0]) == pytest.approx(2 * line)


@pytest.mark.parametrize(("times", "doublings"), [(0.0, 0), (1.0, 0), (1.99, 0), (2.0, 1), (9, 3)])
def test_cells_grow_with_the_time(times, doublings):
    assert _doublings(times * 0.01 / LATER_CELLS, 0.01) == doublings


def test_roots_are_rounded_up():
    square = ball_matrix(exact([[4, 9], [9, 2]]))
    found = _roots(square)
    assert found[0] == pytest.approx(2, rel=1e-14) and found[0] >= 2
    assert Fraction(found[1]) ** 2 >= 2 and found[1] == pytest.approx(math.sqrt(2), rel=1e-14)


def test_products_and_what_their_roundings_are_below():
    rows, columns = np.array([[1.0, -2.0]]), np.array([[3.0], [-0.5]])
    steps = np.array([np.eye(2), [[2.0, 1.0], [-1.0, 0.5]]])
    found, error = _values(rows, steps, columns)
    assert found[:, 0, 0].tolist() == [4.0, 12.0]
    sizes, largest = np.array([4.0, 1 * 6.5 + 2 * 3.25]), 2.0 * np.array([2.0]) * 3.0
    expected = (4 * 2 + 20) * UNIT * sizes + 16 * SMALL * largest + UNDERFLOW
    assert error[:, 0, 0] == pytest.approx(expected, rel=1e-12, abs=0)
    apart = np.array([[[0.0, 0.0], [0.0, 3.0]]])  # what is zero in it was rounded, too
    zero, tiny = _values(np.array([[2.0, 0.0]]), apart, np.array([[0.0], [5.0]]))
    assert zero.item() == 0 and tiny.item() == pytest.approx(16 * SMALL * 30, rel=1e-12, abs=0)
    nothing, floor = _values(0 * rows, steps, columns)
    assert (nothing == 0).all() and (floor == UNDERFLOW).all()


def test_balls_become_floats_if_they_are_narrow():
    assert UNIT == kernels.UNIT  # as 1 + UNIT is 1 and 1 + 2 UNIT is not
    with flint.ctx.workprec(PRECISION):
        third = flint.arb(1) / 3
        found = rounded(flint.arb_mat([[third, 0, flint.arb(0, 1e-41)]]))
        assert found.tolist() == [[1 / 3, 0.0, 0.0]]
        narrow = flint.arb(1, 0.9 * UNIT)
        assert rounded(flint.arb_mat([[narrow]])).item() == 1.0
        for wide in (flint.arb(1, 1.1 * UNIT), flint.arb(0, 1e-30)):
            with pytest.raises(NoCertificate, match="too stiff"):
                rounded(flint.arb_mat([[flint.arb(1), wide]]))


def test_exponentials_at_the_ends_of_cells():
    with flint.ctx.workprec(PRECISION):
        found = _steps(ball_matrix(exact([[-1, 0], [0, "-0.5"]])), rational(Fraction(1, 10)))
    assert found.shape == (CELLS + 1, 2, 2)
    j = np.arange(CELLS + 1)
    assert found[:, 0, 0] == pytest.approx(np.exp(-0.1 * j), rel=1e-15)
    assert found[:, 1, 1] == pytest.approx(np.exp(-0.05 * j), rel=1e-15)
    assert (found[:, 0, 1] == 0).all() and (found[:, 1, 0] == 0).all()


def test_states_have_the_size_that_the_columns_give_them():
    M = np.diag([-1.0, -1.0, -4.0])
    assert _sizes(M, np.array([[1.0], [10.0], [6.0]])) == pytest.approx([1, 10, 3])
    both = np.array([[1.0, 1.0], [10.0, 2.0], [2.0, 6.0]])
    assert _sizes(M, both) == pytest.approx([1, 10, 3])
    assert _sizes(M, np.array([[1.0], [0.0], [0.5 * LEAST_STATE_SIZE]])).tolist() == [1, 1, 1]
    assert _sizes(M, np.array([[0.0], [1.0], [1.0]])).tolist() == [1, 1, 1]


OSCILLATOR = [[0, 1], ["-1.01", "-0.2"]]  # poles -0.1 +- i


@pytest.mark.parametrize("M", [[[-2]], OSCILLATOR, [[-1, 5], [0, -3]]])
def test_the_decay_that_is_proven_bounds_the_kernel(M):
    n = len(M)
    matrix, one = exact(M), exact(np.eye(n, dtype=int))
    with flint.ctx.workprec(PRECISION):
        decay = proven_decay(matrix, one)
        left, right = decay.left(ball_matrix(one)), decay.right(ball_matrix(one))
    slowest = -np.linalg.eigvals(matrix.astype(float)).real.max()
    assert float(decay.mu) == pytest.approx(slowest / 2)
    product = decay.P * decay.inverse
    assert all(product[i, j].contains(int(i == j)) for i in range(n) for j in range(n))
    values, basis = np.linalg.eig(matrix.astype(float))
    for t in (0.0, 0.1, 1.0, 7.0, 30.0):
        kernel = (basis @ np.diag(np.exp(values * t)) @ np.linalg.inv(basis)).real
        assert (np.abs(kernel) <= np.outer(left, right) * math.exp(-float(decay.mu) * t)).all()
    assert left[0] * right[0] == pytest.approx(1) or n > 1


def test_peak_gains_that_are_known():
    scalar = peak_gains(exact([["-0.5"]]), exact([[3], [-1]]), exact([[2, "0.25"]]))
    known = np.array([[12.0, 1.5], [4.0, 0.5]])
    assert (scalar >= known).all() and scalar == pytest.approx(known, rel=1e-7)
    pole, one = 0.1, exact([[1, 0]])
    ring = peak_gains(exact(OSCILLATOR), one, exact([[0], [1]])).item()
    known = 1 / (1 + pole**2) / math.tanh(pole * math.pi / 2)  # of e^{-pole t} |sin t|
    assert known <= ring <= known * (1 + 1e-4)
    chain = peak_gains(exact([[-1, 5], [0, -3]]), one, exact([[0], [1]])).item()
    assert 5 / 3 <= chain <= 5 / 3 * (1 + 1e-6)
    assert peak_gains(exact([[-1]]), exact([[1]]), np.zeros((1, 0), dtype=object)).shape == (1, 0)


def test_a_loop_that_is_too_stiff_is_given_up(monkeypatch):
    monkeypatch.setattr(kernels, "MAX_BLOCKS", 3)
    with pytest.raises(NoCertificate, match="too stiff"):
        peak_gains(exact([["-0.001", 0], [0, -100]]), exact([[1, 1]]), exact([[1], [1]]))


@pytest.mark.parametrize(("later", "level"), [(0.25, 0), (1.0, 1)])
def test_what_the_reference_adds_is_the_smaller_of_its_levels(later, level):
    """e' = -7 e + 3 y + y' + 2, z = e + y/2 + 1/4, |y| <= 10 and |y'| <= 20."""
    form = SimpleNamespace(M=exact([[-7]]), W=exact([[3, 1]]), offset=exact([[2]])[0])
    outputs = SimpleNamespace(C=exact([[1]]), D=exact([["0.5", 0]]), offset=exact([["0.25"]])[0])
    seen = []

    def gains_of(M, C, B):
        seen.append(B.astype(float).tolist())
        return np.array([[0.1, 0.2, 0.3, later]])

    bounds = [rational(Fraction(10)), rational(Fraction(20))]
    found, gains, levels = _responses(
        form, outputs, bounds.__getitem__, [exact([[5]])[0]], gains_of
    )
    (shown,) = seen  # the column, 3, 1 - 3/7 behind the motion at rest, and 1
    assert shown == [pytest.approx([5, 3, 4 / 7, 1])]
    at_rest = Fraction(2, 7) + Fraction(1, 4)
    still = [Fraction(5), (Fraction(3, 7) + Fraction(1, 2)) * 10]
    moving = [0.2 * 10 + later * 20, 0.3 * 20]
    totals = [float(a + at_rest) + b for a, b in zip(still, moving, strict=True)]
    assert levels == [level] == [int(np.argmin(totals))] and gains.tolist() == [[0.1]]
    assert found[0] == pytest.approx(min(totals), rel=1e-11) and found[0] > min(totals)
    _, _, none = _responses(
        form, outputs, lambda j: rational(0), [], lambda M, C, B: 0 * gains_of(M, C, B)[:, 1:]
    )
    assert none == [0]


def test_what_the_reference_adds_is_rounded_up():
    form = SimpleNamespace(M=exact([[-7]]), W=exact([[3, 1]]), offset=exact([[2]])[0])
    outputs = SimpleNamespace(C=exact([[1]]), D=exact([[0, 0]]), offset=exact([["0.25"]])[0])
    bound, *_ = _responses(
        form, outputs, lambda j: rational(0), [], lambda M, C, B: np.zeros((1, 3))
    )
    assert Fraction(bound[0]) > Fraction(2, 7) + Fraction(1, 4)
    assert bound[0] == pytest.approx(2 / 7 + 0.25, rel=1e-11)


@pytest.mark.parametrize("rate", [1.0, 3.0])
def test_what_a_block_of_cells_is_told(monkeypatch, rate):
    """k = 2 e^{-rate t}: k'' = rate^2 k at the ends, and rate^3 2 e^{-rate t} h/2 more inside."""
    told = []

    def block(h, k, error, areas, curvature):
        told.append((h, k[:, 0, 0], areas[:, 0, 0], curvature[:, 0, 0]))
        assert (error > 0).all() and (error < 1e-14).all()
        return areas.sum(axis=0)

    monkeypatch.setattr(kernels, "_block", block)
    total = peak_gains(exact([[-rate]]), exact([[2]]), exact([[1]])).item()
    assert 2 / rate <= total <= 2 / rate * (1 + 1e-8)
    t = 0.0
    for h, k, areas, curvature in told:
        assert h == FIRST_CELL / rate * 2 ** _doublings(t, FIRST_CELL / rate)
        ends = 2 * np.exp(-rate * (t + h * np.arange(CELLS + 1)))
        assert k == pytest.approx(ends, rel=1e-12, abs=0)
        assert areas == pytest.approx(-np.diff(ends) / rate, rel=1e-9, abs=1e-13 * ends[0])
        bend = rate**2 * ends[:-1] + h / 2 * rate**3 * ends[0]
        assert curvature == pytest.approx(bend, rel=1e-9, abs=0)
        t += h * CELLS
    assert len(told) > 1 and 2 * math.exp(-rate * t) / rate < 1e-8


def test_a_fixed_point_is_above_that_of_the_loop_and_near():
    """v = c + G v; the first entry, the error, acts on no other, whatever it is."""
    constant = np.array([2.0, 1.0, 3.0])
    assert 2.0 < _bound(lambda v: constant[:1], 1) <= 2.0 * (1 + 1e-11)
    for gain in (0.0, 0.1, 0.9, 0.95):
        G = np.array([[0.0, 7.0, 5.0], [0.0, gain, 0.2], [0.0, 0.0, gain]])
        known = np.linalg.solve(np.eye(3) - G, constant)[0]
        assert known < _bound(lambda v, G=G: constant + G @ v, 3) <= known * (1 + 1e-7)
    assert 50 < _bound(lambda v: 1 + 0.98 * v, 2) <= 50 * (1 + 1e-7)
    for beyond in (1.0, 2.0):  # what the image is cut off at is no bound
        at_the_limit = iter([np.array([0.5 * UNBOUNDED, 1.0])] * 2)
        cut = np.array([beyond * UNBOUNDED, 1.0])
        with pytest.raises(NoCertificate, match=TOO_MUCH_GAIN):
            _bound(lambda v, it=at_the_limit, cut=cut: next(it, cut), 2)
    for gain in (1.0, 1.5):
        with pytest.raises(NoCertificate, match=TOO_MUCH_GAIN):
            _bound(lambda v, gain=gain: np.minimum(1 + gain * v, UNBOUNDED), 2)
    assert _bound(lambda v: 0.5 * v, 3) < 1e-250  # where nothing acts
    for high in (UNBOUNDED, 2 * UNBOUNDED):
        with pytest.raises(NoCertificate, match=TOO_MUCH_GAIN):
            _bound(lambda v, high=high: np.array([high, 1.0]), 2)

"""Bounds from a start, part by part: constants, jumps and what is left of a start."""

import math
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from test_fixed_point_parts import q
from test_slow_parts import no_less

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import from_starts, start, start_proof, start_set
from certrack.certificates.implemented.enclosed import Enclosed, widened
from certrack.certificates.implemented.from_starts import StartBounds
from certrack.certificates.implemented.input_limits import InputLimits
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.implemented.start import FromStarts
from certrack.certificates.implemented.start_proof import StartProver

#: Of two rows by w, r, noise, sample, step, first.
RUNNING = np.array([[9.0, 0.1, 0.2, 0.3, 0.4, 0.5], [9.0, 0.6, 0.7, 0.8, 0.9, 1.0]])
LAGS = np.array([RUNNING * 2, RUNNING * 3])
TAIL = RUNNING / 10


def frame(lipschitz=None):
    """Two lags, one w, one measured state; Y = (1, 2, 5), mu = 3, eta = 7, T = 1/2."""
    made = object.__new__(FromStarts)
    made._affine = None
    made.drive = SimpleNamespace(
        Y=[q(1), q(2), q(5)], lipschitz=lipschitz, mu=[q(3)], eta=q(7), T=q("0.5"), n=1
    )
    made.gains = SimpleNamespace(running=RUNNING, lags=LAGS, tail=TAIL)
    made.period, made.rows, made.count = None, ["first", "second"], 2
    made._of_r = np.array([0.25, 0.5])
    return made


@pytest.mark.parametrize(("lipschitz", "sample"), [(None, 5.0), (q(8), 2.0)])
def test_constants_are_added_period_by_period(monkeypatch, lipschitz, sample):
    """r and first times Y_2, noise mu, sample by its bound, steps eta; the rest of Y at rest."""
    at_rest = {"first": [q("0.5"), q(1)], "second": [q(2), q(0)]}
    monkeypatch.setattr(start, "steady", lambda period, row: at_rest[row])
    made = frame(lipschitz)
    made._set_constants(1)
    bounds = np.array([5.0, 3.0, sample, 7.0, 5.0])
    running = RUNNING[:, 1:] @ bounds + made._of_r * 5 + [0.5 * 1 + 1 * 2, 2 * 1]
    one, two = (lag[:, 1:] @ bounds for lag in LAGS)
    assert no_less(made._constant, np.array([running, running + one]))
    assert no_less(made._constant_later, running + one + two + TAIL[:, 1:] @ bounds)
    assert made._sample_column == 3


@pytest.mark.parametrize(("apart", "lags"), [(1, 5.0), (2, 3.0), (None, 3.0), (9, 3.0)])
def test_jumps_add_the_largest_sample_of_so_many_periods(apart, lags):
    made = frame()
    made._sample_column = 3
    jumping = made._jumping(SimpleNamespace(jump=q("0.25"), jumps_apart=apart))
    assert no_less(jumping, 0.25 * (lags + 0.1) * RUNNING[:, 3])
    assert made._jumping(SimpleNamespace(jump=None, jumps_apart=apart)) == 0.0


def test_a_start_is_forgotten_by_its_largest_later_entry():
    """zeta = (1, 2) grows to (3, 2) at most; M^L (3, 2) = (0.7, 0.2), and shrinks from there."""
    made = frame()
    made.period = SimpleNamespace(size=2)
    powers = np.array([np.eye(2), [[1.0, 1.0], [0.0, 0.5]]])
    before = Enclosed(np.array([[[1.0, -2.0]], [[4.0, 1.0]]]), np.full((2, 1, 2), 0.25))
    last = np.array([[0.1, 0.2], [0.0, 0.1]])
    made.gains = SimpleNamespace(powers=powers, before=before, last=last)
    found = made._later_transient(np.array([1.0, 2.0]))
    assert no_less(found, [max(1.25 * 0.7 + 2.25 * 0.2, 4.25 * 0.7 + 1.25 * 0.2)])
    made.gains.last = np.array([[1.1, 0.0], [0.0, 0.1]])
    with pytest.raises(NoCertificate, match="not forgotten"):
        made._later_transient(np.array([1.0, 2.0]))


def test_a_loop_that_forgets_everything_has_nothing_left_of_its_start():
    """M^K = 0, as of a dead-beat loop: what stays below zero times anything is zero."""
    made = frame()
    made.period = SimpleNamespace(size=2)
    powers = np.array([np.eye(2), [[0.0, 1.0], [0.0, 0.0]]])
    before = Enclosed(np.array([[[1.0, -2.0]], [[4.0, 1.0]]]), np.zeros((2, 1, 2)))
    made.gains = SimpleNamespace(powers=powers, before=before, last=np.zeros((2, 2)))
    (left,) = made._later_transient(np.array([1.0, 2.0]))
    assert 0 <= left < 1e-290
    made.gains.last = np.array([[0.5, 0.0], [0.0, 0.5]])
    (left,) = made._later_transient(np.zeros(2))  # nor has one that nothing begins with
    assert 0 <= left < 1e-270


def test_all_memories_begin_with_what_is_measured():
    """Two states, three memories: x(0), F x(0), and commands that have not been sent."""
    first = [[1, 2], [3, 4], [5, 6]]
    drive = SimpleNamespace(n=2, memories=3, first=flint.fmpq_mat(first))
    Z, of_noise = start.first_state(drive, 7)
    rows = [[float(v) for v in row] for row in Z.tolist()]
    assert rows == [[1, 0], [0, 1], *first, [0, 0], [0, 0]]
    noise = [[float(v) for v in row] for row in of_noise.tolist()]
    assert noise == [[0, 0], [0, 0], *first, [0, 0], [0, 0]]


#: Two states; rows of e_1 (two of them), x_1, x_2, u and its step.
OUTPUTS = np.array([0, 0, 1, 2, 3, 4])


def loop_of_two(K=3):
    """A frame with an uncertain term of size 0.1 ||(x_1, 2 x_2)|| + 0.2 |x_2| + 0.3."""
    rng = np.random.default_rng(6)
    made = object.__new__(FromStarts)
    made._affine = None
    made.drive = SimpleNamespace(
        sized=2, W=SimpleNamespace(ncols=lambda: 1), uncertain=[SimpleNamespace(growing=None)]
    )
    made.count, made.outputs, made.rows = K, OUTPUTS, list(OUTPUTS)
    made.begins = np.searchsorted(OUTPUTS, np.arange(5))
    made._growth = tuple(map(np.array, ([[0.1]], [[0.3]], [[1.0, 2.0]], [[0.0, 0.2]])))
    made._w = rng.uniform(0.05, 0.2, (K, 6, 1))
    made._by_lag = np.ascontiguousarray(made._w.swapaxes(0, 1).reshape(6, -1))
    made._running_w = rng.uniform(0.1, 0.3, (6, 1))
    made._of_x, made._of_u = rng.uniform(0.01, 0.1, (6, 2)), rng.uniform(0.01, 0.1, 6)
    made._constant, made._constant_later = rng.uniform(0.1, 1, (K, 6)), rng.uniform(0.5, 1, 6)
    made.gains = SimpleNamespace(tail=rng.uniform(0.01, 0.05, (6, 4)))
    made._jumping = lambda starts: starts.jump
    return made


STARTS = SimpleNamespace(
    center=(q(-1), q("0.5")), half=(q("0.25"), q(0)), initial=flint.arb(-2), jump=0.125
)


def size_of(X):
    return 0.1 * np.hypot(X[0], 2 * X[1]) + 0.2 * X[1] + 0.3


def test_sizes_of_uncertain_terms_are_their_formula():
    made = loop_of_two()
    for X in (np.array([3.0, 2.0]), np.array([0.0, 1.0]), np.zeros(2)):
        assert no_less(made.sizes(X), [size_of(X)])
    made.drive.uncertain = [
        SimpleNamespace(growing=SimpleNamespace(largest_float=lambda X, norm: X[1] + 10 * norm))
    ]
    assert no_less(made.sizes(np.array([3.0, 2.0])), [2 + 50])
    made._growth = (np.zeros((0, 1)),) * 4
    assert made.sizes(np.zeros(2)).tolist() == []
    assert made.largest(np.array([1.0, 7, 3, 4, 5, 6])).tolist() == [7, 3, 4, 5, 6]


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_periods_follow_one_after_the_other(size):
    """X(k) is just above its own right-hand side, with w of lag j by the states of k - 1 - j."""
    made = loop_of_two()
    transient = SimpleNamespace(size=size * np.random.default_rng(7).uniform(0, 1, (3, 6)))
    run = made.run(STARTS, transient)
    X, U = run.bounds[:, 1:3], 2.0
    for k in range(3):
        base = made._constant[k] + 0.125
        base = base + sum(made._w[j, :, 0] * size_of(X[k - 1 - j]) for j in range(k))
        assert no_less(run.forced[k], base[4:])
        base = base + transient.size[k]
        U = max(U, base[4])
        values = base + made._of_u * U + made._running_w[:, 0] * size_of(X[k]) + made._of_x @ X[k]
        expected = made.largest(values)
        assert (run.bounds[k] >= expected).all()
        assert run.bounds[k, [0, 3, 4]] == pytest.approx(expected[[0, 3, 4]], rel=1e-7)
        assert (X[k] <= 1.05 * expected[1:3]).all()  # where the iteration stops
        assert (X[k] > expected[1:3]).all()


def test_a_period_without_a_bound_is_refused():
    made = loop_of_two()
    made._of_x = made._of_x + np.array([[0, 0], [0, 0], [1.0, 0], [0, 0], [0, 0], [0, 0]])
    with pytest.raises(NoCertificate, match="no bound in a period"):
        made.run(STARTS, SimpleNamespace(size=np.zeros((3, 6))))


def test_a_bound_beyond_the_floats_is_refused():
    size = np.zeros((3, 6))
    size[:, :2] = np.inf  # of e_1 alone
    with pytest.raises(NoCertificate, match="range of floating point"):
        loop_of_two().run(STARTS, SimpleNamespace(size=size))


@pytest.mark.parametrize("middle", [0, 1, 2, 3])
def test_later_periods_are_bounded_by_what_came_before_and_by_themselves(middle):
    """Lags below K - K1 see the periods from K1 on, the others and the tail see any period."""
    made, rng = loop_of_two(), np.random.default_rng(8)
    transient = SimpleNamespace(later=rng.uniform(0, 1, 6))
    bounds = rng.uniform(1, 3, (3, 5))
    run = SimpleNamespace(bounds=bounds)
    for states, u in (((0.5, 4.0), 0.1), ((2.0, 0.0), 9.0)):
        later = start.Later(states, u)
        found = made.later_image(STARTS, transient, run, middle, later)
        X = np.array(states)
        U = max(u, 2.0, bounds[:, 3].max())
        recent = np.maximum(bounds[middle:, 1:3].max(axis=0, initial=0.0), X)
        ever = np.maximum(bounds[:, 1:3].max(axis=0), X)
        near, far = made._w[: 3 - middle, :, 0], made._w[3 - middle :, :, 0]
        values = made._constant_later + transient.later + 0.125
        values = values + near.sum(axis=0) * size_of(recent)
        values = values + (far.sum(axis=0) + made.gains.tail[:, 0]) * size_of(ever)
        values = values + made._running_w[:, 0] * size_of(X) + made._of_x @ X + made._of_u * U
        assert no_less(found, made.largest(values))


def test_what_is_found_for_later_is_above_its_own_image():
    made = loop_of_two()
    transient = SimpleNamespace(size=np.zeros((3, 6)), later=np.full(6, 0.5))
    run = made.run(STARTS, transient)
    later = made.find_later(STARTS, transient, run, 1)
    image = made.later_image(STARTS, transient, run, 1, later)
    assert start.is_above(later, image)
    assert [*later.states, later.input] == pytest.approx(image[1:4], rel=3e-6)
    made._of_x = made._of_x + np.array([[0, 0], [0, 0], [1.0, 0], [0, 0], [0, 0], [0, 0]])
    with pytest.raises(NoCertificate, match="no bound was found"):
        made.find_later(STARTS, transient, run, 1)


@pytest.mark.parametrize("known", [True, False])
def test_what_a_start_adds_to_the_rows(monkeypatch, known):
    """One plant state, a memory of it and of the input, and one command: chi = (x, y, u).

    x(0) = 2 +- 1, the input before is 4, the sensor's error 3; Pi = (1, 2, 3) y_d(0), y_d(0) = 5.
    """
    made = frame()
    made.drive = SimpleNamespace(
        n=1,
        memories=1,
        mu=[q(3)],
        Y=[q(5), q(7)],
        first=flint.fmpq_mat([[q("0.5")]]),
        first_input=flint.fmpq_mat([[q("0.25")]]),
    )
    pi = flint.arb_mat([[1], [2], [3]])
    made.period = SimpleNamespace(size=3, command=2, drive=made.drive, Pi=[0 * pi, pi])
    rows = np.array([[[1.0, -2.0, 4.0], [0.0, 1.0, 0.0]], [[0.5, 0.0, 1.0], [0.0, 0.0, 2.0]]])
    made.gains = SimpleNamespace(before=Enclosed(rows, np.zeros(rows.shape)))
    seen = []
    made._later_transient = lambda zeta: seen.append(zeta) or "later"
    starts = SimpleNamespace(
        center=(q(2),), half=(q(1),), Y=(flint.arb(5),) if known else None, initial=flint.arb(4)
    )
    found = made.transient(starts)
    reference = np.array([5.0, 10.0, 15.0])
    fixed = np.array([0.0, 0.25 * 4, 4.0]) - (reference if known else 0)
    Z, noise = np.array([1.0, 0.5, 0.0]), np.array([0.0, 0.5 * 3, 0.0])
    free = np.abs(rows @ noise) + (0 if known else np.abs(rows @ reference))
    assert found.later == "later" and found.of_x0.value[:, :, 0] == pytest.approx(rows @ Z)
    assert found.fixed.value == pytest.approx(rows @ fixed)
    assert no_less(found.free, free)
    assert no_less(found.size, np.abs(rows @ (fixed + 2 * Z)) + np.abs(rows @ Z) + free)
    (zeta,) = seen
    start_free = noise if known else noise + reference
    assert no_less(zeta, np.abs(fixed + 2 * Z) + Z + start_free)
    counts = []
    monkeypatch.setattr(start, "widened", lambda v, k=8: counts.append(k) or widened(v, k))
    made.transient(starts)
    assert len(counts) >= 5 and min(counts) >= 3


def test_what_is_left_to_the_limits_of_the_input_and_of_its_steps(monkeypatch):
    """end - sign fixed - forced of every period, with forced of the run, free and its error off."""
    rng = np.random.default_rng(9)
    K, n = 3, 2
    of_x0 = Enclosed(rng.normal(size=(K, 6, n)), rng.uniform(0, 1e-3, (K, 6, n)))
    fixed = Enclosed(rng.normal(size=(K, 6)), rng.uniform(0.1, 1, (K, 6)))
    transient = SimpleNamespace(of_x0=of_x0, fixed=fixed, free=rng.uniform(0, 1, (K, 6)))
    run = SimpleNamespace(forced=rng.uniform(0, 1, (K, 2)))
    frame = SimpleNamespace(begins=np.array([0, 2, 3, 4, 5]))
    limits = SimpleNamespace(low=q(-7), high=q(9), step=q(4))
    evidence = SimpleNamespace(run=run, transient=transient, frame=frame)
    within = [True]
    prover = SimpleNamespace(
        system=SimpleNamespace(plant=SimpleNamespace(states=("x1", "x2"))),
        drive=SimpleNamespace(sized=n),
        evidence=lambda proof: evidence,
        within_later=lambda found: within[0],
    )
    monkeypatch.setattr(start_proof, "input_limits", lambda system, drive: limits)
    monkeypatch.setattr(start_proof, "half_spaces", lambda *parts: parts)
    monkeypatch.setattr(start_proof, "Polytope", lambda *parts: parts)
    proof = SimpleNamespace(region=((q(-1), q(1)), (q(-2), q(3))))
    table, off, room, region, pairs, states = start_proof.polytope_of(prover, proof)
    assert region.tolist() == [[-1, 1], [-2, 3]]
    assert (pairs, states) == (((-1.0, 1.0), (-2.0, 3.0)), ("x1", "x2"))
    cases = [(0, 4, 1, 9.0), (0, 4, -1, 7.0), (1, 5, 1, 4.0), (1, 5, -1, 4.0)]
    for k, (output, at, sign, end) in enumerate(cases):
        part = slice(k * K, (k + 1) * K)
        assert (table[part] == sign * of_x0.value[:, at]).all()
        assert (off[part] == of_x0.error[:, at]).all()
        forced = run.forced[:, output] + transient.free[:, at] + fixed.error[:, at]
        left = end - sign * fixed.value[:, at] - forced
        assert (room[part] < left).all()
        assert room[part] == pytest.approx(left, abs=1e-12)
    assert len(table) == len(off) == len(room) == 4 * K
    monkeypatch.setattr(start_proof, "ROUNDOFF", 2.0**-10)  # as if roundings were large
    _, _, less, *_ = start_proof.polytope_of(prover, proof)
    for k, (output, at, sign, end) in enumerate(cases):
        part = slice(k * K, (k + 1) * K)
        forced = run.forced[:, output] + transient.free[:, at] + fixed.error[:, at]
        lost = 8 * 2.0**-10 * (end + np.abs(fixed.value[:, at]) + forced)
        left = end - sign * fixed.value[:, at] - forced
        assert less[part] == pytest.approx(left - lost, abs=1e-12)
    within[0] = False
    with pytest.raises(NoCertificate, match="in the long run"):
        start_proof.polytope_of(prover, proof)


def test_what_is_at_rest_stays_there():
    """Where nothing acts a bound is zero, and still one above its own image."""
    made = loop_of_two()
    made._growth = tuple(map(np.array, ([[0.0]], [[0.0]], [[1.0, 2.0]], [[0.0, 0.0]])))
    made._constant, made._jumping = np.zeros((3, 6)), lambda starts: 0.0
    made._constant_later = np.zeros(6)
    at_rest = SimpleNamespace(center=(q(0), q(0)), half=(q(0), q(0)), initial=flint.arb(0))
    transient = SimpleNamespace(size=np.zeros((3, 6)), later=np.zeros(6))
    run = made.run(at_rest, transient)
    assert (run.bounds >= 0).all() and run.bounds.max() < 1e-270
    later = made.find_later(at_rest, transient, run, 1)
    assert min(*later.states, later.input) > 0 and max(*later.states, later.input) < 1e-270


def test_what_is_linear_in_the_states_is_one_matrix():
    """w_1 <= 0.2 x_2 + 0.3; not where its bound has a norm, or a formula, in it."""
    made = loop_of_two()
    made._growth = tuple(map(np.array, ([[0.0]], [[0.3]], [[1.0, 2.0]], [[0.0, 0.2]])))
    kinds = [(q(0), None, True), (q(1), None, False), (q(0), "x1", False), (q(1), "x1", False)]
    for gamma, growing, linear in kinds:
        made.drive.uncertain = [SimpleNamespace(gamma=gamma, growing=growing)]
        made._set_affine()
        assert (made._affine is not None) is linear
        made.drive.uncertain = [SimpleNamespace(gamma=q(0), growing=None), *made.drive.uncertain]
        made._set_affine()  # all of them are
        assert (made._affine is not None) is linear
    made.drive.uncertain = [SimpleNamespace(gamma=q(0), growing=None)]
    made._set_affine()
    by_states, constant = made._affine
    assert no_less(by_states, made._running_w @ [[0.0, 0.2]] + made._of_x)
    assert no_less(constant, made._running_w[:, 0] * 0.3)
    base, X = np.arange(6.0), np.array([3.0, 2.0])
    both = [made._image(base, X)]
    made._affine = None
    made.drive.uncertain = [SimpleNamespace(growing=None)]
    both.append(made._image(base, X))
    assert both[0] == pytest.approx(both[1], rel=1e-12)


@pytest.fixture
def counted(monkeypatch):
    """How many roundings each sum was widened for."""
    counts = []

    def counting(values, roundings=8):
        counts.append(roundings)
        return widened(values, roundings)

    monkeypatch.setattr(start, "widened", counting)
    return counts


def loop_of(n, nw, K):
    """A frame with so many states and uncertain terms, one row for each output."""
    made = object.__new__(FromStarts)
    uncertain = [SimpleNamespace(growing=None, gamma=q(0))] * nw
    made.drive = SimpleNamespace(sized=n, W=SimpleNamespace(ncols=lambda: nw), uncertain=uncertain)
    made.count, made.outputs, made.rows = K, np.arange(n + 3), list(range(n + 3))
    made.begins = np.arange(n + 3)
    made._growth = tuple(1e-3 * np.ones((nw, width)) for width in (1, 1, n, n))
    made._w = 1e-3 * np.ones((K, n + 3, nw))
    made._by_lag = np.ascontiguousarray(made._w.swapaxes(0, 1).reshape(n + 3, -1))
    made._running_w, made._of_x = 1e-3 * np.ones((n + 3, nw)), 1e-3 * np.ones((n + 3, n))
    made._of_u, made._constant = np.zeros(n + 3), np.ones((K, n + 3))
    made._constant_later, made._affine = np.ones(n + 3), None
    made.gains = SimpleNamespace(tail=1e-3 * np.ones((n + 3, nw)))
    made._jumping = lambda starts: 0.0
    return made


@pytest.mark.parametrize(("n", "nw", "K"), [(1, 1, 2), (30, 1, 2), (1, 30, 2), (1, 4, 10)])
def test_bounds_from_a_start_count_a_rounding_for_each_of_their_terms(counted, n, nw, K):
    made = loop_of(n, nw, K)
    made.sizes(np.ones(n))
    assert counted.pop() >= n + 2 and not counted
    made.drive.uncertain = [
        SimpleNamespace(growing=SimpleNamespace(largest_float=lambda X, norm: norm), gamma=q(0))
    ] * nw
    made.sizes(np.ones(n))
    assert len(counted) == nw + 1 and min(counted) >= n + 2
    made.drive.uncertain = [SimpleNamespace(growing=None, gamma=q(0))] * nw
    counted.clear()
    made._image(np.ones(n + 3), np.ones(n))
    assert counted.pop() >= 2 * n + 1  # of terms there is at most one more than of states
    starts = SimpleNamespace(center=(q(1),) * n, half=(q(0),) * n, initial=flint.arb(1))
    transient = SimpleNamespace(size=np.zeros((K, n + 3)), later=np.zeros(n + 3))
    run = made.run(starts, transient)
    assert min(counted) >= 3 and max(counted) >= (K - 1) * nw + 1
    counted.clear()
    made.later_image(starts, transient, run, 1, start.Later((1.0,) * n, 1.0))
    assert min(counted) >= K and counted[-1] >= 3 * nw + n + 5
    counted.clear()
    made._set_affine()
    assert len(counted) == 2 and min(counted) >= nw + 1


def test_constants_from_a_start_count_a_rounding_for_each_of_their_terms(counted, monkeypatch):
    monkeypatch.setattr(start, "steady", lambda period, row: [q(1), q(2)])
    made = frame()
    made._set_constants(1)
    assert len(counted) == 2 and min(counted) >= 2 + 5 + 3 + 2  # lags, inputs, Y and sums
    counted.clear()
    made._jumping(SimpleNamespace(jump=q(1), jumps_apart=1))
    assert counted.pop() >= 2 + 2
    for size in (1, 40):
        counted.clear()
        rows = Enclosed(np.ones((1, 1, size)), np.ones((1, 1, size)))
        start._product_with(rows, Enclosed(np.ones((size, 1)), np.ones((size, 1))))
        assert counted.pop() >= size + 3


@pytest.mark.parametrize(("jumps", "once", "known"), [(None, False, 2), (None, True, 2), (1, 0, 2)])
def test_jumps_from_a_start_are_several_one_or_none(monkeypatch, jumps, once, known):
    asked = []
    monkeypatch.setattr(start_set, "jumps", lambda *parts: asked.append(parts) or (0.5, math.inf))
    drive = SimpleNamespace(
        jumps=None if jumps is None else (q(3), q("0.2")),
        jumps_once=once,
        periods_between_jumps=7,
        q=1,
    )
    found = start_set._jumps(SimpleNamespace(reference="it"), drive)
    assert found == ((q(3), 7) if jumps else (q("0.5"), None) if once else (None, None))
    assert asked == ([("it", known)] if once else [])


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("of", ["x0", "polytope"])
@pytest.mark.parametrize("varied", ["", "region", "amplitude", "frequency"])
def test_the_reference_begins_as_in_the_file_where_that_is_known(monkeypatch, varied, of, known):
    """And for other starts too where no member of the ensemble has another one."""
    monkeypatch.setattr(start_set, "reference_at_start", lambda system, q: ((), known and q == 3))
    monkeypatch.setattr(start_set, "is_regional", lambda system: varied == "region")
    population = {name: 1 if varied == name else None for name in ("amplitude", "frequency")}
    system = SimpleNamespace(varied=SimpleNamespace(**population))
    found = start_set.phase_of(system, SimpleNamespace(q=3), of)
    expected = known and (of == "x0" or not varied)
    assert found == ("file" if expected else "any")


@pytest.mark.parametrize(
    ("size", "step", "met"),
    [(2, 1, ""), ("2.001", 1, "|u|"), (2, "1.001", "steps"), ("2.001", "1.001", "|u|")],
)
def test_peaks_are_held_against_the_limits(monkeypatch, size, step, met):
    limits = InputLimits(q(-2), q(3), q(1))
    monkeypatch.setattr(start_proof, "input_limits", lambda system, drive: limits)
    proof = SimpleNamespace(peaks=("9", "8", "7", str(size), str(step)))
    drive = SimpleNamespace(sized=2, offset=q(-3))
    said = start_proof.limit_met("it", drive, proof)
    assert said.startswith(met) and bool(said) is bool(met)
    if met == "|u|":
        assert "within 5.001 from" in said
    if met == "steps":
        assert "within 1.001 from" in said


@pytest.mark.parametrize(
    ("last", "first", "expected"),
    [(5, None, 5), (9, 6, 9), (13, None, 13), (99, None, 13), (0, None, 5), (7, 8, 8)],
)
def test_periods_are_doubled_until_nothing_falls_and_all_that_is_wanted_holds(
    last, first, expected
):
    """From 5 doublings on, or more where another cell needed more; to 13 at most."""
    tried = []

    def bounds(starts, doublings, middle, later):
        tried.append(doublings)
        assert (starts, middle, later) == ("starts", 2 ** (doublings - 1), None)
        return SimpleNamespace(is_spent=doublings >= 4, number=doublings)

    prover = SimpleNamespace(bounds=bounds)
    begin = () if first is None else (first,)

    def enough(found):
        return found.number >= last

    doublings, found = StartProver.search(prover, "starts", enough, *begin)
    assert (doublings, found.number) == (expected, expected)
    assert tried == list(range(first or 5, expected + 1))


@pytest.mark.parametrize("bounded", [(), (6,), (6, 7, 8), (5, 13)])
def test_periods_without_a_bound_are_passed_over(bounded):
    """The last that had one counts, if what is wanted never holds."""

    def bounds(starts, doublings, middle, later):
        if doublings not in bounded:
            raise NoCertificate(f"none for {doublings}")
        return SimpleNamespace(is_spent=doublings == 7)

    prover = SimpleNamespace(bounds=bounds)
    if not bounded:
        with pytest.raises(NoCertificate, match="none for 13"):
            StartProver.search(prover, "starts", lambda _: True)
        return
    found, _ = StartProver.search(prover, "starts", lambda _: True)
    assert found == (7 if 7 in bounded else bounded[-1])
    never, _ = StartProver.search(prover, "starts", lambda _: False)
    assert never == bounded[-1]


def test_a_start_is_bounded_by_what_is_looked_at_and_what_comes_later():
    asked = []
    run = SimpleNamespace(bounds=np.array([[1.0, 8, 3, 1, 5], [2.0, 7, 1, 2, 4]]))
    image = np.array([1.5, 3.0, 3.5, 2.5, 9.0])
    frame = SimpleNamespace(
        find_later=lambda *parts: asked.append(parts) or start.Later((4.0, 5.0), 3.0),
        later_image=lambda *parts: image.copy(),
    )
    prover = SimpleNamespace(
        frame=lambda doublings: frame,
        _run=lambda starts, doublings: ("transient", run),
        drive=SimpleNamespace(sized=2),
    )
    for initial, of_input in ((-1, 3.0), (-6, 6.0)):
        starts = SimpleNamespace(initial=flint.arb(initial))
        found = StartProver.bounds(prover, starts, 5, 3, None)
        assert asked.pop() == (starts, "transient", run, 3)
        assert found.after.tolist() == [1.5, 4, 5, 3, 9]
        assert no_less(found.peaks, [2, 8, 5, of_input, 9])
    given = start.Later((3.1, 3.6), 2.6)
    assert StartProver.bounds(prover, starts, 5, 3, given).later is given and not asked
    for states, u in (((3.0, 3.6), 2.6), ((3.1, 3.5), 2.6), ((3.1, 3.6), 2.5)):
        with pytest.raises(NoCertificate, match="not above"):
            StartProver.bounds(prover, starts, 5, 3, start.Later(states, u))


# what is said of runs from starts


def test_peaks_of_periods_are_the_largest_of_all():
    values = np.array([[1.0, 2, 3, 4, 5], [5.0, 1, 2, 3, 4]])
    found = StartBounds(0.01, values, np.array([2.0, 9, 1, 3.5, 7]), 0.5).peaks
    assert (found.error, found.states, found.input_step) == (5, (9, 3), 7)
    assert no_less(found.input, 4.5)


def test_peaks_from_x0_are_the_largest_of_all_delays(monkeypatch):
    """Of a plant of two states with a channel: |u| has the constant of the law beside it."""
    monkeypatch.setattr(
        from_starts, "nominal_drive", lambda system: SimpleNamespace(offset=q("-0.5"))
    )

    def proof(*peaks, of="x0"):
        entry = SimpleNamespace(of=of, peaks=tuple(map(str, peaks)))
        return SimpleNamespace(starts=(SimpleNamespace(of="polytope", peaks="?"), entry))

    system = SimpleNamespace(plant=SimpleNamespace(n=2))
    one, two = proof(1, 5, 3, 99, 2, 8), proof(4, 2, 6, 99, 7, 1)
    found = from_starts.peaks_of(system, [one, two])
    assert (found.error, found.states, found.input, found.input_step) == (4, (5, 6), 7.5, 8)
    assert from_starts.peaks_of(system, [one, proof(of="polytope")]) is None


@pytest.mark.parametrize("limited", [True, False])
@pytest.mark.parametrize("regional", [True, False])
@pytest.mark.parametrize("kinds", [(), ("x0",), ("polytope",), ("x0", "polytope"), ("x0",) * 2])
def test_which_starts_a_proof_must_and_may_have(monkeypatch, kinds, regional, limited):
    """One from x0 where not every start is admitted, and one polytope there; none with jitter."""
    asked = []
    prover = SimpleNamespace(
        drive="drive", evidence=lambda start: asked.append(("evidence", start.of))
    )
    monkeypatch.setattr(from_starts, "is_limited", lambda system: limited)
    monkeypatch.setattr(from_starts, "is_regional", lambda system: regional)
    monkeypatch.setattr(from_starts, "start_prover", lambda *parts: prover)
    monkeypatch.setattr(
        from_starts, "polytope_of", lambda prover, start: asked.append(("polytope", start.of))
    )
    said = [""]
    monkeypatch.setattr(from_starts, "limit_met", lambda *parts: said[0])
    starts = tuple(SimpleNamespace(of=of) for of in kinds)
    proof = SimpleNamespace(starts=starts, parts=(1, 1), cell=())

    def failed(jitter=0.0, there=True):
        drive = SimpleNamespace(jitter=jitter) if there else None
        return from_starts.failed_starts(SimpleNamespace(implementation=drive), proof, 1)

    partly = limited or regional
    if kinds == ("x0",) * 2:
        assert "at most one proof" in failed()
        return
    if partly and "x0" not in kinds:
        what = "the input has limits" if limited else "not for every start"
        assert what in failed() and "nothing is said of the start" in failed()
        return
    if "polytope" in kinds and not partly:
        assert "for an input with limits" in failed()
        return
    assert failed() == "" == failed(there=False)
    expected = [("evidence" if of == "x0" else "polytope", of) for of in kinds]
    assert asked == 2 * expected
    assert ("with jitter" in failed(jitter=0.1)) is bool(kinds)
    said[0] = "|u| is large"
    assert failed() == ("the limits of the input may act: |u| is large" if limited else "")
    proof.starts = (*starts, SimpleNamespace(of="elsewhere"))
    assert "at most one proof" in failed()


@pytest.mark.parametrize("limited", [True, False])
@pytest.mark.parametrize("regional", [True, False])
@pytest.mark.parametrize("refused", ["", "x0", "polytope"])
@pytest.mark.parametrize("known", [(), ("x0", "polytope")])
def test_what_is_looked_for_of_the_starts_of_a_delay(
    monkeypatch, known, refused, regional, limited
):
    def prove(of):
        if of == refused:
            raise NoCertificate("too far")
        return SimpleNamespace(of=of)

    prover = SimpleNamespace(prove=prove, drive="drive")
    monkeypatch.setattr(from_starts, "is_limited", lambda system: limited)
    monkeypatch.setattr(from_starts, "is_regional", lambda system: regional)
    asked = []
    monkeypatch.setattr(from_starts, "start_prover", lambda *parts: asked.append(parts) or prover)
    monkeypatch.setattr(from_starts, "polytope_of", lambda prover, start: f"of {start.of}")
    said = [""]

    def met(system, drive, start):
        assert (system, drive, start.of) == ("it", "drive", "x0")
        return said[0]

    monkeypatch.setattr(from_starts, "limit_met", met)
    starts = tuple(SimpleNamespace(of=of) for of in known)
    proof = ImplementedProof("1/2", (2, 3), 5, ("1",), "1", "1", "1", starts)
    found = from_starts._starts_of_delay("it", proof, "plant", {"x0": 7})
    assert asked == [("it", q("0.5"), (2, 3), (), "plant", {"x0": 7})]
    partly = limited or regional
    (after,) = found.proofs
    wanted = ["x0", "polytope"] if partly else ["x0"]
    if known:
        assert after.starts == starts
    else:
        assert [entry.of for entry in after.starts] == [of for of in wanted if of != refused]
    there = partly and (bool(known) or refused != "polytope")
    assert found.polytope == ("of polytope" if there else None)
    lost = limited and not known and refused == "x0"
    assert found.reason == ("the limits of the input may act: too far" if lost else "")
    said[0] = "|u| is large"
    found = from_starts._starts_of_delay("it", proof, "plant", {})
    if limited and not lost:
        assert found.reason == "the limits of the input may act: |u| is large"
    assert bool(found.reason) is limited

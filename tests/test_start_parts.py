"""Bounds from a start, part by part: constants, jumps and what is left of a start."""

from types import SimpleNamespace

import flint
import numpy as np
import pytest
from test_fixed_point_parts import q
from test_slow_parts import no_less

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import start, start_proof
from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.start import FromStarts

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
def test_what_a_start_adds_to_the_rows(known):
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
    within[0] = False
    with pytest.raises(NoCertificate, match="in the long run"):
        start_proof.polytope_of(prover, proof)

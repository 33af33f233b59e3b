"""Motion profiles: no limit is exceeded, bounds are exact, and nothing is faster."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.sparse import csr_matrix

import certrack
from certrack.core.errors import InputError
from certrack.references import (
    PiecewiseReference,
    SymbolicReference,
    chirp,
    moves,
    multisine,
    pieces,
    polynomial,
    samples,
    scurve,
    velocity,
)
from certrack.references.profiles.phases import travelled
from certrack.references.profiles.shortest import MOTION_LIMITS, shortest
from certrack.references.rests import moves_of
from certrack.testing.reference import ReferenceConformance

SIZES = st.floats(1e-3, 1e3)
LIMITED = {"speed": 0.5, "acceleration": 2.0, "jerk": 20.0, "snap": 300.0}


def dense(reference, order, per_piece=65):
    """All derivatives at the ends of every piece, just inside, and between."""
    inside = np.concatenate([[1e-9], np.linspace(0, 1, per_piece)[1:-1], [1 - 1e-9]])
    times = np.concatenate([a + (b - a) * inside for a, b in pairwise(reference.knots)])
    return np.abs(reference.values(times, order)).max(axis=1)


def largest_distance(time, limits, steps):
    """How far a move from rest to rest gets in a time: a linear program, from below.

    The highest derivative is constant on each of the steps, in units of the whole time.
    """
    n, h = len(limits), 1.0 / steps
    scaled = [limit * time ** (i + 1) for i, limit in enumerate(limits)]
    rows, columns, values = [], [], []

    def state(i, k):
        return i * (steps + 1) + k

    row = 0
    for k in range(steps):
        for i in range(n):
            entries = [(state(i, k + 1), -1.0), (n * (steps + 1) + k, h ** (n - i))]
            entries += [(state(j, k), h ** (j - i)) for j in range(i, n)]
            for (column, power), order in zip(entries, [0, n - i, *range(n - i)], strict=True):
                rows.append(row)
                columns.append(column)
                values.append(power / math.factorial(order))
            row += 1
    bounds = []
    for i in range(n):
        limit = scaled[i - 1] if i and scaled[i - 1] < math.inf else None
        free = (None, None) if limit is None else (-limit, limit)
        ends = (0.0, 0.0) if i else free
        bounds += [(0.0, 0.0), *[free] * (steps - 1), ends]
    bounds += [(-scaled[-1], scaled[-1])] * steps
    cost = np.zeros(len(bounds))
    cost[state(0, steps)] = -1.0
    matrix = csr_matrix((values, (rows, columns)), shape=(row, len(bounds)))
    found = linprog(cost, A_eq=matrix, b_eq=np.zeros(row), bounds=bounds, method="highs")
    assert found.status == 0
    return -found.fun


CASES = {
    "trapezoid of speed": (1.0, (0.5, 2.0)),
    "S-curve that cruises": (1.0, (0.5, 2.0, 10.0)),
    "S-curve without a cruise": (1.0, (5.0, 2.0, 10.0)),
    "snap alone": (1.0, (math.inf, math.inf, math.inf, 40.0)),
    "snap that touches the speed": (1.0, (1.2, math.inf, math.inf, 40.0)),
    "snap, jerk and acceleration": (1.0, (math.inf, 2.0, 20.0, 300.0)),
}


@pytest.mark.parametrize("case", CASES)
def test_no_solver_is_faster(case):
    """In half a percent less time no profile gets so far; in as much more the solver's does."""
    distance, limits = CASES[case]
    time = shortest(distance, limits).duration
    assert largest_distance(0.995 * time, limits, 80) < distance * (1 - 1e-9)
    assert largest_distance(1.005 * time, limits, 80) > distance


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, 0.9, 0.6, 0.3])
def test_a_cruise_under_a_limited_snap_is_within_a_thousandth(speed):
    limits = (speed, math.inf, math.inf, 40.0)
    time = shortest(1.0, limits).duration
    gained = (largest_distance(time, limits, 400) - 1.0) / speed
    assert gained < 1e-3 * time


@settings(max_examples=60)
@given(
    st.lists(SIZES, min_size=4, max_size=4),
    st.sets(st.sampled_from(MOTION_LIMITS), min_size=1),
    SIZES,
    st.floats(0, 100),
)
def test_no_limit_is_exceeded(sizes, names, distance, start):
    limits = {name: size for name, size in zip(MOTION_LIMITS, sizes, strict=True) if name in names}
    made = moves((0.0, distance, 0.3 * distance), dwell=0.1, start=start, **limits)
    order = 1 + max(MOTION_LIMITS.index(name) for name in limits)
    assert made.order == order
    bounds = made.bounds(order).values
    for name, limit in limits.items():
        assert bounds[MOTION_LIMITS.index(name) + 1] <= limit
    reached = dense(made, order)
    assert np.all(reached <= np.array(bounds) * (1 + 1e-12))
    assert np.all(reached >= np.array(bounds) * (1 - 1e-3))
    assert bounds[0] == pytest.approx(distance, rel=1e-9)
    ends = made.values(np.array([made.knots[-1]]), order)[:, 0]
    assert ends[0] == pytest.approx(0.3 * distance, rel=1e-12)
    assert not ends[1:].any()


@settings(max_examples=40)
@given(SIZES, st.lists(SIZES, min_size=4, max_size=4), st.integers(1, 4))
def test_every_limit_that_is_touched_binds(distance, sizes, count):
    """With a limit a tenth lower, the move is never shorter, and longer for one of them."""
    limits = tuple(sizes[:count])
    time = shortest(distance, limits).duration
    assert travelled(shortest(distance, limits).phases(), count) == pytest.approx(
        distance, rel=1e-9
    )
    lower = [
        shortest(distance, (*limits[:i], 0.9 * limits[i], *limits[i + 1 :])).duration
        for i in range(count)
    ]
    assert min(lower) >= time * (1 - 1e-3)  # a thousandth: chattering
    assert max(lower) > time * (1 + 1e-6)


@settings(max_examples=30)
@given(st.sampled_from([3, 5, 7, 9]), SIZES, st.dictionaries(st.sampled_from(MOTION_LIMITS), SIZES))
def test_polynomial_moves_keep_their_limits_and_reach_one(degree, distance, limits):
    assume(limits and (degree > 3 or set(limits) != {"snap"}))
    made = polynomial((0, distance, 0), degree=degree, dwell=0.2, **limits)
    order = (degree + 1) // 2
    assert made.order == order
    bounds = made.bounds(max(order, 4)).values
    shares = [bounds[MOTION_LIMITS.index(name) + 1] / limit for name, limit in limits.items()]
    assert 1 - 1e-9 < max(shares) <= 1
    assert np.all(dense(made, order) <= np.array(bounds[: order + 1]) * (1 + 1e-12))


def test_minimum_jerk_is_the_polynomial_of_degree_5():
    """Its peak speed is 15/8 of the mean, and its jerk at the ends 60 d/T^3."""
    made = polynomial((0, 1), degree=5, duration=2.0)
    assert made.bounds(3).values[1:] == pytest.approx(
        (15 / 16, 10 / math.sqrt(3) / 4, 7.5), rel=1e-9
    )


def test_a_long_list_does_not_drift():
    made = scurve([0, 1] * 200, speed=0.3, acceleration=1.1, jerk=7, dwell=0.3, start=1000.0)
    found = moves_of(made, made.knots[-1] + 1)
    assert len(found) == 399
    assert {move.target for move in found} == {0.0, 1.0}
    gaps = [b.begin - a.arrival for a, b in pairwise(found)]
    assert max(gaps) - min(gaps) < 1e-9


def test_a_repeated_list_repeats():
    made = velocity((0, 0.4, 0.1, 0), speed=0.8, acceleration=8, dwell=(0.1, 0.2, 0.3), repeat=True)
    t = np.linspace(0, made.period, 1001)
    np.testing.assert_allclose(made.values(t, 1), made.values(t + 3 * made.period, 1), atol=1e-9)
    first, second, third, _ = moves_of(made, 1.6 * made.period)
    rests = [second.begin - first.arrival, third.begin - second.arrival]
    assert rests == pytest.approx([0.1, 0.2])


@pytest.mark.parametrize("degree", [3, 5, 7, 9])
@pytest.mark.parametrize("repeat", [False, True])
def test_splines_pass_through_the_samples(degree, repeat):
    rng = np.random.default_rng(degree)
    t, y = np.cumsum(rng.uniform(0.1, 2, 30)), rng.normal(size=30).cumsum()
    y[-1] = y[0]
    made = samples(t, y, interpolation="spline", degree=degree, repeat=repeat)
    order = (degree + 1) // 2
    assert made.order == order
    np.testing.assert_allclose(made.values(t[:-1], 0)[0], y[:-1], atol=1e-9)
    bounds = np.array(made.bounds(order).values)
    reached = dense(made, order)
    assert np.all(reached <= bounds * (1 + 1e-12))
    assert np.all(reached >= bounds * (1 - 2e-3))


def test_splines_reproduce_what_is_smooth():
    """The error of degree 7 falls with the eighth power of the spacing."""
    errors = []
    for count in (40, 80):
        t = np.linspace(0, 2 * math.pi, count + 1)
        made = samples(t, np.sin(t) * (t < 6.28), "spline", degree=7, repeat=True)
        at = np.linspace(0, 6, 4001)
        errors.append(np.abs(made.values(at, 0)[0] - np.sin(at)).max())
    assert math.log2(errors[0] / errors[1]) > 7


@pytest.mark.parametrize(
    ("coefficients", "order"),
    [
        (((0, 0, 1), (1, 1, -1)), 1),  # the speed jumps, and at the end, too
        (((0, 0, 0.5), (0.5, 1, -0.5)), 2),
        (((0,), (0, 0, 0, 10, -15, 6)), 3),
        (((0,), (0, 1)), 1),
    ],
)
def test_the_order_of_pieces_is_found(coefficients, order):
    made = pieces((0, 1, 2), coefficients)
    assert made.order == order
    assert isinstance(made, PiecewiseReference)
    reached = dense(made, order)
    np.testing.assert_allclose(reached, made.bounds(order).values, rtol=1e-3)


def test_bounds_of_high_degree_are_exact():
    """x^8 - 1.5 x^4 + 0.3 on [0, 1]: its extremes are at 0, at (3/4)^(1/4) and at 1."""
    made = pieces((0, 1, 2), ((0.25, 0, 0, 0, -1.5, 0, 0, 0, 1), (-0.25,)))
    assert made.bounds(0).values[0] == pytest.approx(0.75**2 - 0.25, rel=1e-14)
    assert made.bounds(0).values[0] >= 0.3125


@pytest.mark.parametrize("smoothness", [0, 1, 3])
def test_a_chirp_sweeps_and_stays(smoothness):
    made = chirp(0.1, (1, 20), duration=10, smoothness=smoothness, offset=0.5)
    assert isinstance(made, SymbolicReference)
    assert made.order == smoothness + 2
    t = np.linspace(0, 12, 60_001)
    order = smoothness + 2
    y = made.values(t, order)
    bounds = np.array(made.bounds(order).values)
    reached = np.abs(y).max(axis=1)
    assert np.all(reached <= bounds)
    assert np.all(reached >= 0.8 * bounds)
    slope = np.abs(np.diff(y[order]) / np.diff(t)).max()
    assert slope <= made.lipschitz_bound(order, between_jumps=True)
    late = t > 10
    np.testing.assert_allclose(y[2][late], -400 * (y[0][late] - 0.5), atol=1e-9)
    assert y[1, 0] == pytest.approx(0.1)  # w = 1 at the begin


def test_a_multisine_has_its_sines():
    made = multisine((0.1, 0.2, 0.05), (1, 3, 7.5), offset=0.1)
    t = np.linspace(0, 20, 1001)
    angles = [-math.pi * k * (k + 1) / 3 for k in range(3)]
    pairs = zip((0.1, 0.2, 0.05), (1, 3, 7.5), angles, strict=True)
    expected = 0.1 + sum(a * np.sin(w * t + p) for a, w, p in pairs)
    np.testing.assert_allclose(made.values(t, 0)[0], expected, atol=1e-12)
    assert made.bounds(0).values[0] == pytest.approx(0.45)
    stated = multisine((0.1,), (2,), phases=(0.5,))
    assert stated.values(np.zeros(1), 0)[0, 0] == pytest.approx(0.1 * math.sin(0.5))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: moves((0, 1)), "needs a limit: speed, acceleration, jerk or snap"),
        (lambda: moves((0,), speed=1), r"positions: must be 2 to 10001 positions; got 1"),
        (lambda: moves((0, 1, 1), speed=1), r"positions\[2\]: must differ.*Rest by a dwell"),
        (lambda: moves((0, 1), speed=0), r"speed: must be positive"),
        (lambda: moves((0, 1), speed=1, dwell=(1, 2)), r"dwell"),
        (lambda: moves((0, 1), speed=1, dwell=-1), r"dwell"),
        (lambda: moves((0, 1), speed=1, repeat=True), r"positions\[1\]: must end at the first"),
        (lambda: moves((0, 1), speed=1, repeat=1), r"repeat: must be true or false"),
        (lambda: moves((0, 1e-9), jerk=1e3, start=1e9), r"positions\[1\]: is too short"),
        (lambda: moves((0, 1e300), acceleration=1e-12, jerk=1), "so far apart that times"),
        (lambda: moves((0, 1e12), jerk=1e12, snap=1e-300), "so far apart that times"),
        (lambda: chirp(1, (1, 2), 1e-300).bounds(2), "overflows"),
        (lambda: polynomial(5, duration=1), "positions: must be a list"),
        (lambda: polynomial((0, 1)), "needs a duration, or limits"),
        (lambda: polynomial((0, 1), degree=3, snap=1), "a limit that binds.*no snap"),
        (lambda: polynomial((0, 1), duration=1, speed=1), "left out beside duration"),
        (lambda: polynomial((0, 1), degree=4, duration=1), "degree: must be 3 or 5 or 7 or 9"),
        (lambda: chirp(1, (1, 1), 1), "must differ from the first"),
        (lambda: multisine((1, 2), (1,)), "frequencies"),
        (lambda: pieces((0, 1, 2), ((0, 1), (0, 1))), "must not jump: y_d does at t = 1"),
        (lambda: pieces((0, 1, 2), ((0, 1),)), "coefficients"),
        (lambda: samples((0, 1), (0, 1), degree=5), "degree: is that of a spline"),
        (lambda: samples((0, 1), (0, 1), "spline", degree=6), "degree: must be 3 or 5"),
        (lambda: samples((0, 1, 2), (0, 1, 2), "cubic", repeat=True), r"values\[2\]: must be"),
        (lambda: samples((0, 1, 2), (0, 1, 0), repeat=True), "repeat: is for splines"),
    ],
)
def test_what_makes_no_profile_is_refused_in_one_line(make, message):
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


class TestPointToPoint(ReferenceConformance):
    reference = certrack.load("point-to-point").reference
    duration = 2.5


KINDS = [
    moves((0, 0.2, -0.1), dwell=0.5, **LIMITED),
    velocity((0, 0.2), speed=0.5, acceleration=2, start=0.5),
    polynomial((0, 0.2, 0), degree=9, duration=(1, 2), repeat=True),
    chirp(0.1, (1, 5), duration=5),
    multisine((0.1, 0.05), (1, 3)),
    pieces((0, 1, 2), ((0, 0, 0.1), (0.1, 0.2, -0.1)), repeat=False),
    samples((0, 1, 2, 3), (0, 0.1, 0.3, 0), "spline", degree=7, repeat=False),
]


@pytest.mark.slow
@pytest.mark.parametrize("made", KINDS, ids=lambda made: dict(made.fields)["kind"])
@pytest.mark.parametrize("duty", [n for n in dir(ReferenceConformance) if n.startswith("test_")])
def test_every_kind_keeps_the_duties_of_a_reference(made, duty):
    kit = ReferenceConformance()
    kit.reference = made
    getattr(kit, duty)()


@pytest.mark.parametrize("made", KINDS, ids=lambda made: dict(made.fields)["kind"])
def test_every_kind_survives_a_system_file(made):
    kit = ReferenceConformance()
    kit.reference = made
    kit.test_survives_a_system_file()
    kit.test_keeps_the_protocol()


# moves of least energy

#: u = 0.175 y'' + y''''/240: what the shipped dual motor needs for a motion.
DUAL_MOTOR_EFFORT = (0, 0.175, 0, 1 / 240)


def energy_of(reference, effort, time):
    """Integral of u^2 over a move, by Gauss' rule, which is exact for such polynomials."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    Y = reference.values(time * (nodes + 1) / 2, len(effort))
    u = sum(a * row for a, row in zip(effort, Y[1:], strict=True))
    return float(time / 2 * weights @ u**2)


def least_energy(time):
    """Of all inputs that move the dual motor by 1 from rest to rest, by its Gramian."""
    A, b = np.diag([1.0, 1.0, 1.0], 1), np.array([0.0, 0.0, 0.0, 240.0])
    A[3, 2] = -0.175 * 240
    both = np.block([[-A, np.outer(b, b)], [np.zeros((4, 4)), A.T]])
    flow = expm(time * both)
    gramian = flow[4:, 4:].T @ flow[:4, 4:]
    return float(np.linalg.solve(gramian, [1.0, 0.0, 0.0, 0.0])[0])


@pytest.mark.parametrize(("time", "plain"), [(1.0, 1.10), (2.0, 1.13)])
def test_a_move_of_least_energy_needs_what_the_gramian_says(time, plain):
    effort = DUAL_MOTOR_EFFORT
    found = polynomial((0, 1), degree=7, duration=time, effort=effort)
    least = least_energy(time)
    assert 1 - 1e-9 < energy_of(found, effort, time) / least < 1.0001
    septic = polynomial((0, 1), degree=7, duration=time)
    assert energy_of(septic, effort, time) / least == pytest.approx(plain, abs=0.005)


def test_for_a_double_integrator_it_is_the_cubic():
    """Its least energy is 12/T^3, and no power that is added lowers it."""
    cubic = polynomial((0, 1, 0.4), degree=3, duration=2)
    found = polynomial((0, 1, 0.4), degree=3, duration=2, effort=(0, 1))
    times = np.linspace(0, 4, 101)
    assert (found.values(times, 2) == cubic.values(times, 2)).all()
    assert energy_of(polynomial((0, 1), 3, 2, effort=(0, 1)), (0, 1), 2.0) == pytest.approx(1.5)


@pytest.mark.parametrize("effort", [(0.3, 0.0, 0.0, 1.0), (0.0, 0.1, 0.0, 2.0), DUAL_MOTOR_EFFORT])
def test_its_bounds_hold_and_its_ends_are_at_rest(effort):
    found = polynomial((0, 1, -0.5), degree=7, duration=(1.5, 2.5), dwell=0.2, effort=effort)
    bounds = found.bounds(4).values
    largest = dense(found, 4)
    assert (largest <= np.array(bounds) * (1 + 1e-12)).all()
    assert (largest[:4] >= np.array(bounds)[:4] * (1 - 1e-3)).all()
    ends = found.values(np.array([0.0, 1.5, 1.7, 4.2]), 3)
    rest = np.abs(ends[1:]).max(axis=1)  # but for the rounding of its evaluation
    assert (rest < 1e-9 * np.array(bounds[1:4])).all() and found.order == 4


def test_a_file_can_state_an_effort():
    text = certrack.to_text(certrack.load("dual-motor-lean"))
    head, tail = text.split("[reference]\n")
    keys = 'kind = "polynomial"\npositions = [0, 0.1]\ndegree = 7\nduration = 2\n'
    rest = tail[tail.index("\n[") :]
    system = certrack.loads(f'{head}[reference]\n{keys}effort = [0, 0.175, 0, "1/240"]\n{rest}')
    again = certrack.loads(certrack.to_text(system))
    assert (again.reference.values(np.ones(1), 4) == system.reference.values(np.ones(1), 4)).all()
    plain = certrack.loads(f"{head}[reference]\n{keys}{rest}")
    energies = [certrack.simulate(s.with_settings(x0=(0,) * 4)).metrics for s in (system, plain)]
    assert energies[0].input_energy < energies[1].input_energy


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ({"effort": (1.0,), "speed": 1.0}, "reference.effort: needs a duration"),
        ({"effort": (1.0, 2.0, 0.0), "duration": 1.0}, "the last not zero"),
        ({"effort": (1.0,) * 4, "duration": 1.0}, "must be 3 numbers"),
        ({"effort": (), "duration": 1.0}, "reference.effort"),
    ],
)
def test_an_effort_that_does_not_fit_is_refused(wanted, said):
    with pytest.raises(InputError, match=said):
        polynomial((0, 1), degree=5, **wanted)


def test_positions_without_a_move_are_named_beside_an_effort():
    with pytest.raises(InputError, match=r"reference\.positions"):
        polynomial((0,), degree=3, duration=1.0, effort=(0.0, 1.0))

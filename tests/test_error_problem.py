"""The inequality of a certificate as a quadratic form; the samples that premises are tried at."""

from fractions import Fraction

import numpy as np
import pytest

from certrack.certificates.arithmetic import rational
from certrack.certificates.problem import ErrorProblem
from certrack.certificates.sampling import (
    LATE_SHARE,
    LATEST,
    ORIGIN_SHARE,
    RANDOM_MAGNITUDES,
    RANDOM_POINTS,
    START_SHARE,
    random_points,
)


def numbers(rng, *shape):
    """Fractions of three digits."""
    table = rng.integers(-999, 1000, shape)
    return np.vectorize(lambda v: rational(Fraction(int(v), 1000)), otypes=[object])(table)


def problem(rng, n=3, na=3, nb=2, ny=2):
    """One with three a-inputs: within ||x||, within ||S x + T y||, within ||S x||."""
    S, T, other = numbers(rng, 2, n), numbers(rng, 2, ny), numbers(rng, 1, n)
    return ErrorProblem(
        M=numbers(rng, n, n),
        Ua=numbers(rng, n, na),
        Ub=numbers(rng, n, nb),
        Uy=numbers(rng, n, ny),
        Xe=numbers(rng, n, n),
        Xy=numbers(rng, n, ny),
        states=((0, 1, 2), (1, 2)),
        derivatives=(0, 2),
        adaptation=None,
        selections=(None, (S, T), (other, None)),
    )


def square(values):
    return sum(v * v for v in values)


@pytest.mark.parametrize("selected", [True, False])
def test_the_inequality_is_its_quadratic_form(selected):
    rng = np.random.default_rng(1)
    data = problem(rng)
    if not selected:
        data = ErrorProblem(**{**vars(data), "selections": ()})
    half = numbers(rng, 3, 3)
    P, (lam, nu, k) = half + half.T, (numbers(rng, count) for count in (3, 2, 2))
    alpha = rational(Fraction(3, 7))
    Q = data.inequality(P, lam, nu, k, alpha)
    assert (Q == Q.T).all() and Q.shape == (10, 10)
    for _ in range(5):
        e, a, b, y = (numbers(rng, count) for count in (3, 3, 2, 2))
        x = data.Xe @ e + data.Xy @ y
        bounds = [square(x)] * 3
        if selected:
            (S, T), (other, _) = data.selections[1:]
            bounds = [square(x), square(S @ x + T @ y), square(other @ x)]
        expected = e @ P @ (data.M @ e + data.Ua @ a + data.Ub @ b + data.Uy @ y)
        expected += alpha * (e @ P @ e) / 2
        expected += sum(
            v * (bound - one * one) for v, bound, one in zip(lam, bounds, a, strict=True)
        )
        expected -= nu @ (b * b) + k @ (y * y)
        z = np.concatenate([e, a, b, y])
        assert z @ Q @ z == expected


def test_a_problem_in_floats_has_the_same_numbers():
    data = problem(np.random.default_rng(2))
    found = data.in_floats()
    for name in ("M", "Ua", "Ub", "Uy", "Xe", "Xy"):
        assert getattr(found, name).dtype == float
        assert (getattr(found, name) == getattr(data, name).astype(float)).all()
    assert found.selections[0] is None and found.selections[2][1] is None
    for ours, theirs in zip(found.selections[1], data.selections[1], strict=True):
        assert ours.dtype == float and (ours == theirs.astype(float)).all()
    assert (found.selections[2][0] == data.selections[2][0].astype(float)).all()
    assert (found.states, found.derivatives, found.n) == (data.states, data.derivatives, 3)


def test_a_homogeneous_problem_has_the_uncertain_inputs_alone():
    data = problem(np.random.default_rng(3))
    found = data.homogeneous(rational(2))
    assert found.counts == (3, 0, 0) and found.Xy.shape == (3, 0)
    assert (found.Ua == 2 * data.Ua).all() and (found.M == data.M).all()
    assert found.states == ((0, 1, 2), ()) and found.derivatives == ()
    assert [part and part[1] for part in found.selections] == [None] * 3
    assert (found.selections[1][0] == data.selections[1][0]).all()


def test_an_array_that_is_shared_cannot_be_changed():
    data = problem(np.random.default_rng(4)).read_only()
    for name in ("M", "Ua", "Ub", "Uy", "Xe", "Xy"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(data, name)[0, 0] = 0


def test_samples_are_of_all_times_and_sizes():
    points = random_points(3, 20.0, 7)
    start, late = int(START_SHARE * RANDOM_POINTS), int(LATE_SHARE * RANDOM_POINTS)
    assert points.x.shape == (3, RANDOM_POINTS) and len(points.t) == RANDOM_POINTS
    assert (points.t[:start] == 0).all() and (points.t[start:] > 0).all()
    assert points.t[start] == pytest.approx(20.0)
    assert points.t[start + late - 1] == pytest.approx(20.0 * LATEST)
    assert (np.diff(np.log(points.t[start : start + late])) > 0).all()
    rest = points.t[start + late :]
    assert rest.max() < 20 and rest.min() < 0.1 and rest.max() > 19.9
    origin = np.arange(RANDOM_POINTS) % int(1 / ORIGIN_SHARE) == 0
    assert (points.x[:, origin] == 0).all() and (points.norm[~origin] > 0).all()
    sizes = np.log10(points.norm[~origin])
    low, high = RANDOM_MAGNITUDES
    assert low - 1e-9 <= sizes.min() < low + 0.1 and high - 0.1 < sizes.max() <= high + 1e-9
    on_axis = np.count_nonzero(points.x, axis=0) == 1
    assert 0 < on_axis.sum() < RANDOM_POINTS / 2
    assert all((points.x[i, on_axis] != 0).any() for i in range(3))
    assert (random_points(3, 20.0, 7).x == points.x).all()
    assert (random_points(3, 20.0, 8).x != points.x).any()
    few = points[np.array([2, 5])]
    assert (few.t == points.t[[2, 5]]).all() and (few.x == points.x[:, [2, 5]]).all()
    assert points[3].x.shape == (3, 1) and few.norm == pytest.approx(np.linalg.norm(few.x, axis=0))

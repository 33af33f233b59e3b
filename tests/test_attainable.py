"""What references and bounded inputs attain in linear loops, against closed forms."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import certrack
from certrack.certificates.ranges import certify
from certrack.certificates.ranges.attainable import _by_inputs, attained_at, worst_reference
from certrack.certificates.ranges.certify import attainable_error
from certrack.certificates.ranges.loop import error_form, ranged_loop


def worst(M, W, Y, inputs=None, offset=None):
    """Of lists."""
    n = len(M)
    inputs = np.zeros((n, 0)) if inputs is None else np.array(inputs, dtype=float)
    offset = np.zeros(n) if offset is None else np.array(offset, dtype=float)
    return worst_reference(np.array(M, float), np.array(W, float), inputs, offset, Y)


def test_a_lag_follows_the_largest_constant():
    """e' = -2 e + 3 y, |y| <= 5: 7.5 but for what 12 time constants forget."""
    found = worst([[-2]], [[3, 0]], [5, 100])
    assert found.error == found.by_reference == pytest.approx(7.5, rel=1e-5)


def test_a_lag_follows_the_steepest_ramp():
    """e' = -2 e + 3 y', |y'| <= 0.5, and y has room for the horizon."""
    assert worst([[-2]], [[0, 3]], [100, 0.5]).error == pytest.approx(0.75, rel=1e-5)


def test_two_derivatives_pull_together():
    """e' = -e + y + y' is e = y: a loop that cancels has the reference's bound."""
    assert worst([[-1]], [[1, 1]], [2, 30]).error == pytest.approx(2, rel=1e-3)


def test_the_second_state_reaches_the_error_through_the_first():
    """e_1' = -e_1 + e_2, e_2' = -4 e_2 + 8 y."""
    assert worst([[-1, 1], [0, -4]], [[0, 0], [8, 0]], [3, 1e3]).error == pytest.approx(6, rel=1e-4)


def test_parts_add_up():
    """3 by the reference, 1/2 by the input, 1/4 by the offset, whatever its sign."""
    for sign in (1, -1):
        found = worst([[-2]], [[3, 0]], [2, 50], [[1]], [sign * 0.5])
        assert found.by_reference == pytest.approx(3, rel=1e-5)
        assert found.error == pytest.approx(3.75, rel=1e-3)


@pytest.mark.parametrize("pole", [0.0, 0.5])
def test_an_unstable_loop_attains_nothing(pole):
    assert worst([[pole]], [[1, 0]], [1, 1]) is None
    assert worst([[-1, 0], [0, pole]], [[1, 0], [0, 0]], [1, 1]) is None


def test_a_bound_of_zero_leaves_constants():
    assert worst([[-2]], [[3, 1]], [2, 0]).error == pytest.approx(3, rel=1e-5)


def test_the_integral_of_kernels():
    """Of e^{-t} - e^{-2t}: 1/2; of -2 e^{-t} + 3 e^{-2t}, which crosses zero: 5/6."""
    M = np.array([[-1.0, 1.0], [0.0, -2.0]])
    for inputs, expected in (
        ([[1], [0]], 1.0),
        ([[0], [1]], 0.5),
        ([[1], [-1]], 0.5),
        ([[1], [-3]], 5 / 6),
        ([[1, 0], [0, 1]], 1.5),
    ):
        found = _by_inputs(M, np.array(inputs, dtype=float), 1.0)
        assert found == pytest.approx(expected, rel=2e-4)
    assert _by_inputs(M, np.zeros((2, 0)), 1.0) == 0.0


LOOP = """
[plant]
states = ["x1", "x2"]
chain = [1.5]
linear = [[-0.5]]
drift = "m*x1"
gain_sign = 1
input_gain = 2

[plant.constants]
m = 1

[plant.ranges]
m = [0.5, 2]

[plant.uncertainty]
tau = [0.1, 0.5]
gamma = [0, 0]
beta = [0.3, 4]

[law]
kind = "robust"
c = [2, 3]

[reference]
signal = "0.5*cos(t)"

[truth]
input_gain = 2
omega = ["0", "0"]

[simulation]
x0 = [0, 0]
duration = 20
"""


def linear_loop():
    return ranged_loop(certrack.loads(LOOP))


def test_bounded_uncertain_terms_act_through_the_design():
    """Column k of A, times tau_k beta_k: the integral of its kernels by a fine sum."""
    loop, Y = linear_loop(), (0.5, 0.5)
    for low_or_high in (0, 1):
        corner = [ends[low_or_high] for ends in loop.box]
        form = error_form(loop, loop.entries.at(tuple(corner)))
        M, A = form.M.astype(float), loop.coordinates.A.astype(float)
        inputs = A @ np.diag([0.1 * 0.3, 0.5 * 4])
        step, X, total = expm(M * 1e-3), inputs.copy(), 0.0
        for _ in range(20_000):
            total += np.abs(X[0]).sum() * 1e-3
            X = step @ X
        found = attained_at(loop, corner, Y)
        assert found.error - found.by_reference == pytest.approx(total, rel=2e-3)
        alone = worst_reference(M, form.W.astype(float), np.zeros((2, 0)), np.zeros(2), Y)
        assert found.by_reference == pytest.approx(alone.error)


def test_a_term_without_size_does_not_act():
    text = LOOP.replace("beta = [0.3, 4]", "beta = [0, 4]")
    loop = ranged_loop(certrack.loads(text))
    corner = [low for low, _ in loop.box]
    some, every = (
        attained_at(loop, corner, (0.5, 0.5)),
        attained_at(linear_loop(), corner, (0.5, 0.5)),
    )
    assert some.by_reference < some.error < every.error


def prover(brackets=(), moving=0, by_peak_gains=True):
    reference = SimpleNamespace(bounds=lambda order: SimpleNamespace(values=(order, 7.0)))
    loop = SimpleNamespace(
        brackets=brackets,
        moving=moving,
        system=SimpleNamespace(reference=reference),
        coordinates=SimpleNamespace(q=1),
    )
    box = [(1, 2), (3, 5)]
    return SimpleNamespace(loop=loop, by_peak_gains=by_peak_gains, box=box)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_worst_corner_counts(monkeypatch, sign):
    seen = []

    def attained(loop, corner, Y):
        seen.append((tuple(corner), Y))
        return SimpleNamespace(error=10 + sign * (corner[0] + 10 * corner[1]) / 10)

    monkeypatch.setattr(certify, "attained_at", attained)
    assert attainable_error(prover()) == pytest.approx(15.2 if sign > 0 else 6.9)
    assert sorted(corner for corner, _ in seen) == sorted(itertools.product((1, 2), (3, 5)))
    assert {Y for _, Y in seen} == {(2, 7.0)}


def test_nothing_is_attained_where_one_corner_or_the_kind_of_loop_says_so(monkeypatch):
    errors = iter((1.0, None, 3.0, 4.0))

    def attained(loop, corner, Y):
        error = next(errors)
        return None if error is None else SimpleNamespace(error=error)

    monkeypatch.setattr(certify, "attained_at", attained)
    assert attainable_error(prover()) is None
    one = SimpleNamespace(error=0.25)
    monkeypatch.setattr(certify, "attained_at", lambda loop, corner, Y: one)
    assert attainable_error(prover()) == 0.25
    assert attainable_error(prover(brackets=("x",))) is None
    assert attainable_error(prover(moving=1)) is None
    assert attainable_error(prover(by_peak_gains=False)) is None

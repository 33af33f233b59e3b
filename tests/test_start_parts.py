"""Bounds from a start, part by part: constants, jumps and what is left of a start."""

from types import SimpleNamespace

import flint
import numpy as np
import pytest
from test_fixed_point_parts import q
from test_slow_parts import no_less

from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented import start
from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.start import FromStarts

#: Of two rows by w, r, noise, sample, step, first.
RUNNING = np.array([[9.0, 0.1, 0.2, 0.3, 0.4, 0.5], [9.0, 0.6, 0.7, 0.8, 0.9, 1.0]])
LAGS = np.array([RUNNING * 2, RUNNING * 3])
TAIL = RUNNING / 10


def frame(lipschitz=None):
    """Two lags, one w, one measured state; Y = (1, 2, 5), mu = 3, eta = 7, T = 1/2."""
    made = object.__new__(FromStarts)
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
    monkeypatch.setattr(start, "steady", lambda period, row: map(flint.arb, at_rest[row]))
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

"""Corners of all that has a range: constants, the input gain and entries of theta."""

from __future__ import annotations

from dataclasses import replace

import pytest

import certrack
from certrack.core.errors import InputError
from certrack.studies.ensembles.corners import FIRST_CORNER, ranges_of
from certrack.studies.ensembles.members import Members
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.linear.search import continuous_case

#: A range of g_n and of an entry of theta; the other entry's is a point.
GAIN_AND_THETA = """
[plant]
states = ["x", "v"]
chain = [1]
drift = "-K*x"
regressor = ["v", "tanh(v)"]
gain_sign = 1
input_gain = 2
theta = [0.3, 0.1]
[plant.constants]
K = 1
[plant.ranges]
input_gain = [1.5, 2.5]
theta = [[0.1, 0.5], [0.1, 0.1]]
K = [0.75, 1.0625]
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]
[truth]
input_gain = "2.25*K"
theta = ["0.25*K", 0.1]
omega = [0, "0.1*sin(t)"]
[reference]
signal = "0.3*sin(t)"
[law]
kind = "robust"
c = [3, 3]
feedforward = 1
[ensemble]
x0 = [{uniform = [-0.1, 0.1]}, 0]
[simulation]
x0 = [0, 0]
duration = 4
"""


def test_ranges_of_gain_and_theta_have_corners():
    """In the order of the proofs: constants, then g_n, then the entries of theta."""
    system = certrack.loads(GAIN_AND_THETA)
    expected = {"K": (0.75, 1.0625), "input_gain": (1.5, 2.5), "theta[0]": (0.1, 0.5)}
    assert ranges_of(system) == expected
    members = Members(system, 1)
    draws = members.draws(FIRST_CORNER, FIRST_CORNER + 8)
    assert draws["constants.K"].tolist() == [0.75, 1.0625] * 4
    assert draws["input_gain"].tolist() == [1.5, 1.5, 2.5, 2.5] * 2
    assert draws["theta[0]"].tolist() == [0.1] * 4 + [0.5] * 4
    assert draws["x0[0]"].tolist() == members.draws(0, 8)["x0[0]"].tolist()
    assert "input_gain" not in members.draws(0, 8) and "theta[1]" not in draws
    truth = members.corner(6).truth
    assert float(truth.input_gain.expr) == 2.5 and float(truth.theta[0].expr) == 0.5
    written = members.member(3).truth  # its g_n follows the constant that it drew
    assert written.input_gain.text == "2.25*K" and written.theta[0].text == "0.25*K"


@pytest.mark.parametrize("method", ["lockstep", "alone"])
def test_corners_of_gain_and_theta_are_what_their_systems_do(method):
    system = certrack.loads(GAIN_AND_THETA)
    found = certrack.ensemble(system, 2, method=method, limit=1.0)
    assert len(found.corners.errors) == 8 and found.corners.lost == 0
    assert set(found.corners.constants[0]) == {"K", "input_gain", "theta[0]"}
    for k, error in enumerate(found.corners.errors):
        run = certrack.simulate(Members(system, 0).corner(k))
        assert error == pytest.approx(run.metrics.tail_error, rel=1e-4)
    assert len({round(error, 9) for error in found.corners.errors}) == 8
    for i, error in enumerate(found.frame()["tail_error"]):
        assert error == pytest.approx(
            certrack.simulate(found.member(i)).metrics.tail_error, rel=1e-4
        )


def test_all_ranges_count_towards_six():
    """Four constants with g_n and one entry of theta have corners; with one more there are none."""
    text = GAIN_AND_THETA.replace("K = 1\n", "K = 1\nz1 = 1\nz2 = 1\nz3 = 1\n")
    six = text.replace("K = [0.75", "z1 = [0, 2]\nz2 = [0, 2]\nz3 = [0, 2]\nK = [0.75")
    system = certrack.loads(six)
    assert Members(system, 0).draws(FIRST_CORNER, FIRST_CORNER + 64)["theta[0]"].sum() == 32 * 0.6
    Members(system, 0).corner(63)
    seven = certrack.loads(six.replace("[0.1, 0.1]]", "[0.1, 0.2]]"))
    with pytest.raises(InputError, match="1 to 6 ranges"):
        Members(seven, 0).corner(0)
    assert set(Members(seven, 0).draws(0, 1)) < set(Members(system, 0).draws(0, 1))


def test_the_linear_falsifier_takes_corners_of_gain_and_theta():
    system = certrack.loads(GAIN_AND_THETA.replace('"tanh(v)"', '"x"'))
    case = continuous_case(system, tuple(reference_bounds(system, 2)))
    truth = case.system.truth
    ends = float(truth.input_gain.expr), float(truth.theta[0].expr)
    assert ends[0] in (1.5, 2.5) and ends[1] in (0.1, 0.5)
    own = simulate_at(system, 2, 0.3)
    assert own < case.error <= certrack.certify(system, effort="fast").best.bound


def simulate_at(system, gain, theta):
    truth = replace(system.truth, input_gain=gain, theta=(theta, 0.1))
    return certrack.simulate(system.replace(truth=truth)).metrics.tail_error

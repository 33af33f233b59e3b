"""The laws of the textbooks: each is a law like any other, and does what its formulas promise."""

import numpy as np
import pytest

import certrack
from certrack.laws.baselines.adrc import Adrc
from certrack.laws.baselines.base import placed_feedback, sliding_row
from certrack.laws.baselines.l1 import L1Adaptive
from certrack.laws.baselines.mrac import Mrac
from certrack.laws.baselines.pid import Pid
from certrack.laws.baselines.sliding import SlidingMode
from certrack.laws.baselines.super_twisting import SuperTwisting
from certrack.laws.plant_coordinates import output_derivatives
from certrack.laws.registry import BASELINES
from certrack.testing import LawConformance


def benchmark(law, **settings):
    """Example 1 with known parameters."""
    base = certrack.load("example1")
    plant = certrack.Plant(
        **{name: getattr(base.plant, name) for name in ("states", "chain", "linear", "drift")},
        regressor=base.plant.regressor,
        gain_sign=1,
        input_gain=2,
        theta=[2],
        uncertainty=base.plant.uncertainty,
    )
    settings = {"duration": 6, "tail": 3} | settings
    return base.replace(plant=plant, law=law).with_settings(**settings)


class TestPid(LawConformance):
    system = benchmark(Pid(k_p=30, k_i=20, k_d=8, filter_time=0.01, feedforward=1))


@pytest.mark.slow
class TestSlidingMode(LawConformance):
    system = benchmark(SlidingMode(feedforward=1))


@pytest.mark.slow
class TestSuperTwisting(LawConformance):
    system = benchmark(SuperTwisting(feedforward=1))


class TestAdrc(LawConformance):
    system = benchmark(Adrc(feedforward=1))


@pytest.mark.slow
class TestMrac(LawConformance):
    system = benchmark(Mrac(feedforward=1))


@pytest.mark.slow
class TestL1(LawConformance):
    system = benchmark(L1Adaptive(feedforward=1))


@pytest.mark.parametrize("law", BASELINES)
def test_a_file_can_name_it(law):
    system = benchmark(law(feedforward=1))
    assert certrack.loads(certrack.to_text(system)) == system
    assert not certrack.certify(system).best.verified
    assert "minimises" not in str(system.design()) and "margins" not in str(system.design())


def test_poles_are_where_they_are_placed():
    plant = certrack.load("dual-motor-lean").plant
    F = plant.b + np.eye(3, 4, 1) * plant.g[:, None]
    poles = np.linalg.eigvals(np.vstack([F, placed_feedback(plant, 3.0)]))
    np.testing.assert_allclose(np.poly(poles), np.poly([-3.0] * 4), rtol=1e-9)
    row = sliding_row(plant, 2.0)  # x_4 where sigma = 0
    on_surface = F[:, :3] - np.outer(F[:, 3], row[:3])
    np.testing.assert_allclose(np.poly(on_surface), np.poly([-2.0] * 3), rtol=1e-9)
    rows = output_derivatives(plant)
    np.testing.assert_allclose(rows[2], [-12, 0, 12, 0])  # x_1'' = 2 K_L/J_L (x_3 - x_1)

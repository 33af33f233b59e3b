"""The shipped laws, and a newcomer's, pass the conformance kit."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import pytest

import certrack
from certrack.core.errors import InputError
from certrack.laws import Classic, Robust
from certrack.laws.base import Equations, Law, Signals, dot, gain
from certrack.model.plant import Plant
from certrack.references import triangle
from certrack.testing import LawConformance


class TestAdaptive(LawConformance):
    system = certrack.load("example1")


class TestAdaptiveOnATriangle(LawConformance):
    system = certrack.load("example1").replace(reference=triangle(0.2, 6.0))


class TestRobust(LawConformance):
    system = certrack.load("dual-motor-lean")


class TestClassic(LawConformance):
    system = certrack.load("example1-classic")


@dataclass(frozen=True, kw_only=True)
class Proportional(Law):
    """A newcomer's law: the robust law with a softened input."""

    kind = "proportional"
    softness: float = gain(above=0, default=1.0)

    def equations(self, s: Signals) -> Equations:
        g, theta = s.parameter("g_n"), s.parameters("theta", s.r)
        return Equations(u=s.parameter("softness") * (s.nu - dot(s.phi, theta)) / g)

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        known = Robust(c=self.c).parameters(plant)
        return {**known, "softness": self.softness}


class TestNewcomer(LawConformance):
    system = certrack.load("dual-motor-lean").replace(
        law=Proportional(c=(2, 2, 2, 2), softness=0.9)
    )


def test_kit_catches_a_wrong_law():
    """A law that forgets the reference in its last error coordinate fails."""

    @dataclass(frozen=True, kw_only=True)
    class Foreign(Robust):
        def equations(self, s: Signals) -> Equations:
            from certrack.core.expressions import symbol

            return Equations(u=super().equations(s).u + symbol("x9"))

    kit = LawConformance()
    kit.system = certrack.load("dual-motor-lean")
    kit.system = replace(kit.system, law=Foreign(c=(1, 1, 1, 1)))
    with pytest.raises(AssertionError, match="unknown symbols"):
        kit.test_uses_only_its_signals()


def test_robust_law_must_know_its_parameters():
    plant = Plant(states=["x1"], regressor=["x1"])
    with pytest.raises(InputError, match="must know g_n"):
        Robust(c=[1]).design(plant)
    with pytest.raises(InputError, match="must know theta"):
        Robust(c=[1]).design(replace(plant, input_gain=1))


def test_classic_law_refuses_what_it_does_not_have():
    with pytest.raises(InputError, match="no damping"):
        Classic(c=[1], k=[[1, 1]])
    with pytest.raises(InputError, match="always has n - 1"):
        Classic(c=[1], feedforward=1)


def test_classic_law_needs_a_smooth_reference():
    system = certrack.load("example1-classic")
    with pytest.raises(InputError, match="needs 2 bounded derivatives of y_d, the reference has 1"):
        system.replace(reference=triangle(0.2, 4.0))

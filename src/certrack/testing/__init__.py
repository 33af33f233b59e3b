"""Conformance tests: write a law or a reference in one file, inherit its tests.

In a test file of your own::

    from certrack import load
    from certrack.testing import LawConformance

    class TestMyLaw(LawConformance):
        system = load("example1").replace(law=MyLaw(c=(1, 0.5)))

pytest then runs every ``test_`` method below on your law. A law that is not defined everywhere (a
barrier, say) states the points at which it is tested::

        points = [(0.5, {"x1": 0.3, "x2": 0.1, "bias": 0.2})]

:class:`ReferenceConformance` does the same for a reference, :class:`DisturbanceConformance` for a
family of disturbances, :class:`DistributionConformance` for a distribution. What cannot be tested
where it runs (no heyoka, no compiler, a law that states nothing) is skipped, and says so.
"""

from certrack.testing.distribution import DistributionConformance
from certrack.testing.disturbance import DisturbanceConformance
from certrack.testing.law import LawConformance
from certrack.testing.reference import ReferenceConformance

__all__ = [
    "DistributionConformance",
    "DisturbanceConformance",
    "LawConformance",
    "ReferenceConformance",
]

"""Ranges of constants, and of what the robust law takes for known, have a bound."""

from pathlib import Path

import pytest

import certrack

CASES = Path(__file__).parents[1] / "data" / "cases"


@pytest.mark.parametrize(
    ("name", "varying", "fixed"),
    [
        ("ranges-joint", 0.0335, 0.0263),
        ("ranges-dual-motor", 0.0103, 0.0034),
        ("ranges-axis", 0.00062, 0.00055),
        ("robrange", 0.0632, 0.0632),
    ],
)
def test_ranges_have_bounds(name, varying, fixed, tmp_path):
    system = certrack.load(CASES / f"{name}.toml")
    found = certrack.certify(system)
    assert found.verified and found.vertices.verified and found.vertices.bound <= varying
    assert found.attainable < found.best.bound <= fixed
    assert not found.semidefinite.exists and "plant.ranges lets" in found.semidefinite.reason
    certrack.certificates.save_certificate(system, found.stages, tmp_path / "c.json")
    verdict = certrack.certificates.verify(tmp_path / "c.json")
    assert verdict.verified and float(verdict.bound) <= found.best.bound

"""Estimates in floats that lead a search, and what is made of them where they promise too much."""

from __future__ import annotations

import numpy as np
import pytest
from test_sectors import system_of

from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.ranges.boxes import moved, scaled
from certrack.certificates.ranges.cells import halved
from certrack.certificates.ranges.edges import largest_scale
from certrack.certificates.ranges.estimates import estimated_peak_gains
from certrack.certificates.ranges.kernels import peak_gains
from certrack.certificates.ranges.proofs import RangeProver, cells_fill
from certrack.certificates.ranges.strength import critical_ranges

exact = np.vectorize(rational, otypes=[object])


@pytest.mark.parametrize("seed", range(6))
def test_estimates_are_near_what_is_proven(seed):
    rng = np.random.default_rng([seed, 9])
    n = int(rng.integers(1, 5))
    M = np.round(rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-1, 1), 3)
    M -= np.round(np.linalg.eigvals(M).real.max() + 10.0 ** rng.uniform(-1, 1), 3) * np.eye(n)
    C, B = np.round(rng.normal(size=(2, n)), 2), np.round(rng.normal(size=(n, 2)), 2)
    proven = peak_gains(exact(M), exact(C), exact(B))
    assert estimated_peak_gains(M, C, B) == pytest.approx(proven, rel=0.02)


def test_an_unstable_loop_has_no_estimate():
    with pytest.raises(NoCertificate, match="not stable"):
        estimated_peak_gains(np.array([[1e-9]]), np.eye(1), np.eye(1))
    with pytest.raises(NoCertificate):
        estimated_peak_gains(np.array([[-np.inf]]), np.eye(1), np.eye(1))


def test_promises_that_are_not_kept_do_not_count(monkeypatch):
    prover = RangeProver(system_of("(K - 1)*abs(x)", c=1), sectors=True)
    honest = critical_ranges(prover, cells=True, known=False).scale
    assert 0 < honest < 10
    monkeypatch.setattr(prover, "promises", lambda cell: True)
    assert critical_ranges(prover, cells=True, known=False).scale == pytest.approx(honest, rel=0.03)
    monkeypatch.setattr(prover, "holds", lambda cell: False)
    assert critical_ranges(prover, cells=True, known=False).scale == 0
    kept = critical_ranges(prover, cells=True, known=True)
    assert kept.scale == 1


def test_cells_of_one_scale_fill_the_box_of_another():
    prover = RangeProver(system_of("-K*abs(x)"), sectors=True)
    loop = prover.loop
    cells = halved(loop.box, [1, 1], loop.moving)
    for factor in ("1/3", "5/2"):
        scale = rational(factor)
        others = [moved(loop, cell, scale) for cell in cells]
        assert cells_fill(others, scaled(loop, scale))
        assert all(cell[-1] == loop.box[-1] for cell in others)


def test_a_search_may_begin_a_little_above_the_edge():
    tried = []

    def find(scale):
        tried.append(float(scale))
        return True if float(scale) <= 0.9 else "beyond"

    found = largest_scale(find, accuracy=0.01, fall=1.02)
    assert 0.89 < float(found.scale) <= 0.9 and found.reason == "beyond"
    assert tried[:3] == [1, 0.98039, 0.94232]

"""The reproduction: measured values against the independently computed table."""

import pytest

from certrack.papers.liu2025 import _example1_variants, reproduce, theorem_1_counterexample

# Computed beside this project from the paper's equations: (x0, sign of y_d) -> improved and classic
# (settling, tail, peak, energy).
TABLE = {
    ((1, 2), 1): ((2.15, 0.0336, 12.90, 33.1), (10.50, 0.1125, 9.83, 60.3)),
    ((1, 2), -1): ((3.08, 0.0336, 19.62, 39.5), (11.58, 0.0942, 10.43, 71.2)),
    ((1, -2), 1): ((1.02, 0.0336, 7.79, 26.9), (11.77, 0.1611, 24.94, 164.6)),
}


def test_example_1_in_every_known_sign_variant():
    variants = dict(_example1_variants())
    assert len(variants) == 8
    for key, expected in TABLE.items():
        for run, (settling, tail, peak, energy) in zip(variants[key], expected, strict=True):
            found = run.metrics
            assert found.settling_time == pytest.approx(settling, abs=0.0051)
            assert found.tail_error == pytest.approx(tail, abs=5e-4)  # theirs is from a grid
            assert found.peak_input == pytest.approx(peak, rel=1e-3)  # theirs is from a grid
            assert found.input_energy == pytest.approx(energy, abs=0.051)


def test_claims_are_judged_as_the_theory_does():
    found = reproduce(budget=300)
    verdicts = {(claim.where, claim.statement): claim.verdict for claim in found.claims}
    by_start = {statement[:40]: verdict for (_, statement), verdict in verdicts.items()}
    assert by_start["less control effort (integral of u^2)"[:40]] == "holds"
    assert by_start["less control effort (peak |u|)"[:40]] == "differs"
    assert by_start["the output tracks the reference"[:40]] == "differs"
    assert sum(verdict == "holds" for verdict in verdicts.values()) == 7
    assert sum(verdict == "ambiguous" for verdict in verdicts.values()) == 2
    for bounds in found.bounds.values():  # the order that must hold
        assert bounds["simulated"] <= bounds["semidefinite"] <= bounds["corrected"]
        assert bounds["falsified"] <= bounds["semidefinite"]
    assert found.bounds["dual-motor-lean"]["published"] == float("inf")
    assert found.runs["dual-motor"].metrics.tail_error == pytest.approx(0.0260, abs=5e-5)
    assert found.runs["dual-motor-strong"].metrics.tail_error == pytest.approx(0.0261, abs=5e-5)


def test_counterexample_to_the_last_step_of_theorem_1():
    assert theorem_1_counterexample() == pytest.approx(3.09, abs=0.005)

"""What the paper does not claim and its reader should know."""

from __future__ import annotations

from collections.abc import Iterator

from certrack.certificates.published import certify_published, collect
from certrack.core.rounding import rounded_up
from certrack.papers.liu2025.claim import Observation
from certrack.papers.liu2025.example1 import LATE
from certrack.papers.liu2025.measures import both
from certrack.papers.liu2025.runs import PaperRuns, scaled_damping
from certrack.simulation.simulator import simulate
from certrack.systems.reader import load


def observations(runs: PaperRuns) -> Iterator[Observation]:
    """Observations of ours, each measured."""
    laws = runs.laws
    late = both(laws, lambda r: r.supremum("e_1", LATE))
    yield Observation(
        "Example 1",
        f"the classic law ends more accurate: sup |e_1|, t > {LATE:g} s: {late[0]:.4f} (improved) "
        f"against {late[1]:.4f}, {late[0] / late[1]:.1f} times",
    )
    strong, error = runs.certificates["dual-motor-strong"], runs.motors[1].supremum("e_1", 10)
    yield Observation(
        "Example 2, Figure 4",
        f"the guarantee (42) behind the figure is {rounded_up(strong.published.bound, 4)}, "
        f"{rounded_up(strong.published.bound / 0.1, 2)} times the amplitude of y_d; what is seen "
        f"is {error:.4f}, what is proven exactly {rounded_up(strong.best.bound, 4)}",
    )
    yield _price_of_small_delta()
    lean = runs.lean.metrics
    yield Observation(
        "Remark 5",
        "without damping terms and with y_d' in every step (dual-motor-lean) the servo errs by "
        f"{lean.tail_error:.5f} instead of {runs.weak.metrics.tail_error:.4f} at a peak input of "
        f"{lean.peak_input:.1f} instead of {runs.weak.metrics.peak_input:.1f}",
    )
    yield Observation(
        "Example 2",
        "K_L is stated in N m/A; the stiffness that (1) needs is in N m/rad",
    )


def _price_of_small_delta() -> Observation:
    """Remark 4 with everything that depends on k and p."""
    motor = load("dual-motor")
    smaller = scaled_damping(motor, 0.3)
    terms = collect(smaller, critical=True)
    run = simulate(smaller, duration=1e-6, tail=0.0)  # |u| is largest at the start
    bounds = [
        certify_published(scaled_damping(load("example1"), f))["published"].bound
        for f in (1.0, 0.3, 0.1)
    ]
    return Observation(
        "Remark 4",
        "a smaller Delta has a price: A depends on k and p. With k and p of Example 2 times 0.3, "
        f"mu_1 = {terms.mu1(0):.3g} < 0 (no bound is left) and the input peaks at "
        f"{run.metrics.peak_input:.2g}; in Example 1 (42) goes "
        f"{', '.join(rounded_up(b, 3) for b in bounds)} with k and p times 1, 0.3, 0.1",
    )

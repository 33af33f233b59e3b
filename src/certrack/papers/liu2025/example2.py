"""Section 5, Example 2: the dual-motor servo with tau = 1 and tau = 5."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certrack.papers.liu2025.claim import AMBIGUOUS, Claim, judged
from certrack.papers.liu2025.example1 import COSINE_AMPLITUDE
from certrack.papers.liu2025.measures import BAND, both
from certrack.papers.liu2025.premises import premises_claim
from certrack.papers.liu2025.runs import PaperRuns

#: Of y_d = 0.1 sin 0.75 t.
SINE_AMPLITUDE = 0.1

#: What "about 2 s later" admits, s, and when the tails are compared.
ABOUT_2_S, TAIL = 2.5, 10.0

#: Tails that differ by less than this part of the signal have not changed significantly.
INSIGNIFICANT = 0.05

STATES = ("xi_1", "xi_2", "xi_3", "xi_4")


def example2_claims(runs: PaperRuns) -> Iterator[Claim]:
    """The claims of Example 2 in the order of its text."""
    yield premises_claim("Example 2", "dual-motor")
    yield from _tracking_claims(runs)
    yield _settling(runs)
    yield from _stronger(runs)
    peaks = ", ".join(f"{x0}: {run.metrics.peak_input:.1f}" for x0, run in runs.starts.items())
    yield Claim(
        "Example 2",
        "x(0) (one sign is lost in our copy)",
        "peak |u| from the three readings; the paper states no peak to tell by, but gives xi_1(0) "
        "apart from xi_2(0) = xi_3(0), so the first is unlikely",
        f"{peaks}; we take (-1, 1, 1, 0)",
        AMBIGUOUS,
    )


def _tracking_claims(runs: PaperRuns) -> Iterator[Claim]:
    weak = runs.motors[0]
    final = weak.final_range("e_1")
    yield Claim(
        "Example 2, Figure 3(a)",
        "the servo tracks after about 2 s",
        "as in Example 1: last time |e_1| leaves the band of 0.05",
        f"|e_1| < {BAND} from {weak.within('e_1', BAND):.2f} s on",
        judged(weak.within("e_1", BAND) < ABOUT_2_S),
        f"before {ABOUT_2_S:g} s",
    )
    yield Claim(
        "Example 2, Figure 3(a)",
        "the output tracks the reference",
        "practical tracking, as in Example 1: e_1 settles into a final range, the sup over the "
        "second half of the run, within the band of 0.05; how small it is stands beside it",
        f"final range {final:.4f}, {100 * final / SINE_AMPLITUDE:.0f} % of the amplitude, from "
        f"{weak.settles('e_1'):.2f} s on (Example 1: {runs.laws[0].final_range('e_1'):.4f}, "
        f"{100 * runs.laws[0].final_range('e_1') / COSINE_AMPLITUDE:.0f} %)",
        judged(final < BAND),
        f"final range below {BAND}",
    )


def _settling(runs: PaperRuns) -> Claim:
    weak = runs.motors[0]
    names = ("e_1", "xi_2", "xi_3", "xi_4", "u")
    times = {name: weak.settles(name) for name in names}
    return Claim(
        "Example 2, Figure 3",
        "e_1, xi_2, xi_3, xi_4 and u are in a bounded region after about 2 s",
        "from when on the magnitude is within 1.05 times its final range, the sup over the second "
        "half of the run: every signal of a finite run is bounded, what is meant is that it has "
        "settled",
        ", ".join(f"{name} {time:.2f} s" for name, time in times.items()),
        judged(max(times.values()) < ABOUT_2_S),
        f"all before {ABOUT_2_S:g} s",
    )


def _stronger(runs: PaperRuns) -> Iterator[Claim]:
    weak, strong = runs.motors
    shares, early = {}, {}
    for name in STATES:
        a, b = weak.signals[name], strong.signals[name]
        tail = weak.t >= TAIL
        early[name] = float(np.abs(a - b).max())
        shares[name] = float(np.abs(a - b)[tail].max() / np.abs(a[tail]).max())
    errors = both(runs.motors, lambda r: r.supremum("e_1", TAIL))
    yield Claim(
        "Example 2, Figures 3(a)(b), 4(a)(b)",
        "tau = 5 instead of 1 does not change output and states significantly",
        f"largest difference from {TAIL:g} s on as a part of the signal's largest value there, "
        "since the start would hide it; the largest over the whole run beside it",
        ", ".join(f"{name} {100 * share:.2f} %" for name, share in shares.items())
        + "; whole run "
        + ", ".join(f"{value:.2g}" for value in early.values())
        + f"; tail error {errors[0]:.4f} and {errors[1]:.4f}",
        judged(max(shares.values()) < INSIGNIFICANT),
        f"less than {100 * INSIGNIFICANT:g} %",
    )
    peaks = both(runs.motors, lambda r: r.supremum("u", TAIL))
    energies = both(runs.motors, lambda r: float((r.after("u", TAIL) ** 2).mean()) * TAIL)
    yield Claim(
        "Example 2, Figures 3(c), 4(c)",
        "once u has settled, tau = 5 takes more control effort",
        f"largest |u| and integral of u^2 from {TAIL:g} s on",
        f"max |u| {peaks[0]:.3f} and {peaks[1]:.3f}; integral {energies[0]:.2g} and "
        f"{energies[1]:.2g}",
        judged(peaks[1] > peaks[0] and energies[1] > energies[0]),
    )

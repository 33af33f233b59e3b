"""Section 5, Example 1: the improved law beside the classic one."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from certrack.papers.liu2025.claim import AMBIGUOUS, Claim, judged
from certrack.papers.liu2025.measures import BAND, Response, both, response_times
from certrack.papers.liu2025.premises import premises_claim
from certrack.papers.liu2025.runs import PaperRuns
from certrack.simulation.run import Run

#: Of y_d = 0.2 cos t.
COSINE_AMPLITUDE = 0.2

#: From when on the improved law is settled, and from when on the classic one is, too, in s.
SETTLED, LATE = 3.0, 15.0

#: The paper's letters of what Figures 2(b) to 2(d) show.
SHOWN = ("xi_2", "delta_hat", "theta_hat", "u")


def example1_claims(runs: PaperRuns) -> Iterator[Claim]:
    """The claims of Example 1 in the order of its text."""
    laws = runs.laws
    yield premises_claim("Example 1", "example1")
    yield from _tracking(runs)
    yield from _fluctuation_of_output(laws)
    yield _faster(laws)
    yield from _calmer(laws)
    yield from _effort(runs)
    yield _signs(runs)


def _every(runs: PaperRuns, test: Callable[[Run, Run], bool]) -> str:
    holding = sum(test(a, b) for a, b in runs.example1.values())
    return f"in {holding} of {len(runs.example1)} sign variants"


def _is_faster(a: Run, b: Run) -> bool:
    return not a.metrics.settling_time > b.metrics.settling_time


def _tracking(runs: PaperRuns) -> Iterator[Claim]:
    improved, classic = runs.laws
    rule = (
        "last time |e_1| leaves the band of 0.05 (a quarter of the amplitude, twice the final "
        "error of both examples); beside it when e_1 is within 1.05 times its final range, the "
        "sup over the second half of the run. Practical tracking asks for no more"
    )
    yield Claim(
        "Example 1, Figure 2(a)",
        "the improved law tracks after about 3 s",
        rule,
        f"|e_1| < {BAND} from {improved.within('e_1', BAND):.2f} s on, "
        + _every(runs, lambda a, _: a.metrics.settling_time < 3.5)
        + f" before 3.5 s; {_range_text(improved)}",
        judged(improved.within("e_1", BAND) < 3.5),
        "before 3.5 s",
    )
    yield Claim(
        "Example 1, Figure 2(a)",
        "the classic law tracks only after 10 s",
        "as in the row before",
        f"|e_1| < {BAND} from {classic.within('e_1', BAND):.2f} s on; the improved law is faster "
        + _every(runs, _is_faster)
        + f"; {_range_text(classic)}",
        judged(classic.within("e_1", BAND) > 10),
        "after 10 s",
    )


def _range_text(response: Response) -> str:
    final = response.final_range("e_1")
    share = 100 * final / COSINE_AMPLITUDE
    return (
        f"final range {final:.4f} ({share:.0f} % of the amplitude) from "
        f"{response.settles('e_1'):.2f} s on"
    )


def _fluctuation_of_output(laws: tuple[Response, Response]) -> Iterator[Claim]:
    y_d = laws[0].after("xi_1", LATE) - laws[0].after("e_1", LATE)
    reference = float(np.abs(np.diff(y_d)).sum())
    yield Claim(
        "Example 1, Figure 2(a)",
        "after tracking, the output of the improved law fluctuates less",
        f"total variation of xi_1 from {SETTLED:g} s on, which counts how often and how far it "
        f"moves; also from {LATE:g} s on, when both laws track",
        f"t > {SETTLED:g} s: {_pair(laws, 'xi_1', SETTLED)}; t > {LATE:g} s: "
        f"{_pair(laws, 'xi_1', LATE, 4)} (y_d itself: {reference:.4f})",
        judged(all(_less(laws, "xi_1", start) for start in (SETTLED, LATE))),
        "smaller in both spans",
    )
    turns = both(laws, lambda r: r.turns("xi_1", SETTLED))
    sizes = both(laws, lambda r: r.supremum("e_1", SETTLED))
    yield Claim(
        "Example 1, Figure 2(a)",
        "few small fluctuations under the improved law, frequent large ones under the classic law",
        f"turns of xi_1 (how frequent) and sup |e_1| (how large) from {SETTLED:g} s on",
        f"turns {turns[0]:.0f} against {turns[1]:.0f}; sup |e_1| {sizes[0]:.3f} against "
        f"{sizes[1]:.3f}",
        judged(turns[0] < turns[1] and sizes[0] < sizes[1]),
        "fewer and smaller",
    )


def _pair(laws: tuple[Response, Response], name: str, start: float, digits: int = 2) -> str:
    a, b = both(laws, lambda r: r.total_variation(name, start))
    return f"{a:.{digits}f} against {b:.{digits}f}"


def _less(laws: tuple[Response, Response], name: str, start: float) -> bool:
    a, b = both(laws, lambda r: r.total_variation(name, start))
    return a < b


def _faster(laws: tuple[Response, Response]) -> Claim:
    times = {name: response_times(laws, name) for name in SHOWN}
    text = ", ".join(f"{name} {a:.2f}/{b:.2f}" for name, (a, b) in times.items())
    return Claim(
        "Example 1, Figures 2(b)-(d)",
        "xi_2, delta_hat, theta_hat and u respond faster under the improved law",
        "from when on the signal is as close to its values of the second half of the run as 5 % of "
        "the larger excursion of both laws: the same distance for both",
        f"improved/classic, s: {text}",
        judged(all(a < b for a, b in times.values())),
        "sooner, all four",
    )


def _calmer(laws: tuple[Response, Response]) -> Iterator[Claim]:
    spans = []
    for start in (0.0, SETTLED):
        pairs = {n: both(laws, lambda r, n=n, s=start: r.total_variation(n, s)) for n in SHOWN}  # type: ignore[misc]
        spans.append(pairs)
    texts = [
        ", ".join(f"{name} {a:.3g}/{b:.3g}" for name, (a, b) in pairs.items()) for pairs in spans
    ]
    yield Claim(
        "Example 1, Figures 2(b)-(d)",
        "xi_2, delta_hat, theta_hat and u fluctuate less under the improved law",
        f"total variation, over the whole run and from {SETTLED:g} s on",
        f"improved/classic, whole run: {texts[0]}; t > {SETTLED:g} s: {texts[1]}",
        judged(all(a < b for pairs in spans for a, b in pairs.values())),
        "smaller, all four in both spans",
    )
    peaks = {name: both(laws, lambda r, n=name: r.supremum(n)) for name in SHOWN}  # type: ignore[misc]
    yield Claim(
        "Example 1, Figures 2(b)-(d)",
        "the same, by how far they swing",
        "largest magnitude, since a fluctuation may also be one large swing",
        "improved/classic: " + ", ".join(f"{n} {a:.3f}/{b:.3f}" for n, (a, b) in peaks.items()),
        judged(all(a < b for a, b in peaks.values())),
        "smaller, all four",
    )


def _effort(runs: PaperRuns) -> Iterator[Claim]:
    laws = runs.laws
    ours, theirs = (run.metrics for run in runs.example1[(1, 2), 1])
    yield Claim(
        "Example 1, last sentence",
        "less control effort (integral of u^2)",
        "integral of u^2, the usual meaning of effort; the paper does not define it",
        f"{ours.input_energy:.1f} against {theirs.input_energy:.1f}; smaller "
        + _every(runs, lambda a, b: a.metrics.input_energy < b.metrics.input_energy),
        judged(ours.input_energy < theirs.input_energy),
    )
    yield Claim(
        "Example 1, last sentence",
        "less control effort (peak |u|)",
        "largest |u|, the other usual meaning: what the actuator must be able to give",
        f"{ours.peak_input:.2f} against {theirs.peak_input:.2f}; smaller "
        + _every(runs, lambda a, b: a.metrics.peak_input < b.metrics.peak_input),
        judged(ours.peak_input < theirs.peak_input),
    )
    after = both(laws, lambda r: r.supremum("u", SETTLED))
    yield Claim(
        "Section 6",
        "the improved law has certain advantages in response time and fluctuation degree",
        "the rows of Figure 2 together; 'certain' admits that it need not be better in everything",
        f"both verdicts as above; largest |u| from {SETTLED:g} s on {after[0]:.2f} against "
        f"{after[1]:.2f}",
        judged(_is_faster(*runs.example1[(1, 2), 1]) and _less(laws, "xi_1", SETTLED)),
    )


def _signs(runs: PaperRuns) -> Claim:
    settling = [a.metrics.settling_time for a, _ in runs.example1.values()]
    peaks = [a.metrics.peak_input for a, _ in runs.example1.values()]
    return Claim(
        "Example 1",
        "x(0) and y_d (their signs are lost in our copy)",
        "the improved law with every sign",
        f"over all {len(runs.example1)} signs: |e_1| < {BAND} from {min(settling):.2f} to "
        f"{max(settling):.2f} s on, peak |u| {min(peaks):.1f} to {max(peaks):.1f}",
        AMBIGUOUS,
    )

"""The best design of a search that has a certificate, where the best of all has none.

Where constants have ranges a search is of their corners: gains exist with a small error at each of
them, and with no proof of what lies between. Designs on the way there are nearer to the start, and
have more in hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from certrack.tuning.candidate import Candidate

#: Certificates that are tried: each takes from a second to half a minute.
MOST_CHECKS = 6


def best_certified(
    improvements: Sequence[Candidate], is_certified: Callable[[Candidate], bool]
) -> tuple[Candidate | None, int]:
    """The best design that is certified, and how many were asked.

    By halving between the first, which has most in hand, and the last, which has no certificate:
    of what is asked the best is taken, and not every one is.

    Parameters
    ----------
    improvements : sequence of Candidate
        That keep all limits, each better than the one before; without the best of all.
    is_certified : callable
        The exact certificate.
    """
    best: Candidate | None = None
    asked = 0
    low, high = 0, len(improvements)  # below low certified, from high on not
    while low < high and asked < MOST_CHECKS:
        # the last first: most often the best but one is certified already
        middle = high - 1 if asked == 0 else (low + high) // 2
        asked += 1
        if is_certified(improvements[middle]):
            best, low = improvements[middle], middle + 1
        else:
            high = middle
    return best, asked

"""Stop an ensemble of which no member finishes: more of them would say nothing new."""

from __future__ import annotations

from collections.abc import Iterator

from certrack.core.errors import CertrackError
from certrack.integrators.base import Outcome
from certrack.simulation.messages import outcome_message
from certrack.studies.ensembles.plan import Range
from certrack.studies.ensembles.statistics import Statistics
from certrack.systems.system import System

#: Did one member in a hundred finish, so many would all be lost with a probability of 8 %.
PROBED_MEMBERS = 256


class AllMembersLost(CertrackError):
    """No member of an ensemble finishes."""


def probe_first(missing: list[Range]) -> Iterator[Range]:
    """The ranges, of which the first begins with the members that are looked at before others."""
    for begin, end in missing:
        if begin == 0 and end > PROBED_MEMBERS:
            yield begin, PROBED_MEMBERS
            begin = PROBED_MEMBERS
        yield begin, end


def require_survivors(total: Statistics, members: int, system: System) -> None:
    """Go on only if a member finishes, or if all that were asked for are done.

    Raises
    ------
    AllMembersLost
        With what became of them, and the words of the most frequent outcome.
    """
    done, outcomes = total.members, total.outcomes
    if done >= members or done < PROBED_MEMBERS or outcomes[Outcome.finished.name]:
        return
    counts = ", ".join(f"{count} {name}" for name, count in outcomes.most_common())
    most = Outcome[outcomes.most_common(1)[0][0]]
    raise AllMembersLost(
        f"ensemble: stopped, for none of the first {done} members finishes ({counts}). "
        f"{outcome_message(most, system)} certrack simulate --member 0 shows one of them"
    )

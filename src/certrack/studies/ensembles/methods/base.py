"""What every method of computing members has to do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from certrack.integrators.base import MethodUnavailable
from certrack.loops.continuous import INTEGRALS, ClosedLoop
from certrack.loops.switching import switching
from certrack.studies.ensembles.statistics import Bands


@dataclass(frozen=True)
class MemberResults:
    """What a method knows of a range of members.

    Attributes
    ----------
    metrics : (M, N) array
        In the order of METRICS; of no meaning for a member that did not reach the end.
    ends : (N,) array, s
        Last time reached; -1 for a member of which nothing was computed.
    run_alone : (N,) array of bool
        Which members have to be simulated each by itself: the method could not finish them.
    """

    metrics: np.ndarray
    ends: np.ndarray
    run_alone: np.ndarray


class Method(ABC):
    """A method of computing the members of an ensemble.

    1. *Construction* compiles everything. It raises ``MethodUnavailable`` if this machine cannot
       do it; a method that could be constructed works.
    2. :meth:`compute` gives exactly the members begin ... end-1. To fill vector registers or to
       keep groups together it may compute neighbours besides, which count nowhere.
    3. It counts in the bands, at every time of the grid, the signals of every member of the range:
       a member that has escaped counts as missing from there on. A member that must be run alone
       is counted up to its last time and not after it; the ordinary run is counted from there.
    4. A member that ends early and is not to be run alone has escaped: nothing else may end one.
    5. What it computes of a member depends on the member alone, bit for bit: not on the range, nor
       on the number of threads.
    6. It may be asked for one range after another, by one thread; it may use several itself.
    """

    @abstractmethod
    def compute(self, begin: int, end: int, bands: Bands) -> MemberResults:
        """Compute the members begin ... end-1 and count their signals in the bands."""


def modes_of(loop: ClosedLoop, *, side_by_side: bool) -> tuple[float, ...]:
    """The modes with which members start; none where the loop does not switch.

    Parameters
    ----------
    loop : ClosedLoop
    side_by_side : bool
        Whether members that stick can be followed side by side, if their surfaces are states of
        their own that do not interact.

    Raises
    ------
    MethodUnavailable
        If each member has to be run by itself.
    """
    switched = switching(loop.rates, loop.states, smooth_rates=len(INTEGRALS))
    if switched is None:
        return ()
    alone = switched.bound or not set(switched.surfaces) <= set(loop.states[: loop.n])
    if alone or not side_by_side:
        raise MethodUnavailable("sign() of a state makes members slide: each is run by itself")
    count = len(switched.surfaces)
    return (1.0,) * count + (0.0,) * count

"""An observer: what a sampled controller computes of states and disturbances that it does not see.

    kalman   all states, from those that are measured
    eso      all states, and what acts on the named rows (an extended state observer)
    dob      what acts on the named rows; states by filtered differences (a disturbance observer)

It belongs to the law, for the law is given its estimates; it runs where the law is sampled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import check_fields, keyed
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant

#: Of states alone; of states and disturbances; of disturbances alone.
KALMAN, ESO, DOB = "kalman", "eso", "dob"
OBSERVER_KINDS = (KALMAN, ESO, DOB)


@dataclass(frozen=True, kw_only=True)
class Observer:
    """What is estimated, and how fast.

    Parameters
    ----------
    kind : {"kalman", "eso", "dob"}
    bandwidth : float > 0, or one per row, 1/s
        Of ``dob``: how fast each estimate follows. Of the others, in the place of weights: one
        number, by which all of them are chosen.
    rows : names of states, optional
        On whose rates something acts that is estimated and compensated; the last one if left out.
        ``kalman`` has none.
    weights : numbers > 0, optional
        Of ``kalman`` and ``eso``: how much each estimated signal moves by itself in a period, over
        the error of a sensor; the states that are not measured, then the rows.

    Raises
    ------
    InputError
        If a number is out of its limits, or does not belong to the kind.
    """

    kind: str = keyed("choice", help="what is estimated", choices=OBSERVER_KINDS)
    bandwidth: float | tuple[float, ...] | None = keyed(
        "number or numbers",
        None,
        help="how fast the estimates are: of each row (dob), or one number instead of the weights",
        unit="1/s",
        above=0,
        otherwise="weights",
    )
    rows: tuple[str, ...] = keyed(
        "names",
        (),
        help="on whose rates acts what is estimated and compensated (eso, dob)",
        shape="names of states",
        otherwise="the last state",
    )
    weights: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="how much it moves by itself in a period, over the error of a sensor (kalman, eso)",
        shape="one number per state that is not measured, then one per row",
        above=0,
        otherwise="by the bandwidth",
    )

    def __post_init__(self) -> None:
        check_fields(self, "law.observer")
        if self.kind == KALMAN and self.rows:
            raise InputError(
                "law.observer.rows",
                "must be left out: kalman estimates states only",
                self.rows,
                'Use kind = "eso"',
            )
        if self.kind == DOB and self.weights is not None:
            raise InputError(
                "law.observer.weights",
                "belongs to kalman and eso; dob has a bandwidth",
                self.weights,
                "State law.observer.bandwidth",
            )
        if (self.bandwidth is None) == (self.weights is None):
            remedy = "State the bandwidth" + ("" if self.kind == DOB else ", or the weights")
            said = "is missing" if self.bandwidth is None else "must be left out beside weights"
            raise InputError("law.observer.bandwidth", said, remedy=remedy)
        if self.kind != DOB and isinstance(self.bandwidth, tuple):
            raise InputError(
                "law.observer.bandwidth", f"of {self.kind} must be one number", self.bandwidth
            )

    def bound_to(self, plant: Plant, implementation: Implementation) -> Observer:
        """This observer with rows and their numbers filled in, in the order of the states.

        Raises
        ------
        InputError
            If there are other numbers of rows, bandwidths or weights, or nothing to estimate.
        """
        for i, name in enumerate(self.rows):
            checks.choice(f"law.observer.rows[{i}]", name, plant.states)
            if name in self.rows[:i]:
                raise InputError(f"law.observer.rows[{i}]", "stands there already", name)
        rows: tuple[str, ...] = ()
        if self.kind != KALMAN:
            named = self.rows or plant.states[-1:]
            rows = tuple(name for name in plant.states if name in named)
        bandwidth: Any = self.bandwidth
        if self.kind == DOB:
            values = bandwidth if isinstance(bandwidth, tuple) else (bandwidth,) * len(rows)
            shape = f"one number, or one per row ({', '.join(self.rows or rows)})"
            checks.sequence("law.observer.bandwidth", values, len(rows), shape)
            of_row = dict(zip(self.rows or rows, values, strict=True))
            bandwidth = tuple(of_row[name] for name in rows)
        weights = self.weights
        if weights is not None:
            count, stated = len(implementation.velocity), self.rows or rows
            estimated = (*implementation.velocity, *stated)
            shape = f"one number for each of {', '.join(estimated) or 'no state'}"
            checks.sequence("law.observer.weights", weights, len(estimated), shape)
            weight_of = dict(zip(stated, weights[count:], strict=True))
            weights = (*weights[:count], *(weight_of[name] for name in rows))
        if self.kind != DOB and implementation.velocity_filter:
            raise InputError(
                "implementation.velocity_filter",
                f"filters nothing: the {self.kind} observer takes no differences",
                implementation.velocity_filter,
                "Leave it out",
            )
        return replace(self, rows=rows, bandwidth=bandwidth, weights=weights)

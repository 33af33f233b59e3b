"""How fast an uncertain term may change: w_k = s_k + f_k, a slow part and a fast one.

    |f_k| <= fast_k,    |s_k| <= (bound of w_k) - fast_k,
    |s_k(t) - s_k(t')| <= rate_k |t - t'| + sum_j Delta_rate_kj |x_j(t) - x_j(t')|    between jumps,

and s_k jumps by at most jump_k, with at least `dwell` between two of its jumps. So w_k stays within
its bound, and what does not know of rates is right as it was. Where s_k follows states, and does
not jump, it may be taken for a function s_k(t, x) of which all this holds at any t and x, and not
along the motion alone: a hysteresis belongs to the fast part. A w_k that is slow as a whole has
such parts: shrunk by fast_k towards zero it is as slow, and below its bound by fast_k.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import keys_of

if TYPE_CHECKING:
    from certrack.model.uncertainty import Uncertainty

TABLE = "plant.uncertainty"

#: The keys, `rate` first: the others say more of it.
RATE, JUMP, DWELL, FAST, DELTA_RATE = SLOWNESS = ("rate", "jump", "dwell", "fast", "Delta_rate")

#: Keeps what is as fast as it may be below that in spite of rounding.
SLOW_ROUNDING = 1e-12


@dataclass(frozen=True)
class Slowness:
    """What is known of one w_k.

    Attributes
    ----------
    rate : float, 1/s
    by_states : n floats
        Row of Delta_rate.
    jump : float
    dwell : float, s
        inf where there is no jump.
    fast : float
    """

    rate: float
    by_states: tuple[float, ...]
    jump: float
    dwell: float
    fast: float


def slowness_of(u: Uncertainty, k: int) -> Slowness | None:
    """What is known of w_k; None if nothing is."""
    if u.rate is None or math.isinf(u.rate[k]):
        return None
    jump = 0.0 if u.jump is None else u.jump[k]
    return Slowness(
        rate=u.rate[k],
        by_states=(0.0,) * len(u.tau) if u.Delta_rate is None else u.Delta_rate[k],
        jump=jump,
        dwell=math.inf if not jump or u.dwell is None else u.dwell,
        fast=0.0 if u.fast is None else u.fast[k],
    )


def read_slowness(
    owner: type[Uncertainty],
    values: Mapping[str, Any],
    n: int,
    constants: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The keys that are there, as numbers; irrational ones rounded to the safe side."""
    keys, read = keys_of(owner), dict[str, Any]()
    for name in (RATE, JUMP, FAST):
        if values.get(name) is not None:
            infinite = keys[name].infinite
            limits: dict[str, Any] = {"least": 0, "side": 1, "infinite": infinite}
            where, shape = f"{TABLE}.{name}", keys[name].shape
            read[name] = checks.reals(where, values[name], n, shape, constants, **limits)
    if values.get(DWELL) is not None:
        read[DWELL] = checks.real(f"{TABLE}.{DWELL}", values[DWELL], constants, above=0, side=-1)
    if values.get(DELTA_RATE) is not None:
        where, shape = f"{TABLE}.{DELTA_RATE}", keys[DELTA_RATE].shape
        rows = checks.sequence(where, values[DELTA_RATE], n, f"{shape} (n = {n})")
        read[DELTA_RATE] = tuple(
            checks.reals(
                f"{where}[{k}]", row, n, "one number per state", constants, least=0, side=1
            )
            for k, row in enumerate(rows)
        )
    return read


def check_slowness(u: Uncertainty) -> None:
    """Refuse keys that say nothing without another, or that contradict each other.

    Raises
    ------
    InputError
    """
    for name in (JUMP, FAST, DELTA_RATE):
        if getattr(u, name) is not None and u.rate is None:
            what = "says something of slow terms, and needs rate"
            raise InputError(f"{TABLE}.{name}", what, remedy=f"Add rate, or remove {name}")
    jumps = u.jump is not None and any(u.jump)
    if jumps and u.dwell is None:
        what = "needs dwell, the least time between two jumps"
        raise InputError(f"{TABLE}.{JUMP}", what, list(u.jump or ()), "Add dwell in seconds")
    if u.dwell is not None and not jumps:
        raise InputError(
            f"{TABLE}.{DWELL}", "belongs to jump", u.dwell, "Add jump, or remove dwell"
        )
    for name in (JUMP, FAST, DELTA_RATE):
        for k, entry in enumerate(getattr(u, name) or ()):
            said = any(entry) if isinstance(entry, tuple) else entry
            if said and u.rate is not None and math.isinf(u.rate[k]):
                what = f"must be zero where rate[{k}] is inf"
                shown = list(entry) if isinstance(entry, tuple) else entry
                raise InputError(f"{TABLE}.{name}[{k}]", what, shown, f"Give rate[{k}] a number")
    for k, size in enumerate(u.fast or ()):
        if size and u.formula(k) is not None:
            what = f"must be zero where bound[{k}] is a formula"
            raise InputError(f"{TABLE}.{FAST}[{k}]", what, size, "Use gamma, beta and Delta there")
        if size > u.beta[k]:
            what = f"must be at most beta[{k}] = {u.beta[k]:g}, as it is a part of w_{k + 1}"
            raise InputError(f"{TABLE}.{FAST}[{k}]", what, size, f"Raise beta[{k}]")


def slow_size(u: Uncertainty, k: int, fastest: float) -> float | None:
    """The largest A for which A s(t), |s| <= 1, |s'| <= `fastest`, is an admissible w_k.

    None where nothing is known of how fast w_k may change.
    """
    slowness = slowness_of(u, k)
    if slowness is None:
        return None
    return min(u.beta[k], slowness.rate / fastest) * (1 - SLOW_ROUNDING)


def follows_growth(u: Uncertainty, k: int) -> bool:
    """Whether gamma_k ||S_k x|| + sum_j Delta_kj |x_j| is admissible as a part of a slow w_k."""
    slowness = slowness_of(u, k)
    if slowness is None or u.formula(k) is not None:
        return False
    Delta = (0.0,) * len(u.tau) if u.Delta is None else u.Delta[k]
    slopes = zip(slowness.by_states, u.norm_weights(k), Delta, strict=True)
    return all(allowed >= u.gamma[k] * s + d for allowed, s, d in slopes)

"""The shortest move from rest to rest under limits of speed, acceleration, jerk and snap.

The highest limited derivative is bang-bang: at its limit, or zero where a lower one is at its own.
The speed is symmetric in time, so a move is its first half, maybe a cruise, and the mirrored half.
Up to jerk these profiles are the shortest there are. With a limited snap they are while the speed
stays below its limit or only touches it; where the move cruises, the strict optimum approaches the
limit in infinitely many switches (chattering) and gains less than a thousandth of the time: there
the speed is brought to its limit once, in the shortest time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

from certrack.references.profiles.phases import Phase, Profile, travelled

#: Names of the limits, from the first derivative on.
MOTION_LIMITS = ("speed", "acceleration", "jerk", "snap")

#: Part of a root that is not resolved.
ROOT_RESOLUTION = 1e-15


@lru_cache(maxsize=1024)
def shortest(distance: float, limits: tuple[float, ...]) -> Profile:
    """Phases of the shortest move over a distance.

    Parameters
    ----------
    distance : float
        Positive.
    limits : one to four numbers
        Of y', y'', ..., positive; inf where a derivative has none. The last one is finite.

    Returns
    -------
    Profile
        Durations in s; values are those of the highest limited derivative.
    """
    if len(limits) == 4:
        return _snap_limited(distance, *limits)
    return _recursive(distance, limits)


def _recursive(distance: float, limits: Sequence[float]) -> Profile:
    """Speed up in the shortest time, cruise, slow down."""
    top, *higher = limits
    if not higher:
        return Profile((Phase(distance / top / 2, top),), 0.0, 1)
    peak = min(top, _peak_speed(distance, higher))
    up = _recursive(peak, higher)
    cruise = max(0.0, distance / top - up.duration) if peak == top else 0.0
    return Profile(up.phases(), cruise, len(limits))


def _peak_speed(distance: float, higher: Sequence[float]) -> float:
    """With peak v times the time of the speed-up as the distance, if the speed has no limit."""
    if len(higher) == 1:
        return math.sqrt(distance * higher[0])
    return _solve(lambda v: v * _recursive(v, higher).duration, distance)


def _snap_limited(distance: float, speed: float, *higher: float) -> Profile:
    acceleration, jerk, snap = higher

    def profile(a: float, hold: float, share: float) -> Profile:
        """Acceleration up to a, held, and back to zero.

        The last phase, in which the jerk falls, has this share of the one in which it grows.
        """
        bend = 0.5 + share - share**2 / 2
        grow = min(math.sqrt(a / (snap * bend)), jerk / snap)
        steady = max(0.0, (a - snap * grow**2 * bend) / jerk)
        fall = (Phase(grow, -snap), Phase(steady, 0.0), Phase(share * grow, snap))
        rise = (*_recursive(a, (jerk, snap)).phases(), Phase(hold, 0.0))
        return Profile(rise, 0.0, 4, fall)

    def reaching(wanted: float, what: Callable[[Profile], float], share: float) -> Profile:
        """The profile of which something that grows with a, and with the hold, is as wanted."""
        if acceleration < math.inf and what(profile(acceleration, 0.0, share)) < wanted:
            hold = _solve(lambda h: what(profile(acceleration, h, share)), wanted)
            return profile(acceleration, hold, share)
        a = _solve(lambda a: what(profile(a, 0.0, share)), wanted)
        return profile(a, 0.0, share)

    free = reaching(distance, _distance, 0.0)
    if _largest_speed(free) <= speed:
        return free
    settled = reaching(speed, _largest_speed, 1.0)  # with this it may cruise
    room = distance - _distance(settled)
    if room >= 0:
        return replace(settled, cruise=room / speed)
    share = _solve(
        lambda share: _distance(reaching(speed, _largest_speed, share)), distance, most=1.0
    )
    return reaching(speed, _largest_speed, share)


def _distance(profile: Profile) -> float:
    return float(travelled(profile.phases(), profile.order))


def _largest_speed(profile: Profile) -> float:
    return float(travelled(profile.half, profile.order - 1))


def _solve(rising: Callable[[float], float], wanted: float, most: float = math.inf) -> float:
    """Where a function that rises from below `wanted` at zero reaches it."""
    from scipy.optimize import brentq

    high = min(1.0, most)
    while rising(high) < wanted and high < most:
        high *= 2.0
    low = 0.0 if most < math.inf else high / 2
    while low and rising(low) > wanted:
        low, high = low / 2, low
    if rising(high) <= wanted:
        return high
    if rising(low) >= wanted:
        return low
    root: float = brentq(
        lambda x: rising(x) - wanted, low, high, xtol=ROOT_RESOLUTION * high, rtol=1e-15
    )
    return root

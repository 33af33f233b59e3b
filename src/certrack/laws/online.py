"""Gains that move while the controller runs, between two ends that are known beforehand.

``[law]`` is one end, ``[law.online]`` the other. With a level w in [0, 1] every number p of the law
that differs between them is p(w) = (1 - w) p_0 + w p_1. That moves

    robust, linear   nu_x and nu_Y: u is a mean of the inputs at both ends. In the coordinates of
                     the plant K and r move on a segment, whatever c made them
    adaptive         c_n and the numbers of the update laws, and nothing else

What is certified is the set of all w(t) (:mod:`certrack.certificates.online`), so any rule may move
it. Two look for the best level by trying (:mod:`certrack.laws.seeking`). Of two others, one has a
*threshold* b, and w itself is an own state:

    w' = rise (1 - m)(1 - w) - fall m w,   m = 1/(1 + (e_1/b)^4)

which the size of the error drives up, fast, and its absence down, slowly; w stays in [0, 1], and
|w'| is at most the larger of both rates. With a *schedule* w is a formula of t and the states, held
within [0, 1]; where a `rate` is stated, w' = rate (schedule - w).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi
from typing import TYPE_CHECKING, Any, TypeVar

import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, parse, symbol
from certrack.core.keys import check_fields, keyed
from certrack.laws.seeking import NUMBERS, SEEKING, check_seeking, sought_level

if TYPE_CHECKING:
    from certrack.laws.base import Law
    from certrack.laws.equations import Equations
    from certrack.laws.signals import Signals
    from certrack.model.plant import Plant

OfEnd = TypeVar("OfEnd")

#: The level w, where it is a state of the law.
LEVEL = symbol("online_level")

#: Begin of the names of the numbers at the other end, and of the rule's.
OTHER, RULE = "other_", "online_"

#: Keys of the other end, and the numbers of the law that move with each.
ENDS = {
    "c": ("nu_x", "nu_Y"),
    "c_n": ("nu_x", "nu_Y"),
    "K": ("nu_x", "nu_Y"),
    "r": ("nu_x", "nu_Y"),
    "gain_rate": ("gain_rate",),
    "leak_gain": ("leak_gain",),
    "leak_theta": ("leak_theta",),
    "Gamma": ("Gamma",),
}

#: Functions that are within [-1, 1].
_BOUNDED = (sympy.sin, sympy.cos, sympy.tanh)


@dataclass(frozen=True, kw_only=True)
class Online:
    """The other end of a law's gains, and the rule by which they move.

    Parameters
    ----------
    c, c_n, K, r, gain_rate, leak_gain, leak_theta, Gamma
        Those of the other end; the keys that a law admits are its :attr:`~.base.Law.moving`.
    rate : float > 0, optional, 1/s
        The largest |w'| that the admitted set has; any if left out.
    threshold : float > 0, optional
        b of the rule; unit of the output.
    rise, fall : float > 0, optional, 1/s
        How fast w goes up and down at most; with a threshold.
    schedule : text, optional
        In the place of a threshold: w as a formula of t and the states.
    seek, amplitude, frequency, speed, effort, seed
        In the place of both: see :mod:`certrack.laws.seeking`.

    Raises
    ------
    InputError
        If there is no other end, or not one rule.
    """

    c: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="decay rates at the other end (robust)",
        shape="c_1 ... c_n",
        unit="1/s",
        above=0,
        otherwise="they stay",
    )
    c_n: float | None = keyed(
        "number",
        None,
        help="the last decay rate at the other end (adaptive)",
        unit="1/s",
        above=0,
        otherwise="it stays",
    )
    K: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="feedback at the other end (linear)",
        shape="K_1 ... K_n",
        otherwise="it stays",
    )
    r: float | None = keyed(
        "number",
        None,
        help="feed-forward gain at the other end (linear)",
        otherwise="no static error by y_d^(q+1)",
    )
    gain_rate: float | None = keyed(
        "number",
        None,
        help="adaptation gain of delta_hat at the other end (adaptive; needs a rate)",
        above=0,
        otherwise="it stays",
    )
    leak_gain: float | None = keyed(
        "number",
        None,
        help="leakage of delta_hat at the other end (adaptive)",
        above=0,
        otherwise="it stays",
    )
    leak_theta: float | None = keyed(
        "number",
        None,
        help="leakage of theta_hat at the other end (adaptive)",
        above=0,
        otherwise="it stays",
    )
    Gamma: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="adaptation gain of theta_hat at the other end (adaptive; needs a rate)",
        shape="a diagonal, one number per regressor",
        above=0,
        otherwise="it stays",
    )
    rate: float | None = keyed(
        "number",
        None,
        help="how fast the gains may move at most, as a part of the way",
        unit="1/s",
        above=0,
        otherwise="at any speed",
    )
    threshold: float | None = keyed(
        "number",
        None,
        help="size of the error that moves the gains to the other end",
        above=0,
        otherwise="a schedule",
    )
    rise: float | None = keyed(
        "number",
        None,
        help="how fast a large error moves them there, as a part of what is left",
        unit="1/s",
        above=0,
        otherwise="with a threshold it must be stated",
    )
    fall: float | None = keyed(
        "number",
        None,
        help="how fast a small error moves them back, as a part of what is left",
        unit="1/s",
        above=0,
        otherwise="with a threshold it must be stated",
    )
    schedule: str | None = keyed(
        "text",
        None,
        help="0 (the gains of [law]) to 1 (the other end) as a formula of t and the states",
        otherwise="a threshold",
    )
    seek: str | None = keyed(
        "choice",
        None,
        help="a rule that tries which gains are best",
        choices=SEEKING,
        otherwise="a threshold or a schedule",
    )
    amplitude: float | None = keyed(
        "number", None, help="of what it tries (seek)", above=0, otherwise="must be stated"
    )
    frequency: float | None = keyed(
        "number", None, help="at which it tries", unit="Hz", above=0, otherwise="must be stated"
    )
    speed: float | None = keyed(
        "number", None, help="at which it goes on", unit="1/s", above=0, otherwise="must be stated"
    )
    effort: float | None = keyed(
        "number", None, help="weight of the input's motion beside e_1^2", above=0, otherwise="none"
    )
    seed: int | None = keyed(
        "integer", None, help="of what spsa tries", least=0, most=2**31 - 1, otherwise="0"
    )

    def __post_init__(self) -> None:
        check_fields(self, "law.online")
        if not self.changes:
            remedy = f"State what moves: {', '.join(ENDS)}"
            raise InputError("law.online", "has no other end of the gains", remedy=remedy)
        check_seeking(self)
        rules = [v is not None for v in (self.threshold, self.schedule, self.seek)]
        if self.seek is not None and sum(rules) > 1:
            message = "must be left out beside a threshold or a schedule"
            raise InputError("law.online.seek", message, remedy="State one rule")
        if sum(rules) != 1:
            said = "is missing" if self.threshold is None else "must be left out beside schedule"
            raise InputError("law.online.threshold", said, remedy="State it, seek, or a schedule")
        for name in ("rise", "fall"):
            value = getattr(self, name)
            if (value is None) != (self.threshold is None):
                said = "is missing" if value is None else "belongs to a threshold"
                raise InputError(f"law.online.{name}", said, remedy="State both with a threshold")
            if value is not None and self.rate is not None and value > self.rate:
                remedy = "State a larger rate, or a slower rule"
                raise InputError(f"law.online.{name}", "must be at most the rate", value, remedy)
        if self.rate is None and (self.gain_rate is not None or self.Gamma is not None):
            what = "is missing: V falls with growing adaptation gains, and pays for falling ones"
            remedy = "State how fast the gains may move, 1/s"
            raise InputError("law.online.rate", what, remedy=remedy)

    @property
    def changes(self) -> dict[str, Any]:
        """What is stated of the other end, by key."""
        values = {name: getattr(self, name) for name in ENDS}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers of the rule, by name."""
        names = ("threshold", "rise", "fall") if self.threshold is not None else ("rate", *NUMBERS)
        values = {name: getattr(self, name) for name in names}
        return {f"{RULE}{name}": value for name, value in values.items() if value is not None}

    @property
    def has_state(self) -> bool:
        """Whether the level is a state of the law."""
        return self.threshold is not None or self.rate is not None

    def formula(self, plant: Plant) -> sympy.Expr:
        """The schedule as it is written."""
        assert self.schedule is not None
        names = [str(TIME), *plant.states, *plant.constant_values]
        return parse("law.online.schedule", self.schedule, names).expr

    def wanted(self, s: Signals) -> sympy.Expr:
        """What the schedule wants the level to be, within [0, 1]."""
        if self.seek is not None:
            return within_unit(sought_level(self, s, RULE)[0])
        return within_unit(self.formula(s.plant))

    def check_period(self, period: float) -> None:
        """Refuse a period at which Euler's step takes the level out of [0, 1].

        Raises
        ------
        InputError
        """
        rates = (self.rise, self.fall) if self.threshold is not None else (self.rate,)
        if self.seek is not None:  # its own states must follow their rates, too
            assert self.frequency is not None and self.speed is not None
            rates = (*rates, 20 * pi * self.frequency, 4 * self.speed)
        fastest = max(value or 0.0 for value in rates)
        if fastest * period > 1:
            raise InputError(
                "implementation.period",
                f"must be at most {1 / fastest:.4g} s: a step of law.online would pass its ends",
                period,
                "Set a shorter period, or slower gains (rise, fall, rate)",
            )


def check_online(law: Law) -> None:
    """Refuse another end of gains that the law has not, or that may not move.

    Raises
    ------
    InputError
    """
    online = law.online
    if online is None:
        return
    if not isinstance(online, Online):
        raise InputError("law.online", "must be an Online", online)
    for name in online.changes:
        if name not in law.moving:
            what = f"may not move in the {law.kind} law"
            remedy = f"These may: {', '.join(law.moving) or 'none'}"
            raise InputError(f"law.online.{name}", what, remedy=remedy)
    for name in ("integral", "sampled_feedforward"):
        if getattr(law, name):
            raise InputError(f"law.{name}", "must be left out beside law.online")
    if online.Gamma is not None and not _is_diagonal(getattr(law, "Gamma", None)):
        raise InputError("law.Gamma", "must be a diagonal where law.online.Gamma moves it")
    at_other_end(law, lambda end: end)


def _is_diagonal(metric: Any) -> bool:
    return metric is None or not any(hasattr(row, "__len__") for row in metric)


def first_end(law: Law) -> Law:
    """The law with the gains of ``[law]``, which then stand still."""
    return law if law.online is None else replace(law, online=None)


def other_end(law: Law) -> Law:
    """The law with the gains of ``[law.online]``, which then stand still."""
    assert law.online is not None
    changes = law.online.changes
    if "c" in changes and len(changes["c"]) != len(law.c):
        checks.sequence("law.c", changes["c"], len(law.c), "as many numbers as law.c")
    if "c_n" in changes:
        changes["c"] = (*law.c[:-1], changes.pop("c_n"))
    if "K" in changes:  # with a feed-forward gain of its own
        changes = {"lqr": None, "r": None} | changes
    return replace(law, online=None, **changes)


def at_other_end(law: Law, compute: Callable[[Any], OfEnd]) -> OfEnd:
    """What is computed of :func:`other_end`; messages name the keys of its table."""
    try:
        return compute(other_end(law))
    except InputError as problem:
        if problem.key.startswith("law."):
            problem.key = f"law.online.{problem.key.removeprefix('law.')}"
        raise


def moving_equations(law: Law, equations: Equations, s: Signals) -> Equations:
    """The equations of a law whose gains move, from those of either end.

    Parameters
    ----------
    law : Law
    equations : Equations
        Of gains that stand still, in the symbols of `s`.
    s : Signals
    """
    online = law.online
    assert online is not None
    level, update = _rule(online, s)
    groups = dict.fromkeys(name for key in online.changes for name in ENDS[key])
    known = s.all_parameters
    moved: dict[sympy.Expr, sympy.Expr] = {}
    for name in groups:
        if name in known:
            others = s.parameters(f"{OTHER}{name}", len(known[name]))
            pairs = zip(known[name], others, strict=True)
            moved |= {here: here + level * (there - here) for here, there in pairs}
    return replace(
        equations,
        u=sympy.sympify(equations.u).xreplace(moved),
        update=(
            *((z, sympy.sympify(rate).xreplace(moved)) for z, rate in equations.update),
            *update,
        ),
        filters=(*equations.filters, *(z for z, _ in update)),
    )


def _rule(
    online: Online, s: Signals
) -> tuple[sympy.Expr, tuple[tuple[sympy.Symbol, sympy.Expr], ...]]:
    """The level, and its rate where it is a state."""
    if online.threshold is None:
        wanted = online.wanted(s)
        sought: tuple[tuple[sympy.Symbol, sympy.Expr], ...] = ()
        if online.seek is not None:
            sought = sought_level(online, s, RULE)[1]
        if online.rate is None:
            return wanted, sought
        return LEVEL, (*sought, (LEVEL, s.parameter(f"{RULE}rate") * (wanted - LEVEL)))
    b, rise, fall = (s.parameter(f"{RULE}{name}") for name in ("threshold", "rise", "fall"))
    calm = 1 / (1 + ((s.x[0] - s.Y[0]) / b) ** 4)  # 0 where the power overflows
    return LEVEL, ((LEVEL, rise * (1 - calm) * (1 - LEVEL) - fall * calm * LEVEL),)


def within_unit(formula: sympy.Expr) -> sympy.Expr:
    """The formula held within [0, 1]; itself where it is a sum that cannot leave it."""
    constant, remainder = sympy.expand(formula).as_coeff_Add()
    swing = sympy.S.Zero
    for term in sympy.Add.make_args(remainder) if remainder != 0 else ():
        factor, function = term.as_coeff_Mul()
        if not isinstance(function, _BOUNDED):
            return sympy.Max(0, sympy.Min(1, formula))
        swing += abs(factor)
    if constant - swing >= 0 and constant + swing <= 1:
        return formula
    return sympy.Max(0, sympy.Min(1, formula))


def online_numbers(law: Law, plant: Plant) -> dict[str, Any]:
    """Numbers of the other end and of the rule, by the names that :func:`moving_equations` asks."""
    assert law.online is not None
    other = at_other_end(law, lambda end: end.numbers(plant))
    return {f"{OTHER}{name}": value for name, value in other.items()} | law.online.numbers

"""Rules that look for the best level of moving gains by trying: own states and a wanted level.

What is to become small is J = e_1^2 + effort (u - u_m)^2, the error and what moves the input beside
its mean u_m. A dither d(t) in [-1, 1] moves the level about its middle m, and the middle goes where
J was smaller:

    w  = m + amplitude d,                       m = (1 + tanh z)/2, held within [0, 1]
    z' = -speed (3 d (J - J_m)/(J + J_m) + (z/3)^5)
    J_m' = 2 pi frequency/10 (J - J_m),         u_m' = 20 pi frequency (u - u_m)

*Extremum seeking* has a sine as its dither. *SPSA* perturbs at random: here d is a smooth wave
between -1 and 1 whose changes a seed decides, the same in every run. The level is within its ends
whatever the states are, so a certificate of all motions covers both.
"""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, symbol

if TYPE_CHECKING:
    from certrack.laws.online import Online
    from certrack.laws.signals import Signals

#: The rules, by the words of a system file.
SEEKING = ("extremum", "spsa")

#: What a rule needs, and what it may have beside it.
NUMBERS = ("amplitude", "frequency", "speed", "effort")

#: z, the mean of J and the mean of u.
MIDDLE, MEAN_COST, MEAN_INPUT = (symbol(f"online_{n}") for n in ("middle", "mean_cost", "mean_u"))

#: How much slower the mean of J is than the dither, and that of u faster; how far z goes.
COST_SLOWNESS, MIDDLE_REACH = 10, 3

#: Keeps the quotient of no cost at all defined, in single precision as well.
NO_COST = sympy.Float("1e-30")

#: Frequencies of the random dither in parts of the stated one: no two have a common period.
DITHER_PARTS = (1, sympy.Float("0.7548776662466927"), sympy.Float("0.5698402909980532"))


def check_seeking(online: Online) -> None:
    """Refuse a rule that lacks a number, and numbers without a rule.

    Raises
    ------
    InputError
    """
    for name in (*NUMBERS, "seed"):
        stated = getattr(online, name) is not None
        needed = online.seek is not None and name in ("amplitude", "frequency", "speed")
        if stated and (online.seek is None or (name == "seed" and online.seek != "spsa")):
            owner = "spsa" if name == "seed" else "seek"
            raise InputError(f"law.online.{name}", f"belongs to {owner}", remedy="Leave it out")
        if needed and not stated:
            raise InputError(f"law.online.{name}", "is missing", remedy="State it beside seek")


def dither(online: Online, frequency: sympy.Expr) -> sympy.Expr:
    """d(t), within [-1, 1].

    Parameters
    ----------
    online : Online
        With `seek`.
    frequency : formula
        Hz.
    """
    angle = 2 * sympy.pi * frequency * TIME
    if online.seek == "extremum":
        return sympy.sin(angle)
    draw = random.Random(online.seed or 0)
    waves = [sympy.sin(part * angle + sympy.Float(draw.uniform(0, 6.28))) for part in DITHER_PARTS]
    return sympy.tanh(2 * sympy.Add(*waves))


def sought_level(
    online: Online, s: Signals, rule: str
) -> tuple[sympy.Expr, tuple[tuple[sympy.Symbol, sympy.Expr], ...]]:
    """The level as it may leave [0, 1], and the rates of the rule's states.

    Parameters
    ----------
    online : Online
        With `seek`.
    s : Signals
    rule : str
        Begin of the names of the rule's numbers.
    """
    amplitude, frequency, speed = (s.parameter(f"{rule}{name}") for name in NUMBERS[:3])
    d, turn = dither(online, frequency), 2 * sympy.pi * frequency
    J = (s.x[0] - s.Y[0]) ** 2
    update: tuple[tuple[sympy.Symbol, sympy.Expr], ...] = ()
    if online.effort is not None:
        J += s.parameter(f"{rule}effort") * (s.applied - MEAN_INPUT) ** 2
        update = ((MEAN_INPUT, COST_SLOWNESS * turn * (s.applied - MEAN_INPUT)),)
    share = (J - MEAN_COST) / (J + MEAN_COST + NO_COST)
    update = (
        (MIDDLE, -speed * (MIDDLE_REACH * d * share + (MIDDLE / MIDDLE_REACH) ** 5)),
        (MEAN_COST, turn / COST_SLOWNESS * (J - MEAN_COST)),
        *update,
    )
    return (1 + sympy.tanh(MIDDLE)) / 2 + amplitude * d, update

"""Two motors that share the torque of one input, and what feeds them.

The command u of the design is shared between the drives, which may damp the difference of their
shafts by themselves:

    u_1 = s u - k_d (omega_1 - omega_2),      u_2 = (1 - s) u + k_d (omega_1 - omega_2)
    T_i = b_i u_i,                            P_i = T_i omega_i + R_i (T_i/k_i)^2

With the same b_i the damping leaves the sum of the torques as it is. For a total torque T the
copper loss a_1 T_1^2 + a_2 T_2^2, a_i = R_i/k_i^2, is least for T_1/T = a_2/(a_1 + a_2), and is
then ((a_1 - a_2)/(a_1 + a_2))^2 below that of equal torques.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, parse, symbol
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.model.names import new_name

#: What takes the energy that the motors give back.
SUPPLY_KINDS = ("chopper", "battery")

#: Fields of :class:`Motors` that are a number for each motor, and a number for both.
EACH, BOTH = ("resistance", "torque_per_input", "torque_constant"), ("share", "damping")


@dataclass(frozen=True)
class Motors:
    """Two motors behind one input, in a truth with states of its own.

    Numbers may be formulas of the constants of plant and truth, which an ensemble may vary.

    Parameters
    ----------
    torques : 2 names
        What the motors' torques [N m] are called in the truth's rates, which then contain no u.
    speeds : 2 formulas in the truth's states and the constants
        Speeds of their shafts, rad/s.
    torque_per_input : 2 nonzero numbers
        b_i: torque for one unit of the motor's own command, N m.
    resistance : 2 positive numbers
        R_i of the windings, ohm.
    stored : formula in the truth's states and the constants
        Energy in the mechanism, kinetic and elastic, J.
    torque_constant : 2 nonzero numbers, optional
        k_i: torque for one ampere, N m/A. That of the command if left out: then u_i is the current.
    share : number, 0 to 1
        s: part of the input that is the command of motor 1.
    damping : number >= 0
        k_d: command that is moved from motor 1 to motor 2 where motor 1 runs ahead by 1 rad/s, in
        the unit of the input times s/rad.
    friction : formula in the truth's states and the constants
        Mechanical power that is lost, W; part of what the rates say.

    Raises
    ------
    InputError
        If a number or a count does not fit. Names are checked when the truth meets its plant.
    """

    torques: tuple[str, str] = keyed(
        "names",
        help="names that truth.rates use for the torques of motor 1 and 2",
        shape="motor 1, motor 2",
        unit="N m",
    )
    speeds: tuple[Expression, Expression] = keyed(
        "formulas",
        help="speeds of their shafts, formulas of the truth's states",
        shape="motor 1, motor 2",
        unit="rad/s",
    )
    torque_per_input: tuple[Expression, Expression] = keyed(
        "formulas",
        help="torque for one unit of the motor's command; may contain constants",
        shape="motor 1, motor 2",
        unit="N m",
    )
    resistance: tuple[Expression, Expression] = keyed(
        "formulas",
        help="resistance of the winding; may contain constants",
        shape="motor 1, motor 2",
        unit="ohm",
    )
    stored: Expression = keyed(
        "formula",
        help="kinetic and elastic energy in the mechanism, a formula of the truth's states",
        unit="J",
    )
    torque_constant: tuple[Expression, Expression] | None = keyed(
        "formulas",
        None,
        help="torque for one ampere; may contain constants",
        shape="motor 1, motor 2",
        unit="N m/A",
        otherwise="torque_per_input",
    )
    share: Expression = keyed(
        "formula", "1/2", help="part of the input that goes to motor 1, 0 to 1; may be a constant"
    )
    damping: Expression = keyed(
        "formula",
        0,
        help="command moved from motor 1 to 2 for each rad/s by which 1 runs ahead",
        unit="s/rad",
    )
    friction: Expression = keyed(
        "formula", 0, help="mechanical power lost, a formula of the truth's states", unit="W"
    )

    def __post_init__(self) -> None:
        keys = keys_of(self)
        check_fields(self, "truth.motors", "torques")
        checks.sequence("truth.motors.torques", self.torques, 2, keys["torques"].shape)
        for name in ("speeds", *EACH):
            if getattr(self, name) is not None:
                key = f"truth.motors.{name}"
                entries = checks.sequence(key, getattr(self, name), 2, keys[name].shape)
                texts = (parse(f"{key}[{i}]", entry, None) for i, entry in enumerate(entries))
                set_fields(self, **{name: tuple(texts)})
        for name in ("stored", "friction", *BOTH):
            text = parse(f"truth.motors.{name}", getattr(self, name), None)
            set_fields(self, **{name: text})

    @property
    def currents_per_torque(self) -> tuple[sympy.Expr, sympy.Expr]:
        """1/k_i, formulas of the constants, A/(N m)."""
        first, second = self.torque_constant or self.torque_per_input
        return 1 / first.expr, 1 / second.expr

    def torque_formulas(self, u: sympy.Expr) -> dict[sympy.Symbol, sympy.Expr]:
        """What the torques of this name are: formulas of u, the truth's states and constants."""
        moved = self.damping.expr * (self.speeds[0].expr - self.speeds[1].expr)
        commands = (self.share.expr * u - moved, (1 - self.share.expr) * u + moved)
        return {
            symbol(name): gain.expr * command
            for name, gain, command in zip(
                self.torques, self.torque_per_input, commands, strict=True
            )
        }

    def bound_to(
        self, states: Sequence[str], constants: Mapping[str, Any], rates: Sequence[Expression]
    ) -> Motors:
        """These motors checked against a truth: its states, true constants and rates."""
        for i, name in enumerate(self.torques):
            key = f"truth.motors.torques[{i}]"
            new_name(key, name, [*states, *constants, *self.torques[:i]])
            if not any(symbol(name) in rate.expr.free_symbols for rate in rates):
                raise InputError(key, "must occur in truth.rates", name)
        if any(symbol("u") in rate.expr.free_symbols for rate in rates):
            message = "must not contain u: it reaches the plant by the torques of truth.motors"
            raise InputError("truth.rates", message)
        names = [*states, *constants]
        for key, text in self._formulas(("speeds", "stored", "friction")):
            parse(key, text, names)
        for key, text in self._formulas((*EACH, *BOTH)):
            _check_number(key, checks.real(key, parse(key, text, constants), constants))
        gains = self.numbers(constants).torque_per_input
        if gains[0] * gains[1] < 0:
            message = "must have the same sign: both motors drive the same way"
            raise InputError("truth.motors.torque_per_input", message, list(gains))
        return self

    def numbers(self, constants: Mapping[str, Any]) -> MotorNumbers:
        """The numbers of these motors for such values of the constants."""

        def value(formula: Expression) -> float:
            return float(checks.real("truth.motors", formula, constants))

        def pair(formulas: tuple[Expression, Expression]) -> tuple[float, float]:
            return value(formulas[0]), value(formulas[1])

        return MotorNumbers(
            resistance=pair(self.resistance),
            torque_per_input=pair(self.torque_per_input),
            torque_constant=pair(self.torque_constant or self.torque_per_input),
            share=value(self.share),
            damping=value(self.damping),
        )

    def _formulas(self, names: Sequence[str]) -> list[tuple[str, Expression]]:
        """Key and formula of every entry of these fields."""
        results = []
        for name in names:
            value = getattr(self, name)
            if isinstance(value, tuple):
                results += [(f"truth.motors.{name}[{i}]", entry) for i, entry in enumerate(value)]
            elif value is not None:
                results.append((f"truth.motors.{name}", value))
        return results


def _check_number(key: str, value: float) -> None:
    """The limits of a number of the motors."""
    name = key.split(".")[2].partition("[")[0]
    if name == "resistance" and value <= 0:
        raise InputError(key, "must be positive", value)
    if name in ("torque_per_input", "torque_constant") and value == 0:
        raise InputError(key, "must not be zero", value)
    if name == "share" and not 0 <= value <= 1:
        raise InputError(key, "must be 0 to 1", value)
    if name == "damping" and value < 0:
        raise InputError(key, "must not be negative", value)


@dataclass(frozen=True)
class MotorNumbers:
    """Numbers of two motors.

    Attributes
    ----------
    resistance : 2 numbers, ohm
    torque_per_input : 2 numbers, N m
    torque_constant : 2 numbers, N m/A
    share, damping : float
    """

    resistance: tuple[float, float]
    torque_per_input: tuple[float, float]
    torque_constant: tuple[float, float]
    share: float = 0.5
    damping: float = 0.0

    @property
    def losses_per_torque(self) -> tuple[float, float]:
        """a_i = R_i/k_i^2: copper loss of a motor for 1 N m, W/(N m)^2."""
        pairs = zip(self.resistance, self.torque_constant, strict=True)
        first, second = (R / k**2 for R, k in pairs)
        return first, second

    @property
    def best_share(self) -> float:
        """Share of the input with the least copper loss for a given total torque.

        T_1/T_2 = a_2/a_1, and T_i = b_i u_i: s = (a_2/b_1)/(a_2/b_1 + a_1/b_2).
        """
        (a_1, a_2), (b_1, b_2) = self.losses_per_torque, self.torque_per_input
        first, second = a_2 / b_1, a_1 / b_2
        return first / (first + second)

    def loss(self, share: float) -> float:
        """Copper loss for a total torque of 1 N m shared so, W; no damping acts."""
        (a_1, a_2), (b_1, b_2) = self.losses_per_torque, self.torque_per_input
        one, two = share * b_1, (1 - share) * b_2
        return (a_1 * one**2 + a_2 * two**2) / (one + two) ** 2

    @property
    def best_saving(self) -> float:
        """Part of the copper loss that the best share saves against equal commands.

        For equal b_i it is ((a_1 - a_2)/(a_1 + a_2))^2.
        """
        return 1 - self.loss(self.best_share) / self.loss(0.5)


@dataclass(frozen=True)
class Supply:
    """What feeds the link that both motors hang on, and what takes the energy they give back.

    The link asks for the power P = P_1 + P_2. A source of voltage V behind a resistance R gives
    p = P for P >= 0 at its terminals with the current i = 2 p/(V + sqrt(V^2 - 4 R p)), and so V i
    inside. For P < 0 a chopper burns everything; a battery takes eta min(-P, power_limit) at its
    terminals, and the chopper burns what is above the limit.

    Parameters
    ----------
    kind : {"chopper", "battery"}
    voltage : float > 0, V, optional
        V, required with a resistance.
    resistance : float >= 0, ohm
        R.
    efficiency : float, 0 to 1
        eta.
    power_limit : float >= 0, W
        Of what is given back; inf for none.

    Raises
    ------
    InputError
        If a number is out of its limits, or a chopper has what only a battery has.
    """

    kind: str = keyed("choice", help="what takes the energy given back", choices=SUPPLY_KINDS)
    voltage: float | None = keyed(
        "number", None, help="of the source without load", unit="V", above=0, otherwise="any"
    )
    resistance: float = keyed(
        "number", 0.0, help="inside the source; needs the voltage", unit="ohm", least=0
    )
    efficiency: float = keyed(
        "number", 1.0, help="battery: part of what is given back that it gets", least=0, most=1
    )
    power_limit: float = keyed(
        "number",
        math.inf,
        help="battery: most power that is given back; the chopper burns the rest",
        unit="W",
        least=0,
        infinite=True,
    )

    def __post_init__(self) -> None:
        check_fields(self, "truth.supply")
        if self.resistance and self.voltage is None:
            remedy = "State the voltage of the source, V"
            raise InputError("truth.supply.voltage", "is missing", remedy=remedy)
        for name, default in (("efficiency", 1.0), ("power_limit", math.inf)):
            if self.kind == "chopper" and getattr(self, name) != default:
                message, remedy = "is of a battery", 'Leave it out, or set kind = "battery"'
                raise InputError(f"truth.supply.{name}", message, remedy=remedy)

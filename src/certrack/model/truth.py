"""What the simulated plant really is, unknown to the controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, number, parse, symbol
from certrack.model.plant import (
    MAX_ORDER,
    Plant,
    check_gain,
    check_within,
    name_value_pairs,
    own_name,
)


@dataclass(frozen=True)
class Truth:
    """What the simulated plant really is, unknown to the controller.

    It has the form of the design's plant, or states, rates and outputs of its own instead of
    input_gain, theta, omega and tau.

    Parameters
    ----------
    input_gain : nonzero number
        True g_n.
    theta : r numbers
        True theta.
    omega : n formulas in t and the states
        The uncertain terms w_1 ... w_n.
    tau : n numbers >= 0, optional
        True strengths; those of the plant's uncertainty if left out.
    constants : mapping, optional
        True values of plant constants that differ from the designer's; with states of its own,
        also constants of its own.
    states : names, optional
        States of its own, different from the plant's.
    rates : formulas in t, these states, the input u and the constants
        One per state.
    outputs : n formulas in these states and the constants
        What the controller measures: x_1 ... x_n of the design.
    """

    input_gain: Expression | None = None
    theta: tuple[Expression, ...] = ()
    omega: tuple[Expression, ...] | None = None
    tau: tuple[float, ...] | None = None
    constants: tuple[tuple[str, Expression], ...] = ()
    states: tuple[str, ...] | None = None
    rates: tuple[Expression, ...] | None = None
    outputs: tuple[Expression, ...] | None = None

    def bound_to(self, plant: Plant) -> Truth:
        """This truth checked against `plant`, with its defaults filled in."""
        if self.states is not None:
            return self._with_own_states(plant)
        for name in ("rates", "outputs"):
            if getattr(self, name) is not None:
                raise InputError(f"truth.{name}", "needs truth.states", remedy="Name the states")
        if self.input_gain is None:
            raise InputError("truth.input_gain", "is missing")
        pairs = dict(name_value_pairs("truth.constants", self.constants))
        for name in pairs:
            if name not in plant.constant_values:
                raise InputError(f"truth.constants.{name}", "is not a constant of the plant")
        others = tuple((name, number(f"truth.constants.{name}", v)) for name, v in pairs.items())
        known = plant.with_constants(**dict(others)).constant_values  # type: ignore[arg-type]
        gain = check_gain("truth.input_gain", self.input_gain, plant.gain_sign, known)
        check_within("truth.input_gain", gain, plant.input_gain_range, "input_gain")
        theta = checks.sequence("truth.theta", self.theta, plant.r, "one number per regressor")
        for i, box in enumerate(plant.theta_range or ()):
            value = checks.real(f"truth.theta[{i}]", theta[i], known)
            check_within(f"truth.theta[{i}]", value, box, "theta")
        given_omega = (0,) * plant.n if self.omega is None else self.omega
        omega = checks.sequence("truth.omega", given_omega, plant.n, "w_1 ... w_n, one per state")
        names = ["t", *plant.states, *known]
        tau = plant.uncertainty.tau if self.tau is None else self.tau
        return Truth(
            input_gain=number("truth.input_gain", self.input_gain, known),
            theta=tuple(number(f"truth.theta[{i}]", v, known) for i, v in enumerate(theta)),
            omega=tuple(parse(f"truth.omega[{i}]", v, names) for i, v in enumerate(omega)),
            tau=checks.reals("truth.tau", tau, plant.n, "one number per state", known, least=0),
            constants=others,
        )

    def _with_own_states(self, plant: Plant) -> Truth:
        """The same for a truth with states of its own."""
        for name in ("input_gain", "theta", "omega", "tau"):
            given = getattr(self, name)
            if given is not None and not (isinstance(given, tuple) and not given):
                message = "must be left out where the truth has states of its own"
                raise InputError(f"truth.{name}", message, given, "Write it into truth.rates")
        states: list[str] = []
        entries = checks.sequence("truth.states", self.states, None, "names")
        if not 1 <= len(entries) <= MAX_ORDER:
            raise InputError("truth.states", f"must be 1 to {MAX_ORDER} names", entries)
        for i, name in enumerate(entries):
            key = f"truth.states[{i}]"
            if name in (*plant.states, *plant.constant_values):
                raise InputError(key, "is a name of the plant already", name, "Rename it")
            states.append(own_name(key, name, states))
        constants: dict[str, Expression] = {}
        for name, value in name_value_pairs("truth.constants", self.constants):
            key = f"truth.constants.{name}"
            if name not in plant.constant_values:
                own_name(key, name, [*plant.states, *states, *constants])
            constants[name] = number(key, value)
        known = [*states, *dict.fromkeys([*plant.constant_values, *constants])]
        rates = _formulas(
            "truth.rates", self.rates, len(states), "one per state", ["t", "u", *known]
        )
        if not any(symbol("u") in rate.expr.free_symbols for rate in rates):
            raise InputError("truth.rates", "must contain the input u")
        what = "one per state of the plant"
        return Truth(
            constants=tuple(constants.items()),
            states=tuple(states),
            rates=rates,
            outputs=_formulas("truth.outputs", self.outputs, plant.n, what, known),
        )


def _formulas(
    key: str, given: Any, count: int, what: str, names: Sequence[str]
) -> tuple[Expression, ...]:
    """So many formulas in the names."""
    if given is None:
        raise InputError(key, "is missing")
    entries = checks.sequence(key, given, count, what)
    return tuple(parse(f"{key}[{i}]", entry, names) for i, entry in enumerate(entries))

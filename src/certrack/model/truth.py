"""What the simulated plant really is, unknown to the controller."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, check_name, number, parse, symbol
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.core.once import once_for_newest, without_results
from certrack.model.coefficients import check_gain, check_within, refuse_varying_gain
from certrack.model.motors import Motors, Supply
from certrack.model.names import new_name
from certrack.model.plant import MAX_ORDER, Plant

#: What a truth with states of its own has no place for.
PLANT_FORM = ("input_gain", "theta", "omega", "tau")


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
    motors : Motors, optional
        Two motors that share the input, where the rates contain their torques instead of u.
    supply : Supply, optional
        What feeds the motors, and takes what they give back.

    Raises
    ------
    InputError
        If it has neither form, or something in it is not what it must be. What needs the plant
        (how many numbers, which names) is checked when a system is made of both.
    """

    input_gain: Expression | None = keyed(
        "number", None, help="true g_n", nonzero=True, otherwise="required without states"
    )
    theta: tuple[Expression, ...] = keyed(
        "numbers", (), help="true theta", shape="one number per regressor"
    )
    omega: tuple[Expression, ...] | None = keyed(
        "formulas",
        None,
        help="w_1 ... w_n, formulas of t and the states",
        shape="w_1 ... w_n, one per state",
        otherwise="zero",
    )
    tau: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="true strengths of the uncertain terms",
        shape="one number per state",
        least=0,
        otherwise="those of the uncertainty",
    )
    constants: tuple[tuple[str, Expression], ...] = keyed(
        "constants",
        (),
        help="true value of a constant of the plant; with own states also constants of its own",
        otherwise="those of the plant",
    )
    states: tuple[str, ...] | None = keyed(
        "names",
        None,
        help="names of own states, where the truth is not of the plant's form",
        shape="names",
        otherwise="those of the plant",
    )
    rates: tuple[Expression, ...] | None = keyed(
        "formulas",
        None,
        help="derivatives of the own states: formulas of t, these states, the input u, constants",
        shape="one per state",
        otherwise="required with states",
    )
    outputs: tuple[Expression, ...] | None = keyed(
        "formulas",
        None,
        help="x_1 ... x_n of the design, as formulas of the own states and the constants",
        shape="one per state of the plant",
        otherwise="required with states",
    )
    motors: Motors | None = None
    supply: Supply | None = None

    def __post_init__(self) -> None:
        if self.states is None:
            self._check_plant_form()
        else:
            self._check_own_states()
        if self.supply is not None and self.motors is None:
            remedy = "Describe the motors in a table [truth.motors]"
            raise InputError("truth.supply", "needs truth.motors", remedy=remedy)
        pairs = checks.name_value_pairs("truth.constants", self.constants)
        constants = {name: number(f"truth.constants.{name}", value) for name, value in pairs}
        set_fields(self, constants=tuple(constants.items()))

    def __getstate__(self) -> dict[str, object]:
        return without_results(vars(self))

    def _check_plant_form(self) -> None:
        for name in ("rates", "outputs", "motors"):
            if getattr(self, name) is not None:
                raise InputError(f"truth.{name}", "needs truth.states", remedy="Name the states")
        if self.input_gain is None:
            remedy = 'State the true g_n, e.g. "1/J", which follows truth.constants'
            raise InputError("truth.input_gain", "is missing", remedy=remedy)
        gain = _open_formula("truth.input_gain", self.input_gain)
        for name in map(str, gain.expr.free_symbols):
            check_name("truth.input_gain", name)  # a constant of the plant, not t, inf or nan
        if not gain.expr.free_symbols and float(gain.expr) == 0:
            raise InputError("truth.input_gain", "must not be zero", checks.as_written(gain))
        set_fields(self, input_gain=gain)
        self._read_formulas("theta", "omega")
        check_fields(self, "truth", "tau")

    def _check_own_states(self) -> None:
        for name in PLANT_FORM:
            value = getattr(self, name)
            if value is not None and not (isinstance(value, tuple) and not value):
                message = "must be left out where the truth has states of its own"
                value = checks.as_written(value)
                raise InputError(f"truth.{name}", message, value, "Write it into truth.rates")
        states: list[str] = []
        names = checks.sequence("truth.states", self.states, None, "names")
        if not 1 <= len(names) <= MAX_ORDER:
            raise InputError("truth.states", f"must be 1 to {MAX_ORDER} names", names)
        for i, name in enumerate(names):
            states.append(new_name(f"truth.states[{i}]", name, states))
        set_fields(self, states=tuple(states))
        for name in ("rates", "outputs"):
            if getattr(self, name) is None:
                raise InputError(f"truth.{name}", "is missing")
        self._read_formulas("rates", count=len(states))
        self._read_formulas("outputs")

    def _read_formulas(self, *names: str, count: int | None = None) -> None:
        """Parse the fields of this name; which names they may contain is known with the plant."""
        for name in names:
            value, key = getattr(self, name), f"truth.{name}"
            if value is not None:
                entries = checks.sequence(key, value, count, keys_of(self)[name].shape)
                formulas = (_open_formula(f"{key}[{i}]", entry) for i, entry in enumerate(entries))
                set_fields(self, **{name: tuple(formulas)})

    @once_for_newest
    def bound_to(self, plant: Plant) -> Truth:
        """This truth checked against `plant`, with its defaults filled in."""
        bound = self._bound_to(plant) if self.states is None else self._own_states_bound_to(plant)
        return self if bound == self else bound

    def _bound_to(self, plant: Plant) -> Truth:
        """The same for a truth of the plant's form."""
        assert self.input_gain is not None
        constants = constants_of_truth(plant, self.constants)
        refuse_varying_gain("truth.input_gain", self.input_gain, plant.states)
        gain = check_gain("truth.input_gain", self.input_gain, plant.gain_sign, constants)
        check_within("truth.input_gain", gain, plant.input_gain_range, "input_gain")
        theta = _named_formulas(
            "truth.theta", self.theta, plant.r, "one number per regressor", constants
        )
        for i, box in enumerate(plant.theta_range or ()):
            check_within(f"truth.theta[{i}]", float(theta[i].expr), box, "theta")
        omega = ("0",) * plant.n if self.omega is None else self.omega
        names = ["t", *plant.states, *constants]
        tau = plant.uncertainty.tau if self.tau is None else self.tau
        return replace(
            self,
            input_gain=number("truth.input_gain", self.input_gain, constants),
            theta=theta,
            omega=_named_formulas(
                "truth.omega", omega, plant.n, "w_1 ... w_n, one per state", names
            ),
            tau=tuple(checks.sequence("truth.tau", tau, plant.n, "one number per state")),
        )

    def _own_states_bound_to(self, plant: Plant) -> Truth:
        """The same for a truth with states of its own."""
        states, constants = self.states or (), dict(self.constants)
        for i, name in enumerate(states):
            if name in (*plant.states, *plant.constant_values):
                key = f"truth.states[{i}]"
                raise InputError(key, "is a name of the plant already", name, "Rename it")
        for i, name in enumerate(constants):
            if name not in plant.constant_values:
                used = [*plant.states, *states, *list(constants)[:i]]
                new_name(f"truth.constants.{name}", name, used)
        names = [*states, *dict.fromkeys([*plant.constant_values, *constants])]
        inputs = ["u"] if self.motors is None else ["u", *self.motors.torques]
        rates = _named_formulas(
            "truth.rates", self.rates or (), len(states), "one per state", ["t", *inputs, *names]
        )
        if self.motors is not None:
            built = {k: v for k, v in constants.items() if k in plant.constant_values}
            values = plant.with_constants(**built).constant_values
            stated = {name: value.expr for name, value in constants.items()}
            self.motors.bound_to(states, values | stated, rates)
        elif not any(symbol("u") in rate.expr.free_symbols for rate in rates):
            raise InputError("truth.rates", "must contain the input u")
        what = "one per state of the plant"
        outputs = _named_formulas("truth.outputs", self.outputs or (), plant.n, what, names)
        return replace(self, rates=rates, outputs=outputs)


def constants_of_truth(plant: Plant, constants: Any) -> dict[str, sympy.Expr]:
    """Exact values of the plant's constants, the true ones where they differ."""
    pairs = dict(checks.name_value_pairs("truth.constants", constants))
    for name in pairs:
        if name not in plant.constant_values:
            raise InputError(f"truth.constants.{name}", "is not a constant of the plant")
    values = {name: number(f"truth.constants.{name}", value) for name, value in pairs.items()}
    for name, value in values.items():
        box = plant.constant_boxes.get(name)
        check_within(f"truth.constants.{name}", float(value.expr), box, name)
    return plant.with_constants(**values).constant_values


def _open_formula(key: str, text: Any) -> Expression:
    """A formula whose names are checked when the plant is known."""
    return text if isinstance(text, Expression) else parse(key, text, None)


def _named_formulas(
    key: str,
    texts: Iterable[Any],
    count: int,
    what: str,
    names: Iterable[str] | Mapping[str, Any],
) -> tuple[Expression, ...]:
    """So many formulas in the names."""
    entries = checks.sequence(key, texts, count, what)
    return tuple(parse(f"{key}[{i}]", entry, names) for i, entry in enumerate(entries))

"""The plant as the designer knows it.

x_i' = g_i x_{i+1} + sum_{j<=i} b_ij x_j + tau_i w_i(t, x)               i = 1 ... n-1
x_n' = h(x) + g_n u + phi(x)^T theta + tau_n w_n(t, x)                             [5]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, check_name, number, parse, symbol
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.model.uncertainty import Uncertainty

MAX_ORDER = 50

#: Names and prefixes that a closed loop gives to its own signals.
LOOP_SIGNALS = ("u", "e", "nu", "time", "state", "parameter", "member")
LOOP_PREFIXES = (
    "e_",
    "lambda_",
    "y_d",
    "delta_",
    "theta_",
    "law_",
    "true_",
    "piece_",
    "switch_",
    "integral_",
    "kept_",
    "ref_",
    "ctl_",
)


#: Bounds for no state: the uncertainty of a plant that states none.
UNSTATED = Uncertainty((), (), ())


@dataclass(frozen=True)
class Plant:
    """What the designer knows of the plant [5].

    Every number may be given as a formula of `constants`.

    Parameters
    ----------
    states : n names
        x_1 ... x_n; the output is x_1.
    chain : n-1 nonzero numbers
        Virtual control coefficients g_1 ... g_{n-1}.
    linear : n-1 rows, optional
        Couplings b_ij: row i holds b_i1 ... b_ii. Zero if left out.
    drift : formula in the states
        h(x).
    regressor : r formulas in the states
        phi(x); empty when there is no unknown theta.
    gain_sign : +1 or -1
        Sign of the input gain g_n.
    input_gain : number, optional
        g_n, where it is known (robust law).
    theta : r numbers, optional
        theta, where it is known (robust law).
    uncertainty : Uncertainty, or a mapping {tau, gamma, beta}, optional
        Bounds on w; none if left out.
    constants : mapping of names to numbers, optional
        Names usable in every formula; later ones may use earlier ones.
    input_gain_range, theta_range : intervals, optional
        Ranges for certificates and ensembles.
    units : n + 1 texts, optional
        Units of the states and, last, of the input; for labels only.

    Raises
    ------
    InputError
        If a shape, a sign or a name does not fit.
    """

    states: tuple[str, ...] = keyed(
        "names",
        help="names of x_1 ... x_n, 1 to 50; the output is x_1",
        shape="names of x_1 ... x_n",
    )
    chain: tuple[Expression, ...] = keyed(
        "numbers",
        (),
        help="virtual control coefficients g_1 ... g_{n-1}; [] for n = 1",
        shape="g_1 ... g_{n-1}",
        nonzero=True,
    )
    linear: tuple[tuple[Expression, ...], ...] = keyed(
        "rows",
        None,
        help="couplings b_ij: row i (1 ... n-1) has i entries",
        shape="rows b_i1 ... b_ii, i = 1 ... n-1",
        otherwise="zero",
    )
    drift: Expression = keyed("formula", 0, help="h(x), a formula of the states")
    regressor: tuple[Expression, ...] = keyed(
        "formulas",
        (),
        help="phi(x); [] when there is no unknown theta",
        shape="phi_1(x) ... phi_r(x)",
    )
    gain_sign: int = keyed("choice", 1, help="sign of g_n", choices=(1, -1), required=True)
    input_gain: Expression | None = keyed(
        "number",
        None,
        help="g_n, only where it is known; the robust law needs it",
        nonzero=True,
        otherwise="unknown",
    )
    theta: tuple[Expression, ...] | None = keyed(
        "numbers",
        None,
        help="theta, only where it is known; the robust law needs it",
        shape="one number per regressor",
        otherwise="unknown",
    )
    uncertainty: Uncertainty = UNSTATED
    constants: tuple[tuple[str, Expression], ...] = keyed(
        "constants",
        (),
        help="names usable in every formula; later ones may use earlier ones",
        otherwise="none",
    )
    input_gain_range: tuple[float, float] | None = keyed(
        "interval",
        None,
        help="range of g_n, for certificates and ensembles",
        path="ranges.input_gain",
        otherwise="none",
    )
    theta_range: tuple[tuple[float, float], ...] | None = keyed(
        "intervals",
        None,
        help="range of each entry of theta, for certificates and ensembles",
        shape="one pair per regressor",
        path="ranges.theta",
        otherwise="none",
    )
    units: tuple[str, ...] | None = keyed(
        "texts",
        None,
        help="units of the states, then of the input; for labels only",
        shape="states, then input",
        otherwise="none",
    )

    def __post_init__(self) -> None:
        states = self._check_states()
        n = len(states)
        set_fields(self, states=states, constants=self._check_constants(states))
        values = self.constant_values
        keys = keys_of(self)
        coefficients = checks.sequence(
            "plant.chain",
            self.chain,
            n - 1,
            f"{keys['chain'].shape} (n = {n}, the number of states)",
        )
        for i, value in enumerate(coefficients):
            _refuse_states(f"plant.chain[{i}]", value, states, ROW_REMEDY)
            checks.real(f"plant.chain[{i}]", value, values, nonzero=True)
        names = [*states, *values]
        phi = checks.sequence("plant.regressor", self.regressor, None, keys["regressor"].shape)
        set_fields(
            self,
            chain=tuple(parse(f"plant.chain[{i}]", v, values) for i, v in enumerate(coefficients)),
            linear=self._check_linear(states, values),
            drift=parse("plant.drift", self.drift, names),
            regressor=tuple(parse(f"plant.regressor[{i}]", v, names) for i, v in enumerate(phi)),
            uncertainty=self._check_uncertainty(n),
        )
        self._check_parameters(values)
        if self.units is not None:
            set_fields(self, units=keys["units"].checked("plant.units", self.units, count=n + 1))

    def _check_uncertainty(self, n: int) -> Uncertainty:
        bounds: Any = self.uncertainty
        if bounds is None or (isinstance(bounds, Uncertainty) and bounds == UNSTATED):
            return Uncertainty.none(n)
        if isinstance(bounds, Mapping):
            return Uncertainty.from_table(bounds, n, self.constant_values)
        if not isinstance(bounds, Uncertainty):
            raise InputError("plant.uncertainty", "must be an Uncertainty", bounds)
        for name in ("tau", "gamma", "beta"):
            values = getattr(bounds, name)
            checks.sequence(f"plant.uncertainty.{name}", values, n, "one number per state")
        return bounds

    def _check_states(self) -> tuple[str, ...]:
        names = checks.sequence("plant.states", self.states, None, "names of x_1 ... x_n")
        if not 1 <= len(names) <= MAX_ORDER:
            raise InputError("plant.states", f"must be 1 to {MAX_ORDER} names", names)
        states: list[str] = []
        for i, name in enumerate(names):
            states.append(new_name(f"plant.states[{i}]", name, states))
        return tuple(states)

    def _check_constants(self, states: tuple[str, ...]) -> tuple[tuple[str, Expression], ...]:
        constants: dict[str, Expression] = {}
        for name, value in checks.name_value_pairs("plant.constants", self.constants):
            key = f"plant.constants.{name}"
            new_name(key, name, [*states, *constants])
            constants[name] = number(key, value, {k: v.expr for k, v in constants.items()})
        return tuple(constants.items())

    def _check_linear(
        self, states: tuple[str, ...], constants: Mapping[str, Any]
    ) -> tuple[tuple[Expression, ...], ...]:
        key, n = "plant.linear", len(states)
        couplings: Any = self.linear
        if couplings is None:
            couplings = [[0] * i for i in range(1, n)]
        rows = checks.sequence(
            key,
            couplings,
            n - 1,
            f"rows b_i1 ... b_ii, i = 1 ... n-1 (n = {n}, the number of states)",
        )
        lengths = [
            checks.sequence(f"{key}[{i}]", row, i + 1, "b_i1 ... b_ii")
            for i, row in enumerate(rows)
        ]
        for i, row in enumerate(lengths):
            for j, value in enumerate(row):
                _refuse_states(f"{key}[{i}][{j}]", value, states, ROW_REMEDY)
        return tuple(
            tuple(number(f"{key}[{i}][{j}]", v, constants) for j, v in enumerate(row))
            for i, row in enumerate(lengths)
        )

    def _check_parameters(self, constants: Mapping[str, Any]) -> None:
        check_fields(self, "plant", "gain_sign")
        if self.input_gain is not None:
            refuse_varying_gain("plant.input_gain", self.input_gain, self.states)
            check_gain("plant.input_gain", self.input_gain, self.gain_sign, constants)
            set_fields(self, input_gain=number("plant.input_gain", self.input_gain, constants))
        if self.theta is not None:
            what = "one number per regressor"
            theta = checks.sequence("plant.theta", self.theta, self.r, what)
            values = (number(f"plant.theta[{i}]", v, constants) for i, v in enumerate(theta))
            set_fields(self, theta=tuple(values))
        if self.input_gain_range is not None:
            key = "plant.ranges.input_gain"
            low, high = checks.ordered_pair(key, self.input_gain_range, constants)
            for end in (low, high):
                check_gain(key, end, self.gain_sign)
            set_fields(self, input_gain_range=(low, high))
        if self.theta_range is not None:
            self._check_theta_range(constants)

    def _check_theta_range(self, constants: Mapping[str, Any]) -> None:
        key = "plant.ranges.theta"
        box = checks.sequence(key, self.theta_range, None, "[low, high] pairs")
        if len(box) != self.r:
            many = f"{self.r} pair{'' if self.r == 1 else 's'}"
            what = f"needs {many} [low, high], one per regressor"
            raise InputError(key, what, f"{len(box)}: {box}")
        pairs = (checks.ordered_pair(f"{key}[{i}]", v, constants) for i, v in enumerate(box))
        set_fields(self, theta_range=tuple(pairs))

    @property
    def n(self) -> int:
        """Order of the plant."""
        return len(self.states)

    @property
    def r(self) -> int:
        """Number of unknown parameters theta."""
        return len(self.regressor)

    @cached_property
    def constant_values(self) -> dict[str, sympy.Expr]:
        """Exact values of the constants."""
        return {name: value.expr for name, value in self.constants}

    @cached_property
    def symbols(self) -> tuple[sympy.Symbol, ...]:
        """SymPy symbols of the states."""
        return tuple(symbol(name) for name in self.states)

    @cached_property
    def g(self) -> np.ndarray:
        """g_1 ... g_{n-1}, shape (n-1,)."""
        return np.array([float(value.expr) for value in self.chain])

    @cached_property
    def b(self) -> np.ndarray:
        """b_ij, lower triangular, shape (n-1, n)."""
        matrix = np.zeros((self.n - 1, self.n))
        for i, row in enumerate(self.linear):
            matrix[i, : i + 1] = [float(value.expr) for value in row]
        return matrix

    def with_constants(self, **values: float | Expression) -> Plant:
        """The same plant with other values of some constants; derived numbers follow."""
        if not values:
            return self
        unknown = set(values) - {name for name, _ in self.constants}
        if unknown:
            raise InputError("constants", f"unknown constant {sorted(unknown)[0]!r}")
        sources: Any = {name: values.get(name, value) for name, value in self.constants}
        return replace(self, constants=sources)


def new_name(key: str, name: Any, used: Sequence[str]) -> str:
    """A name that is not used yet, neither here nor by the language nor by the closed loop."""
    check_name(key, name, used)
    if name in LOOP_SIGNALS or name.startswith(LOOP_PREFIXES):
        raise InputError(key, "this name is reserved for a signal", name, "Rename it")
    return str(name)


#: What to do where a coefficient of the rows 1 ... n-1 depends on states.
ROW_REMEDY = (
    "Rows 1 ... n-1 must be x_i' = g_i x_{i+1} + sum b_ij x_j + tau_i w_i with constant g_i and "
    "b_ij: take x_i' itself as the next state, or put the difference from a constant into w_i"
)

#: The same for g_n.
GAIN_REMEDY = (
    "The last row must be x_n' = h(x) + g_n u + phi(x)^T theta + tau_n w_n, affine in u with a "
    "constant g_n: take the whole term with the input as a new input v, with input_gain = 1 or "
    "another constant, and let the drive compute its command from v and the measured states"
)


def _refuse_states(key: str, value: Any, states: Sequence[str], remedy: str) -> None:
    """Refuse a coefficient that depends on states, and say what the class of plants is."""
    if not isinstance(value, (str, Expression)):
        return
    names = {str(s) for s in parse(key, value, None).expr.free_symbols}
    for name in states:
        if name in names:
            text = value if isinstance(value, str) else value.text
            raise InputError(
                key, f"unknown name {name!r}: a state, where a constant is needed", text, remedy
            )


def refuse_varying_gain(key: str, value: Any, states: Sequence[str]) -> None:
    """Refuse an input gain that depends on states, and say which change of the input helps."""
    _refuse_states(key, value, states, GAIN_REMEDY)


def refuse_prefix(plant: Plant, prefix: str, who: str) -> None:
    """Refuse a plant with names that begin as those that `who` gives to constants of its own."""
    for name in (*plant.states, *plant.constant_values):
        if name.startswith(prefix):
            key = "plant.states" if name in plant.states else f"plant.constants.{name}"
            what = f"names that begin with {prefix} are reserved by {who}"
            raise InputError(key, what, name, "Rename it")


def check_gain(
    key: str, value: Any, gain_sign: int, constants: Mapping[str, Any] | None = None
) -> float:
    """A nonzero input gain of the stated sign."""
    gain = checks.real(key, value, constants, nonzero=True)
    if gain * gain_sign < 0:
        raise InputError(key, f"must have the sign of plant.gain_sign = {gain_sign}", gain)
    return gain


def check_within(key: str, value: float, box: tuple[float, float] | None, name: str) -> None:
    """Refuse a true value outside the range that the designer states."""
    if box is not None and not box[0] <= value <= box[1]:
        raise InputError(key, f"must lie in plant.ranges.{name} = [{box[0]:g}, {box[1]:g}]", value)

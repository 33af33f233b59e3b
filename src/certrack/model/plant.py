"""The plant as the designer knows it.

x_i' = g_i x_{i+1} + sum_{j<=i} b_ij x_j + tau_i w_i(t, x)               i = 1 ... n-1
x_n' = h(x) + g_n u + phi(x)^T theta + tau_n w_n(t, x)                             [5]
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, number, parse, symbol
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.model.coefficients import (
    ROW_REMEDY,
    check_gain,
    coupling_row,
    refuse_states,
    refuse_varying_gain,
)
from certrack.model.names import new_name
from certrack.model.ranges import (
    ConstantRange,
    check_sign_at_ends,
    checked_ranges,
    dependents,
    open_constants,
)
from certrack.model.uncertainty import Uncertainty

MAX_ORDER = 50

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
    constant_ranges : mapping of constants to intervals, optional
        Ranges of constants. The law is made with their values in `constants`.
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
    constant_ranges: tuple[ConstantRange, ...] = keyed(
        "intervals by name",
        (),
        help="range of any constant; the law is made with the value in plant.constants",
        path="ranges.NAME",
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
            refuse_states(f"plant.chain[{i}]", value, states, ROW_REMEDY)
            checks.real(f"plant.chain[{i}]", value, values, nonzero=True)
        names = [*states, *values]
        phi = checks.sequence("plant.regressor", self.regressor, None, keys["regressor"].shape)
        set_fields(
            self,
            chain=tuple(parse(f"plant.chain[{i}]", v, values) for i, v in enumerate(coefficients)),
            linear=self._check_linear(states, values),
            drift=parse("plant.drift", self.drift, names),
            regressor=tuple(parse(f"plant.regressor[{i}]", v, names) for i, v in enumerate(phi)),
        )
        self._check_parameters(values)
        self._check_ranges(values)
        set_fields(self, uncertainty=self._check_uncertainty(n))
        if self.units is not None:
            set_fields(self, units=keys["units"].checked("plant.units", self.units, count=n + 1))

    def _check_uncertainty(self, n: int) -> Uncertainty:
        bounds: Any = self.uncertainty
        if bounds is None or (isinstance(bounds, Uncertainty) and bounds == UNSTATED):
            return Uncertainty.none(n)
        if isinstance(bounds, Mapping):
            moved = self._moved(dict(self.constants))
            fixed = {k: v for k, v in self.constant_values.items() if k not in moved}
            try:
                return Uncertainty.from_table(bounds, self.states, fixed)
            except InputError as problem:
                if not any(f"{name!r}" in problem.expected for name in moved):
                    raise
                message = "must not depend on a constant with a range"
                remedy = "State the largest value that it can have"
                raise InputError(problem.key, message, problem.got, remedy) from None
        if not isinstance(bounds, Uncertainty):
            raise InputError("plant.uncertainty", "must be an Uncertainty", bounds)
        for name in ("tau", "gamma", "beta"):
            values = getattr(bounds, name)
            checks.sequence(f"plant.uncertainty.{name}", values, n, "one number per state")
        return bounds.bound_to(self.states, self.constant_values)

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
        values: dict[str, Any] = {}
        for name, value in checks.name_value_pairs("plant.constants", self.constants):
            key = f"plant.constants.{name}"
            new_name(key, name, constants if name in constants else states)
            constants[name] = number(key, value, values)
            values[name] = constants[name].expr
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
        lengths = [coupling_row(f"{key}[{i}]", row, i + 1) for i, row in enumerate(rows)]
        for i, row in enumerate(lengths):
            for j, value in enumerate(row):
                refuse_states(f"{key}[{i}][{j}]", value, states, ROW_REMEDY)
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

    def _check_ranges(self, values: Mapping[str, Any]) -> None:
        written = dict(self.constants)
        ranges = checked_ranges(self.constant_ranges, written, values)
        set_fields(self, constant_ranges=ranges)
        moved = self._moved(written)
        gain = self.input_gain
        if self.input_gain_range is not None and gain is not None and _mentions(gain, moved):
            key, message = (
                "plant.ranges.input_gain",
                "plant.input_gain already follows its constants",
            )
            raise InputError(key, message, gain.text, "Leave one of the two ranges out")
        if self.theta_range is not None and any(_mentions(v, moved) for v in self.theta or ()):
            key, message = "plant.ranges.theta", "plant.theta already follows its constants"
            raise InputError(key, message, remedy="Leave one of the two ranges out")
        named = {f"plant.chain[{i}]": g for i, g in enumerate(self.chain)}
        named |= {} if gain is None else {"plant.input_gain": gain}
        for key, formula in named.items():
            check_sign_at_ends(key, formula, self.constant_ranges, self.open_values)

    def _moved(self, written: dict[str, Expression]) -> set[str]:
        """Names of the constants that are not fixed."""
        names = {name for name, _, _ in self.constant_ranges}
        return names | dependents(names, written) if names else names

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
    def constant_boxes(self) -> dict[str, tuple[float, float]]:
        """Ranges of constants by name, in floats."""
        return {
            name: (float(low.expr), float(high.expr)) for name, low, high in self.constant_ranges
        }

    @cached_property
    def open_values(self) -> dict[str, sympy.Expr]:
        """Every constant as a formula of those that have a range."""
        return open_constants(dict(self.constants), {name for name, _, _ in self.constant_ranges})

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
        """The same plant with other values of some constants; derived numbers follow.

        It is one plant of those that the ranges of the constants admit: it has none itself.
        """
        if not values:
            return self
        unknown = set(values) - {name for name, _ in self.constants}
        if unknown:
            raise InputError("constants", f"unknown constant {sorted(unknown)[0]!r}")
        sources: Any = {name: values.get(name, value) for name, value in self.constants}
        return replace(self, constants=sources, constant_ranges=())


def _mentions(formula: Expression, names: set[str]) -> bool:
    """Whether the text of a number contains one of the names."""
    return bool(set(map(str, parse("", formula, None).expr.free_symbols)) & names)

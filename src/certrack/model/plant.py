"""The plant as the designer knows it, and its uncertainty.

x_i' = g_i x_{i+1} + sum_{j<=i} b_ij x_j + tau_i w_i(t, x)               i = 1 ... n-1
x_n' = h(x) + g_n u + phi(x)^T theta + tau_n w_n(t, x)                             [5]
"""

from __future__ import annotations

import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression, check_name, number, parse, symbol

MAX_ORDER = 50

#: Names and prefixes that a closed loop gives to its own signals.
SIGNALS = ("u", "e", "nu", "time", "state", "parameter", "member")
PREFIXES = (
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


def set_fields(instance: object, **values: Any) -> None:
    """Normalise fields of a frozen dataclass while it is being made."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


@dataclass(frozen=True)
class Uncertainty:
    """Bounds of the uncertain terms: |w_k(t, x)| <= gamma_k ||x|| + beta_k (Assumption 1).

    Parameters
    ----------
    tau, gamma, beta : n numbers >= 0
        Strength of w_k in the plant, and its growth and offset bounds.
    """

    tau: tuple[float, ...]
    gamma: tuple[float, ...]
    beta: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("tau", "gamma", "beta"):
            key = f"plant.uncertainty.{name}"
            values = checks.reals(key, getattr(self, name), None, "n numbers", least=0)
            set_fields(self, **{name: values})

    @staticmethod
    def none(n: int) -> Uncertainty:
        """No uncertain terms at all."""
        zeros = (0.0,) * n
        return Uncertainty(zeros, zeros, zeros)


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
    uncertainty : Uncertainty, optional
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

    states: tuple[str, ...]
    chain: tuple[Expression, ...] = ()
    linear: tuple[tuple[Expression, ...], ...] | None = None
    drift: Expression = field(default=0)  # type: ignore[assignment]
    regressor: tuple[Expression, ...] = ()
    gain_sign: int = 1
    input_gain: Expression | None = None
    theta: tuple[Expression, ...] | None = None
    uncertainty: Uncertainty = None  # type: ignore[assignment]
    constants: tuple[tuple[str, Expression], ...] = ()
    input_gain_range: tuple[float, float] | None = None
    theta_range: tuple[tuple[float, float], ...] | None = None
    units: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        states = self._check_states()
        n = len(states)
        set_fields(self, states=states, constants=self._check_constants(states))
        known = self.constant_values
        g = checks.sequence("plant.chain", self.chain, n - 1, "g_1 ... g_{n-1}")
        for i, value in enumerate(g):
            checks.real(f"plant.chain[{i}]", value, known, nonzero=True)
        names = [*states, *known]
        phi = checks.sequence("plant.regressor", self.regressor, None, "phi_1(x) ... phi_r(x)")
        set_fields(
            self,
            chain=tuple(parse(f"plant.chain[{i}]", v, known) for i, v in enumerate(g)),
            linear=self._check_linear(n, known),
            drift=parse("plant.drift", self.drift, names),
            regressor=tuple(parse(f"plant.regressor[{i}]", v, names) for i, v in enumerate(phi)),
            uncertainty=Uncertainty.none(n) if self.uncertainty is None else self.uncertainty,
        )
        if not isinstance(self.uncertainty, Uncertainty):
            raise InputError("plant.uncertainty", "must be an Uncertainty", self.uncertainty)
        for name in ("tau", "gamma", "beta"):
            values = getattr(self.uncertainty, name)
            checks.sequence(f"plant.uncertainty.{name}", values, n, "one number per state")
        self._check_parameters(known)
        if self.units is not None:
            units = checks.sequence("plant.units", self.units, n + 1, "states, then input")
            set_fields(self, units=tuple(checks.text("plant.units", unit) for unit in units))

    def _check_states(self) -> tuple[str, ...]:
        given = checks.sequence("plant.states", self.states, None, "names of x_1 ... x_n")
        if not 1 <= len(given) <= MAX_ORDER:
            raise InputError("plant.states", f"must be 1 to {MAX_ORDER} names", given)
        states: list[str] = []
        for i, name in enumerate(given):
            states.append(own_name(f"plant.states[{i}]", name, states))
        return tuple(states)

    def _check_constants(self, states: tuple[str, ...]) -> tuple[tuple[str, Expression], ...]:
        pairs = name_value_pairs("plant.constants", self.constants)
        found: dict[str, Expression] = {}
        for name, value in pairs:
            key = f"plant.constants.{name}"
            own_name(key, name, [*states, *found])
            found[name] = number(key, value, {k: v.expr for k, v in found.items()})
        return tuple(found.items())

    def _check_linear(self, n: int, known: Mapping[str, Any]) -> tuple[tuple[Expression, ...], ...]:
        given = self.linear
        if given is None:
            given = tuple((0,) * i for i in range(1, n))  # type: ignore[misc]
        rows = checks.sequence("plant.linear", given, n - 1, "rows b_i1 ... b_ii, i = 1 ... n-1")
        return tuple(
            tuple(
                number(f"plant.linear[{i}][{j}]", v, known)
                for j, v in enumerate(
                    checks.sequence(f"plant.linear[{i}]", row, i + 1, "b_i1 ... b_ii")
                )
            )
            for i, row in enumerate(rows)
        )

    def _check_parameters(self, known: Mapping[str, Any]) -> None:
        sign = self.gain_sign
        whole = isinstance(sign, numbers.Real) and not isinstance(sign, bool)
        if not whole or sign not in (1, -1):
            raise InputError("plant.gain_sign", "must be 1 or -1", self.gain_sign)
        if self.input_gain is not None:
            check_gain("plant.input_gain", self.input_gain, self.gain_sign, known)
            set_fields(self, input_gain=number("plant.input_gain", self.input_gain, known))
        if self.theta is not None:
            what = "one number per regressor"
            theta = checks.sequence("plant.theta", self.theta, self.r, what)
            values = (number(f"plant.theta[{i}]", v, known) for i, v in enumerate(theta))
            set_fields(self, theta=tuple(values))
        if self.input_gain_range is not None:
            low, high = checks.interval("plant.ranges.input_gain", self.input_gain_range, known)
            for end in (low, high):
                check_gain("plant.ranges.input_gain", end, self.gain_sign)
            set_fields(self, input_gain_range=(low, high))
        if self.theta_range is not None:
            box = checks.sequence("plant.ranges.theta", self.theta_range, None, "[low, high] pairs")
            if len(box) != self.r:
                many = f"{self.r} pair{'' if self.r == 1 else 's'}"
                what = f"needs {many} [low, high], one per regressor"
                raise InputError("plant.ranges.theta", what, f"{len(box)}: {box}")
            pairs = (
                checks.interval(f"plant.ranges.theta[{i}]", v, known) for i, v in enumerate(box)
            )
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
        assert self.linear is not None
        matrix = np.zeros((self.n - 1, self.n))
        for i, row in enumerate(self.linear):
            matrix[i, : i + 1] = [float(value.expr) for value in row]
        return matrix

    def with_constants(self, **values: float) -> Plant:
        """The same plant with other values of some constants; derived numbers follow."""
        if not values:
            return self
        unknown = set(values) - {name for name, _ in self.constants}
        if unknown:
            raise InputError("constants", f"unknown constant {sorted(unknown)[0]!r}")
        sources = {name: values.get(name, value) for name, value in self.constants}
        return replace(self, constants=sources)  # type: ignore[arg-type]


def name_value_pairs(key: str, given: Any) -> list[tuple[str, Any]]:
    """Constants as pairs, from a mapping or from pairs."""
    if isinstance(given, Mapping):
        return list(given.items())
    pairs = [
        tuple(pair)
        for pair in checks.sequence(key, given, None, "pairs of name and number")
        if isinstance(pair, (tuple, list)) and len(pair) == 2
    ]
    if len(pairs) != len(given):
        raise InputError(key, "must be a mapping of names to numbers", given)
    return pairs  # type: ignore[return-value]


def own_name(key: str, name: Any, taken: Sequence[str]) -> str:
    """A name that neither the language nor the closed loop uses."""
    check_name(key, name, taken)
    if name in SIGNALS or name.startswith(PREFIXES):
        raise InputError(key, "this name is reserved for a signal", name, "Rename it")
    return str(name)


def check_gain(
    key: str, value: Any, gain_sign: int, known: Mapping[str, Any] | None = None
) -> float:
    """A nonzero input gain of the stated sign."""
    gain = checks.real(key, value, known, nonzero=True)
    if gain * gain_sign < 0:
        raise InputError(key, f"must have the sign of plant.gain_sign = {gain_sign}", gain)
    return gain


def check_within(key: str, value: float, box: tuple[float, float] | None, name: str) -> None:
    """Refuse a true value outside the range that the designer states."""
    if box is not None and not box[0] <= value <= box[1]:
        raise InputError(key, f"must lie in plant.ranges.{name} = [{box[0]:g}, {box[1]:g}]", value)

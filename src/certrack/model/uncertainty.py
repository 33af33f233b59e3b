"""Bounds of what the plant's equations leave out (Assumption 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import Expression
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.model.growth import (
    BOUND_KEY,
    GrowthInFloats,
    bound_as_formula,
    growing_bounds,
    is_global,
    smooth_size,
)
from certrack.model.slowness import (
    SLOWNESS,
    Slowness,
    check_slowness,
    read_slowness,
    slowness_of,
)


@dataclass(frozen=True)
class Uncertainty:
    """Bounds of the uncertain terms: |w_k(t, x)| <= gamma_k ||x|| + beta_k (Assumption 1).

    With `S` and `Delta`, |w_k| <= gamma_k ||S_k x|| + sum_j Delta_kj |x_j| + beta_k. All bounds
    speak of w_k before it is multiplied with tau_k.

    Parameters
    ----------
    tau, gamma, beta : n numbers >= 0
        Strength of w_k in the plant, and its growth and offset bounds.
    Delta : n rows of n numbers >= 0, optional
        Growth with each state by itself.
    S : n numbers >= 0, or n rows of them, optional
        Weights of the states in the norm of gamma: of all norms, or row k of that of w_k.
    constants_vary : bool
        Whether constants with a range may vary in time; otherwise they stand still.
    bound : n formulas, optional
        Where one is not empty it bounds |w_k|, in the place of gamma_k, beta_k and the row of
        Delta, which must be zero there. The name of a state stands for its magnitude, ``norm`` for
        ||S_k x||; it is proven to grow with all of them when a plant is made.
    rate : n numbers >= 0 or inf, 1/s, optional
        How fast the slow part of w_k may change between its jumps; see
        :mod:`certrack.model.slowness`. inf where nothing is known.
    jump, fast : n numbers >= 0, optional
        How far it may jump, and what is not slow in w_k.
    dwell : float, s, optional
        Least time between two jumps of one w_k.
    Delta_rate : n rows of n numbers >= 0, optional
        How much it may change with each state.

    Raises
    ------
    InputError
        If a number is negative, or the lists differ in length.
    """

    tau: tuple[float, ...] = keyed(
        "numbers",
        help="strengths of w_1 ... w_n in the plant",
        shape="one number per state",
        least=0,
    )
    gamma: tuple[float, ...] = keyed(
        "numbers",
        help="growth in |w_k(t, x)| <= gamma_k ||x|| + beta_k",
        shape="one number per state",
        least=0,
    )
    beta: tuple[float, ...] = keyed(
        "numbers",
        help="offset in |w_k(t, x)| <= gamma_k ||x|| + beta_k",
        shape="one number per state",
        least=0,
    )

    Delta: tuple[tuple[float, ...], ...] | None = keyed(
        "rows",
        None,
        help="growth with each state by itself: |w_k| <= sum_j Delta_kj |x_j| + beta_k",
        shape="n rows of n numbers",
        least=0,
        otherwise="none",
    )
    S: tuple[float, ...] | tuple[tuple[float, ...], ...] | None = keyed(
        "any",
        None,
        help="weights of the states in the norm, gamma_k ||S_k x||; row k is the diagonal of S_k",
        shape="n numbers, or n rows of n numbers",
        least=0,
        otherwise="one",
    )
    constants_vary: bool = keyed(
        "flag",
        False,
        help="whether constants with a range may vary in time",
    )
    bound: tuple[Expression | str, ...] | None = keyed(
        "formulas",
        None,
        help="of the states and norm, which stand for magnitudes: |w_k| is at most that, in the "
        'place of gamma, beta and Delta; "" for these',
        shape="one per state",
        otherwise="none",
    )
    rate: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="how fast the slow part of w_k may change between its jumps",
        shape="one number per state",
        unit="1/s",
        least=0,
        infinite=True,
        otherwise="not known",
    )
    jump: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="how far the slow part of w_k may jump",
        shape="one number per state",
        least=0,
        otherwise="no jumps",
    )
    dwell: float | None = keyed(
        "number",
        None,
        help="least time between two jumps of one w_k",
        unit="s",
        above=0,
        otherwise="no jumps",
    )
    fast: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="the part of beta that may change at any speed",
        shape="one number per state",
        least=0,
        otherwise="none",
    )
    Delta_rate: tuple[tuple[float, ...], ...] | None = keyed(
        "rows",
        None,
        help="how much the slow part of w_k may change with each state: sum_j Delta_rate_kj |dx_j|",
        shape="n rows of n numbers",
        least=0,
        otherwise="none",
    )

    def __post_init__(self) -> None:
        for name in ("tau", "gamma", "beta"):
            set_fields(self, **{name: _upper_bounds(name, getattr(self, name))})
        n = len(self.tau)
        for name in ("Delta", "S"):
            set_fields(self, **{name: _weights(name, getattr(self, name), n)})
        check_fields(self, "plant.uncertainty", "constants_vary")
        for name in ("gamma", "beta"):
            values = getattr(self, name)
            if len(values) != len(self.tau):
                wanted = f"must be a list of {len(self.tau)}, as many as tau"
                raise InputError(f"plant.uncertainty.{name}", wanted, list(values))
        if self.bound is not None:
            set_fields(self, bound=self._check_bounds(self.bound))
        stated = {name: getattr(self, name) for name in SLOWNESS}
        set_fields(self, **read_slowness(type(self), stated, n))
        check_slowness(self)

    def _check_bounds(self, bounds: Any) -> tuple[Expression | str, ...] | None:
        """The formulas, of which only the plant knows the names; None if all are empty."""
        n, shape = len(self.tau), keys_of(self)["bound"].shape
        entries = checks.sequence(BOUND_KEY, bounds, n, f"{shape} (n = {n})")
        for k, entry in enumerate(entries):
            if entry == "":
                continue
            growth = self.Delta[k] if self.Delta is not None else ()
            if self.gamma[k] or self.beta[k] or any(growth):
                key = f"{BOUND_KEY}[{k}]"
                what = f"must be all of the bound of w_{k + 1}"
                remedy = f"Set gamma[{k}], beta[{k}] and the row of Delta to 0, or leave it empty"
                raise InputError(key, what, getattr(entry, "text", entry), remedy)
        return tuple(entries) if any(entry != "" for entry in entries) else None

    def bound_to(self, states: Sequence[str], constants: Mapping[str, Any]) -> Uncertainty:
        """These bounds with their formulas read, of the names of a plant."""
        if self.bound is None:
            return self
        return replace(self, bound=growing_bounds(self.bound, states, constants))

    @classmethod
    def from_table(
        cls, table: Any, states: Sequence[str], constants: Mapping[str, Any]
    ) -> Uncertainty:
        """The bounds of a table ``{tau, gamma, beta ...}`` whose numbers may be formulas."""
        keys, n = keys_of(cls), len(states)
        required = [name for name, key in keys.items() if key.required]
        checks.known_keys("plant.uncertainty", table, keys, required=required)
        values: dict[str, Any] = {
            name: _upper_bounds(name, table[name], constants, n) for name in required
        }
        for name in ("Delta", "S"):
            values |= {name: _weights(name, table[name], n, constants)} if name in table else {}
        if "constants_vary" in table:
            values["constants_vary"] = table["constants_vary"]
        if "bound" in table:
            entries = checks.sequence(
                BOUND_KEY, table["bound"], n, f"{keys['bound'].shape} (n = {n})"
            )
            values["bound"] = growing_bounds(entries, states, constants)
        values |= read_slowness(cls, {name: table.get(name) for name in SLOWNESS}, n, constants)
        return cls(**values)

    def slowness(self, k: int) -> Slowness | None:
        """How fast w_k may change; None if nothing is known of that."""
        return slowness_of(self, k)

    def formula(self, k: int) -> Expression | None:
        """The formula that bounds w_k, if it has one."""
        entry = "" if self.bound is None else self.bound[k]
        return entry if isinstance(entry, Expression) else None

    def grows(self, k: int) -> bool:
        """Whether the bound of w_k grows with the state."""
        formula = self.formula(k)
        if formula is not None:
            return bool(formula.expr.free_symbols)
        return self.gamma[k] > 0 or (self.Delta is not None and any(self.Delta[k]))

    def acts(self, k: int) -> bool:
        """Whether w_k may differ from zero."""
        formula = self.formula(k)
        return self.grows(k) or self.beta[k] > 0 or (formula is not None and formula.expr != 0)

    @property
    def is_regional(self) -> bool:
        """Whether a bound of a w_k that acts grows faster than the state."""
        formulas = ((t, self.formula(k)) for k, t in enumerate(self.tau))
        return any(t and entry is not None and not is_global(entry) for t, entry in formulas)

    def norm_weights(self, k: int) -> tuple[float, ...]:
        """Diagonal of S_k."""
        if self.S is None:
            return (1.0,) * len(self.tau)
        return self.S[k] if isinstance(self.S[0], tuple) else self.S  # type: ignore[return-value]

    def largest(self, k: int, x: np.ndarray, states: Sequence[str] = ()) -> np.ndarray:
        """The bound of w_k at states (n,) or (n, N); of their names, where it is a formula."""
        weighted = (np.array(self.norm_weights(k)) * x.T).T
        norm = np.linalg.norm(weighted, axis=0)
        formula = self.formula(k)
        if formula is not None:
            return GrowthInFloats(formula, states).value(x, norm)
        total: np.ndarray = self.gamma[k] * norm + self.beta[k]
        return total if self.Delta is None else total + np.array(self.Delta[k]) @ np.abs(x)

    def bound_formula(self, k: int, states: Sequence[str], offset: float) -> str:
        """The bound of w_k as a formula, with a norm that is smooth at zero and never above ||x||.

        Parameters
        ----------
        k : int
            Number of the state, from 0.
        states : names of the plant's states
        offset : float
            The norm is sqrt(x.x + offset^2) - offset.
        """
        squares = [
            f"{x}**2" if weight == 1 else f"{weight!r}**2*{x}**2"
            for x, weight in zip(states, self.norm_weights(k), strict=True)
            if weight
        ]
        norm = f"(sqrt({' + '.join(squares) or 0} + {offset**2!r}) - {offset!r})"
        formula = self.formula(k)
        if formula is not None:
            return bound_as_formula(formula, states, norm, offset)
        parts = [f"{self.gamma[k]!r}*{norm}"] if self.gamma[k] else []
        for x, entry in zip(states, self.Delta[k] if self.Delta else (), strict=False):
            parts += [f"{entry!r}*{smooth_size(x, offset)}"] if entry else []
        parts += [repr(self.beta[k])] if self.beta[k] else []
        return " + ".join(parts) or "0"

    @staticmethod
    def none(n: int) -> Uncertainty:
        """No uncertain terms at all."""
        zeros = (0.0,) * n
        return Uncertainty(zeros, zeros, zeros)


def _upper_bounds(
    name: str, values: Any, constants: Mapping[str, Any] | None = None, count: int | None = None
) -> tuple[float, ...]:
    """Numbers >= 0 that stand for the rationals of their texts; irrational ones from above."""
    shape = keys_of(Uncertainty)[name].shape
    key = f"plant.uncertainty.{name}"
    return checks.reals(key, values, count, shape, constants, least=0, side=1)


def _weights(name: str, values: Any, count: int, constants: Mapping[str, Any] | None = None) -> Any:
    """Rows of numbers >= 0; for S also one row for all; None if left out."""
    if values is None:
        return None
    key = f"plant.uncertainty.{name}"
    shape = keys_of(Uncertainty)[name].shape
    rows = checks.sequence(key, values, count, f"{shape} (n = {count})")
    if name == "S" and not any(isinstance(row, (list, tuple, np.ndarray)) for row in rows):
        return checks.reals(key, rows, count, "one number per state", constants, least=0, side=1)
    return tuple(
        checks.reals(f"{key}[{k}]", row, count, "one number per state", constants, least=0, side=1)
        for k, row in enumerate(rows)
    )

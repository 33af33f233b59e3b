"""Bounds of what the plant's equations leave out (Assumption 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.keys import keyed, keys_of, set_fields


@dataclass(frozen=True)
class Uncertainty:
    """Bounds of the uncertain terms: |w_k(t, x)| <= gamma_k ||x|| + beta_k (Assumption 1).

    Parameters
    ----------
    tau, gamma, beta : n numbers >= 0
        Strength of w_k in the plant, and its growth and offset bounds.

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

    def __post_init__(self) -> None:
        for name in keys_of(self):
            set_fields(self, **{name: _upper_bounds(name, getattr(self, name))})
        for name in ("gamma", "beta"):
            values = getattr(self, name)
            if len(values) != len(self.tau):
                wanted = f"must be a list of {len(self.tau)}, as many as tau"
                raise InputError(f"plant.uncertainty.{name}", wanted, list(values))

    @classmethod
    def from_table(cls, table: Any, n: int, constants: Mapping[str, Any]) -> Uncertainty:
        """The bounds of a table ``{tau, gamma, beta}`` whose numbers may be formulas."""
        keys = keys_of(cls)
        checks.known_keys("plant.uncertainty", table, keys, required=keys)
        return cls(**{name: _upper_bounds(name, table[name], constants, n) for name in keys})

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
        square = " + ".join(f"{x}**2" for x in states)
        norm = f"(sqrt({square} + {offset**2!r}) - {offset!r})"
        parts = [f"{self.gamma[k]!r}*{norm}"] if self.gamma[k] else []
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

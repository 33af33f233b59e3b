"""Names that a plant and a truth may give: none that the language or a closed loop uses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from certrack.core.errors import InputError
from certrack.core.expressions import check_name

if TYPE_CHECKING:
    from certrack.model.plant import Plant

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

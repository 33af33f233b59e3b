"""Names that a plant and a truth may give: none that the language or a closed loop uses."""

from __future__ import annotations

from collections.abc import Iterable
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


def new_name(key: str, name: Any, used: Iterable[str]) -> str:
    """A name that is not used yet, neither here nor by the language nor by the closed loop."""
    check_name(key, name, used)
    if name in LOOP_SIGNALS or name.startswith(LOOP_PREFIXES):
        raise InputError(key, "this name is reserved for a signal", name, "Rename it")
    return str(name)


def refuse_prefix(plant: Plant, prefix: str, who: str) -> None:
    """Refuse a plant with names that begin as those that `who` gives to constants of its own."""
    for name in (*plant.states, *plant.constant_values):
        if name.startswith(prefix):
            key = "plant.states" if name in plant.states else f"plant.constants.{name}"
            what = f"names that begin with {prefix} are reserved by {who}"
            raise InputError(key, what, name, "Rename it")

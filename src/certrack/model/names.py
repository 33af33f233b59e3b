"""Names that a plant and a truth may give: none that the language or a closed loop uses."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from certrack.core.errors import InputError
from certrack.core.expressions import check_name

if TYPE_CHECKING:
    from certrack.model.plant import Plant

#: Beginnings of the names of certrack's own numbers and memories, which no formula may take.
NUMBER_PREFIXES = (
    *("law_", "ctl_", "kept_", "true_", "ref_", "piece_", "y_d_", "member_", "switch_", "mode_"),
    "integral_",
)

#: Names and beginnings of names that a closed loop gives to its own signals.
LOOP_SIGNALS = ("u", "e", "nu", "time", "state", "parameter", "member")
#: An ensemble gives its members' plants constants of its own, so it refuses its prefix itself.
OF_ENSEMBLES = "member_"
LOOP_PREFIXES = (
    *("e_", "lambda_", "y_d", "delta_", "theta_"),
    *(prefix for prefix in NUMBER_PREFIXES if prefix != OF_ENSEMBLES),
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

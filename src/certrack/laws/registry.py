"""The laws that a system file can name: ours, registered ones, and those of installed packages."""

from __future__ import annotations

from dataclasses import is_dataclass
from importlib.metadata import entry_points
from typing import Any, TypeVar

from certrack.core.errors import InputError
from certrack.core.expressions import check_name
from certrack.core.keys import keys_of, require_compared
from certrack.laws.adaptive import Adaptive
from certrack.laws.base import Law
from certrack.laws.baselines.adrc import Adrc
from certrack.laws.baselines.l1 import L1Adaptive
from certrack.laws.baselines.mpc import Mpc
from certrack.laws.baselines.mrac import Mrac
from certrack.laws.baselines.pid import Pid
from certrack.laws.baselines.sliding import SlidingMode
from certrack.laws.baselines.super_twisting import SuperTwisting
from certrack.laws.classic import Classic
from certrack.laws.linear import Linear
from certrack.laws.robust import Robust

#: Laws of the textbooks, to be compared with.
BASELINES = (Pid, SlidingMode, SuperTwisting, Adrc, Mrac, L1Adaptive, Mpc)

LAWS: dict[str, type[Law]] = {
    law.kind: law for law in (Adaptive, Robust, Linear, Classic, *BASELINES)
}

_L = TypeVar("_L", bound=type[Law])

#: Laws that :func:`register_law` was called with, in this process.
_registered_laws: dict[str, type[Law]] = {}


def register_law(law: _L) -> _L:
    """Class decorator: let system files name a law by its `kind`, in this process.

    A cell of a notebook may be executed again: the new class takes the place of the old one.

    Parameters
    ----------
    law : subclass of Law
        A frozen dataclass with the class attribute `kind`.

    Returns
    -------
    class
        The law itself.

    Raises
    ------
    InputError
        If it is no such class, or its kind is that of a shipped law.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from certrack.laws import Robust, known_laws, register
    >>> @register
    ... @dataclass(frozen=True, kw_only=True)
    ... class Gentle(Robust):
    ...     kind = "gentle"
    >>> known_laws()["gentle"] is Gentle
    True
    """
    if not (isinstance(law, type) and issubclass(law, Law)):
        raise InputError("law", "must be a subclass of certrack.laws.Law", law)
    parameters: Any = getattr(law, "__dataclass_params__", None)
    if not is_dataclass(law) or "__dataclass_params__" not in vars(law) or not parameters.frozen:
        remedy = "Write @register above @dataclass(frozen=True, kw_only=True)"
        raise InputError("law", "must be a frozen dataclass", law.__name__, remedy)
    require_compared("law", law)
    inherited, declared = keys_of(Law), keys_of(law)
    for name, key in inherited.items():
        if name not in declared or declared[name].kind != key.kind:
            message = f"is the name of a field of certrack.laws.Law, which holds {key.kind}"
            raise InputError(f"law.{name}", message, law.__name__, "Choose another name")
    kind = str(getattr(law, "kind", ""))
    check_name("law.kind", kind.replace("-", "_"))
    if kind in LAWS:
        raise InputError("law.kind", "is that of a shipped law", kind, "Choose another name")
    _registered_laws[kind] = law
    return law


def known_laws() -> dict[str, type[Law]]:
    """The laws a system file can name, by their kinds.

    Ours; those of :func:`register_law`; and those of packages that declare the entry point group
    ``certrack.laws``.
    """
    packaged = {point.name: point.load() for point in entry_points(group="certrack.laws")}
    return LAWS | packaged | _registered_laws | LAWS  # ours first in messages, and ours in force

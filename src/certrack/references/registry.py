"""References of a user's own: registered with their keys, and checked when a system gets them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from functools import lru_cache, wraps
from importlib.metadata import entry_points
from typing import Any, TypeVar

import numpy as np

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, check_name
from certrack.core.keys import Key, keys_of, require_compared
from certrack.core.lowering import numpy_callable, rows
from certrack.core.supported import check_symbols, normal_form
from certrack.references.base import Reference
from certrack.references.keys import REFERENCE_KINDS, ReferenceKind
from certrack.references.piecewise import PiecewiseReference
from certrack.references.soft_start import SoftStart
from certrack.references.symbolic import SymbolicReference

_Maker = TypeVar("_Maker", bound=Callable[..., Any])

#: What :func:`register_reference` was called with, in this process.
_registered_references: dict[str, ReferenceKind] = {}

#: What a reference must have.
PROTOCOL = tuple(name for name in vars(Reference) if not name.startswith("_"))

#: How symbols of a reference begin.
SYMBOL_PREFIXES = ("ref_", "piece_")

#: Times at which formulas and values are compared, and how far they may differ.
COMPARED_TIMES, FORMULA_TOLERANCE = 33, 1e-9


def register_reference(kind: str, **keys: Key) -> Callable[[_Maker], _Maker]:
    """Decorator: let system files name a reference by its kind, in this process.

    A cell of a notebook may be executed again: the new one takes the place of the old one.

    Parameters
    ----------
    kind : str
        What stands in ``[reference]`` as its kind.
    **keys : Key
        Of a function: what its arguments are in the file. A class declares its keys by its fields
        (:func:`certrack.references.key`).

    Returns
    -------
    decorator
        Of a frozen dataclass that keeps :class:`~certrack.references.base.Reference`, or of a
        function that returns a :class:`~certrack.references.piecewise.PiecewiseReference`.

    Raises
    ------
    InputError
        If the kind is that of a shipped reference, or what is decorated is neither.

    Examples
    --------
    >>> from certrack.references import Key, register, steps
    >>> @register("two-steps", size=Key("number", help="height of a step", required=True))
    ... def two_steps(size):
    ...     return steps((1.0, 3.0), (0.0, size, 2 * size), slope=10.0)
    >>> two_steps(0.5).fields
    (('kind', 'two-steps'), ('size', 0.5))
    """
    check_name("reference.kind", str(kind).replace("-", "_"))
    if kind in REFERENCE_KINDS:
        message = "is that of a shipped reference"
        raise InputError("reference.kind", message, kind, "Choose another name")

    def decorate(maker: Any) -> Any:
        if not isinstance(maker, type):
            maker = _with_fields(kind, maker, keys)
            _registered_references[kind] = ReferenceKind(maker, dict(keys))
            return maker
        parameters: Any = getattr(maker, "__dataclass_params__", None)
        if not is_dataclass(maker) or parameters is None or not parameters.frozen:
            remedy = "Write @register(...) above @dataclass(frozen=True)"
            raise InputError("reference", "must be a frozen dataclass", maker.__name__, remedy)
        require_compared("reference", maker)
        described = {**keys_of(maker), **keys}
        _require_keys((f.name for f in fields(maker) if f.init and f.default is MISSING), described)
        _registered_references[kind] = ReferenceKind(maker, described)  # type: ignore[arg-type]
        return maker

    return decorate


def _require_keys(names: Iterable[str], keys: Mapping[str, Key]) -> None:
    """Refuse arguments that a file could not state."""
    if missing := [name for name in names if name not in keys]:
        message = f"{', '.join(missing)} has no key"
        remedy = (
            "Declare a field by certrack.references.key(...), or @register(kind, name=Key(...))"
        )
        raise InputError("reference", message, remedy=remedy)


def _with_fields(kind: str, make: Callable[..., Any], keys: Mapping[str, Key]) -> Any:
    """The function, whose references remember the arguments that made them."""
    signature = inspect.signature(make)
    _require_keys(signature.parameters, keys)

    @wraps(make)
    def with_fields(*arguments: Any, **named: Any) -> PiecewiseReference:
        bound = signature.bind(*arguments, **named)
        reference = make(*arguments, **named)
        if not isinstance(reference, PiecewiseReference):
            message = "must be a PiecewiseReference where a function makes it"
            raise InputError("reference", message, reference, "Register a class instead")
        values = {
            name: tuple(value) if isinstance(value, (list, np.ndarray)) else value
            for name, value in bound.arguments.items()
            if value is not None
        }
        return replace(reference, fields=(("kind", kind), *values.items()))

    return with_fields


def known_references() -> dict[str, ReferenceKind]:
    """The kinds of references that a system file can name.

    Ours; those of :func:`register_reference`; and those of packages that declare the entry point
    group ``certrack.references``, whose modules register them when they are loaded.
    """
    for point in entry_points(group="certrack.references"):
        point.load()
    return REFERENCE_KINDS | _registered_references | REFERENCE_KINDS  # ours come first


def kind_of(reference: Reference) -> str | None:
    """The registered kind of a reference that is a class of its own."""
    for kind, entry in known_references().items():
        if entry.make is type(reference):
            return kind
    return None


def check_reference(reference: Any, order: int, duration: float) -> None:
    """Refuse a reference that does not keep the protocol, before anything is compiled.

    Parameters
    ----------
    reference : Reference
    order : int
        Highest derivative that will be asked for.
    duration : float, s

    Raises
    ------
    InputError
        If it is not registered, lacks a member, or its formulas are not supported or not those of
        its values.
    """
    if isinstance(reference, SoftStart):
        check_reference(reference.target, order, duration)
        return
    if isinstance(reference, SymbolicReference):
        reference.check_finite(order, duration)
        return
    if isinstance(reference, PiecewiseReference):
        if not reference.fields:
            remedy = "Make it by a function that certrack.references.register decorates"
            raise InputError("reference", "has no kind, so no file can hold it", remedy=remedy)
        return
    if isinstance(reference, type):
        raise InputError("reference", "must be a reference, not its class", reference)
    missing = [name for name in PROTOCOL if not hasattr(reference, name)]
    if missing:
        remedy = "Inherit certrack.references.Reference"
        raise InputError("reference", f"lacks {', '.join(missing)}", reference, remedy)
    try:
        _check_values(reference, order, duration)
    except TypeError as problem:
        if "unhashable" not in str(problem):
            raise
        message = "must be hashable: its fields must be numbers, texts and tuples"
        raise InputError(
            "reference", message, remedy="Call check_fields in __post_init__"
        ) from None


@lru_cache(maxsize=64)
def _check_values(reference: Any, order: int, duration: float) -> None:
    """What takes longer; done once for equal references."""
    if kind_of(reference) is None:
        raise InputError(
            "reference",
            "is of a class that is not registered",
            type(reference).__name__,
            "Decorate it with certrack.references.register, and make it anew",
        )
    symbols = (*reference.parameter_symbols, *reference.piece_symbols)
    for symbol in symbols:
        if not str(symbol).startswith(SYMBOL_PREFIXES):
            message = "symbols must begin with " + " or ".join(SYMBOL_PREFIXES)
            raise InputError("reference", message, str(symbol))
    formulas = tuple(reference.formulas(order))
    _expect("formulas", len(formulas), order + 1)
    named = {("y_d" if not i else f"y_d^({i})"): formula for i, formula in enumerate(formulas)}
    for name, formula in named.items():
        if normal_form("reference", name, formula) != formula:
            raise InputError("reference", f"{name} has a power of symbols", str(formula))
    check_symbols("reference", named, {TIME, *symbols}, "Use t, parameters and pieces")
    _expect("parameter_values", len(reference.parameter_values), len(reference.parameter_symbols))
    breaks = np.asarray(reference.breaks(0.0, duration), dtype=float)
    if np.any(np.diff(breaks) <= 0) or np.any(breaks <= 0) or np.any(breaks >= duration):
        raise InputError("reference", "breaks must increase strictly inside the interval asked for")
    times = np.linspace(0.0, duration, COMPARED_TIMES + 2)[1:-1]
    values = np.asarray(reference.values(times, order), dtype=float)
    _expect("values", values.shape, (order + 1, len(times)))
    evaluate = numpy_callable([TIME, symbols], formulas)
    for t, column in zip(times.tolist(), values.T, strict=True):
        pieces = np.asarray(reference.piece_values(t), dtype=float)
        _expect("piece_values", len(pieces), len(reference.piece_symbols))
        with np.errstate(all="ignore"):
            expected = rows(evaluate(t, [*reference.parameter_values, *pieces]), 1)[:, 0]
        error = np.abs(column - expected) / (1.0 + np.abs(column))
        if not np.all(error <= FORMULA_TOLERANCE):
            i = int(np.argmax(~(error <= FORMULA_TOLERANCE)))
            message = f"values and formulas of y_d^({i}) differ at t = {t:g}"
            raise InputError("reference", message, f"{column[i]:g} and {expected[i]:g}")


def _expect(member: str, actual: Any, wanted: Any) -> None:
    if actual != wanted:
        what = "shape" if isinstance(wanted, tuple) else "count"
        raise InputError("reference", f"{member} must have the {what} {wanted}", str(actual))

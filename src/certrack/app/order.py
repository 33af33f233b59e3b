"""A text with more or fewer states: what is said of a state stays with its name.

A plant of another order changes a dozen lists at once. A state that is new gets entries that do
nothing, or those of the last one where there is no such entry; formulas are left to their author.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

from certrack.app.form import table_at
from certrack.systems.keys import TABLES

#: Which states the entries of a list belong to, by what its key says of its shape.
ENTRY_PER_STATE = (
    "one number per state",
    "one per state",
    "w_1 ... w_n, one per state",
    "one per state of the plant",
    "one per simulated state",
    "c_1 ... c_n",
    "K_1 ... K_n",
)
BUT_THE_LAST = ("g_1 ... g_{n-1}", "p_1 ... p_{n-1}")
STATES_AND_INPUT = "states, then input"
SQUARE_SHAPES = ("n rows of n numbers", "n numbers, or n rows of n numbers")
TRIANGLE = "rows b_i1 ... b_ii, i = 1 ... n-1"
DAMPING = "row m holds k_m1 ... k_m,2m, m = 1 ... n"

#: Lists of the truth's own states, where it has some: they are not those of the plant.
OF_THE_TRUTH = ("rates", "x0")

#: Entries of a new state that are not 0, and keys that have that of the last state.
OF_A_NEW_STATE = {"chain": 1, "units": "", "p": float("inf"), "outputs": "0"}
LIKE_THE_LAST = ("c", "K")


def names_typed(typed: str) -> list[str]:
    """The names that were typed as a list of TOML; none where it is no such list."""
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        names = tomlkit.value(typed.strip()).unwrap()
    except (TOMLKitError, ValueError, IndexError):
        return []
    texts = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return names if texts and len(set(names)) == len(names) else []


def with_states(text: str, names: Sequence[str]) -> str:
    """The text with the lists that have an entry for each state, for these states.

    Nothing changes where there are as many as before: then they have other names only; nor in a
    text that is no TOML or a list that has not an entry per state now, which loading will tell.

    Parameters
    ----------
    text : str
        TOML.
    names : texts
        Of the states, in their order.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        document = tomlkit.parse(text)
        before = names_typed(document["plant"]["states"].as_string())  # type: ignore[index, union-attr]
    except (TOMLKitError, ValueError, TypeError, AttributeError):
        return text
    if not before or not names or len(names) == len(before):
        return text
    sources = _sources(before, names)
    by_truth = "states" in (table_at(document, "truth") or ())
    for owner, name, shape in _lists(document):
        if by_truth and name in OF_THE_TRUTH:
            continue
        change = _change_of(shape, name, sources, len(before))
        if change is not None and isinstance(owner[name], list):
            with suppress(IndexError, TypeError):
                owner[name] = change(owner[name].unwrap())
    law = table_at(document, "law") or {}
    if isinstance(law.get("feedforward"), int) and law["feedforward"] >= len(names):
        law["feedforward"] = len(names) - 1
    return tomlkit.dumps(document)


def _sources(before: Sequence[str], names: Sequence[str]) -> list[int | None]:
    """Which state each one was: by name, or by place if no name is the same."""
    if set(before) & set(names):
        return [before.index(name) if name in before else None for name in names]
    return [k if k < len(before) else None for k in range(len(names))]


def _lists(document: Any) -> Iterator[tuple[Any, str, str]]:
    """Every list of the file with its table and its shape."""
    for table, keys in TABLES.items():
        path, _, kind = table.rstrip("]").partition("[")
        owner = table_at(document, path)
        if owner is None or (kind and owner.get("kind") != kind):
            continue
        for name, key in keys.items():
            if name in owner and key.shape:
                yield owner, name, key.shape


def _change_of(
    shape: str, name: str, sources: list[int | None], count: int
) -> Callable[[list[Any]], list[Any]] | None:
    """What makes a list of this shape one of the new states; None if it has no entry per state."""

    def entries(values: list[Any], places: Sequence[int | None]) -> list[Any]:
        new = values[-1] if name in LIKE_THE_LAST and values else OF_A_NEW_STATE.get(name, 0)
        return [new if k is None or k >= len(values) else values[k] for k in places]

    def row(values: Any, places: Sequence[int | None]) -> list[Any]:
        return [0 if k is None or k >= len(values) else values[k] for k in places]

    def rows(values: list[Any]) -> list[Any]:
        return [row(() if k is None else values[k], sources) for k in sources]

    def weights(values: list[Any]) -> list[Any]:
        return [1 if k is None else values[k] for k in sources]

    def triangle(values: list[Any]) -> list[Any]:
        old = [() if k is None or k >= len(values) else values[k] for k in sources[:-1]]
        return [row(old[i], sources[: i + 1]) for i in range(len(old))]

    def damping(values: list[Any]) -> list[Any]:
        none = [[float("inf")] * (2 * m + 2) for m in range(len(sources))]
        return [values[m] if k == m else none[m] for m, k in enumerate(sources)]

    if shape in ENTRY_PER_STATE:
        return lambda values: entries(values, sources)
    if shape in BUT_THE_LAST:
        return lambda values: entries(values, sources[:-1])
    if shape == STATES_AND_INPUT:
        return lambda values: [*entries(values[:count], sources), *values[count:]]
    if shape in SQUARE_SHAPES:
        return lambda values: rows(values) if isinstance(values[0], list) else weights(values)
    return {TRIANGLE: triangle, DAMPING: damping}.get(shape)

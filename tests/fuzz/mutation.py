"""Changes of nested tables and lists, as TOML and JSON have them."""

import copy
import random
from typing import Any

Path = tuple[Any, ...]


def paths(value: Any, path: Path = ()) -> list[Path]:
    """Paths of everything in it, without its own."""
    if isinstance(value, dict):
        entries = list(value.items())
    elif isinstance(value, list):
        entries = list(enumerate(value))
    else:
        entries = []
    found = []
    for key, entry in entries:
        found.append((*path, key))
        found += paths(entry, (*path, key))
    return found


def entry(value: Any, path: Path) -> Any:
    """What stands at a path."""
    for key in path:
        value = value[key]
    return value


def shuffled_list(rng: random.Random, values: list, new: Any) -> list:
    """A list with an entry more or less, in another order, or repeated."""
    values, kind = list(values), rng.random()
    if kind < 0.25 and values:
        values.pop(rng.randrange(len(values)))
    elif kind < 0.5:
        values.append(copy.deepcopy(rng.choice(values)) if values else new())
    elif kind < 0.7:
        rng.shuffle(values)
    elif kind < 0.8:
        values *= rng.choice([2, 10, 30])
    else:
        values = [new() for _ in values]
    return values


def mutated_bytes(rng: random.Random, data: bytes, pieces: list[bytes]) -> bytes:
    """Bytes changed, lost, or with pieces put in."""
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        kind, i = rng.random(), rng.randrange(len(changed) + 1)
        if kind < 0.4 and i < len(changed):
            changed[i] = rng.randrange(256)
        elif kind < 0.6:
            del changed[i : i + rng.randrange(30)]
        elif kind < 0.95:
            changed[i:i] = rng.choice(pieces)
        else:
            del changed[i:]
    return bytes(changed)

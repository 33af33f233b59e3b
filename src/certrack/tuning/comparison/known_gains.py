"""Gains that an earlier comparison has searched: read from what it wrote, and measured anew."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from certrack.core import checks
from certrack.core.errors import CertrackError, InputError
from certrack.core.keys import keys_of
from certrack.laws.base import Law
from certrack.tuning.comparison.trials import SharedLimits

#: Keys of the file that are read.
READ_KEYS = ("limits", "laws", "evaluations", "seed", "members")

#: Files of gains are small.
LARGEST_GAINS_FILE = 10_000_000


@dataclass(frozen=True)
class KnownGains:
    """What a search has given, and in what limits.

    Attributes
    ----------
    limits : SharedLimits
    laws : mapping of names to mappings
        Gains by key.
    evaluations : mapping of names to int
        That each law had.
    budget, seed, member_count : int
        Of the comparison.
    """

    limits: SharedLimits
    laws: Mapping[str, Mapping[str, Any]]
    evaluations: Mapping[str, int]
    budget: int
    seed: int
    member_count: int

    def law(self, name: str, base: Law) -> Law:
        """The law of this name: `base` with the gains of the file.

        Raises
        ------
        InputError
            If the file has no such law, or its gains do not fit.
        """
        checks.choice("laws", name, self.laws, "The file of gains has no others")
        gains = self.laws[name]
        key = f"laws.{name}.gains"
        checks.known_keys(key, gains, keys_of(base))
        try:
            return replace(base, **gains)
        except CertrackError as problem:
            raise InputError(key, f"do not fit: {problem}") from None


def read_gains(path: str | Path, stated: str) -> KnownGains:
    """The gains in a file that ``certrack compare --laws ... --json`` has written.

    Parameters
    ----------
    path : path
    stated : str
        Name of the file's own law, which has no searched gains.

    Raises
    ------
    InputError
        If it cannot be read, or is no such file.
    """
    try:
        if Path(path).stat().st_size > LARGEST_GAINS_FILE:
            raise InputError(str(path), "is too large for a file of gains")
        body = json.loads(Path(path).read_text("utf-8"))
    except OSError as problem:
        raise InputError(str(path), f"cannot be read ({problem.strerror})") from None
    except InputError:  # a ValueError, too
        raise
    except (ValueError, RecursionError):
        raise InputError(str(path), "is no file of gains: not JSON", remedy=_REMEDY) from None
    try:
        return _from_body(body, stated)
    except InputError as problem:
        raise InputError(str(path), f"is no file of gains: {problem}", remedy=_REMEDY) from None


_REMEDY = "certrack compare FILE --laws ... --json writes one"


def _from_body(body: Any, stated: str) -> KnownGains:
    checks.known_keys("", body, READ_KEYS, required=READ_KEYS)
    names = ("peak_input", "input_variation", "period")
    checks.known_keys("limits", body["limits"], names, required=names)
    laws = body["laws"]
    if not isinstance(laws, Mapping) or not set(laws) - {stated}:
        raise InputError("laws", "must be a table with a table for each law")
    gains, evaluations = {}, {}
    for name, figures in laws.items():
        if name == stated:
            continue
        if not isinstance(figures, Mapping) or not isinstance(figures.get("gains"), Mapping):
            raise InputError(f"laws.{name}.gains", "is missing")
        gains[name] = figures["gains"]
        tried = figures.get("evaluations", 0)
        evaluations[name] = checks.integer(f"laws.{name}.evaluations", tried, 0, 10**9)
    limits = {name: checks.real(f"limits.{name}", body["limits"][name], above=0) for name in names}
    return KnownGains(
        SharedLimits(**limits),
        gains,
        evaluations,
        checks.integer("evaluations", body["evaluations"], 1, 100_000),
        checks.integer("seed", body["seed"], 0, 2**63),
        checks.integer("members", body["members"], 2, 100_000),
    )

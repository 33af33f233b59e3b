"""The optional guard of a function block: a sample that is not finite leaves no trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from certrack.export.st.statements import INDENT, st_literal

#: Beyond it a number counts as not finite; LREAL ends at 1.797E308.
LARGEST_LREAL = 1.0e308

#: The input that asks for the guard.
GUARD = "GUARD"


def guarded(
    inputs: Sequence[str], results: Mapping[str, str], statements: Sequence[str]
) -> list[str]:
    """The statements of a call behind the guard.

    Parameters
    ----------
    inputs : identifiers
        What the block reads.
    results : mapping
        Output and states, and the temporary variable that keeps each of them meanwhile.
    statements : texts
    """
    keep = [f"{saved} := {name};" for name, saved in results.items()]
    back = [f"{INDENT}{name} := {saved};" for name, saved in results.items()]
    return [
        "",
        "(* with GUARD = TRUE a sample that is not finite holds the last u and all states *)",
        *_condition(f"IF NOT {GUARD} OR", inputs),
        *(INDENT + line if line else "" for line in [*keep, *statements]),
        *(INDENT + line for line in _condition(f"IF {GUARD} AND NOT", list(results))),
        *(INDENT + line for line in [*back, "END_IF;"]),
        "END_IF;",
    ]


def _condition(start: str, names: Sequence[str]) -> list[str]:
    """A condition that all numbers are finite: no comparison holds for what is not a number."""
    tests = finite_conditions(names)
    lines = [f"{INDENT}{test} AND" for test in tests[:-1]]
    return [f"{start} (", *lines, f"{INDENT}{tests[-1]}) THEN"]


def finite_conditions(names: Sequence[str]) -> list[str]:
    """One condition per number: TRUE for those that are finite."""
    number = st_literal(LARGEST_LREAL)
    return [f"({name} >= -{number}) AND ({name} <= {number})" for name in names] or ["TRUE"]

"""A system file with another law: everything else, and its comments, stay as the user wrote it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from certrack.core.errors import one_line
from certrack.systems.writer import to_text, toml_table

if TYPE_CHECKING:
    from certrack.systems.system import System


def with_law(text: str, system: System, remarks: Sequence[str] = ()) -> str:
    """The text of a system file with the law of `system` in the place of its own.

    Parameters
    ----------
    text : str
        Of a file that loads; the whole system is written if it is empty.
    system : System
        The file's system with another law.
    remarks : texts
        Written as comments above the table of the law.

    Returns
    -------
    str
    """
    import tomlkit

    document = tomlkit.parse(text if text.strip() else to_text(system))
    table = tomlkit.table()
    for remark in remarks:
        table.add(tomlkit.comment(one_line(remark)))
    for key, value in law_entries(system).items():
        table.add(key, value)
    table.add(tomlkit.nl())
    document["law"] = table
    if system.settings.estimates is None:
        simulation: Any = document["simulation"]
        simulation.pop("estimates", None)
    return tomlkit.dumps(document)


def law_entries(system: System) -> dict[str, Any]:
    """The keys and values of the table ``[law]``."""
    return toml_table(system.law)

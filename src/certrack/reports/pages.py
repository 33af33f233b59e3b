"""A dossier as a page (HTML), as a print of it (PDF), or as tables for papers."""

from __future__ import annotations

import base64
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from certrack.core.errors import InputError, MissingExtra
from certrack.core.files import require_place, write_bytes, write_text
from certrack.core.version import __version__
from certrack.reports.dossier import Dossier
from certrack.reports.formula_pictures import formula_svgs
from certrack.reports.tables import Table

if TYPE_CHECKING:
    import jinja2

#: What a dossier can be written as, by the ending of the file.
ENDINGS = (".html", ".pdf", ".md", ".tex")


def require_writable(path: str | os.PathLike[str]) -> None:
    """Refuse, before anything is computed, what :func:`save_dossier` would refuse.

    Raises
    ------
    InputError
        If the name has another ending than .html, .pdf, .md and .tex, or there is no such folder.
    MissingExtra
        If a package of the extra ``report`` is needed and not installed.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        problem = f"must end with one of {', '.join(ENDINGS)}"
        raise InputError("--out", problem, str(path), "Such as report.html")
    require_place(Path(path))
    if ending in (".html", ".pdf"):
        _environment()
    if ending == ".pdf":
        _printer()


def save_dossier(dossier: Dossier, path: str | os.PathLike[str]) -> None:
    """Write a dossier in the format that the ending of the file's name tells.

    Parameters
    ----------
    dossier : Dossier
    path : path
        ``.html``: one page that needs no other file; ``.pdf``: a print of it; ``.md`` and
        ``.tex``: sentences and tables, and tables alone.

    Returns
    -------
    None

    Raises
    ------
    InputError
        If the ending is another one, or the file cannot be written.
    MissingExtra
        If a package of the extra ``report`` is needed and not installed.

    Examples
    --------
    >>> import certrack
    >>> system = certrack.load("dual-motor-lean")
    >>> dossier = certrack.dossier(system, without=["falsification", "ensemble", "margins"])
    >>> certrack.save_dossier(dossier, "report.md")
    """
    require_writable(path)
    ending = Path(path).suffix.lower()
    if ending == ".pdf":
        write_bytes(Path(path), to_pdf(dossier))
    else:
        write = {".html": to_html, ".md": to_markdown, ".tex": to_latex}[ending]
        write_text(Path(path), write(dossier))


def to_html(dossier: Dossier) -> str:
    """The dossier as one page that needs no other file, no network and no script.

    Parameters
    ----------
    dossier : Dossier

    Returns
    -------
    str

    Raises
    ------
    MissingExtra
        If Jinja2 is not installed.
    """
    page = _environment().get_template("dossier.html")
    return page.render(dossier=dossier, version=__version__)


def to_pdf(dossier: Dossier) -> bytes:
    """The page, printed."""
    printed: bytes = _printer().HTML(string=to_html(dossier)).write_pdf()
    return printed


def _printer() -> Any:
    try:
        import weasyprint
    except (ImportError, OSError):  # OSError: without Pango, the system's library for text
        raise MissingExtra("WeasyPrint, or its Pango,", "report", "a dossier as PDF") from None
    return weasyprint


def to_markdown(dossier: Dossier) -> str:
    """The sentences and tables of a dossier as Markdown, without its pictures."""
    blocks = [f"# {_plain(dossier.title)}", *map(_plain, dossier.summary)]
    for section in dossier.sections:
        blocks += [f"## {section.title}", *map(_plain, section.lines)]
        blocks += [f"    {formula.text}" for formula in section.formulas]
        blocks += [_markdown_table(entry) for entry in section.tables]
    return "\n\n".join(blocks) + "\n"


#: What Markdown takes for marks within a line, and HTML for tags; one _ within a word is none.
MARKDOWN_MARKS = re.compile(r"[\\`*<\[\]#~|]|(?<!\w)_|_(?!\w)")


def _plain(text: str) -> str:
    """Text that Markdown shows as it is."""
    return MARKDOWN_MARKS.sub(lambda mark: "\\" + mark[0], text)


def _markdown_table(entry: Table) -> str:
    def row(cells: tuple[str, ...]) -> str:
        return f"| {' | '.join(map(_plain, cells))} |"

    rule = "|" + " --- |" * len(entry.columns)
    lines = [row(entry.columns), rule, *map(row, entry.rows)]
    return "\n".join([f"**{entry.title}**\n", *lines] if entry.title else lines)


def to_latex(dossier: Dossier) -> str:
    """The tables of a dossier as LaTeX that needs no package."""
    import pandas

    from certrack.core.latex import latex_table

    parts = []
    for section in dossier.sections:
        for entry in section.tables:
            first, *others = entry.columns
            frame = pandas.DataFrame(
                [row[1:] for row in entry.rows],
                index=pandas.Index([row[0] for row in entry.rows], name=first),
                columns=others,
                dtype=object,
            )
            parts.append(latex_table(frame, caption=entry.title or section.title))
    return "\n".join(parts)


def _environment() -> jinja2.Environment:
    try:
        import jinja2
    except ImportError:
        raise MissingExtra("Jinja2", "report", "a dossier as a page") from None
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("certrack.reports"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {
        "data_url": _data_url,
        "formula": _formula_urls,
        "numbers": _columns_of_numbers,
    }
    return environment


def _data_url(content: str, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content.encode()).decode()}"


def _formula_urls(latex: str) -> list[str]:
    return [_data_url(svg, "image/svg+xml") for svg in formula_svgs(latex)]


#: A number as tables show it; a dash stands for none.
NUMBER = re.compile(r"[<>]? ?[-+]{0,2}\d[\d.]*(e-?\d+)?( %)?|-")


def _columns_of_numbers(entry: Table) -> list[bool]:
    """Which columns hold numbers only, and stand to the right."""
    columns = list(zip(*entry.rows, strict=True))
    return [
        all(map(NUMBER.fullmatch, column)) and any(cell != "-" for cell in column)
        for column in columns
    ] or [False] * len(entry.columns)

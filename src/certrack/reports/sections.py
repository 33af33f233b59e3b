"""What a dossier consists of: sections of sentences, formulas, tables and pictures."""

from __future__ import annotations

from dataclasses import dataclass

from certrack.reports.tables import Table


@dataclass(frozen=True)
class Picture:
    """A picture, as SVG.

    Attributes
    ----------
    name : str
        As the command line names the file of it.
    caption : str
    svg : str
    """

    name: str
    caption: str
    svg: str


@dataclass(frozen=True)
class ShownFormula:
    """A formula.

    Attributes
    ----------
    latex, text : str
    """

    latex: str
    text: str


@dataclass(frozen=True)
class Attachment:
    """A file that the dossier carries.

    Attributes
    ----------
    name : str
    kind : str
        Its media type.
    content : str
    sha256 : str
        Of the content.
    """

    name: str
    kind: str
    content: str
    sha256: str


@dataclass(frozen=True)
class Section:
    """One question about a design, and what was found.

    Attributes
    ----------
    key : str
        By which it is left out, and linked to.
    title : str
    lines : texts
        A paragraph each.
    formulas : sequence of ShownFormula
    tables : sequence of Table
    pictures : sequence of Picture
    attachments : sequence of Attachment
    code : str
        A text that is shown as it is.
    """

    key: str
    title: str
    lines: tuple[str, ...] = ()
    formulas: tuple[ShownFormula, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    attachments: tuple[Attachment, ...] = ()
    code: str = ""

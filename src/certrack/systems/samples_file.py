"""Samples of a reference from a CSV file, as drives, spreadsheets and oscilloscopes write it.

The separator (comma, semicolon, tab, blanks) and the decimal mark are found in the file, a byte
order mark and lines without a number at its top are skipped, two of many columns are chosen by
their names, and whatever cannot be read is named by its row and cell.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from certrack.core.errors import InputError
from certrack.references.samples import TIME_UNITS

#: Separators in the order in which they are tried; None stands for blanks.
SEPARATORS = (";", "\t", ",", None)

#: Rows by which a separator is chosen, and rows of names and units that may stand at the top.
TRIED_ROWS, MAX_HEADER_ROWS = 20, 40

#: Samples that last longer than so many runs are in another unit than seconds, or so it seems.
MANY_RUNS = 10.0

#: Byte order marks and what they say.
ENCODINGS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.I)

_THOUSANDS = re.compile(r"[+-]?\d{1,3}([., ']\d{3})+([.,]\d+)?")

#: What a spreadsheet writes above the rows to name the separator.
_SEPARATOR_LINE = re.compile(r"sep=(.)", re.I)

KEY = "reference.file"
COLUMNS = "must have two columns of numbers: time, y_d"


@dataclass(frozen=True)
class SamplesFile:
    """What stands in the file.

    Attributes
    ----------
    times, values : numbers
    rows : whole numbers
        The row of the file, from 1, in which each sample stands.
    header : str
        The last row without a number above the samples; empty if there is none.
    """

    times: list[float]
    values: list[float]
    rows: list[int]
    header: str


def read_samples(name: str, data: bytes, columns: Sequence[str] | None = None) -> SamplesFile:
    """Two columns of numbers from the bytes of a file.

    Parameters
    ----------
    name : str
        What messages call the file.
    data : bytes
    columns : two texts, optional
        Of time and y_d: names in the header, or numbers from 1; the only two if left out.

    Raises
    ------
    InputError
        It names the row and the cell that cannot be read.
    """
    lines = [(i, line.split("#")[0].strip()) for i, line in enumerate(_lines(name, data), 1)]
    lines = [(i, line) for i, line in lines if line]
    stated = ""
    if lines and (match := _SEPARATOR_LINE.fullmatch(lines[0][1])):
        stated, lines = match[1], lines[1:]
    header = ""
    for _ in range(MAX_HEADER_ROWS):
        if lines and not any(map(_is_number, re.split(r"[;,\s]+", lines[0][1]))):
            header = lines.pop(0)[1]
    if not lines:
        raise InputError(KEY, COLUMNS, f"no sample in {name}")
    tried = [line for _, line in lines[:TRIED_ROWS]]
    separator = stated or _separator(tried, 2 if columns is None else None)
    heads = _cells(header, separator)
    places = _places(name, columns, heads)
    chosen = [
        (row, _chosen(name, row, line, separator, places if columns else None))
        for row, line in lines
    ]
    text = " ".join(cell for _, cells in chosen for cell in cells)
    comma = "," in text and "." not in text
    first, second = (
        [_number(name, row, place + 1, cells[i], comma) for row, cells in chosen]
        for i, place in enumerate(places)
    )
    names = [heads[i] if i < len(heads) else "" for i in places]
    return SamplesFile(
        first,
        second,
        [row for row, _ in lines],
        ";".join(names) if any(names) else header,
    )


def _places(name: str, columns: Sequence[str] | None, heads: Sequence[str]) -> tuple[int, int]:
    """Where time and y_d stand, from 0."""
    if columns is None:
        return 0, 1
    if len(columns) != 2:
        raise InputError("reference.columns", "must be two: of time and of y_d", list(columns))
    places = []
    for i, wanted in enumerate(columns):
        matching = [k for k, head in enumerate(heads) if wanted in (head, _without_unit(head))]
        if not matching and wanted.isdecimal() and int(wanted) >= 1:
            matching = [int(wanted) - 1]
        if len(matching) != 1:
            what = f"must be the name of a column of {name}, or its number from 1"
            names = f"Its columns: {', '.join(heads)}" if any(heads) else "It has no names"
            raise InputError(f"reference.columns[{i}]", what, wanted, names)
        places.append(matching[0])
    if places[0] == places[1]:
        what = "must be another column than that of time"
        raise InputError("reference.columns[1]", what, columns[1])
    return places[0], places[1]


def _without_unit(head: str) -> str:
    return re.sub(r"\s*[\[(].*[\])]\s*$", "", head)


def _chosen(
    name: str, row: int, line: str, separator: str | None, places: tuple[int, int] | None
) -> Sequence[str]:
    """The two cells of a row, or those at the places."""
    cells = _cells(line, separator)
    if places is None and len(cells) == 2:
        return cells
    count = f"{len(cells)} cell{'s' * (len(cells) != 1)}"
    if places is None:
        what = f"row {row} of {name}: {COLUMNS}"
        remedy = 'Keep these two columns, or state columns = ["1", "2"] beside file'
        raise InputError(KEY, what, f"{count}: {line}", remedy)
    if max(places) >= len(cells):
        what = f"row {row} of {name}: has no cell {max(places) + 1}"
        raise InputError(KEY, what, f"{count}: {line}")
    return cells[places[0]], cells[places[1]]


def check_time_unit(name: str, samples: SamplesFile, duration: float) -> None:
    """Refuse times that seem to be in another unit than seconds, where no unit is stated."""
    unit = _unit_in(samples.header)
    if unit not in ("", "s"):
        what = f"the header of {name} says that times are in {unit}"
        raise InputError(KEY, what, samples.header, f'State time_unit = "{unit}" beside file')
    last = samples.times[-1]
    if not math.isfinite(last) or last <= MANY_RUNS * duration:
        return
    unit = next((u for u, size in TIME_UNITS.items() if last * size <= duration), "ms")
    what = (
        f"row {samples.rows[-1]}, cell 1 of {name}: samples that last {last / duration:.3g} times "
        f"simulation.duration seem to be in another unit than s"
    )
    remedy = f'State time_unit = "{unit}" beside file, or "s" if they are right'
    raise InputError(KEY, what, f"{last:g} for a run of {duration:g} s", remedy)


def _lines(name: str, data: bytes) -> list[str]:
    encoding = next((e for mark, e in ENCODINGS.items() if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as problem:
        row = data[: problem.start].count(b"\n") + 1
        what = f"row {row} of {name}: is not text in UTF-8"
        raise InputError(KEY, what, remedy="Save it as CSV in UTF-8") from None
    if "\0" in text:
        what = f"row 1 of {name}: is not text in UTF-8"
        raise InputError(KEY, what, remedy="Save it as CSV in UTF-8")
    text = text.replace("\N{MINUS SIGN}", "-").replace("\N{NO-BREAK SPACE}", " ")
    return re.split(r"\r\n|\r|\n", text)


def _separator(lines: Sequence[str], count: int | None) -> str | None:
    """The one that makes as many numbers as wanted, or as can be, of most rows."""

    def fitting(separator: str | None) -> int:
        rows = [_cells(line, separator) for line in lines]
        full = [row for row in rows if len(row) >= 2 and all(map(_is_number, row))]
        return sum(1 if count else len(row) for row in full if count in (None, len(row)))

    best = max(SEPARATORS, key=fitting)
    if fitting(best):
        return best
    return next((s for s in SEPARATORS if s is None or any(s in line for line in lines)), None)


def _cells(line: str, separator: str | None) -> list[str]:
    if separator is None or '"' not in line:
        parts = line.split(separator)
    else:
        parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    cells = [cell.strip().strip("\"'").strip() for cell in parts]
    return cells[:-1] if len(cells) > 2 and not cells[-1] else cells


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell.strip("\"'")) is not None


def _number(name: str, row: int, cell: int, text: str, comma: bool) -> float:
    if _is_number(text) and (comma or "," not in text):
        return float(text.replace(",", "."))
    what = f"row {row}, cell {cell} of {name}: must be a number"
    remedy = "Use one decimal mark in all of the file" if _is_number(text) else ""
    if not remedy and _THOUSANDS.fullmatch(text):
        remedy = "Write numbers without marks of thousands"
    raise InputError(KEY, what, text or "an empty cell", remedy)


def _unit_in(header: str) -> str:
    """The unit of time that a header names for its first column; empty if it names none."""
    first = re.split(r"[;,\t]", header)[0].lower()
    words = re.findall(r"[a-zµμ]+", first)
    known = {**{unit: unit for unit in TIME_UNITS}, "µs": "us", "μs": "us"}
    known |= {"sec": "s", "seconds": "s", "msec": "ms", "milliseconds": "ms", "minutes": "min"}
    return next((known[word] for word in words if word in known), "")

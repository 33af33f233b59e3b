"""Samples of a reference from a CSV file, as drives, spreadsheets and oscilloscopes write it.

The separator (comma, semicolon, tab, blanks) and the decimal mark are found in the file, a byte
order mark and lines without a number at its top are skipped, and whatever cannot be read is named
by its row and cell.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from certrack.core.errors import InputError
from certrack.references.samples import TIME_UNITS

#: Separators in the order in which they are tried; None stands for blanks.
SEPARATORS = (";", "\t", ",", None)

#: Rows by which a separator is chosen, and rows of names and units that may stand at the top.
TRIED_ROWS, MAX_HEADER_ROWS = 20, 5

#: Samples that last longer than so many runs are in another unit than seconds, or so it seems.
MANY_RUNS = 10.0

#: Byte order marks and what they say.
ENCODINGS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.I)

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


def read_samples(name: str, data: bytes) -> SamplesFile:
    """Two columns of numbers from the bytes of a file.

    Parameters
    ----------
    name : str
        What messages call the file.
    data : bytes

    Raises
    ------
    InputError
        It names the row and the cell that cannot be read.
    """
    lines = [(i, line.split("#")[0].strip()) for i, line in enumerate(_lines(name, data), 1)]
    lines = [(i, line) for i, line in lines if line]
    header = ""
    for _ in range(MAX_HEADER_ROWS):
        if lines and not any(map(_is_number, re.split(r"[;,\s]+", lines[0][1]))):
            header = lines.pop(0)[1]
    if not lines:
        raise InputError(KEY, COLUMNS, f"no sample in {name}")
    separator = _separator([line for _, line in lines[:TRIED_ROWS]])
    text = " ".join(line for _, line in lines)
    comma = separator != "," and "," in text and "." not in text
    times, values = [], []
    for row, line in lines:
        cells = _cells(line, separator)
        if len(cells) != 2:
            count = f"{len(cells)} cell{'s' * (len(cells) != 1)}"
            what = f"row {row} of {name}: {COLUMNS}"
            raise InputError(KEY, what, f"{count}: {line}", "Keep these two columns")
        numbers = [_number(name, row, i, cell, comma) for i, cell in enumerate(cells, 1)]
        times.append(numbers[0])
        values.append(numbers[1])
    return SamplesFile(times, values, [row for row, _ in lines], header)


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
    return re.split(r"\r\n|\r|\n", text)


def _separator(lines: Sequence[str]) -> str | None:
    """The one that makes two numbers of most rows."""

    def fitting(separator: str | None) -> int:
        rows = (_cells(line, separator) for line in lines)
        return sum(len(row) == 2 and all(map(_is_number, row)) for row in rows)

    best = max(SEPARATORS, key=fitting)
    if fitting(best):
        return best
    return next((s for s in SEPARATORS if s is None or any(s in line for line in lines)), None)


def _cells(line: str, separator: str | None) -> list[str]:
    cells = [cell.strip().strip("\"'").strip() for cell in line.split(separator)]
    return cells[:-1] if len(cells) > 2 and not cells[-1] else cells


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell.strip("\"'")) is not None


def _number(name: str, row: int, cell: int, text: str, comma: bool) -> float:
    if _is_number(text) and (comma or "," not in text):
        return float(text.replace(",", "."))
    what = f"row {row}, cell {cell} of {name}: must be a number"
    remedy = "Use one decimal mark in all of the file" if _is_number(text) else ""
    raise InputError(KEY, what, text or "an empty cell", remedy)


def _unit_in(header: str) -> str:
    """The unit of time that a header names for its first column; empty if it names none."""
    first = re.split(r"[;,\t]", header)[0].lower()
    words = re.findall(r"[a-zµμ]+", first)
    known = {**{unit: unit for unit in TIME_UNITS}, "µs": "us", "μs": "us"}
    known |= {"sec": "s", "seconds": "s", "msec": "ms", "milliseconds": "ms", "minutes": "min"}
    return next((known[word] for word in words if word in known), "")

"""The figures of docs/comparison-of-laws.md, computed anew by the commands that the page names.

    python tools/laws_page.py            what the page says against what the commands say
    python tools/laws_page.py --write    tables and pictures of the page written anew
    python tools/laws_page.py example1   one of the systems

The gains are in docs/laws, as the searches wrote them; here every law is simulated, certified and
measured with them. `make docs` runs the first form, and stops where a number of the page is not
what comes out. Pictures come to build/laws.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from certrack.core.rounding import printed_bound
from certrack.reports.tables import short_number

ROOT = Path(__file__).parents[1]
PAGE, BUILD = ROOT / "docs" / "comparison-of-laws.md", ROOT / "build" / "laws"

#: Another machine rounds differently: a number of the page may differ by this part, and by a unit
#: of its last digit.
TOLERANCE = 0.03

#: Where a limit that is not kept shows in a row.
COLUMN_OF_LIMIT = {"peak input": 4, "variation of input": 6, "period": 7}

#: Of a picture in the repository, which stays small.
PICTURE_COLOURS = 64

#: Signs of the tables.
MINUS, NONE = "\N{MINUS SIGN}", "\N{EN DASH}"

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")


@dataclass(frozen=True)
class Section:
    """One system of the page.

    Attributes
    ----------
    name : str
        Of its section, and of the files with its gains.
    file : str
        What `certrack compare` gets.
    scale : float
        From the output's unit to that of the errors in the table.
    """

    name: str
    file: str
    scale: float = 1.0

    @property
    def files(self) -> tuple[str, ...]:
        """Files of gains."""
        return (f"docs/laws/{self.name}.json",)

    def command(self, gains: str) -> list[str]:
        """What is run."""
        return ["certrack", "compare", self.file, "--gains", gains]

    @property
    def marks(self) -> tuple[str, str]:
        """Lines of the page around what is written here."""
        return f"<!-- laws: {self.name}, by tools/laws_page.py -->", f"<!-- end of {self.name} -->"


SECTIONS = (
    Section("dual-motor", "dual-motor-lean"),
    Section("example1", "example1"),
    Section("friction-axis", "tests/data/friction-axis.toml", 1e3),
)


def measured(section: Section, gains: str, pictures: Path | None) -> dict[str, Any]:
    """Run a command of the page in the root of the repository, and read what it says."""
    program = str(Path(sys.executable).with_name("certrack"))
    drawn = [] if pictures is None else ["--plot", str(pictures)]
    arguments = [*section.command(gains)[1:], "--json", *drawn]
    done = subprocess.run([program, *arguments], cwd=ROOT, stdout=subprocess.PIPE, check=True)
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def written(section: Section, results: list[dict[str, Any]]) -> str:
    """The section of the page: limits, figures, gains."""
    return "\n".join(_lines(section, results))


def _lines(section: Section, results: list[dict[str, Any]]) -> Iterator[str]:
    limits = results[0]["limits"]
    yield (
        f"Limits: peak {limits['peak_input']:.4g}, variation {limits['input_variation']:.4g}, "
        f"period {1e3 * limits['period']:.4g} ms. A figure in bold exceeds its limit."
    )
    yield ""
    yield (
        "| law | tail error | worst member | settles [s] | peak | energy | variation | "
        f"longest period [ms] | gain {MINUS}30 % | gain +30 % | certified |"
    )
    yield "|---|" + "--:|" * 10
    rows = list(_laws(results))
    for name, figures, members in rows:
        yield _row(name, figures, members, section.scale)
    yield ""
    yield "| law | evaluations | gains |"
    yield "|---|--:|---|"
    for name, figures, _ in rows:
        gains = ", ".join(f"{key} = {_gain(value)}" for key, value in figures["gains"].items())
        yield f"| {name} | {figures.get('evaluations') or NONE} | {gains} |"


def _laws(results: list[dict[str, Any]]) -> Iterator[tuple[str, dict[str, Any], int]]:
    """Name, figures and members of every law; that of the file once."""
    for i, result in enumerate(results):
        for j, (name, figures) in enumerate(result["laws"].items()):
            if i == 0 or j > 0:
                yield name, figures, result["members"]


def _row(name: str, figures: dict[str, Any], members: int, scale: float) -> str:
    """The figures of one law."""
    label = name if members == 1000 else f"{name} ({members} members)"
    if "note" in figures:
        return f"| {label} | {figures['note']} |" + "  |" * 9
    cells = [
        label,
        _number(figures["tail_error"], scale),
        _number(figures["worst_member"], scale),
        _number(figures["settling_time"]),
        _number(figures["peak_input"]),
        _number(figures["energy"]),
        _number(figures["input_variation"]),
        _number(figures["longest_period"], 1e3),
        *(_number(value, scale) for value in figures["at_gains"].values()),
        _bound(figures["bound"], scale),
    ]
    for limit in figures["exceeded"]:
        i = COLUMN_OF_LIMIT[limit]
        cells[i] = f"**{cells[i]}**"
    return "| " + " | ".join(cells) + " |"


def _number(value: float | None, scale: float = 1.0) -> str:
    """Three digits; what is infinite or missing is lost."""
    if value is None or not math.isfinite(value):
        return "lost"
    return short_number(float(f"{scale * value:.3g}"), 4)


def _bound(value: float | None, scale: float) -> str:
    """A certified error, rounded up."""
    if value is None or not math.isfinite(value):
        return NONE
    scaled = value if scale == 1 else math.nextafter(scale * value, math.inf)
    return printed_bound(scaled, 4)


def _gain(value: Any) -> str:
    """A gain as a file says it; a table of equal numbers by one of them."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_gain(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        flat = [w for v in value for w in (v if isinstance(v, list) else [v])]
        if len(flat) > 2 and len(set(flat)) == 1:
            return f"all {_gain(flat[0])}"
        return f"[{', '.join(map(_gain, value))}]"
    return short_number(value, 6) if isinstance(value, (int, float)) else str(value)


def differences(old: str, new: str) -> list[str]:
    """Lines of the page that are not what was computed, beside that; empty if all are."""
    before, after = old.strip().splitlines(), new.strip().splitlines()
    if len(before) != len(after):
        return [f"{len(before)} lines in the page, {len(after)} computed"]
    pairs = zip(before, after, strict=True)
    return [f"page     {a}\ncomputed {b}" for a, b in pairs if not _agree(a, b)]


def _agree(old: str, new: str) -> bool:
    """Whether two lines have the same words, and nearly the same numbers."""
    if _NUMBER.sub("#", old) != _NUMBER.sub("#", new):
        return False
    pairs = zip(_NUMBER.findall(old), _NUMBER.findall(new), strict=True)
    return all(
        abs(float(a) - float(b)) <= TOLERANCE * abs(float(b)) + max(_unit(a), _unit(b))
        for a, b in pairs
    )


def _unit(text: str) -> float:
    """A unit of the last digit; nothing of a whole number."""
    mantissa, _, exponent = text.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals)) if decimals else 0.0


def section_of(page: str, section: Section) -> str:
    """What the page has between the marks of a section."""
    begin, end = section.marks
    if page.count(begin) != 1 or page.count(end) != 1:
        raise SystemExit(f"{PAGE.name}: must have the lines {begin} and {end} once")
    return page.partition(begin)[2].partition(end)[0]


def main() -> None:
    """Compute, and compare or write."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("sections", nargs="*", metavar="SECTION", help="all if left out")
    parser.add_argument("--write", action="store_true", help="write the page and its pictures")
    options = parser.parse_args()
    names = [section.name for section in SECTIONS]
    if not set(options.sections) <= set(names):
        parser.error(f"sections are {', '.join(names)}")
    wrong: list[str] = []
    for section in SECTIONS:
        if options.sections and section.name not in options.sections:
            continue
        files = section.files
        folders = [BUILD / Path(file).stem if options.write else None for file in files]
        pairs = zip(files, folders, strict=True)
        new = written(section, [measured(section, *pair) for pair in pairs])
        page = PAGE.read_text("utf-8")
        old = section_of(page, section)
        if options.write:
            begin, end = section.marks
            PAGE.write_text(page.replace(begin + old + end, f"{begin}\n\n{new}\n\n{end}"), "utf-8")
            (picture,) = (BUILD / section.name).glob("*.png")
            small = Image.open(picture).convert("RGB").quantize(PICTURE_COLOURS)
            target = ROOT / "docs" / "pictures" / f"laws-{section.name}.png"
            small.save(target, optimize=True)
            continue
        for gains in files:
            command = " ".join(section.command(gains))
            if f"`{command}`" not in page:
                wrong.append(f"the page does not name the command: {command}")
        wrong += differences(old, new)
    if wrong:
        raise SystemExit("\n".join([f"{PAGE.relative_to(ROOT)} is not what comes out:", *wrong]))


if __name__ == "__main__":
    main()

"""Formulas as pictures: LaTeX to SVG, which every browser and every printer shows alike."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser

#: Size of the letters, in points.
FORMULA_SIZE = 12.0

#: Points of an inch.
POINTS_PER_INCH = 72

#: A line is broken before a sign where it would get wider, in points: that of a printed page.
WIDEST_LINE = 460.0

#: Letters as outlines: no font is needed, and the same formula gives the same text.
OUTLINES: dict[Any, Any] = {
    "svg.fonttype": "path",
    "svg.hashsalt": "certrack",
    "mathtext.fontset": "cm",
}


def formula_svgs(latex: str) -> list[str]:
    """The lines of a formula, as SVG each."""
    return [_svg(line) for line in broken(latex)]


def broken(latex: str, widest: float = WIDEST_LINE) -> list[str]:
    r"""A wide formula in lines; each but the first begins with a sign of the outermost sum.

    >>> broken(r"y = a + \frac{b + c}{d} - e", 50)
    ['y = a', '\\quad + \\frac{b + c}{d}', '\\quad - e']
    """
    first, *others = _terms(latex)
    lines = [first]
    for term in others:
        if _extent(lines[-1] + term)[0] > widest:
            lines.append(rf"\quad {term}")
        else:
            lines[-1] += term
    return [line.strip() for line in lines]


def _terms(latex: str) -> list[str]:
    """The formula, cut before each sign that stands in no bracket and joins two terms."""
    terms, depth, begin = [], 0, 0
    for i, letter in enumerate(latex):
        depth += (letter in "{(") - (letter in "})")
        joins = latex[i : i + 2] in ("+ ", "- ") and latex[i - 2 : i] not in ("= ", "")
        if depth == 0 and i > begin and joins:
            terms.append(latex[begin:i])
            begin = i
    return [*terms, latex[begin:]]


def _extent(line: str) -> tuple[float, float, float]:
    """Width, height and depth of a line, in points."""
    with matplotlib.rc_context(OUTLINES):
        letters = FontProperties(size=FORMULA_SIZE)
        width, height, depth, *_ = MathTextParser("path").parse(
            f"${line}$", POINTS_PER_INCH, letters
        )
    return width, height, depth


def _svg(line: str) -> str:
    width, height, depth = _extent(line)
    buffer = io.BytesIO()
    with matplotlib.rc_context(OUTLINES):
        drawing = Figure((width / POINTS_PER_INCH, height / POINTS_PER_INCH))
        drawing.text(0, depth / height, f"${line}$", size=FORMULA_SIZE)
        drawing.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    return buffer.getvalue().decode()

"""Tables as LaTeX: any data frame as text that compiles without further packages."""

from __future__ import annotations

import math
import numbers
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas

#: What LaTeX takes for commands, and how it is written instead.
LATEX_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "^": r"\textasciicircum{}",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "%": r"\%",
    "<": r"$<$",
    ">": r"$>$",
    "|": r"$|$",
    '"': r"\textquotedbl{}",
}

#: Numbers outside of these magnitudes are written as powers of ten.
SMALLEST_PLAIN, LARGEST_PLAIN = 1e-3, 1e5


def latex_text(text: str) -> str:
    """Text as LaTeX shows it; what is no ASCII stays as it is."""
    return "".join(LATEX_SPECIAL.get(char, char) for char in text if char.isprintable())


def latex_number(value: Any, digits: int = 3) -> str:
    """A number with so many significant digits; a dash where it is none."""
    if isinstance(value, (bool, numbers.Integral)) or not isinstance(value, numbers.Real):
        return latex_text(str(value))
    number = float(value)
    if math.isnan(number):
        return "--"
    if math.isinf(number):
        return r"$-\infty$" if number < 0 else r"$\infty$"
    if number and not SMALLEST_PLAIN <= abs(number) < LARGEST_PLAIN:
        mantissa, exponent = f"{number:.{digits - 1}e}".split("e")
        return rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"
    text = f"{number:#.{digits}g}".rstrip(".")
    if "e" in text:
        text = f"{number:.0f}"
    return f"${text}$"


def latex_table(
    frame: pandas.DataFrame, *, caption: str = "", label: str = "", digits: int = 3
) -> str:
    """A data frame as a LaTeX table.

    Needs no package: rules are ``\\hline``. With a caption it is a floating ``table``.

    Parameters
    ----------
    frame : pandas.DataFrame
        Its index is the first column; numbers stand to the right, texts to the left.
    caption, label : str, optional
    digits : int
        Significant digits of numbers.

    Returns
    -------
    str

    Examples
    --------
    >>> import pandas
    >>> from certrack import latex_table
    >>> frame = pandas.DataFrame({"tail_error": [0.01234]}, index=["adaptive"])
    >>> print(latex_table(frame))
    \\begin{tabular}{lr}
    \\hline
     & tail\\_error \\\\
    \\hline
    adaptive & $0.0123$ \\\\
    \\hline
    \\end{tabular}
    <BLANKLINE>
    """
    columns = list(frame.columns)
    is_number = [frame[name].dtype.kind in "fiub" for name in columns]
    kinds = "l" + "".join("r" if number else "l" for number in is_number)
    heading = [latex_text(str(frame.index.name or "")), *(latex_text(_joined(c)) for c in columns)]
    rows = [
        [latex_text(_joined(index)), *(latex_number(value, digits) for value in row)]
        for index, row in zip(frame.index, frame.itertuples(index=False), strict=True)
    ]
    lines = [
        rf"\begin{{tabular}}{{{kinds}}}",
        r"\hline",
        rf"{' & '.join(heading)} \\",
        r"\hline",
        *(rf"{' & '.join(row)} \\" for row in rows),
        r"\hline",
        r"\end{tabular}",
    ]
    if caption or label:
        names = [rf"\caption{{{latex_text(caption)}}}"] if caption else []
        names += [rf"\label{{{re.sub('[^A-Za-z0-9:._-]', '-', label)}}}"] if label else []
        lines = [r"\begin{table}", r"\centering", *names, *lines, r"\end{table}"]
    return "\n".join(lines) + "\n"


def _joined(name: Any) -> str:
    """A heading of one or several levels."""
    return ", ".join(map(str, name)) if isinstance(name, tuple) else str(name)

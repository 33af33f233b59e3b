"""The optional guard of exported C: a sample that is not finite leaves no trace."""

from __future__ import annotations

from certrack.export.c.printer import wrapped
from certrack.export.c.source import CCode
from certrack.export.program import read_symbols
from certrack.export.templates import fill_template

#: The largest finite number of a type, in <float.h>.
LARGEST_NUMBERS = {"double": "DBL_MAX", "float": "FLT_MAX"}


def guard_header(code: CCode) -> str:
    """Contents of NAME_guard.h."""
    program, name = code.program, code.name
    read = read_symbols(program)
    inputs = [f"x[{i}]" for i, symbol in enumerate(program.measured) if symbol in read]
    inputs += [f"y_d[{i}]" for i, symbol in enumerate(program.Y) if symbol in read]
    results = ["u", *(f"next.{member}" for member in code.members if program.states)]
    unused = [
        f"    (void){argument};\n"
        for argument in ("x", "y_d")
        if not any(text.startswith(f"{argument}[") for text in inputs)
    ]
    return fill_template(
        "c/templates/controller_guard.h",
        name=name,
        guard=f"{name.upper()}_GUARD_H",
        parameters=code.parameter_argument,
        p="p, " if program.parameters else "",
        largest=LARGEST_NUMBERS[code.real],
        inputs=_all_finite(inputs),
        unused="".join(unused),
        results=_all_finite(results),
    )


def _all_finite(values: list[str]) -> str:
    """The condition: no comparison holds for what is not a number."""
    tests = [f"(({value} >= -largest) && ({value} <= largest))" for value in values]
    return wrapped(" && ".join(tests or ["true"]), "        ").strip()

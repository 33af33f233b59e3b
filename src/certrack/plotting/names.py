"""Names of states and signals in mathematical type."""

from __future__ import annotations

import re

#: Greek letters as states are named.
GREEK = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda"),
    *("mu", "nu", "xi", "pi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"),
)

#: A letter, marks of derivatives and estimates, an index or a word below it.
_PARTS = re.compile(
    rf"(?P<letter>{'|'.join(GREEK)}|[A-Za-z])(?P<mark>(?:_?(?:ddot|dot|hat))?)"
    r"(?:_?(?P<index>\d+)|_(?P<word>[A-Za-z]\w*?))?(?P<late>(?:_(?:ddot|dot|hat))?)"
)


def math_name(name: str) -> str:
    """A state or estimate name in mathematical type: phi_dot, theta_hat_2, x1, omega_m, v.

    What is no letter with a mark and an index stays as it is: ``speed``.
    """
    parts = _PARTS.fullmatch(name)
    if parts is None:
        return name
    letter = parts["letter"]
    shown = f"\\{letter}" if letter in GREEK else letter
    mark = (parts["mark"] or parts["late"]).strip("_")
    if mark:
        shown = f"\\{mark} {shown}" if len(letter) == 1 else f"\\{mark}{shown}"
    if parts["index"]:
        shown += f"_{{{parts['index']}}}"
    if parts["word"]:
        word = parts["word"].replace("_", "\\_")
        shown += f"_{{\\mathrm{{{word}}}}}" if len(word) > 1 else f"_{{{word}}}"
    return f"${shown}$"

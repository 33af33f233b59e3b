"""The plant and the law of a design as formulas, with their numbers in the paper."""

from __future__ import annotations

from typing import Any

from certrack.app.frames import FrameKind, pack_frame
from certrack.systems.formulas import plant_as_text
from certrack.systems.system import System

#: Numbers of the paper: plant, errors, virtual controls of the first steps and of any, update laws.
PLANT_NUMBER, ERROR_NUMBER, STEP_NUMBERS, ANY_STEP_NUMBER, UPDATE_NUMBER = 5, 6, (9, 13), 18, 26

#: The input of the laws that are the paper's; the robust one knows what the other estimates.
CONTROL_NUMBERS = {"adaptive": "(25)", "robust": "Corollary 1"}


def law_frame(system: System, design: int) -> bytes:
    """What the command line's ``design`` prints, formula by formula.

    Parameters
    ----------
    system : System
    design : int
        Whose gains the numbers are of.
    """
    result = system.design()
    numbers = paper_numbers(system)
    parts = (plant_as_text(system), result.formulas)
    plant, law = ([[text, numbers(text)] for text in formulas] for formulas in parts)
    for row in plant:
        row[1] = f"({PLANT_NUMBER})"
    ends = str(result).splitlines()[len(law) :]
    notes = [line for line in ends if line.startswith(("kappa", "fastest", "margins at u"))]
    if result.coordinates.q and numbers("u = "):
        notes.append("The paper's is that of q = 0: no derivative of y_d in its virtual controls.")
    header: dict[str, Any] = {"plant": plant, "law": law, "notes": notes}
    return pack_frame(FrameKind.LAW, header, design=design)


def paper_numbers(system: System) -> Any:
    """What tells the number of a formula by its left side; of other laws than the paper's none."""
    law = system.law
    differs = (
        law.kind not in CONTROL_NUMBERS
        or getattr(law, "coupling", False)
        or getattr(law, "integral", False)
    )
    n = system.plant.n

    def number(formula: str) -> str:
        left, equals, _ = formula.partition(" = ")
        letter, _, index = left.partition("_")
        if differs or not equals:
            return ""
        if letter == "e" and 1 <= int(index) <= n:
            return f"({ERROR_NUMBER})"
        if letter == "lambda":
            step = int(index)
            return f"({STEP_NUMBERS[step - 1] if step <= len(STEP_NUMBERS) else ANY_STEP_NUMBER})"
        if left in ("u", "nu"):
            return CONTROL_NUMBERS["adaptive"] if left == "nu" else CONTROL_NUMBERS[law.kind]
        return f"({UPDATE_NUMBER})" if left.endswith("'") else ""

    return number

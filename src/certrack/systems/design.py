"""The design of a system: what the recursion and the law give, as numbers and as formulas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from certrack.core.errors import InputError
from certrack.core.notebook import ShownInNotebooks
from certrack.laws.backstepping import ErrorCoordinates
from certrack.systems import formulas
from certrack.systems.optimality import Optimality, optimality

if TYPE_CHECKING:
    from certrack.systems.system import System


#: Said below the formulas of a law whose gains move.
MOVING = "(with the gains of [law]; those of [law.online] are the other end of their motion)"


@dataclass(frozen=True)
class Design(ShownInNotebooks):
    """Result of :func:`design`.

    Attributes
    ----------
    title : str
    kind : str
        Of the law.
    coordinates : ErrorCoordinates
        A, B, kappa, eta, d and the poles of the error system.
    formulas : texts
        Virtual controls, control law and update laws, a line each.
    latex : str
        The same as an ``align*`` environment.
    optimality : Optimality
        The cost that the law minimises, and its gain and phase margins.
    """

    title: str
    kind: str
    coordinates: ErrorCoordinates
    formulas: tuple[str, ...]
    latex: str
    optimality: Optimality

    def summary(self) -> dict[str, Any]:
        """Ready for JSON, but for arrays.

        Returns
        -------
        dict
        """
        coordinates = self.coordinates
        poles = sorted(coordinates.poles, key=lambda pole: (pole.real, pole.imag))
        return {
            "A": coordinates.A,
            "B": coordinates.B if coordinates.q else coordinates.B[:, 0],
            "kappa": coordinates.kappa,
            "eta": coordinates.eta,
            "d": coordinates.d if coordinates.q else coordinates.d[:, 0],
            "R": coordinates.R,
            "nu_x": coordinates.nu_x,
            "nu_Y": coordinates.nu_Y,
            "feedforward": coordinates.q,
            "error_poles": [[pole.real, pole.imag] for pole in poles],
            "law": list(self.formulas),
            "latex": self.latex,
            **self.optimality.record(),
        }

    def __repr__(self) -> str:
        n, q = self.coordinates.n, self.coordinates.q
        return f"Design({self.kind} law, order {n}, feed-forward order {q})"

    def __str__(self) -> str:
        """The formulas, and how fast the error system is."""
        kappa, pole = self.coordinates.kappa, self.coordinates.fastest_pole
        damping = ", ".join(f"{value:.6g}" for value in kappa)
        damped = f"kappa = ({damping}) 1/s; " if self.coordinates.c.any() else ""
        end = f"{damped}fastest error pole {pole:.4g} 1/s"
        return "\n".join([*self.formulas, "", end, *self.optimality.lines()])


def design(system: System) -> Design:
    """The error coordinates, virtual controls and control law of a system.

    Parameters
    ----------
    system : System

    Returns
    -------
    Design

    Examples
    --------
    >>> import certrack
    >>> print(certrack.design(certrack.load("example1-classic")).formulas[0])
    e_1 = x1 - y_d
    """
    if not callable(getattr(system, "design", None)):  # System itself needs this module
        raise InputError("system", "must be a System", system, "certrack.load makes one")
    return Design(
        title=system.title,
        kind=system.law.kind,
        coordinates=system.controller.coordinates,
        formulas=(*formulas.as_text(system), *([MOVING] if system.law.online else [])),
        latex=formulas.as_latex(system),
        optimality=optimality(system),
    )

"""What a control law is: :class:`Law`, its :class:`Equations`, and the :class:`Controller`.

A law is a frozen dataclass of its gains. Its equations are formulas with symbols for every gain, so
one formula serves all gains and is compiled once; beside them it states the numbers that the
symbols stand for.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, check_name, symbol
from certrack.core.keys import check_fields, keyed, keys_of, set_fields
from certrack.core.supported import check_symbols, normal_form
from certrack.laws.backstepping import ErrorCoordinates, Gains
from certrack.laws.equations import Equations
from certrack.laws.error_system import ErrorSystem
from certrack.laws.integral import INTEGRAL
from certrack.laws.observer import Observer
from certrack.laws.online import (
    Online,
    check_online,
    moving_equations,
    online_numbers,
    other_end,
)
from certrack.laws.recursion import recursion
from certrack.laws.signals import Signals
from certrack.model.names import NUMBER_PREFIXES
from certrack.model.plant import MAX_ORDER, Plant


def gain(**description: Any) -> Any:
    """Dataclass field: one number; limits, unit and help as in :class:`certrack.core.keys.Key`."""
    return keyed("number", **description)


def theta_vector(**description: Any) -> Any:
    """Dataclass field: r numbers; zero if left out."""
    shape = "one number per regressor"
    return keyed("numbers", None, shape=shape, otherwise="zero", **description)


def theta_metric(**description: Any) -> Any:
    """Dataclass field: r positive numbers (a diagonal), or a positive definite r x r matrix."""
    shape = "one number per regressor, or a square matrix"
    return keyed("metric", None, shape=shape, above=0, otherwise="identity", **description)


@dataclass(frozen=True)
class Controller:
    """A law designed for one plant: formulas and the numbers in them.

    Attributes
    ----------
    equations : Equations
    signals : Signals
    coordinates : ErrorCoordinates
    values : (P,) array
        Values of :attr:`symbols`.
    start : tuple of float
        Initial values of :attr:`states`, as the law states them.
    law : Law, optional
        Whose it is.
    """

    equations: Equations
    signals: Signals
    coordinates: ErrorCoordinates
    values: np.ndarray
    start: tuple[float, ...] = ()
    law: Law | None = None

    @property
    def states(self) -> tuple[sympy.Symbol, ...]:
        """The controller's own states (estimates)."""
        return tuple(name for name, _ in self.equations.update)

    @cached_property
    def fastest_pole(self) -> float:
        """Largest magnitude of the error system's poles, 1/s: of both ends of gains that move."""
        pole = self.coordinates.fastest_pole
        if self.law is None or self.law.online is None:
            return pole
        return max(pole, other_end(self.law).coordinates(self.signals.plant).fastest_pole)

    @property
    def symbols(self) -> tuple[sympy.Symbol, ...]:
        """Symbols of all gains, in the order of :attr:`values`."""
        return tuple(s for group in self.signals.all_parameters.values() for s in group)

    def values_of(self, names: Sequence[str]) -> np.ndarray:
        """Values of the gains with these names, one after the other.

        They are at hand, unless others are wanted or were asked for since.
        """
        known = tuple(self.signals.all_parameters)
        if tuple(names) == known and len(self.values) == len(self.symbols):
            return self.values
        assert self.law is not None
        return self.law.values(self.signals.plant, names)


@dataclass(frozen=True, kw_only=True)
class Law(ABC):
    """Base of all laws: the gains of the recursion, and what the author of a law owes.

    A new law is a subclass in one file, with the paper's equation beside each line. It must:

    1. be a dataclass with ``frozen=True, kw_only=True`` and a class attribute `kind`, the word that
       names it in a system file;
    2. declare each gain of its own as a field, with :func:`gain`, :func:`theta_vector` or
       :func:`theta_metric`. Every field is a key of the ``[law]`` table; c, k, p and feedforward
       are inherited;
    3. return from :meth:`equations` the input u and the rates of the law's own states (per second),
       as formulas of `s` alone: ``s.x``, ``s.Y``, ``s.e_n``, ``s.nu``, ``s.phi``, ``s.sign_g``,
       the time ``s.t``, in rates ``s.applied``, the gains by ``s.parameter(name)`` and
       ``s.parameters(name, *shape)``, and its own states, which are symbols of
       :func:`certrack.core.expressions.symbol` that name no state or constant of the plant. The
       functions are those of a system file
       (:data:`certrack.core.expressions.ALLOWED_FUNCTIONS`), powers may have gains as exponents;
       anything else is refused when the law is designed, so that what can be simulated can be
       exported. Gains must not stand there as numbers, or a compiled loop would keep the old ones.
       ``s.e_n`` and ``s.nu`` may be plain symbols, as when a law is printed, so a law must not look
       into them;
    4. return from :meth:`parameters` a number, or an array of the shape asked for, for each of
       these names, and raise DesignError where the plant does not tell what the law must know. The
       names A_n, B_n, nu_x, nu_Y, A_n0, nu_0 and sign_g are taken, and those that begin with
       other_ and online_;
    5. pass ``certrack.testing.LawConformance``.

    Optional: another feed-forward order (:meth:`order`); a reason in `no_certificate`; initial
    values of the own states (:meth:`initial_states`), which ``simulation.estimates`` overrides;
    and, so that system files can name the law, :func:`certrack.laws.register` or an entry point
    ``kind = "package:Class"`` of the group ``certrack.laws``. Where the input is saturated, a
    sampled controller keeps of the rates only the terms of gains and own states alone, the
    forgetting; own states that are no estimates are listed in ``Equations.filters`` and move on.
    ``Equations.first`` says where they begin at the first sample.

    A certificate is a theorem about equations. A law says in :meth:`error_system` which of them it
    obeys (:mod:`certrack.laws.error_system`), and has a certificate if its formulas do. A law that
    says nothing has none.

    Parameters
    ----------
    c, k, p
        See :class:`certrack.laws.backstepping.Gains`.
    feedforward : int
        q, how many derivatives of y_d the virtual controls use; needs q + 1 bounded derivatives.
    coupling : float > 0, optional
        rho of :mod:`certrack.laws.balanced`; the paper's recursion if left out.
    sampled_feedforward : bool
        Whether a sampled controller multiplies y_d ... y_d^(q) by what its own loop needs: hold,
        delay and filters then leave no error of a reference that is a polynomial, and q may exceed
        n - 1. For laws and plants that are linear.
    integral : float > 0, optional, 1/s
        c_0 of integral action (:mod:`certrack.laws.integral`): e_0, the integral of x_1 - y_d, is
        an own state of the law, the last one.
    observer : Observer, optional
        What a sampled controller estimates, and gives to the law instead of filtered differences.
    online : Online, optional
        Another end of the gains, and the rule by which they move between the two.
    """

    kind: ClassVar[str]
    #: Why V' <= -alpha V + Delta is not provable for the law; empty where it may be.
    no_certificate: ClassVar[str] = ""
    #: Keys of :class:`certrack.laws.online.Online` that the law admits.
    moving: ClassVar[tuple[str, ...]] = ()

    c: tuple[float, ...] = keyed(
        "numbers",
        help="decay rates of the error coordinates",
        shape="c_1 ... c_n",
        unit="1/s",
        above=0,
    )
    k: tuple[tuple[float, ...], ...] | None = keyed(
        "rows",
        None,
        help="damping: row m has 2m entries; inf omits a term",
        shape="row m holds k_m1 ... k_m,2m, m = 1 ... n",
        above=0,
        infinite=True,
        otherwise="all inf",
    )
    p: tuple[float, ...] | None = keyed(
        "numbers",
        None,
        help="damping of the derivative of y_d not fed forward; inf omits a term",
        shape="p_1 ... p_{n-1}",
        above=0,
        infinite=True,
        otherwise="all inf",
    )
    feedforward: int = keyed(
        "integer",
        0,
        help="derivatives of y_d in the virtual controls, q = 0 ... n-1",
        least=0,
        most=MAX_ORDER - 1,
    )

    coupling: float | None = keyed(
        "number",
        None,
        help="rho of the balanced recursion: poles set by c and rho alone, in any units",
        above=0,
        otherwise="the paper's recursion",
    )
    sampled_feedforward: bool = keyed(
        "flag",
        False,
        help="feed-forward of the loop as sampled, delayed and filtered; q may then exceed n-1",
    )
    integral: float | None = keyed(
        "number",
        None,
        help="c_0 of integral action: the recursion begins with the integral of the error",
        unit="1/s",
        above=0,
        otherwise="none",
    )
    observer: Observer | None = None
    online: Online | None = None

    def __post_init__(self) -> None:
        gains = self.gains()
        values: dict[str, Any] = {"c": gains.c}
        values |= {"k": gains.k} if self.k is not None else {}
        values |= {"p": gains.p} if self.p is not None else {}
        set_fields(self, **values)
        check_fields(self, "law", *(name for name in keys_of(self) if name not in ("c", "k", "p")))
        self._check_tables()

    def _check_tables(self) -> None:
        """Check what is a table below that of the law."""
        if not isinstance(self.observer, Observer | None):
            raise InputError("law.observer", "must be an Observer", self.observer)
        check_online(self)

    @abstractmethod
    def equations(self, s: Signals) -> Equations:
        """Control and update laws as formulas of `s`.

        Equal laws must return equal formulas: compiled loops are compared by them.
        """

    def parameters(self, plant: Plant) -> Mapping[str, Any]:
        """Numbers for the gains that :meth:`equations` asked for, by name.

        Raises
        ------
        InputError
            If a gain does not fit the plant (as many numbers as regressors, for example).
        DesignError
            If the plant does not state what the law must know.
        """
        return {}

    def error_system(self, s: Signals) -> ErrorSystem | None:
        """What a certificate of the law may rely on; None if there is none.

        In the symbols of `s`, like :meth:`equations`. Whoever certifies the law compares the two.
        """
        return None

    def initial_states(self, plant: Plant) -> Mapping[str, float]:
        """Initial values of the law's own states, by name; zero for those that are left out."""
        return {}

    def settled(self, plant: Plant) -> Law:
        """The law with every number stated that it computes for `plant`: what a proof names."""
        return self

    def order(self, plant: Plant) -> int:
        """Feed-forward order q on this plant, 0 <= q <= n - 1; y_d needs q + 1 derivatives."""
        return self.feedforward

    def gains(self) -> Gains:
        """Gains of the recursion."""
        return Gains(self.c, self.k, self.p, self.coupling, self.integral)

    def coordinates(self, plant: Plant) -> ErrorCoordinates:
        """Carry out the recursion for `plant`."""
        q = self.order(plant)
        return recursion(plant.g, plant.b, self.gains(), q, beyond=self.sampled_feedforward)

    def values(self, plant: Plant, names: Sequence[str]) -> np.ndarray:
        """Numbers for the named gains, flattened; all a sweep over gains has to recompute."""
        return self._values(self.coordinates(plant), plant, names)

    def _values(
        self, coordinates: ErrorCoordinates, plant: Plant, names: Sequence[str]
    ) -> np.ndarray:
        numbers = self._numbers(coordinates, plant)
        for name in names:
            if name not in numbers:
                raise InputError("law", f"parameters() gives no number for {name}")
        return np.concatenate([np.ravel(np.asarray(numbers[name], float)) for name in names])

    def numbers(self, plant: Plant) -> dict[str, Any]:
        """All numbers that stand for gains in the formulas, by name."""
        return self._numbers(self.coordinates(plant), plant)

    def _numbers(self, coordinates: ErrorCoordinates, plant: Plant) -> dict[str, Any]:
        return {
            "A_n": coordinates.A[-1],
            "B_n": coordinates.B[-1],
            "nu_x": coordinates.nu_x,
            "nu_Y": coordinates.nu_Y,
            **_of_integral(coordinates),
            "sign_g": plant.gain_sign,
            **self.parameters(plant),
            **({} if self.online is None else online_numbers(self, plant)),
        }

    def design(self, plant: Plant) -> Controller:
        """The controller for `plant`.

        Raises
        ------
        InputError
            If the gains do not fit the plant.
        DesignError
            If no such controller exists.
        """
        coordinates = self.coordinates(plant)
        signals = Signals(plant, coordinates.q, integral=self.integral is not None)
        equations = self.normal_equations(signals)
        names = tuple(z.name for z, _ in equations.update)
        _check_own_states(names, (*plant.states, *plant.constant_values))
        known = {*signals.x, *signals.Y, TIME, signals.applied, *(z for z, _ in equations.update)}
        known |= {name for group in signals.all_parameters.values() for name in group}
        known |= set().union(plant.drift.expr.free_symbols, *(f.free_symbols for f in signals.phi))
        if self.online is not None:
            known |= {symbol(name) for name in plant.constant_values}
        remedy = "Use the signals, gains by s.parameter, and own states that have a rate"
        check_symbols("law", equations.formulas, known, remedy)
        listed = (*equations.filters, *(z for z, _ in equations.first))
        if unknown := [str(z) for z in listed if z.name not in names]:
            message = "filters and first values must be of own states of the law"
            raise InputError("law", message, ", ".join(unknown))
        stated = {
            name: checks.real(f"law.initial_states.{name}", value)
            for name, value in self.initial_states(plant).items()
        }
        if foreign := sorted(set(stated) - set(names)):
            raise InputError("law.initial_states", "names no state of the law", ", ".join(foreign))
        values = self._values(coordinates, plant, list(signals.all_parameters))
        start = tuple(stated.get(name, 0.0) for name in names)
        return Controller(equations, signals, coordinates, values, start, self)

    def normal_equations(self, s: Signals) -> Equations:
        """The equations in the one form that is compiled, printed and exported.

        Raises
        ------
        InputError
            If a formula contains what certrack does not support.
        """
        equations = self.equations(s)
        if not isinstance(equations, Equations):
            raise InputError("law", "equations must return Equations", equations)
        if self.online is not None:
            equations = moving_equations(self, equations, s)
        names = [z for z, _ in equations.update]
        for i, z in enumerate(names):
            if z != symbol(str(z)):
                raise InputError("law", "own states must be made by certrack.laws.symbol", z)
            if z in names[:i]:
                raise InputError("law", "has a state of this name already", z, "Rename it")
        normal = {name: normal_form("law", name, f) for name, f in equations.formulas.items()}
        u, *others = normal.values()
        update = tuple(zip(names, others, strict=False))
        first = zip((z for z, _ in equations.first), others[len(names) :], strict=True)
        if self.integral is not None:
            update = (*update, (INTEGRAL, s.x[0] - s.Y[0]))
        return Equations(u, update, tuple(equations.filters), tuple(first))


def _of_integral(coordinates: ErrorCoordinates) -> dict[str, Any]:
    part = coordinates.integral
    return {} if part is None else {"A_n0": part.column[-1], "nu_0": part.nu}


def _check_own_states(names: Sequence[str], used: Collection[str]) -> None:
    """Refuse names of own states that stand for something else already."""
    for name in names:
        check_name("law", name)
        if name.startswith(NUMBER_PREFIXES):
            raise InputError("law", "names of own states must not begin so", name, "Rename it")
        if name in used:
            raise InputError("law", "has a state of this name already", name, "Rename it")

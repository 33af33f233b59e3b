"""Families of random disturbances: w_k = s_k(t) (gamma_k ||x|| + beta_k) with |s_k| <= 1.

The family says what s_k looks like; the factor behind it, and so Assumption 1, is the ensemble's.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np

from certrack.core.errors import InputError
from certrack.core.expressions import check_name
from certrack.model.distribution import Distribution

if TYPE_CHECKING:
    from certrack.model.population import Population

#: The sum of the magnitudes of a member's sines: just below 1, so that rounding never passes it.
SINE_WEIGHT_SUM = 1 - 1e-12

#: Keeps the weights defined where all draws are zero.
LEAST_WEIGHT = 1e-300


class DisturbanceFamily(ABC):
    """A family of patterns s_k(t), |s_k| <= 1 for all t >= 0.

    The author states `kind`, the word in ``[ensemble]``, and:

    1. :meth:`numbers`, what is drawn for each disturbance of each member;
    2. :meth:`pattern`, s_k as a formula of t and of these numbers. It must never pass 1 in
       magnitude: an ensemble looks at samples of it and refuses what it sees, which is no proof, so
       no certificate is the limit of such an ensemble;
    3. :func:`register_disturbance` on the class.
    """

    kind: ClassVar[str]

    @abstractmethod
    def numbers(self, population: Population) -> Mapping[str, Distribution]:
        """Distributions of the numbers of one s_k, by names that are identifiers."""

    def adjusted(self, draws: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """The numbers of many members after the draw: where they must fit each other."""
        return draws

    @abstractmethod
    def pattern(self, number: Callable[[str], str]) -> str:
        """s_k as the text of a formula of t; ``number(name)`` stands for a drawn number."""


class Multisine(DisturbanceFamily):
    """Sums of sines of random weight, frequency and phase; the weights' magnitudes sum to 1."""

    kind = "multisine"

    def __init__(self, sines: int) -> None:
        self._sines = sines

    def numbers(self, population: Population) -> Mapping[str, Distribution]:
        speed = Distribution("loguniform", population.frequencies)
        turn = Distribution("uniform", (0.0, 2 * math.pi))
        share = Distribution("uniform", (0.0, 1.0))
        names: dict[str, Distribution] = {}
        for j in range(self._sines):
            names |= {f"w_{j}": speed, f"p_{j}": turn, f"a_{j}": share}
        return names

    def adjusted(self, draws: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        weights = [f"a_{j}" for j in range(self._sines)]
        total = sum(draws[name] for name in weights) + LEAST_WEIGHT
        return dict(draws) | {name: SINE_WEIGHT_SUM * draws[name] / total for name in weights}

    def pattern(self, number: Callable[[str], str]) -> str:
        return " + ".join(
            f"{number(f'a_{j}')}*sin({number(f'w_{j}')}*t + {number(f'p_{j}')})"
            for j in range(self._sines)
        )


_F = TypeVar("_F", bound=type[DisturbanceFamily])

#: What :func:`register_disturbance` was called with, in this process.
_registered_disturbances: dict[str, type[DisturbanceFamily]] = {}


def register_disturbance(family: _F) -> _F:
    """Class decorator: let ``ensemble.disturbance`` name a family by its `kind`, in this process.

    Parameters
    ----------
    family : subclass of DisturbanceFamily
        Is made without arguments.

    Returns
    -------
    class
        The family itself.

    Raises
    ------
    InputError
        If it is no such class, or its kind is taken by a shipped one.

    Examples
    --------
    >>> from certrack import Distribution, Population
    >>> from certrack.model.disturbance import DisturbanceFamily, register_disturbance
    >>> @register_disturbance
    ... class Decaying(DisturbanceFamily):
    ...     kind = "decaying"
    ...     def numbers(self, population):
    ...         return {"rate": Distribution("uniform", (0.1, 1.0))}
    ...     def pattern(self, number):
    ...         return f"exp(-{number('rate')}*t)"
    >>> Population(disturbance="decaying").disturbance
    'decaying'
    """
    if not (isinstance(family, type) and issubclass(family, DisturbanceFamily)):
        raise InputError("disturbance", "must be a subclass of DisturbanceFamily", family)
    kind = getattr(family, "kind", "")
    check_name("disturbance.kind", str(kind).replace("-", "_"))
    if kind in ("file", Multisine.kind):
        raise InputError("disturbance.kind", "is that of a shipped family", kind)
    _registered_disturbances[kind] = family
    return family


def known_disturbances() -> tuple[str, ...]:
    """What ``ensemble.disturbance`` may say."""
    return ("file", Multisine.kind, *_registered_disturbances)


def family_of(population: Population) -> DisturbanceFamily | None:
    """The family of a population; None where the disturbances are those of the file."""
    if population.disturbance == "file":
        return None
    if population.disturbance == Multisine.kind:
        return Multisine(population.sines)
    family = _registered_disturbances.get(population.disturbance)
    if family is None:
        raise InputError(
            "ensemble.disturbance",
            "is not registered in this process",
            population.disturbance,
            "Put the family into a module that every process imports",
        )
    return family()

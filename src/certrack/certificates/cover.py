"""The smallest gamma and beta that cover a term of the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from scipy.optimize import minimize

from certrack.certificates.assumption_1 import UncertainTerm
from certrack.certificates.sampling import Points
from certrack.core.rounding import rounded_up

#: Digits of a gamma or beta that is proposed, rounded up; and the part of it that may be rounding.
COVER_DIGITS, COVER_ROUNDING = 2, 1e-9

#: A supremum that grows by this factor when all states are so many times larger (or smaller) is
#: taken for infinite: a power of ||x|| beyond the first, or s log s.
GROWTH, FARTHER = 1.02, 1e4

#: Share of the largest ||x|| beyond which a slope is that of large states.
FAR_SHARE = 1e-2

#: Steps of the search that polishes the largest ratio.
SUPREMUM_STEPS = 300

#: Times a proposal is raised by a unit of its last digit when the samples still break it.
MAX_RAISES = 5


@dataclass(frozen=True)
class Cover:
    """What would cover one term; the file's numbers where they do already.

    Attributes
    ----------
    term : str
        E.g. ``"w_2"``.
    gamma : float or None
        The smallest gamma with the file's beta, rounded up; None if none is large enough.
    beta : float or None
        The smallest beta with the file's gamma.
    both : pair or None
        gamma and beta, where neither alone can be large enough; None also where no pair is.
    proven : bool
        Whether everything stated covers the term by exact arithmetic, not on samples only.
    """

    term: str
    gamma: float | None
    beta: float | None
    both: tuple[float, float] | None
    proven: bool


def smallest_cover(term: UncertainTerm, points: Points) -> Cover:
    """The smallest gamma and beta of the term, each with the other as in the file.

    Where the bound is a formula they are zero if it covers the term; there are none if it does not.

    Parameters
    ----------
    term : UncertainTerm
        tau stays as it is; a term with a true strength and no tau has no cover.
    points : Points
        Samples to look at; a supremum is taken over them and polished.
    """
    if term.zero:
        return Cover(term.name, 0.0, 0.0, None, proven=True)
    if not term.tau or term.violation_of_domain(points):
        return Cover(term.name, None, None, None, proven=False)
    if term.growing is not None:
        broken = term.violation(points) is not None
        size = None if broken else 0.0
        return Cover(term.name, size, size, None, term.proven)
    search = _Suprema(term, points)
    gamma = search.smallest(search.gamma_needed(float(term.beta)), None, term.beta)
    beta = search.smallest(search.beta_needed(float(term.gamma)), term.gamma, None)
    both = None
    if gamma is None and beta is None:
        growth = search.far_growth()
        if math.isfinite(growth):
            slope = Fraction(_short(growth))
            offset = search.smallest(search.beta_needed(float(slope)), slope, None)
            both = None if offset is None else (float(slope), float(offset))
    pairs = [(gamma, term.beta), (term.gamma, beta), both or (None, None)]
    stated = [(Fraction(g), Fraction(b)) for g, b in pairs if g is not None and b is not None]
    proven = bool(stated) and all(term.proven_with(g, b) for g, b in stated)
    return Cover(term.name, _float(gamma), _float(beta), both, proven)


def _float(value: Fraction | None) -> float | None:
    return None if value is None else float(value)


def _short(value: float) -> str:
    return rounded_up(value * (1 - COVER_ROUNDING), COVER_DIGITS)


class _Suprema:
    """Suprema over the samples, also scaled up and down."""

    def __init__(self, term: UncertainTerm, points: Points) -> None:
        self.term = term
        self.base = points
        self.far = Points(points.t, points.x * FARTHER)
        self.near = Points(points.t, points.x / FARTHER)
        self.scale = 1 / float(term.tau)

    def size(self, points: Points) -> np.ndarray:
        values: np.ndarray = np.nan_to_num(self.term.size(points) * self.scale, nan=0.0)
        return values

    def gamma_needed(self, beta: float) -> float:
        """sup (|w| - beta)/||x||."""

        def ratio(points: Points) -> np.ndarray:
            above = self.size(points) - beta * (1 + COVER_ROUNDING)
            with np.errstate(all="ignore"):
                return np.where(above > 0, above / points.norm, 0.0)

        return self._supremum(ratio, self.near, self.far)

    def beta_needed(self, gamma: float) -> float:
        """sup |w| - gamma ||x||."""

        def beyond(points: Points) -> np.ndarray:
            above: np.ndarray = self.size(points) - gamma * (1 + COVER_ROUNDING) * points.norm
            return np.maximum(above, 0.0)

        return self._supremum(beyond, self.far)

    def far_growth(self) -> float:
        """|w|/||x|| where ||x|| is large."""
        slopes = []
        for factor in (FARTHER, FARTHER**2):
            points = Points(self.base.t, self.base.x * factor)
            away = points.norm > FAR_SHARE * points.norm.max()
            slopes.append(float((self.size(points)[away] / points.norm[away]).max()))
        return slopes[0] if slopes[1] <= GROWTH * slopes[0] else math.inf

    def _supremum(self, f: Callable[[Points], np.ndarray], *beyond: Points) -> float:
        values = f(self.base)
        top = float(values.max())
        if not math.isfinite(top) or any(f(p).max() > GROWTH * top for p in beyond):
            return math.inf
        best = self.base[int(np.argmax(values))]
        smallest, largest = 1e-6, 10.0 * float(self.base.norm.max())

        def objective(z: np.ndarray) -> float:
            where = Points(np.abs(z[:1]), z[1:, None])
            inside = smallest <= float(where.norm[0]) <= largest
            return -float(f(where)[0]) if inside else 0.0

        start = np.concatenate([best.t, best.x[:, 0]])
        options = {"maxiter": SUPREMUM_STEPS}
        polished = minimize(objective, start, method="Nelder-Mead", options=options)
        return max(top, -float(polished.fun))

    def smallest(
        self, value: float, gamma: Fraction | None, beta: Fraction | None
    ) -> Fraction | None:
        """The value rounded up so that no sample breaks it; None if there is none."""
        if not math.isfinite(value):
            return None
        for _ in range(MAX_RAISES):
            proposal = Fraction(_short(value))
            g, b = (proposal if gamma is None else gamma), (proposal if beta is None else beta)
            wider = replace(self.term, gamma=g, beta=b)
            if wider.proven or wider.exceeded(self.base) is None:
                return proposal
            value = float(proposal) * (1 + 10.0**-COVER_DIGITS)
        return None

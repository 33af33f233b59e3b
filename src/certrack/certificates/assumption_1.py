"""Assumption 1 put to the test: does the file's omega obey |w_k| <= gamma_k ||x|| + beta_k?

First by majorants, which prove it; else by samples, which can only refute it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import sympy
from scipy.optimize import minimize

from certrack.certificates.arithmetic import as_sympy, fraction, rational
from certrack.certificates.domain import always_defined, more_digits, undefined_at
from certrack.certificates.majorants import Majorant, covers, majorants, root_above
from certrack.certificates.sampling import Points, nearest_failure, random_points
from certrack.certificates.size_majorants import Sizes, stays_below
from certrack.core.expressions import TIME, Expression, symbol
from certrack.core.lowering import NumpyFunction, numpy_callable, rows
from certrack.core.powers import put_in
from certrack.model.growth import NORM, GrowthInFloats
from certrack.model.truth import constants_of_truth
from certrack.systems.system import System, require_system

#: Relative excess that is not reported: the evaluation of a formula rounds.
VIOLATION_TOLERANCE = 1e-9

#: Part of ||x|| by which a formula that is zero may seem to be none.
ROUNDING = 1e-13

#: Relative excess of the point that is shown, where there is one: it can be seen with a calculator.
CLEAR_EXCESS = 1e-3

#: Steps of the Nelder-Mead search that polishes the worst point.
POLISHING_STEPS = 400


@dataclass(frozen=True)
class Violation:
    """A point at which an uncertain term exceeds its bound, or has no value.

    Attributes
    ----------
    term : str
        E.g. ``"w_2"``.
    t, x
        Where: of the points found, the one with the smallest ||x||.
    value, limit : float
        |tau w| there (NaN where the formula has no value), and what the uncertainty allows for it.
    remedy : str
        What would make the assumption hold.
    """

    term: str
    t: float
    x: tuple[float, ...]
    value: float
    limit: float
    remedy: str = "raise gamma or beta"

    def __str__(self) -> str:
        point = ", ".join(f"{v:.4g}" for v in self.x)
        where = f"at t = {self.t:.4g}, x = ({point})"
        if np.isnan(self.value):
            what = f"{self.term} has no value"
        else:
            what = f"tau |{self.term}| = {self.value:.6g} > {self.limit:.6g}"
        return f"Assumption 1 does not hold: {what} {where}; {self.remedy}"


def check_assumption_1(system: System, seed: int = 0) -> list[Violation]:
    """Search for points where the truth's omega breaks its bound.

    Random states of all magnitudes and directions, the worst of each term polished, unless the
    bound is proven. No violation is evidence, not proof: :func:`certrack.check` says which of the
    two. A truth with states of its own has no omega to evaluate.

    Parameters
    ----------
    system : System
    seed : int
        Of the random states.

    Returns
    -------
    list of Violation
        Empty where none was found.

    Examples
    --------
    >>> import certrack
    >>> certrack.check_assumption_1(certrack.load("example1"))
    []
    """
    require_system(system)
    terms = [term for term in uncertain_terms(system) if not term.proven]
    if not terms:
        return []
    points = random_points(system.plant.n, system.settings.duration, seed)
    return [violation for term in terms if (violation := term.violation(points)) is not None]


def uncertain_terms(system: System) -> list[UncertainTerm]:
    """The terms w_1 ... w_n of the truth; none for a truth with states of its own."""
    plant, truth = system.plant, system.truth
    constants = {name: v.expr for name, v in truth.constants}
    if not truth.states:  # what is a formula of others follows them
        constants = constants_of_truth(plant, truth.constants)
    terms = []
    for k, w in enumerate(truth.omega or ()):
        exact = {s: constants[s.name] for s in w.expr.free_symbols if s.name in constants}
        assert truth.tau is not None
        u = plant.uncertainty
        strength, tau, gamma, beta = (_fraction(v[k]) for v in (truth.tau, u.tau, u.gamma, u.beta))
        weights = tuple(map(_fraction, u.norm_weights(k)))
        single = tuple(map(_fraction, u.Delta[k])) if u.Delta else ()
        formula = put_in(w.expr, exact)
        bounds = gamma, beta, weights, single, u.formula(k)
        terms.append(UncertainTerm(k, formula, plant.symbols, strength, tau, *bounds))
    return terms


def _fraction(value: object) -> Fraction:
    return fraction(rational(value))


@dataclass(frozen=True)
class UncertainTerm:
    """One w_k of the truth beside what the design allows for it.

    Attributes
    ----------
    k : int
        From 0.
    formula : sympy.Expr
        omega_k of t and the states.
    states : symbols
    strength : Fraction
        The true tau_k.
    tau, gamma, beta : Fraction
        Of the design: tau_true |w_k| <= tau (gamma ||S x|| + Delta |x| + beta) is the assumption.
    weights : n Fractions
        Diagonal of S.
    single : n Fractions, or none
        Row of Delta.
    growing : Expression or None
        The bound in the place of gamma, Delta and beta, if it is a formula.
    """

    k: int
    formula: sympy.Expr
    states: tuple[sympy.Symbol, ...]
    strength: Fraction
    tau: Fraction
    gamma: Fraction
    beta: Fraction
    weights: tuple[Fraction, ...] = ()
    single: tuple[Fraction, ...] = ()
    growing: Expression | None = None

    @property
    def name(self) -> str:
        """E.g. ``w_2``."""
        return f"w_{self.k + 1}"

    @property
    def zero(self) -> bool:
        """Whether there is nothing to bound."""
        return not self.strength or self.formula == 0

    @cached_property
    def majorants(self) -> list[Majorant]:
        """Polynomials in ||x|| that the formula never exceeds; none if it may have no value."""
        known = always_defined(self.formula, self.states)
        return majorants(self.formula, self.states) if known else []

    @property
    def proven(self) -> bool:
        """Whether the bound holds for all t >= 0 and x, by exact arithmetic."""
        if self.growing is not None:
            return self.proven_within(None)
        if self.proven_with(self.gamma, self.beta):
            return True
        return any(self.single) and self.proven_within(None)

    def proven_within(self, region: Sequence[Fraction] | None) -> bool:
        """The same for all states with |x_i| <= region_i; for all if there is none."""
        if self.zero:
            return True
        if not always_defined(self.formula, self.states, region):
            return False
        norm = Fraction(0)
        if region is not None:
            norm = root_above(
                sum(((w * r) ** 2 for w, r in zip(self.weights, region, strict=True)), norm)
            )
        sizes = Sizes(self.states, self.weights, None if region is None else tuple(region), norm)
        return stays_below(self.formula, self.bound, sizes, self.strength)

    @cached_property
    def bound(self) -> sympy.Expr:
        """tau times the bound, of the sizes of the states and the norm."""
        if self.growing is not None:
            inside = self.growing.expr
        else:
            sizes = zip(self.single, self.states, strict=False)
            inside = sum((as_sympy(c) * x for c, x in sizes), as_sympy(self.beta))
            inside += as_sympy(self.gamma) * symbol(NORM)
        return as_sympy(self.tau) * inside

    def proven_with(self, gamma: Fraction, beta: Fraction) -> bool:
        """The same for another gamma and beta; Delta is left out, and S taken by its least."""
        tau, gamma = self.tau, gamma * min(self.weights, default=Fraction(1))
        return self.zero or covers(self.majorants, tau * gamma, tau * beta, self.strength)

    def violation(
        self, points: Points, *, within: Callable[[Points], Points] | None = None
    ) -> Violation | None:
        """A point where it exceeds its bound or has no value, of those given and near them.

        Parameters
        ----------
        points : Points
        within : callable, optional
            Moves points into the region to which the search keeps, those given among them; it must
            hold the ray from each of its points to the origin.
        """
        points = points if within is None else within(points)
        if self.zero:
            return None
        undefined = undefined_at(self.formula, self.states, points)
        if undefined is not None:
            condition, where = undefined
            limit = float(self.limit(where)[0])
            remedy = f"rewrite truth.omega[{self.k}]: {condition}"
            return self._violation(where, float("nan"), limit, remedy)
        beyond = self.exceeded(points, within=within)
        if beyond is None:
            return None
        size, limit = float(self.size(beyond)[0]), float(self.limit(beyond)[0])
        return self._violation(beyond, size, limit, "")

    def violation_of_domain(self, points: Points) -> bool:
        """Whether it has no value somewhere."""
        return undefined_at(self.formula, self.states, points) is not None

    def _violation(self, where: Points, value: float, limit: float, remedy: str) -> Violation:
        t, x = float(where.t[0]), tuple(where.x[:, 0].tolist())
        return Violation(self.name, t, x, value, limit, remedy or "raise gamma or beta")

    def exceeded(
        self, points: Points, *, within: Callable[[Points], Points] | None = None
    ) -> Points | None:
        """A point beyond the bound, clearly if there is one, of the smallest ||x|| found.

        The points are those that :meth:`violation` has moved.
        """
        excess = self.excess(points)
        worst = int(np.argmax(excess / (1 + points.norm)))
        where = nearest_failure(
            points, lambda p: self._fails(p) & (self.excess(p) > CLEAR_EXCESS * self.limit(p))
        )
        if where is None or not self.confirmed(where):
            where = nearest_failure(points, self._fails)
        if where is None:
            where = nearest_failure(self._polished(points[worst], within), self._fails)
        return where if where is not None and self.confirmed(where) else None

    def _fails(self, points: Points) -> np.ndarray:
        above: np.ndarray = self.excess(points) > ROUNDING * points.norm
        return above

    def size(self, points: Points) -> np.ndarray:
        """tau |w_k|."""
        with np.errstate(all="ignore"):
            w = rows(self._function(points.t, points.x), len(points.t))[0]
        return float(self.strength) * np.abs(w)

    def limit(self, points: Points) -> np.ndarray:
        """What the design allows."""
        norm = points.norm
        if self.weights:
            norm = np.linalg.norm(
                np.array(list(map(float, self.weights)))[:, None] * points.x, axis=0
            )
        if self.growing is not None:
            return float(self.tau) * self._grown.value(points.x, norm)
        allowed: np.ndarray = float(self.tau * self.gamma) * norm
        if self.single:
            allowed = allowed + np.array([float(self.tau * v) for v in self.single]) @ abs(points.x)
        return allowed + float(self.tau * self.beta)

    @property
    def allowance(self) -> str:
        """What the design allows, in words."""
        if self.growing is not None:
            return self.growing.text if self.tau == 1 else f"{float(self.tau):.6g} ({self.growing})"
        norm = "||x||" if all(w == 1 for w in self.weights) else "||S x||"
        text = f"{float(self.tau * self.gamma):.6g} {norm}"
        if any(self.single):
            text += " + tau Delta |x|"
        return f"{text} + {float(self.tau * self.beta):.6g}"

    def excess(self, points: Points) -> np.ndarray:
        """tau |w_k| above what is allowed; -inf where it has no value."""
        gap = self.size(points) - self.limit(points) * (1 + VIOLATION_TOLERANCE)
        return np.nan_to_num(gap, nan=-np.inf)

    def confirmed(self, where: Points) -> bool:
        """Whether more digits than a float's say the same: no overflow, no cancellation."""
        value = more_digits(self.formula, self.states, where)
        if not value.is_real:
            return bool(value.is_infinite)
        return bool(float(self.strength) * abs(value) > float(self.limit(where)[0]))

    def _polished(self, point: Points, within: Callable[[Points], Points] | None = None) -> Points:
        """The point after a search around it for the largest excess."""

        def at(z: np.ndarray) -> Points:
            where = Points(np.abs(z[:1]), z[1:, None])
            return where if within is None else within(where)

        def objective(z: np.ndarray) -> float:
            where = at(z)
            return -float(self.excess(where)[0]) / (1 + float(where.norm[0]))

        start = np.concatenate([point.t, point.x[:, 0]])
        options = {"maxiter": POLISHING_STEPS}
        top = minimize(objective, start, method="Nelder-Mead", options=options).x
        return at(top)

    @cached_property
    def _function(self) -> NumpyFunction:
        return numpy_callable([TIME, self.states], [self.formula])

    @cached_property
    def _grown(self) -> GrowthInFloats:
        assert self.growing is not None
        return GrowthInFloats(self.growing, [s.name for s in self.states])

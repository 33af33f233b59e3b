"""Assumption 1 put to the test: does the file's omega obey |w_k| <= gamma_k ||x|| + beta_k?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy
from scipy.optimize import minimize

from certrack.core.expressions import TIME
from certrack.core.lowering import numpy_callable, rows
from certrack.core.powers import put_in
from certrack.systems.system import System

#: Random points per term; the search takes about 0.05 s, and a violation on a thousandth of
#: them is missed with a probability of 1e-17.
RANDOM_POINTS = 40_000

#: Relative excess that is not reported: the evaluation of a formula rounds.
VIOLATION_TOLERANCE = 1e-9

#: Steps of the Nelder-Mead search that polishes the worst point.
POLISHING_STEPS = 400

#: Powers of ten between which the random states lie; part of them that lies on an axis, where a
#: term of one state is largest against the norm; part of the times at 0, where a transient starts.
RANDOM_MAGNITUDES, AXIS_SHARE, START_SHARE = (-3, 4), 0.3, 0.05


@dataclass(frozen=True)
class Violation:
    """A point at which an uncertain term exceeds its bound.

    Attributes
    ----------
    term : str
        E.g. ``"w_2"``.
    t, x
        Where.
    value, limit : float
        |tau w| there, and what the uncertainty allows for it.
    """

    term: str
    t: float
    x: tuple[float, ...]
    value: float
    limit: float

    def __str__(self) -> str:
        point = ", ".join(f"{v:.4g}" for v in self.x)
        return (
            f"Assumption 1 does not hold: tau |{self.term}| = {self.value:.6g} > {self.limit:.6g} "
            f"at t = {self.t:.4g}, x = ({point}); raise gamma or beta"
        )


def check_assumption_1(system: System, seed: int = 0) -> list[Violation]:
    """Search for points where the truth's omega breaks its bound.

    Random states of all magnitudes and directions over the run's duration, the worst of each term
    polished. No violation is evidence, not proof. A truth with states of its own has no omega to
    evaluate.

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
    plant, truth = system.plant, system.truth
    t, x = _random_points(plant.n, system.settings.duration, seed)
    constants = {**plant.constant_values, **{name: v.expr for name, v in truth.constants}}
    violations = []
    for k, w in enumerate(truth.omega or ()):
        exact = {s: constants[s.name] for s in w.expr.free_symbols if s.name in constants}
        excess = _Excess(system, k, put_in(w.expr, exact))
        size = excess(t, x) / (1 + np.linalg.norm(x, axis=0))
        i = int(np.argmax(size))
        best = np.concatenate([[t[i]], x[:, i]])
        steps = {"maxiter": POLISHING_STEPS}
        polished = minimize(excess.objective, best, method="Nelder-Mead", options=steps)
        if -polished.fun > size[i]:
            best = np.concatenate([[abs(polished.x[0])], polished.x[1:]])
        gap = float(excess(best[:1], best[1:, None])[0])
        if gap > VIOLATION_TOLERANCE:
            limit = float(excess.limit(best[1:, None])[0])
            point = tuple(best[1:].tolist())
            violations.append(Violation(f"w_{k + 1}", float(best[0]), point, gap + limit, limit))
    return violations


class _Excess:
    """tau_k |w_k| minus what the uncertainty allows, as a function of time and state."""

    def __init__(self, system: System, k: int, formula: sympy.Expr) -> None:
        u = system.plant.uncertainty
        assert system.truth.tau is not None
        self.strength = system.truth.tau[k]
        self.gamma, self.beta = u.tau[k] * u.gamma[k], u.tau[k] * u.beta[k]
        self._w = numpy_callable([TIME, system.plant.symbols], [formula])

    def limit(self, x: np.ndarray) -> np.ndarray:
        return self.gamma * np.linalg.norm(x, axis=0) + self.beta

    def __call__(self, t: np.ndarray, x: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            value = self.strength * np.abs(rows(self._w(t, x), len(t))[0])
        return np.nan_to_num(value - self.limit(x) * (1 + VIOLATION_TOLERANCE), nan=-np.inf)

    def objective(self, point: np.ndarray) -> float:
        gap = self(np.abs(point[:1]), point[1:, None])[0]
        return -float(gap) / (1 + float(np.linalg.norm(point[1:])))


def _random_points(n: int, duration: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of all magnitudes, in random directions and along the axes."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(n, RANDOM_POINTS))
    axes = rng.random(RANDOM_POINTS) < AXIS_SHARE
    x[:, axes] *= np.arange(n)[:, None] == rng.integers(0, n, RANDOM_POINTS)[axes]
    x *= 10.0 ** rng.uniform(*RANDOM_MAGNITUDES, RANDOM_POINTS) / np.linalg.norm(x, axis=0)
    x[:, :1] = 0.0
    t = rng.uniform(0, duration, RANDOM_POINTS)
    t[: int(START_SHARE * RANDOM_POINTS)] = 0.0
    return t, x

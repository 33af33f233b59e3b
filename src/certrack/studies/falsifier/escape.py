"""The first escape: how far out a start must be for the uncertain terms to carry the states away.

Where a bound of w grows faster than the state, a certificate holds from a box of starts, and from
far enough away no loop comes back. Between the two lies what nobody has decided. Boxes of the same
shape are tried, larger and larger, from their corners, with uncertain terms that are as large as
their bounds and push every row outwards; the nearest that escapes is simulated as a system.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from certrack.certificates.implemented.polytope import Polytope
from certrack.certificates.start import reference_at_start
from certrack.integrators.base import Outcome
from certrack.model.growth import GrowthInFloats
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.linear.case import WITHIN_BOUND
from certrack.studies.falsifier.linear.chain import Chain
from certrack.studies.falsifier.linear.sampled import sampled_chain
from certrack.systems.system import System

#: The first scale of the box that is tried, and the last; how near the nearest escape is; and
#: by how much a scale is raised where the simulation stays.
FIRST_SCALE, LAST_SCALE, BISECTED, RAISED = 2.0**-6, 2.0**20, 0.01, 1.02

#: Corners that are tried, at most: all of them up to this order.
MAX_CORNERS_ORDER = 8

#: Length of a run, in samples, at most; and how often a scale is raised.
MAX_ESCAPE_SAMPLES, MAX_SCALE_RAISES = 1500, 8

#: The offset of a magnitude in the pattern of a disturbance: tanh(x/offset) is nearly its sign.
SIGN_WIDTH = 1e-3

#: States beyond this have escaped in the search; the run of the system has its own limit.
ESCAPED = 1e9


@dataclass(frozen=True)
class Escape:
    """A start from which the states escape.

    Attributes
    ----------
    scale : float
        Of the box's shape.
    box : n floats
        Half the widths of the box at whose corner it lies.
    system : System
        Replays it.
    within : bool
        Whether it begins in the box that is certified: then certrack is wrong.
    """

    scale: float
    box: tuple[float, ...]
    system: System
    within: bool


def first_escape(
    system: System,
    bounds: tuple[float, ...],
    certified: Polytope | None,
) -> Escape | None:
    """The nearest start, of those tried, from which the states escape.

    Parameters
    ----------
    system : System
        With an implementation; a bound of w grows faster than the state.
    bounds : Y_0 ... Y_m
        Of the reference.
    certified : Polytope or None
        Starts with a certificate.

    Returns
    -------
    Escape, or None where the loop is not linear, or nothing escapes.
    """
    chain = sampled_chain(system, bounds)
    if chain is None:
        return None
    shape, search = shape_of(system), _Search(chain, system)
    low, high = 0.0, FIRST_SCALE
    while (nearest := search.escapes(high * shape)) is None:
        low, high = high, 2 * high
        if high > LAST_SCALE:
            return None
    while low and high > (1 + BISECTED) * low:
        middle = math.sqrt(low * high)
        nearer = search.escapes(middle * shape)
        low, high, nearest = (low, middle, nearer) if nearer else (middle, high, nearest)
    for _ in range(MAX_SCALE_RAISES):
        if nearest is not None:
            case = search.written(*nearest)
            if simulate(case).outcome is Outcome.escaped:
                x0 = np.array(case.settings.x0)
                within = certified is not None and bool(certified.contains(x0))
                return Escape(high, tuple((high * shape).tolist()), case, within)
        high *= RAISED
        nearest = search.escapes(high * shape)
    return None


def shape_of(system: System) -> np.ndarray:
    """Half the widths of the ensemble's box, else ones."""
    drawn = system.varied.x0
    if drawn is None:
        return np.ones(system.plant.n)
    return np.array([max(abs(entry.low), abs(entry.high)) for entry in drawn])


class _Search:
    """Runs of the linear loop from all corners of a box, side by side."""

    def __init__(self, chain: Chain, system: System) -> None:
        self.chain, self.system = chain, system
        n = chain.n
        corners = product((-1.0, 1.0), repeat=min(n, MAX_CORNERS_ORDER))
        half = [c + (1.0,) * (n - len(c)) for c in corners]
        self.corners = np.array(half).T
        wanted = system.settings.duration / chain.period
        self.samples = max(1, min(MAX_ESCAPE_SAMPLES, math.ceil(wanted)))
        m = len(chain.bounds) - 1
        Y = np.zeros(m)
        known = [float(v.mid()) for v in reference_at_start(system, m - 1)[0]]
        Y[: len(known)] = known
        self.at_rest = chain.start @ Y
        acting = len(chain.acting)
        self.patterns = [("x",) * acting, *product("+-", repeat=acting)]
        signs = [[0.0 if s == "x" else float(f"{s}1") for s in p] for p in self.patterns]
        self._constant = np.repeat(np.array(signs).T, self.corners.shape[1], axis=1)
        formulas = {k: system.plant.uncertainty.formula(k) for k in chain.acting}
        states = system.plant.states
        self._growing = {k: GrowthInFloats(f, states) for k, f in formulas.items() if f is not None}

    def escapes(self, half: np.ndarray) -> tuple[tuple[str, ...], np.ndarray] | None:
        """A pattern and a corner from which the loop escapes; None if there is none."""
        chain, n, m = self.chain, self.chain.n, len(self.chain.bounds) - 1
        x0 = np.tile(half[:, None] * self.corners, len(self.patterns))
        z = np.repeat(self.at_rest[:, None], x0.shape[1], axis=1)
        memories = self._first_memories()
        z[n:-m], z[:n] = 0.0, x0
        z[n : n + len(memories)] = memories @ x0
        assert chain.jump is not None
        with np.errstate(all="ignore"):
            for _ in range(self.samples):
                z = chain.jump.J @ z
                for cell in chain.cells:
                    w = self._signs(z) * self._sizes(z[:n])
                    z = cell.E @ z + cell.G @ w + cell.offset[:, None]
                gone = ~(np.abs(z[:n]) < ESCAPED).all(axis=0)
                if gone.any():
                    i = int(np.argmax(gone))
                    return self.patterns[i // self.corners.shape[1]], x0[:, i]
        return None

    def _signs(self, z: np.ndarray) -> np.ndarray:
        """Of every uncertain term, in every run."""
        with_state = np.tanh(z[list(self.chain.acting)] / SIGN_WIDTH)
        signs: np.ndarray = np.where(self._constant == 0, with_state, self._constant)
        return signs

    def _sizes(self, x: np.ndarray) -> np.ndarray:
        """Bounds of the uncertain terms that act."""
        u, rows = self.system.plant.uncertainty, []
        for k in self.chain.acting:
            norm = np.linalg.norm(np.array(u.norm_weights(k))[:, None] * x, axis=0)
            grown = self._growing.get(k)
            rows.append(u.largest(k, x) if grown is None else grown.value(x, norm))
        return np.array(rows)

    def _first_memories(self) -> np.ndarray:
        """The memories before the first sample, over x(0): there are no differences yet."""
        system, implementation = self.system, self.system.implementation
        assert implementation is not None
        names, rows = system.plant.states, []
        eye = np.eye(self.chain.n)
        for i, name in enumerate(names):
            if name in implementation.velocity:
                rows += [eye[i - 1], 0 * eye[0]]
        return np.array(rows).reshape(len(rows), self.chain.n)

    def written(self, pattern: tuple[str, ...], x0: np.ndarray) -> System:
        """The system that begins there, with these uncertain terms."""
        system, chain = self.system, self.chain
        u, names = system.plant.uncertainty, system.plant.states
        omega = ["0"] * chain.n
        for s, k in zip(pattern, chain.acting, strict=True):
            sign = f"tanh({names[k]}/{SIGN_WIDTH!r})" if s == "x" else f"{s}1"
            bound = u.bound_formula(k, names, SIGN_WIDTH)
            omega[k] = f"{WITHIN_BOUND!r}*({sign})*({bound})"
        truth = replace(system.truth, omega=tuple(omega), tau=u.tau)  # type: ignore[arg-type]
        settings = replace(system.settings, x0=tuple(x0.tolist()))
        title = f"First escape found for: {system.title}"
        return system.replace(truth=truth, settings=settings, title=title)

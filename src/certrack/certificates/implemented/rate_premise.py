"""The rates of uncertain terms, held against the truth of the same file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import sympy

from certrack.certificates.arithmetic import fraction, rational
from certrack.certificates.assumption_1 import UncertainTerm, uncertain_terms
from certrack.certificates.implemented.proof import ImplementedProof
from certrack.certificates.premise import ASSUMED, CHECKED, CONTRADICTED, PROVEN, Premise
from certrack.certificates.premises_of_truth import SEED
from certrack.certificates.sampling import RANDOM_POINTS, Points, random_points
from certrack.core.expressions import TIME
from certrack.model.slowness import Slowness
from certrack.systems.system import System

#: Begin of the premises' names.
RATE_OF = "rate of "


def rate_premises(system: System, proofs: Sequence[ImplementedProof]) -> Iterator[Premise]:
    """How fast the terms of the truth are, where proofs use it."""
    if not any(proof.slow for proof in proofs):
        return
    u, terms = system.plant.uncertainty, {term.k: term for term in uncertain_terms(system)}
    points = random_points(system.plant.n, system.settings.duration, SEED)
    split = any(proof.split for proof in proofs)
    for k, strength in enumerate(u.tau):
        slowness = u.slowness(k)
        if strength and u.acts(k) and slowness is not None:
            of_states = split and any(slowness.by_states) and not slowness.jump
            yield _Rate(system, k, slowness, of_states).premise(terms.get(k), points)


@dataclass(frozen=True)
class _Rate:
    """What is said of one w_k, from 0; and whether a proof needs it to be a function of x."""

    system: System
    k: int
    slowness: Slowness
    of_states: bool

    @property
    def stated(self) -> str:
        """In words."""
        s, states = self.slowness, self.system.plant.states
        by_states = [f"{c:g} |d{x}|" for c, x in zip(s.by_states, states, strict=True) if c]
        what = "is a function of t and x, without hysteresis, that " if self.of_states else ""
        most = " + ".join([f"{s.rate:g} dt", *by_states])
        text = f"w_{self.k + 1} {what}changes by at most {most}"
        if s.jump:
            text += f", but for jumps of at most {s.jump:g}, at least {s.dwell:g} s apart"
        if not s.fast:
            return text
        text += f", and a part of at most {s.fast:g} of any speed"
        if not self.of_states:
            return text
        return f"{text}, without which w_{self.k + 1} stays so much below its bound"

    def premise(self, term: UncertainTerm | None, points: Points) -> Premise:
        """The premise; no term where the truth has states of its own."""
        name = f"{RATE_OF}w_{self.k + 1}"
        if term is None or term.zero:
            status = ASSUMED if term is None else PROVEN
            return Premise(name, status, self.stated, remedy="" if term else NOT_SEEN)
        if _has_jumps(term.formula):
            if self.slowness.jump or self.slowness.fast:
                return Premise(name, ASSUMED, f"{self.stated} (assumed of sign)", remedy=NOT_SEEN)
            what = f"{self.stated}, but truth.omega[{self.k}] has sign in it, and may jump"
            remedy = f"state jump[{self.k}] and dwell, or write it with tanh or abs"
            return Premise(name, CONTRADICTED, what, {}, remedy)
        if not _is_continuous(term.formula):
            how = "truth.omega has a quotient, tan or atan2 in it: assumed not to jump there"
            return Premise(name, ASSUMED, f"{self.stated} ({how})", remedy=NOT_SEEN)
        slopes = self._slopes(term)
        if all(slope.proven for _, slope, _ in slopes):
            return Premise(name, PROVEN, f"{self.stated}, for all t and x")
        if self.slowness.jump or self.slowness.fast:
            how = "which part of truth.omega is slow is not told apart"
            return Premise(name, ASSUMED, f"{self.stated}; {how}", remedy=NOT_SEEN)
        for what, slope, key in slopes:
            place = None if slope.proven else slope.exceeded(points)
            if place is not None:
                return self._broken(name, what, slope, key, place)
        how = f"no faster change at {RANDOM_POINTS} random points, the worst polished"
        return Premise(name, CHECKED, f"{self.stated}: {how}")

    def _slopes(self, term: UncertainTerm) -> list[tuple[str, UncertainTerm, str]]:
        """The derivatives by t and by each state as terms with bounds of their own."""
        key, states = f"rate[{self.k}]", self.system.plant.states
        bounds = [("t", TIME, self.slowness.rate, key)]
        for j, (name, x) in enumerate(zip(states, term.states, strict=True)):
            bounds.append((name, x, self.slowness.by_states[j], f"Delta_rate[{self.k}][{j}]"))
        slopes = []
        for name, symbol, bound, where in bounds:
            exact, zero = rational(bound), Fraction(0)
            slope = replace(
                term,
                formula=_derivative(term.formula, symbol),
                gamma=zero,
                beta=fraction(exact),
                single=(),
                growing=None,
            )
            slopes.append((name, slope, where))
        return slopes

    def _broken(
        self, name: str, what: str, slope: UncertainTerm, key: str, place: Points
    ) -> Premise:
        value, limit = float(slope.size(place)[0]), float(slope.limit(place)[0])
        t, x = float(place.t[0]), place.x[:, 0].tolist()
        detail = (
            f"{self.stated}, but tau |dw_{self.k + 1}/d{what}| = {value:.6g} > {limit:.6g} at "
            f"t = {t:.4g}, x = [{', '.join(f'{v:.6g}' for v in x)}]"
        )
        witness = {"t": t, "x": x, "value": value, "limit": limit}
        return Premise(name, CONTRADICTED, detail, witness, f"raise plant.uncertainty.{key}")


#: Why nothing here looks at it.
NOT_SEEN = (
    "watch it on the plant, or keep the bound without rates (leave plant.uncertainty.rate out)"
)


def _has_jumps(formula: sympy.Expr) -> bool:
    """Whether it may have jumps; a kink has none."""
    return bool(
        formula.has(sympy.sign, sympy.Heaviside, sympy.floor, sympy.ceiling, sympy.Piecewise)
    )


def _is_continuous(formula: sympy.Expr) -> bool:
    """Whether a formula without :func:`_has_jumps` has surely no jump, as atan(1/t) has one."""
    if formula.has(sympy.tan, sympy.atan2):
        return False
    return all(
        power.exp.is_nonnegative or power.base.is_zero is False
        for power in formula.atoms(sympy.Pow)
    )


def _derivative(formula: sympy.Expr, symbol: sympy.Symbol) -> sympy.Expr:
    """Of a formula that has kinks at most."""
    slope = sympy.diff(formula, symbol)
    return slope.replace(sympy.Heaviside, lambda *v: (1 + sympy.sign(v[0])) / 2)

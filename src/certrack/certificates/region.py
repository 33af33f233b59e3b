"""Premises that the truth keeps where the states are, but not far away.

As long as the states stay in a region |x_i| <= X_i, the bounds of w and the formulas need to hold
there only. Where they hold there, and the states of a run from x0 are then strictly inside, they
never leave: at the first time of leaving they would still be inside. Who knows such a region says
so: the peaks of the implemented loop, or the level set of a quadratic function.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import partial

import numpy as np

from certrack.certificates.arithmetic import rational
from certrack.certificates.assumption_1 import UncertainTerm, uncertain_terms
from certrack.certificates.domain import conditions
from certrack.certificates.exact import float_up
from certrack.certificates.premise import CHECKED, PROVEN, Premise
from certrack.certificates.premises_of_truth import DOMAIN, SEED, formulas_of_states
from certrack.certificates.sampling import RANDOM_POINTS, Points, random_points
from certrack.core.rounding import rounded_up
from certrack.systems.system import System

#: Sizes of x_1 ... x_n that the states do not exceed.
StateBounds = tuple[Fraction, ...]

#: End of the name of a premise that holds in a region only.
IN_REGION = " in the region"


def in_region(
    system: System,
    premises: Sequence[Premise],
    region: StateBounds | None,
    *,
    formulas: bool = False,
    sampled: bool = True,
) -> tuple[Premise, ...]:
    """The premises, those that are broken far away only replaced by what holds in the region.

    Parameters
    ----------
    system : System
    premises : of :func:`~certrack.certificates.premises_of_truth.premises`
    region : n Fractions, or None
        What the states keep from x0; None if that is not known.
    formulas : bool
        Whether drift and regressor, too, need to be defined in the region only.
    sampled : bool
        Whether a bound of w that is not proven in the region may be checked on samples there.
    """
    if region is None:
        return tuple(premises)
    terms = {term.name: term for term in uncertain_terms(system)}

    def instead(premise: Premise) -> Premise:
        held = None
        broken = premise.contradicted and not _witness_in_region(premise, region)
        if broken and premise.name in terms:
            held = _term_in_region(system, terms[premise.name], region, sampled)
        if broken and premise.name == DOMAIN and formulas:
            held = _domain_in_region(system, region)
        return held or premise

    return tuple(map(instead, premises))


def is_only_in_region(rests_on: Sequence[Premise]) -> bool:
    """Whether a premise holds in a region only: then nothing is claimed but from x0."""
    return any(premise.name.endswith(IN_REGION) for premise in rests_on)


def claim_text(bound: str, from_x0: bool) -> str:
    """What a certificate file claims, of every start or of the file's own."""
    claim = f"limsup |e_1(t)| <= {bound}"
    return f"{claim} from simulation.x0" if from_x0 else claim


def while_within(system: System, region: StateBounds) -> str:
    """A region in words."""
    pairs = zip(system.plant.states, region, strict=True)
    return ", ".join(f"|{x}| <= {rounded_up(float_up(rational(r)), 4)}" for x, r in pairs)


def _witness_in_region(premise: Premise, region: StateBounds) -> bool:
    """Whether the point that breaks a premise is where the states may be."""
    x = (premise.witness or {}).get("x")
    if x is None:
        return False
    return all(abs(Fraction(v)) <= size for v, size in zip(x, region, strict=True))


def _term_in_region(
    system: System, term: UncertainTerm, region: StateBounds, sampled: bool
) -> Premise | None:
    """That a term keeps its bound in the region; None if it does not, or nobody knows."""
    proven, how = term.proven_within(region), ""
    if not proven and not sampled:
        return None
    if not proven:
        points = random_points(system.plant.n, system.settings.duration, SEED)
        if term.violation(points, within=partial(_within, region=region)) is not None:
            return None
        how = f"; no point beyond it among {RANDOM_POINTS} random ones there, the worst polished"
    detail = f"tau |{term.name}| <= {term.allowance} holds"
    return _premise_of_region(term.name, PROVEN if proven else CHECKED, detail, system, region, how)


def _domain_in_region(system: System, region: StateBounds) -> Premise | None:
    """That drift and regressor are defined in the region; None if that is not proven."""
    states = system.plant.symbols
    formulas, named = formulas_of_states(system)
    needed = [c for formula in formulas.values() for c in conditions(formula)]
    if not all(condition.proven(states, region) for condition in needed):
        return None
    return _premise_of_region(DOMAIN, PROVEN, f"{named} are defined", system, region)


def _premise_of_region(
    name: str, status: str, detail: str, system: System, region: StateBounds, how: str = ""
) -> Premise:
    where = f"{detail} while {while_within(system, region)}"
    return Premise(
        f"{name}{IN_REGION}", status, f"{where}, which the states keep from simulation.x0{how}"
    )


def _within(points: Points, region: StateBounds) -> Points:
    """The points, those beyond the region moved to its edge on the ray to the origin."""
    sizes = np.array([float(r) for r in region])[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(points.x == 0, np.inf, sizes / np.abs(points.x)).min(axis=0)
    return Points(points.t, points.x * np.minimum(room, 1.0) * (1 - 1e-12))

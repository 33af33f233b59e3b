"""The limit that members are held against: the user's, or the certificate where it applies."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from certrack.certificates import best_sound_bound
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.certify import (
    ImplementedCertificate,
    certify_implemented,
)
from certrack.certificates.implemented.from_starts import ANY_START, NO_START
from certrack.certificates.implemented.input_limits import is_limited
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.ranges.formulas import untrue_formulas
from certrack.certificates.scope import has_ranges
from certrack.core import checks
from certrack.core.memo import remembered
from certrack.model.distribution import Distribution
from certrack.model.disturbance import Multisine
from certrack.model.population import Population
from certrack.references import SoftStart
from certrack.systems.system import System


def tail_error_limit(system: System, limit: float | None) -> tuple[float | None, str]:
    """Limit of the tail error, and where it comes from; see :func:`limit_and_starts`."""
    return limit_and_starts(system, limit)[:2]


def limit_and_starts(
    system: System, limit: float | None
) -> tuple[float | None, str, ImplementedCertificate | None]:
    """Limit of the tail error, where it comes from, and the starts it holds for.

    Parameters
    ----------
    system : System
    limit : float, optional
        The user's, which goes before all others.

    Returns
    -------
    limit : float or None
    origin : str
        ``"given"``, ``"file"``, ``"certificate"``, or why there is none.
    proven : ImplementedCertificate or None
        Whose starts the limit holds for; None if it is for all.
    """
    population = system.varied
    if limit == math.inf:
        return None, "none was asked for", None
    if limit is not None:
        return checks.real("limit", limit, above=0), "given", None
    if population.limit is not None:
        return population.limit, "file", None
    return _certified(system)


def is_certified(system: System) -> bool:
    """Whether a certificate covers every member: then none can run away."""
    return _certified(system)[1] == "certificate"


@remembered
def _certified(system: System) -> tuple[float | None, str, ImplementedCertificate | None]:
    """The limit by the certificate, its origin and the starts that it is proven for."""
    population = system.varied
    reason = uncovered(system, population)
    if reason is not None:
        return None, f"no certificate covers the population: {reason}", None
    if system.implementation is not None:
        sampled, _ = certify_implemented(system if is_limited(system) else system.long_run)
        if sampled.exists and sampled.starts != NO_START:
            proven = None if sampled.starts == ANY_START else sampled
            if proven is not None and isinstance(system.reference, SoftStart):
                what = "from the starts that are proven, each member has its own soft start"
                return None, f"no certificate covers the population: {what}", None
            return sampled.bound, "certificate", proven
        return None, f"no certificate covers the sampled loop: {sampled.reason}", None
    bound = best_sound_bound(system)
    if math.isfinite(bound):
        return bound, "certificate", None
    return None, "no certificate exists", None


def started_inside(
    system: System, proven: ImplementedCertificate, draws: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Which members start where a limit is proven.

    Parameters
    ----------
    system : System
    proven : ImplementedCertificate
    draws : mapping
        What was drawn for each member.
    """
    members = len(next(iter(draws.values()), np.zeros(1)))
    columns = [
        np.broadcast_to(draws.get(f"x0[{i}]", v), members) for i, v in enumerate(system.settings.x0)
    ]
    x0, population = np.array(columns).T, system.varied
    if population.amplitude is None and population.frequency is None:
        return np.asarray(proven.admits(x0))
    if proven.polytope is None:  # what is proven of x0 is for the file's own reference
        return np.zeros(len(x0), dtype=bool)
    return proven.polytope.contains(x0)


def uncovered(system: System, population: Population) -> str | None:
    """Why the certificate's assumptions do not hold for every member; None if they do."""
    if system.truth.states:
        return "the simulated plant has states of its own, the certified one has the design's form"
    plant, u = system.plant, system.plant.uncertainty
    nominal = {name: float(value) for name, value in plant.constant_values.items()}
    drawn = dict(population.constants)
    moved = {name for name, entry in drawn.items() if not _is(entry, nominal[name])}
    moved |= {name for name, _ in system.truth.constants}
    if moved - set(plant.constant_boxes):  # others are within their ranges: the loader checks
        return "the plant's constants are not the designer's"
    reason = (
        _ranges_left(system, moved) if has_ranges(system) else _numbers_left(system, population)
    )
    if reason is not None:
        return reason
    assert system.truth.tau is not None
    strengths = [entry.high for entry in population.tau or ()] or list(system.truth.tau)
    if any(value > limit for value, limit in zip(strengths, u.tau, strict=True)):
        return "tau exceeds plant.uncertainty.tau"
    amplitude, frequency = population.amplitude, population.frequency
    if amplitude is not None and max(abs(amplitude.low), abs(amplitude.high)) > 1:
        return "the reference's amplitude exceeds the one certified"
    if frequency is not None and frequency.high > 1:
        return "the reference's frequency exceeds the one certified"
    if population.disturbance not in ("file", Multisine.kind):
        return "its disturbances are of a registered family, whose bound is checked on samples only"
    return _contradiction(system, population)


def _ranges_left(system: System, moved: set[str]) -> str | None:
    """The same of g_n and theta where constants have ranges: they must follow what is drawn."""
    try:
        untrue = untrue_formulas(system) if moved else []
    except NoCertificate as refusal:
        return str(refusal)
    if untrue:
        drawn, names = ", ".join(sorted(moved)), " and ".join(f"truth.{name}" for name in untrue)
        return f"members draw {drawn}, and {names} does not follow as the plant's formula does"
    return None


def _numbers_left(system: System, population: Population) -> str | None:
    """Why g_n and theta of the members are not those that were certified; None if they are."""
    plant = system.plant
    certified = plant if system.law.kind == "robust" else system.truth
    assert certified.input_gain is not None
    assert system.truth.input_gain is not None
    nominal_gain = float(certified.input_gain.expr)
    true_gain = float(system.truth.input_gain.expr)
    gain = population.input_gain or Distribution("fixed", (true_gain,))
    if plant.input_gain_range is None and not _is(gain, nominal_gain):
        return "input_gain is another than certified, and plant.ranges does not say how far"
    for entry, value in zip(population.theta or (), certified.theta or (), strict=False):
        if plant.theta_range is None and not _is(entry, float(value.expr)):
            return "theta is another than certified, and plant.ranges does not say how far"
    return None


def _contradiction(system: System, population: Population) -> str | None:
    """A premise that the members break with the file's truth, in what the population leaves."""
    drawn = {"input gain": population.input_gain, "theta": population.theta}
    for premise in contradicted(premises(system)):
        term = premise.name.startswith("w_")
        replaced = population.disturbance != "file" if term else drawn.get(premise.name)
        if not replaced:
            return f"Assumption 1: {premise.detail}" if term else premise.detail
    return None


def _is(entry: Distribution, value: float) -> bool:
    return entry.low == entry.high == value

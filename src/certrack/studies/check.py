"""What can be said of a system without a solver: of its premises, period, quanta and units."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from certrack.certificates.assumption_1 import uncertain_terms
from certrack.certificates.cover import Cover, smallest_cover
from certrack.certificates.premise import Premise, contradicted
from certrack.certificates.premises_of_truth import SEED, premises
from certrack.certificates.sampling import random_points
from certrack.core.blas import one_blas_thread
from certrack.core.rounding import rounded_down
from certrack.laws.leakage import leak_matrix
from certrack.loops.stability import linear_loop
from certrack.model.implementation import Implementation
from certrack.simulation.implementation_notes import (
    ALTERNATING_LEAK,
    LARGE_POLE_PERIOD,
    SMALL_POLE_PERIOD,
    longest_speed_period,
)
from certrack.simulation.remedies import (
    poles_near_gains,
    shorter_period,
    slower_law,
    takes_differences,
)
from certrack.studies.norm_weights import proposed_weights
from certrack.studies.units import misfits
from certrack.systems.system import System, require_system

FINE, NOTE, WARNING, FAULT = "fine", "note", "warning", "fault"

#: Part of the input's range that one step of a sensor should not move it by.
LARGE_INPUT_STEP = 0.1


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    name : str
        E.g. ``"poles x period"`` or ``"quantum of x2"``.
    status : {"fine", "note", "warning", "fault"}
        A fault is what cannot work.
    detail : str
    remedy : str
        Empty where nothing has to be done.
    """

    name: str
    status: str
    detail: str
    remedy: str = ""


@dataclass(frozen=True)
class Check:
    """Result of :func:`check`.

    Attributes
    ----------
    premises : tuple of Premise
        What a certificate would rest on, held against the file's own truth.
    covers : tuple of Cover
        The smallest gamma and beta that cover each term of the truth.
    findings : tuple of Finding
        Poles and period, leaks, quanta, units.
    """

    premises: tuple[Premise, ...]
    covers: tuple[Cover, ...]
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        bad = [premise.name for premise in self.contradicted]
        wrong = [f"{len(bad)} premises contradicted"] if bad else []
        wrong += [f"{len(self.faults)} faults"] if self.faults else []
        warned = sum(finding.status == WARNING for finding in self.findings)
        return f"Check({', '.join(wrong) or 'sound'}; {warned} warnings)"

    @property
    def contradicted(self) -> tuple[Premise, ...]:
        """Premises that the file's own truth breaks."""
        return contradicted(self.premises)

    @property
    def faults(self) -> tuple[Finding, ...]:
        """What cannot work."""
        return tuple(finding for finding in self.findings if finding.status == FAULT)

    @property
    def sound(self) -> bool:
        """Whether no premise is contradicted and nothing is a fault."""
        return not self.contradicted and not self.faults

    def summary(self) -> dict[str, Any]:
        """Ready for JSON.

        Returns
        -------
        dict

        Examples
        --------
        >>> import certrack
        >>> list(certrack.check(certrack.load("example1")).summary())
        ['sound', 'premises', 'covers', 'findings']
        """
        return {
            "sound": self.sound,
            "premises": [premise.record() for premise in self.premises],
            "covers": [vars(cover) for cover in self.covers],
            "findings": [vars(finding) for finding in self.findings],
        }


@one_blas_thread
def check(system: System) -> Check:
    """Look at `system` without a solver: premises, poles and period, quanta, units.

    Parameters
    ----------
    system : System

    Returns
    -------
    Check

    Examples
    --------
    >>> import certrack
    >>> found = certrack.check(certrack.load("example1"))
    >>> found.sound, found.covers[0].gamma
    (True, 0.5)
    """
    require_system(system)
    points = random_points(system.plant.n, system.settings.duration, SEED)
    covers = tuple(smallest_cover(term, points) for term in uncertain_terms(system))
    return Check(premises(system), covers, tuple(_findings(system)))


def _findings(system: System) -> Iterator[Finding]:
    implementation = system.implementation
    if implementation is None:
        fastest = system.controller.fastest_pole
        detail = f"fastest {fastest:.4g} rad/s; no [implementation], so no period to compare"
        yield Finding("poles", NOTE, detail, poles_near_gains(system))
    else:
        yield _pole_period(system, implementation)
        yield from _sampled_stability(system, implementation)
        yield from _leaks(system, implementation)
        yield from _sensor_quanta(system, implementation)
        yield from _input_quantum(system, implementation)
    yield from _units(system)
    yield from _scales(system)


def _pole_period(system: System, implementation: Implementation) -> Finding:
    """The fastest pole of the error system against the period and the delay."""
    fastest = system.controller.fastest_pole
    lag = implementation.period * (1 + max(implementation.delays))
    product = fastest * lag
    what = "period" if not max(implementation.delays) else "(period + delay)"
    detail = f"fastest pole {fastest:.4g} rad/s x {what} {lag:.4g} s = {product:.3g}"
    longest = SMALL_POLE_PERIOD / (fastest * (1 + max(implementation.delays)))
    remedy = f"take a period of {rounded_down(longest, 2)} s or less, or {slower_law(system)}"
    if product > LARGE_POLE_PERIOD:
        return Finding("poles x period", WARNING, f"{detail}, above {LARGE_POLE_PERIOD:g}", remedy)
    if product > SMALL_POLE_PERIOD:
        return Finding("poles x period", NOTE, f"{detail}: sampling will be felt", remedy)
    return Finding("poles x period", FINE, detail)


def _sampled_stability(system: System, implementation: Implementation) -> Iterator[Finding]:
    """The eigenvalues of one period where the loop is linear, else its speed."""
    loop = linear_loop(system)
    if loop is None:
        longest = longest_speed_period(system.controller.fastest_pole, max(implementation.delays))
        if implementation.period >= longest:
            yield Finding(
                "sampled stability",
                FAULT,
                f"the period of {implementation.period:g} s is too long for the fastest error "
                f"pole: a sampled loop of this speed is unstable from {longest:.3g} s on",
                shorter_period(system),
            )
        return
    radius = max(loop.radius(implementation.period, delay) for delay in implementation.delays)
    detail = f"largest eigenvalue of one period of the nominal loop: {radius:.6g}"
    if radius < 1:
        yield Finding("sampled stability", FINE, detail)
        return
    yield Finding(
        "sampled stability",
        FAULT,
        f"{detail}, not below 1: the loop is unstable as it is sampled",
        shorter_period(system),
    )


def _leaks(system: System, implementation: Implementation) -> Iterator[Finding]:
    """The forgetting of the estimates, by forward Euler; beyond 2 the system is not made at all."""
    if implementation.update != "euler":
        return
    for name, rate in _leak_rates(system).items():
        product = rate * implementation.period
        detail = f"leak of {name} {rate:.4g} 1/s x period = {product:.3g}"
        remedy = f'set implementation.update = "exact_leak", or a period below {1 / rate:.2g} s'
        if product > ALTERNATING_LEAK:
            text = f"{detail} > {ALTERNATING_LEAK:g}: the estimate alternates at every step"
            yield Finding("leak x period", WARNING, text, remedy)
        else:
            yield Finding("leak x period", FINE, detail)


def _leak_rates(system: System) -> dict[str, float]:
    """The fastest leak (1/s) of each group of estimates that leak together, by their names."""
    leak, names = leak_matrix(system.controller), [str(s) for s in system.controller.states]
    count, group = connected_components(leak != 0, directed=False)
    members = [np.flatnonzero(group == i) for i in range(count)]
    rates = {
        ", ".join(names[i] for i in block): float(
            np.abs(np.linalg.eigvals(leak[np.ix_(block, block)])).max()
        )
        for block in members
    }
    return {name: rate for name, rate in rates.items() if rate > 0}


def _sensor_quanta(system: System, implementation: Implementation) -> Iterator[Finding]:
    """What one step of each sensor does to the error and to the input."""
    plant, coordinates = system.plant, system.controller.coordinates
    quanta = list(implementation.measurement_quantum or (0.0,) * plant.n)
    origin = [""] * plant.n
    differenced = takes_differences(system)
    other = "a finer sensor or a velocity filter" if differenced else "a finer sensor"
    for i, state in enumerate(plant.states):
        if state in implementation.velocity and not differenced:  # an observer's
            quanta[i] = 0.0
        elif state in implementation.velocity:  # a filtered difference of the one before
            span = implementation.period + implementation.velocity_filter
            quanta[i] = quanta[i - 1] / span / abs(plant.g[i - 1])
            origin[i] = f", from differences of {plant.states[i - 1]}"
    gain = _input_gain(system)
    for i, (state, quantum) in enumerate(zip(plant.states, quanta, strict=True)):
        if not quantum:
            continue
        step = abs(float(coordinates.nu_x[i])) * quantum / gain
        detail = f"one step of {quantum:.4g}{origin[i]} moves u by {step:.4g}"
        status, remedy = FINE, ""
        if i == 0:
            detail += f"; no error below {quantum / 2:.4g} can be seen"
            band = system.settings.band
            if band is not None and quantum / 2 > band:
                status, remedy = WARNING, "the settling band is finer: take a finer sensor"
                detail += f", simulation.band is {band:.4g}"
        if implementation.saturation is not None:
            low, high = implementation.saturation
            if step > LARGE_INPUT_STEP * (high - low):
                status, remedy = WARNING, f"{slower_law(system)}, or take {other}"
                detail += f", {100 * step / (high - low):.3g} % of the input's range"
        yield Finding(f"quantum of {state}", status, detail, remedy)


def _input_gain(system: System) -> float:
    """|g_n|: the law's, else the true one."""
    known = system.plant.input_gain or system.truth.input_gain
    if known is not None:
        return abs(float(known.expr))
    low, high = system.plant.input_gain_range or (math.inf, math.inf)
    return min(abs(low), abs(high))


def _input_quantum(system: System, implementation: Implementation) -> Iterator[Finding]:
    """The converter's step as a disturbance of the last row."""
    quantum = implementation.input_quantum
    if not quantum:
        return
    u, n = system.plant.uncertainty, system.plant.n
    effect = _input_gain(system) * quantum / 2
    allowed = u.tau[n - 1] * u.beta[n - 1]
    detail = (
        f"half a step acts as a disturbance g_n q/2 = {effect:.4g} beside "
        f"tau_n beta_n = {allowed:.4g}"
    )
    if effect > allowed:
        remedy = f"a finer converter, or beta[{n - 1}] that covers it"
        yield Finding("quantum of u", WARNING, detail, remedy)
    else:
        yield Finding("quantum of u", FINE, detail)


def _units(system: System) -> Iterator[Finding]:
    plant = system.plant
    if plant.units is None:
        yield Finding("units", NOTE, "plant.units are not stated, so nothing was compared")
        return
    wrong = misfits(plant.units, [float(v) for v in plant.g])
    for i, expected in wrong:
        a, b = plant.states[i], plant.states[i + 1]
        yield Finding(
            "units",
            WARNING,
            f"{a}' = {b} (chain[{i}] = 1), but {a} is in {plant.units[i]} and {b} in "
            f"{plant.units[i + 1]}, not {expected}",
            f"state {b} in {expected}, or the factor between them in plant.chain[{i}]",
        )
    if not wrong:
        yield Finding("units", FINE, "every x_{i+1} is in the unit of x_i per second where g_i = 1")
    u = plant.uncertainty
    grows = any(t * g for t, g in zip(u.tau, u.gamma, strict=True))
    if grows and len(set(plant.units[: plant.n])) > 1:
        mixed = ", ".join(dict.fromkeys(plant.units[: plant.n]))
        yield Finding(
            "norm",
            NOTE,
            f"||x|| of Assumption 1 adds squares of {mixed}: gamma depends on the choice of units",
        )


def _scales(system: System) -> Iterator[Finding]:
    """Whether the states differ so much in size that the norm of gamma hardly sees some."""
    weights = proposed_weights(system)
    if weights is not None:
        yield Finding("scales of states", NOTE, weights.text(system.plant.states), weights.remedy)

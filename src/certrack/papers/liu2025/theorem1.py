"""Theorem 1 and Corollary 1: what is proven, what is refuted, and by which systems.

The proof ends: V' < 0 while |e_1| > r (41), so |e_1| falls until it is r or less (42). But V is the
sum of the energy of the errors and that of the estimates, and it may fall while energy passes from
the estimates to e_1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from certrack.certificates.assumption_1 import check_assumption_1
from certrack.certificates.published import certify_published, collect
from certrack.core.rounding import rounded_up
from certrack.laws.adaptive import Adaptive
from certrack.papers.liu2025.claim import AMBIGUOUS, Claim, judged
from certrack.papers.liu2025.runs import CERTIFIED, COUNTEREXAMPLE, PaperRuns
from certrack.simulation.run import Run
from certrack.systems.reader import load
from certrack.systems.system import System

#: Distance in s of the samples in which a pulse of the counterexample is searched for its peak.
PULSE_SPACING = 1e-4

#: Distance in s of the samples of the system with a switch, which swings at 1.8 rad/s.
SWITCHED_SPACING = 2e-3

#: Period of the counterexample's reference, s.
REFERENCE_PERIOD = 200 * math.pi


def theorem1_claims(runs: PaperRuns) -> Iterator[Claim]:
    """Theorem 1, its proof and Corollary 1, judged."""
    names = [name for name in (*CERTIFIED, COUNTEREXAMPLE) if name != "dual-motor-lean"]
    adaptive = [name for name in names if "motor" not in name]
    robust = [name for name in names if "motor" in name]
    yield Claim(
        "Theorem 1; abstract",
        "under (25), (26) all signals of the closed loop are bounded",
        "exact proof that V' <= -alpha V + Delta for all states and all that the assumptions "
        "admit, since no run could show it",
        _proofs(runs, adaptive),
        judged(all(runs.certificates[name].semidefinite.verified for name in adaptive)),
    )
    yield Claim(
        "Theorem 1, existence of tau_bar; (35), (36)",
        "it is enough that a tau_bar exists with tau_j < tau_bar",
        "tau_bar = sqrt(min c/mu_3) of the proof, with the gains of the examples and eps near 0, "
        "beside their largest tau, since as stated any tau is below some tau_bar",
        "; ".join(_tau_bar_text(name) for name in ("example1", "dual-motor", "dual-motor-strong")),
        AMBIGUOUS,
    )
    yield _radius(runs)
    yield _last_step()
    yield Claim(
        "Corollary 1",
        "with g_n and theta known, under the robust law the signals and the tracking error are "
        "bounded",
        "exact proof as for Theorem 1; rho_2 is 1/2 here, so (42) is a true bound",
        _proofs(runs, robust),
        judged(all(runs.certificates[name].semidefinite.verified for name in robust)),
    )


def _proofs(runs: PaperRuns, names: list[str]) -> str:
    parts = []
    for name in names:
        certificates = runs.certificates[name]
        state = "verified" if certificates.semidefinite.verified else "not proven"
        parts.append(f"{name}: {state}, alpha = {certificates.semidefinite.alpha:.3g} /s")
    return "; ".join(parts)


def tau_bar(system: System) -> float:
    """tau_bar of the proof [35], [36] for the gains of `system`, as eps goes to 0.

    sqrt(min c/mu_3), mu_3 = ||A^{-1}||_F^2 sum_l sum_{j<=l} k_{l,2j-1} gamma_j^2.
    """
    terms, k = collect(system, critical=True), system.law.gains().k
    assert k is not None
    gamma = system.plant.uncertainty.gamma
    weight = sum(
        k[step][2 * j] * gamma[j] ** 2
        for step in range(len(k))
        for j in range(step + 1)
        if gamma[j]
    )
    return math.sqrt(terms.c_min / (terms.A_norm2 * weight))


def _tau_bar_text(name: str) -> str:
    system = load(name)
    limit, largest = tau_bar(system), max(system.plant.uncertainty.tau)
    return f"{name}: {limit:.5g}, tau = {largest:g} is {100 * largest / limit:.0f} % of it"


def _radius(runs: PaperRuns) -> Claim:
    certificates = runs.certificates[COUNTEREXAMPLE]
    peaks = period_peaks(runs.counterexample)
    other = max(period_peaks(runs.confirmation)[1:])
    limit = certificates.published.bound
    assert meets_premises(runs.counterexample.system)
    falls = "falls" if energy_falls_beyond(runs.counterexample, limit) else "does not fall"
    return Claim(
        "Theorem 1, (42)",
        "the tracking error ends within sqrt(Delta_bar/rho_1)",
        "sup |e_1| in each period of y_d of theorem1-counterexample, a system that meets every "
        "premise: a bound on limsup is false if it is passed in every period",
        f"(42) gives {rounded_up(limit, 5)}; |e_1| reaches {', '.join(f'{v:.4f}' for v in peaks)} "
        f"in periods 1 to {len(peaks)} ({other:.4f} by SciPy); V {falls} while |e_1| is beyond "
        "(42), as (41) says; what is true: "
        f"corrected {rounded_up(certificates.corrected.bound, 4)}, "
        f"semidefinite {rounded_up(certificates.semidefinite.bound, 4)}",
        judged(max(peaks[1:]) <= limit),
    )


def meets_premises(system: System) -> bool:
    """Whether Theorem 1 speaks of `system`: law (25), (26), Assumption 1, mu_1 > 0, all k and p."""
    law, u = system.law, system.plant.uncertainty
    gains = law.gains()
    assert gains.k is not None and gains.p is not None
    finite = [value for row in gains.k for value in row] + list(gains.p)
    return (
        isinstance(law, Adaptive)
        and system.controller.coordinates.q == 0
        and all(0 < value < math.inf for value in finite)
        and all(value > 0 for value in (*u.tau, *u.gamma))
        and not check_assumption_1(system)
        and certify_published(system)["published"].exists
    )


def energy_falls_beyond(run: Run, limit: float) -> bool:
    """Whether V falls from sample to sample wherever |e_1| > limit."""
    beyond = np.flatnonzero(np.abs(run.e[0]) > limit)
    of_errors, of_estimates = energies(run, run.t)
    V = of_errors + of_estimates
    return bool(len(beyond)) and bool((np.diff(V)[beyond[beyond < len(V) - 1]] < 0).all())


def period_peaks(run: Run) -> list[float]:
    """Largest |e_1| in each period of the counterexample's reference."""
    peaks = []
    for k in range(round(run.trajectory.end / REFERENCE_PERIOD)):
        inside = (run.t >= k * REFERENCE_PERIOD) & (run.t <= (k + 1) * REFERENCE_PERIOD)
        t = run.t[inside][np.argmax(np.abs(run.e[0][inside]))]
        near = t + PULSE_SPACING * np.arange(-5000, 5001)
        near = near[(near >= 0) & (near <= run.trajectory.end)]
        y_d = run.system.reference.values(near, 0)[0]
        peaks.append(float(np.abs(run.trajectory.interpolate(near)[0] - y_d).max()))
    return peaks


def energies(run: Run, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Energy of the errors and of the estimates in V [23], for one theta."""
    system, n = run.system, run.system.plant.n
    law, gain = system.law, float(system.truth.input_gain.expr)  # type: ignore[union-attr]
    states = run.trajectory.interpolate(t)
    coordinates = system.controller.coordinates
    e = coordinates.A @ states[:n] - coordinates.B @ system.reference.values(t, coordinates.q)
    delta = states[n] - 1 / gain
    theta = states[n + 1] - float(system.truth.theta[0].expr)
    estimates = abs(gain) * delta**2 / (2 * law.gain_rate) + theta**2 / (2 * law.Gamma[0])  # type: ignore[attr-defined]
    return (e**2).sum(axis=0) / 2, estimates


def _last_step() -> Claim:
    """The step alone, by a linear system with a switch that meets its premise.

    e' = -e + S s(t) q,  q' = -gbar S s(t) e - gbar (q - 1),  s(t) = 1 where sin(0.01 t) > 0.6.
    V = e^2/2 + q^2/(2 gbar) has V' <= -||(e, q)||^2/2 + 1/2, so V falls wherever |e| > 1.
    """
    gbar, strength = 0.05, 8.0
    worst = switched_system_error(gbar, strength)
    corrected = math.sqrt(2 * max(0.5, 1 / (2 * gbar)))
    return Claim(
        "Theorem 1, from (41) to (42)",
        "V' < 0 while |e_1| > r implies limsup |e_1| <= r (last step of the proof)",
        "sup |e| in periods 2 to 4 of a linear system with a slow switch, for which the premise "
        "can be checked by hand",
        f"r = 1 and V' < 0 wherever |e_1| > 1, yet |e_1| returns to {worst:.2f} in every period; "
        f"the corrected bound is {rounded_up(corrected, 4)}",
        judged(worst <= 1),
    )


def switched_system_error(gbar: float = 0.05, strength: float = 8.0) -> float:
    """Largest |e| of the linear system with a switch in periods 2 to 4, by its exact solution."""
    on, off = math.asin(0.6), math.pi - math.asin(0.6)
    edges = sorted(100 * (2 * math.pi * k + phase) for k in range(4) for phase in (on, off))
    times = [0.0, *edges, 100 * 8 * math.pi]
    state, worst = np.array([0.0, 1.0]), 0.0
    for begin, end in pairwise(times):
        s = strength * (math.sin(0.005 * (begin + end)) > 0.6)
        matrix = np.array([[-1.0, s], [-gbar * s, -gbar]])
        equilibrium = np.linalg.solve(matrix, np.array([0.0, -gbar]))
        rates, modes = np.linalg.eig(matrix)
        shares = np.linalg.solve(modes, state - equilibrium)
        t = np.linspace(0.0, end - begin, 1 + round((end - begin) / SWITCHED_SPACING))
        states = (
            equilibrium[:, None] + (modes @ (shares[:, None] * np.exp(np.outer(rates, t)))).real
        )
        state = states[:, -1]
        if begin > 100 * 2 * math.pi:
            worst = max(worst, float(np.abs(states[0]).max()))
    return worst

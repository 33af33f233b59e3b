"""The worst case of the adaptive law as a drive runs it, searched on the sampled loop itself.

The cases of the continuous law (the search's, the ascent's, the kernels', the file's own) are run
as implemented, under the file's own sensor errors and under ones that stay at their bounds. The
worst is a candidate, and so is what a random search of the adversary's numbers finds from the best
point of the continuous search on, each run sampled, delayed, quantised and limited as the drive
does it. Every case begins where the errors are zero; where the sampled loop has a certificate, the
estimates begin in the middle of those that it is for, so that it covers the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import cast

import numpy as np

from certrack.certificates import Certificate
from certrack.certificates.exact import Proof
from certrack.certificates.methods import Methods
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import CONTINUOUS_LAW, premises
from certrack.certificates.sampled_adaptive.certify import certify_sampled_adaptive, starts_inside
from certrack.certificates.sampled_adaptive.proof import SampledAdaptiveProof
from certrack.core.errors import InputError
from certrack.core.progress import Progress
from certrack.model.implementation import Implementation
from certrack.simulation.run import Run
from certrack.simulation.sampled import SampledSimulator
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.drive import DriveFalsification, ending_of, may_be_limited
from certrack.studies.falsifier.linear.sampled import noise_bounds
from certrack.studies.falsifier.linear.search import NothingTried, tail_error
from certrack.studies.falsifier.loop import AdversarialLoop
from certrack.systems.system import System

#: Runs of the continuous search for each one of the sampled loop, which takes a thousand times as
#: long; and samples of all of them together, at most.
RUNS_PER_SAMPLED_RUN, MOST_SAMPLES = 100, 30_000_000

#: Sensors whose errors stay at a bound of either sign: all signs of the first ones are tried.
MAX_SIGNED_SENSORS = 2

#: Size of the first steps of the random search over the ranges, and of the smallest; a step that
#: helps makes the next one longer by this factor, and four that do not make it as much shorter.
WIDEST_MOVE, FINEST_MOVE, STEP_GROWTH = 0.2, 1e-3, 1.5

#: How often another pattern of sensor errors is tried.
OTHER_SENSORS = 0.2


@dataclass(frozen=True)
class SampledGuarantee:
    """What the worst case of the sampled adaptive loop is held against.

    Attributes
    ----------
    certificate : Certificate
        Not verified if a premise is contradicted.
    proof : SampledAdaptiveProof or None
    """

    certificate: Certificate
    proof: SampledAdaptiveProof | None


def guarantee_as_sampled(
    system: System, methods: Methods, effort: str, progress: Progress
) -> SampledGuarantee:
    """The certificate of the adaptive law as implemented.

    Parameters
    ----------
    system : System
        With an implementation.
    methods : Methods
        Certificates of the continuous law: where the proof begins.
    effort : {"fast", "default", "high"}
    progress : callable
    """
    first = next((v for v in methods.proofs.get("bootstrap", ()) if isinstance(v, Proof)), None)
    certificate: Certificate
    certificate, proof = certify_sampled_adaptive(system, effort, first, progress)
    broken = [p for p in contradicted(premises(system)) if p.name != CONTINUOUS_LAW]
    if broken and certificate.exists:
        reason = f"a premise is contradicted: {broken[0].detail}"
        certificate = replace(certificate, verified=False, reason=reason)
    return SampledGuarantee(certificate, proof)


def attack_as_implemented(
    system: System,
    guarantee: SampledGuarantee,
    cases: Mapping[str, System],
    seeded: tuple[AdversarialLoop, np.ndarray] | None,
    budget: int,
    seed: int,
    progress: Progress,
) -> DriveFalsification:
    """The worst case found of the adaptive law as implemented.

    Parameters
    ----------
    system : System
        With an implementation.
    guarantee : SampledGuarantee
    cases : mapping of str to System
        Of the continuous law, by origin.
    seeded : pair of AdversarialLoop and array, or None
        The best point of the continuous search.
    budget, seed : int
        Of the continuous search.
    progress : callable
        Gets the budget, twice, and the worst error so far.

    Raises
    ------
    NothingTried
        If no case can be written as a sampled system.
    """
    drive = system.implementation
    assert drive is not None
    sensors = _worst_sensor_errors(drive, system.plant.n)
    search = _SampledSearch(guarantee.proof, lambda worst: progress(budget, budget, worst))
    for case in cases.values():
        search.replay(case.replace(implementation=errors) for errors in sensors)
    if seeded is not None:
        search.spend(*seeded, sensors, budget // RUNS_PER_SAMPLED_RUN, np.random.default_rng(seed))
    if search.best is None:
        raise NothingTried("no case found can be written as a sampled system")
    case, run, error = search.best
    covered = guarantee.proof is not None and starts_inside(case, guarantee.proof)
    return DriveFalsification(
        error,
        None,
        case,
        ending_of(run),
        guarantee.certificate,
        limited=not covered or may_be_limited(case, run),
        runs=search.runs,
    )


class _SampledSearch:
    """Sampled runs, and the worst of them."""

    def __init__(self, proof: SampledAdaptiveProof | None, tell: Callable[[float], None]) -> None:
        self.runs, self.best = 0, cast("tuple[System, Run, float] | None", None)
        self._tell = tell
        priors = () if proof is None else proof.invariant.priors
        self._estimates = tuple((float(low) + float(high)) / 2 for low, high in priors)

    def replay(self, cases: Iterable[System]) -> None:
        """Run cases, each by a loop of its own."""
        for case in cases:
            try:
                placed = self._placed(case)
                self._compare(placed, simulate(placed))
            except InputError:  # beyond what a system may be, such as too many samples
                continue

    def spend(
        self,
        loop: AdversarialLoop,
        point: np.ndarray,
        sensors: list[Implementation],
        runs: int,
        rng: np.random.Generator,
    ) -> None:
        """A random search from a point on; its best is written and run as a system."""
        low, high = np.array([(v.low, v.high) for v in loop.adversary.variables]).T
        samples = loop.named_case(point).settings.duration / sensors[0].period
        runs = min(runs, int(MOST_SAMPLES / samples))
        if runs < len(sensors):
            return
        simulators = [self._simulator(loop, point, drive) for drive in sensors]
        step, at, chosen, worst = WIDEST_MOVE, point, 0, -1.0
        for i in range(runs):
            first = i < len(sensors)
            moved = 0.0 if first else step * rng.normal(size=len(at))
            other = first or rng.random() < OTHER_SENSORS
            k = i if first else int(rng.integers(len(sensors))) if other else chosen
            place = np.clip(at + moved * (high - low), low, high)
            case = self._placed(loop.named_case(place).replace(implementation=sensors[k]))
            error = tail_error(simulators[k].run(case))
            self.runs += 1
            better = error > worst
            if better:
                at, chosen, worst = place, k, error
            step = step * STEP_GROWTH if better else step * STEP_GROWTH**-0.25
            step = float(np.clip(step, FINEST_MOVE, WIDEST_MOVE))
            self._tell(max(worst, 0.0 if self.best is None else self.best[2]))
        self.replay([loop.case(at).replace(implementation=sensors[chosen])])

    def _simulator(
        self, loop: AdversarialLoop, point: np.ndarray, drive: Implementation
    ) -> SampledSimulator:
        return SampledSimulator(self._placed(loop.named_case(point).replace(implementation=drive)))

    def _compare(self, case: System, run: Run) -> None:
        self.runs += 1
        error = tail_error(run)
        if self.best is None or error > self.best[2]:
            self.best = case, run, error
        self._tell(self.best[2])

    def _placed(self, case: System) -> System:
        """The case, begun where its errors are zero and the certificate has its estimates."""
        c = case.controller.coordinates
        Y = case.reference.values(np.zeros(1), c.q)[:, 0]
        x0 = np.linalg.solve(c.A, c.B @ Y)
        estimates = self._estimates or case.settings.estimates
        return case.with_settings(x0=tuple(x0.tolist()), estimates=estimates)


def _worst_sensor_errors(drive: Implementation, n: int) -> list[Implementation]:
    """The implementation with its own sensor errors, and with ones that stay at their bounds."""
    sizes = noise_bounds(drive, n)
    erring = np.flatnonzero(sizes).tolist()
    variants = [drive]
    for signs in product((1.0, -1.0), repeat=min(len(erring), MAX_SIGNED_SENSORS)):
        errors = np.zeros(n)
        errors[erring] = sizes[erring]
        errors[erring[: len(signs)]] *= signs
        if erring:
            texts = tuple(repr(float(v)) for v in errors)
            variants.append(
                replace(drive, offset=0.0, noise=None, sensor_error=texts)  # type: ignore[arg-type]
            )
    return variants

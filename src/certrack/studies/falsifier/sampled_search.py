"""The worst case of the adaptive law as a drive runs it, searched on the sampled loop itself.

The cases of the continuous law (the search's, the ascent's, the kernels', the file's own) are run
as implemented, under the file's own sensor errors and under ones that stay at their bounds. The
worst is a candidate, and so is what a random search of the adversary's numbers finds from the best
point of the continuous search on, each run sampled, delayed, quantised and limited as the drive
does it. Every case begins where the errors are zero; where the sampled loop has a certificate, the
estimates begin in the middle of those that it is for, so that it covers the run, and a case whose
reference turns faster than the certificate has it is run with the file's own, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import cast

import numpy as np

from certrack.certificates import Certificate
from certrack.certificates.methods import Methods
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import CONTINUOUS_LAW, premises
from certrack.certificates.sampled_adaptive.certify import certify_sampled_adaptive, starts_inside
from certrack.certificates.sampled_adaptive.proof import SampledAdaptiveProof
from certrack.core.errors import InputError
from certrack.core.progress import Progress
from certrack.model.implementation import Implementation
from certrack.references.base import lipschitz_bound
from certrack.simulation.run import Run
from certrack.simulation.sampled import SampledSimulator
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.drive import (
    DriveFalsification,
    ending_of,
    may_be_limited,
    unless_contradicted,
)
from certrack.studies.falsifier.linear.sampled import noise_bounds
from certrack.studies.falsifier.linear.search import NothingTried
from certrack.studies.falsifier.loop import AdversarialLoop
from certrack.studies.falsifier.outputs import ERROR, SoughtOutput
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
    certificate, proof = certify_sampled_adaptive(system, effort, methods.bootstrap_start, progress)
    broken = [p for p in contradicted(premises(system)) if p.name != CONTINUOUS_LAW]
    return SampledGuarantee(unless_contradicted(certificate, broken), proof)


def attack_as_implemented(
    system: System,
    guarantee: SampledGuarantee,
    cases: Mapping[str, System],
    seeded: tuple[AdversarialLoop, np.ndarray] | None,
    budget: int,
    seed: int,
    progress: Progress,
    output: SoughtOutput = ERROR,
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
    output : SoughtOutput
        What is made large.

    Raises
    ------
    NothingTried
        If no case can be written as a sampled system.
    """
    drive = system.implementation
    assert drive is not None
    sensors = _worst_sensor_errors(drive, system.plant.n)
    search = _SampledSearch(
        system, guarantee.proof, lambda worst: progress(budget, budget, worst), output
    )
    for case in cases.values():
        search.replay(case.replace(implementation=errors) for errors in sensors)
        if not search.turns_as_proven(case):
            replaced = case.replace(reference=system.reference)
            search.replay(replaced.replace(implementation=errors) for errors in sensors)
    if seeded is not None:
        search.spend(*seeded, sensors, budget // RUNS_PER_SAMPLED_RUN, np.random.default_rng(seed))
    if search.best is None:
        raise NothingTried("no case found can be written as a sampled system")
    case, run, error = search.best
    return DriveFalsification(
        error,
        None,
        case,
        ending_of(run),
        guarantee.certificate,
        # from a start that is covered the limits are proven never to act
        limited=may_be_limited(case, run) if guarantee.proof is None else not search.covered(case),
        runs=search.runs,
    )


class _SampledSearch:
    """Sampled runs, and the worst of them: of those that the proof covers, if there are any."""

    def __init__(
        self,
        system: System,
        proof: SampledAdaptiveProof | None,
        tell: Callable[[float], None],
        output: SoughtOutput = ERROR,
    ) -> None:
        self.runs, self.best = 0, cast("tuple[System, Run, float] | None", None)
        self._system, self._proof, self._tell, self._output = system, proof, tell, output
        self._best_covered = False
        priors = () if proof is None else proof.invariant.priors
        self._estimates = tuple((float(low) + float(high)) / 2 for low, high in priors)

    def covered(self, case: System) -> bool:
        """Whether the proof is of such a run: of its start, and of its reference."""
        inside = self._proof is not None and starts_inside(case, self._proof)
        return inside and self.turns_as_proven(case)

    def turns_as_proven(self, case: System) -> bool:
        """Whether y_d^(q+1) is known to change no faster than the file's, as the proof has it.

        References of the continuous search keep the bounds of the file's up to y_d^(q+1) only.
        Without a proof there is nothing to keep.
        """
        if self._proof is None or case.reference == self._system.reference:
            return True
        order = case.controller.coordinates.q + 1
        known = lipschitz_bound(self._system.reference, order)
        steepest = lipschitz_bound(case.reference, order)
        return known is not None and steepest is not None and steepest <= known

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
        step, at, chosen, worst = WIDEST_MOVE, point, 0, -1.0
        steep = not self.turns_as_proven(loop.case(point))

        def named(place: np.ndarray, drive: Implementation) -> System:
            case = loop.named_case(place).replace(implementation=drive)
            if steep:  # the file's own is one that the proof covers
                case = case.replace(reference=self._system.reference)
            return self._placed(case)

        simulators = [SampledSimulator(named(point, drive)) for drive in sensors]
        for i in range(runs):
            first = i < len(sensors)
            moved = 0.0 if first else step * rng.normal(size=len(at))
            other = first or rng.random() < OTHER_SENSORS
            k = i if first else int(rng.integers(len(sensors))) if other else chosen
            place = np.clip(at + moved * (high - low), low, high)
            error = self._output.tail(simulators[k].run(named(place, sensors[k])))
            self.runs += 1
            better = error > worst
            if better:
                at, chosen, worst = place, k, error
            step = step * STEP_GROWTH if better else step * STEP_GROWTH**-0.25
            step = float(np.clip(step, FINEST_MOVE, WIDEST_MOVE))
            self._tell(max(worst, 0.0 if self.best is None else self.best[2]))
        best = loop.case(at).replace(implementation=sensors[chosen])
        self.replay([best.replace(reference=self._system.reference) if steep else best])

    def _compare(self, case: System, run: Run) -> None:
        self.runs += 1
        error, covered = self._output.tail(run), self.covered(case)
        if self.best is None or (covered, error) > (self._best_covered, self.best[2]):
            self.best, self._best_covered = (case, run, error), covered
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

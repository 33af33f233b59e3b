"""The falsifier: hunt for the worst that the assumptions admit, to see how tight a certificate is.

A population of adversaries is evolved on the batched integrator to maximise |e_1| after the
transient; the best case is polished alone. Where the error loop is linear, its kernels and a linear
program give another case, also at the corners of what has a range, and of the loop as a drive
carries it out (:mod:`certrack.studies.falsifier.linear`). Where constants have ranges, the adaptive
law gets the case of the loop that knows what it estimates, and the search goes on from these
constants. Where the loop is nonlinear, an ascent along the slopes of its adjoint goes on from the
worst of all these (:mod:`certrack.studies.falsifier.ascent`). Cases are written as system files and
replayed there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, overload

from certrack.certificates import Certificate
from certrack.certificates.certify import EFFORTS
from certrack.certificates.methods import METHOD_STEPS, Methods, every_certificate
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.errors import InputError
from certrack.core.progress import Progress, silent
from certrack.core.rounding import rounded_up
from certrack.laws.adaptive import Adaptive
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.alarm import alarm
from certrack.studies.falsifier.any_output import OutputFalsification, falsify_output
from certrack.studies.falsifier.drive import (
    DriveFalsification,
    attacked_by_kernels,
    ending_of,
    first_alarm,
)
from certrack.studies.falsifier.hunt import OWN, hunt
from certrack.studies.falsifier.linear.search import (
    NothingTried,
)
from certrack.studies.falsifier.outputs import ERROR, output_named, tail_error
from certrack.studies.falsifier.sampled_search import (
    attack_as_implemented,
    guarantee_as_sampled,
)
from certrack.systems.system import System, require_system

#: Runs of a search that is asked for by mistake would take years.
MAX_BUDGET = 10**9


@dataclass(frozen=True)
class Falsification:
    """The worst case found.

    Attributes
    ----------
    worst_error : float
        Largest |e_1| after the transient, replayed by the ordinary simulation; inf if it escapes.
    system : System
        Replays it.
    evaluations : int
        Runs spent.
    certificates : mapping of str to Certificate
        What the error is held against, by kind; not verified if a premise is contradicted.
    against : Certificate or None
        The tightest that is proven of the design, whether or not the file keeps the premises.
    alarm : {None, "premise", "defect"}
        Whether the worst case is beyond what `against` certifies from its start: then a premise is
        broken, or certrack is wrong.
    reason : str
        Of the alarm: which premise, or that none was found.
    own_run : bool
        Whether the worst case is the file's own run.
    origin : {"search", "ascent", "kernels", "own"}
        Where the worst case comes from: the search, the ascent from what it found, the kernels of
        the linear loop, the file.
    stopped : str or None
        How the worst run ended, where it did not reach its end.
    drive : DriveFalsification or None
        The worst case of the loop as the file's implementation carries it out, where it is linear.
    ended : str
        Why the search stopped.
    left_out : mapping of str to str
        Why the kernels of the continuous loop (``"kernels"``), those of the implemented one
        (``"drive"``) or the ascent (``"ascent"``) were not tried.
    """

    worst_error: float
    system: System
    evaluations: int
    certificates: Mapping[str, Certificate]
    against: Certificate | None
    alarm: str | None
    reason: str
    own_run: bool
    origin: str = "search"
    stopped: str | None = None
    drive: DriveFalsification | None = None
    ended: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        proven = "none" if self.against is None else rounded_up(self.against.bound, 4)
        alarm_text = "" if self.alarm is None else f", ALARM ({self.alarm})"
        runs = f"found in {self.evaluations} runs"
        return f"Falsification(|e_1| = {self.worst_error:.4g} {runs}, proven {proven}{alarm_text})"


@overload
def falsify(
    system: System,
    *,
    of: Literal["error"] = "error",
    budget: int = 6000,
    seed: int = 0,
    effort: str = "default",
    progress: Progress = silent,
    certifying: Progress = silent,
) -> Falsification: ...


@overload
def falsify(
    system: System,
    *,
    of: str,
    budget: int = 6000,
    seed: int = 0,
    effort: str = "default",
    progress: Progress = silent,
    certifying: Progress = silent,
) -> Falsification | OutputFalsification: ...


@one_blas_thread
def falsify(
    system: System,
    *,
    of: str = "error",
    budget: int = 6000,
    seed: int = 0,
    effort: str = "default",
    progress: Progress = silent,
    certifying: Progress = silent,
) -> Falsification | OutputFalsification:
    """Search the worst admissible case of `system`; its own run is always a candidate.

    Parameters
    ----------
    system : System
        Its law, ranges and uncertainty; disturbance and reference are replaced. The search is of
        the continuous loop; a linear one that has an implementation is attacked as such, too.
    of : str
        What is to become large: ``"error"``, ``"input"``, or the name of a state of the plant or of
        an estimate, such as ``"x2"`` and ``"theta_hat_1"``.
    budget : int
        Number of runs.
    seed : int
        Seed of the population.
    effort : {"fast", "default", "high"}
        Of the certificates that the worst case is held against, as of :func:`certrack.certify`.
    progress : callable
        Gets the runs so far, the budget and the worst error so far.
    certifying : callable
        Gets, before the search, the steps done of certifying what it is held against, their number
        and the bound so far.

    Returns
    -------
    Falsification
        Of the error; an OutputFalsification of anything else.

    Raises
    ------
    InputError
        If there is no output of this name, a bound of the reference cannot be proven, the truth has
        states of its own, or a name of the plant is one of the search's own.

    Examples
    --------
    >>> import certrack
    >>> result = certrack.falsify(certrack.load("dual-motor-lean"), budget=200)
    >>> bool(result.worst_error <= certrack.certify(certrack.load("dual-motor-lean")).best.bound)
    True
    >>> result = certrack.falsify(certrack.load("dual-motor-lean"), of="input", budget=200)
    >>> bool(result.worst <= result.claim.bound)
    True
    """
    require_system(system)
    checks.integer("budget", budget, 1, MAX_BUDGET)
    checks.integer("seed", seed, 0, 2**63 - 1)
    checks.choice("effort", effort, EFFORTS)
    output = output_named(system, of)
    if system.truth.states:
        raise InputError(
            "truth.states",
            "falsify searches disturbances of the design's plant, not of one with own states",
            remedy="Give the truth in the design's form, or vary it by certrack ensemble",
        )
    system = system.long_run  # a soft start has vanished where the worst error is sought
    if output != ERROR:
        return falsify_output(system, output, budget, seed, effort, progress, certifying)
    steps = METHOD_STEPS + (system.implementation is not None)
    methods = every_certificate(system, effort, lambda k, _, bound: certifying(k, steps, bound))
    bounds = tuple(reference_bounds(system, system.controller.coordinates.q + 1))
    left_out: dict[str, str] = {}
    drive = guarantee = None

    def certifying_drive(_: float, __: float | None, bound: float | None, /) -> None:
        certifying(METHOD_STEPS, steps, bound)

    if system.implementation is not None:
        try:
            drive = attacked_by_kernels(system, bounds, effort, certifying_drive)
        except NothingTried as refusal:
            left_out["drive"] = str(refusal)
            if isinstance(system.law, Adaptive):  # its loop is searched as it runs
                guarantee = guarantee_as_sampled(system, methods, effort, certifying_drive)
    progress(0, budget, None)
    implemented, system = system, system.replace(implementation=None)
    hunted = hunt(system, bounds, budget, seed, progress)
    cases, runs = hunted.cases, hunted.runs
    left_out |= hunted.left_out
    if guarantee is not None:
        try:
            drive = attack_as_implemented(
                implemented, guarantee, cases, hunted.seeded, budget, seed, progress
            )
            del left_out["drive"]
        except NothingTried as refusal:
            left_out["drive"] = str(refusal)
    errors = {origin: tail_error(run) for origin, run in runs.items()}
    worst = max(errors, key=lambda origin: errors[origin])
    against, stages = methods.best, methods.stages
    alarms = (
        alarm(system, cases[origin], run, against, stages)
        for origin, run in runs.items()
        if against is not None
    )
    raised = first_alarm(alarms, drive)
    return Falsification(
        errors[worst],
        cases[worst],
        hunted.evaluations + 1,
        _of_this_file(system, methods),
        against,
        None if raised is None else raised.kind,
        "" if raised is None else raised.reason,
        own_run=worst == OWN,
        origin=worst,
        stopped=ending_of(runs[worst]),
        drive=drive,
        ended=hunted.ended,
        left_out=left_out,
    )


def _of_this_file(system: System, methods: Methods) -> dict[str, Certificate]:
    """The certificates, none of them verified where the file's truth breaks a premise."""
    broken = contradicted(premises(system))
    entries = {kind: methods.certificates[kind] for kind in methods.kinds}
    return {
        kind: replace(entry, verified=entry.verified and not broken)
        for kind, entry in entries.items()
    }

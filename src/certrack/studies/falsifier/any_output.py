"""The falsifier of any output: how large do the input, a state or an estimate become?

The search is that of the error with another signal to make large, of the continuous loop and of the
loop as a drive runs it, and so are candidates, replays and alarms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from certrack.certificates.certificate import missing
from certrack.core.progress import Progress
from certrack.core.rounding import rounded_up
from certrack.laws.adaptive import Adaptive
from certrack.studies.falsifier.adversary import reference_bounds
from certrack.studies.falsifier.claims import OutputClaim, output_alarm, output_claim
from certrack.studies.falsifier.drive import (
    DriveFalsification,
    attacked_by_kernels,
    ending_of,
    first_alarm,
)
from certrack.studies.falsifier.hunt import Hunted, hunt
from certrack.studies.falsifier.linear.search import NothingTried
from certrack.studies.falsifier.outputs import ESTIMATE, SoughtOutput
from certrack.studies.falsifier.sampled_search import SampledGuarantee, attack_as_implemented
from certrack.systems.system import System

#: Why the sampled loop of the adaptive law is held against nothing but its error.
OF_ERROR_ONLY = "of the loop as implemented the error alone is certified"


@dataclass(frozen=True)
class OutputFalsification:
    """The largest magnitude found of an output.

    Attributes
    ----------
    output : SoughtOutput
    worst : float
        Largest magnitude after the transient, replayed by the ordinary simulation; inf if the run
        escapes. Unit of the output.
    system : System
        Replays it.
    evaluations : int
        Runs spent.
    claim : OutputClaim
        What is certified of the output.
    alarm : {None, "premise", "defect"}
        Whether a run is beyond the claim: then a premise is broken, or certrack is wrong.
    reason : str
        Of the alarm.
    origin : {"search", "ascent", "kernels", "own"}
        Where the worst case comes from.
    stopped : str or None
        How the worst run ended, where it did not reach its end.
    drive : DriveFalsification or None
        The same of the loop as the file's implementation carries it out.
    ended : str
        Why the search stopped.
    left_out : mapping of str to str
        Why the kernels (``"kernels"``), those of the loop as implemented (``"drive"``) or the
        ascent (``"ascent"``) were not tried.
    """

    output: SoughtOutput
    worst: float
    system: System
    evaluations: int
    claim: OutputClaim
    alarm: str | None
    reason: str
    origin: str
    stopped: str | None = None
    drive: DriveFalsification | None = None
    ended: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        claimed = rounded_up(self.claim.bound, 4) if self.claim.exists else "nothing"
        alarm_text = "" if self.alarm is None else f", ALARM ({self.alarm})"
        largest = f"|{self.output.symbol_text}| = {self.worst:.4g}"
        runs = f"found in {self.evaluations} runs"
        return f"OutputFalsification({largest} {runs}, claimed {claimed}{alarm_text})"

    @property
    def settling(self) -> bool:
        """Whether the worst run is beyond the bound only since its start is not forgotten."""
        return self.alarm is None and self.worst > self.claim.bound


def falsify_output(
    system: System,
    output: SoughtOutput,
    budget: int,
    seed: int,
    effort: str,
    progress: Progress,
    certifying: Progress,
) -> OutputFalsification:
    """Search the worst case of an output; arguments as of :func:`certrack.falsify`.

    Parameters
    ----------
    system : System
        In the long run.
    output : SoughtOutput
    budget, seed : int
    effort : {"fast", "default", "high"}
    progress, certifying : callables
    """
    continuous = system.replace(implementation=None)
    claim = output_claim(continuous, output, effort, certifying)
    bounds = tuple(reference_bounds(system, system.controller.coordinates.q + 1))
    left_out: dict[str, str] = {}
    drive = None
    if system.implementation is not None and output.kind != ESTIMATE:
        try:
            drive = attacked_by_kernels(system, bounds, effort, certifying, output)
        except NothingTried as refusal:
            left_out["drive"] = str(refusal)
    progress(0, budget, None)
    hunted = hunt(continuous, bounds, budget, seed, progress, output)
    if system.implementation is not None and isinstance(system.law, Adaptive):
        try:
            drive = _as_implemented(system, hunted, output, budget, seed, progress)
            left_out.pop("drive", None)
        except NothingTried as refusal:
            left_out["drive"] = str(refusal)
    sizes = {origin: output.tail(run) for origin, run in hunted.runs.items()}
    worst = max(sizes, key=lambda origin: sizes[origin])
    alarms = (
        output_alarm(continuous, output, claim, hunted.cases[origin], run)
        for origin, run in hunted.runs.items()
    )
    raised = first_alarm(alarms, drive)
    return OutputFalsification(
        output,
        sizes[worst],
        hunted.cases[worst],
        hunted.evaluations + 1,
        claim,
        None if raised is None else raised.kind,
        "" if raised is None else raised.reason,
        worst,
        ending_of(hunted.runs[worst]),
        drive,
        hunted.ended,
        {**left_out, **hunted.left_out},
    )


def _as_implemented(
    system: System,
    hunted: Hunted,
    output: SoughtOutput,
    budget: int,
    seed: int,
    progress: Progress,
) -> DriveFalsification:
    """The worst case of the adaptive law on the sampled loop, held against nothing."""
    guarantee = SampledGuarantee(missing("sampled", OF_ERROR_ONLY), None)
    return attack_as_implemented(
        system, guarantee, hunted.cases, hunted.seeded, budget, seed, progress, output
    )

"""Which class computes a system's members by which method."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from certrack.integrators.base import MethodUnavailable
from certrack.laws.baselines.mpc import planned_limits, require_formula
from certrack.studies.ensembles.methods.base import Method
from certrack.studies.ensembles.methods.lockstep_continuous import LockstepContinuous
from certrack.studies.ensembles.methods.lockstep_sampled import LockstepSampled
from certrack.studies.ensembles.methods.native_continuous import NativeContinuous
from certrack.studies.ensembles.methods.native_sampled import NativeSampled
from certrack.studies.ensembles.methods.sampled_base import SampledMethod
from certrack.studies.ensembles.methods.single_runs import SingleRuns
from certrack.studies.ensembles.problem import EnsembleProblem

CONTINUOUS: dict[str, Callable[[EnsembleProblem, int], Method]] = {
    "native": NativeContinuous,
    "implicit": partial(NativeContinuous, implicit=True),
    "lockstep": LockstepContinuous,
}

SAMPLED: dict[str, Callable[..., SampledMethod]] = {
    "native": NativeSampled,
    "lockstep": LockstepSampled,
}


def create_method(name: str, problem: EnsembleProblem, threads: int) -> Method:
    """The method of that name for the system: its controller is continuous or sampled.

    Raises
    ------
    MethodUnavailable
        If this machine does not have it.
    """
    if name == "alone":
        return SingleRuns()
    system = problem.system
    if name != "native" and planned_limits(system.law, system.implementation) is not None:
        raise MethodUnavailable("the mpc law plans its input sample by sample")
    if name == "implicit" and system.implementation is not None:
        raise MethodUnavailable(
            "a sampled loop has no implicit steps: its plant moves sample by sample"
        )
    if system.implementation is None:
        return CONTINUOUS[name](problem, threads)
    return SAMPLED[name](problem, threads, adjustable=False)


def fastest_adjustable(problem: EnsembleProblem, threads: int) -> SampledMethod:
    """The first method on this machine that can be asked for other implementations."""
    require_formula(problem.system.law, problem.system.implementation, "search over periods")
    for create in SAMPLED.values():
        try:
            return create(problem, threads, adjustable=True)
        except MethodUnavailable:
            continue
    raise AssertionError("every machine has the maps of the sampled loop")

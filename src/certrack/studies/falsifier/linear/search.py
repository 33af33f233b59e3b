"""The worst case of a linear error loop, found by kernels and linear programs, and simulated."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from certrack.certificates.certificate import NoCertificate, within_floats
from certrack.certificates.ranges.loop import RangedLoop, ranged_loop
from certrack.certificates.scope import refuse_unknown
from certrack.core.errors import CertrackError, InputError
from certrack.laws.error_system import EstimatedParameters
from certrack.model.jitter import JITTER_PATTERNS
from certrack.simulation.run import Run
from certrack.simulation.simulator import simulate
from certrack.studies.falsifier.linear.ascent import worst_inputs
from certrack.studies.falsifier.linear.case import at_point, written_case
from certrack.studies.falsifier.linear.chain import Chain
from certrack.studies.falsifier.linear.continuous import continuous_chain
from certrack.studies.falsifier.linear.corners import worst_corners
from certrack.studies.falsifier.linear.rows import row_of
from certrack.studies.falsifier.linear.sampled import (
    reference_class,
    sampled_chain,
    with_jumps,
)
from certrack.studies.falsifier.outputs import ERROR, SoughtOutput
from certrack.systems.system import System

#: Corners whose worst inputs are computed and simulated.
MAX_CANDIDATES = 3


class NothingTried(CertrackError):
    """Why a loop has no worst case by its kernels; the text is the reason."""


@dataclass(frozen=True)
class LinearCase:
    """A worst case of a linear loop.

    Attributes
    ----------
    estimate : float
        |e_1|, or the output sought, at the end, by the linear loop.
    system : System
        Replays it.
    run : Run
    error : float
        Tail error of the run, or the largest magnitude of the output sought; inf if it escapes, 0
        if it ends before the tail.
    """

    estimate: float
    system: System
    run: Run
    error: float


def continuous_case(
    system: System, bounds: tuple[float, ...], output: SoughtOutput = ERROR
) -> LinearCase:
    """The worst case of the continuous loop at constant parameters.

    Parameters
    ----------
    system : System
        Without an implementation.
    bounds : Y_0 ... Y_{q+1}
    output : SoughtOutput
        What is made large.

    Returns
    -------
    LinearCase

    Raises
    ------
    NothingTried
        For a law whose loop is not linear, an output that is not, or where nothing is found.
    """
    loop = _linear_loop(system, bounds)
    row = row_of(system, output, len(bounds) - 1)
    if row is None:
        raise NothingTried(f"{output.symbol_text} is not linear in the states")

    def size(point: tuple[Any, ...]) -> float | None:
        chain = continuous_chain(loop, point, bounds, row)
        first = None if chain is None else worst_inputs(chain, turns=1)
        return None if first is None else first.error

    points = worst_corners(loop, bounds, MAX_CANDIDATES, None if output == ERROR else size)
    return _worst_of(
        loop,
        (
            (continuous_chain(loop, point, bounds, row), at_point(system, values_at(loop, point)))
            for point in points
        ),
        output,
        odd=not row.constant,
    )


def sampled_case(
    system: System, bounds: tuple[float, ...], output: SoughtOutput = ERROR
) -> LinearCase:
    """The worst case of the loop as a drive carries it out.

    Parameters
    ----------
    system : System
        With an implementation.
    bounds : Y_0 ... Y_{q+1}
    output : SoughtOutput
        What is made large.

    Returns
    -------
    LinearCase

    Raises
    ------
    NothingTried
        Where the loop is not linear or not stable, or nothing is found.
    """
    loop = _linear_loop(_without_integral(system), bounds)  # for where constants are worst
    implementation, references = system.implementation, reference_class(system, bounds)
    assert implementation is not None
    members = [
        at_point(system, values_at(loop, point)).replace(
            implementation=replace(
                implementation, delay=delay, counted_delay=implementation.design_delay
            )
        )
        for point in worst_corners(loop, bounds, MAX_CANDIDATES)
        for delay in implementation.delays
    ]
    chains = (
        (entry, member)
        for member in members
        if (chain := sampled_chain(member, references.bounds, output))
        for entry in [_worst_partition(with_jumps(chain, references))]
    )
    return _worst_of(loop, chains, output)


def _without_integral(system: System) -> System:
    """The system whose law has no integral action: that is a memory of the sampled controller."""
    if system.law.integral is None:
        return system
    return system.replace(law=replace(system.law, integral=None))


def _linear_loop(system: System, bounds: tuple[float, ...]) -> RangedLoop:
    if system.law.online is not None:
        raise NothingTried("the gains move: their motion is searched instead")
    if system.law.integral is not None:
        raise NothingTried("law.integral is attacked as sampled only: add [implementation]")
    loop = linear_error_loop(system)
    if loop is None:
        raise NothingTried("the error loop is not linear")
    if not all(map(math.isfinite, bounds)):
        raise NothingTried("a derivative of the reference that the law uses has no bound")
    return loop


def _worst_partition(chains: list[Chain]) -> Chain:
    """The chain whose pieces are worst, by the first turn of the search for worst inputs."""
    if len(chains) == 1:
        return chains[0]
    firsts = [worst_inputs(chain, turns=1) for chain in chains]
    errors = [0.0 if first is None else first.error for first in firsts]
    return chains[errors.index(max(errors))]


def _timed(case: System) -> list[System]:
    """The case with every pattern of its jitter."""
    drive = case.implementation
    if drive is None or not drive.jitter:
        return [case]
    return [
        case.replace(implementation=replace(drive, jitter_pattern=pattern))
        for pattern in JITTER_PATTERNS
    ]


def _worst_of(
    loop: RangedLoop,
    chains: Iterable[tuple[Chain | None, System]],
    output: SoughtOutput,
    *,
    odd: bool = True,
) -> LinearCase:
    """The worst inputs of all chains, each with its system, simulated."""
    attacks = [
        (worst, member)
        for chain, member in chains
        if chain is not None and (worst := worst_inputs(chain)) is not None
    ]
    if not attacks:
        raise NothingTried("the loop is not stable, forgets too slowly, or has no linear program")
    worst, member = max(attacks, key=lambda pair: pair[0].error)
    odd = odd and not loop.brackets and all(entry == 0 for entry in loop.matrix[:, -1])
    try:
        senses = (1,) if odd else (1, -1)
        cases = [case for sense in senses for case in _timed(written_case(member, worst, sense))]
    except InputError as problem:  # beyond what a system may be, such as too many samples
        raise NothingTried(f"the case found cannot be written as a system: {problem}") from None
    played = [(case, simulate(case)) for case in cases]
    entries = [LinearCase(worst.error, case, run, output.tail(run)) for case, run in played]
    return max(entries, key=lambda entry: entry.error)


def linear_error_loop(system: System) -> RangedLoop | None:
    """The error loop as a function of the constants; None where it is not linear."""
    try:
        with within_floats():
            if isinstance(refuse_unknown(system), EstimatedParameters):
                return None
            return ranged_loop(system)
    except NoCertificate:
        return None


def values_at(loop: RangedLoop, point: tuple[Any, ...]) -> dict[str, Any]:
    """The values of what has a range, as texts of fractions by name."""
    return {str(name): str(value) for name, value in zip(loop.symbols, point, strict=True)}

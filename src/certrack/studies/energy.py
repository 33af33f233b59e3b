"""Where the energy of a run goes: motors, mechanism, supply; per cycle, to the last nanojoule.

All flows are states of the same integration as the run (:mod:`certrack.loops.energy`), so the
balance is no sum over samples: what is missing from it is the integrator's error.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from certrack.core import checks
from certrack.core.blas import one_blas_thread
from certrack.core.errors import InputError
from certrack.core.notebook import ShownInNotebooks
from certrack.core.progress import Progress, silent
from certrack.integrators.base import Outcome
from certrack.loops.energy import (
    FLOWS,
    motor_numbers,
    power_values,
    require_motors,
    stored_energy,
    with_flows,
    with_motors,
)
from certrack.model.motors import MotorNumbers
from certrack.references import SymbolicReference
from certrack.references.search import Formula
from certrack.simulation.run import Run
from certrack.simulation.simulator import Simulator
from certrack.systems.system import System, require_system

#: Tolerance of the integrator, unless the file asks for less: flows then close to 1e-12 J or so.
ENERGY_TOLERANCE = 1e-12

#: At most so many cycles are listed: the last ones.
MAX_CYCLES = 100

#: A run that ended early, after more than this part of the source's most power, ended by it.
NEAR_LIMIT = 0.9

#: A cycle that ends this part of itself after the run still counts: periods are rounded up.
CYCLE_ROUNDING = 1e-9


@dataclass(frozen=True)
class EnergyBalance:
    """Where the energy went between two times; all in joules.

    Attributes
    ----------
    begin, end : float, s
    copper : 2 floats
        Losses in the windings of each motor.
    work : 2 floats
        What each motor gave to the mechanism.
    friction : float
        Lost in the mechanism.
    surroundings : float
        What the disturbances gave to the mechanism.
    stored : float
        Growth of the mechanism's kinetic and elastic energy, from the states at both times.
    drawn, returned : float
        Out of the source, and back into it.
    chopper : float
        Burned in the brake chopper.
    supply_loss : float
        Lost between link and source, with what its resistance takes.
    asked, given_back : float
        What the motors' link took, and what it gave back.
    """

    begin: float
    end: float
    copper: tuple[float, float]
    work: tuple[float, float]
    friction: float
    surroundings: float
    stored: float
    drawn: float
    returned: float
    chopper: float
    supply_loss: float
    asked: float
    given_back: float

    @property
    def net(self) -> float:
        """Energy from the source, J."""
        return self.drawn - self.returned

    @property
    def losses(self) -> float:
        """Copper, friction, chopper and supply, J."""
        return sum(self.copper) + self.friction + self.chopper + self.supply_loss

    @property
    def regenerated(self) -> float:
        """Part of the energy drawn that comes back to the source; a chopper would burn it."""
        return self.returned / self.drawn if self.drawn else 0.0

    @property
    def residual(self) -> float:
        """Net - losses - stored + surroundings: zero but for the integrator's error, J."""
        return self.net - self.losses - self.stored + self.surroundings

    def as_dict(self) -> dict[str, Any]:
        """What JSON holds of it."""
        sums = {name: getattr(self, name) for name in ("net", "regenerated", "residual")}
        return {**asdict(self), "copper": list(self.copper), "work": list(self.work), **sums}


@dataclass(frozen=True)
class TorqueSplit:
    """One way to share the input, and what came of it.

    Attributes
    ----------
    share : float
        Part of the input that is the command of motor 1.
    damping : float
        Of the difference of the shafts, unit of the input times s/rad.
    balance : EnergyBalance
        Of the whole run.
    twist : float
        Largest change of theta_1 - theta_2 from the start, rad.
    tail_twist : float
        Between its extremes in the tail of the run, rad: what does not decay.
    """

    share: float
    damping: float
    balance: EnergyBalance
    twist: float
    tail_twist: float

    def as_dict(self) -> dict[str, Any]:
        """What JSON holds of it."""
        energies = {"copper": list(self.balance.copper), "net": self.balance.net}
        numbers = {
            name: getattr(self, name) for name in ("share", "damping", "twist", "tail_twist")
        }
        return {**numbers, **energies}


@dataclass(frozen=True)
class Energy(ShownInNotebooks):
    """Where the energy of a run goes.

    Attributes
    ----------
    run : Run
        With the flows among its states, after those of the truth.
    system : System
    motors : MotorNumbers
    balance : EnergyBalance
        Of the whole run.
    cycle : float, optional
        Length of a cycle, s.
    cycles : tuple of EnergyBalance
        Whole cycles, from the start on; of many the last ones.
    rms_current, rms_torque : 2 floats
        Of each motor over the run, A and N m.
    splits : tuple of TorqueSplit
        As stated, even, and with the least copper loss, the same damping in all.
    """

    run: Run
    system: System
    motors: MotorNumbers
    balance: EnergyBalance
    cycle: float | None
    cycles: tuple[EnergyBalance, ...]
    rms_current: tuple[float, float]
    rms_torque: tuple[float, float]
    splits: tuple[TorqueSplit, ...]

    @property
    def saving_by_split(self) -> float:
        """Part of the copper loss of the even split that the best one saves in this run."""
        _, even, best = (sum(split.balance.copper) for split in self.splits)
        return 1 - best / even if even else 0.0

    @cached_property
    def powers(self) -> dict[str, np.ndarray]:
        """The flows in watts at the times of the run."""
        states = self.run.trajectory.interpolate(self.run.t)
        return power_values(self.system, self.run.t, states, self.run.u)

    def csv(self) -> str:
        """The powers over time as CSV: t [s], u, then the flows in watts.

        Returns
        -------
        str
        """
        powers = {name: values for name, values in self.powers.items() if name != "twist"}
        header = ",".join(["time_s", "u", *(f"{name}_W" for name in powers)])
        columns = zip(self.run.t, self.run.u, *powers.values(), strict=True)
        lines = (",".join(repr(float(value)) for value in row) for row in columns)
        return "\n".join([header, *lines]) + "\n"

    def summary(self) -> dict[str, Any]:
        """Everything, ready for JSON.

        Returns
        -------
        dict
        """
        return {
            "balance": self.balance.as_dict(),
            "cycle": self.cycle,
            "cycles": [entry.as_dict() for entry in self.cycles],
            "rms_current": list(self.rms_current),
            "rms_torque": list(self.rms_torque),
            "splits": [split.as_dict() for split in self.splits],
            "best_share": self.motors.best_share,
            "saving_by_split": self.saving_by_split,
            "saving_by_split_formula": self.motors.best_saving,
            "outcome": self.run.outcome.name,
        }

    def __repr__(self) -> str:
        losses = sum(self.balance.copper)
        return (
            f"Energy(copper {losses:.5g} J, net {self.balance.net:.5g} J, "
            f"residual {self.balance.residual:.1e} J)"
        )


@one_blas_thread
def energy(
    system: System,
    *,
    share: float | None = None,
    damping: float | None = None,
    cycle: float | None = None,
    progress: Progress = silent,
) -> Energy:
    """Balance the energy of two motors over a run, and compare ways to share the torque.

    Parameters
    ----------
    system : System
        Its truth has motors.
    share : float, optional
        Part of the input that is the command of motor 1; the file's if left out.
    damping : float, optional
        Of the difference of the shafts; the file's if left out.
    cycle : float, optional
        Length of a cycle, s; the period of the reference if left out, where it has one.
    progress : callable
        Gets the runs done, their number and None; see :mod:`certrack.core.progress`.

    Returns
    -------
    Energy

    Raises
    ------
    InputError
        If the system has no motors, its stored energy does not fit its rates, or an argument is
        out of its limits.

    Examples
    --------
    >>> import certrack
    >>> found = certrack.energy(certrack.load("dual-motor-physical"), damping=0.05)
    >>> round(100 * found.saving_by_split, 2)
    9.8
    >>> abs(found.balance.residual) < 1e-9
    True
    """
    require_system(system)
    require_motors(system)
    changes: dict[str, Any] = {}
    if share is not None:
        changes["share"] = checks.real("share", share, least=0, most=1)
    if damping is not None:
        changes["damping"] = checks.real("damping", damping, least=0)
    system = with_motors(system, **changes) if changes else system
    length = _cycle_length(system, cycle)
    numbers = motor_numbers(system)
    shares = (numbers.share, 0.5, numbers.best_share)
    simulator: Simulator | None = None
    splits: list[TorqueSplit] = []
    runs: list[Run] = []
    for i, value in enumerate(shares):
        progress(float(i), float(len(shares)), None)
        if value in shares[:i]:
            again = shares.index(value)
            splits.append(splits[again])
            continue
        wider = with_flows(with_motors(system, share=value) if i else system, ENERGY_TOLERANCE)
        simulator = simulator or Simulator(wider)
        run = simulator.run(wider)
        runs.append(run)
        splits.append(_split(system, run, value, numbers.damping))
    progress(float(len(shares)), float(len(shares)), None)
    run, balance = runs[0], splits[0].balance
    _check_supply(system, run)
    duration = balance.end - balance.begin
    squares = [loss / R for loss, R in zip(balance.copper, numbers.resistance, strict=True)]
    rms = [math.sqrt(max(square, 0.0) / duration) if duration else 0.0 for square in squares]
    torques = [value * abs(k) for value, k in zip(rms, numbers.torque_constant, strict=True)]
    return Energy(
        run=run,
        system=system,
        motors=numbers,
        balance=balance,
        cycle=length,
        cycles=_cycles(system, run, length),
        rms_current=(rms[0], rms[1]),
        rms_torque=(torques[0], torques[1]),
        splits=tuple(splits),
    )


def _check_supply(system: System, run: Run) -> None:
    """Say what ended a run whose source cannot give the power that the motors ask for."""
    supply = system.truth.supply
    if run.outcome is Outcome.finished or supply is None or not supply.resistance:
        return
    assert supply.voltage is not None
    most, end = supply.voltage**2 / (4 * supply.resistance), run.trajectory.end
    asked = power_values(system, run.t, run.trajectory.interpolate(run.t), run.u)["asked"]
    if not np.max(asked) >= NEAR_LIMIT * most:
        return
    raise InputError(
        "truth.supply.resistance",
        f"is too large: the source gives at most V^2/(4 R) = {most:.4g} W, and at t = {end:.4g} s "
        "the motors ask for more",
        supply.resistance,
        "Lower it, or raise truth.supply.voltage",
    )


def _cycle_length(system: System, cycle: float | None) -> float | None:
    """Length of a cycle: as given, or the reference's period."""
    if cycle is not None:
        value = checks.real("cycle", cycle, above=0)
        if value > system.settings.duration:
            message = f"must fit into simulation.duration = {system.settings.duration:g} s"
            raise InputError("cycle", message, value)
        return value
    reference = system.reference
    period: float | None = getattr(reference, "period", None)
    if isinstance(reference, SymbolicReference):
        period = Formula(reference.numeric).period
    return period if period and math.isfinite(period) else None


def _cycles(system: System, run: Run, length: float | None) -> tuple[EnergyBalance, ...]:
    """Balances of the whole cycles in a run."""
    if length is None:
        return ()
    count = math.floor(run.trajectory.end / length + CYCLE_ROUNDING)
    first = max(0, count - MAX_CYCLES)
    times = np.minimum(length * np.arange(first, count + 1), run.trajectory.end)
    return _balances(system, run, times)


def _split(system: System, run: Run, share: float, damping: float) -> TorqueSplit:
    """What a run with this share comes to."""
    (balance,) = _balances(system, run, np.array([0.0, run.trajectory.end]))
    n = len(system.simulated_states)
    twist = run.trajectory.interpolate(run.t)[n + FLOWS.index("twist")]
    tail = twist[run.t >= system.settings.tail_start]
    largest = float(np.max(np.abs(twist)))
    return TorqueSplit(share, damping, balance, largest, float(np.ptp(tail)) if len(tail) else 0.0)


def _balances(system: System, run: Run, times: np.ndarray) -> tuple[EnergyBalance, ...]:
    """The balance between each time and the next."""
    states = run.trajectory.interpolate(times)
    n = len(system.simulated_states)
    stored = np.diff(stored_energy(system, states))
    grown = np.diff(states[n : n + len(FLOWS)], axis=1)
    balances = []
    for i, begin in enumerate(times[:-1]):
        flow = dict(zip(FLOWS, grown[:, i].tolist(), strict=True))
        copper, work = (
            (flow.pop(f"{name}_1"), flow.pop(f"{name}_2")) for name in ("copper", "work")
        )
        del flow["twist"]
        balances.append(
            EnergyBalance(
                float(begin), float(times[i + 1]), copper, work, stored=float(stored[i]), **flow
            )
        )
    return tuple(balances)

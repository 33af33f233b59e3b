"""The members of an ensemble: from (seed, index) to a complete system, one alone or many at once.

Both use the same draws; a test holds them against each other.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from certrack.core import checks
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, parse, symbol
from certrack.core.lowering import numpy_callable, rows
from certrack.core.memo import remembered
from certrack.laws.plant_coordinates import output_derivatives
from certrack.loops.continuous import ClosedLoop, close_loop, parameter_values
from certrack.loops.plant import true_constants
from certrack.model.distribution import Distribution
from certrack.model.disturbance import Multisine, family_of
from certrack.model.names import refuse_prefix
from certrack.model.plant import Plant
from certrack.model.sampling import MAX_MEMBERS, probabilities
from certrack.model.slowness import slow_size
from certrack.model.truth import Truth
from certrack.references import SoftStart, SymbolicReference
from certrack.simulation.run import Run
from certrack.simulation.simulator import Simulator
from certrack.studies.ensembles.corners import (
    FIRST_CORNER,
    constant_ranges_of,
    count_of,
    draws_at_corners,
    moved_parameters,
    ranges_of,
)
from certrack.studies.ensembles.following import following_parameters
from certrack.studies.ensembles.scaled_reference import scaled_reference
from certrack.systems.system import System, require_system

#: Members and times at which the pattern of a registered disturbance is looked at.
CHECKED_MEMBERS, CHECKED_TIMES = 64, 257

#: ||x|| in the disturbances is sqrt(x.x + offset^2) - offset: smooth at zero, never above.
NORM_OFFSET = 1e-6

#: Parameter that scales the reference of a member.
AMPLITUDE = symbol("ref_member_amplitude")


#: Begin of the names of a disturbance's numbers.
DISTURBANCE_PREFIX = "member_w"


def _disturbance_name(k: int, name: str) -> str:
    """Name of a drawn number of w_k among the constants of the plant."""
    return f"{DISTURBANCE_PREFIX}{k}_{name}"


def member(system: System, index: int, *, seed: int = 0) -> System:
    """One member of a system's population, as a system of its own.

    The member that :func:`certrack.ensemble` simulates under this index, whatever the number of
    members: it is a pure function of seed and index.

    Parameters
    ----------
    system : System
    index : int
        From 0.
    seed : int
        Of the ensemble.

    Returns
    -------
    System
        With every drawn number written out; it can be simulated, falsified and saved.

    Raises
    ------
    InputError
        If the index is no whole number from 0 on or beyond the sequence, or the population cannot
        be drawn.

    Examples
    --------
    >>> import certrack
    >>> replayed = certrack.member(certrack.load("example1"), 4188)
    >>> replayed.title.split(" of:")[0]
    'Member 4188 (seed 0)'
    >>> certrack.simulate(replayed).outcome.name
    'finished'
    """
    require_system(system)
    return Members(system, seed).member(index)


def members_of(system: System, seed: int) -> Members:
    """The members of a system for a seed; what does not depend on the seed is made once."""
    return _of_any_seed(system, type(family_of(system.varied))).with_seed(seed)


@remembered
def _of_any_seed(system: System, _family: type) -> Members:
    """Those of the seed 0; the system names its family, which may be registered anew."""
    return Members(system, 0)


class Members:
    """All members of a system's population for one seed.

    Parameters
    ----------
    system : System
    seed : int
    """

    def __init__(self, system: System, seed: int) -> None:
        self.system, self.seed = system, seed
        self.population = system.varied
        self._refuse_unscalable()
        refuse_prefix(system.plant, "member_", "an ensemble")
        self.family = family_of(self.population)
        self._refuse_unsteady()
        numbers = {} if self.family is None else self.family.numbers(self.population)
        self._disturbance_names = tuple(numbers)
        self.columns = self._columns()
        self.template = self._system(
            {name: (d.low + d.high) / 2 for name, d in self.columns.items()}, written=False
        )
        self._constants = tuple(true_constants(self.template))
        self.loop: ClosedLoop = close_loop(self.template)
        self.base = parameter_values(self.loop, self.template)
        self._moved_at_corners = moved_parameters(system)
        self._refuse_large_patterns()

    def with_seed(self, seed: int) -> Members:
        """The members for another seed."""
        if seed == self.seed:
            return self
        others = copy(self)
        others.seed = seed
        others._refuse_large_patterns()
        return others

    def _refuse_unscalable(self) -> None:
        population, reference = self.population, self.system.reference
        scaled = population.amplitude is not None or population.frequency is not None
        if scaled and not isinstance(reference, SymbolicReference):
            raise InputError(
                "ensemble.reference",
                "needs a reference given by a formula",
                remedy="State reference.signal, or leave [ensemble.reference] out",
            )

    def _columns(self) -> dict[str, Distribution]:
        """Name and distribution of every drawn number, in the order of the draws."""
        population, plant = self.population, self.system.plant
        u = plant.uncertainty
        columns: dict[str, Distribution | None] = {}
        for name in ("x0", "estimates", "theta", "tau"):
            entries = getattr(population, name)
            columns |= {f"{name}[{i}]": entry for i, entry in enumerate(entries or ())}
        columns |= {f"constants.{name}": entry for name, entry in self._constants_drawn.items()}
        for name in ("input_gain", "amplitude", "frequency"):
            columns[name] = getattr(population, name)
        if self.family is not None:
            numbers = self.family.numbers(population)
            for k in range(plant.n):
                if u.acts(k):
                    columns |= {_disturbance_name(k, name): d for name, d in numbers.items()}
        return {name: entry for name, entry in columns.items() if entry is not None}

    @cached_property
    def _constants_drawn(self) -> dict[str, Distribution]:
        """What the population draws; another constant with a range is as in the truth.

        So it is a number of each member, and the corners of the ranges can have another.
        """
        drawn, true = dict(self.population.constants), true_constants(self.system)
        ranges = constant_ranges_of(self.system)
        others = {n: Distribution("fixed", (true[n],)) for n in ranges if n not in drawn}
        return drawn | (others if count_of(ranges_of(self.system)) else {})

    def draws(self, begin: int, end: int) -> dict[str, np.ndarray]:
        """Every drawn number of the members begin ... end-1, or of some corners, by name."""
        if begin >= FIRST_CORNER:
            return draws_at_corners(self.system, self.draws, begin, end)
        free = [name for name, entry in self.columns.items() if not entry.fixed]
        table = probabilities(self.population.sampling, self.seed, begin, end, len(free))
        p = dict(zip(free, table, strict=True))
        nothing = np.zeros(end - begin)
        draws = {name: d.quantile(p.get(name, nothing)) for name, d in self.columns.items()}
        if self.family is None:
            return draws
        for k in range(self.system.plant.n):
            names = {name: _disturbance_name(k, name) for name in self._disturbance_names}
            if names and next(iter(names.values())) in draws:
                fitting = self.family.adjusted({name: draws[full] for name, full in names.items()})
                draws |= {_disturbance_name(k, name): values for name, values in fitting.items()}
        return draws

    def member(self, index: int) -> System:
        """Member `index` as a system of its own, its numbers written out.

        Raises
        ------
        InputError
            If the index is negative or beyond the sequence.
        """
        checks.integer("index", index, 0, MAX_MEMBERS - 1)
        return self._written(index)

    def corner(self, index: int) -> System:
        """Corner `index` of the ranges as a system of its own, its numbers written out.

        Raises
        ------
        InputError
            If there is no such corner.
        """
        count = count_of(ranges_of(self.system))
        if not count:
            message = "there are no corners: they are run for 1 to 6 ranges in [plant.ranges]"
            raise InputError("corner", message, index)
        checks.integer("corner", index, 0, count - 1)
        return self._written(FIRST_CORNER + index)

    def _written(self, index: int) -> System:
        draws = self.draws(index, index + 1)
        return self._one(index, {name: float(v[0]) for name, v in draws.items()}, written=True)

    def run(self, index: int) -> Run:
        """The run of member `index`; all members share one compiled simulator."""
        draws = self.draws(index, index + 1)
        point = {name: float(v[0]) for name, v in draws.items()}
        run = self._simulator.run(self._one(index, point, written=False))
        return replace(run, system=self._one(index, point, written=True))

    @cached_property
    def _simulator(self) -> Simulator:
        return Simulator(self.template)

    def _one(self, index: int, point: dict[str, float], *, written: bool) -> System:
        """Member `index`, whose draws are `point`."""
        is_corner = index >= FIRST_CORNER
        if written and not is_corner:  # what nobody draws is as in the truth
            drawn = dict(self.population.constants)
            added = {f"constants.{n}" for n in self._constants_drawn if n not in drawn}
            point = {name: value for name, value in point.items() if name not in added}
        system = self._system(point, written=written)
        implementation = system.implementation
        what = f"Corner {index - FIRST_CORNER}" if is_corner else f"Member {index}"
        return system.replace(
            title=f"{what} (seed {self.seed}) of: {self.system.title}",
            implementation=None
            if implementation is None
            else replace(implementation, seed=self.seed, stream=index),
        )

    def table(self, begin: int, end: int) -> tuple[np.ndarray, dict[sympy.Symbol, np.ndarray]]:
        """Starts (S, N), and the values of every parameter that differs between members."""
        draws, count = self.draws(begin, end), end - begin
        plant, names = self.system.plant, [state.name for state in self.loop.states]
        starts = np.repeat(np.array(self.system.start)[:, None], count, axis=1)
        n = self.loop.n
        for i in range(len(starts)):
            name = f"x0[{i}]" if i < n else f"estimates[{i - n}]"
            starts[i] = draws.get(name, starts[i])
        assert len(starts) == len(names) - 3
        columns = self._derived(draws, count)
        for name, values in draws.items():
            if match := re.fullmatch(r"(theta|tau)\[(\d+)\]", name):
                columns[f"true_{match[1]}_{match[2]}"] = values
            elif name in ("amplitude", "frequency"):
                columns[f"ref_member_{name}"] = values
        if "input_gain" in draws:
            columns[f"true_g_{plant.n - 1}"] = draws["input_gain"]
        for i, name in enumerate(self._constants):
            drawn = draws.get(name if name.startswith("member_") else f"constants.{name}")
            if drawn is not None:
                columns[f"true_constants_{i}"] = drawn
        columns |= self._joined(starts[:n])
        for i, name in enumerate(map(str, self.loop.parameters)):
            if name in self._moved_at_corners:  # else as in the truth
                columns.setdefault(name, np.full(count, self.base[i]))
        return starts, {symbol(name): values for name, values in columns.items()}

    def _joined(self, x0: np.ndarray) -> dict[str, np.ndarray]:
        """A soft start begins where each member does."""
        reference = self.template.reference
        if not isinstance(reference, SoftStart):
            return {}
        begins = output_derivatives(self.system.plant)[: len(reference.start)] @ x0
        return {f"ref_gap_{i}": row for i, row in enumerate(reference.gaps(begins))}

    def _derived(self, draws: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
        """Numbers of the plant that follow from its varying constants."""
        moving, evaluate, values = self._following
        if not moving:
            return {}
        columns = [draws.get(f"constants.{name}", value) for name, value in values.items()]
        return dict(zip(moving, rows(evaluate(*columns), count), strict=True))

    @cached_property
    def _following(self) -> tuple[list[str], Callable[..., list[Any]], dict[str, float]]:
        return following_parameters(self.system, self.loop, self._constants_drawn)

    def _system(self, point: dict[str, float], *, written: bool) -> System:
        """One member; its disturbance and reference numbers written out, or as constants."""
        system, plant = self.system, self.system.plant
        settings = system.settings
        x0 = [point.get(f"x0[{i}]", v) for i, v in enumerate(settings.x0)]
        start = system.start[len(x0) :]
        estimates = [point.get(f"estimates[{i}]", v) for i, v in enumerate(start)]
        if not written and self.family is not None:
            numbers = {
                name: value for name, value in point.items() if name.startswith(DISTURBANCE_PREFIX)
            }
            plant = replace(plant, constants=dict(plant.constants) | numbers)  # type: ignore[arg-type]
        return System(
            plant=plant,
            law=system.law,
            reference=scaled_reference(system.reference, point),
            truth=self._truth(point, plant, written=written),
            settings=replace(settings, x0=tuple(x0), estimates=tuple(estimates) or None),
            title=system.title,
            implementation=system.implementation,
        )

    def _truth(self, point: dict[str, float], plant: Plant, *, written: bool) -> Truth:
        truth = self.system.truth
        others: dict[str, Any] = {name: value.text for name, value in truth.constants}
        others |= {n[10:]: v for n, v in point.items() if n.startswith("constants.")}
        if truth.states:
            return replace(truth, constants=others).bound_to(plant)  # type: ignore[arg-type]
        assert truth.tau is not None and truth.input_gain is not None
        omega: Any = truth.omega
        if self.family is not None:
            omega = self._omega(point, written=written)
        return Truth(
            input_gain=point.get("input_gain", truth.input_gain.text),  # type: ignore[arg-type]
            theta=tuple(
                point.get(f"theta[{i}]", v.text)  # type: ignore[misc, arg-type]
                for i, v in enumerate(truth.theta)
            ),
            omega=omega,
            tau=tuple(point.get(f"tau[{i}]", v) for i, v in enumerate(truth.tau)),
            constants=others,  # type: ignore[arg-type]
        ).bound_to(plant)

    def _omega(self, point: dict[str, float], *, written: bool) -> tuple[str, ...]:
        """w_k = s_k(t) (gamma_k ||x|| + beta_k); s_k(t) times what its speed admits."""
        assert self.family is not None
        plant, u = self.system.plant, self.system.plant.uncertainty
        fastest = self.population.frequencies[1]
        terms = []
        for k in range(plant.n):
            pattern = self._pattern(k, point, written=written)
            varies = u.acts(k)
            slow = slow_size(u, k, fastest)
            bound = u.bound_formula(k, plant.states, NORM_OFFSET) if varies else ""
            bound = bound if slow is None else repr(slow)
            terms.append(f"({pattern})*({bound})" if varies else "0")
        return tuple(terms)

    def _pattern(self, k: int, point: dict[str, float], *, written: bool) -> str:
        """s_k with its numbers, or with their names."""
        assert self.family is not None

        def number(name: str) -> str:
            full = _disturbance_name(k, name)
            return f"({point[full]!r})" if written else full

        u = self.system.plant.uncertainty
        if not u.acts(k):
            return "0"
        return self.family.pattern(number)

    def _refuse_unsteady(self) -> None:
        """Only of sines is it known how fast they are."""
        if self.family is None or isinstance(self.family, Multisine):
            return
        if self.system.plant.uncertainty.rate is not None:
            raise InputError(
                "ensemble.disturbance",
                "may change faster than plant.uncertainty.rate says",
                self.family.kind,
                'Use "multisine" or "file", or remove the rate',
            )

    def _refuse_large_patterns(self) -> None:
        """A registered family that passes 1 at a sample breaks Assumption 1."""
        if self.family is None or isinstance(self.family, Multisine):
            return
        draws = self.draws(0, CHECKED_MEMBERS)
        times = np.linspace(0.0, self.system.settings.duration, CHECKED_TIMES)
        for k in range(self.system.plant.n):
            names = [name for name in draws if name.startswith(_disturbance_name(k, ""))]
            text = self._pattern(k, {}, written=False)
            formula = parse("disturbance", text, ["t", *names]).expr
            values = numpy_callable([TIME, *map(symbol, names)], [formula])(
                times[:, None], *(draws[name][None] for name in names)
            )[0]
            worst = float(np.abs(values).max())
            if not worst <= 1:
                kind = self.family.kind
                raise InputError(f"disturbance.{kind}", "must stay within [-1, 1]", f"{worst:.6g}")

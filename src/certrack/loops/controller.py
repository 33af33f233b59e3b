"""The controller in discrete time, as it runs every period: from measurements to the input.

One description serves the simulation, the exported code and the block-diagram tools. With the
measured states m, the reference Y = (y_d ... y_d^(q+1)) and the controller's own states s, all at
t_k:

    x_{i+1} = (v_i - sum_j b_ij x_j)/g_i        where not measured; v_i: filtered difference of x_i
                                                or all by an observer (:mod:`~.observers`)
    u_law   = law(x, Y, estimates)
    u       = u_law, within the saturation and the rate limit
    z_{k+1} = z_k + W rate(x, Y, z_k)           estimates; only forgetting while u /= u_law

A law whose formulas contain the time gets t_k = k T, with k among the states: what is exported
knows the time without being told.

W = T I is forward Euler. ``exact_leak`` takes the constant part L of the Jacobian of the rates by
the estimates (the leak) into account exactly: W = L^-1 (exp(L T) - I) [exponential Euler].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
import sympy

from certrack.core.expressions import TIME, symbol
from certrack.core.select import Select, clamp, magnitude
from certrack.laws.base import Controller
from certrack.laws.leakage import leak_jacobian
from certrack.laws.observer import DOB
from certrack.loops.observers import INPUT_BEFORE, at_rest, estimation
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant

#: Pairs (symbol, formula), to be computed in this order.
Assignments = tuple[tuple[sympy.Symbol, sympy.Expr], ...]

#: What is remembered, its next value, and the one before the first sample, as in `presets`.
Memory = tuple[sympy.Symbol, sympy.Expr, sympy.Expr]

#: The commanded input, and the one that the law asks for before any limit.
COMMAND, LAW_INPUT = symbol("ctl_u"), symbol("ctl_u_law")

PERIOD = symbol("ctl_period")

#: The time of the sample, and its number, which counts from offset/T on.
SAMPLE_TIME, SAMPLE_NUMBER = symbol("ctl_time"), symbol("ctl_sample")

#: 1 at the first sample, 0 later: there is nothing to take a difference from yet.
FIRST = symbol("ctl_first")


@dataclass(frozen=True)
class SampledController:
    """A controller in discrete time; equal for implementations that differ in numbers only.

    Attributes
    ----------
    measured : n symbols
        Of the plant's states; those that are differenced are not used.
    Y : symbols
        y_d ... y_d^(q+1).
    estimates : symbols
        The law's own states; they come first among `states`.
    states : symbols
        All that is remembered from sample to sample.
    steps : pairs (symbol, formula)
        To be computed in this order; the last one is :data:`COMMAND`.
    update : formulas, one per state
        Of everything above.
    parameters : symbols
        Of :func:`~.controller_values.controller_values`: gains, then numbers of the implementation.
    gain_names : names of the law's gains
    hold : pairs (i, j)
        Entries of W that are not structurally zero, where it is not T I.
    leak : formulas
        Constant part of the Jacobian, row-major, of the gains.
    presets : formulas, one per state
        Over what is measured at the first sample and :data:`~.observers.INPUT_BEFORE`: with these
        values before it the first sample is as any other. Zero for estimates.
    values : pairs (symbol, formula)
        What the law takes for states that it is not given as they are measured, and for own
        states that begin at the first measurement.
    compensation : formula
        What an observer adds to the law's input.
    """

    measured: tuple[sympy.Symbol, ...]
    Y: tuple[sympy.Symbol, ...]
    estimates: tuple[sympy.Symbol, ...]
    states: tuple[sympy.Symbol, ...]
    steps: Assignments
    update: tuple[sympy.Expr, ...]
    parameters: tuple[sympy.Symbol, ...]
    gain_names: tuple[str, ...]
    hold: tuple[tuple[int, int], ...]
    leak: tuple[sympy.Expr, ...]
    presets: tuple[sympy.Expr, ...]
    values: Assignments
    compensation: sympy.Expr

    @property
    def numbers(self) -> tuple[sympy.Symbol, ...]:
        """The parameters that an implementation of the same structure may change."""
        return tuple(name for name in self.parameters if name.name.startswith("ctl_"))


def sampled_controller(
    plant: Plant, controller: Controller, implementation: Implementation
) -> SampledController:
    """The controller of a law in discrete time.

    Parameters
    ----------
    plant : Plant
        Of the design: its chain gives the states that are not measured.
    controller : Controller
        The law in continuous time.
    implementation : Implementation
        Only what it has counts here (limits, differences, anti-windup), not its numbers.

    Returns
    -------
    SampledController
    """
    s = controller.signals
    steps: list[tuple[sympy.Symbol, sympy.Expr]] = []
    memories: list[Memory] = []
    numbers = [PERIOD]
    law, compensation = controller.law, sympy.S.Zero
    observer = None if law is None else law.observer
    differenced = observer is None or observer.kind == DOB
    x = _state_values(plant, implementation, steps, memories, numbers) if differenced else {}
    if observer is not None:
        assert law is not None
        observed = estimation(plant, law, implementation, x, COMMAND, FIRST)
        steps += observed.steps
        memories += observed.memories
        numbers += observed.numbers
        x, compensation = x | observed.values, observed.compensation
    started = first_values(controller, x)
    if memories or started:
        memories.append((FIRST, sympy.S.Zero, sympy.S.Zero))
    steps += started
    x |= {z: step for (z, _), (step, _) in zip(controller.equations.first, started, strict=True)}
    values = tuple(x.items())
    if any(formula.has(TIME) for formula in controller.equations.formulas.values()):
        steps.append((SAMPLE_TIME, PERIOD * SAMPLE_NUMBER))
        memories.append((SAMPLE_NUMBER, SAMPLE_NUMBER + 1, sympy.S.Zero))
        x[TIME] = SAMPLE_TIME
    steps.append((LAW_INPUT, controller.equations.u.xreplace(x) + compensation))
    steps.append((COMMAND, _limited(implementation, numbers)))
    if implementation.rate_limit is not None:
        memories.append((symbol("ctl_u_last"), COMMAND, INPUT_BEFORE))
    estimates = controller.states
    x[s.applied] = COMMAND
    rates = [rate.xreplace(x) for _, rate in controller.equations.update]
    leak = leak_jacobian(controller) if implementation.update == "exact_leak" else ()
    hold = _hold_entries(leak, len(estimates))
    numbers += [symbol(f"ctl_hold_{i}_{j}") for i, j in hold]
    if implementation.projection is not None:
        numbers += _projection_limits(len(estimates))
    now = [x.get(z, z) for z in estimates]
    forgetting = forgetting_rates(rates, {*controller.symbols, *now})
    filters = [x.get(z, z) for z in controller.equations.filters]
    after = next_estimates(now, rates, forgetting, hold, implementation, filters)
    constants = [symbol(name) for name in plant.constant_values]
    return SampledController(
        measured=s.x,
        Y=s.Y,
        estimates=estimates,
        states=(*estimates, *(name for name, _, _ in memories)),
        steps=tuple(steps),
        update=(*after, *(formula for _, formula, _ in memories)),
        parameters=(*controller.symbols, *constants, *numbers),
        gain_names=tuple(s.all_parameters),
        hold=hold,
        leak=leak,
        presets=(*(sympy.S.Zero,) * len(estimates), *(before for _, _, before in memories)),
        values=values,
        compensation=compensation,
    )


def first_values(controller: Controller, x: Mapping[sympy.Symbol, sympy.Expr]) -> Assignments:
    """Own states as the law takes them, those that begin at what is measured at the first sample.

    Parameters
    ----------
    controller : Controller
    x : mapping
        What stands for states that are not measured.
    """
    return tuple(
        (symbol(f"ctl_begun_{z.name}"), z + FIRST * value.xreplace(x))
        for z, value in controller.equations.first
    )


def next_estimates(
    estimates: Sequence[sympy.Expr],
    rates: Sequence[sympy.Expr],
    forgetting: Sequence[sympy.Expr],
    hold: Sequence[tuple[int, int]],
    implementation: Implementation,
    filters: Sequence[sympy.Symbol] = (),
) -> list[sympy.Expr]:
    """The estimates after one period.

    Parameters
    ----------
    estimates, rates : formulas
        Rates may be symbols for them.
    forgetting : formulas
        The rates' part that :func:`forgetting_rates` finds.
    hold : pairs (i, j)
        See :class:`SampledController`.
    implementation : Implementation
    filters : symbols
        Those of the estimates that move on while the input is limited.

    Returns
    -------
    formulas, one per estimate
    """
    rises = _weighted(rates, hold)
    limited = implementation.saturation is not None or implementation.rate_limit is not None
    if limited and implementation.anti_windup != "none":
        if implementation.anti_windup != "leak":
            forgetting = [sympy.S.Zero] * len(rises)
        limited_rises = _weighted(
            [
                rate if z in filters else slow
                for z, rate, slow in zip(estimates, rates, forgetting, strict=True)
            ],
            hold,
        )
        excess = magnitude(LAW_INPUT - COMMAND)
        rises = [
            rise if slow == rise else Select(excess, 0, slow, rise)
            for slow, rise in zip(limited_rises, rises, strict=True)
        ]
    after = [z + rise for z, rise in zip(estimates, rises, strict=True)]
    if implementation.projection is None:
        return after
    limits = _projection_limits(len(after))
    return [
        clamp(z, low, high) for z, low, high in zip(after, limits[::2], limits[1::2], strict=True)
    ]


def _projection_limits(estimates: int) -> list[sympy.Symbol]:
    """Limits of the projection: low, high, low ..."""
    return [symbol(f"ctl_box_{i}") for i in range(2 * estimates)]


def differenced(name: str) -> sympy.Symbol:
    """Stands for a state that is not measured."""
    return symbol(f"ctl_value_{name}")


def _state_values(
    plant: Plant,
    implementation: Implementation,
    steps: list[tuple[sympy.Symbol, sympy.Expr]],
    memories: list[Memory],
    numbers: list[sympy.Symbol],
) -> dict[sympy.Symbol, sympy.Expr]:
    """What stands for a state that is not measured: its value by differences.

    Adds to `steps` what is computed for it, to `memories` what is remembered, to `numbers` the
    parameters.
    """
    values: dict[sympy.Symbol, sympy.Expr] = {}
    if not implementation.velocity:
        return values
    x, pole = plant.symbols, symbol("ctl_filter")
    numbers.append(pole)
    still = at_rest(plant, implementation.velocity)
    for i in range(1, plant.n):
        if plant.states[i] not in implementation.velocity:
            continue
        name = plant.states[i]
        position = values.get(x[i - 1], x[i - 1])
        before, speed = symbol(f"ctl_before_{name}"), symbol(f"ctl_speed_{name}")
        difference = Select(FIRST, 0, 0, (position - before) / PERIOD)
        filtered, value = symbol(f"ctl_filtered_{name}"), differenced(name)
        assert plant.linear is not None
        row = [b.expr * values.get(x[j], x[j]) for j, b in enumerate(plant.linear[i - 1])]
        steps.append((filtered, speed + pole * (difference - speed)))
        steps.append((value, (filtered - sympy.Add(*row)) / plant.chain[i - 1].expr))
        memories += [(before, position, still[x[i - 1]]), (speed, filtered, sympy.S.Zero)]
        values[x[i]] = value
    return values


def _limited(implementation: Implementation, numbers: list[sympy.Symbol]) -> sympy.Expr:
    """The input that the law asks for, within the limits."""
    command: sympy.Expr = LAW_INPUT
    if implementation.rate_limit is not None:
        last, step = symbol("ctl_u_last"), symbol("ctl_u_step")
        numbers.append(step)
        command = clamp(command, last - step, last + step)
    if implementation.saturation is not None:
        low, high = symbol("ctl_u_low"), symbol("ctl_u_high")
        numbers += [low, high]
        command = clamp(command, low, high)
    return command


def forgetting_rates(rates: Sequence[sympy.Expr], names: Set[sympy.Symbol]) -> list[sympy.Expr]:
    """The terms of the rates in `names` (gains and estimates) alone: leakage towards the priors."""
    terms = (sympy.Add.make_args(sympy.expand(rate)) for rate in rates)
    return [sympy.Add(*(term for term in part if term.free_symbols <= names)) for part in terms]


def _weighted(rates: Sequence[sympy.Expr], hold: Sequence[tuple[int, int]]) -> list[sympy.Expr]:
    """W times the rates."""
    if not hold:
        return [PERIOD * rate for rate in rates]
    weights = {(i, j): symbol(f"ctl_hold_{i}_{j}") for i, j in hold}
    return [
        sympy.Add(*(w * rates[j] for (row, j), w in weights.items() if row == i))
        for i in range(len(rates))
    ]


def _hold_entries(leak: tuple[sympy.Expr, ...], count: int) -> tuple[tuple[int, int], ...]:
    """Entries of W that are not structurally zero: those of I + |L| + |L|^2 + ..."""
    if not any(leak):
        return ()
    links = np.array([entry != 0 for entry in leak]).reshape(count, count)
    reach = np.eye(count, dtype=bool) | links
    for _ in range(count):
        reach = (reach.astype(int) @ reach.astype(int)) > 0
    return tuple((int(i), int(j)) for i, j in np.argwhere(reach))


def starting_state(
    controller: SampledController, estimates: tuple[float, ...], implementation: Implementation
) -> np.ndarray:
    """States before the first sample.

    Parameters
    ----------
    controller : SampledController
    estimates : numbers
        The law's own states at the start.
    implementation : Implementation
        Has the input before the first sample.

    Returns
    -------
    (S,) array
    """
    first_number = implementation.offset / implementation.period
    initial = {FIRST: 1.0, SAMPLE_NUMBER: first_number}
    before = zip(controller.states, controller.presets, strict=True)
    initial |= {
        name: implementation.initial_input for name, preset in before if preset == INPUT_BEFORE
    }
    memories = [initial.get(name, 0.0) for name in controller.states[len(controller.estimates) :]]
    return np.array([*estimates, *memories])


def resolved(controller: SampledController) -> tuple[sympy.Expr, tuple[sympy.Expr, ...]]:
    """The command and the next states as formulas without intermediate steps."""
    known: dict[sympy.Symbol, sympy.Expr] = {}
    for name, formula in controller.steps:
        known[name] = formula.xreplace(known)
    return known[COMMAND], tuple(formula.xreplace(known) for formula in controller.update)


def planning_base(controller: SampledController) -> tuple[sympy.Expr, ...]:
    """The input that the law asks for without limits, then the states that it takes."""
    known: dict[sympy.Symbol, sympy.Expr] = {}
    for name, formula in controller.steps:
        known[name] = formula.xreplace(known)
    values = dict(controller.values)
    states = [values.get(x, x).xreplace(known) for x in controller.measured]
    return (known[LAW_INPUT], *states)

"""A closed loop whose disturbances and reference are controls, held in short steps.

    w_k = s_k bound_k(x), |s_k| <= 1       y_d^(m) held on pieces, m = q + 1

The states are those of plant and controller, then y_d ... y_d^(m-1); parameters are g_n and the
theta_i with ranges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy

from certrack.certificates.worst_profile import stopping_widths, turning_time
from certrack.core.arrays import Array
from certrack.core.expressions import symbol
from certrack.integrators.controlled import ControlledFlow, ControlledRuns
from certrack.loops.continuous import close_loop, driven_loop, parameter_values
from certrack.studies.falsifier.ascent.at_end import SoughtAtEnd
from certrack.studies.falsifier.draft import SystemDraft
from certrack.studies.falsifier.loop import slowest_time_constant
from certrack.studies.falsifier.outputs import ERROR, SoughtOutput
from certrack.studies.falsifier.patterns import ADVERSARY_PREFIX
from certrack.systems.system import System

#: Length of the run, in time constants of the slowest mode: e^-10 is left of the start.
ASCENT_TIME_CONSTANTS = 10.0

#: A run that is cut to fewer, since it would have too many steps, shows its start and no long run.
LEAST_TIME_CONSTANTS = 5.0

#: A step over the fastest time constant of the nominal error, and steps at most.
CONTROL_STEP_PART, MOST_CONTROL_STEPS = 0.15, 4000

#: A piece of the reference lasts this part of the time from it to the end, at least so many steps,
#: and not longer than this part of the time in which the reference can turn: y_d that turned long
#: ago matters where estimates forget slowly. Pieces at most, whatever their length.
PIECE_PART, LEAST_PIECE, TURNING_PART, MAX_REFERENCE_PIECES = 0.07, 2, 0.5, 400

#: Pieces by which a reference comes to rest after the end.
RESTING_PIECES = 24

#: ||x|| in a disturbance is sqrt(x.x + offset^2) - offset.
SHARE_NORM_OFFSET = 2.0**-14


@dataclass(frozen=True)
class AdversaryInputs:
    """What N members are given.

    Attributes
    ----------
    shares : (K, C, N) array
        s_k of every step, within -1 and 1.
    begin : (m, N) array
        y_d ... y_d^(m-1) at the beginning.
    pieces : (pieces + RESTING_PIECES, N) array
        y_d^(m); with the last ones the reference comes to rest after the end.
    truths : (P, N) array
        g_n and theta, where they have ranges.
    """

    shares: Array
    begin: Array
    pieces: Array
    truths: Array

    @property
    def count(self) -> int:
        """Members."""
        return self.begin.shape[1]

    def parts(self) -> tuple[Array, Array, Array, Array]:
        """All of them."""
        return self.shares, self.begin, self.pieces, self.truths

    def finer(self, times: int) -> AdversaryInputs:
        """The same for a loop with so many times as many steps."""
        return AdversaryInputs(
            np.repeat(self.shares, times, axis=0), self.begin, self.pieces, self.truths
        )

    def coarser(self, times: int) -> AdversaryInputs:
        """The same for a loop with so many times as few steps: the share of every such step."""
        return AdversaryInputs(self.shares[::times], self.begin, self.pieces, self.truths)

    def towards(self, others: AdversaryInputs, part: Array) -> AdversaryInputs:
        """A part (N,) of the way to others: admissible if both are."""
        pairs = zip(self.parts(), others.parts(), strict=True)
        return AdversaryInputs(*(a + part * (b - a) for a, b in pairs))

    def where(self, mask: Array, others: AdversaryInputs) -> AdversaryInputs:
        """These where the mask (N,) is true, and others elsewhere."""
        pairs = zip(self.parts(), others.parts(), strict=True)
        return AdversaryInputs(*(np.where(mask, a, b) for a, b in pairs))

    def subset(self, members: Array) -> AdversaryInputs:
        """Those with these numbers."""
        return AdversaryInputs(*(a[..., members] for a in self.parts()))


class ControlledLoop:
    """A system whose disturbances, reference and true parameters are controls.

    Parameters
    ----------
    system : System
        Without an implementation.
    bounds : Y_0 ... Y_m
    finer : int
        So many times as many steps as usual.
    sought : SoughtOutput
        What is to be made large.

    Attributes
    ----------
    acting : numbers of the states whose w_k acts
    ranges : (P, 2) array
        Of the parameters.
    widths : (K,) array, s
        Of the steps.
    piece_steps : (pieces,) array of int
        How many steps each piece of the reference lasts.
    """

    def __init__(
        self,
        system: System,
        bounds: tuple[float, ...],
        finer: int = 1,
        sought: SoughtOutput = ERROR,
    ) -> None:
        self.system, self.bounds, self.sought = system, np.array(bounds), sought
        plant, u = system.plant, system.plant.uncertainty
        self.acting = tuple(k for k in range(plant.n) if u.tau[k] > 0 and u.acts(k))
        self.held = tuple(u.slowness(k) is not None for k in self.acting)
        names, boxes = [], []
        if plant.input_gain_range and len(set(plant.input_gain_range)) > 1:
            names.append(f"true_g_{plant.n - 1}")
            boxes.append(plant.input_gain_range)
        for i, (low, high) in enumerate(plant.theta_range or ()):
            if low < high:
                names.append(f"true_theta_{i}")
                boxes.append((low, high))
        self.truth_names = tuple(names)
        self.ranges = np.array(boxes, dtype=float).reshape(len(boxes), 2)
        count, step = self._steps()
        self.widths = np.full(finer * count, step / finer)
        turning = TURNING_PART * turning_time(self.bounds) / step
        self.piece_steps = finer * _pieces(
            count, max(int(turning), -(-count // MAX_REFERENCE_PIECES))
        )

    def _steps(self) -> tuple[int, float]:
        poles = self.system.controller.coordinates.poles
        horizon = ASCENT_TIME_CONSTANTS * slowest_time_constant(self.system)
        step = CONTROL_STEP_PART / float(np.abs(poles).max())
        count = min(MOST_CONTROL_STEPS, int(np.ceil(horizon / step)))
        return count, step

    def with_steps(self, finer: int) -> ControlledLoop:
        """The same with so many times as many steps as usual."""
        return ControlledLoop(self.system, tuple(self.bounds.tolist()), finer, self.sought)

    @property
    def horizon(self) -> float:
        """Length of a run, s."""
        return float(self.widths.sum())

    @property
    def forgets_start(self) -> bool:
        """Whether the run lasts until too little of its start is left to be taken for an error."""
        least = LEAST_TIME_CONSTANTS * slowest_time_constant(self.system)
        return self.horizon >= least

    @property
    def piece_widths(self) -> Array:
        """Of the pieces of the reference up to the end, s."""
        return np.add.reduceat(self.widths, np.cumsum(self.piece_steps) - self.piece_steps)

    @property
    def stopping_widths(self) -> Array:
        """Of the pieces after the end, s."""
        return stopping_widths(self.bounds, RESTING_PIECES)

    def share_bound(self, k: int) -> str:
        """The bound of w_k, of which s_k is the share, as a formula."""
        u = self.system.plant.uncertainty
        if u.slowness(k) is not None:
            return repr(u.beta[k])
        return u.bound_formula(k, self.system.plant.states, SHARE_NORM_OFFSET)

    @property
    def runs(self) -> ControlledRuns:
        """The loop, compiled."""
        return self._formulas[0]

    @cached_property
    def _formulas(self) -> tuple[ControlledRuns, SoughtAtEnd]:
        """The loop, compiled, and what is sought of its states, controls and parameters."""
        m, draft = len(self.bounds) - 1, SystemDraft(self.system)
        for k in self.acting:
            name = f"{ADVERSARY_PREFIX}s{k}"
            draft.constants[name] = 0.0
            draft.omega[k] = f"{name}*({self.share_bound(k)})"
        template = draft.finish(self.system.settings)
        loop = close_loop(template)
        Y = tuple(sympy.Symbol(f"reference_{i}", real=True) for i in range(m + 1))
        known = len(template.controller.signals.Y)
        u, e_1, rates = driven_loop(template, loop.plant, Y[:known])
        constants = list(template.plant.constant_values)
        shares = [
            symbol(f"true_constants_{constants.index(f'{ADVERSARY_PREFIX}s{k}')}")
            for k in self.acting
        ]
        free = [symbol(name) for name in self.truth_names]
        fixed = {
            name: sympy.Float(float(value))
            for name, value in zip(loop.parameters, parameter_values(loop, template), strict=False)
            if name not in (*shares, *free)
        }
        formulas = (*(rate.xreplace(fixed) for rate in rates), *Y[1:])
        states = (*loop.states[: len(rates)], *Y[:m])
        flow = ControlledFlow(states, (*shares, Y[m]), tuple(free), formulas)
        sought = self.sought.formula(replace(loop, u=u, e_1=e_1)).xreplace(fixed)
        return ControlledRuns(flow), SoughtAtEnd(flow, sought)

    @cached_property
    def resting(self) -> Array:
        """x where the error of the nominal law is zero, from y_d ... y_d^(m-1)."""
        c = self.system.controller.coordinates
        x: Array = np.linalg.solve(c.A, c.B)
        return x

    @property
    def at_end(self) -> SoughtAtEnd:
        """What is sought, from states, controls and parameters at the end."""
        return self._formulas[1]

    def arguments(self, inputs: AdversaryInputs) -> tuple[Array, Array, Array, Array]:
        """Widths, starts, controls and parameters of the members.

        They begin where the error of the nominal law is zero, with the law's own estimates.
        """
        n, size = self.system.plant.n, len(self.system.start)
        starts = np.zeros((size + len(inputs.begin), inputs.count))
        starts[:size] = np.array(self.system.start)[:, None]
        starts[:n] = self.resting @ inputs.begin
        starts[size:] = inputs.begin
        steep = np.repeat(inputs.pieces[: len(self.piece_steps)], self.piece_steps, axis=0)
        controls = np.concatenate([inputs.shares, steep[:, None]], axis=1)
        return self.widths, starts, controls, inputs.truths

    def errors(self, inputs: AdversaryInputs) -> Array:
        """e_1, or what else is sought, at the end, of every member."""
        arguments = self.arguments(inputs)
        states = self.runs.run(*arguments)
        return self.at_end.values(states[-1], arguments[2][-1], inputs.truths)

    def slopes(self, inputs: AdversaryInputs) -> tuple[Array, AdversaryInputs]:
        """The same, and its slopes by the inputs."""
        arguments = self.arguments(inputs)
        last, truths = arguments[2][-1], inputs.truths
        ends = None if self.at_end.is_linear else self.runs.run(*arguments)[-1]
        at_end = self.at_end.slopes(ends, last, truths)
        states, back = self.runs.run_back(*arguments, at_end.by_states)
        back.controls[-1] += at_end.by_controls
        n, size = self.system.plant.n, len(self.system.start)
        begin = back.start[size:] + self.resting.T @ back.start[:n]
        first = np.cumsum(self.piece_steps) - self.piece_steps
        steep = np.add.reduceat(back.controls[:, -1], first, axis=0)
        steep = np.concatenate([steep, np.zeros((RESTING_PIECES, inputs.count))])
        values = self.at_end.values(states[-1], last, truths)
        by_truths = back.parameters + at_end.by_parameters
        return values, AdversaryInputs(back.controls[:, :-1], begin, steep, by_truths)


def _pieces(steps: int, longest: int) -> Array:
    """How many steps the pieces of the reference last, the earliest first."""
    counts, left, done = list[int](), steps, 0
    while left:
        count = min(left, max(LEAST_PIECE, min(longest, int(PIECE_PART * done))))
        counts.append(count)
        left, done = left - count, done + count
    return np.array(counts[::-1])

"""The probes of a monitor reach both sides of every limit, and its numbers keep inside it."""

import math
from dataclasses import replace
from fractions import Fraction
from functools import cached_property

import mpmath
import numpy as np
import pytest
import sympy
from exported import sampled
from test_monitor import FREE, FULL

from certrack import Monitor
from certrack.core.errors import InputError
from certrack.core.expressions import symbol
from certrack.export.golden_vectors import MUTATION, golden_vectors
from certrack.export.monitor import (
    COMMAND_BEFORE,
    Flag,
    Within,
    monitor_program,
    rounded_to_type,
)
from certrack.export.monitor_probes import (
    BEYOND_BOUND,
    DOWN,
    LEAST_SPEED_LIMIT,
    SPEED_MARGIN,
    UP,
    _expected,
    _input_edges,
    _limited_references,
    _rate_edges,
    _Samples,
    _speed_edges,
    monitor_probes,
)
from certrack.export.program import controller_program
from certrack.loops.controller import COMMAND

SMALL = Monitor(box={"x1": (-1, 1), "x2": ("-1e-5", 0.5)}, limit_reference=True)


class Case:
    def __init__(self, limits, monitor):
        self.box = monitor.box
        self.system = sampled("example1", **limits)
        self.program = controller_program(self.system)
        self.monitor = monitor_program(monitor, self.system, self.program)
        self.vectors = golden_vectors(self.system, self.program)
        self.golden = self.samples(self.vectors.x, self.vectors.Y, self.vectors.states)

    def samples(self, *inputs):
        return _Samples(self.system, self.program, self.monitor, *inputs)

    @cached_property
    def limited(self):
        return list(_limited_references(self.program, self.monitor, self.golden, self.samples))


@pytest.fixture(scope="module", params=["full", "free", "small"])
def case(request):
    limits, monitor = {"full": FULL, "free": FREE, "small": (FULL[0], SMALL)}[request.param]
    return Case(limits, Monitor(box=monitor.box, limit_reference=monitor.limit_reference))


def premises(case):
    return [premise for flag in case.monitor.flags for premise in flag.premises]


def test_conditions_are_of_what_the_controller_reads_keeps_and_answers(case):
    golden, program = case.golden, case.program
    expected = dict(zip(program.measured, golden.x, strict=True))
    expected |= dict(zip(program.Y, golden.Y, strict=True))
    expected |= dict(zip(program.states, golden.answers[1:], strict=True))
    expected |= {COMMAND: golden.answers[0], COMMAND_BEFORE: golden.before}
    for name, numbers in expected.items():
        value, low, high = golden.values(Within(name, sympy.Float(0.1) * name, sympy.Float(0.3)))
        assert (value == numbers).all() and (low == 0.1 * numbers).all() and (high == 0.3).all()
    if not any(flag.of_command for flag in case.monitor.flags):  # nothing limits what is asked for
        assert (golden.asked == golden.answers[0]).all()
    parameters = controller_program(case.system, parameters=True)
    samples = _Samples(case.system, parameters, case.monitor, golden.x, golden.Y, golden.states)
    for name in parameters.parameters:
        value, _, _ = samples.values(between(0, 1, name))
        assert (value == parameters.constants[name]).all()


def test_the_command_before_is_that_of_the_state_or_of_a_disabled_controller(case):
    states, last = case.program.states, symbol("ctl_u_last")
    monitor = replace(case.monitor, off=0.25)
    samples = _Samples(
        case.system, case.program, monitor, case.golden.x, case.golden.Y, case.golden.states
    )
    of_state = case.golden.states[states.index(last)] if last in states else 0.25
    assert (samples.before == of_state).all()


@pytest.mark.parametrize("case", ["full"], indirect=True)
def test_probes_begin_with_the_golden_vectors_as_numbers_of_the_type(case):
    for real, kind in (("double", np.float64), ("float", np.float32)):
        probes = monitor_probes(case.system, case.program, case.monitor, case.vectors, real)
        count = case.vectors.x.shape[1]
        for ours, theirs in ((probes.x, case.vectors.x), (probes.Y, case.vectors.Y)):
            assert (ours[:, :count] == theirs.astype(kind)).all()
            assert (ours.astype(kind) == ours).all()
    assert 0 < SPEED_MARGIN < MUTATION  # else a number that is 0.3 % off is not noticed


def test_inputs_lie_at_their_limits_and_just_beyond(case):
    x, Y, states = _input_edges(case.program, case.monitor, "float64")
    inputs = (*case.program.measured, *case.program.Y)
    table = np.vstack([x, Y])
    assert (np.count_nonzero(table, axis=0) <= 1).all()
    assert (states == np.array(case.program.start)[:, None]).all()
    for premise in premises(case):
        if premise.value in inputs:
            found = set(table[inputs.index(premise.value)])
            low, high = float(premise.low), float(premise.high)
            assert {low, high, np.nextafter(low, -9), np.nextafter(high, 9)} <= found


def test_speeds_lie_on_both_sides_of_their_limits(case):
    seen = 0
    for inputs in _speed_edges(case.program, case.monitor, case.samples):
        probes = case.samples(*inputs)
        assert (inputs[0] == 1).all() and (inputs[1] == 0).all()
        near = [p for p in premises(case) if "ctl_speed" in str(p.value)]
        (premise,) = near
        value, low, high = probes.values(premise)
        for end in (low[0], high[0]):
            margin = max(abs(end), LEAST_SPEED_LIMIT) * SPEED_MARGIN
            for side in (-1, 1):
                wanted = end + side * margin
                assert np.abs(value - wanted).min() <= 1e-6 * margin
        seen += 1
    assert seen == (1 if case.box else 0)


def test_commands_before_lie_far_on_both_sides(case):
    found = list(_rate_edges(case.program, case.golden))
    limited = any("ctl_u_step" in str(c) for c in case.program.constants)
    assert len(found) == limited
    for x, Y, states in found:
        probes = case.samples(x, Y, states)
        step = next(v for c, v in case.program.constants.items() if str(c) == "ctl_u_step")
        assert probes.before - probes.asked == pytest.approx([-3 * step, 3 * step])
        assert abs(probes.asked[0]) == np.abs(case.golden.asked).min()


def test_limited_references_go_beyond_their_bounds(case):
    found = case.limited
    assert len(found) == (2 * len(case.program.Y) if case.monitor.limit_reference else 0)
    for k, (_, Y, _) in enumerate(found):
        bound = case.monitor.reference_bounds[k // 2]
        assert abs(Y[k // 2, 0]) > bound
        assert Y[k // 2, 0] == pytest.approx((-1, 1)[k % 2] * BEYOND_BOUND * bound)


def test_answers_are_to_the_reference_that_is_followed(case):
    """Beyond its bounds the answer is that at the bounds, if the monitor limits it; only then."""
    bounds = np.array(case.monitor.reference_bounds)[:, None]
    beyond = case.golden.Y + 3 * bounds
    x, states = case.golden.x, case.golden.states
    answers = case.samples(x, beyond, states).asked
    at_bounds = case.samples(x, np.clip(beyond, -bounds, bounds), states).asked
    assert (answers == at_bounds).all() == case.monitor.limit_reference


def test_a_limited_reference_is_tried_where_its_bound_counts_most(case):
    """Where y_d^(i) 0.3 % below its bound changes most what the law asks for within its limits."""
    found = case.limited
    limits = [
        (float(p.low), float(p.high))
        for flag in case.monitor.flags
        for p in flag.premises
        if flag.name == "saturated"
    ]
    for n, (x, _, states) in [*enumerate(found)][1:3]:
        i, bound = n // 2, (-1, 1)[n % 2] * case.monitor.reference_bounds[n // 2]
        asked = []
        for part in (1.0, 1.0 - MUTATION):
            Y = case.golden.Y.copy()
            Y[i] = part * bound
            asked.append(case.samples(case.golden.x, Y, case.golden.states).asked)
        effect = np.abs(asked[0] - asked[1])
        for low, high in limits:
            effect[(asked[0] <= low) | (asked[0] >= high)] = 0.0
        k = int(np.argmax(effect))
        assert effect[k] > 0 and (x[:, 0] == case.golden.x[:, k]).all()
        names = [str(s) for s in case.program.states]
        if "ctl_u_last" in names:
            assert states[names.index("ctl_u_last"), 0] == asked[0][k]


class Numbers:
    """Samples whose values, limits and asked inputs are these."""

    def __init__(self, value, asked=None):
        self.value = np.array(value)
        self.asked = self.value if asked is None else np.array(asked)

    def values(self, premise):
        each = np.ones(len(self.value))
        return [self.value, float(premise.low) * each, float(premise.high) * each]


def between(low, high, value="a + b", **options):
    return Within(sympy.sympify(value), sympy.Float(low), sympy.Float(high), **options)


def test_what_lies_near_a_limit_is_left_to_rounding():
    value = [-1 - 1e-2, -1 - 1e-13, -1 + 1e-13, -1 + 1e-2, 1, 3 - 1e-2, 3, 3 + 1e-2, -3]
    flag = Flag("f", "", (between(-1, 3),))
    expected = [UP, 2, 2, DOWN, DOWN, DOWN, 2, UP, UP]
    assert _expected(flag, [flag], Numbers(value), "double").tolist() == expected
    plain = Flag("f", "", (between(-1, 3, "a"),))  # it is not computed
    exact = [UP, UP, DOWN, DOWN, DOWN, DOWN, DOWN, UP, UP]
    assert _expected(plain, [plain], Numbers(value), "double").tolist() == exact
    strict = Flag("f", "", (between(-1, 3, "a", strict=True),))
    exact[6] = UP
    assert _expected(strict, [strict], Numbers(value), "double").tolist() == exact
    both = Flag("f", "", (between(-1, 3, "a"), between(0, 2, "b")))
    found = _expected(both, [both], Numbers([0.0, 1.0, 2.5, -0.5, 4.0]), "double")
    assert found.tolist() == [DOWN, DOWN, UP, UP, UP]


def test_a_flag_of_the_command_is_left_to_rounding_near_the_limits_of_others():
    """u may be what the law asks for, or any other limit that it is moved to."""
    command = Flag("saturated", "", (between(-1, 3, "u", strict=True),), of_command=True)
    same = Flag("rate", "", (between(-5, 3, "u"),), of_command=True)
    apart = Flag("rate", "", (between(-5, 2, "u"),), of_command=True)
    value, asked = [0.0, 3.0, 3.0], [0.0, 4.0, 3.0 + 1e-13]
    alone = _expected(command, [command], Numbers(value, asked), "double")
    assert alone.tolist() == [DOWN, UP, 2]
    lower = Flag("rate", "", (between(-1, 7, "u"),), of_command=True)
    for other in (same, lower):
        found = _expected(command, [command, other], Numbers(value, asked), "double")
        assert found.tolist() == [2] * 3
    found = _expected(command, [command, apart], Numbers(value, asked), "double")
    assert found.tolist() == [DOWN, UP, 2]


def test_every_flag_is_expected_up_and_down(case):
    probes = monitor_probes(case.system, case.program, case.monitor, case.vectors, "double")
    for flag, row in zip(case.monitor.flags, probes.expected, strict=True):
        assert (row == DOWN).any(), flag
        assert (row == UP).any() or not flag.premises, flag
    assert probes.x.shape[1] == probes.Y.shape[1] == len(probes.before) == probes.expected.shape[1]


def test_a_sample_without_an_answer_is_no_probe(case, monkeypatch):
    """Whether the command is not finite or what is kept."""

    class Overflowing(_Samples):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            if self.x.shape[1] > case.vectors.x.shape[1]:
                self.answers = self.answers.copy()
                self.answers[0, 2], self.answers[-1, 5] = np.inf, np.nan

    arguments = (case.system, case.program, case.monitor, case.vectors, "double")
    every = monitor_probes(*arguments)
    monkeypatch.setattr("certrack.export.monitor_probes._Samples", Overflowing)
    found = monitor_probes(*arguments)
    left_out = np.delete(every.x, [2, 5], axis=1)
    assert np.array_equal(found.x, left_out) and found.Y.shape[1] == left_out.shape[1]
    assert found.expected.shape[1] == len(found.before) == left_out.shape[1]


def test_what_is_expected_is_what_the_conditions_say(case):
    for flag in case.monitor.flags:
        row = _expected(flag, case.monitor.flags, case.golden, "double")
        holds = np.ones(row.shape, dtype=bool)
        for premise in flag.premises:
            value, low, high = case.golden.values(premise)
            holds &= (
                (value > low) & (value < high)
                if premise.strict
                else ((value >= low) & (value <= high))
            )
        assert (row[row != 2] == np.where(holds, DOWN, UP)[row != 2]).all()


@pytest.mark.parametrize("root", [2, 3, 5, 6, 7, 10, 11, 13])
def test_irrational_ends_of_a_box_are_rounded_inward(root):
    ((_, (low, high)),) = Monitor(box={"x1": (f"-sqrt({root})", f"sqrt({root})")}).box
    for end in (low, high):
        assert Fraction(end) ** 2 < root
        assert Fraction(abs(end) + 2 * np.spacing(abs(end))) ** 2 > root
    with mpmath.workdps(60):
        assert mpmath.mpf(high) < mpmath.sqrt(root)


def test_a_box_that_is_empty_is_refused():
    for ends in ((1, 1), (2, 1), ("1/3", "1/3"), ("sqrt(2)", "sqrt(2)")):
        with pytest.raises(InputError, match="low must be less than high"):
            Monitor(box={"x1": ends})
    with pytest.raises(InputError, match="monitor.limit_reference: must be True or False"):
        Monitor(limit_reference=1)


@pytest.mark.parametrize(("real", "bits"), [("double", 53), ("float", 24)])
def test_numbers_of_a_monitor_are_the_next_of_their_type(real, bits):
    for value in (0.5, -3.0, 0.1, 1 / 3, 2.0**-10, -0.7):
        exact = Fraction(repr(value))  # what the float stands for
        step = Fraction(2) ** (math.frexp(value)[1] - bits)
        high, low = (Fraction(rounded_to_type(value, real, up=up)) for up in (True, False))
        assert low <= exact <= high and high - low in (0, step)
        assert (high / step).denominator == (low / step).denominator == 1
        assert (high == low) == ((exact / step).denominator == 1)
    with pytest.raises(InputError, match="needs finite bounds"):
        rounded_to_type(math.inf, real, up=True)
    if real == "float":
        with pytest.raises(InputError, match="float cannot hold"):
            rounded_to_type(1e39, real, up=False)

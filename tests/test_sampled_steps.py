"""Steps between two events of a sampled loop, with maps that are known; parts of its controller."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from exported import EVERYTHING, sampled
from test_extensions import law_of

import certrack
from certrack.core.expressions import TIME, symbol
from certrack.core.select import STEP_LENGTH, Select, clamp
from certrack.integrators.base import ESCAPING, Outcome
from certrack.integrators.sampled.events import EventTimeline
from certrack.integrators.sampled.run import SampledProblem, SampledRun, sensed
from certrack.integrators.sampled.step_control import (
    END_ROUNDING,
    FIRST_MAX_FACTOR,
    MAX_FACTOR,
    MAX_INTERVAL_STEPS,
    next_factor,
)
from certrack.laws.observer import Observer
from certrack.loops.continuous import INTEGRAL_SCALE, INTEGRALS
from certrack.loops.controller import (
    COMMAND,
    LAW_INPUT,
    PERIOD,
    _hold_entries,
    _weighted,
    differenced,
    forgetting_rates,
    next_estimates,
    resolved,
    sampled_controller,
    starting_state,
)
from certrack.loops.observers import INPUT_BEFORE, estimation
from certrack.loops.plant import INPUT
from certrack.loops.sampled import AREA, SQUARE, loop_values, run_totals, sample_loop
from certrack.model.noise import normal


class Maps:
    """x' = u and total' = 1, exact; the error is (h/longest)^9 of the member, or what it says."""

    def __init__(self, longest):
        self.longest, self.calls = np.array(longest, dtype=float), 0
        self.shortest = math.inf

    def step(self, t, h, allowed, x, u, totals, p):
        self.calls += 1
        longest = p[0]
        self.shortest = min(self.shortest, float(np.min(h)))
        error = np.where(np.isfinite(longest), (h / np.abs(longest)) ** 9, math.nan)
        return x + h * u, totals + h, error


def run_of(longest, u=None, x=None, max_state=1e6):
    """A run of members with their longest steps, between two events."""
    count = len(longest)
    run = object.__new__(SampledRun)
    run._maps = Maps(longest)
    run._problem = SimpleNamespace(tolerance=1e-6, max_state=max_state)
    run.allowed = 1e-7
    run.x = np.zeros((1, count)) if x is None else np.array([x], dtype=float)
    run.totals = np.zeros((1, count))
    run.u = np.ones(count) if u is None else np.array(u, dtype=float)
    run.parameters = np.array([longest], dtype=float)
    run.alive = np.ones(count, dtype=bool)
    run.run_alone = np.zeros(count, dtype=bool)
    run.outcomes = np.full(count, Outcome.finished, dtype=object)
    return run


def crossed(run, begin=1.0, end=2.0, on_step=None):
    run._cross(begin, end, on_step)
    return run.x[0]


@pytest.mark.parametrize("longest", [[10.0], [0.3], [0.3, 0.01], [10.0, 0.02, 0.4, 7.0, 0.05]])
def test_every_member_crosses_by_its_own_steps(longest):
    u = np.arange(1.0, 1 + len(longest))
    run = run_of(longest, u)
    assert crossed(run) == pytest.approx(u)
    assert run.totals[0] == pytest.approx(np.ones(len(longest)))
    assert (run.outcomes == Outcome.finished).all() and not run.run_alone.any()


def test_a_member_does_not_depend_on_its_neighbours():
    alone = [crossed(run_of([longest]))[0] for longest in (0.3, 0.011)]
    assert list(crossed(run_of([0.3, 0.011]))) == alone


def test_one_late_member_is_enough_and_a_dead_one_is_none():
    for longest in ([10.0, 0.3, 10.0], [0.3]):
        run = run_of(longest)
        crossed(run)
        assert run._maps.calls > 2 and run._maps.shortest <= 0.3
    run = run_of([10.0, 0.3])
    run.alive[1] = False
    crossed(run)
    assert run._maps.calls == 1


@pytest.mark.parametrize(("error", "calls"), [(0.99, 1), (1.01, None), (1.5, None)])
def test_a_step_is_taken_whose_error_is_allowed(error, calls):
    """Not one of a hundredth more: then several shorter ones."""
    longest, seen = error ** (-1 / 9), [1.0]
    run = run_of([longest])
    crossed(run, on_step=lambda t, x, totals, u: seen.append(t))
    assert run._maps.calls == calls or (calls is None and run._maps.calls > 2)
    assert (np.diff(seen) <= longest).all() and seen[-1] == 2.0
    run = run_of([longest])
    run._substep(np.array([0]), 1.0, 2.0, np.array([1.0]), np.zeros((1, 1)), np.zeros((1, 1)), None)
    assert run._maps.calls == calls or (calls is None and run._maps.calls > 2)


@pytest.mark.parametrize(("missing", "calls"), [(0.25, 1), (40.0, 2)])
def test_the_last_step_takes_what_only_rounding_leaves(missing, calls):
    run, end = run_of([10.0]), 3.0
    h = np.array([end - 1.0 - missing * END_ROUNDING * end])
    x, totals = np.zeros((1, 1)), np.zeros((1, 1))
    ends = []
    run._substep(np.array([0]), 1.0, end, h, x, totals, lambda t, x, totals, u: ends.append(t))
    assert run._maps.calls == calls == len(ends) and ends[-1] == end
    assert x[0, 0] == pytest.approx(2.0)


def test_a_member_without_an_error_is_lost_and_the_others_go_on():
    run = run_of([math.nan, 0.1, math.nan, 0.3], x=[0, 0, 2 * ESCAPING, 0])
    found = crossed(run)
    assert np.isnan(found[[0, 2]]).all() and found[[1, 3]] == pytest.approx([1, 1])
    outcomes = list(run.outcomes)
    assert outcomes == [Outcome.undefined, Outcome.finished, Outcome.escaped, Outcome.finished]
    assert list(run.run_alone) == [True, False, False, False]
    assert np.isnan(run.totals[0, 0]) and run.totals[0, 1] == pytest.approx(1)


def test_a_member_that_needs_too_many_steps_says_so():
    run = run_of([1e-5, 0.3])
    assert MAX_INTERVAL_STEPS < 1e5
    found = crossed(run)
    assert np.isnan(found[0]) and found[1] == pytest.approx(1)
    assert list(run.outcomes) == [Outcome.step_limit, Outcome.finished]
    assert list(run.run_alone) == [True, False]
    assert run._maps.calls == MAX_INTERVAL_STEPS + 1


@pytest.mark.parametrize("u", [2e6, -2e6, math.nan, math.inf])
def test_an_input_beyond_all_states_is_the_controllers(u):
    run = run_of([math.nan], u=[u], max_state=1e6)
    crossed(run)
    assert list(run.outcomes) == [Outcome.controller_diverged]
    run = run_of([math.nan], u=[1e6], max_state=1e6)
    crossed(run)
    assert list(run.outcomes) == [Outcome.undefined]


@pytest.mark.parametrize(("longest", "steps"), [(10.0, (1, 1)), (0.3, (4, 9)), (0.01, (100, 150))])
def test_steps_of_a_lone_member_are_told(longest, steps):
    seen = []
    run = run_of([longest])
    crossed(run, on_step=lambda t, x, totals, u: seen.append((t, x[0, 0], totals[0, 0], u[0])))
    times = np.array([t for t, *_ in seen])
    assert (np.diff(times) > 0).all() and times[-1] == 2.0
    assert steps[0] <= len(times) <= steps[1]
    assert [x for _, x, _, _ in seen] == pytest.approx(list(times - 1))
    assert {u for *_, u in seen} == {1.0}


def test_who_leaves_the_admitted_states_has_escaped():
    run = run_of([1.0] * 4, x=[5, -11, math.nan, 10], max_state=10)
    run.outcomes[2] = Outcome.undefined
    assert run._inside()
    assert list(run.alive) == [True, False, False, True]
    assert list(run.outcomes) == [
        Outcome.finished,
        Outcome.escaped,
        Outcome.undefined,
        Outcome.finished,
    ]
    assert np.isnan(run.x[0, 1]) and run.x[0, 3] == 10
    for state in (11, -11):
        one = run_of([1.0], x=[state], max_state=10)
        assert not one._inside()
    assert run_of([1.0], x=[-10], max_state=10)._inside()


def test_the_next_step_is_within_its_limits():
    error = np.array([0.0, 1e-30, 1.0, 1e30, math.nan, math.inf])
    found = next_factor(error, MAX_FACTOR)
    assert found[[0, 1]] == pytest.approx([MAX_FACTOR] * 2)
    assert 0.5 < found[2] < 1 and found[3:] == pytest.approx([0.1] * 3)
    assert next_factor(np.zeros(1), FIRST_MAX_FACTOR) == [FIRST_MAX_FACTOR]


# the controller's formulas

A, Z, X = symbol("a"), symbol("z"), symbol("x")


def test_what_is_forgotten_are_the_terms_of_gains_and_estimates():
    """Of -a (z - 1) + x z: -a z + a; a term that has every name, and one that has none."""
    rates = [-A * (Z - 1) + X * Z, X, -A * Z, sympy.Integer(3) + X]
    assert forgetting_rates(rates, {A, Z}) == [-A * Z + A, 0, -A * Z, 3]
    assert forgetting_rates([-A * Z], {A}) == [0]


def test_entries_of_the_hold_are_where_estimates_reach_each_other():
    chain = (A, A, sympy.S.Zero, sympy.S.Zero, A, A, sympy.S.Zero, sympy.S.Zero, A)
    upper = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    assert _hold_entries(chain, 3) == upper
    assert _hold_entries((sympy.S.Zero,) * 4, 2) == ()
    ring = (0, 1, 0, 0, 0, 1, 1, 0, 0)
    assert len(_hold_entries(tuple(map(sympy.Integer, ring)), 3)) == 9


def test_weights_of_the_rates():
    assert _weighted([X, Z], ()) == [PERIOD * X, PERIOD * Z]
    w = {at: symbol("ctl_hold_{}_{}".format(*at)) for at in ((0, 0), (0, 1), (1, 1))}
    assert _weighted([X, Z], tuple(w)) == [w[0, 0] * X + w[0, 1] * Z, w[1, 1] * Z]


# the estimates after a period

THETA, BASE, FILTERED = symbol("theta"), symbol("delta"), symbol("filtered")
ESTIMATES, RATES = (BASE, THETA, FILTERED), tuple(map(symbol, ("r0", "r1", "r2")))
FORGOTTEN = (symbol("f0"), RATES[1], sympy.S.Zero)

LIMITS = [{"saturation": (-1, 1)}, {"rate_limit": 3.0}, {"saturation": (-1, 1), "rate_limit": 3.0}]


def after_a_period(filters=(), hold=(), **options):
    implementation = certrack.Implementation(period=0.1, **options)
    return next_estimates(ESTIMATES, RATES, FORGOTTEN, hold, implementation, filters)


def at_limit(formulas, excess):
    """The formulas with the input so far from what the law asks for, and short numbers."""
    numbers = {LAW_INPUT: sympy.Integer(5) + excess, COMMAND: sympy.Integer(5)}
    numbers[PERIOD] = sympy.Rational(1, 10)
    return [sympy.sympify(evaluated(f.xreplace(numbers))) for f in formulas]


def evaluated(formula):
    """A formula whose selections have numbers to compare."""
    if isinstance(formula, Select):
        a, b, first, second = formula.args
        return evaluated(first if evaluated(a) > evaluated(b) else second)
    if formula.args and formula.has(Select):
        return formula.func(*map(evaluated, formula.args))
    return formula


def moved(*rates):
    return [z + rate / 10 for z, rate in zip(ESTIMATES, rates, strict=True)]


@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("excess", [sympy.Rational(1, 100), -1, 0])
def test_estimates_only_forget_while_the_input_is_limited(limits, excess):
    after = at_limit(after_a_period(**limits, anti_windup="leak"), excess)
    assert after == moved(*(FORGOTTEN if excess else RATES))
    after = at_limit(after_a_period(**limits, anti_windup="hold"), excess)
    assert after == moved(*((0, 0, 0) if excess else RATES))
    after = at_limit(after_a_period(**limits, anti_windup="none"), excess)
    assert after == moved(*RATES)
    for windup, others in (("leak", FORGOTTEN[:2]), ("hold", (0, 0))):
        after = at_limit(after_a_period((FILTERED,), **limits, anti_windup=windup), excess)
        assert after == moved(*((*others, RATES[2]) if excess else RATES))


def test_without_limits_nothing_is_compared():
    for windup in ("leak", "hold", "none"):
        after = after_a_period(anti_windup=windup)
        assert after == [z + PERIOD * rate for z, rate in zip(ESTIMATES, RATES, strict=True)]
    limited = after_a_period(saturation=(-1, 1), anti_windup="leak")
    assert [f.has(Select) for f in limited] == [True, False, True]  # theta only forgets


def test_estimates_are_kept_in_their_box():
    box = ((-1, 1), (-2, 2), (-3, 3))
    limits = symbols_of("ctl_box_{}", 6)
    after = after_a_period(projection=box)
    for i, (z, rate) in enumerate(zip(ESTIMATES, RATES, strict=True)):
        assert after[i] == clamp(z + PERIOD * rate, limits[2 * i], limits[2 * i + 1])


def symbols_of(form, count):
    return [symbol(form.format(i)) for i in range(count)]


def test_what_is_held_weighs_what_is_forgotten_too():
    hold = ((0, 0), (0, 1), (1, 1), (2, 2))
    w = {at: symbol("ctl_hold_{}_{}".format(*at)) for at in hold}
    after = at_limit(after_a_period(hold=hold, saturation=(-1, 1), anti_windup="leak"), 1)
    assert after[0] == BASE + w[0, 0] * FORGOTTEN[0] + w[0, 1] * RATES[1]
    assert after[1:] == [THETA + w[1, 1] * RATES[1], FILTERED]


# the whole controller


def made(**options):
    return sampled("example1", **options)


def controller_of(system):
    return sampled_controller(system.plant, system.controller, system.implementation)


def test_the_command_is_limited_in_rate_then_in_size():
    steps = dict(controller_of(made(saturation=(-5, 5), rate_limit=200.0)).steps)
    last, step, low, high = map(symbol, ("ctl_u_last", "ctl_u_step", "ctl_u_low", "ctl_u_high"))
    assert steps[COMMAND] == clamp(clamp(LAW_INPUT, last - step, last + step), low, high)
    assert dict(controller_of(made(saturation=(-5, 5))).steps)[COMMAND] == clamp(
        LAW_INPUT, low, high
    )
    assert dict(controller_of(made()).steps)[COMMAND] == LAW_INPUT


def test_what_a_controller_remembers_and_begins_with():
    system = made(period=0.01, **EVERYTHING | {"offset": 0.003, "initial_input": 0.3})
    controller = controller_of(system)
    names = [s.name for s in controller.states]
    assert names == [
        *("delta_hat", "theta_hat_1"),
        *("ctl_before_x2", "ctl_speed_x2", "ctl_first", "ctl_u_last"),
    ]
    begin = starting_state(controller, (0.7, -0.2), system.implementation)
    assert list(begin) == [0.7, -0.2, 0, 0, 1, 0.3]
    presets = dict(zip(names, controller.presets, strict=True))
    assert presets["ctl_before_x2"] == controller.measured[0] and presets["delta_hat"] == 0
    assert presets["ctl_speed_x2"] == 0 and presets["ctl_u_last"] == INPUT_BEFORE
    after = dict(zip(names, controller.update, strict=True))
    assert after["ctl_first"] == 0 and after["ctl_u_last"] == COMMAND
    assert after["ctl_before_x2"] == controller.measured[0]
    assert after["ctl_speed_x2"] == symbol("ctl_filtered_x2")
    numbers = [name.name for name in controller.numbers]
    assert numbers == [
        *("ctl_period", "ctl_filter", "ctl_u_step", "ctl_u_low", "ctl_u_high"),
        *("ctl_hold_0_0", "ctl_hold_1_1", "ctl_box_0", "ctl_box_1", "ctl_box_2", "ctl_box_3"),
    ]
    assert set(controller.numbers) < set(controller.parameters)
    assert controller.hold == ((0, 0), (1, 1))
    assert controller_of(made()).hold == () and len(controller_of(made()).numbers) == 1


def test_a_law_of_time_begins_with_the_number_of_its_first_sample():
    law = law_of(lambda s: s.t)
    system = law.replace(implementation=certrack.Implementation(period=0.5, offset=0.25))
    controller = controller_of(system)
    assert starting_state(controller, system.estimates, system.implementation)[-1] == 0.5
    names = [s.name for s in controller.states]
    assert names[-1] == "ctl_sample"
    assert controller.update[-1] == controller.states[-1] + 1 and controller.presets[-1] == 0
    assert dict(controller.steps)[symbol("ctl_time")] == PERIOD * symbol("ctl_sample")


def test_a_filtered_difference_stands_for_a_speed():
    system = made(velocity=("x2",), velocity_filter=0.002)
    controller = controller_of(system)
    steps, x1 = dict(controller.steps), controller.measured[0]
    before, speed, pole = map(symbol, ("ctl_before_x2", "ctl_speed_x2", "ctl_filter"))
    filtered = steps[symbol("ctl_filtered_x2")]
    difference = Select(symbol("ctl_first"), 0, 0, (x1 - before) / PERIOD)
    assert sympy.expand(filtered - (speed + pole * (difference - speed))) == 0
    plant = system.plant
    value = steps[differenced("x2")].xreplace({s: plant.constant_values[s.name] for s in ()})
    expected = (symbol("ctl_filtered_x2") - plant.linear[0][0].expr * x1) / plant.chain[0].expr
    assert sympy.expand(value - expected) == 0
    assert [name.name for name, _ in controller.values] == ["x2"]
    command, _ = resolved(controller)
    given = {*controller.states, *controller.measured, *controller.Y, *controller.parameters}
    assert command.free_symbols <= given and controller.measured[1] not in command.free_symbols


# the sampled loop


def test_the_loop_of_a_drive():
    system = made(saturation=(-5, 5))
    loop = sample_loop(system)
    x1, x2 = loop.plant.states
    y, y1 = system.reference.formulas(1)
    assert loop.e_1 == x1 - y
    assert sympy.simplify(loop.slope - (x2 + loop.plant.rates[0] - x2 - y1)) == 0
    assert len(set(loop.parameters)) == len(loop.parameters)
    for names in (loop.plant.parameters, loop.controller.parameters, loop.reference_parameters):
        assert set(names) <= set(loop.parameters)
    free = set().union(*(f.free_symbols for _, f in loop.controller.steps))
    assert not free & {*system.controller.signals.Y} and TIME in free
    values = dict(zip(map(str, loop.parameters), loop_values(loop, system), strict=True))
    assert values["ctl_u_low"] == -5 and values["ctl_u_high"] == 5
    assert values["ctl_period"] == 0.001
    with pytest.raises(certrack.InputError, match="implementation: is missing"):
        sample_loop(certrack.load("example1").replace(implementation=None))


def test_numbers_put_in_for_parameters_are_no_parameters():
    system = made()
    loop = sample_loop(system)
    values = dict(zip(loop.parameters, map(sympy.Float, loop_values(loop, system)), strict=True))
    fixed = loop.with_numbers(values)
    assert fixed.parameters == ()
    formulas = [*fixed.plant.rates, *fixed.plant.outputs, *fixed.controller.update, fixed.slope]
    formulas += [fixed.e_1, *(f for _, f in (*fixed.controller.steps, *fixed.totals))]
    for formula in formulas:
        assert not formula.free_symbols & set(loop.parameters)
    one = loop.parameters[0]
    assert one not in loop.with_numbers({one: values[one]}).parameters
    assert len(loop.with_numbers({one: values[one]}).parameters) == len(loop.parameters) - 1


def test_totals_of_a_run():
    """They rise by h u^2, and by the integrals of e_1^2 and e_1, in units that keep digits."""
    totals = run_totals()
    rises = [sympy.nsimplify((f - name) * INTEGRAL_SCALE) for name, f in totals]
    assert rises == [STEP_LENGTH * INPUT**2, SQUARE, AREA]
    assert [name.name for name, _ in totals] == list(INTEGRALS)
    system = made()
    assert sample_loop(system).totals == totals
    own = ((symbol("time"), symbol("time") + STEP_LENGTH),)
    assert sample_loop(system, own).totals == own


# what happens when


class Told(Maps):
    """Maps whose command is what was measured of the first state, plus 1 a sample."""

    def __init__(self, count):
        super().__init__([10.0] * count)

    def control(self, t, measured, states, parameters):
        self.at.append(t)
        self.seen.append(measured.copy())
        return measured[0] + 100 * (1 + states[0]), states + 1


def whole_run(
    times,
    *,
    samples,
    acts,
    breaks=(),
    marks=(),
    u0=0.25,
    x=(1.0, 2.0),
    clock=None,
    seen=None,
    **drive,
):
    """A run through events at these times, and what it told."""
    count, K = len(x), len(times)

    def where(chosen):
        return np.array([t in chosen for t in times])

    numbers = np.full(K, -1)
    for i, t in enumerate(marks):
        numbers[times.index(t)] = i
    line = EventTimeline(
        times=np.array(times),
        clock=np.array(times if clock is None else clock),
        samples=where(samples),
        acts=where(acts),
        breaks=where(breaks).astype(int),
        marks=numbers,
    )
    problem = SampledProblem(
        x=np.array([x]),
        states=np.zeros((1, count)),
        totals=np.zeros((1, count)),
        parameters=np.full((1, count), 10.0),
        implementation=certrack.Implementation(period=1.0, initial_input=u0, **drive),
        timeline=line,
        outputs=None,
        pieces=lambda t: np.array([1000 + t]),
        keys=np.arange(count, dtype=np.uint64),
        tolerance=1e-6,
        max_state=1e6,
    )
    maps = Told(count)
    maps.at, maps.seen = [], []
    run, told = SampledRun(maps, problem), []
    run.run(
        on_sample=lambda t, states: told.append(("sample", t, states[0, 0], run.x[0, 0])),
        on_step=lambda t, x, totals, u: told.append(("step", t, u[0], run.parameters[1, 0])),
        on_mark=lambda mark: told.append(("mark", mark, run.x[0, 0])),
    )
    if seen is not None:
        seen += maps.seen
    return run, told, maps.at


def test_every_sample_has_its_own_noise_and_sensor_errors():
    """Of sample k = 0, 1, 2 of the run; the errors are formulas of its time."""
    for drive in ({"noise": (0.5,)}, {"sensor_error": ("0.25 + t",)}):
        seen, keys = [], np.arange(2, dtype=np.uint64)
        times = [0.0, 1.0, 2.0, 3.0]
        whole_run(times, samples=times[:3], acts=(), u0=0.0, seen=seen, **drive)
        assert len(seen) == 3
        for k, measured in enumerate(seen):
            error = 0.5 * normal(keys, k, 1)[0] if "noise" in drive else 0.25 + times[k]
            assert measured[0] == pytest.approx(np.array([1.0, 2.0]) + error)


def test_events_happen_in_their_order():
    """Samples at 0 and 1; commands act at 0.5 and 1.5; u(t) is what x says."""
    times = [0.0, 0.5, 1.0, 1.25, 1.5, 2.0]
    run, told, at = whole_run(
        times, samples=(0.0, 1.0), acts=(0.5, 1.5), breaks=(1.25,), marks=(1.0, 2.0)
    )
    first, x_half = 1.0 + 100, 1.0 + 0.5 * 0.25
    x_one = x_half + 0.5 * first
    second = x_one + 200
    assert told == [
        ("sample", 0.0, 0.0, 1.0),
        ("step", 0.5, 0.25, 1000.0),
        ("step", 1.0, first, 1000.0),
        ("sample", 1.0, 1.0, x_one),
        ("mark", 0, x_one),
        ("step", 1.25, first, 1000.0),
        ("step", 1.5, first, 1001.25),
        ("step", 2.0, second, 1001.25),
        ("mark", 1, pytest.approx(x_one + 0.5 * first + 0.5 * second)),
    ]
    assert at == [0.0, 1.0] and run.marks == 2
    assert (run.ends == 2.0).all() and run.alive.all()
    assert run.variation[0] == pytest.approx(first - 0.25 + second - first)
    assert (run.totals == 2.0).all() and (run.outcomes == Outcome.finished).all()


def test_a_command_that_acts_at_the_begin_is_no_change():
    """Without a delay the input before the first sample never acts."""
    run, told, _ = whole_run([0.0, 1.0], samples=(0.0,), acts=(0.0,))
    assert told == [("sample", 0.0, 0.0, 1.0), ("step", 1.0, 101.0, 1000.0)]
    assert (run.variation == 0).all() and list(run.u) == [101.0, 102.0]


def test_the_law_gets_the_time_of_its_own_clock():
    _, told, at = whole_run(
        [0.0, 1.1, 2.0], samples=(0.0, 1.1), acts=(0.0, 1.1), clock=[0.0, 1.0, 2.0]
    )
    assert at == [0.0, 1.0] and told[2][:2] == ("sample", 1.1)


def test_a_run_ends_with_its_last_member():
    run, told, _ = whole_run(
        [0.0, 1.0, 2.0], samples=(0.0,), acts=(0.0,), marks=(2.0,), x=(999_950.0,)
    )
    assert told[-1][0] == "step" and run.marks == 0
    assert not run.alive.any() and list(run.outcomes) == [Outcome.escaped]
    assert list(run.ends) == [0.0]
    run, *_ = whole_run([0.0, 1.0, 2.0], samples=(0.0,), acts=(0.0,), x=(999_950.0, 1.0))
    assert list(run.alive) == [False, True] and list(run.ends) == [0.0, 2.0]


# what the sensors give


def test_sensors_add_noise_clip_it_and_round():
    true, keys = np.array([[0.1, 2.0], [-3.0, 4.0]]), np.array([7, 8], dtype=np.uint64)
    plain = certrack.Implementation(period=1.0)
    assert sensed(true, plain, keys, 3) is true
    noisy = certrack.Implementation(period=1.0, noise=(0.5, 2.0))
    noise = np.array([[0.5], [2.0]]) * normal(keys, 3, 2)
    assert sensed(true, noisy, keys, 3) == pytest.approx(true + noise)
    assert not np.allclose(sensed(true, noisy, keys, 4), true + noise)
    stated = np.array([0.01, -0.02])
    assert sensed(true, plain, keys, 3, stated) == pytest.approx(true + stated[:, None])
    assert sensed(true, noisy, keys, 3, stated) == pytest.approx(true + noise + stated[:, None])
    bounded = certrack.Implementation(period=1.0, noise=(0.5, 2.0), noise_bound=(0.1, 0.3))
    clipped = np.clip(noise + stated[:, None], [[-0.1], [-0.3]], [[0.1], [0.3]])
    assert sensed(true, bounded, keys, 3, stated) == pytest.approx(true + clipped)
    rounded = certrack.Implementation(period=1.0, measurement_quantum=(0.25, 0.0))
    assert sensed(true, rounded, keys, 3) == pytest.approx(np.array([[0.0, 2.0], [-3.0, 4.0]]))
    assert sensed(true, rounded, keys, 3, np.array([0.1, 0.1])) == pytest.approx(
        np.array([[0.25, 2.0], [-2.9, 4.1]])
    )


@pytest.mark.parametrize("kind", ["kalman", "eso", "dob"])
def test_an_observer_is_all_between_measurements_and_law(kind):
    """What it computes, remembers and needs is the controller's, in its order."""
    base = certrack.load("dual-motor-observer")
    law = replace(base.law, observer=Observer(kind=kind, bandwidth=300))
    system = base.replace(law=law)
    plant, implementation = system.plant, system.implementation
    controller = controller_of(system)
    without = controller_of(base.replace(law=replace(base.law, observer=None)))
    x = dict(without.values) if kind == "dob" else {}
    observed = estimation(plant, law, implementation, x, COMMAND, symbol("ctl_first"))
    n = len(controller.estimates)
    names = [name for name, _, _ in observed.memories]
    kept = list(controller.states[n:])
    begin = kept.index(names[0])
    assert kept[begin : begin + len(names)] == names and symbol("ctl_first") in kept
    after = dict(zip(controller.states, controller.update, strict=True))
    presets = dict(zip(controller.states, controller.presets, strict=True))
    for name, value, before in observed.memories:
        assert after[name] == value and presets[name] == before
    steps = list(controller.steps)
    begin = steps.index(observed.steps[0])
    assert steps[begin : begin + len(observed.steps)] == list(observed.steps)
    assert set(observed.numbers) <= set(controller.parameters)
    assert dict(controller.values) == x | observed.values
    assert controller.compensation == observed.compensation
    asked = dict(steps)[LAW_INPUT]
    law_of_estimates = system.controller.equations.u.xreplace(dict(controller.values))
    assert sympy.expand(asked - law_of_estimates - observed.compensation) == 0
    assert (symbol("ctl_before_" + plant.states[-1]) in kept) == (kind == "dob")

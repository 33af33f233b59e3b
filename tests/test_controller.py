"""What a sampled controller remembers from one sample to the next."""

from dataclasses import dataclass

import numpy as np
import pytest
from exported import sampled
from test_extensions import law_of

import certrack
from certrack.export.golden_vectors import reference_answers
from certrack.export.program import controller_program


def test_values_are_found_by_name():
    system = certrack.load("example1")
    controller = system.controller
    names = list(controller.signals.all_parameters)
    assert controller.values_of(names) is controller.values
    by_symbol = dict(zip(controller.symbols, controller.values.tolist(), strict=True))
    groups = controller.signals.all_parameters
    for order in (names[::-1], names[2:5], [names[-1], names[0]]):
        expected = np.array([by_symbol[entry] for name in order for entry in groups[name]])
        assert controller.values_of(order).tolist() == expected.tolist()


@dataclass(frozen=True, kw_only=True)
class _WithMargin(certrack.Robust):
    """Its error system asks for a gain that its equations do not have."""

    kind = "with-margin"

    def error_system(self, s):
        s.parameter("margin")
        return super().error_system(s)

    def parameters(self, plant):
        return {**super().parameters(plant), "margin": 7.0}


def test_gains_that_are_asked_for_later_shift_no_others():
    plain = certrack.load("dual-motor-lean")
    gains = {key: getattr(plain.law, key) for key in ("c", "feedforward")}
    system = plain.replace(law=_WithMargin(**gains))
    expected = certrack.simulate(system.with_settings(duration=2)).metrics
    certrack.design(system)
    later = certrack.Simulator(system).run(system.with_settings(duration=2)).metrics
    assert later == expected
    names = [*system.controller.signals.all_parameters]
    assert "margin" in names and system.controller.values_of(names)[-1] == 7.0


def test_a_drive_begins_without_a_difference():
    """At the first sample there is no position before, so no speed, wherever the axis is."""
    system = sampled("example1", velocity=("x2",), velocity_filter=0.002)
    program = controller_program(system)
    start = np.repeat(np.array(program.start)[:, None], 3, axis=1)
    x = np.array([[-1.0, 0.3, 7.0], [0.0, 0.0, 0.0]])
    after = reference_answers(system, program)(x, np.zeros((len(program.Y), 3)), start)[1:]
    states = dict(zip(map(str, program.states), after, strict=True))
    assert (states["ctl_speed_x2"] == 0).all()
    assert (states["ctl_before_x2"] == x[0]).all()


def test_a_law_that_needs_the_time_counts_its_samples():
    """At sample k the law sees t = k T: u differs from that of another sample by what t adds."""
    system = law_of(lambda s: s.t).replace(implementation=certrack.Implementation(period=0.25))
    program = controller_program(system)
    answers = reference_answers(system, program)
    x, Y = np.array([[0.3], [0.1]]), np.zeros((len(program.Y), 1))
    states = np.array(program.start)[:, None]
    kept = [str(z) for z in program.states]
    commands = []
    for _ in range(4):
        u, *after = answers(x, Y, states)
        commands.append(float(u[0]))
        number = kept.index("ctl_sample")
        states[number] = after[number]
    assert np.diff(commands) == pytest.approx([0.25] * 3)


def test_two_speeds_in_a_row_are_differences_of_measured_and_differenced_positions():
    """x_3 by differences of x_2, which itself is a difference of x_1: a ramp in x_1 gives both."""
    base = certrack.load("dual-motor-lean")
    names = base.plant.states
    drive = certrack.Implementation(period=0.01, velocity=names[1:3], velocity_filter=0.0)
    program = controller_program(base.replace(implementation=drive))
    answers = reference_answers(base.replace(implementation=drive), program)
    states = np.array(program.start, dtype=float)[:, None]
    kept = [str(z) for z in program.states]
    Y = np.zeros((len(program.Y), 1))
    positions = [0.0, 0.03, 0.07, 0.12]
    before = dict.fromkeys(names[:2])
    measured = [str(x) for x in program.measured]
    for x1 in positions:
        x = np.array([[x1 if name == names[0] else 0.0] for name in measured])
        after = answers(x, Y, states)[1:]
        found = dict(zip(kept, after[:, 0], strict=True))
        assert found[f"ctl_before_{names[1]}"] == x1
        speed = 0.0 if before[names[0]] is None else (x1 - before[names[0]]) / 0.01
        assert found[f"ctl_speed_{names[1]}"] == pytest.approx(speed, rel=1e-12)
        row, g = base.plant.b[0], base.plant.g
        x2 = (speed - row[0] * x1) / g[0]
        assert found[f"ctl_before_{names[2]}"] == pytest.approx(x2, rel=1e-12)
        speed = 0.0 if before[names[1]] is None else (x2 - before[names[1]]) / 0.01
        assert found[f"ctl_speed_{names[2]}"] == pytest.approx(speed, rel=1e-12, abs=1e-12)
        before, states = {names[0]: x1, names[1]: x2}, after

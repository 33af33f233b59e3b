"""Soft starts: joined to the state, gone in the long run, and counted from a start."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack.certificates import save_certificate, verify
from certrack.core.errors import InputError
from certrack.laws.plant_coordinates import output_derivatives
from certrack.references import SoftStart, SymbolicReference, jumps, lipschitz_bound
from certrack.studies.ensembles.error_limit import limit_and_starts
from certrack.studies.ensembles.members import Members
from certrack.testing.reference import ReferenceConformance

LEAN = certrack.load("dual-motor-lean")
NUMBERS = st.floats(-3, 3)


def soft(system, transient):
    """The same with a soft start, through its file."""
    text = certrack.to_text(system)
    return certrack.loads(text.replace("[reference]", f"[reference]\ntransient = {transient}"))


SOFT = soft(LEAN, 1.0)


@settings(max_examples=40)
@given(st.lists(NUMBERS, min_size=1, max_size=6), st.floats(0.05, 5))
def test_it_is_joined_at_both_ends_and_bounded(start, transient):
    made = SoftStart(SymbolicReference("0.1*sin(0.75*t) + 0.2"), transient).joined(tuple(start))
    order = len(start)
    assert made.order == order
    t = np.append(np.linspace(0, transient, 2001)[:-1], [transient * (1 - 1e-12), transient])
    values = made.values(t, order)
    np.testing.assert_allclose(values[:-1, 0], start, rtol=1e-9, atol=1e-9)
    target = made.target.values(np.array([transient, 2 * transient]), order)
    size = np.abs(values).max(axis=1)
    np.testing.assert_allclose(values[:-1, -1], target[:-1, 0], atol=1e-9 * size.max() + 1e-9)
    np.testing.assert_array_equal(made.values(np.array([2 * transient]), order)[:, 0], target[:, 1])
    bounds = np.array(made.bounds(order).values)
    assert np.all(size <= bounds * (1 + 1e-12))
    added = bounds - np.array(made.target.bounds(order).values)
    parts = np.abs(values - made.target.values(t, order))[:, :-1].max(axis=1)
    np.testing.assert_allclose(parts, added, rtol=1e-2, atol=1e-9)  # the transient's is exact
    size, spacing = jumps(made, order)
    assert spacing == np.inf
    assert size >= abs(values[-1, -2] - target[-1, 0]) * 0.9


def test_it_has_no_parts_of_one_that_ends_where_its_target_jumps():
    target = certrack.load("point-to-point").reference
    made = SoftStart(target, 0.05).joined((0.002, 0.0, 0.0))
    size, spacing = jumps(made, 3)
    assert size > jumps(target, 3)[0]
    distance = np.abs(np.array(target.knots) - 0.05).min()
    assert spacing <= distance
    steepest = lipschitz_bound(made, 3, between_jumps=True)
    t = np.linspace(1e-6, 0.049, 1001)
    slope = np.abs(np.diff(made.values(t, 3)[3]) / np.diff(t))[:200].max()
    assert slope <= steepest
    assert lipschitz_bound(made, 3) is None


def test_the_rows_give_the_derivatives_of_the_output():
    """y' = g_1 x_2 + b_11 x_1, and so on: along the nominal loop, by the plant's own formulas."""
    plant = LEAN.plant
    rows = output_derivatives(plant)
    np.testing.assert_array_equal(rows[0], [1, 0, 0, 0])
    np.testing.assert_array_equal(
        rows[1], [0, plant.g[0], 0, 0] + rows[0][0] * np.eye(4)[0] * plant.b[0, 0]
    )
    x = np.array(LEAN.settings.x0)
    np.testing.assert_allclose(SOFT.reference.start, rows @ x)


def test_it_saves_peak_and_energy_and_keeps_the_tail():
    plain, joined = certrack.simulate(LEAN).metrics, certrack.simulate(SOFT).metrics
    assert joined.peak_input < 0.45 * plain.peak_input
    assert joined.input_energy < 0.25 * plain.input_energy
    assert joined.tail_error == pytest.approx(plain.tail_error, rel=1e-6)


def test_the_long_run_is_certified_as_without_it_and_the_tube_counts_it(tmp_path):
    plain, joined = certrack.certify(LEAN), certrack.certify(SOFT)
    for kind in ("semidefinite", "peak"):
        assert getattr(joined, kind).bound == getattr(plain, kind).bound
    run = certrack.simulate(SOFT)
    t = np.linspace(0, SOFT.settings.duration, 4001)
    error = np.abs(run.trajectory.interpolate(t)[0] - SOFT.reference.values(t, 0)[0])
    assert joined.tube.verified
    assert np.all(error <= joined.tube(t))
    assert error[200:600].max() > plain.tube(t)[-1]  # the long run's bound is not kept at first
    path = tmp_path / "c.json"
    save_certificate(SOFT, joined.stages, path)
    assert verify(path).verified


def test_the_falsifier_keeps_to_the_long_run():
    found = certrack.falsify(SOFT, budget=60)
    assert found.worst_error <= certrack.certificates.best_sound_bound(LEAN)


def test_each_member_begins_at_its_own_state():
    text = (
        certrack.to_text(SOFT.replace(population=None))
        + "\n[ensemble]\nx0 = [{uniform = [-1, 1]}, 0, 0.5, 0]\n"
    )
    system = certrack.loads(text)
    members = Members(system, 0)
    starts, columns = members.table(0, 5)
    gaps = {str(name): values for name, values in columns.items() if "gap" in str(name)}
    assert len(gaps) == 4
    for i in range(5):
        alone = members.member(i)
        assert alone.reference.start[0] == starts[0, i] == alone.settings.x0[0]
        assert gaps["ref_gap_0"][i] == alone.reference.parameter_values[-4]
    together = certrack.ensemble(system, 3, tolerance=1e-9)
    largest = max(certrack.simulate(members.member(i)).metrics.peak_input for i in range(3))
    found = together.statistics.metrics["peak_input"].summary()["max"]
    assert found == pytest.approx(largest, rel=1e-5)


def test_a_limit_that_is_proven_from_a_start_is_not_taken_for_members():
    drive = certrack.Implementation(period=0.001, saturation=(-500, 500))
    varied = certrack.Population(x0=({"uniform": [-1, 1]}, 0, 0, 0))
    system = SOFT.replace(implementation=drive, population=varied)
    limit, reason, _ = limit_and_starts(system, None)
    assert limit is None
    assert "each member has its own soft start" in reason


def test_the_loop_as_it_runs_counts_it_from_the_start_only():
    drive = certrack.Implementation(period=0.002)
    plain, joined = (
        certrack.certify(system.replace(implementation=drive)).implemented
        for system in (LEAN, SOFT)
    )
    assert joined.verified
    assert joined.bound == plain.bound
    run = certrack.simulate(SOFT.replace(implementation=drive))
    assert run.metrics.peak_input <= joined.peaks.input


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("transient = 1.0", "transient = 0"), "transient: must be at least 1e-06"),
        (("transient = 1.0", "transient = 1e-320"), "transient: must be at least 1e-06"),
        (("transient = 1.0", 'transient = "x"'), "transient"),
    ],
)
def test_what_cannot_be_joined_is_refused(change, message):
    text = certrack.to_text(SOFT)
    assert change[0] in text
    with pytest.raises(InputError, match=message) as caught:
        certrack.loads(text.replace(*change))
    assert "\n" not in str(caught.value)


def test_a_truth_with_states_of_its_own_is_refused():
    system = certrack.load("dual-motor-physical")
    assert system.truth.states
    with pytest.raises(InputError, match=r"transient: needs the state of the design"):
        soft(system, 1.0)


class TestSoftStart(ReferenceConformance):
    duration = 3.0
    reference = SoftStart(certrack.load("point-to-point").reference, 0.3).joined((1.0, 1.0))

    def test_survives_a_system_file(self):
        """Its start is that of the system."""
        system = certrack.load("example1").replace(reference=self.reference)
        assert certrack.loads(certrack.to_text(system)).reference == system.reference
        assert system.reference.start[0] == system.settings.x0[0]

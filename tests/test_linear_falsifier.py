"""The worst case of a linear loop: what kernels and a linear program promise, a run shows."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from depth import depth

import certrack
from certrack.certificates import best_sound_bound
from certrack.certificates.ranges.certify import certify_ranges
from certrack.certificates.worst_profile import WorstProfile, stopping_widths, worst_profile
from certrack.cli import main
from certrack.core.expressions import TIME, parse
from certrack.core.lowering import numpy_callable
from certrack.integrators.many.native import vector_compiler
from certrack.references import profile
from certrack.studies.falsifier.falsify import falsify
from certrack.studies.falsifier.linear.ascent import worst_inputs
from certrack.studies.falsifier.linear.case import admissible_profile
from certrack.studies.falsifier.linear.chain import kernels, run
from certrack.studies.falsifier.linear.continuous import continuous_chain
from certrack.studies.falsifier.linear.corners import worst_corners
from certrack.studies.falsifier.linear.pattern import MAX_CHANGES, sign_formula
from certrack.studies.falsifier.linear.sampled import (
    reference_class,
    sampled_chain,
    with_jumps,
)
from certrack.studies.falsifier.linear.search import (
    NothingTried,
    continuous_case,
    linear_error_loop,
    sampled_case,
)
from certrack.studies.falsifier.outputs import tail_error

LEAN, DRIVE = certrack.load("dual-motor-lean"), certrack.load("dual-motor-drive")


def bounds_of(system):
    return system.reference.bounds(system.controller.coordinates.q + 1).values


@pytest.fixture(scope="module")
def drive():
    """Of a drive without rounding: there the linear loop is the loop."""
    exact = replace(DRIVE.implementation, measurement_quantum=None)
    return sampled_case(DRIVE.replace(implementation=exact), bounds_of(DRIVE))


# the formulas of signs


@pytest.mark.parametrize("count", [1, 5, 200])
def test_a_sign_formula_has_the_signs_of_the_weights(count):
    rng = np.random.default_rng(count)
    weights, edges = rng.normal(size=count), np.arange(count + 1.0)
    text = sign_formula(weights, edges)
    assert text.count("sign") <= MAX_CHANGES
    formula = numpy_callable([TIME], [parse("", text, ["t"]).expr])
    values = np.broadcast_to(formula(edges[:-1] + 0.5)[0], count)
    if count <= MAX_CHANGES:
        assert (values == np.sign(weights)).all()
    else:  # the largest ones count
        assert values @ weights > 0.7 * np.abs(weights).sum()


def test_no_weight_is_no_sign():
    assert sign_formula(np.zeros(3), np.arange(4.0)) == "0"


# the linear program


def test_the_worst_profile_of_one_derivative_is_a_ramp_between_the_bounds():
    """y_d at the end, less y_d at the start: 2 Y_0 where there is time, else Y_1 times the time."""
    for duration, expected in ((10.0, 2.0), (1.0, 0.5)):
        widths = np.full(20, duration / 20)
        found = worst_profile(np.array([0.0, *widths]), [1.0, 0.5], widths)
        assert found.value == pytest.approx(expected, rel=1e-6)


def test_a_worst_profile_keeps_its_bounds_and_comes_to_rest():
    rng = np.random.default_rng(4)
    Y, widths = [1.0, 0.7, 2.0, 30.0], np.full(40, 0.05)
    gains = rng.normal(size=43)
    found = worst_profile(gains, Y, widths, 60)
    assert found.value == pytest.approx(gains @ [*found.start, *found.pieces[:40]])
    assert found.value > 0
    for sense in (1, -1):
        written = admissible_profile(found, tuple(Y), sense)
        reached = np.array(written.bounds(3).values)
        assert (reached <= Y).all()
        assert (reached > 0.99 * np.array(Y))[[0, 3]].all()
        late = written.values(np.array([1e6]), 3)
        assert late[1:].ravel() == pytest.approx([0, 0, 0], abs=1e-12)


def test_between_its_times_a_worst_profile_keeps_its_bounds_too():
    """Of wide pieces, the program sees the ends only: the rest is scaled away."""
    Y, widths = [1.0, 5.0, 5.0], np.full(6, 1.0)
    found = worst_profile(np.array([0.0, 0.0, 1, -1, 1, -1, 1, -1.0]), Y, widths, 60)
    written = admissible_profile(found, tuple(Y), 1)
    assert written.values(np.zeros(1), 2).ravel()[2] == pytest.approx(found.pieces[0], rel=0.02)


# the continuous loop


@pytest.mark.parametrize("name", ["dual-motor-lean", pytest.param("axis", marks=pytest.mark.slow)])
def test_a_run_of_the_case_has_the_error_that_was_promised(name, tmp_path):
    system = certrack.load(name)
    case = continuous_case(system, bounds_of(system))
    assert case.error == pytest.approx(case.estimate, rel=1e-4)
    certrack.save(case.system, tmp_path / "worst.toml")
    replayed = certrack.simulate(certrack.load(tmp_path / "worst.toml"))
    assert tail_error(replayed) == pytest.approx(case.error, rel=1e-6)
    Y = bounds_of(system)
    assert (np.array(case.system.reference.bounds(len(Y) - 1).values) <= np.array(Y)).all()


def test_a_wrong_sign_of_a_kernel_is_a_smaller_error():
    loop = linear_error_loop(LEAN)
    chain = continuous_chain(loop, loop.nominal, bounds_of(LEAN))
    worst = worst_inputs(chain)
    right = run(chain, worst.kernels, worst.reference).error
    assert abs(right) == pytest.approx(worst.error)
    for k in range(len(chain.acting)):
        flipped = worst.kernels.disturbance.copy()
        flipped[:, :, k] *= -1
        wrong = run(chain, worst.kernels._replace(disturbance=flipped), worst.reference).error
        assert abs(wrong) < 0.98 * abs(right)


def triangular():
    """The drive with a reference whose derivative jumps, as its law feeds forward."""
    law, reference = replace(DRIVE.law, feedforward=0), certrack.triangle(0.1, 4.0)
    return DRIVE.replace(law=law, reference=reference)


@pytest.mark.parametrize(
    ("kind", "late"), [("continuous", False), ("sampled", False), ("sampled", True)]
)
def test_kernels_are_the_derivatives_of_the_error(kind, late):
    """Of the reference's pieces and its start, and of the sensors, one by one."""
    if kind == "continuous":
        loop = linear_error_loop(LEAN)
        chain = continuous_chain(loop, loop.nominal, bounds_of(LEAN))
    else:
        system = triangular()
        chain = sampled_chain(system, reference_class(system, bounds_of(system)).bounds)
        chain = replace(chain, pieces=np.full(10, chain.periods // 10), late=late)
    cells = tuple(replace(cell, G=cell.G[:, :0]) for cell in chain.cells)
    chain = replace(chain, acting=(), cells=cells)
    quiet = replace(chain, noise=0 * chain.noise)
    signed, m = kernels(chain), len(chain.bounds) - 1
    pieces = len(chain.pieces)
    still = WorstProfile(0.0, np.zeros(m), np.zeros(pieces), np.ones(pieces))
    for i in range(m):
        moved = replace(still, start=np.eye(m)[i])
        assert run(quiet, signed, moved).error == pytest.approx(signed.reference[i], abs=1e-12)
    for i in (0, pieces // 2, pieces - 2, pieces - 1):
        moved = replace(still, pieces=np.eye(pieces)[i])
        expected = signed.reference[m + i]
        assert run(quiet, signed, moved).error == pytest.approx(expected, rel=1e-9, abs=1e-12)
    noisy = np.abs(signed.noise).sum(axis=0) @ chain.noise
    assert run(chain, signed, still).error == pytest.approx(noisy, rel=1e-9, abs=1e-15)


def test_an_adaptive_loop_has_no_linear_case():
    example = certrack.load("example1")
    with pytest.raises(NothingTried, match="not linear"):
        continuous_case(example, bounds_of(example))


@pytest.mark.slow
def test_what_falsify_says_besides():
    found = falsify(DRIVE, budget=100)
    assert found.origin == "kernels"
    assert found.stopped is None
    assert 0.0013 < found.drive.worst_error < found.drive.estimate
    example = certrack.load("example1")
    found = falsify(example, budget=100)
    assert found.origin == "ascent" and "ascent" not in found.left_out
    assert found.drive is None
    assert found.stopped is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flexible-joint", "axis"])
def test_no_case_of_a_system_with_ranges_is_beyond_its_bounds(name):
    system = certrack.load(name)
    case, proven = continuous_case(system, bounds_of(system)), certify_ranges(system)
    assert 0.9 * proven.attainable <= case.error <= proven.best.bound
    assert case.error == pytest.approx(case.estimate, rel=1e-3)


def test_a_worst_point_inside_of_the_ranges_is_seen():
    """What the law does not cancel, 4 p (1 - p) - 0.36, is largest in the middle."""
    plant = certrack.Plant(
        states=["x"],
        drift="4*p*(1 - p)*x",
        input_gain=1,
        gain_sign=1,
        constants={"p": "1/10"},
        constant_ranges=(("p", "1/10", "9/10"),),
    )
    system = certrack.System(
        plant=plant,
        law=certrack.Robust(c=[4]),
        reference=certrack.SymbolicReference("sin(t)"),
        truth=certrack.Truth(input_gain=1),
        settings=certrack.Settings(x0=[0], duration=1),
    )
    loop = linear_error_loop(system)
    assert worst_corners(loop, bounds_of(system), 1) == [(loop.nominal[0] * 5,)]


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(4, 40)))
def test_no_case_of_a_random_loop_is_beyond_its_bound(seed):
    system = random_loop(seed)
    case, bound = continuous_case(system, bounds_of(system)), best_sound_bound(system)
    assert case.error <= bound
    assert abs(case.run.e[0][-1]) == pytest.approx(case.estimate, rel=1e-2)


@pytest.mark.slow
def test_falsify_writes_the_case_of_a_drive_besides(capfd, tmp_path):
    out = tmp_path / "worst.toml"
    command = ["falsify", "dual-motor-drive", "--budget", "100", "--out", str(out), "--json"]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert not ended.value.code
    found = json.loads(capfd.readouterr().out)
    assert found["origin"] == "kernels"
    assert found["stopped"] is None
    assert 0.0013 < found["drive"]["worst_error"] < found["drive"]["estimate"]
    assert found["drive"]["estimate"] < found["drive"]["certified"] <= 0.00165
    assert found["drive"]["certified"] < found["drive"]["estimate"] / 0.9
    for path, error in ((out, found), (tmp_path / "worst-drive.toml", found["drive"])):
        run = certrack.simulate(certrack.load(path))
        assert tail_error(run) == pytest.approx(error["worst_error"], rel=1e-6)


@pytest.mark.slow
def test_friction_that_the_law_cancels_is_attacked_by_kernels():
    plant = replace(LEAN.plant, drift="K_L/J_M*(x1 - x3) - 0.3*sign(x4)")
    found = falsify(LEAN.replace(plant=plant), budget=100)
    assert found.origin == "kernels"
    assert found.worst_error == pytest.approx(0.0012184, rel=1e-3)
    assert found.alarm is None


def random_loop(seed):
    """A chain of integrators under the robust law, with disturbances, at times with ranges."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    q = int(rng.integers(0, n))
    a, c = rng.uniform(-1, 1, n).round(3).tolist(), rng.uniform(2, 6, n).round(3).tolist()
    states = [f"x{i + 1}" for i in range(n)]
    terms = [f"({v!r})*{x}" for v, x in zip(a, states, strict=True)]
    drift = " + ".join([f"p*{terms[0]}", *terms[1:]])
    ranges = {"constant_ranges": (("p", "9/10", "11/10"),)} if seed % 2 else {}
    plant = certrack.Plant(
        states=states,
        chain=[1] * (n - 1),
        drift=drift,
        input_gain=1,
        gain_sign=1,
        uncertainty={
            "tau": [1] * n,
            "gamma": rng.uniform(0, 0.02, n).round(4).tolist(),
            "beta": rng.uniform(0, 0.2, n).round(4).tolist(),
        },
        constants={"p": 1},
        **ranges,
    )
    return certrack.System(
        plant=plant,
        law=certrack.Robust(c=c, feedforward=q),
        reference=certrack.SymbolicReference(f"0.3*sin({rng.uniform(0.5, 3):.3f}*t)"),
        truth=certrack.Truth(input_gain=1),
        settings=certrack.Settings(x0=[0.0] * n, duration=10),
    )


# the loop as a drive carries it out


def test_a_run_of_the_drive_has_the_error_that_was_promised(drive, tmp_path):
    assert drive.error == pytest.approx(drive.estimate, rel=1e-4)
    certrack.save(drive.system, tmp_path / "worst.toml")
    replayed = certrack.simulate(certrack.load(tmp_path / "worst.toml"))
    assert tail_error(replayed) == pytest.approx(drive.error, rel=1e-6)


def test_a_wrong_sign_of_the_noise_is_a_smaller_error(drive):
    flipped = [f"-({error.text})" for error in drive.system.implementation.sensor_error]
    wrong = replace(drive.system.implementation, sensor_error=tuple(flipped))
    error = tail_error(certrack.simulate(drive.system.replace(implementation=wrong)))
    assert error < 0.85 * drive.error


@pytest.mark.slow
def test_rounding_at_its_worst_is_as_large_as_promised():
    """Without the encoders, but with half a step of them in the sensors' errors."""
    chain = sampled_chain(DRIVE, reference_class(DRIVE, bounds_of(DRIVE)).bounds)
    worst = worst_inputs(chain)
    assert worst.error > 0.9 * 0.00165
    size = float(chain.noise[0])
    noisy = replace(DRIVE.implementation, measurement_quantum=None, noise_bound=(size, 0, size, 0))
    case = sampled_case(DRIVE.replace(implementation=noisy), bounds_of(DRIVE))
    assert case.error == pytest.approx(worst.error, rel=1e-4)
    rounded = sampled_case(DRIVE, bounds_of(DRIVE))
    assert 0.8 * worst.error < rounded.error < worst.error


@pytest.mark.slow
def test_a_delay_of_several_periods_is_in_the_chain():
    late = replace(DRIVE.implementation, period=0.003, delay=2.3, measurement_quantum=None)
    case = sampled_case(DRIVE.replace(implementation=late), bounds_of(DRIVE))
    assert case.error == pytest.approx(case.estimate, rel=1e-4)


def test_bounds_and_their_slopes_are_those_of_the_uncertainty():
    rng = np.random.default_rng(2)
    Delta = rng.uniform(0, 1, (4, 4)).tolist()
    u = replace(LEAN.plant.uncertainty, beta=(0.1, 0, 0, 0.2), Delta=Delta, S=(1, 2, 0, 3))
    loop = linear_error_loop(LEAN)
    chain = replace(continuous_chain(loop, loop.nominal, bounds_of(LEAN)), uncertainty=u)
    x, step = rng.normal(size=4), 1e-6
    assert chain.bound(x) == pytest.approx([u.largest(k, x) for k in chain.acting])
    moved = [(chain.bound(x + step * e) - chain.bound(x - step * e)) / 2 / step for e in np.eye(4)]
    assert chain.slopes(x) == pytest.approx(np.array(moved).T, rel=1e-6)
    assert chain.slopes(np.zeros(4)) == pytest.approx(np.zeros((2, 4)))


@pytest.mark.slow
def test_a_reference_that_may_jump_seldom_does_so_seldom():
    """Of a triangle, y_d' has a largest jump and a least time between two."""
    system = triangular()
    references = reference_class(system, bounds_of(system))
    assert references.jump == pytest.approx(0.2)
    assert references.spacing == pytest.approx(2.0)
    ideal = replace(DRIVE.implementation, measurement_quantum=None)
    case = sampled_case(system.replace(implementation=ideal), bounds_of(system))
    assert case.error == pytest.approx(case.estimate, rel=1e-4)
    chain = sampled_chain(system, references.bounds)
    for jump in (0.05, 0.2):
        for entry in with_jumps(chain, replace(references, jump=jump)):
            worst = worst_inputs(entry, turns=1)
            assert (worst.reference.widths[:-61] > 1.999).all()
            assert np.abs(np.diff(worst.reference.pieces)).max() <= jump * (1 + 1e-12)


def test_an_unstable_drive_has_no_case():
    slow = replace(DRIVE.implementation, period=0.2)
    with pytest.raises(NothingTried, match="not stable"):
        sampled_case(DRIVE.replace(implementation=slow), bounds_of(DRIVE))


def test_what_was_not_tried_is_said(monkeypatch):
    """A case that cannot be written as a system is no reason to say nothing."""

    def refuse(*_):
        raise certrack.InputError("reference", "must not jump")

    monkeypatch.setattr("certrack.studies.falsifier.linear.search.written_case", refuse)
    found = falsify(DRIVE, budget=20)
    assert found.drive is None and set(found.left_out) == {"drive", "kernels"}
    assert "must not jump" in found.left_out["drive"]


def test_stopping_does_not_wait_for_what_no_reference_reaches():
    """Y_4 of the file is 6600, but |y^(4)| with |y^(5)| <= 25 stays far below it."""
    widths = stopping_widths(np.array([0.7855, 3.15, 19.4, 403.0, 6600.0, 25.2]), 60)
    assert 0.5 < widths.sum() < 10


@pytest.mark.slow
def test_the_flexible_joint_on_a_drive_is_attacked():
    system = certrack.load("flexible-joint")
    system = system.replace(implementation=certrack.Implementation(period=0.004, delay=0.5))
    case = sampled_case(system, bounds_of(system))
    assert case.error == pytest.approx(case.estimate, rel=0.05) and case.error > 0.009


# errors of sensors


def with_errors(*errors, **settings):
    exact = replace(
        DRIVE.implementation, noise=None, noise_bound=(0.0008, 0, 0.0008, 0), sensor_error=errors
    )
    return DRIVE.replace(implementation=exact).with_settings(**settings)


@pytest.mark.slow
def test_an_offset_of_a_sensor_is_an_error_of_the_axis():
    """Both sensors show 0.0005 too much: the axis rests 0.0005 short; 0.002 is clipped."""
    for error, expected in ((0.0005, 0.0005), (0.002, 0.0008)):
        off = with_errors(error, 0, error, 0)
        off = off.replace(
            reference=certrack.SymbolicReference("0.1"),
            truth=replace(DRIVE.truth, omega=("0",) * 4),
            implementation=replace(off.implementation, measurement_quantum=None),
        ).with_settings(duration=8)
        assert certrack.simulate(off).e[0][-1] == pytest.approx(-expected, rel=1e-3)


@pytest.mark.parametrize(
    "method",
    [
        pytest.param("lockstep", marks=pytest.mark.slow),
        pytest.param("native", marks=pytest.mark.skipif(not vector_compiler(), reason="no C")),
    ],
)
def test_members_of_an_ensemble_have_the_errors_of_a_single_run(method):
    system = with_errors("0.001*sign(t - 1)", 0, "0.0003*t", 0, duration=1.5)
    found = certrack.ensemble(system, 3, method=method)
    lone = max(found.run(i).metrics.tail_error for i in range(3))
    assert found.statistics.metrics["tail_error"].most == pytest.approx(lone, rel=1e-6)
    without = certrack.ensemble(with_errors(0, 0, 0, 0, duration=1.5), 3, method=method)
    assert abs(lone - without.statistics.metrics["tail_error"].most) > 1e-4 * lone


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        (["0"], "implementation.sensor_error: must be a list of 4: one per state"),
        (["x1", "0", "0", "0"], r"implementation.sensor_error\[0\]: unknown name 'x1'"),
        ("sin(t)", "implementation.sensor_error"),
    ],
)
def test_errors_of_sensors_that_do_not_fit(errors, message):
    with pytest.raises(certrack.InputError, match=message):
        with_errors(*errors) if isinstance(errors, list) else with_errors(errors)


# motion profiles


def test_a_profile_of_constant_jerk():
    """A rise of 1: jerk 32 for a quarter of a second, then the reverse, and so on."""
    move = profile((0, 0.25, 0.75, 1), (0, 0, 0), (64, -64, 64))
    t = np.linspace(0, 1.5, 301)
    y = move.values(t, 3)
    assert y[0, -1] == pytest.approx(2.0)
    assert move.order == 3
    assert move.bounds(3).values == pytest.approx((2.0, 4.0, 16.0, 64.0))
    assert (np.abs(y).max(axis=1) <= move.bounds(3).values).all()


@pytest.mark.parametrize("degree", [4, 6])
def test_bounds_of_profiles_of_high_degree_hold(degree):
    ends_at_rest = [(-1) ** k * math.comb(degree, k) for k in range(degree + 1)]
    tops = np.convolve(ends_at_rest, np.random.default_rng(degree).integers(-5, 6, 2 * degree))
    move = profile(tuple(range(3 * degree + 1)), (0.0,) * degree, tuple(tops.tolist()))
    y = np.abs(move.values(np.linspace(0, 3 * degree, 40_001), degree)).max(axis=1)
    stated = np.array(move.bounds(degree).values)
    assert (y <= stated).all()
    assert stated == pytest.approx(y, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0, 1), (0, 0), (1,)), "must not jump: the derivative of order 1 does at t = 1 s"),
        (((1, 2, 3), (0, 1), (0, -1)), "must not jump: the derivative of order 1 does at t = 1 s"),
        (((0, 1, 1), (0, 0), (1, -1)), r"reference.times\[2\]: times must increase"),
        (((0, 1), (0, 0), (1, 2)), "reference.highest"),
        (((0, 1), (), (1,)), "reference.start"),
    ],
)
def test_profiles_that_are_none(arguments, message):
    with pytest.raises(certrack.InputError, match=message):
        profile(*arguments)


def test_a_profile_survives_its_file():
    move = profile((0, 0.25, 0.75, 1), (0.5, 0, 0), (64, -64, 64))
    system = LEAN.replace(reference=move)
    assert certrack.loads(certrack.to_text(system)) == system

"""Observers, integral action and sampled feed-forward: simulated, certified, exported."""

import ctypes
from dataclasses import replace

import flint
import independent_checker
import numpy as np
import pytest
from depth import depth
from exported import PythonController, along_a_run
from friction_axis import adaptive, pid_tail
from observer_loops import with_estimates
from sampled_attack import worst_error
from scipy.linalg import expm, solve_discrete_are
from test_export_c import CPPCHECK, STRICT, needs, run, write
from test_export_fmu import VERSIONS, Imported, inputs, written
from test_export_st import compare
from test_implemented import random_drive

import certrack
from certrack import InputError
from certrack.certificates import to_document, verify
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.estimate import estimate_implemented
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.proof import delays, failed_implemented
from certrack.core.errors import DesignError
from certrack.export.c.source import c_code
from certrack.laws.observer import Observer
from certrack.laws.observer_model import observer_model
from certrack.loops.stability import linear_loop

ESO = certrack.load("dual-motor-observer")
LAW, DRIVE = replace(ESO.law, observer=None), ESO.implementation
FILTERED = replace(DRIVE, velocity_filter=0.002)


def with_observer(observer, drive=None, noise=0.0, **law):
    """The drive of the catalogue with another observer, or none."""
    plain = observer is None or observer.kind == "dob"
    drive = drive or (FILTERED if plain else DRIVE)
    if noise:
        drive = replace(drive, noise_bound=(noise, 0, noise, 0))
    return ESO.replace(law=replace(LAW, observer=observer, **law), implementation=drive)


DOB = Observer(kind="dob", bandwidth=40.0)
BOTH = Observer(kind="dob", bandwidth=40.0, rows=("x2", "x4"))
KALMAN = Observer(kind="kalman", bandwidth=200.0)
KINDS = {
    "none": with_observer(None),
    "dob": with_observer(DOB),
    "dob of two rows": with_observer(BOTH),
    "eso": ESO,
    "eso, late": with_observer(ESO.law.observer, replace(DRIVE, delay=1.5)),
    "kalman": with_observer(KALMAN),
    "integral": with_observer(None, integral=6.0),
    "integral, dob": with_observer(DOB, integral=3.0),
}


def later(names, soon):
    """Parameters of which all but some are slow."""
    return [pytest.param(v, marks=() if v in soon else pytest.mark.slow) for v in names]


# Files ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", KINDS)
def test_files(name):
    assert certrack.loads(certrack.to_text(KINDS[name])) == KINDS[name]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "dob"}, "law.observer.bandwidth: is missing"),
        ({"kind": "dob", "bandwidth": 3, "weights": [1]}, "law.observer.weights: belongs to"),
        ({"kind": "eso", "bandwidth": 3, "weights": [1]}, "must be left out beside weights"),
        ({"kind": "kalman", "bandwidth": 3, "rows": ["x4"]}, "law.observer.rows: must be left out"),
        ({"kind": "eso", "bandwidth": [3, 4]}, "law.observer.bandwidth: of eso must be one number"),
        ({"kind": "eso", "bandwidth": -1}, "law.observer.bandwidth: must be positive"),
        ({"kind": "luenberger", "bandwidth": 1}, "law.observer.kind: must be one of"),
    ],
)
def test_what_does_not_fit_a_kind(values, message):
    with pytest.raises(InputError, match=message):
        Observer(**values)


@pytest.mark.parametrize(
    ("observer", "message"),
    [
        ('kind = "eso"\nweights = [1, 2]', "law.observer.weights: must be a list of 3"),
        ('kind = "eso"\nbandwidth = 9\nrows = ["x9"]', r"law.observer.rows\[0\]: must be one of"),
        ('kind = "dob"\nbandwidth = [1, 2]', "law.observer.bandwidth: must be a list of 1"),
        ('kind = "eso"\nbandwidth = 9\nrows = ["x3", "x4"]', "cannot share x3, x4"),
        ('kind = "eso"\nbandwidth = 9\nspeed = 3', "law.observer.speed: unknown key"),
    ],
)
def test_what_does_not_fit_a_system(observer, message):
    text = certrack.to_text(KINDS["kalman"])
    begin, end = text.index("[law.observer]"), text.index("[simulation]")
    with pytest.raises(InputError, match=message):
        certrack.loads(f"{text[:begin]}[law.observer]\n{observer}\n\n{text[end:]}")


def test_an_observer_needs_samples():
    text = certrack.to_text(ESO)
    with pytest.raises(InputError, match="law.observer: needs"):
        certrack.loads(text[: text.index("[implementation]")])


def test_what_cannot_be_told_apart_is_refused():
    observer = Observer(kind="eso", bandwidth=9.0, rows=("x1", "x4"))
    only_motor = replace(DRIVE, velocity=("x2", "x3", "x4"))
    with pytest.raises((InputError, DesignError)):
        with_observer(observer, only_motor)


@pytest.mark.parametrize("weights", [(1e200, 1, 1e-200), (1e-320, 1, 1), (1, 1, 1e-250)])
def test_weights_beyond_the_precision_are_refused_or_have_gains(weights):
    try:
        system = with_observer(Observer(kind="eso", weights=weights))
        found = observer_model(system.plant, system.law, system.implementation)
    except DesignError as refusal:
        assert refusal.key == "law.observer"
        assert "weights that differ less" in str(refusal)
    else:
        assert np.isfinite(found.correction).all()


@pytest.mark.parametrize(
    "numbers",
    [{"kind": "eso", "weights": (30, 16, 500, 2000)}, {"kind": "dob", "bandwidth": (20, 50)}],
)
def test_numbers_of_rows_go_with_their_rows(numbers):
    """Rows may be named in any order; their weights and bandwidths are in the same order."""
    several = next(name for name in numbers if name != "kind")
    turned = {**numbers, several: (*numbers[several][:-2], *numbers[several][:-3:-1])}
    first, second, wrong = (
        with_observer(Observer(rows=rows, **values))
        for rows, values in (
            (("x2", "x4"), numbers),
            (("x4", "x2"), turned),
            (("x4", "x2"), numbers),
        )
    )
    models = [observer_model(s.plant, s.law, s.implementation) for s in (first, second, wrong)]
    np.testing.assert_array_equal(models[0].correction, models[1].correction)
    assert np.abs(models[0].correction - models[2].correction).max() > 1e-3


# The observer by hand ---------------------------------------------------------------------------


def test_extended_state_observer_is_that_of_the_textbook():
    """The stationary gain by SciPy, the period by its matrix exponential."""
    A = np.array([[0, 1, 0, 0], [-12, 0, 12, 0], [0, 0, 0, 1], [30, 0, -30, 0]], float)
    block = np.zeros((6, 6))
    block[:4, :4], block[3, 4], block[3, 5] = A, 1, 20
    T, C = 1e-3, np.eye(2, 5)
    C[1] = np.eye(5)[2]
    over = expm(block * T)
    F = over[:5, :5]
    Q = np.diag([1e-3, 30, 1e-3, 16, 3925.0]) ** 2
    S = solve_discrete_are(F.T, C.T, Q, np.eye(2))
    gain = S @ C.T @ np.linalg.inv(C @ S @ C.T + np.eye(2))
    model = observer_model(ESO.plant, ESO.law, DRIVE)
    np.testing.assert_allclose(model.correction, gain, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(np.hstack([model.F, model.G]), F[:4], rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(model.new + model.old, over[:4, 5], rtol=1e-12, atol=1e-18)
    half = expm(block * T / 2)
    np.testing.assert_allclose(model.new, half[:4, 5], rtol=1e-12, atol=1e-18)
    assert pytest.approx([-1 / 20]) == model.U and not model.P.any()


@pytest.mark.parametrize(
    "name",
    later(["dob", "dob of two rows", "eso", "eso, late", "integral"], ["dob of two rows", "eso"]),
)
def test_a_constant_disturbance_leaves_no_error(name):
    """Of the rows that are estimated; a constant reference; d^ is what acts."""
    system = KINDS[name]
    on_x2 = 0.05 if name == "dob of two rows" else 0
    truth = replace(ESO.truth, omega=(0, on_x2, 0, 0.1))
    drive = replace(system.implementation, measurement_quantum=None)
    reference = certrack.SymbolicReference("0.1")
    still = system.replace(truth=truth, implementation=drive, reference=reference)
    still = still.with_settings(x0=(0, 0, 0, 0), duration=6.0, tail=5.5)
    ran = certrack.simulate(still)
    assert ran.metrics.tail_error < 1e-8
    assert (
        certrack.simulate(
            still.replace(
                law=replace(system.law, observer=None, integral=None),
                implementation=replace(drive, velocity_filter=0.0),
            )
        ).metrics.tail_error
        > 1e-5
    )


def test_bandwidth_places_the_poles_of_the_estimates():
    """Three poles of Butterworth's filter at 100 /s, of the position, the speed and d."""
    observer = Observer(kind="eso", bandwidth=100.0)
    model = observer_model(ESO.plant, replace(LAW, observer=observer), replace(DRIVE, period=1e-4))
    F = np.block([[model.F, model.G], [np.zeros((1, 4)), np.ones((1, 1))]])
    seen = F[[0, 2]]
    poles = np.log(np.linalg.eigvals(F - model.correction @ seen)) / 1e-4
    fast = sorted(poles[np.abs(poles) > 50], key=lambda p: p.imag)
    at_100 = [p for p in fast if abs(abs(p) - 100) < 3]
    assert len(at_100) >= 3


def test_limits_do_not_wind_the_estimate_up():
    """The observer is given the input within its limits, and takes them for no disturbance."""
    tight = replace(DRIVE, saturation=(-2, 2), measurement_quantum=None)
    system = ESO.replace(implementation=tight).with_settings(x0=(-0.2, 0, 0, 0), duration=4.0)
    controller = PythonController(system)
    x, Y = along_a_run(system)
    d = [name.name for name in _states(system)].index("ctl_d_x4")
    largest, limited = 0.0, 0
    for measured, reference in zip(x, Y, strict=True):
        u = controller.step(measured, reference)
        largest, limited = max(largest, abs(controller.state[d])), limited + (abs(u) == 2)
    assert limited > 10 and largest < 1.0


def _states(system):
    from certrack.loops.controller import sampled_controller

    return sampled_controller(system.plant, system.controller, system.implementation).states


# Sampled feed-forward ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", later(KINDS, ["dob of two rows", "eso, late", "integral, dob"]))
def test_no_error_of_polynomials(name):
    """The first row of the loop's own motion is y_d, to the order that is fed forward."""
    system = KINDS[name]
    with flint.ctx.workprec(DRIVE_BITS):
        Pi = Enclosed.of(one_period(drive_of(system), (1, 1)).Pi[-1]).value
    np.testing.assert_allclose(Pi[0], [1, 0, 0, 0], atol=1e-12)
    plain = system.replace(law=replace(system.law, sampled_feedforward=False))
    with flint.ctx.workprec(DRIVE_BITS):
        Pi = Enclosed.of(one_period(drive_of(plain), (1, 1)).Pi[-1]).value
    assert np.abs(Pi[0] - [1, 0, 0, 0]).max() > 1e-6 or name in ("eso", "eso, late", "kalman")


def test_feedforward_beyond_the_chain():
    """Orders above n - 1 have a use in a sampled loop only."""
    with pytest.raises(InputError, match=r"law\.feedforward"):
        ESO.replace(law=replace(LAW, sampled_feedforward=False, feedforward=4))
    errors = []
    for q in (3, 4):
        reference = certrack.SymbolicReference("0.1*sin(2*t)")
        system = with_observer(None, feedforward=q).replace(reference=reference)
        drive = replace(FILTERED, measurement_quantum=None)
        quiet = system.replace(implementation=drive, truth=replace(ESO.truth, omega=None))
        short = quiet.with_settings(duration=6.0, tail=5.0)
        errors.append(certrack.simulate(short).metrics.tail_error)
    assert errors[1] < errors[0] / 5


def test_feedforward_of_a_nonlinear_loop_is_refused():
    base = certrack.load("example1")
    law = replace(base.law, sampled_feedforward=True)
    with pytest.raises(DesignError, match="sampled_feedforward"):
        certrack.simulate(base.replace(law=law, implementation=certrack.Implementation(0.001)))


# Certificates -----------------------------------------------------------------------------------

#: Observer, noise, and what the bound must not exceed and the worst that was simulated.
BOUNDS = [
    ("none", 0.0, 0.000418, 0.000368),
    ("dob", 0.0, 0.000254, 0.000209),
    ("eso", 0.0, 0.000253, 0.000206),
    ("none", 1e-4, 0.00068, 0.000596),
    ("dob", 1e-4, 0.00053, 0.000444),
    ("eso", 1e-4, 0.00053, 0.000446),
    ("integral", 0.0, 0.000365, 0.000319),
]


@pytest.mark.parametrize("case", later(BOUNDS, BOUNDS[1:3]))
def test_bounds_of_the_motors(case):
    name, noise, most, simulated = case
    system = KINDS[name]
    if noise:
        drive = replace(system.implementation, noise_bound=(noise, 0, noise, 0))
        system = system.replace(implementation=drive)
    assert simulated < estimate_implemented(system).bound <= most


def test_a_proof_and_its_mutants():
    found, (proof,) = certify_implemented(ESO)
    assert found.verified and found.bound <= 0.000253
    (delay,) = delays(ESO)
    assert failed_implemented(ESO, proof, delay) == ""
    smaller = replace(proof, bound="0.00024")
    assert "smaller" in failed_implemented(ESO, smaller, delay)
    weaker = replace(ESO.law, observer=Observer(kind="eso", weights=(30, 16, 3000)))
    assert failed_implemented(ESO.replace(law=weaker), proof, delay)
    late = ESO.replace(implementation=replace(DRIVE, counted_delay=0.0))
    assert failed_implemented(late, proof, delay)


@pytest.mark.slow
def test_another_reader_of_the_page_agrees():
    """With the files of a certificate; and not with an observer that is another."""
    _, proofs = certify_implemented(ESO)
    document = to_document(ESO, *proofs)
    assert verify(document).verified
    assert float(independent_checker.check(document)) == pytest.approx(0.0002447, rel=1e-3)
    text = document["system"]
    assert "[30.0, 16.0, 3925.0]" in text
    document["system"] = text.replace("[30.0, 16.0, 3925.0]", "[30.0, 16.0, 3000.0]")
    assert not verify(document).verified
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(document)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["none", "dob", "dob of two rows", "eso, late", "kalman"])
def test_another_reader_of_the_page_agrees_on_every_kind(name):
    limits = {"saturation": (-70, 70), "initial_input": 0.5}
    drive = replace(KINDS[name].implementation, **limits)
    system = KINDS[name].replace(implementation=drive)
    found, proofs = certify_implemented(system)
    assert found.verified
    checked = float(independent_checker.check(to_document(system, *proofs)))
    assert checked == pytest.approx(found.bound, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_every_kind_is_proven(name):
    system = KINDS[name]
    found, (proof,) = certify_implemented(system)
    (delay,) = delays(system)
    assert found.verified and failed_implemented(system, proof, delay) == ""
    assert found.bound == pytest.approx(estimate_implemented(system).bound, rel=1e-3)
    tighter = replace(proof, bound=f"{0.999 * float(proof.bound):.9g}")
    assert failed_implemented(system, tighter, delay)


def attacked(seed, count):
    """Bound over attack of random loops with estimates."""
    rng, ratios = np.random.default_rng(seed), []
    while len(ratios) < count:
        system, amplitude, frequency = random_drive(rng)
        system = with_estimates(system, rng)
        if system is None:
            continue
        found, _ = certify_implemented(system)
        drive = system.implementation
        radius = linear_loop(system).radius(drive.period, drive.delay)
        if not found.exists:
            assert ("unstable" in found.reason) == (radius >= 1), found.reason
            continue
        ratios.append(found.bound / worst_error(system, amplitude, frequency))
        assert ratios[-1] >= 1, (seed, system.law, drive)
    return ratios


def test_no_attack_beats_the_bound_of_random_loops():
    assert np.median(attacked(1, 1)) <= 1.25


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(2, 12)))
def test_no_attack_beats_the_bound_of_many_random_loops(seed):
    assert np.median(attacked(100 + seed, 12)) <= 1.25


def test_mismatch_is_what_the_estimate_of_two_rows_is_for():
    """A load that is 30 % heavier than the controller knows."""
    bounds = {name: mismatched(KINDS[name]) for name in ("none", "dob of two rows")}
    assert bounds["dob of two rows"] <= 0.00082 < 0.0017 < bounds["none"] <= 0.00187


def mismatched(system):
    """The estimate with J_L 30 % larger in the plant, but not in the controller."""
    from certrack.certificates.implemented import estimate as estimate_room
    from certrack.certificates.implemented.fixed_point import OutputBounds
    from certrack.certificates.implemented.outputs import output_rows
    from certrack.certificates.implemented.proof import cells_of, periods_needed

    noisy = replace(system.implementation, noise_bound=(1e-4, 0, 1e-4, 0))
    system = system.replace(implementation=noisy)
    constants = dict(system.plant.constants) | {"J_L": 0.65}
    other = replace(system.plant, constants=constants)
    drive = drive_of(system)
    true = drive_of(system.replace(plant=other))
    drive = replace(drive, A=true.A, b=true.b, W=true.W)
    with flint.ctx.workprec(100):
        period = one_period(drive, cells_of(drive))
        rows, doublings = output_rows(period), periods_needed(period, 1e-5)
        gains = estimate_room._estimated_gains(period, rows, doublings)
        bounds = OutputBounds.of(period, rows, gains)
        return float(bounds.image(*bounds.search())[0])


def test_no_certificate_in_continuous_time_with_an_integral():
    found = certrack.certify(with_observer(None, integral=6.0).replace(implementation=None))
    assert not found.best.exists and "integral action" in found.semidefinite.reason


# Code -------------------------------------------------------------------------------------------


#: Kinds whose code is compiled in every run of the tests.
SOON = ["dob of two rows", "eso, late", "integral, dob"]


@pytest.fixture(params=later(KINDS, SOON))
def compiled(request, tmp_path):
    """A controller of some kind, its code, and the library it was compiled to."""
    system = KINDS[request.param].with_settings(duration=0.3, tail=0.1)
    write(tmp_path, c_code(system, "drive", real="double"))
    flags = [*STRICT, "-ffp-contract=off", "-shared", "-fPIC"]
    run("gcc", *flags, "drive.c", "-o", "drive.so", cwd=tmp_path)
    return system, tmp_path, ctypes.CDLL(str(tmp_path / "drive.so"))


@needs("gcc")
@needs("cppcheck")
def test_code(compiled):
    """It agrees with the simulation step by step, passes its acceptance test, and is clean."""
    system, folder, library = compiled
    library.drive_step.restype = ctypes.c_double
    library.drive_step.argtypes = [ctypes.c_void_p] * 3
    controller = PythonController(system)
    memory = np.zeros(len(controller.state) + 1)
    library.drive_init(ctypes.c_void_p(memory.ctypes.data))
    rows = [np.ascontiguousarray(part) for part in along_a_run(system)]
    for x, Y in zip(*rows, strict=True):
        u = library.drive_step(memory.ctypes.data, x.ctypes.data, Y.ctypes.data)
        wanted = controller.step(x, Y)
        assert abs(u - wanted) <= 1e-12 * max(1, abs(wanted))
    run("gcc", *STRICT, "drive.c", "drive_test.c", "-lm", cwd=folder)
    assert "passed" in run("./a.out", cwd=folder)
    run("cppcheck", *CPPCHECK, "drive.c", cwd=folder)


@pytest.mark.parametrize("name", later(KINDS, ["dob of two rows", "eso, late", "integral, dob"]))
def test_structured_text(name):
    """Its commands agree with the simulation step by step; a gain of 4000 rounds an estimate."""
    system = KINDS[name].with_settings(duration=0.3, tail=0.1)
    worst, _ = compare(system, "drive", within=1e-10)
    assert worst <= 1e-12


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", later(KINDS, ["eso"]))
def test_fmu(name, version, tmp_path):
    """It agrees with the simulation step by step."""
    system = KINDS[name].with_settings(duration=0.3, tail=0.1)
    imported = Imported(written(system, version, tmp_path, "drive"), version, tmp_path)
    controller, T = PythonController(system), system.implementation.period
    for k, (x, Y) in enumerate(zip(*along_a_run(system), strict=True)):
        imported.set(inputs(system, x, Y))
        wanted = controller.step(x, Y)
        assert abs(imported.step(k * T, T) - wanted) <= 1e-12 * max(1, abs(wanted))
    imported.close()


# An axis ----------------------------------------------------------------------------------------

FRICTION = """
[plant]
states = ["x1", "x2"]
chain = [1]
drift = "-2.14*x2"
gain_sign = 1
input_gain = 0.3696
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0.02]
beta = [0, 0.324]
[truth]
input_gain = 0.3696
omega = [0, "0.2*sign(x2)"]
[reference]
signal = "0.1*sin(t)"
bounds = [0.2, 0.25, 1, 20, 400]
[law]
kind = "robust"
c = [60, 60]
feedforward = 2
sampled_feedforward = true
[implementation]
period = 0.001
delay = 1.5
measurement_quantum = [5e-6, 0]
velocity = ["x2"]
velocity_filter = 0.001
[simulation]
x0 = [0, 0]
duration = 4
"""


def test_an_estimate_halves_the_error_of_an_axis_with_friction():
    axis = certrack.loads(FRICTION)
    plain = estimate_implemented(axis).bound
    law = replace(axis.law, observer=Observer(kind="dob", bandwidth=150.0))
    found, _ = certify_implemented(axis.replace(law=law))
    assert found.verified and found.bound <= 0.051e-3
    assert plain == pytest.approx(0.107e-3, rel=0.01)


@pytest.mark.slow
def test_integral_action_takes_the_adaptive_law_past_a_pid():
    """With friction that it does not know; its certificate of the drive is none."""
    tails = {c0: certrack.simulate(adaptive(30, c0, 8.0)).metrics.tail_error for c0 in (None, 30)}
    assert tails[30] < pid_tail(30, 8.0) and tails[30] < 0.6 * tails[None]
    assert not certrack.certify(adaptive(30, 30, 8.0)).implemented.exists

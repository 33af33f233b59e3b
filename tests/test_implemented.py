"""The certificate of the loop as it runs: sound against attacks, tight, or refused."""

import json
import math
import time
from dataclasses import replace

import flint
import independent_checker
import numpy as np
import pytest
from depth import depth
from pace import within
from sampled_attack import SampledLoop, worst_error

import certrack
from certrack.certificates import certify, to_document, verify
from certrack.certificates.arithmetic import rational
from certrack.certificates.implemented import gains as gains_room
from certrack.certificates.implemented import levels as levels_room
from certrack.certificates.implemented import outputs as outputs_room
from certrack.certificates.implemented.certify import certify_implemented
from certrack.certificates.implemented.drive import DRIVE_BITS, Drive, UncertainBound, drive_of
from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.estimate import estimate_implemented
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.gains import mean_magnitude, output_gains
from certrack.certificates.implemented.outputs import output_rows
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.powers import PastRows
from certrack.certificates.implemented.proof import delays, failed_implemented, prove_implemented
from certrack.cli import main
from certrack.loops.stability import linear_loop
from certrack.model.implementation import Implementation
from certrack.studies.ensembles.error_limit import tail_error_limit
from certrack.systems.reader import loads

#: Step of a 16-bit encoder, rad, and what noise within 1e-4 adds to it.
ENCODER, NOISE = 2 * math.pi / 2**16, 2e-4


def on_a_drive(name, T, speeds=(), noise=0.0, **entries):
    """A shipped system with 16-bit encoders on both shafts and half a period of delay."""
    quantum = ENCODER + noise  # a bounded error, whatever its source
    drive = {
        "period": T,
        "delay": 0.5,
        "measurement_quantum": (quantum, 0.0, quantum, 0.0),
        "velocity": speeds,
        "velocity_filter": 0.002 if speeds else 0.0,
    }
    return certrack.load(name).replace(implementation=Implementation(**(drive | entries)))


#: Name, period, whether speeds are differences, noise, what the bound must not exceed, and the
#: worst that was ever simulated.
MOTORS = [
    ("dual-motor", 0.001, True, 0.0, 0.02700, 0.026716),
    ("dual-motor-lean", 0.001, True, 0.0, 0.001390, 0.001301),
    ("dual-motor-lean", 0.003, True, 0.0, 0.001380, 0.001287),
    ("dual-motor-lean", 0.01, True, 0.0, 0.001335, 0.001227),
    ("dual-motor-lean", 0.001, True, NOISE, 0.00165, 0.001529),
    ("dual-motor-lean", 0.003, True, NOISE, 0.00164, 0.001516),
    ("dual-motor-lean", 0.01, True, NOISE, 0.00160, 0.001456),
    ("dual-motor-lean", 0.003, False, 0.0, 0.001335, 0.0012527),
]


@pytest.mark.parametrize(("name", "T", "differenced", "noise", "most", "simulated"), MOTORS)
def test_bounds_of_the_motors(name, T, differenced, noise, most, simulated):
    speeds = ("x2", "x4") if differenced else ()
    found, proofs = certify_implemented(on_a_drive(name, T, speeds, noise))
    assert found.verified and simulated < found.bound <= most
    assert found.saturation == "none" and len(proofs) == 1
    assert sum(found.parts.values()) == pytest.approx(found.bound, rel=1e-5)


def test_input_and_states_in_the_long_run():
    found, _ = certify_implemented(on_a_drive("dual-motor", 0.001, ("x2", "x4")))
    assert found.peak_input == pytest.approx(15.56, abs=0.01)
    found, _ = certify_implemented(on_a_drive("dual-motor-lean", 0.001, ("x2", "x4")))
    assert found.peak_input == pytest.approx(0.6103, abs=1e-3)
    assert 0.1 < found.states[0] < 0.102  # the reference's amplitude and the error


def test_exact_check_is_fast():
    system = on_a_drive("dual-motor-lean", 0.001, ("x2", "x4"))
    _, (proof,) = certify_implemented(system)
    with within(20):
        assert failed_implemented(system, proof, delays(system)[0]) == ""


# Random loops -------------------------------------------------------------------------------------


def random_drive(rng):
    """A random plant with a lean law on a drive, and its reference's amplitude and frequency."""
    n = int(rng.integers(1, 6))
    names = [f"x{i + 1}" for i in range(n)]
    differenced = [name for name in names[1:] if rng.random() < 0.3]
    tau = [round(float(rng.uniform(0.1, 1) * (rng.random() < 0.6)), 3) for _ in names]
    growth = float(rng.choice([0, 0.003, 0.02]))
    gain = round(float(rng.choice([-1, 1]) * rng.uniform(0.5, 5)), 3)
    amplitude, frequency = float(rng.choice([0, 0.01, 0.1])), round(float(rng.uniform(0.2, 2)), 2)
    drift = " + ".join(f"({rng.uniform(-4, 4):.3f})*{x}" for x in names)
    drift += "" if rng.random() < 0.7 else f" + {rng.uniform(-2, 2):.3f}"
    tables = {
        "plant": {
            "states": names,
            "chain": [
                round(float(rng.choice([-1, 1]) * rng.uniform(0.5, 3)), 3) for _ in names[1:]
            ],
            "linear": [
                [round(float(rng.uniform(-3, 3) * (rng.random() < 0.6)), 3) for _ in range(i + 1)]
                for i in range(n - 1)
            ],
            "drift": drift,
            "regressor": [],
            "gain_sign": int(np.sign(gain)),
            "input_gain": gain,
        },
        "plant.uncertainty": {
            "tau": [*tau[:-1], tau[-1] or 0.5],
            "gamma": [growth * (rng.random() < 0.6) for _ in names],
            "beta": [round(float(rng.uniform(0, 0.3)), 3) for _ in names],
        },
        "truth": {"input_gain": gain, "omega": [0] * n},
        "reference": {"signal": f"{amplitude}*sin({frequency}*t)"},
        "law": {
            "kind": "robust",
            "c": [round(float(rng.uniform(1.5, 8)), 3) for _ in names],
            "feedforward": int(rng.integers(0, n)),
        },
        "simulation": {"x0": [0] * n, "duration": 10},
        "implementation": {
            "period": float(rng.choice([5, 10, 20])) * 1e-3,
            "delay": float(rng.choice([0, 0.1, 0.5, 0.7, 1, 1.3, 2, 2.5, 3])),
            "input_quantum": float(rng.choice([0, 0, 0.01])),
            "measurement_quantum": [
                0.0 if x in differenced else float(rng.choice([0, 1e-4, 1e-3])) for x in names
            ],
            "velocity": differenced,
            "velocity_filter": float(rng.choice([0, 0.01])) if differenced else 0.0,
        },
    }
    lines = []
    for name, table in tables.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return loads("\n".join(lines), "random"), amplitude, frequency


def attacked(seed, count):
    """Bound over attack of random loops; a loop without a bound must have a reason."""
    rng, ratios = np.random.default_rng(seed), []
    for _ in range(count):
        system, amplitude, frequency = random_drive(rng)
        found, _ = certify_implemented(system)
        radius = linear_loop(system).radius(
            system.implementation.period, system.implementation.delay
        )
        if not found.exists:
            assert radius > 0.9 or "too strong" in found.reason, found.reason
            assert ("unstable" in found.reason) == (radius >= 1), found.reason
            continue
        assert radius < 1
        ratios.append(found.bound / worst_error(system, amplitude, frequency))
        assert ratios[-1] >= 1, (seed, system.implementation)
    return ratios


def test_no_attack_beats_the_bound_of_random_loops():
    assert np.median(attacked(4, 5)) <= 1.15


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(2, 12)))
def test_no_attack_beats_the_bound_of_many_random_loops(seed):
    assert np.median(attacked(100 + seed, 25)) <= 1.15


def test_attack_on_the_input():
    system = on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"))
    found, _ = certify_implemented(system)
    attack = SampledLoop(system).error(0, 300, 0.1, 0.75, output=None)
    assert 0.4 * found.peak_input < attack <= found.peak_input


def test_period_map_is_that_of_the_sampled_controller():
    rng = np.random.default_rng(5)
    for _ in range(12):
        system, _, _ = random_drive(rng)
        drive = system.implementation
        with flint.ctx.workprec(DRIVE_BITS):
            M = Enclosed.of(one_period(drive_of(system), (2, 3)).map).value
        radius = float(np.abs(np.linalg.eigvals(M)).max())
        assert radius == pytest.approx(
            linear_loop(system).radius(drive.period, drive.delay), rel=1e-6
        )


# Cases with a known answer ------------------------------------------------------------------------


def bare_drive(A, b, W, Ly, T, Y, lipschitz, uncertain, mu=None):
    """A loop whose input does not depend on its state."""
    n, wide = len(A), len(Ly)
    with flint.ctx.workprec(DRIVE_BITS):
        return Drive(
            A=flint.arb_mat(A),
            b=flint.arb_mat([[v] for v in b]),
            W=flint.arb_mat(W),
            Lx=flint.arb_mat(1, n),
            Ls=flint.arb_mat(1, 0),
            Ly=flint.arb_mat([Ly]),
            Sx=flint.arb_mat(0, n),
            Ss=flint.arb_mat(0, 0),
            Sy=flint.arb_mat(0, wide),
            first=flint.arb_mat(0, n),
            first_input=flint.arb_mat(0, 1),
            T=rational(T),
            delay=rational(0.0),
            uncertain=tuple(uncertain),
            mu=tuple(map(rational, mu or [0.0] * n)),
            eta=rational(0.0),
            Y=tuple(map(rational, Y)),
            lipschitz=None if lipschitz is None else rational(lipschitz),
            jumps=None,
            jumps_once=False,
            offset=rational(0.0),
        )


def bounded(drive, parts=(1, 1), doublings=10):
    """F at its fixed point: e_1, the states, u, its steps."""
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive, parts)
        rows = output_rows(period)
        bounds = OutputBounds.of(period, rows, output_gains(period, rows, doublings))
        X, U = bounds.search()
        return [float(v) for v in bounds.image([flint.arb(v) for v in X], flint.arb(U))]


UNIT_W = UncertainBound(rational(0.0), rational(1.0), (rational(1.0),), (rational(0.0),))


def test_what_acts_between_samples_counts_once():
    """x' = -x + w, |w| <= 1: the truth is 1; without the weights s/h it was 1.0513."""
    drive = bare_drive([[-1]], [0], [[1]], [0, 0], 0.1, [0.0, 0.0], 0.0, [UNIT_W])
    assert 1 <= bounded(drive, parts=(1, 2))[1] <= 1.0031
    assert 1 <= bounded(drive, parts=(1, 20))[1] <= 1.0001


def test_the_running_period_counts():
    """The law u = y_d'' has |u| up to Y_2, by the sample of the period that runs."""
    drive = bare_drive([[-1]], [0], [[1]], [0, 0, 1], 0.1, [1.0, 0.3, 0.1], 0.05, [UNIT_W])
    assert bounded(drive)[2] == pytest.approx(0.1, rel=1e-6)
    assert bounded(drive)[2] >= 0.1


def test_sampling_of_the_last_derivative():
    """x' = -x + u, u = y_d': without a Lipschitz constant the sample may miss all of y_d'."""
    Y = [1.0, 0.2]
    spread = bounded(bare_drive([[-1]], [1], [[0]], [1, 1], 0.1, Y, 0.01, [UNIT_W]))[0]
    apart = bounded(bare_drive([[-1]], [1], [[0]], [1, 1], 0.1, Y, None, [UNIT_W]))[0]
    # u = y + y' holds x = y in continuous time; sampled at 10 Hz it lags by half a period
    assert 0.01 < spread < 0.05 and apart > 0.3


def test_period_to_zero_is_the_continuous_peak_gain():
    system = certrack.load("dual-motor-lean")
    c = system.controller.coordinates
    bounds = []
    for T in (2e-3, 1e-3, 5e-4):
        drive = Implementation(period=T)
        bounds.append(certify_implemented(system.replace(implementation=drive))[0].bound)
    continuous = continuous_peak(c, system.plant.uncertainty, system.reference.bounds(2).values)
    limit = 2 * bounds[2] - bounds[1]  # what is linear in T goes
    assert limit == pytest.approx(continuous, rel=1e-4)
    assert abs(bounds[2] - continuous) < abs(bounds[1] - continuous) < abs(bounds[0] - continuous)


def continuous_peak(c, u, Y, steps=40_000, h=1e-4):
    """The bound by peak gains of the continuous loop, by a sum over its impulse responses."""
    from scipy.linalg import expm

    M = np.array(c.error_matrix, float)
    Xe = np.linalg.inv(np.array(c.A, float))
    columns = np.hstack([np.array(c.A, float) @ np.diag(u.tau), -np.array(c.R, float)[:, None]])
    rows = np.vstack([np.eye(len(M))[:1], Xe])
    gains, state, step = 0.0, expm(M * h / 2) @ columns, expm(M * h)
    for _ in range(steps):
        gains = gains + np.abs(rows @ state) * h
        state = step @ state
    still = np.abs(Xe @ np.array(c.B, float)) @ np.array(Y[:2])
    still = np.concatenate([[0.0], still])
    n = len(M)
    constant = still + gains[:, :n] @ np.array(u.beta) + gains[:, n] * Y[2]
    norm = 0.0
    for _ in range(200):
        value = constant + gains[:, :n] @ np.array(u.gamma) * norm
        norm = np.linalg.norm(value[1:])
    return value[0]


def test_a_constant_in_the_drift_is_in_the_input_only():
    base = certrack.load("dual-motor-lean")
    moved = replace(base.plant, drift="K_L/J_M*(x1 - x3) + 6")
    drive = Implementation(period=0.003, delay=0.5)
    plain, _ = certify_implemented(base.replace(implementation=drive))
    found, _ = certify_implemented(base.replace(plant=moved, implementation=drive))
    assert found.bound == plain.bound
    assert found.peak_input == pytest.approx(plain.peak_input + 6 / 20)


def with_triangles(T):
    text = certrack.systems.writer.to_text(certrack.load("dual-motor-lean"))
    triangle = 'kind = "triangle"\namplitude = 0.02\nperiod = 8'
    text = text.replace('signal = "0.1*sin(0.75*t)"', triangle)
    text = text.replace("feedforward = 1", "feedforward = 0").replace("bound = 0.2", "")
    return loads(text, "triangle").replace(implementation=Implementation(period=T, delay=0.5))


def test_corners_of_the_reference():
    """y_d' of a triangle jumps every 4 s, which counts; no run is beyond, though it comes near."""
    system = with_triangles(0.03)
    found, _ = certify_implemented(system)
    run = certrack.simulate(system, duration=24.0)
    worst = np.abs(run.e[0][run.t > 8]).max()
    assert worst < found.bound < 2 * worst
    drive = drive_of(system)
    assert float(drive.jumps[0]) == pytest.approx(0.02) and float(drive.jumps[1]) < 4
    assert (
        "jumps by at most 0.02"
        in {p.name: p.detail for p in certify(system).premises}["sampled reference"]
    )
    jumps_anywhere = replace(drive, lipschitz=None, jumps=None)
    assert bounded(jumps_anywhere)[0] > 2 * found.bound
    never = replace(drive, jumps=None)
    assert bounded(never)[0] < found.bound


def test_errors_of_samples_count_where_the_largest_is_not_the_first(monkeypatch):
    """Jumps of y_d' count by the largest sample of several periods, and by what floats lost."""
    drive = drive_of(with_triangles(0.03))
    product_error = gains_room.product_error

    def jump():
        with flint.ctx.workprec(DRIVE_BITS):
            period = one_period(drive, (1, 1))
            return output_gains(period, output_rows(period), 9).jump

    exact = jump()
    monkeypatch.setattr(gains_room, "product_error", lambda *a: product_error(*a) + 1e-6)
    assert (jump() >= exact + 0.999e-6).all()


def test_floats_enclose_what_balls_compute():
    """The sums of the engine against the same sums in 2000 bits, period by period."""
    system = on_a_drive("dual-motor-lean", 0.02, ())
    doublings = 7
    with flint.ctx.workprec(2000):
        period = one_period(drive_of(system), (1, 1))
        rows = output_rows(period)
        columns = gains_room.kernel_columns(period, 2, smeared=True)
        past = gains_room.running_period(period, rows)[1]
        heads = PastRows.of(period, past, doublings)
        sums, _ = gains_room.sums_of_periods(period, columns, heads, doublings)
        row = flint.arb_mat([past.tolist()[0]])
        width = columns.nodes.ncols() // 3
        exact = [flint.arb(0)] * (sums.shape[1])
        for _ in range(2**doublings):
            seen = (row * columns.all()).entries()
            for p in range(2):
                for j in range(width):
                    a, b = seen[p * width + j], seen[(p + 1) * width + j]
                    crossing = (a < 0 and b > 0) or (a > 0 and b < 0)
                    size = (a * a + b * b) / (abs(a) + abs(b)) if crossing else abs(a) + abs(b)
                    exact[j] += size / 2 * period.cells[1 - p].length
            for j, value in enumerate(seen[3 * width :]):
                exact[width + j] += abs(value)
            row = row * period.map
        for value, true in zip(sums[0], exact, strict=True):
            assert flint.arb(float(value)) >= true
            assert float(value) <= float(true) * (1 + 1e-9) + 1e-15


def test_mean_of_a_line_is_exact():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 100))
    s = np.linspace(0, 1, 2001)[:, None]
    assert mean_magnitude(a, b) == pytest.approx(
        np.trapezoid(np.abs(a + s * (b - a)), s[:, 0], axis=0), abs=1e-6
    )
    assert mean_magnitude(np.zeros(1), np.zeros(1)) == 0
    assert mean_magnitude(np.array([-1e-300]), np.array([1e-300])) == pytest.approx(5e-301)


# Wrong engines are caught -------------------------------------------------------------------------


def wrong_sign(monkeypatch):
    """The reference's motion with the sign of its sample."""
    honest = gains_room.kernel_columns

    def flipped(period, phase, smeared):
        columns = honest(period, phase, smeared)
        if not smeared:
            return columns
        width = period.W.ncols() + 1
        nodes = columns.nodes
        last = period.after[0] * gains_room.column(period.reference, period.drive.q + 1)
        for end in range(len(columns.lengths) + 1):
            for i in range(nodes.nrows()):
                spread = last[i, 0] / period.drive.T
                nodes[i, end * width + width - 1] = 2 * spread - nodes[i, end * width + width - 1]
        return replace(columns, nodes=nodes)

    monkeypatch.setattr(gains_room, "kernel_columns", flipped)
    monkeypatch.setattr(levels_room, "levels_of", lambda _: [])  # which have kernels of their own


def forgotten_tail(monkeypatch):
    """The sums end after two periods."""
    for room in (gains_room, levels_room):
        monkeypatch.setattr(room, "tail_gains", lambda last, each, power: 0 * last @ each)
    monkeypatch.setattr("certrack.certificates.implemented.proof.periods_needed", lambda _: 1)


def forgotten_running_period(monkeypatch):
    """What acts since the last sample is left out."""
    honest = gains_room.running_period

    def without(period, rows):
        table, past = honest(period, rows)
        return 0 * table, past

    monkeypatch.setattr(gains_room, "running_period", without)


def forgotten_samples(monkeypatch):
    """Sensors exact at every sample."""
    honest = gains_room.gains_of

    def silent(table, nw, n, jump):
        return replace(honest(table, nw, n, jump), noise=np.zeros((len(table), n)))

    monkeypatch.setattr(gains_room, "gains_of", silent)


SMALL = """
[plant]
states = ["x"]
chain = []
linear = []
drift = "-x"
regressor = []
gain_sign = 1
input_gain = 2
[plant.uncertainty]
tau = [1]
gamma = [0]
beta = [0.1]
[truth]
input_gain = 2
omega = [0]
[reference]
signal = "0.1*sin(0.1*t)"
[law]
kind = "robust"
c = [4]
[simulation]
x0 = [0]
duration = 5
[implementation]
period = 0.05
delay = 0.5
measurement_quantum = [0.01]
"""


@pytest.mark.parametrize("wrong", [forgotten_tail, forgotten_samples])
def test_a_wrong_engine_is_beaten_by_the_attack(monkeypatch, wrong):
    system = loads(SMALL, "small")
    attack = worst_error(system, 0.1, 0.1)
    assert attack <= certify_implemented(system)[0].bound < 1.1 * attack
    wrong(monkeypatch)
    assert certify_implemented(system)[0].bound < attack


def test_a_forgotten_running_period_is_seen(monkeypatch):
    drive = bare_drive([[-1]], [0], [[1]], [0, 0, 1], 0.1, [1.0, 0.3, 0.1], 0.05, [UNIT_W])
    forgotten_running_period(monkeypatch)
    assert bounded(drive)[2] < 0.1  # what test_the_running_period_counts looks at


def test_a_wrong_sign_in_a_kernel_is_seen(monkeypatch):
    """The sample no longer cancels the motion it feeds forward: far from the simulated worst."""
    wrong_sign(monkeypatch)
    found, _ = certify_implemented(on_a_drive("dual-motor-lean", 0.003))
    assert not found.exists or found.bound > 0.00140


# Refusals -----------------------------------------------------------------------------------------


def test_refusals_say_why():
    lean = certrack.load("dual-motor-lean")

    def reason(system, **entries):
        drive = Implementation(**({"period": 0.003, "delay": 0.5} | entries))
        return certify_implemented(system.replace(implementation=drive))[0].reason

    assert "no [implementation]" in certify_implemented(lean)[0].reason
    assert "spectral radius" in reason(lean, period=0.2)
    assert "noise_bound" in reason(lean, noise=(1e-5, 0, 0, 0))
    assert "adaptive" in reason(certrack.load("example1"))
    u = lean.plant.uncertainty
    strong = replace(u, gamma=tuple(200 * v for v in u.gamma))
    assert "too strong" in reason(lean.replace(plant=replace(lean.plant, uncertainty=strong)))
    nonlinear = replace(lean.plant, drift="x1**2")
    assert "linear" in reason(lean.replace(plant=nonlinear))
    ramp = lean.replace(reference=certrack.SymbolicReference("0.1*t"))
    assert "bounds of the reference" in reason(ramp)
    published = on_a_drive("dual-motor", 0.001, ("x2", "x4"), saturation=(-15.0, 15.0))
    assert "15.5" in certify_implemented(published)[0].reason  # it may saturate for ever


def test_limits_that_may_act_leave_nothing_verified():
    system = on_a_drive("dual-motor-lean", 0.003, ("x2", "x4"), saturation=(-2.0, 2.0))
    result = certify(system)
    assert not result.implemented.verified and result.implemented.saturation == "may act"
    assert result.implemented.exists and result.best is not result.implemented
    assert "input limits" not in {p.name for p in result.premises}
    slow = on_a_drive("dual-motor-lean", 0.003, ("x2", "x4"), rate_limit=1.0)
    assert "rate limit" in certify_implemented(slow)[0].reason
    assert certify_implemented(on_a_drive("dual-motor-lean", 0.003, ("x2", "x4"), rate_limit=1e4))[
        0
    ].verified


def test_a_gain_that_the_law_does_not_know_is_covered_by_cells():
    lean = certrack.load("dual-motor-lean")
    ranged = lean.replace(
        plant=replace(lean.plant, input_gain_range=(15.0, 25.0)),
        implementation=Implementation(period=0.003),
    )
    found, _ = certify_implemented(ranged)
    assert found.verified and found.cells > 1
    for gain in (15.0, 25.0):
        member = ranged.replace(truth=replace(ranged.truth, input_gain=gain))
        assert worst_error(member, 0.1, 0.75) < found.bound < 0.01
    with pytest.raises(certrack.NoCertificate, match="input_gain"):
        drive_of(ranged)


# Files and the command line -----------------------------------------------------------------------

MUTANTS = {
    "bound": lambda p: replace(p, bound=f"{float(p.bound) * 0.9999:.12g}"),
    "state": lambda p: replace(p, states=(*p.states[:-1], f"{float(p.states[-1]) * 0.99:.12g}")),
    "input": lambda p: replace(p, input=f"{float(p.input) * 0.99:.12g}"),
    "step": lambda p: replace(p, step=f"{float(p.step) * 0.99:.12g}"),
    "delay": lambda p: replace(p, delay="1/4"),
    "fewer periods": lambda p: replace(p, doublings=6),
    "no periods": lambda p: replace(p, doublings=-1),
    "no cells": lambda p: replace(p, parts=(0, 1)),
    "a state less": lambda p: replace(p, states=p.states[1:]),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutated_proofs_are_refused(mutant):
    system = on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"))
    proof, _ = prove_implemented(system, delays(system)[0])
    assert failed_implemented(system, proof, delays(system)[0]) == ""
    assert failed_implemented(system, MUTANTS[mutant](proof), delays(system)[0]) != ""
    assert not verify(to_document(system, MUTANTS[mutant](proof))).verified


@pytest.mark.slow
def test_certificate_file():
    system = on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"))
    result = certify(system)
    assert result.best is result.implemented and result.verified
    document = to_document(system, *result.stages)
    verdict = verify(document)
    assert verdict.verified and float(verdict.bound) <= result.best.bound
    assert [p.record() for p in verdict.premises] == document["premises"]
    for broken in (
        document | {"proof": document["proof"] * 2},
        document | {"system": document["system"].replace("delay = 0.5", "delay = 0.6")},
        document | {"claim": "limsup |e_1(t)| <= 0.001"},
    ):
        assert not verify(broken).verified
    entry = document["proof"][0]
    for wrong in ({"parts": [1]}, {"doublings": 7.0}, {"states": "1"}, {"delay": "1/0"}):
        with pytest.raises(certrack.InputError):
            verify(document | {"proof": [entry | wrong]})
    with pytest.raises(certrack.InputError, match="must have"):
        verify(document | {"proof": [{k: v for k, v in entry.items() if k != "step"}]})


def command(capsys, *arguments):
    """Exit code and standard output of the command line."""
    with pytest.raises(SystemExit) as stopped:
        main(list(map(str, arguments)))
    return stopped.value.code or 0, capsys.readouterr().out


@pytest.mark.slow
def test_command_line(tmp_path, capsys):
    file, out = tmp_path / "drive.toml", tmp_path / "cert.json"
    certrack.save(on_a_drive("dual-motor-lean", 0.01, ("x2", "x4")), file)
    code, text = command(capsys, "certify", file, "--json", "--out", out)
    found = json.loads(text)
    assert code == 0 and found["verified"]
    assert found["best"] == {
        "method": "implemented",
        "bound": found["implemented"]["bound"],
        "verified": True,
        "loop": "implemented",
        "starts": "every start",
    }
    assert len(found["implemented"]["states"]) == 4 and found["implemented"]["peak_input"] < 0.4
    assert "ship with implemented" in command(capsys, "certify", file)[1]
    code, text = command(capsys, "verify", out)
    assert code == 0 and "sampled loop" in text


def test_ensembles_of_drives_take_it_as_their_limit():
    system = on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"))
    bound = certify_implemented(system)[0].bound
    assert tail_error_limit(system, None) == (bound, "certificate")
    unstable = on_a_drive("dual-motor-lean", 0.3)
    limit, reason = tail_error_limit(unstable, None)
    assert limit is None and "unstable" in reason


@pytest.mark.slow
def test_members_keep_the_bound():
    found = certrack.ensemble(on_a_drive("dual-motor-lean", 0.01, ("x2", "x4")), 200)
    assert found.limit_origin == "certificate" and found.violations()["count"] == 0


def test_rows_of_outputs_are_their_polynomials():
    """Bernstein rows of a cell give the state inside it, for a loop at rest but for its start."""
    system = on_a_drive("dual-motor-lean", 0.02)
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive_of(system), (1, 1))
        rows = [r for r in outputs_room.output_rows(period) if r.output == 1 and r.phase == 0]
        chi = np.random.default_rng(1).normal(size=period.size)
        values = [
            float(sum((v * c for v, c in zip(r.row, chi, strict=True)), flint.arb(0))) for r in rows
        ]
        end = Enclosed.of(period.cells[0].transition).value[0] @ chi
    assert values[0] == pytest.approx(chi[0])
    assert values[-1] == pytest.approx(end, abs=1e-4)


# Another reading of the page ----------------------------------------------------------------------


def proofs_that_agree(system):
    """Proofs of which `verify` and the checker that was written from the page say the same."""
    _, proofs = certify_implemented(system)
    document = to_document(system, *proofs)
    assert verify(document).verified
    assert independent_checker.check(document) == independent_checker.decimal(
        max(proofs, key=lambda p: float(p.bound)).bound
    )
    return proofs


def by_both(system):
    """Both checkers accept the proofs, and the other one refuses smaller claims."""
    proofs = proofs_that_agree(system)
    smaller = [replace(p, bound=f"{float(p.bound) * 0.98:.12g}") for p in proofs]
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(to_document(system, *smaller))
    less = [replace(p, states=tuple(f"{float(v) * 0.9:.9g}" for v in p.states)) for p in proofs]
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(to_document(system, *less))


def test_another_checker_agrees():
    by_both(on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"), delay=(0.3, 1.2)))
    by_both(loads(SMALL, "small"))


@pytest.mark.slow
def test_another_checker_agrees_on_more():
    by_both(with_triangles(0.03))
    proofs_that_agree(certrack.load("dual-motor-drive"))
    rng, held = np.random.default_rng(11), 0
    for _ in range(depth(4, 40)):
        system, _, _ = random_drive(rng)
        if certify_implemented(system)[0].exists:
            by_both(system)
            held += 1
    assert held > 1


def test_estimate_is_near_the_proof_and_fast():
    for name, T in (("dual-motor-lean", 0.001), ("dual-motor", 0.003)):
        system = on_a_drive(name, T, ("x2", "x4"))
        start = time.process_time()
        found, _ = certify_implemented(system)
        proof_seconds = time.process_time() - start
        seconds = []
        for _ in range(4):
            start = time.process_time()
            estimate = estimate_implemented(system)
            seconds.append(time.process_time() - start)
        assert estimate.bound == pytest.approx(found.bound, rel=1e-4)
        assert estimate.peak_input == pytest.approx(found.peak_input, rel=1e-4)
        assert min(seconds) < proof_seconds / 3
    corners = with_triangles(0.03)
    assert estimate_implemented(corners).bound == pytest.approx(
        certify_implemented(corners)[0].bound, rel=0.01
    )
    with pytest.raises(certrack.NoCertificate, match="unstable"):
        estimate_implemented(on_a_drive("dual-motor-lean", 0.3))


def test_the_unit_of_time_does_not_matter():
    """The same loop in seconds and in milliseconds, with q = 2."""

    def scaled(unit):
        Y = [1.0, 0.5 / unit, 0.3 / unit**2, 0.2 / unit**3]
        law = [4.0, 4.0 * unit, unit**2, 0.1 * unit**3]
        drive = bare_drive(
            [[-1 / unit]], [0.25 / unit], [[1 / unit]], law, 0.25 * unit, Y, 0.4 / unit**4, [UNIT_W]
        )
        return bounded(drive, parts=(1, 3))

    assert scaled(1.0) == pytest.approx(scaled(1024.0), rel=1e-9)


def test_what_products_lose_is_counted():
    """Sums of the errors of heads times table, for true numbers anywhere in their balls."""
    rng = np.random.default_rng(4)
    heads, table = rng.normal(size=(6, 4)), rng.normal(size=(4, 10))
    head_error, table_error = 1e-3 * np.abs(heads), 1e-2 * rng.random((4, 10))
    found = gains_room.product_error(
        Enclosed(heads, head_error), Enclosed(table, table_error), 2, 5
    )
    for _ in range(200):
        h = heads + head_error * rng.choice([-1, 1], heads.shape)
        t = table + table_error * rng.choice([-1, 1], table.shape)
        lost = np.abs(h @ t - heads @ table).reshape(3, 2, 5, 2).sum(axis=(0, 2))
        assert (lost <= found).all()
    worst = (np.abs(heads) + head_error) @ (np.abs(table) + table_error)
    most = (worst - np.abs(heads) @ np.abs(table)).reshape(3, 2, 5, 2).sum(axis=(0, 2))
    assert found == pytest.approx(most, rel=1e-6)
    exact = gains_room.product_error(Enclosed(heads, 0 * heads), Enclosed(table, 0 * table), 2, 5)
    assert (exact > 0).all() and (exact < 1e-13).all()  # the floats' own roundings


def test_kernels_that_bend_within_a_cell():
    """x'' = -x' - 25 x + w in cells of a radian: the lines between the ends are too small."""
    two = UncertainBound(rational(0.0), rational(1.0), (rational(1.0),) * 2, (rational(0.0),) * 2)
    drive = bare_drive([[0, 1], [-25, -1]], [0, 0], [[0], [1]], [0, 0], 0.2, [0.0, 0.0], 0.0, [two])
    s = np.linspace(0, 60, 1_200_001)
    omega = math.sqrt(24.75)
    kernel = np.abs(np.exp(-s / 2) * np.sin(omega * s) / omega)
    truth = np.trapezoid(kernel, s)
    assert np.trapezoid(kernel[::4000], s[::4000]) < 0.995 * truth
    for parts, most in ((1, 1.3), (8, 1.005)):
        with flint.ctx.workprec(DRIVE_BITS):
            period = one_period(drive, (1, parts))
            rows = output_rows(period)
            gains = output_gains(period, rows, 9)
        (at_sample,) = [i for i, r in enumerate(rows) if (r.output, r.phase, r.share) == (1, 0, 0)]
        assert truth <= gains.w[at_sample, 0] < most * truth


def test_what_is_before_the_summed_periods_counts(monkeypatch):
    system = loads(SMALL, "small")
    monkeypatch.setattr("certrack.certificates.implemented.proof.periods_needed", lambda _: 4)
    short = certify_implemented(system)[0].bound
    monkeypatch.undo()
    full = certify_implemented(system)[0].bound
    assert full * (1 - 1e-9) <= short < 1.1 * full


def test_noise_and_half_a_step_add_up():
    quiet = certify_implemented(on_a_drive("dual-motor-lean", 0.01))[0].parts["sensors"]
    noisy = on_a_drive("dual-motor-lean", 0.01, noise_bound=(ENCODER, 0.0, ENCODER, 0.0))
    assert certify_implemented(noisy)[0].parts["sensors"] == pytest.approx(3 * quiet, rel=1e-6)

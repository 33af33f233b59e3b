"""Two motors behind one input: split, damping, supply, and a balance that closes."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from test_cli import invoke, result

import certrack
from certrack.core.errors import InputError
from certrack.integrators.base import Outcome
from certrack.loops.energy import (
    FLOWS,
    motor_numbers,
    power_formulas,
    power_values,
    stored_energy,
    with_flows,
    with_motors,
)
from certrack.model.motors import MotorNumbers, Motors, Supply
from certrack.reports.energy import energy_notes, energy_table

SERVO = certrack.load("dual-motor-physical")
MOTORS = SERVO.truth.motors

#: As before there were motors: shares of u in the rates.
UNSPLIT = {"T_1/J_M": "K_M/J_M*split*u", "T_2/J_M": "K_M/J_M*(1 - split)*effectiveness_2*u"}

positive = st.floats(0.05, 20).map(lambda value: float(f"{value:.4g}"))
pairs = st.tuples(positive, positive)


def in_truth(system=SERVO, **changes):
    return system.replace(truth=replace(system.truth, **changes))


def constants(**changes):
    return tuple((dict(SERVO.truth.constants) | changes).items())


def without_disturbances(friction=0.0):
    """The servo with viscous friction of both motors and the load, and nothing from outside."""
    shafts = [
        f"(max(th_{i} - th_L - backlash, 0) + min(th_{i} - th_L + backlash, 0))" for i in (1, 2)
    ]
    rates = (
        "om_L",
        f"K_L/J_L*({shafts[0]} + {shafts[1]}) - d_f/J_L*om_L",
        *("om_1", f"T_1/J_M - K_L/J_M*{shafts[0]} - d_f/J_M*om_1"),
        *("om_2", f"T_2/J_M - K_L/J_M*{shafts[1]} - d_f/J_M*om_2"),
    )
    motors = replace(MOTORS, friction="d_f*(om_L**2 + om_1**2 + om_2**2)")
    return in_truth(rates=rates, motors=motors, constants=constants(d_f=friction))


@pytest.fixture(scope="module")
def found():
    return certrack.energy(SERVO, damping=0.05)


@pytest.fixture(scope="module")
def undamped():
    return certrack.energy(SERVO)


# --- the split ------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [None, 0.001])
@pytest.mark.parametrize("split", [0.5, 0.4])
def test_motors_change_no_bit_of_the_run(split, period):
    texts = [rate.text for rate in SERVO.truth.rates]
    for name, text in UNSPLIT.items():
        texts = [rate.replace(name, text) for rate in texts]
    implementation = period and certrack.Implementation(period=period)
    with_them = in_truth(constants=constants(split=split, effectiveness_2=0.9, backlash=0.01))
    without = in_truth(with_them, rates=tuple(texts), motors=None, supply=None)
    runs = [
        certrack.simulate(system.replace(implementation=implementation), duration=3)
        for system in (with_them, without)
    ]
    assert np.array_equal(runs[0].t, runs[1].t)
    assert np.array_equal(runs[0].x, runs[1].x)
    assert np.array_equal(runs[0].u, runs[1].u)


@given(
    R=pairs,
    b=st.tuples(positive, positive),
    k=pairs,
)
def test_the_best_share_is_the_minimum(R, b, k):
    motors = MotorNumbers(R, b, k)
    least = minimize_scalar(motors.loss, bounds=(0, 1), method="bounded", options={"xatol": 1e-10})
    assert motors.loss(motors.best_share) <= least.fun * (1 + 1e-12)
    assert motors.best_share == pytest.approx(least.x, abs=1e-5)
    assert 0 <= motors.best_saving < 1


@given(R=pairs, k=positive)
def test_what_the_best_share_saves(R, k):
    saving = ((R[0] - R[1]) / (R[0] + R[1])) ** 2
    assert MotorNumbers(R, (k, k), (k, k)).best_saving == pytest.approx(saving, abs=1e-12)
    assert MotorNumbers(R, (k, k), (k, k)).best_share == pytest.approx(R[1] / (R[0] + R[1]))


@given(R=pairs, k=pairs, b=positive)
def test_with_other_torque_constants_the_loss_of_a_newton_metre_counts(R, k, b):
    a = [R[0] / k[0] ** 2, R[1] / k[1] ** 2]
    motors = MotorNumbers(R, (b, b), k)
    assert motors.best_saving == pytest.approx(((a[0] - a[1]) / (a[0] + a[1])) ** 2, abs=1e-12)


def test_equal_motors_have_nothing_to_save():
    motors = MotorNumbers((2.0, 2.0), (3.0, 3.0), (3.0, 3.0))
    assert motors.best_share == 0.5
    assert motors.best_saving == 0


def test_the_best_share_without_damping_saves_a_ninth_and_leaves_the_shafts_swinging(undamped):
    assert undamped.saving_by_split == pytest.approx(1 / 9, abs=1e-9)  # the mean sees no split
    best = undamped.splits[2]
    assert best.share == pytest.approx(2 / 3)
    assert best.twist == pytest.approx(1.231, abs=1e-3)
    assert best.tail_twist > 2.4  # from -1.22 to 1.22 rad
    assert any("truth.motors.damping" in note for note in energy_notes(undamped))


def test_with_damping_the_difference_decays_and_most_of_the_saving_stays(found):
    best = found.splits[2]
    assert found.saving_by_split == pytest.approx(0.0980, abs=5e-5)
    assert best.twist == pytest.approx(0.6575, abs=1e-4)
    assert best.tail_twist < 0.02
    assert not any("truth.motors.damping" in note for note in energy_notes(found))


def test_the_difference_of_the_shafts_decays_as_its_equation_says():
    """J d'' + 2 K_M k_d d' + K_L d = 0 for the difference d of the shafts, without input."""
    system = in_truth(without_disturbances(), constants=constants(d_f=0, split=0.5))
    system = with_motors(system, damping=0.05).with_settings(
        x0=(0, 0, 0.1, 0, -0.1, 0), duration=3, tolerance=1e-12
    )
    run = certrack.simulate(system)
    t = np.linspace(0, 3, 200)
    states = run.trajectory.interpolate(t)
    decay, w2 = 4 * 0.05 / 0.1, 3 / 0.1
    w = math.sqrt(w2 - decay**2)
    d = 0.2 * np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))
    assert np.abs(states[2] - states[4] - d).max() < 1e-8


# --- the balance ----------------------------------------------------------------------------


def test_the_balance_closes_per_cycle_and_over_the_run(found):
    for balance in (found.balance, *found.cycles):
        assert abs(balance.residual) < 1e-9
    assert len(found.cycles) == 2
    assert found.cycle == pytest.approx(2 * math.pi / 0.75)
    assert found.cycles[0].end == found.cycles[1].begin
    assert found.balance.net == found.balance.drawn - found.balance.returned


SIMULATOR = {}


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(
    share=st.floats(0, 1),
    damping=st.floats(0, 0.2),
    lost=st.floats(0.5, 1),
    play=st.floats(0, 0.02),
    x0=st.lists(st.floats(-1, 1), min_size=6, max_size=6),
)
def test_the_balance_closes_for_random_motors(share, damping, lost, play, x0):
    changed = in_truth(constants=constants(effectiveness_2=lost, backlash=play))
    system = with_motors(changed, share=share, damping=damping).with_settings(
        x0=tuple(x0), duration=4
    )
    wider = with_flows(system, 1e-12)
    simulator = SIMULATOR.setdefault("one", None) or certrack.Simulator(wider)
    SIMULATOR["one"] = simulator
    run = simulator.run(wider)
    assert run.outcome is Outcome.finished
    states = run.trajectory.interpolate(np.array([0.0, 4.0]))
    flow = dict(zip(FLOWS, states[6 : 6 + len(FLOWS), 1], strict=True))
    spent = sum(flow[f"copper_{i}"] for i in (1, 2)) + flow["chopper"] + flow["supply_loss"]
    grown = np.diff(stored_energy(system, states))[0]
    missing = flow["drawn"] - flow["returned"] - spent - grown + flow["surroundings"]
    assert abs(missing) < 1e-9
    assert flow["twist"] == pytest.approx(np.diff(states[2] - states[4])[0], abs=1e-9)
    assert flow["work_1"] + flow["work_2"] + flow["surroundings"] == pytest.approx(grown, abs=1e-9)


@pytest.mark.parametrize(
    "supply",
    [
        None,
        Supply("chopper", voltage=24, resistance=0.2),
        Supply("battery"),
        Supply("battery", voltage=60, resistance=0.3, efficiency=0.7, power_limit=50),
    ],
)
def test_the_balance_closes_for_every_supply(supply):
    found = certrack.energy(in_truth(supply=supply).with_settings(duration=9), damping=0.05)
    balance = found.balance
    assert abs(balance.residual) < 1e-9
    assert balance.drawn >= balance.asked > 0
    if supply is None or supply.kind == "chopper":
        assert balance.returned == 0
        assert balance.chopper == pytest.approx(balance.given_back, abs=1e-9)
    elif supply.resistance == 0:
        assert balance.returned == pytest.approx(balance.given_back, abs=1e-9)
        assert balance.chopper == balance.supply_loss == 0
    else:
        assert 0 < balance.chopper < balance.given_back
        assert 0 < balance.returned < 0.7 * balance.given_back


def test_flows_are_those_that_quadrature_finds(found):
    """Gauss's quadrature of the powers along the run, 12 points on each step."""
    run, steps = found.run, found.run.trajectory.times
    nodes, weights = np.polynomial.legendre.leggauss(12)
    half = np.diff(steps) / 2
    t = (steps[:-1] + half)[:, None] + half[:, None] * nodes
    states = run.trajectory.interpolate(t.ravel())
    powers = power_values(found.system, t.ravel(), states, run.input_of(t.ravel(), states))
    ends = run.trajectory.interpolate(steps[[0, -1]])
    for name, values in powers.items():
        total = np.sum(values.reshape(t.shape) * weights * half[:, None])
        place = 6 + FLOWS.index(name)
        assert ends[place, 1] - ends[place, 0] == pytest.approx(total, abs=1e-8), name


def test_nothing_from_outside_and_all_friction_told():
    found = certrack.energy(without_disturbances(friction=0.2).with_settings(duration=9))
    assert abs(found.balance.surroundings) < 1e-10
    assert found.balance.friction > 0.1
    assert abs(found.balance.residual) < 1e-9


def test_friction_that_is_not_told_is_work_of_the_surroundings():
    system = without_disturbances(friction=0.2).with_settings(duration=3)
    told = certrack.energy(system).balance
    hidden = certrack.energy(in_truth(system, motors=replace(system.truth.motors, friction=0)))
    assert hidden.balance.surroundings == pytest.approx(-told.friction, abs=1e-9)


def test_the_load_of_the_motors(found):
    run, u = found.run, found.run.u
    mean = np.trapezoid(u**2, run.t) / 20
    for i in range(2):
        assert found.rms_current[i] == pytest.approx(0.5 * math.sqrt(mean), rel=1e-3)
        assert found.rms_torque[i] == pytest.approx(4 * found.rms_current[i])


def test_the_sampled_loop_is_balanced_too():
    implementation = certrack.Implementation(period=0.002, saturation=(-6, 6))
    system = SERVO.replace(implementation=implementation).with_settings(duration=9)
    found = certrack.energy(system, damping=0.05)
    assert abs(found.balance.residual) < 1e-9
    assert max(abs(found.run.u)) <= 6


def test_the_law_of_the_battery(found):
    """V i - R i^2 is the power at the terminals, at every time."""
    powers = found.powers
    out = powers["drawn"] / 48
    assert np.allclose(48 * out - 0.1 * out**2, powers["asked"], atol=1e-9)
    back = powers["returned"] / 48
    assert np.allclose(48 * back + 0.1 * back**2, 0.9 * powers["given_back"], atol=1e-9)
    assert min(powers["given_back"]) >= -1e-12


def test_cycles_of_another_length_and_none():
    found = certrack.energy(SERVO, cycle=5)
    assert [entry.end for entry in found.cycles] == [5, 10, 15, 20]
    ramp = SERVO.replace(reference=certrack.SymbolicReference("0.1*sin(t) + 0.1*sin(sqrt(2)*t)"))
    found = certrack.energy(ramp.with_settings(duration=3))
    assert found.cycle is None
    assert found.cycles == ()
    assert len(certrack.plotting.energy_figure(found, "").axes) == 2


# --- the file -------------------------------------------------------------------------------


def test_a_file_keeps_its_motors(tmp_path):
    supply = Supply("battery", voltage=48, power_limit=100)
    system = in_truth(motors=replace(MOTORS, damping="0.05"), supply=supply)
    certrack.save(system, tmp_path / "mine.toml")
    again = certrack.load(tmp_path / "mine.toml")
    assert again == system
    assert again.truth.supply.power_limit == 100
    assert motor_numbers(again).damping == 0.05


def test_an_ensemble_varies_the_share():
    member = certrack.member(SERVO, 3)
    share = motor_numbers(member).share
    assert share == float(float(dict(member.truth.constants)["split"].expr))
    assert 0.4 <= share <= 0.6
    assert share != 0.5


def refused(**changes):
    with pytest.raises(InputError) as problem:
        in_truth(motors=replace(MOTORS, **changes))
    return str(problem.value)


@pytest.mark.parametrize(
    ("changes", "key", "what"),
    [
        ({"torques": ("T_1",)}, "truth.motors.torques", "a list of 2: motor 1, motor 2"),
        ({"torques": ("T_1", "T_1")}, "truth.rates[5]", "T_2"),
        ({"torques": ("T_1", "T_3")}, "truth.rates[5]", "T_2"),
        ({"torques": ("om_1", "T_2")}, "truth.rates[3]", "T_1"),
        ({"resistance": (0, 1)}, "truth.motors.resistance[0]", "positive"),
        ({"resistance": (1, "R_2")}, "truth.motors.resistance[1]", "R_2"),
        ({"torque_per_input": (4, 0)}, "truth.motors.torque_per_input[1]", "zero"),
        ({"torque_per_input": (4, -4)}, "truth.motors.torque_per_input", "same sign"),
        ({"torque_constant": (0, 4)}, "truth.motors.torque_constant[0]", "zero"),
        ({"share": 1.5}, "truth.motors.share", "0 to 1"),
        ({"damping": -0.1}, "truth.motors.damping", "negative"),
        ({"speeds": ("om_1", "om_3")}, "truth.motors.speeds[1]", "om_3"),
        ({"stored": "J*om_1**2"}, "truth.motors.stored", "'J'"),
        ({"friction": "u"}, "truth.motors.friction", "'u'"),
    ],
)
def test_bad_motors_are_refused(changes, key, what):
    message = refused(**changes)
    assert message.startswith(f"{key}:"), message
    assert what in message


def test_u_beside_the_torques_is_refused():
    rates = [rate.text for rate in SERVO.truth.rates]
    rates[1] += " + u"
    with pytest.raises(InputError, match=r"truth\.rates: must not contain u"):
        in_truth(rates=tuple(rates))


def test_motors_need_states_and_a_supply_needs_motors():
    with pytest.raises(InputError, match=r"truth\.motors: needs truth\.states"):
        certrack.Truth(input_gain=1, motors=MOTORS)
    with pytest.raises(InputError, match=r"truth\.supply: needs truth\.motors"):
        certrack.Truth(input_gain=1, supply=Supply("battery"))


@pytest.mark.parametrize(
    ("entries", "key"),
    [
        ({"kind": "capacitor"}, "kind"),
        ({"kind": "battery", "resistance": 0.1}, "voltage"),
        ({"kind": "battery", "efficiency": 1.1}, "efficiency"),
        ({"kind": "battery", "power_limit": -1}, "power_limit"),
        ({"kind": "battery", "voltage": 0}, "voltage"),
        ({"kind": "chopper", "efficiency": 0.9}, "efficiency"),
        ({"kind": "chopper", "power_limit": 9}, "power_limit"),
    ],
)
def test_bad_supplies_are_refused(entries, key):
    with pytest.raises(InputError, match=rf"truth\.supply\.{key}: "):
        Supply(**entries)


@pytest.mark.parametrize(
    "wrong",
    [
        "J_L/2*om_L**2 + J_M*(om_1**2 + om_2**2)",  # twice the inertia
        "J_L/2*om_L**2 + J_M/2*(om_1**2 - om_2**2)",
        "J_L/2*om_L**2",
    ],
)
def test_stored_energy_that_does_not_fit_the_rates_is_refused(wrong):
    system = in_truth(motors=replace(MOTORS, stored=wrong))
    with pytest.raises(InputError, match=r"truth\.motors\.stored: does not fit truth\.rates"):
        certrack.energy(system)


def test_a_source_that_is_too_weak_is_told():
    supply = Supply("battery", voltage=12, resistance=5)
    with pytest.raises(InputError, match=r"at most V\^2/\(4 R\) = 7\.2 W"):
        certrack.energy(in_truth(supply=supply))


def test_arguments_out_of_their_limits():
    for name, value in (("share", 2), ("damping", -1), ("cycle", 0), ("cycle", 21)):
        with pytest.raises(InputError, match=rf"^{name}: "):
            certrack.energy(SERVO, **{name: value})


def test_no_motors_no_energy():
    with pytest.raises(InputError, match=r"truth\.motors: is missing"):
        certrack.energy(certrack.load("example1"))
    with pytest.raises(InputError, match=r"truth\.motors: is missing"):
        power_formulas(certrack.load("dual-motor"))


# --- what is printed ------------------------------------------------------------------------


def test_the_table_adds_up(found):
    rows = {row[0]: row[1:] for row in energy_table(found).rows}
    assert rows["= net"] == rows["= accounted for"]
    assert float(rows["drawn from the source"][0]) == pytest.approx(found.balance.drawn, rel=1e-4)


def test_many_cycles_are_the_first_and_the_last():
    found = certrack.energy(SERVO.with_settings(duration=3), cycle=0.5)
    assert len(found.cycles) == 6
    assert energy_table(found).columns[2:] == ("0 to 0.5 s", "2 to 2.5 s", "2.5 to 3 s")


@pytest.mark.slow
def test_the_command(capfd, tmp_path):
    out, folder = tmp_path / "powers.csv", tmp_path / "pictures"
    code, told, _ = invoke(
        capfd,
        *("energy", "dual-motor-physical", "--damping", "0.05"),
        *("--out", str(out), "--plot", str(folder)),
    )
    assert code == 0
    assert "saves 9.80 % of the copper loss" in told
    assert "18.67 % of what is drawn" in told
    header, first = out.read_text().splitlines()[:2]
    assert header.startswith("time_s,u,copper_1_W")
    assert float(first.split(",")[1]) == pytest.approx(-13.578, abs=1e-3)
    assert (folder / "energy.png").stat().st_size > 10_000
    data = result(capfd, "energy", "dual-motor-physical", "--damping", "0.05", "--json")
    assert data["saving_by_split"] == pytest.approx(0.098, abs=1e-4)
    assert abs(data["balance"]["residual"]) < 1e-9
    json.dumps(data)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("example1",), "example1.toml: truth.motors: is missing"),
        (("dual-motor-physical", "--share", "2"), "--share: must be at most 1"),
        (("dual-motor-physical", "--cycle", "99"), "--cycle: must fit"),
    ],
)
def test_bad_commands_exit_with_2(capfd, arguments, message):
    code, _, told = invoke(capfd, "energy", *arguments)
    assert code == 2
    assert message in told


def test_a_notebook_shows_it(found):
    assert "copper 3.5726 J" in repr(found)
    assert len(certrack.plot(found).axes) == 4


def test_motors_are_public():
    assert certrack.Motors is Motors
    assert certrack.Supply is Supply

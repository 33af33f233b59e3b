"""What ranges cost, how far they may grow, the tube over them, and the corners of an ensemble."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from depth import depth
from scipy.linalg import expm
from test_ranges import attained, random_system

import certrack
from certrack.certificates.arithmetic import rational
from certrack.certificates.ranges.boxes import closed, forbidden, scaled, with_range
from certrack.certificates.ranges.certify import attainable_error, certify_ranges
from certrack.certificates.ranges.edges import LARGEST_SCALE, largest_scale
from certrack.certificates.ranges.loop import error_form
from certrack.certificates.ranges.proofs import RangeProver
from certrack.certificates.ranges.strength import STRENGTH_ACCURACY, critical_ranges
from certrack.certificates.ranges.tube import range_tube
from certrack.cli import cli
from certrack.cli.console import to_json
from certrack.core.errors import Cancelled, InputError
from certrack.studies.drift import drift
from certrack.studies.ensembles.corners import FIRST_CORNER, Corners, ranges_of
from certrack.studies.ensembles.members import Members
from certrack.studies.norm_weights import helpful_weights, proposed_weights

Q = rational

CASES = Path(__file__).parent / "data" / "cases"
AXIS = certrack.load(str(CASES / "ranges-axis.toml"))
MOTOR = certrack.load(str(CASES / "ranges-dual-motor.toml"))


def with_ranges(system, **ranges):
    return system.replace(plant=replace(system.plant, constant_ranges=ranges))


#: The axis with its load and its viscous friction within ranges: quick, and two constants.
TWO = with_ranges(AXIS, M=["0.8*95.1089", "1.1*95.1089"], Fv=["0.7*203.5034", "1.3*203.5034"])


# boxes and edges


def test_boxes_are_scaled_about_the_nominal_values():
    loop = RangeProver(TWO).loop
    assert scaled(loop, Q(1)) == loop.box
    assert scaled(loop, Q(0)) == tuple((value, value) for value in loop.nominal)
    (low, high), _ = scaled(loop, Q("3/2"))
    M = Q("95.1089")
    assert (low, high) == (M * Q("0.7"), M * Q("1.15"))
    assert closed(loop, 0)[0] == (M, M) and closed(loop, 0)[1] == loop.box[1]


def test_a_range_that_would_cross_zero_is_forbidden():
    loop = RangeProver(AXIS).loop
    assert forbidden(loop, loop.box) == ""
    assert "plant.input_gain" in forbidden(loop, ((Q(-1), Q(200)),))
    assert "plant.input_gain" in forbidden(loop, ((Q(0), Q(200)),))


@pytest.mark.parametrize("edge", [3e-5, 0.4, 1.0, 1.7, 130.0, 2.5e7])
@pytest.mark.parametrize("known", [False, True])
def test_the_edge_is_found_from_inside(edge, known):
    tried = []

    def find(scale):
        tried.append(scale)
        return (scale,) if float(scale) <= edge else "too much"

    known = (Q(1),) if known and edge >= 1 else None
    found = largest_scale(find, known=known, accuracy=1e-3)
    assert edge / (1 + 2e-3) <= float(found.scale) <= edge and found.reason == "too much"
    assert (Q(found.scale),) == found.result  # what was found there, not near there
    assert len(tried) < 60


def test_an_edge_that_is_nowhere():
    found = largest_scale(lambda scale: True)
    assert found.unlimited and float(found.scale) == LARGEST_SCALE and found.reason == ""
    found = largest_scale(lambda scale: "never")
    assert (found.scale, found.result, found.reason) == ("0", None, "never")


# what each range costs


def test_the_cost_of_a_constant_is_the_bound_without_its_range():
    found = certify_ranges(TWO, details=True)
    ranges = {"M": ["0.8*95.1089", "1.1*95.1089"], "Fv": ["0.7*203.5034", "1.3*203.5034"]}
    assert [entry.name for entry in found.constants] == list(ranges)
    for entry in found.constants:
        others = {name: pair for name, pair in ranges.items() if name != entry.name}
        without = certify_ranges(with_ranges(TWO, **others)).best.bound
        assert entry.known == pytest.approx(without, rel=0.01)
        assert entry.known < entry.bound == found.best.bound and entry.verified
        assert entry.low < entry.nominal < entry.high
    assert certify_ranges(TWO).constants == ()


def test_a_closed_range_is_proven_like_any_other():
    """The proof for a box with one range closed is checked by the same checker."""
    prover = RangeProver(TWO)
    for k in range(2):
        box = closed(prover.loop, k)
        proof = prover.vertices(box)
        assert prover.check(proof) == "" and len(proof.points) < prover.loop.entries.count
        assert prover.check(prover.peak(box)) == ""
        wider = replace(proof, cell=proof.cell[::-1])
        assert prover.check(wider)


def test_costs_are_printed_and_in_the_json():
    run = CliRunner().invoke(cli, ["certify", str(CASES / "ranges-axis.toml")])
    assert run.exit_code == 0 and "what each range costs" in run.output
    assert "critical strength (common scale of all half widths of plant.ranges)" in run.output
    run = CliRunner().invoke(cli, ["certify", str(CASES / "ranges-axis.toml"), "--json"])
    values = json.loads(run.stdout)
    (entry,) = values["constants"]
    assert entry["name"] == "M" and entry["verified"]
    assert entry["bound_if_known"] + entry["cost"] == pytest.approx(values["best"]["bound"])
    assert values["critical_strength"]["ranges"] == pytest.approx(10 / 3, rel=2 * STRENGTH_ACCURACY)
    assert "plant.input_gain" in values["critical_strength"]["ranges_end"]
    assert values["tube"]["kind"] == "vertices"
    fast = ["certify", str(CASES / "ranges-axis.toml"), "--json", "--effort", "fast"]
    values = json.loads(CliRunner().invoke(cli, fast).stdout)
    assert values["constants"] == [] and values["critical_strength"]["ranges"] is None


def test_nothing_is_verified_where_the_truth_breaks_a_premise():
    broken = AXIS.replace(truth=replace(AXIS.truth, omega=["0", "0.2*sin(9*t)"]))
    found = certrack.certify(broken)
    assert found.contradicted and found.tube is None
    assert not any(entry.verified for entry in found.constants)
    assert not drift(broken, error=0.001).verified


# the critical strength


@pytest.mark.slow
def test_the_critical_strength_has_a_certificate():
    found = critical_ranges(RangeProver(TWO), cells=True, known=True)
    loop = RangeProver(TWO).loop
    box = scaled(loop, Q(str(found.scale)))
    ranges = {str(s): [str(a), str(b)] for s, (a, b) in zip(loop.symbols, box, strict=True)}
    assert certify_ranges(with_ranges(TWO, **ranges)).best.exists
    assert found.scale > 1 and found.reason


def test_a_range_that_stability_does_not_see_has_no_critical_strength():
    system = with_ranges(AXIS, OF=["-3.2", "-3.1"])
    found = critical_ranges(RangeProver(system), cells=True, known=True)
    assert math.isinf(found.scale) and found.reason == ""


#: Stable with the gain that the law knows, unstable a little above, stable from 1.5 times on.
GAIN_ELSEWHERE = """
[plant]
states = ["x1", "x2", "x3", "x4"]
chain = [1, 1, 1]
drift = "7621*x1 + 7759*x2 + 202.5*x3 + 68.5*x4"
input_gain = 1
gain_sign = 1
[plant.ranges]
input_gain = [2, 3]
[plant.uncertainty]
tau = [0, 0, 0, 1]
gamma = [0, 0, 0, 0]
beta = [0, 0, 0, 0.1]
[truth]
input_gain = 2.5
omega = [0, 0, 0, 0]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [2, 2, 2, 2]
[simulation]
x0 = [0, 0, 0, 0]
duration = 1
"""


def test_the_critical_strength_holds_at_every_smaller_scale():
    """Scales of [2, 3] about 1 leave out what is between: there the loop is unstable."""
    prover = RangeProver(certrack.loads(GAIN_ELSEWHERE))
    loop = prover.loop

    def rate(gain):
        M = error_form(loop, loop.entries.at((gain,))).M
        return np.linalg.eigvals(M.astype(float)).real.max()

    assert rate(Q(1)) < 0 and rate(Q(2)) < 0 and rate(Q(3)) < 0 < rate(Q("1.1"))
    assert prover.peak(loop.box) is not None
    found = critical_ranges(prover, cells=False, known=True)
    assert 0 < found.scale < 0.05
    for scale in np.linspace(0, found.scale, 9):
        ((low, high),) = scaled(loop, Q(str(scale)))
        assert low == 1 and rate(high) < 0


@pytest.mark.slow
def test_the_critical_strength_is_below_one_without_a_certificate():
    ranges = {"J_L": ["0.4*0.5", "1.6*0.5"], "K_L": ["0.6*3", "1.4*3"]}
    wide = with_ranges(MOTOR, **ranges)
    found = certify_ranges(wide, details=True)
    assert not found.best.exists and 0.8 < found.strength.scale < 1
    assert all(entry.known < math.inf for entry in found.constants)


# how far a constant may drift


@pytest.mark.parametrize("error", [0.001, pytest.param(0.0004, marks=pytest.mark.slow)])
def test_a_drift_is_certified_by_the_file_that_states_it(error):
    found = drift(AXIS, error=error)
    (entry,) = found.constants
    assert found.together is None and found.verified and found.origin == "given"
    stated = with_ranges(AXIS, M=[entry.low, entry.high])
    assert certify_ranges(stated).best.bound <= error
    assert entry.bound <= error
    assert entry.part == pytest.approx((entry.high - entry.low) / 2 / 95.1089)
    half = 1.1 * (entry.high - entry.low) / 2
    larger = with_ranges(AXIS, M=[95.1089 - half, 95.1089 + half])
    assert attainable_error(RangeProver(larger)) > error  # no proof could give much more
    assert (entry.part > 0.3) == (error == 0.001)  # the file's own


@pytest.mark.slow
def test_the_drift_of_two_constants_one_by_one_and_together():
    certified = certify_ranges(TWO).best.bound
    found = drift(TWO)
    assert found.error == 1.5 * certified and "1.5 times" in found.origin
    for entry in found.constants:
        ranges = {"M": ["0.8*95.1089", "1.1*95.1089"], "Fv": ["0.7*203.5034", "1.3*203.5034"]}
        ranges[entry.name] = [entry.low, entry.high]
        assert certify_ranges(with_ranges(TWO, **ranges)).best.bound <= found.error
    together = {name: [low, high] for name, low, high in found.together.ranges}
    assert certify_ranges(with_ranges(TWO, **together)).best.bound <= found.error
    assert found.together.scale > 1
    assert set(found.summary()["together"]["ranges"]) == {"M", "Fv"}


def test_the_file_may_state_the_admitted_error():
    limited = AXIS.replace(population=certrack.Population(limit=0.0007))
    assert (drift(limited).error, drift(limited).origin) == (0.0007, "file")
    assert drift(limited, error=0.0008).error == 0.0008


def test_constants_that_vary_get_the_smaller_drift():
    u = AXIS.plant.uncertainty
    plant = replace(AXIS.plant, uncertainty=replace(u, constants_vary=True))
    still, moving = drift(AXIS, error=0.0007), drift(AXIS.replace(plant=plant), error=0.0007)
    assert 0 < moving.constants[0].part < still.constants[0].part
    proof = RangeProver(AXIS).vertices(
        ((Q(str(moving.constants[0].low)), Q(str(moving.constants[0].high))),)
    )
    assert float(proof.bound) <= 0.0007


def test_no_range_serves_an_error_that_is_too_small():
    found = drift(TWO, error=1e-5)
    assert all(entry.low is None and entry.reason for entry in found.constants)
    assert found.together.ranges == () and "none" in repr(found)
    with pytest.raises(InputError, match="error"):
        drift(TWO, error=0)


def test_a_drift_is_refused_where_no_certificate_covers_the_ranges():
    plant = replace(TWO.plant, drift="-Fv/M*v**3")
    found = drift(TWO.replace(plant=plant))
    assert found.constants == () and "v**3 is unbounded" in found.reason
    assert drift(AXIS.replace(plant=replace(AXIS.plant, constant_ranges={}))).reason


def test_a_drift_can_be_stopped():
    stop = certrack.Cancellable()
    stop.cancel()
    with pytest.raises(Cancelled):
        drift(AXIS, progress=stop)


def test_margin_tells_the_drift(tmp_path):
    file = str(CASES / "ranges-axis.toml")
    options = ["--error", "0.001", "-n", "2", "--plot", str(tmp_path)]
    run = CliRunner().invoke(cli, ["margin", file, *options])
    assert run.exit_code == 0 and "+-60" in run.output
    assert (tmp_path / "margin-drift.png").stat().st_size > 5000
    (entry,) = json.loads(to_json(drift(AXIS, error=0.001).summary()))["constants"]
    assert entry["bound"] <= 0.001 and entry["low"] < 0.7 * 95.1089


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(3, depth(8, 40)))
def test_what_is_said_of_random_chains_is_not_beaten(seed):
    """Attained with a range closed, at the largest drift, and at the critical strength."""
    rng = np.random.default_rng([seed, 4])
    system = random_system(rng, states=3, constants=2)
    result = certify_ranges(system, details=True)
    if not result.best.exists:
        return
    prover = RangeProver(system)
    loop = prover.loop
    for k, entry in enumerate(result.constants):
        assert reached(loop, closed(loop, k)) <= entry.known <= entry.bound
    drifts = drift(system)
    for k, entry in enumerate(drifts.constants):
        box = with_range(loop, k, Q(entry.low), Q(entry.high))
        assert reached(loop, box) <= entry.bound <= drifts.error
        assert entry.low <= float(loop.nominal[k]) <= entry.high
    if not math.isinf(result.strength.scale):
        for corner in itertools.product(*scaled(loop, Q(result.strength.scale))):
            M = error_form(loop, loop.entries.at(corner)).M.astype(float)
            assert np.linalg.eigvals(M).real.max() < 0


def reached(loop, box):
    """What linear programs over references reach at the corners of a box; 0 if not linear."""
    if loop.brackets:
        return 0.0
    return max(attained(loop, corner) for corner in itertools.product(*box))


# the tube


def switched_error(system, corners, times, seed):
    """|e_1| at times of the linear loop whose constants jump between points of the box."""
    loop = RangeProver(system).loop
    rng = np.random.default_rng(seed)
    forms = [error_form(loop, loop.entries.at(corner)) for corner in corners]
    c, q = loop.coordinates, loop.coordinates.q
    Y = system.reference.values(times, q + 1)
    e = c.A.astype(float) @ system.settings.x0 - c.B.astype(float) @ Y[: q + 1, 0]
    h, errors = times[1] - times[0], [abs(e[0])]
    beta = c.A[:, -1].astype(float) * system.plant.uncertainty.beta[-1]
    steps = []
    for form in forms:
        M = form.M.astype(float)
        after = expm(h * M)
        steps.append((after, np.linalg.solve(M, after - np.eye(len(e))), form.W.astype(float)))
    for k in range(len(times) - 1):
        if k % 20 == 0:
            choice = rng.integers(len(forms))
        after, forced, W = steps[choice]
        force = W @ Y[:, k] + forms[choice].offset.astype(float)
        e = after @ e + forced @ (force + beta * np.sign(np.sin(9 * times[k])))
        errors.append(abs(e[0]))
    return np.array(errors)


@pytest.mark.parametrize(
    "x0",
    [[0, 0], *(pytest.param(x0, marks=pytest.mark.slow) for x0 in ([0.3, -1], [-0.05, 2]))],
)
def test_no_run_leaves_the_tube_whatever_the_constants_do(x0):
    system = AXIS.with_settings(x0=x0)
    prover = RangeProver(system)
    proof = prover.vertices(prover.box)
    tube = range_tube(system, proof)
    assert tube.verified and tube.floor >= float(proof.bound) ** 2 * (1 - 1e-9)
    times = np.linspace(0, 1.0, 1001)
    points = [*itertools.product(*prover.box), *[(Q(value),) for value in (80, 95, 110)]]
    ratios = [switched_error(system, points, times, seed) / tube(times) for seed in (1, 2)]
    largest = np.max(ratios)
    assert 0.05 < largest <= 1
    for corner in prover.box[0]:
        truth = replace(system.truth, constants={"M": float(corner)})
        run = certrack.simulate(system.replace(truth=truth))
        assert (np.abs(run.e[0]) <= tube(run.t)).all()
    box = [(x - 0.01, x + 0.01) for x in x0]
    assert range_tube(system, proof, box).start > tube.start


def test_the_tube_of_certify_is_that_of_vertices():
    found = certrack.certify(AXIS, effort="fast")
    assert found.tube.floor == pytest.approx(found.vertices.bound**2, rel=1e-9)
    prover = RangeProver(AXIS)
    assert found.tube == range_tube(AXIS, prover.vertices(prover.box))


# corners


def test_corners_have_their_constants_and_the_rest_of_a_member():
    members = Members(TWO, 3)
    draws = members.draws(FIRST_CORNER, FIRST_CORNER + 6)  # two more fill a register
    of_members = members.draws(0, 4)
    low, high = TWO.plant.constant_boxes["M"]
    assert draws["constants.M"].tolist() == [low, high, low, high, low, high]
    low, high = TWO.plant.constant_boxes["Fv"]
    assert draws["constants.Fv"].tolist() == [low, low, high, high, low, low]
    for name, values in draws.items():
        if not name.startswith("constants."):
            assert values[:4].tolist() == of_members[name].tolist() and values[4] == values[0]
    corner = members.corner(2)
    assert corner.title.startswith("Corner 2 (seed 3)")
    assert dict(corner.truth.constants)["M"].text and certrack.simulate(corner).outcome.name
    for wrong in (-1, 4):
        with pytest.raises(InputError, match="corner"):
            members.corner(wrong)


@pytest.mark.parametrize("method", ["lockstep", "alone"])
def test_corners_are_run_apart_from_the_members(method):
    quick = TWO.with_settings(duration=4)
    found = certrack.ensemble(quick, 3, method=method)
    assert found.members == 3 and len(found.corners.errors) == 4 and found.corners.lost == 0
    for k, error in enumerate(found.corners.errors):
        run = certrack.simulate(Members(quick, 0).corner(k))
        assert error == pytest.approx(run.metrics.tail_error, rel=1e-4)
        assert error <= found.limit
    summary = found.summary()["corners"]
    assert summary["count"] == 4 and summary["beyond"] == 0
    worst = summary["worst"]
    assert worst["tail_error"] == max(found.corners.errors)
    assert worst["constants"] == found.corners.constants[worst["corner"]]
    assert found.summary()["outcomes"] == {"finished": 3}


def test_corners_do_not_move_the_members():
    """A population that leaves the constants out: its members are as they were."""
    plain = TWO.with_settings(duration=4).replace(population=certrack.Population(theta=[0.2]))
    without = plain.replace(plant=replace(plain.plant, constant_ranges={}))
    found = certrack.ensemble(plain, 4, method="lockstep", limit=1.0)
    others = certrack.ensemble(without, 4, method="lockstep", limit=1.0)
    assert np.allclose(found.per_member()[0], others.per_member()[0], rtol=1e-9)
    assert others.corners is None and others.summary()["corners"] is None
    assert len(set(found.corners.errors)) == 4
    assert not found.member(0).truth.constants


def test_lost_corners_are_counted_and_named():
    corners = Corners(({"a": 1.0}, {"a": 2.0}), (0.1, math.inf), ("finished", "escaped"), 0.05)
    assert (corners.worst, corners.lost, corners.beyond) == (1, 1, 2)
    assert corners.summary()["worst"]["outcome"] == "escaped"
    plant = replace(
        AXIS.plant,
        drift="-Fv/M*v + OF*(M - 95.1089)*v",
        constant_ranges={"M": ["0.7*95.1089", "1.3*95.1089"]},
    )
    wild = AXIS.replace(plant=plant).with_settings(duration=20)
    found = certrack.ensemble(wild, 2, method="lockstep", limit=1.0)
    assert found.corners.lost == 1 and found.corners.outcomes.count("finished") == 1


def test_more_than_six_ranges_have_no_corners():
    ranges = {name: [f"0.99*({v.text})", f"1.01*({v.text})"] for name, v in AXIS.plant.constants}
    ranges["OF"] = ["1.01*(-3.1648)", "0.99*(-3.1648)"]
    extra = {f"z{i}": 1 for i in range(2)}
    plant = replace(AXIS.plant, constants=dict(AXIS.plant.constants) | extra)
    many = AXIS.replace(
        plant=replace(plant, constant_ranges=ranges | {z: ["0.9", "1.1"] for z in extra})
    )
    assert len(ranges_of(many)) == 7
    with pytest.raises(InputError, match="1 to 6"):
        Members(many, 0).corner(0)
    found = certrack.ensemble(many.with_settings(duration=2), 2, method="lockstep", limit=1.0)
    assert found.corners is None


def test_a_folder_keeps_its_corners(tmp_path, monkeypatch):
    quick = TWO.with_settings(duration=3)
    run = {"members": 4, "method": "lockstep", "limit": 0.01, "out": tmp_path / "runs"}
    first = certrack.ensemble(quick, **run)
    kept = {path.name: path.read_bytes() for path in (tmp_path / "runs").iterdir()}
    assert "corners.npz" in kept
    from certrack.studies.ensembles.engine import Engine

    asked, compute = [], Engine.compute
    monkeypatch.setattr(
        Engine, "compute", lambda self, a, b, t=None: asked.append(a) or compute(self, a, b, t)
    )
    again = certrack.ensemble(quick, **run)
    assert not asked and again.corners == first.corners
    assert {path.name: path.read_bytes() for path in (tmp_path / "runs").iterdir()} == kept
    path = tmp_path / "runs" / "corners.npz"
    data = kept["corners.npz"]
    middle = len(data) // 2
    flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
    for wrong in (b"", data[:-9], flipped):
        path.write_bytes(wrong)
        asked.clear()
        assert certrack.ensemble(quick, **run).corners == first.corners
        assert asked == [FIRST_CORNER] and path.read_bytes() == kept["corners.npz"]


def test_a_corner_is_replayed_by_the_command_line():
    file = str(CASES / "ranges-axis.toml")
    both = CliRunner().invoke(cli, ["simulate", file, "--corner", "0", "--member", "0"])
    assert both.exit_code == 2 and "not both" in both.output
    none = CliRunner().invoke(cli, ["simulate", file, "--corner", "2"])
    assert "corner: must be a whole number from 0 to 1" in str(none.exception)
    run = CliRunner().invoke(cli, ["ensemble", file, "-n", "2", "--json", "--limit", "1"])
    worst = json.loads(run.stdout)["corners"]["worst"]
    again = CliRunner().invoke(cli, ["simulate", file, "--corner", str(worst["corner"]), "--json"])
    assert json.loads(again.stdout)["tail_error"] == pytest.approx(worst["tail_error"], rel=1e-4)


# weights of the norm

FAST = """
[plant]
states = ["x", "v"]
chain = [1]
linear = [[0]]
drift = 0
gain_sign = 1
input_gain = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0.5]
beta = [0, 1]
[truth]
input_gain = 1
omega = [0, 0]
[reference]
signal = "0.01*sin(400*t)"
[law]
kind = "robust"
c = [40, 40]
feedforward = 1
[simulation]
x0 = [0, 0]
duration = 1
"""


def test_weights_are_proposed_and_help():
    system = certrack.loads(FAST)
    weights = proposed_weights(system)
    assert weights.S == (1.0, 0.0025) and weights.sizes == pytest.approx((0.01, 4), rel=1e-6)
    found = certrack.certify(system)
    assert found.best.bound == certrack.certify(system).best.bound  # nothing was applied
    _, bound = helpful_weights(system, found)
    u = replace(system.plant.uncertainty, S=weights.S)
    stated = system.replace(plant=replace(system.plant, uncertainty=u))
    assert certrack.certify(stated).semidefinite.bound == bound < found.semidefinite.bound
    assert proposed_weights(stated) is None
    (finding,) = [f for f in certrack.check(system).findings if f.name == "scales of states"]
    assert "S = [1, 0.0025]" in finding.remedy


def test_the_hint_is_printed_once(tmp_path):
    file = tmp_path / "fast.toml"
    file.write_text(FAST)
    run = CliRunner().invoke(cli, ["certify", str(file)])
    assert run.stderr.count("S = [1, 0.0025]") == 1 and "would then be" in run.stderr
    file.write_text(FAST.replace("400", "4"))
    assert "S = [" not in CliRunner().invoke(cli, ["certify", str(file)]).stderr
    file.write_text(FAST.replace("gamma = [0, 0.5]", "gamma = [0, 0]"))
    assert "S = [" not in CliRunner().invoke(cli, ["certify", str(file)]).stderr


def test_the_starter_file_mentions_the_weights(tmp_path):
    CliRunner().invoke(cli, ["new", str(tmp_path / "drive.toml")])
    assert "# S = " in (tmp_path / "drive.toml").read_text()

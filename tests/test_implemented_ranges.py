"""The sampled loop for constants with ranges: sound against members, tight, checked, or refused."""

import json
import math
import re
from dataclasses import replace

import flint
import independent_checker
import numpy as np
import pytest
from depth import depth
from ranged_drives import members, random_ranged_drive, worst_member
from sampled_attack import worst_error
from test_implemented import by_both, on_a_drive

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.implemented import cover, levels
from certrack.certificates.implemented import ranged as ranged_room
from certrack.certificates.implemented.certify import certify_implemented, failed_cover
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.enclosed import Enclosed
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.polytope import Polytope, common
from certrack.certificates.implemented.proof import cells_of, prove_implemented
from certrack.loops.stability import linear_loop
from certrack.model.implementation import Implementation
from certrack.studies.ensembles.error_limit import tail_error_limit
from certrack.systems.reader import loads

#: Step of a 12-bit encoder, rad.
ENCODER = 2 * math.pi / 2**12


def joint(T=0.008, **entries):
    """The flexible joint on a drive, with encoders on both shafts, and exact bounds of y_d."""
    system = certrack.load("flexible-joint")
    drive = {"period": T, "delay": 0.5, "measurement_quantum": (ENCODER, 0.0, ENCODER, 0.0)}
    return system.replace(
        reference=certrack.SymbolicReference("0.7854*sin(2*t)"),
        implementation=Implementation(**(drive | entries)),
    )


@pytest.fixture(scope="module")
def proven():
    """The joint's system, certificate and proofs."""
    system = joint()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(cover.MOST_SAMPLED_CELLS, "default", 4)
        return system, *certify_implemented(system)


def test_the_flexible_joint(proven):
    """A range of 20 % has a bound, near what members reach; one cell has more."""
    system, found, proofs = proven
    assert found.verified and found.cells == len(proofs) == 4
    attack, _ = worst_member(system, np.random.default_rng(2), 6, 0.7854, 2.0)
    assert attack < found.bound < 2 * attack
    one, _ = certify_implemented(system, effort="fast")
    assert one.cells == 1 and one.bound > 1.1 * found.bound
    assert sum(found.parts.values()) == pytest.approx(found.bound, rel=1e-5)
    limit, origin = tail_error_limit(system, None)
    assert attack < limit <= found.bound and origin == "certificate"


def test_certificate_file(proven):
    system, _, proofs = proven
    document = json.loads(json.dumps(to_document(system, *proofs)))
    verdict = verify(document)
    assert verdict.verified and float(verdict.bound) == max(float(p.bound) for p in proofs)
    one, proofs = certify_implemented(system, effort="fast")
    document = json.loads(json.dumps(to_document(system, *proofs)))
    assert float(independent_checker.check(document)) <= one.bound
    wrong = to_document(system, replace(proofs[0], bound=shorter(proofs[0].bound, 0.99)))
    with pytest.raises(independent_checker.Refused):
        independent_checker.check(json.loads(json.dumps(wrong)))


@pytest.mark.slow
def test_another_checker_agrees_on_cells(proven):
    system, found, proofs = proven
    document = json.loads(json.dumps(to_document(system, *proofs)))
    assert float(independent_checker.check(document)) <= found.bound
    lower = edited(proofs, 0, bound=shorter(proofs[0].bound, 0.98))  # its own is up to 1 % lower
    mutants = (MUTANTS[name](proofs) for name in ("channel", "a cell less", "another cell"))
    for mutant in (lower, *mutants):
        wrong = to_document(system, *mutant)
        with pytest.raises(independent_checker.Refused):
            independent_checker.check(json.loads(json.dumps(wrong)))


def edited(proofs, i, **changes):
    return (*proofs[:i], replace(proofs[i], **changes), *proofs[i + 1 :])


def shorter(text, part):
    return f"{float(text) * part:.12g}"


MUTANTS = {
    # the first cell is the worst one
    "bound": lambda p: edited(p, 0, bound=shorter(p[0].bound, 0.9999)),
    "state": lambda p: edited(p, 0, states=(shorter(p[0].states[0], 0.99), *p[0].states[1:])),
    "channel": lambda p: edited(p, 0, states=(*p[0].states[:-1], shorter(p[0].states[-1], 0.99))),
    "no channel": lambda p: edited(p, 0, states=p[0].states[:-1]),
    "a cell less": lambda p: p[1:],
    "a gap": lambda p: edited(p, 0, cell=((p[0].cell[0][0], "0.7919"),)),
    "another cell": lambda p: edited(p, 0, cell=p[-1].cell),
    "a wider cell": lambda p: edited(p, 0, cell=(("19796/25000", "29694/25000"),)),
    "no cell": lambda p: edited(p, 0, cell=()),
    "two constants": lambda p: edited(p, 0, cell=p[0].cell * 2),
    "fewer periods": lambda p: edited(p, 0, doublings=2),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutated_cells_are_refused(proven, mutant):
    system, _, proofs = proven
    assert failed_cover(system, MUTANTS[mutant](proofs)) != ""


def test_malformed_cells_are_no_certificate(proven):
    system, _, proofs = proven
    document = json.loads(json.dumps(to_document(system, *proofs)))
    for wrong in ([["1", "0"]], [["a", "b"]], "x", [["1/0", "2"]]):
        entries = [document["proof"][0] | {"cell": wrong}, *document["proof"][1:]]
        with pytest.raises(certrack.InputError):
            verify(document | {"proof": entries})


def test_the_plant_of_a_cell_is_that_of_its_members():
    """Centre and channels at delta = -1, 1 against the loop of a member, period by period."""
    rng = np.random.default_rng(7)
    for _ in range(4):
        system, _, _ = random_ranged_drive(rng)
        plant = ranged_room.RangedPlant(system)
        for member, values in members(system, rng, 2):
            point = tuple((flint.fmpq(*v.as_integer_ratio()),) * 2 for v in values.values())
            drive = plant.drive(point)
            assert not drive.channels
            with flint.ctx.workprec(DRIVE_BITS):
                M = Enclosed.of(one_period(drive, cells_of(drive)).map).value
            radius = float(np.abs(np.linalg.eigvals(M)).max())
            T, delay = member.implementation.period, member.implementation.delay
            assert radius == pytest.approx(linear_loop(member).radius(T, delay), rel=1e-6)


def attacked_members(seed, count, tried):
    rng, ratios = np.random.default_rng(seed), []
    for _ in range(count):
        system, amplitude, frequency = random_ranged_drive(rng)
        found, _ = certify_implemented(system)
        if not found.exists:
            assert "cells of plant.ranges" in found.reason, found.reason
            continue
        error, values = worst_member(system, rng, tried, amplitude, frequency)
        ratios.append(found.bound / error)
        assert ratios[-1] >= 1, (seed, values)
    return ratios


def test_no_member_beats_the_bound():
    assert np.median(attacked_members(3, 1, 4)) < 2


@pytest.mark.slow
@pytest.mark.search
@pytest.mark.parametrize("seed", range(depth(1, 12)))
def test_no_member_beats_the_bound_of_many_loops(seed):
    assert np.median(attacked_members(200 + seed, 8, 8)) < 2


def softest():
    """The joint with its least stiffness: the cell of that point, and what an attack reaches."""
    system = joint()
    (low, _), *_ = ranged_room.RangedPlant(system).box
    member = system.replace(truth=replace(system.truth, constants=(("c0", "19796/25000"),)))
    return system, ((low, low),), worst_error(member, 0.7854, 2.0)


def bound_of(system, cell):
    plant = ranged_room.RangedPlant(system)
    return float(cover._size(prove_implemented(system, flint.fmpq(1, 2), cell, plant)))


def test_a_forgotten_channel_is_beaten_by_a_member(monkeypatch):
    """Without what the ranges add, the bound is that of the cell's centre."""
    system, point, attack = softest()
    assert attack < bound_of(system, point) < 1.5 * attack
    honest = ranged_room.RangedPlant.drive

    def centre(self, cell, delay=None):
        return honest(self, tuple(((low + high) / 2,) * 2 for low, high in cell), delay)

    monkeypatch.setattr(ranged_room.RangedPlant, "drive", centre)
    assert bound_of(system, ranged_room.RangedPlant(system).box) < attack


def test_constants_that_vary_need_one_cell():
    system = joint()
    varying = replace(system.plant.uncertainty, constants_vary=True)
    system = system.replace(plant=replace(system.plant, uncertainty=varying))
    found, proofs = certify_implemented(system)
    assert found.verified and found.cells == 1
    standing, many = certify_implemented(joint())
    assert standing.bound < found.bound
    assert "one cell" in failed_cover(system, many)
    assert failed_cover(system, proofs) == ""


def test_a_drive_with_limits_and_ranges():
    """What is proven from a start is proven for every cell."""
    wide = joint(0.01, saturation=(-60.0, 60.0))
    found, proofs = certify_implemented(wide, effort="fast")
    assert found.verified and found.saturation == "inactive" and found.peaks.input < 60
    assert failed_cover(wide, proofs) == ""
    tight = joint(0.01, saturation=(-4.0, 4.0))
    found, _ = certify_implemented(tight, effort="fast")
    assert not found.verified and "limits" in found.reason


def test_refusals_name_the_cell():
    system = joint(0.03)
    found, proofs = certify_implemented(system)
    assert not found.exists and not proofs
    assert "the nominal ones: the sampled loop is unstable" in found.reason
    lost = cover._lost_corner(ranged_room.RangedPlant(joint(0.018)), cover.rational(0.5))
    assert lost.startswith("at c0 = 0.79184 the sampled loop is unstable")
    assert not cover._lost_corner(ranged_room.RangedPlant(joint()), cover.rational(0.5))
    nonlinear = replace(system.plant, drift="-Beff/Jeq*j - c0/Jeq*(a-10*phi) + (c0-0.9898)*sin(a)")
    found, _ = certify_implemented(joint().replace(plant=nonlinear))
    assert "linear" in found.reason


def two_masses(half=0.3):
    """A motor and a load on a shaft; of 30 % one cell has no bound."""
    return loads(TWO_MASSES.replace('"0.7*', f'"{1 - half}*').replace('"1.3*', f'"{1 + half}*'))


TWO_MASSES = """
[plant]
states = ["q", "v", "twist", "rate"]
chain = [1, "K/JL", 1]
drift = "-b/JM*(v + rate) - (1/JM + 1/JL)*(K*twist + D*rate)"
input_gain = "1/JM"
gain_sign = 1
[plant.constants]
JM = 0.0008
JL = 0.0012
K = 35
D = 0.02
b = 0.003
[plant.ranges]
K = ["0.7*35", "1.3*35"]
JL = ["0.7*0.0012", "1.3*0.0012"]
[plant.uncertainty]
tau = [0, 1, 0, 1]
gamma = [0, 0, 0, 0]
beta = [0, 0, 0, 12.5]
Delta = [[0, 0, 0, 0], [0, 0, 0, "D/0.00084"], [0, 0, 0, 0], [0, 0, 0, 0]]
[truth]
input_gain = "1/JM"
omega = [0, "D/JL*rate", 0, "12*sin(30*t)"]
[reference]
signal = "0.5*sin(2*t)"
[law]
kind = "robust"
c = [60, 60, 250, 250]
coupling = 0.5
feedforward = 3
[simulation]
x0 = [0, 0, 0, 0]
duration = 4
[implementation]
period = 0.00025
delay = 0.5
measurement_quantum = [1.0e-5, 0, 2.0e-5, 0]
"""


@pytest.mark.slow
def test_a_refusal_blames_the_ranges_where_they_are_the_cause(monkeypatch):
    """And what it offers helps: cells have a bound, and so have the narrower ranges in one cell."""
    found, _ = certify_implemented(two_masses(), effort="fast")
    assert not found.exists and "--effort default" in found.reason
    assert "gamma" not in found.reason and "uncertain terms" not in found.reason
    (share,) = re.findall(r"with (\d+) % of their widths", found.reason)
    half = 0.3 * int(share) / 100
    narrow = two_masses(half=half)
    assert certify_implemented(narrow, effort="fast")[0].verified
    monkeypatch.setitem(cover.MOST_SAMPLED_CELLS, "default", 16)
    assert certify_implemented(two_masses())[0].verified


def test_a_refusal_blames_the_growth_where_that_is_the_cause():
    """With the nominal constants, too, nothing is proven."""
    system = two_masses()
    strong = replace(system.plant.uncertainty, gamma=(0.0, 0.0, 0.0, 400.0))
    found, _ = certify_implemented(
        system.replace(plant=replace(system.plant, uncertainty=strong)), effort="fast"
    )
    assert "nominal" in found.reason and "lower gamma" in found.reason


def test_the_region_of_several_polytopes_is_in_all_of_theirs():
    names = ("a", "b")
    one = Polytope(np.zeros((0, 2)), np.zeros(0), ((-1.0, 1.0), (-2.0, 2.0)), names)
    two = Polytope(np.zeros((0, 2)), np.zeros(0), ((-3.0, 0.5), (-1.0, 4.0)), names)
    assert common([one, two]).region == ((-1.0, 0.5), (-1.0, 2.0))


# Levels -------------------------------------------------------------------------------------------


def test_levels_help_away_from_the_nominal_constants(monkeypatch):
    """Where the plant is not the law's, all derivatives cancelled give twice the bound.

    The file's bounds of y_d are wide: what is cancelled and what y_d^(4) drives do not add up.
    """
    system, point, attack = softest()
    system = system.replace(reference=certrack.load("flexible-joint").reference)
    bound = bound_of(system, point)
    monkeypatch.setattr(levels, "levels_of", lambda _: [])
    assert bound_of(system, point) > 2 * bound > 2 * attack


def test_a_level_of_all_derivatives_is_the_steady_motion():
    """D of the loop's own motion is zero; level 0 has the desired states."""
    system = on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"))
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive_of(system), (1, 2))
        own = levels._level_of(period, period.Pi, 0)
        for D in own.residual:
            assert Enclosed.of(D).upper.max() < 1e-60
        zero, *_ = levels.levels_of(period)
        x_d = Enclosed.of(period.drive.desired).value
        for Pi in zero.Pi:
            assert Enclosed.of(Pi).value[:4] == pytest.approx(x_d)
        last = period.jump * zero.Pi[-1]
        for j in range(2):
            for i in range(period.size):
                last[i, j] = last[i, j] + period.reference[i, j] - zero.Pi[0][i, j]
        assert Enclosed.of(last).upper.max() < 1e-60  # a jump leaves nothing


def wrong_residual(monkeypatch):
    """What the loop does not obey is forgotten."""
    honest = levels._level_of

    def without(period, wanted, s):
        level = honest(period, wanted, s)
        return replace(level, residual=tuple(D * flint.arb(0) for D in level.residual))

    monkeypatch.setattr(levels, "_level_of", without)


def test_a_forgotten_residual_is_beaten_by_the_attack(monkeypatch):
    system, point, attack = softest()
    assert attack < bound_of(system, point)
    wrong_residual(monkeypatch)
    assert bound_of(system, point) < attack


@pytest.mark.slow
@pytest.mark.search
def test_another_checker_agrees_on_random_loops():
    rng, held = np.random.default_rng(21), 0
    for _ in range(depth(4, 40)):
        system, _, _ = random_ranged_drive(rng)
        if certify_implemented(system)[0].exists:
            by_both(system)
            held += 1
    assert held > 2


# Sampling margins ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_sampling_margins_are_proven():
    """The slowest and the fastest period serve; a little slower does not."""
    system = on_a_drive("dual-motor-lean", 0.01, ("x2", "x4"))
    found, _ = certify_implemented(system, margins=True)
    margins, drive = found.margins, system.implementation
    assert margins.bound == pytest.approx(2 * found.bound, rel=1e-9)
    assert 0.02 < margins.slowest < 0.03 and margins.fastest == 0.00125
    assert margins.faster_untried and not margins.slower_untried
    for period, serves in ((margins.slowest, True), (1.05 * margins.slowest, False)):
        other = system.replace(implementation=replace(drive, period=period))
        assert (certify_implemented(other)[0].bound <= margins.bound) is serves


@pytest.mark.parametrize("r", [0.0, 1.0])
def test_a_linear_law_without_a_share_of_the_last_derivative(r):
    """What the gain's range makes of the input is no quotient by that share."""
    system, *_ = random_ranged_drive(np.random.default_rng(4))
    K = tuple(map(float, system.controller.coordinates.nu_x))
    law = certrack.laws.Linear(K=K, r=r, feedforward=system.law.feedforward)
    found, _ = certify_implemented(system.replace(law=law), effort="fast")
    assert found.exists

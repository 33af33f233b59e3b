"""The critical strength: right at any size of tau, never below the published one."""

import json
import math
from dataclasses import replace

import pytest
from click.testing import CliRunner

import certrack
from certrack.certificates import certify, certify_semidefinite
from certrack.certificates.arithmetic import rational
from certrack.certificates.formulation import error_problem
from certrack.certificates.published import critical_strength
from certrack.certificates.strength import (
    _holds_as_published,
    _limit,
    _provable,
    critical_semidefinite,
)
from certrack.cli import cli
from certrack.laws import Robust
from certrack.model.plant import Plant
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references import SymbolicReference
from certrack.systems.system import Settings, System

#: A design of finite k and p whose uncertainty is tiny: order 2, adaptive law, steep regressor.
TINY = """
[plant]
states = ["x1", "x2"]
chain = [1]
linear = [[0]]
drift = 0
regressor = ["16/(1 + exp(-400*(x1 - 0.06)))"]
gain_sign = 1
[plant.uncertainty]
tau = [0.0001, 0.0001]
gamma = [0.01, 0.01]
beta = [0, 0]
[truth]
input_gain = 1
theta = [1]
[reference]
signal = "0.1*sin(0.01*t)"
[law]
kind = "adaptive"
c = [0.5, 0.5]
k = [[50, 50], [50, 50, 50, 50]]
p = [1]
gain_rate = 0.05
leak_gain = 2
leak_theta = 1
delta0 = 1
theta0 = [0]
Gamma = [0.02]
[simulation]
x0 = [0, 0]
duration = 1
"""

DECADES = range(-5, 6)


def scaled(system, factor):
    """The system with tau times `factor`."""
    u = system.plant.uncertainty
    stronger = Uncertainty(tuple(factor * v for v in u.tau), u.gamma, u.beta)
    plant = replace(system.plant, uncertainty=stronger)
    return system.replace(plant=plant, truth=replace(system.truth, tau=None))


def named(name):
    return certrack.loads(TINY) if name == "tiny" else certrack.load(name)


@pytest.mark.parametrize("name", ["example1", "dual-motor", "dual-motor-lean", "tiny"])
def test_the_product_of_scale_and_tau_is_the_same_over_ten_decades(name):
    system = named(name)
    at_one = critical_semidefinite(system)
    assert 1e-3 < at_one < 1e9
    for decade in DECADES:
        stronger = scaled(system, 10.0**decade)
        assert critical_semidefinite(stronger) * 10.0**decade == pytest.approx(at_one, rel=1e-9)
        published = critical_strength(stronger) * 10.0**decade
        assert published == pytest.approx(critical_strength(system), rel=1e-9)


@pytest.mark.parametrize("name", ["example1", "dual-motor", "tiny"])
@pytest.mark.parametrize("decade", DECADES)
def test_it_is_not_below_the_published_one(name, decade):
    system = scaled(named(name), 10.0**decade)
    certified, _ = certify_semidefinite(system)
    published = critical_strength(system)
    assert critical_semidefinite(system, certified) >= published > 0
    if certified.verified:
        assert critical_semidefinite(system, certified) >= 1


@pytest.mark.parametrize("name", ["example1", "dual-motor", "tiny"])
def test_the_designs_own_multipliers_prove_the_published_strength_and_no_more(name):
    system = named(name)
    exact, published = error_problem(system, rational), critical_strength(system)
    assert _holds_as_published(system, exact, published)
    terms = published / critical_strength(scaled(system, 2.0))
    assert terms == pytest.approx(2, rel=1e-9)
    u = system.plant.uncertainty
    assert not _holds_as_published(system, exact, 1e3 * published), u


@pytest.mark.parametrize("name", ["example1", "dual-motor", "tiny"])
def test_it_is_not_above_what_makes_an_admissible_loop_unstable(name):
    """w_k = s x_k moves the trace; where it is positive, the error system has no certificate."""
    system = named(name)
    exact = error_problem(system, rational)
    problem = exact.in_floats()
    limit = _limit(exact)
    assert critical_semidefinite(system) < limit

    def trace(scale):
        worst = -math.inf
        for i, k in enumerate(problem.states[0]):
            for sign in (1, -1):
                loop = problem.M + sign * scale * problem.Ua[:, [i]] @ problem.Xe[[k]]
                worst = max(worst, loop.trace())
        return worst

    assert trace(0.999 * limit) < 0 < trace(1.001 * limit)


@pytest.mark.parametrize("name", ["example1", "dual-motor", "tiny"])
def test_a_little_below_there_is_a_certificate_and_above_there_is_none(name):
    system = named(name)
    edge = critical_semidefinite(system)
    assert certify_semidefinite(scaled(system, 0.97 * edge))[0].verified
    assert not certify_semidefinite(scaled(system, 1.03 * edge))[0].exists


def test_the_exact_strength_of_a_first_order_loop():
    """x' = -c x + tau gamma a, |a| <= |x|: certified exactly up to tau gamma = c."""
    plant = Plant(states=["x1"], input_gain=1, uncertainty=Uncertainty([1e-7], [0.5], [0.1]))
    system = System(plant, Robust(c=[3.0]), SymbolicReference("0"), Truth(1), Settings([0], 1))
    edge = critical_semidefinite(system)
    assert 0.998 * 6e7 < edge <= 6e7


@pytest.mark.parametrize("decade", range(-6, 1))
def test_the_program_is_solved_far_below_the_edge(decade):
    """There the leakage's cost, a power of the scale, used to be all that the solver saw."""
    exact = error_problem(certrack.load("example1"), rational)
    assert _provable(exact, 10.0**decade, math.inf)


def test_without_a_part_that_grows_with_the_state_it_is_unlimited():
    plant = Plant(states=["x1"], input_gain=1, uncertainty=Uncertainty([1.0], [0], [0.1]))
    system = System(plant, Robust(c=[3.0]), SymbolicReference("0"), Truth(1), Settings([0], 1))
    assert math.isinf(certify(system).critical_semidefinite)


def test_a_large_strength_is_printed_as_the_number_it_is():
    """Beyond 1e9, where the search once ended with "inf"."""
    system = scaled(certrack.load("dual-motor-lean"), 1e-9)
    assert critical_semidefinite(system) == pytest.approx(8.9e10, rel=0.01)


def test_the_command_line_prints_them_rounded_down():
    done = CliRunner().invoke(cli, ["certify", "example1"])
    assert "published 4.2966, semidefinite 13.8" in done.output
    told = json.loads(CliRunner().invoke(cli, ["certify", "example1", "--json"]).output)
    strengths = told["critical_strength"]
    assert strengths["published"] == pytest.approx(4.29660661, rel=1e-8)
    assert strengths["semidefinite"] >= 13.8

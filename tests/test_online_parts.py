"""Parts of the certificate of moving gains and of the rules that move them, one by one."""

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from test_online import RULE, SYSTEMS, adaptive, robust

import certrack
from certrack.certificates.adaptation import Adaptation
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import from_text, root_up
from certrack.certificates.formulation import error_problem
from certrack.certificates.online import certify as room
from certrack.certificates.online.adaptation import moving_adaptation
from certrack.certificates.online.certify import OnlineProof, certify_online, failed_online
from certrack.certificates.online.ends import _with_inputs_of_both, end_problems
from certrack.certificates.online.rates import (
    RateProgram,
    RateSolution,
    prove_rates,
    rate_inequalities,
    squared_rate_bound,
)
from certrack.certificates.online.tube import online_tube
from certrack.certificates.semidefinite import SemidefiniteProgram
from certrack.certificates.stated import first_end_system, other_end_system
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.laws.online import LEVEL, Online, _is_diagonal, other_end, within_unit

RATE = 2.0
SOLUTION = RateSolution(1.0, (), (), (), 0.5)


@pytest.fixture(scope="module")
def moving():
    """A system with a bounded speed, its two problems, and its proof."""
    system = robust(rate=RATE)
    _, (proof,) = certify_online(system)
    return system, end_problems(system), proof


# The inequalities of a bounded speed --------------------------------------------------------------


def test_the_inequalities_add_up_to_that_of_the_mean(moving):
    """(w_0 + w_1)^2 = 1: what V' is at level w is a mean of the three, for both signs of w'."""
    problems = [problem.in_floats() for problem in moving[1]]
    rng, n, alpha = np.random.default_rng(0), 4, 0.7
    P = [(m + m.T) for m in rng.normal(size=(2, n, n))]
    multipliers = [tuple(rng.uniform(size=c) for c in problems[0].counts) for _ in range(2)]
    forms = list(rate_inequalities(problems, P, multipliers, alpha, RATE))
    assert len(forms) == 6
    for w in (0.0, 0.3, 0.5, 1.0):

        def mean(values, w=w):
            return (1 - w) * values[0] + w * values[1]

        parts = ("M", "Ua", "Ub", "Uy")
        between = replace(
            problems[0], **{p: mean([getattr(end, p) for end in problems]) for p in parts}
        )
        groups = [mean(group) for group in zip(*multipliers, strict=True)]
        expected = between.inequality(mean(P), *groups, alpha)
        for speed, (first, last, crossed) in zip(
            (RATE, -RATE), (forms[:3], forms[3:]), strict=True
        ):
            whole = expected.copy()
            whole[:n, :n] += speed * (P[1] - P[0]) / 2
            sums = (1 - w) ** 2 * first + w**2 * last + w * (1 - w) * crossed
            np.testing.assert_allclose(sums, whole, rtol=1e-12, atol=1e-12)


def test_ends_that_are_the_same_need_nothing_for_their_speed():
    """Then P_0 = P_1 is best, and the optimum is that of gains that stand still."""
    problem = error_problem(first_end_system(robust()), rational).in_floats()
    still = SemidefiniteProgram(problem)
    program = RateProgram([problem, problem], 3.0)
    assert program.fastest == pytest.approx(still.fastest, rel=1e-12)
    for part in (0.1, 0.4):
        alpha = part * still.fastest
        one, both = still.solve(alpha), program.solve(alpha)
        assert both.alpha == alpha
        assert both.bound == pytest.approx(one.bound, rel=1e-5)
        assert both.delta == pytest.approx(one.delta, rel=1e-5)


def test_the_solver_says_nothing_where_results_are_printed(moving, capfd):
    assert RateProgram([problem.in_floats() for problem in moving[1]], RATE).solve(0.4) is not None
    assert capfd.readouterr() == ("", "")


def test_a_higher_speed_costs_more_in_every_unit(moving):
    """The same optimum whatever the unit of time is scaled by, and a larger one for larger v."""
    problems = [problem.in_floats() for problem in moving[1]]
    bounds = [RateProgram(problems, v).solve(0.4).bound for v in (0.0, 0.5, 2.0, 8.0)]
    assert sorted(bounds) == bounds
    assert bounds[0] < 0.99 * bounds[-1]


def test_what_the_program_finds_is_what_is_proven(moving):
    system, problems, _ = moving
    solution = RateProgram([p.in_floats() for p in problems], RATE).solve(0.4)
    proofs = prove_rates(problems, solution, rational(RATE))
    assert float(proofs[0].bound) == pytest.approx(solution.bound, rel=1e-5)
    assert float(proofs[0].bound) >= solution.bound * (1 - 1e-6)
    assert {proof.alpha for proof in proofs} == {proofs[0].alpha}
    assert failed_online(system, OnlineProof(proofs[0].bound, proofs)) == ""
    worse = replace(solution, P=tuple(0.5 * P for P in solution.P))
    assert prove_rates(problems, worse, rational(RATE)) is None


def squared(moving, change):
    _, problems, proof = moving
    return squared_rate_bound(problems, [change(end) for end in proof.ends], rational(RATE))


def test_the_bound_is_that_of_the_dearer_end(moving):
    """2 max(Delta_0, Delta_1)/alpha, and the printed bound is not one digit below its root."""
    system, problems, proof = moving
    deltas = [sum(Fraction(v) for v in (*end.nu, *end.k)) for end in proof.ends]
    square = squared_rate_bound(problems, proof.ends, rational(RATE))
    assert Fraction(int(square.p), int(square.q)) == 2 * max(deltas) / Fraction(proof.ends[0].alpha)
    assert deltas[0] != deltas[1]
    assert proof.bound == root_up(square)
    digits, exponent = proof.bound.split("e")
    less = f"{int(digits) - 1}e{exponent}"
    assert from_text(less) ** 2 < square
    ends = tuple(replace(end, bound=less) for end in proof.ends)
    assert "smaller than what" in failed_online(system, OnlineProof(less, ends))
    negative = OnlineProof(
        f"-{proof.bound}", tuple(replace(e, bound=f"-{proof.bound}") for e in ends)
    )
    assert "smaller than what" in failed_online(system, negative)


def test_an_alpha_of_zero_bounds_nothing(moving):
    assert squared(moving, lambda end: replace(end, alpha="0")) is None
    assert squared(moving, lambda end: replace(end, alpha="-0.001")) is None


def test_ends_with_a_rate_of_their_own_are_refused(moving):
    _, problems, proof = moving
    first, other = proof.ends
    slower = replace(other, alpha=str(0.5 * float(other.alpha)))
    assert squared_rate_bound(problems, [first, slower], rational(RATE)) is None
    assert squared_rate_bound(problems, [replace(first, alpha=slower.alpha), other], RATE) is None


def test_a_multiplier_of_zero_is_none_below_zero(moving):
    """Where the reference does not act, its multipliers are free as long as they are positive."""
    _, problems, proof = moving
    problems = [replace(p, Uy=0 * p.Uy, Xy=0 * p.Xy) for p in problems]
    for zero, holds in (("1e-30", True), ("-1e-30", False)):
        ends = [replace(end, k=(zero,) * len(end.k)) for end in proof.ends]
        assert (squared_rate_bound(problems, ends, rational(RATE)) is not None) == holds


@pytest.mark.parametrize("rows", [(), (("1",),), (("1", "0"), ("0",)), (("1", "0"),)])
def test_a_P_of_another_shape_is_refused(moving, rows):
    assert squared(moving, lambda end: replace(end, P=rows)) is None


def test_P_must_be_above_its_floor(moving):
    """P >= e_1 e_1^T is what makes sqrt(2 V) a bound of e_1; scaled, all the rest still holds."""
    _, problems, proof = moving
    for factor, holds in ((1.0, True), (0.8, False)):
        ends = [
            replace(
                end,
                P=tuple(tuple(str(factor * float(v)) for v in row) for row in end.P),
                lam=tuple(str(factor * float(v)) for v in end.lam),
            )
            for end in proof.ends
        ]
        assert (squared_rate_bound(problems, ends, rational(RATE)) is not None) == holds


# The search ---------------------------------------------------------------------------------------


def test_smaller_rates_are_tried_where_the_best_leaves_no_room(monkeypatch):
    """The best itself first, then parts of it, and the first that is proven counts."""
    best, asked = replace(SOLUTION, alpha=2.0), []

    def solve(alpha):
        asked.append(alpha)
        return None if alpha == 0.95 * 2.0 else replace(best, alpha=alpha)

    program = SimpleNamespace(solve=solve)
    monkeypatch.setattr(room, "best_solution", lambda _: best)
    seen = []

    def prove(solution):
        seen.append(solution.alpha)
        return ("proof",) if solution.alpha < 1.6 else None

    assert room._first_proven(program, prove) == ("proof",)
    assert asked == [0.95 * 2.0, 0.85 * 2.0, 0.7 * 2.0]
    assert seen == [2.0, 0.85 * 2.0, 0.7 * 2.0]
    assert room._first_proven(program, lambda _: None) is None
    monkeypatch.setattr(room, "best_solution", lambda _: None)
    assert room._first_proven(program, prove) is None


def test_the_bound_of_a_solution_is_the_root_of_twice_delta_over_alpha():
    assert replace(SOLUTION, alpha=4.0, delta=2.0).bound == 1.0
    assert replace(SOLUTION, alpha=4.0, delta=-1e-12).bound == 0.0


def test_ends_too_far_apart_say_what_to_do():
    found, proof = certify_online(robust(slow=1.0, fast=40.0))
    assert (found.exists, proof) == (False, ())
    assert "state law.online.rate" in found.reason


# Update laws --------------------------------------------------------------------------------------


def laws(gain_rate, leak_gain, leak_theta, *Gamma):
    r = len(Gamma)
    matrix = np.zeros((r, r), dtype=object) + rational(0)
    for i, v in enumerate(Gamma):
        matrix[i, i] = rational(v)
    return Adaptation(
        gain_rate=rational(gain_rate),
        leak_gain=rational(leak_gain),
        leak_theta=rational(leak_theta),
        Gamma=matrix,
        gains=(rational("1.5"), rational("2.5")),
        delta0=rational("0.4"),
        gain_sign=1,
        theta0=np.array([rational(2)] * r, dtype=object),
        theta_box=((rational(1), rational(3)),) * r,
    )


def test_each_number_of_the_update_laws_is_taken_at_its_worse_end():
    """gbar and Gamma fall relatively by at most v |step|/smallest, the largest of all entries."""
    one, two = laws("2", "0.7", "0.3", "1", "4", "6"), laws("5", "0.4", "0.9", "3", "4", "2")
    for first, other in ((one, two), (two, one)):
        found = moving_adaptation(first, other, rational("0.1"))
        assert found.gain_rate == rational(2)
        assert (found.leak_gain, found.leak_theta) == (rational("0.4"), rational("0.3"))
        assert found.largest_leaks == (rational("0.7"), rational("0.9"))
        assert np.diag(found.Gamma).tolist() == [rational(1), rational(4), rational(2)]
        assert found.falls == (rational("0.15"), rational("0.2"))
        assert (found.gains, found.delta0) == (one.gains, one.delta0)
    assert np.diag(one.Gamma).tolist() == [rational(1), rational(4), rational(6)]  # as it was
    assert np.diag(two.Gamma).tolist() == [rational(3), rational(4), rational(2)]


def test_numbers_that_stay_need_no_speed():
    same = laws("2", "0.7", "0.3", "1")
    found = moving_adaptation(same, replace(same, leak_gain=rational("0.9")), None)
    assert found.falls == (0, 0)
    assert found.gain_rate == rational(2)
    alpha = rational("0.2")
    assert moving_adaptation(same, same, None).leakage_cost(alpha) == same.leakage_cost(alpha)


def test_the_cost_of_moving_leaks_is_that_of_the_dearer_end_of_each():
    one, two = laws("2", "0.7", "0.3", "1"), laws("2", "0.4", "0.9", "1")
    moving, alpha = moving_adaptation(one, two, None), rational("0.2")
    costs = [
        laws("2", a, b, "1").leakage_cost(alpha) for a in ("0.7", "0.4") for b in ("0.3", "0.9")
    ]
    assert moving.leakage_cost(alpha) == max(costs)
    assert moving.leakage_cost(rational(4)) is None  # more than a leakage allows
    floats = moving.in_floats()
    assert floats.leakage_cost(0.2) == pytest.approx(float(max(costs)), rel=1e-12)
    assert all(isinstance(v, float) for v in (*floats.largest_leaks, *floats.falls))


def test_falling_gains_cost_as_much_as_a_faster_rate():
    one, two = laws("2", "0.7", "0.6", "1"), laws("3", "0.7", "0.6", "1")
    moving, v, alpha = (
        moving_adaptation(one, two, rational("0.1")),
        rational("0.05"),
        rational("0.2"),
    )
    assert moving.falls == (v, 0)
    expected = one._cost_of_gain(alpha + v, one.leak_gain) + one._cost_of_theta(
        alpha, one.leak_theta
    )
    assert moving.leakage_cost(alpha) == expected


# The tube -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_tube_begins_at_the_larger_energy_of_both_ends(name):
    """2 V(0) with V from the law's own coordinates: A of either end, estimates at either end."""
    system = SYSTEMS[name]
    _, (proof,) = certify_online(system)
    tube = online_tube(system, proof)
    plant, first = system.plant, first_end_system(system)
    design = first.controller.coordinates
    A, B = design.A, design.B
    x = np.array(system.settings.x0)
    Y = system.reference.values(np.array([0.0]), design.q)[:, 0]
    e = A @ x - B @ Y
    energies = []
    for stage in proof.ends:
        P = np.array(stage.P, dtype=float)
        if len(proof.ends) == 2:
            e_here = np.linalg.solve(A, e)
            energies.append(e_here @ P @ e_here)
        else:
            problem = end_problems(system)[0]
            values = np.array(first.estimates, dtype=float)
            estimates = np.array([rational(v) for v in values], dtype=object)
            energies.append(e @ P @ e + 2 * P[-1, -1] * float(problem.adaptation.energy(estimates)))
    assert plant.n == len(e)
    assert tube.start == pytest.approx(max(energies), rel=1e-6)
    assert tube.start >= max(energies)
    assert tube.floor == pytest.approx(float(proof.bound) ** 2, rel=1e-11)
    assert tube.floor >= float(proof.bound) ** 2
    assert tube.alpha == pytest.approx(float(proof.ends[0].alpha), rel=1e-15)
    assert rational(tube.alpha) <= from_text(proof.ends[0].alpha)
    assert tube.verified
    wider = online_tube(system, proof, [(v - 0.1, v + 0.1) for v in x])
    assert wider.start > tube.start


# Ends of the gains --------------------------------------------------------------------------------


def controlled(system, change):
    """The system with a law whose equations `change` alters where the gains move."""
    base = type(system.law)

    class Other(base):
        def normal_equations(self, s):
            equations = super().normal_equations(s)
            return equations if self.online is None else change(equations, s)

    law = system.law
    return system.replace(law=Other(c=law.c, feedforward=law.feedforward, online=law.online))


def test_an_input_that_is_no_mean_has_no_certificate():
    def change(equations, s):
        return replace(equations, u=equations.u + LEVEL * (1 - LEVEL) * s.x[0])

    found, _ = certify_online(controlled(robust(), change))
    assert not found.exists
    assert "no mean" in found.reason


def renumbered(system, name, factor):
    """The system with a law that runs with another number where the gains move."""
    base = type(system.law)

    class Other(base):
        def _numbers(self, coordinates, plant):
            numbers = dict(super()._numbers(coordinates, plant))
            if self.online is not None:
                numbers[name] = factor * numbers[name]
            return numbers

    law = system.law
    return system.replace(law=Other(c=law.c, feedforward=law.feedforward, online=law.online))


@pytest.mark.parametrize(
    "name",
    ["nu_x", "nu_Y", "other_nu_x", "other_nu_Y", "online_rise", "online_fall", "online_threshold"],
)
def test_a_controller_with_another_number_has_no_certificate(name):
    """Each of both ends and of the rule; the same law with the stated numbers has one."""
    assert certify_online(renumbered(robust(), name, 1))[0].verified
    found, _ = certify_online(renumbered(robust(), name, 1.5))
    assert not found.exists
    assert f"what runs with {name} has another number" in found.reason


@pytest.mark.parametrize("factor", [1, 2])
def test_a_schedule_that_is_followed_by_another_rule_has_no_certificate(factor):
    system = robust()
    online = Online(c=(8.0,) * 4, schedule="0.5 + 0.5*tanh(x1)", rate=1.0)
    system = system.replace(law=replace(system.law, online=online))

    def change(equations, s):
        update = tuple((level, factor * rate) for level, rate in equations.update)
        return replace(equations, update=update)

    found, _ = certify_online(controlled(system, change))
    assert found.exists == (factor == 1)
    assert factor == 1 or "another rule" in found.reason


def test_a_bound_of_the_uncertainty_of_its_own_is_not_covered_beside():
    system = robust()
    old = system.plant.uncertainty
    uncertainty = replace(
        old, gamma=(*old.gamma[:3], 0), beta=(*old.beta[:3], 0), bound=("", "", "", "0.1*abs(x1)")
    )
    found, _ = certify_online(system.replace(plant=replace(system.plant, uncertainty=uncertainty)))
    assert not found.exists
    assert "plant.uncertainty.bound beside law.online" in found.reason


def test_an_adaptive_law_that_shares_all_is_covered_by_its_slower_end():
    system = adaptive(c_n=3.0)
    (problem,) = end_problems(system)
    ends = [error_problem(end(system), rational) for end in (first_end_system, other_end_system)]
    last = [end.M[-1, -1] for end in ends]
    assert problem.M[-1, -1] == max(last)  # the smaller c_n: M[n, n] = -c_n - ...
    assert last[0] != last[1]
    turned = system.replace(
        law=replace(system.law, c=(1.0, 30.0), online=replace(system.law.online, c_n=0.5))
    )
    (problem,) = end_problems(turned)
    assert problem.M[-1, -1] == error_problem(other_end_system(turned), rational).M[-1, -1]


OF_ORDER_THREE = """
[plant]
states = ["x1", "x2", "x3"]
chain = [1, 1]
drift = "-0.3*x3"
regressor = ["sin(x1)"]
gain_sign = 1
[plant.uncertainty]
tau = [0.05, 0.05, 0.1]
gamma = [0.1, 0.1, 0.1]
beta = [0.1, 0.1, 0.1]
[truth]
input_gain = 2
theta = [0.5]
omega = ["0.1*sin(t)", "0.1*cos(t)", "0.1*sin(2*t)"]
[reference]
signal = "0.2*sin(t)"
[law]
kind = "adaptive"
c = [1, 2, 9]
gain_rate = 1
leak_gain = 0.5
leak_theta = 0.5
delta0 = 0.5
theta0 = [0.4]
online = {c_n = 3, threshold = 0.01, rise = 2, fall = 0.3}
[simulation]
x0 = [0.1, 0, 0]
duration = 10
tail = 2
"""


@pytest.mark.parametrize(("first", "other"), [(9.0, 3.0), (3.0, 9.0)])
def test_the_slower_end_is_that_of_the_smaller_last_gain_at_any_order(first, other):
    """V' holds M[n, n] = -c_n + ... of the slower end for all that are between."""
    system = certrack.loads(OF_ORDER_THREE)
    online = replace(system.law.online, c_n=other)
    system = system.replace(law=replace(system.law, c=(1.0, 2.0, first), online=online))
    assert other_end(system.law).c == (1.0, 2.0, other)
    ends = [error_problem(end(system), rational) for end in (first_end_system, other_end_system)]
    assert abs(ends[1].M[-1, -1] - ends[0].M[-1, -1]) == rational(abs(first - other))
    (problem,) = end_problems(system)
    assert (problem.M == ends[first > other].M).all()
    off = np.abs(ends[1].M - ends[0].M)
    off[-1, -1] = rational(0)
    assert not off.any()  # the last gain stands nowhere else


def test_a_column_that_acts_at_one_end_is_there_at_both():
    """y_d^(q+1) acts where r makes no static error by it at one end only."""
    base = certrack.load("dual-motor-linear")
    law = base.law.settled(base.plant)
    faster = tuple(1.1 * v for v in law.K)
    online = Online(K=faster, r=1.01 * law.r, schedule="0.5")
    problems = end_problems(base.replace(law=replace(law, online=online)))
    assert len(problems) == 2
    assert problems[0].derivatives == problems[1].derivatives
    assert problems[0].counts == problems[1].counts
    assert [p.Uy.shape for p in problems] == [p.Xy.shape for p in problems]


@pytest.mark.parametrize("shorter", [0, 1])
def test_an_input_that_one_end_has_not_acts_at_the_other_alone(moving, shorter):
    """Its column is zero there, so that the inequality is that without it, whatever its share."""
    problems = list(moving[1])
    whole = problems[shorter]
    less = replace(
        whole, Uy=whole.Uy[:, :-1], Xy=whole.Xy[:, :-1], derivatives=whole.derivatives[:-1]
    )
    problems[shorter] = less
    both = _with_inputs_of_both(*problems)
    assert both[1 - shorter] is problems[1 - shorter]
    wide = both[shorter]
    assert (wide.derivatives, wide.counts) == (whole.derivatives, whole.counts)
    assert wide.Uy.shape == whole.Uy.shape and wide.Xy.shape == whole.Xy.shape
    assert (wide.Uy[:, :-1] == less.Uy).all() and (wide.Xy[:, :-1] == less.Xy).all()
    assert not wide.Uy[:, -1].any() and not wide.Xy[:, -1].any()
    rng, n = np.random.default_rng(1), less.n
    P = rng.normal(size=(n, n))
    lam, nu, k = (rng.uniform(0.1, 1, count) for count in whole.counts)
    P, size = P + P.T, n + sum(less.counts)
    form = wide.in_floats().inequality(P, lam, nu, k, 0.3)
    short = less.in_floats().inequality(P, lam, nu, k[:-1], 0.3)
    np.testing.assert_allclose(form[:size, :size], short, rtol=1e-12, atol=1e-12)
    assert not form[-1, :-1].any() and form[-1, -1] < 0


def test_gains_that_stand_still_have_no_ends():
    with pytest.raises(NoCertificate, match="stand still"):
        end_problems(certrack.load("dual-motor-lean"))


# The rules ----------------------------------------------------------------------------------------


def rate_of_level(system, error, level):
    """w' of the controller that runs, with x_1 so far from y_d."""
    runs = system.controller
    values = dict(zip(runs.symbols, runs.values, strict=True))
    s = runs.signals
    values |= dict.fromkeys((*s.x, *s.Y), 0.0) | {s.x[0]: error, LEVEL: level}
    return float(dict(runs.equations.update)[LEVEL].xreplace(values))


def test_an_error_of_the_threshold_moves_the_level_by_halves():
    """m = 1/(1 + (e_1/b)^4): 1/2 at b, 16/17 at b/2, 1/17 at 2 b, whatever the sign of e_1."""
    system, b = robust(), RULE["threshold"]
    rise, fall = RULE["rise"], RULE["fall"]
    for error, m in ((b, 1 / 2), (b / 2, 16 / 17), (2 * b, 1 / 17), (0.0, 1.0)):
        for level in (0.0, 0.25, 1.0):
            expected = rise * (1 - m) * (1 - level) - fall * m * level
            for sign in (1, -1):
                found = rate_of_level(system, sign * error, level)
                assert found == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_a_schedule_with_a_rate_is_followed():
    law = replace(robust().law, online=Online(c=(8.0,) * 4, schedule="0.75", rate=3.0))
    system = robust().replace(law=law)
    assert rate_of_level(system, 0.0, 0.25) == pytest.approx(1.5)
    assert rate_of_level(system, 0.0, 1.0) == pytest.approx(-0.75)


def test_states_and_numbers_of_a_rule():
    rule, plain = Online(c_n=3.0, **RULE), Online(c_n=3.0, schedule="t/(1 + t)")
    slow = Online(c_n=3.0, schedule="0.5", rate=2.0)
    assert (rule.has_state, plain.has_state, slow.has_state) == (True, False, True)
    assert rule.numbers == {f"online_{name}": value for name, value in RULE.items()}
    assert plain.numbers == {}
    assert slow.numbers == {"online_rate": 2.0}
    assert rule.changes == {"c_n": 3.0}
    assert plain.formula(certrack.load("example1").plant) == TIME / (1 + TIME)


@pytest.mark.parametrize(
    "name", ["c_n", "gain_rate", "leak_gain", "leak_theta", "rate", "threshold", "rise", "fall"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_numbers_that_are_not_positive_are_refused(name, value):
    stated = {"c_n": 3.0, "rate": 9.0, **RULE, name: value}
    with pytest.raises(InputError) as caught:
        Online(**stated)
    assert caught.value.key == f"law.online.{name}"


@pytest.mark.parametrize("name", ["amplitude", "frequency", "speed", "effort"])
def test_numbers_of_what_is_tried_must_be_positive(name):
    stated = {"seek": "spsa", "amplitude": 0.1, "frequency": 0.5, "speed": 0.2, "effort": 0.1}
    assert getattr(Online(c_n=3.0, **(stated | {name: 1e-9})), name) == 1e-9
    for value in (0.0, -0.5, -1.0, np.inf, np.nan):
        with pytest.raises(InputError) as caught:
            Online(c_n=3.0, **(stated | {name: value}))
        assert caught.value.key == f"law.online.{name}"


def test_a_seed_is_an_integer_of_31_bits():
    stated = {"seek": "spsa", "amplitude": 0.1, "frequency": 0.5, "speed": 0.2}
    for seed in (0, 1, 2**31 - 1):
        assert Online(c_n=3.0, **stated, seed=seed).seed == seed
    for seed in (-1, 2**31, 0.5):
        with pytest.raises(InputError, match=r"law\.online\.seed"):
            Online(c_n=3.0, **stated, seed=seed)


def test_each_rule_excludes_the_others():
    sought = {"seek": "spsa", "amplitude": 0.1, "frequency": 0.5, "speed": 0.2}
    for others, key in (
        (sought | RULE, "seek"),
        (sought | {"schedule": "0.5"}, "seek"),
        (RULE | {"schedule": "0.5"}, "threshold"),
        ({}, "threshold"),
    ):
        with pytest.raises(InputError) as caught:
            Online(c_n=3.0, **others)
        assert caught.value.key == f"law.online.{key}"


@pytest.mark.parametrize("name", ["c", "Gamma"])
def test_lists_of_numbers_that_are_not_positive_are_refused(name):
    for value in (0.0, -1.0):
        with pytest.raises(InputError) as caught:
            Online(**{name: (1.0, value)}, rate=9.0, **RULE)
        assert caught.value.key == f"law.online.{name}[1]"
    assert getattr(Online(**{name: (1.0, 1e-9)}, rate=9.0, **RULE), name) == (1.0, 1e-9)
    assert Online(K=(0.0, -1.0), r=-2.0, **RULE).K == (0.0, -1.0)


def test_a_rule_may_be_as_fast_as_the_rate_and_no_faster():
    assert Online(c_n=3.0, **RULE, rate=RULE["rise"]).rate == RULE["rise"]
    for name in ("rise", "fall"):
        with pytest.raises(InputError, match=rf"law\.online\.{name}: must be at most the rate"):
            Online(c_n=3.0, **(RULE | {"rise": 1.0, "fall": 1.0, name: 1.01}), rate=1.0)
    with pytest.raises(InputError, match="rate: is missing"):
        Online(Gamma=(3.0,), schedule="0.5")
    assert Online(Gamma=(3.0,), schedule="0.5", rate=1.0).rate == 1.0


def test_a_step_may_reach_an_end_and_not_pass_it():
    rule = Online(c_n=3.0, threshold=1.0, rise=2.0, fall=4.0)
    rule.check_period(0.25)
    with pytest.raises(InputError, match=r"must be at most 0\.25 s"):
        rule.check_period(0.2501)
    slow = Online(c_n=3.0, schedule="0.5", rate=4.0)
    slow.check_period(0.25)
    with pytest.raises(InputError, match=r"must be at most 0\.25 s"):
        slow.check_period(0.2501)
    Online(c_n=3.0, schedule="0.5").check_period(1e9)  # no state, no step


@pytest.mark.parametrize("kind", ["extremum", "spsa"])
@pytest.mark.parametrize(
    ("frequency", "speed", "rate", "fastest"),
    [(0.5, 0.2, None, 10 * np.pi), (0.001, 3.0, None, 12.0), (0.001, 0.01, 5.0, 5.0)],
)
def test_a_step_follows_all_states_of_a_rule_that_seeks(kind, frequency, speed, rate, fastest):
    """Ten times its frequency in 1/s, 2 pi each; four times its speed; and the stated rate."""
    rule = Online(c_n=3.0, seek=kind, amplitude=0.1, frequency=frequency, speed=speed, rate=rate)
    rule.check_period(0.999 / fastest)
    with pytest.raises(InputError, match=f"must be at most {1 / fastest:.4g} s"):
        rule.check_period(1.001 / fastest)


def test_a_formula_that_fills_its_range_is_left_as_it_is():
    x, half = sympy.Symbol("x", real=True), sympy.Rational(1, 2)
    for inside in (half + half * sympy.sin(x), half - half * sympy.tanh(x), half):
        assert within_unit(inside) == inside
    for constant in (sympy.S.Zero, sympy.S.One):
        assert within_unit(constant) == constant
    assert within_unit(sympy.Rational(3, 2)) == 1
    assert within_unit(-half) == 0
    for over in (half + sympy.Rational(3, 5) * sympy.sin(x), half * sympy.cos(x), 1 - sympy.cos(x)):
        assert within_unit(over) == sympy.Max(0, sympy.Min(1, over))
    for free in (x, 2 * x**2 - 1, half + sympy.sin(x) / 4 + x / 9, sympy.exp(x), x * sympy.sin(x)):
        assert within_unit(free) == sympy.Max(0, sympy.Min(1, free))
    two = half + sympy.sin(x) / 4 + sympy.cos(3 * x) / 4
    assert within_unit(two) == two
    assert within_unit(two + sympy.tanh(x) / 100) != two + sympy.tanh(x) / 100


def test_what_another_end_says_replaces_what_the_law_says():
    base = certrack.load("example1").law
    law = replace(base, online=Online(c_n=7.0, leak_gain=0.9, **RULE))
    end = other_end(law)
    assert end.c == (*base.c[:-1], 7.0)
    assert (end.leak_gain, end.leak_theta, end.online) == (0.9, base.leak_theta, None)
    linear = certrack.load("dual-motor-linear")
    still = linear.law.settled(linear.plant)
    faster = tuple(1.1 * v for v in still.K)
    assert other_end(replace(still, online=Online(K=faster, **RULE))).r is None
    kept = other_end(replace(still, online=Online(K=faster, r=2.0, **RULE)))
    assert (kept.K, kept.r, kept.lqr) == (faster, 2.0, None)
    only = other_end(replace(still, online=Online(r=2.0, **RULE)))
    assert (only.K, only.r) == (still.K, 2.0)


def test_a_diagonal_is_written_as_one_number_per_regressor():
    assert _is_diagonal(None) and _is_diagonal(()) and _is_diagonal((1.0, 2.0))
    assert not _is_diagonal(((1.0, 0.0), (0.0, 2.0)))


def test_messages_name_the_keys_of_the_other_end():
    base = certrack.load("example1").law
    with pytest.raises(InputError) as caught:
        replace(base, online=Online(c=(1.0,), **RULE))
    assert caught.value.key.startswith("law.online.")

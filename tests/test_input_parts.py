"""Parts of the bounds on the input, one by one: the row of u, the programs, the checks."""

from dataclasses import replace
from fractions import Fraction

import flint
import numpy as np
import pytest
from test_input_bounds import integrators, lean

import certrack
from certrack.certificates import certify_input
from certrack.certificates import input_bounds as room
from certrack.certificates.arithmetic import rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.exact import Proof, from_text, root_up
from certrack.certificates.formulation import error_coordinates, error_problem
from certrack.certificates.input_bounds import (
    InputBound,
    InputBounds,
    energy_bound,
    failed_input,
    peak_square,
)
from certrack.certificates.input_problem import input_problem
from certrack.certificates.input_program import InputProgram
from certrack.certificates.mean_squares import RUN_PARTS, mean_squares
from certrack.certificates.semidefinite import fastest_rate
from certrack.certificates.start import starting_energy
from certrack.certificates.state_bounds import certify_state, state_problem
from certrack.certificates.tube import starts_of
from certrack.core.errors import InputError
from certrack.core.expressions import symbol

#: With a theta that is known, a constant drift and a gain that is not 1.
SHIFTED = """
title = "two states, all parts of the input"
[plant]
states = ["x1", "x2"]
chain = [0.5]
linear = [[0.3]]
drift = "0.4*x1 - 0.7*x2 + 1.5"
regressor = ["x2"]
input_gain = 2.5
theta = [0.6]
gain_sign = 1
[plant.uncertainty]
tau = [1, 1]
gamma = [0, 0.05]
beta = [0.01, 0.1]
[truth]
input_gain = 2.5
theta = [0.6]
omega = ["0", "0"]
[reference]
signal = "0.2*sin(2*t)"
[law]
kind = "robust"
c = [2, 3]
feedforward = 1
[simulation]
x0 = [0.1, -0.2]
duration = 10
"""


def shifted(q=1, drift=None):
    text = SHIFTED.replace("feedforward = 1", f"feedforward = {q}")
    return certrack.loads(text if drift is None else text.replace("0.7*x2 + 1.5", drift))


def plain(q=1):
    """The same without the constant that u would have to cancel for ever."""
    return shifted(q, "0.7*x2")


@pytest.fixture(scope="module", params=[0, 1])
def bounded(request):
    system = plain(request.param)
    return system, certify_input(system)


# The row of u -------------------------------------------------------------------------------------


@pytest.mark.parametrize("system", [shifted(0), shifted(1), plain(), lean(), lean(q=3)])
def test_the_row_gives_what_the_controller_commands(system):
    """u(x, Y) of the law that runs = row e + sum c_i y_i + c_0, e = A x - B Y, y_i = Y_i/bound."""
    exact, runs = input_problem(system).in_floats(), system.controller
    values = dict(zip(runs.symbols, runs.values, strict=True))
    values |= {symbol(name): v for name, v in system.plant.constant_values.items()}
    s, design = runs.signals, runs.coordinates
    formula = runs.equations.u.xreplace(values)
    bounds = np.array(system.reference.bounds(design.q + 1).values)
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, Y = rng.normal(size=system.plant.n), bounds * rng.uniform(-1, 1, design.q + 2)
        point = dict(zip((*s.x, *s.Y), (*x, *Y), strict=True))
        e, y = design.A @ x - design.B @ Y[:-1], Y / bounds
        found = exact.row @ e + exact.through_y @ y + exact.constant
        assert found == pytest.approx(float(formula.xreplace(point)), rel=1e-9)
        over = np.concatenate([e, np.zeros(sum(exact.problem.counts[:2])), y])
        assert exact.over_all @ over + exact.constant == pytest.approx(found, rel=1e-12)


@pytest.mark.parametrize("system", [shifted(0), shifted(1), lean(q=3)])
def test_all_derivatives_are_inputs_of_the_error_system(system):
    """x = Xe e + Xy y for every x and Y, and e' = M e + Uy y where nothing uncertain acts."""
    problem, design = input_problem(system).in_floats().problem, system.controller.coordinates
    q, n, rng = design.q, system.plant.n, np.random.default_rng(1)
    bounds = np.array(system.reference.bounds(q + 1).values)
    assert problem.derivatives == tuple(range(q + 2))
    assert problem.Uy.shape == problem.Xy.shape == (n, q + 2)
    x, Y = rng.normal(size=n), bounds * rng.uniform(-1, 1, q + 2)
    e, y = design.A @ x - design.B @ Y[:-1], Y / bounds
    np.testing.assert_allclose(problem.Xe @ e + problem.Xy @ y, x, rtol=1e-9)
    x_dot = np.append(design.F @ x, design.nu_x @ x + design.nu_Y @ Y)
    e_dot = design.A @ x_dot - design.B @ Y[1:]
    scale = np.abs(design.A).max() * np.abs(x_dot).max()
    np.testing.assert_allclose(problem.M @ e + problem.Uy @ y, e_dot, atol=1e-12 * scale)


def test_the_constant_is_what_cancels_the_drift_at_rest():
    exact = input_problem(shifted())
    assert exact.constant == rational("-0.6")  # -1.5/2.5
    assert input_problem(plain()).constant == 0
    through = [abs(v) for v in exact.through_y]
    assert exact.direct == sum(through, rational("0.6"))
    opposite = replace(exact, through_y=-exact.through_y, constant=-exact.constant)
    assert opposite.direct == exact.direct
    with pytest.raises(ValueError, match="read-only"):
        exact.problem.Uy[0, 0] = 0


# The programs -------------------------------------------------------------------------------------


def test_the_programs_find_what_their_proofs_give(bounded):
    """The value of the energy is the largest V(0), that of the peak max(V(0), Delta/alpha)."""
    system, _ = bounded
    exact = input_problem(system)
    starts, _ = starts_of(system, None)
    errors = room._errors(system, starts)
    shares = mean_squares(system, len(exact.through_y) - 1, 10.0)
    program = InputProgram(exact.in_floats(), errors)
    energy = program.energy(10.0, shares.astype(float))
    assert energy.alpha == 0
    assert energy.value == pytest.approx(max(e @ energy.P @ e / 2 for e in errors), rel=1e-4)
    alpha = 0.3 * fastest_rate(exact.in_floats().problem)
    peak = program.peak(alpha)
    assert peak.alpha == alpha
    V = max(e @ peak.P @ e / 2 for e in errors)
    level = max(V, (peak.nu.sum() + peak.k.sum()) / alpha)
    assert peak.value == pytest.approx(level, rel=1e-4)
    late = InputProgram(exact.in_floats()).peak(alpha)
    assert late.value <= peak.value * (1 + 1e-6)
    assert late.value == pytest.approx((late.nu.sum() + late.k.sum()) / alpha, rel=1e-4)


def test_more_starts_and_longer_runs_need_more():
    system = plain()
    exact = input_problem(system)
    ones = np.ones(len(exact.through_y))
    near, far = np.array([0.1, 0.0]), np.array([5.0, -3.0])

    def least(starts, duration, shares=ones):
        found = InputProgram(exact.in_floats(), starts).energy(duration, shares)
        V = max(e @ found.P @ e / 2 for e in starts)
        return V + duration * (found.nu.sum() + found.k @ shares)

    assert least([near], 10.0) < least([far], 10.0)
    assert least([near, far], 10.0) == pytest.approx(least([far], 10.0), rel=1e-3)
    assert least([near], 10.0) < least([near], 20.0) < 2.001 * least([near], 10.0)
    assert least([near], 10.0, 0.5 * ones) < 0.9 * least([near], 10.0)


def test_a_plant_without_anything_uncertain_has_the_energy_of_its_own_equation():
    """No inputs but y: the least V(0) + ... with y = 0 is e^T X e, X of the Lyapunov equation."""
    text = SHIFTED.replace("0.7*x2 + 1.5", "0.7*x2").replace("beta = [0.01, 0.1]", "beta = [0, 0]")
    text = text.replace("gamma = [0, 0.05]", "gamma = [0, 0]")
    system = certrack.loads(text.replace('"0.2*sin(2*t)"', '"1e-6*sin(2*t)"'))
    exact = input_problem(system).in_floats()
    M, row = exact.problem.M, exact.row
    X = np.linalg.solve(
        np.kron(np.eye(2), M.T) + np.kron(M.T, np.eye(2)), -np.outer(row, row).ravel()
    ).reshape(2, 2)
    found = certify_input(system)
    e = room._errors(system, starts_of(system, None)[0])[0]
    assert found.energy.bound == pytest.approx(e @ X @ e, rel=1e-3)
    assert found.energy.bound >= e @ X @ e


# What is claimed ----------------------------------------------------------------------------------


def test_the_bounds_are_what_their_proofs_give(bounded):
    """Each from its numbers in fractions: V(0) + T (sum nu + k m), and sqrt(2 max) + direct."""
    system, found = bounded
    exact = input_problem(system)
    starts, _ = starts_of(system, None)
    order, T = len(exact.through_y) - 1, system.settings.duration
    shares = mean_squares(system, order, T)

    def numbers(bound):
        nu, k = ([from_text(v) for v in part] for part in (bound.proof.nu, bound.proof.k))
        P = np.array([[from_text(v) for v in row] for row in bound.proof.P], dtype=object)
        zero = rational(0)
        return nu, k, sum(nu, zero), starting_energy(system, exact.problem, P, starts)

    _, k, total, V = numbers(found.energy)
    energy = V + rational(T) * (total + sum((a * b for a, b in zip(k, shares, strict=True)), 0))
    _, k, total, _ = numbers(found.rms)
    rms = total + sum(k, rational(0))
    assert from_text(found.rms.proof.bound) == from_text(root_up(rms))
    assert from_text(found.energy.proof.bound) == from_text(root_up(energy**2))
    for bound, counted in ((found.peak, True), (found.ultimate, False)):
        _, k, total, V = numbers(bound)
        level = (total + sum(k, rational(0))) / from_text(bound.proof.alpha)
        level = max(level, V) if counted else level
        largest = from_text(root_up(2 * level)) + exact.direct
        assert from_text(bound.proof.bound) == from_text(root_up(largest**2))
        assert rational(bound.bound) >= from_text(bound.proof.bound)
    assert found.record()["rms_input"] == found.rms.bound
    assert found.record()["ultimate_input"] == found.ultimate.bound
    assert found.ultimate.bound <= found.peak.bound
    assert failed_input(system, found) == ""


def one_digit_less(text):
    digits, _, exponent = text.partition("e")
    return f"{int(digits) - 1}e{exponent}"


@pytest.mark.parametrize("name", ["energy", "rms", "peak", "ultimate"])
def test_a_bound_one_digit_below_its_proof_is_refused(bounded, name):
    system, found = bounded
    bound = getattr(found, name)
    less = replace(bound.proof, bound=one_digit_less(bound.proof.bound))
    claim = replace(found, **{name: InputBound(bound.bound, less)})
    assert failed_input(system, claim) == f"the proof of {name} does not hold"
    lower = replace(found, **{name: InputBound(bound.bound * (1 - 1e-15), bound.proof)})
    assert failed_input(system, lower) == f"{name} is smaller than what is proven"
    higher = replace(found, **{name: InputBound(2 * bound.bound, bound.proof)})
    assert failed_input(system, higher) == ""
    negative = replace(bound.proof, bound=f"-{bound.proof.bound}")
    claim = replace(found, **{name: InputBound(bound.bound, negative)})
    assert failed_input(system, claim) == f"the proof of {name} does not hold"
    alone = InputBounds(**{name: bound})
    assert failed_input(system, alone) == ""  # what is not claimed needs no proof


def test_a_proof_needs_its_shape_its_signs_and_its_rate(bounded):
    system, found = bounded
    exact = input_problem(system)
    starts, _ = starts_of(system, None)
    ones = np.array([rational(1)] * len(exact.through_y), dtype=object)

    def energy(proof):
        return energy_bound(system, exact, proof, starts, 10.0, ones)

    def peak(proof):
        return peak_square(system, exact, proof, starts)

    for value, proof, other in (
        (energy, found.energy.proof, "0.001"),
        (peak, found.peak.proof, "0"),
    ):
        assert value(proof) is not None
        assert value(replace(proof, alpha=other)) is None
        assert value(replace(proof, nu=proof.nu[:-1])) is None
        assert value(replace(proof, P=proof.P[:1])) is None
        tilted = (proof.P[0], (str(float(proof.P[1][0]) * 1.0001 + 1e-9), proof.P[1][1]))
        assert value(replace(proof, P=tilted)) is None
        for group in ("nu", "k", "lam"):
            texts = getattr(proof, group)
            assert value(replace(proof, **{group: ("-1e-30", *texts[1:])})) is None
    assert (
        energy_bound(system, input_problem(shifted()), found.energy.proof, (), 10.0, ones) is None
    )


def test_without_starts_nothing_is_added():
    """The long run forgets V(0)."""
    system = plain()
    found, exact = certify_input(system), input_problem(system)
    starts, _ = starts_of(system, None)
    ones = np.array([rational(1)] * len(exact.through_y), dtype=object)
    proof = found.energy.proof
    with_it, without = (
        energy_bound(system, exact, proof, chosen, 10.0, ones) for chosen in (starts, ())
    )
    P = np.array([[from_text(v) for v in row] for row in proof.P], dtype=object)
    assert with_it - without == starting_energy(system, exact.problem, P, starts)
    double = energy_bound(system, exact, proof, (), 20.0, ones)
    assert double == 2 * without


def test_a_solution_gives_way_by_the_same_part_more_and_more():
    """P and lam by 1 + s, nu and k by (1 + s)^2 and a part of their sum, alpha by 1 - s."""
    system = plain()
    solution = InputProgram(input_problem(system).in_floats()).peak(0.5)
    proofs = room._as_proofs(solution)
    assert len(proofs) == len(room.BACK_OFF)
    for slack, proof in zip(room.BACK_OFF, proofs, strict=True):
        assert isinstance(proof, Proof)
        assert float(proof.alpha) == pytest.approx(0.5 * (1 - slack), rel=1e-12)
        P = np.array(proof.P, dtype=float)
        np.testing.assert_allclose(P, (1 + slack) * solution.P, rtol=1e-9)
        assert (P == P.T).all()
        extra = slack * (solution.nu.sum() + solution.k.sum())
        nu, k = np.array(proof.nu, dtype=float), np.array(proof.k, dtype=float)
        np.testing.assert_allclose(nu, solution.nu * (1 + slack) ** 2 + extra, rtol=1e-9)
        np.testing.assert_allclose(k, solution.k * (1 + slack) ** 2 + extra, rtol=1e-9)
        lam = np.array(proof.lam, dtype=float)
        assert (lam > solution.lam * (1 + slack)).all()
        np.testing.assert_allclose(lam, solution.lam * (1 + slack), rtol=1e-6, atol=2e-12)


def test_multipliers_that_are_all_zero_give_way_by_a_part_of_the_value():
    system = plain()
    solution = InputProgram(input_problem(system).in_floats()).peak(0.5)
    none = replace(solution, nu=0 * solution.nu, k=0 * solution.k, value=4.0)
    for slack, proof in zip(room.BACK_OFF, room._as_proofs(none), strict=True):
        for text in (*proof.nu, *proof.k):
            assert float(text) == pytest.approx(4e-12 * slack, rel=1e-12, abs=0)


def test_the_best_rate_of_those_tried_counts(monkeypatch):
    """The program of each, the smallest value first."""
    system = plain()
    best = certify_input(system).peak.bound
    alone = []
    for rate in room.RATES:
        monkeypatch.setattr(room, "RATES", np.array([rate]))
        peak = certify_input(system).peak
        alone += [peak.bound] if peak is not None else []
    assert best == min(alone) < max(alone)


@pytest.mark.parametrize("n", [6, 7])
def test_as_many_starts_as_a_program_takes(n):
    """64 corners of six states are distinguished, 128 of seven are not."""
    system = integrators(n)
    starts, _ = starts_of(system, [(-1.0, 1.0)] * n)
    if n == 6:
        assert len(room._errors(system, starts)) == 64
        x, Y = starts[5]
        design = system.controller.coordinates
        e = design.A @ np.array([float(v) for v in x]) - design.B @ np.array([float(v) for v in Y])
        assert room._errors(system, starts)[5] == pytest.approx(e, abs=1e-9 * np.abs(e).max())
    else:
        with pytest.raises(NoCertificate, match="more than 64 corners"):
            room._errors(system, starts)


def test_the_name_of_a_file_has_no_bounds():
    with pytest.raises(
        InputError, match=r"^system: must be a System; got example1\. certrack\.load"
    ):
        certify_input("example1")


def test_what_is_missing_is_named_and_nothing_else():
    found, exact = certify_input(plain()), input_problem(plain())
    assert found.missing == {}
    without = replace(found, rms=None, peak=None)
    assert room._missing(without, exact) == {
        "rms": "no proof was found",
        "peak": "no proof was found",
    }
    constant = certify_input(shifted())
    assert list(constant.missing) == ["energy", "rms"]
    assert constant.record()["energy"] is None
    assert constant.record()["box"] is None
    boxed = certify_input(plain(), ((-0.1, 0.1),) * 2)
    assert boxed.record()["box"] == [[-0.1, 0.1]] * 2


# Mean squares -------------------------------------------------------------------------------------


def of_reference(**table):
    lines = "\n".join(f"{name} = {value}" for name, value in table.items())
    return certrack.loads(SHIFTED.replace('signal = "0.2*sin(2*t)"', lines))


def test_the_mean_of_a_ramp_is_known():
    """(1/T) int (t/T)^2 = 1/3, from above by the width of the parts: sum (i + 1)^2/N^3."""
    system = of_reference(signal='"0.2*sin(2*t)"')
    N = RUN_PARTS
    values = mean_squares(system, 0, 1e-3).astype(float)  # there sin(2 t) = 2 t
    above = sum((i + 1) ** 2 for i in range(N)) / N**3 * (2e-3) ** 2
    assert values[0] == pytest.approx(above, rel=1e-5)
    assert float(Fraction(1, 3)) * (2e-3) ** 2 < values[0]


def test_a_reference_without_a_rule_counts_as_if_it_were_at_its_bounds(monkeypatch):
    """And the precision of the balls is what it was."""

    def refuse(*_):
        raise ValueError("no rule")

    before = flint.ctx.prec
    monkeypatch.setattr("certrack.certificates.mean_squares._mean", refuse)
    assert mean_squares(plain(), 3, 10.0).tolist() == [1, 1, 1, 1]
    assert flint.ctx.prec == before


def test_a_reference_that_rests_at_its_bound_has_a_mean_of_one():
    """And derivatives that are zero count as if they were at their bound."""
    system = of_reference(signal='"0.2"')
    shares = mean_squares(system, 2, 10.0)
    assert len(shares) == 3
    assert float(shares[0]) == pytest.approx(1, rel=1e-9)
    assert shares[1] == shares[2] == 1


# States -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("q", [0, 1])
@pytest.mark.parametrize("i", [0, 1])
def test_a_state_is_a_row_over_errors_and_reference(q, i):
    """x = A^-1 (e + B Y), with each y_j scaled to its bound; the last derivative is not in it."""
    system = plain(q)
    found, design = state_problem(system, i), error_coordinates(system, rational)
    e = [Fraction(3, 7), Fraction(-2, 5)]
    y = [Fraction(k + 1, 9) for k in range(q + 1)]
    A, B = design.A.astype(float), design.B.astype(float)
    x = np.linalg.solve(A, np.array(e, float) + B @ np.array(y, float))
    bounds = [0.2 * 2**k for k in range(q + 2)]  # of 0.2 sin(2 t)
    row, through = found.row.astype(float), found.through_y.astype(float)
    scaled = np.array(y, dtype=float) / bounds[:-1]
    assert row @ np.array(e, float) + through[:-1] @ scaled == pytest.approx(x[i])
    assert through[-1] == 0 and found.constant == 0 and len(through) == q + 2
    assert found.problem.counts[2] >= error_problem(system, rational).counts[2]
    assert list(found.problem.derivatives) == list(range(q + 2))


def test_a_state_of_one_integrator_is_the_error_and_the_reference():
    """e' = -c e + w, |w| <= 0.3: limsup |x| <= 0.3/c + Y_0, and no less."""
    system = certrack.loads(
        """
[plant]
states = ["x1"]
chain = []
drift = "0"
gain_sign = 1
input_gain = 1
[plant.uncertainty]
tau = [1]
gamma = [0]
beta = [0.3]
[truth]
input_gain = 1
omega = ["0"]
[reference]
signal = "0.2*sin(2*t)"
[law]
kind = "robust"
c = [3]
[simulation]
x0 = [0]
duration = 10
"""
    )
    bound = float(certify_state(system, 0).bound)
    assert 0.3 / 3 + 0.2 <= bound <= 1.001 * (0.3 / 3 + 0.2)


def test_laws_whose_states_have_no_such_bound_say_so():
    with pytest.raises(NoCertificate, match="known parameters only"):
        state_problem(certrack.load("example1"), 0)
    moving = certrack.loads(
        SHIFTED.replace("[law]", '[law.online]\nc = [3, 4]\nschedule = "0.5"\n[law]')
    )
    with pytest.raises(NoCertificate, match="law.online moves them"):
        state_problem(moving, 0)

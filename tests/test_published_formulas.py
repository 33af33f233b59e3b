"""The published proof and the units of programs, part by part, in fractions."""

import math
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from test_certificate_formulas import exact

import certrack
from certrack.certificates import published
from certrack.certificates.arithmetic import decimal, positive_definite, rational
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.formulation import error_problem
from certrack.certificates.published import (
    SMALL_EPS,
    Terms,
    _minimise,
    _smallest_eigenvalue,
    best_eps,
    critical_strength,
    residual_damping,
    uncertainty_terms,
)
from certrack.certificates.scaling import (
    KEPT_BITS,
    Scaling,
    _divided,
    _norm,
    _reach,
    _rounded,
    _timed,
)


def terms(**others):
    """Numbers that all differ."""
    numbers = {
        "c_min": Fraction(5),
        "A_norm2": Fraction(2),
        "G": Fraction(1, 4),
        "reference2": Fraction(3),
        "residual": Fraction(7, 10),
        "H": Fraction(1, 3),
        "leak": Fraction(1, 9),
        "gains": (Fraction(2), Fraction(7, 2)),
        "adaptation": None,
    } | others
    return Terms(**numbers)


def estimating(Gamma, gain_rate, leak_gain, leak_theta):
    return SimpleNamespace(
        gain_rate=Fraction(gain_rate),
        leak_gain=Fraction(leak_gain),
        leak_theta=Fraction(leak_theta),
        Gamma=Gamma,
    )


def test_the_formulas_without_estimates():
    found, eps = terms(), Fraction(1, 2)
    assert found.mu1(eps) == Fraction(17, 4)  # 5 - 3/2 2 1/4
    assert found.dbar(eps) == 3 * Fraction(1, 4) * 3 + Fraction(7, 10) + Fraction(1, 3) + Fraction(
        1, 9
    )
    assert found.rho1(eps) == found.mu1(eps) and found.alpha(eps) == Fraction(17, 2)
    assert found.rho2() == Fraction(1, 2)
    assert terms(G=Fraction(0)).dbar(eps) == Fraction(7, 10) + Fraction(1, 3) + Fraction(1, 9)


@pytest.mark.parametrize(
    ("numbers", "gamma_min", "rho1", "rho2", "alpha"),
    [
        # mu1 = 17/4; |g_n| gbar1/2, gbar2/2; |g_n|/(2 gbar), 1/(2 lambda); gbar gbar1, gbar2 lambda
        (("1", "1/5", "30"), "2", "1/5", "7/4", "1/5"),
        (("1", "100", "1/5"), "2", "1/10", "7/4", "2/5"),
        (("50", "100", "30"), "2", "17/4", "1/2", "17/2"),
        (("50", "100", "30"), "1/4", "17/4", "2", "15/2"),
    ],
)
def test_the_formulas_with_estimates(numbers, gamma_min, rho1, rho2, alpha):
    with_theta = terms(adaptation=estimating([1], *numbers), gamma_min=Fraction(gamma_min))
    eps = Fraction(1, 2)
    assert with_theta.rho1(eps) == Fraction(rho1)
    assert with_theta.rho2() == Fraction(rho2)
    assert with_theta.alpha(eps) == Fraction(alpha)


def test_without_theta_its_rates_do_not_count():
    none = terms(adaptation=estimating([], "50", "100", "1/100"), gamma_min=Fraction(1, 100))
    eps = Fraction(1, 2)
    assert none.rho1(eps) == Fraction(17, 4) and none.alpha(eps) == Fraction(17, 2)
    assert none.rho2() == Fraction(1, 2)


def test_the_best_eps_of_a_sum_of_two_parts():
    """Of a + b eps + c/eps the best is sqrt(c/b), which is within the range that is looked at."""
    found = _minimise(lambda eps: 3 + 2 * eps + 0.5 / eps, terms(c_min=5.0, A_norm2=2.0, G=0.25))
    assert found == pytest.approx(0.5, rel=1e-6)
    top = 5 / (2 * 0.25) - 1
    edge = _minimise(lambda eps: -eps, terms(c_min=5.0, A_norm2=2.0, G=0.25))
    assert 0.99 * top < edge < top
    assert _minimise(lambda eps: eps, terms(G=0)) == 1.0
    floats = terms(
        **{name: float(v) for name, v in vars(terms()).items() if isinstance(v, Fraction)}
    )
    best = best_eps(floats)
    value = 2 * floats.dbar(best) / floats.alpha(best)
    others = [best * factor for factor in (0.9, 0.99, 1.01, 1.1)]
    assert all(2 * floats.dbar(eps) / floats.alpha(eps) > value for eps in others)
    assert best > SMALL_EPS


def test_the_smallest_eigenvalue_is_not_below_what_stands_for_it():
    assert _smallest_eigenvalue(exact([["3", "0"], ["0", "2"]])) == 2
    full = exact([["2", "1"], ["1", "2"]])  # 1 and 3
    below = _smallest_eigenvalue(full)
    assert 1 - rational("1e-8") < below < 1
    assert positive_definite(full - below * np.eye(2, dtype=object))
    assert _smallest_eigenvalue(np.array([[2.0, 1.0], [1.0, 2.0]])) == pytest.approx(1)
    with pytest.raises(NoCertificate, match="singular"):
        _smallest_eigenvalue(exact([["1", "1"], ["1", "1"]]))


def damped(**uncertainty):
    """Three states, all damping terms different."""
    system = certrack.load("example1")
    u = {"tau": ("1/2", "1/3"), "gamma": (1, 2), "beta": (3, 4)} | uncertainty
    law = replace(system.law, k=((2, 3), (5, 7, 11, 13)), p=(17,))
    return SimpleNamespace(
        law=law,
        plant=SimpleNamespace(n=2, uncertainty=SimpleNamespace(Delta=None, S=None, **u)),
        controller=system.controller,
    )


def test_the_damping_of_the_uncertain_terms():
    """Step 1 has w_1, step 2 has w_1 and w_2; gamma-parts first, then beta-parts."""
    G, H = uncertainty_terms(damped(), rational)
    assert rational(Fraction(2 + 5, 4) + Fraction(11 * 4, 9)) == G
    assert rational(Fraction((3 + 7) * 9, 4) + Fraction(13 * 16, 9)) == H
    assert uncertainty_terms(damped(tau=(0, 0)), rational) == (0, 0)


def test_a_damping_that_is_left_out_is_named():
    system = damped()
    system.law = replace(system.law, k=((2, 3), (5, 7, math.inf, 13)))
    with pytest.raises(NoCertificate, match=r"finite k\[1\]\[2\], because tau_2 gamma_2"):
        uncertainty_terms(system, rational)
    system.plant.uncertainty.gamma = (1, 0)
    G, _ = uncertainty_terms(system, rational)
    assert rational(Fraction(7, 4)) == G
    for name in ("Delta", "S"):
        with pytest.raises(NoCertificate, match="without Delta and S"):
            uncertainty_terms(damped_with(name), rational)


def damped_with(name):
    system = damped()
    setattr(system.plant.uncertainty, name, ((1, 0), (0, 1)))
    return system


def test_the_damping_of_what_is_not_fed_forward():
    system = damped()
    for R, expected in (([1, 0], 17), ([0, 1], 0)):
        coordinates = SimpleNamespace(R=R, q=0)
        assert residual_damping(system, coordinates, rational) == expected
    system.law = replace(system.law, p=(math.inf,))
    assert residual_damping(system, SimpleNamespace(R=[0, 1], q=0), rational) == 0
    with pytest.raises(NoCertificate, match=r"finite p\[0\], because y_d\^\(1\) enters step 1"):
        residual_damping(system, SimpleNamespace(R=[1, 0], q=0), rational)


# units of programs


@pytest.mark.parametrize("name", ["example1", "dual-motor"])
def test_the_critical_strength_is_rounded_down(name):
    """tau^2 (||A^-1||_F^2 G) = min c, in fractions."""
    system = certrack.load(name)
    Xe = error_problem(system, rational).Xe
    G, _ = uncertainty_terms(system, rational)
    c_min = min(rational(c) for c in system.law.gains().c)
    found = rational(critical_strength(system)) ** 2 * (Xe**2).sum() * G / c_min
    assert 1 - Fraction(1, 10**8) < Fraction(str(found)) < 1


@pytest.mark.parametrize("sizes", [(math.inf, 0.0), (0.0, math.inf), (math.nan, 0.0)])
def test_one_number_beyond_floats_is_too_many(monkeypatch, sizes):
    monkeypatch.setattr(published, "uncertainty_terms", lambda system, number: sizes)
    with pytest.raises(NoCertificate, match="range of floating point"):
        published.collect(certrack.load("example1"))


def test_numbers_lose_their_last_bits_alone():
    for value in (1 / 3, -2e7 / 3, 0.0, 1.0, 5e-300):
        kept = float(_rounded(value))
        assert abs(kept - value) <= abs(value) * 2.0**-KEPT_BITS
        mantissa = math.frexp(kept)[0] * 2**KEPT_BITS
        assert mantissa == int(mantissa)


def test_norms_and_quotients():
    assert _norm(np.array([[3.0, 0.0]]), np.array([4.0])) == 5
    assert _norm(np.zeros((2, 2)), np.zeros(1)) == 1.0
    assert _divided(None, 2.0) is None and list(_divided(np.array([4.0]), 2.0)) == [2]


def test_programs_in_other_units():
    scaling = Scaling(2.0, np.array([3.0, 5.0]))
    assert scaling.rate(0.5) == 1 and scaling.leak_cost(50.0) == 4
    P = scaling.unscaled_P([(0, 0), (0, 1), (1, 1)], np.array([1.0, 2.0, 3.0]), 1)
    expected = [[25 / 9, 2 * 25 / 15], [2 * 25 / 15, 3.0]]
    assert pytest.approx(np.array(expected)) == P
    S, T = np.array([[1.0, 2.0]]), np.array([[6.0]])
    problem = SimpleNamespace(
        Xe=np.array([[1.0, 0.0], [0.0, 2.0]]),
        Xy=np.array([[0.5], [1.0]]),
        counts=(2, 1, 1),
        selections=(None, (S, T)),
    )
    reach = _reach(problem, scaling.sizes)
    assert reach == pytest.approx([math.sqrt(9 + 100 + 1.25), math.sqrt(9 + 400 + 8.5**2)])
    problem.selections = (None, (S, None))
    assert _reach(problem, scaling.sizes)[1] == pytest.approx(math.sqrt(9 + 400 + 2.5**2))
    lam, nu, k = scaling.unscaled_multipliers(problem, np.array([1.0, 2, -3, 4]), 0)
    reach = _reach(problem, scaling.sizes)
    assert lam == pytest.approx(4.5 * np.array([1, 2]) / reach**2)
    assert list(nu) == [0] and list(k) == [18]
    assert scaling.lam_units(problem, 0) == pytest.approx(4.5 / reach**2)


def test_rates_in_another_unit_of_time():
    problem = error_problem(certrack.load("example1"), decimal)
    timed = _timed(problem, 3.0)
    for name in ("M", "Ua", "Ub", "Uy"):
        assert getattr(timed, name) == pytest.approx(3 * getattr(problem, name))
    assert timed.Xe is problem.Xe
    one = Scaling.of(problem)
    assert one.time == pytest.approx(-1 / np.linalg.eigvals(problem.M).real.max())

"""The conformance kits can fail: wrong laws, references, disturbances and distributions do."""

from dataclasses import dataclass, fields, replace
from unittest import SkipTest

import numpy as np
import pytest
import sympy
from extensions import Spline, dynamic_surface, spline

import certrack
from certrack.laws import Adaptive, Equations, OwnErrors, Robust, dot, symbol
from certrack.model.distribution import Distribution
from certrack.model.disturbance import DisturbanceFamily, Multisine, register_disturbance
from certrack.references import Bounds, register, trapezoid, triangle
from certrack.testing import (
    DistributionConformance,
    DisturbanceConformance,
    LawConformance,
    ReferenceConformance,
)
from certrack.testing.claim import recursion_errors

CLAIM, ENERGY, TRACKS = (
    "test_obeys_its_error_system",
    "test_its_energy_falls_as_stated",
    "test_tracks",
)


def failing(kit, **attributes):
    """Names of the tests of a kit that fail."""
    case, failed = kit(), set()
    for name, value in attributes.items():
        setattr(case, name, value)
    for name in (name for name in dir(case) if name.startswith("test_")):
        try:
            getattr(case, name)()
        except SkipTest:
            pass
        except Exception:
            failed.add(name)
    return failed


def failing_claims(system, names=(CLAIM, ENERGY, TRACKS)):
    case, failed = LawConformance(), set()
    case.system = system
    for name in names:
        try:
            getattr(case, name)()
        except SkipTest:
            failed.add(f"skipped {name}")
        except AssertionError:
            failed.add(name)
    return failed


def in_place_of(law, base):
    """The base system with a wrong law that has the same gains."""
    gains = {f.name: getattr(base.law, f.name) for f in fields(base.law)}
    return base.replace(law=law(**gains))


class WrongRobust(Robust):
    def equations(self, s):
        u = super().equations(s).u
        g_n, theta = s.parameter("g_n"), s.parameters("theta", s.r)
        return Equations(self.wrong(s, u, g_n, theta))


class WrongAdaptive(Adaptive):
    def equations(self, s):
        return self.wrong(s, super().equations(s))


def wrong_robust(change):
    @dataclass(frozen=True, kw_only=True)
    class Wrong(WrongRobust):
        kind = "wrong"

        def wrong(self, *signals):
            return change(*signals)

    return Wrong


def wrong_adaptive(change):
    @dataclass(frozen=True, kw_only=True)
    class Wrong(WrongAdaptive):
        kind = "wrong"

        def wrong(self, *signals):
            return change(*signals)

    return Wrong


def test_the_right_laws_pass():
    for base in (certrack.load("dual-motor-lean"), known(certrack.load("example1"))):
        short = base.with_settings(duration=5, tail=2.5)
        assert not failing_claims(in_place_of(Robust, short))
    assert not failing_claims(certrack.load("example1"))


ROBUST = {
    "no input": (lambda s, u, g, theta: 0 * u, {CLAIM, ENERGY, TRACKS}),
    "the other sign": (lambda s, u, g, theta: -u, {CLAIM, ENERGY, TRACKS}),
    "no reference": (lambda s, u, g, theta: u.subs(dict.fromkeys(s.Y, 0)), {CLAIM, TRACKS}),
    "no derivative": (lambda s, u, g, theta: u.subs(s.Y[-1], 0), {CLAIM}),
    "times the gain": (lambda s, u, g, theta: (s.nu - dot(s.phi, theta)) * g, {CLAIM}),
    "a little less": (lambda s, u, g, theta: u * (1 - sympy.Rational(1, 10**6)), {CLAIM}),
    "nonlinearity left": (lambda s, u, g, theta: u + s.plant.drift.expr / g, {CLAIM}),
}


@pytest.mark.parametrize("name", ROBUST)
def test_wrong_robust_laws_fail(name):
    change, noticed = ROBUST[name]
    base = (
        known(certrack.load("example1")) if "nonlin" in name else certrack.load("dual-motor-lean")
    )
    base = base.with_settings(duration=5, tail=2.5)
    failed = failing_claims(in_place_of(wrong_robust(change), base))
    assert failed >= noticed, failed


def known(system):
    """The system with the robust law, for known g_n and theta."""
    plant = replace(system.plant, input_gain=2, theta=[2])
    return system.replace(plant=plant, law=Robust(c=(2, 2), feedforward=1))


def flipped(s, equations):
    return Equations(equations.u, tuple((z, -rate) for z, rate in equations.update))


def changed_update(index, change):
    def wrong(s, equations):
        update = list(equations.update)
        z, rate = update[index]
        update[index] = (z, change(s, z, rate))
        return Equations(equations.u, tuple(update))

    return wrong


def frozen_signs(s, equations):
    theta_hat = symbol("theta_hat_1")
    return Equations(equations.u.subs(theta_hat, -theta_hat), equations.update)


ADAPTIVE = {
    "flipped update": (flipped, {ENERGY}),
    "flipped delta": (changed_update(0, lambda s, z, rate: -rate), {ENERGY}),
    "flipped theta": (changed_update(1, lambda s, z, rate: -rate), {ENERGY}),
    "no leakage": (
        changed_update(1, lambda s, z, rate: rate.subs(symbol("law_leak_theta_0"), 0)),
        {ENERGY},
    ),
    "sign of the gain": (
        changed_update(0, lambda s, z, rate: rate.subs(s.sign_g, -s.sign_g)),
        {ENERGY},
    ),
    "sign of theta_hat": (frozen_signs, {CLAIM}),
    "no input": (lambda s, e: Equations(0 * e.u, e.update), {CLAIM}),
}


@pytest.mark.parametrize("name", ADAPTIVE)
def test_wrong_adaptive_laws_fail(name):
    change, noticed = ADAPTIVE[name]
    base = certrack.load("example1")
    failed = failing_claims(in_place_of(wrong_adaptive(change), base), (CLAIM, ENERGY))
    assert failed >= noticed, failed


def test_numbers_at_the_wrong_symbols_fail():

    @dataclass(frozen=True, kw_only=True)
    class Exchanged(Adaptive):
        kind = "exchanged"

        def parameters(self, plant):
            right = super().parameters(plant)
            return {**right, "leak_gain": self.leak_theta, "leak_theta": self.leak_gain}

    base = certrack.load("example1")
    base = base.replace(law=replace(base.law, leak_gain=0.3))
    name = "test_gains_are_those_of_the_fields"
    assert not failing_claims(base, [name])
    assert failing_claims(in_place_of(Exchanged, base), [name]) == {name}


def test_a_law_that_claims_nothing_must_still_track():
    """u = 0 in a class of its own: the claims are skipped, and say so; the run shows it."""

    @dataclass(frozen=True, kw_only=True)
    class Idle(Robust):
        kind = "idle"

        def equations(self, s):
            return Equations(sympy.Integer(0) * s.nu)

        def error_system(self, s):
            return None

    failed = failing_claims(in_place_of(Idle, certrack.load("dual-motor-lean")))
    assert failed == {f"skipped {CLAIM}", f"skipped {ENERGY}", TRACKS}


def test_a_user_s_claim_is_checked():
    """Errors of a law's own, with a filter among them; another rate is refused."""
    system = dynamic_surface()
    assert not failing_claims(system) - {f"skipped {ENERGY}"}

    @dataclass(frozen=True, kw_only=True)
    class Hopeful(type(system.law)):
        kind = "hopeful"

        def error_system(self, s):
            claim = super().error_system(s)
            return OwnErrors(claim.errors, (claim.rates[0], 2 * claim.rates[1]))

    assert CLAIM in failing_claims(in_place_of(Hopeful, system))


@pytest.mark.parametrize(
    "claim",
    [
        lambda c: replace(c, V_rate=c.V_rate - sympy.Rational(1, 1000)),  # falls less than claimed
        lambda c: replace(c, V_rate=c.V_rate + 10**3 * c.V),  # says nothing
        lambda c: replace(c, V=-c.V, V_rate=-c.V_rate),  # is no energy
    ],
)
def test_wrong_claims_of_the_energy_fail(claim):
    @dataclass(frozen=True, kw_only=True)
    class Wrong(Robust):
        kind = "wrong"

        def error_system(self, s):
            return claim(recursion_errors(s, self.coordinates(s.plant)))

    assert failing_claims(in_place_of(Wrong, certrack.load("dual-motor-lean"))) == {ENERGY}


def test_what_cannot_be_tested_here_is_skipped(monkeypatch):
    monkeypatch.setattr("certrack.testing.shared.has_heyoka", lambda: False)
    case = LawConformance()
    case.system = certrack.load("dual-motor-lean")
    for name in ("numpy_and_taylor_forms_agree", "integrators_agree"):
        with pytest.raises(SkipTest, match="needs heyoka"):
            getattr(case, f"test_{name}")()


def made(**changes):
    """A spline with some members replaced."""
    cls = dataclass(frozen=True)(type("Changed", (Spline,), changes))
    register("changed-spline")(cls)
    base = spline().reference
    return cls(base.times, base.points)


def small_bounds(self, order):
    right = Spline.bounds(self, order)
    return Bounds((*right.values[:-1], 0.5 * right.values[-1]), right.origin)


def wrong_slope(self, t, order):
    values = Spline.values(self, t, order)
    return np.array([*values[:1], *(1.01 * values[1:])])


def jumping(self, t, order):
    values = Spline.values(self, t, order)
    values[0] += 0.01 * (t >= 1.5)
    return values


REFERENCES = {
    "bounds too small": ({"bounds": small_bounds}, "test_bounds_hold"),
    "a break is missing": (
        {"breaks": lambda self, a, b: Spline.breaks(self, a, b)[1:]},
        "test_every_break_is_listed",
    ),
    "a wrong derivative": ({"values": wrong_slope}, "test_every_break_is_listed"),
    "values beside the formulas": ({"values": jumping}, "test_formulas_are_those_of_the_values"),
    "a jump": ({"values": jumping}, "test_is_continuous_below_its_order"),
    "no symbols": ({"piece_symbols": ()}, "test_keeps_the_protocol"),
}


@pytest.mark.parametrize("name", REFERENCES)
def test_wrong_references_fail(name):
    changes, noticed = REFERENCES[name]
    assert noticed in failing(ReferenceConformance, reference=made(**changes), duration=5.0)


def test_a_reference_that_no_file_can_hold_fails():
    reference = replace(triangle(0.2, 4.0), fields=())
    failed = failing(ReferenceConformance, reference=reference)
    assert {"test_keeps_the_protocol", "test_survives_a_system_file"} <= failed


class TestTriangle(ReferenceConformance):
    reference = triangle(0.2, 4.0)


class TestTrapezoid(ReferenceConformance):
    reference = trapezoid(0.3, 4.0, 0.5)


class TestMultisine(DisturbanceConformance):
    family = Multisine(3)


@register_disturbance
class Decaying(DisturbanceFamily):
    kind = "decaying-in-tests"

    def numbers(self, population):
        return {"rate": Distribution("uniform", (0.1, 1.0))}

    def pattern(self, number):
        return f"exp(-{number('rate')}*t)"


class TestDecaying(DisturbanceConformance):
    family = Decaying()


class Growing(Decaying):
    def pattern(self, number):
        return f"exp({number('rate')}*(t - 50))"


class Unused(Decaying):
    def pattern(self, number):
        return "sin(t)"


class Zero(Decaying):
    def pattern(self, number):
        return f"0*{number('rate')}"


class Neighbours(Multisine):
    def adjusted(self, draws):
        right = super().adjusted(draws)
        return {name: values * values.mean() for name, values in right.items()}


class Forgetful(Multisine):
    def adjusted(self, draws):
        return {name: v for name, v in super().adjusted(draws).items() if name != "p_0"}


class Restless(Decaying):
    def pattern(self, number):
        self.asked = getattr(self, "asked", 0) + 1
        return f"exp(-{number('rate')}*t)/{self.asked}"


class Unnamed(Decaying):
    def numbers(self, population):
        return {"a rate": Distribution("uniform", (0.1, 1.0))}

    def pattern(self, number):
        return f"0.5 + 0*{len(number('a rate'))}"


DISTURBANCES = {
    Growing(): "test_stays_within_one",
    Unused(): "test_pattern_uses_every_number",
    Zero(): "test_members_differ",
    Neighbours(3): "test_members_do_not_depend_on_each_other",
    Forgetful(3): "test_members_do_not_depend_on_each_other",
    Restless(): "test_pattern_uses_every_number",
    Unnamed(): "test_numbers_are_distributions",
}


@pytest.mark.parametrize("family", DISTURBANCES, ids=lambda family: type(family).__name__)
def test_wrong_disturbances_fail(family):
    case = DisturbanceConformance()
    case.family = family
    with pytest.raises((AssertionError, KeyError, ValueError)):
        getattr(case, DISTURBANCES[family])()


class TestTruncated(DistributionConformance):
    distribution = Distribution("truncnorm", (1.0, 0.5, 0.0, 1.8))


class TestOfScipy(DistributionConformance):
    distribution = Distribution("norm", (), (("loc", 2.0), ("scale", 0.1)))


class TestMeasured(DistributionConformance):
    samples = (1.8, 2.0, 2.0, 2.3, 2.4)
    distribution = Distribution.empirical(samples)


class Backwards(Distribution):
    def quantile(self, p):
        return super().quantile(1 - np.asarray(p))


class Narrow(Distribution):
    def quantile(self, p):
        return super().quantile(0.1 + 0.8 * np.asarray(p))


class Ranked(Distribution):
    def quantile(self, p):
        return super().quantile(np.argsort(np.argsort(p)) / max(len(p) - 1, 1))


class Rounded(Distribution):
    @property
    def written(self):
        return {self.kind: [round(v) for v in self.values]}


DISTRIBUTIONS = {
    Backwards: "test_values_increase_between_its_ends",
    Narrow: "test_values_increase_between_its_ends",
    Ranked: "test_each_value_is_its_own",
    Rounded: "test_survives_a_system_file",
}


@pytest.mark.parametrize("wrong", DISTRIBUTIONS)
def test_wrong_distributions_fail(wrong):
    distribution = wrong("uniform", (0.4, 1.7))
    assert DISTRIBUTIONS[wrong] in failing(DistributionConformance, distribution=distribution)


def test_a_distribution_beside_its_samples_fails():
    samples = tuple(np.random.default_rng(0).normal(1, 0.2, 400).clip(0, 2))
    right = Distribution("truncnorm", (1, 0.2, 0, 2))
    assert not failing(DistributionConformance, distribution=right, samples=samples)
    for wrong in (Distribution("uniform", (0, 2)), Distribution("truncnorm", (1.2, 0.2, 0, 2))):
        failed = failing(DistributionConformance, distribution=wrong, samples=samples)
        assert failed == {"test_is_that_of_its_samples"}

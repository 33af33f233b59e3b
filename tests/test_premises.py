"""Premises of certificates: what is proven, what is only checked, what is contradicted."""

import json
import math
import re
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import certrack
from certrack.certificates import premises, to_document, verify
from certrack.certificates.assumption_1 import uncertain_terms
from certrack.certificates.assumptions import assumptions
from certrack.certificates.cover import smallest_cover
from certrack.certificates.domain import always_defined, conditions, undefined_at
from certrack.certificates.layout import FORMAT_1, digest_of
from certrack.certificates.majorants import ROOT_FACTORS, majorants
from certrack.certificates.sampling import Points, random_points
from certrack.cli import main
from certrack.core.errors import InputError
from certrack.core.expressions import TIME, parse
from certrack.core.lowering import numpy_callable, rows
from certrack.core.rounding import rounded_up
from certrack.loops.stability import linear_loop
from certrack.studies.falsifier.alarm import alarm
from certrack.studies.falsifier.falsify import falsify
from certrack.studies.units import misfits, powers

EXAMPLE = certrack.load("example1")
LEAN = certrack.load("dual-motor-lean")
X = sympy.symbols("x1 x2", real=True)


def invoke(capfd, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    out, err = capfd.readouterr()
    return stop.value.code, out, err


def formula(text):
    return parse("test", text, ["t", "x1", "x2"]).expr


def with_omega(text, k=0, system=EXAMPLE):
    omega = list(system.truth.omega)
    omega[k] = text
    return system.replace(truth=replace(system.truth, omega=tuple(omega)))


def named(system, name):
    (found,) = [premise for premise in premises(system) if premise.name == name]
    return found


# the list


def test_shipped_systems_keep_every_premise_and_most_are_proven():
    for name in certrack.catalog():
        found = premises(certrack.load(name))
        assert not any(premise.contradicted for premise in found), name
        assert {p.name for p in found} >= {"plant", "domain", "reference"}
    assert {p.status for p in premises(EXAMPLE)} == {"proven"}
    assert {p.status for p in premises(LEAN)} == {"proven"}


@pytest.mark.slow
def test_a_sampled_file_assumes_the_continuous_law_and_says_so(capfd, tmp_path):
    """Where no certificate is of the sampled loop: here the law is adaptive."""
    file = str(tmp_path / "sampled.toml")
    certrack.save(EXAMPLE.replace(implementation=certrack.Implementation(period=1e-3)), file)
    code, out, _ = invoke(capfd, "certify", file, "--effort", "fast")
    assert code == 0
    assert "assumed       continuous law, exact states" in out
    _, out, _ = invoke(capfd, "certify", file, "--json", "--effort", "fast")
    (entry,) = [p for p in json.loads(out)["premises"] if p["name"].startswith("continuous")]
    assert entry["status"] == "assumed" and entry["witness"] is None


def test_a_truth_with_states_of_its_own_is_assumed_to_fit():
    found = premises(certrack.load("dual-motor-physical"))
    assert [p.name for p in found][:2] == ["plant", "domain"]
    assert found[0].status == "assumed" and "states of its own" in found[0].detail


def test_constants_count_only_where_they_change_the_plant():
    text = certrack.to_text(LEAN)
    other = certrack.loads(text.replace("[truth.constants]", "[truth.constants]\nJ_L = 0.6"))
    found = named(other, "plant")
    assert found.contradicted and found.witness == {"J_L": 0.6}
    assert "J_L = 0.6" in found.remedy
    assert not certrack.certify(other).verified
    same = certrack.loads(text.replace("[truth.constants]", "[truth.constants]\nJ_L = 0.5"))
    assert named(same, "plant").status == "proven"
    motor = certrack.loads(text.replace("[truth.constants]", "[truth.constants]\nK_M = 5"))
    assert named(motor, "plant").status == "proven"  # K_M stands in the input gain only
    assert named(motor, "input gain").contradicted


def test_a_declared_bound_is_proven_checked_or_contradicted():
    def with_reference(signal, bounds):
        reference = certrack.SymbolicReference(signal, declared=bounds)
        return named(EXAMPLE.replace(reference=reference), "reference")

    assert with_reference("0.2*cos(t)", (0.3, 0.3)).status == "proven"
    assert with_reference("t*exp(-t)", (0.5, 1.0)).status in ("checked", "proven")
    late = with_reference("0.001*t/(1 + 0.0001*t)", (5.1, 1.0))  # 5 at 1e4 s, later up to 10
    assert late.contradicted and late.witness["t"] > 1e4
    assert late.witness["value"] > late.witness["limit"] >= 5.1


def test_irrational_numbers_are_named():
    plant = replace(LEAN.plant, chain=(1, "sqrt(2)", 1))
    found = named(LEAN.replace(plant=plant), "irrational numbers")
    assert found.status == "assumed" and "sqrt(2)" in found.detail


# majorants


PROVABLE = {
    "0.5*sqrt(x1**2 + x2**2)*sin(2*t)": (0.5, 0),
    "0.2*log(1 + x1**2 + x2**2) + 0.1/(1 + t)": (0.2, 0.1),
    "0.01*atan(x1**2 + x2**2)": (0.01, 0),
    "0.999999*tanh(9*sin(2*t) + 3*x1)*(0.3*(sqrt(x1**2 + x2**2 + 1e-8) - 0.0001) + 0.1)": (
        0.3,
        0.1,
    ),
    "3*x1 - 4*x2 + 2": (5, 2),
    "sin(t) + cos(t)": (0, 1.4142135623731),
    "3*abs(x1) + 4*abs(x2)": (5, 0),
    "min(1, max(-1, x1*x2))": (0, 1),
    "x1/(1 + x2**2)": (1, 0),
    "log(3 + x1**2)": (0.47, 1.0987),
    "sqrt(4 + x1**2 + x2**2)": (1, 2),
}


@pytest.mark.parametrize("text", PROVABLE)
def test_majorants_prove_what_is_true(text):
    gamma, beta = PROVABLE[text]
    term = uncertain_terms(with_omega(text))[0]
    wide = replace(term, gamma=Fraction(str(gamma)), beta=Fraction(str(beta)))
    assert wide.proven
    assert wide.exceeded(random_points(2, 20.0, 1)) is None


@pytest.mark.parametrize("text", PROVABLE)
def test_majorants_are_never_below(text):
    points = random_points(2, 20.0, 2)
    f = formula(text)
    values = np.abs(rows(numpy_callable([TIME, X], [f])(points.t, points.x), len(points.t))[0])
    found = majorants(f, X)
    assert found
    for majorant in found:
        limit = sum(float(c) * points.norm**i for i, c in enumerate(majorant))
        assert np.all(values <= limit * (1 + 1e-12))


PIECES = ["x1", "x2", "t", "1", "0.3", "sin(t)", "x1**2", "x1*x2", "sqrt(1 + x2**2)", "exp(-t)"]


@settings(max_examples=60, deadline=None)
@given(
    st.recursive(
        st.sampled_from(PIECES),
        lambda inner: st.one_of(
            st.builds("({0} + {1})".format, inner, inner),
            st.builds("({0} - 2*{1})".format, inner, inner),
            st.builds("({0})*({1})".format, inner, inner),
            st.builds("{1}({0})".format, inner, st.sampled_from(["sin", "tanh", "atan", "abs"])),
            st.builds("log(1 + ({0})**2)".format, inner),
            st.builds("max({0}, {1})".format, inner, inner),
        ),
        max_leaves=5,
    )
)
def test_no_random_formula_passes_its_majorants(text):
    f = formula(text)
    points = random_points(2, 20.0, 3)[np.arange(0, 40_000, 40)]
    with np.errstate(all="ignore"):
        found = rows(numpy_callable([TIME, X], [f])(points.t, points.x), len(points.t))[0]
    for majorant in majorants(f, X):
        limit = sum(float(c) * points.norm**i for i, c in enumerate(majorant))
        finite = np.isfinite(found)
        assert np.all(np.abs(found[finite]) <= limit[finite] * (1 + 1e-9) + 1e-12)


def test_factors_of_slow_functions_hold():
    u = np.geomspace(1e-6, 1e6, 200_001)
    for function, factor in ROOT_FACTORS.items():
        value = np.log1p(u**2) if function is sympy.log else getattr(np, _numpy(function))(u**2)
        assert np.all(np.abs(value) <= float(factor) * u)
    assert np.max(np.log1p(u**2) / u) > 0.804  # 0.81 is no waste


def _numpy(function):
    return {"atan": "arctan"}.get(function.__name__, function.__name__)


def test_a_formula_that_may_have_no_value_is_not_proven():
    for text in ("0.1*sin(1/x1)", "0.1*tanh(log(x1))", "0.1*sin(sqrt(x1))", "0.01*atan(1/t)"):
        term = uncertain_terms(with_omega(text, k=1))[1]
        assert not term.proven
        assert named(with_omega(text, k=1), "w_2").contradicted


# Assumption 1


@pytest.mark.parametrize(
    ("text", "status"),
    [
        ("0.5*x1", "proven"),
        ("0.3*sin(x1) + 0.4*x2", "checked"),
        ("0.500001*x1", "contradicted"),
        ("0.5*x1 + 1e-7", "contradicted"),
        ("x1**2", "contradicted"),
        ("0.0001*t*sin(t)*x1/(1 + abs(x1))", "contradicted"),  # long after the run
        ("0.4*exp(x1)/(1 + exp(x1))*x1", "checked"),  # overflows, but has a value
    ],
)
def test_terms_are_told_apart(text, status):
    assert named(with_omega(text), "w_1").status == status


def test_a_narrow_violation_is_found():
    found = named(with_omega("0.5*x1 + 0.02*exp(-100*(x1 - 3)**2)"), "w_1")
    assert found.contradicted
    assert found.witness["value"] > found.witness["limit"]


COVERS = {
    "0.31*x1*sin(t)": (0.31, math.nan, None),
    "x1**2": (math.nan, math.nan, None),
    "0.6*x1 + 0.2*sin(t)": (math.nan, math.nan, (0.6, 0.2)),
    "0.2*cos(3*t)": (math.nan, 0.2, None),
    "sqrt(abs(x1))": (math.nan, 0.5, None),
    "0": (0.0, 0.0, None),
}


@pytest.mark.parametrize("text", COVERS)
def test_the_smallest_cover(text):
    gamma, beta, both = COVERS[text]
    term = uncertain_terms(with_omega(text))[0]
    term = replace(term, gamma=Fraction(1, 2) if text != "0.31*x1*sin(t)" else Fraction(0))
    points = random_points(2, 20.0, 0)
    found = smallest_cover(term, points)
    for value, right in ((found.gamma, gamma), (found.beta, beta)):
        assert (value is None) == math.isnan(right)
        assert value is None or value == pytest.approx(right, rel=1e-3)
    assert (found.both is None) == (both is None)
    assert both is None or found.both == pytest.approx(both, rel=0.02)


@pytest.mark.parametrize("text", ["0.31*x1*sin(t)", "0.2*log(1 + x1**2) + 0.01", "0.37*x2"])
def test_a_cover_is_enough_and_a_tenth_less_is_not(text):
    term = replace(uncertain_terms(with_omega(text))[0], beta=Fraction(1, 100))
    points = random_points(2, 20.0, 0)
    gamma = smallest_cover(term, points).gamma
    assert replace(term, gamma=Fraction(str(gamma))).exceeded(points) is None
    assert replace(term, gamma=Fraction(str(gamma)) * Fraction(9, 10)).exceeded(points) is not None


# the domain


@pytest.mark.parametrize(
    ("text", "defined", "witness"),
    [
        ("log(1 + x1**2)", True, None),
        ("sqrt(x1**2 + x2**2)", True, None),
        ("asin(sin(x1))", True, None),
        ("1/(2 + sin(x1))", True, None),
        ("log(x1)", False, 0.0),
        ("sqrt(x1 - 2)", False, 0.0),
        ("1/(x1 - 1)", False, 1.0),
        ("1/x2", False, 0.0),
        ("acos(x1/3)", False, 3.0),
        ("tan(x1)", False, math.pi / 2),
        ("(x1 + 5)**1.5", False, 5.0),
    ],
)
def test_where_a_formula_has_a_value(text, defined, witness):
    f = formula(text)
    assert always_defined(f, X) == defined
    found = undefined_at(f, X, random_points(2, 20.0, 0))
    assert (found is None) == defined
    if not defined:
        condition, where = found
        assert condition in conditions(f)
        # the nearest of the points found, and hardly farther than the nearest that there is
        assert float(where.norm[0]) <= max(1.1 * witness, witness + 2e-3) + 20 * (text == "tan(x1)")


def test_an_underflow_is_no_failure():
    f = formula("log(exp(-x1**2) + exp(-x2**2))")
    assert not always_defined(f, X)
    assert undefined_at(f, X, random_points(2, 20.0, 0)) is None


# certificates


def test_format_1_is_verified_unless_its_truth_breaks_a_premise():
    found = certrack.certify(LEAN)
    body = to_document(LEAN, *found.quadratic)
    assert body["format"].endswith("/2")
    old = {key: value for key, value in body.items() if key not in ("premises", "sha256")}
    old |= {"format": FORMAT_1, "assumptions": assumptions(LEAN)}
    assert verify(old | {"sha256": digest_of(old)}).verified
    wrong = LEAN.replace(truth=replace(LEAN.truth, input_gain=3.0))
    old["system"] = certrack.to_text(wrong)
    verdict = verify(old | {"sha256": digest_of(old)})
    assert not verdict.verified
    assert "input gain" in verdict.reason and verdict.premises[0].witness["true"] == 3.0


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p[0].update(status="checked"),
        lambda p: p[3].update(status="assumed"),
        lambda p: p[0].update(extra=1),
        lambda p: p[0].pop("remedy"),
        lambda p: p.append(p[0]),
        lambda p: p.reverse(),
        lambda p: p[0].update(witness={"t": 0}),
        lambda p: p[0].update(detail="anything"),
    ],
)
def test_premises_of_a_certificate_cannot_be_changed(change):
    body = to_document(LEAN, *certrack.certify(LEAN).stages)
    change(body["premises"])
    assert not verify(body | {"sha256": digest_of(body)}).verified


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"made_by"', '"claim"', 1),
        lambda text: text.replace('"alpha"', '"alpha": "1",\n   "alpha"', 1),
        lambda text: text.replace('"witness": null', '"witness": NaN', 1),
        lambda text: text.replace('"witness": null', '"witness": Infinity', 1),
        lambda text: text.replace('"shift": "0"', '"shift": 0', 1),
        lambda text: text.replace('"shift": "0"', '"shift": "0", "note": "x"', 1),
        lambda text: text[:-2] + ', "note": 1}',
    ],
)
def test_what_the_page_does_not_define_is_refused(change, tmp_path):
    path = tmp_path / "cert.json"
    found = certrack.certify(LEAN)
    certrack.certificates.save_certificate(LEAN, found.quadratic, path)
    text = path.read_text()
    assert change(text) != text
    path.write_text(change(text))
    with pytest.raises(InputError):
        verify(path)


@pytest.mark.parametrize("shift", ["0.1", "0.0", "-0"])
def test_a_shift_that_no_stage_uses_is_refused(shift):
    found = certrack.certify(EXAMPLE, effort="fast")
    for i in (0, 2):
        body = to_document(EXAMPLE, *found.stages)
        body["proof"][i]["shift"] = shift
        verdict = verify(body | {"sha256": digest_of(body)})
        assert not verdict.verified and "shift" in verdict.reason


def test_efforts_find_the_same_today():
    found = {
        effort: certrack.certify(LEAN, effort=effort) for effort in ("fast", "default", "high")
    }
    assert len({entry.best.bound for entry in found.values()}) == 1
    with pytest.raises(InputError, match="effort"):
        certrack.certify(LEAN, effort="heroic")


# the falsifier's alarm


def test_a_long_transient_is_no_alarm():
    system = LEAN.with_settings(x0=(5.0, 0.0, 0.0, 0.0), duration=3.0, tail=0.2)
    found = falsify(system, budget=100)
    assert found.own_run and found.worst_error > found.against.bound
    assert found.alarm is None


def test_omega_that_leaves_its_bound_on_the_run_is_a_broken_premise():
    system = with_omega("0.1*cos(t) + 2*cos(3*t)", 3, LEAN)
    found = falsify(system, budget=100)
    assert found.alarm == "premise" and found.reason.startswith("w_4")
    assert not any(entry.verified for entry in found.certificates.values())


def test_a_run_beyond_its_tube_without_a_broken_premise_is_a_defect(monkeypatch):
    found, run = certrack.certify(LEAN), certrack.simulate(LEAN)
    assert alarm(LEAN, LEAN, run, found.best, found.quadratic) is None
    assert alarm(LEAN, LEAN, run, found.semidefinite, found.quadratic) is None
    wrong = replace(found.peak, bound=found.peak.bound / 10)  # as a wrong program would claim
    assert alarm(LEAN, LEAN, run, wrong, found.quadratic).kind == "defect"
    false = replace(found.semidefinite, bound=found.semidefinite.bound / 10)
    assert alarm(LEAN, LEAN, run, false, found.quadratic) is None  # below the true tube
    constant = "certrack.studies.falsifier.alarm.tube_of"
    monkeypatch.setattr(constant, lambda *_: lambda t: np.full(len(t), false.bound))
    raised = alarm(LEAN, LEAN, run, false, found.quadratic)
    assert raised.kind == "defect" and "report" in raised.reason


def test_without_a_tube_a_short_run_is_run_on_before_it_is_an_alarm():
    """A peak gain has a bound where the quadratic proof, and so the tube, may have none."""
    system = LEAN.with_settings(x0=(5.0, 0.0, 0.0, 0.0), duration=1.0)
    peak, run = certrack.certify(LEAN, "fast").peak, certrack.simulate(system)
    assert run.metrics.tail_error > peak.bound
    assert alarm(system, system, run, peak, ()) is None
    wrong = replace(peak, bound=peak.bound / 10)
    assert alarm(system, system, run, wrong, ()).kind == "defect"
    other = with_omega("0.1*sin(t)", 3, system)  # a case of the search begins without an error
    assert alarm(system, other, run, peak, ()).kind == "defect"


# check


def test_check_says_how_far_to_widen_gamma(capfd, tmp_path):
    system = with_omega("0.3012*x1 + 0.004*sin(t)", k=1)
    path = tmp_path / "narrow.toml"
    certrack.save(system, path)
    code, out, err = invoke(capfd, "check", str(path))
    assert code == 1
    assert "widen gamma[1] to 0.31" in err
    assert "gamma = 0.31 with beta = 0.1" in out
    plant = replace(system.plant, uncertainty=replace(system.plant.uncertainty, gamma=(0.5, 0.31)))
    assert not certrack.check(system.replace(plant=plant)).contradicted


def test_bounds_of_single_states_are_proven_and_not_one_beyond():
    uncertainty = replace(
        LEAN.plant.uncertainty,
        gamma=(0,) * 4,
        beta=(0, 0.5, 0, 0),
        Delta=((0,) * 4, (0, 0, 0, 0.25), (0,) * 4, (0,) * 4),
    )

    def status(text):
        omega = ["0", text, "0", "0"]
        truth = replace(LEAN.truth, omega=tuple(omega))
        system = LEAN.replace(plant=replace(LEAN.plant, uncertainty=uncertainty), truth=truth)
        return next(p.status for p in certrack.check(system).premises if p.name == "w_2")

    for text in ("x4/4", "-0.25*abs(x4)", "sin(t)*x4/4 + cos(x1)/2", "x4/8 - sin(x4)/8"):
        assert status(text) == "proven", text
    for text in ("0.251*x4", "x3/4", "x4/4 + 0.51*cos(t)", "x4/4 + 0.001*x1"):
        assert status(text) == "contradicted", text


def test_check_says_what_makes_poles_far_faster_than_the_gains():
    chain = tuple(1000 * float(g) for g in (1, 12, 1))
    stiff = LEAN.replace(plant=replace(LEAN.plant, chain=(1, chain[1], 1)))

    def remedy(system):
        return next(f.remedy for f in certrack.check(system).findings if f.name == "poles")

    assert "law.coupling = 0.5" in remedy(stiff)
    assert remedy(LEAN) == remedy(stiff.replace(law=replace(stiff.law, coupling=0.5))) == ""


def test_check_knows_the_period():
    drive = certrack.load("dual-motor-drive")

    def findings(**changes):
        implementation = replace(drive.implementation, **changes)
        found = certrack.check(drive.replace(implementation=implementation))
        return {finding.name: finding.status for finding in found.findings}, found

    status, found = findings()
    assert found.sound and status["poles x period"] == status["sampled stability"] == "fine"
    status, found = findings(period=0.1)
    assert status["poles x period"] == "warning"
    assert status["sampled stability"] == "fault" and not found.sound
    (remedy,) = (f.remedy for f in found.findings if f.name == "poles x period")
    advised = float(re.search(r"a period of (\S+) s or less", remedy)[1])
    for period, expected in ((advised, "fine"), (1.1 * advised, "note")):
        status, found = findings(period=period)
        assert status["poles x period"] == expected, "the delay counts in what is advised"
    loop, delay = linear_loop(drive), drive.implementation.delay
    edge = brentq(lambda period: loop.radius(period, delay) - 1, 0.01, 0.1)
    assert findings(period=0.98 * edge)[0]["sampled stability"] == "fine"
    assert findings(period=1.02 * edge)[0]["sampled stability"] == "fault"


def test_check_knows_leaks_and_quanta():
    implementation = certrack.Implementation(period=0.01, saturation=(-1, 1), input_quantum=0.5)
    law = replace(EXAMPLE.law, Gamma=[1000.0], leak_theta=0.15)
    system = EXAMPLE.replace(law=law, implementation=implementation)
    names = {(f.name, f.status): f for f in certrack.check(system).findings}
    leak = names["leak x period", "warning"]
    assert "= 1.5 > 1" in leak.detail and "exact_leak" in leak.remedy
    exact = system.replace(implementation=replace(implementation, update="exact_leak"))
    assert certrack.check(exact).sound
    quantum = names["quantum of u", "warning"]
    assert "0.5" in quantum.detail  # g_n q/2 = 2 x 0.25
    coarse = replace(implementation, measurement_quantum=(0.1, 0.0))
    names = {f.name: f for f in certrack.check(exact.replace(implementation=coarse)).findings}
    step = abs(EXAMPLE.controller.coordinates.nu_x[0]) * 0.1 / 2
    assert f"{step:.4g}" in names["quantum of x1"].detail


def test_check_groups_estimates_that_leak_together():
    """Gamma leak_theta of the coupled pair has the eigenvalues 3 and 1; delta_hat leaks alone."""
    law = replace(EXAMPLE.law, Gamma=((20, 10), (10, 20)), leak_theta=0.1, theta0=(0, 0))
    system = EXAMPLE.replace(
        plant=replace(EXAMPLE.plant, regressor=("x1", "x2")),
        law=replace(law, gain_rate=5.0, leak_gain=0.4),
        truth=replace(EXAMPLE.truth, theta=(1, 2)),
        implementation=certrack.Implementation(period=0.01),
    )
    leaks = [f.detail for f in certrack.check(system).findings if f.name == "leak x period"]
    assert leaks == [
        "leak of delta_hat 2 1/s x period = 0.02",
        "leak of theta_hat_1, theta_hat_2 3 1/s x period = 0.03",
    ]
    silent = system.replace(law=certrack.Classic(c=law.c, Gamma=law.Gamma))
    assert all(f.name != "leak x period" for f in certrack.check(silent).findings)


def test_units_that_do_not_fit_are_named():
    assert powers("rad/s^2") == powers("rad s^-2") == powers("rad·s⁻²") == {"rad": 1, "s": -2}
    assert powers("1") == {} and powers("kg m^2/s") == {"kg": 1, "m": 2, "s": -1}
    assert powers("?") is None
    assert misfits(("m", "m/s", "V"), (1.0,)) == []
    assert misfits(("mm", "m/s", "V"), (1.0,)) == [(0, "mm/s")]
    assert misfits(("m", "N", "V"), (3.0,)) == []  # g_1 carries the unit
    plant = replace(LEAN.plant, units=("deg", "rad/s", "rad", "rad/s", "N m"))
    found = certrack.check(LEAN.replace(plant=plant))
    (unit,) = [f for f in found.findings if f.name == "units"]
    assert unit.status == "warning" and "deg/s" in unit.detail


def test_printed_bounds_of_the_reference_are_rounded_up():
    found = named(LEAN, "reference")
    assert "0.0750001" in found.detail  # 0.075 as a double that was rounded up
    assert rounded_up(repr(0.1), 6) == "0.1"


def test_points_include_the_origin_axes_and_late_times():
    points = random_points(3, 10.0, 0)
    assert (points.norm == 0).sum() > 100
    assert ((points.x != 0).sum(axis=0) == 1).sum() > 5000
    assert points.t.max() > 1e4 and (points.t == 0).sum() > 1000
    assert isinstance(points[3], Points) and points[3].x.shape == (3, 1)


RANGED = """
[plant]
states = ["x1", "x2"]
chain = [1]
drift = "-d*sqrt(3)*x2 - k*x1"
gain_sign = 1
input_gain = 1
[plant.constants]
k = 'sqrt(2)'
d = 1
[plant.ranges]
k = ["1.2", "1.6"]
d = ["0.6666666666", "4/3"]
[law]
kind = "robust"
c = [1, 1]
[reference]
signal = "sin(t)"
[truth]
input_gain = 1
[simulation]
x0 = [0, 0]
duration = 1
"""


def test_irrational_nominal_values_and_numbers_of_drift_are_named():
    found = named(certrack.loads(RANGED), "irrational numbers")
    assert "k = sqrt(2)" in found.detail and "sqrt(3)" in found.detail
    rational = certrack.loads(RANGED.replace("'sqrt(2)'", "1.41").replace("sqrt(3)", "1.73"))
    assert "irrational numbers" not in [premise.name for premise in premises(rational)]
    unranged = certrack.loads(RANGED.split("[plant.ranges]")[0] + RANGED[RANGED.index("[law]") :])
    assert "irrational numbers" not in [premise.name for premise in premises(unranged)]


def test_ranges_are_printed_outward():
    found = named(certrack.loads(RANGED), "plant")
    assert "k in [1.2, 1.6], d in [0.666666, 1.33334]" in found.detail

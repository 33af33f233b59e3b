"""Claims that were false once: each is a true bound now, or said to be contradicted."""

import hashlib
import json
from dataclasses import dataclass, fields

import flint
import numpy as np
import pytest
import sympy

import certrack
from certrack.certificates.ranges.kernels import _block
from certrack.certificates.start import _turns
from certrack.core.expressions import TIME
from certrack.laws.adaptive import Adaptive

PLANT = """
title = "two states"
[plant]
states = ["q", "v"]
chain = [1]
linear = [[0]]
gain_sign = 1
{plant}
[truth]
{truth}
[reference]
signal = "{signal}"
[law]
kind = "{kind}"
c = [2, 2]
feedforward = 1
{law}
[simulation]
x0 = [0, 0]
duration = 40
"""

NO_W = "[plant.uncertainty]\ntau = [0, 0]\ngamma = [0, 0]\nbeta = [0, 0.001]"
ROBUST = {"kind": "robust", "law": "", "signal": "sin(t)"}
ADAPTIVE = {
    "kind": "adaptive",
    "law": "delta0 = 1\ngain_rate = 0.2\nleak_gain = 1\nleak_theta = 1",
    "signal": "sin(t)",
}

WITH_D = (
    'drift = "-d*v"\ninput_gain = 1\n[plant.constants]\nd = 1\n[plant.ranges]\nd = [0.9, 1.1]\n'
)

#: What was certified, and exceeded by the file's own run.
BOUNDED = {
    "Delta and ranges": {
        **ROBUST,
        "plant": WITH_D
        + "[plant.uncertainty]\ntau = [0, 1]\ngamma = [0, 0]\nbeta = [0, 0.01]\n"
        + "Delta = [[0, 0], [3, 0]]",
        "truth": 'input_gain = 1\nomega = [0, "3*q"]',
    },
    "S and ranges": {
        **ROBUST,
        "plant": WITH_D
        + "[plant.uncertainty]\ntau = [0, 1]\ngamma = [0, 0.2]\nbeta = [0, 0.01]\nS = [10, 10]",
        "truth": 'input_gain = 1\nomega = [0, "2*q"]',
    },
    "the true theta": {
        **ADAPTIVE,
        "plant": 'regressor = ["1"]\ntheta = [0]\n' + WITH_D + NO_W,
        "truth": "input_gain = 1\ntheta = [50]",
    },
    "theta by a true constant": {
        **ADAPTIVE,
        "plant": 'regressor = ["1"]\n' + WITH_D.replace("d = 1", "d = 1\nf = 0") + NO_W,
        "truth": 'input_gain = 1\ntheta = ["f*d"]\nconstants = {f = 50}',
    },
}


def made(case):
    text = PLANT.format(**case)
    return certrack.loads(text)


@pytest.mark.parametrize("name", BOUNDED)
def test_the_own_run_keeps_the_bound(name):
    system = made(BOUNDED[name])
    found = certrack.certify(system)
    assert found.verified
    assert certrack.simulate(system).metrics.tail_error <= found.best.bound


FORMULA_OF_P = '[plant.constants]\np = {p}\nr = "p"\n'

#: What was proven of a truth that is another.
CONTRADICTED = {
    "omega by a constant that follows another": (
        "w_2",
        {
            **ROBUST,
            "plant": "input_gain = 1\n"
            + FORMULA_OF_P.format(p=1)
            + "[plant.uncertainty]\ntau = [0, 1]\ngamma = [0, 0]\nbeta = [0, 1]",
            "truth": 'input_gain = 1\nomega = [0, "r"]\nconstants = {p = 10}',
        },
    ),
    "a drift that differs for negative states": (
        "plant",
        {
            **ROBUST,
            "plant": 'drift = "p*max(-q, 0)"\ninput_gain = 1\n[plant.constants]\np = 0\n' + NO_W,
            "truth": "input_gain = 1\nconstants = {p = 5}",
        },
    ),
    "a constant that no longer follows": (
        "plant",
        {
            **ROBUST,
            "plant": 'drift = "p*v - r*v"\ninput_gain = 1\n'
            + FORMULA_OF_P.format(p=1)
            + "[plant.ranges]\np = [-4, 6]\n"
            + NO_W,
            "truth": "input_gain = 1\nconstants = {p = 6, r = 1}",
        },
    ),
    "a gain that does not follow the ranges": (
        "input gain",
        {
            **ADAPTIVE,
            "plant": 'input_gain = "1/J"\n[plant.constants]\nJ = 0.5\n[plant.ranges]\n'
            + "J = [0.4, 0.6]\n"
            + NO_W,
            "truth": "input_gain = 0.05",
        },
    ),
}


@pytest.mark.parametrize("name", CONTRADICTED)
def test_the_truth_contradicts_the_premise(name):
    premise, case = CONTRADICTED[name]
    found = certrack.certify(made(case), effort="fast")
    assert [broken.name for broken in found.contradicted] == [premise]
    assert not found.verified and found.stages == ()


def test_a_bound_that_is_a_formula_is_not_left_out_with_ranges():
    """The certificates of ranges read gamma, Delta and beta alone, which are zero beside it."""

    def system(bound):
        plant = f"{WITH_D}[plant.uncertainty]\ntau = [0, 1]\ngamma = [0, 0]\nbeta = [0, 0]\n{bound}"
        return made({**ROBUST, "plant": plant, "truth": 'input_gain = 1\nomega = [0, "5*sin(t)"]'})

    formula = system('bound = ["", "5 + 0.1*v**2"]')
    found = certrack.certify(formula, "fast")
    assert not found.verified and not found.best.exists
    assert "plant.uncertainty.bound" in found.peak.reason
    quiet = system("").replace(truth=formula.truth.__class__(input_gain=1, omega=(0, 0)))
    document = certrack.certificates.to_document(formula, *certrack.certify(quiet, "fast").stages)
    verdict = certrack.certificates.verify(document)
    assert not verdict.verified and "plant.uncertainty.bound" in verdict.reason


def test_constants_that_vary_need_one_cell():
    system = made({**BOUNDED["S and ranges"]})
    stages = certrack.certify(system).stages
    assert len(stages) > 1
    document = certrack.certificates.to_document(system, *stages)
    text = document["system"].replace(
        "[plant.uncertainty]", "[plant.uncertainty]\nconstants_vary = true"
    )
    document["system"] = text
    found = certrack.certificates.premises(certrack.loads(text))
    document["premises"] = [premise.record() for premise in found]
    content = {key: value for key, value in document.items() if key != "sha256"}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    verdict = certrack.certificates.verify(content | {"sha256": digest})
    assert not verdict.verified and "need one cell" in verdict.reason


@pytest.mark.parametrize("signal", ["sin(abs(t))", "tanh(abs(t))", "max(t, 0)*exp(-t)"])
def test_the_tube_begins_with_the_derivative_from_the_right(signal):
    system = made(
        {**ROBUST, "plant": "input_gain = 1\n" + NO_W, "truth": "input_gain = 1"}
        | {"signal": signal}
    )
    tube = certrack.certify(system).tube
    run = certrack.simulate(system, duration=10)
    t = np.linspace(0, 10, 2001)
    error = run.trajectory.interpolate(t)[0] - system.reference.values(t, 0)[0]
    assert (np.abs(error) <= tube(t) + 1e-9).all()


def test_a_sign_that_turns_at_the_start_proves_no_tube():
    t, start = TIME, {TIME: flint.arb(0)}
    assert _turns(sympy.sign(sympy.tanh(t)) * sympy.cos(t), start)
    assert not _turns(sympy.sign(1 + t) * sympy.cos(t), start)


@dataclass(frozen=True, kw_only=True)
class StartsElsewhere(Adaptive):
    kind = "starts-elsewhere"

    def initial_states(self, plant):
        return {"delta_hat": 1.0, "theta_hat_1": 5000.0}


def test_the_tube_counts_where_a_law_starts_its_estimates():
    case = {
        **ADAPTIVE,
        "plant": 'regressor = ["1"]\ntheta = [0]\ninput_gain = 1\n' + NO_W,
        "truth": "input_gain = 1\ntheta = [0]",
    }
    system = made(case).with_settings(duration=10)
    gains = {entry.name: getattr(system.law, entry.name) for entry in fields(system.law)}
    system = system.replace(law=StartsElsewhere(**gains))
    run, tube = certrack.simulate(system), certrack.certify(system).tube
    t = np.linspace(0, 10, 2001)
    error = run.trajectory.interpolate(t)[0] - system.reference.values(t, 0)[0]
    assert (np.abs(error) <= tube(t)).all()


def test_a_cell_whose_sign_is_not_certain_is_not_too_small():
    """k(0) in [-0.2, 0], k(h) in [0.9, 1.1]: the integral of |k| may be 0.55."""
    k = np.array([[[-0.1]], [[1.0]]])
    zero = np.zeros((1, 1, 1))
    assert _block(1.0, k, np.full_like(k, 0.1), zero, zero)[0, 0] >= 0.55


@pytest.mark.parametrize("ends", ["[-0.5, 0.6]", "[0, 0.6]"])
def test_a_gain_that_may_vanish_is_refused_when_the_file_is_loaded(ends):
    case = {
        **ROBUST,
        "plant": f'input_gain = "1/J"\n[plant.constants]\nJ = 0.5\n[plant.ranges]\nJ = {ends}\n'
        + NO_W,
        "truth": 'input_gain = "1/J"',
    }
    with pytest.raises(certrack.InputError, match=r"ranges.J: plant.input_gain = 1/J must be"):
        made(case)


def test_members_that_do_not_follow_are_not_held_against_the_certificate():
    case = {
        **ROBUST,
        "plant": 'input_gain = "1/J"\n[plant.constants]\nJ = 0.5\n[plant.ranges]\nJ = [0.4, 0.6]\n'
        + NO_W,
        "truth": "input_gain = 2",
    }
    found = certrack.ensemble(made(case), 16, method="lockstep")
    assert found.limit is None and "truth.input_gain does not follow" in found.limit_origin
    follows = made(case | {"truth": 'input_gain = "1/J"\nconstants = {J = 0.45}'})
    found = certrack.ensemble(follows, 16, method="lockstep")
    assert found.limit_origin == "certificate"
    assert found.violations()["count"] == 0

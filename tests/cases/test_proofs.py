"""Inputs whose certificates were false, missing without a true reason, or a traceback."""

import json
import runpy
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import flint
import numpy as np
import pytest

import certrack
from certrack.certificates import certify_semidefinite, verify
from certrack.certificates.arithmetic import rational
from certrack.certificates.document import to_document
from certrack.certificates.exact import failed_condition, prove, squared_bound
from certrack.certificates.formulation import error_problem
from certrack.certificates.layout import digest_of
from certrack.certificates.semidefinite import SemidefiniteProgram, best_solution
from certrack.cli import main
from certrack.core.errors import InputError

INPUTS = Path(__file__).parents[1] / "data" / "cases"


def text_of(name):
    return (INPUTS / f"{name}.toml").read_text()


@pytest.fixture
def run(capfd):
    def command(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(v) for v in arguments])
        out, err = capfd.readouterr()
        return SimpleNamespace(exit_code=end.value.code, stdout=out, stderr=err)

    return command


def one_line(done):
    return done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


@pytest.mark.parametrize("name", ["indefinite-gamma", "singular-gamma"])
def test_a_gamma_that_is_not_positive_definite_is_refused_when_it_is_loaded(name, run):
    with pytest.raises(InputError, match="must be positive definite"):
        certrack.load(INPUTS / f"{name}.toml")
    for verb in ("certify", "simulate"):
        done = run(verb, INPUTS / f"{name}.toml")
        assert done.exit_code == 2
        assert one_line(done)
        assert "law.Gamma" in done.stderr


def with_gamma(name, Gamma):
    """The case with another Gamma; every entry as a text of the file."""
    rows = ", ".join(f"[{', '.join(row)}]" for row in Gamma)
    lines = text_of(name).splitlines()
    i = next(i for i, line in enumerate(lines) if line.startswith("Gamma"))
    return "\n".join([*lines[:i], f"Gamma = [{rows}]", *lines[i + 1 :]])


def singular_family(count=60):
    """Matrices of two-digit decimals with determinant zero: i k = j^2."""
    triples = (
        (i, j, i_k)
        for i, j in product(range(10, 100), repeat=2)
        if j * j % i == 0 and 10 <= (i_k := j * j // i) < 100 and i != j
    )
    some = list(triples)[:count]
    return [[[f"{i / 10}", f"{j / 10}"], [f"{j / 10}", f"{k / 10}"]] for i, j, k in some]


def test_floats_take_some_singular_matrices_for_positive_definite_and_we_take_none():
    family = singular_family()
    assert len(family) == 60
    fooled = [np.linalg.eigvalsh(np.array(m, dtype=float)).min() > 0 for m in family]
    assert sum(fooled) >= 5
    for Gamma in family:
        with pytest.raises(InputError, match="must be positive definite"):
            certrack.loads(with_gamma("singular-gamma", Gamma))


def test_a_little_more_on_the_diagonal_makes_every_one_of_them_positive_definite():
    """By 1e-25, which no float tells from zero."""
    for (a, b), (_, d) in singular_family()[::6]:
        larger = d + "0" * 24 + "1"
        system = certrack.loads(with_gamma("singular-gamma", [[a, b], [b, larger]]))
        assert error_problem(system, rational).adaptation.gamma_is_positive_definite()


def test_a_nearly_singular_gamma_has_no_bound_for_the_true_reason():
    nearly = with_gamma("singular-gamma", [["0.1", "0.3"], ["0.3", "0.9" + "0" * 24 + "1"]])
    found, _ = certify_semidefinite(certrack.loads(nearly))
    assert "forget too slowly" in found.reason
    wider = with_gamma("singular-gamma", [["0.1", "0.3"], ["0.3", "0.90001"]])
    assert certify_semidefinite(certrack.loads(wider))[0].verified


def test_the_exact_check_refuses_an_indefinite_gamma():
    """A proof for a good Gamma is none for a bad one, and none is found for a bad one."""
    good = certrack.loads(with_gamma("singular-gamma", [["1.0", "0.3"], ["0.3", "0.9"]]))
    problem = error_problem(good, rational)
    _, proof = certify_semidefinite(good)
    assert failed_condition(problem, proof) == ""
    rows = [["1.35248e16", "1.09953e16"], ["1.09953e16", "8938884278510587.0"]]
    Gamma = np.array([[rational(float(v)) for v in row] for row in rows], dtype=object)
    assert Gamma[0, 0] * Gamma[1, 1] < Gamma[0, 1] ** 2
    assert np.linalg.eigvalsh(Gamma.astype(float)).min() > 0
    bad = replace(problem, adaptation=replace(problem.adaptation, Gamma=Gamma))
    assert failed_condition(bad, proof) == "Gamma is not positive definite"
    assert squared_bound(bad, proof) is None
    solution = best_solution(SemidefiniteProgram(bad.in_floats()))
    assert solution is None or prove(bad, solution) is None
    skew = Gamma + np.array([[0, flint.fmpq(1)], [0, 0]], dtype=object)
    bad = replace(problem, adaptation=replace(problem.adaptation, Gamma=skew))
    assert failed_condition(bad, proof) == "Gamma is not positive definite"


def test_a_certificate_file_with_an_indefinite_gamma_is_refused():
    good = certrack.loads(with_gamma("singular-gamma", [["1.0", "0.3"], ["0.3", "0.9"]]))
    _, proof = certify_semidefinite(good)
    document = to_document(good, proof)
    assert verify(document).verified
    document["system"] = document["system"].replace("[0.3, 0.9]]", "[0.3, 0.09]]")
    document["sha256"] = digest_of(document)
    with pytest.raises(InputError, match="positive definite"):
        verify(document)


def test_a_law_with_half_the_input_has_no_certificate(capsys):
    case = runpy.run_path(str(INPUTS / "subclass.py"))
    found = case["c"]
    assert not found.best.exists
    assert not found.best.verified
    assert "its u is another" in found.semidefinite.reason
    assert "certified semidefinite inf False" in capsys.readouterr().out


def test_the_unit_of_time_changes_no_bound():
    bounds = [
        certify_semidefinite(certrack.loads(text_of(name)))[0]
        for name in ("cert_unit_s", "cert_unit_slow")
    ]
    assert all(bound.verified for bound in bounds)
    assert [round(b.bound, 4) for b in bounds] == [0.2615, 0.2615]
    assert bounds[0].bound == pytest.approx(bounds[1].bound, rel=1e-6)


@pytest.mark.parametrize("name", ["bound-1e13", "certify-beta-1e20"])
def test_large_numbers_have_a_bound(name, run):
    done = run("certify", INPUTS / f"{name}.toml", "--json")
    assert done.exit_code == 0
    told = json.loads(done.stdout)
    assert told["semidefinite"]["verified"]
    largest = {"bound-1e13": 1e15, "certify-beta-1e20": 1e20}[name]
    assert 1e-4 * largest < told["semidefinite"]["bound"] < 10 * largest


def test_numbers_whose_squares_overflow_have_none_and_the_reason_is_true(run):
    done = run("certify", INPUTS / "certify-beta-1e160.toml", "--require")
    assert done.exit_code == 1
    assert one_line(done)
    assert "leave the range of floating point" in done.stderr


def test_a_certificate_with_numbers_of_any_size_is_checked_in_one_line(run):
    done = run("verify", INPUTS / "cert-bound-1e59.json")
    assert done.exit_code in (0, 1)
    assert one_line(done) or done.exit_code == 0

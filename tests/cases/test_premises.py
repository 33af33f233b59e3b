"""Files whose own truth breaks what a certificate takes for true, and files made to deceive."""

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from pace import within

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.assumption_1 import uncertain_terms
from certrack.certificates.premise import contradicted
from certrack.certificates.premises_of_truth import premises
from certrack.certificates.sampling import Points
from certrack.cli import main
from certrack.core.errors import InputError
from certrack.studies.falsifier.falsify import falsify

CASES = Path(__file__).parent.parent / "data" / "cases"


def path(name):
    return CASES / name


def invoke(capfd, *arguments):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    out, err = capfd.readouterr()
    return stop.value.code, out, err


#: File, the premise that its own truth breaks, and what the witness says.
CONTRADICTED = {
    "theta": ("theta", {"true": [5.0], "assumed": [1.0]}),
    "robust-wrong-gain": ("input gain", {"true": 3.0, "assumed": 20.0}),
    "domain-log": ("domain", None),
    "viol": ("w_2", None),
    "cubic-fast": ("w_2", None),
    "undefined_at_zero": ("w_2", None),
}


@pytest.mark.parametrize("name", CONTRADICTED)
def test_nothing_is_verified_where_the_truth_breaks_a_premise(capfd, name, tmp_path):
    premise, witness = CONTRADICTED[name]
    file, out = str(path(f"{name}.toml")), tmp_path / "cert.json"
    code, text, err = invoke(capfd, "certify", file, "--json", "--out", str(out))
    found = json.loads(text)
    assert code == 1
    assert not out.exists()
    assert found["verified"] is False and found["best"] is None and found["tube"] is None
    kinds = ("published", "corrected", "rate", "semidefinite", "cascade", "peak")
    assert not any(found[kind]["verified"] for kind in kinds)
    (broken,) = [entry for entry in found["premises"] if entry["status"] == "contradicted"]
    assert broken["name"] == premise
    assert broken["remedy"]
    assert witness is None or broken["witness"] == witness
    assert f"premise contradicted: {premise}" in err
    code, text, _ = invoke(capfd, "certify", file)
    assert code == 1
    assert "exactly " not in text.replace("exactly as", "")
    code, _, err = invoke(capfd, "check", file, "--json")
    assert code == 1
    assert f"premise contradicted: {premise}" in err


@pytest.mark.parametrize("name", CONTRADICTED)
def test_a_certificate_with_a_broken_premise_is_refused(name):
    system = certrack.load(path(f"{name}.toml"))
    with pytest.raises(InputError, match="the truth contradicts one"):
        to_document(system, certrack.certify(system).proof)


def test_what_breaks_a_premise_only_faster_than_the_axis_runs_is_certified_from_x0(capfd, tmp_path):
    """3 v^3 passes 0.2 v + 0.1 at 0.3897; the level set from x0 keeps |v| below 0.336."""
    out = tmp_path / "cert.json"
    code, text, _ = invoke(capfd, "certify", str(path("cubic.toml")), "--json", "--out", str(out))
    found = json.loads(text)
    assert code == 0 and found["verified"] and found["starts_box"] > 0.001
    names = [entry["name"] for entry in found["premises"]]
    assert "w_2 in the region" in names and "w_2" not in names
    code, text, _ = invoke(capfd, "verify", str(out))
    assert code == 0 and "from simulation.x0" in json.loads(out.read_text())["claim"]


@pytest.mark.parametrize("name", ["viol", "cubic"])
def test_a_witness_is_a_point_one_can_work_with(name):
    system = certrack.load(path(f"{name}.toml"))
    (broken,) = contradicted(premises(system))
    x, t = broken.witness["x"], broken.witness["t"]
    omega = {"viol": abs(0.5 * math.sin(9 * t)), "cubic": abs(3 * x[1] ** 3)}[name]
    allowed = 0.2 * math.hypot(*x) + 0.1
    assert omega == pytest.approx(broken.witness["value"])
    assert allowed == pytest.approx(broken.witness["limit"])
    assert omega > 1.0005 * allowed
    # cubic: 3 v^3 = 0.2 v + 0.1 has its root at v = 0.3897, the nearest point that there is
    assert math.hypot(*x) <= {"viol": 0.0, "cubic": 0.392}[name]


REMEDIED = {
    "theta": ("theta = [1]\n[plant.unc", "theta = [5]\n[plant.unc"),
    "robust-wrong-gain": ('input_gain = "K_M/(2*J_M)"  ', "input_gain = 3"),
    "viol": ("beta = [0, 0.1]", "beta = [0, 0.5]"),
    "cubic": ('"-3*v**3"', '"0.1*tanh(-30*v**3)"'),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REMEDIED)
def test_the_remedy_works(name, tmp_path):
    old, new = REMEDIED[name]
    text = path(f"{name}.toml").read_text()
    assert old in text
    file = tmp_path / "mended.toml"
    file.write_text(text.replace(old, new))
    (tmp_path / "prof.csv").write_text(path("prof.csv").read_text())
    found = certrack.certify(certrack.load(file))
    assert not found.contradicted
    assert found.verified
    (broken,) = contradicted(premises(certrack.load(path(f"{name}.toml"))))
    advice = {"theta": "[5]", "robust-wrong-gain": "3", "viol": "beta[1] to 0.5", "cubic": "tanh"}
    assert advice[name] in broken.remedy


def test_a_domain_that_holds_is_proven(tmp_path):
    text = path("domain-log.toml").read_text()
    text = text.replace('"sqrt(x1)"', '"sqrt(max(x1, 0))"')
    file = tmp_path / "mended.toml"
    file.write_text(text)
    (broken,) = certrack.certify(certrack.load(file)).contradicted
    assert "plant.regressor[0]" in broken.detail and broken.witness["x"][0] <= 0
    file.write_text(text.replace('"log(x1)"', '"log(max(x1, 0.001))"'))
    found = certrack.certify(certrack.load(file))
    assert {p.status for p in found.premises if p.name == "domain"} == {"proven"}


@pytest.mark.parametrize("verb", ["simulate", "compare"])
def test_runs_say_once_that_no_certificate_covers_them(capfd, verb):
    _, _, err = invoke(capfd, verb, str(path("viol.toml")), "--json")
    assert err.count("no certificate covers every start") == 1
    assert "widen beta[1] to 0.5" in err


@pytest.mark.slow
def test_an_ensemble_says_what_its_members_are(capfd):
    _, out, err = invoke(capfd, "ensemble", str(path("viol.toml")), "-n", "8")
    assert "random admissible ones (multisine) in the place of truth.omega" in out
    assert "no certificate covers" not in err  # omega is not what the members have
    assert "(certificate)" in out
    _, out, err = invoke(capfd, "ensemble", str(path("robust-wrong-gain.toml")), "-n", "8")
    assert err.count("no certificate covers this: premise contradicted: input gain") == 1
    assert "no limit: no certificate covers the population" in out


def test_the_files_own_run_is_a_candidate_of_the_falsifier():
    system = certrack.load(path("slow.toml"))
    found = falsify(system, budget=200)
    assert found.worst_error >= 0.04 * (1 - 1e-3)  # that of the file's own run; kernels find more
    assert found.alarm is None
    assert found.against.bound > found.worst_error


def test_a_run_beyond_the_bound_is_an_alarm_that_names_the_premise(capfd):
    file = str(path("robust-wrong-gain.toml"))
    code, out, err = invoke(capfd, "falsify", file, "--budget", "150", "--json")
    found = json.loads(out)
    assert code == 1
    assert found["alarm"] == "premise" and found["ratio"] is None
    assert found["against"]["method"] == "peak"
    assert "ALARM" in err and "g_n = 20, the true one is 3" in err


def test_a_claim_that_stands_twice_is_refused(capfd):
    code, out, err = invoke(capfd, "verify", str(path("dup-claim.json")))
    assert (code, out) == (2, "")
    assert "the key 'claim' stands twice" in err and err.count("\n") == 1
    lines = path("dup-claim.json").read_text().splitlines()
    single = json.loads("\n".join(line for line in lines if "0.0000001" not in line))
    assert single["format"] == "certrack-certificate/1"
    assert verify(single).verified  # the older format stays verifiable


def test_a_certificate_that_used_to_hang_is_refused_at_once():
    with within(2):
        try:
            verdict = verify(path("hang-cert.json"))
        except InputError as problem:
            assert "\n" not in str(problem)
        else:
            assert not verdict.verified


def test_a_bound_that_hides_a_change_is_one_line(capfd):
    code, _, err = invoke(capfd, "verify", str(path("cert-bound-1e59.json")))
    assert code == 1
    assert err.count("\n") == 1 and "not verified" in err
    body = json.loads(path("cert-bound-1e59.json").read_text())
    for bound in ("1e59", "1e400", "1e-400", "7863781002255e-400"):
        body["proof"][-1]["bound"], body["claim"] = bound, f"limsup |e_1(t)| <= {bound}"
        content = {key: value for key, value in body.items() if key != "sha256"}
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
        assert not verify(body | {"sha256": digest}).verified


def test_a_run_that_never_began_has_not_settled(capfd):
    code, out, err = invoke(capfd, "simulate", str(path("undefined_at_zero.toml")), "--json")
    found = json.loads(out)
    assert code == 1
    assert found["outcome"] == "undefined" and found["settling_time"] is None
    assert "w_2 has no value at t = 0" in err


def test_an_input_gain_that_depends_on_a_state_names_the_class_and_the_change_of_input(tmp_path):
    text = path("maglev-not-affine.toml").read_text()
    certrack.load(path("maglev-not-affine.toml"))
    for old, new, words in (
        (
            "input_gain = -7.5\n[plant.con",
            'input_gain = "-Km/(Mb*gap**2)"\n[plant.con',
            "new input v",
        ),
        ("[truth]\ninput_gain = -7.5", '[truth]\ninput_gain = "-Km/(Mb*gap**2)"', "new input v"),
        ("chain = [1]", 'chain = ["1 + gap"]', "as the next state"),
    ):
        assert old in text
        file = tmp_path / "system.toml"
        file.write_text(text.replace(old, new))
        with pytest.raises(InputError) as refusal:
            certrack.load(file)
        assert "gap" in str(refusal.value)
        assert "must be x_" in str(refusal.value) and words in str(refusal.value)


def test_the_witness_of_cubic_is_the_nearest_of_a_fine_grid():
    system = certrack.load(path("cubic.toml"))
    term = uncertain_terms(system)[1]
    (broken,) = contradicted(premises(system))
    import numpy as np

    v = np.linspace(-0.4, 0.4, 8001)
    x = np.array([np.zeros_like(v), v])
    beyond = np.abs(v)[term.excess(Points(np.zeros_like(v), x)) > 0]
    assert math.hypot(*broken.witness["x"]) == pytest.approx(beyond.min(), rel=0.01)
    assert replace(term, gamma=term.gamma * 10).exceeded(Points(np.zeros_like(v), x)) is None

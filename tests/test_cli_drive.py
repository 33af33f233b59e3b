"""The command line on a drive without a certificate, and what it must not claim or write over."""

from dataclasses import replace

import pytest
from test_cli import invoke, result

import certrack
from certrack.certificates import Certificate
from certrack.reports.falsification import falsification_summary
from certrack.studies.falsifier.falsify import Falsification

ONE_STATE = """
[plant]
states = ["x1"]
gain_sign = 1
input_gain = "kg"

[plant.constants]
kg = 2

[plant.ranges]

[plant.uncertainty]
tau = [1]
gamma = [0.1]
beta = [0.2]

[truth]
input_gain = "kg"
omega = ["0.2*cos(t)"]

[reference]
signal = "0.5*sin(t)"

[law]
kind = "robust"
c = [5]

[simulation]
x0 = [1]
duration = 10

[implementation]
period = 0.01
noise = [0.001]
noise_bound = [0.003]
"""


def drive_file(folder, old="", new=""):
    """A drive of one state, with one line changed."""
    path = folder / "servo-drive.toml"
    assert old in ONE_STATE
    path.write_text(ONE_STATE.replace(old, new) if old else ONE_STATE)
    return path


def test_falsify_attacks_a_drive_that_has_no_certificate(capfd, tmp_path):
    path = drive_file(tmp_path, "noise_bound = [0.003]", "")
    found = result(capfd, "falsify", str(path), "--budget", "100")
    assert found["drive"]["worst_error"] > 0.05
    assert found["drive"]["certified"] is None
    assert not found["drive"]["verified"]
    assert "noise_bound" in found["drive"]["reason"]


def test_falsify_attacks_a_drive_whose_gain_has_a_range(capfd, tmp_path):
    path = drive_file(tmp_path, "[plant.ranges]", "[plant.ranges]\nkg = [1.8, 2.2]")
    found = result(capfd, "falsify", str(path), "--budget", "100")["drive"]
    assert found["verified"] and 0.05 < found["worst_error"] <= found["certified"]


def test_a_broken_premise_leaves_nothing_to_ship_with(capfd, tmp_path):
    code, out, _ = invoke(capfd, "certify", str(drive_file(tmp_path)), "--effort", "fast")
    assert code == 0
    assert "ship with" in out
    path = drive_file(tmp_path, "0.2*cos(t)", "0.5*cos(t)")
    code, out, _ = invoke(capfd, "certify", str(path), "--effort", "fast")
    assert code == 1
    assert "contradicted" in out
    assert "ship with" not in out


@pytest.mark.parametrize(
    "verb",
    [("certify", "servo-drive.toml"), ("falsify", "servo-drive.toml"), ("falsify", "servo.toml")],
)
def test_a_system_file_is_not_written_over(capfd, tmp_path, verb):
    path = drive_file(tmp_path)
    code, _, err = invoke(capfd, verb[0], str(path), "--out", str(tmp_path / verb[1]))
    assert code == 2
    assert "written over" in err
    assert path.read_text() == ONE_STATE


def test_a_run_that_still_settles_exceeds_no_bound():
    proven = Certificate("peak", 0.1, verified=True)
    found = Falsification(
        0.2, certrack.load("example1"), 1, {"peak": proven}, proven, None, "", True
    )
    assert falsification_summary(found)["settling"]
    assert not falsification_summary(found)["certificates"]["peak"]["exceeded"]
    unproven = replace(found, against=None)
    assert falsification_summary(unproven)["certificates"]["peak"]["exceeded"]

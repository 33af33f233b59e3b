"""Lost starts: what is found is lost when it is replayed, and where the edge is known it is met."""

import json
from dataclasses import replace

import numpy as np
import pytest

import certrack
from certrack.cli import main
from certrack.integrators.base import Outcome
from certrack.reports.falsification import lost_starts_lines, lost_starts_summary
from certrack.studies.falsifier.lost_starts import LostStarts, lost_starts
from certrack.studies.falsifier.start_alarm import start_alarm

#: x' = x^3 + u with |u| <= 2, sampled: nothing that begins beyond the root of x^3 = 2 comes back.
CUBIC = """
[plant]
states = ["x"]
drift = "x**3"
input_gain = 1
gain_sign = 1
[plant.uncertainty]
tau = [{tau}]
gamma = [0]
beta = [0.19]
[truth]
input_gain = 1
omega = ["0"]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [2]
[implementation]
period = 0.001
saturation = [-2, 2]
[simulation]
x0 = [0]
duration = 8
"""


def cubic(tau=0):
    return certrack.loads(CUBIC.format(tau=tau))


def test_the_edge_of_a_saturated_loop_is_met():
    found = lost_starts(cubic(), [(-1.0, 2.0)], budget=40)
    assert found.nearest.pattern == "own"
    (x0,) = found.nearest.x0
    assert x0 == pytest.approx(2 ** (1 / 3), rel=3e-3)
    assert found.nearest.part == pytest.approx((x0 - 0.5) / 1.5)


def test_disturbances_at_their_bounds_bring_the_edge_nearer():
    found = lost_starts(cubic(tau=1), [(-2.0, 2.0)], budget=40)
    assert found.nearest.pattern != "own"
    assert abs(found.nearest.x0[0]) == pytest.approx((2 - 0.19) ** (1 / 3), rel=3e-3)
    assert not certrack.check_assumption_1(found.nearest.system)


def test_what_is_found_is_lost_when_it_is_replayed(tmp_path):
    found = lost_starts(cubic(tau=1), [(-2.0, 2.0)], budget=40)
    certrack.save(found.nearest.system, tmp_path / "lost.toml")
    replayed = certrack.simulate(certrack.load(tmp_path / "lost.toml"))
    assert replayed.outcome is Outcome.escaped
    assert float(replayed.trajectory.times[-1]) == pytest.approx(found.nearest.time)


def test_nothing_is_lost_inside():
    found = lost_starts(cubic(tau=1), [(-1.15, 1.15)], budget=60)
    assert (found.nearest, found.lost, found.runs) == (None, 0, 60)
    assert 1.1 < found.largest < 1.3


def test_a_start_that_is_not_a_corner_is_found():
    """The middle of the box comes back, and so do its corners: what is lost lies between them."""
    text = CUBIC.format(tau=0).replace('drift = "x**3"', 'drift = "6*exp(-100*(x - 1)**2)"')
    system = certrack.loads(
        text.replace("[-2, 2]", "[-3, 3]").replace("= 8", "= 8\nmax_state = 1.0001")
    )
    found = lost_starts(system, [(-0.9, 0.95)], budget=100)
    assert found.nearest is not None
    assert 0.8 < found.nearest.x0[0] < 0.95


def test_it_agrees_with_the_first_escape_of_a_region():
    """The other search runs the linear loop in NumPy, from corners alone."""
    found = lost_starts(certrack.load("dual-motor-drag"), [(-12, 12)] * 4, budget=60)
    assert np.abs(found.nearest.x0).max() == pytest.approx(11.39, abs=0.25)
    assert found.nearest.pattern == "outward"


@pytest.mark.parametrize("box", [[(0, 1)] * 2, [(1, 0)], [(0, float("inf"))]])
def test_a_box_that_is_none(box):
    with pytest.raises(certrack.InputError, match="box"):
        lost_starts(cubic(), box)


def test_without_a_box():
    with pytest.raises(certrack.InputError, match="no box of starts"):
        lost_starts(cubic())


def said(capfd, *arguments):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    out, err = capfd.readouterr()
    return ended.value.code, out + err


def test_the_command_writes_what_it_found(capfd, tmp_path):
    file, out = tmp_path / "cubic.toml", tmp_path / "lost.toml"
    file.write_text(CUBIC.format(tau=1))
    command = ("falsify", str(file), "--starts", "--box=-2:2", "--budget", "400")
    code, text = said(capfd, *command, "--out", str(out))
    assert code == 0, text
    assert "lost start: x = " in text
    assert certrack.simulate(certrack.load(out)).outcome is Outcome.escaped
    with pytest.raises(SystemExit):
        main((*command, "--json"))
    values = json.loads(capfd.readouterr().out)
    assert values["nearest"]["x0"] == list(certrack.load(out).settings.x0)
    assert (
        "no start of the box is lost"
        in said(capfd, "falsify", str(file), "--starts", "--box=-1:1", "--budget", "400")[1]
    )
    code, text = said(capfd, "falsify", str(file), "--box=-1:1")
    assert (code, "Add --starts" in text) == (2, True)


def test_a_lost_start_that_is_claimed_is_an_alarm(monkeypatch):
    """Nothing that is claimed is lost; with a claim that is too wide there is an alarm."""
    system = certrack.load("dual-motor-drag")
    searched = lost_starts(system, [(-12, 12)] * 4, budget=30)
    assert searched.nearest is not None and searched.gone
    assert start_alarm(system, searched) is None
    results = certrack.certify(system)
    everywhere = replace(results.implemented, starts="any", polytope=None)
    wrong = replace(results, implemented=everywhere)
    monkeypatch.setattr("certrack.studies.falsifier.start_alarm.certify", lambda *_, **__: wrong)
    assert start_alarm(system, searched).kind == "defect"


def test_an_excursion_beyond_a_narrow_limit_is_no_alarm():
    """The law brings the state back; what is called an escape is max_state."""
    text = CUBIC.format(tau=0).replace("x**3", "0").replace("saturation = [-2, 2]", "")
    text = text.replace("= 8", "= 8\nmax_state = 1")
    system = certrack.loads(text.replace("[-2, 2]", "[-9, 9]"))
    searched = LostStarts(((-1.0, 1.0),), 1, 1, None, 0.0, (("own", (1.0,)),))
    assert start_alarm(system, searched) is None
    lines = lost_starts_lines(lost_starts_summary(searched), ["x"])
    assert lines == ["1 of 1 runs were lost, none of them when it was run again: x in [-1, 1]"]


def test_a_box_beyond_what_a_state_may_reach():
    with pytest.raises(certrack.InputError, match="of x must be within simulation.max_state"):
        lost_starts(cubic(), [(-1e10, 1)])

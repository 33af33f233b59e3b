"""What a newcomer is told: each usual slip gets one line that says what to write instead."""

import dataclasses
import re
import subprocess
import sys
from dataclasses import dataclass

import pytest
from click.testing import CliRunner

import certrack
from certrack import laws
from certrack.cli import cli
from certrack.core.errors import InputError
from certrack.core.expressions import parse
from certrack.export.monitor import default_parameters
from certrack.laws.base import gain
from certrack.studies.check import FAULT

FORMULAS = {
    "2t": "Write 2*t",
    "2 t": "Write 2*t",
    "1e5 t": "Write 1e5*t",
    "2(t + 1)": "Write 2*(...)",
    "3.5sin(t)": "Write 3.5*sin(...)",
    "x1 t": "Write x1*t",
    "x1(t)": "Write x1*(...)",
    "(t) x1": "Write (...)*x1",
    "(t + 1)(x1)": "Write (...)*(...)",
    "sin(t": "Close the bracket",
    "sin(t))": "A bracket is closed that was not opened",
    "": "an empty text. Write 0 for nothing",
    "  ": "an empty text. Write 0 for nothing",
    "t^2": "Write ** for powers",
    "0,5": "Write a decimal point, not a comma: 0.5",
    "0,5*t": "Write a decimal point, not a comma: 0.5",
    "sin(0,5*t)": "Write a decimal point, not a comma: 0.5",
    "Sin(t)": "Did you mean sin?",
    "X1": "Did you mean x1?",
    "t \N{MINUS SIGN} 1": "Write - for",
    "t\N{SUPERSCRIPT TWO}": "Write **2 for",
}


@pytest.mark.parametrize(("text", "remedy"), FORMULAS.items())
def test_a_slip_in_a_formula(text, remedy):
    with pytest.raises(InputError) as refused:
        parse("plant.drift", text, ["t", "x1"])
    assert remedy in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["1e5*t", "2e-3", "max(1, 2)*t", "-(x1)*(t)", "2.*t", "x1**2"])
def test_what_is_a_formula_stays_one(text):
    parse("plant.drift", text, ["t", "x1"])


def edited(old, new):
    text, count = re.subn(old, new, certrack.starter(), count=1, flags=re.MULTILINE)
    assert count == 1
    return text


FILES = {
    "no true gain": (
        edited("^input_gain = 2.2.*\n", ""),
        'truth.input_gain: is missing. State the true g_n, e.g. "1/J"',
    ),
    "parts turned": (edited("^input_gain = 2.2", "gain_input = 2.2"), "Did you mean input_gain?"),
    "a percentage": (
        edited(r"^input_gain = \[1.5, 2.5\].*", 'J = "10 %"'),
        "plant.ranges.J: must be a list of 2: [low, high]; got 10 %. Within 10 % it is "
        '["0.9*0.5", "1.1*0.5"]',
    ),
    "a number": (edited(r"^input_gain = \[1.5, 2.5\].*", "J = 0.1"), '["0.8*0.5", "1.2*0.5"]'),
    "ranges at the top": (
        edited(r"^\[plant.ranges\]", "[ranges]"),
        "ranges: is not a table of its own. Did you mean [plant.ranges]?",
    ),
    "a key above its table": (
        "duration = 3\n" + certrack.starter(),
        "duration: stands above its table. It belongs below [reference] or [simulation]",
    ),
    "a law of one's own": (
        edited('^kind = "adaptive"', 'kind = "mine"'),
        "entry point of the group certrack.laws",
    ),
}


@pytest.mark.parametrize(("text", "message"), FILES.values(), ids=FILES)
def test_a_slip_in_a_file(text, message):
    with pytest.raises(InputError) as refused:
        certrack.loads(text)
    assert message in str(refused.value)


def test_a_percentage_is_offered_as_the_range_that_loads():
    text = edited(r"^input_gain = \[1.5, 2.5\].*", 'J = "20 %"')
    with pytest.raises(InputError) as refused:
        certrack.loads(text)
    pair = str(refused.value).rpartition("it is ")[2]
    system = certrack.loads(
        text.replace('"20 %"', pair).replace("gain_sign = 1  ", "gain_sign = 1")
    )
    assert system.plant.constant_boxes["J"] == (0.4, 0.6)


def go(*arguments):
    return CliRunner().invoke(cli, list(map(str, arguments)))


def test_a_period_that_is_given_as_an_option_is_refused_by_its_name(tmp_path):
    for verb, name in (("c", "firmware"), ("st", "a.st"), ("fmu", "a.fmu")):
        result = go("export", verb, "example1", "--period", 0, "--out", tmp_path / name)
        assert isinstance(result.exception, InputError)
        assert str(result.exception).startswith("--period: must be positive")


def test_check_fails_where_a_nonlinear_loop_is_sampled_too_slowly(tmp_path):
    system = certrack.load("example1")
    pole = system.controller.coordinates.fastest_pole
    for product, sound in ((1.9, True), (2.1, False)):
        slow = system.replace(implementation=certrack.Implementation(period=product / pole))
        found = certrack.check(slow)
        faults = [f for f in found.findings if f.status == FAULT]
        assert found.sound == sound
        assert ["unstable from" in fault.detail for fault in faults] == [True] * (not sound)
        certrack.save(slow, tmp_path / "slow.toml")
        assert go("check", tmp_path / "slow.toml").exit_code == (0 if sound else 1)


def test_the_rows_of_ranges_that_have_no_certificate_say_why():
    system = certrack.load("axis")
    wide = {
        name: (low.expr / 50, high.expr * 50) for name, low, high in system.plant.constant_ranges
    }
    plant = dataclasses.replace(system.plant, constant_ranges=wide)
    found = certrack.certify(system.replace(plant=plant), "fast")
    assert not found.best.exists
    from certrack.reports import certificates as certificate_report

    rows = certificate_report.certificates_table(found)
    names = [row[0] for row in rows.rows]
    notes = [row[-1] for row in rows.rows]
    assert names == ["vertices", "peak", "cells"]
    assert notes == [getattr(found, kind).reason for kind in names]
    assert not any("cover it" in note for note in notes)


SYSTEM_CALLS = {
    "simulate": lambda: certrack.simulate("example1"),
    "simulator": lambda: certrack.Simulator("example1"),
    "certify": lambda: certrack.certify("example1"),
    "check": lambda: certrack.check("example1"),
    "falsify": lambda: certrack.falsify("example1"),
    "margins": lambda: certrack.margins("example1"),
    "ensemble": lambda: certrack.ensemble("example1"),
    "member": lambda: certrack.member("example1", 0),
    "design": lambda: certrack.design("example1"),
    "save": lambda: certrack.save("example1", "file.toml"),
    "to_text": lambda: certrack.to_text("example1"),
    "export_c": lambda: certrack.export_c("example1", "folder", period=0.001),
    "export_st": lambda: certrack.export_st("example1", "drive.st", period=0.001),
    "export_fmu": lambda: certrack.export_fmu("example1", "drive.fmu", period=0.001),
    "default_parameters": lambda: default_parameters("example1", period=0.001),
    "simulate_with_c": lambda: certrack.simulate_with_c("example1"),
    "to_control": lambda: certrack.to_control("example1"),
    "check_assumption_1": lambda: certrack.check_assumption_1("example1"),
    "tube": lambda: certrack.certificates.tube("example1", []),
    "save_certificate": lambda: certrack.certificates.save_certificate("example1", [], "a.json"),
}


@pytest.mark.parametrize("call", SYSTEM_CALLS.values(), ids=SYSTEM_CALLS)
def test_the_name_of_a_file_is_no_system(call):
    with pytest.raises(InputError) as refused:
        call()
    expected = "system: must be a System; got example1. certrack.load makes one"
    assert str(refused.value) == expected


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"a": "example1", "b": "example1"}, "laws['a']: must be a System; got example1"),
        (["a", "b"], "laws: must be a mapping of names to systems"),
    ],
)
def test_paired_wants_systems_by_name(given, message):
    with pytest.raises(InputError) as refused:
        certrack.paired(given)
    assert str(refused.value).startswith(message)


@pytest.mark.parametrize("index", [-1, 1.5, "3", True])
def test_the_index_of_a_member_is_a_whole_number(index):
    with pytest.raises(InputError, match="^index: must be a whole number from 0 to"):
        certrack.member(certrack.load("example1"), index)


def test_a_part_of_a_system_is_named_as_it_is():
    with pytest.raises(InputError, match=r"system.lw: unknown key. Did you mean law\?"):
        certrack.load("example1").replace(lw=3)


def test_a_public_name_is_named_as_it_is():
    with pytest.raises(AttributeError, match=r"no attribute 'simulte'. Did you mean simulate\?"):
        _ = certrack.simulte
    code = "import sys, certrack; hasattr(certrack, 'x'); assert 'numpy' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_tube_begins_at_the_start():
    tube = certrack.Tube(1.0, 0.25, 2.0)
    assert tube(0.0) >= 1.0
    for t in (-1e-9, float("nan"), [0.0, -1.0]):
        with pytest.raises(InputError, match="t: must be at least 0"):
            tube(t)


@dataclass(frozen=True, kw_only=True)
class Proportional(laws.Law):
    """A law with one gain, to be spoiled."""

    kind = "proportional"
    kp: float = gain(help="gain", above=0)

    def equations(self, s):
        return laws.Equations(-s.parameter("kp") * self.signal(s))

    def signal(self, s):
        return s.x[0]

    def parameters(self, plant):
        return {"kp": self.kp}


def designed(law):
    return law(c=(1, 1), kp=1.0).design(certrack.load("example1").plant)


def test_a_law_that_forgets_a_number():
    class Forgetful(Proportional):
        def parameters(self, plant):
            return {}

    designed(Proportional)
    with pytest.raises(InputError, match=r"^law: parameters\(\) gives no number for kp"):
        designed(Forgetful)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (lambda s: s.x[5], "s.x[5]: has 2 entries, from s.x[0]"),
        (lambda s: s.Y[3], "s.Y[3]: has 2 entries, from s.Y[0]"),
        (lambda s: s.phi[1], "s.phi[1]: has 1 entries, from s.phi[0]"),
    ],
)
def test_a_signal_that_a_law_does_not_have(entry, message):
    class Beyond(Proportional):
        def signal(self, s):
            return entry(s)

    with pytest.raises(InputError) as refused:
        designed(Beyond)
    assert str(refused.value) == message


@pytest.mark.parametrize("name", ["c", "k", "p", "coupling", "feedforward"])
def test_a_gain_that_hides_one_of_all_laws_is_refused(name):
    own = laws.theta_metric(help="own") if name == "coupling" else gain(help="own", above=0)
    kind = {"__annotations__": {name: object}, name: own, "kind": "hiding"}
    hiding = dataclass(frozen=True, kw_only=True)(type("Hiding", (Proportional,), kind))
    with pytest.raises(InputError, match=f"^law.{name}: is the name of a field of certrack.laws"):
        laws.register(hiding)


def test_results_show_themselves_in_one_short_line():
    system = certrack.load("dual-motor-lean")
    again = certrack.load("dual-motor-lean")
    shown = [
        certrack.check(system),
        certrack.certify(system).best,
        certrack.falsify(system, budget=100),
        certrack.paired({"a" * 300: system, "b" * 300: again}, 4, method="lockstep"),
        certrack.Certificate("rate", float("inf"), reason="x" * 3000),
    ]
    for result in shown:
        assert repr(result).startswith(type(result).__name__ + "(")
        assert len(repr(result)) <= 400
        assert "\n" not in repr(result)

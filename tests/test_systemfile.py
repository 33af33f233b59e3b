"""System files: round trip, exact messages, hostile and random input."""

import re
import tomllib
import types
import typing
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from conftest import SHIPPED, systems
from hypothesis import given, settings
from hypothesis import strategies as st

import certrack
from certrack.core.errors import InputError
from certrack.core.expressions import TIME
from certrack.laws import base
from certrack.model.distribution import Distribution
from certrack.model.implementation import Implementation
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references import samples, steps, trapezoid, triangle
from certrack.systems.lines import line_of
from certrack.systems.reader import loads
from certrack.systems.shipped import starter
from certrack.systems.system import Settings, System
from certrack.systems.writer import to_text

GOOD = (Path(__file__).parent / "data" / "starter.toml").read_text()
LINE = re.compile(r"(?<=^drive\.toml):\d+")


def edited(old, new):
    assert old in GOOD
    return GOOD.replace(old, new)


# what is wrong -> (text, beginning of the message after the file name)
BAD = {
    "empty": ("", "is empty"),
    "blank": ("  \n", "is empty"),
    "binary": (bytes(range(256)), "is not a text file"),
    "not TOML": ("plant = [", "is not TOML"),
    "deeply nested TOML": ("a = " + "[" * 5000, "is not TOML"),
    "no tables": ("title = 'x'", "plant: is missing"),
    "unknown section": (GOOD + "\n[extra]\n", "extra: unknown key"),
    "section is not a table": (
        "plant = 1\ntruth=1\nlaw=1\nreference=1\nsimulation=1",
        "plant: must be a table",
    ),
    "title is not text": (edited('"My drive"', "3"), "title: must be one line of printable text"),
    "unknown key": (edited("chain =", "chian ="), "plant.chian: unknown key"),
    "states missing": (edited("states =", "#"), "plant.states: is missing"),
    "no states": (edited('["x1", "x2"]', "[]"), "plant.states: must be 1 to 50 names"),
    "duplicate states": (
        edited('["x1", "x2"]', '["x1", "x1"]'),
        "plant.states[1]: names must be different",
    ),
    "reserved state": (
        edited('["x1", "x2"]', '["x1", "sin"]'),
        "plant.states[1]: this name is reserved",
    ),
    "signal as state": (
        edited('["x1", "x2"]', '["x1", "u"]'),
        "plant.states[1]: this name is reserved",
    ),
    "internal state": (
        edited('["x1", "x2"]', '["x1", "law_c_0"]'),
        "plant.states[1]: this name is",
    ),
    "Python keyword": (
        edited('["x1", "x2"]', '["x1", "lambda"]'),
        "plant.states[1]: names must be ident",
    ),
    "not a name": (edited('["x1", "x2"]', '["x1", "x 2"]'), "plant.states[1]: names must be ident"),
    "state is a number": (
        edited('["x1", "x2"]', '["x1", 2]'),
        "plant.states[1]: names must be ident",
    ),
    "chain too long": (
        edited("chain = [1]", "chain = [1, 2]"),
        "plant.chain: must be a list of 1: g_1 ... g_{n-1} (n = 2, the number of states)",
    ),
    "chain not a list": (edited("chain = [1]", "chain = 1"), "plant.chain: must be a list of 1"),
    "zero g": (edited("chain = [1]", "chain = [0]"), "plant.chain[0]: must not be zero"),
    "g is nan": (edited("chain = [1]", "chain = [nan]"), "plant.chain[0]: must be a finite number"),
    "g is inf": (edited("chain = [1]", "chain = [inf]"), "plant.chain[0]: must be a finite number"),
    "g is text": (edited("chain = [1]", 'chain = ["x1"]'), "plant.chain[0]: unknown name 'x1'"),
    "g is true": (edited("chain = [1]", "chain = [true]"), "plant.chain[0]: must be a formula"),
    "linear shape": (
        edited("linear = [[0]]", "linear = [[0, 1]]"),
        "plant.linear[0]: must be a list of 1: b_i1 ... b_ii; got [0, 1]. The factor of x_{i+1}",
    ),
    "number without a digit": (
        edited("J = 0.5", "J = .5"),
        "is not TOML: Invalid value (at line 19, column 5): 'J = .5 # inertia'. A number begins",
    ),
    "drift name": (edited('"-d/J*x2"', '"x3"'), "plant.drift: unknown name 'x3'"),
    "drift attack": (
        edited('"-d/J*x2"', '"x1.__class__"'),
        "plant.drift: Attribute is not allowed",
    ),
    "drift bomb": (edited('"-d/J*x2"', '"9**9**9**9"'), "plant.drift: an exponent is larger"),
    "drift nested": (
        edited('"-d/J*x2"', f'"{"(" * 5000}x1{")" * 5000}"'),
        "plant.drift: formula is ",
    ),
    "drift long": (
        edited('"-d/J*x2"', f'"{"+".join(["x1"] * 200_000)}"'),
        "plant.drift: formula is longer",
    ),
    "gain sign missing": (edited("gain_sign", "#"), "plant.gain_sign: is missing"),
    "gain sign": (edited("gain_sign = 1", "gain_sign = 2"), "plant.gain_sign: must be 1 or -1"),
    "gain against sign": (
        edited("gain_sign = 1", "gain_sign = -1"),
        "plant.input_gain: must have the sign",
    ),
    "truth against sign": (
        edited("input_gain = 2.2", "input_gain = -2.2"),
        "truth.input_gain: must have the sign",
    ),
    "truth gain zero": (
        edited("input_gain = 2.2", "input_gain = 0"),
        "truth.input_gain: must not be zero",
    ),
    "truth theta": (edited("theta = [1.7]", "theta = []"), "truth.theta: must be a list of 1"),
    "truth omega": (edited('omega = [0, "', 'omega = ["'), "truth.omega: must be a list of 2"),
    "constant name": (edited("J = 0.5", "t = 0.5"), "plant.constants.t: this name is reserved"),
    "constant is state": (
        edited("J = 0.5", "x1 = 0.5"),
        "plant.constants.x1: names must be different",
    ),
    "constant value": (edited("J = 0.5", "J = 'x1'"), "plant.constants.J: unknown name"),
    "constant zero divides": (edited("J = 0.5", "J = 0"), "plant.input_gain: divides by zero"),
    "range order": (
        edited("[1.5, 2.5]", "[2.5, 1.5]"),
        "plant.ranges.input_gain: low must not exceed",
    ),
    "range sign": (
        edited("[1.5, 2.5]", "[-1.5, 2.5]"),
        "plant.ranges.input_gain: must have the sign",
    ),
    "range shape": (
        edited("[[1.0, 3.0]]", "[1.0, 3.0]"),
        "plant.ranges.theta: needs 1 pair [low, high], one per regressor; got 2: [1.0, 3",
    ),
    "tau negative": (
        edited("tau = [0, 1]", "tau = [0, -1]"),
        "plant.uncertainty.tau[1]: must be zero or",
    ),
    "tau shape": (
        edited("tau = [0, 1]", "tau = [1]"),
        "plant.uncertainty.tau: must be a list of 2",
    ),
    "gamma missing": (edited("gamma = ", "#"), "plant.uncertainty.gamma: is missing"),
    "signal": (edited('"0.5*sin(t)"', '"0.5*sin(x1)"'), "reference.signal: unknown name 'x1'"),
    "no signal": (edited('signal = "0.5*sin(t)"', ""), "reference: must have a signal or a kind"),
    "kind": (
        edited('signal = "0.5*sin(t)"', 'kind = "square"'),
        "reference.kind: must be one of triangle",
    ),
    "kind field": (
        edited('signal = "0.5*sin(t)"', 'kind = "triangle"'),
        "reference.amplitude: is missing",
    ),
    "sample file outside": (
        edited('signal = "0.5*sin(t)"', 'kind = "samples"\nfile = "/etc/passwd"'),
        "reference.file: must lie beside the system file",
    ),
    "sample file above": (
        edited('signal = "0.5*sin(t)"', 'kind = "samples"\nfile = "../x.csv"'),
        "reference.file: must lie beside the system file",
    ),
    "law kind": (edited('"adaptive"  ', '"nonlinear"  '), "law.kind: must be one of adaptive"),
    "law kind missing": (edited('kind = "adaptive"', ""), "law.kind: is missing"),
    "c shape": (edited("c = [5, 5]", "c = [5]"), "law.c: must be a list of 2"),
    "c negative": (edited("c = [5, 5]", "c = [5, -5]"), "law.c[1]: must be positive; got -5"),
    "c zero": (edited("c = [5, 5]", "c = [5, 0]"), "law.c[1]: must be positive"),
    "c missing": (edited("c = [5, 5]", ""), "law.c: is missing"),
    "c nan": (edited("c = [5, 5]", "c = [5, nan]"), "law.c[1]: must be a finite number"),
    "Gamma": (edited("Gamma = [1.0]", "Gamma = [0.0]"), "law.Gamma[0]: must be positive"),
    "Gamma matrix": (
        edited("Gamma = [1.0]", "Gamma = [[-1.0]]"),
        "law.Gamma: must be positive definite",
    ),
    "foreign gain": (
        edited('kind = "adaptive"', 'kind = "robust"'),
        "law.Gamma: is not a key of the robust law (adaptive, classic have it). "
        "Nor: gain_rate, leak_gain, leak_theta, delta0, theta0",
    ),
    "foreign shape": (
        edited('signal = "0.5*sin(t)"', 'kind = "triangle"\nrise = 1'),
        "reference.rise: is not a key of the triangle reference (trapezoid has it)",
    ),
    "no such gain": (edited("Gamma = [1.0]", "Gama = [1.0]"), "law.Gama: unknown key"),
    "feedforward": (
        edited("feedforward = 1", "feedforward = 2"),
        "law.feedforward: must be a whole number",
    ),
    "x0 shape": (edited("x0 = [0.5, 0]", "x0 = [0.5]"), "simulation.x0: must be a list of 2"),
    "duration negative": (
        edited("duration = 20", "duration = -20"),
        "simulation.duration: must be positive",
    ),
    "duration huge": (
        edited("duration = 20", "duration = inf"),
        "simulation.duration: must be a finite",
    ),
    "estimates": (
        edited("duration = 20", "duration = 20\nestimates = [1]"),
        "simulation.estimates: must be a list of 2: the controller states (delta_hat, theta_hat_1)",
    ),
    "tolerance": (
        edited("duration = 20", "duration = 20\ntolerance = 1"),
        "simulation.tolerance: must be",
    ),
    "integrator": (
        edited("duration = 20", 'duration = 20\nintegrator = "euler"'),
        "simulation.integrator: must be one of",
    ),
    "start beyond the limit": (
        edited("duration = 20", "duration = 20\nmax_state = 0.1"),
        "simulation.x0[0]: must be within simulation.max_state",
    ),
    "tail": (
        edited("duration = 20", "duration = 20\ntail = 20"),
        "simulation.tail: must be before",
    ),
    "units": (edited('"rad/s", "N m"]', '"rad/s"]'), "plant.units: must be a list of 3"),
    "pairs": (
        edited("theta = [[1.0, 3.0]]", "theta = [[1.0, 3.0], [0, 1]]"),
        "plant.ranges.theta: needs 1 pair [low, high], one per regressor; got 2: [[1.0, 3.0], [0",
    ),
    "smoothness": (
        edited('signal = "0.5*sin(t)"', 'kind = "triangle"\namplitude = 1\nperiod = 2'),
        "reference: this design (law.feedforward = 1) needs 2 bounded derivatives",
    ),
}


@pytest.mark.parametrize(("text", "expected"), BAD.values(), ids=BAD.keys())
def test_bad_files_are_named_in_one_line(text, expected):
    with pytest.raises(InputError) as caught:
        loads(text, "drive.toml")
    message = str(caught.value)
    assert LINE.sub("", message, count=1).startswith(f"drive.toml: {expected}"), message
    assert "\n" not in message
    assert len(message) < 700


def line_named(text, key):
    """The line that the message about this key names."""
    with pytest.raises(InputError) as caught:
        loads(text, "drive.toml")
    problem = caught.value
    assert (problem.file, problem.key) == ("drive.toml", key)
    where = "drive.toml" if problem.line is None else f"drive.toml:{problem.line}"
    assert str(problem).startswith(": ".join(filter(None, (where, key))) + ": ")
    return problem.line and text.splitlines()[problem.line - 1]


LINES_NAMED = [
    ("chain = [1]", "chian = [1]", "plant.chian", "chian = [1]"),
    ("chain = [1]", "chain = [\n  # g_1\n  0,\n]", "plant.chain[0]", "  0,"),
    ("J = 0.5", "J = 'x'", "plant.constants.J", "J = 'x'"),
    ("[plant.constants]", "[plan]", "plan", "[plan]"),
    ("gamma = ", "# ", "plant.uncertainty.gamma", "[plant.uncertainty]"),
    ("c = [5, 5]", '"c" = [5, "x"]', "law.c[1]", '"c" = [5, "x"]'),
    ('title = "My drive"', 'title = """a\n[law]"""', "title", 'title = """'),
    ("[simulation]", "[simulation]\ntail = 30", "simulation.tail", "tail = 30"),
    ("[simulation]", "[implementation]\n[simulation]", "implementation.period", "[implementation]"),
    ("[simulation]", "ensemble.limit = 0\n[simulation]", "law.ensemble", "ensemble.limit = 0"),
    (
        "[simulation]",
        "[ensemble]\nx0 = [1,\n {uniform = [2,\n 1]}]\n[simulation]",
        "ensemble.x0[1].uniform",
        " {uniform = [2,",
    ),
]


@pytest.mark.parametrize(("old", "new", "key", "expected"), LINES_NAMED)
def test_a_message_names_the_line_of_its_key(old, new, key, expected):
    assert line_named(edited(old, new), key).startswith(expected)


def test_text_that_is_not_toml_has_the_line_of_the_parser():
    assert line_named(edited("[simulation]", "[simulation"), "") == "[simulation"


def test_what_is_not_in_the_file_has_no_line():
    assert line_named("title = 'x'", "plant") is None
    assert line_named("", "") is None


@given(st.lists(st.sampled_from([*'abc.=[]{}",#\\ \n', "'", '"""', "a = 1\n", "[a.b]\n"])))
def test_the_search_for_a_line_ends_on_any_text(parts):
    text = "".join(parts)
    assert line_of(text, "a.b[0]") in (None, *range(1, text.count("\n") + 2))


@pytest.mark.parametrize(
    ("wrong", "close"),
    [("chian", "chain"), ("regresor", "regressor"), ("input-gain", "input_gain")],
)
def test_an_unknown_key_comes_with_the_closest_known_one(wrong, close):
    with pytest.raises(InputError, match=rf"unknown key. Did you mean {close}\? Known here: "):
        loads(edited("chain =", f"{wrong} ="))
    with pytest.raises(InputError, match=r"unknown key. Known here: "):
        loads(edited("chain =", "zzz ="))


@pytest.mark.parametrize("name", SHIPPED)
def test_loading_builds_every_thing_once(monkeypatch, name):
    calls = Counter()

    def count(owner, method):
        original = getattr(owner, method)

        def counting(*arguments, **options):
            calls[owner.__name__, method] += 1
            return original(*arguments, **options)

        monkeypatch.setattr(owner, method, counting)

    for part in (Plant, Uncertainty, Implementation, Population, Settings, System):
        count(part, "__post_init__")
    count(Truth, "bound_to")
    count(base, "recursion")
    system = certrack.load(name)
    assert system.controller is system.controller
    assert set(calls.values()) == {1}, calls
    parts = {owner for owner, _ in calls}
    assert {"Plant", "Uncertainty", "Settings", "System", "Truth"} <= parts
    assert (base.__name__ in parts) == (system.law.kind != "linear")  # which has no recursion
    assert ("Implementation" in parts) == (system.implementation is not None)


def test_starter_and_shipped_systems_survive_a_round_trip(shipped):
    for system in (shipped, loads(GOOD), loads(starter())):
        again = loads(to_text(system))
        assert again == system
        assert to_text(again) == to_text(system)


def test_saved_text_keeps_formulas(tmp_path):
    system = certrack.load("dual-motor")
    path = tmp_path / "motor.toml"
    certrack.save(system, path)
    assert certrack.load(path) == system
    table = tomllib.loads(path.read_text())
    assert table["plant"]["chain"] == [1, "2*K_L/J_L", 1]
    assert table["plant"]["drift"] == "K_L/J_M*(x1 - x3)"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "reference",
    [
        triangle(0.2, 4.0, bound=1.0),
        trapezoid(0.2, 4.0, 0.5, offset=0.1),
        steps([1, 4], [0, 0.2, -0.1], 1.0),
        samples([0, 1, 2], [0, 0.1, 0.3], "cubic"),
    ],
)
def test_references_survive_a_round_trip(reference):
    system = certrack.load("example1").replace(reference=reference)
    assert loads(to_text(system)) == system


@given(systems())
def test_random_systems_survive_a_round_trip(system):
    assert loads(to_text(system)) == system


def test_samples_are_read_from_a_file_beside_the_system(tmp_path):
    (tmp_path / "motion.csv").write_text("# time, y_d\n0, 0\n1, 0.2\n2, 0.1\n")
    text = GOOD.replace('signal = "0.5*sin(t)"', 'kind = "samples"\nfile = "motion.csv"')
    (tmp_path / "drive.toml").write_text(text)
    system = certrack.load(tmp_path / "drive.toml")
    assert system.reference == samples([0, 1, 2], [0, 0.2, 0.1])
    assert loads(to_text(system)) == system  # saved with its samples, no file needed
    for content in ("", "a,b\n", "1\n2\n", "1,2,3\n2,3,4\n", "0,1\n0,2\n"):
        (tmp_path / "motion.csv").write_text(content)
        with pytest.raises(InputError, match="reference"):
            certrack.load(tmp_path / "drive.toml")
    (tmp_path / "motion.csv").unlink()
    with pytest.raises(InputError, match="cannot be read"):
        certrack.load(tmp_path / "drive.toml")


@pytest.mark.parametrize("name", ["nowhere.toml", "nowhere", ".", "a\0b.toml", "x" * 300 + ".toml"])
def test_unreadable_sources_are_our_error(name):
    with pytest.raises(InputError):
        certrack.load(name)


def test_too_large_file_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("certrack.systems.tables.MAX_FILE_BYTES", 100)
    (tmp_path / "big.toml").write_text("#" * 200)
    with pytest.raises(InputError, match="larger than"):
        certrack.load(tmp_path / "big.toml")


def loads_or_complains(text):
    try:
        assert isinstance(loads(text), System)
    except InputError as problem:
        assert "\n" not in str(problem)


@settings(max_examples=200)
@given(st.one_of(st.text(), st.binary()))
def test_fuzzed_text_raises_nothing_but_our_error(text):
    loads_or_complains(text)


VALUES = st.recursive(
    st.one_of(
        st.none().map(lambda _: "''"),
        st.booleans().map(lambda b: str(b).lower()),
        st.integers(-(2**70), 2**70).map(str),
        st.floats().map(repr),
        st.sampled_from(
            ["'x1'", "'x1*t'", "'2*J'", "inf", "nan", "1e400", "1979-05-27", "'sin(x1'", "{a = 1}"]
        ),
    ),
    lambda inner: st.lists(inner, max_size=3).map(lambda items: f"[{', '.join(items)}]"),
    max_leaves=6,
)
LINES = [i for i, line in enumerate(GOOD.splitlines()) if "=" in line.split("#")[0]]


@pytest.mark.slow
@settings(max_examples=600)
@given(st.sampled_from(LINES), VALUES)
def test_fuzzed_values_raise_nothing_but_our_error(line, value):
    lines = GOOD.splitlines()
    lines[line] = f"{lines[line].split('=')[0]}= {value}"
    loads_or_complains("\n".join(lines))


@settings(max_examples=200)
@given(st.sampled_from(LINES), st.sampled_from(LINES))
def test_swapped_lines_raise_nothing_but_our_error(first, second):
    lines = GOOD.splitlines()
    lines[first], lines[second] = lines[second], lines[first]
    loads_or_complains("\n".join(lines))


#: What is invalid by itself, and the key that its message names.
INVALID = [
    (Plant, {"states": ["x1", "x2"]}, "plant.chain"),
    (Plant, {"states": ["x"], "gain_sign": 0}, "plant.gain_sign"),
    (Plant, {"states": ["x"], "uncertainty": {"tau": [0]}}, "plant.uncertainty.gamma"),
    (Uncertainty, {"tau": [1], "gamma": [-1], "beta": [0]}, "plant.uncertainty.gamma[0]"),
    (Uncertainty, {"tau": [1], "gamma": [1, 1], "beta": [0]}, "plant.uncertainty.gamma"),
    (Truth, {}, "truth.input_gain"),
    (Truth, {"input_gain": 1, "tau": [-1]}, "truth.tau[0]"),
    (Truth, {"input_gain": "x.__class__"}, "truth.input_gain"),
    (Truth, {"input_gain": 1, "omega": ["9**9**9**9"]}, "truth.omega[0]"),
    (Truth, {"input_gain": 1, "constants": {"K": "J"}}, "truth.constants.K"),
    (Truth, {"states": ["z"], "rates": ["u"], "outputs": 3}, "truth.outputs"),
    (Truth, {"states": ["z", "z"], "rates": ["u"], "outputs": ["z"]}, "truth.states[1]"),
    (Truth, {"states": ["z"], "rates": [], "outputs": ["z"]}, "truth.rates"),
    (Truth, {"states": ["z"], "rates": ["u"], "outputs": ["z"], "tau": [1]}, "truth.tau"),
    (Settings, {"x0": ["a"], "duration": 1}, "simulation.x0[0]"),
    (Settings, {"x0": [0], "duration": 0}, "simulation.duration"),
    (Settings, {"x0": [0], "duration": 1, "tolerance": 1}, "simulation.tolerance"),
    (Implementation, {"period": -1}, "implementation.period"),
    (Implementation, {"period": 1, "offset": 1}, "implementation.offset"),
    (Implementation, {"period": 1, "delay": 101}, "implementation.delay"),
    (Implementation, {"period": 1, "saturation": (1, 0)}, "implementation.saturation"),
    (Implementation, {"period": 1, "saturation": (1, 2)}, "implementation.initial_input"),
    (Implementation, {"period": 1, "noise": [-1]}, "implementation.noise[0]"),
    (Implementation, {"period": 1, "noise_bound": [-1]}, "implementation.noise_bound[0]"),
    (Implementation, {"period": 1, "seed": -1}, "implementation.seed"),
    (Implementation, {"period": 1, "velocity": "x2"}, "implementation.velocity"),
    (Implementation, {"period": 1, "velocity_filter": 1}, "implementation.velocity_filter"),
    (Implementation, {"period": 1, "update": "heun"}, "implementation.update"),
    (Implementation, {"period": 1, "projection": [[1, 0]]}, "implementation.projection[0]"),
    (Population, {"sines": -4}, "ensemble.sines"),
    (Population, {"points": 2.5}, "ensemble.points"),
    (Population, {"limit": 0}, "ensemble.limit"),
    (Population, {"sampling": "halton"}, "ensemble.sampling"),
    (Population, {"disturbance": 3}, "ensemble.disturbance"),
    (Population, {"frequencies": (0, 1)}, "ensemble.frequencies"),
    (Population, {"tau": [{"uniform": [-1, 1]}]}, "ensemble.tau[0]"),
    (Population, {"x0": [{"uniform": [1, -1]}]}, "ensemble.x0[0].uniform"),
    (Population, {"theta": 1}, "ensemble.theta"),
    (Population, {"constants": {"K": "a"}}, "ensemble.constants.K"),
    (Population, {"frequency": 0}, "ensemble.reference.frequency"),
    (Distribution, {"kind": "uniform", "values": (2, 1)}, "uniform"),
    (Distribution, {"kind": "uniform", "values": (1,)}, "uniform"),
    (Distribution, {"kind": "loguniform", "values": (0, 1)}, "loguniform"),
    (Distribution, {"kind": "truncnorm", "values": (0, 0, -1, 1)}, "truncnorm"),
    (Distribution, {"kind": "gauss", "values": (0, 1)}, "distribution"),
]


@pytest.mark.parametrize(("part", "fields", "key"), INVALID)
def test_nothing_exists_invalid(part, fields, key):
    with pytest.raises(InputError) as caught:
        part(**fields)
    assert caught.value.key == key


def test_a_part_holds_what_its_types_say():
    plant = Plant(
        states=["x1", "x2"],
        chain=[2],
        regressor=["K"],
        gain_sign=1.0,
        input_gain=3,
        theta=[1],
        constants={"K": "2"},
        input_gain_range=[1, 4],
        theta_range=[["K", 3]],
        uncertainty={"tau": ["K", 0], "gamma": [0, 1], "beta": [0, 0]},
    )
    truth = Truth(input_gain="K", theta=[2], omega=[0, "t"], tau=[1, "1/2"], constants={"K": 3})
    own = Truth(states=["z"], rates=["u - a"], outputs=["z", 0], constants={"a": 1})
    settings = Settings(x0=np.array([1, 0]), duration=np.int64(3))
    implementation = Implementation(period="1/8", saturation=[-1, 1], velocity=["x2"], noise=[0, 1])
    population = Population(x0=[1, {"uniform": [0, 1]}], constants={"K": 2}, frequencies=[1, 2])
    reference = certrack.SymbolicReference("K*sin(t)", constants={"K": 2}, declared=[2, 2])
    law = certrack.Adaptive(c=[1, 2], theta0=[1], Gamma=[[1]], delta0=1)
    bound = System(plant, law, reference, truth, settings, "", population, implementation)
    assert bound.truth.omega[1].expr == TIME
    assert float(bound.truth.input_gain.expr) == 3
    for part in (plant, truth, own, settings, implementation, population, reference, law):
        holds_its_types(part)
    for part in (bound.truth, bound.population, bound.implementation, plant.uncertainty):
        holds_its_types(part)
    holds_its_types(Distribution("uniform", [0, 1]))


def holds_its_types(part):
    for name, type_ in typing.get_type_hints(type(part)).items():
        if typing.get_origin(type_) is not typing.ClassVar:
            assert is_a(getattr(part, name), type_), (name, getattr(part, name), type_)


def is_a(value, type_):
    origin, arguments = typing.get_origin(type_), typing.get_args(type_)
    if type_ is typing.Any:
        return True
    if origin is types.UnionType:
        return any(is_a(value, option) for option in arguments)
    if origin is not tuple:
        return type(value) is type_
    if arguments[1:] == (...,):
        arguments = arguments[:1] * len(value) if isinstance(value, tuple) else ()
    return (
        type(value) is tuple
        and len(value) == len(arguments)
        and all(is_a(v, t) for v, t in zip(value, arguments, strict=True))
    )


def test_catalog_lists_every_shipped_file():
    assert tuple(certrack.catalog()) == SHIPPED
    folder = Path(certrack.__file__).parent / "systems" / "catalog"
    assert {path.stem for path in folder.glob("*.toml")} == set(SHIPPED)


def test_a_missing_key_points_at_the_header_of_its_table():
    text = "[plant.ranges]\ninput_gain = [1, 2]\n\n[plant]\nchain = []\n\n[plant.constants]\n"
    assert line_of(text, "plant.states") == 4
    assert line_of(text, "plant.ranges.input_gain") == 2
    assert line_of("[plant.ranges]\n", "plant.states") == 1


def test_a_problem_in_a_file_of_samples_names_file_and_row(tmp_path):
    start = GOOD.index("[reference]")
    end = GOOD.index("\n[", start + 1)
    text = f'{GOOD[:start]}[reference]\nkind = "samples"\nfile = "s.csv"\n{GOOD[end:]}'
    for rows, row in (("0,0\n1,1\n1,2\n", 3), ("0,0\n1,nan\n", 2)):
        (tmp_path / "s.csv").write_text(rows)
        with pytest.raises(InputError, match=rf"reference\.file: row {row} of s\.csv: "):
            loads(text, folder=tmp_path)
    (tmp_path / "s.csv").write_text("0,0\n1,1\n")
    loads(text, folder=tmp_path)
    both = text.replace('file = "s.csv"', 'file = "s.csv"\nvalues = [1, 2]')
    with pytest.raises(InputError, match=r"reference\.values: must be left out beside"):
        loads(both, folder=tmp_path)

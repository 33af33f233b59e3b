"""What the designer's workers do: gains, forms, references, runs, bounds, early results."""

import dataclasses
import json
import math
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

import certrack
from certrack.app.form import form_of, with_entries, with_numbers, with_reference_table
from certrack.app.frames import (
    frame_arrays,
    frame_header,
    frame_prefix,
)
from certrack.app.gains import movable_gains, with_gains
from certrack.app.jobs import JOBS, JobContext
from certrack.app.long_tasks import FIRST_MEMBERS, MORE_MEMBERS, _runs_spent, run_task
from certrack.app.open_design import Designs, continuous_law
from certrack.app.order import names_typed, with_states
from certrack.app.profiles import DRAWN_ORDER, reference_record
from certrack.app.responses import metric_texts
from certrack.app.task_progress import TaskProgress
from certrack.cli import cli
from certrack.core.errors import InputError
from certrack.core.rounding import printed_bound
from certrack.reports.tables import BOUND_TEXT_DIGITS, table
from certrack.reports.tuning import eased
from certrack.simulation.metrics import METRIC_LABELS
from certrack.studies.falsifier.drive import DriveFalsification
from certrack.tuning.result import ActiveLimit

# plant and law as formulas


def law_of(name, gains=None):
    job = {"text": certrack.starter(name), "name": name, "gains": gains or {}, "design": 7}
    frame = JOBS["law"](JobContext(), job, 0.0, None, None)
    assert (frame_prefix(frame).kind.name, frame_prefix(frame).design) == ("LAW", 7)
    return frame_header(frame)


def test_the_law_is_that_of_the_command_line_with_the_numbers_of_the_paper():
    shown, system = law_of("example1"), certrack.load("example1")
    texts, numbers = zip(*shown["law"], strict=True)
    assert texts == certrack.design(system).formulas
    assert numbers == ("(6)", "(9)", "(6)", "(25)", "(25)", "(26)", "(26)")
    assert [number for _, number in shown["plant"]] == ["(5)", "(5)"]
    assert shown["notes"] == [str(certrack.design(system)).splitlines()[len(texts) + 1]]
    moved = dict(law_of("example1", {"law.c[0]": 2.0})["law"])
    assert "lambda_1 = -2.25*x1 + 3.75*y_d" in moved and "lambda_1 = -1.75*x1 + 3.25*y_d" in texts


def test_virtual_controls_have_the_number_of_their_step_and_other_laws_none():
    robust = dict(law_of("dual-motor")["law"])
    steps = [number for text, number in robust.items() if text.startswith("lambda")]
    assert steps == ["(9)", "(13)", "(18)"]
    assert [n for text, n in robust.items() if text.startswith("u")] == ["Corollary 1"]
    lean = law_of("dual-motor-lean")
    assert any("q = 0" in note for note in lean["notes"])
    assert not any("q = 0" in note for note in law_of("dual-motor")["notes"])
    assert not any(number for _, number in law_of("example1-classic")["law"])


# gains and form


@pytest.mark.parametrize("name", sorted(certrack.catalog()))
def test_every_gain_moves_the_law_and_the_text_alike(name):
    text = certrack.starter(name)
    system = certrack.loads(text)
    gains = movable_gains(system)
    values = {g.path: round(1.07 * g.value, 6) if g.value else 0.01 for g in gains}
    assert values
    written = certrack.loads(with_numbers(text, values))
    assert with_gains(system, values).law == written.law
    for path, value in values.items():
        assert with_gains(system, {path: value}).law != system.law, path


@pytest.mark.parametrize(
    "path", ["law.c", "law.c[9]", "law.kind", "plant.chain[0]", "law.observer.bandwidth", "c[0]"]
)
def test_what_is_no_gain_is_refused(path):
    with pytest.raises(InputError, match=r"is not a gain of this law|is a list"):
        with_gains(certrack.load("example1"), {path: 1.0})


def test_numbers_go_to_their_place_and_comments_stay():
    text = certrack.starter("example1")
    changed = with_numbers(text, {"law.c[1]": 0.75, "law.k[1][2]": 2, "law.leak_gain": 0.7})
    assert (
        changed.replace("0.75]", "0.5]")
        .replace("inf, 2, 1]", "inf, 1, 1]")
        .replace("leak_gain = 0.7", "leak_gain = 0.6")
        == text
    )
    assert "# gbar1" in changed


def test_a_field_of_the_form_is_written_as_toml():
    text = certrack.starter("example1")
    changed = with_entries(
        text,
        {
            "plant.drift": "x1*x2",
            "simulation.duration": "12.5",
            "simulation.band": "",
            "plant.uncertainty.gamma": "[0.1, 0.2]",
            "implementation.period": "0.001",
        },
    )
    system = certrack.loads(changed)
    assert str(system.plant.drift.expr) == "x1*x2"
    assert system.settings.duration == 12.5 and system.settings.band is None
    assert system.plant.uncertainty.gamma == (0.1, 0.2)
    assert system.implementation.period == 0.001
    assert "# h(x)" in changed and changed.index("[plant]") < changed.index("[law]")
    with pytest.raises(InputError, match="is not TOML"):
        with_entries(text, {"plant.chain": "[1,"})
    with pytest.raises(InputError, match="Mend the file first"):
        with_entries("[plant", {"plant.chain": "[1]"})


@pytest.mark.parametrize("name", sorted(certrack.catalog()))
def test_the_form_has_every_key_of_a_file_and_its_help(name):
    import tomllib

    text = certrack.starter(name)
    fields = {f["path"]: f for section in form_of(text) for f in section["fields"]}

    def leaves(table, path=""):
        for key, value in table.items():
            where = f"{path}.{key}" if path else key
            if isinstance(value, dict) and where not in fields:
                yield from leaves(value, where)
            else:
                yield where

    assert set(leaves(tomllib.loads(text))) <= set(fields)
    assert all(field["help"] for field in fields.values() if field["kind"] != "any")
    filled = {path: f["value"] for path, f in fields.items() if f["value"]}
    again = certrack.loads(with_entries(text, {p: v for p, v in filled.items() if v is not None}))
    assert again == certrack.loads(text)


# jobs, in this process


def job(do, **details):
    text = certrack.starter(details.pop("name", "example1"))
    base = {"text": text, "name": "example1.toml", "folder": None, "gains": {}, "design": 3}
    return base | {"do": do, "view": 2, "window": None, "pixels": 300, "sampled": False} | details


def carried_out(context, work):
    return JOBS[work["do"]](context, work, 0.0, lambda frame: None, lambda *_: None)


@pytest.fixture(scope="module")
def context():
    return JobContext()


def test_numbers_of_a_run_are_those_of_the_command_line(context):
    data = carried_out(context, job("run", gains={"law.c[0]": 1.25}))
    header, rows = frame_header(data), frame_arrays(data)
    law = dataclasses.replace(certrack.load("example1").law, c=(1.25, 0.5))
    run = certrack.simulate(certrack.load("example1").replace(law=law))
    assert header["metrics"] == run.metrics.as_dict()
    assert header["texts"] == metric_texts(run.metrics.as_dict())
    rows_of_table = [[k, run.metrics.as_dict()[k]] for k in METRIC_LABELS]
    printed = table("", ["", ""], rows_of_table)
    assert [row[1] for row in printed.rows] == list(header["texts"].values())
    error = rows[1 + 2]
    assert np.abs(error).max() == pytest.approx(np.abs(run.x[0] - run.y_d).max(), rel=1e-6)
    assert frame_prefix(data).design == 3 and frame_prefix(data).view == 2


def test_a_window_is_computed_anew(context):
    data = carried_out(context, job("run", window=[2.0, 2.5]))
    header, rows = frame_header(data), frame_arrays(data)
    run = certrack.simulate(certrack.load("example1"))
    times = rows[0].astype(float) + header["t0"]
    assert len(times) == 600 and times[0] == 2.0 and times[-1] == pytest.approx(2.5)
    assert rows[1] == pytest.approx(run.trajectory.interpolate(times)[0], abs=1e-5)


#: Its states grow beyond all limits within a fraction of a second.
ESCAPING = """
[plant]
states = ["x1", "x2"]
chain = [1]
linear = [[0]]
drift = "0"
regressor = []
gain_sign = 1
input_gain = 1
theta = []
[plant.uncertainty]
tau = [0.1, 0.1]
gamma = [0, 0]
beta = [9, 9]
[truth]
input_gain = 1
theta = []
omega = ["0", "30*x2**3"]
[reference]
signal = "0"
[law]
kind = "robust"
c = [2, 2]
feedforward = 1
[simulation]
x0 = [1.0, 1.0]
duration = 8
tail = 1
"""


@pytest.mark.parametrize("window", [[4.0, 5.0], [0.0, 5.0], [9.0, 10.0], [-3.0, -2.0]])
def test_no_window_shows_more_than_the_run(context, window):
    data = carried_out(context, job("run", text=ESCAPING, window=window))
    header, rows = frame_header(data), frame_arrays(data)
    run = certrack.simulate(certrack.loads(ESCAPING))
    assert header["outcome"] == "escaped" and header["end"] == run.trajectory.end < 1
    times = rows[0].astype(float) + header["t0"]
    assert times.min() >= 0 and times.max() <= run.trajectory.end * (1 + 1e-6)
    largest = np.abs(run.x).max(axis=1)
    assert all(np.abs(rows[1 + i]).max() <= largest[i] * (1 + 1e-6) for i in range(2))


def test_a_bound_is_the_estimate_and_the_exact_one_is_what_certify_proves(context):
    gains = {"law.c[0]": 7.0}
    work = {"name": "dual-motor-lean", "gains": gains}
    bound = frame_header(carried_out(context, job("bound", **work)))
    exact = frame_header(carried_out(context, job("exact", effort="fast", **work)))
    system = with_gains(certrack.load("dual-motor-lean"), gains)
    proven = certrack.certify(system, "fast")
    assert exact["verified"] and exact["method"] == proven.best.kind == bound["method"]
    assert exact["bound"] == pytest.approx(proven.best.bound, rel=1e-6)
    assert exact["text"] == printed_bound(exact["bound"], BOUND_TEXT_DIGITS)
    assert float(exact["text"]) >= exact["bound"]
    assert bound["bound"] == pytest.approx(exact["bound"], rel=1e-3)
    assert sum(share for _, share in bound["shares"]) == pytest.approx(1)
    assert exact["tube"]["pieces"] and {p["status"] for p in exact["premises"]} == {"proven"}


def test_a_text_that_is_wrong_is_told_with_its_line(context):
    text = certrack.starter("example1").replace("x1**2*x2", "x1**2*x9")
    header = frame_header(carried_out(context, job("describe", text=text)))
    assert header["problem"]["line"] == 9 and header["problem"]["key"] == "plant.drift"
    assert "unknown name 'x9'" in header["problem"]["message"]


#: The uncertainty is too strong for the gains.
UNCERTAIN = (
    ESCAPING.replace("tau = [0.1, 0.1]", "tau = [5, 5]")
    .replace("gamma = [0, 0]", "gamma = [5, 5]")
    .replace('"30*x2**3"', '"0"')
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (UNCERTAIN, "lower tau, raise c"),
        (certrack.starter("example1-classic"), "without leakage the estimates may drift"),
    ],
)
def test_why_there_is_no_bound_is_what_the_command_line_says(context, tmp_path, text, says):
    header = frame_header(carried_out(context, job("exact", text=text, effort="fast")))
    assert header["bound"] is None and says in header["reason"]
    (tmp_path / "none.toml").write_text(text)
    run = CliRunner().invoke(cli, ["certify", str(tmp_path / "none.toml"), "--effort", "fast"])
    assert f"certrack: no certificate: {header['reason']}\n" in run.output


def test_a_contradicted_premise_is_told_with_its_remedy(context):
    text = certrack.starter("example1").replace("gamma = [0.5, 0.2]", "gamma = [0.1, 0.2]")
    header = frame_header(carried_out(context, job("exact", text=text, effort="fast")))
    assert not header["verified"]
    assert header["contradicted"][0]["name"] == "w_1" and header["contradicted"][0]["remedy"]


def test_a_drive_is_shown_by_its_continuous_law_first(context):
    first = frame_header(carried_out(context, job("run", name="dual-motor-drive")))
    assert not first["sampled"]
    assert continuous_law(certrack.load("dual-motor-drive")).implementation is None


def test_a_compiled_loop_serves_other_numbers():
    designs = Designs()
    system = certrack.load("dual-motor-lean")
    designs.run(system)
    (compiled,) = designs._simulators
    designs.run(with_gains(system, {"law.c[2]": 8.0}))
    assert designs._simulators == [compiled]


# the reference


@pytest.mark.parametrize("name", ["example1", "dual-motor-lean", "flexible-joint"])
def test_another_kind_of_reference_suits_the_law_or_is_not_offered(context, name):
    text = certrack.starter(name)
    system = certrack.loads(text)
    needed = system.controller.coordinates.q + 1
    for kind, offered in reference_record(system, text)["kinds"]:
        work = job("describe", text=text, entries={"reference.kind": kind})
        header = frame_header(carried_out(context, work))
        assert (header["problem"] is None) == offered, (kind, header["problem"])
        if not offered:
            continue
        drawn = header["reference"]
        assert drawn["kind"] == kind
        size = np.abs(
            system.reference.values(np.linspace(0, system.settings.duration, 999), 0)
        ).max()
        assert 0.3 * size < np.abs(drawn["rows"][0]).max() < 1.4 * size, kind
        assert len(drawn["rows"]) >= min(needed, DRAWN_ORDER) + 1
        for row, limit in zip(drawn["rows"], drawn["limits"], strict=True):
            assert limit is None or np.abs(row).max() <= limit * (1 + 1e-4)


def test_points_of_a_reference_are_where_the_curve_passes_them():
    text = certrack.starter("point-to-point")
    system = certrack.loads(text)
    points = reference_record(system, text)["points"]
    assert points["path"] == "reference.positions" and None not in points["times"]
    assert points["times"] == sorted(points["times"])
    reached = system.reference.values(np.array(points["times"]), 0)[0]
    assert reached == pytest.approx(points["values"], abs=1e-4)
    assert (
        reference_record(certrack.load("example1"), certrack.starter("example1"))["points"] is None
    )


def with_named(name, states):
    """A shipped text after other states were typed into its form, and what the page is told."""
    entries = {"plant.states": json.dumps(states)}
    work = job("describe", text=certrack.starter(name), entries=entries)
    header = frame_header(carried_out(JobContext(), work))
    return tomllib.loads(header["text"]), header


@pytest.mark.parametrize("name", ["example1", "flexible-joint", "motor-shaft-load", "stiction"])
@pytest.mark.parametrize("first", [True, False])
def test_every_list_follows_a_state_that_is_added(name, first):
    before = tomllib.loads(certrack.starter(name))
    states = before["plant"]["states"]
    names = ["extra", *states] if first else [*states, "extra"]
    after, header = with_named(name, names)
    assert "message" not in header
    assert header["states"] == names
    place = 0 if first else len(states)
    last = before["law"]["c"][-1]
    for owner, key, new in [("plant", "chain", 1), ("law", "c", last), ("simulation", "x0", 0)]:
        wanted = list(before[owner][key])
        wanted.insert(min(place, len(wanted)), new)
        assert after[owner][key] == wanted, (owner, key)
    for key, values in before["plant"]["uncertainty"].items():
        if len(values) == len(states) and not isinstance(values[0], list):
            assert after["plant"]["uncertainty"][key] == [*values[:place], 0, *values[place:]]
    assert after["truth"]["omega"][place] == 0
    if "units" in before["plant"]:
        assert after["plant"]["units"][-1] == before["plant"]["units"][-1]
        assert len(after["plant"]["units"]) == len(names) + 1


def test_a_state_that_goes_takes_its_entries_along():
    after, header = with_named("theorem1-counterexample", ["x1"])
    assert "message" not in header and header["states"] == ["x1"]
    assert after["plant"]["chain"] == [] and len(after["simulation"]["x0"]) == 1
    after, header = with_named("stiction", ["v"])
    assert after["law"]["feedforward"] == 0 and header["states"] == ["v"]


def test_states_of_the_truth_s_own_stay():
    before = tomllib.loads(certrack.starter("dual-motor-physical"))
    names = [*before["plant"]["states"], "extra"]
    after = tomllib.loads(with_states(certrack.starter("dual-motor-physical"), names))
    assert after["truth"]["rates"] == before["truth"]["rates"]
    assert after["simulation"]["x0"] == before["simulation"]["x0"]
    assert after["truth"]["outputs"] == [*before["truth"]["outputs"], "0"]


def test_other_names_of_as_many_states_change_nothing_else():
    text = certrack.starter("example1")
    assert with_states(text, ["a", "b"]) == text
    assert with_states(text, []) == text
    for typed in ('["a", 1]', '["a", "a"]', "a, b", "["):
        assert names_typed(typed) == []
    assert names_typed(' ["a", "b"] ') == ["a", "b"]
    three = tomllib.loads(with_states(text, ["a", "b", "d"]))
    assert three["simulation"]["x0"] == [*tomllib.loads(text)["simulation"]["x0"], 0]


@pytest.mark.parametrize(
    "text",
    [
        "[plant",
        "plant = 3",
        "[plant]\nstates = 3",
        '[plant]\nstates = ["a", 2]',
        '[plant]\nstates = ["a", "b"]\nlinear = [3]\n[plant.uncertainty]\nDelta = []\nS = []',
        '[plant]\nstates = ["a", "b"]\n[law]\nkind = "robust"\nk = [1]\nc = []\nfeedforward = "q"',
        'law = 3\ntruth = 4\n[plant]\nstates = ["a", "b"]',
    ],
)
def test_a_broken_text_stays_for_loading_to_tell(text):
    for names in (["a", "b", "c"], ["b"]):
        changed = with_states(text, names)
        assert changed == text or tomllib.loads(changed)["plant"]["states"] == ["a", "b"]


def test_rows_of_states_follow():
    text = """
[plant]
states = ["a", "b", "d"]
linear = [[1], [2, 3]]
[plant.uncertainty]
Delta = [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
S = [1, 2, 3]
[law]
kind = "adaptive"
k = [[1, 2], [3, 4, 5, 6], [7, 8, 9, 10, 11, 12]]
p = [4, 5]
"""
    more = tomllib.loads(with_states(text, ["a", "new", "b", "d"]))
    assert more["plant"]["linear"] == [[1], [0, 0], [2, 0, 3]]
    assert more["plant"]["uncertainty"]["Delta"] == [
        [1, 0, 2, 3],
        [0, 0, 0, 0],
        [4, 0, 5, 6],
        [7, 0, 8, 9],
    ]
    assert more["plant"]["uncertainty"]["S"] == [1, 1, 2, 3]
    assert more["law"]["k"] == [[1, 2], [math.inf] * 4, [math.inf] * 6, [math.inf] * 8]
    assert more["law"]["p"] == [4, math.inf, 5]
    fewer = tomllib.loads(with_states(text, ["a", "b"]))
    assert fewer["plant"]["linear"] == [[1]]
    assert fewer["plant"]["uncertainty"]["Delta"] == [[1, 2], [4, 5]]
    assert fewer["law"]["k"] == [[1, 2], [3, 4, 5, 6]] and fewer["law"]["p"] == [4]


def test_an_edited_reference_keeps_the_comments_around_it():
    text = certrack.starter("example1")
    changed = with_reference_table(text, {"kind": "triangle", "amplitude": 0.2, "period": 10})
    assert changed.split("[reference]")[0] == text.split("[reference]")[0]
    assert certrack.loads(changed).reference.order == 1


# long computations say what they do


def said_in(frames):
    headers = map(frame_header, frames)
    return [header["words"] for header in headers if header["state"] == "running"]


def test_reports_have_their_words_and_the_first_of_each_part_is_shown():
    frames = []
    progress = TaskProgress("optimum", 5, frames.append)
    searches = progress.part("searches", "iterations")
    searches(0, 3, None)
    searches(1, 3, 14)  # too soon
    progress.part("runs", "worst so far", " rad")(400, 6000, 0.00412345)
    progress.part("steps", at_work=lambda done: f"step {done}")(2, None, 0.1)
    assert said_in(frames) == [
        "0 of 3 searches",
        "400 of 6000 runs \N{MIDDLE DOT} worst so far 0.0041234 rad",
        "step 2, steps 2",  # a bound that is not proven yet is not said
    ]
    assert [frame_header(frame)["share"] for frame in frames] == [0, 400 / 6000, None]


def test_runs_spent_are_said_of_their_loop():
    drive = DriveFalsification(1.0, None, None, None, None)
    assert _runs_spent(6255, None) == "6255"
    said = "6255 of the continuous law; 40 of the loop as the drive runs it"
    assert _runs_spent(6255, dataclasses.replace(drive, runs=40)) == said
    assert _runs_spent(6255, drive).endswith("by its linear kernels")


def test_a_limit_from_below_is_eased_by_less_of_it():
    assert eased(ActiveLimit("period", 0.01, 0.16)) == "10 % shorter period"
    assert eased(ActiveLimit("delay margin", 0.01, 0.16)) == "10 % shorter delay margin"
    assert eased(ActiveLimit("peak input", 40.0, 0.16)) == "10 % more peak input"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "options", "parts"),
    [
        ("falsify", {"budget": 100}, ["certifying, 0 of ", "0 of 100 runs"]),
        ("margins", {"members": 2}, ["values tried 1"]),
        ("tune", {"starts": 1}, ["0 of 1 starts", "tuned design: closed forms, 0 of "]),
    ],
)
def test_each_part_of_a_long_computation_is_named(task, options, parts):
    frames = []
    run_task(task, certrack.load("dual-motor-drive"), options, 5, frames.append)
    said = iter(said_in(frames))
    for part in parts:
        assert any(words.startswith(part) for words in said), part


@pytest.mark.slow
def test_the_first_members_of_an_ensemble_are_shown_early():
    frames = []
    options = {"members": FIRST_MEMBERS * MORE_MEMBERS}
    data = run_task("ensemble", certrack.load("example1"), options, 5, frames.append)
    early = [frame for frame in frames if frame_header(frame)["state"] == "early"]
    assert [frame_header(frame)["members"] for frame in early] == [FIRST_MEMBERS]
    said = said_in(frames)
    assert said[:2] == [f"the first {FIRST_MEMBERS} members", "certifying the limit of the error"]
    assert said[2].startswith(f"0 of {FIRST_MEMBERS * MORE_MEMBERS} members")
    assert frame_header(data)["state"] == "done"
    assert frame_header(data)["members"] == FIRST_MEMBERS * MORE_MEMBERS
    assert len(frame_arrays(data)) == len(frame_arrays(early[0]))

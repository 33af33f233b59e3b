"""The designer without a browser: messages, frames, gains, forms, sessions, files, security."""

import asyncio
import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import certrack
from certrack.app.decimation import decimate
from certrack.app.form import form_of, with_entries, with_numbers
from certrack.app.frames import (
    FrameKind,
    frame_arrays,
    frame_header,
    frame_prefix,
    pack_frame,
)
from certrack.app.gains import movable_gains, with_gains
from certrack.app.jobs import JOBS, JobContext
from certrack.app.launch import first_design, folder_of
from certrack.app.messages import MAX_MESSAGE, GainMove, parse_message
from certrack.app.open_design import Designs, continuous_law
from certrack.app.responses import metric_texts
from certrack.app.security import Access
from certrack.app.server import AppServer, static_files
from certrack.app.session import MAX_WAITING, QUEUE, Session
from certrack.app.workspace import Workspace
from certrack.core.errors import InputError
from certrack.core.rounding import printed_bound
from certrack.reports.tables import BOUND_TEXT_DIGITS, table
from certrack.simulation.metrics import METRIC_LABELS

SET = {"type": "set", "design": 1, "view": 0, "gains": {"law.c[0]": 2}, "pixels": 300}


# frames


def test_a_frame_gives_back_what_was_packed():
    rows = [np.array([0.0, 1.5, -2.25]), np.arange(5.0)]
    header = {"bound": math.inf, "text": "\N{GREEK SMALL LETTER THETA}", "list": (1, math.nan)}
    data = pack_frame(FrameKind.RUN, header, rows, design=70_000, view=9, data=b"abc")
    prefix = frame_prefix(data)
    assert (prefix.kind, prefix.design, prefix.view) == (FrameKind.RUN, 70_000, 9)
    assert prefix.header_bytes % 4 == 0 and data[:4] == b"CTR1"
    shown = frame_header(data)
    assert shown["bound"] is None and shown["list"] == [1, None] and shown["bytes"] == 3
    assert all((a == b).all() for a, b in zip(frame_arrays(data), rows, strict=True))
    assert data.endswith(b"abc")


def test_decimation_keeps_a_peak_of_one_sample_and_the_order_of_extremes():
    t = np.linspace(0, 20, 20_001)
    y = np.sin(t)
    y[12_345], y[12_346] = 50.0, -60.0
    times, (row,) = decimate(t, [y], 700)
    assert len(times) <= 1400 and (np.diff(times) > 0).all()
    assert row.max() == 50.0 and row.min() == -60.0
    assert row.argmax() < row.argmin()
    assert times[0] == 0 and abs(times[row.argmax()] - t[12_345]) <= 20 / 700
    short = decimate(t[:500], [y[:500]], 300)
    assert short[0] is not None and len(short[0]) == 500


# messages


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is not JSON"),
        ("[" * 10_000, "is not JSON"),
        ("[]", "must be an object"),
        ('{"type": "shell"}', "must be one of"),
        ('{"type": "set", "design": 1, "view": 0}', "message.pixels: is missing"),
        (json.dumps(SET | {"design": -1}), "whole number"),
        (json.dumps(SET | {"design": 2**32}), "whole number"),
        (json.dumps(SET | {"pixels": 10**9}), "whole number"),
        (json.dumps(SET | {"gains": {"law.c[0]": "2"}}), "must be a number"),
        (json.dumps(SET | {"gains": {"law.c[0]": True}}), "must be a number"),
        (json.dumps(SET | {"gains": {"law.c[0]": 1e400}}).replace("Infinity", "1e400"), "law.c[0]"),
        (json.dumps(SET | {"gains": {str(i): 1 for i in range(3000)}}), "at most"),
        (json.dumps(SET | {"window": [2, 1]}), "low must be less"),
        ('{"type": "open", "source": "url", "name": "x", "design": 1}', "must be one of"),
        ('{"type": "task", "task": "rm", "design": 1}', "must be one of"),
        ('{"type": "save", "name": "a\\nb", "text": ""}', "printable"),
        ("x" * (MAX_MESSAGE + 1), "longer than"),
    ],
)
def test_a_message_that_is_none_is_refused_in_words(text, says):
    with pytest.raises(InputError) as refused:
        parse_message(text)
    assert says in str(refused.value)


def test_a_move_is_read():
    move = parse_message(json.dumps(SET | {"window": [1, 2.5], "resting": True}))
    assert move == GainMove(1, 0, {"law.c[0]": 2.0}, (1.0, 2.5), 300, resting=True)


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
    assert header["texts"] == metric_texts(run)
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


# a session's mailbox


def opened_session(drive=False):
    session = Session()
    data = pack_frame(
        FrameKind.SYSTEM, {"text": "t", "name": "n", "problem": None, "drive": drive}, design=1
    )
    session.answered({"do": "describe", "design": 1}, data)
    session.outgoing.get_nowait()
    return session


def moved(design, **changes):
    values = SET | {"design": design} | changes
    return parse_message(json.dumps(values))


def test_the_newest_move_wins_and_the_bound_is_of_what_is_answered():
    session = opened_session()
    for design in range(2, 40):
        session.moved(moved(design))
    now = math.inf
    work = session.next_job("run", now)
    assert work["design"] == 39 and session.next_job("run", now) is None
    assert session.next_job("bound", now) is None
    session.answered(work, pack_frame(FrameKind.RUN, {}, design=39))
    session.moved(moved(40))
    assert session.next_job("bound", now)["design"] == 39
    assert session.next_job("exact", 0.0) is None, "a proof waits until the move rests"
    assert session.next_job("exact", now)["design"] == 40


def test_an_outdated_proof_is_dropped_and_a_fast_one_is_refined():
    session = opened_session()
    session.moved(moved(2))
    work = session.next_job("exact", math.inf)
    session.moved(moved(3))
    assert session.outdated(work)
    session.answered(work, pack_frame(FrameKind.EXACT, {"bound": 1}, design=2))
    assert session.outgoing.empty()
    work = session.next_job("exact", math.inf)
    session.answered(work, pack_frame(FrameKind.EXACT, {"bound": 1}, design=3))
    assert session.outgoing.qsize() == 1
    assert session.next_job("exact", math.inf)["effort"] == "default"
    assert session.next_job("exact", math.inf) is None


def test_a_view_alone_asks_for_no_bound_and_a_drive_is_run_as_it_is_at_rest():
    session = opened_session(drive=True)
    session.moved(moved(2))
    session.next_job("exact", math.inf), session.next_job("run", math.inf)
    assert session.next_job("bound", math.inf)["sampled"]
    session.moved(moved(2, view=7))
    assert session.next_job("exact", math.inf) is None
    assert session.next_job("run", math.inf)["view"] == 7


def test_a_page_that_does_not_read_loses_frames_and_one_that_floods_is_refused():
    session = opened_session()
    for _ in range(3 * QUEUE):
        session.note("x")
    assert session.outgoing.qsize() == QUEUE
    open_message = parse_message('{"type": "text", "design": 4, "text": "a", "name": "b"}')
    assert [session.opened(open_message) for _ in range(MAX_WAITING + 1)][-1] is False


def test_a_job_that_ends_its_worker_twice_is_not_tried_again():
    session = opened_session()
    session.moved(moved(2))
    work = session.next_job("run", math.inf)
    session.crashed(work, timed_out=False, seconds=20)
    session.crashed(work | {"do": "bound"}, timed_out=False, seconds=20)
    assert session.next_job("run", math.inf) == work
    session.crashed(work, timed_out=False, seconds=20)
    assert session.next_job("run", math.inf) is None
    kinds = [frame_prefix(session.outgoing.get_nowait()).kind for _ in range(3)]
    assert kinds == [FrameKind.NOTE, FrameKind.NOTE, FrameKind.PROBLEM]


# files and security


def test_no_file_outside_the_folder_is_read_or_written(tmp_path):
    inside, outside = tmp_path / "inside", tmp_path / "outside.toml"
    inside.mkdir()
    outside.write_text("[plant]\n")
    (inside / "link.toml").symlink_to(outside)
    (inside / "mine.toml").write_text("[plant]\n")
    space = Workspace(inside)
    assert space.files() == ["mine.toml"] and space.read("mine.toml") == "[plant]\n"
    names = [
        "../outside.toml",
        str(outside),
        "link.toml",
        "",
        ".",
        "a\0b",
        "sub/../../outside.toml",
    ]
    for name in names:
        with pytest.raises(InputError, match="is not in"):
            space.read(name)
        with pytest.raises(InputError, match="is not in"):
            space.write(name, "x", overwrite=True)
    assert outside.read_text() == "[plant]\n"
    assert space.write("new", "text", overwrite=False) == "new.toml"
    with pytest.raises(InputError, match="exists already"):
        space.write("new.toml", "other", overwrite=False)


def test_the_first_design_is_a_file_of_the_folder_or_a_shipped_system(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(certrack.starter())
    assert first_design("mine.toml", folder_of("mine.toml")) == "file mine.toml"
    assert first_design("example1", folder_of("example1")) == "catalog example1"
    assert first_design(None, folder_of(None)) == ""
    for wrong in ("example7", "nothing.toml"):
        with pytest.raises(InputError):
            first_design(wrong, folder_of(wrong))


class NoHub:
    """Stands for the workers, which none of these requests may reach."""

    sessions: dict = {}


def asked(path, *, host="127.0.0.1:8000", method="GET"):
    """Status, headers and body of a request, without a network."""
    access = Access(8000, "right-key")
    server = AppServer(access, Workspace.__new__(Workspace), "", NoHub())
    answers = []

    async def request():
        path_only, _, query = path.partition("?")
        scope = {
            "type": "http", "method": method, "path": path_only, "raw_path": path_only.encode(),
            "query_string": query.encode(), "headers": [(b"host", host.encode())],
            "http_version": "1.1", "scheme": "http", "root_path": "",
        }  # fmt: skip

        async def receive():
            return {"type": "http.request", "body": b""}

        async def send(message):
            answers.append(message)

        await server.application()(scope, receive, send)

    asyncio.run(request())
    headers = {name.decode(): value.decode() for name, value in answers[0]["headers"]}
    return answers[0]["status"], headers, b"".join(a.get("body", b"") for a in answers[1:])


@pytest.mark.parametrize(
    ("path", "host", "status"),
    [
        ("/?t=right-key", "127.0.0.1:8000", 200),
        ("/?t=right-key", "localhost:8000", 200),
        ("/", "127.0.0.1:8000", 403),
        ("/?t=wrong-key", "127.0.0.1:8000", 403),
        ("/?t=", "127.0.0.1:8000", 403),
        ("/?t=right-key", "evil.example:8000", 403),
        ("/?t=right-key", "127.0.0.1:8001", 403),
        ("/main.js", "127.0.0.1:8000", 200),
        ("/vendor/uPlot.js", "127.0.0.1:8000", 200),
        ("/main.js", "evil.example", 403),
        ("/index.html", "127.0.0.1:8000", 404),
        ("/../server.py", "127.0.0.1:8000", 404),
        ("/%2e%2e/server.py", "127.0.0.1:8000", 404),
        ("/vendor/../main.js", "127.0.0.1:8000", 404),
        ("//etc/passwd", "127.0.0.1:8000", 404),
    ],
)
def test_requests(path, host, status):
    code, headers, body = asked(path, host=host)
    assert code == status
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert b"right-key" not in body
    if status == 200 and path.startswith("/?"):
        assert b'id="plots"' in body


def test_only_get_is_answered():
    assert asked("/?t=right-key", method="POST")[0] == 405


def test_nothing_of_the_page_is_inline_or_from_elsewhere():
    for name, data in static_files().items():
        if name.startswith("vendor") or name.endswith((".svg", ".woff2")):
            continue
        text = data.decode()
        assert "http://" not in text.replace("http://www.w3.org/", ""), name
        assert "https://" not in text, name
        if name.endswith(".html"):
            assert "style=" not in text and "onclick" not in text and "<script>" not in text
        if name.endswith(".js"):
            assert "innerHTML" not in text and "insertAdjacentHTML" not in text, name
            assert "eval(" not in text and "new Function" not in text, name


def test_the_licences_of_what_is_vendored_are_there():
    files = static_files()
    assert b"MIT" in files["vendor/uPlot-LICENSE.txt"]
    assert b"Open Font License" in files["vendor/inter-LICENSE.txt"]
    assert sum(map(len, files.values())) < 400_000


@given(st.binary(min_size=0, max_size=40))
def test_keys_are_compared_whatever_they_are(data):
    access = Access(8000, "right-key")
    text = data.decode("latin-1")
    assert access.key_is_right(text) == (text == "right-key")
    assert not access.origin_is_ours(text) and not access.origin_is_ours(None)

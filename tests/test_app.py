"""The designer without a browser: messages, frames, sessions."""

import json
import math
import time

import numpy as np
import pytest

from certrack.app.decimation import decimate
from certrack.app.frames import (
    FrameKind,
    frame_arrays,
    frame_header,
    frame_prefix,
    of_revision,
    pack_frame,
)
from certrack.app.messages import MAX_MESSAGE, MAX_TEXT_BYTES, GainMove, parse_message
from certrack.app.outbox import QUEUE
from certrack.app.server import _refusal
from certrack.app.session import PAUSE, Session
from certrack.core.errors import InputError

SET = {
    "type": "set",
    "design": 1,
    "view": 0,
    "revision": 1,
    "gains": {"law.c[0]": 2},
    "pixels": 300,
}


# frames


def test_a_frame_gives_back_what_was_packed():
    rows = [np.array([0.0, 1.5, -2.25]), np.arange(5.0)]
    header = {"bound": math.inf, "text": "\N{GREEK SMALL LETTER THETA}", "list": (1, math.nan)}
    data = pack_frame(FrameKind.RUN, header, rows, design=70_000, view=9, data=b"abc")
    data = of_revision(data, 4_000_000_000)
    prefix = frame_prefix(data)
    assert prefix.revision == 4_000_000_000
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
        ('{"type": "set", "design": 1, "view": 0, "revision": 1}', "message.pixels: is missing"),
        ('{"type": "set", "design": 1, "view": 0}', "message.revision: is missing"),
        (json.dumps(SET | {"design": -1}), "whole number"),
        (json.dumps(SET | {"design": 2**32}), "whole number"),
        (json.dumps(SET | {"pixels": 10**9}), "whole number"),
        (json.dumps(SET | {"gains": {"law.c[0]": "2"}}), "must be a number"),
        (json.dumps(SET | {"gains": {"law.c[0]": True}}), "must be a number"),
        (json.dumps(SET | {"gains": {"law.c[0]": 1e400}}).replace("Infinity", "1e400"), "law.c[0]"),
        (json.dumps(SET | {"gains": {str(i): 1 for i in range(3000)}}), "at most"),
        (json.dumps(SET | {"window": [2, 1]}), "low must be less"),
        ('{"type": "open", "source": "url", "name": "x", "revision": 1}', "must be one of"),
        ('{"type": "task", "task": "rm", "revision": 1}', "must be one of"),
        ('{"type": "save", "name": "a\\nb", "text": ""}', "printable"),
        *(
            (json.dumps({"x": 1, **message})[:-1] + f', "{key}": {deep}}}', "lists in each other")
            for deep in ("[" * 600 + "]" * 600, '{"a":' * 300 + "[1]" + "}" * 300)
            for message, key in (
                ({}, "type"),
                (SET, "pixels"),
                (SET, "window"),
                (SET, "gains"),
                ({"type": "hello"}, "protocol"),
                ({"type": "task", "task": "tune", "design": 1, "revision": 1}, "options"),
            )
        ),
        ("x" * (MAX_MESSAGE + 1), "longer than"),
        ("\N{GREEK SMALL LETTER THETA}" * (MAX_MESSAGE // 2 + 1), "longer than"),
        (json.dumps({"type": "save", "name": "a", "text": "x" * (MAX_TEXT_BYTES + 1)}), "512 kB"),
    ],
)
def test_a_message_that_is_none_is_refused_in_words(text, says):
    with pytest.raises(InputError) as refused:
        parse_message(text)
    assert says in str(refused.value)
    answer = frame_header(_refusal(text, refused.value))
    assert answer["message"] == str(refused.value)
    assert answer["of"] is None or isinstance(answer["of"], str)


def test_a_move_is_read():
    move = parse_message(json.dumps(SET | {"window": [1, 2.5], "resting": True}))
    assert move == GainMove(1, 0, 1, {"law.c[0]": 2.0}, (1.0, 2.5), 300, resting=True)
    assert parse_message(json.dumps(SET | {"law": True})).law and not move.law


# a session's mailbox


def opened_session(drive=False):
    session = Session()
    data = pack_frame(FrameKind.SYSTEM, {"text": "t", "name": "n", "problem": None, "drive": drive})
    session.opened(parse_message(text_message(1)))
    session.answered(session.next_job("run", 0.0), data)
    session.outgoing.take()
    return session


def text_message(revision, text="t"):
    return json.dumps({"type": "text", "revision": revision, "text": text, "name": "n"})


def moved(design, **changes):
    values = SET | {"design": design} | changes
    return parse_message(json.dumps(values))


def test_where_the_gesture_ends_the_proof_begins_and_is_made_once():
    session = opened_session(drive=True)
    now = time.monotonic()
    session.moved(moved(2))
    assert session.next_job("exact", now) is None
    session.moved(moved(2, resting=True))
    now = time.monotonic()
    assert session.next_job("exact", now)["design"] == 2
    waiting = [session.next_job("bound", now) for _ in range(3)]
    assert [job["do"] for job in waiting] == ["text", "bound", "run"] and waiting[2]["sampled"]
    session.moved(moved(2, resting=True))
    assert session.next_job("exact", math.inf) is None
    session.moved(moved(2, view=1))
    assert session.next_job("exact", math.inf) is None
    assert [session.next_job("bound", math.inf)["do"] for _ in range(2)] == ["text", "run"]


def test_a_page_that_waits_for_an_answer_is_not_at_rest():
    """However long it waits: where the machine is busy, proofs would take what is left of it."""
    session = opened_session(drive=True)
    session.moved(moved(2))
    first = session.next_job("run", 1e9)
    session.moved(moved(3))
    assert session.next_job("exact", 1e9) is None
    session.answered(first, pack_frame(FrameKind.RUN, {}, design=2))
    assert session.next_job("exact", 1e9) is None, "the newest move has no answer yet"
    newest = session.next_job("run", 1e9)
    session.answered(newest, pack_frame(FrameKind.RUN, {}, design=3))
    now = time.monotonic()
    assert session.next_job("exact", now) is None
    assert session.next_job("exact", now + PAUSE)["design"] == 3
    jobs = [session.next_job("bound", now + PAUSE)["do"] for _ in range(2)]
    assert jobs == ["bound", "run"]


def test_a_drive_waits_for_the_answer_to_the_window_that_is_seen():
    session = opened_session(drive=True)
    session.moved(moved(2))
    first = session.next_job("run", 1e9)
    session.moved(moved(2, view=5))
    session.answered(first, pack_frame(FrameKind.RUN, {}, design=2))
    assert session.next_job("exact", 1e9)["design"] == 2, "a proof has no window"
    assert session.next_job("bound", 1e9)["do"] == "bound"
    assert session.next_job("bound", 1e9) is None
    second = session.next_job("run", 1e9)
    session.answered(second, pack_frame(FrameKind.RUN, {}, design=2, view=5))
    job = session.next_job("bound", 1e9)
    assert (job["do"], job["view"]) == ("run", 5), "of the same gains there is a bound"


def test_a_run_of_the_drive_that_crashed_does_not_hasten_the_next_one():
    session = opened_session(drive=True)
    session.moved(moved(2, resting=True))
    *_, old = (session.next_job("bound", 1e9) for _ in range(3))
    assert old["sampled"]
    session.moved(moved(3))
    session.crashed(old, timed_out=False, seconds=20)
    assert session.next_job("bound", 1e9)["do"] == "bound"
    assert session.next_job("bound", 1e9) is None


@pytest.mark.parametrize("timed_out", [True, False])
def test_a_move_whose_run_is_given_up_has_its_proof_all_the_same(timed_out):
    session = opened_session()
    session.moved(moved(2))
    work = session.next_job("run", 1e9)
    if not timed_out:
        session.crashed(work, timed_out=False, seconds=20)
        assert session.next_job("exact", 1e9) is None and session.next_job("run", 1e9) == work
    session.crashed(work, timed_out=timed_out, seconds=20)
    assert session.next_job("exact", time.monotonic() + PAUSE)["design"] == 2


def test_formulas_are_computed_only_where_the_page_shows_them():
    for law, asked in ((False, ["text", "bound"]), (True, ["text", "bound", "law"])):
        session = opened_session()
        session.moved(moved(2, resting=True, law=law))
        jobs = iter(lambda s=session: s.next_job("bound", math.inf), None)
        assert [job["do"] for job in jobs] == asked


def test_the_newest_move_wins_and_its_bound_does_not_wait_for_its_run():
    session = opened_session()
    for design in range(2, 40):
        session.moved(moved(design))
    now = math.inf
    work = session.next_job("run", now)
    assert work["design"] == 39 and session.next_job("run", now) is None
    assert session.next_job("bound", now)["design"] == 39
    assert session.next_job("bound", now) is None
    session.moved(moved(40))
    session.answered(work, pack_frame(FrameKind.RUN, {}, design=39))
    assert session.next_job("bound", now)["design"] == 40
    assert session.next_job("exact", 0.0) is None, "a proof waits until the move rests"
    assert session.next_job("exact", now)["design"] == 40


def test_an_outdated_proof_is_dropped_and_a_fast_one_is_refined():
    session = opened_session()
    session.moved(moved(2))
    work = session.next_job("exact", math.inf)
    session.moved(moved(3))
    assert session.outdated(work)
    session.answered(work, pack_frame(FrameKind.EXACT, {"bound": 1}, design=2))
    assert len(session.outgoing) == 0
    work = session.next_job("exact", math.inf)
    session.answered(work, pack_frame(FrameKind.EXACT, {"bound": 1}, design=3))
    assert len(session.outgoing) == 1
    assert session.next_job("exact", math.inf)["effort"] == "default"
    assert session.next_job("exact", math.inf) is None


def test_a_view_alone_asks_for_no_bound_and_a_drive_is_run_as_it_is_at_rest():
    session = opened_session(drive=True)
    session.moved(moved(2))
    session.next_job("exact", math.inf), session.next_job("run", math.inf)
    jobs = [session.next_job("bound", math.inf) for _ in range(2)]
    assert jobs[0]["do"] == "bound" and jobs[1]["sampled"]
    session.moved(moved(2, view=7))
    assert session.next_job("exact", math.inf) is None
    assert session.next_job("run", math.inf)["view"] == 7


def test_a_page_that_does_not_read_loses_curves_but_neither_the_newest_nor_a_result():
    session = opened_session()
    session.send(pack_frame(FrameKind.TASK, {"state": "done"}))
    for design in range(3 * QUEUE):
        session.send(pack_frame(FrameKind.RUN, {}, design=design))
    assert len(session.outgoing) == QUEUE
    kept = [frame_prefix(session.outgoing.take()) for _ in range(QUEUE)]
    assert kept[0].kind is FrameKind.TASK and kept[-1].design == 3 * QUEUE - 1
    for _ in range(3 * QUEUE):
        session.note("x")
    assert len(session.outgoing) == QUEUE


# texts


def described(session, work, **header):
    header = {"text": work["text"], "name": "n", "problem": None, "drive": False} | header
    session.answered(work, of_revision(pack_frame(FrameKind.SYSTEM, header), work["revision"]))


def test_gains_of_another_text_are_answered_but_not_carried_out():
    """Otherwise a page that moves a slider while its text is read waits for ever."""
    session = opened_session()
    session.opened(parse_message(text_message(2, "new")))
    session.moved(moved(2, view=3))
    assert session.next_job("run", math.inf)["do"] == "describe"
    old = session.next_job("run", math.inf)
    assert old["revision"] == 1, "the text at hand is worked on while another is read"
    described(session, {"do": "describe", "revision": 2, "text": "new"})
    session.outgoing.take()
    session.answered(old, pack_frame(FrameKind.RUN, {}, design=2))
    assert len(session.outgoing) == 0, "what was computed for the old text is not sent"
    session.moved(moved(3, view=4))
    answer = session.outgoing.take()
    prefix = frame_prefix(answer)
    assert (prefix.design, prefix.view, prefix.revision) == (3, 4, 1)
    assert frame_header(answer)["superseded"] and session.next_job("run", math.inf) is None
    session.moved(moved(4, revision=2))
    assert session.next_job("run", math.inf)["text"] == "new"


def test_the_newest_text_wins_whichever_is_read_first():
    session = opened_session()
    session.opened(parse_message(text_message(2, "slow")))
    slow = session.next_job("run", 0.0)
    for revision in range(3, 9):
        session.opened(parse_message(text_message(revision, f"text {revision}")))
    newest = session.next_job("run", 0.0)
    assert newest["text"] == "text 8" and session.next_job("run", 0.0) is None
    assert session.outdated(slow) and not session.outdated(newest)
    described(session, newest)
    session.outgoing.take()
    described(session, slow)
    assert len(session.outgoing) == 0 and session.base.text == "text 8"
    session.crashed(slow, timed_out=True, seconds=1)
    assert len(session.outgoing) == 0


def test_a_long_computation_of_another_text_does_not_begin():
    session = opened_session()
    start = {"type": "task", "task": "falsify", "design": 3, "revision": 2}
    assert session.long_job(parse_message(json.dumps(start))) is None
    start["revision"] = 1
    assert session.long_job(parse_message(json.dumps(start)))["text"] == "t"


def test_what_is_exported_is_named_after_the_file_that_the_text_was_saved_to():
    def exported():
        message = {"type": "export", "format": "toml", "design": 3, "revision": session.asked}
        return session.long_job(parse_message(json.dumps(message)))["name"]

    session = opened_session()
    assert exported() == "n"
    session.saved("mine.toml", 0)  # another text was asked for meanwhile
    assert exported() == "n"
    session.saved("mine.toml", 1)
    assert exported() == "mine.toml"
    session.opened(parse_message(text_message(2, "other")))
    described(session, session.next_job("run", 0.0))
    assert exported() == "n"


def test_a_long_computation_whose_process_is_gone_ends_with_a_message():
    session = opened_session()
    work = {"do": "task", "task": "tune", "design": 4, "revision": 1, "page": session.id}
    session.crashed(work, timed_out=False, seconds=1)
    header = frame_header(session.outgoing.take())
    assert (
        header["of"] == "task"
        and header["task"] == "tune"
        and "start it again" in header["message"]
    )


def test_a_refinement_that_fails_says_of_what_it_was():
    session = opened_session()
    session.moved(moved(2))
    work = session.next_job("exact", math.inf)
    session.answered(work, pack_frame(FrameKind.EXACT, {"bound": 1}, design=2))
    session.outgoing.take()
    refining = session.next_job("exact", math.inf)
    session.crashed(refining, timed_out=True, seconds=900)
    header = frame_header(session.outgoing.take())
    assert (header["of"], header["effort"]) == ("exact", "default") and "900 s" in header["message"]


def test_a_job_that_ends_its_worker_twice_is_not_tried_again():
    session = opened_session()
    session.moved(moved(2))
    work = session.next_job("run", math.inf)
    session.crashed(work, timed_out=False, seconds=20)
    session.crashed(work | {"do": "bound"}, timed_out=False, seconds=20)
    assert session.next_job("run", math.inf) == work
    session.crashed(work, timed_out=False, seconds=20)
    assert session.next_job("run", math.inf) is None
    kinds = [frame_prefix(session.outgoing.take()).kind for _ in range(3)]
    assert kinds == [FrameKind.NOTE, FrameKind.NOTE, FrameKind.PROBLEM]

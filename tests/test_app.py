"""The designer without a browser: messages, frames, sessions."""

import json
import math

import numpy as np
import pytest

from certrack.app.decimation import decimate
from certrack.app.frames import (
    FrameKind,
    frame_arrays,
    frame_header,
    frame_prefix,
    pack_frame,
)
from certrack.app.messages import MAX_MESSAGE, GainMove, parse_message
from certrack.app.session import MAX_WAITING, QUEUE, Session
from certrack.core.errors import InputError

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

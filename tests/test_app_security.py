"""Files, requests and keys of the designer, and what a machine without its packages is told."""

import asyncio
import errno
import json
import os
import socket
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import certrack
from certrack.app import server as server_module
from certrack.app.frames import frame_header, frame_prefix
from certrack.app.launch import _listening, first_design, folder_of, serve_designer
from certrack.app.messages import MAX_TEXT_BYTES, parse_message
from certrack.app.security import Access
from certrack.app.server import AppServer, static_files
from certrack.app.session import Session
from certrack.app.workspace import FileChanged, Workspace
from certrack.core.errors import InputError

# files and security


def test_no_file_outside_the_folder_is_read_or_written(tmp_path):
    inside, outside = tmp_path / "inside", tmp_path / "outside.toml"
    inside.mkdir()
    outside.write_text("[plant]\n")
    (inside / "link.toml").symlink_to(outside)
    (inside / "mine.toml").write_text("[plant]\n")
    space = Workspace(inside)
    assert space.files() == ["mine.toml"] and space.read("mine.toml").text == "[plant]\n"
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
            space.write(name, "x", known="")
    assert outside.read_text() == "[plant]\n"
    assert space.write("new", "text", known="")[0] == "new.toml"
    with pytest.raises(FileChanged, match="exists already"):
        space.write("new.toml", "other", known="")


def test_a_file_that_has_changed_on_the_disk_is_not_replaced(tmp_path):
    space = Workspace(tmp_path)
    _, first = space.write("mine.toml", "one", known="")
    assert space.read("mine.toml").digest == first
    _, second = space.write("mine.toml", "two", known=first)
    (tmp_path / "mine.toml").write_text("by another hand")
    with pytest.raises(FileChanged, match="has changed on the disk") as change:
        space.write("mine.toml", "three", known=second)
    assert (tmp_path / "mine.toml").read_text() == "by another hand"
    space.write("mine.toml", "three", known=change.value.digest)
    assert (tmp_path / "mine.toml").read_text() == "three"
    (tmp_path / "mine.toml").unlink()
    space.write("mine.toml", "four", known=second)
    assert (tmp_path / "mine.toml").read_text() == "four"


def test_texts_have_one_limit_wherever_they_come_from(tmp_path):
    space, text = Workspace(tmp_path), "x" * MAX_TEXT_BYTES
    space.write("fits.toml", text, known="")
    assert space.read("fits.toml").text == text
    (tmp_path / "long.toml").write_text(text + "x")
    with pytest.raises(InputError, match="larger than 512 kB"):
        space.read("long.toml")
    with pytest.raises(InputError, match="larger than 512 kB"):
        space.write("longer.toml", text + "x", known="")
    for kind, more in (("text", {}), ("edit", {"entries": {}}), ("save", {})):
        message = {"type": kind, "name": "a", "revision": 1} | more
        parse_message(json.dumps(message | {"text": text}))
        with pytest.raises(InputError, match="larger than 512 kB"):
            parse_message(json.dumps(message | {"text": text + "x"}))


NAMES_TOO_LONG = ["a" * 300, "a" * 253, "a/" + "b" * 300, "a" * 300 + "/b"]


@pytest.mark.parametrize("name", NAMES_TOO_LONG)
def test_a_name_that_the_disk_does_not_take_is_told(tmp_path, name):
    space = Workspace(tmp_path)
    (tmp_path / "a").mkdir()
    with pytest.raises(InputError, match="File name too long"):
        space.write(name, "x", known="")
    if len(name) > 255:
        with pytest.raises(InputError, match="File name too long.*Choose a shorter name"):
            space.read(name)
    assert [path.name for path in tmp_path.rglob("*")] == ["a"]


def test_a_folder_that_may_not_be_looked_into_is_told(tmp_path, monkeypatch):
    def locked(self, **_):
        raise PermissionError(errno.EACCES, "Permission denied", str(self))

    space = Workspace(tmp_path)
    monkeypatch.setattr(Path, "exists", locked)
    for request in (lambda: space.read("a.toml"), lambda: space.write("a", "x", known="")):
        with pytest.raises(InputError, match=r"cannot be looked up \(Permission denied\)"):
            request()


@pytest.mark.parametrize(
    ("problem", "says"),
    [
        (InputError("a", "is no file"), "a: is no file"),
        (OSError(errno.EIO, "Input/output error"), "The disk refused it: Input/output error."),
        (ValueError("no idea"), "ValueError: no idea"),
    ],
)
def test_whatever_goes_wrong_with_the_disk_is_an_answer(problem, says):
    async def fails():
        raise problem

    async def succeeds():
        done.append(True)

    async def talk():
        session = Session()
        disk = server_module._OneAfterAnother(session)
        disk.begin("save", fails(), 7)
        disk.begin("save", succeeds(), 8)
        frame = await asyncio.wait_for(session.outgoing.get(), 10)
        while not done:
            await asyncio.sleep(0)
        return frame

    done: list[bool] = []
    frame = asyncio.run(talk())
    assert frame_prefix(frame).kind.name == "PROBLEM" and frame_prefix(frame).revision == 7
    assert frame_header(frame)["message"] == says and frame_header(frame)["of"] == "save"


def test_a_folder_without_end_is_listed_in_time(tmp_path, monkeypatch):
    monkeypatch.setattr("certrack.app.workspace.MAX_SCANNED", 50)
    for k in range(200):
        (tmp_path / f"{k:03}.toml").write_text("[plant]\n")
    assert len(Workspace(tmp_path).files()) == 50
    monkeypatch.setattr("certrack.app.workspace.LONGEST_LISTING", 0.0)
    assert Workspace(tmp_path).files() == []


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
    assert sum(map(len, files.values())) < 430_000


@given(st.binary(min_size=0, max_size=40))
def test_keys_are_compared_whatever_they_are(data):
    access = Access(8000, "right-key")
    text = data.decode("latin-1")
    assert access.key_is_right(text) == (text == "right-key")
    assert not access.origin_is_ours(text) and not access.origin_is_ours(None)


@pytest.mark.parametrize("package", ["starlette", "uvicorn", "websockets"])
def test_without_the_extra_one_line_says_what_to_install(package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(certrack.MissingExtra, match=r"pip install 'certrack\[app\]'"):
        serve_designer(None, host="127.0.0.1", port=0, browser=False, say=print)


@pytest.mark.skipif(sys.platform == "win32", reason="links and pipes of POSIX")
def test_odd_entries_of_the_folder_lock_nobody_out(tmp_path):
    """Links in a circle, pipes, hidden and deep folders, and names without end."""
    space = Workspace(tmp_path)
    text = '[plant]\nstates = ["x1"]\n'
    (tmp_path / "b.toml").symlink_to("a.toml")
    (tmp_path / "a.toml").symlink_to("b.toml")
    os.mkfifo(tmp_path / "pipe.toml")
    for folder in (".hidden", "one/two", "one/two/three"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "c.toml").write_text(text)
    (tmp_path / "one" / "self").symlink_to(tmp_path)
    (tmp_path / "fine.toml").write_text(text)
    assert space.files() == ["fine.toml", "one/two/c.toml"]
    for name in ("a.toml", "pipe.toml", "a/" * 500_000 + "x"):
        with pytest.raises(InputError):
            space.read(name)
        with pytest.raises(InputError):
            space.write(name, text, known="")


def test_a_text_that_no_file_can_hold_is_refused():
    message = json.dumps({"type": "save", "name": "a.toml", "text": "a\ud800"})
    with pytest.raises(InputError, match="lone surrogates"):
        parse_message(message)


def test_a_frame_does_not_wait_until_the_page_has_acknowledged_another():
    async def delay_of_a_connection():
        options = asyncio.get_running_loop().create_future()

        def connected(_, writer):
            accepted = writer.get_extra_info("socket")
            options.set_result(accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        with _listening("127.0.0.1", 0) as listener:
            async with await asyncio.start_server(connected, sock=listener):
                _, writer = await asyncio.open_connection(*listener.getsockname())
                writer.close()
                return await options

    assert asyncio.run(delay_of_a_connection())

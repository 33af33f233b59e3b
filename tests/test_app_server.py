"""The designer's server with real workers, by clients of its protocol."""

import asyncio
import contextlib
import os
import signal
import socket
import time
from pathlib import Path

import pytest
import websockets
from app_client import PATIENCE, page, running

import certrack

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with running("dual-motor-lean", folder=tmp_path_factory.mktemp("app")) as started:
        yield started


def test_the_command_prints_one_address_with_its_key(server):
    assert server.address.startswith("http://127.0.0.1:") and "/?t=" in server.address


async def refused(server, query, **options):
    address = server.socket.split("?")[0] + query
    try:
        async with websockets.connect(address, **options):
            return False
    except websockets.InvalidStatus as refusal:
        return refusal.response.status_code == 403


def test_who_is_not_our_page_is_refused(server):
    right = f"?t={server.key}"

    async def attempts():
        yield await refused(server, query="", origin=server.origin)
        yield await refused(server, query="?t=wrong", origin=server.origin)
        yield await refused(server, query=right)
        yield await refused(server, query=right, origin="http://evil.example")
        yield await refused(server, query=right, origin=server.origin.replace("127", "128"))

    async def collected():
        return [attempt async for attempt in attempts()]

    assert all(asyncio.run(collected()))


def test_a_message_that_is_too_long_closes_the_connection_and_others_live(server):
    async def talk():
        async with page(server) as other, page(server) as client:
            await client.send("text", text="x" * (2 << 20), name="n")
            with pytest.raises(websockets.ConnectionClosed) as closed:
                await client.receive("SYSTEM")
            assert closed.value.rcvd.code == 1009
            assert (await other.open("dual-motor-lean"))["title"]

    asyncio.run(talk())


def test_moves_are_answered_and_the_last_is_proven(server):
    async def talk():
        async with page(server) as client:
            system = await client.open("dual-motor-lean")
            assert [gain["path"] for gain in system["gains"]] == [f"law.c[{i}]" for i in range(4)]
            answered = []
            for design in range(2, 30):
                gains = {"law.c[0]": 6 + 0.1 * design}
                await client.move(design, gains, resting=design == 29)
                if design % 2:
                    answered.append((await client.receive("RUN"))[0].design)
            while answered[-1] < 29:
                answered.append((await client.receive("RUN"))[0].design)
            assert answered == sorted(answered)
            prefix, exact, _ = await client.receive("EXACT")
            assert prefix.design == 29 and exact["verified"]
            bounds = [h for p, h in client.frames if p.kind.name == "BOUND" and p.design == 29]
            if bounds:
                assert bounds[-1]["bound"] == pytest.approx(exact["bound"], rel=1e-3)
            texts = [h["text"] for p, h in client.frames if p.kind.name == "TEXT"]
            if not texts:  # another process writes it, beside the proof
                texts = [(await client.receive("TEXT"))[1]["text"]]
            assert certrack.loads(texts[-1]).law.c[0] == 8.9
            return exact["bound"]

    bound = asyncio.run(talk())
    system = certrack.load("dual-motor-lean")
    law = system.law.__class__(c=(8.9, 6, 6, 6), feedforward=1)
    assert bound == pytest.approx(certrack.certify(system.replace(law=law)).best.bound, rel=1e-6)


def test_hostile_texts_are_told_and_the_server_lives(server):
    starter = certrack.starter("dual-motor-lean")
    deep = "(" * 5000 + "x1" + ")" * 5000
    bombs = [
        "",
        "[plant",
        starter.replace('drift = "', f'drift = "{deep}+'),
        starter.replace('drift = "', 'drift = "9**9**9**9+'),
        starter.replace('drift = "', 'drift = "(x1+x2+x3+x4+1)**400+'),
        starter.replace('drift = "', 'drift = "' + "*".join(["(x1+x2+1)"] * 300) + "+"),
        starter.replace('drift = "', 'drift = "' + "sin(" * 200 + "x1" + ")" * 200 + "+"),
        starter.replace('drift = "', 'drift = "' + "1" * 100_000 + "+"),
        starter.replace('signal = "', "signal = \"__import__('os')+"),
        starter.replace("duration = 20", "duration = 1e300"),
        starter.replace('title = "', 'title = "<img src=x onerror=alert(1)>'),
    ]

    async def talk():
        problems = []
        async with page(server) as client:
            for text in bombs:
                await client.send("text", text=text, name="bomb.toml")
                problems.append((await client.receive("SYSTEM"))[1]["problem"])
            await client.send("nonsense")
            await client.receive("PROBLEM")
            assert (await client.open("dual-motor-lean"))["problem"] is None
        return problems

    problems = asyncio.run(talk())
    assert all(problem and "\n" not in problem["message"] for problem in problems[:9]), problems


def test_a_killed_worker_is_started_again_and_nothing_is_lost(server):
    async def talk():
        async with page(server) as client:
            await client.open("dual-motor-lean")
            await client.move(2)
            await client.receive("EXACT")
            before = server.workers()
            for role in ("run", "bound", "exact"):
                os.kill(before[role], signal.SIGKILL)
            await client.move(3, {"law.c[1]": 7.0}, resting=True)
            await client.receive("RUN", where=lambda h: True)
            prefix, exact, _ = await client.receive("EXACT")
            assert prefix.design == 3 and exact["verified"]
            assert not set(before.values()) & set(server.workers().values())

    asyncio.run(talk())


def test_long_computations_report_end_and_are_cancelled(server):
    async def talk():
        async with page(server) as client:
            await client.open("dual-motor-lean")
            await client.move(2)
            await client.send("task", task="falsify", options={"budget": 200}, design=2)
            _, done, rows = await client.receive("TASK", where=lambda h: h["state"] == "done")
            assert done["worst"] <= float(done["certified"]) and len(rows) == 2
            await client.send("task", task="ensemble", options={"members": 100_000}, design=2)
            await client.receive("TASK", where=lambda h: h["state"] == "running")
            await client.send("task", task="falsify", options={}, design=2)
            assert "One long" in (await client.receive("PROBLEM"))[1]["message"]
            task = server.workers()["task"]
            await client.send("cancel")
            await client.receive("TASK", where=lambda h: h["state"] == "cancelled")
            for _ in range(100):
                if not Path(f"/proc/{task}").exists():
                    break
                await asyncio.sleep(0.05)
            assert not Path(f"/proc/{task}").exists()
            options = {"starts": 1, "objective": "x"}
            await client.send("task", task="tune", options=options, design=2)
            assert "must be one of" in (await client.receive("PROBLEM"))[1]["message"]

    asyncio.run(talk())


def test_a_long_computation_whose_process_is_killed_ends_and_the_next_one_begins(server):
    async def talk():
        async with page(server) as client:
            await client.open("dual-motor-lean")
            await client.move(2)
            await client.send("task", task="ensemble", options={"members": 100_000}, design=2)
            await client.receive("TASK", where=lambda h: h["state"] == "running")
            os.kill(server.workers()["task"], signal.SIGKILL)
            _, header, _ = await client.receive("PROBLEM", where=lambda h: h["of"] == "task")
            assert header["task"] == "ensemble" and "start it again" in header["message"]
            await client.send("cancel")
            await client.receive("TASK", where=lambda h: h["state"] == "cancelled")
            await client.send("task", task="falsify", options={"budget": 200}, design=2)
            await client.receive("TASK", where=lambda h: h["state"] == "done")

    asyncio.run(talk())


def test_a_move_while_a_text_is_read_is_answered_and_the_page_goes_on(server):
    async def talk():
        async with page(server) as client:
            text = (await client.open("dual-motor-lean"))["text"]
            for k in range(5):
                changed = text.replace("duration = 20", f"duration = {19 - k}")
                await client.send("text", text=changed, name="a.toml")
                for j in range(3):
                    await client.move(
                        10 * k + j + 2, {"law.c[0]": 6.5}, revision=client.revision - 1
                    )
            prefix, system, _ = await client.receive("SYSTEM")
            assert (prefix.revision, system["duration"]) == (client.revision, 15)
            await client.move(99, {"law.c[0]": 7.0}, revision=client.revision - 1)
            prefix, _, _ = await client.receive("PROBLEM", where=lambda h: h["superseded"])
            while prefix.design != 99:
                prefix, _, _ = await client.receive("PROBLEM")
            await client.move(100, {"law.c[0]": 7.0})
            prefix, _, _ = await client.receive("RUN")
            assert (prefix.design, prefix.revision) == (100, client.revision)

    asyncio.run(talk())


def test_a_text_that_takes_long_does_not_hold_up_a_newer_one(server):
    """Its worker is ended after a second, and the newer text is read by another."""

    async def talk():
        async with page(server) as client:
            text = (await client.open("dual-motor-lean"))["text"]
            os.kill(server.workers()["run"], signal.SIGSTOP)  # it reads for ever
            await client.send("text", text=text + "\n", name="slow.toml")
            await asyncio.sleep(0.2)
            await client.send("text", text=text, name="a.toml")
            prefix, system, _ = await client.receive("SYSTEM")
            assert prefix.revision == client.revision and system["problem"] is None

    asyncio.run(talk())


def test_files_are_saved_over_what_is_known_only(server, tmp_path_factory):
    async def talk():
        async with page(server) as client:
            text = (await client.open("dual-motor-lean"))["text"]
            saved = {"name": "mine.toml", "text": text}
            await client.send("save", **saved)
            first = (await client.receive("NOTE", where=lambda h: "saved" in h))[1]
            await client.send("open", source="file", name="mine.toml")
            _, system, _ = await client.receive("SYSTEM")
            assert system["file"] == {"name": "mine.toml", "digest": first["digest"]}
            await client.send("save", **saved | {"text": text + "\n"}, known=first["digest"])
            await client.receive("NOTE", where=lambda h: "saved" in h)
            await client.send("save", **saved, known=first["digest"])
            change = (await client.receive("NOTE", where=lambda h: "conflict" in h))[1]["conflict"]
            assert "has changed on the disk" in change["reason"]
            await client.send("save", **saved, known=change["digest"])
            await client.receive("NOTE", where=lambda h: "saved" in h)
            await client.send("open", source="file", name="nothing.toml")
            prefix, problem, _ = await client.receive("PROBLEM")
            assert problem["of"] == "open" and prefix.revision == client.revision
            for kind, more in (("open", {"source": "file"}), ("save", {"text": text})):
                await client.send(kind, name="a" * 300, **more)
                problem = (await client.receive("PROBLEM"))[1]
                assert problem["of"] == kind and "File name too long" in problem["message"]
            await client.connection.send('{"type": ' + "[" * 600 + "]" * 600 + "}")
            assert "in each other" in (await client.receive("PROBLEM"))[1]["message"]
            await client.send("save", **saved | {"name": "still-here.toml"})
            await client.receive("NOTE", where=lambda h: "saved" in h)

    asyncio.run(talk())


@pytest.mark.parametrize("wanted", ["toml", "certificate", "c", "st", "fmu", "netcdf", "svg"])
def test_exports(server, wanted, tmp_path):
    from certrack.app.frames import frame_header, frame_prefix

    async def talk():
        async with page(server) as client:
            await client.open("dual-motor-lean")
            await client.move(2)
            gains = {"law.c[0]": 6.5}
            await client.send("export", format=wanted, design=2, gains=gains)
            while True:
                data = await asyncio.wait_for(client.connection.recv(), PATIENCE)
                if frame_prefix(data).kind.name == "PROBLEM":
                    raise AssertionError(frame_header(data)["message"])
                if frame_prefix(data).kind.name == "FILE":
                    header = frame_header(data)
                    return header["name"], data[-header["bytes"] :]

    name, content = asyncio.run(talk())
    if wanted == "toml":
        assert certrack.loads(content).law.c[0] == 6.5
    if wanted == "certificate":
        (tmp_path / name).write_bytes(content)
        assert certrack.certificates.verify(tmp_path / name).verified
    if wanted == "c":
        import io
        import zipfile

        names = zipfile.ZipFile(io.BytesIO(content)).namelist()
        assert any(entry.endswith(".c") for entry in names)
    assert len(content) > 500


def test_a_killed_server_leaves_no_worker_and_a_new_one_knows_the_key(tmp_path):
    with running(folder=tmp_path) as first:
        end = time.monotonic() + PATIENCE
        while len(workers := first.workers()) < 3 and time.monotonic() < end:
            time.sleep(0.1)
        port = int(first.host.split(":")[1])
        first.process.kill()
        end = time.monotonic() + 20
        while any(map(_lives, workers.values())) and time.monotonic() < end:
            time.sleep(0.1)
        assert len(workers) == 3 and not any(map(_lives, workers.values()))
    with running(folder=tmp_path, port=port) as second:
        assert second.address == first.address


def _lives(process):
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def test_a_thousand_connections_hold_neither_up_a_page_nor_the_server(server):
    async def talk():
        async with page(server) as client:
            await client.open("dual-motor-lean")
            held = await asyncio.gather(
                *(asyncio.open_connection(*server.host.split(":")) for _ in range(1000)),
                return_exceptions=True,
            )
            await client.move(2, {"law.c[0]": 6.5})
            assert (await client.receive("RUN"))[0].design == 2
            async with page(server) as another:  # while all the others are still there
                assert (await another.open("dual-motor-lean"))["title"]
            for entry in held:
                if not isinstance(entry, BaseException):
                    entry[1].close()

    asyncio.run(talk())


def test_a_request_that_never_ends_is_closed(server):
    """One byte of a header now and then, and a second request that is begun only."""
    from certrack.app.connections import REQUEST_DEADLINE

    host, port = server.host.split(":")
    with (
        socket.create_connection((host, int(port)), PATIENCE) as slow,
        socket.create_connection((host, int(port)), PATIENCE) as second,
    ):
        second.sendall(f"GET /icon.svg HTTP/1.1\r\nHost: {server.host}\r\n\r\n".encode())
        assert second.recv(1 << 16).startswith(b"HTTP/1.1 200")
        begin = time.monotonic()
        for connection in (slow, second):
            connection.settimeout(0.5)
            connection.sendall(b"GET / HTTP/1.1\r\nX: ")
        open_ones = [slow, second]
        while open_ones and time.monotonic() - begin < REQUEST_DEADLINE + 20:
            for connection in list(open_ones):
                try:
                    connection.sendall(b"x")
                    if connection.recv(1000) == b"":
                        open_ones.remove(connection)
                except TimeoutError:
                    continue
                except OSError:
                    open_ones.remove(connection)
        assert not open_ones and time.monotonic() - begin > REQUEST_DEADLINE / 2


@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_body_of_50_megabytes_is_not_kept(server, method):
    def memory():
        status = Path(f"/proc/{server.process.pid}/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) / 1024

    host, port = server.host.split(":")
    before, size = memory(), 50 << 20
    with socket.create_connection((host, int(port)), PATIENCE) as connection:
        head = f"{method} / HTTP/1.1\r\nHost: {server.host}\r\nContent-Length: {size}\r\n\r\n"
        connection.sendall(head.encode())
        with contextlib.suppress(OSError):
            for _ in range(50):
                connection.sendall(b"x" * (1 << 20))
        answer = connection.recv(100)
    assert answer.startswith(b"HTTP/1.1 403" if method == "GET" else b"HTTP/1.1 405")
    assert memory() < before + 20

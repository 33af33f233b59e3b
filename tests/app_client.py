"""A page without a browser: a server in a process of its own, and a client of its protocol."""

import asyncio
import json
import os
import re
import subprocess
import sys
import time
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import websockets

from certrack.app.frames import frame_arrays, frame_header, frame_prefix

#: Longest wait for an answer, s: machines of tests may be slow and busy.
PATIENCE = 240

KEY = "key-of-the-tests"


class Server:
    """A running ``certrack app``."""

    def __init__(self, process, address):
        self.process, self.address = process, address
        self.host, self.key = re.fullmatch(r"http://([^/]+)/\?t=(.+)", address).groups()

    @property
    def socket(self):
        return f"ws://{self.host}/ws?t={self.key}"

    @property
    def origin(self):
        return f"http://{self.host}"

    def workers(self):
        """Process numbers of its children by their role."""
        children = {}
        for place in Path("/proc").glob("[0-9]*"):
            try:
                parent = int((place / "stat").read_text().rpartition(")")[2].split()[1])
                command = (place / "cmdline").read_bytes().split(b"\0")
            except (OSError, ValueError):
                continue
            if parent == self.process.pid and b"certrack.app.worker" in command:
                role = command[command.index(b"certrack.app.worker") + 1].decode()
                children[role] = int(place.name)
        return children


@contextmanager
def running(*arguments, folder, port=0, key=KEY):
    """A server in `folder`; its workers end with it."""
    environment = {**os.environ, "CERTRACK_APP_KEY": key, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "certrack", "app", *arguments]
    process = subprocess.Popen(
        [*command, "--no-browser", "--port", str(port)],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        server = Server(process, process.stdout.readline().strip())
        await_listening(server)
        yield server
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()


def await_listening(server):
    """Wait until the server answers."""
    import socket

    host, port = server.host.split(":")
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            socket.create_connection((host, int(port)), 1).close()
            return
        except OSError:
            time.sleep(0.05)
    raise AssertionError("the server does not answer")


class Page:
    """A client that speaks the protocol."""

    def __init__(self, connection):
        self.connection = connection
        self.frames = []
        self.revision = 0

    async def send(self, kind, **values):
        """A message; a text is a new revision, anything else is of the newest one."""
        if kind in ("open", "text", "edit"):
            self.revision += 1
        if kind in ("open", "text", "edit", "set", "task", "export"):
            values.setdefault("revision", self.revision)
        await self.connection.send(json.dumps({"type": kind, **values}))

    async def receive(self, *kinds, where=lambda header: True):
        """The next frame of these kinds; every frame that comes is remembered."""
        while True:
            data = await asyncio.wait_for(self.connection.recv(), PATIENCE)
            prefix, header = frame_prefix(data), frame_header(data)
            self.frames.append((prefix, header))
            if prefix.kind.name in kinds and where(header):
                return prefix, header, frame_arrays(data)

    async def open(self, name):
        """Open a shipped system."""
        await self.send("open", source="catalog", name=name)
        return (await self.receive("SYSTEM"))[1]

    async def move(self, design, gains=None, view=0, window=None, **more):
        await self.send(
            "set",
            design=design,
            view=view,
            gains=gains or {},
            window=window,
            **{"pixels": 400, **more},
        )


@asynccontextmanager
async def page(server, **headers):
    """A connected page that has had its greeting."""
    options = {"origin": server.origin, "max_size": None} | headers
    async with websockets.connect(server.socket, **options) as connection:
        client = Page(connection)
        await client.receive("NOTE", where=lambda header: "hello" in header)
        yield client

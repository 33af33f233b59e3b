"""The server: static files from a fixed table, and one connection for each page."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Coroutine
from importlib.resources import files
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from certrack.app.frames import PROTOCOL_NUMBER, FrameKind, pack_frame
from certrack.app.hub import Hub
from certrack.app.messages import (
    MAX_MESSAGE,
    MAX_TEXT_BYTES,
    CancelTask,
    Export,
    FormEdit,
    GainMove,
    Hello,
    ListFiles,
    Message,
    NewText,
    Open,
    Save,
    StartTask,
    parse_message,
)
from certrack.app.security import WRONG_KEY, Access
from certrack.app.session import Session
from certrack.app.workspace import FileChanged, Workspace
from certrack.core.errors import CertrackError, InputError
from certrack.core.version import version
from certrack.systems.shipped import catalog

#: Pages at the same time.
MAX_PAGES = 64

#: Messages of a page in a second that ask for more than a run; further ones are dropped.
MAX_REQUESTS = 30

TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".woff2": "font/woff2",
    ".svg": "image/svg+xml",
}

#: The page, and the one that those see who come without the key.
PAGE_FILE, REFUSAL_FILE = "index.html", "refused.html"


class AppServer:
    """The designer's server.

    Parameters
    ----------
    access : Access
    workspace : Workspace
    first : str
        What pages open first: ``"catalog NAME"``, ``"file NAME"``, or empty.
    hub : Hub
    """

    def __init__(self, access: Access, workspace: Workspace, first: str, hub: Hub) -> None:
        self.access, self.workspace, self.first, self.hub = access, workspace, first, hub
        self.static = static_files()
        self.headers = access.headers()
        self._listing: asyncio.Task[list[str]] | None = None

    def application(self) -> Starlette:
        """The ASGI application."""
        routes = [
            WebSocketRoute("/ws", self.connection),
            Route("/", self.page),
            Route("/{name:path}", self.file),
        ]
        application = Starlette(routes=routes, lifespan=self._lifespan)
        application.add_middleware(GZipMiddleware, minimum_size=4096)
        return application

    @contextlib.asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        await self.hub.start()
        try:
            yield
        finally:
            await self.hub.stop()

    async def page(self, request: Request) -> Response:
        """The page, for those who have the key."""
        if not self.access.host_is_ours(request.headers.get("host")):
            return PlainTextResponse("wrong host", 403, self.headers)
        if self.access.key_is_right(request.query_params.get("t")):
            return Response(self.static[PAGE_FILE], headers=self.headers, media_type=TYPES[".html"])
        return Response(self.static[REFUSAL_FILE], 403, self.headers, TYPES[".html"])

    async def file(self, request: Request) -> Response:
        """A file of the fixed table; nothing in it is secret."""
        if not self.access.host_is_ours(request.headers.get("host")):
            return PlainTextResponse("wrong host", 403, self.headers)
        name = request.path_params["name"]
        if name not in self.static or name == PAGE_FILE:
            return PlainTextResponse("not found", 404, self.headers)
        kind = TYPES.get(Path(name).suffix, "text/plain")
        return Response(self.static[name], headers=self.headers, media_type=kind)

    async def connection(self, socket: WebSocket) -> None:
        """One page."""
        headers = socket.headers
        if not (
            self.access.host_is_ours(headers.get("host"))
            and self.access.origin_is_ours(headers.get("origin"))
            and self.access.key_is_right(socket.query_params.get("t"))
        ):
            await socket.close(4403, WRONG_KEY)
            return
        if len(self.hub.sessions) >= MAX_PAGES:
            await socket.close(4429, f"More than {MAX_PAGES} pages are open.")
            return
        await socket.accept()
        session = Session(str(self.workspace.folder))
        self.hub.join(session)
        writer = asyncio.create_task(_write(socket, session))
        disk = _OneAfterAnother(session)
        try:
            disk.begin("files", self._greet(session))
            await self._listen(socket, session, disk)
        except WebSocketDisconnect:
            pass
        finally:
            writer.cancel()
            disk.stop()
            self.hub.leave(session)

    async def _greet(self, session: Session) -> None:
        """Tell a page what there is to open; the folder is looked through beside all else."""
        if self._listing is None or self._listing.done():  # pages that ask at once share it
            self._listing = asyncio.create_task(asyncio.to_thread(self.workspace.files))
        header = {
            "hello": {"protocol": PROTOCOL_NUMBER, "certrack": version()},
            "catalog": catalog(),
            "files": await asyncio.shield(self._listing),
            "folder": str(self.workspace.folder),
            "first": self.first,
            "most": MAX_TEXT_BYTES,
        }
        session.send(pack_frame(FrameKind.NOTE, header))

    async def _open(self, session: Session, message: Open) -> None:
        """Read a file and let it be described, unless another text has come meanwhile."""
        file = await asyncio.to_thread(self.workspace.read, message.name)
        if session.asked == message.revision:
            session.opened(message, file)
            self.hub.pump()

    async def _save(self, session: Session, message: Save, revision: int) -> None:
        """Write a file, or say that it is not the one that the page knows."""
        name, text, known = message.name, message.text, message.known
        try:
            name, digest = await asyncio.to_thread(self.workspace.write, name, text, known=known)
            session.saved(name, revision)
            header: dict[str, Any] = {"saved": name, "digest": digest}
        except FileChanged as change:
            conflict = {"name": change.key, "reason": change.expected, "digest": change.digest}
            header = {"conflict": conflict}
        session.send(pack_frame(FrameKind.NOTE, header))

    async def _listen(self, socket: WebSocket, session: Session, disk: _OneAfterAnother) -> None:
        second, count = 0, 0
        while True:
            try:
                text = await socket.receive_text()
            except KeyError:  # a message of bytes
                await socket.close(1003)
                return
            if len(text) > MAX_MESSAGE:
                await socket.close(1009)
                return
            try:
                message = parse_message(text)
                if not isinstance(message, GainMove):
                    now = int(time.monotonic())
                    second, count = now, 1 if now != second else count + 1
                    if count > MAX_REQUESTS:
                        raise InputError("message", "too many requests in a second")
                if isinstance(message, Hello) and message.protocol != PROTOCOL_NUMBER:
                    session.note("Reload the page: certrack was updated.")
                await self._handle(session, message, disk)
            except CertrackError as problem:
                session.send(_refusal(text, problem))

    async def _handle(self, session: Session, message: Message, disk: _OneAfterAnother) -> None:
        match message:
            case GainMove():
                session.moved(message)
            case Open(source="file"):
                session.asks(message.revision)
                disk.begin("open", self._open(session, message), message.revision)
            case Open() | NewText() | FormEdit():
                session.opened(message)
            case StartTask() | Export():
                job = session.long_job(message)
                reason = "The text has changed, or nothing is open: try again."
                if job is not None:
                    reason = await self.hub.start_task(session, job)
                if reason:
                    raise InputError("task", reason)
            case CancelTask():
                self.hub.cancel_task(session)
            case ListFiles():
                disk.begin("files", self._greet(session))
            case Save():
                disk.begin("save", self._save(session, message, session.asked))
        self.hub.pump()


class _OneAfterAnother:
    """What a page wants of the disk, in the order of its messages and beside its moves."""

    def __init__(self, session: Session) -> None:
        self._session, self._turn = session, asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, kind: str, work: Coroutine[Any, Any, None], revision: int = 0) -> None:
        """Do something when its turn has come; what is wrong is told to the page."""
        task = asyncio.create_task(self._in_turn(kind, work, revision))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _in_turn(self, kind: str, work: Coroutine[Any, Any, None], revision: int) -> None:
        async with self._turn:
            try:
                await work
            except CertrackError as problem:
                header: dict[str, Any] = {"message": str(problem)}
            except OSError as problem:
                header = {"message": f"The disk refused it: {problem.strerror or problem}."}
            except Exception as problem:  # a defect must not leave the page without an answer
                header = {"message": f"{type(problem).__name__}: {problem}", "defect": True}
            else:
                return
            header["of"] = kind
            self._session.send(pack_frame(FrameKind.PROBLEM, header, revision=revision))

    def stop(self) -> None:
        """The page is gone: what has not begun is not done."""
        for task in self._tasks:
            task.cancel()


async def _write(socket: WebSocket, session: Session) -> None:
    """Send what is queued for a page, in order."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        while True:
            await socket.send_bytes(await session.outgoing.get())


def _refusal(text: str, problem: CertrackError) -> bytes:
    """What is wrong with a message, with the kind and the counters that it has."""
    try:
        values = json.loads(text)
        kind = value if isinstance(value := values.get("type"), str) else None
    except (ValueError, AttributeError, RecursionError):
        kind, values = None, {}
    counters: dict[str, Any] = {
        name: value if isinstance(value := values.get(name), int) and value >= 0 else 0
        for name in ("design", "view", "revision")
    }
    return pack_frame(FrameKind.PROBLEM, {"message": str(problem), "of": kind}, **counters)


def static_files() -> dict[str, bytes]:
    """Every file of the page by its name; no other name is ever read."""
    folder = files("certrack.app") / "static"
    contents: dict[str, bytes] = {}
    for entry in folder.iterdir():
        if entry.is_dir():
            for inner in entry.iterdir():
                contents[f"{entry.name}/{inner.name}"] = inner.read_bytes()
        else:
            contents[entry.name] = entry.read_bytes()
    return contents

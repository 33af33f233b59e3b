"""From a command to a running server: a free port, one address, the browser."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from certrack.app.workspace import Workspace
from certrack.core.errors import InputError, MissingExtra
from certrack.systems.shipped import shipped_names, shipped_text

#: A key to be used in the place of a new one, so that a page finds a server that was started anew.
KEY_VARIABLE = "CERTRACK_APP_KEY"

#: Seconds that pages have to say good-bye.
GOODBYE = 1

#: Cores to a worker for runs.
CORES_PER_LIVE_WORKER = 2


def first_design(file: str | None, folder: Path) -> str:
    """What the page opens first.

    Raises
    ------
    InputError
        If it is neither a file of the folder nor a shipped system.
    """
    if file is None:
        return ""
    path = Path(file)
    if path.suffix == "" and not path.exists():
        if file not in shipped_names():
            remedy = "Shipped: " + ", ".join(shipped_names())
            raise InputError(file, "is neither a file nor a shipped system", remedy=remedy)
        return f"catalog {file}"
    if not path.is_file():
        raise InputError(file, "is not a file")
    return f"file {path.resolve().relative_to(folder.resolve()).as_posix()}"


def folder_of(file: str | None) -> Path:
    """The folder whose files the page may read and write: the file's, else the present one."""
    return Path(file).resolve().parent if file is not None and Path(file).is_file() else Path.cwd()


def serve_designer(
    file: str | None,
    *,
    host: str,
    port: int,
    browser: bool,
    say: Callable[[str], None],
) -> None:
    """Serve until interrupted.

    Parameters
    ----------
    file : str or None
        A system file, or the name of a shipped system.
    host : str
    port : int
        0 for a free one.
    browser : bool
        Whether to open the page.
    say : callable
        Gets the address.

    Raises
    ------
    MissingExtra
        If the server's packages are not installed.
    InputError
        If the file or the port cannot be used.
    """
    try:
        import uvicorn
        import websockets as websockets
        from starlette import applications as applications
    except ImportError:
        raise MissingExtra("starlette, uvicorn or websockets", "app", "the designer") from None
    from certrack.app.connections import BoundedProtocol
    from certrack.app.hub import Hub
    from certrack.app.security import LOOPBACK, Access
    from certrack.app.server import AppServer

    folder = folder_of(file)
    first = first_design(file, folder)
    with _listening(host, port) as listener:
        port = listener.getsockname()[1]
        hosts = LOOPBACK if host in LOOPBACK else (*LOOPBACK, host)
        access = Access(port, os.environ.get(KEY_VARIABLE), hosts)
        live = max(1, (os.cpu_count() or 1) // CORES_PER_LIVE_WORKER)
        workspace = Workspace(folder)
        hub = Hub(live, _opened_first(first, workspace))
        server = AppServer(access, workspace, first, hub)
        address = f"http://{'127.0.0.1' if host in LOOPBACK else host}:{port}/?t={access.key}"
        say(address)
        if browser:
            threading.Timer(0.3, webbrowser.open, [address]).start()
        config = uvicorn.Config(
            server.application(),
            loop="asyncio",
            http=BoundedProtocol,
            ws="websockets-sansio",
            ws_max_size=_message_limit(),
            ws_per_message_deflate=False,
            log_level="warning",
            access_log=False,
            timeout_graceful_shutdown=GOODBYE,
            server_header=False,
        )
        with contextlib.suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[listener])


def _opened_first(first: str, workspace: Workspace) -> dict[str, Any] | None:
    """The text that the first page opens, for workers to compile."""
    source, _, name = first.partition(" ")
    if not source:
        return None
    text = shipped_text(name) if source == "catalog" else workspace.read(name).text
    file = f"{name}.toml" if source == "catalog" else name
    return {"text": text, "name": file, "folder": str(workspace.folder)}


def _message_limit() -> int:
    from certrack.app.messages import MAX_MESSAGE

    return MAX_MESSAGE


@contextlib.contextmanager
def _listening(host: str, port: int) -> Iterator[socket.socket]:
    """A socket that listens, on this machine unless told otherwise."""
    # Without the protocol asyncio would leave Nagle's algorithm on: a frame that follows another
    # would wait for the page to acknowledge that one, up to 40 ms.
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    if sys.platform != "win32":
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except (OSError, OverflowError) as problem:
        listener.close()
        raise InputError("--port", f"{host}:{port} cannot be used ({problem})") from None
    with listener:
        yield listener

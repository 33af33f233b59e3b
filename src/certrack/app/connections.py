"""Connections that hold nobody up: a deadline for requests, and room for new ones.

Whoever opens a connection and sends nothing, or a header a byte at a time, holds a place. Such a
connection is closed after a while, and at once where the places are needed: the one that has waited
longest goes first. Those of pages, and those whose answer is on its way, stay.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

#: Open connections, of all kinds.
MAX_CONNECTIONS = 256

#: Seconds in which a request must have come whole, from the connection or from the answer before.
REQUEST_DEADLINE = 10.0


class BoundedProtocol(H11Protocol):
    """HTTP for one connection."""

    _timer: asyncio.TimerHandle | None = None
    _since = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._await_request()
        if len(self.connections) > MAX_CONNECTIONS:
            waiting = [c for c in self.connections if isinstance(c, BoundedProtocol) and c.waits]
            min(waiting, key=lambda c: c._since, default=self).close()

    @property
    def waits(self) -> bool:
        """Whether no request has come, or the last one is answered."""
        return self._timer is not None

    def close(self) -> None:
        """End the connection at once; the server counts it no more."""
        self._stop_waiting()
        self.connections.discard(self)
        self.transport.abort()

    def handle_events(self) -> None:
        """Read what has come; a request that is whole is waited for no more."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_waiting()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection to a page."""
        self._stop_waiting()
        super().handle_websocket_upgrade(event)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self._await_request()
        super().on_response_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """The other side is gone."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _await_request(self) -> None:
        self._stop_waiting()
        self._since = self.loop.time()
        self._timer = self.loop.call_later(REQUEST_DEADLINE, self.close)

    def _stop_waiting(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

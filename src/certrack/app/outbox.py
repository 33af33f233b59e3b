"""Frames that wait for a page: one that does not read loses curves, never a result."""

from __future__ import annotations

import asyncio
from collections import deque

from certrack.app.frames import FrameKind, frame_prefix

#: Frames that wait for a page that does not read.
QUEUE = 64

#: Kinds that a newer frame makes worthless.
PASSING = (FrameKind.RUN, FrameKind.BOUND)


class Outbox:
    """A queue of frames with room for :data:`QUEUE` of them.

    Where it is full, the oldest curves go, so that the newest answer always arrives; where there
    are none, the oldest frame.
    """

    def __init__(self) -> None:
        self._frames: deque[bytes] = deque()
        self._filled = asyncio.Event()

    def add(self, frame: bytes) -> None:
        """Queue a frame."""
        if len(self._frames) >= QUEUE:
            passing = (k for k, f in enumerate(self._frames) if frame_prefix(f).kind in PASSING)
            del self._frames[next(passing, 0)]
        self._frames.append(frame)
        self._filled.set()

    async def get(self) -> bytes:
        """The oldest frame, as soon as there is one."""
        while not self._frames:
            self._filled.clear()
            await self._filled.wait()
        return self._frames.popleft()

    def take(self) -> bytes:
        """The oldest frame; IndexError if none waits."""
        return self._frames.popleft()

    def __len__(self) -> int:
        return len(self._frames)

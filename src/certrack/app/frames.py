"""What a page gets: binary frames with a JSON header and curves as Float32.

Little-endian: the magic word, u16 kind, u16 view, u32 design, u32 n, u32 revision; n bytes of
JSON, padded by blanks to a multiple of 4; the arrays, whose lengths are ``lengths`` of the header;
and bytes of a file, ``bytes`` of the header says how many. A page reads arrays without a copy.

Three counters of the page say what a frame is the answer to: ``revision`` rises with every text
that the page sends, ``design`` with every change of gains or text, ``view`` with every
window of time. Gains are those of a text, so that they are carried out for it or not at all.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np

#: Another number on either side means that the page must be loaded again.
PROTOCOL_NUMBER = 2

MAGIC = b"CTR1"

#: Magic word, kind, view, design, length of the header, revision; and where the last stands.
_PREFIX, _REVISION = struct.Struct("<4sHHIII"), struct.Struct("<I")
_REVISION_AT = _PREFIX.size - _REVISION.size

#: The counters as they fit into a frame.
MAX_VIEW, MAX_DESIGN = 2**16 - 1, 2**32 - 1
MAX_REVISION = MAX_DESIGN


class FrameKind(IntEnum):
    """What a frame tells."""

    RUN = 1
    BOUND = 2
    EXACT = 3
    TASK = 4
    PROBLEM = 5
    SYSTEM = 6
    TEXT = 7
    FILE = 8
    NOTE = 9
    LAW = 10


class FramePrefix(NamedTuple):
    """The first bytes of a frame."""

    kind: FrameKind
    view: int
    design: int
    header_bytes: int
    revision: int


def pack_frame(
    kind: FrameKind,
    header: Mapping[str, Any],
    arrays: Sequence[np.ndarray] = (),
    *,
    design: int = 0,
    view: int = 0,
    revision: int = 0,
    data: bytes = b"",
) -> bytes:
    """One frame.

    Parameters
    ----------
    kind : FrameKind
    header : mapping
        Ready for JSON, but for numbers that are not finite: they become null.
    arrays : sequence of (N,) arrays
    design, view, revision : int
        Counters of the page, whose answer this is.
    data : bytes
        Of a file.
    """
    lengths: dict[str, Any] = {"lengths": [len(a) for a in arrays]} if arrays else {}
    lengths |= {"bytes": len(data)} if data else {}
    text = _json({**header, **lengths}).encode()
    text += b" " * (-len(text) % 4)
    counters = view & MAX_VIEW, design & MAX_DESIGN
    prefix = _PREFIX.pack(MAGIC, kind, *counters, len(text), revision & MAX_REVISION)
    return b"".join([prefix, text, *(a.astype("<f4").tobytes() for a in arrays), data])


def frame_prefix(data: bytes) -> FramePrefix:
    """Kind and counters of a frame."""
    _, kind, view, design, length, revision = _PREFIX.unpack_from(data)
    return FramePrefix(FrameKind(kind), view, design, length, revision)


def of_revision(data: bytes, revision: int) -> bytes:
    """The same frame as the answer to a text."""
    mark = _REVISION.pack(revision & MAX_REVISION)
    return data[:_REVISION_AT] + mark + data[_PREFIX.size :]


def frame_header(data: bytes) -> dict[str, Any]:
    """The JSON header of a frame."""
    header: dict[str, Any] = json.loads(data[_PREFIX.size : _PREFIX.size + _header_size(data)])
    return header


def frame_arrays(data: bytes) -> list[np.ndarray]:
    """The arrays of a frame."""
    import numpy as np

    at, arrays = _PREFIX.size + _header_size(data), []
    for length in frame_header(data).get("lengths", ()):
        arrays.append(np.frombuffer(data, "<f4", length, at))
        at += 4 * length
    return arrays


def _header_size(data: bytes) -> int:
    return frame_prefix(data).header_bytes


def _json(header: Mapping[str, Any]) -> str:
    """The text of a header; one that is ready is not walked through before."""

    def ready(value: Any) -> Any:
        if (converted := json_ready(value)) is value:
            raise TypeError(f"no part of a header: {type(value).__name__}")
        return converted

    def text(value: Any) -> str:
        return json.dumps(value, separators=(",", ":"), allow_nan=False, default=ready)

    try:
        return text(header)
    except ValueError:  # a number that is not finite
        return text(json_ready(header))


def json_ready(value: Any) -> Any:
    """The value with tuples and arrays as lists, and None for numbers that JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return json_ready(value.tolist())
    if isinstance(value, Mapping):
        return {str(name): json_ready(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_ready(entry) for entry in value]
    return value

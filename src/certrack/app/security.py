"""Who may speak with the server: the page that it serves itself, by the key of this session.

Any page of the web can send requests to 127.0.0.1, also under a name that it has pointed there. So
the host must be one of ours, a connection must come from our own page, and whoever opens either
must know a key that stands only in the address that ``certrack app`` prints.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable

#: Names under which the server answers where it listens on this machine only.
LOOPBACK = ("127.0.0.1", "localhost")

#: Bytes of a key.
KEY_BYTES = 16

WRONG_KEY = "Open the address that certrack app printed: it carries the key of this session."


class Access:
    """The key, and the hosts and origins that are ours.

    Parameters
    ----------
    port : int
    key : str, optional
        A new one if left out.
    hosts : names
    """

    def __init__(self, port: int, key: str | None = None, hosts: Iterable[str] = LOOPBACK) -> None:
        self.port = port
        self.key = key or secrets.token_urlsafe(KEY_BYTES)
        self.hosts = frozenset(f"{host}:{port}" for host in hosts)
        self.origins = frozenset(f"http://{host}" for host in self.hosts)

    def host_is_ours(self, host: str | None) -> bool:
        """Whether a request was sent to us under our own name."""
        return host in self.hosts

    def origin_is_ours(self, origin: str | None) -> bool:
        """Whether a connection comes from our page; one without an origin does not."""
        return origin in self.origins

    def key_is_right(self, key: str | None) -> bool:
        """Whether a key is ours, compared in constant time."""
        return secrets.compare_digest((key or "").encode(), self.key.encode())

    def headers(self) -> dict[str, str]:
        """Headers of every answer: nothing from elsewhere, nothing inline, in no frame."""
        sockets = " ".join(sorted(f"ws://{host}" for host in self.hosts))
        policy = {
            "default-src": "'none'",
            "script-src": "'self'",
            "style-src": "'self'",
            "font-src": "'self'",
            "img-src": "'self' data: blob:",
            "connect-src": f"'self' {sockets}",
            "base-uri": "'none'",
            "form-action": "'none'",
            "frame-ancestors": "'none'",
        }
        return {
            "Content-Security-Policy": "; ".join(f"{k} {v}" for k, v in policy.items()),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }

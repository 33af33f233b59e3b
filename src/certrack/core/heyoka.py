"""Whether heyoka can be used, and how it keeps off standard output."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any


def has_heyoka() -> bool:
    """Whether heyoka is installed (it has no wheels for macOS and Windows)."""
    return find_spec("heyoka") is not None


def quiet_heyoka() -> Any:
    """The module ``heyoka``, imported, with its logger silent but for what is critical."""
    import heyoka

    heyoka.set_logger_level_critical()  # it warns on standard output, where JSON goes
    return heyoka

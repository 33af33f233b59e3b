"""What the kits share."""

from __future__ import annotations

from typing import NoReturn
from unittest import SkipTest

from certrack.core.heyoka import has_heyoka

#: What is tried at random, and how far numbers may differ.
TRIED_POINTS, TRIED_MEMBERS, SHORT_RUN = 5, 4, 1.0

#: Period of the sampled runs where the system has none, s.
PERIOD_TESTED = 1e-3


def skip(reason: str) -> NoReturn:
    """End a test that cannot be done here; pytest and unittest show it as skipped."""
    raise SkipTest(reason)


def require_heyoka() -> None:
    """Skip a test that needs Taylor's method."""
    if not has_heyoka():
        skip("needs heyoka")

"""Remember the results of pure functions, whether or not their arguments have a hash."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")

#: Results that a process remembers of each function: of the last systems that it worked on.
MAX_REMEMBERED = 16


def remembered(function: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Remember the last results of a function, for arguments that are equal.

    A reference or a law of the user's may have no hash: then the function is called every time.
    """
    memo: Any = lru_cache(MAX_REMEMBERED)(function)

    @wraps(function)
    def recall(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        try:
            hash((*args, *kwargs.values()))
        except TypeError:
            return function(*args, **kwargs)
        return memo(*args, **kwargs)

    return recall

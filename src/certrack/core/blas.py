"""One thread for the linear algebra: matrices are small here, and threads that wait cost most.

With its default of one thread per core the BLAS under NumPy and SciPy spends several times the
processor time, and most of the wall time where other programs run. What runs in parallel here are
members of an ensemble, in threads or processes of their own.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import cache, wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

_LimitedArguments = ParamSpec("_LimitedArguments")
_LimitedResult = TypeVar("_LimitedResult")

#: What tells a BLAS that is loaded later how many threads to use.
THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def one_thread_from_now_on() -> None:
    """Ask a BLAS that this process has not yet loaded for one thread, unless the user asks else."""
    if not any(name in os.environ for name in THREAD_VARIABLES):
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))


def one_blas_thread(
    function: Callable[_LimitedArguments, _LimitedResult],
) -> Callable[_LimitedArguments, _LimitedResult]:
    """The function, which lets the BLAS use one thread while it runs."""

    @wraps(function)
    def limited(
        *arguments: _LimitedArguments.args, **named: _LimitedArguments.kwargs
    ) -> _LimitedResult:
        with _LIMIT:
            return function(*arguments, **named)

    return limited


class _ThreadLimit:
    """One thread from where the first caller enters until the last one leaves.

    The number is the process's. Callers that overlap would each take the other's for what was
    there before, and leave it behind.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._before = Lock(), 0, list[int]()

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._before = [library.num_threads for library in _libraries()]
                _set_threads([1] * len(self._before))
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                _set_threads(self._before)


_LIMIT = _ThreadLimit()


@cache
def _libraries() -> tuple[Any, ...]:
    """The BLAS of NumPy and that of SciPy: to look for them takes two milliseconds."""
    import scipy.linalg  # noqa: F401 - loads its own
    from threadpoolctl import ThreadpoolController

    return tuple(ThreadpoolController().select(user_api="blas").lib_controllers)


def _set_threads(counts: Sequence[int]) -> None:
    for library, count in zip(_libraries(), counts, strict=True):
        # threadpoolctl heeds one thread at a time, and the last to leave may be another one
        release = getattr(library, "clear_controlling_thread", lambda **_: None)
        release(force=True)
        library.set_num_threads(count)
        release(force=True)

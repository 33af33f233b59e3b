"""One thread for the linear algebra: matrices are small here, and threads that wait cost most.

With its default of one thread per core the BLAS under NumPy and SciPy spends several times the
processor time, and most of the wall time where other programs run. What runs in parallel here are
members of an ensemble, in threads or processes of their own.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

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
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*arguments, **named)

    return limited

"""A budget of processor time and memory for work on a stranger's file.

Sizes are checked wherever a file is read, so that nothing grows without bound. This is the last
line of defence, for what nobody thought of. A second thread watches the one that works and, when
its budget is spent, raises an exception in it. That works on every system, needs no right and
touches no limit of the process; but a single operation inside a C library is not interrupted, only
what follows it.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from certrack.core.errors import InputError

#: Multiplies every budget; 0 lifts them. For slow machines, and for huge files of one's own.
FACTOR_VARIABLE = "CERTRACK_BUDGET"

#: How often the watching thread looks, s, and how long it waits before it raises once more: a
#: library may have caught the first exception.
POLL_INTERVAL, RAISE_INTERVAL = 0.05, 1.0

#: Instructions at which a pending exception would have come.
LOOKED_FOR = 100

Result = TypeVar("Result")


class _BudgetExceeded(BaseException):
    """Raised in the watched thread. No handler of ordinary errors catches it."""


def within_budget(
    work: Callable[[], Result], *, what: str, seconds: float, megabytes: float
) -> Result:
    """Do some work, or refuse when it takes more than it may.

    Parameters
    ----------
    work : callable
        Done in this thread.
    what : str
        Is refused; begins the message.
    seconds : float
        Processor time of this thread.
    megabytes : float
        By which the memory of the process may grow.

    Returns
    -------
    object
        What the work returns.

    Raises
    ------
    InputError
        If the budget is spent, or the machine has no more memory.
    """
    factor = _factor()
    if factor == 0:
        return work()
    watch = _Watch(factor * seconds, factor * megabytes)
    try:
        watch.start()
        try:
            result = work()
        finally:
            watch.stop()
    except _BudgetExceeded:
        _stop_surely(watch)
    except MemoryError:
        raise InputError(what, "needs more memory than this machine gives") from None
    if watch.exceeded:
        raise InputError(
            what,
            f"is given up: it needs more than {watch.exceeded}",
            remedy=f"Make it simpler or set the environment variable {FACTOR_VARIABLE} to a factor",
        )
    return result


def _factor() -> float:
    text = os.environ.get(FACTOR_VARIABLE, "1")
    try:
        factor = float(text)
    except ValueError:
        factor = -1.0
    if not 0 <= factor < float("inf"):
        raise InputError(FACTOR_VARIABLE, "must be a factor, or 0 for no limit", text)
    return factor


class _Watch:
    """A second thread that looks at what the present one has used."""

    def __init__(self, seconds: float, megabytes: float) -> None:
        self.exceeded = ""  # of what; empty while within the budget
        self._raised = False
        self._seconds, self._megabytes = seconds, megabytes
        self._owner = threading.get_ident()
        self._clock = _clock_of(self._owner)
        self._begin, self._memory = self._clock(), resident_megabytes()
        self._lock, self._done = threading.RLock(), threading.Event()
        self._thread = threading.Thread(target=self._poll, name="certrack budget", daemon=True)

    def start(self) -> None:
        """Begin to look, where there can be another thread at all."""
        try:
            self._thread.start()
        except RuntimeError:  # no more threads: without a budget rather than not at all
            self._done.set()

    def stop(self) -> None:
        """Look no more; no exception comes after this has returned."""
        with self._lock:
            self._done.set()
        if self._raised:
            _await_exception()
        if self._thread.is_alive():
            self._thread.join()  # a process with one thread may fork

    def _poll(self) -> None:
        raised = -RAISE_INTERVAL
        while not self._done.wait(POLL_INTERVAL):
            self.exceeded = self.exceeded or self._overspent()
            if self.exceeded and time.monotonic() - raised >= RAISE_INTERVAL:
                raised = time.monotonic()
                with self._lock:
                    if not self._done.is_set():
                        self._raised = True
                        _raise_in(self._owner, _BudgetExceeded)

    def _overspent(self) -> str:
        if self._clock() - self._begin > self._seconds:
            return f"{self._seconds:g} s of processor time"
        if resident_megabytes() - self._memory > self._megabytes:
            return f"{self._megabytes:g} MB of memory"
        return ""


def _stop_surely(watch: _Watch) -> None:
    """Stop, even if one more exception arrives meanwhile."""
    while True:
        try:
            watch.stop()
            return
        except _BudgetExceeded:
            continue


def _raise_in(thread: int, exception: type[BaseException]) -> None:
    """Raise an exception in a thread when its current operation ends.

    It is never taken back: in CPython 3.11 that leaves the interpreter waiting for one for ever, so
    that it is slow, and hangs under a profiler.
    """
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(exception))


def _await_exception() -> None:
    """Let an exception come that was raised in this thread and has not arrived."""
    try:
        for _ in range(LOOKED_FOR):
            time.sleep(0)
    except _BudgetExceeded:
        pass


def _clock_of(thread: int) -> Callable[[], float]:
    """Processor time of a thread, s; of the process where the system does not tell."""
    if not hasattr(time, "pthread_getcpuclockid"):
        return time.process_time
    clock = time.pthread_getcpuclockid(thread)
    return lambda: time.clock_gettime(clock)


def resident_megabytes() -> float:
    """Memory that the process has now (on macOS: had at most so far), MB; 0 if unknown."""
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, ValueError, IndexError, AttributeError):
        pass
    if sys.platform == "win32":
        return _windows_megabytes()
    try:
        import resource
    except ImportError:
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def _windows_megabytes() -> float:
    """Working set, from the counters of the process."""

    class Counters(ctypes.Structure):
        _fields_ = (
            ("size", ctypes.c_ulong),
            ("faults", ctypes.c_ulong),
            ("peak", ctypes.c_size_t),
            ("working_set", ctypes.c_size_t),
            ("others", ctypes.c_size_t * 6),
        )

    counters = Counters(size=ctypes.sizeof(Counters))
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined]
    kernel.GetCurrentProcess.restype = ctypes.c_void_p
    process = ctypes.c_void_p(kernel.GetCurrentProcess())
    done = kernel.K32GetProcessMemoryInfo(process, ctypes.byref(counters), counters.size)
    return counters.working_set / 1e6 if done else 0.0

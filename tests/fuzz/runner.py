"""Run a fuzzer: many generated inputs, each held to what must never happen.

A fuzzer has a name, makes an input from a random number generator, and examines one: it returns a
word for what happened (it counts them), or raises :class:`Finding`. Where judging what the product
said takes time of its own, it returns the judge, whose time is not the product's. Whatever else is
raised is a finding too, and so is what takes too long. Inputs that are found are kept in a folder;
those worth keeping move to tests/data/corpus, which the tests replay.
"""

import ctypes
import hashlib
import random
import re
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from pace import too_long

try:
    import resource
except ImportError:  # Windows
    resource = None

#: No input may take longer, s (see :mod:`pace`), or more memory than the process has when it
#: begins, MB.
MAX_SECONDS, MAX_MEGABYTES = 2.0, 1000

#: An input is broken off after so many times the limit, on whatever machine and under a trace.
PATIENCE = 15


#: What happened to a system that was simulated, which may take any time.
UNTIMED = "loaded, simulated"

#: What happened to one that was certified: a search, held only to when an input is broken off.
SEARCHED = "loaded, certified"


class Finding(Exception):
    """Something that must never happen."""


class TooLong(BaseException):
    """Raised by the alarm; no handler of the product catches it."""


class Fuzzer(Protocol):
    """What a kind of input needs."""

    name: str
    suffix: str

    def make(self, rng: random.Random) -> bytes: ...

    def examine(self, data: bytes) -> str | Callable[[], str]: ...


@dataclass
class Report:
    """What happened, how often; the findings, one per kind; the slowest input."""

    counts: Counter = field(default_factory=Counter)
    findings: dict[str, bytes] = field(default_factory=dict)
    slowest: float = 0.0
    seconds: float = 0.0
    megabytes: float = 0.0

    def __str__(self) -> str:
        counts = ", ".join(f"{count} {word}" for word, count in sorted(self.counts.items()))
        return (
            f"{sum(self.counts.values())} inputs in {self.seconds:.0f} s: {counts}; slowest "
            f"{self.slowest:.2f} s of processor time, memory {self.megabytes:.0f} MB, "
            f"{len(self.findings)} kinds of findings"
        )


def run(fuzzer: Fuzzer, seed: int, count: int, keep: Path | None = None) -> Report:
    """Examine `count` inputs; those that are findings go to the folder `keep`."""
    report = Report()
    give_back()
    begin = time.monotonic()
    for i in range(count):
        data = fuzzer.make(random.Random(f"{fuzzer.name} {seed} {i}"))
        resting = forget_peak()
        word, spent = outcome(fuzzer, data)
        taken = peak_megabytes() - resting
        report.slowest = max(report.slowest, spent)
        report.megabytes = max(report.megabytes, taken)
        if taken > MAX_MEGABYTES:
            word = "FINDING: memory"
        report.counts[word.partition(":")[0]] += 1
        if word.startswith("FINDING") and word not in report.findings:
            report.findings[word] = data
            print(f"{fuzzer.name} {seed} {i}: {word}", file=sys.stderr, flush=True)
            if keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                digest = hashlib.sha256(data).hexdigest()[:10]
                (keep / f"{fuzzer.name}-{digest}{fuzzer.suffix}").write_bytes(data)
    report.seconds = time.monotonic() - begin
    return report


def outcome(fuzzer: Fuzzer, data: bytes) -> tuple[str, float]:
    """The word for what happened to one input, and the processor time that the product took, s."""
    begin, spent = time.process_time(), None
    try:
        with alarm(PATIENCE * MAX_SECONDS):
            word = fuzzer.examine(data)
            spent = time.process_time() - begin
            if not isinstance(word, str):
                word = word()
    except Finding as finding:
        word = f"FINDING: {finding}"
    except TooLong as problem:
        word = f"FINDING: hangs {place(problem)}"
    except Exception as problem:
        word = f"FINDING: {type(problem).__name__} {place(problem)}"
    if spent is None:
        spent = time.process_time() - begin
    if word == UNTIMED:
        return word, 0.0
    if word != SEARCHED and not word.startswith("FINDING") and too_long(spent, MAX_SECONDS):
        word = f"FINDING: slow, {word}"
    return word, spent


def place(problem: BaseException) -> str:
    """Where it came from: the innermost line of the product."""
    frames = traceback.extract_tb(problem.__traceback__)
    ours = [frame for frame in frames if "certrack" in Path(frame.filename).parts] or frames
    return f"in {Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else ""


class alarm:
    """Break off after some processor time, where the system can."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __enter__(self) -> None:
        if hasattr(signal, "setitimer"):
            self.before = signal.signal(signal.SIGVTALRM, self.ring)
            signal.setitimer(signal.ITIMER_VIRTUAL, self.seconds)

    def __exit__(self, *_: Any) -> None:
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            signal.signal(signal.SIGVTALRM, self.before)

    @staticmethod
    def ring(*_: Any) -> None:
        raise TooLong


STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def give_back() -> None:
    """Return to the system what was freed, where it can: it would be taken again uncounted."""
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def forget_peak() -> float:
    """Measure the most memory from now on, where the system can; what there is now, MB.

    The highest so far where the system cannot forget; 0 where it does not say.
    """
    with suppress(OSError):
        CLEAR.write_text("5")
    return peak_megabytes()


def peak_megabytes() -> float:
    """Most memory that this process had since the input began, MB.

    Since the process began where the system cannot forget; 0 where it does not say.
    """
    if CLEAR.exists() and (peak := re.search(r"VmHWM:\s+(\d+) kB", STATUS.read_text())):
        return int(peak[1]) / 1000
    if resource is None:
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)

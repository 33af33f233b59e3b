"""Which tests run which lines, and how long they take: measured once, kept in ``build/mutants``."""

from __future__ import annotations

import hashlib
import json
import math
import os
import signal
import sys
import time
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import FrameType

import pytest

from mutation.changes import Mutant
from mutation.groups import GROUPS, ROOT, SOURCE
from mutation.runs import collect, in_child

KEPT = ROOT / "build" / "mutants"

#: Seconds of the processor: no test that takes longer is used, nor are more of them for a mutant.
LONGEST, BUDGET = 3.0, 12.0

#: Tests of less are tried of all files, where something is changed that runs on import.
QUICK = 0.01

#: Seconds after which a test is stopped that could not be stopped yet.
LATER = 0.01

#: Functions of pytest in which what a test raises is the test's.
STOPPABLE = {"pytest_runtest_setup", "pytest_runtest_call"}


@dataclass(frozen=True)
class Trace:
    """Of each line of each module the tests that run it (None: the import), of each its seconds."""

    lines: dict[str, dict[int, list[str | None]]]
    seconds: dict[str, float]

    def tests(self, mutant: Mutant) -> tuple[list[str], bool]:
        """Tests that run a mutant, and whether they must import it anew.

        The fastest first, those of a file together so that they share what they set up. Other tests
        of the same files follow, for as long again: what one test sets up or remembers may be
        judged by another. One example of every test is taken before another of the same.
        """
        lines = self.lines.get(mutant.module, {})
        runners = {name for line in mutant.lines for name in lines.get(line, [])}
        anew = mutant.function is None or None in runners
        runners -= {None}
        users = {name for names in lines.values() for name in names} - {None}
        others = self._everyone
        if anew:  # whoever uses the module, and all others: what it says may be read anywhere
            runners = users
            others = others | {name for name, used in self.seconds.items() if used < QUICK}
        else:
            files = {_file(name) for name in runners}
            others = {name for name in others if _file(name) in files}

        def rank(name: str) -> tuple[bool | float | str, ...]:
            near = name not in runners, name not in users
            return (anew and self.seconds[name] > QUICK, *near, self.seconds[name], name)

        ranked = sorted(runners | others, key=rank)
        chosen = self._affordable([name for name in ranked if name in runners])
        chosen += self._affordable([name for name in ranked if name not in runners])
        return sorted(chosen, key=lambda name: (name not in runners, *self._order(name))), anew

    def _affordable(self, ranked: list[str]) -> list[str]:
        """As many as the budget allows: the quick ones, and of the others examples by turns."""
        seen: dict[str, int] = {}
        turns = []
        for name in ranked:
            test = name.partition("[")[0]
            seen[test] = seen.get(test, 0) + 1
            turns.append((seen[test] if self.seconds[name] > QUICK else 0, name))
        chosen, total = [], 0.0
        for _, name in sorted(turns, key=lambda turn: turn[0]):  # stable: else as they are ranked
            total += self.seconds[name]
            if total > BUDGET:
                break
            chosen.append(name)
        return chosen

    @cached_property
    def _everyone(self) -> set[str]:
        """All tests that run a line of the group and passed."""
        known = (names for lines in self.lines.values() for names in lines.values())
        return {name for names in known for name in names} - {None}

    def _order(self, name: str) -> tuple[int, str, float]:
        seconds = self.seconds[name]
        return math.ceil(math.log10(max(seconds, 0.03))), _file(name), seconds


def _file(name: str) -> str:
    return name.partition("::")[0]


def trace(files: Iterable[str], modules: Iterable[str]) -> Trace:
    """From ``build/mutants`` where neither the tests nor the modules changed, else by a run."""
    lines: dict[str, dict[int, list[str | None]]] = {module: {} for module in modules}
    seconds: dict[str, float] = {}
    digests = {module: _digest(SOURCE / module) for module in lines}
    for file in files:
        kept = KEPT / (Path(file).stem + ".json")
        digest = _digest(ROOT / file)
        found = json.loads(kept.read_text()) if kept.exists() else {}
        same = digests.items() <= found.get("modules", {}).items()
        if not same or found["digest"] != digest:
            print(f"  which lines {file} runs ...", end=" ", flush=True)
            code, _ = in_child(lambda _, file=file, kept=kept: _measure(file, kept), 3600)
            if code:
                sys.exit(f"{file} cannot be traced")
            found = json.loads(kept.read_text())
            print(f"{len(found['seconds'])} tests, {sum(found['seconds'].values()):.0f} s")
        names = list(found["seconds"])
        seconds |= found["seconds"]
        for module, ran in found["lines"].items():
            for line, numbers in ran.items() if module in lines else ():
                runners = lines[module].setdefault(int(line), [])
                runners += [None if i < 0 else names[i] for i in numbers]
    return Trace(lines, seconds)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _measure(file: str, kept: Path) -> None:
    """Run a file of tests with coverage; a test that fails so, or takes too long, is left out."""
    import coverage  # here, so that the other children do without

    modules = sorted({module for group in GROUPS.values() for module in group.modules})
    paths = [str(SOURCE / module) for module in modules]
    measured = coverage.Coverage(data_file=None, config_file=False, include=paths)
    seconds: dict[str, float] = {}
    failed = set()

    class TooLong(BaseException):
        pass

    def stop(signum: int, frame: FrameType | None) -> None:
        """Later where coverage may hold its lock, and where pytest would not take it for a test."""
        names = {outer.f_code.co_name for outer, _ in traceback.walk_stack(frame)}
        if frame and ("/coverage/" in frame.f_code.co_filename or names.isdisjoint(STOPPABLE)):
            signal.setitimer(signal.ITIMER_VIRTUAL, LATER)
        else:
            raise TooLong

    class Failures:
        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                failed.add(report.nodeid)

    def action(items: list[pytest.Item]) -> None:
        items[0].config.pluginmanager.register(Failures())
        for item, following in zip(items, [*items[1:], None], strict=True):
            measured.switch_context(item.nodeid)
            began = time.process_time()
            signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            seconds[item.nodeid] = time.process_time() - began

    signal.signal(signal.SIGVTALRM, stop)
    measured.start()
    log = os.open(os.devnull, os.O_WRONLY)
    os.dup2(log, 1)
    collect([file], action)
    measured.stop()
    data = measured.get_data()
    numbers = {name: i for i, name in enumerate(seconds)} | {"": -1}
    lines = {}
    for path in sorted(data.measured_files()):
        module = str(Path(path).relative_to(SOURCE))
        lines[module] = {
            line: sorted(numbers[name] for name in names if name not in failed)
            for line, names in data.contexts_by_lineno(path).items()
        }
    digests = {module: _digest(SOURCE / module) for module in modules}
    KEPT.mkdir(parents=True, exist_ok=True)
    text = {"digest": _digest(ROOT / file), "modules": digests, "seconds": seconds, "lines": lines}
    kept.write_text(json.dumps(text))

"""Runs of tests in forks of one interpreter: with coverage per test, and with a change in place."""

from __future__ import annotations

import gc
import importlib.abc
import importlib.util
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from types import CodeType, FunctionType

import pytest

from mutation.changes import Mutant
from mutation.groups import ROOT

OPTIONS = ("-o", "addopts=", "-p", "no:terminal", "-p", "no:cacheprovider", "-m", "not slow")

#: A child gets this many times the processor's seconds its tests took, and some; 8 GB at most.
SLOWER, EXTRA_SECONDS, BYTES = 2, 10, 8 << 30
#: A child that waits for something that never comes is stopped after so many seconds more.
WAITING = 120


def in_child(action: Callable[[int], None], seconds: float) -> tuple[int, str]:
    """The exit code of a fork that does `action`, and what it wrote to the pipe it was given."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setpgrp()
            limit = int(SLOWER * seconds) + EXTRA_SECONDS
            resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
            resource.setrlimit(resource.RLIMIT_DATA, (BYTES, BYTES))
            action(writing)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(writing)
    until = time.monotonic() + 10 * SLOWER * seconds + WAITING
    done = status = 0
    while not done:
        done, status = os.waitpid(child, os.WNOHANG)
        if not done and time.monotonic() > until:
            os.killpg(child, signal.SIGKILL)
            done, status = os.waitpid(child, 0)
        time.sleep(0.01)
    with os.fdopen(reading) as pipe:
        return os.waitstatus_to_exitcode(status), pipe.read()


class Loop:
    """A plugin of pytest that does something of its own with the tests that were collected."""

    def __init__(self, action: Callable[[list[pytest.Item]], None]) -> None:
        self.action = action

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Instead of a run of everything."""
        if session.testsfailed:
            raise session.Interrupted("the tests cannot be collected")
        self.action(session.items)
        return True


class FirstFailure:
    """A plugin of pytest that ends the process with the first test that fails, and names it."""

    def __init__(self, pipe: int) -> None:
        self.pipe = pipe

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """After each phase of each test."""
        if report.failed:
            os.write(self.pipe, report.nodeid.encode())
            os._exit(1)


def collect(files: Sequence[str], action: Callable[[list[pytest.Item]], None]) -> None:
    """Collect tests, and do something with them."""
    code = pytest.main([*OPTIONS, *files], plugins=[Loop(action)])
    if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        sys.exit(f"pytest ends with {code}")


def run(items: list[pytest.Item], wanted: Sequence[str]) -> None:
    """Run the wanted tests, in that order."""
    by_name = {item.nodeid: item for item in items}
    chosen = [by_name[name] for name in wanted]
    for item, following in zip(chosen, [*chosen[1:], None], strict=True):
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)


def changed_in_place(mutant: Mutant) -> None:
    """Give the functions of this process the code of the mutant."""

    def is_changed(code: CodeType) -> bool:
        here = (code.co_qualname, code.co_firstlineno)
        return code.co_filename == mutant.path and here == mutant.function

    new = next(code for code in _codes(mutant.code()) if is_changed(code))
    for function in [f for f in gc.get_objects() if isinstance(f, FunctionType)]:
        if is_changed(function.__code__):
            function.__code__ = new


def _codes(code: CodeType) -> list[CodeType]:
    """A code and all inside it."""
    inner = [c for c in code.co_consts if isinstance(c, CodeType)]
    return [code, *(deep for c in inner for deep in _codes(c))]


class Replaced(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the mutant in the place of its module."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant

    def find_spec(self, fullname, path, target=None):  # type: ignore[no-untyped-def]
        if fullname != self.mutant.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.mutant.path, loader=self)

    def exec_module(self, module) -> None:  # type: ignore[no-untyped-def]
        exec(self.mutant.code(), module.__dict__)


def failure_in_place(
    items: list[pytest.Item], mutant: Mutant | None, wanted: Sequence[str], seconds: float
) -> str | None:
    """Who noticed a change of a function, among tests that were collected without it."""

    def action(pipe: int) -> None:
        if mutant is not None:
            changed_in_place(mutant)
        items[0].config.pluginmanager.register(FirstFailure(pipe))
        run(items, wanted)

    code, name = in_child(action, seconds)
    return (name or "a crash or the time limit") if code else None


def failure_from_import(mutant: Mutant, wanted: Sequence[str], seconds: float) -> str | None:
    """Who noticed a change of what runs on import: in a process that has not imported certrack."""

    def action(pipe: int) -> None:
        log = os.open(os.devnull, os.O_WRONLY)
        os.dup2(log, 1)
        os.dup2(log, 2)
        sys.meta_path.insert(0, Replaced(mutant))
        files = list(dict.fromkeys(name.partition("::")[0] for name in wanted))
        loop = Loop(lambda items: run(items, wanted))
        if code := pytest.main([*OPTIONS, *files], plugins=[loop, FirstFailure(pipe)]):
            sys.exit(int(code))

    code, name = in_child(action, seconds + 5)
    return (name or "an import, a crash or the time limit") if code else None


def prepare() -> None:
    """Import what is not ours once, for all children."""
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT / "src"), str(ROOT / "tests")]
    os.environ["PYTHONPATH"] = str(ROOT / "src")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for package in ("numpy", "sympy", "scipy.stats", "flint", "clarabel", "heyoka"):
        if importlib.util.find_spec(package.partition(".")[0]):
            importlib.import_module(package)

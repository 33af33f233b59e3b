"""Mutation testing: small changes of the source that the tests must notice.

    python tools/mutants.py [GROUP ...] [--count 20] [--seed 0]

Each group is a few modules and the files of tests that should notice a change in them. Of all
changes, a seeded sample is tried; each meets those tests that run its line, the fastest first,
until one fails. A change that no test notices survives, also where no test runs its line: write a
test for it, or explain in ``equivalent-mutants.txt`` why it changes nothing that anyone can see.
The exit code is 1 if a survivor is not explained.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import time
from pathlib import Path

from mutation.changes import Mutant, mutants
from mutation.groups import GROUPS
from mutation.runs import collect, failure_from_import, failure_in_place, prepare
from mutation.traces import trace

EXPLAINED = Path(__file__).with_name("equivalent-mutants.txt")


def explained() -> dict[str, str]:
    """Mutants that change nothing visible, and why: a line of each, the reason indented below."""
    found: dict[str, str] = {}
    for line in EXPLAINED.read_text().splitlines() if EXPLAINED.exists() else []:
        if line.startswith("    "):
            found[list(found)[-1]] += line.strip() + " "
        elif line and not line.startswith("#"):
            found[line] = ""
    return found


def is_explained(mutant: Mutant, reasons: dict[str, str]) -> bool:
    """Whether the list has it; a line that ends with * is for all that begin so."""
    return any(
        mutant.text.startswith(line[:-1]) if line.endswith("*") else mutant.text == line
        for line in reasons
    )


def try_group(name: str, count: int, seed: int, only: str) -> bool:
    """Try a sample of a group, print its survivors and its score; whether all are explained."""
    group, reasons = GROUPS[name], explained()
    everything = [m for module in group.modules for m in mutants(module, group.texts)]
    everything = [m for m in everything if only in m.text]
    sample = random.Random(f"{seed} {name}").sample(everything, min(count, len(everything)))
    print(f"{name}: {len(sample)} of {len(everything)} mutants", flush=True)
    known = trace(group.files, group.modules)
    screen = os.fdopen(os.dup(1), "w", buffering=1)  # while pytest captures what is printed
    tried = [m for m in sample if not is_explained(m, reasons)]
    plans = [(m, *known.tests(m)) for m in tried]
    noticed: set[str] = set()
    survived = 0
    began = time.monotonic()

    def judge(mutant: Mutant, killer: str | None, why: str) -> None:
        nonlocal survived
        survived += killer is None
        noticed.add(killer or "")
        if killer is None:
            screen.write(f"  survived {why}, line {mutant.lines[0]}: {mutant.text}\n")

    for mutant, tests, anew in plans:
        seconds = sum(known.seconds[test] for test in tests)
        if not tests:
            judge(mutant, None, "as no test runs it")
        elif anew:
            judge(mutant, failure_from_import(mutant, tests, seconds), f"{len(tests)} tests")

    def loop(items: list) -> None:
        for mutant, tests, anew in plans:
            if tests and not anew:
                seconds = sum(known.seconds[test] for test in tests)
                killer = failure_in_place(items, mutant, tests, seconds)
                judge(mutant, killer, f"{len(tests)} tests")
        judges = sorted(noticed & known.seconds.keys())
        seconds = sum(known.seconds[test] for test in judges)
        if judges and (failed := failure_in_place(items, None, judges, seconds)):
            screen.write(f"{name}: the score is void, without any change fails {failed}\n")

    collect(group.files, loop)
    killed = len(tried) - survived
    score, took = 100 * killed / max(len(tried), 1), time.monotonic() - began
    screen.write(
        f"{name}: {killed} of {len(tried)} noticed ({score:.1f} %), "
        f"{len(sample) - len(tried)} equivalent; {took / max(len(tried), 1):.1f} s each\n"
    )
    return survived == 0


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("groups", nargs="*", choices=[*GROUPS, []], help="all if left out")
    parser.add_argument("--count", type=int, default=20, help="mutants per group")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="mutants whose text has this in it")
    options = parser.parse_args()
    prepare()
    left = 0
    for name in options.groups or GROUPS:
        child = os.fork()  # every group begins with a process that has not imported certrack
        if child == 0:
            os._exit(0 if try_group(name, options.count, options.seed, options.only) else 1)
        left += os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0
    sys.exit(1 if left else 0)


if __name__ == "__main__":
    main()

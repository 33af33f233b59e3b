"""What a change did to the speed: rows of work, of two source trees in turns.

``make bench-compare BASE=main`` prints the processor time of every row before and after, and their
ratio, and writes them to ``build/bench-compare.json``. Each row runs in processes of its own, of
the one tree and of the other by turns, and the best of the rounds counts: a noisy machine hurts
both alike. `ROWS` names what is measured and what is wanted of it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent

#: A plant of n states under the robust law.
CHAIN = """
def chain(n, c=3):
    plant = certrack.Plant(
        states=[f"x{i}" for i in range(1, n + 1)], chain=[1] * (n - 1), input_gain=1,
        uncertainty=certrack.Uncertainty([0] * (n - 1) + [0.1], [1e-3] * n, [0.1] * n))
    return certrack.System(
        plant=plant, law=certrack.Robust(c=[c] * n, feedforward=1),
        reference=certrack.SymbolicReference("0.2*cos(t)"), truth=certrack.Truth(1),
        settings=certrack.Settings([0] * n, 1))
"""

#: Prints the best processor time of a statement, s, the time that `fresh` takes left out.
WORKER = """
import json, sys, time
setup, fresh, statement, turn = json.loads(sys.argv[1])
names = {}
exec("import certrack\\n" + setup, names)
fresh, statement = (compile(code, "row", "exec") for code in (fresh, statement))
best, begin, calls = float("inf"), time.process_time(), 0
while calls < 3 or time.process_time() - begin < turn:
    exec(fresh, names)
    start = time.process_time()
    exec(statement, names)
    calls += 1
    best = min(best, time.process_time() - start)
print(best)
"""


#: Prints the proven bounds of the shipped systems.
BOUNDS = """
import json, sys
import certrack
from certrack.systems.shipped import catalog
found = {}
for name in catalog():
    certificates = certrack.certify(certrack.load(name), effort=sys.argv[1])
    each = {kind: getattr(value, "bound", None) for kind, value in vars(certificates).items()}
    found |= {f"{name}, {kind}": v for kind, v in each.items() if isinstance(v, float)}
    if certificates.tube is not None:
        found |= {f"{name}, tube at {t} s": certificates.tube(t) for t in (0.0, 1.0, 5.0)}
print(json.dumps(found))
"""

#: A bound that is larger by this part than before is worse: a search in floats may end elsewhere.
WORSE = 1e-6


@dataclass(frozen=True)
class Row:
    """One piece of work.

    Attributes
    ----------
    wanted : float
        Processor time, s.
    arguments : words of the command line
        Of a process whose time counts with its start and imports, or
    setup, fresh, statement : str
        Python: what is done once, what before every call, and what is timed.
    """

    wanted: float
    arguments: tuple[str, ...] = ()
    setup: str = ""
    fresh: str = ""
    statement: str = ""


def _certified(system: str, wanted: float, effort: str = "fast") -> Row:
    """A certificate of a system that is read or made anew: nothing is remembered of it."""
    return Row(wanted, (), CHAIN, f"s = {system}", f"certrack.certify(s, effort={effort!r})")


def _bound(n: int, wanted: float, warm: bool = False) -> Row:
    """The bound of a robust law alone, in floats, with its gradient where it is warm."""
    imports = """
from certrack.certificates.arithmetic import decimal
from certrack.certificates.estimates.riccati import riccati_estimate
from certrack.certificates.formulation import error_problem
"""
    setup = f"{CHAIN}{imports}problem = error_problem(chain({n}), decimal)\nstate = None\n"
    if warm:  # of a problem nearby
        setup += f"near = error_problem(chain({n}, 3.06), decimal)\n"
        setup += "state = riccati_estimate(near).state\n"
    return Row(wanted, (), setup, "", "riccati_estimate(problem, state)")


def _run(name: str, tolerance: float, wanted: float) -> Row:
    setup = f's = certrack.load("{name}").with_settings(tolerance={tolerance})\n'
    return Row(
        wanted, (), setup + "simulator = certrack.Simulator(s)", "", "simulator.run().metrics"
    )


def _members(name: str, count: int, wanted: float) -> Row:
    """Members of a population, compiled before, with the limit remembered."""
    setup = f's = certrack.load("{name}")\n'
    call = f"certrack.ensemble(s, {count}, threads=1)"
    return Row(wanted, (), setup + call, "", call)


ROWS = {
    "certrack list": Row(0.25, ("list",)),
    "certrack design example1": Row(0.25, ("design", "example1")),
    "certrack margin example1": Row(1.0, ("margin", "example1")),
    "certrack falsify example1": Row(1.0, ("falsify", "example1", "--budget", "3000")),
    "certrack falsify dual-motor": Row(1.0, ("falsify", "dual-motor", "--budget", "3000")),
    "fast certificate, example1": _certified('certrack.load("example1")', 0.060),
    "default certificate, example1": _certified('certrack.load("example1")', 3.0, "default"),
    "fast certificate, robust n = 2": _certified("chain(2)", 0.009),
    "fast certificate, robust n = 4": _certified("chain(4)", 0.022),
    "fast certificate, robust n = 8": _certified("chain(8)", 0.079),
    "fast certificate, robust n = 12": _certified("chain(12)", 0.268),
    "bound of robust n = 4, cold": _bound(4, 6e-3),
    "bound of robust n = 4, warm": _bound(4, 2e-3, warm=True),
    "bound of robust n = 12, cold": _bound(12, 6e-3),
    "bound of robust n = 12, warm": _bound(12, 10e-3, warm=True),
    "run of example1 at 1e-9": _run("example1", 1e-9, 0.15e-3),
    "run of example1 at 1e-6": _run("example1", 1e-6, 0.10e-3),
    "10,000 members of example1": _members("example1", 10_000, 0.12),
    "1,024 members of dual-motor": _members("dual-motor", 1_024, 1_024 * 20e-6),
    "1,024 members of dual-motor-strong": _members("dual-motor-strong", 1_024, 1_024 * 20e-6),
    "sampled run of dual-motor-drive": _run("dual-motor-drive", 1e-9, 5e-3),
}

#: Too long for every comparison: by `--only`.
LONG_ROWS = {
    "certrack reproduce": Row(6.0, ("reproduce", "--out", "{folder}")),
    "high certificate, example1": _certified('certrack.load("example1")', 60.0, "high"),
}


def spent(row: Row, tree: Path, turn: float, folder: Path) -> float:
    """Processor time of one round of a row, s."""
    environment = os.environ | {
        "PYTHONPATH": str(tree / "src"),
        "OMP_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "",  # as installed: modules are compiled in the first round
        "PYTHONPYCACHEPREFIX": str(folder.parent / "bench-bytecode"),
    }
    if not row.arguments:
        task = json.dumps([row.setup, row.fresh, row.statement, turn])
        command = [sys.executable, "-c", WORKER, task]
        return float(subprocess.check_output(command, env=environment, text=True))
    words = [word.format(folder=folder) for word in row.arguments]
    process = subprocess.Popen(
        [sys.executable, "-m", "certrack", *words], env=environment, stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(words)} ended with {process.returncode} in {tree}")
    return usage.ru_utime + usage.ru_stime


def compared(base: Path, rows: dict[str, Row], rounds: int, turn: float) -> dict[str, list[float]]:
    """Best time of every row in the base and in this tree, s; printed as they come."""
    folder = HERE / "build" / "bench-reproduction"
    heads = ("before", "after", "after/before", "wanted")
    print("processor time, ms".ljust(34) + "".join(f"{head:>14}" for head in heads))
    times = {}
    for name, row in rows.items():
        best = [float("inf")] * 2
        for turned in range(rounds):
            for place in (0, 1) if turned % 2 == 0 else (1, 0):
                tree = (base, HERE)[place]
                best[place] = min(best[place], spent(row, tree, turn, folder))
        times[name] = [*best, row.wanted]
        before, after = best
        print(
            f"{name:34}{1e3 * before:14.3f}{1e3 * after:14.3f}{after / before:14.2f}"
            f"{1e3 * row.wanted:14.3f}",
            flush=True,
        )
    return times


@contextmanager
def checked_out(folder: Path, commit: str) -> Iterator[Path]:
    """The folder if it is a checkout, else a checkout of the commit."""
    if (folder / "src").is_dir():
        yield folder
        return
    checkout = HERE / "build" / "bench-base"
    git = ["git", "-C", str(HERE), "worktree"]
    subprocess.run([*git, "add", "--force", "--detach", str(checkout), commit], check=True)
    try:
        yield checkout
    finally:
        subprocess.run([*git, "remove", "--force", str(checkout)], check=True)


def compared_bounds(base: Path, effort: str) -> bool:
    """Whether no bound of a shipped system got worse; prints those that moved."""
    found = []
    for tree in (base, HERE):
        environment = os.environ | {"PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-c", BOUNDS, effort]
        found.append(json.loads(subprocess.check_output(command, env=environment, text=True)))
    before, after = found
    worse = 0
    for name, old in before.items():
        new = after.get(name, float("inf"))
        is_worse = not new <= old * (1 + WORSE)
        worse += is_worse
        if is_worse or abs(new - old) > WORSE * old:
            print(f"{name}: {old!r} before, {new!r} after{', worse' if is_worse else ''}")
    print(f"{len(before)} bounds of effort {effort}: {worse} worse by more than {WORSE:g}")
    return not worse


def main() -> None:
    """Compare this tree with a commit, or with another checkout."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("base", help="a commit, or the folder of a checkout")
    parser.add_argument("--only", default="", help="rows with this text, the long ones too")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--turn", type=float, default=0.3, help="seconds of a row in a round")
    parser.add_argument(
        "--bounds", metavar="EFFORT", help="compare the bounds of this effort, not the times"
    )
    chosen = parser.parse_args()
    every = ROWS | LONG_ROWS if chosen.only else ROWS
    rows = {name: row for name, row in every.items() if chosen.only in name}
    base = Path(chosen.base).resolve()
    with checked_out(base, chosen.base) as tree:
        if chosen.bounds:
            sys.exit(not compared_bounds(tree, chosen.bounds))
        times = compared(tree, rows, chosen.rounds, chosen.turn)
    written = HERE / "build" / "bench-compare.json"
    written.parent.mkdir(exist_ok=True)
    columns = ("before", "after", "wanted")
    table = {name: dict(zip(columns, row, strict=True)) for name, row in times.items()}
    written.write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()

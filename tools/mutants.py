"""Mutation testing: small changes of the source that the tests must notice.

    python tools/mutants.py [GROUP ...] [--count 20] [--seed 0]

Each group is a few modules and the narrowest tests that should notice a change in them. Of all
changes that the operators below allow, a seeded sample is tried; each runs the tests of its group
in a process of its own, with the changed module in the place of the real one. A change that no
test notices survives: write a test for it, or explain in ``equivalent-mutants.txt`` why it changes
nothing that anyone can see. The exit code is 1 if a survivor is not explained.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "certrack"
EXPLAINED = Path(__file__).with_name("equivalent-mutants.txt")

#: A mutant that takes this many times as long as the real code, and 20 s, is stopped: noticed.
SLOWER, EXTRA_SECONDS = 4, 20


@dataclass(frozen=True)
class Group:
    """Modules (below ``src/certrack``) and the arguments of pytest that run their tests."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    texts: bool = False  # whether operators inside texts are changed, too: printers


GROUPS = {
    "backstepping": Group(
        ("laws/backstepping.py",), ("tests/test_backstepping.py", "-k", "not random_nominal")
    ),
    "laws": Group(
        (
            "laws/base.py",
            "laws/signals.py",
            "laws/robust.py",
            "laws/adaptive.py",
            "laws/classic.py",
        ),
        (
            *("tests/test_laws.py", "tests/test_testing.py", "tests/test_backstepping.py", "-k"),
            "(FullGamma and (its or immutable or symbols or fields or survives or sampled))"
            " or (Robust and its) or (TestClassic and its) or adaptive_laws or robust_law"
            " or refused or must_know or refuses or smooth or initial or user",
        ),
    ),
    "certificates": Group(
        (
            *("certificates/formulation.py", "certificates/problem.py", "certificates/exact.py"),
            *("certificates/adaptation.py", "certificates/centred.py", "certificates/cascade.py"),
            *("certificates/document.py", "certificates/arithmetic.py"),
        ),
        (
            *("tests/test_certificate_data.py", "tests/test_rounding.py"),
            *("tests/test_independent_checker.py", "tests/test_certificates.py", "-k"),
            "not falsif and not random_systems and not tube and not critical and not classical"
            " and not rate_is and not lean_bounds",
        ),
    ),
    "references": Group(
        tuple(
            f"references/{name}.py"
            for name in ("shapes", "piecewise", "polynomials", "symbolic", "supremum")
        ),
        (
            *("tests/test_references.py", "tests/test_testing.py", "-k"),
            "not many_samples and not duties and not wrong and not law",
        ),
    ),
    "metrics": Group(("simulation/metrics.py",), ("tests/test_metrics.py",)),
    "sampled": Group(
        ("loops/controller.py", "loops/sampled.py", "integrators/sampled/run.py"),
        (
            *("tests/test_sampled.py", "-k"),
            "by_hand or limits_are or projection or quantised or saturation or differenced or leak"
            " or forget or noise or breaks or rounding or escape or integrals or longer"
            " or period_map",
        ),
    ),
    "statistics": Group(
        ("studies/ensembles/statistics.py",),
        (
            *("tests/test_statistics.py", "tests/test_ensembles.py", "-k"),
            "statistics or clopper or counts or bins or (brute and lockstep)",
        ),
    ),
    "c-printers": Group(
        ("export/c/printer.py", "export/c/source.py", "core/printing.py"),
        (
            *("tests/test_printing.py", "tests/test_export_c.py", "-k"),
            "printing or wrong_number or plain or limits or text",
        ),
        texts=True,
    ),
}

ARITHMETIC = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.MatMult: (ast.Mult,),
}
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
SWAPPED_NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "floor": "ceil"}
SWAPPED_CHARACTERS = {"+": "-", "-": "+", "*": "/", "<": ">", ">": "<", "&": "|", "|": "&"}


def replacements(node: ast.AST, texts: bool) -> Iterator[ast.AST]:
    """What may stand in the place of `node`."""

    def changed(**fields: object) -> ast.AST:
        twin = copy.copy(node)
        for name, value in fields.items():
            setattr(twin, name, value)
        return twin

    if isinstance(node, (ast.BinOp, ast.AugAssign)):
        yield from (changed(op=op()) for op in ARITHMETIC.get(type(node.op), ()))
    elif isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            for other in COMPARISONS[type(op)]:
                yield changed(ops=[*node.ops[:i], other(), *node.ops[i + 1 :]])
    elif isinstance(node, ast.BoolOp):
        yield changed(op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        yield node.operand
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        yield changed(test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield changed(value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield changed(value=node.value + 1)
        yield changed(value=node.value - 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield changed(value=2 * node.value or 1.0)
        if node.value:
            yield changed(value=node.value / 2)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and texts:
        for i, character in enumerate(node.value):
            if character in SWAPPED_CHARACTERS:
                other = SWAPPED_CHARACTERS[character]
                yield changed(value=node.value[:i] + other + node.value[i + 1 :])
                break
    elif isinstance(node, ast.Name) and node.id in SWAPPED_NAMES:
        yield changed(id=SWAPPED_NAMES[node.id])
    elif isinstance(node, ast.Attribute) and node.attr in SWAPPED_NAMES:
        yield changed(attr=SWAPPED_NAMES[node.attr])
    elif isinstance(node, (ast.Continue, ast.Break)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield ast.Pass()


#: A place in a syntax tree: names of fields, and indices where a field is a list.
Place = tuple[tuple[str, int | None], ...]


def places(node: ast.AST, texts: bool, here: Place = ()) -> Iterator[tuple[Place, ast.AST]]:
    """Every node that a change could begin at: no annotations, messages, docstrings."""
    yield here, node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        for i, child in enumerate(value if isinstance(value, list) else [value]):
            if not isinstance(child, ast.AST) or isinstance(child, (ast.Raise, ast.Assert)):
                continue
            if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
                continue  # a docstring
            if isinstance(child, ast.FunctionDef) and child.name == "__repr__":
                continue
            if isinstance(child, ast.JoinedStr) and not texts:
                continue  # a message
            yield from places(child, texts, (*here, (name, i if isinstance(value, list) else None)))


def at(tree: ast.AST, place: Place) -> ast.AST:
    """The node at a place."""
    for name, i in place:
        value = getattr(tree, name)
        tree = value if i is None else value[i]
    return tree


def put(tree: ast.AST, place: Place, node: ast.AST) -> None:
    """Replace the node at a place."""
    *before, (name, i) = place
    parent = at(tree, tuple(before))
    if i is None:
        setattr(parent, name, node)
    else:
        getattr(parent, name)[i] = node


@dataclass(frozen=True)
class Mutant:
    """One change: its module, where and what it is in words, and the source with it."""

    module: str
    line: int
    text: str
    source: str


def mutants(module: str, texts: bool) -> list[Mutant]:
    """Every mutant of a module."""
    source = (SOURCE / module).read_text()
    tree, found, seen = ast.parse(source), [], {}
    for place, node in places(tree, texts):
        for other in replacements(node, texts):
            twin = copy.deepcopy(tree)
            put(twin, place, copy.deepcopy(other))
            ast.fix_missing_locations(twin)
            text = f"{module}::{_scope(tree, place)}: {_words(tree, twin, place)}"
            seen[text] = seen.get(text, 0) + 1
            text += f" ({seen[text]})" if seen[text] > 1 else ""
            found.append(Mutant(module, getattr(node, "lineno", 0), text, ast.unparse(twin)))
    return found


def _scope(tree: ast.AST, place: Place) -> str:
    """Classes and functions around a place."""
    nodes = (at(tree, place[:i]) for i in range(1, len(place) + 1))
    names = [n.name for n in nodes if isinstance(n, (ast.FunctionDef, ast.ClassDef))]
    return ".".join(names) or "module"


def _words(tree: ast.AST, twin: ast.AST, place: Place) -> str:
    """The statement around a place, or the head of one, before and after."""
    cut = max(i for i in range(len(place) + 1) if isinstance(at(tree, place[:i]), ast.stmt))
    here = place[:cut]
    if hasattr(at(tree, here), "body"):  # a compound statement: only the part that changes
        here = place[: cut + 1] if cut < len(place) else here
    texts = (ast.unparse(at(t, here)).splitlines()[0] for t in (tree, twin))
    return " -> ".join(texts)


class Replaced(importlib.abc.MetaPathFinder, importlib.abc.SourceLoader):
    """Imports one module from a mutant's source."""

    def __init__(self, mutant: Mutant) -> None:
        self.name = "certrack." + mutant.module.removesuffix(".py").replace("/", ".")
        self.path, self.source = str(SOURCE / mutant.module), mutant.source

    def find_spec(self, fullname, path, target=None):  # type: ignore[no-untyped-def]
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self)

    def get_filename(self, fullname: str) -> str:
        return self.path

    def get_data(self, path: str) -> bytes:
        return self.source.encode()


def run(tests: tuple[str, ...], mutant: Mutant | None, limit: float) -> tuple[str, float]:
    """``survived``, ``noticed`` or ``too slow``, and the seconds it took."""
    began = time.monotonic()
    log = tempfile.TemporaryFile("w+b")  # noqa: SIM115
    child = os.fork()
    if child == 0:
        os.setsid()
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
        if mutant is not None:
            sys.meta_path.insert(0, Replaced(mutant))
        import pytest

        options = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow", "--no-header"]
        code = 1
        try:
            code = int(pytest.main([*options, *tests]))
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        seconds = time.monotonic() - began
        if done:
            break
        if seconds > limit:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return "too slow", seconds
        time.sleep(0.05)
    code = os.waitstatus_to_exitcode(status)
    if mutant is None and code != 0:
        log.seek(0)
        sys.exit("the tests fail without any change:\n" + log.read().decode()[-3000:])
    return ("survived" if code == 0 else "noticed"), seconds


def explained() -> dict[str, str]:
    """Mutants that change nothing visible, and why: a line of each, the reason indented below."""
    found: dict[str, str] = {}
    for line in EXPLAINED.read_text().splitlines() if EXPLAINED.exists() else []:
        if line.startswith("    "):
            found[list(found)[-1]] += line.strip() + " "
        elif line and not line.startswith("#"):
            found[line] = ""
    return found


def fits(text: str, line: str) -> bool:
    """Whether a line of the list that ends with * begins like the mutant."""
    return line.endswith("*") and text.startswith(line[:-1])


def try_group(name: str, count: int, seed: int) -> int:
    """Try a sample of a group, print its survivors and its score; how many are unexplained."""
    group, reasons = GROUPS[name], explained()
    tests = tuple(t for t in group.tests if "/" not in t or (ROOT / t).exists())
    everything = [m for module in group.modules for m in mutants(module, group.texts)]
    sample = random.Random(f"{seed} {name}").sample(everything, min(count, len(everything)))
    _, usual = run(tests, None, 1e9)
    print(f"{name}: {len(sample)} of {len(everything)} mutants, {usual:.0f} s each", flush=True)
    noticed = equivalent = 0
    for mutant in sample:
        if mutant.text in reasons or any(fits(mutant.text, line) for line in reasons):
            equivalent += 1
            continue
        outcome, seconds = run(tests, mutant, SLOWER * usual + EXTRA_SECONDS)
        noticed += outcome != "survived"
        if outcome == "survived":
            print(f"  survived, {seconds:.0f} s, line {mutant.line}: {mutant.text}", flush=True)
    tried = len(sample) - equivalent
    score = 100 * noticed / max(tried, 1)
    print(f"{name}: {noticed} of {tried} noticed ({score:.1f} %), {equivalent} equivalent")
    return tried - noticed


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("groups", nargs="*", choices=[*GROUPS, []], help="all if left out")
    parser.add_argument("--count", type=int, default=20, help="mutants per group")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT / "src"), str(ROOT / "tests")]
    os.environ["PYTHONPATH"] = str(ROOT / "src")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for package in ("numpy", "sympy", "scipy.stats", "flint", "clarabel", "heyoka"):
        if importlib.util.find_spec(package.partition(".")[0]):
            importlib.import_module(package)  # once, for all mutants
    left = [try_group(name, options.count, options.seed) for name in options.groups or GROUPS]
    sys.exit(1 if any(left) else 0)


if __name__ == "__main__":
    main()

"""Architecture: rooms, layers, names, public surface, size of files, cost of import."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest

import certrack

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "certrack"
PAGE = ROOT / "docs" / "architecture.md"


def test_imports_point_down_only():
    command = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [command, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


def floors():
    """The rooms of every floor, from the top down, as the import contract lists them."""
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = contract["contracts"][0]["layers"]
    return [[name.strip().removeprefix("certrack.") for name in row.split("|")] for row in layers]


def modules():
    """Room (folder, or module at the root), path and syntax tree of every module."""
    for path in sorted(SOURCE.rglob("*.py")):
        inner = path.relative_to(SOURCE)
        yield inner.parts[0].removesuffix(".py"), inner.as_posix(), ast.parse(path.read_text())


def test_rooms_are_folders_floors_and_entries_of_the_page():
    root = {path.stem for path in SOURCE.glob("*.py")} - {"__init__", "__main__"}
    folders = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    stray = {path.parent.name for path in SOURCE.glob("*/*.py")} - folders
    assert not stray, "a room needs an __init__.py"
    listed = [room for floor in floors() for room in floor]
    assert sorted(listed) == sorted(root | folders)
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \|", PAGE.read_text(), re.M)
    numbered = [(len(floors()) - i, room) for i, floor in enumerate(floors()) for room in floor]
    assert [(int(number), room) for number, room in rows] == numbered


def test_root_holds_few_modules():
    assert len(list(SOURCE.glob("*.py"))) <= 6


def defined(body):
    """Names that classes, functions and assignments of a body define, dotted for members."""
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
            if isinstance(node, ast.ClassDef):
                yield from (f"{node.name}.{name}" for name in defined(node.body))
        elif isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = (part for target in targets for part in ast.walk(target))
            yield from (part.id for part in names if isinstance(part, ast.Name))


def test_page_names_what_exists():
    """Files as `room/file.py`, or as `tests/...` of the repository, names behind `::`."""
    found = re.findall(r"`([\w./-]+\.(?:py|toml))(?:::([\w.]+))?`", PAGE.read_text())
    assert len(found) > 30
    for file, name in found:
        path = next((p for p in (SOURCE / file, ROOT / file) if p.exists()), None)
        assert path is not None, file
        if name:
            assert name in set(defined(ast.parse(path.read_text()).body)), f"{file}::{name}"


#: Public names that several modules define, and why that is one meaning.
ONE_MEANING = {
    **dict.fromkeys(
        (
            "certify",
            "check",
            "design",
            "energy",
            "ensemble",
            "falsify",
            "fmu",
            "optimal",
            "reproduce",
            "simulate",
            "tune",
            "verify",
        ),
        "the verb of the command line, and what it calls",
    ),
    "check": "look at what is stated: a file (the verb and what it calls), or a proof",
}


def test_public_names_mean_one_thing():
    """The list is exact: an entry that is no longer needed has to go."""
    places = defaultdict(set)
    for _, path, tree in modules():
        for name in defined(tree.body):
            if not name.startswith("_") and "." not in name:
                places[name].add(path)
    twice = {name: sorted(paths) for name, paths in places.items() if len(paths) > 1}
    assert twice.keys() == ONE_MEANING.keys(), twice


def test_private_names_are_unique_within_a_room():
    places = defaultdict(set)
    for room, path, tree in modules():
        for name in defined(tree.body):
            if name.startswith("_") and not name.startswith("__") and "." not in name:
                places[room, name].add(path)
    twice = {key: sorted(paths) for key, paths in places.items() if len(paths) > 1}
    assert not twice


#: Words that say nothing to a control or numerics engineer; what is meant has a name.
BANNED = set(
    "found made given way ways some mine whole put taken kept rest own go look creep bury forget "
    "lay told hands crowd passed course counted Crowd Passed Course Counted MOST PATIENCE".split()
)


def identifiers(tree):
    """Every name that a module gives to something."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr
        elif isinstance(node, ast.alias) and node.asname:
            yield node.asname
        elif isinstance(node, (ast.ExceptHandler, ast.MatchAs, ast.MatchStar)) and node.name:
            yield node.name


def test_names_are_those_of_the_field():
    for _, path, tree in modules():
        assert not {name.strip("_") for name in identifiers(tree)} & BANNED, path


def test_public_surface_is_frozen():
    assert certrack.__all__ == sorted(certrack.__all__)
    assert set(certrack.__all__) == {
        "Adaptive",
        "BoundEstimate",
        "Bounds",
        "Cancellable",
        "Cancelled",
        "Certificate",
        "Certificates",
        "CertrackError",
        "Check",
        "Claim",
        "Classic",
        "CompilerError",
        "ControlBlocks",
        "Controller",
        "Design",
        "DesignError",
        "Distribution",
        "Dossier",
        "Energy",
        "EnergyBalance",
        "Ensemble",
        "ErrorCoordinates",
        "Exported",
        "Falsification",
        "Front",
        "Gains",
        "Goal",
        "Implementation",
        "InputError",
        "Law",
        "Linear",
        "LostStart",
        "LostStarts",
        "Margin",
        "Margins",
        "Metrics",
        "MissingExtra",
        "Monitor",
        "Motors",
        "NoCertificate",
        "Optima",
        "Optimum",
        "Outcome",
        "PairedComparison",
        "Plant",
        "Population",
        "Premise",
        "Reproduction",
        "Robust",
        "Run",
        "Settings",
        "Simulator",
        "Supply",
        "SymbolicReference",
        "System",
        "TorqueSplit",
        "TrajectoryCost",
        "Truth",
        "Tube",
        "Tuned",
        "Uncertainty",
        "Verdict",
        "__version__",
        "catalog",
        "certificates",
        "certify",
        "check",
        "check_assumption_1",
        "design",
        "dossier",
        "energy",
        "ensemble",
        "estimate",
        "export_c",
        "export_fmu",
        "export_st",
        "falsify",
        "latex_table",
        "laws",
        "load",
        "loads",
        "lost_starts",
        "margins",
        "member",
        "optimal",
        "paired",
        "plot",
        "plotting",
        "references",
        "reproduce",
        "save",
        "save_dossier",
        "simulate",
        "simulate_with_c",
        "starter",
        "testing",
        "to_control",
        "to_text",
        "trapezoid",
        "triangle",
        "tune",
    }
    for name in certrack.__all__:
        assert getattr(certrack, name).__doc__


def test_import_loads_nothing_heavy():
    code = "import sys, certrack; print([m for m in sys.modules if m in HEAVY])"
    heavy = {"numpy", "sympy", "scipy", "heyoka", "xarray", "matplotlib", "click", "rich"}
    command = [sys.executable, "-c", code.replace("HEAVY", repr(heavy))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [
        (["--help"], ["numpy", "sympy", "rich", "certrack.systems", "certrack.core.checks"]),
        (["list"], ["numpy", "sympy", "certrack.systems.reader"]),
        (["design", "dual-motor-lean"], ["scipy", "heyoka", "xarray", "matplotlib", "numpy.f2py"]),
    ],
)
def test_a_verb_loads_what_it_needs(arguments, heavy):
    code = (
        "import sys; from certrack.cli import main\n"
        "try: main(sys.argv[2:])\n"
        "except SystemExit: pass\n"
        "print([name for name in sys.argv[1].split() if name in sys.modules], file=sys.stderr)"
    )
    command = [sys.executable, "-c", code, " ".join(heavy), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout and done.stderr.strip() == "[]"


def test_no_eval_anywhere():
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in {"eval", "exec", "compile"}, path
            if isinstance(node, ast.Attribute):
                assert node.attr not in {"parse_expr"}, path


def test_files_stay_small():
    for path in SOURCE.rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 420, path

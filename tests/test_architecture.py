"""The house: layers, public surface, size of files, cost of import."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import certrack

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "certrack"


def test_imports_point_down_only():
    command = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [command, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


def test_every_module_has_its_floor():
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = contract["contracts"][0]["layers"]
    listed = {name.strip() for layer in layers for name in layer.split("|")}
    modules = {path.stem for path in SOURCE.glob("*.py")} - {"__init__"}
    packages = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    assert listed == {f"certrack.{name}" for name in modules | packages}


def test_public_surface_is_frozen():
    assert certrack.__all__ == sorted(certrack.__all__)
    assert set(certrack.__all__) == {
        "Adaptive",
        "Certificates",
        "CertrackError",
        "Classic",
        "DesignError",
        "Distribution",
        "Ensemble",
        "ErrorCoordinates",
        "Gains",
        "Implementation",
        "InputError",
        "Law",
        "Metrics",
        "MissingExtra",
        "NoCertificate",
        "Outcome",
        "Plant",
        "Population",
        "Robust",
        "Run",
        "Settings",
        "Simulator",
        "SymbolicReference",
        "System",
        "Truth",
        "Uncertainty",
        "catalog",
        "certify",
        "check_assumption_1",
        "ensemble",
        "load",
        "loads",
        "margins",
        "recursion",
        "samples",
        "save",
        "simulate",
        "steps",
        "to_text",
        "trapezoid",
        "triangle",
        "tube",
        "verify",
    }
    for name in certrack.__all__:
        assert getattr(certrack, name).__doc__


def test_import_loads_nothing_heavy():
    code = "import sys, certrack; print([m for m in sys.modules if m in HEAVY])"
    heavy = {"numpy", "sympy", "scipy", "heyoka", "xarray", "matplotlib", "click", "rich"}
    command = [sys.executable, "-c", code.replace("HEAVY", repr(heavy))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


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

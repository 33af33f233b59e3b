"""The paper's equation numbers: each label stands where docs/paper.md says, and nowhere else."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "certrack"
PAGE = (ROOT / "docs" / "paper.md").read_text()
NUMBERS = range(1, 55)

LABEL = re.compile(r"(?<![\w\])=])(?<!= )\[(\d{1,2})\](?![\[(])")
ROW = re.compile(r"^\| (\[\d+\]|[A-Z]\w+ \d) \|.*\| ([^|]*) \|$", re.M)
PLACE = re.compile(r"`([\w./-]+\.(?:py|toml))(?:::([\w.]+))?`")

#: Files that speak of the paper's equations, besides all of the package.
TESTS = [ROOT / "tests" / "test_lyapunov.py"]


def places():
    """Of every row of the index: its name, and files with the names in them."""
    return {name: PLACE.findall(cell) for name, cell in ROW.findall(PAGE)}


def path_of(file):
    return next(p for p in (SOURCE / file, ROOT / file) if p.exists())


def numbers(text):
    return {int(number) for number in LABEL.findall(text)}


def owners(tree):
    """Dotted names of classes and functions, with their first and last line."""
    for node in tree.body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            yield node.name, node.lineno, node.end_lineno
            if isinstance(node, ast.ClassDef):
                for name, first, last in owners(node):
                    yield f"{node.name}.{name}", first, last


def remarks(path):
    """Comments and docstrings with the lines on which they begin and stand."""
    text = path.read_text()
    if path.suffix != ".py":
        for number, line in enumerate(text.splitlines(), 1):
            yield number, line.partition("#")[2]
        return
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
        elif token.type == tokenize.STRING and token.string.startswith('"""'):
            for offset, line in enumerate(token.string.splitlines()):
                yield token.start[0] + offset, line


def labels(path):
    """Labels of a file: number to the dotted names that enclose it; "" is the file itself."""
    inside = defaultdict(set)
    spans = list(owners(ast.parse(path.read_text()))) if path.suffix == ".py" else []
    for line, text in remarks(path):
        for number in numbers(text):
            enclosing = {name for name, first, last in spans if first <= line <= last}
            inside[number] |= enclosing or {""}
    return inside


def labelled():
    files = [*SOURCE.rglob("*.py"), *SOURCE.rglob("*.toml"), *TESTS]
    return {path: found for path in files if (found := labels(path))}


def test_the_index_has_every_number_once_and_in_order():
    listed = [int(name[1:-1]) for name in re.findall(r"^\| (\[\d+\]) \|", PAGE, re.M)]
    assert listed == list(NUMBERS)
    names = {name for name in places() if not name.startswith("[")}
    assert names == {
        *(f"Assumption {i}" for i in (1, 2)),
        *(f"Remark {i}" for i in range(1, 6)),
        "Theorem 1",
        "Corollary 1",
        "Example 1",
        "Example 2",
    }


@pytest.mark.parametrize("number", NUMBERS)
def test_the_label_stands_where_the_index_says(number):
    for file, name in places()[f"[{number}]"]:
        found = labels(path_of(file))
        assert name in found[number], f"[{number}] is not in {file}::{name}"


@pytest.mark.parametrize("number", NUMBERS)
def test_the_equation_is_stated_in_the_section_that_the_index_names(number):
    row = re.search(rf"^\| \[{number}\] \|.*?\]\(#([\w-]+)\)", PAGE, re.M)
    sections = re.split(r"^## (.+)$", PAGE, flags=re.M)
    bodies = dict(zip(sections[1::2], sections[2::2], strict=True))
    (body,) = [text for head, text in bodies.items() if head.lower().replace(" ", "-") == row[1]]
    formulas = re.findall(r"\$\$(.*?)\$\$", body, re.S)
    assert any(f"[{number}]" in formula for formula in formulas)


def test_no_label_stands_where_the_index_does_not_name_it():
    """So that a label that moves, or is wrong, is noticed: here, and where it is missed."""
    allowed = {
        (path_of(file), int(row[1:-1]), name)
        for row, cells in places().items()
        if row.startswith("[")
        for file, name in cells
    }
    for path, found in labelled().items():
        for number, enclosing in found.items():
            assert number in NUMBERS, f"[{number}] in {path}"
            named = any((path, number, name) in allowed for name in enclosing)
            assert named, f"[{number}] in {path}: {enclosing}"


@pytest.mark.parametrize("name", [name for name in places() if not name.startswith("[")])
def test_what_has_a_name_lives_where_the_index_says(name):
    cells = places()[name]
    assert cells
    for file, inner in cells:
        path = path_of(file)
        if inner:
            assert inner in {owner for owner, _, _ in owners(ast.parse(path.read_text()))}


def test_labels_are_told_from_lists_and_subscripts():
    assert numbers("x  # [9], [13], [18]") == {9, 13, 18}
    assert numbers("# [25]: nu") == {25}
    assert numbers("c = [2], row[3], f(x)[4], [5](page.md), A[6][7]") == set()


def test_a_moved_label_is_noticed(tmp_path):
    path = tmp_path / "moved.py"
    path.write_text('"""A module [5]."""\n\ndef other():\n    x = [3]  # [18]\n')
    assert labels(path) == {5: {""}, 18: {"other"}}

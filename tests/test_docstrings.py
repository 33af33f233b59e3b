"""Every example in a docstring runs, and every public function has one."""

import doctest
import inspect
import re
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

import certrack
from certrack.core.compilers import c_compilers

SOURCE = Path(certrack.__file__).parent

#: What works only where there is a C compiler.
NEEDS_C = {"certrack.export.fmu.archive", "certrack.export.c.software_in_the_loop"}


def with_examples():
    """Modules with an example in their text."""
    for path in sorted(SOURCE.rglob("*.py")):
        if re.search(r"^ *>>> ", path.read_text(), re.M):
            parts = path.relative_to(SOURCE.parent).with_suffix("").parts
            yield ".".join(part for part in parts if part != "__init__")


@pytest.mark.parametrize("name", list(with_examples()))
def test_examples_run(name, tmp_path, monkeypatch):
    if name in NEEDS_C and not c_compilers():
        pytest.skip("no C compiler")
    monkeypatch.chdir(tmp_path)  # some examples write files
    results = doctest.testmod(import_module(name))
    assert results.attempted
    assert not results.failed


def sections(value):
    return set(re.findall(r"^(\w+)\n-+$", inspect.getdoc(value) or "", re.M))


def public_functions():
    """Functions of the top level, and of the public rooms whose own page they are."""
    for place in (certrack, certrack.certificates, certrack.plotting):
        for name in place.__all__:
            value = getattr(place, name)
            if inspect.isfunction(value) or hasattr(value, "__wrapped__"):
                yield pytest.param(value, id=f"{place.__name__}.{name}")


@pytest.mark.parametrize("function", list(public_functions()))
def test_public_functions_say_what_they_return_and_show_it(function):
    assert "Examples" in sections(function)
    if inspect.signature(function).return_annotation != "None":
        assert "Returns" in sections(function)
    named = [name for name in inspect.signature(function).parameters if name != "progress"]
    assert not named or "Parameters" in sections(function), "arguments are described"


def test_every_public_class_is_described():
    for name in certrack.__all__:
        value = getattr(certrack, name)
        if not isinstance(value, (ModuleType, str)):
            assert len((inspect.getdoc(value) or "").split()) > 3, name

"""Every command and every program in the documentation runs."""

import dataclasses
import inspect
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from certrack.cli import main
from certrack.core.compilers import c_compilers
from certrack.core.keys import keys_of
from certrack.laws import LAWS
from certrack.laws.observer import Observer
from certrack.laws.online import Online
from certrack.model.implementation import Implementation
from certrack.model.motors import Motors, Supply
from certrack.model.plant import Plant
from certrack.model.population import Population
from certrack.model.truth import Truth
from certrack.model.uncertainty import Uncertainty
from certrack.references.keys import REFERENCE_KINDS
from certrack.systems.documentation import with_comments, with_section
from certrack.systems.keys import KEYS, as_dicts
from certrack.systems.shipped import starter
from certrack.systems.system import Settings, System

ROOT = Path(__file__).parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
#: Their commands or programs take long.
LONG = {
    *("README", "bridges", "certificates", "comparison-of-laws", "deployment", "dossier", "energy"),
    *("ensembles", "friction", "mismatch", "new-law", "observers", "optimal", "python", "ranges"),
    *("reproduction", "sampled", "systems-in-code", "tuning", "tutorial"),
}
PARAMETERS = [
    pytest.param(page, id=page.stem, marks=[pytest.mark.slow] * (page.stem in LONG))
    for page in PAGES
]
#: What works only where there is a C compiler.
NEEDS_C = re.compile(r"export fmu|export\.fmu|--with-c")

#: A file of a page, which its commands find.
NAMED = re.compile(r"# ([\w-]+\.toml)\n")

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)


def unavailable(text):
    return NEEDS_C.search(text) and not c_compilers()


def blocks(page, language):
    return [text for kind, text in BLOCK.findall(page.read_text()) if kind == language]


@pytest.mark.parametrize("page", PARAMETERS)
def test_commands_run_in_order(page, tmp_path, monkeypatch, capfd):
    """In this process: to load certrack anew for each would take longer than most of them."""
    monkeypatch.chdir(tmp_path)
    for kind, block in BLOCK.findall(page.read_text()):
        if kind == "toml" and (name := NAMED.match(block)):
            (tmp_path / name[1]).write_text(block)
        for line in block.splitlines() if kind == "console" else ():
            assert line.startswith("$ certrack "), line
            arguments = shlex.split(line[2:])[1:]
            if (tmp_path / arguments[-1]).exists() and arguments[0] == "new":
                continue
            if unavailable(line):
                continue
            with pytest.raises(SystemExit) as ended:
                main(arguments)
            assert ended.value.code == 0, f"{line}\n{capfd.readouterr().err}"


@pytest.mark.parametrize("page", PARAMETERS)
def test_programs_run(page, tmp_path):
    for text in blocks(page, "python"):
        if unavailable(text):
            continue
        (tmp_path / "test_program.py").write_text(text)
        commands = [[sys.executable, "test_program.py"]]
        if "Conformance" in text:
            commands.append([sys.executable, "-m", "pytest", "-q", "test_program.py"])
        for command in commands:
            done = subprocess.run(
                command, cwd=tmp_path, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_toml_parses_and_links_exist(page):
    for text in blocks(page, "toml"):
        tomllib.loads(text)
    for target in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_what_the_page_says_of_every_key_is_what_the_loader_knows():
    page = (ROOT / "docs" / "system-file.md").read_text()
    assert page == with_section(page), "write it anew: make keys"
    for path, key in KEYS.items():
        assert re.search(rf"\| `{path.rpartition('.')[2]}` \|", page), path
        assert key.help and not key.help.endswith("."), path


def test_every_comment_of_the_starter_file_is_that_of_its_key():
    assert starter() == with_comments(starter()), "write it anew: make keys"
    assert "# length of the run, s\n" in starter()


def test_the_table_of_keys_is_json_and_tells_what_a_form_needs():
    forms = json.loads(json.dumps(as_dicts()))
    assert set(forms) == set(KEYS)
    assert forms["implementation.delay"] == {
        "kind": "number or numbers",
        "help": "from a sample until its input acts; of several a run has the first",
        "unit": "periods",
        "least": 0,
        "most": 100,
        "default": 0,
    }
    assert forms["law[adaptive].c"]["required"] and forms["plant.chain"]["nonzero"]
    assert forms["ensemble.sampling"]["choices"] == ["plain", "latin", "sobol"]


def test_no_field_of_a_table_is_without_its_key():
    without = {  # parts of a system, which are tables of their own
        Plant: {"uncertainty"},
        Truth: {"motors", "supply"},
        System: {"plant", "law", "reference", "truth", "settings", "population", "implementation"},
    }
    for owner in (
        Plant,
        Uncertainty,
        Truth,
        Motors,
        Supply,
        Settings,
        Implementation,
        Population,
        System,
        Observer,
        Online,
    ):
        names = {entry.name for entry in dataclasses.fields(owner)}
        assert names - set(keys_of(owner)) == without.get(owner, set())
    for law in LAWS.values():
        names = {entry.name for entry in dataclasses.fields(law) if entry.init}
        assert names - set(keys_of(law)) == {"observer", "online"}  # tables of their own


@pytest.mark.parametrize("kind", REFERENCE_KINDS)
def test_the_keys_of_a_reference_are_the_arguments_of_its_maker(kind):
    reference = REFERENCE_KINDS[kind]
    arguments = {
        name: argument.default
        for name, argument in inspect.signature(reference.make).parameters.items()
        if argument.kind is argument.POSITIONAL_OR_KEYWORD
    }
    assert set(arguments) == set(reference.keys) - {"file", "columns", "value_unit"}
    for name, default in arguments.items():
        required = default is inspect.Parameter.empty
        assert required == reference.keys[name].required, name
        assert required or default == reference.keys[name].default, name

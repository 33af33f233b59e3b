"""Every command and every program in the documentation runs."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from certrack.core.compilers import c_compilers

ROOT = Path(__file__).parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
#: What works only where there is a C compiler.
NEEDS_C = re.compile(r"export fmu|export\.fmu|--with-c")

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)


def unavailable(text):
    return NEEDS_C.search(text) and not c_compilers()


def blocks(page, language):
    return [text for kind, text in BLOCK.findall(page.read_text()) if kind == language]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_run_in_order(page, tmp_path):
    for block in blocks(page, "console"):
        for line in block.splitlines():
            assert line.startswith("$ certrack "), line
            command = shlex.split(line[2:])
            command[0] = str(Path(sys.executable).with_name("certrack"))
            if (tmp_path / command[-1]).exists() and command[1] == "new":
                continue
            if unavailable(line):
                continue
            done = subprocess.run(
                command, cwd=tmp_path, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, f"{line}\n{done.stderr}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
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


def test_every_system_file_key_is_documented():
    from dataclasses import fields as fields_of

    from certrack.laws import LAWS
    from certrack.systems.reader import (
        IMPLEMENTATION_KEYS,
        PLANT_KEYS,
        POPULATION_KEYS,
        SETTING_KEYS,
        SIGNALS,
        TRUTH_KEYS,
    )

    page = (ROOT / "docs" / "system-file.md").read_text()
    fields = {entry.name for law in LAWS.values() for entry in fields_of(law)}
    signals = {name for _, a, b in SIGNALS.values() for name in (*a, *b)}
    for key in {
        *PLANT_KEYS,
        *TRUTH_KEYS,
        *SETTING_KEYS,
        *POPULATION_KEYS,
        *IMPLEMENTATION_KEYS,
        *fields,
        *signals,
    }:
        assert re.search(rf"[`.]{key}\b", page), key

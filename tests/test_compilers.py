"""One C compiler for all that is compiled, and one clear message for each way in which it fails."""

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from exported import sampled

import certrack
from certrack.core import compilers
from certrack.core.compilers import (
    CompilerError,
    c_compilers,
    find_c_compiler,
    load_library,
    run_compiler,
    shared_library,
)
from certrack.export.c import simulate_with_c
from certrack.export.fmu import fmu
from certrack.integrators.base import MethodUnavailable
from certrack.integrators.many.native import compiled_library

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the false compilers are shell scripts")

SOURCES = {
    "answer.h": "#define ANSWER 42\n",
    "answer.c": '#include "answer.h"\nint a(void) {return ANSWER;}\n',
}
FLAGS = ("-shared", "-fPIC")

#: Compilers that fail, and what is said of them.
FALSE = {
    "broken": (
        "echo 'warm-up' >&2; printf 'a.c:1: error: \\377 wrong\\nmore\\n' >&2; exit 3",
        "failed: a.c:1: error: \ufffd wrong",
    ),
    "silent": ("exit 4", "failed: exit code 4"),
    "lying": ("exit 0", "reported success but wrote no file"),
    "hanging": ("sleep 600 & echo $! > {folder}/sleeper; wait", "took longer than 0.5 s"),
    "wrong": ("shift $(($# - 1)); echo text > $1", "what the C compiler built cannot be loaded: "),
}


@pytest.fixture
def false_compiler(tmp_path, monkeypatch):
    """Makes a shell script the only compiler."""

    def install(kind, name="gcc"):
        folder = tmp_path / "bin"
        folder.mkdir(exist_ok=True)
        script, message = FALSE[kind]
        path = folder / name
        path.write_text(f"#!/bin/sh\n{script.format(folder=folder)}\n")
        path.chmod(0o755)
        for tool in ("sleep", "echo", "printf"):
            (folder / tool).symlink_to(shutil.which(tool))
        monkeypatch.setenv("PATH", str(folder))
        monkeypatch.delenv("CC", raising=False)
        return str(path), message

    return install


def test_a_library_without_the_function_is_no_traceback(tmp_path, monkeypatch):
    """A compiler that builds another program than it was given."""
    real = shutil.which("gcc") or shutil.which("cc")
    if real is None:
        pytest.skip("no C compiler")
    (tmp_path / "other.c").write_text("int other(void) {return 0;}\n")
    built = tmp_path / "other.so"
    subprocess.run([real, "-shared", "-fPIC", tmp_path / "other.c", "-o", built], check=True)
    false = tmp_path / "cc"
    false.write_text(f"#!/bin/sh\nshift $(($# - 1))\ncat {built} > $1\n")
    false.chmod(0o755)
    monkeypatch.setenv("CC", str(false))
    with pytest.raises(CompilerError, match="what the C compiler built has no function "):
        simulate_with_c(sampled("example1"))
    with pytest.raises(MethodUnavailable, match="has no function integrate"):
        compiled_library("many/native.c", "")


def test_a_relative_compiler_is_found_from_another_folder(tmp_path, monkeypatch):
    real = shutil.which("gcc") or shutil.which("cc")
    if real is None:
        pytest.skip("no C compiler")
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "mycc").symlink_to(real)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CC", "tools/mycc")
    assert c_compilers()[0] == str(tmp_path / "tools" / "mycc")
    assert shared_library(SOURCES, FLAGS)


class TestLookup:
    def tool(self, folder, name):
        path = folder / name
        path.write_text("#!/bin/sh\n")
        path.chmod(0o755)
        return str(path)

    def test_order(self, tmp_path, monkeypatch):
        monkeypatch.setenv("PATH", str(tmp_path))
        monkeypatch.delenv("CC", raising=False)
        assert c_compilers() == []
        found = [self.tool(tmp_path, name) for name in ("cc", "clang", "gcc")]
        assert c_compilers() == found[::-1]
        assert find_c_compiler() == found[-1]

    def test_variable_cc(self, tmp_path, monkeypatch):
        monkeypatch.setenv("PATH", str(tmp_path))
        gcc, other = (self.tool(tmp_path, name) for name in ("gcc", "tcc"))
        for value, expected in (
            ("tcc", [other, gcc]),
            (other, [other, gcc]),
            ("gcc", [gcc]),
            ("nothing", [gcc]),
            ("", [gcc]),
        ):
            monkeypatch.setenv("CC", value)
            assert c_compilers() == expected

    def test_the_variable_is_obeyed(self, false_compiler, monkeypatch):
        real = find_c_compiler()
        path, message = false_compiler("broken", "own-cc")
        monkeypatch.setenv(
            "PATH", os.pathsep.join([str(Path(path).parent), str(Path(real).parent)])
        )
        monkeypatch.setenv("CC", "own-cc")
        with pytest.raises(CompilerError) as refused:
            shared_library(SOURCES, FLAGS)
        assert str(refused.value) == f"the C compiler {path} {message}"


class TestRun:
    def test_library(self):
        assert load_library(SOURCES, FLAGS).a() == 42
        assert shared_library(SOURCES, FLAGS)

    def test_none(self, monkeypatch):
        monkeypatch.setenv("PATH", "")
        monkeypatch.delenv("CC", raising=False)
        with pytest.raises(CompilerError) as refused:
            shared_library(SOURCES, FLAGS)
        assert str(refused.value) == "no C compiler was found: install gcc or clang"

    @pytest.mark.parametrize("build", [load_library, shared_library])
    @pytest.mark.parametrize("kind", FALSE)
    def test_false_compilers(self, kind, build, false_compiler, tmp_path):
        path, message = false_compiler(kind)
        begin = time.monotonic()
        with pytest.raises(CompilerError) as refused:
            build(SOURCES, FLAGS, timeout=0.5)
        assert time.monotonic() - begin < 300  # not until the sleeper ends
        said = str(refused.value)
        assert "\n" not in said
        if kind == "wrong":
            assert said.startswith(message)
        else:
            assert said == f"the C compiler {path} {message}"
        if kind == "hanging":  # what it started is gone, too
            assert gone(int((tmp_path / "bin" / "sleeper").read_text()))

    def test_no_program(self, tmp_path):
        path = tmp_path / "gcc"
        path.write_bytes(b"\x7fELF")
        path.chmod(0o755)
        with pytest.raises(CompilerError, match="cannot be run .*: install gcc or clang"):
            run_compiler(["-c"], tmp_path, compiler=str(path))

    def test_nowhere_to_write(self, monkeypatch):
        monkeypatch.setattr(compilers.tempfile, "tempdir", "/nonexistent")
        monkeypatch.setenv("CERTRACK_CACHE", "off")  # what was compiled before needs no such file
        with pytest.raises(CompilerError, match="no temporary files can be written"):
            shared_library(SOURCES, FLAGS)


def gone(process):
    """Whether a process has ended."""
    for _ in range(50):
        done = subprocess.run(["/bin/kill", "-0", str(process)], capture_output=True, check=False)
        state = Path(f"/proc/{process}/stat")
        if done.returncode or (state.exists() and state.read_text().split()[2] == "Z"):
            return True
        time.sleep(0.1)
    return False


def uses():
    """All that is compiled."""
    system = sampled("example1", duration=0.1)
    return {
        "the loop": lambda: simulate_with_c(system),
        "fmu": lambda: fmu(system),
        "ensembles": lambda: certrack.ensemble(system, 1, method="native"),
        "lanes": lambda: compiled_library("many/native.c", ""),
    }


@pytest.mark.parametrize("use", uses())
def test_same_message_for_the_same_problem(use, false_compiler, monkeypatch):
    path, message = false_compiler("broken")
    with pytest.raises(
        (certrack.CertrackError, MethodUnavailable), match="error: \ufffd wrong"
    ) as refused:
        uses()[use]()
    assert f"the C compiler {path} {message}" in str(refused.value)
    monkeypatch.setenv("PATH", "")
    with pytest.raises((certrack.CertrackError, MethodUnavailable)) as refused:
        uses()[use]()
    assert "no C compiler was found: install gcc or clang" in str(refused.value)

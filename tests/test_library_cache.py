"""Compiled libraries on disk: private, checked, bounded, and never in the way."""

import dataclasses
import errno
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from clusters import local_cluster

import certrack
from certrack.cli import main
from certrack.core import compilers, library_cache, library_key
from certrack.core.compilers import c_compilers, load_library, shared_library
from certrack.core.library_cache import CacheUnusable, clear, location, lookup, state, store
from certrack.integrators.many import native as native_module
from certrack.integrators.many.native import vector_compiler

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="nothing is kept on disk"),
    pytest.mark.skipif(not c_compilers(), reason="no C compiler"),
]

KEY, OTHER = "a" * 64, "b" * 64
FLAGS = ("-shared", "-fPIC")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache, on disk and in memory."""
    monkeypatch.setenv("CERTRACK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(compilers, "_LOADED", {})
    native_module._knows_flags.cache_clear()  # that is asked of a compiled library, too
    return tmp_path / "cache" / "libraries"


@pytest.fixture
def compiled(monkeypatch):
    """The compiler's runs so far."""
    runs = []
    real = compilers.run_compiler

    def counting(*args, **kwargs):
        runs.append(args)
        return real(*args, **kwargs)

    monkeypatch.setattr(compilers, "run_compiler", counting)
    return runs


def program(answer):
    return {"answer.c": f"int answer(void) {{return {answer};}}\n"}


def answer_of(number, monkeypatch=None):
    """From a library that is in no memory."""
    if monkeypatch is not None:
        monkeypatch.setattr(compilers, "_LOADED", {})
    return load_library(program(number), FLAGS).answer()


def only_file(folder):
    (path,) = folder.iterdir()
    return path


# what is kept


def test_nothing_is_compiled_twice(folder, compiled, monkeypatch):
    first = load_library(program(1), FLAGS)
    assert load_library(program(1), FLAGS) is first
    assert len(compiled) == 1
    assert answer_of(1, monkeypatch) == 1
    assert len(shared_library(program(1), FLAGS)) == only_file(folder).stat().st_size
    assert len(compiled) == 1
    monkeypatch.setenv("CERTRACK_CACHE", "off")
    assert answer_of(1) == 1
    assert len(compiled) == 2


def test_folder_and_files_are_private(folder):
    before = os.umask(0)
    try:
        assert answer_of(2) == 2
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o777 == 0o700
    assert only_file(folder).stat().st_mode & 0o777 == 0o600


def test_the_oldest_are_dropped(folder, monkeypatch):
    monkeypatch.setattr(library_cache, "MAX_BYTES", 250)
    keys = [f"{i:064x}" for i in range(3)]
    for age, key in zip((30, 20), keys, strict=False):
        store(key, bytes(100))
        (path,) = folder.glob(f"{key}-*")
        os.utime(path, (time.time() - age,) * 2)
    assert lookup(keys[0]) == bytes(100)  # used last
    store(keys[2], bytes(100))
    assert [lookup(key) is not None for key in keys] == [True, False, True]
    store(OTHER, bytes(251))
    assert lookup(OTHER) is None
    assert state().size == 200


def test_what_a_killed_process_left_is_removed(folder):
    store(KEY, b"library")
    left, fresh = folder / f"{'0' * 32}.part", folder / f"{'1' * 32}.part"
    for path in (left, fresh):
        path.write_bytes(b"half")
    os.utime(left, (time.time() - 7200,) * 2)
    store(OTHER, b"library")
    assert not left.exists()
    assert fresh.exists()


# what is not trusted


def refused(folder, compiled, monkeypatch):
    """Whether the next use compiles anew, and is right."""
    before = len(compiled)
    assert answer_of(7, monkeypatch) == 7
    return len(compiled) == before + 1


def another_library(folder, path):
    """Of the same user, under its own key: nothing but its place is wrong."""
    answer_of(8)
    (other,) = set(folder.iterdir()) - {path}
    return other.read_bytes()


def changed_byte(folder, path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    return bytes(data)


def shortened(folder, path):
    return path.read_bytes()[:-1]


def emptied(folder, path):
    return b""


@pytest.mark.parametrize("damage", [changed_byte, another_library, shortened, emptied])
def test_other_contents_are_never_loaded(damage, folder, compiled, monkeypatch):
    assert answer_of(7) == 7
    path = only_file(folder)
    path.write_bytes(damage(folder, path))
    assert refused(folder, compiled, monkeypatch)
    assert not refused(folder, compiled, monkeypatch)  # it was replaced


def test_a_name_with_the_digest_of_another_library_is_not_enough(folder):
    store(KEY, b"right")
    only_file(folder).rename(folder / only_file(folder).name.replace(KEY, OTHER))
    assert lookup(OTHER) is None
    assert lookup(KEY) is None


def as_link(path):
    target = path.with_name("target")
    path.rename(target)
    path.symlink_to(target)


def as_pipe(path):
    path.unlink()
    os.mkfifo(path, 0o600)


@pytest.mark.parametrize(
    "change", [as_link, as_pipe, lambda path: path.chmod(0o620), lambda path: path.chmod(0o602)]
)
def test_links_pipes_and_files_that_others_may_write_are_not_loaded(
    change, folder, compiled, monkeypatch
):
    assert answer_of(7) == 7
    change(only_file(folder))
    assert refused(folder, compiled, monkeypatch)


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701, 0o777])
def test_a_folder_that_others_may_enter_is_not_used(mode, folder, compiled, monkeypatch):
    assert answer_of(7) == 7
    folder.chmod(mode)
    assert refused(folder, compiled, monkeypatch)
    assert state().trouble == "others may enter it (make it private by chmod 700)"
    with pytest.raises(CacheUnusable, match="others may enter it"):
        clear()


def test_a_folder_that_is_a_link_is_not_used(folder, compiled, monkeypatch):
    assert answer_of(7) == 7
    folder.rename(folder.with_name("elsewhere"))
    folder.symlink_to(folder.with_name("elsewhere"))
    assert refused(folder, compiled, monkeypatch)
    assert state().trouble


def test_the_cache_itself_may_lie_behind_a_link(tmp_path, monkeypatch, compiled):
    """As ~/.cache on a large disk."""
    monkeypatch.setattr(compilers, "_LOADED", {})
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    monkeypatch.setenv("CERTRACK_CACHE", str(tmp_path / "link"))
    assert answer_of(7) == 7
    assert not refused(tmp_path, compiled, monkeypatch)


def test_what_belongs_to_another_user_is_not_used(folder, compiled, monkeypatch):
    """Seen from the other side: this process is another user than the one who stored it."""
    assert answer_of(7) == 7
    other = os.geteuid() + 1
    with monkeypatch.context() as patch:
        patch.setattr(library_cache.os, "geteuid", lambda: other)
        assert refused(folder, compiled, patch)
        assert state().trouble == "it belongs to another user"
    if os.geteuid():
        pytest.skip("only root can give files away")
    os.chown(only_file(folder), other, -1)
    assert refused(folder, compiled, monkeypatch)
    os.chown(folder, other, -1)
    assert refused(folder, compiled, monkeypatch)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_root_makes_no_folder_in_a_users_home(tmp_path, monkeypatch):
    os.chown(tmp_path, 12345, -1)
    monkeypatch.delenv("CERTRACK_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    store(KEY, b"library")
    assert not list(tmp_path.iterdir())
    assert state().trouble == f"{tmp_path} belongs to another user"


# where nothing can be kept


def full(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_leaves_nothing_half(folder, compiled, monkeypatch):
    store(OTHER, b"earlier")
    real = os.fdopen

    def fdopen(descriptor, mode):
        file = real(descriptor, mode)
        if "w" in mode:
            file.write = full
        return file

    monkeypatch.setattr(library_cache.os, "fdopen", fdopen)
    assert answer_of(7) == 7
    assert len(compiled) == 1
    assert lookup(OTHER) == b"earlier"
    only_file(folder)


def test_no_library_takes_its_name_before_it_is_whole(folder, monkeypatch):
    monkeypatch.setattr(library_cache.os, "rename", full)
    store(KEY, b"library")
    assert lookup(KEY) is None
    assert not list(folder.iterdir())


@pytest.mark.parametrize("error", [errno.EACCES, errno.EROFS, errno.ENOENT])
def test_an_unwritable_place_is_no_error(error, folder, monkeypatch, capfd):
    def mkdir(*_, **__):
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(Path, "mkdir", mkdir)
    assert answer_of(7) == 7
    assert capfd.readouterr() == ("", "")
    assert not folder.exists()


@pytest.mark.parametrize("place", ["/dev/null", "relative/folder", "~/here"])
def test_places_where_nothing_can_be_kept(place, monkeypatch, capfd):
    monkeypatch.setenv("CERTRACK_CACHE", place)
    assert answer_of(7, monkeypatch) == 7
    assert state().trouble
    assert capfd.readouterr() == ("", "")
    assert not Path(place).is_dir()


def test_where_it_is(tmp_path, monkeypatch):
    monkeypatch.delenv("CERTRACK_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert location() == tmp_path / "certrack" / "libraries"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    inside = "Library/Caches" if sys.platform == "darwin" else ".cache"
    assert location() == tmp_path / "home" / inside / "certrack" / "libraries"
    monkeypatch.setattr(Path, "home", lambda: Path())
    with pytest.raises(CacheUnusable, match="no home folder"):
        location()
    assert state().trouble == "there is no home folder"
    assert answer_of(7, monkeypatch) == 7


@pytest.mark.parametrize("value", ["off", "OFF", "0", "", "none", " no "])
def test_it_can_be_turned_off(value, folder, compiled, monkeypatch):
    monkeypatch.setenv("CERTRACK_CACHE", value)
    for _ in range(2):
        assert answer_of(7) == 7
    assert len(compiled) == 2
    assert not folder.exists()
    assert state().trouble == "turned off by the environment variable CERTRACK_CACHE"


# the key


def key(sources=None, flags=("-O2",), libraries=("-lm",), compiler=None):
    return library_key.library_key(
        sources or program(1), flags, libraries, compiler or c_compilers()[0]
    )


def test_everything_that_matters_is_in_the_key(monkeypatch, tmp_path):
    script = tmp_path / "cc"
    script.write_text("#!/bin/sh\necho version 1 >&2\n")
    script.chmod(0o755)
    keys = [
        key(),
        key(program(2)),
        key({"other.c": program(1)["answer.c"]}),
        key(flags=("-O3",)),
        key(flags=("-O2", "-lm"), libraries=()),
        key(libraries=("-lmvec", "-lm")),
        key(compiler=str(script)),
    ]
    times = script.stat()
    script.write_text("#!/bin/sh\necho version 2 >&2\n")
    os.utime(script, ns=(times.st_atime_ns, times.st_mtime_ns))
    library_key._version.cache_clear()
    keys.append(key(compiler=str(script)))
    assert script.stat().st_mtime_ns == times.st_mtime_ns  # what it says of itself has changed
    os.utime(script, ns=(times.st_atime_ns, times.st_mtime_ns + 1))
    keys.append(key(compiler=str(script)))
    machine = library_key.machine()
    monkeypatch.setattr(library_key, "machine", lambda: (*machine, "avx1024"))
    keys.append(key())
    for name in ("CPATH", "LD_RUN_PATH", "CCC_OVERRIDE_OPTIONS", "NIX_CFLAGS_COMPILE"):
        monkeypatch.setenv(name, "/opt/include")
        keys.append(key())
    assert len(set(keys)) == len(keys)
    assert all(len(entry) == 64 for entry in keys)


CPU = """processor\t: 0
vendor_id\t: GenuineIntel
flags\t\t: fpu avx2 avx512f
cpu MHz\t\t: {frequency}

processor\t: 1
flags\t\t: other
"""


def test_the_processor_is_what_it_can_do(monkeypatch):
    """Another frequency is no other processor; without a list of abilities the name decides."""

    def machine(text, node="one"):
        monkeypatch.setattr(Path, "read_text", lambda *_, **__: text)
        monkeypatch.setattr(library_key.platform, "node", lambda: node)
        return library_key.machine.__wrapped__()

    here = machine(CPU.format(frequency=3000))
    assert here == machine(CPU.format(frequency=800), "two")
    assert here != machine(CPU.format(frequency=3000).replace(" avx512f", ""))
    assert machine("processor: 0\n") != machine("processor: 0\n", "two")


# several processes


RACE = """
import sys
from certrack.core import compilers
from certrack.core.compilers import load_library
sources = {"answer.c": "int answer(void) {return 42;}"}
sys.stdin.readline()
assert load_library(sources, ("-shared", "-fPIC")).answer() == 42
"""


def test_processes_that_compile_the_same_do_no_harm(folder, compiled):
    racers = [
        subprocess.Popen([sys.executable, "-c", RACE], stdin=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for racer in racers:
        racer.stdin.write("go\n")
        racer.stdin.flush()
    assert [racer.wait(60) for racer in racers] == [0, 0, 0]
    for racer in racers:
        racer.stdin.close()
    assert all(library_cache.ENTRY.fullmatch(path.name) for path in folder.iterdir())
    sources = {"answer.c": "int answer(void) {return 42;}"}
    assert load_library(sources, FLAGS).answer() == 42
    assert not compiled


# ensembles

native = pytest.mark.skipif(vector_compiler() is None, reason="needs a C compiler")


def short(**changes):
    return certrack.load("example1").replace(
        settings=dataclasses.replace(certrack.load("example1").settings, duration=1.0, tail=0.5),
        **changes,
    )


def members_of(system, **settings):
    found = certrack.ensemble(system, 64, method="native", threads=1, limit=np.inf, **settings)
    return found.per_member()[0]


@native
def test_cold_warm_and_without_a_cache_are_the_same(folder, monkeypatch, compiled):
    vector_compiler()
    system = short()
    cold = members_of(system)
    monkeypatch.setattr(compilers, "_LOADED", {})
    runs = len(compiled)
    warm = members_of(system)
    assert len(compiled) == runs
    monkeypatch.setenv("CERTRACK_CACHE", "off")
    off = members_of(system)
    assert len(compiled) > runs
    assert np.array_equal(cold, warm, equal_nan=True)
    assert np.array_equal(cold, off, equal_nan=True)


@native
def test_other_numbers_compile_nothing(folder, compiled):
    system = short()
    before, law = members_of(system), system.law
    runs = len(compiled)
    stiffer = short(law=dataclasses.replace(law, c=tuple(1.07 * float(c) for c in law.c)))
    after = members_of(stiffer)
    members_of(stiffer, seed=3)
    members_of(short(truth=dataclasses.replace(system.truth, omega=("0.11*sin(3*t)",) * 2)))
    alone = [certrack.member(stiffer, i) for i in range(2)]
    alone = [certrack.simulate(member, tolerance=1e-10).metrics.rms_error for member in alone]
    rms = certrack.studies.ensembles.plan.METRICS.index("rms_error")
    assert after[rms, :2] == pytest.approx(alone, rel=1e-5)
    assert abs(after[rms] / before[rms] - 1).max() > 1e-3
    assert len(compiled) == runs


NO_COMPILER = """
from certrack.core import compilers

def refuse(*_, **__):
    raise AssertionError("compiled again")

compilers.run_compiler = refuse
"""


@native
@pytest.mark.slow
def test_another_process_compiles_nothing(folder):
    lines = [
        NO_COMPILER,
        "import certrack",
        "found = certrack.ensemble(certrack.load('example1'), 64, method='native', threads=1)",
        "print(found.per_member()[0].sum().hex())",
    ]
    here = certrack.ensemble(certrack.load("example1"), 64, method="native", threads=1)
    there = subprocess.check_output([sys.executable, "-c", "\n".join(lines)], text=True)
    assert there.strip() == here.per_member()[0].sum().hex()


@native
@pytest.mark.slow
def test_workers_of_a_cluster_compile_nothing(folder):
    """Each has a memory of its own; they share the disk."""
    from distributed import Client

    system = certrack.load("example1")
    here = certrack.ensemble(system, 512, seed=5, method="native", limit=np.inf)
    with local_cluster(2) as cluster, Client(cluster) as client:
        client.run(exec, NO_COMPILER, {})
        there = certrack.ensemble(
            system, 512, seed=5, method="native", limit=np.inf, chunk=64, client=client
        )
    assert np.array_equal(here.per_member()[0], there.per_member()[0], equal_nan=True)


# the command line


def run(capfd, *arguments):
    with pytest.raises(SystemExit) as end:
        main(["cache", *arguments])
    return end.value.code, *capfd.readouterr()


def test_the_command_shows_and_clears(folder, capfd):
    code, out, _ = run(capfd)
    assert (code, out) == (0, f"0 compiled libraries, 0.00 MB of at most 64 MB, in {folder}\n")
    store(KEY, bytes(2**19))
    (folder / "notes.txt").write_text("mine")
    code, out, _ = run(capfd, "--json")
    assert (json.loads(out)["libraries"], json.loads(out)["bytes"]) == (1, 2**19)
    code, out, _ = run(capfd)
    assert out == f"1 compiled library, 0.50 MB of at most 64 MB, in {folder}\n"
    code, out, _ = run(capfd, "--clear")
    assert (code, out) == (0, f"1 compiled library (0.50 MB) removed from {folder}\n")
    assert only_file(folder).read_text() == "mine"
    folder.chmod(0o755)
    code, out, err = run(capfd, "--clear")
    assert (code, out) == (2, "")
    assert err == f"certrack: {folder}: others may enter it (make it private by chmod 700)\n"


def test_the_command_says_why_nothing_is_kept(capfd, monkeypatch):
    monkeypatch.setenv("CERTRACK_CACHE", "off")
    code, out, _ = run(capfd)
    assert (code, out) == (
        0,
        "Not used: turned off by the environment variable CERTRACK_CACHE\n",
    )
    assert json.loads(run(capfd, "--json")[1])["place"] is None

"""Files appear whole or not at all, whatever goes wrong and wherever."""

import errno
import os
import resource
import stat
import sys

import numpy as np
import pytest
import xarray

import certrack
from certrack.core import files
from certrack.core.errors import InputError
from certrack.export.c.export import write_all
from certrack.plotting import save_figure

linux = pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
DATASET = xarray.Dataset({"x": ("time", np.arange(50_000.0))})


def picture():
    from matplotlib.figure import Figure

    figure = Figure()
    figure.subplots().plot([0, 1])
    return figure


#: Every way to write a file, and the name that it gets.
WRITERS = {
    "text": ("a.toml", lambda path: files.write_text(path, "abc")),
    "bytes": ("a.fmu", lambda path: files.write_bytes(path, b"abc")),
    "netcdf": ("a.nc", lambda path: files.write_netcdf(path, DATASET)),
    "folder": ("a.c", lambda path: files.write_folder(path.parent, {"b": b"1", "a.c": "2"})),
    "figure": ("a.svg", lambda path: save_figure(picture(), path.parent, "a")),
    "system": ("a.toml", lambda path: certrack.save(certrack.load("example1"), path)),
    "export": ("a.c", lambda path: write_all(path.parent, {"a.c": "1", "b.h": "2"})),
}


@pytest.fixture(params=WRITERS)
def writer(request):
    return WRITERS[request.param]


def full(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("call", ["replace", "fsync"])
def test_a_full_disk_leaves_everything_as_it_was(tmp_path, monkeypatch, writer, call):
    name, write = writer
    (tmp_path / name).write_text("before")
    monkeypatch.setattr(os, call, full)
    with pytest.raises(InputError) as refused:
        write(tmp_path / name)
    monkeypatch.undo()
    assert str(tmp_path) in str(refused.value)
    assert str(refused.value).endswith(
        "cannot be written (No space left on device). Make room or choose another place"
    )
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "before"


@pytest.mark.parametrize("new", ["a", "b", ""])
def test_a_second_name_that_fails_puts_the_first_file_back(tmp_path, monkeypatch, new):
    before = {name: f"before {name}" for name in ("a", "b") if name != new}
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    replace, calls = os.replace, []

    def fails_at_second(source, target):
        calls.append(target)
        if len(calls) == 2:
            full()
        replace(source, target)

    monkeypatch.setattr(os, "replace", fails_at_second)
    with pytest.raises(InputError, match="No space left"):
        files.write_folder(tmp_path, {"a": "1", "b": "2"})
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


@linux
@pytest.mark.parametrize("room", [0, 100_000])
@pytest.mark.parametrize(
    ("name", "write", "data"),
    [("a", files.write_bytes, bytes(200_000)), ("a.nc", files.write_netcdf, DATASET)],
    ids=["bytes", "netcdf"],
)
def test_a_write_that_breaks_off_midway(tmp_path, name, write, data, room):
    """The operating system itself refuses, also deep inside HDF5."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(InputError, match=r"cannot be written \(File too large\)"):
            write(tmp_path / name, data)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())


def test_an_interruption_leaves_nothing(tmp_path, monkeypatch, writer):
    name, write = writer

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / name)
    assert not list(tmp_path.iterdir())


@linux
def test_a_folder_that_cannot_be_written(writer):
    name, write = writer
    with pytest.raises(InputError, match=r"/proc/.*cannot be written \(.*\)\. [A-Z]"):
        write(files.Path("/proc/nowhere") / name)


def test_a_file_where_a_folder_should_be(tmp_path, writer):
    name, write = writer
    (tmp_path / "file").write_text("before")
    with pytest.raises(InputError, match="cannot be"):
        write(tmp_path / "file" / name)
    assert (tmp_path / "file").read_text() == "before"


def test_a_folder_of_the_name_stays(tmp_path, writer):
    name, write = writer
    (tmp_path / name).mkdir()
    with pytest.raises(InputError, match=f"cannot be written.*{name} is a folder"):
        write(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_is_not_replaced(tmp_path, writer):
    name, write = writer
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="not a file but a device or a pipe"):
        write(tmp_path / name)
    assert stat.S_ISFIFO((tmp_path / name).stat().st_mode)


def test_a_link_to_a_folder_is_followed(tmp_path, writer):
    name, write = writer
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    write(tmp_path / "link" / name)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / name).stat().st_size
    assert not list((tmp_path / "real").glob("*.part"))


def test_a_link_laid_at_the_temporary_name_is_refused(tmp_path, monkeypatch, writer):
    """Even where somebody guesses the name, nothing is written through the link."""
    name, write = writer
    victim = tmp_path / "victim"
    victim.write_text("before")
    monkeypatch.setattr(files.secrets, "token_hex", lambda _count: "guessed")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".certrack-guessed.part").symlink_to(victim)
    with pytest.raises(InputError, match="File exists"):
        write(tmp_path / "out" / name)
    assert victim.read_text() == "before"


def test_temporary_names_differ(tmp_path, monkeypatch):
    names = []
    monkeypatch.setattr(os, "replace", lambda temporary, _path: names.append(temporary.name))
    for _ in range(20):
        files.write_bytes(tmp_path / "a", b"")
    assert len(set(names)) == 20


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_permissions_are_those_of_any_new_file(tmp_path, writer, mask):
    name, write = writer
    before = os.umask(mask)
    try:
        write(tmp_path / name)
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / name).stat().st_mode) == 0o666 & ~mask


def test_several_files_appear_together(tmp_path, monkeypatch):
    """The last of them is on the disk before the first one appears."""
    synced, fsync = [], os.fsync

    def last_fails(number):
        synced.append(number)
        return full() if len(synced) == 3 else fsync(number)

    monkeypatch.setattr(os, "fsync", last_fails)
    with pytest.raises(InputError):
        files.write_folder(tmp_path / "a" / "b", dict.fromkeys("xyz", "text"))
    assert not list(tmp_path.iterdir())  # the folders neither


def test_what_is_written_is_what_was_given(tmp_path):
    files.write_text(tmp_path / "text", "é\n")
    assert (tmp_path / "text").read_bytes() == b"\xc3\xa9\n"
    files.write_bytes(tmp_path / "text", b"other")
    assert (tmp_path / "text").read_bytes() == b"other"
    files.write_netcdf(tmp_path / "a.nc", DATASET)
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as stored:
        assert stored.identical(DATASET)
    paths = files.write_folder(tmp_path / "new" / "one", {"a": "1", "b": b"2"})
    assert [path.read_text() for path in paths] == ["1", "2"]


def test_an_existing_file_may_be_protected(tmp_path):
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("file", "link"):
        if name == "file":
            files.write_text(tmp_path / name, "1", overwrite=False)
        with pytest.raises(InputError, match="exists already"):
            files.write_text(tmp_path / name, "2", overwrite=False)
    assert (tmp_path / "file").read_text() == "1"
    assert (tmp_path / "link").is_symlink()

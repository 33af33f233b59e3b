"""Folders of ensembles: whatever is wrong with a file, its members are computed again."""

import io
import os
import subprocess
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from filelock import FileLock
from test_ensembles import identical

import certrack
from certrack.core.errors import InputError
from certrack.studies.ensembles import checkpoints as module
from certrack.studies.ensembles.checkpoints import LOCK_NAME, Checkpoints
from certrack.studies.ensembles.engine import Engine
from certrack.studies.ensembles.plan import make_plan
from certrack.studies.ensembles.stored import (
    _Unusable,
    check_arrays,
    digest,
    read_arrays,
    sealed,
)

SPANS = ((0, 12), (12, 24))
NAME = "chunk-0000000012-0000000024.npz"


@pytest.fixture(scope="module")
def plan():
    system = certrack.load("dual-motor-lean").with_settings(duration=0.5, tail=None)
    system = system.replace(population=replace(system.varied, points=8))
    return make_plan(system, 1, 1e-6, 0.05, "alone", per_member=True)


@pytest.fixture(scope="module")
def honest(plan):
    engine = Engine(plan)
    return {span: engine.compute(*span) for span in SPANS}


@pytest.fixture
def folder(tmp_path, plan, honest):
    with Checkpoints(tmp_path, plan) as checkpoints:
        for span, statistics in honest.items():
            checkpoints.save(span, statistics.packed())
    return tmp_path


def covered(folder, plan):
    """The members that a folder still has, and the number that was counted."""
    total = plan.empty()
    with Checkpoints(folder, plan) as checkpoints:
        spans = checkpoints.load(total, 24)
    assert total.members == sum(end - begin for begin, end in spans)
    return spans


def test_what_was_written_is_read(folder, plan, honest):
    assert covered(folder, plan) == list(SPANS)
    total = plan.empty()
    with Checkpoints(folder, plan) as checkpoints:
        checkpoints.load(total, 24)
    expected = plan.empty()
    for statistics in honest.values():
        expected.merge(statistics)
    for name, array in expected.packed().items():
        np.testing.assert_array_equal(total.packed()[name], array, err_msg=name)


def with_entry(data, flags=0, method=0):
    """An archive whose entries say that they are encrypted, or packed by some method."""
    changed = bytearray(data)
    for mark, at_flags, at_method in ((b"PK\x01\x02", 8, 10), (b"PK\x03\x04", 6, 8)):
        i = changed.find(mark)
        while i >= 0:
            changed[i + at_flags] |= flags
            changed[i + at_method] = method
            i = changed.find(mark, i + 4)
    return bytes(changed)


def archive(arrays, kind=zipfile.ZIP_STORED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", kind) as file:
        for name, data in arrays.items():
            file.writestr(f"{name}.npy", data)
    return buffer.getvalue()


def npy(shape, kind="<f8", body=b""):
    """An array file that claims a shape and a type."""
    header = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    header += b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + body


DEFLATED = zipfile.ZIP_DEFLATED


class Bomb:
    def __reduce__(self):
        return os.abort, ()


#: What may stand in place of a file, made from its bytes.
FILES = {
    "empty": lambda data: b"",
    "torn": lambda data: data[:-10],
    "half": lambda data: data[: len(data) // 2],
    "noise": lambda data: os.urandom(5000),
    "text": lambda data: b"hello",
    "an empty archive": lambda data: b"PK\x05\x06" + b"\0" * 18,
    "encrypted": lambda data: with_entry(data, flags=1),
    "packed by deflate64": lambda data: with_entry(data, method=9),
    "packed by lzma": lambda data: with_entry(data, method=14),
    "one bit": lambda data: data[:5000] + bytes([data[5000] ^ 1]) + data[5001:],
    "pickle": lambda data: archive({"bins": pickled()}),
    "a bomb": lambda data: archive(
        {"bins": npy((10**8,), body=bytes(10**8))}, zipfile.ZIP_DEFLATED
    ),
    "a huge shape": lambda data: archive({"bins": npy((10**12,))}),
    "a larger shape": lambda data: archive({"bins": npy((2**63 - 1,))}),
    "a negative shape": lambda data: archive({"bins": npy((-1,))}),
    "objects": lambda data: archive({"bins": npy((1,), "|O", bytes(8))}),
    "no type": lambda data: archive({"bins": npy((1,), "zz")}),
    "an array of others": lambda data: archive({"../bins": npy((1,), body=bytes(8))}),
    "an array twice": lambda data: twice(data),
}


def pickled():
    buffer = io.BytesIO()
    np.save(buffer, np.array([Bomb()], dtype=object), allow_pickle=True)
    return buffer.getvalue()


def twice(data):
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        arrays = [(entry.filename, file.read(entry)) for entry in file.infolist()]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for name, content in [*arrays, arrays[0]]:
            file.writestr(name, content)
    return buffer.getvalue()


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("change", FILES.values(), ids=FILES)
@pytest.mark.parametrize("name", [NAME, "merged.npz"])
def test_a_file_that_is_none_is_computed_again(folder, plan, name, change):
    data = change((folder / NAME).read_bytes())
    (folder / name).write_bytes(data)
    assert covered(folder, plan) == [span for span in SPANS if name != NAME or span != (12, 24)]


def test_a_folder_pipe_or_link_in_place_of_a_file(folder, plan, tmp_path):
    (folder / NAME).unlink()
    (folder / NAME).mkdir()
    os.mkfifo(folder / "merged.npz")  # reading it would never end
    (folder / "chunk-0000000024-0000000036.npz").symlink_to(folder / "nowhere")
    assert covered(folder, plan) == [SPANS[0]]


def changes(statistics):
    """Arrays with one thing wrong each, by what is wrong."""
    good = statistics.packed()
    edited: dict[str, dict] = {}

    def put(what, **arrays):
        edited[what] = good | arrays

    for name, array in good.items():
        edited[f"{name} missing"] = {key: value for key, value in good.items() if key != name}
        put(f"{name} as text", **{name: np.array(["a"] * array.size)})
        put(f"{name} as complex", **{name: np.ones(array.shape, complex)})
        put(f"{name} as scalar", **{name: array.ravel()[0] if array.size else np.array(1)})
        put(f"{name} as times", **{name: np.zeros(array.shape, "M8[s]")})
        put(f"{name} one more", **{name: np.append(array, array[-1:], axis=0)})
        put(f"{name} one less", **{name: array[:-1]})
        put(f"{name} in rows", **{name: array[None]})
        if array.dtype.kind != "U":
            for value in (-7, 0, 2**30, np.nan, np.inf):
                with np.errstate(invalid="ignore"):
                    other = array.copy()
                    other.flat[-1] = np.array(value).astype(array.dtype)
                if not np.array_equal(other, array, equal_nan=array.dtype.kind == "f"):
                    put(f"{name} ends with {value}", **{name: other})
        put(f"{name} reversed", **{name: array[::-1]}) if len(
            set(array.ravel().tolist())
        ) > 1 else None
    put("an outcome nobody knows", outcomes=np.array(["won"] * len(good["outcomes"])))
    return edited


def test_sealed_anew_every_field_is_checked_all_the_same(plan, honest):
    """A forger makes the digest anew: type, shape, range and agreement of the fields remain."""
    accepted = []
    for what, arrays in changes(honest[12, 24]).items():
        try:
            check_arrays(read_arrays(sealed(arrays, [(12, 24)], "")), plan, [(12, 24)])
        except (_Unusable, ValueError, KeyError):
            continue
        accepted.append(what)
    assert accepted == []
    check_arrays(read_arrays(sealed(honest[12, 24].packed(), [], "")), plan, [(12, 24)])


@pytest.mark.parametrize(
    "ranges", [[(0, 12)], [(12, 25)], [(12, 18), (18, 24)], [(24, 12)], [(-12, 0)], []]
)
def test_the_members_are_those_of_the_name(folder, plan, honest, ranges):
    with Checkpoints(folder, plan) as checkpoints:
        run = checkpoints._run
    (folder / NAME).write_bytes(sealed(honest[12, 24].packed(), ranges, run))
    assert covered(folder, plan) == [(0, 12)]


@pytest.mark.parametrize(
    "ranges",
    [[(0, 12), (6, 18)], [(12, 24), (0, 12)], [(0, 24)], [(0, 2**40)], [(0, 12), (12, 12)]],
)
def test_a_merged_file_of_impossible_members(folder, plan, honest, ranges):
    with Checkpoints(folder, plan) as checkpoints:
        run = checkpoints._run
    for path in folder.glob("chunk-*"):
        path.unlink()
    total = plan.empty()
    total.merge(honest[12, 24])
    (folder / "merged.npz").write_bytes(sealed(total.packed(), ranges, run))
    assert covered(folder, plan) == []


def test_a_chunk_of_another_ensemble_is_not_taken(folder, plan, honest):
    """Same shapes, other numbers: the digest binds a file to what is run."""
    other = replace(plan, seed=2)
    (folder / NAME).write_bytes(
        sealed(honest[12, 24].packed(), [(12, 24)], Checkpoints(folder, other)._run)
    )
    assert covered(folder, plan) == [(0, 12)]


def test_what_is_changed_without_the_digest_is_named():
    arrays = {"bins": np.arange(3, dtype=np.uint32)}
    assert not np.array_equal(digest(arrays, "a"), digest(arrays, "b"))
    assert not np.array_equal(digest(arrays, "a"), digest({"bins": arrays["bins"][::-1]}, "a"))
    with pytest.raises(_Unusable, match="nobody knows"):
        read_arrays(archive({"x": npy((0,))}))


@pytest.mark.parametrize("names", ["chunk-1-2.npz", "chunk-0000000024-0000000012.npz"])
def test_other_names_are_not_looked_at(folder, plan, names):
    (folder / names).write_bytes((folder / NAME).read_bytes())
    assert covered(folder, plan) == list(SPANS)


@pytest.mark.parametrize("content", [b"\xff\xfe", b"", b"# certrack", b"\0" * 10**6])
def test_a_manifest_of_something_else_is_refused(folder, plan, content):
    (folder / "ensemble.toml").write_bytes(content)
    with pytest.raises(InputError, match="holds another ensemble"):
        covered(folder, plan)


def test_another_revision_of_the_method_is_refused(folder, plan, monkeypatch):
    assert f"method alone, revision {module.REVISION}" in (folder / "ensemble.toml").read_text()
    monkeypatch.setattr(module, "REVISION", module.REVISION + 1)
    with pytest.raises(InputError, match="revision of the method or version differs"):
        covered(folder, plan)


def test_a_second_process_is_refused_and_the_first_goes_on(folder, plan):
    held = FileLock(folder / LOCK_NAME)
    with held, pytest.raises(InputError) as refused:
        covered(folder, plan)
    assert str(refused.value) == (
        f"{folder}: another process computes into it. Wait until it has ended or choose another "
        "--out"
    )
    assert covered(folder, plan) == list(SPANS)


def test_a_lock_that_a_killed_process_left_does_not_count(folder, plan):
    """The system lets go of it with the process, whatever remains of the file."""
    program = (
        "import os, signal, sys, filelock; filelock.FileLock(sys.argv[1]).acquire(); "
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", program, folder / LOCK_NAME], check=False)
    assert covered(folder, plan) == list(SPANS)


def test_without_locks_it_works_all_the_same(folder, plan, monkeypatch):
    def none(*_, **__):
        raise NotImplementedError("no locks here")

    monkeypatch.setattr(FileLock, "acquire", none)
    assert covered(folder, plan) == list(SPANS)


def test_the_lock_ends_with_the_call(tmp_path):
    system = certrack.load("dual-motor-lean").with_settings(duration=0.1, tail=None)
    first = certrack.ensemble(system, 16, method="lockstep", out=tmp_path)
    again = certrack.ensemble(system, 16, method="lockstep", out=tmp_path)
    assert again.computed == 0
    identical(first, again)

    class Stopped(Exception):
        pass

    def stop(done, *_):
        if done:
            raise Stopped

    with pytest.raises(Stopped):
        certrack.ensemble(system, 24, method="lockstep", out=tmp_path, progress=stop)
    with FileLock(tmp_path / LOCK_NAME, timeout=0):
        pass

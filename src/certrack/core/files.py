"""Files that appear whole or not at all.

Data go to a temporary file in the target's folder, reach the disk, and then take the target's name
in one step. Whatever goes wrong before that step, an earlier file of the name stays as it was and
no temporary file is left. The temporary name is random and must be free, so that neither another
process nor a symbolic link laid in advance can divert what is written.
"""

from __future__ import annotations

import errno
import io
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from certrack.core.errors import InputError

if TYPE_CHECKING:
    import xarray

#: What the user can do about the causes that have a remedy of their own.
REMEDIES = {
    errno.ENOSPC: "Make room or choose another place",
    errno.EDQUOT: "Make room or choose another place",
    errno.ENOENT: "Make its folder or choose another place",
    errno.ENAMETOOLONG: "Choose a shorter name",
}


def write_text(path: Path, text: str, *, overwrite: bool = True) -> None:
    """Write a text file (UTF-8) whole or not at all.

    Raises
    ------
    InputError
        If it exists and must not be overwritten, or cannot be written.
    """
    if not overwrite and os.path.lexists(path):
        raise InputError(str(path), "exists already", remedy="Choose another name")
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file whole or not at all.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    try:
        write_whole(path, data)
    except OSError as problem:
        raise _refusal(path, problem) from None


def require_place(path: Path) -> None:
    """Refuse, before something long is computed, what could not be written in the end.

    Raises
    ------
    InputError
        If no file can take this name now.
    """
    try:
        _require_replaceable(path)
        with _temporary_file(path.parent):
            pass
    except OSError as problem:
        raise _refusal(path, problem) from None


def write_whole(path: Path, data: bytes | memoryview) -> None:
    """Write a file whole or not at all, for callers that have an error message of their own.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    _require_replaceable(path)
    with _temporary_file(path.parent) as temporary:
        _fill(temporary, data)
        os.replace(temporary, path)  # noqa: PTH105


def write_folder(folder: Path, contents: Mapping[str, str | bytes]) -> tuple[Path, ...]:
    """Write several files of a folder, all or none as far as errors go; returns their paths.

    Everything is on the disk before the first file takes its name, and the earlier files are
    copied aside. Where a file then cannot take its name, those that had are put back or removed; if
    even that fails, or the process is killed between two names, the folder may hold files of
    both sets, each of them whole.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    contents : mapping
        Text (UTF-8) or bytes by file name.

    Raises
    ------
    InputError
        If the folder cannot be made or a file cannot be written.
    """
    paths = tuple(folder / name for name in contents)
    missing: list[Path] = []
    try:
        missing += [place for place in (folder, *folder.parents) if not place.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        for path in paths:
            _require_replaceable(path)
        with ExitStack() as stack:
            temporaries = [stack.enter_context(_temporary_file(folder)) for _ in paths]
            for temporary, data in zip(temporaries, contents.values(), strict=True):
                _fill(temporary, data.encode() if isinstance(data, str) else data)
            earlier = [stack.enter_context(_copy_aside(path)) for path in paths]
            _take_names(temporaries, paths, earlier)
    except BaseException as problem:
        for place in missing:
            with suppress(OSError):
                place.rmdir()
        if isinstance(problem, OSError):
            raise _refusal(folder, problem) from None
        raise
    return paths


def write_netcdf(path: Path, dataset: xarray.Dataset) -> None:
    """Write a dataset as NetCDF, whole or not at all.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    import h5netcdf  # type: ignore[import-untyped]
    from xarray.backends import H5NetCDFStore

    image = io.BytesIO()  # HDF5 crashes the process where the disk of its file is full
    with h5netcdf.File(image, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    write_bytes(path, image.getbuffer())


def read_netcdf(path: Path) -> xarray.Dataset:
    """A dataset of a NetCDF file, read into memory.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    import xarray

    try:
        with xarray.open_dataset(path, engine="h5netcdf") as dataset:
            return dataset.load()
    except (OSError, ValueError, KeyError) as problem:
        reason = getattr(problem, "strerror", None) or "it is no NetCDF file"
        raise InputError(str(path), f"cannot be read ({reason})") from None


@contextmanager
def _temporary_file(folder: Path) -> Iterator[Path]:
    """An empty file of our own, with the permissions of any new file; removed if not moved."""
    path = folder / f".certrack-{secrets.token_hex(8)}.part"
    path.open("xb").close()  # exclusive: an existing file or link of that name is an error
    try:
        yield path
    finally:
        with suppress(OSError):  # what made the write fail says more
            path.unlink(missing_ok=True)


@contextmanager
def _copy_aside(path: Path) -> Iterator[Path | None]:
    """A copy of what a path holds, for a while; None if it holds nothing."""
    if not os.path.lexists(path):
        yield None
        return
    copy = path.parent / f".certrack-{secrets.token_hex(8)}.part"
    try:
        shutil.copy2(path, copy, follow_symlinks=False)
        yield copy
    finally:
        with suppress(OSError):
            copy.unlink(missing_ok=True)


def _take_names(
    temporaries: Sequence[Path], paths: Sequence[Path], earlier: Sequence[Path | None]
) -> None:
    """Give every temporary file its name, or put back what these names held."""
    done = 0
    try:
        for temporary, path in zip(temporaries, paths, strict=True):
            os.replace(temporary, path)  # noqa: PTH105
            done += 1
    except BaseException:
        for path, copy in zip(paths[:done], earlier[:done], strict=True):
            with suppress(OSError):
                if copy is None:
                    path.unlink()
                else:
                    os.replace(copy, path)  # noqa: PTH105
        raise


def _fill(path: Path, data: bytes | memoryview) -> None:
    """Write the contents and wait for the disk, so that a power failure leaves no empty file."""
    with path.open("r+b") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _require_replaceable(path: Path) -> None:
    """Refuse what a file must not take the place of."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, f"{path.name} is a folder")
    if path.exists() and not path.is_file():
        raise FileExistsError(errno.EEXIST, f"{path.name} is not a file but a device or a pipe")


def _refusal(path: Path, problem: OSError) -> InputError:
    reason = problem.strerror or str(problem)
    remedy = REMEDIES.get(problem.errno or 0, "Choose another place")
    return InputError(str(path), f"cannot be written ({reason})", remedy=remedy)

"""Write the statistics of members to a file, and believe nothing of what is read back.

The file may be torn, of another ensemble, or made to do harm. So it is read without pickle and
without decompression; a digest binds its arrays to the members and to what is run; every array must
have its type and shape; and the numbers must agree with each other: every table counts every member
once, and where the metrics of single members are kept, all else is counted again from them.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from certrack.integrators.base import Outcome
from certrack.model.sampling import MAX_MEMBERS
from certrack.studies.ensembles.corners import MAX_RANGES
from certrack.studies.ensembles.plan import METRICS, Plan, Range
from certrack.studies.ensembles.statistics import (
    BAND_BINS,
    WORST_MEMBERS,
    Bands,
    Statistics,
    Tally,
)

#: Arrays of a file: kind of their numbers and number of dimensions.
ARRAYS: dict[str, tuple[str, int]] = {
    "bins": ("u4", 1),
    "counts": ("u4", 1),
    "totals": ("i8", 1),
    "outcomes": ("U", 1),
    "outcome_counts": ("i8", 1),
    "worst": ("f8", 1),
    "worst_members": ("i8", 1),
    **{f"{name}_keys": ("i8", 1) for name in METRICS},
    **{f"{name}_counts": ("i8", 1) for name in METRICS},
    **{f"{name}_extremes": ("f8", 1) for name in METRICS},
}

#: Of a file that keeps the metrics of single members.
TABLE_ARRAYS = {
    "table_parts": ("i8", 2),
    "table_metrics": ("f8", 2),
    "table_outcomes": ("i1", 1),
}

#: Which members are counted, and what binds all arrays together.
SEALS = {"ranges": ("i8", 2), "digest": ("u1", 1)}

#: Bytes of a file besides those of the bands and the members, and of a member that is kept.
MAX_OVERHEAD, BYTES_PER_MEMBER = 10_000_000, 100

#: A merged file with the metrics of more members is not read again.
MAX_MERGED_MEMBERS = 10_000_000

#: Longest name of an outcome.
MAX_OUTCOME_LENGTH = max(len(outcome.name) for outcome in Outcome)


class _Unusable(ValueError):
    """A file that does not hold what it should; its members are computed again."""


def sealed(statistics: Mapping[str, np.ndarray], ranges: Sequence[Range], run: str) -> bytes:
    """The contents of a file.

    Parameters
    ----------
    statistics : mapping
        Packed.
    ranges : pairs (begin, end)
        Members that they count.
    run : str
        What is run.
    """
    arrays = {**statistics, "ranges": np.array(ranges, dtype=np.int64).reshape(-1, 2)}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays, digest=digest(arrays, run))  # type: ignore[arg-type]
    return buffer.getvalue()


def digest(arrays: Mapping[str, np.ndarray], run: str) -> np.ndarray:
    """SHA-256 of named arrays and of what is run."""
    state = hashlib.sha256(run.encode())
    for name in sorted(set(arrays) - {"digest"}):
        array = arrays[name]
        state.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        state.update(np.ascontiguousarray(array).tobytes())
    return np.frombuffer(state.digest(), np.uint8)


def read_stored(
    path: Path, plan: Plan, run: str, span: Range | None = None
) -> tuple[Statistics, list[Range]]:
    """The statistics in a file of `plan`, and the members that they count.

    Parameters
    ----------
    path : path
    plan : Plan
    run : str
        What is run.
    span : (begin, end), optional
        The members of a chunk; a merged file says its own.

    Raises
    ------
    Exception
        Of any kind, if anything is wrong with the file.
    """
    require(path.is_file(), "no file")
    begin, end = span or (0, MAX_MERGED_MEMBERS)
    largest = plan.centre.size * BAND_BINS * 8 + BYTES_PER_MEMBER * (end - begin) + MAX_OVERHEAD
    with path.open("rb") as stream:
        data = stream.read(largest + 1)
    require(len(data) <= largest, "the file is too long")
    arrays = read_arrays(data)
    ranges = _ranges(arrays)
    require(span is None or ranges == [span], "members of another chunk")
    require(np.array_equal(digest(arrays, run), arrays["digest"]), "the arrays were changed")
    check_arrays(arrays, plan, ranges)
    statistics = plan.empty()
    statistics.add_packed(arrays)
    return statistics, ranges


def read_arrays(data: bytes) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz`` file that is not compressed."""
    known = ARRAYS | TABLE_ARRAYS | SEALS
    arrays: dict[str, np.ndarray] = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        require(len(entries) <= len(known), "too many arrays")
        require(sum(entry.file_size for entry in entries) <= len(data), "it is compressed")
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            require(name in known and name not in arrays, "an array that nobody knows")
            require(entry.compress_type == zipfile.ZIP_STORED, "it is compressed")
            arrays[name] = _array(archive.read(entry), *known[name])
    return arrays


def _array(data: bytes, kind: str, dimensions: int) -> np.ndarray:
    """The array of an ``.npy`` file, if it is what it should be."""
    stream = io.BytesIO(data)
    require(np.lib.format.read_magic(stream) == (1, 0), "an unknown version")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    is_right = (dtype.kind == "U" and kind == "U") or dtype == np.dtype(kind)
    require(is_right and len(shape) == dimensions, "an array of another type")
    body = data[stream.tell() :]
    count = 1
    for length in shape:
        require(length >= 0, "a negative length")
        count *= length
    require(count * dtype.itemsize == len(body), "an array of another length")
    return np.frombuffer(body, dtype).reshape(shape, order="F" if by_columns else "C").copy()


def check_arrays(arrays: Mapping[str, np.ndarray], plan: Plan, ranges: Sequence[Range]) -> None:
    """Refuse arrays that cannot be the statistics of these members.

    Raises
    ------
    _Unusable
    """
    members = sum(end - begin for begin, end in ranges)
    require(set(arrays) >= set(ARRAYS), "an array is missing")
    _check_bands(arrays, plan, members)
    violations = _check_totals(arrays, plan, members)
    _check_outcomes(arrays, members)
    for name in METRICS:
        _check_metric(name, arrays, members)
    _check_worst(arrays, plan, ranges, violations)
    if plan.per_member:
        require(set(arrays) >= set(TABLE_ARRAYS), "the table of members is missing")
        _check_table(arrays, plan, ranges)


def require(condition: Any, what: str) -> None:
    """Refuse the file unless the condition holds."""
    if not condition:
        raise _Unusable(what)


def _ranges(arrays: Mapping[str, np.ndarray]) -> list[Range]:
    """The members of a merged file: in order, without overlap."""
    rows = arrays["ranges"]
    require(rows.shape[1] == 2 and len(rows), "no ranges")
    ends = rows.ravel()
    require((rows[:, 0] < rows[:, 1]).all() and (np.diff(ends) >= 0).all(), "ranges overlap")
    most = MAX_MEMBERS + 2**MAX_RANGES  # the corners have the numbers behind all members
    require(ends[0] >= 0 and ends[-1] <= most, "ranges of members that do not exist")
    return [(begin, end) for begin, end in rows.tolist()]


def _check_bands(arrays: Mapping[str, np.ndarray], plan: Plan, members: int) -> None:
    """Every signal at every time has counted every member."""
    bins, counts = arrays["bins"].astype(np.int64), arrays["counts"].astype(np.int64)
    require(bins.shape == counts.shape and (bins[1:] > 0).all(), "bins are not in order")
    require((counts > 0).all() and (counts <= members).all(), "a count is out of range")
    places = np.cumsum(bins)
    cells = plan.centre.size
    require(not places.size or places[-1] < cells * BAND_BINS, "a bin that does not exist")
    sums = np.bincount(places // BAND_BINS, weights=counts, minlength=cells)
    require((sums == members).all(), "bands do not count every member")


def _check_totals(arrays: Mapping[str, np.ndarray], plan: Plan, members: int) -> int:
    totals = arrays["totals"]
    require(totals.shape == (2,) and totals[0] == members, "another number of members")
    violations = int(totals[1])
    most = 0 if plan.limit is None else members
    require(0 <= violations <= most, "more violations than members")
    return violations


def _check_outcomes(arrays: Mapping[str, np.ndarray], members: int) -> None:
    names, counts = arrays["outcomes"], arrays["outcome_counts"]
    require(names.dtype.itemsize <= 4 * MAX_OUTCOME_LENGTH, "an outcome that nobody knows")
    known = set(names.tolist()) <= {outcome.name for outcome in Outcome}
    require(known and len(set(names.tolist())) == len(names), "an outcome that nobody knows")
    require(names.shape == counts.shape and _counts_all(counts, members), "outcomes of others")


def _counts_all(counts: np.ndarray, members: int) -> bool:
    """Whether these are counts of so many members; they are small enough to be added."""
    return bool(((counts > 0) & (counts <= members)).all()) and int(counts.sum()) == members


def _check_metric(name: str, arrays: Mapping[str, np.ndarray], members: int) -> None:
    keys, counts = arrays[f"{name}_keys"], arrays[f"{name}_counts"]
    extremes = arrays[f"{name}_extremes"]
    require(keys.shape == counts.shape and extremes.shape == (3,), "a metric of another shape")
    least, most, missing = extremes.tolist()
    require(0 <= missing <= members and missing == int(missing), "missing members out of range")
    require(_counts_all(counts, members - int(missing)), "a metric does not count every member")
    require((np.diff(keys) > 0).all(), "bins of a metric are not in order")
    ends = Tally()
    ends.observe(np.array([least, most] if keys.size else []))
    if keys.size:
        require(ends.missing == 0 and least <= most, "extremes that are no numbers")
        require(ends.keys[[0, -1]].tolist() == keys[[0, -1]].tolist(), "extremes of other bins")
    else:
        require((least, most) == (ends.least, ends.most), "extremes of nothing")


def _check_worst(
    arrays: Mapping[str, np.ndarray], plan: Plan, ranges: Sequence[Range], violations: int
) -> None:
    values, indices = arrays["worst"], arrays["worst_members"]
    members = sum(end - begin for begin, end in ranges)
    expected = (min(WORST_MEMBERS, members),)
    require(values.shape == indices.shape == expected, "another number of worst members")
    require((values >= 0).all(), "a worst member without an error")
    pairs = list(zip((-values).tolist(), indices.tolist(), strict=True))
    require(pairs == sorted(set(pairs)), "worst members are not in order")
    inside = [any(begin <= index < end for begin, end in ranges) for index in indices.tolist()]
    require(all(inside) and len(set(indices.tolist())) == len(indices), "a member of others")
    _, most, missing = arrays["tail_error_extremes"].tolist()
    finite = values[np.isfinite(values)]
    require(len(values) - len(finite) == min(missing, len(values)), "worst members not missing")
    require(not finite.size or finite[0] == most, "the worst is not the largest")
    if plan.limit is not None:
        beyond = int((values > plan.limit).sum())
        require(beyond == min(violations, len(values)), "violations of others")


def _check_table(arrays: Mapping[str, np.ndarray], plan: Plan, ranges: Sequence[Range]) -> None:
    """The metrics of single members; all that is counted must be counted from them."""
    parts, metrics, codes = (arrays[name] for name in TABLE_ARRAYS)
    members = sum(end - begin for begin, end in ranges)
    expected = [[begin, end - begin] for begin, end in joined(ranges)]
    require(parts.tolist() == expected, "a table of other members")
    require(metrics.shape == (len(METRICS), members), "a table of another shape")
    require(codes.shape == (members,), "a table of another shape")
    require(((codes >= 0) & (codes < len(Outcome))).all(), "an outcome that nobody knows")
    names = [outcome.name for outcome in Outcome]
    occurred = {names[code]: count for code, count in enumerate(np.bincount(codes)) if count}
    stored = dict(zip(arrays["outcomes"].tolist(), arrays["outcome_counts"].tolist(), strict=True))
    require(occurred == stored, "outcomes of others")
    for name, values in zip(METRICS, metrics, strict=True):
        tally = Tally()
        tally.observe(values)
        extremes = [tally.least, tally.most, tally.missing]
        same = (
            np.array_equal(tally.keys, arrays[f"{name}_keys"])
            and np.array_equal(tally.counts, arrays[f"{name}_counts"])
            and extremes == arrays[f"{name}_extremes"].tolist()
        )
        require(same, "a metric of others")
    tail = metrics[METRICS.index("tail_error")]
    tail = np.where(np.isnan(tail), np.inf, tail)
    statistics = Statistics(Bands(np.zeros((1, 1)), np.ones(1)), {})
    place = 0
    for begin, end in ranges:
        statistics.observe_worst(tail[place : place + end - begin], begin)
        place += end - begin
    worst = list(zip(arrays["worst"].tolist(), arrays["worst_members"].tolist(), strict=True))
    require(statistics.worst == worst, "worst members of others")
    if plan.limit is not None:
        require(int((tail > plan.limit).sum()) == arrays["totals"][1], "violations of others")


def joined(ranges: Sequence[Range]) -> list[Range]:
    """Ranges in order, those that touch as one."""
    result: list[Range] = []
    for begin, end in sorted(ranges):
        if result and result[-1][1] == begin:
            result[-1] = (result[-1][0], end)
        else:
            result.append((begin, end))
    return result

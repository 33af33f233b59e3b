"""Folders of ensembles: files with arrays, bytes or names changed, some sealed anew.

Whatever is in a file, reading never fails; and what is accepted of a file whose digest was not made
anew is what was written. A forger who makes it anew must at least have made numbers that agree, so
that the results can be printed.
"""

import atexit
import io
import random
import shutil
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import certrack
from certrack.studies.ensembles.checkpoints import Checkpoints
from certrack.studies.ensembles.ensemble import Ensemble
from certrack.studies.ensembles.plan import Plan, make_plan
from certrack.studies.ensembles.statistics import Statistics
from certrack.studies.ensembles.stored import sealed
from fuzz.mutation import mutated_bytes
from fuzz.runner import Finding

CHUNKS = ((0, 16), (16, 32), (32, 40))
MEMBERS = 40

#: Ends the first line of an input whose digest was made anew.
FORGED = b" forged"

PIECES = [b"\x00" * 8, b"\xff" * 8, b"PK\x03\x04", b"PK\x01\x02", b"NUMPY", b"(" * 200, b"'<f8'"]
TYPES = ("f8", "f4", "i8", "i4", "u4", "u1", "?", "c16", "U3", "S4", "M8[s]", "O", "i4,f8")
VALUES = (0, 1, -1, 7, 2**31, 2**62, -(2**63), float("nan"), float("inf"), -float("inf"), 1e300)


class Chunks:
    """The file of the second of three chunks; its name is its first line."""

    name, suffix = "chunks", ".bin"

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp())
        atexit.register(shutil.rmtree, self.folder, ignore_errors=True)
        system = certrack.load("dual-motor-lean").with_settings(duration=0.5, tail=None)
        system = system.replace(population=replace(system.varied, points=10))
        plan = make_plan(system, 1, 1e-6, 0.05, "alone", per_member=True)
        self.plan: Plan = plan
        self.honest = {span: statistics_of(plan, *span) for span in CHUNKS}
        with Checkpoints(self.folder, plan) as checkpoints:
            for span, statistics in self.honest.items():
                checkpoints.save(span, statistics.packed())
            self.run = checkpoints._run
        self.files = {path.name: path.read_bytes() for path in self.folder.glob("*.npz")}
        self.arrays = self.honest[CHUNKS[1]].packed()

    def make(self, rng: random.Random) -> bytes:
        name = rng.choice(["chunk-0000000016-0000000032.npz"] * 3 + ["merged.npz"])
        kind, mark = rng.random(), b""
        if kind < 0.35:
            data = mutated_bytes(rng, self.files["chunk-0000000016-0000000032.npz"], PIECES)
        elif kind < 0.4:
            data = rng.choice(list(self.files.values()))
        else:
            arrays: dict[str, Any] = dict(self.arrays)
            for _ in range(rng.choice([1, 1, 2, 3])):
                self._change(rng, arrays)
            if kind < 0.8:
                try:
                    spans = [rng.choice([(16, 32), (0, 32), (32, 16), (16, 2**40), (-5, 11)])]
                    data = sealed(arrays, [(16, 32)] if rng.random() < 0.8 else spans, self.run)
                    mark = FORGED
                except (ValueError, TypeError):
                    data = packed(arrays)
            else:
                data = packed(arrays, compressed=rng.random() < 0.3)
        return name.encode() + mark + b"\n" + data

    def _change(self, rng: random.Random, arrays: dict[str, Any]) -> None:
        name, kind = rng.choice(list(arrays)), rng.random()
        array = np.array(arrays[name])
        if kind < 0.1:
            del arrays[name]
        elif kind < 0.25:
            try:
                with np.errstate(all="ignore"):
                    arrays[name] = array.astype(rng.choice(TYPES))
            except (ValueError, TypeError):
                arrays[name] = np.array("x")
        elif kind < 0.35:
            arrays[name] = array.reshape(rng.choice([(-1, 1), (1, -1), (-1,)]))
        elif kind < 0.45:
            arrays[name] = np.append(array, array.ravel()[:1])
        elif kind < 0.55:
            arrays[name] = array.ravel()[:-1]
        elif kind < 0.6:
            arrays[rng.choice(["digest", "ranges", "x", "../x"])] = array
        elif array.size:
            i = rng.randrange(array.size)
            try:
                with np.errstate(all="ignore"):
                    step = rng.choice([1, -1, 2])
                    array.flat[i] = array.flat[i] + step if kind < 0.8 else rng.choice(VALUES)
            except (TypeError, ValueError, OverflowError):
                array.flat[i] = array.flat[0]
            arrays[name] = array

    def examine(self, data: bytes) -> str:
        line, _, content = data.partition(b"\n")
        name = line.removesuffix(FORGED)
        for path in self.folder.glob("*.npz"):
            path.unlink()
        for path, original in self.files.items():
            (self.folder / path).write_bytes(original)
        (self.folder / name.decode()).write_bytes(content)
        with Checkpoints(self.folder, self.plan) as checkpoints:
            total = self.plan.empty()
            covered = checkpoints.load(total, MEMBERS)
        if any(end <= begin for begin, end in covered) or not set(covered) <= set(CHUNKS):
            raise Finding("ranges of other members")
        if total.members != sum(end - begin for begin, end in covered):
            raise Finding("another number of members")
        Ensemble(self.plan.system, 1, total, 0.05, "", 0, 0.0).summary() if covered else None
        expected = self.plan.empty()
        for span in covered:
            expected.merge(self.honest[span])
        same = contents(expected) == contents(total)
        if not same and not line.endswith(FORGED):
            raise Finding("accepted what was not written")
        if len(covered) == len(CHUNKS):
            return "accepted" if same else "accepted a forgery that agrees with itself"
        return "refused"


def statistics_of(plan: Plan, begin: int, end: int) -> Statistics:
    """What an engine gives for these members."""
    from certrack.studies.ensembles.engine import Engine

    return Engine(plan).compute(begin, end)


def packed(arrays: dict[str, Any], *, compressed: bool = False) -> bytes:
    """An archive of arrays, without a digest."""
    buffer = io.BytesIO()
    kind = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(buffer, "w", kind) as archive:
        for name, array in arrays.items():
            entry = io.BytesIO()
            np.save(entry, np.asarray(array), allow_pickle=True)
            archive.writestr(f"{name}.npy", entry.getvalue())
    return buffer.getvalue()


def contents(statistics: Statistics) -> dict[str, bytes]:
    """All that is kept, comparable."""
    arrays = statistics.packed()
    pairs = sorted(zip(arrays.pop("outcomes"), arrays.pop("outcome_counts"), strict=True))
    return {name: array.tobytes() for name, array in arrays.items()} | {"o": repr(pairs).encode()}

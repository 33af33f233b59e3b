"""CSV files of a reference."""

import atexit
import random
import shutil
import tempfile
from pathlib import Path

import numpy as np

import certrack
from certrack.core.errors import CertrackError
from fuzz.runner import Finding

GOOD = b"# time, y_d\n0,0\n0.5,0.1\n1,0.3\n2,-0.1\n3,0\n"
PIECES = [
    *(b"nan", b"inf", b"-inf", b"1e400", b"1e-400", b",", b"\n", b"\r", b"\x00", b"\xff", b'"'),
    *(b"1_0", b"0x1p3", b"1j", b"#", b"\n\n", b"1,2,3\n", b"1\n", b"\xef\xbb\xbf", b";", b" "),
    *(b"1e300,1e300\n", b"1e9,1e308\n", b"True", b"0,5;1,2\n", b"t;y\n", b"1e-300,1\n", b"ms"),
    *(b"''", b"\t", "\u0661,1\n".encode(), b"9" * 5000, b"time,y\n", b"0,0\n" * 300, b"1 2\n"),
]

SYSTEM = """
[plant]
states = ["x1"]
gain_sign = 1
input_gain = 1
[truth]
input_gain = 1
[reference]
kind = "samples"
file = "samples.csv"
interpolation = "{}"
[law]
kind = "robust"
c = [1]
feedforward = 0
[simulation]
x0 = [0]
duration = 1
"""


class Samples:
    """The file of samples beside a system file."""

    name, suffix = "samples", ".csv"

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp())
        atexit.register(shutil.rmtree, self.folder, ignore_errors=True)

    def make(self, rng: random.Random) -> bytes:
        data = bytearray(GOOD)
        for _ in range(rng.choice([0, 1, 1, 2, 4])):
            i, kind = rng.randrange(len(data) + 1), rng.random()
            if kind < 0.4 and i < len(data):
                data[i] = rng.randrange(256)
            elif kind < 0.6:
                del data[i : i + rng.randrange(6)]
            else:
                data[i:i] = rng.choice(PIECES)
        return bytes(data)

    def examine(self, data: bytes) -> str:
        (self.folder / "samples.csv").write_bytes(data)
        words = {self._load(data, interpolation) for interpolation in ("monotone", "cubic")}
        return "loaded" if "loaded" in words else "refused"

    def _load(self, data: bytes, interpolation: str) -> str:
        try:
            system = certrack.loads(SYSTEM.format(interpolation), "system.toml", self.folder)
            reference = system.reference
            values = reference.values(np.linspace(0.0, 3.0, 7), 1)
            reference.bounds(1)
        except CertrackError as refusal:
            if "\n" in str(refusal) or len(str(refusal)) > 1000:
                raise Finding("a message of more than one line") from None
            return "refused"
        if not np.isfinite(values).all():
            raise Finding("a reference that is not finite")
        return "loaded"

"""Certificate files: numbers, systems, claims and bytes changed, most with a digest that is right.

A file that is accepted must claim what was proven. So if its system and proof are those of an
honest certificate, all else must be too (but for who made it). With the same system it must not
claim less than the honest bound, which a solver found as the smallest, with a margin for what the
solver leaves. And with another system, it must not claim less than the bound found for that one.
A bootstrap is no smallest bound: one that is accepted must be accepted by the other checker, too.
"""

import copy
import json
import random
import re
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Any

import independent_checker

import certrack
from certrack.certificates.bootstrap.document import is_bootstrap
from certrack.certificates.document import to_document
from certrack.certificates.layout import digest_of
from certrack.certificates.verification import verify
from certrack.core.errors import CertrackError
from fuzz.mutation import entry, mutated_bytes, paths
from fuzz.runner import Finding

#: Systems, and the efforts that give certificates of one, two and three stages, and a bootstrap.
HONEST = (
    *(("dual-motor-lean", "fast"), ("example1", "fast"), ("dual-motor", "fast")),
    *(("theorem1-counterexample", "fast"), ("example1", "default")),
)

#: What a solver may miss of the smallest bound, relatively.
SOLVER_MISSES = Fraction(2, 1000)

#: How a claim begins.
CLAIM = "limsup |e_1(t)| <= "

#: Who made it: free text.
FREE = ("made_by", "sha256")

NUMBERS = (
    *("0", "-0", "1", "-1", "1e400", "1e-400", "1e401", "9" * 60, "1e", "e5", "1e5e5", "--1"),
    *("+1", "1.", ".5", ".", "", "1_0", "\u0661", "nan", "inf", "-inf", "1/2", "1e+-5", "1E5"),
    *("0x1", "1e" + "0" * 37 + "1", "1" + "0" * 59, "1e-00000400", "0" * 60, " 1", "1\n"),
    *("1e99999999999999999999999", "1e400" * 2, None, 1, 1.5, True, [], {}, [["1"]]),
)
FACTORS = (0.5, 2, 0.99, 1.01, 0.999999, 1.000001, 1 - 1e-12, 1 + 1e-12, -1, 0, 10, 0.1)
PIECES = [
    *(b"9" * 5000, b"[" * 50000, b'{"a":' * 50000, b"1e999999999", b"NaN", b"\x00", b"\xff\xfe"),
    *(b'"\\ud800"', b'"format":1,', b"1E400", b"-", b'"claim": "limsup |e_1(t)| <= 0",'),
]
SYSTEM_NUMBERS = ("0", "1", "-1", "2", "1e300", "1e-300", "nan", "inf", "0.5", "1e6", '"1/3"')
SYSTEM_PIECES = ('"', "[", "]", "=", "\n", "x1", "#", "9" * 50, "{", "a." * 5000)


class Certificates:
    """Documents that `verify` reads."""

    name, suffix = "certificates", ".json"

    def __init__(self, honest: tuple[tuple[str, str], ...] = HONEST) -> None:
        self.honest: list[dict[str, Any]] = []
        for name, effort in honest:
            system = certrack.load(name)
            found = certrack.certify(system, effort)
            self.honest.append(json.loads(json.dumps(to_document(system, *found.stages))))
        assert all(verify(document).verified for document in self.honest)
        self.best: dict[str, Fraction | None] = {
            document["system"]: bound_of(document)
            for document in self.honest
            if not is_bootstrap(document)
        }

    def make(self, rng: random.Random) -> bytes:
        if rng.random() < 0.25:
            data = json.dumps(rng.choice(self.honest), indent=1).encode()
            if rng.random() < 0.05:  # a second claim, which a reader may see instead
                return data.replace(b"{", b'{"claim": "limsup |e_1(t)| <= 0",', 1)
            return mutated_bytes(rng, data, PIECES)
        document = copy.deepcopy(rng.choice(self.honest))
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            self._mutate(rng, document)
        if rng.random() < 0.85 and "sha256" in document:
            document["sha256"] = digest_of(document)
        return json.dumps(document).encode()

    def _mutate(self, rng: random.Random, document: dict[str, Any]) -> None:
        kind, proof = rng.random(), document.get("proof")
        if kind < 0.35:
            numbers = [p for p in paths(proof) if isinstance(entry(proof, p), str)]
            if numbers:
                *place, key = rng.choice(numbers)
                around = entry(proof, tuple(place))
                around[key] = changed_number(rng, around[key])
        elif kind < 0.5 and isinstance(document.get("system"), str) and document["system"]:
            document["system"] = changed_system(rng, document["system"])
        elif kind < 0.6 and well_formed(proof):
            stage = rng.choice(proof)
            stage["bound"] = changed_number(rng, stage.get("bound"))
            if rng.random() < 0.8:
                document["claim"] = f"{CLAIM}{proof[-1].get('bound')}"
        elif kind < 0.65 and well_formed(proof):
            document["proof"] = [
                proof[::-1],
                [*proof, copy.deepcopy(rng.choice(proof))],
                proof[1:],
                proof[:1],
                copy.deepcopy(rng.choice(self.honest)["proof"]),
            ][rng.randrange(5)]
        elif kind < 0.7:
            smaller = ["limsup |e_1(t)| <= 0", "", None, "limsup |e_1(t)| <= 1e-3"]
            document["claim"] = rng.choice(smaller)
        else:
            *place, key = rng.choice(paths(document) or [("claim",)])
            around, kind = entry(document, tuple(place)), rng.random()
            if kind < 0.5:
                around[key] = rng.choice([*NUMBERS, {"a": 1}, "x" * 100])
            elif kind < 0.75:
                around.pop(key, None) if isinstance(around, dict) else around.pop(key)
            elif isinstance(around, list):
                around.insert(key, copy.deepcopy(around[key]))
            else:
                around[rng.choice(["x", "alpha", "P", "bound", "claim"])] = rng.choice(NUMBERS)

    def examine(self, data: bytes) -> str | Callable[[], str]:
        try:
            read = json.loads(data)
        except (ValueError, RecursionError):
            read = None
        try:
            verdict = verify_bytes(data)
        except CertrackError as refusal:
            if "\n" in str(refusal) or len(str(refusal)) > 1000:
                raise Finding("a message of more than one line") from None
            return "refused"
        if not verdict.verified:
            if not verdict.reason.strip() or "\n" in verdict.reason:
                raise Finding("no reason in one line")
            return "not verified"
        if read is None:
            raise Finding("verified, but it is not JSON")
        if json.loads(data, object_pairs_hook=repeats):
            raise Finding("verified with a key twice")
        return partial(self._judge, read)

    def _judge(self, document: dict[str, Any]) -> str:
        """What was accepted must have been proven."""
        if is_bootstrap(document):
            self._ask_the_other_checker(document)
        elif document["claim"] != f"{CLAIM}{document['proof'][-1]['bound']}":
            raise Finding("accepted a claim that is not the proof's")
        for honest in self.honest:
            if (honest["system"], honest["proof"]) == (document["system"], document["proof"]):
                differ = {
                    key for key in {*honest, *document} if honest.get(key) != document.get(key)
                }
                if differ - set(FREE):
                    raise Finding(f"accepted though it differs in {sorted(differ)}")
                return "verified, nothing changed"
        if is_bootstrap(document):
            return "verified, by both checkers"
        best = self._best(document["system"])
        if best is not None and bound_of(document) < best * (1 - SOLVER_MISSES):
            raise Finding("accepted a bound below the smallest that can be proven")
        return "verified, claims no less"

    def _ask_the_other_checker(self, document: dict[str, Any]) -> None:
        try:
            independent_checker.check(document)
        except (independent_checker.Refused, ArithmeticError, ValueError, LookupError) as refusal:
            raise Finding(f"accepted what another checker refuses: {refusal}") from None

    def _best(self, text: str) -> Fraction | None:
        """The bound that is found for a system; None where none is."""
        if text not in self.best:
            found = certrack.certify(certrack.loads(text), "fast")
            bound = Fraction(found.stages[-1].bound) if found.stages else None
            self.best[text] = bound
        return self.best[text]


def verify_bytes(data: bytes) -> certrack.Verdict:
    """What `verify` says of a file of these bytes."""
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "certificate.json"
        path.write_bytes(data)
        return verify(path)


def repeats(pairs: list[tuple[str, Any]]) -> bool:
    """Whether an object of JSON has a key twice, or contains one that does."""
    inner = [v for _, v in pairs for v in (v if isinstance(v, list) else [v]) if v is True]
    return len({key for key, _ in pairs}) < len(pairs) or bool(inner)


def bound_of(document: dict[str, Any]) -> Fraction:
    return Fraction(document["claim"].removeprefix(CLAIM))


def well_formed(proof: Any) -> bool:
    return isinstance(proof, list) and bool(proof) and all(isinstance(s, dict) for s in proof)


def changed_number(rng: random.Random, text: Any) -> Any:
    """Another number: near, of another size, or no number."""
    kind = rng.random()
    if not isinstance(text, str) or not text or len(text) > 60 or kind < 0.2:
        return rng.choice(NUMBERS)
    if len(text.lower().partition("e")[2]) < 5:
        try:
            number = float(Fraction(text))
        except (ValueError, OverflowError, ZeroDivisionError):
            return rng.choice(NUMBERS)
        if kind < 0.6:
            return f"{number * rng.choice(FACTORS):.15g}"
        if kind < 0.8:
            return f"{number + rng.choice([1e-12, -1e-12, 1e-6, -1e-6, 1, -1]):.15g}"
    i = rng.randrange(len(text))
    return text[:i] + rng.choice("0123456789.eE+-") + text[i + 1 :]


def changed_system(rng: random.Random, text: str) -> str:
    """Another system: a number, a line or a character changed."""
    kind = rng.random()
    if kind < 0.7:
        numbers = list(re.finditer(r"-?\d+\.?\d*(e-?\d+)?", text))
        if numbers:
            number = rng.choice(numbers)
            new = rng.choice([*SYSTEM_NUMBERS, f"{rng.uniform(-3, 3):.6g}"])
            return text[: number.start()] + new + text[number.end() :]
    if kind < 0.8:
        lines = text.split("\n")
        i = rng.randrange(len(lines))
        if rng.random() < 0.5:
            del lines[i]
        else:
            lines.insert(i, rng.choice(lines))
        return "\n".join(lines)
    i = rng.randrange(len(text))
    return text[:i] + rng.choice(SYSTEM_PIECES) + text[i + rng.randrange(3) :]

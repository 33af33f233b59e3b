"""Fuzzers: what was once found, in the fast tests; new inputs, in the slow ones and `make fuzz`."""

import os
import time
from pathlib import Path

import pytest
from fuzz import KINDS, fuzzer
from fuzz.runner import MAX_MEGABYTES, Finding, outcome, peak_megabytes, run

CORPUS = Path(__file__).parent / "data" / "corpus"

#: Inputs of each kind in the slow tests; about a minute each.
COUNTS = {"systems": 400, "expressions": 8000, "certificates": 500, "samples": 500, "chunks": 300}


@pytest.fixture(scope="module")
def fuzzers():
    return {}


@pytest.mark.parametrize("path", sorted(CORPUS.glob("*/*")), ids=lambda path: path.stem)
def test_what_was_found_stays_mended(fuzzers, path):
    kind = path.parent.name
    if kind not in fuzzers:
        fuzzers[kind] = fuzzer(kind)
    word, _ = outcome(fuzzers[kind], path.read_bytes())
    assert not word.startswith("FINDING"), word


def test_the_corpus_has_only_kinds_that_exist():
    assert {path.name for path in CORPUS.iterdir()} <= set(KINDS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_new_inputs(kind, tmp_path):
    """Other inputs with another CERTRACK_FUZZ_SEED."""
    seed = int(os.environ.get("CERTRACK_FUZZ_SEED", "0"))
    report = run(fuzzer(kind), seed, COUNTS[kind], tmp_path)
    assert not report.findings, report.findings
    assert report.megabytes < MAX_MEGABYTES


class Faulty:
    """A fuzzer of a product that does what must never happen."""

    name, suffix = "faulty", ".txt"

    def make(self, rng):
        return rng.choice([b"fine", b"wrong", b"crash", b"hang"])

    def examine(self, data):
        if data == b"wrong":
            raise Finding("a false value")
        if data == b"crash":
            raise ZeroDivisionError
        while data == b"hang":
            pass
        return "fine"


def test_the_runner_finds_each_kind_of_fault_once(monkeypatch, tmp_path):
    monkeypatch.setattr("fuzz.runner.MAX_SECONDS", 0.05)
    report = run(Faulty(), 0, 40, tmp_path)
    kinds = sorted({word.split()[1] for word in report.findings})
    assert kinds == ["ZeroDivisionError", "a", "hangs"]
    assert sorted(path.read_bytes() for path in tmp_path.iterdir()) == [b"crash", b"hang", b"wrong"]
    assert report.counts["fine"] > 0


class Hungry(Faulty):
    """A fuzzer of a product that takes memory."""

    def make(self, rng):
        return b"100" if rng.random() < 0.5 else b"1"

    def examine(self, data):
        bytearray(10**6 * int(data))
        return data.decode()


def test_memory_counts_from_where_an_input_begins(monkeypatch, tmp_path):
    """Whatever the process, which has run other tests, had taken before."""
    if not peak_megabytes():
        pytest.skip("the system does not say how much memory a process has")
    monkeypatch.setattr("fuzz.runner.MAX_MEGABYTES", 50)
    held = bytearray(60 * 10**6)
    small = [bytes(10**5) for _ in range(4000)]
    last = small[-1]  # after it, what is freed before it stays with the process
    del small
    report = run(Hungry(), 0, 20, tmp_path)
    assert last
    assert list(report.findings) == ["FINDING: memory"] and report.counts["1"] > 0
    assert 90 < report.megabytes < 130 and len(held) == 60 * 10**6


class Judged(Faulty):
    """A fuzzer whose judge takes longer than the product may."""

    def examine(self, data):
        if data == b"hang":
            return lambda: super(Judged, self).examine(data)
        return lambda: spend(0.1) or "judged"


def spend(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_the_time_of_a_judge_is_not_the_products(monkeypatch):
    monkeypatch.setattr("fuzz.runner.MAX_SECONDS", 0.05)
    assert outcome(Judged(), b"fine")[0] == "judged"
    assert outcome(Judged(), b"hang")[0].startswith("FINDING: hangs")


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("x1 + 1", "x1 + 1 + 1/10**8"),
        ("sin(x1)", "sin(x1 + 2*3.14159)"),
        ("max(x1, t)", "min(x1, t)"),
        ("x1**2", "x1*abs(x1)"),
    ],
)
def test_a_wrong_value_is_found(monkeypatch, text, wrong):
    """The evaluator is another one than the product's: it notices a wrong formula."""
    from fuzz import expressions

    right = expressions.parse
    monkeypatch.setattr(expressions, "parse", lambda key, _, names: right(key, wrong, names))
    with pytest.raises(Finding, match="another value"):
        expressions.Expressions().examine(text.encode())


def test_a_forged_claim_is_found(monkeypatch):
    """The judge of certificates is another one than `verify`."""
    import json

    from fuzz import certificates

    judge = certificates.Certificates((("dual-motor-lean", "fast"),))
    document = judge.honest[0]
    accepting = certificates.verify(document)
    monkeypatch.setattr(certificates, "verify", lambda path: accepting)

    def changed(**entries):
        return json.dumps(document | entries).encode()

    assert judge.examine(changed())() == "verified, nothing changed"
    stage = document["proof"][0]
    half = f"{float(stage['bound']) / 2:.6g}"
    claim = f"limsup |e_1(t)| <= {half}"
    for forged in (
        changed(claim="limsup |e_1(t)| <= 0"),
        changed(assumptions=[]),
        changed(proof=[stage | {"bound": half}], claim=claim),
        b'{"claim": "limsup |e_1(t)| <= 0", ' + changed()[1:],
    ):
        with pytest.raises(Finding, match="accepted|twice"):
            judge.examine(forged)()

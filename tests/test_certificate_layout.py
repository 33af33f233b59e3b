"""The layout of a certificate file: what is read at all, and which keys it must have."""

import pytest

import certrack
from certrack.certificates import document, layout
from certrack.certificates.bootstrap.document import bootstrap_stages
from certrack.certificates.implemented.document import implemented_proofs
from certrack.certificates.layout import (
    DOCUMENT_KEYS,
    FORMAT,
    FORMAT_1,
    check_layout,
    read_document,
    refusing_malformed_proof,
)
from certrack.certificates.records import cell_record, online_record, stage_record
from certrack.certificates.sampled_adaptive.document import sampled_adaptive_record
from certrack.core.errors import CertrackError, InputError


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "certificate.json"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_document(path)

    return read


def test_what_is_read_is_an_object(read, tmp_path):
    assert read('{"a": [1, {"b": 2}]}') == {"a": [1, {"b": 2}]}
    assert read("[1]") == read('"text"') == {}
    for text in ("", "{", "{'a': 1}", b"\xff\xfe", "[" * 100_000):
        with pytest.raises(InputError, match="not JSON"):
            read(text)
    with pytest.raises(InputError, match="cannot be read"):
        read_document(tmp_path / "missing.json")


def test_no_key_stands_twice_and_no_number_is_infinite(read):
    for text in ('{"a": 1, "a": 1}', '{"b": {"a": 1, "c": 2, "a": 3}}'):
        with pytest.raises(InputError, match="'a' stands twice"):
            read(text)
    assert read('{"a": {"a": 1}}') == {"a": {"a": 1}}
    for word in ("NaN", "Infinity", "-Infinity"):
        with pytest.raises(InputError, match=f"{word} is not JSON"):
            read(f'{{"a": {word}}}')


def test_reading_stops_at_a_limit(read, monkeypatch):
    monkeypatch.setattr(layout, "MAX_CERTIFICATE_BYTES", 9)
    assert read('{"a": 12}') == {"a": 12}
    with pytest.raises(InputError, match="larger than"):
        read('{"a": 123}')


def body(kind, **changed):
    return dict.fromkeys(DOCUMENT_KEYS[kind], "text") | {"format": kind} | changed


@pytest.mark.parametrize("kind", [FORMAT, FORMAT_1])
def test_a_certificate_has_the_keys_of_its_format(kind):
    check_layout(body(kind))
    check_layout(body(kind, proof=[], **{DOCUMENT_KEYS[kind][3]: []}))
    for key in DOCUMENT_KEYS[kind]:
        with pytest.raises(InputError, match="it must have"):
            check_layout({name: v for name, v in body(kind).items() if name != key})
    with pytest.raises(InputError, match="it must have"):
        check_layout(body(kind, more=1))
    for key in ("claim", "system", "sha256", "made_by"):
        with pytest.raises(InputError, match="texts expected"):
            check_layout(body(kind, **{key: 1}))
    with pytest.raises(InputError, match="must be certrack-certificate/2 or"):
        check_layout(body(kind, format="certrack-certificate/3"))
    for wrong in ([], "text", None, body(kind, format=2)):
        with pytest.raises(InputError, match="it must have"):
            check_layout(wrong)
    assert ("premises" in DOCUMENT_KEYS[kind]) == (kind == FORMAT)
    assert ("assumptions" in DOCUMENT_KEYS[kind]) == (kind == FORMAT_1)


def test_a_certificate_that_nobody_could_check_is_not_written(monkeypatch, tmp_path):
    system = certrack.load("dual-motor-lean")
    stages = certrack.certify(system, "fast").stages
    monkeypatch.setattr(document, "MAX_CERTIFICATE_BYTES", 100)
    with pytest.raises(CertrackError, match="larger than 0 MB, which nobody could check"):
        certrack.certificates.save_certificate(system, stages, tmp_path / "cert.json")
    assert not list(tmp_path.iterdir())


def test_a_refusal_is_not_wrapped_in_another():
    with pytest.raises(InputError) as refused, refusing_malformed_proof():
        raise InputError("proof", "must have bound and cell")
    assert str(refused.value) == "proof: must have bound and cell"
    for problem in (TypeError("a"), ValueError("b"), ZeroDivisionError("c")):
        with pytest.raises(InputError) as refused, refusing_malformed_proof():
            raise problem
        assert str(refused.value) == f"proof: must hold decimal texts ({problem})"
    with pytest.raises(KeyError), refusing_malformed_proof():  # a defect is not bad input
        raise KeyError("a")


STAGE = {name: [] for name in ("P", "lam", "nu", "k")} | dict.fromkeys(
    ("alpha", "bound", "shift"), "1"
)
SAMPLED = {"invariant": {}, "row": [], "stages": []}
DELAY = dict.fromkeys(("delay", "input", "step", "bound"), "0") | {
    "states": [],
    "starts": [],
    "parts": [1, 1],
    "doublings": 3,
}
START = {"region": [], "states": [], "peaks": [], "input": "0"} | {
    "doublings": 3,
    "middle": 1,
    "of": "e_1",
    "phase": "later",
}


@pytest.mark.parametrize(
    ("read", "entries", "expected"),
    [
        (stage_record, {}, "must have alpha, "),
        (stage_record, STAGE | {"k": ["x"]}, "must hold decimal texts (not a decimal number: 'x')"),
        (cell_record, {}, "a cell must have"),
        (cell_record, {"cell": [["2", "1"]], "bound": "1", "points": []}, "must hold decimal"),
        (cell_record, {"cell": [["1/0", "1"]], "bound": "1", "points": []}, "must hold decimal"),
        (cell_record, {"cell": [], "bound": "1", "points": [{}]}, "must have alpha, "),
        (online_record, {"bound": "1", "ends": [{}]}, "must have alpha, "),
        (online_record, {"bound": 1, "ends": [{}]}, "must hold decimal texts"),
        (bootstrap_stages, [{}], "must have region, "),
        (bootstrap_stages, [{"region": {}, "functions": 3}], "must hold decimal texts (a list"),
        (bootstrap_stages, [{"region": {}, "functions": []}], "must have box, "),
        (bootstrap_stages, [{"region": {}, "functions": [{}]}], "must have alpha, "),
        (sampled_adaptive_record, [{}], "must have invariant, "),
        (sampled_adaptive_record, [SAMPLED], "must have region, "),
        (sampled_adaptive_record, [SAMPLED, SAMPLED], "must be one, "),
        (implemented_proofs, [{}], "must have delay, "),
        (implemented_proofs, [DELAY | {"input": 0}], "must hold decimal texts (not a decimal"),
        (implemented_proofs, [DELAY | {"starts": [{}]}], "starts must have "),
        (implemented_proofs, [DELAY | {"starts": [START | {"of": 1}]}], "must hold decimal texts"),
    ],
)
def test_what_is_malformed_is_refused_in_one_sentence(read, entries, expected):
    with pytest.raises(InputError) as refused:
        read(entries)
    text = str(refused.value)
    assert text.startswith(f"proof: {expected}") and text.count("proof:") == 1

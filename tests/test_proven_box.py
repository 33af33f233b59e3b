"""The monitor's box from a certificate: saved and verified, of this system, or certified anew."""

import json

import pytest
from test_implemented import command, on_a_drive

import certrack
from certrack.certificates.implemented.certify import certify_implemented
from certrack.export.proven_box import proven_box


@pytest.fixture(scope="module")
def certified(tmp_path_factory):
    """A drive, the file of its system and a certificate of it."""
    folder = tmp_path_factory.mktemp("box")
    system = on_a_drive("dual-motor-lean", 0.02, ("x4",))
    certrack.save(system, folder / "drive.toml")
    found, proofs = certify_implemented(system, from_start=True)
    certrack.certificates.save_certificate(system, proofs, folder / "cert.json")
    return system, found, folder


def test_a_saved_certificate_has_the_box(certified):
    system, found, folder = certified
    box = proven_box(system, folder / "cert.json")
    assert list(box) == ["x1", "x2", "x3"]  # x4 is a difference
    quantum = system.implementation.measurement_quantum
    for i, (low, high) in enumerate(box.values()):
        assert low == -high and high == pytest.approx(found.peaks.states[i] + quantum[i] / 2)
        assert high >= found.peaks.states[i]
    assert box == proven_box(system)


def test_only_a_true_certificate_of_this_system_counts(certified):
    system, _, folder = certified
    with pytest.raises(certrack.InputError, match="another system"):
        proven_box(on_a_drive("dual-motor-lean", 0.01, ("x4",)), folder / "cert.json")
    body = json.loads((folder / "cert.json").read_text())
    (folder / "wrong.json").write_text(json.dumps(body | {"claim": "limsup |e_1(t)| <= 0"}))
    with pytest.raises(certrack.InputError, match="not verified"):
        proven_box(system, folder / "wrong.json")
    lean = certrack.load("dual-motor-lean")
    stages = certrack.certify(lean, "fast").stages
    certrack.certificates.save_certificate(lean, stages, folder / "continuous.json")
    with pytest.raises(certrack.InputError, match="nothing of the states"):
        proven_box(lean.replace(implementation=system.implementation), folder / "continuous.json")


def test_on_the_command_line(certified, capsys):
    _, found, folder = certified
    monitor = ("export", "st", folder / "drive.toml", "--monitor", "--out", folder / "a.st")
    assert command(capsys, *monitor, "--certificate", folder / "cert.json")[0] == 0
    text = (folder / "a.st").read_text()
    assert f"{found.peaks.states[1]:.6f}"[:5] in text and "x4_outside" not in text
    assert command(capsys, *monitor, "--certify", "--box", "x2", "-1", "1")[0] == 0
    assert "x2 is outside of [-1.0, 1.0]" in (folder / "a.st").read_text()
    assert command(capsys, *monitor[:3], *monitor[4:], "--certify")[0] == 2
    assert command(capsys, *monitor, "--certify", "--certificate", folder / "cert.json")[0] == 2

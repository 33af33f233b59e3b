"""Files that were made to be believed: the numbers satisfy what a careless checker asks."""

from dataclasses import replace

import flint
import independent_checker
import pytest

import certrack
from certrack.certificates import to_document, verify
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.implemented.drive import DRIVE_BITS, drive_of
from certrack.certificates.implemented.fixed_point import OutputBounds
from certrack.certificates.implemented.gains import output_gains
from certrack.certificates.implemented.outputs import output_rows
from certrack.certificates.implemented.period import one_period
from certrack.certificates.implemented.proof import ImplementedProof

#: The uncertain term drives the loop apart: 12 x_1 + 6 x_2 against poles at -2.
DRIVEN_APART = """
[plant]
states = ["x1", "x2"]
chain = [1]
drift = "{drift}"
input_gain = 1
gain_sign = 1
[plant.uncertainty]
tau = [0, 1]
gamma = [0, 0]
beta = [0, 0.1]
Delta = [[0, 0], [12, 6]]
[truth]
input_gain = 1
omega = [0, "12*x1 + 6*x2"]
[reference]
signal = "0.1*sin(t)"
[law]
kind = "robust"
c = [2, 2]
feedforward = 1
[simulation]
x0 = [0.01, 0]
duration = 5
[implementation]
period = 0.01
"""


def test_negative_bounds_of_states_prove_nothing():
    """Where F grows faster than v, -v is above F(-v): the loop below leaves every bound."""
    system = certrack.loads(DRIVEN_APART.format(drift=0))
    assert not certrack.certify(system).implemented.exists
    assert certrack.simulate(system).metrics.tail_error > 1e6
    proof = ImplementedProof("0", (1, 1), 11, ("-1000", "-300"), "-1000", "0.000001", "0.000001")
    with flint.ctx.workprec(DRIVE_BITS):
        period = one_period(drive_of(system), proof.parts)
        rows = output_rows(period)
        bounds = OutputBounds.of(period, rows, output_gains(period, rows, proof.doublings))
        image = bounds.image([flint.fmpq(-1000), flint.fmpq(-300)], flint.fmpq(-1000))
    assert all(image[i] < v for i, v in ((1, -1000), (2, -300), (3, -1000)))  # v > F(v)
    assert image[0] < 0
    document = to_document(system, proof)
    verdict = verify(document)
    assert not verdict.verified and "negative" in verdict.reason
    with pytest.raises(independent_checker.Refused, match="negative"):
        independent_checker.check(document)
    assert not verify(to_document(system, replace(proof, input="1000"))).verified


@pytest.mark.parametrize("drift", ["atan(tan(x1))", "atan((1 + x1)/(1 - x1)) - atan(x1)"])
def test_a_drift_whose_slope_is_constant_may_still_jump(drift):
    text = DRIVEN_APART.format(drift=drift).replace("[[0, 0], [12, 6]]", "[[0, 0], [0, 0]]")
    with pytest.raises(NoCertificate, match="only loops that are linear"):
        drive_of(certrack.loads(text))


def test_a_file_that_was_changed_is_refused_before_its_proof_is_read():
    system = certrack.loads(DRIVEN_APART.format(drift=0))
    proof = ImplementedProof("0", (1, 1), 11, ("1", "1"), "1", "0.000001", "0.000001")
    document = to_document(system, proof)
    assert "changed" not in verify(document).reason
    changed = document | {"made_by": "certrack 99"}
    assert verify(changed).reason == "the file was changed after it was made"

"""The prover of cells, with parts that are made up: what is asked, in what order, what fails."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from test_range_algebra import FIRST_ORDER, exact

import certrack
from certrack.certificates.certificate import NoCertificate
from certrack.certificates.ranges import certify, proofs, tube
from certrack.certificates.ranges.certify import _certificate, _certificates
from certrack.certificates.ranges.costs import ConstantCost
from certrack.certificates.ranges.peak import UNBOUNDED, _bound
from certrack.certificates.ranges.proofs import CellProof, RangeProver, check_cells
from certrack.certificates.ranges.search import RangeBounds
from certrack.certificates.ranges.strength import all_hold
from certrack.certificates.ranges.vertices import VertexSolution
from certrack.certificates.semidefinite import Solution

P = sympy.Symbol("p")


@dataclass(frozen=True)
class Law:
    """What an adaptation knows of the ranges."""

    gains: tuple = ("its own",)
    theta_box: tuple = ("its own",)


def prover(law=None, gain=None, theta=None):
    made = object.__new__(RangeProver)
    object.__setattr__(made, "_adaptation", law)
    object.__setattr__(made, "loop", SimpleNamespace(estimated=(gain, theta), symbols=(P,)))
    return made


def cell(low, high):
    return ((exact(low), exact(high)),)


def test_the_leakage_knows_gain_and_theta_of_a_cell():
    """At its ends; where they are one number, once."""
    assert prover()._leakage(cell(1, 2)) is None
    law = prover(Law(), 3 * P)._leakage(cell(1, 2))
    assert sorted(law.gains) == [exact(3), exact(6)] and law.theta_box == ("its own",)
    assert sorted(prover(Law(), -P)._leakage(cell(1, 2)).gains) == [exact(1), exact(2)]
    assert prover(Law(), P)._leakage(cell(2, 2)).gains == (exact(2),)
    law = prover(Law(), None, (P, 5 - P))._leakage(cell(1, 2))
    assert law.gains == ("its own",)
    assert law.theta_box == ((exact(1), exact(2)), (exact(3), exact(4)))
    assert prover(Law(), None, ())._leakage(cell(1, 2)) == Law()
    for low, high in ((-1, 2), (0, 2), (-2, 0)):
        with pytest.raises(NoCertificate, match="may vanish"):
            prover(Law(), P)._leakage(cell(low, high))


class Known:
    """A prover whose cells are a row of numbers, with the slope of a term behind each."""

    def __init__(self, by_peak_gains=True, moving=0, reason=""):
        self.box = cell(0, 4) + (cell(-1, 1) if moving else ())
        self.loop = SimpleNamespace(moving=moving)
        self.by_peak_gains, self.reason, self.checked = by_peak_gains, reason, []

    def check(self, proof):
        self.checked.append(proof.cell)
        return self.reason


def of(*ends, bound="1", slope=None):
    extra = () if slope is None else (slope,)
    return [CellProof(((a, b), *extra), bound) for a, b in ends]


def checked(monkeypatch, known, entries, bound="1", vary=False):
    asked = []
    monkeypatch.setattr(proofs, "prover_of", lambda system, n: asked.append(n) or known)
    system = SimpleNamespace(
        plant=SimpleNamespace(uncertainty=SimpleNamespace(constants_vary=vary))
    )
    reason = check_cells(system, entries, bound)
    assert not asked or asked == [max((len(entry.cell) for entry in entries), default=0)]
    return reason


HALVES = (("0", "2"), ("2", "4"))


def test_cells_are_proven_one_by_one(monkeypatch):
    known = Known()
    assert checked(monkeypatch, known, of(*HALVES)) == ""
    assert known.checked == [((("0", "2")),), ((("2", "4")),)]
    assert checked(monkeypatch, Known(reason="fails"), of(*HALVES)) == "fails"
    assert "smaller than that of a cell" in checked(monkeypatch, Known(), of(*HALVES), "0.999")
    assert checked(monkeypatch, Known(), of(*HALVES), "1.001") == ""
    assert "cover" in checked(monkeypatch, Known(), of(("0", "2")))
    assert "cover" in checked(monkeypatch, Known(), [])
    assert "one interval" in checked(monkeypatch, Known(), of(*HALVES, slope=("0", "1")))
    monkeypatch.setattr(proofs, "MAX_PROOF_CELLS", 1)
    assert "more than 1" in checked(monkeypatch, Known(), of(*HALVES))
    assert checked(monkeypatch, Known(), of(("0", "4"))) == ""


def test_what_varies_in_time_is_in_one_cell(monkeypatch):
    whole = of(("0", "4"))
    assert checked(monkeypatch, Known(), whole, vary=True) == ""
    assert "need one cell" in checked(monkeypatch, Known(), of(*HALVES), vary=True)
    assert "adaptive law" in checked(monkeypatch, Known(False), whole, vary=True)
    assert checked(monkeypatch, Known(False), whole) == ""


def test_no_cell_cuts_the_slope_of_a_term(monkeypatch):
    known = Known(moving=1)
    assert checked(monkeypatch, known, of(*HALVES, slope=("-1", "1"))) == ""
    cut = [*of(("0", "4"), slope=("-1", "0")), *of(("0", "4"), slope=("0", "1"))]
    assert "cuts the slope" in checked(monkeypatch, Known(moving=1), cut)


@pytest.mark.parametrize("by_peak_gains", [True, False])
@pytest.mark.parametrize("solution", [None, "found"])
def test_whether_a_cell_holds_or_promises_to(monkeypatch, by_peak_gains, solution):
    """By peak gains, or else by a quadratic function; a promise rests on floats alone."""
    steps = {"peak": None, "problems": ["p"], "proven": ("stage",)}

    class Prover(RangeProver):
        def __init__(self):
            object.__setattr__(self, "loop", "loop")

        by_peak_gains = property(lambda self: by_peak_gains_now)
        coefficients = "coefficients"

        def peak(self, cell):
            return steps["peak"]

        def problems(self, cell):
            if steps["problems"] is None:
                raise NoCertificate("none")
            return steps["problems"]

    by_peak_gains_now = by_peak_gains
    made = Prover()

    def bound(*_):
        if steps["peak"] is None:
            raise NoCertificate("none")

    monkeypatch.setattr(proofs, "peak_bound", bound)
    monkeypatch.setattr(proofs, "_slow_solution", lambda problems: solution)
    monkeypatch.setattr(proofs, "prove_vertices", lambda problems, found: steps["proven"])
    assert made.holds("cell") == made.promises("cell") == (solution is not None)
    steps["proven"] = None
    assert not made.holds("cell") and made.promises("cell") == (solution is not None)
    steps["problems"] = None
    assert not made.holds("cell") and not made.promises("cell")
    steps["peak"] = "proof"
    assert made.holds("cell") == made.promises("cell") == by_peak_gains


def test_all_boxes_hold_or_none():
    assert all_hold(SimpleNamespace(holds=lambda box: True), ["a", "b"])
    assert not all_hold(SimpleNamespace(holds=lambda box: box == "a"), ["a", "b"])

    def refused(box):
        raise NoCertificate("none")

    assert not all_hold(SimpleNamespace(holds=refused), ["a"])


def test_what_a_constant_costs_is_the_difference_of_two_bounds():
    found = ConstantCost("m", 1.0, 2.0, 3.0, known=0.25, bound=1.0)
    assert found.cost == 0.75 and found.record()["range"] == [1.0, 3.0]
    none = ConstantCost("m", 1.0, 2.0, 3.0, known=0.25, bound=math.inf)
    assert math.isnan(none.cost)
    assert found.record() == {
        "name": "m",
        "range": [1.0, 3.0],
        "nominal": 2.0,
        "bound_if_known": 0.25,
        "cost": 0.75,
        "verified": True,
    }


def test_a_gain_too_large_for_floats_is_no_bound():
    with pytest.raises(NoCertificate, match="not below 1"):
        _bound(lambda v: np.minimum(1 + 10 * v, UNBOUNDED), 2)
    assert _bound(lambda v: np.array([UNBOUNDED / 10, 0.0]), 2) == pytest.approx(UNBOUNDED / 10)


def stages(*alphas, bound="0.5"):
    """A cell by a quadratic function of each rate, or by peak gains where there is none."""
    points = [(SimpleNamespace(alpha=alpha),) * 2 if alpha else () for alpha in alphas]
    return tuple(CellProof((), bound, entry) for entry in points)


def test_a_certificate_of_cells_has_their_largest_bound_and_lowest_rate():
    """Delta is what makes the bound: bound^2 = 2 Delta/alpha."""
    system = certrack.loads(FIRST_ORDER)
    proofs = (*stages("4", bound="0.25"), *stages("3", bound="0.5"))
    found = _certificate("cells", system, proofs)
    assert (found.kind, found.bound, found.alpha, found.verified) == ("cells", 0.5, 3.0, True)
    assert found.delta == 0.375 and found.assumptions
    mixed = _certificate("cells", system, stages("4", None))
    assert math.isnan(mixed.alpha) and math.isnan(mixed.delta) and mixed.bound == 0.5


def test_the_best_of_the_ranges_is_saved():
    system = certrack.loads(FIRST_ORDER)
    one, two = (CellProof((), bound) for bound in ("0.5", "0.25"))
    bounds = RangeBounds(one, two, (one, one))
    found = _certificates(system, bounds, 0.1, False, "default")
    assert found.best.kind == "peak" and found.proof == (two,) and found.vertex_proof is one
    cells = _certificates(system, RangeBounds(one, None, (two, two)), None, False, "default")
    assert cells.best.kind == "cells" and cells.proof == (two, two)
    assert "not below 1" in cells.peak.reason
    same = _certificates(system, RangeBounds(one, one, (one,)), None, False, "default")
    assert same.best.kind == "cells"
    for varies, effort, reason in (
        (True, "default", "stand still"),
        (False, "fast", "take more time"),
        (False, "high", "no cells found"),
    ):
        none = _certificates(system, RangeBounds(None, None, ()), None, varies, effort)
        assert reason in none.cells.reason and none.proof == () and none.vertex_proof is None
        assert "no quadratic function" in none.vertices.reason


def test_what_is_attained_is_the_worst_of_all_corners(monkeypatch):
    asked, errors = [], iter([0.25, 0.75, 0.5, 0.125])

    def attained(loop, corner, Y):
        asked.append((corner, Y))
        error = next(errors)
        return None if error is None else SimpleNamespace(error=error)

    monkeypatch.setattr(certify, "attained_at", attained)
    reference = SimpleNamespace(bounds=lambda order: SimpleNamespace(values=("Y", order)))
    loop = SimpleNamespace(
        brackets=(),
        moving=0,
        system=SimpleNamespace(reference=reference),
        coordinates=SimpleNamespace(q=2),
    )
    prover = SimpleNamespace(loop=loop, by_peak_gains=True, box=((1, 2), (3, 4)))
    assert certify.attainable_error(prover) == 0.75
    assert [corner for corner, _ in asked] == [(1, 3), (1, 4), (2, 3), (2, 4)]
    assert asked[0][1] == ("Y", 3)
    errors = iter([0.25, None])
    assert certify.attainable_error(prover) is None
    for changed in ({"brackets": (1,)}, {"moving": 1}):
        other = SimpleNamespace(**{**vars(loop), **changed})
        nothing = SimpleNamespace(loop=other, by_peak_gains=True, box=prover.box)
        assert certify.attainable_error(nothing) is None
    assert certify.attainable_error(SimpleNamespace(loop=loop, by_peak_gains=False)) is None


@pytest.mark.parametrize("verified", [True, False])
def test_the_tube_of_a_box_is_the_widest_of_its_points(monkeypatch, verified):
    values = iter([(4.0, 1.0, 0.5), (9.0, 0.25, 0.5), (1.0, 2.0, 0.5)])
    asked = []

    def single(system, problem, stage, starts):
        asked.append((problem, stage, starts))
        return next(values)

    made = SimpleNamespace(problems=lambda cell: asked.append(cell) or ["a", "b", "c"])
    monkeypatch.setattr(tube, "prover_of", lambda system, count: made if count == 1 else None)
    monkeypatch.setattr(tube, "starts_of", lambda system, box: (("starts", box), verified))
    monkeypatch.setattr(tube, "single_stage", single)
    proof = CellProof((("1", "2"),), "1", ("x", "y", "z"))
    found = tube.range_tube("system", proof, "box")
    assert (found.start, found.floor, found.alpha) == (9.0, 2.0, 0.5)
    assert found.verified == verified and asked[0] == cell(1, 2)
    starts = ("starts", "box")
    assert asked[1:] == [("a", "x", starts), ("b", "y", starts), ("c", "z", starts)]


def test_the_tube_of_a_box_with_one_point_is_that_point_s(monkeypatch):
    made = SimpleNamespace(problems=lambda cell: ["a"])
    monkeypatch.setattr(tube, "prover_of", lambda system, count: made)
    monkeypatch.setattr(tube, "starts_of", lambda system, box: ((), True))
    monkeypatch.setattr(tube, "single_stage", lambda *parts: (4.0, 1.0, 0.5))
    found = tube.range_tube("system", CellProof((("1", "1"),), "1", ("x",)))
    assert (found.start, found.floor, found.alpha) == (4.0, 1.0, 0.5)


@pytest.mark.parametrize(
    ("delta", "alpha", "bound"), [(4.0, 2.0, 2.0), (1.5, 3.0, 1.0), (-1, 2, 0)]
)
def test_the_bound_of_what_a_solver_found(delta, alpha, bound):
    """bound^2 = 2 Delta/alpha; what is below zero by its roundings is zero."""
    none = np.zeros(0)
    vertices = VertexSolution(alpha, np.eye(1), (), (), delta)
    one = Solution(alpha, np.eye(1), none, none, none, delta, none)
    assert vertices.bound == one.bound == bound

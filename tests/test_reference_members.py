"""What the members of a reference must give: one that is right, and each of them wrong."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import TIME, parse
from certrack.references import profile, registry, samples, soft_start
from certrack.references.registry import _check_values
from certrack.references.search import Formula
from certrack.references.smoothness import Stretch

A, PIECE = sympy.Symbol("ref_a", real=True), sympy.Symbol("piece_b", real=True)


class Line:
    """y_d = a t + b with b = 3 from t = 1 on, as formulas and values."""

    parameter_symbols, parameter_values = (A,), (2.0,)
    piece_symbols = (PIECE,)

    def __init__(self, **changed):
        for name, value in changed.items():
            setattr(self, name, value)

    def formulas(self, order):
        return (A * TIME + PIECE, A, sympy.S.Zero)[: order + 1]

    def breaks(self, start, end):
        return np.array([1.0])

    def piece_values(self, t):
        return np.array([3.0 if t >= 1 else 0.0])

    def values(self, t, order):
        t = np.asarray(t)
        return np.array([2 * t + np.where(t >= 1, 3.0, 0.0), 0 * t + 2.0, 0 * t])[: order + 1]


@pytest.fixture(autouse=True)
def known(monkeypatch):
    monkeypatch.setattr(registry, "kind_of", lambda reference: "line")


def test_a_reference_whose_members_agree():
    for order in (0, 1, 2):
        _check_values(Line(), order, 4.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"parameter_values": (2.0, 1.0)}, "parameter_values must have the count 1"),
        ({"parameter_values": ()}, "parameter_values must have the count 1"),
        ({"formulas": lambda order: (A * TIME + PIECE,)}, "formulas must have the count 2"),
        ({"formulas": lambda order: (A * TIME + PIECE, A, A)}, "formulas must have the count 2"),
        ({"piece_values": lambda t: np.array([0.0, 3.0])}, "piece_values must have the count 1"),
        ({"values": lambda t, order: np.zeros((1, len(t)))}, "values must have the shape"),
        ({"values": lambda t, order: np.zeros((2, len(t) + 1))}, "values must have the shape"),
        ({"parameter_symbols": (sympy.Symbol("a"),)}, "symbols must begin with"),
        ({"formulas": lambda order: (A * TIME, A + sympy.Symbol("other"))}, "other"),
        ({"breaks": lambda start, end: [1.0, 1.0]}, "must increase strictly"),
        ({"breaks": lambda start, end: [2.0, 1.0]}, "must increase strictly"),
        ({"breaks": lambda start, end: [0.0, 1.0]}, "must increase strictly"),
        ({"breaks": lambda start, end: [1.0, 4.0]}, "must increase strictly"),
        ({"breaks": lambda start, end: [-1.0]}, "must increase strictly"),
    ],
)
def test_each_member_that_is_wrong_is_named(changed, message):
    with pytest.raises(InputError, match=message):
        _check_values(Line(**changed), 1, 4.0)


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("off", [1e-3, -1e-3, math.nan, math.inf])
def test_values_and_formulas_agree_in_every_derivative(order, off):
    line = Line()

    def values(t, count):
        table = line.values(t, count)
        table[order] = table[order] + off
        return table

    with np.errstate(all="ignore"), pytest.raises(InputError, match=rf"y_d\^\({order}\) differ"):
        _check_values(Line(values=values), 1, 4.0)


def test_the_target_of_a_soft_start_is_looked_at():
    rest = {"order": 2.0, "declared_bound": None, "bounds": None}
    right, wrong = Line(**rest), Line(**rest, values=lambda t, order: np.zeros((order + 1, len(t))))
    registry.check_reference(soft_start.SoftStart(right, 1.0), 1, 4.0)
    with pytest.raises(InputError, match="differ"):
        registry.check_reference(soft_start.SoftStart(wrong, 1.0), 1, 4.0)


@pytest.mark.parametrize("times", [(0, 1, 1, 2), (0, 1, 0.5, 2)])
def test_times_of_a_profile_increase(times):
    with pytest.raises(InputError, match=r"reference\.times\[2\]: times must increase"):
        profile(times, (0, 0), (1, 0, -1))


def test_a_class_that_is_not_registered_is_refused(monkeypatch):
    monkeypatch.setattr(registry, "kind_of", lambda reference: None)
    with pytest.raises(InputError, match="not registered"):
        _check_values(Line(), 1, 4.0)


@pytest.mark.parametrize(
    ("breaks", "apart"), [([], 3.0), ([2.5], 1.5), ([1.0], 3.0), ([0.25, 9.0], 0.75)]
)
def test_jumps_of_a_soft_start_are_as_near_as_those_of_its_target(monkeypatch, breaks, apart):
    """Where the transient ends, at t = 1, too; a break that is there is the same one."""
    asked = []
    target = SimpleNamespace(breaks=lambda *span: asked.append(span) or breaks)
    start = SimpleNamespace(
        order=2, start=(1.0,), target=target, transient=1.0, _transient=lambda order: 0.25
    )
    monkeypatch.setattr(soft_start, "jumps", lambda reference, order: (0.5, 3.0))
    size, spacing = soft_start.SoftStart.jumps(start, 2)
    assert 0.75 <= size < 0.75 * (1 + 1e-9) and asked == [(0.0, 5.0)]
    assert apart * (1 - 2e-9) < spacing < apart
    assert soft_start.SoftStart.jumps(start, 1) is None
    monkeypatch.setattr(soft_start, "jumps", lambda reference, order: None)
    assert soft_start.SoftStart.jumps(start, 2) == (0.25, math.inf)
    start.start = ()
    assert soft_start.SoftStart.jumps(start, 2) is None


@pytest.mark.parametrize(
    ("text", "period"),
    [
        ("sin(t) + cos(2*t)", 2 * math.pi),
        ("sin(3*t)*cos(2*t)", 2 * math.pi),
        ("sin(4*t + 1)", math.pi / 2),
        ("sin(t) + sin(sqrt(2)*t)", math.inf),
        ("t*sin(t)", math.inf),
        ("exp(-t)", math.inf),
        ("1/(2 + sin(t/3))", 6 * math.pi),
    ],
)
def test_a_bound_is_looked_for_within_one_period(text, period):
    formula = Formula(parse("", text, ["t"]).expr)
    assert formula.end == pytest.approx(period, rel=1e-9) and formula.end >= period


@pytest.mark.parametrize("interpolation", ["cubic", "spline", "monotone"])
def test_samples_that_are_too_close_are_refused(interpolation):
    """Two of them are enough."""
    times = (0.0, 1e-200, 1.0, 2.0, 3.0, 4.0, 5.0)
    values = (0.0, 1.0, 0.0, 1.0, 0.5, 0.25, 0.0)
    with np.errstate(all="ignore"), pytest.raises(InputError):
        samples(times, values, interpolation=interpolation)


@pytest.mark.parametrize(("begin", "end"), [("0", "oo"), ("1/3", "2/3"), ("sqrt(2)", "oo")])
def test_the_times_of_a_stretch_are_rounded_outward(begin, end):
    exact = sympy.sympify(begin), sympy.sympify(end)
    found = Stretch(*exact, parse("", "exp(-t)", ["t"]).expr).bounded()
    assert sympy.Rational(found.begin) <= exact[0] and found.begin == pytest.approx(float(exact[0]))
    assert found.end == pytest.approx(float(exact[1])) and bool(exact[1] <= found.end)

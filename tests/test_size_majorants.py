"""Proofs of |f| <= b(|x_i|, ||S x||): each way to a proof, up to the number where it ends."""

from fractions import Fraction

import pytest
import sympy

from certrack.certificates.arithmetic import as_sympy
from certrack.certificates.assumption_1 import UncertainTerm
from certrack.certificates.size_majorants import Sizes, stays_below
from certrack.core.expressions import parse, symbol
from certrack.model.growth import NORM

STATES = (symbol("x1"), symbol("x2"))
NAMES = ("t", "x1", "x2", NORM)


def fractions(*numbers):
    return tuple(map(Fraction, numbers))


def below(text, bound, c, weights=("1", "1"), region=None, norm="6", strength="1"):
    """Whether |text| <= bound is proven where the bound's letter c is a number."""
    names = {"c": as_sympy(Fraction(c))}
    limits = None if region is None else fractions(*region)
    sizes = Sizes(STATES, fractions(*weights), limits, Fraction(norm))
    inside = parse("", bound, [*NAMES, "c"]).expr.xreplace({symbol("c"): names["c"]})
    return stays_below(parse("", text, NAMES).expr, inside, sizes, Fraction(strength))


EDGES = [
    # the same parts, of sums, products, powers and magnitudes
    ("3*x1", "c*x1", "3", {}),
    ("3*x1", "c*x1", "21/2", {"strength": "7/2"}),
    ("-3*x1*x2", "c*x1*x2", "3", {}),
    ("abs(x1) + sin(t)*x2", "x1 + c*x2", "1", {}),
    ("(x1 - 2*x2)**2", "x1**2 + c*x1*x2 + 4*x2**2", "4", {}),
    ("0.25*cos(x1)", "c", "1/4", {}),
    # a size is at most the norm, by its weight; without weights on all states it is none
    ("3*x1", "c*norm", "3/2", {"weights": ("2", "1/2")}),
    ("3*x2", "c*norm", "6", {"weights": ("2", "1/2")}),
    ("3*x1 - 3*x2", "c*norm + 3*x2", "3", {"weights": ("1", "0")}),
    ("sqrt(x1**2 + x2**2)", "c*norm", "1/2", {"weights": ("3", "2")}),
    ("sqrt(x1**2 + x2**2)", "c*x1 + x2", "1", {"weights": ("0", "1")}),
    # in a region higher powers are lower ones
    ("x1**2", "c*x1", "3", {"region": ("3", "5")}),
    ("x1**2", "c", "9", {"region": ("3", "5")}),
    ("x1*x2", "c*x1", "5", {"region": ("3", "5")}),
    ("x1*x2", "c*x2", "3", {"region": ("3", "5")}),
    ("x1**2", "c*norm", "3/2", {"region": ("3", "5"), "weights": ("2", "1")}),
    ("2*x1**2", "x1 + c", "18", {"region": ("3", "5")}),
    ("x1**3 + x1**2", "x1**2 + c*x1", "9", {"region": ("3", "5")}),
    ("x1*sqrt(x1**2 + x2**2)", "c*x1", "7", {"region": ("3", "5"), "norm": "7"}),
    ("x1**2 + x2**2", "c*x1 + x2/2 + 27", "3", {"region": ("3", "5")}),
    # what is left after a part is used up goes to the norm, then to a number
    ("x1**2", "x1 + c*norm", "2", {"region": ("3", "5")}),
    ("x1**2 + 4*x2", "x1 + 3*x2 + c", "14", {"region": ("3", "5")}),
]


@pytest.mark.parametrize(("text", "bound", "edge", "sizes"), EDGES)
def test_a_bound_is_proven_up_to_its_edge(text, bound, edge, sizes):
    edge = Fraction(edge)
    assert below(text, bound, edge, **sizes)
    assert below(text, bound, 2 * edge, **sizes)
    assert not below(text, bound, edge * (1 - Fraction(1, 10**12)), **sizes)


@pytest.mark.parametrize(
    ("text", "bound", "sizes"),
    [
        ("x1", "c*norm", {"weights": ("0", "1")}),  # S does not see x1
        ("x1**2", "c*x1 + c*x2 + c", {}),  # without a region a square outgrows it
        ("x1*x2", "c*norm", {}),
        ("x1", "c", {}),
        ("x1", "c*x2", {}),
        ("x1", "c*x1 - tanh(x2)", {}),  # a part that falls
        ("x1", "c*x1 + x2*sin(x1)", {"region": ("3", "5")}),  # and one that may
        ("exp(x1)", "c + c*x1", {"region": ("3", "5")}),  # no rule
    ],
)
def test_what_no_rule_proves_is_not_proven(text, bound, sizes):
    assert not below(text, bound, 10**6, **sizes)


def test_parts_of_the_bound_that_grow_only_help():
    assert below("3*x1", "3*x1 + tanh(x2) + norm", 0)
    assert below("3*x1", "3*x1 + exp(x1*x2)", 0, region=("3", "5"))


def test_a_state_that_stays_at_zero_costs_nothing():
    assert below("1000*x1*x2", "c*x1", "1/1000", region=("3", "0"))
    assert not below("1000*x1*x2", "c*x1", "1/1000", region=("3", "2/1000000"), norm="3")


def term(text, *, growing=None, single=(), weights=("1", "1"), beta="1/5", tau="1/2"):
    """w_1 of strength 3 with gamma = 1/10."""
    bound = None if growing is None else parse("", growing, ["x1", "x2", NORM])
    numbers = fractions("3", tau, "1/10", beta)
    formula = parse("", text, NAMES).expr
    return UncertainTerm(0, formula, STATES, *numbers, fractions(*weights), single, bound)


def test_the_bound_of_a_term_has_all_its_parts():
    x1, x2, norm = (*STATES, symbol(NORM))
    whole = term("x1", single=fractions("1/7", "1/9"), weights=("2", "1")).bound
    expected = (x1 / 7 + x2 / 9 + sympy.Rational(1, 5) + norm / 10) / 2
    assert sympy.expand(whole - expected) == 0
    assert sympy.expand(term("x1", growing="x1**2 + norm").bound - (x1**2 + norm) / 2) == 0


@pytest.mark.parametrize(
    ("text", "region", "proven"),
    [
        ("x1**2/12", ("2", "1"), True),  # 3 x1^2/12 <= x1^2/4 <= x1 R_1/4: the bound is x1/2
        ("x1**2/12", ("2001/1000", "1"), False),
        ("x1**2/12", None, False),
        ("0*x1", None, True),
        ("1/(x1 - x1 + 1e-9*x2)", ("2", "1"), False),  # it may have no value
    ],
)
def test_a_term_is_proven_within_its_region(text, region, proven):
    one = term(text, growing="x1", weights=("3", "4"))
    assert one.proven_within(None if region is None else fractions(*region)) == proven
    if region is None:
        assert one.proven == proven


def test_the_norm_in_a_region_is_that_of_its_corner():
    """3 |x1| ||x||/c <= x1/2 with ||x|| <= 5 where |x1| <= 3 and |x2| <= 4: c = 30."""
    for c, proven in ((30, True), (29.999, False)):
        one = term(f"x1*sqrt(x1**2 + x2**2)/{c}", growing="x1")
        assert one.proven_within(fractions("3", "4")) == proven

"""The search of bounds for all times: its pieces, cuts and phases, and the bounds it ends with."""

import math

import numpy as np
import pytest
import sympy
from flint import arb

from certrack.core.expressions import TIME, parse
from certrack.references.growth import GrowthEnclosure, Undefined, ball
from certrack.references.search import (
    MAX_PHASES,
    MAX_TURNS,
    Formula,
    Piece,
    _closer,
    _common_divisor,
    _float_below,
    _Search,
    derivative_bound,
    float_above_ball,
    prove_defined,
)
from certrack.references.smoothness import Stretch, smoothness


def formula(text, *span):
    return Formula(parse("", text, ["t"]).expr, *span)


def test_halves_in_time():
    one, two = Piece(1.0, 4.0, None, 2).in_time()
    assert (one, two) == (Piece(1.0, 2.5, None, 3), Piece(2.5, 4.0, None, 3))
    early, late = Piece(0.25, math.inf, None).in_time()
    assert (early, late) == (Piece(0.25, 2.0, None, 1), Piece(2.0, math.inf, None, 1))
    early, late = Piece(8.0, math.inf, None).in_time()
    assert early.end == late.begin == 16.0


def test_halves_in_phase():
    whole = Piece(0.0, math.inf, ((0.0, 1.0), (0.25, 0.75), (0.5, 1.0)), 1)
    low, high = whole.in_phase(1)
    assert low == Piece(0.0, math.inf, ((0.0, 1.0), (0.25, 0.5), (0.5, 1.0)), 2)
    assert high == Piece(0.0, math.inf, ((0.0, 1.0), (0.5, 0.75), (0.5, 1.0)), 2)
    assert next(whole.in_phase(0)).phases[1:] == whole.phases[1:]
    assert next(whole.in_phase(2)).phases[:2] == whole.phases[:2]


def test_frequencies_are_multiples_of_few():
    arg = {text: parse("", f"sin({text})", ["t"]).expr.args[0] for text in ("2*t", "3*t + 1")}
    ((base, turns),) = formula("sin(2*t)*exp(-t) + cos(3*t + 1)")._tables
    assert abs(base) == 1
    found = {key: (abs(n), offset) for key, (n, offset) in turns.items()}
    assert found == {arg["2*t"]: (2, 0), arg["3*t + 1"]: (3, 1)}
    two = formula("sin(t) + sin(sqrt(2)*t) + sin(t/2) + sin(t**2 + 3*t) + sin(t**2)")._tables
    assert sorted(len(turns) for _, turns in two) == [1, 3]
    assert sorted(float(base) for base, _ in two) == pytest.approx([0.5, math.sqrt(2)])
    many = "+".join(f"sin(sqrt({n})*t)" for n in (2, 3, 5, 7))
    assert len(formula(many)._tables) == MAX_PHASES == 3
    assert len(formula(f"sin({MAX_TURNS}*t) + sin(t)")._tables) == 1
    assert len(formula(f"sin({MAX_TURNS + 1}*t) + sin(t)")._tables) == 0
    assert formula("exp(-t)")._tables == [] and formula("sin(exp(-t))")._tables == []


def test_the_largest_common_divisor_of_rationals():
    third, half = sympy.Rational(1, 3), sympy.Rational(1, 2)
    assert _common_divisor([sympy.S.One, sympy.S.One, half]) == half
    assert _common_divisor([third, half]) == sympy.Rational(1, 6)
    assert _common_divisor([sympy.Rational(4, 3), sympy.Integer(6)]) == sympy.Rational(2, 3)


@pytest.mark.parametrize(
    ("text", "turn"),
    [
        ("sin(t)*exp(-t)", 2 * math.pi),
        ("(sin(2*t) + cos(3*t))*exp(-t)", 2 * math.pi / 3),
        ("(sin(t) + cos(sqrt(2)*t))*t", math.sqrt(2) * math.pi),
        ("sin(-4*t)*t", math.pi / 2),
        ("exp(-t)", math.inf),
    ],
)
def test_how_long_a_piece_is_on_which_time_tells_the_phases(text, turn):
    assert formula(text)._turn == pytest.approx(turn)


@pytest.mark.parametrize(
    ("text", "span", "ends"),
    [
        ("exp(-t)", (0.0, 8.0), [0, 8]),
        ("exp(-t)", (0.0, 7.0), [0, 7]),
        ("exp(-t)", (), [0, 8, math.inf]),
        ("exp(-t)", (2.5, math.inf), [2.5, 11, math.inf]),
        ("exp(-t)", (2.5, 11.0), [2.5, 11]),
        ("exp(-t)", (2.5, 12.0), [2.5, 11, 12]),
        ("sin(t) + cos(2*t)", (), [0, 2 * math.pi]),
        ("sin(t) + cos(2*t)", (1.0, math.inf), [1, 1 + 2 * math.pi]),
        ("sin(t)", (1.0, 2.0), [1, 2]),
    ],
)
def test_all_times_are_in_the_first_pieces(text, span, ends):
    pieces = formula(text, *span).pieces()
    assert [p.begin for p in pieces] == pytest.approx(ends[:-1])
    assert [p.end for p in pieces] == pytest.approx(ends[1:])
    assert all(p.cuts == 0 for p in pieces)


def test_phases_are_told_apart_where_a_piece_is_long():
    wave = formula("sin(t)*exp(-t)")  # one turn in 2 pi
    long, endless = wave.pieces()
    assert long.phases == endless.phases == ((0.0, 1.0),)
    assert wave._settled(Piece(0.0, 6.25, ((0.0, 1.0),))).phases is None
    assert wave._settled(Piece(0.0, 6.5, ((0.0, 1.0),))).phases is not None
    (in_time,) = wave.possible_cuts(long)
    assert [p.phases for p in in_time] == [None, None]
    in_phase, in_time = wave.possible_cuts(endless)
    assert [p.phases for p in in_phase] == [((0.0, 0.5),), ((0.5, 1.0),)]
    assert in_time[0].end == in_time[1].begin == 16.0
    narrow = Piece(8.0, math.inf, ((0.0, 2.0**-14),))
    assert len(wave.possible_cuts(narrow)) == 1
    assert len(wave.possible_cuts(Piece(8.0, math.inf, ((0.0, 2.0**-13),)))) == 2


def test_an_evaluation_knows_its_times_and_phases():
    wave = formula("sin(2*t + 1)*exp(-t)")
    arg = parse("", "sin(2*t + 1)", ["t"]).expr.args[0]
    plain = wave.evaluation(Piece(0.0, 1.0, None), 3)
    assert plain.order == 3 and not plain.phases and not plain.smooth
    assert float(plain.time.mid()) == 0.5 and float(plain.time.rad()) == pytest.approx(0.5)
    endless = wave.evaluation(Piece(8.0, math.inf, ((0.25, 0.5),)), 2, smooth=True)
    assert isinstance(endless.time, GrowthEnclosure) and endless.smooth and endless.order == 2
    low, high = endless.time.ends()
    assert float(low) == pytest.approx(8) and math.isinf(float(high))
    phase, offset = endless.phases[arg]
    assert offset == 1 and float(phase.lower()) == pytest.approx(math.pi / 2, rel=1e-6)
    assert float(phase.upper()) == pytest.approx(math.pi, rel=1e-6)
    twice = formula("(sin(t) + sin(3*t))*exp(-t)")
    phases = twice.evaluation(Piece(0.0, math.inf, ((0.0, 0.5),)), 0).phases
    tops = sorted(float(phase.upper()) for phase, _ in phases.values())
    assert tops == pytest.approx([math.pi, 3 * math.pi], rel=1e-6)
    finite = wave.evaluation(Piece(0.0, 9.0, ((0.0, 1.0),)), 0).time
    assert float(finite.ends()[1]) == pytest.approx(9)


# what the search finds


@pytest.mark.parametrize(
    ("text", "order", "largest"),
    [
        ("exp(-t)", 0, 1.0),
        ("exp(-t)", 3, 1.0),
        ("t*exp(-t)", 0, math.exp(-1)),
        ("t*exp(-t)", 1, 1.0),
        ("t*exp(-t)", 2, 2.0),
        ("1/(1 + t)", 2, 2.0),
        ("1/(1 + t**2)", 0, 1.0),
        ("t/(1 + t**2)", 0, 0.5),
        ("tanh(t)", 1, 1.0),
        ("atan(t)", 0, math.pi / 2),
        ("sin(t)*exp(-t)", 0, math.exp(-math.pi / 4) / math.sqrt(2)),
        ("exp(sin(t))", 0, math.e),
        ("exp(sin(t))", 1, 1.4585),
        ("sin(t)/(2 + cos(t))", 0, 1 / math.sqrt(3)),
        ("sin(t)*tanh(t)", 0, 1.0),
        ("log(1 + exp(-t))", 0, math.log(2)),
        ("1 - exp(-t)", 0, 1.0),
    ],
)
def test_bounds_for_all_times(text, order, largest):
    found = derivative_bound(formula(text), order)
    f = parse("", text, ["t"]).expr.diff(TIME, order)
    t = np.concatenate([np.linspace(0, 50, 200_001), np.geomspace(50, 1e6, 1000)])
    with np.errstate(all="ignore"):
        reached = np.nan_to_num(np.abs(sympy.lambdify(TIME, f)(t))).max()
    assert reached <= found * (1 + 1e-12) and found <= reached * (1 + 5e-3)
    assert found == pytest.approx(largest, rel=2e-3)


@pytest.mark.parametrize(
    ("text", "span", "largest"),
    [
        ("exp(-t)", (1.0, 2.0), math.exp(-1)),
        ("t**2", (1.0, 3.0), 9.0),
        ("sin(t)", (0.25, 0.5), math.sin(0.5)),
        ("t*exp(-t)", (2.0, math.inf), 2 * math.exp(-2)),
        ("sin(t)", (2.0, math.inf), 1.0),
    ],
)
def test_bounds_between_two_times(text, span, largest):
    found = derivative_bound(formula(text, *span), 0)
    assert largest * (1 - 1e-14) <= found <= largest * 1.001


@pytest.mark.parametrize("text", ["t", "exp(t)", "t*sin(t)", "log(1 + t)"])
def test_what_grows_for_ever_has_no_bound(text):
    assert derivative_bound(formula(text), 0) is None


@pytest.mark.parametrize(
    "text", ["1/(1 + t)", "log(1 + t)", "sqrt(1 + sin(t)/2)", "1/(2 + sin(t))"]
)
def test_what_is_defined_everywhere(text):
    for smooth in (False, True):
        prove_defined(formula(text), smooth=smooth)


@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("1/(t - 3)", "near t = 3$|near t = 2.99|near t = 3.00"),
        ("log(20 - t)", "near t = (20|19.9|2[0-9])"),
        ("sqrt(t - 1/2)", "near t = (0|0.49|0.5)"),
        ("tan(t)", "near t = 1.5"),
    ],
)
def test_where_it_is_not_defined(text, at):
    with pytest.raises(Undefined, match=at):
        prove_defined(formula(text), smooth=False)


def test_kinks_are_not_smooth():
    prove_defined(formula("abs(t - 1)**(1/2)"), smooth=False)
    with pytest.raises(Undefined):
        prove_defined(formula("abs(t - 1)**(1/2)"), smooth=True)
    prove_defined(formula("asin(sin(t))"), smooth=False)
    with pytest.raises(Undefined):
        prove_defined(formula("asin(sin(t))"), smooth=True)


# one bound


def test_the_bound_on_one_piece():
    search = _Search(formula("t*exp(-t)"), 1)  # (1 - t) e^-t
    found = search.bound(Piece(0.0, 0.5, None))
    assert found == pytest.approx(1.0, rel=1e-6) and found >= 1
    assert 1 - 1e-9 <= search.reached <= 1 and search.work > 0
    endless = search.bound(Piece(8.0, math.inf, ()))
    assert 7 * math.exp(-8) <= endless < 10 * math.exp(-8)
    growing = _Search(formula("t"), 0)
    assert growing.bound(Piece(8.0, math.inf, ())) == math.inf
    assert _Search(formula("1/(t - 1)"), 0).bound(Piece(0.0, 2.0, None)) == math.inf


def test_the_centred_form():
    """Of what rises or falls the ends; else the middle, and the slope times the distance."""
    falling = _Search(formula("exp(-t)"), 0)
    value = falling._centred(Piece(0.0, 1.0, None))
    assert float(value.lower()) == pytest.approx(math.exp(-1), rel=1e-6)
    assert float(value.upper()) == pytest.approx(1, rel=1e-6)
    assert falling.reached == pytest.approx(1)
    rising = _Search(formula("exp(t)"), 2)._centred(Piece(0.0, 1.0, None))
    assert float(rising.upper()) == pytest.approx(math.e, rel=1e-6)
    assert float(rising.lower()) == pytest.approx(1, rel=1e-6)
    hill = _Search(formula("t - t**2"), 0)
    value = hill._centred(Piece(0.0, 1.0, None))  # 1/4 + [-1, 1] [-1/2, 1/2]
    assert float(value.lower()) == pytest.approx(-0.25, abs=1e-6)
    assert float(value.upper()) == pytest.approx(0.75, abs=1e-6)
    third = _Search(formula("t**3"), 3)._at(arb(2))
    assert float(third) == 6


def test_what_is_closer():
    near, far, unknown = ball(-1, 2), ball(-3, 1), arb("nan")
    assert _closer(near, far) is near and _closer(far, near) is near
    assert _closer(near, unknown) is near and _closer(unknown, near) is near
    assert _closer(arb("inf"), near) is near


def test_floats_beside_points():
    third = arb(1) / 3
    assert arb(float_above_ball(third.upper())) >= third
    assert float_above_ball(arb(0.5)) == 0.5 and float_above_ball(arb("inf")) == math.inf
    assert float_above_ball(third.upper()) == pytest.approx(1 / 3, rel=1e-14)
    assert 0 < 0.5 - _float_below(arb(0.5)) < 1e-15 and _float_below(arb("inf")) == 0.0
    assert _float_below(third) == pytest.approx(1 / 3, rel=1e-14)


# stretches


def test_bounds_on_a_stretch():
    half, two = sympy.Rational(1, 2), sympy.Integer(2)
    line = Stretch(half, two, TIME**2 - TIME)
    assert line.bound(0) == 2.0 and line.bound(1) == 3.0 and line.bound(2) == 2.0
    assert line.bound(3) == 0.0
    deep = Stretch(sympy.S.Zero, sympy.S.One, TIME**2 - TIME)
    assert 0.25 <= deep.bound(0) <= 0.25 * (1 + 1e-12)
    root = Stretch(sympy.sqrt(2), two, TIME**2)
    assert 4 <= root.bound(0) <= 4.001
    scaled = Stretch(half, two, sympy.pi * TIME)
    assert 2 * math.pi <= scaled.bound(0) * (1 + 1e-12) <= 2.001 * math.pi
    assert Stretch(half, sympy.oo, TIME).bound(0) is None
    assert Stretch(half, sympy.oo, TIME).bound(1) == 1.0


@pytest.mark.parametrize(
    ("text", "begins"),
    [
        ("abs(t - 1) + abs(t - 2)", [0, 1, 2]),
        ("abs(t - 1) - abs(1 - t) + exp(-t)", [0]),
        ("abs(abs(t - 2) - 1)", [0, 1, 2, 3]),
        ("max(0, min(1, t/3 - 1))", [0, 3, 6]),
        ("abs(t**2 - 1)", [0]),
    ],
)
def test_stretches_begin_at_the_kinks(text, begins):
    found = smoothness(parse("", text, ["t"]).expr)
    assert [float(s.begin) for s in found.stretches] == begins
    assert [s.end for s in found.stretches[:-1]] == [s.begin for s in found.stretches[1:]]
    assert found.stretches[-1].end is sympy.oo
    f = sympy.lambdify(TIME, parse("", text, ["t"]).expr)
    for s in found.stretches:
        end = float(s.end) if s.end is not sympy.oo else float(s.begin) + 3
        t = np.linspace(float(s.begin), end, 7)
        if not s.formula.has(sympy.Abs):
            values = np.broadcast_to(sympy.lambdify(TIME, s.formula)(t), t.shape)
            assert values == pytest.approx(np.array([float(f(x)) for x in t]), abs=1e-12)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_order_is_the_first_derivative_that_jumps(n):
    found = smoothness(parse("", f"max(t - 1, 0)**{n}", ["t"]).expr)
    assert found.order == n
    assert found.jumps(n) == ((1.0, float(math.factorial(n))),)
    assert found.jumps(n - 1) == ()
    assert found.bound(n) == math.factorial(n) and found.bound(n + 1) == 0.0
    assert found.bound(0) is None

"""What the printers of all languages share."""

import itertools
import re

import numpy as np
import pytest
import sympy

from certrack.core.errors import InputError
from certrack.core.kinks import fold_minmax, without_minmax
from certrack.core.lowering import numpy_callable
from certrack.core.printing import ATOM, PRODUCT, SUM, FormulaPrinter, recognise_selection
from certrack.core.select import Select, larger, magnitude, smaller
from certrack.export.c.printer import CPrinter, helper_definition
from certrack.export.st.statements import Statements, Variables
from certrack.integrators.many.native_source import VectorPrinter

a, b, c = SYMBOLS = sympy.symbols("a b c", real=True)
NAMES = {name: name.name for name in SYMBOLS}

MEANING = {"max": max, "min": min, "abs": abs, "clamp": lambda low, x, high: min(max(low, x), high)}


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        (larger(a, b), ("max", (a, b))),
        (smaller(a, b), ("min", (b, a))),
        (magnitude(a + b), ("abs", (a + b,))),
        (Select(a, b, a, Select(b, c, c, b)), ("clamp", (a, b, c))),
        (Select(0, b, 0, Select(b, 1, 1, b)), ("clamp", (0, b, 1))),
        (Select(a, b, c, a), None),
        (Select(a, 0, -a, a), None),
        (Select(a, b, a, Select(b, c, b, c)), None),
        (Select(a, b, a, Select(c, b, b, c)), None),
        (Select(a, 1, a, -a), None),
        (sympy.Abs(a), None),
    ],
)
def test_recognised_selections(choice, expected):
    assert recognise_selection(choice) == expected


def test_a_recognised_selection_has_the_value_of_the_selection():
    """For every choice among a few parts."""
    parts, count = (a, b, -a, sympy.Integer(0)), 0
    inner = [Select(*four) for four in itertools.product((a, b, c), repeat=4)]
    choices = [Select(*four) for four in itertools.product(parts, repeat=4)]
    choices += [Select(x, y, x, no) for x, y in itertools.permutations(SYMBOLS, 2) for no in inner]
    points = [(x, y, z) for x, y, z in itertools.product((-1.0, 0.0, 2.0), repeat=3) if x <= z]
    for choice in choices:
        if (usual := recognise_selection(choice)) is None:
            continue
        count += 1
        name, arguments = usual
        values = numpy_callable(SYMBOLS, [*arguments, choice])
        for point in points:
            *numbers, value = (float(v) for v in values(*point))
            if name == "clamp" and numbers[0] > numbers[2]:
                continue  # it has no interval
            assert MEANING[name](*numbers) == value, (choice, point)
    assert count > 10


def test_min_and_max_are_folded_from_the_left():
    formula = sympy.Max(a, b, c) + sympy.Min(a, b * c, 2)
    points = np.random.default_rng(0).normal(size=(3, 100)) * 2
    expected = np.maximum.reduce(points) + np.minimum.reduce(
        [points[0], points[1] * points[2], np.full(100, 2.0)]
    )
    for folded in (without_minmax(formula), fold_minmax(formula, larger, smaller)):
        assert not folded.has(sympy.Max, sympy.Min)
        (values,) = numpy_callable(SYMBOLS, [folded])(*points)
        assert values == pytest.approx(expected, rel=1e-14)


def printers():
    return {
        "C": CPrinter(NAMES, "double", []),
        "st": Statements(Variables(NAMES)),
        "vectors": VectorPrinter(NAMES),
    }


@pytest.mark.parametrize("language", printers())
def test_what_a_language_lacks_is_refused(language):
    with pytest.raises(InputError, match="form of the function gamma"):
        printers()[language].text(sympy.gamma(a))
    with pytest.raises(InputError, match="form of the function Derivative"):
        printers()[language].text(sympy.Derivative(a, b, evaluate=False))


@pytest.mark.parametrize("language", printers())
def test_numbers_are_computed(language):
    """A part without symbols is one number, correctly rounded."""
    printer = printers()[language]
    for number in (sympy.Rational(1, 3), sympy.pi**2, sympy.sqrt(2) + 1, sympy.exp(1)):
        assert printer.text(number) == repr(float(number))
    assert printer.text(sympy.Integer(-2)) == "-2.0"
    assert printer.text(sympy.Integer(-2), ATOM) == "(-2.0)"


def test_parentheses_where_they_are_wanted():
    assert VectorPrinter(NAMES).text(a * b, ATOM) == "(a*b)"
    st = Statements(Variables(NAMES))
    assert st.text(a - b * c) == "a - b * c"
    assert st.text(a - b * c, PRODUCT) == "(a - b * c)"
    assert st.text(a / (b * c)) == "a / b / c"
    code = CPrinter(NAMES, "double", [])
    assert code.text(a - b * c) == "a - (b * c)"
    assert code.text(a * 2 / (b * c)) == "(2.0 * a) / (b * c)"
    assert code.text(-(a**-2), SUM) == "-(1.0 / (a * a))"


def test_an_unfinished_language_says_so():
    with pytest.raises(NotImplementedError):
        FormulaPrinter(NAMES).text(sympy.Integer(1))


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (sympy.sqrt(a), "sqrt(a)"),
        (1 / sympy.sqrt(a), "1.0 / sqrt(a)"),
        (a**3, "a * a * a"),
        (a**-2, "1.0 / (a * a)"),
        (a ** sympy.Rational(1, 3), "pow(a, 0.3333333333333333)"),
    ],
)
def test_powers_in_c(formula, text):
    assert CPrinter(NAMES, "double", {}).text(formula) == text


@pytest.mark.parametrize(("real", "one"), [("double", "1.0"), ("float", "1.0F")])
def test_the_sign_in_c_is_one_or_minus_one(real, one):
    text = helper_definition("sign", real, real)
    assert re.findall(r"[-\d.f]*\d\.\d\w*", text.partition("return")[2]) == [
        one.replace("1", "0"),
        one,
        one.replace("1", "0"),
        f"-{one}",
    ]

"""Powers of constants that SymPy would compute for ever, and text that is read again."""

import time

import pytest
import sympy

from certrack.core.errors import InputError
from certrack.core.expressions import parse, symbol
from certrack.core.powers import put_in


@pytest.mark.parametrize(
    "text",
    [
        "4.076**0.0000001",
        "(4.076*x)**0.0000001",
        "(-4.076*x)**0.0000001",
        "exp(0.0000001*log(4.076) + x)",
        "(12*x)**(1/64)*12**(1/63)*12**(1/61)*12**(-1/59)*12**0.123456*12**0.000001",
        "sqrt(sqrt(12))*sqrt(12)*12**0.3",
        "(exp(log(4.076)*0.0000001))**0.0000003",
        "(4.076*exp(x))**0.0000001",
        "((4.076*x)**2)**0.0000001",
        "max(4.076**0.0000001, x)",
        "sign(4.076**0.0000001 - 1) + abs(x)",
        "exp(exp(1)*log(2))",
        "(1e300)**(1/64)",
        "1e-300**0.5",
    ],
)
def test_powers_are_read_at_once_and_mean_what_they_say(text):
    begin = time.process_time()
    expr = parse("", text, ["x"]).expr
    assert time.process_time() - begin < 1
    assert parse("", expr, ["x"]).expr == expr
    names = {name: getattr(sympy, name) for name in ("exp", "log", "sqrt", "sign")}
    x = -0.7 if text.startswith("(-") else 0.7
    floats = names | {"max": max, "abs": abs, "x": sympy.Float(x)}
    expected = eval(text, {"__builtins__": {}}, floats)  # our own text, not a stranger's
    assert float(expr.subs(symbol("x"), x)) == pytest.approx(float(expected), rel=1e-12)


def test_constants_are_put_in_without_being_computed():
    formula = parse("", "K**0.0000001*exp(0.0000001*log(K)*x)", ["K", "x"]).expr
    begin = time.process_time()
    value = put_in(formula, {symbol("K"): sympy.Rational(1019, 250)})
    assert time.process_time() - begin < 1
    assert value.free_symbols == {symbol("x")}


def test_names_of_sympy_are_names_of_a_user():
    formula = parse("", "E*exp(1) + Abs*abs(I) + Max*max(E, I)", ["E", "Abs", "I", "Max"]).expr
    assert parse("", formula, ["E", "Abs", "I", "Max"]).expr == formula


def test_a_misspelt_name_is_corrected_among_thousands():
    names = [f"c{i}" for i in range(3000)] + ["stiffness"]
    with pytest.raises(InputError, match=r"Did you mean stiffness\?") as caught:
        parse("", "stifness", names)
    assert len(str(caught.value)) < 600

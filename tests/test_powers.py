"""Powers of constants that SymPy would compute for ever, and text that is read again."""

import pytest
import sympy
from pace import within

from certrack import export_c, loads, simulate
from certrack.core.errors import InputError
from certrack.core.expressions import parse, symbol
from certrack.core.kinks import derivative
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
    with within(1):
        expr = parse("", text, ["x"]).expr
    assert parse("", expr, ["x"]).expr == expr
    names = {name: getattr(sympy, name) for name in ("exp", "log", "sqrt", "sign")}
    x = -0.7 if text.startswith("(-") else 0.7
    floats = names | {"max": max, "abs": abs, "x": sympy.Float(x)}
    expected = eval(text, {"__builtins__": {}}, floats)  # our own text, not a stranger's
    assert float(expr.subs(symbol("x"), x)) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "sqrt(log(tanh(1300)))",
        "log(tanh(1300))**0.3*x",
        "sqrt(tanh(1300) - 1)",
        "(sin(1)**2 + cos(1)**2 - 1)**0.5",
    ],
)
def test_roots_of_what_rounds_to_zero_are_refused(text):
    """Floats say 0; of these the first three are below it, and have no real root."""
    with pytest.raises(InputError, match="no value|not a finite real number"):
        parse("", text, ["x"])
    assert parse("", "(sin(1)**2 + cos(1)**2 - 0.9)**0.5", ["x"]).expr > 0.3


def test_constants_are_put_in_without_being_computed():
    formula = parse("", "K**0.0000001*exp(0.0000001*log(K)*x)", ["K", "x"]).expr
    with within(1):
        value = put_in(formula, {symbol("K"): sympy.Rational(1019, 250)})
    assert value.free_symbols == {symbol("x")}


def test_names_of_sympy_are_names_of_a_user():
    formula = parse("", "E*exp(1) + Abs*abs(I) + Max*max(E, I)", ["E", "Abs", "I", "Max"]).expr
    assert parse("", formula, ["E", "Abs", "I", "Max"]).expr == formula


def test_a_misspelt_name_is_corrected_among_thousands():
    names = [f"c{i}" for i in range(3000)] + ["stiffness"]
    with pytest.raises(InputError, match=r"Did you mean stiffness\?") as caught:
        parse("", "stifness", names)
    assert len(str(caught.value)) < 600


FINE_ROOT = """
[plant]
states = ["x1", "x2"]
chain = [1]
gain_sign = 1
input_gain = 1
drift = "sin(sinh((x2+3)**0.123456789)) + abs(x1)**1.2345*cosh((x1+5)**(1/61)*(x1+5)**(1/63))"
[law]
kind = "robust"
c = [1, 1]
[reference]
signal = "sin(t)"
[truth]
input_gain = 1
[simulation]
x0 = [0.5, 0]
duration = 0.1
"""


def test_a_formula_with_fine_roots_is_simulated_and_exported(tmp_path):
    """SymPy took it for a polynomial in the 10^9th root, whose coefficients filled the memory."""
    system = loads(FINE_ROOT)
    with within(20):
        taylor = simulate(system)
        scipy = simulate(system, integrator="scipy")
        export_c(system, tmp_path, period=0.001)
    assert taylor.x[:, -1] == pytest.approx(scipy.x[:, -1], rel=1e-6)


@pytest.mark.parametrize(
    ("text", "slope"),
    [
        ("x**1.2345", 0.0),
        ("x**0.123*x**0.877", 1.0),
        ("(x**2 + 1)**0.4567", 0.0),
        ("(x**0.3456)**2.123*x**(1/63)*x**(60/61)", 0.0),
        ("x**pi", 0.0),
    ],
)
def test_the_slope_of_a_fine_root_exists_at_zero(text, slope):
    x = symbol("x")
    expr = derivative(parse("", text, ["x"]).expr, x)
    assert float(expr.subs(x, 0)) == slope
    values = {x: sympy.Float("0.7", 40)}
    exact = sympy.diff(parse("", text, ["x"]).expr, x)
    assert float(expr.subs(values)) == pytest.approx(float(exact.subs(values)), rel=1e-13)

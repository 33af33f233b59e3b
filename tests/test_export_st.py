"""Structured Text: it parses, and computes what Python does."""

import math
import re

import numpy as np
import pytest
import tree_sitter
import tree_sitter_iec61131_3_st as grammar
from exported import EVERYTHING, PythonController, along_a_run, sampled
from extensions import dynamic_surface, prescribed_performance, spline
from test_cli import invoke, result

import certrack
from certrack.export.golden_vectors import GOLDEN_TOLERANCE, golden_vectors
from certrack.export.program import controller_program
from certrack.export.st.function_block import structured_text

LANGUAGE = tree_sitter.Language(grammar.language())

FUNCTIONS = {
    "ABS": abs,
    "SIN": math.sin,
    "COS": math.cos,
    "TAN": math.tan,
    "ASIN": math.asin,
    "ACOS": math.acos,
    "ATAN": math.atan,
    "EXP": math.exp,
    "LN": math.log,
    "SQRT": math.sqrt,
    "EXPT": math.pow,
    "MAX": max,
    "MIN": min,
    "LIMIT": lambda low, value, high: min(max(value, low), high),
}

OPERATORS = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    ">": lambda a, b: a > b,
    "<": lambda a, b: a < b,
    ">=": lambda a, b: a >= b,
    "<=": lambda a, b: a <= b,
    "AND": lambda a, b: a and b,
    "OR": lambda a, b: a or b,
}


class FunctionBlock:
    """A function block, executed on its syntax tree; identifiers in capitals."""

    def __init__(self, text):
        self.tree = tree_sitter.Parser(LANGUAGE).parse(text.encode())
        (self.block,) = (
            node for node in self.tree.root_node.children if node.type.endswith("declaration")
        )
        self.values, self.sections, self.types = {}, {}, {}
        for section in self.block.children:
            if section.type.startswith("var_"):
                title = section.text.decode().split("\n")[0]
                self.sections[title] = [self.declare(node) for node in self.declared(section)]
        for name in self.sections["VAR_OUTPUT"]:
            if self.values[name] is None:  # what the standard gives to begin with
                self.values[name] = 0.0 if self.types[name] == "LREAL" else False

    def declared(self, section):
        return [node for node in section.children if node.type == "variable_declaration"]

    def declare(self, node):
        name, kind, *value = node.named_children
        name = name.text.decode().upper()
        assert name not in self.values, name
        self.types[name] = kind.text.decode()
        self.values[name] = self.evaluate(value[0]) if value else None
        return name

    def call(self, *inputs, reset=False, guard=False):
        for name in self.sections.get("VAR_TEMP", []):
            self.values[name] = None  # nothing is kept there from call to call
        names = self.sections["VAR_INPUT"]
        self.values |= dict(zip(names, [*map(float, inputs), reset, guard], strict=True))
        self.run(self.block.children)
        return self.values["U"]

    def run(self, nodes):
        for node in nodes:
            if node.type == "assignment_statement":
                target, value = node.named_children
                name = target.text.decode().upper()
                assert name not in self.sections.get("VAR CONSTANT", [])
                self.values[name] = self.evaluate(value)
                kind = {float: "LREAL", bool: "BOOL"}[type(self.values[name])]
                assert self.types[name] == kind, name
            elif node.type == "if_statement":
                self.choose(node)

    def choose(self, node):
        condition, *rest = node.named_children
        if self.evaluate(condition):
            return self.run(n for n in rest if n.type == "assignment_statement" or is_if(n))
        for clause in rest:
            if clause.type == "elsif_clause":
                condition, *statements = clause.named_children
                if self.evaluate(condition):
                    return self.run(statements)
            elif clause.type == "else_clause":
                return self.run(clause.named_children)
        return None

    def evaluate(self, node):
        kind, parts = node.type, node.named_children
        if kind == "identifier":
            value = self.values[node.text.decode().upper()]
            assert value is not None, node.text
            return value
        if kind == "real_literal":
            return float(node.text)
        if kind == "boolean_literal":
            return node.text == b"TRUE"
        if kind == "parenthesized_expression":
            return self.evaluate(parts[0])
        if kind == "unary_expression":
            if node.children[0].type == "NOT":
                return not self.evaluate(parts[0])
            assert node.children[0].type == "-"
            return -self.evaluate(parts[0])
        if kind == "binary_expression":
            left, operator, right = node.children
            return OPERATORS[operator.type](self.evaluate(left), self.evaluate(right))
        assert kind == "call_expression", kind
        function, arguments = parts
        return FUNCTIONS[function.text.decode()](*map(self.evaluate, arguments.named_children))


def is_if(node):
    return node.type == "if_statement"


def compare(system, name="example1", within=1e-13):
    """Run the block along a run of the system; the largest difference, relative."""
    text = structured_text(system, name)
    block, ours = FunctionBlock(text), PythonController(system)
    assert not block.tree.root_node.has_error
    worst = 0.0
    for x, Y in zip(*along_a_run(system), strict=True):
        u = ours.step(x, Y)
        worst = max(worst, abs(block.call(*x, *Y) - u) / (1 + abs(u)))
        states = [block.values[state] for state in block.sections.get("VAR", [])]
        assert states == pytest.approx(ours.state.tolist(), rel=within, abs=within)
    return worst, block


@pytest.mark.parametrize(
    ("name", "implementation"),
    [
        ("example1", {}),
        ("example1", EVERYTHING),
        ("example1", {"saturation": (-5, 5), "anti_windup": "none"}),
        ("dual-motor-lean", {"velocity": ("x2", "x4")}),
        ("dual-motor-lean", {}),
        ("dual-motor", {}),
    ],
)
def test_computes_what_python_does(name, implementation):
    worst, _ = compare(sampled(name, **implementation))
    assert worst < 1e-13


@pytest.mark.parametrize("make", [dynamic_surface, prescribed_performance, spline])
@pytest.mark.parametrize("limits", [{}, {"saturation": (-30.0, 30.0), "rate_limit": 5000.0}])
def test_laws_and_references_of_others_compute_what_python_does(make, limits):
    """Own states with initial values, filters, the time in a formula, samples of a spline."""
    system = make(implementation=certrack.Implementation(period=1e-3, **limits))
    worst, _ = compare(system.with_settings(duration=1), "mine")
    assert worst < 1e-13


def passes(text, vectors):
    """Whether a block gives the golden answers."""
    block = FunctionBlock(text)
    states = block.sections.get("VAR", [])
    for k in range(vectors.x.shape[1]):
        block.values |= dict(zip(states, map(float, vectors.states[:, k]), strict=True))
        u = block.call(*vectors.x[:, k], *vectors.Y[:, k])
        got = np.array([u, *(block.values[state] for state in states)])
        deviation = np.abs(got - vectors.answers[:, k]) / vectors.scales[:, k]
        if not deviation.max() <= GOLDEN_TOLERANCE["double"]:
            return False
    return True


@pytest.mark.parametrize("implementation", [{}, EVERYTHING], ids=["plain", "everything"])
def test_every_wrong_number_is_noticed(implementation):
    system = sampled("example1", **implementation)
    text, vectors = (
        structured_text(system),
        golden_vectors(system, controller_program(system), "double"),
    )
    assert vectors.blind == ()
    assert passes(text, vectors)
    begins = [text.index("VAR CONSTANT"), text.index("END_IF;", text.index("IF RESET"))]
    ends = [text.index("END_VAR", begins[0]), len(text)]
    count = 0
    for begin, end in zip(begins, ends, strict=True):
        for match in re.finditer(r"\b\d+\.\d+(E-?\d+)?", text[begin:end]):
            if float(match[0]) == 0 or match[0] == "1.0E308":  # the guard's: tested by itself
                continue
            head, tail = text[: begin + match.start()], text[begin + match.end() :]
            assert not passes(f"{head}{float(match[0]) * 1.003!r}{tail}", vectors), match[0]
            count += 1
    assert count >= 9


def with_drift(drift):
    system = sampled("example1", duration=0.5)
    return system.replace(plant=certrack.Plant(**(PLANT | {"drift": drift})))


PLANT = {
    "states": ["x1", "x2"],
    "chain": [2],
    "linear": [[-3]],
    "regressor": ["1 + x1*sin(x2)"],
    "gain_sign": 1,
    "input_gain": 2.0,
    "theta": [2.0],
    "uncertainty": certrack.Uncertainty([0.1, 0.2], [0.5, 0.2], [0.0, 0.1]),
}


@pytest.mark.parametrize(
    "drift",
    [
        "tanh(3*x1) + sinh(x2) - cosh(x1*x2)",
        "tanh(100*x2)",
        "sign(x2 - 0.5) + 2*abs(x1)",
        "atan2(x2, x1) + atan2(-x2, -x1) + atan2(x1*x2, x2 - 1)",
        "min(x1, x2, 0.5) + max(x1, -x2)*min(1, x1**2)",
        "sqrt(1 + x1**2)/(2 + x2**2)**1.5 - 1/sqrt(2 + x1**2)",
        "exp(-x1**2) + log(1 + x2**2) + asin(x1/4) + acos(x1/4) + atan(x2) + tan(x1/4)",
        "-x1**3/(1 + x2**2)**2 + (x1 - x2)**5 - abs(x1)**0.3 + (1 + x1**2)**9/1000",
        "max(abs(x1 - x2), sign(x1)*tanh(x2)) - 1e-7*x1 + 3e12*x2*1e-12",
    ],
)
def test_every_function(drift):
    """What the standard lacks is expressed by what it has."""
    system = with_drift(drift)
    worst, block = compare(system)
    assert worst < 1e-13
    called = set(re.findall(r"\b([A-Z0-9]+)\(", block.tree.root_node.text.decode()))
    assert called <= set(FUNCTIONS)


def test_reset_starts_again():
    system = sampled("example1", **EVERYTHING)
    block = FunctionBlock(structured_text(system, "example1"))
    inputs = [1.0, 2.0, 0.2, 0.0]
    first = [block.call(*inputs) for _ in range(3)]
    again = [block.call(*inputs, reset=not k) for k in range(3)]
    assert first == again
    assert first[0] != first[1]


def test_interface():
    block = FunctionBlock(structured_text(sampled("dual-motor-lean"), "dual-motor-lean"))
    assert "FUNCTION_BLOCK dual_motor_lean\n" in block.tree.root_node.text.decode()
    expected = "X1 X2 X3 X4 Y_D Y_D_1 Y_D_2 RESET GUARD"
    assert block.sections["VAR_INPUT"] == expected.split()
    assert block.sections["VAR_OUTPUT"] == ["U"]


def test_what_is_not_read_is_not_called_measured():
    text = structured_text(sampled("example1", velocity=("x2",)))
    assert "x1 : LREAL; (* measured" in text
    assert "x2 : LREAL; (* not read; computed from x1 *)" in text


def test_names_and_comments_that_do_not_fit():
    """Identifiers are the same in capitals; some are reserved; a title may end a comment."""
    system = sampled("example1", duration=0.1)
    plant = PLANT | {"states": ["S", "s__"], "regressor": ["1 + S*sin(s__*K*k)"]}
    constants = {"constants": {"K": 1, "k": "2*K"}, "drift": "S**2*s__"}
    strange = system.replace(
        plant=certrack.Plant(**(plant | constants)),
        truth=certrack.Truth(2.0, [2.0]),
        title="a *) b (* c \u2013 d (*) e",
    )
    worst, block = compare(strange, "step")
    assert worst < 1e-13
    assert block.sections["VAR_INPUT"][:2] == ["S_2", "S_3"]
    text = block.tree.root_node.text.decode()
    assert text.isascii()
    assert "FUNCTION_BLOCK step_2\n" in text


def test_needs_an_implementation():
    with pytest.raises(certrack.InputError, match="implementation: is missing"):
        structured_text(certrack.load("example1"), "example1")


def test_command_line(capfd, tmp_path):
    out = tmp_path / "drive.st"
    code, _, err = invoke(
        capfd, "export", "st", "dual-motor-lean", "--period", "0.01", "--out", str(out)
    )
    assert (code, err) == (0, "")
    block = FunctionBlock(out.read_text())
    assert "FUNCTION_BLOCK drive\n" in out.read_text()
    assert block.call(0, 0, 0, 0, 0, 0, 0) == 0.0
    assert result(capfd, "export", "st", "example1", "--period", "1", "--out", str(out)) == {
        "file": str(out)
    }
    for arguments, message in (
        (("--out", str(out)), "implementation: is missing"),
        (("--period", "0", "--out", str(out)), "--period: must be positive"),
        (("--period", "1", "--out", str(tmp_path / "no" / "a.st")), "cannot be written"),
    ):
        code, _, err = invoke(capfd, "export", "st", "example1", *arguments)
        assert code == 2
        assert message in err
        assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == [out]

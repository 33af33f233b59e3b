"""Small changes of a module: an operator, a comparison, a number, a branch, a call."""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Iterator
from dataclasses import dataclass
from types import CodeType

from mutation.groups import SOURCE

ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.MatMult: ast.Mult,
}
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
SWAPPED_NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "floor": "ceil"}
SWAPPED_CHARACTERS = {"+": "-", "-": "+", "*": "/", "<": ">", ">": "<", "&": "|", "|": "&"}

#: Texts of which this is a part are for people.
PROSE = re.compile("[A-Za-z]+ [a-z]+ [a-z]+ [a-z]+")

#: Fields of the syntax that decide nothing, and keywords of calls that only guard or speed up.
NEVER_CHANGED = {"annotation", "returns", "decorator_list", "type_params"}
GUARDS = {"strict", "repr", "stacklevel", "maxsize"}

#: A place in a syntax tree: names of fields, and indices where a field is a list.
Place = tuple[tuple[str, int | None], ...]


def replacements(node: ast.AST, texts: bool) -> Iterator[ast.AST]:
    """What may stand in the place of `node`."""

    def changed(**fields: object) -> ast.AST:
        twin = copy.copy(node)
        for name, value in fields.items():
            setattr(twin, name, value)
        return twin

    if isinstance(node, (ast.BinOp, ast.AugAssign)):
        if type(node.op) in ARITHMETIC:
            yield changed(op=ARITHMETIC[type(node.op)]())
    elif isinstance(node, ast.Compare):
        for i, op in enumerate(node.ops):
            for other in COMPARISONS[type(op)]:
                yield changed(ops=[*node.ops[:i], other(), *node.ops[i + 1 :]])
    elif isinstance(node, ast.BoolOp):
        yield changed(op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        yield node.operand
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        yield changed(test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield changed(value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield changed(value=node.value + 1)
        yield changed(value=node.value - 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield changed(value=2 * node.value or 1.0)
        if node.value:
            yield changed(value=node.value / 2)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and texts:
        if PROSE.search(node.value):
            return
        for i, character in enumerate(node.value):
            if character in SWAPPED_CHARACTERS:
                other = SWAPPED_CHARACTERS[character]
                yield changed(value=node.value[:i] + other + node.value[i + 1 :])
                break
    elif isinstance(node, ast.Name) and node.id in SWAPPED_NAMES:
        yield changed(id=SWAPPED_NAMES[node.id])
    elif isinstance(node, ast.Attribute) and node.attr in SWAPPED_NAMES:
        yield changed(attr=SWAPPED_NAMES[node.attr])
    elif isinstance(node, (ast.Continue, ast.Break)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield ast.Pass()


def _decides_nothing(node: object, texts: bool) -> bool:
    """Errors and their texts, docstrings, what is there for types or for people alone."""
    if not isinstance(node, ast.AST) or isinstance(node, (ast.Raise, ast.Assert)):
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    if isinstance(node, ast.FunctionDef) and node.name in ("__repr__", "_repr_html_"):
        return True
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name):
        return node.test.id == "TYPE_CHECKING"
    if isinstance(node, ast.keyword) and node.arg in GUARDS:
        return True
    return isinstance(node, ast.JoinedStr) and not texts


def places(node: ast.AST, texts: bool, here: Place = ()) -> Iterator[tuple[Place, ast.AST]]:
    """Every node that a change could begin at."""
    yield here, node
    for name, value in ast.iter_fields(node):
        if name in NEVER_CHANGED:
            continue
        for i, child in enumerate(value if isinstance(value, list) else [value]):
            if not _decides_nothing(child, texts):
                step = (name, i if isinstance(value, list) else None)
                yield from places(child, texts, (*here, step))


def at(tree: ast.AST, place: Place) -> ast.AST:
    """The node at a place."""
    for name, i in place:
        value = getattr(tree, name)
        tree = value if i is None else value[i]
    return tree


def put(tree: ast.AST, place: Place, node: ast.AST) -> None:
    """Replace the node at a place."""
    *before, (name, i) = place
    parent = at(tree, tuple(before))
    if i is None:
        setattr(parent, name, node)
    else:
        getattr(parent, name)[i] = node


@dataclass(frozen=True, eq=False)
class Mutant:
    """One change of a module.

    `lines` are those of its statement, or of the head of it; `function` is the qualified name and
    the first line of the outermost function whose body has it, or None where it runs on import.
    """

    module: str
    place: Place
    node: ast.AST
    text: str
    lines: range
    function: tuple[str, int] | None

    @property
    def path(self) -> str:
        """Of the module's file."""
        return str(SOURCE / self.module)

    @property
    def name(self) -> str:
        """Of the module, as it is imported."""
        return "certrack." + self.module.removesuffix(".py").replace("/", ".")

    def code(self) -> CodeType:
        """The whole module with the change, compiled."""
        tree = ast.parse((SOURCE / self.module).read_text())
        put(tree, self.place, copy.deepcopy(self.node))
        return compile(ast.fix_missing_locations(tree), self.path, "exec")


def mutants(module: str, texts: bool) -> list[Mutant]:
    """Every mutant of a module."""
    tree = ast.parse((SOURCE / module).read_text())
    found: list[Mutant] = []
    seen: dict[str, int] = {}
    for place, node in list(places(tree, texts)):
        for other in replacements(node, texts):
            nodes = [at(tree, place[:i]) for i in range(len(place) + 1)]
            before = _words(nodes, place)
            put(tree, place, other)
            after = _words([at(tree, place[:i]) for i in range(len(place) + 1)], place)
            put(tree, place, node)
            text = f"{module}::{_scope(nodes)}: {before} -> {after}"
            seen[text] = seen.get(text, 0) + 1
            text += f" ({seen[text]})" if seen[text] > 1 else ""
            lines, function = _lines(nodes), _function(nodes, place)
            found.append(Mutant(module, place, other, text, lines, function))
    return found


def _scope(nodes: list[ast.AST]) -> str:
    """Classes and functions around a place."""
    names = [n.name for n in nodes[1:] if isinstance(n, (ast.FunctionDef, ast.ClassDef))]
    return ".".join(names) or "module"


def _words(nodes: list[ast.AST], place: Place) -> str:
    """The statement around a place; of a compound statement the part that changes."""
    cut = max(i for i in range(len(nodes)) if isinstance(nodes[i], ast.stmt))
    if hasattr(nodes[cut], "body") and cut < len(place):
        cut += 1
    return ast.unparse(nodes[cut]).splitlines()[0]


def _lines(nodes: list[ast.AST]) -> range:
    """Lines of the statement around a place, or of its head as far as the place."""
    statement = [n for n in nodes if isinstance(n, ast.stmt)][-1]
    last = statement.end_lineno
    if hasattr(statement, "body"):
        inside = nodes[-1].test if isinstance(nodes[-1], (ast.If, ast.While)) else nodes[-1]
        last = getattr(inside, "end_lineno", statement.lineno)
    return range(statement.lineno, last + 1)


def _function(nodes: list[ast.AST], place: Place) -> tuple[str, int] | None:
    """The outermost function whose body has a place."""
    for i, node in enumerate(nodes[:-1]):
        if isinstance(node, ast.FunctionDef) and place[i][0] == "body":
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            return _scope(nodes[: i + 1]), first
    return None

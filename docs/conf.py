"""The site: the Markdown pages of the repository and a reference made from the docstrings.

The source folder is the repository itself, so every link between pages is the same on the site and
in the repository. ``make docs`` builds it, without a network and with warnings as errors.
"""

from __future__ import annotations

import pkgutil
import re
import tomllib
from importlib import import_module
from pathlib import Path
from types import BuiltinFunctionType, GenericAlias, ModuleType
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert

import certrack

ROOT = Path(__file__).parents[1]
CONFIGURATION = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))

project = "certrack"
author = "The certrack authors"
copyright = f"2026, {author}"
version = release = CONFIGURATION["project"]["version"]

extensions = ["sphinx.ext.autodoc", "numpydoc", "myst_parser"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/**"]

html_theme = "furo"
html_title = f"certrack {release}"
html_extra_path = ["site"]  # its index.html leads to docs/index.html
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
highlight_language = "none"  # indented blocks are formulas

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
html_math_renderer = "mathml"  # browsers typeset it themselves, without a script from a network

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc states the types, with shapes and units
numpydoc_show_class_members = False

REFERENCE = ROOT / "docs" / "api"


def rooms() -> list[str]:
    """The rooms of the package, from the top floor down, as the import contract lists them."""
    layers = CONFIGURATION["tool"]["importlinter"]["contracts"][0]["layers"]
    return [name.strip() for layer in layers for name in layer.split("|")]


def modules_of(room: str) -> list[str]:
    """The room itself and every module in it."""
    module = import_module(room)
    inner = pkgutil.walk_packages(getattr(module, "__path__", ()), f"{room}.")
    return [room, *sorted(info.name for info in inner)]


def heading(text: str, line: str) -> str:
    """A heading in reStructuredText."""
    return f"{text}\n{line * len(text)}\n"


def room_page(room: str) -> str:
    """One page: what is in the room, module by module."""
    parts = [heading(room, "=")]
    for module in modules_of(room):
        is_package = hasattr(import_module(module), "__path__")
        title = [] if module == room else [heading(module, "-")]
        # A package repeats names of its modules: they are described once, where they are.
        members = [] if is_package else ["   :members:"]
        parts += [*title, "\n".join([f".. automodule:: {module}", *members]) + "\n"]
    return "\n".join(parts)


def public_page() -> str:
    """One page: every public name, linked to its description."""
    lines = [heading("Public names", "="), "What ``import certrack`` offers.\n"]
    lines += [".. list-table::", "   :widths: 30 70", ""]
    for name in certrack.__all__:
        value = getattr(certrack, name)
        if isinstance(value, str):
            continue
        if isinstance(value, ModuleType):
            first = (value.__doc__ or "").strip().split("\n\n")[0].replace("\n", " ")
            lines += [f"   * - :py:mod:`~{value.__name__}`", f"     - {escaped(first)}"]
            continue
        first = (value.__doc__ or "").strip().split("\n\n")[0].replace("\n", " ")
        target = f"{value.__module__}.{value.__qualname__}"
        lines += [f"   * - :py:obj:`~{target}`", f"     - {escaped(first)}"]
    return "\n".join(lines) + "\n"


def write_reference() -> None:
    """Write the pages of the reference; untouched where nothing changed, so builds stay short."""
    pages = {"public": public_page()} | {
        room.removeprefix("certrack."): room_page(room) for room in rooms()
    }
    REFERENCE.mkdir(exist_ok=True)
    for old in REFERENCE.glob("*.rst"):
        if old.stem not in pages:
            old.unlink()
    for name, text in pages.items():
        path = REFERENCE / f"{name}.rst"
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


#: Markup inside a line; around it our formulas have signs that reStructuredText takes for its own.
MARKUP = re.compile(r"(``.*?``|:[\w:]+:`[^`]*`|`[^`]*`_?)", re.DOTALL)
SIGNS = re.compile(r"(\||\*(?=\S)|(?<=\w)_(?!\w))")


def escaped(text: str) -> str:
    """The text with the signs of its formulas escaped: |x|, \\*x, x\\_; markup stays."""
    parts = MARKUP.split(text)
    parts[::2] = [SIGNS.sub(r"\\\1", part) for part in parts[::2]]
    return "".join(parts)


def readable(lines: list[str]) -> list[str]:
    """A docstring as reStructuredText: indented formulas keep their lines, signs are escaped."""
    result: list[str] = []
    for block in "\n".join(lines).split("\n\n"):
        before = result[-1] if result else ""
        is_literal = before.endswith("::") or (before.startswith("    ") and block[:4] == "    ")
        if block.startswith("    ") and not before.startswith(("* ", "- ", ">>>")):
            result += [block if is_literal else f"::\n\n{block}"]
        else:
            result += [block if block.startswith(">>>") else escaped(block)]
    return "\n\n".join(result).split("\n")


def rewrite_docstring(
    app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]
) -> None:
    """Docstrings are plain text with formulas; Sphinx reads them by this."""
    lines[:] = readable(lines)


def skip_foreign(
    app: Any, what: str, name: str, value: Any, skip: bool, options: Any
) -> bool | None:
    """Leave out names of types, and what a module has imported from C."""
    return True if isinstance(value, (GenericAlias, BuiltinFunctionType)) else None


def write_math(translator: Any, node: nodes.Element) -> None:
    """Formulas as MathML."""
    is_block = isinstance(node, nodes.math_block)
    formula = convert(node.astext(), display="block" if is_block else "inline")
    translator.body.append(f'<div class="formula">{formula}</div>' if is_block else formula)
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Write the reference before Sphinx looks for pages; read docstrings before numpydoc does."""
    write_reference()
    app.add_html_math_renderer("mathml", (write_math, None), (write_math, None))
    app.connect("autodoc-process-docstring", rewrite_docstring, priority=100)
    app.connect("autodoc-skip-member", skip_foreign)

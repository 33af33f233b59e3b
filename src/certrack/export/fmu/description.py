"""What an FMU says of itself: modelDescription.xml of FMI 2.0 and 3.0, and a page to read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from xml.etree import ElementTree as Tree

from certrack.core.version import version
from certrack.export.c.source import CCode
from certrack.export.program import unread


@dataclass(frozen=True)
class Variable:
    """A variable of the FMU; its value reference is its place in the list."""

    name: str
    causality: str
    start: float
    description: str
    unit: str = ""

    @property
    def attributes(self) -> dict[str, str]:
        """What both versions call the same."""
        found = {"name": self.name, "causality": self.causality, "description": self.description}
        if self.causality == "input":
            return found | {"variability": "continuous"}
        return found | {"variability": "discrete", "initial": "exact"}

    @property
    def value(self) -> dict[str, str]:
        """Start and unit."""
        return {"start": repr(self.start)} | ({"unit": self.unit} if self.unit else {})


def variables(code: CCode) -> list[Variable]:
    """In the order of ``fmi/instance.h``: states, reference, input of the plant, what is kept."""
    plant, implementation, made = code.system.plant, code.system.implementation, code.program
    assert implementation is not None
    idle = unread(code.system)
    units = plant.units or ("",) * (plant.n + 1)
    found = [
        Variable(name, "input", 0.0, idle.get(name, "measured state"), unit)
        for name, unit in zip(plant.states, units, strict=False)
    ]
    found.append(Variable("y_d", "input", 0.0, "reference", units[0]))
    for i in range(1, len(made.Y)):
        found.append(Variable(f"y_d_{i}", "input", 0.0, f"derivative no. {i} of the reference"))
    command = "command of the last sample"
    found.append(Variable("u", "output", implementation.initial_input, command, units[-1]))
    for symbol, start in zip(made.states, made.start, strict=True):
        found.append(
            Variable(f"kept.{made.labels[symbol]}", "local", start, "kept from sample to sample")
        )
    return found


def _root(code: CCode, fmi: str, token: dict[str, str]) -> Tree.Element:
    system = code.system
    return Tree.Element(
        "fmiModelDescription",
        token,
        fmiVersion=fmi,
        modelName=system.title or code.name,
        description=f"{system.law.kind} tracking controller in discrete time",
        generationTool=f"certrack {version()}",
        variableNamingConvention="structured",
    )


def _frame(code: CCode, root: Tree.Element, found: Sequence[Variable]) -> None:
    """Units, log categories and the experiment: the same in both versions."""
    implementation, settings = code.system.implementation, code.system.settings
    assert implementation is not None
    if units := sorted({variable.unit for variable in found} - {""}):
        defined = Tree.SubElement(root, "UnitDefinitions")
        for unit in units:
            Tree.SubElement(defined, "Unit", name=unit)
    categories = Tree.SubElement(root, "LogCategories")
    Tree.SubElement(categories, "Category", name="logStatusError")
    Tree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(settings.duration),
        stepSize=repr(implementation.period),
    )


def _text(root: Tree.Element) -> str:
    Tree.indent(root)
    body = Tree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'


def fmi_2(code: CCode, token: str, sources: Sequence[str]) -> dict[str, str]:
    """Description files of FMI 2.0; `sources` are the files to be compiled."""
    found = variables(code)
    root = _root(code, "2.0", {"guid": token})
    kind = Tree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=code.name,
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    listed = Tree.SubElement(kind, "SourceFiles")
    for name in sources:
        Tree.SubElement(listed, "File", name=name)
    _frame(code, root, found)
    inside = Tree.SubElement(root, "ModelVariables")
    for i, variable in enumerate(found):
        attributes = variable.attributes | {"valueReference": str(i)}
        scalar = Tree.SubElement(inside, "ScalarVariable", attributes)
        Tree.SubElement(scalar, "Real", variable.value)
    outputs = Tree.SubElement(Tree.SubElement(root, "ModelStructure"), "Outputs")
    for i in _outputs(found):
        # nothing that is set between two steps shows before the next one
        Tree.SubElement(outputs, "Unknown", index=str(i + 1), dependencies="")
    return {"modelDescription.xml": _text(root)}


def fmi_3(code: CCode, token: str, sources: Sequence[str]) -> dict[str, str]:
    """Description files of FMI 3.0; `sources` are the files to be compiled."""
    implementation, found = code.system.implementation, variables(code)
    assert implementation is not None
    root = _root(code, "3.0", {"instantiationToken": token})
    Tree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=code.name,
        canHandleVariableCommunicationStepSize="false",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        fixedInternalStepSize=repr(implementation.period),
    )
    _frame(code, root, found)
    inside = Tree.SubElement(root, "ModelVariables")
    for i, variable in enumerate(found):
        attributes = variable.attributes | variable.value | {"valueReference": str(i)}
        Tree.SubElement(inside, "Float64", attributes)
    time = {"name": "time", "causality": "independent", "variability": "continuous"}
    Tree.SubElement(inside, "Float64", time | {"valueReference": str(len(found))})
    structure = Tree.SubElement(root, "ModelStructure")
    for i in _outputs(found):
        Tree.SubElement(structure, "Output", valueReference=str(i), dependencies="")
    build = Tree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = Tree.SubElement(build, "BuildConfiguration", modelIdentifier=code.name)
    listed = Tree.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        Tree.SubElement(listed, "SourceFile", name=name)
    return {"modelDescription.xml": _text(root), "sources/buildDescription.xml": _text(build)}


DESCRIPTIONS = {"2": fmi_2, "3": fmi_3}


def _outputs(found: Sequence[Variable]) -> Iterator[int]:
    return (i for i, variable in enumerate(found) if variable.causality == "output")


def page(code: CCode) -> str:
    """A page for the reader, in HTML."""
    implementation = code.system.implementation
    assert implementation is not None
    rows = "\n".join(
        f"<tr><td>{escape(v.name)}<td>{v.causality}<td>{escape(v.unit)}<td>{escape(v.description)}"
        for v in variables(code)
    )
    title = escape(code.system.title or code.name)
    return f"""<!DOCTYPE html>
<meta charset="utf-8">
<title>{title}</title>
<h1>{title}</h1>
<p>Tracking controller, sampled every {implementation.period!r} s.</p>
<p>Set the inputs to their values at t, then step from t to t + h: the controller takes its sample
at t, and u is its command of t. h must be a multiple of the period; with more than one period all
samples see the same inputs. A master that steps plant and controller side by side (Jacobi) gives
the plant this command one step late; one that steps the controller first (Gauss-Seidel) does
not.</p>
<table>
<tr><th>variable<th>kind<th>unit<th>meaning
{rows}
</table>
"""

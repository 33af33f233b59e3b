"""What an FMU says of itself: modelDescription.xml of FMI 2.0 and 3.0, and a page to read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from xml.etree import ElementTree as Tree

from certrack.core.version import version
from certrack.export.c.source import CCode
from certrack.export.fmu.monitored import monitored_variables
from certrack.export.fmu.variables import Variable
from certrack.export.program import unread_states
from certrack.export.templates import fill_template


def variables(code: CCode) -> list[Variable]:
    """In the order of ``fmi/instance.h``: states, reference, input of the plant, what is kept."""
    plant, implementation, program = code.system.plant, code.system.implementation, code.program
    assert implementation is not None
    unread = unread_states(code.system)
    units = plant.units or ("",) * (plant.n + 1)
    declared = [
        Variable(name, "input", 0.0, unread.get(name, "measured state"), unit)
        for name, unit in zip(plant.states, units, strict=False)
    ]
    declared.append(Variable("y_d", "input", 0.0, "reference", units[0]))
    for i in range(1, len(program.Y)):
        declared.append(Variable(f"y_d_{i}", "input", 0.0, f"derivative no. {i} of the reference"))
    command = "command of the last sample"
    declared.append(Variable("u", "output", implementation.initial_input, command, units[-1]))
    for symbol, start in zip(program.states, program.start, strict=True):
        declared.append(
            Variable(f"kept.{program.labels[symbol]}", "local", start, "kept from sample to sample")
        )
    if not program.states and code.monitor is not None:  # C wants a member at least
        declared.append(Variable("kept.unused", "local", 0.0, "this controller keeps nothing"))
    return [*declared, *monitored_variables(code)]


def _root_element(code: CCode, fmi: str, token: dict[str, str]) -> Tree.Element:
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


def _add_common_elements(code: CCode, root: Tree.Element, declared: Sequence[Variable]) -> None:
    """Units, log categories and the experiment: the same in both versions."""
    implementation, settings = code.system.implementation, code.system.settings
    assert implementation is not None
    if units := sorted({variable.unit for variable in declared} - {""}):
        defined = Tree.SubElement(root, "UnitDefinitions")
        for unit in units:
            Tree.SubElement(defined, "Unit", name=unit)
    categories = Tree.SubElement(root, "LogCategories")
    Tree.SubElement(categories, "Category", name="logStatusWarning")
    Tree.SubElement(categories, "Category", name="logStatusError")
    Tree.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(settings.duration),
        stepSize=repr(implementation.period),
    )


def _xml_text(root: Tree.Element) -> str:
    Tree.indent(root)
    body = Tree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{body}\n'


def fmi_2(code: CCode, token: str, sources: Sequence[str]) -> dict[str, str]:
    """Description files of FMI 2.0; `sources` are the files to be compiled."""
    declared = variables(code)
    root = _root_element(code, "2.0", {"guid": token})
    kind = Tree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=code.name,
        canHandleVariableCommunicationStepSize="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    source_files = Tree.SubElement(kind, "SourceFiles")
    for name in sources:
        Tree.SubElement(source_files, "File", name=name)
    _add_common_elements(code, root, declared)
    inside = Tree.SubElement(root, "ModelVariables")
    for i, variable in enumerate(declared):
        attributes = variable.attributes | {"valueReference": str(i)}
        scalar = Tree.SubElement(inside, "ScalarVariable", attributes)
        Tree.SubElement(scalar, "Real", variable.value)
    outputs = Tree.SubElement(Tree.SubElement(root, "ModelStructure"), "Outputs")
    for i in _output_indices(declared):
        # nothing that is set between two steps shows before the next one
        Tree.SubElement(outputs, "Unknown", index=str(i + 1), dependencies="")
    return {"modelDescription.xml": _xml_text(root)}


def fmi_3(code: CCode, token: str, sources: Sequence[str]) -> dict[str, str]:
    """Description files of FMI 3.0; `sources` are the files to be compiled."""
    implementation, declared = code.system.implementation, variables(code)
    assert implementation is not None
    root = _root_element(code, "3.0", {"instantiationToken": token})
    Tree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=code.name,
        canHandleVariableCommunicationStepSize="false",
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        fixedInternalStepSize=repr(implementation.period),
    )
    _add_common_elements(code, root, declared)
    inside = Tree.SubElement(root, "ModelVariables")
    for i, variable in enumerate(declared):
        attributes = variable.attributes | variable.value | {"valueReference": str(i)}
        Tree.SubElement(inside, "Float64", attributes)
    time = {"name": "time", "causality": "independent", "variability": "continuous"}
    Tree.SubElement(inside, "Float64", time | {"valueReference": str(len(declared))})
    structure = Tree.SubElement(root, "ModelStructure")
    for i in _output_indices(declared):
        Tree.SubElement(structure, "Output", valueReference=str(i), dependencies="")
    build = Tree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = Tree.SubElement(build, "BuildConfiguration", modelIdentifier=code.name)
    source_files = Tree.SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        Tree.SubElement(source_files, "SourceFile", name=name)
    return {
        "modelDescription.xml": _xml_text(root),
        "sources/buildDescription.xml": _xml_text(build),
    }


DESCRIPTIONS = {"2": fmi_2, "3": fmi_3}


def _output_indices(declared: Sequence[Variable]) -> Iterator[int]:
    return (i for i, variable in enumerate(declared) if variable.causality == "output")


def documentation_page(code: CCode) -> str:
    """A page for the reader, in HTML."""
    implementation = code.system.implementation
    assert implementation is not None
    rows = [
        f"<tr><td>{escape(v.name)}<td>{v.causality}<td>{escape(v.unit)}<td>{escape(v.description)}"
        for v in variables(code)
    ]
    return fill_template(
        "fmu/templates/index.html",
        title=escape(code.system.title or code.name),
        period=repr(implementation.period),
        rows="\n".join(rows),
    )

"""modelDescription.xml and the documentation's page, written from the interface's table."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from string import Template
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from chaincrane.build_info import VERSION
from chaincrane.variables import UNITS, Variable

from .fmus import FMUS, NATIVE, Fmu

LOG_CATEGORIES = {
    "logStatusWarning": "fmi2Warning: something to know of, the result stands",
    "logStatusDiscard": "fmi2Discard: a step was not done",
    "logStatusError": "Why a value, a step or a state was refused",
    "logStatusFatal": "fmi2Fatal: the instance cannot go on",
    "logAll": "All messages",
}
DEFAULT_EXPERIMENT = {
    "startTime": "0",
    "stopTime": "4",
    "tolerance": "1e-6",
    "stepSize": "0.005",
}


def _variable_element(variable: Variable, reference: int) -> Element:
    output = variable.causality == "output"
    if variable.kind == "Real" and variable.causality != "parameter" and not variable.discrete:
        variability = "continuous"
    else:
        variability = "discrete" if output else "fixed"
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.meaning,
        "causality": variable.causality,
        "variability": variability,
    }
    if variable.causality != "input":
        attributes["initial"] = "calculated" if output else "exact"
    element = Element("ScalarVariable", attributes)
    typed = {
        "unit": variable.unit,
        "min": variable.minimum,
        "max": variable.maximum,
        "nominal": variable.nominal,
        "start": variable.start,
    }
    # repr keeps every digit of a float, so that a value set back as its start is the same value
    given = {
        key: value if isinstance(value, str) else repr(value)
        for key, value in typed.items()
        if value is not None
    }
    SubElement(element, variable.kind, given)
    return element


def _unit_definitions(fmu: Fmu) -> Element:
    """The units that its variables have."""
    element = Element("UnitDefinitions")
    used = {variable.unit for variable in fmu.variables}
    for name, exponents in UNITS.items():
        if name not in used:
            continue
        unit = SubElement(element, "Unit", {"name": name})
        SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents.items()})
        if name == "rad":
            degree = {"name": "deg", "factor": repr(180.0 / 3.141592653589793)}
            SubElement(unit, "DisplayUnit", degree)
    return element


def _model_structure(fmu: Fmu) -> Element:
    """Outputs and InitialUnknowns with their dependencies; indices count from 1.

    A step's inputs act within the step, so no output depends on an input at its own instant.
    """
    structure = Element("ModelStructure")
    index = {
        name: str(place) for place, name in enumerate((v.name for v in fmu.variables), start=1)
    }
    outputs = SubElement(structure, "Outputs")
    for variable in fmu.outputs:
        SubElement(outputs, "Unknown", {"index": index[variable.name], "dependencies": ""})
    unknowns = SubElement(structure, "InitialUnknowns")
    for variable in fmu.outputs:
        on = sorted(int(index[name]) for name in fmu.starts_from(variable))
        dependencies = " ".join(str(place) for place in on)
        SubElement(
            unknowns, "Unknown", {"index": index[variable.name], "dependencies": dependencies}
        )
    return structure


def documentation(model: str, sources: str, template: str) -> str:
    """The FMU's index.html: ``template`` with the model's name, version and interface filled in."""
    fmu, rows = FMUS[model], []
    for variable in fmu.variables:
        start = "" if variable.start is None else str(variable.start)
        cells = variable.name, variable.causality, variable.unit or "", start, variable.meaning
        rows.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
    return Template(template).substitute(
        model=model,
        description=escape(fmu.description),
        version=version(sources),
        interface="\n".join(rows),
        needs=needs(model),
    )


def needs(model: str) -> str:
    """What a host of ``model``'s FMU must have, as HTML; it names the native twin."""
    fmu = FMUS[model]
    if fmu.crane is not None:
        return (
            "Nothing: no Python and no package. It has binaries for Linux (glibc 2.17 or newer),"
            " Windows (10 or newer) and macOS, all x86-64, and its C sources for other machines."
        )
    packages = " and ".join(fmu.packages) or "no package"
    spare = " (NumPy and SciPy only where its C kernel cannot be loaded)" if fmu.kernel else ""
    text = (
        f"Python 3.10 or newer in the host's process, with {packages}{spare}, on Linux or Windows,"
        " x86-64: that is what pythonfmu has a wrapper for."
    )
    twin = model + NATIVE
    if twin in FMUS:
        text += (
            f" A host that is no Python process is served better by <code>{twin}.fmu</code>:"
            " the same interface and model in C, which needs nothing."
        )
    return text


def version(sources: str) -> str:
    """The version with the hash of the sources that the FMU was built from."""
    return f"{VERSION}+{sources[:12]}"


def model_description(
    model: str, sources: str, date: str, tool: str, c_files: Sequence[str]
) -> bytes:
    """The XML of ``model``, a key of FMUS, built by ``tool`` from ``sources`` (a hash).

    ``c_files``: names of the C files of a native FMU.
    """
    fmu = FMUS[model]
    root = Element(
        "fmiModelDescription",
        {
            "fmiVersion": "2.0",
            "modelName": model,
            "guid": f"{{{sources}}}",
            "description": fmu.description,
            "author": "the chaincrane authors",
            "version": version(sources),
            "copyright": "Copyright 2026 the chaincrane authors",
            "license": "MIT",
            "generationTool": tool,
            "generationDateAndTime": date,
            "variableNamingConvention": "structured",
        },
    )
    capabilities = {
        "modelIdentifier": model,
        "needsExecutionTool": "false",
        "canHandleVariableCommunicationStepSize": "true",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
    }
    if c_files:
        capabilities["canInterpolateInputs"] = "true"
    simulation = SubElement(root, "CoSimulation", capabilities)
    if c_files:
        files = SubElement(simulation, "SourceFiles")
        for name in c_files:
            SubElement(files, "File", {"name": name})
    root.append(_unit_definitions(fmu))
    categories = SubElement(root, "LogCategories")
    for name, meaning in LOG_CATEGORIES.items():
        SubElement(categories, "Category", {"name": name, "description": meaning})
    SubElement(root, "DefaultExperiment", DEFAULT_EXPERIMENT)
    variables = SubElement(root, "ModelVariables")
    for reference, variable in enumerate(fmu.variables):
        variables.append(_variable_element(variable, reference))
    root.append(_model_structure(fmu))
    indent(root)
    xml: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return xml

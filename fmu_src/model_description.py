"""modelDescription.xml, written from the interface table. Used by the build; not in the FMU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from string import Template
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from chaincrane import antisway_interface, interface, observer_interface
from chaincrane.build_info import VERSION
from chaincrane.variables import UNITS, Variable

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

_WEIGHT = ("chain.mass", "chain.elements", "payload.mass", "gravity")
_SHAPE = ("chain.length", "chain.mass", "chain.EA", "payload.mass", "gravity")
_SWAY = ("initial.sway_angle",)
_SPEED = ("initial.speed",)


def _crane_dependencies(output: str, linear: bool) -> tuple[str, ...]:
    """Parameters that a crane's output depends on before the first step."""
    if output in ("chain.x[10]", "chain.y[10]"):  # the payload
        output = output.replace("chain.", "payload.").removesuffix("[10]")
    inside = (*_SHAPE, "chain.elements")  # of a point between the chain's ends
    stretch = tuple(name for name in _SHAPE if name != "chain.length")
    if output in ("trolley.v", "payload.vx"):
        return _SPEED
    if output == "trolley.fx":
        return _WEIGHT + _SWAY
    if output.startswith("chain.tension"):
        return _WEIGHT if linear else _WEIGHT + _SWAY
    if output == "payload.y":
        return _SHAPE if linear else _SHAPE + _SWAY
    if output.startswith("chain.y["):
        return inside if linear else inside + _SWAY
    if output in ("payload.x", "payload.x_rel"):
        return ("chain.length", *_SWAY) if linear else _SHAPE + _SWAY
    if output.startswith("chain.x[") or output == "chain.mid_x_rel":
        return ("chain.length", *_SWAY) if linear else inside + _SWAY
    if output == "payload.sway_angle":
        return stretch + _SWAY if linear else _SWAY
    if output == "chain.top_angle":
        return (*stretch, "chain.elements", *_SWAY) if linear else _SWAY
    if output == "energy.total":
        elastic = () if linear else ("chain.EA", "chain.elements")
        return ("chain.length", "chain.mass", "payload.mass", "gravity", *elastic, *_SWAY, *_SPEED)
    return ()  # trolley.x, payload.vy, energy.dissipated, energy.error, solver.*: zero


def _observer_dependencies(output: str) -> tuple[str, ...]:
    """Parameters that an observer's output depends on before the first step."""
    if output in ("trolley.v", "payload.vx"):
        return _SPEED
    if not output.startswith("std."):
        return ()  # it starts at rest below the trolley, until a sample says otherwise
    believed = (*observer_interface.BELIEVED, "sensor.sample_time")
    of_observer = [v.name for v in observer_interface.PARAMETERS if v.name.startswith("observer.")]
    return (*believed, *(name for name in of_observer if name != "observer.inputs_at"))


@dataclass(frozen=True)
class Fmu:
    """What is told of one FMU."""

    description: str
    variables: tuple[Variable, ...]
    initial_dependencies: Callable[[str], tuple[str, ...]]  # of an output, on parameters
    page: str = "index.html"  # its documentation, in the documentation folder
    c_sources: tuple[str, ...] = ()  # of a native FMU: its C files

    @property
    def outputs(self) -> list[Variable]:
        """The interface's outputs."""
        return [variable for variable in self.variables if variable.causality == "output"]


FMUS = {
    "crane_nl": Fmu(
        "Overhead crane with a flexible chain: nonlinear, truss finite elements"
        " (Maourane & Szabo 2020, section 2.1)",
        interface.VARIABLES,
        partial(_crane_dependencies, linear=False),
    ),
    "crane_lin": Fmu(
        "Overhead crane with a flexible chain: linear, a taut string stepped exactly"
        " (Maourane & Szabo 2020, section 2.2)",
        interface.VARIABLES,
        partial(_crane_dependencies, linear=True),
    ),
    "crane_observer": Fmu(
        "Observer of an overhead crane's chain and payload: a steady-state Kalman filter on the"
        " linear crane, from a camera or a rope-angle sensor",
        observer_interface.VARIABLES,
        _observer_dependencies,
        "control.html",
    ),
    "crane_antisway": Fmu(
        "Anti-sway controller of an overhead crane: LQR on the estimate, or an open-loop move,"
        " shaped or plain, within limits of velocity and acceleration",
        antisway_interface.VARIABLES,
        lambda output: (),
        "control.html",
    ),
}

_SLAVE = ("fmi2_slave.c", "saved_state.c", "text.c")
for _model, _sources in (
    ("crane_nl", ("nonlinear_model.c", "chain_kernel.c")),
    ("crane_lin", ("linear_model.c",)),
):
    FMUS[f"{_model}_native"] = replace(
        FMUS[_model],
        description=f"{FMUS[_model].description}; native, no Python inside",
        c_sources=(*_SLAVE, *_sources),
    )


def _variable_element(variable: Variable, reference: int) -> Element:
    output = variable.causality == "output"
    if variable.kind == "Real" and variable.causality != "parameter":
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


def _unit_definitions() -> Element:
    element = Element("UnitDefinitions")
    for name, exponents in UNITS.items():
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
        on = sorted(int(index[name]) for name in fmu.initial_dependencies(variable.name))
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
    )


def version(sources: str) -> str:
    """The version with the hash of the sources that the FMU was built from."""
    return f"{VERSION}+{sources[:12]}"


def model_description(model: str, sources: str, date: str, tool: str) -> bytes:
    """The XML of ``model``, a key of FMUS, built by ``tool`` from ``sources`` (a hash)."""
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
    if fmu.c_sources:
        capabilities["canInterpolateInputs"] = "true"
    simulation = SubElement(root, "CoSimulation", capabilities)
    if fmu.c_sources:
        files = SubElement(simulation, "SourceFiles")
        for name in fmu.c_sources:
            SubElement(files, "File", {"name": name})
    root.append(_unit_definitions())
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

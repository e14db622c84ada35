"""A loop as an SSP package (System Structure and Parameterization 1.0): FMUs and connections."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from .instances import describe
from .loop import Loop
from .places import whole_file
from .start_values import check_start_values

SSP = "http://ssp-standard.org/SSP1/"
OSP = "com.opensimulationplatform"  # whose annotation libcosim takes its step size from
OMS = "org.openmodelica"  # whose annotation OMSimulator takes it from
OMS_SCHEMA = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
OMS_TOLERANCE = "0.0001"  # which it asks for, and which a fixed step has no use for
PARAMETERS = "start"  # name of the parameter sets
EARLIEST = (1980, 1, 1, 0, 0, 0)


def write_ssp(path: Path, loop: Loop) -> Path:
    """Write ``loop`` as an SSP package; its bytes depend on the loop and its FMUs alone."""
    entries = {"SystemStructure.ssd": structure(path.stem, loop)}
    entries |= {f"resources/{fmu.name}": fmu.read_bytes() for fmu in loop.fmus.values()}
    with whole_file(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for name, content in sorted(entries.items()):
            info = zipfile.ZipInfo(name, EARLIEST)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            archive.writestr(info, content)
    return path


def structure(name: str, loop: Loop) -> bytes:
    """The SystemStructure.ssd of ``loop``."""
    root = Element(
        "ssd:SystemStructureDescription",
        {
            "xmlns:ssd": f"{SSP}SystemStructureDescription",
            "xmlns:ssc": f"{SSP}SystemStructureCommon",
            "xmlns:ssv": f"{SSP}SystemStructureParameterValues",
            "xmlns:osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
            "xmlns:oms": OMS_SCHEMA,
            "name": name,
            "version": "1.0",
        },
    )
    system = SubElement(root, "ssd:System", {"name": name})
    elements = SubElement(system, "ssd:Elements")
    for part in loop.fmus:
        _component(elements, part, loop)
    connections = SubElement(system, "ssd:Connections")
    for source, output, sink, taken in loop.connections:
        ends = {
            "startElement": source,
            "startConnector": output,
            "endElement": sink,
            "endConnector": taken,
        }
        SubElement(connections, "ssd:Connection", ends)
    _master_of_omsimulator(system, loop.step)
    times = {"startTime": "0.0", "stopTime": repr(loop.stop_time)}
    experiment = SubElement(root, "ssd:DefaultExperiment", times)
    annotations = SubElement(experiment, "ssd:Annotations")
    annotation = SubElement(annotations, "ssc:Annotation", {"type": OSP})
    algorithm = SubElement(annotation, "osp:Algorithm")
    SubElement(algorithm, "osp:FixedStepAlgorithm", {"baseStepSize": repr(loop.step)})
    indent(root)
    text: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


def _master_of_omsimulator(system: Element, step: float) -> None:
    """What OMSimulator wants to find in a system: its own master with a fixed step."""
    annotation = SubElement(SubElement(system, "ssd:Annotations"), "ssc:Annotation", {"type": OMS})
    information = SubElement(SubElement(annotation, "oms:Annotations"), "oms:SimulationInformation")
    tolerances = dict.fromkeys(("absoluteTolerance", "relativeTolerance"), OMS_TOLERANCE)
    master = {"description": "oms-ma", "stepSize": repr(step)} | tolerances
    SubElement(information, "oms:FixedStepMaster", master)


def _component(elements: Element, part: str, loop: Loop) -> None:
    """One FMU, with the connectors that are used and its start values."""
    fmu = loop.fmus[part]
    component = SubElement(
        elements,
        "ssd:Component",
        {
            "name": part,
            "type": "application/x-fmu-sharedlibrary",
            "source": f"resources/{fmu.name}",
        },
    )
    connectors = SubElement(component, "ssd:Connectors")
    used = {(output, "output") for source, output, _, _ in loop.connections if source == part}
    used |= {(taken, "input") for _, _, sink, taken in loop.connections if sink == part}
    for name, kind in sorted(used):
        connector = SubElement(connectors, "ssd:Connector", {"name": name, "kind": kind})
        SubElement(connector, "ssc:Real")
    start = loop.start.get(part, {})
    if start:
        description = describe(fmu)
        check_start_values(fmu, description, start)
        types = {v.name: v.type for v in description.modelVariables}
        bindings = SubElement(component, "ssd:ParameterBindings")
        binding = SubElement(bindings, "ssd:ParameterBinding")
        values = SubElement(binding, "ssd:ParameterValues")
        given = SubElement(values, "ssv:ParameterSet", {"version": "1.0", "name": PARAMETERS})
        parameters = SubElement(given, "ssv:Parameters")
        for name, value in start.items():
            parameter = SubElement(parameters, "ssv:Parameter", {"name": name})
            SubElement(parameter, f"ssv:{types[name]}", {"value": _text(types[name], value)})


def _text(kind: str, value: Any) -> str:
    return repr(float(value)) if kind == "Real" else str(value)

"""interface.h of a native FMU, written from the interface table; for the build, not in an FMU."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from chaincrane.parameters import CHOICES, allowed, checked
from chaincrane.variables import Variable

KINDS = ("Real", "Integer", "String", "Boolean")


def c_header(
    model: str,
    guid: str,
    sources: str,
    variables: Sequence[Variable],
    categories: Sequence[str],
) -> str:
    """The header of ``model``'s FMU: names, kinds, start values, ranges; what the XML says too."""
    places = {variable.name: place for place, variable in enumerate(variables)}
    settable = [variable for variable in variables if variable.causality != "output"]
    texts = [variable.name for variable in settable if variable.kind == "String"]
    inputs = [variable for variable in settable if variable.causality == "input"]
    order = [places[name] for name in checked()]
    counts = {
        "INPUTS": len(inputs),
        "PARAMETERS": len(settable) - len(inputs),
        "SETTABLE": len(settable),
        "OUTPUTS": len(variables) - len(settable),
        "VARIABLES": len(variables),
        "STRINGS": len(texts),
        "LOG_CATEGORIES": len(categories),
    }
    rows = [_row(variable, texts) for variable in variables]
    references = [f"    VR_{_constant(v.name)} = {places[v.name]}," for v in variables]
    most = max(map(len, CHOICES.values()))
    logs = [f"LOG_{_snake(name.removeprefix('log'))}" for name in categories]
    return "\n".join(
        (
            "/* Written by build_fmu.py from the interface's table in Python: do not edit. */",
            "#ifndef INTERFACE_H",
            "#define INTERFACE_H",
            "",
            "#include <math.h>",
            "#include <stddef.h>",
            "",
            f"#define MODEL_IDENTIFIER {_text(model)}",
            f"#define MODEL_GUID {_text(guid)}",
            f"#define MODEL_SOURCES {_text(sources)}",
            "",
            *(f"enum {{ {name} = {count} }};" for name, count in counts.items()),
            "",
            "/* value references: a variable's place in the table */",
            "enum {",
            *references,
            "};",
            "",
            f"typedef enum {{ {', '.join(kind.upper() for kind in KINDS)} }} Kind;",
            "",
            "typedef struct {",
            "    const char *name;",
            "    Kind kind;",
            "    double start, minimum, maximum;",
            "    int text;                   /* of a String: its place among the Strings */",
            "    const char *start_text;     /* of a String */",
            "    const char *allowed;        /* in words, of a parameter */",
            f"    const char *choices[{most + 1}];     /* of a String; NULL ends them */",
            "} Variable;",
            "",
            "/* static: each file has its own copy, and none changes it */",
            f"static const char *const KIND_NAME[] = {{{', '.join(map(_text, KINDS))}}};",
            f"static const Variable VARIABLE[] = {{\n{chr(10).join(rows)}\n}};",
            "/* parameters in the order in which they are checked */",
            f"static const int CHECK_ORDER[] = {{{', '.join(map(str, order))}}};",
            f"enum {{ {', '.join(logs)} }};",
            "static const char *const LOG_CATEGORY[] = {",
            f"    {', '.join(map(_text, categories))}}};",
            "",
            "#endif",
            "",
        )
    )


def _row(variable: Variable, texts: list[str]) -> str:
    text = variable.kind == "String"
    name = variable.name
    words = _text(allowed(name)) if variable.causality == "parameter" else "NULL"
    choices = [_text(choice) for choice in CHOICES.get(name, ())]
    cells = (
        _text(name),
        variable.kind.upper(),
        _number(0.0 if text else variable.start, "0.0"),
        _number(variable.minimum, "-INFINITY"),
        _number(variable.maximum, "INFINITY"),
        str(texts.index(name)) if text else "-1",
        _text(str(variable.start)) if text else "NULL",
        words,
        "{" + ", ".join([*choices, "NULL"]) + "}",
    )
    return f"    {{{', '.join(cells)}}},"


def _number(value: Any, missing: str) -> str:
    """A double that keeps every digit."""
    return missing if value is None else repr(float(value))


def _text(value: str) -> str:
    return json.dumps(value)


def _constant(name: str) -> str:
    """chain.x[1] -> CHAIN_X_1."""
    return name.replace(".", "_").replace("[", "_").replace("]", "").upper()


def _snake(name: str) -> str:
    """StatusError -> STATUS_ERROR."""
    return "".join(f"_{c}" if c.isupper() and place else c for place, c in enumerate(name)).upper()

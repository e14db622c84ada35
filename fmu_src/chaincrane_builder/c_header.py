"""The C headers that are written from the tables in Python: twins.h and interface.h.

twins.h has what a model in C shares with its twin in Python: constants, choices, and the structures
that go between them. interface.h has what the FMI layer of a native FMU knows of its variables.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from chaincrane.plant.interface import (
    EXPERIMENT_TOLERANCE_ALLOWED,
    INPUTS,
    LAST_COMMAND,
    LINEAR_STATE,
    NO_SLACK,
    NONLINEAR_STATE,
    NOT_PREDICTABLE,
    OUTPUTS,
    PARAMETERS,
    PAST_STEP,
    SHARED_STATE,
    TOLERANCE_NOT_KEPT,
    TOLERANCE_STATE,
)
from chaincrane.plant.kernel import FAILURE, Outcome, layout
from chaincrane.variables import Variable

from .fmus import SOURCES

KINDS = ("Real", "Integer", "String", "Boolean")
WORDS = {
    "EXPERIMENT_TOLERANCE_ALLOWED": EXPERIMENT_TOLERANCE_ALLOWED,
    "NO_SLACK": NO_SLACK,
    "NOT_PREDICTABLE": NOT_PREDICTABLE,
    "TOLERANCE_NOT_KEPT": TOLERANCE_NOT_KEPT,
}
# Modules whose public constants are their C twins' too.
SHARED_MODULES = (
    *sorted((SOURCES / "chaincrane" / "plant").glob("*.py")),
    SOURCES / "chaincrane" / "clock.py",
)


def constants(modules: Iterable[Path] = SHARED_MODULES) -> dict[str, tuple[Any, str]]:
    """Numbers, or tuples of them, in capitals at the top of modules: value and module by name.

    Names that begin with an underscore are the module's own. Raises ValueError where two modules
    share a name.
    """
    found: dict[str, tuple[Any, str]] = {}
    for module in modules:
        for name, value in _numbers(ast.parse(module.read_text(encoding="utf-8"))):
            if name in found:
                raise ValueError(f"{name} is a constant of {found[name][1]} and of {module.name}")
            found[name] = value, module.name
    return found


def _numbers(tree: ast.Module) -> Iterator[tuple[str, Any]]:
    for node in tree.body:
        if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Name):
            continue
        name = node.targets[0].id
        if not re.fullmatch(r"[A-Z][A-Z0-9_]*", name):
            continue
        try:
            value = ast.literal_eval(node.value)
        except ValueError:
            continue
        if all(isinstance(one, (int, float)) for one in _each(value)):
            yield name, value


def _each(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def twins_header() -> str:
    """twins.h: what the models in C share with those in Python."""
    lines = [
        "/* Written by the build from the tables in chaincrane/plant: do not edit.",
        "   Every structure is of doubles alone, in the order of its table. */",
        "#ifndef TWINS_H",
        "#define TWINS_H",
        "",
        *_constant_lines(),
        "",
        *_choice_lines(),
        "",
        *(
            f"enum {{ {name} = {len(rows)} }};"
            for name, rows in (("INPUTS", INPUTS), ("PARAMETERS", PARAMETERS), ("OUTPUTS", OUTPUTS))
        ),
        "",
        *_structure("Command", {row.symbol: row.unit or "" for row in INPUTS}),
        *_structure("Settings", {row.symbol: _settings_note(row) for row in PARAMETERS}),
        *_structure("Outputs", _output_members()),
        *_structure("SharedState", SHARED_STATE),
        *_structure("NonlinearState", _own_members(NONLINEAR_STATE)),
        *_structure("LinearState", _own_members(LINEAR_STATE)),
        *_structure("ToleranceState", TOLERANCE_STATE),
        *_structure("PastStep", _past_members()),
        *_structure("Failure", FAILURE),
        "/* How a step ends. */",
        f"typedef enum {{ {', '.join(f'{one.name} = {one.value}' for one in Outcome)} }} Outcome;",
        "",
        *(f"static const char {name}[] = {_text(words)};" for name, words in WORDS.items()),
        "",
        "/* A hash of these structures, for kernel.py. */",
        f"static const char LAYOUT[] = {_text(layout())};",
        "",
        "/* Does not compile where a structure is not what its table says. */",
        *(
            f"typedef char {name}_size[sizeof({name}) == {size} * sizeof(double) ? 1 : -1];"
            for name, size in _sizes().items()
        ),
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _sizes() -> dict[str, int]:
    return {
        "Command": len(INPUTS),
        "Settings": len(PARAMETERS),
        "Outputs": len(OUTPUTS),
        "NonlinearState": len(NONLINEAR_STATE),
        "LinearState": len(LINEAR_STATE),
        "ToleranceState": len(TOLERANCE_STATE),
        "PastStep": len(PAST_STEP),
        "Failure": len(FAILURE),
    }


def _constant_lines() -> Iterator[str]:
    for name, (value, module) in constants().items():
        note = f"/* {module} */"
        if isinstance(value, tuple):
            yield f"static const double {name}[] = {{{', '.join(map(repr, value))}}}; {note}"
        elif isinstance(value, int):
            yield f"enum {{ {name} = {value} }}; {note}"
        else:
            yield f"static const double {name} = {value!r}; {note}"


def _choice_lines() -> Iterator[str]:
    """A String parameter's choices, by number: SOLVER_SCHEME_NEWMARK."""
    for row in PARAMETERS:
        if row.choices:
            names = (f"{row.symbol}_{choice}".upper() for choice in row.choices)
            yield f"enum {{ {', '.join(names)} }};"


def _settings_note(row: Variable) -> str:
    if row.choices:
        return f"{row.symbol.upper()}_..."
    return row.unit or "a whole number"


def _output_members() -> dict[str, str]:
    """Outputs as members; those with an index become one array, chain_x[10]."""
    members: dict[str, str] = {}
    for row in OUTPUTS:
        base, bracket, _ = row.name.partition("[")
        if not bracket:
            members[row.symbol] = row.unit or "a whole number"
        else:
            name = base.replace(".", "_")
            count = sum(one.name.startswith(f"{base}[") for one in OUTPUTS)
            members[f"{name}[{count}]"] = row.unit or ""
    return members


def _own_members(state: Mapping[str, str]) -> dict[str, str]:
    """A crane's state as members: what all share as one structure, and so the last command."""
    members = {"SharedState shared": "what every state begins with"}
    for name, note in state.items():
        if name.startswith(LAST_COMMAND):
            members[f"Command {LAST_COMMAND.rstrip('.')}"] = "of the last step, if loaded"
        elif name not in SHARED_STATE:
            members[name] = note
    return members


def _past_members() -> dict[str, str]:
    """A communication step that can be run anew, as members."""
    members: dict[str, str] = {}
    for name, note in PAST_STEP.items():
        if name in (row.symbol for row in INPUTS):
            members["Command command"] = "held over it"
        else:
            members[name] = note
    return members


def _structure(name: str, members: Mapping[str, str]) -> list[str]:
    """A structure of doubles; a member that names its own type keeps it."""
    rows = [
        f"    {member if ' ' in member else f'double {member}'}; /* {note} */"
        for member, note in members.items()
    ]
    return ["typedef struct {", *rows, f"}} {name};", ""]


# A function or an object that a header of ours announces, at the start of a line.
_ANNOUNCED = re.compile(
    r"^(?!static|typedef|enum|struct|return|else)(?:extern )?[A-Za-z][\w ]*?[ *]+(\w+)(?:\(|;)",
    flags=re.MULTILINE,
)


def announced(header: str) -> list[str]:
    """Names of the functions and objects that a header of ours announces."""
    return _ANNOUNCED.findall(header)


def names_header(prefix: str, headers: Iterable[str]) -> str:
    """names.h: all that ``headers`` announce gets a name of this library's alone, hidden in it."""
    names = sorted({name for text in headers for name in announced(text)})
    return "\n".join(
        (
            "/* Written by the build: do not edit. What is not FMI's is named after the library,",
            "   so that two can be linked into one program, and it stays within the library. */",
            "#ifndef NAMES_H",
            "#define NAMES_H",
            "",
            "#if defined(__GNUC__) && !defined(_WIN32)",
            '#define HIDDEN _Pragma("GCC visibility push(hidden)")',
            '#define SHOWN _Pragma("GCC visibility pop")',
            "#else",
            "#define HIDDEN",
            "#define SHOWN",
            "#endif",
            "",
            *(f"#define {name} {prefix}_{name}" for name in names),
            "",
            "#endif",
            "",
        )
    )


def interface_header(
    model: str,
    guid: str,
    sources: str,
    variables: Sequence[Variable],
    categories: Sequence[str],
) -> str:
    """interface.h of ``model``'s FMU: names, kinds, start values, ranges; what the XML says too."""
    places = {variable.name: place for place, variable in enumerate(variables)}
    settable = [variable for variable in variables if variable.causality != "output"]
    texts = [variable.name for variable in settable if variable.kind == "String"]
    counts = {
        "SETTABLE": len(settable),
        "VARIABLES": len(variables),
        "STRINGS": len(texts),
        "LOG_CATEGORIES": len(categories),
    }
    rows = [_row(variable, texts) for variable in variables]
    references = [f"    VR_{v.symbol.upper()} = {places[v.name]}," for v in variables]
    most = max(len(variable.choices) for variable in variables)
    logs = [f"LOG_{_snake(name.removeprefix('log'))}" for name in categories]
    return "\n".join(
        (
            "/* Written by the build from the interface's table in Python: do not edit. */",
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
    words = _text(variable.allowed) if variable.causality == "parameter" else "NULL"
    cells = (
        _text(name),
        variable.kind.upper(),
        _number(0.0 if text else variable.start, "0.0"),
        _number(variable.minimum, "-INFINITY"),
        _number(variable.maximum, "INFINITY"),
        str(texts.index(name)) if text else "-1",
        _text(str(variable.start)) if text else "NULL",
        words,
        "{" + ", ".join([*map(_text, variable.choices), "NULL"]) + "}",
    )
    return f"    {{{', '.join(cells)}}},"


def _number(value: Any, missing: str) -> str:
    """A double that keeps every digit."""
    return missing if value is None else repr(float(value))


def _text(value: str) -> str:
    return json.dumps(value)


def _snake(name: str) -> str:
    """StatusError -> STATUS_ERROR."""
    return "".join(f"_{c}" if c.isupper() and place else c for place, c in enumerate(name)).upper()

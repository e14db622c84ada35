"""Rung 0, the house: which room knows of which, and what the twins share.

A model in C and its twin in Python have one table of constants and structures; their equations are
written twice. So a number in an equation is either part of its formula or has a name in the table.
"""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from conftest import ROOT

from chaincrane.control.antisway import AntiSwayInput
from chaincrane.control.observer import ObserverInput
from chaincrane.plant.command import Command
from chaincrane.plant.kernel import KernelMissing, load_library
from chaincrane.variables import rows
from chaincrane_builder.c_header import announced, constants
from chaincrane_builder.compile_c import cc_library, has_cc, has_zig, included, zig_library
from chaincrane_builder.pack import imported

SOURCES = ROOT / "fmu_src"
PACKAGE = SOURCES / "chaincrane"
NATIVE = SOURCES / "native"
CRANES = ("crane_nl", "crane_lin", "crane_nl_native", "crane_lin_native")
# Numbers that formulas are made of.
OF_FORMULAS = {0.0, 0.25, 0.5, *map(float, range(9))}
# Files with numbers that are theirs alone, or with a formula that has others.
THEIR_OWN = {
    "chain.py": {12.0},  # the averaged mass matrix
    "chain.c": {12.0},
    "nonlinear.c": {15.0, 16.0},  # memory in units of 16 bytes
    "tolerance.c": {15.0, 16.0},
    "inextensible.c": {30.0, 1e-17},  # Jacobi's method
    "linear.c": {15.0, 16.0, 1e-100, 1e-9},
    "fmi2_slave.c": {1e-12, 32.0, 64.0, 256.0},
    "start_values.c": {64.0},
}
WITH_TWINS = [
    "chain.h",
    "chain.c",
    "crane.c",
    "banded.h",
    "energy_momentum.c",
    "jump.c",
    "newmark.c",
    "truss.c",
    "inextensible.c",
    "nonlinear.c",
    "tolerance.c",
    "linear.c",
    "start_values.c",
    "fmi2_slave.c",
]


def imports(file: Path) -> Iterator[str]:
    """Modules of ours that a file imports, from the top."""
    inside = file.relative_to(SOURCES).parts if SOURCES in file.parents else ()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = (*inside[: -node.level], node.module) if node.level else (node.module,)
            for alias in node.names:
                name = ".".join(part for part in base if part)
                yield f"{name}.{alias.name}"


# --- rooms --------------------------------------------------------------------------------------


def test_control_never_enters_plant() -> None:
    for file in (PACKAGE / "plant").glob("*.py"):
        assert not [name for name in imports(file) if "control" in name], file


def test_the_driver_imports_no_model() -> None:
    for file in (ROOT / "chaincrane_driver").glob("*.py"):
        assert not [name for name in imports(file) if re.match(r"chaincrane\b", name)], file


def test_what_travels_knows_nothing_of_the_build() -> None:
    for file in [*PACKAGE.rglob("*.py"), *SOURCES.glob("*.py")]:
        names = list(imports(file))
        assert not [name for name in names if "chaincrane_" in name], file


def test_no_module_imports_itself_over_others() -> None:
    known: dict[str, set[str]] = {}
    for file in [*SOURCES.rglob("*.py"), *(ROOT / "chaincrane_driver").glob("*.py")]:
        root = SOURCES if SOURCES in file.parents else ROOT
        name = ".".join(file.relative_to(root).with_suffix("").parts)
        known[name.removesuffix(".__init__")] = set(imports(file))
    graph = {
        name: {other for other in known if other != name and _reaches(found, other)}
        for name, found in known.items()
    }
    for name in graph:
        seen, waiting = set(), list(graph[name])
        while waiting:
            other = waiting.pop()
            assert other != name, f"{name} imports itself"
            if other not in seen:
                seen.add(other)
                waiting += graph[other]


def _reaches(found: set[str], module: str) -> bool:
    return any(name == module or name.rpartition(".")[0] == module for name in found)


def test_an_fmu_packs_what_it_imports() -> None:
    for model in ("crane_nl", "crane_lin"):
        assert not [name for name in imported(model) if "control" in name]
    assert "chaincrane/plant/kernel.py" not in imported("crane_lin")
    assert "chaincrane/plant/nonlinear.py" not in imported("crane_observer")
    assert "chaincrane/control/antisway.py" not in imported("crane_observer")


def guids(folder: Path) -> dict[str, str | None]:
    """Guids of the cranes' FMUs in a folder."""
    found = {}
    for model in CRANES:
        with zipfile.ZipFile(folder / f"{model}.fmu") as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        found[model] = root.get("guid")
    return found


def test_a_comment_in_control_leaves_the_cranes_guids(
    fmus: Path, native_fmus: Path, tmp_path: Path
) -> None:
    """Their saved states go on; and a comment in plant makes other FMUs of them."""
    copy = tmp_path / "tree"
    shutil.copytree(SOURCES, copy / "fmu_src", ignore=shutil.ignore_patterns("*cache*"))
    for name in ("build_fmu.py", "LICENSE"):
        shutil.copy(ROOT / name, copy)

    def built_with_a_comment_in(room: str) -> dict[str, str | None]:
        for file in (copy / "fmu_src" / "chaincrane" / room).glob("*.py"):
            file.write_text(file.read_text() + "# a comment\n")
        command = [sys.executable, "build_fmu.py", "--dest", room, *CRANES]
        subprocess.run(command, cwd=copy, check=True)
        return guids(copy / room)

    for model in CRANES[2:]:
        shutil.copy(native_fmus / f"{model}.fmu", tmp_path)
    for model in CRANES[:2]:
        shutil.copy(fmus / f"{model}.fmu", tmp_path)
    assert built_with_a_comment_in("control") == guids(tmp_path)
    changed = built_with_a_comment_in("plant")
    assert all(changed[model] != guids(tmp_path)[model] for model in CRANES[:2])
    # a comment is not in what C is made from
    assert all(changed[model] == guids(tmp_path)[model] for model in CRANES[2:])


# --- one table ----------------------------------------------------------------------------------


def test_what_a_header_announces_stays_in_its_library() -> None:
    headers = {file.name: file.read_text() for file in NATIVE.glob("*.h")}
    names = {name for name in headers if announced(headers[name])}
    assert {"crane.h", "nonlinear.h", "text.h"} <= names and "scheme.h" not in names
    for name in names:
        inside = re.search(r"(?ms)^HIDDEN$(.*)^SHOWN$", headers[name])
        assert inside and announced(inside[1]) == announced(headers[name]), name
        assert '#include "names.h"' in headers[name], name


def without_comments(text: str) -> str:
    """C without comments, texts and preprocessor's lines."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)
    return re.sub(r'"(\\.|[^"\\])*"|^\s*#[^\n]*', " ", text, flags=re.MULTILINE)


@pytest.mark.parametrize("name", WITH_TWINS)
def test_a_number_in_c_is_part_of_a_formula_or_has_a_name(name: str) -> None:
    allowed = OF_FORMULAS | THEIR_OWN.get(name, set())
    text = without_comments((NATIVE / name).read_text())
    found = re.findall(r"(?<![\w.])\d+(?:\.\d*)?(?:[eE][-+]?\d+)?", text)
    assert {float(number) for number in found} <= allowed


@pytest.mark.parametrize("file", sorted((PACKAGE / "plant").glob("*.py")), ids=lambda f: f.name)
def test_a_number_in_a_models_function_is_part_of_a_formula_or_has_a_name(file: Path) -> None:
    for function in ast.walk(ast.parse(file.read_text())):
        if isinstance(function, ast.FunctionDef):
            numbers = {
                node.value
                for node in ast.walk(function)
                if isinstance(node, ast.Constant) and type(node.value) in (int, float)
            }
            allowed = OF_FORMULAS | THEIR_OWN.get(file.name, set())
            assert numbers <= allowed, (function.name, numbers - allowed)


def test_every_constant_is_read_by_both_twins() -> None:
    """In capitals in Python: then it is in C too, under the same name, and is used there."""
    native = "".join(without_comments(file.read_text()) for file in NATIVE.glob("*.[ch]"))
    assert len(constants()) >= 25
    for name, (_, module) in constants().items():
        (file,) = [one for one in SOURCES.rglob(module) if "control" not in one.parts]
        assert len(re.findall(rf"\b{name}\b", file.read_text())) >= 2, name
        assert re.search(rf"\b{name}\b", native), f"{name} of {module} is not read in C"


def test_a_name_means_one_constant(tmp_path: Path) -> None:
    for name in ("one.py", "two.py"):
        (tmp_path / name).write_text("TOLERANCE = 1e-3\n")
    with pytest.raises(ValueError, match=r"TOLERANCE is a constant of one\.py and of two\.py"):
        constants([tmp_path / "one.py", tmp_path / "two.py"])


@pytest.mark.parametrize("inputs", [Command, ObserverInput, AntiSwayInput])
def test_an_input_has_the_name_of_its_row(inputs: Any) -> None:
    assert [field.name for field in fields(inputs)] == [row.symbol for row in rows(inputs)]


# --- what C and Python hand each other ----------------------------------------------------------


def compiled(sources: dict[str, bytes]) -> bytes:
    """This host's library of C files; raises CalledProcessError."""
    if has_zig() and sys.platform.startswith("linux"):
        return zig_library("linux64", sources, "changed")
    if not has_cc():
        pytest.skip("no compiler")
    return cc_library(sources)


def changed(name: str, old: str, new: str) -> dict[str, bytes]:
    """The nonlinear crane's C files with one thing replaced."""
    sources = included("kernel", "kernel.c", "tolerance.c")
    text = sources[name].decode()
    assert old in text
    return sources | {name: text.replace(old, new, 1).encode()}


@pytest.mark.parametrize("member", ["payload_colour", "chain_z[0]"])
def test_an_output_that_is_not_in_the_table_does_not_compile(member: str) -> None:
    line = "    o->trolley_fx = head->trolley_fx;\n"
    sources = changed("nonlinear.c", line, f"{line}    o->{member} = 0.0;\n")
    with pytest.raises(subprocess.CalledProcessError) as error:
        compiled(sources)
    assert member.partition("[")[0] in error.value.stderr


def test_a_structure_that_is_not_its_table_does_not_compile() -> None:
    with pytest.raises(subprocess.CalledProcessError) as error:
        compiled(changed("twins.h", "} Command;", "double colour;\n} Command;"))
    assert "Command_size" in error.value.stderr


def test_a_kernel_of_another_interface_is_refused(tmp_path: Path) -> None:
    library = tmp_path / "crane_kernel.so"
    library.write_bytes(compiled(changed("twins.h", 'LAYOUT[] = "', 'LAYOUT[] = "0')))
    with pytest.raises(KernelMissing, match="has another interface than this package"):
        load_library(str(library))

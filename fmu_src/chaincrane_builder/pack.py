"""Packs FMUs: gathers what one needs and no more, names the build by its content, writes a file.

The same sources give the same bytes: the guid is the content's hash, entries are sorted and dated
by SOURCE_DATE_EPOCH (or 1980), and modules inside an FMU carry the hash in their names, so that
several FMUs, or two builds of one, can live in one process.
"""

from __future__ import annotations

import ast
import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime, timezone
from hashlib import sha256
from importlib.metadata import distribution, version
from pathlib import Path

from . import compile_c, icon, model_description
from .c_header import SHARED_MODULES, interface_header
from .fmus import FMUS, LICENCE, NATIVE, NATIVE_MODELS, SOURCES

PACKAGE, SLAVE = "chaincrane", "fmi_slave"
EARLIEST = 315532800  # 1980-01-01, the first day that a zip file can name
FMI_SLAVE_C = "fmi2_slave.c"
OF_THE_BUILD = ("c_header", "compile_c", "fmus", "model_description", "pack")  # what decides an FMU


Say = Callable[[str], None]  # is told what is being done


def build(
    model: str,
    dest: Path,
    sources: Mapping[str, bytes] | None = None,
    say: Say = lambda text: None,
) -> Path:
    """Build one FMU into the folder ``dest``; its path. Raises CalledProcessError.

    ``sources``: other Python files than the tree's, as :func:`imported` gives them.
    """
    if model in NATIVE_MODELS:
        return _build_native(model, dest, say)
    return _build_python(model, dest, imported(model) if sources is None else sources, say)


# --- what a Python FMU imports ------------------------------------------------------------------


def imported(model: str) -> dict[str, bytes]:
    """Python files that ``model``'s slave imports, directly or not, by their path in fmu_src."""
    found: dict[str, bytes] = {}
    waiting = [SOURCES / f"{model}.py"]
    while waiting:
        file = waiting.pop()
        name = file.relative_to(SOURCES).as_posix()
        if name not in found:
            found[name] = file.read_bytes()
            waiting += _imports(file)
    return dict(sorted(found.items()))


def _imports(file: Path) -> Iterator[Path]:
    """Our own files that one file imports, and the packages that hold them."""
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(file, node)
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            place = SOURCES.joinpath(*name.split("."))
            if place.with_suffix(".py").exists():
                yield place.with_suffix(".py")
                place = place.parent
            while place != SOURCES and (place / "__init__.py").exists():
                yield place / "__init__.py"
                place = place.parent


def _absolute(file: Path, node: ast.ImportFrom) -> str:
    """The module that ``from ..x import y`` names, from the top."""
    if not node.level:
        return node.module or ""
    package = file.relative_to(SOURCES).parts[: -node.level]
    return ".".join((*package, *([node.module] if node.module else [])))


# --- building -----------------------------------------------------------------------------------


_KERNELS: dict[str, dict[str, bytes]] = {}  # compiled once in a process, by the crane's C file


def _kernels(crane: str, say: Say) -> dict[str, bytes]:
    if crane not in _KERNELS:
        _KERNELS[crane] = {
            f"resources/native/{path}": content
            for path, content in compile_c.kernel_libraries(crane, say).items()
        }
    return _KERNELS[crane]


def _build_python(model: str, dest: Path, sources: Mapping[str, bytes], say: Say) -> Path:
    from pythonfmu.builder import FmuBuilder

    kernel = FMUS[model].kernel
    kernels = _kernels(kernel, say) if kernel else {}
    pythonfmu = f"pythonfmu {version('pythonfmu')}"
    tool = f"chaincrane, {pythonfmu}"
    carried = kernels | _licences("chaincrane", "pythonfmu")
    digest = _content_hash(model, tool, {**sources, **carried})
    tag = digest[:12]
    say("packing")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch, "src")
        folder.mkdir()
        _stage(sources, digest, folder)
        sys.path.insert(0, str(SOURCES))  # what the slaves share stands beside them
        try:
            raw = FmuBuilder.build_FMU(
                folder / f"{model}_{tag}.py",
                dest=scratch,
                project_files=[folder / f"{PACKAGE}_{tag}", folder / f"{SLAVE}_{tag}.py"],
            )
        finally:
            sys.path.remove(str(SOURCES))
        for name in [name for name in sys.modules if f"_{tag}" in name]:
            del sys.modules[name]  # an FMU that is run in this process later loads its own
        with zipfile.ZipFile(raw) as archive:
            entries = {name: archive.read(name) for name in archive.namelist()}
    return _finish(model, digest, entries | carried, tool, dest)


def _stage(sources: Mapping[str, bytes], digest: str, folder: Path) -> None:
    """Write the sources with module names that are unique to their content."""
    tag = digest[:12]
    absolute = re.compile(rf"^( *from| *import) ({PACKAGE}|{SLAVE})\b", flags=re.MULTILINE)
    renamed = re.compile(r"^(\w+?)(/|\.py$)")
    for name, content in sources.items():
        text = absolute.sub(rf"\1 \2_{tag}", content.decode())
        if name == f"{PACKAGE}/build_info.py":
            text = text.replace('SOURCES = "unbuilt"', f'SOURCES = "{digest}"')
        target = folder / renamed.sub(rf"\1_{tag}\2", name)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(text.encode())


def native_sources(model: str) -> tuple[dict[str, bytes], str]:
    """C files and headers of a native FMU, by name, and its content's hash.

    The headers of the FMI standard are those of the FMPy that is installed.
    """
    import fmpy

    fmu = FMUS[model]
    assert fmu.crane is not None
    standard = sorted((Path(fmpy.__file__).parent / "c-code").glob("fmi2*.h"))
    sources = compile_c.included(model, FMI_SLAVE_C, fmu.crane)
    sources |= {file.name: file.read_bytes() for file in standard}

    def header(digest: str) -> bytes:
        categories = tuple(model_description.LOG_CATEGORIES)
        text = interface_header(model, f"{{{digest}}}", digest, fmu.variables, categories)
        return text.encode()

    made_from = {**sources, "interface.h": header(""), "settings": compile_c.settings().encode()}
    digest = _content_hash(model, _native_tool(), made_from | _licences("chaincrane"))
    return sources | {"interface.h": header(digest)}, digest


def _native_tool() -> str:
    return f"chaincrane, {compile_c.compiler()}"


def _build_native(model: str, dest: Path, say: Say) -> Path:
    sources, digest = native_sources(model)
    libraries = compile_c.libraries(sources, model, say=say)
    entries = {f"binaries/{name}": content for name, content in libraries.items()}
    entries |= {f"sources/{name}": content for name, content in sources.items()}
    return _finish(model, digest, entries | _licences("chaincrane"), _native_tool(), dest)


# --- what every FMU has -------------------------------------------------------------------------


def _content_hash(model: str, tool: str, made_from: Mapping[str, bytes]) -> str:
    """Hash of all that makes an FMU, but for its date and for the hash itself."""
    digest = sha256(tool.encode())
    for name, content in sorted({**made_from, **_described(model, "", "", tool)}.items()):
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def _described(model: str, digest: str, date: str, tool: str) -> dict[str, bytes]:
    """XML, icon and documentation of an FMU, by FMU path."""
    folder, fmu = SOURCES / "documentation", FMUS[model]
    files = [file for file in sorted(folder.iterdir()) if file.suffix != ".html"]
    page = (folder / fmu.page).read_text(encoding="utf-8")
    c_files = [] if fmu.crane is None else _c_files(model)
    return {
        "modelDescription.xml": model_description.model_description(
            model, digest, date, tool, c_files
        ),
        "model.png": icon.png(icon.draw()),
        **{f"documentation/{file.name}": file.read_bytes() for file in files},
        "documentation/index.html": model_description.documentation(model, digest, page).encode(),
    }


def _c_files(model: str) -> list[str]:
    crane = FMUS[model].crane
    assert crane is not None
    return [name for name in compile_c.included(model, FMI_SLAVE_C, crane) if name.endswith(".c")]


def made_from(model: str) -> bytes:
    """Hashes of all files that decide what ``model``'s FMU does, in sha256sum's format.

    A driver beside the sources sees by them whether the FMU is still what the sources say. They are
    not in the guid: a comment here leaves an FMU of C what it was.
    """
    fmu = FMUS[model]
    crane = fmu.crane or fmu.kernel
    files = [SOURCES / name for name in imported(model.removesuffix(NATIVE))]
    if crane is not None:
        root = FMI_SLAVE_C if fmu.crane else "kernel.c"
        files += [SOURCES / "native" / name for name in compile_c.included(root, crane)]
        files += [SOURCES / "native" / compile_c.NO_STARTUP, *SHARED_MODULES]
    names = {file.relative_to(SOURCES).as_posix(): file for file in files if file.exists()}
    here = Path(__file__).parent
    names |= {f"{here.name}/{name}.py": here / f"{name}.py" for name in OF_THE_BUILD}
    lines = [f"{sha256(file.read_bytes()).hexdigest()}  fmu_src/{n}" for n, file in names.items()]
    return "\n".join([*sorted(lines, key=lambda line: line[64:]), ""]).encode()


def _licences(*packages: str) -> dict[str, bytes]:
    """The licences of what an FMU carries, by FMU path."""
    found = {}
    for package in packages:
        if package == PACKAGE:
            text = LICENCE.read_bytes()
        else:
            files = distribution(package).files or []
            text = next(file for file in files if file.name == "LICENSE").read_binary()
        found[f"documentation/licenses/{package}.txt"] = text
    return found


def _finish(model: str, digest: str, entries: dict[str, bytes], tool: str, dest: Path) -> Path:
    """Add what every FMU has, and write it into the folder ``dest``; its path."""
    epoch = max(EARLIEST, int(os.environ.get("SOURCE_DATE_EPOCH", EARLIEST)))
    date = datetime.fromtimestamp(epoch, tz=timezone.utc)
    entries = entries | _described(model, digest, date.strftime("%Y-%m-%dT%H:%M:%SZ"), tool)
    entries["documentation/sources.sha256"] = made_from(model)
    dest.mkdir(parents=True, exist_ok=True)
    fmu = dest / f"{model}.fmu"
    _write_archive(fmu, entries, date)
    return fmu


def _write_archive(path: Path, entries: dict[str, bytes], date: datetime) -> None:
    """Write a zip file whose bytes depend on its entries and date alone."""
    partial = path.with_suffix(".part")
    try:
        with zipfile.ZipFile(partial, "w") as archive:
            for name in sorted(entries):
                info = zipfile.ZipInfo(name, date.timetuple()[:6])
                info.compress_type = zipfile.ZIP_DEFLATED
                info.create_system = 3  # the same on every system
                info.external_attr = 0o644 << 16
                archive.writestr(info, entries[name], compresslevel=9)
        partial.replace(path)
    finally:  # a full disk or Ctrl-C leaves nothing half-written
        partial.unlink(missing_ok=True)

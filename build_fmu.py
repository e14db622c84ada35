#!/usr/bin/env python3
"""Build the cranes' FMUs, native twins, observer and controller, and check each with FMPy.

The same sources give the same bytes: the guid is the sources' hash, entries are sorted and dated
by SOURCE_DATE_EPOCH (or 1980), and modules inside an FMU carry the hash in their names, so that
several FMUs, or two builds of one, can live in one process.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from datetime import datetime, timezone
from functools import cache
from hashlib import sha256
from importlib.metadata import distribution
from pathlib import Path, PurePosixPath

SOURCES = Path(__file__).resolve().parent / "fmu_src"
MODELS = ("crane_nl", "crane_lin", "crane_observer", "crane_antisway")
NATIVE_MODELS = ("crane_nl_native", "crane_lin_native")  # C, with no Python inside
PACKAGE, SLAVE = "chaincrane", "fmi_slave"
EARLIEST = 315532800  # 1980-01-01, the first day that a zip file can name


def read_sources(model: str) -> dict[str, bytes]:
    """The files that make ``model``'s FMU, by their path in fmu_src."""
    files = [SOURCES / f"{model}.py", SOURCES / f"{SLAVE}.py"]
    files += sorted((SOURCES / PACKAGE).glob("*.py"))
    return {file.relative_to(SOURCES).as_posix(): file.read_bytes() for file in files}


@cache
def kernel_libraries() -> dict[str, bytes]:
    """The C kernel, compiled for each platform that this machine's tools can make, by FMU path."""
    sys.path.insert(0, str(SOURCES / "native"))
    import compile_kernel

    with tempfile.TemporaryDirectory() as scratch:
        made = compile_kernel.compile_all(Path(scratch))
        return {
            f"resources/native/{file.parent.name}/{file.name}": file.read_bytes() for file in made
        }


def content_hash(sources: dict[str, bytes], native: dict[str, bytes]) -> str:
    """Hash of all that makes an FMU: its sources, what describes and builds it, pythonfmu."""
    import pythonfmu

    digest = sha256(pythonfmu.__version__.encode())
    described = [SOURCES / "model_description.py", SOURCES / "icon.py"]
    described += sorted((SOURCES / "documentation").iterdir())
    texts = {file.relative_to(SOURCES).as_posix(): file.read_bytes() for file in described}
    texts["build_fmu.py"] = Path(__file__).read_bytes()
    for name, content in sorted((sources | texts | native | licences()).items()):
        digest.update(f"{name}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def stage(sources: dict[str, bytes], digest: str, folder: Path) -> None:
    """Write the sources with module names that are unique to their content."""
    tag = digest[:12]
    imported = re.compile(rf"^( *from| *import) ({PACKAGE}|{SLAVE})\b", flags=re.MULTILINE)
    renamed = re.compile(r"^(\w+?)(/|\.py$)")
    for name, content in sources.items():
        text = imported.sub(rf"\1 \2_{tag}", content.decode())
        if name == f"{PACKAGE}/build_info.py":
            text = text.replace('SOURCES = "unbuilt"', f'SOURCES = "{digest}"')
        target = folder / renamed.sub(rf"\1_{tag}\2", name)
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(text.encode())


def build(model: str, dest: Path, sources: dict[str, bytes] | None = None) -> Path:
    """Build one FMU into the folder ``dest``, from the tree's sources or others; its path."""
    sys.path.insert(0, str(SOURCES))
    from pythonfmu import __version__
    from pythonfmu.builder import FmuBuilder

    sources = sources or read_sources(model)
    native = kernel_libraries() if model == "crane_nl" else {}
    digest = content_hash(sources, native)
    tag = digest[:12]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch, "src")
        folder.mkdir()
        stage(sources, digest, folder)
        raw = FmuBuilder.build_FMU(
            folder / f"{model}_{tag}.py",
            dest=scratch,
            project_files=[folder / f"{PACKAGE}_{tag}", folder / f"{SLAVE}_{tag}.py"],
        )
        for name in [name for name in sys.modules if f"_{tag}" in name]:
            del sys.modules[name]  # an FMU that is run in this process later loads its own
        with zipfile.ZipFile(raw) as archive:
            entries = {name: archive.read(name) for name in archive.namelist()}
    entries.update(native)
    entries.update(licences())
    return finish(model, digest, entries, f"chaincrane, pythonfmu {__version__}", dest)


def finish(model: str, digest: str, entries: dict[str, bytes], tool: str, dest: Path) -> Path:
    """Add what every FMU has, and write it into the folder ``dest``; its path."""
    import icon
    import model_description

    epoch = max(EARLIEST, int(os.environ.get("SOURCE_DATE_EPOCH", EARLIEST)))
    date = datetime.fromtimestamp(epoch, tz=timezone.utc)
    stamp = date.strftime("%Y-%m-%dT%H:%M:%SZ")
    entries["modelDescription.xml"] = model_description.model_description(
        model, digest, stamp, tool
    )
    entries["model.png"] = icon.png(icon.draw())
    for file in sorted((SOURCES / "documentation").iterdir()):
        if file.suffix != ".html":
            entries[f"documentation/{file.name}"] = file.read_bytes()
    page = (SOURCES / "documentation" / model_description.FMUS[model].page).read_text()
    filled = model_description.documentation(model, digest, page)
    entries["documentation/index.html"] = filled.encode()
    dest.mkdir(parents=True, exist_ok=True)
    fmu = dest / f"{model}.fmu"
    write_archive(fmu, entries, date)
    return fmu


def native_sources(model: str) -> tuple[dict[str, bytes], str]:
    """C files and headers of a native FMU, by name, and the hash of all that makes it.

    The headers of the FMI standard are those of the FMPy that is installed.
    """
    sys.path[:0] = [str(SOURCES), str(SOURCES / "native")]
    import compile_kernel
    import fmpy

    import c_header
    import model_description

    fmu = model_description.FMUS[model]
    standard = Path(fmpy.__file__).parent / "c-code"
    files = [SOURCES / "native" / name for name in (*fmu.c_sources, "no_startup.c")]
    headers = sorted((SOURCES / "native").glob("*.h")) + sorted(standard.glob("fmi2*.h"))
    sources = {file.name: file.read_bytes() for file in files + headers}
    makers = [SOURCES / "c_header.py", SOURCES / "native" / "compile_kernel.py"]
    makers += sorted((SOURCES / PACKAGE).glob("*.py"))
    made_by = {file.relative_to(SOURCES).as_posix(): file.read_bytes() for file in makers}
    digest = content_hash(sources | made_by, {"compiler": compile_kernel.compiler().encode()})
    categories = tuple(model_description.LOG_CATEGORIES)
    header = c_header.c_header(model, f"{{{digest}}}", digest, fmu.variables, categories)
    return sources | {"interface.h": header.encode()}, digest


def build_native(model: str, dest: Path) -> Path:
    """Build one native FMU into the folder ``dest``; its path. Raises CalledProcessError."""
    sources, digest = native_sources(model)
    import compile_kernel

    with tempfile.TemporaryDirectory() as scratch:
        for name, content in sources.items():
            Path(scratch, name).write_bytes(content)
        files = sorted(name for name in sources if name.endswith(".c"))
        libraries = compile_kernel.libraries(Path(scratch), files, model, ["-DCHAIN_STATIC"])
    entries = {f"binaries/{name}": content for name, content in libraries.items()}
    entries |= {f"sources/{name}": content for name, content in sources.items()}
    entries |= {"documentation/licenses/chaincrane.txt": (SOURCES.parent / "LICENSE").read_bytes()}
    return finish(model, digest, entries, f"chaincrane, {compile_kernel.compiler()}", dest)


def licences() -> dict[str, bytes]:
    """The licences of what an FMU carries, by FMU path."""
    files = distribution("pythonfmu").files or []
    theirs = next(file for file in files if file.name == "LICENSE")
    return {
        "documentation/licenses/chaincrane.txt": (SOURCES.parent / "LICENSE").read_bytes(),
        "documentation/licenses/pythonfmu.txt": theirs.read_binary(),
    }


def write_archive(path: Path, entries: dict[str, bytes], date: datetime) -> None:
    """Write a zip file whose bytes depend on its entries and date alone."""
    partial = path.with_suffix(".part")
    with zipfile.ZipFile(partial, "w") as archive:
        for name in sorted(entries):
            info = zipfile.ZipInfo(name, date.timetuple()[:6])
            info.compress_type = zipfile.ZIP_DEFLATED
            info.create_system = 3  # the same on every system
            info.external_attr = 0o644 << 16
            archive.writestr(info, entries[name], compresslevel=9)
    partial.replace(path)


def platforms(fmu: Path) -> str:
    """For which platforms an FMU has compiled C of ours."""
    folder = "binaries" if fmu.stem in NATIVE_MODELS else "resources/native"
    with zipfile.ZipFile(fmu) as archive:
        names = [PurePosixPath(name) for name in archive.namelist()]
    found = [name.parent.name for name in names if str(name.parent.parent) == folder]
    return ", ".join(found) or "none"


def main(arguments: list[str] | None = None) -> int:
    """Build what the command line asks for; 0 where FMPy finds no problem."""
    parser = argparse.ArgumentParser(
        description="Build the FMUs and validate them with FMPy.",
        epilog="examples:  python build_fmu.py    python build_fmu.py --dest out crane_nl"
        "    python build_fmu.py --native",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    every = MODELS + NATIVE_MODELS
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"{', '.join(every)}")
    parser.add_argument("--native", action="store_true", help=f"build {', '.join(NATIVE_MODELS)}")
    parser.add_argument("--dest", type=Path, default=Path(), help="folder for the FMUs (this one)")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.models) - set(every))
    if unknown:
        parser.error(f"no such model: {', '.join(unknown)}; there are {', '.join(every)}")
    from fmpy.validation import validate_fmu

    failed = False
    for model in options.models or (NATIVE_MODELS if options.native else MODELS):
        try:
            fmu = (build_native if model in NATIVE_MODELS else build)(model, options.dest)
        except subprocess.CalledProcessError as error:
            print(f"{model}: the C sources do not compile:\n{error.stderr}", file=sys.stderr)
            return 1
        problems = validate_fmu(str(fmu))
        for problem in problems:
            print(f"{fmu}: {problem}", file=sys.stderr)
        failed = failed or bool(problems)
        verdict = "INVALID" if problems else "valid"
        print(f"{fmu}: {verdict}, {fmu.stat().st_size // 1024} kB; C for: {platforms(fmu)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""Build the cranes' FMUs, their observer and their controller, and check each with FMPy.

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
from pathlib import Path

SOURCES = Path(__file__).resolve().parent / "fmu_src"
MODELS = ("crane_nl", "crane_lin", "crane_observer", "crane_antisway")
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

    import icon
    import model_description

    sources = sources or read_sources(model)
    native = kernel_libraries() if model == "crane_nl" else {}
    digest = content_hash(sources, native)
    tag = digest[:12]
    epoch = max(EARLIEST, int(os.environ.get("SOURCE_DATE_EPOCH", EARLIEST)))
    date = datetime.fromtimestamp(epoch, tz=timezone.utc)
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
    tool = f"chaincrane, pythonfmu {__version__}"
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
    entries.update(licences())
    dest.mkdir(parents=True, exist_ok=True)
    fmu = dest / f"{model}.fmu"
    write_archive(fmu, entries, date)
    return fmu


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


def main(arguments: list[str] | None = None) -> int:
    """Build what the command line asks for; 0 where FMPy finds no problem."""
    parser = argparse.ArgumentParser(
        description="Build the FMUs and validate them with FMPy.",
        epilog="examples:  python build_fmu.py    python build_fmu.py --dest out crane_nl",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"{', '.join(MODELS)} (all)")
    parser.add_argument("--dest", type=Path, default=Path(), help="folder for the FMUs (this one)")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.models) - set(MODELS))
    if unknown:
        parser.error(f"no such model: {', '.join(unknown)}; there are {', '.join(MODELS)}")
    from fmpy.validation import validate_fmu

    try:
        kernels = kernel_libraries()
    except subprocess.CalledProcessError as error:
        print(f"the C kernel does not compile:\n{error.stderr}", file=sys.stderr)
        return 1
    platforms = ", ".join(Path(name).parent.name for name in kernels)
    print(
        f"C kernel for: {platforms or 'no platform, as there is no compiler (NumPy runs instead)'}"
    )
    failed = False
    for model in options.models or MODELS:
        fmu = build(model, options.dest)
        problems = validate_fmu(str(fmu))
        for problem in problems:
            print(f"{fmu}: {problem}", file=sys.stderr)
        failed = failed or bool(problems)
        print(f"{fmu}: {'INVALID' if problems else 'valid'}, {fmu.stat().st_size // 1024} kB")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

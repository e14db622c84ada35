"""Compiles C for FMI's platforms, with the PyPI package ziglang or the host's own compiler."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

from chaincrane.plant.kernel import KERNEL, PLATFORMS

from .c_header import names_header, twins_header
from .fmus import SOURCES

NATIVE = SOURCES / "native"
FLAGS = [
    "-std=c99",
    "-O2",
    "-ffp-contract=off",  # the same digits on every machine
    "-fno-math-errno",  # with the next: speed, and not a digit changed
    "-fno-trapping-math",
    "-fvisibility=hidden",
]
# FMI's name of a platform -> zig's target, a library's suffix, what it links. Nothing but the C
# library is needed; on Windows that is ucrtbase.dll, and no start-up code, which zig would have to
# compile first, for a minute. The baseline processor: bytes do not depend on the building machine.
TARGETS = {
    "linux64": ("x86_64-linux-gnu.2.17", "so", ["-lm"]),
    "win64": ("x86_64-windows-gnu", "dll", ["-nostdlib", "-lucrtbase"]),
    "darwin64": ("x86_64-macos", "dylib", ["-lm"]),
}
# clang would make sincos of the two, which ucrtbase.dll has not
WINDOWS_FLAGS = ["-DNO_STARTUP", "-fno-builtin-sin", "-fno-builtin-cos"]
NO_STARTUP = "no_startup.c"
_INCLUDED = re.compile(r'^#include "(\w+)\.h"', flags=re.MULTILINE)


def included(library: str, *roots: str) -> dict[str, bytes]:
    """C files of a library, by name: the roots, the headers that they include, and those's files.

    The headers twins.h and names.h are written; others that are not here are the standard's.
    """
    found: dict[str, bytes] = {"twins.h": twins_header().encode()}
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name in found or not (NATIVE / name).exists():
            continue
        found[name] = (NATIVE / name).read_bytes()
        for stem in _INCLUDED.findall(found[name].decode()):
            waiting += [f"{stem}.h", f"{stem}.c"]
    headers = [content.decode() for name, content in found.items() if name.endswith(".h")]
    found["names.h"] = names_header(library, headers).encode()
    return dict(sorted(found.items()))


def has_zig() -> bool:
    """Is the PyPI package ziglang here?"""
    return importlib.util.find_spec("ziglang") is not None


def has_cc() -> bool:
    """Has this machine a C compiler of its own?"""
    return shutil.which(os.environ.get("CC", "cc")) is not None


def compiler() -> str:
    """What compiles here, with its version."""
    if has_zig():
        return f"ziglang {importlib.metadata.version('ziglang')}"
    return os.environ.get("CC", "cc") if has_cc() else "no compiler"


def settings() -> str:
    """All that decides what a compiler makes of C files, besides them."""
    return repr((compiler(), FLAGS, TARGETS, WINDOWS_FLAGS))


def libraries(
    sources: Mapping[str, bytes],
    name: str,
    flags: Sequence[str] = (),
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, bytes]:
    """The library ``name`` of C files for every platform that this machine can make, by FMI's path.

    ``say`` is told what is being compiled. Raises CalledProcessError, whose stderr says what does
    not compile.
    """

    def compiled(platform: str) -> bytes:
        say(f"compiling C for {platform}, with {compiler()}")
        if has_zig():
            return zig_library(platform, sources, name, flags)
        return cc_library(sources, flags)

    if has_zig():
        platforms = list(TARGETS)
    elif has_cc():
        platforms = [PLATFORMS[sys.platform][0]]
    else:
        return {}
    return {f"{one}/{name}.{TARGETS[one][1]}": compiled(one) for one in platforms}


def zig_library(
    platform: str, sources: Mapping[str, bytes], name: str, flags: Sequence[str] = ()
) -> bytes:
    """A platform's shared library of C files. Raises CalledProcessError."""
    target, suffix, link = TARGETS[platform]
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", target, "-mcpu=baseline"]
    flags = [*FLAGS, *flags, *(WINDOWS_FLAGS if platform == "win64" else ["-fPIC"])]
    if platform == "darwin64":
        link = [*link, f"-Wl,-install_name,@rpath/{name}.{suffix}"]
    if platform == "win64":
        sources = {**sources, NO_STARTUP: (NATIVE / NO_STARTUP).read_bytes()}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        files = _write(sources, folder)
        for file in files:
            _run([*zig, *flags, "-c", "-o", _object(file), file], folder)
        library = f"{name}.{suffix}"
        _run([*zig, "-shared", "-s", "-o", library, *map(_object, files), *link], folder)
        content = Path(folder, library).read_bytes()
    return _undated(content) if platform == "win64" else content


def cc_library(sources: Mapping[str, bytes], flags: Sequence[str] = ()) -> bytes:
    """This host's shared library of C files, by its own compiler. Raises CalledProcessError."""
    flags = [*FLAGS, *flags, *([] if sys.platform == "win32" else ["-fPIC"])]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        files = _write(sources, folder)
        compiler = os.environ.get("CC", "cc")
        _run([compiler, *flags, "-shared", "-o", "library", *files, "-lm"], folder)
        return Path(folder, "library").read_bytes()


def library_for_host(sources: Mapping[str, bytes], name: str) -> bytes:
    """This host's shared library of C files, by zig or else by its own compiler.

    Raises CalledProcessError, or FileNotFoundError where there is no compiler.
    """
    if has_zig():
        return zig_library(PLATFORMS[sys.platform][0], sources, name)
    return cc_library(sources)


def _write(sources: Mapping[str, bytes], folder: Path) -> list[str]:
    """Write C files and headers into a folder; the names of the C files."""
    for name, content in sources.items():
        Path(folder, name).write_bytes(content)
    return sorted(name for name in sources if name.endswith(".c"))


def _object(file: str) -> str:
    return str(Path(file).with_suffix(".o"))


def _run(command: Sequence[str], folder: Path) -> None:
    environment = {**os.environ, **_zig_cache()}
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, env=environment)


@cache
def _zig_cache() -> dict[str, str]:
    """Environment that lets zig keep what it has compiled, its own C library above all.

    Where the usual folder cannot be written (no HOME, or somebody else's), zig fails or waits for
    ever: then it is the temporary folder.
    """
    if "ZIG_GLOBAL_CACHE_DIR" in os.environ:
        return {}
    try:
        usual = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
        (usual / "zig").mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=usual / "zig"):
            return {}
    except (OSError, RuntimeError):  # RuntimeError: no home
        return {"ZIG_GLOBAL_CACHE_DIR": str(Path(tempfile.gettempdir(), "zig-cache"))}


def _undated(dll: bytes) -> bytes:
    """A Windows library without the time of its linking, 4 bytes 8 bytes into its PE header."""
    stamp = struct.unpack_from("<I", dll, 0x3C)[0] + 8
    return dll[:stamp] + bytes(4) + dll[stamp + 4 :]


def kernel_libraries(
    crane: str, say: Callable[[str], None] = lambda text: None
) -> dict[str, bytes]:
    """The kernel of a crane's C file for every platform that can be made, by FMI's path."""
    return libraries(included(KERNEL, "kernel.c", crane), KERNEL, say=say)


def kernel_for_host(dest: Path, crane: str = "tolerance.c") -> Path:
    """This host's kernel of a crane's C file, written to ``dest``; its path.

    Raises CalledProcessError, or FileNotFoundError where there is no compiler.
    """
    library = dest / f"{KERNEL}.{PLATFORMS[sys.platform][1]}"
    dest.mkdir(parents=True, exist_ok=True)
    library.write_bytes(library_for_host(included(KERNEL, "kernel.c", crane), KERNEL))
    return library

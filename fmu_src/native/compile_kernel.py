"""Compile chain_kernel.c for FMI's platforms, with the PyPI package ziglang or the host's own cc.

python compile_kernel.py DEST        every platform, with ziglang; or this host's, with cc
python compile_kernel.py --cc DEST   this host's, with $CC or cc
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
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
WINDOWS_FLAGS = ["-DCHAIN_NO_STARTUP", "-fno-builtin-sin", "-fno-builtin-cos"]
KERNEL = "chain_kernel"
HOSTS = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}


def has_zig() -> bool:
    """Is the PyPI package ziglang here?"""
    return importlib.util.find_spec("ziglang") is not None


def has_cc() -> bool:
    """Has this machine a C compiler of its own?"""
    return shutil.which(os.environ.get("CC", "cc")) is not None


def zig_library(
    platform: str, folder: Path, sources: Sequence[str], name: str, flags: Sequence[str] = ()
) -> bytes:
    """A platform's shared library of C files in ``folder``. Raises CalledProcessError."""
    target, suffix, link = TARGETS[platform]
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", target, "-mcpu=baseline"]
    flags = [*FLAGS, *flags, *(WINDOWS_FLAGS if platform == "win64" else ["-fPIC"])]
    if platform == "darwin64":
        link = [*link, f"-Wl,-install_name,@rpath/{name}.{suffix}"]
    with tempfile.TemporaryDirectory() as scratch:
        made = f"{name}.{suffix}"
        objects = [str(Path(source).with_suffix(".o")) for source in sources]
        for source, compiled in zip(sources, objects, strict=True):
            _run([*zig, *flags, "-c", "-o", str(Path(scratch, compiled)), source], folder)
        _run([*zig, "-shared", "-s", "-o", made, *objects, *link], Path(scratch))
        content = Path(scratch, made).read_bytes()
    return undated(content) if platform == "win64" else content


def _run(command: Sequence[str], folder: Path) -> None:
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)


def compile_with_zig(platform: str, dest: Path) -> Path:
    """Compile one platform's kernel; returns its path. Raises CalledProcessError."""
    library = dest / platform / f"{KERNEL}.{TARGETS[platform][1]}"
    sources = [f"{KERNEL}.c", *(["no_startup.c"] if platform == "win64" else [])]
    content = zig_library(platform, HERE, sources, KERNEL)
    library.parent.mkdir(parents=True, exist_ok=True)
    library.write_bytes(content)
    return library


def undated(dll: bytes) -> bytes:
    """A Windows library without the time of its linking, 4 bytes 8 bytes into its PE header."""
    stamp = struct.unpack_from("<I", dll, 0x3C)[0] + 8
    return dll[:stamp] + bytes(4) + dll[stamp + 4 :]


def cc_library(folder: Path, sources: Sequence[str], made: Path, flags: Sequence[str] = ()) -> None:
    """This host's shared library, by its own compiler. Raises CalledProcessError."""
    flags = [*FLAGS, *flags, *([] if sys.platform == "win32" else ["-fPIC"])]
    made.parent.mkdir(parents=True, exist_ok=True)
    compiler = os.environ.get("CC", "cc")
    _run([compiler, *flags, "-shared", "-o", str(made), *sources, "-lm"], folder)


def compile_with_cc(dest: Path) -> Path:
    """Compile this host's kernel with its own compiler; its path. Raises CalledProcessError."""
    platform = HOSTS[sys.platform]
    library = dest / platform / f"{KERNEL}.{TARGETS[platform][1]}"
    cc_library(HERE, [f"{KERNEL}.c"], library)
    return library


def compile_all(dest: Path) -> list[Path]:
    """Libraries for every platform, or for this one, or none: what the machine's tools can make."""
    if has_zig():
        return [compile_with_zig(platform, dest) for platform in TARGETS]
    return [compile_with_cc(dest)] if has_cc() else []


def libraries(
    folder: Path, sources: Sequence[str], name: str, flags: Sequence[str] = ()
) -> dict[str, bytes]:
    """A library of C files for every platform that this machine can make, by FMI's path."""
    if has_zig():
        return {
            f"{platform}/{name}.{suffix}": zig_library(platform, folder, sources, name, flags)
            for platform, (_, suffix, _) in TARGETS.items()
        }
    if not has_cc():
        return {}
    path = f"{HOSTS[sys.platform]}/{name}.{TARGETS[HOSTS[sys.platform]][1]}"
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch, "made")
        cc_library(folder, sources, made, flags)
        return {path: made.read_bytes()}


def compiler() -> str:
    """What compiles here, with its version."""
    if has_zig():
        return f"ziglang {importlib.metadata.version('ziglang')}"
    return os.environ.get("CC", "cc") if has_cc() else "no compiler"


def compile_for_host(dest: Path) -> Path:
    """This host's library alone; its path. Raises CalledProcessError, or FileNotFoundError."""
    if has_zig():
        return compile_with_zig(HOSTS[sys.platform], dest)
    return compile_with_cc(dest)


def main() -> int:
    """Compile what the command line asks for, and print the paths."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dest", type=Path, help="folder; libraries go to DEST/<platform>/")
    parser.add_argument("--cc", action="store_true", help="with the host's own compiler")
    options = parser.parse_args()
    dest = options.dest.resolve()
    try:
        made = [compile_with_cc(dest)] if options.cc else compile_all(dest)
    except subprocess.CalledProcessError as error:
        print(error.stderr, file=sys.stderr)
        return 1
    print("\n".join(map(str, made)) or "no compiler here: pip install ziglang")
    return 0 if made else 1


if __name__ == "__main__":
    sys.exit(main())

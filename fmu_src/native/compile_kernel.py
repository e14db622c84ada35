"""Compile chain_kernel.c for FMI's platforms, with the PyPI package ziglang or the host's own cc.

python compile_kernel.py DEST        every platform, with ziglang; or this host's, with cc
python compile_kernel.py --cc DEST   this host's, with $CC or cc
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import struct
import subprocess
import sys
import tempfile
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
# FMI's name of a platform -> zig's target, the library's name, what links it. Nothing but the C
# library is needed; on Windows that is ucrtbase.dll, and no start-up code, which zig would have to
# compile first, for a minute. The baseline processor: bytes do not depend on the building machine.
TARGETS = {
    "linux64": ("x86_64-linux-gnu.2.17", "chain_kernel.so", ["-lm"]),
    "win64": ("x86_64-windows-gnu", "chain_kernel.dll", ["-nostdlib", "-lucrtbase"]),
    "darwin64": (
        "x86_64-macos",
        "chain_kernel.dylib",
        ["-lm", "-Wl,-install_name,@rpath/chain_kernel.dylib"],
    ),
}
HOSTS = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}


def has_zig() -> bool:
    """Is the PyPI package ziglang here?"""
    return importlib.util.find_spec("ziglang") is not None


def has_cc() -> bool:
    """Has this machine a C compiler of its own?"""
    return shutil.which(os.environ.get("CC", "cc")) is not None


def compile_with_zig(platform: str, dest: Path) -> Path:
    """Compile one platform's library; returns its path. Raises CalledProcessError."""
    target, name, link = TARGETS[platform]
    library = dest / platform / name
    library.parent.mkdir(parents=True, exist_ok=True)
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", target, "-mcpu=baseline"]
    flags = ["-DCHAIN_NO_STARTUP"] if platform == "win64" else ["-fPIC"]
    with tempfile.TemporaryDirectory() as scratch:
        made = Path(scratch, name)
        compiled = Path(scratch, "chain_kernel.o")
        compile_it = [*zig, *FLAGS, *flags, "-c", "-o", str(compiled), "chain_kernel.c"]
        link_it = [*zig, "-shared", "-s", "-o", str(made), str(compiled), *link]
        for command in (compile_it, link_it):
            subprocess.run(command, cwd=HERE, check=True, capture_output=True, text=True)
        content = made.read_bytes()
    library.write_bytes(undated(content) if platform == "win64" else content)
    return library


def undated(dll: bytes) -> bytes:
    """A Windows library without the time of its linking, 4 bytes 8 bytes into its PE header."""
    stamp = struct.unpack_from("<I", dll, 0x3C)[0] + 8
    return dll[:stamp] + bytes(4) + dll[stamp + 4 :]


def compile_with_cc(dest: Path) -> Path:
    """Compile this host's library with its own compiler; its path. Raises CalledProcessError."""
    platform = HOSTS[sys.platform]
    library = dest / platform / TARGETS[platform][1]
    library.parent.mkdir(parents=True, exist_ok=True)
    flags = FLAGS if platform == "win64" else [*FLAGS, "-fPIC"]
    command = [os.environ.get("CC", "cc"), *flags, "-shared", "-o", str(library), "chain_kernel.c"]
    subprocess.run([*command, "-lm"], cwd=HERE, check=True, capture_output=True, text=True)
    return library


def compile_all(dest: Path) -> list[Path]:
    """Libraries for every platform, or for this one, or none: what the machine's tools can make."""
    if has_zig():
        return [compile_with_zig(platform, dest) for platform in TARGETS]
    return [compile_with_cc(dest)] if has_cc() else []


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

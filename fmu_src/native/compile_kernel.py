"""Compile chain_kernel.c into ``<dest>/<platform>/``: ``python compile_kernel.py [--zig] [DEST]``.

Without ``--zig`` the machine's own compiler ($CC or cc) makes the library of this host. With it,
the PyPI package ziglang makes those of every platform in TARGETS, on any machine.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
FLAGS = [
    "-std=c99",
    "-O2",
    "-ffp-contract=off",
    "-fno-math-errno",  # with the next: speed, and not a digit changed
    "-fno-trapping-math",
    "-fvisibility=hidden",
    "-shared",
]
TARGETS = {  # FMI's name of a platform -> zig's target, the library's name
    "linux64": ("x86_64-linux-gnu.2.17", "chain_kernel.so"),
    "win64": ("x86_64-windows-gnu", "chain_kernel.dll"),
    "darwin64": ("x86_64-macos", "chain_kernel.dylib"),
}
HOSTS = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}


def compile_kernel(platform: str, dest: Path, *, zig: bool = False) -> Path:
    """Compile the library of one platform; returns its path. Raises CalledProcessError."""
    target, name = TARGETS[platform]
    library = dest / platform / name
    library.parent.mkdir(parents=True, exist_ok=True)
    compiler = [os.environ.get("CC", "cc")]
    flags = FLAGS if platform == "win64" else [*FLAGS, "-fPIC"]
    if zig:
        # the baseline CPU, so that the bytes do not depend on the machine that builds
        compiler = [
            sys.executable,
            "-m",
            "ziglang",
            "cc",
            "-target",
            target,
            "-mcpu=baseline",
            "-s",
        ]
    command = [*compiler, *flags, "-o", str(library), "chain_kernel.c", "-lm"]
    subprocess.run(command, cwd=HERE, check=True)
    for extra in (library.with_suffix(".pdb"), library.with_suffix(".lib")):
        extra.unlink(missing_ok=True)
    return library


def main() -> None:
    """Compile for this host, or with zig for all platforms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dest", nargs="?", type=Path, default=HERE)
    parser.add_argument("--zig", action="store_true")
    options = parser.parse_args()
    platforms = TARGETS if options.zig else [HOSTS[sys.platform]]
    for platform in platforms:
        print(compile_kernel(platform, options.dest.resolve(), zig=options.zig))


if __name__ == "__main__":
    main()

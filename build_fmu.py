#!/usr/bin/env python3
"""Build the cranes' FMUs, native twins, observer and controller, and check each with FMPy."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "fmu_src"))

if __name__ == "__main__":
    try:
        from chaincrane_builder.command import main

        code = main()
    except KeyboardInterrupt:  # while what builds is still being loaded
        print("chaincrane: stopped", file=sys.stderr)
        code = 2
    sys.exit(code)

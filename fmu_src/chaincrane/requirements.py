"""Says what a host's Python lacks, where the ImportError that follows may not be shown."""

from __future__ import annotations

import sys
from importlib.util import find_spec


def require(*packages: str) -> None:
    """Name the packages that are missing, and what to install, in one line on stderr."""
    missing = [name for name in packages if name not in sys.modules and find_spec(name) is None]
    if missing and sys.stderr is not None:
        names = " ".join(missing)
        python = sys.executable or "the Python of this host"
        print(f"chaincrane: {python} lacks {names}: python -m pip install {names}", file=sys.stderr)

"""Mends what pythonfmu's wrapper, the C++ library of a Python FMU, does to its process (0.7.0)."""

from __future__ import annotations

import ctypes
import os
import sys
from typing import Any


def mend(namespace: dict[str, Any]) -> None:
    """Called by a slave's module with its globals(), at each instantiation and reset.

    At an instantiation the wrapper puts the FMU's resources on sys.path, executes the slave's file
    in its module's namespace, and then releases that namespace, which it had only borrowed. Left
    alone, the namespace is freed under a living module, and the host crashes at a later
    instantiation; and sys.path grows by one entry each time.
    """
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(namespace))
    resources = sys.path[0] if sys.path else ""
    ours = ("slavemodule.txt", f"{namespace['__name__']}.py")
    if all(os.path.exists(os.path.join(resources, name)) for name in ours):
        del sys.path[0]

"""Mends what pythonfmu's wrapper, the C++ library of a Python FMU, does to its process (0.7.0)."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from typing import Any

_MENDED: set[str] = set()  # resources of the FMUs whose wrapper ends well


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
        if sys.platform == "linux" and resources not in _MENDED:
            _MENDED.add(resources)
            with contextlib.suppress(OSError, AttributeError):
                _mend_end(resources)


def _mend_end(resources: str) -> None:
    """Let the wrapper of the FMU with these resources release Python first when the process ends.

    It does so twice. C++ destroys what it holds Python by, and ``finalizePythonInterpreter``, the
    library's last function, then counts down in the memory that this has freed: with bad luck the
    process aborts after all its work, "corrupted double-linked list". That function called before
    both, which C does in the reverse order of registration, leaves them nothing to do.

    Raises OSError or AttributeError where the host has the library elsewhere, or it is another.
    """
    folder = os.path.join(os.path.dirname(os.path.realpath(resources)), "binaries", "linux64", "")
    with open("/proc/self/maps", encoding="utf-8", errors="surrogateescape") as lines:
        loaded = [line.rstrip("\n").split(maxsplit=5)[-1] for line in lines]
    for name in sorted({name for name in loaded if name.startswith(folder)}):
        library = ctypes.CDLL(name, mode=os.RTLD_NOLOAD | os.RTLD_LAZY)  # and keeps it loaded
        release = ctypes.cast(library.finalizePythonInterpreter, ctypes.c_void_p)
        getattr(ctypes.CDLL(None), "__cxa_atexit")(release, None, None)

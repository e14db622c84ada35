"""Mends what pythonfmu's wrapper, the C++ library of a Python FMU, does to its process (0.7.0)."""

from __future__ import annotations

import _ctypes
import atexit
import contextlib
import ctypes
import os
import sys
from typing import Any

import pythonfmu

PYTHON_IS_THE_HOST = bool(sys.orig_argv)  # it was not started from C
_LOADED: dict[int, bytes] = {}  # addresses of finalizePythonInterpreter -> wrappers' files


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
        if sys.platform == "linux":
            with contextlib.suppress(OSError, AttributeError):
                _remember_wrapper()


# Left alone, a wrapper lets go of Python twice when its process ends. C++ destroys what it holds it
# by; then finalizePythonInterpreter, the library's last function, counts down in the memory that
# this has freed, and with bad luck the process aborts after all its work, "corrupted double-linked
# list". That function called before leaves the other two nothing to do.


def _remember_wrapper() -> None:
    """Find the wrapper that is calling us, for the end of Python; or let it go of Python now.

    In a C program one wrapper has started Python, and only its end may end it; the others do not
    need to hold it, and C++ may destroy them before. The first that any FMU of ours has seen in
    this process, which all know by the package that they share, is taken for that one.
    """
    for library in dict.fromkeys(map(_file_of, _stack())):
        function = _last_function(library)
        if function is not None:
            break
    else:
        return
    file = next((file for part, file in _mapped() if function in part), b"")
    first = vars(pythonfmu).setdefault("first_wrapper_seen", (function, file))
    if PYTHON_IS_THE_HOST or first == (function, file):
        _LOADED[function] = file
    else:
        ctypes.CFUNCTYPE(None)(function)()


@atexit.register
def _release() -> None:
    """Let the wrappers go of Python at its end: in a C program the one that is ending it.

    Only those that are still loaded; and the loader is not asked, as the host may be waiting in it.
    """
    if not _LOADED:
        return
    with contextlib.suppress(OSError):
        mapped, stack = _mapped(), _stack()
        for function, file in _LOADED.items():
            parts = [part for part, name in mapped if name == file]
            loaded = any(function in part for part in parts)
            calling = any(address in part for part in parts for address in stack)
            if loaded and (PYTHON_IS_THE_HOST or calling):
                ctypes.CFUNCTYPE(None)(function)()


def _last_function(library: bytes | None) -> int | None:
    """The address of a wrapper's finalizePythonInterpreter; None: the library is no wrapper."""
    if library is None:
        return None
    try:
        opened = ctypes.CDLL(os.fsdecode(library), mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
    except OSError:
        return None
    try:
        return ctypes.cast(opened.finalizePythonInterpreter, ctypes.c_void_p).value
    except AttributeError:
        return None
    finally:
        _ctypes.dlclose(opened._handle)  # how long it is loaded is its host's affair


class _Place(ctypes.Structure):
    """Dl_info: where an address is."""

    _fields_ = (
        ("file", ctypes.c_char_p),
        ("base", ctypes.c_void_p),
        ("symbol", ctypes.c_char_p),
        ("address", ctypes.c_void_p),
    )


if sys.platform == "linux":
    _C = ctypes.CDLL(None)


def _stack() -> list[int]:
    """Return addresses of the C functions that are calling us, the nearest first."""
    addresses = (ctypes.c_void_p * 256)()
    return [address for address in addresses[: _C.backtrace(addresses, 256)] if address]


def _file_of(address: int) -> bytes | None:
    """The library that an address is in, as the loader calls it."""
    place = _Place()
    found = _C.dladdr(ctypes.c_void_p(address), ctypes.byref(place))
    return place.file if found else None


def _mapped() -> list[tuple[range, bytes]]:
    """Addresses and name of each part of a file in this process."""
    with open("/proc/self/maps", "rb") as lines:
        rows = [line.rstrip(b"\n").split(maxsplit=5) for line in lines]
    parts = []
    for addresses, *_, name in rows:
        first, end = addresses.split(b"-")
        parts.append((range(int(first, 16), int(end, 16)), name.removesuffix(b" (deleted)")))
    return parts

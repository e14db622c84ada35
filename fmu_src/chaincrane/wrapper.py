"""Mends what pythonfmu's wrapper, the C++ library of a Python FMU, does to its process (0.7.0)."""

from __future__ import annotations

import _ctypes
import atexit
import contextlib
import ctypes
import os
import sys
from typing import Any, NamedTuple

PYTHON_IS_THE_HOST = bool(sys.orig_argv)  # it was not started from C


class _Part(NamedTuple):
    """A part of a library in memory."""

    addresses: range
    file: bytes


_WRAPPERS: dict[_Part, int] = {}  # code of a wrapper, address of its finalizePythonInterpreter


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


# A wrapper lets go of Python twice when its process ends. C++ destroys what it holds Python by, and
# finalizePythonInterpreter, the library's last function, then counts down in the memory that this
# has freed: with bad luck the process aborts after all its work, "corrupted double-linked list".
# Once we have called that function, it finds nothing to count down at the end.


def _remember_wrapper() -> None:
    """Note the wrapper that is calling us; forget those that are not loaded any more."""
    parts = _code()
    for library in dict.fromkeys(map(_file_of, _stack())):
        function = _last_function(library)
        if function is not None:
            for gone in _WRAPPERS.keys() - parts:
                _WRAPPERS.pop(gone, None)
            _WRAPPERS.update((part, function) for part in parts if function in part.addresses)
            return


@atexit.register
def _release() -> None:
    """Let the wrappers that are loaded go of Python, at its end.

    In a Python host all of them: none has begun to end. In a C program the wrapper that has started
    Python is ending it now, and calling us; that one alone, as C++ may have destroyed the others,
    whose end stays as pythonfmu has it. The loader is not asked for anything: the host may be
    waiting in it.
    """
    if not _WRAPPERS:
        return
    with contextlib.suppress(OSError):
        parts, stack = _code(), _stack()
        for part, function in _WRAPPERS.items():
            calling = any(address in part.addresses for address in stack)
            if part in parts and (PYTHON_IS_THE_HOST or calling):
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


def _code() -> set[_Part]:
    """All code of files that this process has mapped."""
    with open("/proc/self/maps", "rb") as lines:
        rows = [line.split(maxsplit=5) for line in lines if b" r-xp " in line]
    parts = set()
    for addresses, *_, name in rows:
        first, end = addresses.split(b"-")
        file = name.rstrip(b"\n").removesuffix(b" (deleted)")
        parts.add(_Part(range(int(first, 16), int(end, 16)), file))
    return parts

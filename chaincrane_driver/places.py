"""Files that are whole or not there, and folders: can they be written?"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A file to write, which takes the place of ``path`` once it is whole; its folder is made.

    What stops the writing, a full disk or Ctrl-C, leaves ``path`` as it was. Raises OSError with
    the name of ``path``.
    """
    partial = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        partial.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        partial.unlink(missing_ok=True)


def hindrance(folder: Path) -> str | None:
    """Why nothing can be written in a folder, or made there if it is none yet; None: it can."""
    above = [folder.absolute(), *folder.absolute().parents]
    there = next(one for one in above if one.exists())
    if not there.is_dir():
        return f"{there} is not a folder"
    return None if os.access(there, os.W_OK) else f"{there} cannot be written"


def house_matplotlib() -> None:
    """Where there is no home for Matplotlib's cache, one in the temporary folder.

    It would make one itself, tell of it on two lines, and remove it at the end, when this command's
    temporary folder is gone already.
    """
    if "MPLCONFIGDIR" in os.environ or not sys.platform.startswith("linux"):
        return
    for variable, usual in (("XDG_CONFIG_HOME", "~/.config"), ("XDG_CACHE_HOME", "~/.cache")):
        base = os.environ.get(variable) or os.path.expanduser(usual)
        if hindrance(Path(base, "matplotlib")) is not None:
            os.environ["MPLCONFIGDIR"] = tempfile.mkdtemp(prefix="matplotlib-")
            return

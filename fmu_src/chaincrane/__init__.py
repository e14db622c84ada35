"""Models of an overhead crane with a flexible chain: nonlinear, and linear with the same interface.

Import what you need from its module: ``chaincrane.nonlinear``, ``chaincrane.linear``,
``chaincrane.parameters``. Nothing is imported here, so that a model loads no more than it uses.
"""

import sys
from importlib.util import find_spec

_missing = [name for name in ("numpy", "scipy") if name not in sys.modules and not find_spec(name)]
if _missing:  # a host that runs an FMU shows less of the ImportError that follows, or nothing
    print(
        f"chaincrane: {sys.executable or 'the Python of this host'} lacks {' and '.join(_missing)};"
        f" install: python -m pip install {' '.join(_missing)}",
        file=sys.stderr,
    )

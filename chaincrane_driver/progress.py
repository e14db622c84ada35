"""What a simulation tells of its progress."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]

REPORTS = 100  # of its progress that a simulation makes

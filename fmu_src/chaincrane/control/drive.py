"""The trolley's drive: it follows a commanded acceleration with a lag, where it has one."""

from __future__ import annotations

from math import exp


def followed(a: float, a_cmd: float, h: float, lag: float) -> tuple[float, float]:
    """Mean over ``h`` s and end of an acceleration that follows a held command, m/s2.

    lag a' = a_cmd - a from ``a``: a(h) = a_cmd + (a - a_cmd) exp(-h/lag). Without lag it is a_cmd.
    """
    if not lag:
        return a_cmd, a_cmd
    kept = exp(-h / lag)
    return a_cmd + (a - a_cmd) * (1.0 - kept) * lag / h, a_cmd + (a - a_cmd) * kept

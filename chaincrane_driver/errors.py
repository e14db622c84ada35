"""Errors that a user can mend."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class UserError(Exception):
    """Something that the user can mend; the command line shows it as one line."""


def one_line(error: Exception | str) -> str:
    """What an error says, as one line."""
    return " ".join(str(error).split())


MOST_LISTED = 20  # names in a message; of more, one is always the nearest


def instead(name: str, known: Iterable[str]) -> str:
    """What may have been meant by an unknown name: the nearest of ``known``, or all of them."""
    names = list(known)
    near = get_close_matches(name, names, n=1, cutoff=0.6 if len(names) <= MOST_LISTED else 0.0)
    return f"; the nearest is {near[0]!r}" if near else f"; there are {', '.join(names)}"

"""Errors that a user can mend."""


class UserError(Exception):
    """Something that the user can mend; the command line shows it as one line."""


def one_line(error: Exception) -> str:
    """What an error says, as one line."""
    return " ".join(str(error).split())

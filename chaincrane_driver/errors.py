"""Errors that a user can mend."""


class UserError(Exception):
    """Something that the user can mend; the command line shows it as one line."""

"""The program chaincrane, or python -m chaincrane_driver."""

import sys


def main() -> int:
    """The command line; Ctrl-C while it is still being loaded is one line, too."""
    try:
        from .cli import main as command

        return command()
    except KeyboardInterrupt:
        print("chaincrane: stopped", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())

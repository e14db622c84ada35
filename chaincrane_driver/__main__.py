"""The program chaincrane, or python -m chaincrane_driver."""

import signal
import sys

# Commands whose runs begin at once, and workers that there is work for.
EARLY = {"run": 2, "report": 2, "figures": 8, "check": 8}
NO_RUNS = {"--help", "-h", "--results"}  # options with which they make none


def main() -> int:
    """The command line; Ctrl-C while it is still being loaded is one line, too."""
    # A program of its own: being ended is as Ctrl-C, and leaves nothing.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        given = sys.argv[1:]
        if not given or given[0] not in EARLY or NO_RUNS.intersection(given):
            return _command()
        from .processes import early_workers

        with early_workers(EARLY[given[0]]):
            return _command()
    except KeyboardInterrupt:
        print("chaincrane: stopped", file=sys.stderr)
        return 2


def _command() -> int:
    from .cli import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())

"""chaincrane study."""

from __future__ import annotations

import argparse

from . import study
from .options import add_out
from .places import whole_file
from .stale import say_if_stale


def command(options: argparse.Namespace) -> int:
    """Run a study from the FMUs: tables and a picture. The study: observer, a minute or two."""
    say_if_stale(sorted(study.files(options.fmus)))
    results = study.run(options.fmus)
    text = study.report(results)
    path = options.out / "observer_study.md"
    with whole_file(path) as partial:
        partial.write_text(text)
    print(study.answer(results) + "\n")
    written = [path, *study.picture(results, options.out / "observer_study")]
    print("written: " + ", ".join(str(path) for path in written))
    return 0


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("study", choices=("observer",), help="which study")
    add_out(parser, "results")

"""The command line, chaincrane: its commands, in the order of its help."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import metadata
from inspect import getdoc
from pathlib import Path
from typing import NoReturn

from . import (
    compare,
    converge,
    fit_command,
    plots,
    report,
    scenario,
    shipped,
    study,
    sweep_command,
)
from .antisway import HEAVY, PUSH, TARGET, Setup, measure, metrics_table, parse_setting
from .check_command import (
    add_check_options,
    add_export_options,
    add_run,
    add_scenario,
    command_check,
    command_export,
)
from .errors import UserError, instead
from .instances import describe
from .loop import ORDERS
from .masters import MASTERS, Package
from .places import hindrance, whole_file
from .processes import Timed, do_all, simulate_all, workers_for
from .scenario import Scenario
from .simulate import Job
from .ssp import write_ssp
from .stale import say_if_stale
from .tables import Table, write_table

PAPER = (("heavy payload", "paper_heavy"), ("light payload", "paper_light"))


def run_all(one: Scenario, fmus: Path) -> dict[str, Table]:
    """Simulate every run of a scenario."""
    tables = simulate_all(jobs_of(one, fmus), one.name)
    return {run.name: table for run, table in zip(one.runs, tables, strict=True)}


def jobs_of(one: Scenario, fmus: Path) -> list[Job]:
    """Every run of a scenario as work; says it where an FMU is stale."""
    jobs = [one.job(run, shipped.fmu(fmus, run.fmu)) for run in one.runs]
    say_if_stale(job.fmu for job in jobs)
    return jobs


def checked_units(one: Scenario, fmus: Path) -> dict[str, str | None]:
    """Units of the first run's variables by name; raises UserError for a signal it has not."""
    variables = describe(shipped.fmu(fmus, one.runs[0].fmu)).modelVariables
    outputs = [variable for variable in variables if variable.causality == "output"]
    units = {variable.name: variable.unit for variable in outputs}
    for name in one.look_at:
        if name not in units:
            path, near = one.folder / "scenario.toml", instead(name, units)
            raise UserError(f"{path}: look_at: there is no {name!r}{near}")
    return units


def command_run(options: argparse.Namespace) -> int:
    """Run scenarios: results as CSV, a table of differences, a picture."""
    for folder in options.scenario:
        one = scenario.load(folder)
        results = run_all(one, options.fmus)
        units = checked_units(one, options.fmus)
        out = options.out / one.name
        for name, table in results.items():
            write_table(out / f"{name}.csv", table)
        print(f"{one.title} ({one.name})\n\n{compare.comparison_table(one, results, units)}\n")
        pictures = plots.comparison(one, results, units, out / "comparison")
        print(f"written: {out}/*.csv, {', '.join(str(path) for path in pictures)}\n")
    return 0


def command_converge(options: argparse.Namespace) -> int:
    """Estimate the time and mesh errors of a scenario's runs: tables, CSV, a picture.

    Each run is repeated with solver.max_step halved twice, then with chain.elements doubled twice.
    Where the differences do not shrink, or are large, the signal is not predictable: so it says.
    """
    one = scenario.load(options.scenario)
    runs = one.named(options.run)
    say_if_stale(shipped.fmu(options.fmus, run.fmu) for run in runs)
    findings = converge.study(one, runs, options.fmus, options.signals)
    path = options.out / one.name / "convergence.csv"
    converge.write_csv(path, findings)
    drawn = options.signals or one.look_at
    signals = [signal for signal in findings[0].signals if signal.name in drawn]
    pictures = plots.convergence_figure(
        findings[0], signals, f"{one.title}: how well it converges", path.with_suffix("")
    )
    print(f"{one.title} ({one.name})\n")
    for finding in findings:
        print(f"{finding.settings}\n\n{converge.table(finding)}\n")
    print(f"{converge.LEGEND}\n")
    print("written: " + ", ".join(str(one) for one in (path, *pictures)))
    return 0


def command_report(options: argparse.Namespace) -> int:
    """Write a scenario's runs as one HTML file: the crane moving, curves, differences, settings.

    It opens in any browser, from disk. chaincrane antisway writes one of the closed loop.
    """
    for folder in options.scenario:
        one = scenario.load(folder)
        one = replace(one, runs=one.named(options.run))
        results, units = run_all(one, options.fmus), checked_units(one, options.fmus)
        told = report.of_scenario(one, results, units, options.fmus)
        path = told.write(options.out / f"{one.name}.html")
        print(f"written: {path}, {path.stat().st_size // 1024} kB")
    return 0


def command_figures(options: argparse.Namespace) -> int:
    """Draw the paper's Figs. 4 to 7 from the FMUs, with the comparison in numbers."""
    scenarios = [scenario.load(options.scenarios / name) for _, name in PAPER]
    jobs = [job for one in scenarios for job in jobs_of(one, options.fmus)]
    units = [checked_units(one, options.fmus) for one in scenarios]
    with workers_for(len(jobs)) as workers:
        tables = iter(do_all(workers, jobs, "runs"))
        results = [{run.name: next(tables) for run in one.runs} for one in scenarios]
        for one, found, of in zip(scenarios, results, units, strict=True):
            print(f"{one.title}\n\n{compare.comparison_table(one, found, of)}\n")
        labels = (label for label, _ in PAPER)
        panels = list(zip(labels, scenarios, results, strict=True))
        drawings = plots.papers_figures(panels, options.out)
        written = [path for paths in do_all(workers, drawings, "figures") for path in paths]
    print("written: " + ", ".join(str(path) for path in written))
    return 0


def command_antisway(options: argparse.Namespace) -> int:
    """Move the crane by 1 m in closed loop: metrics, a picture, the SSP package.

    Crane, observer and controller run as FMUs, beside three open-loop moves for comparison. With
    --master ecos or libcosim those run the package; all compares them with FMPy.
    """
    more: dict[str, dict[str, object]] = {}
    for text in options.set:
        part, name, value = parse_setting(text)
        more.setdefault(part, {})[name] = value
    setup = Setup(
        payload=options.payload,
        plant=options.plant,
        method=options.method,
        observer=options.elements,
        sensor=options.sensor,
        noisy=not options.clean,
        target=options.target,
        stop_time=options.stop,
        step=options.step,
        order=options.order,
        push=PUSH if options.push else None,
        more=more,
    )
    if not 0.0 < setup.step <= setup.stop_time < float("inf"):
        raise UserError("--step and --stop need 0 < step <= stop, both in seconds")
    others = [master for master in MASTERS[1:] if options.master in (master, "all")]
    if others and setup.order != "parallel":
        raise UserError("ecos and libcosim step side by side: --order sequential is FMPy's alone")
    beside = ("time_optimal", "zv", "trapezoid")
    methods = [setup.method, *(method for method in beside if method != setup.method)]
    loops = [
        report.with_shape(replace(setup, method=method).loop(options.fmus)) for method in methods
    ]
    say_if_stale(loops[0].fmus.values())
    ssp = write_ssp(options.out / "crane_antisway.ssp", loops[0])
    work: list[Timed] = [*loops, *(Package(master, ssp, loops[0]) for master in others)]
    tables = simulate_all(work, "antisway")
    shown = [(METHOD_LABELS[m], table) for m, table in zip(methods, tables, strict=False)]
    rows = [(label, measure(table, setup.target)) for label, table in shown]
    print(metrics_table("move", rows) + "\n")
    for master, table in zip(others, tables[len(methods) :], strict=True):
        names = table.dtype.names or ()
        worst = max(float(abs(table[name] - tables[0][name]).max()) for name in names)
        print(f"{master}: every signal within {worst:.1e} (SI) of FMPy's")
        write_table(options.out / f"{master}.csv", table)
    write_table(options.out / "fmpy.csv", tables[0])
    title = f"A move of {setup.target:g} m; payload {setup.payload:g} kg; {setup.sensor} sensor"
    title += f"; observer: {setup.label}"
    written = [ssp, options.out / "fmpy.csv"]
    bars = [(label, one.settling, 1e3 * one.residual) for label, one in rows]
    push = PUSH[:2] if options.push else None
    written += plots.antisway_figure(shown, bars, push, title, options.out / "antisway")
    told = report.of_antisway(setup, loops[0], shown, title)
    written.append(told.write(options.out / "antisway.html"))
    print("written: " + ", ".join(str(path) for path in written))
    return 0


METHOD_LABELS = {
    "planned": "plan and regulator",
    "lqr": "LQR on the estimate",
    "zv": "ZV-shaped, open loop",
    "zvd": "ZVD-shaped, open loop",
    "time_optimal": "time-optimal, open loop",
    "trapezoid": "plain, open loop",
}


def command_study(options: argparse.Namespace) -> int:
    """Run a study from the FMUs: tables and a picture. The study: observer, some minutes."""
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


class Parser(argparse.ArgumentParser):
    """A command line's grammar whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """End with the message and where help is."""
        self.exit(2, f"chaincrane: {message}; see {self.prog} --help\n")


def add_antisway_options(antisway: argparse.ArgumentParser) -> None:
    """The options of chaincrane antisway."""
    for name, kind, default, text in (
        ("payload", float, HEAVY, "mass of the payload, kg"),
        ("target", float, TARGET, "where the trolley is to go, m"),
        ("stop", float, 12.0, "simulated time, s"),
        ("step", float, 0.01, "communication step, s"),
    ):
        antisway.add_argument(
            f"--{name}", type=kind, default=default, help=f"{text} ({default:g})", metavar="N"
        )
    antisway.add_argument(
        "--elements",
        type=int,
        metavar="N",
        help="of observer and controller; 0: a massless-rope pendulum (the string's first modes)",
    )
    for name, choices, text in (
        ("plant", ("crane_nl", "crane_lin"), "the crane"),
        ("method", tuple(METHOD_LABELS), "how to move"),
        ("sensor", ("rope", "camera"), "what is measured"),
        ("order", ORDERS, "of FMPy's steps"),
        ("master", (*MASTERS, "all"), "what runs the loop beside FMPy"),
    ):
        antisway.add_argument(
            f"--{name}", choices=choices, default=choices[0], help=f"{text} ({choices[0]})"
        )
    antisway.add_argument(
        "--push", action="store_true", help="push the payload, 0.5 m/s2 from 7 to 7.5 s; --stop 20"
    )
    antisway.add_argument("--clean", action="store_true", help="a sensor without noise")
    antisway.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PART::NAME=VALUE",
        help="a start value of crane, observer or antisway, as observer::sensor.delay=0.02",
    )


def parser() -> argparse.ArgumentParser:
    """The command line's grammar."""
    top = Parser(
        prog="chaincrane",
        description="Drive the cranes' FMUs with FMPy: compare, draw, check.",
        epilog="examples:\n  chaincrane build\n  chaincrane run paper_heavy\n  chaincrane figures\n"
        "  chaincrane check --fmu some_other_crane.fmu --model crane_nl",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=versions())
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    commands.add_parser("build", help="Build the FMUs, or copy those that came.", add_help=False)

    def command(name: str, action: object, example: str) -> argparse.ArgumentParser:
        text = getdoc(action) or ""
        sub = commands.add_parser(
            name,
            help=text.splitlines()[0],
            description=text,
            epilog=f"example: {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        sub.set_defaults(action=action)
        sub.add_argument(
            "--fmus",
            type=Path,
            default=shipped.WORKING_FOLDER,
            metavar="DIR",
            help="where the FMUs are (here, else those that came with chaincrane)",
        )
        return sub

    def scenarios(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--scenarios",
            type=Path,
            default=shipped.scenarios(),
            metavar="DIR",
            help="where the scenarios are (scenarios, else those that came with chaincrane)",
        )

    def results_in(sub: argparse.ArgumentParser, folder: str) -> None:
        sub.add_argument(
            "--out",
            type=Path,
            default=Path(folder),
            metavar="DIR",
            help=f"folder for the results ({folder})",
        )

    run = command("run", command_run, "chaincrane run paper_heavy")
    add_scenario(run, "+")
    results_in(run, "results")

    reporting = command("report", command_report, "chaincrane report paper_light")
    add_scenario(reporting, "+")
    add_run(reporting)
    results_in(reporting, "results")

    figures = command("figures", command_figures, "chaincrane figures --out figures")
    scenarios(figures)
    results_in(figures, "figures")

    antisway = command("antisway", command_antisway, "chaincrane antisway --payload 0.07")
    add_antisway_options(antisway)
    results_in(antisway, "results/antisway")

    converging = command(
        "converge", command_converge, "chaincrane converge paper_heavy --run nonlinear"
    )
    add_scenario(converging)
    add_run(converging)
    converging.add_argument(
        "--signals",
        type=lambda text: tuple(filter(None, text.split(","))),
        default=(),
        metavar="NAME,NAME",
        help="Real outputs to judge and to draw (what the scenario looks at is drawn; judged too:"
        f" {', '.join(converge.BESIDES)})",
    )
    results_in(converging, "results")

    sweep_command.add_options(
        command(
            "sweep",
            sweep_command.command_sweep,
            "chaincrane sweep paper_heavy --vary"
            " payload.mass=0.05:0.5:50 --vary chain.elements=2,5,10",
        )
    )
    fit_command.add_options(
        command(
            "fit",
            fit_command.command_fit,
            "chaincrane fit paper_heavy measured.csv --fit payload.mass=0.3 --shift",
        )
    )

    check = command("check", command_check, "chaincrane check --fmu crane_nl_native.fmu")
    scenarios(check)
    add_check_options(check)
    add_export_options(
        command("export", command_export, "chaincrane export paper_heavy --out crosscheck")
    )

    studied = command("study", command_study, "chaincrane study observer --out docs")
    studied.add_argument("study", choices=("observer",), help="which study")
    results_in(studied, "results")
    return top


@contextmanager
def own_temporary_folder() -> Iterator[None]:
    """A temporary folder for this command and its workers, gone with it.

    A worker that is stopped half-way leaves the FMU that it unpacked.
    """
    before = os.environ.get("TMPDIR")
    with tempfile.TemporaryDirectory(prefix="chaincrane-", ignore_cleanup_errors=True) as folder:
        tempfile.tempdir = os.environ["TMPDIR"] = folder
        try:
            yield
        finally:
            tempfile.tempdir = None
            if before is None:
                del os.environ["TMPDIR"]
            else:
                os.environ["TMPDIR"] = before


def check_places(options: argparse.Namespace) -> None:
    """Where a command is to write it can: said before its work, not after. Raises UserError."""
    given = vars(options)
    folders = {"out": given["out"] or Path("results")} if "out" in given else {}
    for option in ("junit", "json"):
        file = given.get(option)
        if file is not None:
            if file.is_dir():
                raise UserError(f"--{option} {file}: is a folder")
            folders[option] = file.parent
    for option, folder in folders.items():
        reason = hindrance(folder)
        if reason is not None:
            raise UserError(f"--{option} {given[option] or folder}: {reason}")


def versions() -> str:
    """Versions of what decides a result."""
    ours, fmpy = metadata.version("chaincrane"), metadata.version("fmpy")
    return f"chaincrane {ours} (FMPy {fmpy}, Python {platform.python_version()})"


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the command; errors that a user can mend are one line."""
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["build"]:  # it alone needs the models, and what makes FMUs of them
        from chaincrane_builder import command

        return command.main(given[1:], "chaincrane build", shipped.FMUS)
    options = parser().parse_args(given)
    try:
        check_places(options)
        with own_temporary_folder():
            return int(options.action(options))
    except UserError as error:
        print(f"chaincrane: {error}", file=sys.stderr)
    except BrokenPipeError:  # the reader has seen enough: chaincrane ... | head
        sys.stdout = None
        return 0
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        print(f"chaincrane: {reason}", file=sys.stderr)
    except KeyboardInterrupt:
        print("chaincrane: stopped", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())

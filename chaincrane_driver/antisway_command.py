"""chaincrane antisway."""

from __future__ import annotations

import argparse
from dataclasses import replace

from . import plots, report
from .antisway import HEAVY, PUSH, TARGET, Setup, measure, metrics_table, parse_setting
from .errors import UserError
from .loop import ORDERS
from .masters import MASTERS, Package
from .options import add_out
from .processes import Timed, simulate_all
from .ssp import write_ssp
from .stale import say_if_stale
from .tables import write_table

METHOD_LABELS = {
    "planned": "plan and regulator",
    "lqr": "LQR on the estimate",
    "zv": "ZV-shaped, open loop",
    "zvd": "ZVD-shaped, open loop",
    "time_optimal": "time-optimal, open loop",
    "trapezoid": "plain, open loop",
}


def command(options: argparse.Namespace) -> int:
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


def add_options(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    for name, kind, default, text in (
        ("payload", float, HEAVY, "mass of the payload, kg"),
        ("target", float, TARGET, "where the trolley is to go, m"),
        ("stop", float, 12.0, "simulated time, s"),
        ("step", float, 0.01, "communication step, s"),
    ):
        parser.add_argument(
            f"--{name}", type=kind, default=default, help=f"{text} ({default:g})", metavar="N"
        )
    parser.add_argument(
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
        parser.add_argument(
            f"--{name}", choices=choices, default=choices[0], help=f"{text} ({choices[0]})"
        )
    parser.add_argument(
        "--push", action="store_true", help="push the payload, 0.5 m/s2 from 7 to 7.5 s; --stop 20"
    )
    parser.add_argument("--clean", action="store_true", help="a sensor without noise")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PART::NAME=VALUE",
        help="a start value of crane, observer or antisway, as observer::sensor.delay=0.02",
    )
    add_out(parser, "results/antisway")

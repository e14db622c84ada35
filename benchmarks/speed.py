#!/usr/bin/env python3
"""How fast is the nonlinear crane, against what else steps a chain? Work against precision.

Everything is measured side by side in one process, in turns, and given as medians and ratios: on a
noisy machine a ratio stands where a time does not. The run is the paper's, 4 s, travelling start,
heavy payload; the error is the payload's largest distance from the same model's converged solution.

- kernel: the C kernel, called for its internal steps alone;
- inextensible: the same with chain.formulation = inextensible, eight points, whose mesh errs by
  less than ten elements; steps that its fastest mode forbids are left out;
- numpy: the NumPy model, its definition;
- fmu: crane_nl.fmu under FMPy's FMU2Slave, a communication step of 1 ms, 3 inputs set and 7
  outputs read at each, beside a pythonfmu FMU that does nothing, with as many variables;
- mujoco rk4, euler: MuJoCo, rigid links on hinges, which is the steel chain but for its stretch;
- solve_ivp: SciPy's DOP853 and Radau on M a = f - f_sigma, for a chain 7000 times softer: the steel
  chain's axial vibrations would cost them hours. The kernel damps those that a step cannot resolve,
  so on the undamped soft chain it needs the finer steps.

    python benchmarks/speed.py                  table on stdout
    python benchmarks/speed.py --plot work.svg  and a work-precision plot
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "fmu_src")]


from chaincrane.plant.chain import along_elements, axial_force, discretise, internal_force
from chaincrane.plant.command import Command
from chaincrane.plant.kernel import NativeCrane, load_library
from chaincrane.plant.nonlinear import NonlinearCrane
from chaincrane.plant.parameters import Chain, Crane, Initial, Numerics
from chaincrane.plant.trolley import equal_parts
from chaincrane_builder.compile_c import kernel_for_host
from chaincrane_driver.compare import markdown_table

SPEED, STOP, END = 0.8, 1.0, 4.0  # m/s, s, s
SAMPLE = 0.02  # s, where errors are looked at
TARGETS = (1e-3, 1e-4)  # m
STEPS = (1e-2, 8e-3, 5e-3, 4e-3, 2.5e-3, 2e-3, 1.25e-3, 1e-3, 5e-4, 2.5e-4)  # s
MESHES = (2, 10, 50, 200, 1000)
SOFT_EA = 1e3  # N, for solvers that cannot take steel


@dataclass(frozen=True)
class Point:
    """One solver at one setting."""

    solver: str
    setting: str
    error: float  # m
    run: Callable[[], Any]
    estimate: float | None = None  # m, by solver.error_estimate


def timed(runs: Sequence[Callable[[], Any]], rounds: int) -> list[list[float]]:
    """Times of each run, s, taken in turns."""
    times: list[list[float]] = [[] for _ in runs]
    for number in range(rounds + 1):
        for run, mine in zip(runs, times, strict=True):
            start = perf_counter()
            run()
            if number:  # the first round warms up
                mine.append(perf_counter() - start)
    return times


def samples(model: Any) -> np.ndarray:
    """Payload's x and y relative to the trolley over the paper's run, (200, 2), m."""
    rows = []
    for number in range(round(END / SAMPLE)):
        model.step(SAMPLE, Command(trolley_v_cmd=SPEED if number * SAMPLE < STOP - 1e-9 else 0.0))
        out = model.outputs()
        rows.append((out["payload.x_rel"], out["payload.y"]))
    return np.array(rows)


def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance between two paths, m."""
    return float(np.hypot(*(a - b).T).max())


def paper_run(make: Callable[[float], Any], h: float) -> None:
    """The paper's run of a new crane, in two calls: the cost of its internal steps, little else."""
    model = make(h)
    model.step(STOP, Command(trolley_v_cmd=SPEED))
    model.step(END - STOP)


# --- ours -------------------------------------------------------------------------------------


def our_points(library: Any, elements: int = 10) -> list[Point]:
    """The kernel at all steps, the NumPy model at a few."""
    crane = Crane()

    def kernel(h: float, **more: Any) -> NativeCrane:
        return NativeCrane(crane, Initial(), Numerics(elements, h, **more), library=library)

    def numpy(h: float) -> NonlinearCrane:
        return NonlinearCrane(crane, Initial(), Numerics(elements, h))

    truth = samples(kernel(STEPS[-1] / 16))
    points = []
    for h in STEPS:
        error = distance(samples(kernel(h)), truth)
        run = partial(paper_run, kernel, h)
        points.append(Point("kernel", f"{h:g} s", error, run, estimated(kernel, h)))
        if h >= 1e-3:
            points.append(Point("numpy", f"{h:g} s", error, partial(paper_run, numpy, h)))
    return points


def estimated(make: Callable[..., Any], h: float) -> float:
    """The time error of the payload that a companion tells for the paper's run, m."""
    model = make(h, error_estimate="companion")
    samples(model)
    return float(model.outputs()["error.payload"])


def inextensible_points(library: Any, points: int = 8) -> list[Point]:
    """The inextensible chain at the steps that it takes as asked for, and at its longest."""
    crane = Crane()

    def inextensible(h: float, **more: Any) -> NativeCrane:
        numerics = Numerics(points, h, formulation="inextensible", **more)
        return NativeCrane(crane, Initial(), numerics, library=library)

    truth = samples(inextensible(STEPS[-1] / 16))
    found = []
    for h in STEPS:
        model = inextensible(h)
        path = samples(model)
        if model.outputs()["solver.steps"] > equal_parts(SAMPLE, h):
            continue
        run = partial(paper_run, inextensible, h)
        error, estimate = distance(path, truth), estimated(inextensible, h)
        found.append(Point("inextensible", f"{h:g} s", error, run, estimate))
    return found


# --- MuJoCo -----------------------------------------------------------------------------------


def mujoco_chain(crane: Crane, elements: int) -> str:
    """The chain as MuJoCo's XML: rigid links on hinges, the payload part of the last one."""
    L0, m = crane.chain.length / elements, crane.chain.mass / elements
    body, closing = "", ""
    for e in range(elements):
        mass, centre = m, 0.5 * L0
        inertia = m * L0**2 / 12.0
        if e == elements - 1:
            mass = m + crane.payload.mass
            centre = (0.5 * m + crane.payload.mass) * L0 / mass
            inertia += m * (centre - 0.5 * L0) ** 2 + crane.payload.mass * (L0 - centre) ** 2
        top = 0.0 if e == 0 else -L0
        body += f'<body pos="0 0 {top}"><joint type="hinge" axis="0 -1 0"/>'
        body += f'<inertial pos="0 0 {-centre}" mass="{mass}"'
        body += f' diaginertia="{inertia} {inertia} 1e-9"/>'
        closing += "</body>"
    end = f'<site name="payload" pos="0 0 {-L0}"/>'
    options = f'<option gravity="0 0 {-crane.gravity}"><flag contact="disable"/></option>'
    compiler = '<compiler balanceinertia="true" boundinertia="1e-12"/>'
    return f"<mujoco>{compiler}{options}<worldbody>{body}{end}{closing}</worldbody></mujoco>"


RK4, EULER = 1, 0  # mjINT_RK4, mjINT_EULER


def mujoco_run(crane: Crane, elements: int) -> Callable[[int, float, bool], np.ndarray | None]:
    """The paper's run in MuJoCo, as a function of integrator, step and whether to look.

    Seen from the trolley: a second at rest, then the stop's impulse as hinge velocities, 3 s of
    swing. Returns the payload's path after the stop like :func:`samples`, or None where not looked.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(mujoco_chain(crane, elements))
    chain = discretise(crane, elements)
    M = np.diag(chain.mass_diagonal) + chain.mass_coupling * (
        np.eye(elements, k=1) + np.eye(elements, k=-1)
    )
    after = np.linalg.solve(M, chain.row_mass * SPEED)  # relative velocities after the stop
    qvel = np.diff(np.diff(after, prepend=0.0) / chain.L0, prepend=0.0)

    def run(integrator: int, h: float, look: bool) -> np.ndarray | None:
        model.opt.integrator, model.opt.timestep = integrator, h
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, nstep=round(STOP / h))
        data.qvel[:] = qvel
        if not look:
            mujoco.mj_step(model, data, nstep=round((END - STOP) / h))
            return None
        rows = []
        for _ in range(round((END - STOP) / SAMPLE)):
            mujoco.mj_step(model, data, nstep=round(SAMPLE / h))
            mujoco.mj_kinematics(model, data)
            rows.append(data.site_xpos[0][[0, 2]].copy())
        return np.array(rows)

    return run


def mujoco_points(library: Any, elements: int = 10) -> list[Point]:
    """MuJoCo's RK4 and Euler, at steps that divide the interval of looking."""
    crane = Crane()
    run = mujoco_run(crane, elements)
    truth = run(RK4, STEPS[-1], True)
    ours = samples(NativeCrane(crane, Initial(), Numerics(elements, 1e-5), library=library))
    assert truth is not None
    apart = distance(ours[round(STOP / SAMPLE) :], truth)
    print(f"MuJoCo's converged payload is {1e3 * apart:.4f} mm from ours (which stretches)\n")
    points = []
    finer = (1e-4, 5e-5, 2e-5)
    for name, integrator in (("mujoco rk4", RK4), ("mujoco euler", EULER)):
        for h in STEPS if integrator == RK4 else (*STEPS[-3:], *finer):
            if abs(SAMPLE / h - round(SAMPLE / h)) > 1e-9:
                continue
            path = run(integrator, h, True)
            assert path is not None
            error = distance(path, truth) if np.isfinite(path).all() else float("inf")
            points.append(Point(name, f"{h:g} s", error, partial(run, integrator, h, False)))
    return points


# --- SciPy ------------------------------------------------------------------------------------


def solve_ivp_points(library: Any, elements: int = 10) -> list[Point]:
    """SciPy's DOP853 and Radau on a soft chain, and the kernel on the same."""
    from scipy.integrate import solve_ivp

    crane = Crane(chain=Chain(EA=SOFT_EA))
    chain = discretise(crane, elements)
    n = elements
    M = np.diag(chain.mass_diagonal) + chain.mass_coupling * (np.eye(n, k=1) + np.eye(n, k=-1))
    inverse = np.linalg.inv(M)

    def rate(_t: float, state: np.ndarray) -> np.ndarray:
        r, w = state.reshape(2, n, 2)
        d = along_elements(r)
        force = axial_force(SOFT_EA, chain.L0, np.hypot(*d.T))
        a = inverse @ (chain.weight - internal_force(d, force))
        return np.concatenate((w.ravel(), a.ravel()))

    start = np.zeros((2, n, 2))
    start[0] = chain.rest
    start[1, :, 0] = inverse @ (chain.row_mass * SPEED)
    times = np.arange(1, round((END - STOP) / SAMPLE) + 1) * SAMPLE

    def integrate(method: str, rtol: float) -> np.ndarray:
        done = solve_ivp(
            rate, (0.0, END - STOP), start.ravel(), method, times, rtol=rtol, atol=1e-2 * rtol
        )
        return np.asarray(done.y[2 * n - 2 : 2 * n].T)

    def kernel(h: float) -> NativeCrane:
        return NativeCrane(crane, Initial(), Numerics(n, h), library=library)

    truth = integrate("DOP853", 1e-10)
    points = []
    for method, tolerances in (("DOP853", (1e-3, 1e-4, 1e-5)), ("Radau", (1e-2, 1e-3, 1e-4))):
        for rtol in tolerances:
            error = distance(integrate(method, rtol), truth)
            job = partial(integrate, method, rtol)
            points.append(Point(f"solve_ivp {method}, soft", f"rtol {rtol:g}", error, job))
    for h in (*STEPS[3:], 1e-4, 5e-5):
        error = distance(samples(kernel(h))[round(STOP / SAMPLE) :], truth)
        points.append(Point("kernel, soft", f"{h:g} s", error, partial(paper_run, kernel, h)))
    return points


# --- the FMU ----------------------------------------------------------------------------------

NOTHING = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Nothing(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for number in range(53):
            causality = Fmi2Causality.input if number < 3 else Fmi2Causality.output
            setattr(self, f"v{number}", 0.0)
            self.register_variable(Real(f"v{number}", causality=causality))

    def do_step(self, current_time, step_size):
        return True
"""


def fmu_ratio(rounds: int) -> tuple[float, float]:
    """Median time, s, of 4000 steps of crane_nl.fmu, and its ratio to an FMU that does nothing."""
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave
    from pythonfmu.builder import FmuBuilder

    from chaincrane_builder.pack import build

    with tempfile.TemporaryDirectory() as scratch:
        Path(scratch, "nothing.py").write_text(NOTHING)
        nothing = FmuBuilder.build_FMU(f"{scratch}/nothing.py", scratch)
        files = [build("crane_nl", Path(scratch)), nothing]
        slaves, folders = [], []
        for file in files:
            description = read_model_description(str(file), validate=False)
            folders.append(extract(str(file)))
            slaves.append(
                FMU2Slave(
                    guid=description.guid,
                    unzipDirectory=folders[-1],
                    modelIdentifier=description.coSimulation.modelIdentifier,
                    instanceName="timed",
                )
            )
            slaves[-1].instantiate()

        def run(slave: FMU2Slave) -> None:
            slave.reset()
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            for number in range(4000):
                slave.setReal([0, 1, 2], [SPEED if number < 1000 else 0.0, 0.0, 0.0])
                slave.doStep(currentCommunicationPoint=1e-3 * number, communicationStepSize=1e-3)
                slave.getReal(list(range(20, 27)))

        ours, idle = timed([lambda: run(slaves[0]), lambda: run(slaves[1])], rounds)
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
    ratio = statistics.median(a / b for a, b in zip(ours, idle, strict=True))
    return statistics.median(ours), ratio


def cold_ratio(rounds: int) -> tuple[float, float]:
    """Time of ``fmpy simulate crane_nl.fmu``, s; its ratio to an FMU that only imports NumPy."""
    from pythonfmu.builder import FmuBuilder

    from chaincrane_builder.pack import build

    with tempfile.TemporaryDirectory() as scratch:
        Path(scratch, "idle.py").write_text("import numpy\n" + NOTHING.replace("Nothing", "Idle"))
        idle = FmuBuilder.build_FMU(f"{scratch}/idle.py", scratch)
        files = [build("crane_nl", Path(scratch)), idle]
        options = ["--stop-time=4", "--output-interval=0.005", f"--output-file={scratch}/out.csv"]

        def run(file: Path) -> None:
            fmpy = [sys.executable, "-m", "fmpy", "simulate", str(file), *options]
            subprocess.run(fmpy, check=True, capture_output=True)

        ours, theirs = timed([lambda: run(files[0]), lambda: run(files[1])], rounds)
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    return statistics.median(ours), ratio


# --- meshes -----------------------------------------------------------------------------------


def mesh_rows(library: Any, rounds: int) -> list[list[str]]:
    """Cost of a step of 1 ms and of an element in it, for fine and coarse meshes."""
    cranes = []
    for n in MESHES:
        crane = NativeCrane(Crane(), Initial(), Numerics(n, 1e-3), library=library)
        crane.step(STOP, Command(trolley_v_cmd=SPEED))
        crane.step(0.5)
        cranes.append(crane)
    times = timed([partial(crane.step, 0.1) for crane in cranes], rounds)
    per_step = [statistics.median(mine) / 100 for mine in times]
    ten = per_step[MESHES.index(10)] / 10
    return [
        [
            str(n),
            f"{1e6 * cost:.2f} us",
            f"{1e9 * cost / n:.0f} ns",
            f"{cost / n / ten:.2f}",
            f"{crane.effort.iterations / crane.effort.steps:.2f}",
        ]
        for n, cost, crane in zip(MESHES, per_step, cranes, strict=True)
    ]


# --- report -----------------------------------------------------------------------------------


def cheapest(points: list[Point], cost: dict[Point, float], target: float) -> dict[str, Point]:
    """For each solver its cheapest setting that reaches ``target`` m."""
    best: dict[str, Point] = {}
    for point in points:
        if point.error < target:
            other = best.get(point.solver)
            if other is None or cost[point] < cost[other]:
                best[point.solver] = point
    return best


def plot(points: list[Point], cost: dict[Point, float], path: Path) -> None:
    """Work-precision plot of the steel chain's solvers."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"font.size": 9, "svg.hashsalt": "chaincrane", "svg.fonttype": "none"})
    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    styles = {
        "kernel": ("black", "o"),
        "inextensible": ("#009E73", "D"),
        "numpy": ("#888888", "s"),
        "mujoco rk4": ("#0072B2", "^"),
        "mujoco euler": ("#D55E00", "v"),
    }
    for solver, (colour, marker) in styles.items():
        mine = [p for p in points if p.solver == solver and 0.0 < p.error < 0.1]
        axes.loglog(
            [1e3 * p.error for p in mine],
            [1e3 * cost[p] for p in mine],
            marker=marker,
            color=colour,
            label=solver,
            markersize=4,
        )
        told = [p for p in mine if p.estimate is not None]
        axes.loglog(
            [1e3 * (p.estimate or 0.0) for p in told],
            [1e3 * cost[p] for p in told],
            marker=marker,
            linestyle="none",
            markerfacecolor="none",
            color=colour,
            markersize=7,
            label=f"{solver}, as its companion tells" if told else None,
        )
    axes.set_xlabel("largest error of the payload, mm")
    axes.set_ylabel("time for 4 s of the paper's run, ms")
    axes.grid(alpha=0.25, which="both")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    axes.set_title("Work and precision: ten steel elements or eight points", loc="left", fontsize=9)
    figure.savefig(path, dpi=200, metadata={"Date": None} if path.suffix == ".svg" else None)


def main() -> int:
    """Measure all, and print tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7, help="counted rounds (7)")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="work-precision plot, SVG or PNG")
    options = parser.parse_args()

    with tempfile.TemporaryDirectory() as scratch:
        library = load_library(str(kernel_for_host(Path(scratch))))
    points = our_points(library) + inextensible_points(library)
    try:
        points += mujoco_points(library)
    except ImportError:
        print("MuJoCo is not installed: pip install -e '.[benchmark]'\n")
    points += solve_ivp_points(library)
    times = timed([point.run for point in points], options.rounds)
    cost = {p: statistics.median(mine) for p, mine in zip(points, times, strict=True)}

    for target in TARGETS:
        best = cheapest(points, cost, target)
        steel, soft = cost[best["kernel"]], cost[best["kernel, soft"]]
        rows = [
            [
                solver,
                point.setting,
                f"{1e3 * point.error:.3f} mm",
                f"{1e3 * cost[point]:.2f} ms",
                f"{cost[point] / (soft if 'soft' in solver else steel):.1f}",
            ]
            for solver, point in best.items()
        ]
        print(f"4 s of the paper's run, payload within {1e3 * target:g} mm:\n")
        print(markdown_table(["solver", "setting", "error", "time", "ratio to kernel"], rows), "\n")
    header = ["elements", "a step", "an element of it", "ratio to n = 10", "iterations a step"]
    print(markdown_table(header, mesh_rows(library, options.rounds)), "\n")
    fmu, ratio = fmu_ratio(options.rounds)
    print(f"crane_nl.fmu under FMPy: {1e6 * fmu / 4000:.1f} us a step of 1 ms,", end=" ")
    print(f"{ratio:.2f} times an FMU that does nothing")
    cold, ratio = cold_ratio(options.rounds)
    print(f"fmpy simulate crane_nl.fmu, cold: {cold:.2f} s,", end=" ")
    print(f"{ratio:.2f} times an FMU that only imports NumPy")
    if options.plot:
        plot(points, cost, options.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())

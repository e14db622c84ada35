#!/usr/bin/env python3
"""How far are ten elements from the chain that they stand for? The mesh's error, and the step's.

Two runs: the paper's stop, 4 s, travelling start; and 30 s of swing from 0.3 rad. Largest distance
of the payload from that of 160 elements (averaged mass matrix, internal step 0.25 ms), looked at
every 10 ms, for both cranes, both payloads and both mass matrices; and the error of an internal
step of 1 ms with ten elements.

    python benchmarks/mesh.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "fmu_src")]


from chaincrane.plant.command import Command
from chaincrane.plant.kernel import NativeCrane, load_library
from chaincrane.plant.parameters import MASS_MATRICES, Crane, Initial, Numerics, Payload
from chaincrane_builder.compile_c import kernel_for_host
from chaincrane_driver.compare import markdown_table

PAYLOADS = {"heavy": 0.42, "light": 0.07}  # kg
SAMPLE, FINE_STEP, FINE_MESH = 0.01, 2.5e-4, 160  # s, s, elements
MESHES = (10, 20, 40)  # elements


CASES = {"stop": (Initial(), 4.0), "release": (Initial(speed=0.0, sway_angle=0.3), 30.0)}  # s


def path(model: Any, case: str) -> np.ndarray:
    """Payload's positions, one every 10 ms, (samples, 2), m."""
    rows = []
    for number in range(round(CASES[case][1] / SAMPLE)):
        travels = case == "stop" and number < 100
        model.step(SAMPLE, Command(trolley_v_cmd=0.8 if travels else 0.0))
        out = model.outputs()
        rows.append((out["payload.x"], out["payload.y"]))
    return np.array(rows)


def main() -> None:
    """Print the tables."""
    # Windows does not delete a library that is loaded
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        libraries = {
            kind: load_library(str(kernel_for_host(Path(scratch, kind), f"{kind}.c")))
            for kind in ("nonlinear", "linear")
        }

    def run(kind: str, payload: str, case: str, numerics: Numerics) -> np.ndarray:
        crane = Crane(payload=Payload(PAYLOADS[payload]))
        model = NativeCrane(crane, CASES[case][0], numerics, library=libraries[kind])
        return path(model, case)

    def apart(a: np.ndarray, b: np.ndarray) -> str:
        return f"{1e3 * np.hypot(*(a - b).T).max():.2f} mm"

    rows = []
    for kind in libraries:
        for case in CASES:
            for payload in PAYLOADS:
                fine = Numerics(FINE_MESH, FINE_STEP, mass_matrix="averaged")
                truth = run(kind, payload, case, fine)
                for mass_matrix in MASS_MATRICES:
                    chosen = (Numerics(n, FINE_STEP, mass_matrix=mass_matrix) for n in MESHES)
                    errors = [apart(run(kind, payload, case, one), truth) for one in chosen]
                    rows.append([kind, case, payload, mass_matrix, *errors])
    header = ["crane", "case", "payload", "chain.mass_matrix"]
    header += [f"{elements} elements" for elements in MESHES]
    print(markdown_table(header, rows), "\n")
    for payload in PAYLOADS:
        coarse, fine_path = (
            run("nonlinear", payload, "stop", Numerics(max_step=step)) for step in (1e-3, 1e-5)
        )
        print(f"time error at 1 ms, {payload}: {apart(coarse, fine_path)}")


if __name__ == "__main__":
    main()

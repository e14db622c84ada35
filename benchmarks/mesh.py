#!/usr/bin/env python3
"""How far are ten elements from the chain that they stand for? The mesh's error, and the step's.

The paper's run, 4 s, travelling start: largest distance of the payload from that of 160 elements
(averaged mass matrix, internal step 0.25 ms), looked at every 10 ms, for both cranes, both payloads
and both mass matrices; and the error of an internal step of 1 ms with ten elements.

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
from chaincrane.plant.linear import LinearCrane
from chaincrane.plant.parameters import MASS_MATRICES, Crane, Initial, Numerics, Payload
from chaincrane_builder.compile_c import kernel_for_host
from chaincrane_driver.compare import markdown_table

PAYLOADS = {"heavy": 0.42, "light": 0.07}  # kg
SAMPLE, FINE_STEP, FINE_MESH = 0.01, 2.5e-4, 160  # s, s, elements


def path(model: Any) -> np.ndarray:
    """Payload's positions over the paper's run, (400, 2), m."""
    rows = []
    for number in range(400):
        model.step(SAMPLE, Command(trolley_v_cmd=0.8 if number < 100 else 0.0))
        out = model.outputs()
        rows.append((out["payload.x"], out["payload.y"]))
    return np.array(rows)


def main() -> None:
    """Print the table."""
    # Windows does not delete a library that is loaded
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        library = load_library(str(kernel_for_host(Path(scratch))))

    def run(
        kind: str, payload: str, n: int, mass_matrix: str, step: float = FINE_STEP
    ) -> np.ndarray:
        settings = (
            Crane(payload=Payload(PAYLOADS[payload])),
            Initial(),
            Numerics(n, step, mass_matrix=mass_matrix),
        )
        if kind == "linear":
            return path(LinearCrane(*settings))
        return path(NativeCrane(*settings, library=library))

    def apart(a: np.ndarray, b: np.ndarray) -> str:
        return f"{1e3 * np.hypot(*(a - b).T).max():.2f} mm"

    rows = []
    for kind in ("nonlinear", "linear"):
        for payload in PAYLOADS:
            truth = run(kind, payload, FINE_MESH, "averaged")
            for mass_matrix in MASS_MATRICES:
                errors = [apart(run(kind, payload, n, mass_matrix), truth) for n in (10, 20, 40)]
                rows.append([kind, payload, mass_matrix, *errors])
    header = ["crane", "payload", "chain.mass_matrix", "10 elements", "20", "40"]
    print(markdown_table(header, rows), "\n")
    for payload in PAYLOADS:
        coarse = run("nonlinear", payload, 10, "consistent", 1e-3)
        fine = run("nonlinear", payload, 10, "consistent", 1e-5)
        print(f"time error at 1 ms, {payload}: {apart(coarse, fine)}")


if __name__ == "__main__":
    main()

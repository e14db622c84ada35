"""A sweep of one's own: how much a payload sways after the stop, by its mass and by the chain.

Beside the FMUs: python sweep.py. Work runs in a few processes that keep their FMUs. For more than
this there is chaincrane sweep.
"""

from pathlib import Path

from chaincrane_driver.processes import simulate_all
from chaincrane_driver.simulate import Job

MASSES, ELEMENTS = (0.07, 0.2, 0.42), (1, 2, 10)  # kg

if __name__ == "__main__":  # the processes read this file, too
    cases = [(mass, count) for mass in MASSES for count in ELEMENTS]
    jobs = [
        Job(Path("crane_lin.fmu"), {"payload.mass": mass, "chain.elements": count}, None, 4.0, 0.01)
        for mass, count in cases
    ]
    print("payload, kg  elements  largest sway, mm")
    for (mass, count), result in zip(cases, simulate_all(jobs, "sweep"), strict=True):
        print(f"{mass:11}  {count:8}  {1e3 * abs(result['payload.x_rel']).max():16.1f}")

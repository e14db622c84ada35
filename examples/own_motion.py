"""A trolley's motion of one's own, from motion.csv: its columns are named like inputs.

Beside crane_nl.fmu: python own_motion.py. Inputs are linear between rows; the same time twice is a
jump. FMPy wants a column for each input, so the other two are there, too.
"""

from pathlib import Path

import matplotlib.pyplot as plt
from fmpy import simulate_fmu
from fmpy.util import read_csv

motion = read_csv(str(Path(__file__).with_name("motion.csv")))
result = simulate_fmu(
    "crane_nl.fmu",
    input=motion,
    start_values={"initial.speed": 0.0, "payload.mass": 0.2},
    stop_time=6.0,
    output_interval=0.01,
)
assert result["time"][-1] > 5.99, "the FMU has discarded a step: see what it has printed"

figure, (top, bottom) = plt.subplots(2, sharex=True)
top.plot(result["time"], result["trolley.v"])
top.set_ylabel("trolley, m/s")
bottom.plot(result["time"], 1e3 * result["payload.x_rel"])
bottom.set_ylabel("sway, mm")
bottom.set_xlabel("time, s")
figure.savefig("own_motion.png")
print(f"sway at most {1e3 * abs(result['payload.x_rel']).max():.0f} mm")

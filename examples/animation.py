"""An animation of the chain, as a GIF: ten of its points are outputs, chain.x[i] and chain.y[i].

Beside crane_nl.fmu: python animation.py. (chaincrane report makes one for a browser.)
"""

import matplotlib.pyplot as plt
import numpy as np
from fmpy import simulate_fmu
from matplotlib.animation import FuncAnimation, PillowWriter

result = simulate_fmu(
    "crane_nl.fmu", start_values={"payload.mass": 0.07}, stop_time=2.0, output_interval=0.04
)
x = np.column_stack([result["trolley.x"], *(result[f"chain.x[{i}]"] for i in range(1, 11))])
y = np.column_stack([0 * result["time"], *(result[f"chain.y[{i}]"] for i in range(1, 11))])

figure, axes = plt.subplots(figsize=(3, 4))
axes.set(xlim=(-0.4, 0.4), ylim=(-0.9, 0.1), aspect="equal", xlabel="x, m", ylabel="y, m")
(chain,) = axes.plot([], [], "k.-")
(payload,) = axes.plot([], [], "o", markersize=10)


def draw(row):
    chain.set_data(x[row], y[row])
    payload.set_data(x[row, -1:], y[row, -1:])
    axes.set_title(f"{result['time'][row]:.2f} s")
    return chain, payload


FuncAnimation(figure, draw, frames=len(x)).save("chain.gif", PillowWriter(fps=25))
print(f"chain.gif: {len(x)} pictures")

"""The cranes of a scenario, moving: an animated SVG, which browsers play. The README's picture.

Beside crane_nl.fmu and crane_lin.fmu: python moving_picture.py. Its lengths are millimetres.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from chaincrane_driver import scenario
from chaincrane_driver.processes import simulate_all

one = scenario.load(Path("paper_light"))
runs = one.named(["massless", "linear_10", "nonlinear"])[::-1]  # the last is on top
jobs = [replace(one.job(run, Path(run.fmu)), output_interval=0.04) for run in runs]
DASHES = {"massless": ("#00795A", "4 8"), "linear_10": ("#0072B2", "22 8")}


def moving(attribute, values):
    repeat = f'dur="{one.stop_time:g}s" repeatCount="indefinite"'
    return f'<animate attributeName="{attribute}" {repeat} values="{";".join(values)}"/>'


parts = ['<rect x="-150" y="-80" width="1450" height="1000" fill="white"/>']
parts += ['<path d="M-150 0H1300" stroke="gray" stroke-width="4"/>']
for place, (run, result) in enumerate(zip(runs, simulate_all(jobs, "runs"), strict=True)):
    x = [result["trolley.x"], *(result[f"chain.x[{i + 1}]"] for i in range(10))]
    y = [0 * result["time"], *(-result[f"chain.y[{i + 1}]"] for i in range(10))]
    points = np.rint(1e3 * np.array([x, y]).T).astype(int).tolist()  # by time, then down the chain
    colour, dashes = DASHES.get(run.name, ("black", "none"))
    line = f'fill="none" stroke="{colour}" stroke-width="6" stroke-dasharray="{dashes}"'
    shapes = [" ".join(f"{a},{b}" for a, b in chain) for chain in points]
    ends = [
        moving(f"c{axis}", [str(chain[-1][k]) for chain in points]) for k, axis in enumerate("xy")
    ]
    text = f'x="20" y="{792 + 50 * place}" font-size="38" font-family="sans-serif"'
    parts += [f"<polyline {line}>{moving('points', shapes)}</polyline>"]
    parts += [f'<circle r="18" fill="{colour}">{"".join(ends)}</circle>']
    parts += [f'<path {line} d="M-110 {780 + 50 * place}h110"/><text {text}>{run.label}</text>']
trolley = moving("x", [str(chain[0][0] - 35) for chain in points])
parts += [f'<rect y="-18" width="70" height="36">{trolley}</rect>']
view = 'xmlns="http://www.w3.org/2000/svg" viewBox="-150 -80 1450 1000"'
Path("crane.svg").write_text("\n".join([f"<svg {view}>", *parts, "</svg>\n"]))
print(f"crane.svg: {len(points)} pictures of {len(runs)} cranes")

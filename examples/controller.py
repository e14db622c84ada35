"""A controller of one's own in a plain loop: the trolley goes 1 m, and sway is fed back.

Beside crane_nl.fmu: python controller.py. The crane starts at rest only if it is told to.
"""

from tempfile import TemporaryDirectory

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

STEP, STOP, TARGET = 0.01, 10.0, 1.0  # s, s, m

description = read_model_description("crane_nl.fmu")
place = {variable.name: variable.valueReference for variable in description.modelVariables}
folder = TemporaryDirectory()
crane = FMU2Slave(
    guid=description.guid,
    unzipDirectory=extract("crane_nl.fmu", folder.name),
    modelIdentifier=description.coSimulation.modelIdentifier,
)
crane.instantiate()
crane.setupExperiment(startTime=0.0)
crane.setReal([place["initial.speed"]], [0.0])  # else it travels at 0.8 m/s, and stops dead
crane.enterInitializationMode()
crane.exitInitializationMode()

seen = [place[name] for name in ("trolley.x", "trolley.v", "payload.x_rel", "payload.vx")]
x = v = sway = vx = 0.0
for number in range(round(STOP / STEP)):
    # slow poles for the trolley; its acceleration against the sway's velocity takes sway out
    a = 0.5 * (TARGET - x) - 1.2 * v + 1.0 * (vx - v)
    crane.setReal([place["trolley.a_cmd"]], [max(-1.0, min(1.0, a))])
    crane.doStep(number * STEP, STEP)
    x, v, sway, vx = crane.getReal(seen)

print(f"after {STOP:g} s: trolley at {x:.3f} m, sway {1e3 * sway:.1f} mm")
crane.terminate()
crane.freeInstance()
folder.cleanup()

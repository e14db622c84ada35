"""The linear crane's A, B, C, D in python-control: poles, a regulator, and its step response.

pip install control, then: python python_control.py. The matrices are the paper's (32).
"""

import control
import numpy as np

from chaincrane.plant.linear import state_space
from chaincrane.plant.parameters import Crane

model = state_space(Crane(), elements=2)
chain = control.ss(model.A, model.B[:, :1], model.C[:1], model.D[:1, :1])  # a_cmd to the sway
lowest = min(abs(pole) for pole in chain.poles())
print(f"the slowest mode swings once in {2 * np.pi / lowest:.3f} s")

# the trolley itself: its place and velocity are two more states, both driven by a_cmd
A = np.block([[model.A, np.zeros((4, 2))], [np.zeros((2, 4)), np.array([[0, 1], [0, 0]])]])
B = np.vstack([model.B[:, :1], [[0], [1]]])
gain, _, _ = control.lqr(A, B, np.diag([1, 25, 0, 0, 4, 1]), np.array([[1]]))
closed = control.ss(A - B @ gain, B * gain[0, 4], np.eye(6)[[1, 4]], 0)
response = control.step_response(closed, np.linspace(0, 15, 1501))
sway, place = response.outputs[:, 0]
print(f"a step of 1 m: sway at most {1e3 * abs(sway).max():.0f} mm, at the end {place[-1]:.3f} m")

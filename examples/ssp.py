"""The crane as the plant in an SSP package: written here, run by libcosim as it is.

Beside the FMUs, with pip install libcosimpy: python ssp.py. Parts, connections, start values and
step are all in the package. (FMPy's simulate_ssp leaves the start values out.)
"""

from pathlib import Path

from chaincrane_driver.antisway import Setup
from chaincrane_driver.masters import Package
from chaincrane_driver.processes import simulate_all
from chaincrane_driver.ssp import write_ssp

if __name__ == "__main__":  # the process that runs libcosim reads this file, too
    # crane, observer, controller; a loop of your own has its parts and their start values by name
    loop = Setup(payload=0.07, stop_time=10.0).loop(Path())
    package = write_ssp(Path("crane.ssp"), loop)
    (result,) = simulate_all([Package("libcosim", package, loop)], "libcosim")
    x, sway = result["crane::trolley.x"][-1], result["crane::payload.x_rel"][-1]
    print(f"crane.ssp: trolley at {x:.3f} m, sway {1e3 * sway:.1f} mm after {loop.stop_time:g} s")

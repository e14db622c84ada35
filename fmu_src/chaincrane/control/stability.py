"""The closed loop as its own model predicts it: how its slowest disturbance grows or dies away.

All parts step side by side, as in the SSP package: sample, estimate and command are each of the
step's start, and the command acts in the next step. The plant is the string with more modes than
the filter has, so that what the filter does not know (spillover) shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import log

import numpy as np

from ..plant.chain import Array, discretise
from ..plant.parameters import Crane
from . import kalman
from .antisway import AntiSway, AntiSwaySettings
from .modes import MESH, StringModes
from .observer import SENSORS, CraneObserver, ObserverSettings

PLANT_MODES = 10
GROWS = 1e-3  # of omega_1; slower growth, in 160 periods by e, is not worth a warning
_KEPT = 64  # warnings, of all controllers of a process


@dataclass(frozen=True)
class Growth:
    """The eigenvalue of the loop that dies away most slowly."""

    rate: float  # 1/s, positive: it grows
    omega: float  # rad/s, at which it swings


def warning(control: AntiSway, h: float) -> str | None:
    """What a user should be told of a loop that is unstable with either sensor; None: nothing."""
    return _warning(control.settings, h)


@lru_cache(_KEPT)
def _warning(settings: AntiSwaySettings, h: float) -> str | None:
    """The same of a controller of these settings, kept: an FMU is reset to them again and again."""
    control = AntiSway(settings)
    first = float(control.string.modes.omega[0])
    found = {sensor: expected_growth(control, sensor, h) for sensor in SENSORS}
    for sensor, growth in found.items():
        if growth.rate > GROWS * first:
            return (
                "the closed loop is unstable by the controller's own model, with a"
                f" {sensor} sampled every {h:g} s: eigenvalue {growth.rate:.2g} +"
                f" {growth.omega:.4g}i 1/s; smaller antisway.scale.jerk and larger"
                " antisway.scale.position make it calmer"
            )
    return None


def predicted_growth(control: AntiSway, watch: CraneObserver, crane: Crane, h: float) -> Growth:
    """The loop of a controller and an observer on a crane, in steps and samples of ``h`` s."""
    string = StringModes(discretise(crane, MESH, control.settings.mass_matrix), PLANT_MODES)
    return slowest(closed_loop(control, watch, string, h), h)


def expected_growth(control: AntiSway, sensor: str, h: float) -> Growth:
    """With an observer of the controller's model and the defaults' filter, on its own crane."""
    one = control.settings
    believed = ObserverSettings(one.crane, one.mass_matrix, 0.0, one.model, one.elements)
    settings = replace(believed, sensor=sensor)
    settings = replace(settings, clock=replace(settings.clock, sample_time=h))
    return predicted_growth(control, CraneObserver(settings), one.crane, h)


def slowest(loop: Array, h: float) -> Growth:
    """The largest eigenvalue of a loop's step of ``h`` s."""
    roots = np.linalg.eigvals(loop)
    largest = roots[np.argmax(np.abs(roots))]
    return Growth(log(max(abs(largest), 1e-300)) / h, float(abs(np.angle(largest))) / h)


def closed_loop(control: AntiSway, watch: CraneObserver, string: StringModes, h: float) -> Array:
    """The matrix of one step of ``h`` s: z of the plant, trolley, estimate, acceleration.

    Plant and estimate in z = [omega eta; eta'] (:mod:`kalman`); the drive's lag is left out.
    """
    rope = watch.settings.sensor == "rope"
    omega, n = string.modes.omega, len(string.modes.omega)
    found, watched = watch.filters_for(h).fed_back, watch.cautious
    phi, m = watched.transition(h), len(watched.c)
    modes = len(watch.string.modes.omega)
    size = 2 * n + 2 + m + 1
    plant, trolley, estimate, a = slice(0, 2 * n), 2 * n, slice(2 * n + 2, size - 1), size - 1
    loop = np.zeros((size, size))
    loop[plant, plant] = kalman.transition(string, h)
    loop[plant, a] = kalman.held_input(string, h)[:, 1]
    loop[trolley, [trolley, trolley + 1, a]] = 1.0, h, 0.5 * h * h
    loop[trolley + 1, [trolley + 1, a]] = 1.0, h
    # The estimate, corrected by the sample of the step's start.
    shown = np.zeros(size)
    row, left = (string.slope, string.slope_left) if rope else (string.end, string.end_left)
    known = (watch.string.slope_left if rope else watch.string.end_left)[0]
    shown[:n] = row / omega
    shown[a] = left[0] - known
    correction = np.outer(phi @ found.gain, shown)
    correction[:, estimate] -= np.outer(phi @ found.gain, watched.c)
    loop[estimate] = correction
    loop[estimate, estimate] += phi
    loop[2 * n + 2 : 2 * n + 2 + 2 * modes, a] += kalman.held_input(watch.string, h)[:, 1]
    # The command: what the regulator makes of the estimate at the step's start.
    fed_back = min(control.modes, modes)
    one = control.design(h)
    told = np.zeros((len(one.Ad), size))
    told[[0, 1], [trolley, trolley + 1]] = 1.0
    end = watch.string.end
    first = 2 * n + 2
    wind = 0.0 if watched.pull is None else watched.pull
    told[0, size - 2] += control.string.end_by_force * wind
    for mode in range(fed_back):
        q, rate = 2 + 2 * mode, 3 + 2 * mode
        told[q, first + mode] = end[mode] / watch.string.modes.omega[mode]
        told[rate, first + modes + mode] = end[mode]
        own = control.string
        told[q, size - 2] -= own.end[mode] ** 2 / own.modes.omega[mode] ** 2 * wind
    ahead = one.Ad @ told
    ahead[:, a] += one.Bd
    loop[a] = -h * one.K[:-1] @ ahead
    loop[a, a] += 1.0 - h * one.K[-1]
    return loop

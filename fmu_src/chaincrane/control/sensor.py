"""A sensor: it samples, is off by noise and bias, and speaks late. Repeatable bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import cos, floor, log, pi, sqrt
from typing import Any

import numpy as np

from ..variables import ABOVE_ZERO, parameter, whole

ROUND_OFF = 1e-9  # s, what a sum of communication steps may be off by
MAX_SEED = 2**31 - 1
_BLOCK = 64  # deviates whose bits are drawn at once: to make a generator takes longer than they do
_BLOCKS = 64  # that are kept, of all seeds


@dataclass(frozen=True)
class Clock:
    """When a sensor samples, when it speaks, and what its noise begins with."""

    sample_time: float = parameter(
        "sensor.sample_time",
        "s",
        0.01,
        "of the sensor's clock; samples are taken at communication points",
        minimum=ABOVE_ZERO,
        nominal=0.01,
    )
    delay: float = parameter(
        "sensor.delay", "s", 0.0, "until a sample arrives; the filter knows", minimum=0.0
    )
    seed: int = whole(
        "sensor.seed", 1, (0, MAX_SEED), "of the noise; the same seed gives the same bits"
    )


def _noise(sensor: str, unit: str) -> Any:
    return parameter(f"{sensor}.noise", unit, 0.0, "standard deviation of each sample", minimum=0.0)


def _bias(sensor: str, unit: str) -> Any:
    return parameter(
        f"{sensor}.bias", unit, 0.0, "what each sample is off by, unknown to the filter"
    )


@dataclass(frozen=True)
class Camera:
    """What a camera's samples are off by."""

    noise: float = _noise("camera", "m")
    bias: float = _bias("camera", "m")


@dataclass(frozen=True)
class Rope:
    """What a rope-angle sensor's samples are off by."""

    noise: float = _noise("rope", "rad")
    bias: float = _bias("rope", "rad")


@dataclass(frozen=True)
class Sensor:
    """What a sensor does to a signal."""

    clock: Clock
    off: Camera | Rope

    def due(self, time: float, taken_until: int) -> int | None:
        """Number of the clock's last tick by ``time`` s, or None where it has been taken already.

        The clock ticks at 0, T, 2 T, ...; a signal can be sampled at communication points alone.
        """
        tick = floor((time + ROUND_OFF) / self.clock.sample_time)
        return tick if tick >= taken_until else None

    def reading(self, value: float, number: int) -> float:
        """What sample ``number`` says of ``value``."""
        return value + self.off.bias + self.off.noise * normal(self.clock.seed, number)

    def heard(self, sampled: float, time: float) -> bool:
        """Whether by ``time`` s a sample of the instant ``sampled`` has arrived."""
        return sampled + self.clock.delay <= time + ROUND_OFF


@lru_cache(_BLOCKS)
def _bits(seed: int, block: int) -> list[list[int]]:
    """Philox's bits of the deviates of a block: its counter's next words, two of every four."""
    words = np.random.Philox(key=seed, counter=block * _BLOCK).random_raw(4 * _BLOCK)
    drawn: list[list[int]] = words.reshape(_BLOCK, 4)[:, :2].tolist()
    return drawn


def normal(seed: int, number: int) -> float:
    """Standard normal deviate ``number`` of a seed's stream: Box & Muller (1958) on Philox's bits.

    z = sqrt(-2 ln u1) cos(2 pi u2). It depends on its two arguments alone, so a saved state needs
    no generator, and Philox's bits are the same in every NumPy.
    """
    block, place = divmod(number, _BLOCK)
    first, second = _bits(seed, block)[place]
    u1, u2 = (first >> 11) + 0.5, (second >> 11) + 0.5
    return sqrt(-2.0 * log(u1 * 2.0**-53)) * cos(2.0 * pi * u2 * 2.0**-53)

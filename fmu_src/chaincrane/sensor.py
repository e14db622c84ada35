"""A sensor: it samples, is off by noise and bias, and speaks late. Repeatable bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, floor, log, pi, sqrt

import numpy as np

from .errors import BadValue
from .parameters import check_number

ROUND_OFF = 1e-9  # s, what a sum of communication steps may be off by
MAX_SEED = 2**31 - 1


@dataclass(frozen=True)
class Sensor:
    """What a sensor does to a signal; noise and bias in the signal's unit."""

    sample_time: float = 0.01  # s
    noise: float = 0.0  # standard deviation
    bias: float = 0.0
    delay: float = 0.0  # s, until a sample is heard of
    seed: int = 1

    def check(self, name: str) -> None:
        """Raise BadValue for the first value not allowed; ``name``: camera or rope."""
        positive, not_negative = "a finite number above 0", "a finite number, 0 or above"
        check_number("sensor.sample_time", self.sample_time, positive, test=lambda v: v > 0)
        check_number("sensor.delay", self.delay, not_negative, test=lambda v: v >= 0)
        check_number(f"{name}.noise", self.noise, not_negative, test=lambda v: v >= 0)
        check_number(f"{name}.bias", self.bias)
        if not isinstance(self.seed, int) or not 0 <= self.seed <= MAX_SEED:
            raise BadValue("sensor.seed", self.seed, f"a whole number from 0 to {MAX_SEED}")

    def due(self, time: float, taken_until: int) -> int | None:
        """Number of the clock's last tick by ``time`` s, or None where it has been taken already.

        The clock ticks at 0, T, 2 T, ...; a signal can be sampled at communication points alone.
        """
        tick = floor((time + ROUND_OFF) / self.sample_time)
        return tick if tick >= taken_until else None

    def reading(self, value: float, number: int) -> float:
        """What sample ``number`` says of ``value``."""
        return value + self.bias + self.noise * normal(self.seed, number)

    def heard(self, sampled: float, time: float) -> bool:
        """Whether by ``time`` s a sample of the instant ``sampled`` has arrived."""
        return sampled + self.delay <= time + ROUND_OFF


def normal(seed: int, number: int) -> float:
    """Standard normal deviate ``number`` of a seed's stream: Box & Muller (1958) on Philox's bits.

    z = sqrt(-2 ln u1) cos(2 pi u2). It depends on its two arguments alone, so a saved state needs
    no generator, and Philox's bits are the same in every NumPy.
    """
    first, second = np.random.Philox(key=seed, counter=number).random_raw(2).tolist()
    u1, u2 = ((bits >> 11) + 0.5 for bits in (first, second))
    return sqrt(-2.0 * log(u1 * 2.0**-53)) * cos(2.0 * pi * u2 * 2.0**-53)

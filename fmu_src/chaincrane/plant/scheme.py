"""What a time-stepping scheme takes and gives. A scheme knows nothing of communication steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from .chain import Array
from .command import Command


@dataclass(frozen=True)
class Motion:
    """Motion of the free nodes relative to the trolley."""

    r: Array  # m, (n, 2), positions
    w: Array  # m/s, (n, 2), velocities
    tension: Array  # N, (n,)
    a: Array | None = None  # m/s2, (n, 2), accelerations; None at a start
    stretched: Array | None = None  # m, (n,), by the last step; None at a start
    last_h: float = 0.0  # s, that step's length


@dataclass(frozen=True)
class Jump:
    """What a jump makes of a motion; ``tension``, N, (n,), is what the motion after it requires."""

    motion: Motion
    dw: Array  # m/s, (n, 2), change of the nodes' velocities
    tension: Array | None = None  # None: the elements' lengths stay


@dataclass(frozen=True)
class Load:
    """What drives the crane during an internal step."""

    trolley_v: float  # m/s, at the step's start
    command: Command  # its acceleration and forces are constant

    def trolley_v_after(self, t: float) -> float:
        """Velocity of the trolley, m/s, ``t`` seconds into the step."""
        return self.trolley_v + t * self.command.trolley_a_cmd


@dataclass(frozen=True)
class StepResult:
    """A step that converged, with its energy terms."""

    motion: Motion
    trolley_fx: float  # N, what the drive exerts on the chain
    work_trolley: float  # J
    work_payload: float  # J
    dissipated: float  # J, by damping and by the scheme
    iterations: int


class Scheme(Protocol):
    """A time-stepping scheme for one chain."""

    def jump(self, motion: Motion, command: Command, trolley_v: float, dv: float) -> Jump:
        """A jump of the trolley's velocity by ``dv`` to ``trolley_v``, m/s."""

    def start(self, motion: Motion, load: Load) -> Motion:
        """Make ``motion`` ready for a first step, or for one after a change of load."""

    def step(self, motion: Motion, load: Load, h: float) -> StepResult:
        """One step of ``h`` seconds; raises NotConverged."""

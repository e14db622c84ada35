"""A crane that keeps a tolerance: where its time error is larger it is run anew, in shorter steps.

No step chosen from a local error keeps the error of a swing: what one step adds is small beside
what earlier ones have put into its phase. So the communication steps since the start are
remembered, and where the companion's estimate comes to half the tolerance the crane goes through
them all again, with steps half as long. At every communication point it is what it would be had it
taken its present step from the start; where the step changes, the payload's place changes by about
the tolerance, and forces by what their own errors are. All runs together cost at most about twice
the last.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, fields, replace
from typing import Any

import numpy as np

from ..errors import BadState, EnergyBalanceBroken, NotConverged
from ..whole_step import WholeSteps
from .command import IDLE, Command
from .crane import CraneModel
from .interface import PAST_STEP, TOLERANCE_NOT_KEPT, TOLERANCE_STATE
from .ledger import Effort
from .nonlinear import NonlinearCrane
from .parameters import Crane, Initial, Numerics

MAX_REFINEMENTS = 6  # times that solver.max_step is halved
MAX_REMEMBERED = 65536  # communication steps; three megabytes
# Of the tolerance, what the estimate may come to: it is too low now and then. With all of it 1 % of
# 285 random cranes were off by more than twice the tolerance.
ESTIMATED_SHARE = 0.5
_COMMAND_FIELDS = tuple(field.name for field in fields(Command))


class TolerantCrane(WholeSteps):
    """A crane whose estimated time error stays within solver.tolerance, as long as it can."""

    def __init__(
        self,
        make: Callable[[Crane | None, Initial | None, Numerics], CraneModel],
        crane: Crane | None,
        initial: Initial | None,
        numerics: Numerics,
    ) -> None:
        self._make, self._settings = make, (crane, initial)
        self._numerics = numerics
        self._level = 0  # times that the longest step was halved
        self._gave_up = False
        self._past: list[tuple[float, Command, float, float]] = []
        self._remembered = 0  # of the past; what stands behind was undone by who called
        self.crane = self._made()
        self.start_time = 0.0

    def _made(self) -> CraneModel:
        """The crane at its start, with the step of the present level."""
        step = self._numerics.max_step / 2**self._level
        return self._make(*self._settings, replace(self._numerics, max_step=step))

    def step(self, h: float, command: Command = IDLE) -> None:
        """Advance by ``h`` seconds under a held command, as :meth:`CraneModel.step` does."""
        trolley = self.crane.trolley
        self.crane.start_time = self.start_time
        self.crane.step(h, command)
        if self._remembered == MAX_REMEMBERED:
            self._gave_up, self._remembered = True, 0
        if self._gave_up:
            return
        self._past[self._remembered :] = [(h, command, trolley.v, trolley.gained)]
        self._remembered += 1
        while (
            self._exceeds(ESTIMATED_SHARE) and self._level < MAX_REFINEMENTS and not self._gave_up
        ):
            self._refine()

    def _exceeds(self, share: float) -> bool:
        """Whether the estimate exceeds a share of the tolerance."""
        return self.crane.error_payload > share * self._numerics.tolerance

    def _refine(self) -> None:
        """Run all that was anew, with steps half as long; as it was where that fails."""
        kept, effort = self.crane, self.crane.effort
        self._level += 1
        try:
            self.crane = self._made()
            for h, command, _, _ in self._past[: self._remembered]:
                self.crane.step(h, command)
                effort = Effort(
                    effort.steps + self.crane.effort.steps,
                    effort.iterations + self.crane.effort.iterations,
                )
        except (NotConverged, EnergyBalanceBroken):
            self.crane, self._gave_up = kept, True
            self._level -= 1
        self.crane.effort = effort

    def notice(self) -> str | None:
        """What a user should be told of the motion, once; None: nothing."""
        return TOLERANCE_NOT_KEPT if self._exceeds(1.0) else self.crane.notice()

    def keep(self) -> Any:
        """What :meth:`undo` needs; the crane goes on under the same name until it is refined."""
        return vars(self).copy(), self.crane.keep()

    def undo(self, kept: Any) -> None:
        """Be as when ``kept`` was kept."""
        own, cranes = kept
        vars(self).update(own)
        self.crane.undo(cranes)

    def outputs(self) -> dict[str, float]:
        """All outputs by their FMU names, in SI units, in the interface's order."""
        return self.crane.outputs()

    def save(self) -> bytes:
        """The whole state, bit for bit: the crane's, how it was refined, and the steps so far."""
        head = {
            "level": float(self._level),
            "gave_up": float(self._gave_up),
            "remembered": float(self._remembered),
        }
        past = self._past[: self._remembered]
        rows = [(h, *astuple(command), v, gained) for h, command, v, gained in past]
        numbers = [head[name] for name in TOLERANCE_STATE] + [x for row in rows for x in row]
        return self.crane.save() + np.array(numbers, dtype="<f8").tobytes()

    def load(self, state: bytes) -> None:
        """Restore what :meth:`save` gave, in a crane with the same parameters.

        Raises BadState, the crane unchanged, where the size does not fit.
        """
        own = len(self.crane.save())
        numbers = np.frombuffer(state[own:], dtype="<f8").tolist() if len(state) % 8 == 0 else []
        head = dict(zip(TOLERANCE_STATE, numbers, strict=False))
        past = numbers[len(TOLERANCE_STATE) :]
        if len(head) < len(TOLERANCE_STATE) or len(past) != head["remembered"] * len(PAST_STEP):
            raise BadState.of_other_settings()
        before, self._level = self._level, int(head["level"])
        try:
            crane = self._made()
            crane.load(state[:own])
        except BadState:
            self._level = before
            raise
        self.crane, self._gave_up, self._past = crane, bool(head["gave_up"]), []
        for place in range(0, len(past), len(PAST_STEP)):
            h, *told, v, gained = past[place : place + len(PAST_STEP)]
            command = Command(**dict(zip(_COMMAND_FIELDS, told, strict=True)))
            self._past.append((h, command, v, gained))
        self._remembered = len(self._past)


def nonlinear_crane(
    crane: Crane | None = None, initial: Initial | None = None, numerics: Numerics | None = None
) -> NonlinearCrane | TolerantCrane:
    """The nonlinear crane, which keeps solver.tolerance where one is set."""
    if numerics is None or numerics.tolerance == 0.0:
        return NonlinearCrane(crane, initial, numerics)
    return TolerantCrane(NonlinearCrane, crane, initial, numerics)

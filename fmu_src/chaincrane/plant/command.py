"""What drives a crane during a communication step, by name."""

from __future__ import annotations

from dataclasses import dataclass

from ..variables import held_input


@dataclass(frozen=True, kw_only=True)
class Command:
    """The cranes' inputs, held over a communication step."""

    trolley_v_cmd: float = held_input(
        "trolley.v_cmd",
        "m/s",
        "commanded velocity, held over the communication step; a change is a jump",
    )
    trolley_a_cmd: float = held_input(
        "trolley.a_cmd",
        "m/s2",
        "commanded acceleration, held over the communication step; the trolley moves at"
        " v_cmd + integral of a_cmd",
    )
    payload_fx: float = held_input(
        "payload.fx", "N", "outer horizontal force on the payload (wind, a push)"
    )


IDLE = Command()

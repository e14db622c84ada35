"""A jump of the trolley's velocity: the impulse on the chain, and the tension that follows it.

For a chain of rods that do not stretch, tensions jump with the velocities, to what the motion after
the jump requires. A stiff truss gets there by axial vibrations, which ring for ever, and which no
step of a millisecond resolves: its tension is an artefact of the step then. So a jump leaves out
what is faster than a time T: each axial vibration of frequency omega is scaled by
(1 + (omega T)^2)^-8, in the impulse and in the tension. Half is left at omega T = 0.3: at some
140 Hz for the longest T.

What a jump leaves are waves that run along the chain, and their tension is right only in steps that
resolve them. So steps are at most wave_step for the first wave_time after it: all others may be as
long as solver.max_step allows.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from . import banded
from .chain import (
    Array,
    DiscreteChain,
    along_elements,
    applied_force,
    assemble_force,
    axial_force,
    mass_times,
)
from .command import Command
from .parameters import Crane
from .scheme import Jump, Motion

JUMP_TIME = 3.5e-4  # s, T of a chain whose slowest axial vibration is much faster than this
JUMP_PASSES = 8  # the power of the filter
WAVE_STEP = 0.25  # of the time that an axial wave takes along an element, a step that resolves it
WAVE_TURN = 6.0  # rad, of the bounce that waves are followed for: nearly all of one
WAVE_TRAVELS = 40.0  # of a wave along the chain that are followed at most
WAVE_SHARE = 0.05  # of the weight; a jump whose wave pulls less is none to be followed


def bounce(crane: Crane) -> float:
    """Frequency of the payload's bounce on the chain, rad/s: sqrt(EA/(L (M + m/3)))."""
    chain = crane.chain
    return sqrt(chain.EA / (chain.length * (crane.payload.mass + chain.mass / 3.0)))


def stiffness_number(crane: Crane) -> float:
    """x^4, x = omega_1 JUMP_TIME, omega_1 the bounce, the slowest axial vibration; ours.

    Where that is slow, as in a soft chain, a user sees it and its waves, and all are kept; where
    even that is fast, none is.
    """
    return (bounce(crane) * JUMP_TIME) ** 4


def filter_time(crane: Crane) -> float:
    """T, s, of a crane: JUMP_TIME x^4/(1 + x^4), ours."""
    x4 = stiffness_number(crane)
    return JUMP_TIME * x4 / (1.0 + x4)


def wave_speed(crane: Crane) -> float:
    """Speed of an axial wave, m/s: sqrt(EA L/m)."""
    return sqrt(crane.chain.EA * crane.chain.length / crane.chain.mass)


def wave_step(chain: DiscreteChain) -> float:
    """Longest step, s, that resolves the waves which a jump leaves, ours.

    L0/(4 c) + JUMP_TIME x^4 (1 + x^4): a quarter of what a wave takes along an element, and longer
    the more of the fastest the filter leaves out. Where it leaves out all, any step will do.
    """
    x4 = stiffness_number(chain.crane)
    return WAVE_STEP * chain.L0 / wave_speed(chain.crane) + JUMP_TIME * x4 * (1.0 + x4)


def wave_time(crane: Crane, dv: float) -> float:
    """How long, s, the waves of a jump by ``dv`` m/s are followed: 6/omega_1, at most 40 L/c; ours.

    The first peaks of tension come within the bounce. 0 where dv c m/L, the tension of
    an axial wave that the trolley would send along the chain, is below a twentieth of the weight: a
    command in many small jumps is an acceleration.
    """
    c, chain = wave_speed(crane), crane.chain
    pull = abs(dv) * c * chain.mass / chain.length
    if pull < WAVE_SHARE * crane.gravity * crane.total_mass:
        return 0.0
    return min(WAVE_TURN / bounce(crane), WAVE_TRAVELS * chain.length / c)


def plain_jump(chain: DiscreteChain, motion: Motion, dv: float) -> Jump:
    """The impulse of the mass matrix: M_ff dw = -b dv, b its row sums; ``dv`` in m/s."""
    push = np.zeros_like(motion.w)
    push[:, 0] = -chain.row_mass * dv
    dw = banded.Factors(banded.mass_bands(chain)).solve(push)
    return Jump(Motion(motion.r, motion.w + dw, motion.tension), dw)


def filtered_jump(
    chain: DiscreteChain, motion: Motion, command: Command, trolley_v: float, dv: float
) -> Jump:
    """The same without what is faster than T, and the tension that the motion after it requires.

    With C the elements' rates of stretch by nodal velocities, and k = EA/L0, eight times over:

        dw <- (M + T^2 k C^T C)^-1 M dw
        (M + T^2 k C^T C) a = f - C^T (N + T^2 k g),  N <- N + T^2 k (C a + g),  g = w_perp^2/l

    The second line ends where no element stretches any faster, C a + g = 0: in a chain of rods.
    ``trolley_v``: after the jump, m/s.
    """
    T = filter_time(chain.crane)
    d = along_elements(motion.r)
    length = np.hypot(d[:, 0], d[:, 1])
    c = d / length[:, None]
    stiffness = T**2 * chain.crane.chain.EA / chain.L0
    tangent = stiffness * c[:, :, None] * c[:, None, :]
    factors = banded.Factors(banded.add_tangents(banded.mass_bands(chain), tangent))
    dw = plain_jump(chain, motion, dv).dw
    for _ in range(JUMP_PASSES):
        dw = factors.solve(mass_times(chain, dw))
    w = motion.w + dw
    across = c[:, 0] * along_elements(w)[:, 1] - c[:, 1] * along_elements(w)[:, 0]
    turning = across**2 / length
    force = applied_force(chain, command, trolley_v)
    force -= chain.crane.damping.air * mass_times(chain, w)
    tension = axial_force(chain.crane.chain.EA, chain.L0, length)
    for _ in range(JUMP_PASSES):
        pull = (tension + stiffness * turning)[:, None] * c
        rate = np.einsum("ij,ij->i", c, along_elements(factors.solve(force - assemble_force(pull))))
        tension = tension + stiffness * (rate + turning)
    return Jump(Motion(motion.r, w, motion.tension), dw, tension)


def settled(chain: DiscreteChain, motion: Motion, tension: Array) -> Motion:
    """``motion`` with the elements at the lengths of ``tension``, N, (n,).

    Directions stay, and each element's w_perp is scaled by l_old/l_new: its angular momentum stays.
    """
    d, dw = along_elements(motion.r), along_elements(motion.w)
    length = np.hypot(d[:, 0], d[:, 1])
    c = d / length[:, None]
    new = chain.L0 * (1.0 + tension / chain.crane.chain.EA)
    along = np.einsum("ij,ij->i", c, dw)[:, None] * c
    moved = np.cumsum(c * (new - length)[:, None], axis=0)
    turned = np.cumsum(along + (dw - along) * (length / new)[:, None], axis=0)
    return Motion(motion.r + moved, turned, tension)

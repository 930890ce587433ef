"""A tick of a coupling by itself, as what it exchanged."""

from __future__ import annotations

from cosim.base.columns import TickRow
from cosim.base.frames import Array
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.ticks import ServoCommands
from cosim.soft.body.loads import Loads


def one_tick(coupling: Coupling, position: Array, torque: Array, loads: Loads) -> TickRow:
    """Advance by one tick.

    Args:
        coupling: advanced.
        position: (joints,) [rad], that the servos hold.
        torque: (joints,) [N m], feedforward.
        loads: on the soft body at the end of the tick.
    """
    servos = ServoCommands.without_payload(position[None], 0.0 * position[None], torque[None])
    taken = coupling.advance(servos, [loads])
    assert taken.done == 1
    return taken.last()

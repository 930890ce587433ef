"""One tick of the staggered exchange."""

from cosim.coupling.schemes.algorithmic_mass import CarriedInertia
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.ticks import ServoCommand, TickLog
from cosim.soft.body.loads import Loads


def tick(
    interface: Interface, carried: CarriedInertia, servos: ServoCommand, loads: Loads, log: TickLog
) -> None:
    """Take a tick: the arm steps under the last loads, then the soft robot with the flange's new pose.

    Args:
        interface: between arm and soft robot.
        carried: inertia on the arm's joints.
        servos: commands.
        loads: on the soft robot at the end of the tick, without contacts.
        log: its next row is filled.

    Raises:
        InstabilityError: the arm's state is no longer finite.
        ConvergenceError: the soft step has no solution.
    """
    begin_tick(interface, carried)
    interface.step_rigid(servos, log)  # MuJoCo
    end_tick(interface, loads, log)


def begin_tick(interface: Interface, carried: CarriedInertia) -> None:
    """Load the arm for its step, which follows here or in another loop."""
    interface.load_flange(interface.wrench)  # contacts of the last tick act on bodies already
    carried.compensate(interface.scene)


def end_tick(interface: Interface, loads: Loads, log: TickLog) -> None:
    """Take the soft step after the rigid one, and transfer its wrench to the next tick."""
    reply = interface.advance_soft(loads)  # finds contacts, steps the soft robot, loads bodies
    interface.transfer_loads(reply, log)

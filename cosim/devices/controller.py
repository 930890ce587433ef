"""What a controller sees, commands and is; its commands are checked and held between its samples.

A controller is a frozen description; what it remembers is a state that goes in and comes out, so that a run
can be saved and continued. It is asked at a fixed rate; its last command holds in between.

Controllers that come with cosim close one loop with a law from an error to an output: on cables, from a
measured quantity, or on the flange's motion, which leads the tip along a path.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, final

from cosim.base.frames import Array, Pose, Shown, Wrench

State = TypeVar("State")


@final
@dataclass(frozen=True)
class Measurement(Shown):
    """What is measured of a run between two ticks, without noise: by controllers, by `Simulation.measure`.

    Args:
        time_s: simulated time.
        setpoint: of the phase for the controller that looks, in the unit of the controlled value; None:
            nothing, or nobody does.
        tip_wanted: (3,) [m], world, where the phase's tip path or tip target has the tip now; free components
            are not numbers; None: nowhere, or no controller looks.
        tip_position: (3,) [m], world.
        tip_direction: (3,), unit normal of the tip ring, world.
        tip_twist: (6,) [m/s, rad/s], linear then angular, of the tip ring's centre, world axes; how fast the
            ring turns about its own normal is part of it.
        bending_angle_rad: between the tip's direction and the flange's z axis.
        pressure_Pa: gauge pressure of each chamber.
        volume_m3: of each chamber.
        gas_kg: sealed in each chamber; None where its pressure is given.
        cable_tension_N: at the base end of each cable, by its name.
        cable_length_m: of each cable's route, by its name.
        cable_unstretched_m: commanded length of each cable, by its name; while its tension is commanded, the
            length by which it would be the same.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s].
        joint_torque: (joints,) [N m], that the servos gave in the last tick; at rest, their holding torque.
        flange: world_from_flange.
        flange_twist: (6,) [m/s, rad/s], linear then angular, of the flange's origin, world axes.
        flange_wrench: that soft robot and palm exert on the flange, about the flange's origin, world axes.
        contact_force_N: (3,) [N] of the soft robot on each rigid body in the last tick, world axes, by the
            body's name; the floor is part of "world".
        body_pose: world from each rigid body, by its name.
        limits: what does not go as commanded, in words: joints and speeds that a command asked for beyond
            their bounds, torques that servos cannot exceed, gas whose command a phase has ended; empty where
            all follow.
        sensors: readings (n,) of the scenario's sensors, by name; see `Simulation.measure`.
    """

    time_s: float
    setpoint: float | None
    tip_position: Array
    tip_direction: Array
    tip_twist: Array
    bending_angle_rad: float
    pressure_Pa: tuple[float, ...]
    volume_m3: tuple[float, ...]
    gas_kg: tuple[float | None, ...]
    cable_tension_N: Mapping[str, float]
    cable_length_m: Mapping[str, float]
    cable_unstretched_m: Mapping[str, float]
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    flange: Pose
    flange_twist: Array
    flange_wrench: Wrench
    contact_force_N: Mapping[str, Array]
    body_pose: Mapping[str, Pose]
    limits: tuple[str, ...] = ()
    sensors: Mapping[str, Array] = field(default_factory=dict)
    tip_wanted: Array | None = None


@final
@dataclass(frozen=True)
class Command:
    """What a controller or `Simulation.step` asks for; a run makes a complete `RobotCommand` of it.

    What it leaves out, a controller leaves to the plan. `Simulation.step` leaves it as it was commanded last,
    and to the plan where it never was; of `flange`, `flange_twist` and `joint_position` it takes one at most,
    and a flange whose twist is commanded no more stands. The last five keys are of `Simulation.step` alone.

    Args:
        cable_tension_N: by cable name.
        cable_length_m: unstretched length, by cable name; not for a cable whose tension is commanded.
        pump_pressure_Pa: setpoint, by pump name.
        flange_twist: (6,) [m/s, rad/s], linear then angular, world axes: how the flange's reference moves
            besides the plan, about its origin; None: it moves as planned, from where it has been moved to.
        pressure_Pa: gauge, by chamber name; not where gas is sealed, nor beyond the tick in which it will be.
        gas_kg: amount of gas, by name of a chamber in which it is sealed and no pump works; what comes in
            has its temperature.
        flange: world_from_flange; the joints go there evenly, on the branch they are on.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s] of the joints as they arrive at `joint_position`, along a cubic from
            their present speed, where no bound is in the way; None: they go there evenly.
    """

    cable_tension_N: Mapping[str, float] = field(default_factory=dict)
    cable_length_m: Mapping[str, float] = field(default_factory=dict)
    pump_pressure_Pa: Mapping[str, float] = field(default_factory=dict)
    flange_twist: Sequence[float] | Array | None = None
    pressure_Pa: Mapping[str, float] = field(default_factory=dict)
    gas_kg: Mapping[str, float] = field(default_factory=dict)
    flange: Pose | None = None
    joint_position: Sequence[float] | Array | None = None
    joint_velocity: Sequence[float] | Array | None = None


class Controller(ABC, Generic[State]):
    """Decides what devices do. Subclasses are frozen; their state is a frozen dataclass, number or tuple."""

    @abstractmethod
    def start(self, seen: Measurement) -> State:
        """Return the state in which a phase begins that uses this controller after one that did not.

        Args:
            seen: the measurement then.
        """

    @abstractmethod
    def act(self, state: State, seen: Measurement) -> tuple[State, Command]:
        """Return the state afterwards and the command that holds for the next period.

        Args:
            state: of the call before, or `start`.
            seen: the measurement now.
        """


AnyController = Controller[Any]

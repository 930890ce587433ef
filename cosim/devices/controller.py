"""What a controller sees, commands and is.

A controller is a frozen description; what it remembers is a state that goes in and comes out, so that a run
can be saved and continued. It is asked at a fixed rate; its last command holds in between.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, Generic, TypeVar, final

from cosim.base.frames import Array, Pose, Wrench

State = TypeVar("State")
NOTHING: Final[Mapping[str, float]] = MappingProxyType({})


@final
@dataclass(frozen=True)
class Measurement:
    """What a controller sees: the run at the start of a tick, without noise.

    Args:
        time_s: simulated time.
        setpoint: what the phase asks of this controller, in the unit of what it controls; None: nothing.
        tip_position: (3,) [m], world.
        tip_direction: (3,), unit normal of the tip ring, world.
        bending_angle_rad: between the tip's direction and the flange's z axis.
        pressure_Pa: gauge pressure of each chamber.
        volume_m3: of each chamber.
        cable_tension_N: at the base end of each cable, by its name.
        cable_length_m: of each cable's route, by its name.
        cable_unstretched_m: commanded length of each cable, by its name; while its tension is commanded, the
            length by which it would be the same.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s].
        joint_torque: (joints,) [N m], that the servos gave in the last tick; zero before the first.
        flange: world_from_flange.
        flange_wrench: that the soft robot exerts on the flange, about the flange's origin, world axes.
        contact_force_N: (3,) [N] of the soft robot on each rigid body in the last tick, world axes, by the
            body's name; the floor is part of "world".
    """

    time_s: float
    setpoint: float | None
    tip_position: Array
    tip_direction: Array
    bending_angle_rad: float
    pressure_Pa: tuple[float, ...]
    volume_m3: tuple[float, ...]
    cable_tension_N: Mapping[str, float]
    cable_length_m: Mapping[str, float]
    cable_unstretched_m: Mapping[str, float]
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    flange: Pose
    flange_wrench: Wrench
    contact_force_N: Mapping[str, Array]


@final
@dataclass(frozen=True)
class Command:
    """What a controller asks for until it is asked again; what it leaves out goes as planned.

    A run makes the complete `RobotCommand` of each tick from it and the plan.

    Args:
        cable_tension_N: by cable name.
        cable_length_m: unstretched length, by cable name; not for a cable whose tension is commanded.
        pump_pressure_Pa: setpoint, by pump name.
        flange_twist: (6,) [m/s, rad/s], linear then angular, world axes: how the flange's reference moves
            besides the plan, about its origin; None: it moves as planned, from where it has been moved to.
    """

    cable_tension_N: Mapping[str, float] = field(default_factory=lambda: NOTHING)
    cable_length_m: Mapping[str, float] = field(default_factory=lambda: NOTHING)
    pump_pressure_Pa: Mapping[str, float] = field(default_factory=lambda: NOTHING)
    flange_twist: tuple[float, ...] | None = None


class Controller(ABC, Generic[State]):
    """Decides what devices do. Subclasses are frozen; their state is a frozen dataclass, number or tuple."""

    @abstractmethod
    def start(self, seen: Measurement) -> State:
        """Return the state in which a phase begins that uses this controller after one that did not."""

    @abstractmethod
    def act(self, state: State, seen: Measurement) -> tuple[State, Command]:
        """Return the state afterwards and the command that holds for the next period."""


AnyController = Controller[Any]

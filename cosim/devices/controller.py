"""Base class of controllers, with the measurement that they receive and the command that they return. A
controller is a frozen description; its state goes in and comes out of every call, so that a run can be saved
and continued. It is called at a fixed rate, and its last command holds in between.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, final
from warnings import warn

from cosim.base.frames import Array, Pose, Shown, Wrench

State = TypeVar("State")


@dataclass(frozen=True, kw_only=True)
class RobotState:
    """State of the robot without the soft side, between two ticks; `Measurement` describes its fields."""

    time_s: float
    flange: Pose
    flange_twist: Array
    flange_wrench: Wrench
    flange_jacobian: Array
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    contact_force_N: Mapping[str, Array]
    body_pose: Mapping[str, Pose]

    @property
    def wrench(self) -> Wrench:
        """Former name of `flange_wrench`."""
        warn("RobotState.wrench: is RobotState.flange_wrench now", DeprecationWarning, stacklevel=2)
        return self.flange_wrench

    @property
    def contact_force(self) -> Mapping[str, Array]:
        """Former name of `contact_force_N`."""
        warn("RobotState.contact_force: is RobotState.contact_force_N now", DeprecationWarning, stacklevel=2)
        return self.contact_force_N


@final
@dataclass(frozen=True, kw_only=True)
class Measurement(Shown, RobotState):
    """What is measured of a run between two ticks, without noise: by controllers, by `Simulation.measure`.

    Args:
        time_s: simulated time.
        setpoint: of the phase for this controller, in the unit of the controlled value; None: no setpoint, or
            no controller measures.
        tip_wanted: (3,) [m], world, present target of the tip by the phase's tip path or target; free
            components are NaN; None: no target, or no controller measures.
        tip_position: (3,) [m], world.
        tip_direction: (3,), unit normal of the tip ring, world.
        tip_twist: (6,) [m/s, rad/s], linear then angular, of the tip ring about its centre, world axes, the
            rotation about its normal included.
        bending_angle_rad: between the tip's direction and the flange's z axis.
        pressure_Pa: gauge pressure of each chamber.
        volume_m3: of each chamber.
        gas_kg: sealed gas in each chamber; None: its pressure is given.
        cable_tension_N: at the base end of each cable, by its name.
        cable_length_m: of each cable's route, by its name.
        cable_unstretched_m: commanded length of each cable, by its name; if its tension is commanded, the
            length that would give this tension.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s].
        joint_torque: (joints,) [N m], of the servos in the last tick; at rest, their holding torque.
        flange: world_from_flange.
        flange_twist: (6,) [m/s, rad/s], linear then angular, of the flange's origin, world axes.
        flange_wrench: of soft robot and palm on the flange, about the flange's origin, world axes.
        flange_jacobian: (6, joints), from joint speeds to the twist of the flange's origin, world axes.
        contact_force_N: (3,) [N] of the soft robot on each rigid body in the last tick, world axes, by the
            body's name; the floor is part of "world".
        body_pose: world from each rigid body, by its name.
        limits: text on commands that are not followed: joints and speeds beyond their limits, servos at
            their torque limit, gas whose command a phase has ended; empty if all are followed.
        sensors: readings (n,) of the scenario's sensors, by name; see `Simulation.measure`.
    """

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
    limits: tuple[str, ...] = ()
    sensors: Mapping[str, Array] = field(default_factory=dict)
    tip_wanted: Array | None = None


@final
@dataclass(frozen=True)
class Command:
    """Command of a controller or of `Simulation.step`; a run completes it to a `RobotCommand`.

    Values that a controller omits follow the plan. Values that `Simulation.step` omits keep their last
    commanded value, or follow the plan if none was commanded. At most one of `flange`, `flange_twist` and
    `joint_position` is allowed; if the twist is omitted in a later step, the flange stops. Only
    `Simulation.step` accepts the last five keys.

    Args:
        cable_tension_N: by cable name.
        cable_length_m: unstretched length, by cable name; not for a cable whose tension is commanded.
        pump_pressure_Pa: setpoint, by pump name.
        flange_twist: (6,) [m/s, rad/s], linear then angular, world axes: motion of the flange's reference in
            addition to the plan, about its origin; None: no further motion.
        pressure_Pa: gauge, by chamber name; not for a chamber that is sealed, or will be within the step.
        gas_kg: amount of gas, by name of a sealed chamber without an active pump; added gas has the gas's
            temperature.
        flange: world_from_flange; the joints move there at constant speed, on their present branch.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s], speed of the joints on arrival at `joint_position`, along a cubic
            from their present speed, if no limit prevents it; None: they move at constant speed.
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
    """Base class of controllers. Subclasses are frozen; a state is a frozen dataclass, number or tuple."""

    @abstractmethod
    def start(self, seen: Measurement) -> State:
        """Return the state at the start of a phase that uses this controller, after a phase that did not.

        Args:
            seen: measurement at that time.
        """

    @abstractmethod
    def act(self, state: State, seen: Measurement) -> tuple[State, Command]:
        """Return the next state, and the command that holds for the next period.

        Args:
            state: of the previous call, or of `start`.
            seen: present measurement.
        """


AnyController = Controller[Any]

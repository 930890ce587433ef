"""Schema of a scenario file: frozen, SI units in the names of the keys, world frame, z up.

A rigid target is a pose of the flange. `direction` is the flange's z axis, out of the flange. At
`roll_rad = 0` the flange is turned the shortest way from hanging straight down with its x axis along the
world's x axis; pointing straight up it is turned half a turn about the world's y axis instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final, Literal, final

from cosim.scenario.constraints import (
    Bounds,
    Colour,
    Count,
    Direction,
    Length,
    Name,
    NonNegative,
    Positive,
    Pressure,
    Quaternion,
    Text,
    Vector3,
)
from cosim.scenario.soft_robot import SoftRobot

NO_ARM: Final = "none"
Tensions = tuple[NonNegative, ...]


@final
@dataclass(frozen=True)
class Clock:
    """The lockstep clock: rigid and soft side advance by one tick at a time."""

    tick_s: Annotated[float, Bounds(above=0.0, at_most=0.1)] = 0.002


@final
@dataclass(frozen=True)
class Solver:
    """How the soft side is solved.

    Args:
        residual_tolerance_N: largest force component left at an equilibrium or a converged step.
        newton_iterations_max: bound for an equilibrium (quasistatic mode and the start).
        dynamic_tolerance_N: largest force component left in a tick of the dynamic mode.
        dynamic_newton_iterations: new tangents per tick in the dynamic mode, besides iterations with a
            kept one; a tick that is left far from balance takes more.
        integrator: of the dynamic mode.
        damping_per_s: mass-proportional damping, force = -damping_per_s * m * v.
    """

    residual_tolerance_N: Positive = 1e-6
    newton_iterations_max: Count = 100
    dynamic_tolerance_N: Positive = 1e-4
    dynamic_newton_iterations: Count = 1
    integrator: Literal["implicit_euler", "bdf2"] = "implicit_euler"
    damping_per_s: NonNegative = 0.0


@final
@dataclass(frozen=True)
class Contact:
    """Contact of the soft robot with floor and objects, in the dynamic mode.

    Args:
        enabled: whether it is modelled.
        stiffness_N_m3: pressure per depth.
        smoothing_m: width of the transition; contact begins at half of it before touching.
        stick_m: tangential distance at which the full friction acts.
    """

    enabled: bool = True
    stiffness_N_m3: Positive = 3e8
    smoothing_m: Positive = 1e-4
    stick_m: Positive = 1e-4


@final
@dataclass(frozen=True)
class ChamberModel:
    """Switches for comparison with the published open-chamber data.

    Args:
        closed: the end holes carry pressure (caps); otherwise the films only.
        all_hinges: every interior edge carries a hinge; otherwise the published subset.
        calibrated: film and hinges as in the soft robot's `[calibration]`; otherwise as in its file.
    """

    closed: bool = True
    all_hinges: bool = True
    calibrated: bool = False


@final
@dataclass(frozen=True)
class Gas:
    """The gas in the chamber, wherever a phase seals it.

    Args:
        exponent: gamma of p V^gamma, from 1 (slow, isothermal) to 1.4 (fast, adiabatic air).
        ambient_Pa: absolute pressure outside.
        temperature_K: of the gas when it is sealed; only a leak depends on it.
    """

    exponent: Annotated[float, Bounds(at_least=1.0, at_most=2.0)] = 1.4
    ambient_Pa: NonNegative = 101325.0
    temperature_K: Positive = 293.15


@final
@dataclass(frozen=True)
class Recording:
    """How often the recording holds the scene, in simulated time; curves have a point per tick."""

    frames_per_s: Positive = 60.0


@final
@dataclass(frozen=True)
class FlangePose:
    """Absolute pose of the flange: origin, z axis, roll about it (see the module's text)."""

    position_m: Vector3
    direction: Direction
    roll_rad: float = 0.0


@final
@dataclass(frozen=True)
class FlangeTurn:
    """Right-handed rotation about the flange's origin, world axis, from where the phase starts."""

    axis: Direction
    angle_rad: float


@final
@dataclass(frozen=True)
class TipTarget:
    """Where the soft tip should be at the end of a phase: `position_m`, or only its height.

    Args:
        position_m: of the centre of the last hole ring, world.
        direction: unit normal of the last hole ring, away from the base, world.
        height_m: world z of the tip; only with reach_with = "cables".
        reach_with: "flange": the flange goes where the deformed tip meets the target;
            "cables": the flange stays, tensions are found;
            "none": the flange goes where the undeformed tip would meet it (to see the error).
    """

    position_m: Vector3 | None = None
    direction: Direction | None = None
    height_m: float | None = None
    reach_with: Literal["flange", "cables", "none"] = "flange"


@final
@dataclass(frozen=True)
class Start:
    """State before the first tick; an empty list of tensions means none."""

    flange: FlangePose
    pressure_Pa: Pressure = 0.0
    cable_tension_N: Tensions = ()


@final
@dataclass(frozen=True)
class SceneObject:
    """A rigid body of the scene.

    Args:
        size_m: box: three edge lengths; sphere: radius; cylinder, capsule: radius and length.
        position_m: of its centre, world.
        quaternion: (w, x, y, z), world from object; normalised on use.
        mass_kg: omitted = fixed to the world.
        friction: coefficient of sliding.
    """

    name: Name
    shape: Literal["box", "sphere", "cylinder", "capsule"]
    size_m: Annotated[tuple[Positive, ...], Length(at_least=1, at_most=3)]
    position_m: Vector3
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    mass_kg: Positive | None = None
    rgba: Colour = (0.55, 0.57, 0.60, 1.0)
    friction: NonNegative = 0.8


@final
@dataclass(frozen=True)
class Support:
    """Nodes held in the world; only without an arm.

    Args:
        rings: such as "unit_1.outer".
        corners: of these rings, 0 to sides - 1; omitted: all nodes of the rings.
        axes: world axes along which they are held, where they are when the phase starts.
    """

    rings: Annotated[tuple[str, ...], Length(at_least=1)]
    corners: tuple[int, ...] | None = None
    axes: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz"


@final
@dataclass(frozen=True)
class Force:
    """A dead load on nodes, at the end of the ramp.

    Args:
        rings: such as "unit_5.outer".
        corners: of these rings, 0 to sides - 1; omitted: all nodes of the rings.
        total_N: shared evenly by the nodes, world axes.
    """

    rings: Annotated[tuple[str, ...], Length(at_least=1)]
    total_N: Vector3
    corners: tuple[int, ...] | None = None


@final
@dataclass(frozen=True)
class Phase:
    """One stretch of the run; what is omitted stays as it is.

    Args:
        duration_s: of the ramp.
        settle_s: held afterwards, at the end values.
        increments: of the ramp, in the quasistatic mode.
        ramp: "smooth" is the minimum-jerk quintic.
        gas: "prescribed": the pressure is given; "sealed": what is in the chamber when the phase starts stays
            in it, and its pressure follows from the volume. Prescribed until a phase seals it.
        leak_kg_s_Pa: mass that a sealed gas loses per second and pascal of gauge pressure.
        pressure_Pa: gauge pressure at the end of the ramp.
        cable_tension_N: at the base end of each cable, at the end of the ramp.
        flange: absolute pose at the end of the ramp.
        flange_turn: relative rotation; may be combined with `flange_shift_m`.
        flange_shift_m: relative displacement, world axes.
        release: rings let go when the phase starts, before anything else is held.
        clamp: rings held rigidly to the flange from here on, as they are when the phase starts.
        supports: `[[phase.support]]` in the file; held from here on, besides what is held already.
        forces: `[[phase.force]]` in the file; together they replace the forces of earlier phases.
        tip_target: where the tip should end up.
    """

    name: Name
    duration_s: Positive
    settle_s: NonNegative = 0.0
    increments: Count = 100
    ramp: Literal["smooth", "linear", "step"] = "smooth"
    gas: Literal["prescribed", "sealed"] | None = None
    leak_kg_s_Pa: NonNegative | None = None
    pressure_Pa: Pressure | None = None
    cable_tension_N: Tensions | None = None
    flange: FlangePose | None = None
    flange_turn: FlangeTurn | None = None
    flange_shift_m: Vector3 | None = None
    release: tuple[str, ...] = ()
    clamp: tuple[str, ...] = ()
    supports: tuple[Support, ...] = field(default=(), metadata={"key": "support"})
    forces: tuple[Force, ...] = field(default=(), metadata={"key": "force"})
    tip_target: TipTarget | None = None


@final
@dataclass(frozen=True)
class Scenario:
    """Everything a run depends on.

    Args:
        name: of the scenario; the file's name if omitted.
        robot: rigid arm: a directory of robots/, or an arm of example-robot-data; "none": the base is
            held where the flange starts, and nothing of an arm is loaded.
        soft_robot: in the file a name, a path, or a table `{file = NAME, ...}` of changes to that file.
        payload_compensation: the arm's feedforward knows the soft arm's weight.
        objects: `[[object]]` in the file.
        phases: `[[phase]]` in the file.
    """

    schema: Literal[1]
    name: Name
    title: Text
    robot: str
    soft_robot: SoftRobot
    start: Start
    phases: Annotated[tuple[Phase, ...], Length(at_least=1)] = field(metadata={"key": "phase"})
    mode: Literal["dynamic", "quasistatic"] = "dynamic"
    gravity_m_s2: Vector3 = (0.0, 0.0, -9.81)
    payload_compensation: bool = True
    clock: Clock = Clock()
    solver: Solver = Solver()
    contact: Contact = Contact()
    chamber: ChamberModel = ChamberModel()
    gas: Gas = Gas()
    recording: Recording = Recording()
    objects: tuple[SceneObject, ...] = field(default=(), metadata={"key": "object"})

"""Describes what does not change during a run: names, sizes, shapes, what is modelled."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias, final

from cosim.base.frames import Array, IntArray, Shown
from cosim.base.solid import BodyShape
from cosim.devices.device_report import DeviceNames, SensorNames
from cosim.plan.decision import Decision
from cosim.telemetry.camera_image import CameraInfo

if TYPE_CHECKING:
    from cosim.plan.arm_limits import PlannedArm
    from cosim.plan.tip_errors import TipPathInfo
    from cosim.soft.beams.beam_rings import StiffenerStrain
    from cosim.telemetry.energy import EnergyParts

Decay: TypeAlias = Callable[[float, float], tuple[float, float]]
"""Natural frequency [Hz] and twice the decay [1/s] of its materials -> decay [1/s] by all losses, and the
numerical decay that ticks add.
"""


@final
@dataclass(frozen=True)
class DrawnFilm:
    """The film on a coarser mesh of some of its nodes, for faster pictures.

    Args:
        nodes: (k,), indices of the film's nodes.
        triangles: (m, 3), indices into `nodes`.
        cables: indices into `nodes` of each cable, base to tip.
        stress: positions of these nodes (k, 3) [m] -> largest principal stress (m,) [Pa].
    """

    nodes: IntArray
    triangles: IntArray
    cables: tuple[IntArray, ...]
    stress: Callable[[Array], Array]


@final
@dataclass(frozen=True)
class ObjectInfo:
    """A movable object.

    Args:
        name: of the object.
        body: its index in `RunInfo.body_names`.
        figures: (10,) mass [kg], centre (3,) [m] in the body's frame, inertia xx, yy, zz, xy, xz, yz [kg m^2]
            about that, body axes.
        free: whether it hangs on no joint, so that a soft robot can hold it.
    """

    name: str
    body: int
    figures: tuple[float, ...]
    free: bool = True


@dataclass(frozen=True, repr=False)
class RunInfo(Shown):
    """Description of a run that does not change during it.

    Args:
        scenario: name of the scenario.
        title: one line for people.
        mode: "dynamic" or "quasistatic".
        tick_s: length of a tick [s].
        duration_s: simulated time of the whole run [s].
        ticks: number of ticks of the whole run.
        phase_names: in order.
        joint_names: of the arm, base to flange.
        body_names: rigid bodies, in the order of `Snapshot.body_position`; objects by their names.
        shapes: of the rigid bodies, for drawing.
        soft_triangles: (m, 3) node indices of the film, outward orientation.
        cables: node indices of each cable, base to tip.
        chamber_names: of the gas chambers.
        soft_weight_N: weight of the soft robot [N].
        gravity: (3,) [m/s^2], world.
        membrane_stress: node positions (n, 3) [m] -> largest principal stress (m,) [Pa].
        cable_names: in the order of `cables`.
        devices: names of pumps, winches and controllers; None without any.
        report: Markdown lines on the model (masses, counts, switches).
        modelled: effects that are modelled or left out, and why.
        hinge_energy_share: node positions (n, 3) [m] -> share of the hinges in the elastic energy.
        stiffener_strain: node positions (n, 3) [m] -> strain and strength of the stiffeners, None without.
        section_model: error and size of the section model; None if the film itself is modelled.
        expected_error: of each figure of the soft robot: low, high, reference, source; None: not measured.
        arm: requirements of the plan on the arm; None without an arm.
        tip_paths: of the tip, by the index of their phase.
        decay: of natural modes; None in statics.
        energy: masses, cables and steps for the energy balance; None for runs without a balance.
        soft_mass_kg: mass of the soft robot.
        mounted: other bodies fixed to the flange: (10,) mass [kg], centre (3,) [m] in the flange frame,
            inertia xx, yy, zz, xy, xz, yz [kg m^2] about that; () for none.
        objects: movable objects; () in statics, where they are fixed.
        grasps: whether the soft robot has a palm or several films.
        sliding: (joints,), whether a joint slides.
        tip_measured_by: how the tip's direction is measured, in words; empty: unknown.
        tip_directions: (3,) of tip targets, by the index of their phase.
        stored_m: length of the soft robot laid flat [m]; None if it is not a single stack of units.
        frames_length: node positions (n, 3) [m] -> length [m] of its stacked frames; None if frames do not
            rest on one another.
        sensors: names, units and values of the sensors.
        cameras: their names, sizes and rates.
        drawn: coarser mesh of the film for recordings; None: the whole film is drawn.
        lengths_s: durations that ticks should divide [s].
        rounded: warnings of phases that are rounded to whole ticks.
    """

    scenario: str
    title: str
    mode: str
    tick_s: float
    duration_s: float
    ticks: int
    phase_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    body_names: tuple[str, ...]
    shapes: tuple[BodyShape, ...]
    soft_triangles: IntArray
    cables: tuple[IntArray, ...]
    chamber_names: tuple[str, ...]
    soft_weight_N: float
    gravity: Array
    membrane_stress: Callable[[Array], Array]
    report: str
    cable_names: tuple[str, ...] = ()
    devices: DeviceNames | None = None
    modelled: tuple[Decision, ...] = ()
    hinge_energy_share: Callable[[Array], float] | None = None
    stiffener_strain: Callable[[Array], StiffenerStrain | None] | None = None
    section_model: dict[str, Any] | None = None
    expected_error: dict[str, dict[str, Any] | None] = field(default_factory=dict)
    arm: PlannedArm | None = None
    tip_paths: Mapping[int, TipPathInfo] = field(default_factory=dict)
    decay: Decay | None = None
    energy: EnergyParts | None = None
    soft_mass_kg: float = 0.0
    mounted: tuple[float, ...] = ()
    objects: tuple[ObjectInfo, ...] = ()
    grasps: bool = False
    sliding: tuple[bool, ...] = ()
    tip_measured_by: str = ""
    tip_directions: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    stored_m: float | None = None
    frames_length: Callable[[Array], float] | None = None
    sensors: tuple[SensorNames, ...] = ()
    cameras: tuple[CameraInfo, ...] = ()
    drawn: DrawnFilm | None = None
    lengths_s: tuple[float, ...] = ()
    rounded: tuple[str, ...] = ()

    @property
    def names_along(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the entries along the axes of columns."""
        readings = (
            ".".join(filter(None, (each.name, value))) for each in self.sensors for value in each.values
        )
        return {
            "joints": self.joint_names, "bodies": self.body_names, "chambers": self.chamber_names,
            "cables": self.cable_names, "readings": tuple(readings),
        }  # fmt: skip

    def __repr__(self) -> str:
        """Return two lines: scenario and phases, and sizes."""
        return (
            f"Run of {self.scenario}, {self.mode}: {self.ticks} ticks of {self.tick_s:g} s in the phases "
            f"{', '.join(self.phase_names)}\n"
            f"{len(self.joint_names)} joints, bodies {', '.join(self.body_names) or 'none'}, "
            f"{len(self.soft_triangles)} triangles of film, {len(self.cables)} cables"
        )

"""What a run shows of itself: one frozen description of the stage, one snapshot per tick.

The film's shape is read when somebody asks for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray, Pose, Shown, Twist, Wrench, read_only
from cosim.base.solid import BodyShape
from cosim.coupling.schemes.ledger import LedgerEntry, ShapeFigures, TickPieces
from cosim.devices.device_report import ActuationReport, DeviceNames, SensorNames
from cosim.plan.decision import Decision

if TYPE_CHECKING:
    from cosim.base.solid import LinkContact
    from cosim.coupling.soft_sides.shape_reader import ShapeReader
    from cosim.plan.arm_limits import PlannedArm
    from cosim.plan.tip_errors import TipPathInfo
    from cosim.soft.beams.beam_rings import StiffenerStrain
    from cosim.soft.solve.branching import Branching, FilmOverlap, Footing
    from cosim.telemetry.energy import EnergyParts


@final
@dataclass(frozen=True)
class CameraInfo:
    """A camera, for whoever shows its pictures.

    Args:
        name: of it.
        size: (2,) width and height in pixels.
        fov_rad: from the lower to the upper edge.
        rate_Hz: pictures per second.
    """

    name: str
    size: tuple[int, int]
    fov_rad: float
    rate_Hz: float

    @property
    def focal_length(self) -> float:
        """In pixels."""
        return 0.5 * self.size[1] / math.tan(0.5 * self.fov_rad)


@final
@dataclass(frozen=True, eq=False)
class CameraImage(Shown):
    """What a camera sees.

    Args:
        camera: its name.
        rgb: (height, width, 3), from the upper left corner.
        depth_m: (height, width), along the camera's line of sight; infinite where nothing is.
        segments: (height, width), 0: nothing, 1: film, 2 + k: body k of `RunInfo.body_names`.
        position: (3,) [m] of the camera, world.
        rotation: (3, 3), world from camera: x to the right, y up, z against the line of sight.
    """

    camera: str
    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    segments: NDArray[np.int16]
    position: Annotated[Array, (3,)]
    rotation: Annotated[Array, (3, 3)]


@final
@dataclass(frozen=True, eq=False)
class FilmShape(Shown):
    """The film at the end of one tick.

    Args:
        node_position: (nodes, 3) [m], world.
        chamber_volume_m3: (chambers,).
        tip_position: (3,) [m], mean of the last hole ring.
        tip_direction: (3,), unit normal of the last hole ring, away from the base.
        center_line_m: length of the polyline through the centres of the hole rings.
    """

    node_position: Annotated[Array, ("film", 3)]
    chamber_volume_m3: Annotated[Array, ("chambers",)]
    tip_position: Annotated[Array, (3,)]
    tip_direction: Annotated[Array, (3,)]
    center_line_m: float
    _reader: ClassVar[None] = None

    @property
    def _shape(self) -> FilmShape:
        """Itself: there is nothing to read."""
        return self

    def read(self) -> FilmShape:
        """Return itself."""
        return self


@final
class UnreadFilmShape:
    """The same, each value read off the soft side's shape when it is asked for, and kept.

    Args:
        reader: of the shape.
        shape: as its reader needs it; nothing that happens later changes it.
    """

    def __init__(self, reader: ShapeReader, shape: Any) -> None:
        self._reader, self._shape = reader, shape

    @cached_property
    def node_position(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(read_only(self._reader.positions(self._shape)))

    @property
    def chamber_volume_m3(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(self._figures.volumes_m3[0])

    @property
    def tip_position(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(self._figures.tip_position[0])

    @property
    def tip_direction(self) -> Array:
        """See `FilmShape`."""
        return np.asarray(self._figures.tip_direction[0])

    @property
    def center_line_m(self) -> float:
        """See `FilmShape`."""
        return float(self._figures.center_line_m[0])

    @cached_property
    def _figures(self) -> ShapeFigures:
        return self._reader.figures([self._shape])

    def read(self) -> FilmShape:
        """Return all values, without what reads them."""
        return FilmShape(
            self.node_position, self.chamber_volume_m3, self.tip_position, self.tip_direction,
            self.center_line_m,
        )  # fmt: skip

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what is pickled: the values."""
        return FilmShape, tuple(vars(self.read()).values())


Decay: TypeAlias = Callable[[float, float], tuple[float, float]]
"""Natural frequency [Hz], and twice the decay [1/s] by its materials -> decay [1/s] that all losses ask for,
and what ticks add to it."""
Film: TypeAlias = FilmShape | UnreadFilmShape
"""The film at the end of one tick."""


@final
class FilmShapes:
    """The film at the ends of k ticks; read all together, which costs a fraction of one by one.

    Args:
        reader: of the shapes; None where these are read already.
        shapes: k, as the reader needs them, or `FilmShape`.
        figures: of the shapes; None where they are still to be read.
    """

    def __init__(
        self, reader: ShapeReader | None, shapes: Sequence[Any], figures: ShapeFigures | None = None
    ) -> None:
        self._reader, self._shapes, self._figures = reader, shapes, figures

    @classmethod
    def of(cls, films: Sequence[Film]) -> FilmShapes:
        """Return some shapes as one, at least one."""
        readers = {film._reader for film in films}
        if len(readers) > 1:  # of several runs
            return cls(None, [film.read() for film in films])
        return cls(readers.pop(), [film._shape for film in films])

    @classmethod
    def joined(cls, parts: Sequence[FilmShapes]) -> FilmShapes:
        """Return the shapes of some parts of one run, at least one part, in order."""
        shapes, reader = list(chain.from_iterable(part._shapes for part in parts)), parts[0]._reader
        if reader is not None and all(part._figures is None for part in parts):
            return cls(reader, shapes)
        columns = [vars(part.figures).values() for part in parts]
        figures = ShapeFigures(*map(np.concatenate, zip(*columns, strict=True)))
        return cls(reader, shapes, figures)

    def __getitem__(self, row: int) -> Film:
        shape = self._shapes[row]
        return shape if self._reader is None else UnreadFilmShape(self._reader, shape)

    @property
    def figures(self) -> ShapeFigures:
        """Figures of all shapes."""
        if self._figures is None:
            self._figures = self._read()
        return self._figures

    @property
    def tip_position(self) -> Array:
        """Tips (k, 3) [m] of all shapes; of shapes that are still to be read nothing else is read."""
        if self._figures is None and self._reader is not None:
            return self._reader.tips(self._shapes)
        return self.figures.tip_position

    def some(self, rows: IntArray) -> FilmShapes:
        """Return some of the shapes, by their places."""
        return FilmShapes(self._reader, [self._shapes[k] for k in rows.tolist()], self.figures.some(rows))

    def node_position(self, rows: slice = slice(None)) -> Array:
        """Return the film's nodes (k, nodes, 3) [m] at some of the ticks."""
        shapes = self._shapes[rows]
        if self._reader is None:
            return np.stack([shape.node_position for shape in shapes])
        return self._reader.films(shapes)

    def moments(self) -> Array:
        """Return the moments (k, m, 3) [kg^1/2 m] of all shapes; m = 0: none are known."""
        if self._reader is None:
            return np.zeros((len(self._shapes), 0, 3))
        return self._reader.moments(self._shapes)

    def _read(self) -> ShapeFigures:
        if self._reader is not None:
            return self._reader.figures(self._shapes)
        columns = ("tip_position", "tip_direction", "center_line_m", "chamber_volume_m3")
        return ShapeFigures(*(np.stack([getattr(shape, name) for shape in self._shapes]) for name in columns))


__all__ = ["BodyShape", "LedgerEntry", "RunInfo", "Snapshot"]


@final
@dataclass(frozen=True)
class DrawnFilm:
    """The film on a coarser mesh, whose nodes are among its own: pictures of it cost less.

    Args:
        nodes: (k,) of the film.
        triangles: (m, 3) places in `nodes`.
        cables: places in `nodes` of each cable, base to tip.
        stress: positions of these nodes (k, 3) [m] -> largest principal stress (m,) [Pa].
    """

    nodes: IntArray
    triangles: IntArray
    cables: tuple[IntArray, ...]
    stress: Callable[[Array], Array]


@final
@dataclass(frozen=True)
class ObjectInfo:
    """An object that can move.

    Args:
        name: of it.
        body: its place in `RunInfo.body_names`.
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
    """Everything about a run that does not change while it runs.

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
        shapes: what is drawn of the rigid bodies.
        soft_triangles: (m, 3) node indices of the film, outward orientation.
        cables: node indices of each cable, base to tip.
        chamber_names: of the gas chambers.
        soft_weight_N: weight of the soft robot [N].
        gravity: (3,) [m/s^2], world.
        membrane_stress: node positions (n, 3) [m] -> largest principal stress (m,) [Pa].
        cable_names: in the order of `cables`.
        devices: what of pumps, winches and controllers there is to show; None without any.
        report: Markdown lines on what is modelled (masses, counts, switches).
        modelled: what is modelled or left out, and why.
        hinge_energy_share: node positions (n, 3) [m] -> share of the hinges in the elastic energy.
        stiffener_strain: node positions (n, 3) [m] -> strain and strength of the stiffeners, None without.
        section_model: error and size of the section model; None where the film itself is modelled.
        expected_error: of each figure of the soft robot: low, high, against what, source; None: not measured.
        arm: what the plan asks of the arm; None without one.
        tip_paths: that the tip follows, by the index of their phase.
        decay: of natural modes; None in statics.
        energy: masses, cables and steps for the energy balance; None for runs that have no balance.
        soft_mass_kg: mass of the soft robot.
        mounted: what else is fixed to the flange: (10,) mass [kg], centre (3,) [m] in the flange frame,
            inertia xx, yy, zz, xy, xz, yz [kg m^2] about that; () for nothing.
        objects: that can move; () in statics, where they stand still.
        grasps: whether the soft robot has a palm or several films.
        sliding: (joints,), whether a joint slides.
        tip_measured_by: by what the tip's direction is measured, in words; empty: unknown.
        tip_directions: (3,) that tip targets ask for, by the index of their phase.
        stored_m: length of the soft robot laid flat [m]; None where it is no single stack of units.
        frames_length: node positions (n, 3) [m] -> length [m] of its frames, which rest on one another;
            None where they do not.
        sensors: names, units and values of the sensors.
        cameras: their names, sizes and rates.
        drawn: what recordings draw of the film; None: all of it.
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
        """Return two lines: what run it is of, and its parts."""
        return (
            f"Run of {self.scenario}, {self.mode}: {self.ticks} ticks of {self.tick_s:g} s in the phases "
            f"{', '.join(self.phase_names)}\n"
            f"{len(self.joint_names)} joints, bodies {', '.join(self.body_names) or 'none'}, "
            f"{len(self.soft_triangles)} triangles of film, {len(self.cables)} cables"
        )


@final
@dataclass(frozen=True)
class RunErrors:
    """How far the figures at the ends of phases may be off; docs/run_error.md.

    Args:
        phases: by the phase's index: each figure's bar, None if it has no bar, what it is made of, and
            the `reason` why.
        reason: why phases are left out; None where none is.
        iterations: on the refined mesh.
        wall_s: that it took.
    """

    phases: dict[int, dict[str, Any]] = field(default_factory=dict)
    reason: str | None = None
    iterations: int = 0
    wall_s: float = 0.0


@final
@dataclass(frozen=True, repr=False, eq=False)
class Snapshot(Shown):
    """State at the end of one tick; nobody can write to its arrays.

    Args:
        tick: count from 1; 0 is the state before the first tick.
        time_s: tick times tick length [s].
        phase: index into `RunInfo.phase_names`.
        joint_position: (joints,) [rad].
        joint_velocity: (joints,) [rad/s]; in statics the mean one over the increment.
        joint_torque: (joints,) [N m], that the servos gave in the tick, or hold with at rest.
        joint_target: (joints,) [rad], what the controller was asked for.
        body_position: (bodies, 3) [m], world.
        body_quaternion: (bodies, 4), (w, x, y, z), world from body.
        body_contact_force: (bodies, 3) [N], of the soft robot on each body, mean over the tick, world axes.
        film: where it is, and what follows from that; read when asked for.
        world_from_flange: pose of the flange.
        flange_twist: of the flange origin, world axes.
        soft_center: (3,) [m], centre of mass of the soft robot, world.
        soft_inertia: (3, 3) [kg m^2], of the soft robot about that, world axes.
        chamber_pressure_Pa: (chambers,), gauge, in the order of `RunInfo.chamber_names`; of a sealed gas at
            its present volume.
        cable_tension_N: (cables,) at the base end.
        tip_target: (3,) [m] or None.
        ledger: what the interface exchanged.
        tick_wall_s: wall time of this tick [s].
        devices: what pumps, winches and controllers do; None in a scenario without.
        link_contacts: of the arm's links, at ticks at which they are looked at; see `Parts.looks_at_links`.
        branchings: unstable states that the soft robot has met in the tick, or is in.
        overlaps: of its films, at ticks at which it is looked for.
        footing: how firmly the soft robot stands, at the end of a phase; None where it is not known.
        sensor_reading: (readings,), of `RunInfo.sensors` one after the other.
        sensor_truth: (readings,), what they would read without noise, bias, delay, hold and steps.
        images: of the cameras whose next picture is due at this tick.
        pieces: of the tick, where it was taken in pieces.
        mounted_load: (6,), force [N] and torque [N m] on the flange of what is fixed next to the soft robot,
            such as a palm, at its origin, world axes: weight, inertia and contacts, mean over the tick.
        body_touch: (bodies, 3), what touches each body, see `TickBatch`.
    """

    tick: int
    time_s: float
    phase: int
    joint_position: Annotated[Array, ("joints",)]
    joint_velocity: Annotated[Array, ("joints",)]
    joint_torque: Annotated[Array, ("joints",)]
    joint_target: Annotated[Array, ("joints",)]
    body_position: Annotated[Array, ("bodies", 3)]
    body_quaternion: Annotated[Array, ("bodies", 4)]
    body_contact_force: Annotated[Array, ("bodies", 3)]
    film: Film
    world_from_flange: Pose
    flange_twist: Twist
    soft_center: Annotated[Array, (3,)]
    soft_inertia: Annotated[Array, (3, 3)]
    chamber_pressure_Pa: Annotated[Array, ("chambers",)]
    cable_tension_N: Annotated[Array, ("cables",)]
    tip_target: Annotated[Array, (3,)] | None
    ledger: LedgerEntry
    tick_wall_s: float
    devices: ActuationReport | None = None
    link_contacts: tuple[LinkContact, ...] = ()
    branchings: tuple[Branching, ...] = ()
    overlaps: tuple[FilmOverlap, ...] = ()
    footing: Footing | None = None
    sensor_reading: Annotated[Array, ("readings",)] = field(default_factory=lambda: np.zeros(0))
    sensor_truth: Annotated[Array, ("readings",)] = field(default_factory=lambda: np.zeros(0))
    images: tuple[CameraImage, ...] = ()
    pieces: TickPieces | None = None
    mounted_load: Annotated[Array, (6,)] = field(default_factory=lambda: np.zeros(6))
    body_touch: Annotated[Array, ("bodies", 3)] = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def flange_wrench(self) -> Wrench:
        """What all that hangs on the flange exerts on it, at its origin, world axes.

        That is the soft robot's wrench, `ledger.wrench`, and `mounted_load`.
        """
        wrench, load = self.ledger.wrench, self.mounted_load
        return Wrench(wrench.force + load[:3], wrench.torque + load[3:])

    @property
    def node_position(self) -> Array:
        """(nodes, 3) [m], world."""
        return self.film.node_position

    @property
    def pressure_Pa(self) -> float:
        """Gauge pressure in the first chamber."""
        return float(self.chamber_pressure_Pa[0])

    @property
    def chamber_volume_m3(self) -> Array:
        """(chambers,), inside the film, hole rings closed by flat fans."""
        return self.film.chamber_volume_m3

    @property
    def volume_m3(self) -> float:
        """Of all chambers."""
        return float(sum(self.chamber_volume_m3.tolist()))

    @property
    def tip_position(self) -> Array:
        """(3,) [m], mean of the last hole ring."""
        return self.film.tip_position

    @property
    def tip_direction(self) -> Array:
        """(3,), unit normal of the last hole ring, away from the base."""
        return self.film.tip_direction

    @property
    def sag_m(self) -> float:
        """Distance of the tip from where a straight arm along the flange's axis would have it.

        That arm is rigid, and as long as this one is at present.
        """
        flange = self.world_from_flange
        away = self.tip_position - flange.translation - self.film.center_line_m * flange.rotation[:, 2]
        return float(np.sqrt((away * away).sum()))

    def kept(self) -> Snapshot:
        """Return the same with all that is shown of the film read, without pictures: what is saved."""
        return replace(self, film=self.film.read(), images=())

    def __repr__(self) -> str:
        """Return two lines: when, and what is there then."""
        tip = ", ".join(f"{1e3 * value:.1f}" for value in self.tip_position)
        pressures = ", ".join(f"{1e-3 * value:g}" for value in self.chamber_pressure_Pa)
        return (
            f"Snapshot of tick {self.tick}, {self.time_s:g} s, phase {self.phase}: "
            f"{len(self.joint_position)} joints, {len(self.body_position)} bodies, "
            f"{len(self.node_position)} nodes\n"
            f"tip at ({tip}) mm, sag {1e3 * self.sag_m:.1f} mm, {pressures} kPa, "
            f"{self.ledger.contacts} contacts, residual {self.ledger.residual_N:.1e} N"
        )

"""What a run shows of itself: one frozen description of the stage, one snapshot per tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Annotated, Any

from cosim.base.body_shape import BodyShape
from cosim.base.frames import Array, IntArray, Pose, Twist
from cosim.base.frozen import quickly_made
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.devices.device_report import ActuationReport, DeviceNames
from cosim.plan.decision import Decision
from cosim.telemetry.film_shape import FilmShape
from cosim.telemetry.tick_columns import FROM_ROW, TickColumns

if TYPE_CHECKING:  # who only looks at snapshots needs no engine
    from cosim.base.link_contact import LinkContact
    from cosim.plan.arm_limits import PlannedArm

__all__ = ["BodyShape", "LedgerEntry", "RunInfo", "Snapshot"]

_FROM_FILM = (
    "node_position", "volume_m3", "chamber_volume_m3", "tip_position", "tip_direction", "sag_m",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class RunInfo:
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
        section_model: error and size of the section model; None where the film itself is modelled.
        arm: what the plan asks of the arm; None without one.
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
    section_model: dict[str, float] | None = None
    arm: PlannedArm | None = None

    def __repr__(self) -> str:
        """Return two lines: what run it is of, and its parts."""
        return (
            f"Run of {self.scenario}, {self.mode}: {self.ticks} ticks of {self.tick_s:g} s in the phases "
            f"{', '.join(self.phase_names)}\n"
            f"{len(self.joint_names)} joints, bodies {', '.join(self.body_names) or 'none'}, "
            f"{len(self.soft_triangles)} triangles of film, {len(self.cables)} cables"
        )


@quickly_made
@dataclass(frozen=True, repr=False)
class Snapshot:
    """State at the end of one tick; arrays are owned by the snapshot.

    In place of each value that the film's shape decides (`_FROM_FILM`) one `FilmShape` may be given, the same
    for all; they are then made of it when first asked for, and `kept_shape` holds it for a `Block` to read.
    Of a row of `TickColumns` nearly everything is made when first asked for, see `of_row`.

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
        body_contact_force: (bodies, 3) [N], of the soft robot on each body, world axes.
        node_position: (nodes, 3) [m], world.
        world_from_flange: pose of the flange.
        flange_twist: of the flange origin, world axes.
        pressure_Pa: gauge pressure in the first chamber, of a sealed gas at its present volume.
        volume_m3: inside the film of all chambers, hole rings closed by flat fans.
        chamber_pressure_Pa: (chambers,), gauge, in the order of `RunInfo.chamber_names`.
        chamber_volume_m3: (chambers,).
        cable_tension_N: (cables,) at the base end.
        tip_position: (3,) [m], mean of the last hole ring.
        tip_direction: (3,), unit normal of the last hole ring, away from the base.
        sag_m: distance of the tip from where the same arm, straight and rigid along the flange
            axis at its present length, would have it.
        tip_target: (3,) [m] or None.
        ledger: what the interface exchanged.
        tick_wall_s: wall time of this tick [s].
        devices: what pumps, winches and controllers do; None in a scenario without.
        link_contacts: of the arm's links, at ticks at which they are looked at; see `Parts.looks_at_links`.
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
    node_position: Annotated[Array, ("film", 3)]
    world_from_flange: Pose
    flange_twist: Twist
    pressure_Pa: float
    volume_m3: float
    chamber_pressure_Pa: Annotated[Array, ("chambers",)]
    chamber_volume_m3: Annotated[Array, ("chambers",)]
    cable_tension_N: Annotated[Array, ("cables",)]
    tip_position: Annotated[Array, (3,)]
    tip_direction: Annotated[Array, (3,)]
    sag_m: float
    tip_target: Annotated[Array, (3,)] | None
    ledger: LedgerEntry
    tick_wall_s: float
    devices: ActuationReport | None = None
    link_contacts: tuple[LinkContact, ...] = ()
    kept_shape: FilmShape | None = field(init=False, repr=False, compare=False)
    kept_row: tuple[TickColumns, int] | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        held = vars(self)
        film = held["node_position"]
        if type(film) is not FilmShape:
            held["kept_shape"] = None
            return
        held["kept_shape"] = film
        for name in _FROM_FILM:
            del held[name]

    @classmethod
    def of_row(cls, columns: TickColumns, row: int) -> Snapshot:
        """Return the snapshot of one row, in less than a microsecond."""
        snapshot = object.__new__(cls)
        held = vars(snapshot)
        held["tick"], held["time_s"] = columns.clock[row]
        held["phase"], held["kept_row"] = columns.phase, (columns, row)
        return snapshot

    def __getstate__(self) -> dict[str, Any]:
        """Return what is copied or pickled: all values, without the other rows and what reads them."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        return own | {"kept_shape": None}

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

    if not TYPE_CHECKING:  # where it would hide misspelt names

        def __getattr__(self, name: str) -> Any:
            held = vars(self)
            row = held.get("kept_row")
            if row is not None and name in FROM_ROW:
                value = FROM_ROW[name](*row)
            elif name in _FROM_FILM and (row or held.get("kept_shape")) is not None:
                value = getattr(self.kept_shape, name)
            else:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            held[name] = value
            return value

"""The columns of a run: one table that ticks, results, summary, files, recordings and documentation read."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cosim.base.column import Column, Columns, RunFigure, TableRow, View
from cosim.base.frames import Array, IntArray, Mask, Twist, Wrench, quaternions_from_rotations

_NONE: Final = np.zeros(0)
_COUNT: Final = np.int64(0)
_NO: Final = np.bool_(False)
_XYZ: Final = ("vermilion", "green", "sky")
_RECORDS: Final[dict[str, Callable[[Array], Any]]] = {
    "flange_twist": lambda row: Twist(row[:3], row[3:]),
    "wrench": lambda row: Wrench(row[:3], row[3:]),
    "tip_target": lambda row: None if np.isnan(row).all() else row,
}
"""How a single tick shows columns that are neither numbers nor plain arrays."""


def _sag_m(ticks: Any) -> Array:
    return np.asarray(ticks.film.figures.sag_m(ticks.flange_position, ticks.flange_rotation[:, :, 2]))


def _bending_angle_rad(ticks: Any) -> Array:
    axis, tip = ticks.flange_rotation[:, :, 2], ticks.tip_direction
    across = np.cross(axis, tip)
    return np.asarray(np.arctan2(np.sqrt((across * across).sum(axis=1)), (axis * tip).sum(axis=1)))


def _palm_contacts(ticks: Any) -> IntArray:
    return np.asarray(ticks.body_touch[:, :1, 1].sum(axis=1).astype(np.int64))


def _power_error(ticks: Any) -> Array:
    size = ticks.power_size_W
    moved = size > 0.0
    return np.where(moved, np.abs(ticks.power_error_W) / np.where(moved, size, 1.0), 0.0)


def _of_devices(ticks: Any, read: Callable[[Any], Array]) -> Array:
    """Return rows of what devices report; rows of length 0 in a scenario without devices."""
    return np.array([_NONE if report is None else read(report) for report in ticks.devices])


def _has_tip_target(ticks: Any) -> Mask:
    return np.asarray(~np.isnan(ticks.tip_target).all(axis=1))


def _target_distance_m(ticks: Any) -> Array:
    away = ticks.tip_position - ticks.tip_target
    away[np.isnan(away)] = 0.0
    return np.where(ticks.has_tip_target, np.sqrt((away * away).sum(axis=1)), np.nan)


class RunColumns(Columns):
    """The columns of a result, which files hold as well; world frame, SI units."""

    tick = Column("rows", "1", "count of ticks, 0 before the first one.", fill=_COUNT)
    time_s = Column("rows", "s", "simulated time.", RunFigure("end_s", "end", "simulated time [s]"))
    phase = Column("rows", "1", "index into `stage.phase_names`.", fill=_COUNT)
    joint_position = Column(
        "rows, joints", "rad", "of the arm; a joint that slides has metres.",
        RunFigure("joint_position_rad", "end", "list, arm joints [rad]"),
    )  # fmt: skip
    joint_velocity = Column("rows, joints", "rad/s", "in statics the mean one over the increment.")
    joint_torque = Column(
        "rows, joints", "N m", "that the servos gave in the tick; at rest, their holding torque.",
    )  # fmt: skip
    joint_target = Column("rows, joints", "rad", "targets of the servos.")
    body_position = Column("rows, bodies, 3", "m", "of the frames of the arm's links and the objects, world.")
    body_quaternion = Column("rows, bodies, 4", "1", "(w, x, y, z), world from body.")
    body_contact_force = Column(
        "rows, bodies, 3", "N", "of the soft robot's contacts on each body, world axes.",
    )  # fmt: skip
    flange_position = Column(
        "rows, 3", "m", "of its origin, world.",
        RunFigure("flange_position_m", "end", "origin of the flange [m]"),
    )  # fmt: skip
    flange_quaternion = Column(
        "rows, 4", "1", "(w, x, y, z), world from flange.",
        RunFigure("flange_quaternion", "end", "(w, x, y, z), world from flange"),
        read=lambda ticks: quaternions_from_rotations(ticks.flange_rotation),
    )  # fmt: skip
    flange_force = Column(
        "rows, 3", "N",
        "that all that hangs on the flange exerts on it, world axes: the soft robot, and weight, inertia "
        "and contacts of a palm, as a sensor between arm and flange shows.",
        read=lambda ticks: ticks.wrench[:, :3] + ticks.mounted_load[:, :3],
        view=View("Interface", 0, "flange_force", "Force on the flange, world [N]", colours=_XYZ),
    )  # fmt: skip
    flange_torque = Column(
        "rows, 3", "N m", "the same, about the flange's origin.",
        read=lambda ticks: ticks.wrench[:, 3:] + ticks.mounted_load[:, 3:],
        view=View("Interface", 1, "flange_torque", "Torque on the flange, world [N m]", colours=_XYZ),
    )  # fmt: skip
    soft_center = Column("rows, 3", "m", "centre of mass of the soft robot, world.")
    soft_inertia = Column("rows, 3, 3", "kg m^2", "of the soft robot about that, world axes.")
    tip_position = Column(
        "rows, 3", "m", "centre of the last hole ring.",
        RunFigure("tip_position_m", "end", "mean of the last hole ring [m]"),
        read=lambda ticks: ticks.film.figures.tip_position,
        view=View("Robot", 3, "tip_position", "Tip position, world [mm]", 1e3, colours=_XYZ),
    )  # fmt: skip
    tip_direction = Column(
        "rows, 3", "1", "its unit normal.",
        RunFigure(
            "tip_direction", "end",
            "unit vector away from the base: normal of the last hole ring, or of a flat tip as "
            "`tip_measured_by` says",
        ),
        read=lambda ticks: ticks.film.figures.tip_direction,
    )  # fmt: skip
    sag_m = Column(
        "rows", "m", "distance of the tip from where a straight arm along the flange's axis would have it.",
        RunFigure(
            "sag_m", "end",
            "distance of the tip from where a straight, rigid arm of the same length along the flange's z "
            "axis would have it [m]",
        ),
        read=_sag_m,
        view=View("Robot", 4, "sag", "Sag [mm]", 1e3, "sag", ("orange",)),
    )  # fmt: skip
    pressure_Pa = Column(
        "rows", "Pa", "gauge, in the first chamber; of a sealed gas at its present volume.",
        RunFigure(
            "pressure_Pa", "end",
            "gauge pressure in the chamber, whether given or that of a sealed gas; of several, in the first "
            "[Pa]",
        ),
        read=lambda ticks: ticks.chamber_pressure_Pa[:, 0],
    )  # fmt: skip
    volume_m3 = Column(
        "rows", "m^3", "of all chambers.",
        RunFigure(
            "volume_m3", "end",
            "volume of the chamber, holes closed by flat caps; of several, their sum [m^3]",
        ),
        read=lambda ticks: ticks.chamber_volume_m3.sum(axis=1),
    )  # fmt: skip
    chamber_pressure_Pa = Column(
        "rows, chambers", "Pa", "gauge.",
        view=View("Robot", 0, "pressure", "Pressure [kPa]", 1e-3, "gauge pressure", ("sky",)),
    )  # fmt: skip
    chamber_volume_m3 = Column(
        "rows, chambers", "m^3", "inside the film.",
        read=lambda ticks: ticks.film.figures.volumes_m3,
        view=View("Robot", 1, "volume", "Chamber volume [ml]", 1e6, "volume", ("green",)),
    )  # fmt: skip
    cable_tension_N = Column(
        "rows, cables", "N", "at the base end.",
        RunFigure("cable_tension_N", "end", "list, tension at the base end of each cable [N]"),
        view=View("Robot", 2, "tension", "Cable tension [N]", label="cable"),
    )  # fmt: skip
    cable_length_m = Column(
        "rows, cables", "m", "of the routes; (rows, 0) without devices or commanded lengths.",
        read=lambda ticks: _of_devices(ticks, lambda report: report.cable_length_m),
    )  # fmt: skip
    cable_unstretched_m = Column(
        "rows, cables", "m", "off the drum; not a number while the tension is commanded.",
        read=lambda ticks: _of_devices(ticks, lambda report: report.unstretched_m),
    )  # fmt: skip
    sensor_reading = Column("rows, readings", "1", "of all sensors, each in its unit; see `sensor`.")
    sensor_truth = Column("rows, readings", "1", "true values, at the same instants.")
    bending_angle_rad = Column(
        "rows", "rad", "between the tip's direction and the flange's z axis.",
        read=_bending_angle_rad,
    )  # fmt: skip
    residual_N = Column(
        "rows", "N", "largest force component that the soft step was left with.",
        RunFigure(
            "max_equilibrium_residual_N", "largest",
            "largest component of the residual force of the soft side after any tick [N]",
        ),
        view=View("Run", 0, "residual", "Out-of-balance force [log10 N]", 1.0, "residual", ("sky",),
            legend=False, peaks=True, log=True),
    )  # fmt: skip
    newton_iterations = Column(
        "rows", "1", "of the soft step.",
        RunFigure(
            "newton_iterations", "sum", "of the soft side, all ticks and the start equilibrium together"
        ),
        fill=_COUNT,
        view=View("Run", 1, "newton", "Newton iterations per tick", 1.0, "iterations", ("white",),
            legend=False, peaks=True),
    )  # fmt: skip
    power_error_W = Column(
        "rows", "W", "that appeared at the interface.",
        RunFigure(
            "max_interface_power_error_W", "largest",
            "largest power that appeared or vanished at the flange between the two sides [W]",
        ),
        read=lambda ticks: ticks.rigid_power_W + ticks.soft_power_W,
        view=View("Interface", 2, "power_error", "Power lost at the interface [W]", 1.0, "power error",
            ("pink",), legend=False),
    )  # fmt: skip
    stability_ratio = Column(
        "rows", "1", "of the coupling; stable below 1.",
        RunFigure(
            "max_stability_ratio", "largest",
            "largest eigenvalue of flange mobility times the soft side's algorithmic mass (four times that "
            "with BDF2); below 1 the staggered exchange is stable. The bound is sufficient, not necessary: "
            "it leaves out damping and servos, so a run slightly above 1 may be stable",
        ),
        view=View("Interface", 3, "stability", "Stability ratio of the coupling", 1.0, "mass ratio",
            ("orange",), legend=False),
    )  # fmt: skip
    contacts = Column(
        "rows", "1", "points of the film that press on something.",
        RunFigure(
            "contact_since_s", "since", "first time at which the film touched the scene; `null`: never"
        ),
        fill=_COUNT,
    )  # fmt: skip
    contact_force_N = Column(
        "rows", "N", "sum of the normal forces that acted on bodies, mean over the tick.",
        RunFigure(
            "max_contact_force_N", "largest",
            "largest sum of the normal forces between film and scene, mean over one tick of what acted on "
            "bodies. In a hit it depends on the tick: see `touched`",
        ),
    )  # fmt: skip
    contact_depth_m = Column(
        "rows", "m", "of the deepest point in the pressed body.",
        RunFigure(
            "max_contact_depth_m", "largest",
            "how deep the deepest point of the film has been in an obstacle",
        ),
    )  # fmt: skip
    palm_contacts = Column(
        "rows", "1", "of what is mounted on the flange with rigid bodies.",
        fill=_COUNT, read=_palm_contacts,
    )  # fmt: skip
    self_contacts = Column(
        "rows", "1", "points of the film that press on another film of the soft robot.",
        RunFigure(
            "self_contact_since_s", "since",
            "first time at which films of the soft robot press on one another; `null` where they never do, "
            "or contact between them is not modelled",
        ),
        fill=_COUNT,
    )  # fmt: skip
    self_contact_force_N = Column(
        "rows", "N", "sum of their normal forces.",
        RunFigure(
            "max_self_contact_force_N", "largest",
            "largest sum of the normal forces between films of the soft robot; 0 with `contact.self_contact "
            "= false`",
        ),
    )  # fmt: skip
    self_contact_depth_m = Column(
        "rows", "m", "of the deepest point behind another film.",
        RunFigure(
            "max_self_contact_depth_m", "largest",
            "how deep the deepest point of a film has been behind another film of the soft robot",
        ),
    )  # fmt: skip
    tick_wall_s = Column(
        "rows", "s", "wall time.",
        view=View("Run", 2, "tick_cost", "Cost of a tick [ms]", 1e3, "wall time", ("orange",), peaks=True),
    )  # fmt: skip
    energy_J = Column(
        "rows, energies", "J",
        "balance of energy since the start: put in by gas, cables, flange, gravity, bodies, lost in "
        "contact, at eyelets, by damping and the integrator, held; elastic energy and rest every 0.1 s, "
        "else not numbers. (rows, 0) where the run has no balance.",
    )  # fmt: skip


class TickColumns(RunColumns):
    """The columns of ticks while a run lasts: those of its result, and further ones that results leave out.

    In ticks `body_contact_force` is the mean over the tick; in a staggered tick it was found at the end of
    the one before.
    """

    flange_rotation = Column("rows, 3, 3", "1", "world from flange.")
    flange_twist = Column(
        "rows, 6", "m/s", "linear and angular [rad/s], of the flange's origin, world axes.",
    )  # fmt: skip
    wrench = Column(
        "rows, 6", "N", "force and torque [N m] of the soft robot on the flange, at its origin, world axes.",
    )  # fmt: skip
    mounted_load = Column(
        "rows, 6", "N",
        "force and torque [N m] on the flange of what is fixed next to the soft robot, such as a palm, at "
        "its origin, world axes: weight, inertia and contacts, mean over the tick.",
    )  # fmt: skip
    body_touch = Column(
        "rows, bodies, 3", "N",
        "what touches each body: sum of the soft robot's normal forces on it that acted in the tick; of an "
        "object also its contacts with what is mounted on flanges, to which other arms' soft robots count "
        "as one, and with other rigid bodies; of the world also all contacts of what is mounted on the own "
        "flange with rigid bodies.",
    )  # fmt: skip
    node_position = Column(
        "rows, nodes, 3", "m", "of the film, world.", read=lambda ticks: ticks.film.node_position()
    )
    center_line_m = Column(
        "rows", "m", "length of the polyline through the centres of the hole rings.",
        RunFigure(
            "length_m", "end",
            "length of the line through the centres of the rings, from the base to the tip [m]",
        ),
        read=lambda ticks: ticks.film.figures.center_line_m,
    )  # fmt: skip
    tip_target = Column(
        "rows, 3", "m", "world; NaN in free components, and without a target.", fill=np.float64(np.nan),
    )  # fmt: skip
    has_tip_target = Column("rows", "1", "whether there is one.", fill=_NO, read=_has_tip_target)
    target_distance_m = Column(
        "rows", "m",
        "of the tip from its target in the components that are not free; NaN without a target.",
        read=_target_distance_m,
        view=View("Robot", 5, "sag/target", "", 1e3, "tip to target", ("green",)),
    )  # fmt: skip
    joint_error = Column(
        "rows, joints", "rad", "position less target.",
        read=lambda ticks: ticks.joint_position - ticks.joint_target,
        view=View("Run", 3, "joint_error", "Joint error [mrad]", 1e3, "joint", numbered=True),
    )  # fmt: skip
    rigid_power_W = Column("rows", "W", "power of the wrench that the rigid side received.")
    soft_power_W = Column(
        "rows", "W", "power that the soft side took in by its answer of this tick, with the same twist.",
    )  # fmt: skip
    power_size_W = Column(
        "rows", "W", "product of the sizes of wrench and flange velocity: a power of this size is large.",
    )  # fmt: skip
    power_error = Column(
        "rows", "1", "`power_error_W` over `power_size_W`; 0 at rest.",
        RunFigure(
            "max_interface_power_error", "largest",
            "largest power that appeared or vanished at the flange, over the product of the sizes of wrench "
            "and velocity",
        ),
        read=_power_error,
    )  # fmt: skip
    momentum_error = Column(
        "rows", "1",
        "largest relative difference of what the rigid side received in the tick from what was handed over "
        "to it, in force and torque about the world's origin.",
        RunFigure(
            "max_momentum_error", "largest",
            "largest relative difference, in any tick, between the load sent and the load that the flange "
            "or the touched bodies received",
        ),
    )  # fmt: skip
    slides = Column(
        "rows", "1", "equilibria that only a damped slide led to, in statics and before the first tick.",
        RunFigure(
            "slides", "sum",
            "how many equilibria (the start's included) were reached by pseudo-transient continuation: "
            "Newton's method failed even with the load cut to 1/256, a damped body slid on from the end of "
            "the branch, and Newton's method converged there",
        ),
        fill=_COUNT,
    )  # fmt: skip
    algorithmic_mass = Column("rows", "1", "whether it was carried as armature in the tick.", fill=_NO)
    contact_ratio = Column(
        "rows", "1", "largest mass by which the film answers touched bodies within a tick, over theirs.",
        RunFigure(
            "max_contact_ratio", "largest",
            "largest effective mass of the film at a body that it touches, over the body's mass; above 2 "
            "the body [gives way within the film's step](contact.md)",
        ),
    )  # fmt: skip
    contact_work_J = Column("rows", "J", "of contacts with the scene on the film in the tick.")
    self_contact_work_J = Column("rows", "J", "of contacts between films on these.")
    eyelets_J = Column("rows", "J", "lost at eyelets of cables that know in which direction they slide.")
    bodies_work_J = Column("rows", "J", "of contacts with the film on bodies in the tick.")
    hit_m_s = Column(
        "rows", "m/s",
        "speed at which film and the body of `hit_body` came on to each other before the tick, of the "
        "contact that the tick resolves least; 0 without one.",
    )  # fmt: skip
    hit_way_m = Column("rows", "m", "way of that body in a step that would resolve it.")
    hit_body = Column("rows", "1", "index of the body; -1 for no hit.", fill=np.int64(-1))
    scheme = Column("rows", "1", "of the exchange in the tick.", fill=np.str_("staggered"))
    trials = Column(
        "rows", "1", "how often the tick was taken until the loads agreed; 1 in the staggered exchange.",
        fill=np.int64(1),
    )  # fmt: skip
    iterated_trials = Column(
        "rows", "1", "the same of ticks that were repeated until the loads agreed; 0 for the others.",
        RunFigure(
            "iterated_ticks", "count",
            "ticks that were repeated until the loads agreed; the others were staggered "
            "([coupling](coupling.md))",
        ),
        RunFigure("interface_trials", "sum", "how often these ticks were taken in all"),
        RunFigure("max_interface_trials", "largest", "how often the tick with most trials was taken"),
        fill=_COUNT, read=lambda ticks: np.where(ticks.scheme == "iterated", ticks.trials, 0),
    )  # fmt: skip
    interface_residual = Column(
        "rows", "1",
        "what the loads on flange and bodies that acted differ from those the soft side answered with in "
        "the same tick, over their size; 0 where no iteration was asked for.",
        RunFigure(
            "max_interface_residual", "largest",
            "in these ticks: largest difference between the loads that acted and the loads of the reaction, "
            "over their size",
        ),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class TickTable(TickColumns):
    """Ticks, one row each; its columns are attributes.

    Args:
        arrays: columns that are stored, by name.
    """

    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False, repr=False)
class TickRow(TableRow, TickColumns):
    """One tick: its columns are attributes, `wrench` a `Wrench`, `flange_twist` a `Twist`.

    `tip_target` is None without a target.

    Args:
        table: of this tick alone.
    """

    table: TickTable

    def value_of(self, column: Column) -> Any:
        """Return the value of a column in this tick."""
        record = _RECORDS.get(column.name)
        if record is None:
            return super().value_of(column)
        vars(self)[column.name] = shown = record(self.table.value_of(column)[0])
        return shown

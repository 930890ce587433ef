"""Measures a run: for controllers, and for `Simulation.measure`."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, TypedDict, final

import numpy as np

from cosim.base.frames import Array, Pose, cross, length, rotations_from_quaternions
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.devices.cable_drive import CableDrive
from cosim.devices.controller import Measurement, RobotState
from cosim.plan.chamber_gas import ChamberGas
from cosim.soft.elements.cable import stretch_at

_FLAT: Final = 1e-6
"""Determinant of the nodes' spread over its trace cubed (at most 1/27) below which they are in a line."""


@final
class BodyPoses(Mapping[str, Pose]):
    """Poses of rigid bodies, world from body, by name; a pose is computed on access.

    Args:
        names: (bodies,).
        positions: (bodies, 3) [m], world; must not be changed.
        quaternions: (bodies, 4), (w, x, y, z), world from body; must not be changed.
    """

    def __init__(self, names: tuple[str, ...], positions: Array, quaternions: Array) -> None:
        self._names, self._positions, self._quaternions = names, positions, quaternions

    def __getitem__(self, name: str) -> Pose:
        if name not in self._names:
            raise KeyError(f"there is no rigid body '{name}'; there are: {', '.join(self._names)}")
        k = self._names.index(name)
        (rotation,) = rotations_from_quaternions(self._quaternions[k : k + 1])
        return Pose(rotation, self._positions[k])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        """Return the representation of a dictionary of the poses."""
        return repr(dict(self))


@final
class CableFigures(TypedDict):
    """The fields of a measurement with values by cable."""

    cable_tension_N: dict[str, float]
    cable_length_m: dict[str, float]
    cable_unstretched_m: dict[str, float]


def measured(
    soft: SoftRobot,
    robot: RobotState,
    gas: ChamberGas,
    cables: CableFigures,
    *,
    setpoint: float | None = None,
    limits: tuple[str, ...] = (),
) -> Measurement:
    """Return the measurement of a run.

    Args:
        soft: soft side in its present state.
        robot: state of the rest of the robot at the same time.
        gas: in the chambers.
        cables: see `measured_cables`.
        setpoint: see `Measurement`.
        limits: see `Measurement`.
    """
    body, state = soft.body, soft.state
    contents = [gas.content(k) for k in range(len(soft.pressures_Pa))]
    direction = body.tip_direction(state.positions)
    return Measurement(
        **vars(robot),
        setpoint=setpoint,
        tip_position=body.tip_position(state.positions),
        tip_direction=direction,
        tip_twist=ring_twist(state.positions[body.tip], state.velocities[body.tip]),
        bending_angle_rad=bending_angle(direction, robot.flange),
        pressure_Pa=tuple(soft.pressures_Pa),
        volume_m3=tuple(soft.volumes_m3),
        gas_kg=tuple(None if content is None else content.mass_kg for content in contents),
        limits=limits,
        **cables,
    )


def measured_cables(
    names: Sequence[str], drives: Sequence[CableDrive], positions: Array, tension_N: Sequence[float] | None
) -> CableFigures:
    """Return the fields of a measurement with values by cable.

    Args:
        names: of the cables.
        drives: of the cables.
        positions: (n, 3) [m].
        tension_N: of each cable, if the drives are not active; None: that of the drives.
    """
    lengths = [drive.cable.length(positions) for drive in drives]
    if tension_N is None:
        tension_N = [drive.tension_N(positions) for drive in drives]
        unstretched = [drive.unstretched_m(positions) for drive in drives]
    else:
        rows = zip(drives, tension_N, lengths, strict=True)
        unstretched = [long - stretch_at(pull, drive.cable.stiffness_N_m) for drive, pull, long in rows]
    tension, length_m, free = (
        dict(zip(names, map(float, values), strict=True)) for values in (tension_N, lengths, unstretched)
    )
    return CableFigures(cable_tension_N=tension, cable_length_m=length_m, cable_unstretched_m=free)


def bending_angle(tip_direction: Array, flange: Pose) -> float:
    """Return the angle [rad] between the tip's direction (3,) and the flange's z axis."""
    axis = flange.rotation[:, 2]
    return float(np.arctan2(length(cross(axis, tip_direction)), axis @ tip_direction))


def ring_twist(positions: Array, velocities: Array) -> Array:
    """Return the twist (6,) [m/s, rad/s] about the centre of nodes that fits their velocities best.

    With r from the centre, v = V + w x r in least squares: sum (r.r 1 - r r^T) w = sum r x (v - V).

    Args:
        positions: (n, 3) [m].
        velocities: (n, 3) [m/s].
    """
    count = len(positions)
    linear = velocities.sum(axis=0) / count
    away, moving = positions - positions.sum(axis=0) / count, velocities - linear
    spread = float((away * away).sum()) * np.eye(3) - away.T @ away
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = (away.T @ moving).tolist()  # the sum of r v^T
    moment = np.array([yz - zy, zx - xz, xy - yx])
    if np.linalg.det(spread) > _FLAT * spread.trace() ** 3:
        return np.concatenate([linear, np.linalg.solve(spread, moment)])
    # nodes in a line do not determine the rotation about it
    return np.concatenate([linear, np.linalg.lstsq(spread, moment, rcond=1e-9)[0]])

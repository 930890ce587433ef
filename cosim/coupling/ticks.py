"""Input and output of ticks: the servos' commands, and the log with the columns that the exchange fills."""

from __future__ import annotations

from collections.abc import Mapping
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.column import room_for
from cosim.base.columns import TickColumns, TickRow, TickTable
from cosim.base.frames import Array, Wrench
from cosim.base.kernel_types import Blocks, Matrix
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.robots.soft_step import SoftReply
from cosim.coupling.shape_figures import SubstepRecord
from cosim.reduced.sections.figures import CENTER, FIGURES, INERTIA, WRENCH

if TYPE_CHECKING:
    from cosim.coupling.contact.contact_arrays import BodyLoads
    from cosim.rigid.scene.coupled_scene import CoupledScene
    from cosim.soft.solve.state import Equilibrium


_LINEAR_FIRST: Final = np.array([3, 4, 5, 0, 1, 2])


class ServoCommands(NamedTuple):
    """References and feedforward of the servos in n ticks.

    Args:
        position: (n, joints) [rad].
        velocity: (n, joints) [rad/s].
        torque: (n, joints) [N m], feedforward without payload.
        payload_regressor: (n, joints, 10), derivative of the feedforward by the payload's
            `inertial_parameters`; zero for a feedforward that ignores the payload.
    """

    position: Matrix
    velocity: Matrix
    torque: Matrix
    payload_regressor: Blocks

    @classmethod
    def without_payload(cls, position: Array, velocity: Array, torque: Array) -> ServoCommands:
        """Return commands (n, joints) whose feedforward does not depend on the payload."""
        return cls(position, velocity, torque, np.zeros((*position.shape, 10)))

    def row(self, k: int) -> ServoCommand:
        """Return the commands of tick k."""
        return ServoCommand(self.position[k], self.velocity[k], self.torque[k], self.payload_regressor[k])

    def part(self, first: int, end: int) -> ServoCommands:
        """Return the commands of the ticks from `first` up to, not including, `end`."""
        return ServoCommands._make(map(itemgetter(slice(first, end)), self))


class ServoCommand(NamedTuple):
    """References and feedforward of the servos in one tick, see `ServoCommands`.

    Args:
        position: (joints,) [rad].
        velocity: (joints,) [rad/s].
        torque: (joints,) [N m].
        payload_regressor: (joints, 10).
    """

    position: Array
    velocity: Array
    torque: Array
    payload_regressor: Array


def scene_columns(scene: CoupledScene) -> dict[str, Array]:
    """Return the scene's state by column of the log: views of MuJoCo's arrays, which stay in memory."""
    joints, speeds, torques = scene.joint_rows
    positions, quaternions = scene.place_rows
    return {
        "joint_position": joints,
        "joint_velocity": speeds,
        "joint_torque": torques,
        "flange_position": scene.flange.origin,
        "flange_rotation": scene.flange.axes,
        "body_position": positions,
        "body_quaternion": quaternions,
        "mounted_load": scene.mounted,
    }


@final
class TickLog(TickColumns):
    """The ticks of one call: columns with a row for each, and the error that ended the call, if any.

    Args:
        arrays: allocated columns that the exchange fills, by name; see `room_for`.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]]) -> None:
        self.arrays = arrays
        vars(self).update(arrays)  # as attributes, which are faster than the table
        self.shapes: list[Any] = []
        """(done,) shapes of the film, each as `SoftRobot.current_shape` returns it."""
        self.substeps: dict[int, SubstepRecord] = {}
        """Records of the ticks with substeps, by row."""
        self.done = 0
        """Number of finished ticks; later rows are not filled yet."""
        self.error: BaseException | None = None
        """Error of the tick after the last finished one; None if it did not fail."""

    def log_scene(
        self, scene: CoupledScene, rows: Mapping[str, Array], bodies: BodyLoads, momentum_error: float
    ) -> None:
        """Fill the present tick's row with the scene's state after the rigid step.

        Args:
            scene: after the step.
            rows: its `scene_columns`.
            bodies: loads on bodies in the step.
            momentum_error: of the loads in the step.
        """
        k, spin = self.done, scene.flange.spin
        for name, value in rows.items():
            self.arrays[name][k] = value
        self.flange_twist[k] = spin[_LINEAR_FIRST]
        self.momentum_error[k], self.bodies_work_J[k] = momentum_error, scene.bodies.work_J
        if np.count_nonzero(bodies.loaded):
            loaded = np.flatnonzero(bodies.loaded)
            self.body_contact_force[k, loaded] = bodies.applied[loaded, :3]
            self.body_touch[k, loaded, 0] = bodies.normal_force[loaded]
        scene.read_touch(self.body_touch[k])

    def end_tick(self, reply: SoftReply, soft: SoftRobot, figures: Array) -> None:
        """Fill the present tick's row with the soft robot's reply, and continue with the next row.

        Args:
            reply: of the soft robot.
            soft: soft robot after its step.
            figures: (FIGURES,), its wrench on the flange, centre and inertia of its mass.
        """
        k, films = self.done, soft.touching
        self.wrench[k], self.soft_center[k] = figures[WRENCH:CENTER], figures[CENTER:INERTIA]
        self.soft_inertia[k] = figures[INERTIA:].reshape(3, 3)
        self.residual_N[k], self.newton_iterations[k] = reply.residual_N, reply.iterations
        self.self_contact_work_J[k], self.eyelets_J[k] = reply.films_work_J, reply.eyelets_J
        self.chamber_pressure_Pa[k] = soft.pressures_Pa
        if films is not None:
            self.self_contacts[k], self.self_contact_force_N[k] = films.count, films.normal_force_N
            self.self_contact_depth_m[k] = films.depth_m
        self.shapes.append(soft.current_shape())
        self.done += 1

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of the finished ticks, by name."""
        return {name: array[: self.done] for name, array in self.arrays.items()}

    def last(self) -> TickRow:
        """Return the last tick's row, without columns that are computed from the film's shape."""
        row = slice(self.done - 1, self.done)
        return TickRow(TickTable({name: array[row].copy() for name, array in self.arrays.items()}))


def sizes_of(joints: int, bodies: int, chambers: int) -> dict[str, int]:
    """Return the sizes of the columns that the exchange fills; those of the energy balance are empty here."""
    return {"joints": joints, "bodies": bodies, "chambers": chambers, "energies": 0}


def rest_columns(equilibrium: Equilibrium, sizes: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    """Return the columns (1, ...) of the exchange, by name, at rest in an equilibrium of the soft robot."""
    arrays, wrench = room_for(TickColumns, sizes)(1), equilibrium.wrench
    arrays["wrench"][0, :3], arrays["wrench"][0, 3:] = wrench.force, wrench.torque
    arrays["residual_N"][0] = equilibrium.residual_N
    arrays["newton_iterations"][0], arrays["slides"][0] = equilibrium.iterations, equilibrium.slides
    return arrays


def figures_of(soft: SoftRobot, wrench: Wrench) -> Array:
    """Return a soft robot's figures (FIGURES,): wrench on the flange, centre and inertia of its mass."""
    figures = np.empty(FIGURES)
    fill_figures(soft, wrench, figures)
    return figures


def fill_figures(soft: SoftRobot, wrench: Wrench, figures: Array) -> None:
    """Fill a soft robot's figures (FIGURES,), see `figures_of`."""
    figures[WRENCH : WRENCH + 3], figures[WRENCH + 3 : CENTER] = wrench.force, wrench.torque
    soft.fill_mass(figures)

"""What ticks are asked for, and what they leave: the columns of the table that the exchange fills."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.column import room_for
from cosim.base.columns import TickColumns, TickRow, TickTable
from cosim.base.frames import Array, Wrench
from cosim.base.kernel_types import Blocks, Matrix
from cosim.coupling.robots.soft_robot import SoftReply, SoftRobot
from cosim.coupling.shape_figures import SubstepRecord
from cosim.reduced.sections.figures import CENTER, FIGURES, INERTIA, WRENCH

if TYPE_CHECKING:
    from cosim.coupling.contact.contact_arrays import BodyLoads
    from cosim.rigid.scene.coupled_scene import CoupledScene
    from cosim.soft.solve.state import Equilibrium


_LINEAR_FIRST: Final = np.array([3, 4, 5, 0, 1, 2])


class ServoCommands(NamedTuple):
    """What the servos are asked for in n ticks.

    Args:
        position: (n, joints) [rad].
        velocity: (n, joints) [rad/s].
        torque: (n, joints) [N m], feedforward without payload.
        payload_regressor: (n, joints, 10), its derivative by the payload's `inertial_parameters`; of none: zero.
    """

    position: Matrix
    velocity: Matrix
    torque: Matrix
    payload_regressor: Blocks

    @classmethod
    def without_payload(cls, position: Array, velocity: Array, torque: Array) -> ServoCommands:
        """Return (n, joints) each with a feedforward that is as it is, whatever hangs on the flange."""
        return cls(position, velocity, torque, np.zeros((*position.shape, 10)))

    def row(self, k: int) -> ServoCommand:
        """Return the commands of tick k."""
        return ServoCommand(self.position[k], self.velocity[k], self.torque[k], self.payload_regressor[k])

    def some(self, first: int, end: int) -> ServoCommands:
        """Return the commands of some of the ticks."""
        return ServoCommands._make(map(itemgetter(slice(first, end)), self))


class ServoCommand(NamedTuple):
    """What the servos are asked for in one tick, see `ServoCommands`.

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
    """Return where a scene is, by column: views of MuJoCo's arrays, which stay where they are in memory."""
    joints, speeds, torques = scene.joint_rows
    places, quaternions = scene.place_rows
    return {
        "joint_position": joints,
        "joint_velocity": speeds,
        "joint_torque": torques,
        "flange_position": scene.flange.origin,
        "flange_rotation": scene.flange.axes,
        "body_position": places,
        "body_quaternion": quaternions,
        "mounted_load": scene.mounted,
    }


@final
class TickLog(TickColumns):
    """How far both sides have come in one call, and what its ticks have left: columns with a row for each.

    Args:
        arrays: room for the columns that the exchange fills, by name; see `room_for`.
    """

    def __init__(self, arrays: dict[str, NDArray[Any]]) -> None:
        self.arrays = arrays
        vars(self).update(arrays)  # found at once, without a look at the table
        self.parts: list[Sequence[Any]] = []
        """Shapes of the film, each as `SoftRobot.current_shape` returns it, some ticks together."""
        self.pieces: dict[int, SubstepRecord] = {}
        """Of ticks that were taken in pieces, by their rows."""
        self.done = 0
        """How many ticks have been taken; rows beyond the last one hold nothing."""
        self.error: BaseException | None = None
        """What the next one has failed with, half done; None for nothing."""

    @property
    def shapes(self) -> Sequence[Any]:
        """(done,), of the film."""
        return self.parts[0] if len(self.parts) == 1 else list(chain.from_iterable(self.parts))

    def log_scene(
        self, scene: CoupledScene, rows: Mapping[str, Array], bodies: BodyLoads, momentum_error: float
    ) -> None:
        """Fill the row of the tick in progress with what its rigid step has led to.

        Args:
            scene: after the step.
            rows: its `scene_columns`.
            bodies: what has acted on them.
            momentum_error: of what has acted.
        """
        k, spin = self.done, scene.flange.spin
        for name, value in rows.items():
            self.arrays[name][k] = value
        self.flange_twist[k] = spin[_LINEAR_FIRST]
        self.momentum_error[k], self.bodies_work_J[k] = momentum_error, scene.bodies.work_J
        if np.count_nonzero(bodies.loaded):
            loaded = np.flatnonzero(bodies.loaded)
            self.body_contact_force[k, loaded] = bodies.applied[loaded, :3]
            self.body_touch[k, loaded, 0] = bodies.pressing[loaded]
        scene.read_touch(self.body_touch[k])

    def end_tick(self, reply: SoftReply, soft: SoftRobot, figures: Array) -> None:
        """Fill the row of the tick in progress with what the soft side has answered; the next one follows.

        Args:
            reply: of the soft side.
            soft: after its step.
            figures: (FIGURES,), wrench on the flange, centre and inertia of its mass.
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
        self.parts.append([soft.current_shape()])
        self.done += 1

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of the ticks that have been taken, by name."""
        return {name: array[: self.done] for name, array in self.arrays.items()}

    def last(self) -> TickRow:
        """Return the last tick, without what follows from the film's shape."""
        row = slice(self.done - 1, self.done)
        return TickRow(TickTable({name: array[row].copy() for name, array in self.arrays.items()}))


def sizes_of(joints: int, bodies: int, chambers: int) -> dict[str, int]:
    """Return the sizes of the columns that the exchange fills; there is no balance of energy yet."""
    return {"joints": joints, "bodies": bodies, "chambers": chambers, "energies": 0}


def rest_columns(found: Equilibrium, sizes: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    """Return the columns (1, ...) of the exchange at rest in an equilibrium of the soft side, by name."""
    arrays = room_for(TickColumns, sizes)(1)
    arrays["wrench"][0, :3], arrays["wrench"][0, 3:] = found.wrench.force, found.wrench.torque
    arrays["residual_N"][0], arrays["newton_iterations"][0] = found.residual_N, found.iterations
    arrays["slides"][0] = found.slides
    return arrays


def figures_of(soft: SoftRobot, wrench: Wrench) -> Array:
    """Return the figures (FIGURES,) of a soft side with its wrench on the flange."""
    figures = np.empty(FIGURES)
    fill_figures(soft, wrench, figures)
    return figures


def fill_figures(soft: SoftRobot, wrench: Wrench, figures: Array) -> None:
    """Fill the figures (FIGURES,) of a soft side with its wrench on the flange."""
    figures[WRENCH : WRENCH + 3], figures[WRENCH + 3 : CENTER] = wrench.force, wrench.torque
    soft.fill_mass(figures)

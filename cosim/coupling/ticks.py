"""What ticks are asked for and what they leave: arrays with a row for each tick, columns with the film."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Wrench
from cosim.base.kernel_types import Blocks, Matrix
from cosim.base.kernels import unchecked
from cosim.coupling.schemes.ledger import LedgerEntry, Scheme, TickPieces
from cosim.coupling.soft_sides.soft_side import SoftReply, SoftSide
from cosim.coupling.tick_rows import SceneRows, Ticks, log_rigid
from cosim.reduced.sections.assembly import CENTER, FIGURES, INERTIA, WRENCH

if TYPE_CHECKING:
    from cosim.coupling.contact.contact_arrays import BodyLoads
    from cosim.rigid.scene.coupled_scene import CoupledScene


class Servos(NamedTuple):
    """What the servos are asked for in n ticks.

    Args:
        position: (n, joints) [rad].
        velocity: (n, joints) [rad/s].
        torque: (n, joints) [N m], feedforward without payload.
        by_payload: (n, joints, 10), its derivative by the payload's `inertial_parameters`; of none: zero.
    """

    position: Matrix
    velocity: Matrix
    torque: Matrix
    by_payload: Blocks

    @classmethod
    def knowing_no_payload(cls, position: Array, velocity: Array, torque: Array) -> Servos:
        """Return (n, joints) each with a feedforward that is as it is, whatever hangs on the flange."""
        return cls(position, velocity, torque, np.zeros((*position.shape, 10)))

    def row(self, k: int) -> ServoRow:
        """Return the commands of tick k."""
        return ServoRow(self.position[k], self.velocity[k], self.torque[k], self.by_payload[k])

    def some(self, first: int, end: int) -> Servos:
        """Return the commands of some of the ticks."""
        return Servos._make(map(itemgetter(slice(first, end)), self))


class ServoRow(NamedTuple):
    """What the servos are asked for in one tick, see `Servos`.

    Args:
        position: (joints,) [rad].
        velocity: (joints,) [rad/s].
        torque: (joints,) [N m].
        by_payload: (joints, 10).
    """

    position: Array
    velocity: Array
    torque: Array
    by_payload: Array


@final
@dataclass
class TicksTaken:
    """How far both sides have come in one call, and what its ticks have left.

    Args:
        ticks: what they leave; rows beyond the last one hold nothing.
        pressure_Pa: (n, chambers), gauge.
        stability_ratio: (n,), see `LedgerEntry`, as for all that follow down to `interface_residual`.
        algorithmic_mass: (n,).
        trials: (n,).
        interface_residual: (n,).
        scheme: of the exchange.
        parts: shapes of the film, each as `SoftSide.shape_now` returns it, some ticks together.
        pieces: of ticks that were taken in pieces, by their rows.
        done: how many ticks have been taken.
        error: what the next one has failed with, half done; None for nothing.
    """

    ticks: Ticks
    pressure_Pa: Array
    stability_ratio: Array
    algorithmic_mass: Mask
    trials: IntArray
    interface_residual: Array
    scheme: Scheme = "staggered"
    parts: list[Sequence[Any]] = field(default_factory=list)
    pieces: dict[int, TickPieces] = field(default_factory=dict)
    done: int = 0
    error: BaseException | None = None

    @classmethod
    def room(cls, n: int, joints: int, bodies: int, chambers: int) -> TicksTaken:
        """Return room for n ticks."""
        return cls(
            Ticks.room(n, joints, bodies), np.zeros((n, chambers)), np.zeros(n), np.zeros(n, dtype=bool),
            np.ones(n, np.int64), np.zeros(n),
        )  # fmt: skip

    @property
    def shapes(self) -> Sequence[Any]:
        """(done,), of the film."""
        return self.parts[0] if len(self.parts) == 1 else list(chain.from_iterable(self.parts))

    @property
    def wrench(self) -> Array:
        """(done, 6), of the soft side on the flange, at its origin, world axes."""
        return self.ticks.figures[: self.done, WRENCH:CENTER]

    def log_scene(
        self, scene: CoupledScene, rows: SceneRows, bodies: BodyLoads, momentum_error: float
    ) -> None:
        """Fill the row of the tick in progress with what its rigid step has led to.

        Args:
            scene: after the step.
            rows: its own.
            bodies: what has acted on them.
            momentum_error: of what has acted, see `LedgerEntry`.
        """
        k, ticks = self.done, self.ticks
        unchecked(log_rigid)(k, rows, scene.flange.spin, ticks)
        ticks.momentum_error[k], ticks.work[k, 3] = momentum_error, scene.bodies.work_J
        if np.count_nonzero(bodies.loaded):
            loaded = np.flatnonzero(bodies.loaded)
            ticks.body_force[k, loaded] = bodies.applied[loaded, :3]
            ticks.touch[k, loaded, 0] = bodies.pressing[loaded]
        scene.read_touch(ticks.touch[k])

    def end_tick(self, reply: SoftReply, soft: SoftSide, figures: Array) -> None:
        """Fill the row of the tick in progress with what the soft side has answered; the next one follows.

        Args:
            reply: of the soft side.
            soft: after its step.
            figures: (FIGURES,), see `Ticks`.
        """
        k, ticks, films = self.done, self.ticks, soft.touching
        ticks.figures[k], ticks.residual[k], ticks.iterations[k] = figures, reply.residual_N, reply.iterations
        ticks.work[k, 1:3] = reply.films_work_J, reply.eyelets_J
        self.pressure_Pa[k] = soft.pressures_Pa
        if films is not None:
            ticks.self_contact[k] = films.count, films.normal_force_N, films.depth_m
        self.parts.append([soft.shape_now()])
        self.done += 1

    def last_entry(self) -> LedgerEntry:
        """Return what was exchanged in the last tick."""
        columns = {name: column.item(self.done - 1) for name, column in self.ledger().items()}
        figures = self.wrench[-1]
        return LedgerEntry(Wrench(figures[:3].copy(), figures[3:].copy()), **columns)

    def columns(self) -> dict[str, Any]:
        """Return the columns of `TickColumns` that ticks fill, (done, ...) each."""
        n, ticks = self.done, self.ticks
        figures = ticks.figures[:n]
        return {
            "joint_position": ticks.joints[:n],
            "joint_velocity": ticks.joint_speed[:n],
            "joint_torque": ticks.servo_torque[:n],
            "body_position": ticks.places[:n],
            "body_quaternion": ticks.quaternions[:n],
            "body_contact_force": ticks.body_force[:n],
            "flange_position": ticks.origin[:n],
            "flange_rotation": ticks.axes[:n],
            "flange_twist": ticks.twist[:n],
            "wrench": figures[:, WRENCH:CENTER],
            "soft_center": figures[:, CENTER:INERTIA],
            "soft_inertia": figures[:, INERTIA:].reshape(-1, 3, 3),
            "chamber_pressure_Pa": self.pressure_Pa[:n],
            "mounted_load": ticks.mounted[:n],
            "body_touch": ticks.touch[:n],
            **self.ledger(),
        }

    def ledger(self) -> dict[str, Any]:
        """Return the columns (done,) of `LedgerEntry`, without the wrench."""
        n, ticks = self.done, self.ticks
        return {
            "rigid_power_W": ticks.power[:n, 0],
            "soft_power_W": ticks.power[:n, 1],
            "power_size_W": ticks.power[:n, 2],
            "residual_N": ticks.residual[:n],
            "newton_iterations": ticks.iterations[:n],
            "momentum_error": ticks.momentum_error[:n],
            "contacts": ticks.contacts[:n],
            "contact_force_N": ticks.contact[:n, 0],
            "contact_depth_m": ticks.contact[:n, 1],
            "contact_ratio": ticks.contact[:n, 2],
            "stability_ratio": self.stability_ratio[:n],
            "algorithmic_mass": self.algorithmic_mass[:n],
            "self_contacts": ticks.self_contact[:n, 0].astype(np.int64),
            "self_contact_force_N": ticks.self_contact[:n, 1],
            "self_contact_depth_m": ticks.self_contact[:n, 2],
            "contact_work_J": ticks.work[:n, 0],
            "self_contact_work_J": ticks.work[:n, 1],
            "eyelets_J": ticks.work[:n, 2],
            "bodies_work_J": ticks.work[:n, 3],
            "hit_m_s": ticks.hit[:n, 0],
            "hit_way_m": ticks.hit[:n, 1],
            "hit_body": ticks.hit[:n, 2].astype(np.int64),
            "scheme": np.full(n, self.scheme),
            "trials": self.trials[:n],
            "interface_residual": self.interface_residual[:n],
            "slides": np.zeros(n, np.int64),
        }


def figures_of(soft: SoftSide, wrench: Wrench) -> Array:
    """Return the figures (FIGURES,) of a soft side with its wrench on the flange, see `Ticks`."""
    figures = np.empty(FIGURES)
    fill_figures(soft, wrench, figures)
    return figures


def fill_figures(soft: SoftSide, wrench: Wrench, figures: Array) -> None:
    """Fill the figures (FIGURES,) of a soft side with its wrench on the flange, see `Ticks`."""
    figures[WRENCH : WRENCH + 3], figures[WRENCH + 3 : CENTER] = wrench.force, wrench.torque
    soft.fill_mass(figures)

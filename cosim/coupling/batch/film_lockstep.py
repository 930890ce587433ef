"""Ticks of arm and lumped film in a row, in one kernel.

The kernel takes what most ticks are: given pressures and tensions, contact with bodies that are fixed or
free, and a soft step whose tangents are positive definite. All else is finished by `StaggeredCoupling`, as
any other tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import nothing_of
from cosim.coupling.batch.added_inertia import AddedInertiaRow
from cosim.coupling.batch.batch_arrays import Ticks
from cosim.coupling.batch.film_kernel import advance_film_ticks, row_calls
from cosim.coupling.batch.film_rows import FilmCommands, FilmMotion, FilmReach, FilmRow
from cosim.coupling.batch.lockstep import Servos
from cosim.coupling.batch.row_contact import RowContact, nothing_there
from cosim.coupling.batch.row_lockstep import RowLockstep, pose_of
from cosim.coupling.batch.tick_halves import SOFT_STEP_BEGUN, SOFT_STEP_LEFT
from cosim.coupling.contact.contact_exchange import AHEAD_TICKS
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.reduced.sections.outputs import CENTER, FIGURES, INERTIA, WRENCH
from cosim.rigid.distance.shape_bounds import SHAPE_BOUNDS
from cosim.rigid.scene.native import NativeScene
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import BegunStep, SoftState
from cosim.soft.solve.time_step import LARGE_TURN_RAD

_MOST = 64  # ticks in a row: fine meshes are large


@final
class FilmLockstep(RowLockstep):
    """Advances one coupling with a lumped film by many ticks at once.

    Args:
        coupling: staggered.
        native: its rigid side.
        soft: its soft side.
        mounted: (10,) `inertial_parameters` of a rigid mass on the flange, flange frame.
    """

    def __init__(
        self, coupling: StaggeredCoupling, native: NativeScene, soft: SoftArm, mounted: Array
    ) -> None:
        super().__init__(coupling, native, mounted, _MOST)
        self._soft, self._mass_kg = soft, soft.body.mass_kg
        self._contact = RowContact.of(coupling.interface)
        contact, tick_s = coupling.interface.contact, coupling.interface.scene.tick_s
        self._reach = FilmReach(
            nothing_of(SHAPE_BOUNDS) if contact is None else contact.query.bounds,
            0.0 if contact is None else contact.rest_reach_m, AHEAD_TICKS * tick_s,
        )  # fmt: skip

    @classmethod
    def of(cls, coupling: object, soft: object, mounted: Array) -> FilmLockstep | None:
        """Return what advances a coupling; None where that takes more than a kernel."""
        if not isinstance(coupling, StaggeredCoupling) or not isinstance(soft, SoftArm):
            return None
        native = coupling.interface.scene.native()
        if native is None or not soft.steps_alone or not soft.stepper.quick.sides.knows_body:
            return None
        return cls(coupling, native, soft, mounted)

    @property
    def ready(self) -> bool:
        contact = self.coupling.interface.contact
        knows_contact = contact is None or contact.idle or self._contact is not None
        return knows_contact and self._soft.stepper.quick.sides.knows_factor

    def commands(self, servos: Servos, loads: Sequence[Loads]) -> FilmCommands | None:
        if not all(load.plain for load in {id(load): load for load in loads}.values()):
            return None
        chambers = len(self._soft.body.gas_chambers)
        pressure = np.array([load.pressures(chambers) for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        gravity = np.array([load.gravity for load in loads])
        joints = servos.position, servos.velocity, servos.torque, servos.by_payload
        return FilmCommands(*joints, pressure, tension, gravity)

    @cached_property
    def _calls(self) -> IntArray:
        return row_calls()

    def _figures(self) -> Array:
        figures, wrench, mass = np.empty(FIGURES), self.coupling.wrench, self._soft.mass_properties()
        figures[WRENCH:CENTER] = *wrench.force, *wrench.torque
        figures[CENTER:INERTIA], figures[INERTIA:] = mass.center, mass.inertia.ravel()
        return figures

    def _motion(self, count: int) -> FilmMotion:
        state = self._soft.state
        x, velocity = (np.empty((count + 2, *state.positions.shape)) for _ in range(2))
        memory = np.empty((count + 1, len(state.memory)))
        x[0], velocity[0] = state.earlier or (state.positions, state.velocities)
        x[1], velocity[1], memory[0] = state.positions, state.velocities, state.memory
        return FilmMotion(x, velocity, memory)

    def _shown(self, motion: FilmMotion, commands: FilmCommands, done: int) -> tuple[list[Array], Array]:
        return list(motion.x[2 : done + 2]), commands.pressure[:done]

    def _row(
        self,
        ticks: Ticks,
        motion: FilmMotion,
        commands: FilmCommands,
        loads: Sequence[Loads],
        carried: AddedInertiaRow,
    ) -> tuple[int, int]:
        soft, stepper, tick_s = self._soft, self._soft.stepper, self.coupling.interface.scene.tick_s
        # a first step looks back over one only
        count = len(loads) if soft.state.earlier is not None else 1
        quick, scheme = stepper.quick, stepper.scheme_of(soft.state, tick_s)
        side = quick.sides.of(scheme, tick_s)
        assert side is not None, "ready says whether there is one"
        mass = soft.body.node_mass.reshape(-1, 1, 1)
        begins = quick.untouched, quick.begins(lenient=True), quick.begins(lenient=False)
        contact = nothing_there() if self._contact is None else self._contact.begin()
        row = FilmRow(side, *begins, self._reach, self._calls, mass, self._mass_kg, LARGE_TURN_RAD, contact)
        done, ending = advance_film_ticks(
            count, self.native, carried, self.mounted, commands, row, ticks, motion
        )
        quick.sides.take_over(side, scheme)
        if done:
            self._go_to(ticks, motion, done, loads[done - 1])
        if ending == SOFT_STEP_BEGUN:
            end = motion.x[done + 2].copy(), motion.velocity[done + 2].copy(), motion.memory[done + 1].copy()
            left = int(ticks.iterations[done]), float(ticks.residual[done])
            quick.begun = BegunStep(soft.state, *end, *left)
        self._conclude(ticks, done, half_done=ending in (SOFT_STEP_LEFT, SOFT_STEP_BEGUN))
        return done, ending

    def _conclude(self, ticks: Ticks, done: int, *, half_done: bool) -> None:
        """Bring all but the soft side to where the kernel has stopped."""
        contact = self._contact
        if contact is None or not done:
            self._take_over(ticks, done, half_done=half_done)
            return
        self._take_over(ticks, done, contact.handed, half_done=half_done)
        contact.end(ticks, done, carry=self.coupling.bodies_carry, half_done=half_done)

    def _go_to(self, ticks: Ticks, motion: FilmMotion, done: int, loads: Loads) -> None:
        """Bring the soft side to where the kernel has stopped."""
        x, velocity = motion.x[done : done + 2].copy(), motion.velocity[done : done + 2].copy()
        state = SoftState(x[1], velocity[1], motion.memory[done].copy(), (x[0], velocity[0]))
        drive = pose_of(ticks, done), loads
        self._soft.go_to(state, float(ticks.residual[done - 1]), pose_of(ticks, done - 1), drive)

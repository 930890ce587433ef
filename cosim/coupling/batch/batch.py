"""Ticks of arm and section arm in a row, in one kernel: a tenth of what they cost one by one.

The kernel takes what most ticks are: a given pressure, given tensions, nothing touched. It leaves a soft step
that does not converge in one go; that tick is finished by `StaggeredCoupling`, as any other would be.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.batch.added_inertia import AddedInertiaRow
from cosim.coupling.batch.batch_arrays import ChainMotion, Commands, Ticks
from cosim.coupling.batch.batch_kernel import advance_ticks
from cosim.coupling.batch.lockstep import Servos
from cosim.coupling.batch.row_lockstep import RowLockstep, pose_of
from cosim.coupling.batch.tick_halves import SOFT_STEP_LEFT
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.soft_sides.chain_reader import ChainShapes
from cosim.coupling.soft_sides.section_arm import SectionArm
from cosim.reduced.sections.pressure_spline import TERMS
from cosim.reduced.solve.state import ChainState
from cosim.reduced.solve.time_step import ChainStep
from cosim.rigid.scene.native import NativeScene
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome

_MOST = 512  # ticks in a row: more cost no less each


@final
class SectionLockstep(RowLockstep):
    """Advances one coupling by many ticks at once.

    Args:
        coupling: staggered, nothing touched.
        native: its rigid side.
        soft: its soft side.
        mounted: (10,) `inertial_parameters` of a rigid mass on the flange, flange frame.
    """

    def __init__(
        self, coupling: StaggeredCoupling, native: NativeScene, soft: SectionArm, mounted: Array
    ) -> None:
        super().__init__(coupling, native, mounted, _MOST)
        self._soft = soft

    @classmethod
    def of(cls, coupling: object, soft: object, mounted: Array) -> SectionLockstep | None:
        """Return what advances a coupling; None where that takes more than a kernel."""
        if not isinstance(coupling, StaggeredCoupling) or coupling.interface.contact is not None:
            return None
        native = coupling.interface.scene.native()
        if native is None or not isinstance(soft, SectionArm) or soft.stepper.losses_follow_shape:
            return None
        return cls(coupling, native, soft, mounted)

    def commands(self, servos: Servos, loads: Sequence[Loads]) -> Commands | None:
        if not all(load.plain for load in {id(load): load for load in loads}.values()):
            return None
        pressure = np.array([load.pressures(1)[0] for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        first, weights = np.empty(len(loads), np.int64), np.empty((len(loads), TERMS))
        spline, terms = self._soft.section.model.spline, None
        for k, value in enumerate(pressure.tolist()):
            if terms is None or value != pressure[k - 1]:
                terms = spline.terms(value)
            first[k], weights[k] = terms.first, terms.weights[0]
        return Commands(
            servos.position, servos.velocity, servos.torque, servos.by_payload, pressure, first, weights,
            self._soft.stepper.segment_tensions(tension),
        )  # fmt: skip

    @property
    def ready(self) -> bool:
        return True

    def _figures(self) -> Array:
        return self._soft.last.figures

    def _motion(self, count: int) -> ChainMotion:
        chain = self._soft.last.chain
        frames = len(chain.frames)
        rows = ChainMotion(np.empty((count + 2, 2, frames, 4, 3)), np.empty((count, frames, 6)))
        rows.motion[0] = chain.motion if chain.earlier is None else chain.earlier
        rows.motion[1] = chain.motion
        return rows

    def _shown(self, motion: ChainMotion, commands: Commands, done: int) -> tuple[ChainShapes, Array]:
        pressure = commands.pressure[:done]
        return ChainShapes(motion.motion[2 : done + 2, 0], pressure), pressure[:, None]

    def _row(
        self,
        ticks: Ticks,
        motion: ChainMotion,
        commands: Commands,
        loads: Sequence[Loads],
        carried: AddedInertiaRow,
    ) -> tuple[int, int]:
        scene, soft, stepper = self.coupling.interface.scene, self._soft, self._soft.stepper
        options, begin = stepper.options, soft.last.chain
        two_steps, earlier = options.integrator == "bdf2", begin.earlier is not None
        chain = stepper.arrays(soft.clamp, loads[0], begin.frames)
        kept = stepper.tangent.serves(soft.clamp, scene.tick_s, two_steps and earlier)
        done, ending, kept = advance_ticks(
            len(loads), self.native, carried, self.mounted, soft.section.mass_kg, commands, chain, ticks,
            motion, scene.tick_s, options.damping_per_s, two_steps, earlier, kept,
            options.newton.iterations_max,
        )  # fmt: skip
        half_done = ending == SOFT_STEP_LEFT
        last = done if half_done else done - 1  # of which the soft step was tried
        stepper.tangent.keep(kept, soft.clamp, scene.tick_s, two_steps and (earlier or last > 0))
        if done:
            self._go_to(ticks, motion, done, loads[done - 1])
        self._take_over(ticks, done, half_done=half_done)
        # what was computed for a pressure is kept with it
        stepper.arrays(soft.clamp, loads[max(last, 0)], soft.last.frames)
        return done, ending

    def _go_to(self, ticks: Ticks, rows: ChainMotion, done: int, loads: Loads) -> None:
        """Bring the soft side to where the kernel has stopped."""
        motion, figures = rows.motion[done : done + 2].copy(), ticks.figures[done].copy()
        last = ChainStep(
            ChainState(motion[1], motion[0]), rows.gradient[done - 1].copy(), figures, Outcome.CONVERGED,
            int(ticks.iterations[done - 1]), float(ticks.residual[done - 1]), loads.pressures(1)[0],
        )  # fmt: skip
        self._soft.go_to(last, pose_of(ticks, done), loads)

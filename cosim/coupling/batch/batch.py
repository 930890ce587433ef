"""Ticks of arm and section arm in a row, in one kernel: a tenth of what they cost one by one.

The kernel takes what most ticks are: a given pressure, given tensions, nothing touched. It leaves a soft step
that does not converge in one go; that tick is finished by `StaggeredCoupling`, as any other would be.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.coupling.batch.added_inertia import AddedInertiaRow
from cosim.coupling.batch.batch_arrays import Commands, Ticks
from cosim.coupling.batch.batch_kernel import ALL_DONE, RIGID_SIDE_WARNS, SOFT_STEP_LEFT, advance_ticks
from cosim.coupling.batch.lockstep import Lockstep, LockstepProgress, Servos
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.coupling.schemes.momentum_balance import NOTHING, TransferredLoads, six_numbers
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.soft_sides.chain_reader import ChainShapes
from cosim.coupling.soft_sides.section_arm import SectionArm
from cosim.reduced.sections.outputs import FIGURES, supplied_wrench
from cosim.reduced.sections.pressure_spline import TERMS
from cosim.reduced.solve.state import ChainState
from cosim.reduced.solve.time_step import ChainStep
from cosim.rigid.scene.native import NativeScene
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome


@final
class SectionLockstep(Lockstep):
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
        self._coupling, self._native, self._soft, self._mounted = coupling, native, soft, mounted
        self._lost = 0.0

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

    def advance(self, commands: Commands, loads: Sequence[Loads]) -> LockstepProgress:
        interface, count = self._coupling.interface, len(loads)
        interface.scene.check()
        ticks = self._empty(count)
        ratio, carried = np.empty(count), np.zeros(count, dtype=bool)
        done, ending = 0, ALL_DONE
        while done < count and ending == ALL_DONE:
            # in between, the flange is weighed
            most, on_joints = self._coupling.begin_row()
            end = min(done + most, count)
            ratio[done:end], carried[done:end] = interface.ratio, len(on_joints.inertia) > 0
            taken, ending = self._advance(
                ticks.from_on(done), commands.rows(done, end), loads[done:end], on_joints
            )
            done += taken
        half_done, broken = ending == SOFT_STEP_LEFT, ending == RIGID_SIDE_WARNS
        if broken and not done:
            interface.scene.check()
        pressure = commands.pressure[:done]
        shapes = ChainShapes(ticks.motion[2 : done + 2, 0], pressure)
        return LockstepProgress(ticks, shapes, pressure, done, half_done, broken, ratio, carried)

    def _advance(
        self, ticks: Ticks, commands: Commands, loads: Sequence[Loads], carried: AddedInertiaRow
    ) -> tuple[int, int]:
        """Advance in one go; return how many ticks are done, and how that ended."""
        scene, soft, stepper = self._coupling.interface.scene, self._soft, self._soft.stepper
        options, begin = stepper.options, soft.last.chain
        two_steps, earlier = options.integrator == "bdf2", begin.earlier is not None
        chain = stepper.arrays(soft.clamp, loads[0], begin.frames)
        kept = stepper.tangent.serves(soft.clamp, scene.tick_s, two_steps and earlier)
        done, ending, kept = advance_ticks(
            len(loads), self._native, carried, self._mounted, soft.section.mass_kg, commands, chain, ticks,
            scene.tick_s, options.damping_per_s, two_steps, earlier, kept, options.newton.iterations_max,
        )  # fmt: skip
        half_done = ending == SOFT_STEP_LEFT
        last = done if half_done else done - 1  # of which the soft step was tried
        stepper.tangent.keep(kept, soft.clamp, scene.tick_s, two_steps and (earlier or last > 0))
        self._take_over(ticks, done, loads, half_done=half_done)
        # what was computed for a pressure is kept with it
        stepper.arrays(soft.clamp, loads[max(last, 0)], soft.last.frames)
        return done, ending

    def finish_tick(self, loads: Loads) -> LedgerEntry:
        self._coupling.interface.ticks += 1
        return self._coupling.finish_tick(loads, self._coupling.wrench, self._lost)

    def _empty(self, count: int) -> Ticks:
        """Return the rows to fill, with what is there before the first tick."""
        native, interface, last = self._native, self._coupling.interface, self._soft.last
        flange, handed, chain = interface.scene.flange_pose, interface.handed, last.chain
        frames, joints, bodies = len(chain.frames), len(native.position), len(native.places)
        ticks = Ticks(
            np.empty((count + 2, 2, frames, 4, 3)), np.empty((count, frames, 6)),
            np.empty((count + 1, FIGURES)), np.empty((count + 1, 3)), np.empty((count + 1, 3, 3)),
            np.empty((count, 6)), np.empty((count + 1, 7)), np.empty((count, joints)),
            np.empty((count, joints)), np.empty((count, joints)), np.empty((count, bodies, 3)),
            np.empty((count, bodies, 4)), np.empty((count, 3)), np.empty(count),
            np.empty(count), np.empty(count, np.int64),
        )  # fmt: skip
        ticks.motion[0] = chain.motion if chain.earlier is None else chain.earlier
        ticks.motion[1], ticks.figures[0] = chain.motion, last.figures
        ticks.origin[0], ticks.axes[0] = flange.translation, flange.rotation
        ticks.handed[0] = (*handed.flange, handed.flange_size_N)
        return ticks

    def _take_over(self, ticks: Ticks, done: int, loads: Sequence[Loads], *, half_done: bool) -> None:
        """Bring both sides and the coupling to where the kernel has stopped."""
        soft, coupling = self._soft, self._coupling
        flange = coupling.interface.scene.flange
        if done:
            motion = ticks.motion[done : done + 2].copy()
            figures, pressure = ticks.figures[done].copy(), loads[done - 1].pressures(1)[0]
            last = ChainStep(
                ChainState(motion[1], motion[0]), ticks.gradient[done - 1].copy(), figures, Outcome.CONVERGED,
                int(ticks.iterations[done - 1]), float(ticks.residual[done - 1]), pressure,
            )  # fmt: skip
            soft.go_to(last, _pose(ticks, done), loads[done - 1])
            size = float(ticks.handed[done, 6])
            handed = TransferredLoads(six_numbers(ticks.handed[done, :6]), NOTHING, size, 0.0)
            coupling.end_row(done, supplied_wrench(figures), handed)
        if half_done:
            self._lost = float(ticks.momentum_error[done])
            flange.stepped(_pose(ticks, done))
        else:
            flange.stepped(_pose(ticks, done - 1))


def _pose(ticks: Ticks, row: int) -> Pose:
    return Pose.owning(ticks.axes[row].copy(), ticks.origin[row].copy())

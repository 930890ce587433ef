"""The quasistatic mode: a sequence of equilibria of the soft body and its carrier."""

import time
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, Twist, vector_from_rotation
from cosim.base.state_checks import check_state
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.devices.command_source import StepToTake
from cosim.errors import ConvergenceError
from cosim.plan.static_plan import start_equilibrium
from cosim.soft.body.loads import Loads
from cosim.soft.solve.branching import Branching
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.stepping.extrapolation import REMEMBERED, next_of
from cosim.stepping.parts import Parts
from cosim.stepping.relaxed_wrench import RelaxedWrench
from cosim.stepping.stepped_run import Cursor, SteppedRun
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch

_ROUNDS_MAX: Final = 20
_AT_REST_m: Final = 1e-5
"""Motion of the flange in a round, below which the rounds have converged."""


@final
@dataclass(frozen=True)
class QuasistaticState:
    """Start of the next increment.

    Args:
        present: the present equilibrium.
        shapes: (k, n, 3) [m], flange frame, before each of the last increments of the phase, k <= 3.
        deflections: (k, joints) [rad], of the carrier at these times.
    """

    present: Equilibrium
    shapes: Annotated[Array, ("k", "nodes", 3)]
    deflections: Annotated[Array, ("k", "joints")]


@final
@dataclass(frozen=True)
class _Motion:
    """Mean motion of an increment.

    Args:
        twist: of the flange origin, world axes.
        joint_velocity: (joints,) [rad/s].
        soft_power_W: of the flange's nodes.
    """

    twist: Twist
    joint_velocity: Array
    soft_power_W: float


@final
class QuasistaticSimulation(SteppedRun):
    """Solves a planned run increment by increment.

    Args:
        parts: of the run.
        stage: its unchanging description.
    """

    def __init__(self, parts: Parts, stage: RunInfo) -> None:
        phases = [planned.phase for planned in parts.plan.phases]
        super().__init__(parts, stage, [phase.increments for phase in phases])
        self._ends_s = list(accumulate(phase.duration_s + phase.settle_s for phase in phases))
        self._state: QuasistaticState | None = None
        parts.soft.set_obstacles(parts.carrier.obstacles())

    def _without_history(self, present: Equilibrium) -> QuasistaticState:
        """Return the state at the start of a phase."""
        nodes, joints = present.state.positions, self._parts.carrier.deflection
        return QuasistaticState(present, np.empty((0, *nodes.shape)), np.empty((0, *joints.shape)))

    @property
    def _present(self) -> QuasistaticState:
        assert self._state is not None, "the run has begun"
        return self._state

    @property
    def equilibrium(self) -> Equilibrium:
        """The present equilibrium."""
        return self._present.present

    @property
    def state(self) -> QuasistaticState | None:
        """Start of the next increment, without contacts of films, which each increment finds again."""
        if self._state is None:
            return None
        present = self._state.present
        present = replace(present, loads=replace(present.loads, self_contact=None), branchings=())
        return replace(self._state, present=present)

    @state.setter
    def state(self, state: QuasistaticState | None) -> None:
        soft = self._parts.soft.state
        sizes = {"nodes": len(soft.positions), "joints": len(self._parts.carrier.deflection)}
        check_state(state, self.state, QuasistaticState, place="state.run", sizes=sizes)
        assert state is not None, "just checked"
        check_state(state.present.state, soft, SoftState, place="state.run.present.state")
        if state.present.loads.contact is not None:
            self._parts.soft.contact_surface().check_planes(state.present.loads.contact)
        self._state = state

    def _start(self, began: float) -> TickBatch:
        parts = self._parts
        plan, carrier = parts.plan, parts.carrier
        carrier.set_configuration(plan.joints)
        start = start_equilibrium(parts.soft, carrier.flange_pose, parts.loads(plan.command))
        start, spent = self._with_deflection(start, plan.joints, start.iterations)
        self._state = self._without_history(start)
        still = np.zeros_like(plan.joints)
        return self._shown(Cursor(), 0.0, plan.joints, _Motion(Twist(), still, 0.0), spent, began)

    def _take(self, to: Cursor, most: int) -> TickBatch:
        began = time.perf_counter()
        parts, state = self._parts, self._present
        phase = parts.plan.phases[to.phase].phase
        began_s = self._ends_s[to.phase - 1] if to.phase else 0.0
        if to.done == 1:
            self._begin_phase(to.phase, state.present.world_from_flange)
            state = self._without_history(state.present)
        span = (phase.duration_s + phase.settle_s) / phase.increments
        joints = parts.carrier.joint_position
        command = parts.command(StepToTake(to.phase, to.done, began_s + (to.done - 1) * span, span))
        reference = command.joints.position
        self._state, spent = self._advance(state, reference, parts.loads(command.soft))
        motion = _mean_motion(parts, state.present, self._state.present, joints, span)
        return self._shown(to, began_s + to.done * span, reference, motion, spent, began)

    def _step_of(self, to: Cursor) -> str:
        return f"increment {to.done} of {self._parts.plan.phases[to.phase].phase.increments}"

    def _shown(
        self, to: Cursor, time_s: float, reference: Array, motion: _Motion, spent: int, began: float
    ) -> TickBatch:
        """Return the row of the present equilibrium, with the Newton iterations spent on it."""
        parts, present, touched = self._parts, self._present.present, NOTHING_TOUCHED
        soft, carrier, flange = parts.soft, parts.carrier, present.world_from_flange
        if present.loads.contact is not None:
            touched = ContactReport.of(present.loads.contact.at(present.state.positions))
        columns = {
            "tick": to.tick,
            "time_s": time_s,
            "phase": to.phase,
            "joint_target": reference,
            "joint_velocity": motion.joint_velocity,
            "joint_torque": carrier.hold(present.wrench),
            "flange_twist": [*motion.twist.linear, *motion.twist.angular],
            "rigid_power_W": present.wrench.power(motion.twist),
            "soft_power_W": motion.soft_power_W,
            "newton_iterations": spent,
            "contacts": touched.count,
            "contact_force_N": touched.normal_force_N,
            "contact_depth_m": touched.depth_m,
            "body_contact_force": touched.on_each(len(carrier.body_names)),
        }
        shape, ends = soft.current_shape(), to.done == self._counts[to.phase]
        return parts.at_rest(
            present, columns, began,
            branchings=self._branchings(to, present.branchings),
            overlaps=parts.overlaps(shape, carrier.joint_position) if self._overlap_rows(to, 1) else (),
            stability=soft.assess_stability(shape, flange, present.loads) if ends else None,
        )  # fmt: skip

    def _branchings(self, to: Cursor, passed: tuple[Branching, ...]) -> tuple[Branching, ...]:
        """Return the branchings in an increment, with load factors of the phase."""
        if not to.done:
            return passed
        before, count = to.done - 1, self._counts[to.phase]
        return tuple(replace(each, load_factor=(before + each.load_factor) / count) for each in passed)

    def _advance(
        self, state: QuasistaticState, reference: Array, loads: Loads
    ) -> tuple[QuasistaticState, int]:
        """Return the state at the next equilibrium of both, and the Newton iterations spent."""
        carrier, soft, present = self._parts.carrier, self._parts.soft, state.present
        # the start extrapolates shape, in the flange frame, and deflection
        local = present.world_from_flange.inverse().apply(present.state.positions)
        shapes = np.concatenate((state.shapes, local[None]))
        deflections = np.concatenate((state.deflections, carrier.deflection[None]))
        state = replace(state, shapes=shapes[-REMEMBERED:], deflections=deflections[-REMEMBERED:])
        if soft.obstacles is not None:  # friction holds an extrapolated shape: extrapolate linearly
            shapes, deflections = shapes[-2:], deflections[-1:]
        carrier.track(reference, next_of(deflections))
        pose = carrier.flange_pose
        try:
            start = pose.apply(next_of(shapes))
            found = soft.switch_branch(present, soft.solve(present.state, pose, loads, start))
            spent = found.iterations
        except ConvergenceError as error:
            carrier.track(reference, deflections[-1])
            found = soft.follow(present, carrier.flange_pose, loads)
            spent = error.iterations + found.iterations
        found, spent = self._with_deflection(found, reference, spent)
        return replace(state, present=found), spent

    def _with_deflection(self, found: Equilibrium, reference: Array, spent: int) -> tuple[Equilibrium, int]:
        """Return a common equilibrium of carrier and soft body, and the Newton iterations spent.

        Raises:
            ConvergenceError: none was found.
        """
        carrier, soft, relaxed = self._parts.carrier, self._parts.soft, RelaxedWrench()
        for _ in range(_ROUNDS_MAX):
            soft.commit(found)
            if not carrier.relax_under(reference, relaxed.next(found.wrench)):
                return found, spent
            last, before = found, found.world_from_flange
            found = soft.follow(found, carrier.flange_pose, found.loads)
            spent, slides = spent + found.iterations, last.slides + found.slides
            found = replace(found, slides=slides, branchings=(*last.branchings, *found.branchings))
        moved = float(np.linalg.norm(found.world_from_flange.translation - before.translation))
        if moved > _AT_REST_m:
            raise ConvergenceError(
                f"the arm and the soft robot that pushes it find no common equilibrium: after {_ROUNDS_MAX} "
                f"rounds the flange still moves by {1e3 * moved:.3g} mm, with "
                f"{np.linalg.norm(found.wrench.force):.3g} N on it; take more increments, or stiffer servos",
                found.residual_N,
                spent,
            )
        return found, spent


def _mean_motion(
    parts: Parts, before: Equilibrium, after: Equilibrium, joints: Array, span_s: float
) -> _Motion:
    """Return the motion between two equilibria, from joint angles (joints,) [rad] to those of the carrier."""
    old, new = before.world_from_flange, after.world_from_flange
    turn = vector_from_rotation(new.rotation @ old.rotation.T)
    twist = Twist((new.translation - old.translation) / span_s, turn / span_s)
    displacement = after.state.positions - before.state.positions
    velocity = (parts.carrier.joint_position - joints) / span_s
    return _Motion(twist, velocity, parts.soft.supplied_work(displacement) / span_s)

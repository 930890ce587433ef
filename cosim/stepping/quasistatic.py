"""The quasistatic mode: a chain of equilibria of the soft body and of what carries it.

The wrench that an arm gives way to, in rounds with a soft robot that pushes it.

Against something hard a small motion of the flange changes the wrench by more than what moved it: taken as it
is, it would swing between two values for ever. After some rounds that did not settle, only a share of each
change is taken, by Aitken's rule for vectors.
Source: Irons and Tuck, Int. J. Numer. Methods Eng. 1 (1969) 275.
"""

import time
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, Twist, Wrench, vector_from_rotation
from cosim.base.state_checks import check_state
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.devices.command_source import StepToTake
from cosim.errors import ConvergenceError
from cosim.plan.static_plan import start_equilibrium
from cosim.soft.body.loads import Loads
from cosim.soft.solve.branching import Branching
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.stepping.parts import Parts
from cosim.stepping.stepped_run import Cursor, SteppedRun
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch

_FULL_ROUNDS = 4
_LEAST_SHARE = 0.05


@final
class RelaxedWrench:
    """Gives the wrench of each round."""

    def __init__(self) -> None:
        self._rounds, self._share = 0, 1.0
        self._given: Array | None = None
        self._change: Array | None = None

    def next(self, found: Wrench) -> Wrench:
        """Return the wrench to give way to.

        Args:
            found: of the equilibrium in this round, at the flange's origin, world axes.
        """
        wrench = np.concatenate((found.force, found.torque))
        self._rounds += 1
        if self._given is None:
            self._given = wrench
            return found
        change = wrench - self._given
        if self._change is not None and self._rounds > _FULL_ROUNDS:
            turn = change - self._change
            share = -self._share * float(self._change @ turn) / max(float(turn @ turn), 1e-300)
            self._share = min(1.0, max(_LEAST_SHARE, share))
        self._change, self._given = change, self._given + self._share * change
        return found if self._share == 1.0 else Wrench(self._given[:3], self._given[3:])


_DROOP_ROUNDS_MAX = 20
_SWINGS_M = 1e-5  # of the flange, in a round


@final
@dataclass(frozen=True)
class QuasistaticState:
    """What the next increment starts from.

    Args:
        here: the present equilibrium.
        shapes: (k, n, 3) [m], flange frame, before each of the last increments of the phase, k <= 3.
        deflections: (k, joints) [rad], of the carrier then.
    """

    here: Equilibrium
    shapes: Annotated[Array, ("k", "nodes", 3)]
    deflections: Annotated[Array, ("k", "joints")]


_REMEMBERED = 3  # increments of a phase, from which the next one is guessed
_FAR_NEARER = 0.25  # than a line: a parabola makes more of kinks, where touching films slide on


def next_of(trail: Array) -> Array:
    """Return where a sequence goes on to: on a parabola where that led far nearer to its end than a line.

    Through a, b, c at equal distances, the parabola goes on to 3 c - 3 b + a, the line to 2 c - b (Lagrange).

    Args:
        trail: (k, ...), k >= 1, the last ones.
    """
    if len(trail) == 1:
        return np.array(trail[0])
    d, c = trail[-1], trail[-2]
    if len(trail) > _REMEMBERED:
        b, a = trail[-3], trail[-4]
        line, parabola = (d - c) - (c - b), (d - c) - 2.0 * (c - b) + (b - a)
        if np.vdot(parabola, parabola) < _FAR_NEARER**2 * np.vdot(line, line):
            return np.asarray(3.0 * (d - c) + b)
    return np.asarray(2.0 * d - c)


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

    def _without_history(self, here: Equilibrium) -> QuasistaticState:
        """Return the state at the start of a phase."""
        nodes, joints = here.state.positions, self._parts.carrier.deflection
        return QuasistaticState(here, np.empty((0, *nodes.shape)), np.empty((0, *joints.shape)))

    @property
    def _begun(self) -> QuasistaticState:
        assert self._state is not None, "the run has begun"
        return self._state

    @property
    def equilibrium(self) -> Equilibrium:
        """The present one."""
        return self._begun.here

    @property
    def state(self) -> QuasistaticState | None:
        """What the next increment starts from; which films touch is found again in every increment."""
        if self._state is None:
            return None
        here = self._state.here
        here = replace(here, loads=replace(here.loads, self_contact=None), branchings=())
        return replace(self._state, here=here)

    @state.setter
    def state(self, state: QuasistaticState | None) -> None:
        soft = self._parts.soft.state
        sizes = {"nodes": len(soft.positions), "joints": len(self._parts.carrier.deflection)}
        check_state(state, self.state, QuasistaticState, place="state.run", sizes=sizes)
        assert state is not None, "just checked"
        check_state(state.here.state, soft, SoftState, place="state.run.here.state")
        if state.here.loads.contact is not None:
            self._parts.soft.contact_surface().check_planes(state.here.loads.contact)
        self._state = state

    def _start(self, began: float) -> TickBatch:
        parts = self._parts
        plan, carrier = parts.plan, parts.carrier
        carrier.set_configuration(plan.joints)
        here = start_equilibrium(parts.soft, carrier.flange_pose, parts.loads(plan.command))
        here, spent = self._with_droop(here, plan.joints, here.iterations)
        self._state = self._without_history(here)
        still = np.zeros_like(plan.joints)
        return self._shown(Cursor(), 0.0, plan.joints, _Motion(Twist(), still, 0.0), spent, began)

    def _take(self, to: Cursor, most: int) -> TickBatch:
        began = time.perf_counter()
        parts, state = self._parts, self._begun
        phase = parts.plan.phases[to.phase].phase
        began_s = self._ends_s[to.phase - 1] if to.phase else 0.0
        if to.done == 1:
            self._begin_phase(to.phase, state.here.world_from_flange)
            state = self._without_history(state.here)
        span = (phase.duration_s + phase.settle_s) / phase.increments
        joints = parts.carrier.joint_position
        command = parts.command(StepToTake(to.phase, to.done, began_s + (to.done - 1) * span, span))
        reference = command.joints.position
        self._state, spent = self._advance(state, reference, parts.loads(command.soft))
        motion = _mean_motion(parts, state.here, self._state.here, joints, span)
        return self._shown(to, began_s + to.done * span, reference, motion, spent, began)

    def _step_of(self, to: Cursor) -> str:
        return f"increment {to.done} of {self._parts.plan.phases[to.phase].phase.increments}"

    def _shown(
        self, to: Cursor, time_s: float, reference: Array, motion: "_Motion", spent: int, began: float
    ) -> TickBatch:
        """Return what the present equilibrium shows, with the Newton iterations spent on it."""
        parts, here, touched = self._parts, self._begun.here, NOTHING_TOUCHED
        soft, carrier, flange = parts.soft, parts.carrier, here.world_from_flange
        if here.loads.contact is not None:
            touched = ContactReport.of(here.loads.contact.at(here.state.positions))
        given = {
            "tick": to.tick,
            "time_s": time_s,
            "phase": to.phase,
            "joint_target": reference,
            "joint_velocity": motion.joint_velocity,
            "joint_torque": carrier.hold(here.wrench),
            "flange_twist": [*motion.twist.linear, *motion.twist.angular],
            "rigid_power_W": here.wrench.power(motion.twist),
            "soft_power_W": motion.soft_power_W,
            "newton_iterations": spent,
            "contacts": touched.count,
            "contact_force_N": touched.normal_force_N,
            "contact_depth_m": touched.depth_m,
            "body_contact_force": touched.on_each(len(carrier.body_names)),
        }
        shape, looks, ends = soft.current_shape(), self._looked_at(to, 1), to.done == self._counts[to.phase]
        return parts.at_rest(
            here, given, began,
            branchings=self._branchings(to, here.branchings),
            overlaps=parts.overlaps(shape, carrier.joint_position) if looks else (),
            footing=soft.assess_stability(shape, flange, here.loads) if ends else None,
        )  # fmt: skip

    def _branchings(self, to: Cursor, passed: tuple[Branching, ...]) -> tuple[Branching, ...]:
        """Return what an increment has passed, with load factors of the phase in place of the increment."""
        if not to.done:
            return passed
        before, count = to.done - 1, self._counts[to.phase]
        return tuple(replace(each, load_factor=(before + each.load_factor) / count) for each in passed)

    def _advance(
        self, state: QuasistaticState, reference: Array, loads: Loads
    ) -> tuple[QuasistaticState, int]:
        """Return the state at the next equilibrium of both, and the Newton iterations spent."""
        carrier, soft, here = self._parts.carrier, self._parts.soft, state.here
        # shape, seen from the flange, and deflection go on as they changed in the increments before
        local = here.world_from_flange.inverse().apply(here.state.positions)
        shapes = np.concatenate((state.shapes, local[None]))
        deflections = np.concatenate((state.deflections, carrier.deflection[None]))
        state = replace(state, shapes=shapes[-_REMEMBERED:], deflections=deflections[-_REMEMBERED:])
        if soft.obstacles is not None:  # what it touches holds it where the guess has put it: guess less
            shapes, deflections = shapes[-2:], deflections[-1:]
        carrier.track(reference, next_of(deflections))
        pose = carrier.flange_pose
        try:
            found = soft.switch_branch(here, soft.solve(here.state, pose, loads, pose.apply(next_of(shapes))))
            spent = found.iterations
        except ConvergenceError as error:
            carrier.track(reference, deflections[-1])
            found = soft.follow(here, carrier.flange_pose, loads)
            spent = error.iterations + found.iterations
        found, spent = self._with_droop(found, reference, spent)
        return replace(state, here=found), spent

    def _with_droop(self, found: Equilibrium, reference: Array, spent: int) -> tuple[Equilibrium, int]:
        """Let the carrier give way to the wrench until it and the soft body agree.

        Raises:
            ConvergenceError: they do not.
        """
        carrier, soft, relaxed = self._parts.carrier, self._parts.soft, RelaxedWrench()
        for _ in range(_DROOP_ROUNDS_MAX):
            soft.commit(found)
            if not carrier.relax_under(reference, relaxed.next(found.wrench)):
                return found, spent
            last, before = found, found.world_from_flange
            found = soft.follow(found, carrier.flange_pose, found.loads)
            spent, slides = spent + found.iterations, last.slides + found.slides
            found = replace(found, slides=slides, branchings=(*last.branchings, *found.branchings))
        moved = float(np.linalg.norm(found.world_from_flange.translation - before.translation))
        if moved > _SWINGS_M:
            raise ConvergenceError(
                f"the arm and the soft robot that pushes it find no common place: after {_DROOP_ROUNDS_MAX} "
                f"rounds the flange still moves by {1e3 * moved:.3g} mm, with "
                f"{np.linalg.norm(found.wrench.force):.3g} N on it",
                found.residual_N,
                spent,
            )
        return found, spent


@final
@dataclass(frozen=True)
class _Motion:
    """How an increment moves, in its mean.

    Args:
        twist: of the flange origin, world axes.
        joint_velocity: (joints,) [rad/s].
        soft_power_W: that the flange's nodes took in at that rate.
    """

    twist: Twist
    joint_velocity: Array
    soft_power_W: float


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

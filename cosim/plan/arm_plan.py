"""What a plan asks of arm and section model, before anything runs.

Joints against their bounds, links against the scene, the range in which a section model was fitted.

How far a soft arm swings that is carried along a path: as one oscillator that is shaken at its foot.

The plan is walked through on the statics; where a phase accelerates the flange, gravity is replaced by g - y,
with y what the arm's swing comes to (`swing`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.solid import LinkContact
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.soft_side import MassProperties, SoftSide
from cosim.errors import ConvergenceError, OutOfRangeError, ScenarioError
from cosim.plan.arm_limits import ArmLimits, PathClearances, PlannedArm
from cosim.plan.decision import SECTION_RANGE, Decision
from cosim.plan.motion import JointPath, JointReference, Progress, progress
from cosim.plan.plan import ChamberGas, PhasePlan, Plan, loads_of
from cosim.plan.planning import AnyWay, JointPlanner, start_equilibrium
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.state import Equilibrium

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.scene import RigidScene


_SAMPLES = 41  # of a phase, at least
_TAIL_MAX = 2000  # samples after it


@final
@dataclass(frozen=True)
class FlangeAcceleration:
    """Accelerations of the flange's origin, and the arm's rest after them.

    Args:
        fractions: (k,) progress of the phase.
        values: (k, 3) [m/s^2], world.
        step_s: between them.
    """

    fractions: Array
    values: Array
    step_s: float

    @classmethod
    def of(cls, arm: Arm, planned: PhasePlan) -> FlangeAcceleration | None:
        """Return those of a phase; None where the flange rests, or leaps, which has none."""
        phase, path = planned.phase, planned.joints
        if path.spline is None or phase.ramp == "step":
            return None
        count = max(_SAMPLES, 2 * len(path.spline.x))
        step_s = phase.duration_s / (count - 1)
        # a sample before and one after: a linear ramp leaps from rest to its speed
        ways = [progress(phase.ramp, k * step_s, phase.duration_s) for k in range(-1, count + 1)]
        x = np.array([arm.forward(path.at(way).position).translation for way in ways])
        fractions = np.array([way.value for way in ways[1:-1]])
        return cls(fractions, np.diff(x, n=2, axis=0) / step_s**2, step_s)

    @property
    def largest(self) -> Array:
        """(3,) [m/s^2], where it is largest."""
        return np.asarray(self.values[int(np.argmax(np.linalg.norm(self.values, axis=1)))])

    def swing(self, rate_rad_s: float) -> tuple[float, Array]:
        """Return when an undamped oscillator is farthest, and what lasting acceleration does that.

        y'' = w^2 (a - y), exact for an acceleration a that is even between samples. Slow motions give y = a,
        a sudden acceleration that lasts up to y = 2 a, a short one less than a.

        Args:
            rate_rad_s: w.

        Returns:
            Progress of the phase; acceleration y (3,) [m/s^2] of its foot.
        """
        tail = min(_TAIL_MAX, math.ceil(2.0 * math.pi / (rate_rad_s * self.step_s)))
        angle = rate_rad_s * self.step_s
        cosine, sine = math.cos(angle), math.sin(angle)
        y, rate = np.zeros(3), np.zeros(3)  # rate: y' / w
        farthest, place = y, 0
        for k, a in enumerate([*self.values, *np.zeros((tail, 3))]):
            y, rate = a + cosine * (y - a) + sine * rate, cosine * rate - sine * (y - a)
            if y @ y > farthest @ farthest:
                farthest, place = y, k
        return float(self.fractions[min(place, len(self.fractions) - 1)]), farthest


_PIECES = 20  # of a phase
_SLOW = 0.1  # share of gravity below which an acceleration bends no arm out of its range
_PROBE = 0.02  # of gravity, to the side
_RANGE = " out of its section model's range: "
_FIRST_MODE = (
    1.5  # w^2 d / a, d the tip's deflection under an even load a: 1.55 of a beam, 1.45 of a hanging rope
)
_MOVED_BY: Final = (
    "flange", "flange_turn", "flange_shift_m", "flange_shake", "tip_target", "tip_path", "cable_tension_N",
    "forces", "pressure_Pa", "release", "clamp",
)  # fmt: skip
_DRIVEN_BY: Final = ("cable_length_m", "cable_shortening_m", "control", "pump_pressure_Pa")


def section_range(scenario: Scenario, plan: Plan, soft: SoftSide, arm: Arm | None, touched: bool) -> Decision:
    """Return whether the soft arm stays within its model's range, as far as the plan knows where it is.

    Args:
        scenario: checked.
        plan: of the run.
        soft: at its start; its state is used up.
        arm: kinematics; None where the flange stands still.
        touched: whether contact is modelled, which may hold the arm: what is found is then said, not refused.

    Raises:
        ScenarioError: it leaves the range, and the film does not take over there; `path` names the key that
            takes it there.
    """
    try:
        known = _Walk(scenario, plan, soft, arm).through()
    except ScenarioError as error:
        if scenario.hands_over and isinstance(error.__cause__, OutOfRangeError):
            place = error.__cause__.place
            return Decision(SECTION_RANGE, False, f"{place}; the film takes over there", "model.handover")
        if not touched:
            raise
        return Decision(SECTION_RANGE, False, f"{error.faults[0][1]}; contact is not in this", error.path)
    return Decision(SECTION_RANGE, True, f"{known} bears the plan's loads and accelerations", "fidelity")


@final
class _Walk:
    """Follows the arm's equilibrium through a plan."""

    def __init__(self, scenario: Scenario, plan: Plan, soft: SoftSide, arm: Arm | None) -> None:
        self._plan, self._soft, self._arm = plan, soft, arm
        self._commanded = bool(scenario.commands)
        self._dynamic = scenario.mode == "dynamic"
        self._gas = ChamberGas(scenario.gas)

    def through(self) -> str:
        """Return how far the plan knows where the arm will be; it stays in its range there."""
        here = None
        for planned in self._plan.phases:
            name = planned.phase.name
            if self._commanded or any(getattr(planned.phase, key) for key in _DRIVEN_BY):
                return f"up to phase '{name}', in which devices or commands drive it, the arm"
            try:
                here = self._phase(planned, here or self._start())
            except OutOfRangeError as error:
                raise _refused_phase(planned.phase, error) from error
            except ConvergenceError:
                return f"up to phase '{name}', in which it loses its equilibrium, the arm"
            if self._gas.flows:
                return f"up to the end of phase '{name}', in which gas flows, the arm"
        return "the arm"

    def _start(self) -> Equilibrium:
        plan = self._plan
        try:
            here = start_equilibrium(self._soft, plan.start, loads_of(plan.command, plan.gravity))
        except OutOfRangeError as error:
            raise ScenarioError("start", _refusal(f"the arm is{_RANGE}{error.place}")) from error
        self._soft.settle(here)
        return here

    def _phase(self, planned: PhasePlan, here: Equilibrium) -> Equilibrium:
        planned.holding.apply(self._soft, here.world_from_flange)
        self._gas.begin(planned.gas, self._soft)
        self._check_swing(planned, here)
        still = planned.joints.spline is None and planned.begin is planned.end and not self._gas.flows
        for fraction in np.linspace(0.0, 1.0, 1 if still else _PIECES + 1).tolist():
            here = self._at(planned, here, fraction)
            self._soft.settle(here)
        return here

    def _at(
        self, planned: PhasePlan, here: Equilibrium, fraction: float, less: Array | None = None
    ) -> Equilibrium:
        """Return the equilibrium at a fraction of a phase, gravity less an acceleration (3,) [m/s^2]."""
        pose = here.world_from_flange
        if self._arm is not None and planned.joints.spline is not None:
            pose = self._arm.forward(planned.joints.at(Progress(fraction, 0.0, 0.0)).position)
        command = self._gas.between(planned.begin, planned.end, fraction)
        gravity = np.array(self._plan.gravity)
        x, y, z = (gravity if less is None else gravity - less).tolist()
        return self._soft.follow(here, pose, loads_of(command, (x, y, z)))

    def _check_swing(self, planned: PhasePlan, here: Equilibrium) -> None:
        """Raise where the flange's motion makes the arm swing out of its range.

        Raises:
            ScenarioError: it does.
        """
        found = FlangeAcceleration.of(self._arm, planned) if self._arm and self._dynamic else None
        size = float(np.linalg.norm(self._plan.gravity))
        if found is None or 2.0 * float(np.linalg.norm(found.largest)) < _SLOW * size:
            return
        here = self._at(planned, here, 0.0)
        fraction, swing = found.swing(self._rate(planned, here, found.largest))
        for part in np.linspace(0.0, fraction, _PIECES + 1).tolist():
            here = self._at(planned, here, part)
        try:
            self._at(planned, here, fraction, swing)
        except OutOfRangeError as error:
            largest = float(np.linalg.norm(found.largest))
            text = f"accelerates the flange by up to {largest:.3g} m/s^2; the arm swings{_RANGE}{error.place}"
            key = f"phase.{planned.phase.name}.duration_s"
            raise ScenarioError(key, _refusal(f"{text}; take longer")) from error
        except ConvergenceError:
            return

    def _rate(self, planned: PhasePlan, here: Equilibrium, along: Array) -> float:
        """Return the rate [rad/s] of the arm's first mode along a direction, from its deflection."""
        probe = _PROBE * 9.81
        moved = self._at(planned, here, 0.0, probe * along / np.linalg.norm(along))
        body = self._soft.body
        shift = body.tip_position(moved.state.positions) - body.tip_position(here.state.positions)
        return float(np.sqrt(_FIRST_MODE * probe / max(float(np.linalg.norm(shift)), 1e-9)))


def _refusal(text: str) -> str:
    others = "fidelity = 'lumped', which knows what lies beyond, or 'auto'"
    return f"{text}; or model.handover = true, by which the film takes over there, {others}"


def _refused_phase(phase: PhaseTable, error: OutOfRangeError) -> ScenarioError:
    """Return the refusal of a phase: by the one key that moves the arm, or by all of them."""
    given = [key.replace("forces", "force") for key in _MOVED_BY if getattr(phase, key)]
    path = ["phase", phase.name, *(given if len(given) == 1 else ())]
    by = f", by {' and '.join(given)}," if len(given) > 1 else ""
    return ScenarioError(".".join(path), _refusal(f"takes the arm{by}{_RANGE}{error.place}"))


_FEWEST, _MOST, _PER_KNOT = 50, 1000, 2  # samples of a phase in which the arm moves
_INSIDE = 1e-9  # share of a phase between its border and what counts as within
_STANDS_IN_M = 1e-3  # an arm that stands no deeper than this touches
_SAME_rad = 1e-3  # joints of one configuration


@final
@dataclass(frozen=True)
class AskedMotion:
    """What a plan asks of the joints at some instants; at `jumps` the reference's speed or place jumps.

    Args:
        time_s: (n,), in order.
        phase: (n,) index.
        joints: n instants.
        jumps: (n,) bool; speed and acceleration are then those of a jump within a tick.
    """

    time_s: Array
    phase: IntArray
    joints: JointReference
    jumps: Mask


def planned_arm(
    arm: Arm,
    scene: RigidScene,
    plan: Plan,
    payload: Payload,
    clearances: PathClearances | None,
    *,
    dynamic: bool,
) -> PlannedArm:
    """Return what a plan asks of an arm.

    Torques are those of the arm with a rigid payload; jumps of the reference do not count in them.

    Args:
        arm: kinematics and inverse dynamics.
        scene: at its start.
        plan: of the run.
        payload: the soft robot in its drawn shape and what else is mounted.
        clearances: on that way; None where they are not looked at.
        dynamic: whether the motion takes time; positions and torques at rest otherwise.
    """
    limits, names = ArmLimits.of(arm), tuple(planned.phase.name for planned in plan.phases)
    asked = asked_motion(plan, scene.tick_s)
    q, v, a = asked.joints.position, asked.joints.velocity, asked.joints.acceleration
    moving, still = np.zeros_like(q), np.zeros(arm.joint_count)
    for k in range(len(q)):
        timed = dynamic and not asked.jumps[k]
        moving[k] = arm.inverse_dynamics(
            q[k], v[k] if timed else still, a[k] if timed else still, scene.armature, payload
        )
    values = {"position": q, "velocity": v, "acceleration": a, "torque": moving}
    asked_for = values if dynamic else {"position": q, "torque": moving}
    found = [limits.extreme(name, rows, asked.time_s, asked.phase) for name, rows in asked_for.items()]
    return PlannedArm(limits, tuple(extreme for extreme in found if extreme is not None), clearances, names)


def asked_motion(plan: Plan, tick_s: float) -> AskedMotion:
    """Return what a plan asks of the joints, at instants close enough together to find the largest values.

    Args:
        plan: of a run.
        tick_s: within which a jump of the reference happens [s].
    """
    rows: list[tuple[Array, int, JointReference, bool]] = []
    began_s, here, speed = 0.0, plan.joints, np.zeros_like(plan.joints)
    for index, planned in enumerate(plan.phases):
        phase = planned.phase
        time_s, joints = _through(planned)
        first, last = joints.row(0), joints.row(-1)
        jump = JointReference(
            here, first.velocity + (first.position - here) / tick_s, (first.velocity - speed) / tick_s
        )
        rows.append((np.array([began_s]), index, jump, True))
        rows.append((began_s + time_s, index, joints, False))
        here, speed = planned.joints.last, last.velocity
        if phase.settle_s > 0.0:
            end_s = np.array([began_s + phase.duration_s])
            rows.append((end_s, index, JointReference(here, last.velocity, -speed / tick_s), True))
            speed = np.zeros_like(here)
        began_s += phase.duration_s + phase.settle_s
    return AskedMotion(
        np.concatenate([time_s for time_s, _, _, _ in rows]),
        np.concatenate([np.full(len(time_s), index) for time_s, index, _, _ in rows]),
        JointReference(*(
            np.concatenate([np.atleast_2d(getattr(joints, name)) for _, _, joints, _ in rows])
            for name in ("position", "velocity", "acceleration")
        )),
        np.concatenate([np.full(len(time_s), jumps) for time_s, _, _, jumps in rows]),
    )  # fmt: skip


def _through(planned: PhasePlan) -> tuple[Array, JointReference]:
    """Return times (n,) within a phase, and what is asked for then."""
    phase, path = planned.phase, planned.joints
    count = 2
    if path.spline is not None:
        count = min(max(_FEWEST, _PER_KNOT * len(path.spline.x)), _MOST)
    time_s = phase.duration_s * np.clip(np.linspace(0.0, 1.0, count), _INSIDE, 1.0 - _INSIDE)
    return time_s, path.through([progress(phase.ramp, t, phase.duration_s) for t in time_s.tolist()])


def drawn_payload(body: SoftBody, mounted: MassProperties | None) -> Payload:
    """Return a soft robot in its drawn shape, and what else is mounted (flange frame), as a rigid payload."""
    from cosim.kinematics.arm import Payload  # here: a scene without an arm does not wait for Pinocchio

    mass = MassProperties.of(body.node_mass, body.positions)
    if mounted is not None:
        mass = mass.joined(mounted)
    return Payload(mass.mass_kg, mass.center, mass.inertia)


def checked_start(plan_joints: JointPlanner, arm: Arm, scene: RigidScene, payload: Payload) -> JointPlanner:
    """Return a planner that refuses a start at which the arm cannot stand.

    Args:
        plan_joints: finds the joint angles.
        arm: kinematics and inverse dynamics.
        scene: at its start.
        payload: see `planned_arm`.
    """

    def plan(start: Pose, ways: list[AnyWay], blame: Callable[[int], str]) -> tuple[JointPath, ...]:
        paths = plan_joints(start, ways, blame)
        check_start(arm, scene, payload, paths[0].first, blame(-1))
        return paths

    return plan


def check_start(arm: Arm, scene: RigidScene, payload: Payload, joints: Array, key: str) -> None:
    """Check that an arm can stand where it starts.

    Args:
        arm: kinematics and inverse dynamics.
        scene: at its start.
        payload: see `planned_arm`.
        joints: (joints,) [rad].
        key: to blame.

    Raises:
        ScenarioError: a link is in something, or a joint takes more torque than it can give.
    """
    check_stands(touched_by_links(scene, joints), key)
    torque, limit = arm.gravity_torque(joints, payload), arm.effort_limit
    beyond = [k for k in range(len(torque)) if abs(torque[k]) > limit[k] > 0.0]
    if beyond:
        needs = ", ".join(f"{arm.joint_names[k]} {abs(torque[k]):.0f} of {limit[k]:g} N m" for k in beyond)
        raise ScenarioError(
            key,
            f"the arm cannot hold itself and a payload of {payload.mass_kg:.3g} kg: {needs}; bring the "
            "flange closer in, or make the load lighter",
        )


def touched_by_links(scene: RigidScene, joints: Array) -> list[LinkContact]:
    """Return the contacts of an arm's links at joint angles (joints,), but those with other arms.

    Where other arms begin is known once all have been planned.
    """
    return [one for one in scene.links.at(joints) if not one.other.startswith(scene.other_arms)]


def stands_clear(scene: RigidScene, paths: Sequence[JointPath]) -> bool:
    """Return whether the links of an arm are in nothing where its joint paths begin; see `check_stands`."""
    return not _overlaps(touched_by_links(scene, paths[0].first))


def avoided_start(scene: RigidScene, begins: Array, nearest: Array) -> str:
    """Return in what links would be at the start nearest to home; empty for nothing, or if it begins there.

    Args:
        scene: with the arm.
        begins: (joints,) [rad].
        nearest: (joints,) [rad], the configuration nearest to the arm's home.
    """
    if np.abs(begins - nearest).max() <= _SAME_rad:
        return ""
    return _overlaps(touched_by_links(scene, nearest))


def _overlaps(contacts: Sequence[LinkContact]) -> str:
    """Return which links are in what, in words; empty if none is."""
    deep = [contact for contact in contacts if contact.depth_m > _STANDS_IN_M]
    return ", ".join(f"{c.link} {1e3 * c.depth_m:.0f} mm deep in {c.other}" for c in deep)


def check_stands(contacts: Sequence[LinkContact], key: str) -> None:
    """Check that links of an arm are in nothing, where it starts.

    Args:
        contacts: there.
        key: to blame.

    Raises:
        ScenarioError: a link is in something.
    """
    if where := _overlaps(contacts):
        raise ScenarioError(
            key, f"the arm overlaps something: {where}; move the flange, the base of an arm or the objects"
        )


def check_base(scene: RigidScene, body: SoftBody, flange: Pose, depth_m: float) -> None:
    """Check that the held end of a soft robot is not inside something that stands still.

    Args:
        scene: at its start.
        body: on the flange.
        flange: where it starts, world.
        depth_m: up to which it may be inside.

    Raises:
        ScenarioError: a held node is deeper; the film beside it could only be torn out of there.
    """
    query = scene.contact_query(fixed_only=True)
    hits = query.distances(flange.apply(body.positions[body.base]), -depth_m)
    if len(hits.distance):
        k = int(np.argmin(hits.distance))
        other = scene.body_names[int(query.body[hits.shape[k]])]
        raise ScenarioError(
            "start.flange",
            f"the soft robot's base stands {-1e3 * hits.distance[k]:.2f} mm deep in {other}; move the flange "
            "or the objects",
        )

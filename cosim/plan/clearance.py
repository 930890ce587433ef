"""What is around an arm: whether it can stand where a run begins, and what comes near on its planned way.

At the start its links are checked against the scene, its joints against its weight.

How near links and soft robot come to what is around them along a planned way, before anything runs.

Solids are measured only where they may be nearer than is asked: a pair that was d apart is at least d less
what both have moved since. A point at r in a body moves by |dx| + ||dR|| r at most.

Film hardly stretches: a node is no farther from the base than the shortest way to it along the drawn mesh,
times one plus the strain. So the film stays within a ball around the flange's origin, wherever it bends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import TYPE_CHECKING, Final, final

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from cosim.base.frames import Array, IntArray, Pose
from cosim.base.solid import LinkContact, Solid
from cosim.config.schema.settings import PlanTable
from cosim.coupling.soft_sides.soft_side import MassProperties
from cosim.errors import ScenarioError
from cosim.plan.arm_limits import Nearest, PathClearances, Touch, nearer, with_touches
from cosim.plan.asked_motion import AskedMotion, asked_motion
from cosim.plan.motion import CellMotion, JointPath, progress
from cosim.plan.plan import Plan
from cosim.plan.planning import AnyWay, JointPlanner, flange_key
from cosim.soft.body.body import SoftBody
from cosim.soft.geometry.surface import directed_edges

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.scene import RigidScene


SOFT_ROBOT: Final = "soft robot"
_FEWEST: Final = 100  # instants of a phase in which a cell moves


def path_clearances(
    scene: RigidScene,
    plan: Plan,
    body: SoftBody,
    settings: PlanTable,
    cell: CellMotion | None = None,
    *,
    film_touches: bool,
) -> PathClearances | None:
    """Return how near to one another a planned way brings things; None where that is not asked for.

    The soft robot is carried in its drawn shape. Objects that can move are left out: where they will be is
    not known.

    Args:
        scene: with the arm and what is around it.
        plan: of the run.
        body: of the soft robot, on the flange.
        settings: of the plan.
        cell: how its joints move; None where it has none.
        film_touches: whether the run models what the soft robot touches; it may then come as near as it does.
    """
    if settings.collision == "off":
        return None
    found = scene.links.solids()
    film = Solid(
        found.flange, SOFT_ROBOT, "surface", vertices=body.positions, triangles=np.asarray(body.triangles)
    )
    solids = (*found.solids, film)
    carried = np.append(found.carried, len(found.solids))
    among = _Watch(solids, found.among_links)
    links, soft = (_Watch(solids, _pairs(chosen, found.others)) for chosen in (found.links, carried))
    touches: tuple[Touch, ...] = ()
    bound = settings.clearance_m
    for time_s, phase, joints, moved in _instants(plan, scene.tick_s, cell):
        places, when = scene.dynamics.places(joints, moved), (time_s, phase)
        near = [*among.nearer_than(0.0, *places, *when), *links.nearer_than(bound, *places, *when)]
        hit = list(soft.nearer_than(bound, *places, *when))
        touches = with_touches(touches, near if film_touches else near + hit, *when)
    return PathClearances(touches, links.nearest, soft.nearest)


@final
@dataclass(frozen=True)
class ArmOnItsWay:
    """One of several arms in a scene, on its planned way.

    Args:
        scene: with all arms, as this one is planned in it.
        plan: of the arm.
        body: of its soft robot.
    """

    scene: RigidScene
    plan: Plan
    body: SoftBody

    @property
    def asked(self) -> AskedMotion:
        """What the plan asks of the joints."""
        return asked_motion(self.plan, self.scene.tick_s)

    def solids(self) -> tuple[Solid, ...]:
        """Return what moves with the arm, its film the last one."""
        found = self.scene.links.solids()
        film = Solid(
            found.flange, self.scene.description.prefix + SOFT_ROBOT, "surface",
            vertices=self.body.positions, triangles=np.asarray(self.body.triangles),
        )  # fmt: skip
        return (*(found.solids[k] for k in (*found.links, *found.carried)), film)

    def places(self, time_s: Array) -> Iterator[tuple[Array, Array]]:
        """Yield where all bodies are at instants, as `ArmDynamics.places`: of other arms, some place."""
        asked = self.asked
        joints = [np.interp(time_s, asked.time_s, each) for each in asked.joints.position.T]
        return map(self.scene.dynamics.places, np.stack(joints, axis=1))


def clearances_to_others(
    found: PathClearances | None,
    own: ArmOnItsWay,
    others: Sequence[ArmOnItsWay],
    settings: PlanTable,
    *,
    film_touches: bool,
) -> PathClearances | None:
    """Return what `path_clearances` has found, with how near other arms come at the same time.

    Args:
        found: None where it is not looked at.
        own: the arm that was looked at.
        others: in the same scene.
        settings: of the plan.
        film_touches: whether the run models contact of the soft robot with links; with films it does not.
    """
    for other in others:
        if found is not None:
            found = _with_other(found, own, other, settings.clearance_m, film_touches=film_touches)
    return found


def _with_other(
    found: PathClearances, own: ArmOnItsWay, other: ArmOnItsWay, bound: float, *, film_touches: bool
) -> PathClearances:
    mine, theirs = own.solids(), other.solids()
    solids, film, their_film = (*mine, *theirs), len(mine) - 1, len(mine) + len(theirs) - 1
    their_links = np.arange(len(mine), their_film)
    links = _Watch(solids, _pairs(np.arange(film), their_links))
    soft, films = (_Watch(solids, _pairs(np.array([film]), np.array(x))) for x in (their_links, [their_film]))
    prefix, asked = other.scene.description.prefix, own.asked
    of_other = np.array([name.startswith(prefix) for name in own.scene.body_names])
    time_s = np.union1d(asked.time_s, other.asked.time_s)
    phases = asked.phase[np.searchsorted(asked.time_s, time_s, side="right") - 1]
    touches, ways = found.touches, zip(own.places(time_s), other.places(time_s), strict=True)
    for moment, (here, there) in zip(zip(time_s.tolist(), phases.tolist(), strict=True), ways, strict=True):
        for place, elsewhere in zip(here, there, strict=True):
            place[of_other] = elsewhere[of_other]
        near = [*links.nearer_than(bound, *here, *moment), *films.nearer_than(bound, *here, *moment)]
        hit = list(soft.nearer_than(bound, *here, *moment))
        touches = with_touches(touches, near if film_touches else near + hit, *moment)
    of_soft = nearer(soft.nearest, films.nearest)
    return PathClearances(touches, nearer(found.links, links.nearest), nearer(found.soft_robot, of_soft))


def keeps_clear(scene: RigidScene, clearance_m: float, paths: Sequence[JointPath]) -> bool:
    """Return whether links touch neither each other nor, within a clearance, what stands still.

    Args:
        scene: with the arm and what is around it; a cell is as in its file.
        clearance_m: of links from what is no part of the robot.
        paths: of the joints; looked at at their knots.
    """
    found = scene.links.solids()
    among, links = (
        _Watch(found.solids, chosen) for chosen in (found.among_links, _pairs(found.links, found.others))
    )
    for path in paths:
        for q in [path.first] if path.spline is None else path.spline(path.spline.x):
            places = scene.dynamics.places(q)
            near = (among.nearer_than(0.0, *places, 0.0, 0), links.nearer_than(clearance_m, *places, 0.0, 0))
            if any(True for watched in near for _ in watched):
                return False
    return True


def check_clearances(clearances: PathClearances | None, plan: Plan, settings: PlanTable) -> None:
    """Check that nothing on a planned way comes nearer than it may, where that is to be refused.

    Raises:
        ScenarioError: something does; the first is named, by the phase that leads to it.
    """
    if clearances is None or settings.collision != "refuse" or not clearances.touches:
        return
    first = min(clearances.touches, key=lambda touch: touch.first_s)
    names = tuple(planned.phase.name for planned in plan.phases)
    others = len(clearances.touches) - 1
    more = f" (and {others} more)" if others else ""
    raise ScenarioError(
        flange_key(plan.phases[first.phase].phase),
        f"{first.text(names)}{more}; lead the flange around it, move the obstacle, or run all the same "
        "with plan.collision = 'warn'",
    )


def _instants(
    plan: Plan, tick_s: float, cell: CellMotion | None
) -> Iterator[tuple[float, int, Array, Array | None]]:
    """Yield time, phase, joints of the arm and those of the cell, close enough together to miss nothing."""
    if cell is None:
        asked = asked_motion(plan, tick_s)
        yield from zip(asked.time_s.tolist(), asked.phase.tolist(), asked.joints.position, repeat(None))
        return
    began_s = 0.0
    for index, planned in enumerate(plan.phases):
        phase, path = planned.phase, planned.joints
        length_s = phase.duration_s + phase.settle_s
        count = max(_FEWEST, 0 if path.spline is None else 2 * len(path.spline.x))
        for time_s in np.linspace(0.0, length_s, count).tolist():
            joints = path.at(progress(phase.ramp, time_s, phase.duration_s)).position
            yield began_s + time_s, index, joints, cell.at(index, time_s)[0]
        began_s += length_s


def _pairs(ones: IntArray, others: IntArray) -> IntArray:
    return np.stack(np.meshgrid(ones, others), axis=-1).reshape(-1, 2)


@final
class _Watch:
    """Watches pairs of solids along a way; `nearest` is the nearest that any has come so far."""

    def __init__(self, solids: tuple[Solid, ...], pairs: IntArray) -> None:
        from cosim.kinematics.arm import Clearance  # here: a scene without an arm does not wait for it

        self._solids, self._pairs = solids, pairs
        self._clearance = Clearance(solids)
        self._body = np.array([solid.body for solid in solids])
        self._radius = np.array([solid.radius_m for solid in solids])
        self._least = np.full(len(pairs), -np.inf)  # distance below which a pair is not
        self._places: tuple[Array, Array] | None = None
        self.nearest: Nearest | None = None

    def nearer_than(
        self, bound_m: float, positions: Array, rotations: Array, time_s: float, phase: int
    ) -> Iterator[LinkContact]:
        """Yield the pairs that are nearer than a bound, with bodies as for `Clearance.at`."""
        self._least -= self._moved(positions, rotations)[self._pairs].sum(axis=1)
        self._places = positions, rotations
        between = self._clearance.at(positions, rotations)
        for k in np.argsort(self._least).tolist():
            seen = np.inf if self.nearest is None else self.nearest.distance_m
            if self._least[k] >= max(bound_m, seen):
                return
            one, other = self._pairs[k].tolist()
            self._least[k] = distance = between(one, other)
            names = self._solids[one].name, self._solids[other].name
            if distance < seen:
                self.nearest = Nearest(*names, distance, time_s, phase)
            if distance < bound_m:
                yield LinkContact(*names, -distance, movable=False)

    def _moved(self, positions: Array, rotations: Array) -> Array:
        """Return how far points of each solid have moved at most since the last instant [m]."""
        if self._places is None:
            return np.zeros(len(self._solids))
        before, axes = self._places
        shifted = np.linalg.norm(positions - before, axis=1)
        turned = np.linalg.norm(rotations - axes, axis=(1, 2))
        return np.asarray(shifted[self._body] + turned[self._body] * self._radius)


_SAMPLES = 60  # of a phase
_AWAY_M = 0.05  # from the planned way: lag of the servos, droop
_STRAIN = 0.05  # beside what the pressure makes
_PRESSURE_FACTOR = 4.0  # of the film's mean stress: it is larger at corners, and pressure overshoots


@final
@dataclass(frozen=True)
class FlangeTravel:
    """The planned way of the flange.

    Args:
        positions: (k, 3) [m], of its origin.
        gap_m: largest distance between two samples; shaking adds its stroke.
        acceleration_m_s2: largest of the end of a lever along the flange's axis, step ramps left out.
    """

    positions: Array
    gap_m: float
    acceleration_m_s2: float


def flange_travel(arm: Arm, plan: Plan, lever_m: float = 0.0) -> FlangeTravel:
    """Return where the planned joint paths take the flange's origin, and what accelerations they ask for.

    Args:
        arm: kinematics.
        plan: of the run.
        lever_m: length of the lever along the flange's z axis, at whose end accelerations are taken.
    """
    positions, gap, largest = [], 0.0, 0.0
    for planned in plan.phases:
        phase, path = planned.phase, planned.joints
        if phase.flange_shake is not None:
            shake = phase.flange_shake
            gap = max(gap, 2.0 * shake.amplitude_m)
            largest = max(largest, shake.amplitude_m * (2.0 * np.pi * shake.frequency_Hz) ** 2)
        if path.spline is None:
            positions.append(arm.forward(path.first).translation[None])
            continue
        times = np.linspace(0.0, phase.duration_s, _SAMPLES)
        ramp = "linear" if phase.ramp == "step" else phase.ramp  # a servo goes through what lies between
        asked = path.through([progress(ramp, t, phase.duration_s) for t in times])
        poses = [arm.forward(joints) for joints in asked.position]
        x = np.array([pose.translation for pose in poses])
        positions.append(x)
        gap = max(gap, float(np.linalg.norm(np.diff(x, axis=0), axis=1).max()))
        if phase.ramp == "smooth":
            ends = x + lever_m * np.array([pose.rotation[:, 2] for pose in poses])
            second = np.diff(ends, n=2, axis=0) / (times[1] - times[0]) ** 2
            largest = max(largest, float(np.linalg.norm(second, axis=1).max()))
    return FlangeTravel(np.concatenate(positions), gap, largest)


def film_reach(body: SoftBody, pressure_Pa: float) -> float:
    """Return a distance [m] from the flange's origin that no node of the film exceeds.

    Args:
        body: in the flange frame.
        pressure_Pa: largest gauge pressure.
    """
    # plates lead from one film to the next
    plates = [nodes for plate in body.plates for nodes in plate.rings]
    spokes = [np.column_stack([np.full(len(nodes) - 1, nodes[0]), nodes[1:]]) for nodes in plates]
    x, edges = body.positions, np.concatenate([directed_edges(body.triangles), *spokes])
    length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    graph = csr_matrix((length, (edges[:, 0], edges[:, 1])), shape=(len(x),) * 2)
    way = dijkstra(graph, directed=False, indices=body.base, min_only=True)
    least = min(entry.film.least_modulus_Pa * entry.film.thickness_m for entry in body.membranes)
    width = float(np.ptp(x, axis=0).max())
    strain = _STRAIN + _PRESSURE_FACTOR * pressure_Pa * width / least
    return float(np.linalg.norm(x[body.base], axis=1).max()) + (1.0 + strain) * float(way.max())


def within_reach(
    scene: RigidScene, travel: FlangeTravel, reach_m: float, *, fixed_only: bool = False
) -> tuple[str, ...]:
    """Return the bodies of a scene at rest that the film may get to.

    Args:
        scene: at its start.
        travel: of the flange.
        reach_m: of the film around it.
        fixed_only: whether to leave out what can move.
    """
    query, x = scene.contact_query(fixed_only=fixed_only), travel.positions
    around = reach_m + 0.5 * travel.gap_m + _AWAY_M
    active = query.near(x.min(axis=0), x.max(axis=0), around)
    if not len(active):
        return ()
    hits = query.distances(x, around, active)
    return scene.bodies.names(np.unique(query.body[hits.shape]))


_STANDS_IN_M = 1e-3  # an arm that stands no deeper than this touches
_SAME_rad = 1e-3  # joints of one configuration


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

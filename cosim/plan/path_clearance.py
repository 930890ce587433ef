"""Clearances of links and soft robot along a planned motion. Distances of a pair are computed only when it
may be near: points of two solids that were d apart are at least d minus the displacement of both apart. A
point at r in a body moves by at most |dx| + ||dR|| r.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.solid import LinkContact, Solid
from cosim.config.schema.settings import PlanTable
from cosim.errors import ScenarioError
from cosim.plan.arm_limits import Nearest, PathClearances, Touch, nearer, with_touches
from cosim.plan.cell_motion import CellMotion
from cosim.plan.joint_path import JointPath
from cosim.plan.plan import Plan
from cosim.plan.ramp import progress
from cosim.plan.required_motion import RequiredMotion, required_motion
from cosim.plan.static_plan import flange_key
from cosim.soft.body.body import SoftBody

if TYPE_CHECKING:
    from cosim.rigid.scene.scene import RigidScene


SOFT_ROBOT: Final = "soft robot"
_FEWEST: Final = 100  # instants of a phase with a moving cell


def path_clearances(
    scene: RigidScene,
    plan: Plan,
    body: SoftBody,
    settings: PlanTable,
    cell: CellMotion | None = None,
    *,
    film_touches: bool,
) -> PathClearances | None:
    """Return the clearances along a planned motion; None if plan.collision = "off".

    The soft robot has its drawn shape. Movable objects are left out, because their motion is unknown.

    Args:
        scene: with the arm and its surroundings.
        plan: of the run.
        body: of the soft robot, on the flange.
        settings: of the plan.
        cell: motion of its joints; None without any.
        film_touches: whether the run models the soft robot's contact; its touches are then not reported.
    """
    if settings.collision == "off":
        return None
    all_solids = scene.links.solids()
    film = Solid(
        all_solids.flange, SOFT_ROBOT, "surface", vertices=body.positions,
        triangles=np.asarray(body.triangles),
    )  # fmt: skip
    solids, others = (*all_solids.solids, film), all_solids.others
    carried = np.append(all_solids.carried, len(all_solids.solids))
    among = _PairDistances(solids, all_solids.among_links)
    links, soft = (_PairDistances(solids, _pairs(each, others)) for each in (all_solids.links, carried))
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
class PlannedArmMotion:
    """Planned motion of one of several arms in a scene.

    Args:
        scene: of this arm, with all arms.
        plan: of the arm.
        body: of its soft robot.
    """

    scene: RigidScene
    plan: Plan
    body: SoftBody

    @property
    def required(self) -> RequiredMotion:
        """Joint motion that the plan requires."""
        return required_motion(self.plan, self.scene.tick_s)

    def solids(self) -> tuple[Solid, ...]:
        """Return the solids that move with the arm, the film as the last one."""
        all_solids = self.scene.links.solids()
        film = Solid(
            all_solids.flange, self.scene.description.prefix + SOFT_ROBOT, "surface",
            vertices=self.body.positions, triangles=np.asarray(self.body.triangles),
        )  # fmt: skip
        return (*(all_solids.solids[k] for k in (*all_solids.links, *all_solids.carried)), film)

    def places(self, time_s: Array) -> Iterator[tuple[Array, Array]]:
        """Yield the poses of all bodies at instants, see `ArmDynamics.places`; other arms do not move."""
        required = self.required
        joints = [np.interp(time_s, required.time_s, each) for each in required.joints.position.T]
        return map(self.scene.dynamics.places, np.stack(joints, axis=1))


def clearances_to_others(
    found: PathClearances | None,
    own: PlannedArmMotion,
    others: Sequence[PlannedArmMotion],
    settings: PlanTable,
    *,
    film_touches: bool,
) -> PathClearances | None:
    """Return the clearances of `path_clearances` with those to other moving arms.

    Args:
        found: clearances without other arms; None: they are not checked.
        own: motion of the arm that these belong to.
        others: motions of the other arms.
        settings: of the plan.
        film_touches: whether the run models contact of the soft robot with links; with films it does not.
    """
    for other in others:
        if found is not None:
            found = _with_other(found, own, other, settings.clearance_m, film_touches=film_touches)
    return found


def _with_other(
    found: PathClearances, own: PlannedArmMotion, other: PlannedArmMotion, bound: float, *, film_touches: bool
) -> PathClearances:
    mine, theirs = own.solids(), other.solids()
    solids, film, their_film = (*mine, *theirs), len(mine) - 1, len(mine) + len(theirs) - 1
    their_links = np.arange(len(mine), their_film)
    links = _PairDistances(solids, _pairs(np.arange(film), their_links))
    soft, films = (
        _PairDistances(solids, _pairs(np.array([film]), np.array(x))) for x in (their_links, [their_film])
    )
    prefix, required = other.scene.description.prefix, own.required
    of_other = np.array([name.startswith(prefix) for name in own.scene.body_names])
    time_s = np.union1d(required.time_s, other.required.time_s)
    phases = required.phase[np.searchsorted(required.time_s, time_s, side="right") - 1]
    touches, motions = found.touches, zip(own.places(time_s), other.places(time_s), strict=True)
    instants = zip(time_s.tolist(), phases.tolist(), strict=True)
    for instant, (poses, other_poses) in zip(instants, motions, strict=True):
        for part, other_part in zip(poses, other_poses, strict=True):
            part[of_other] = other_part[of_other]
        near = [*links.nearer_than(bound, *poses, *instant), *films.nearer_than(bound, *poses, *instant)]
        hit = list(soft.nearer_than(bound, *poses, *instant))
        touches = with_touches(touches, near if film_touches else near + hit, *instant)
    of_soft = nearer(soft.nearest, films.nearest)
    return PathClearances(touches, nearer(found.links, links.nearest), nearer(found.soft_robot, of_soft))


def keeps_clear(scene: RigidScene, clearance_m: float, paths: Sequence[JointPath]) -> bool:
    """Return whether links touch neither each other nor come nearer than a clearance to fixed bodies.

    Args:
        scene: with the arm and its surroundings; the cell is as in its file.
        clearance_m: of links from other bodies.
        paths: of the joints; checked at their knots.
    """
    all_solids = scene.links.solids()
    among, links = (
        _PairDistances(all_solids.solids, chosen)
        for chosen in (all_solids.among_links, _pairs(all_solids.links, all_solids.others))
    )
    for path in paths:
        for q in [path.first] if path.spline is None else path.spline(path.spline.x):
            places = scene.dynamics.places(q)
            near = (among.nearer_than(0.0, *places, 0.0, 0), links.nearer_than(clearance_m, *places, 0.0, 0))
            if any(True for watched in near for _ in watched):
                return False
    return True


def check_clearances(clearances: PathClearances | None, plan: Plan, settings: PlanTable) -> None:
    """Check the clearances of a plan, if plan.collision = "refuse".

    Raises:
        ScenarioError: one is too small; the message names the first, with its phase.
    """
    if clearances is None or settings.collision != "refuse" or not clearances.touches:
        return
    first = min(clearances.touches, key=lambda touch: touch.first_s)
    names = tuple(planned.phase.name for planned in plan.phases)
    others = len(clearances.touches) - 1
    more = f" (and {others} more)" if others else ""
    raise ScenarioError(
        flange_key(plan.phases[first.phase].phase),
        f"{first.text(names)}{more}; move the flange around it, move the obstacle, or run anyway with "
        "plan.collision = 'warn'",
    )


def _instants(
    plan: Plan, tick_s: float, cell: CellMotion | None
) -> Iterator[tuple[float, int, Array, Array | None]]:
    """Yield time, phase, joints of the arm and those of the cell, at closely spaced instants of a plan."""
    if cell is None:
        required = required_motion(plan, tick_s)
        rows = required.time_s.tolist(), required.phase.tolist(), required.joints.position
        yield from zip(*rows, repeat(None))
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
class _PairDistances:
    """Distances of pairs of solids along a motion; `nearest` is the smallest distance so far."""

    def __init__(self, solids: tuple[Solid, ...], pairs: IntArray) -> None:
        from cosim.kinematics.clearance import Clearance  # imported here so that no arm means no Pinocchio

        self._solids, self._pairs = solids, pairs
        self._clearance = Clearance(solids)
        self._body = np.array([solid.body for solid in solids])
        self._radius = np.array([solid.radius_m for solid in solids])
        self._least = np.full(len(pairs), -np.inf)  # lower bound of each pair's distance
        self._places: tuple[Array, Array] | None = None
        self.nearest: Nearest | None = None

    def nearer_than(
        self, bound_m: float, positions: Array, rotations: Array, time_s: float, phase: int
    ) -> Iterator[LinkContact]:
        """Yield the pairs that are nearer than a bound.

        Args:
            bound_m: bound on the distance [m].
            positions: (bodies, 3) [m], world.
            rotations: (bodies, 3, 3), world from body.
            time_s: instant.
            phase: index of its phase.
        """
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
        """Return a bound (solids,) [m] on the displacement of points of each solid since the last instant."""
        if self._places is None:
            return np.zeros(len(self._solids))
        before, axes = self._places
        shifted = np.linalg.norm(positions - before, axis=1)
        turned = np.linalg.norm(rotations - axes, axis=(1, 2))
        return np.asarray(shifted[self._body] + turned[self._body] * self._radius)

"""How near links and soft robot come to what is around them along a planned way, before anything runs.

Solids are measured only where they may be nearer than is asked: a pair that was d apart is at least d less
what both have moved since. A point at r in a body moves by |dx| + ||dR|| r at most.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.link_contact import LinkContact
from cosim.base.solid import Solid
from cosim.config.schema.solver import PlanTable
from cosim.errors import ScenarioError
from cosim.plan.arm_limits import Nearest, PathClearances, Touch, with_touches
from cosim.plan.arm_plan import asked_motion
from cosim.plan.cell_motion import CellMotion
from cosim.plan.paths.phase_motion import flange_key
from cosim.plan.plan import Plan
from cosim.plan.ramp import progress
from cosim.soft.body.body import SoftBody

if TYPE_CHECKING:
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
        f"{first.text(names)}{more}; lead the flange around it, move what is in the way, or run all the same "
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
        from cosim.kinematics.clearance import Clearance  # here: a scene without an arm does not wait for it

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

"""The film's reach around the flange's path, and the bodies within it. Film hardly stretches, so a node's
distance from the base is at most the shortest path along the drawn mesh, times one plus the strain. So the
film stays within a ball around the flange's origin, however it bends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.base.frames import Array
from cosim.plan.plan import Plan
from cosim.plan.ramp import progress
from cosim.soft.body.body import SoftBody
from cosim.soft.geometry.surface import directed_edges

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm
    from cosim.rigid.scene.scene import RigidScene

_SAMPLES = 60  # of a phase
_AWAY_M = 0.05  # margin for the lag of the servos and droop
_STRAIN = 0.05  # in addition to that of the pressure
_PRESSURE_FACTOR = 4.0  # on the film's mean stress, which is larger at corners; pressure may overshoot


@final
@dataclass(frozen=True)
class FlangeTravel:
    """The planned path of the flange.

    Args:
        positions: (k, 3) [m], of its origin.
        gap_m: largest distance between two samples; shaking adds its stroke.
        acceleration_m_s2: largest of the end of a lever along the flange's axis, step ramps left out.
    """

    positions: Array
    gap_m: float
    acceleration_m_s2: float


def flange_travel(arm: Arm, plan: Plan, lever_m: float = 0.0) -> FlangeTravel:
    """Return the path and the accelerations of the flange's origin along planned joint paths.

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
        ramp = "linear" if phase.ramp == "step" else phase.ramp  # servos pass through the angles between
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
    from scipy.sparse import csgraph, csr_matrix  # imported here because it takes long to load

    # plates connect one film to the next
    plates = [nodes for plate in body.plates for nodes in plate.rings]
    spokes = [np.column_stack([np.full(len(nodes) - 1, nodes[0]), nodes[1:]]) for nodes in plates]
    x, edges = body.positions, np.concatenate([directed_edges(body.triangles), *spokes])
    length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    graph = csr_matrix((length, (edges[:, 0], edges[:, 1])), shape=(len(x),) * 2)
    way = csgraph.dijkstra(graph, directed=False, indices=body.base, min_only=True)
    least = min(entry.film.least_modulus_Pa * entry.film.thickness_m for entry in body.membranes)
    width = float(np.ptp(x, axis=0).max())
    strain = _STRAIN + _PRESSURE_FACTOR * pressure_Pa * width / least
    return float(np.linalg.norm(x[body.base], axis=1).max()) + (1.0 + strain) * float(way.max())


def within_reach(
    scene: RigidScene, travel: FlangeTravel, reach_m: float, *, fixed_only: bool = False
) -> tuple[str, ...]:
    """Return the names of bodies within the film's reach of the flange's path.

    Args:
        scene: at its start.
        travel: path of the flange.
        reach_m: of the film around the flange.
        fixed_only: whether only fixed bodies count.
    """
    query, x = scene.contact_query(fixed_only=fixed_only), travel.positions
    around = reach_m + 0.5 * travel.gap_m + _AWAY_M
    active = query.near(x.min(axis=0), x.max(axis=0), around)
    if not len(active):
        return ()
    hits = query.distances(x, around, active)
    return scene.bodies.names(np.unique(query.body[hits.shape]))

"""Adds contacts between the corners of an object and the bodies on a flange, such as a palm. MuJoCo keeps at
most four contact points of two solids, not the same ones in every tick, and not the deepest ones: an object
that rests on a palm with five corners loses one of them, and newtons with it, every few ticks, and creeps. So
each corner is a point that touches the palm, in addition to MuJoCo's contacts.
"""

from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np

from cosim.base.frames import Array, Pose
from cosim.rigid.build.pair_friction import PairFriction

_POINT_M: Final = 1e-6  # MuJoCo has no points: radius of a sphere
_AROUND: Final = 12  # corners on a cylinder's rim, which is up to 3.4 % of its radius outside of them
_DIRECTIONS: Final = 256  # directions in which corners of a mesh are searched
_GOLDEN: Final = np.pi * (3.0 - np.sqrt(5.0))


def add_corner_contacts(
    spec: mujoco.MjSpec, carried: Sequence[mujoco.MjsBody], touching: mujoco.MjsBody, friction: PairFriction
) -> None:
    """Add contact pairs of the corners of an object with bodies on flanges.

    Args:
        spec: with all these bodies.
        carried: bodies on flanges; their geoms have names, and priority over those of objects.
        touching: an object that can move; its geoms have names.
        friction: of pairs.
    """
    for geom in list(touching.geoms):
        body_from_geom = Pose.from_quaternion(np.array(geom.quat), np.array(geom.pos))
        for k, place in enumerate(body_from_geom.apply(_corners(spec, geom))):
            name = f"{geom.name}/corner {k + 1}"
            # with contact bits of 0 it meets only geoms that are named in a pair
            corner = touching.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, contype=0, conaffinity=0)
            corner.size, corner.pos, corner.mass = [_POINT_M, 0.0, 0.0], place, 0.0
            for body in carried:
                for other in body.geoms:
                    both = other.friction[0], geom.friction[0]
                    _add_pair(spec, other, name, friction.between((body.name, touching.name), both))


def _add_pair(spec: mujoco.MjSpec, carried: mujoco.MjsGeom, corner: str, sliding: float) -> None:
    """Add a contact pair of a corner and a geom, with the geom's parameters and a coefficient of sliding."""
    pair = spec.add_pair(geomname1=carried.name, geomname2=corner)
    _, turning, rolling = carried.friction
    pair.friction = [sliding, sliding, turning, rolling, rolling]
    pair.condim, pair.solref, pair.solimp = carried.condim, carried.solref, carried.solimp


def _corners(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> Array:
    """Return the corners (n, 3) [m] of a geom, geom frame; none for spheres, capsules and ellipsoids."""
    match geom.type:
        case mujoco.mjtGeom.mjGEOM_BOX:
            signs = 2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0
            return np.asarray(signs * geom.size)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            angle = np.arange(_AROUND) * 2.0 * np.pi / _AROUND
            radius, half = geom.size[:2]
            rim = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.full(_AROUND, half)))
            return np.concatenate((rim, rim * (1.0, 1.0, -1.0)))
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _fewer(np.array(spec.mesh(geom.meshname).uservert).reshape(-1, 3))
        case _:
            return np.zeros((0, 3))


def _fewer(vertices: Array) -> Array:
    """Return a subset of vertices (n, 3) [m] whose hull is as close to the others as a cylinder's corners."""
    corners = vertices[np.unique([np.argmax(vertices @ way) for way in _directions(_DIRECTIONS)])]
    centred, reach = corners - corners.mean(axis=0), corners @ _directions(4 * _DIRECTIONS).T
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    across = np.ptp(centred @ axes.T, axis=0)
    least = reach.max(axis=0) - 0.5 * np.median(across) * (1.0 - np.cos(np.pi / _AROUND))
    kept = np.ones(len(corners), dtype=bool)
    for k in range(len(corners)):
        kept[k] = False
        kept[k] = not kept.any() or (reach[kept].max(axis=0) < least).any()
    return np.asarray(corners[kept])


def _directions(count: int) -> Array:
    """Return evenly spread unit vectors (count, 3), on a spiral of golden angles."""
    place = np.arange(count)
    height = 1.0 - (2.0 * place + 1.0) / count
    across = np.sqrt(1.0 - height**2)
    return np.column_stack((across * np.cos(_GOLDEN * place), across * np.sin(_GOLDEN * place), height))

"""Contacts of an object with what the flange carries, at all corners of the object in every tick.

Of two solids MuJoCo keeps four points at most, not the same ones in every tick, and not the deepest ones: an
object that rests on a palm with five corners loses one of them, and with it newtons, every few ticks, and
walks. So its corners are points that touch the palm for themselves, besides what MuJoCo finds.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from cosim.base.frames import Array, Pose

_POINT_M: Final = 1e-6  # MuJoCo knows no points: radius of a sphere
_AROUND: Final = 12  # of a cylinder's rim: between two of them it stands out by 3 % of its radius
_DIRECTIONS: Final = 256  # in which corners of a mesh are looked for
_GOLDEN: Final = np.pi * (3.0 - np.sqrt(5.0))


def add_corner_contacts(spec: mujoco.MjSpec, carried: mujoco.MjsBody, touching: mujoco.MjsBody) -> None:
    """Let the corners of a body touch another one, as the other one's geoms are touched.

    Args:
        spec: holds both.
        carried: on the flange; its geoms have names, and priority over those of objects.
        touching: an object that can move; its geoms have names.
    """
    for geom in list(touching.geoms):
        body_from_geom = Pose.from_quaternion(np.array(geom.quat), np.array(geom.pos))
        for k, place in enumerate(body_from_geom.apply(_corners(spec, geom))):
            name = f"{geom.name}/corner {k + 1}"
            # contact bits of 0: nothing but what is named in a pair meets it
            corner = touching.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, contype=0, conaffinity=0)
            corner.size, corner.pos, corner.mass = [_POINT_M, 0.0, 0.0], place, 0.0
            for other in carried.geoms:
                _add_pair(spec, other, name)


def _add_pair(spec: mujoco.MjSpec, carried: mujoco.MjsGeom, corner: str) -> None:
    """Let a corner touch a geom; the contact is as the geom has it."""
    pair = spec.add_pair(geomname1=carried.name, geomname2=corner)
    sliding, turning, rolling = carried.friction
    pair.friction = [sliding, sliding, turning, rolling, rolling]
    pair.condim, pair.solref, pair.solimp = carried.condim, carried.solref, carried.solimp


def _corners(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> Array:
    """Return corners (n, 3) [m] of a geom in its own frame; none of what is round all over."""
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
            vertices = np.array(spec.mesh(geom.meshname).uservert).reshape(-1, 3)
            return np.asarray(vertices[np.unique([np.argmax(vertices @ way) for way in _directions()])])
        case _:
            return np.zeros((0, 3))


def _directions() -> Array:
    """Return directions (n, 3) that are spread evenly, on a spiral of golden angles."""
    place = np.arange(_DIRECTIONS)
    height = 1.0 - (2.0 * place + 1.0) / _DIRECTIONS
    across = np.sqrt(1.0 - height**2)
    return np.column_stack((across * np.cos(_GOLDEN * place), across * np.sin(_GOLDEN * place), height))

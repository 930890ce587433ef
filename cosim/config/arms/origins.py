"""Poses as URDF writes them: `<origin xyz rpy>`, rotation = Rz(yaw) Ry(pitch) Rx(roll)."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from cosim.base.frames import Array, Pose


def text_of(values: Array) -> str:
    """Return numbers as a text that gives exactly the same numbers when read."""
    return " ".join(repr(float(value)) for value in values)


def add_origin(element: ElementTree.Element, pose: Pose) -> None:
    """Add the origin of a joint, shape or inertia, in its parent's frame."""
    r = pose.rotation
    upright = math.hypot(r[0, 0], r[1, 0])
    roll = math.atan2(r[2, 1], r[2, 2]) if upright > 1e-12 else math.atan2(-r[1, 2], r[1, 1])
    yaw = math.atan2(r[1, 0], r[0, 0]) if upright > 1e-12 else 0.0
    angles = np.array([roll, math.atan2(-r[2, 0], upright), yaw])
    ElementTree.SubElement(element, "origin", xyz=text_of(pose.translation), rpy=text_of(angles))


def origin_of(element: ElementTree.Element) -> Pose:
    """Return the origin of a joint, shape or inertia whose numbers have been checked."""
    origin = element.find("origin")
    if origin is None:
        return Pose()
    xyz, rpy = (np.array([float(w) for w in origin.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return Pose(about_z @ about_y @ about_x, xyz)


def add_inertial(link: ElementTree.Element, mass_kg: float, pose: Pose, principal: Array) -> None:
    """Give a link its inertia.

    Args:
        link: that has none.
        mass_kg: of it.
        pose: of the centre of mass and principal axes, link frame.
        principal: (3,) [kg m^2], moments about these axes.
    """
    inertial = ElementTree.SubElement(link, "inertial")
    add_origin(inertial, pose)
    ElementTree.SubElement(inertial, "mass", value=repr(float(mass_kg)))
    moments = {key: repr(float(value)) for key, value in zip(("ixx", "iyy", "izz"), principal, strict=True)}
    ElementTree.SubElement(inertial, "inertia", moments, ixy="0", ixz="0", iyz="0")

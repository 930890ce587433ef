"""Writes elements of URDF files: joints, inertias, cylinders. MJCF arms, adapters and moving bases are
converted to URDF with them. A pose is `<origin xyz rpy>` with the rotation Rz(yaw) Ry(pitch) Rx(roll).
"""

import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from cosim.base.frames import Array, Pose


def text_of(values: Array) -> str:
    """Return numbers as a text that parses to exactly the same numbers."""
    return " ".join(repr(float(value)) for value in values)


def add_origin(element: ElementTree.Element, pose: Pose) -> None:
    """Add an `<origin>` to a joint, shape or inertia.

    Args:
        element: gets it.
        pose: of the joint, shape or inertia in its parent's frame.
    """
    r = pose.rotation
    upright = math.hypot(r[0, 0], r[1, 0])
    roll = math.atan2(r[2, 1], r[2, 2]) if upright > 1e-12 else math.atan2(-r[1, 2], r[1, 1])
    yaw = math.atan2(r[1, 0], r[0, 0]) if upright > 1e-12 else 0.0
    angles = np.array([roll, math.atan2(-r[2, 0], upright), yaw])
    ElementTree.SubElement(element, "origin", xyz=text_of(pose.translation), rpy=text_of(angles))


def link_of(joint: ElementTree.Element, end: str) -> str:
    """Return the name of a joint's link.

    Args:
        joint: a `<joint>`.
        end: "parent" or "child".
    """
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def add_inertial(link: ElementTree.Element, mass_kg: float, pose: Pose, principal: Array) -> None:
    """Add an `<inertial>` to a link.

    Args:
        link: without an inertia.
        mass_kg: of the link.
        pose: of the centre of mass and principal axes, link frame.
        principal: (3,) [kg m^2], moments of inertia about these axes.
    """
    inertial = ElementTree.SubElement(link, "inertial")
    add_origin(inertial, pose)
    ElementTree.SubElement(inertial, "mass", value=repr(float(mass_kg)))
    moments = {key: repr(float(value)) for key, value in zip(("ixx", "iyy", "izz"), principal, strict=True)}
    ElementTree.SubElement(inertial, "inertia", moments, ixy="0", ixz="0", iyz="0")


def add_joint(
    robot: ElementTree.Element, name: str, kind: str, ends: tuple[str, str], pose: Pose
) -> ElementTree.Element:
    """Add a joint to a robot and return it.

    Args:
        robot: gets the joint.
        name: of the joint.
        kind: "fixed", or one of `cosim.base.arm_file.MOVING`.
        ends: names of the parent link and the child link.
        pose: parent from joint.
    """
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    for end, link in zip(("parent", "child"), ends, strict=True):
        ElementTree.SubElement(joint, end, link=link)
    add_origin(joint, pose)
    return joint


def add_cylinder(link: ElementTree.Element, tag: str, pose: Pose, radius: float, length: float) -> None:
    """Add a cylinder to a link, centred on a pose and along its z axis.

    Args:
        link: gets the cylinder.
        tag: "visual" or "collision".
        pose: of the cylinder, link frame.
        radius: [m].
        length: [m].
    """
    shape = ElementTree.SubElement(link, tag)
    add_origin(shape, pose)
    size = {"radius": repr(float(radius)), "length": repr(float(length))}
    ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "cylinder", size)


def standing_along(axis: Array) -> Array:
    """Return a rotation (3, 3) whose z axis is the unit vector `axis` (3,)."""
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(axis, aside), axis], axis=1)

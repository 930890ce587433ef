"""A rigid piece between an arm's flange and the soft robot."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final

import numpy as np

from cosim.base.frames import Pose
from cosim.config.arms.arm_table import AdapterTable
from cosim.config.arms.origins import add_inertial, add_origin
from cosim.errors import InputError

ADAPTER: Final = "adapter"


def add_adapter(robot: ElementTree.Element, flange: str, adapter: AdapterTable, path: Path) -> str:
    """Add a rigid cylinder from the flange to where soft robots are mounted; return the link there.

    I = m (3 r^2 + l^2) / 12 across its axis and m r^2 / 2 along it.

    Args:
        robot: gets a link and a fixed joint more.
        flange: link that carries it.
        adapter: what it is.
        path: of the arm's file.

    Raises:
        InputError: a link has its name already, or it has a mass but no length.
    """
    if any(link.get("name") == ADAPTER for link in robot.findall("link")):
        raise InputError(f"arm file {path}: a link is called {ADAPTER!r}, so no adapter can be added")
    end = Pose.from_quaternion(np.array(adapter.quaternion), np.array(adapter.position_m))
    length, radius, mass_kg = float(np.linalg.norm(end.translation)), adapter.radius_m, adapter.mass_kg
    link = ElementTree.SubElement(robot, "link", name=ADAPTER)
    joint = ElementTree.SubElement(robot, "joint", name=f"{ADAPTER}_joint", type="fixed")
    ElementTree.SubElement(joint, "parent", link=flange)
    ElementTree.SubElement(joint, "child", link=ADAPTER)
    add_origin(joint, end)
    if length == 0.0 and mass_kg > 0.0:
        raise InputError(f"arm file {path}: an adapter of length 0 has no mass; leave mass_kg out")
    if length == 0.0:
        return ADAPTER
    axis = end.translation / length
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside /= np.linalg.norm(aside)
    standing = np.stack([aside, np.cross(axis, aside), axis], axis=1)
    middle = end.inverse() @ Pose(standing, 0.5 * end.translation)
    if mass_kg > 0.0:
        across, along = mass_kg * (3.0 * radius**2 + length**2) / 12.0, 0.5 * mass_kg * radius**2
        add_inertial(link, mass_kg, middle, np.array([across, across, along]))
    for tag in ("visual", "collision"):
        shape = ElementTree.SubElement(link, tag)
        add_origin(shape, middle)
        size = {"radius": repr(radius), "length": repr(length)}
        ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "cylinder", size)
    return ADAPTER

"""The shapes of an arm's links: their mesh files are found, and what no engine reads is replaced."""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final

import numpy as np

from cosim.base.files_read import note_file
from cosim.base.frames import Pose
from cosim.config.arms.origins import add_origin, origin_of, text_of
from cosim.config.arms.package_files import found_file
from cosim.errors import InputError

_SUFFIXES: Final = (".stl", ".obj", ".msh")
_MOST_TRIANGLES: Final = 200_000  # of an STL file, for MuJoCo
_THINNEST_M: Final = 1e-3


def readable_mesh(path: Path) -> bool:
    """Return whether MuJoCo can read a mesh file, by its ending and, of STL, its length."""
    suffix = path.suffix.lower()
    if suffix != ".stl":
        return suffix in _SUFFIXES
    with path.open("rb") as stream:
        head = stream.read(84)
    count = struct.unpack_from("<I", head, 80)[0] if len(head) == 84 else 0
    return 0 < count <= _MOST_TRIANGLES and path.stat().st_size == 84 + 50 * count


def find_meshes(
    robot: ElementTree.Element, path: Path, package_folders: tuple[Path, ...]
) -> tuple[Path, ...]:
    """Make the mesh files of all links absolute paths, and return them.

    Raises:
        InputError: one is missing.
    """
    found: dict[Path, None] = {}
    for mesh in robot.iter("mesh"):
        try:
            file = found_file(mesh.get("filename", ""), path, package_folders)
        except InputError as error:
            raise InputError(f"arm file {path}: mesh {error}") from None
        mesh.set("filename", str(file))
        note_file(file)
        found[file] = None
    return tuple(found)


def replace_unreadable(robot: ElementTree.Element) -> tuple[str, ...]:
    """Replace collision meshes that MuJoCo cannot read by boxes; return what to say about all of them.

    The box has the mass and the inertia of the link: edges a with a^2 = 6 (I_y + I_z - I_x) / m. A link
    without a mass loses the shape.
    """
    drawn: list[str] = []
    boxes: list[str] = []
    gone: list[str] = []
    for link in robot.findall("link"):
        name = link.get("name", "")
        if any(not _readable(shape) for shape in link.findall("visual")):
            drawn.append(name)
        unread = [shape for shape in link.findall("collision") if not _readable(shape)]
        for shape in unread:
            link.remove(shape)
        if unread:
            (boxes if _add_box(link) else gone).append(name)
    notes = (
        (boxes, "meshes that cannot be read are replaced by boxes of the same inertia"),
        (gone, "meshes that cannot be read are left out"),
        ([name for name in drawn if name not in boxes + gone], "drawn by collision shapes"),
    )
    return tuple(f"{text}: {', '.join(names)}" for names, text in notes if names)


def _readable(shape: ElementTree.Element) -> bool:
    return all(readable_mesh(Path(mesh.get("filename", ""))) for mesh in shape.iter("mesh"))


def _add_box(link: ElementTree.Element) -> bool:
    """Add a box of a link's mass and inertia as its shape; return whether it has any."""
    inertial = link.find("inertial")
    mass, inertia = (None if inertial is None else inertial.find(tag) for tag in ("mass", "inertia"))
    if inertial is None or mass is None or inertia is None or not float(mass.get("value", "0")) > 0.0:
        return False
    xx, yy, zz, xy, xz, yz = (
        float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    squared = 6.0 * (moments.sum() - 2.0 * moments) / float(mass.get("value", "0"))
    edges = np.sqrt(np.maximum(squared, _THINNEST_M**2))
    shape = ElementTree.SubElement(link, "collision")
    add_origin(shape, origin_of(inertial) @ Pose(axes, np.zeros(3)))
    ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "box", size=text_of(edges))
    return True

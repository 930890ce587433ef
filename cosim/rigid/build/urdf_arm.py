"""Reads URDF files, which may come from anybody, within bounds. Parts that MuJoCo does not read are read
here: MuJoCo treats mimic joints, and joints without limits, as free; it ignores speed limits and packages,
and knows few mesh formats.
"""

import copy
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.arm_file import FIXED, MOVING
from cosim.base.files import note_file
from cosim.base.frames import Pose
from cosim.config import packages, xml_files
from cosim.config.arm_files import ArmSource
from cosim.errors import InputError
from cosim.rigid.build import mjcf_files, urdf_elements
from cosim.rigid.build.arm_tree import ROOT, Chain, Way

MOST_LINKS: Final = 500
_XACRO: Final = "ros.org/wiki/xacro"
_KEPT: Final = {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
_SUFFIXES: Final = (".stl", ".obj", ".msh")
_MOST_TRIANGLES: Final = 200_000  # of an STL file, for MuJoCo
_THINNEST_M: Final = 1e-3
_MESH_GREY: Final = "0.80 0.81 0.83 1"


@final
class UrdfArm:
    """The robot of a URDF file.

    Attributes: `tree`, its links as MuJoCo joins them, without masses and shapes.

    Args:
        source: of the arm.

    Raises:
        InputError: the file is missing, too large, no XML, no URDF or no tree, or has xacro macros or a
            number that is not finite.
    """

    def __init__(self, source: ArmSource) -> None:
        self._source, self._robot = source, _read_robot(source.path)
        bare = ElementTree.Element("robot", name="tree")
        for link in self._robot.findall("link"):
            ElementTree.SubElement(bare, "link", link.attrib)
        for joint in self._robot.findall("joint"):
            ends = [end for tag in ("parent", "child") if (end := joint.find(tag)) is not None]
            ElementTree.SubElement(bare, "joint", joint.attrib).extend(ends)
        self.tree = urdf_spec(bare, source.path)

    def chain_to(self, way: Way) -> Chain:
        """Return the chain to the flange; hands, fingers and helper frames off it are left out.

        Raises:
            InputError: a joint is of a type that is not handled, or mimics another one.
        """
        robot, path, links = self._robot, self._source.path, {ROOT, *way.bodies}
        left_out = []
        for element in list(robot):
            moved = urdf_elements.link_of(element, "child") if element.tag == "joint" else element.get("name")
            if element.tag in ("link", "joint") and moved in links:
                continue
            if element.tag != "material":
                robot.remove(element)
            masses = [mass.get("value", "0").strip() for mass in element.iter("mass")]
            if element.tag == "link" and any(mass not in ("0", "0.0") for mass in masses):
                left_out.append(element.get("name", ""))
        joints = {urdf_elements.link_of(joint, "child"): joint for joint in robot.findall("joint")}
        chain = tuple(joints[body] for body in way.bodies if body in joints)
        for joint in chain:
            where = f"arm file {path}: joint {joint.get('name')!r}"
            if (kind := joint.get("type")) not in (FIXED, *MOVING):
                handled = ", ".join((FIXED, *MOVING))
                raise InputError(f"{where} is {kind!r:.80}; the chain to the flange may hold {handled}")
            if joint.find("mimic") is not None:
                raise InputError(
                    f"{where}: it mimics another joint; the joints to the flange must move by themselves"
                )
        return Chain(robot, chain, way.flange, files=(path,), left_out=tuple(left_out))


def urdf_spec(robot: ElementTree.Element, path: Path) -> mujoco.MjSpec:
    """Return MuJoCo's specification of a robot, with all links as bodies.

    Raises:
        InputError: MuJoCo refuses it; the message names the file.
    """
    options = ElementTree.Element("mujoco")
    ElementTree.SubElement(options, "compiler", _KEPT)
    robot.append(options)
    text = ElementTree.tostring(robot, encoding="unicode")
    robot.remove(options)
    with mjcf_files.refusals(f"arm file {path}", lines=False):
        return mujoco.MjSpec.from_string(text)


def _read_robot(path: Path) -> ElementTree.Element:
    robot = xml_files.read_xml(path)
    if path.suffix == ".xacro" or any(_XACRO in element.tag for element in robot.iter()):
        plain = path.with_suffix("") if path.suffix == ".xacro" else path.with_suffix(".plain.urdf")
        shown = plain if plain.suffix == ".urdf" else plain.with_suffix(".urdf")
        raise InputError(
            f"arm file {path} holds xacro macros, which are not expanded here; expand them first: "
            f"xacro {path.name} > {shown.name}"
        )
    if robot.tag != "robot":
        raise InputError(
            f"arm file {path} is no URDF: its first element is <{robot.tag}>, not <robot>; an MJCF file "
            "ends in .xml"
        )
    count = len(robot.findall("link"))
    if count > MOST_LINKS:
        raise InputError(f"arm file {path} has {count} links; at most {MOST_LINKS} are read")
    for element in robot.iter():
        mjcf_files.check_numbers(element, f"arm file {path}")
    if not robot.get("name"):
        robot.set("name", path.stem)  # Pinocchio needs one
    for inertia in robot.iter("inertia"):
        for key in ("ixy", "ixz", "iyz"):
            inertia.set(key, inertia.get(key, "0"))
    return robot


def find_meshes(robot: ElementTree.Element, source: ArmSource) -> tuple[Path, ...]:
    """Make the mesh files of all links absolute paths, and return them.

    Raises:
        InputError: one is missing.
    """
    found: dict[Path, None] = {}
    for mesh in robot.iter("mesh"):
        try:
            file = packages.resolve_file(mesh.get("filename", ""), source.path, source.package_folders)
        except InputError as error:
            raise InputError(f"arm file {source.path}: mesh {error}") from None
        mesh.set("filename", str(file))
        note_file(file)
        found[file] = None
    return tuple(found)


def replace_unreadable(robot: ElementTree.Element, model: mujoco.MjModel) -> tuple[str, ...]:
    """Replace meshes that MuJoCo cannot read; return notes on them.

    Visual shapes are replaced by the link's collision shapes, collision shapes by a box of the link's mass
    and inertia; a link without mass loses the shape.

    Args:
        robot: whose meshes are absolute paths.
        model: of it, compiled without shapes.
    """
    drawn: list[str] = []
    boxes: list[str] = []
    gone: list[str] = []
    for link in robot.findall("link"):
        name = link.get("name", "")
        unread = [shape for shape in link.findall("collision") if not _readable(shape)]
        for shape in unread:
            link.remove(shape)
        if unread:
            (boxes if _add_box(link, model) else gone).append(name)
        if not all(map(_readable, link.findall("visual"))):
            _draw_by_collision(link)
            drawn.append(name)
    notes = (
        (boxes, "meshes that cannot be read are replaced by boxes of the same inertia"),
        (gone, "meshes that cannot be read are left out"),
        ([name for name in drawn if name not in boxes + gone], "drawn by collision shapes"),
    )
    return tuple(f"{text}: {', '.join(names)}" for names, text in notes if names)


def _draw_by_collision(link: ElementTree.Element) -> None:
    for shape in link.findall("visual"):
        link.remove(shape)
    for shape in link.findall("collision"):
        drawn = copy.deepcopy(shape)
        drawn.tag = "visual"
        material = ElementTree.SubElement(drawn, "material", name="link")
        ElementTree.SubElement(material, "color", rgba=_MESH_GREY)
        link.append(drawn)


def _readable(shape: ElementTree.Element) -> bool:
    """Return whether MuJoCo can read a shape's meshes, by their endings and, of STL, their length."""
    return all(_readable_mesh(Path(mesh.get("filename", ""))) for mesh in shape.iter("mesh"))


def _readable_mesh(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix != ".stl":
        return suffix in _SUFFIXES
    with path.open("rb") as stream:
        head = stream.read(84)
    count = struct.unpack_from("<I", head, 80)[0] if len(head) == 84 else 0
    return 0 < count <= _MOST_TRIANGLES and path.stat().st_size == 84 + 50 * count


def _add_box(link: ElementTree.Element, model: mujoco.MjModel) -> bool:
    """Give a link a box of edges a, a^2 = 6 (I_y + I_z - I_x) / m; return whether it has a mass."""
    body = model.body(link.get("name", ""))
    mass, moments = float(body.mass[0]), body.inertia
    if not mass > 0.0:
        return False
    edges = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / mass, _THINNEST_M**2))
    shape = ElementTree.SubElement(link, "collision")
    urdf_elements.add_origin(shape, Pose.from_quaternion(body.iquat, body.ipos))
    ElementTree.SubElement(
        ElementTree.SubElement(shape, "geometry"), "box", size=urdf_elements.text_of(edges)
    )
    return True

"""The chain of a URDF from its root to the flange: joints checked, shapes of links found.

Checks what joints and links of a chain say, so that a refusal names them before any engine reads it.

The shapes of an arm's links: their mesh files are found, and what no engine reads is replaced.
"""

import struct
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from cosim.base.arm_file import FIXED, MOVING
from cosim.base.files import note_file
from cosim.base.frames import Array, Pose
from cosim.config import arm_table, robot_tree
from cosim.errors import InputError

FLANGE_NAMES: Final = ("attachment_site", "tool0", "flange")
MOST_JOINTS: Final = 10
_MOST_NAMED: Final = 6


def flange_of(robot: ElementTree.Element, given: str | None, path: Path) -> tuple[str, str]:
    """Return the link that is the flange, and how it was found.

    Args:
        robot: one tree.
        given: its name; None: see `FLANGE_NAMES`, also as the end of one name only, such as left_tool0; else
            the last link before the chain branches into several that move, or ends.
        path: of the file.

    Raises:
        InputError: there is no such link.
    """
    names = [link.get("name", "") for link in robot.findall("link")]
    if given is not None:
        if given not in names:
            raise InputError(f"arm file {path} has no link {given!r}; there are {', '.join(names)}")
        return given, "as asked for"
    for wanted in FLANGE_NAMES:
        if wanted in names:
            return wanted, "by its name"
    for wanted in FLANGE_NAMES:
        ending = [name for name in names if name.endswith(f"_{wanted}")]
        if len(ending) == 1:
            return ending[0], "by the end of its name"
    return _last_link(robot), "the last link before the chain branches or ends"


def chain_to(robot: ElementTree.Element, flange: str, path: Path) -> list[ElementTree.Element]:
    """Return the joints from the root to the flange.

    Raises:
        InputError: a joint is of a type that is not handled, none moves, or too many do.
    """
    joint_above = {robot_tree.link_of(joint, "child"): joint for joint in robot.findall("joint")}
    chain: list[ElementTree.Element] = []
    link = flange
    while link in joint_above:
        joint = joint_above[link]
        if joint.get("type") not in (FIXED, *MOVING):
            raise InputError(
                f"arm file {path}: joint {joint.get('name')!r} is {joint.get('type')!r:.80}; "
                f"the chain to the flange may hold {', '.join((FIXED, *MOVING))}"
            )
        chain.insert(0, joint)
        link = robot_tree.link_of(joint, "parent")
    moving = moving_joints(chain)
    if not 1 <= len(moving) <= MOST_JOINTS:
        names = ", ".join(repr(joint.get("name")) for joint in moving[:MOST_JOINTS]) or "none"
        raise InputError(
            f"arm file {path}: {len(moving)} joints move the flange {flange!r}, {names}; "
            f"it must be 1 to {MOST_JOINTS}; {_other_flanges(robot)}"
        )
    return chain


def moving_joints(chain: list[ElementTree.Element]) -> list[ElementTree.Element]:
    """Return the joints of a chain that are not fixed."""
    return [joint for joint in chain if joint.get("type") != FIXED]


def _other_flanges(robot: ElementTree.Element) -> str:
    """Return what to do about a flange that too few or too many joints move: the ends of usable chains."""
    ends = _usable_ends(robot)
    if not ends:
        return f"no other link is moved by 1 to {MOST_JOINTS} joints either"
    named = ", ".join(f"{name!r} ({count})" for name, count in ends[:_MOST_NAMED])
    more = f" and {len(ends) - _MOST_NAMED} others" if len(ends) > _MOST_NAMED else ""
    return f"name another link as flange in an arm.toml, such as (joints that move it): {named}{more}"


def _usable_ends(robot: ElementTree.Element) -> list[tuple[str, int]]:
    """Return the links that 1 to `MOST_JOINTS` joints move, and none beyond them, most joints first."""
    joint_above = {robot_tree.link_of(joint, "child"): joint for joint in robot.findall("joint")}

    def count(link: str) -> int:
        """Return how many joints move a link; -1 where one of a type that is not handled does."""
        kinds = []
        while link in joint_above:
            kinds.append(joint_above[link].get("type"))
            link = robot_tree.link_of(joint_above[link], "parent")
        return -1 if {*kinds} - {FIXED, *MOVING} else sum(kind != FIXED for kind in kinds)

    counts = {link.get("name", ""): count(link.get("name", "")) for link in robot.findall("link")}
    usable = {link: moved for link, moved in counts.items() if 1 <= moved <= MOST_JOINTS}
    inner = {robot_tree.link_of(joint_above[link], "parent") for link in usable}
    return sorted(((link, usable[link]) for link in usable if link not in inner), key=lambda end: -end[1])


def _last_link(robot: ElementTree.Element) -> str:
    """Return the link after which no joint moves, or several branches have joints that move."""
    below: dict[str, list[ElementTree.Element]] = {}
    above: dict[str, ElementTree.Element] = {}
    for joint in robot.findall("joint"):
        below.setdefault(robot_tree.link_of(joint, "parent"), []).append(joint)
        above[robot_tree.link_of(joint, "child")] = joint
    moving = set[ElementTree.Element]()  # joints that move, or lead to one
    for joint in above.values():
        way: ElementTree.Element | None = None if joint.get("type") == FIXED else joint
        while way is not None and way not in moving:
            moving.add(way)
            way = above.get(robot_tree.link_of(way, "parent"))
    children = above.keys()
    link = next(name for each in robot.findall("link") if (name := each.get("name", "")) not in children)
    while True:
        joints = below.get(link, [])
        ahead = [joint for joint in joints if joint in moving]
        if len(ahead) > 1:
            return link
        if not ahead and len(joints) != 1:  # beyond the last joint, a row of frames leads to the flange
            return link
        link = robot_tree.link_of((ahead or joints)[0], "child")


_LARGEST: Final = {"xyz": 100.0, "rpy": 1e4, "mass": 1e5, "inertia": 1e7, "limit": 1e7}
_AXES: Final = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_SINGLE: Final = (
    "parent", "child", "origin", "axis", "limit", "dynamics", "inertial", "mass", "inertia", "geometry"
)  # fmt: skip
_SIZES: Final[Mapping[str, Mapping[str, int]]] = {
    "box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1}, "mesh": {},
}  # fmt: skip
_ROUNDING: Final = 1e-9
_LIGHTEST_kg: Final = 1e-9
_LEAST_INERTIA_kg_m2: Final = 1e-12


def check_chain(robot: ElementTree.Element, chain: list[ElementTree.Element], path: Path) -> None:
    """Check origins, axes, limits, masses and inertias of a chain.

    Raises:
        InputError: a number is missing, no number, not finite or too large; a joint has no axis or no limits;
            what a joint moves has no mass, or an inertia that no body has.
    """
    links = {link.get("name", ""): link for link in robot.findall("link")}
    carrier, mass_kg = "", np.inf
    root = robot_tree.link_of(chain[0], "parent")
    _checked_mass(links[root], f"arm file {path}: link {root!r}", moves=False, alone=False)
    for name in (root, *(robot_tree.link_of(joint, "child") for joint in chain)):
        _check_once(links[name], f"arm file {path}: link {name!r}")
        _check_shapes(links[name], f"arm file {path}: link {name!r}")
    for joint in chain:
        name = joint.get("name", "")
        _check_once(joint, f"arm file {path}: joint {name!r}")
        _check_joint(joint, f"arm file {path}: joint {name!r}")
        if joint.get("type") != FIXED:
            _check_carried(carrier, mass_kg, path)
            carrier, mass_kg = name, 0.0
        link = robot_tree.link_of(joint, "child")
        where, alone = f"arm file {path}: link {link!r}", joint.get("type") != FIXED
        mass_kg += _checked_mass(links[link], where, moves=bool(carrier), alone=alone)
    _check_carried(carrier, mass_kg, path)


def numbers(
    element: ElementTree.Element | None, key: str, count: int, default: str, where: str, kind: str = "limit"
) -> Array:
    """Return the numbers of an attribute.

    Args:
        element: that may have it.
        key: the attribute.
        count: how many there must be.
        default: text that replaces it where it is missing; empty: it must be there.
        where: for messages.
        kind: of number, which says how large it may be.

    Raises:
        InputError: it is missing, holds no finite numbers, not so many, or too large ones.
    """
    text = default if element is None else element.get(key, default)
    if not text:
        raise InputError(f"{where}: {key} is missing")
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        raise InputError(f"{where}: {key} {text!r:.80} is no number") from None
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{where}: {key} is {text!r:.80}; it must be {count} finite numbers")
    if np.abs(values).max() > _LARGEST[kind]:
        raise InputError(f"{where}: {key} {text!r:.80} is too large; at most {_LARGEST[kind]:g}")
    return values


def _check_once(element: ElementTree.Element, where: str) -> None:
    """Raise InputError where a part of a joint or link, of which there is one, stands twice."""
    for parent in (element, *element):
        tags = Counter(part.tag for part in parent if part.tag in _SINGLE)
        for tag, count in tags.items():
            if count > 1:
                raise InputError(f"{where}: has <{tag}> {count} times")


def _check_joint(joint: ElementTree.Element, where: str) -> None:
    _check_origin(joint, where)
    if joint.get("type") == FIXED:
        return
    if joint.find("mimic") is not None:
        raise InputError(
            f"{where}: it mimics another joint; the joints to the flange must move by themselves"
        )
    axis = joint.find("axis")
    if np.linalg.norm(numbers(axis, "xyz", 3, "1 0 0" if axis is None else "", where, "xyz")) < _ROUNDING:
        raise InputError(f"{where}: its axis is zero")
    limit = joint.find("limit")
    for key in ("effort", "velocity"):
        if numbers(limit, key, 1, "0", where)[0] < 0.0:
            raise InputError(f"{where}: its {key} limit is negative")
    dynamics = joint.find("dynamics")
    for key in ("damping", "friction"):
        if numbers(dynamics, key, 1, "0", where)[0] < 0.0:
            raise InputError(f"{where}: its {key} is negative")
    if joint.get("type") == "continuous":
        return
    if limit is None:
        raise InputError(
            f"{where}: has no <limit>; give lower, upper, effort and velocity, or make it 'continuous'"
        )
    lower, upper = (float(numbers(limit, key, 1, "0", where)[0]) for key in ("lower", "upper"))
    if not lower < upper:
        raise InputError(f"{where}: its limits leave no way: lower {lower:g}, upper {upper:g}")


def _check_origin(element: ElementTree.Element, where: str) -> None:
    origin = element.find("origin")
    numbers(origin, "xyz", 3, "0 0 0", where, "xyz")
    numbers(origin, "rpy", 3, "0 0 0", where, "rpy")


def _checked_mass(link: ElementTree.Element, where: str, *, moves: bool, alone: bool) -> float:
    """Return the mass of a link [kg], once it has been checked with its inertia; 0 where it has none.

    Args:
        link: of the chain.
        where: for messages.
        moves: whether a joint comes before it.
        alone: whether it hangs on a moving joint itself, so that it may not be a point.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0
    _check_origin(inertial, f"{where}: inertial")
    mass_kg = float(numbers(inertial.find("mass"), "value", 1, "", f"{where}: mass", "mass")[0])
    if mass_kg < 0.0:
        raise InputError(f"{where}: its mass is {mass_kg:g} kg; it must not be negative")
    tensor = inertial.find("inertia")
    defaults = [""] * 3 + ["0"] * 3
    six = [
        float(numbers(tensor, key, 1, default, f"{where}: inertia", "inertia")[0])
        for key, default in zip(_AXES, defaults, strict=True)
    ]
    if not moves:
        return mass_kg
    xx, yy, zz, xy, xz, yz = six
    principal = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if mass_kg == 0.0 and not any(six):
        return 0.0
    shown = ", ".join(f"{value:.3g}" for value in principal)
    if not (mass_kg > 0.0 and principal[0] >= -_ROUNDING * principal[2]):
        raise InputError(
            f"{where}: mass {mass_kg:g} kg and principal moments of inertia {shown} kg m^2 must be above 0"
        )
    if alone and not (mass_kg >= _LIGHTEST_kg and principal[0] >= _LEAST_INERTIA_kg_m2):
        raise InputError(
            f"{where}: mass {mass_kg:g} kg and principal moments of inertia {shown} kg m^2 are too small for "
            f"what hangs on a joint: at least {_LIGHTEST_kg:g} kg and {_LEAST_INERTIA_kg_m2:g} kg m^2"
        )
    if principal[0] + principal[1] < principal[2] * (1.0 - _ROUNDING):
        raise InputError(
            f"{where}: no body has the principal moments of inertia {shown} kg m^2: the largest is more than "
            "the sum of the others"
        )
    return mass_kg


def _check_carried(joint: str, mass_kg: float, path: Path) -> None:
    if mass_kg == 0.0:
        raise InputError(
            f"arm file {path}: joint {joint!r} moves nothing that has a mass; give the <inertial> of the "
            "links up to the next joint"
        )


def _check_shapes(link: ElementTree.Element, where: str) -> None:
    """Check that each shape of a link is one of those that a URDF may have, and has a size.

    Raises:
        InputError: it is not, or has none.
    """
    for shape in (*link.findall("visual"), *link.findall("collision")):
        _check_origin(shape, f"{where}: {shape.tag}")
        geometry = shape.find("geometry")
        solids = [] if geometry is None else list(geometry)
        if len(solids) != 1 or solids[0].tag not in _SIZES:
            raise InputError(f"{where}: a <{shape.tag}> needs one of {', '.join(_SIZES)} in its <geometry>")
        for key, count in _SIZES[solids[0].tag].items():
            if not (numbers(solids[0], key, count, "", f"{where}: {solids[0].tag}", "xyz") > 0.0).all():
                raise InputError(f"{where}: {key} of a {solids[0].tag} must be above 0")


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
            file = robot_tree.found_file(mesh.get("filename", ""), path, package_folders)
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
    arm_table.add_origin(shape, arm_table.origin_of(inertial) @ Pose(axes, np.zeros(3)))
    ElementTree.SubElement(ElementTree.SubElement(shape, "geometry"), "box", size=arm_table.text_of(edges))
    return True

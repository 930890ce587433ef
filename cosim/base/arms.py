"""Arms by name: finds the URDF file and reduces it to the chain from the root to the flange.

The reduced text is the one source of the MuJoCo and the Pinocchio model, so both see the same arm.
"""

from __future__ import annotations

import math
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path

import numpy as np

from cosim.base.frames import Array
from cosim.base.resources import robots_directory
from cosim.errors import InputError

_DATA_PACKAGE = "example-robot-data"
_FIXED, _MOVING = ("fixed",), ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class ArmFile:
    """An arm, ready to be given to both engines.

    Args:
        name: as asked for.
        urdf_path: file that it was read from.
        urdf: URDF text of the chain from the root to the flange, mesh files as absolute paths.
        flange_frame: link whose frame is the flange: origin in the mounting face, z out of it.
        joint_names: the moving joints, base to flange.
        home: (joints,) [rad], a configuration far from singularities.
        acceleration_bound: (joints,) [rad/s^2], not negative, beyond which a motion is reported; joints left
            out have none.
    """

    name: str
    urdf_path: Path
    urdf: str
    flange_frame: str
    joint_names: tuple[str, ...]
    home: Array
    acceleration_bound: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        home = np.array(self.home, dtype=np.float64)
        if home.shape != (len(self.joint_names),):
            raise InputError(
                f"arm {self.name!r} has {len(self.joint_names)} joints {self.joint_names}, "
                f"but its home has {home.size} angles"
            )
        bound = np.full(len(home), np.inf)
        given = np.asarray(self.acceleration_bound, dtype=np.float64)[: len(bound)]
        if not (given > 0.0).all():
            raise InputError(f"arm {self.name!r}: bounds of joint acceleration {given} must be above 0")
        bound[: len(given)] = given
        for name, values in (("home", home), ("acceleration_bound", bound)):
            values.setflags(write=False)
            object.__setattr__(self, name, values)


@dataclass(frozen=True)
class _Entry:
    """Where an arm lies below its folder of robots, and what its URDF does not say."""

    path: str
    flange_frame: str
    home: tuple[float, ...]
    acceleration: tuple[float, ...] = ()


_UR_ACCELERATION = (np.deg2rad(800.0),) * 6  # no limit is published; assumed as for the UR5e
_UR_HOME = (0.0, -0.5 * np.pi, 0.5 * np.pi, -0.5 * np.pi, -0.5 * np.pi, 0.0)
_OWN_ARMS = {"ur5e": _Entry("ur5e/ur5e.urdf", "tool0", _UR_HOME)}
_PACKAGED_ARMS = {
    "ur3": _Entry("ur_description/urdf/ur3_robot.urdf", "tool0", _UR_HOME, _UR_ACCELERATION),
    "ur5": _Entry("ur_description/urdf/ur5_robot.urdf", "tool0", _UR_HOME, _UR_ACCELERATION),
    "ur10": _Entry("ur_description/urdf/ur10_robot.urdf", "tool0", _UR_HOME, _UR_ACCELERATION),
    "panda": _Entry(
        "panda_description/urdf/panda.urdf",
        "panda_link8",
        (0.0, -0.25 * np.pi, 0.0, -0.75 * np.pi, 0.0, 0.5 * np.pi, 0.25 * np.pi),
        (
            15.0,
            7.5,
            10.0,
            12.5,
            15.0,
            20.0,
            20.0,
        ),  # the maker's limits, from its manual
    ),
}


def arm_names() -> tuple[str, ...]:
    """Return the names that `find_arm` knows."""
    return tuple(sorted({**_OWN_ARMS, **_PACKAGED_ARMS}))


def find_arm(name: str) -> ArmFile:
    """Return the arm of a name.

    Args:
        name: one of `arm_names()`.

    Raises:
        InputError: unknown name, or the file is missing or not usable.
    """
    packages: tuple[Path, ...] = ()
    if name in _OWN_ARMS:
        entry, folder = _OWN_ARMS[name], robots_directory()
    elif name in _PACKAGED_ARMS:
        share = _packaged_share()
        entry, folder, packages = _PACKAGED_ARMS[name], share / _DATA_PACKAGE / "robots", (share,)
    else:
        raise InputError(f"unknown arm {name!r}; there are {', '.join(arm_names())}")
    arm = read_arm(folder / entry.path, entry.flange_frame, entry.home, name=name, package_folders=packages)
    return replace(arm, acceleration_bound=np.array(entry.acceleration)) if entry.acceleration else arm


def read_arm(
    path: Path,
    flange_frame: str,
    home: tuple[float, ...],
    *,
    name: str | None = None,
    package_folders: tuple[Path, ...] = (),
) -> ArmFile:
    """Return the arm of a URDF file; only the chain from the root to the flange is kept.

    The bound of a joint's acceleration is the attribute `acceleration` of its `<limit>`, if there is one.
    Hands, fingers and helper frames off the chain are left out: the flange carries the soft robot.

    Args:
        path: URDF file.
        flange_frame: link whose frame is the flange.
        home: (joints,) [rad].
        name: the file's stem unless given.
        package_folders: where the NAME of `package://NAME/...` is looked for.

    Raises:
        InputError: file, flange, package or mesh missing, text not XML, or a joint type not handled.
    """
    robot = _parsed(path)
    joints = _chain(robot, flange_frame, path)
    links = {flange_frame} | {_link_of(joint, "parent") for joint in joints}
    for element in list(robot):
        is_link = element.tag == "link" and element.get("name") in links
        if not (is_link or element in joints or element.tag == "material"):
            robot.remove(element)
    for mesh in robot.iter("mesh"):
        mesh.set("filename", str(_resolved(mesh.get("filename", ""), path, package_folders)))
    moving = [joint for joint in joints if joint.get("type") in _MOVING]
    text = ElementTree.tostring(robot, encoding="unicode")
    names = tuple(joint.get("name", "") for joint in moving)
    bound = np.array([_acceleration_bound(joint, path) for joint in moving])
    return ArmFile(name or path.stem, path, text, flange_frame, names, np.array(home), bound)


def _parsed(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except FileNotFoundError:
        raise InputError(f"arm file {path} does not exist") from None
    except ElementTree.ParseError as error:
        raise InputError(f"arm file {path} is not XML: {error}") from None


def _chain(robot: ElementTree.Element, flange: str, path: Path) -> list[ElementTree.Element]:
    """Return the joints from the root to the flange."""
    names = [link.get("name", "") for link in robot.findall("link")]
    if flange not in names:
        raise InputError(f"arm file {path} has no link {flange!r}; there are {', '.join(names)}")
    joint_above = {_link_of(joint, "child"): joint for joint in robot.findall("joint")}
    chain: list[ElementTree.Element] = []
    link = flange
    while link in joint_above:
        joint = joint_above[link]
        if joint.get("type") not in _FIXED + _MOVING:
            raise InputError(
                f"arm file {path}: joint {joint.get('name')!r} is {joint.get('type')!r}; "
                f"the chain to the flange may hold {', '.join(_FIXED + _MOVING)}"
            )
        chain.insert(0, joint)
        link = _link_of(joint, "parent")
    return chain


def _link_of(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _acceleration_bound(joint: ElementTree.Element, path: Path) -> float:
    """Return the attribute `acceleration` of a joint's limit [rad/s^2]; infinite without one."""
    limit = joint.find("limit")
    text = None if limit is None else limit.get("acceleration")
    try:
        return math.inf if text is None else float(text)
    except ValueError:
        where = f"arm file {path}: joint {joint.get('name')!r}"
        raise InputError(f"{where}: acceleration {text!r} is no number") from None


def _resolved(filename: str, urdf: Path, package_folders: tuple[Path, ...]) -> Path:
    """Return the absolute path of a mesh named in a URDF."""
    if not filename.startswith("package://"):
        candidates = [urdf.parent / filename.removeprefix("file://")]
    else:
        candidates = [folder / filename.removeprefix("package://") for folder in package_folders]
    for candidate in candidates:
        if candidate.is_file():
            return candidate.resolve()
    looked = ", ".join(map(str, candidates)) or "no package folder given"
    raise InputError(f"arm file {urdf}: mesh {filename!r} not found (looked for {looked})")


def _packaged_share() -> Path:
    """Return the folder that holds the folder example-robot-data."""
    candidates = [Path(sys.prefix) / "share"]
    try:
        files = metadata.distribution(_DATA_PACKAGE)
        candidates.insert(0, Path(str(files.locate_file("cmeel.prefix/share"))))
    except metadata.PackageNotFoundError:
        pass
    for candidate in candidates:
        if (candidate / _DATA_PACKAGE / "robots").is_dir():
            return candidate
    raise InputError(
        f"the arms {', '.join(sorted(_PACKAGED_ARMS))} are read from the package {_DATA_PACKAGE}, "
        f"which is not installed; install it or use {', '.join(sorted(_OWN_ARMS))}"
    )

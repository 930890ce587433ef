"""Reads an arm from its URDF or MJCF file and its `arm.toml`. MuJoCo parses and checks the file. Links and
joints from the root to the flange become one URDF, which MuJoCo and Pinocchio both read.
"""

import copy
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from typing import Final

import mujoco
import numpy as np

from cosim.base.arm_file import FIXED, ArmFile
from cosim.base.frames import Array, Pose
from cosim.config import arm_files
from cosim.config.arm_files import ArmSource
from cosim.errors import InputError
from cosim.rigid.build import mjcf_files, mounting
from cosim.rigid.build.arm_tree import Chain, way_to_flange
from cosim.rigid.build.mjcf_arm import MjcfArm
from cosim.rigid.build.urdf_arm import UrdfArm, find_meshes, replace_unreadable, urdf_spec

LEFT_OUT: Final = "left out, because not on the way to the flange"
_MOST: Final = 1e7
"""Of lengths, masses and inertias [m, kg]: engines do not compute with every finite number."""
_FILLED: Final = ("effort", "velocity")
_UNBOUNDED: Final = ("acceleration", "inf")


def read_arm(source: ArmSource) -> ArmFile:
    """Return the arm of a URDF or MJCF file; only the chain from the root to the flange is kept.

    The bound of a joint's acceleration is the attribute `acceleration` of its `<limit>`, if there is one.
    Hands, fingers and helper frames off the chain are left out: the flange carries the soft robot.

    Raises:
        InputError: MuJoCo refuses the file; the flange, a package or a mesh is missing; the type of a joint
            is not supported; a list of the `arm.toml` does not have one possible value per joint.
    """
    robot = MjcfArm(source) if source.is_mjcf else UrdfArm(source)
    with mjcf_files.refusals(f"arm file {source.path}"):  # such as duplicate names
        way = way_to_flange(robot.tree, source.table.flange, source.path)
    chain = robot.chain_to(way)
    moving = [joint for joint in chain.joints if joint.get("type") != FIXED]
    names = tuple(joint.get("name", "") for joint in moving)
    _write_limits(moving, names, source)
    limits = np.array([_limits_of(joint, source) for joint in moving])
    model = _compiled(chain.robot, source)
    meshes = find_meshes(chain.robot, source)
    notes = [f"flange '{way.flange}', {way.how}"]
    notes += ["home from its keyframe"] if chain.home is not None else []
    notes += replace_unreadable(chain.robot, model)
    notes += [f"{LEFT_OUT}: {', '.join(chain.left_out)}"] if chain.left_out else []
    for key, values in (("effort", limits[:, 2]), ("velocity", limits[:, 3])):
        unbounded = [name for name, value in zip(names, values, strict=True) if value == 0.0]
        if unbounded:
            notes.append(f"no {key} limit in the file, so none is checked: {', '.join(unbounded)}")
    arm = _arm_of(chain, names, limits, source)
    files = (*source.files, *chain.files, *meshes)
    notes += arm_files.assumed(source.table.limits.assumed)
    return mounting.on_moving_base(replace(arm, files=files, notes=tuple(notes)), source.table.base)


def _arm_of(chain: Chain, names: tuple[str, ...], limits: Array, source: ArmSource) -> ArmFile:
    """Return the arm of a chain with the values of its `arm.toml`, without its moving base.

    Args:
        chain: with its limits.
        names: of its joints that move.
        limits: (joints, 5), see `_limits_of`.
        source: of the arm.
    """
    table, flange = source.table, chain.flange
    home, known = _home(chain, names, limits, source)
    if table.adapter is not None:
        flange = mounting.add_adapter(chain.robot, flange, table.adapter, source.path)
    armature = _of_joints(table.servos.armature, "servos.armature", names, source)
    if armature is None:
        armature = np.zeros(0) if chain.armature is None else chain.armature
    return ArmFile(
        source.name,
        source.path,
        ElementTree.tostring(chain.robot, encoding="unicode"),
        flange,
        names,
        home,
        limits[:, 4],
        armature,
        _of_joints(table.servos.stiffness, "servos.stiffness", names, source),
        _of_joints(table.servos.damping, "servos.damping", names, source),
        Pose.from_quaternion(np.array(table.base.quaternion), np.array(table.base.position_m)),
        home_known=known,
        shapes=chain.shapes,
        drawn_as=table.drawn_as,
    )


def _write_limits(moving: list[ElementTree.Element], names: tuple[str, ...], source: ArmSource) -> None:
    """Replace limits of joints by those of an `arm.toml`."""
    limits = source.table.limits
    for key in ("lower", "upper", "velocity", "acceleration", "effort"):
        values = _of_joints(getattr(limits, key), f"limits.{key}", names, source)
        for joint, value in zip(moving, () if values is None else values.tolist(), strict=False):
            _limit_of(joint).set(key, repr(value))
    given = [key for key in ("lower", "upper") if getattr(limits, key) is not None]
    for joint in moving:
        if joint.get("type") != "continuous" or not given:
            continue
        if len(given) == 1:
            raise InputError(
                f"{_where(joint, source)}: turns without limits; limits.{given[0]} alone bounds one side "
                "only, give both"
            )
        joint.set("type", "revolute")


def _limits_of(joint: ElementTree.Element, source: ArmSource) -> list[float]:
    """Return the limits of a joint: lower, upper, effort, speed, acceleration; 0 for no effort or speed.

    MuJoCo does not read the last two, and ignores the limits of a joint with an empty range.

    Raises:
        InputError: one is no number, effort or speed is negative, acceleration is not positive, or the
            range is empty.
    """
    limit, where, found = _limit_of(joint), _where(joint, source), []
    for key, default in (("lower", "0"), ("upper", "0"), *((key, "0") for key in _FILLED), _UNBOUNDED):
        text = limit.get(key, default)
        try:
            found.append(float(text))
        except ValueError:
            raise InputError(f"{where}: {key} {text!r:.80} is no number") from None
        if key in _FILLED and found[-1] < 0.0:
            raise InputError(f"{where}: its {key} limit is {found[-1]:g}; give at least 0 (0: no limit)")
        if key == _UNBOUNDED[0] and not found[-1] > 0.0:
            raise InputError(f"{where}: its {key} limit is {found[-1]:g}; give one above 0, or leave it out")
    for key in _FILLED:  # engines refuse joints without them
        limit.set(key, limit.get(key, "0"))
    if joint.get("type") == "continuous":
        found[:2] = -np.inf, np.inf
    if not found[0] < found[1]:
        raise InputError(
            f"{where}: its limits leave no way: lower {found[0]:g}, upper {found[1]:g}; give them in its "
            "<limit>, or make it 'continuous'"
        )
    return found


def _compiled(robot: ElementTree.Element, source: ArmSource) -> mujoco.MjModel:
    """Return the compiled model of links and joints without shapes, which MuJoCo checks.

    Raises:
        InputError: it refuses them, or a length, mass or inertia is more than `_MOST`.
    """
    bare = copy.deepcopy(robot)
    for link in bare.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    where = f"arm file {source.path}"
    model = mjcf_files.compiled(urdf_spec(bare, source.path), where, lines=False)
    for name in ("body_pos", "body_ipos", "body_mass", "body_inertia"):
        rows = np.abs(getattr(model, name)).reshape(model.nbody, -1).max(axis=1)
        if rows.max() > _MOST:
            body = model.body(int(rows.argmax())).name
            raise InputError(f"{where}: link {body!r}: {name} {rows.max():g} is too large; at most {_MOST:g}")
    return model


def _limit_of(joint: ElementTree.Element) -> ElementTree.Element:
    """Return the limit of a joint, added if it has none."""
    found = joint.find("limit")
    return ElementTree.SubElement(joint, "limit") if found is None else found


def _where(joint: ElementTree.Element, source: ArmSource) -> str:
    return f"arm file {source.path}: joint {joint.get('name')!r}"


def _of_joints(
    values: tuple[float, ...] | None, key: str, names: tuple[str, ...], source: ArmSource
) -> Array | None:
    """Return a list of `arm.toml` as (joints,); None if it is left out."""
    if values is not None and len(values) != len(names):
        raise InputError(
            f"arm {source.name!r}: {key} has {len(values)} entries; there are {len(names)} joints: "
            f"{', '.join(names)}"
        )
    return None if values is None else np.array(values, dtype=np.float64)


def _home(chain: Chain, names: tuple[str, ...], limits: Array, source: ArmSource) -> tuple[Array, bool]:
    """Return the home of an arm, and whether a file gives it; if not, it is 0, clipped to the limits."""
    given, (lower, upper) = _of_joints(source.table.home, "home", names, source), limits[:, :2].T
    home = chain.home if given is None else given
    if home is None:
        return np.clip(np.zeros(len(names)), lower, upper), False
    outside = (home < lower) | (home > upper)
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"arm file {source.path}: joint {names[k]!r}: its home {home[k]:g} is outside its limits, "
            f"{lower[k]:g} to {upper[k]:g}; set home in an arm.toml"
        )
    return home, True

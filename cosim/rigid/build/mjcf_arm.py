"""Reads an arm from MuJoCo's own format: the chain of bodies to the flange, and the shapes of links.

Shapes of an arm's links from a compiled MuJoCo model, and back into a specification.

Links and joints become those of a URDF, which both engines are given; the shapes of the links are kept as
they are. Link frames are those of the bodies, moved to their joints.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.arm_file import FIXED, ArmFile, LinkShape
from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.config.arms.arm_files import LEFT_OUT, ArmSource, Chain, arm_of, check_limited_chain
from cosim.config.arms.arm_table import add_inertial, add_joint, text_of
from cosim.config.arms.chain import FLANGE_NAMES
from cosim.errors import InputError
from cosim.rigid.build.description import VISUAL_GROUP
from cosim.rigid.build.mjcf_files import read_mjcf_file
from cosim.rigid.build.object_bodies import GEOM_TYPES, SHAPES, mesh_of

_GEOMETRY_KINDS: Final = {GEOM_TYPES[name]: name for name in SHAPES}
_HIDDEN_GROUP: Final = 3


def link_shapes(model: mujoco.MjModel, bodies: list[int], names: list[str]) -> tuple[LinkShape, ...]:
    """Return the shapes of bodies, in the frames of their links.

    What does not collide is drawn; a body that has nothing but what collides, is drawn by that. Planes and
    height fields belong to no link and are left out.

    Args:
        model: compiled.
        bodies: from the base to the flange.
        names: of their links.
    """
    shapes = []
    for body, name in zip(bodies, names, strict=True):
        first = int(model.body_jntadr[body])
        anchor = np.zeros(3) if first < 0 else model.jnt_pos[first]
        geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
        touched = {geom: bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) for geom in geoms}
        for geom, collides in touched.items():
            kind = _GEOMETRY_KINDS.get(mujoco.mjtGeom(model.geom_type[geom]))
            if kind is None:
                continue
            pose = Pose.from_quaternion(model.geom_quat[geom], model.geom_pos[geom] - anchor)
            drawn = not collides or all(touched.values())
            material, size = int(model.geom_matid[geom]), model.geom_size[geom].copy()
            colour = (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]).astype(np.float64)
            mesh = mesh_of(model, geom) if kind == "mesh" else _NO_MESH
            shapes.append(LinkShape(name, kind, size, pose, colour, collides, drawn, *mesh))
    return tuple(shapes)


def add_shapes(spec: mujoco.MjSpec, shapes: tuple[LinkShape, ...]) -> None:
    """Add shapes to the bodies of their links; they have no mass."""
    for number, shape in enumerate(shapes):
        geom = spec.body(shape.link).add_geom(type=GEOM_TYPES[shape.kind], rgba=shape.rgba, density=0.0)
        geom.pos, geom.quat = shape.pose.translation, shape.pose.quaternion
        geom.group = VISUAL_GROUP if shape.drawn else _HIDDEN_GROUP
        geom.contype = geom.conaffinity = int(shape.collides)
        if shape.kind == "mesh":
            mesh = spec.add_mesh(name=f"arm/{number}")
            mesh.uservert, mesh.userface = shape.vertices.ravel().tolist(), shape.triangles.ravel().tolist()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # also of one that is flat or open
            geom.meshname = mesh.name
        else:
            geom.size = shape.size


_NO_MESH: Final = np.zeros((0, 3)), np.zeros((0, 3), np.int64)


ROOT: Final = "world"  # a link of this name is MuJoCo's world
_HOME: Final = "home"
_KINDS: Final = {mujoco.mjtJoint.mjJNT_HINGE: "revolute", mujoco.mjtJoint.mjJNT_SLIDE: "prismatic"}
_Object = mujoco.mjtObj


@final
@dataclass(frozen=True)
class _Flange:
    """Where the flange is: in a body's frame, by the name of a site or of the body, and how it was found."""

    name: str
    body: int
    pose: Pose
    how: str


def read_mjcf(source: ArmSource) -> ArmFile:
    """Return the arm of an MJCF file; only the chain of bodies from the world to the flange is kept.

    Actuators, tendons, sensors, cameras and options are left out: servos are those of the scene.

    Raises:
        InputError: MuJoCo cannot read the file, the flange is not there, or the chain holds joints that are
            not handled.
    """
    read, path = read_mjcf_file(source.path, "arm"), source.path
    model = read.model
    flange = _flange(model, source.table.flange, path)
    bodies = _bodies_to(model, flange.body)
    robot = ElementTree.Element("robot", name=source.name)
    ElementTree.SubElement(robot, "link", name=ROOT)
    parent, outer, moving = ROOT, Pose(), []
    for body in bodies:
        joint = _joint_of(model, body, path)
        moving += [] if joint is None else [joint]
        parent, outer = _add_link(robot, model, body, joint, parent, outer)
    taken = flange.name in [link.get("name", "") for link in robot.findall("link")]
    end = f"{flange.name}_frame" if taken else flange.name
    ElementTree.SubElement(robot, "link", name=end)
    add_joint(robot, f"{end}_fixed", FIXED, (parent, end), outer.inverse() @ flange.pose)
    joints = robot.findall("joint")
    check_limited_chain(robot, joints, source)
    _check_alone(model, moving, bodies, path)
    home = _home(model, moving)
    notes = [f"flange '{flange.name}', {flange.how}"]
    if home is not None:
        notes.append("home from its keyframe")
    if others := [k for k in range(1, model.nbody) if k not in bodies and model.body_mass[k] > 0.0]:
        names = ", ".join(_name(model, _Object.mjOBJ_BODY, k) for k in others)
        notes.append(f"{LEFT_OUT}: {names}")
    armature = model.dof_armature[model.jnt_dofadr[moving]]
    shapes = link_shapes(model, bodies, [_name(model, _Object.mjOBJ_BODY, body) for body in bodies])
    return arm_of(
        Chain(
            robot, tuple(joints), end, home, armature if armature.any() else None,
            shapes=shapes, files=read.files, notes=tuple(notes),
        ),
        source,
    )  # fmt: skip


def _flange(model: mujoco.MjModel, given: str | None, path: Path) -> _Flange:
    sites = {_name(model, _Object.mjOBJ_SITE, k): k for k in range(model.nsite)}
    bodies = {_name(model, _Object.mjOBJ_BODY, k): k for k in range(1, model.nbody)}
    for name in FLANGE_NAMES if given is None else (given,):
        how = "by its name" if given is None else "as asked for"
        if name in sites:
            k = sites[name]
            pose = Pose.from_quaternion(model.site_quat[k], model.site_pos[k])
            return _Flange(name, int(model.site_bodyid[k]), pose, how)
        if name in bodies:
            return _Flange(name, bodies[name], Pose(), how)
    if given is not None:
        raise InputError(
            f"arm file {path} has no site or body {given!r}; there are {', '.join((*sites, *bodies))}"
        )
    last = _last_body(model)
    if last == 0:
        raise InputError(f"arm file {path}: no body moves, or several do from the beginning; name the flange")
    how = "the last body before the chain branches or ends"
    return _Flange(_name(model, _Object.mjOBJ_BODY, last), last, Pose(), how)


def _last_body(model: mujoco.MjModel) -> int:
    """Return the body after which none moves, or several do; 0 where that is the world itself."""
    children: dict[int, list[int]] = {}
    moves = model.body_jntnum > 0
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        children.setdefault(int(model.body_parentid[body]), []).append(body)
        moves[model.body_parentid[body]] |= moves[body]
    body = 0
    while len(ahead := [child for child in children.get(body, []) if moves[child]]) == 1:
        body = ahead[0]
    return body


def _bodies_to(model: mujoco.MjModel, body: int) -> list[int]:
    chain: list[int] = []
    while body:
        chain.insert(0, body)
        body = int(model.body_parentid[body])
    return chain


def _joint_of(model: mujoco.MjModel, body: int, path: Path) -> int | None:
    """Return the joint of a body.

    Raises:
        InputError: it has several, or one that is no hinge or slide, has a spring, or slides without limits.
    """
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if count == 0:
        return None
    joint = _name(model, _Object.mjOBJ_JOINT, first)
    if count > 1:
        where = f"arm file {path}: body {_name(model, _Object.mjOBJ_BODY, body)!r}"
        raise InputError(f"{where} has {count} joints; give each its own body")
    kind, where = mujoco.mjtJoint(model.jnt_type[first]), f"arm file {path}: joint {joint!r}"
    if kind not in _KINDS:
        what = kind.name.removeprefix("mjJNT_").lower()
        raise InputError(f"{where} is {what!r}; the chain to the flange may hold hinges and slides")
    if kind == mujoco.mjtJoint.mjJNT_SLIDE and not model.jnt_limited[first]:
        raise InputError(f"{where} slides without limits; give it a range")
    if model.jnt_stiffness[first] != 0.0:
        raise InputError(f"{where} has a spring, which no joint of an arm may have")
    return first


def _add_link(
    robot: ElementTree.Element, model: mujoco.MjModel, body: int, joint: int | None, parent: str, outer: Pose
) -> tuple[str, Pose]:
    """Add a body and the joint before it; return its name, and body from link."""
    name = _name(model, _Object.mjOBJ_BODY, body)
    link = ElementTree.SubElement(robot, "link", name=name)
    anchor = np.zeros(3) if joint is None else model.jnt_pos[joint]
    own = Pose(np.eye(3), anchor)
    if model.body_mass[body] > 0.0:
        middle = Pose.from_quaternion(model.body_iquat[body], model.body_ipos[body])
        add_inertial(link, model.body_mass[body], own.inverse() @ middle, model.body_inertia[body])
    placed = outer.inverse() @ Pose.from_quaternion(model.body_quat[body], model.body_pos[body]) @ own
    if joint is None:
        add_joint(robot, f"{name}_fixed", FIXED, (parent, name), placed)
        return name, own
    axis, dof = model.jnt_axis[joint], int(model.jnt_dofadr[joint])
    back = -float(model.qpos0[model.jnt_qposadr[joint]]) * axis  # drawn at this angle, not at zero
    slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
    zero = Pose(np.eye(3), back) if slides else Pose(rotation_from_vector(back), np.zeros(3))
    limited = bool(model.jnt_limited[joint])
    kind = _KINDS[mujoco.mjtJoint(model.jnt_type[joint])] if limited else "continuous"
    made = add_joint(robot, _name(model, _Object.mjOBJ_JOINT, joint), kind, (parent, name), placed @ zero)
    ElementTree.SubElement(made, "axis", xyz=text_of(axis))
    limit = {"effort": repr(_effort(model, joint)), "velocity": "0"}
    if limited:
        lower, upper = model.jnt_range[joint].tolist()
        limit |= {"lower": repr(lower), "upper": repr(upper)}
    ElementTree.SubElement(made, "limit", limit)
    friction = {
        "damping": repr(float(model.dof_damping[dof])),
        "friction": repr(float(model.dof_frictionloss[dof])),
    }
    ElementTree.SubElement(made, "dynamics", friction)
    return name, own


def _effort(model: mujoco.MjModel, joint: int) -> float:
    """Return the largest torque of a joint [N m]: its own limit, or that of its actuators; 0 without any."""
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).min())
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    mine = on_joint & (model.actuator_trnid[:, 0] == joint) & (model.actuator_forcelimited != 0)
    force = np.abs(model.actuator_forcerange[mine]).min(axis=1) * np.abs(model.actuator_gear[mine, 0])
    return float(force.sum())


def _check_alone(model: mujoco.MjModel, joints: list[int], bodies: list[int], path: Path) -> None:
    """Raise InputError where an equality ties a joint or body of the chain to something."""
    kinds = {_Object.mjOBJ_BODY: bodies, _Object.mjOBJ_JOINT: joints}
    for k in range(model.neq):
        is_joint = model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT
        kind = _Object.mjOBJ_JOINT if is_joint else mujoco.mjtObj(model.eq_objtype[k])
        tied = {int(model.eq_obj1id[k]), int(model.eq_obj2id[k])} & set(kinds.get(kind, []))
        if tied:
            what = f"{'joint' if is_joint else 'body'} {_name(model, kind, min(tied))!r}"
            raise InputError(
                f"arm file {path}: {what} is tied by an equality; the chain must be free to move"
            )


def _home(model: mujoco.MjModel, joints: list[int]) -> Array | None:
    """Return the joint angles of the keyframe "home", or of the first one; None without any."""
    names = [_name(model, _Object.mjOBJ_KEY, k) for k in range(model.nkey)]
    if not names:
        return None
    angles = model.key_qpos[names.index(_HOME) if _HOME in names else 0]
    return np.array(angles[model.jnt_qposadr[joints]])


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    """Return the name of something, or what represents one."""
    return mujoco.mj_id2name(model, kind, index) or f"{kind.name.removeprefix('mjOBJ_').lower()}_{index}"

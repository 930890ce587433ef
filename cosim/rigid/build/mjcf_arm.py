"""Converts the arm of an MJCF file to a URDF with its links and joints; the shapes of the links are copied
from MuJoCo's model.
"""

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.arm_file import FIXED, LinkShape
from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.config.arm_files import ArmSource
from cosim.errors import InputError
from cosim.rigid.build import description, mjcf_files
from cosim.rigid.build.arm_tree import ROOT, Chain, Way
from cosim.rigid.build.object_bodies import GEOM_TYPES, SHAPES, mesh_of
from cosim.rigid.build.urdf_elements import add_inertial, add_joint, text_of

_GEOMETRY_KINDS: Final = {GEOM_TYPES[name]: name for name in SHAPES}
_HIDDEN_GROUP: Final = 3
_NO_MESH: Final = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
_HOME: Final = "home"
_KINDS: Final = {mujoco.mjtJoint.mjJNT_HINGE: "revolute", mujoco.mjtJoint.mjJNT_SLIDE: "prismatic"}
_Object = mujoco.mjtObj


def link_shapes(model: mujoco.MjModel, bodies: list[int], names: list[str]) -> tuple[LinkShape, ...]:
    """Return the shapes of bodies, in the frames of their links.

    Shapes that do not collide are drawn; if all shapes of a body collide, these are drawn. Planes and height
    fields belong to no link and are left out.

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
        geom.group = description.VISUAL_GROUP if shape.drawn else _HIDDEN_GROUP
        geom.contype = geom.conaffinity = int(shape.collides)
        if shape.kind == "mesh":
            mesh = spec.add_mesh(name=f"arm/{number}")
            mesh.uservert, mesh.userface = shape.vertices.ravel().tolist(), shape.triangles.ravel().tolist()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # also of one that is flat or open
            geom.meshname = mesh.name
        else:
            geom.size = shape.size


@final
class MjcfArm:
    """The robot of an MJCF file.

    Actuators, tendons, sensors, cameras and options are left out: servos are those of the scene.

    Attributes: `tree`, its bodies, all of which have names.

    Args:
        source: of the arm.

    Raises:
        InputError: MuJoCo cannot read the file.
    """

    def __init__(self, source: ArmSource) -> None:
        self._source, self._read = source, mjcf_files.read_mjcf_file(source.path, "arm")
        self.tree = self._read.spec
        for body in self.tree.bodies:
            body.name = _name(self._read.model, _Object.mjOBJ_BODY, body.id)

    def chain_to(self, way: Way) -> Chain:
        """Return the chain to the flange; the frame of a link is that of its body, moved to its joint.

        Raises:
            InputError: the chain has joints that are not supported, or is tied to something.
        """
        model, path = self._read.model, self._source.path
        bodies = [self.tree.body(name).id for name in way.bodies]
        robot = ElementTree.Element("robot", name=self._source.name)
        ElementTree.SubElement(robot, "link", name=ROOT)
        parent, outer, moving = ROOT, Pose(), []
        for body in bodies:
            joint = _joint_of(model, body, path)
            moving += [] if joint is None else [joint]
            parent, outer = _add_link(robot, model, body, joint, parent, outer)
        _check_alone(model, moving, bodies, path)
        armature = model.dof_armature[model.jnt_dofadr[moving]]
        others = [k for k in range(1, model.nbody) if k not in bodies and model.body_mass[k] > 0.0]
        return Chain(
            robot, tuple(robot.findall("joint")), self._add_flange(robot, way, outer),
            home=_home(model, moving),
            armature=armature if armature.any() else None,
            shapes=link_shapes(model, bodies, list(way.bodies)),
            files=self._read.files,
            left_out=tuple(_name(model, _Object.mjOBJ_BODY, k) for k in others),
        )  # fmt: skip

    def _add_flange(self, robot: ElementTree.Element, way: Way, outer: Pose) -> str:
        """Add the link whose frame is the flange, and return its name; body from link: outer."""
        model, flange = self._read.model, Pose()
        if way.on_site:
            site = model.site(way.flange)
            flange = Pose.from_quaternion(site.quat, site.pos)
        end = f"{way.flange}_frame" if way.flange in (ROOT, *way.bodies) else way.flange
        ElementTree.SubElement(robot, "link", name=end)
        add_joint(robot, f"{end}_fixed", FIXED, (way.bodies[-1], end), outer.inverse() @ flange)
        return end


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
        raise InputError(f"{where} has a spring, which no joint of an arm may have; remove its stiffness")
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
    """Return the name of an element, or its kind and index."""
    return mujoco.mj_id2name(model, kind, index) or f"{kind.name.removeprefix('mjOBJ_').lower()}_{index}"

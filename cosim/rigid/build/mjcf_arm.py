"""Arms of MJCF files, and how an arm looks whose shapes stand in another file.

Shapes of an arm's links from a compiled MuJoCo model, and back into a specification.

Links and joints become those of a URDF, which both engines are given; the shapes of the links are kept as
they are. Link frames are those of the bodies, moved to their joints.

Both descriptions stand with their joints at zero. The other one is turned and moved as a whole until the axes
of its joints lie on those of the arm; then its meshes are fixed to the arm's links.
"""

import xml.etree.ElementTree as ElementTree
from contextvars import Context
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.arm_file import FIXED, ArmFile, LinkShape
from cosim.base.frames import Array, IntArray, Pose, cross_matrix, rotation_from_vector
from cosim.base.solid import BodyShape
from cosim.config.arm_chain import FLANGE_NAMES
from cosim.config.arm_files import LEFT_OUT, ArmSource, Chain, arm_of, arm_source, check_limited_chain
from cosim.config.arm_table import add_inertial, add_joint, text_of
from cosim.errors import InputError
from cosim.rigid.build import description, mjcf_files
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
        geom.group = description.VISUAL_GROUP if shape.drawn else _HIDDEN_GROUP
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
    read, path = mjcf_files.read_mjcf_file(source.path, "arm"), source.path
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


_MOST_APART_m: Final = 5e-3
_MOST_TURNED: Final = 0.01  # [rad]
_LEAST_SPREAD: Final = 0.1  # second singular value of the axes' directions: all are parallel at zero


@final
@dataclass(frozen=True)
class ArmDrawing:
    """The meshes that an arm is drawn by in place of its own shapes.

    Args:
        shapes: of the bodies that have meshes; other bodies keep their own shapes.
        note: by what the arm is drawn, or why by its own shapes; empty where its file names nothing.
    """

    shapes: tuple[BodyShape, ...] = ()
    note: str = ""

    def in_place_of(self, own: tuple[BodyShape, ...]) -> tuple[BodyShape, ...]:
        """Return the shapes of a scene with these in place of those of the same bodies."""
        replaced = {shape.body for shape in self.shapes}
        return (*(shape for shape in own if shape.body not in replaced), *self.shapes)


def drawing_of(arm: ArmFile, model: mujoco.MjModel, prefix: str = "") -> ArmDrawing:
    """Return how an arm is drawn in a scene; nothing is raised, as a drawing changes no result.

    Args:
        arm: whose file may name another description, see `ArmTable.drawn_as`.
        model: of the scene.
        prefix: of the arm's names in it.
    """
    if arm.drawn_as is None:
        return ArmDrawing()
    try:
        source = Context().run(arm_source, arm.drawn_as)  # its files are not noted as those of a run
        other = Context().run(_read, source)
        shapes = _fitted(other, model, [prefix + name for name in arm.joint_names])
    except (InputError, ValueError) as error:  # MuJoCo raises the latter
        return ArmDrawing(note=f"drawn by its own shapes: {error}")
    return ArmDrawing(shapes, f"drawn as {arm.drawn_as}")


@lru_cache(maxsize=4)
def _read(source: ArmSource) -> ArmFile:
    """Return another description, read once in a process: meshes take time.

    Corners of triangles that are in one place become one vertex, so that round faces are drawn smooth.
    """
    arm = read_mjcf(source)
    return replace(arm, shapes=tuple(map(_welded, arm.shapes)))


def _welded(shape: LinkShape) -> LinkShape:
    vertices, place = np.unique(shape.vertices, axis=0, return_inverse=True)
    return replace(shape, vertices=vertices, triangles=place.reshape(-1)[shape.triangles])


def _fitted(other: ArmFile, model: mujoco.MjModel, names: list[str]) -> tuple[BodyShape, ...]:
    """Return the meshes of another description in the frames of a model's bodies.

    Args:
        other: with as many joints as the arm has without those that move its base.
        model: of the scene.
        names: of the arm's joints in it.

    Raises:
        InputError: its axes do not lie on those of the arm.
    """
    spec = mujoco.MjSpec.from_string(other.urdf)
    spec.compiler.fusestatic = False
    drawn = spec.compile()
    theirs = np.array([drawn.joint(name).id for name in other.joint_names])
    ours = np.array([model.joint(name).id for name in names[-len(theirs) :]])
    if len(ours) < len(theirs):
        raise InputError(f"{other.path} has {len(theirs)} joints, the arm {len(ours)}")
    there, here = _at_zero(drawn, theirs), _at_zero(model, ours)
    placed = _alignment(
        (here.xanchor[ours], here.xaxis[ours]), (there.xanchor[theirs], there.xaxis[theirs]), other
    )
    shapes = []
    for shape in other.shapes:
        if not shape.drawn or shape.kind != "mesh":
            continue
        source = drawn.body(shape.link).id
        moved = _joints_above(drawn, source, theirs)
        first = int(model.jnt_bodyid[ours[0]])
        body = int(model.jnt_bodyid[ours[moved - 1]] if moved else model.body_parentid[first])
        pose = _pose(here, body).inverse() @ placed @ _pose(there, source) @ shape.pose
        red, green, blue, alpha = shape.rgba.tolist()
        shapes.append(BodyShape(body, pose.apply(shape.vertices), shape.triangles, (red, green, blue, alpha)))
    return tuple(shapes)


def _at_zero(model: mujoco.MjModel, joints: IntArray) -> mujoco.MjData:
    """Return where all bodies are with some joints at zero."""
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def _alignment(ours: tuple[Array, Array], theirs: tuple[Array, Array], other: ArmFile) -> Pose:
    """Return the pose X that puts axes onto others: least squares of directions, then of distances of lines.

    R minimises sum |R u_k - v_k|^2 (Kabsch, Acta Cryst. A 32, 1976); t solves sum P_k (R p_k + t - q_k) = 0
    with P_k = 1 - v_k v_k^T.

    Args:
        ours: points q (n, 3) [m] on the axes, and their directions v (n, 3), of length 1.
        theirs: p and u, the same.
        other: whose axes they are, for messages.

    Raises:
        InputError: the axes are all parallel, or they do not fit.
    """
    (q, v), (p, u) = ours, theirs
    left, spread, right = np.linalg.svd(u.T @ v)
    if spread[1] < _LEAST_SPREAD:
        raise InputError(f"axes that are all parallel at zero do not show the heading of {other.path}")
    upright = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = right.T @ upright @ left.T
    across = np.array([-(cross_matrix(axis) @ cross_matrix(axis)) for axis in v])
    away = np.einsum("kij,kj->ki", across, q - p @ rotation.T)
    shift = np.linalg.solve(across.sum(axis=0), away.sum(axis=0))
    turned = float(np.linalg.norm(u @ rotation.T - v, axis=1).max())
    apart = float(np.linalg.norm(away - across @ shift, axis=1).max())
    if turned > _MOST_TURNED or apart > _MOST_APART_m:
        raise InputError(
            f"{other.path} is another arm: with joints at zero its axes are {1e3 * apart:.1f} mm and "
            f"{turned:.2g} rad away, at most {1e3 * _MOST_APART_m:g} mm and {_MOST_TURNED:g} rad fit"
        )
    return Pose(rotation, shift)


def _joints_above(model: mujoco.MjModel, body: int, joints: IntArray) -> int:
    """Return how many of a chain's joints move a body."""
    order = {int(model.jnt_bodyid[joint]): number for number, joint in enumerate(joints, start=1)}
    while body and body not in order:
        body = int(model.body_parentid[body])
    return order.get(body, 0)


def _pose(data: mujoco.MjData, body: int) -> Pose:
    return Pose(data.xmat[body].reshape(3, 3), data.xpos[body])

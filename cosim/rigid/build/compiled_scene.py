"""Compiles a scene description into a MuJoCo model, and into what is drawn of it.

Triangle meshes of primitive shapes, for drawing. Triangles run counter-clockwise seen from outside.

Reads what is drawn of a MuJoCo model's bodies as plain triangle meshes.

A scene's MuJoCo model and what is drawn of it, from which any number of scenes can be made.

The cell that a robot stands in: read from MuJoCo's own format, and its driven joints.

A drive's rotor is so heavy that no load accelerates it, so contacts feel the speed of what it moves; at the
end of every step its joint is put where it is to be, so that nothing adds up.
"""

import copy
import xml.etree.ElementTree as ElementTree
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.base.solid import BodyShape
from cosim.errors import InputError, SceneError
from cosim.rigid.build import drawn_arm, mjcf_arm, mjcf_files, object_bodies, urdf_arm
from cosim.rigid.build.description import (
    CELL,
    FLANGE_CONTACTS,
    FLANGE_SITE,
    FORCE_SENSOR,
    OBJECT_CONTACTS,
    TORQUE_SENSOR,
    VISUAL_GROUP,
    Cell,
    CellJoint,
    SceneDescription,
    SceneObject,
    ServoGains,
)

ROTOR: Final = 1e6  # kg, kg m^2
_STIFF_FRICTION: Final = 0.999  # impedance of joints with dry friction that stand still, below 1


_FIRST_HIDDEN_GROUP: Final = 3  # MuJoCo shows groups 0, 1 and 2
_HIDDEN_GROUP: Final = 4
_CELL_CONTACT: Final = (0, 3)  # with links and objects, not with itself
_DRIVEN: Final = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)


def read_cell(path: Path) -> Cell:
    """Return the cell of an MJCF file.

    Raises:
        InputError: MuJoCo refuses the file, something in it moves freely or is soft, or a shape cannot be
            touched.
    """
    read = mjcf_files.read_mjcf_file(path, "cell")
    spec, model = read.spec, read.model
    joints = _joints(path, model)
    if model.nflex or model.nskin:
        raise InputError(f"cell file {path}: holds flexes or skins; a cell is rigid")
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    for geom in np.flatnonzero(collides):
        kind = mujoco.mjtGeom(model.geom_type[geom])
        if kind not in object_bodies.GEOM_TYPES.values():
            name, what = model.geom(int(geom)).name, kind.name.removeprefix("mjGEOM_").lower()
            raise InputError(
                f"cell file {path}: geom {name or int(geom)!r} is of type {what!r}, which cannot be touched; "
                "replace it, or set its contype and conaffinity to 0"
            )
    planes = collides & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    return Cell(path, spec, int(collides.sum()), bool(planes.any()), joints, _asked_otherwise(spec))


def attach_cell(spec: mujoco.MjSpec, cell: Cell, fixed: Sequence[str]) -> None:
    """Put a cell into a specification that has the options of the scene already.

    What drives move meets nothing that stands still: no contact would stop it.

    Args:
        spec: of the scene.
        cell: to add, in world axes.
        fixed: names of other bodies of the scene that stand still.
    """
    added = cell.spec.copy()
    others = (*added.keys, *added.sensors, *added.actuators, *added.tendons, *added.cameras)
    for element in (*others, *added.equalities):
        added.delete(element)
    for joint, known in zip(added.joints, cell.joints, strict=True):
        joint.name, joint.limited, joint.armature, joint.ref = known.name, False, ROTOR, 0.0
        joint.stiffness, joint.damping, joint.frictionloss = [0.0] * 3, [0.0] * 3, 0.0
    for name in _options(spec):
        setattr(added.option, name, getattr(spec.option, name))
    added.nuser_geom = spec.nuser_geom
    for number, body in enumerate(added.bodies[1:]):
        body.name = body.name or f"body_{number + 1}"
    for geom in added.geoms:
        geom.group = VISUAL_GROUP if geom.group < _FIRST_HIDDEN_GROUP else _HIDDEN_GROUP
        geom.userdata = [0.0] * spec.nuser_geom
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = _CELL_CONTACT
    carrier = spec.worldbody.add_body(name=CELL)
    driven = [f"{CELL}/{body.name}" for body in _driven(added.worldbody, moved=False)]
    spec.attach(added, prefix=f"{CELL}/", frame=carrier.add_frame())
    for one in driven:
        for other in fixed:
            spec.add_exclude(bodyname1=one, bodyname2=other)


def _driven(body: mujoco.MjsBody, *, moved: bool) -> Iterator[mujoco.MjsBody]:
    """Yield the bodies on a body that joints move."""
    for child in body.bodies:
        on_joint = moved or bool(child.joints)
        if on_joint:
            yield child
        yield from _driven(child, moved=on_joint)


def _joints(path: Path, model: mujoco.MjModel) -> tuple[CellJoint, ...]:
    """Return the joints that drives move."""
    found = []
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        name = model.joint(joint).name or model.body(body).name or f"joint_{joint + 1}"
        if mujoco.mjtJoint(model.jnt_type[joint]) not in _DRIVEN:
            kind = mujoco.mjtJoint(model.jnt_type[joint]).name.removeprefix("mjJNT_").lower()
            raise InputError(
                f"cell file {path}: joint {name!r} is of type {kind!r}; bodies of a cell slide or turn "
                "about a hinge, driven by the phases; give what moves freely as [[object]]"
            )
        limits = (-np.inf, np.inf)
        if model.jnt_limited[joint]:
            low, high = (model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).tolist()
            limits = (low, high)
        found.append(CellJoint(name, bool(model.jnt_type[joint] == _DRIVEN[0]), limits))
    twice = [name for name, count in Counter(joint.name for joint in found).items() if count > 1]
    if twice:
        raise InputError(f"cell file {path}: two joints are called {twice[0]!r}; give each its own name")
    return tuple(found)


def _options(spec: mujoco.MjSpec) -> list[str]:
    return [name for name in dir(spec.option) if not name.startswith("_")]


def _asked_otherwise(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Return the options that a file sets, as names and values: the scene has its own."""
    plain, found = mujoco.MjSpec(), []
    for name in _options(spec):
        asked = np.asarray(getattr(spec.option, name))
        if not np.array_equal(asked, np.asarray(getattr(plain.option, name))):
            found.append(f"{name} {' '.join(f'{value:g}' for value in asked.ravel().astype(float))}")
    return tuple(found)


SEGMENTS = 32
_MOST_LINES = 200  # that a plane or a height field is drawn with, along an edge

Mesh = tuple[Array, IntArray]


def box(half: Array) -> Mesh:
    """Return a box; every face has its own corners, so that its edges stay sharp when shaded.

    Args:
        half: (3,) half edges [m].
    """
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    vertices: list[Array] = []
    triangles: list[IntArray] = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            face = np.empty((4, 3))
            face[:, axis] = side
            face[:, [(axis + 1) % 3, (axis + 2) % 3]] = square[:: int(side)]
            start = 4 * len(triangles)
            vertices.append(face * half)
            triangles.append(np.array([[0, 1, 2], [0, 2, 3]]) + start)
    return np.concatenate(vertices), np.concatenate(triangles)


def revolved(radius: Array, height: Array) -> Mesh:
    """Return the surface of a profile turned about z; radius zero closes it with a point.

    Args:
        radius: (rings,) [m], along the profile.
        height: (rings,) [m], not falling; two rings of one place make a sharp edge.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    rings = np.concatenate(
        (radius[:, None, None] * circle, np.repeat(height[:, None, None], SEGMENTS, axis=1)), axis=2
    )
    around = np.arange(SEGMENTS)
    ahead = (around + 1) % SEGMENTS
    triangles = []
    for ring in range(len(radius) - 1):
        low, high = ring * SEGMENTS, (ring + 1) * SEGMENTS
        if radius[ring] > 0.0:
            triangles.append(np.stack((low + around, low + ahead, high + ahead), axis=1))
        if radius[ring + 1] > 0.0:
            triangles.append(np.stack((low + around, high + ahead, high + around), axis=1))
    return rings.reshape(-1, 3), np.concatenate(triangles)


def cylinder(radius: float, half_length: float) -> Mesh:
    """Return a cylinder along z with a narrow chamfer that catches light at its rims."""
    chamfer = 0.06 * min(radius, half_length)
    inner, low = radius - chamfer, half_length - chamfer
    profile = np.array([0.0, inner, inner, radius, radius, radius, radius, inner, inner, 0.0])
    height = np.array([half_length, half_length, half_length, low, low])
    return revolved(profile, np.concatenate((-height, height[::-1])))


def sphere(radius: float) -> Mesh:
    """Return a sphere about the origin."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, SEGMENTS // 2 + 1)
    ring = radius * np.cos(latitude)
    ring[[0, -1]] = 0.0
    return revolved(ring, radius * np.sin(latitude))


def ellipsoid(half: Array) -> Mesh:
    """Return an ellipsoid with half axes (3,) [m] about the origin."""
    vertices, triangles = sphere(1.0)
    return vertices * half, triangles


def capsule(radius: float, half_length: float) -> Mesh:
    """Return a capsule along z; `half_length` reaches to the centres of its caps [m]."""
    latitude = np.linspace(0.0, 0.5 * np.pi, SEGMENTS // 4 + 1)
    ring = radius * np.cos(latitude)
    ring[-1] = 0.0
    height = half_length + radius * np.sin(latitude)
    return revolved(np.concatenate((ring[::-1], ring)), np.concatenate((-height[::-1], height)))


def checkerboard(half: Array, tile: float) -> tuple[Mesh, Mesh]:
    """Return the even and the odd tiles of a rectangle in the xy plane, facing +z.

    Args:
        half: (2,) half edges [m].
        tile: wanted edge of a tile [m]; rounded so that whole tiles fit.
    """
    counts = np.clip(np.round(2.0 * half / tile), 2, _MOST_LINES).astype(int)
    x, y = (np.linspace(-h, h, n + 1) for h, n in zip(half, counts, strict=True))
    tiles: tuple[list[Array], list[Array]] = ([], [])
    for i in range(counts[0]):
        for j in range(counts[1]):
            corners = [[x[i], y[j], 0], [x[i + 1], y[j], 0], [x[i + 1], y[j + 1], 0], [x[i], y[j + 1], 0]]
            tiles[(i + j) % 2].append(np.array(corners))
    return _quads(tiles[0]), _quads(tiles[1])


def height_field(size: Array, heights: Array) -> Mesh:
    """Return the upper side of a height field; of a fine one every second, third, ... row and column.

    Args:
        size: half edge x, half edge y, and what the heights are multiplied by [m].
        heights: (rows, columns), rows along y and columns along x.
    """
    kept = [np.linspace(0, n - 1, min(n, _MOST_LINES)).round().astype(int) for n in heights.shape]
    y, x = (h * (2.0 * k / (n - 1) - 1.0) for h, k, n in zip(size[1::-1], kept, heights.shape, strict=True))
    z = size[2] * heights[np.ix_(*kept)]
    corner = np.arange(z.size).reshape(z.shape)
    a, b, c, d = (
        part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1])
    )
    vertices = np.stack([*np.meshgrid(x, y), z], axis=2).reshape(-1, 3)
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _quads(quads: list[Array]) -> Mesh:
    starts = 4 * np.arange(len(quads))[:, None, None]
    triangles = np.array([[0, 1, 2], [0, 2, 3]]) + starts
    return np.concatenate(quads), triangles.reshape(-1, 3)


_TILE_M = 0.25
_DARKER = 0.90


def body_shapes(model: mujoco.MjModel) -> tuple[BodyShape, ...]:
    """Return a mesh for each drawn geom, two for a plane (a checkerboard)."""
    shapes = []
    for geom in np.flatnonzero(model.geom_group == VISUAL_GROUP):
        body_from_geom = Pose.from_quaternion(model.geom_quat[geom], model.geom_pos[geom])
        material = int(model.geom_matid[geom])
        colour = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        red, green, blue, alpha = (float(c) for c in colour)
        for shade, (vertices, triangles) in zip((1.0, _DARKER), _meshes(model, int(geom)), strict=False):
            shapes.append(
                BodyShape(
                    int(model.geom_bodyid[geom]),
                    body_from_geom.apply(vertices),
                    np.asarray(triangles, dtype=np.int64),
                    (shade * red, shade * green, shade * blue, alpha),
                )
            )
    return tuple(shapes)


def _meshes(model: mujoco.MjModel, geom: int) -> tuple[Mesh, ...]:
    size, kind = model.geom_size[geom], mujoco.mjtGeom(model.geom_type[geom])
    match kind:
        case mujoco.mjtGeom.mjGEOM_BOX:
            return (box(size),)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return (sphere(size[0]),)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return (ellipsoid(size),)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return (cylinder(size[0], size[1]),)
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return (capsule(size[0], size[1]),)
        case mujoco.mjtGeom.mjGEOM_PLANE:
            return checkerboard(size[:2], _TILE_M)
        case mujoco.mjtGeom.mjGEOM_HFIELD:
            field = int(model.geom_dataid[geom])
            first, rows, columns = model.hfield_adr[field], model.hfield_nrow[field], model.hfield_ncol[field]
            heights = model.hfield_data[first : first + rows * columns].reshape(rows, columns)
            return (height_field(model.hfield_size[field], heights),)
        case mujoco.mjtGeom.mjGEOM_MESH | mujoco.mjtGeom.mjGEOM_SDF:
            vertices, triangles = object_bodies.mesh_of(model, geom)
            # every triangle gets its own corners, so that the edges of the casting stay sharp when shaded
            return ((vertices[triangles.ravel()], np.arange(triangles.size).reshape(-1, 3)),)
        case _:
            raise ValueError(f"geom {geom}: no way to draw {kind.name}")


FLANGE_MOUNT = "flange_mount"
FLOOR = "floor"

# Robot links meet floor and objects but not one another.
_ROBOT_CONTACT = (1, 2)
_OTHER_ARMS = 8  # bit of the first of several arms, which meet one another
_FRICTION_OVER_NORMAL = 1e4  # impedances of a contact: below friction's limit, creep goes with its inverse
_WITH_WIRES = 1e2  # of a wound wire's many contacts, harder friction doubles the cost of a step
_TOLERANCE = 1e-14  # of contact forces, relative to a mean inertia that is the arm's more than the objects'
# MuJoCo ends the search along a Newton step after so many points, and with it the iteration, whatever
# force is left. Its own 50 are too few for friction on many points: a clamped spool shook the arm.
_SEARCHES_MAX = 500
# Of the slope along a Newton step, over the tolerance: with MuJoCo's own 0.01, below what rounding leaves of
# it, which kept searches from ending: a sixth of a step.
_SEARCH_TOLERANCE = 100.0
_DEPTH_TOLERANCE_M = 1e-9  # normals of shapes that touch less deeply may point the other way
_FEW_TREES = 2  # as of a gripper and one object: finding islands costs more than solving all at once
_FLOOR_GREY = (0.86, 0.87, 0.88, 1.0)


def compile_model(description: SceneDescription, arms: tuple[SceneDescription, ...] = ()) -> mujoco.MjModel:
    """Return the MuJoCo model of a scene.

    Args:
        description: what it is made of.
        arms: further ones in it, of whose descriptions the arm, its place and what is mounted count.

    Raises:
        InputError: MuJoCo cannot read the arm's file.
        SceneError: MuJoCo refuses an object or a wire.
    """
    try:
        return _compiled(description, arms)
    except ValueError as error:
        body = _refused(description, arms)
        paths = ", ".join(str(one.arm.path) for one in (description, *arms))
        what = f"a scene with {paths}" if body is None else "it"
        raise SceneError(f"MuJoCo refuses {what}: {error}".replace("\n", ", "), body) from None


def _refused(description: SceneDescription, arms: tuple[SceneDescription, ...]) -> str | None:
    """Return the first body without which, and without all after it, MuJoCo accepts a scene."""
    objects, wires = description.objects_by_parent(), description.wires
    names = [item.name for item in objects] + [wire.name for wire in wires]

    def accepted(count: int) -> bool:
        fewer = replace(description, objects=objects[:count], wires=wires[: max(0, count - len(objects))])
        try:
            _compiled(fewer, arms)
        except ValueError:
            return False
        return True

    count = bisect_left(range(len(names) + 1), True, key=lambda k: not accepted(k))
    return names[count - 1] if 0 < count <= len(names) else None


def _compiled(description: SceneDescription, arms: tuple[SceneDescription, ...] = ()) -> mujoco.MjModel:
    together = (description, *arms)
    spec = mujoco.MjSpec() if arms else _arm_spec(description)
    _set_options(spec, description)
    for place, one in enumerate(together if arms else ()):
        added = _arm_spec(one)
        _set_options(added, description)
        _meet_other_arms(added, place, len(together))
        spec.attach(added, prefix=one.prefix, frame=spec.worldbody.add_frame())
    mounted = [replace(item, name=one.prefix + item.name) for one in together for item in one.mounted]
    _add_surroundings(spec, description, mounted)
    names, wires = ([item.name for item in items] for items in (mounted, description.wires))
    description.friction.add_contacts(spec, names, wires)
    mounts = [one.prefix + FLANGE_MOUNT for one in together]
    for item in description.objects:
        if item.mass_kg > 0.0:
            _count_contacts(spec, item.name, mounts)
    model = spec.compile()
    if mounted and model.ntree <= _FEW_TREES:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    for wire in description.wires:
        object_bodies.relax_wire(model, wire)
    mjcf_files.check_finite(model)
    return model


def _count_contacts(spec: mujoco.MjSpec, name: str, mounts: Sequence[str]) -> None:
    """Let sensors count the contacts of an object: with all rigid bodies, and with what each flange has."""
    for mount in ("", *mounts):
        sensor = _add_counter(spec, f"{OBJECT_CONTACTS} {name} {mount}", (mujoco.mjtObj.mjOBJ_BODY, name))
        if mount:
            sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_XBODY, mount


def _add_counter(spec: mujoco.MjSpec, name: str, of: tuple[mujoco.mjtObj, str]) -> mujoco.MjsSensor:
    """Add a sensor that counts the contacts of a body, or of all that hangs on it."""
    sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=of[0], objname=of[1])
    sensor.intprm[:3] = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1
    return sensor


def _arm_spec(description: SceneDescription) -> mujoco.MjSpec:
    """Return an arm where it stands, with servos, sensors and what is mounted on its flange."""
    arm = description.arm
    spec = urdf_arm.urdf_spec(ElementTree.fromstring(arm.urdf), arm.path)
    _place_base(spec, description.world_from_base or arm.world_from_base)
    _prepare_arm(spec, description)
    for item in description.mounted:
        object_bodies.add_mounted(spec, spec.body(FLANGE_MOUNT), item, _ROBOT_CONTACT, description.step_s)
    return spec


def _meet_other_arms(spec: mujoco.MjSpec, place: int, count: int) -> None:
    """Let what collides of an arm meet all other arms as well, each by a contact bit of its own."""
    bits = [_OTHER_ARMS << k for k in range(count)]
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            geom.contype |= bits[place]
            geom.conaffinity |= sum(bits) - bits[place]


def _set_options(spec: mujoco.MjSpec, description: SceneDescription) -> None:
    spec.compiler.degree = False
    spec.option.timestep = description.step_s
    spec.option.gravity = description.gravity
    spec.option.tolerance, spec.option.ls_iterations = _TOLERANCE, _SEARCHES_MAX
    spec.option.ls_tolerance = _SEARCH_TOLERANCE
    spec.option.ccd_tolerance = _DEPTH_TOLERANCE_M
    # servos are implicit by their share of the mass matrix, see `RigidScene`, and joint damping is by itself
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # What friction holds must not creep, as MuJoCo's regularised friction does. With its default, a pyramid
    # for a cone, it would all the same: each of the pyramid's two directions has a share of the normal force
    # for itself.
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = _WITH_WIRES if description.wires else _FRICTION_OVER_NORMAL
    object_bodies.prepare(spec)


def _add_surroundings(
    spec: mujoco.MjSpec, description: SceneDescription, mounted: Sequence[SceneObject]
) -> None:
    """Add floor, objects, wires and cell to arms."""
    cell = description.cell
    if description.floor_height_m is not None and not (cell is not None and cell.has_plane):
        height = description.floor_height_m
        floor = SceneObject(FLOOR, "plane", (4.0, 4.0), (0.0, 0.0, height), rgba=_FLOOR_GREY)
        object_bodies.add_object(spec, floor, {}, description.step_s)
    objects = {item.name: item for item in description.objects}
    for item in description.objects_by_parent():
        object_bodies.add_object(spec, item, objects, description.step_s)
    carried = [spec.body(item.name) for item in mounted]
    for item in description.objects:
        if carried and item.mass_kg > 0.0:
            object_bodies.add_corner_contacts(spec, carried, spec.body(item.name), description.friction)
    for wire in description.wires:
        object_bodies.add_wire(spec, wire, objects, description.step_s)
    if cell is not None:
        still = [item.name for item in description.objects if item.mass_kg == 0.0]
        ground = [FLOOR] if spec.body(FLOOR) is not None else []
        attach_cell(spec, cell, [*still, *ground])


def _place_base(spec: mujoco.MjSpec, world_from_base: Pose) -> None:
    for body in spec.worldbody.bodies:
        placed = world_from_base @ Pose.from_quaternion(np.array(body.quat), np.array(body.pos))
        body.pos, body.quat = placed.translation, placed.quaternion


def _prepare_arm(spec: mujoco.MjSpec, description: SceneDescription) -> None:
    """Give the arm its rotor inertia, servos, contact filter, flange site and sensors."""
    arm = description.arm
    joints = [spec.joint(name) for name in arm.joint_names]
    gains = description.gains or ServoGains.of(arm, np.array([joint.actfrcrange[1] for joint in joints]))
    rotors = arm.armature if description.armature is None else np.full(len(joints), description.armature)
    inputs = mujoco.mjtCtrlInput
    all_inputs = int(inputs.mjINPUT_POS) | int(inputs.mjINPUT_VEL) | int(inputs.mjINPUT_FF)
    for joint, rotor, stiffness, damping in zip(joints, rotors, gains.stiffness, gains.damping, strict=True):
        joint.armature = rotor
        # dry friction opposes the speed at a step's end; MuJoCo's soft one lags, and may push a braking joint
        joint.solref_friction = [-1.0, -_STIFF_FRICTION / description.step_s]
        joint.solimp_friction = [_STIFF_FRICTION, _STIFF_FRICTION, 1e-3, 0.5, 2.0]
        servo = spec.add_actuator(
            name=f"{joint.name}_servo", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_pid(kp=stiffness, kv=damping, ctrlspec=all_inputs)
    mjcf_arm.add_shapes(spec, arm.shapes)
    for geom in spec.geoms:
        geom.density = 0.0  # a link without <inertial> has no mass, whatever its shapes
        if geom.contype or geom.conaffinity:
            geom.contype, geom.conaffinity = _ROBOT_CONTACT
    # A massless body of its own: loads act at its origin, and the sensor above it sees them alone.
    mount = spec.body(arm.flange_frame).add_body(name=FLANGE_MOUNT)
    mount.add_site(name=FLANGE_SITE)
    for name, kind in (
        (FORCE_SENSOR, mujoco.mjtSensor.mjSENS_FORCE),
        (TORQUE_SENSOR, mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=FLANGE_SITE)
    _add_counter(spec, FLANGE_CONTACTS, (mujoco.mjtObj.mjOBJ_XBODY, FLANGE_MOUNT))


@final
class CompiledScene:
    """The model of a scene, which stays as it was compiled.

    Args:
        description: what the scene is made of.
        arms: further ones in it, see `compile_model`.

    Raises:
        InputError: MuJoCo refuses the arm's file or an object.
    """

    def __init__(self, description: SceneDescription, arms: tuple[SceneDescription, ...] = ()) -> None:
        mjcf_files.set_up_engine()
        self._model = compile_model(description, arms)
        self._arms = {one.prefix: one.arm for one in (description, *arms)}

    def model(self) -> mujoco.MjModel:
        """Return a model that may be changed."""
        return copy.copy(self._model)

    @cached_property
    def shapes(self) -> tuple[BodyShape, ...]:
        """What is drawn of the bodies."""
        shapes = body_shapes(self._model)
        for drawing in self.drawings.values():
            shapes = drawing.in_place_of(shapes)
        return shapes

    @cached_property
    def drawings(self) -> dict[str, drawn_arm.ArmDrawing]:
        """How each arm is drawn, by the prefix of its names."""
        return {prefix: drawn_arm.drawing_of(arm, self._model, prefix) for prefix, arm in self._arms.items()}

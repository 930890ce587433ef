"""Reads the cell around an arm from an MJCF file, and adds it to a scene. Phases drive its joints. The rotor
inertia of a driven joint is so large that no load accelerates it, so contacts see the speed of its body; at
the end of every step the joint is set to its target, so errors do not accumulate.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from cosim.errors import InputError
from cosim.rigid.build import mjcf_files, object_bodies
from cosim.rigid.build.description import VISUAL_GROUP, Cell, CellJoint
from cosim.rigid.build.scene_names import CELL

ROTOR: Final = 1e6  # kg, kg m^2
_FIRST_HIDDEN_GROUP: Final = 3  # MuJoCo shows groups 0, 1 and 2
_HIDDEN_GROUP: Final = 4
_CELL_CONTACT: Final = (0, 3)  # with links and objects, not with itself
_DRIVEN: Final = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)


def read_cell(path: Path) -> Cell:
    """Return the cell of an MJCF file.

    Raises:
        InputError: MuJoCo refuses the file, a body in it moves freely or is soft, or a shape has no contact.
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
    """Add a cell to the specification of a scene.

    Driven bodies have no contacts with fixed ones, which could not stop them.

    Args:
        spec: of the scene, with its options.
        cell: to add, in world axes.
        fixed: names of other fixed bodies of the scene.
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
    """Yield the bodies below a body that joints move."""
    for child in body.bodies:
        on_joint = moved or bool(child.joints)
        if on_joint:
            yield child
        yield from _driven(child, moved=on_joint)


def _joints(path: Path, model: mujoco.MjModel) -> tuple[CellJoint, ...]:
    """Return the driven joints of a cell.

    Raises:
        InputError: a joint is neither slide nor hinge, or two have the same name.
    """
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
    """Return names and values of the options that a file sets, which the scene's options override."""
    plain, found = mujoco.MjSpec(), []
    for name in _options(spec):
        asked = np.asarray(getattr(spec.option, name))
        if not np.array_equal(asked, np.asarray(getattr(plain.option, name))):
            found.append(f"{name} {' '.join(f'{value:g}' for value in asked.ravel().astype(float))}")
    return tuple(found)

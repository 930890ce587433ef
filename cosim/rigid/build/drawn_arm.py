"""Draws an arm with the meshes of another file (`drawn_as`). Both files describe the arm with all joints at
zero. The other model is moved rigidly until its joint axes coincide with those of the arm; then its meshes
are fixed to the arm's links.
"""

from contextvars import Context
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, final

import mujoco
import numpy as np

from cosim.base.arm_file import ArmFile, LinkShape
from cosim.base.frames import Array, IntArray, Pose, cross_matrix
from cosim.base.solid import BodyShape
from cosim.config.arm_files import ArmSource, arm_source
from cosim.errors import InputError
from cosim.rigid.build.arm_reader import read_arm

_MOST_APART_m: Final = 5e-3
_MOST_TURNED: Final = 0.01  # [rad]
_LEAST_SPREAD: Final = 0.1  # second singular value of the axes' directions: all are parallel at zero


@final
@dataclass(frozen=True)
class ArmDrawing:
    """Meshes that replace an arm's own shapes in pictures.

    Args:
        shapes: of the bodies that have meshes; other bodies keep their own shapes.
        note: how the arm is drawn, or why with its own shapes; empty if its file names no other description.
    """

    shapes: tuple[BodyShape, ...] = ()
    note: str = ""

    def in_place_of(self, own: tuple[BodyShape, ...]) -> tuple[BodyShape, ...]:
        """Return the shapes of a scene with these in place of those of the same bodies."""
        replaced = {shape.body for shape in self.shapes}
        return (*(shape for shape in own if shape.body not in replaced), *self.shapes)


def drawing_of(arm: ArmFile, model: mujoco.MjModel, prefix: str = "") -> ArmDrawing:
    """Return how an arm is drawn in a scene; errors become a note, as a drawing changes no result.

    Args:
        arm: whose file may name another description, see `ArmTable.drawn_as`.
        model: of the scene.
        prefix: of the arm's names in it.
    """
    if arm.drawn_as is None:
        return ArmDrawing()
    try:
        source = Context().run(arm_source, arm.drawn_as)  # so that its files do not count as files of the run
        other = Context().run(_read, source)
        shapes = _fitted(other, model, [prefix + name for name in arm.joint_names])
    except (InputError, ValueError) as error:  # MuJoCo raises the latter
        return ArmDrawing(note=f"drawn by its own shapes: {error}")
    return ArmDrawing(shapes, f"drawn as {arm.drawn_as}")


@lru_cache(maxsize=4)
def _read(source: ArmSource) -> ArmFile:
    """Return another description, read once in a process: meshes take time.

    Corners of triangles at one position become one vertex, so that round faces are drawn smooth.
    """
    arm = read_arm(source)
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
        InputError: its joint axes do not coincide with those of the arm.
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
    """Return the state of a model with some joints at zero."""
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def _alignment(ours: tuple[Array, Array], theirs: tuple[Array, Array], other: ArmFile) -> Pose:
    """Return the pose X that moves axes onto others: least squares of directions, then of distances of lines.

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

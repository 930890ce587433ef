"""Poses, twists and wrenches.

Naming: `world_from_tool` maps coordinates of the tool frame into the world frame, so that
`world_from_tool @ tool_from_tip` reads as a chain. Quaternions are (w, x, y, z) everywhere.
Twists and wrenches are taken at a named point, along world axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]
PlaceArray: TypeAlias = NDArray[np.uint64]
SixNumbers: TypeAlias = tuple[float, float, float, float, float, float]

_Kind = TypeVar("_Kind")
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
_FEW = 300  # numbers, up to which copies cost less than views


def _frozen(value: Any, shape: tuple[int, ...]) -> Array:
    if type(value) is np.ndarray and not value.flags.writeable and value.flags.owndata:
        kept: Array = value  # nobody can change it
        if kept.shape == shape and kept.dtype == np.float64:
            return kept
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        array = array.reshape(shape)
    array.setflags(write=False)
    return array


def _owning(kind: type[_Kind], name: str, array: Array, other_name: str, other: Array) -> _Kind:
    """Return an instance that takes over its two arrays, without copies and checks of its constructor."""
    array.setflags(False)  # type: ignore[call-arg]  # write: by keyword it takes twice as long
    other.setflags(False)  # type: ignore[call-arg]
    made = object.__new__(kind)
    held = made.__dict__
    held[name], held[other_name] = array, other
    return made


class Remade:
    """A dataclass whose arrays are read-only again once it is unpickled."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.__post_init__()  # type: ignore[attr-defined]  # every one has it


def read_only(array: Any) -> Any:
    """Return a view that nobody can write through; its owner still can, as kernels take no other arrays."""
    view = array.view()
    view.setflags(False)  # by keyword it takes twice as long
    return view


class Shown(Remade):
    """A dataclass that is shown to others: nobody can write to the arrays that it holds."""

    def __post_init__(self) -> None:
        held = vars(self)
        for name, value in held.items():
            if type(value) is np.ndarray:
                held[name] = view = value.view()
                view.setflags(False)  # type: ignore[call-arg]  # by keyword it takes twice as long
            elif type(value) is tuple and value and type(value[0]) is np.ndarray:
                held[name] = tuple(map(read_only, value))


def cross_matrix(vector: Array) -> Array:
    """Return the matrix S with S @ b = vector x b.

    Args:
        vector: (3,).
    """
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def cross(a: Array, b: Array) -> Array:
    """Return a x b along the last axis; several times faster than numpy's on few vectors.

    Args:
        a: (..., 3).
        b: (..., 3), of the same shape.
    """
    if a.ndim == 1:
        (x, y, z), (u, v, w) = a.tolist(), b.tolist()
        return np.array((y * w - z * v, z * u - x * w, x * v - y * u))
    if a.size > _FEW:
        result = np.empty_like(a)
        for r, s, t in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            result[..., r] = a[..., s] * b[..., t] - a[..., t] * b[..., s]
        return result
    left = a.take(_NEXT, -1) * b.take(_AFTER, -1)
    return np.asarray(left - a.take(_AFTER, -1) * b.take(_NEXT, -1))


def length(vector: Array) -> float:
    """Return the Euclidean length of a vector (n,); several times faster than numpy's on a short one."""
    return math.sqrt(vector.dot(vector))


def rotation_from_vector(vector: Array) -> Array:
    """Return the rotation exp(S(vector)) by Rodrigues' formula.

    Args:
        vector: (3,), axis times angle [rad].
    """
    angle = float(np.linalg.norm(vector))
    skew = cross_matrix(vector)
    if angle < 1e-8:
        return np.asarray(np.eye(3) + skew + 0.5 * skew @ skew)
    sine, versine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + sine * skew + versine * skew @ skew)


def vector_from_rotation(rotation: Array) -> Array:
    """Return the axis times angle [rad] of a rotation, angle in [0, pi].

    Args:
        rotation: (3, 3), orthonormal.
    """
    w, *xyz = quaternion_from_rotation(rotation)
    sine = float(np.linalg.norm(xyz))
    if sine < 1e-12:
        return 2.0 * np.array(xyz)
    return np.asarray(2.0 * np.arctan2(sine, w) / sine * np.array(xyz))


def quaternion_from_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (w, x, y, z), w >= 0, of a rotation (Shepperd's method).

    Args:
        rotation: (3, 3), orthonormal.
    """
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    k = int(np.argmax([trace, rotation[0, 0], rotation[1, 1], rotation[2, 2]]))
    q = np.empty(4)
    if k == 0:
        q[0] = 1.0 + trace
        q[1:] = (
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        )
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q[1 + i] = 1.0 + rotation[i, i] - rotation[j, j] - rotation[m, m]
        q[1 + j] = rotation[j, i] + rotation[i, j]
        q[1 + m] = rotation[m, i] + rotation[i, m]
        q[0] = rotation[m, j] - rotation[j, m]
    q /= np.linalg.norm(q)
    return q if q[0] >= 0.0 else -q


def quaternions_from_rotations(rotations: Array) -> Array:
    """Return `quaternion_from_rotation` of many rotations (k, 3, 3): (k, 4).

    Each is the row of the symmetric matrix 4 q q^T with the largest diagonal entry, normalised.
    """
    r = rotations.transpose(1, 2, 0)
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    products = np.empty((4, 4, len(rotations)))
    products[0] = (1.0 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1])
    for i in range(3):
        products[1 + i, 0] = products[0, 1 + i]
        for j in range(3):
            products[1 + i, 1 + j] = r[i, j] + r[j, i]
        products[1 + i, 1 + i] += 1.0 - trace
    largest = np.argmax(products[np.arange(4), np.arange(4)], axis=0)
    q = products[largest, :, np.arange(len(rotations))]
    q /= np.sqrt((q * q).sum(axis=1))[:, None]
    return np.asarray(np.where(q[:, :1] >= 0.0, q, -q))


def rotation_from_quaternion(quaternion: Array) -> Array:
    """Return the rotation of a quaternion (w, x, y, z), normalised first.

    Args:
        quaternion: (4,), not zero.
    """
    w, x, y, z = np.asarray(quaternion, dtype=np.float64) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotations_from_quaternions(quaternions: Array) -> Array:
    """Return the rotations (k, 3, 3) of unit quaternions (k, 4), (w, x, y, z)."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


@dataclass(frozen=True)
class Pose(Remade):
    """Rigid transform y = rotation @ x + translation.

    Args:
        rotation: (3, 3), orthonormal, determinant 1.
        translation: (3,) [m].
    """

    rotation: Annotated[Array, (3, 3)] = field(default_factory=lambda: np.eye(3))
    translation: Annotated[Array, (3,)] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", _frozen(self.rotation, (3, 3)))
        object.__setattr__(self, "translation", _frozen(self.translation, (3,)))

    @classmethod
    def owning(cls, rotation: Array, translation: Array) -> Pose:
        """Return the pose that takes over arrays of the right shapes, which nobody else may hold."""
        return _owning(cls, "rotation", rotation, "translation", translation)

    @classmethod
    def from_quaternion(cls, quaternion: Array, translation: Array) -> Pose:
        """Return the pose of a quaternion (w, x, y, z) and a translation (3,) [m]."""
        return cls(rotation_from_quaternion(quaternion), translation)

    @property
    def quaternion(self) -> Array:
        """Unit quaternion (w, x, y, z), w >= 0."""
        return quaternion_from_rotation(self.rotation)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose.owning(
            self.rotation @ other.rotation, self.rotation @ other.translation + self.translation
        )

    def inverse(self) -> Pose:
        """Return the pose that undoes this one."""
        return Pose.owning(self.rotation.T, -self.rotation.T @ self.translation)

    def apply(self, points: Array) -> Array:
        """Return points mapped by this pose.

        Args:
            points: (..., 3) [m].
        """
        return np.asarray(points @ self.rotation.T + self.translation)

    def interpolated(self, end: Pose, fraction: float) -> Pose:
        """Return the pose at a fraction of the shortest way to another; exactly that at 1.

        The origin moves on a line, the rotation about one axis.

        Args:
            end: the other pose.
            fraction: of the way, 0 to 1.
        """
        if fraction >= 1.0:
            return end
        turn = vector_from_rotation(end.rotation @ self.rotation.T)
        origin = (1.0 - fraction) * self.translation + fraction * end.translation
        return Pose(rotation_from_vector(fraction * turn) @ self.rotation, origin)


@dataclass(frozen=True)
class Twist(Remade):
    """Velocity of a frame: of its origin [m/s] and angular [rad/s], world axes, shape (3,) each."""

    linear: Annotated[Array, (3,)] = field(default_factory=lambda: np.zeros(3))
    angular: Annotated[Array, (3,)] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "linear", _frozen(self.linear, (3,)))
        object.__setattr__(self, "angular", _frozen(self.angular, (3,)))

    @classmethod
    def owning(cls, linear: Array, angular: Array) -> Twist:
        """Return the twist that takes over arrays (3,), which nobody else may hold."""
        return _owning(cls, "linear", linear, "angular", angular)


@dataclass(frozen=True)
class Wrench(Remade):
    """Force [N] and torque [N m] about a named point, world axes, shape (3,) each."""

    force: Annotated[Array, (3,)] = field(default_factory=lambda: np.zeros(3))
    torque: Annotated[Array, (3,)] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", _frozen(self.force, (3,)))
        object.__setattr__(self, "torque", _frozen(self.torque, (3,)))

    @classmethod
    def owning(cls, force: Array, torque: Array) -> Wrench:
        """Return the wrench that takes over arrays (3,), to which nobody else may write."""
        return _owning(cls, "force", force, "torque", torque)

    def __add__(self, other: Wrench) -> Wrench:
        return Wrench(self.force + other.force, self.torque + other.torque)

    def moved(self, offset: Array) -> Wrench:
        """Return the same load about a point at `offset` (3,) [m] from the present one."""
        return Wrench(self.force, self.torque - cross(np.asarray(offset, dtype=np.float64), self.force))

    def power(self, twist: Twist) -> float:
        """Return force . linear + torque . angular [W], both about the same point."""
        return float(self.force.dot(twist.linear) + self.torque.dot(twist.angular))


def in_mm(point: Array) -> str:
    """Return a place (2,) or (3,) [m] in words."""
    return f"({', '.join(f'{1e3 * number:.2f}' for number in point)}) mm"

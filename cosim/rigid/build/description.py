"""What a rigid scene is made of: an arm on its base, its servos, the cell, objects, wires, friction of pairs.

One solid shape of a rigid body, and how much it encloses.

How an object hangs on another one, or on the world: by a hinge or a slide.

A wire: capsules in a row, joined by ball joints that resist bending.

The cell that a robot stands in: whatever stands still around the arm, or is moved by drives.

MuJoCo lets the larger of two coefficients count, or the one of the geom with priority. Where the rule says
otherwise, the two geoms get their own contact, which is as MuJoCo would have it besides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, final

import mujoco
import numpy as np

from cosim.base import arm_file, solid
from cosim.base.frames import Array, IntArray, Pose, rotation_from_vector
from cosim.config.schema.objects import WireTable
from cosim.errors import InputError

FILM: Final = "film"
_RULES: Final[dict[str, Callable[[Array, Array], Array]]] = {
    "largest": np.maximum,
    "smallest": np.minimum,
    "mean": lambda a, b: 0.5 * (a + b),
    "root": lambda a, b: np.sqrt(a * b),
}
_NO_SHARE: Final = 1e-15  # of both geoms in a contact's parameters: then each has half


@final
@dataclass(frozen=True)
class PairFriction:
    """How the coefficients of two surfaces make that of the pair.

    Args:
        rule: "largest", "smallest", "mean" or "root", of the product.
        film: coefficient of the film; None: the film takes that of what it touches.
        pairs: names of two bodies, and the coefficient between them whatever the rule says.
    """

    rule: str = "largest"
    film: float | None = None
    pairs: tuple[tuple[str, str, float], ...] = ()

    def between(self, names: tuple[str, str], mu: tuple[float, float]) -> float:
        """Return the coefficient of a pair.

        Args:
            names: of the two bodies.
            mu: their coefficients.
        """
        return float(self._of(np.array(names)[:, None], np.array(mu)[:, None])[0])

    def on_film(self, names: Sequence[str], mu: Array) -> Array:
        """Return the coefficients (k,) between film and bodies.

        Args:
            names: of the bodies.
            mu: (k,), theirs.
        """
        film = mu if self.film is None else np.full(len(mu), self.film)
        both = np.array([names, [FILM] * len(mu)]).reshape(2, -1)
        return self._of(both, np.stack([mu, film]))

    def _of(self, names: Array, mu: Array) -> Array:
        """Return the coefficients (k,) of pairs: names (2, k), coefficients (2, k)."""
        found = np.array(_RULES[self.rule](*mu))
        for one, other, coefficient in self.pairs:
            first, second = names
            here = ((first == one) & (second == other)) | ((first == other) & (second == one))
            found[here] = coefficient
        return found

    def add_contacts(self, spec: mujoco.MjSpec, mounted: Sequence[str], wires: Sequence[str]) -> None:
        """Give geoms their own contacts where MuJoCo would take another coefficient.

        Priority of what is mounted decides on how hard its contacts are, not on friction. Where the file of
        a cell gives a geom priority, its coefficient stays the one that counts.

        Args:
            spec: complete.
            mounted: names of bodies on the flange.
            wires: names of the wires, whose bodies are called NAME/1, NAME/2, ...
        """
        geoms = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
        decides = [geom.friction[0] for geom in geoms if geom.parent.name in mounted]
        largest = max((geom.friction[0] for geom in geoms), default=0.0)
        if not self.pairs and self.rule == "largest" and min(decides, default=largest) >= largest:
            return
        model = spec.compile()
        both = _meeting(model)
        names, mu = np.array(body_names(model, range(model.ngeom), wires)), model.geom_friction[:, 0]
        wanted, taken = self._of(names[both], mu[both]), _taken(model, both)
        priority = np.where(np.isin(names, mounted), 0, model.geom_priority)[both]
        wanted = np.where(priority[0] == priority[1], wanted, taken)
        for geom in spec.geoms:
            geom.name = geom.name or f"geom {geom.id}"
        called = {geom.id: geom.name for geom in spec.geoms}
        for k in np.flatnonzero(wanted != taken):
            one, other = (int(geom) for geom in both[:, k])
            pair = spec.add_pair(geomname1=called[one], geomname2=called[other])
            _be_as_mixed(pair, model, one, other)
            pair.friction[:2] = float(wanted[k])


def body_names(model: mujoco.MjModel, geoms: Sequence[int] | IntArray, wires: Sequence[str]) -> list[str]:
    """Return the name of the body of each geom (k,), that of the wire for its segments."""
    found = []
    for geom in geoms:
        name = model.body(int(model.geom_bodyid[geom])).name
        whole = name.rpartition("/")[0]
        found.append(whole if whole in wires else name)
    return found


def _meeting(model: mujoco.MjModel) -> IntArray:
    """Return pairs of geoms (2, k) that MuJoCo lets touch each other."""
    both = np.stack(np.triu_indices(model.ngeom, 1))
    kind, affinity = model.geom_contype[both], model.geom_conaffinity[both]
    meets = ((kind & affinity[::-1]) != 0).any(axis=0)
    body = np.sort(model.geom_bodyid[both], axis=0)
    weld = model.body_weldid[body]
    above = model.body_weldid[model.body_parentid[weld]]
    related = (weld == above[::-1]).any(axis=0) & (weld != 0).all(axis=0)
    excluded = np.isin((body[0] << 16) + body[1], model.exclude_signature)
    return np.asarray(both[:, meets & (weld[0] != weld[1]) & ~related & ~excluded], dtype=np.int64)


def _taken(model: mujoco.MjModel, both: IntArray) -> Array:
    """Return the coefficients of sliding (k,) that MuJoCo takes for pairs of geoms (2, k)."""
    priority, mu = model.geom_priority[both], model.geom_friction[both, 0]
    return np.asarray(
        np.where(priority[0] == priority[1], mu.max(axis=0), np.where(priority[0] > priority[1], *mu))
    )


def _be_as_mixed(pair: mujoco.MjsPair, model: mujoco.MjModel, one: int, other: int) -> None:
    """Give a pair what MuJoCo makes of two geoms: the one with priority decides, or their shares do."""
    geoms, priority = [one, other], model.geom_priority[[one, other]]
    pair.margin, pair.gap = model.geom_margin[geoms].sum(), model.geom_gap[geoms].sum()
    if priority[0] != priority[1]:
        geoms = [geoms[int(np.argmax(priority))]]
    share = model.geom_solmix[geoms]
    share = share / share.sum() if share.sum() > _NO_SHARE else np.full(len(geoms), 1.0 / len(geoms))
    pair.condim = model.geom_condim[geoms].max()
    sliding, turning, rolling = model.geom_friction[geoms].max(axis=0)
    pair.friction = [sliding, sliding, turning, rolling, rolling]
    times = model.geom_solref[geoms]
    pair.solref = share @ times if (times[:, 0] > 0.0).all() else times.min(axis=0)
    pair.solimp = share @ model.geom_solimp[geoms]


@dataclass(frozen=True)
class Geometry:
    """A solid of one shape, somewhere on its body.

    Args:
        shape: as of `[[object]]`, or "plane"; axes of cylinder, capsule and the plane's normal are its z.
        size_m: as of `[[object]]`; of a plane, its edges along x and y.
        position_m: (3,) [m], of its centre, body frame; of a mesh: of the origin of its vertices.
        quaternion: (w, x, y, z), body from geometry.
        rgba: colour, components 0 to 1.
        friction: sliding friction coefficient.
        relative_density: its share of the body's mass goes with this times its volume.
        mesh: of shape "mesh".
        convex: of shape "mesh": each of its shells is touched as its convex hull; otherwise soft robots touch
            the surface itself, by a table of distances, and rigid bodies the hull of the whole.
    """

    shape: str
    size_m: tuple[float, ...] = ()
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    rgba: tuple[float, float, float, float] = (0.75, 0.55, 0.35, 1.0)
    friction: float = 0.8
    relative_density: float = 1.0
    mesh: solid.TriangleMesh | None = None
    convex: bool = True

    @property
    def volume_m3(self) -> float:
        """Enclosed volume [m^3]; 0 for a plane."""
        if self.mesh is not None:
            return self.mesh.volume_m3
        s = self.size_m
        match self.shape:
            case "box":
                return s[0] * s[1] * s[2]
            case "sphere":
                return 4.0 / 3.0 * np.pi * s[0] ** 3
            case "cylinder":
                return np.pi * s[0] ** 2 * s[1]
            case "capsule":
                return np.pi * s[0] ** 2 * (s[1] + 4.0 / 3.0 * s[0])
            case "ellipsoid":
                return 4.0 / 3.0 * np.pi * s[0] * s[1] * s[2]
            case _:
                return 0.0


@dataclass(frozen=True)
class Joint:
    """One degree of freedom between an object and its parent; 0 where the scene is drawn.

    Moment = -stiffness q - damping dq/dt - friction sign(dq/dt). MuJoCo takes springs explicitly, which alone
    is unstable where the tick is long. An inertia of stiffness h^2 / 4 on the joint, h the tick, makes it the
    trapezoidal rule: stable at any tick, tan(w' h / 2) = w h / 2 for the circular frequency, no damping.

    Args:
        kind: turns about the axis, or shifts along it.
        axis: (3,) world, where the scene is drawn.
        anchor_m: (3,) [m], world, a point on the axis of a hinge.
        parent: name of the object that it hangs on; None for the world.
        limits: smallest and largest q [rad] or [m]; None for free motion.
        damping: [N m s] or [N s/m].
        stiffness: [N m] or [N/m].
        friction: dry, [N m] or [N].
    """

    kind: Literal["hinge", "slide"]
    axis: tuple[float, float, float]
    anchor_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    parent: str | None = None
    limits: tuple[float, float] | None = None
    damping: float = 0.0
    stiffness: float = 0.0
    friction: float = 0.0


def wire_poses(wire: WireTable) -> Sequence[Pose]:
    """Return world from segment of a wire: origin at its first end, z along it, twisted as little as can be.

    Between neighbours of length l acts the moment -(EI / l) angle - (damping / l) angular velocity, in
    every direction, so that many segments bend like a beam of flexural rigidity EI; twist the same.

    Args:
        wire: its points, world.
    """
    knots = wire.knots
    axis, rotation, poses = np.array([0.0, 0.0, 1.0]), np.eye(3), []
    for k, length in enumerate(wire.lengths_m):
        ahead = (knots[k + 1] - knots[k]) / length
        rotation = rotation_from_vector(_turn(axis, ahead)) @ rotation
        axis = ahead
        poses.append(Pose(rotation, knots[k]))
    return tuple(poses)


def _turn(a: Array, b: Array) -> Array:
    """Return the shortest rotation vector (3,) [rad] that turns unit vector a to b."""
    normal = np.cross(a, b)
    sine = float(np.linalg.norm(normal))
    angle = float(np.arctan2(sine, a @ b))
    if sine > 1e-12:
        return np.asarray(normal * (angle / sine))
    aside = np.eye(3)[int(np.argmin(np.abs(a)))]
    across = np.cross(a, aside)
    return np.asarray(across * (angle / np.linalg.norm(across)))


CELL: Final = "cell"
"""Body that carries the world of the cell; its own names are behind it and a slash."""


@final
@dataclass(frozen=True)
class CellJoint:
    """A joint of a cell, which a drive moves.

    Args:
        name: of the joint, or of its body if it has none.
        slides: whether it does, or turns.
        limits: smallest and largest place [m] or [rad]; infinite without any.
    """

    name: str
    slides: bool
    limits: tuple[float, float]


@final
@dataclass(frozen=True)
class Cell:
    """A cell, ready to be put around an arm.

    Args:
        path: of its MJCF.
        spec: MuJoCo's specification of it; copied before it is used.
        touched: how many geoms collide.
        has_plane: whether a plane of it collides, which then is the floor.
        joints: that drives move, in the order of the compiled model.
        ignored: options of the file that the scene has otherwise, with their values.
    """

    path: Path
    spec: Any
    touched: int
    has_plane: bool
    joints: tuple[CellJoint, ...]
    ignored: tuple[str, ...]

    @property
    def report(self) -> str:
        """What to say about it."""
        floor = "its plane is the floor" if self.has_plane else "on the scene's floor"
        text = f"{self.path.name}, {self.touched} geoms that can be touched, {floor}"
        if self.joints:
            text = f"{text}; driven: {', '.join(joint.name for joint in self.joints)}"
        return f"{text}; options left out: {', '.join(self.ignored)}" if self.ignored else text


FLANGE_SITE, FORCE_SENSOR, TORQUE_SENSOR = "flange", "flange_force", "flange_torque"
FLANGE_CONTACTS = "flange_contacts"
OBJECT_CONTACTS = "contacts of"
"""What names of sensors begin with that count an object's contacts: with all, then with each flange."""
VISUAL_GROUP = 1  # MuJoCo's URDF reader puts what is drawn into this geom group


@dataclass(frozen=True)
class SceneObject:
    """A rigid body of one shape, or of several parts.

    Args:
        name: unique in the scene.
        shape: as of a `Geometry`, about the body's frame; None for a body that is made of its parts.
        size_m: as of `[[object]]`; of a plane, its edges along x and y.
        position_m: (3,) [m], of the body's frame, world; the centre of a shape that is no mesh.
        quaternion: (w, x, y, z), world from object.
        mass_kg: 0 for an object that stands still; parts share it by volume times relative density.
        rgba: colour, components 0 to 1.
        friction: sliding friction coefficient.
        inertia: (3,) [kg m^2], about the centre of mass, body axes; None: that of its solids.
        center_of_mass_m: (3,), body frame, where `inertia` is given.
        spin_friction_m: torsional and rolling friction, torque by normal force; None: MuJoCo knows none.
        contact_time_s: of what is mounted on the flange: in which what touches it comes to move with it.
        mesh: of shape "mesh", see `Geometry`.
        convex: of shape "mesh", see `Geometry`.
        parts: further solids on the same body; they may overlap.
        joint: that it hangs on; None for a body that is free, or stands still.
    """

    name: str
    shape: str | None = None
    size_m: tuple[float, ...] = ()
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    mass_kg: float = 0.0
    rgba: tuple[float, float, float, float] = (0.75, 0.55, 0.35, 1.0)
    friction: float = 0.8
    mesh: solid.TriangleMesh | None = None
    convex: bool = True
    parts: tuple[Geometry, ...] = ()
    joint: Joint | None = None
    inertia: tuple[float, float, float] | None = None
    center_of_mass_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spin_friction_m: tuple[float, float] | None = None
    contact_time_s: float = 0.004

    @property
    def geometries(self) -> tuple[Geometry, ...]:
        """All solids of the body, its own shape first."""
        if self.shape is None:
            return self.parts
        own = Geometry(
            self.shape,
            self.size_m,
            rgba=self.rgba,
            friction=self.friction,
            mesh=self.mesh,
            convex=self.convex,
        )
        return (own, *self.parts)


@dataclass(frozen=True)
class ServoGains:
    """Gains of the joint servos, torque = stiffness (q_ref - q) + damping (v_ref - v) + feedforward.

    Args:
        stiffness: (joints,) [N m/rad].
        damping: (joints,) [N m s/rad].
    """

    stiffness: Array
    damping: Array

    @classmethod
    def of(cls, arm: arm_file.ArmFile, effort: Array) -> "ServoGains":
        """Return the gains of an arm's file, or such that grow with the joint's torque limit.

        500 max(1, effort / 37.5 N m) and a fifth of it: on the UR5e 2000/400 and 500/100, the values
        in common use for this arm in MuJoCo. A prismatic joint gives its whole force at 20 mm, 1 kN at least.

        Args:
            arm: whose joints.
            effort: (joints,) [N m], of prismatic joints [N]; 0 where there is no limit.
        """
        effort = np.asarray(effort, dtype=np.float64)
        stiffness = 500.0 * np.maximum(1.0, effort / 37.5)
        stiffness = np.where(arm.prismatic, 50.0 * np.maximum(1e3, effort), stiffness)
        stiffness = _given(arm.servo_stiffness, stiffness)
        return cls(stiffness, _given(arm.servo_damping, 0.2 * stiffness))


def _given(values: Array | None, others: Array) -> Array:
    """Return values that an arm's file gives, and others where it gives none."""
    return others if values is None else np.where(np.isnan(values), others, values)


@dataclass(frozen=True)
class SceneDescription:
    """Everything that a rigid scene is built from.

    Args:
        arm: fixed to the world.
        tick_s: length of a tick [s].
        substeps: how many steps MuJoCo takes in one.
        gravity: (3,) [m/s^2], world.
        world_from_base: pose of the arm's root link; that of the arm's file unless given.
        objects: bodies around the arm.
        wires: around the arm.
        mounted: bodies fixed to the flange, posed in its frame.
        floor_height_m: height of a floor plane [m], or None for no floor.
        cell: what else stands around the arm; a plane of it is the floor.
        armature: rotor inertia seen at each joint [kg m^2]; those of the arm's file unless given.
        gains: of the servos; those of the arm's file, or from its torque limits, unless given.
        friction: of pairs of bodies, and of the film on them.
        prefix: of the names of the arm's bodies, joints and sensors among several arms, such as left/.
    """

    arm: arm_file.ArmFile
    tick_s: float = 0.002
    substeps: int = 1
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    world_from_base: Pose | None = None
    objects: tuple[SceneObject, ...] = ()
    wires: tuple[WireTable, ...] = ()
    mounted: tuple[SceneObject, ...] = ()
    floor_height_m: float | None = 0.0
    cell: Cell | None = None
    armature: float | None = None
    gains: ServoGains | None = None
    friction: PairFriction = PairFriction()
    prefix: str = ""

    @property
    def step_s(self) -> float:
        """Length of a step of MuJoCo [s]."""
        return self.tick_s / self.substeps

    def objects_by_parent(self) -> tuple[SceneObject, ...]:
        """Return the objects in an order in which each comes after the one that it hangs on.

        Raises:
            InputError: an object hangs on itself, or on one that is not there.
        """
        ordered: list[SceneObject] = []
        waiting = list(self.objects)
        while waiting:
            there = {None, *(item.name for item in ordered)}
            ready = [item for item in waiting if (item.joint and item.joint.parent) in there]
            if not ready:
                names = ", ".join(repr(item.name) for item in waiting)
                raise InputError(f"{names}: hang on themselves, or on an object that is not there")
            ordered += ready
            there |= {item.name for item in ready}
            waiting = [item for item in waiting if item.name not in there]
        return tuple(ordered)

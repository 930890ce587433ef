"""Triangle meshes of the visible geoms of a MuJoCo model, for drawing. Triangles are counter-clockwise seen
from outside.
"""

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.base.solid import BodyShape
from cosim.rigid.build import object_bodies
from cosim.rigid.build.description import VISUAL_GROUP

SEGMENTS = 32
_MOST_LINES = 200  # that a plane or a height field is drawn with, along an edge
Mesh = tuple[Array, IntArray]
_TILE_M = 0.25
_DARKER = 0.90


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

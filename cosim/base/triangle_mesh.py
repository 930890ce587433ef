"""Reads triangle meshes from STL and OBJ files: closed meshes of rigid objects, and surfaces with named
groups of triangles for films. STL repeats a corner for every triangle, so corners closer than 1e-6 of the
mesh's size become one vertex. In a closed mesh every edge belongs to two triangles, which run along it in
opposite directions. The volume of a closed mesh is V = sum det(a, b, c) / 6 over its triangles.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from cosim.base.components import components
from cosim.base.files import read_file
from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import MeshError

MESH_SUFFIXES = (".stl", ".obj")
LARGEST_FILE_BYTES = 50_000_000
MOST_TRIANGLES = 200_000
MOST_SHELLS = 500
_SMALLEST, _LARGEST = 1e-6, 1e6  # of a mesh, in the unit of its file, from um in m to km in mm
_SAME_PLACE = 1e-6  # of the mesh's size
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@final
@dataclass(frozen=True)
class TriangleMesh:
    """A closed surface.

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3), counter-clockwise seen from outside.
    """

    vertices: Array
    triangles: IntArray

    @property
    def volume_m3(self) -> float:
        """Enclosed volume, sum of det(a, b, c) / 6 over the triangles."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return float(np.einsum("mr,mr->", a, np.cross(b, c)) / 6.0)

    def scaled(self, factor: float) -> "TriangleMesh":
        """Return the mesh with its vertices multiplied by a factor."""
        return TriangleMesh(factor * self.vertices, self.triangles)

    def shells(self) -> "tuple[TriangleMesh, ...]":
        """Return the pieces that share no vertex, each as its own mesh.

        Raises:
            MeshError: there are more than `MOST_SHELLS`.
        """
        edges = np.concatenate([self.triangles[:, (0, 1)], self.triangles[:, (0, 2)]])
        piece = components(len(self.vertices), edges)
        meant = np.unique(piece[self.triangles[:, 0]])
        if len(meant) > MOST_SHELLS:
            raise MeshError(
                f"has {len(meant)} shells, pieces that share no vertex; at most {MOST_SHELLS} are read"
            )
        return tuple(self._piece(piece == k) for k in meant)

    def _piece(self, kept: Array) -> "TriangleMesh":
        place = np.cumsum(kept) - 1
        return TriangleMesh(self.vertices[kept], place[self.triangles[kept[self.triangles[:, 0]]]])


@final
@dataclass(frozen=True)
class GroupedSurface:
    """A surface, which may have open rims, with named groups of triangles.

    Args:
        vertices: (n, 3) [m].
        triangles: (m, 3), with the orientation of the file.
        groups: ascending indices of triangles, by the name of the group.
    """

    vertices: Array
    triangles: IntArray
    groups: dict[str, IntArray]


def read_mesh(path: Path) -> TriangleMesh:
    """Return the closed mesh of a file, turned right side out.

    Args:
        path: ends in .stl (binary or text) or .obj; lengths in m.

    Raises:
        MeshError: the file cannot be read, is too large, holds no triangles, or its surface is not closed.
    """
    return _closed(_read(path)[0], path.name)


def read_surface(path: Path) -> GroupedSurface:
    """Return the surface of a file, closed or not; the groups are those of `g` lines of an OBJ file.

    Args:
        path: ends in .stl (binary or text) or .obj; lengths in m.

    Raises:
        MeshError: the file cannot be read, is too large, or holds no triangles.
    """
    corners, names = _read(path)
    vertices, triangles, kept = _merged(corners, path.name)
    places: dict[str, list[int]] = {}
    for place, row in enumerate(np.flatnonzero(kept).tolist()):
        for name in names[row] if names else ():
            places.setdefault(name, []).append(place)
    return GroupedSurface(
        vertices, triangles, {name: np.array(rows, dtype=np.int64) for name, rows in places.items()}
    )


def _read(path: Path) -> tuple[Array, list[tuple[str, ...]]]:
    """Return the corners (m, 3, 3) of a file's triangles, and the groups that each is in; none of STL."""
    names: list[tuple[str, ...]] = []
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise MeshError(f"{path.name}: a mesh file ends in {' or '.join(MESH_SUFFIXES)}")
    try:
        data = read_file(path, LARGEST_FILE_BYTES)
        if path.suffix.lower() == ".stl":
            corners = _stl_corners(data)
        else:
            corners, names = _obj_corners(data.decode())
    except OSError as error:
        raise MeshError(f"{path.name}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise MeshError(
            f"{path.name}: is not a {path.suffix[1:].upper()} file: not a text from byte {error.start}"
        ) from error
    except ValueError as error:
        raise MeshError(f"{path.name}: is not a {path.suffix[1:].upper()} file: {error!s:.120}") from error
    if not len(corners) or not np.isfinite(corners).all():
        raise MeshError(
            f"{path.name}: holds {'a number that is not finite' if len(corners) else 'no triangles'}"
        )
    if len(corners) > MOST_TRIANGLES:
        raise MeshError(f"{path.name}: holds {len(corners)} triangles; at most {MOST_TRIANGLES} are read")
    return corners, names


def _stl_corners(data: bytes) -> Array:
    """Return the corners (m, 3, 3) of an STL file; a binary one is as long as its count says."""
    if len(data) >= 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]:
        with np.errstate(invalid="ignore"):  # of what is no number; it is refused later
            return np.asarray(np.frombuffer(data, _FACET, offset=84)["corners"], dtype=np.float64)
    words = data.decode("ascii").split()
    if not words or words[0].lower() != "solid":
        raise ValueError("neither its length nor its first word fits")
    places = [k for k, word in enumerate(words) if word.lower() == "vertex"]
    if len(places) % 3:
        raise ValueError(f"{len(places)} corners are not triangles")
    return _points([words[k + 1 : k + 4] for k in places]).reshape(-1, 3, 3)


def _obj_corners(text: str) -> tuple[Array, list[tuple[str, ...]]]:
    """Return the corners (m, 3, 3) and groups of an OBJ file; faces with more corners become fans."""
    lines = [line.split() for line in text.splitlines()]
    vertices = _points([line[1:4] for line in lines if line[:1] == ["v"]])
    triangles, before = list[tuple[int, int, int]](), 0
    names, here = list[tuple[str, ...]](), tuple[str, ...]()
    for word, *rest in filter(None, lines):
        before += word == "v"
        if word == "g":
            here = tuple(dict.fromkeys(rest))
        if word == "f":
            fan = list(_fan(rest, before, len(vertices)))
            triangles += fan
            names += [here] * len(fan)
    corners = vertices[np.array(triangles, dtype=np.int64)] if triangles else np.zeros((0, 3, 3))
    return np.asarray(corners), names


def _points(words: list[list[str]]) -> Array:
    """Return points (n, 3) from the words of their coordinates."""
    short = next((k for k, point in enumerate(words, start=1) if len(point) != 3), None)
    if short is not None:
        raise ValueError(f"vertex {short} has {len(words[short - 1])} coordinates; must have 3")
    return np.array([[float(word) for word in point] for point in words]).reshape(-1, 3)


def _fan(words: list[str], before: int, count: int) -> Iterator[tuple[int, int, int]]:
    """Yield the triangles of one face; OBJ counts from 1, and with negative numbers back from the face."""
    numbers = [int(word.split("/")[0]) for word in words]
    places = [number - 1 if number > 0 else before + number for number in numbers]
    for number, place in zip(numbers, places, strict=True):
        if not 0 <= place < count:
            raise ValueError(f"a face names vertex {number}; there are {count}")
    for k in range(1, len(places) - 1):
        yield places[0], places[k], places[k + 1]


def _merged(corners: Array, name: str) -> tuple[Array, IntArray, Mask]:
    """Return vertices (n, 3), triangles (k, 3) and which of the given ones (m,) these are: no lines."""
    points = corners.reshape(-1, 3)
    size = float(np.ptp(points, axis=0).max())
    if size == 0.0:
        raise MeshError(f"{name}: all its corners are in one place")
    if not (size >= _SMALLEST and np.abs(points).max() <= _LARGEST):
        furthest = np.abs(points).max()
        raise MeshError(
            f"{name}: is {size:g} wide and reaches to {furthest:g}; must be {_SMALLEST:g} wide at least "
            f"and reach to {_LARGEST:g} at most"
        )
    cell = np.round(points / (_SAME_PLACE * size)).astype(np.int64)
    _, first, place = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    triangles = place.reshape(-1, 3)
    a, b, c = triangles.T
    kept = (a != b) & (b != c) & (c != a)
    return points[first], np.asarray(triangles[kept], dtype=np.int64), kept


def _closed(corners: Array, name: str) -> TriangleMesh:
    vertices, triangles, _ = _merged(corners, name)
    edges = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    n = len(vertices)
    there, back = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    open_edges = int((~np.isin(there, back)).sum()) + len(there) - len(np.unique(there))
    if open_edges:
        raise MeshError(f"{name}: is not closed: {open_edges} of {len(there)} edges have no counterpart")
    shells = TriangleMesh(vertices, triangles).shells()
    size = float(np.ptp(vertices, axis=0).max())
    if any(abs(shell.volume_m3) < 1e-9 * size**3 for shell in shells):
        raise MeshError(f"{name}: encloses no volume")
    return _joined(shells)


def _joined(shells: tuple[TriangleMesh, ...]) -> TriangleMesh:
    """Return shells as one mesh, their triangles counter-clockwise seen from outside."""
    before = np.cumsum([0, *(len(shell.vertices) for shell in shells)])
    turned = [shell.triangles[:, :: 1 if shell.volume_m3 > 0.0 else -1] for shell in shells]
    return TriangleMesh(
        np.concatenate([shell.vertices for shell in shells]),
        np.concatenate([triangles + k for triangles, k in zip(turned, before, strict=False)]),
    )

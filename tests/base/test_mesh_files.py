"""Meshes from files: both formats give the same closed surface, anything else is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.resources import object_mesh_path
from cosim.base.triangle_mesh import read_mesh, read_surface
from cosim.errors import MeshError

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def obj(vertices: np.ndarray, faces: list[tuple[int, ...]]) -> str:
    lines = ["v " + " ".join(map(str, vertex)) for vertex in vertices.tolist()]
    return "\n".join(lines + ["f " + " ".join(f"{k + 1}/1/1" for k in face) for face in faces])


def triangles() -> np.ndarray:
    return np.array([[CUBE[f[0]], CUBE[f[k]], CUBE[f[k + 1]]] for f in FACES for k in (1, 2)])


def text_stl() -> str:
    corners = ["\n".join(f"vertex {x} {y} {z}" for x, y, z in t) for t in triangles().tolist()]
    facets = [f"facet normal 0 0 0\nouter loop\n{c}\nendloop\nendfacet" for c in corners]
    return "solid cube\n" + "\n".join(facets) + "\nendsolid cube\n"


def binary_stl() -> bytes:
    facet = np.zeros(12, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    facet["corners"] = triangles()
    return b"solid is no promise".ljust(80) + np.uint32(12).tobytes() + facet.tobytes()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cube.obj", obj(CUBE, FACES).encode()),
        ("inside_out.obj", obj(CUBE, [face[::-1] for face in FACES]).encode()),
        ("counted_backwards.obj", obj(CUBE, [tuple(k - 9 for k in face) for face in FACES]).encode()),
        ("cube.stl", text_stl().encode()),
        ("cube.STL", binary_stl()),
    ],
)
def test_a_cube_is_a_cube(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    mesh = read_mesh(path)
    assert mesh.vertices.shape == (8, 3)
    assert mesh.triangles.shape == (12, 3)
    assert mesh.volume_m3 == pytest.approx(1.0, rel=1e-12)
    assert mesh.scaled(0.1).volume_m3 == pytest.approx(1e-3, rel=1e-12)


def test_shells_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "two.obj"
    faces = FACES + [tuple(k + 8 for k in face) for face in FACES]
    path.write_text(obj(np.concatenate([CUBE, 2.0 * CUBE + 3.0]), faces), encoding="utf-8")
    assert sorted(shell.volume_m3 for shell in read_mesh(path).shells()) == pytest.approx([1.0, 8.0])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("cube.ply", b"", r"ends in \.stl or \.obj"),
        ("open.obj", obj(CUBE, FACES[:5]).encode(), "is not closed: 4 of 30 edges"),
        ("turned.obj", obj(CUBE, [FACES[0][::-1], *FACES[1:]]).encode(), "is not closed"),
        ("flat.obj", obj(CUBE, [FACES[0], FACES[0][::-1]]).encode(), "encloses no volume"),
        ("empty.obj", b"# nothing", "holds no triangles"),
        ("short.stl", b"\x00" * 90, "is not a STL file"),
        ("words.obj", b"v a b c", "is not a OBJ file"),
        ("index.obj", b"v 0 0 0\nf 1 2 3", "a face names vertex 2; there are 1"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", "not finite"),
    ],
)
def test_what_is_no_closed_mesh_is_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(MeshError, match=message):
        read_mesh(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="cannot be read"):
        read_mesh(tmp_path / "nothing.stl")


def test_the_spool_is_three_convex_shells() -> None:
    spool = read_mesh(object_mesh_path("spool.obj"))
    drum, *flanges = sorted(spool.shells(), key=lambda shell: float(np.ptp(shell.vertices[:, 0])))
    polygon = 16.0 * np.sin(2.0 * np.pi / 32)  # area of a 32-gon over its radius squared
    assert drum.volume_m3 == pytest.approx(polygon * 0.024**2 * 0.082, rel=1e-5)
    assert [f.volume_m3 for f in flanges] == pytest.approx([polygon * 0.036**2 * 0.004] * 2, rel=1e-5)


def test_an_open_surface_keeps_its_groups_and_turns(tmp_path: Path) -> None:
    lines = obj(CUBE, FACES).splitlines()
    lines[len(CUBE)] = "g side front\n" + lines[len(CUBE)]
    lines[len(CUBE) + 1] = "g back\n" + lines[len(CUBE) + 1]
    (tmp_path / "open.obj").write_text("\n".join(lines[:-1]), encoding="utf-8")
    facets = "".join(f"{facet}endfacet" for facet in text_stl().split("endfacet")[:10])
    (tmp_path / "open.stl").write_text(facets, encoding="utf-8")
    found = {name: read_surface(tmp_path / f"open.{name}") for name in ("obj", "stl")}
    for surface in found.values():
        np.testing.assert_array_equal(surface.vertices[surface.triangles], triangles()[:10])
    groups = {name: places.tolist() for name, places in found["obj"].groups.items()}
    assert groups == {"side": [0, 1], "front": [0, 1], "back": [2, 3, 4, 5, 6, 7, 8, 9]}
    assert found["stl"].groups == {}
    with pytest.raises(MeshError, match="is not closed"):
        read_mesh(tmp_path / "open.obj")

"""Sharp features of obstacles against film triangles."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from cosim.base.frames import Array, IntArray
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.distance.film_distance import FilmReach, FilmTriangles
from tests.coupling.nearest_film import nearest_film
from tests.rigid.shapes import compiled, hull_vertices, level, to_world


def query_of(*names: str) -> ContactQuery:
    model, data = compiled()
    return ContactQuery(model, data, [model.geom(name).id for name in names])


def test_features_lie_on_edges_and_include_corners() -> None:
    query = query_of("sphere", "box", "cylinder", "hull")
    features = query.features
    assert not (features.shape == 0).any()
    for g, name in ((1, "box"), (2, "cylinder"), (3, "hull")):
        found = query.feature_positions(features.of(np.array([g])))
        model, data = compiled()
        body = model.body(name).id
        local = (found - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
        assert np.abs(level(name, local)).max() < 2e-8  # mesh vertices are single precision
    box = query.features.position[features.shape == 1]
    half = np.array([0.02, 0.015, 0.03])
    assert ((np.abs(np.abs(box) - half) < 1e-12).sum(axis=1) >= 2).all()
    assert ((np.abs(np.abs(box) - half) < 1e-12).sum(axis=1) == 3).sum() == 8
    hull = query.feature_positions(features.of(np.array([3])))
    corners = to_world("hull", hull_vertices()[ConvexHull(hull_vertices()).vertices])
    gap = np.linalg.norm(corners[:, None] - hull[None], axis=2).min(axis=1)
    assert np.mean(gap < 2e-8) > 0.9  # the rest are blunter than what counts as an edge


def cube() -> tuple[Array, IntArray]:
    """Return nodes and outward triangles of the cube |x|, |y|, |z| < 1 cm."""
    hull = ConvexHull(np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0)
    triangles = hull.simplices.copy()
    x = 0.01 * hull.points
    for t, (a, b, c) in enumerate(triangles):
        if np.linalg.det(x[[a, b, c]]) < 0.0:
            triangles[t] = a, c, b
    return x, triangles.astype(np.int64)


def test_distance_to_the_film_is_that_of_the_body_it_encloses() -> None:
    x, triangles = cube()
    points = np.random.default_rng(0).uniform(-0.016, 0.016, size=(3000, 3))
    beyond = np.abs(points) - 0.01
    wanted = np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)
    hits = nearest_film(points, FilmTriangles(x, triangles), FilmReach(0.004, 0.003))
    inside_range = (wanted < 0.004) & (wanted > -0.003)
    np.testing.assert_array_equal(hits.point, np.flatnonzero(inside_range))
    np.testing.assert_allclose(hits.distance, wanted[inside_range], atol=1e-12)
    foot = np.einsum("ka,kar->kr", hits.weight, x[triangles[hits.triangle]])
    np.testing.assert_allclose(foot + hits.distance[:, None] * hits.normal, points[hits.point], atol=1e-12)
    assert ((wanted < 0.0) & inside_range).sum() > 300
    assert ((beyond > 0.0).sum(axis=1) >= 2).sum() > 300  # beside edges and corners, where triangles tie


def test_points_beside_a_sharp_seam_are_outside() -> None:
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * (0.01, 0.01, 0.002)
    hull = ConvexHull(corners)
    triangles = hull.simplices.astype(np.int64)
    for t, (a, b, c) in enumerate(triangles):
        if np.linalg.det(corners[[a, b, c]]) < 0.0:
            triangles[t] = a, c, b
    points = np.random.default_rng(0).uniform(-0.012, 0.012, size=(3000, 3)) * (1.0, 1.0, 0.3)
    inside = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1) < 0.0
    hits = nearest_film(points, FilmTriangles(corners, triangles), FilmReach(0.02, 0.02))
    assert len(hits.point) == len(points)
    assert inside.sum() > 100
    np.testing.assert_array_equal(hits.distance < 0.0, inside)


def test_what_a_face_has_held_back_does_not_come_out_of_the_other_face_of_a_sharp_edge() -> None:
    # a wedge with its edge along y at x = 0, whose faces lean to z = +x / 4 and z = -x / 4
    x = 0.01 * np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.25], [1.0, 0.0, -0.25]])
    triangles = np.array([[0, 2, 1], [0, 1, 3]])
    upper, lower = 0, 1
    assert np.cross(x[2] - x[0], x[1] - x[0])[2] > 0.0

    def face(place: list[float], held: int) -> int:
        film = FilmTriangles(x, triangles)
        hits = nearest_film(np.array([place]), film, FilmReach(0.004, 0.004), held=np.array([held]))
        assert len(hits.point) == 1
        return int(hits.triangle[0])

    below_the_middle = [1.6e-3, 0.0, -1e-4]  # 0.49 mm behind the upper face, 0.29 mm behind the lower one
    assert face(below_the_middle, -1) == face(below_the_middle, lower) == lower
    assert face(below_the_middle, upper) == upper
    # in front of the lower face, yet squarely behind the upper one
    through = [6e-4, 0.0, -2e-4]
    assert face(through, -1) == lower
    assert face(through, upper) == upper
    # beside the edge, or deeper than what rests on a face is
    assert face([-3e-4, 0.0, -2e-4], upper) == lower
    assert face([4e-3, 0.0, -1e-4], upper) == lower

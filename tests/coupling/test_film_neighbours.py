"""Lists of what is near: what they give while they serve is what a whole search gives."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Pose, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.coupling.contact.contact_report import ContactMemory
from cosim.coupling.contact.near_search import NearSearch
from cosim.rigid.build.description import SceneDescription, SceneObject
from cosim.rigid.distance.film_distance import FilmReach, FilmTriangles
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.contact_points import ContactSurface, Extent
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from tests.coupling.nearest_film import nearest_film
from tests.soft.bodies import icosphere

REACH_M, BEHIND_M, MARGIN_M, RADIUS_M = 1.5e-3, 5e-3, 8e-3, 0.03
OBJECTS = (
    SceneObject("box", "box", (0.04, 0.05, 0.03), (0.0, 0.0, 0.52)),
    SceneObject("tin", "cylinder", (0.02, 0.05), (0.05, 0.0, 0.52)),
    SceneObject("ball", "sphere", (0.02,), (0.0, 0.06, 0.52)),
)


def film() -> SoftBody:
    x, triangles = icosphere(3, RADIUS_M)
    return SoftBody.from_arrays(x, triangles, Film(1e8, 0.3, 1e-4), node_mass=1e-4)


@pytest.mark.parametrize("step_m", [2e-4, 1.5e-3])
def test_what_lists_find_is_what_a_whole_search_finds(step_m: float) -> None:
    body = film()
    surface = ContactSurface.of(body, FilmPotential(body).pattern)
    scene = RigidScene(SceneDescription(find_arm("ur5e"), objects=OBJECTS))
    query = scene.contact_query()
    search, nothing = NearSearch(query, surface), ContactMemory.empty(0)
    rng, start, made = np.random.default_rng(0), query.position.copy(), 0
    counts = np.zeros(2)
    for step in range(60):
        # the ball of film rolls over the objects while they are carried along and shaken
        turn = rotation_from_vector(np.array([0.0, 0.3 * step * step_m / RADIUS_M, 0.0]))
        carried = np.array([0.02 * step, 0.0, 0.0])
        query.position[:] = start + carried + 0.5 * step_m * rng.normal(size=start.shape)
        at = carried + np.array([0.7 * step_m * step - 0.02, 0.01, 0.555 + 0.2 * RADIUS_M])
        x = np.ascontiguousarray(Pose(turn, at).apply(body.positions))
        extent = Extent.of(x, np.zeros_like(x))
        active = query.near(extent.low, extent.high, REACH_M)
        if not len(active):
            continue
        asked = x, extent, active, (REACH_M, BEHIND_M), nothing
        near = search.find(*asked)
        if near is None:  # the lists are not valid
            search.build_lists(x, extent, REACH_M + MARGIN_M, BEHIND_M + MARGIN_M)
            made += 1
            near = search.find(*asked)
        assert near is not None
        points, rows = near.points, near.features
        hits = query.distances(surface.points(x), REACH_M, active)
        np.testing.assert_array_equal(points.point, hits.point)
        np.testing.assert_array_equal(points.shape, hits.shape)
        np.testing.assert_array_equal(points.found[:, 0], hits.distance)
        np.testing.assert_array_equal(points.found[:, 1:], hits.normal)
        chosen = query.features.of(active)
        places = query.feature_positions(chosen)
        within = FilmReach(REACH_M, BEHIND_M, extent.low - REACH_M, extent.high + REACH_M)
        seen = nearest_film(places, FilmTriangles(x, surface.triangles), within)
        np.testing.assert_array_equal(rows.feature, chosen[seen.point])
        np.testing.assert_array_equal(rows.triangle, seen.triangle)
        np.testing.assert_array_equal(rows.gap[:, 0], seen.distance)
        counts += len(points.point), len(rows.feature)
    assert (counts > 300).all()
    assert 1 < made < 39

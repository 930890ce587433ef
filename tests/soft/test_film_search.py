"""The search for films over films against a plain one: every point beside every triangle."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, rotation_from_vector
from cosim.soft.contact.self_contact_candidates import UnitMotion
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints, Relation
from cosim.soft.contact.self_contact_search import FilmSearch
from tests.soft.bodies import hexagon_arm, inflated_positions

MARGIN = 0.02  # of a triangle, beyond its edges
FACING = {Relation.VALLEY: 0.0, Relation.APART: 0.5}  # largest cosine of the outer normals


def all_pairs(
    faces: FilmFaces, points: FilmPoints, x: Array, reach: float, behind: float
) -> set[tuple[int, int]]:
    """Return the pairs (point, triangle): of each other unit the nearest triangle, where the films face."""
    place = np.einsum("pa,par->pr", points.weights, x[points.nodes])
    a, b, c = x[faces.triangles].transpose(1, 0, 2)
    areas, outward = np.cross(b - a, c - a), np.zeros_like(place)
    np.add.at(outward, points.on_triangle, areas[:, None])
    normals = areas / np.linalg.norm(areas, axis=1)[:, None]
    direction = outward / np.linalg.norm(outward, axis=1)[:, None]
    found = set()
    for p, y in enumerate(place):
        kind = faces.relation[points.home[p, 0], faces.face]
        d = np.einsum("tr,tr->t", normals, y - a)
        foot = np.linalg.solve(np.stack([b - a, c - a, normals], axis=2), (y - a)[:, :, None])[:, :2, 0]
        inside = np.minimum(foot.min(axis=1), 1.0 - foot.sum(axis=1)) >= -MARGIN
        facing = normals @ direction[p] < np.where(kind == Relation.VALLEY, *FACING.values())
        far = np.where(kind == Relation.VALLEY, reach, max(reach, behind))
        over = inside & (kind != Relation.NONE) & (d >= -behind) & (d <= far)
        # across a valley only what faces the point counts, and nothing that it hangs on
        own = np.isin(faces.triangles, points.nodes[p]).any(axis=1)
        over &= (kind != Relation.VALLEY) | (facing & ~own)
        for unit in np.unique(faces.unit[over]):
            mine = np.flatnonzero(over & (faces.unit == unit))
            nearest = mine[np.abs(d[mine]).argmin()]
            if facing[nearest] and d[nearest] < reach:
                found.add((p, int(nearest)))
    return found


def crumpled(seed: int, height: float) -> tuple[FilmFaces, FilmPoints, Array]:
    """Return faces, points and nodes (n, 3) [m] of three units, at a share of their height."""
    body = hexagon_arm(3)
    faces = FilmFaces.of(body)
    noise = np.random.default_rng(seed).normal(0.0, 5e-3, (body.nodes, 3))
    x = np.ascontiguousarray(inflated_positions(3) * (1.0, 1.0, height) + noise)
    return faces, FilmPoints.of(faces, body.positions), x


@pytest.mark.parametrize(("seed", "height"), [(0, 1.0), (1, 1.0), (2, 0.15), (3, 0.15)])
def test_crumpled_units_are_found_over_one_another(seed: int, height: float) -> None:
    faces, points, x = crumpled(seed, height)
    hits = FilmSearch(faces, points).near(x, 3e-3, 4e-3)
    found = set(zip(hits.point.tolist(), hits.triangle.tolist(), strict=True))
    assert len(found) == len(hits.point)
    assert found == all_pairs(faces, points, x, 3e-3, 4e-3)
    kinds = faces.relation[points.home[hits.point, 0], faces.face[hits.triangle]]
    assert (kinds == Relation.VALLEY).any()
    assert (kinds == Relation.APART).any() == (height < 1.0)


def test_more_pairs_than_there_is_room_for_are_found_all_the_same() -> None:
    faces, points, x = crumpled(2, 0.15)
    search = FilmSearch(faces, points)
    expected = search.near(x, 3e-3, 4e-3)
    untouched = np.full((5, 2), -1)
    search._out = untouched[:4]
    found = search.near(x, 3e-3, 4e-3)
    np.testing.assert_array_equal(found.point, expected.point)
    np.testing.assert_array_equal(found.triangle, expected.triangle)
    assert len(found.point) > 4
    assert (untouched[:4] >= 0).all()
    assert (untouched[4] == -1).all()


@pytest.mark.parametrize("turn_rad", [0.0, 0.1])
def test_lists_that_are_kept_find_what_new_ones_find(turn_rad: float) -> None:
    faces, points, x = crumpled(2, 0.15)
    search, upper = FilmSearch(faces, points), (x[:, 2] > np.median(x[:, 2]))[:, None]
    turn = rotation_from_vector(turn_rad * np.array((0.6, 0.0, 0.8)))
    long: list[Array | None] = [None]
    short: list[Array | None] = [None]
    for _ in range(40):
        # one half slides over the other, and both are carried along
        x = np.ascontiguousarray((x + 1e-4 * upper * (1.0, 0.5, 0.0) + 0.01) @ turn.T)
        hits, fresh = search.near(x, 3e-3, 4e-3), FilmSearch(faces, points).near(x, 3e-3, 4e-3)
        np.testing.assert_array_equal(hits.point, fresh.point)
        np.testing.assert_array_equal(hits.triangle, fresh.triangle)
        for made, kept in (long, search._candidates._before), (short, search._short._before):
            made += [] if kept is made[-1] else [kept]
    assert len(long) == 3
    assert 10 < len(short) < 25


def test_a_point_that_comes_from_beside_is_found_over_its_triangle() -> None:
    faces, points, x = crumpled(2, 0.15)
    search = FilmSearch(faces, points)
    search.near(x, 3e-3, 4e-3)
    rng, here = np.random.default_rng(0), 0
    for _ in range(60):
        x = x + rng.uniform(-1.0, 1.0, x.shape) * 4e-5  # some nodes against their neighbours
        hits = search.near(np.ascontiguousarray(x), 3e-3, 4e-3)
        fresh = FilmSearch(faces, points).near(np.ascontiguousarray(x), 3e-3, 4e-3)
        np.testing.assert_array_equal(hits.triangle, fresh.triangle)
        here += len(hits.triangle)
    assert here > 1000


def test_units_that_are_carried_stay_and_units_that_leave_do_not() -> None:
    faces, _, x = crumpled(0, 1.0)
    motion, turn = (
        UnitMotion(faces.unit_nodes, faces.units_meet),
        rotation_from_vector(np.array((1.0, -2.0, 0.5))),
    )
    carried = np.ascontiguousarray(x @ turn.T + 0.3)
    allowed = np.full((faces.units, faces.units), 1e-9)
    assert motion.stays(carried, x, allowed)
    mirrored = np.ascontiguousarray(x * (1.0, 1.0, -1.0))
    assert not motion.stays(mirrored, x, allowed + 1e-3)
    last = np.unique(faces.triangles[faces.unit == faces.units - 1])
    alone = np.setdiff1d(last, faces.triangles[faces.unit == faces.units - 2])
    for distance in (0.5e-3, 2e-3):
        moved = carried.copy()
        moved[alone] += distance / np.sqrt(3.0)
        assert motion.stays(moved, x, allowed + 1e-3) == (distance < 1e-3)

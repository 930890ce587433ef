"""The search for films over films against a plain one: every point beside every triangle."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, rotation_from_vector
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.overlap_check import OverlapCheck
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints, Relation
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
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


def crumpled(seed: int, height: float) -> tuple[SelfContact, Array]:
    """Return three units that may touch, and nodes (n, 3) [m] at a share of their height."""
    body = hexagon_arm(3)
    noise = np.random.default_rng(seed).normal(0.0, 5e-3, (body.nodes, 3))
    x = np.ascontiguousarray(inflated_positions(3) * (1.0, 1.0, height) + noise)
    return SelfContact(body, FilmContactLaw(ContactLaw())), x


def pairs_at(films: SelfContact, x: Array) -> list[tuple[int, int]]:
    """Return the pairs (point, triangle) that are found, from outside."""
    pairs = films.static_pairs(np.ascontiguousarray(x))
    assert pairs is not None
    outside = pairs.triangle < len(films.faces.triangles)  # the film from inside, and the flange, come after
    points = pairs.key[outside] // films.faces.units
    return list(zip(points.tolist(), pairs.triangle[outside].tolist(), strict=True))


@pytest.mark.parametrize(("seed", "height"), [(0, 1.0), (1, 1.0), (2, 0.15), (3, 0.15)])
def test_crumpled_units_are_found_over_one_another(seed: int, height: float) -> None:
    films, x = crumpled(seed, height)
    faces, found = films.faces, pairs_at(films, x)
    points = FilmPoints.of(faces, hexagon_arm(3).positions)
    assert len(set(found)) == len(found)
    assert set(found) == all_pairs(faces, points, x, 3e-3, 5e-3)
    point, triangle = np.array(found).T
    kinds = faces.relation[points.home[point, 0], faces.face[triangle]]
    assert (kinds == Relation.VALLEY).any()
    assert (kinds == Relation.APART).any() == (height < 1.0)


def test_a_look_finds_the_deepest_point_behind_a_film_that_faces_it() -> None:
    body, depths = hexagon_arm(3), []
    faces, look = FilmFaces.of(body), OverlapCheck(body)
    points = FilmPoints.of(faces, body.positions)
    for seed, height in [(0, 1.0), (2, 0.15), (3, 0.4), (4, 0.1)]:
        x = crumpled(seed, height)[1]
        point, triangle = np.array([*all_pairs(faces, points, x, 0.0, 5e-3)]).T.reshape(2, -1)
        a, b, c = x[faces.triangles[triangle]].transpose(1, 0, 2)
        place, normal = (
            (points.weights[point, :, None] * x[points.nodes[point]]).sum(axis=1),
            np.cross(b - a, c - a),
        )
        depth = np.einsum("kr,kr->k", a - place, normal) / np.linalg.norm(normal, axis=1)
        found, deepest = look.overlap(x), float(depth.max(initial=0.0))
        depths.append(deepest)
        assert (0.0 if found is None else found.depth_m) == pytest.approx(deepest, rel=1e-9)
    assert min(depths) < 4e-3 < max(depths)


def test_more_pairs_than_there_is_room_for_are_found_all_the_same() -> None:
    films, x = crumpled(2, 0.15)
    expected, untouched = pairs_at(films, x), np.full((5, 2), -1)
    films.outside.hits = untouched[:4]
    assert pairs_at(films, x) == expected
    assert len(expected) > 4
    assert (untouched[:4] >= 0).all()
    assert (untouched[4] == -1).all()


@pytest.mark.parametrize("turn_rad", [0.0, 0.1])
def test_lists_that_are_kept_find_what_new_ones_find(turn_rad: float) -> None:
    films, x = crumpled(2, 0.15)
    upper = (x[:, 2] > np.median(x[:, 2]))[:, None]
    turn = rotation_from_vector(turn_rad * np.array((0.6, 0.0, 0.8)))
    made, kept = [0, 0], [np.empty(0), np.empty(0)]
    for _ in range(40):
        # one half slides over the other, and both are carried along
        x = np.ascontiguousarray((x + 1e-4 * upper * (1.0, 0.5, 0.0) + 0.01) @ turn.T)
        assert pairs_at(films, x) == pairs_at(crumpled(2, 0.15)[0], x)
        now = [near.before.copy() for near in (films.outside.long, films.outside.short)]
        made = [n + (not np.array_equal(*both)) for n, *both in zip(made, now, kept, strict=True)]
        kept = now
    assert made[0] <= 3
    assert 10 < made[1] < 25


def test_a_point_that_comes_from_beside_is_found_over_its_triangle() -> None:
    films, x = crumpled(2, 0.15)
    rng, here = np.random.default_rng(0), 0
    pairs_at(films, x)
    for _ in range(60):
        x = x + rng.uniform(-1.0, 1.0, x.shape) * 4e-5  # some nodes against their neighbours
        found = pairs_at(films, x)
        assert found == pairs_at(crumpled(2, 0.15)[0], x)
        here += len(found)
    assert here > 1000


@pytest.mark.parametrize("turn_rad", [0.0, 0.02])
def test_films_that_were_quiet_are_seen_to_press_as_soon_as_they_do(turn_rad: float) -> None:
    body, rng, told = hexagon_arm(3), np.random.default_rng(0), list[bool]()
    x, films = inflated_positions(3).copy(), SelfContact(body, FilmContactLaw(ContactLaw()))
    last = np.unique(films.faces.triangles[films.faces.unit == 2])
    for k in range(100):  # the last unit comes up to the others, and all are carried along
        x[last] += 2e-5 * rng.normal(size=(len(last), 3)) + (0.0, 0.0, 1e-4 * (k % 13 < 9))
        turn = rotation_from_vector(k * turn_rad * np.array((0.6, 0.0, 0.8)))
        carried = np.ascontiguousarray((x + 0.01 * k) @ turn.T)
        told.append(films.presses_at_rest(carried))
        assert told[-1] == SelfContact(body, FilmContactLaw(ContactLaw())).presses_at_rest(carried)
    assert 70 < told.index(True) < 95


def test_lists_serve_units_that_are_carried_and_not_units_that_leave() -> None:
    films, x = crumpled(0, 1.0)
    faces, lists = films.faces, films.outside
    pairs_at(films, x)
    turn = rotation_from_vector(np.array((1.0, -2.0, 0.5)))
    carried = np.ascontiguousarray(x @ turn.T + 0.3)
    last = np.unique(faces.triangles[faces.unit == faces.units - 1])
    alone = np.setdiff1d(last, faces.triangles[faces.unit == faces.units - 2])
    moved = carried.copy()
    for distance, stays in ((0.0, True), (1e-4, True), (1e-3, False)):
        moved[alone] = carried[alone] + distance / np.sqrt(3.0)
        pairs_at(films, moved)
        assert np.array_equal(films.outside.short.before, x) == stays
        assert np.array_equal(lists.long.before, x)
    pairs_at(films, x * (1.0, 1.0, -1.0))  # no rotation
    assert not np.array_equal(films.outside.long.before, x)


def test_units_that_are_just_too_far_for_the_list_may_move_as_far_as_near_ones() -> None:
    body, x = hexagon_arm(3), inflated_positions(3) * (1.0, 1.0, 0.5)
    films = SelfContact(body, FilmContactLaw(ContactLaw()))
    unit_nodes = films.faces.unit_nodes
    last = np.setdiff1d(unit_nodes[2], unit_nodes[1])
    films.static_pairs(np.ascontiguousarray(x))
    for distance_m, stays in ((2.8e-3, True), (3.3e-3, True), (3.7e-3, False)):
        moved = x.copy()
        moved[last, 0] += distance_m
        films.static_pairs(moved)
        assert np.array_equal(films.outside.long.before, x) == stays

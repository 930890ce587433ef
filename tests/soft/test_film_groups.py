"""Bodies of several films: each face group has its material, all else speaks of the body's triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray, Pose
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody, stored_energy
from cosim.soft.body.copies import Plate, around_axis, attached, copies
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.elements.membrane import Membranes
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.named_mesh import refine
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.surface import triangle_area
from tests.derivatives import RELATIVE, dense, derivative_errors
from tests.soft.bodies import FILM, hexagon_arm, shapes

DOUBLE = replace(FILM, thickness_m=2.0 * FILM.thickness_m)
SOFT = Film(0.4e9, 0.3, 0.05e-3, law="tension_field")
STEP_M = 1e-6
POSES = around_axis(2, 0.1, 0.4)


def groups_of(triangles: IntArray) -> dict[str, IntArray]:
    """Return two groups that lie across each other."""
    odd = np.arange(len(triangles)) % 3 == 1
    return {"wall": np.flatnonzero(~odd), "neck": np.flatnonzero(odd)}


def body_of(neck: Film, wall: Film = FILM, units: int = 1) -> SoftBody:
    arm = hexagon_arm(units)
    triangles = arm.triangles
    films = {"wall": wall, "neck": neck}
    mixed = SoftBody.from_arrays(
        arm.positions, triangles, films, face_groups=groups_of(triangles), caps=arm.caps, node_mass=1e-3,
        base=arm.base, tip=arm.tip,
    )  # fmt: skip
    return mixed.with_other(type(arm.hinges), arm.hinges)


def evaluated(body: SoftBody, x: Array) -> tuple[float, Array, Array]:
    system = FilmPotential(body)
    loads = Loads((10e3,))
    energy = system.evaluate(x, loads, np.zeros(0), system.memory.copy())
    return energy, system.gradient.copy(), dense(system.pattern, system.blocks)


def film_energy(body: SoftBody, x: Array) -> float:
    return stored_energy(body, x)[Membranes]


def test_groups_of_one_film_are_one_film() -> None:
    arm, same, x = body_of(FILM), hexagon_arm(1), shapes(1)["inflated"]
    assert film_energy(arm, x) == pytest.approx(film_energy(same, x), rel=1e-12)
    assert len(arm.membranes) == 1


def test_each_group_has_its_own_film() -> None:
    x, double, single = shapes(1)["inflated"], body_of(DOUBLE), body_of(FILM)
    neck = slice(len(groups_of(single.triangles)["wall"]), None)
    assert [part.film for part in double.membranes] == [FILM, DOUBLE]
    own = Membranes.from_shape(single.positions, single.triangles[neck], FILM)
    unused = np.zeros_like(x), np.zeros((0, 3, 3))
    added = own.add(x, np.zeros((0, 0), np.int64), *unused)
    assert added > 0.0
    assert film_energy(double, x) - film_energy(single, x) == pytest.approx(added, rel=1e-9)


def test_derivatives_with_two_films() -> None:
    body, x = body_of(SOFT), shapes(1)["inflated"]
    assert max(derivative_errors(lambda at: evaluated(body, at), x, STEP_M)) < 10.0 * RELATIVE


def test_values_of_all_triangles_come_in_the_bodys_order() -> None:
    body, x = body_of(SOFT), shapes(1)["inflated"]
    np.testing.assert_allclose(body.areas, triangle_area(body.positions, body.triangles), rtol=1e-12)
    stress, strain = body.principal_stress(x), body.strain(x)
    start = 0
    for part in body.membranes:
        own = slice(start, start + len(part.triangles))
        np.testing.assert_array_equal(body.triangles[own], part.triangles)
        np.testing.assert_array_equal(stress[own], part.principal_stress(x))
        np.testing.assert_array_equal(strain[own], part.strain(x))
        start = own.stop
    assert start == len(body.triangles) == len(stress)


def test_chambers_of_copies_hold_their_own_film() -> None:
    single = body_of(DOUBLE)
    pair = copies(single, POSES)
    assert [part.film for part in pair.membranes] == [FILM, DOUBLE] * 2
    for k, chamber in enumerate(pair.gas_chambers):
        own = pair.triangles[chamber.triangles]
        np.testing.assert_array_equal(own, single.triangles + k * single.nodes)


def test_a_part_of_another_film_is_attached_with_its_chamber() -> None:
    arm, part = body_of(DOUBLE, units=2), body_of(FILM, wall=DOUBLE)
    both = attached(arm, "arm", part, "hand", Pose(np.eye(3), np.array([0.0, 0.0, 0.02])), Plate(0.1, 1e6))
    # the carrier's last film is the part's first one
    assert [len(films.triangles) for films in both.membranes] == [
        len(arm.membranes[0].triangles),
        len(arm.membranes[1].triangles) + len(part.membranes[0].triangles),
        len(part.membranes[1].triangles),
    ]
    for chamber, whole, shift in zip(both.gas_chambers, (arm, part), (0, arm.nodes), strict=True):
        np.testing.assert_array_equal(both.triangles[chamber.triangles], whole.triangles + shift)


def test_groups_that_leave_a_triangle_without_a_film_are_refused() -> None:
    arm = hexagon_arm(1)
    triangles, groups = arm.triangles, groups_of(arm.triangles)
    short = {**groups, "neck": groups["neck"][1:]}
    with pytest.raises(MeshError, match="triangle 1 belongs to 0 of the face groups wall, neck"):
        SoftBody.from_arrays(arm.positions, triangles, {"wall": FILM, "neck": DOUBLE}, face_groups=short)
    with pytest.raises(MeshError, match="a film is for face group 'rim'; there are wall, neck"):
        SoftBody.from_arrays(arm.positions, triangles, {"rim": FILM}, face_groups=groups)
    beyond = {"wall": np.array([len(triangles)])}
    with pytest.raises(MeshError, match=f"face group wall has triangle {len(triangles)}"):
        SoftBody.from_arrays(arm.positions, triangles, {"wall": FILM}, face_groups=beyond)
    twice = {**groups, "wall": np.concatenate([groups["wall"], groups["wall"][:1]])}
    with pytest.raises(MeshError, match="face group wall has a triangle twice"):
        replace(PolygonalStack(6, 1, 0.05, 0.01, 0.002).mesh(), face_groups={"wall": np.array([0, 1, 0])})
    with pytest.raises(MeshError, match="face group wall has a triangle twice"):
        SoftBody.from_arrays(arm.positions, triangles, {"wall": FILM, "neck": DOUBLE}, face_groups=twice)


def test_parts_of_a_triangle_have_its_groups_and_values() -> None:
    drawn = PolygonalStack(6, 2, 0.05, 0.01, 0.002).mesh()
    area = triangle_area(drawn.positions, drawn.triangles)
    carrying = replace(drawn, face_groups=groups_of(drawn.triangles), face_values={"area_m2": area})
    fine = refine(carrying, 2)
    assert fine.face_groups.keys() == {"wall", "neck"}
    parts = triangle_area(fine.positions, fine.triangles)
    np.testing.assert_allclose(fine.face_values["area_m2"], 16.0 * parts, rtol=1e-9)
    for name, places in carrying.face_groups.items():
        whole, cut = area[places].sum(), parts[fine.face_groups[name]].sum()
        assert cut == pytest.approx(whole, rel=1e-12), name
    with pytest.raises(MeshError, match="face values area_m2 have shape"):
        replace(drawn, face_values={"area_m2": area[1:]})

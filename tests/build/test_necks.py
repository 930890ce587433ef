"""`refine_holes` and `neck` of a stack: what the soft body has of them, and how stiffly it tilts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray
from cosim.build.paper_model import published_robot
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.schema.film import FilmTable
from cosim.config.schema.settings import ModelTable
from cosim.config.schema.soft_robot import HingeTable, MassTable, SoftRobotTable, StiffenerTable
from cosim.config.schema.stack import NeckTable, StackTable
from cosim.errors import ScenarioError
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.hinge import shell_stiffness
from cosim.soft.geometry.surface import triangles_beside
from tests.known_answers.stacks import OpenSpecimen, tilt_stiffness

FUSED_M = 0.008
STEPS_KPA = (0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0)
SQUARE: dict[str, Any] = {
    "sides": 4, "corner_radius_m": 0.03 * 2**0.5, "hole_radius_m": 0.002 * 2**0.5,
    "ring_heights": (0.2, 0.5, 0.8),
}  # fmt: skip


def unit(
    refine: int, holes: int, fused_radius_m: float = 0.0, law: str = "plain", framed: bool = False
) -> SoftBody:
    """Return the body of one square unit: film of 0.11 mm, no hinge along its seam.

    Args:
        refine: how often every triangle is cut.
        holes: how often those at the holes are, before.
        fused_radius_m: within which films are fused; 0 for none.
        law: of the film.
        framed: whether a stiff frame holds the seam.
    """
    stack = StackTable(
        **SQUARE, units=1, unit_height_m=0.002, refine=refine, refine_holes=holes,
        neck=NeckTable(fused_radius_m) if fused_radius_m else None,
    )  # fmt: skip
    film: Any = {"young_modulus_Pa": 1.3e9, "poisson_ratio": 0.2, "thickness_m": 0.11e-3, "law": law}
    robot = SoftRobotTable(
        name="unit", source="a test", stack=stack, film=FilmTable(**film),
        hinge=HingeTable(rule="shell"), mass=MassTable(1e-3),
        stiffener=StiffenerTable("stiff" if framed else "none", 1e6),
    )  # fmt: skip
    return build_soft_body(robot, ModelTable())


@pytest.fixture
def robot() -> SoftRobotTable:
    robot = load_scenario("three_unit_inflation").soft_robot
    assert isinstance(robot, SoftRobotTable)
    return replace(published_robot(robot), hinge=replace(robot.hinge, rule="shell"))


def built(robot: SoftRobotTable, **changes: Any) -> SoftBody:
    return build_soft_body(replace(robot, stack=replace(robot.stack, **changes)), ModelTable())


def inflated(kPa: float, *mesh: Any, **changes: Any) -> OpenSpecimen:
    sample = OpenSpecimen(unit(*mesh, **changes))
    for step in (*STEPS_KPA, kPa):
        sample.load_to(1e3 * step)
    return sample


@pytest.mark.parametrize("refine", [0, 1])
@pytest.mark.parametrize("holes", [0, 1, 2])
@pytest.mark.parametrize("fused", [0.0, FUSED_M])
def test_the_table_knows_how_many_triangles(
    robot: SoftRobotTable, refine: int, holes: int, fused: float
) -> None:
    assert robot.stack is not None
    neck = NeckTable(fused) if fused else None
    meshes: list[Literal["drawn", "graded"]] = ["graded"] if fused and not holes else ["drawn", "graded"]
    for mesh in meshes:
        stack = replace(robot.stack, mesh=mesh, refine=refine, refine_holes=holes, neck=neck)
        body = build_soft_body(replace(robot, stack=stack), ModelTable())
        assert stack.triangles == len(body.triangles)


@pytest.mark.parametrize(
    ("changes", "tolerance"),
    [({"refine_holes": 1}, 0.1), ({"refine_holes": 2}, 0.1), ({"mesh": "graded"}, 0.11)],
)
def test_masses_stay_where_they_are(robot: SoftRobotTable, changes: dict[str, Any], tolerance: float) -> None:
    drawn, finer = built(robot), built(robot, **changes)
    assert finer.mass_kg == pytest.approx(drawn.mass_kg, rel=1e-12)

    def moments(body: SoftBody) -> list[float]:
        x, y, z = body.positions.T
        return [float(body.node_mass @ of) / body.mass_kg for of in (z, x * x, y * y)]

    # nodes are spread over the area around them, which is wider outwards; evenly over all nodes: -43 %
    np.testing.assert_allclose(moments(finer), moments(drawn), rtol=tolerance)


def test_fused_film_is_twice_as_thick(robot: SoftRobotTable) -> None:
    heavy = replace(robot, film=replace(robot.film, density_kg_m3=1e3))
    single, fused = (
        built(heavy, refine_holes=2, neck=neck) for neck in (NeckTable(FUSED_M), NeckTable(0.8 * FUSED_M))
    )
    plain, thick = single.membranes
    assert thick.film == replace(plain.film, thickness_m=2.0 * plain.film.thickness_m)
    assert single.mass_kg - fused.mass_kg == pytest.approx(
        1e3 * plain.film.thickness_m * (thick.areas.sum() - fused.membranes[1].areas.sum()), rel=1e-6
    )
    hinges, triangles = single.hinges.nodes, single.triangles
    rigidity = robot.hinge.stiffness_factor * plain.film.flexural_rigidity_Nm
    bare = shell_stiffness(single.positions, triangles, hinges, rigidity)
    beside = triangles_beside(triangles, hinges)
    sides: IntArray = (beside >= len(plain.triangles)).sum(axis=1)
    ratio = single.hinges.stiffness / bare
    for count, expected in enumerate((1.0, 16.0 / 9.0, 8.0)):
        assert (sides == count).any()
        np.testing.assert_allclose(ratio[sides == count], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "path", "message"),
    [
        ({"neck.fused_radius_m": 0.002}, "neck.fused_radius_m", "must lie between hole_radius_m, 0.00282843"),
        ({"neck.fused_radius_m": 0.0151}, "neck.fused_radius_m", "and the mid rings, .* 0.015 from the axis"),
        ({"neck.fused_radius_m": 0.008, "refine_holes": 0}, "refine_holes", "is 0; a neck needs 1 or 2"),
        ({"refine_holes": 3}, "refine_holes", "out of bounds"),
    ],
)
def test_necks_without_room_are_refused(changes: dict[str, Any], path: str, message: str) -> None:
    stack = {"mesh": "drawn", "refine_holes": 1, **changes}
    given = {f"soft_robot.stack.{key}": value for key, value in stack.items()}
    with pytest.raises(ScenarioError, match=message) as told:
        load_scenario("three_unit_inflation", given)
    assert told.value.path == f"soft_robot.stack.{path}"


def test_a_unit_tilts_as_finite_elements_do() -> None:
    # 24.5 +- 2.5 mN m/rad at 10 kPa; the drawn mesh has 131
    stiffness = 1e3 * tilt_stiffness(inflated(10.0, 0, 2, law="wrinkling"))
    assert stiffness == pytest.approx(22.8, rel=0.01)
    assert 0.85 * 22.0 < stiffness < 1.15 * 27.0


def test_a_framed_unit_tilts_as_its_finest_mesh_does() -> None:
    # 27.3 mN m/rad with 4608 triangles, 90 on the drawn mesh
    assert 1e3 * tilt_stiffness(inflated(10.0, 0, 2, framed=True)) == pytest.approx(27.3, rel=0.1)


def test_refinement_hardly_changes_the_tilt_of_fused_necks() -> None:
    coarse, fine = (tilt_stiffness(inflated(10.0, refine, 2, FUSED_M, framed=True)) for refine in (0, 1))
    assert fine == pytest.approx(coarse, rel=0.1)
    assert 1e3 * fine == pytest.approx(56.1, rel=0.02)


def test_a_graded_mesh_answers_as_the_mesh_refined_twice_does() -> None:
    # one framed unit; the drawn mesh is 11 % too small, 1 % too short, 30 % too stiff
    robot = load_scenario("ur5e_hexagon_arm").soft_robot
    assert isinstance(robot, SoftRobotTable)

    def figures(mesh: Literal["drawn", "graded"], finer: int) -> Array:
        assert robot.stack is not None
        one = replace(robot, stack=replace(robot.stack, units=1, mesh=mesh, refine_holes=1), cables=())
        sample = OpenSpecimen(build_soft_body(one, ModelTable(), finer=finer))
        for step in (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0):
            sample.load_to(1e3 * step)
        return np.array([sample.volume_m3, sample.extension_m, tilt_stiffness(sample)])

    off = figures("graded", 0) / figures("drawn", 2) - 1.0
    assert (np.abs(off) < (0.04, 0.02, 0.07)).all(), off

"""From a robot's description to a soft body: refinement keeps what must stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.identity import content_name
from cosim.base.resources import scenario_path
from cosim.build.paper_model import published_robot
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.schema.settings import ModelTable
from cosim.config.schema.soft_robot import SoftRobotTable, StiffenerTable
from cosim.config.schema.stack import NeckTable
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import SoftBody, stored_energy
from cosim.soft.body.loads import Loads
from cosim.soft.elements.hinge import bending_measure
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.surface import triangle_area
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions


@pytest.fixture(scope="module")
def robot() -> SoftRobotTable:
    """Return the paper's hexagonal arm cut down to its first unit, without cables."""
    arm = published_robot(load_scenario(str(scenario_path("ur5e_hexagon_arm"))).soft_robot)
    return replace(arm, stack=replace(arm.stack, units=1), cables=())


def refined(
    robot: SoftRobotTable, levels: int, rule: str = "uniform", model: ModelTable | None = None
) -> SoftBody:
    changed = replace(robot, stack=replace(robot.stack, refine=levels), hinge=replace(robot.hinge, rule=rule))
    return build_soft_body(changed, model or ModelTable())


def test_unrefined_uniform_hinges_have_the_given_stiffness(robot: SoftRobotTable) -> None:
    body = refined(robot, 0)
    expected = robot.hinge.stiffness_factor * body.membranes[0].film.bending_stiffness_Nm
    assert (body.hinges.stiffness == expected).all()


@pytest.mark.parametrize("all_hinges", [True, False])
@pytest.mark.parametrize("levels", [1, 2])
def test_refined_uniform_hinges_keep_the_bending_energy(
    robot: SoftRobotTable, levels: int, all_hinges: bool
) -> None:
    model = ModelTable(all_hinges=all_hinges)
    coarse, fine = refined(robot, 0, model=model), refined(robot, levels, model=model)
    measures = [
        bending_measure(body.positions, body.hinges.nodes, body.hinges.stiffness) for body in (coarse, fine)
    ]
    assert measures[1] == pytest.approx(measures[0], rel=1e-12)
    assert np.ptp(fine.hinges.stiffness) == 0.0
    assert len(coarse.hinges.nodes) == (108 if all_hinges else 84)


@pytest.mark.parametrize("levels", [0, 2])
def test_shell_hinges_have_the_film_s_rigidity(robot: SoftRobotTable, levels: int) -> None:
    body = refined(robot, levels, "shell")
    area = float(triangle_area(body.positions, body.triangles).sum())
    rigidity = robot.hinge.stiffness_factor * body.membranes[0].film.flexural_rigidity_Nm
    measure = bending_measure(body.positions, body.hinges.nodes, body.hinges.stiffness)
    assert measure == pytest.approx(rigidity * area, rel=1e-12)


def test_refinement_keeps_the_mass(robot: SoftRobotTable) -> None:
    heavy = replace(
        robot, mass=replace(robot.mass, seam_mass_kg=0.003), film=replace(robot.film, density_kg_m3=1e3)
    )
    coarse, fine = refined(heavy, 0), refined(heavy, 2)
    assert coarse.mass_kg > 48 * robot.mass.node_mass_kg + 12 * 0.003
    assert fine.mass_kg == pytest.approx(coarse.mass_kg, rel=1e-12)


@pytest.mark.parametrize("levels", [0, 1])
def test_frames_ring_the_outer_rims(robot: SoftRobotTable, levels: int) -> None:
    assert refined(robot, levels).frames is None
    framed = replace(robot, stiffener=replace(robot.stiffener, kind="stiff"))
    body = refined(framed, levels)
    assert body.frames is not None
    np.testing.assert_array_equal(body.frames.rings, body.rings["unit_1.outer"][None])


BEAM = StiffenerTable("beam", width_m=2e-3, height_m=4e-3, young_modulus_Pa=2e9, density_kg_m3=1250.0)


def test_beams_ring_the_outer_rims_with_their_mass(robot: SoftRobotTable) -> None:
    coarse, fine = (refined(replace(robot, stiffener=BEAM), levels) for levels in (0, 1))
    (beams,) = coarse.of_kind(BeamRings)
    np.testing.assert_array_equal(beams.rings, coarse.rings["unit_1.outer"][None])
    assert beams.section == RectangularSection(2e-3, 4e-3, 2e9)
    # six sides of 50 mm
    assert coarse.mass_kg - refined(robot, 0).mass_kg == pytest.approx(1250.0 * 8e-6 * 0.3, rel=1e-10)
    assert fine.mass_kg == pytest.approx(coarse.mass_kg, rel=1e-12)
    # every node of the rim carries as much, and stands for the same length on each side
    np.testing.assert_allclose(np.ptp(coarse.node_mass[beams.rings]), 0.0, atol=1e-12)


@pytest.mark.parametrize("levels", [0, 1])
def test_frames_smaller_than_the_rim_have_shorter_beams_and_less_mass(
    robot: SoftRobotTable, levels: int
) -> None:
    small = replace(BEAM, side_ratio=0.99)
    fitting, slack = (refined(replace(robot, stiffener=table), levels) for table in (BEAM, small))
    (beams,), (shorter,) = (body.of_kind(BeamRings) for body in (fitting, slack))
    np.testing.assert_allclose(shorter.lengths, 0.99 * beams.lengths, rtol=1e-14)
    np.testing.assert_array_equal(slack.positions, fitting.positions)
    bare_kg = refined(robot, levels).mass_kg
    assert slack.mass_kg - bare_kg == pytest.approx(0.99 * (fitting.mass_kg - bare_kg), rel=1e-10)
    stiff = StiffenerTable("stiff", side_ratio=0.99)
    frames = refined(replace(robot, stiffener=stiff), levels).frames
    whole = refined(replace(robot, stiffener=StiffenerTable("stiff")), levels).frames
    assert frames is not None
    assert whole is not None
    np.testing.assert_allclose(frames.lengths, 0.99 * whole.lengths, rtol=1e-14)


def test_the_paper_s_model_takes_away_what_a_file_adds(robot: SoftRobotTable) -> None:
    bare = replace(robot, film=replace(robot.film, law="plain"), stiffener=StiffenerTable())
    ours = replace(
        robot,
        stack=replace(robot.stack, refine_holes=1, neck=NeckTable(0.012)),
        film=replace(robot.film, law="wrinkling", wrinkle_panel_m=0.02),
        hinge=replace(robot.hinge, rule="shell"),
        stiffener=BEAM,
    )
    published = build_soft_body(ours, ModelTable(published=True))
    assert content_name(published) == content_name(build_soft_body(bare, ModelTable()))
    assert content_name(published) != content_name(build_soft_body(ours, ModelTable()))
    bars = replace(ours, film=replace(robot.film, law="edge_strain"))
    assert build_soft_body(bars, ModelTable(published=True)).membranes[0].film.law == "edge_strain"


def test_the_paper_s_model_is_also_that_of_what_a_robot_carries() -> None:
    robot = load_soft_robot("arm_with_gripper")
    part = robot.attachments[0]
    film = replace(robot.film, law="wrinkling")
    carried = replace(part, robot=replace(part.robot, film=film, stiffener=BEAM))
    ours = replace(robot, film=film, attachments=(carried,))
    published = build_soft_body(ours, ModelTable(published=True))
    assert content_name(published) == content_name(build_soft_body(robot, ModelTable(published=True)))
    assert {membranes.film.law for membranes in published.membranes} == {"plain"}
    assert not published.of_kind(BeamRings)


def test_attached_copies_keep_their_beams() -> None:
    arm = load_scenario("gripper_lifts_bridge").soft_robot
    assert isinstance(arm, SoftRobotTable)
    (part,) = arm.attachments
    finger = replace(part.robot, stiffener=BEAM)
    robot = replace(arm, stiffener=BEAM, attachments=(replace(part, robot=finger),))
    body = build_soft_body(robot, ModelTable())
    own, fingers = body.of_kind(BeamRings)
    assert finger.copies is not None
    assert len(own.rings) == arm.stack.units
    assert len(fingers.rings) == finger.stack.units * finger.copies.count
    assert fingers.rings.min() > own.rings.max()
    assert stored_energy(body, body.positions)[BeamRings] < 1e-15
    assert stored_energy(body, 1.01 * body.positions)[BeamRings] > 1e-2


def test_beams_of_a_refined_mesh_store_the_same_energy(robot: SoftRobotTable) -> None:
    energies = []
    for levels in (0, 1):
        body = refined(replace(robot, stiffener=BEAM), levels)
        x = body.positions * [1.02, 0.99, 1.0]  # an affine image keeps the drawn sides straight
        energies.append(stored_energy(body, x)[BeamRings])
    assert energies[1] == pytest.approx(energies[0], rel=0.02)
    assert energies[0] > 1e-3


@pytest.mark.parametrize(
    ("levels", "rule"),
    [(0, "uniform"), (1, "uniform"), (2, "uniform"), (0, "shell"), (1, "shell"), (2, "shell"), (3, "shell")],
)
def test_a_refined_unit_inflates(robot: SoftRobotTable, levels: int, rule: str) -> None:
    body = refined(robot, levels, rule)
    held = np.zeros(body.nodes, dtype=bool)
    held[body.base] = True
    system = FilmPotential(body)
    solver = NewtonSolver(system, held)
    x, angles = body.positions, system.memory.copy()
    options = NewtonOptions(iterations_max=300)
    for pressure in np.linspace(0.0, 1e3, 5)[1:]:
        result = solver.solve(x, angles, Loads((pressure,), (), (0.0, 0.0, 0.0)), options)
        assert result.converged, result.outcome
        x, angles = result.positions, result.memory
    stretch = body.tip_position(x)[2] - body.tip_position(body.positions)[2]
    # a unit of 50 mm radius opens by some millimetres to some 20
    assert 2e-3 < stretch < 0.03

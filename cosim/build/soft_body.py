"""Makes a soft body from a soft robot's description."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.build.given_body import LEAST_RING
from cosim.build.mesh_source import drawn_mesh
from cosim.build.published_robot import published_robot
from cosim.build.stack_source import NODES_PER_AREA, cable_route, drawn_stack, stack_mesh
from cosim.config.rules.scenario_rules import LEAST_NODE_MASS_kg
from cosim.config.schema.body_source import MeshTable
from cosim.config.schema.film import FilmTable, StiffenerTable
from cosim.config.schema.soft_robot import (
    ARM_CHAMBER,
    AttachmentTable,
    SoftRobotTable,
)
from cosim.config.schema.solver import ModelTable
from cosim.config.schema.stack import CableTable
from cosim.errors import MeshError, ScenarioError
from cosim.soft.beams.beam_rings import BeamRings
from cosim.soft.beams.rectangular_section import RectangularSection
from cosim.soft.body.attachment import Plate, attached
from cosim.soft.body.body import SoftBody
from cosim.soft.body.copies import around_axis, copies
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.elements.material import Film
from cosim.soft.elements.shell_hinges import bending_measure, shell_stiffness
from cosim.soft.geometry.face_groups import mean_beside
from cosim.soft.geometry.holes import FUSED
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.surface import interior_hinges, triangle_area
from cosim.soft.published.hinges import without_spring

_REST = ""  # name of the face group of all triangles that are in none with a film of its own
_KEPT_STIFFNESS = 1e-4  # of the plain law in a tension field: slack triangles beside hinges would collapse


def build_film(table: FilmTable) -> Film:
    """Return a film."""
    f = table
    kept = _KEPT_STIFFNESS if f.law == "tension_field" else 0.0
    return Film(f.young_modulus_Pa, f.poisson_ratio, f.thickness_m, f.law, kept, f.wrinkle_panel_m)


def build_soft_body(robot: SoftRobotTable, model: ModelTable, path: str = "soft_robot") -> SoftBody:
    """Return the soft body of a robot, in the flange frame.

    Args:
        robot: its description.
        model: comparison switches; `published` decides before anything of the description does.
        path: of the description's table.

    Raises:
        MeshError: the geometry gives degenerate triangles.
        ScenarioError: a film wrinkles, and nothing says how wide its panels are; `path` names the key.
    """
    if model.published:
        robot = published_robot(robot)
    drawn = _drawn(robot)
    mesh = drawn if robot.stack is None else stack_mesh(drawn, robot.stack)
    _check_panels(robot, mesh, path)
    hinges, stiffness = _hinges(robot, model, drawn, mesh)
    base = np.unique(np.concatenate([mesh.ring(name) for name in robot.base]))
    body = SoftBody.from_arrays(
        mesh.positions,
        mesh.triangles,
        _films(robot),
        face_groups=_face_groups(robot, mesh),
        wrinkle_panel_m=mesh.face_values.get("wrinkle_panel_m", 0.0),
        hinge_nodes=hinges,
        hinge_stiffness=stiffness,
        fold_barrier_rad=robot.hinge.fold_barrier_rad,
        caps=mesh.caps,
        closed=model.closed,
        cables=tuple(_cable(mesh, entry) for entry in robot.cables),
        node_mass=_node_mass(robot, drawn, mesh),
        base=base,
        tip=mesh.ring(mesh.tip_ring),
        rings=mesh.rings,
    )
    body = replace(body, center_rings=mesh.center_rings, frame_rings=mesh.seam_rings)
    if robot.stiffener.kind != "none":
        body = body.with_elements(_stiffener(mesh, robot.stiffener))
    body = body.with_elements(*(entry.element(body) for entry in robot.elements))
    if robot.copies is not None:
        c = robot.copies
        body = copies(body, around_axis(c.count, c.radius_m, c.tilt_rad, c.spin_rad, c.height_m))
    for entry in robot.attachments:
        body = _with_attachment(body, entry, model, f"{path}.attach.{entry.name}.robot")
    return body


def _drawn(robot: SoftRobotTable) -> NamedMesh:
    """Return the unrefined mesh of a robot."""
    if robot.stack is not None:
        return drawn_stack(robot.stack)
    assert robot.body is not None, "a checked robot has one of the two"
    mesh: NamedMesh = drawn_mesh(robot.body) if isinstance(robot.body, MeshTable) else robot.body.mesh()
    for name in robot.body.set_names():
        mesh.ring(name)
    if len(mesh.ring(mesh.tip_ring)) < LEAST_RING:
        raise MeshError(
            f"the tip, {mesh.tip_ring!r}, has {len(mesh.ring(mesh.tip_ring))} nodes; a ring of {LEAST_RING} "
            "is needed at least"
        )
    return mesh


def _films(robot: SoftRobotTable) -> Film | dict[str, Film]:
    film = build_film(robot.film)
    own = {name: build_film(table) for name, table in _own_films(robot).items()}
    return {_REST: film, **own} if own else film


def _own_films(robot: SoftRobotTable) -> dict[str, FilmTable]:
    """Return the films of face groups that have one of their own."""
    own = {entry.name: entry.film for entry in robot.groups}
    if robot.stack is None or robot.stack.neck is None:
        return own
    return {**own, FUSED: replace(robot.film, thickness_m=2.0 * robot.film.thickness_m)}


def _face_groups(robot: SoftRobotTable, mesh: NamedMesh) -> dict[str, IntArray]:
    """Return the face groups, and under a name of its own what is in none with a film."""
    own = [mesh.face_groups[name] for name in _own_films(robot) if name in mesh.face_groups]
    rest = np.setdiff1d(np.arange(len(mesh.triangles)), np.concatenate([np.zeros(0, np.int64), *own]))
    return {**mesh.face_groups, _REST: rest}


def _of_triangles(robot: SoftRobotTable, mesh: NamedMesh, value: Callable[[FilmTable], float]) -> Array:
    """Return a value (m,) of the film of each triangle."""
    found = np.full(len(mesh.triangles), value(robot.film))
    for name, film in _own_films(robot).items():
        found[mesh.face_groups[name]] = value(film)
    return found


def _check_panels(robot: SoftRobotTable, mesh: NamedMesh, path: str) -> None:
    """Refuse films that wrinkle on a mesh that does not say how wide their panels are."""
    known, groups = mesh.face_values.get("wrinkle_panel_m"), _face_groups(robot, mesh)
    for name, film in {_REST: robot.film, **_own_films(robot)}.items():
        places = groups.get(name, ())
        needs = film.law == "wrinkling" and film.wrinkle_panel_m is None and len(places) > 0
        if needs and (known is None or not (known[places] > 0.0).all()):
            table = f"{path}.film" if name == _REST else f"{path}.group.{name}.film"
            raise ScenarioError(
                f"{table}.wrinkle_panel_m",
                "is required for mesh bodies whose film has law = 'wrinkling': set it to the distance "
                "between seams, in m",
            )


def _with_attachment(body: SoftBody, entry: AttachmentTable, model: ModelTable, path: str) -> SoftBody:
    top = body.tip_position(body.positions) + np.array([0.0, 0.0, entry.height_m])
    plate = Plate(entry.plate.mass_kg, entry.plate.stiffness_N_m)
    part = build_soft_body(entry.robot, model, path)
    return attached(body, ARM_CHAMBER, part, entry.name, Pose(np.eye(3), top), plate)


def _cable(mesh: NamedMesh, entry: CableTable) -> Cable:
    return Cable(
        cable_route(mesh, entry),
        1.0 if entry.capstan_factor is None else entry.capstan_factor,
        entry.friction_coefficient or 0.0,
        entry.stiffness_N_m,
    )


def _hinges(
    robot: SoftRobotTable, model: ModelTable, coarse: NamedMesh, mesh: NamedMesh
) -> tuple[IntArray, Array]:
    """Return hinge nodes (h, 4) and their stiffness (h,) [N m/rad].

    The published subset of hinges exists on the unrefined mesh only; a refined mesh has all hinges, with
    a uniform stiffness scaled to the bending measure of the unrefined ones.
    """
    refined = mesh is not coarse
    drawn = interior_hinges(coarse.triangles, coarse.seam)
    if not model.all_hinges:
        drawn = drawn[~without_spring(coarse, drawn)]
    hinges = interior_hinges(mesh.triangles, mesh.seam) if refined else drawn
    factor = robot.hinge.stiffness_factor
    if robot.hinge.rule == "shell":
        rigidity = _of_triangles(robot, mesh, lambda film: factor * build_film(film).flexural_rigidity_Nm)
        beside = mean_beside(mesh.triangles, hinges, rigidity)
        return hinges, shell_stiffness(mesh.positions, mesh.triangles, hinges, beside)
    stiffness = _of_triangles(robot, mesh, lambda film: factor * build_film(film).bending_stiffness_Nm)
    uniform = mean_beside(mesh.triangles, hinges, stiffness)
    if refined:
        uniform *= bending_measure(coarse.positions, drawn) / bending_measure(mesh.positions, hinges)
    return hinges, uniform


def _stiffener(mesh: NamedMesh, table: StiffenerTable) -> FrameRings | BeamRings:
    rings = np.array([mesh.ring(name) for name in mesh.seam_rings])
    if table.kind == "stiff":
        return FrameRings.from_shape(mesh.positions, rings, table.stiffness_N_m)
    return BeamRings.from_shape(mesh.positions, rings, _section(table))


def _section(table: StiffenerTable) -> RectangularSection:
    # what is missing was refused before
    width, height, modulus = table.width_m or 0.0, table.height_m or 0.0, table.young_modulus_Pa or 0.0
    return RectangularSection(width, height, modulus, table.poisson_ratio, table.strength_strain or math.inf)


def _node_mass(robot: SoftRobotTable, coarse: NamedMesh, mesh: NamedMesh) -> Array:
    """Return the mass (n,) [kg] of each node; a refined mesh spreads what the unrefined one carries."""
    evenly = 0.0 if NODES_PER_AREA in mesh.face_values else robot.mass.node_mass_kg
    mass = np.full(len(mesh.positions), evenly * len(coarse.positions) / len(mesh.positions))
    if len(mesh.seam):
        mass[mesh.seam] += robot.mass.seam_mass_kg * len(coarse.seam) / len(mesh.seam)
    areal = _of_triangles(robot, mesh, lambda film: film.density_kg_m3 * film.thickness_m)
    if NODES_PER_AREA in mesh.face_values:  # its nodes are closer at the holes
        areal += robot.mass.node_mass_kg * mesh.face_values[NODES_PER_AREA]
    share = areal / 3.0 * triangle_area(mesh.positions, mesh.triangles)
    for corner in range(3):
        np.add.at(mass, mesh.triangles[:, corner], share)
    if robot.stiffener.kind == "beam":
        _add_beam_mass(mass, mesh, robot.stiffener)
    if mass.min() < LEAST_NODE_MASS_kg:
        raise MeshError(
            f"node {mass.argmin()} has a mass of {mass.min():g} kg; every node needs "
            f"{LEAST_NODE_MASS_kg:g} kg at least: give mass.node_mass_kg or film.density_kg_m3"
        )
    return mass


def _add_beam_mass(mass: Array, mesh: NamedMesh, table: StiffenerTable) -> None:
    per_length = table.density_kg_m3 * _section(table).area_m2
    for ring in (mesh.ring(name) for name in mesh.seam_rings):
        following = np.roll(ring, -1)
        length = np.linalg.norm(mesh.positions[following] - mesh.positions[ring], axis=1)
        mass[ring] += 0.5 * per_length * (length + np.roll(length, 1))

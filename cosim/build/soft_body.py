"""Builds the soft body of a robot's table: mesh, films, hinges, masses, cables, stiffeners, copies and
attachments.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cosim.base import triangle_mesh
from cosim.base.frames import Array, IntArray, Pose, in_mm
from cosim.build.given_body import LEAST_RING
from cosim.build.mesh_file import drawn_mesh
from cosim.build.paper_model import published_robot
from cosim.build.stack import NODES_PER_AREA, stack_meshes
from cosim.config.schema import body_sources, pattern, settings, soft_robot
from cosim.config.schema.film import FilmTable
from cosim.errors import MeshError, ScenarioError
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import GasChamber, SoftBody
from cosim.soft.body.copies import Plate, around_axis, attached, copies
from cosim.soft.elements import element, frame_ring, frame_stops, material, open_caps
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.fabric import Fabric
from cosim.soft.elements.hinge import bending_measure, shell_stiffness
from cosim.soft.geometry.named_mesh import BENDING_FACTOR, NamedMesh, refine, rest_angles
from cosim.soft.geometry.polygonal_stack import FUSED
from cosim.soft.geometry.surface import interior_hinges, mean_beside, rows_of, triangle_area

_REST = ""  # face group of all triangles that have the robot's film
_KEPT_STIFFNESS = 1e-4  # of the plain law in a tension field: slack triangles next to hinges would collapse


def cable_route(mesh: NamedMesh, table: soft_robot.CableTable) -> IntArray:
    """Return the nodes of a mesh that a cable leads through, base to tip."""
    if table.units is None:
        return mesh.line(table.line or "")
    lines = np.stack([line for name, line in mesh.lines.items() if name.startswith("corner_")])
    first, last = table.units
    along = np.arange(first - 1, len(lines[0]) if last == "last" else last)
    corners = (table.corner or 0) + table.corners_per_unit * np.arange(len(along))
    return np.asarray(lines[corners % len(lines), along])


def build_film(table: FilmTable) -> material.Film:
    """Return the material of a film's table."""
    f = table
    kept = _KEPT_STIFFNESS if f.law == "tension_field" else 0.0
    young_modulus_Pa, fabric = f.young_modulus_Pa, None
    if f.fabric is not None:
        w = f.fabric
        young_modulus_Pa, strain = w.modulus_warp_Pa, (w.straight_strain_warp, w.straight_strain_weft)
        fabric = Fabric(
            w.modulus_weft_Pa, w.shear_modulus_Pa, w.warp_direction, w.straight_modulus_Pa, strain
        )
    assert young_modulus_Pa is not None, "a checked film has one of the two"
    return material.Film(
        young_modulus_Pa, f.poisson_ratio, f.thickness_m, f.law, kept, f.wrinkle_panel_m, f.loss_factor,
        f.loss_frequency_Hz, fabric, f.buckling_force_N_m, f.stiffening,
    )  # fmt: skip


def build_soft_body(
    robot: soft_robot.SoftRobotTable, model: settings.ModelTable, path: str = "soft_robot", finer: int = 0
) -> SoftBody:
    """Return the soft body of a robot, in the flange frame.

    Args:
        robot: its description.
        model: switches for comparison with the paper; `published` overrides the description.
        path: of the description's table, for messages.
        finer: additional refinements, each of which divides every triangle into four.

    Raises:
        MeshError: the geometry gives degenerate triangles.
        ScenarioError: a film wrinkles, and the width of its panels is unknown.
    """
    if model.published:
        robot = published_robot(robot)
    drawn, mesh = _drawn_body(robot) if robot.stack is None else stack_meshes(robot.stack)
    mesh = refine(mesh, finer)
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
        hinge_rest_angle=rest_angles(mesh, hinges),
        fold_barrier_rad=robot.hinge.fold_barrier_rad,
        caps=mesh.caps,
        closed=model.closed,
        cables=tuple(_cable(mesh, entry) for entry in robot.cables),
        node_mass=_node_mass(robot, drawn, mesh),
        base=base,
        tip=mesh.ring(mesh.tip_ring),
        rings=mesh.rings,
    )
    body = replace(
        body,
        center_rings=mesh.center_rings,
        frame_rings=mesh.seam_rings,
        chambers=_chambers(robot, mesh),
        tip_along=mesh.tip_along,
    )
    if robot.stiffener.kind != "none":
        body = body.with_elements(*_stiffeners(mesh, robot))
    body = body.with_elements(*(entry.element(body) for entry in robot.elements))
    if robot.copies is not None:
        c = robot.copies
        body = copies(body, around_axis(c.count, c.radius_m, c.tilt_rad, c.spin_rad, c.height_m))
    for entry in robot.attachments:
        body = _with_attachment(body, entry, model, f"{path}.attach.{entry.name}.robot", finer)
    return body


def _drawn_body(robot: soft_robot.SoftRobotTable) -> tuple[NamedMesh, NamedMesh]:
    """Return the mesh of a robot that is not a stack as its drawn and as its refined mesh."""
    assert robot.body is not None, "a checked robot has one of the two"
    mesh: NamedMesh
    if isinstance(robot.body, body_sources.MeshTable):
        mesh = drawn_mesh(robot.body)
        _check_held(mesh, robot.base)
    elif isinstance(robot.body, pattern.PatternTable):
        from cosim.build.patterns import drawn_pattern  # imported here because few robots need the mesher

        mesh = drawn_pattern(robot.body, robot.base[0], robot.stiffener.kind != "none")
    else:
        mesh = robot.body.mesh()
    for name in robot.body.set_names():
        mesh.ring(name)
    if len(mesh.ring(mesh.tip_ring)) < LEAST_RING:
        raise MeshError(
            f"the tip, {mesh.tip_ring!r}, has {len(mesh.ring(mesh.tip_ring))} nodes; a ring of {LEAST_RING} "
            "is needed at least"
        )
    return mesh, mesh


def _check_held(mesh: NamedMesh, base: Sequence[str]) -> None:
    """Check that a base holds every connected piece of a film.

    Raises:
        MeshError: one is not held.
    """
    held = mesh.positions[np.unique(np.concatenate([mesh.ring(name) for name in base]))]
    for piece in triangle_mesh.TriangleMesh(mesh.positions, mesh.triangles).shells():
        if not (held[:, None] == piece.vertices).all(axis=2).any():
            raise MeshError(
                f"the piece of film around {in_mm(piece.vertices.mean(axis=0))} shares no node with the "
                f"rest, and no base ({', '.join(base)}) holds it: join it, or remove it"
            )


def _films(robot: soft_robot.SoftRobotTable) -> material.Film | dict[str, material.Film]:
    film = build_film(robot.film)
    by_group = {name: build_film(table) for name, table in _group_films(robot).items()}
    return {_REST: film, **by_group} if by_group else film


def _group_films(robot: soft_robot.SoftRobotTable) -> dict[str, FilmTable]:
    """Return the films of face groups that differ from the robot's film, by group."""
    films = {entry.name: entry.film for entry in robot.groups}
    if robot.stack is None or robot.stack.neck is None:
        return films
    return {**films, FUSED: replace(robot.film, thickness_m=2.0 * robot.film.thickness_m)}


def _face_groups(robot: soft_robot.SoftRobotTable, mesh: NamedMesh) -> dict[str, IntArray]:
    """Return the triangles of each face group; those with the robot's film are the group `_REST`."""
    groups = [mesh.face_groups[name] for name in _group_films(robot) if name in mesh.face_groups]
    rest = np.setdiff1d(np.arange(len(mesh.triangles)), np.concatenate([np.zeros(0, np.int64), *groups]))
    return {**mesh.face_groups, _REST: rest}


def _chambers(robot: soft_robot.SoftRobotTable, mesh: NamedMesh) -> tuple[GasChamber, ...]:
    """Return the chambers of a film with several, in the body's order of triangles, which is film by film."""
    if not mesh.chambers:
        return ()
    groups, films = _face_groups(robot, mesh), _films(robot)
    order = np.concatenate([groups[name] for name in films]) if isinstance(films, dict) else None
    row = np.arange(len(mesh.triangles))
    if order is not None:
        row[order] = np.arange(len(order))
    chambers = []
    for name in mesh.chambers:
        triangles = mesh.face_groups[name]
        nodes = set(mesh.triangles[triangles].ravel().tolist())
        caps = tuple(k for k, cap in enumerate(mesh.caps) if nodes.issuperset(cap.tolist()))
        chambers.append(GasChamber(name, np.sort(row[triangles]), caps))
    return tuple(chambers)


def _of_triangles(
    robot: soft_robot.SoftRobotTable, mesh: NamedMesh, value: Callable[[FilmTable], float]
) -> Array:
    """Return a value (m,) of the film of each triangle."""
    values = np.full(len(mesh.triangles), value(robot.film))
    for name, film in _group_films(robot).items():
        if name in mesh.face_groups:  # an unknown name is refused when the body is built
            values[mesh.face_groups[name]] = value(film)
    return values


def _check_panels(robot: soft_robot.SoftRobotTable, mesh: NamedMesh, path: str) -> None:
    """Check that the panel width of every wrinkling film is known.

    Raises:
        ScenarioError: neither the film's table nor the mesh gives it.
    """
    known, groups = mesh.face_values.get("wrinkle_panel_m"), _face_groups(robot, mesh)
    for name, film in {_REST: robot.film, **_group_films(robot)}.items():
        triangles = groups.get(name, ())
        needs = film.law == "wrinkling" and film.wrinkle_panel_m is None and len(triangles) > 0
        if needs and (known is None or not (known[triangles] > 0.0).all()):
            table = f"{path}.film" if name == _REST else f"{path}.group.{name}.film"
            raise ScenarioError(
                f"{table}.wrinkle_panel_m",
                "is required for mesh bodies whose film has law = 'wrinkling': set it to the distance "
                "between seams, in m",
            )


def _with_attachment(
    body: SoftBody, entry: soft_robot.AttachmentTable, model: settings.ModelTable, path: str, finer: int
) -> SoftBody:
    top = body.tip_position(body.positions) + np.array([0.0, 0.0, entry.height_m])
    plate = Plate(entry.plate.mass_kg, entry.plate.stiffness_N_m)
    part = build_soft_body(entry.robot, model, path, finer)
    return attached(body, soft_robot.ARM_CHAMBER, part, entry.name, Pose(np.eye(3), top), plate)


def _cable(mesh: NamedMesh, entry: soft_robot.CableTable) -> Cable:
    return Cable(
        cable_route(mesh, entry),
        1.0 if entry.capstan_factor is None else entry.capstan_factor,
        entry.friction_coefficient or 0.0,
        entry.stiffness_N_m,
        entry.eyelet_loss_N,
        entry.losses == "directed",
        entry.damping_Ns_m,
    )


def _hinges(
    robot: soft_robot.SoftRobotTable, model: settings.ModelTable, coarse: NamedMesh, mesh: NamedMesh
) -> tuple[IntArray, Array]:
    """Return hinge nodes (h, 4) and their stiffness (h,) [N m/rad].

    The published subset of hinges exists on the unrefined mesh only; a refined mesh has all hinges, with
    a uniform stiffness scaled to the bending measure of the unrefined ones.
    """
    refined = mesh is not coarse
    drawn = _folds(coarse)
    if not model.all_hinges:
        drawn = [(places, folds[~open_caps.without_spring(coarse, folds)]) for places, folds in drawn]
    sheets = _folds(mesh) if refined else drawn
    hinges = rows_of([folds for _, folds in sheets])
    factor = robot.hinge.stiffness_factor * mesh.face_values.get(BENDING_FACTOR, 1.0)
    if robot.hinge.rule == "shell":
        rigidity = factor * _of_triangles(robot, mesh, lambda film: build_film(film).flexural_rigidity_Nm)
        return hinges, rows_of([_shell(mesh, places, folds, rigidity) for places, folds in sheets])
    stiffness = factor * _of_triangles(robot, mesh, lambda film: build_film(film).bending_stiffness_Nm)
    uniform = rows_of([mean_beside(mesh.triangles[at], folds, stiffness[at]) for at, folds in sheets])
    if refined:
        before = rows_of([folds for _, folds in drawn])
        uniform *= bending_measure(coarse.positions, before) / bending_measure(mesh.positions, hinges)
    return hinges, uniform


def _folds(mesh: NamedMesh) -> list[tuple[IntArray, IntArray]]:
    """Return the triangles (t,) of each sheet, or of the film that is one, and its edges that fold (h, 4)."""
    sheets = [mesh.face_groups[name] for name in mesh.sheets] or [np.arange(len(mesh.triangles))]
    return [(places, interior_hinges(mesh.triangles[places], mesh.seam)) for places in sheets]


def _shell(mesh: NamedMesh, places: IntArray, folds: IntArray, rigidity: Array) -> Array:
    """Return the stiffness (h,) [N m/rad] of a sheet's folds, from the rigidity (m,) of all triangles."""
    triangles = mesh.triangles[places]
    return shell_stiffness(mesh.positions, triangles, folds, mean_beside(triangles, folds, rigidity[places]))


def _stiffeners(mesh: NamedMesh, robot: soft_robot.SoftRobotTable) -> list[element.Element]:
    rings, table = np.array([mesh.ring(name) for name in mesh.seam_rings]), robot.stiffener
    if table.kind == "stiff":
        frames = frame_ring.FrameRings.from_shape
        return [frames(mesh.positions, rings, table.stiffness_N_m, table.side_ratio)]
    beams = BeamRings.from_shape(mesh.positions, rings, _section(table), table.side_ratio)
    found: list[element.Element] = [beams]
    if table.rest_on_one_another and len(rings) > 1:
        found.append(frame_stops.FrameStops.from_shape(mesh.positions, rings, robot.frame_pitch_m))
    return found


def _section(table: soft_robot.StiffenerTable) -> RectangularSection:
    # the table's rules require these three for beams
    width, height, modulus = table.width_m or 0.0, table.height_m or 0.0, table.young_modulus_Pa or 0.0
    return RectangularSection(width, height, modulus, table.poisson_ratio, table.strength_strain or np.inf)


def _node_mass(robot: soft_robot.SoftRobotTable, coarse: NamedMesh, mesh: NamedMesh) -> Array:
    """Return the mass (n,) [kg] of each node; a refined mesh has the mass of the unrefined one."""
    evenly = 0.0 if NODES_PER_AREA in mesh.face_values else robot.mass.node_mass_kg
    mass = np.full(len(mesh.positions), evenly * len(coarse.positions) / len(mesh.positions))
    if len(mesh.seam):
        mass[mesh.seam] += robot.mass.seam_mass_kg * len(coarse.seam) / len(mesh.seam)
    areal = _of_triangles(robot, mesh, lambda film: film.density_kg_m3 * film.thickness_m)
    if NODES_PER_AREA in mesh.face_values:  # its nodes are closer at the holes
        areal += robot.mass.node_mass_kg * mesh.face_values[NODES_PER_AREA]
    corner_mass = areal / 3.0 * triangle_area(mesh.positions, mesh.triangles)
    for corner in range(3):
        np.add.at(mass, mesh.triangles[:, corner], corner_mass)
    if robot.stiffener.kind == "beam":
        _add_beam_mass(mass, mesh, robot.stiffener)
    if mass.min() < soft_robot.LEAST_NODE_MASS_kg:
        raise MeshError(
            f"node {mass.argmin()} has a mass of {mass.min():g} kg; every node needs "
            f"{soft_robot.LEAST_NODE_MASS_kg:g} kg at least: give mass.node_mass_kg or film.density_kg_m3"
        )
    return mass


def _add_beam_mass(mass: Array, mesh: NamedMesh, table: soft_robot.StiffenerTable) -> None:
    per_length = table.density_kg_m3 * _section(table).area_m2 * table.side_ratio
    for ring in (mesh.ring(name) for name in mesh.seam_rings):
        following = np.roll(ring, -1)
        length = np.linalg.norm(mesh.positions[following] - mesh.positions[ring], axis=1)
        mass[ring] += 0.5 * per_length * (length + np.roll(length, 1))

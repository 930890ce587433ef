"""Makes a soft body from a soft robot's description, a mesh file, or arrays.

Soft robots as the paper models them: bare film, as stiff in compression as in tension.

Mesh files as a source of soft bodies: the film, the caps of its open ends, and its named nodes.

Stacks of polygonal units as a source of soft bodies: the one place that turns their tables into names.

Soft bodies that are given from Python, as arrays, in place of a scenario's soft robot.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final, TypeAlias, final

import numpy as np

from cosim.base import kept_parts, solid
from cosim.base.frames import Array, IntArray, Pose, cross, in_mm
from cosim.build.patterns import drawn_pattern
from cosim.config.schema import body_sources, given_body, pattern, settings, soft_robot
from cosim.config.schema.film import FilmTable
from cosim.config.schema.stack import StackTable
from cosim.config.toml import parsing
from cosim.config.toml.rules import Faults
from cosim.errors import MeshError, ScenarioError
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection
from cosim.soft.body.body import GasChamber, SoftBody
from cosim.soft.body.copies import Plate, around_axis, attached, copies
from cosim.soft.elements import element, frame_ring, frame_stops, material, open_caps
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.fabric import Fabric
from cosim.soft.elements.hinge import bending_measure, shell_stiffness
from cosim.soft.geometry.named_mesh import BENDING_FACTOR, NamedMesh, refine, rest_angles
from cosim.soft.geometry.polygonal_stack import FUSED, PolygonalStack, with_finer_holes
from cosim.soft.geometry.surface import (
    check_mesh,
    directed_edges,
    interior_hinges,
    mean_beside,
    nodes_of_several_fans,
    rims,
    rows_of,
    triangle_area,
)

TAKEN_AWAY: Final = (
    "stack.mesh", "stack.refine_holes", "stack.neck", "film.law", "film.wrinkle_panel_m",
    "film.buckling_force_N_m", "hinge.rule", "stiffener", "cable.losses", "cable.eyelet_loss_N",
)  # fmt: skip
"""Keys of a robot's file that the paper's model does not look at."""


def published_robot(robot: soft_robot.SoftRobotTable) -> soft_robot.SoftRobotTable:
    """Return a robot in the paper's lumped model: what its file adds to that is taken away.

    Hinges keep their factor and barrier. What the robot carries is left as it is.
    Source: "cable pneumatic soft robots" and its code, Sim-FAST by Y. Zhu.
    """
    stack = None if robot.stack is None else replace(robot.stack, mesh="drawn", refine_holes=0, neck=None)
    groups = tuple(replace(entry, film=_published_film(entry.film)) for entry in robot.groups)
    return replace(
        robot,
        stack=stack,
        film=_published_film(robot.film),
        groups=groups,
        hinge=replace(robot.hinge, rule="uniform"),
        cables=tuple(replace(cable, losses="one_way", eyelet_loss_N=0.0) for cable in robot.cables),
        stiffener=soft_robot.StiffenerTable(),
    )


def _published_film(film: FilmTable) -> FilmTable:
    """Return a film with the paper's law: bars along the edges where they are asked for, plain otherwise."""
    law = film.law if film.law == "edge_strain" else "plain"
    return replace(film, law=law, wrinkle_panel_m=None, buckling_force_N_m=0.0)


_SAME_PLANE = 1e-5  # of the film's size


def drawn_mesh(table: body_sources.MeshTable) -> NamedMesh:
    """Return the film of a mesh file, in the flange's frame.

    Raises:
        MeshError: the file cannot be read, or it has no such nodes.
    """
    read = solid.read_surface(Path(table.file))
    surface = solid.GroupedSurface(table.scale * read.vertices, read.triangles, read.groups)
    check_mesh(surface.vertices, surface.triangles)
    pinched = nodes_of_several_fans(surface.triangles)
    if len(pinched):
        raise MeshError(
            f"{Path(table.file).name}: two parts of the film touch only in node {pinched[0]} at "
            f"{in_mm(surface.vertices[pinched[0]])}: their gas would be one; move them apart, or join "
            "them along edges"
        )
    holes = rims(surface.triangles)
    if _six_volumes(surface, holes) < 0.0:
        raise MeshError(f"{Path(table.file).name}: is inside out; turn its triangles over")
    sets = {entry.name: _nodes(entry, surface) for entry in table.sets}
    for name, nodes in sets.items():
        rim = next((hole for hole in holes if set(hole.tolist()) == set(nodes.tolist())), None)
        sets[name] = nodes if rim is None else rim
    return NamedMesh(
        positions=surface.vertices,
        triangles=surface.triangles,
        rings=sets,
        caps=holes,
        base_ring=table.sets[0].name,
        tip_ring=table.tip,
        lines=sets,
        face_groups=surface.groups,
    )


def _six_volumes(surface: solid.GroupedSurface, holes: tuple[IntArray, ...]) -> float:
    """Return six times the volume [m^3] that film and caps enclose, see `cosim.soft.elements.pressure`."""
    x = surface.vertices - surface.vertices.mean(axis=0)
    a, b, c = (x[surface.triangles[:, k]] for k in range(3))
    caps = (x[hole].mean(axis=0) @ cross(x[hole], x[np.roll(hole, -1)]).sum(axis=0) for hole in holes)
    return float((a * cross(b, c)).sum() + sum(caps))


def _nodes(entry: body_sources.NodeSetTable, surface: solid.GroupedSurface) -> IntArray:
    if entry.group is not None:
        if entry.group not in surface.groups:
            known = ", ".join(surface.groups) or "none"
            raise MeshError(f"set {entry.name!r} is of group {entry.group!r}; the file has: {known}")
        return np.unique(surface.triangles[surface.groups[entry.group]])
    if entry.axis is not None and entry.at_m is not None:
        return _in_plane(entry.name, "xyz".index(entry.axis), entry.at_m, surface.vertices)
    return _nearest(entry.name, np.array(entry.points_m), surface)


def _in_plane(name: str, axis: int, at_m: float, x: Array) -> IntArray:
    """Return the nodes in a plane across an axis, around it counter-clockwise seen from outside."""
    low, high = float(x[:, axis].min()), float(x[:, axis].max())
    found = np.flatnonzero(np.abs(x[:, axis] - at_m) <= _SAME_PLANE * float(np.ptp(x, axis=0).max()))
    if not found.size:
        raise MeshError(
            f"set {name!r} is at {'xyz'[axis]} = {at_m:g} m, where no node is; the film reaches from "
            f"{low:g} m to {high:g} m"
        )
    offset = x[found] - x[found].mean(axis=0)
    angle = np.arctan2(offset[:, (axis + 2) % 3], offset[:, (axis + 1) % 3])
    return found[np.argsort(angle if at_m > 0.5 * (low + high) else -angle, kind="stable")]


def _nearest(name: str, points: Array, surface: solid.GroupedSurface) -> IntArray:
    x = surface.vertices
    ends = x[directed_edges(surface.triangles)]
    reach = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max())
    found = np.empty(len(points), np.int64)
    for k, point in enumerate(points):
        distance = np.linalg.norm(x - point, axis=1)
        found[k] = np.argmin(distance)
        if distance[found[k]] > reach:
            raise MeshError(
                f"set {name!r}: point {point.tolist()} is {distance[found[k]]:.3g} m from the nearest node, "
                f"further than the longest edge, {reach:.3g} m"
            )
    return found


NODES_PER_AREA: Final = "nodes_per_m2"
"""Face value of a mesh with further nodes at its holes: nodes of the drawn mesh to the square metre."""


def drawn_stack(table: StackTable) -> NamedMesh:
    """Return the unrefined mesh of a stack, in the flange's frame.

    Raises:
        MeshError: the geometry gives degenerate triangles.
    """
    return _stack(table).mesh()


def _stack(table: StackTable) -> PolygonalStack:
    t = table
    return PolygonalStack(
        t.sides, t.units, t.corner_radius_m, t.hole_radius_m, t.unit_height_m, t.taper,
        t.mid_ring_fraction, t.ring_heights, t.first_corner_rad,
    )  # fmt: skip


def stack_mesh(drawn: NamedMesh, table: StackTable) -> NamedMesh:
    """Return the mesh of a stack, refined as its table has it; the drawn one where it is not.

    Films fused at the necks are face group `holes.FUSED`.

    Raises:
        MeshError: a neck has no room, or no refinement at its hole.
    """
    fused_radius_m = None if table.neck is None else table.neck.fused_radius_m
    if table.mesh == "graded":
        return refine(
            _spread_by_unit(_stack(table).graded_mesh(fused_radius_m), drawn, table.units), table.refine
        )
    if not table.refine_holes and table.neck is None:
        return refine(drawn, table.refine)
    rings = (*drawn.center_rings, drawn.tip_ring)
    drawn = replace(drawn, face_values={**drawn.face_values, NODES_PER_AREA: _nodes_per_area(drawn)})
    return refine(with_finer_holes(drawn, rings, table.refine_holes, fused_radius_m), table.refine)


def _spread_by_unit(mesh: NamedMesh, drawn: NamedMesh, units: int) -> NamedMesh:
    """Return a mesh with the nodes that the drawn one has in each unit, spread over its film.

    Rings of the drawn mesh, equally far apart, have the same number of nodes: on an area there are as many as
    goes with one over the distance from the axis.
    """
    area, own = (triangle_area(film.positions, film.triangles).reshape(units, -1) for film in (drawn, mesh))
    nodes = (area * _nodes_per_area(drawn).reshape(units, -1)).sum(axis=1)
    away = np.linalg.norm(mesh.positions[mesh.triangles].mean(axis=1)[:, :2], axis=1).reshape(units, -1)
    spread = (nodes / (own / away).sum(axis=1))[:, None] / away
    return replace(mesh, face_values={**mesh.face_values, NODES_PER_AREA: spread.ravel()})


def _nodes_per_area(mesh: NamedMesh) -> Array:
    """Return how many nodes lie on a square metre of each triangle (m,), each spread over those around it."""
    area = np.repeat(triangle_area(mesh.positions, mesh.triangles), 3)
    around = np.bincount(mesh.triangles.ravel(), area, len(mesh.positions))
    return np.asarray((1.0 / around[mesh.triangles]).sum(axis=1))


@lru_cache(maxsize=2)
def _stack_meshes(table: StackTable) -> tuple[NamedMesh, NamedMesh]:
    """Return the drawn mesh of a stack and its own; kept, as derivatives build many bodies on one mesh."""
    drawn = drawn_stack(table)
    return drawn, stack_mesh(drawn, table)


def cable_route(mesh: NamedMesh, table: soft_robot.CableTable) -> IntArray:
    """Return the nodes of a mesh that a cable leads through, base to tip."""
    if table.units is None:
        return mesh.line(table.line or "")
    lines = np.stack([line for name, line in mesh.lines.items() if name.startswith("corner_")])
    first, last = table.units
    along = np.arange(first - 1, len(lines[0]) if last == "last" else last)
    corners = (table.corner or 0) + table.corners_per_unit * np.arange(len(along))
    return np.asarray(lines[corners % len(lines), along])


LEAST_RING: Final = 3


@final
@dataclass(frozen=True)
class NamedBody:
    """A soft body with the names that a scenario calls it and its cables by.

    Args:
        body: in the flange's frame; its film closed by caps where it holds gas. Its base and tip are rings
            "base" and "tip", unless it has rings of these names.
        name: of the body.
        cable_names: of its cables, in order; omitted: cable_1, cable_2, ...

    Raises:
        MeshError: the film is no sound surface, the base is empty, the tip no ring, a node has no mass, or
            there are more or fewer names than cables.
        ScenarioError: a name cannot be one.
    """

    body: SoftBody
    name: str = "body"
    cable_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        body = self.body
        check_mesh(body.positions, body.triangles)
        if not len(body.base):
            raise MeshError("the soft body has no base: no node would follow the flange")
        if len(body.tip) < LEAST_RING:
            raise MeshError(f"the tip has {len(body.tip)} nodes; a ring of {LEAST_RING} is needed at least")
        light = np.flatnonzero(body.node_mass < soft_robot.LEAST_NODE_MASS_kg)
        if light.size:
            raise MeshError(
                f"node {light[0]} has a mass of {body.node_mass[light[0]]:g} kg; every node needs "
                f"{soft_robot.LEAST_NODE_MASS_kg:g} kg at least"
            )
        names = self.cable_names or tuple(f"cable_{k + 1}" for k in range(len(body.cables)))
        if len(names) != len(body.cables) or len(set(names)) < len(names):
            raise MeshError(f"cable_names are {list(names)}; {len(body.cables)} names that differ are needed")
        rings = {"base": body.base, "tip": body.tip, **body.rings}
        object.__setattr__(self, "cable_names", names)
        object.__setattr__(self, "body", replace(body, rings=rings))
        self.table()

    @classmethod
    def of(cls, body: "SoftBody | NamedBody") -> "NamedBody":
        """Return a body with names, the usual ones where it has none."""
        return body if isinstance(body, NamedBody) else cls(body)

    def table(self) -> given_body.GivenBodyTable:
        """Return what a scenario may name of it."""
        body = self.body
        described = {
            "name": self.name,
            "arrays": kept_parts.content_name(body),
            "triangles": len(body.triangles),
            "closed": body.closed,
            "rings": list(body.rings),
            "base": [name for name, ring in body.rings.items() if np.isin(ring, body.base).all()],
            "cables": list(self.cable_names),
            "chambers": [chamber.name for chamber in body.gas_chambers],
        }
        return parsing.parse(given_body.GivenBodyTable, described, "body", Faults())


AnyBody: TypeAlias = SoftBody | NamedBody
"""What may be given in place of a scenario's soft robot."""


_REST = ""  # name of the face group of all triangles that are in none with a film of its own
_KEPT_STIFFNESS = 1e-4  # of the plain law in a tension field: slack triangles beside hinges would collapse


def build_film(table: FilmTable) -> material.Film:
    """Return a film."""
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
        f.loss_frequency_Hz, fabric, f.buckling_force_N_m,
    )  # fmt: skip


def build_soft_body(
    robot: soft_robot.SoftRobotTable, model: settings.ModelTable, path: str = "soft_robot", finer: int = 0
) -> SoftBody:
    """Return the soft body of a robot, in the flange frame.

    Args:
        robot: its description.
        model: comparison switches; `published` decides before anything of the description does.
        path: of the description's table.
        finer: how often each triangle is divided into four, besides what the description asks for.

    Raises:
        MeshError: the geometry gives degenerate triangles.
        ScenarioError: a film wrinkles, and nothing says how wide its panels are; `path` names the key.
    """
    if model.published:
        robot = published_robot(robot)
    drawn, mesh = _drawn_body(robot) if robot.stack is None else _stack_meshes(robot.stack)
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
    """Return the unrefined mesh of a robot that is no stack, twice."""
    assert robot.body is not None, "a checked robot has one of the two"
    mesh: NamedMesh
    if isinstance(robot.body, body_sources.MeshTable):
        mesh = drawn_mesh(robot.body)
        _check_held(mesh, robot.base)
    elif isinstance(robot.body, pattern.PatternTable):
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
    """Refuse a film with a piece that no base holds."""
    held = mesh.positions[np.unique(np.concatenate([mesh.ring(name) for name in base]))]
    for piece in solid.TriangleMesh(mesh.positions, mesh.triangles).shells():
        if not (held[:, None] == piece.vertices).all(axis=2).any():
            raise MeshError(
                f"the piece of film around {in_mm(piece.vertices.mean(axis=0))} shares no node with the "
                f"rest, and no base ({', '.join(base)}) holds it: join it, or take it away"
            )


def _films(robot: soft_robot.SoftRobotTable) -> material.Film | dict[str, material.Film]:
    film = build_film(robot.film)
    own = {name: build_film(table) for name, table in _own_films(robot).items()}
    return {_REST: film, **own} if own else film


def _own_films(robot: soft_robot.SoftRobotTable) -> dict[str, FilmTable]:
    """Return the films of face groups that have one of their own."""
    own = {entry.name: entry.film for entry in robot.groups}
    if robot.stack is None or robot.stack.neck is None:
        return own
    return {**own, FUSED: replace(robot.film, thickness_m=2.0 * robot.film.thickness_m)}


def _face_groups(robot: soft_robot.SoftRobotTable, mesh: NamedMesh) -> dict[str, IntArray]:
    """Return the face groups, and under its own name what is in none with a film."""
    own = [mesh.face_groups[name] for name in _own_films(robot) if name in mesh.face_groups]
    rest = np.setdiff1d(np.arange(len(mesh.triangles)), np.concatenate([np.zeros(0, np.int64), *own]))
    return {**mesh.face_groups, _REST: rest}


def _chambers(robot: soft_robot.SoftRobotTable, mesh: NamedMesh) -> tuple[GasChamber, ...]:
    """Return the chambers of a film that encloses several; the body has its triangles film by film."""
    if not mesh.chambers:
        return ()
    groups, films = _face_groups(robot, mesh), _films(robot)
    order = np.concatenate([groups[name] for name in films]) if isinstance(films, dict) else None
    place = np.arange(len(mesh.triangles))
    if order is not None:
        place[order] = np.arange(len(order))
    found = []
    for name in mesh.chambers:
        own = mesh.face_groups[name]
        inside = set(mesh.triangles[own].ravel().tolist())
        caps = tuple(k for k, cap in enumerate(mesh.caps) if inside.issuperset(cap.tolist()))
        found.append(GasChamber(name, np.sort(place[own]), caps))
    return tuple(found)


def _of_triangles(
    robot: soft_robot.SoftRobotTable, mesh: NamedMesh, value: Callable[[FilmTable], float]
) -> Array:
    """Return a value (m,) of the film of each triangle."""
    found = np.full(len(mesh.triangles), value(robot.film))
    for name, film in _own_films(robot).items():
        if name in mesh.face_groups:  # a name that is in none is refused with the body
            found[mesh.face_groups[name]] = value(film)
    return found


def _check_panels(robot: soft_robot.SoftRobotTable, mesh: NamedMesh, path: str) -> None:
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
        return [frame_ring.FrameRings.from_shape(mesh.positions, rings, table.stiffness_N_m)]
    found: list[element.Element] = [BeamRings.from_shape(mesh.positions, rings, _section(table))]
    if table.rest_on_one_another and len(rings) > 1:
        found.append(frame_stops.FrameStops.from_shape(mesh.positions, rings, robot.frame_pitch_m))
    return found


def _section(table: soft_robot.StiffenerTable) -> RectangularSection:
    # what is missing was refused before
    width, height, modulus = table.width_m or 0.0, table.height_m or 0.0, table.young_modulus_Pa or 0.0
    return RectangularSection(width, height, modulus, table.poisson_ratio, table.strength_strain or np.inf)


def _node_mass(robot: soft_robot.SoftRobotTable, coarse: NamedMesh, mesh: NamedMesh) -> Array:
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
    if mass.min() < soft_robot.LEAST_NODE_MASS_kg:
        raise MeshError(
            f"node {mass.argmin()} has a mass of {mass.min():g} kg; every node needs "
            f"{soft_robot.LEAST_NODE_MASS_kg:g} kg at least: give mass.node_mass_kg or film.density_kg_m3"
        )
    return mass


def _add_beam_mass(mass: Array, mesh: NamedMesh, table: soft_robot.StiffenerTable) -> None:
    per_length = table.density_kg_m3 * _section(table).area_m2
    for ring in (mesh.ring(name) for name in mesh.seam_rings):
        following = np.roll(ring, -1)
        length = np.linalg.norm(mesh.positions[following] - mesh.positions[ring], axis=1)
        mass[ring] += 0.5 * per_length * (length + np.roll(length, 1))

"""Rules that tie several values of a scenario's objects together."""

from __future__ import annotations

from typing import Final

import numpy as np

from cosim.base.triangle_mesh import read_mesh
from cosim.config.schema.mesh_paths import mesh_path
from cosim.config.schema.objects import HingeJointTable, ObjectTable, SolidTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.wire import WireTable
from cosim.config.toml.faults import Faults
from cosim.config.toml.suggestions import unknown_name_message
from cosim.errors import MeshError, ScenarioError

SMALLEST_MESH_m: Final = 1e-6
LARGEST_MESH_m: Final = 100.0
LEAST_INERTIA_kg_m2: Final = 1e-15  # that MuJoCo takes
_SIZE_ENTRIES: Final = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2, "ellipsoid": 3, "mesh": 0}


def check_objects(scenario: Scenario, faults: Faults) -> None:
    """Check the objects and wires of a scenario, one by one and together.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    objects = scenario.objects
    with faults:
        for entry in objects:
            with faults:
                check_object(entry, f"object.{entry.name}", faults)
    names = tuple(entry.name for entry in objects)
    for entry in objects:
        with faults:
            _check_joint(entry, names, f"object.{entry.name}", faults)
    with faults:
        for wire in scenario.wires:
            with faults:
                _check_wire(wire, names, f"wire.{wire.name}", faults)
    parents = {entry.name: joint.parent for entry in objects if (joint := entry.hinge or entry.slide)}
    for name in names:
        with faults:
            _check_line(name, parents)


def _check_joint(entry: ObjectTable, names: tuple[str, ...], path: str, faults: Faults) -> None:
    if entry.hinge is not None and entry.slide is not None:
        raise ScenarioError(f"{path}.slide", "cannot stand beside hinge; an object has one joint")
    joint, key = entry.hinge or entry.slide, "hinge" if entry.hinge is not None else "slide"
    if joint is None:
        return
    with faults:
        if entry.mass_kg is None:
            raise ScenarioError(f"{path}.mass_kg", f"is missing; what hangs on a {key} needs mass")
    with faults:
        if joint.parent is not None and joint.parent not in names:
            raise ScenarioError(f"{path}.{key}.parent", unknown_name_message("object", joint.parent, names))
    unit = "rad" if isinstance(joint, HingeJointTable) else "m"
    limits = joint.range_rad if isinstance(joint, HingeJointTable) else joint.range_m
    if limits is not None and not (limits[0] <= 0.0 <= limits[1] and limits[0] < limits[1]):
        raise ScenarioError(
            f"{path}.{key}.range_{unit}", f"{list(limits)} must increase and hold 0, where the object starts"
        )


def _check_line(name: str, parents: dict[str, str | None]) -> None:
    """Follow the parents from an object on; none may come twice."""
    line = [name]
    while (parent := parents.get(line[-1])) is not None:
        if parent in line:
            raise ScenarioError(f"object.{name}", f"hangs on itself: {' on '.join([*line, parent])}")
        line.append(parent)


def _check_wire(wire: WireTable, names: tuple[str, ...], path: str, faults: Faults) -> None:
    for key in ("first", "last"):
        with faults:
            held = getattr(wire, key)
            if held is not None and held not in names:
                raise ScenarioError(f"{path}.{key}", unknown_name_message("object", held, names))
    points = np.array(wire.points_m)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    if length / wire.segments <= 2.0 * wire.radius_m:
        most = int(length / (2.0 * wire.radius_m))
        raise ScenarioError(
            f"{path}.segments",
            f"{wire.segments} segments of {length:.3g} m are not longer than thick; fewer than {most} are",
        )
    least = LEAST_INERTIA_kg_m2 / (0.4 * wire.radius_m**2) * wire.segments
    if wire.mass_kg <= least:
        raise ScenarioError(
            f"{path}.mass_kg",
            f"{wire.mass_kg:g} is too light for {wire.segments} segments that thin, which would spin without "
            f"inertia; must be above {least:.3g}",
        )


def check_object(entry: ObjectTable, path: str, faults: Faults) -> None:
    """Check one object.

    Args:
        entry: may hold UNKNOWN.
        path: of its table.
        faults: gets the rules that are broken.
    """
    with faults:
        if entry.shape is None and not entry.parts:
            raise ScenarioError(path, "give a shape, or [[object.part]] tables; neither is given")
    with faults:
        _check_inertia(entry, path)
    solids: list[tuple[str, ObjectTable | SolidTable]] = [(path, entry)]
    solids += [(f"{path}.part.{k}", part) for k, part in enumerate(entry.parts, start=1)]
    for where, solid in solids:
        for check in (_check_size, _check_mesh):
            with faults:
                check(solid, where)


def _check_inertia(entry: ObjectTable, path: str) -> None:
    inertia = entry.inertia_kg_m2
    if inertia is None:
        if entry.center_of_mass_m is not None:
            raise ScenarioError(f"{path}.center_of_mass_m", "goes with inertia_kg_m2; none is given")
        return
    if entry.mass_kg is None:
        raise ScenarioError(f"{path}.mass_kg", "is missing; what has inertia_kg_m2 needs mass")
    if 2.0 * max(inertia) > sum(inertia):
        raise ScenarioError(
            f"{path}.inertia_kg_m2",
            f"{list(inertia)} is of no body: the largest must not be above the sum of the other two",
        )


def _check_size(entry: ObjectTable | SolidTable, path: str) -> None:
    if entry.shape is None:
        if entry.size_m:
            raise ScenarioError(f"{path}.size_m", "goes with a shape; none is given")
    elif len(entry.size_m) != _SIZE_ENTRIES[entry.shape]:
        raise ScenarioError(
            f"{path}.size_m",
            f"has {len(entry.size_m)} entries; a {entry.shape} has {_SIZE_ENTRIES[entry.shape]}",
        )


def _check_mesh(entry: ObjectTable | SolidTable, path: str) -> None:
    if entry.shape != "mesh":
        if entry.file is not None:
            raise ScenarioError(f"{path}.file", "goes with shape = 'mesh'")
        return
    if entry.file is None:
        raise ScenarioError(f"{path}.file", "is missing; a mesh needs an .stl or .obj file")
    try:
        mesh = read_mesh(mesh_path(entry.file))
    except MeshError as error:
        raise ScenarioError(f"{path}.file", str(error)) from error
    size = entry.scale * float(np.abs(mesh.vertices).max())
    if not SMALLEST_MESH_m <= size <= LARGEST_MESH_m:
        raise ScenarioError(
            f"{path}.scale",
            f"{entry.scale:g} makes the mesh reach {size:g} m from its origin; must be within "
            f"{SMALLEST_MESH_m:g} and {LARGEST_MESH_m:g} m",
        )
